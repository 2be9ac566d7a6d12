"""Parameters with respect to which a run can be differentiated: names, units and directions."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from itertools import accumulate, combinations
from math import prod
from typing import Any, NamedTuple

import numpy as np

from lierb.errors import ArgumentError, LierbError, brief, items_of, unknown_name
from lierb.model.acting import ELEMENTS
from lierb.model.base import Model
from lierb.model.numbers import INERTIA, Place, labelled, places_of, qualified
from lierb.runs.start_directions import (
    JOINT,
    POSE,
    TWIST,
    Moved,
    Seeds,
    Start,
    frame_seeds,
    omega_units,
)
from lierb.support.arrays import Array

TWIST_UNITS = "rad/s, rad/s, rad/s, m/s, m/s, m/s"
POSE_UNITS = "rad, rad, rad, m, m, m"
STARTS = {
    "twist0": (6, TWIST_UNITS, TWIST),
    "omega0": (3, "rad/s", TWIST),
    "pose0": (6, POSE_UNITS, POSE),
}
SYMMETRIC = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))  # entries of an inertia
MOST = 1 << 14  # directions times trajectories that are treated together
OF_LISTS = ("problem", *ELEMENTS)  # prefixes of names in a study


class Parameter(NamedTuple):
    """Parameter of a run, a number or several.

    size : number of its directions.   unit : unit, or those of all components.
    fields : fields of the inputs that depend on it.
    seeds : function of the start that returns derivatives of its own fields; for a pose or twist of
    the start, directions in the body's axes by field.
    units : changes of the numbers of the first field along each direction, (directions, numbers);
    None for a start.
    follows : what of the start follows: "" for nothing, "pose" and "twist" for the links whose
    start it is not, "joint" for a parameter of joints or constraints.
    """

    name: str
    size: int
    unit: str
    fields: tuple[str, ...]
    seeds: Callable[[Start], Seeds]
    units: Array | None = None
    follows: str = ""

    @property
    def is_start(self) -> bool:
        """Return whether it is a pose or twist at the start."""
        return self.units is None

    @property
    def link(self) -> str:
        """Return the prefix of the link of a start."""
        link, dot, _ = self.name.rpartition(".")
        return link + dot

    def is_same_as(self, other: Parameter) -> bool:
        """Return whether both are names of the same numbers of the model."""
        if self.units is None or other.units is None:
            return False
        return self.fields[0] == other.fields[0] and np.array_equal(self.units, other.units)

    @property
    def own_fields(self) -> tuple[str, ...]:
        """Return the fields that hold its numbers, each all of them; not for a start."""
        return self.fields[:1] if self.moves_start else self.fields

    @property
    def moves_start(self) -> bool:
        """Return whether it is of a joint or a constraint, with which the start changes."""
        return self.follows == JOINT


def slices_of(parameters: Iterable[Parameter]) -> dict[str, slice]:
    """Return the place of each parameter, by name, among the numbers of all in order."""
    slices, first = {}, 0
    for p in parameters:
        slices[p.name] = slice(first, first + p.size)
        first += p.size
    return slices


def labels_of(p: Parameter) -> list[str]:
    """Return a name for each number of a parameter."""
    if p.size == 1:
        return [p.name]
    if p.name.endswith("body.inertia"):
        return [f"{p.name}[{i + 1}{j + 1}]" for i, j in SYMMETRIC]
    return [f"{p.name}[{k}]" for k in range(p.size)]


def units_of(p: Parameter) -> list[str]:
    """Return the unit of each number of a parameter."""
    units = p.unit.split(", ")
    return units * p.size if len(units) == 1 else units


def parameters_by_name(model: Model) -> dict[str, Parameter]:
    """Return all parameters of a model."""
    return {p.name: p for p in _parameters(model)}


def chosen_parameters(
    model: Model, given: Any, argument: str = "with_respect_to"
) -> tuple[Parameter, ...]:
    """Return the parameters of an argument with their names. Raises ArgumentError."""
    expected = "names of parameters, such as omega0 or body.mass"
    names = (given,) if isinstance(given, str) else items_of(argument, given, expected)
    if not names:  # most runs: all parameters of a model take longer than its checks
        return ()
    known = parameters_by_name(model)
    parameters: dict[str, Parameter] = {}
    for name in names:
        if isinstance(name, Parameter):  # of fits, with directions of their own
            parameters[name.name] = name
            continue
        if not isinstance(name, str):
            raise ArgumentError(f"{argument} has {brief(name)}; expected {expected}")
        table, _, rest = name.partition(".")
        key = rest if table in OF_LISTS and name not in known else name
        if key not in known:
            raise _unknown(model, argument, name, known)
        if key in parameters:
            raise ArgumentError(f"{argument} names {key} twice; name it once")
        parameters[key] = known[key]
    return tuple(parameters.values())


def separate_parameters(model: Model, given: Any) -> tuple[Parameter, ...]:
    """Return the parameters of `parameters=`, no two of which share a number. Raises ArgumentError.

    A fit could not tell them apart, and a covariance would count the number twice.
    """
    chosen = chosen_parameters(model, given, "parameters")
    for first, second in combinations(chosen, 2):
        if {first.name, second.name} == {f"{first.link}omega0", f"{first.link}twist0"}:
            names, why = sorted((first.name, second.name)), "is a part of"
        elif first.is_same_as(second):
            names, why = [second.name, first.name], "is another name of"
        else:
            continue
        part, whole = names
        raise ArgumentError(
            f"parameters names {first.name} and {second.name}; {part} {why} {whole}, leave out "
            f"{part}"
        )
    return chosen


def _unknown(model: Model, argument: str, name: str, known: dict[str, Parameter]) -> LierbError:
    place = places_of(model).get(name)
    if place is None or place.kind != "time":
        return unknown_name(argument, name, known)
    owner = name.rpartition(".")[0]
    element = next(e.name for e, label, _ in labelled(model) if label == owner)
    return ArgumentError(
        f"{argument}={brief(name)} determines times at which {element} jumps, by which the motion "
        "is not differentiated; leave it out"
    )


def _parameters(model: Model) -> Iterator[Parameter]:
    """Yield all parameters of a model."""
    for link, owner in enumerate(model.link_names):
        for name, (count, unit, follows) in STARTS.items():
            seeds, fields = partial(_start_units, model, link, name), _start_fields(model, name)
            yield Parameter(qualified(owner, name), count, unit, fields, seeds, follows=follows)
    for name, place in places_of(model).items():
        if place.kind not in ("frame", "time"):
            parameter = partial(_geometric, model) if place.binds else _plain
            yield parameter(name, place, _units(place))


# ---- directions --------------------------------------------------------------------------------


def _plain(name: str, place: Place, units: Array) -> Parameter:
    """Return a parameter on which the start does not depend.   units : (directions, numbers)."""
    fields = place.field, *place.copies
    seeds = dict.fromkeys(fields, units[:, None])
    return Parameter(name, len(units), place.unit, fields, lambda start: seeds, units)


def _units(place: Place) -> Array:
    """Return the changes of a field's numbers along each direction, (directions, numbers)."""
    if place.kind == "point":
        return np.eye(3, 12, 9)  # of the last three numbers of a frame
    if place.shapes != INERTIA:
        return np.eye(prod(place.shapes[0]))
    units = np.zeros((len(SYMMETRIC), 3, 3))
    for direction, (i, j) in enumerate(SYMMETRIC):
        units[direction, i, j] = units[direction, j, i] = 1.0
    return units.reshape(-1, 9)


def _geometric(model: Model, name: str, place: Place, units: Array) -> Parameter:
    """Return a parameter of a joint or a constraint, with which the start changes."""
    fields = place.field, *_start_fields(model, "pose0")
    return _plain(name, place, units)._replace(fields=fields, follows=JOINT)


def _start_fields(model: Model, name: str) -> tuple[str, ...]:
    fields = ("pose", "twist") if name == "pose0" else ("twist",)
    return tuple(f"{prefix}{field}" for prefix in model.fields for field in fields)


def _start_units(model: Model, link: int, name: str, start: Start) -> Seeds:
    """Return the directions of a link's start, in its body's axes."""
    units = np.eye(6)[:, None]
    if name == "omega0":
        joint = model.joints[link].joint
        assert joint is not None
        units = omega_units(joint.body_frame)
    return {f"{model.fields[link]}{STARTS[name][2]}": units}


def _seeds_of(start: Start, moved: Moved, with_poses: bool) -> Seeds:
    seeds: Seeds = {}
    for i, prefix in enumerate(start.model.fields):
        seeds[f"{prefix}twist"] = moved.twists[i]
        if with_poses:
            seeds[f"{prefix}pose"] = frame_seeds(start.poses[i], moved.poses[i])
    return seeds


def fields_of(parameters: Iterable[Parameter], order: Iterable[str]) -> tuple[str, ...]:
    """Return the fields on which any of the parameters acts, in this order."""
    fields = {field for p in parameters for field in p.fields}
    return tuple(name for name in order if name in fields)


def all_directions(parameters: Iterable[Parameter], start: Start) -> list[dict[str, Array]]:
    """Return the derivatives of the inputs along each direction, (n or 1, numbers) by field."""
    parameters = tuple(parameters)
    seeds = seeds_of(parameters, start)
    return [
        {field: array[j] for field, array in seeds[p.name].items()}
        for p in parameters
        for j in range(p.size)
    ]


def seeds_of(parameters: Iterable[Parameter], start: Start) -> dict[str, Seeds]:
    """Return the derivatives of the inputs along the directions of each parameter, by name.

    Parameters with the same `follows` are treated together, since the arrays are small.
    """
    seeds = {p.name: (p, p.seeds(start)) for p in parameters}
    found = {name: own for name, (_, own) in seeds.items()}
    for follows in (POSE, TWIST, JOINT):
        rest = [p for p, _ in seeds.values() if p.follows == follows]
        while rest:
            most = max(MOST // start.count, max(p.size for p in rest))
            count = sum(size <= most for size in accumulate(p.size for p in rest))
            group, rest = rest[:count], rest[count:]
            parts = slices_of(group)
            together = _stacked([(parts[p.name], found[p.name]) for p in group])
            moved = _seeds_of(start, start.moved(follows, together), follows != TWIST)
            for name, part in parts.items():
                own = found[name] if follows == JOINT else {}
                found[name] = own | {field: array[part] for field, array in moved.items()}
    return found


def misfits_of(parameters: Sequence[Parameter], start: Start) -> tuple[Array, Array]:
    """Return `Start.misfits` along the directions of parameters with which the start moves."""
    pairs = zip(slices_of(parameters).values(), parameters, strict=True)
    return start.misfits(_stacked([(part, p.seeds(start)) for part, p in pairs]))


def _stacked(changes: Sequence[tuple[slice, Seeds]]) -> Seeds:
    """Return changes by field, of all directions, with zeros for fields that do not change."""
    stacked: Seeds = {}
    for field in {field: None for _, own in changes for field in own}:
        parts = [(part, own[field]) for part, own in changes if field in own]
        count, width = max(x.shape[1] for _, x in parts), parts[0][1].shape[2]
        stacked[field] = np.zeros((changes[-1][0].stop, count, width))
        for part, x in parts:
            stacked[field][part] = x
    return stacked
