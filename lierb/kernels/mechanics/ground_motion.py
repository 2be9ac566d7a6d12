"""Ground that moves: a link's force of inertia in a frame with a given acceleration."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import islice
from math import prod
from typing import Any, ClassVar

from lierb.kernels.functions.function import Function
from lierb.kernels.mechanics.elements import Element
from lierb.kernels.mechanics.newton_euler import Frames, Motion, Wrench
from lierb.kernels.mechanics.user_frames import UserFrame, constant_in_time, second, slope_of
from lierb.kernels.mechanics.user_wrench import times_of_jumps
from lierb.kernels.numbers.arithmetic import apart, flatten
from lierb.kernels.numbers.vec import Vec, cross, mat_t_vec, scale
from lierb.kernels.numbers.zero import ZERO


@dataclass(frozen=True)
class GroundMotion(Element):
    """Force −m s̈ at the centre of mass, s(t) the displacement of the ground: a user's function."""

    function: Function
    discontinuities: tuple[str, ...] = ()
    takes_body: ClassVar = True

    @property
    def depends_on_velocity(self) -> bool:
        return False

    def placed(self, given: dict[str, Any], frames: Frames) -> tuple[Any, ...]:
        """Return the frame, the parameters, and mass and centre of mass of the body."""
        own = tuple(given[name] for name in self.shapes)
        return UserFrame.of(frames), own, given["body.mass"], given["body.com"]

    def acceleration(self, placed: Any, x: Motion) -> Vec:
        """Return s̈, m/s², in the axes of the user's body frame."""
        turn, _ = UserFrame(*placed[0]).pose(x.q, x.place)
        return mat_t_vec(turn, self._second_slope(x.time, *flatten(placed[1])))

    @cached_property
    def _second_slope(self) -> Callable[..., Vec]:
        """Return the formula of s̈, m/s², in ground axes, from time and parameters.

        Its code is called apart: each stage of each link would have it otherwise, which made the
        first call of a small mechanism four times as long.
        """

        def formula(time: Any, *numbers: Any) -> Vec:
            rest = iter(constant_in_time(numbers))
            parameters = tuple(
                tuple(islice(rest, prod(shape))) if shape else next(rest)
                for shape in self.shapes.values()
            )
            moved = self.function(parameters, second(time, 1.0, ZERO))
            return tuple(0.0 * time + slope_of(slope_of(s)) for s in moved)

        # the name of the code, which differs from motion to motion
        formula.__qualname__ = f"_second_slope.{self.function.fingerprint}.{self.shapes}"
        return apart(3)(formula)

    def felt(self, placed: Any, x: Motion) -> Vec:
        """Return s̈, m/s², in the axes of the joint on the body."""
        return mat_t_vec(UserFrame(*placed[0]).axes, self.acceleration(placed, x))

    def wrench(self, placed: Any, x: Motion) -> Wrench:
        frame, _, mass, com = placed
        pull = scale(-mass, self.acceleration(placed, x))
        return UserFrame(*frame).to_joint_axes(cross(com, pull), pull)

    def travel(self, placed: Any, start: Motion, end: Motion, h: Any, size: Any) -> tuple[()]:
        """Return no bounds: the force does not depend on the place."""
        return ()

    def jumps(self, placed: Any) -> tuple[Any, ...]:
        return times_of_jumps(self, placed[1])
