"""Protocol of a method: how a state becomes the one a step later."""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol

from lierb.kernels.numbers.vec import Vec
from lierb.kernels.systems.state import Slopes, Stabilised, State
from lierb.kernels.systems.system import AnySystem


class Interval(NamedTuple):
    """Interval of a step.

    time, span : its beginning and length as functions of time read them, s. They differ from the
        step's own where something jumps at its ends.
    h : length of the step, s.
    """

    time: Any
    span: Any
    h: Any

    def part(self, theta: Any) -> Interval:
        """Interval of the first part θ of the step."""
        return Interval(self.time, theta * self.span, theta * self.h)


class Step(NamedTuple):
    """Result of a step.

    slopes : rates of the stages, from which errors and states between the ends follow.
    singular : 1 where a stage met a singular configuration.
    stabilised : the state with the corrections of the stabilisation.
    """

    state: State
    slopes: Slopes
    singular: Any
    stabilised: Stabilised


class Defect(NamedTuple):
    """Difference of two states, as an error estimate has it; n as in `System`.

    x : in the algebra (n,), rad and m.   twist : of V (n,), rad/s and m/s.   states : of the rest.
    """

    x: Vec
    twist: Vec
    states: Vec


class Method(Protocol):
    """One-step method, on any system.   state : at the start of the step, which `at` describes."""

    def step(
        self, system: AnySystem, body: Any, state: State, at: Interval, all_stages: bool = False
    ) -> Step:
        """Step by h.   all_stages : also those for error estimate and dense output alone."""

    def defects(self, system: AnySystem, body: Any, slopes: Slopes, h: Any) -> tuple[Defect, ...]:
        """Error estimates of a step with these slopes, the one of highest order first."""

    def extended(
        self, system: AnySystem, body: Any, state: State, at: Interval, slopes: Slopes
    ) -> Slopes:
        """Append the slopes that only `between` needs."""

    def between(
        self, system: AnySystem, body: Any, state: State, at: Interval, slopes: Slopes, theta: Any
    ) -> State:
        """State at time + θ h, 0 ≤ θ ≤ 1.   slopes : those of `extended`."""
