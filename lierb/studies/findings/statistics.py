"""Compute statistics of a study's bodies: quantiles with intervals, and sensitivity indices."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import pyarrow.compute as pc

from lierb.results.columns import as_array, unit_of
from lierb.studies.description.quantiles import (
    CONFIDENCE,
    PROBABILITIES,
    Quantile,
    quantiles_of,
)
from lierb.studies.description.settings import Setting
from lierb.studies.description.stopping import observed_columns
from lierb.studies.findings.columns import ok_columns, rows_of
from lierb.studies.findings.sizes import errors_seen
from lierb.studies.storage.results import IS_SUCCESS, Results
from lierb.support.arrays import Array
from lierb.support.extras import require

MOST_NUMBERS = 2**24  # most numbers read at once from a history: 128 MB


class Spread(NamedTuple):
    """Hold the quantiles of a quantity over the bodies in one setting.

    bodies : number of ok bodies with a number.   undefined : number of ok bodies with NaN.
    quantiles : see `quantiles_of`.
    """

    setting: Setting
    name: str
    unit: str
    bodies: int
    undefined: int
    quantiles: tuple[Quantile, ...]


def quantities(dataset: Results, probabilities: Sequence[float] = PROBABILITIES) -> list[Spread]:
    """Return quantiles, with intervals, of the errors that are not zero and of all observables.

    probabilities : of the quantiles; 0.5 is the median.
    """
    columns, schema = [*errors_seen(dataset).values()], dataset.table().schema
    columns += observed_columns(dataset.study.batch(0, 1).problem)
    spreads = []
    for setting in dataset.study.settings:
        for name in columns:
            rows = ok_columns(dataset, setting, ["trajectory", name])
            is_number = ~np.isnan(rows[name])
            values, bodies = rows[name][is_number], rows["trajectory"][is_number]
            own = dataset.study.design.independent(bodies)
            quantiles = quantiles_of(values, own, probabilities)
            unit, undefined = unit_of(schema.field(name)), len(is_number) - len(values)
            spreads.append(Spread(setting, name, unit, len(values), undefined, quantiles))
    return spreads


# ---- over time ---------------------------------------------------------------------------------


def quantiles_over_time(
    dataset: Results,
    name: str,
    setting: Setting,
    probabilities: Sequence[float],
    of: Callable[[Array], Array] = np.asarray,
) -> tuple[Array, Array]:
    """Return times, s, and quantiles of a column of the history at each, over the ok bodies.

    Bodies that failed do not count, not even before they did; those that an event has ended count
    until then.

    of : function of the numbers, such as np.abs.

    The quantiles are (probabilities, times), NaN without a body. The history may be larger than the
    memory: at most MOST_NUMBERS are read at once.
    """
    history = dataset.table("history")
    failed = dataset.table().to_table(columns=["trajectory"], filter=rows_of(setting) & ~IS_SUCCESS)
    rows = rows_of(setting) & ~pc.field("trajectory").isin(failed["trajectory"])
    times = _times(dataset, setting)
    most = max(1, MOST_NUMBERS // max(1, history.count_rows(filter=rows) // max(1, len(times))))
    steps, quantiles = list(times), []
    for first in range(0, len(steps), most):
        some = steps[first : first + most]
        inside = (pc.field("step") >= some[0]) & (pc.field("step") <= some[-1])
        table = history.to_table(columns=["step", name], filter=rows & inside)
        values, at = of(as_array(table[name])), as_array(table["step"])
        order = np.argsort(at, kind="stable")
        starts = np.searchsorted(at[order], some[1:])
        for group in np.split(values[order], starts):
            alive = group[~np.isnan(group)]
            some_alive = alive if len(alive) else [np.nan]
            quantiles.append(np.quantile(some_alive, probabilities, method="inverted_cdf"))
    return np.array([*times.values()]), np.reshape(quantiles, (-1, len(probabilities))).T


def _times(dataset: Results, setting: Setting) -> dict[int, float]:
    """Return the times of the saved steps, in order; all bodies of a setting share them."""
    first = dataset.table().head(1, columns=["trajectory"], filter=rows_of(setting))
    if not first.num_rows:
        return {}
    (body,) = first["trajectory"].to_pylist()
    own = rows_of(setting) & (pc.field("trajectory") == body)
    table = dataset.table("history").to_table(columns=["step", "t"], filter=own)
    return dict(sorted(zip(table["step"].to_pylist(), table["t"].to_pylist(), strict=True)))


# ---- sensitivity -------------------------------------------------------------------------------

RESAMPLED = 200  # bootstrap samples for an index's interval
LEAST_ROWS = 16  # with fewer, bootstrapped intervals contain the index in half of all studies


class _Index(NamedTuple):
    """Hold an index with its confidence interval."""

    value: float
    low: float
    high: float


class Sensitivity(NamedTuple):
    """A sampled quantity accounts for shares of a column's variance, in one setting.

    first : of the quantity alone.   total : with its interactions. NaN if all bodies have the same
        value, or too few bodies are ok.
    rows : number of the design's rows that are used.
    """

    setting: Setting
    column: str
    quantity: str
    first: _Index
    total: _Index
    rows: int


def indices(dataset: Results) -> list[Sensitivity]:
    """Return Sobol's indices of the observables, or else of the errors; [] for other designs.

    By `scipy.stats.sobol_indices`: first order by Saltelli et al. (2010), total by Jansen (1999).
    The first 2ᵏ rows of the design are used, up to the first body that is not ok, not done, or has
    no number. Intervals are percentiles of bootstrapped rows.
    """
    design, found = dataset.study.design, []
    if design.method != "saltelli":
        return []
    each = len(design.drawn) + 2
    observed = observed_columns(dataset.study.batch(0, 1).problem)
    for setting in dataset.study.settings:
        for column in observed or errors_seen(dataset).values():
            values = np.full(design.n, np.nan)
            is_ok = rows_of(setting) & IS_SUCCESS
            table = dataset.table().to_table(columns=["trajectory", column], filter=is_ok)
            values[as_array(table["trajectory"])] = as_array(table[column])
            whole = np.isfinite(values.reshape(-1, each)).all(axis=1)
            count = len(whole) if whole.all() else int(whole.argmin())
            rows = 1 << count.bit_length() - 1 if count else 0
            both = _indices(values[: rows * each].reshape(-1, each))
            for j, name in enumerate(design.drawn):
                first, total = (_Index(*map(float, part[:, j])) for part in both)
                found.append(Sensitivity(setting, column, name, first, total, rows))
    return found


def _indices(values: Array) -> tuple[Array, Array]:
    """Return first and total indices, (value, low, high) × quantity.   values : (rows, 2 + q)."""
    rows, width = values.shape
    if rows < LEAST_ROWS or np.ptp(values) == 0.0:
        nothing = np.full((3, width - 2), np.nan)
        return nothing, nothing
    random, estimates = np.random.default_rng(0), [_estimated(values)]
    estimates += [_estimated(values[random.integers(rows, size=rows)]) for _ in range(RESAMPLED)]
    low, high = np.quantile(estimates[1:], ((1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2), axis=0)
    first, total = np.stack((estimates[0], low, high), axis=1)
    return first, total


def _estimated(values: Array) -> Array:
    """Return first and total indices, (2, quantities)."""
    require("scipy")
    from scipy.stats import sobol_indices

    # The output is repeated, since SciPy squeezes the axis of a single quantity.
    f = np.repeat(values.T[:, None], 2, axis=1)
    indices = sobol_indices(func={"f_A": f[0], "f_B": f[1], "f_AB": f[2:]}, n=len(values))
    shape = (2, values.shape[1] - 2)
    return np.stack((indices.first_order.reshape(shape)[0], indices.total_order.reshape(shape)[0]))
