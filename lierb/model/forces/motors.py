"""Motors at joint axes: prescribed torques and forces, speeds and positions."""

from __future__ import annotations

import inspect
from dataclasses import dataclass, replace
from typing import Any, ClassVar

from numpy.typing import ArrayLike

from lierb.errors import ArgumentError, ForceError, brief, require_name
from lierb.kernels.functions.function import Function
from lierb.kernels.functions.shapes import Shape, UserFunction
from lierb.kernels.functions.user_number import UserNumber
from lierb.kernels.mechanics.axis_rows import AxisRow
from lierb.kernels.mechanics.newton_euler import Kinematics, Motion, Wrench
from lierb.kernels.mechanics.rows import AddedRow, HeldBody, Rows, slides, turns
from lierb.kernels.mechanics.user_frames import constant_in_time, second, slope_of
from lierb.kernels.numbers.arithmetic import plain
from lierb.kernels.numbers.vec import ZERO3
from lierb.kernels.numbers.zero import ZERO
from lierb.model.forces.built_in import BuiltIn, Parameter
from lierb.model.functions.tracing import DERIVATIVES, user_function
from lierb.model.functions.wrenches import Force

__all__ = ["motor"]

COORDINATES = ("turn", "slide")  # coordinates of a joint's axis


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
class Prescribed(Motor):
    """Motion of the joint axis as given: a constraint row instead of a force.

    coordinate : "turn" about the axis, "slide" along it, or None for a choice by `on_joint`.
    """

    parameters: ClassVar = {}
    coordinate: str | None = None
    rows: int = 1

    @property
    def needs_slide(self) -> bool:  # type: ignore[override]
        return self.coordinate == "slide"

    @property
    def options(self) -> dict[str, Any]:
        return {"coordinate": self.coordinate}

    def on_joint(self, rows: Rows, joint: int = 0) -> Prescribed:
        return replace(self, coordinate=self.coordinate or own_coordinate(rows))

    def unit_of(self, name: str) -> str:
        unit = super().unit_of(name)
        return unit.replace("rad", "m") if self.needs_slide else unit

    def wrench(self, placed: Any, x: Motion) -> Wrench:
        return ZERO3, ZERO3


class SpeedMotor(Prescribed):
    """Prescribed rate of the angle or of the slide."""

    parameters: ClassVar = {"speed": Parameter("rad/s")}

    def row(self, place: int, i: int) -> AddedRow:
        return SpeedRow(self, place, i)


class PositionMotor(Prescribed):
    """Prescribed angle or slide."""

    parameters: ClassVar = {"position": Parameter("rad")}

    def row(self, place: int, i: int) -> AddedRow:
        return PositionRow(self, place, i)


def own_coordinate(rows: Rows) -> str:
    """Return the coordinate of a joint's axis: its turn, or its slide if it does not turn."""
    return "slide" if slides(rows) and not turns(rows) else "turn"


class PrescribedRow(AxisRow):
    """Row of a joint axis whose motion is a function of time."""

    depends_on_time = True

    def __str__(self) -> str:
        return "motor"

    def given(self, x: Kinematics, body: HeldBody) -> Any:
        """Return the function's value at the time of a motion."""
        return self.element.at(self.placed(body), x.time)

    def slope(self, x: Kinematics, body: HeldBody) -> Any:
        """Return the function's exact derivative by time."""
        given = self.element.at(self.placed(body), UserNumber(plain(x.time), (1.0,)))
        return slope_of(given)

    def acceleration(self, x: Kinematics, body: HeldBody) -> Any:
        return self.bend(x, body) + self.prescribed_slope(x, body)


class SpeedRow(PrescribedRow):
    """Constraint row q̇ = w(t), q the angle or the slide."""

    is_holonomic = False
    prescribed_rate = PrescribedRow.given
    prescribed_slope = PrescribedRow.slope


class PositionRow(PrescribedRow):
    """Constraint row q = f(t); angles are compared up to whole turns."""

    prescribed_place = PrescribedRow.given
    prescribed_rate = PrescribedRow.slope

    def value(self, x: Kinematics, body: HeldBody) -> Any:
        return self.distance(x, self.given(x, body))

    def prescribed_slope(self, x: Kinematics, body: HeldBody) -> Any:
        own = constant_in_time(self.placed(body))
        moving = self.element.at(own, second(x.time, 1.0, ZERO))
        return slope_of(slope_of(moving))


def motor(
    torque: ArrayLike | UserFunction | None = None,
    *,
    speed: ArrayLike | UserFunction | None = None,
    position: ArrayLike | UserFunction | None = None,
    force: ArrayLike | UserFunction | None = None,
    coordinate: str | None = None,
    **parameters: ArrayLike,
) -> Force:
    """Drive a joint by a torque about its axis, a force along it, or a prescribed motion.

    Exactly one of `torque`, `force`, `speed` and `position` must be given: a number, one number for
    each body, or a function of (t) or (t, params), t in s, or with a further argument `body`.
    `lierb.wrench` describes the operations allowed in a function. The joint must keep the axis e₃,
    such as revolute, prismatic, cylindrical, screw and planar.

    A speed or a position is a further constraint, and −λ of its row is the torque or the force of
    the motor. The start must satisfy it; a position prescribes the speed too, by its exact
    derivative. `close(pose, t0=…)` and `project(twist, pose, t0=…)` of `Problem` and `Mechanism`
    find such a start. The prescribed rate must be continuous: a run has no impulses. If it jumps,
    the joint moves on at its old rate, and a warning has the distance from the prescribed position.

    Parameters
    ----------
    torque : float, array_like of shape (n,), or callable, optional
        Torque about the axis, N m.
    speed : float, array_like of shape (n,), or callable, optional
        Rate of the coordinate, rad/s, or m/s of a slide.
    position : float, array_like of shape (n,), or callable, optional
        Coordinate, rad, or m of a slide. An angle beyond ±π continues to the next turn.
    force : float, array_like of shape (n,), or callable, optional
        Force along the axis, N. The joint must slide along e₃, such as a prismatic one.
    coordinate : {"turn", "slide"}, optional
        Coordinate that `speed` or `position` prescribes. Default: the turn about the axis, or, if
        the joint does not turn, the slide along it.
    **parameters : float or array_like, shape (n,)
        Parameters of the function, by name.

    Returns
    -------
    Force
        Element for `Problem(forces=…)`.

    Raises
    ------
    ArgumentError
        None or several of torque, force, speed and position are given.
    ForceError
        The function cannot be compiled.

    Examples
    --------
    >>> import lierb, math
    >>> lierb.forces.motor(lambda t, params: params.peak * math.sin(3.0 * t), peak=[0.1, 0.2])
    <motor: peak>

    A pivot that is shaken by 1 cm:

    >>> cart = lierb.joints.prismatic(axis=(0.0, 0.0, 1.0))
    >>> shaken = lierb.forces.motor(position=lambda t: 0.01 * math.sin(200.0 * t))
    >>> problem = lierb.Problem(lierb.bodies.sphere(0.1, mass=1.0), cart, forces=shaken)
    >>> problem.project((0, 0, 0, 0, 0, 0)).round(9).tolist()
    [0.0, 0.0, 0.0, 0.0, 0.0, 2.0]
    """
    ways: dict[str, tuple[Any, type[Motor]]] = {
        "torque": (torque, Motor), "speed": (speed, SpeedMotor),
        "position": (position, PositionMotor), "force": (force, SlideMotor),
    }  # fmt: skip
    chosen = [(name, value, kind) for name, (value, kind) in ways.items() if value is not None]
    if len(chosen) != 1:
        raise ArgumentError("give torque= or speed= or position= or force=, one of them")
    name, value, kind = chosen[0]
    is_prescribed = issubclass(kind, Prescribed)
    if coordinate is not None:
        if not is_prescribed:
            raise ArgumentError(f"coordinate={brief(coordinate)} is for speed= and position=")
        require_name("coordinate", coordinate, COORDINATES)
    options = {"coordinate": coordinate} if is_prescribed else {}
    if callable(value):
        if not inspect.isfunction(value):
            raise ForceError(
                f"expected a number or a function of (t) or (t, params), got {brief(value)}"
            )
        shapes: dict[str, Shape] = dict.fromkeys(parameters, ())
        because = DERIVATIVES if is_prescribed else None
        function = user_function(value, ("t",), shapes, ((),), because)
        return kind(function, **options).force(**parameters)
    if parameters:
        raise ArgumentError(f"{', '.join(parameters)}: only a function takes parameters")
    return kind(None, **options).force(**{name: value})
