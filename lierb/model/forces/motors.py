"""Motors at joint axes: given torques, speeds and forces."""

from __future__ import annotations

import inspect
from dataclasses import dataclass
from typing import Any, ClassVar

from numpy.typing import ArrayLike

from lierb.errors import ArgumentError, ForceError, brief
from lierb.kernels.functions.function import Function
from lierb.kernels.functions.shapes import Shape, UserFunction
from lierb.kernels.functions.user_number import UserNumber
from lierb.kernels.mechanics.elements import Wrench
from lierb.kernels.mechanics.newton_euler import Kinematics, Motion
from lierb.kernels.mechanics.rows import AddedRow, HeldBody
from lierb.kernels.numbers.arithmetic import plain
from lierb.kernels.numbers.vec import UNIT, ZERO3, Vec
from lierb.kernels.numbers.zero import ZERO
from lierb.model.forces.built_in import BuiltIn, Parameter
from lierb.model.functions.tracing import DERIVATIVES, user_function
from lierb.model.functions.wrenches import Force

__all__ = ["motor"]


@dataclass(frozen=True)
class Motor(BuiltIn):
    """Torque about the joint axis: constant, or a function of time."""

    function: Function | None
    name = "motor"
    parameters: ClassVar = {"torque": Parameter("N m")}
    needs_axis: ClassVar = True

    def at(self, placed: Any, time: Any) -> Any:
        """Torque, force or speed at a time."""
        return placed[0] if self.function is None else self.function(placed, time)

    def wrench(self, placed: Any, x: Motion) -> Wrench:
        return (ZERO, ZERO, self.at(placed, x.time)), ZERO3


@dataclass(frozen=True)
class SlideMotor(Motor):
    """Force along the joint axis: constant, or a function of time."""

    parameters: ClassVar = {"force": Parameter("N")}
    needs_slide: ClassVar = True

    def wrench(self, placed: Any, x: Motion) -> Wrench:
        return ZERO3, (ZERO, ZERO, self.at(placed, x.time))


@dataclass(frozen=True)
class SpeedMotor(Motor):
    """Given speed about the joint axis, rad/s: a constraint row in place of a force."""

    parameters: ClassVar = {"speed": Parameter("rad/s")}
    rows: int = 1

    def wrench(self, placed: Any, x: Motion) -> Wrench:
        return ZERO3, ZERO3

    def row(self, place: int, i: int) -> AddedRow:
        return SpeedRow(self, place, i)


class SpeedRow(AddedRow):
    """Constraint row Ω₃ = w(t)."""

    is_holonomic = False
    fixed_axis = 2

    def __str__(self) -> str:
        return "motor"

    def jacobian(self, x: Kinematics, body: HeldBody) -> Vec:
        return UNIT[2] + ZERO3

    def acceleration(self, x: Kinematics, body: HeldBody) -> Any:
        """Exact derivative ẇ."""
        rate = self.element.at(self.placed(body), UserNumber(plain(x.time), (1.0,)))
        return rate.parts[0] if isinstance(rate, UserNumber) else ZERO

    def prescribed_rate(self, x: Kinematics, body: HeldBody) -> Any:
        return self.element.at(self.placed(body), x.time)


def motor(
    torque: ArrayLike | UserFunction | None = None,
    *,
    speed: ArrayLike | UserFunction | None = None,
    force: ArrayLike | UserFunction | None = None,
    **parameters: ArrayLike,
) -> Force:
    """Drive the joint axis by a torque or a speed about it, or by a force along it.

    One of `torque`, `speed` and `force` is given: a number, one for each body, or a function (t) or
    (t, params), or with a further argument `body`, with t in s. `lierb.wrench` describes what such
    a function may do. The joint must keep the axis e₃: revolute, cylindrical, screw, planar and the
    like.

    Parameters
    ----------
    torque : float, array_like of shape (n,), or callable, optional
        Torque about the axis, N m.
    speed : float, array_like of shape (n,), or callable, optional
        Speed about the axis, rad/s. It is a constraint of its own, which the twist at the start
        must satisfy; −λ of its row is the torque that the motor needs.
    force : float, array_like of shape (n,), or callable, optional
        Force along the axis, N. The joint must slide along e₃, such as prismatic.
    **parameters : float or array_like, shape (n,)
        Parameters of the function, by name.

    Returns
    -------
    Force
        Element for `Problem(forces=…)`.

    Examples
    --------
    >>> import lierb, math
    >>> lierb.forces.motor(lambda t, params: params.peak * math.sin(3.0 * t), peak=[0.1, 0.2])
    <motor: peak>
    """
    ways = {"torque": (torque, Motor), "speed": (speed, SpeedMotor), "force": (force, SlideMotor)}
    chosen = [(name, value, kind) for name, (value, kind) in ways.items() if value is not None]
    if len(chosen) != 1:
        raise ArgumentError("give torque= or speed= or force=, one of them")
    name, value, kind = chosen[0]
    if callable(value):
        if not inspect.isfunction(value):
            raise ForceError(
                f"expected a number or a function of (t) or (t, params), got {brief(value)}"
            )
        shapes: dict[str, Shape] = dict.fromkeys(parameters, ())
        because = None if speed is None else DERIVATIVES
        function = user_function(value, ("t",), shapes, ((),), because)
        return kind(function).force(**parameters)
    if parameters:
        raise ArgumentError(f"{', '.join(parameters)}: only a function takes parameters")
    return kind(None).force(**{name: value})
