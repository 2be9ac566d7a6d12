"""Running a batch: where its numbers are, the driver called in short calls, progress."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from lierb.compiler.code import compiled
from lierb.compiler.entries import entry_of
from lierb.kernels.loops.blocks import integrate_blocks, integrate_on_threads
from lierb.kernels.loops.job import RESUMED, UNSEEN, job_of
from lierb.kernels.loops.record import (
    carried_columns,
)
from lierb.kernels.stepping.clock import Clock
from lierb.kernels.systems.plan import AnyPlan
from lierb.runs.inputs import Inputs
from lierb.runs.output import Chunk, Output
from lierb.runs.threads import CALL_SECONDS, running, threads_for
from lierb.support.arrays import Array
from lierb.support.forks import check_threads
from lierb.support.progress import Progress, reporter

# In one chunk at the least: what is carried of them stays in the cache beside the state.
CHUNK_BODIES = 4096
FIRST_CALL_BLOCK_STEPS = 20_000  # about 10 ms, to find out how fast a plan runs


@dataclass(frozen=True)
class Run:
    """What all calls of the driver have in common."""

    plan: AnyPlan
    inputs: Inputs
    clock: Clock
    output: Output
    threads: int

    @cached_property
    def _arrays(self) -> dict[str, NDArray]:
        """As the driver takes them; `inputs` is where its threads bring numbers together."""
        places = self.inputs.places(self.plan)
        varying = np.flatnonzero(places[:, 1])[None]
        blocks = np.empty((self.threads, len(places), self.plan.lanes))
        return {"places": places, "varying": varying, "inputs": blocks, **self.output.arrays}

    def call(self, chunk: Chunk, begin: int, end: int) -> float:
        """Steps begin … end of a chunk; returns the seconds they took, compilation apart."""
        arrays = self._arrays | {"carried": chunk.carried}
        sizes = (chunk.start, chunk.stop, begin, end, self.inputs.differ, self.output.rows)
        jobs, counter = job_of(arrays, *sizes, clock=self.clock), np.zeros(2, dtype=np.int64)
        entry = entry_of(integrate_blocks, self.plan, arrays["inputs"][0], counter, jobs)
        loop = (entry, counter, self.threads, jobs)
        run = compiled(integrate_on_threads, *loop)
        with running(self.threads):
            began = time.perf_counter()
            run(*loop)
            return max(time.perf_counter() - began, 1e-6)


def integrate(
    plan: AnyPlan,
    inputs: Inputs,
    clock: Clock,
    with_state: bool = False,
    threads: int | None = None,
    progress: Progress = None,
    check: Callable[[Array, int], bool] | None = None,
) -> Output:
    """Run every body to the end, chunk by chunk.

    check : a function of `Output.starts` of a chunk and the number of its first body; it raises, or
        says whether it wants to see the next chunk. It sees all of them before the first step, or,
        where they are but one chunk, after the driver's first call.
    """
    check_threads()
    output = Output.empty(plan, inputs.count, clock, with_state)
    used = threads_for(threads, -(-inputs.count // plan.lanes))
    run = Run(plan, inputs, clock, output, used)
    chunks = list(_chunks(run, inputs.count))
    if check is not None and len(chunks) > 1:
        for chunk in chunks:
            run.call(chunk, UNSEEN, 0)
            if not check(output.starts(chunk.start, chunk.stop), chunk.start):
                break
        check = None
    begin = RESUMED if inputs.state is not None else 0 if check is None else UNSEEN
    with reporter(progress, inputs.count * clock.steps) as report:
        for chunk in chunks:
            for done in _run_chunk(run, chunk, begin):
                if check is not None:
                    check(output.starts(chunk.start, chunk.stop), chunk.start)
                    check = None
                report(chunk.start * clock.steps + (chunk.stop - chunk.start) * done)
    return output


def _chunks(run: Run, count: int) -> Iterator[Chunk]:
    """As many bodies as one call can take to the end, or CHUNK_BODIES of them."""
    lanes = run.plan.lanes
    in_one_call = lanes * int(_pace(run.plan, run.clock.dt).ahead() / run.clock.steps)
    size = max(CHUNK_BODIES, in_one_call)
    size = -(-size // lanes) * lanes
    width = -(-min(size, count) // lanes) * lanes
    many = width if in_one_call < min(size, count) else 0
    carried = np.empty((carried_columns(run.plan), many))
    for start in range(0, count, size):
        yield Chunk(start, min(start + size, count), carried)


def _run_chunk(run: Run, chunk: Chunk, begin: int) -> Iterator[int]:
    """Run a chunk to the end; yields the steps done after each call of the driver.

    begin : 0, UNSEEN or RESUMED.
    """
    plan, steps = run.plan, run.clock.steps
    done, blocks, pace = 0, -(-(chunk.stop - chunk.start) // plan.lanes), _pace(plan, run.clock.dt)
    ahead = pace.ahead()
    while done < steps:
        left = steps - done
        calls = max(1, round(left * blocks / ahead)) if chunk.carried.size else 1
        end = done + -(-left // calls)
        seconds = run.call(chunk, begin, end)
        if plan.calls_functions:
            run.output.hear(plan, chunk, is_last=end == steps)
        pace.seconds = seconds / ((end - done) * blocks)
        ahead = pace.steps(CALL_SECONDS)
        begin = done = end
        yield done


@dataclass
class _Pace:
    """How long a step of one block took in the last call, in s; None before there was one."""

    seconds: float | None = None

    def steps(self, seconds: float) -> float:
        """Steps of one block for so many seconds."""
        if self.seconds is None:
            return max(FIRST_CALL_BLOCK_STEPS, 1)
        return max(seconds / self.seconds, 1)

    def ahead(self) -> float:
        """For the first call of a chunk, whose bodies may be slower than the last ones."""
        return self.steps(0.5 * CALL_SECONDS)


@lru_cache(64)
def _pace(plan: AnyPlan, dt: float) -> _Pace:
    """One for all runs of a plan with steps of dt: the larger a step's angles, the slower it is."""
    return _Pace()


# ---- threads -----------------------------------------------------------------------------------
