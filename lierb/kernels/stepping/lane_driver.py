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

from lierb.compiler import calls
from lierb.compiler.code import OPTIONS, cached
from lierb.compiler.entries import call, raise_again, take_turn
from lierb.compiler.loops import histories_at, integers_at, number_at, numbers_at, shared
from lierb.compiler.trace import kernel
from lierb.kernels.numbers.arithmetic import any_lanes, flatten, load, store, where
from lierb.kernels.numbers.vec import Vec
from lierb.kernels.stepping.driver import (
    ARRAYS,
    JOB,
    RESUMED,
    UNSEEN,
    Record,
    _are_finite,
    initial_record,
    initial_state,
    load_body,
    load_record,
    load_state,
    observe,
    resumed_state,
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
from lierb.kernels.stepping.lane_clock import (
    EVENT,
    OK,
    LaneClock,
    Span,
    Trial,
    Verdict,
    fate_of,
    first_clock,
    judged,
    to_measure,
    to_tidy,
    trial_of,
)
from lierb.kernels.stepping.plan import AnyPlan
from lierb.kernels.stepping.signals import (
    Held,
    controllers_of,
    events_of,
    seen_by_functions,
    signals_of,
)
from lierb.kernels.stepping.state import State
from lierb.kernels.stepping.step_size import Tolerances, squared_error
from lierb.kernels.stepping.stepper import Slopes, between, trial_step
from lierb.kernels.stepping.systems import system_of

# Rows of a desk, of numbers that loops over lanes read and write.
(
    TRAJECTORY,  # whose the lane is; −1 for nobody's
    NUMBER,  # of the trajectory, for noise
    MARK,  # where something is to be done
    TIME,
    NEXT,  # row of the history that is due next
    DUE,  # when that is, s
    THETA,
    STATUS,
    LOW, HIGH, AT_LOW, AT_HIGH,  # of a crossing: θ and the function's value at both ends
    WHICH,  # of the events
    SHRINKING,  # of the search: how often the same end has moved
    FIRST_END,  # θ of the first terminal event in the step
    ACTIVE, FRESH, FATE,
    ROWS,
) = range(19)  # fmt: skip
LOOKS = 4  # at the functions of events in a step of a method with a continuous extension
CLOCK_ROWS = len(LaneClock._fields)
SEARCHES = 100  # halvings at most: θ has 53 bits


LANE_JOB = np.dtype(
    (
        np.record,
        [
            *((name, JOB[name]) for name in ARRAYS),
            *((name, np.int64, (4,)) for name in ("desk", "save_at", "numbers", "events", "kinds")),
            *((name, np.int64) for name in ("stop", "begin", "turns", "differ", "rows", "watched")),
            ("seed", np.float64),
            *get_type_hints(Span).items(),
            *get_type_hints(Tolerances).items(),
        ],
    )
)
"""As `lierb.kernels.stepping.driver.JOB`, of the batch or of a desk.

desk : [row][lane], of `desk_rows`.   save_at : [1][rows of the history], s.   numbers : [1][n].
events : [place][EVENT_COLUMNS and numbers of what is seen], of a desk; its place 0 has the count.
kinds : [direction, terminal][event].
turns : iterations in this call.   watched : how many events there are.
"""
EVENT_COLUMNS = 3  # trajectory, event, t


def desk_rows(plan: AnyPlan) -> int:
    """ROWS; each event's side, and its values at LOOKS + 1 times; the clock; what is held."""
    return _held_row(plan) + sum(_held_widths(plan))


def _clock_row(plan: AnyPlan) -> int:
    return ROWS + (LOOKS + 2) * len(events_of(plan))


def _held_row(plan: AnyPlan) -> int:
    return _clock_row(plan) + len(LaneClock._fields)


def _held_widths(plan: AnyPlan) -> tuple[int, int, int]:
    controls, memory = width_of(controls_of(plan)), width_of(memory_of(plan))
    return controls, memory, len(controllers_of(plan))


# ---- formulas on all lanes -----------------------------------------------------------------------


def any_of(numbers: Any) -> Any:
    """Whether some lane's number is not 0."""
    return any_lanes(numbers > 0.0)


def taken(mask: Any, new: Any, old: Any) -> Any:
    """`new` where the mask, 1 or 0, is 1."""
    return where(mask > 0.5, new, old)


def row_of(plan: AnyPlan, desk: Any, row: Any) -> Any:
    return load(desk, (row, 0), plan.lanes)


def put_row(plan: AnyPlan, desk: Any, row: Any, numbers: Any) -> None:
    store(desk, (row, 0), numbers, plan.lanes)


def load_clock(plan: AnyPlan, desk: Any) -> LaneClock:
    first = _clock_row(plan)
    return LaneClock(*(row_of(plan, desk, first + i) for i in range(len(LaneClock._fields))))


def load_held(plan: AnyPlan, desk: Any) -> Held:
    rows = iter(range(_held_row(plan), desk_rows(plan)))
    parts = (islice(rows, width) for width in _held_widths(plan))
    return Held(*(tuple(row_of(plan, desk, row) for row in part) for part in parts))


def store_lanes(plan: AnyPlan, desk: Any, clock: LaneClock, held: Held) -> None:
    """Until the next call."""
    for row, numbers in enumerate(flatten((clock, held)), _clock_row(plan)):
        put_row(plan, desk, row, numbers)


# ---- a trajectory's start ----


def started(
    plan: AnyPlan, body: Any, state: State, desk: Any, span: Span, limits: Tolerances
) -> tuple[State, Record, LaneClock, Held]:
    """With the user's states, and controllers before their first tick."""
    system, due = system_of(plan), row_of(plan, desk, DUE)
    state = state._replace(states=initial_states(plan, body, due))
    periods = [plain(every) for every in system.periods(body)] if controllers_of(plan) else []
    controls, _, _ = _held_widths(plan)
    held = Held(
        (0.0 * due,) * controls,
        tuple(0.0 * due + x for x in system.initial_memory(body)) if periods else (),
        tuple(0.0 * due + first_tick(span.start, every) for every in periods),
    )
    body = seen_by_functions(plan, body, state, held)
    if plan.calls_functions:
        calls.set_marks(calls.marks(due))
    clock = first_clock(plan, body, state, span, limits, due)
    return state, initial_record(plan, body, state), clock, held


# ---- an arrival ----


def is_tick(plan: AnyPlan, body: Any, clock: LaneClock, held: Held, fresh: Any) -> Any:
    """Whether a controller is to run somewhere."""
    due = fresh < -1.0  # never
    for number in range(len(controllers_of(plan))):
        due = due | _ticks(plan, body, clock, held, fresh, number)
    return any_lanes(due)


def _ticks(
    plan: AnyPlan, body: Any, clock: LaneClock, held: Held, fresh: Any, number: int
) -> Any:
    every = system_of(plan).periods(body)[number]
    ahead = every * held.ticks[number] - clock.t
    return (fresh > 0.5) & (ahead <= 4.0 * EPS * absolute(clock.t))


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
    system, own = system_of(plan), row_of(plan, desk, NUMBER)
    for number, controller in enumerate(controllers_of(plan)):
        due = _ticks(plan, body, clock, held, fresh, number)
        at = seen_by_functions(plan, body, state, held)
        tick = held.ticks[number]
        noise = Noise(seed, own, tick)
        seen = system.seen(at, state, clock.t)
        controls, memory = system.controlled(at, seen, clock.t, number, noise)
        first, kept = offsets_of(plan, number)
        held = Held(
            _replaced(held.controls, first, where(due, tuple(controls), held.controls[first : first + len(controls)])),
            _replaced(held.memory, kept, where(due, tuple(memory), held.memory[kept : kept + len(memory)])),
            _replaced(held.ticks, number, (where(due, tick + 1.0, tick),)),
        )
    return held


def _replaced(numbers: Vec, first: int, new: Vec) -> Vec:
    return numbers[:first] + tuple(new) + numbers[first + len(new) :]


def is_measured(clock: LaneClock, span: Span, fresh: Any, fate: Any) -> Any:
    return any_lanes(to_measure(clock, span, fresh, fate))


def measured_now(
    plan: AnyPlan, body: Any, state: State, record: Record, clock: LaneClock, span: Span,
    fresh: Any, fate: Any,
) -> tuple[Record, LaneClock]:  # fmt: skip
    """The record with what is seen now, where it is time for that."""
    now = to_measure(clock, span, fresh, fate)
    share = 0.5 * (clock.t - clock.seen) / (span.end - span.start)
    _, seen = observe(plan, body, state, record, clock.steps, clock.t, share, by_halves=True)
    return where(now, seen, record), clock._replace(seen=where(now, clock.t, clock.seen))


def fate_now(
    clock: LaneClock, span: Span, limits: Tolerances, record: Record, fresh: Any, fate: Any
) -> Any:
    return fate_of(clock, span, limits, record.status, fresh, fate)


def is_due(clock: LaneClock, fresh: Any) -> Any:
    """Whether a row of some lane's history is due now."""
    return any_lanes((fresh > 0.5) & (clock.due <= clock.t))


def mark_due(plan: AnyPlan, desk: Any, clock: LaneClock, fresh: Any) -> None:
    put_row(plan, desk, MARK, where((fresh > 0.5) & (clock.due <= clock.t), 1.0, 0.0 * clock.t))


def with_due(plan: AnyPlan, desk: Any, clock: LaneClock) -> LaneClock:
    """After rows have been handed over: when the next ones are due."""
    return clock._replace(due=row_of(plan, desk, DUE))


def show(
    plan: AnyPlan, body: Any, state: State, held: Held, record: Record, clock: LaneClock,
    time: Any, history: Any,
) -> Record:  # fmt: skip
    """A row of the history on the desk: measures, observables, states and controls."""
    shown, seen = observe(plan, body, state, record, clock.steps, time)
    signals = (*state.states, *held.controls)
    store_measures(plan, record, (*shown, *signals), history, 0, 0)
    return without_measures(plan, record, seen)


def show_end(
    plan: AnyPlan, state: State, held: Held, clock: LaneClock, summary: Any, fate: Any, column: Any
) -> None:
    """What lanes of their own clocks have in a summary beside the others, from `column` on."""
    status = where(fate > 0.5, fate - 1.0, fate)
    numbers = (status, clock.t, clock.steps, clock.rejected, clock.h, *state.states, *held.controls)
    for i, number in enumerate(numbers):
        store(summary, (column + i, 0), number, plan.lanes)


# ---- a step ----


class Made(NamedTuple):
    """Of a trial: the state, the slopes of its stages where somebody looks between, the mark of a
    singular configuration, and the square of the error.
    """

    state: State
    slopes: Any
    singular: Any
    square: Any


def next_trial(
    plan: AnyPlan, body: Any, clock: LaneClock, held: Held, span: Span, active: Any
) -> Trial:
    stop = span.end + 0.0 * clock.t
    periods = system_of(plan).periods(body) if controllers_of(plan) else ()
    for every, tick in zip(periods, held.ticks, strict=True):
        stop = minimum(stop, every * tick)
    return trial_of(plan, clock, stop, active)


def attempted(
    plan: AnyPlan, body: Any, state: State, record: Record, trial: Trial, limits: Tolerances
) -> Made:
    body = body._replace(dropped=record.dropped)
    looks = plan.embedded is not None or (plan.looks and plan.extension is not None)
    made = trial_step(plan, body, state, trial.start, trial.h, all_stages=looks)
    square: Any = ZERO
    if plan.embedded is not None:
        square = squared_error(plan, body, state, made.state, made.slopes, trial.h, limits)
    slopes = made.slopes if plan.looks and plan.extension is not None else ()
    return Made(made.state, slopes, made.singular, square)


def verdict_on(
    plan: AnyPlan, made: Made, clock: LaneClock, trial: Trial, limits: Tolerances, active: Any
) -> Verdict:
    turns, places = system_of(plan).told_by(made.state.chart)
    state = made.state
    numbers = (*turns, *state.v_or_mu, *state.x, *places, state.work, *state.states)
    fine = _are_finite(*numbers)
    return judged(plan, clock, trial, fine, made.singular, made.square, limits, active)


def is_refused(verdict: Verdict, active: Any) -> Any:
    return any_lanes((active > 0.5) & (verdict.failed > 0.5))


def with_failures(record: Record, clock: LaneClock, failed: Any) -> tuple[Record, Any]:
    """The record with the status of what has failed, and the fate of what ends though its state is
    fine: a step that would have to be too small.
    """
    hard = (failed > 0.5) & (failed < MAX_STEPS)
    status = where(hard & (record.status == OK), failed, record.status)
    step = where(hard & (record.status == OK), clock.steps, record.failed_step)
    soft = where(failed >= MAX_STEPS, failed + 1.0, 0.0 * failed)
    return record._replace(status=status, failed_step=step), soft


def is_to_tidy(clock: LaneClock, span: Span, fresh: Any) -> Any:
    return any_lanes(to_tidy(clock, span, fresh))


def tidied(
    plan: AnyPlan, body: Any, state: State, clock: LaneClock, span: Span, fresh: Any
) -> State:
    return where(to_tidy(clock, span, fresh), tidy(plan, body, state), state)


# ---- between the ends of a step ----


def theta_of(plan: AnyPlan, desk: Any) -> Any:
    return row_of(plan, desk, THETA)


def state_between(
    plan: AnyPlan, body: Any, state: State, made: Made, trial: Trial, theta: Any
) -> State:
    if not plan.looks:
        return state  # never
    return between(plan, body, state, trial.start, trial.h, made.slopes, theta)


def due_between(plan: AnyPlan, desk: Any, clock: LaneClock, trial: Trial, accepted: Any) -> Any:
    """Whether a row of the history is due before the end of an accepted step; then MARK and THETA
    say where, and when.
    """
    if not plan.looks:
        return all_lanes(clock.t < clock.t)  # never
    due = (accepted > 0.5) & (clock.due < clock.t)
    length = where(trial.h > 0.0, trial.h, 1.0)
    put_row(plan, desk, MARK, where(due, 1.0, 0.0 * clock.t))
    put_row(plan, desk, THETA, where(due, (clock.due - trial.start) / length, 0.0))
    return any_lanes(due)


def put_values(
    plan: AnyPlan, body: Any, state: State, held: Held, time: Any, desk: Any, row: Any
) -> None:
    """Of the events' functions, from a row of the desk on."""
    if not events_of(plan):
        return
    body = seen_by_functions(plan, body, state, held)
    system = system_of(plan)
    found = system.events(body, system.seen(body, state, time), time)
    for i, value in enumerate(found):
        put_row(plan, desk, row + i, value)


def put_lane_rows(
    plan: AnyPlan, desk: Any, trial: Trial, accepted: Any, active: Any, fresh: Any, fate: Any
) -> None:
    """For loops over lanes."""
    for row, numbers in (
        (MARK, accepted), (TIME, trial.start), (STATUS, trial.h), (ACTIVE, active),
    ):  # fmt: skip
        put_row(plan, desk, row, numbers)


def as_ended(
    record: Record, clock: LaneClock, span: Span
) -> Record:
    """The record of a trajectory that has ended, its means by the time that it has lasted."""
    lasted = clock.t - span.start
    length = where(lasted > 0.0, lasted, 1.0)
    seen = (each._replace(total=each.total / length) for each in record.observed)
    return record._replace(observed=tuple(seen))


for _formula in (
    any_of, taken, row_of, put_row, load_clock, load_held, store_lanes, started, is_tick, ticked,
    is_measured, measured_now, fate_now, is_due, mark_due, with_due, show, show_end, next_trial,
    attempted, verdict_on, is_refused, with_failures, is_to_tidy, tidied, theta_of, state_between,
    due_between, put_values, as_ended, seen_by_functions, crossings_possible, at_event, minus_one,
):  # fmt: skip
    kernel(_formula)


# ---- loops over lanes ----------------------------------------------------------------------------


@shared
def hand_over_row(desk, own, job, lanes):
    """A row of the history, from the desk to where MARK says, of the row that is due there; then
    the next one is due.
    """
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
        if multipliers.shape[0] > 0:
            for c in range(multipliers.shape[2]):
                multipliers[row, column, c] = own_multipliers[0, lane, c]
        joints = own_reactions.shape[0]
        for joint in range(joints):
            for c in range(6):
                reactions[joint * rows + row, column, c] = own_reactions[joint, lane, c]
        if job.rows > 1:
            hand_over_state(own, job, lane, column, row)
        desk[NEXT, lane] = row + 1
        desk[DUE, lane] = save_at[0, row + 1] if row + 1 < rows else np.inf


@shared
def hand_over_state(own, job, lane, column, row):
    """Of all links."""
    _copy(histories_at(own.rotation), histories_at(job.rotation), lane, column, row, job.rows)
    _copy(histories_at(own.position), histories_at(job.position), lane, column, row, job.rows)
    _copy(histories_at(own.omega), histories_at(job.omega), lane, column, row, job.rows)
    _copy(histories_at(own.v), histories_at(job.v), lane, column, row, job.rows)


@shared
def _copy(shown, array, lane, column, row, rows):
    for link in range(shown.shape[0]):
        for c in range(shown.shape[2]):
            array[link * rows + row, column, c] = shown[link, lane, c]


@shared
def hand_over_end(own, job, lane, column):
    """The end of a trajectory."""
    for c, (shown, array) in enumerate(
        ((numbers_at(own.summary), numbers_at(job.summary)), (numbers_at(own.ends), numbers_at(job.ends)))
    ):
        for row in range(shown.shape[0]):
            array[row, column] = shown[row, lane]
    hand_over_state(own, job, lane, column, job.rows - 1)
