"""Adjoint runs: the gradient of one number at the end of each trajectory, by all its inputs."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lierb.kernels.loops.adjoint import differentiate_blocks
from lierb.kernels.loops.gains import Adjoint, marked, marks, moving
from lierb.kernels.loops.job import BODIES, job_of, jobs_of
from lierb.kernels.loops.remade_steps import begun
from lierb.kernels.numbers.tape import Tape
from lierb.kernels.stepping.clock import StepClock, time_of
from lierb.kernels.stepping.method import Interval
from lierb.kernels.systems.layout import Columns
from lierb.kernels.systems.plan import AnyPlan, LoopPlan, MechanismPlan
from lierb.kernels.systems.signals import controller_fields
from lierb.kernels.systems.state import EVENT, OK
from lierb.kernels.systems.system_of import plan_with_derivatives, system_of
from lierb.kernels.systems.tree_loop_gains import numbers_of_listed
from lierb.kernels.systems.tree_places import STATE
from lierb.kernels.systems.tree_table import table_of
from lierb.runs import engine
from lierb.runs.derivatives import at_ticks, ending_events
from lierb.runs.driver import Run, aligned
from lierb.runs.lane_engine import LaneTime
from lierb.runs.output import Output
from lierb.runs.starts import Ready
from lierb.runs.threads import CALL_SECONDS, threads_for
from lierb.support.arrays import Array
from lierb.support.memory import require_memory
from lierb.support.progress import BODY_STEPS, Progress, reporter

MOST_KEPT = 1 << 25  # bytes of a thread for the states of all steps; with more, some are made again
# Ends of adaptive steps that are noted at first: of all trajectories, and of each one.
FIRST_STEPS, LEAST_ROOM, MOST_ROOM = 1 << 23, 64, 4096
FIRST_CALL_STEPS = 2000  # steps of a block in a thread's first call


@dataclass(frozen=True)
class AdjointRun(Run[Any]):
    """A run whose steps are known, differentiated backwards.

    number : of the objective, see `Adjoint`.
    step_times : ends of the steps, [step][trajectory or 1], s; row 0 has the start.
    ended_by : see `lierb.kernels.loops.remade_steps.Noted`.
    """

    number: int
    step_times: Array
    ended_by: Array

    @cached_property
    def tag(self) -> Adjoint:
        code = self.plan.code
        if isinstance(code, LoopPlan):
            code = replace(code, has_gains=True)
        return Adjoint(code, self.number)

    @property
    def steps(self) -> int:
        return len(self.step_times) - 1

    @property
    def total(self) -> tuple[int, str]:
        return self.inputs.count * self.steps, BODY_STEPS

    def calls(self, begin: int = 0) -> Iterator[int]:
        """Differentiate some trajectories after the others; yield the work done."""
        lanes, count, first, times = self.plan.lanes, self.inputs.count, 0, self.times
        size = max(FIRST_CALL_STEPS // self.steps, 1) * lanes * self.threads
        while first < count:
            stop = min(first + size, count)
            numbers = {
                "dt": times.dt if isinstance(times, StepClock) else 0.0,
                "seed": times.seed if isinstance(times, LaneTime) else 0.0,
                "steps": self.steps, "kept_every": self.every, "differ": BODIES,
                "first_row": self.rows[0], "state_rows": self.rows[1],
                "first": first, "stop": stop,
            }  # fmt: skip
            jobs = jobs_of(*(job_of(self.arrays | own, numbers) for own in self.memories))
            seconds = self.run(differentiate_blocks, np.zeros(2, dtype=np.int64), jobs)
            blocks = max(int((stop - first) / lanes * CALL_SECONDS / seconds), self.threads)
            first, size = stop, blocks * lanes
            yield stop * self.steps

    @cached_property
    def gains(self) -> Array:
        """Gains by the inputs, then the objective, [column][trajectory]."""
        return np.empty((self.inputs.columns["state"].start + 1, self.inputs.count))

    @cached_property
    def every(self) -> int:
        """Number of steps between states that are kept: 1, or about the root of the steps'."""
        kept = 8 * self.plan.lanes * self.rows[1] * self.steps
        return 1 if kept <= MOST_KEPT else math.isqrt(self.steps)

    @property
    def rows(self) -> tuple[int, int]:
        """Rows of memory that the gains and a state take."""
        gains, state = rows_of(self.tag)
        return gains, state + (int(self.table[0][0, STATE]) if self.table else 0)

    @cached_property
    def table(self) -> tuple[NDArray[np.int64], int] | None:
        """Table and number of rows of a looped plan."""
        plan = self.plan
        is_looped = isinstance(plan, MechanismPlan) and plan.is_in_memory
        return table_of(plan, apart=True) if is_looped else None

    def memory_of_thread(self) -> dict[str, NDArray[Any]]:
        """Return a thread's memory for gains and states."""
        gains, state = self.rows
        rows = gains + state * (self.steps // self.every + 1 + self.every)
        size = 8 * rows * self.plan.lanes * self.threads
        require_memory(size, "the states of all steps", "lower threads= or take fewer steps")
        memory: dict[str, NDArray[Any]] = {"memory": aligned(rows, self.plan.lanes)}
        if self.table:
            numbers = 2 * (self.table[1] + self.inputs.columns["state"].start)
            memory |= {"table": self.table[0], "nodes": aligned(numbers, self.plan.lanes)}
        return memory

    @cached_property
    def arrays(self) -> dict[str, NDArray[Any]]:
        noise = np.zeros((1, self.step_times.shape[1]))  # full blocks
        if isinstance(self.times, LaneTime):
            noise[0, : self.inputs.count] = self.times.numbers
        return super().arrays | {
            "step_times": self.step_times, "ended_by": self.ended_by, "gains": self.gains,
            "noise_indices": noise,
        }  # fmt: skip


@lru_cache(256)
def rows_of(tag: Adjoint) -> tuple[int, int]:
    """Return how many rows of memory the gains and a state take, except for nodes in memory."""
    if isinstance(tag.plan, LoopPlan):
        columns = system_of(tag.plan).state, Columns(*controller_fields(tag.plan))
        numbers = sum(each.count for each in columns)
        return numbers_of_listed(tag.plan) + numbers, numbers
    system, one = system_of(tag.plain), np.ones(1)
    given = [one] * system.inputs.count
    with np.errstate(all="ignore"):
        of_inputs = marked(system_of(tag.plan).body(Tape().opened(given)))
        held = begun(tag.plain, system.body(given), given, Interval(one, one, one), one)
    numbers = len(moving(held))
    return tag.inputs + marks(of_inputs) + numbers, numbers


def plan_backwards(ready: Ready) -> AnyPlan | None:
    """Return the plan of a run's adjoint; None for looped code with rows."""
    if not ready.plan.is_in_memory:
        fields = (f.name for f, _ in ready.inputs.columns if f.name != "state")
        return plan_with_derivatives(ready.plan, tuple(fields))
    plan = plan_with_derivatives(ready.plan, ())
    code = plan.code
    assert isinstance(code, LoopPlan)
    return None if code.constraint_kinds else plan


def gains_of(
    ready: Ready,
    plan: Any,
    number: int,
    threads: int | None,
    progress: Progress,
    check: engine.StartCheck | None,
) -> tuple[Array, Array]:
    """Return gains of a number at the end by all inputs, then the number, [column][trajectory].

    Beside them, the ends of all steps; see `AdjointRun.step_times`.

    plan : `plan_backwards`.   number : see `Adjoint`.
    """
    times, inputs = ready.times, ready.inputs
    if isinstance(times, StepClock):
        engine.check_starts(ready.plan, inputs, times, threads, check)
        numbers = 3 * (times.steps + 1)  # with those that NumPy makes on the way
        require_memory(8 * numbers, "the ends of all steps", "take fewer steps")
        ends = time_of(times, np.arange(times.steps + 1))[:, None]
        ended_by = np.zeros((0, 0))
    else:
        ends, ended_by = _noted(ready, threads, progress, check)
    output = Output.empty(ready.plan, 1, times, with_state=False)
    used = threads_for(threads, -(-inputs.count // plan.lanes))
    run = AdjointRun(plan, inputs, times, output, used, number, ends, ended_by)
    with reporter(progress, *run.total) as report:
        for done in run.calls():
            report(done)
    return run.gains, ends


def _noted(
    ready: Ready, threads: int | None, progress: Progress, check: engine.StartCheck | None
) -> tuple[Array, Array]:
    """Run; return the ends of all steps, of which the last is repeated, and the terminal events.

    They are `step_times` and `ended_by` of `AdjointRun`.
    """
    times, count = ready.times, ready.inputs.count
    assert isinstance(times, LaneTime)
    room = min(max(FIRST_STEPS // count, LEAST_ROOM), MOST_ROOM)
    width = -(-count // ready.plan.lanes) * ready.plan.lanes  # full blocks
    while True:
        remedy = "take fewer trajectories at a time, or a larger tolerance"
        require_memory(8 * room * width, "the ends of all steps", remedy)
        ends = np.empty((room, width))
        output = engine.integrate(
            ready.plan, ready.inputs, times, False, threads, progress, check, step_times=ends
        )
        steps = output.of_lanes("steps").astype(np.int64)
        most = int(steps.max(initial=1))
        if most < room:
            break
        room, check = most + 1, None
    ends = ends[: most + 1]
    ends[0] = times.span.start
    ends[:, count:] = times.span.start
    steps = np.pad(steps, (0, width - count))
    after = np.arange(most + 1)[:, None] > steps
    last = ends[steps, np.arange(width)]
    ends[after] = np.broadcast_to(last, ends.shape)[after]
    failed = (output.status != OK) & (output.status != EVENT)
    ends[:, :count][:, failed] = np.nan
    return ends, _ended_by(ready, output, steps)


def _ended_by(ready: Ready, output: Output, steps: NDArray[np.int64]) -> Array:
    """Return `ended_by` of `AdjointRun`.   steps : of each trajectory."""
    ended_by = np.stack([np.full(len(steps), -1.0), np.full(len(steps), np.inf)])
    if ready.model.events:
        at, which = np.array([*ending_events(ready, output)], dtype=int).reshape(-1, 2).T
        is_fixed = at_ticks(ready.model, at, which, output.t[at])
        ended_by[:, at] = np.where(is_fixed, -1, which), steps[at]
    return ended_by
