"""The equations of motion of one body have two formulations.

`SaddlePoint` integrates V on all of SE(3) or SO(3)×R³ and solves for V̇ and λ in every stage.
`Subgroup` integrates the momentum μ = NᵀMV of a joint whose motions are a subgroup of SE(3).
"""

from __future__ import annotations

from functools import cached_property
from typing import Any

from lierb.kernels.groups import quaternion
from lierb.kernels.groups.quaternion import Chart
from lierb.kernels.mechanics import subgroup
from lierb.kernels.mechanics.constraints import holds_a_point
from lierb.kernels.mechanics.elements import Applied, applied_to
from lierb.kernels.mechanics.newton_euler import BodyConstants, Parameters
from lierb.kernels.mechanics.rows import PITCHED, fixed_axes
from lierb.kernels.mechanics.saddle import has_others, is_other_rank
from lierb.kernels.numbers.arithmetic import absolute, where
from lierb.kernels.numbers.vec import ZERO6, Vec, dot, mat_vec, row
from lierb.kernels.numbers.zero import ZERO
from lierb.kernels.systems.acceleration import accelerate
from lierb.kernels.systems.one_body import LARGEST, OneBody
from lierb.kernels.systems.plan import Plan
from lierb.kernels.systems.signals import states_of
from lierb.kernels.systems.state import Rates, State

SMALL_ANGLE_STAGES = 4  # largest number for a saddle point; with more, compilation takes long
SETTLED = 16 * 2.0**-52  # relative rounding error of a twist that is rotated to joint axes


class SaddlePoint(OneBody):
    """Compute V̇ and λ from the index-1 saddle point, in every stage."""

    @property
    def is_light(self) -> bool:
        """Return whether the rows need no Schur complement, and stages are few."""
        rows = self.plan.rows
        outright = (
            self.plan.cspace == "SE3"
            and holds_a_point(rows)
            and len(rows) == 3 + len(fixed_axes(rows))
        )
        return outright and is_short(self.plan)

    @property
    def takes_small_angle_steps(self) -> bool:
        return bool(self.invariant) and self.plan.method.length <= SMALL_ANGLE_STAGES

    @cached_property
    def invariant(self) -> tuple[int, ...]:
        """Return components of V that stay zero if zero: rows constant in body axes fix them.

        There are none if a method finds V by iteration, which leaves rounding errors.
        """
        if not self.plan.has_stages:
            return ()
        fixed = fixed_axes(self.plan.rows)
        holds = self.plan.cspace == "SE3" and holds_a_point(self.plan.rows)
        return (*fixed, 3, 4, 5) if holds else fixed

    free = (0, 1, 2, 3, 4, 5)

    def settled(
        self, body: BodyConstants, parameters: Parameters, twist: Vec, chart: Chart, velocity: Vec
    ) -> tuple[Chart, Vec]:
        """Return C₀ and V; invariant components that are only rounding of the twist become zero."""
        turning, moving, reach = (
            sum(map(absolute, part)) for part in (twist[:3], twist[3:], parameters.body[1])
        )
        sizes = (turning,) * 3 + (moving + turning * reach,) * 3
        settled = []
        for i, (v, size) in enumerate(zip(velocity, sizes, strict=True)):
            is_rounding = (absolute(v) <= SETTLED * size) & (size <= LARGEST)
            settled.append((where(is_rounding, 0.0, v) if i in self.invariant else v) + 0.0)
        p, d = chart
        return (tuple(x + 0.0 for x in p), tuple(x + 0.0 for x in d)), tuple(settled)  # no −0

    def dropped(self, body: BodyConstants, state: State) -> Any:
        if not has_others(self.plan.rows):
            return ZERO
        no_forces = Applied(ZERO6, ZERO)  # the rank does not depend on forces
        chart = self.chart_of(state)
        return accelerate(self.plan, body, chart, state.v_or_mu, applied=no_forces).dropped

    def rates(self, body: BodyConstants, state: State, gravity: Vec, time: Any) -> Rates:
        plan, (chart, x, velocity, *_) = self.plan, state
        step = self.increment(x)
        # Most plans use one of the three rotated rows: cheaper than the matrix of the moved chart.
        fixed = quaternion.matrix(chart[0])
        q = tuple(z for i in range(3) for z in step.rotate_back(row(fixed, i)))
        fall = step.fall(gravity)

        def to_ground(a: Vec) -> Vec:
            return mat_vec(fixed, step.rotate(a))

        at = chart[0], step.place(chart)  # its rotation is q
        solution = accelerate(plan, body, at, velocity, time, q, fall, to_ground)
        singular = solution.singular
        if has_others(plan.rows):  # a joint of another rank is another joint
            singular = where(is_other_rank(solution.dropped, body.dropped), 1.0, singular)
        return Rates(step.rate(velocity), solution.rate, solution.power, singular)


class Subgroup(OneBody):
    """μ̇ from Euler–Poincaré's equation on the joint's subgroup H; NᵀMN is inverted once."""

    invariant = ()

    @cached_property
    def slots(self) -> subgroup.Slots:
        return subgroup.slots_of(self.plan.rows)

    @property
    def free(self) -> tuple[int, ...]:
        return tuple(i for i, slot in enumerate(self.slots) if slot >= 0)

    @property
    def is_light(self) -> bool:
        """Return whether a step has few stages and the joint few degrees of freedom."""
        return is_short(self.plan)

    @property
    def takes_small_angle_steps(self) -> bool:
        return self.is_light

    @property
    def is_homogeneous(self) -> bool:  # type: ignore[override]
        return not self.plan.acting and not states_of(self.plan)

    @property
    def slides_as_it_turns(self) -> bool:  # type: ignore[override]
        """Return whether H contains rotations about e₃ and translations normal to it.

        Any point of the body at the same height can then be the joint's point. The centre of mass
        is used, with which no term is a small difference.
        """
        return self.slots[0] < 0 <= self.slots[2] and min(self.slots[3:5]) >= 0

    def with_gain(self, body: BodyConstants) -> BodyConstants:
        """Return the body with its constant gain (NᵀMN)⁻¹."""
        gain = subgroup.inverse(subgroup.reduced_inertia(self.slots, body))
        return body._replace(gain=gain)

    def settled(
        self, body: BodyConstants, parameters: Parameters, twist: Vec, chart: Chart, velocity: Vec
    ) -> tuple[Chart, Vec]:
        """Return C₀ and μ; components off H are dropped."""
        inside = subgroup.in_subalgebra(self.slots, velocity, body.pitch)
        p, d = subgroup.on_subgroup(self.slots, chart)
        on_manifold = self.on_manifold(body, (quaternion.normalised(p), d))
        return on_manifold, subgroup.momentum_of(self.slots, body, inside)

    def dropped(self, body: BodyConstants, state: State) -> Any:
        return ZERO

    def structured(self, state: State, pitch: Any) -> State:
        """Return the state with the structural zeros of the plan, of H and of its algebra."""
        chart, x, momentum, *_ = state
        inside = state._replace(
            chart=subgroup.on_subgroup(self.slots, chart),
            x=subgroup.in_subalgebra(self.slots, x, pitch),
            v_or_mu=subgroup.projected(self.slots, momentum, pitch),
        )
        return super().structured(inside, pitch)

    def velocity(self, body: BodyConstants, v_or_mu: Vec) -> Vec:
        return subgroup.velocity_of(self.slots, body, v_or_mu)

    def kinetic_energy(self, body: BodyConstants, v_or_mu: Vec) -> Any:
        return 0.5 * dot(self.velocity(body, v_or_mu), v_or_mu)

    def in_algebra(self, body: BodyConstants, x: Vec) -> Vec:
        if self.plan.is_ambient:  # sums of slopes have the structural zeros of the slopes
            return x
        return subgroup.in_subalgebra(self.slots, x, body.pitch)

    def rates(self, body: BodyConstants, state: State, gravity: Vec, time: Any) -> Rates:
        chart, x, momentum, *_ = state
        velocity = self.velocity(body, momentum)
        step = self.increment(x)
        applied = Applied(ZERO6, ZERO)
        if self.plan.acting:
            pose = step.pose(chart)
            at = self.plan.space.kinematics(body, pose, velocity)._replace(time=time)
            applied = applied_to(body, self.plan.elements, at.motion)
        fall = step.fall(gravity)
        rate = subgroup.momentum_rate(self.slots, body, fall, applied.wrench, velocity, momentum)
        return Rates(step.rate(velocity), rate, applied.power)

    def on_manifold(self, body: BodyConstants, chart: Chart) -> Chart:
        p, d = chart
        for r in self.plan.rows:
            if r.slot == (5, PITCHED):
                x = self.plan.space.kinematics(body, quaternion.pose(chart), ZERO6)
                d = (d[0], d[1], d[2] - r.value(x, body))
        return p, d


FORMULATIONS: dict[str, type[SaddlePoint | Subgroup]] = {
    "saddle": SaddlePoint,
    "subgroup": Subgroup,
}


def is_short(plan: Plan) -> bool:
    """Return whether a step has few stages and the joint few degrees of freedom."""
    return plan.method.length * (6 - len(plan.rows)) <= 12
