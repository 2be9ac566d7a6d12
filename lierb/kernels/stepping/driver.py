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

import numpy as np
from numba import prange
from numpy.typing import NDArray

from lierb.compiler import calls
from lierb.compiler.code import cached
from lierb.compiler.entries import call, raise_again, take_turns
from lierb.compiler.loops import histories_at, integers_at, number_at, numbers_at, shared
from lierb.compiler.trace import kernel
from lierb.kernels.groups.coefficients import TINY
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
    scatter,
    sqrt,
    store,
    where,
)
from lierb.kernels.numbers.zero import ZERO, is_zero
from lierb.kernels.stepping.clock import Clock, ahead_of, seen_at, share_of, time_of
from lierb.kernels.stepping.formulations import LARGEST
from lierb.kernels.stepping.layout import LANE_SUMMARY, POSE_AND_TWIST
from lierb.kernels.stepping.measures import (
    JOINT_ERRORS,
    JOINT_KEPT,
    KEPT,
    MEASURES,
    MUST_BE_FINITE,
    SUMMARY,
    Measure,
)
from lierb.kernels.stepping.observables import (
    KEEPS,
    Kept,
    columns_of,
    kept_of,
    may_raise,
    nothing_kept,
    observables_of,
    with_value,
)
from lierb.kernels.stepping.plan import AnyPlan
from lierb.kernels.stepping.signals import lane_end, signals_width
from lierb.kernels.stepping.state import State
from lierb.kernels.stepping.status import NON_FINITE, OK, RAISED, SINGULAR
from lierb.kernels.stepping.stepper import step
from lierb.kernels.stepping.systems import system_of

# In place of step 0: for a start that is to be looked at, and for one that goes on from a state.
UNSEEN, RESUMED = -1, -2
TWISTS, POSES, BODIES = range(3)  # each with those before it
SHARES = 8  # in which a thread takes what would be its part, the first of them
NAN = float("nan")


ARRAYS = {
    "places": "int64, [column of inputs][address for the first trajectory, bytes to the next]",
    "varying": "int64, [1][columns of inputs in which trajectories differ]",
    "inputs": "[thread][column][lane], where each thread brings a block's numbers together",
    "carried": "[column][trajectory of the chunk, padded to full blocks], between two calls",
    "summary": "[SUMMARY, KEEPS of each observable, JOINT_KEPT of each joint][trajectory]",
    "history": "[`history_measures`, observables, JOINT_ERRORS of each joint][time][trajectory]",
    **dict.fromkeys(
        (field.name for field in POSE_AND_TWIST.fields),
        "[link, time or the last one alone][trajectory][component]",
    ),
    "multipliers": "[time][trajectory][row of any joint]",
    "reactions": "[joint, time][trajectory][component]",
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
            ("differ", np.int64),  # from trajectory to trajectory: TWISTS, POSES or BODIES
            ("rows", np.int64),  # of the states, for each link: all saved times, or the last one
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

    sizes : first, stop, begin, end, differ and rows.
    """
    numbers: list[int] = []
    for name in ARRAYS:
        array = arrays[name]
        extents = array.shape + (1,) * (3 - array.ndim)
        numbers += (array.__array_interface__["data"][0], *extents)
    content = _PACKED.pack(*numbers, *sizes, *clock)
    return np.frombuffer(bytearray(content), JOB)


@lru_cache(64)
def history_measures(plan: AnyPlan) -> tuple[Measure, ...]:
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
    joints: tuple[Any, ...] = ()  # of a mechanism's joints, JOINT_KEPT of each: squares


def marks_column(plan: AnyPlan) -> int:
    """Of what is carried: what functions have raised."""
    return system_of(plan).state.count + len(KEPT) + len(Record._fields) - 3


def carried_columns(plan: AnyPlan) -> int:
    watched = len(Kept._fields) * len(observables_of(plan)) + joint_columns(plan)
    return marks_column(plan) + 1 + watched


def joint_columns(plan: AnyPlan) -> int:
    """Of a summary: JOINT_KEPT of every joint of a mechanism."""
    return len(JOINT_KEPT) * len(system_of(plan).joints)


def summary_columns(plan: AnyPlan) -> int:
    return lane_column(plan) + (LANE_SUMMARY.count + signals_width(plan)) * plan.has_lane_clocks


def lane_column(plan: AnyPlan) -> int:
    """Of a summary: the first of LANE_SUMMARY, where lanes have clocks of their own."""
    return SUMMARY.count + len(KEEPS) * len(observables_of(plan)) + joint_columns(plan)


def history_columns(plan: AnyPlan) -> int:
    """Measures, observables, the errors of every joint of a mechanism, the user's states and
    outputs.
    """
    own = len(history_measures(plan)) + len(observables_of(plan))
    return own + len(JOINT_ERRORS) * len(system_of(plan).joints) + signals_width(plan)


# ---- formulas on one block ---------------------------------------------------------------------


def _columns(plan: AnyPlan, array: Any, columns: range, first: Any) -> list[Any]:
    return [load(array, (c, first), plan.lanes) for c in columns]


def _inputs(plan: AnyPlan, inputs: Any) -> list[Any]:
    """All numbers but a state to go on from."""
    return _columns(plan, inputs, range(system_of(plan).inputs["state"].start), 0)


def load_body(plan: AnyPlan, inputs: Any) -> Any:
    return system_of(plan).body(_inputs(plan, inputs))


def load_placed(plan: AnyPlan, body: Any, inputs: Any) -> Any:
    """What all starts in one pose have in common."""
    return system_of(plan).placed(body, _inputs(plan, inputs))


def load_given(plan: AnyPlan, inputs: Any, time: Any) -> Any:
    """The same of what is looked at, whether they are on the joint."""
    return system_of(plan).given(_inputs(plan, inputs), time)


def initial_state(plan: AnyPlan, body: Any, placed: Any, inputs: Any) -> State:
    state: State = system_of(plan).start(body, placed, _inputs(plan, inputs))
    return state


def initial_record(plan: AnyPlan, body: Any, state: State) -> Record:
    """Nothing kept so far, as numbers of the state's own type."""
    nothing = 0.0 * body.mass  # no constant: 1 / t of a motor is inf, no error
    system = system_of(plan)
    seen = system.measured(body, state, system.seen(body, state, nothing), nothing)
    energy = seen.values["energy"]
    dropped = system.dropped(body, state)
    if plan.calls_functions and not plan.has_lane_clocks:
        calls.set_marks(nothing + float(calls.CLEAR))
    watched = nothing_kept(plan, nothing)
    joints = (nothing,) * joint_columns(plan)
    kept = (nothing,) * len(KEPT)
    return Record(kept, energy, nothing, nothing, nothing + dropped, watched, joints)


def resumed_state(plan: AnyPlan, body: Any, inputs: Any) -> State:
    """The one that a run goes on from."""
    at = system_of(plan).inputs["state"]
    numbers = _columns(plan, inputs, range(at.start, at.stop), 0)
    state: State = system_of(plan).state_of(numbers, body)
    return state


def load_state(plan: AnyPlan, body: Any, carried: Any, first: Any) -> State:
    numbers = _columns(plan, carried, range(system_of(plan).state.count), first)
    state: State = system_of(plan).state_of(numbers, body)
    return state


def load_record(plan: AnyPlan, carried: Any, first: Any) -> Record:
    marks, watched = marks_column(plan), len(Kept._fields) * len(observables_of(plan))
    numbers = _columns(plan, carried, range(system_of(plan).state.count, marks), first)
    more = tuple(_columns(plan, carried, range(marks + 1, carried_columns(plan)), first))
    kept, (energy, status, step, dropped) = tuple(numbers[: len(KEPT)]), numbers[len(KEPT) :]
    seen = kept_of(more[:watched]), more[watched:]
    record = Record(kept, energy, status, step, dropped, *seen)
    if plan.calls_functions:
        before = load(carried, (marks, first), plan.lanes)
        # Lanes with clocks of their own are heard once they have handed over their ends.
        known = before if plan.has_lane_clocks else where(before > 0.0, float(calls.HEARD), before)
        fine = where(record.status == OK, float(calls.CLEAR), float(calls.SILENT))
        calls.set_marks(where(before > calls.SILENT, known, fine))
    return record


def store_carried(plan: AnyPlan, carried: Any, first: Any, state: State, record: Record) -> None:
    kept, *more, watched, joints = record
    numbers = (*flatten(state), *kept, *more, *_raised_in_call(plan, record))
    for c, number in enumerate(numbers):
        store(carried, (c, first), number, plan.lanes)
    for c, number in enumerate(flatten((watched, joints)), marks_column(plan) + 1):
        store(carried, (c, first), number, plan.lanes)


def store_end(plan: AnyPlan, state: State, ends: Any, column: Any) -> None:
    numbers = [*flatten(state)]
    going_on = [numbers[c] for c in state_columns(plan)]
    places = [(c, column) for c in range(len(going_on))]
    scatter(ends, 1, places, going_on, plan.lanes)


@lru_cache(64)
def end_columns(plan: AnyPlan) -> tuple[int, ...]:
    """Of a state to go on from those that are kept at the end: `state_columns`, then `lane_end`."""
    first = system_of(plan).state.count
    return (*state_columns(plan), *range(first, first + lane_end(plan).count))


@lru_cache(64)
def state_columns(plan: AnyPlan) -> tuple[int, ...]:
    """Of the state's numbers those that are kept at the end: what the plan has, but W, which counts
    from the start of its own run.
    """
    columns = system_of(plan).state
    numbers = flatten(system_of(plan).state_of((1.0,) * columns.count))
    work = columns.index("work")
    return tuple(c for c, number in enumerate(numbers) if c != work and not is_zero(number))


def advance(
    plan: AnyPlan, body: Any, state: State, record: Record, k: Any, time: Any, h: Any
) -> tuple[State, Record]:
    """Step number k, from `time` on.

    A body that fails keeps its status and step, and is NaN from then on.
    """
    return _advanced(plan, body, state, record, k, time, h, ())


def advance_still(
    plan: AnyPlan, body: Any, state: State, record: Record, k: Any, time: Any, h: Any
) -> tuple[State, Record]:
    """The same, to the same bits, where `is_still`: half of a saddle point's operations."""
    still = plan.formulation.still
    if not still:
        return state, record  # never
    return _advanced(plan, body, state, record, k, time, h, still)


def _advanced(
    plan: AnyPlan,
    body: Any,
    state: State,
    record: Record,
    k: Any,
    time: Any,
    h: Any,
    still: tuple[int, ...],
) -> tuple[State, Record]:
    body = body._replace(dropped=record.dropped)
    moved, singular = _stepped(plan, body, state, time, h, still)
    # An angle that is not finite spoils all of Q.
    turns, places = system_of(plan).told_by(moved.chart)
    numbers = (*turns, *moved.v_or_mu, *moved.x, *places, moved.work)
    fine = are_finite(*numbers) & (singular <= 0.5)
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


def heard(plan: AnyPlan, record: Record, k: Any) -> Record:
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


def _raised_in_call(plan: AnyPlan, record: Record) -> Any:
    """What functions have raised; negative where the body had failed before."""
    if not plan.calls_functions:
        return ()
    known = calls.marks(record.status)
    counts = (record.status == OK) | (record.status == RAISED)
    return (where(counts, known, -known),)


def _stepped(
    plan: AnyPlan, body: Any, state: State, time: Any, h: Any, still: tuple[int, ...]
) -> tuple[State, Any]:
    """A step, with V's components that are `still` as structural zeros."""
    before = state.v_or_mu
    moving = tuple(ZERO if i in still else v for i, v in enumerate(before))
    moved, singular = step(plan, body, state._replace(v_or_mu=moving), time, h)
    pairs = zip(before, moved.v_or_mu, strict=True)
    after = tuple(v if i in still else x for i, (v, x) in enumerate(pairs))
    return moved._replace(v_or_mu=after), singular


def are_finite(*numbers: Any) -> Any:
    """Whether all of them are, and so is their sum."""
    numbers = numbers or (ZERO,)
    while len(numbers) > 1:  # by halves: a sum of one after the other keeps the next step waiting
        half = len(numbers) // 2
        pairs = zip(numbers[:half], numbers[half : 2 * half], strict=True)
        numbers = (*(a + b for a, b in pairs), *numbers[2 * half :])
    return absolute(numbers[0]) <= LARGEST  # false for NaN


def has_still(plan: AnyPlan, h: Any) -> Any:
    """Whether the plan's rows keep anything `still`."""
    return all_lanes(h == h if plan.formulation.still else h < h)


def is_still(plan: AnyPlan, state: State, h: Any) -> Any:
    """Whether what the plan's rows keep `still` is so, in all lanes; and so it stays."""
    velocity = state.v_or_mu
    still = h == h
    for i in plan.formulation.still:
        still = still & (velocity[i] == 0.0)
    return all_lanes(still)


def is_gentle(plan: AnyPlan, body: Any, state: State, record: Record, h: Any) -> Any:
    """Whether the next step's angles will be tiny in all lanes, as far as one can tell before."""
    if not plan.takes_gentle_steps:
        return all_lanes(h < h)  # never
    gentle = record.dropped == 0.0
    for square in system_of(plan).turning(body, state):
        gentle = gentle & (h * h * plain(square) <= 0.8 * TINY)
    return all_lanes(gentle)


def advance_gently(plan: AnyPlan, body: Any, state: State, time: Any, h: Any) -> tuple[State, Any]:
    """A step without a branch, and whether it is the step that `advance` makes.

    For states that are `still`. A branch for each stage's angle takes a spherical joint's step a
    twentieth of its time.
    """
    if not plan.takes_gentle_steps:
        return state, all_lanes(h < h)  # never
    with assumptions(h) as conditions:
        moved, singular = _stepped(plan, body, state, time, h, plan.formulation.still)
    _, places = system_of(plan).told_by(moved.chart)
    fine = are_finite(*moved.v_or_mu, *places, moved.work) & (singular <= 0.5)
    for condition in conditions:  # which no angle meets that is not finite
        fine = fine & condition
    return moved, all_lanes(fine)


def tidy(plan: AnyPlan, body: Any, state: State) -> State:
    return state._replace(chart=plan.formulation.tidied(body, state.chart))


def observe(
    plan: AnyPlan,
    body: Any,
    state: State,
    record: Record,
    k: Any,
    time: Any,
    share: Any = ZERO,
    by_halves: bool = False,
) -> tuple[tuple[Any, ...], Record]:
    """The measures and observables of a history at step k, and the record with what is kept of
    them.   share : of the run's time, that the step counts for in means; `by_halves`, half the time
    since the last one, which both count for.

    Where they are not finite they tell nothing, and the body has failed, though its state may be
    finite: squares and energies overflow long before it.
    """
    system = system_of(plan)
    seen = system.seen(body, state, time)
    values = system.observed(body, seen, time)
    if may_raise(plan):
        record = heard(plan, record, k)
    now, joints = system.measured(body, state, seen, time, record.first_energy)
    sizes = {measure.name: measure.size(now[measure.name]) for measure in MEASURES}
    fine = are_finite(*(sizes[name] for name in MUST_BE_FINITE))
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
    errors = tuple(sqrt(square) for joint in joints for square in joint)
    return (*shown, *values, *errors), record._replace(
        kept=tuple(kept),
        status=status,
        failed_step=failed_step,
        observed=tuple(with_value(old, value, share, alive, by_halves) for old, value in pairs),
        joints=_joints_kept(record, joints, alive),
    )


def _joints_kept(
    record: Record, joints: tuple[tuple[Any, ...], ...], alive: Any
) -> tuple[Any, ...]:
    """JOINT_KEPT of every joint, with what is seen now."""
    found = []
    places = ((joint, measure, how) for joint in joints for measure, how in JOINT_KEPT)
    for (joint, measure, how), old in zip(places, record.joints, strict=True):
        square = joint[JOINT_ERRORS.index(measure)]
        if how == "final":
            found.append(where(alive, plain(square), NAN))
        else:
            found.append(old if is_zero(square) else where(alive, maximum(old, square), old))
    return tuple(found)


def without_measures(plan: AnyPlan, record: Record, seen: Record) -> Record:
    """The record after a step that is saved and not measured.   seen : as `observe` has it."""
    if not may_raise(plan):
        return record
    raised = (seen.status == RAISED) & (record.status == OK)
    return record._replace(
        status=where(raised, seen.status, record.status),
        failed_step=where(raised, seen.failed_step, record.failed_step),
    )


def store_measures(
    plan: AnyPlan, record: Record, shown: tuple[Any, ...], history: Any, row: Any, first: Any
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
    plan: AnyPlan, body: Any, inputs: Any, state: State, record: Record
) -> list[tuple[Any, ...]]:
    """R (row by row), r, ω, v in the user's frames, of every link; NaN after a failure."""
    links = system_of(plan).in_user_frames(body, _inputs(plan, inputs), state)
    alive = record.status == OK
    return [where(alive, numbers, (NAN,) * len(numbers)) for numbers in links]


def store_state(
    plan: AnyPlan,
    body: Any,
    inputs: Any,
    state: State,
    record: Record,
    states: Any,
    row: Any,
    rows: Any,
    column: Any,
) -> None:
    """One row of the states: R, r, ω and v, each [link, time][body][component].

    rows : of each link.
    """
    for numbers in user_state(plan, body, inputs, state, record):
        for array, part in zip(states, POSE_AND_TWIST.parts(numbers).values(), strict=True):
            scatter(array, 1, [(row, column, c) for c in range(len(part))], part, plan.lanes)
            prefetch(array, (row + 1, column, 0), plan.lanes * len(part))
        row = row + rows


def store_forces(
    plan: AnyPlan,
    body: Any,
    state: State,
    record: Record,
    multipliers: Any,
    reactions: Any,
    row: Any,
    rows: Any,
    first: Any,
    time: Any,
) -> None:
    """One row of the history's λ, [time][body][row], and of reactions, [joint, time][body][…].

    rows : of each joint.
    """
    if not (plan.multipliers or plan.reaction):
        return
    found, wrenches = system_of(plan).forces(body, state, time)
    alive = record.status == OK
    if plan.multipliers and found:
        places = [(row, first, c) for c in range(len(found))]
        scatter(multipliers, 1, places, where(alive, found, (NAN,) * len(found)), plan.lanes)
        prefetch(multipliers, (row + 1, first, 0), plan.lanes * len(found))
    for wrench in wrenches if plan.reaction else ():
        places = [(row, first, c) for c in range(6)]
        scatter(reactions, 1, places, where(alive, wrench, (NAN,) * 6), plan.lanes)
        prefetch(reactions, (row + 1, first, 0), plan.lanes * 6)
        row = row + rows


def store_summary(plan: AnyPlan, record: Record, summary: Any, column: Any) -> None:
    """What is kept of the measures, status and the step of a failure."""
    r = record
    kept = [measure.shown(x) for (measure, _), x in zip(KEPT, r.kept, strict=True)]
    numbers = (*kept, r.status, r.failed_step, *_raised_in_call(plan, r))
    watched = (
        *(x for kept in r.observed for x in columns_of(kept)),
        *(sqrt(square) for square in r.joints),
    )
    places = [*range(len(numbers)), *(SUMMARY.count + c for c in range(len(watched)))]
    scatter(summary, 1, [(c, column) for c in places], (*numbers, *watched), plan.lanes)


def store_start(
    plan: AnyPlan, given: Any, inputs: Any, summary: Any, column: Any, time: Any
) -> None:
    """Whether the start, as given, is on the joint.

    time : s, of the start.
    """
    starts = system_of(plan).starts_well(given, _inputs(plan, inputs), time)
    scatter(summary, 1, [(SUMMARY.index("starts"), column)], [starts], plan.lanes)


for _formula in (
    load_body, load_placed, load_given, initial_state, initial_record, resumed_state, load_state,
    load_record, store_carried, advance, advance_still, has_still, is_still, is_gentle,
    advance_gently, tidy, observe, store_measures, store_state, store_forces, store_summary,
    store_start, store_end, heard, without_measures,
):  # fmt: skip
    kernel(_formula)


# ---- the loop over steps and the loop over blocks ------------------------------------------------


@shared
def pack(job, inputs, first, is_new):
    """A block's numbers from where the user has them; past the last trajectory, its own again.

    is_new : whether `inputs` lacks even what all trajectories share.
    """
    places, varying = integers_at(job.places), integers_at(job.varying)
    begin, last = job.first + first, job.stop - job.first - first - 1
    for i in range(inputs.shape[0] if is_new else varying.shape[1]):
        c = i if is_new else varying[0, i]
        stride = places[c, 1]
        address = places[c, 0] + stride * begin
        for lane in range(inputs.shape[1]):
            inputs[c, lane] = number_at(address)
            address += stride if lane < last else 0


@shared
def take_share(counter, count, threads):
    """The first of the next numbers below `count` for a thread, and the one behind the last.

    They become fewer and fewer, so that all threads end together on cores that are not equally
    fast. Neighbours go to one thread: two that write side by side wait for each other, in short
    runs for as long as the work takes.
    """
    size = max((count - counter[0]) // (SHARES * threads), 1)
    first = take_turns(counter, size)
    return first, min(first + size, count)


@cached()
def integrate_blocks(plan, inputs, counter, jobs):
    """A call's steps of block after block, share by share.

    With begin = UNSEEN starts are looked at first. With begin = RESUMED the states to start from
    are among the inputs.

    inputs : where the thread brings a block's numbers together.
    counter : [0, 0], of blocks that some thread has taken; of what has ended one, if anything.
    """
    job, lanes = jobs[0], inputs.shape[1]
    # Apart from the record: what a loop reads from memory might have been written there.
    clock = Clock(job.dt, job.steps, job.measure_every, job.save_every, job.origin, job.first_step)
    carried, summary, ends = numbers_at(job.carried), numbers_at(job.summary), numbers_at(job.ends)
    history, multipliers = histories_at(job.history), histories_at(job.multipliers)
    reactions, saved = histories_at(job.reactions), history.shape[1]
    states = (
        histories_at(job.rotation),
        histories_at(job.position),
        histories_at(job.omega),
        histories_at(job.v),
    )
    last, stop, resumes, h = clock.steps, job.end, job.begin == RESUMED, clock.dt
    blocks = (job.stop - job.first + lanes - 1) // lanes
    is_new, block, behind = True, 0, 0
    while True:
        if block == behind:
            block, behind = take_share(counter, blocks, job.inputs[1])
            if block >= behind:
                break
        first, k = block * lanes, max(job.begin, 0)
        column, fresh = job.first + first, k == 0
        pack(job, inputs, first, is_new)
        if is_new or job.differ == BODIES:  # what all share is found once
            body = load_body(plan, inputs)
        if is_new or job.differ != TWISTS:
            placed = load_placed(plan, body, inputs)
            given = load_given(plan, inputs, time_of(clock, 0))
        is_new = False
        block += 1
        if job.begin == UNSEEN:
            store_start(plan, given, inputs, summary, column, time_of(clock, 0))
        if stop == 0:
            continue
        if resumes:
            state = resumed_state(plan, body, inputs)
        elif k > 0:
            state = load_state(plan, body, carried, first)
        else:
            state = initial_state(plan, body, placed, inputs)
        if k > 0:
            record = load_record(plan, carried, first)
        else:
            record = initial_record(plan, body, state)
        still = is_still(plan, state, h)
        while True:
            time = time_of(clock, k)
            measure, save, row = seen_at(clock, k)
            if fresh and (measure or save):
                shown, seen = observe(plan, body, state, record, k, time, share_of(clock, k))
                record = seen if measure else without_measures(plan, record, seen)
                if save:
                    store_measures(plan, record, shown, history, row, column)
                    store_forces(
                        plan, body, state, record, multipliers, reactions, row, saved, column, time
                    )
                    if k == last:  # before, the next step fails
                        record = heard(plan, record, k)
                if k == last or (save and job.rows > 1):
                    row = job.rows - 1 if k == last else row
                    store_state(plan, body, inputs, state, record, states, row, job.rows, column)
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
            store_end(plan, state, ends, column)


@cached(parallel=True)
def integrate_on_threads(integrate, counter, threads, jobs):
    """All blocks by `integrate`, an entry of integrate_blocks: one parallel loop for all plans."""
    for thread in prange(threads):
        inputs = histories_at(jobs[0].inputs)[thread]
        raised = call(integrate, inputs, counter, jobs)
        if raised != 0:
            counter[1] = raised
    raise_again(counter[1])
