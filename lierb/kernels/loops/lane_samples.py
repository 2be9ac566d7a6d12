"""Samples of observables within adaptive steps, which may be long.

Parts of a step, of the length of those in which events are searched, are sampled at the nodes of
Gauss–Lobatto quadrature, for means and extremes. Where the quartic through the samples has a new
extreme, successive parabolas locate it.
"""

from __future__ import annotations

from math import sqrt
from typing import Any

from lierb.compiler.loops import histories_at, numbers_at, part_of_loop
from lierb.kernels.loops import lane_between as inner
from lierb.kernels.loops import workspace as ws
from lierb.kernels.loops.lane_between import Part
from lierb.kernels.loops.lane_state import Lanes, any_of, put_row, row_of
from lierb.kernels.loops.lane_steps import interval_of
from lierb.kernels.loops.states_in_memory import exchange
from lierb.kernels.mechanics.passive_elements import UserObservable
from lierb.kernels.numbers.arithmetic import (
    absolute,
    any_lanes,
    branch,
    load,
    maximum,
    minimum,
    store,
    where,
)
from lierb.kernels.numbers.dual import values
from lierb.kernels.numbers.vec import Vec
from lierb.kernels.stepping.lane_clock import Trial
from lierb.kernels.systems.combine import NAN
from lierb.kernels.systems.derivatives import completed, on_values
from lierb.kernels.systems.extra_states import with_signals
from lierb.kernels.systems.observables import Kept, with_value
from lierb.kernels.systems.plan import AnyPlan
from lierb.kernels.systems.state import OK, State
from lierb.kernels.systems.system_of import system_of
from lierb.kernels.tracing.trace import kernel

MOST_PARTS = 4096  # largest number of parts of a step, which observables do not bound
INNER = sqrt(3.0 / 7.0)
NODES = (-1.0, -INNER, 0.0, INNER, 1.0)  # of Gauss–Lobatto quadrature
WEIGHTS = (1 / 20, 49 / 180, 16 / 45, 49 / 180, 1 / 20)
LAST = len(NODES) - 1
# Rows of an observable's samples: those at the nodes, one at an extreme, the extremes so far; place
# and value at the three points of a bracket, and the range of the samples.
AT_EXTREME, LEAST, LARGEST, BRACKET = range(len(NODES), len(NODES) + 4)
ROWS = BRACKET + 7
NEWTON_STEPS, LONGEST = 6, 0.3  # of the search for the quartic's extreme, and its longest step
OVERSHOOT = 0.4  # of a quartic beyond its values at the nodes, relative to their range: at most
GAIN = 1e-9  # least gain for which an extreme is evaluated, relative to the range of the samples
MOST_TRIES = 20  # evaluations at an extreme


@part_of_loop
def take_samples(plan, body, ranked, state, moved, slopes, trial, accepted, lanes, own):
    """Sample all observables within a step; return the lanes with their statistics.

    In each part, turn 0 takes the known value at its start, the next ones those at the nodes; then
    each observable has two turns, for its least and its largest value.

    body, ranked : with the signals, then with the rank, at the start of the step.   lanes : at its
    end, which may be an event.
    """
    samples, rows = histories_at(own.samples), numbers_at(own.rows)
    part, turn, tries = stretches(plan, body, state, moved, trial, accepted), 0, 0
    while True:
        if turn == 0:
            lanes = begun(plan, lanes, trial, part, samples)
        elif turn <= LAST:
            put_row(plan, rows, ws.THETA, node(part, NODES[turn]))
            put_row(plan, rows, ws.SELECTED, part.open)
        else:
            extreme = turn - LAST - 1
            if extreme == 2 * samples.shape[1]:
                part, turn = next_stretch(part), 0
                if not any_of(part.open):
                    break
                continue
            sign = 1.0 if extreme % 2 else -1.0
            if tries == 0:
                known = LARGEST if extreme % 2 else LEAST
                put_extreme(plan, samples, extreme // 2, sign, known, rows, part)
            else:
                halves = 1.0 if tries % 3 == 0 else 0.0
                put_narrower(plan, samples, extreme // 2, sign, halves, rows, part)
            tries += 1
            if tries > MOST_TRIES or not any_of(row_of(plan, rows, ws.SELECTED)):
                turn, tries = turn + 1, 0
                continue
        if turn > 0:
            theta = in_trial(plan, rows, lanes, trial, part)
            there = inner.state_between(plan, ranked, state, slopes, trial, theta)
            row = min(turn, AT_EXTREME)
            weight = WEIGHTS[turn] if turn <= LAST else 0.0
            is_last = 1.0 if turn == LAST else 0.0
            exchange(plan, body)
            lanes = sampled(
                plan, ranked, there, rows, lanes, trial, theta, part, samples, row, weight, is_last
            )
            exchange(plan, body)
        if turn <= LAST:
            turn += 1
    return lanes


def takes_samples(plan: AnyPlan, accepted: Any) -> Any:
    """Return whether a step of any lane is sampled."""
    return any_lanes((accepted > 0.5) if plan.samples else (accepted < accepted))


@on_values
def stretches(
    plan: AnyPlan, body: Any, state: State, moved: State, trial: Trial, accepted: Any
) -> Part:
    """Return the first part of a step, which is open in every accepted step."""
    watched = UserObservable if plan.samples else None
    return inner.first_part(plan, body, state, moved, trial, accepted, watched, MOST_PARTS)


def node(part: Part, at: Any) -> Any:
    """Return θ of a point of the part.   at : the point, from −1 to 1."""
    return 0.5 + 0.5 * at + 0.0 * part.open


def in_trial(plan: AnyPlan, rows: Any, lanes: Lanes, trial: Trial, part: Part) -> Any:
    """Return θ of the step for the row THETA of a part; the step ends at the lanes' time."""
    length = where(trial.h > 0.0, trial.h, 1.0)
    lasted = (lanes.clock.t - trial.start) / length
    return inner.in_step(part, row_of(plan, rows, ws.THETA)) * lasted


def next_stretch(part: Part) -> Part:
    """Return the next part, open where it exists."""
    return inner.next_part(part, 0.0 * part.open)


def _stretch(lanes: Lanes, trial: Trial, part: Part) -> Any:
    """Return the length of a part, s."""
    return (lanes.clock.t - trial.start) / part.count


def begun(plan: AnyPlan, lanes: Lanes, trial: Trial, part: Part, samples: Any) -> Lanes:
    """Return the lanes with the weight of the start of a part, whose sample is known."""
    if not plan.samples:
        return lanes
    share, is_open = WEIGHTS[0] * _stretch(lanes, trial, part), part.open > 0.5
    observed = []
    for i, old in enumerate(lanes.record.observed):
        new = with_value(old, old.last, share, is_open)
        for row, number in ((0, old.last), (LEAST, old.least), (LARGEST, old.largest)):
            store(samples, (row, i, 0), values(number), plan.lanes)
        observed.append(where(is_open, new, old))
    return lanes._replace(record=lanes.record._replace(observed=tuple(observed)))


def sampled(
    plan: AnyPlan, body: Any, there: State, rows: Any, lanes: Lanes, trial: Trial, theta: Any,
    part: Part, samples: Any, row: Any, weight: Any, is_last: Any,
) -> Lanes:  # fmt: skip
    """Return the selected lanes with a sample of each observable in their statistics.

    there : the state at θ.   row : of the samples.   weight : in means, 0 at an extreme.
    is_last : 1 at the end of the part.
    """
    if not plan.samples:
        return lanes
    record, at, system = lanes.record, interval_of(plan, trial), system_of(plan)
    time = at.time + theta * at.span  # inside the step, where functions may jump at its ends
    body = with_signals(plan, body, there, lanes.control)
    seen = system.observed(body, system.motion(body, there, time), time)
    share, selected = weight * _stretch(lanes, trial, part), row_of(plan, rows, ws.SELECTED) > 0.5
    observed, alive = [], record.status == OK
    pairs = zip(record.observed, completed(plan, seen), strict=True)
    for i, (old, value) in enumerate(pairs):
        known = where(alive, value, NAN)
        store(samples, (row, i, 0), values(known), plan.lanes)
        new = with_value(old, known, share, alive)
        total, lost = where(weight > 0.0, (new.total, new.lost), (old.total, old.lost))
        last = where(is_last > 0.5, new.last, old.last)
        observed.append(where(selected, Kept(new.least, new.largest, total, lost, last), old))
    return lanes._replace(record=record._replace(observed=tuple(observed)))


def put_extreme(
    plan: AnyPlan, samples: Any, observable: Any, sign: Any, known: Any, rows: Any, part: Part
) -> None:
    """Store θ of the quartic's extreme, and select the lanes in which it is a new one.

    Store the samples that bracket it.

    sign : 1 for the largest value, −1 for the least.   known : row of the extreme so far.
    """
    if not plan.samples:
        return
    y = [sign * load(samples, (k, observable, 0), plan.lanes) for k in range(len(NODES))]
    known = sign * load(samples, (known, observable, 0), plan.lanes)
    points, least = [*zip(NODES, y, strict=True)], y[0]
    low, mid, high = points[0], points[0], points[1]
    for before, here, after in zip(points, points[1:], (*points[2:], points[-1]), strict=False):
        is_higher = here[1] > mid[1]
        low, mid, high = where(is_higher, (before, here, after), (low, mid, high))
        least = minimum(least, here[1])
    extent = mid[1] - least
    is_near = (mid[1] + OVERSHOOT * extent > known) & (part.open > 0.5)
    at, value = branch(
        any_lanes(is_near), lambda: _highest(_quartic(y), mid[0]), lambda: (mid[0], known)
    )
    is_new = is_near & (value > maximum(known, mid[1]) + GAIN * extent) & (absolute(at) < 1.0)
    is_new = is_new & (low[0] < at) & (at < high[0])
    _put_bracket(plan, samples, observable, (*low, *mid, *high, extent))
    _put_next(plan, rows, part, at, is_new)


def put_narrower(
    plan: AnyPlan, samples: Any, observable: Any, sign: Any, halves: Any, rows: Any, part: Part
) -> None:
    """Narrow the bracket by the sample at θ; store the next θ, and select lanes that need it.

    The next θ is that of the parabola through the bracket.

    halves : 1 for the middle of the bracket's larger half instead; one end might never move
        otherwise.
    """
    if not plan.samples:
        return
    numbers = tuple(load(samples, (r, observable, 0), plan.lanes) for r in range(BRACKET, ROWS))
    low, mid, high, extent = numbers[:2], numbers[2:4], numbers[4:6], numbers[6]
    selected = row_of(plan, rows, ws.SELECTED) > 0.5
    at = 2.0 * row_of(plan, rows, ws.THETA) - 1.0
    seen = at, sign * load(samples, (AT_EXTREME, observable, 0), plan.lanes)
    is_higher = seen[1] > mid[1]
    beside = where(is_higher, mid, seen)
    mid = where(is_higher, seen, mid)
    low = where(beside[0] < mid[0], beside, low)
    high = where(beside[0] > mid[0], beside, high)
    before, after = low[0] - mid[0], high[0] - mid[0]
    falls, rises = (low[1] - mid[1]) / before, (high[1] - mid[1]) / after
    bend = (rises - falls) / (after - before)
    slope = falls - bend * before
    gain = -0.25 * slope * slope / bend
    larger = where(-before > after, before, after)
    at = mid[0] + where(halves > 0.5, 0.5 * larger, -0.5 * slope / bend)
    goes_on = selected & (bend < 0.0) & (gain > GAIN * extent)
    goes_on = goes_on & (low[0] < at) & (at < high[0]) & ((at < mid[0]) | (at > mid[0]))
    _put_bracket(plan, samples, observable, (*low, *mid, *high, extent))
    _put_next(plan, rows, part, at, goes_on)


def _put_bracket(plan: AnyPlan, samples: Any, observable: Any, numbers: Vec) -> None:
    for row, number in enumerate(numbers, BRACKET):
        store(samples, (row, observable, 0), number, plan.lanes)


def _put_next(plan: AnyPlan, rows: Any, part: Part, at: Any, selected: Any) -> None:
    put_row(plan, rows, ws.SELECTED, where(selected, 1.0, 0.0 * part.open))
    put_row(plan, rows, ws.THETA, where(selected, node(part, at), 0.5))


def _highest(p: tuple[Any, ...], at: Any) -> tuple[Any, Any]:
    """Return the place of a polynomial's largest value from −1 to 1, near `at`, and the value."""
    for _ in range(NEWTON_STEPS):
        slope = p[1] + at * (2.0 * p[2] + at * (3.0 * p[3] + at * (4.0 * p[4])))
        bend = 2.0 * p[2] + at * (6.0 * p[3] + at * (12.0 * p[4]))
        step = where(bend < 0.0, -slope / where(bend < 0.0, bend, 1.0), slope * float("inf"))
        step = maximum(minimum(step, LONGEST), -LONGEST)
        at = maximum(minimum(at + step, 1.0), -1.0)
    return at, p[0] + at * (p[1] + at * (p[2] + at * (p[3] + at * p[4])))


def _quartic(y: list[Any]) -> tuple[Any, ...]:
    """Return the coefficients of the polynomial through the samples at the nodes."""
    s = INNER
    even, even_inner = 0.5 * (y[4] + y[0]) - y[2], (0.5 * (y[3] + y[1]) - y[2]) / (s * s)
    odd, odd_inner = 0.5 * (y[4] - y[0]), 0.5 * (y[3] - y[1]) / s
    fourth, third = (even - even_inner) / (1.0 - s * s), (odd - odd_inner) / (1.0 - s * s)
    return y[2], odd - third, even - fourth, third, fourth


for _formula in (
    takes_samples, stretches, node, in_trial, next_stretch, begun, sampled, put_extreme,
    put_narrower,
):  # fmt: skip
    kernel(_formula)
