"""Integration of a batch: a sequence of short driver calls, with checks and progress."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from lierb.kernels.loops.blocks import integrate_blocks
from lierb.kernels.loops.job import RESUMED, UNSEEN, job_of, jobs_of
from lierb.kernels.loops.record import carried_rows
from lierb.kernels.stepping.clock import StepClock
from lierb.kernels.systems.plan import AnyPlan
from lierb.runs.driver import Run
from lierb.runs.inputs import Inputs
from lierb.runs.lane_engine import NOT_NOTED, LaneRun, LaneTime
from lierb.runs.output import Chunk, Output
from lierb.runs.threads import CALL_SECONDS, threads_for
from lierb.support.arrays import Array
from lierb.support.forks import check_threads
from lierb.support.progress import BODY_STEPS, Progress, reporter

# Least number of trajectories in a chunk. The carried state of so many stays in the cache.
CHUNK_BODIES = 4096
StartCheck = Callable[[Array, int], bool]

FIRST_CALL_BLOCK_STEPS = 20_000  # about 10 ms, to measure the plan's speed


def integrate(
    plan: AnyPlan,
    inputs: Inputs,
    times: StepClock | LaneTime,
    with_state: bool = False,
    threads: int | None = None,
    progress: Progress = None,
    check: StartCheck | None = None,
    step_times: Array = NOT_NOTED,
) -> Output:
    """Run every trajectory to the end.

    step_times : see `LaneRun`.

    check : function of (`Output.starts` of some trajectories, index of the first). It raises, or
        returns True to check the next trajectories. It is called before the first step or, if one
        chunk has all trajectories, after the driver's first call.
    """
    check_threads()
    output = Output.empty(plan, inputs.count, times, with_state)
    used = threads_for(threads, -(-inputs.count // plan.lanes))
    run: BlockRun | LaneRun
    if isinstance(times, LaneTime):
        run = LaneRun(plan, inputs, times, output, used, step_times)
    else:
        run = BlockRun(plan, inputs, times, output, used)
    if check is not None and not run.checks_late:
        for first, starts in run.starts():
            if not check(starts, first):
                break
        check = None
    begin = RESUMED if inputs.state is not None else 0 if check is None else UNSEEN
    with reporter(progress, *run.total) as report:
        for done in run.calls(begin):
            if check is not None:
                check(output.starts(0, inputs.count), 0)
                check = None
            report(done)
    return run.result()


def check_starts(
    plan: AnyPlan, inputs: Inputs, times: StepClock, threads: int | None, check: StartCheck | None
) -> None:
    """Check the starts of all trajectories without a step; arguments as for `integrate`."""
    if check is None:
        return
    output = Output.empty(plan, inputs.count, times, False)
    used = threads_for(threads, -(-inputs.count // plan.lanes))
    for first, starts in BlockRun(plan, inputs, times, output, used).starts():
        if not check(starts, first):
            break


class BlockRun(Run[StepClock]):
    """A run whose lanes share one clock, chunk by chunk."""

    @property
    def total(self) -> tuple[int, str]:
        return self.inputs.count * self.times.steps, BODY_STEPS

    @property
    def checks_late(self) -> bool:
        return len(self.chunks) == 1

    @cached_property
    def chunks(self) -> list[Chunk]:
        """Chunks of the batch: as many trajectories as one call finishes, or CHUNK_BODIES."""
        lanes, count = self.plan.lanes, self.inputs.count
        in_one_call = lanes * int(_pace(self.plan, self.times.dt).ahead() / self.times.steps)
        size = max(CHUNK_BODIES, in_one_call)
        size = -(-size // lanes) * lanes
        width = -(-min(size, count) // lanes) * lanes
        many = width if in_one_call < min(size, count) else 0
        carried = np.empty((carried_rows(self.plan), many))
        return [Chunk(i, min(i + size, count), carried) for i in range(0, count, size)]

    def starts(self) -> Iterator[tuple[int, Array]]:
        for chunk in self.chunks:
            self.call(chunk, UNSEEN, 0)
            yield chunk.start, self.output.starts(chunk.start, chunk.stop)

    def calls(self, begin: int) -> Iterator[int]:
        for chunk in self.chunks:
            for done in self._run_chunk(chunk, begin):
                yield chunk.start * self.times.steps + (chunk.stop - chunk.start) * done

    def call(self, chunk: Chunk, begin: int, end: int) -> float:
        """Make steps begin … end of a chunk; return the seconds taken, compilation excluded."""
        numbers = {
            "first": chunk.start, "stop": chunk.stop, "begin": begin, "until": end,
            "differ": self.inputs.differ, "rows_per_link": self.output.rows,
            **self.times._asdict(),
        }  # fmt: skip
        arrays = self.arrays | {"carried": chunk.carried}
        jobs = jobs_of(*(job_of(arrays | own, numbers) for own in self.memories))
        return self.run(integrate_blocks, np.zeros(2, dtype=np.int64), jobs)

    def _run_chunk(self, chunk: Chunk, begin: int) -> Iterator[int]:
        """Run a chunk to the end; yield the number of steps after each call of the driver."""
        plan, steps, pace = self.plan, self.times.steps, _pace(self.plan, self.times.dt)
        done, blocks = 0, -(-(chunk.stop - chunk.start) // plan.lanes)
        ahead = pace.ahead()
        while done < steps:
            left = steps - done
            calls = max(1, round(left * blocks / ahead)) if chunk.carried.size else 1
            end = done + -(-left // calls)
            seconds = self.call(chunk, begin, end)
            if plan.calls_functions:
                self.output.collect_exceptions(chunk, is_last=end == steps)
            pace.seconds = seconds / ((end - done) * blocks)
            ahead = pace.steps(CALL_SECONDS)
            begin = done = end
            yield done


@dataclass
class _Pace:
    """Measured time of a step of one block in the last call, s; None before the first call."""

    seconds: float | None = None

    def steps(self, seconds: float) -> float:
        """Return the number of steps that one block makes in `seconds`."""
        if self.seconds is None:
            return max(FIRST_CALL_BLOCK_STEPS, 1)
        return max(seconds / self.seconds, 1)

    def ahead(self) -> float:
        """Return the number of steps of a chunk's first call, which may run slower."""
        return self.steps(0.5 * CALL_SECONDS)


@lru_cache(64)
def _pace(plan: AnyPlan, dt: float) -> _Pace:
    """Return the pace shared by all runs of a plan with step dt; large angles take longer."""
    return _Pace()
