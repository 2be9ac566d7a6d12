"""Group all commands, and define those that are not about studies.

Each command imports what it runs inside its function, so that `lierb --help` stays quick.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import groupby, zip_longest
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

from lierb.cli import studies as study_cli
from lierb.cli.comparing import compare
from lierb.cli.terminal import INTERRUPTED, print_whole, progress_of_cases, wrapped
from lierb.errors import LierbError, MissingExtraError
from lierb.support.extras import require
from lierb.support.representations import counted, rounded

if TYPE_CHECKING:
    from rich.table import Table
    from rich.text import Text

    from lierb.analysis.paper import Finding, PaperReport


NO_CACHE = "none: the JIT is off, or no folder can be written"  # in place of the cache's folder


class Commands(click.Group):
    """Commands of the group report an error in one sentence instead of a traceback."""

    def invoke(self, ctx: click.Context) -> Any:
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:
            click.echo("\nInterrupted. No file is left half-written.", err=True)
            ctx.exit(INTERRUPTED)
        except BrokenPipeError:
            raise  # `lierb … | head`: click exits quietly
        except (MissingExtraError, LierbError, OSError) as error:
            raise click.ClickException(str(error)) from error


@click.group(cls=Commands, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="lierb")
def cli() -> None:
    """Constrained rigid bodies on Lie groups, many at once."""


for command in (*study_cli.COMMANDS, compare):
    cli.add_command(command)


def finite(_ctx: click.Context, _param: click.Parameter, value: float) -> float:
    """Check that an option's number is finite."""
    if not math.isfinite(value):
        raise click.BadParameter(f"{value} is not a finite number")
    return value


@cli.command()
@click.option(
    "--out", type=click.Path(file_okay=False, path_type=Path), default=Path("results/paper"),
    show_default=True, help="Folder for the tables and figures.",
)  # fmt: skip
@click.option(
    "--gravity", type=float, default=0.0, show_default=True, callback=finite,
    help="In m/s², along -e3 of the ground; the paper mentions none.",
)  # fmt: skip
@click.option(
    "--update", type=click.Choice(["local", "global", "ambient"]), default="local",
    show_default=True, help="How a step updates the configuration.",
)  # fmt: skip
@click.option("--as-printed", is_flag=True, help="Keep the mistakes that the paper prints.")
@click.option("--no-figures", is_flag=True, help="Write the tables only.")
def paper(out: Path, gravity: float, update: str, as_printed: bool, no_figures: bool) -> None:
    """Reproduce section 5 of the paper that lierb grew out of.

    Every joint in both c-spaces, RK4 with three step sizes over 10 s: how well does each keep its
    constraints, and does that agree with the paper's claims? (A. Müller, BIT 56, 2016)
    """
    from lierb.analysis.paper import T_END, run_paper

    with progress_of_cases() as progress:
        report = run_paper(
            out,
            gravity=gravity,
            update=update,
            as_printed=as_printed,
            figures=not no_figures,
            progress=progress,
        )
    click.echo(f"Section 5 of the paper over {T_END:g} s: {report.setting}\n")
    print_whole(_findings_table(report))
    for line in _closing_lines(report, out):
        click.echo(line)


@cli.command()
@click.option("--json", "as_json", is_flag=True, help="As JSON, for a report or a script.")
def info(as_json: bool) -> None:
    """Print what lierb runs with: versions, CPU, lanes, threads, compiled kernels."""
    import json

    from lierb.installation import info as found_by

    facts = found_by()
    if as_json:
        click.echo(json.dumps(facts, indent=2))
        return
    cache = facts.pop("cache")
    rows = {
        "versions": ", ".join(
            f"{name} {facts[name]}"
            for name in ("lierb", "python", "numba", "llvmlite", "numpy", "pyarrow")
        ),
        "platform": facts["platform"],
        "CPU": f"{facts['cpu']} ({', '.join(facts['vectors'])}{', fma' * facts['fma']})",
        "lanes": f"{facts['lanes']} bodies in a vector register",
        "threads": f"{facts['threads']} ({facts['threading_layer']})",
        "cache": cache["folder"] or NO_CACHE,
        "compiled": f"{cache['kernels']} kernels of this version, {cache['bytes'] / 1e6:.1f} MB "
        f"of at most {cache['most_bytes'] / 1e6:.0f}",
    }
    for name, text in rows.items():
        click.echo(f"{name:10}{text}")


@cli.command()
@click.option("--clear", is_flag=True, help="Delete them all, whatever version they are of.")
def cache(clear: bool) -> None:
    """Print folder, number and size of the compiled kernels on the disk."""
    from lierb.installation import clear_cache, info

    if clear:
        try:
            deleted = clear_cache()
        except OSError as error:
            raise click.ClickException(
                f"{error.filename} cannot be deleted: {error.strerror}"
            ) from error
        megabytes = sum(deleted.values()) / 1e6
        click.echo(f"Deleted {counted(len(deleted), 'file')}, {megabytes:.1f} MB.")
        return
    facts = info()["cache"]
    size = f"{facts['kernels']} kernels of this version, {facts['bytes'] / 1e6:.1f} MB"
    click.echo(f"{size}; folder: {facts['folder'] or NO_CACHE}")


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
@click.option("--solver", default="auto", show_default=True, help="auto, saddle or subgroup.")
@click.option("--multipliers", is_flag=True, help="The kernels of runs that record them.")
@study_cli.SET
@click.pass_context
def warmup(
    ctx: click.Context,
    joint: tuple[str, ...],
    method: tuple[str, ...],
    cspace: tuple[str, ...],
    update: tuple[str, ...],
    solver: str,
    multipliers: bool,
    changes: study_cli.Changes,
) -> None:
    """Compile kernels ahead of time, for later processes to load from the disk.

    JOINT is a name such as spherical (the default), or tree for looped mechanisms, or several.
    Every option but --solver may be given more than once: each combination is compiled. Or it is
    the TOML file of a study, of which --set is the only option.
    """
    from lierb.installation import info as found_by
    from lierb.installation import warmup as made_ready

    if any(name.endswith(".toml") for name in joint):
        if len(joint) > 1:
            raise click.UsageError(f"one study or joints, got {', '.join(joint)}")
        for name in ("method", "cspace", "update", "solver", "multipliers"):
            if ctx.get_parameter_source(name) is not ParameterSource.DEFAULT:
                raise click.UsageError(f"--{name} is for joints; --set changes the study's")
        require("study")
        from lierb.studies.execution.replaying import compile_for

        for setting, seconds in compile_for(joint[0], changes):
            click.echo(f"{setting.label:40}{seconds:6.2f} s")
        return
    if changes:
        raise click.UsageError("--set changes a study; name its TOML file")
    with progress_of_cases() as progress:
        kernels = made_ready(
            joint or ("spherical",), methods=method, cspaces=cspace, updates=update,
            solver=solver, multipliers=multipliers, progress=progress,
        )  # fmt: skip
    for kernel in kernels:
        name = f"{kernel.joint}, {kernel.method}, {kernel.cspace}, {kernel.update}"
        click.echo(f"{name:40}{kernel.seconds:6.2f} s")
    folder = found_by()["cache"]["folder"]
    click.echo(f"ready: {counted(len(kernels), 'kernel')}; folder: {folder or NO_CACHE}")


def _findings_table(report: PaperReport) -> Table:
    """Return a table with a block of rows for each joint and c-space.

    It is 79 columns wide, so that it fits where output is piped as well.
    """
    from rich import box
    from rich.table import Table

    from lierb.analysis.paper_examples import AS_STATED

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
    """Return the cells of each step size: the step, the position error, the rotation error."""
    by_quantity = {finding.quantity: finding.errors for finding in findings}
    dts = findings[0].dts
    absent = [math.nan] * len(dts)
    columns = [by_quantity.get(quantity, absent) for quantity in ("position", "rotation")]
    return [
        [f"{dt:.0e}".replace("e-0", "e-"), *map(rounded, errors)]
        for dt, *errors in zip(dts, *columns)
    ]


def _judgement_cells(findings: list[Finding]) -> list[list[str | Text]]:
    """Return the cells of each error: name, observed order, verdict, claim, agreement."""
    from rich.text import Text

    agreement: dict[bool | None, str | Text] = {
        True: Text("yes", "green"),
        False: Text("NO", "bold red"),
        None: "–",
    }
    return [
        [
            finding.quantity[:3],
            "–" if finding.order is None else str(finding.order),
            finding.verdict,
            finding.claim or "–",
            agreement[finding.agrees],
        ]
        for finding in findings
    ]


def _closing_lines(report: PaperReport, out: Path) -> Iterator[str]:
    """Yield notes on the table, departures from the paper, agreement, and files."""
    yield ""
    yield "pos, rot: the position and the rotation error, largest of all steps."
    yield "exact: at rounding for every dt.  >=: the finer error is at rounding, a lower bound."
    yield ""
    noted = dict.fromkeys(f.example for f in report.findings if f.example.note)
    for example in noted:
        yield wrapped(f"{example.title} ({example.reading}): {example.note}.")
    for warning in report.warnings:
        yield wrapped(f"warning: {warning}")
    yield ""
    claims = [finding.agrees for finding in report.findings if finding.agrees is not None]
    yield f"{sum(claims)} of {len(claims)} claims of the paper agree."
    yield f"Written to {out}:"
    for stem, files in groupby(report.files, key=lambda path: path.stem):
        yield f"  {stem}{', '.join(path.suffix for path in files)}"
