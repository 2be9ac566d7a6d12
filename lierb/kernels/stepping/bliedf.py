"""Backward differentiation formulas on a Lie group (BLieDF) of index 3, of one and of two steps.

With C₁ = C₀ exp hΔ₀, the increment before, Δ₋₁, and the velocities V₀ and V₋₁ before,

    V₁ = γ₀ Δ₀ + γ₁ Δ₋₁,   h V̇₁ = α₀ V₁ + α₁ V₀ + α₂ V₋₁,   γ₀ = α₀,   γ₁ = α₀ + α₁.

`lierb.kernels.stepping.descriptor_method` solves these for V̇₁ and λ₁.

On a linear space V₁ is the usual difference of poses. On a group an increment is the mean velocity
of its step up to h² (V̈/24 + [V, V̇]/12). This term is nearly equal in Δ₀ and Δ₋₁, so that the
formula of two steps keeps order 2. More steps would need the commutator as a correction.

Two steps start with V₋₁ = V₀ − h V̇₀ + ½h² V̈₀ and Δ₋₁ = V₀ − ½h V̇₀, where V̈₀ is from a look ahead. A
first step of order 1 would leave an error of h² in the pose, and one of order h in the velocity.

Wieloch and Arnold, J. Comput. Appl. Math. 387 (2021).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from lierb.kernels.numbers.vec import Vec, axpy, scale, sub
from lierb.kernels.stepping.descriptor_method import DescriptorMethod, Predicted, look_ahead
from lierb.kernels.stepping.method import Interval
from lierb.kernels.systems.scheme import BLieDFScheme
from lierb.kernels.systems.state import State

ALPHA = {1: (1.0, -1.0), 2: (1.5, -2.0, 0.5)}


@dataclass(frozen=True)
class BLieDF(DescriptorMethod):
    """The formula has as many steps as the order of its scheme."""

    scheme: BLieDFScheme

    def started(self, system: Any, body: Any, state: State, at: Interval) -> State:
        """Return the state with V̇ and λ at the start, and with two steps V₋₁ and Δ₋₁."""
        rate, multipliers, later = look_ahead(system, body, state, at)
        own: Vec = ()
        if self.scheme.order == 2:
            velocity = axpy(-at.h, rate, state.v_or_mu)
            velocity = axpy(0.5 * at.h, sub(later, rate), velocity)
            own = (*velocity, *axpy(-0.5 * at.h, rate, state.v_or_mu))
        return state._replace(carried=(*rate, *own, *multipliers))

    def predicted(self, state: State, h: Any) -> Predicted:
        first, second, *third = ALPHA[self.scheme.order]
        share = h * (1.0 / first)
        velocity = increment = scale(-second / first, state.v_or_mu)
        if third:
            n = len(state.v_or_mu)
            earlier, before = state.carried[n : 2 * n], state.carried[2 * n : 3 * n]
            velocity = axpy(-third[0] / first, earlier, velocity)
            increment = axpy(-(first + second), before, velocity)
        return Predicted(scale(share, increment), velocity, share * share, share)

    def own(self, state: State, h: Any, x: Vec, rate: Vec) -> Vec:
        """Return V₀ and Δ₀ of two steps, which are V₋₁ and Δ₋₁ of the next step."""
        return () if self.scheme.order == 1 else (*state.v_or_mu, *scale(1.0 / h, x))
