"""Threads, forks, interrupts and progress: the bits of a run do not depend on them."""

import ctypes
import math
import multiprocessing
import os
import signal
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from pathlib import Path

import numba
import numpy as np
import pytest
from cases import tiered

import lierb
from lierb.errors import ForkError
from lierb.kernels.loops.sharing import take_share

pytestmark = pytest.mark.skipif(
    bool(numba.config.DISABLE_JIT), reason="there are no threads with the JIT off"
)

ROOT = Path(lierb.__file__).parents[1]
COUNT = 37  # bodies; several blocks and a padded one for any number of lanes
STEPS = 200
NUMBERS = ("t", "position_error_max", "energy_drift_max", "rotation", "position", "omega", "v")

TOP = lierb.Problem(
    lierb.Body(mass=6.075, inertia=(0.0126563, 0.0468281, 0.0569531)),
    lierb.joints.spherical(body_point=(-0.15, 0.0375, 0.0)),
    gravity=(0.0, 0.0, -9.81),
)
TWISTS = TOP.joint.twist(np.linspace(-6.0, 6.0, 3 * COUNT).reshape(COUNT, 3))


def run(twists=TWISTS, **given):
    arguments = {"dt": 1e-3, "t_end": STEPS * 1e-3} | given
    return lierb.integrate(TOP, twist0=twists, **arguments)


def bits(result):
    return [result.summary[name].combine_chunks().to_pylist() for name in NUMBERS]


@pytest.fixture(scope="module")
def alone():
    """Results of a single thread of Python."""
    return bits(run())


# ---------------------------------------------------------------- threads of Python


def test_concurrent_calls_give_the_bits_of_one(alone):
    with ThreadPoolExecutor(8) as pool:
        found = list(pool.map(lambda _: bits(run()), range(24)))
    assert all(one == alone for one in found)


def test_concurrent_calls_of_different_problems_do_not_mix():
    expected = [bits(run(TWISTS[i : i + 3])) for i in range(8)]
    with ThreadPoolExecutor(8) as pool:
        found = list(pool.map(lambda i: bits(run(TWISTS[i : i + 3])), range(8)))
    assert found == expected


def test_concurrent_calls_with_progress_and_threads_give_the_bits_of_one(alone):
    def call(threads):
        return bits(run(threads=threads, progress=lambda done, total: None))

    most = numba.config.NUMBA_NUM_THREADS
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(call, [1, most, None, 1, most, None]))
    assert all(one == alone for one in found)


@pytest.mark.slow
def test_concurrent_first_calls_compile_once_and_agree():
    # a tableau that nothing else uses: every thread finds it missing
    method = lierb.ButcherTableau([[], [0.625]], [0.2, 0.8], name="of this test")
    start = threading.Barrier(4)

    def call(_):
        start.wait()
        return bits(run(method=method))

    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(call, range(4)))
    assert all(one == found[0] for one in found)
    assert np.isfinite(found[0][NUMBERS.index("position")]).all()


# ---------------------------------------------------------------- threads of Numba


def test_threads_change_no_bit(alone):
    for threads in range(1, numba.config.NUMBA_NUM_THREADS + 1):
        assert bits(run(threads=threads)) == alone


def test_threads_are_set_back():
    before = numba.get_num_threads()
    run(threads=1)
    assert numba.get_num_threads() == before


def test_threads_are_set_back_after_an_error():
    before = numba.get_num_threads()
    with pytest.raises(ZeroDivisionError):
        run(threads=1, progress=lambda done, total: 1 / 0)
    assert numba.get_num_threads() == before


def test_threads_are_used_in_the_call(monkeypatch):
    seen = []

    def idle(entry, counter, threads, jobs):
        seen.append(numba.get_num_threads())
        address, *shape = map(int, jobs["summary"][0, 0])
        ctypes.memset(address, 0, 8 * math.prod(shape))

    monkeypatch.setattr(lierb.runs.driver, "integrate_on_threads", idle)
    run(threads=1)
    assert set(seen) == {1}


def test_no_number_is_taken_twice():
    """Blocks are handed out by a counter that all threads share."""

    @numba.njit(parallel=True)
    def taken(threads, count):
        times = np.zeros(count, np.int64)
        counter = np.zeros(1, np.int64)
        for _ in numba.prange(threads):
            while True:
                first, end = take_share(counter, count, threads)
                if first >= end:
                    break
                for number in range(first, end):
                    times[number] += 1
        return times

    for count in (1, 7, 100_000):
        assert (taken(numba.get_num_threads(), count) == 1).all()


@pytest.mark.parametrize("count", [1, 5, 10_000])
@pytest.mark.parametrize("threads", [1, 3, 64])
def test_shares_become_smaller_so_that_threads_end_together(threads, count):
    counter, sizes = np.zeros(1, np.int64), []
    while (share := take_share(counter, count, threads))[0] < share[1]:
        sizes.append(share[1] - share[0])
    assert sum(sizes) == count
    assert sizes == sorted(sizes, reverse=True)
    assert sizes[-1] == 1
    assert max(sizes) <= max(count / (8 * threads), 1)


# ---------------------------------------------------------------- progress


def long_run(progress, **given):
    """Two chunks of bodies, and several calls of the driver in each."""
    count = lierb.runs.engine.CHUNK_BODIES + 100
    twists = np.tile(TWISTS[:1], (count, 1))
    return run(twists, t_end=0.1, progress=progress, **given)


def test_progress_rises_to_the_total(monkeypatch):
    monkeypatch.setattr(lierb.runs.engine, "CALL_SECONDS", 0.0)  # a call for every step
    monkeypatch.setattr(lierb.runs.engine, "FIRST_CALL_BLOCK_STEPS", 1)
    told = []
    long_run(lambda done, total: told.append((done, total)))
    done, totals = zip(*told, strict=True)
    assert set(totals) == {(lierb.runs.engine.CHUNK_BODIES + 100) * 100}
    assert len(done) == 200
    assert all(a < b for a, b in pairwise(done))
    assert done[0] > 0
    assert done[-1] == totals[-1]


def test_chunks_of_a_known_plan_are_not_cut(monkeypatch):
    """State carried from one call to the next costs as much as dozens of steps."""
    monkeypatch.setattr(lierb.runs.engine, "CALL_SECONDS", 60.0)
    told = []
    long_run(False)
    long_run(lambda done, total: told.append(done))
    assert told == [(lierb.runs.engine.CHUNK_BODIES + 100) * 100]


def test_progress_of_one_body_ends_at_its_steps():
    told = []
    run(TWISTS[0], progress=lambda done, total: told.append((done, total)))
    assert told[-1] == (STEPS, STEPS)


def test_progress_changes_no_bit(alone, monkeypatch):
    # a call of the driver for every step, or for all of them at once
    for seconds, first in ((0.0, 1), (60.0, 10**9)):
        monkeypatch.setattr(lierb.runs.engine, "CALL_SECONDS", seconds)
        monkeypatch.setattr(lierb.runs.engine, "FIRST_CALL_BLOCK_STEPS", first)
        told = []
        assert bits(run(progress=lambda done, total: told.append(done))) == alone  # noqa: B023
        assert len(told) == (STEPS if seconds == 0.0 else 1)


def test_progress_false_is_silent(capfd):
    run(progress=False)
    assert capfd.readouterr() == ("", "")


def test_progress_default_is_silent_without_a_terminal(capfd):
    run()
    assert capfd.readouterr() == ("", "")


def test_progress_true_draws_on_stderr(capfd):
    pytest.importorskip("rich")
    run(progress=True)
    out, _ = capfd.readouterr()
    assert out == ""


# ---------------------------------------------------------------- interrupts


@pytest.mark.parametrize("error", [KeyboardInterrupt, ZeroDivisionError])
def test_interrupted_run_leaves_the_library_usable(alone, error):
    def interrupt(done, total):
        raise error

    with pytest.raises(error):
        long_run(interrupt)
    assert bits(run()) == alone


def test_interrupt_of_one_thread_leaves_the_others_running(alone):
    def interrupt(done, total):
        raise KeyboardInterrupt

    def broken(_):
        with pytest.raises(KeyboardInterrupt):
            run(progress=interrupt)

    with ThreadPoolExecutor(4) as pool:
        broken_ones = [pool.submit(broken, i) for i in range(6)]
        good = [pool.submit(lambda: bits(run())) for _ in range(6)]
        assert all(one.result(timeout=60) == alone for one in good)
        for one in broken_ones:
            one.result(timeout=60)


@pytest.mark.usefixtures("interruptible")
def test_ctrl_c_stops_a_long_run_soon():
    # the main thread is inside compiled code most of the time; calls last some 0.15 s
    timer = threading.Timer(0.5, signal.raise_signal, [signal.SIGINT])
    timer.start()
    try:
        with pytest.raises(KeyboardInterrupt):
            run(dt=1e-6, t_end=1000.0, measure_every=1000)
    finally:
        timer.cancel()


# ---------------------------------------------------------------- fork

needs_fork = pytest.mark.skipif(
    "fork" not in multiprocessing.get_all_start_methods(), reason="no fork on this system"
)

# Each runs in a process of its own: a fork of pytest would take all of its threads' locks along.
# The child may hang or be killed by its threading layer; the alarm turns a hang into SIGALRM.
PRELUDE = """
import gc, multiprocessing, os, signal, sys, threading
import numba, numpy as np
import lierb
from lierb.errors import ForkError

top = lierb.Problem(lierb.Body(1.0, (1.0, 1.0, 1.0)), lierb.joints.spherical())

def run(**given):
    given = {"dt": 1e-2, "t_end": 0.1} | given
    return lierb.integrate(top, twist0=(1, 2, 3, 0, 0, 0), **given)

def child():
    signal.alarm(15)
    try:
        run()
        print("ran", flush=True)
    except ForkError as error:
        print("ForkError:", error, flush=True)

def forked():
    worker = multiprocessing.get_context("fork").Process(target=child)
    worker.start()
    worker.join(60)
    print("exit code", worker.exitcode, flush=True)
"""

FORKS = {
    "after a run": "run(); forked()",
    "after a run with threads": "run(threads=1); forked()",
    "while another thread runs": """
started = threading.Event()
progress = lambda done, total: started.set()
threading.Thread(
    target=run, kwargs={"dt": 1e-6, "t_end": 1000.0, "progress": progress}, daemon=True
).start()
assert started.wait(60)
for _ in range(2):
    forked()
os._exit(0)
""",
    "after Numba's threads were started by others": "numba.get_num_threads(); forked()",
    "before any run": "forked(); run()",
    "while another thread compiles": """
import tempfile
numba.config.CACHE_DIR = tempfile.mkdtemp()  # nothing is compiled yet
threading.Thread(target=lierb.lie.so3.exp, args=([1.0, 2.0, 3.0],)).start()
while not lierb.compiler.code.is_compiling():
    pass
def child():
    signal.alarm(15)
    assert gc.isenabled()
    try:
        lierb.lie.so3.exp([1.0, 2.0, 3.0])
        print("ran", flush=True)
    except ForkError as error:
        print("ForkError:", error, flush=True)
forked()
lierb.lie.so3.exp([1.0, 2.0, 3.0])  # the parent goes on
""",
    "twice": """
def child():
    if os.fork() == 0:
        signal.alarm(15)
        try:
            run()
        except ForkError as error:
            print("ForkError:", error, flush=True)
        os._exit(0)
    os.wait()
run()
forked()
""",
}


def run_script(script, timeout=120, **environment):
    return subprocess.run(
        [sys.executable, "-W", "ignore", "-c", PRELUDE + script],  # 3.12 warns of fork as such
        capture_output=True,
        text=True,
        timeout=timeout,
        check=False,
        cwd=ROOT,
        env=os.environ | environment,
    )


def assert_clear(done):
    """Every child ended by itself, and either ran or said what was wrong."""
    told = done.stdout.splitlines()
    ends = [line for line in told if line.startswith("exit code")]
    assert ends, done.stderr
    assert set(ends) == {"exit code 0"}, done.stdout + done.stderr
    said = [line for line in told if line.startswith(("ran", "ForkError"))]
    assert len(said) == len(ends), done.stdout + done.stderr
    return said


@needs_fork
@pytest.mark.slow  # each starts Python, Numba and a child: 2 s
@pytest.mark.parametrize(
    "name", tiered(FORKS, (), ("after a run", "before any run", "while another thread compiles"))
)
def test_fork_gives_a_clear_error_or_a_run(name):
    assert_clear(run_script(FORKS[name]))


EVERY_LAYER = pytest.mark.parametrize("layer", ["omp", "tbb", "workqueue"])


def run_on_layer(layer, script):
    done = run_script(script, NUMBA_THREADING_LAYER=layer)
    if "No threading layer could be loaded" in done.stderr:
        pytest.skip(f"no threading layer {layer} here")
    return done


@needs_fork
@pytest.mark.slow
@EVERY_LAYER
def test_fork_after_a_run_is_clear_on_every_threading_layer(layer):
    for line in assert_clear(run_on_layer(layer, "run(); forked()")):
        assert "spawn" in line  # the remedy


@pytest.mark.slow
@EVERY_LAYER
def test_concurrent_calls_work_on_every_threading_layer(layer):
    script = """
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
with ThreadPoolExecutor(4) as pool:
    found = list(pool.map(lambda _: run(t_end=1.0).summary["position"].to_pylist(), range(20)))
assert all(one == found[0] for one in found)
print("agreed on", numba.threading_layer())
"""
    done = run_on_layer(layer, script)
    assert done.returncode == 0, done.stderr  # workqueue aborts the process when entered twice
    assert done.stdout.strip() == f"agreed on {layer}"


@pytest.mark.slow
def test_spawned_workers_give_the_bits_of_the_parent(alone):
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        assert pool.apply(_bits_of_a_run) == alone


def _bits_of_a_run():
    return bits(run())


def test_fork_error_is_no_value_error():
    # nothing is wrong with the arguments
    assert issubclass(ForkError, RuntimeError)
    assert not issubclass(ForkError, ValueError)


# ---------------------------------------------------------------- the end of a process


@pytest.mark.slow  # a process
def test_handlers_of_atexit_may_integrate():
    """Python starts no thread any more; what is compiled is compiled in this one."""
    script = """
import atexit
many = top.joint.twist(omega=np.ones((1 << 14, 3)))
atexit.register(lambda: print(lierb.integrate(top, twist0=many, dt=1e-2, t_end=0.1)))
"""
    done = run_script(script)
    assert "16384 trajectories" in done.stdout, done.stderr
