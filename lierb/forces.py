"""Applied forces beside gravity: springs, dampers, drag, motors, and functions of the user's own.

    problem = lierb.Problem(body, joint, forces=[lierb.forces.drag(linear=0.1)])

Every parameter is one for all bodies or one for each: (n,), (n, 3). Points and directions are in
the frame that the argument's name says, in m; by default points are the frame's origin.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lierb.arrays import as_numbers
from lierb.errors import ArgumentError, ForceError, body_label, require_name, told
from lierb.kernels.functions.function import Function, Shape
from lierb.kernels.mechanics import elements as kinds
from lierb.user_elements import Force, user_function

FRAMES = ("ground", "body")
ORIGIN = (0.0, 0.0, 0.0)


def _not_negative(**given: ArrayLike) -> None:
    for name, value in given.items():
        array = np.atleast_1d(as_numbers(name, value, ()))
        for body in np.flatnonzero(array < 0.0)[:1]:
            label = body_label(name, int(body), array.size)
            raise ArgumentError(f"{label} is {array[body]}; expected zero or a positive number")


def constant_wrench(
    torque: ArrayLike = ORIGIN,
    force: ArrayLike = ORIGIN,
    *,
    point: ArrayLike = ORIGIN,
    frame: str = "ground",
) -> Force:
    """A constant torque, N m, and a constant force, N, that acts at a point of the body.

    torque, force : (3,) or (n, 3), in the axes of `frame`: "ground", or "body" (a thruster).
    point : (3,) or (n, 3), m, in the body frame.

    A force that is constant in the ground has a potential, −force·x, and counts in the energy; what
    a torque, or a thruster, does is work.

    >>> import lierb
    >>> lierb.forces.constant_wrench(force=(0.0, 0.0, 2.0), frame="body")
    <constant_wrench: torque, force, point>
    """
    require_name("frame", frame, FRAMES)
    kind = kinds.BodyWrench() if frame == "body" else kinds.GroundWrench()
    return Force.of("constant_wrench", kind, torque=torque, force=force, point=point)


def spring_damper(
    body_point: ArrayLike = ORIGIN,
    ground_point: ArrayLike = ORIGIN,
    *,
    stiffness: ArrayLike = 0.0,
    damping: ArrayLike = 0.0,
    length: ArrayLike = 0.0,
) -> Force:
    """A linear spring and damper between a point of the body and one of the ground.

    stiffness : N/m.   damping : N s/m.   length : m, at which the spring is slack.

    Its force on the body is −(k (ℓ − length) + c ℓ̇) along the line; nothing where ℓ = 0. The
    spring's ½k(ℓ − length)² counts in the energy, what the damper takes in the work.
    """
    _not_negative(stiffness=stiffness, damping=damping, length=length)
    return Force.of(
        "spring_damper", kinds.SpringDamper(), body_point=body_point, ground_point=ground_point,
        stiffness=stiffness, damping=damping, length=length,
    )  # fmt: skip


def torsional_spring(
    *, stiffness: ArrayLike = 0.0, damping: ArrayLike = 0.0, angle: ArrayLike = 0.0
) -> Force:
    """A spring and damper about the joint axis.

    stiffness : N m/rad.   damping : N m s/rad.   angle : rad, at which the spring is slack.

    The spring knows the pose, not how it came about: it turns back to `angle` the shorter way, so
    that its torque jumps half a turn from there. It counts in the energy, ½kφ². For joints that
    keep the axis e₃: revolute, prismatic, cylindrical, screw, planar and the like.
    """
    _not_negative(stiffness=stiffness, damping=damping)
    return Force.of(
        "torsional_spring", kinds.TorsionalSpring(), stiffness=stiffness, damping=damping,
        angle=angle,
    )  # fmt: skip


def drag(
    linear: ArrayLike = 0.0,
    quadratic: ArrayLike = 0.0,
    *,
    angular: ArrayLike = 0.0,
    point: ArrayLike = ORIGIN,
) -> Force:
    """Resistance of a medium at rest: −(linear + quadratic·|u|)·u at a point with velocity u.

    linear : N s/m.   quadratic : N s²/m².   angular : N m s, for a torque −angular·ω.
    point : (3,) or (n, 3), m, in the body frame.
    """
    _not_negative(linear=linear, quadratic=quadratic, angular=angular)
    return Force.of(
        "drag", kinds.Drag(), linear=linear, quadratic=quadratic, angular=angular, point=point
    )


def motor(
    torque: ArrayLike | Callable[..., Any] | None = None,
    *,
    speed: ArrayLike | Callable[..., Any] | None = None,
    **parameters: ArrayLike,
) -> Force:
    """A motor on the joint axis: its torque, N m, or its speed, rad/s, given.

    torque or speed : number or (n,), or a function (t) or (t, params), and (…, body), with t in s;
        see `lierb.wrench` for what such a function may do. A speed is a constraint of its own, on
        which the twist at the start must be; −λ of its row is the torque that the motor needs.
    parameters : of the function, each a number or (n,).

    For joints that keep the axis e₃: revolute, cylindrical, screw, planar and the like.

    >>> import lierb, math
    >>> lierb.forces.motor(lambda t, params: params.peak * math.sin(3.0 * t), peak=[0.1, 0.2])
    <motor: peak>
    """
    if (torque is None) == (speed is None):
        raise ArgumentError("give torque= or speed=, one of the two")
    name, given = ("torque", torque) if speed is None else ("speed", speed)
    kind = kinds.Motor if speed is None else kinds.SpeedMotor
    if callable(given):
        shapes: dict[str, Shape] = dict.fromkeys(parameters, ())
        function = _time_function(given, shapes, differentiated=speed is not None)
        return Force.of("motor", kind(function), **parameters)
    if parameters:
        raise ArgumentError(f"{', '.join(parameters)}: only a function takes parameters")
    return Force.of("motor", kind(None), **{name: given})  # type: ignore[arg-type]


def _time_function(
    function: Callable[..., Any], shapes: dict[str, Shape], differentiated: bool
) -> Function:
    """A user's function of (t) or (t, params) that returns one number."""
    if not inspect.isfunction(function):
        raise ForceError(
            f"expected a number or a function of (t) or (t, params), got {told(function)}"
        )
    return user_function(function, ("t",), shapes, ((),), differentiated)
