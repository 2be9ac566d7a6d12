"""Users' constraints on poses and on velocities, and their rows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from lierb.kernels.functions.elementary import constraint
from lierb.kernels.functions.function import Function
from lierb.kernels.functions.user_number import UserNumber
from lierb.kernels.mechanics.elements import Element
from lierb.kernels.mechanics.newton_euler import Frames, Kinematics
from lierb.kernels.mechanics.rows import AddedRow, HeldBody
from lierb.kernels.mechanics.user_frames import (
    UserFrame,
    constant_in_time,
    moving,
    second,
    slope_of,
)
from lierb.kernels.numbers.arithmetic import plain
from lierb.kernels.numbers.vec import (
    ZERO3,
    ZERO6,
    Vec,
    add,
    cross,
    cross_add,
    mat_vec,
    row,
    sub,
    units,
)
from lierb.kernels.numbers.zero import ZERO


@dataclass(frozen=True)
class UserConstraint(Element):
    """User's constraint h(R, r) = 0."""

    does_work: ClassVar = False
    function: Function
    rows: int = 1
    is_translational: bool = True

    def row(self, place: int, i: int) -> AddedRow:
        return UserRow(self, place, i)

    def placed(self, given: dict[str, Any], frames: Frames) -> tuple[Any, ...]:
        return UserFrame.of(frames), tuple(given.values())


class UserRow(AddedRow):
    """Row of a user's constraint; dual numbers give its J and η."""

    @property
    def is_translational(self) -> bool:  # type: ignore[override]
        return bool(self.element.is_translational)

    def __str__(self) -> str:
        return self.element.function.name + (str(self.i + 1) if self.element.rows > 1 else "")

    def _given(self, body: HeldBody) -> tuple[UserFrame, tuple[Any, ...]]:
        """Return the user's frames, and the parameters of the function."""
        frame, parameters = self.placed(body)
        return UserFrame(*frame), parameters

    def _of(self, parameters: tuple[Any, ...], *motion: Any) -> Any:
        with constraint():
            return self.element.function(parameters, *motion)[self.i]

    def _along_twists(self, x: Kinematics, frame: UserFrame, number: Any) -> Vec:
        """Return the row of J from the number's derivatives along the unit twists of the user."""
        slope = number.parts if isinstance(number, UserNumber) and number.parts else ZERO6
        torque, force = frame.to_joint_axes(slope[:3], slope[3:])
        return cross_add(x.arm, force, torque) + x.translation(mat_vec(x.q, force), force)

    def value(self, x: Kinematics, body: HeldBody) -> Any:
        frame, parameters = self._given(body)
        h = self._of(parameters, *frame.pose(x.q, x.d))
        return h.value if isinstance(h, UserNumber) else h

    def jacobian(self, x: Kinematics, body: HeldBody) -> Vec:
        """Derivative along the six unit twists, Ṙ = R ω̂ and ṙ = R v in the user's body axes."""
        frame, parameters = self._given(body)
        r, place = frame.pose(x.q, x.d)
        entries = []
        for axis in range(3):
            a, b, c = row(r, axis)
            for entry, turning in ((a, (ZERO, -c, b)), (b, (c, ZERO, -a)), (c, (-b, a, ZERO))):
                entries.append(UserNumber(entry, turning + ZERO3))
        places = [UserNumber(place[axis], ZERO3 + row(r, axis)) for axis in range(3)]
        h = self._of(parameters, tuple(entries), tuple(places))
        return self._along_twists(x, frame, h)

    def acceleration(self, x: Kinematics, body: HeldBody) -> Any:
        """Return η = −ḧ at V̇ = 0, where R̈ = R ω̂²."""
        frame, parameters = self._given(body)
        r, place = frame.pose(x.q, x.d)
        omega, v = frame.twist(x.omega, x.point_rate)
        swing = cross(x.omega, cross(x.omega, frame.origin))
        entries = []
        for axis in range(3):
            along = row(r, axis)
            rate = cross(along, omega)  # (aᵀ ω̂)ᵀ = a×ω
            entries += [second(*xs) for xs in zip(along, rate, cross(rate, omega), strict=True)]
        bend = mat_vec(r, mat_vec(frame.axes, add(x.point_bias, swing)))
        places = [second(*xs) for xs in zip(place, mat_vec(r, v), bend, strict=True)]
        h = self._of(constant_in_time(parameters), tuple(entries), tuple(places))
        return -slope_of(slope_of(h))


@dataclass(frozen=True)
class UserVelocityConstraint(UserConstraint):
    """User's constraint g(R, r, ω, v) = 0, linear in ω and v."""

    def row(self, place: int, i: int) -> AddedRow:
        return UserVelocityRow(self, place, i)


class UserVelocityRow(UserRow):
    """Row of a user's constraint on velocities; dual numbers give its J and η."""

    is_holonomic = False

    def value(self, x: Kinematics, body: HeldBody) -> Any:
        return ZERO

    def jacobian(self, x: Kinematics, body: HeldBody) -> Vec:
        """Derivatives by ω and v, in the user's body axes."""
        frame, parameters = self._given(body)
        pose, zero = frame.pose(x.q, x.d), 0.0 * plain(x.q[0])
        twist = tuple(UserNumber(zero, unit) for unit in units(6))
        return self._along_twists(x, frame, self._of(parameters, *pose, twist[:3], twist[3:]))

    def acceleration(self, x: Kinematics, body: HeldBody) -> Any:
        """Return η = −ġ at ω̇ = 0 and at the acceleration of the point at V̇ = 0."""
        frame, parameters = self._given(body)
        r, place = frame.pose(x.q, x.d)
        omega, v = frame.twist(x.omega, x.point_rate)
        turning = sum((cross(row(r, i), omega) for i in range(3)), start=())  # Ṙ = R ω̂
        # the components of v in turning axes: v̇ = Qᵀd̈ − ω × v
        change = mat_vec(frame.axes, sub(x.point_bias, cross(x.omega, x.point_rate)))
        pose = moving(r, turning), moving(place, mat_vec(r, v))
        return -slope_of(self._of(parameters, *pose, moving(omega, ZERO3), moving(v, change)))
