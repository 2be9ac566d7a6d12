"""A clock for each lane: when its trajectory is, how long the next step is, when it ends.

Fixed steps end at t = anchor + dt·k, the same doubles as if all lanes had one clock; adaptive ones
where the step-size control says. Both end where a controller ticks, and at the end of the run.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from lierb.kernels.numbers.arithmetic import (
    absolute,
    all_lanes,
    branch,
    maximum,
    minimum,
    rint,
    where,
)
from lierb.kernels.numbers.zero import ZERO
from lierb.kernels.stepping.clock import TIDY_EVERY
from lierb.kernels.stepping.step_size import (
    EPS,
    LEAST_ULPS,
    Tolerances,
    change,
    first_step,
    within,
)
from lierb.kernels.systems.layout import LANE_END
from lierb.kernels.systems.plan import AnyPlan
from lierb.kernels.systems.state import DT_MIN, MAX_STEPS, NON_FINITE, OK, RAISED, SINGULAR, State
from lierb.kernels.tracing import calls

INF = float("inf")
PASSED = 1.1  # by so much of `longest` a step may be longer, as velocities change in it
NEARLY = 1e-9  # of a step: what is left of a run, less than that, belongs to the step


def rounding_at(time: Any) -> Any:
    """How far apart two times may be that are one, s: sums of steps, and multiples of a period."""
    return 4.0 * EPS * absolute(time)


class Span(NamedTuple):
    """Of a run, s.

    origin, counted : of fixed steps, the start is so many steps after that time.
    every : how many steps between two measurements.
    """

    start: float
    end: float
    origin: float
    counted: float
    every: float


class LaneClock(NamedTuple):
    """t : now, s.   h : the next step, as far as nothing cuts it short, s.

    anchor, counted : fixed steps are counted from there.   before : of the step-size control.
    steps, rejected : so far.   seen : when the observables were looked at last, s.
    due : when the next row of the history is, s.   ahead : steps before the start.
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
    """A step to be tried: from `start` on, h long, to `end`, s.   lands : 1 where something cuts it
    short.
    """

    start: Any
    h: Any
    end: Any
    lands: Any


class Verdict(NamedTuple):
    """accepted : 1 where the step is taken.   failed : a status, or OK."""

    accepted: Any
    failed: Any
    clock: LaneClock


def first_clock(
    plan: AnyPlan, body: Any, state: State, span: Span, limits: Tolerances, zero: Any
) -> LaneClock:
    """Before anything is due.   zero : of each lane."""
    start, length = zero + span.start, zero + (span.end - span.start)
    h = zero + limits.dt
    if plan.embedded is not None:
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
    plan: AnyPlan, clock: LaneClock, limits: Tolerances, found: dict[str, tuple[Any, ...]]
) -> LaneClock:
    """The clock of a run that goes on: where nothing else is asked for, as that before has left it.

    found : LANE_END; NaN where that run had but one clock.
    """
    anchor, counted, h, before, ahead = (found[field.name][0] for field in LANE_END.fields)
    if plan.embedded is None:
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
    """stop : where the step ends at the latest, s.   active : 0 where nothing is to be tried.

    A fixed step that ends there of itself is none that has been cut: steps are counted on.
    """
    left = stop - clock.t
    lands = clock.h * (1.0 + NEARLY) >= left
    if plan.embedded is None:
        reached = clock.anchor + clock.h * (clock.counted + 1.0)
        end = where(lands, stop, reached)
        is_whole = absolute(left - clock.h) <= rounding_at(absolute(stop) + clock.h)
        lands = lands & ~is_whole
        h = where(lands, left, clock.h)
    else:  # no sliver is left for the last one
        half = clock.t + 0.5 * left
        ahead = where(clock.h > 0.5 * left, half, clock.t + clock.h)
        end = where(lands, stop, ahead)
        h = end - clock.t
    going = active > 0.5
    return Trial(
        clock.t, where(going, h, 0.0), where(going, end, clock.t), where(lands, 1.0, 0.0 * left)
    )


def judged(
    plan: AnyPlan,
    clock: LaneClock,
    trial: Trial,
    fine: Any,
    singular: Any,
    square: Any,
    longest: Any,
    limits: Tolerances,
    active: Any,
) -> Verdict:
    """fine : a mask, of what is finite and no singular configuration.   square : of the error.
    longest : step that elements allow, s, by the velocity at its end; None for any.
    singular : 1 where a step that cannot be shortened ends as such.
    """
    going = active > 0.5
    worse = where(singular > 0.5, float(SINGULAR), float(NON_FINITE))
    raised = going & ~going
    if plan.calls_functions:
        raised = going & (calls.marks(clock.t) > calls.SILENT)
    steps = clock.steps
    if plan.embedded is None:
        moves = trial.end > trial.start
        accepted = going & fine & moves & ~raised
        failed = where(going & ~accepted, where(moves, worse, float(DT_MIN)), float(OK))
        counted = clock._replace(steps=where(accepted, steps + 1.0, steps))
        cut = accepted & (trial.lands > 0.5)
        moved = counted._replace(
            t=where(accepted, trial.end, clock.t),
            anchor=where(cut, trial.end, clock.anchor),
            counted=where(cut, 0.0, where(accepted, clock.counted + 1.0, clock.counted)),
        )
        return Verdict(
            where(accepted, 1.0, 0.0 * steps), where(raised, float(RAISED), failed), moved
        )
    meets = fine & (square <= 1.0) & (trial.end > trial.start)  # false for NaN
    if longest is not None:
        meets = meets & (trial.h <= PASSED * longest)
    accepted = going & meets & ~raised
    by = change(plan, where(fine & (square == square), square, INF), clock.before, meets)
    grown = trial.h * by.factor
    if longest is not None:
        grown = where(meets, grown, minimum(grown, longest))
    # A step that was cut short says little about a long one.
    longer = where(trial.h < 0.5 * clock.h, maximum(grown, clock.h), grown)
    taken = clock._replace(
        t=trial.end, h=within(longer, limits), before=by.level, steps=steps + 1.0
    )

    def some_refused() -> tuple[Any, Any, LaneClock]:
        refused = going & ~meets & ~raised
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
    found: tuple[Any, Any, LaneClock] = branch(
        all_lanes(accepted), lambda: (zero + 1.0, zero + float(OK), taken), some_refused
    )
    return Verdict(*found)


def to_tidy(clock: LaneClock, fresh: Any, fate: Any) -> Any:
    """Where rounding is to be taken off: every so many steps, those before a break included."""
    counted = clock.steps + clock.ahead
    turns = is_multiple(counted, float(TIDY_EVERY))
    return (fresh > 0.5) & (fate == 0.0) & turns & (counted > 0.0)


def to_measure(clock: LaneClock, span: Span, fresh: Any, fate: Any) -> Any:
    """Where a trajectory is measured: every so many steps, and at its end."""
    return (fresh > 0.5) & (is_multiple(clock.steps, span.every) | (fate > 0.0))


def is_multiple(count: Any, every: Any) -> Any:
    """Of whole numbers. The quotient need but be near the whole one, and lanes share 1 / every."""
    return count == every * rint(count * (1.0 / every))


def fate_of(
    clock: LaneClock, span: Span, limits: Tolerances, status: Any, fresh: Any, fate: Any
) -> Any:
    """0 where a trajectory goes on; elsewhere its status and 1."""
    fresh = (fresh > 0.5) & (fate == 0.0)
    many = clock.steps + clock.rejected >= limits.max_steps
    found = where(many, float(MAX_STEPS + 1), ZERO)
    found = where(clock.t >= span.end, float(OK + 1), found)
    found = where(status > 0.0, status + 1.0, found)
    return where(fresh, found, fate)
