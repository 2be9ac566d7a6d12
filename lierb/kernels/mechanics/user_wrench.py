"""Users' wrenches: functions of time, pose and twist."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from lierb.kernels.functions.function import Function
from lierb.kernels.functions.user_number import UserNumber
from lierb.kernels.mechanics.elements import Element
from lierb.kernels.mechanics.newton_euler import Frames, Motion, Wrench
from lierb.kernels.mechanics.user_frames import UserFrame, moving
from lierb.kernels.numbers.arithmetic import flatten
from lierb.kernels.numbers.vec import cross, mat_vec, row
from lierb.kernels.numbers.zero import ZERO


@dataclass(frozen=True)
class UserWrench(Element):
    """User's wrench, a function of (t, R, r, ω, v) in the user's frames."""

    function: Function
    potential: Function | None = None
    discontinuities: tuple[str, ...] = ()
    is_users: ClassVar = True
    bounds_steps: ClassVar = True

    @property
    def is_conservative(self) -> bool:  # type: ignore[override]
        return self.potential is not None

    def placed(self, given: dict[str, Any], frames: Frames) -> tuple[Any, ...]:
        return UserFrame.of(frames), tuple(given.values())

    def wrench(self, placed: Any, x: Motion) -> Wrench:
        frame, parameters = UserFrame(*placed[0]), placed[1]
        r, place = frame.pose(x.q, x.place)
        omega, v = frame.twist(x.omega, x.v)
        wrench = self.function(parameters, x.time, r, place, omega, v, signals=x.signals)
        return frame.to_joint_axes(*wrench)

    def energy(self, placed: Any, x: Motion) -> Any:
        if self.potential is None:
            return ZERO
        return self.potential(placed[1], *UserFrame(*placed[0]).pose(x.q, x.place))

    def power(self, placed: Any, x: Motion, wrench: Wrench) -> Any:
        """Power of the wrench plus dU/dt; zero if the wrench derives from the potential U."""
        total = super().power(placed, x, wrench)
        if self.potential is None:
            return total
        frame = UserFrame(*placed[0])
        (r, place), (omega, v) = frame.pose(x.q, x.place), frame.twist(x.omega, x.v)
        turning = sum((cross(row(r, i), omega) for i in range(3)), start=())  # Ṙ = R ω̂
        energy = self.potential(placed[1], moving(r, turning), moving(place, mat_vec(r, v)))
        return total + energy.parts[0] if isinstance(energy, UserNumber) else total

    def jumps(self, placed: Any) -> tuple[Any, ...]:
        return times_of_jumps(self, placed[1])


def times_of_jumps(element: Element, parameters: tuple[Any, ...]) -> tuple[Any, ...]:
    """Return the parameters of a user's function that are times of possible jumps, s."""
    given = dict(zip(element.shapes, parameters, strict=False))  # `body` parameters come last
    return tuple(flatten(tuple(given[name] for name in element.discontinuities)))
