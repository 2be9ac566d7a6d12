"""Draw the errors over the sampled numbers interactively, by the extra `lierb[report]`."""

from __future__ import annotations

from typing import Any

import numpy as np

from lierb.studies.description.study import Study
from lierb.studies.findings.columns import drawn_columns, ok_columns, some_rows
from lierb.studies.findings.findings import least_drawn
from lierb.studies.findings.symbols import labelled
from lierb.studies.pages.columns import AXES
from lierb.studies.pages.looks import looks, step_sizes
from lierb.studies.storage.results import Results
from lierb.support.arrays import Array
from lierb.support.extras import require

require("report")
import plotly.graph_objects as go  # noqa: E402

SYMBOLS = ("circle", "diamond", "square", "x")  # markers, from the largest dt to the smallest
POINTS = 3000  # most dots of a setting, in addition to its worst bodies
WORST = 5  # bodies with the largest errors of each kind, which are always shown


def explorer(dataset: Results, study: Study, seen: dict[str, str]) -> str:
    """Return the HTML of a figure of any error over any sampled number, a dot for each body.

    seen : columns of the errors, by kind.   Returns "" without sampled numbers or ok bodies.
    """
    drawn, least = drawn_columns(dataset), least_drawn(dataset, study)
    across: list[dict[str, Array]] = []
    up: list[dict[str, Array]] = []
    figure = go.Figure()
    sizes = step_sizes(study)
    for look in looks(study):
        rows = ok_columns(dataset, look.setting, ["trajectory", *seen.values(), *drawn])
        some = _chosen([rows[name] for name in seen.values()])
        across.append({label: values[some] for label, values in labelled(drawn, rows, study)})
        up.append({AXES[k]: rows[name][some] for k, name in seen.items()})
        figure.add_scatter(
            mode="markers", name=look.setting.label, customdata=rows["trajectory"][some],
            marker={"size": 5, "opacity": 0.5, "color": look.key.colour,
                    "symbol": SYMBOLS[sizes.index(look.setting.step) % len(SYMBOLS)]},
            hovertemplate="trajectory %{customdata}<br>%{x:.4g}, %{y:.2e}",
        )  # fmt: skip
    if not any(numbers.size for x in across for numbers in x.values()):
        return ""
    titles, errors = list(across[0]), list(up[0])
    for kind in seen:
        _raise_zeros([each[AXES[kind]] for each in up], least[kind])
    for trace, x, y in zip(figure.data, across, up, strict=True):
        trace.update(x=x[titles[0]], y=y[errors[0]])
    figure.update_layout(
        template="simple_white", height=560, hovermode="closest",
        margin={"t": 110, "r": 10, "l": 62},
        legend={"orientation": "h", "y": -0.18},
        xaxis={"title": {"text": titles[0]}, "showgrid": True},
        yaxis={"title": {"text": f"largest {errors[0]}"}, "type": "log", "showgrid": True,
               "exponentformat": "power"},
        updatemenus=[
            _menu("x", {title: [x[title] for x in across] for title in titles}, "", 1.3),
            _menu("y", {error: [y[error] for y in up] for error in errors}, "largest ", 1.16),
        ],
    )  # fmt: skip
    html: str = figure.to_html(
        full_html=False, include_plotlyjs=True, div_id="explorer",
        config={"displaylogo": False, "modeBarButtons": [["zoom2d", "pan2d", "resetScale2d"]]},
    )  # fmt: skip
    return html


def _raise_zeros(errors: list[Array], least: float) -> None:
    """Raise zeros, for a logarithmic axis, to a decade below the least of the rest."""
    every = np.concatenate(errors)
    floor = 0.1 * every[every > least].min(initial=max(every.max(initial=0.0), 10.0 * least))
    for each in errors:
        each[each <= least] = floor


def _menu(axis: str, choices: dict[str, list[Array]], prefix: str, high: float) -> dict[str, Any]:
    """Return an axis's menu of numbers.   choices : of each trace, by title.   high : ordinate."""
    buttons = [
        {
            "label": f"{axis}: {title}",
            "method": "update",
            "args": [{axis: numbers}, {f"{axis}axis.title.text": prefix + title}],
        }
        for title, numbers in choices.items()
    ]
    return {"buttons": buttons, "x": 0.0, "xanchor": "left", "y": high, "yanchor": "top"}


def _chosen(errors: list[Array]) -> Array:
    """Return the indices of the rows to draw: some, and the worst of each error."""
    worst = [np.argsort(-error, kind="stable")[:WORST] for error in errors]
    return np.unique(np.concatenate([some_rows(len(errors[0]), POINTS), *worst]))
