"""Functions of the user's that raise, body by body: who fails, when, and what is said of it."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from pathlib import Path

import numba
import numpy as np
import pytest
from cases import column, joint
from numba.core.runtime import _nrt_python, rtsys

import lierb
from lierb.errors import FailedTrajectoryWarning
from lierb.results.failures import Failures
from lierb.runs import engine
from lierb.studies.storage.files import parquet_files

pytestmark = [
    pytest.mark.slow,  # kernels of their own
    pytest.mark.filterwarnings("ignore::lierb.errors.ScalarFunctionWarning"),
]
CALM, CONSTANT, RUNTIME, ARRAY, ASSERT, INDEX, STOP = range(7)
FALL = {"dt": 0.125, "t_end": 1.0, "method": "Euler"}
WORDS = {
    CONSTANT: r'touchy raised ValueError: too late \(line \d+, "raise ValueError',
    RUNTIME: r"touchy raised ZeroDivisionError: \('at', 0\.5, 2\.0\) \(line \d+, ",
    ARRAY: r"touchy raised ValueError: \('at', 'an array of shape \(3,\)'\) ",
    ASSERT: r'touchy raised AssertionError: still too late \(line \d+, "raise Ass',
    INDEX: r"touchy raised IndexError: index is out of bounds",
    STOP: r"touchy raised StopIteration",
}


@lierb.wrench(kind=0.0, start=0.5, end=9.0, size=1.0)
def touchy(t, R, r, omega, v, params):
    if params.start <= t < params.end:
        if params.kind == CONSTANT:
            raise ValueError("too late")
        if params.kind == RUNTIME:
            raise ZeroDivisionError("at", t, params.kind)
        if params.kind == ARRAY:
            raise ValueError("at", r)
        if params.kind == ASSERT:
            raise AssertionError("still too late")  # pytest writes another assert
        if params.kind == INDEX:
            return r, np.array([r[int(params.kind)], 0.0, 0.0])
        if params.kind == STOP:
            once = iter((0.0,))
            next(once)
            next(once)
    return np.zeros(3), np.array([params.size, 0.0, R[2, 2]])


def thrown(bodies: int = 1, twist0=(0.0,) * 6, options=FALL, **parameters) -> lierb.Result:
    problem = lierb.Problem(
        lierb.Body(2.0, (1.0, 1.0, 1.0)), lierb.joints.free(), forces=touchy(**parameters)
    )
    twists = np.broadcast_to(twist0, (bodies, 6))
    return lierb.integrate(problem, twist0=twists, **options)


def statuses(result: lierb.Result) -> list[str]:
    return result.summary["status"].to_pylist()


def require_same(result: lierb.Result, other: lierb.Result) -> None:
    assert statuses(result) == statuses(other)
    for table in ("summary", "history"):
        found, wanted = getattr(result, table), getattr(other, table)
        for name in set(found.column_names) - {"status"}:
            np.testing.assert_array_equal(column(found, name), column(wanted, name))


KINDS = np.arange(40) % 7  # some blocks, the last one not full, in each of them every kind
SIZES = np.linspace(0.5, 2.0, len(KINDS))
SAVED = FALL | {"save_every": 1, "record": "state"}


@pytest.fixture(scope="module")
def mixed():
    with pytest.warns(FailedTrajectoryWarning) as told:
        result = thrown(40, options=SAVED, kind=KINDS, size=SIZES)
    return result, str(told[-1].message)


def test_trajectories_whose_function_raises_end_there(mixed):
    result, _ = mixed
    raised = KINDS != CALM
    assert statuses(result) == ["raised" if r else "ok" for r in raised]
    np.testing.assert_array_equal(column(result.summary, "t"), np.where(raised, 0.625, 1.0))
    assert np.isnan(result.v[5:, raised]).all()


def test_what_raises_changes_no_bit_of_others_nor_of_what_was_before(mixed):
    result, _ = mixed
    calm = thrown(40, options=SAVED, size=SIZES)
    fine = KINDS == CALM
    for name in ("position", "rotation", "omega", "v"):
        found, wanted = getattr(result, name), getattr(calm, name)
        np.testing.assert_array_equal(found[:, fine], wanted[:, fine])
        np.testing.assert_array_equal(found[:5], wanted[:5])  # up to t = 0.5 s
    for name in ("energy_drift_max", "work_final"):
        found, wanted = column(result.summary, name), column(calm.summary, name)
        np.testing.assert_array_equal(found[fine], wanted[fine])


@pytest.mark.parametrize("threads", [1, 2])
def test_what_is_said_does_not_depend_on_threads(mixed, threads):
    if threads > numba.config.NUMBA_NUM_THREADS:
        pytest.skip("one core")
    options = SAVED | {"threads": threads}
    with pytest.warns(FailedTrajectoryWarning) as told:
        result = thrown(40, options=options, kind=KINDS, size=SIZES)
    require_same(result, mixed[0])
    assert str(told[0].message) == mixed[1]


@pytest.fixture
def one_step_a_call(monkeypatch):
    """A list that grows by one with each call of the driver."""
    calls, call = [], engine.BlockRun.call
    monkeypatch.setattr(engine.BlockRun, "call", lambda *given: calls.append(0) or call(*given))
    monkeypatch.setattr(engine, "FIRST_CALL_BLOCK_STEPS", 1)
    monkeypatch.setattr(engine, "CALL_SECONDS", 1e-12)
    engine._pace.cache_clear()
    yield calls
    engine._pace.cache_clear()


def test_calls_of_the_driver_may_be_cut_anywhere(mixed, one_step_a_call):
    with pytest.warns(FailedTrajectoryWarning) as told:
        result = thrown(40, options=SAVED, kind=KINDS, size=SIZES)
    assert len(one_step_a_call) == 8
    require_same(result, mixed[0])
    assert str(told[0].message) == mixed[1]


@pytest.mark.parametrize("kind", WORDS)
def test_the_exception_is_told(kind):
    words = rf"the trajectory failed: raised at t = 0\.625 s: {WORDS[kind]}"
    with pytest.warns(FailedTrajectoryWarning, match=words) as told:
        result = thrown(kind=float(kind))
    assert len(told) == 1
    assert "return numbers there instead" in str(told[0].message)
    said = str(Failures.of(result.summary))
    assert said in str(told[0].message)
    assert said in repr(result)
    assert said in repr(pickle.loads(pickle.dumps(result)))


def test_the_first_exception_is_that_of_the_first_trajectory():
    """Whichever came first in time, in a block or in a thread."""
    kind = np.full(5000, float(CONSTANT))  # two chunks
    kind[:33], kind[33] = CALM, RUNTIME
    start = np.full(5000, 0.25)
    start[33] = 0.75
    words = (
        r"4967 of 5000 .*the first is trajectory 33, raised at t = 0\.875 s: touchy raised ZeroDiv"
    )
    with pytest.warns(FailedTrajectoryWarning, match=words):
        thrown(5000, kind=kind, start=start)


def test_the_first_exception_is_told_behind_another_failure():
    twists = np.zeros((5, 6))
    twists[1, 3] = 1e160  # its energy is no number
    words = (
        r"3 of 5 trajectories failed \(1 non_finite, 2 raised\); the first is trajectory 1, "
        r"non_finite at t = 0 s; in trajectory 3, at t = 0\.625 s, touchy raised ValueError: too l"
    )
    with pytest.warns(FailedTrajectoryWarning, match=words):
        result = thrown(5, twists, kind=[CALM, CONSTANT, CALM, CONSTANT, RUNTIME])
    assert statuses(result) == ["ok", "non_finite", "ok", "raised", "raised"]


@pytest.mark.filterwarnings("ignore::lierb.errors.FailedTrajectoryWarning")
def test_exceptions_leave_no_memory_behind():
    """Exceptions with arguments are on Numba's heap; no array of the function's is among them."""
    kinds = np.array([RUNTIME, ARRAY])[np.arange(512) % 2]
    thrown(512, kind=kinds)
    _nrt_python.memsys_enable_stats()
    try:
        before = rtsys.get_allocation_stats()
        assert set(statuses(thrown(512, kind=kinds))) == {"raised"}
        after = rtsys.get_allocation_stats()
    finally:
        _nrt_python.memsys_disable_stats()
    taken = after.alloc - before.alloc
    assert taken >= 4 * 512  # the exception and its arguments, and all calm calls' arrays
    assert after.free - before.free == taken


def test_a_study_would_count_them(mixed):
    summary = mixed[0].summary
    (file,) = parquet_files("00", {"summary": summary}, "zstd")
    assert file.failed == {"raised": np.count_nonzero(KINDS)}


# ---- where else a function is asked -------------------------------------------------------------


def held(t_end: float, t0: float = 0.0, method: str = "Euler", **parameters) -> lierb.Result:
    """Run on a joint with rows that depend on the pose, from rest."""
    problem = lierb.Problem(
        lierb.Body(2.0, (1.0, 1.0, 1.0)), joint("universal"), forces=touchy(**parameters)
    )
    return lierb.integrate(
        problem, twist0=np.zeros(6), dt=0.125, t0=t0, t_end=t_end, method=method, save_every=1,
        record=("state", "reaction"),
    )  # fmt: skip


def test_a_run_that_starts_late_asks_nothing_of_earlier_times():
    """Rows are looked at before the first step, and no force is needed for that."""
    result = held(5.5, t0=5.0, kind=[CONSTANT, RUNTIME], start=-1.0, end=4.0)
    assert statuses(result) == ["ok", "ok"]


def test_a_reaction_that_cannot_be_told_at_the_end_is_a_failure():
    """The next step fails at other times, with and without a recorded reaction."""
    with pytest.warns(FailedTrajectoryWarning, match=r"trajectory 1, raised at t = 0\.5 s: touchy"):
        result = held(0.5, kind=[CALM, CONSTANT])
    assert statuses(result) == ["ok", "raised"]
    with pytest.warns(FailedTrajectoryWarning, match=r"trajectory 1, raised at t = 0\.625 s: to"):
        result = held(1.0, kind=[CALM, CONSTANT])
    reaction = column(result.history, "reaction").reshape(9, 2, 6)
    assert np.isfinite(reaction[:, 0]).all()
    assert np.isfinite(reaction[:4, 1]).all()
    assert np.isnan(reaction[4, 1]).any()
    assert np.isnan(reaction[5:, 1]).all()
    assert np.isfinite(result.v[:5]).all()  # of t = 0.5 s the state is known
    assert np.isnan(result.v[5:, 1]).all()


@pytest.mark.filterwarnings("ignore::lierb.errors.FailedTrajectoryWarning")
def test_a_call_may_end_between_a_reaction_and_the_step_that_fails(one_step_a_call):
    """The reaction at 0.5 s, of the call before, makes the step fail, and is reported once."""
    result = held(1.0, kind=[CALM, CONSTANT])
    assert len(one_step_a_call) == 8
    assert column(result.summary, "t").tolist() == [1.0, 0.625]
    assert "trajectory 1, raised at t = 0.625 s: touchy raised" in repr(result)


@pytest.mark.filterwarnings("ignore::lierb.errors.FailedTrajectoryWarning")
def test_what_raises_is_not_called_singular():
    """The NaN of the first stage makes rows of the second seem dependent."""
    assert statuses(held(1.0, method="Heun", kind=[CALM, CONSTANT])) == ["ok", "raised"]


@lierb.controller(every=1.0)
def ticking(t):
    return {"ticked": t}


@lierb.event(terminal=True, end=1e9)
def ending(t, params):
    return t - params.end


@lierb.observable(unit="s")
def choosy(t):
    if 0.25 < t < 0.45:
        raise ValueError("not now")
    return t


@pytest.mark.slow
def test_what_happens_to_another_trajectory_asks_nothing_of_this_one():
    """Looked at every half second; its neighbour ticks, or ends, at 0.3 s."""
    body = lierb.Body(1.0, (0.4, 0.4, 0.4))
    for changed in ({"every": 0.3}, {"end": 0.3}):
        every = np.array([2.0, changed.get("every", 2.0)])
        end = np.array([1e9, changed.get("end", 1e9)])
        problem = lierb.Problem(
            body, lierb.joints.free(), controllers=ticking(every=every), events=ending(end=end),
            observables=choosy(),
        )  # fmt: skip
        with pytest.warns(FailedTrajectoryWarning):
            found = lierb.integrate(
                problem, twist0=np.zeros((2, 6)), dt=0.1, t_end=1.0, measure_every=5, method="Euler"
            )
        assert found.summary["status"].to_pylist() == ["ok", "raised"]


def test_a_motor_s_torque_may_raise():
    """A function of time alone is called once for all bodies of a block."""

    def torque(t):
        if t >= 0.5:
            raise ValueError("it has stopped", t)
        return 1.0

    problem = lierb.Problem(
        lierb.Body(2.0, (1.0, 1.0, 1.0)), lierb.joints.revolute(), forces=lierb.forces.motor(torque)
    )
    words = (
        r"21 of 21 .*trajectory 0, raised at t = 0\.625 s: torque raised .*'it has stopped', 0.5"
    )
    with pytest.warns(FailedTrajectoryWarning, match=words):
        result = lierb.integrate(problem, twist0=np.zeros((21, 6)), **FALL)
    assert set(statuses(result)) == {"raised"}


ALONE = """
import warnings
import numpy as np
from test_raising import KINDS, SIZES, statuses, thrown
with warnings.catch_warnings(record=True) as told:
    warnings.simplefilter("always")
    result = thrown(len(KINDS), kind=KINDS, size=SIZES)
print(statuses(result) == ["ok" if kind == 0 else "raised" for kind in KINDS])
print(str(told[-1].message).splitlines()[0])
"""


def test_without_the_jit_the_same_is_said():
    environment = os.environ | {"NUMBA_DISABLE_JIT": "1", "PYTHONPATH": str(Path(__file__).parent)}
    done = subprocess.run(
        [sys.executable, "-c", ALONE], env=environment, capture_output=True, text=True, check=True
    )
    right, told = done.stdout.splitlines()
    assert right == "True"
    assert "trajectory 1, raised at t = 0.625 s: touchy raised ValueError: too late (line" in told
