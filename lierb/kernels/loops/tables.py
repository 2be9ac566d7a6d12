"""Tables of a run: rows of histories and states, summaries, and checks of starts."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from lierb.compiler.loops import histories_at, shared
from lierb.kernels.loops.record import Record, exception_flags, load_inputs, load_values, with_rank
from lierb.kernels.numbers.arithmetic import prefetch, scatter, sqrt, where
from lierb.kernels.numbers.dual import Dual, values
from lierb.kernels.numbers.vec import Vec
from lierb.kernels.systems.combine import NAN
from lierb.kernels.systems.derivatives import differentiated, in_time, on_values, parts_side_by_side
from lierb.kernels.systems.extra_states import with_states
from lierb.kernels.systems.layout import POSE_AND_TWIST
from lierb.kernels.systems.measures import KEPT, SUMMARY
from lierb.kernels.systems.observables import DIFFERENTIATED, columns_of, observables_of
from lierb.kernels.systems.plan import AnyPlan
from lierb.kernels.systems.signals import events_of, signals_width
from lierb.kernels.systems.state import OK, State
from lierb.kernels.systems.system_of import in_memory, system_of
from lierb.kernels.tracing.trace import kernel

Placed = Callable[[Any], tuple[Any, ...]]  # place of a number, by its index in a row


class Tables(NamedTuple):
    """Result arrays of a history: see `lierb.kernels.loops.job.RESULTS`."""

    history: Any
    multipliers: Any
    reactions: Any
    states: tuple[Any, Any, Any, Any]
    derivatives: Any


@shared
def tables_at(job):
    """Return the result arrays of a job record."""
    states = (
        histories_at(job.rotation),
        histories_at(job.position),
        histories_at(job.omega),
        histories_at(job.v),
    )
    return Tables(
        histories_at(job.history),
        histories_at(job.multipliers),
        histories_at(job.reactions),
        states,
        histories_at(job.derivatives),
    )


class Place(NamedTuple):
    """Position of a row in result arrays.

    row : index of the time.   rows : number of rows for each link or joint.
    column : index of the first trajectory.
    """

    row: Any
    rows: Any
    column: Any


@on_values
def store_row(
    plan: AnyPlan,
    body: Any,
    state: State,
    record: Record,
    shown: Vec,
    tables: Tables,
    at: Place,
    time: Any,
) -> None:
    """Store one row of the history's scalar columns, λ and reactions; prefetch the next row.

    Hardware does not prefetch a row so far away, and its cache misses would take as long as four
    steps.
    """
    alive = record.status == OK

    def put(array: Any, axis: int, places: list[tuple[Any, ...]], numbers: Vec) -> None:
        scatter(array, axis, places, where(alive, numbers, (NAN,) * len(numbers)), plan.lanes)

    def put_history(first: Any, numbers: Vec) -> None:
        if numbers:
            places = [(first + c, at.row, at.column) for c in range(len(numbers))]
            put(tables.history, 2, places, tuple(numbers))

    behind = signals_width(plan) * plan.has_lane_clocks if plan.is_looped else 0
    head = len(shown) - behind
    put_history(0, shown[:head])
    for c in range(head):
        prefetch(tables.history, (c, at.row + 1, at.column), plan.lanes)
    if plan.is_looped:
        place = tables.history, head, at.row, at.column
        put_history(in_memory(plan).store_errors(body, *place, alive), shown[head:])
    if not (plan.multipliers or plan.reaction):
        return
    body = with_rank(plan, body, record)
    if plan.is_looped:
        arrays = tables.multipliers, tables.reactions
        in_memory(plan).store_forces(body, *arrays, at, time, alive)
        return
    multipliers, wrenches = system_of(plan).forces(body, state, time)
    if plan.multipliers and multipliers:
        count = len(multipliers)
        put(tables.multipliers, 1, [(at.row, at.column, c) for c in range(count)], multipliers)
        prefetch(tables.multipliers, (at.row + 1, at.column, 0), plan.lanes * count)
    row = at.row
    for wrench in wrenches if plan.reaction else ():
        put(tables.reactions, 1, [(row, at.column, c) for c in range(6)], wrench)
        prefetch(tables.reactions, (row + 1, at.column, 0), plan.lanes * 6)
        row = row + at.rows


def user_state(
    plan: AnyPlan, body: Any, inputs: Any, state: State, record: Record
) -> list[tuple[Any, ...]]:
    """Return R (row by row), r, ω, v of every link, in the user's frames; NaN after a failure."""
    links = system_of(plan).in_user_frames(body, load_inputs(plan, inputs), state)
    alive = record.status == OK
    return [where(alive, values(numbers), (NAN,) * len(numbers)) for numbers in links]


def store_state(
    plan: AnyPlan, body: Any, inputs: Any, state: State, record: Record, tables: Tables, at: Place
) -> None:
    """Store one row of the states: R, r, ω and v, each [link, time][trajectory][component]."""
    if plan.is_looped:
        alive = record.status == OK
        in_memory(plan).store_links(body, tables.states, at.row, at.rows, at.column, alive)
        return
    row = at.row
    for numbers in user_state(plan, body, inputs, state, record):
        for array, part in zip(tables.states, POSE_AND_TWIST.parts(numbers).values(), strict=True):
            scatter(array, 1, [(row, at.column, c) for c in range(len(part))], part, plan.lanes)
            prefetch(array, (row + 1, at.column, 0), plan.lanes * len(part))
        row = row + at.rows


def store_derivatives(
    plan: AnyPlan, body: Any, inputs: Any, state: State, record: Record, tables: Tables, at: Place,
    time: Any,
) -> None:  # fmt: skip
    """Store one row of the derivatives of a state, [column, direction]."""
    if plan.moving:

        def placed(c: Any) -> tuple[Any, ...]:
            return at.row, at.column, c

        _store_parts(plan, body, inputs, state, record, tables.derivatives, placed, time)


def store_end_derivatives(
    plan: AnyPlan, body: Any, inputs: Any, state: State, record: Record, array: Any, column: Any,
    time: Any,
) -> None:  # fmt: skip
    """Store the derivatives at the end, [column, direction], then those in time, [column].

    Those in time are for the ends of trajectories that an event has ended.
    """
    if not plan.moving:
        return

    def placed(c: Any) -> tuple[Any, ...]:
        return c, column

    count = _store_parts(plan, body, inputs, state, record, array, placed, time)
    if events_of(plan) and plan.is_looped:
        loop, body = in_memory(plan), with_rank(plan, body, record)
        moved_body, moved = loop.moved_in_time(body, state, time)
        time = Dual(time, (1.0, *(0.0,) * (plan.directions - 1)))
        alive = record.status == OK
        loop.store_derivatives(moved_body, moved, array, placed, time, alive, in_time=True)
    elif events_of(plan):
        body, state, system = values(body), values(state), system_of(plan)
        moved, time = in_time(system, body, state, time), Dual(time, (1.0,))
        body = with_states(body, moved)
        _store_parts(plan, body, inputs, moved, record, array, placed, time, count)


def _store_parts(
    plan: AnyPlan, body: Any, inputs: Any, state: State, record: Record, array: Any,
    placed: Placed, time: Any, first: int = 0,
) -> int:  # fmt: skip
    """Store all derivatives of a state, from number `first` on; return how many.

    placed : function that returns the place of a number in the array; its second index is that of
        the first trajectory.
    """
    own, body = system_of(plan), with_rank(plan, body, record)
    if plan.is_looped:
        alive = record.status == OK
        in_memory(plan).store_derivatives(body, state, array, placed, time, alive)
        return 0
    given = load_values(plan, inputs) if first else load_inputs(plan, inputs)
    parts = tuple(differentiated(plan, own, body, given, state, time))
    parts = where(record.status == OK, parts, (NAN,) * len(parts))
    places = [placed(c) for c in range(first, first + len(parts))]
    scatter(array, 1, places, parts, plan.lanes)
    return len(parts)


def store_summary(
    plan: AnyPlan, body: Any, record: Record, summary: Any, slopes: Any, end: Any, column: Any
) -> None:
    """Store a summary: retained measures, status, and step of a failure.

    slopes : receives the derivatives of `DIFFERENTIATED` of each observable, in the rows before
        `end`.
    """
    if plan.moving and observables_of(plan):
        of_observables = tuple(kept[: len(DIFFERENTIATED)] for kept in record.observed)
        parts = parts_side_by_side(of_observables, plan.directions)
        rows = range(-len(parts), 0)
        scatter(slopes, 1, [(end + c, column) for c in rows], parts, plan.lanes)
    r: Record = values(record)
    kept = [measure.shown(x) for (measure, _), x in zip(KEPT, r.kept, strict=True)]
    numbers = (*kept, r.status, r.failed_step, *exception_flags(plan, r))
    watched = (
        *(x for kept in r.observed for x in columns_of(kept)),
        *(sqrt(square) for square in r.joints),
        *r.turns,
    )
    places = [*range(len(numbers)), *(SUMMARY.count + c for c in range(len(watched)))]
    scatter(summary, 1, [(c, column) for c in places], (*numbers, *watched), plan.lanes)
    if plan.is_looped:
        in_memory(plan).store_kept(body, summary, SUMMARY.count + len(watched), column)


def store_start(
    plan: AnyPlan, given: Any, inputs: Any, summary: Any, column: Any, time: Any
) -> None:
    """Store whether the user's start is on the joint.   time : of the start, s."""
    starts = system_of(plan).is_on_joint(given, load_values(plan, inputs), time)
    scatter(summary, 1, [(SUMMARY.index("starts"), column)], [starts], plan.lanes)


for _formula in (
    store_row, store_state, store_derivatives, store_end_derivatives, store_summary, store_start,
):  # fmt: skip
    kernel(_formula)
