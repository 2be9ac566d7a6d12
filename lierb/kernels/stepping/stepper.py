"""One step of an explicit Runge–Kutta method on (X, V, W), for any Butcher tableau.

Ẋ = dexp⁻¹_{−X} V and V̇ = F(X, V)  (Müller, eqs. 4a, b), with C = C₀ exp X. `local` update
(Munthe-Kaas): X starts at 0 in every step, structurally. `global` (the paper's): X carries on, and
C₀ moves up before dexp⁻¹ meets its pole at 2π (errata E18). W, the work of what has no potential,
is the same method's quadrature of its power.
"""

from __future__ import annotations

from functools import partial
from typing import Any

from lierb.kernels.numbers.arithmetic import fma, maximum
from lierb.kernels.numbers.vec import Vec
from lierb.kernels.numbers.zero import ZERO, is_zero
from lierb.kernels.stepping.plan import AnyPlan
from lierb.kernels.stepping.state import State


def step(plan: AnyPlan, body: Any, state: State, time: Any, h: Any) -> tuple[State, Any]:
    """The state h seconds after `time`, and the mark of a singular configuration on the way."""
    formulation = plan.formulation
    before = formulation.before_step(body, state.chart)
    stage = partial(formulation.rates, body, state.chart, before)
    x_rates: list[Vec] = []
    rates: list[Vec] = []  # of V or μ
    powers: list[Vec] = []
    singular: Any = ZERO
    for weights, node in zip(plan.stages, plan.nodes, strict=True):
        x = formulation.in_algebra(body, _advanced(state.x, 0.5 * h, weights, x_rates))
        v_or_mu = _advanced(state.v_or_mu, h, weights, rates)
        found = stage(x, v_or_mu, fma(h, node, time))
        x_rates.append(found.x)
        rates.append(found.v_or_mu)
        powers.append((found.power,))
        singular = maximum(singular, found.singular)
    x = formulation.in_algebra(body, _advanced(state.x, 0.5 * h, plan.weights, x_rates))
    v_or_mu = _advanced(state.v_or_mu, h, plan.weights, rates)
    (work,) = _advanced((state.work,), h, plan.weights, powers)
    if plan.is_local:
        chart, x = formulation.moved(state.chart, x), (ZERO,) * len(x)
    else:
        chart, x = formulation.recharted(state.chart, x)
    stepped = State(chart, x, v_or_mu, work)
    kept, off = formulation.stabilised(body, stepped, time + h)
    return kept, singular if is_zero(off) else maximum(singular, off)


def _advanced(base: Vec, h: Any, weights: tuple[float, ...], rates: list[Vec]) -> Vec:
    """base + h Σ wⱼ kⱼ; zero weights cost nothing, and h wⱼ does not depend on the step."""
    total = base
    for weight, rate in zip(weights, rates, strict=False):
        if weight != 0.0:
            hw = h * weight
            total = tuple(fma(hw, k, x) for k, x in zip(rate, total, strict=True))
    return total
