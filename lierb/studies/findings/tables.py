"""Format findings as tables for a terminal."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import zip_longest
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from lierb.studies.description.quantiles import CONFIDENCE, Quantile, percent
from lierb.studies.findings.findings import LABELS, SettingErrors, orders
from lierb.studies.findings.linear_theory import LinearTheory
from lierb.studies.findings.occurrences import Occurred
from lierb.studies.findings.statistics import Sensitivity, Spread
from lierb.support.representations import counted, digits_apart, rounded

if TYPE_CHECKING:
    from rich.table import Table

Row = TypeVar("Row", LinearTheory, Occurred, Sensitivity, Spread)  # findings with a setting


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


def table_of(findings: list[SettingErrors]) -> Table:
    """Make the table of the errors."""
    words = ("largest error of",)
    table = empty_table(words, ("bodies", "failed", "median", "largest", "order"))
    for each in findings:
        seen = orders(findings, each)
        table.add_section()
        table.add_row(each.setting.label, str(each.bodies), str(each.failed))
        for kind, label in LABELS.items():
            median, *_, largest = map(rounded, each.quantiles[kind])
            order = "" if seen[kind] is None else str(seen[kind])
            table.add_row(f"  {label}", "", "", median, largest, order)
    return table


def with_interval(
    numbers: Iterable[float], form: str = ".3g", beyond: str = "inf"
) -> tuple[str, str]:
    """Format a value and its interval; a dash stands for NaN, `beyond` for infinity.

    numbers : value, low, high.
    """
    value, low, high = (
        "–" if np.isnan(x) else "−" * (x < 0.0) + beyond if np.isinf(x) else f"{x:{form}}"
        for x in numbers
    )
    return value, f"{low}…{high}"


def named(name: str, unit: str) -> str:
    return f"{name}, {unit}" if unit not in ("", "1") else name


def _in_sections(table: Table, rows: Iterable[Row]) -> Iterator[Row]:
    """Yield the items; each new setting is first added as a row of its own."""
    before = None
    for each in rows:
        if each.setting != before:
            table.add_section()
            table.add_row(each.setting.label)
            before = each.setting
        yield each


def form_of(quantile: Quantile, row: Iterable[Quantile]) -> str:
    """Return the format of a quantile and its interval, with digits that tell them apart.

    row : quantiles beside it, from which it differs too.
    """
    beside = [quantile.low, quantile.high, *(each.value for each in row)]
    return f".{digits_apart(quantile.value, beside)}g"


def _quantile_rows(row: Sequence[Quantile], beyond: str = "inf") -> list[list[str]]:
    return [[percent(q.probability), *with_interval(q[1:], form_of(q, row), beyond)] for q in row]


def _add_rows(table: Table, names: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """Add rows.   names : lines of the first column."""
    for name, row in zip_longest((f"  {name}" for name in names), rows):
        table.add_row(name, *row or ())


INTERVAL = f"{CONFIDENCE:.0%} interval"


def table_of_quantities(rows: list[Spread]) -> Table:
    """Make the table of the quantiles."""
    table = empty_table(("quantiles over the bodies",), ("", "value", INTERVAL))
    for each in _in_sections(table, rows):
        names = [named(each.name, each.unit)]
        names += [f"  not a number: {each.undefined}"] if each.undefined else []
        _add_rows(table, names, _quantile_rows(each.quantiles))
    return table


def table_of_events(rows: list[Occurred], t_end: float) -> Table:
    """Make the table of the events."""
    table = empty_table(("events",), ("", "first time, s", INTERVAL))
    for each in _in_sections(table, rows):
        names = [
            each.name,
            f"  in {each.bodies} of {counted(each.of, 'body', 'bodies')}",
            f"  {each.crossings} in all",
        ]
        _add_rows(table, names, _quantile_rows(each.first, f"> {t_end:g}"))
    return table


def table_of_indices(rows: list[Sensitivity]) -> Table:
    """Make the table of the sensitivity indices."""
    words = ("share of the variance due to",)
    table = empty_table(words, ("alone", INTERVAL, "in all", INTERVAL))
    before = None
    for each in _in_sections(table, rows):
        if (each.setting, each.column) != before:
            table.add_row(f"  {each.column}, of {counted(each.rows, 'row')}")
            before = each.setting, each.column
        table.add_row(
            f"    {each.quantity}",
            *with_interval(each.first, ".3f"),
            *with_interval(each.total, ".3f"),
        )
    return table


def table_of_linear_theory(rows: list[LinearTheory]) -> Table:
    """Make the table of importance factors, and of linear percentiles beside sampled ones."""
    table = empty_table(("linear theory: share of variance",), ("", "linear", "sampled", INTERVAL))
    for each in _in_sections(table, rows):
        names = [named(each.name, each.unit), *(f"  {share}" for share in shares_of(each))]
        linear = [f"{x:{form_of(q, each.sampled)}}" for x, q in zip(each.linear, each.sampled)]
        rows_of = zip(linear, _quantile_rows(each.sampled))
        _add_rows(table, names, [[p, x, *q] for x, (p, *q) in rows_of])
    return table


def shares_of(theory: LinearTheory) -> list[str]:
    """Format the importance factors, the largest first."""
    shares = sorted(theory.shares.items(), key=lambda pair: -pair[1])
    return [f"{share:.3f} {quantity}" for quantity, share in shares]
