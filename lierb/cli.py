"""The `lierb` command. Needs click and rich: `pip install "lierb[cli]"`.

Each command imports what it runs inside its function, so that `lierb --help` stays quick.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import groupby, zip_longest
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from lierb.errors import LierbError
from lierb.extras import MissingExtraError, require

if TYPE_CHECKING:
    from rich.table import Table

    from lierb.dataset import Dataset
    from lierb.paper import Finding, PaperReport

INTERRUPTED = 130  # 128 + SIGINT, as shells have it


class Commands(click.Group):
    """A group whose commands end with one sentence where Python would show a traceback."""

    def invoke(self, ctx: click.Context) -> Any:
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:
            click.echo("\nInterrupted. No file is left half-written.", err=True)
            ctx.exit(INTERRUPTED)
        except BrokenPipeError:
            raise  # `lierb … | head`: click ends quietly
        except (MissingExtraError, LierbError, OSError) as error:
            raise click.ClickException(str(error)) from error


@click.group(cls=Commands, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="lierb")
def cli() -> None:
    """Constrained rigid bodies on Lie groups, many at once."""


def finite(_ctx: click.Context, _param: click.Parameter, value: float) -> float:
    """Callback for options that take a finite number."""
    if not math.isfinite(value):
        raise click.BadParameter(f"{value} is not a finite number")
    return value


@cli.command()
@click.option(
    "--out",
    type=click.Path(file_okay=False, path_type=Path),
    default=Path("results/paper"),
    show_default=True,
    help="Folder for the tables and figures.",
)
@click.option(
    "--gravity",
    type=float,
    default=0.0,
    show_default=True,
    callback=finite,
    help="In m/s², along -e3 of the ground; the paper mentions none.",
)
@click.option(
    "--update",
    type=click.Choice(["local", "global"]),
    default="local",
    show_default=True,
    help="How a step updates the configuration.",
)
@click.option("--as-printed", is_flag=True, help="Keep the mistakes that the paper prints.")
@click.option("--no-figures", is_flag=True, help="Write the tables only.")
def paper(out: Path, gravity: float, update: str, as_printed: bool, no_figures: bool) -> None:
    """Reproduce section 5 of the paper that lierb grew out of.

    Every joint in both c-spaces, RK4 with three step sizes over 10 s: how well does each keep its
    constraints, and does that agree with the paper's claims? (A. Müller, BIT 56, 2016)
    """

    from lierb.paper import T_END, run_paper

    with _progress() as progress:
        report = run_paper(
            out,
            gravity=gravity,
            update=update,
            as_printed=as_printed,
            figures=not no_figures,
            progress=progress,
        )
    click.echo(f"Section 5 of the paper over {T_END:g} s: {report.setting}\n")
    _print_whole(_findings_table(report))
    for line in _closing_lines(report, out):
        click.echo(line)


@cli.command()
@click.option("--json", "as_json", is_flag=True, help="As JSON, for a report or a script.")
def info(as_json: bool) -> None:
    """What lierb runs with here: versions, CPU, lanes, threads, compiled kernels."""
    import json

    import lierb

    found = lierb.info()
    if as_json:
        click.echo(json.dumps(found, indent=2))
        return
    cache = found.pop("cache")
    rows = {
        "versions": ", ".join(
            f"{name} {found[name]}"
            for name in ("lierb", "python", "numba", "llvmlite", "numpy", "pyarrow")
        ),
        "platform": found["platform"],
        "CPU": f"{found['cpu']} ({', '.join(found['vectors'])}{', fma' * found['fma']})",
        "lanes": f"{found['lanes']} bodies in a vector register",
        "threads": f"{found['threads']} ({found['threading_layer']})",
        "cache": cache["folder"] or "none: the JIT is off",
        "compiled": f"{cache['kernels']} kernels of this version, {cache['bytes'] / 1e6:.1f} MB",
    }
    for name, text in rows.items():
        click.echo(f"{name:10}{text}")


@cli.command()
@click.argument("joint", nargs=-1)
@click.option("--method", multiple=True, default=["RK4"], show_default=True)
@click.option(
    "--cspace", multiple=True, default=["SE3"], show_default=True,
    help="SE3, SO3xR3 or reduced.",
)  # fmt: skip
@click.option(
    "--update", multiple=True, default=["local"], show_default=True, help="local or global."
)
@click.option("--solver", default="auto", show_default=True, help="auto or saddle.")
@click.option("--multipliers", is_flag=True, help="The kernels of runs that record them.")
def warmup(
    joint: tuple[str, ...],
    method: tuple[str, ...],
    cspace: tuple[str, ...],
    update: tuple[str, ...],
    solver: str,
    multipliers: bool,
) -> None:
    """Compile ahead of time what later processes then load from the disk cache.

    JOINT is a name such as spherical (the default), or several. Every option but --solver may be
    given more than once: each combination is compiled. Or it is the TOML file of a study.
    """
    import lierb

    if len(joint) == 1 and joint[0].endswith(".toml"):
        require("study")
        from lierb.running import compile_for

        for setting, seconds in compile_for(joint[0]):
            click.echo(f"{setting.label:40}{seconds:6.2f} s")
        return
    with _progress() as progress:
        kernels = lierb.warmup(
            joint or ("spherical",), methods=method, cspaces=cspace, updates=update,
            solver=solver, multipliers=multipliers, progress=progress,
        )  # fmt: skip
    for kernel in kernels:
        name = f"{kernel.joint}, {kernel.method}, {kernel.cspace}, {kernel.update}"
        click.echo(f"{name:40}{kernel.seconds:6.2f} s")
    click.echo(f"{len(kernels)} kernels are ready in {lierb.info()['cache']['folder']}")


STUDY = click.argument("study", type=click.Path(exists=True, dir_okay=False, path_type=Path))


@cli.command()
@STUDY
@click.option(
    "--out", type=click.Path(file_okay=False, path_type=Path),
    help="Folder for the results.  [default: results/NAME]",
)  # fmt: skip
@click.option("--resume", is_flag=True, help="Go on with what an earlier run has left.")
@click.option("--threads", type=click.IntRange(min=1), help="Threads to use.  [default: all]")
@click.option("--only", type=int, help="Replay one body alone, everything recorded at each step.")
def run(study: Path, out: Path | None, resume: bool, threads: int | None, only: int | None) -> None:
    """Run a Monte Carlo STUDY, a TOML file, into a folder of Parquet parts.

    A run that was stopped, however, goes on with --resume; its results are the same, bit for bit.
    """
    require("study")
    from lierb.running import run as run_study

    folder = out or Path("results") / study.stem
    if only is not None:
        _replay(study, folder, only, threads)
        return
    try:
        with _body_steps() as progress:
            dataset = run_study(study, folder, resume=resume, threads=threads, progress=progress)
    except KeyboardInterrupt:
        click.echo(
            f"\nStopped. Finished parts are kept; go on with:  lierb run {study} --resume", err=True
        )
        raise click.exceptions.Exit(INTERRUPTED) from None
    _show(dataset)


@cli.command()
@click.argument("folder", type=click.Path(exists=True, file_okay=False, path_type=Path))
def show(folder: Path) -> None:
    """The summary of a study's results in FOLDER, finished or not."""
    require("study")
    from lierb.dataset import Dataset

    dataset = Dataset(folder)
    dataset.read()
    _show(dataset)


@cli.command()
@click.argument("folder", type=click.Path(exists=True, file_okay=False, path_type=Path))
def plot(folder: Path) -> None:
    """Figures of a study's results in FOLDER, as PNG and SVG in FOLDER/figures."""
    require("study")
    require("plot")
    from lierb.dataset import Dataset
    from lierb.study_plots import draw_all

    dataset = Dataset(folder)
    dataset.read()
    for path in draw_all(dataset, folder / "figures"):
        click.echo(str(path))


@cli.command()
@STUDY
def predict(study: Path) -> None:
    """Which constraints of a STUDY's joint each configuration space keeps exactly, and why.

    Of its first body: where the joint is on the body can make a difference.
    """
    require("study")
    import lierb
    from lierb.study import Study

    batch = Study.load(study).batch(0, 1)
    found = lierb.predict(batch.problem.of_body(0), None if batch.pose0 is None else batch.pose0[0])
    click.echo(str(found))
    for prediction in found.values():
        click.echo(_wrapped(f"{prediction.cspace}: {prediction.reason}"))


def _replay(study: Path, folder: Path, body: int, threads: int | None) -> None:
    """One body's history in files of its own, and its row of the summary."""
    import pyarrow.parquet as pq

    from lierb.running import replay

    folder.mkdir(parents=True, exist_ok=True)
    for number, (setting, tables) in enumerate(replay(study, body, threads=threads)):
        path = folder / f"body-{body}-{number:02d}.parquet"
        pq.write_table(tables["errors"], path)
        (row,) = tables["summary"].to_pylist()
        click.echo(f"{setting.label}: {row['status']}, history in {path}")
        for name, value in row.items():
            if isinstance(value, float):
                click.echo(f"  {name:28}{value!r}")


def _print_whole(table: Table) -> None:
    """In a window that is too narrow the lines wrap, but no number is cut."""
    from rich.console import Console

    console = Console(highlight=False)
    console.width = max(console.width, Console(width=1000).measure(table).maximum)
    console.print(table)


def _show(dataset: Dataset) -> None:
    from lierb.findings import findings, table_of

    _print_whole(table_of(findings(dataset)))
    done, asked = len(dataset.parts), dataset.manifest["asked"]
    state = "" if done == asked else "; the rest with: lierb run STUDY --resume"
    click.echo(f"{dataset.folder}: {done} of {asked} parts{state}")


@contextmanager
def _body_steps() -> Iterator[Callable[[int, int], None] | None]:
    """A bar of body-steps on standard error, with their rate and the time left."""
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        Progress,
        TaskProgressColumn,
        TextColumn,
        TimeRemainingColumn,
    )

    console = Console(stderr=True)
    if not console.is_terminal:
        yield None
        return
    columns = (
        BarColumn(), TaskProgressColumn(), TextColumn("{task.fields[rate]}"), TimeRemainingColumn(),
    )  # fmt: skip
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("", total=None, rate="")

        def show(done: int, total: int) -> None:
            bar.update(task, completed=done, total=total)
            speed = bar.tasks[0].speed
            if speed:
                bar.update(task, rate=f"{speed / 1e6:.1f} M body-steps/s")

        yield show


@contextmanager
def _progress() -> Iterator[Callable[[int, int, str], None]]:
    """A bar on standard error; where that is no terminal, a line for each joint or figure."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

    console = Console(stderr=True)
    if not console.is_terminal:
        yield _progress_lines()
        return
    columns = (BarColumn(), MofNCompleteColumn(), TextColumn("{task.description}"))
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("", total=None)

        def show(done: int, total: int, what: str) -> None:
            bar.update(task, completed=done, total=total, description=what)

        yield show


def _progress_lines() -> Callable[[int, int, str], None]:
    shown = ""

    def show(done: int, total: int, what: str) -> None:
        nonlocal shown
        topic = what.split(":")[0]
        if topic and topic != shown:
            click.echo(f"[{done}/{total}] {topic}", err=True)
        shown = topic

    return show


def _findings_table(report: PaperReport) -> Table:
    """A block of rows for each joint and c-space: the step sizes, and the judgement beside them.

    It is 79 columns wide, so that it fits where output is piped as well.
    """
    from rich import box
    from rich.table import Table

    from lierb.paper import AS_STATED

    table = Table(box=box.SIMPLE_HEAD, show_edge=False, pad_edge=False, padding=0)
    for column in (
        "joint",
        "c-space",
        "dt/s",
        "max\nposition\nerror/m",
        "max\nrotation\nerror",
        "",
        "observed\norder",
        "verdict",
        "paper's\nclaim",
        "agrees",
    ):
        table.add_column(column, no_wrap=True)
    for example, of_example in groupby(report.findings, key=lambda finding: finding.example):
        names = example.title.split(", ")
        if example.reading != AS_STATED:
            names.append(f"({example.reading})")
        for cspace, of_cspace in groupby(of_example, key=lambda finding: finding.cspace):
            findings = list(of_cspace)
            block = zip_longest(
                names, [cspace], _error_cells(findings), _judgement_cells(findings), fillvalue=""
            )
            for name, space, errors, judgement in block:
                table.add_row(name, space, *(errors or [""] * 3), *judgement)
            names = []
        table.add_section()
    return table


def _error_cells(findings: list[Finding]) -> list[list[str]]:
    """For each step size: the step size, the position error, the rotation error."""
    by_quantity = {finding.quantity: finding.errors for finding in findings}
    dts = findings[0].dts
    absent = [None] * len(dts)
    columns = [by_quantity.get(quantity, absent) for quantity in ("position", "rotation")]
    return [
        [f"{dt:.0e}".replace("e-0", "e-"), *map(_number, errors)]
        for dt, *errors in zip(dts, *columns)
    ]


def _number(error: float | None) -> str:
    if error is None:
        return "-"
    return f"{error:.1e}" if error else "0"


def _judgement_cells(findings: list[Finding]) -> list[list[str]]:
    """For each error: its name, the observed order, the verdict, the claim, whether they agree."""
    agreement = {True: "[green]yes[/]", False: "[bold red]NO[/]", None: "-"}
    return [
        [
            finding.quantity[:3],
            "-" if finding.order is None else str(finding.order),
            finding.verdict,
            finding.claim or "-",
            agreement[finding.agrees],
        ]
        for finding in findings
    ]


def _closing_lines(report: PaperReport, out: Path) -> Iterator[str]:
    """How to read the table, what was read differently, what agrees, and where the files are."""
    yield ""
    yield "pos, rot: the position and the rotation error, largest of all steps."
    yield "exact: at rounding for every dt.  >=: the finer error is at rounding, a lower bound."
    yield ""
    noted = dict.fromkeys(f.example for f in report.findings if f.example.note)
    for example in noted:
        yield _wrapped(f"{example.title} ({example.reading}): {example.note}.")
    for warning in report.warnings:
        yield _wrapped(f"warning: {warning}")
    yield ""
    claims = [finding.agrees for finding in report.findings if finding.agrees is not None]
    yield f"{sum(claims)} of {len(claims)} claims of the paper agree."
    yield f"Written to {out}:"
    for stem, files in groupby(report.files, key=lambda path: path.stem):
        yield f"  {stem}{', '.join(path.suffix for path in files)}"


def _wrapped(text: str) -> str:
    return textwrap.fill(text, width=80, subsequent_indent="  ")
