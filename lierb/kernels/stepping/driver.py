"""The compiled driver: blocks of L bodies, in parallel, from one step number to another.

Arrays are C-contiguous float64. `inputs`, `carried` and `summary` are [column][body], with the
bodies padded to a multiple of L; histories are [column][time][body] or [time][body][component],
unpadded, and become Arrow columns as they are. Between two calls everything about a body lives in
`carried`: cutting a run into calls changes no bit. At the end the state itself goes to `ends`, for
a run that goes on from there: it changes no bit either.
"""

from __future__ import annotations

from functools import lru_cache
from itertools import accumulate, pairwise
from typing import Any, NamedTuple

from numba import njit, prange

from lierb.compiler import _jit
from lierb.kernels.functions import calls
from lierb.kernels.groups import quaternion, so3
from lierb.kernels.groups.coefficients import TINY
from lierb.kernels.mechanics.elements import Applied, Element, body_with, parameter_count
from lierb.kernels.mechanics.measures import Measures, measure
from lierb.kernels.mechanics.newton_euler import (
    SE3,
    BodyConstants,
    Parameters,
    SO3xR3,
    about_a_point,
    closed_pose,
)
from lierb.kernels.mechanics.saddle import has_others
from lierb.kernels.mechanics.scale import bearings, start_tolerances
from lierb.kernels.mechanics.subgroup import (
    in_subalgebra,
    inverse,
    momentum_of,
    on_subgroup,
    projected,
    reduced_inertia,
)
from lierb.kernels.numbers.arithmetic import (
    absolute,
    all_lanes,
    assumptions,
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
from lierb.kernels.numbers.vec import (
    IDENTITY,
    ZERO3,
    ZERO6,
    Mat,
    Vec,
    diagonal,
    dot,
    mat_mat,
    mat_vec_add,
)
from lierb.kernels.numbers.zero import ZERO, is_zero
from lierb.kernels.stepping.plan import Plan
from lierb.kernels.stepping.stepper import (
    TIDY_EVERY,
    State,
    accelerate,
    chart_of,
    kinetic_energy_of,
    pose_of,
    step,
    tidied,
    velocity_of,
)

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


OK, SINGULAR, NON_FINITE, RAISED = 0, 1, 2, 3  # status codes

X, V_OR_MU, WORK = slice(12, 18), slice(18, 24), 24  # columns of a carried state; before X, C₀
STATE_COLUMNS = 25
# As `store_summary` says; what functions have raised at last; whether the start is on the joint.
RAISED_AT_END, STARTS = 11, 12
SUMMARY_COLUMNS = STARTS + 1
SETTLED = 16 * 2.0**-52  # of a twist: what turning it to joint axes may leave
# In place of step 0: for a start that is to be looked at, and for one that goes on from `carried`.
UNSEEN, RESUMED = -1, -2
ERROR_COLUMNS = (
    "position_error", "rotation_error", "velocity_error", "rotation_rate_error", "energy_drift",
    "orthogonality_error", "energy",
)  # fmt: skip


def error_columns(plan: Plan) -> tuple[str, ...]:
    """Scalar columns of a history: `work` where something does any."""
    return (*ERROR_COLUMNS, "work") if plan.does_work else ERROR_COLUMNS


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
    dropped: Any  # at the start; see `BodyConstants`


MARKS = STATE_COLUMNS + len(Record._fields)  # what a function has raised, if the plan calls any
CARRIED_COLUMNS = MARKS + 1
LARGEST = 1.7976931348623157e308
NAN = float("nan")


# ---- formulas on one block ---------------------------------------------------------------------


def _columns(plan: Plan, array: Any, count: int, first: Any) -> list[Any]:
    return [load(array, (c, first), plan.lanes) for c in range(count)]


def parameters_of(
    numbers: list[Any], turn: Mat = IDENTITY, shift: Vec = ZERO3
) -> tuple[Parameters, Any, Any]:
    """Parameters, pose and twist from the numbers of the input columns.

    A pose of NaN stands for the one in which the joint is closed, `lierb.joints.Joint.closed_pose`.

    turn, shift : of the joint's axes on the body, and of its point, along them.
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
    with rounded_as_numpy(parameters.mass):
        closed = closed_pose(parameters.ground, parameters.body, parameters.length)
    axes, point = parameters.body
    return (
        parameters._replace(body=(mat_mat(axes, turn), mat_vec_add(axes, shift, point))),
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
    shift: Vec = ZERO3,
) -> BodyConstants:
    """The body, with its elements, from the numbers of all input columns."""
    parameters, _, _ = parameters_of(numbers, turn, shift)
    return body_with(space, parameters, elements, numbers[INPUT_COLUMNS:])


def load_body(plan: Plan, inputs: Any, first: Any) -> BodyConstants:
    numbers = _columns(plan, inputs, input_columns(plan.elements), first)
    body = body_of(plan.space, plan.elements, numbers)
    if plan.turns_about_a_point:
        turn, centre, moments, differences = about_a_point(body)
        turn = so3.orthonormalised(turn)
        turned = body_of(plan.space, plan.elements, numbers, turn)
        body = plan.space.centred(turned, centre)._replace(
            turn=turn, origin_inertia=diagonal(moments), moments=moments, differences=differences
        )
    if plan.slides_as_it_turns:
        shift = (*body.com[:2], ZERO)
        moved = body_of(plan.space, plan.elements, numbers, shift=shift)
        body = plan.space.centred(moved, (ZERO, ZERO, body.com[2]))._replace(shift=shift)
    if plan.slots is None:
        return body
    return body._replace(gain=inverse(reduced_inertia(plan.slots, body)))


def _start(plan: Plan, body: BodyConstants, inputs: Any, first: Any) -> tuple[Parameters, Any, Any]:
    """Parameters in the body's own joint axes; pose and twist as given."""
    return parameters_of(_columns(plan, inputs, INPUT_COLUMNS, first), body.turn, body.shift)


def initial_state(plan: Plan, body: BodyConstants, inputs: Any, first: Any) -> State:
    parameters, pose, twist = _start(plan, body, inputs, first)
    placed, velocity = plan.space.to_joint_axes(parameters, pose, twist)
    chart, still = quaternion.from_pose(placed), tuple(0.0 * v for v in velocity)
    none = 0.0 * parameters.mass
    if plan.slots is None:
        velocity = _settled(plan, parameters, twist, velocity)
        p, d = chart
        chart = tuple(x + 0.0 for x in p), tuple(x + 0.0 for x in d)  # no −0
        return _structured(plan, State(chart, still, velocity, none), parameters.pitch)
    velocity = in_subalgebra(plan.slots, velocity, parameters.pitch)
    momentum = momentum_of(plan.slots, body, velocity)
    start = _structured(plan, State(chart, still, momentum, none), parameters.pitch)
    return tidied(plan, body, start)


def _settled(plan: Plan, parameters: Parameters, twist: Any, velocity: Any) -> Any:
    """V, where the components that rows keep `still` are rounding of the twist: zero there."""
    turning, moving, reach = (
        sum(map(absolute, part)) for part in (twist[:3], twist[3:], parameters.body[1])
    )
    sizes = (turning,) * 3 + (moving + turning * reach,) * 3
    settled = []
    for i, (v, size) in enumerate(zip(velocity, sizes, strict=True)):
        is_rounding = (absolute(v) <= SETTLED * size) & (size <= LARGEST)
        settled.append((where(is_rounding, 0.0, v) if i in plan.still else v) + 0.0)
    return tuple(settled)


def _structured(plan: Plan, state: State, pitch: Any) -> State:
    """The state with the structural zeros of its plan."""
    chart, x, v_or_mu, work = state
    if plan.slots is not None:
        x = in_subalgebra(plan.slots, x, pitch)
        v_or_mu = projected(plan.slots, v_or_mu, pitch)
        chart = on_subgroup(plan.slots, chart)
    return State(chart, ZERO6 if plan.is_local else x, v_or_mu, work if plan.does_work else ZERO)


def initial_record(plan: Plan, body: BodyConstants, state: State) -> Record:
    """Maxima so far: nothing, as numbers of the state's own type."""
    nothing = 0.0 * body.mass
    start = _measured(plan, body, state, nothing)  # no constant: 1 / t of a motor is inf, no error
    dropped: Any = nothing
    if plan.slots is None and has_others(plan.rows):
        # No force makes rows depend on others.
        chart, still = chart_of(plan, state), Applied(ZERO6, ZERO)
        dropped = dropped + accelerate(plan, body, chart, state.v_or_mu, applied=still).dropped
    if plan.calls_functions:
        calls.set_marks(nothing + float(calls.CLEAR))
    return Record(*(nothing,) * 8, start.energy, nothing, nothing, dropped)


def load_state(plan: Plan, body: BodyConstants, carried: Any, first: Any) -> State:
    numbers = _columns(plan, carried, STATE_COLUMNS, first)
    return _state_of(plan, tuple(numbers), body.pitch)


def _state_of(plan: Plan, numbers: tuple[Any, ...], pitch: Any) -> State:
    state = State((numbers[:4], numbers[4:7]), numbers[X], numbers[V_OR_MU], numbers[WORK])
    return _structured(plan, state, pitch)


def load_record(plan: Plan, carried: Any, first: Any) -> Record:
    record = Record(*_columns(plan, carried, MARKS, first)[STATE_COLUMNS:])
    if plan.calls_functions:
        before = load(carried, (MARKS, first), plan.lanes)
        pending = where(before > calls.SILENT, float(calls.HEARD), float(calls.CLEAR))
        calls.set_marks(where(record.status == OK, pending, float(calls.SILENT)))
    return record


def store_carried(plan: Plan, carried: Any, first: Any, state: State, record: Record) -> None:
    numbers = (*record, *_raised_in_call(plan, record))
    for c, number in (*_placed(state), *enumerate(numbers, STATE_COLUMNS)):
        store(carried, (c, first), number, plan.lanes)


def _placed(state: State) -> list[tuple[int, Any]]:
    """A state's numbers, each with its column."""
    chart, x, v_or_mu, work = state
    return [
        *enumerate(chart[0] + chart[1]), *enumerate(x, X.start), *enumerate(v_or_mu, V_OR_MU.start),
        (WORK, work),
    ]  # fmt: skip


def store_end(plan: Plan, state: State, ends: Any, first: Any) -> None:
    """What `end_columns` names, [column][body]."""
    numbers = [number for _, number in _going_on(state)]
    places = [(c, first) for c in range(len(numbers))]
    scatter(ends, 1, places, numbers, plan.lanes)


def _going_on(state: State) -> list[tuple[int, Any]]:
    """Of a state's numbers those with which a run goes on: W counts from its own start."""
    return [(c, number) for c, number in _placed(state) if c != WORK and not is_zero(number)]


@lru_cache(64)
def end_columns(plan: Plan) -> tuple[int, ...]:
    """The columns of a carried state that are kept at the end: those that its plan has."""
    return tuple(c for c, _ in _going_on(_state_of(plan, (1.0,) * STATE_COLUMNS, 1.0)))


def advance(
    plan: Plan, body: BodyConstants, state: State, record: Record, k: Any, time: Any, h: Any
) -> tuple[State, Record]:
    """Step number k, from `time` on.

    A body that fails keeps its status and step, and is NaN from then on.
    """
    return _advanced(plan, body, state, record, k, time, h, ())


def advance_still(
    plan: Plan, body: BodyConstants, state: State, record: Record, k: Any, time: Any, h: Any
) -> tuple[State, Record]:
    """The same, to the same bits, where `is_still`: half of a saddle point's operations."""
    if not plan.still:
        return state, record  # never
    return _advanced(plan, body, state, record, k, time, h, plan.still)


def _advanced(
    plan: Plan,
    body: BodyConstants,
    state: State,
    record: Record,
    k: Any,
    time: Any,
    h: Any,
    still: tuple[int, ...],
) -> tuple[State, Record]:
    body = body._replace(dropped=record.dropped)
    moved, singular = _stepped(plan, body, state, time, h, still)
    q, d = moved.chart
    # An angle that is not finite spoils all of Q.
    numbers = (q[0], *moved.v_or_mu, *moved.x, *d, moved.work)
    fine = _are_finite(*numbers) & (singular <= 0.5)
    if plan.calls_functions:
        fine = fine & (calls.marks(record.status) == calls.CLEAR)

    def marked() -> Any:
        now = where(singular > 0.5, float(SINGULAR), where(fine, float(OK), float(NON_FINITE)))
        alive = record.status == OK
        if plan.calls_functions:
            known = calls.marks(record.status)
            now = where(known > calls.SILENT, float(RAISED), now)  # which NaN has made singular
            fails = where(
                (now > 0.0) | (record.status > 0.0), float(calls.SILENT), float(calls.CLEAR)
            )
            calls.set_marks(maximum(known, fails))
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


def heard(plan: Plan, record: Record, k: Any) -> Record:
    """The record, where a function has raised since the last step: asked for λ or the reaction."""
    if not plan.calls_functions:
        return record  # never
    fresh = (calls.marks(record.status) > calls.SILENT) & (record.status == OK)
    return record._replace(
        status=where(fresh, float(RAISED), record.status),
        failed_step=where(fresh, real(k), record.failed_step),
    )


def _raised_in_call(plan: Plan, record: Record) -> Any:
    """What functions have raised; negative where the body had failed before."""
    if not plan.calls_functions:
        return ()
    known = calls.marks(record.status)
    counts = (record.status == OK) | (record.status == RAISED)
    return (where(counts, known, -known),)


def _stepped(
    plan: Plan, body: BodyConstants, state: State, time: Any, h: Any, still: tuple[int, ...]
) -> tuple[State, Any]:
    """A step, with V's components that are `still` as structural zeros."""
    before = state.v_or_mu
    moving = tuple(ZERO if i in still else v for i, v in enumerate(before))
    moved, singular = step(plan, body, state._replace(v_or_mu=moving), time, h)
    pairs = zip(before, moved.v_or_mu, strict=True)
    after = tuple(v if i in still else x for i, (v, x) in enumerate(pairs))
    return moved._replace(v_or_mu=after), singular


def _are_finite(*numbers: Any) -> Any:
    """Whether all of them are, and so is their sum."""
    return absolute(sum(numbers, start=ZERO)) <= LARGEST  # false for NaN


def has_still(plan: Plan, h: Any) -> Any:
    """Whether the plan's rows keep anything `still`."""
    return all_lanes(h == h if plan.still else h < h)


def is_still(plan: Plan, state: State, h: Any) -> Any:
    """Whether what the plan's rows keep `still` is so, in all lanes; and so it stays."""
    velocity = state.v_or_mu
    still = h == h
    for i in plan.still:
        still = still & (velocity[i] == 0.0)
    return all_lanes(still)


def is_gentle(plan: Plan, body: BodyConstants, state: State, record: Record, h: Any) -> Any:
    """Whether the next step's angles will be tiny in all lanes, as far as one can tell before."""
    if not plan.takes_gentle_steps:
        return all_lanes(h < h)  # never
    omega = velocity_of(plan, body, state)[:3]
    gentle = h * h * plain(dot(omega, omega)) <= 0.8 * TINY
    return all_lanes(gentle & (record.dropped == 0.0))


def advance_gently(
    plan: Plan, body: BodyConstants, state: State, time: Any, h: Any
) -> tuple[State, Any]:
    """A step without a branch, and whether it is the step that `advance` makes.

    For states that are `still`. A branch for each stage's angle takes a spherical joint's step a
    twentieth of its time.
    """
    if not plan.takes_gentle_steps:
        return state, all_lanes(h < h)  # never
    with assumptions(h) as conditions:
        moved, singular = _stepped(plan, body, state, time, h, plan.still)
    fine = _are_finite(*moved.v_or_mu, *moved.chart[1], moved.work) & (singular <= 0.5)
    for condition in conditions:  # which no angle meets that is not finite
        fine = fine & condition
    return moved, all_lanes(fine)


def tidy(plan: Plan, body: BodyConstants, state: State) -> State:
    return tidied(plan, body, state)


def _measured(plan: Plan, body: BodyConstants, state: State, time: Any) -> Measures:
    pose, velocity = pose_of(plan, state), velocity_of(plan, body, state)
    kinetic_energy = kinetic_energy_of(plan, body, state)
    return measure(plan, body, pose, velocity, kinetic_energy, state.work, time)


def _drift(record: Record, now: Measures) -> Any:
    """E(t) − E(0) − W(t)."""
    return now.energy - record.first_energy - now.work


def observe(
    plan: Plan, body: BodyConstants, state: State, record: Record, k: Any, time: Any
) -> tuple[Measures, Record]:
    """The measures at step k, and the record with its maxima raised to them.

    Where they are not finite they tell nothing, and the body has failed, though its state may be
    finite: squares and energies overflow long before it.
    """
    now = _measured(plan, body, state, time)
    *squares, _, _ = now
    drift = absolute(_drift(record, now))  # which energy and work make infinite, if they are
    fine, so_far = _are_finite(*squares, drift), (record.status, record.failed_step)
    alive = (record.status == OK) & fine

    def raised(old: Any, new: Any) -> Any:
        return old if is_zero(new) else where(alive, maximum(old, new), old)

    def marked() -> Any:
        fresh = where(record.status == OK, (float(NON_FINITE), real(k)), so_far)
        return where(fine, so_far, fresh)

    status, failed_step = branch(all_lanes(fine), lambda: so_far, marked)
    return now, record._replace(
        position=raised(record.position, now.position),
        rotation=raised(record.rotation, now.rotation),
        velocity=raised(record.velocity, now.velocity),
        rotation_rate=raised(record.rotation_rate, now.rotation_rate),
        orthogonality=raised(record.orthogonality, now.orthogonality),
        energy_drift=raised(record.energy_drift, drift),
        last_position=where(alive, now.position, NAN),
        last_rotation=where(alive, now.rotation, NAN),
        status=status,
        failed_step=failed_step,
    )


def store_errors(
    plan: Plan, record: Record, now: Measures, errors: Any, row: Any, first: Any
) -> None:
    """One row of the history's scalar columns, in the order of `error_columns`.

    The next row is far from this one, where no hardware looks for it: fetched now, it is at hand
    when the steps to it are made. Otherwise its cache misses take as long as four steps.
    """
    alive = record.status == OK
    numbers = (
        sqrt(now.position), sqrt(now.rotation), sqrt(now.velocity), sqrt(now.rotation_rate),
        _drift(record, now), sqrt(now.orthogonality), now.energy,
        *((now.work,) if plan.does_work else ()),
    )  # fmt: skip
    places = [(c, row, first) for c in range(len(numbers))]
    scatter(errors, 2, places, where(alive, numbers, (NAN,) * len(numbers)), plan.lanes)
    for c in range(len(numbers)):
        prefetch(errors, (c, row + 1, first), plan.lanes)


def user_state(
    plan: Plan, body: BodyConstants, inputs: Any, state: State, record: Record, first: Any
) -> tuple[Any, ...]:
    """R (row by row), r, ω, v in the user's frames; NaN after a failure."""
    parameters, _, _ = _start(plan, body, inputs, first)
    velocity = velocity_of(plan, body, state)
    pose, twist = plan.space.to_user_axes(parameters, pose_of(plan, state), velocity)
    return where(record.status == OK, pose[0] + pose[1] + twist, (NAN,) * 18)


def store_state(
    plan: Plan,
    body: BodyConstants,
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
    body: BodyConstants,
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
    velocity = velocity_of(plan, body, state)
    found = accelerate(plan, body, chart_of(plan, state), velocity, time)
    alive = record.status == OK
    for recorded, array, numbers in (
        (plan.multipliers, multipliers, found.multipliers),
        (plan.reaction, reactions, found.reaction),
    ):
        if recorded and numbers:
            places = [(row, first, c) for c in range(len(numbers))]
            scatter(array, 1, places, where(alive, numbers, (NAN,) * len(numbers)), plan.lanes)
            prefetch(array, (row + 1, first, 0), plan.lanes * len(numbers))


def store_summary(plan: Plan, state: State, record: Record, summary: Any, first: Any) -> None:
    """Maxima, final errors, W, status and the step of a failure."""
    r = record
    work = where(r.status == OK, plain(state.work), NAN)
    numbers = (
        sqrt(r.position), sqrt(r.rotation), sqrt(r.velocity), sqrt(r.rotation_rate),
        sqrt(r.orthogonality), r.energy_drift, sqrt(r.last_position), sqrt(r.last_rotation), work,
        r.status, r.failed_step,
    )  # fmt: skip
    for c, number in enumerate(numbers):
        store(summary, (c, first), number, plan.lanes)
    for number in _raised_in_call(plan, r):
        store(summary, (RAISED_AT_END, first), number, plan.lanes)


def store_start(plan: Plan, inputs: Any, summary: Any, first: Any, time: Any) -> None:
    """1 where the start, as given, is on the joint, and 0 elsewhere.

    time : s, of the start.
    """
    numbers = _columns(plan, inputs, input_columns(plan.elements), first)
    parameters, pose, twist = parameters_of(numbers)
    chart, velocity = plan.space.to_joint_axes(parameters, pose, twist)
    body = body_of(plan.space, plan.elements, numbers)
    x = plan.space.kinematics(body, chart, velocity)._replace(time=time)
    off = measure(plan, body, chart, velocity, ZERO, ZERO, time)
    allowed = start_tolerances(plan.rows, parameters, pose, twist, x, body)
    fine = allowed.position <= LARGEST  # false for NaN
    for square, most in zip(off, allowed):  # energy and orthogonality are not looked at
        fine = fine & (sqrt(square) <= most) & (most <= LARGEST)
    for bearing in bearings(plan.rows, chart[0]):
        fine = fine & (bearing > 0.0)
    store(summary, (STARTS, first), where(fine, 1.0, 0.0), plan.lanes)


for _formula in (
    load_body, initial_state, initial_record, load_state, load_record, store_carried, advance,
    advance_still, has_still, is_still, is_gentle, advance_gently, tidy, observe,
    store_errors, store_state, store_forces, store_summary, store_start, store_end, heard,
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
    multipliers, reactions, ends, offset, begin, stop, last, origin, first_step, h, measure_every,
    save_every,
):  # fmt: skip
    """Steps begin … stop of the block that starts at `first` (`offset` + `first` in histories).

    `last` is the run's last step. With begin = UNSEEN the start is looked at first; with stop = 0
    that is all. With begin = RESUMED the state to start from is carried. States (rotations …
    velocities) have a row for every saved step, or for the last one only.

    Step k is at origin + h·(first_step + k): a run that goes on from another one counts on, and so
    has its times, and its rounding tidied, as if there had been no break.
    """
    resumes = begin == RESUMED
    if begin == UNSEEN:
        store_start(plan, inputs, summary, first, origin + h * first_step)
    begin = max(begin, 0)
    if stop == 0:
        return
    body = load_body(plan, inputs, first)
    if begin > 0 or resumes:
        state = load_state(plan, body, carried, first)
    else:
        state = initial_state(plan, body, inputs, first)
    if begin > 0:
        record = load_record(plan, carried, first)
    else:
        record = initial_record(plan, body, state)
    column = offset + first
    still = is_still(plan, state, h)
    k = begin
    fresh = begin == 0
    while True:
        time = origin + h * (first_step + k)
        save = save_every > 0 and (k % save_every == 0 or k == last)
        if fresh and (save or k % measure_every == 0 or k == last):
            now, seen = observe(plan, body, state, record, k, time)
            if k % measure_every == 0 or k == last:
                record = seen
            if save:
                row = (k + save_every - 1) // save_every
                store_errors(plan, record, now, errors, row, column)
                store_forces(plan, body, state, record, multipliers, reactions, row, column, time)
                if k == last:  # before, the next step fails
                    record = heard(plan, record, k)
            if k == last or (save and rotations.shape[0] > 1):
                row = rotations.shape[0] - 1 if k == last else k // save_every
                states = (rotations, places, omegas, velocities)
                store_state(plan, body, inputs, state, record, states, row, first, column)
        if k >= stop:
            break
        counted = first_step + k
        # After the measures: they see what rounding did.
        if counted % TIDY_EVERY == 0 and (k > 0 or resumes):
            state = tidy(plan, body, state)
        ahead = min(_until(k, measure_every, stop), _until(counted, TIDY_EVERY, first_step + stop))
        if save_every > 0:
            ahead = min(ahead, _until(k, save_every, stop))
        end = k + ahead
        if still and is_gentle(plan, body, state, record, h):
            while k < end:
                moved, fine = advance_gently(plan, body, state, origin + h * (first_step + k), h)
                if not fine:
                    break
                state = moved
                k += 1
        if still and has_still(plan, h):
            while k < end:
                time = origin + h * (first_step + k)
                k += 1
                state, record = advance_still(plan, body, state, record, k, time, h)
        while k < end:
            time = origin + h * (first_step + k)
            k += 1
            state, record = advance(plan, body, state, record, k, time, h)
        fresh = True
    if stop < last:
        store_carried(plan, carried, first, state, record)
    else:
        store_summary(plan, state, record, summary, first)
        store_end(plan, state, ends, column)


@_jit.cached(parallel=True)
def integrate_blocks(
    sources, integrate, counter, lanes, threads, inputs, carried, summary, errors, rotations,
    places, omegas, velocities, multipliers, reactions, ends, offset, begin, stop, last, origin,
    first_step, h, measure_every, save_every,
):  # fmt: skip
    """All blocks by `integrate`, an entry of integrate_block: one loop for all plans.

    counter : [0, 0], of blocks that some thread has taken; of what has ended one, if anything.
    """
    blocks = inputs.shape[1] // lanes
    for _ in prange(threads):  # each takes what comes next: cores need not be equally fast
        while True:
            block = _jit.take_turn(counter)
            if block >= blocks:
                break
            raised = _jit.call(
                integrate, block * lanes, inputs, carried, summary, errors, rotations, places,
                omegas, velocities, multipliers, reactions, ends, offset, begin, stop, last, origin,
                first_step, h, measure_every, save_every,
            )  # fmt: skip
            if raised != 0:
                counter[1] = raised
    _jit.raise_again(counter[1])
