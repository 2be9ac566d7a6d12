"""Draw results over the sampled numbers interactively, by the extra `lierb[report]`."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from lierb.studies.findings.columns import drawn_columns, ok_columns, some_rows
from lierb.studies.findings.ranking import Ranking
from lierb.studies.findings.symbols import labelled
from lierb.studies.pages.columns import Ordinate, ordinates
from lierb.studies.pages.looks import looks, step_sizes
from lierb.studies.storage.results import Results
from lierb.support.arrays import Array
from lierb.support.extras import require

require("report")
import plotly.graph_objects as go  # noqa: E402

SYMBOLS = ("circle", "diamond", "square", "x")  # markers, from the largest dt to the smallest
POINTS = 3000  # most dots of a setting, in addition to its worst bodies
WORST = 5  # worst bodies of each ranking, which are always shown


def explorer(dataset: Results, ranked: list[Ranking], errors: Iterable[str]) -> str:
    """Return the HTML of a figure of results over any sampled number, a dot for each body.

    errors : columns that the figure has beside those of the rankings.   Returns "" without sampled
    numbers or ok bodies.
    """
    study, drawn = dataset.study, drawn_columns(dataset)
    axes = ordinates(dataset, (*(each.column for each in ranked), *errors))
    columns = [axis.column for axis in axes]
    up: list[dict[str, Array]] = []
    figure = go.Figure()
    sizes = step_sizes(study)
    draws: list[dict[str, Array]] = []
    for look in looks(study):
        rows = ok_columns(dataset, look.setting, ["trajectory", *columns, *drawn])
        worst = [each.order(rows[each.column])[:WORST] for each in ranked]
        some = np.unique(np.concatenate([some_rows(len(rows["trajectory"]), POINTS), *worst]))
        draws.append({name: rows[name][some] for name in drawn})
        up.append({name: rows[name][some] for name in columns})
        figure.add_scatter(
            mode="markers", name=look.setting.label, customdata=rows["trajectory"][some],
            marker={"size": 5, "opacity": 0.5, "color": look.key.colour,
                    "symbol": SYMBOLS[sizes.index(look.setting.step) % len(SYMBOLS)]},
            hovertemplate="trajectory %{customdata}<br>%{x:.6g}, %{y:.6g}",
        )  # fmt: skip
    across = labelled(drawn, draws, study)
    if not any(numbers.size for x in across for numbers in x.values()):
        return ""
    titles = list(across[0])
    for axis in axes:
        if axis.least is not None:
            _raise_zeros([each[axis.column] for each in up], axis.least)
    for trace, x, y in zip(figure.data, across, up, strict=True):
        trace.update(x=x[titles[0]], y=y[columns[0]])
    figure.update_layout(
        template="simple_white", height=560, hovermode="closest",
        margin={"t": 110, "r": 10, "l": 62},
        legend={"orientation": "h", "y": -0.24},
        xaxis={"title": {"text": titles[0]}, "showgrid": True},
        yaxis={"title": {"text": axes[0].title}, "type": _scale(axes[0]), "showgrid": True,
               "exponentformat": "power"},
        updatemenus=[
            _menu("x", 1.3, [
                (title, {"x": [x[title] for x in across]}, {"xaxis.title.text": title})
                for title in titles
            ]),
            _menu("y", 1.16, [
                (axis.label, {"y": [y[axis.column] for y in up]},
                 {"yaxis.title.text": axis.title, "yaxis.type": _scale(axis)})
                for axis in axes
            ]),
        ],
    )  # fmt: skip
    html: str = figure.to_html(
        full_html=False, include_plotlyjs=True, div_id="explorer",
        config={"displaylogo": False, "responsive": True,
                "modeBarButtons": [["zoom2d", "pan2d", "resetScale2d"]]},
    )  # fmt: skip
    return html


def _raise_zeros(errors: list[Array], least: float) -> None:
    """Raise zeros, for a logarithmic axis, to a decade below the least of the rest."""
    every = np.concatenate(errors)
    floor = 0.1 * every[every > least].min(initial=max(every.max(initial=0.0), 10.0 * least))
    for each in errors:
        each[each <= least] = floor


def _scale(axis: Ordinate) -> str:
    return "linear" if axis.least is None else "log"


def _menu(
    axis: str, height: float, choices: list[tuple[str, dict[str, Any], dict[str, Any]]]
) -> dict[str, Any]:
    """Return the menu of an axis.   choices : label, changes of the traces and of the layout."""
    buttons = [
        {"label": f"{axis}: {label}", "method": "update", "args": [traces, layout]}
        for label, traces, layout in choices
    ]
    return {"buttons": buttons, "x": 0.0, "xanchor": "left", "y": height, "yanchor": "top"}
