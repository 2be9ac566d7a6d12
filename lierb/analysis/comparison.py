"""A comparison of methods has a table of the runs, observed orders, and their files."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pyarrow as pa

from lierb.analysis.comparison_orders import FLOOR, Observed, observed_orders
from lierb.analysis.comparison_tables import (
    ORDERS_NOTE,
    UNITS,
    TextTable,
    in_latex,
    in_markdown,
    table_of_orders,
    table_of_runs,
)
from lierb.analysis.reference import ERRORS
from lierb.errors import ArgumentError, require_name
from lierb.methods import Method
from lierb.support.extras import is_installed, require
from lierb.support.files import folder_of, naming, parquet, write_whole
from lierb.support.representations import Lines, Represented, counted

if TYPE_CHECKING:
    from matplotlib.figure import Figure

NAME = "comparison"  # name of the files


@dataclass(frozen=True, repr=False)
class Comparison(Represented):
    """`lierb.convergence` returns a comparison of methods, c-spaces and steps.

    Attributes
    ----------
    table : pyarrow.Table
        A row for each method, c-space and step: method, cspace; dt, s, or rtol; step, s, the mean
        one; steps, rejected and evaluations of right-hand sides, means over trajectories; cpu_time
        of the batch, s; trajectories, failed; error.rotation, error.position, error.omega and
        error.v at t_end, the largest or the median over trajectories; drift.position and
        drift.rotation of the joints, and drift.energy, maxima over the run. Each of these is
        followed by its floor, such as error.v.floor: an error up to the floor is rounding, or may
        be the reference's.
    orders : tuple of Observed
        Observed orders of all errors and drifts.
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
            Configuration space; it may be omitted if there is only one.
        quantity : str, optional
            A column of `table`. Default: error.position, or error.rotation if no position changes.

        Returns
        -------
        float
            The order.

        Raises
        ------
        UnknownNameError
            The comparison has no such method, c-space or quantity.
        ArgumentError
            There are several c-spaces, and `cspace` is omitted.
        """
        if not self.orders:
            raise ArgumentError("each method was run with one step; give two and more for orders")
        require_name("method", method, dict.fromkeys(each.method for each in self.orders))
        if quantity is None:
            moves = any(self.table["error.position"].to_pylist())
            quantity = "error.position" if moves else "error.rotation"
        require_name("quantity", quantity, dict.fromkeys(each.quantity for each in self.orders))
        matching = [
            each for each in self.orders
            if each.method == method and each.quantity == quantity and cspace in (None, each.cspace)
        ]  # fmt: skip
        if cspace is not None:
            require_name("cspace", cspace, dict.fromkeys(each.cspace for each in self.orders))
        cspaces = dict.fromkeys(each.cspace for each in matching)
        if len(cspaces) > 1:
            raise ArgumentError(f"{method} was run on {', '.join(cspaces)}; give cspace= as well")
        order = matching[0].order
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
        notes = (*self.notes, *((ORDERS_NOTE,) if self.orders else ()))
        parts = [*map(in_markdown, self.text_tables(columns))]
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
        tables = zip(self.text_tables(columns), captions, strict=False)
        return "\n".join(in_latex(table, caption) for table, caption in tables)

    def text_tables(self, columns: Iterable[str] | None = None) -> Iterator[TextTable]:
        """Yield the table of the runs and the table of the orders, if there are any, as text."""
        yield table_of_runs(self.table, columns)
        if self.orders:
            yield table_of_orders(self.orders)

    # ---- pictures and files ----

    def figure(self, quantity: str | None = None) -> Figure:
        """Draw errors over CPU time, right-hand sides and step, and drifts; needs `lierb[plot]`.

        Parameters
        ----------
        quantity : {"rotation", "position", "omega", "v"}, optional
            Error to draw. Default: position, or rotation if there is no position error. Points
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
        """Write table (Parquet), Markdown, LaTeX and, with Matplotlib, the figure to a folder.

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
            `out` is not a folder on this machine.
        """
        folder = folder_of(out)
        contents = {
            "parquet": parquet(self.table),
            "md": self.to_markdown().encode(),
            "tex": self.to_latex().encode(),
        }
        if is_installed("plot"):
            from lierb.results.plots import picture

            contents |= {kind: picture(self.figure(), kind) for kind in ("png", "svg")}
        with naming(folder, "made", "choose another folder"):
            folder.mkdir(parents=True, exist_ok=True)
        files = {folder / f"{NAME}.{kind}": content for kind, content in contents.items()}
        for path, content in files.items():
            write_whole(path, content)
        return [*files]

    # ---- at a prompt ----

    def _representation(self) -> tuple[str, Lines]:
        title = f"lierb.Comparison: {counted(self.table.num_rows, 'run')}"
        rows: list[tuple[str, str]] = []
        header, orders = table_of_orders(self.orders)
        for row in orders:
            known = [f"{q} {order}" for q, order in zip(header[3:], row[3:]) if order != "–"]
            adaptive = "" if row[2] == "dt" else ", adaptive"
            text = f"order of {', '.join(known)}" if known else "–"
            rows.append((f"{row[0]}, {row[1]}{adaptive}", text))
        return title, [*rows, ("notes", "\n".join(self.notes))]


def comparison(
    rows: Sequence[dict[str, Any]],
    methods: Sequence[Method],
    sizes: dict[str, float],
    name: str,
    notes: Iterable[str],
    metadata: dict[str, Any],
) -> Comparison:
    """Make a comparison from the rows of its table.

    sizes : characteristic size of each quantity of the problem, the scale of its errors.
    """
    notes = tuple(notes)
    orders = tuple(observed_orders(rows, {each.name: each.order for each in methods}, sizes))
    columns = list(rows[0])
    metadata = metadata | {"notes": list(notes), "orders": [each.as_json() for each in orders]}
    schema = pa.schema([_field(each) for each in columns], {"lierb": json.dumps(metadata)})
    table = pa.Table.from_pydict({c: [row[c] for row in rows] for c in columns}, schema)
    return Comparison(table, orders, name, notes)


def _field(name: str) -> pa.Field:
    plain = name.removesuffix(FLOOR)
    if plain in ("method", "cspace"):
        return pa.field(name, pa.dictionary(pa.int32(), pa.string()))
    kind = pa.int64() if plain in ("trajectories", "failed") else pa.float64()
    return pa.field(name, kind, metadata={"unit": UNITS[plain]})
