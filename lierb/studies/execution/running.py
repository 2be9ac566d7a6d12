"""Run a study part by part into a folder."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
from contextlib import closing, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

from lierb.errors import ArgumentError, StudyError
from lierb.model.mechanism.mechanism import Mechanism
from lierb.model.problem import Problem
from lierb.results.failures import warn_of
from lierb.runs.threads import threads_for
from lierb.sampling import Design
from lierb.studies.dataset import Dataset
from lierb.studies.description.code import is_loading
from lierb.studies.description.from_python import NAMELESS, study_of
from lierb.studies.description.study import Study
from lierb.studies.description.study_file import plain_changes
from lierb.studies.execution.cluster import require_workers, spread
from lierb.studies.execution.foreseen import warn_before
from lierb.studies.execution.opening import loaded, opened, unentered
from lierb.studies.execution.order import InTurn
from lierb.studies.execution.replaying import REPLAY
from lierb.studies.storage.files import Stored, parquet_files
from lierb.studies.storage.parts import Part
from lierb.studies.storage.store import Store
from lierb.support.files import folder_of
from lierb.support.progress import BODY_STEPS, Progress, check_progress, reporter

if TYPE_CHECKING:
    from distributed import Client


@overload
def run(
    study: Study | str | Path,
    out: str | Path,
    /,
    *,
    changes: Mapping[str, Any] | None = None,
    resume: bool = False,
    overwrite: bool = False,
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
    overwrite: bool = False,
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
    overwrite: bool = False,
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
    overwrite: bool = False,
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
    overwrite : bool, optional
        Delete the results of an earlier run in the folder, of whichever study, and begin anew.
        Files that are not a study's stay.
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
        Settings of a problem: dt or rtol, t_end and others of `lierb.study_of`; the study's `name`
        is by default that of the folder.

    Returns
    -------
    Dataset
        The results.

    Raises
    ------
    StudyError
        The study is wrong; or the folder has results already (without `resume` or `overwrite`),
        those of another study, other Parquet in its tables' folders, or another run that writes to
        it; or the cluster has no workers, is lost, or has workers that die again and again at a
        part.
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
    if resume and overwrite:
        raise ArgumentError("resume=True keeps what overwrite=True deletes; give one of them")
    study, out = _study_and_folder(study, design, out, settings)
    given, text = loaded(study, changes)
    warn_before(given, stacklevel=3)
    if client is None:
        threads_for(threads, 1)  # raises for wrong threads, before `overwrite` deletes anything
    else:
        require_workers(client)
    store = Store(out)
    with store.locked():
        parts = opened(store, given, text, changes, resume, overwrite)
        in_turn = InTurn(given, parts, store)
        in_turn.enter({})
        done, left = parts.work(store.parts), in_turn.left()
        unit = "trajectories" if given.has_lane_clocks else BODY_STEPS
        with reporter(progress, parts.work(), unit) as report, _interruptible() as stopping:

            def report_part(within: int) -> None:
                report(done + within)

            if client is None:
                finished = _here(given, left, store, threads, stopping, report_part)
            else:
                finished = spread(client, given, left, store, threads, gather, stopping)
            with closing(finished):
                for name, files in finished:
                    done += parts.work(in_turn.enter({name: files}))
                    report_part(0)
        if not in_turn.is_complete:
            raise KeyboardInterrupt
        in_turn.end()
        store.drop_unfinished()
        unentered(store)  # raises for Parquet files that were added meanwhile
    warn_of(store.failures(), REPLAY, stacklevel=3)
    return Dataset.of(store)


def _study_and_folder(
    study: Any, design: Any, out: Any, settings: Mapping[str, Any]
) -> tuple[Study | str | Path, Any]:
    """Read the arguments of either way to call `run`."""
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
        return study_of(study, design, **{"name": _name_by(out), **settings}), out
    if design is not None and out is not None:
        raise ArgumentError("a study is run as lierb.run(study, out)")
    for key in settings:
        raise ArgumentError(f"{key} is a setting of the study; give it in changes=")
    return study, design if out is None else out


def _name_by(out: Any) -> str:
    """Return the name of a study without one: that of its folder, if a study may be called so."""
    name = folder_of(out).resolve().name
    return name if name and name.isprintable() else NAMELESS


def _here(
    study: Study,
    parts: Iterable[Part],
    store: Store,
    threads: int | None,
    stopping: threading.Event,
    report: Callable[[int], None],
) -> Generator[tuple[str, list[Stored]]]:
    """Run parts in this process until `stopping` is set; yield their names and files."""
    design = study.design
    for part in parts:
        if stopping.is_set():
            return
        tables = part.tables(study, design, threads, _share_of(part.work(study), report))
        yield part.name, store.store(parquet_files(part.name, tables, study.output.compression))


def _share_of(work: int, report: Callable[[int], None]) -> Callable[[int, int], None]:
    """Return the progress function of a part; derivatives take several runs for the same work."""
    return lambda done, total: report(done * work // total)


@contextmanager
def _interruptible() -> Iterator[threading.Event]:
    """Yield an event that the first Ctrl-C sets; the second one interrupts."""
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
