"""End of a run: the state from which another run continues, and its derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

from lierb.kernels.loops.record import Record, load_columns, with_all_parts
from lierb.kernels.numbers.arithmetic import flatten, scatter, where
from lierb.kernels.numbers.dual import value_of, values
from lierb.kernels.numbers.zero import is_zero
from lierb.kernels.systems.derivatives import parts_side_by_side, seeds_of_end, with_parts
from lierb.kernels.systems.plan import AnyPlan
from lierb.kernels.systems.signals import HELD, lane_end
from lierb.kernels.systems.state import State
from lierb.kernels.systems.system_of import in_memory, system_of
from lierb.kernels.tracing.trace import kernel


def resumed_state(plan: AnyPlan, body: Any, inputs: Any) -> State:
    """Load the state that a run continues from."""
    if plan.is_looped:
        state: State = in_memory(plan).resumed(body, inputs)
    else:
        state = system_of(plan).state_of(_continued(plan, inputs, "state"), body)
    return with_all_parts(plan, state)


def resumed_lane(plan: AnyPlan, body: Any, inputs: Any) -> dict[str, tuple[Any, ...]]:
    """Load `lane_end` of the run that is continued, by field; those of HELD have derivatives."""
    columns = lane_end(plan)
    if plan.is_looped:
        numbers: Sequence[Any] = in_memory(plan).resumed_lane(body, inputs, columns.count)
    else:
        numbers = _continued(plan, inputs, "lane")
    return {name: x if name in HELD else values(x) for name, x in columns.parts(numbers).items()}


def _continued(plan: AnyPlan, inputs: Any, name: str) -> Sequence[Any]:
    """Load one of END from the inputs, with its derivatives if it moves."""
    columns = system_of(plan).inputs
    own, seeds = columns[name], seeds_of_end(plan, columns, name)
    numbers = load_columns(plan, inputs, range(own.start, own.stop), 0)
    return with_parts(plan, numbers, load_columns(plan, inputs, seeds, 0)) if seeds else numbers


def resumed_record(plan: AnyPlan, body: Any, inputs: Any, record: Record) -> Record:
    """Return the record with the rank of the run that is continued, unless its rows differ."""
    if not plan.keeps_rank:
        return record
    (dropped,) = resumed_lane(plan, body, inputs)["dropped"]
    return record._replace(dropped=where(dropped == dropped, dropped, record.dropped))


def store_end(
    plan: AnyPlan, body: Any, state: State, record: Record, ends: Any, column: Any
) -> None:
    """Store the state, and the rank at the start, for a run that continues; then derivatives."""

    def put(first: Any, numbers: Sequence[Any]) -> None:
        if numbers:
            rows = end_rows(plan, body, first, numbers)
            places = [(row, column) for row, _ in rows]
            scatter(ends, 1, places, [number for _, number in rows], plan.lanes)

    rank = (record.dropped,) * plan.keeps_rank
    if plan.is_looped:
        in_memory(plan).store_end(body, state, put)
        put(lane_row(plan, body), rank)
    else:
        numbers = flatten(state)
        put(0, (*(numbers[c] for c in state_columns(plan)), *rank))


def end_rows(plan: AnyPlan, body: Any, first: Any, numbers: Sequence[Any]) -> list[tuple[Any, Any]]:
    """Return the rows of an end's numbers with these; then, behind all, their derivatives.

    first : row of the first number, and index in `end_columns`.
    """
    if not plan.moving:
        return [(first + c, number) for c, number in enumerate(numbers)]
    behind = lane_row(plan, body) + lane_end(plan).count + first * plan.directions
    parts = parts_side_by_side(tuple(numbers), plan.directions)
    rows = [(first + c, value_of(number)) for c, number in enumerate(numbers)]
    return rows + [(behind + c, part) for c, part in enumerate(parts)]


def lane_row(plan: AnyPlan, body: Any) -> Any:
    """Return the first row of `lane_end` at an end, behind the state."""
    return in_memory(plan).end_columns(body) if plan.is_looped else len(state_columns(plan))


@lru_cache(64)
def end_columns(plan: AnyPlan) -> tuple[int, ...]:
    """Return the columns of a state to continue from that are stored at the end of a run.

    They are `state_columns`, then `lane_end`.
    """
    first = system_of(plan).state.count
    return (*state_columns(plan), *range(first, first + lane_end(plan).count))


def end_parts(plan: AnyPlan) -> int:
    """Return the number of derivatives that are stored at the end of a run."""
    return plan.directions * len(end_columns(plan))


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
