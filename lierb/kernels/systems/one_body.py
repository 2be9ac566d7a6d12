"""One body in the driver's terms: what is read of it, its state, what is seen of it.

`lierb.kernels.systems.tree_system.TreeFormulation` says the same of many bodies.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

from lierb.kernels.functions.function import size_of
from lierb.kernels.groups import quaternion, so3
from lierb.kernels.groups.quaternion import Chart
from lierb.kernels.mechanics.constraints import (
    position_error_squared,
    rate_errors_squared,
    rotation_error_squared,
)
from lierb.kernels.mechanics.elements import Element, body_with
from lierb.kernels.mechanics.newton_euler import (
    SE3,
    BodyConstants,
    Motion,
    Parameters,
    Pose,
    SO3xR3,
    about_a_point,
    closed_pose,
    girth_of,
)
from lierb.kernels.mechanics.scale import (
    PoseTolerances,
    bearings,
    pose_tolerances,
    twist_tolerances,
)
from lierb.kernels.numbers.arithmetic import rounded_as_numpy, sqrt, where
from lierb.kernels.numbers.vec import (
    IDENTITY,
    ZERO3,
    ZERO6,
    ZERO9,
    Mat,
    Vec,
    diagonal,
    dot,
    mat_mat,
    mat_vec_add,
)
from lierb.kernels.numbers.zero import ZERO
from lierb.kernels.systems.formulations import (
    LARGEST,
    Formulation,
    accelerate,
    formulation_of_body,
)
from lierb.kernels.systems.layout import INPUTS, STATE, Columns, Field, inputs_of, pose_of
from lierb.kernels.systems.measures import Observed, measured
from lierb.kernels.systems.plan import Plan
from lierb.kernels.systems.signals import Watching, lane_end, states_of
from lierb.kernels.systems.state import State


class Seen(NamedTuple):
    """A body at one time."""

    pose: Pose
    velocity: Vec


class Placed(NamedTuple):
    """What all starts of a body in one pose have in common.

    frames : with the joint's axes that are used.   pose : in the user's frames.   chart : C₀.
    """

    frames: Parameters
    pose: Pose
    chart: Chart


class Given(NamedTuple):
    """A body and its pose in the joint's axes as the user has them.

    held : the pose, in the user's frames.   seat : the same, in joint axes.
    fits : 1 where it is on the joint, else 0.
    """

    frames: Parameters
    body: BodyConstants
    held: Pose
    seat: Pose
    allowed: PoseTolerances
    fits: Any


def parameters_of(
    numbers: list[Any], turn: Mat = IDENTITY, shift: Vec = ZERO3
) -> tuple[Parameters, Any, Any]:
    """Parameters, pose and twist from the numbers of the input columns.

    A pose of NaN stands for the one in which the joint is closed, `lierb.joints.Joint.closed_pose`.

    turn, shift : of the joint's axes on the body, and of its point, along them.
    """
    parts = INPUTS.parts(numbers)
    parameters = Parameters(
        mass=parts["mass"][0],
        inertia=parts["inertia"],
        com=parts["com"],
        gravity=parts["gravity"],
        ground=pose_of(parts["ground_frame"]),
        body=pose_of(parts["body_frame"]),
        pitch=parts["pitch"][0],
        length=parts["length"][0],
    )
    pose = pose_of(parts["pose"])
    with rounded_as_numpy(parameters.mass):
        closed = closed_pose(parameters.ground, parameters.body, parameters.length)
    axes, point = parameters.body
    return (
        parameters._replace(body=(mat_mat(axes, turn), mat_vec_add(axes, shift, point))),
        where(pose[1][0] == pose[1][0], pose, closed),
        parts["twist"],
    )


# What a twist asks for. All else would go through the compiler from where it is found to where
# nobody uses it, for a tenth of the time to a kernel.


def _frames_of(parameters: Parameters) -> Parameters:
    return parameters._replace(mass=ZERO, inertia=ZERO9, pitch=ZERO, length=ZERO)


def _held_of(body: BodyConstants) -> BodyConstants:
    return body._replace(
        mass=ZERO, inertia=ZERO9, inertia_inverse=ZERO9, com=ZERO3, gravity=ZERO3,
        energy_origin=ZERO, origin_inertia=ZERO9, first_moment=ZERO3,
    )  # fmt: skip


def body_of(
    space: type[SE3] | type[SO3xR3],
    elements: tuple[Element, ...],
    numbers: list[Any],
    turn: Mat = IDENTITY,
    shift: Vec = ZERO3,
) -> BodyConstants:
    """The body, with its elements, from the numbers of all input columns."""
    parameters, _, _ = parameters_of(numbers, turn, shift)
    return body_with(space, parameters, elements, numbers[INPUTS.count :])


@dataclass(frozen=True)
class OneBody(Watching):
    """Of a plan: what the driver asks of a system."""

    plan: Plan
    links = 1
    joints = ()  # those whose errors have columns of their own

    @cached_property
    def formulation(self) -> Formulation:
        return formulation_of_body(self.plan)

    @cached_property
    def inputs(self) -> Columns:
        columns = inputs_of(self.plan.elements, self.state.count)
        if not self.plan.has_lane_clocks:
            return columns
        return Columns(*columns.fields, Field("lane", (lane_end(self.plan).count,)))

    @cached_property
    def state(self) -> Columns:
        return Columns(*STATE.fields, Field("states", (size_of(states_of(self.plan)),)))

    def body(self, numbers: list[Any]) -> BodyConstants:
        plan = self.plan
        body = body_of(plan.space, plan.elements, numbers)
        if plan.turns_about_a_point:
            turn, centre, moments, differences = about_a_point(body)
            turn = so3.orthonormalised(turn)
            turned = body_of(plan.space, plan.elements, numbers, turn)
            body = plan.space.centred(turned, centre)._replace(
                turn=turn,
                origin_inertia=diagonal(moments),
                moments=moments,
                differences=differences,
            )
        if self.formulation.slides_as_it_turns:
            shift = (*body.com[:2], ZERO)
            moved = body_of(plan.space, plan.elements, numbers, shift=shift)
            body = plan.space.centred(moved, (ZERO, ZERO, body.com[2]))._replace(shift=shift)
        body = body._replace(girth=girth_of((body.mass, body.inertia)))
        return self.formulation.prepared(body)

    def placed(self, body: BodyConstants, numbers: list[Any]) -> Placed:
        space, formulation = self.plan.space, self.formulation
        parameters, pose, _ = parameters_of(numbers, body.turn, body.shift)
        seat, still = space.to_joint_axes(parameters, pose, ZERO6)
        chart, _ = formulation.start(body, parameters, ZERO6, quaternion.from_pose(seat), still)
        return Placed(_frames_of(parameters), pose, chart)

    def start(self, body: BodyConstants, placed: Placed, numbers: list[Any]) -> State:
        (frames, pose, chart), twist = placed, INPUTS.parts(numbers)["twist"]
        _, velocity = self.plan.space.to_joint_axes(frames, pose, twist)
        _, v_or_mu = self.formulation.start(body, frames, twist, chart, velocity)
        still = tuple(0.0 * v for v in velocity)
        state = State(chart, still, v_or_mu, 0.0 * body.mass)
        return self.structured(state, body.pitch)

    def state_of(self, numbers: Sequence[Any], body: BodyConstants | None = None) -> State:
        """From its numbers side by side."""
        found = self.state.parts(numbers)
        chart = (found["p"], found["d"])
        (work,) = found["work"]
        state = State(chart, found["x"], found["v_or_mu"], work, found["states"])
        return self.structured(state, 1.0 if body is None else body.pitch)

    def structured(self, state: State, pitch: Any) -> State:
        """The state with the structural zeros of the plan."""
        plan = self.plan
        chart, x, v_or_mu = self.formulation.structured(state.chart, state.x, state.v_or_mu, pitch)
        work = state.work if plan.does_work else ZERO
        return State(chart, ZERO6 if plan.is_local else x, v_or_mu, work, state.states)

    def seen(self, body: BodyConstants, state: State, time: Any) -> Seen:
        formulation = self.formulation
        pose = quaternion.pose(formulation.chart(state.chart, state.x))
        return Seen(pose, formulation.velocity(body, state.v_or_mu))

    def told_by(self, chart: Chart) -> tuple[Vec, Vec]:
        """Of its chart, numbers that are finite if all turns are, and all places."""
        return (chart[0][0],), chart[1]

    def turning(self, body: BodyConstants, state: State) -> list[Any]:
        """The square of its angular velocity, rad²/s²."""
        omega = self.formulation.velocity(body, state.v_or_mu)[:3]
        return [dot(omega, omega)]

    def dropped(self, body: BodyConstants, state: State) -> Any:
        """How many rows depend on others."""
        formulation = self.formulation
        chart = formulation.chart(state.chart, state.x)
        return formulation.dropped(body, chart, state.v_or_mu)

    def measured(
        self, body: BodyConstants, state: State, seen: Any, time: Any, first_energy: Any = ZERO
    ) -> Observed:
        kinetic_energy = self.formulation.kinetic_energy(body, state.v_or_mu)
        found = measured(
            self.plan, body, seen.pose, seen.velocity, kinetic_energy, state.work, time,
            first_energy,
        )  # fmt: skip
        return Observed(found)

    def motions(self, body: BodyConstants, seen: Any, time: Any) -> Callable[[int], Motion]:
        x = self.plan.space.kinematics(body, *seen)._replace(time=time)
        motion = x.motion._replace(signals=body.signals)
        return lambda _: motion

    def in_user_frames(self, body: BodyConstants, numbers: list[Any], state: State) -> list[Vec]:
        """R (row by row), r, ω, v, of every link."""
        parameters, _, _ = parameters_of(numbers, body.turn, body.shift)
        pose, velocity = self.seen(body, state, ZERO)
        pose, twist = self.plan.space.to_user_axes(parameters, pose, velocity)
        return [pose[0] + pose[1] + twist]

    def forces(self, body: BodyConstants, state: State, time: Any) -> tuple[Vec, list[Vec]]:
        """λ of all rows, and every joint's wrench on its body."""
        formulation = self.formulation
        velocity = formulation.velocity(body, state.v_or_mu)
        chart = formulation.chart(state.chart, state.x)
        found = accelerate(self.plan, body, chart, velocity, time)
        return found.multipliers, [found.reaction]

    def given(self, numbers: list[Any], time: Any) -> Given:
        space, rows = self.plan.space, self.plan.rows
        parameters, pose, _ = parameters_of(numbers)
        seat, still = space.to_joint_axes(parameters, pose, ZERO6)
        body = body_of(space, self.plan.elements, numbers)
        x = space.kinematics(body, seat, still)._replace(time=time)
        allowed = pose_tolerances(parameters, pose)
        fine = allowed.position <= LARGEST  # false for NaN
        fine = fine & (sqrt(position_error_squared(rows, x, body)) <= allowed.position)
        fine = fine & (sqrt(rotation_error_squared(rows, x, body)) <= allowed.rotation)
        for bearing in bearings(rows, x.q):
            fine = fine & (bearing > 0.0)
        fits = where(fine, 1.0, 0.0)
        return Given(_frames_of(parameters), _held_of(body), pose, seat, allowed, fits)

    def starts_well(self, given: Given, numbers: list[Any], time: Any) -> Any:
        """1 where the start, as given, is on the joint, else 0."""
        space, rows, body = self.plan.space, self.plan.rows, given.body
        twist = INPUTS.parts(numbers)["twist"]
        _, velocity = space.to_joint_axes(given.frames, given.held, twist)
        x = space.kinematics(body, given.seat, velocity)._replace(time=time)
        allowed = twist_tolerances(rows, given.frames, given.allowed, twist, x, body)
        fine = given.fits > 0.5
        errors = rate_errors_squared(rows, x, body, velocity)
        for squared, most in zip(errors, allowed, strict=True):
            fine = fine & (sqrt(squared) <= most) & (most <= LARGEST)
        return where(fine, 1.0, 0.0)
