"""Explicit Runge–Kutta methods integrate (X, V, W, s), with any Butcher tableau.

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
from typing import Any

from lierb.kernels.numbers.arithmetic import fma, maximum, where
from lierb.kernels.numbers.vec import scale
from lierb.kernels.numbers.zero import ZERO
from lierb.kernels.stepping.method import Interval
from lierb.kernels.stepping.stages import StageMethod
from lierb.kernels.systems.scheme import ExplicitScheme, Stages
from lierb.kernels.systems.state import Factors, Slopes, State, Units
from lierb.kernels.systems.system import AnySystem


@dataclass(frozen=True)
class ExplicitRungeKutta(StageMethod):
    """An explicit Runge–Kutta method is commutator-free if its scheme has exponentials."""

    scheme: ExplicitScheme

    def with_stages(
        self, system: AnySystem, body: Any, state: State, at: Interval, slopes: Slopes, rows: Stages
    ) -> tuple[Slopes, Any]:
        """Return the slopes with those of further stages, and 1 where any stage is singular."""
        h, products = at.h, self.scheme.exponentials
        units = Units(0.5 * h, h, h, self.scheme.embedded is not None)
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

    @property
    def end_factors(self) -> Factors | None:
        return self.scheme.exponentials[-1] if self.scheme.exponentials else None

    def counts_in_steps(self, system: AnySystem) -> bool:
        """Return whether a step measures time by its own length h.

        Slopes are then h Ẋ and h² V̇, for h V under h² times gravity, and a stage's sums need no
        product with h. If all lanes have one h, such products are computed only once anyway.
        """
        is_own = self.scheme.embedded is not None and not self.scheme.exponentials
        return is_own and system.is_homogeneous

    def slope_units(self, system: AnySystem, h: Any) -> tuple[Any, Any]:
        """Return the factors of the sums of slopes for X, and for V or μ."""
        if not self.counts_in_steps(system):
            return h, h
        moves = h > 0.0  # false for idle lanes
        return 1.0, where(moves, 1.0 / where(moves, h, 1.0), 0.0)
