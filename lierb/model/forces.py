"""Applied forces beside gravity: springs, dampers, drag, motors, and functions of the user's own.

::

    problem = lierb.Problem(body, joint, forces=[lierb.forces.drag(linear=0.1)])

Every parameter has one value for all bodies or one for each: (n,), (n, 3). The name of a point or
direction says in which frame it is; the default point is that frame's origin.

A force is a class with its name, its parameters and its formulas, and the function of that name
that makes it. Studies use the same names.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from lierb.errors import ArgumentError, ForceError, body_label, require_name, told
from lierb.kernels.functions.function import Function
from lierb.kernels.functions.shapes import Shape
from lierb.kernels.functions.user_number import UserNumber
from lierb.kernels.mechanics.elements import Bound, Element, Tangent, Wrench, travel_to_kink
from lierb.kernels.mechanics.newton_euler import Frames, Kinematics, Motion
from lierb.kernels.mechanics.rows import AddedRow, HeldBody
from lierb.kernels.numbers.arithmetic import (
    PI,
    absolute,
    fma,
    maximum,
    minimum,
    plain,
    rint,
    sqrt,
    where,
)
from lierb.kernels.numbers.trigonometry import atan2
from lierb.kernels.numbers.vec import (
    UNIT,
    ZERO3,
    Vec,
    cross,
    cross_add,
    dot,
    mat_t_vec,
    norm,
    scale,
    sub,
)
from lierb.kernels.numbers.zero import ZERO
from lierb.model.functions.tracing import DERIVATIVES, user_function
from lierb.model.functions.wrenches import Force
from lierb.support.arrays import as_numbers, as_positive, batch_size

ORIGIN = (0.0, 0.0, 0.0)


class Parameter(NamedTuple):
    """Of a force: unit, shape for one body, whether it may be negative, the way to joint axes."""

    unit: str
    shape: Shape = ()
    is_signed: bool = True
    to_joint_axes: Callable[[Frames, Any], Any] = lambda frames, given: given


BODY_POINT = Parameter("m", (3,), to_joint_axes=Frames.body_point)
GROUND_POINT = Parameter("m", (3,), to_joint_axes=Frames.ground_point)
FORCE_UNITS: dict[str, dict[str, str]] = {}  # of the parameters of every force, by its name


@dataclass(frozen=True)
class BuiltIn(Element):
    """A force of lierb's own.

    name : of the function that makes it, and of its type in a study.
    """

    name: ClassVar[str]
    parameters: ClassVar[dict[str, Parameter]]

    def __init_subclass__(cls, is_abstract: bool = False) -> None:
        if is_abstract:
            return
        units = FORCE_UNITS.setdefault(cls.name, {})
        units |= {name: parameter.unit for name, parameter in cls.parameters.items()}

    @property
    def shapes(self) -> dict[str, Shape]:
        own = {name: parameter.shape for name, parameter in self.parameters.items()}
        return super().shapes if self.functions else own

    def force(self, /, **given: ArrayLike) -> Force:
        """The force with these parameters."""
        made = Force.of(self.name, self, given)
        for name in (n for n, p in self.parameters.items() if not p.is_signed):
            array = np.atleast_1d(made.parameters[name])
            for body in np.flatnonzero(array < 0.0)[:1]:
                label = body_label(name, int(body), array.size)
                raise ArgumentError(f"{label} is {array[body]}; expected zero or a positive number")
        return made

    def placed(self, given: dict[str, Any], frames: Frames) -> tuple[Any, ...]:
        ways = {name: parameter.to_joint_axes for name, parameter in self.parameters.items()}
        return tuple(ways[n](frames, x) if n in ways else x for n, x in given.items())


# ---- constant wrenches -------------------------------------------------------------------------


class BodyWrench(BuiltIn):
    """Constant in body axes: a thruster."""

    name = "constant_wrench"
    parameters: ClassVar = {
        "torque": Parameter("N m", (3,)), "force": Parameter("N", (3,)), "point": BODY_POINT,
    }  # fmt: skip

    def placed(self, given: dict[str, Any], frames: Frames) -> tuple[Any, ...]:
        force = frames.body_direction(given["force"])
        torque = frames.body_direction(given["torque"])
        return cross_add(frames.body_point(given["point"]), force, torque), force

    def wrench(self, placed: Any, x: Motion) -> Wrench:
        torque, force = placed
        return torque, force


class GroundWrench(BuiltIn):
    """Constant in ground axes; the force has a potential, the torque has none."""

    name = BodyWrench.name
    parameters: ClassVar = BodyWrench.parameters
    is_conservative: ClassVar = True
    working: ClassVar = ("torque",)

    def placed(self, given: dict[str, Any], frames: Frames) -> tuple[Any, ...]:
        return (
            frames.ground_direction(given["torque"]),
            frames.ground_direction(given["force"]),
            frames.body_point(given["point"]),
            -dot(given["force"], frames.ground[1]),
        )

    def wrench(self, placed: Any, x: Motion) -> Wrench:
        torque, force, point, _ = placed
        pull = mat_t_vec(x.q, force)
        return cross_add(point, pull, mat_t_vec(x.q, torque)), pull

    def energy(self, placed: Any, x: Motion) -> Any:
        _, force, point, at_origin = placed
        return at_origin - dot(force, x.place_of(point))

    def power(self, placed: Any, x: Motion, wrench: Wrench) -> Any:
        return dot(mat_t_vec(x.q, placed[0]), x.omega)


def constant_wrench(
    torque: ArrayLike = ORIGIN,
    force: ArrayLike = ORIGIN,
    *,
    point: ArrayLike = ORIGIN,
    frame: str = "ground",
) -> Force:
    """Apply a constant torque, and a constant force at a point of the body.

    A force that is constant in the ground has a potential, −force·x, which counts in the energy. A
    torque, or a force in the body's axes, counts in the work.

    Parameters
    ----------
    torque : array_like, shape (3,) or (n, 3), optional
        Torque, N m, in the axes of `frame`.
    force : array_like, shape (3,) or (n, 3), optional
        Force, N, in the axes of `frame`.
    point : array_like, shape (3,) or (n, 3), optional
        Point of the body where the force acts, m, in the body frame.
    frame : {"ground", "body"}, optional
        Axes of torque and force. A thruster's are "body".

    Returns
    -------
    Force
        Element for `Problem(forces=…)`.

    Examples
    --------
    >>> import lierb
    >>> lierb.forces.constant_wrench(force=(0.0, 0.0, 2.0), frame="body")
    <constant_wrench: torque, force, point>
    """
    require_name("frame", frame, ("ground", "body"))
    kind = BodyWrench() if frame == "body" else GroundWrench()
    return kind.force(torque=torque, force=force, point=point)


# ---- springs and dampers -----------------------------------------------------------------------


class SpringDamper(BuiltIn):
    """Along the line from a point of the ground to a point of the body."""

    name = "spring_damper"
    parameters: ClassVar = {
        "body_point": BODY_POINT,
        "ground_point": GROUND_POINT,
        "stiffness": Parameter("N/m", is_signed=False),
        "damping": Parameter("N s/m", is_signed=False),
        "length": Parameter("m", is_signed=False),
    }
    is_conservative: ClassVar = True
    working: ClassVar = ("damping",)

    def _line(self, placed: Any, x: Motion) -> tuple[Vec, Any, Any]:
        """From anchor to point in body axes, 1/ℓ and ℓ̇."""
        point, anchor = placed[:2]
        line = mat_t_vec(x.q, sub(x.place_of(point), anchor))
        inverse = _inverse_norm(line)
        return line, inverse, dot(line, x.velocity_of(point)) * inverse

    def wrench(self, placed: Any, x: Motion) -> Wrench:
        point, _, stiffness, damping, length = placed
        line, inverse, rate = self._line(placed, x)
        # k (ℓ − ℓ₀)/ℓ + c ℓ̇/ℓ: no direction is needed where ℓ = 0
        tension = fma(inverse, fma(damping, rate, -(stiffness * length)), stiffness)
        force = scale(-tension, line)
        return cross(point, force), force

    def tangents(self, placed: Any, x: Motion) -> tuple[Tangent, ...]:
        point, _, stiffness, damping, length = placed
        line, inverse, _ = self._line(placed, x)
        # k (1 − ℓ₀/ℓ) across the line, where it is stretched. Where ℓ = 0, any direction may be its
        across = stiffness * maximum(1.0 - length * inverse, 0.0)
        anywhere = where(inverse == 0.0, damping, 0.0)
        along = _pulled(point, scale(inverse, line))
        return (
            Tangent(along, stiffness - across, damping),
            *(Tangent(_pulled(point, axis), across, anywhere) for axis in UNIT),
        )

    def energy(self, placed: Any, x: Motion) -> Any:
        point, anchor, stiffness, _, length = placed
        stretch = norm(sub(x.place_of(point), anchor)) - length
        return 0.5 * stiffness * (stretch * stretch)

    def power(self, placed: Any, x: Motion, wrench: Wrench) -> Any:
        _, _, rate = self._line(placed, x)
        return -placed[3] * (rate * rate)


def _pulled(point: Vec, direction: Vec) -> Vec:
    """Torque and force of a unit force at a point."""
    return cross(point, direction) + direction


def _inverse_norm(a: Vec) -> Any:
    """1/‖a‖; 0 for the zero vector."""
    square = dot(a, a)
    some = square > 0.0
    return where(some, 1.0, 0.0) / sqrt(where(some, square, 1.0))


def spring_damper(
    body_point: ArrayLike = ORIGIN,
    ground_point: ArrayLike = ORIGIN,
    *,
    stiffness: ArrayLike = 0.0,
    damping: ArrayLike = 0.0,
    length: ArrayLike = 0.0,
) -> Force:
    """Apply a linear spring and damper between a point of the body and one of the ground.

    The force on the body is −(k (ℓ − length) + c ℓ̇) along the line between the points, and zero
    where ℓ = 0. The spring's ½k(ℓ − length)² counts in the energy, the damper's power in the work.

    Parameters
    ----------
    body_point : array_like, shape (3,) or (n, 3), optional
        Point of the body, m, in the body frame.
    ground_point : array_like, shape (3,) or (n, 3), optional
        Point of the ground, m, in the ground frame.
    stiffness : float or array_like, shape (n,), optional
        Stiffness k, N/m.
    damping : float or array_like, shape (n,), optional
        Damping c, N s/m.
    length : float or array_like, shape (n,), optional
        Length at which the spring is slack, m.

    Returns
    -------
    Force
        Element for `Problem(forces=…)`.

    Examples
    --------
    >>> import lierb
    >>> lierb.forces.spring_damper(ground_point=(0.0, 0.0, 1.0), stiffness=[10.0, 20.0], length=0.5)
    <spring_damper: body_point, ground_point, stiffness, damping, length>
    """
    return SpringDamper().force(
        body_point=body_point, ground_point=ground_point, stiffness=stiffness, damping=damping,
        length=length,
    )  # fmt: skip


class AtJoint(BuiltIn, is_abstract=True):
    """About the joint axis e₃, or along it: by the rate there, and the place."""

    needs_axis: ClassVar = True

    def rate(self, x: Motion) -> Any:
        return x.omega[2]

    def place(self, x: Motion, middle: Any) -> Any:
        """From the middle on."""
        return _turn(x, middle)

    def pushed(self, size: Any) -> Wrench:
        return (ZERO, ZERO, size), ZERO3

    def tangent(self, stiffness: Any, damping: Any, is_lasting: bool = True) -> Tangent:
        torque, force = self.pushed(1.0)
        return Tangent(torque + force, stiffness, damping, is_lasting)


class AlongJoint(AtJoint, is_abstract=True):
    """Along e₃, by how far the joint's point is along it, and how fast."""

    needs_slide: ClassVar = True

    def rate(self, x: Motion) -> Any:
        return x.v[2]

    def place(self, x: Motion, middle: Any) -> Any:
        return x.place[2] - middle

    def pushed(self, size: Any) -> Wrench:
        return ZERO3, (ZERO, ZERO, size)


def _turn(x: Motion, angle: Any) -> Any:
    """How far the body is turned about e₃ from that angle, in [−π, π]."""
    turn = atan2(x.q[3], x.q[0]) - angle
    return fma(-2.0 * PI, rint(turn * (0.5 / PI)), turn)


class JointSpring(AtJoint, is_abstract=True):
    """Back to where it is slack, with a damper: by stiffness, damping and that place."""

    is_conservative: ClassVar = True
    working: ClassVar = ("damping",)

    def wrench(self, placed: Any, x: Motion) -> Wrench:
        stiffness, damping, slack = placed
        return self.pushed(-fma(stiffness, self.place(x, slack), damping * self.rate(x)))

    def tangents(self, placed: Any, x: Motion) -> tuple[Tangent, ...]:
        stiffness, damping, _ = placed
        return (self.tangent(stiffness, damping),)

    def energy(self, placed: Any, x: Motion) -> Any:
        stiffness, _, slack = placed
        stretch = self.place(x, slack)
        return 0.5 * stiffness * (stretch * stretch)

    def power(self, placed: Any, x: Motion, wrench: Wrench) -> Any:
        return -placed[1] * (self.rate(x) * self.rate(x))


class TorsionalSpring(JointSpring):
    """About the joint axis, back to a turn that is at most half a turn away."""

    name = "torsional_spring"
    bounds_steps: ClassVar = True
    parameters: ClassVar = {
        "stiffness": Parameter("N m/rad", is_signed=False),
        "damping": Parameter("N m s/rad", is_signed=False),
        "angle": Parameter("rad"),
    }

    def travel(self, placed: Any, start: Motion, end: Motion, size: Any) -> tuple[Bound, ...]:
        # the torque jumps half a turn from where the spring is slack
        return (travel_to_kink(self.place(start, placed[2]), self.rate(end), (PI, 3.0 * PI)),)


def torsional_spring(
    *, stiffness: ArrayLike = 0.0, damping: ArrayLike = 0.0, angle: ArrayLike = 0.0
) -> Force:
    """Apply a spring and damper about the joint axis.

    The spring depends on the pose, not on the path to it: it turns back to `angle` the shorter way,
    and its torque jumps half a turn from there. It counts in the energy, ½kφ². It is for joints
    that keep the axis e₃: revolute, prismatic, cylindrical, screw, planar and the like.

    Parameters
    ----------
    stiffness : float or array_like, shape (n,), optional
        Stiffness k, N m/rad.
    damping : float or array_like, shape (n,), optional
        Damping, N m s/rad.
    angle : float or array_like, shape (n,), optional
        Angle at which the spring is slack, rad.

    Returns
    -------
    Force
        Element for `Problem(forces=…)`.

    Examples
    --------
    >>> import lierb
    >>> lierb.forces.torsional_spring(stiffness=0.5, damping=[0.0, 0.01])
    <torsional_spring: stiffness, damping, angle>
    """
    return TorsionalSpring().force(stiffness=stiffness, damping=damping, angle=angle)


class SlideSpring(AlongJoint, JointSpring):
    """Along the joint axis, back to a place."""

    name = "slide_spring"
    parameters: ClassVar = {
        "stiffness": Parameter("N/m", is_signed=False),
        "damping": Parameter("N s/m", is_signed=False),
        "position": Parameter("m"),
    }


def slide_spring(
    *, stiffness: ArrayLike = 0.0, damping: ArrayLike = 0.0, position: ArrayLike = 0.0
) -> Force:
    """Apply a spring and damper along the joint axis.

    The spring's ½k(d₃ − position)² counts in the energy, the damper's power in the work. It is for
    joints that keep the axis e₃ and slide along it: prismatic, cylindrical, screw and the like.

    Parameters
    ----------
    stiffness : float or array_like, shape (n,), optional
        Stiffness k, N/m.
    damping : float or array_like, shape (n,), optional
        Damping, N s/m.
    position : float or array_like, shape (n,), optional
        Coordinate d₃ at which the spring is slack, m.

    Returns
    -------
    Force
        Element for `Problem(forces=…)`.

    Examples
    --------
    >>> import lierb
    >>> lierb.forces.slide_spring(stiffness=[10.0, 20.0], position=0.1)
    <slide_spring: stiffness, damping, position>
    """
    return SlideSpring().force(stiffness=stiffness, damping=damping, position=position)


# ---- friction in joints ------------------------------------------------------------------------


class JointFriction(AtJoint):
    """Against the turning about the joint axis: viscous, and Coulomb's, made smooth."""

    name = "joint_friction"
    parameters: ClassVar = {
        "viscous": Parameter("N m s/rad", is_signed=False),
        "coulomb": Parameter("N m", is_signed=False),
        "speed": Parameter("rad/s"),
    }

    def wrench(self, placed: Any, x: Motion) -> Wrench:
        viscous, coulomb, speed = placed
        rate = self.rate(x)
        per_rate = coulomb / sqrt(fma(rate, rate, speed * speed))
        return self.pushed(-((viscous + per_rate) * rate))

    def tangents(self, placed: Any, x: Motion) -> tuple[Tangent, ...]:
        viscous, coulomb, speed = placed
        return self.tangent(0.0, viscous), self.tangent(0.0, coulomb / speed, is_lasting=False)


class SlideFriction(AlongJoint, JointFriction):
    """Against the sliding along the joint axis."""

    name = "slide_friction"
    parameters: ClassVar = {
        "viscous": Parameter("N s/m", is_signed=False),
        "coulomb": Parameter("N", is_signed=False),
        "speed": Parameter("m/s"),
    }


def joint_friction(
    *, viscous: ArrayLike = 0.0, coulomb: ArrayLike = 0.0, speed: ArrayLike = 1e-2
) -> Force:
    """Apply friction in a joint that turns: −(viscous + coulomb/√(ω² + speed²))·ω about its axis.

    Coulomb's friction is smoothed: it is 71 % of `coulomb` at ω = speed, all of it far above, and
    viscous below, so that a joint that should stick creeps. Near ω = 0 its damping is
    coulomb/speed: keep steps short beside the inertia over that. It is for joints that keep the
    axis e₃.

    Parameters
    ----------
    viscous : float or array_like, shape (n,), optional
        Coefficient of viscous friction, N m s/rad.
    coulomb : float or array_like, shape (n,), optional
        Torque of Coulomb's friction, N m.
    speed : float or array_like, shape (n,), optional
        Speed over which Coulomb's friction is smoothed, rad/s, positive.

    Returns
    -------
    Force
        Element for `Problem(forces=…)`.

    Examples
    --------
    >>> import lierb
    >>> lierb.forces.joint_friction(viscous=0.01, coulomb=[0.0, 0.2])
    <joint_friction: viscous, coulomb, speed>
    """
    as_positive("speed", speed, "rad/s")
    return JointFriction().force(viscous=viscous, coulomb=coulomb, speed=speed)


def slide_friction(
    *, viscous: ArrayLike = 0.0, coulomb: ArrayLike = 0.0, speed: ArrayLike = 1e-3
) -> Force:
    """Apply friction in a joint that slides: −(viscous + coulomb/√(u² + speed²))·u along its axis.

    Coulomb's friction is smoothed as in `joint_friction`. It is for joints that keep the axis e₃
    and slide along it.

    Parameters
    ----------
    viscous : float or array_like, shape (n,), optional
        Coefficient of viscous friction, N s/m.
    coulomb : float or array_like, shape (n,), optional
        Coulomb's friction, N.
    speed : float or array_like, shape (n,), optional
        Speed over which Coulomb's friction is smoothed, m/s, positive.

    Returns
    -------
    Force
        Element for `Problem(forces=…)`.

    Examples
    --------
    >>> import lierb
    >>> lierb.forces.slide_friction(coulomb=2.0, speed=[1e-3, 1e-2])
    <slide_friction: viscous, coulomb, speed>
    """
    as_positive("speed", speed, "m/s")
    return SlideFriction().force(viscous=viscous, coulomb=coulomb, speed=speed)


# ---- limits of joints --------------------------------------------------------------------------


class JointLimit(AtJoint):
    """A stop at either end: a spring and damper beyond it, nothing before."""

    name = "joint_limit"
    bounds_steps: ClassVar = True
    parameters: ClassVar = {
        "lower": Parameter("rad"),
        "upper": Parameter("rad"),
        "stiffness": Parameter("N m/rad", is_signed=False),
        "damping": Parameter("N m s/rad", is_signed=False),
    }
    is_conservative: ClassVar = True
    working: ClassVar = ("damping",)

    def _beyond(self, placed: Any, x: Motion) -> tuple[Any, Any]:
        """How far it is beyond a stop, of either sign, and the damping there."""
        lower, upper, _, damping = placed
        half = 0.5 * (upper - lower)
        place = self.place(x, 0.5 * (lower + upper))
        beyond = maximum(place - half, 0.0) + minimum(place + half, 0.0)
        return beyond, where(absolute(place) > half, damping, 0.0)

    def wrench(self, placed: Any, x: Motion) -> Wrench:
        beyond, damping = self._beyond(placed, x)
        return self.pushed(-fma(placed[2], beyond, damping * self.rate(x)))

    def tangents(self, placed: Any, x: Motion) -> tuple[Tangent, ...]:
        _, _, stiffness, damping = placed
        return (self.tangent(stiffness, damping, is_lasting=False),)

    def travel(self, placed: Any, start: Motion, end: Motion, size: Any) -> tuple[Bound, ...]:
        lower, upper = placed[:2]
        place, half = self.place(start, 0.5 * (lower + upper)), 0.5 * (upper - lower)
        return (travel_to_kink(place, self.rate(end), (-half, half, *self.farther(half))),)

    def farther(self, half: Any) -> tuple[Any, ...]:
        """Kinks beyond the upper stop: half a turn from the middle, and the lower stop again."""
        return PI, 2.0 * PI - half

    def energy(self, placed: Any, x: Motion) -> Any:
        beyond, _ = self._beyond(placed, x)
        return 0.5 * placed[2] * (beyond * beyond)

    def power(self, placed: Any, x: Motion, wrench: Wrench) -> Any:
        _, damping = self._beyond(placed, x)
        return -damping * (self.rate(x) * self.rate(x))


class SlideLimit(AlongJoint, JointLimit):
    """The same along the joint axis."""

    name = "slide_limit"
    parameters: ClassVar = {
        "lower": Parameter("m"),
        "upper": Parameter("m"),
        "stiffness": Parameter("N/m", is_signed=False),
        "damping": Parameter("N s/m", is_signed=False),
    }

    def farther(self, half: Any) -> tuple[Any, ...]:
        """No kink beyond the upper stop."""
        return (np.inf,)


def joint_limit(
    *, lower: ArrayLike, upper: ArrayLike, stiffness: ArrayLike, damping: ArrayLike = 0.0
) -> Force:
    """Apply stops to a joint that turns: a spring and a damper about its axis beyond either one.

    The spring counts in the energy, the damper's power in the work. A stop depends on the pose, not
    on the path to it: beyond it the shorter way back counts, so that lower and upper must be less
    than 2π apart. Keep steps short beside √(inertia/stiffness); the step in which a stop is met is
    of lower order. It is for joints that keep the axis e₃.

    Parameters
    ----------
    lower : float or array_like, shape (n,)
        Least angle φ, rad.
    upper : float or array_like, shape (n,)
        Largest angle φ, rad.
    stiffness : float or array_like, shape (n,)
        Stiffness of the stops, N m/rad.
    damping : float or array_like, shape (n,), optional
        Damping in the stops, N m s/rad.

    Returns
    -------
    Force
        Element for `Problem(forces=…)`.

    Examples
    --------
    >>> import lierb
    >>> lierb.forces.joint_limit(lower=-0.5, upper=[1.0, 1.5], stiffness=100.0, damping=0.1)
    <joint_limit: lower, upper, stiffness, damping>
    """
    _require_order(lower, upper, 2.0 * np.pi)
    return JointLimit().force(lower=lower, upper=upper, stiffness=stiffness, damping=damping)


def slide_limit(
    *, lower: ArrayLike, upper: ArrayLike, stiffness: ArrayLike, damping: ArrayLike = 0.0
) -> Force:
    """Apply stops to a joint that slides: a spring and a damper along its axis beyond either one.

    Energy, work and steps are as for `joint_limit`. It is for joints that keep the axis e₃ and
    slide along it.

    Parameters
    ----------
    lower : float or array_like, shape (n,)
        Least coordinate d₃, m.
    upper : float or array_like, shape (n,)
        Largest coordinate d₃, m.
    stiffness : float or array_like, shape (n,)
        Stiffness of the stops, N/m.
    damping : float or array_like, shape (n,), optional
        Damping in the stops, N s/m.

    Returns
    -------
    Force
        Element for `Problem(forces=…)`.

    Examples
    --------
    >>> import lierb
    >>> lierb.forces.slide_limit(lower=0.0, upper=0.2, stiffness=[1e3, 1e4])
    <slide_limit: lower, upper, stiffness, damping>
    """
    _require_order(lower, upper)
    return SlideLimit().force(lower=lower, upper=upper, stiffness=stiffness, damping=damping)


def _require_order(lower: ArrayLike, upper: ArrayLike, turn: float = np.inf) -> None:
    low, high = as_numbers("lower", lower, ()), as_numbers("upper", upper, ())
    batch_size(lower=low, upper=high)
    lows, highs = (np.atleast_1d(x) for x in np.broadcast_arrays(low, high))
    for body in np.flatnonzero(lows > highs)[:1]:
        label = body_label("lower", int(body), lows.size)
        below, above = float(lows[body]), float(highs[body])
        raise ArgumentError(f"{label} is {below}, above upper, {above}; expected lower ≤ upper")
    for body in np.flatnonzero(highs - lows >= turn)[:1]:
        label = body_label("upper", int(body), lows.size)
        raise ArgumentError(
            f"{label} is {float(highs[body])} rad, a turn or more above lower, "
            f"{float(lows[body])}: stops that know the pose alone would never act; expected less "
            "than 2π between them"
        )


# ---- drag --------------------------------------------------------------------------------------


class Drag(BuiltIn):
    """Against the velocity of a body point, linear and quadratic, and against the turning."""

    name = "drag"
    parameters: ClassVar = {
        "linear": Parameter("N s/m", is_signed=False),
        "quadratic": Parameter("N s²/m²", is_signed=False),
        "angular": Parameter("N m s", is_signed=False),
        "point": BODY_POINT,
    }

    def wrench(self, placed: Any, x: Motion) -> Wrench:
        linear, quadratic, angular, point = placed
        moving = x.velocity_of(point)
        force = scale(-fma(quadratic, norm(moving), linear), moving)
        return cross_add(point, force, scale(-angular, x.omega)), force

    def tangents(self, placed: Any, x: Motion) -> tuple[Tangent, ...]:
        linear, quadratic, angular, point = placed
        moving = x.velocity_of(point)
        more = quadratic * norm(moving)  # q‖u‖ across u, and twice that along it
        ahead = scale(_inverse_norm(moving), moving)
        return (
            Tangent(_pulled(point, ahead), damping=more),
            *(Tangent(_pulled(point, axis), damping=linear + more) for axis in UNIT),
            *(Tangent(axis + ZERO3, damping=angular) for axis in UNIT),
        )


def drag(
    linear: ArrayLike = 0.0,
    quadratic: ArrayLike = 0.0,
    *,
    angular: ArrayLike = 0.0,
    point: ArrayLike = ORIGIN,
) -> Force:
    """Apply the drag of a medium at rest: −(linear + quadratic·‖u‖)·u at a point of velocity u.

    Parameters
    ----------
    linear : float or array_like, shape (n,), optional
        Coefficient of linear drag, N s/m.
    quadratic : float or array_like, shape (n,), optional
        Coefficient of quadratic drag, N s²/m².
    angular : float or array_like, shape (n,), optional
        Coefficient of a torque −angular·ω, N m s.
    point : array_like, shape (3,) or (n, 3), optional
        Point of the body where the drag acts, m, in the body frame.

    Returns
    -------
    Force
        Element for `Problem(forces=…)`.

    Examples
    --------
    >>> import lierb
    >>> lierb.forces.drag(linear=0.1, quadratic=[0.0, 0.02])
    <drag: linear, quadratic, angular, point>
    """
    return Drag().force(linear=linear, quadratic=quadratic, angular=angular, point=point)


# ---- motors ------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Motor(BuiltIn):
    """A torque about the joint axis: constant, or a function of time."""

    function: Function | None
    name = "motor"
    parameters: ClassVar = {"torque": Parameter("N m")}
    needs_axis: ClassVar = True

    def at(self, placed: Any, time: Any) -> Any:
        """The torque, or whatever else it gives."""
        return placed[0] if self.function is None else self.function(placed, time)

    def wrench(self, placed: Any, x: Motion) -> Wrench:
        return (ZERO, ZERO, self.at(placed, x.time)), ZERO3


@dataclass(frozen=True)
class SlideMotor(Motor):
    """A force along the joint axis."""

    parameters: ClassVar = {"force": Parameter("N")}
    needs_slide: ClassVar = True

    def wrench(self, placed: Any, x: Motion) -> Wrench:
        return ZERO3, (ZERO, ZERO, self.at(placed, x.time))


@dataclass(frozen=True)
class SpeedMotor(Motor):
    """The turn about the joint axis at a given rate, rad/s: a row, and no force."""

    parameters: ClassVar = {"speed": Parameter("rad/s")}
    rows: int = 1

    def wrench(self, placed: Any, x: Motion) -> Wrench:
        return ZERO3, ZERO3

    def row(self, place: int, i: int) -> AddedRow:
        return SpeedRow(self, place, i)


class SpeedRow(AddedRow):
    """Ω₃ = w(t)."""

    is_holonomic = False
    fixed_axis = 2

    def __str__(self) -> str:
        return "motor"

    def jacobian(self, x: Kinematics, body: HeldBody) -> Vec:
        return UNIT[2] + ZERO3

    def acceleration(self, x: Kinematics, body: HeldBody) -> Any:
        """ẇ, exactly."""
        rate = self.element.at(self.placed(body), UserNumber(plain(x.time), (1.0,)))
        return rate.parts[0] if isinstance(rate, UserNumber) else ZERO

    def prescribed_rate(self, x: Kinematics, body: HeldBody) -> Any:
        return self.element.at(self.placed(body), x.time)


def motor(
    torque: ArrayLike | Callable[..., Any] | None = None,
    *,
    speed: ArrayLike | Callable[..., Any] | None = None,
    force: ArrayLike | Callable[..., Any] | None = None,
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
    chosen = [(name, given, kind) for name, (given, kind) in ways.items() if given is not None]
    if len(chosen) != 1:
        raise ArgumentError("give torque= or speed= or force=, one of them")
    name, given, kind = chosen[0]
    if callable(given):
        if not inspect.isfunction(given):
            raise ForceError(
                f"expected a number or a function of (t) or (t, params), got {told(given)}"
            )
        shapes: dict[str, Shape] = dict.fromkeys(parameters, ())
        because = None if speed is None else DERIVATIVES
        function = user_function(given, ("t",), shapes, ((),), because)
        return kind(function).force(**parameters)
    if parameters:
        raise ArgumentError(f"{', '.join(parameters)}: only a function takes parameters")
    return kind(None).force(**{name: given})


__all__ = [*FORCE_UNITS]


def __dir__() -> list[str]:
    return list(__all__)
