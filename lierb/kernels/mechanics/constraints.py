"""The primitive rows of a joint, of which every joint is a list.

Rows act on D = (Q, d), the body's joint frame seen from the ground's:

    d1      d_i = 0                         screw   d₃ − pitch·φ = 0
    Qtd1    (Qᵀd)_i = 0                     rod     (d·d − length²)/(2 length) = 0
    Q32     Q_ij = 0                        cv      2z = 0: Q = R(w, x, y, z) has its axis ⊥ e₃
    Omega1  Ω_k = 0, a fixed axis, as a condition on velocity

Each has its value h, its Jacobian row (J V = ḣ, angular part first) and η of the acceleration
constraint J V̇ = η, so that η = −(ḧ at V̇ = 0).
"""

from __future__ import annotations

import re
from typing import Any, NamedTuple

from lierb.kernels.groups import quaternion, so3
from lierb.kernels.mechanics.newton_euler import BodyConstants, Kinematics
from lierb.kernels.numbers.arithmetic import PI, fma, rint, where
from lierb.kernels.numbers.trigonometry import atan2
from lierb.kernels.numbers.vec import (
    UNIT,
    ZERO3,
    Vec,
    axpy,
    column,
    cross,
    dot,
    mat_t_vec,
    norm,
    row,
    scale,
    sub,
)
from lierb.kernels.numbers.zero import ZERO

WHOLE_ROWS = ("screw", "rod", "cv")  # rows that act on no single component


class Row(NamedTuple):
    """One primitive row; axes count from 0."""

    kind: str
    i: int
    j: int = -1

    @classmethod
    def parse(cls, name: str) -> Row:
        """`d1`, `Qtd2`, `Q32`, `Omega3`, `screw`, `rod` or `cv`, axes counted from 1."""
        if name in WHOLE_ROWS:
            return cls(name, 2)
        match = re.fullmatch(r"(d|Qtd|Omega)([123])|(Q)([123])([123])", name)
        if match is None:
            raise ValueError(name)
        kind, axis, matrix, i, j = match.groups()
        return cls(matrix, int(i) - 1, int(j) - 1) if matrix else cls(kind, int(axis) - 1)

    @property
    def is_translational(self) -> bool:
        return self.kind in {"d", "Qtd", "screw", "rod"}

    @property
    def fixed_axis(self) -> int | None:
        """The body axis about which the row alone says how the body turns, if it does."""
        return self.i if self.kind == "Omega" else None

    @property
    def unit(self) -> str:
        """Unit of the row's multiplier."""
        return "N" if self.is_translational else "N m"

    def __str__(self) -> str:
        if self.kind in WHOLE_ROWS:
            return self.kind
        return self.kind + str(self.i + 1) + (str(self.j + 1) if self.j >= 0 else "")


class AddedRow(NamedTuple):
    """A row of another source than a joint: component `i` of element number `place`."""

    source: Any  # with jacobian, acceleration, value and rate, and a name for each component
    place: int
    i: int
    is_translational: bool
    kind: str = "added"

    @property
    def is_of_velocity(self) -> bool:
        """Whether it says nothing of the pose."""
        return not self.source.is_holonomic

    @property
    def fixed_axis(self) -> int | None:
        axis: int | None = self.source.fixed_axis
        return axis

    @property
    def unit(self) -> str:
        return "N" if self.is_translational else "N m"

    def __str__(self) -> str:
        return str(self.source.row_name(self.i))


Rows = tuple[Row | AddedRow, ...]


def jacobian(r: Row | AddedRow, x: Kinematics, body: BodyConstants) -> Vec:
    """The row of J, 6 numbers: angular, translational."""
    if isinstance(r, AddedRow):
        return r.source.jacobian(body.elements[r.place], x, r.i)
    if r.kind == "Omega":
        return UNIT[r.i] + ZERO3
    if r.kind == "Q":
        return cross(UNIT[r.j], row(x.q, r.i)) + ZERO3
    if r.kind == "cv":
        p = quaternion.of_matrix(x.q)
        return (-p[2], p[1], p[0]) + ZERO3
    if r.kind == "rod":
        direction = scale(1.0 / body.length, x.d)
        in_body = mat_t_vec(x.q, direction)
        return cross(x.arm, in_body) + x.translation(direction, in_body)
    if r.kind == "Qtd":
        direction = UNIT[r.i]
        arm = sub(x.arm, mat_t_vec(x.q, x.d))
        return cross(arm, direction) + x.translation(column(x.q, r.i), direction)
    direction = row(x.q, r.i)
    turning = cross(x.arm, direction)
    if r.kind == "screw":  # φ̇ = Ω₃, because Ω₁ = Ω₂ = 0
        turning = (turning[0], turning[1], turning[2] - body.pitch)
    return turning + x.translation(UNIT[r.i], direction)


def acceleration(r: Row | AddedRow, x: Kinematics, body: BodyConstants) -> Any:
    """η of the row."""
    if isinstance(r, AddedRow):
        return r.source.acceleration(body.elements[r.place], x, r.i)
    if r.kind == "Omega":
        return ZERO
    if r.kind == "Q":
        return -_bend(x, r.i, r.j)
    if r.kind == "cv":
        return 0.25 * dot(x.omega, x.omega) * value(r, x, body)
    if r.kind == "rod":
        bend = dot(x.point_rate, x.point_rate) + dot(mat_t_vec(x.q, x.d), x.point_bias)
        return -bend / body.length
    if r.kind == "Qtd":
        b = mat_t_vec(x.q, x.d)
        swing = cross(x.omega, b)
        rate = sub(x.point_rate, swing)
        return -dot(UNIT[r.i], sub(x.point_bias, cross(x.omega, axpy(2.0, rate, swing))))
    return -dot(row(x.q, r.i), x.point_bias)


def _bend(x: Kinematics, i: int, j: int) -> Any:
    """d²Q_ij/dt² at zero angular acceleration."""
    return dot(row(x.q, i), cross(x.omega, cross(x.omega, UNIT[j])))


def prescribed_rate(r: Row | AddedRow, x: Kinematics, body: BodyConstants) -> Any:
    """What J V has to be: zero, but for a motor's speed."""
    return r.source.rate(body.elements[r.place], x) if isinstance(r, AddedRow) else ZERO


def value(r: Row | AddedRow, x: Kinematics, body: BodyConstants) -> Any:
    """h of the row; an `Omega` row has none of its own (`rotation_error_squared` measures it)."""
    if isinstance(r, AddedRow):
        return r.source.value(body.elements[r.place], x, r.i)
    if r.kind == "d":
        return x.d[r.i]
    if r.kind == "Qtd":
        return mat_t_vec(x.q, x.d)[r.i]
    if r.kind == "Q":
        return x.q[3 * r.i + r.j]
    if r.kind == "cv":
        # not (Q₂₁ − Q₁₂)/2 = 2wz, which has no gradient at a half turn; of this J is a unit vector
        return 2.0 * quaternion.of_matrix(x.q)[3]
    if r.kind == "rod":  # ‖d‖ − length, to first order
        return 0.5 * (dot(x.d, x.d) / body.length - body.length)
    turn = 2.0 * PI * body.pitch
    slip = fma(-body.pitch, atan2(x.q[3], x.q[0]), x.d[2])
    turns = rint(slip / where(turn == 0.0, 1.0, turn))
    return fma(-turn, turns, slip)  # φ is known up to whole turns: the nearest is meant


def fixed_axes(rows: Rows) -> list[int]:
    """The axes about which `Omega` rows forbid to turn."""
    return sorted({r.i for r in rows if r.kind == "Omega"})


def held_axes(rows: Rows) -> list[int]:
    """The joint axes that `Omega` rows keep parallel."""
    fixed = fixed_axes(rows)
    return {2: [3 - sum(fixed)], 3: [0, 1, 2]}.get(len(fixed), [])


def residuals(rows: Rows, x: Kinematics, body: BodyConstants) -> list[Any]:
    """h of every row; of `Omega` rows by how much, rad, the body has turned about their axes."""
    fixed = fixed_axes(rows)
    if len(fixed) == 3:
        turns = dict(enumerate(so3.log(x.q)))
    elif len(fixed) == 2:
        turns = _tilt(x.q, 3 - sum(fixed))
    return [turns[r.i] if r.kind == "Omega" else value(r, x, body) for r in rows]


def _tilt(q: Vec, axis: int) -> dict[int, Any]:
    """The turn that has taken an axis of the body from the ground's, about the two other ones."""
    i, j = (axis + 1) % 3, (axis + 2) % 3
    seen = row(q, axis)  # the ground's axis, in body axes
    sine = norm((seen[i], seen[j]))
    stretch = atan2(sine, seen[axis]) / where(sine == 0.0, 1.0, sine)
    return {i: stretch * seen[j], j: -stretch * seen[i]}


def _squares(numbers: list[Any]) -> Any:
    total: Any = ZERO
    for x in numbers:
        total = fma(x, x, total)
    return total


def position_error_squared(rows: Rows, x: Kinematics, body: BodyConstants) -> Any:
    return _squares([value(r, x, body) for r in rows if r.is_translational])


def rotation_error_squared(rows: Rows, x: Kinematics, body: BodyConstants) -> Any:
    """Of `Q` and `cv` rows; and for `Omega` rows, how far Q is from a turn about the free axis."""
    entries = [
        value(r, x, body)
        for r in rows
        if r.kind in ("Q", "cv") or (r.kind == "added" and not r.is_translational)
    ]
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


def rate_errors_squared(
    rows: Rows, x: Kinematics, body: BodyConstants, velocity: Vec
) -> tuple[Any, Any]:
    """Squares of the translational and of the rotational rows of J V, less what is prescribed."""
    rates = [
        (r.is_translational, dot(jacobian(r, x, body), velocity) - prescribed_rate(r, x, body))
        for r in rows
    ]
    return (
        _squares([rate for translational, rate in rates if translational]),
        _squares([rate for translational, rate in rates if not translational]),
    )
