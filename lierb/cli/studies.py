"""These commands run studies and show their results."""

from __future__ import annotations

import os
import shlex
from contextlib import AbstractContextManager, nullcontext, suppress
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from lierb.cli.terminal import INTERRUPTED, print_whole, wrapped
from lierb.errors import StudyError
from lierb.studies.description.changes import parsed, written
from lierb.studies.description.shipped import example as text_of
from lierb.studies.description.shipped import examples
from lierb.studies.description.sources import MANIFEST, STUDY, as_file, folder_by, is_copied
from lierb.support.collected_warnings import warnings_collected
from lierb.support.extras import require
from lierb.support.files import ROOM, folder_of, naming, parquet, write_whole

if TYPE_CHECKING:
    from distributed import Client

    from lierb.studies.dataset import Dataset
    from lierb.studies.description.study import Study

Changes = dict[str, Any]
MOST_EVENTS = 20  # most printed events of a trajectory


class UserPath(click.Path):
    """The path's `~` is expanded, as in `--out=~/top`, where a shell does not."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        # as text: a Path turns a URL into `s3:/x`, and an empty path into the current folder
        return super().convert(os.path.expanduser(value), param, ctx)  # noqa: PTH111


FOLDER = click.argument("folder", type=UserPath(exists=True, file_okay=False, path_type=Path))


def _readable(ctx: click.Context, _param: click.Parameter, given: Path) -> Path:
    """Return the path STUDY as a file that can be read repeatedly until the command ends."""
    return ctx.with_resource(as_file(given))


STUDY_FILE = click.argument(
    "study", callback=_readable,
    type=UserPath(exists=True, dir_okay=False, allow_dash=True, path_type=Path),
)  # fmt: skip


def _changes(_ctx: click.Context, _param: click.Parameter, given: tuple[str, ...]) -> Changes:
    """Parse the option --set: changes by dotted keys."""
    try:
        pairs = [parsed(each) for each in given]
    except StudyError as error:
        raise click.BadParameter(str(error)) from None
    return _merged(*({key: value} for key, value in pairs))


def _merged(*given: Changes) -> Changes:
    changes: Changes = {}
    for each in given:
        for key in changes.keys() & each.keys():
            raise click.UsageError(f"{key} is set twice; choose")
        changes |= each
    return changes


SET = click.option(
    "--set", "changes", multiple=True, metavar="KEY=VALUE", callback=_changes,
    help="Change a setting of the STUDY, as integrate.dt=1e-4; may be given more than once.",
)  # fmt: skip


def _probabilities(_ctx: click.Context, _param: click.Parameter, given: str) -> tuple[float, ...]:
    """Parse the option --quantiles: percentages, as probabilities."""
    try:
        percents = sorted({float(each) for each in given.split(",")})
    except ValueError:
        percents = [0.0]
    if not all(0.0 < each < 100.0 for each in percents):
        raise click.BadParameter(
            f"{given}; expected percentages above 0 and below 100, as 50,95,99.73"
        )
    if percents[-1] <= 1.0:  # shares of the bodies
        shares, larger = (
            f"--quantiles={','.join(f'{scale * each:.12g}' for each in percents)}"
            for scale in (1.0, 100.0)
        )
        raise click.BadParameter(
            f"{shares}; expected percentages, as {larger} for these shares; if {given} % are "
            f"meant, give a larger one beside them: {shares},50"
        )
    return tuple(each / 100.0 for each in percents)


QUANTILES = click.option(
    "--quantiles", "probabilities", metavar="PERCENT,…", default="5,50,95", show_default=True,
    callback=_probabilities, help="Quantiles of the tables, in percent, as 50,95,99.73.",
)  # fmt: skip
RANK_BY = click.option(
    "--rank-by", metavar="COLUMN",
    help="Column of the summary whose largest numbers are the report's worst; -COLUMN: whose "
    "smallest.  [default: that of a stopping rule, or the first observable's maximum, or errors]",
)  # fmt: skip


@click.command()
@STUDY_FILE
@SET
@click.option("--n", type=int, help="Number of bodies: as --set sample.n=N.")
@click.option("--seed", type=int, help="Seed of the sampling: as --set sample.seed=SEED.")
@click.option(
    "--stop-when", metavar="RULE",
    help='Stop by a rule, as "width of 95% of COLUMN < 2%": as --set sample.stop_when=RULE.',
)  # fmt: skip
@click.option(
    "--out", type=UserPath(file_okay=False),
    help="Folder for the results.  [default: results/NAME]",
)  # fmt: skip
@click.option("--resume", is_flag=True, help="Continue an earlier run.")
@click.option(
    "--overwrite", is_flag=True, help="Delete the results of an earlier run in DIR first."
)
@click.option(
    "--threads", type=click.IntRange(min=1),
    help="Threads to use, in each worker of a cluster.  [default: all that it has]",
)  # fmt: skip
@click.option(
    "--workers", type=click.IntRange(min=1), metavar="N",
    help="Spread the parts over N processes of this machine.",
)  # fmt: skip
@click.option(
    "--scheduler", metavar="ADDRESS",
    help="Spread them over the workers of a Dask cluster, such as tcp://10.0.0.1:8786.",
)  # fmt: skip
@click.option(
    "--gather", is_flag=True, help="Workers send their parts here; they do not see the folder."
)
@click.option("--report", is_flag=True, help="Write DIR/report.html at the end.")
@RANK_BY
@QUANTILES
@click.option(
    "--only", type=int, metavar="TRAJECTORY",
    help="Replay the trajectory of this number alone, with everything recorded at each step.",
)  # fmt: skip
def run(
    study: Path,
    changes: Changes,
    n: int | None,
    seed: int | None,
    stop_when: str | None,
    out: str | None,
    resume: bool,
    overwrite: bool,
    threads: int | None,
    workers: int | None,
    scheduler: str | None,
    gather: bool,
    report: bool,
    rank_by: str | None,
    probabilities: tuple[float, ...],
    only: int | None,
) -> None:
    """Run a Monte Carlo STUDY, a TOML file (- for standard input), into a folder of Parquet parts.

    --resume continues a run that was stopped in any way; its results are the same, bit for bit.
    """
    require("study")
    if report:
        require("report")  # before the run, not after it
    from lierb.studies.description.study import Study
    from lierb.studies.execution.foreseen import foreseen
    from lierb.studies.execution.running import run as run_study

    folder = folder_of(Path("results") / folder_by(study) if out is None else out)
    _require_one_way(workers, scheduler, gather, report, only)
    if rank_by is not None and not report:
        raise click.UsageError("--rank-by is for --report")
    own = {"sample.n": n, "sample.seed": seed, "sample.stop_when": stop_when}
    changes = _merged(changes, {key: value for key, value in own.items() if value is not None})
    loaded = Study.load(study, changes)  # reports errors before any worker starts
    if only is not None:
        _replay(loaded, folder, only, threads)
        return
    if rank_by is not None:
        from lierb.studies.findings.ranking import ranking_named

        ranking_named(loaded, rank_by)  # raises before the run, not after it
    for message in chain.from_iterable(foreseen(loaded).values()):
        click.secho(wrapped(message), fg="yellow", err=True)
    try:
        with _client(workers, scheduler) as client, warnings_collected():
            dataset = run_study(
                study, folder, changes=changes, resume=resume, overwrite=overwrite,
                threads=threads, client=client, gather=gather,
            )  # fmt: skip
    except KeyboardInterrupt:
        again = _to_go_on(study, changes, out, folder)
        click.echo(f"\nStopped. Finished parts are kept; go on with:  {again}", err=True)
        raise click.exceptions.Exit(INTERRUPTED) from None
    _show(dataset, probabilities)
    if report:
        _report(dataset, folder / "report.html", rank_by, probabilities)
    _end_with_failures(dataset)


def _to_go_on(study: Path, changes: Changes, out: str | None, folder: Path) -> str:
    """Return the command that resumes a run; a study from a pipe is resumed from its folder."""
    if is_copied(study.parent):
        return _again(folder, "--resume")
    options = [word for each in written(changes) for word in ("--set", each)]
    options += ["--out", str(folder)] if out is not None else []
    return shlex.join(["lierb", "run", str(study), *options, "--resume"])


def _require_one_way(
    workers: int | None, scheduler: str | None, gather: bool, report: bool, only: int | None
) -> None:
    spread = workers is not None or scheduler is not None
    if workers is not None and scheduler is not None:
        raise click.UsageError("--workers starts a cluster, --scheduler joins one; choose")
    if gather and not spread:
        raise click.UsageError("--gather is for a cluster: --scheduler or --workers")
    if only is not None and spread:
        raise click.UsageError("--only runs one trajectory here: without --scheduler and --workers")
    if only is not None and report:
        raise click.UsageError("--report is on a study, --only on one trajectory; choose")


def _client(workers: int | None, scheduler: str | None) -> AbstractContextManager[Client | None]:
    """Return the context in which the cluster of the options runs: its client, or None."""
    if workers is None and scheduler is None:
        return nullcontext()
    require("cluster")
    from lierb.studies.execution.cluster import client_of, local_client

    click.echo(f"Joining {scheduler} ..." if scheduler else "Starting the workers ...", err=True)
    return local_client(workers) if workers else client_of(str(scheduler))


def _results_in(folder: Path) -> Dataset:
    require("study")
    from lierb.studies.dataset import Dataset

    return Dataset(folder)


@click.command()
@FOLDER
@QUANTILES
def show(folder: Path, probabilities: tuple[float, ...]) -> None:
    """Print the summary of a study's results in FOLDER, finished or not."""
    dataset = _results_in(folder)
    _show(dataset, probabilities)
    _end_with_failures(dataset)


@click.command()
@FOLDER
def plot(folder: Path) -> None:
    """Draw figures of a study's results in FOLDER, as PNG and SVG in FOLDER/figures."""
    dataset, figures = _results_in(folder), folder / "figures"
    require("plot")
    from lierb.studies.pages.figures import draw_all, omitted

    with naming(figures, "written", ROOM):
        drawn = draw_all(dataset, figures)
    for path in drawn:
        click.echo(str(path))
    for name, why in omitted(dataset).items():
        click.echo(f"{name}: left out, since {why}", err=True)


@click.command("report")
@FOLDER
@click.option(
    "--out", type=UserPath(dir_okay=False, path_type=Path),
    help="The file to write.  [default: FOLDER/report.html]",
)  # fmt: skip
@RANK_BY
@QUANTILES
def report_page(
    folder: Path, out: Path | None, rank_by: str | None, probabilities: tuple[float, ...]
) -> None:
    """Write a study's results in FOLDER as one HTML page, which opens without a network."""
    dataset = _results_in(folder)
    _report(dataset, out or folder / "report.html", rank_by, probabilities)


@click.command()
@STUDY_FILE
@SET
def predict(study: Path, changes: Changes) -> None:
    """Print which constraints of a STUDY's joints each configuration space keeps, and why.

    The first body is used: the place of the joint on the body can make a difference.
    """
    require("study")
    from lierb.analysis.prediction import joint_by_joint
    from lierb.analysis.prediction import predict as predict_joints
    from lierb.studies.description.study import Study

    loaded = Study.load(study, changes)
    first = loaded.batch(0, 1).first
    prediction = predict_joints(first.problem, first.pose0, update=loaded.integrate.update)
    click.echo(str(prediction))
    for joint, each in joint_by_joint(prediction):
        click.echo(wrapped(f"{', '.join(filter(None, (joint, each.cspace)))}: {each.reason}"))


def _replay(study: Study, folder: Path, trajectory: int, threads: int | None) -> None:
    """Integrate a trajectory; write its histories, and print its summaries and events."""
    from lierb.results.failures import Failures
    from lierb.studies.execution.replaying import replay
    from lierb.studies.storage.manifest import read_manifest

    digest = study.digest()
    with suppress(StudyError):  # a replay needs no results, nor whole ones
        digest = read_manifest(folder / MANIFEST)["digest"]
    if digest != study.digest():
        other = (
            f"{folder} has results of another study, or with other changes: the trajectory is none "
            f"of them; {_again(folder, '--only', str(trajectory))} replays theirs"
        )
        click.secho(wrapped(other), fg="yellow", err=True)
    click.echo(
        f"Integrating trajectory {trajectory}; the first time, its code is compiled ...",
        err=True,
    )
    for number, (setting, tables) in enumerate(replay(study, trajectory, threads=threads)):
        path = folder / f"trajectory-{trajectory}-{number:02d}.parquet"
        write_whole(path, parquet(tables["history"]))
        (row,) = tables["summary"].to_pylist()
        click.echo(f"{setting.label}: {row['status']}, history in {path}")
        if failed := Failures.of(tables["summary"]):
            click.echo(f"  {failed}")
        for name, value in row.items():
            if isinstance(value, float):
                click.echo(f"  {name:27} {value!r}")
        events = tables["events"].to_pylist() if "events" in tables else []
        for event in events[:MOST_EVENTS]:
            click.echo(f"  {event['event']} at t = {event['t']!r} s")
        if len(events) > MOST_EVENTS:
            click.echo(f"  and {len(events) - MOST_EVENTS} events more")


def _report(
    dataset: Dataset, path: Path, rank_by: str | None, probabilities: tuple[float, ...]
) -> None:
    require("report")
    from lierb.studies.pages.report import write_report

    click.echo("Writing the report ...", err=True)
    page = write_report(dataset, path, rank_by=rank_by, probabilities=probabilities)
    click.echo(str(page))


def _show(dataset: Dataset, probabilities: tuple[float, ...]) -> None:
    from lierb.studies.description.quantiles import BASIS
    from lierb.studies.findings import findings, linear_theory, occurrences, statistics, tables

    shown = [
        tables.table_of(findings.findings(dataset)),
        tables.table_of_quantities(statistics.quantities(dataset, probabilities)),
    ]
    if events := occurrences.crossings(dataset, probabilities):
        shown.append(tables.table_of_events(events, dataset.study.integrate.t_end))
    if indices := statistics.indices(dataset):
        shown.append(tables.table_of_indices(indices))
    if theory := linear_theory.linear_theories(dataset, probabilities):
        shown.append(tables.table_of_linear_theory(theory))
    for n, table in enumerate(shown):
        if n:
            click.echo()
        print_whole(table)
    if basis := BASIS.get(dataset.study.sample.method):
        click.echo(wrapped(basis))
    for line in linear_theory.remarks(theory):
        click.secho(wrapped(line), fg="yellow")
    if moved := dataset.manifest.get("moved"):
        click.secho(wrapped(f"{moved}."), fg="yellow")
    done, total = len(dataset.parts), dataset.manifest["asked"]
    state = dataset.rest(f"the rest with: {_again(dataset.folder, '--resume')}")
    click.echo(f"{dataset.folder}: {done} of {total} parts{state}")


def _end_with_failures(dataset: Dataset) -> None:
    """Print the failures and their remedies last, where they are read."""
    failures = dataset.failures()
    if failures is None:
        return
    click.secho(str(failures), fg="red", bold=True)
    for remedy in failures.remedies:
        click.echo(wrapped(remedy))
    replay = _again(dataset.folder, "--only", str(failures.trajectory))
    click.echo(f"Replay trajectory {failures.trajectory}, with everything recorded:\n  {replay}")


def _again(folder: Path, *options: str) -> str:
    """Return the command that runs the study of a folder into it."""
    return shlex.join(["lierb", "run", str(folder / STUDY), "--out", str(folder), *options])


@click.command()
@click.argument("name", required=False)
def example(name: str | None) -> None:
    """Print the example study NAME, to be run or changed; without a name, list them.

    \b
    lierb example heavy_top > heavy_top.toml
    lierb run heavy_top.toml --n 1000
    """
    if name is None:
        for each, line in examples().items():
            click.echo(f"{each:14}{line}")
        return
    click.echo(text_of(name).encode(), nl=False)  # bytes: TOML is UTF-8, whatever a terminal has


COMMANDS = (run, show, plot, report_page, predict, example)
