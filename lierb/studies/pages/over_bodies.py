"""Draw figures over the bodies of a study: distributions, and errors over sampled numbers."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from lierb.kernels.systems.measures import KEPT
from lierb.results.panels import (
    MOST_KEYS,
    OUTLINE,
    Draw,
    Key,
    Ridge,
    Sheet,
    log_axes,
    positive,
    ridges,
)
from lierb.studies.findings.columns import drawn_columns, ok_columns, some_rows
from lierb.studies.findings.ranking import rankings
from lierb.studies.findings.sizes import errors_seen, least_drawn
from lierb.studies.findings.symbols import labelled
from lierb.studies.pages.columns import AXES, KNOWN, Ordinate, axis_label, ordinates, other_columns
from lierb.studies.pages.looks import Look, looks, step_sizes
from lierb.studies.storage.results import Results
from lierb.support.arrays import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FINAL = {"position": "position_error_final", "rotation": "rotation_error_final"}
POINTS = 4000  # most points of a scatter plot
RANKS = 2000  # most points of a distribution function
IN_SUMMARY = KNOWN | {f"{measure.name}_{how}" for measure, how in KEPT}


def distribution_sheet(dataset: Results) -> Sheet:
    """Draw distribution functions and histograms of the largest errors of the bodies."""
    seen, least, shown = errors_seen(dataset), least_drawn(dataset), looks(dataset.study)
    panels: list[Draw] = []
    columns = dataset.table().schema.names
    finals = {kind: name for kind, name in FINAL.items() if kind in seen and name in columns}
    for kind, largest in seen.items():
        rows = [_ridge(dataset, look, largest, finals.get(kind)) for look in shown]
        panels.append(partial(_draw_shares, rows, shown, least[kind], AXES[kind]))
        panels.append(partial(_draw_ridges, rows, least[kind], f"largest {AXES[kind]}", True))
    keys = [look.key for look in shown]
    if finals and len(keys) < MOST_KEYS:
        keys.append(Key("outline: at the end", OUTLINE))
    return Sheet("errors over the bodies", panels, keys,
                 height=max(3.2, 0.42 * len(shown) + 0.9))  # fmt: skip


def quantity_sheet(dataset: Results) -> Sheet:
    """Draw histograms of the summary's other columns, such as those of observables."""
    shown, panels = looks(dataset.study), []
    for field in other_columns(dataset.table().schema, IN_SUMMARY):
        rows = [_ridge(dataset, look, field.name, None) for look in shown]
        panels.append(partial(_draw_ridges, rows, -1.0, axis_label(field), False))
    return Sheet("other quantities over the bodies", panels, across=3,
                 height=max(2.4, 0.42 * len(shown) + 0.9))  # fmt: skip


def _ridge(dataset: Results, look: Look, name: str, outline: str | None) -> Ridge:
    names = [name] if outline is None else [name, outline]
    columns = ok_columns(dataset, look.setting, names)
    return Ridge(look.key, columns[name], columns[outline] if outline else np.empty(0))


def _draw_shares(
    rows: list[Ridge], shown: list[Look], least: float, label: str, panel: Axes
) -> None:
    zeros, ends = [], []
    for row, look in zip(rows, shown):
        values = np.sort(row.values[np.isfinite(row.values)])
        none = int(np.searchsorted(values, least, side="right"))
        if none and none == len(values):
            zeros.append(row.key.label)
        if none == len(values):
            continue
        ranks = np.unique(np.linspace(none, len(values) - 1, RANKS).astype(int))
        share = (ranks + 1) / len(values)
        panel.step(positive(values[ranks], least), share, where="post", color=row.key.colour,
                   linestyle=row.key.dash, linewidth=look.width)  # fmt: skip
        middle = int(np.searchsorted(share, 0.5))
        ends.append((row.key.label, row.key.colour, values[ranks[-1]], share[middle]))
    panel.set_xlabel(f"largest {label}")
    panel.set_ylabel("share of the bodies at or below")
    log_axes(panel, "x", zeros)
    if ends:
        panel.set_ylim(-0.02, 1.02)


def _draw_ridges(rows: list[Ridge], least: float, label: str, is_log: bool, panel: Axes) -> None:
    ridges(panel, rows, least, is_log=is_log)
    panel.set_xlabel(label, parse_math=False)


def parameter_sheet(dataset: Results, rank_by: str | None = None) -> Sheet:
    """Draw the column by which the bodies are ranked over sampled numbers."""
    study, drawn = dataset.study, drawn_columns(dataset)
    (up,) = ordinates(dataset, [rankings(dataset, rank_by)[0].column])
    largest = [s for s in study.settings if s.step == step_sizes(study)[0]]
    shown = looks(study, largest)
    across = []
    for look in shown:
        rows = ok_columns(dataset, look.setting, [up.column, *drawn])
        some = some_rows(len(rows[up.column]), POINTS)
        across.append({name: values[some] for name, values in rows.items()})
    heights = [rows[up.column] for rows in across]
    dots = [*zip(shown, heights, labelled(drawn, across, study), strict=True)]
    panels = [partial(_draw_dots, dots, label, up) for label in dots[0][2]]
    keys = [Key(look.key.label, look.key.colour, is_dot=True) for look in shown]
    return Sheet(f"{up.title} against what was sampled", panels, keys, across=3,
                 height=2.8)  # fmt: skip


def _draw_dots(
    dots: list[tuple[Look, Array, dict[str, Array]]], label: str, up: Ordinate, panel: Axes
) -> None:
    zeros, on_edge = [], []
    for n, (look, values, columns) in enumerate(dots):
        size = 2.0 + 2.4 * (len(dots) - 1 - n) / len(dots)  # so that a covered dot keeps its rim
        heights = values if up.least is None else positive(values, up.least)
        if up.least is not None and values.size and not np.isfinite(heights).any():
            zeros.append(look.key.label)
            continue
        panel.plot(columns[label], heights, "o", color=look.key.colour, markersize=size,
                   markeredgewidth=0, alpha=0.6, rasterized=True)  # fmt: skip
        if up.least is not None:
            on_edge.append((look, columns[label][np.isnan(heights)]))
    panel.set_xlabel(label, parse_math=False)
    panel.set_ylabel(up.title, parse_math=False)
    panel.locator_params(axis="x", nbins=5)
    log_axes(panel, "" if up.least is None else "y", zeros)
    for look, at in on_edge:
        if at.size:
            panel.plot(at, np.zeros(at.size), "|", color=look.key.colour, markersize=7,
                       transform=panel.get_xaxis_transform(), clip_on=False)  # fmt: skip
