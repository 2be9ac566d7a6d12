"""What lanes with clocks of their own do, on all lanes at once: the formulas between the loops of
`lierb.kernels.loops.lanes`.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from lierb.kernels.functions.function import size_of
from lierb.kernels.functions.signals import Noise
from lierb.kernels.loops.advance import tidy
from lierb.kernels.loops.record import (
    NAN,
    Record,
    are_finite,
    initial_record,
    initial_state,
    load_placed,
    observe,
    state_columns,
    user_state,
    without_measures,
)
from lierb.kernels.loops.workspace import (
    DUE,
    LAST,
    LENGTH,
    MARK,
    NUMBER,
    START,
    THETA,
    TOOK,
    desk_of,
)
from lierb.kernels.numbers.arithmetic import (
    absolute,
    all_lanes,
    any_lanes,
    flatten,
    floor,
    fma,
    load,
    maximum,
    minimum,
    plain,
    rint,
    store,
    where,
)
from lierb.kernels.numbers.vec import Vec
from lierb.kernels.numbers.zero import ZERO, is_zero
from lierb.kernels.stepping.lane_clock import (
    LaneClock,
    Span,
    Trial,
    Verdict,
    continued,
    fate_of,
    first_clock,
    judged,
    rounding_at,
    to_measure,
    to_tidy,
    trial_of,
)
from lierb.kernels.stepping.step_size import (
    Tolerances,
    longest_step,
    parts_to_watch,
    squared_correction,
    squared_error,
)
from lierb.kernels.stepping.stepper import between, extended, trial_step
from lierb.kernels.systems.extra_states import Held, with_signals
from lierb.kernels.systems.layout import LANE_END
from lierb.kernels.systems.observables import Kept, observables_of, with_value
from lierb.kernels.systems.plan import AnyPlan
from lierb.kernels.systems.signals import (
    controllers_of,
    events_of,
    lane_end,
    memory_slices,
    output_slices,
    outputs_of,
    states_of,
)
from lierb.kernels.systems.state import EVENT, MAX_STEPS, OK, State
from lierb.kernels.systems.system_of import system_of
from lierb.kernels.tracing import calls
from lierb.kernels.tracing.trace import kernel

NODES = 1e-13  # rounding of a tableau's nodes, sums of weights of either sign


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


# ---- functions that are called body by body, and what they raise ----


def silenced(plan: AnyPlan, known: Any) -> Any:
    """The marks so far; from now on functions are called where `known` is 1 alone. What is but
    computed beside the others, of no state that a trajectory has, shall raise nothing.
    """
    if not plan.calls_functions:
        return known
    before = calls.marks(known)
    calls.set_marks(where(known > 0.5, before, float(calls.SILENT)))
    return before


def renewed(plan: AnyPlan, fresh: Any) -> Any:
    """The same before trajectories start: of these nothing has raised."""
    if not plan.calls_functions:
        return fresh
    before = calls.marks(fresh)
    calls.set_marks(where(fresh > 0.5, float(calls.CLEAR), float(calls.SILENT)))
    return before


def restored(plan: AnyPlan, before: Any, known: Any) -> None:
    """The marks where `known` is not 1."""
    if plan.calls_functions:
        calls.set_marks(where(known > 0.5, calls.marks(known), before))


# ---- a trajectory's start ----


def own_start(plan: AnyPlan, body: Any, inputs: Any, desk: Any) -> State:
    """The state with the initial values of the user's own."""
    placed = load_placed(plan, body, inputs)
    state, zero = initial_state(plan, body, placed, inputs), 0.0 * row_of(plan, desk, NUMBER)
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
    is_one = absolute(count - whole) <= rounding_at(count)
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
    """Behind what `store_end` stores, for a run that goes on."""
    clock = clock._replace(ahead=clock.ahead + clock.steps)
    own = (getattr(clock, field.name) for field in LANE_END.fields)
    first = len(state_columns(plan)) + plan.keeps_rank
    for row, number in enumerate((*own, *flatten(held)), first):
        store(ends, (row, 0), number, plan.lanes)


# ---- an arrival at the end of a step, or at a start ----


def to_tick(plan: AnyPlan, body: Any, clock: LaneClock, held: Held, fresh: Any, fate: Any) -> Any:
    """1 where a controller is to run; not where an event has just ended a trajectory."""
    due = fresh < -1.0  # never
    for tick, every in zip(held.ticks, _periods(plan, body), strict=True):
        due = due | _ticks(clock, tick, every, fresh)
    return where(due & (fate == 0.0), 1.0, 0.0 * fresh)


def _ticks(clock: LaneClock, tick: Any, every: Any, fresh: Any) -> Any:
    return (fresh > 0.5) & (every * tick - clock.t <= rounding_at(clock.t))


class Ticked(NamedTuple):
    record: Record
    clock: LaneClock
    held: Held


def ticked(
    plan: AnyPlan,
    body: Any,
    state: State,
    record: Record,
    clock: LaneClock,
    held: Held,
    ticks: Any,
    desk: Any,
    seed: Any,
) -> Ticked:
    """With what controllers set, where they are to run; each sees what those before it have set.
    A mean's interval that ends here has no part of what comes after it.
    """
    others = silenced(plan, ticks)
    watches = observables_of(plan) and controllers_of(plan)
    if watches:
        due = (ticks > 0.5) & (clock.t > clock.seen)
        half = 0.5 * (clock.t - clock.seen)
        before = _observed(plan, body, state, held, record, clock.t, half)
        record = record._replace(observed=where(due, before, record.observed))
        clock = clock._replace(seen=where(due, clock.t, clock.seen))
    held = _controlled(plan, body, state, clock, held, ticks, desk, seed)
    if watches:
        zero = 0.0 * clock.t
        after = _observed(plan, body, state, held, record, clock.t, zero)
        after = tuple(
            new._replace(total=old.total, lost=old.lost)  # an infinite one stays so
            for new, old in zip(after, record.observed, strict=True)
        )
        record = record._replace(observed=where(ticks > 0.5, after, record.observed))
    restored(plan, others, ticks)
    return Ticked(record, clock, held)


def _controlled(
    plan: AnyPlan,
    body: Any,
    state: State,
    clock: LaneClock,
    held: Held,
    ticks: Any,
    desk: Any,
    seed: Any,
) -> Held:
    system, trajectory = system_of(plan), row_of(plan, desk, NUMBER)
    periods = _periods(plan, body)
    for number, every in enumerate(periods):
        tick = held.ticks[number]
        due = _ticks(clock, tick, every, ticks)
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


def _observed(
    plan: AnyPlan, body: Any, state: State, held: Held, record: Record, time: Any, half: Any
) -> tuple[Kept, ...]:
    """What is kept of the observables, with one value more."""
    system, body = system_of(plan), with_signals(plan, body, state, held)
    alive = record.status == OK
    values = system.observed(body, system.seen(body, state, time), time)
    return tuple(
        with_value(old, where(alive, value, NAN), half, alive, by_halves=True)
        for old, value in zip(record.observed, values, strict=True)
    )


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
    return (fresh > 0.5) & (clock.due - clock.t <= rounding_at(clock.t))


def _is_due_before(clock: LaneClock, accepted: Any) -> Any:
    """Whether a row is due before the end of an accepted step. One that is due there is shown after
    a tick.
    """
    return (accepted > 0.5) & (clock.t - clock.due > rounding_at(clock.t))


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
    asked = where(now | _is_due(clock, fresh), 1.0, 0.0 * fresh)
    others = silenced(plan, asked)
    half = 0.5 * (clock.t - clock.seen)
    shown, seen = observe(plan, body, state, record, clock.steps, clock.t, half, by_halves=True)
    record = where(now, seen, without_measures(plan, record, seen))
    restored(plan, others, asked)
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


def last_end(clock: LaneClock, span: Span) -> Any:
    """Where the next step ends at the latest, s: at the end of the run."""
    return span.end + 0.0 * clock.t


def sooner(clock: LaneClock, stop: Any, time: Any) -> Any:
    """`stop`, or a time before it that is not over, s."""
    is_ahead = time - clock.t > rounding_at(clock.t)
    return where(is_ahead, minimum(stop, time), stop)


def next_trial(
    plan: AnyPlan, body: Any, state: State, clock: LaneClock, held: Held, stop: Any, active: Any
) -> Trial:
    """The step to be tried.   stop : where it ends at the latest, s, as far as is known."""
    end = stop
    for every, tick in zip(_periods(plan, body), held.ticks, strict=True):
        at = every * tick  # as near to the end as rounding, it is there
        at = where(absolute(at - end) <= rounding_at(end), end, at)
        stop = minimum(stop, at)
    for time in system_of(plan).jumps(body):
        stop = sooner(clock, stop, time)
    if plan.embedded is not None:
        longest = longest_step(plan, body, state, state, clock.t, clock.h)
        stop = stop if longest is None else minimum(stop, clock.t + longest)
    return trial_of(plan, clock, stop, active)


def inside(plan: AnyPlan, trial: Trial) -> tuple[Any, Any]:
    """Beginning and length of the step as functions of time see it, s: where one may jump at
    either end, a rounding inside.
    """
    if not plan.jumps:
        return trial.start, trial.h
    rounding = rounding_at(maximum(absolute(trial.start), absolute(trial.end)))
    rounding = fma(NODES, trial.h, rounding)
    return trial.start + rounding, maximum(trial.h - 2.0 * rounding, 0.0)


class Made(NamedTuple):
    """Of a trial: the state, the slopes of its stages where somebody looks between, the mark of a
    singular configuration, and the squares of the error and of the stabilisation's correction.
    """

    state: State
    slopes: Any
    singular: Any
    square: Any
    correction: Any


def attempted(
    plan: AnyPlan,
    body: Any,
    state: State,
    clock: LaneClock,
    trial: Trial,
    limits: Tolerances,
) -> Made:
    is_continuous = plan.looks and plan.extension is not None
    all_stages = is_continuous or plan.embedded is not None
    made = trial_step(plan, body, state, *inside(plan, trial), trial.h, all_stages)
    square: Any = ZERO
    correction: Any = ZERO
    if plan.embedded is not None:
        square = squared_error(plan, body, state, made.state, made.slopes, trial.h, limits)
        is_first = clock.steps + clock.ahead < 0.5
        correction = squared_correction(plan, body, state, made.kept, trial.h, limits, is_first)
    slopes = made.slopes if is_continuous else ()
    return Made(made.state, slopes, made.singular, square, correction)


def verdict_on(
    plan: AnyPlan,
    body: Any,
    state: State,
    made: Made,
    clock: LaneClock,
    trial: Trial,
    limits: Tolerances,
    active: Any,
) -> Verdict:
    moved, square, singular = made.state, made.square, made.singular
    turns, places = system_of(plan).told_by(moved.chart)
    numbers = (*turns, *moved.v_or_mu, *moved.x, *places, moved.work, *moved.states)
    fine = are_finite(*numbers) & (singular <= 0.5)
    if not is_zero(made.correction):
        too_large = made.correction > 1.0
        square = where(too_large & (made.correction > square), made.correction, square)
        singular = where(too_large, 1.0, singular)
    longest = None
    if plan.embedded is not None:
        longest = longest_step(plan, body, state, moved, clock.t, clock.h)
    return judged(plan, clock, trial, fine, singular, square, longest, limits, active)


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


def is_to_tidy(clock: LaneClock, fresh: Any, fate: Any) -> Any:
    return any_lanes(to_tidy(clock, fresh, fate))


def tidied(
    plan: AnyPlan, body: Any, state: State, clock: LaneClock, fresh: Any, fate: Any
) -> State:
    return where(to_tidy(clock, fresh, fate), tidy(plan, body, state), state)


# ---- between the ends of a step ----


def is_due_between(plan: AnyPlan, clock: LaneClock, accepted: Any) -> Any:
    """Whether a row of some history is due before the end of an accepted step.

    clock : at that end.
    """
    if not plan.looks:
        return all_lanes(clock.t < clock.t)  # never
    return any_lanes(_is_due_before(clock, accepted))


def slopes_between(plan: AnyPlan, body: Any, state: State, made: Made, trial: Trial) -> Any:
    """What `state_between` is made of."""
    if not plan.looks or plan.extension is None:
        return ()
    return extended(plan, body, state, *inside(plan, trial), trial.h, made.slopes)


def state_between(
    plan: AnyPlan, body: Any, state: State, slopes: Any, trial: Trial, theta: Any
) -> State:
    if not plan.looks:
        return state  # never
    return between(plan, body, state, *inside(plan, trial), trial.h, slopes, theta)


def time_between(trial: Trial, theta: Any) -> Any:
    return trial.start + theta * trial.h


def mark_due_between(
    plan: AnyPlan, desk: Any, clock: LaneClock, trial: Trial, accepted: Any
) -> None:
    """MARK and THETA say where a row of the history is due, and when."""
    due = _is_due_before(clock, accepted)
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


def put_roundings(
    plan: AnyPlan, body: Any, state: State, held: Held, time: Any, desk: Any, first: Any
) -> None:
    """How much rounding makes of the events' values, which are on the desk from row `first` on."""
    if events_of(plan):
        system, body = system_of(plan), with_signals(plan, body, state, held)
        nearby = system.events_nearby(body, system.seen(body, state, time), time)
        values = [row_of(plan, desk, first + i) for i in range(len(nearby))]
        pairs = zip(nearby, values, strict=True)
        _put_rows(plan, desk, "roundings", tuple(absolute(x - value) for x, value in pairs))


def put_shown(
    plan: AnyPlan, body: Any, inputs: Any, state: State, record: Record, held: Held, desk: Any
) -> None:
    """All that tables show of a state."""
    links = user_state(plan, body, inputs, state, record)
    _put_rows(plan, desk, "shown", (*links, state.states, held.controls))


class Part(NamedTuple):
    """A part of a step: number `at` out of `count`, lane by lane.

    open : 1 where events are to be looked for in it.   is_last : 1 where the step ends with it.
    """

    at: Any
    count: Any
    open: Any
    is_last: Any


def parts_of(
    plan: AnyPlan, body: Any, state: State, moved: State, trial: Trial, accepted: Any
) -> Part:
    """The first part, in which every accepted step is."""
    if not events_of(plan):
        return Part(accepted, accepted, accepted, accepted)  # never
    count = parts_to_watch(plan, body, state, moved, trial)
    return _part(0.0 * count, count, accepted)


def next_part(part: Part, fate: Any) -> Part:
    """The part after it, where there is one and nothing has ended the trajectory."""
    goes_on = (part.open > 0.5) & (part.is_last < 0.5) & (fate == 0.0)
    return _part(part.at + 1.0, part.count, where(goes_on, 1.0, 0.0 * fate))


def _part(at: Any, count: Any, is_open: Any) -> Part:
    return Part(at, count, is_open, where(at + 1.0 >= count, 1.0, 0.0 * at))


def ends_step(part: Part) -> Any:
    """Whether the part is the last one in every lane that has it."""
    return all_lanes((part.is_last > 0.5) | (part.open < 0.5))


def in_step(part: Part, theta: Any) -> Any:
    """θ of the step, from that of its part."""
    return (part.at + theta) / part.count


def put_part(plan: AnyPlan, desk: Any, trial: Trial, part: Part) -> None:
    """Have events looked for in a part, as if it were a step."""
    put_row(plan, desk, TOOK, part.open)
    put_row(plan, desk, START, time_between(trial, in_step(part, 0.0)))
    put_row(plan, desk, LENGTH, trial.h / part.count)


class Ending(NamedTuple):
    """A step in which something terminal happens: state and clock there, and the fate."""

    state: State
    clock: LaneClock
    fate: Any


def ended_between(
    plan: AnyPlan,
    desk: Any,
    there: State,
    moved: State,
    trial: Trial,
    part: Part,
    clock: LaneClock,
    fate: Any,
) -> Ending:
    """there : the states at θ = LAST of the part."""
    last = row_of(plan, desk, LAST)
    ends = last <= 1.0
    state = where(ends, there, moved)
    t = where(ends, time_between(trial, in_step(part, last)), clock.t)
    clock = clock._replace(
        t=t, anchor=where(ends, t, clock.anchor), counted=where(ends, 0.0, clock.counted)
    )
    return Ending(state, clock, where(ends, float(EVENT + 1), fate))


for _formula in (
    any_of, taken, row_of, put_row, load_lanes, store_lanes, own_start, started, to_tick, ticked,
    fate_now, looks_now, looked, mark_due, with_due, store_lane_summary, as_ended, last_end,
    sooner, next_trial, attempted, verdict_on, with_failures, is_to_tidy, tidied, is_due_between,
    slopes_between, state_between, time_between, mark_due_between, shown_between, put_values,
    put_roundings, put_shown, parts_of, next_part, ends_step, in_step, put_part, ended_between,
    with_signals, goes_on, store_lane_end, silenced, renewed, restored,
):  # fmt: skip
    kernel(_formula)
