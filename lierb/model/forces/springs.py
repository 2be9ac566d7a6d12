"""Springs and dampers: between two points, and about or along joint axes."""

from __future__ import annotations

from typing import Any, ClassVar

from numpy.typing import ArrayLike

from lierb.kernels.mechanics.elements import Tangent
from lierb.kernels.mechanics.kinks import Bound
from lierb.kernels.mechanics.newton_euler import Motion, Wrench
from lierb.kernels.numbers.arithmetic import PI, fma, maximum, where
from lierb.kernels.numbers.vec import UNIT, Vec, axpy, cross, dot, mat_t_vec, norm, scale, sub
from lierb.model.forces.built_in import (
    BODY_POINT,
    GROUND_POINT,
    ORIGIN,
    BuiltIn,
    Parameter,
    inverse_norm,
    unit_force_at,
)
from lierb.model.forces.joint_axes import AlongJoint, AtJoint
from lierb.model.functions.wrenches import Force

__all__ = ["spring_damper", "torsional_spring", "slide_spring"]


class SpringDamper(BuiltIn):
    """Spring and damper along the line from a point of the ground to a point of the body."""

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

    def _line(self, placed: Any, x: Motion) -> tuple[Vec, Any, Vec]:
        """Vector from the ground's point to the body's, its 1/ℓ and its rate, in body axes."""
        point, anchor = placed[:2]
        line = mat_t_vec(x.q, sub(x.place_of(point), anchor))
        return line, inverse_norm(line), x.velocity_of(point)

    def wrench(self, placed: Any, x: Motion) -> Wrench:
        point, _, stiffness, damping, length = placed
        line, inverse, velocity = self._line(placed, x)
        rate = dot(line, velocity) * inverse
        # k (ℓ − ℓ₀)/ℓ + c ℓ̇/ℓ: needs no direction where ℓ = 0
        tension = fma(inverse, fma(damping, rate, -(stiffness * length)), stiffness)
        # There the line comes to lie along the velocity, and the damper's force is −c v.
        anywhere = where(inverse == 0.0, damping, 0.0)
        force = axpy(-anywhere, velocity, scale(-tension, line))
        return cross(point, force), force

    def tangents(self, placed: Any, x: Motion) -> tuple[Tangent, ...]:
        point, _, stiffness, damping, length = placed
        line, inverse, _ = self._line(placed, x)
        # k (1 − ℓ₀/ℓ) across the line, if it is stretched. At ℓ = 0 it may have any direction.
        across = stiffness * maximum(1.0 - length * inverse, 0.0)
        anywhere = where(inverse == 0.0, damping, 0.0)
        along = unit_force_at(point, scale(inverse, line))
        return (
            Tangent(along, stiffness - across, damping),
            *(Tangent(unit_force_at(point, axis), across, anywhere) for axis in UNIT),
        )

    def energy(self, placed: Any, x: Motion) -> Any:
        point, anchor, stiffness, _, length = placed
        stretch = norm(sub(x.place_of(point), anchor)) - length
        return 0.5 * stiffness * (stretch * stretch)

    def power(self, placed: Any, x: Motion, wrench: Wrench) -> Any:
        line, inverse, velocity = self._line(placed, x)
        rate = dot(line, velocity) * inverse
        square = where(inverse == 0.0, dot(velocity, velocity), rate * rate)
        return -placed[3] * square


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
    where ℓ = 0. The energy includes the spring's ½k(ℓ − length)², the work the damper's power.

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

    Raises
    ------
    ArgumentError
        `stiffness` or `damping` is negative, or an argument has the wrong shape.

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


class JointSpring(AtJoint, is_abstract=True):
    """Spring and damper at a joint axis; the spring is slack at the last parameter."""

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
    """Spring and damper about the joint axis; the spring turns back the shorter way."""

    name = "torsional_spring"
    bounds_steps: ClassVar = True
    parameters: ClassVar = {
        "stiffness": Parameter("N m/rad", is_signed=False),
        "damping": Parameter("N m s/rad", is_signed=False),
        "angle": Parameter("rad"),
    }

    def travel(
        self, placed: Any, start: Motion, end: Motion, h: Any, size: Any
    ) -> tuple[Bound, ...]:
        if self.turns:
            return ()
        # the torque jumps half a turn from where the spring is slack
        return (self.to_kink(start, end, h, placed[2], (-PI, PI), size),)


def torsional_spring(
    *,
    stiffness: ArrayLike = 0.0,
    damping: ArrayLike = 0.0,
    angle: ArrayLike = 0.0,
    turns: str | None = None,
) -> Force:
    """Apply a spring and damper about the joint axis.

    The torque is −(k φ + c φ̇), with φ the joint angle minus `angle`. Without `turns`, φ is between
    −π and π: the spring turns back the shorter way, and its torque jumps half a turn from `angle`.
    The energy includes ½kφ², the work the damper's power. The joint must keep the axis e₃, such as
    revolute, cylindrical, screw and planar.

    Parameters
    ----------
    stiffness : float or array_like, shape (n,), optional
        Stiffness k, N m/rad.
    damping : float or array_like, shape (n,), optional
        Damping c, N m s/rad.
    angle : float or array_like, shape (n,), optional
        Angle at which the spring is slack, rad.
    turns : str, optional
        Name of the state by which `lierb.turns` counts whole turns of the same joint.

    Returns
    -------
    Force
        Element for `Problem(forces=…)`.

    Raises
    ------
    ArgumentError
        `stiffness` or `damping` is negative, or an argument has the wrong shape.

    Examples
    --------
    >>> import lierb
    >>> lierb.forces.torsional_spring(stiffness=0.5, damping=[0.0, 0.01])
    <torsional_spring: stiffness, damping, angle>
    """
    return TorsionalSpring.counting(turns).force(stiffness=stiffness, damping=damping, angle=angle)


class SlideSpring(AlongJoint, JointSpring):
    """Spring and damper along the joint axis."""

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

    The energy includes the spring's ½k(d₃ − position)², the work the damper's power. The joint must
    keep the axis e₃ and slide along it, such as prismatic, cylindrical and screw.

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

    Raises
    ------
    ArgumentError
        `stiffness` or `damping` is negative, or an argument has the wrong shape.

    Examples
    --------
    >>> import lierb
    >>> lierb.forces.slide_spring(stiffness=[10.0, 20.0], position=0.1)
    <slide_spring: stiffness, damping, position>
    """
    return SlideSpring().force(stiffness=stiffness, damping=damping, position=position)
