"""Methods without error estimate and continuous extension are for fixed steps."""

from __future__ import annotations

from typing import Any

from lierb.kernels.stepping.method import Defect, Interval, Step
from lierb.kernels.systems.state import Slopes, Stabilised, State
from lierb.kernels.systems.system import AnySystem


class UnestimatedMethod:
    """The steps of such a method have no slopes; see `lierb.kernels.stepping.method.Method`."""

    def started(self, system: AnySystem, body: Any, state: State, at: Interval) -> State:
        return state

    def step(
        self, system: AnySystem, body: Any, state: State, at: Interval, all_stages: bool = False
    ) -> Step:
        raise NotImplementedError

    def defects(self, system: AnySystem, body: Any, slopes: Slopes, h: Any) -> tuple[Defect, ...]:
        return ()

    def extrapolated(self, system: AnySystem, state: State, slopes: Slopes, h: Any) -> State:
        return state

    def extended(
        self, system: AnySystem, body: Any, state: State, at: Interval, slopes: Slopes
    ) -> Slopes:
        return slopes

    def between(
        self, system: AnySystem, body: Any, state: State, at: Interval, slopes: Slopes, theta: Any
    ) -> State:
        """Return the state at time + θ h, by a step of θ h."""
        return self.step(system, body, state, at.part(theta)).state


def ended(state: State, singular: Any, unsolved: Any, turns: Any) -> Step:
    """Return the step that ends in a state."""
    return Step(state, Slopes(), singular, Stabilised(state), unsolved, turns)
