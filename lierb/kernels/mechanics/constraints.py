"""Constraint residuals of all rows of a joint, and errors of their rates."""

from __future__ import annotations

from lierb.kernels.groups import so3
from lierb.kernels.mechanics.newton_euler import Kinematics
from lierb.kernels.mechanics.rows import HeldBody, Rows, fixed_axes
from lierb.kernels.numbers.arithmetic import fma, where
from lierb.kernels.numbers.number import Number
from lierb.kernels.numbers.trigonometry import atan2
from lierb.kernels.numbers.vec import Vec, dot, norm, row
from lierb.kernels.numbers.zero import ZERO


def holds_a_point(rows: Rows) -> bool:
    """Return whether the rows fix the joint's point in all directions."""
    return {0, 1, 2} <= {r.held_axis for r in rows if r.is_of_joint}


def held_axes(rows: Rows) -> list[int]:
    """Return the joint axes that `Omega` rows keep parallel."""
    fixed = fixed_axes(rows)
    return {2: [3 - sum(fixed)], 3: [0, 1, 2]}.get(len(fixed), [])


def residuals(rows: Rows, x: Kinematics, body: HeldBody) -> list[Number]:
    """Value h of every row; for an `Omega` row, the body's angle about its axis, rad."""
    fixed = fixed_axes(rows)
    turns: dict[int | None, Number] = {}
    if len(fixed) == 3:
        turns = dict(enumerate(so3.log(x.q)))
    elif len(fixed) == 2:
        turns = _tilt(x.q, 3 - sum(fixed))
    return [r.value(x, body) if r.has_value else turns[r.fixed_axis] for r in rows]


def smooth_residuals(rows: Rows, x: Kinematics, body: HeldBody) -> list[Number]:
    """Return the value h of every row, with the gradient J wherever all are zero.

    That of an `Omega` row is an entry of Q, or for three such rows of its skew part.
    """
    fixed = fixed_axes(rows)
    values: dict[int | None, Number] = {}
    for i in fixed:
        j, k = (i + 1) % 3, (i + 2) % 3
        if len(fixed) == 3:
            values[i] = 0.5 * (x.q[3 * k + j] - x.q[3 * j + k])
        else:  # the axis that the rows keep is k, or j
            values[i] = x.q[3 * k + j] if k not in fixed else -x.q[3 * j + k]
    return [r.value(x, body) if r.has_value else values[r.fixed_axis] for r in rows]


def _tilt(q: Vec, axis: int) -> dict[int | None, Number]:
    """Angles, rad, between a body's axis and the ground's, about each of the two other axes."""
    i, j = (axis + 1) % 3, (axis + 2) % 3
    ground_axis = row(q, axis)  # in body axes
    sine = norm((ground_axis[i], ground_axis[j]))
    factor = atan2(sine, ground_axis[axis]) / where(sine == 0.0, 1.0, sine)
    return {i: factor * ground_axis[j], j: -factor * ground_axis[i]}


def _squares(numbers: list[Number]) -> Number:
    total: Number = ZERO
    for x in numbers:
        total = fma(x, x, total)
    return total


def position_error_squared(rows: Rows, x: Kinematics, body: HeldBody) -> Number:
    return _squares([r.value(x, body) for r in rows if r.is_translational])


def rotation_error_squared(rows: Rows, x: Kinematics, body: HeldBody) -> Number:
    """Square of the values of rotational rows, and of Q's entries that `Omega` rows zero."""
    entries = [r.value(x, body) for r in rows if r.has_value and not r.is_translational]
    fixed = fixed_axes(rows)
    if len(fixed) == 2:
        axis = 3 - sum(fixed)
        entries += [x.q[3 * i + axis] for i in fixed]
    total = _squares(entries)
    if len(fixed) == 3:
        total = fma(
            0.5, _squares([x.q[3 * i + j] for i in range(3) for j in range(3) if i != j]), total
        )
    return total


def rate_errors(rows: Rows, x: Kinematics, body: HeldBody, velocity: Vec) -> list[Number]:
    """J V − prescribed rate of every row."""
    return [dot(r.jacobian(x, body), velocity) - r.prescribed_rate(x, body) for r in rows]


def rate_errors_squared(
    rows: Rows, x: Kinematics, body: HeldBody, velocity: Vec
) -> tuple[Number, Number]:
    """Sums of the squares of J V − prescribed rate, over translational and rotational rows."""
    return squares_by_kind(rows, rate_errors(rows, x, body, velocity))


def errors_squared(
    rows: Rows, x: Kinematics, body: HeldBody, rates: list[Number]
) -> tuple[Number, ...]:
    """Squares of the errors of position, rotation and their rates; `rates` are `rate_errors`."""
    of_rates = squares_by_kind(rows, rates)
    position = position_error_squared(rows, x, body)
    return position, rotation_error_squared(rows, x, body), *of_rates


def squares_by_kind(rows: Rows, numbers: list[Number]) -> tuple[Number, Number]:
    """Sums of the squares of the rows' numbers, over translational and rotational rows."""
    pairs = [*zip(rows, numbers, strict=True)]
    return (
        _squares([x for r, x in pairs if r.is_translational]),
        _squares([x for r, x in pairs if not r.is_translational]),
    )
