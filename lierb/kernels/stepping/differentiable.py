"""Implicit methods with derivatives of the run: their steps differentiate formulas themselves.

The numbers of a step are `lifted`, so that these derivatives do not mix.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

from lierb.kernels.numbers.dual import lifted, values
from lierb.kernels.stepping.method import Defect, Interval, Method, Step
from lierb.kernels.systems.state import Slopes, State
from lierb.kernels.systems.system import AnySystem


@dataclass(frozen=True)
class WrappedMethod:
    """A method whose steps another method makes, on other numbers; see `Method`."""

    method: Method

    def evaluated(self, formula: Callable[..., Any], *operands: Any) -> Any:
        """Return formula(*operands), with derivatives."""
        raise NotImplementedError

    def started(self, system: AnySystem, body: Any, state: State, at: Interval) -> State:
        return self.evaluated(partial(self.method.started, system), body, state, at)

    def step(
        self, system: AnySystem, body: Any, state: State, at: Interval, all_stages: bool = False
    ) -> Step:
        step = partial(self.method.step, system, all_stages=all_stages)
        return self.evaluated(step, body, state, at)

    def defects(self, system: AnySystem, body: Any, slopes: Slopes, h: Any) -> tuple[Defect, ...]:
        return self.method.defects(system, body, slopes, h)

    def extrapolated(self, system: AnySystem, state: State, slopes: Slopes, h: Any) -> State:
        return self.method.extrapolated(system, state, slopes, h)

    def extended(
        self, system: AnySystem, body: Any, state: State, at: Interval, slopes: Slopes
    ) -> Slopes:
        return self.evaluated(partial(self.method.extended, system), body, state, at, slopes)

    def between(
        self, system: AnySystem, body: Any, state: State, at: Interval, slopes: Slopes, theta: Any
    ) -> State:
        between = partial(self.method.between, system)
        return self.evaluated(between, body, state, at, slopes, theta)


@dataclass(frozen=True)
class DifferentiableMethod(WrappedMethod):
    """Steps of the method have numbers with derivatives."""

    def evaluated(self, formula: Callable[..., Any], *operands: Any) -> Any:
        return values(formula(*lifted(operands)))
