"""Explicit Runge–Kutta methods on (X, V, W, s), for any Butcher tableau.

Ẋ = dexp⁻¹_{−X} V and V̇ = F(X, V)  (Müller, eqs. 4a, b), with C = C₀ exp X. `local` update
(Munthe-Kaas): X starts at 0 in every step, structurally. `global` (the paper's): X continues, and
C₀ is updated before X reaches the pole of dexp⁻¹ at 2π (errata E18). `ambient`:
Ẏ = ½ (1 + Y) V with C = C₀ (1 + Y)/‖1 + Y‖, and Y starts at 0 in every step. W, the work of forces
without potential, is the integral of their power by the same method; s are the user's extra states.

A commutator-free method (Celledoni, Marthinsen and Owren 2003; Crouch and Grossman 1993) computes
each pose by several exponentials, C₀ exp(h Σ a¹ V) exp(h Σ a² V) …, and so needs no dexp⁻¹.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

from lierb.kernels.numbers.arithmetic import fma, maximum, where
from lierb.kernels.numbers.vec import Vec, scale
from lierb.kernels.numbers.zero import ZERO, is_zero
from lierb.kernels.stepping.method import Defect, Interval, Method, Step
from lierb.kernels.systems.combine import weighted
from lierb.kernels.systems.plan import AnyPlan, Embedded, Extension, Stages
from lierb.kernels.systems.state import Factors, Slopes, State, Units, Weights
from lierb.kernels.systems.system import AnySystem


@lru_cache(256)
def method_of(plan: AnyPlan) -> Method:
    """Method of a plan."""
    return ExplicitRungeKutta(
        plan.stages, plan.weights, plan.exponentials, plan.embedded, plan.extension
    )


@dataclass(frozen=True)
class ExplicitRungeKutta:
    """Explicit Runge–Kutta method; commutator-free if it has exponentials.

    stages : A, its strictly lower triangle row by row; rows for the error estimate are last.
    weights : b.   exponentials : weights for each stage, then for the end.
    """

    stages: Stages
    weights: tuple[float, ...]
    exponentials: tuple[Stages, ...] = ()
    embedded: Embedded | None = None
    extension: Extension | None = None

    @cached_property
    def last_stage(self) -> int:
        """Number of stages needed without error estimate and dense output."""
        return max(i for i, weight in enumerate(self.weights, 1) if weight != 0.0)

    def step(
        self, system: AnySystem, body: Any, state: State, at: Interval, all_stages: bool = False
    ) -> Step:
        rows = self.stages if all_stages else self.stages[: self.last_stage]
        slopes, singular = self._stages(system, body, state, at, Slopes(), rows, self.exponentials)
        end = self.exponentials[-1] if self.exponentials else None
        ended = self._ended(system, body, state, at.h, slopes, self.weights, end)
        kept = system.stabilised(body, state, ended, at.time + at.span, at.h)
        if not is_zero(kept.singular):
            singular = maximum(singular, kept.singular)
        return Step(kept.state, slopes, singular, kept)

    def extended(
        self, system: AnySystem, body: Any, state: State, at: Interval, slopes: Slopes
    ) -> Slopes:
        """Append the further stages of the continuous extension."""
        assert self.extension is not None
        return self._stages(system, body, state, at, slopes, self.extension.stages)[0]

    def between(
        self, system: AnySystem, body: Any, state: State, at: Interval, slopes: Slopes, theta: Any
    ) -> State:
        """State at time + θ h, by the continuous extension or, without one, by a step of θ h.

        The pose is C₀ exp X(θ): on the group, and for a subgroup joint on its subgroup.
        """
        if self.extension is None:
            return self.step(system, body, state, at.part(theta)).state
        weights = tuple(_polynomial(theta, terms) for terms in self.extension.weights)
        ended = self._ended(system, body, state, at.h, slopes, weights, None)
        time = fma(theta, at.span, at.time)
        return system.stabilised(body, state, ended, time, theta * at.h).state

    def defects(self, system: AnySystem, body: Any, slopes: Slopes, h: Any) -> tuple[Defect, ...]:
        """h Σ weights · slopes for the weights of each error estimate."""
        assert self.embedded is not None
        return tuple(
            self._defect(system, body, slopes, h, weights) for weights in self.embedded.weights
        )

    def _defect(
        self, system: AnySystem, body: Any, slopes: Slopes, h: Any, weights: tuple[float, ...]
    ) -> Defect:
        base, rest = beside_the_step(self.weights, weights)

        def times(unit: Any, rates: tuple[Vec, ...]) -> Vec:
            total = weighted((ZERO,) * len(rates[0]), base, rates)
            return tuple(unit * each for each in weighted(total, rest, rates))

        x_unit, unit = self._slope_units(system, h)
        x, v_or_mu = times(x_unit, slopes.x), times(unit, slopes.v_or_mu)
        states = times(h, slopes.states)
        turning, moving = system.turning_and_moving(system.in_algebra(body, x))
        return Defect(turning, moving, system.velocity(body, v_or_mu), states)

    def _stages(
        self,
        system: AnySystem,
        body: Any,
        state: State,
        at: Interval,
        slopes: Slopes,
        rows: Stages,
        products: tuple[Factors, ...] = (),
    ) -> tuple[Slopes, Any]:
        """Return the slopes with those of further stages, and 1 where any stage is singular."""
        h = at.h
        units = Units(0.5 * h, h, h, self.embedded is not None)
        gravity = system.chart_gravity(body, state.chart)
        if self.counts_in_steps(system):
            gravity = scale(h * h, gravity)
            state = state._replace(v_or_mu=scale(h, state.v_or_mu))
            units = Units(0.5, 1.0, h)
        singular: Any = ZERO
        for i, weights in enumerate(rows):
            factors = products[i] if products else None
            stage = system.combine(body, state, weights, slopes, units, factors)
            falling = gravity
            if factors is not None:
                falling = system.chart_gravity(body, stage.chart)
            time = fma(at.span, sum(weights), at.time)
            rates = system.stage_rates(body, stage, falling, time, len(slopes.x))
            slopes = slopes.with_stage(rates)
            singular = maximum(singular, rates.singular)
        return slopes, singular

    def _ended(
        self,
        system: AnySystem,
        body: Any,
        state: State,
        h: Any,
        slopes: Slopes,
        weights: Weights,
        factors: Factors | None,
    ) -> State:
        """State with h Σ weights · slopes; the pose by all factors, or by one exponential."""
        x_unit, unit = self._slope_units(system, h)
        # Sums without the state also appear in error estimates.
        units = Units(0.5 * x_unit, unit, h, self.embedded is not None)
        ended = system.combine(body, state, weights, slopes, units, factors)
        return ended if factors is not None else system.move(body, ended)

    def counts_in_steps(self, system: AnySystem) -> bool:
        """Return whether a step measures time by its own length h.

        Slopes are then h Ẋ and h² V̇, for h V under h² times gravity, and a stage's sums need no
        product with h. If all lanes have one h, such products are computed only once anyway.
        """
        is_own = self.embedded is not None and not self.exponentials
        return is_own and system.is_homogeneous

    def _slope_units(self, system: AnySystem, h: Any) -> tuple[Any, Any]:
        """Factors of the sums of slopes for X, and for V or μ."""
        if not self.counts_in_steps(system):
            return h, h
        moves = h > 0.0  # false for idle lanes
        return 1.0, where(moves, 1.0 / where(moves, h, 1.0), 0.0)


def beside_the_step(
    step: tuple[float, ...], error: tuple[float, ...]
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Split an error's weights into those of the step and few others, if that is shorter.

    The step's sum is emitted as in the step itself, so that LLVM computes it only once. DOP853's
    weights of third order differ from the step's in 3 of 12.
    """
    step += (0.0,) * (len(error) - len(step))
    rest = tuple(e - b for e, b in zip(error, step, strict=True))
    if sum(map(bool, rest)) < sum(map(bool, error)):
        return step, rest
    return (), error


def _polynomial(theta: Any, terms: tuple[float, ...]) -> Any:
    """Return Σ terms[k] θᵏ⁺¹; 0.0 where there are none."""
    if not any(terms):
        return 0.0
    *lower, total = terms
    total = theta * total
    for term in reversed(lower):
        total = theta * (total + term)
    return total
