"""Reproduce section 5 of Müller's paper (`lierb.analysis.paper_examples`)."""

from __future__ import annotations

import json
import os
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from lierb.analysis.convergence import Order, observed_order, verdict
from lierb.analysis.paper_examples import CSPACES, INERTIA, MASS, Example, PaperFigure, examples
from lierb.api import integrate
from lierb.kernels.mechanics.scale import length_of
from lierb.model.bodies.body import Body
from lierb.model.problem import Problem
from lierb.results.columns import numbers, repeated
from lierb.support import extras
from lierb.support.files import parquet, write_whole

Progress = Callable[[int, int, str], object]

METHOD = "RK4"
DTS = (1e-2, 1e-3, 1e-4)  # s
T_END = 10.0  # s
ROWS_PER_HISTORY = 1000


@dataclass(frozen=True)
class Finding:
    """A finding has errors of one kind, of one example in one c-space, with the paper's claim."""

    example: Example
    cspace: str
    quantity: str
    dts: tuple[float, ...]
    errors: tuple[float, ...]  # maxima over the run, one for each step size
    order: Order | None

    @property
    def verdict(self) -> str:
        return verdict(self.errors, self.order)

    @property
    def claim(self) -> str | None:
        claim: str | None = getattr(self.example.claims[self.cspace], self.quantity)
        return claim

    @property
    def agrees(self) -> bool | None:
        """Return True if the claim is confirmed, else False; None without a claim."""
        return None if self.claim is None else self.claim == self.verdict


@dataclass(frozen=True)
class PaperReport:
    """Results of `run_paper`.

    setting : method, update and gravity, as text.
    summary : one row per run (example × c-space × step size).   history : their histories.
    findings : one per example, c-space and error.   warnings : messages of `integrate`.
    files : paths that were written.
    """

    setting: str
    summary: pa.Table
    history: pa.Table
    findings: tuple[Finding, ...]
    warnings: tuple[str, ...]
    files: tuple[Path, ...] = ()


@dataclass(frozen=True)
class _Run:
    example: Example
    cspace: str
    dt: float
    summary: pa.Table
    history: pa.Table
    sizes: Mapping[str, float]  # size of each quantity


# ---- runs --------------------------------------------------------------------------------------


def run_paper(
    out: str | os.PathLike[str] | None = None,
    *,
    gravity: float = 0.0,
    update: str = "local",
    as_printed: bool = False,
    dts: Sequence[float] = DTS,
    t_end: float = T_END,
    figures: bool = True,
    progress: Progress | None = None,
) -> PaperReport:
    """Run every example of section 5 in both c-spaces with every step size.

    Parameters
    ----------
    out : path, optional
        Folder of `summary.parquet`, `history.parquet` and the figures. Default: no files.
    gravity : float, optional
        Acceleration along −e₃ of the ground, m/s². The paper does not mention gravity.
    update : {"local", "global", "ambient"}, optional
        Update, as in `integrate`.
    as_printed : bool, optional
        Use the examples with the paper's misprints.
    dts : sequence of float, optional
        Step sizes, s, each a divisor of `t_end`.
    t_end : float, optional
        End of the runs, s.
    figures : bool, optional
        Draw the figures.
    progress : callable, optional
        Function of (number of finished runs, number of all runs, name of the next run).

    Returns
    -------
    PaperReport
        Tables, findings, warnings and files.

    Raises
    ------
    MissingExtraError
        `figures` is True and Matplotlib is not installed.

    Examples
    --------
    >>> from lierb.analysis.paper import run_paper
    >>> report = run_paper(dts=(1e-2,), t_end=0.1)
    >>> report.summary.num_rows
    16
    """
    chosen = examples(as_printed)
    plan = list(product(chosen, CSPACES, dts))
    drawings: list[tuple[Example, PaperFigure]] = []
    if out is not None:
        # Both precede the runs, so that errors are raised at once.
        Path(out).mkdir(parents=True, exist_ok=True)
        if figures:
            extras.require("plot")
            drawings = [(example, figure) for example in chosen for figure in example.figures]
    total = len(plan) + len(drawings)

    announce = progress or (lambda done, total, what: None)
    runs = []
    warned: dict[str, None] = {}  # an ordered set
    for done, (example, cspace, dt) in enumerate(plan):
        announce(done, total, f"{example.title}: {cspace}, dt = {dt:g} s")
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            runs.append(_run(example, cspace, dt, t_end, gravity, update))
        for warning in caught:
            # The remedy after the semicolon is for callers of `integrate`.
            warned.setdefault(f"{example.title}: {str(warning.message).partition(';')[0]}")
    gravity_text = f"gravity {gravity:g} m/s² along -e3" if gravity else "no gravity"
    report = PaperReport(
        setting=f"{METHOD}, {update} update, {gravity_text}",
        summary=_concatenate([_labelled(run.summary, run) for run in runs]),
        history=_concatenate([_labelled(run.history, run) for run in runs]),
        findings=tuple(_findings(runs, chosen)),
        warnings=tuple(warned),
    )
    files = []
    if out is not None:
        files += _write_tables(report, Path(out))
        for done, (example, figure) in enumerate(drawings, start=len(plan)):
            announce(done, total, f"figure {figure.number}: {example.title}")
            files += _draw(report, example, figure, Path(out))
    announce(total, total, "done")
    return replace(report, files=tuple(files))


def _run(
    example: Example, cspace: str, dt: float, t_end: float, gravity: float, update: str
) -> _Run:
    joint = example.joint()
    problem = Problem(Body(mass=MASS, inertia=INERTIA), joint, gravity=(0.0, 0.0, -gravity))
    result = integrate(
        problem,
        twist0=joint.twist(omega=example.omega0, point_velocity=example.point_velocity),
        dt=dt,
        t_end=t_end,
        method=METHOD,
        cspace=cspace,
        update=update,
        save_every=max(1, round(t_end / dt / ROWS_PER_HISTORY)),
        record=("state",),
        check=example.check,
        solver="saddle",  # as in the paper
    )
    assert result.history is not None  # save_every was given
    places = result.history["position"].combine_chunks().flatten().to_numpy()
    size = float(length_of(problem.parameters()) + np.abs(places).max())
    # The states are needed only for that size; without them the files are small.
    history = result.history.drop_columns(["rotation", "position", "omega", "v"])
    return _Run(example, cspace, dt, result.summary, history, {"position": size, "rotation": 1.0})


def _findings(runs: Sequence[_Run], chosen: Sequence[Example]) -> Iterator[Finding]:
    for example, cspace in product(chosen, CSPACES):
        own = [run for run in runs if run.example is example and run.cspace == cspace]
        dts = tuple(run.dt for run in own)
        for quantity in example.quantities:
            errors = tuple(_largest_error(run.summary, quantity) for run in own)
            order = observed_order(dts, errors, [run.sizes[quantity] for run in own])
            yield Finding(example, cspace, quantity, dts, errors, order)


def _largest_error(summary: pa.Table, quantity: str) -> float:
    """Maximum over the run; NaN if the integration failed."""
    if summary["status"][0].as_py() != "ok":
        return float("nan")
    return float(summary[f"{quantity}_error_max"][0].as_py())


# ---- tables and files --------------------------------------------------------------------------


def _labelled(table: pa.Table, run: _Run) -> pa.Table:
    """Return `table` with leading columns that identify the run."""
    rows = table.num_rows
    labels = {"example": run.example.key, "reading": run.example.reading, "cspace": run.cspace}
    for place, (name, value) in enumerate(labels.items()):
        table = table.add_column(place, name, repeated(value, rows))
    dt_field = pa.field("dt", pa.float64(), metadata={"unit": "s"})
    return table.add_column(len(labels), dt_field, numbers(np.full(rows, run.dt)))


def _concatenate(tables: Sequence[pa.Table]) -> pa.Table:
    """Concatenate the runs; provenance entries that differ between runs form the list "runs"."""
    provenance = [json.loads(table.schema.metadata[b"lierb"]) for table in tables]
    shared = {
        key: value
        for key, value in provenance[0].items()
        if all(entries[key] == value for entries in provenance)
    }
    own = [{k: v for k, v in entries.items() if k not in shared} for entries in provenance]
    joined = pa.concat_tables([table.replace_schema_metadata(None) for table in tables])
    joined = joined.unify_dictionaries().combine_chunks()
    return joined.replace_schema_metadata({"lierb": json.dumps({**shared, "runs": own})})


def _write_tables(report: PaperReport, folder: Path) -> list[Path]:
    tables = {
        folder / "summary.parquet": report.summary,
        folder / "history.parquet": report.history,
    }
    for path, table in tables.items():
        write_whole(path, parquet(table, compression="zstd"))
    return list(tables)


def _draw(report: PaperReport, example: Example, figure: PaperFigure, folder: Path) -> list[Path]:
    from lierb.results import plots  # Matplotlib takes most of a second to import

    history, summary = (
        table.filter(pc.equal(table["example"], example.key))
        for table in (report.history, report.summary)
    )
    name = example.title[0].upper() + example.title[1:]
    drawing = plots.error_figure(
        history,
        summary,
        quantity=figure.quantity,
        title=f"{name} joint: {figure.quantity} error (figure {figure.number} of the paper)",
        subtitle=f"{report.setting}; reading: {example.reading}",
    )
    files = []
    for kind in ("png", "svg"):
        path = folder / f"figure_{figure.number}_{example.key}_{figure.quantity}.{kind}"
        write_whole(path, plots.picture(drawing, kind))
        files.append(path)
    return files
