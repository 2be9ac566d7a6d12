"""Figures of a study: errors over its bodies, over time, over the step, over what was sampled."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from lierb.analysis.convergence import ROUNDING_FLOOR
from lierb.errors import require_name
from lierb.kernels.systems.measures import KEPT, MEASURES
from lierb.methods import tableau_of
from lierb.results.panels import (
    MOST_KEYS,
    NO_TIMES,
    OUTLINE,
    Draw,
    Key,
    Ridge,
    Sheet,
    figure_of,
    label_lines,
    log_axes,
    order_lines,
    positive,
    ridges,
)
from lierb.studies.description.settings import Setting
from lierb.studies.description.study import Study
from lierb.studies.findings.findings import (
    ERRORS,
    Found,
    drawn_columns,
    errors_seen,
    findings,
    least_drawn,
    ok_columns,
    some_rows,
    study_of,
)
from lierb.studies.findings.occurrences import event_names, first_times
from lierb.studies.findings.sizes import as_array
from lierb.studies.findings.statistics import percentiles_over_time
from lierb.studies.findings.symbols import labelled
from lierb.studies.pages.looks import Look, looks, step_sizes
from lierb.studies.storage.results import Results
from lierb.support.arrays import Array
from lierb.support.extras import require
from lierb.support.files import write_whole

require("plot")
from matplotlib.axes import Axes  # noqa: E402
from matplotlib.figure import Figure  # noqa: E402

from lierb.results.plots import MATH_NAMES, save  # noqa: E402

AXES = {
    "position": "position error [m]",
    "rotation": "rotation error",
    "energy": "energy drift [J]",
}
FINAL = {"position": "position_error_final", "rotation": "rotation_error_final"}
HISTORY = {"position": "position_error", "rotation": "rotation_error", "energy": "energy_drift"}
PERCENTILES = (5.0, 50.0, 95.0, 100.0)  # at each time
POINTS = 4000  # of a scatter plot, at most
RANKS = 2000  # points of a distribution function, at most
KNOWN = {  # columns that other figures have, or that are no results
    "trajectory", "status", "cspace", "method", "dt", "rtol", "step", "t", "dt_last",
    "rotation", "position", "omega", "v", "lambda", "reaction",
}  # fmt: skip
IN_HISTORY = KNOWN | {measure.name for measure in MEASURES} - {"energy"}
IN_SUMMARY = KNOWN | {f"{measure.name}_{how}" for measure, how in KEPT}
CAPTIONS = {
    "distribution": "The share of the bodies whose largest error is at or below a value, and "
    "histograms: each body's largest error (filled), and that at the end of its run (outline).",
    "time": "Median (thick), 5 to 95 % of the bodies (band) and the largest (thin) at each time.",
    "recorded": "What else was recorded: median (line) and 5 to 95 % of the bodies (band).",
    "quantities": "What else the bodies' summaries have: a histogram for each setting.",
    "order": "Median, 95 % and largest of the bodies over the step; grey: the method's order.",
    "events": "The share of the bodies to which an event has happened by a time.",
    "parameters": "A dot is a body: its largest error against each sampled number; zeros on the "
    "lower edge.",
}


def omitted(dataset: Results) -> dict[str, str]:
    """The figures that there is no need for, by name, and why."""
    study = study_of(dataset)
    rows = ok_columns(dataset, study.settings[0], list(drawn := drawn_columns(dataset)))
    reasons = {
        "time": (not study.integrate.saves, "neither save_every nor save_at is set"),
        "order": _no_order(study),
        "parameters": (not list(labelled(drawn, rows, study)), "no numbers are sampled"),
    }
    return {name: why for name, (is_left_out, why) in reasons.items() if is_left_out}


def _no_order(study: Study) -> tuple[bool, str]:
    if study.integrate.is_adaptive:
        return True, "steps are adaptive"
    return len(set(study.integrate.dt)) < 2, "there is one dt"


def sheets(dataset: Results) -> Iterator[tuple[str, Sheet]]:
    """Every figure that the study has settings for, by name; what has no data says so."""
    study, left_out = study_of(dataset), omitted(dataset)
    for name, make in KINDS.items():
        if name not in left_out:
            sheet = make(dataset, study)
            if sheet.panels:
                yield name, sheet


def figures(dataset: Results) -> Iterator[tuple[str, Figure]]:
    """The same, drawn."""
    study = study_of(dataset)
    for name, sheet in sheets(dataset):
        yield name, figure_of(sheet, study)


def figure(dataset: Results, name: str | None = None) -> Figure:
    """One of them; see `Dataset.plot`."""
    found = dict(sheets(dataset))
    if name is None:
        name = "time" if "time" in found else "distribution"
    require_name("name", name, found)
    return figure_of(found[name], study_of(dataset))


def draw_all(dataset: Results, folder: Path) -> list[Path]:
    """The figures, as PNG and SVG in `folder`."""
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for name, drawn in figures(dataset):
        for kind in ("png", "svg"):
            path = folder / f"{name}.{kind}"
            content = BytesIO()
            save(drawn, content, kind)
            write_whole(path, content.getvalue())
            written.append(path)
    return written


# ---- over the bodies ---------------------------------------------------------------------------


def distribution_sheet(dataset: Results, study: Study) -> Sheet:
    """How the errors are distributed over the bodies: shares at or below, and histograms."""
    seen, least, shown = errors_seen(dataset, study), least_drawn(dataset, study), looks(study)
    panels: list[Draw] = []
    columns = _summary(dataset)
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


def quantity_sheet(dataset: Results, study: Study) -> Sheet:
    """Histograms of the summary's other columns, such as those of observables."""
    shown, panels = looks(study), []
    for field in _others(_schema(dataset, "summary"), IN_SUMMARY):
        rows = [_ridge(dataset, look, field.name, None) for look in shown]
        panels.append(partial(_draw_ridges, rows, -1.0, _axis(field), False))
    return Sheet("other quantities over the bodies", panels, across=3,
                 height=max(2.4, 0.42 * len(shown) + 0.9))  # fmt: skip


def _ridge(dataset: Results, look: Look, name: str, outline: str | None) -> Ridge:
    names = [name] if outline is None else [name, outline]
    found = ok_columns(dataset, look.setting, names)
    return Ridge(look.key, found[name], found[outline] if outline else np.empty(0))


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


# ---- over time ---------------------------------------------------------------------------------


def time_sheet(dataset: Results, study: Study) -> Sheet:
    """Errors over time: median, 5 to 95 %, and extremes over the bodies."""
    seen, least, shown = errors_seen(dataset, study), least_drawn(dataset, study), looks(study)
    panels = [
        partial(_draw_errors, dataset, shown, HISTORY[kind], least[kind], AXES[kind])
        for kind in seen
    ]
    return Sheet("errors over time: median, 5 to 95 %, largest", panels,
                 [look.key for look in shown])  # fmt: skip


def recorded_sheet(dataset: Results, study: Study) -> Sheet:
    """Other columns of the history over time, such as the energy and observables."""
    shown = looks(study)
    if not study.integrate.saves:
        return Sheet("", ())
    fields = _others(_schema(dataset, "history"), IN_HISTORY)
    panels = [partial(_draw_column, dataset, shown, each.name, _axis(each)) for each in fields]
    return Sheet("what else was recorded: median, 5 to 95 %", panels, [look.key for look in shown],
                 across=3)  # fmt: skip


def _draw_errors(
    dataset: Results, shown: list[Look], name: str, least: float, label: str, panel: Axes
) -> None:
    zeros, ends = [], []
    for look in shown:
        times, bands = _bands(dataset, look.setting, name, np.abs)
        if times.size < 2:
            continue
        times, bands = times[1:], bands[:, 1:]  # at the start there is no error yet
        if np.nanmax(bands[3], initial=0.0) <= least:
            if np.isfinite(bands[3]).any():
                zeros.append(look.key.label)
            continue
        low, median, high, most = positive(bands, least)
        colour, dash = look.key.colour, look.key.dash
        panel.plot(times, median, color=colour, linestyle=dash, linewidth=look.width)
        bottom = np.where(np.isnan(low), np.nanmin(positive(bands, least)), low)
        panel.fill_between(times, bottom, high, color=colour, alpha=0.18, linewidth=0)
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
        times, (low, median, high, _) = _bands(dataset, look.setting, name)
        if not np.isfinite(median).any():
            continue
        panel.plot(times, median, color=look.key.colour, linestyle=look.key.dash,
                   linewidth=look.width)  # fmt: skip
        panel.fill_between(times, low, high, color=look.key.colour, alpha=0.15, linewidth=0)
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


# ---- over the step -----------------------------------------------------------------------------


def order_sheet(dataset: Results, study: Study) -> Sheet:
    """Quantiles of the errors over dt, with a line of the method's order."""
    seen, least, found = errors_seen(dataset, study), least_drawn(dataset, study), findings(dataset)
    spaces = list(dict.fromkeys((s.cspace, s.method) for s in study.settings))
    first = [next(s for s in study.settings if (s.cspace, s.method) == own) for own in spaces]
    keys = []
    for look in looks(study, first):
        name = MATH_NAMES.get(look.setting.cspace, look.setting.cspace)
        keys.append(Key(f"{name}, {look.setting.method}", look.key.colour))
    panels = [
        partial(_draw_orders, found, list(zip(spaces, keys)), kind, least[kind]) for kind in seen
    ]
    return Sheet("errors over the step: median, 95 % and largest", panels, keys)


def _draw_orders(
    found: list[Found], spaces: list[tuple[tuple[str, str], Key]], kind: str, least: float,
    panel: Axes,
) -> None:  # fmt: skip
    zeros, ends = [], []
    lines: dict[int, float] = {}  # where each order's line begins
    for n, ((cspace, method), key) in enumerate(spaces):
        of = [f for f in found if (f.setting.cspace, f.setting.method) == (cspace, method)]
        of.sort(key=lambda f: f.setting.step)
        dts = np.array([f.setting.step for f in of])
        drawn = positive([f.quantiles[kind] for f in of], least)
        if np.isfinite([f.quantiles[kind] for f in of]).all() and not np.isfinite(drawn).any():
            zeros.append(key.label)
            continue
        for i, (marker, dash) in enumerate(zip("o^s", ("-", "--", ":"))):
            panel.plot(dts, drawn[:, i], color=key.colour, marker=marker, linestyle=dash,
                       markersize=4 + 3 * (n == 0 and len(spaces) > 1),
                       markerfacecolor="none" if n == 0 else None,
                       linewidth=2.2 if n == 0 else 1.2)  # fmt: skip
        ends += [(key.label, key.colour, dts[-1], y) for y in drawn[-1, :1] if np.isfinite(y)]
        median, size = drawn[-1, 0], of[-1].sizes[kind]
        if (order := tableau_of(method).order) and median > ROUNDING_FLOOR * size:
            lines[order] = min(lines.get(order, np.inf), median)
    order_lines(panel, lines, dts)
    panel.set_xlabel("Δt [s]")
    panel.set_ylabel(AXES[kind])
    log_axes(panel, "xy", zeros)
    if ends:
        panel.set_xticks(dts, [f"{dt:g}" for dt in dts], minor=False)
        panel.set_xticks([], minor=True)
    if len(spaces) > MOST_KEYS and ends:
        label_lines(panel, ends)


# ---- over what was sampled ---------------------------------------------------------------------


def parameter_sheet(dataset: Results, study: Study) -> Sheet:
    """The largest position error, or the rotation's or the drift, against what was sampled."""
    drawn = drawn_columns(dataset)
    kind, least = next(iter(errors_seen(dataset, study))), least_drawn(dataset, study)
    largest = [s for s in study.settings if s.step == step_sizes(study)[0]]
    shown = looks(study, largest)
    found = []
    for look in shown:
        rows = ok_columns(dataset, look.setting, [ERRORS[kind], *drawn])
        some = some_rows(len(rows[ERRORS[kind]]), POINTS)
        columns = {label: values[some] for label, values in labelled(drawn, rows, study)}
        found.append((look, rows[ERRORS[kind]][some], columns))
    panels = [
        partial(_draw_dots, found, label, least[kind], f"largest {AXES[kind]}")
        for label in found[0][2]
    ]
    keys = [Key(look.key.label, look.key.colour, is_dot=True) for look in shown]
    return Sheet("the largest error against what was sampled", panels, keys, across=3,
                 height=2.8)  # fmt: skip


def _draw_dots(
    found: list[tuple[Look, Array, dict[str, Array]]],
    label: str,
    least: float,
    error: str,
    panel: Axes,
) -> None:
    zeros, on_edge = [], []
    for n, (look, errors, columns) in enumerate(found):
        size = 2.0 + 2.4 * (len(found) - 1 - n) / len(found)  # a dot on another leaves its rim
        heights = positive(errors, least)
        if errors.size and not np.isfinite(heights).any():
            zeros.append(look.key.label)
            continue
        panel.plot(columns[label], heights, "o", color=look.key.colour, markersize=size,
                   markeredgewidth=0, alpha=0.6, rasterized=True)  # fmt: skip
        on_edge.append((look, columns[label][np.isnan(heights)]))
    panel.set_xlabel(label, parse_math=False)
    panel.set_ylabel(error)
    panel.locator_params(axis="x", nbins=5)
    log_axes(panel, "y", zeros)
    for look, at in on_edge:
        if at.size:
            panel.plot(at, np.zeros(at.size), "|", color=look.key.colour, markersize=7,
                       transform=panel.get_xaxis_transform(), clip_on=False)  # fmt: skip


# ---- events ------------------------------------------------------------------------------------


def event_sheet(dataset: Results, study: Study) -> Sheet:
    """To how many bodies each event has happened, over time."""
    shown = looks(study)
    panels = [partial(_draw_event, dataset, study, shown, name) for name in event_names(study)]
    keys = [look.key for look in shown]
    return Sheet("when each event first happened", panels, keys, across=3)


def _draw_event(dataset: Results, study: Study, shown: list[Look], name: str, panel: Axes) -> None:
    run = study.integrate
    for look in shown:
        first, _ = first_times(dataset, look.setting, name)
        if not first.size:
            continue
        had = first[np.isfinite(first)]
        ranks = np.unique(np.linspace(1, len(had), RANKS).astype(int))[: len(had)]
        times = np.concatenate([[run.t0], had[ranks - 1], [run.t_end]])
        share = np.concatenate([[0], ranks, [len(had)]]) / len(first)
        panel.step(times, share, where="post", color=look.key.colour, linestyle=look.key.dash,
                   linewidth=look.width)  # fmt: skip
    panel.set_xlabel("time [s]")
    panel.set_ylabel(f"share with: {name.replace('_', ' ')}", parse_math=False)
    panel.locator_params(axis="x", nbins=6)
    panel.set_ylim(-0.02, 1.02)


KINDS: dict[str, Callable[[Results, Study], Sheet]] = {
    "distribution": distribution_sheet,
    "time": time_sheet,
    "recorded": recorded_sheet,
    "events": event_sheet,
    "quantities": quantity_sheet,
    "order": order_sheet,
    "parameters": parameter_sheet,
}


# ---- data --------------------------------------------------------------------------------------


def _bands(
    dataset: Results, setting: Setting, name: str, of: Callable[[Any], Array] = np.asarray
) -> tuple[Array, Array]:
    """Times, and 5 %, 50 %, 95 % and the largest of `of` the column at each."""
    found = percentiles_over_time(dataset, name, setting, PERCENTILES, of=of)
    return as_array(found, "t"), np.stack([as_array(found, f"p{p:g}") for p in PERCENTILES])


def _schema(dataset: Results, name: str) -> pa.Schema:
    return dataset.table(name).schema


def _summary(dataset: Results) -> set[str]:
    return set(_schema(dataset, "summary").names)


def _others(schema: pa.Schema, known: set[str]) -> list[pa.Field]:
    """Columns of numbers that no other figure has; of joints' errors that have the largest."""
    return [
        field for field in schema
        if field.name.rpartition(".")[2] not in known
        and not field.name.startswith("sample.")
        and pa.types.is_floating(field.type)
    ]  # fmt: skip


def _axis(field: pa.Field) -> str:
    unit = (field.metadata or {}).get(b"unit", b"").decode()
    title = field.name.replace("_", " ")
    return f"{title} [{unit}]" if unit not in ("", "1") else title
