"""A lane's clock has its trajectory's current time, the next step's length, the end of the run.

Fixed steps end at t = anchor + dt·k, the same doubles as with one clock for all lanes. Adaptive
steps end where step-size control chooses. Both also end at ticks of controllers and at the end of
the run.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from lierb.kernels.mechanics.kinks import LOOSE
from lierb.kernels.numbers.arithmetic import (
    absolute,
    all_lanes,
    branch,
    maximum,
    minimum,
    rint,
    where,
)
from lierb.kernels.numbers.zero import ZERO, is_zero
from lierb.kernels.stepping.clock import TIDY_EVERY
from lierb.kernels.stepping.step_size import EPS, LEAST_ULPS, Tolerances, change, first_step, within
from lierb.kernels.systems.layout import LANE_END
from lierb.kernels.systems.plan import AnyPlan
from lierb.kernels.systems.state import (
    DT_MIN,
    MAX_STEPS,
    NO_CONVERGENCE,
    NON_FINITE,
    OK,
    RAISED,
    SINGULAR,
    State,
)
from lierb.kernels.tracing import calls

INF = float("inf")
NEARLY = 1e-9  # fraction of a step: a shorter remainder of the run is added to the step


def rounding_at(time: Any) -> Any:
    """Return the distance within which two times count as equal, s.

    Times are sums of steps, and multiples of a period.
    """
    return 4.0 * EPS * absolute(time)


class Span(NamedTuple):
    """A span is the start and end of a run, s.

    origin, counted : fixed steps start `counted` steps after `origin`, s.
    every : number of steps between two measurements.
    """

    start: float
    end: float
    origin: float
    counted: float
    every: float


class LaneClock(NamedTuple):
    """Hold the clock of a lane.

    t : current time, s.   h : length of the next step unless it is cut short, s.
    anchor, counted : fixed steps are counted from `anchor`, s.
    before : level of the last error, for step-size control; see `Change`.
    steps, rejected : counts of accepted and rejected steps so far.
    seen : time at which observables were last evaluated, s.
    due : time of the next row of the history, s.   ahead : number of steps before the start.
    """

    t: Any
    h: Any
    anchor: Any
    counted: Any
    before: Any
    steps: Any
    rejected: Any
    seen: Any
    due: Any
    ahead: Any


class Trial(NamedTuple):
    """A trial is a step to be tried, from `start` to `end`, of length h, s.

    is_cut : 1 where the step is cut short.
    """

    start: Any
    h: Any
    end: Any
    is_cut: Any


# Outcome of a step: 1 where it is accepted; its status, OK if it does not fail; the clock after it.
Verdict = tuple[Any, Any, LaneClock]


def first_clock(
    plan: AnyPlan, body: Any, state: State, span: Span, limits: Tolerances, zero: Any
) -> LaneClock:
    """Return the clock at the start, with no row due.   zero : 0 in each lane."""
    start, length = zero + span.start, zero + (span.end - span.start)
    h = zero + limits.dt
    if plan.is_adaptive:
        chosen = first_step(plan, body, state, start, length, limits)
        chosen = where(h > 0.0, h, chosen)
        h = within(chosen, limits)
    return LaneClock(
        start,
        h,
        zero + span.origin,
        zero + span.counted,
        zero,
        zero,
        zero,
        start,
        zero + INF,
        zero + span.counted,
    )


def continued(
    plan: AnyPlan, clock: LaneClock, limits: Tolerances, ends: dict[str, tuple[Any, ...]]
) -> LaneClock:
    """Return the clock of a continued run: the last one of the run before, unless options differ.

    ends : LANE_END; NaN if the run before had one clock for all lanes.
    """
    anchor, counted, h, before, ahead = (ends[field.name][0] for field in LANE_END.fields)
    if not plan.is_adaptive:
        same = h == clock.h
        return clock._replace(
            anchor=where(same, anchor, clock.anchor),
            counted=where(same, counted, clock.counted),
            ahead=where(same, ahead, clock.ahead),
        )
    known = h == h
    chosen = known & (0.0 * clock.h + limits.dt == 0.0)
    return clock._replace(
        h=where(chosen, within(where(known, h, clock.h), limits), clock.h),
        before=where(chosen, before, clock.before),
        ahead=where(known, ahead, clock.ahead),
    )


def trial_of(plan: AnyPlan, clock: LaneClock, stop: Any, active: Any) -> Trial:
    """Return the next step to be tried.

    stop : its latest end, s.   active : 0 where the lane is idle.

    A fixed step that ends exactly at `stop` is not cut, and the step count goes on.
    """
    left = stop - clock.t
    reaches = clock.h * (1.0 + NEARLY) >= left
    if not plan.is_adaptive:
        reached = clock.anchor + clock.h * (clock.counted + 1.0)
        end = where(reaches, stop, reached)
        is_whole = absolute(left - clock.h) <= rounding_at(absolute(stop) + clock.h)
        reaches = reaches & ~is_whole
        h = where(reaches, left, clock.h)
    else:  # leave no tiny remainder for the last step
        half = clock.t + 0.5 * left
        ahead = where(clock.h > 0.5 * left, half, clock.t + clock.h)
        end = where(reaches, stop, ahead)
        h = end - clock.t
    going = active > 0.5
    return Trial(
        clock.t, where(going, h, 0.0), where(going, end, clock.t), where(reaches, 1.0, 0.0 * left)
    )


def judged(
    plan: AnyPlan,
    clock: LaneClock,
    trial: Trial,
    fine: Any,
    singular: Any,
    unsolved: Any,
    square: Any,
    longest: Any,
    nearer: Any,
    limits: Tolerances,
    active: Any,
) -> Verdict:
    """Accept or reject a step, and choose the next one.

    fine : mask of states that are finite and not singular.
    singular, unsolved : 1 where a step that cannot be shortened fails with SINGULAR, with
        NO_CONVERGENCE.
    square : square of the error.
    longest : longest step that elements allow by the motion at its end; None for any.
    nearer : the same by the rates at its start, which a failed step does not spoil;
        structurally zero if it is unknown.
    """
    running = active > 0.5
    raised = running & ~running
    if plan.calls_functions:
        raised = running & (calls.exception_flags(clock.t) > calls.SUPPRESSED)
    worse: Any = float(NON_FINITE)
    if not is_zero(unsolved):
        worse = where(unsolved > 0.5, float(NO_CONVERGENCE), worse)
    worse = where(singular > 0.5, float(SINGULAR), worse)
    if not plan.is_adaptive:
        return _fixed(clock, trial, fine, worse, raised, running)
    steps = clock.steps
    meets = fine & (square <= 1.0) & (trial.end > trial.start)  # false for NaN
    is_exact = meets
    if longest is not None:
        meets = meets & (trial.h <= longest.made)
    accepted = running & meets & ~raised
    by = change(plan, where(fine & (square == square), square, INF), clock.before, meets)
    grown = trial.h * by.factor
    if longest is not None:
        shorter = where(is_exact, longest.step, minimum(grown, longest.step))
        if not is_zero(nearer):
            shorter = where(trial.h > LOOSE * nearer, nearer, shorter)
        grown = where(meets, grown, shorter)
    # A step that was cut short does not determine the length of a full one.
    longer = where(trial.h < 0.5 * clock.h, maximum(grown, clock.h), grown)
    taken = clock._replace(
        t=trial.end, h=within(longer, limits), before=by.level, steps=steps + 1.0
    )

    def some_refused() -> Verdict:
        refused = running & ~meets & ~raised
        least = maximum(limits.dt_min, LEAST_ULPS * EPS * absolute(clock.t))
        too_small = refused & (trial.h <= least)
        too_many = refused & (steps + clock.rejected + 1.0 >= limits.max_steps)
        failed = where(too_many, float(MAX_STEPS), float(OK))
        short = where(fine & (singular <= 0.5), float(DT_MIN), worse)
        failed = where(too_small, short, failed)
        again = clock._replace(
            h=where(refused, within(grown, limits), within(clock.h, limits)),
            before=where(refused, 0.0, clock.before),
            rejected=where(refused, clock.rejected + 1.0, clock.rejected),
        )
        failed = where(raised, float(RAISED), failed)
        return where(accepted, 1.0, 0.0 * steps), failed, where(accepted, taken, again)

    zero = 0.0 * steps
    return branch(all_lanes(accepted), lambda: (zero + 1.0, zero + float(OK), taken), some_refused)


def _fixed(
    clock: LaneClock, trial: Trial, fine: Any, worse: Any, raised: Any, running: Any
) -> Verdict:
    """Accept a fixed step, or end the trajectory.   worse : status if the step is not fine."""
    steps, moves = clock.steps, trial.end > trial.start
    accepted = running & fine & moves & ~raised
    failed = where(running & ~accepted, where(moves, worse, float(DT_MIN)), float(OK))
    counted = clock._replace(steps=where(accepted, steps + 1.0, steps))
    cut = accepted & (trial.is_cut > 0.5)
    moved = counted._replace(
        t=where(accepted, trial.end, clock.t),
        anchor=where(cut, trial.end, clock.anchor),
        counted=where(cut, 0.0, where(accepted, clock.counted + 1.0, clock.counted)),
    )
    failed = where(raised, float(RAISED), failed)
    return where(accepted, 1.0, 0.0 * steps), failed, moved


def to_tidy(clock: LaneClock, fresh: Any, termination: Any) -> Any:
    """Return where the pose is to be renormalised.

    It is every TIDY_EVERY steps, counted over continued runs.
    """
    counted = clock.steps + clock.ahead
    turns = is_multiple(counted, float(TIDY_EVERY))
    return (fresh > 0.5) & (termination == 0.0) & turns & (counted > 0.0)


def to_measure(clock: LaneClock, span: Span, fresh: Any, termination: Any) -> Any:
    """Return where a trajectory is measured: every `span.every` steps, and at its end."""
    return (fresh > 0.5) & (is_multiple(clock.steps, span.every) | (termination > 0.0))


def is_multiple(count: Any, every: Any) -> Any:
    """Return whether a whole number is a multiple of another.

    An approximate quotient suffices; 1 / every is computed once for all lanes.
    """
    return count == every * rint(count * (1.0 / every))


def termination_of(
    clock: LaneClock, span: Span, limits: Tolerances, status: Any, fresh: Any, termination: Any
) -> Any:
    """Return the termination code: 0 while a trajectory runs, then its status + 1."""
    fresh = (fresh > 0.5) & (termination == 0.0)
    many = clock.steps + clock.rejected >= limits.max_steps
    code = where(many, float(MAX_STEPS + 1), ZERO)
    code = where(clock.t >= span.end, float(OK + 1), code)
    code = where(status > 0.0, status + 1.0, code)
    return where(fresh, code, termination)
