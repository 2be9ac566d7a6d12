"""A study's results as one HTML page that opens without a network. Needs `lierb[report]`."""

from __future__ import annotations

import base64
import io
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.compute as pc

from lierb.arrays import Array
from lierb.errors import LierbError
from lierb.extras import require
from lierb.prediction import Prediction, predict
from lierb.studies.dataset import Dataset
from lierb.studies.files import write_whole
from lierb.studies.findings import (
    LABELS,
    QUANTILES,
    Found,
    components,
    drawn_columns,
    errors_seen,
    findings,
    index_told,
    indices,
    least_drawn,
    ok_columns,
    orders,
    quantities,
    shown,
    some_rows,
    study_of,
    told,
    with_unit,
)
from lierb.studies.parts import parts_of
from lierb.studies.quantiles import CONFIDENCE
from lierb.studies.statistics import PROBABILITIES
from lierb.studies.study import Setting, Study

require("report")
import jinja2  # noqa: E402
import plotly.graph_objects as go  # noqa: E402
from matplotlib.figure import Figure  # noqa: E402

from lierb.plots import save  # noqa: E402
from lierb.studies.figures import AXES, figures, omitted, styles  # noqa: E402

TEMPLATE = "report.html"
SYMBOLS = ("circle", "diamond", "square", "x")  # from the largest dt to the smallest
POINTS = 3000  # of a setting in the interactive figure, beside its worst bodies
WORST = 5  # bodies that are listed for each error
FAILED = 20  # bodies that are listed
CAPTIONS = {
    "distribution": "The share of the bodies whose error is at or below a value, and histograms: "
    "each body's largest error (thick) and that at the end of its run (thin).",
    "time": "Median (thick), 5 to 95 % of the bodies (band) and the largest (thin) at each time.",
    "order": "Median, 95 % and largest of the bodies over the step; grey: order 4.",
    "parameters": "A dot is a body: its largest error against each sampled number.",
}


def write_report(dataset: Dataset, path: str | Path) -> Path:
    """Write the page on a study's finished parts: tables, figures, and how to reproduce them.

    dataset : as `lierb.run` returns it, or read; finished or not.   path : of the HTML file.
    """
    study, found = study_of(dataset), findings(dataset)
    seen = errors_seen(dataset, study)
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("lierb", ""),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    page = environment.get_template(TEMPLATE).render(
        zip=zip,
        study=study,
        text=dataset.study_text() or study.to_toml(),
        machine=dataset.manifest["machine"],
        digest=dataset.manifest["digest"],
        done=len(dataset.parts),
        asked=dataset.manifest["asked"],
        bodies=len(study.design),
        body_steps=parts_of(study).body_steps(dataset.parts),
        failed=dataset.failures(),
        predictions=_predictions(study),
        quantiles=[*(f"{q:.0%}" for q in QUANTILES[:-1]), "all"],
        probabilities=[f"{p:.0%}" for p in PROBABILITIES],
        confidence=f"{CONFIDENCE:.0%}",
        quantities=[
            (each.setting, with_unit(each), [told(q) for q in each.quantiles])
            for each in quantities(dataset)
        ],
        indices=[
            (
                each.setting,
                each.column,
                each.quantity,
                index_told(each.first),
                index_told(each.total),
            )
            for each in indices(dataset)
        ],
        ordered=len(set(study.integrate.dt)) > 1,
        errors=[_error_rows(found, each) for each in found],
        figures=[(name, CAPTIONS[name], _data_url(figure)) for name, figure in figures(dataset)],
        omitted=omitted(dataset),
        explorer=_explorer(dataset, study, seen),
        worst=_worst(dataset, study, seen),
        failures=_failures(dataset),
    )
    path = Path(path)
    write_whole(path, page.encode())
    return path


def _predictions(study: Study) -> list[Prediction]:
    """What the first body's joint keeps; nothing where no theorem says it."""
    batch = study.batch(0, 1)
    pose = None if batch.pose0 is None else batch.pose0[0]
    try:
        return list(predict(batch.problem.of_body(0), pose).values())
    except LierbError:
        return []


def _error_rows(found: list[Found], each: Found) -> tuple[Found, dict[str, list[str]]]:
    """A setting, and for each error its quantiles and its observed order."""
    seen = orders(found, each)
    return each, {
        label: [*map(shown, each.quantiles[kind]), str(seen[kind] or "–")]
        for kind, label in LABELS.items()
    }


def _data_url(figure: Figure) -> str:
    file = io.BytesIO()
    save(figure, file, "svg")
    return "data:image/svg+xml;base64," + base64.b64encode(file.getvalue()).decode()


# ---- bodies ------------------------------------------------------------------------------------


def _worst(dataset: Dataset, study: Study, seen: dict[str, str]) -> list[dict[str, Any]]:
    """The bodies with the largest errors of each kind, and what they drew."""
    listed = []
    drawn = drawn_columns(dataset)
    for kind, name in seen.items():
        largest = []
        for setting in study.settings:
            rows = ok_columns(dataset, setting, ["trajectory", name, *drawn])
            for i in np.argsort(-rows[name], kind="stable")[:WORST]:
                draws = {each.removeprefix("sample."): _drawn(rows[each][i]) for each in drawn}
                error, trajectory = float(rows[name][i]), int(rows["trajectory"][i])
                largest.append((error, setting, trajectory, draws))
        largest.sort(key=lambda each: -each[0])
        listed += [
            {"kind": LABELS[kind], "error": shown(error), "setting": setting.label,
             "trajectory": trajectory, "draws": draws}
            for error, setting, trajectory, draws in largest[:WORST]
        ]  # fmt: skip
    return listed


def _drawn(draw: Any) -> str:
    numbers = ", ".join(f"{x:.4g}" for x in np.atleast_1d(draw))
    return f"({numbers})" if np.ndim(draw) else numbers


def _failures(dataset: Dataset) -> list[dict[str, Any]]:
    """The first of the bodies that failed."""
    table = dataset.table().head(
        FAILED,
        columns=["cspace", "method", "dt", "trajectory", "status", "t"],
        filter=pc.field("status") != "ok",
    )
    rows: list[dict[str, Any]] = table.to_pylist()
    return [
        {"setting": Setting(row["cspace"], row["method"], row["dt"]).label, **row} for row in rows
    ]


# ---- the interactive figure --------------------------------------------------------------------


def _explorer(dataset: Dataset, study: Study, seen: dict[str, str]) -> str:
    """Any error against any sampled number, body by body; "" without such or a body that is ok."""
    drawn, least = drawn_columns(dataset), least_drawn(dataset, study)
    across: list[dict[str, Array]] = []
    up: list[dict[str, Array]] = []
    figure = go.Figure()
    dts = sorted(set(study.integrate.dt), reverse=True)
    for setting, style in styles(study):
        rows = ok_columns(dataset, setting, ["trajectory", *seen.values(), *drawn])
        some = _chosen([rows[name] for name in seen.values()])
        across.append({title: values[some] for title, values in components(drawn, rows)})
        up.append({AXES[k]: np.maximum(rows[name][some], least[k]) for k, name in seen.items()})
        figure.add_scatter(
            mode="markers", name=setting.label, customdata=rows["trajectory"][some],
            marker={"size": 5, "opacity": 0.5, "color": style["color"],
                    "symbol": SYMBOLS[dts.index(setting.dt) % len(SYMBOLS)]},
            hovertemplate="trajectory %{customdata}<br>%{x:.4g}, %{y:.2e}",
        )  # fmt: skip
    if not any(numbers.size for x in across for numbers in x.values()):
        return ""
    titles, errors = list(across[0]), list(up[0])
    for trace, x, y in zip(figure.data, across, up, strict=True):
        trace.update(x=x[titles[0]], y=y[errors[0]])
    figure.update_layout(
        template="simple_white", height=520, margin={"t": 60, "r": 20}, hovermode="closest",
        legend={"orientation": "h", "y": -0.18},
        xaxis={"title": {"text": titles[0]}, "showgrid": True},
        yaxis={"title": {"text": f"largest {errors[0]}"}, "type": "log", "showgrid": True,
               "exponentformat": "power"},
        updatemenus=[
            _menu("x", {title: [x[title] for x in across] for title in titles}, "", 0.0),
            _menu("y", {error: [y[error] for y in up] for error in errors}, "largest ", 0.45),
        ],
    )  # fmt: skip
    html: str = figure.to_html(
        full_html=False, include_plotlyjs=True, div_id="explorer",
        config={"displaylogo": False, "modeBarButtons": [["zoom2d", "pan2d", "resetScale2d"]]},
    )  # fmt: skip
    return html


def _menu(axis: str, choices: dict[str, list[Array]], prefix: str, place: float) -> dict[str, Any]:
    """A menu of what an axis shows: the numbers of each trace by title."""
    buttons = [
        {
            "label": f"{axis}: {title}",
            "method": "update",
            "args": [{axis: numbers}, {f"{axis}axis.title.text": prefix + title}],
        }
        for title, numbers in choices.items()
    ]
    return {"buttons": buttons, "x": place, "xanchor": "left", "y": 1.14, "yanchor": "top"}


def _chosen(errors: list[Array]) -> Array:
    """Rows to draw: some, and the worst of each error."""
    worst = [np.argsort(-error, kind="stable")[:WORST] for error in errors]
    return np.unique(np.concatenate([some_rows(len(errors[0]), POINTS), *worst]))
