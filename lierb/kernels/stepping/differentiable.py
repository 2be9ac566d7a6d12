"""Implicit methods with derivatives of the run: their steps differentiate formulas themselves.

The numbers of a step are `lifted`, so that these derivatives do not mix.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from lierb.kernels.numbers.dual import lifted, values
from lierb.kernels.stepping.method import Defect, Interval, Method, Step
from lierb.kernels.systems.state import Slopes, State
from lierb.kernels.systems.system import AnySystem


@dataclass(frozen=True)
class DifferentiableMethod:
    """Steps of the method have numbers with derivatives; see `Method`."""

    method: Method

    def started(self, system: AnySystem, body: Any, state: State, at: Interval) -> State:
        return values(self.method.started(system, *lifted((body, state, at))))

    def step(
        self, system: AnySystem, body: Any, state: State, at: Interval, all_stages: bool = False
    ) -> Step:
        body, state, at = lifted((body, state, at))
        return values(self.method.step(system, body, state, at, all_stages))

    def defects(self, system: AnySystem, body: Any, slopes: Slopes, h: Any) -> tuple[Defect, ...]:
        return self.method.defects(system, body, slopes, h)

    def extrapolated(self, system: AnySystem, state: State, slopes: Slopes, h: Any) -> State:
        return self.method.extrapolated(system, state, slopes, h)

    def extended(
        self, system: AnySystem, body: Any, state: State, at: Interval, slopes: Slopes
    ) -> Slopes:
        numbers = lifted((body, state, at, slopes))
        return values(self.method.extended(system, *numbers))

    def between(
        self, system: AnySystem, body: Any, state: State, at: Interval, slopes: Slopes, theta: Any
    ) -> State:
        numbers = lifted((body, state, at, slopes, theta))
        return values(self.method.between(system, *numbers))
