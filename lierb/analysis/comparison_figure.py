"""Plot a comparison: work-precision diagrams, errors and drifts over the step."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import pyarrow as pa

from lierb.analysis.comparison_orders import FLOOR
from lierb.results.colours import colours_of
from lierb.results.panels import (
    MOST_KEYS,
    Draw,
    Key,
    Named,
    Sheet,
    figure_of,
    label_lines,
    log_axes,
    order_lines,
    positive,
)
from lierb.support.arrays import Array
from lierb.support.extras import require

require("plot")
from matplotlib.axes import Axes  # noqa: E402
from matplotlib.figure import Figure  # noqa: E402

from lierb.results.plots import MATH_NAMES  # noqa: E402

AXES = {
    "error.rotation": "rotation error [rad]", "error.position": "position error [m]",
    "error.omega": "error of ω [rad/s]", "error.v": "error of v [m/s]",
    "drift.position": "drift of the joints [m]", "drift.rotation": "drift of the joints, rotation",
    "drift.energy": "energy drift [J]",
    "cpu_time": "CPU time [s]", "evaluations": "right-hand sides", "step": "Δt [s]", "rtol": "rtol",
}  # fmt: skip
MARKERS = "os^Dv<>Pph*"  # one for each method
NO_RUN = "nothing to draw: no run got to its end"


@dataclass(frozen=True)
class Line:
    """A line has the runs of a method on a c-space, from the coarsest to the finest.

    order : order of the method, if it is known and the steps are fixed.
    """

    key: Key
    marker: str
    rows: pa.Table
    order: int | None

    def column(self, name: str) -> Array:
        """Return a column as floats, NaN for missing values."""
        return np.asarray(self.rows[name].to_numpy(zero_copy_only=False).astype(float))


def comparison_figure(
    named: Named, table: pa.Table, orders: Mapping[str, int | None], quantity: str | None
) -> Figure:
    """Draw a comparison's table: a panel for each abscissa, and one for each drift.

    orders : orders of the methods, by name.   quantity : error to draw, without "error.".
    """
    lines = list(_lines(table, orders))
    error = f"error.{quantity or _first(table)}"
    panels: list[Draw] = []
    if table["cpu_time"].null_count < table.num_rows:
        panels.append(partial(_draw, lines, "cpu_time", error))
    panels.append(partial(_draw, lines, "evaluations", error))
    panels.append(partial(_draw, lines, "step", error))
    if table["rtol"].null_count < table.num_rows:
        panels.append(partial(_draw, lines, "rtol", error))
    panels += [
        partial(_draw, lines, "step", drift)
        for drift in ("drift.position", "drift.rotation", "drift.energy")
        if table[drift].null_count < table.num_rows
    ]
    title = "work and precision; hollow: no more than rounding, or than the reference's own error"
    return figure_of(Sheet(title, panels, [line.key for line in lines], across=3), named)


def _first(table: pa.Table) -> str:
    """Return "position", or "rotation" if all position errors are rounding."""
    errors, floors = (table[f"error.position{end}"].to_pylist() for end in ("", FLOOR))
    exceeds = any(e is not None and e > floor for e, floor in zip(errors, floors, strict=True))
    return "position" if exceeds else "rotation"


def _lines(table: pa.Table, orders: Mapping[str, int | None]) -> Iterator[Line]:
    rows = table.to_pylist()
    keys = [(row["cspace"], row["method"], row["dt"] is None) for row in rows]
    spaces = list(dict.fromkeys((cspace, method) for cspace, method, _ in keys))
    colours = dict(zip(spaces, colours_of([cspace for cspace, _ in spaces]), strict=True))
    methods = list(dict.fromkeys(method for _, method, _ in keys))
    for key in dict.fromkeys(keys):
        cspace, method, is_adaptive = key
        label = f"{MATH_NAMES.get(cspace, cspace)}, {method}"
        label += ", adaptive" if is_adaptive else ""
        yield Line(
            Key(label, colours[cspace, method], "--" if is_adaptive else "-"),
            MARKERS[methods.index(method) % len(MARKERS)],
            table.take([n for n, each in enumerate(keys) if each == key]),
            None if is_adaptive else orders.get(method),
        )


def _draw(lines: list[Line], across: str, quantity: str, panel: Axes) -> None:
    zeros, ends = [], []
    below: dict[int, float] = {}  # start of each order's line
    dts = np.empty(0)
    for n, line in enumerate(lines):
        x, errors, floors = (line.column(c) for c in (across, quantity, quantity + FLOOR))
        drawn = positive(errors, 0.0)
        if not np.isfinite(x * drawn).any():
            if np.isfinite(x).any() and np.nanmax(errors, initial=-1.0) == 0.0:
                zeros.append(line.key.label)
            continue
        visible = errors > floors
        width = 1.2 + 1.2 * (len(lines) - 1 - n) / len(lines)  # shows coincident lines
        panel.plot(x, drawn, color=line.key.colour, linestyle=line.key.dash, linewidth=width)
        style: dict[str, Any] = {"linestyle": "none", "marker": line.marker, "markersize": 5.0}
        panel.plot(x[visible], drawn[visible], color=line.key.colour, **style)
        panel.plot(
            x[~visible], drawn[~visible], color=line.key.colour, markerfacecolor="white", **style
        )
        ends.append((line.key.label, line.key.colour, float(x[-1]), float(np.nanmin(drawn))))
        if across == "step" and line.order and visible.any():
            last = int(np.flatnonzero(visible)[-1])
            at_last = drawn[last] * (x[-1] / x[last]) ** line.order
            below[line.order] = min(below.get(line.order, np.inf), at_last)
            dts = x if x.size > dts.size else dts
    if dts.size > 1:
        order_lines(panel, below, dts)
    if across == "rtol":
        x = np.unique(np.concatenate([line.column(across) for line in lines]))
        x = x[np.isfinite(x)]
        panel.plot(x, x, color="#999999", linewidth=1.0)
    panel.set_xlabel(AXES[across])
    panel.set_ylabel(AXES[quantity])
    log_axes(panel, "xy", zeros, NO_RUN)
    if ends:  # space for the labels of zero errors
        low, high = min(lowest for *_, lowest in ends), panel.get_ylim()[1]
        panel.set_ylim(bottom=0.3 * low / (high / low) ** (0.07 * len(zeros)))
    if len(lines) > MOST_KEYS and ends:
        label_lines(panel, ends)
