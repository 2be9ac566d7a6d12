"""Motors at joint axes: prescribed torques, speeds and forces."""

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
        """Torque, force or speed at a time, s."""
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
    """Prescribed speed about the joint axis, rad/s: a constraint row instead of a force."""

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

    Exactly one of `torque`, `speed` and `force` must be given: a number, one number for each body,
    or a function of (t) or (t, params), t in s, or with a further argument `body`. `lierb.wrench`
    describes the operations allowed in a function. The joint must keep the axis e₃, such as
    revolute, cylindrical, screw and planar.

    Parameters
    ----------
    torque : float, array_like of shape (n,), or callable, optional
        Torque about the axis, N m.
    speed : float, array_like of shape (n,), or callable, optional
        Speed about the axis, rad/s. It is a further constraint, which the initial twist must
        satisfy; −λ of its row is the torque of the motor.
    force : float, array_like of shape (n,), or callable, optional
        Force along the axis, N. The joint must slide along e₃, such as a prismatic one.
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
