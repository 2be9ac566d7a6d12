"""One step of an explicit Runge–Kutta method on (X, V, W), for any Butcher tableau.

Ẋ = dexp⁻¹_{−X} V and V̇ = F(X, V)  (Müller, eqs. 4a, b), with C = C₀ exp X. `local` update
(Munthe-Kaas): X starts at 0 in every step, structurally. `global` (the paper's): X carries on, and
C₀ moves up before dexp⁻¹ meets its pole at 2π (errata E18). W, the work of what has no potential,
is the same method's quadrature of its power.
"""

from __future__ import annotations

from functools import partial
from operator import methodcaller
from typing import Any, NamedTuple

from lierb.kernels.groups import quaternion
from lierb.kernels.groups.quaternion import Chart
from lierb.kernels.mechanics import subgroup
from lierb.kernels.mechanics.elements import Applied, applied_to
from lierb.kernels.mechanics.newton_euler import BodyConstants, Kinematics, Turn, spinning
from lierb.kernels.mechanics.rows import PITCHED
from lierb.kernels.mechanics.saddle import Load, has_others, solve
from lierb.kernels.numbers.arithmetic import PI, any_lanes, branch, fma, maximum, where
from lierb.kernels.numbers.vec import (
    ZERO6,
    Mat,
    Vec,
    add,
    axpy,
    cross,
    cross_add,
    dot,
    mat_t_vec,
    mat_vec,
    neg,
    row,
    scale,
    sub,
)
from lierb.kernels.numbers.zero import ZERO
from lierb.kernels.stepping.plan import Plan

Pose = tuple[Mat, Vec]
# Any angle between 0.25 and 5 rad does as well; 5.8 degrades, 6.2 fails.
RECHART_ANGLE = PI
TIDY_EVERY = 30  # steps; 16 to 64 do as well, but with measure_every=10 this one is measured too


class State(NamedTuple):
    chart: Chart  # C₀, with a unit quaternion
    x: Vec  # X/2, as quaternions take it; structurally zero in a local update
    v_or_mu: Vec  # V; on a subgroup its momentum μ
    work: Any = ZERO  # J, of what has no potential; structurally zero where nothing does any


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
    if plan.slots is None:
        return state.v_or_mu
    return subgroup.velocity_of(plan.slots, body, state.v_or_mu)


def kinetic_energy_of(plan: Plan, body: BodyConstants, state: State) -> Any:
    if plan.slots is None:
        return plan.space.kinetic_energy(body, state.v_or_mu)
    return 0.5 * dot(velocity_of(plan, body, state), state.v_or_mu)


class Acceleration(NamedTuple):
    """The solution of the saddle point."""

    rate: Vec  # V̇
    multipliers: tuple[Any, ...]  # λ, in the order of the joint's rows
    reaction: Vec  # the joint's wrench on the body, about the joint's point, in its axes there
    power: Any  # what forces and motors add to E
    singular: Any  # the mark of a singular configuration
    dropped: Any  # how many rows depend on others


def accelerate(
    plan: Plan,
    body: BodyConstants,
    chart: Chart,
    velocity: Vec,
    time: Any = ZERO,
    q: Mat | None = None,
    fall: Vec | None = None,
    to_ground: Turn | None = None,
    applied: Applied | None = None,
) -> Acceleration:
    """The saddle point at one state.

    q, fall, to_ground, applied : the chart's Q, gravity in body axes, the way from these to the
        ground's, and all other forces, where they are known already.
    """
    to_ground = to_ground or partial(quaternion.rotated, chart[0])
    q = quaternion.matrix(chart[0]) if q is None else q
    x = plan.space.kinematics(body, (q, chart[1]), velocity)._replace(time=time)
    seen = x.at_point()
    rows = plan.rows
    fall = mat_t_vec(q, body.gravity) if fall is None else fall
    applied = applied or applied_to(body, plan.elements, x.motion)
    turning = None
    if body.moments:
        turning = spinning(body, x.omega, fall, applied.wrench[:3])
    found = solve(
        body,
        x.q,
        rows,
        methodcaller("jacobian", seen, body),
        tuple(r.acceleration(seen, body) for r in rows),
        _load(body, x.omega, fall, applied.wrench),
        x.omega + x.point_rate,
        turning,
    )
    torque, force = found.wrench[:3], found.wrench[3:]
    aside = cross(body.shift, force)  # about the user's joint point
    multipliers = tuple(
        x if r.fixed_axis is None else x - aside[r.fixed_axis]
        for r, x in zip(rows, found.multipliers, strict=True)
    )
    return Acceleration(
        plan.space.velocity_rate(body, to_ground, velocity, found.turning, found.moving),
        multipliers,
        mat_vec(body.turn, add(torque, aside)) + mat_vec(body.turn, force),
        applied.power + _driving_power(plan, body, x, multipliers),
        found.singular,
        found.dropped,
    )


def _load(body: BodyConstants, omega: Vec, fall: Vec, applied: Vec) -> Load:
    """ad_Vᵀ M V + W, less what ω alone does to the acceleration of the centre of mass.

    fall : gravity in body axes.   applied : the wrench of all other forces, about P.
    """
    centre = sub(body.com, body.arm)
    spin = cross(mat_vec(body.inertia, omega), omega)
    bent = cross(omega, cross(omega, centre))
    force = axpy(body.mass, sub(fall, bent), applied[3:])
    # c × (ω×(ω×c)) = (c·ω) c×ω
    pull = axpy(-dot(centre, omega), omega, fall)
    return Load(
        add(spin, cross_add(applied[3:], centre, applied[:3])),
        force,
        cross_add(scale(body.mass, centre), pull, add(spin, applied[:3])),
    )


def _driving_power(
    plan: Plan, body: BodyConstants, x: Kinematics, multipliers: tuple[Any, ...]
) -> Any:
    """−λ w of all constraints that move, J V = w.

    multipliers : λ of `plan.rows`.
    """
    total: Any = ZERO
    for r, multiplier in zip(plan.rows, multipliers, strict=True):
        total = fma(-multiplier, r.prescribed_rate(x, body), total)
    return total


def step(plan: Plan, body: BodyConstants, state: State, time: Any, h: Any) -> tuple[State, Any]:
    """The state h seconds after `time`, and the mark of a singular configuration on the way."""
    of_formulation = _saddle_stage if plan.slots is None else _subgroup_stage
    falling = quaternion.rotated_back(state.chart[0], body.gravity)
    stage = partial(of_formulation, plan, body, state.chart, falling)
    x_rates: list[Vec] = []
    rates: list[Vec] = []  # of V or μ
    powers: list[Vec] = []
    singular: Any = ZERO
    for weights, node in zip(plan.stages, plan.nodes, strict=True):
        x = _in_algebra(plan, body, _advanced(state.x, 0.5 * h, weights, x_rates))
        v_or_mu = _advanced(state.v_or_mu, h, weights, rates)
        x_rate, rate, power, failed = stage(x, v_or_mu, fma(h, node, time))
        x_rates.append(x_rate)
        rates.append(rate)
        powers.append((power,))
        singular = maximum(singular, failed)
    x = _in_algebra(plan, body, _advanced(state.x, 0.5 * h, plan.weights, x_rates))
    v_or_mu = _advanced(state.v_or_mu, h, plan.weights, rates)
    (work,) = _advanced((state.work,), h, plan.weights, powers)
    if plan.is_local:
        moved = plan.space.charts.compose_exp(state.chart, x, quaternion.angle_coefficients(x))
        return State(moved, ZERO6, v_or_mu, work), singular
    return _recharted(plan, State(state.chart, x, v_or_mu, work)), singular


def _saddle_stage(
    plan: Plan, body: BodyConstants, chart: Chart, falling: Vec, x: Vec, velocity: Vec, time: Any
) -> tuple[Vec, Vec, Any, Any]:
    """Ẋ, V̇, Ẇ and the mark of a singular configuration.

    falling : gravity in the chart's axes.   x : X/2.
    """
    k = quaternion.angle_coefficients(x)
    moved = plan.space.charts.compose_exp(chart, x, k)
    # Three turned rows, of which most plans use one, are less than a matrix made of `moved`.
    fixed = quaternion.matrix(chart[0])
    q = tuple(z for i in range(3) for z in quaternion.rotate(neg(x), row(fixed, i), k))
    fall = quaternion.rotate(neg(x), falling, k)

    def to_ground(a: Vec) -> Vec:
        return mat_vec(fixed, quaternion.rotate(x, a, k))

    found = accelerate(plan, body, moved, velocity, time, q, fall, to_ground)
    singular = found.singular
    if has_others(plan.rows):  # another rank is another joint
        singular = where(found.dropped == body.dropped, singular, 1.0)
    return plan.space.charts.dexpinv(neg(x), velocity, k), found.rate, found.power, singular


def _subgroup_stage(
    plan: Plan, body: BodyConstants, chart: Chart, falling: Vec, x: Vec, momentum: Vec, time: Any
) -> tuple[Vec, Vec, Any, Any]:
    """Ẋ, μ̇, Ẇ and no mark; arguments as of `_saddle_stage`."""
    assert plan.slots is not None
    velocity = subgroup.velocity_of(plan.slots, body, momentum)
    k = quaternion.angle_coefficients(x)
    applied = Applied(ZERO6, ZERO)
    if plan.elements:
        pose = quaternion.pose(quaternion.compose_exp(chart, x, k))
        motion = plan.space.kinematics(body, pose, velocity)._replace(time=time).motion
        applied = applied_to(body, plan.elements, motion)
    fall = quaternion.rotate(neg(x), falling, k)
    rate = subgroup.momentum_rate(plan.slots, body, fall, applied.wrench, velocity, momentum)
    return quaternion.dexpinv(neg(x), velocity, k), rate, applied.power, ZERO


def _in_algebra(plan: Plan, body: BodyConstants, x: Vec) -> Vec:
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


def tidied(plan: Plan, body: BodyConstants, state: State) -> State:
    """The state with C₀ put back where rounding has taken it from: p to unit length, a screw on H.

    Not every step: a systematic error of a projection would then add up (for R's 1.5e-12 rad in 1e6
    steps).
    """
    p, d = quaternion.normalised(state.chart[0]), state.chart[1]
    for r in plan.rows:
        if plan.slots is not None and r.slot == (5, PITCHED):
            x = plan.space.kinematics(body, quaternion.pose((p, d)), ZERO6)
            d = (d[0], d[1], d[2] - r.value(x, body))
    return state._replace(chart=(p, d))


def _recharted(plan: Plan, state: State) -> State:
    """C₀ ← C₀ exp X and X ← 0 where ‖ξ‖ has passed the threshold."""
    far = dot(state.x[:3], state.x[:3]) > (0.5 * RECHART_ANGLE) ** 2

    def move() -> Any:
        moved = plan.space.charts.compose_exp(state.chart, state.x)
        return where(far, (moved, tuple(0.0 * x for x in state.x)), (state.chart, state.x))

    chart, x = branch(any_lanes(far), move, lambda: (state.chart, state.x), likely=False)
    return state._replace(chart=chart, x=x)
