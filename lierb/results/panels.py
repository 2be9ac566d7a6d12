"""Panels of a study's figures: side by side in a file, one below the other on a phone.

A `Sheet` has the panels of a figure; each panel is a function that draws on a Matplotlib axis.
`figure_of` draws all panels in one figure. `panels_of` makes one figure for each panel, for a page
that arranges them itself.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from typing import Any, Protocol

import numpy as np

from lierb.support.arrays import Array
from lierb.support.extras import require

require("plot")
import matplotlib  # noqa: E402
from matplotlib.axes import Axes  # noqa: E402
from matplotlib.figure import Figure  # noqa: E402
from matplotlib.lines import Line2D  # noqa: E402
from matplotlib.ticker import (  # noqa: E402
    LogFormatterSciNotation,
    LogLocator,
    MaxNLocator,
    NullFormatter,
    NullLocator,
    ScalarFormatter,
)

from lierb.results.colours import CSPACE_NAMES  # noqa: E402
from lierb.results.plots import MATH_NAMES, MOST, STYLE, ShownFigure  # noqa: E402

DASHES = ("-", "--", ":", "-.")
MOST_TITLE = 60  # characters of a study's name in a title
MOST_KEYS = 8  # most lines in a legend; more lines are labelled at their ends
MOST_SETTINGS = 24  # most settings that are drawn
MOST_BINS = 60
NO_BODY = "nothing to draw: no body got to its end"
NO_TIMES = "nothing to draw: no body got as far as the first rows"
GREY, OUTLINE = "#555555", "#222222"
PLAIN = {name: CSPACE_NAMES[cspace] for cspace, name in MATH_NAMES.items()}
Draw = Callable[[Axes], None]


@dataclass(frozen=True)
class Key:
    """Legend entry: label, colour and dash."""

    label: str
    colour: str
    dash: str = "-"
    is_dot: bool = False

    @property
    def plain(self) -> str:
        """Return a label without Matplotlib's math markup."""
        return reduce(lambda text, each: text.replace(*each), PLAIN.items(), self.label)


@dataclass(frozen=True)
class Sheet:
    """Description of a figure: title, drawing functions of its panels, and legend.

    height : height of a panel, inches.
    """

    title: str
    panels: Sequence[Draw]
    keys: Sequence[Key] = ()
    across: int = 2
    height: float = 3.2


class Named(Protocol):
    """Study or comparison with a name."""

    @property
    def name(self) -> str: ...


def figure_of(sheet: Sheet, study: Named) -> Figure:
    """Return a figure of all panels side by side, with title and legend."""
    with matplotlib.rc_context(STYLE):
        across = min(sheet.across, len(sheet.panels))
        down = -(-len(sheet.panels) // across)
        figure = ShownFigure(
            figsize=(max(7.5, 4.2 * across), sheet.height * down + 1.0), layout="constrained"
        )
        name = study.name if len(study.name) <= MOST_TITLE else f"{study.name[:MOST_TITLE]}…"
        figure.suptitle(
            f"{name}: {sheet.title}", x=0.01, ha="left", fontsize=12, fontweight="bold",
            parse_math=False,
        )  # fmt: skip
        axes = list(figure.subplots(down, across, squeeze=False).ravel())
        for draw, panel in zip(sheet.panels, axes):
            draw(panel)
        for panel in axes[len(sheet.panels) :]:
            panel.set_visible(False)
        if sheet.keys and len(sheet.keys) <= MOST_KEYS:
            handles = [_handle(key) for key in sheet.keys]
            labels = [key.label for key in sheet.keys]
            columns = max(1, min(across + 1, 4))
            figure.legend(handles, labels, loc="outside lower left", ncols=columns)
    return figure


def panels_of(sheet: Sheet) -> Iterator[Figure]:
    """Return one figure for each panel, of the width of a phone."""
    for draw in sheet.panels:
        with matplotlib.rc_context(STYLE):
            figure = Figure(figsize=(4.4, sheet.height), layout="constrained")
            draw(figure.subplots())
        yield figure


def _handle(key: Key) -> Line2D:
    style: Any = {"marker": "o", "linestyle": "none"} if key.is_dot else {"linestyle": key.dash}
    return Line2D([], [], color=key.colour, **style)


# ---- axes --------------------------------------------------------------------------------------


def positive(errors: Any, least: float) -> Array:
    """Return values for a logarithmic axis; NaN for those below `least`."""
    values = np.asarray(errors, dtype=float)
    return np.where(values > least, np.minimum(values, MOST), np.nan)


def mark_of(line: Array) -> str | None:
    """Return the mark of a line with one number, which has no length."""
    return "o" if np.isfinite(line).sum() == 1 else None


def draw_band(
    panel: Axes, times: Array, low: Array, median: Array, high: Array, alpha: float, **look: Any
) -> None:
    """Draw a median and a band about it; if there is one number, as a dot and a bar.

    alpha : opacity of the band.   look : of the median.
    """
    mark = mark_of(median)
    panel.plot(times, median, marker=mark, **look)
    width = 4 if mark else 0
    panel.fill_between(times, low, high, color=look["color"], alpha=alpha, linewidth=width)


def log_axes(panel: Axes, axes: str, zeros: Sequence[str] = (), why: str = NO_BODY) -> None:
    """Make axes logarithmic with few ticks; write the reason if nothing is drawn.

    zeros : labels of quantities that are zero throughout; they are listed as text, not drawn.
    """
    notes = [f"{label}: exactly 0" for label in zeros]
    if not has_data(panel):
        panel.set(xticks=[], yticks=[])
        text = "\n".join(notes) or why
        panel.text(0.5, 0.5, text, transform=panel.transAxes, ha="center", va="center", wrap=True)
        return
    for axis in axes:
        panel.set(**{f"{axis}scale": "log"})
        few_ticks(panel, axis)
    if notes:
        panel.set_title("\n".join(notes), loc="right", fontsize=8, color=GREY)


def few_ticks(panel: Axes, axis: str) -> None:
    """Set ticks of a logarithmic axis, at whole decades if it has some, few enough for labels."""
    low, high = sorted(panel.get_xlim() if axis == "x" else panel.get_ylim())
    decades = np.log10(high / low) if low > 0.0 else 0.0
    own = getattr(panel, f"{axis}axis")
    own.set_minor_formatter(NullFormatter())
    if decades > 1.5:
        own.set_major_locator(LogLocator(numticks=6 if axis == "x" else 8))
        if decades > 4:
            own.set_minor_locator(NullLocator())
    elif decades > 0.7:
        own.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0), numticks=12))
        own.set_major_formatter(
            LogFormatterSciNotation(labelOnlyBase=False, minor_thresholds=(9, 9))
        )
    else:  # the power of ten is written once, beside the axis
        own.set_minor_locator(NullLocator())
        own.set_major_locator(MaxNLocator(nbins=4))
        own.set_major_formatter(ScalarFormatter(useMathText=True))


def has_data(panel: Axes) -> bool:
    drawn = (np.asarray(line.get_ydata(), dtype=float) for line in panel.lines)
    return bool(panel.patches) or any(np.isfinite(each).any() for each in drawn)


def order_lines(panel: Axes, lines: Mapping[int, float], dts: Array) -> None:
    """Draw a grey line for each order below the errors; `lines`: values at the last dt by order."""
    for order, start in lines.items():
        panel.plot(dts, 0.25 * start * (dts / dts[-1]) ** order, color="#999999", linewidth=1.0)
        middle = dts[len(dts) // 2]
        panel.annotate(
            f"order {order}", (middle, 0.25 * start * (middle / dts[-1]) ** order),
            xytext=(4, -10), textcoords="offset points", color="#666666", fontsize=8,
        )  # fmt: skip


def label_lines(panel: Axes, labels: Sequence[tuple[str, str, float, float]]) -> None:
    """Label lines at the right of a panel without overlap; (label, colour, x, y) by line."""
    panel.autoscale_view()
    to_axes = panel.transData + panel.transAxes.inverted()
    room = 0.048
    placed = sorted(
        (float(to_axes.transform((x, y))[1]), label, colour) for label, colour, x, y in labels
    )
    at = -np.inf
    for y, label, colour in placed:
        at = max(y, at + room)
        panel.text(1.01, at, label, transform=panel.transAxes, color=colour, fontsize=7,
                   va="center", clip_on=False)  # fmt: skip


# ---- ridges ------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Ridge:
    """Histogram on its own baseline.

    values : values of the filled histogram.   outline : values of the same bodies whose histogram
        is drawn as a line; may be empty.
    """

    key: Key
    values: Array
    outline: Array


def ridges(panel: Axes, rows: Sequence[Ridge], least: float, *, is_log: bool) -> None:
    """Draw named histograms one below the other, each scaled to its highest bin.

    Zeros and values below `least` do not fit a logarithmic axis; their number is written as text.
    """
    drawn = [
        tuple(_shown(values, least, is_log) for values in (row.values, row.outline)) for row in rows
    ]
    every = np.concatenate([part for pair in drawn for part in pair] or [np.empty(0)])
    if every.size:
        edges = _edges(every)
        to_axis = 10.0**edges if is_log else edges
        for n, (row, pair) in enumerate(zip(rows, drawn)):
            base = float(len(rows) - 1 - n)
            most = max((np.histogram(v, edges)[0].max(initial=0) for v in pair), default=0) or 1
            filled, outline = (0.72 * np.histogram(v, edges)[0] / most for v in pair)
            panel.stairs(base + filled, to_axis, baseline=base, fill=True, color=row.key.colour,
                         alpha=0.55)  # fmt: skip
            if pair[1].size:
                panel.stairs(base + outline, to_axis, baseline=base, color=OUTLINE, linewidth=0.7)
            panel.axhline(base, color="#bbbbbb", linewidth=0.6, zorder=0)
    for n, row in enumerate(rows):
        _name_ridge(panel, row, len(rows) - 1 - n, least, is_log)
    panel.set(yticks=[], ylim=(-0.1, len(rows) + 0.05))
    panel.grid(visible=False, axis="y")
    if every.size and is_log:
        panel.set_xscale("log")
        few_ticks(panel, "x")
    elif every.size:
        panel.locator_params(axis="x", nbins=4)
    else:
        panel.set_xticks([])


def _name_ridge(panel: Axes, row: Ridge, base: int, least: float, is_log: bool) -> None:
    values = row.values[~np.isnan(row.values)]
    is_zero = np.abs(values) <= least if is_log else np.zeros(0)
    shares = [("exactly 0", is_zero), ("infinite", np.isinf(values))]
    notes = [
        what if each.all() else f"{100 * each.mean():.2g} % {what}"
        for what, each in shares
        if each.any()
    ]
    note = ", ".join(notes) if values.size else "no body got to its end"
    panel.text(0.005, base + 0.97, row.key.label, transform=panel.get_yaxis_transform(),
               color=row.key.colour, fontsize=8, va="top")  # fmt: skip
    panel.text(0.995, base + 0.97, note, transform=panel.get_yaxis_transform(), color=GREY,
               fontsize=8, va="top", ha="right")  # fmt: skip


def _shown(values: Array, least: float, is_log: bool) -> Array:
    """Return the values within the axis; their logarithms if the axis is logarithmic."""
    finite = values[np.isfinite(values)]
    if not is_log:
        return finite
    return np.asarray(np.log10(np.minimum(finite[finite > least], MOST)))


def _edges(values: Array) -> Array:
    low, high = float(values.min()), float(values.max())
    if high - low <= 1e-9 * max(abs(low), abs(high), 1e-300):
        low, high = low - 0.5 * (abs(low) or 1.0) * 0.1, high + 0.5 * (abs(high) or 1.0) * 0.1
    bins = int(np.clip(2.0 * np.sqrt(values.size), 12, MOST_BINS))
    return np.linspace(low, high, bins + 1)
