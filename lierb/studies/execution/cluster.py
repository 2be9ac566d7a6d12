"""Execution of a study's parts on a Dask cluster. Needs the extra `lierb[cluster]`."""

from __future__ import annotations

import logging
import signal
import threading
import time
import warnings
from collections.abc import Generator, Iterable, Iterator
from concurrent.futures import CancelledError
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numba

from lierb.errors import StudyError, StudyWarning
from lierb.runs.provenance import machine
from lierb.studies.description.study import Study
from lierb.studies.storage.files import File, Stored, parquet_files
from lierb.studies.storage.parts import Part
from lierb.studies.storage.results import STUDY
from lierb.studies.storage.store import Store
from lierb.support.extras import remedy, require

if TYPE_CHECKING:
    from distributed import Client, Future

AHEAD = 2  # parts given to each worker: they take turns in the kernel, with all its threads
CONNECT_SECONDS = 30
KEPT = "finished parts are kept, --resume (resume=True) does the rest"
GONE = f"all workers of the cluster are gone; {KEPT}"
LOST = f"the connection to the cluster was lost ({{}}); {KEPT}"
LOST_SECONDS = 60  # without any worker: they do not come back
TALKING = ("client", "core", "comm", "comm.core", "comm.tcp", "batched", "utils", "utils_comm")


def spread(
    client: Client,
    study: Study,
    parts: Iterable[Part],
    dataset: Store,
    threads: int | None,
    gather: bool,
    stopping: threading.Event,
) -> Generator[tuple[str, list[Stored]]]:
    """Run parts on a cluster until `stopping` is set; yield their names and files.

    A part whose worker dies is given to another one. Only so many parts are given out at a time
    that neither they nor, with `gather`, their files fill anybody's memory.
    """
    _be_quiet()
    _require_workers(client)
    place = None if gather else (dataset.folder.resolve(), (dataset.folder / STUDY).read_bytes())
    waiting = iter(parts)
    under_way: dict[Future, Part] = {}
    elsewhere: set[str] = set()

    def give() -> None:
        most = max(1, AHEAD * len(_workers(client)))
        while len(under_way) < most and not stopping.is_set():
            part = next(waiting, None)
            if part is None:
                return
            # pure=False: a key of its own, since a part of the same name may be another study's
            future = client.submit(_run_part, study, part, place, threads, pure=False)
            under_way[future] = part

    try:
        give()
        while under_way:
            for future in _finished(client, list(under_way)):
                part = under_way.pop(future)
                made, where = _result(client, future, part)
                if where != machine():
                    elsewhere.add(_differences(where))
                yield part.name, dataset.store(made) if gather else made
            give()
    except Exception as error:
        if not _is_lost(client, error):
            raise
        under_way.clear()  # nobody is there to be told
        raise StudyError(LOST.format(type(error).__name__)) from None
    finally:
        if under_way and client.status == "running":
            with suppress(OSError):  # it was not, as it turns out
                client.cancel(list(under_way))
        for differences in elsewhere:
            warnings.warn(
                f"a worker differs from this machine ({differences}); its parts may differ in the "
                "last bits",
                StudyWarning,
                stacklevel=2,
            )


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
    client = Client.__new__(Client)  # kept, to be closed where its start fails
    try:
        client.__init__(scheduler, timeout=CONNECT_SECONDS)
    except Exception as error:  # each kind of address has its own
        # Left to the collector, it may be closed amidst another one's start, and wait for its lock.
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

    For good, since a task may be heard of when the process ends.
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


class NoAnswer(Exception):
    """The connected scheduler does not answer."""


def _workers(client: Client) -> dict[str, int]:
    """Number of threads of each worker, by its address."""
    try:
        found: dict[str, int] = client.sync(
            client.scheduler.ncores, callback_timeout=CONNECT_SECONDS
        )
    except TimeoutError:
        raise NoAnswer from None
    return found


# ---- in a worker -------------------------------------------------------------------------------


def dask_setup(_worker: Any) -> None:
    """Ignore a terminal's Ctrl-C in a worker of `local_client`; the main process handles it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _run_part(
    study: Study, part: Part, place: tuple[Path, bytes] | None, threads: int | None
) -> tuple[list[File] | list[Stored], dict[str, Any]]:
    """Integrate a part in a worker; return its files, stored if there is a `place`, and machine."""
    if place is not None:
        _require_same_folder(*place)
    tables = part.tables(study, study.design, threads or _own_threads())
    files = parquet_files(part.name, tables, study.output.compression)
    return files if place is None else Store(place[0]).store(files), machine()


def _own_threads() -> int:
    """Number of threads of this worker. Its tasks run one at a time, each with all threads."""
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


def _require_workers(client: Client) -> None:
    try:
        client.wait_for_workers(1, timeout=CONNECT_SECONDS)
    except TimeoutError:
        address = client.scheduler_info().get("address", "its address")
        raise StudyError(f"the Dask scheduler at {address} has no workers; start some") from None
    except Exception as error:
        if not _is_lost(client, error):
            raise
        raise StudyError(LOST.format(type(error).__name__)) from None
    try:
        client.run_on_scheduler(machine)
        client.run(machine)
    except Exception as error:  # what cannot be imported there comes back in many guises
        if _is_lost(client, error):
            raise StudyError(LOST.format(type(error).__name__)) from None
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
            if future.status == "error":  # the task's own
                raise
            if not _workers(client):  # the last worker left with it
                raise StudyError(GONE) from None
            patience *= 2  # another worker does it again, or it is a long way from there
        except KilledWorker as error:
            raise StudyError(
                f"workers died {error.allowed_failures + 1} times in a row that had part "
                f"{part.name}, perhaps beside others; if it was for memory, fewer bodies in a "
                "part take less: [output] part"
            ) from None


def _differences(where: dict[str, Any]) -> str:
    here = machine()
    return ", ".join(f"{k} {where[k]} there, {here[k]} here" for k in here if where[k] != here[k])
