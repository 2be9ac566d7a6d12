"""Format tables of a comparison as text: headers and cells, Markdown and LaTeX."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import pyarrow as pa

from lierb.analysis.comparison_orders import FLOOR, Observed
from lierb.analysis.reference import ERRORS
from lierb.errors import require_name
from lierb.support.representations import rounded

TextTable = tuple[list[str], list[list[str]]]  # header, rows

QUANTITIES = {
    **{f"error.{name}": unit for name, unit in ERRORS.items()},
    "drift.position": "m", "drift.rotation": "1", "drift.energy": "J",
}  # fmt: skip
UNITS = {
    "dt": "s", "rtol": "1", "step": "s", "steps": "1", "rejected": "1", "evaluations": "1",
    "cpu_time": "s", "trajectories": "1", "failed": "1", **QUANTITIES,
}  # fmt: skip
LABELS = {
    "method": "method", "cspace": "c-space", "dt": "dt", "rtol": "rtol", "steps": "steps",
    "rejected": "rejected", "evaluations": "evaluations", "cpu_time": "CPU time",
    "failed": "failed", "error.rotation": "rotation", "error.position": "position",
    "error.omega": "ω", "error.v": "v", "drift.position": "joint position",
    "drift.rotation": "joint rotation", "drift.energy": "energy",
}  # fmt: skip
MATH_NAMES = {"SE3": "$SE(3)$", "SO3xR3": r"$SO(3)\times\mathbb{R}^3$"}  # in LaTeX
ESCAPED = {
    "\\": r"\textbackslash{}", "&": r"\&", "%": r"\%", "$": r"\$", "#": r"\#", "_": r"\_",
    "{": r"\{", "}": r"\}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}",
    "ω": r"$\omega$", "≥": r"$\geq$", "×": r"$\times$", "≤": r"$\leq$", "²": "$^2$", "–": "--",
    "−": "$-$", "…": r"\ldots{}",
}  # fmt: skip
ORDERS_NOTE = (
    "Orders are slopes of log error over log step, least squares from the finest step on as far as "
    "the slope stays the same; (3 of 4) counts the runs that were taken, with 2 none was left to "
    "say whether it does. Errors that are rounding, or at least half as large as what they are "
    "errors of, show no order."
)


def table_of_runs(table: pa.Table, columns: Iterable[str] | None) -> TextTable:
    """Return columns of a comparison's table as text; default: all with numbers except floors."""
    if columns is None:
        names = [name for name in LABELS if _has_numbers(name, table[name])]
    else:
        names = [columns] if isinstance(columns, str) else list(columns)
        for name in names:
            require_name("columns", name, table.column_names)
    cells = [_cells(name, table) for name in names]
    return [_header(name) for name in names], [list(row) for row in zip(*cells, strict=True)]


def table_of_orders(orders: Sequence[Observed]) -> TextTable:
    """Return observed orders as text, a row for each method, c-space and control of the steps."""
    quantities = list(dict.fromkeys(each.quantity for each in orders))
    keys = dict.fromkeys((e.method, e.cspace, e.control) for e in orders)
    texts = {(e.method, e.cspace, e.control, e.quantity): e.text for e in orders}
    rows = [
        [*key[:2], "dt" if key[2] == "dt" else "mean step", *(texts[*key, q] for q in quantities)]
        for key in keys
    ]
    return ["method", "c-space", "over", *(LABELS[each] for each in quantities)], rows


def _has_numbers(name: str, column: pa.ChunkedArray) -> bool:
    if name in ("rejected", "failed"):
        return any(column.to_pylist())
    return bool(column.null_count < len(column))


def _cells(name: str, table: pa.Table) -> list[str]:
    values = table[name].to_pylist()
    if name not in QUANTITIES:
        return [_cell(name, value) for value in values]
    floors = table[name + FLOOR].to_pylist()
    return [
        f"({rounded(value)})" if value and value <= floor else _cell(name, value)
        for value, floor in zip(values, floors, strict=True)
    ]


def _header(name: str) -> str:
    label, unit = LABELS.get(name, name), UNITS.get(name.removesuffix(FLOOR), "1")
    unit = "ms" if name == "cpu_time" else unit
    return label if unit == "1" else f"{label}, {unit}"


def _cell(name: str, value: Any) -> str:
    if value is None:
        return "–"
    if isinstance(value, str):
        return value
    if name == "cpu_time":
        return f"{1e3 * value:.3g}"
    if name in ("dt", "rtol", "step"):
        return f"{value:.6g}"
    if name in ("steps", "rejected", "evaluations", "trajectories", "failed"):
        return f"{value:.0f}"
    return rounded(value)


def _in_latex(text: str) -> str:
    """Escape a text for LaTeX; typeset numbers such as 1.2e-05 and c-spaces as mathematics."""

    if text in MATH_NAMES:
        return MATH_NAMES[text]
    inner = text.strip("()")
    mantissa, e, exponent = inner.partition("e")
    try:
        float(inner)
    except ValueError:
        return "".join(ESCAPED.get(letter, letter) for letter in text)
    shown = rf"${mantissa}\cdot 10^{{{int(exponent)}}}$" if e else f"${inner}$"
    return text.replace(inner, shown)


def in_markdown(text_table: TextTable) -> str:
    """Write a table in Markdown."""
    header, rows = text_table
    lines = [header, ["---"] * len(header), *rows]
    cells = ([text.replace("|", r"\|") for text in line] for line in lines)
    return "\n".join(f"| {' | '.join(line)} |" for line in cells)


def in_latex(text_table: TextTable, caption: str) -> str:
    """Write a table in LaTeX, with the rules of booktabs."""
    header, rows = text_table
    words = sum(name in ("method", "c-space", "over") for name in header)
    lines = [
        r"\begin{table}",
        r"\centering",
        rf"\begin{{tabular}}{{{'l' * words}{'r' * (len(header) - words)}}}",
        r"\toprule",
        rf"{' & '.join(map(_in_latex, header))} \\",
        r"\midrule",
        *(rf"{' & '.join(map(_in_latex, row))} \\" for row in rows),
        r"\bottomrule",
        r"\end{tabular}",
        rf"\caption{{{_in_latex(caption)}}}",
        r"\end{table}",
    ]
    return "\n".join(lines) + "\n"
