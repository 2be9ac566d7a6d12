"""Add weighted slopes of a step to states, and move the pose."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from lierb.kernels.numbers.arithmetic import fma, where
from lierb.kernels.numbers.vec import Vec
from lierb.kernels.numbers.zero import ZERO, is_zero
from lierb.kernels.systems.signals import PassiveElements
from lierb.kernels.systems.state import Factors, Rates, Slopes, State, Units, Weights

NAN = float("nan")


class StateArithmetic(PassiveElements):
    """All systems share this arithmetic, on the charts of each."""

    width: int  # numbers of X, or of Y within a step
    moved: Callable[..., Any]  # (chart, X/2): C₀ exp X
    ended: Callable[..., Any]  # (chart, X/2 or Y): the chart moved by a step
    recharted: Callable[..., Any]  # (C₀ exp X, 0) where X is large, else (C₀, X)
    in_algebra: Callable[..., Vec]
    rates: Callable[..., Rates]

    def combine(
        self,
        body: Any,
        state: State,
        weights: Weights,
        slopes: Slopes,
        units: Units,
        factors: Factors | None = None,
    ) -> State:
        """Add h Σ weights · slopes to X or Y, V or μ, work and extra states.

        factors : rows a of a commutator-free method. The pose is then
            C₀ exp(h Σ a¹ V) exp(h Σ a² V) …, and X is zero.
        """
        chart, x = state.chart, state.x
        if self.plan.is_local:
            x = (ZERO,) * self.width
        if factors is None:
            x = self.in_algebra(body, summed(x, units.x, weights, slopes.x, units))
        else:
            chart = self._product(body, chart, factors, slopes.x, units)
            x = (ZERO,) * self.width
        v_or_mu = summed(state.v_or_mu, units.v_or_mu, weights, slopes.v_or_mu, units)
        (work,) = summed((state.work,), units.other, weights, slopes.work, units)
        states = summed(state.states, units.other, weights, slopes.states, units)
        return State(chart, x, v_or_mu, work, states)

    def move(self, body: Any, state: State) -> State:
        """Move C₀ by exp X or (1 + Y)/‖1 + Y‖; in a global update, only where X is large."""
        if self.plan.is_local:
            return self.placed_by_chart(state)
        chart, x = self.recharted(state.chart, state.x)
        return state._replace(chart=chart, x=x)

    def velocity(self, body: Any, v_or_mu: Vec) -> Vec:
        return v_or_mu

    def silenced(self, body: Any, v_or_mu: Vec, alive: Any) -> Vec:
        return tuple(x if is_zero(x) else where(alive, x, NAN) for x in v_or_mu)

    def placed_by_chart(self, state: State) -> State:
        """Return the state with its pose as its chart, and X structurally zero."""
        chart = self.ended(state.chart, state.x)
        return state._replace(chart=chart, x=(ZERO,) * len(state.v_or_mu))

    def stage_rates(
        self, body: Any, state: State, gravity: Any, time: Any, stage: int = 0
    ) -> Rates:
        """Return the rates at C₀ exp X, including those of extra states; see `rates`."""
        if not state.states:
            return self.rates(body, state, gravity, time)
        body = body._replace(signals=body.signals._replace(states=state.states))
        motion = self.motion(body, self.placed_by_chart(state), time)
        of_states = self.state_rates(body, motion, time)
        return self.rates(body, state, gravity, time)._replace(states=of_states)

    def _product(
        self, body: Any, chart: Any, factors: Factors, velocities: tuple[Vec, ...], units: Units
    ) -> Any:
        """Return C₀ exp(h Σ a¹ V) exp(h Σ a² V) …"""
        for weights in factors:
            if any(weights):
                zero = tuple(0.0 * x for x in velocities[0])
                x = summed(zero, units.x, weights, velocities, units)
                chart = self.moved(chart, self.in_algebra(body, x))
        return chart


def summed(base: Vec, unit: Any, weights: Weights, slopes: tuple[Vec, ...], units: Units) -> Vec:
    """Return base + unit Σ wⱼ kⱼ."""
    if not units.sums_first:
        return weighted(base, weights, slopes, unit)
    total = weighted((ZERO,) * len(base), weights, slopes)
    return tuple(fma(unit, k, x) for k, x in zip(total, base, strict=True))


def weighted(base: Vec, weights: Weights, slopes: tuple[Vec, ...], h: Any = None) -> Vec:
    """Return base + Σ (h wⱼ) kⱼ, or base + Σ wⱼ kⱼ without h; zero weights are skipped."""
    total = base
    for weight, slope in zip(weights, slopes, strict=False):
        if not (isinstance(weight, float) and weight == 0.0):
            factor = weight if h is None else h * weight
            total = tuple(fma(factor, k, x) for k, x in zip(slope, total, strict=True))
    return total
