"""One step of an explicit Runge–Kutta method on (X, V, W, s), for any Butcher tableau.

Ẋ = dexp⁻¹_{−X} V and V̇ = F(X, V)  (Müller, eqs. 4a, b), with C = C₀ exp X. `local` update
(Munthe-Kaas): X starts at 0 in every step, structurally. `global` (the paper's): X carries on, and
C₀ moves up before dexp⁻¹ meets its pole at 2π (errata E18). W, the work of what has no potential,
is the same method's quadrature of its power; s are the user's own states.

A commutator-free method (Celledoni, Marthinsen and Owren 2003; Crouch and Grossman 1993) makes each
pose of several exponentials, C₀ exp(h Σ a¹ V) exp(h Σ a² V) …, and so needs no dexp⁻¹.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from lierb.kernels.numbers.arithmetic import fma, maximum, where
from lierb.kernels.numbers.vec import Vec, scale
from lierb.kernels.numbers.zero import ZERO, is_zero
from lierb.kernels.systems.extra_states import rates_of_states, with_states
from lierb.kernels.systems.plan import AnyPlan
from lierb.kernels.systems.signals import states_of
from lierb.kernels.systems.state import Stabilised, State
from lierb.kernels.systems.system_of import formulation_of

Rows = tuple[tuple[float, ...], ...]


class Slopes(NamedTuple):
    """What the stages of a step have found, one entry each; by h where `counts_in_steps`."""

    x: tuple[Vec, ...]  # Ẋ; of a commutator-free method V
    v_or_mu: tuple[Vec, ...]
    work: tuple[Vec, ...]
    states: tuple[Vec, ...]


class Step(NamedTuple):
    """What a step comes to.   singular : the mark of a singular configuration on the way.

    kept : what the stabilisation has made of the state.
    """

    state: State
    slopes: Slopes
    singular: Any
    kept: Stabilised


def step(plan: AnyPlan, body: Any, state: State, time: Any, h: Any) -> tuple[State, Any]:
    """The state h seconds after `time`, and the mark of a singular configuration on the way."""
    made = trial_step(plan, body, state, time, h, h)
    return made.state, made.singular


def trial_step(
    plan: AnyPlan,
    body: Any,
    state: State,
    time: Any,
    span: Any,
    h: Any,
    all_stages: bool = False,
) -> Step:
    """The same with the stages' slopes.

    time, span : beginning and length of the step as functions of time see it, s.
    all_stages : also those that only the error estimate or the continuous extension asks for.
    """
    stages = plan.stages if all_stages else plan.stages[: plan.last_stage]
    products = plan.exponentials[: len(stages)]
    slopes, singular = _stages(
        plan,
        body,
        state,
        time,
        span,
        h,
        Slopes((), (), (), ()),
        stages,
        products or (None,) * len(stages),
    )
    end = plan.exponentials[-1] if plan.exponentials else None
    stepped = _combined(plan, body, state, h, slopes, plan.weights, end)
    kept = formulation_of(plan).stabilised(body, state, stepped, time + span, h)
    if not is_zero(kept.singular):
        singular = maximum(singular, kept.singular)
    return Step(kept.state, slopes, singular, kept)


def extended(
    plan: AnyPlan, body: Any, state: State, time: Any, span: Any, h: Any, slopes: Slopes
) -> Slopes:
    """With the further stages of the continuous extension."""
    assert plan.extension is not None
    rows = plan.extension.stages
    found, _ = _stages(plan, body, state, time, span, h, slopes, rows, (None,) * len(rows))
    return found


def between(
    plan: AnyPlan,
    body: Any,
    state: State,
    time: Any,
    span: Any,
    h: Any,
    slopes: Any,
    theta: Any,
) -> State:
    """The state θ h after `time`, 0 ≤ θ ≤ 1: by the method's continuous extension, or, where it
    has none, by a step of its own to there.

    The pose is C₀ exp X(θ): on the group, and for a subgroup joint on its subgroup.
    slopes : of all stages and of those of the extension.
    """
    extension = plan.extension
    if extension is None:
        return trial_step(plan, body, state, time, theta * span, theta * h).state
    weights = tuple(_polynomial(theta, terms) for terms in extension.weights)
    found = _combined(plan, body, state, h, slopes, weights, None)
    time, h = fma(theta, span, time), theta * h
    kept: State = formulation_of(plan).stabilised(body, state, found, time, h).state
    return kept


def _polynomial(theta: Any, terms: tuple[float, ...]) -> Any:
    """Σ terms[k] θᵏ⁺¹; 0.0 where there are none."""
    if not any(terms):
        return 0.0
    *lower, total = terms
    total = theta * total
    for term in reversed(lower):
        total = theta * (total + term)
    return total


def _stages(
    plan: AnyPlan,
    body: Any,
    state: State,
    time: Any,
    span: Any,
    h: Any,
    known: Slopes,
    rows: Rows,
    products: tuple[Rows | None, ...],
) -> tuple[Slopes, Any]:
    """The slopes of further stages behind those `known`, and the mark of a singular one."""
    formulation = formulation_of(plan)
    before, start = formulation.before_step(body, state.chart), state.v_or_mu
    x_unit, unit = 0.5 * h, h
    if counts_in_steps(plan):
        before, start, x_unit, unit = scale(h * h, before), scale(h, start), 0.5, 1.0
    x_rates, rates, powers, more = map(list, known)
    singular: Any = ZERO
    for weights, factors in zip(rows, products, strict=True):
        x = formulation.in_algebra(body, _advanced(plan, state.x, x_unit, weights, x_rates))
        v_or_mu = _advanced(plan, start, unit, weights, rates)
        states = _advanced(plan, state.states, h, weights, more)
        at = fma(span, sum(weights), time)
        chart, falling = state.chart, before
        if factors is not None:
            chart, x = _product(plan, body, chart, h, factors, x_rates), (ZERO,) * len(x)
            falling = formulation.before_step(body, chart)
        found = rates_at(plan, body, chart, falling, x, v_or_mu, states, at)
        x_rates.append(found.x)
        rates.append(found.v_or_mu)
        powers.append((found.power,))
        more.append(found.states)
        singular = maximum(singular, found.singular)
    return Slopes(tuple(x_rates), tuple(rates), tuple(powers), tuple(more)), singular


def _combined(
    plan: AnyPlan,
    body: Any,
    state: State,
    h: Any,
    slopes: Slopes,
    weights: tuple[Any, ...],
    factors: Rows | None,
) -> State:
    """The state with h Σ weights · slopes, its pose by so many exponentials, or by one."""
    formulation = formulation_of(plan)
    x_unit, unit = units_of(plan, h)
    v_or_mu = _ended(plan, state.v_or_mu, unit, weights, slopes.v_or_mu)
    (work,) = _ended(plan, (state.work,), h, weights, slopes.work)
    states = _ended(plan, state.states, h, weights, slopes.states)
    still = (ZERO,) * len(state.x)
    if factors is not None:
        chart, x = _product(plan, body, state.chart, h, factors, slopes.x), still
    else:
        x = formulation.in_algebra(body, _ended(plan, state.x, 0.5 * x_unit, weights, slopes.x))
        if plan.is_local:
            chart, x = formulation.moved(state.chart, x), still
        else:
            chart, x = formulation.recharted(state.chart, x)
    return State(chart, x, v_or_mu, work, states)


def _product(plan: AnyPlan, body: Any, chart: Any, h: Any, factors: Rows, slopes: Any) -> Any:
    """C₀ exp(h Σ a¹ V) exp(h Σ a² V) …"""
    formulation = formulation_of(plan)
    for weights in factors:
        if any(weights):
            still = tuple(0.0 * x for x in slopes[0])
            x = formulation.in_algebra(body, _advanced(plan, still, 0.5 * h, weights, slopes))
            chart = formulation.moved(chart, x)
    return chart


def counts_in_steps(plan: AnyPlan) -> bool:
    """Whether a step measures time by its own length h: its slopes are h Ẋ and h² V̇, of h V under
    h² times gravity, and a stage's sums need no product with h. Where all lanes have one h, such
    products are made but once.
    """
    is_own = plan.embedded is not None and not plan.exponentials and not states_of(plan)
    return is_own and formulation_of(plan).is_homogeneous


def units_of(plan: AnyPlan, h: Any) -> tuple[Any, Any]:
    """What sums of the slopes of X, and of V or μ, are multiplied by."""
    if not counts_in_steps(plan):
        return h, h
    moves = h > 0.0  # not where a lane has nothing to do
    return 1.0, where(moves, 1.0 / where(moves, h, 1.0), 0.0)


class StageRates(NamedTuple):
    """At one state: Ẋ, of V or μ, of the user's states; power, and the mark of a singular one."""

    x: Vec
    v_or_mu: Vec
    states: Vec
    power: Any
    singular: Any


def rates_at(
    plan: AnyPlan,
    body: Any,
    chart: Any,
    falling: Any,
    x: Vec,
    v_or_mu: Vec,
    states: Vec,
    time: Any,
) -> StageRates:
    """At C₀ exp X.   chart : C₀.   falling : the formulation's `before_step` of it."""
    formulation, own = formulation_of(plan), states
    if states:
        body = with_states(body, states)
        there = State(formulation.moved(chart, x), (ZERO,) * len(x), v_or_mu, ZERO, states)
        own = rates_of_states(plan, body, there, time)
    found = formulation.rates(body, chart, falling, x, v_or_mu, time)
    return StageRates(found.x, found.v_or_mu, own, found.power, found.singular)


def _advanced(plan: AnyPlan, base: Vec, h: Any, weights: tuple[Any, ...], rates: Any) -> Vec:
    """base + h Σ wⱼ kⱼ; zero weights cost nothing.

    Where all steps are as long, so are all h wⱼ, and rates are added up by them; where lanes choose
    their own, h comes last, which saves a product for each weight.
    """
    if plan.embedded is None or isinstance(h, float):
        return weighted(base, weights, rates, h)
    return _ended(plan, base, h, weights, rates)


def _ended(plan: AnyPlan, base: Vec, h: Any, weights: tuple[Any, ...], rates: Any) -> Vec:
    """The same at the end of a step: by the sum alone, of which the error is made as well."""
    if plan.embedded is None:
        return weighted(base, weights, rates, h)
    total = weighted((ZERO,) * len(base), weights, rates)
    return tuple(fma(h, k, x) for k, x in zip(total, base, strict=True))


def weighted(base: Vec, weights: tuple[Any, ...], rates: Any, h: Any = None) -> Vec:
    """base + Σ (h wⱼ) kⱼ; without h, base + Σ wⱼ kⱼ."""
    total = base
    for weight, rate in zip(weights, rates, strict=False):
        if not (isinstance(weight, float) and weight == 0.0):
            factor = weight if h is None else h * weight
            total = tuple(fma(factor, k, x) for k, x in zip(rate, total, strict=True))
    return total
