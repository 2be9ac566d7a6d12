"""The compiled driver: blocks of L bodies, in parallel, from one step number to another.

Arrays are C-contiguous float64. `inputs`, `carried` and `summary` are [column][body], with the
bodies padded to a multiple of L; histories are [column][time][body] or [time][body][component],
unpadded, and become Arrow columns as they are. Between two calls everything about a body lives in
`carried`: cutting a run into calls changes no bit.
"""

from __future__ import annotations

from itertools import accumulate, pairwise
from typing import Any, NamedTuple

from numba import njit, prange

from lierb.kernels import _jit, quaternion, so3
from lierb.kernels.arithmetic import (
    absolute,
    all_lanes,
    branch,
    load,
    maximum,
    plain,
    prefetch,
    real,
    rounded_as_numpy,
    scatter,
    sqrt,
    store,
    where,
)
from lierb.kernels.coefficients import TINY, angles_taken_for_tiny
from lierb.kernels.elements import Element, body_with, parameter_count
from lierb.kernels.measures import Measures, measure
from lierb.kernels.newton_euler import SE3, Body, Parameters, SO3xR3, closed_pose
from lierb.kernels.plan import Plan
from lierb.kernels.scale import bearings, start_tolerances
from lierb.kernels.stepper import (
    TIDY_EVERY,
    State,
    accelerate,
    kinetic_energy_of,
    pose_of,
    step,
    tidied,
    velocity_of,
)
from lierb.kernels.subgroup import (
    in_subalgebra,
    inverse,
    momentum_of,
    on_subgroup,
    projected,
    reduced_inertia,
    turns_about_a_point,
)
from lierb.kernels.vec import IDENTITY, ZERO6, Mat, diagonal, dot, mat_mat, principal_axes
from lierb.kernels.zero import ZERO, is_zero

# ---- columns -----------------------------------------------------------------------------------

INPUT_WIDTHS = {
    "mass": 1, "inertia": 9, "com": 3, "gravity": 3, "ground_frame": 12, "body_frame": 12,
    "pitch": 1, "length": 1, "pose": 12, "twist": 6,
}  # fmt: skip
_ENDS = tuple(accumulate(INPUT_WIDTHS.values(), initial=0))
INPUT_SLICES = {
    name: slice(*ends) for name, ends in zip(INPUT_WIDTHS, pairwise(_ENDS), strict=True)
}
INPUT_COLUMNS = _ENDS[-1]


def input_columns(elements: tuple[Element, ...]) -> int:
    """All of them: those that every problem has, and then the elements' parameters."""
    return INPUT_COLUMNS + parameter_count(elements)


OK, SINGULAR, NON_FINITE = 0, 1, 2  # status codes

CARRIED_COLUMNS = 12 + 6 + 6 + 11  # chart, X, V or μ, Record
SUMMARY_COLUMNS = 11 + 1  # Record; whether the start is on the joint
UNSEEN = -1  # in place of step 0, for a start that is to be looked at
ERROR_COLUMNS = (
    "position_error", "rotation_error", "velocity_error", "rotation_rate_error", "energy_drift",
    "orthogonality_error", "energy",
)  # fmt: skip


class Record(NamedTuple):
    """What a run remembers of a body; squares as in `Measures`."""

    position: Any
    rotation: Any
    velocity: Any
    rotation_rate: Any
    orthogonality: Any
    energy_drift: Any
    last_position: Any
    last_rotation: Any
    first_energy: Any
    status: Any
    failed_step: Any


LARGEST = 1.7976931348623157e308
NAN = float("nan")


# ---- formulas on one block ---------------------------------------------------------------------


def _columns(plan: Plan, array: Any, count: int, first: Any) -> list[Any]:
    return [load(array, (c, first), plan.lanes) for c in range(count)]


def parameters_of(numbers: list[Any], turn: Mat = IDENTITY) -> tuple[Parameters, Any, Any]:
    """Parameters, pose and twist from the numbers of the input columns.

    A pose of NaN stands for the one in which the joint is closed, `lierb.joints.Joint.closed_pose`.

    turn : of the joint's axes on the body.
    """
    parts = {name: tuple(numbers[columns]) for name, columns in INPUT_SLICES.items()}
    parameters = Parameters(
        mass=parts["mass"][0],
        inertia=parts["inertia"],
        com=parts["com"],
        gravity=parts["gravity"],
        ground=_pose(parts["ground_frame"]),
        body=_pose(parts["body_frame"]),
        pitch=parts["pitch"][0],
        length=parts["length"][0],
    )
    pose = _pose(parts["pose"])
    with rounded_as_numpy():
        closed = closed_pose(parameters.ground, parameters.body, parameters.length)
    axes, point = parameters.body
    return (
        parameters._replace(body=(mat_mat(axes, turn), point)),
        where(pose[1][0] == pose[1][0], pose, closed),
        parts["twist"],
    )


def _pose(numbers: tuple[Any, ...]) -> tuple[Any, Any]:
    return numbers[:9], numbers[9:]


def body_of(
    space: type[SE3] | type[SO3xR3],
    elements: tuple[Element, ...],
    numbers: list[Any],
    turn: Mat = IDENTITY,
) -> Body:
    """The body, with its elements, from the numbers of all input columns."""
    parameters, _, _ = parameters_of(numbers, turn)
    return body_with(space, parameters, elements, numbers[INPUT_COLUMNS:])


def load_body(plan: Plan, inputs: Any, first: Any) -> Body:
    numbers = _columns(plan, inputs, input_columns(plan.elements), first)
    body = body_of(plan.space, plan.elements, numbers)
    if plan.slots is None:
        return body
    if turns_about_a_point(plan.slots):
        moments, turn = principal_axes(body.origin_inertia)
        turn = so3.orthonormalised(turn)
        turned = body_of(plan.space, plan.elements, numbers, turn)
        body = turned._replace(turn=turn, origin_inertia=diagonal(moments))
    return body._replace(gain=inverse(reduced_inertia(plan.slots, body)))


def _start(plan: Plan, body: Body, inputs: Any, first: Any) -> tuple[Parameters, Any, Any]:
    """Parameters in the body's own joint axes; pose and twist as given."""
    return parameters_of(_columns(plan, inputs, INPUT_COLUMNS, first), body.turn)


def initial_state(plan: Plan, body: Body, inputs: Any, first: Any) -> State:
    parameters, pose, twist = _start(plan, Body(*body), inputs, first)
    chart, velocity = plan.space.to_joint_axes(parameters, pose, twist)
    still = tuple(0.0 * v for v in velocity)
    if plan.slots is None:
        return _structured(plan, State(chart, still, velocity), parameters.pitch)
    chart = quaternion.from_pose(chart)
    velocity = in_subalgebra(plan.slots, velocity, parameters.pitch)
    momentum = momentum_of(plan.slots, Body(*body), velocity)
    start = _structured(plan, State(chart, still, momentum), parameters.pitch)
    return tidied(plan, Body(*body), start)


def _structured(plan: Plan, state: State, pitch: Any) -> State:
    """The state with the structural zeros of its plan."""
    chart, x, v_or_mu = state
    if plan.slots is not None:
        x = in_subalgebra(plan.slots, x, pitch)
        v_or_mu = projected(plan.slots, v_or_mu, pitch)
        chart = on_subgroup(plan.slots, chart)
    return State(chart, ZERO6 if plan.is_local else x, v_or_mu)


def initial_record(plan: Plan, body: Body, state: State) -> Record:
    """Maxima so far: nothing, as numbers of the state's own type."""
    nothing = 0.0 * body[0]
    start = _measured(plan, Body(*body), State(*state), ZERO)
    return Record(*(nothing,) * 8, start.energy, nothing, nothing)


def load_carried(plan: Plan, body: Body, carried: Any, first: Any) -> tuple[State, Record]:
    numbers = tuple(_columns(plan, carried, CARRIED_COLUMNS, first))
    width = 9 if plan.slots is None else 4
    chart = numbers[:width], numbers[width : width + 3]
    x, v_or_mu, record = numbers[12:18], numbers[18:24], numbers[24:]
    return _structured(plan, State(chart, x, v_or_mu), Body(*body).pitch), Record(*record)


def store_carried(plan: Plan, carried: Any, first: Any, state: State, record: Record) -> None:
    chart, x, v_or_mu = state
    for place, numbers in ((0, chart[0] + chart[1]), (12, x + v_or_mu + tuple(record))):
        for c, number in enumerate(numbers, place):
            store(carried, (c, first), number, plan.lanes)


def advance(
    plan: Plan, body: Body, state: State, record: Record, k: Any, h: Any
) -> tuple[State, Record]:
    """Step number k; a body that fails keeps its status and step, and is NaN from then on."""
    state, record = State(*state), Record(*record)
    moved, singular = step(plan, Body(*body), state, h * (real(k) - 1.0), h)
    q, d = moved.chart
    # An angle that is not finite spoils all of Q.
    fine = _are_finite(q[0], *moved.v_or_mu, *moved.x, *d) & (singular <= 0.5)

    def marked() -> Any:
        now = where(singular > 0.5, float(SINGULAR), where(fine, float(OK), float(NON_FINITE)))
        alive = record.status == OK
        fresh = (now > 0.0) & alive
        return (
            # NaN from the next step on, and from there into the pose.
            tuple(x if is_zero(x) else where(alive, x, NAN) for x in moved.v_or_mu),
            where(fresh, now, record.status),
            where(fresh, real(k), record.failed_step),
        )

    v_or_mu, status, failed_step = branch(
        all_lanes(fine), lambda: (moved.v_or_mu, record.status, record.failed_step), marked
    )
    return (
        moved._replace(v_or_mu=v_or_mu),
        record._replace(status=status, failed_step=failed_step),
    )


def _are_finite(*numbers: Any) -> Any:
    """Whether all of them are, and so is their sum."""
    return absolute(sum(numbers, start=ZERO)) <= LARGEST  # false for NaN


def is_gentle(plan: Plan, body: Body, state: State, h: Any) -> Any:
    """Whether the next step's angles will be tiny in all lanes, as far as one can tell before."""
    if not plan.takes_gentle_steps:
        return all_lanes(h < h)  # never
    omega = velocity_of(plan, Body(*body), State(*state))[:3]
    return all_lanes(h * h * plain(dot(omega, omega)) <= 0.8 * TINY)


def advance_gently(plan: Plan, body: Body, state: State, k: Any, h: Any) -> tuple[State, Any]:
    """Step number k without a branch, and whether it is the step that `advance` makes.

    A branch for each stage's angle takes a spherical joint's step a twentieth of its time.
    """
    if not plan.takes_gentle_steps:
        return State(*state), all_lanes(h < h)  # never
    with angles_taken_for_tiny() as conditions:
        moved, _ = step(plan, Body(*body), State(*state), h * (real(k) - 1.0), h)
    fine = _are_finite(*moved.v_or_mu, *moved.chart[1])
    for condition in conditions:  # which no angle meets that is not finite
        fine = fine & condition
    return moved, all_lanes(fine)


def tidy(plan: Plan, body: Body, state: State) -> State:
    return tidied(plan, Body(*body), State(*state))


def _measured(plan: Plan, body: Body, state: State, time: Any) -> Measures:
    pose, velocity = pose_of(plan, state), velocity_of(plan, body, state)
    return measure(plan, body, pose, velocity, kinetic_energy_of(plan, body, state), time)


def observe(
    plan: Plan, body: Body, state: State, record: Record, time: Any
) -> tuple[Measures, Record]:
    """The measures now, and the record with its maxima raised to them where they are finite."""
    record, state = Record(*record), State(*state)
    now = _measured(plan, Body(*body), state, time)
    alive = record.status == OK

    def raised(old: Any, new: Any) -> Any:
        if is_zero(new):
            return old
        return where(alive & (new <= LARGEST), maximum(old, new), old)

    return now, record._replace(
        position=raised(record.position, now.position),
        rotation=raised(record.rotation, now.rotation),
        velocity=raised(record.velocity, now.velocity),
        rotation_rate=raised(record.rotation_rate, now.rotation_rate),
        orthogonality=raised(record.orthogonality, now.orthogonality),
        energy_drift=raised(record.energy_drift, absolute(now.energy - record.first_energy)),
        last_position=where(alive, now.position, NAN),
        last_rotation=where(alive, now.rotation, NAN),
    )


def store_errors(
    plan: Plan, record: Record, now: Measures, errors: Any, row: Any, first: Any
) -> None:
    """One row of the history's scalar columns, in the order of ERROR_COLUMNS.

    The next row is far from this one, where no hardware looks for it: fetched now, it is at hand
    when the steps to it are made. Otherwise its cache misses take as long as four steps.
    """
    record, now = Record(*record), Measures(*now)
    alive = record.status == OK
    numbers = (
        sqrt(now.position), sqrt(now.rotation), sqrt(now.velocity), sqrt(now.rotation_rate),
        now.energy - record.first_energy, sqrt(now.orthogonality), now.energy,
    )  # fmt: skip
    places = [(c, row, first) for c in range(len(numbers))]
    scatter(errors, 2, places, where(alive, numbers, (NAN,) * len(numbers)), plan.lanes)
    for c in range(len(numbers)):
        prefetch(errors, (c, row + 1, first), plan.lanes)


def user_state(
    plan: Plan, body: Body, inputs: Any, state: State, record: Record, first: Any
) -> tuple[Any, ...]:
    """R (row by row), r, ω, v in the user's frames; NaN after a failure."""
    body, state = Body(*body), State(*state)
    parameters, _, _ = _start(plan, body, inputs, first)
    velocity = velocity_of(plan, body, state)
    pose, twist = plan.space.to_user_axes(parameters, pose_of(plan, state), velocity)
    return where(Record(*record).status == OK, pose[0] + pose[1] + twist, (NAN,) * 18)


def store_state(
    plan: Plan,
    body: Body,
    inputs: Any,
    state: State,
    record: Record,
    states: Any,
    row: Any,
    first: Any,
    column: Any,
) -> None:
    """One row of the states: R, r, ω and v, each [time][body][component]."""
    numbers = user_state(plan, body, inputs, state, record, first)
    for array, part in zip(
        states, (numbers[:9], numbers[9:12], numbers[12:15], numbers[15:]), strict=True
    ):
        scatter(array, 1, [(row, column, c) for c in range(len(part))], part, plan.lanes)
        prefetch(array, (row + 1, column, 0), plan.lanes * len(part))


def store_forces(
    plan: Plan,
    body: Body,
    state: State,
    record: Record,
    multipliers: Any,
    reactions: Any,
    row: Any,
    first: Any,
    time: Any,
) -> None:
    """One row of the history's λ and reactions, [time][body][component]."""
    if not (plan.multipliers or plan.reaction):
        return
    body, state = Body(*body), State(*state)
    velocity = velocity_of(plan, body, state)
    found = accelerate(plan, body, pose_of(plan, state), velocity, time)
    alive = Record(*record).status == OK
    for recorded, array, numbers in (
        (plan.multipliers, multipliers, found.multipliers),
        (plan.reaction, reactions, found.reaction),
    ):
        if recorded and numbers:
            places = [(row, first, c) for c in range(len(numbers))]
            scatter(array, 1, places, where(alive, numbers, (NAN,) * len(numbers)), plan.lanes)
            prefetch(array, (row + 1, first, 0), plan.lanes * len(numbers))


def store_summary(plan: Plan, record: Record, summary: Any, first: Any) -> None:
    squares, rest = tuple(record)[:5], tuple(record)[5:]
    drift, last, others = rest[0], rest[1:3], rest[3:]
    for c, number in enumerate((*map(sqrt, squares), drift, *map(sqrt, last), *others)):
        store(summary, (c, first), number, plan.lanes)


def store_start(plan: Plan, inputs: Any, summary: Any, first: Any) -> None:
    """1 where the start, as given, is on the joint, and 0 elsewhere."""
    numbers = _columns(plan, inputs, input_columns(plan.elements), first)
    parameters, pose, twist = parameters_of(numbers)
    chart, velocity = plan.space.to_joint_axes(parameters, pose, twist)
    body = body_of(plan.space, plan.elements, numbers)
    x = plan.space.kinematics(body, chart, velocity)
    off = measure(plan, body, chart, velocity, ZERO, ZERO)
    allowed = start_tolerances(plan.rows, parameters, pose, twist, x, body)
    fine = allowed.position <= LARGEST  # false for NaN
    for square, most in zip(off, allowed):  # energy and orthogonality are not looked at
        fine = fine & (sqrt(square) <= most) & (most <= LARGEST)
    for bearing in bearings(plan.rows, chart[0]):
        fine = fine & (bearing > 0.0)
    store(summary, (SUMMARY_COLUMNS - 1, first), where(fine, 1.0, 0.0), plan.lanes)


for _formula in (
    load_body, initial_state, initial_record, load_carried, store_carried, advance, is_gentle,
    advance_gently, tidy, observe,
    store_errors, store_state, store_forces, store_summary, store_start,
):  # fmt: skip
    _jit.kernel(_formula)


# ---- the loop over steps and the loop over blocks ------------------------------------------------


@njit(**_jit.OPTIONS)
def _until(k: int, every: int, end: int) -> int:
    """Steps from k to the next multiple of `every`, or to the end."""
    return min(every - k % every, end - k)


@_jit.cached()
def integrate_block(
    plan, first, inputs, carried, summary, errors, rotations, places, omegas, velocities,
    multipliers, reactions, offset, begin, stop, last, h, measure_every, save_every,
):  # fmt: skip
    """Steps begin … stop of the block that starts at `first` (`offset` + `first` in histories).

    `last` is the run's last step. With begin = UNSEEN the start is looked at first; with stop = 0
    that is all. States (rotations … velocities) have a row for every saved step, or for the last
    one only.
    """
    if begin == UNSEEN:
        store_start(plan, inputs, summary, first)
        begin = 0
    if stop == 0:
        return
    body = load_body(plan, inputs, first)
    if begin == 0:
        state = initial_state(plan, body, inputs, first)
        record = initial_record(plan, body, state)
    else:
        state, record = load_carried(plan, body, carried, first)
    column = offset + first
    k = begin
    fresh = begin == 0
    while True:
        save = save_every > 0 and (k % save_every == 0 or k == last)
        if fresh and (save or k % measure_every == 0 or k == last):
            now, seen = observe(plan, body, state, record, h * k)
            if k % measure_every == 0 or k == last:
                record = seen
            if save:
                row = (k + save_every - 1) // save_every
                store_errors(plan, record, now, errors, row, column)
                store_forces(plan, body, state, record, multipliers, reactions, row, column, h * k)
            if k == last or (save and rotations.shape[0] > 1):
                row = rotations.shape[0] - 1 if k == last else k // save_every
                states = (rotations, places, omegas, velocities)
                store_state(plan, body, inputs, state, record, states, row, first, column)
        if k >= stop:
            break
        if k % TIDY_EVERY == 0 and k > 0:  # after the measures: they see what rounding did
            state = tidy(plan, body, state)
        ahead = min(_until(k, measure_every, stop), _until(k, TIDY_EVERY, stop))
        if save_every > 0:
            ahead = min(ahead, _until(k, save_every, stop))
        end = k + ahead
        if is_gentle(plan, body, state, h):
            while k < end:
                moved, fine = advance_gently(plan, body, state, k + 1, h)
                if not fine:
                    break
                state = moved
                k += 1
        while k < end:
            k += 1
            state, record = advance(plan, body, state, record, k, h)
        fresh = True
    if stop < last:
        store_carried(plan, carried, first, state, record)
    else:
        store_summary(plan, record, summary, first)


@_jit.cached(parallel=True)
def integrate_blocks(
    sources, integrate, counter, lanes, threads, inputs, carried, summary, errors, rotations,
    places, omegas, velocities, multipliers, reactions, offset, begin, stop, last, h, measure_every,
    save_every,
):  # fmt: skip
    """All blocks by `integrate`, an entry of integrate_block: one loop for all plans.

    counter : [0], of blocks that some thread has taken.
    """
    blocks = inputs.shape[1] // lanes
    for _ in prange(threads):  # each takes what comes next: cores need not be equally fast
        while True:
            block = _jit.take_turn(counter)
            if block >= blocks:
                break
            _jit.call(
                integrate, block * lanes, inputs, carried, summary, errors, rotations, places,
                omegas, velocities, multipliers, reactions, offset, begin, stop, last, h,
                measure_every, save_every,
            )  # fmt: skip
