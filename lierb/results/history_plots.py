"""Draw a history: motion, energy, errors and other recorded columns over time.

Every column of numbers has a panel with its name and unit. Needs Matplotlib: the extra
`lierb[plot]`.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from itertools import cycle, pairwise
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from lierb.errors import ArgumentError, items_of, require_name
from lierb.model.mechanism.mechanism import Mechanism
from lierb.model.problem import Problem
from lierb.results.columns import as_array, unit_of
from lierb.results.failures import has_failed
from lierb.results.motion_panels import SUBSCRIPTS, Coordinates, Panel, Series, State, Trace
from lierb.results.states import RunStates, chosen_trajectories
from lierb.support.arrays import Array
from lierb.support.extras import require

require("plot")
import matplotlib  # noqa: E402
from matplotlib.axes import Axes  # noqa: E402
from matplotlib.figure import Figure  # noqa: E402
from matplotlib.lines import Line2D  # noqa: E402

from lierb.results.colours import COLOURS  # noqa: E402
from lierb.results.panels import draw_band, mark_of, positive  # noqa: E402
from lierb.results.plots import STYLE, ShownFigure  # noqa: E402

MOST_LINES = 6  # most trajectories drawn one by one; for more, quantiles are drawn
ACROSS = 3  # panels in a row
MOST_BESIDE = 24  # most characters of a legend beside a panel's title
DASHES = ("-", "--", ":", "-.", (0, (5, 1, 1, 1, 1, 1)), (0, (1, 3)))  # of components
KEYS = ("trajectory", "step", "t")
STATE = ("rotation", "position", "omega", "v")
ON_REQUEST = ("velocity_error", "rotation_rate_error", "work", "v")  # drawn on request
COORDINATES = ("angles", "slides")  # panels of the joints of a mechanism
MOTION = ("angles", "trace", "position", "omega")  # panels of the state
QUANTILES = (0.05, 0.5, 0.95)
LABELS = {"lambda": "λ", "omega": "ω", "position": "r", "v": "v"}
TITLES = {"lambda": "multipliers", "omega": "angular velocity"}
NO_NUMBER = "nothing to draw: not a number"


def history_figure(
    result: RunStates,
    columns: str | Iterable[str] = (),
    *,
    trajectories: int | Iterable[int] | None,
    problem: Problem | Mechanism | None,
) -> Figure:
    """Return a figure of a result's history; see `lierb.Result.plot`."""
    if result.history is None:
        raise ArgumentError(
            "there is no history to plot: integrate with save_every=… or save_at=…, and record="
            '["state", "energy"] for motion and energy'
        )
    count = result.summary.num_rows
    chosen = chosen_trajectories(trajectories, count, count)
    failed = has_failed(result.summary)
    names = (columns,) if isinstance(columns, str) else items_of("columns", columns, "names")
    made = _panels(result, problem)
    shown = _chosen(made, names)
    t = as_array(result.history["t"]).reshape(-1, count)[:, 0]
    with matplotlib.rc_context(STYLE):
        return _drawn([make() for make in shown], t, chosen, failed)


def _chosen(
    made: dict[str, Callable[[], Panel | Trace | None]], names: Sequence[str]
) -> list[Callable[[], Any]]:
    for name in names:
        require_name("columns", name, made)
    default = {name for name in made if name not in ON_REQUEST and "." not in name}
    if not default & {*MOTION, *COORDINATES}:  # a mechanism whose joints are unknown
        default |= {name for name in made if name.rpartition(".")[2] in MOTION}
    return [make for name, make in made.items() if name in (names or default)]


# ---- panels ------------------------------------------------------------------------------------


def _panels(
    result: RunStates, problem: Problem | Mechanism | None
) -> dict[str, Callable[[], Panel | Trace | None]]:
    """Return the drawing function of each panel with columns, by name, in figure order."""
    history = result.history
    assert history is not None
    known: Any = problem or (result._end.model if result._end else None)
    made: dict[str, Callable[[], Any]] = {}
    if result.links:
        if known is not None and known.link_names == result.links and result.has_states:
            coordinates = Coordinates(result, known)
            made |= {name: getattr(coordinates, name) for name in COORDINATES}
        left_out = {*KEYS, "rotation"}
    else:
        if set(STATE) <= {*history.column_names}:
            state = State(result, known)
            for name in MOTION:  # an observable may have such a name
                is_taken = name not in STATE and name in history.column_names
                made[f"{name} of the motion" if is_taken else name] = getattr(state, name)
        left_out = {*KEYS, *STATE[:-1], *_without_rows(known)}
    for column in history.schema:
        if column.name.rpartition(".")[2] not in left_out and _is_number(column.type):
            made |= _of_column(history, column, result.summary.num_rows)
    return made


def _without_rows(problem: Problem | None) -> set[str]:
    """Return the names of the errors without a constraint row."""
    if problem is None or any(element.kind.rows for element in problem.elements):
        return set()
    kinds = problem.joint.error_kinds
    return {f"{kind}_error" for kind in ("position", "rotation") if kind not in kinds}


def _is_number(kind: pa.DataType) -> bool:
    inner = kind.value_type if pa.types.is_fixed_size_list(kind) else kind
    return bool(pa.types.is_floating(inner) or pa.types.is_integer(inner))


def _of_column(history: pa.Table, column: pa.Field, count: int) -> dict[str, Callable[[], Panel]]:
    """Return a panel for each unit of a column's components."""
    width = column.type.list_size if pa.types.is_fixed_size_list(column.type) else 1
    units = unit_of(column).split(", ")
    units = units if len(units) == width else units[:1] * width

    def panel(unit: str, title: str, label: str) -> Panel:
        values = as_array(history[column.name]).reshape(-1, count, width)
        mine = [i for i in range(width) if units[i] == unit]
        labels = [f"{label}{each}" for each in SUBSCRIPTS] if width > 1 else [label]
        series = tuple(Series(name, values[..., i]) for name, i in zip(cycle(labels), mine))
        is_error = column.name.endswith(("_error", "_drift"))
        return Panel(title, unit, series, is_error)

    owner, _, name = column.name.rpartition(".")
    plain = TITLES.get(name, name.replace("_", " "))
    short = LABELS.get(name, plain)
    plain = f"{owner}: {plain}" if owner else plain
    distinct = list(dict.fromkeys(units))
    if name == "reaction":
        titles = {"N m": ("torque of the joint", "T"), "N": ("force of the joint", "F")}
        if owner:
            return {
                f"{owner}.{what.split()[0]}": partial(panel, u, f"{owner}: {what}", letter)
                for u in distinct
                for what, letter in [titles[u]]
            }
        return {titles[u][0]: partial(panel, u, *titles[u]) for u in distinct}
    if len(distinct) == 1:
        return {column.name: partial(panel, distinct[0], plain, short)}
    return {f"{column.name} [{unit}]": partial(panel, unit, plain, short) for unit in distinct}


# ---- looks -------------------------------------------------------------------------------------


def _drawn(
    made: Sequence[Panel | Trace | None], t: Array, chosen: list[int], failed: NDArray[np.bool_]
) -> Figure:
    """Draw the panels; quantiles are of the trajectories that have not failed, if there are any."""
    panels = [panel for panel in made if panel is not None]
    across = min(ACROSS, len(panels)) or 1
    down = -(-len(panels) // across) or 1
    figure = ShownFigure(figsize=(4.2 * across, 2.7 * down + 0.5), layout="constrained")
    axes = list(figure.subplots(down, across, squeeze=False).ravel())
    one_by_one, asked = len(chosen) <= MOST_LINES, len(chosen)
    if not one_by_one:
        chosen = [i for i in chosen if not failed[i]] or chosen
    for panel, each in zip(axes, panels):
        if isinstance(each, Trace):
            _draw_trace(panel, each, chosen)
        else:
            _draw_panel(panel, each, t, chosen, not one_by_one)
    for panel in axes[len(panels) :]:
        panel.set_visible(False)
    if one_by_one and len(chosen) > 1:
        lines = [Line2D([], [], color=COLOURS[n]) for n in range(len(chosen))]
        labels = [f"trajectory {i}{', failed' * bool(failed[i])}" for i in chosen]
        figure.legend(lines, labels, loc="outside lower left", ncols=6)
    elif not one_by_one:
        text = f"{len(chosen)} trajectories: median, 5 to 95 % shaded; errors: thin, the largest"
        if failed[chosen].any():
            text += "; all failed"
        elif len(chosen) < asked:
            text += f"; without the {asked - len(chosen)} that failed"
        figure.supxlabel(text, x=0.01, ha="left", fontsize=9, color="#555555")
    return figure


def _draw_panel(axes: Axes, panel: Panel, t: Array, chosen: list[int], many: bool) -> None:
    """Draw a line for each trajectory and component, or quantiles of many trajectories."""
    alone = len(chosen) == 1
    drawn = [np.abs(s.values[:, chosen]) if panel.is_error else s.values[:, chosen]
             for s in panel.series]  # fmt: skip
    if not any(np.nanmax(np.abs(values), initial=0.0) > 0.0 for values in drawn):
        text = NO_NUMBER if all(np.isnan(values).all() for values in drawn) else "exactly 0"
        axes.set_yticks([])
        axes.text(0.5, 0.5, text, transform=axes.transAxes, ha="center", va="center")
        drawn = []
    for n, (series, values) in enumerate(zip(panel.series, drawn)):
        dash: Any = "-" if alone or many else DASHES[n % len(DASHES)]
        own = COLOURS[n % len(COLOURS)]
        if many:
            _draw_bands(axes, t, values, own, panel.is_error)
        else:
            for i in range(len(chosen)):
                colour = own if alone else COLOURS[i % len(COLOURS)]
                line = positive(values[:, i], 0.0) if panel.is_error else values[:, i]
                mark = mark_of(line)
                axes.plot(t, line, marker=mark, color=colour, linestyle=dash, linewidth=1.1)
        legend = own if alone or many else "#333333"
        axes.plot([], [], color=legend, linestyle=dash, label=series.label)
    if panel.is_error and drawn:
        axes.set_yscale("log")
    if len(panel.series) > 1 and drawn:
        beside: dict[str, Any] = {"loc": "lower right", "bbox_to_anchor": (1.02, 0.98), "ncols": 6}
        if sum(len(series.label) for series in panel.series) > MOST_BESIDE:
            beside = {"loc": "best"}
        axes.legend(**beside, fontsize=8, handlelength=1.3, columnspacing=0.8, handletextpad=0.4)
    axes.set_title(panel.axis, loc="left", fontsize=10)
    axes.set_xlabel("time [s]")
    if len(t) > 1:
        axes.set_xlim(t[0], t[-1])
    else:
        axes.set(xlim=(t[0] - 0.5, t[0] + 0.5), xticks=t)


def _draw_bands(axes: Axes, t: Array, values: Array, colour: str, is_error: bool) -> None:
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore", RuntimeWarning)  # all trajectories may have failed
        low, median, high = np.nanquantile(values, QUANTILES, axis=1)
        most = np.nanmax(values, axis=1)
    if is_error:
        low, median, high, most = positive((low, median, high, most), 0.0)
    draw_band(axes, t, low, median, high, 0.2, color=colour, linewidth=1.3)
    if is_error:
        axes.plot(t, most, marker=mark_of(most), markersize=3, color=colour, linewidth=0.5)


def _draw_trace(axes: Axes, trace: Trace, chosen: list[int]) -> None:
    """Draw a trace on the sphere, with circles at 45°, 90° and 180° from the middle."""
    turn = np.linspace(0.0, 2 * np.pi, 181)
    for angle in (45, 90, 180):
        radius = 2.0 * np.sin(np.radians(angle) / 2.0)
        width = 1.0 if angle in (90, 180) else 0.5
        axes.plot(radius * np.cos(turn), radius * np.sin(turn), color="#bbbbbb", linewidth=width)
        axes.annotate(
            f"{angle}°", (0.0, radius), ha="center", va="bottom", fontsize=7, color="#777"
        )
    for n, number in enumerate(chosen[:MOST_LINES]):
        x, y = trace.points[:, number, 0], trace.points[:, number, 1]
        for a, b in pairwise([0, *_jumps(x, y), len(x)]):
            axes.plot(x[a:b], y[a:b], color=COLOURS[n % len(COLOURS)], linewidth=0.9)
        axes.plot(x[:1], y[:1], "o", color=COLOURS[n % len(COLOURS)], markersize=4)
    text = f", first {MOST_LINES}" if len(chosen) > MOST_LINES else ""
    axes.set_title(f"{trace.title}{text}", loc="left", fontsize=10)
    axes.set(aspect="equal", xticks=[], yticks=[], xlim=(-2.1, 2.1), ylim=(-2.1, 2.25))
    axes.grid(visible=False)
    for spine in axes.spines.values():
        spine.set_visible(False)


def _jumps(x: Array, y: Array) -> list[int]:
    """Return the indices at which the trace crosses to the other side of the rim."""
    far = np.hypot(np.diff(x), np.diff(y)) > 1.5
    return [int(i) + 1 for i in np.flatnonzero(far)]
