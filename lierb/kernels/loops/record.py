"""Record of a run: what the loops load, measure and store, and the columns that it makes."""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

from lierb.kernels.numbers.arithmetic import (
    absolute,
    all_lanes,
    branch,
    flatten,
    load,
    maximum,
    plain,
    prefetch,
    real,
    scatter,
    sqrt,
    store,
    where,
)
from lierb.kernels.numbers.zero import ZERO, is_zero
from lierb.kernels.systems.formulations import LARGEST
from lierb.kernels.systems.layout import LANE_SUMMARY, POSE_AND_TWIST
from lierb.kernels.systems.measures import (
    JOINT_ERRORS,
    JOINT_KEPT,
    KEPT,
    MEASURES,
    MUST_BE_FINITE,
    SUMMARY,
    Measure,
)
from lierb.kernels.systems.observables import (
    KEEPS,
    Kept,
    columns_of,
    kept_of,
    may_raise,
    nothing_kept,
    observables_of,
    with_value,
)
from lierb.kernels.systems.plan import AnyPlan
from lierb.kernels.systems.signals import lane_end, signals_width
from lierb.kernels.systems.state import NON_FINITE, OK, RAISED, State
from lierb.kernels.systems.system_of import system_of
from lierb.kernels.tracing import calls

NAN = float("nan")


@lru_cache(64)
def history_measures(plan: AnyPlan) -> tuple[Measure, ...]:
    """Those of a history: `work` where something does any."""
    return tuple(m for m in MEASURES if m.name != "work" or plan.does_work)


class Record(NamedTuple):
    """What a run remembers of a body."""

    kept: tuple[Any, ...]  # of KEPT; squares where a measure is one
    first_energy: Any
    status: Any
    failed_step: Any
    dropped: Any  # at the start; see `BodyConstants`
    observed: tuple[Kept, ...] = ()
    joints: tuple[Any, ...] = ()  # of a mechanism's joints, JOINT_KEPT of each: squares


def marks_column(plan: AnyPlan) -> int:
    """Of what is carried: what functions have raised."""
    return system_of(plan).state.count + len(KEPT) + len(Record._fields) - 3


def carried_columns(plan: AnyPlan) -> int:
    watched = len(Kept._fields) * len(observables_of(plan)) + joint_columns(plan)
    return marks_column(plan) + 1 + watched


def joint_columns(plan: AnyPlan) -> int:
    """Of a summary: JOINT_KEPT of every joint of a mechanism."""
    return len(JOINT_KEPT) * len(system_of(plan).joints)


def summary_columns(plan: AnyPlan) -> int:
    return lane_column(plan) + (LANE_SUMMARY.count + signals_width(plan)) * plan.has_lane_clocks


def lane_column(plan: AnyPlan) -> int:
    """Of a summary: the first of LANE_SUMMARY, where lanes have clocks of their own."""
    return SUMMARY.count + len(KEEPS) * len(observables_of(plan)) + joint_columns(plan)


def history_columns(plan: AnyPlan) -> int:
    """Measures, observables, the errors of every joint of a mechanism, the user's states and
    outputs.
    """
    own = len(history_measures(plan)) + len(observables_of(plan))
    return own + len(JOINT_ERRORS) * len(system_of(plan).joints) + signals_width(plan)


def _columns(plan: AnyPlan, array: Any, columns: range, first: Any) -> list[Any]:
    return [load(array, (c, first), plan.lanes) for c in columns]


def _inputs(plan: AnyPlan, inputs: Any) -> list[Any]:
    """All numbers but a state to go on from."""
    return _columns(plan, inputs, range(system_of(plan).inputs["state"].start), 0)


def load_body(plan: AnyPlan, inputs: Any) -> Any:
    return system_of(plan).body(_inputs(plan, inputs))


def load_placed(plan: AnyPlan, body: Any, inputs: Any) -> Any:
    """What all starts in one pose have in common."""
    return system_of(plan).placed(body, _inputs(plan, inputs))


def load_given(plan: AnyPlan, inputs: Any, time: Any) -> Any:
    """The same of what is looked at, whether they are on the joint."""
    return system_of(plan).given(_inputs(plan, inputs), time)


def initial_state(plan: AnyPlan, body: Any, placed: Any, inputs: Any) -> State:
    state: State = system_of(plan).start(body, placed, _inputs(plan, inputs))
    return state


def initial_record(plan: AnyPlan, body: Any, state: State) -> Record:
    """Nothing kept so far, as numbers of the state's own type."""
    nothing = 0.0 * body.mass  # no constant: 1 / t of a motor is inf, no error
    system = system_of(plan)
    seen = system.measured(body, state, system.seen(body, state, nothing), nothing)
    energy = seen.values["energy"]
    dropped = system.dropped(body, state)
    if plan.calls_functions and not plan.has_lane_clocks:
        calls.set_marks(nothing + float(calls.CLEAR))
    watched = nothing_kept(plan, nothing)
    joints = (nothing,) * joint_columns(plan)
    kept = (nothing,) * len(KEPT)
    return Record(kept, energy, nothing, nothing, nothing + dropped, watched, joints)


def resumed_state(plan: AnyPlan, body: Any, inputs: Any) -> State:
    """The one that a run goes on from."""
    at = system_of(plan).inputs["state"]
    numbers = _columns(plan, inputs, range(at.start, at.stop), 0)
    state: State = system_of(plan).state_of(numbers, body)
    return state


def resumed_record(plan: AnyPlan, inputs: Any, record: Record) -> Record:
    """Record with the rank at the start of the run that goes on, unless that had other rows."""
    if not plan.keeps_rank:
        return record
    at = system_of(plan).inputs["lane"]
    (dropped,) = _columns(plan, inputs, range(at.start, at.start + 1), 0)
    return record._replace(dropped=where(dropped == dropped, dropped, record.dropped))


def load_state(plan: AnyPlan, body: Any, carried: Any, first: Any) -> State:
    numbers = _columns(plan, carried, range(system_of(plan).state.count), first)
    state: State = system_of(plan).state_of(numbers, body)
    return state


def load_record(plan: AnyPlan, carried: Any, first: Any) -> Record:
    marks, watched = marks_column(plan), len(Kept._fields) * len(observables_of(plan))
    numbers = _columns(plan, carried, range(system_of(plan).state.count, marks), first)
    more = tuple(_columns(plan, carried, range(marks + 1, carried_columns(plan)), first))
    kept, (energy, status, step, dropped) = tuple(numbers[: len(KEPT)]), numbers[len(KEPT) :]
    seen = kept_of(more[:watched]), more[watched:]
    record = Record(kept, energy, status, step, dropped, *seen)
    if plan.calls_functions:
        before = load(carried, (marks, first), plan.lanes)
        # Lanes with clocks of their own are heard once they have handed over their ends.
        known = before if plan.has_lane_clocks else where(before > 0.0, float(calls.HEARD), before)
        fine = where(record.status == OK, float(calls.CLEAR), float(calls.SILENT))
        calls.set_marks(where(before > calls.SILENT, known, fine))
    return record


def store_carried(plan: AnyPlan, carried: Any, first: Any, state: State, record: Record) -> None:
    kept, *more, watched, joints = record
    numbers = (*flatten(state), *kept, *more, *_raised_in_call(plan, record))
    for c, number in enumerate(numbers):
        store(carried, (c, first), number, plan.lanes)
    for c, number in enumerate(flatten((watched, joints)), marks_column(plan) + 1):
        store(carried, (c, first), number, plan.lanes)


def store_end(plan: AnyPlan, state: State, record: Record, ends: Any, column: Any) -> None:
    numbers = [*flatten(state)]
    going_on = [numbers[c] for c in state_columns(plan)]
    if plan.keeps_rank:
        going_on.append(record.dropped)
    places = [(c, column) for c in range(len(going_on))]
    scatter(ends, 1, places, going_on, plan.lanes)


@lru_cache(64)
def end_columns(plan: AnyPlan) -> tuple[int, ...]:
    """Of a state to go on from those that are kept at the end: `state_columns`, then `lane_end`."""
    first = system_of(plan).state.count
    return (*state_columns(plan), *range(first, first + lane_end(plan).count))


@lru_cache(64)
def state_columns(plan: AnyPlan) -> tuple[int, ...]:
    """Of the state's numbers those that are kept at the end: what the plan has, but W, which counts
    from the start of its own run.
    """
    columns = system_of(plan).state
    numbers = flatten(system_of(plan).state_of((1.0,) * columns.count))
    work = columns.index("work")
    return tuple(c for c, number in enumerate(numbers) if c != work and not is_zero(number))


def heard(plan: AnyPlan, record: Record, k: Any) -> Record:
    """The record, where a function has raised since the last step: asked for λ or the reaction, or
    an observable.
    """
    if not plan.calls_functions:
        return record  # never
    fresh = (calls.marks(record.status) > calls.SILENT) & (record.status == OK)
    return record._replace(
        status=where(fresh, float(RAISED), record.status),
        failed_step=where(fresh, real(k), record.failed_step),
    )


def _raised_in_call(plan: AnyPlan, record: Record) -> Any:
    """What functions have raised; negative where the body had failed before."""
    if not plan.calls_functions:
        return ()
    known = calls.marks(record.status)
    counts = (record.status == OK) | (record.status == RAISED)
    return (where(counts, known, -known),)


def are_finite(*numbers: Any) -> Any:
    """Whether all of them are, and so is their sum."""
    numbers = numbers or (ZERO,)
    while len(numbers) > 1:  # by halves: a sum of one after the other keeps the next step waiting
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
    """The measures and observables of a history at step k, and the record with what is kept of
    them.   share : of the run's time, that the step counts for in means; `by_halves`, half the time
    since the last one, which both count for.

    Where they are not finite they tell nothing, and the body has failed, though its state may be
    finite: squares and energies overflow long before it.
    """
    system = system_of(plan)
    seen = system.seen(body, state, time)
    values = system.observed(body, seen, time)
    if may_raise(plan):
        record = heard(plan, record, k)
    now, joints = system.measured(body, state, seen, time, record.first_energy)
    sizes = {measure.name: measure.size(now[measure.name]) for measure in MEASURES}
    fine = are_finite(*(sizes[name] for name in MUST_BE_FINITE))
    so_far = (record.status, record.failed_step)
    alive = (record.status == OK) & fine

    def marked() -> Any:
        fresh = where(record.status == OK, (float(NON_FINITE), real(k)), so_far)
        return where(fine, so_far, fresh)

    status, failed_step = branch(all_lanes(fine), lambda: so_far, marked)
    kept = []
    for (measure, how), old in zip(KEPT, record.kept, strict=True):
        size = sizes[measure.name]
        if how == "final":
            kept.append(where(alive, plain(now[measure.name]), NAN))
        else:
            kept.append(old if is_zero(size) else where(alive, maximum(old, size), old))
    shown = tuple(measure.shown(now[measure.name]) for measure in history_measures(plan))
    # As wide as the block: a function of time alone, called body by body, has one value for it.
    values = tuple(where(alive, value, NAN) for value in values)
    pairs = zip(record.observed, values, strict=True)
    errors = tuple(sqrt(square) for joint in joints for square in joint)
    return (*shown, *values, *errors), record._replace(
        kept=tuple(kept),
        status=status,
        failed_step=failed_step,
        observed=tuple(with_value(old, value, share, alive, by_halves) for old, value in pairs),
        joints=_joints_kept(record, joints, alive),
    )


def _joints_kept(
    record: Record, joints: tuple[tuple[Any, ...], ...], alive: Any
) -> tuple[Any, ...]:
    """JOINT_KEPT of every joint, with what is seen now."""
    found = []
    places = ((joint, measure, how) for joint in joints for measure, how in JOINT_KEPT)
    for (joint, measure, how), old in zip(places, record.joints, strict=True):
        square = joint[JOINT_ERRORS.index(measure)]
        if how == "final":
            found.append(where(alive, plain(square), NAN))
        else:
            found.append(old if is_zero(square) else where(alive, maximum(old, square), old))
    return tuple(found)


def without_measures(plan: AnyPlan, record: Record, seen: Record) -> Record:
    """The record after a step that is saved and not measured.   seen : as `observe` has it."""
    if not may_raise(plan):
        return record
    raised = (seen.status == RAISED) & (record.status == OK)
    return record._replace(
        status=where(raised, seen.status, record.status),
        failed_step=where(raised, seen.failed_step, record.failed_step),
    )


def store_measures(
    plan: AnyPlan, record: Record, shown: tuple[Any, ...], history: Any, row: Any, first: Any
) -> None:
    """One row of the history's scalar columns.

    The next row is far from this one, where no hardware looks for it: fetched now, it is at hand
    when the steps to it are made. Otherwise its cache misses take as long as four steps.
    """
    places = [(c, row, first) for c in range(len(shown))]
    alive = record.status == OK
    scatter(history, 2, places, where(alive, tuple(shown), (NAN,) * len(shown)), plan.lanes)
    for c in range(len(shown)):
        prefetch(history, (c, row + 1, first), plan.lanes)


def user_state(
    plan: AnyPlan, body: Any, inputs: Any, state: State, record: Record
) -> list[tuple[Any, ...]]:
    """R (row by row), r, ω, v in the user's frames, of every link; NaN after a failure."""
    links = system_of(plan).in_user_frames(body, _inputs(plan, inputs), state)
    alive = record.status == OK
    return [where(alive, numbers, (NAN,) * len(numbers)) for numbers in links]


def store_state(
    plan: AnyPlan,
    body: Any,
    inputs: Any,
    state: State,
    record: Record,
    states: Any,
    row: Any,
    rows: Any,
    column: Any,
) -> None:
    """One row of the states: R, r, ω and v, each [link, time][body][component].

    rows : of each link.
    """
    for numbers in user_state(plan, body, inputs, state, record):
        for array, part in zip(states, POSE_AND_TWIST.parts(numbers).values(), strict=True):
            scatter(array, 1, [(row, column, c) for c in range(len(part))], part, plan.lanes)
            prefetch(array, (row + 1, column, 0), plan.lanes * len(part))
        row = row + rows


def with_rank(plan: AnyPlan, body: Any, record: Record) -> Any:
    """Body with the number of rows that were redundant at the start."""
    return body._replace(dropped=record.dropped)


def store_forces(
    plan: AnyPlan,
    body: Any,
    state: State,
    record: Record,
    multipliers: Any,
    reactions: Any,
    row: Any,
    rows: Any,
    first: Any,
    time: Any,
) -> None:
    """One row of the history's λ, [time][body][row], and of reactions, [joint, time][body][…].

    rows : of each joint.
    """
    if not (plan.multipliers or plan.reaction):
        return
    found, wrenches = system_of(plan).forces(with_rank(plan, body, record), state, time)
    alive = record.status == OK
    if plan.multipliers and found:
        places = [(row, first, c) for c in range(len(found))]
        scatter(multipliers, 1, places, where(alive, found, (NAN,) * len(found)), plan.lanes)
        prefetch(multipliers, (row + 1, first, 0), plan.lanes * len(found))
    for wrench in wrenches if plan.reaction else ():
        places = [(row, first, c) for c in range(6)]
        scatter(reactions, 1, places, where(alive, wrench, (NAN,) * 6), plan.lanes)
        prefetch(reactions, (row + 1, first, 0), plan.lanes * 6)
        row = row + rows


def store_summary(plan: AnyPlan, record: Record, summary: Any, column: Any) -> None:
    """What is kept of the measures, status and the step of a failure."""
    r = record
    kept = [measure.shown(x) for (measure, _), x in zip(KEPT, r.kept, strict=True)]
    numbers = (*kept, r.status, r.failed_step, *_raised_in_call(plan, r))
    watched = (
        *(x for kept in r.observed for x in columns_of(kept)),
        *(sqrt(square) for square in r.joints),
    )
    places = [*range(len(numbers)), *(SUMMARY.count + c for c in range(len(watched)))]
    scatter(summary, 1, [(c, column) for c in places], (*numbers, *watched), plan.lanes)


def store_start(
    plan: AnyPlan, given: Any, inputs: Any, summary: Any, column: Any, time: Any
) -> None:
    """Whether the start, as given, is on the joint.

    time : s, of the start.
    """
    starts = system_of(plan).starts_well(given, _inputs(plan, inputs), time)
    scatter(summary, 1, [(SUMMARY.index("starts"), column)], [starts], plan.lanes)
