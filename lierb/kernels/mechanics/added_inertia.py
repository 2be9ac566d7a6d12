"""Inertia that elements add to links: mass that changes with time; added mass of a fluid.

The wrench of such an element is linear in the acceleration of its link, and the equations of motion
are solved with it. The constants, the energy and the momentum of the body do not include it: the
wrench does work.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

from lierb.kernels.functions.function import Function
from lierb.kernels.groups import se3
from lierb.kernels.mechanics.elements import Element
from lierb.kernels.mechanics.newton_euler import Frames, Motion, unit_inertia
from lierb.kernels.mechanics.spatial import Articulated, Pose, Rigid
from lierb.kernels.mechanics.user_wrench import times_of_jumps
from lierb.kernels.numbers.arithmetic import where
from lierb.kernels.numbers.number import Number
from lierb.kernels.numbers.vec import ZERO3, Vec, add, axpy, cross, dot, neg, scale, sub

NAN = float("nan")


class Added(NamedTuple):
    """Inertia added to a link, about its joint's point, in joint axes.

    The wrench on the link is load − A (ω̇, a), with the acceleration a of the joint's point.
    """

    inertia: Articulated
    load: Vec

    def and_also(self, other: Added) -> Added:
        return Added(self.inertia.and_also(other.inertia), add(self.load, other.load))

    def power(self, acceleration: Vec, twist: Vec) -> Number:
        """Power of the wrench on the link, W."""
        return dot(sub(self.load, self.inertia.momentum(acceleration)), twist)


class AddedInertia(Element):
    """Base class of elements with inertia.   has_weight : True if gravity acts on it."""

    adds_inertia: ClassVar = True
    has_weight: ClassVar[bool] = False

    def added(self, placed: Any, x: Motion) -> Added:
        raise NotImplementedError


def body_frame(frames: Frames) -> Pose:
    """Return the user's body frame relative to the joint's point, in joint axes."""
    return se3.inverse((frames.axes, frames.origin))


@dataclass(frozen=True)
class VariableMass(AddedInertia):
    """Rigid body with mass, centre of mass and inertia that are a user's function of time."""

    function: Function
    discontinuities: tuple[str, ...] = ()
    is_users: ClassVar = True
    has_weight: ClassVar = True

    def placed(self, given: dict[str, Any], frames: Frames) -> tuple[Any, ...]:
        return body_frame(frames), tuple(given.values())

    def added(self, placed: Any, x: Motion) -> Added:
        frame, parameters = placed
        mass, com, inertia = self.function(parameters, x.time, signals=x.signals)
        mass = where(mass >= 0.0, mass, NAN)  # the trajectory ends as non_finite
        about_origin = axpy(mass, unit_inertia(com), inertia)
        moved = Rigid(mass, scale(mass, com), about_origin).from_frame(frame)
        spin = moved.momentum(x.omega + ZERO3)
        return Added(moved, neg(cross(x.omega, spin[:3]) + cross(x.omega, spin[3:])))

    def jumps(self, placed: Any) -> tuple[Any, ...]:
        return times_of_jumps(self, placed[1])
