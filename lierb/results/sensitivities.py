"""Tables of a run's derivatives with respect to its parameters."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from math import prod
from typing import NamedTuple

import numpy as np
import pyarrow as pa

from lierb.errors import require_name
from lierb.kernels.systems.layout import Columns
from lierb.kernels.systems.measures import MEASURES
from lierb.kernels.systems.observables import DIFFERENTIATED
from lierb.model.base import Model
from lierb.model.numbers import qualified
from lierb.results.columns import as_array, numbers, vectors
from lierb.results.tables import REACTION_UNITS
from lierb.runs.derivatives import Derivatives
from lierb.runs.output import Output
from lierb.runs.parameters import POSE_UNITS, TWIST_UNITS, slices_of
from lierb.support.arrays import Array

SEPARATOR = "/"  # between quantity and parameter in the name of a column
UNIT, PER, SHAPE = b"unit", b"per", b"shape"  # keys of a column's metadata


class Sensitivities(NamedTuple):
    """Tables of derivatives; a column such as `pose/body.mass` for each quantity and parameter.

    Each row has the derivatives of a quantity's numbers by all numbers of a parameter, those of one
    number side by side. The metadata of a column has the quantity's `unit`, the parameter's (`per`)
    and the `shape`.

    Attributes
    ----------
    summary : pyarrow.Table
        Derivatives at the end of each trajectory, in the rows of `Result.summary`, and those of
        minimum, maximum and mean of each observable, by the names there. A maximum changes with the
        value at the time that has it.
    history : pyarrow.Table or None
        Derivatives at the saved times, in the rows of `Result.history`.
    events : pyarrow.Table or None
        Derivatives at the events, in the rows of `Result.events`; those of the event's time are
        `t/…`, and all others include its change.
    """

    summary: pa.Table
    history: pa.Table | None = None
    events: pa.Table | None = None

    @property
    def quantities(self) -> tuple[str, ...]:
        """Return the names of the differentiated quantities."""
        return _names(self.summary, 0)

    @property
    def parameters(self) -> tuple[str, ...]:
        """Return the names of the parameters."""
        return _names(self.summary, 1)

    def array(self, of: str, with_respect_to: str) -> Array:
        """Return the derivatives of a quantity by a parameter; see `Result.sensitivity`."""
        require_name("of", of, self.quantities)
        require_name("with_respect_to", with_respect_to, self.parameters)
        column = f"{of}{SEPARATOR}{with_respect_to}"
        lead: tuple[int, ...] = (self.summary.num_rows,)
        table = self.summary
        if self.history is not None and column in self.history.column_names:
            table, lead = self.history, (-1, self.summary.num_rows)
        shape = table.schema.field(column).metadata[SHAPE].decode()
        return as_array(table[column]).reshape(*lead, *map(int, shape.split(", ")))

    def named(self, parameters: Sequence[str]) -> Sensitivities:
        """Return the tables with other names of the parameters, in order."""
        new = dict(zip(self.parameters, parameters, strict=True))

        def renamed(table: pa.Table) -> pa.Table:
            pairs = (name.partition(SEPARATOR) for name in table.column_names)
            return table.rename_columns([f"{of}{by}{new.get(p, p)}" for of, by, p in pairs])

        return Sensitivities(*(table if table is None else renamed(table) for table in self))


class Untabled:
    """Derivatives of a run at the saved times, or at the end of a run that saves none.

    There are no tables, for callers that need a few numbers.
    """

    def __init__(self, derivatives: Derivatives, model: Model) -> None:
        self._derivatives = derivatives
        self._quantities = {q.name: q for q in _quantities(derivatives.columns, model)}
        self._directions = slices_of(derivatives.parameters)

    def array(self, of: str, with_respect_to: str) -> Array:
        """Return the derivatives of a quantity by a parameter; see `Result.sensitivity`."""
        derivatives, directions = self._derivatives, self._directions[with_respect_to]
        if of == TIME.name:
            return derivatives.times[directions].T
        quantity = self._quantities[of]
        if derivatives.parts[0].size:
            rows = derivatives.rows_of(quantity.part, directions)
        else:
            rows = _chosen(derivatives.ends)(quantity.part, directions)
        return rows.reshape(*rows.shape[:-2], *quantity.shape, -1)


def _names(table: pa.Table, which: int) -> tuple[str, ...]:
    pairs = (name.split(SEPARATOR) for name in table.column_names if SEPARATOR in name)
    return tuple(dict.fromkeys(pair[which] for pair in pairs))


class _Quantity(NamedTuple):
    """Quantity of a run.   part : of the differentiated columns.   shape : of its value."""

    name: str
    part: slice
    shape: tuple[int, ...]
    unit: str


TIME = _Quantity("t", slice(0, 1), (), "s")


def sensitivities(
    derivatives: Derivatives,
    output: Output,
    model: Model,
    history: pa.Table | None,
    events: pa.Table | None,
    metadata: str,
) -> Sensitivities:
    """Return the tables of derivatives.   history, events : of the run, whose rows they share."""
    count = len(output.status)
    columns = {"trajectory": numbers(np.arange(count, dtype=np.int64)), "t": numbers(output.t)}
    fields = [pa.field(name, array.type) for name, array in columns.items()]
    ends = [*_columns(derivatives, _chosen(derivatives.ends), model)]
    named = ((each, of) for each in model.observables for of in DIFFERENTIATED)
    for i, (each, of) in enumerate(named):
        statistic = _Quantity(f"{each.name}_{of}", slice(i, i + 1), (), each.unit)
        ends += _of(derivatives, statistic, _chosen(derivatives.statistics))
    if any(event.terminal for event in model.events):
        ends += _of(derivatives, TIME, _chosen(derivatives.times[None]))
    first = [*zip(fields, columns.values(), strict=True)]
    tables: list[pa.Table | None] = [_table(first, ends, metadata), None, None]
    if history is not None:
        same = _same(history, ("trajectory", "step", "t"))
        tables[1] = _table(same, [*_columns(derivatives, derivatives.rows_of, model)], metadata)
    if events is not None:
        at_events = [
            *_columns(derivatives, _chosen(derivatives.events), model),
            *_of(derivatives, TIME, _chosen(derivatives.event_times[None])),
        ]
        tables[2] = _table(_same(events, ("trajectory", "event", "t")), at_events, metadata)
    return Sensitivities(*tables)


Column = tuple[pa.Field, pa.Array]
Choice = Callable[[slice, slice], Array]  # derivatives of columns along directions, […, of, by]


def _same(table: pa.Table, names: Sequence[str]) -> list[Column]:
    return [(table.schema.field(name), table[name]) for name in names]


def _table(first: list[Column], rest: list[Column], metadata: str) -> pa.Table:
    fields, arrays = zip(*first, *rest, strict=True)
    return pa.Table.from_arrays(list(arrays), schema=pa.schema(fields, {"lierb": metadata}))


def _chosen(array: Array) -> Choice:
    """Return a choice of [column][direction][row]."""
    return lambda of, by: np.moveaxis(array[of, by], -1, 0)


def _columns(derivatives: Derivatives, chosen: Choice, model: Model) -> Iterator[Column]:
    """Yield the columns of all quantities."""
    for quantity in _quantities(derivatives.columns, model):
        yield from _of(derivatives, quantity, chosen)


def _of(derivatives: Derivatives, quantity: _Quantity, chosen: Choice) -> Iterator[Column]:
    """Yield a column for each parameter."""
    directions = slices_of(derivatives.parameters)
    for p in derivatives.parameters:
        part = chosen(quantity.part, directions[p.name])
        flat = part.reshape(prod(part.shape[:-2]), prod(part.shape[-2:]))
        column = vectors(np.ascontiguousarray(flat))
        shape = ", ".join(map(str, (*quantity.shape, p.size)))
        described = {UNIT: quantity.unit, PER: p.unit, SHAPE: shape}
        name = f"{quantity.name}{SEPARATOR}{p.name}"
        yield pa.field(name, column.type, metadata=described), column


def _quantities(columns: Columns, model: Model) -> Iterator[_Quantity]:
    """Yield the differentiated quantities, in the order of their columns."""
    start = columns["links"].start
    for link in model.link_names:
        for name, units in (("pose", POSE_UNITS), ("twist", TWIST_UNITS)):
            yield _Quantity(qualified(link, name), slice(start, start + 6), (6,), units)
            start += 6
    for name, shape, unit in model.signals:
        yield _Quantity(name, slice(start, start + prod(shape)), shape, unit)
        start += prod(shape)
    for measure in MEASURES:
        if measure.name == "energy" or (measure.name == "work" and columns.field("work").width):
            yield _Quantity(measure.name, columns[measure.name], (), measure.unit)
    for i, each in enumerate(model.observables, columns["observables"].start):
        yield _Quantity(each.name, slice(i, i + 1), (), each.unit)
    start = columns["multipliers"].start
    for name, rows in model.rows_by_name if columns.field("multipliers").width else ():
        if rows:
            part, units = slice(start, start + len(rows)), ", ".join(row.unit for row in rows)
            yield _Quantity(qualified(name, "lambda"), part, (len(rows),), units)
        start += len(rows)
    start = columns["reactions"].start
    names = model.joint_names or ("",)
    for name in names if columns.field("reactions").width else ():
        label = qualified(name, "reaction")
        yield _Quantity(label, slice(start, start + 6), (6,), REACTION_UNITS)
        start += 6
