"""Motions in the users' frames, and numbers with derivatives in time, for users' functions."""

from __future__ import annotations

from typing import Any, NamedTuple

from lierb.kernels.functions.user_number import UserNumber
from lierb.kernels.mechanics.newton_euler import Frames, Motion, Pose, Wrench
from lierb.kernels.numbers.arithmetic import plain
from lierb.kernels.numbers.dual import Dual
from lierb.kernels.numbers.vec import (
    ZERO3,
    Mat,
    Vec,
    add,
    cross,
    cross_add,
    mat_mat,
    mat_mat_t,
    mat_t_vec,
    mat_vec,
    mat_vec_add,
)
from lierb.kernels.numbers.zero import ZERO


class UserFrame(NamedTuple):
    """Transformation from joint axes back to the user's frames."""

    ground: Pose
    axes: Mat  # the joint's axes in the user's body frame
    origin: Vec  # origin of the user's body frame from the joint's point, in body axes

    @classmethod
    def of(cls, frames: Frames) -> UserFrame:
        return cls(frames.ground, frames.axes, frames.body_point(ZERO3))

    def pose(self, q: Mat, place: Vec) -> Pose:
        """Return (R, r) of a pose in joint axes."""
        ground, ground_origin = self.ground
        r = mat_mat(ground, mat_mat_t(q, self.axes))
        return r, add(ground_origin, mat_vec(ground, mat_vec_add(q, self.origin, place)))

    def twist(self, omega: Vec, v: Vec) -> tuple[Vec, Vec]:
        moving = cross_add(omega, self.origin, v)
        return mat_vec(self.axes, omega), mat_vec(self.axes, moving)

    def felt(self, x: Motion) -> tuple[Vec, Vec]:
        """Return ω̇ and the specific force at the user's origin, in the user's body axes."""
        turning, point = x.felt[:3], x.felt[3:]
        swing = cross(x.omega, cross(x.omega, self.origin))
        moving = cross_add(turning, self.origin, add(point, swing))
        return mat_vec(self.axes, turning), mat_vec(self.axes, moving)

    def to_joint_axes(self, torque: Vec, force: Vec) -> Wrench:
        pull = mat_t_vec(self.axes, force)
        return cross_add(self.origin, pull, mat_t_vec(self.axes, torque)), pull


def moving(values: Vec, rates: Vec) -> Vec:
    """Numbers with their first derivatives."""
    return tuple(UserNumber(plain(x), (rate,)) for x, rate in zip(values, rates, strict=True))


def second(value: Any, rate: Any, bend: Any) -> UserNumber:
    """A number with its first and second derivative."""
    return UserNumber(UserNumber(plain(value), (rate,)), (UserNumber(plain(rate), (bend,)),))


def slope_of(number: Any) -> Any:
    """Return the derivative of a number with one derivative, or of a constant."""
    return number.parts[0] if isinstance(number, UserNumber) and number.parts else ZERO


def constant_in_time(numbers: tuple[Any, ...]) -> tuple[Any, ...]:
    """Return numbers without the derivatives of `second`; they keep those by parameters."""
    return tuple(
        constant_in_time(x) if isinstance(x, tuple)
        else UserNumber(UserNumber(x)) if isinstance(x, Dual)
        else x
        for x in numbers
    )  # fmt: skip
