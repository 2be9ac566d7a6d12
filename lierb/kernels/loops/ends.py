"""End of a run: the state from which another run continues, and its derivatives."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

from lierb.kernels.loops.record import Record, load_columns, with_all_parts
from lierb.kernels.numbers.arithmetic import (
    flatten,
    load,
    scatter,
    where,
)
from lierb.kernels.numbers.zero import is_zero
from lierb.kernels.systems.derivatives import (
    on_values,
    parts_side_by_side,
    seeds_of_state,
    with_parts,
)
from lierb.kernels.systems.plan import AnyPlan
from lierb.kernels.systems.signals import lane_end
from lierb.kernels.systems.state import State
from lierb.kernels.systems.system_of import in_memory, system_of
from lierb.kernels.tracing.trace import kernel


def resumed_state(plan: AnyPlan, body: Any, inputs: Any) -> State:
    """Load the state that a run continues from."""
    if plan.is_looped:
        return in_memory(plan).resumed(body, inputs)
    at = system_of(plan).inputs["state"]
    numbers: Any = load_columns(plan, inputs, range(at.start, at.stop), 0)
    seeds = seeds_of_state(plan, system_of(plan).inputs)
    if seeds:
        numbers = with_parts(plan, numbers, load_columns(plan, inputs, seeds, 0))
    state: State = system_of(plan).state_of(numbers, body)
    return with_all_parts(plan, state)


def resumed_record(plan: AnyPlan, body: Any, inputs: Any, record: Record) -> Record:
    """Return the record with the rank of the run that is continued, unless its rows differ."""
    if not plan.keeps_rank:
        return record
    dropped = load(inputs, (lane_input(plan, body), 0), plan.lanes)
    return record._replace(dropped=where(dropped == dropped, dropped, record.dropped))


def lane_input(plan: AnyPlan, body: Any) -> Any:
    """Return the first column of `lane_end` in the inputs."""
    if plan.is_looped:
        return in_memory(plan).lane_column(body)
    return system_of(plan).inputs["lane"].start


def store_end(
    plan: AnyPlan, body: Any, state: State, record: Record, ends: Any, column: Any
) -> None:
    """Store the state, and the rank at the start, for a run that continues; then derivatives."""
    _store_end_values(plan, body, state, record, ends, column)
    if end_parts(plan):
        numbers = flatten(state)
        parts = parts_side_by_side(tuple(numbers[c] for c in state_columns(plan)), plan.directions)
        first = len(end_columns(plan))
        scatter(ends, 1, [(first + c, column) for c in range(len(parts))], parts, plan.lanes)


@on_values
def _store_end_values(
    plan: AnyPlan, body: Any, state: State, record: Record, ends: Any, column: Any
) -> None:
    first: Any = 0
    going_on: list[Any] = []
    if plan.is_looped:
        in_memory(plan).store_end(body, state, ends, column)
        first = in_memory(plan).end_columns(body)
    else:
        numbers = [*flatten(state)]
        going_on = [numbers[c] for c in state_columns(plan)]
    if plan.keeps_rank:
        going_on.append(record.dropped)
    if not going_on:
        return
    places = [(first + c, column) for c in range(len(going_on))]
    scatter(ends, 1, places, going_on, plan.lanes)


@lru_cache(64)
def end_columns(plan: AnyPlan) -> tuple[int, ...]:
    """Return the columns of a state to continue from that are stored at the end of a run.

    They are `state_columns`, then `lane_end`.
    """
    first = system_of(plan).state.count
    return (*state_columns(plan), *range(first, first + lane_end(plan).count))


def end_parts(plan: AnyPlan) -> int:
    """Return the number of derivatives of a state that are stored at the end of a run."""
    in_loop = plan.is_looped or plan.is_in_memory
    return 0 if in_loop else plan.directions * len(state_columns(plan))


@lru_cache(64)
def state_columns(plan: AnyPlan) -> tuple[int, ...]:
    """Return the indices of a state's numbers that are stored at the end of a run.

    W is not stored, since it is counted from the start of a run.
    """
    columns = system_of(plan).state
    numbers = flatten(system_of(plan).state_of((1.0,) * columns.count))
    work = columns.index("work")
    return tuple(c for c, number in enumerate(numbers) if c != work and not is_zero(number))


for _formula in (resumed_state, resumed_record, store_end):
    kernel(_formula)
