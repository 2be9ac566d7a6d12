"""Figures of a study: errors over its bodies, over time, over the step, over what was sampled."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from lierb.arrays import Array
from lierb.extras import require
from lierb.studies.convergence import ROUNDING_FLOOR
from lierb.studies.dataset import Dataset
from lierb.studies.files import write_whole
from lierb.studies.findings import (
    ERRORS,
    QUANTILES,
    components,
    drawn_columns,
    errors_seen,
    findings,
    least_drawn,
    ok_columns,
    some_rows,
    study_of,
)
from lierb.studies.sizes import rows_of
from lierb.studies.study import Setting, Study

require("plot")
import matplotlib  # noqa: E402
from matplotlib.axes import Axes  # noqa: E402
from matplotlib.figure import Figure  # noqa: E402

from lierb.plots import COLOURS, CSPACE_NAMES, STYLE, drawable, save  # noqa: E402

AXES = {
    "position": "position error [m]",
    "rotation": "rotation error",
    "energy": "energy drift [J]",
}
FINAL = {"position": "position_error_final", "rotation": "rotation_error_final"}
HISTORY = {"position": "position_error", "rotation": "rotation_error", "energy": "energy_drift"}
DASHES = ("-", "--", ":", "-.")
POINTS = 4000  # of a scatter plot, at most
RANKS = 2000  # points of a distribution function, at most
MOST_TITLE = 60  # characters of a study's name in a title
NO_BODY = "nothing to draw: no body got to its end"


def omitted(dataset: Dataset) -> dict[str, str]:
    """The figures that `figures` leaves out, by name, and why."""
    study = study_of(dataset)
    drawn = drawn_columns(dataset)
    rows = ok_columns(dataset, study.settings[0], list(drawn))
    reasons = {
        "time": (study.integrate.save_every is None, "save_every is not set"),
        "order": (len(set(study.integrate.dt)) < 2, "there is one dt"),
        "parameters": (not list(components(drawn, rows)), "no numbers are sampled"),
    }
    return {name: why for name, (is_left_out, why) in reasons.items() if is_left_out}


def figures(dataset: Dataset) -> Iterator[tuple[str, Figure]]:
    """Every figure that the study has settings for, by name; what has no data says so."""
    study, left_out = study_of(dataset), omitted(dataset)
    kinds: dict[str, Callable[[Dataset, Study], Figure]] = {
        "distribution": distribution_figure,
        "time": time_figure,
        "order": order_figure,
        "parameters": parameter_figure,
    }
    for name, draw in kinds.items():
        if name not in left_out:
            with matplotlib.rc_context(STYLE):
                figure = draw(dataset, study)
            yield name, figure


def draw_all(dataset: Dataset, folder: Path) -> list[Path]:
    """The figures, as PNG and SVG in `folder`."""
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for name, figure in figures(dataset):
        for kind in ("png", "svg"):
            path = folder / f"{name}.{kind}"
            content = BytesIO()
            save(figure, content, kind)
            write_whole(path, content.getvalue())
            written.append(path)
    return written


def distribution_figure(dataset: Dataset, study: Study) -> Figure:
    """How the errors are distributed over the bodies: shares at or below, and histograms.

    Of the largest errors thick, of those at the end of the run thin; a colour for each c-space and
    method, a dash for each dt.
    """
    shown, least = errors_seen(dataset, study), least_drawn(dataset, study)
    across = len(shown)
    figure, panels = _panels(
        study, "Errors over the bodies: largest (thick), at the end (thin)", across, 2
    )
    for n, (kind, largest) in enumerate(shown.items()):
        below, histogram = panels[n], panels[n + across]
        for setting, style in styles(study):
            for name, width in ((largest, 1.6), (FINAL.get(kind), 0.7)):
                if name is None:
                    continue
                found = ok_columns(dataset, setting, [name])[name]
                values = np.sort(drawable(found[np.isfinite(found)], least[kind]))
                if not values.size:
                    continue
                ranks = np.unique(np.linspace(0, values.size - 1, RANKS).astype(int))
                share = (ranks + 1) / values.size
                below.step(values[ranks], share, where="post", linewidth=width, **style)
                counts, edges = np.histogram(np.log10(values), _decades(values))
                histogram.stairs(
                    counts / values.size, 10.0**edges, color=style["color"],
                    linestyle=style["linestyle"], linewidth=width,
                )  # fmt: skip
        histogram.sharex(below)
        for panel in (below, histogram):
            panel.set_xlabel(AXES[kind])
            _log_axes(panel, "x")
    panels[0].set_ylabel("share of the bodies at or below")
    panels[across].set_ylabel("share of the bodies in a bin")
    _legend(figure, panels)
    return figure


def _decades(values: Array) -> Array:
    """Edges of a histogram's bins: ten to a decade, fewer than a hundred in all."""
    low, high = np.log10(values[0]), np.log10(values[-1])
    bins = int(np.clip(10 * (high - low), 10, 100))
    return np.linspace(low - 0.01, high + 0.01, bins + 1)


def time_figure(dataset: Dataset, study: Study) -> Figure:
    """Errors over time: median, 5 to 95 %, and extremes over the bodies."""
    shown, least = errors_seen(dataset, study), least_drawn(dataset, study)
    figure, panels = _panels(study, "Errors over time: median, 5 to 95 %, largest", len(shown))
    for panel, kind in zip(panels, shown):
        for setting, style in styles(study):
            times, bands = _bands(dataset, setting, HISTORY[kind])
            if times.size < 2:
                continue
            times, bands = times[1:], bands[:, 1:]  # at the start there is no error yet
            low, median, high, most = drawable(bands, least[kind])
            panel.plot(times, median, **style)
            panel.fill_between(times, low, high, color=style["color"], alpha=0.2, linewidth=0)
            panel.plot(times, most, color=style["color"], linewidth=0.6, alpha=0.8)
        panel.set_ylabel(AXES[kind])
        panel.set_xlabel("time [s]")
        _log_axes(panel, "y", "nothing to draw: no body got as far as the first rows")
    _legend(figure, panels)
    return figure


def order_figure(dataset: Dataset, study: Study) -> Figure:
    """Quantiles of the errors over dt, with a line of order 4."""
    shown, least = errors_seen(dataset, study), least_drawn(dataset, study)
    figure, panels = _panels(study, "Errors over the step: median, 95 % and largest", len(shown))
    found = findings(dataset)
    for panel, kind in zip(panels, shown):
        for (cspace, method), colour in zip(_spaces(study), COLOURS):
            of = [f for f in found if (f.setting.cspace, f.setting.method) == (cspace, method)]
            of.sort(key=lambda f: f.setting.dt)
            dts = np.array([f.setting.dt for f in of])
            for n, marker in zip(range(len(QUANTILES)), "o^s"):
                errors = drawable([f.quantiles[kind][n] for f in of], least[kind])
                label = _label(cspace, method) if n == 0 else None
                panel.plot(
                    dts, errors, color=colour, marker=marker, markersize=4, label=label,
                    linestyle=DASHES[n],
                )  # fmt: skip
                if n == 0 and errors[-1] > ROUNDING_FLOOR * of[-1].sizes[kind]:
                    panel.plot(dts, errors[-1] * (dts / dts[-1]) ** 4, color="#999999", zorder=0)
        panel.set_xlabel("Δt [s]; grey: order 4")
        panel.set_ylabel(AXES[kind])
        _log_axes(panel, "xy")
    _legend(figure, panels)
    return figure


def parameter_figure(dataset: Dataset, study: Study) -> Figure:
    """The largest position error, or the rotation's or the drift, against what was sampled."""
    drawn = drawn_columns(dataset)
    rows = ok_columns(dataset, study.settings[0], [*ERRORS.values(), *drawn])
    columns = list(components(drawn, rows))
    kind, least = next(iter(errors_seen(dataset, study))), least_drawn(dataset, study)
    across = min(len(columns), 4)
    figure, panels = _panels(
        study, "The largest error against what was sampled", across, -(-len(columns) // across)
    )
    for setting, style in styles(study):
        if setting.dt != max(study.integrate.dt):
            continue
        rows = ok_columns(dataset, setting, [ERRORS[kind], *drawn])
        some = some_rows(len(rows[ERRORS[kind]]), POINTS)
        errors = drawable(rows[ERRORS[kind]][some], least[kind])
        for panel, (name, values) in zip(panels, components(drawn, rows)):
            panel.plot(
                values[some], errors, ".", color=style["color"], markersize=2, alpha=0.4,
                label=style["label"], rasterized=True,
            )  # fmt: skip
            panel.set_xlabel(name, parse_math=False)
    for panel in panels[: len(columns)]:
        _log_axes(panel, "y")
    panels[0].set_ylabel(f"largest {AXES[kind]}")
    for panel in panels[len(columns) :]:
        panel.set_visible(False)
    _legend(figure, panels)
    return figure


# ---- data --------------------------------------------------------------------------------------


def _bands(dataset: Dataset, setting: Setting, name: str) -> tuple[Array, Array]:
    """Times, and 5 %, 50 %, 95 % and the largest of |error| at each."""
    table = dataset.table("history").to_table(columns=["step", "t", name], filter=rows_of(setting))
    steps, values = table["step"].to_numpy(), np.abs(table[name].to_numpy())
    if not len(steps):
        return np.empty(0), np.empty((4, 0))
    order = np.argsort(steps, kind="stable")
    whole, starts = np.unique(steps[order], return_index=True)
    groups = np.split(values[order], starts[1:])
    times = table["t"].to_numpy()[order][starts]
    bands = np.full((4, len(whole)), np.nan)
    for n, group in enumerate(groups):
        alive = group[~np.isnan(group)]
        if alive.size:
            bands[:, n] = np.quantile(alive, (0.05, 0.5, 0.95, 1.0))
    return times, bands


# ---- looks -------------------------------------------------------------------------------------


def _spaces(study: Study) -> list[tuple[str, str]]:
    return list(dict.fromkeys((s.cspace, s.method) for s in study.settings))


def _label(cspace: str, method: str) -> str:
    return f"{CSPACE_NAMES.get(cspace, cspace)}, {method}"


def styles(study: Study) -> Iterator[tuple[Setting, dict[str, Any]]]:
    """A colour for each c-space and method, a dash for each dt."""
    spaces, dts = _spaces(study), sorted(set(study.integrate.dt), reverse=True)
    for setting in study.settings:
        colour = COLOURS[spaces.index((setting.cspace, setting.method)) % len(COLOURS)]
        dash = DASHES[dts.index(setting.dt) % len(DASHES)]
        step = f", Δt = {setting.dt:g} s" if len(dts) > 1 else ""
        label = _label(setting.cspace, setting.method) + step
        yield setting, {"color": colour, "linestyle": dash, "label": label}


def _log_axes(panel: Axes, axes: str, why: str = NO_BODY) -> None:
    """Logarithmic axes; where nothing is drawn, which has none, the reason instead."""
    is_drawn = bool(panel.patches) or any(
        np.isfinite(np.asarray(line.get_ydata(), dtype=float)).any() for line in panel.lines
    )
    if is_drawn:
        panel.set(**{f"{axis}scale": "log" for axis in axes})
        return
    panel.set(xticks=[], yticks=[])
    panel.text(0.5, 0.5, why, transform=panel.transAxes, ha="center", va="center", wrap=True)


def _panels(study: Study, title: str, across: int, down: int = 1) -> tuple[Figure, list[Axes]]:
    width = max(7.5, 3.6 * across + 0.8)  # room for the title
    figure = Figure(figsize=(width, 3.4 * down + 1.0), layout="constrained")
    name = study.name if len(study.name) <= MOST_TITLE else f"{study.name[:MOST_TITLE]}…"
    figure.suptitle(
        f"{name}: {title}",
        x=0.01,
        ha="left",
        fontsize=12,
        fontweight="bold",
        parse_math=False,
    )
    return figure, list(figure.subplots(down, across, squeeze=False).ravel())


def _legend(figure: Figure, panels: list[Axes]) -> None:
    handles, labels = panels[0].get_legend_handles_labels()
    first = {label: handle for handle, label in reversed([*zip(handles, labels)])}
    labels, handles = [*reversed(first)], [*reversed(first.values())]
    dots = bool(handles) and getattr(handles[0], "get_linestyle", str)() == "None"
    figure.legend(handles, labels, loc="outside lower left", ncols=4, markerscale=4 if dots else 1)
