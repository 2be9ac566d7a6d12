"""Report of a study: one HTML page that opens without a network. Needs `lierb[report]`."""

from __future__ import annotations

import base64
import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lierb.analysis.prediction import Prediction, joint_by_joint, predict
from lierb.errors import LierbError
from lierb.results.columns import as_array
from lierb.studies.description.quantiles import CONFIDENCE, PROBABILITIES, percent
from lierb.studies.description.settings import Setting
from lierb.studies.description.study import Study
from lierb.studies.findings.columns import drawn_columns, field_unit, ok_columns
from lierb.studies.findings.findings import (
    LABELS,
    SettingErrors,
    crossings,
    errors_seen,
    findings,
    indices,
    linear_theories,
    orders,
    quantities,
    study_of,
)
from lierb.studies.findings.linear_theory import left_out
from lierb.studies.findings.ranking import Ranking, rankings
from lierb.studies.findings.statistics import Spread
from lierb.studies.findings.tables import named, shares_of, with_interval
from lierb.studies.pages.replays import chosen, description_of, replayed
from lierb.studies.storage.parts import Parts
from lierb.studies.storage.replaying import call_of
from lierb.studies.storage.results import IS_SUCCESS, Results, setting_columns
from lierb.support.extras import require
from lierb.support.files import require_page, write_whole
from lierb.support.representations import rounded

require("report")
import jinja2  # noqa: E402
from matplotlib.figure import Figure  # noqa: E402

from lierb.results.panels import MOST_KEYS, Key, Sheet, panels_of  # noqa: E402
from lierb.results.plots import save  # noqa: E402
from lierb.studies.pages.explorer import WORST, explorer  # noqa: E402
from lierb.studies.pages.figures import CAPTIONS, omitted, sheets  # noqa: E402

TEMPLATE = "report.html"
FAILED = 20  # most failed bodies that are listed
HEIGHT = {1: 560, 2: 620, 3: 760, 4: 760}  # height of the animation by its number of views, pixels


@dataclass(frozen=True)
class Drawn:
    """Figure of the page: panels as data URLs, and the legend's keys."""

    name: str
    title: str
    caption: str
    panels: list[str]
    keys: list[Key]
    across: int


def write_report(
    dataset: Results,
    path: str | Path,
    *,
    rank_by: str | None = None,
    probabilities: Sequence[float] = PROBABILITIES,
) -> Path:
    """Write the page on a study's finished parts: tables, figures, and how to reproduce them.

    dataset : as `lierb.run` returns it, or read; finished or not.   path : of the HTML file.
    rank_by : column of the summary whose largest numbers are the worst, or `-COLUMN` for the
        smallest; by default as `lierb.studies.findings.ranking.rankings` chooses.
    probabilities : of the quantiles in the tables, more than 0 and less than 1.

    Raises StudyFileError if the page would replace a file that is no HTML page, and
    UnknownNameError for an unknown column.
    """
    path = Path(path)
    require_page(path)
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("lierb.studies.pages", ""),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    study = study_of(dataset)
    values = _values_of_run(dataset, study) | _values_of_findings(
        dataset, study, rank_by, probabilities
    )
    page = environment.get_template(TEMPLATE).render(zip=zip, study=study, **values)
    write_whole(path, page.encode())
    return path


def _values_of_run(dataset: Results, study: Study) -> dict[str, Any]:
    """Values of the template about the study and how it was run."""
    return {
        "text": dataset.study_text() or study.to_toml(),
        "machine": dataset.manifest["machine"],
        "digest": dataset.manifest["digest"],
        "done": len(dataset.parts),
        "asked": dataset.manifest["asked"],
        "bodies": len(study.design),
        "body_steps": _steps_done(dataset, study),
        "predictions": _predictions(study),
        "ordered": len(set(study.integrate.dt)) > 1,
        "step": "rtol" if study.integrate.is_adaptive else "dt, s",
    }


def _values_of_findings(
    dataset: Results, study: Study, rank_by: str | None, probabilities: Sequence[float]
) -> dict[str, Any]:
    """Return the values of the template about the results."""
    ranked, percents = rankings(dataset, study, rank_by), [percent(p) for p in probabilities]
    options = "" if rank_by is None else f" --rank-by={rank_by}"
    if tuple(probabilities) != PROBABILITIES:
        options += f" --quantiles={','.join(each.rstrip('%') for each in percents)}"
    theory = linear_theories(dataset, probabilities)
    summaries, seen, end = findings(dataset), errors_seen(dataset, study), study.integrate.t_end
    return {
        "options": options,
        "failed": dataset.failures(),
        "failures": _failures(dataset, study),
        "percents": percents,
        "confidence": f"{CONFIDENCE:.0%}",
        "errors": [_error_rows(summaries, each) for each in summaries],
        "quantities": [
            (each.setting, _named(each), [with_interval(q[1:]) for q in each.quantiles])
            for each in quantities(dataset, probabilities)
        ],
        "events": [
            (each, [with_interval(q[1:], beyond=f"> {end:g}") for q in each.first])
            for each in crossings(dataset, probabilities)
        ],
        "indices": [
            (*each[:3], with_interval(each.first, ".3f"), with_interval(each.total, ".3f"))
            for each in indices(dataset)
        ],
        "theory": [
            (
                each,
                named(each.name, each.unit),
                [share.strip() for share in shares_of(each)],
                [(f"{x:.3g}", with_interval(q[1:])) for x, q in zip(each.linear, each.sampled)],
            )
            for each in theory
        ],
        "left_out": left_out(theory),
        "figures": [_drawn_sheet(name, sheet) for name, sheet in sheets(dataset, rank_by)],
        "omitted": omitted(dataset),
        "explorer": explorer(dataset, study, ranked, seen.values()),
        "motion": _motion(dataset, study, ranked[0]),
        "worst": [row for each in ranked for row in _worst(dataset, study, each)],
    }


def _steps_done(dataset: Results, study: Study) -> int:
    """Return the number of steps of all bodies, rejected ones included."""
    table = dataset.table()
    if not study.has_lane_clocks:
        return Parts(study).work(dataset.parts)
    counts = table.to_table(columns=["steps", "rejected"])
    return int(as_array(counts["steps"]).sum() + as_array(counts["rejected"]).sum())


def _predictions(study: Study) -> list[tuple[str, Prediction]]:
    """Return predictions for each joint of the first body; [] if no theorem applies."""
    try:
        first = study.batch(0, 1).first
        return list(joint_by_joint(predict(*first, update=study.integrate.update)))
    except LierbError:
        return []


def _error_rows(
    summaries: list[SettingErrors], each: SettingErrors
) -> tuple[SettingErrors, dict[str, list[str]]]:
    """Return a setting, and for each error the median, the largest, and the observed order."""
    seen = orders(summaries, each)
    return each, {
        label: [*map(rounded, each.quantiles[kind][[0, -1]]), str(seen[kind] or "–")]
        for kind, label in LABELS.items()
    }


def _named(spread: Spread) -> str:
    """Format a quantity's name, its unit, and the number of bodies without a number."""
    name = named(spread.name, spread.unit)
    return f"{name} (not a number: {spread.undefined})" if spread.undefined else name


def _drawn_sheet(name: str, sheet: Sheet) -> Drawn:
    keys = list(sheet.keys) if len(sheet.keys) <= MOST_KEYS else []
    panels = [_data_url(figure) for figure in panels_of(sheet)]
    return Drawn(name, sheet.title, CAPTIONS[name], panels, keys, sheet.across)


def _motion(dataset: Results, study: Study, ranking: Ranking) -> tuple[str, str] | None:
    """Return the animation of the worst and the median trajectory, and its description."""
    picked = chosen(dataset, study, ranking)
    if picked is None:
        return None
    animation = replayed(study, picked)
    return animation.frame(HEIGHT[len(animation.scene["views"])]), description_of(picked)


def _data_url(figure: Figure) -> str:
    file = io.BytesIO()
    save(figure, file, "svg")
    return "data:image/svg+xml;base64," + base64.b64encode(file.getvalue()).decode()


# ---- bodies ------------------------------------------------------------------------------------


def _worst(dataset: Results, study: Study, ranking: Ranking) -> list[dict[str, Any]]:
    """Return the worst bodies, and their sampled numbers."""
    drawn, worst = drawn_columns(dataset), []
    unit = field_unit(dataset.table().schema.field(ranking.column))
    for setting in study.settings:
        rows = ok_columns(dataset, setting, ["trajectory", ranking.column, *drawn])
        values = rows[ranking.column]
        worst += [
            {"ranking": named(ranking.label, unit), "value": values[i], "setting": setting.label,
             "trajectory": int(rows["trajectory"][i]),
             "call": call_of(study, setting, int(rows["trajectory"][i])),
             "draws": {each.removeprefix("sample."): _drawn(rows[each][i]) for each in drawn}}
            for i in ranking.order(values)[:WORST]
        ]  # fmt: skip
    order = ranking.order(np.array([each["value"] for each in worst]))
    return [worst[i] for i in order[:WORST]]


def _drawn(draw: Any) -> str:
    numbers = ", ".join(f"{x:.4g}" for x in np.atleast_1d(draw))
    return f"({numbers})" if np.ndim(draw) else numbers


def _failures(dataset: Results, study: Study) -> list[dict[str, Any]]:
    """Return rows of the first bodies that failed."""
    table = dataset.table()
    columns = [*setting_columns(table.schema), "trajectory", "status", "t"]
    rows: list[dict[str, Any]] = table.head(FAILED, columns=columns, filter=~IS_SUCCESS).to_pylist()
    for row in rows:
        setting = Setting.of_row(row)
        row |= {"setting": setting.label, "call": call_of(study, setting, row["trajectory"])}
    return rows
