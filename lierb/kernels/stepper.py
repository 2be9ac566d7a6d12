"""One step of an explicit Runge–Kutta method on (X, V, W), for any Butcher tableau.

Ẋ = dexp⁻¹_{−X} V and V̇ = F(X, V)  (Müller, eqs. 4a, b), with C = C₀ exp X. `local` update
(Munthe-Kaas): X starts at 0 in every step, structurally. `global` (the paper's): X carries on, and
C₀ moves up before dexp⁻¹ meets its pole at 2π (errata E18). W, the work of what has no potential,
is the same method's quadrature of its power.
"""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

from lierb.kernels import quaternion, so3, subgroup
from lierb.kernels.arithmetic import PI, any_lanes, branch, fma, maximum, where
from lierb.kernels.coefficients import step_coefficients
from lierb.kernels.constraints import (
    acceleration,
    given_multipliers,
    jacobian,
    prescribed_rate,
    solving_rows,
    value,
)
from lierb.kernels.elements import Load, total_load
from lierb.kernels.newton_euler import Body, row_response
from lierb.kernels.plan import Plan
from lierb.kernels.quaternion import Chart
from lierb.kernels.saddle import solve
from lierb.kernels.vec import ZERO6, Mat, Vec, add, axpy, cross_add, dot, mat_vec, neg
from lierb.kernels.zero import ZERO

Pose = tuple[Mat, Vec]
# Any angle between 0.25 and 5 rad does as well; 5.8 degrades, 6.2 fails.
RECHART_ANGLE = PI
TIDY_EVERY = 30  # steps; 16 to 64 do as well, but with measure_every=10 this one is measured too


class State(NamedTuple):
    chart: Pose | Chart  # C₀; on a subgroup with a unit quaternion
    x: Vec  # `Plan.share` of X; structurally zero in a local update
    v_or_mu: Vec  # V; on a subgroup its momentum μ
    work: Any = ZERO  # J, of what has no potential; structurally zero where nothing does any


def pose_of(plan: Plan, state: State) -> Pose:
    """C = C₀ exp X."""
    chart = state.chart if plan.is_local else plan.charts.compose_exp(state.chart, state.x)
    return chart if plan.slots is None else quaternion.pose(chart)


def velocity_of(plan: Plan, body: Body, state: State) -> Vec:
    """V."""
    if plan.slots is None:
        return state.v_or_mu
    return subgroup.velocity_of(plan.slots, body, state.v_or_mu)


def kinetic_energy_of(plan: Plan, body: Body, state: State) -> Any:
    if plan.slots is None:
        return plan.space.kinetic_energy(body, state.v_or_mu)
    return 0.5 * dot(velocity_of(plan, body, state), state.v_or_mu)


class Acceleration(NamedTuple):
    """The solution of the saddle point."""

    rate: Vec  # V̇
    multipliers: tuple[Any, ...]  # λ, in the order of the joint's rows
    reaction: Vec  # the joint's wrench on the body, about the joint's point, in its axes there
    singular: Any  # the mark of a singular configuration


def accelerate(
    plan: Plan, body: Body, pose: Pose, velocity: Vec, time: Any = ZERO, load: Load | None = None
) -> Acceleration:
    """The saddle point at one state.

    load : the applied forces', where it is known.
    """
    load = load or applied_load(plan, body, pose, velocity, time)
    x = plan.space.kinematics(body, pose, velocity)._replace(time=time)
    in_body_axes = x._replace(is_body_fixed=True)
    rows = solving_rows(plan.rows)
    jacobians = [jacobian(r, in_body_axes, body) for r in rows]
    found, multipliers, singular = solve(
        body,
        jacobians,
        [acceleration(r, x, body) for r in rows],
        add(
            plan.space.free_acceleration(body, pose, velocity),
            row_response(body, load.wrench),
        ),
        velocity,
    )
    wrench: Vec = ZERO6
    for multiplier, direction in zip(multipliers, jacobians, strict=True):
        wrench = axpy(-multiplier, direction, wrench)
    torque, force = wrench[:3], wrench[3:]
    about_joint = cross_add(force, x.arm, torque)
    return Acceleration(
        plan.space.velocity_rate(pose, found),
        given_multipliers(plan.rows, rows, multipliers, pose[0]),
        mat_vec(body.turn, about_joint) + mat_vec(body.turn, force),
        singular,
    )


def applied_load(plan: Plan, body: Body, pose: Pose, velocity: Vec, time: Any) -> Load:
    """Of all applied forces but gravity, about the body frame's origin."""
    if not plan.elements:
        return Load(ZERO6, ZERO)
    return total_load(plan.elements, body, plan.space.motion(pose, velocity, time))


def _driving_power(
    plan: Plan, body: Body, pose: Pose, velocity: Vec, time: Any, multipliers: tuple[Any, ...]
) -> Any:
    """−λ w of all constraints that move, J V = w.

    multipliers : λ of `plan.rows`.
    """
    x = plan.space.kinematics(body, pose, velocity)._replace(time=time)
    total: Any = ZERO
    for r, multiplier in zip(plan.rows, multipliers, strict=True):
        total = fma(-multiplier, prescribed_rate(r, x, body), total)
    return total


def step(plan: Plan, body: Body, state: State, time: Any, h: Any) -> tuple[State, Any]:
    """The state h seconds after `time`, and the mark of a singular configuration on the way."""
    if plan.slots is None:
        stage = partial(_saddle_stage, plan, body, state.chart)
    else:
        falling = quaternion.rotated_back(state.chart[0], body.gravity)
        stage = partial(_subgroup_stage, plan, body, state.chart, falling)
    x_rates: list[Vec] = []
    rates: list[Vec] = []  # of V or μ
    powers: list[Vec] = []
    singular: Any = ZERO
    for weights, node in zip(plan.stages, plan.nodes, strict=True):
        x = _in_algebra(plan, body, _advanced(state.x, plan.share * h, weights, x_rates))
        v_or_mu = _advanced(state.v_or_mu, h, weights, rates)
        x_rate, rate, power, failed = stage(x, v_or_mu, fma(h, node, time))
        x_rates.append(x_rate)
        rates.append(rate)
        powers.append((power,))
        singular = maximum(singular, failed)
    x = _in_algebra(plan, body, _advanced(state.x, plan.share * h, plan.weights, x_rates))
    v_or_mu = _advanced(state.v_or_mu, h, plan.weights, rates)
    (work,) = _advanced((state.work,), h, plan.weights, powers)
    if plan.is_local:
        k = _angle_coefficients(plan, x)
        return State(plan.charts.compose_exp(state.chart, x, k), ZERO6, v_or_mu, work), singular
    return _recharted(plan, State(state.chart, x, v_or_mu, work)), singular


def _angle_coefficients(plan: Plan, x: Vec) -> Any:
    if plan.slots is None:
        return plan.charts.angle_coefficients(x, step_coefficients)
    return quaternion.angle_coefficients(x)


def _saddle_stage(
    plan: Plan, body: Body, chart: Pose, x: Vec, velocity: Vec, time: Any
) -> tuple[Vec, Vec, Any, Any]:
    """Ẋ, V̇, Ẇ and the mark of a singular configuration."""
    k = _angle_coefficients(plan, x)
    pose = plan.charts.compose_exp(chart, x, k)
    load = applied_load(plan, body, pose, velocity, time)
    found = accelerate(plan, body, pose, velocity, time, load)
    power = load.power + _driving_power(plan, body, pose, velocity, time, found.multipliers)
    return plan.charts.dexpinv(neg(x), velocity, k), found.rate, power, found.singular


def _subgroup_stage(
    plan: Plan, body: Body, chart: Chart, falling: Vec, x: Vec, momentum: Vec, time: Any
) -> tuple[Vec, Vec, Any, Any]:
    """Ẋ, μ̇, Ẇ and no mark.

    falling : gravity in the chart's axes.   x : X/2.
    """
    assert plan.slots is not None
    velocity = subgroup.velocity_of(plan.slots, body, momentum)
    k = _angle_coefficients(plan, x)
    load = Load(ZERO6, ZERO)
    if plan.elements:
        pose = quaternion.pose(quaternion.compose_exp(chart, x, k))
        load = applied_load(plan, body, pose, velocity, time)
    fall = quaternion.rotate(neg(x), falling, k)
    rate = subgroup.momentum_rate(plan.slots, body, fall, load.wrench, velocity, momentum)
    return quaternion.dexpinv(neg(x), velocity, k), rate, load.power, ZERO


def _in_algebra(plan: Plan, body: Body, x: Vec) -> Vec:
    """X, on a subgroup with the structural zeros of its algebra."""
    return x if plan.slots is None else subgroup.in_subalgebra(plan.slots, x, body.pitch)


def _advanced(base: Vec, h: Any, weights: tuple[float, ...], rates: list[Vec]) -> Vec:
    """base + h Σ wⱼ kⱼ; zero weights cost nothing, and h wⱼ does not depend on the step."""
    total = base
    for weight, rate in zip(weights, rates, strict=False):
        if weight != 0.0:
            hw = h * weight
            total = tuple(fma(hw, k, x) for k, x in zip(rate, total, strict=True))
    return total


def tidied(plan: Plan, body: Body, state: State) -> State:
    """The state with C₀ put back where rounding has taken it from: R on SO(3), a screw on its H.

    Not every step: a systematic error of a projection would then add up (for R's 1.5e-12 rad in 1e6
    steps).
    """
    if plan.slots is None:
        q, place = state.chart
        return state._replace(chart=(so3.orthonormalised(q), place))
    p, d = quaternion.normalised(state.chart[0]), state.chart[1]
    for row in plan.rows:
        if row.kind == "screw":
            x = plan.space.kinematics(body, quaternion.pose((p, d)), ZERO6)
            d = (d[0], d[1], d[2] - value(row, x, body))
    return state._replace(chart=(p, d))


def _recharted(plan: Plan, state: State) -> State:
    """C₀ ← C₀ exp X and X ← 0 where ‖ξ‖ has passed the threshold."""
    far = dot(state.x[:3], state.x[:3]) > (plan.share * RECHART_ANGLE) ** 2

    def move() -> Any:
        k = _angle_coefficients(plan, state.x)
        moved = plan.charts.compose_exp(state.chart, state.x, k)
        return where(far, (moved, tuple(0.0 * x for x in state.x)), (state.chart, state.x))

    chart, x = branch(any_lanes(far), move, lambda: (state.chart, state.x), likely=False)
    return state._replace(chart=chart, x=x)
