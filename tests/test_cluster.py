"""Studies on Dask workers: the same bits as in one process, whatever happens to the workers."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace

import pytest
from cases import long_but
from click.testing import CliRunner
from studies import TEXT, bits, errors_when_stopped, hashes, start_long, study

import lierb
from lierb.cli import cli
from lierb.errors import ArgumentError, StudyError, StudyWarning
from lierb.studies.execution import cluster
from lierb.studies.storage.parts import Parts
from lierb.studies.storage.store import Store

pytest.importorskip("distributed")
import dask
import dask.distributed

BODIES = 6_000
SHORT = {
    "sample": {"n": BODIES},
    "integrate": {"dt": [1e-3], "t_end": 0.02, "save_every": 10},
    "output": {"part": 2048},
}


@pytest.fixture(scope="module")
def alone(tmp_path_factory):
    """The study in one process."""
    folder = tmp_path_factory.mktemp("alone") / "out"
    lierb.run(study(**SHORT), folder)
    return folder


@pytest.fixture(scope="module")
def client():
    with cluster.local_client(2) as client:
        yield client


@pytest.fixture(scope="module")
def threads():
    """Two workers that are threads of this process: they are there at once."""
    with (
        dask.distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, processes=False, dashboard_address=None
        ) as there,
        dask.distributed.Client(there) as client,
    ):
        yield client


# ---- the same bits -----------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    "workers", [1, pytest.param(3, marks=pytest.mark.long)]
)  # of two there are tests below
def test_bits_do_not_depend_on_workers_or_parts(workers, alone, tmp_path):
    with cluster.local_client(workers) as client:
        for part in (500, 2048, 5000):
            folder = tmp_path / str(part)
            given = study(**SHORT | {"output": {"part": part}})
            lierb.run(given, folder, client=client, gather=part == 500)
            for table in ("summary", "history"):
                assert bits(folder, table) == bits(alone, table)
        assert hashes(tmp_path / "2048") == hashes(alone)


@pytest.mark.slow
def test_sent_or_written_the_files_are_those_of_one_process(client, alone, tmp_path):
    told = []
    lierb.run(study(**SHORT), tmp_path / "sent", client=client, gather=True)
    lierb.run(
        study(**SHORT), tmp_path / "written", client=client,
        progress=lambda done, total: told.append((done, total)),
    )  # fmt: skip
    assert hashes(tmp_path / "sent") == hashes(tmp_path / "written") == hashes(alone)
    assert told[-1] == (2 * BODIES * 20, 2 * BODIES * 20)
    assert told == sorted(told)


def test_only_what_is_missing_is_done(threads, alone, tmp_path):
    lierb.run(study(**SHORT), tmp_path, client=threads)
    lost, *kept = sorted(tmp_path.rglob("part-*.parquet"))
    written = {path: path.stat().st_mtime_ns for path in kept}
    lost.unlink()
    lierb.run(study(**SHORT), tmp_path, client=threads, resume=True)
    again = {path for path in kept if path.stat().st_mtime_ns != written[path]}
    part = lost.name
    assert {path.name for path in again} == {part}  # its other table
    assert hashes(tmp_path) == hashes(alone)


@pytest.mark.slow
def test_a_worker_uses_its_own_threads(client):
    threads = max(1, (os.cpu_count() or 1) // 2)
    assert list(client.nthreads().values()) == [threads] * 2
    assert client.submit(cluster._own_threads).result() == threads


# ---- what may happen ---------------------------------------------------------------------------


@contextmanager
def killing(client, folder: Path, after: list[int]):
    """Kill a worker, at random, when so many parts are finished; yields the ids of the killed."""
    killed: list[int] = []
    done = threading.Event()

    def kill() -> None:
        rng = random.Random(2)
        for parts in after:
            while len(list(folder.glob("summary/*.parquet"))) < parts and not done.is_set():
                time.sleep(0.02)
            running = [pid for pid in client.run(os.getpid).values() if pid not in killed]
            killed.append(rng.choice(running))
            os.kill(killed[-1], signal.SIGKILL)

    thread = threading.Thread(target=kill)
    thread.start()
    try:
        yield killed
    finally:
        done.set()
        thread.join()


@pytest.mark.slow
def test_a_killed_worker_costs_its_parts_only(tmp_path):
    given = study(sample={"n": 8000}, integrate={"t_end": 0.4}, output={"part": 1024})
    lierb.run(given, tmp_path / "alone")
    out = tmp_path / "out"
    with cluster.local_client(2) as client, killing(client, out, [3]) as killed:
        lierb.run(given, out, client=client)
    assert len(killed) == 1
    assert hashes(out) == hashes(tmp_path / "alone")


@pytest.mark.long
def test_a_part_that_kills_its_workers_is_named(tmp_path, monkeypatch):
    monkeypatch.setattr(cluster, "_run_part", _dies)
    with (
        dask.config.set({"distributed.scheduler.allowed-failures": 0}),
        cluster.local_client(1) as client,
        pytest.raises(StudyError, match=r"workers died 1 times .* had part 00-0000000000"),
    ):
        lierb.run(study(), tmp_path, client=client)


def _dies(*_args: object) -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def test_a_worker_left_behind_by_another_run_overwrites_nothing(tmp_path):
    """Its run is over, and a corrected study is in the folder before it has finished its part."""
    lierb.run(study(), tmp_path)
    before = hashes(tmp_path)
    other = study(sample={"seed": 4})
    place = tmp_path, (tmp_path / "study.toml").read_bytes()
    cluster._run_part(other, next(iter(Parts(other))), place, 1)
    now = hashes(tmp_path)
    assert {name: now[name] for name in before} == before
    assert all(name.endswith(".unfinished") for name in now.keys() - before.keys())


def test_workers_without_lierb_are_told(threads, tmp_path, monkeypatch):
    def missing():
        raise ImportError("No module named 'lierb'")

    monkeypatch.setattr(cluster, "machine", missing)
    with pytest.raises(StudyError, match=r"cannot load lierb.*No module named 'lierb'"):
        lierb.run(study(), tmp_path, client=threads)


@pytest.mark.long
def test_a_lost_cluster_leaves_what_is_finished(alone, tmp_path):
    with cluster.local_client(1) as client:

        def stop(done: int, total: int) -> None:
            client.cluster.close()

        with pytest.raises(StudyError, match=r"cluster.*--resume"):
            lierb.run(study(**SHORT), tmp_path, client=client, progress=stop)
    done = Store(tmp_path)
    done.read()
    assert done.parts
    assert done.drop_damaged() == []
    lierb.run(study(**SHORT), tmp_path, resume=True)
    assert hashes(tmp_path) == hashes(alone)


@pytest.mark.long
def test_workers_that_are_gone_are_not_waited_for_for_ever(tmp_path, monkeypatch):
    monkeypatch.setattr(cluster, "LOST_SECONDS", 1.0)
    with cluster.local_client(1) as client:

        def dismiss(done: int, total: int) -> None:
            client.cluster.scale(0)

        with pytest.raises(StudyError, match=r"all workers of the cluster are gone; .*--resume"):
            lierb.run(study(**SHORT), tmp_path, client=client, progress=dismiss)


@pytest.mark.slow
def test_a_result_whose_worker_left_with_it_is_not_waited_for_for_ever(monkeypatch):
    monkeypatch.setattr(cluster, "LOST_SECONDS", 1.0)
    part = next(iter(Parts(study(**SHORT))))
    with cluster.local_client(1) as client:
        future = client.submit(int, 1)
        dask.distributed.wait([future])
        client.cluster.scale(0)
        while client.nthreads():
            time.sleep(0.05)
        with pytest.raises(StudyError, match="all workers of the cluster are gone"):
            cluster._result(client, future, part)


def test_workers_that_do_not_see_the_folder_say_so(threads, tmp_path):
    def hide(done: int, total: int) -> None:
        (tmp_path / "study.toml").unlink(missing_ok=True)

    with pytest.raises(StudyError, match=r"does not see .*--gather"):
        lierb.run(
            study(**SHORT | {"output": {"part": 250}}), tmp_path, client=threads, progress=hide
        )


def test_another_kind_of_worker_warns(threads, tmp_path, monkeypatch):
    there = cluster.machine()

    def machine():
        is_here = threading.current_thread() is threading.main_thread()
        return there | {"cpu": "abacus"} if is_here else there

    monkeypatch.setattr(cluster, "machine", machine)
    with pytest.warns(StudyWarning, match="a worker differs .*cpu .* there, abacus here"):
        lierb.run(study(**SHORT), tmp_path, client=threads)


def test_a_scheduler_without_workers_is_named(tmp_path, monkeypatch):
    from distributed import Client, LocalCluster

    monkeypatch.setattr(cluster, "CONNECT_SECONDS", 0.5)
    with (
        LocalCluster(n_workers=0, dashboard_address="127.0.0.1:0") as empty,
        Client(empty) as client,
        pytest.raises(StudyError, match=r"scheduler at tcp://.* has no workers"),
    ):
        lierb.run(study(), tmp_path, client=client)


STARTED = """
import sys
from pathlib import Path
from distributed import LocalCluster

if __name__ == "__main__":
    with LocalCluster(
        n_workers=1, processes=False, protocol="tcp", dashboard_address="127.0.0.1:0"
    ) as cluster:
        Path(sys.argv[1]).with_suffix(".new").write_text(cluster.scheduler_address)
        Path(sys.argv[1]).with_suffix(".new").rename(sys.argv[1])
        sys.stdin.read()
"""
JOINING = """
import os, signal, sys
import lierb
from lierb.studies.execution import cluster
from studies import study

cluster.CONNECT_SECONDS = cluster.LOST_SECONDS = 3
with cluster.client_of(sys.argv[1]) as client:

    def hit(done, total):
        if done:
            os.kill(int(sys.argv[3]), int(sys.argv[4]))

    given = study(sample={"n": 2000}, output={"part": 500})
    lierb.run(given, sys.argv[2], client=client, progress=hit)
"""


@pytest.mark.long
@pytest.mark.parametrize("sign", long_but([signal.SIGKILL, signal.SIGSTOP], signal.SIGSTOP))
def test_a_scheduler_that_dies_or_falls_silent_is_told_in_one_sentence(sign, tmp_path):
    """No other output: distributed's logs and its unawaited tasks are suppressed."""
    (tmp_path / "started.py").write_text(STARTED)
    scheduler = subprocess.Popen(
        [sys.executable, str(tmp_path / "started.py"), str(tmp_path / "address")],
        stdin=subprocess.PIPE, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    try:
        while not (tmp_path / "address").exists():
            assert scheduler.poll() is None
            time.sleep(0.1)
        address = (tmp_path / "address").read_text()
        arguments = [address, str(tmp_path / "out"), str(scheduler.pid), str(int(sign))]
        run = subprocess.run(
            [sys.executable, "-c", JOINING, *arguments], timeout=300, check=False,
            capture_output=True, text=True, cwd=Path(__file__).parent,
        )  # fmt: skip
    finally:
        scheduler.kill()
        scheduler.communicate()
    *_, last = run.stderr.strip().splitlines()
    assert last.startswith("lierb.errors.StudyError: the connection to the cluster was lost (")
    assert last.endswith("finished parts are kept, --resume (resume=True) does the rest")
    assert "distributed" not in run.stderr
    assert run.stderr.count("Traceback") == 1  # that of the error itself, in this script
    lierb.run(study(sample={"n": 2000}, output={"part": 500}), tmp_path / "out", resume=True)


def test_gather_wants_a_cluster(tmp_path):
    with pytest.raises(ArgumentError, match="client"):
        lierb.run(study(), tmp_path, gather=True)


def test_an_asynchronous_client_is_refused(tmp_path):
    with pytest.raises(ArgumentError, match="asynchronous"):
        lierb.run(study(), tmp_path / "out", client=SimpleNamespace(asynchronous=True))
    assert not (tmp_path / "out").exists()


# ---- the command -------------------------------------------------------------------------------


def invoke(*arguments):
    return CliRunner().invoke(cli, ["run", *map(str, arguments)])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--workers", 2, "--scheduler", "tcp://127.0.0.1:1"), "choose"),
        (("--gather",), "--gather is for a cluster"),
        (("--only", 3, "--workers", 2), "--only runs one trajectory here"),
        (("--only", 3, "--report"), "choose"),
        (("--scheduler", "tcp://127.0.0.1:1"), "no Dask scheduler answers at tcp://127.0.0.1:1"),
        (("--scheduler", "nonsense"), "no Dask scheduler answers at nonsense"),
        (("--scheduler", "tls://127.0.0.1:1"), "no Dask scheduler answers at tls://127.0.0.1:1"),
        (("--scheduler", "ucx://127.0.0.1:1"), "no Dask scheduler answers at ucx://127.0.0.1:1"),
        (("--scheduler", "tcp://a b:70000"), "no Dask scheduler answers at tcp://a b:70000"),
        (("--scheduler", ""), "no Dask scheduler answers at"),
    ],
)
def test_command_says_what_is_wrong(options, said, tmp_path, monkeypatch):
    monkeypatch.setattr(cluster, "CONNECT_SECONDS", 0.5)
    file = tmp_path / "study.toml"
    file.write_text(TEXT)
    started, start = [], dask.distributed.Client.start
    monkeypatch.setattr(
        dask.distributed.Client, "start", lambda c, **given: (started.append(c), start(c, **given))
    )
    result = invoke(file, "--out", tmp_path / "out", *options)
    assert result.exit_code in (1, 2)
    assert said in result.output
    assert not (tmp_path / "out").exists()
    # Amidst another one's start the collector would wait for ever to close it.
    assert all(client.status == "closed" for client in started)


@pytest.mark.slow
def test_command_joins_a_scheduler(client, tmp_path):
    file = tmp_path / "study.toml"
    file.write_text(TEXT)
    lierb.run(file, tmp_path / "alone")
    result = invoke(file, "--out", tmp_path / "out", "--scheduler", client.scheduler.address)
    assert result.exit_code == 0, result.output
    assert hashes(tmp_path / "out") == hashes(tmp_path / "alone")


@pytest.mark.long
def test_ctrl_c_in_a_terminal_reaches_no_worker(tmp_path, interruptible):
    process, out = start_long(tmp_path, "--workers", "2"), tmp_path / "out"
    os.killpg(process.pid, signal.SIGINT)  # a terminal sends it to all of them
    errors = errors_when_stopped(process, out)
    assert f"go on with:  lierb run {tmp_path / 'study.toml'} --out {out} --resume" in errors
