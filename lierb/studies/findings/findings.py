"""Findings of a study, setting by setting: error quantiles, failures, observed orders."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeVar

import numpy as np
import pyarrow as pa
from pydantic import ValidationError

from lierb.analysis.convergence import Order, observed_order
from lierb.analysis.magnitudes import kinds_of
from lierb.errors import StudyError
from lierb.results.failures import has_failed
from lierb.studies.description.quantiles import CONFIDENCE, Quantile, quantile_of
from lierb.studies.description.settings import Setting
from lierb.studies.description.study import Study
from lierb.studies.findings.occurrences import Occurred, occurrences
from lierb.studies.findings.sizes import as_array, rows_of, sizes_of
from lierb.studies.findings.statistics import (
    PROBABILITIES,
    Sensitivity,
    Spread,
    observed_columns,
    sensitivities,
    spreads,
)
from lierb.studies.storage.results import IS_FINE, Results
from lierb.support.arrays import Array
from lierb.support.shown import rounded

if TYPE_CHECKING:
    from rich.table import Table

Told = TypeVar("Told", Occurred, Sensitivity, Spread)  # what has a setting

ERRORS = {
    "position": "position_error_max",
    "rotation": "rotation_error_max",
    "energy": "energy_drift_max",
}
LABELS = {"position": "position, m", "rotation": "rotation", "energy": "energy, J"}
QUANTILES = (0.5, 0.95, 1.0)
NEGLIGIBLE = 1e-18  # an error below this is none, relative to the problem's own size


@dataclass(frozen=True)
class Found:
    """Errors of the bodies in one setting of a study.

    bodies : finished ones.   failed : those of them whose status is not ok.
    quantiles : of each of ERRORS, in the order of QUANTILES, over the bodies that are ok; NaN where
        there are none, and for an error that the joint has no rows for.
    sizes : of what each of ERRORS is an error of; see `lierb.studies.findings.sizes`.
    intervals : of each quantile but the largest, the two ends of its confidence interval; see
        `lierb.studies.findings.statistics`.
    """

    setting: Setting
    bodies: int
    failed: int
    quantiles: dict[str, Array]
    sizes: dict[str, float]
    intervals: dict[str, Array]


def study_of(dataset: Results) -> Study:
    """Return the study of a folder's results."""
    try:
        return Study.model_validate(dataset.manifest["study"]).with_code(dataset.code())
    except ValidationError as error:
        raise StudyError(f"{dataset.folder} is of another version of lierb: {error}") from None


def findings(dataset: Results) -> list[Found]:
    """Evaluate the finished parts, setting by setting."""
    study = study_of(dataset)
    kinds = (*kinds_of(study.batch(0, 1).problem), "energy")
    return [_found(dataset, study, setting, kinds) for setting in study.settings]


def _found(dataset: Results, study: Study, setting: Setting, kinds: tuple[str, ...]) -> Found:
    names = ["status", *ERRORS.values()]
    rows: pa.Table = dataset.table().to_table(columns=names, filter=rows_of(setting))
    ok = ~has_failed(rows)
    quantiles, intervals = {}, {}
    for kind, name in ERRORS.items():
        values = rows[name].to_numpy()[ok] if kind in kinds else np.empty(0)
        ordered = np.sort(values)
        each = [quantile_of(ordered, p) for p in QUANTILES[:-1]]
        largest = values.max() if len(values) else np.nan
        quantiles[kind] = np.array([*(q.value for q in each), largest])
        intervals[kind] = np.array([(q.low, q.high) for q in each])
    sizes = sizes_of(dataset, study, setting)
    return Found(setting, len(ok), int((~ok).sum()), quantiles, sizes, intervals)


def quantities(dataset: Results) -> list[Spread]:
    """Quantiles, with intervals, of the errors that are not zero and of all observables."""
    study = study_of(dataset)
    units = {kind: label.partition(", ")[2] or "1" for kind, label in LABELS.items()}
    columns = {name: units[kind] for kind, name in errors_seen(dataset, study).items()}
    return list(spreads(dataset, study, columns | observed_columns(dataset, study)))


def happened(dataset: Results) -> list[Occurred]:
    """Number and first times of each event of the problem; [] without events."""
    return list(occurrences(dataset, study_of(dataset)))


def indices(dataset: Results) -> list[Sensitivity]:
    """Sobol's indices of the observables, or else of the errors; [] for other designs."""
    study = study_of(dataset)
    columns = list(observed_columns(dataset, study)) or [*errors_seen(dataset, study).values()]
    return list(sensitivities(dataset, study, columns))


def orders(found: list[Found], of: Found) -> dict[str, Order | None]:
    """Observed orders of the medians over all dt of a c-space and method."""
    same = [
        f for f in found
        if (f.setting.cspace, f.setting.method) == (of.setting.cspace, of.setting.method)
    ]  # fmt: skip
    dts = [f.setting.dt for f in same if f.setting.dt is not None]
    if len(set(dts)) < 2 or len(dts) < len(same):
        return dict.fromkeys(ERRORS)
    return {
        kind: observed_order(
            dts, [f.quantiles[kind][0] for f in same], [f.sizes[kind] for f in same]
        )
        for kind in ERRORS
    }


# ---- columns -----------------------------------------------------------------------------------


def ok_columns(dataset: Results, setting: Setting, names: list[str]) -> dict[str, Array]:
    """Read columns of the bodies that are ok in a setting; lists as (n, k)."""
    table = dataset.table().to_table(columns=names, filter=rows_of(setting) & IS_FINE)
    return {name: as_array(table, name) for name in names}


def drawn_columns(dataset: Results) -> dict[str, str]:
    """Names of the columns of sampled quantities, and their units."""
    fields = [field for field in dataset.table().schema if field.name.startswith("sample.")]
    return {field.name: (field.metadata or {}).get(b"unit", b"1").decode() for field in fields}


def some_rows(rows: int, most: int) -> Array:
    """Indices of at most so many rows, at random: Sobol points are periodic."""
    chosen = np.random.default_rng(0).permutation(rows)[:most]
    return np.sort(chosen)


def errors_seen(dataset: Results, study: Study) -> dict[str, str]:
    """Return the errors that are not negligible, and their columns."""
    seen = set()
    for setting in study.settings:
        columns = ok_columns(dataset, setting, list(ERRORS.values()))
        for kind, size in sizes_of(dataset, study, setting).items():
            if columns[ERRORS[kind]].max(initial=0.0) > NEGLIGIBLE * size:
                seen.add(kind)
    return {kind: name for kind, name in ERRORS.items() if kind in (seen or {"energy"})}


def least_drawn(dataset: Results, study: Study) -> dict[str, float]:
    """Least error of each kind that a logarithmic axis shows."""
    sizes = [sizes_of(dataset, study, setting) for setting in study.settings]
    return {kind: NEGLIGIBLE * (min(s[kind] for s in sizes) or 1.0) for kind in ERRORS}


# ---- for a terminal ----------------------------------------------------------------------------


def empty_table(words: Sequence[str], numbers: Sequence[str]) -> Table:
    """Make a table for a terminal, with columns of words and of numbers, and no rows."""
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, show_edge=False, pad_edge=False, padding=(0, 1))
    for column in words:
        table.add_column(column, no_wrap=True)
    for column in numbers:
        table.add_column(column, no_wrap=True, justify="right")
    return table


def table_of(found: list[Found]) -> Table:
    """Make the table of the errors."""
    step = "dt/s" if all(each.setting.rtol is None for each in found) else "rtol"
    words = ("c-space", "method", step, "bodies", "failed", "largest error of")
    table = empty_table(words, (*(f"{q:.0%}" for q in QUANTILES[:-1]), "all", "order"))
    for each in found:
        seen, setting = orders(found, each), each.setting
        heads = [
            setting.cspace,
            setting.method,
            f"{setting.step:g}",
            str(each.bodies),
            str(each.failed),
        ]
        for kind, label in LABELS.items():
            quantiles = [rounded(x) for x in each.quantiles[kind]]
            order = "" if seen[kind] is None else str(seen[kind])
            table.add_row(*heads, label, *quantiles, order)
            heads = [""] * len(heads)
        table.add_section()
    return table


def quantile_told(quantile: Quantile) -> tuple[str, str]:
    """Format a quantile and its interval with three digits; a dash if there is none."""
    value, low, high = (
        "–" if np.isnan(x) else f"{x:.3g}" for x in (quantile.value, quantile.low, quantile.high)
    )
    return value, f"{low}…{high}"


def first_told(quantile: Quantile, t_end: float) -> tuple[str, str]:
    """Format a quantile of a time, which may lie beyond t_end, and its interval."""
    value, low, high = (
        "–" if np.isnan(x) else f"> {t_end:g}" if np.isinf(x) else f"{x:.3g}"
        for x in (quantile.value, quantile.low, quantile.high)
    )
    return value, f"{low}…{high}"


def with_unit(spread: Spread) -> str:
    """Format a quantity's name, its unit, and the number of bodies without a number."""
    name = f"{spread.name}, {spread.unit}" if spread.unit != "1" else spread.name
    return f"{name} (not a number: {spread.undefined})" if spread.undefined else name


def _in_sections(
    table: Table,
    found: Iterable[Told],
    title: Callable[[Told], str] = lambda each: each.setting.label,
) -> Iterator[Told]:
    """Yield the items; each new title is first added as a row of its own."""
    before = None
    for each in found:
        section = each.setting, title(each)
        if section != before:
            table.add_section()
            table.add_row(section[1])
            before = section
        yield each


def table_of_quantities(found: list[Spread]) -> Table:
    """Make the table of the quantiles."""
    words = (f"quantiles, their {CONFIDENCE:.0%} intervals",)
    table = empty_table(words, [f"{p:.0%}" for p in PROBABILITIES])
    for each in _in_sections(table, found):
        values, intervals = zip(*map(quantile_told, each.quantiles), strict=True)
        table.add_row(f"  {with_unit(each)}", *values)
        table.add_row("", *intervals)
    return table


def table_of_events(found: list[Occurred], t_end: float) -> Table:
    """Make the table of the events."""
    words = (f"events; first time, s, its {CONFIDENCE:.0%} interval",)
    table = empty_table(words, ("in all", "bodies", *(f"{p:.0%}" for p in PROBABILITIES)))
    for each in _in_sections(table, found):
        values, intervals = zip(*(first_told(q, t_end) for q in each.first), strict=True)
        bodies = f"{each.bodies} of {each.of}"
        table.add_row(f"  {each.name}", str(each.crossings), bodies, *values)
        table.add_row("", "", "", *intervals)
    return table


def index_told(index: tuple[float, float, float]) -> tuple[str, str]:
    """Format a sensitivity index and its interval."""
    value, low, high = ("–" if np.isnan(x) else f"{x:.3f}" for x in index)
    return value, f"{low}…{high}"


def table_of_indices(found: list[Sensitivity]) -> Table:
    """Make the table of the sensitivity indices."""
    interval = f"{CONFIDENCE:.0%} interval"
    words = ("share of the variance due to",)
    table = empty_table(words, ("alone", interval, "in all", interval))
    title = lambda each: f"{each.column}, {each.setting.label}"
    for each in _in_sections(table, found, title):
        table.add_row(f"  {each.quantity}", *index_told(each.first), *index_told(each.total))
    return table
