"""Rosenbrock methods integrate (X, V, W, s) in the chart of each step, without iteration.

They are for stiff systems.

With y the independent numbers of X, V or μ, extra states and work, and J the Jacobian of ẏ at the
start of the step, (1 − γhJ) kᵢ = γ (ẏ(t + αᵢ h, y + h Σ Aᵢⱼ kⱼ) + Σ Cᵢⱼ kⱼ + γᵢ h ∂ẏ/∂t). J is
exact, by dual numbers. On a subgroup joint X stays in the subalgebra 𝔥: ẏ maps 𝔥 × 𝔥 into itself,
and so does its Jacobian.

Hairer and Wanner, Solving Ordinary Differential Equations II, IV.7.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from lierb.kernels.numbers.arithmetic import fma, maximum
from lierb.kernels.numbers.elimination import Factored, less
from lierb.kernels.numbers.vec import axpy, scale
from lierb.kernels.numbers.zero import ZERO
from lierb.kernels.stepping.method import Interval
from lierb.kernels.stepping.stages import StageMethod
from lierb.kernels.systems.combine import weighted
from lierb.kernels.systems.scheme import RosenbrockScheme, Stages
from lierb.kernels.systems.state import Slopes, State, Units
from lierb.kernels.systems.system import AnySystem
from lierb.kernels.systems.unknowns import Jacobian, Unknowns


@dataclass(frozen=True)
class Rosenbrock(StageMethod):
    """Rosenbrock method; its slopes kᵢ are no rates of the stages."""

    scheme: RosenbrockScheme

    def with_stages(
        self, system: AnySystem, body: Any, state: State, at: Interval, slopes: Slopes, rows: Stages
    ) -> tuple[Slopes, Any]:
        if not rows:  # a continuous extension without further stages
            return slopes, ZERO
        scheme, h = self.scheme, at.h
        unknowns = Unknowns(system, state)
        gravity = system.chart_gravity(body, state.chart)
        rates, jacobian = unknowns.jacobian(body, gravity, at.time)
        factored = Factored(_iteration_matrix(jacobian, h * scheme.gamma))
        units = Units(0.5 * h, h, h, scheme.embedded is not None)
        found: tuple[Any, ...] = ()
        singular = rates.singular
        known: tuple[tuple[float, ...], float] = (), 0.0
        for weights, couplings, node, late in zip(
            rows, scheme.couplings, scheme.nodes, scheme.late, strict=False
        ):
            place = tuple(w for w in weights if w), node
            if place != known:  # a stage at the place of the one before has the same rates
                known = place
                stage = system.combine(body, state, weights, slopes, units)
                time = fma(at.span, node, at.time)
                rates = system.stage_rates(body, stage, gravity, time, len(found))
                singular = maximum(singular, rates.singular)
            right = weighted(unknowns.of(rates), couplings, found)
            right = axpy(h * late, jacobian.late, right) if late else right
            k = factored.solve(scale(scheme.gamma, right))
            found = (*found, k)
            slopes = slopes.with_stage(unknowns.rates(body, k))
        return slopes, singular

    def extrapolated(self, system: AnySystem, state: State, slopes: Slopes, h: Any) -> State:
        """Return the state with the V or μ after h of its first slope, γ ẏ where J is small."""
        return super().extrapolated(system, state, slopes, h / self.scheme.gamma)


def _iteration_matrix(jacobian: Jacobian, unit: Any) -> list[list[Any]]:
    """Return 1 − hγJ.   unit : hγ."""
    return [
        [less(1.0 if i == j else ZERO, unit, slope) for j, slope in enumerate(row)]
        for i, row in enumerate(jacobian.rows)
    ]
