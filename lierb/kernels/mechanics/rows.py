"""Rows of the constraint Jacobian: one class for each kind of row.

The primitive rows of a joint act on D = (Q, d), the body's joint frame in the ground's joint frame.
A row has a value h, a row of J (J V = ḣ, angular part first), and the right-hand side η of the
acceleration constraint J V̇ = η, with η = −ḧ at V̇ = 0.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product, starmap
from typing import Any, ClassVar, Protocol

from lierb.kernels.groups import quaternion
from lierb.kernels.mechanics.newton_euler import Kinematics
from lierb.kernels.numbers.arithmetic import PI, fma, rint, where
from lierb.kernels.numbers.number import Number
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
    row,
    scale,
    sub,
)
from lierb.kernels.numbers.zero import ZERO

FIXED = -1  # slot of a component of V that is zero
PITCHED = -2  # slot of v₃ = pitch·ω₃


class HeldBody(Protocol):
    """Parameters of rows; a body has them, or a pair of frames in a mechanism."""

    @property
    def pitch(self) -> Number: ...
    @property
    def length(self) -> Number: ...
    @property
    def elements(self) -> tuple[Any, ...]: ...


class Row:
    """One scalar constraint.

    is_translational : True if h is a length, an error of position, and λ a force.
    is_holonomic : True if the row constrains the pose.
    has_value : True if h can be computed from this row alone.
    is_of_joint : True for a row of the joint, which depends on D alone.
    depends_on_time : True for a row of a motor, whose position or rate is a function of time.
    second : part of the row at a second joint, for a row that couples two; then J V is a sum.
    parameters : joint parameters of the row, with their units.
    """

    is_translational: bool = False
    is_holonomic: bool = True
    has_value: bool = True
    is_of_joint: bool = True
    depends_on_time: bool = False
    second: Row | None = None
    parameters: ClassVar[dict[str, str]] = {}

    @property
    def unit(self) -> str:
        """Unit of the multiplier."""
        return "N" if self.is_translational else "N m"

    @property
    def error_kind(self) -> str:
        return "position" if self.is_translational else "rotation"

    @property
    def held_axis(self) -> int | None:
        """Ground axis along which this row alone fixes the joint's point, or None."""
        return None

    @property
    def fixed_axis(self) -> int | None:
        """Body axis about which this row alone fixes the rotation, or None."""
        return None

    @property
    def holds_slide(self) -> bool:
        """Return whether the row prevents sliding along e₃, in a joint that keeps e₃."""
        return self.held_axis == 2

    @property
    def holds_turn(self) -> bool:
        """Return whether the row prevents turning about e₃, in a joint that keeps e₃."""
        return self.fixed_axis == 2

    @property
    def slot(self) -> tuple[int, int] | None:
        """Component of (ω, v) and its slot in the algebra of a subgroup joint."""
        axis = self.fixed_axis if self.held_axis is None else 3 + self.held_axis
        return None if axis is None else (axis, FIXED)

    def value(self, x: Kinematics, body: HeldBody) -> Number:
        """Value h."""
        return ZERO

    def jacobian(self, x: Kinematics, body: HeldBody) -> Vec:
        """Row of J, (6,): angular part, translational part."""
        raise NotImplementedError

    def acceleration(self, x: Kinematics, body: HeldBody) -> Number:
        """Right-hand side η."""
        return ZERO

    def prescribed_rate(self, x: Kinematics, body: HeldBody) -> Number:
        """Prescribed value of J V."""
        return ZERO

    def prescribed_slope(self, x: Kinematics, body: HeldBody) -> Number:
        """Derivative of the prescribed rate by time."""
        return ZERO

    def prescribed_place(self, x: Kinematics, body: HeldBody) -> Number:
        """Prescribed coordinate of a row that depends on time."""
        return ZERO


Rows = tuple[Row, ...]


def fixed_axes(rows: Rows) -> tuple[int, ...]:
    """Return the body axes about which rows prevent turning, in order."""
    axes = {r.fixed_axis for r in rows if r.is_of_joint and r.fixed_axis is not None}
    return tuple(sorted(axes))


def keeps_axis(rows: Rows) -> bool:
    """Return whether the body's e₃ stays parallel to the ground's e₃."""
    return {0, 1} <= {*fixed_axes(rows)}


def turns(rows: Rows) -> bool:
    """Return whether a joint that keeps e₃ turns about it."""
    return not (any(r.holds_turn for r in rows) or (_is_screw(rows) and _holds_slide(rows)))


def slides(rows: Rows) -> bool:
    """Return whether a joint that keeps e₃ slides along it."""
    return not (_holds_slide(rows) or (_is_screw(rows) and any(r.holds_turn for r in rows)))


def _holds_slide(rows: Rows) -> bool:
    return any(r.holds_slide for r in rows)


def _is_screw(rows: Rows) -> bool:
    """Return whether the joint turns in proportion as it slides."""
    return any(isinstance(r, Screw) for r in rows)


def parameters_of(rows: Rows) -> dict[str, str]:
    """Return the parameters of a joint's rows, with their units."""
    return {name: unit for row in rows for name, unit in row.parameters.items()}


# ---- rows of joints ----------------------------------------------------------------------------


JOINT_ROWS: dict[str, JointRow] = {}  # all primitive rows, by name


@dataclass(frozen=True)
class JointRow(Row):
    """A primitive row. Axes i, j are numbered from 0; in the row's name, from 1."""

    i: int = -1
    j: int = -1
    symbol: ClassVar[str]
    axis_count: ClassVar[int] = 1

    def __init_subclass__(cls) -> None:
        for made in starmap(cls, product(range(3), repeat=cls.axis_count)):
            JOINT_ROWS[str(made)] = made

    def __str__(self) -> str:
        return self.symbol + "".join(str(axis + 1) for axis in (self.i, self.j) if axis >= 0)

    def objection(self, rows: Rows) -> str | None:
        """Return why the row cannot be combined with these rows, as in "has …"; None if it can."""
        return None


class Point(JointRow):
    """d_i = 0: the body's point stays in a plane of the ground."""

    symbol = "d"
    is_translational = True

    @property
    def held_axis(self) -> int:
        return self.i

    def value(self, x: Kinematics, body: HeldBody) -> Number:
        return x.d[self.i]

    def jacobian(self, x: Kinematics, body: HeldBody) -> Vec:
        direction = row(x.q, self.i)
        return cross(x.arm, direction) + x.translation(UNIT[self.i], direction)

    def acceleration(self, x: Kinematics, body: HeldBody) -> Number:
        return -dot(row(x.q, self.i), x.point_bias)


class GroundPoint(JointRow):
    """(Qᵀd)_i = 0: the ground's point stays in a plane of the body."""

    symbol = "Qtd"
    is_translational = True

    @property
    def holds_slide(self) -> bool:
        return self.i == 2

    def value(self, x: Kinematics, body: HeldBody) -> Number:
        return mat_t_vec(x.q, x.d)[self.i]

    def jacobian(self, x: Kinematics, body: HeldBody) -> Vec:
        direction = UNIT[self.i]
        arm = sub(x.arm, mat_t_vec(x.q, x.d))
        return cross(arm, direction) + x.translation(column(x.q, self.i), direction)

    def acceleration(self, x: Kinematics, body: HeldBody) -> Number:
        b = mat_t_vec(x.q, x.d)
        swing = cross(x.omega, b)
        rate = sub(x.point_rate, swing)
        bend = sub(x.point_bias, cross(x.omega, axpy(2.0, rate, swing)))
        return -dot(UNIT[self.i], bend)


class Turning(JointRow):
    """Ω_i = 0: a fixed axis, as a condition on velocity."""

    symbol = "Omega"
    has_value = False

    @property
    def fixed_axis(self) -> int:
        return self.i

    def objection(self, rows: Rows) -> str | None:
        alone = len(fixed_axes(rows)) == 1
        return "has one Omega row alone; expected two, three or none" if alone else None

    def jacobian(self, x: Kinematics, body: HeldBody) -> Vec:
        return UNIT[self.i] + ZERO3


class Cosine(JointRow):
    """Q_ij = 0: an axis of the body stays perpendicular to one of the ground."""

    symbol = "Q"
    axis_count = 2

    @property
    def holds_turn(self) -> bool:
        return self.i < 2 and self.j < 2

    def value(self, x: Kinematics, body: HeldBody) -> Number:
        return x.q[3 * self.i + self.j]

    def jacobian(self, x: Kinematics, body: HeldBody) -> Vec:
        return cross(UNIT[self.j], row(x.q, self.i)) + ZERO3

    def acceleration(self, x: Kinematics, body: HeldBody) -> Number:
        return -dot(row(x.q, self.i), cross(x.omega, cross(x.omega, UNIT[self.j])))


class Screw(JointRow):
    """d₃ − pitch·φ = 0, in a joint that keeps e₃."""

    symbol = "screw"
    axis_count = 0
    is_translational = True
    parameters: ClassVar = {"pitch": "m/rad"}
    slot = (5, PITCHED)

    def objection(self, rows: Rows) -> str | None:
        kept = keeps_axis(rows)
        return None if kept else "has a screw row whose axis may tilt; add Omega1 and Omega2"

    def value(self, x: Kinematics, body: HeldBody) -> Number:
        turn = 2.0 * PI * body.pitch
        slip = fma(-body.pitch, atan2(x.q[3], x.q[0]), x.d[2])
        turns = rint(slip / where(turn == 0.0, 1.0, turn))
        return fma(-turn, turns, slip)  # φ is determined up to whole turns; the nearest is taken

    def jacobian(self, x: Kinematics, body: HeldBody) -> Vec:
        sliding = Point(2).jacobian(x, body)
        # φ̇ = Ω₃, because Ω₁ = Ω₂ = 0
        return (*sliding[:2], sliding[2] - body.pitch, *sliding[3:])

    def acceleration(self, x: Kinematics, body: HeldBody) -> Number:
        return Point(2).acceleration(x, body)


class Rod(JointRow):
    """(d·d − length²)/(2 length) = 0: ‖d‖ − length, to first order."""

    symbol = "rod"
    axis_count = 0
    is_translational = True
    parameters: ClassVar = {"length": "m"}

    def objection(self, rows: Rows) -> str | None:
        held = any(r.is_translational and r != self for r in rows)
        return "has a rod beside rows that hold its end in another way" if held else None

    def value(self, x: Kinematics, body: HeldBody) -> Number:
        return 0.5 * (dot(x.d, x.d) / body.length - body.length)

    def jacobian(self, x: Kinematics, body: HeldBody) -> Vec:
        direction = scale(1.0 / body.length, x.d)
        in_body = mat_t_vec(x.q, direction)
        return cross(x.arm, in_body) + x.translation(direction, in_body)

    def acceleration(self, x: Kinematics, body: HeldBody) -> Number:
        bend = dot(x.point_rate, x.point_rate) + dot(mat_t_vec(x.q, x.d), x.point_bias)
        return -bend / body.length


class ConstantVelocity(JointRow):
    """2z = 0: Q = R(w, x, y, z) has its axis ⊥ e₃."""

    symbol = "cv"
    axis_count = 0
    holds_turn = True

    def value(self, x: Kinematics, body: HeldBody) -> Number:
        # (Q₂₁ − Q₁₂)/2 = 2wz has no gradient at a half turn; that of 2z is a unit vector
        return 2.0 * quaternion.of_matrix(x.q)[3]

    def jacobian(self, x: Kinematics, body: HeldBody) -> Vec:
        p = quaternion.of_matrix(x.q)
        return (-p[2], p[1], p[0]) + ZERO3

    def acceleration(self, x: Kinematics, body: HeldBody) -> Number:
        return 0.25 * dot(x.omega, x.omega) * self.value(x, body)


# ---- rows of elements --------------------------------------------------------------------------


@dataclass(frozen=True)
class AddedRow(Row):
    """Row `i` of the element at index `place`: a motor's motion, or a user's constraint."""

    element: Any
    place: int
    i: int
    is_of_joint = False

    def placed(self, body: HeldBody) -> Any:
        """Parameters of the element in joint axes."""
        return body.elements[self.place]
