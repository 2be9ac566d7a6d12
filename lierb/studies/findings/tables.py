"""Format findings as tables for a terminal."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from lierb.studies.description.quantiles import CONFIDENCE, Quantile
from lierb.studies.findings.findings import LABELS, QUANTILES, SettingErrors, orders
from lierb.studies.findings.occurrences import Occurred
from lierb.studies.findings.statistics import PROBABILITIES, Sensitivity, Spread
from lierb.support.representations import rounded

if TYPE_CHECKING:
    from rich.table import Table

Row = TypeVar("Row", Occurred, Sensitivity, Spread)  # findings with a setting


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
    step = "dt/s" if all(each.setting.rtol is None for each in findings) else "rtol"
    words = ("c-space", "method", step, "bodies", "failed", "largest error of")
    table = empty_table(words, (*(f"{q:.0%}" for q in QUANTILES[:-1]), "all", "order"))
    for each in findings:
        seen, setting = orders(findings, each), each.setting
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


def with_interval(
    numbers: Iterable[float], form: str = ".3g", beyond: str = "inf"
) -> tuple[str, str]:
    """Format a value and its interval; a dash stands for NaN, `beyond` for infinity.

    numbers : value, low, high.
    """
    value, low, high = (
        "–" if np.isnan(x) else beyond if np.isinf(x) else f"{x:{form}}" for x in numbers
    )
    return value, f"{low}…{high}"


def first_time(quantile: Quantile, t_end: float) -> tuple[str, str]:
    """Format a quantile of a time, which may lie beyond t_end, and its interval."""
    return with_interval(quantile[1:], beyond=f"> {t_end:g}")


def named(name: str, unit: str) -> str:
    return f"{name}, {unit}" if unit != "1" else name


def with_unit(spread: Spread) -> str:
    """Format a quantity's name, its unit, and the number of bodies without a number."""
    name = named(spread.name, spread.unit)
    return f"{name} (not a number: {spread.undefined})" if spread.undefined else name


def _in_sections(
    table: Table,
    rows: Iterable[Row],
    title: Callable[[Row], str] = lambda each: each.setting.label,
) -> Iterator[Row]:
    """Yield the items; each new title is first added as a row of its own."""
    before = None
    for each in rows:
        section = each.setting, title(each)
        if section != before:
            table.add_section()
            table.add_row(section[1])
            before = section
        yield each


def table_of_quantities(rows: list[Spread]) -> Table:
    """Make the table of the quantiles."""
    words = (f"quantiles, their {CONFIDENCE:.0%} intervals",)
    table = empty_table(words, [f"{p:.0%}" for p in PROBABILITIES])
    for each in _in_sections(table, rows):
        values, intervals = zip(*(with_interval(q[1:]) for q in each.quantiles), strict=True)
        table.add_row(f"  {with_unit(each)}", *values)
        table.add_row("", *intervals)
    return table


def table_of_events(rows: list[Occurred], t_end: float) -> Table:
    """Make the table of the events."""
    words = (f"events; first time, s, its {CONFIDENCE:.0%} interval",)
    table = empty_table(words, ("in all", "bodies", *(f"{p:.0%}" for p in PROBABILITIES)))
    for each in _in_sections(table, rows):
        values, intervals = zip(*(first_time(q, t_end) for q in each.first), strict=True)
        bodies = f"{each.bodies} of {each.of}"
        table.add_row(f"  {each.name}", str(each.crossings), bodies, *values)
        table.add_row("", "", "", *intervals)
    return table


def table_of_indices(rows: list[Sensitivity]) -> Table:
    """Make the table of the sensitivity indices."""
    interval = f"{CONFIDENCE:.0%} interval"
    words = ("share of the variance due to",)
    table = empty_table(words, ("alone", interval, "in all", interval))
    title = lambda each: f"{each.column}, {each.setting.label}"
    for each in _in_sections(table, rows, title):
        table.add_row(
            f"  {each.quantity}",
            *with_interval(each.first, ".3f"),
            *with_interval(each.total, ".3f"),
        )
    return table
