"""A step of all lanes, each with its own clock; ticks, measures and rows due at its end."""

from __future__ import annotations

from typing import Any, NamedTuple

from lierb.kernels.loops.advance import tidy
from lierb.kernels.loops.lane_state import (
    Lanes,
    put_row,
    restore_exceptions,
    row_of,
    suppress_exceptions,
)
from lierb.kernels.loops.record import (
    are_finite,
    observe,
    with_all_parts,
    with_rank,
    with_turns,
    without_measures,
)
from lierb.kernels.loops.states_in_memory import keep_errors, take_next
from lierb.kernels.loops.ticks import controlled, is_any_due, periods_of
from lierb.kernels.loops.workspace import DUE, NOISE_INDEX, SELECTED
from lierb.kernels.numbers.arithmetic import (
    absolute,
    all_lanes,
    any_lanes,
    fma,
    maximum,
    minimum,
    where,
)
from lierb.kernels.numbers.dual import values
from lierb.kernels.numbers.zero import ZERO, is_zero
from lierb.kernels.stepping.lane_clock import (
    LaneClock,
    Span,
    Trial,
    judged,
    rounding_at,
    termination_of,
    to_measure,
    to_tidy,
    trial_of,
)
from lierb.kernels.stepping.method import Interval
from lierb.kernels.stepping.method_of import method_of
from lierb.kernels.stepping.step_size import Tolerances, squared_correction, squared_error
from lierb.kernels.stepping.travel import longest_step
from lierb.kernels.systems.combine import NAN
from lierb.kernels.systems.derivatives import completed
from lierb.kernels.systems.extra_states import with_signals
from lierb.kernels.systems.observables import Kept, observables_of, with_value
from lierb.kernels.systems.plan import AnyPlan
from lierb.kernels.systems.signals import controllers_of
from lierb.kernels.systems.state import MAX_STEPS, OK, State
from lierb.kernels.systems.system_of import system_of
from lierb.kernels.tracing.trace import kernel

NODES = 1e-13  # rounding of a tableau's nodes, sums of weights of either sign


# ---- a step ----


def last_end(lanes: Lanes, span: Span) -> Any:
    """Return the latest end of the next step, s: the end of the run."""
    return span.end + 0.0 * lanes.clock.t


def sooner(lanes: Lanes, stop: Any, time: Any) -> Any:
    """Return the earlier of `stop` and `time`, s; `stop` if `time` is past."""
    is_ahead = time - lanes.clock.t > rounding_at(lanes.clock.t)
    return where(is_ahead, minimum(stop, time), stop)


def next_trial(plan: AnyPlan, body: Any, lanes: Lanes, stop: Any, active: Any) -> Trial:
    """Return the step to be tried.   stop : latest end, s, without ticks, jumps and bounds."""
    clock, end = lanes.clock, stop
    body, state = values(body), values(lanes.state)
    for period, tick in zip(periods_of(plan, body), lanes.control.ticks, strict=True):
        time = period * tick  # a tick within rounding of the end counts as at the end
        time = where(absolute(time - end) <= rounding_at(end), end, time)
        stop = minimum(stop, time)
    for time in system_of(plan).jumps(body):
        stop = sooner(lanes, stop, time)
    if plan.is_adaptive:
        longest = longest_step(plan, body, state, state, clock.t, clock.h, clock.h)
        if longest is not None:
            clock = clock._replace(h=minimum(clock.h, longest.step))
    return trial_of(plan, clock, stop, active)


def interval_of(plan: AnyPlan, trial: Trial) -> Interval:
    """Return the interval of the step.

    If functions of time may jump at an end, theirs is inside the step by a rounding.
    """
    if not plan.jumps:
        return Interval(trial.start, trial.h, trial.h)
    rounding = rounding_at(maximum(absolute(trial.start), absolute(trial.end)))
    rounding = fma(NODES, trial.h, rounding)
    return Interval(trial.start + rounding, maximum(trial.h - 2.0 * rounding, 0.0), trial.h)


class Made(NamedTuple):
    """Result of a trial.

    slopes : slopes of the stages, if there is a continuous extension.
    singular : 1 in a singular configuration.   unsolved : 1 where an iteration has not converged.
    turns : number of its turns.
    square, correction : squares of the error and of the stabilisation's correction, relative to
        the tolerances.
    nearer : longest step by the rates at the start, s; structurally zero if nothing bounds it.
    """

    state: State
    slopes: Any
    singular: Any
    unsolved: Any
    turns: Any
    square: Any
    correction: Any
    nearer: Any


def attempted(plan: AnyPlan, body: Any, lanes: Lanes, trial: Trial, limits: Tolerances) -> Made:
    """Try a step."""
    state, body = lanes.state, with_rank(plan, body, lanes.record)
    all_stages = plan.is_continuous or plan.is_adaptive
    at = interval_of(plan, trial)
    made = method_of(plan).step(system_of(plan), body, state, at, all_stages)
    square: Any = ZERO
    correction: Any = ZERO
    nearer: Any = ZERO
    if plan.is_adaptive:
        body, before, seen = values(body), values(state), values(made)
        square = squared_error(plan, body, before, seen.state, seen.slopes, trial.h, limits)
        is_first = lanes.clock.steps + lanes.clock.ahead < 0.5
        correction = squared_correction(
            plan, body, before, seen.stabilised, trial.h, limits, is_first
        )
        if not plan.is_looped:
            at_end = method_of(plan).extrapolated(system_of(plan), before, seen.slopes, trial.h)
            wanted = lanes.clock.h
            longest = longest_step(plan, body, before, at_end, trial.start, trial.h, wanted)
            nearer = ZERO if longest is None else longest.step
    slopes = made.slopes if plan.is_continuous else ()
    moved = with_all_parts(plan, made.state)
    singular, unsolved, turns = values(made.singular), made.unsolved, made.turns
    return Made(moved, slopes, singular, unsolved, turns, square, correction, nearer)


def decided(
    plan: AnyPlan,
    body: Any,
    lanes: Lanes,
    made: Made,
    trial: Trial,
    limits: Tolerances,
    active: Any,
) -> tuple[Any, Any, Lanes]:
    """Accept a step, or shorten it, or end the trajectory.

    Return 1 where it is accepted; its status, OK if it does not fail; and the lanes with the clock
    after the step.
    """
    moved, square, singular = values(made.state), made.square, made.singular
    turns, places = system_of(plan).turns_and_places(moved.chart)
    numbers = (*turns, *moved.v_or_mu, *moved.x, *places, moved.work, *moved.states)
    fine = are_finite(*numbers) & (singular <= 0.5)
    if not is_zero(made.unsolved):
        fine = fine & (made.unsolved <= 0.5)
    if not is_zero(made.correction):
        too_large = made.correction > 1.0
        square = where(too_large & (made.correction > square), made.correction, square)
        singular = where(too_large, 1.0, singular)
    clock, longest = lanes.clock, None
    if plan.is_adaptive:
        body, before = values(body), values(lanes.state)
        longest = longest_step(plan, body, before, moved, clock.t, trial.h, clock.h)
    accepted, failed, clock = judged(
        plan, clock, trial, fine, singular, made.unsolved, square, longest, made.nearer, limits,
        active,
    )  # fmt: skip
    record = with_turns(lanes.record, made.turns, active > 0.5)
    return accepted, failed, lanes._replace(clock=clock, record=record)


def with_failures(lanes: Lanes, failed: Any, termination: Any) -> tuple[Lanes, Any]:
    """Return the lanes with the status of failed steps, and the termination codes.

    A trajectory that would need too small a step, or too many, ends in its last valid state.
    """
    record = lanes.record
    hard = (failed > 0.5) & (failed < float(MAX_STEPS)) & (record.status == OK)
    record = record._replace(
        status=where(hard, failed, record.status),
        failed_step=where(hard, lanes.clock.steps, record.failed_step),
    )
    ended = where(failed >= float(MAX_STEPS), failed + 1.0, termination)
    return lanes._replace(record=record), ended


def moved_to(lanes: Lanes, state: State, mask: Any) -> Lanes:
    """Return the lanes at `state` where the mask is 1."""
    return lanes._replace(state=where(mask > 0.5, state, lanes.state))


# ---- ticks of controllers ----


def to_tick(plan: AnyPlan, body: Any, lanes: Lanes, fresh: Any, termination: Any) -> Any:
    """Return 1 where a controller must run; 0 where an event has just ended a trajectory."""
    due = is_any_due(plan, body, lanes.control, lanes.clock.t, fresh)
    return where(due & (termination == 0.0), 1.0, 0.0 * fresh)


def ticked(plan: AnyPlan, body: Any, lanes: Lanes, ticks: Any, rows: Any, seed: Any) -> Lanes:
    """Run the controllers that are due.

    Observables are evaluated before and after, where one interval of a mean ends and one begins.
    """
    flags = suppress_exceptions(plan, ticks)
    watches = observables_of(plan) and controllers_of(plan)
    record, clock = lanes.record, lanes.clock
    if watches:
        due = (ticks > 0.5) & (clock.t > clock.seen)
        before = _observed(plan, body, lanes, _half(plan, clock))
        record = record._replace(observed=where(due, before, record.observed))
        clock = clock._replace(seen=where(due, clock.t, clock.seen))
    stream = row_of(plan, rows, NOISE_INDEX)
    ranked = with_rank(plan, body, record)
    control = controlled(plan, ranked, lanes.state, lanes.control, clock.t, ticks, seed, stream)
    lanes = Lanes(lanes.state, record, clock, control)
    if watches:
        after = tuple(
            new._replace(total=old.total, lost=old.lost)  # an infinite total stays infinite
            for new, old in zip(
                _observed(plan, body, lanes, 0.0 * clock.t), record.observed, strict=True
            )
        )
        record = record._replace(observed=where(ticks > 0.5, after, record.observed))
    restore_exceptions(plan, flags, ticks)
    return lanes._replace(record=record)


def _observed(plan: AnyPlan, body: Any, lanes: Lanes, half: Any) -> tuple[Kept, ...]:
    """Return the statistics of the observables, with their current values added.

    half : half the time since the last evaluation, s.
    """
    time, record, system = lanes.clock.t, lanes.record, system_of(plan)
    body = with_signals(plan, with_rank(plan, body, record), lanes.state, lanes.control)
    alive = record.status == OK
    seen = completed(plan, system.observed(body, system.motion(body, lanes.state, time), time))
    return tuple(
        with_value(old, where(alive, value, NAN), half, alive, by_halves=True)
        for old, value in zip(record.observed, seen, strict=True)
    )


# ---- measures and rows of the history at the end of a step ----


def termination_now(
    lanes: Lanes, span: Span, limits: Tolerances, fresh: Any, termination: Any
) -> Any:
    return termination_of(lanes.clock, span, limits, lanes.record.status, fresh, termination)


def _is_due(clock: LaneClock, fresh: Any) -> Any:
    """True where a row of the history is due now."""
    return (fresh > 0.5) & (clock.due - clock.t <= rounding_at(clock.t))


def measures_now(plan: AnyPlan, lanes: Lanes, span: Span, fresh: Any, termination: Any) -> Any:
    """Return whether any lane is measured now, or has a row of the history due."""
    now = to_measure(lanes.clock, span, fresh, termination)
    return any_lanes(now | _is_due(lanes.clock, fresh))


def with_measures(
    plan: AnyPlan, body: Any, lanes: Lanes, span: Span, fresh: Any, termination: Any
) -> tuple[tuple[Any, ...], Lanes]:
    """Return a row of the history, and the lanes with the current measures recorded."""
    clock, record = lanes.clock, lanes.record
    now = to_measure(clock, span, fresh, termination)
    mask = where(now | _is_due(clock, fresh), 1.0, 0.0 * fresh)
    flags = suppress_exceptions(plan, mask)
    half = _half(plan, clock)
    shown, seen = observe(
        plan, body, lanes.state, record, clock.steps, clock.t, half, by_halves=True
    )
    keep_errors(plan, body, seen, where(now, 1.0, 0.0 * fresh))
    record = where(now, seen, without_measures(plan, record, seen))
    restore_exceptions(plan, flags, mask)
    clock = clock._replace(seen=where(now, clock.t, clock.seen))
    row = (*shown, *values((*lanes.state.states, *lanes.control.controls)))
    return row, lanes._replace(record=record, clock=clock)


def _half(plan: AnyPlan, clock: LaneClock) -> Any:
    """Return half the time since the last measurement, s; zero if its steps were sampled."""
    return ZERO if plan.samples else 0.5 * (clock.t - clock.seen)


def select_due(plan: AnyPlan, rows: Any, lanes: Lanes, fresh: Any) -> Any:
    """Select the lanes in which a row of the history is due; return whether there is any."""
    if not plan.interpolates:
        return all_lanes(lanes.clock.t < lanes.clock.t)  # never
    due = _is_due(lanes.clock, fresh)
    put_row(plan, rows, SELECTED, where(due, 1.0, 0.0 * lanes.clock.t))
    return any_lanes(due)


def with_due(plan: AnyPlan, rows: Any, lanes: Lanes) -> Lanes:
    """Return the lanes with the due times of their next rows."""
    return lanes._replace(clock=lanes.clock._replace(due=row_of(plan, rows, DUE)))


def is_to_tidy(lanes: Lanes, fresh: Any, termination: Any) -> Any:
    return any_lanes(to_tidy(lanes.clock, fresh, termination))


def tidied(plan: AnyPlan, body: Any, lanes: Lanes, fresh: Any, termination: Any) -> Lanes:
    mask = to_tidy(lanes.clock, fresh, termination)
    state = tidy(plan, body, lanes.state)
    take_next(plan, body, where(mask, 1.0, 0.0 * fresh))
    return lanes._replace(state=where(mask, state, lanes.state))


for _formula in (
    last_end, sooner, next_trial, attempted, decided, with_failures, moved_to, to_tick, ticked,
    termination_now, measures_now, with_measures, select_due, with_due, is_to_tidy, tidied,
):  # fmt: skip
    kernel(_formula)
