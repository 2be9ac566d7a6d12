"""Figures of fits and propagated covariances, by Matplotlib: the extra `lierb[plot]`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from lierb.support.arrays import Array
from lierb.support.extras import require

require("plot")
import matplotlib  # noqa: E402
from matplotlib.axes import Axes  # noqa: E402
from matplotlib.figure import Figure  # noqa: E402

from lierb.results.colours import COLOURS  # noqa: E402
from lierb.results.plots import STYLE, ShownFigure  # noqa: E402

MOST_LABELS = 30  # numbers whose correlations are drawn
WIDTH, HEIGHT = 9.6, 2.6  # of the figure, and of a panel, inches
FAILS = "#d62728"


def fit_figure(
    t: Array,
    residuals: Mapping[str, Array],
    units: Mapping[str, str],
    labels: Sequence[str],
    correlation: Array,
) -> Figure:
    """Draw the residuals of each column over time, and the correlations; arguments as in `Fit`."""
    shows_matrix = 1 < len(labels) <= MOST_LABELS
    rows = len(residuals) + 2 * shows_matrix
    with matplotlib.rc_context(STYLE):
        figure = ShownFigure(figsize=(WIDTH, HEIGHT * rows), layout="constrained")
        grid = figure.add_gridspec(rows, 1)
        for i, (name, off) in enumerate(residuals.items()):
            panel = figure.add_subplot(grid[i, 0])
            for c in range(off.shape[2]):
                colour = COLOURS[c % len(COLOURS)]
                dots = panel.plot(t, off[:, :, c], ".", color=colour, markersize=3)
                dots[0].set_label(str(c + 1))
            _name_components(panel, off.shape[2])
            panel.axhline(0.0, color="#222222", linewidth=0.8)
            panel.set_title(f"{name}, run minus data [{_unit(units[name])}]", loc="left")
            panel.set_xlabel("t [s]")
        if shows_matrix:
            panel = figure.add_subplot(grid[-2:, 0])
            image = panel.imshow(correlation, cmap="RdBu_r", vmin=-1.0, vmax=1.0)
            panel.set_xticks(range(len(labels)), labels, rotation=90)
            panel.set_yticks(range(len(labels)), labels)
            panel.grid(visible=False)
            panel.set_title("correlations of the estimate", loc="left")
            figure.colorbar(image, ax=panel)
    return figure


def propagation_figure(
    t: Array,
    linear: Mapping[str, Array],
    sample: Mapping[str, Array],
    holds: Mapping[str, NDArray[np.bool_]],
    units: Mapping[str, str],
    runs: int,
) -> Figure:
    """Draw standard deviations, (times, w): lines of linear theory, dots of the sample.

    holds, units : as in `Propagation`.
    """
    rows = len(linear)
    with matplotlib.rc_context(STYLE):
        figure = ShownFigure(figsize=(WIDTH, HEIGHT * rows + 0.4), layout="constrained")
        panels = figure.subplots(rows, 1, sharex=True, squeeze=False)[:, 0]
        for panel, (name, deviations) in zip(panels, linear.items(), strict=True):
            for c in range(deviations.shape[1]):
                colour = COLOURS[c % len(COLOURS)]
                panel.plot(t, deviations[:, c], color=colour, label=str(c + 1))
                panel.plot(t, sample[name][:, c], ".", color=colour)
            _name_components(panel, deviations.shape[1])
            for fails in t[~holds[name]]:
                panel.axvline(fails, color=FAILS, linewidth=0.6, alpha=0.5, zorder=0)
            panel.set_title(f"{name}, standard deviation [{_unit(units[name])}]", loc="left")
            panel.set_ylim(bottom=0.0)
        panels[-1].set_xlabel("t [s]")
        notes = f"lines: linear theory; dots: {runs} runs"
        if not all(holds[name].all() for name in linear):
            notes += "; red: linear theory does not hold"
        figure.supxlabel(notes, x=0.01, ha="left", fontsize=9, color="#555555")
    return figure


def _name_components(panel: Axes, count: int) -> None:
    if count > 1:
        panel.legend(title="component", loc="center left", bbox_to_anchor=(1.0, 0.5))


def _unit(unit: str) -> str:
    """Return the units of components, each of them once."""
    return ", ".join(dict.fromkeys(part.strip() for part in unit.split(",") if part.strip()))
