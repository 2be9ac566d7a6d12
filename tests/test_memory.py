"""Results that the memory does not hold are refused before anything is allocated or compiled."""

import re
import sys
from types import SimpleNamespace

import numpy as np
import pyarrow as pa
import pytest
from cases import RECORD, integrate, top

import lierb
from lierb.errors import LierbError, MemoryLimitError
from lierb.results import tables as tables_module
from lierb.results.tables import size_of_tables
from lierb.runs import engine
from lierb.runs import lane_engine as lanes
from lierb.sampling import Design, Rotation
from lierb.support import memory

GB = 10**9


@pytest.fixture
def nothing_runs(monkeypatch):
    def refuse(*_, **__):
        raise AssertionError("a run was started")

    monkeypatch.setattr(engine, "integrate", refuse)


@pytest.fixture
def four_gigabytes(monkeypatch):
    for module in (memory, tables_module):
        monkeypatch.setattr(module, "available", lambda: 4 * GB)


def batch(count):
    """So many tops, in the memory of one."""
    problem, twist0 = top()
    return {"problem": problem, "twist0": np.broadcast_to(twist0, (count, 6)), "dt": 1e-3}


@pytest.mark.usefixtures("nothing_runs", "four_gigabytes")
def test_history_that_does_not_fit_is_refused_with_its_size_and_what_to_do():
    run = batch(4096) | {"t_end": 10.0, "record": ("state",)}
    with pytest.raises(MemoryLimitError) as told:
        lierb.integrate(**run, save_every=1)
    assert re.search(r"history of 10001 times × 4096 bodies takes 9\.\d+ GB", str(told.value))
    assert "4 GB are free" in str(told.value)
    assert "record less" in str(told.value)
    assert "integrate_batches" in str(told.value)
    every = int(re.search(r"save_every=(\d+) fits", str(told.value))[1])
    assert 2 < every < 10
    with pytest.raises(AssertionError, match="started"):
        lierb.integrate(**run, save_every=every)
    with pytest.raises(MemoryLimitError):
        lierb.integrate(**run, save_every=2)


@pytest.mark.usefixtures("nothing_runs", "four_gigabytes")
@pytest.mark.parametrize("save_every", [None, 1])
def test_summary_that_does_not_fit_is_refused(save_every):
    with pytest.raises(MemoryLimitError, match=r"summary of 1000000000 bodies.*fewer at a time"):
        lierb.integrate(**batch(10**9), t_end=2e-3, save_every=save_every)


@pytest.mark.usefixtures("nothing_runs")
def test_sizes_beyond_any_address_are_refused():
    with pytest.raises(MemoryLimitError, match="TB"):
        lierb.integrate(**batch(10**13), t_end=1e9, save_every=1)


def test_memory_error_of_numpy_is_told_as_lierbs_own(monkeypatch):
    def fail(*_):
        raise MemoryError

    monkeypatch.setattr(engine.Output, "empty", fail)
    with pytest.raises(MemoryLimitError, match="history of 3 times × 2 bodies takes"):
        lierb.integrate(**batch(2), t_end=2e-3, save_every=1, record=RECORD)


@pytest.mark.usefixtures("four_gigabytes")
def test_copy_of_an_argument_that_does_not_fit_is_refused():
    with pytest.raises(MemoryLimitError, match=r"mass of shape \(1000000000,\) takes 8 GB"):
        lierb.Body(np.broadcast_to(1.0, (10**9,)), (1.0, 1.0, 1.0))
    with pytest.raises(MemoryLimitError, match=r"so3\.compose of a batch \(100000, 100000\)"):
        lierb.lie.so3.compose(np.ones((10**5, 1, 3, 3)), np.ones((10**5, 3, 3)))


def test_sequence_without_an_end_is_refused_before_it_is_read():
    with pytest.raises(LierbError, match=r"^mass "):
        lierb.Body(range(10**15), (1.0, 1.0, 1.0))


@pytest.mark.parametrize("bodies", [10**15, 2**62])
def test_draws_that_do_not_fit_are_refused(bodies):
    design = Design({"attitude": Rotation()}, bodies)
    with pytest.raises(MemoryLimitError, match=rf"what is drawn for {bodies} bodies .* fewer at"):
        design.draw()


def test_estimate_is_what_the_tables_hold(monkeypatch):
    """Not less, and at most a tenth more."""
    estimated = []

    def seen(*given):
        estimated.append(size_of_tables(*given))
        return estimated[-1]

    monkeypatch.setattr(tables_module, "size_of_tables", seen)
    problem, twist0 = top()
    result = integrate(problem, twist0=np.tile(twist0, (64, 1)), dt=1e-2, t_end=0.2, save_every=1)
    before = pa.total_allocated_bytes()
    held = result.summary.nbytes + result.history.nbytes + result._end.output.ends.nbytes
    assert pa.total_allocated_bytes() == before
    assert held <= estimated[0] < 1.1 * held


@lierb.states(wheel=(0.0, 0.0, 0.0), angle=0.0)
def stored(omega):
    return {"wheel": omega, "angle": omega[2]}


@lierb.controller(every=0.1, memory={"sum": 0.0})
def held(omega, memory):
    return {"torque": -omega, "level": omega[0]}, {"sum": memory.sum + omega[0]}


@pytest.mark.parametrize("options", [{}, {"save_at": (0.1,)}, {"save_at": (0.1, 0.2)}], ids=str)
@pytest.mark.parametrize("record", [(), ("state",), RECORD], ids=str)
def test_estimate_of_lanes_is_what_the_tables_hold(options, record, monkeypatch):
    """Not less, and at most a tenth more: of adaptive steps, states and controllers, too."""
    estimated, outputs = [], []

    def seen(*given):
        estimated.append(size_of_tables(*given))
        return estimated[-1]

    def made(plan, inputs, times, with_state, *_):
        outputs.append(engine.Output.empty(plan, inputs.count, times, with_state))
        for array in outputs[-1].arrays.values():
            array.fill(0.0)
        return outputs[-1]

    monkeypatch.setattr(tables_module, "size_of_tables", seen)
    monkeypatch.setattr(engine, "integrate", made)
    plain, twist0 = top()
    problem = lierb.Problem(
        plain.body, plain.joint, plain.gravity, states=stored(), controllers=held()
    )
    given = options | ({"record": record} if options else {})
    count = 1000
    result = lierb.integrate(
        problem, twist0=np.tile(twist0, (count, 1)), rtol=1e-6, t_end=0.2, **given
    )
    arrays = {id(a): a.nbytes for a in outputs[0].arrays.values()}
    numbers = 8 * count  # of the trajectories, to draw noise by
    made_new = {b.address: b.size for t in tables(result) for b in buffers(t)}
    written = [(a.ctypes.data, a.ctypes.data + a.nbytes) for a in outputs[0].arrays.values()]
    copies = sum(size for at, size in made_new.items() if not any(b <= at < e for b, e in written))
    grown = sum(arrays.values()) + numbers + copies
    assert grown <= 1.01 * estimated[0]  # but for a dictionary's names and the like
    assert estimated[0] < 1.1 * grown


def tables(result):
    return [table for table in (result.summary, result.history) if table is not None]


def buffers(table):
    for column in table.columns:
        for chunk in column.chunks:
            yield from (b for b in chunk.buffers() if b is not None)


# ---------------------------------------------------------------- how much there is


def test_small_runs_do_not_ask(monkeypatch):
    monkeypatch.setattr(memory, "available", lambda: 0)
    assert memory.is_free(memory.ALWAYS)
    assert not memory.is_free(memory.ALWAYS + 1)


@pytest.fixture
def system(tmp_path, monkeypatch):
    """Files as Linux has them: 8 GB free, in a group within one."""
    (tmp_path / "meminfo").write_text(f"MemTotal: 9000000 kB\nMemAvailable: {8 * 10**6} kB\n")
    (tmp_path / "cgroup").write_text("1:name=systemd:/x\n0::/outer/inner\n")
    inner = tmp_path / "fs" / "outer" / "inner"
    inner.mkdir(parents=True)
    monkeypatch.setattr(memory, "MEMINFO", tmp_path / "meminfo")
    monkeypatch.setattr(memory, "CGROUP", tmp_path / "cgroup")
    monkeypatch.setattr(memory, "CGROUPS", tmp_path / "fs")
    return inner


def limited(group, limit, used, inactive, active=0):
    (group / "memory.max").write_text(f"{limit}\n")
    (group / "memory.current").write_text(f"{used}\n")
    (group / "memory.stat").write_text(f"anon 5\nactive_file {active}\ninactive_file {inactive}\n")


def test_available_is_what_the_system_says(system):
    assert memory.available() == 8 * 1024 * 10**6


def test_files_that_were_read_often_leave_their_memory_to_who_asks(system):
    limited(system, 5 * GB, 5 * GB, inactive=GB, active=3 * GB)
    assert memory.available() == 4 * GB


def test_available_heeds_the_limits_of_every_control_group(system):
    limited(system, "max", 3 * GB, 0)
    assert memory.available() == 8 * 1024 * 10**6
    limited(system.parent, 5 * GB, 3 * GB, GB)  # what is cached is given back
    assert memory.available() == 3 * GB
    limited(system, 2 * GB, GB, 0)
    assert memory.available() == GB
    limited(system, GB, 2 * GB, 0)
    assert memory.available() == 0


def test_available_is_all_memory_where_nobody_tells(system, monkeypatch):
    memory.MEMINFO.unlink()
    memory.CGROUP.unlink()
    values = {"SC_PHYS_PAGES": 1000, "SC_PAGE_SIZE": 4096}
    monkeypatch.setattr(memory.os, "sysconf", values.__getitem__, raising=False)
    assert memory.available() == 4096000
    monkeypatch.delattr(memory.os, "sysconf")
    assert memory.available() == sys.maxsize


@pytest.mark.parametrize(
    ("size", "told"),
    [(0, "0 bytes"), (999, "999 bytes"), (1500, "1.5 kB"), (4 * GB, "4 GB"), (10**18, "1e+06 TB")],
)
def test_sizes_are_told_in_units_that_are_read(size, told):
    assert memory.in_words(size) == told


def test_events_beyond_memory_are_told(monkeypatch):
    """Nobody knows before how many there will be: a run stops once they have no room."""
    room = np.zeros((101, 20))  # the number of events, then these
    run = SimpleNamespace(_events=[], memories=[{"events": room}])
    monkeypatch.setattr(memory, "ALWAYS", 100_000)
    monkeypatch.setattr(memory, "available", lambda: 100_000)
    room[0, 0] = 100
    lanes.LaneRun._take_events(run)
    room[0, 0] = 100
    with pytest.raises(lierb.errors.MemoryLimitError, match="events so far takes 128 kB"):
        lanes.LaneRun._take_events(run)


# ---- where results lie -------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.skipif(
    pa.default_memory_pool().backend_name != "mimalloc", reason="lierb asks NumPy for memory then"
)
@pytest.mark.parametrize(
    "clock", [{"dt": 1e-3}, pytest.param({"rtol": 1e-6}, marks=pytest.mark.long)], ids=str
)
def test_results_lie_in_arrows_pool(clock):
    """It keeps what is given back: a run that follows another one has no page faults."""
    before = pa.total_allocated_bytes()
    result = lierb.integrate(**{**batch(20_000), **clock}, t_end=1e-3)
    held = pa.total_allocated_bytes() - before
    assert held >= 0.9 * result.summary.select(["rotation", "position", "omega", "v"]).nbytes
    del result
    assert pa.total_allocated_bytes() - before < 0.1 * held


def test_what_arrow_keeps_for_later_counts_as_free(monkeypatch):
    left = [1 * GB, 3 * GB]  # before and after it is asked to let go
    monkeypatch.setattr(memory, "available", lambda: left.pop(0))
    assert memory.is_free(2 * GB)
    assert not left
