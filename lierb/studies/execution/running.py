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
from typing import TYPE_CHECKING, Any, overload

import numpy as np
import pyarrow as pa

from lierb.api import integrate
from lierb.errors import ArgumentError, StiffStepWarning, StudyError, StudyWarning
from lierb.model.mechanism.mechanism import Mechanism
from lierb.model.problem import Problem
from lierb.results.failures import Failures, warn_of
from lierb.runs.options import check_options
from lierb.runs.provenance import machine
from lierb.runs.stiffness import stiff_steps
from lierb.sampling import Design
from lierb.studies.dataset import Dataset
from lierb.studies.description.changes import written
from lierb.studies.description.code import is_loading
from lierb.studies.description.from_python import study_of
from lierb.studies.description.sources import as_file, path_given
from lierb.studies.description.stopping import Bodies
from lierb.studies.description.study import Setting, Study, tables_of
from lierb.studies.description.study_file import plain_changes
from lierb.studies.execution.cluster import spread
from lierb.studies.storage.parts import Part, Parts, parts_of
from lierb.studies.storage.store import STUDY, Stored, parquet_files, part_named
from lierb.support.collected_warnings import is_told_elsewhere, told_elsewhere
from lierb.support.progress import BODY_STEPS, Progress, check_progress, reporter

if TYPE_CHECKING:
    from distributed import Client

LOOKED_AT = 4096  # bodies of a study, for which steps may be too long
REPLAYED = 1000  # parts of the time of a trajectory with adaptive steps, that is replayed
REPLAY = (
    "lierb.studies.execution.running.replay, or `lierb run STUDY --only NUMBER`, shows all that "
    "one of them did"
)


@overload
def run(
    study: Study | str | Path,
    out: str | Path,
    /,
    *,
    changes: Mapping[str, Any] | None = None,
    resume: bool = False,
    threads: int | None = None,
    progress: Progress = None,
    client: Client | None = None,
    gather: bool = False,
) -> Dataset: ...
@overload
def run(
    study: Study | str | Path,
    *,
    out: str | Path,
    changes: Mapping[str, Any] | None = None,
    resume: bool = False,
    threads: int | None = None,
    progress: Progress = None,
    client: Client | None = None,
    gather: bool = False,
) -> Dataset: ...
@overload
def run(
    study: Problem | Mechanism,
    design: Design,
    out: str | Path,
    *,
    changes: Mapping[str, Any] | None = None,
    resume: bool = False,
    threads: int | None = None,
    progress: Progress = None,
    client: Client | None = None,
    gather: bool = False,
    **settings: Any,
) -> Dataset: ...
def run(
    study: Study | Problem | Mechanism | str | Path,
    design: Any = None,
    out: Any = None,
    *,
    changes: Mapping[str, Any] | None = None,
    resume: bool = False,
    threads: int | None = None,
    progress: Progress = None,
    client: Client | None = None,
    gather: bool = False,
    **settings: Any,
) -> Dataset:
    """Run a study into a folder, part by part; memory does not grow with the study.

    It is called as `run(study, out, …)` or `run(problem, design, out, …)`. After Ctrl-C the parts
    under way are finished first; a second Ctrl-C loses them.

    Parameters
    ----------
    study : Study, path, Problem or Mechanism
        A study, or the path of its TOML file; or a problem whose numbers a design draws. The files
        with the problem's own functions are copied into the folder.
    design : Design, optional
        Design of a problem, see `lierb.study_of`. Of a study, `out` stands here.
    out : path
        Folder of the results, the second argument where there is no design; it is made if need be;
        `~` is the home folder.
    changes : dict, optional
        Changes of the study, by dotted keys: {"sample.n": 1000, "integrate.dt": [1e-3, 1e-4]}. The
        folder's study.toml has the study as it was run, its manifest also the changes.
    resume : bool, optional
        Continue an earlier run of the same study: finished parts are kept, missing or damaged ones
        are run. The results are the same, bit for bit.
    threads : int, optional
        Number of threads, as in `lierb.integrate`; with `client`, of each worker (None: its own
        number).
    progress : bool or callable, optional
        As in `lierb.integrate`.
    client : dask.distributed.Client, optional
        Cluster whose workers run the parts, one task a part, and write them into `out`, which they
        must see under the same path. The files are the same, bit for bit.
    gather : bool, optional
        Let the workers send their parts back, and this process write them.
    **settings : object
        Settings of a problem: dt or rtol, t_end and others of `lierb.study_of`.

    Returns
    -------
    Dataset
        The results.

    Raises
    ------
    StudyError
        The study is wrong; or the folder has results already (without `resume`), those of another
        study, other Parquet in its tables' folders, or another run that writes to it; or the
        cluster has no workers, is lost, or has workers that die again and again at a part.
    StudyFileError
        A file cannot be written. It is a StudyError and an OSError.

    Warns
    -----
    FailedTrajectoryWarning
        Some trajectories have failed.
    StiffStepWarning
        Fixed steps are too long for a force of `lierb.forces`, as in `lierb.integrate`.

    Examples
    --------
    >>> import tempfile
    >>> import lierb
    >>> box = lierb.bodies.box((0.1, 0.2, 0.3), mass=1.0)
    >>> ball = lierb.joints.spherical(body_point=(0.0, 0.0, 0.15))
    >>> spins = lierb.sampling.Direction(length=2.0)
    >>> design = lierb.sampling.Design({"initial.omega": spins}, n=100)
    >>> with tempfile.TemporaryDirectory() as out:
    ...     dataset = lierb.run(lierb.Problem(box, ball), design, out, dt=1e-2, t_end=0.1)
    ...     table = dataset.table("summary").to_table()
    >>> table.num_rows, table.schema.field("sample.initial.omega").metadata[b"unit"]
    (100, b'rad/s')
    """
    check_progress(progress)
    changes = plain_changes(changes or {})
    if gather and client is None:
        raise ArgumentError("gather=True is for the workers of a cluster; give client=")
    if client is not None and client.asynchronous:
        raise ArgumentError("client= is asynchronous; run takes a Client that waits")
    study, out = _given(study, design, out, settings)
    given, text = _loaded(study, changes or {})
    _warn_of_stiff_steps(given, stacklevel=3)
    dataset = Dataset(out)
    with dataset.locked():
        parts = _opened(dataset, given, text, changes or {}, resume)
        in_turn = InTurn(given, parts, dataset)
        in_turn.enter({})
        done, left = parts.work(dataset.parts), in_turn.left()
        of = "trajectories" if given.has_lane_clocks else BODY_STEPS
        with reporter(progress, parts.work(), of) as report, _interruptible() as stopping:

            def tell(within: int) -> None:
                report(done + within)

            if client is None:
                finished = _here(given, left, dataset, threads, stopping, tell)
            else:
                finished = spread(client, given, left, dataset, threads, gather, stopping)
            with closing(finished):
                for name, files in finished:
                    done += parts.work(in_turn.enter({name: files}))
                    tell(0)
        if not in_turn.is_complete:
            raise KeyboardInterrupt
        in_turn.end()
        dataset.drop_unfinished()
        _left_by_a_kill(dataset)  # nothing is, now
    warn_of(dataset.failures(), REPLAY, stacklevel=3)
    return dataset


def _given(
    study: Any, design: Any, out: Any, settings: Mapping[str, Any]
) -> tuple[Study | str | Path, Any]:
    """The study and the folder, of either way to call `run`."""
    if file := is_loading():
        raise StudyError(
            f"{file} runs a study when it is loaded for its functions; put that under "
            'if __name__ == "__main__":'
        )
    if isinstance(study, (Problem, Mechanism)):
        if design is None or out is None:
            raise ArgumentError(
                "a problem is run as lierb.run(problem, design, out, dt=…, t_end=…)"
            )
        return study_of(study, design, **settings), out
    if design is not None and out is not None:
        raise ArgumentError("a study is run as lierb.run(study, out)")
    for key in settings:
        raise ArgumentError(f"{key} is a setting of the study; give it in changes=")
    return study, design if out is None else out


class InTurn:
    """Which parts of a study are run, and entered.

    With a rule when to stop (`lierb.studies.description.stopping`), parts are entered in their
    order: nothing is left of parts that workers did beyond the last one of a setting.
    """

    def __init__(self, study: Study, parts: Parts, dataset: Dataset) -> None:
        self.parts, self.dataset, self.rule = parts, dataset, study.stopping_rule
        self.held: dict[str, list[Stored]] = {}
        self.last: dict[Setting, str] = {}  # parts, of settings that need no more
        self.waiting = iter(parts)
        self.next = next(self.waiting, None)
        self.bodies = Bodies(self.rule) if self.rule else None

    @property
    def is_complete(self) -> bool:
        if self.rule is None:
            return len(self.dataset.parts) == self.parts.total
        return self.next is None

    def left(self) -> Iterator[Part]:
        """What is to be done, as far as is known when the next one is asked for."""
        for part in self.parts:
            is_there = part.name in self.dataset.parts or part.name in self.held
            if not is_there and part.setting not in self.last:
                yield part

    def enter(self, done: dict[str, list[Stored]]) -> list[str]:
        """Enter parts that are done, and those that waited for them; which they are."""
        if self.rule is None:
            for name, files in done.items():
                self.dataset.enter(name, files)
            return list(done)
        self.held |= done
        entered = []
        while self.next is not None:
            part = self.next
            if part.name not in self.dataset.parts:
                if part.name not in self.held:
                    break
                self.dataset.enter(part.name, self.held.pop(part.name))
                entered.append(part.name)
            self._count(part)
        self._drop()
        return entered

    def _count(self, part: Part) -> None:
        """Ask the rule about all bodies up to a part, and go on to the next one."""
        assert self.rule is not None
        assert self.bodies is not None
        self.bodies.add(self.dataset.part_of("summary", part.name, self.bodies.columns))
        is_enough = self.rule.holds(self.bodies)
        self.next = next(self.waiting, None)
        while is_enough and self.next is not None and self.next.setting == part.setting:
            self.next = next(self.waiting, None)
        if self.next is None or self.next.setting != part.setting:
            self.last[part.setting] = part.name
            self.bodies = Bodies(self.rule)

    def _drop(self) -> None:
        """Delete what was done and is not wanted."""
        for name in list(self.held):
            part = self.parts.named(name)
            if part is not None and part.setting in self.last:
                self.dataset.drop([file.aside for file in self.held.pop(name)])

    def end(self) -> None:
        """Note which parts were the last ones, where some were left out."""
        if len(self.dataset.parts) < self.parts.total:
            self.dataset.end_with(list(self.last.values()))


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
    """Stream a study's results, without files.

    Parameters
    ----------
    study : Study or path
        A study, or the path of its TOML file.
    table : {"summary", "history", "events"}, optional
        Table to stream: "history" if the study has `save_every` or `save_at`, "events" if its
        problem has events.
    threads : int, optional
        Number of threads, as in `lierb.integrate`.

    Returns
    -------
    pyarrow.RecordBatchReader
        Reader; each batch is integrated when it is read.

    Warns
    -----
    FailedTrajectoryWarning
        Some trajectories have failed. The warning comes at the end.
    StiffStepWarning
        Fixed steps are too long for a force of `lierb.forces`, as in `lierb.integrate`.

    Examples
    --------
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
    _warn_of_stiff_steps(given, stacklevel=3)
    if table not in given.table_names:
        raise ArgumentError(
            f'table={table!r}; expected "summary", "history" with save_every or save_at, or '
            '"events" of a problem with events'
        )
    design, parts, rule = given.design, parts_of(given), given.stopping_rule
    seen: Failures | None = None

    def made() -> Iterator[pa.Table]:
        nonlocal seen
        bodies: dict[Setting, Bodies] = {}
        for part in parts:
            if rule is not None:
                known = bodies.setdefault(part.setting, Bodies(rule))
                if known.count and rule.holds(known):
                    continue
            tables = part.tables(given, design, threads)
            if failures := Failures.of(tables["summary"]):
                own = replace(failures, setting=part.setting.label)
                seen = Failures.joined([seen, own] if seen else [own], parts.trajectories)
            if rule is not None:
                known.add(tables["summary"])
            yield tables[table]

    tables = made()
    first = next(tables)

    def batches() -> Iterator[pa.RecordBatch]:
        yield from first.to_batches()
        for each in tables:
            yield from each.to_batches()
        warn_of(seen, REPLAY, stacklevel=3)

    return pa.RecordBatchReader.from_batches(first.schema, batches())


def _warn_of_stiff_steps(study: Study, **options: Any) -> None:
    """Issue one StiffStepWarning for all settings of a study.   options : of `warnings.warn`."""
    if not is_told_elsewhere() and (messages := stiff_settings(study)):
        warnings.warn("\n  ".join(messages), StiffStepWarning, **options)


def stiff_settings(study: Study) -> list[str]:
    """A message for each setting with too long steps for the first bodies of a study."""
    design = study.design
    count = min(len(design), LOOKED_AT)
    batch = study.batch(0, count, design)
    messages = []
    for setting in study.settings:
        _, timing, _ = check_options(batch.problem, **study.options(setting))
        messages.append(stiff_steps(batch.problem, batch.pose0, batch.twist0, count, timing))
    return [message for message in dict.fromkeys(messages) if message]


def compile_for(
    study: Study | str | Path, changes: Mapping[str, Any] | None = None
) -> list[tuple[Setting, float]]:
    """Compile what a study needs, setting by setting; the seconds that each took."""
    given, _ = _loaded(study, changes or {})
    batch = given.batch(0, 1)
    took = []
    for setting in given.settings:
        options = given.options(setting)
        if given.has_lane_clocks:
            options |= {"max_steps": 1}
        else:
            options |= {"t0": 0.0, "t_end": setting.dt}
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

    save_every : steps between rows of its history; with adaptive steps there are REPLAYED and one
        of them at equal distances, beside those of the study.

    Its row of the summary, and its events, are those of the study, bit for bit.
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
    run = study.integrate
    changes: dict[str, Any] = {"save_every": save_every, "save_at": None}
    if run.is_adaptive:
        times = np.linspace(run.t0, run.t_end, REPLAYED + 1)
        if run.times is not None:
            times = np.union1d(times, np.clip(run.times, run.t0, run.t_end))
        changes = {"save_every": None, "save_at": times.tolist()}
    changes["record"] = ["state", "energy", "multipliers", "reaction"]
    changed = run.model_copy(update=changes)
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
        dataset.begin(
            study.digest(), study.model_dump(), text, parts.total, changes,
            study.code, study.fingerprints() if study.files else {},
        )  # fmt: skip
        dataset.drop_unfinished()
    else:
        _resumed(dataset, study, text)
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


def _resumed(dataset: Dataset, study: Study, text: str) -> None:
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
    for file in dataset.restore_code(study.code):
        warnings.warn(
            f"{dataset.folder / file} was missing; it is written again", StudyWarning, stacklevel=4
        )
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
    told = [f"{k} = {there.get(k)} there, {here.get(k)} here" for k in keys[:5]]
    before = dataset.manifest.get("code", {})
    told += [
        f"{file} was edited since, or is another file"
        for file, digest in study.code_digests.items()
        if before.get(file, digest) != digest
    ]
    return ", ".join(told)


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
