"""A study's results as one HTML page that opens without a network. Needs `lierb[report]`."""

from __future__ import annotations

import base64
import io
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lierb.analysis.prediction import Prediction, joint_by_joint, predict
from lierb.errors import LierbError
from lierb.studies.description.quantiles import CONFIDENCE
from lierb.studies.description.settings import Setting
from lierb.studies.description.study import Study
from lierb.studies.findings.findings import (
    LABELS,
    QUANTILES,
    Found,
    drawn_columns,
    errors_seen,
    findings,
    first_told,
    happened,
    index_told,
    indices,
    least_drawn,
    ok_columns,
    orders,
    quantile_told,
    quantities,
    some_rows,
    study_of,
    with_unit,
)
from lierb.studies.findings.sizes import as_array
from lierb.studies.findings.statistics import PROBABILITIES
from lierb.studies.findings.symbols import labelled
from lierb.studies.pages.looks import looks, step_sizes
from lierb.studies.pages.replays import chosen, replayed, told
from lierb.studies.storage.parts import parts_of
from lierb.studies.storage.results import IS_FINE, Results, setting_columns
from lierb.support.arrays import Array
from lierb.support.extras import require
from lierb.support.files import require_page, write_whole
from lierb.support.shown import rounded

require("report")
import jinja2  # noqa: E402
import plotly.graph_objects as go  # noqa: E402
from matplotlib.figure import Figure  # noqa: E402

from lierb.results.panels import MOST_KEYS, Key, Sheet, panels_of  # noqa: E402
from lierb.results.plots import save  # noqa: E402
from lierb.studies.pages.columns import AXES  # noqa: E402
from lierb.studies.pages.figures import CAPTIONS, omitted, sheets  # noqa: E402

TEMPLATE = "report.html"
SYMBOLS = ("circle", "diamond", "square", "x")  # from the largest dt to the smallest
POINTS = 3000  # of a setting in the interactive figure, beside its worst bodies
WORST = 5  # bodies that are listed for each error
FAILED = 20  # bodies that are listed
HEIGHT = {1: 560, 2: 620, 3: 760, 4: 760}  # of the moving picture by its views, pixels


@dataclass(frozen=True)
class Drawn:
    """A figure as the page has it: panels as data URLs, and what their lines are."""

    name: str
    title: str
    caption: str
    panels: list[str]
    keys: list[Key]
    across: int


def write_report(dataset: Results, path: str | Path) -> Path:
    """Write the page on a study's finished parts: tables, figures, and how to reproduce them.

    dataset : as `lierb.run` returns it, or read; finished or not.   path : of the HTML file.

    Raises StudyFileError where the page would replace a file that is no HTML page.
    """
    path = Path(path)
    require_page(path)
    study, found = study_of(dataset), findings(dataset)
    seen = errors_seen(dataset, study)
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("lierb.studies.pages", ""),
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
        body_steps=_steps_done(dataset, study),
        failed=dataset.failures(),
        predictions=_predictions(study),
        quantiles=[*(f"{q:.0%}" for q in QUANTILES[:-1]), "all"],
        probabilities=[f"{p:.0%}" for p in PROBABILITIES],
        confidence=f"{CONFIDENCE:.0%}",
        quantities=[
            (each.setting, with_unit(each), [quantile_told(q) for q in each.quantiles])
            for each in quantities(dataset)
        ],
        events=[
            (each, [first_told(q, study.integrate.t_end) for q in each.first])
            for each in happened(dataset)
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
        step="rtol" if study.integrate.is_adaptive else "dt, s",
        errors=[_error_rows(found, each) for each in found],
        figures=[_drawn_sheet(name, sheet) for name, sheet in sheets(dataset)],
        omitted=omitted(dataset),
        explorer=_explorer(dataset, study, seen),
        motion=_motion(dataset, study),
        worst=_worst(dataset, study, seen),
        failures=_failures(dataset),
    )
    write_whole(path, page.encode())
    return path


def _steps_done(dataset: Results, study: Study) -> int:
    """Of all bodies, those that were refused among them."""
    table = dataset.table()
    if not study.has_lane_clocks:
        return parts_of(study).work(dataset.parts)
    counts = table.to_table(columns=["steps", "rejected"])
    return int(as_array(counts, "steps").sum() + as_array(counts, "rejected").sum())


def _predictions(study: Study) -> list[tuple[str, Prediction]]:
    """What each of the first body's joints keeps; nothing where no theorem says it."""
    try:
        return list(joint_by_joint(predict(*study.batch(0, 1).first)))
    except LierbError:
        return []


def _error_rows(found: list[Found], each: Found) -> tuple[Found, dict[str, list[str]]]:
    """A setting, and for each error its quantiles and its observed order."""
    seen = orders(found, each)
    return each, {
        label: [*map(rounded, each.quantiles[kind]), str(seen[kind] or "–")]
        for kind, label in LABELS.items()
    }


def _drawn_sheet(name: str, sheet: Sheet) -> Drawn:
    keys = list(sheet.keys) if len(sheet.keys) <= MOST_KEYS else []
    panels = [_data_url(figure) for figure in panels_of(sheet)]
    return Drawn(name, sheet.title, CAPTIONS[name], panels, keys, sheet.across)


def _motion(dataset: Results, study: Study) -> tuple[str, str] | None:
    """The moving picture of the worst and the median trajectory, and what it shows."""
    picked = chosen(dataset, study)
    if picked is None:
        return None
    animation = replayed(study, picked)
    return animation.frame(HEIGHT[len(animation.scene["views"])]), told(picked)


def _data_url(figure: Figure) -> str:
    file = io.BytesIO()
    save(figure, file, "svg")
    return "data:image/svg+xml;base64," + base64.b64encode(file.getvalue()).decode()


# ---- bodies ------------------------------------------------------------------------------------


def _worst(dataset: Results, study: Study, seen: dict[str, str]) -> list[dict[str, Any]]:
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
            {"kind": LABELS[kind], "error": rounded(error), "setting": setting.label,
             "trajectory": trajectory, "draws": draws}
            for error, setting, trajectory, draws in largest[:WORST]
        ]  # fmt: skip
    return listed


def _drawn(draw: Any) -> str:
    numbers = ", ".join(f"{x:.4g}" for x in np.atleast_1d(draw))
    return f"({numbers})" if np.ndim(draw) else numbers


def _failures(dataset: Results) -> list[dict[str, Any]]:
    """The first of the bodies that failed."""
    table = dataset.table()
    columns = [*setting_columns(table.schema), "trajectory", "status", "t"]
    rows: list[dict[str, Any]] = table.head(FAILED, columns=columns, filter=~IS_FINE).to_pylist()
    return [{"setting": Setting.of_row(row).label, **row} for row in rows]


# ---- the interactive figure --------------------------------------------------------------------


def _explorer(dataset: Results, study: Study, seen: dict[str, str]) -> str:
    """Any error against any sampled number, body by body; "" without such or a body that is ok."""
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
    """Zeros, which a logarithmic axis has no place for, go a decade below the least of the rest."""
    every = np.concatenate(errors)
    floor = 0.1 * every[every > least].min(initial=max(every.max(initial=0.0), 10.0 * least))
    for each in errors:
        each[each <= least] = floor


def _menu(axis: str, choices: dict[str, list[Array]], prefix: str, high: float) -> dict[str, Any]:
    """A menu of what an axis shows, the numbers of each trace by title; one above the other."""
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
    """Rows to draw: some, and the worst of each error."""
    worst = [np.argsort(-error, kind="stable")[:WORST] for error in errors]
    return np.unique(np.concatenate([some_rows(len(errors[0]), POINTS), *worst]))
