"""Dense output within a step, for rows of histories and for events."""

from __future__ import annotations

from typing import Any, NamedTuple

from lierb.kernels.loops import workspace as ws
from lierb.kernels.loops.lane_state import Lanes, put_row, put_rows, row_of
from lierb.kernels.loops.lane_steps import Made, interval_of
from lierb.kernels.loops.record import (
    Record,
    observe,
    with_all_parts,
    with_rank,
    without_measures,
)
from lierb.kernels.mechanics.passive_elements import UserEvent
from lierb.kernels.numbers.arithmetic import absolute, all_lanes, any_lanes, load, store, where
from lierb.kernels.numbers.dual import values
from lierb.kernels.stepping.lane_clock import LaneClock, Trial, rounding_at
from lierb.kernels.stepping.method_of import method_of
from lierb.kernels.stepping.travel import MOST_PARTS, parts_to_watch
from lierb.kernels.systems.derivatives import on_values
from lierb.kernels.systems.extra_states import Control, with_signals
from lierb.kernels.systems.plan import AnyPlan
from lierb.kernels.systems.signals import events_of
from lierb.kernels.systems.state import EVENT, State
from lierb.kernels.systems.system_of import system_of
from lierb.kernels.tracing.trace import kernel


def slopes_between(plan: AnyPlan, body: Any, state: State, made: Made, trial: Trial) -> Any:
    """Return the slopes of the continuous extension."""
    if not plan.is_continuous:
        return ()
    at = interval_of(plan, trial)
    return method_of(plan).extended(system_of(plan), body, state, at, made.slopes)


def state_between(
    plan: AnyPlan, body: Any, state: State, slopes: Any, trial: Trial, theta: Any
) -> State:
    """Return the state at θ of a step."""
    if not plan.interpolates:
        return state  # never
    at = interval_of(plan, trial)
    between = method_of(plan).between(system_of(plan), body, state, at, slopes, theta)
    return with_all_parts(plan, between)


def time_between(trial: Trial, theta: Any) -> Any:
    return trial.start + theta * trial.h


# ---- rows of the history ----


def _is_due_before(clock: LaneClock, accepted: Any) -> Any:
    """True where a row is due before the end of an accepted step.

    A row due at the end is saved after a tick.
    """
    return (accepted > 0.5) & (clock.t - clock.due > rounding_at(clock.t))


def is_due_between(plan: AnyPlan, lanes: Lanes, accepted: Any) -> Any:
    """Return whether a row of some history is due before the end of an accepted step.

    lanes : at that end.
    """
    if not plan.interpolates:
        return all_lanes(lanes.clock.t < lanes.clock.t)  # never
    return any_lanes(_is_due_before(lanes.clock, accepted))


def select_due_between(plan: AnyPlan, rows: Any, lanes: Lanes, trial: Trial, accepted: Any) -> None:
    """Select the lanes in which a row of the history is due, and set its θ."""
    clock = lanes.clock
    due = _is_due_before(clock, accepted)
    length = where(trial.h > 0.0, trial.h, 1.0)
    put_row(plan, rows, ws.SELECTED, where(due, 1.0, 0.0 * clock.t))
    put_row(plan, rows, ws.THETA, where(due, (clock.due - trial.start) / length, 0.0))


def shown_between(
    plan: AnyPlan, body: Any, state: State, lanes: Lanes
) -> tuple[tuple[Any, ...], Record]:
    """Return a row of the history at its due time, and the record."""
    clock, (body, state, record) = lanes.clock, values((body, state, lanes.record))
    shown, seen = observe(plan, body, state, record, clock.steps, clock.due)
    row = (*shown, *state.states, *values(lanes.control.controls))
    return row, without_measures(plan, lanes.record, seen)


def with_record(lanes: Lanes, record: Record) -> Lanes:
    return lanes._replace(record=record)


# ---- events ----


@on_values
def put_values(
    plan: AnyPlan, body: Any, state: State, control: Control, time: Any, values: Any, sample: Any
) -> None:
    """Store the values of all events, [sample][event][lane]."""
    if events_of(plan):
        system, body = system_of(plan), with_signals(plan, body, state, control)
        for i, value in enumerate(system.events(body, system.motion(body, state, time), time)):
            store(values, (sample, i, 0), value, plan.lanes)


@on_values
def put_roundings(
    plan: AnyPlan, body: Any, lanes: Lanes, values: Any, sample: Any, roundings: Any
) -> None:
    """Store the effect of rounding on the events' current values, which are those of `sample`."""
    if events_of(plan):
        state, time, body = lanes.state, lanes.clock.t, with_rank(plan, body, lanes.record)
        system, body = system_of(plan), with_signals(plan, body, state, lanes.control)
        nearby = system.events_nearby(body, system.motion(body, state, time), time)
        now = [load(values, (sample, i, 0), plan.lanes) for i in range(len(nearby))]
        pairs = zip(nearby, now, strict=True)
        put_rows(plan, roundings, 0, tuple(absolute(x - value) for x, value in pairs))


class Part(NamedTuple):
    """One of the equal parts of a step in which events are searched, lane by lane.

    index : of the part.   count : number of parts.   open : 1 where the part is searched.
    is_last : 1 where it is the last part of the step.
    """

    index: Any
    count: Any
    open: Any
    is_last: Any


@on_values
def parts_of(
    plan: AnyPlan, body: Any, state: State, moved: State, trial: Trial, accepted: Any
) -> Part:
    """Return the first part, which is open in every accepted step."""
    watched = UserEvent if events_of(plan) else None
    return first_part(plan, body, state, moved, trial, accepted, watched, MOST_PARTS)


def first_part(
    plan: AnyPlan, body: Any, state: State, moved: State, trial: Trial, accepted: Any,
    watched: type | None, most: int,
) -> Part:  # fmt: skip
    """Return the first of a step's parts; see `parts_to_watch`.   watched : None for no search."""
    if watched is None:
        return Part(accepted, accepted, accepted, accepted)  # never
    count = parts_to_watch(plan, body, state, moved, trial, watched, most)
    return _part(0.0 * count, count, accepted)


def next_part(part: Part, termination: Any) -> Part:
    """Return the next part, open where it exists and the trajectory has not ended."""
    is_open = (part.open > 0.5) & (part.is_last < 0.5) & (termination == 0.0)
    return _part(part.index + 1.0, part.count, where(is_open, 1.0, 0.0 * termination))


def _part(index: Any, count: Any, is_open: Any) -> Part:
    return Part(index, count, is_open, where(index + 1.0 >= count, 1.0, 0.0 * index))


def ends_step(part: Part) -> Any:
    """Return whether the part is the last one in every lane in which it is open."""
    return all_lanes((part.is_last > 0.5) | (part.open < 0.5))


def in_step(part: Part, theta: Any) -> Any:
    """Convert θ of a part to θ of the step."""
    return (part.index + theta) / part.count


def put_part(plan: AnyPlan, rows: Any, trial: Trial, part: Part) -> None:
    """Store the part as the step in which events are searched."""
    put_row(plan, rows, ws.ACCEPTED, part.open)
    put_row(plan, rows, ws.START, time_between(trial, in_step(part, 0.0)))
    put_row(plan, rows, ws.LENGTH, trial.h / part.count)


def ended_between(
    plan: AnyPlan,
    rows: Any,
    there: State,
    moved: State,
    trial: Trial,
    part: Part,
    lanes: Lanes,
    termination: Any,
) -> tuple[State, Lanes, Any]:
    """End the step at its first terminal event: return state, lanes and the termination codes.

    there : states at θ = LAST of the part.
    """
    last, clock = row_of(plan, rows, ws.LAST), lanes.clock
    ends = last <= 1.0
    state = where(ends, there, moved)
    t = where(ends, time_between(trial, in_step(part, last)), clock.t)
    clock = clock._replace(
        t=t, anchor=where(ends, t, clock.anchor), counted=where(ends, 0.0, clock.counted)
    )
    code = where(ends, float(EVENT + 1), termination)
    return state, lanes._replace(clock=clock), code


def ends_between(plan: AnyPlan, rows: Any) -> Any:
    """Return 1 where the step ends at a terminal event."""
    last = row_of(plan, rows, ws.LAST)
    return where(last <= 1.0, 1.0, 0.0 * last)


for _formula in (
    slopes_between, state_between, time_between, is_due_between, select_due_between, shown_between,
    ends_between, with_record, put_values, put_roundings, parts_of, next_part, ends_step, in_step,
    put_part, ended_between,
):  # fmt: skip
    kernel(_formula)
