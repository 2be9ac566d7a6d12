"""State of a thread's lanes, each with its own clock: load, start, store."""

from __future__ import annotations

from itertools import islice
from typing import Any, NamedTuple

from lierb.kernels.loops.ends import end_rows, lane_row, resumed_lane, resumed_record
from lierb.kernels.loops.record import (
    Record,
    carried_columns,
    initial_record,
    initial_state,
    load_carried,
    load_placed,
    store_carried,
    with_all_parts,
)
from lierb.kernels.loops.tables import user_state
from lierb.kernels.loops.ticks import first_control
from lierb.kernels.loops.workspace import DUE, NOISE_INDEX
from lierb.kernels.numbers.arithmetic import any_lanes, flatten, load, store, where
from lierb.kernels.numbers.dual import values
from lierb.kernels.stepping.lane_clock import LaneClock, Span, continued, first_clock
from lierb.kernels.stepping.step_size import Tolerances
from lierb.kernels.systems.combine import NAN
from lierb.kernels.systems.derivatives import completed, on_values, parts_side_by_side, with_parts
from lierb.kernels.systems.extra_states import Control, with_initial_states, with_signals
from lierb.kernels.systems.layout import LANE_END
from lierb.kernels.systems.plan import AnyPlan
from lierb.kernels.systems.state import OK, State
from lierb.kernels.systems.system_of import in_memory, system_of
from lierb.kernels.tracing import calls
from lierb.kernels.tracing.trace import kernel


class Lanes(NamedTuple):
    """State of all lanes: system, record, clock and controllers."""

    state: State
    record: Record
    clock: LaneClock
    control: Control


def any_of(numbers: Any) -> Any:
    """Return whether any lane's number is above 0."""
    return any_lanes(numbers > 0.0)


def select(mask: Any, new: Any, old: Any) -> Any:
    """Return `new` where the mask, 1 or 0, is 1, and `old` elsewhere."""
    return where(mask > 0.5, new, old)


def row_of(plan: AnyPlan, rows: Any, row: Any) -> Any:
    return load(rows, (row, 0), plan.lanes)


def put_row(plan: AnyPlan, rows: Any, row: Any, numbers: Any) -> None:
    store(rows, (row, 0), numbers, plan.lanes)


def put_rows(plan: AnyPlan, rows: Any, first: int, numbers: Any) -> None:
    """Store numbers in successive rows."""
    for row, number in enumerate(flatten(numbers), first):
        put_row(plan, rows, row, number)


def load_lanes(plan: AnyPlan, body: Any, carried: Any) -> Lanes:
    state, record = load_carried(plan, body, carried, 0)
    columns = carried_columns(plan)
    clock, *control, parts = (
        [row_of(plan, carried, row) for row in range(columns[name].start, columns[name].stop)]
        for name in ("clock", *Control._fields, "control_parts")
    )
    rest = iter(with_parts(plan, [x for numbers in control for x in numbers], parts))
    controls, memory, ticks = (tuple(islice(rest, len(numbers))) for numbers in control)
    return Lanes(state, record, LaneClock(*clock), Control(controls, memory, values(ticks)))


def store_lanes(plan: AnyPlan, body: Any, carried: Any, lanes: Lanes) -> None:
    store_carried(plan, body, carried, 0, lanes.state, lanes.record)
    columns, control = carried_columns(plan), lanes.control
    put_rows(plan, carried, columns["clock"].start, (lanes.clock, values(control)))
    if plan.moving:
        parts = tuple(parts_side_by_side(control, plan.directions))
        put_rows(plan, carried, columns["control_parts"].start, parts)


# ---- exception flags of functions that are called body by body ----


def suppress_exceptions(plan: AnyPlan, mask: Any) -> Any:
    """From now on, call functions only where the mask is 1. Return the flags so far.

    Speculatively computed lanes must not raise.
    """
    if not plan.calls_functions:
        return mask
    before = calls.exception_flags(mask)
    calls.set_exception_flags(where(mask > 0.5, before, float(calls.SUPPRESSED)))
    return before


def clear_exceptions(plan: AnyPlan, fresh: Any) -> Any:
    """Clear the flags of starting trajectories, suppress others. Return the flags so far."""
    if not plan.calls_functions:
        return fresh
    before = calls.exception_flags(fresh)
    calls.set_exception_flags(where(fresh > 0.5, float(calls.CLEAR), float(calls.SUPPRESSED)))
    return before


def restore_exceptions(plan: AnyPlan, before: Any, mask: Any) -> None:
    """Restore the flags where the mask is not 1."""
    if plan.calls_functions:
        calls.set_exception_flags(where(mask > 0.5, calls.exception_flags(mask), before))


# ---- start of a trajectory ----


def own_start(plan: AnyPlan, body: Any, inputs: Any, rows: Any) -> State:
    """Return the initial state, with initial values of the extra states."""
    placed = load_placed(plan, body, inputs)
    state, zero = initial_state(plan, body, placed, inputs), 0.0 * row_of(plan, rows, NOISE_INDEX)
    return with_all_parts(plan, with_initial_states(system_of(plan), body, state, zero))


def started(
    plan: AnyPlan, body: Any, state: State, rows: Any, span: Span, limits: Tolerances
) -> Lanes:
    """Return the lanes before the first tick."""
    due = row_of(plan, rows, DUE)
    zero = 0.0 * row_of(plan, rows, NOISE_INDEX)
    control = first_control(plan, body, span.start, zero)
    control = completed(plan, control)._replace(ticks=control.ticks)
    whole, body, state = state, values(body), values(state)
    body = with_signals(plan, body, state, values(control))
    clock = first_clock(plan, body, state, span, limits, zero)._replace(due=due)
    return Lanes(whole, initial_record(plan, body, state), clock, control)


def resumed(plan: AnyPlan, body: Any, lanes: Lanes, limits: Tolerances, inputs: Any) -> Lanes:
    """Return the lanes with the final clock and controllers of the run before."""
    before = resumed_lane(plan, body, inputs)
    control = (
        tuple(where(y == y, y, x) for x, y in zip(mine, before[name], strict=True))
        for name, mine in lanes.control._asdict().items()
    )
    clock = continued(plan, lanes.clock, limits, before)
    record = resumed_record(plan, body, inputs, lanes.record)
    return lanes._replace(record=record, clock=clock, control=Control(*control))


# ---- results ----


def put_shown(
    plan: AnyPlan, body: Any, inputs: Any, state: State, lanes: Lanes, shown: Any
) -> None:
    """Store the quantities of a state that tables show."""
    if plan.is_looped:
        first = in_memory(plan).put_links(body, shown, lanes.record.status == OK)
        for i, number in enumerate(values((*state.states, *lanes.control.controls))):
            put_row(plan, shown, first + i, number)
        return
    links = user_state(plan, body, inputs, state, lanes.record)
    put_rows(plan, shown, 0, (*links, *values((state.states, lanes.control.controls))))


@on_values
def store_lane_summary(plan: AnyPlan, lanes: Lanes, summary: Any, column: Any) -> None:
    """Store LANE_SUMMARY, extra states and controls, beginning at a column."""
    clock = lanes.clock
    numbers = (clock.t, clock.steps, clock.rejected, clock.h)
    alive = lanes.record.status == OK
    signals = (where(alive, x, NAN) for x in (*lanes.state.states, *lanes.control.controls))
    for i, number in enumerate((*numbers, *signals)):
        put_row(plan, summary, column + i, number)


def store_lane_end(plan: AnyPlan, body: Any, lanes: Lanes, ends: Any) -> None:
    """Store clock and controllers behind the state and the rank, for a run that continues."""
    clock = lanes.clock._replace(ahead=lanes.clock.ahead + lanes.clock.steps)
    own = tuple(getattr(clock, field.name) for field in LANE_END.fields)
    first = lane_row(plan, body) + int(plan.keeps_rank)
    for row, number in end_rows(plan, body, first, flatten((own, lanes.control))):
        put_row(plan, ends, row, number)


def as_ended(lanes: Lanes, span: Span, termination: Any) -> Record:
    """Return the record of terminated trajectories.

    It has the status from the termination code, and means over the time that they lasted.
    """
    record, lasted = lanes.record, lanes.clock.t - span.start
    lasted = where(lasted > 0.0, lasted, 1.0)
    observed = (each._replace(total=each.total / lasted) for each in record.observed)
    status = where(termination > 0.5, termination - 1.0, 0.0)
    status = where(record.status > 0.5, record.status, status)
    return record._replace(observed=tuple(observed), status=status)


for _formula in (
    any_of, select, row_of, put_row, load_lanes, store_lanes, suppress_exceptions, clear_exceptions,
    restore_exceptions, own_start, started, resumed, put_shown, store_lane_summary, store_lane_end,
    as_ended, with_signals,
):  # fmt: skip
    kernel(_formula)
