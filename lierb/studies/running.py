"""Running a study: part by part into a folder, or as a stream of record batches."""

from __future__ import annotations

import signal
import threading
import time
import warnings
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pyarrow as pa

from lierb.api import integrate
from lierb.errors import ArgumentError, StudyError, StudyWarning
from lierb.runs.failures import Failures, told_elsewhere, warn_of
from lierb.runs.progress import Progress, check_progress, reporter
from lierb.runs.provenance import machine
from lierb.studies.changes import written
from lierb.studies.cluster import spread
from lierb.studies.dataset import STUDY, Dataset, Stored, parquet_files, part_named
from lierb.studies.parts import Part, Parts, parts_of
from lierb.studies.sources import as_file, path_given
from lierb.studies.study import Setting, Study, tables_of
from lierb.studies.study_file import plain_changes

if TYPE_CHECKING:
    from distributed import Client

REPLAY = (
    "lierb.studies.running.replay, or `lierb run STUDY --only NUMBER`, shows all that one of them "
    "did"
)


def run(
    study: Study | str | Path,
    out: str | Path,
    *,
    changes: Mapping[str, Any] | None = None,
    resume: bool = False,
    threads: int | None = None,
    progress: Progress = None,
    client: Client | None = None,
    gather: bool = False,
) -> Dataset:
    """Run a study into a folder, part by part; memory does not grow with the study.

    study : a Study, or the path of its TOML file.   out : a folder; made if need be; `~` is home.
    changes : of the study, by dotted keys: {"sample.n": 1000, "integrate.dt": [1e-3, 1e-4]}. The
        folder's study.toml has the study as it was run, its manifest also what was changed.
    resume : go on where an earlier run of the same study stopped: finished parts are kept, those
        that are missing or damaged are done (again). The results are the same, bit for bit.
    threads : as in `lierb.integrate`; with `client`, of each worker, its own number if None.
    progress : as in `lierb.integrate`.
    client : a dask.distributed.Client; its workers run the parts, one task a part, and write them
        into `out`, which they must see under the same path. The files are the same, bit for bit.
    gather : the workers send their parts back, and this process writes them.

    Raises StudyError for a study that is wrong, for a folder that has results already (without
    `resume`), those of another study, or other Parquet in its tables' folders, for another run
    that writes to it, and as StudyFileError, an OSError too, for what cannot be written; with
    `client`, for a cluster without workers, one that is lost, or a part whose workers die again
    and again. After Ctrl-C the parts under way are finished first; a second Ctrl-C loses them. One
    FailedTrajectoryWarning says how many trajectories failed, if any did.
    """
    check_progress(progress)
    changes = plain_changes(changes or {})
    if gather and client is None:
        raise ArgumentError("gather=True is for the workers of a cluster; give client=")
    if client is not None and client.asynchronous:
        raise ArgumentError("client= is asynchronous; run takes a Client that waits")
    given, text = _loaded(study, changes or {})
    dataset = Dataset(out)
    with dataset.locked():
        parts = _opened(dataset, given, text, changes or {}, resume)
        done = parts.body_steps(dataset.parts)
        left = (part for part in parts if part.name not in dataset.parts)
        with reporter(progress, parts.body_steps()) as report, _interruptible() as stopping:

            def tell(within: int) -> None:
                report(done + within)

            if client is None:
                finished = _here(given, left, dataset, threads, stopping, tell)
            else:
                finished = spread(client, given, left, dataset, threads, gather, stopping)
            with closing(finished):
                for name, files in finished:
                    dataset.enter(name, files)
                    done += parts.body_steps([name])
                    tell(0)
        if len(dataset.parts) < parts.total:
            raise KeyboardInterrupt
        dataset.drop_unfinished()
        _left_by_a_kill(dataset)  # nothing is, now
    warn_of(dataset.failures(), REPLAY, stacklevel=3)
    return dataset


def _here(
    study: Study,
    parts: Iterable[Part],
    dataset: Dataset,
    threads: int | None,
    stopping: threading.Event,
    tell: Callable[[int], None],
) -> Generator[tuple[str, list[Stored]]]:
    """Run parts in this process, until it is stopping."""
    design = study.design
    for part in parts:
        if stopping.is_set():
            return
        tables = part.tables(study, design, threads, lambda within, _: tell(within))
        yield part.name, dataset.store(parquet_files(part.name, tables, study.output.compression))


def integrate_batches(
    study: Study | str | Path, table: str = "summary", *, threads: int | None = None
) -> pa.RecordBatchReader:
    """A study's results as a stream, for those who want no files.

    table : "summary", or "history" if the study has `save_every`.
    Returns a pyarrow.RecordBatchReader; each batch is integrated when it is asked for. At the end
    one FailedTrajectoryWarning says how many trajectories failed, if any did.

    >>> import lierb
    >>> study = lierb.Study.of({
    ...     "body": {"mass": 6.075, "inertia": [0.0126563, 0.0468281, 0.0569531]},
    ...     "joint": {"type": "spherical", "body_point": [-0.15, 0.0375, 0.0]},
    ...     "initial": {"omega": [6.28, 3.14, 0.63]},
    ...     "sample": {"n": 5},
    ...     "integrate": {"dt": 1e-3, "t_end": 0.1},
    ... })
    >>> sum(batch.num_rows for batch in lierb.integrate_batches(study))
    5
    """
    given, _ = _loaded(study, {})
    known = ("summary", "history") if given.integrate.save_every else ("summary",)
    if table not in known:
        raise ArgumentError(f'table={table!r}; expected "summary", or "history" with save_every')
    design, parts = given.design, parts_of(given)
    seen: Failures | None = None

    def made() -> Iterator[pa.Table]:
        nonlocal seen
        for part in parts:
            tables = part.tables(given, design, threads)
            if failures := Failures.of(tables["summary"]):
                own = replace(failures, setting=part.setting.label)
                seen = Failures.joined([seen, own] if seen else [own], parts.trajectories)
            yield tables[table]

    tables = made()
    first = next(tables)

    def batches() -> Iterator[pa.RecordBatch]:
        yield from first.to_batches()
        for each in tables:
            yield from each.to_batches()
        warn_of(seen, REPLAY, stacklevel=3)

    return pa.RecordBatchReader.from_batches(first.schema, batches())


def compile_for(
    study: Study | str | Path, changes: Mapping[str, Any] | None = None
) -> list[tuple[Setting, float]]:
    """Compile what a study needs, setting by setting; the seconds that each took."""
    given, _ = _loaded(study, changes or {})
    batch = given.batch(0, 1)
    took = []
    for setting in given.settings:
        options = given.options(setting) | {"t0": 0.0, "t_end": setting.dt}
        began = time.perf_counter()
        with told_elsewhere():  # of one step
            integrate(
                batch.problem, twist0=batch.twist0, pose0=batch.pose0, progress=False, **options
            )
        took.append((setting, time.perf_counter() - began))
    return took


def replay(
    study: Study | str | Path, trajectory: int, *, save_every: int = 1, threads: int | None = None
) -> list[tuple[Setting, dict[str, pa.Table]]]:
    """One trajectory of a study alone, with everything recorded, in each of the study's settings.

    Its row of the summary is that of the study, bit for bit.
    """
    given, _ = _loaded(study, {})
    last = len(given.design) - 1
    if not 0 <= trajectory <= last:
        raise StudyError(f"there is no trajectory {trajectory} in the study; it has 0 … {last}")
    fixed = replace_integrate(given, save_every)
    return [
        (setting, Part("", setting, trajectory, 1).tables(fixed, given.design, threads))
        for setting in fixed.settings
    ]


def replace_integrate(study: Study, save_every: int) -> Study:
    """The study with the whole history recorded."""
    record = ["state", "energy", "multipliers", "reaction"]
    changed = study.integrate.model_copy(update={"save_every": save_every, "record": record})
    return study.model_copy(update={"integrate": changed})


def _loaded(study: Study | str | Path, changes: Mapping[str, Any]) -> tuple[Study, str]:
    """The study, and the text of a file that says it: its own where nothing is changed."""
    if isinstance(study, Study):
        given = study.changed(changes)
        return given, given.to_toml()
    with as_file(path_given(study)) as path:
        given = Study.load(path, changes)
        if not changes:
            return given, path.read_text(encoding="utf-8")
    return given, f"# {path.name} with {', '.join(written(changes))}\n{given.to_toml()}"


def _opened(
    dataset: Dataset, study: Study, text: str, changes: Mapping[str, Any], resume: bool
) -> Parts:
    """The parts of the study, those that are entered in its folder being whole.

    Raises StudyError for a folder that is not the study's; see `lierb.studies.dataset`.
    """
    parts = parts_of(study)
    if dataset.exists():
        _read(dataset, study, parts.total, resume)
    is_same = dataset.manifest.get("digest") == study.digest()
    if dataset.parts and not is_same:
        begun = ", ".join(written(dataset.changes))
        raise StudyError(
            f"{dataset.folder} has the results of another study: {_differences(dataset, study)}"
            + (f"; it was run with {begun}" if begun else "")
        )
    if dataset.parts and not resume:
        raise StudyError(
            f"{dataset.folder} has results of this study already; --resume (resume=True) does what "
            "is missing, or choose another folder"
        )
    _left_by_a_kill(dataset, parts if is_same else None)
    if not dataset.parts:
        dataset.begin(study.digest(), study.model_dump(), text, parts.total, changes)
        dataset.drop_unfinished()
    else:
        _resumed(dataset, text)
    dataset.drop(_left_by_a_kill(dataset, parts))
    return parts


def _read(dataset: Dataset, study: Study, asked: int, resume: bool) -> None:
    """Read the manifest, or mend it where the study that it is of goes on."""
    try:
        dataset.read()
    except StudyError:
        if not (resume and dataset.mend(study, asked)):
            raise
        warnings.warn(
            f"the manifest of {dataset.folder} was edited or damaged; {len(dataset.parts)} of "
            f"{asked} parts are as they were entered, the others are done again",
            StudyWarning,
            stacklevel=5,
        )


def _resumed(dataset: Dataset, text: str) -> None:
    """Look at what is there; write what is missing of it but for parts."""
    if dataset.manifest["machine"] != machine():
        warnings.warn(
            f"{dataset.folder} was begun with other versions or on another machine; what is done "
            "now may differ from its parts in the last bits",
            StudyWarning,
            stacklevel=4,
        )
    if dataset.study_text() is None:
        warnings.warn(
            f"{dataset.folder / STUDY} was missing; it is written again", StudyWarning, stacklevel=4
        )
        dataset.write(STUDY, text.encode())
    dataset.drop_damaged()


def _left_by_a_kill(dataset: Dataset, own: Parts | None = None) -> list[str]:
    """Files of parts that a run was about to enter; whoever reads the folder sees their rows.

    own : the parts of the study that was run there; none if another one was.
    Raises StudyError where such a reader would see rows that are not the study's.
    """
    files = dataset.strays()
    for file in files:
        name = part_named(file)
        if own is None or name is None or own.named(name) is None:
            raise StudyError(
                f"{dataset.folder / file} would be read with this study's parts, but no manifest "
                "enters it among them; move it elsewhere, or choose another folder"
            )
    return files


def _differences(dataset: Dataset, study: Study) -> str:
    there, here = dict(tables_of(dataset.manifest["study"])), dict(tables_of(study.model_dump()))
    keys = [k for k in there | here if there.get(k) != here.get(k) and k != "name"]
    return ", ".join(f"{k} = {there.get(k)} there, {here.get(k)} here" for k in keys[:5])


@contextmanager
def _interruptible() -> Iterator[threading.Event]:
    """An event that the first Ctrl-C sets; the second one interrupts."""
    stopping = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield stopping
        return
    before = signal.getsignal(signal.SIGINT)

    def stop(number: int, frame: Any) -> None:
        stopping.set()
        signal.signal(signal.SIGINT, signal.default_int_handler)

    if before is signal.default_int_handler:
        signal.signal(signal.SIGINT, stop)
    try:
        yield stopping
    finally:
        signal.signal(signal.SIGINT, before)
