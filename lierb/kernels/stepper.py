"""One step of an explicit Runge–Kutta method on (X, V), for any Butcher tableau.

Ẋ = dexp⁻¹_{−X} V and V̇ = F(X, V)  (Müller, eqs. ODEvec1a, b), with C = C₀ exp X.
`local` update (Munthe-Kaas): X starts at 0 in every step, structurally. `global` (eq. 4 of the
paper): X carries on, and C₀ moves up before dexp⁻¹ meets its pole at 2π (errata E18).
"""

from __future__ import annotations

from typing import Any, NamedTuple

from lierb.kernels.arithmetic import PI, any_lanes, branch, fma, maximum, where
from lierb.kernels.constraints import acceleration, jacobian
from lierb.kernels.newton_euler import Body
from lierb.kernels.plan import Plan
from lierb.kernels.saddle import solve
from lierb.kernels.vec import Mat, Vec, dot, neg
from lierb.kernels.zero import ZERO

Pose = tuple[Mat, Vec]
ZERO6: Vec = (ZERO,) * 6
# Any angle between 0.25 and 5 rad does as well; 5.8 degrades, 6.2 fails.
RECHART_ANGLE = PI


class State(NamedTuple):
    chart: Pose  # C₀
    x: Vec  # X; structurally zero in a local update
    velocity: Vec  # V


def pose_of(plan: Plan, state: State) -> Pose:
    """C = C₀ exp X."""
    if plan.is_local:
        return state.chart
    group = plan.space.group
    return group.compose(state.chart, group.exp(state.x))


def accelerate(
    plan: Plan, body: Body, pose: Pose, velocity: Vec
) -> tuple[Vec, tuple[Any, ...], Any]:
    """V̇, λ and the mark of a singular configuration."""
    x = plan.space.kinematics(body, pose, velocity)
    rows = [jacobian(r, x, body.pitch) for r in plan.rows]
    eta = [acceleration(r, x) for r in plan.rows]
    return solve(body, rows, eta, plan.space.free_acceleration(body, pose, velocity))


def step(plan: Plan, body: Body, state: State, h: Any) -> tuple[State, Any]:
    """The state after h seconds, and the mark of a singular configuration met on the way."""
    group = plan.space.group
    x_rates: list[Vec] = []
    v_rates: list[Vec] = []
    singular: Any = ZERO
    for weights in plan.stages:
        x = _combine(state.x, h, weights, x_rates)
        velocity = _combine(state.velocity, h, weights, v_rates)
        k = group.angle_coefficients(x)
        pose = group.compose(state.chart, group.exp(x, k))
        v_rate, _, contradictory = accelerate(plan, body, pose, velocity)
        x_rates.append(group.dexpinv(neg(x), velocity, k))
        v_rates.append(v_rate)
        singular = contradictory if singular is ZERO else maximum(singular, contradictory)
    x = _combine(state.x, h, plan.weights, x_rates)
    velocity = _combine(state.velocity, h, plan.weights, v_rates)
    if plan.is_local:
        return State(group.compose(state.chart, group.exp(x)), ZERO6, velocity), singular
    return _recharted(plan, State(state.chart, x, velocity)), singular


def _combine(base: Vec, h: Any, weights: tuple[float, ...], rates: list[Vec]) -> Vec:
    """base + h Σ wⱼ kⱼ; zero weights cost nothing, and h wⱼ does not depend on the step."""
    total = base
    for weight, rate in zip(weights, rates, strict=False):
        if weight != 0.0:
            hw = h * weight
            total = tuple(fma(hw, k, x) for k, x in zip(rate, total, strict=True))
    return total


def _recharted(plan: Plan, state: State) -> State:
    """C₀ ← C₀ exp X and X ← 0 where ‖ξ‖ has passed the threshold."""
    far = dot(state.x[:3], state.x[:3]) > RECHART_ANGLE**2

    def move() -> Any:
        return where(
            far, (pose_of(plan, state), tuple(0.0 * x for x in state.x)), (state.chart, state.x)
        )

    chart, x = branch(any_lanes(far), move, lambda: (state.chart, state.x))
    return State(chart, x, state.velocity)
