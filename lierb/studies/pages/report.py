"""Report of a study: one HTML page that opens without a network. Needs `lierb[report]`."""

from __future__ import annotations

import base64
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from lierb.analysis.magnitudes import kinds_of
from lierb.analysis.prediction import Prediction, joint_by_joint, predict
from lierb.errors import LierbError
from lierb.results.columns import as_array, unit_of
from lierb.studies.description.quantiles import BASIS, CONFIDENCE, PROBABILITIES, percent
from lierb.studies.description.settings import Setting
from lierb.studies.description.sources import STUDY
from lierb.studies.description.study import Study
from lierb.studies.findings import findings, statistics
from lierb.studies.findings.columns import drawn_columns, ok_columns
from lierb.studies.findings.linear_theory import linear_theories, remarks
from lierb.studies.findings.occurrences import crossings
from lierb.studies.findings.ranking import Ranking, rankings
from lierb.studies.findings.sizes import errors_seen
from lierb.studies.findings.tables import form_of, named, shares_of, with_interval
from lierb.studies.pages.replays import chosen, description_of, replayed
from lierb.studies.storage.parts import Parts
from lierb.studies.storage.replaying import call_of
from lierb.studies.storage.results import IS_SUCCESS, Results, setting_columns
from lierb.support.extras import require
from lierb.support.files import require_page, write_whole
from lierb.support.representations import apart, rounded

require("report")
import jinja2  # noqa: E402
from matplotlib.figure import Figure  # noqa: E402

from lierb.results.panels import MOST_KEYS, panels_of  # noqa: E402
from lierb.results.plots import picture  # noqa: E402
from lierb.studies.pages.explorer import WORST, explorer  # noqa: E402
from lierb.studies.pages.figures import CAPTIONS, TITLES, omitted, sheets  # noqa: E402

TEMPLATE = "report.html"
FAILED = 20  # most failed bodies that are listed
HEIGHT = {1: 560, 2: 620, 3: 760, 4: 760}  # height of the animation by its number of views, pixels


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
    environment.globals |= {  # functions that the template calls
        "call_of": call_of, "data_url": data_url, "form_of": form_of, "named": named,
        "orders": findings.orders,
        "panels_of": panels_of, "rounded": rounded, "shares_of": shares_of,
        "with_interval": with_interval, "zip": zip,
    }  # fmt: skip
    page = environment.get_template(TEMPLATE).render(_values(dataset, rank_by, probabilities))
    write_whole(path, page.encode())
    return path


def _values(
    dataset: Results, rank_by: str | None, probabilities: Sequence[float]
) -> dict[str, Any]:
    """Return the values of the template."""
    study, ranked, folder = dataset.study, rankings(dataset, rank_by), dataset.folder
    kinds = kinds_of(study.batch(0, 1).problem)
    percents = [percent(p) for p in probabilities]
    options = "" if rank_by is None else f" --rank-by={rank_by}"
    if tuple(probabilities) != PROBABILITIES:
        options += f" --quantiles={','.join(each.rstrip('%') for each in percents)}"
    theory = linear_theories(dataset, probabilities)
    return {
        "study": study,
        "text": dataset.study_text() or study.to_toml(),
        "manifest": dataset.manifest,
        "body_steps": _steps_done(dataset),
        "predictions": _predictions(study),
        "options": options,
        "folder": str(folder),
        "command": shlex.join(["lierb", "run", str(folder / STUDY), "--out", str(folder)]),
        "code": study.code,
        "asked": bool(study.problem.observables),
        "has_rows": bool(kinds),
        "failed": dataset.failures(),
        "failures": _failures(dataset),
        "percents": percents,
        "confidence": f"{CONFIDENCE:.0%}",
        "labels": {k: label for k, label in findings.LABELS.items() if k in (*kinds, "energy")},
        "errors": findings.findings(dataset),
        "basis": BASIS.get(study.sample.method, ""),
        "quantities": statistics.quantities(dataset, probabilities),
        "events": crossings(dataset, probabilities),
        "indices": statistics.indices(dataset),
        "theory": theory,
        "remarks": remarks(theory),
        "figures": list(sheets(dataset, rank_by)),
        "captions": CAPTIONS,
        "titles": TITLES,
        "most_keys": MOST_KEYS,
        "omitted": omitted(dataset),
        "explorer": explorer(dataset, ranked, errors_seen(dataset).values()),
        "motion": _motion(dataset, ranked[0]),
        "worst": [row for each in ranked for row in _worst(dataset, each)],
    }


def _steps_done(dataset: Results) -> int:
    """Return the number of steps of all bodies, rejected ones included."""
    if not dataset.study.has_lane_clocks:
        return Parts(dataset.study).work(dataset.parts)
    counts = dataset.table().to_table(columns=["steps", "rejected"])
    return int(as_array(counts["steps"]).sum() + as_array(counts["rejected"]).sum())


def _predictions(study: Study) -> list[tuple[str, Prediction]]:
    """Return predictions for each joint with rows of the first body; [] if no theorem applies."""
    try:
        first = study.batch(0, 1).first
        made = predict(first.problem, first.pose0, update=study.integrate.update)
        return [(joint, each) for joint, each in joint_by_joint(made) if each.rows]
    except LierbError:
        return []


def _motion(dataset: Results, ranking: Ranking) -> tuple[str, str] | None:
    """Return the animation of the worst and the median trajectory, and its description."""
    picked = chosen(dataset, ranking)
    if picked is None:
        return None
    animation = replayed(dataset.study, picked)
    return animation.frame(HEIGHT[len(animation.scene["views"])]), description_of(picked)


def data_url(figure: Figure) -> str:
    """Return a figure as the URL of an image."""
    return "data:image/svg+xml;base64," + base64.b64encode(picture(figure, "svg")).decode()


# ---- bodies ------------------------------------------------------------------------------------


def _worst(dataset: Results, ranking: Ranking) -> list[dict[str, Any]]:
    """Return the worst bodies, and their sampled numbers."""
    drawn, worst = drawn_columns(dataset), list[dict[str, Any]]()
    unit = unit_of(dataset.table().schema.field(ranking.column))
    for setting in dataset.study.settings:
        columns = ok_columns(dataset, setting, ["trajectory", ranking.column, *drawn])
        for i in ranking.order(columns[ranking.column])[:WORST]:
            worst.append(
                {name: values[i] for name, values in columns.items()} | {"setting": setting}
            )
    order = ranking.order(np.array([row[ranking.column] for row in worst]))
    worst = [worst[i] for i in order[:WORST]]
    values = apart([row[ranking.column] for row in worst])
    draws = {name.removeprefix("sample."): _drawn([row[name] for row in worst]) for name in drawn}
    return [
        {"ranking": named(ranking.label, unit), "value": values[i], "setting": row["setting"],
         "trajectory": int(row["trajectory"]),
         "draws": {name: texts[i] for name, texts in draws.items()}}
        for i, row in enumerate(worst)
    ]  # fmt: skip


def _drawn(draws: list[Any]) -> list[str]:
    """Format draws of a quantity, each component with digits that tell the bodies apart."""
    columns = zip(*(apart([*component]) for component in zip(*map(np.ravel, draws))))
    return [
        f"({', '.join(texts)})" if np.ndim(draw) else texts[0]
        for draw, texts in zip(draws, columns)
    ]


def _failures(dataset: Results) -> list[dict[str, Any]]:
    """Return rows of the first bodies that failed."""
    table = dataset.table()
    columns = [*setting_columns(table.schema), "trajectory", "status", "t"]
    rows = table.head(FAILED, columns=columns, filter=~IS_SUCCESS).to_pylist()
    return [row | {"setting": Setting.of_row(row)} for row in rows]
