"""The compiled driver: blocks of L bodies, in parallel, from one step number to another.

Numbers are read where the user has them, and results written where Arrow's columns will be (`JOB`).
Between two calls everything about a trajectory lives in `carried`: cutting a run into calls changes
no bit. At the end the state itself goes to `ends`, for a run that goes on from there: it changes no
bit either.
"""

from __future__ import annotations

from functools import lru_cache
from struct import Struct
from typing import Any, NamedTuple, get_type_hints

import numba
import numpy as np
from numba import prange
from numpy.typing import NDArray

from lierb.compiler import calls
from lierb.compiler.code import OPTIONS, cached
from lierb.compiler.entries import call, raise_again, take_turn
from lierb.compiler.loops import histories_at, integers_at, number_at, numbers_at, shared
from lierb.compiler.trace import kernel
from lierb.kernels.groups import quaternion, so3
from lierb.kernels.groups.coefficients import TINY
from lierb.kernels.mechanics.elements import Element, body_with
from lierb.kernels.mechanics.newton_euler import (
    SE3,
    BodyConstants,
    Parameters,
    SO3xR3,
    about_a_point,
    closed_pose,
)
from lierb.kernels.mechanics.scale import bearings, start_tolerances
from lierb.kernels.numbers.arithmetic import (
    absolute,
    all_lanes,
    assumptions,
    branch,
    flatten,
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
    Mat,
    Vec,
    diagonal,
    dot,
    mat_mat,
    mat_vec_add,
)
from lierb.kernels.numbers.zero import ZERO, is_zero
from lierb.kernels.stepping.clock import Clock, ahead_of, seen_at, share_of, time_of
from lierb.kernels.stepping.formulations import LARGEST, accelerate
from lierb.kernels.stepping.layout import INPUTS, POSE_AND_TWIST, STATE, inputs_of
from lierb.kernels.stepping.measures import (
    KEPT,
    MEASURES,
    MUST_BE_FINITE,
    SUMMARY,
    Measure,
    measured,
)
from lierb.kernels.stepping.observables import (
    KEEPS,
    Kept,
    columns_of,
    kept_of,
    may_raise,
    nothing_kept,
    observables_of,
    observed,
    with_value,
)
from lierb.kernels.stepping.plan import Plan
from lierb.kernels.stepping.stepper import (
    State,
    chart_of,
    pose_of,
    step,
    structured,
    tidied,
    velocity_of,
)

OK, SINGULAR, NON_FINITE, RAISED = 0, 1, 2, 3  # status codes
# In place of step 0: for a start that is to be looked at, and for one that goes on from a state.
UNSEEN, RESUMED = -1, -2
NAN = float("nan")


ARRAYS = {
    "places": "int64, [column of inputs][address for the first trajectory, bytes to the next]",
    "varying": "int64, [1][columns of inputs in which trajectories differ]",
    "inputs": "[thread][column][lane], where each thread brings a block's numbers together",
    "carried": "[column][trajectory of the chunk, padded to full blocks], between two calls",
    "summary": "[SUMMARY, then KEEPS of each observable][trajectory]",
    "history": "[`history_measures`, then observables][time][trajectory]",
    **dict.fromkeys(
        (field.name for field in POSE_AND_TWIST.fields),
        "[time, or the last one alone][trajectory][component]",
    ),
    "multipliers": "[time][trajectory][component]",
    "reactions": "[time][trajectory][component]",
    "ends": "[`end_columns`][trajectory]",
}
JOB = np.dtype(
    (
        np.record,
        [
            *((name, np.int64, (4,)) for name in ARRAYS),  # address and extents
            ("first", np.int64),  # trajectory of the chunk
            ("stop", np.int64),  # the one after its last
            ("begin", np.int64),  # step of this call
            ("end", np.int64),  # 0: to look at the start alone
            ("differ", np.int64),  # 1 where bodies do, 0 where but their starts do
            *get_type_hints(Clock).items(),
        ],
    )
)
"""What the loops over blocks and steps work on: arrays, float64 and C-contiguous but for one,
sizes, and the clock. In one record, of which nothing but its address goes through calls."""


_CODES = {"i": "q", "f": "d", "V": "4q"}  # of whole numbers, reals, and addresses with extents
_PACKED = Struct("=" + "".join(_CODES[JOB[name].kind] for name in JOB.names or ()))


def job_of(arrays: dict[str, NDArray], *sizes: int, clock: Clock) -> NDArray:
    """The record, as an array of one; whoever calls keeps the arrays.

    sizes : first, stop, begin, end and differ.
    """
    numbers: list[int] = []
    for name in ARRAYS:
        array = arrays[name]
        extents = array.shape + (1,) * (3 - array.ndim)
        numbers += (array.__array_interface__["data"][0], *extents)
    content = _PACKED.pack(*numbers, *sizes, *clock)
    return np.frombuffer(bytearray(content), JOB)


@lru_cache(64)
def history_measures(plan: Plan) -> tuple[Measure, ...]:
    """Those of a history: `work` where something does any."""
    return tuple(m for m in MEASURES if m.name != "work" or plan.does_work)


class Record(NamedTuple):
    """What a run remembers of a body."""

    kept: tuple[Any, ...]  # of KEPT; squares where a measure is one
    first_energy: Any
    status: Any
    failed_step: Any
    dropped: Any  # at the start; see `BodyConstants`
    observed: tuple[Kept, ...] = ()


MARKS = STATE.count + len(KEPT) + len(Record._fields) - 2  # column of what functions have raised
WATCHED = MARKS + 1  # the first of what is kept of observables


def carried_columns(plan: Plan) -> int:
    return WATCHED + len(Kept._fields) * len(observables_of(plan))


def summary_columns(plan: Plan) -> int:
    return SUMMARY.count + len(KEEPS) * len(observables_of(plan))


# ---- formulas on one block ---------------------------------------------------------------------


def _columns(plan: Plan, array: Any, columns: range, first: Any) -> list[Any]:
    return [load(array, (c, first), plan.lanes) for c in columns]


def _inputs(plan: Plan, inputs: Any, count: int | None = None) -> list[Any]:
    """The first `count` numbers, or all but a state to go on from."""
    many = inputs_of(plan.elements)["state"].start if count is None else count
    return _columns(plan, inputs, range(many), 0)


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
    return body_with(space, parameters, elements, numbers[INPUTS.count :])


def load_body(plan: Plan, inputs: Any) -> BodyConstants:
    numbers = _inputs(plan, inputs)
    body = body_of(plan.space, plan.elements, numbers)
    if plan.turns_about_a_point:
        turn, centre, moments, differences = about_a_point(body)
        turn = so3.orthonormalised(turn)
        turned = body_of(plan.space, plan.elements, numbers, turn)
        body = plan.space.centred(turned, centre)._replace(
            turn=turn, origin_inertia=diagonal(moments), moments=moments, differences=differences
        )
    if plan.formulation.slides_as_it_turns:
        shift = (*body.com[:2], ZERO)
        moved = body_of(plan.space, plan.elements, numbers, shift=shift)
        body = plan.space.centred(moved, (ZERO, ZERO, body.com[2]))._replace(shift=shift)
    return plan.formulation.prepared(body)


def _start(plan: Plan, body: BodyConstants, inputs: Any) -> tuple[Parameters, Any, Any]:
    """Parameters in the body's own joint axes; pose and twist as given."""
    return parameters_of(_inputs(plan, inputs, INPUTS.count), body.turn, body.shift)


def initial_state(plan: Plan, body: BodyConstants, inputs: Any) -> State:
    parameters, pose, twist = _start(plan, body, inputs)
    placed, velocity = plan.space.to_joint_axes(parameters, pose, twist)
    chart, v_or_mu = plan.formulation.start(
        body, parameters, twist, quaternion.from_pose(placed), velocity
    )
    still = tuple(0.0 * v for v in velocity)
    return structured(plan, State(chart, still, v_or_mu, 0.0 * parameters.mass), parameters.pitch)


def initial_record(plan: Plan, body: BodyConstants, state: State) -> Record:
    """Nothing kept so far, as numbers of the state's own type."""
    nothing = 0.0 * body.mass  # no constant: 1 / t of a motor is inf, no error
    pose, velocity = pose_of(plan, state), velocity_of(plan, body, state)
    kinetic_energy = plan.formulation.kinetic_energy(body, state.v_or_mu)
    seen = measured(plan, body, pose, velocity, kinetic_energy, state.work, nothing)
    energy = seen["energy"]
    dropped = plan.formulation.dropped(body, chart_of(plan, state), state.v_or_mu)
    if plan.calls_functions:
        calls.set_marks(nothing + float(calls.CLEAR))
    watched = nothing_kept(plan, nothing)
    return Record((nothing,) * len(KEPT), energy, nothing, nothing, nothing + dropped, watched)


def resumed_state(plan: Plan, body: BodyConstants, inputs: Any) -> State:
    """The one that a run goes on from."""
    at = inputs_of(plan.elements)["state"]
    numbers = _columns(plan, inputs, range(at.start, at.stop), 0)
    return _state_of(plan, numbers, body.pitch)


def load_state(plan: Plan, body: BodyConstants, carried: Any, first: Any) -> State:
    numbers = _columns(plan, carried, range(STATE.count), first)
    return _state_of(plan, numbers, body.pitch)


def _state_of(plan: Plan, numbers: Any, pitch: Any) -> State:
    found = STATE.parts(numbers)
    state = State((found["p"], found["d"]), found["x"], found["v_or_mu"], *found["work"])
    return structured(plan, state, pitch)


def load_record(plan: Plan, carried: Any, first: Any) -> Record:
    numbers = _columns(plan, carried, range(STATE.count, MARKS), first)
    watched = _columns(plan, carried, range(WATCHED, carried_columns(plan)), first)
    kept, (energy, status, step, dropped) = tuple(numbers[: len(KEPT)]), numbers[len(KEPT) :]
    record = Record(kept, energy, status, step, dropped, kept_of(tuple(watched)))
    if plan.calls_functions:
        before = load(carried, (MARKS, first), plan.lanes)
        pending = where(before > calls.SILENT, float(calls.HEARD), float(calls.CLEAR))
        calls.set_marks(where(record.status == OK, pending, float(calls.SILENT)))
    return record


def store_carried(plan: Plan, carried: Any, first: Any, state: State, record: Record) -> None:
    kept, *more, watched = record
    numbers = (*_numbers_of(state), *kept, *more, *_raised_in_call(plan, record))
    for c, number in enumerate(numbers):
        store(carried, (c, first), number, plan.lanes)
    for c, number in enumerate(flatten(watched)):
        store(carried, (WATCHED + c, first), number, plan.lanes)


def _numbers_of(state: State) -> tuple[Any, ...]:
    """In the order of STATE."""
    chart, x, v_or_mu, work = state
    return (*chart[0], *chart[1], *x, *v_or_mu, work)


def store_end(plan: Plan, state: State, ends: Any, column: Any) -> None:
    numbers = _numbers_of(state)
    going_on = [numbers[c] for c in end_columns(plan)]
    places = [(c, column) for c in range(len(going_on))]
    scatter(ends, 1, places, going_on, plan.lanes)


@lru_cache(64)
def end_columns(plan: Plan) -> tuple[int, ...]:
    """Of STATE those that are kept at the end: what the plan has, but W, which counts from the
    start of its own run.
    """
    numbers = _numbers_of(_state_of(plan, (1.0,) * STATE.count, 1.0))
    work = STATE.index("work")
    return tuple(c for c, number in enumerate(numbers) if c != work and not is_zero(number))


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
    still = plan.formulation.still
    if not still:
        return state, record  # never
    return _advanced(plan, body, state, record, k, time, h, still)


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
    """The record, where a function has raised since the last step: asked for λ or the reaction, or
    an observable.
    """
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
    return all_lanes(h == h if plan.formulation.still else h < h)


def is_still(plan: Plan, state: State, h: Any) -> Any:
    """Whether what the plan's rows keep `still` is so, in all lanes; and so it stays."""
    velocity = state.v_or_mu
    still = h == h
    for i in plan.formulation.still:
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
        moved, singular = _stepped(plan, body, state, time, h, plan.formulation.still)
    fine = _are_finite(*moved.v_or_mu, *moved.chart[1], moved.work) & (singular <= 0.5)
    for condition in conditions:  # which no angle meets that is not finite
        fine = fine & condition
    return moved, all_lanes(fine)


def tidy(plan: Plan, body: BodyConstants, state: State) -> State:
    return state._replace(chart=tidied(plan, body, state.chart))


def observe(
    plan: Plan,
    body: BodyConstants,
    state: State,
    record: Record,
    k: Any,
    time: Any,
    share: Any = ZERO,
) -> tuple[tuple[Any, ...], Record]:
    """The measures and observables of a history at step k, and the record with what is kept of
    them.   share : of the run's time, that the step counts for in means.

    Where they are not finite they tell nothing, and the body has failed, though its state may be
    finite: squares and energies overflow long before it.
    """
    pose, velocity = pose_of(plan, state), velocity_of(plan, body, state)
    values = observed(plan, body, pose, velocity, time)
    if may_raise(plan):
        record = heard(plan, record, k)
    kinetic_energy = plan.formulation.kinetic_energy(body, state.v_or_mu)
    now = measured(
        plan, body, pose, velocity, kinetic_energy, state.work, time, record.first_energy
    )
    sizes = {measure.name: measure.size(now[measure.name]) for measure in MEASURES}
    fine = _are_finite(*(sizes[name] for name in MUST_BE_FINITE))
    so_far = (record.status, record.failed_step)
    alive = (record.status == OK) & fine

    def marked() -> Any:
        fresh = where(record.status == OK, (float(NON_FINITE), real(k)), so_far)
        return where(fine, so_far, fresh)

    status, failed_step = branch(all_lanes(fine), lambda: so_far, marked)
    kept = []
    for (measure, how), old in zip(KEPT, record.kept, strict=True):
        size = sizes[measure.name]
        if how == "final":
            kept.append(where(alive, plain(now[measure.name]), NAN))
        else:
            kept.append(old if is_zero(size) else where(alive, maximum(old, size), old))
    shown = tuple(measure.shown(now[measure.name]) for measure in history_measures(plan))
    # As wide as the block: a function of time alone, called body by body, has one value for it.
    values = tuple(where(alive, value, NAN) for value in values)
    pairs = zip(record.observed, values, strict=True)
    return (*shown, *values), record._replace(
        kept=tuple(kept),
        status=status,
        failed_step=failed_step,
        observed=tuple(with_value(old, value, share, alive) for old, value in pairs),
    )


def without_measures(plan: Plan, record: Record, seen: Record) -> Record:
    """The record after a step that is saved and not measured.   seen : as `observe` has it."""
    if not may_raise(plan):
        return record
    raised = (seen.status == RAISED) & (record.status == OK)
    return record._replace(
        status=where(raised, seen.status, record.status),
        failed_step=where(raised, seen.failed_step, record.failed_step),
    )


def store_measures(
    plan: Plan, record: Record, shown: tuple[Any, ...], history: Any, row: Any, first: Any
) -> None:
    """One row of the history's scalar columns.

    The next row is far from this one, where no hardware looks for it: fetched now, it is at hand
    when the steps to it are made. Otherwise its cache misses take as long as four steps.
    """
    places = [(c, row, first) for c in range(len(shown))]
    alive = record.status == OK
    scatter(history, 2, places, where(alive, tuple(shown), (NAN,) * len(shown)), plan.lanes)
    for c in range(len(shown)):
        prefetch(history, (c, row + 1, first), plan.lanes)


def user_state(
    plan: Plan, body: BodyConstants, inputs: Any, state: State, record: Record
) -> tuple[Any, ...]:
    """R (row by row), r, ω, v in the user's frames; NaN after a failure."""
    parameters, _, _ = _start(plan, body, inputs)
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
    column: Any,
) -> None:
    """One row of the states: R, r, ω and v, each [time][body][component]."""
    numbers = user_state(plan, body, inputs, state, record)
    for array, part in zip(states, POSE_AND_TWIST.parts(numbers).values(), strict=True):
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


def store_summary(plan: Plan, record: Record, summary: Any, column: Any) -> None:
    """What is kept of the measures, status and the step of a failure."""
    r = record
    kept = [measure.shown(x) for (measure, _), x in zip(KEPT, r.kept, strict=True)]
    numbers = (*kept, r.status, r.failed_step, *_raised_in_call(plan, r))
    watched = tuple(x for kept in r.observed for x in columns_of(kept))
    places = [*range(len(numbers)), *(SUMMARY.count + c for c in range(len(watched)))]
    scatter(summary, 1, [(c, column) for c in places], (*numbers, *watched), plan.lanes)


def store_start(plan: Plan, inputs: Any, summary: Any, column: Any, time: Any) -> None:
    """Whether the start, as given, is on the joint.

    time : s, of the start.
    """
    numbers = _inputs(plan, inputs)
    parameters, pose, twist = parameters_of(numbers)
    chart, velocity = plan.space.to_joint_axes(parameters, pose, twist)
    body = body_of(plan.space, plan.elements, numbers)
    x = plan.space.kinematics(body, chart, velocity)._replace(time=time)
    off = measured(plan, body, chart, velocity, ZERO, ZERO, time)
    allowed = start_tolerances(plan.rows, parameters, pose, twist, x, body)
    fine = allowed.position <= LARGEST  # false for NaN
    for name, most in allowed._asdict().items():
        fine = fine & (sqrt(off[f"{name}_error"]) <= most) & (most <= LARGEST)
    for bearing in bearings(plan.rows, chart[0]):
        fine = fine & (bearing > 0.0)
    place = (SUMMARY.index("starts"), column)
    scatter(summary, 1, [place], [where(fine, 1.0, 0.0)], plan.lanes)


for _formula in (
    load_body, initial_state, initial_record, resumed_state, load_state, load_record,
    store_carried, advance, advance_still, has_still, is_still, is_gentle, advance_gently, tidy,
    observe, store_measures, store_state, store_forces, store_summary, store_start, store_end,
    heard, without_measures,
):  # fmt: skip
    kernel(_formula)


# ---- the loop over steps and the loop over blocks ------------------------------------------------


@numba.njit(**OPTIONS, inline="always")  # compiled with its caller alone
def _integrate_block(plan, body, inputs, first, job, clock):
    """A call's steps of the block that starts with the chunk's trajectory `first`.

    With begin = UNSEEN the start is looked at first. With begin = RESUMED the state to start from
    is one of the inputs.
    """
    column, summary = job.first + first, numbers_at(job.summary)
    last, stop = clock.steps, job.end
    if job.begin == UNSEEN:
        store_start(plan, inputs, summary, column, time_of(clock, 0))
    if stop == 0:
        return
    carried, history = numbers_at(job.carried), histories_at(job.history)
    states = (
        histories_at(job.rotation),
        histories_at(job.position),
        histories_at(job.omega),
        histories_at(job.v),
    )
    multipliers, reactions = histories_at(job.multipliers), histories_at(job.reactions)
    resumes, k, h = job.begin == RESUMED, max(job.begin, 0), clock.dt
    if resumes:
        state = resumed_state(plan, body, inputs)
    elif k > 0:
        state = load_state(plan, body, carried, first)
    else:
        state = initial_state(plan, body, inputs)
    if k > 0:
        record = load_record(plan, carried, first)
    else:
        record = initial_record(plan, body, state)
    still = is_still(plan, state, h)
    fresh = k == 0
    while True:
        time = time_of(clock, k)
        measure, save, row = seen_at(clock, k)
        if fresh and (measure or save):
            shown, seen = observe(plan, body, state, record, k, time, share_of(clock, k))
            record = seen if measure else without_measures(plan, record, seen)
            if save:
                store_measures(plan, record, shown, history, row, column)
                store_forces(plan, body, state, record, multipliers, reactions, row, column, time)
                if k == last:  # before, the next step fails
                    record = heard(plan, record, k)
            if k == last or (save and states[0].shape[0] > 1):
                row = states[0].shape[0] - 1 if k == last else row
                store_state(plan, body, inputs, state, record, states, row, column)
        if k >= stop:
            break
        # After the measures: they see what rounding did.
        end, tidies = ahead_of(clock, k, stop)
        if tidies and (k > 0 or resumes):
            state = tidy(plan, body, state)
        if still and is_gentle(plan, body, state, record, h):
            while k < end:
                moved, fine = advance_gently(plan, body, state, time_of(clock, k), h)
                if not fine:
                    break
                state = moved
                k += 1
        if still and has_still(plan, h):
            while k < end:
                time = time_of(clock, k)
                k += 1
                state, record = advance_still(plan, body, state, record, k, time, h)
        while k < end:
            time = time_of(clock, k)
            k += 1
            state, record = advance(plan, body, state, record, k, time, h)
        fresh = True
    if stop < last:
        store_carried(plan, carried, first, state, record)
    else:
        store_summary(plan, record, summary, column)
        store_end(plan, state, numbers_at(job.ends), column)


@shared
def pack(job, inputs, first, is_new):
    """A block's numbers from where the user has them; past the last trajectory, its own again.

    is_new : whether `inputs` lacks even what all trajectories share.
    """
    places, varying = integers_at(job.places), integers_at(job.varying)
    begin, last = job.first + first, job.stop - 1
    for i in range(inputs.shape[0] if is_new else varying.shape[1]):
        c = i if is_new else varying[0, i]
        address, stride = places[c, 0], places[c, 1]
        for lane in range(inputs.shape[1]):
            inputs[c, lane] = number_at(address + stride * min(begin + lane, last))


@cached()
def integrate_blocks(plan, inputs, counter, jobs):
    """Block after block: each thread takes the next, since cores need not be equally fast.

    inputs : where the thread brings a block's numbers together.
    counter : [0, 0], of blocks that some thread has taken; of what has ended one, if anything.
    """
    job, lanes = jobs[0], inputs.shape[1]
    # Apart from the record: what a loop reads from memory might have been written there.
    clock = Clock(job.dt, job.steps, job.measure_every, job.save_every, job.origin, job.first_step)
    blocks = (job.stop - job.first + lanes - 1) // lanes
    is_new = True
    while True:
        block = take_turn(counter)
        if block >= blocks:
            break
        pack(job, inputs, block * lanes, is_new)
        if is_new or job.differ:  # what all share is found once
            body = load_body(plan, inputs)
        _integrate_block(plan, body, inputs, block * lanes, job, clock)
        is_new = False


@cached(parallel=True)
def integrate_on_threads(integrate, counter, threads, jobs):
    """All blocks by `integrate`, an entry of integrate_blocks: one parallel loop for all plans."""
    for thread in prange(threads):
        inputs = histories_at(jobs[0].inputs)[thread]
        raised = call(integrate, inputs, counter, jobs)
        if raised != 0:
            counter[1] = raised
    raise_again(counter[1])
