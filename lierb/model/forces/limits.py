"""Joint limits: a spring and damper beyond each stop."""

from __future__ import annotations

from collections.abc import Mapping
from math import isfinite
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from lierb.errors import ArgumentError
from lierb.kernels.mechanics.elements import Tangent
from lierb.kernels.mechanics.kinks import Bound
from lierb.kernels.mechanics.newton_euler import Motion, Wrench
from lierb.kernels.numbers.arithmetic import PI, absolute, fma, minimum, where
from lierb.model.forces.built_in import Parameter
from lierb.model.forces.joint_axes import AlongJoint, AtJoint, sliding
from lierb.model.functions.wrenches import Force
from lierb.support.arrays import Array, first_bad

__all__ = ["joint_limit", "slide_limit"]

# Distance from a stop that is rounding: of a coordinate, which is the difference of larger numbers,
# and of an angle in (−π, π] from the middle of the stops.
OF_COORDINATE, OF_ANGLE = 1e-12, 1e-14


class JointLimit(AtJoint):
    """Stops at both ends of an angle: a spring and damper beyond each."""

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
    jumping: ClassVar = ("damping",)

    def require_fit(self, parameters: Mapping[str, Array]) -> None:
        super().require_fit(parameters)
        turn = self.whole_turn if self.is_wrapped else np.inf
        _require_order(parameters["lower"], parameters["upper"], turn)

    def _beyond(self, placed: Any, x: Motion) -> tuple[Any, Any]:
        """Signed distance beyond a stop, and the damping there.

        A joint on a stop, as at a start, is beyond it unless it moves away: derivatives are those
        of the motion to come.
        """
        middle, low, high = self.stops(placed)
        place, rate, damping = self.place(x, middle), self.rate(x), placed[3]
        above, below, near = place - high, place - low, OF_COORDINATE * absolute(place)
        if isfinite(self.whole_turn):
            near = OF_ANGLE * (PI + absolute(place) + absolute(middle))
        is_above = (above > near) | ((above >= -near) & (rate >= 0.0))
        is_below = (below < -near) | ((below <= near) & (rate <= 0.0))
        beyond = where(is_above, above, where(is_below, below, 0.0))
        return beyond, where(is_above | is_below, damping, 0.0)

    def wrench(self, placed: Any, x: Motion) -> Wrench:
        beyond, damping = self._beyond(placed, x)
        return self.pushed(-fma(placed[2], beyond, damping * self.rate(x)))

    def tangents(self, placed: Any, x: Motion) -> tuple[Tangent, ...]:
        _, _, stiffness, damping = placed
        return (self.tangent(stiffness, damping, is_lasting=False),)

    def travel(
        self, placed: Any, start: Motion, end: Motion, h: Any, size: Any
    ) -> tuple[Bound, ...]:
        middle, low, high = self.stops(placed)
        kinks: tuple[Any, ...] = low, high
        if self.is_wrapped:  # half a turn from the middle, and then the other stop
            kinks = -2.0 * PI + high, -PI, low, high, PI, 2.0 * PI + low
        return (self.to_kink(start, end, h, middle, kinks, minimum(size, 0.5 * (high - low))),)

    @property
    def is_wrapped(self) -> bool:
        """Return whether the pose alone gives the coordinate, up to whole turns."""
        return not self.turns and isfinite(self.whole_turn)

    def stops(self, placed: Any) -> tuple[Any, Any, Any]:
        """Return the coordinate from which others count, and those of the stops.

        It is the middle where the coordinate is wrapped, otherwise 0: one of the stops may be far.
        """
        lower, upper = placed[:2]
        if not self.is_wrapped:
            return 0.0, lower, upper
        half = 0.5 * (upper - lower)
        return 0.5 * (lower + upper), -half, half

    def energy(self, placed: Any, x: Motion) -> Any:
        beyond, _ = self._beyond(placed, x)
        return 0.5 * placed[2] * (beyond * beyond)

    def power(self, placed: Any, x: Motion, wrench: Wrench) -> Any:
        _, damping = self._beyond(placed, x)
        return -damping * (self.rate(x) * self.rate(x))


class SlideLimit(AlongJoint, JointLimit):
    """Stops at both ends of a slide along the joint axis."""

    name = "slide_limit"
    parameters: ClassVar = sliding(JointLimit.parameters)


def joint_limit(
    *,
    lower: ArrayLike,
    upper: ArrayLike,
    stiffness: ArrayLike,
    damping: ArrayLike = 0.0,
    turns: str | None = None,
) -> Force:
    """Apply stops to a joint that turns: a spring and a damper about its axis beyond either one.

    The energy includes the spring, the work the damper's power. Without `turns`, a stop depends on
    the pose, not on the number of turns, and the spring turns back the shorter way: so
    upper − lower must be less than 2π. Steps must be short relative to √(inertia/stiffness). A
    fixed step across a stop is of lower order; adaptive steps end there. The joint must keep the
    axis e₃.

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
    turns : str, optional
        Name of the state by which `lierb.turns` counts whole turns of the same joint.

    Returns
    -------
    Force
        Element for `Problem(forces=…)`.

    Raises
    ------
    ArgumentError
        `stiffness` or `damping` is negative, `lower` is above `upper`, or they are a turn or more
        apart without `turns`.

    Examples
    --------
    >>> import lierb
    >>> lierb.forces.joint_limit(lower=-0.5, upper=[1.0, 1.5], stiffness=100.0, damping=0.1)
    <joint_limit: lower, upper, stiffness, damping>
    """
    return JointLimit.counting(turns).force(
        lower=lower, upper=upper, stiffness=stiffness, damping=damping
    )


def slide_limit(
    *, lower: ArrayLike, upper: ArrayLike, stiffness: ArrayLike, damping: ArrayLike = 0.0
) -> Force:
    """Apply stops to a joint that slides: a spring and a damper along its axis beyond either one.

    Energy, work and steps are as for `joint_limit`. The joint must keep the axis e₃ and slide along
    it.

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

    Raises
    ------
    ArgumentError
        `stiffness` or `damping` is negative, or `lower` is above `upper`.

    Examples
    --------
    >>> import lierb
    >>> lierb.forces.slide_limit(lower=0.0, upper=0.2, stiffness=[1e3, 1e4])
    <slide_limit: lower, upper, stiffness, damping>
    """
    return SlideLimit().force(lower=lower, upper=upper, stiffness=stiffness, damping=damping)


def _require_order(lower: Array, upper: Array, turn: float) -> None:
    lows, highs = np.broadcast_arrays(lower, upper)
    for body, label in first_bad("lower", lows > highs):
        raise ArgumentError(
            f"{label} is {lows.flat[body]}, above upper, {highs.flat[body]}; expected lower ≤ upper"
        )
    for body, label in first_bad("upper", highs - lows >= turn):
        raise ArgumentError(
            f"{label} is {highs.flat[body]} rad, a turn or more above lower, {lows.flat[body]}: "
            "stops that depend on the pose alone would never act; expected less than 2π between "
            "them, or turns=, the name of a state of lierb.turns, which counts turns"
        )
