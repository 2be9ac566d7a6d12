"""One body on a joint: inputs, state, poses and measures.

`lierb.kernels.systems.formulations` adds accelerations. `lierb.kernels.systems.tree_system` is the
system of several bodies.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from types import ModuleType
from typing import Any, ClassVar, NamedTuple

from lierb.kernels.functions.function import size_of
from lierb.kernels.groups import quaternion, so3
from lierb.kernels.groups.ambient import WIDTH
from lierb.kernels.groups.increments import Ambient, Exponential, Increment
from lierb.kernels.groups.quaternion import Chart
from lierb.kernels.mechanics.constraints import (
    position_error_squared,
    rate_errors_squared,
    rotation_error_squared,
)
from lierb.kernels.mechanics.elements import potential_energy
from lierb.kernels.mechanics.ground_motion import GroundMotion
from lierb.kernels.mechanics.newton_euler import (
    BodyConstants,
    Motion,
    Parameters,
    Pose,
    girth_of,
    principal_axes_at_point,
)
from lierb.kernels.mechanics.scale import bearings, pose_tolerances, twist_tolerances
from lierb.kernels.mechanics.tree import Connection
from lierb.kernels.numbers.arithmetic import PI, any_lanes, branch, sqrt, where
from lierb.kernels.numbers.vec import ZERO6, Vec, add, dot, mat_t_vec, mat_vec, sub
from lierb.kernels.numbers.zero import ZERO
from lierb.kernels.systems.acceleration import accelerate
from lierb.kernels.systems.body_inputs import (
    Placed,
    PoseCheck,
    body_of,
    frames_alone,
    parameters_of,
    rows_alone,
)
from lierb.kernels.systems.combine import NAN, StateArithmetic
from lierb.kernels.systems.layout import INPUTS, STATE, Columns, Field, inputs_of
from lierb.kernels.systems.measures import MEASURES, Observed, Sample
from lierb.kernels.systems.plan import Plan
from lierb.kernels.systems.signals import lane_end, states_of
from lierb.kernels.systems.state import Stabilised, State

# For a global update: any angle from 0.25 to 5 rad works equally; 5.8 degrades, 6.2 fails.
RECHART_ANGLE = PI
LARGEST = 1.7976931348623157e308


class BodyMotion(NamedTuple):
    """Pose and velocity of a body, in joint axes."""

    pose: Pose
    velocity: Vec


def recharted(charts: ModuleType, chart: Chart, x: Vec) -> tuple[Chart, Vec]:
    """Return C₀ exp X and 0 where ‖ξ‖ exceeds the threshold, C₀ and X elsewhere.   x : X/2."""
    far = dot(x[:3], x[:3]) > (0.5 * RECHART_ANGLE) ** 2

    def move() -> Any:
        moved = charts.compose_exp(chart, x)
        return where(far, (moved, tuple(0.0 * y for y in x)), (chart, x))

    return branch(any_lanes(far), move, lambda: (chart, x), likely=False)


@dataclass(frozen=True)
class OneBody(StateArithmetic):
    """System of one body, without accelerations; see `lierb.kernels.systems.system.System`."""

    plan: Plan
    links = 1
    joints: ClassVar[tuple[Connection, ...]] = ()  # with separate columns
    is_homogeneous = False
    slides_as_it_turns = False

    # ---- inputs and start ----

    @cached_property
    def inputs(self) -> Columns:
        plan = self.plan
        lane = lane_end(plan).count
        return inputs_of(plan.elements, self.state.count, lane, plan.moving, plan.directions)

    @cached_property
    def state(self) -> Columns:
        return Columns(
            *STATE.fields,
            Field("states", (size_of(states_of(self.plan)),)),
            Field("carried", (self.plan.carried,)),
        )

    def body(self, numbers: list[Any]) -> BodyConstants:
        plan = self.plan
        body = body_of(plan.space, plan.elements, numbers)
        if plan.turns_about_a_point:
            axes = principal_axes_at_point(body)
            turn = so3.orthonormalised(axes.turn)
            turned = body_of(plan.space, plan.elements, numbers, turn)
            body = plan.space.centred(turned, axes.centre)._replace(
                turn=turn,
                origin_inertia=axes.inertia,
                moments=axes.moments,
                differences=axes.differences,
                products=axes.products,
            )
        if self.slides_as_it_turns:
            shift = (*body.com[:2], ZERO)
            moved = body_of(plan.space, plan.elements, numbers, shift=shift)
            body = plan.space.centred(moved, (ZERO, ZERO, body.com[2]))._replace(shift=shift)
        body = body._replace(girth=girth_of((body.mass, body.inertia)))
        return self.with_gain(body)

    def placed(self, body: BodyConstants, numbers: list[Any]) -> Placed:
        space = self.plan.space
        parameters, pose, _ = parameters_of(numbers, body.turn, body.shift)
        seat, rest = space.to_joint_axes(parameters, pose, ZERO6)
        chart, _ = self.settled(body, parameters, ZERO6, quaternion.from_pose(seat), rest)
        return Placed(frames_alone(parameters), pose, chart)

    def start(self, body: BodyConstants, placed: Placed, numbers: list[Any]) -> State:
        (frames, pose, chart), twist = placed, INPUTS.parts(numbers)["twist"]
        _, velocity = self.plan.space.to_joint_axes(frames, pose, twist)
        _, v_or_mu = self.settled(body, frames, twist, chart, velocity)
        x = tuple(0.0 * v for v in velocity)
        nothing = 0.0 * body.mass
        carried = (nothing + NAN,) * self.plan.carried  # not yet known
        state = State(chart, x, v_or_mu, nothing, carried=carried)
        return self.structured(state, body.pitch)

    def state_of(self, numbers: Sequence[Any], body: BodyConstants | None = None) -> State:
        parts = self.state.parts(numbers)
        chart = (parts["p"], parts["d"])
        (work,) = parts["work"]
        own = parts["states"], parts["carried"]
        state = State(chart, parts["x"], parts["v_or_mu"], work, *own)
        return self.structured(state, 1.0 if body is None else body.pitch)

    def with_gain(self, body: BodyConstants) -> BodyConstants:
        """Return the body with the constants of its formulation."""
        return body

    def structured(self, state: State, pitch: Any) -> State:
        """Return the state with the structural zeros of the plan."""
        work = state.work if self.plan.does_work else ZERO
        return state._replace(x=ZERO6 if self.plan.is_local else state.x, work=work)

    def pose_check(self, numbers: list[Any], time: Any) -> PoseCheck:
        space, rows = self.plan.space, self.plan.rows
        parameters, user_pose, _ = parameters_of(numbers)
        pose, rest = space.to_joint_axes(parameters, user_pose, ZERO6)
        body = body_of(space, self.plan.elements, numbers)
        x = space.kinematics(body, pose, rest)._replace(time=time)
        allowed = pose_tolerances(parameters, user_pose)
        fine = allowed.position <= LARGEST  # false for NaN
        fine = fine & (sqrt(position_error_squared(rows, x, body)) <= allowed.position)
        fine = fine & (sqrt(rotation_error_squared(rows, x, body)) <= allowed.rotation)
        for bearing in bearings(rows, x.q):
            fine = fine & (bearing > 0.0)
        fits = where(fine, 1.0, 0.0)
        frames = frames_alone(parameters)
        return PoseCheck(frames, rows_alone(body), user_pose, pose, allowed, fits)

    def is_on_joint(self, check: PoseCheck, numbers: list[Any], time: Any) -> Any:
        space, rows, body = self.plan.space, self.plan.rows, check.body
        twist = INPUTS.parts(numbers)["twist"]
        _, velocity = space.to_joint_axes(check.frames, check.user_pose, twist)
        x = space.kinematics(body, check.pose, velocity)._replace(time=time)
        allowed = twist_tolerances(rows, check.frames, check.allowed, twist, x, body)
        fine = check.fits > 0.5
        errors = rate_errors_squared(rows, x, body, velocity)
        for squared, most in zip(errors, allowed, strict=True):
            fine = fine & (sqrt(squared) <= most) & (most <= LARGEST)
        return where(fine, 1.0, 0.0)

    def settled(
        self, body: BodyConstants, parameters: Parameters, twist: Vec, chart: Chart, velocity: Vec
    ) -> tuple[Chart, Vec]:
        """Return C₀, and V or μ, of a start in joint axes.   twist : in the user's frames."""
        raise NotImplementedError

    # ---- pose ----

    @property
    def width(self) -> int:  # type: ignore[override]
        return WIDTH if self.plan.is_ambient else 6

    def increment(self, x: Vec) -> Increment:
        """Motion of a stage since the chart.   x : X/2 or Y."""
        space = self.plan.space
        if self.plan.is_ambient:
            return Ambient.of(space.ambient, x)
        return Exponential.of(space.charts, x)

    def ended(self, chart: Chart, x: Vec) -> Chart:
        """Return the chart moved by a step.   x : X/2 or Y."""
        return self.increment(x).moved(chart)

    def in_algebra(self, body: BodyConstants, x: Vec) -> Vec:
        return x

    def completed(self, body: BodyConstants, v_or_mu: Vec) -> Vec:
        return v_or_mu

    def chart_gravity(self, body: BodyConstants, chart: Chart) -> Vec:
        return quaternion.rotated_back(chart[0], body.gravity)

    def moved(self, chart: Chart, x: Vec) -> Chart:
        """Return C₀ exp X.   x : X/2."""
        return self.plan.space.charts.compose_exp(chart, x)

    def turning_and_moving(self, x: Vec) -> tuple[Vec, Vec]:
        half = self.width // 2
        return x[:half], x[half:]

    def recharted(self, chart: Chart, x: Vec) -> tuple[Chart, Vec]:
        return recharted(self.plan.space.charts, chart, x)

    def chart_of(self, state: State) -> Chart:
        """Return C₀ exp X, which is structurally C₀ in a local update."""
        chart: Chart = state.chart
        return chart if self.plan.is_local else self.moved(chart, state.x)

    def tidied(self, body: BodyConstants, chart: Chart) -> Chart:
        """Renormalise the quaternion; project a screw joint's pose onto its subgroup.

        In an ambient update a screw joint's pose leaves its subgroup by more than rounding, and is
        left where it is.

        This is not done in every step, where a systematic error of the projection would accumulate
        (to 1.5e-12 rad in 1e6 steps for that of R).
        """
        p, d = chart
        p = quaternion.normalised(p)
        return (p, d) if self.plan.is_ambient else self.on_manifold(body, (p, d))

    def on_manifold(self, body: BodyConstants, chart: Chart) -> Chart:
        """Project a screw joint's pose onto its subgroup, if the formulation keeps poses there."""
        return chart

    def stabilised(
        self, body: BodyConstants, before: State, state: State, time: Any, h: Any
    ) -> Stabilised:
        return Stabilised(state)

    # ---- measures ----

    def places(self, chart: Chart) -> Vec:
        return chart[1]

    def turns_and_places(self, chart: Chart) -> tuple[Vec, Vec]:
        return (chart[0][0],), chart[1]

    def angular_speeds_squared(self, body: BodyConstants, state: State) -> list[Any]:
        omega = self.velocity(body, state.v_or_mu)[:3]
        return [dot(omega, omega)]

    def kinetic_energy(self, body: BodyConstants, v_or_mu: Vec) -> Any:
        return self.plan.space.kinetic_energy(body, v_or_mu)

    def motion(
        self, body: BodyConstants, state: State, time: Any, is_next: bool = False
    ) -> BodyMotion:
        pose = quaternion.pose(self.chart_of(state))
        return BodyMotion(pose, self.velocity(body, state.v_or_mu))

    def motions(
        self, body: BodyConstants, motion: BodyMotion, time: Any
    ) -> Callable[[int], Motion]:
        x = self.plan.space.kinematics(body, *motion)._replace(time=time)
        with_signals = x.motion._replace(signals=body.signals)
        return lambda _: with_signals

    def felt(self, body: BodyConstants, motion: BodyMotion, time: Any) -> Callable[[int], Vec]:
        q, d = motion.pose
        solution = accelerate(
            self.plan, body, ((), d), motion.velocity, time, q, to_ground=partial(mat_vec, q)
        )
        moving = sub(solution.moving, mat_t_vec(q, body.gravity))
        seen = self.motions(body, motion, time)(0)
        for element, placed in zip(self.plan.elements, body.elements, strict=True):
            if isinstance(element, GroundMotion):
                moving = add(moving, element.felt(placed, seen))
        felt = solution.turning + moving
        return lambda _: felt

    def measured(
        self,
        body: BodyConstants,
        state: State,
        motion: BodyMotion,
        time: Any,
        first_energy: Any = ZERO,
    ) -> Observed:
        plan, (pose, velocity) = self.plan, motion
        kinetic = self.kinetic_energy(body, state.v_or_mu)
        x = plan.space.kinematics(body, pose, velocity)._replace(time=time)
        potential = plan.space.potential_energy(body, pose)
        if plan.elements:
            timeless = x._replace(time=ZERO).motion  # no potential depends on time
            timeless = timeless._replace(signals=body.signals)
            potential = potential + potential_energy(plan.elements, body, timeless)
        energy = kinetic + potential
        rates = rate_errors_squared(plan.rows, x, body, velocity)
        sample = Sample(plan, body, pose, x, rates, energy, first_energy, state.work)
        return Observed({measure.name: measure.of(sample) for measure in MEASURES})

    def in_user_frames(self, body: BodyConstants, numbers: list[Any], state: State) -> list[Vec]:
        parameters, _, _ = parameters_of(numbers, body.turn, body.shift)
        pose, velocity = self.motion(body, state, ZERO)
        pose, twist = self.plan.space.to_user_axes(parameters, pose, velocity)
        return [pose[0] + pose[1] + twist]

    def forces(self, body: BodyConstants, state: State, time: Any) -> tuple[Vec, list[Vec]]:
        velocity = self.velocity(body, state.v_or_mu)
        solution = accelerate(self.plan, body, self.chart_of(state), velocity, time)
        return solution.multipliers, [solution.reaction]
