"""Figures of a study, by name."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

from lierb.errors import require_name
from lierb.results.panels import Sheet, figure_of
from lierb.studies.findings.columns import drawn_columns, ok_columns
from lierb.studies.findings.symbols import labelled
from lierb.studies.pages.over_bodies import distribution_sheet, parameter_sheet, quantity_sheet
from lierb.studies.pages.over_step import order_sheet
from lierb.studies.pages.over_time import event_sheet, recorded_sheet, time_sheet
from lierb.studies.storage.results import Results
from lierb.support.extras import require
from lierb.support.files import write_whole

require("plot")
from matplotlib.figure import Figure  # noqa: E402

from lierb.results.plots import picture  # noqa: E402

KINDS: dict[str, Callable[[Results], Sheet]] = {
    "distribution": distribution_sheet,
    "time": time_sheet,
    "recorded": recorded_sheet,
    "events": event_sheet,
    "quantities": quantity_sheet,
    "order": order_sheet,
    "parameters": parameter_sheet,
}
CAPTIONS = {
    "distribution": "The share of the bodies whose largest error is at or below a value, and "
    "histograms: each body's largest error (filled), and that at the end of its run (outline).",
    "time": "Median (thick), 5 to 95 % of the bodies (band) and the largest (thin) at each "
    "time, of the bodies that did not fail.",
    "recorded": "What else was recorded: median (line) and 5 to 95 % of the bodies (band) that "
    "did not fail.",
    "quantities": "What else the bodies' summaries have, without those that failed: a "
    "histogram for each setting.",
    "order": "Median, 95 % and largest of the bodies over the step; grey: the method's order.",
    "events": "The share of the bodies to which an event has happened by a time.",
    "parameters": "A dot is a body: the column by which bodies are ranked, against each sampled "
    "number; errors of zero on the lower edge.",
}

TITLES = {  # of figures that may be left out
    "time": "errors over time", "order": "errors over the step",
    "parameters": "figure over sampled numbers",
}  # fmt: skip


def omitted(dataset: Results) -> dict[str, str]:
    """Return the figures that are left out, by name, and the reason."""
    study, run, reasons = dataset.study, dataset.study.integrate, {}
    if not run.saves:
        reasons["time"] = "neither save_every nor save_at is set"
    if run.is_adaptive:
        reasons["order"] = "adaptive steps have no one size"
    elif len(run.dt) < 2:
        reasons["order"] = "there is one dt"
    rows = ok_columns(dataset, study.settings[0], list(drawn := drawn_columns(dataset)))
    if not labelled(drawn, [rows], study)[0]:
        reasons["parameters"] = "no numbers are sampled"
    return reasons


def sheets(dataset: Results, rank_by: str | None = None) -> Iterator[tuple[str, Sheet]]:
    """Yield the figures that are not left out, by name; a panel without data says so.

    rank_by : column of "parameters"; see `lierb.studies.findings.ranking.rankings`.
    """
    left_out = omitted(dataset)
    kinds = KINDS | {"parameters": partial(parameter_sheet, rank_by=rank_by)}
    for name, make in kinds.items():
        if name not in left_out:
            sheet = make(dataset)
            if sheet.panels:
                yield name, sheet


def figures(dataset: Results) -> Iterator[tuple[str, Figure]]:
    """Draw the figures of `sheets`."""
    for name, sheet in sheets(dataset):
        yield name, figure_of(sheet, dataset.study)


def figure(dataset: Results, name: str | None = None) -> Figure:
    """Draw one figure; see `Dataset.plot`."""
    drawable = dict(sheets(dataset))
    if name is None:
        name = "time" if "time" in drawable else "distribution"
    require_name("name", name, drawable)
    return figure_of(drawable[name], dataset.study)


def draw_all(dataset: Results, folder: Path) -> list[Path]:
    """Write the figures as PNG and SVG into `folder`; return the paths."""
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for name, drawn in figures(dataset):
        for kind in ("png", "svg"):
            path = folder / f"{name}.{kind}"
            write_whole(path, picture(drawn, kind))
            written.append(path)
    return written
