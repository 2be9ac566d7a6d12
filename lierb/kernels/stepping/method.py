"""A protocol describes one-step methods, their arguments and their results."""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol

from lierb.kernels.numbers.vec import Vec
from lierb.kernels.numbers.zero import ZERO
from lierb.kernels.systems.state import Slopes, Stabilised, State
from lierb.kernels.systems.system import AnySystem


class Interval(NamedTuple):
    """Hold the interval of a step.

    time, span : beginning and length for functions of time, s. They differ from those of the step
        if an element jumps at its ends.
    h : length of the step, s.
    """

    time: Any
    span: Any
    h: Any

    def part(self, theta: Any) -> Interval:
        """Return the interval of the first fraction θ of the step."""
        return Interval(self.time, theta * self.span, theta * self.h)


class Step(NamedTuple):
    """Hold the result of a step.

    slopes : rates of the stages, for error estimates and dense output.
    singular : 1 where a stage has a singular configuration.
    stabilised : the state at the end, with the corrections by stabilisation.
    unsolved : 1 where an iteration has not converged.   turns : number of its turns.
    """

    state: State
    slopes: Slopes
    singular: Any
    stabilised: Stabilised
    unsolved: Any = ZERO
    turns: Any = ZERO


class Defect(NamedTuple):
    """The defect is an error estimate, a difference of two states; n as in `System`.

    turning, moving : of the poses, rad and m; see `System.turning_and_moving`.
    twist : of V (n,), rad/s and m/s.   states : of the extra states.
    """

    turning: Vec
    moving: Vec
    twist: Vec
    states: Vec


class Method(Protocol):
    """A one-step method works for any system.

    state : at the start of a step.   at : its interval.
    """

    def started(self, system: AnySystem, body: Any, state: State, at: Interval) -> State:
        """Return the state with the numbers that the method carries before its first step."""

    def step(
        self, system: AnySystem, body: Any, state: State, at: Interval, all_stages: bool = False
    ) -> Step:
        """Make a step by h.   all_stages : also those only for error estimate and dense output."""

    def defects(self, system: AnySystem, body: Any, slopes: Slopes, h: Any) -> tuple[Defect, ...]:
        """Return the step's error estimates with these slopes, the one of highest order first."""

    def extrapolated(self, system: AnySystem, state: State, slopes: Slopes, h: Any) -> State:
        """Return the state with the V or μ that its rates at the start give after h."""

    def extended(
        self, system: AnySystem, body: Any, state: State, at: Interval, slopes: Slopes
    ) -> Slopes:
        """Append the slopes that are needed for dense output only."""

    def between(
        self, system: AnySystem, body: Any, state: State, at: Interval, slopes: Slopes, theta: Any
    ) -> State:
        """Return the state at time + θ h, 0 ≤ θ ≤ 1.   slopes : those of `extended`."""
