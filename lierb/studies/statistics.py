"""What a study's bodies tell of all that might have been drawn: quantiles with their intervals."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from lierb.arrays import Array
from lierb.errors import require_name
from lierb.kernels.stepping.observables import KEEPS
from lierb.studies.dataset import Dataset
from lierb.studies.quantiles import Quantile, quantile_of
from lierb.studies.sizes import as_array, rows_of
from lierb.studies.study import Setting, Study

PROBABILITIES = (0.05, 0.5, 0.95)
MOST_NUMBERS = 2**24  # of a history that are looked at together, 128 MB


class Spread(NamedTuple):
    """A quantity of the bodies in one setting.

    bodies : those that are ok and for which it is a number.   undefined : ok, and it is none.
    """

    setting: Setting
    name: str
    unit: str
    bodies: int
    undefined: int
    quantiles: tuple[Quantile, ...]


def observed_columns(dataset: Dataset, study: Study) -> dict[str, str]:
    """The columns of a summary that observables have, and their units."""
    names = [
        f"{element.name}_{how}"
        for element in study.batch(0, 1).problem.observables
        for how in KEEPS
    ]
    schema = dataset.table().schema
    return {name: (schema.field(name).metadata or {}).get(b"unit", b"1").decode() for name in names}


def spreads(
    dataset: Dataset,
    study: Study,
    columns: dict[str, str],
    probabilities: Sequence[float] = PROBABILITIES,
) -> Iterator[Spread]:
    """Quantiles of columns of the summary, setting by setting.   columns : with their units."""
    for setting in study.settings:
        for name, unit in columns.items():
            values = _ok_values(dataset, setting, name)
            ordered = np.sort(values[~np.isnan(values)])
            found = tuple(quantile_of(ordered, p) for p in probabilities)
            yield Spread(setting, name, unit, len(ordered), len(values) - len(ordered), found)


def _ok_values(dataset: Dataset, setting: Setting, name: str) -> Array:
    """A column of the bodies that are ok in a setting."""
    is_ok = pc.field("status") == "ok"
    table = dataset.table().to_table(columns=[name], filter=rows_of(setting) & is_ok)
    return as_array(table, name)


# ---- over time ---------------------------------------------------------------------------------


def percentiles_over_time(
    dataset: Dataset,
    name: str,
    setting: Setting,
    percentiles: Sequence[float] = (5.0, 50.0, 95.0),
) -> pa.Table:
    """Percentiles of a column of the history, over the bodies that have a number at each time.

    Returns a table of step, t, bodies and a column for each, such as p5 and p97.5, in the column's
    unit. The history may be larger than the memory: so many times are read at once as fit 128 MB.

    Raises UnknownNameError for a column that is none of one number.
    """
    history = dataset.table("history")
    schema = history.schema
    scalar = [f.name for f in schema if pa.types.is_float64(f.type) and f.name not in ("t", "dt")]
    require_name("name", name, scalar)
    probabilities = np.asarray(percentiles, dtype=float) / 100.0
    rows = rows_of(setting)
    times = _times(dataset, setting)
    most = max(1, MOST_NUMBERS // max(1, history.count_rows(filter=rows) // max(1, len(times))))
    steps, found, counts = list(times), [], []
    for first in range(0, len(steps), most):
        some = steps[first : first + most]
        inside = (pc.field("step") >= some[0]) & (pc.field("step") <= some[-1])
        table = history.to_table(columns=["step", name], filter=rows & inside)
        values, at = as_array(table, name), as_array(table, "step")
        order = np.argsort(at, kind="stable")
        starts = np.searchsorted(at[order], some[1:])
        for group in np.split(values[order], starts):
            alive = group[~np.isnan(group)]
            counts.append(len(alive))
            none = np.full(len(probabilities), np.nan)
            is_any = len(alive) > 0
            found.append(
                np.quantile(alive, probabilities, method="inverted_cdf") if is_any else none
            )
    unit = schema.field(name).metadata
    columns = np.array(found).reshape(-1, len(probabilities)).T
    fields = [
        pa.field("step", pa.int64()),
        pa.field("t", pa.float64(), metadata={"unit": "s"}),
        pa.field("bodies", pa.int64()),
        *(pa.field(f"p{p:g}", pa.float64(), metadata=unit) for p in percentiles),
    ]
    arrays = [steps, [times[step] for step in steps], counts, *columns]
    return pa.table([pa.array(a) for a in arrays], schema=pa.schema(fields))


def _times(dataset: Dataset, setting: Setting) -> dict[int, float]:
    """When each saved step is, in order; the same for all bodies of a setting."""
    first = dataset.table().head(1, columns=["trajectory"], filter=rows_of(setting))
    if not first.num_rows:
        return {}
    (body,) = first["trajectory"].to_pylist()
    own = rows_of(setting) & (pc.field("trajectory") == body)
    table = dataset.table("history").to_table(columns=["step", "t"], filter=own)
    return dict(sorted(zip(table["step"].to_pylist(), table["t"].to_pylist(), strict=True)))
