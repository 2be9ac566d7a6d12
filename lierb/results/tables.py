"""Arrow tables of a run: columns, units and metadata."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from math import prod
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from lierb.errors import MemoryLimitError
from lierb.kernels.loops.record import history_measures
from lierb.kernels.loops.workspace import EVENT_COLUMNS
from lierb.kernels.stepping.clock import StepClock
from lierb.kernels.systems.layout import POSE_AND_TWIST
from lierb.kernels.systems.measures import JOINT_ERRORS, JOINT_KEPT, KEPT, MEASURES, Measure
from lierb.kernels.systems.observables import KEEPS
from lierb.kernels.systems.plan import AnyPlan
from lierb.kernels.systems.signals import outputs_of, signals_width, states_of
from lierb.kernels.systems.system_of import system_of
from lierb.model.base import Model
from lierb.model.functions.wrenches import Force
from lierb.model.numbers import qualified
from lierb.results.columns import each_row, numbers, numbers_of, texts, vectors
from lierb.results.failures import RAISED_KEY, STATUS_NAMES
from lierb.runs.output import Output
from lierb.runs.starts import Ready
from lierb.support.memory import available, is_free, too_large

COUNTS = ("steps", "rejected")  # columns of trajectories with their own clocks
STATUS_DICTIONARY = texts([STATUS_NAMES[code] for code in sorted(STATUS_NAMES)])

REACTION_UNITS = "N m, N m, N m, N, N, N"

Column = tuple[pa.Array, str]  # with its unit, or units; "" without one
_schemas: dict[tuple[Any, ...], pa.Schema] = {}  # by names, units and shapes of the columns


def _table(columns: dict[str, Column], metadata: str, model: Model) -> pa.Table:
    covers = _covers_of(model)
    units = (unit for _, unit in columns.values())
    key = (*columns, *units, *covers.values(), *model.signals)  # of signals alone shapes differ
    if key not in _schemas:
        _schemas[key] = _schema(columns, covers)
    schema = _schemas[key].with_metadata({"lierb": metadata})
    return pa.Table.from_arrays([array for array, _ in columns.values()], schema=schema)


def _schema(columns: dict[str, Column], covers: dict[str, str]) -> pa.Schema:
    fields = []
    for name, (array, unit) in columns.items():
        described = {"unit": unit} if unit else {}
        if covered := covers.get(name.removesuffix("_max").removesuffix("_final")):
            described["covers"] = covered
        fields.append(pa.field(name, array.type, metadata=described or None))
    return pa.schema(fields)


def _covers_of(model: Model) -> dict[str, str]:
    """Return descriptions of the columns of energy, energy drift and work."""
    stored = [force.name for force in model.forces if force.kind.is_conservative]
    working = dict.fromkeys(w for force in model.forces if (w := _work_of(force)))  # of all links
    energy = f"kinetic energy; potential energy of {', '.join(('gravity', *stored))}"
    drift, work = energy, "nothing: all that acts has a potential"
    if working:
        work = f"work of {', '.join(working)}"
        drift = f"{energy}; less the {work}"
    return {"energy": energy, "energy_drift": drift, "work": work}


def _no_work(energy: pa.Array) -> pa.Array:
    """Return a column of zeros, with NaN after a failure."""
    return numbers(np.where(np.isnan(numbers_of(energy)), np.nan, 0.0))


def _work_of(force: Force) -> str:
    """Return the name of the non-conservative part of a force; "" if it has none."""
    if not force.kind.is_conservative:
        return force.name
    if force.kind.is_users:
        return f"{force.name} beyond its potential"
    for part in force.kind.working:
        if np.any(force.parameters[part] != 0.0):
            return f"{force.name}'s {part}"
    return ""


def size_of_tables(plan: AnyPlan, count: int, rows: int, recorded: tuple[str, ...]) -> int:
    """Return the peak memory of both tables of a run, bytes, with the Output that they wrap.

    rows : number of saved times.   Measured: 0.98 to 1.08 of the growth of a process. Events are
    not included, since their number is unknown.
    """
    with_state, has_lanes = "state" in recorded, plan.has_lane_clocks
    links = system_of(plan).links
    is_copied = with_state and rows + has_lanes > 1
    copied = POSE_AND_TWIST.count * links if is_copied else 0  # pose and twist at the end
    turned = sum(prod(shape) for _, shape in (*states_of(plan), *outputs_of(plan)) if shape)
    copied += turned + len(COUNTS) * has_lanes
    own = 3 + ("energy" in recorded and not plan.does_work)  # trajectory, step, t; work
    if plan.multipliers and system_of(plan).joints:
        own += len(plan.rows)  # arrays for each joint
    own += turned
    ours = count * (1 + copied) + rows * (3 + own * count)  # temporaries for one time
    return Output.size(plan, count, rows, with_state) + 8 * ours


def history_row_bytes(model: Model, recorded: Iterable[str]) -> int:
    """Return the size of a row of `history_table`, bytes."""
    numbers_in = 3 + sum(m.recorded_by is None or m.recorded_by in recorded for m in MEASURES)
    joints = model.joint_names
    numbers_in += len(model.observables) + len(JOINT_ERRORS) * len(joints)
    numbers_in += sum(prod(shape) for _, shape, _ in model.signals)
    if "state" in recorded:
        numbers_in += POSE_AND_TWIST.count * len(model.link_names)
    if "multipliers" in recorded:
        numbers_in += sum(len(rows) for _, rows in model.rows_by_name)
    if "reaction" in recorded:
        numbers_in += 6 * max(len(joints), 1)
    return 8 * numbers_in


def event_row_bytes(model: Model) -> int:
    """Return the size of a row of `events_table`, bytes."""
    signals = sum(prod(shape) for _, shape, _ in model.signals)
    return 8 * (2 + POSE_AND_TWIST.count * len(model.link_names) + signals) + 1


def summary_table(output: Output, metadata: str, model: Model) -> pa.Table:
    """Return a table with a row for each trajectory."""
    plan = output.plan
    status = pa.DictionaryArray.from_arrays(numbers(output.status), STATUS_DICTIONARY)
    columns: dict[str, Column] = {
        "trajectory": (numbers(np.arange(len(output.status), dtype=np.int64)), ""),
        "status": (status, ""),
        "t": (numbers(output.t), "s"),
    }
    if plan.has_lane_clocks:
        columns |= {name: (numbers(output.of_lanes(name).astype(np.int64)), "") for name in COUNTS}
        columns["dt_last"] = numbers(output.of_lanes("dt_last")), "s"
    if plan.method.iterates:
        columns["iterations"] = numbers(output.turns.astype(np.int64)), ""
    columns |= _kept("", KEPT, each_row(output.kept))
    watched = [(f"{each.name}_{how}", each.unit) for each in model.observables for how in KEEPS]
    more = each_row(output.observed)
    of_joints = _in_parts(more[len(watched) :], len(JOINT_KEPT))
    for joint, kept in zip(model.joint_names, of_joints, strict=True):
        columns |= _kept(joint, JOINT_KEPT, kept)
    columns |= _states(model, map(output.state_of, range(len(model.link_names))))
    columns |= {name: (column, unit) for (name, unit), column in zip(watched, more, strict=False)}
    columns |= _signals_of(model, output.signals)
    table = _table(columns, metadata, model)
    for what in output.raised.values():
        raised = {RAISED_KEY: what.encode(errors="backslashreplace")}
        table = table.replace_schema_metadata(table.schema.metadata | raised)
    return table


def history_table(
    output: Output, recorded: tuple[str, ...], plan: AnyPlan, metadata: str, model: Model
) -> pa.Table:
    """Return a table with a row for each saved time and trajectory, time-major."""
    clock, count = output.clock, len(output.status)
    saved = clock.saved_steps()
    columns: dict[str, Column] = {
        "trajectory": (numbers(np.tile(np.arange(count, dtype=np.int64), len(saved))), ""),
        "step": (numbers(np.repeat(saved, count)), ""),
        "t": (numbers(np.repeat(clock.saved_times(), count)), "s"),
    }
    measures, observables = history_measures(plan), model.observables
    rows = each_row(output.history)
    by_measure = list(zip(measures, rows[: len(measures)], strict=True))
    columns |= {m.name: (column, m.unit) for m, column in by_measure if m.recorded_by is None}
    before = len(output.history) - signals_width(plan)
    errors = rows[len(measures) + len(observables) : before]
    for joint, own in zip(model.joint_names, _in_parts(errors, len(JOINT_ERRORS)), strict=True):
        named = zip(JOINT_ERRORS, own, strict=True)
        columns |= {f"{joint}.{measure.name}": (column, measure.unit) for measure, column in named}
    if "state" in recorded:
        firsts = [output.rows * link for link in range(len(model.link_names))]
        columns |= _states(model, ([a[i : i + len(saved)] for a in output.states] for i in firsts))
    columns |= {m.name: (column, m.unit) for m, column in by_measure if m.recorded_by in recorded}
    if "energy" in recorded and not plan.does_work:
        columns["work"] = _no_work(columns["energy"][0]), "J"
    if "multipliers" in recorded and plan.rows:  # Parquet has no lists of length 0
        columns |= _multipliers_of(model, output.multipliers)
    if "reaction" in recorded:
        for number, joint in enumerate(model.joint_names or ("",)):
            part = output.reactions[len(saved) * number : len(saved) * (number + 1)]
            columns[qualified(joint, "reaction")] = vectors(part), REACTION_UNITS
    columns |= {
        each.name: (column, each.unit) for each, column in zip(observables, rows[len(measures) :])
    }
    columns |= _signals_of(model, output.history[before:].reshape(-1, len(saved) * count))
    return _table(columns, metadata, model)


def events_table(output: Output, metadata: str, model: Model) -> pa.Table:
    """Return a table with a row for each event, by trajectory and time."""
    rows = output.events
    assert rows is not None
    names = texts([event.name for event in model.events])
    which = numbers(rows[:, 1].astype(np.int32))
    columns: dict[str, Column] = {
        "trajectory": (numbers(rows[:, 0].astype(np.int64)), ""),
        "event": (pa.DictionaryArray.from_arrays(which, names), ""),
        "t": (numbers(rows[:, 2]), "s"),
    }
    width, count = POSE_AND_TWIST.count, len(model.link_names)
    of_links = np.split(rows[:, EVENT_COLUMNS : EVENT_COLUMNS + count * width], count, axis=1)
    columns |= _states(model, ([own[:, at] for _, at in POSE_AND_TWIST] for own in of_links))
    columns |= _signals_of(model, rows[:, EVENT_COLUMNS + count * width :].T)
    return _table(columns, metadata, model)


# ---- columns -----------------------------------------------------------------------------------


def _kept(
    joint: str, kept: Sequence[tuple[Measure, str]], columns: Sequence[pa.Array]
) -> dict[str, Column]:
    """Return the columns of measures in a summary."""
    named = zip(kept, columns, strict=True)
    return {qualified(joint, f"{m.name}_{how}"): (c, m.unit) for (m, how), c in named}


def _states(model: Model, of_links: Iterable[Iterable[NDArray]]) -> dict[str, Column]:
    """Return the columns of poses and twists.   of_links : arrays of their fields, by link."""
    return {
        qualified(link, field.name): (vectors(array), field.unit)
        for link, arrays in zip(model.link_names, of_links, strict=True)
        for field, array in zip(POSE_AND_TWIST.fields, arrays, strict=True)
    }


def _signals_of(model: Model, rows: NDArray) -> dict[str, Column]:
    """Return the columns of extra states and controller outputs.   rows : [number][row]."""
    columns, first = {}, 0
    for name, shape, unit in model.signals:
        part = rows[first : first + prod(shape)]
        columns[name] = vectors(part.T) if shape else numbers(part[0]), unit
        first += len(part)
    return columns


def _in_parts(columns: list[pa.Array], width: int) -> Iterator[list[pa.Array]]:
    return (columns[i : i + width] for i in range(0, len(columns), width))


def _multipliers_of(model: Model, multipliers: NDArray) -> dict[str, Column]:
    """Return the columns of λ of the joints that have rows."""
    columns, first = {}, 0
    for name, rows in model.rows_by_name:
        if rows:
            part = np.ascontiguousarray(multipliers[..., first : first + len(rows)])
            units = ", ".join(row.unit for row in rows)
            columns[qualified(name, "lambda")] = vectors(part), units
        first += len(rows)
    return columns


def require_memory(ready: Ready) -> None:
    """Raise MemoryLimitError if the results exceed the memory, before any allocation or JIT."""
    rows, count = ready.times.saved_rows, ready.inputs.count
    if not is_free(size_of_tables(ready.plan, count, rows, ready.options.record)):
        raise no_room(ready)


def no_room(ready: Ready) -> MemoryLimitError:
    """Return the error of results that are larger than the free memory."""
    plan, clock, count = ready.plan, ready.times, ready.inputs.count
    recorded, free = ready.options.record, available()
    whole = size_of_tables(plan, count, clock.saved_rows, recorded)
    summary = size_of_tables(plan, count, 0, ())
    apart = "lierb.integrate_batches or lierb.run, whose memory does not grow with the study"
    if summary >= free or not clock.saved_rows:
        what, remedy = f"the summary of {count} bodies", f"take fewer at a time, or {apart}"
    else:
        rows = clock.saved_rows
        fitting = max(int(0.8 * (free - summary) / ((whole - summary) / rows)), 2)
        fits = f"{fitting} times fit"
        if isinstance(clock, StepClock):
            fits = f"save_every={-(-clock.steps // (fitting - 1))} fits"
        what = f"the history of {rows} times × {count} bodies"
        more = ", record less" if recorded else ""
        remedy = f"save less often ({fits}){more}, take fewer bodies, or {apart}"
    return too_large(what, whole, free, remedy)
