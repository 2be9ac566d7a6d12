"""Draw figures over time: errors, other columns of the history, and events."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from lierb.analysis.magnitudes import DRIFTS
from lierb.kernels.systems.measures import MEASURES
from lierb.results.panels import (
    MOST_KEYS,
    NO_TIMES,
    Sheet,
    draw_band,
    label_lines,
    log_axes,
    positive,
)
from lierb.studies.findings.occurrences import event_names, first_times
from lierb.studies.findings.sizes import errors_seen, least_drawn
from lierb.studies.findings.statistics import quantiles_over_time
from lierb.studies.pages.columns import AXES, KNOWN, axis_label, other_columns
from lierb.studies.pages.looks import Look, looks
from lierb.studies.storage.results import Results
from lierb.support.arrays import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes

PROBABILITIES = (0.05, 0.5, 0.95, 1.0)  # of the quantiles drawn at each time
RANKS = 2000  # most points of a distribution function
IN_HISTORY = KNOWN | {measure.name for measure in MEASURES} - {"energy"}


def time_sheet(dataset: Results) -> Sheet:
    """Draw errors over time: median, 5 to 95 % and largest of the bodies."""
    seen, least, shown = errors_seen(dataset), least_drawn(dataset), looks(dataset.study)
    panels = [
        partial(_draw_errors, dataset, shown, DRIFTS[kind], least[kind], AXES[kind])
        for kind in seen
    ]
    return Sheet("errors over time: median, 5 to 95 %, largest", panels,
                 [look.key for look in shown])  # fmt: skip


def recorded_sheet(dataset: Results) -> Sheet:
    """Draw other columns of the history over time, such as the energy and observables."""
    shown = looks(dataset.study)
    if not dataset.study.integrate.saves:
        return Sheet("", ())
    fields = other_columns(dataset.table("history").schema, IN_HISTORY)
    panels = [partial(_draw_column, dataset, shown, each.name, axis_label(each)) for each in fields]
    return Sheet("what else was recorded: median, 5 to 95 %", panels, [look.key for look in shown],
                 across=3)  # fmt: skip


def _draw_errors(
    dataset: Results, shown: list[Look], name: str, least: float, label: str, panel: Axes
) -> None:
    zeros, ends = [], []
    for look in shown:
        times, bands = quantiles_over_time(dataset, name, look.setting, PROBABILITIES, np.abs)
        later = times > dataset.study.integrate.t0  # at the start there is no error yet
        times, bands = times[later], bands[:, later]
        if not times.size:
            continue
        if np.nanmax(bands[3], initial=0.0) <= least:
            if np.isfinite(bands[3]).any():
                zeros.append(look.key.label)
            continue
        low, median, high, most = positive(bands, least)
        colour, dash = look.key.colour, look.key.dash
        bottom = np.where(np.isnan(low), np.nanmin(positive(bands, least)), low)
        style = {"color": colour, "linestyle": dash, "linewidth": look.width}
        draw_band(panel, times, bottom, median, high, 0.18, **style)
        panel.plot(times, most, color=colour, linestyle=dash, linewidth=0.6, alpha=0.8)
        ends.append((look.key.label, colour, *_end(times, median if np.isfinite(median).any()
                                                   else most)))  # fmt: skip
    panel.set_ylabel(label)
    panel.set_xlabel("time [s]")
    panel.locator_params(axis="x", nbins=6)
    log_axes(panel, "y", zeros, NO_TIMES)
    if len(shown) > MOST_KEYS and ends:
        label_lines(panel, ends)


def _draw_column(dataset: Results, shown: list[Look], name: str, label: str, panel: Axes) -> None:
    ends = []
    for look in shown:
        times, bands = quantiles_over_time(dataset, name, look.setting, PROBABILITIES)
        low, median, high, _ = bands
        if not np.isfinite(median).any():
            continue
        colour, dash = look.key.colour, look.key.dash
        style = {"color": colour, "linestyle": dash, "linewidth": look.width}
        draw_band(panel, times, low, median, high, 0.15, **style)
        ends.append((look.key.label, look.key.colour, *_end(times, median)))
    panel.set_ylabel(label, parse_math=False)
    panel.set_xlabel("time [s]")
    if not ends:
        log_axes(panel, "", why=NO_TIMES)
    elif len(shown) > MOST_KEYS:
        label_lines(panel, ends)


def _end(times: Array, line: Array) -> tuple[float, float]:
    last = int(np.flatnonzero(np.isfinite(line))[-1])
    return float(times[last]), float(line[last])


def event_sheet(dataset: Results) -> Sheet:
    """Share of the bodies to which each event has happened, over time."""
    shown = looks(dataset.study)
    panels = [partial(_draw_event, dataset, shown, name) for name in event_names(dataset.study)]
    keys = [look.key for look in shown]
    return Sheet("when each event first happened", panels, keys, across=3)


def _draw_event(dataset: Results, shown: list[Look], name: str, panel: Axes) -> None:
    run = dataset.study.integrate
    for look in shown:
        _, first, _ = first_times(dataset, look.setting, name)
        if not first.size:
            continue
        had = np.sort(first[np.isfinite(first)])
        ranks = np.unique(np.linspace(1, len(had), RANKS).astype(int))[: len(had)]
        times = np.concatenate([[run.t0], had[ranks - 1], [run.t_end]])
        share = np.concatenate([[0], ranks, [len(had)]]) / len(first)
        panel.step(times, share, where="post", color=look.key.colour, linestyle=look.key.dash,
                   linewidth=look.width)  # fmt: skip
    panel.set_xlabel("time [s]")
    panel.set_ylabel(f"share with: {name.replace('_', ' ')}", parse_math=False)
    panel.locator_params(axis="x", nbins=6)
    panel.set_ylim(-0.02, 1.02)
