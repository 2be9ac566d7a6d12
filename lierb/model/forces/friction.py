"""Friction in joints: viscous, and Coulomb's, smoothed."""

from __future__ import annotations

from typing import Any, ClassVar

from numpy.typing import ArrayLike

from lierb.kernels.mechanics.elements import Tangent
from lierb.kernels.mechanics.newton_euler import Motion, Wrench
from lierb.kernels.numbers.arithmetic import fma, sqrt
from lierb.model.forces.built_in import Parameter
from lierb.model.forces.joint_axes import AlongJoint, AtJoint, sliding
from lierb.model.functions.wrenches import Force
from lierb.support.arrays import as_positive

__all__ = ["joint_friction", "slide_friction"]


class JointFriction(AtJoint):
    """Friction about the joint axis: viscous, and Coulomb's, smoothed."""

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
    """Friction along the joint axis."""

    name = "slide_friction"
    parameters: ClassVar = sliding(JointFriction.parameters)


def joint_friction(
    *, viscous: ArrayLike = 0.0, coulomb: ArrayLike = 0.0, speed: ArrayLike = 1e-2
) -> Force:
    """Apply friction in a joint that turns: −(viscous + coulomb/√(ω² + speed²))·ω about its axis.

    Coulomb's friction is smoothed: it is 71 % of `coulomb` at ω = speed, approaches it above, and
    is viscous below, so that a joint that should stick creeps. Near ω = 0 the damping is
    coulomb/speed: steps of explicit methods must be short relative to inertia·speed/coulomb. The
    joint must keep the axis e₃.

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

    Raises
    ------
    ArgumentError
        A parameter is negative, or `speed` is zero.

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

    Coulomb's friction is smoothed as in `joint_friction`. The joint must keep the axis e₃ and slide
    along it.

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

    Raises
    ------
    ArgumentError
        A parameter is negative, or `speed` is zero.

    Examples
    --------
    >>> import lierb
    >>> lierb.forces.slide_friction(coulomb=2.0, speed=[1e-3, 1e-2])
    <slide_friction: viscous, coulomb, speed>
    """
    as_positive("speed", speed, "m/s")
    return SlideFriction().force(viscous=viscous, coulomb=coulomb, speed=speed)
