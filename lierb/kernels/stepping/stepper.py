"""One step of an explicit Runge–Kutta method on (X, V, W), for any Butcher tableau.

Ẋ = dexp⁻¹_{−X} V and V̇ = F(X, V)  (Müller, eqs. 4a, b), with C = C₀ exp X. `local` update
(Munthe-Kaas): X starts at 0 in every step, structurally. `global` (the paper's): X carries on, and
C₀ moves up before dexp⁻¹ meets its pole at 2π (errata E18). W, the work of what has no potential,
is the same method's quadrature of its power.
"""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

from lierb.kernels.groups import quaternion
from lierb.kernels.groups.quaternion import Chart
from lierb.kernels.mechanics.newton_euler import BodyConstants
from lierb.kernels.numbers.arithmetic import PI, any_lanes, branch, fma, maximum, where
from lierb.kernels.numbers.vec import ZERO6, Mat, Vec, dot
from lierb.kernels.numbers.zero import ZERO
from lierb.kernels.stepping.plan import Plan

Pose = tuple[Mat, Vec]
# Any angle between 0.25 and 5 rad does as well; 5.8 degrades, 6.2 fails.
RECHART_ANGLE = PI


class State(NamedTuple):
    chart: Chart  # C₀, with a unit quaternion
    x: Vec  # X/2, as quaternions take it; structurally zero in a local update
    v_or_mu: Vec  # V; on a subgroup its momentum μ
    work: Any = ZERO  # J, of what has no potential; structurally zero where nothing does any


def structured(plan: Plan, state: State, pitch: Any) -> State:
    """The state with the structural zeros of its plan."""
    chart, x, v_or_mu = plan.formulation.structured(state.chart, state.x, state.v_or_mu, pitch)
    work = state.work if plan.does_work else ZERO
    return State(chart, ZERO6 if plan.is_local else x, v_or_mu, work)


def chart_of(plan: Plan, state: State) -> Chart:
    """C = C₀ exp X."""
    if plan.is_local:
        return state.chart
    moved: Chart = plan.space.charts.compose_exp(state.chart, state.x)
    return moved


def pose_of(plan: Plan, state: State) -> Pose:
    """C as a matrix and a vector."""
    return quaternion.pose(chart_of(plan, state))


def velocity_of(plan: Plan, body: BodyConstants, state: State) -> Vec:
    """V."""
    return plan.formulation.velocity(body, state.v_or_mu)


def step(plan: Plan, body: BodyConstants, state: State, time: Any, h: Any) -> tuple[State, Any]:
    """The state h seconds after `time`, and the mark of a singular configuration on the way."""
    formulation = plan.formulation
    falling = quaternion.rotated_back(state.chart[0], body.gravity)
    stage = partial(formulation.rates, body, state.chart, falling)
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
        moved = plan.space.charts.compose_exp(state.chart, x, quaternion.angle_coefficients(x))
        return State(moved, ZERO6, v_or_mu, work), singular
    return _recharted(plan, State(state.chart, x, v_or_mu, work)), singular


def _advanced(base: Vec, h: Any, weights: tuple[float, ...], rates: list[Vec]) -> Vec:
    """base + h Σ wⱼ kⱼ; zero weights cost nothing, and h wⱼ does not depend on the step."""
    total = base
    for weight, rate in zip(weights, rates, strict=False):
        if weight != 0.0:
            hw = h * weight
            total = tuple(fma(hw, k, x) for k, x in zip(rate, total, strict=True))
    return total


def tidied(plan: Plan, body: BodyConstants, chart: Chart) -> Chart:
    """C₀ put back where rounding has taken it from: p to unit length, a screw on H.

    Not every step: a systematic error of a projection would then add up (for R's 1.5e-12 rad in 1e6
    steps).
    """
    p, d = chart
    return plan.formulation.on_manifold(body, (quaternion.normalised(p), d))


def _recharted(plan: Plan, state: State) -> State:
    """C₀ ← C₀ exp X and X ← 0 where ‖ξ‖ has passed the threshold."""
    far = dot(state.x[:3], state.x[:3]) > (0.5 * RECHART_ANGLE) ** 2

    def move() -> Any:
        moved = plan.space.charts.compose_exp(state.chart, state.x)
        return where(far, (moved, tuple(0.0 * x for x in state.x)), (state.chart, state.x))

    chart, x = branch(any_lanes(far), move, lambda: (state.chart, state.x), likely=False)
    return state._replace(chart=chart, x=x)
