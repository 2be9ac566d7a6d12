"""Where accelerations come from, one class each; the stepper, the driver and measures know neither.

`SaddlePoint` integrates V on all of SE(3) or SO(3)×R³ and solves for V̇ and λ in every stage.
`Subgroup` integrates the momentum μ = NᵀMV of a joint whose motions are a subgroup of SE(3).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache, partial
from operator import methodcaller
from types import ModuleType
from typing import Any, NamedTuple

from lierb.kernels.groups import quaternion
from lierb.kernels.groups.quaternion import Chart
from lierb.kernels.mechanics import subgroup
from lierb.kernels.mechanics.constraints import holds_a_point
from lierb.kernels.mechanics.elements import Applied, applied_to
from lierb.kernels.mechanics.newton_euler import (
    BodyConstants,
    Kinematics,
    Parameters,
    Turn,
    spinning,
)
from lierb.kernels.mechanics.rows import PITCHED, fixed_axes
from lierb.kernels.mechanics.saddle import has_others, is_other_rank, solve
from lierb.kernels.mechanics.support import Load
from lierb.kernels.numbers.arithmetic import PI, absolute, any_lanes, branch, fma, where
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
from lierb.kernels.systems.plan import Plan
from lierb.kernels.systems.state import Stabilised

# Of a global update: any angle between 0.25 and 5 rad does as well; 5.8 degrades, 6.2 fails.
RECHART_ANGLE = PI
GENTLE_STAGES = 4  # of a saddle point, at most: more of them compile for long
SETTLED = 16 * 2.0**-52  # of a twist: what turning it to joint axes may leave
LARGEST = 1.7976931348623157e308


class Acceleration(NamedTuple):
    """The solution of the saddle point."""

    rate: Vec  # V̇
    multipliers: tuple[Any, ...]  # λ, in the order of the joint's rows
    reaction: Vec  # the joint's wrench on the body, about the joint's point, in its axes there
    power: Any  # what forces and motors add to E
    singular: Any  # the mark of a singular configuration
    dropped: Any  # how many rows depend on others


class Rates(NamedTuple):
    """Of one stage."""

    x: Vec  # Ẋ/2
    v_or_mu: Vec
    power: Any
    singular: Any = ZERO


@dataclass(frozen=True)
class OnOneChart:
    """What all formulations of one body have in common."""

    plan: Plan
    is_homogeneous = False

    def before_step(self, body: BodyConstants, chart: Chart) -> Vec:
        """What all stages of a step share: gravity in the chart's axes."""
        return quaternion.rotated_back(chart[0], body.gravity)

    def moved(self, chart: Chart, x: Vec) -> Chart:
        """C₀ exp X.   x : X/2."""
        found: Chart = self.plan.space.charts.compose_exp(chart, x)
        return found

    def chart(self, chart: Chart, x: Vec) -> Chart:
        """The same; structurally C₀ in a local update."""
        return chart if self.plan.is_local else self.moved(chart, x)

    def recharted(self, chart: Chart, x: Vec) -> tuple[Chart, Vec]:
        return recharted(self.plan.space.charts, chart, x)

    def places(self, chart: Chart) -> Vec:
        """Where the body is."""
        return chart[1]

    def stabilised(
        self, body: BodyConstants, before: Any, state: Any, time: Any, h: Any
    ) -> Stabilised:
        """The state put back on its constraints; see `TreeFormulation.stabilised`."""
        return Stabilised(state)

    def tidied(self, body: BodyConstants, chart: Chart) -> Chart:
        """C₀ put back where rounding has taken it from: p to unit length, a screw on H.

        Not every step: a systematic error of a projection would then add up (for R's 1.5e-12 rad
        in 1e6 steps).
        """
        p, d = chart
        return self.on_manifold(body, (quaternion.normalised(p), d))

    def on_manifold(self, body: BodyConstants, chart: Chart) -> Chart:
        return chart


def recharted(charts: ModuleType, chart: Chart, x: Vec) -> tuple[Chart, Vec]:
    """C₀ ← C₀ exp X and X ← 0 where ‖ξ‖ has passed the threshold."""
    far = dot(x[:3], x[:3]) > (0.5 * RECHART_ANGLE) ** 2

    def move() -> Any:
        moved = charts.compose_exp(chart, x)
        return where(far, (moved, tuple(0.0 * y for y in x)), (chart, x))

    found: tuple[Chart, Vec] = branch(any_lanes(far), move, lambda: (chart, x), likely=False)
    return found


@dataclass(frozen=True)
class SaddlePoint(OnOneChart):
    """V̇ and λ from the index-1 saddle point, in every stage."""

    @property
    def is_light(self) -> bool:
        """Whether a step is little work: rates that rows say outright, in few stages."""
        rows = self.plan.rows
        outright = (
            self.plan.cspace == "SE3"
            and holds_a_point(rows)
            and len(rows) == 3 + len(fixed_axes(rows))
        )
        return outright and is_short(self.plan)

    @property
    def takes_gentle_steps(self) -> bool:
        return bool(self.still) and len(self.plan.stages) <= GENTLE_STAGES

    @cached_property
    def still(self) -> tuple[int, ...]:
        """Components of V that stay at zero, once they are: rows that are constant in body axes ask
        for nothing else, and nothing else moves them.
        """
        fixed = fixed_axes(self.plan.rows)
        holds = self.plan.cspace == "SE3" and holds_a_point(self.plan.rows)
        return (*fixed, 3, 4, 5) if holds else fixed

    slides_as_it_turns = False

    def prepared(self, body: BodyConstants) -> BodyConstants:
        return body

    def start(
        self, body: BodyConstants, parameters: Parameters, twist: Vec, chart: Chart, velocity: Vec
    ) -> tuple[Chart, Vec]:
        """C₀, and V, where the components that rows keep `still` are rounding of the twist: zero
        there.
        """
        turning, moving, reach = (
            sum(map(absolute, part)) for part in (twist[:3], twist[3:], parameters.body[1])
        )
        sizes = (turning,) * 3 + (moving + turning * reach,) * 3
        settled = []
        for i, (v, size) in enumerate(zip(velocity, sizes, strict=True)):
            is_rounding = (absolute(v) <= SETTLED * size) & (size <= LARGEST)
            settled.append((where(is_rounding, 0.0, v) if i in self.still else v) + 0.0)
        p, d = chart
        return (tuple(x + 0.0 for x in p), tuple(x + 0.0 for x in d)), tuple(settled)  # no −0

    def dropped(self, body: BodyConstants, chart: Chart, velocity: Vec) -> Any:
        """How many rows depend on others; no force makes them."""
        if not has_others(self.plan.rows):
            return ZERO
        still = Applied(ZERO6, ZERO)
        return accelerate(self.plan, body, chart, velocity, applied=still).dropped

    def structured(self, chart: Chart, x: Vec, v_or_mu: Vec, pitch: Any) -> tuple[Chart, Vec, Vec]:
        return chart, x, v_or_mu

    def velocity(self, body: BodyConstants, v_or_mu: Vec) -> Vec:
        return v_or_mu

    def kinetic_energy(self, body: BodyConstants, v_or_mu: Vec) -> Any:
        return self.plan.space.kinetic_energy(body, v_or_mu)

    def in_algebra(self, body: BodyConstants, x: Vec) -> Vec:
        return x

    def rates(
        self, body: BodyConstants, chart: Chart, falling: Vec, x: Vec, velocity: Vec, time: Any
    ) -> Rates:
        """Of one stage.   falling : gravity in the chart's axes.   x : X/2."""
        plan, k = self.plan, quaternion.angle_coefficients(x)
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
            singular = where(is_other_rank(found.dropped, body.dropped), 1.0, singular)
        x_rate = plan.space.charts.dexpinv(neg(x), velocity, k)
        return Rates(x_rate, found.rate, found.power, singular)


@dataclass(frozen=True)
class Subgroup(OnOneChart):
    """μ̇ from Euler–Poincaré's equation on the joint's own subgroup: the saddle point, solved once
    and for all.
    """

    still = ()

    @cached_property
    def slots(self) -> subgroup.Slots:
        return subgroup.slots_of(self.plan.rows)

    @property
    def is_light(self) -> bool:
        """Whether a step is little work: a rate for each of few stages and freedoms."""
        return is_short(self.plan)

    @property
    def takes_gentle_steps(self) -> bool:
        return self.is_light

    @property
    def is_homogeneous(self) -> bool:  # type: ignore[override]
        """Whether the rates of s V under s² times gravity are s Ẋ and s² V̇, for any s."""
        return not self.plan.acting

    @property
    def slides_as_it_turns(self) -> bool:
        """Whether H has turns about e₃ and slides normal to it. Any point of the body will do then
        for the joint's, but for its height: the centre of mass, beside which nothing is small.
        """
        return self.slots[0] < 0 <= self.slots[2] and min(self.slots[3:5]) >= 0

    def prepared(self, body: BodyConstants) -> BodyConstants:
        """The body with its constant gain."""
        gain = subgroup.inverse(subgroup.reduced_inertia(self.slots, body))
        return body._replace(gain=gain)

    def start(
        self, body: BodyConstants, parameters: Parameters, twist: Vec, chart: Chart, velocity: Vec
    ) -> tuple[Chart, Vec]:
        """C₀ and μ; what is off H is dropped."""
        inside = subgroup.in_subalgebra(self.slots, velocity, body.pitch)
        p, d = subgroup.on_subgroup(self.slots, chart)
        on_manifold = self.on_manifold(body, (quaternion.normalised(p), d))
        return on_manifold, subgroup.momentum_of(self.slots, body, inside)

    def dropped(self, body: BodyConstants, chart: Chart, velocity: Vec) -> Any:
        return ZERO

    def structured(self, chart: Chart, x: Vec, v_or_mu: Vec, pitch: Any) -> tuple[Chart, Vec, Vec]:
        """With the structural zeros of H and of its algebra."""
        return (
            subgroup.on_subgroup(self.slots, chart),
            subgroup.in_subalgebra(self.slots, x, pitch),
            subgroup.projected(self.slots, v_or_mu, pitch),
        )

    def velocity(self, body: BodyConstants, v_or_mu: Vec) -> Vec:
        return subgroup.velocity_of(self.slots, body, v_or_mu)

    def kinetic_energy(self, body: BodyConstants, v_or_mu: Vec) -> Any:
        return 0.5 * dot(self.velocity(body, v_or_mu), v_or_mu)

    def in_algebra(self, body: BodyConstants, x: Vec) -> Vec:
        return subgroup.in_subalgebra(self.slots, x, body.pitch)

    def rates(
        self, body: BodyConstants, chart: Chart, falling: Vec, x: Vec, momentum: Vec, time: Any
    ) -> Rates:
        """Of one stage; arguments as of `SaddlePoint`."""
        velocity = self.velocity(body, momentum)
        k = quaternion.angle_coefficients(x)
        applied = Applied(ZERO6, ZERO)
        if self.plan.acting:
            pose = quaternion.pose(quaternion.compose_exp(chart, x, k))
            at = self.plan.space.kinematics(body, pose, velocity)._replace(time=time)
            applied = applied_to(body, self.plan.elements, at.motion)
        fall = quaternion.rotate(neg(x), falling, k)
        rate = subgroup.momentum_rate(self.slots, body, fall, applied.wrench, velocity, momentum)
        return Rates(quaternion.dexpinv(neg(x), velocity, k), rate, applied.power)

    def on_manifold(self, body: BodyConstants, chart: Chart) -> Chart:
        """A screw put back on H."""
        p, d = chart
        for r in self.plan.rows:
            if r.slot == (5, PITCHED):
                x = self.plan.space.kinematics(body, quaternion.pose(chart), ZERO6)
                d = (d[0], d[1], d[2] - r.value(x, body))
        return p, d


Formulation = SaddlePoint | Subgroup
FORMULATIONS: dict[str, type[Formulation]] = {"saddle": SaddlePoint, "subgroup": Subgroup}


@lru_cache(256)
def formulation_of_body(plan: Plan) -> Formulation:
    """Formulation of a single body's plan."""
    return FORMULATIONS[plan.solver](plan)


def is_short(plan: Plan) -> bool:
    """Whether a step has few stages and freedoms."""
    return len(plan.stages) * (6 - len(plan.rows)) <= 12


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
