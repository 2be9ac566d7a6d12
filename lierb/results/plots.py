"""Draw figures of lierb's Arrow tables with Matplotlib: the extra `lierb[plot]`."""

from __future__ import annotations

import math
import os
import warnings
from collections.abc import Sequence
from io import BytesIO
from itertools import cycle
from typing import IO, Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from lierb.support.extras import require

require("plot")
import matplotlib  # noqa: E402
from matplotlib.axes import Axes  # noqa: E402
from matplotlib.figure import Figure  # noqa: E402

from lierb.results.colours import STEP_COLOURS  # noqa: E402

MATH_NAMES = {"SO3xR3": r"$SO(3)\times\mathbb{R}^3$", "SE3": r"$SE(3)$"}
UNITS = {"position": "m", "rotation": "1"}

LEAST = 1e-18
"""Least drawn error. Smaller errors are drawn at this value, since zero errors are common and a
logarithmic axis cannot show them."""
MOST = 1e250
"""Largest drawn error. Larger errors are drawn at this value, since Matplotlib's ticks extend
beyond the data and doubles end at 1e308."""

STYLE: dict[Any, Any] = {  # Matplotlib types its keys one by one
    "font.size": 9.5,
    "axes.titlesize": 11,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#dddddd",
    "grid.linewidth": 0.6,
    "legend.frameon": False,
    "svg.hashsalt": "lierb",  # equal figures give equal files
}


def error_figure(
    errors: pa.Table,
    summary: pa.Table,
    *,
    quantity: str,
    title: str,
    subtitle: str = "",
) -> Figure:
    """Return a figure of an error over time: a panel for each c-space, a line for each step.

    errors : columns "cspace", "dt" (s), "t" (s) and "<quantity>_error", of one body.
    summary : columns "cspace", "dt" and "<quantity>_error_max", a row for each line.
    quantity : "position" or "rotation".
    """
    with matplotlib.rc_context(STYLE):
        figure = ShownFigure(figsize=(9.6, 4.6), layout="constrained")
        figure.suptitle(title, x=0.01, ha="left", fontsize=13, fontweight="bold")
        panels = figure.subplots(1, len(MATH_NAMES), sharey=True)
        lowest, highest = math.inf, 0.0
        for panel, (cspace, name) in zip(panels, MATH_NAMES.items()):
            low, high = _draw_panel(panel, _of(errors, cspace), _of(summary, cspace), quantity)
            panel.set_title(name, loc="left")
            lowest, highest = min(lowest, low), max(highest, high)
        panels[0].set_ylabel(f"{quantity} error [{UNITS[quantity]}]")
        _scale(panels, lowest, highest)
        figure.supxlabel(subtitle, x=0.01, ha="left", fontsize=9, color="#555555")
    return figure


class ShownFigure(Figure):
    """Figure displayed by notebooks, with or without pyplot."""

    def _repr_png_(self) -> bytes:
        content = BytesIO()
        with matplotlib.rc_context(STYLE):
            self.savefig(content, format="png", dpi=100)
        return content.getvalue()


def save(figure: Figure, path: str | os.PathLike[str] | IO[bytes], kind: str) -> None:
    """Write `figure` to `path`, a file name or an open file, as "png" or "svg"."""
    metadata = {"Date": None} if kind == "svg" else {}
    with matplotlib.rc_context(STYLE), warnings.catch_warnings():
        # a name in a script without an installed font is drawn as boxes
        warnings.filterwarnings("ignore", "Glyph .* missing from font")
        figure.savefig(path, format=kind, dpi=160, metadata=metadata)


def picture(figure: Figure, kind: str) -> bytes:
    """Return the content of a "png" or "svg" file of a figure."""
    content = BytesIO()
    save(figure, content, kind)
    return content.getvalue()


def _of(table: pa.Table, cspace: str) -> pa.Table:
    return table.filter(pc.equal(table["cspace"], cspace))


def _draw_panel(
    panel: Axes, errors: pa.Table, summary: pa.Table, quantity: str
) -> tuple[float, float]:
    """Draw the lines of one c-space; return the smallest and the largest value drawn."""
    lowest, highest = math.inf, 0.0
    runs = zip(summary["dt"].to_pylist(), summary[f"{quantity}_error_max"].to_pylist())
    for (dt, largest), colour in zip(sorted(runs, reverse=True), cycle(STEP_COLOURS)):
        run = errors.filter(pc.equal(errors["dt"], dt))
        # The start is left out: the joint is closed there, and its error is zero.
        t, error = (run[name].to_numpy()[1:] for name in ("t", f"{quantity}_error"))
        drawn = np.clip(error, LEAST, MOST)
        label = f"Δt = {_power_of_ten(dt)} s:  max {_number(largest)}"
        panel.plot(t, drawn, color=colour, linewidth=1.1, label=label)
        finite = drawn[np.isfinite(drawn)]
        lowest = min(lowest, finite.min(initial=math.inf))
        highest = max(highest, finite.max(initial=0.0))
    panel.set_xlabel("time [s]")
    panel.set_xlim(0.0, max(errors["t"].to_pylist(), default=0.0) or None)
    panel.legend(loc="upper center", bbox_to_anchor=(0.5, -0.16))
    return lowest, highest


def _scale(panels: Sequence[Axes], lowest: float, highest: float) -> None:
    """Set the axis to whole decades around the values; mark the smallest ones."""
    bottom = 10.0 ** math.floor(math.log10(min(lowest, 100 * LEAST)))
    top = 10.0 ** math.ceil(math.log10(max(1.5 * highest, 1000 * LEAST)))
    panels[0].set_yscale("log")
    panels[0].set_ylim(bottom / 3, top)
    if lowest > LEAST:
        return
    for panel in panels:
        panel.axhline(LEAST, color="#888888", linewidth=0.8, linestyle=(0, (4, 3)), zorder=0)
        panel.annotate(
            rf"$10^{{{round(math.log10(LEAST))}}}$ or less",
            (1.0, LEAST),
            xycoords=panel.get_yaxis_transform(),
            xytext=(-2, 3),
            textcoords="offset points",
            ha="right",
            color="#555555",
            fontsize=8,
        )


def _power_of_ten(value: float) -> str:
    exponent = math.log10(value)
    if abs(exponent - round(exponent)) < 1e-9:
        return f"$10^{{{round(exponent)}}}$"
    return f"{value:g}"


def _number(value: float) -> str:
    if value == 0.0:
        return "0"
    if not math.isfinite(value):
        return "not finite"
    mantissa, exponent = f"{value:.1e}".split("e")
    return rf"${mantissa}\times10^{{{int(exponent)}}}$"
