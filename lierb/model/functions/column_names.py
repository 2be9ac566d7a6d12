"""Observables, states and outputs must not use the names of a run's columns."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from math import prod

from lierb.errors import ArgumentError
from lierb.kernels.systems.layout import POSE_AND_TWIST
from lierb.kernels.systems.measures import KEPT, MEASURES
from lierb.kernels.systems.observables import KEEPS
from lierb.model.functions.binding import Column
from lierb.model.functions.observables import Observable
from lierb.model.joints.joint import MOST_ROWS

AXES = ("x", "y", "z")
COMPONENTS = {  # suffixes of the components of vectors in data frames
    "rotation": tuple(i + j for i in AXES for j in AXES),
    "position": AXES,
    "omega": AXES,
    "v": AXES,
    "reaction": tuple(f"{what}_{i}" for what in ("torque", "force") for i in AXES),
}
OF_A_ROW = ("trajectory", "step", "t", "event", "status")
OF_STEPS = ("steps", "rejected", "dt_last", "iterations")
SETTING = ("cspace", "method", "dt", "rtol")  # columns of a study
MULTIPLIERS = "lambda"


def _taken() -> Iterator[str]:
    yield from (*OF_A_ROW, *OF_STEPS, *SETTING, MULTIPLIERS, "reaction")
    yield from (field.name for field in POSE_AND_TWIST.fields)
    yield from (measure.name for measure in MEASURES)
    yield from (f"{measure.name}_{how}" for measure, how in KEPT)
    yield from (f"{name}_{part}" for name, parts in COMPONENTS.items() for part in parts)
    yield from (f"{MULTIPLIERS}_{i + 1}" for i in range(MOST_ROWS))


TAKEN = frozenset(_taken())


def require_free(observables: Iterable[Observable], signals: Iterable[Column] = ()) -> None:
    """Raise ArgumentError if a column name exists already; case is ignored.

    signals : columns of extra states and controllers' outputs, whose names differ.
    """
    owners: dict[str, str] = {}
    for each in observables:
        columns = (each.name, *(f"{each.name}_{how}" for how in KEEPS))
        remedy = f'give it another name: {each.name}(…).named("…")'
        _require_free("observables", each.name, columns, owners, remedy)
    for signal in signals:
        parts = (f"{signal.name}_{i + 1}" for i in range(prod(signal.shape)) if signal.shape)
        columns = (signal.name, *parts)
        _require_free("states and controllers", signal.name, columns, owners, "rename it")


def _require_free(
    what: str, name: str, columns: tuple[str, ...], owners: dict[str, str], remedy: str
) -> None:
    """Raise ArgumentError if a column has an owner; enter the new owner of the columns."""
    for column in columns:
        owner = "lierb's own" if column.lower() in TAKEN else owners.get(column.lower())
        if owner:
            raise ArgumentError(
                f"{what}: {name} would have the column {column}, which is {owner}; {remedy}"
            )
    kind = "observable" if what == "observables" else "state or output"
    owners |= dict.fromkeys((column.lower() for column in columns), f"that of the {kind} {name}")
