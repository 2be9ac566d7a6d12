"""Execute a study's parts on a Dask cluster, which needs the extra `lierb[cluster]`."""

from __future__ import annotations

import logging
import signal
import threading
import time
import warnings
from collections.abc import Generator, Iterable, Iterator
from concurrent.futures import CancelledError
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numba

from lierb.errors import StudyError, StudyWarning
from lierb.runs.provenance import machine
from lierb.studies.description.sources import STUDY
from lierb.studies.description.study import Study
from lierb.studies.storage.files import File, Stored, parquet_files
from lierb.studies.storage.parts import Part
from lierb.studies.storage.store import Store
from lierb.support.extras import remedy, require

if TYPE_CHECKING:
    from distributed import Client, Future

Place = tuple[Path, bytes] | None  # a shared folder and its study.toml; None to send files back
AHEAD = 2  # tasks of each worker: they run in turn, each with all its threads
CONNECT_SECONDS = 30
KEPT = "finished parts are kept, --resume (resume=True) does the rest"
GONE = f"all workers of the cluster are gone; {KEPT}"
LOST_SECONDS = 60  # s without any worker until the run ends
TALKING = ("client", "core", "comm", "comm.core", "comm.tcp", "batched", "utils", "utils_comm")


def spread(
    client: Client,
    study: Study,
    parts: Iterable[Part],
    store: Store,
    threads: int | None,
    gather: bool,
    stopping: threading.Event,
) -> Generator[tuple[str, list[Stored]]]:
    """Run parts on a cluster until `stopping` is set; yield their names and files.

    A part whose worker dies is submitted again. With `gather` the files are sent to this process.
    """
    place = None if gather else (store.folder.resolve(), (store.folder / STUDY).read_bytes())
    tasks = _Tasks(client, study, iter(parts), place, threads)
    differing: set[str] = set()
    try:
        tasks.submit(stopping)
        while tasks.submitted:
            for future in _finished(client, list(tasks.submitted)):
                part = tasks.submitted.pop(future)
                files, where = _result(client, future, part)
                if where != machine():
                    differing.add(_differences(where))
                yield part.name, store.store(files) if gather else files
            tasks.submit(stopping)
    except Exception as error:
        if not _is_lost(client, error):
            raise
        tasks.submitted.clear()
        raise _lost(error) from None
    finally:
        tasks.cancel()
        for differences in differing:
            warnings.warn(
                f"a worker differs from this machine ({differences}); its parts may differ in the "
                "last bits",
                StudyWarning,
                stacklevel=2,
            )


@dataclass
class _Tasks:
    """Parts of a study as tasks of a cluster, at most AHEAD for each worker.

    This bounds the memory of the scheduler and, where files are gathered, of this process.
    """

    client: Client
    study: Study
    waiting: Iterator[Part]
    place: Place
    threads: int | None
    submitted: dict[Future, Part] = field(default_factory=dict)

    def submit(self, stopping: threading.Event) -> None:
        most = max(1, AHEAD * len(_workers(self.client)))
        while len(self.submitted) < most and not stopping.is_set():
            part = next(self.waiting, None)
            if part is None:
                return
            # pure=False: a new key, since another study may have a part of the same name
            future = self.client.submit(
                _run_part, self.study, part, self.place, self.threads, pure=False
            )
            self.submitted[future] = part

    def cancel(self) -> None:
        if self.submitted and self.client.status == "running":
            with suppress(OSError):  # the connection is lost after all
                self.client.cancel(list(self.submitted))


@contextmanager
def local_client(workers: int) -> Iterator[Client]:
    """Start worker processes on this machine, which share its cores; yield the client."""
    require("cluster")
    from distributed import Client, LocalCluster

    threads = max(1, numba.config.NUMBA_NUM_THREADS // workers)
    with (
        LocalCluster(
            n_workers=workers,
            threads_per_worker=threads,
            processes=True,
            dashboard_address="127.0.0.1:0",
            preload=__name__,
        ) as cluster,
        Client(cluster) as client,
    ):
        yield client


@contextmanager
def client_of(scheduler: str) -> Iterator[Client]:
    """Yield a client of the scheduler at an address such as tcp://10.0.0.1:8786."""
    require("cluster")
    from distributed import Client

    _be_quiet()
    client = Client.__new__(Client)  # kept, to close it if its start fails
    try:
        client.__init__(scheduler, timeout=CONNECT_SECONDS)
    except Exception as error:  # its type depends on the kind of address
        # The garbage collector might close it during another client's start, and wait for its lock.
        with suppress(Exception):
            client.close()
        raise StudyError(
            f"no Dask scheduler answers at {scheduler}: {error}; expected an address such as "
            "tcp://10.0.0.1:8786, as the scheduler prints it when it starts"
        ) from None
    with client:
        yield client


def _be_quiet() -> None:
    """Silence distributed's logs about connections, which lierb reports itself.

    This is permanent: a task may be reported when the process ends.
    """
    for name in TALKING:
        logging.getLogger(f"distributed.{name}").setLevel(logging.CRITICAL)
    logging.getLogger("asyncio").addFilter(_is_no_connection)


def _is_no_connection(record: logging.LogRecord) -> bool:
    kind = record.exc_info and record.exc_info[0]
    return not (kind and kind.__module__.startswith("distributed"))


def _is_lost(client: Client, error: Exception) -> bool:
    """Return whether an error means that the connection to the scheduler is lost."""
    from distributed.comm import CommClosedError

    signs = CancelledError, CommClosedError, NoAnswer
    return client.status != "running" or isinstance(error, signs)


def _lost(error: Exception) -> StudyError:
    return StudyError(f"the connection to the cluster was lost ({type(error).__name__}); {KEPT}")


class NoAnswer(Exception):
    """The connected scheduler does not answer."""


def _workers(client: Client) -> dict[str, int]:
    """Return the number of threads of each worker, by its address."""
    try:
        threads: dict[str, int] = client.sync(
            client.scheduler.ncores, callback_timeout=CONNECT_SECONDS
        )
    except TimeoutError:
        raise NoAnswer from None
    return threads


# ---- in a worker -------------------------------------------------------------------------------


def dask_setup(_worker: Any) -> None:
    """Ignore a terminal's Ctrl-C in a worker of `local_client`; the main process handles it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _run_part(
    study: Study, part: Part, place: Place, threads: int | None
) -> tuple[list[File] | list[Stored], dict[str, Any]]:
    """Integrate a part in a worker; return its files, stored if there is a `place`, and machine."""
    if place is not None:
        _require_same_folder(*place)
    tables = part.tables(study, study.design, threads or _own_threads())
    files = parquet_files(part.name, tables, study.output.compression)
    return files if place is None else Store(place[0]).store(files), machine()


def _own_threads() -> int:
    """Return this worker's number of threads; each of its tasks, one at a time, has all."""
    from distributed import get_worker

    return int(min(get_worker().state.nthreads, numba.config.NUMBA_NUM_THREADS))


def _require_same_folder(folder: Path, study: bytes) -> None:
    try:
        seen = (folder / STUDY).read_bytes()
    except OSError:
        seen = b""
    if seen != study:
        raise StudyError(f"a worker does not see {folder}; let it send its parts: --gather")


# ---- at home -----------------------------------------------------------------------------------


def require_workers(client: Client) -> None:
    """Raise StudyError for a cluster without workers, or whose workers cannot load lierb."""
    _be_quiet()
    try:
        client.wait_for_workers(1, timeout=CONNECT_SECONDS)
    except TimeoutError:
        address = client.scheduler_info().get("address", "its address")
        raise StudyError(f"the Dask scheduler at {address} has no workers; start some") from None
    try:
        client.run_on_scheduler(machine)
        client.run(machine)
    except Exception as error:  # a failed import there raises many types
        if _is_lost(client, error):
            raise _lost(error) from None
        raise StudyError(
            "the scheduler or a worker cannot load lierb, which it needs as this process does "
            f"(installed here by {remedy('cluster')}): {error}"
        ) from None


def _finished(client: Client, futures: list[Future]) -> list[Future]:
    """Wait for futures; return those that are done."""
    from distributed import wait

    seen = time.monotonic()
    while True:
        with suppress(TimeoutError, CancelledError):
            wait(futures, timeout=1, return_when="FIRST_COMPLETED")
        if done := [future for future in futures if future.done()]:
            return done
        if _workers(client):
            seen = time.monotonic()
        elif time.monotonic() - seen > LOST_SECONDS:
            raise StudyError(GONE)


def _result(client: Client, future: Future, part: Part) -> Any:
    """Fetch the result of a finished task from its worker."""
    from distributed import KilledWorker

    patience = LOST_SECONDS
    while True:
        try:
            return future.result(timeout=patience)
        except TimeoutError:
            if future.status == "error":  # raised by the task
                raise
            if not _workers(client):  # the last worker left with it
                raise StudyError(GONE) from None
            patience *= 2  # another worker repeats it, or the connection is slow
        except KilledWorker as error:
            raise StudyError(
                f"workers died {error.allowed_failures + 1} times in a row that had part "
                f"{part.name}, perhaps among others; if memory was short, choose fewer bodies in a "
                "part: [output] part"
            ) from None


def _differences(where: dict[str, Any]) -> str:
    here = machine()
    return ", ".join(f"{k} {where[k]} there, {here[k]} here" for k in here if where[k] != here[k])
