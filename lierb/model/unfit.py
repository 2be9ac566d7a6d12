"""Errors for rows of users' functions that are not finite at a start."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Any

import numpy as np

from lierb.errors import PoseError, TwistError
from lierb.kernels.mechanics.newton_euler import BodyConstants, Kinematics
from lierb.kernels.mechanics.rows import Row, Rows
from lierb.kernels.mechanics.user_rows import UserRow
from lierb.kernels.numbers.arithmetic import plain
from lierb.support.arrays import first_bad

Label = Callable[[int], str]  # name of a member's pose in messages


def unfit_rate(rows: Rows, rates: Iterable[Any], t0: float) -> TwistError | None:
    """Error for the first prescribed rate, such as a motor's speed, that is not finite at t0."""
    message = _unfit(rows, rates, t0, "the speed", "/s", "twist")
    return TwistError(message) if message else None


def unfit_place(rows: Rows, places: Iterable[Any], t0: float) -> PoseError | None:
    """Error for the first prescribed position of a motor that is not finite at t0."""
    message = _unfit(rows, places, t0, "the position", "", "pose")
    return PoseError(message) if message else None


def _unfit(
    rows: Rows, numbers: Iterable[Any], t0: float, what: str, per: str, start: str
) -> str | None:
    """Message for the first prescribed number that is not finite at t0.

    per : "/s" for rates.   start : what would have to have the number.
    """
    for row, number in zip(rows, numbers, strict=True):
        each = np.atleast_1d(plain(number))
        for body, label in first_bad(what, ~np.isfinite(each)):
            unit = f"{'m' if row.is_translational else 'rad'}{per}"
            return (
                f"{label} that {row} prescribes is {each[body]} {unit} at t0={t0:g} s, and no "
                f"{start} has it; give a function that has a value there, or another t0"
            )
    return None


def unfit_constraint(
    rows: Rows, x: Kinematics, body: BodyConstants, label: Label, *, where: str = "",
    member: int | None = None,
) -> PoseError | None:  # fmt: skip
    """Error for the first user's constraint that is not finite at a pose, or whose derivative is.

    where : names of its links, for a mechanism.   member : the only member to check.
    """
    for row in filter(lambda row: isinstance(row, UserRow), rows):
        for what, number in _numbers_of(row, x, body):
            each = np.atleast_1d(plain(number))
            bad = np.flatnonzero(~np.isfinite(each))
            if member is not None and len(each) > 1:
                bad = bad[bad == member]
            for body_number in bad[:1].tolist():
                name = label(body_number if member is None else member)
                argument = name.partition("[")[0]
                return PoseError(
                    f"{what}{where} is {each[body_number]} at {name}; give another {argument}=, "
                    "where it is finite, or a function that is finite there"
                )
    return None


def _numbers_of(row: Row, x: Kinematics, body: BodyConstants) -> Iterator[tuple[str, Any]]:
    """Value and first derivatives of a user's constraint, each with its name in messages."""
    yield f"{row}", row.value(x, body)
    slope = f"the derivative of {row}" if row.is_holonomic else f"{row}"  # linear in the twist
    for number in row.jacobian(x, body):
        yield slope, number
