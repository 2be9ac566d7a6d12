"""Record of a run: quantities that the loops load, measure and store, and their columns."""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

from lierb.kernels.numbers.arithmetic import (
    absolute,
    all_lanes,
    branch,
    flatten,
    load,
    plain,
    real,
    sqrt,
    store,
    where,
)
from lierb.kernels.numbers.dual import values
from lierb.kernels.numbers.zero import ZERO
from lierb.kernels.stepping.lane_clock import LaneClock
from lierb.kernels.systems.combine import NAN
from lierb.kernels.systems.derivatives import (
    completed,
    on_values,
    parts_side_by_side,
    seeded,
    with_parts,
)
from lierb.kernels.systems.layout import LANE_SUMMARY, Columns, Field
from lierb.kernels.systems.measures import (
    JOINT_ERRORS,
    JOINT_KEPT,
    KEPT,
    MEASURES,
    MUST_BE_FINITE,
    SUMMARY,
    Measure,
    retained,
)
from lierb.kernels.systems.observables import (
    KEEPS,
    Kept,
    kept_of,
    may_raise,
    nothing_kept,
    observables_of,
    with_value,
)
from lierb.kernels.systems.one_body import LARGEST
from lierb.kernels.systems.plan import AnyPlan, MechanismPlan
from lierb.kernels.systems.signals import controller_fields, signals_width
from lierb.kernels.systems.state import NON_FINITE, OK, RAISED, State
from lierb.kernels.systems.system_of import in_memory, system_of
from lierb.kernels.systems.tree_places import STATE_ROWS
from lierb.kernels.systems.tree_table import table_of
from lierb.kernels.tracing import calls
from lierb.kernels.tracing.trace import kernel


@lru_cache(64)
def history_measures(plan: AnyPlan) -> tuple[Measure, ...]:
    """Return the measures of a history; `work` is one if an element does work."""
    return tuple(m for m in MEASURES if m.name != "work" or plan.does_work)


class Record(NamedTuple):
    """Quantities of a trajectory that are recorded along a run."""

    kept: tuple[Any, ...]  # values of KEPT, or their squares if the measure is computed as a square
    first_energy: Any
    status: Any
    failed_step: Any
    dropped: Any  # rows dropped at the start; see `BodyConstants`
    observed: tuple[Kept, ...] = ()
    joints: tuple[Any, ...] = ()  # JOINT_KEPT of each joint of a mechanism: squares
    turns: tuple[Any, ...] = ()  # number of turns of all iterations; empty for methods without any


@lru_cache(64)
def carried_columns(plan: AnyPlan) -> Columns:
    """Return the columns of a trajectory between two calls: state, record, clock, controllers."""
    columns = (
        Field("state", (system_of(plan).state.count,)), Field("kept", (len(KEPT),)),
        Field("first_energy"), Field("status"), Field("failed_step"), Field("dropped"),
        Field("flags"), Field("observed", (kept_numbers(plan),)),
        Field("joints", (joint_columns(plan),)), Field("turns", (int(plan.method.iterates),)),
        Field("parts", (plan.directions * (system_of(plan).state.count + kept_numbers(plan)),)),
    )  # fmt: skip
    if not plan.has_lane_clocks:
        return Columns(*columns)
    clock = Field("clock", (len(LaneClock._fields),))
    controllers = controller_fields(plan)
    parts = Field("control_parts", (plan.directions * Columns(*controllers).count,))
    return Columns(*columns, clock, *controllers, parts)


def carried_rows(plan: AnyPlan) -> int:
    """Return the number of rows of `carried`: `carried_columns`, and a looped plan's states."""
    own = carried_columns(plan.code).count
    if isinstance(plan, MechanismPlan) and plan.is_in_memory:
        return own + int(table_of(plan)[0][0, STATE_ROWS]) * (1 + plan.directions)
    return own


def joint_columns(plan: AnyPlan) -> int:
    """Return the number of a summary's columns for JOINT_KEPT of a mechanism's joints."""
    return len(JOINT_KEPT) * len(system_of(plan).joints)


def summary_columns(plan: AnyPlan) -> int:
    return lane_column(plan) + (LANE_SUMMARY.count + signals_width(plan)) * plan.has_lane_clocks


def lane_column(plan: AnyPlan) -> int:
    """Return the first column of LANE_SUMMARY in a summary, if lanes have separate clocks."""
    own = SUMMARY.count + len(KEEPS) * len(observables_of(plan)) + joint_columns(plan)
    return own + plan.method.iterates


def kept_numbers(plan: AnyPlan) -> int:
    """Return the number of a record's numbers for statistics of observables."""
    return len(Kept._fields) * len(observables_of(plan))


def history_columns(plan: AnyPlan) -> int:
    """Return the number of columns of a history.

    They are measures, observables, errors of a mechanism's joints, extra states and outputs.
    """
    own = len(history_measures(plan)) + len(observables_of(plan))
    return own + len(JOINT_ERRORS) * len(system_of(plan).joints) + signals_width(plan)


def load_columns(plan: AnyPlan, array: Any, columns: range, first: Any) -> list[Any]:
    return [load(array, (c, first), plan.lanes) for c in columns]


def load_inputs(plan: AnyPlan, inputs: Any) -> list[Any]:
    """Load the inputs, with their derivatives, except a state to continue from."""
    columns = system_of(plan).inputs
    return seeded(plan, columns, load_columns(plan, inputs, range(columns["state"].start), 0))


def load_values(plan: AnyPlan, inputs: Any) -> list[Any]:
    """Load the inputs without derivatives."""
    return [*map(values, load_inputs(plan, inputs))]


def load_body(plan: AnyPlan, inputs: Any, table: Any, memory: Any) -> Any:
    """Load the constants.   table, memory : of a looped plan."""
    if plan.is_looped:
        return in_memory(plan).loaded(inputs, table, memory)
    return system_of(plan).body(load_inputs(plan, inputs))


def load_placed(plan: AnyPlan, body: Any, inputs: Any) -> Any:
    """Load the part of a start that depends on the pose only."""
    return system_of(plan).placed(body, load_inputs(plan, inputs))


def load_given(plan: AnyPlan, inputs: Any, time: Any) -> Any:
    """Load the part of the check of a start that depends on the pose only."""
    return system_of(plan).pose_check(load_values(plan, inputs), time)


def initial_state(plan: AnyPlan, body: Any, placed: Any, inputs: Any) -> State:
    if plan.is_looped:
        return in_memory(plan).started(body, inputs)
    state: State = system_of(plan).start(body, placed, load_inputs(plan, inputs))
    return with_all_parts(plan, state)


def with_all_parts(plan: AnyPlan, state: State) -> State:
    """Return the state with all derivatives of every number."""
    return completed(plan, state)


@on_values
def initial_record(plan: AnyPlan, body: Any, state: State) -> Record:
    """Return a record at the start, with numbers of the state's type."""
    nothing = 0.0 * body.mass  # not a constant, so that 1 / t of a motor is inf, not an error
    system = system_of(plan)
    seen = system.measured(body, state, system.motion(body, state, nothing), nothing)
    energy = seen.values["energy"]
    dropped = system.dropped(body, state)
    if plan.calls_functions and not plan.has_lane_clocks:
        calls.set_exception_flags(nothing + float(calls.CLEAR))
    watched = completed(plan, nothing_kept(plan, nothing))
    joints = (nothing,) * joint_columns(plan)
    kept, turns = (nothing,) * len(KEPT), (nothing,) * plan.method.iterates
    return Record(kept, energy, nothing, nothing, nothing + dropped, watched, joints, turns)


def with_turns(record: Record, turns: Any, counts: Any) -> Record:
    """Return the record with more turns of iterations, where the mask is true."""
    more = tuple(where(counts, before + plain(turns), before) for before in record.turns)
    return record._replace(turns=more)


def with_rank(plan: AnyPlan, body: Any, record: Record) -> Any:
    """Return the body with the number of rows that were redundant at the start."""
    return body._replace(dropped=record.dropped)


def load_carried(plan: AnyPlan, body: Any, carried: Any, first: Any) -> tuple[State, Record]:
    """Load state, record and exception flags of a block, from the last call."""
    columns = carried_columns(plan)
    parts = columns.parts(load_columns(plan, carried, range(columns.count), first))
    numbers = with_parts(plan, (*parts["state"], *parts["observed"]), parts["parts"])
    own = len(parts["state"])
    state = with_all_parts(plan, system_of(plan).state_of(numbers[:own], body))
    observed = kept_of(tuple(numbers[own:]))
    names = "first_energy", "status", "failed_step", "dropped"
    energy, status, step, dropped = (parts[name][0] for name in names)
    if plan.is_looped:
        in_memory(plan).load_state(body, carried, columns.count, first)
    kept, joints, turns = (parts[name] for name in ("kept", "joints", "turns"))
    record = Record(kept, energy, status, step, dropped, observed, joints, turns)
    if plan.calls_functions:
        (before,) = parts["flags"]
        # For lanes with separate clocks, exceptions are collected at the end of a trajectory.
        known = (
            before if plan.has_lane_clocks else where(before > 0.0, float(calls.COLLECTED), before)
        )
        fine = where(record.status == OK, float(calls.CLEAR), float(calls.SUPPRESSED))
        calls.set_exception_flags(where(before > calls.SUPPRESSED, known, fine))
    return state, record


def store_carried(
    plan: AnyPlan, body: Any, carried: Any, first: Any, state: State, record: Record
) -> None:
    """Store state, record and exception flags of a block, for the next call."""
    kept, *numbers, observed, joints, turns = record
    flags = exception_flags(plan, record)
    for c, number in enumerate((*flatten(values(state)), *kept, *numbers, *flags)):
        store(carried, (c, first), number, plan.lanes)
    behind = carried_columns(plan)["observed"].start
    parts = parts_side_by_side((state, observed), plan.directions) if plan.moving else []
    for c, number in enumerate((*flatten((values(observed), joints, turns)), *parts), behind):
        store(carried, (c, first), number, plan.lanes)
    if plan.is_looped:
        in_memory(plan).store_state(body, carried, carried_columns(plan).count, first)


def with_exceptions(plan: AnyPlan, record: Record, k: Any) -> Record:
    """Return the record with the status RAISED where a function has raised since the last step.

    Such functions are evaluated for λ, reactions and observables.
    """
    if not plan.calls_functions:
        return record  # never
    fresh = (calls.exception_flags(record.status) > calls.SUPPRESSED) & (record.status == OK)
    return record._replace(
        status=where(fresh, float(RAISED), record.status),
        failed_step=where(fresh, real(k), record.failed_step),
    )


def exception_flags(plan: AnyPlan, record: Record) -> Any:
    """Return the exception flags; negative where the trajectory had failed before."""
    if not plan.calls_functions:
        return ()
    known = calls.exception_flags(record.status)
    counts = (record.status == OK) | (record.status == RAISED)
    return (where(counts, known, -known),)


def are_finite(*numbers: Any) -> Any:
    """Return whether all numbers and their sum are finite."""
    numbers = numbers or (ZERO,)
    while len(numbers) > 1:  # pairwise: a sequential sum would delay the next step
        half = len(numbers) // 2
        pairs = zip(numbers[:half], numbers[half : 2 * half], strict=True)
        numbers = (*(a + b for a, b in pairs), *numbers[2 * half :])
    return absolute(numbers[0]) <= LARGEST  # false for NaN


def observe(
    plan: AnyPlan,
    body: Any,
    state: State,
    record: Record,
    k: Any,
    time: Any,
    share: Any = ZERO,
    by_halves: bool = False,
) -> tuple[tuple[Any, ...], Record]:
    """Return the measures and observables of a history at step k, and the updated record.

    share : weight of the step in means, a fraction of the run's time; with `by_halves`, half the
        time since the last step, which is the weight of both.

    Statistics of observables have derivatives; measures have none.
    """
    body = with_rank(plan, body, record)
    system, plain = system_of(plan), (values(body), values(state))
    seen = system.motion(*plain, time)
    of_observed = system.motion(body, state, time) if plan.moving and observables_of(plan) else seen
    watched = completed(plan, system.observed(body, of_observed, time))
    if may_raise(plan):
        record = with_exceptions(plan, record, k)
    shown, errors, measured = measure(plan, body, state, record, k, time, seen)
    alive = measured.status == OK
    # A function of time alone has one value for the block; `where` extends it to all lanes.
    watched = tuple(where(alive, value, NAN) for value in watched)
    pairs = zip(record.observed, watched, strict=True)
    kept = tuple(with_value(old, value, share, alive, by_halves) for old, value in pairs)
    return (*shown, *values(watched), *errors), measured._replace(observed=kept)


@on_values
def measure(
    plan: AnyPlan, body: Any, state: State, record: Record, k: Any, time: Any, seen: Any
) -> tuple[tuple[Any, ...], tuple[Any, ...], Record]:
    """Return the measures, the errors of joints, and the record with them.   seen : motion.

    A trajectory fails if its measures are not finite, even if its state is: squares and energies
    overflow long before the state does.
    """
    system = system_of(plan)
    now, joints = system.measured(body, state, seen, time, record.first_energy)
    sizes = {measure.name: measure.size(now[measure.name]) for measure in MEASURES}
    fine = are_finite(*(sizes[name] for name in MUST_BE_FINITE))
    so_far = (record.status, record.failed_step)
    alive = (record.status == OK) & fine

    def failed() -> Any:
        fresh = where(record.status == OK, (float(NON_FINITE), real(k)), so_far)
        return where(fine, so_far, fresh)

    status, failed_step = branch(all_lanes(fine), lambda: so_far, failed)
    kept = tuple(
        retained(how, old, now[measure.name], sizes[measure.name], alive)
        for (measure, how), old in zip(KEPT, record.kept, strict=True)
    )
    shown = tuple(measure.shown(now[measure.name]) for measure in history_measures(plan))
    errors = tuple(sqrt(square) for joint in joints for square in joint)
    squares = ((how, joint[JOINT_ERRORS.index(m)]) for joint in joints for m, how in JOINT_KEPT)
    of_joints = tuple(
        retained(how, old, square, square, alive)
        for (how, square), old in zip(squares, record.joints, strict=True)
    )
    measured = record._replace(kept=kept, status=status, failed_step=failed_step, joints=of_joints)
    return shown, errors, measured


def without_measures(plan: AnyPlan, record: Record, seen: Record) -> Record:
    """Return the record after a step that is saved, not measured.   seen : record by `observe`."""
    if not may_raise(plan):
        return record
    raised = (seen.status == RAISED) & (record.status == OK)
    return record._replace(
        status=where(raised, seen.status, record.status),
        failed_step=where(raised, seen.failed_step, record.failed_step),
    )


for _formula in (
    load_body, load_placed, load_given, initial_state, initial_record, with_rank, load_carried,
    store_carried, observe, without_measures, with_exceptions,
):  # fmt: skip
    kernel(_formula)
