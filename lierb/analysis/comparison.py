"""What a comparison of methods found: its table, observed orders, and what is written of them."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from lierb.analysis.convergence import EXACT, Order, fitted_order, verdict
from lierb.analysis.reference import ERRORS
from lierb.errors import ArgumentError, require_name
from lierb.methods import ButcherTableau
from lierb.support.extras import is_installed, require
from lierb.support.files import folder_of, naming, write_whole
from lierb.support.shown import Lines, Shown, counted, rounded

if TYPE_CHECKING:
    from matplotlib.figure import Figure

QUANTITIES = {
    **{f"error.{name}": unit for name, unit in ERRORS.items()},
    "drift.position": "m", "drift.rotation": "1", "drift.energy": "J",
}  # fmt: skip
FLOOR = ".floor"  # after a quantity's name: the column of what it has to exceed to be believed
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
MATH_NAMES = {"SE3": "$SE(3)$", "SO3xR3": r"$SO(3)\times\mathbb{R}^3$"}
ESCAPED = {
    "\\": r"\textbackslash{}", "&": r"\&", "%": r"\%", "$": r"\$", "#": r"\#", "_": r"\_",
    "{": r"\{", "}": r"\}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}",
    "ω": r"$\omega$", "≥": r"$\geq$", "×": r"$\times$", "≤": r"$\leq$", "²": "$^2$", "–": "--",
    "−": "$-$", "…": r"\ldots{}",
}  # fmt: skip
NAME = "comparison"  # of the files of one


@dataclass(frozen=True)
class Observed:
    """Observed order of a quantity, for a method on a c-space.

    Attributes
    ----------
    method : str
        Name of the method.
    cspace : str
        Configuration space.
    control : {"dt", "rtol"}
        Setting that the steps follow.
    quantity : str
        A column of the comparison's table, such as "error.position".
    order : Order or None
        The order; None where all errors are rounding or below the reference's own.
    of_method : int or None
        Order of the method, where it is known.
    runs : int
        Number of runs.
    verdict : str
        "exact", "order 4", "drifts" …; see `lierb.analysis.convergence`.
    """

    method: str
    cspace: str
    control: str
    quantity: str
    order: Order | None
    of_method: int | None
    runs: int
    verdict: str

    @property
    def told(self) -> str:
        """The order, and from how many of the runs: `3.99 (4 of 5)`."""
        if self.order is None:
            return EXACT if self.quantity.startswith("drift.") else "–"
        if self.order.lower_bound:
            return f"≥ {self.order.slope:.2f}"
        if math.isnan(self.order.slope):
            return "does not fall" if self.order.steps else "–"
        return f"{self.order.slope:.2f} ({len(self.order.steps)} of {self.runs})"


@dataclass(frozen=True, repr=False)
class Comparison(Shown):
    """Comparison of methods, c-spaces and steps, which `lierb.convergence` returns.

    Attributes
    ----------
    table : pyarrow.Table
        A row for each method, c-space and step: method, cspace; dt, s, or rtol; step, s, the mean
        one; steps, rejected and evaluations of right-hand sides, means over trajectories; cpu_time
        of the batch, s; trajectories, failed; error.rotation, error.position, error.omega and
        error.v at t_end, the largest or the median over trajectories; drift.position and
        drift.rotation of the joints, and drift.energy, the largest of the run. Each of these is
        followed by its floor, such as error.v.floor: an error up to that is rounding, or the
        reference's.
    orders : tuple of Observed
        Observed orders of all that falls with the step.
    name : str
        Title of figures.
    notes : tuple of str
        Sentences on how the comparison was measured.
    """

    table: pa.Table
    orders: tuple[Observed, ...]
    name: str
    notes: tuple[str, ...]

    # ---- tables ----

    def order(self, method: str, cspace: str | None = None, quantity: str | None = None) -> float:
        """Return an observed order; NaN where none can be observed.

        With both dts and rtols, a method's order is that over dt.

        Parameters
        ----------
        method : str
            Name of the method.
        cspace : str, optional
            Configuration space; it may be left out where there is one.
        quantity : str, optional
            A column of `table`. Default: error.position, or error.rotation where nothing moves away
            from its place.

        Returns
        -------
        float
            The order.

        Raises
        ------
        UnknownNameError
            The comparison has no such method, c-space or quantity.
        ArgumentError
            There are several c-spaces and none is named.
        """
        if not self.orders:
            raise ArgumentError("each method was run with one step; give two and more for orders")
        require_name("method", method, dict.fromkeys(each.method for each in self.orders))
        if quantity is None:
            moves = any(self.table["error.position"].to_pylist())
            quantity = "error.position" if moves else "error.rotation"
        require_name("quantity", quantity, dict.fromkeys(each.quantity for each in self.orders))
        found = [
            each for each in self.orders
            if each.method == method and each.quantity == quantity and cspace in (None, each.cspace)
        ]  # fmt: skip
        if cspace is not None:
            require_name("cspace", cspace, dict.fromkeys(each.cspace for each in self.orders))
        if len({each.cspace for each in found}) > 1:
            names = ", ".join(dict.fromkeys(each.cspace for each in found))
            raise ArgumentError(f"{method} was run on {names}; give cspace= as well")
        order = found[0].order
        return math.nan if order is None else order.slope

    def to_markdown(self, columns: Iterable[str] | None = None) -> str:
        """Write tables of the runs and of the orders, and the notes, as Markdown.

        Parameters
        ----------
        columns : iterable of str, optional
            Columns of `table`. Default: all that have numbers, except floors.

        Returns
        -------
        str
            The text.
        """
        parts = []
        for header, rows in self.told(columns):
            lines = [header, ["---"] * len(header), *rows]
            parts.append("\n".join(f"| {' | '.join(map(_in_markdown, line))} |" for line in lines))
        notes = (*self.notes, *((ORDERS_NOTE,) if self.orders else ()))
        parts.append("\n".join(f"- {note}" for note in notes))
        return "\n\n".join(parts) + "\n"

    def to_latex(self, columns: Iterable[str] | None = None) -> str:
        """Write the tables of `to_markdown` in LaTeX, the notes in a caption; needs booktabs.

        Parameters
        ----------
        columns : iterable of str, optional
            Columns of `table`. Default: all that have numbers, except floors.

        Returns
        -------
        str
            The text.
        """
        captions = (" ".join(self.notes), ORDERS_NOTE)
        each = zip(self.told(columns), captions, strict=False)
        return "\n".join(_latex_table(*table, caption) for table, caption in each)

    def told(
        self, columns: Iterable[str] | None = None
    ) -> Iterator[tuple[list[str], list[list[str]]]]:
        """Header and rows of the runs, and of the orders if there are any, as texts."""
        yield self._runs(columns)
        if self.orders:
            yield self._orders()

    def _runs(self, columns: Iterable[str] | None) -> tuple[list[str], list[list[str]]]:
        if columns is None:
            names = [name for name in LABELS if self._has(name)]
        else:
            names = [columns] if isinstance(columns, str) else list(columns)
            for name in names:
                require_name("columns", name, self.table.column_names)
        cells = [self._cells(name) for name in names]
        return [_header(name) for name in names], [list(row) for row in zip(*cells, strict=True)]

    def _has(self, name: str) -> bool:
        column = self.table[name]
        if name in ("rejected", "failed"):
            return any(column.to_pylist())
        return bool(column.null_count < len(column))

    def _cells(self, name: str) -> list[str]:
        values = self.table[name].to_pylist()
        if name not in QUANTITIES:
            return [_cell(name, value) for value in values]
        floors = self.table[name + FLOOR].to_pylist()
        return [
            _cell(name, value) if value is None or not value or value > floor
            else f"({rounded(value)})"
            for value, floor in zip(values, floors, strict=True)
        ]  # fmt: skip

    def _orders(self) -> tuple[list[str], list[list[str]]]:
        quantities = list(dict.fromkeys(each.quantity for each in self.orders))
        keys = list(dict.fromkeys((e.method, e.cspace, e.control) for e in self.orders))
        header = ["method", "c-space", "over", *(LABELS[each] for each in quantities)]
        rows = []
        for key in keys:
            own = {e.quantity: e for e in self.orders if (e.method, e.cspace, e.control) == key}
            control = "dt" if key[2] == "dt" else "mean step"
            rows.append([*key[:2], control, *(own[q].told for q in quantities)])
        return header, rows

    # ---- pictures and files ----

    def figure(self, quantity: str | None = None) -> Figure:
        """Draw errors over CPU time, right-hand sides and step, and drifts; needs `lierb[plot]`.

        Parameters
        ----------
        quantity : {"rotation", "position", "omega", "v"}, optional
            Error to draw. Default: that of position or, where there is none, of rotation. Points
            below their floor are drawn hollow.

        Returns
        -------
        matplotlib.figure.Figure
            The figure.

        Raises
        ------
        UnknownNameError
            The comparison has no such error.
        MissingExtraError
            Matplotlib is not installed.
        """
        require("plot")
        from lierb.analysis.comparison_figure import comparison_figure

        if quantity is not None:
            require_name("quantity", quantity, ERRORS)
        orders = {each.method: each.of_method for each in self.orders}
        return comparison_figure(self, self.table, orders, quantity)

    def save(self, out: str | Path) -> list[Path]:
        """Write the table (Parquet), Markdown, LaTeX and, with Matplotlib, the figure to a folder.

        Parameters
        ----------
        out : path
            The folder.

        Returns
        -------
        list of Path
            The files; each is written whole or not at all.

        Raises
        ------
        StudyError
            `out` is no folder of this machine.
        """
        folder = folder_of(out)
        contents: dict[str, Callable[[], bytes]] = {
            f"{NAME}.parquet": lambda: _parquet(self.table),
            f"{NAME}.md": lambda: self.to_markdown().encode(),
            f"{NAME}.tex": lambda: self.to_latex().encode(),
        }
        if is_installed("plot"):
            for kind in ("png", "svg"):
                contents[f"{NAME}.{kind}"] = lambda kind=kind: _picture(self.figure(), kind)  # type: ignore[misc]
        with naming(folder, "made", "choose another folder"):
            folder.mkdir(parents=True, exist_ok=True)
        for name, content in contents.items():
            write_whole(folder / name, content())
        return [folder / name for name in contents]

    # ---- at a prompt ----

    def _shown(self) -> tuple[str, Lines]:
        title = f"lierb.Comparison: {counted(self.table.num_rows, 'run')}"
        rows: list[tuple[str, str]] = []
        header, orders = self._orders()
        for row in orders:
            seen = [f"{q} {order}" for q, order in zip(header[3:], row[3:]) if order != "–"]
            adaptive = "" if row[2] == "dt" else ", adaptive"
            rows.append(
                (f"{row[0]}, {row[1]}{adaptive}", f"order of {', '.join(seen)}" if seen else "–")
            )
        return title, [*rows, ("notes", "\n".join(self.notes))]


ORDERS_NOTE = (
    "Orders are slopes of log error over log step, least squares from the finest step on as far as "
    "the slope stays the same; (3 of 4) counts the runs that were taken, with 2 none was left to "
    "say whether it does. Errors that are rounding, or at least half as large as what they are "
    "errors of, show no order."
)


def comparison(
    rows: Sequence[dict[str, Any]],
    tableaus: Sequence[ButcherTableau],
    sizes: dict[str, float],
    name: str,
    notes: Iterable[str],
    metadata: dict[str, Any],
) -> Comparison:
    """Comparison made of the rows of its table.

    sizes : by quantity that the problem has, the size of what its errors are errors of.
    """
    notes = tuple(notes)
    orders = tuple(_observed(rows, {each.name: each.order for each in tableaus}, sizes))
    columns = list(rows[0])
    metadata = metadata | {"notes": list(notes), "orders": [_as_json(each) for each in orders]}
    schema = pa.schema([_field(each) for each in columns], {"lierb": json.dumps(metadata)})
    table = pa.Table.from_pydict({c: [row[c] for row in rows] for c in columns}, schema)
    return Comparison(table, orders, name, notes)


def _observed(
    rows: Sequence[dict[str, Any]], known: dict[str, int | None], sizes: dict[str, float]
) -> Iterator[Observed]:
    """Runs with failures say nothing: who is left differs from step to step."""
    keyed: dict[tuple[str, str, str], list[dict[str, Any]]] = {}
    for row in rows:
        keyed.setdefault((row["method"], row["cspace"], _control(row)), []).append(row)
    for (method, cspace, control), of in keyed.items():
        by_step = {row["step"]: row for row in of if row["step"] is not None}
        steps, of = list(by_step), list(by_step.values())
        if len(steps) < 2:
            continue
        for quantity, size in sizes.items():
            errors = np.array([_number(r[quantity]) if not r["failed"] else np.nan for r in of])
            floors = np.array([_number(row[quantity + FLOOR]) for row in of])
            order = fitted_order(steps, errors, size, floors)  # type: ignore[arg-type]
            told = verdict(errors, order)  # type: ignore[arg-type]
            yield Observed(method, cspace, control, quantity, order, known[method], len(of), told)


def _number(value: float | None) -> float:
    return np.nan if value is None else float(value)


def _control(row: dict[str, Any]) -> str:
    return "rtol" if row["dt"] is None else "dt"


def _field(name: str) -> pa.Field:
    plain = name.removesuffix(FLOOR)
    if plain in ("method", "cspace"):
        return pa.field(name, pa.dictionary(pa.int32(), pa.string()))
    kind = pa.int64() if plain in ("trajectories", "failed") else pa.float64()
    return pa.field(name, kind, metadata={"unit": UNITS[plain]})


def _as_json(each: Observed) -> dict[str, Any]:
    order = None
    if each.order is not None and math.isfinite(each.order.slope):
        order = {
            "slope": each.order.slope, "lower_bound": each.order.lower_bound,
            "steps": list(each.order.steps),
        }  # fmt: skip
    named = ("method", "cspace", "control", "quantity", "of_method", "runs", "verdict")
    return {name: getattr(each, name) for name in named} | {"order": order}


def _parquet(table: pa.Table) -> bytes:
    content = pa.BufferOutputStream()
    pq.write_table(table, content)
    return bytes(content.getvalue())


def _picture(figure: Figure, kind: str) -> bytes:
    from lierb.results.plots import save

    content = BytesIO()
    save(figure, content, kind)
    return content.getvalue()


# ---- texts -------------------------------------------------------------------------------------


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


def _in_markdown(text: str) -> str:
    return text.replace("|", r"\|")


def _in_latex(text: str) -> str:
    """Escaped; numbers such as 1.2e-05 as powers of ten, c-spaces as mathematics."""
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


def _latex_table(header: list[str], rows: list[list[str]], caption: str) -> str:
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
