"""The primitive rows of a joint, of which every joint is a list.

Rows act on D = (Q, d), the body's joint frame seen from the ground's: `d1` d_i = 0, `Qtd1`
(Qᵀd)_i = 0, `Q32` Q_ij = 0, `Omega1` Ω_k = 0 (a fixed axis, as a condition on velocity), `screw`
d₃ − pitch·φ = 0. Each has its value h, its Jacobian row (J V = ḣ, angular part first) and η of the
acceleration constraint J V̇ = η, so that η = −(ḧ at V̇ = 0). `solving_rows` has a kind of its own,
`point`: the rows d1 d2 d3, turned to body axes.
"""

from __future__ import annotations

import re
from typing import Any, NamedTuple

from lierb.kernels.arithmetic import PI, fma, rint, where
from lierb.kernels.coefficients import atan2
from lierb.kernels.newton_euler import Kinematics
from lierb.kernels.vec import (
    UNIT,
    ZERO3,
    Vec,
    axpy,
    column,
    cross,
    dot,
    mat_t_vec,
    mat_vec,
    row,
    sub,
)
from lierb.kernels.zero import ZERO


class Row(NamedTuple):
    """One primitive row; axes count from 0."""

    kind: str
    i: int
    j: int = -1

    @classmethod
    def parse(cls, name: str) -> Row:
        """`d1`, `Qtd2`, `Q32`, `Omega3` or `screw`, axes counted from 1."""
        if name == "screw":
            return cls("screw", 2)
        match = re.fullmatch(r"(d|Qtd|Omega)([123])|(Q)([123])([123])", name)
        if match is None:
            raise ValueError(name)
        kind, axis, matrix, i, j = match.groups()
        return cls(matrix, int(i) - 1, int(j) - 1) if matrix else cls(kind, int(axis) - 1)

    @property
    def is_translational(self) -> bool:
        return self.kind in {"d", "Qtd", "screw"}

    @property
    def unit(self) -> str:
        """Unit of the row's multiplier."""
        return "N" if self.is_translational else "N m"

    def __str__(self) -> str:
        if self.kind == "screw":
            return "screw"
        return self.kind + str(self.i + 1) + (str(self.j + 1) if self.j >= 0 else "")


def jacobian(r: Row, x: Kinematics, pitch: Any) -> Vec:
    """The row of J, 6 numbers: angular, translational."""
    if r.kind == "Omega":
        return UNIT[r.i] + ZERO3
    if r.kind == "Q":
        return cross(UNIT[r.j], row(x.q, r.i)) + ZERO3
    if r.kind == "point":
        return cross(x.arm, UNIT[r.i]) + x.translation(column(x.q, r.i), UNIT[r.i])
    if r.kind == "Qtd":
        direction = UNIT[r.i]
        arm = sub(x.arm, mat_t_vec(x.q, x.d))
        return cross(arm, direction) + x.translation(column(x.q, r.i), direction)
    direction = row(x.q, r.i)
    turning = cross(x.arm, direction)
    if r.kind == "screw":  # φ̇ = Ω₃, because Ω₁ = Ω₂ = 0
        turning = (turning[0], turning[1], turning[2] - pitch)
    return turning + x.translation(UNIT[r.i], direction)


def acceleration(r: Row, x: Kinematics) -> Any:
    """η of the row."""
    if r.kind == "Omega":
        return ZERO
    if r.kind == "Q":
        return -dot(row(x.q, r.i), cross(x.omega, cross(x.omega, UNIT[r.j])))
    if r.kind == "Qtd":
        b = mat_t_vec(x.q, x.d)
        swing = cross(x.omega, b)
        rate = sub(x.point_rate, swing)
        return -dot(UNIT[r.i], sub(x.point_bias, cross(x.omega, axpy(2.0, rate, swing))))
    if r.kind == "point":
        return -x.point_bias[r.i]
    return -dot(row(x.q, r.i), x.point_bias)


def value(r: Row, x: Kinematics, pitch: Any) -> Any:
    """h of the row; an `Omega` row has none of its own (`rotation_error_squared` measures it)."""
    if r.kind == "d":
        return x.d[r.i]
    if r.kind == "Qtd":
        return mat_t_vec(x.q, x.d)[r.i]
    if r.kind == "Q":
        return x.q[3 * r.i + r.j]
    turn = 2.0 * PI * pitch
    slip = fma(-pitch, atan2(x.q[3], x.q[0]), x.d[2])
    turns = rint(slip / where(turn == 0.0, 1.0, turn))
    return fma(-turn, turns, slip)  # φ is known up to whole turns: the nearest is meant


# ---- the rows as they are solved ---------------------------------------------------------------

POINT = tuple(Row("point", i) for i in range(3))  # Qᵀ times the rows d1 d2 d3: their body axes
HELD = tuple(Row("d", i) for i in range(3))


def solving_rows(rows: tuple[Row, ...]) -> tuple[Row, ...]:
    """The same constraints as rows of which as many as can be are constant, and those first.

    In body axes M is constant, and so are `Omega` rows and rows that hold a point. What is made of
    them alone does not depend on the pose: the compiler takes it out of the loop over steps.
    """
    held = POINT if set(HELD) <= set(rows) else ()
    fixed = tuple(r for r in rows if r.kind == "Omega")
    return (*fixed, *held, *(r for r in rows if r not in fixed and not (held and r in HELD)))


def given_multipliers(
    rows: tuple[Row, ...], solved: tuple[Row, ...], multipliers: tuple[Any, ...], q: Any
) -> tuple[Any, ...]:
    """λ of the joint's own rows, in their order, from that of its `solving_rows`."""
    found = dict(zip(solved, multipliers, strict=True))
    if POINT[0] in found:
        found |= zip(HELD, mat_vec(q, tuple(found[r] for r in POINT)), strict=True)
    return tuple(found[r] for r in rows)


def _squares(numbers: list[Any]) -> Any:
    total: Any = ZERO
    for x in numbers:
        total = fma(x, x, total)
    return total


def position_error_squared(rows: tuple[Row, ...], x: Kinematics, pitch: Any) -> Any:
    return _squares([value(r, x, pitch) for r in rows if r.is_translational])


def rotation_error_squared(rows: tuple[Row, ...], x: Kinematics) -> Any:
    """Of the `Q` rows; and for `Omega` rows, how far Q is from a turn about the axis left free."""
    entries = [x.q[3 * r.i + r.j] for r in rows if r.kind == "Q"]
    fixed = sorted({r.i for r in rows if r.kind == "Omega"})
    if len(fixed) == 2:
        axis = 3 - sum(fixed)
        entries += [x.q[3 * i + axis] for i in fixed]
    total = _squares(entries)
    if len(fixed) == 3:
        total = fma(
            0.5, _squares([x.q[3 * i + j] for i in range(3) for j in range(3) if i != j]), total
        )
    return total


def rate_errors_squared(
    rows: tuple[Row, ...], x: Kinematics, pitch: Any, velocity: Vec
) -> tuple[Any, Any]:
    """Squares of the translational and of the rotational rows of J V."""
    rates = [(r.is_translational, dot(jacobian(r, x, pitch), velocity)) for r in rows]
    return (
        _squares([rate for translational, rate in rates if translational]),
        _squares([rate for translational, rate in rates if not translational]),
    )
