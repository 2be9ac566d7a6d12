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

from typing import Any, NamedTuple

import numba
from numba import prange

from lierb.compiler.code import OPTIONS, cached
from lierb.compiler.entries import call, raise_again, take_turn
from lierb.compiler.loops import histories_at, numbers_at
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
from lierb.kernels.stepping.crossings import (
    BEGINNING,
    DIPPING,
    ENDING,
    GOING_ON,
    LOOKING,
    NARROWING,
    NOTING,
    NOTING_DIP,
    NOTING_EVENTS,
    SEARCHING,
    SHOWING,
    STARTING,
)
from lierb.kernels.stepping.desk import (
    ACTIVE,
    ANSWER,
    ASKED,
    DUE,
    FATE,
    FRESH,
    HANDING_ENDS,
    HANDING_ROW,
    IS_NEW,
    LAST,
    LENGTH,
    LOOKS,
    MARK,
    NUMBER,
    START,
    TAKING,
    TASK,
    THETA,
    TOOK,
    TURN,
    desk_of,
)
from lierb.kernels.stepping.driver import (
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
from lierb.kernels.stepping.layout import LANE_END
from lierb.kernels.stepping.plan import AnyPlan
from lierb.kernels.stepping.signals import (
    controllers_of,
    events_of,
    lane_end,
    memory_slices,
    output_slices,
    outputs_of,
    states_of,
)
from lierb.kernels.stepping.state import State
from lierb.kernels.stepping.status import EVENT, MAX_STEPS, OK
from lierb.kernels.stepping.step_size import EPS, Tolerances, squared_error
from lierb.kernels.stepping.stepper import between, extended, trial_step
from lierb.kernels.stepping.systems import system_of

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
    carried, events, told = numbers_at(own.carried), numbers_at(own.events), numbers_at(own.told)
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
                told[0, ASKED] = HANDING_ENDS
                call(job.serve, inputs, counter, jobs)
            told[0, ASKED], told[0, IS_NEW] = TAKING, 1.0 if is_new else 0.0
            call(job.serve, inputs, counter, jobs)
            active, fresh = row_of(plan, desk, ACTIVE), row_of(plan, desk, MARK)
            fate = row_of(plan, desk, FATE)
            if told[0, ANSWER] == 0.0:
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
                told[0, ASKED] = STARTING
                call(job.watch, inputs, counter, jobs)
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
                slopes = slopes_between(plan, seen, state, made, trial)
                task, turn = SHOWING, 0
                if own.watched > 0:
                    at_end = own.values + own.looks * own.watched
                    put_values(plan, seen, moved, held, trial.end, desk, at_end)
                    told[0, ASKED], task = BEGINNING, LOOKING
                    call(job.watch, inputs, counter, jobs)
                while True:
                    if task != SHOWING:
                        told[0, ASKED] = GOING_ON
                        call(job.watch, inputs, counter, jobs)
                        task, turn = int(told[0, TASK]), int(told[0, TURN])
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
                        if task != LOOKING:
                            told[0, ASKED] = NARROWING if task == SEARCHING else NOTING_DIP
                            call(job.watch, inputs, counter, jobs)
                    elif task == NOTING:
                        _store_state(plan, body, inputs, there, record, own)
                        put_signals(plan, there, held, desk)
                        told[0, ASKED] = NOTING_EVENTS
                        call(job.watch, inputs, counter, jobs)
                    elif task == ENDING:
                        moved, clock, fate = ended_between(
                            plan, desk, there, made, trial, clock, fate
                        )
                    else:
                        at = with_signals(plan, body, there, held)
                        shown, record = shown_between(plan, at, there, held, record, clock)
                        due = clock.due
                        _store_row(plan, at, inputs, there, record, shown, own, job.rows, due)
                        told[0, ASKED] = HANDING_ROW
                        call(job.serve, inputs, counter, jobs)
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
                told[0, ASKED] = HANDING_ROW
                call(job.serve, inputs, counter, jobs)
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
