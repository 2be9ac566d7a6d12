"""Define `lierb compare`: methods, c-spaces and steps side by side, on a study's problem."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from lierb.cli.studies import SET, STUDY_FILE, Changes, UserPath
from lierb.cli.terminal import print_whole, progress_of_cases, wrapped
from lierb.support.extras import require
from lierb.support.files import folder_of

if TYPE_CHECKING:
    from rich.table import Table

    from lierb.analysis.comparison import Comparison
    from lierb.studies.description.study import Study

MOST_BODIES = 64  # most bodies that are compared unless --n is given


def _words(_ctx: click.Context, _param: click.Parameter, given: tuple[str, ...]) -> list[str]:
    """Read an option that takes names, one or several with commas."""
    return [word.strip() for each in given for word in each.split(",") if word.strip()]


def _numbers(ctx: click.Context, param: click.Parameter, given: tuple[str, ...]) -> list[float]:
    """Read an option that takes numbers, one or several with commas."""
    try:
        return [float(word) for word in _words(ctx, param, given)]
    except ValueError as error:
        raise click.BadParameter(f"{error}; expected numbers, as 1e-2,5e-3") from None


def _several(name: str, callback: Any, metavar: str, text: str) -> Any:
    """Return an option for several values: with commas, or given more than once."""
    return click.option(name, multiple=True, callback=callback, metavar=metavar, help=text)


@click.command()
@STUDY_FILE
@SET
@_several("--methods", _words, "NAME,…", "As RK4,DOP853.  [default: the study's]")
@_several(
    "--dts", _numbers, "S,…",
    "Fixed steps, as 1e-2,5e-3.  [default: the study's; of one that, its half and its quarter]",
)  # fmt: skip
@_several(
    "--rtols", _numbers, "TOL,…",
    "Tolerances of adaptive steps, as 1e-6,1e-9; without --dts there are no fixed steps.  "
    "[default: the study's]",
)  # fmt: skip
@_several("--cspaces", _words, "NAME,…", "Of SE3, SO3xR3, reduced.  [default: the study's]")
@click.option(
    "--n", type=click.IntRange(min=1), metavar="N",
    help=f"Trajectories, the first of the study's.  [default: all, but at most {MOST_BODIES}]",
)  # fmt: skip
@click.option(
    "--norm", type=click.Choice(["largest", "median"]), default="largest", show_default=True,
    help="Of the errors over the trajectories.",
)  # fmt: skip
@click.option(
    "--repeats", type=click.IntRange(min=0), default=3, show_default=True,
    help="Timed repetitions of each run, of which the best counts; 0 for none.",
)  # fmt: skip
@click.option(
    "-o",
    "--out",
    type=UserPath(file_okay=False),
    help="Folder for the files.  [default: results/NAME-compared]",
)
@click.option("--markdown", "form", flag_value="markdown", help="Print the tables as Markdown.")
@click.option("--latex", "form", flag_value="latex", help="Print the tables as LaTeX.")
def compare(
    study: Path,
    changes: Changes,
    methods: list[str],
    dts: list[float],
    rtols: list[float],
    cspaces: list[str],
    n: int | None,
    norm: str,
    repeats: int,
    out: str | None,
    form: str | None,
) -> None:
    """Compare methods, c-spaces and steps on the problem of a STUDY, a TOML file (- for stdin).

    Each is run to the end of the study's time: errors against a reference with an error estimate of
    its own, CPU time on one thread, right-hand sides, drifts of joints and energy, observed orders.
    The folder has them as Parquet, Markdown, LaTeX and figures.

    \b
    lierb example heavy_top > heavy_top.toml
    lierb compare heavy_top.toml --methods Heun,RK4,DOP853 --dts 4e-3,2e-3,1e-3
    """
    require("study")
    from lierb.analysis.comparing import convergence
    from lierb.studies.description.study import Study

    loaded = Study.load(study, changes)
    name = loaded.name
    folder = folder_of(Path("results") / f"{name}-compared" if out is None else out)
    run, count = loaded.integrate, len(loaded.design)
    taken = min(count, MOST_BODIES) if n is None else n
    if taken > count:
        raise click.BadParameter(f"{n}; the study has {count}", param_hint="--n")
    if n is None and taken < count:
        click.echo(f"The first {taken} of {count} trajectories; --n takes others.", err=True)
    batch = loaded.batch(0, taken)
    control = _control(loaded, dts, rtols)
    if left := _left_out(loaded):
        click.echo(f"Not taken from the study: {', '.join(left)}.", err=True)
    with progress_of_cases() as progress:
        comparison = convergence(
            batch.problem, methods or run.method, **control, cspaces=cspaces or run.cspace,
            twist0=batch.twist0, pose0=batch.pose0, t_end=run.t_end, t0=run.t0, update=run.update,
            solver=run.solver, stabilise=loaded.stabilise, measure_every=run.measure_every,
            discontinuities=run.discontinuities,
            seed=loaded.sample.seed if batch.problem.controllers else 0, norm=norm,
            repeats=repeats, name=name, progress=progress,
        )  # fmt: skip
        progress(0, 1, "files")
        files = comparison.save(folder)
    _print(comparison, form)
    click.echo(
        f"Written to {folder}: {', '.join(path.name for path in files)}", err=form is not None
    )


def _print(comparison: Comparison, form: str | None) -> None:
    """Print the tables as Markdown, as LaTeX, or for a terminal with notes."""
    if form is not None:
        text = comparison.to_markdown() if form == "markdown" else comparison.to_latex()
        click.echo(text, nl=False)
        return
    for header, rows in comparison.text_tables():
        print_whole(_table(header, rows))
        click.echo()
    for note in comparison.notes:
        click.echo(wrapped(note))


def _control(study: Study, dts: list[float], rtols: list[float]) -> dict[str, Any]:
    """Return steps and tolerances from the options, or else from the study."""
    run = study.integrate
    if not (dts or rtols):
        if run.is_adaptive:
            rtols = [setting.step for setting in study.settings]
        else:
            first = run.dt[0]  # of a single step its half and quarter too, to give an order
            dts = run.dt if len(run.dt) > 1 else [first, first / 2, first / 4]
    atol = run.atol if rtols else None
    return {"dts": dts or None, "rtols": list(dict.fromkeys(rtols)) or None, "atol": atol}


def _left_out(study: Study) -> list[str]:
    """Return the keys of [integrate] that a comparison, of whole runs without saved rows, omits."""
    run = study.integrate
    keys = ("dt_min", "dt_max", "max_steps", "save_every", "save_at", "record", "sensitivities")
    left = [key for key in keys if getattr(run, key) not in (None, [])]
    return [*left, "dt"] if run.is_adaptive and run.dt else left


def _table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> Table:
    """Make a table for a terminal."""
    from lierb.studies.findings.tables import empty_table

    words = [name for name in header if name in ("method", "c-space", "over")]
    table = empty_table(words, header[len(words) :])
    for _, of_method in groupby(rows, key=lambda row: list(row[:2])):
        if len(words) < 3:
            table.add_section()
        for row in of_method:
            table.add_row(*row)
    return table
