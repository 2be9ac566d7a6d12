"""Running a batch: bodies packed into columns, the driver called in short calls, progress."""

from __future__ import annotations

import os
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any

import numba
import numpy as np

from lierb.arrays import Array
from lierb.errors import ArgumentError, ForkError
from lierb.kernels import _jit
from lierb.kernels.driver import (
    CARRIED_COLUMNS,
    ERROR_COLUMNS,
    INPUT_COLUMNS,
    INPUT_WIDTHS,
    SUMMARY_COLUMNS,
    integrate_blocks,
)
from lierb.kernels.plan import Plan
from lierb.model import Problem

Progress = bool | Callable[[int, int], None] | None

SUMMARY_SCALARS = (
    "position_error_max", "rotation_error_max", "velocity_error_max", "rotation_rate_error_max",
    "orthogonality_error_max", "energy_drift_max", "position_error_final", "rotation_error_final",
    "first_energy", "status", "failed_step",
)  # fmt: skip
STATE_WIDTHS = {"R": 9, "r": 3, "omega": 3, "v": 3}

# Bodies in one chunk: about 1 kB each, so that a chunk stays in the cache beside the state.
CHUNK_BODIES = 4096
# One call of the driver shall last about this long: short enough for Ctrl-C and a moving bar, long
# enough that the 30 µs of a call do not show.
CALL_SECONDS = 0.15
FIRST_CALL_BLOCK_STEPS = 20_000  # about 10 ms, to find out how fast this problem runs


@dataclass(frozen=True)
class Grid:
    """The times of a run: `steps` steps of `dt` s, measured and saved every so many (0: never)."""

    dt: float
    steps: int
    measure_every: int
    save_every: int

    def saved_steps(self) -> Any:
        if not self.save_every:
            return np.empty(0, dtype=np.int64)
        return np.unique(np.append(np.arange(0, self.steps, self.save_every), self.steps))


@dataclass(frozen=True)
class Inputs:
    """Everything about every body, as (1, width) where shared and (n, width) where batched."""

    columns: tuple[Array, ...]
    count: int

    @classmethod
    def of(cls, problem: Problem, poses: Array, twists: Array, count: int) -> Inputs:
        parts = {
            "mass": problem.body.mass,
            "inertia": problem.body.inertia,
            "com": problem.body.com,
            "gravity": problem.gravity,
            "ground_frame": _flat_pose(problem.joint.ground_frame),
            "body_frame": _flat_pose(problem.joint.body_frame),
            "pitch": problem.joint.pitch,
            "pose": _flat_pose(poses),
            "twist": twists,
        }
        return cls(tuple(parts[name].reshape(-1, w) for name, w in INPUT_WIDTHS.items()), count)

    def packed(self, start: int, stop: int, width: int) -> Array:
        """Bodies start … stop as [column][body], the last one repeated up to `width`."""
        packed = np.empty((INPUT_COLUMNS, width))
        first = 0
        for column in self.columns:
            part = column if len(column) == 1 else column[start:stop]
            place = packed[first : first + column.shape[1]]
            place[:, : stop - start] = part.T
            place[:, stop - start :] = part[-1:].T
            first += column.shape[1]
        return packed


def _flat_pose(poses: Array) -> Array:
    flat: Array = np.concatenate(
        [poses[..., :3, :3].reshape(*poses.shape[:-2], 9), poses[..., :3, 3]], axis=-1
    )
    return flat


@dataclass(frozen=True)
class Output:
    """Results of a run: columns by body, and histories [column][time][body] and so on."""

    summary: dict[str, Any]
    errors: Array
    states: tuple[Array, ...]
    multipliers: Array

    @classmethod
    def empty(cls, plan: Plan, count: int, grid: Grid, with_state: bool) -> Output:
        rows = len(grid.saved_steps())
        summary = {name: np.empty(count) for name in SUMMARY_SCALARS}
        summary |= {name: np.empty((count, width)) for name, width in STATE_WIDTHS.items()}
        return cls(
            summary,
            np.empty((len(ERROR_COLUMNS), rows, count)),
            tuple(np.empty((rows * with_state, count, width)) for width in STATE_WIDTHS.values()),
            np.empty((rows * plan.multipliers, count, len(plan.rows))),
        )

    def take(self, summary: Array, start: int, stop: int) -> None:
        """Keep a finished chunk's summary, [column][padded body]."""
        for c, name in enumerate(SUMMARY_SCALARS):
            self.summary[name][start:stop] = summary[c, : stop - start]
        first = len(SUMMARY_SCALARS)
        for name, width in STATE_WIDTHS.items():
            self.summary[name][start:stop] = summary[first : first + width, : stop - start].T
            first += width


def integrate(
    plan: Plan,
    inputs: Inputs,
    grid: Grid,
    with_state: bool = False,
    threads: int | None = None,
    progress: Progress = None,
) -> Output:
    """Run every body to the end, chunk by chunk."""
    _check_threads()
    output = Output.empty(plan, inputs.count, grid, with_state)
    with _reporter(progress, inputs.count * grid.steps) as report, _threads(threads):
        for start in range(0, inputs.count, CHUNK_BODIES):
            stop = min(start + CHUNK_BODIES, inputs.count)
            for done in _run_chunk(plan, inputs, grid, output, start, stop):
                report(start * grid.steps + (stop - start) * done)
    return output


def _run_chunk(
    plan: Plan, inputs: Inputs, grid: Grid, output: Output, start: int, stop: int
) -> Iterator[int]:
    """Run bodies start … stop; yields the steps done after each call of the driver."""
    blocks = -(-(stop - start) // plan.lanes)
    width = blocks * plan.lanes
    packed = inputs.packed(start, stop, width)
    carried = np.empty((CARRIED_COLUMNS, width))
    summary = np.empty((SUMMARY_COLUMNS, width))
    histories = (output.errors, *output.states, output.multipliers)
    begin, ahead = 0, max(1, FIRST_CALL_BLOCK_STEPS // blocks)
    while begin < grid.steps:
        end = min(begin + ahead, grid.steps)
        arguments = (
            packed, carried, summary, *histories, plan.lanes, start, begin, end, grid.steps,
            grid.dt, grid.measure_every, grid.save_every,
        )  # fmt: skip
        _jit.ensure_compiled(integrate_blocks, plan, *arguments)
        began = time.perf_counter()
        _call_driver(plan, *arguments)
        rate = (end - begin) / max(time.perf_counter() - began, 1e-6)
        begin, ahead = end, max(1, int(CALL_SECONDS * rate))
        yield begin
    output.take(summary, start, stop)


# ---- threads -----------------------------------------------------------------------------------

_driver_lock = threading.Lock()  # Numba's workqueue layer aborts the process when entered twice
_lacks_threads = False


def _after_fork() -> None:
    """In a forked child: whether the parent had started Numba's threads (lierb or anybody)."""
    global _lacks_threads
    with suppress(ValueError):  # what Numba raises before its threads have started
        numba.threading_layer()
        _lacks_threads = True


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_after_fork)


def _check_threads() -> None:
    """Before any lock: a forked child may have inherited it locked."""
    if _lacks_threads:
        raise ForkError(
            "this process was forked after Numba's threads had started in its parent, which it "
            "lacks; start workers with multiprocessing.get_context('spawn')"
        )


def _call_driver(*arguments: Any) -> None:
    with _driver_lock, np.errstate(all="ignore"):
        integrate_blocks(*arguments)


@contextmanager
def _threads(count: int | None) -> Iterator[None]:
    """Numba's number of threads set to `count`, and set back."""
    if count is None:
        yield
        return
    most = numba.config.NUMBA_NUM_THREADS
    whole = isinstance(count, (int, np.integer)) and not isinstance(count, bool)
    if not whole or not 1 <= count <= most:
        raise ArgumentError(
            f"threads={count!r}; expected 1 … {most}, the threads that Numba started with"
        )
    before = numba.get_num_threads()
    numba.set_num_threads(count)
    try:
        yield
    finally:
        numba.set_num_threads(before)


# ---- progress ----------------------------------------------------------------------------------

QUIET_SECONDS = 2.0


def _on_terminal() -> bool:
    return sys.stderr is not None and sys.stderr.isatty()  # None: started without a console


@contextmanager
def _reporter(progress: Progress, total: int) -> Iterator[Callable[[int], None]]:
    """A function that is told the body-steps done so far."""
    if callable(progress):
        tell = progress
        yield lambda done: tell(done, total)
    elif progress is False or (progress is None and not _on_terminal()):
        yield lambda done: None
    else:
        with _bar(
            total, quiet=0.0 if progress else QUIET_SECONDS, required=bool(progress)
        ) as report:
            yield report


@contextmanager
def _bar(total: int, quiet: float, required: bool) -> Iterator[Callable[[int], None]]:
    try:
        from rich.console import Console
        from rich.progress import Progress as Bar
    except ImportError:
        if required:
            raise ArgumentError('progress=True needs rich; pip install "lierb[cli]"') from None
        yield lambda done: None
        return
    bar = Bar(console=Console(stderr=True), transient=True)
    task = bar.add_task("body-steps", total=total)
    began = time.monotonic()

    def report(done: int) -> None:
        if time.monotonic() - began >= quiet and not bar.live.is_started:
            bar.start()
        bar.update(task, completed=done)

    try:
        yield report
    finally:
        bar.stop()
