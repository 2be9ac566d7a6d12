"""The compiled driver of lanes that have a clock each: adaptive steps, output at given times,
events, controllers.

A lane whose trajectory has ended takes the next one at once, so that trajectories of many steps
keep no other lane waiting. One iteration tries a step in every lane; what a lane's trajectory does
depends on its own numbers alone, and so do its bits.

Each thread has a desk: one time of L trajectories, in the same arrays as the results of the batch.
What a lane has to show is written there, by the formulas of `lierb.kernels.stepping.driver`, and
handed over to its place in the results. Between two calls all that the lanes carry lies there, too.
"""

from __future__ import annotations

from typing import Any, NamedTuple, get_type_hints

import numba
import numpy as np
from numba import prange

from lierb.compiler.code import OPTIONS, cached
from lierb.compiler.entries import call, raise_again, take_turn
from lierb.compiler.loops import histories_at, integers_at, number_at, numbers_at, shared
from lierb.compiler.trace import kernel
from lierb.kernels.functions.function import size_of
from lierb.kernels.functions.signals import Noise
from lierb.kernels.numbers.arithmetic import (
    absolute,
    all_lanes,
    any_lanes,
    flatten,
    floor,
    load,
    minimum,
    plain,
    rint,
    store,
    where,
)
from lierb.kernels.numbers.vec import Vec
from lierb.kernels.numbers.zero import ZERO
from lierb.kernels.stepping.driver import (
    ARRAYS,
    NAN,
    RESUMED,
    UNSEEN,
    Record,
    are_finite,
    heard,
    initial_record,
    initial_state,
    load_body,
    load_record,
    load_state,
    observe,
    pack,
    resumed_state,
    state_columns,
    store_carried,
    store_end,
    store_forces,
    store_measures,
    store_start,
    store_state,
    store_summary,
    tidy,
    without_measures,
)
from lierb.kernels.stepping.held import Held, with_signals
from lierb.kernels.stepping.lane_clock import (
    LaneClock,
    Span,
    Trial,
    Verdict,
    continued,
    fate_of,
    first_clock,
    judged,
    to_measure,
    to_tidy,
    trial_of,
)
from lierb.kernels.stepping.layout import LANE_END, Columns, Field
from lierb.kernels.stepping.measures import SUMMARY
from lierb.kernels.stepping.plan import AnyPlan
from lierb.kernels.stepping.signals import (
    controllers_of,
    events_of,
    lane_end,
    memory_of,
    memory_slices,
    output_slices,
    outputs_of,
    signals_width,
    states_of,
)
from lierb.kernels.stepping.state import State
from lierb.kernels.stepping.status import EVENT, MAX_STEPS, OK
from lierb.kernels.stepping.step_size import EPS, Tolerances, squared_error
from lierb.kernels.stepping.stepper import between, extended, trial_step
from lierb.kernels.stepping.systems import system_of

# Rows of a desk that loops over lanes read and write.
(
    TRAJECTORY,  # whose the lane is; −1 for nobody's
    NUMBER,  # of the trajectory, for noise
    MARK,  # 1 where something is to be done
    ACTIVE,  # 1 where a trajectory is on its way
    FRESH,  # 1 where one has just started, or a step has been accepted
    FATE,  # 0 where it goes on; where it has ended, its status and 1
    NEXT, DUE,  # row of the history, and when it is due, s
    START, LENGTH,  # of the step, s
    THETA,
    TOOK,  # 1 where the step has been accepted
    CURSOR,  # of the search for crossings: how many looks have been gone through
    WHICH,  # of the events
    LOW, HIGH, AT_LOW, AT_HIGH,  # of a crossing: θ and the event's value at both ends
    LAST,  # θ of the first terminal event in the step; 2 for none
    ROWS,
) = range(20)  # fmt: skip
LOOKS = 4  # at events in a step, where the method has a continuous extension
STARTS = SUMMARY.index("starts")  # which is known before
SEARCHES = 120  # at most; every third one halves
NEAR = 0.125  # of an event's range in a step: how near to zero it must come to be looked at there
# What the state between a step's ends is asked for: events' values, to look for crossings, first at
# equal distances, then where an event seems to come nearest to zero and to go back; and to find
# one; a crossing, to note it; the end of a trajectory; a row of its history.
LOOKING, DIPPING, SEARCHING, NOTING, ENDING, SHOWING = range(6)
EVENT_COLUMNS = 3  # trajectory, event, t


OWN_ARRAYS = ("desk", "save_at", "numbers", "events", "kinds")
_SIZES = (
    "first", "stop", "begin", "turns", "differ", "rows", "watched", "looks", "sides", "values",
    "signals", "own_summary",
)  # fmt: skip
LANE_JOB = np.dtype(
    (
        np.record,
        [
            *((name, np.int64, (4,)) for name in (*ARRAYS, *OWN_ARRAYS)),
            *((name, np.int64) for name in _SIZES),
            ("seed", np.float64),
            *get_type_hints(Span).items(),
            *get_type_hints(Tolerances).items(),
        ],
    )
)
"""As `lierb.kernels.stepping.driver.JOB`, of the batch or of a desk.

desk : [row][lane], of `desk_of`.   save_at : [1][row of the history], s.   numbers : [1][n].
events : of a desk, [place][EVENT_COLUMNS, state and signals]; place 0 has their count.
kinds : [direction, is terminal][event].
first, stop : trajectories.   turns : iterations in this call.   watched, looks : events, and how
often each is asked in a step.
sides, values, signals : rows of a desk.   own_summary : column of LANE_SUMMARY in a summary.
"""


def desk_of(plan: AnyPlan) -> Columns:
    """The rows of a desk: what loops over lanes need; of each event its side, its values at the
    looks of a step, the first of them at its start, those of a search, and θ and value of a dip;
    then what lanes carry.
    """
    events, signals = len(events_of(plan)), signals_width(plan)
    return Columns(
        Field("rows", (ROWS,)),
        Field("sides", (events,)),
        Field("values", (LOOKS + 1, events)),
        Field("searched", (events,)),
        Field("dips", (2, events)),
        Field("signals", (signals,)),
        Field("clock", (len(LaneClock._fields),)),
        Field("controls", (size_of(outputs_of(plan)),)),
        Field("memory", (size_of(memory_of(plan)),)),
        Field("ticks", (len(controllers_of(plan)),)),
    )


# ---- formulas on all lanes -----------------------------------------------------------------------


def any_of(numbers: Any) -> Any:
    """Whether some lane's number is above 0."""
    return any_lanes(numbers > 0.0)


def taken(mask: Any, new: Any, old: Any) -> Any:
    """`new` where the mask, 1 or 0, is 1."""
    return where(mask > 0.5, new, old)


def row_of(plan: AnyPlan, desk: Any, row: Any) -> Any:
    return load(desk, (row, 0), plan.lanes)


def put_row(plan: AnyPlan, desk: Any, row: Any, numbers: Any) -> None:
    store(desk, (row, 0), numbers, plan.lanes)


def _rows_of(plan: AnyPlan, desk: Any, name: str) -> tuple[Any, ...]:
    columns = desk_of(plan)[name]
    return tuple(row_of(plan, desk, row) for row in range(columns.start, columns.stop))


def _put_rows(plan: AnyPlan, desk: Any, name: str, numbers: Any) -> None:
    for row, number in enumerate(flatten(numbers), desk_of(plan)[name].start):
        put_row(plan, desk, row, number)


def load_lanes(plan: AnyPlan, desk: Any) -> tuple[LaneClock, Held]:
    """What lanes carry beside state and record."""
    held = Held(*(_rows_of(plan, desk, name) for name in Held._fields))
    return LaneClock(*_rows_of(plan, desk, "clock")), held


def store_lanes(plan: AnyPlan, desk: Any, clock: LaneClock, held: Held) -> None:
    """Until the next call."""
    _put_rows(plan, desk, "clock", clock)
    for name, numbers in held._asdict().items():
        _put_rows(plan, desk, name, numbers)


# ---- a trajectory's start ----


def own_start(plan: AnyPlan, body: Any, inputs: Any, desk: Any) -> State:
    """The state with the initial values of the user's own."""
    state, zero = initial_state(plan, body, inputs), 0.0 * row_of(plan, desk, NUMBER)
    own = system_of(plan).initial_states(body) if states_of(plan) else ()
    return state._replace(states=tuple(zero + x for x in own))


def started(
    plan: AnyPlan, body: Any, state: State, desk: Any, span: Span, limits: Tolerances
) -> tuple[Record, LaneClock, Held]:
    """Before the first tick."""
    due = row_of(plan, desk, DUE)
    zero = 0.0 * row_of(plan, desk, NUMBER)
    system, periods = system_of(plan), _periods(plan, body)
    held = Held(
        (zero,) * size_of(outputs_of(plan)),
        tuple(zero + x for x in system.initial_memory(body)) if periods else (),
        tuple(zero + _first_tick(span.start, every) for every in periods),
    )
    body = with_signals(plan, body, state, held)
    clock = first_clock(plan, body, state, span, limits, zero)._replace(due=due)
    return initial_record(plan, body, state), clock, held


def _periods(plan: AnyPlan, body: Any) -> Vec:
    return system_of(plan).periods(body) if controllers_of(plan) else ()


def _first_tick(start: Any, every: Any) -> Any:
    """The number of the first one that is not before the start."""
    count = plain(start) / every
    whole = rint(count)
    is_one = absolute(count - whole) <= 4.0 * EPS * absolute(count)
    return where(is_one, whole, floor(count) + 1.0)


def goes_on(
    plan: AnyPlan, clock: LaneClock, held: Held, limits: Tolerances, inputs: Any
) -> tuple[LaneClock, Held]:
    """What a run that goes on starts with, as the one before has left it."""
    at, known = system_of(plan).inputs["lane"], lane_end(plan)
    numbers = tuple(load(inputs, (c, 0), plan.lanes) for c in range(at.start, at.stop))
    found = known.parts(numbers)
    kept = (
        tuple(where(y == y, y, x) for x, y in zip(mine, found[name], strict=True))
        for name, mine in held._asdict().items()
    )
    return continued(plan, clock, limits, found), Held(*kept)


def store_lane_end(plan: AnyPlan, clock: LaneClock, held: Held, ends: Any) -> None:
    """Behind the state, for a run that goes on."""
    clock = clock._replace(ahead=clock.ahead + clock.steps)
    own = (getattr(clock, field.name) for field in LANE_END.fields)
    for row, number in enumerate((*own, *flatten(held)), len(state_columns(plan))):
        store(ends, (row, 0), number, plan.lanes)


# ---- an arrival at the end of a step, or at a start ----


def is_tick(plan: AnyPlan, body: Any, clock: LaneClock, held: Held, fresh: Any) -> Any:
    """Whether a controller is to run somewhere."""
    due = fresh < -1.0  # never
    for tick, every in zip(held.ticks, _periods(plan, body), strict=True):
        due = due | _ticks(clock, tick, every, fresh)
    return any_lanes(due)


def _ticks(clock: LaneClock, tick: Any, every: Any, fresh: Any) -> Any:
    return (fresh > 0.5) & (every * tick - clock.t <= 4.0 * EPS * absolute(clock.t))


def ticked(
    plan: AnyPlan,
    body: Any,
    state: State,
    clock: LaneClock,
    held: Held,
    fresh: Any,
    desk: Any,
    seed: Any,
) -> Held:
    """With what controllers set now; each sees what those before it have just set."""
    system, trajectory = system_of(plan), row_of(plan, desk, NUMBER)
    periods = _periods(plan, body)
    for number, every in enumerate(periods):
        tick = held.ticks[number]
        due = _ticks(clock, tick, every, fresh)
        at = with_signals(plan, body, state, held)
        seen = system.seen(at, state, clock.t)
        noise = Noise(seed, trajectory, tick)
        controls, memory = system.controlled(at, seen, clock.t, number, noise)
        held = Held(
            _set(held.controls, output_slices(plan)[number], controls, due),
            _set(held.memory, memory_slices(plan)[number], memory, due),
            _set(held.ticks, slice(number, number + 1), (tick + 1.0,), due),
        )
    return held


def _set(numbers: Vec, part: slice, new: Any, mask: Any) -> Vec:
    changed = tuple(where(mask, plain(x), old) for x, old in zip(new, numbers[part], strict=True))
    return numbers[: part.start] + changed + numbers[part.stop :]


def fate_now(
    clock: LaneClock, span: Span, limits: Tolerances, record: Record, fresh: Any, fate: Any
) -> Any:
    return fate_of(clock, span, limits, record.status, fresh, fate)


def looks_now(plan: AnyPlan, clock: LaneClock, span: Span, fresh: Any, fate: Any) -> Any:
    """Whether something is measured somewhere, or a row of a history is due."""
    now = to_measure(clock, span, fresh, fate)
    return any_lanes(now | _is_due(clock, fresh))


def _is_due(clock: LaneClock, fresh: Any) -> Any:
    return (fresh > 0.5) & (clock.due <= clock.t)


class Look(NamedTuple):
    """shown : of the history.   record, clock : with what is measured now."""

    shown: tuple[Any, ...]
    record: Record
    clock: LaneClock


def looked(
    plan: AnyPlan,
    body: Any,
    state: State,
    held: Held,
    record: Record,
    clock: LaneClock,
    span: Span,
    fresh: Any,
    fate: Any,
) -> Look:
    now = to_measure(clock, span, fresh, fate)
    half = 0.5 * (clock.t - clock.seen)
    shown, seen = observe(plan, body, state, record, clock.steps, clock.t, half, by_halves=True)
    record = where(now, seen, without_measures(plan, record, seen))
    clock = clock._replace(seen=where(now, clock.t, clock.seen))
    return Look((*shown, *state.states, *held.controls), record, clock)


def mark_due(plan: AnyPlan, desk: Any, clock: LaneClock, fresh: Any) -> Any:
    """MARK says where a row of the history is due; whether it is anywhere."""
    if not plan.looks:
        return all_lanes(clock.t < clock.t)  # never
    due = _is_due(clock, fresh)
    put_row(plan, desk, MARK, where(due, 1.0, 0.0 * clock.t))
    return any_lanes(due)


def with_due(plan: AnyPlan, desk: Any, clock: LaneClock) -> LaneClock:
    """After rows have been handed over: when the next ones are due."""
    return clock._replace(due=row_of(plan, desk, DUE))


def store_lane_summary(
    plan: AnyPlan, state: State, held: Held, clock: LaneClock, record: Record, summary: Any,
    column: Any,
) -> None:  # fmt: skip
    """What LANE_SUMMARY has, the user's states and controls, from a column on."""
    numbers = (clock.t, clock.steps, clock.rejected, clock.h)
    alive = record.status == OK
    signals = (where(alive, x, NAN) for x in (*state.states, *held.controls))
    for i, number in enumerate((*numbers, *signals)):
        store(summary, (column + i, 0), number, plan.lanes)


def as_ended(record: Record, clock: LaneClock, span: Span, fate: Any) -> Record:
    """The record of what has ended, with the status that its fate is, and its means by the time
    that it has lasted.
    """
    lasted = clock.t - span.start
    lasted = where(lasted > 0.0, lasted, 1.0)
    seen = (each._replace(total=each.total / lasted) for each in record.observed)
    soft = where(fate > 0.5, fate - 1.0, 0.0)
    status = where(record.status > 0.5, record.status, soft)
    return record._replace(observed=tuple(seen), status=status)


# ---- a step ----


def next_trial(
    plan: AnyPlan, body: Any, clock: LaneClock, held: Held, span: Span, active: Any
) -> Trial:
    stop = span.end + 0.0 * clock.t
    for every, tick in zip(_periods(plan, body), held.ticks, strict=True):
        stop = minimum(stop, every * tick)
    return trial_of(plan, clock, stop, active)


class Made(NamedTuple):
    """Of a trial: the state, the slopes of its stages where somebody looks between, the mark of a
    singular configuration, and the square of the error.
    """

    state: State
    slopes: Any
    singular: Any
    square: Any


def attempted(
    plan: AnyPlan, body: Any, state: State, record: Record, trial: Trial, limits: Tolerances
) -> Made:
    body = body._replace(dropped=record.dropped)
    is_continuous = plan.looks and plan.extension is not None
    all_stages = is_continuous or plan.embedded is not None
    made = trial_step(plan, body, state, trial.start, trial.h, all_stages)
    square: Any = ZERO
    if plan.embedded is not None:
        square = squared_error(plan, body, state, made.state, made.slopes, trial.h, limits)
    return Made(made.state, made.slopes if is_continuous else (), made.singular, square)


def verdict_on(
    plan: AnyPlan, made: Made, clock: LaneClock, trial: Trial, limits: Tolerances, active: Any
) -> Verdict:
    state = made.state
    turns, places = system_of(plan).told_by(state.chart)
    numbers = (*turns, *state.v_or_mu, *state.x, *places, state.work, *state.states)
    fine = are_finite(*numbers)
    return judged(plan, clock, trial, fine, made.singular, made.square, limits, active)


def with_failures(record: Record, clock: LaneClock, failed: Any, fate: Any) -> tuple[Record, Any]:
    """The record with the status of what has failed; and the fate of what ends though its state is
    fine, as a step would have to be too small.
    """
    hard = (failed > 0.5) & (failed < float(MAX_STEPS)) & (record.status == OK)
    record = record._replace(
        status=where(hard, failed, record.status),
        failed_step=where(hard, clock.steps, record.failed_step),
    )
    return record, where(failed >= float(MAX_STEPS), failed + 1.0, fate)


def is_to_tidy(clock: LaneClock, span: Span, fresh: Any, fate: Any) -> Any:
    return any_lanes(to_tidy(clock, fresh, fate))


def tidied(
    plan: AnyPlan, body: Any, state: State, clock: LaneClock, span: Span, fresh: Any, fate: Any
) -> State:
    return where(to_tidy(clock, fresh, fate), tidy(plan, body, state), state)


# ---- between the ends of a step ----


def is_due_between(plan: AnyPlan, clock: LaneClock, accepted: Any) -> Any:
    """Whether a row of some history is due before the end of an accepted step.

    clock : at that end.
    """
    if not plan.looks:
        return all_lanes(clock.t < clock.t)  # never
    return any_lanes((accepted > 0.5) & (clock.due < clock.t))


def slopes_between(plan: AnyPlan, body: Any, state: State, made: Made, trial: Trial) -> Any:
    """What `state_between` is made of."""
    if not plan.looks or plan.extension is None:
        return ()
    return extended(plan, body, state, trial.start, trial.h, made.slopes)


def state_between(
    plan: AnyPlan, body: Any, state: State, slopes: Any, trial: Trial, theta: Any
) -> State:
    if not plan.looks:
        return state  # never
    return between(plan, body, state, trial.start, trial.h, slopes, theta)


def time_between(trial: Trial, theta: Any) -> Any:
    return trial.start + theta * trial.h


def mark_due_between(
    plan: AnyPlan, desk: Any, clock: LaneClock, trial: Trial, accepted: Any
) -> None:
    """MARK and THETA say where a row of the history is due, and when."""
    due = (accepted > 0.5) & (clock.due < clock.t)
    length = where(trial.h > 0.0, trial.h, 1.0)
    put_row(plan, desk, MARK, where(due, 1.0, 0.0 * clock.t))
    put_row(plan, desk, THETA, where(due, (clock.due - trial.start) / length, 0.0))


def shown_between(
    plan: AnyPlan, body: Any, state: State, held: Held, record: Record, clock: LaneClock
) -> tuple[tuple[Any, ...], Record]:
    """A row of the history, at the time that it is due."""
    shown, seen = observe(plan, body, state, record, clock.steps, clock.due)
    return (*shown, *state.states, *held.controls), without_measures(plan, record, seen)


def put_values(
    plan: AnyPlan, body: Any, state: State, held: Held, time: Any, desk: Any, first: Any
) -> None:
    """Of all events, from a row on."""
    if events_of(plan):
        system, body = system_of(plan), with_signals(plan, body, state, held)
        for i, value in enumerate(system.events(body, system.seen(body, state, time), time)):
            put_row(plan, desk, first + i, value)


def put_signals(plan: AnyPlan, state: State, held: Held, desk: Any) -> None:
    _put_rows(plan, desk, "signals", (state.states, held.controls))


def put_trial(plan: AnyPlan, desk: Any, trial: Trial, accepted: Any) -> None:
    put_row(plan, desk, TOOK, accepted)
    put_row(plan, desk, START, trial.start)
    put_row(plan, desk, LENGTH, trial.h)


class Ending(NamedTuple):
    """Of a step in which something terminal happens: state and clock there, and the fate."""

    state: State
    clock: LaneClock
    fate: Any


def ended_between(
    plan: AnyPlan, desk: Any, there: State, made: Made, trial: Trial, clock: LaneClock, fate: Any
) -> Ending:
    """there : the states at θ = LAST."""
    last = row_of(plan, desk, LAST)
    ends = last <= 1.0
    state = where(ends, there, made.state)
    t = where(ends, time_between(trial, last), clock.t)
    return Ending(state, clock._replace(t=t), where(ends, float(EVENT + 1), fate))


for _formula in (
    any_of, taken, row_of, put_row, load_lanes, store_lanes, own_start, started, is_tick,
    ticked, fate_now, looks_now, looked, mark_due, with_due, store_lane_summary, as_ended,
    next_trial, attempted, verdict_on, with_failures, is_to_tidy, tidied, is_due_between,
    slopes_between, state_between, time_between, mark_due_between, shown_between, put_values,
    put_signals, put_trial, ended_between, with_signals, goes_on, store_lane_end,
):  # fmt: skip
    kernel(_formula)


# ---- loops over lanes ----------------------------------------------------------------------------


@shared
def hand_over_row(desk, own, job, lanes):
    """A row of the history, where MARK says, from the desk to its place; the next one is due."""
    history, shown = histories_at(job.history), histories_at(own.history)
    multipliers, own_multipliers = histories_at(job.multipliers), histories_at(own.multipliers)
    reactions, own_reactions = histories_at(job.reactions), histories_at(own.reactions)
    save_at = numbers_at(job.save_at)
    rows = save_at.shape[1]
    for lane in range(lanes):
        if desk[MARK, lane] == 0.0:
            continue
        column, row = int(desk[TRAJECTORY, lane]), int(desk[NEXT, lane])
        for c in range(shown.shape[0]):
            history[c, row, column] = shown[c, 0, lane]
        if own_multipliers.shape[0] > 0:
            for c in range(own_multipliers.shape[2]):
                multipliers[row, column, c] = own_multipliers[0, lane, c]
        for joint in range(own_reactions.shape[0]):
            for c in range(6):
                reactions[joint * rows + row, column, c] = own_reactions[joint, lane, c]
        if job.rows > 1:
            hand_over_state(own, job, lane, column, row)
        desk[NEXT, lane] = row + 1
        desk[DUE, lane] = save_at[0, row + 1] if row + 1 < rows else np.inf


@shared
def hand_over_state(own, job, lane, column, row):
    """Of all links."""
    copy_links(histories_at(own.rotation), histories_at(job.rotation), lane, column, row, job.rows)
    copy_links(histories_at(own.position), histories_at(job.position), lane, column, row, job.rows)
    copy_links(histories_at(own.omega), histories_at(job.omega), lane, column, row, job.rows)
    copy_links(histories_at(own.v), histories_at(job.v), lane, column, row, job.rows)


@shared
def copy_links(shown, array, lane, column, row, rows):
    for link in range(shown.shape[0]):
        for c in range(shown.shape[2]):
            array[link * rows + row, column, c] = shown[link, lane, c]


@shared
def hand_over_ends(desk, own, job, lanes):
    """What trajectories that have ended come to."""
    summary, own_summary = numbers_at(job.summary), numbers_at(own.summary)
    ends, own_ends = numbers_at(job.ends), numbers_at(own.ends)
    for lane in range(lanes):
        if desk[FATE, lane] > 0.0:
            column = int(desk[TRAJECTORY, lane])
            for c in range(own_summary.shape[0]):
                if c != STARTS:
                    summary[c, column] = own_summary[c, lane]
            for c in range(own_ends.shape[0]):
                ends[c, column] = own_ends[c, lane]
            hand_over_state(own, job, lane, column, job.rows - 1)


@shared
def take_next(desk, job, inputs, counter, lanes, is_new):
    """Lanes whose trajectory has ended take the next ones; MARK says which have one. Whether there
    is any on its way.
    """
    places, varying = integers_at(job.places), integers_at(job.varying)
    save_at, numbers = numbers_at(job.save_at), numbers_at(job.numbers)
    going = False
    for lane in range(lanes):
        desk[MARK, lane] = 0.0
        if desk[FATE, lane] > 0.0:
            desk[FATE, lane] = 0.0
            taken = take_turn(counter)
            is_one = taken < job.stop
            desk[MARK, lane] = 1.0 if is_one else 0.0
            desk[ACTIVE, lane] = desk[MARK, lane]
            if is_one or is_new:
                trajectory = min(taken, job.stop - 1)  # a lane without one has harmless numbers
                for i in range(inputs.shape[0] if is_new else varying.shape[1]):
                    c = i if is_new else varying[0, i]
                    inputs[c, lane] = number_at(places[c, 0] + places[c, 1] * trajectory)
                desk[TRAJECTORY, lane] = trajectory
                desk[NUMBER, lane] = numbers[0, trajectory]
                desk[NEXT, lane] = 0.0
                desk[DUE, lane] = save_at[0, 0] if save_at.shape[1] > 0 else np.inf
        going = going or desk[ACTIVE, lane] > 0.0
    return going


# ---- events ----


@shared
def side_of(value):
    return 1.0 if value > 0.0 else -1.0 if value < 0.0 else 0.0


@shared
def note_starts(desk, own, lanes):
    """Of trajectories that have just started: on which side of zero each event is; 0 on it."""
    for lane in range(lanes):
        if desk[MARK, lane] > 0.0:
            for event in range(own.watched):
                value = desk[own.values + own.watched * own.looks + event, lane]
                desk[own.sides + event, lane] = side_of(value)
                desk[own.values + event, lane] = value


@shared
def begin_looks(desk, own, lanes):
    """Before crossings are looked for in an accepted step; the first thing to be done for it."""
    for lane in range(lanes):
        desk[CURSOR, lane] = 0.0
        desk[LAST, lane] = 2.0
    return LOOKING if own.watched > 0 else SHOWING


@shared
def next_task(desk, own, kinds, events, first, task, turn, lanes):
    """What is to be done next at a state between, and THETA, where that is; and the task's turn.

    first : place of the first event that is noted in this step.
    """
    if task == LOOKING:
        if turn + 1 < own.looks:
            for lane in range(lanes):
                desk[THETA, lane] = (turn + 1) / own.looks
            return LOOKING, turn + 1
        find_dips(desk, own, lanes)
        task, turn = DIPPING, -1
    if task == DIPPING:
        turn = next_dip(desk, own, turn + 1, lanes)
        if turn < own.watched:
            return DIPPING, turn
        task = NOTING  # of nothing so far
    elif task == SEARCHING:
        if turn + 1 < SEARCHES and next_thetas(desk, lanes, turn + 1):
            return SEARCHING, turn + 1
        for lane in range(lanes):
            desk[THETA, lane] = desk[HIGH, lane] if desk[MARK, lane] > 0.0 else 0.0
        return NOTING, 0
    if task == NOTING:
        if next_crossings(desk, own, kinds, lanes):
            next_thetas(desk, lanes, 0)
            return SEARCHING, 0
        end_search(desk, own, lanes)
        if drop_later(desk, events, first, lanes):
            for lane in range(lanes):
                desk[THETA, lane] = desk[LAST, lane] if desk[LAST, lane] <= 1.0 else 0.0
            return ENDING, 0
    return SHOWING, 0


@shared
def find_dips(desk, own, lanes):
    """Of each event the θ at which it seems to come nearest to zero and to go back, between two
    looks of one sign: the least of the cubic by values and slopes there, which are those of the
    quartic through all looks. 2 where there is none.
    """
    count = own.watched
    dips = own.values + (LOOKS + 2) * count
    for lane in range(lanes):
        for event in range(count):
            desk[dips + event, lane] = 2.0
            if own.looks == LOOKS and desk[TOOK, lane] > 0.0:
                desk[dips + event, lane] = dip_of(desk, own.values + event, count, lane)


@shared
def dip_of(desk, first, every, lane):
    a, b, c = desk[first, lane], desk[first + every, lane], desk[first + 2 * every, lane]
    d, e = desk[first + 3 * every, lane], desk[first + 4 * every, lane]
    values = (a, b, c, d, e)
    slopes = (  # of the quartic, by θ / 4
        (-25.0 * a + 48.0 * b - 36.0 * c + 16.0 * d - 3.0 * e) / 12.0,
        (-3.0 * a - 10.0 * b + 18.0 * c - 6.0 * d + e) / 12.0,
        (a - 8.0 * b + 8.0 * d - e) / 12.0,
        (3.0 * e + 10.0 * d - 18.0 * c + 6.0 * b - a) / 12.0,
        (25.0 * e - 48.0 * d + 36.0 * c - 16.0 * b + 3.0 * a) / 12.0,
    )
    found, nearest = 2.0, NEAR * (max(values) - min(values))
    for look in range(LOOKS):
        side = side_of(values[look])
        low, high = side * values[look], side * values[look + 1]
        falls, rises = side * slopes[look], side * slopes[look + 1]
        if high > 0.0 and falls < 0.0 and rises > 0.0:
            bend = 3.0 * (low - high) + falls + rises
            root = np.sqrt(bend * bend - falls * rises)
            share = 1.0 - (rises + root - bend) / (rises - falls + 2.0 * root)
            least = low + share * (falls + share * (share * (falls + rises + 2.0 * (low - high))
                    + 3.0 * (high - low) - 2.0 * falls - rises))  # fmt: skip
            if least < nearest and 0.0 < share < 1.0:
                found, nearest = (look + share) / LOOKS, least
    return found


@shared
def next_dip(desk, own, event, lanes):
    """The next event, from this one on, that dips somewhere, and THETA; the count of events if none
    does.
    """
    dips = own.values + (LOOKS + 2) * own.watched
    while event < own.watched:
        found = False
        for lane in range(lanes):
            theta = desk[dips + event, lane]
            desk[THETA, lane] = theta if theta < 1.0 else 0.0
            found = found or theta < 1.0
        if found:
            break
        event += 1
    return event


@shared
def note_dip(desk, own, event, lanes):
    """Of this event, its value at THETA."""
    searched = own.values + (LOOKS + 1) * own.watched
    dips = searched + own.watched
    for lane in range(lanes):
        desk[dips + own.watched + event, lane] = desk[searched + event, lane]


@shared
def next_crossings(desk, own, kinds, lanes):
    """The next crossing in each lane, as MARK, WHICH, LOW, HIGH, AT_LOW and AT_HIGH; whether there
    is any. Zero is crossed where it is reached from either side: a value of exactly zero counts,
    and from there on neither side is the one that was left.
    """
    found, looks, count = False, own.looks, own.watched
    dips = own.values + (LOOKS + 2) * count
    for lane in range(lanes):
        desk[MARK, lane] = 0.0
        if desk[TOOK, lane] == 0.0:
            continue
        cursor = int(desk[CURSOR, lane])
        while cursor < 2 * looks * count and desk[MARK, lane] == 0.0:
            # From one look to the next; or to a dip between them, and from there on.
            half, look, event = cursor % 2, cursor // 2 // count + 1, cursor // 2 % count
            cursor += 1
            low, high = (look - 1) / looks, look / looks
            before = desk[own.values + (look - 1) * count + event, lane]
            value = desk[own.values + look * count + event, lane]
            dip, at_dip = desk[dips + event, lane], desk[dips + count + event, lane]
            if low < dip < high:
                if half == 0:
                    high, value = dip, at_dip
                else:
                    low, before = dip, at_dip
            elif half == 0:
                continue
            side = desk[own.sides + event, lane]
            if side * value < 0.0 or (side != 0.0 and value == 0.0):
                direction = kinds[0, event]
                if direction == 0.0 or direction == -side:
                    found = True
                    desk[MARK, lane] = 1.0
                    desk[WHICH, lane] = event
                    desk[LOW, lane], desk[HIGH, lane] = low, high
                    # What is held may have made it jump.
                    desk[AT_LOW, lane] = before if side * before > 0.0 else 0.0
                    desk[AT_HIGH, lane] = value
                desk[own.sides + event, lane] = side_of(value)
            elif side == 0.0:
                desk[own.sides + event, lane] = side_of(value)
        desk[CURSOR, lane] = cursor
    return found


@shared
def next_thetas(desk, lanes, search):
    """Where the crossings are looked for next, between both ends: by the secant, each end's value
    halved once it has stayed twice (Illinois), and by halves every third time. Whether any is.
    """
    busy = False
    for lane in range(lanes):
        low, high = desk[LOW, lane], desk[HIGH, lane]
        desk[THETA, lane] = high if desk[MARK, lane] > 0.0 else 0.0
        if desk[MARK, lane] == 0.0:
            continue
        length, at = desk[LENGTH, lane], abs(desk[START, lane]) + desk[LENGTH, lane]
        least = max(4.0 * EPS, 2.0 * EPS * at / length if length > 0.0 else 1.0)
        if high - low <= least:
            continue
        busy = True
        theta, slope = 0.5 * (low + high), desk[AT_HIGH, lane] - desk[AT_LOW, lane]
        if search % 3 != 2 and slope != 0.0:
            secant = high - desk[AT_HIGH, lane] * (high - low) / slope
            if low < secant < high:
                theta = min(max(secant, low + 0.5 * least), high - 0.5 * least)
        desk[THETA, lane] = theta
    return busy


@shared
def narrow(desk, own, lanes):
    """With the events' values at THETA."""
    searched = own.values + (LOOKS + 1) * own.watched
    for lane in range(lanes):
        theta = desk[THETA, lane]
        if desk[MARK, lane] == 0.0 or theta >= desk[HIGH, lane] or theta <= desk[LOW, lane]:
            continue
        value = desk[searched + int(desk[WHICH, lane]), lane]
        before, after = desk[AT_LOW, lane], desk[AT_HIGH, lane]
        is_after = value * after > 0.0 or value == 0.0 if after != 0.0 else value * before <= 0.0
        if is_after:
            desk[HIGH, lane], desk[AT_HIGH, lane] = theta, value
            desk[AT_LOW, lane] = 0.5 * before
        else:
            desk[LOW, lane], desk[AT_LOW, lane] = theta, value
            desk[AT_HIGH, lane] = 0.5 * after


@shared
def note_events(desk, own, events, kinds, lanes):
    """One row for each crossing that has been found, with the state there, which is on the desk."""
    rotation, position = histories_at(own.rotation), histories_at(own.position)
    omega, v = histories_at(own.omega), histories_at(own.v)
    for lane in range(lanes):
        if desk[MARK, lane] == 0.0:
            continue
        place, event, theta = int(events[0, 0]) + 1, int(desk[WHICH, lane]), desk[HIGH, lane]
        events[0, 0] = place
        events[place, 0], events[place, 1] = desk[TRAJECTORY, lane], event
        events[place, 2] = desk[START, lane] + theta * desk[LENGTH, lane]
        column = EVENT_COLUMNS
        for link in range(rotation.shape[0]):
            for part in (rotation, position, omega, v):
                for c in range(part.shape[2]):
                    events[place, column] = part[link, lane, c]
                    column += 1
        for row in range(own.signals, own.signals + events.shape[1] - column):
            events[place, column] = desk[row, lane]
            column += 1
        if kinds[1, event] > 0.0:
            desk[LAST, lane] = min(desk[LAST, lane], theta)


@shared
def drop_later(desk, events, first, lanes):
    """Have nothing known of events of this step, from place `first` on, that come after their
    trajectory's end. Whether any ends.
    """
    ends = False
    for lane in range(lanes):
        if desk[LAST, lane] <= 1.0:
            ends = True
            last = desk[START, lane] + desk[LAST, lane] * desk[LENGTH, lane]
            for place in range(first, int(events[0, 0]) + 1):
                if events[place, 0] == desk[TRAJECTORY, lane] and events[place, 2] > last:
                    events[place, 0] = -1.0
    return ends


@shared
def end_search(desk, own, lanes):
    """The values at the end of an accepted step are those at the start of the next."""
    for lane in range(lanes):
        if desk[TOOK, lane] > 0.0:
            for event in range(own.watched):
                last = desk[own.values + own.looks * own.watched + event, lane]
                desk[own.values + event, lane] = last


# ---- the loops over steps and over trajectories --------------------------------------------------


@numba.njit(**OPTIONS, inline="always")  # compiled with its caller alone
def _store_row(plan, body, inputs, state, record, shown, own, rows, time):
    """A row of the history on the desk.   rows : of the states, in the results."""
    store_measures(plan, record, shown, histories_at(own.history), 0, 0)
    multipliers, reactions = histories_at(own.multipliers), histories_at(own.reactions)
    store_forces(plan, body, state, record, multipliers, reactions, 0, 1, 0, time)
    if rows > 1:
        _store_state(plan, body, inputs, state, record, own)


@numba.njit(**OPTIONS, inline="always")
def _store_state(plan, body, inputs, state, record, own):
    states = (
        histories_at(own.rotation),
        histories_at(own.position),
        histories_at(own.omega),
        histories_at(own.v),
    )
    store_state(plan, body, inputs, state, record, states, 0, 1, 0)


@numba.njit(**OPTIONS, inline="always")
def _store_ends(plan, body, inputs, state, record, clock, held, fate, span, own):
    """Of all lanes, those included that go on."""
    record = heard(plan, record, clock.steps)
    _store_state(plan, body, inputs, state, record, own)
    summary = numbers_at(own.summary)
    store_lane_summary(plan, state, held, clock, record, summary, own.own_summary)
    store_summary(plan, as_ended(record, clock, span, fate), summary, 0)
    store_end(plan, state, numbers_at(own.ends), 0)
    store_lane_end(plan, clock, held, numbers_at(own.ends))


@numba.njit(**OPTIONS, inline="always")
def _look_at_starts(plan, inputs, counter, job):
    """Whether trajectories start on their joints, block by block."""
    is_new, lanes = True, inputs.shape[1]
    summary = numbers_at(job.summary)
    while True:
        first = take_turn(counter) * lanes
        if first >= job.stop:
            break
        pack(job, inputs, first, is_new)
        store_start(plan, inputs, summary, first, job.start)
        is_new = False


@cached()
def integrate_lanes(plan, inputs, counter, jobs):
    """Steps in all lanes of a thread, until none has a trajectory, or a call's turns are over.

    inputs : where the thread brings the lanes' numbers together.
    counter : [trajectories taken, what has ended a thread].   jobs : of the batch, of the desk.
    """
    job, own = jobs[0], jobs[1]
    if job.begin == UNSEEN:
        _look_at_starts(plan, inputs, counter, job)
        return
    lanes, turns, desk = inputs.shape[1], job.turns, numbers_at(own.desk)
    span = Span(job.start, job.end, job.origin, job.counted, job.every)
    limits = Tolerances(
        job.dt, job.rtol, job.rotation_atol, job.position_atol, job.omega_atol, job.v_atol,
        job.states_atol, job.dt_min, job.dt_max, job.max_steps,
    )  # fmt: skip
    carried, events, kinds = numbers_at(own.carried), numbers_at(own.events), numbers_at(job.kinds)
    room = events.shape[0] - lanes * own.watched * (own.looks + 1) - 1
    is_new = own.begin == 0
    body = load_body(plan, inputs)
    state, record = load_state(plan, body, carried, 0), load_record(plan, carried, 0)
    clock, held = load_lanes(plan, desk)
    active, fresh = row_of(plan, desk, ACTIVE), row_of(plan, desk, FRESH)
    fate = row_of(plan, desk, FATE)
    while True:
        if any_of(fate):
            if not is_new:
                put_row(plan, desk, FATE, fate)
                _store_ends(plan, body, inputs, state, record, clock, held, fate, span, own)
                hand_over_ends(desk, own, job, lanes)
            going = take_next(desk, job, inputs, counter, lanes, is_new)
            active, fresh = row_of(plan, desk, ACTIVE), row_of(plan, desk, MARK)
            fate = row_of(plan, desk, FATE)
            if not going:
                break
            if is_new or job.differ:
                body = load_body(plan, inputs)
            if job.begin == RESUMED:
                state = taken(fresh, resumed_state(plan, body, inputs), state)
            else:
                state = taken(fresh, own_start(plan, body, inputs, desk), state)
            begun = started(plan, body, state, desk, span, limits)
            record, first = taken(fresh, begun[0], record), (begun[1], begun[2])
            if job.begin == RESUMED:
                first = goes_on(plan, begun[1], begun[2], limits, inputs)
            clock, held = taken(fresh, first[0], clock), taken(fresh, first[1], held)
            is_new = False
            if own.watched > 0:
                at_end = own.values + own.looks * own.watched
                put_values(plan, body, state, held, clock.t, desk, at_end)
                note_starts(desk, own, lanes)
        else:
            if turns == 0 or events[0, 0] > room:
                break
            turns -= 1
            trial = next_trial(plan, body, clock, held, span, active)
            seen = with_signals(plan, body, state, held)
            made = attempted(plan, seen, state, record, trial, limits)
            accepted, failed, clock = verdict_on(plan, made, clock, trial, limits, active)
            record, fate = with_failures(record, clock, failed, fate)
            moved = made.state
            if own.watched > 0 or is_due_between(plan, clock, accepted):
                put_trial(plan, desk, trial, accepted)
                if own.watched > 0:
                    at_end = own.values + own.looks * own.watched
                    put_values(plan, seen, moved, held, trial.end, desk, at_end)
                slopes = slopes_between(plan, seen, state, made, trial)
                first, turn = int(events[0, 0]) + 1, 0
                task = begin_looks(desk, own, lanes)
                while True:
                    task, turn = next_task(desk, own, kinds, events, first, task, turn, lanes)
                    if task == SHOWING:
                        if not is_due_between(plan, clock, accepted):
                            break
                        mark_due_between(plan, desk, clock, trial, accepted)
                    theta = row_of(plan, desk, THETA)
                    there = state_between(plan, seen, state, slopes, trial, theta)
                    if task == LOOKING or task == DIPPING or task == SEARCHING:
                        # Of a look its own; of what is searched those behind all looks.
                        look = turn if task == LOOKING else LOOKS + 1
                        row, time = own.values + look * own.watched, time_between(trial, theta)
                        put_values(plan, seen, there, held, time, desk, row)
                        if task == SEARCHING:
                            narrow(desk, own, lanes)
                        elif task == DIPPING:
                            note_dip(desk, own, turn, lanes)
                    elif task == NOTING:
                        _store_state(plan, body, inputs, there, record, own)
                        put_signals(plan, there, held, desk)
                        note_events(desk, own, events, kinds, lanes)
                    elif task == ENDING:
                        moved, clock, fate = ended_between(
                            plan, desk, there, made, trial, clock, fate
                        )
                    else:
                        at = with_signals(plan, body, there, held)
                        shown, record = shown_between(plan, at, there, held, record, clock)
                        due = clock.due
                        _store_row(plan, at, inputs, there, record, shown, own, job.rows, due)
                        hand_over_row(desk, own, job, lanes)
                        clock = with_due(plan, desk, clock)
            state = taken(accepted, moved, state)
            fresh = taken(failed, failed, accepted)
        if is_tick(plan, body, clock, held, fresh):
            held = ticked(plan, body, state, clock, held, fresh, desk, job.seed)
        fate = fate_now(clock, span, limits, record, fresh, fate)
        if looks_now(plan, clock, span, fresh, fate):
            seen = with_signals(plan, body, state, held)
            shown, record, clock = looked(plan, seen, state, held, record, clock, span, fresh, fate)
            fate = fate_now(clock, span, limits, record, fresh, fate)
            if mark_due(plan, desk, clock, fresh):
                _store_row(plan, seen, inputs, state, record, shown, own, job.rows, clock.t)
                hand_over_row(desk, own, job, lanes)
                clock = with_due(plan, desk, clock)
        if is_to_tidy(clock, span, fresh, fate):
            state = tidied(plan, body, state, clock, span, fresh, fate)
    store_carried(plan, carried, 0, state, record)
    store_lanes(plan, desk, clock, held)
    put_row(plan, desk, FATE, fate)
    put_row(plan, desk, ACTIVE, active)


@cached(parallel=True)
def integrate_lanes_on_threads(integrate, counter, threads, jobs):
    """Each thread's lanes by `integrate`, an entry of integrate_lanes.

    jobs : [thread][of the batch, of its desk].
    """
    for thread in prange(threads):
        inputs = histories_at(jobs[thread, 0].inputs)[thread]
        raised = call(integrate, inputs, counter, jobs[thread])
        if raised != 0:
            counter[1] = raised
    raise_again(counter[1])
