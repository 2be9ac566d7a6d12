"""Calls of the compiled driver, common to runs with a shared clock and with one per lane."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from lierb.compiler.code import compiled
from lierb.compiler.entries import entry_of
from lierb.compiler.tags import Tag
from lierb.kernels.loops.sharing import integrate_on_threads
from lierb.kernels.stepping.clock import Clock
from lierb.kernels.systems.plan import AnyPlan, MechanismPlan
from lierb.kernels.systems.signals import events_of
from lierb.kernels.systems.tree_table import table_of
from lierb.kernels.tracing.memory import LINE
from lierb.runs.inputs import Inputs
from lierb.runs.output import Output
from lierb.runs.threads import running
from lierb.support.arrays import Array
from lierb.support.memory import require_memory

Clocks = TypeVar("Clocks", bound=Clock)


@dataclass(frozen=True)
class Run(Generic[Clocks]):
    """A run: its plan, inputs, times and results, and the number of threads."""

    plan: AnyPlan
    inputs: Inputs
    times: Clocks
    output: Output
    threads: int

    @property
    def tag(self) -> Tag:
        """Tag for which the loop is compiled."""
        return self.plan.code

    @property
    def total(self) -> tuple[int, str]:
        """Amount of work, and its unit."""
        raise NotImplementedError

    @property
    def checks_late(self) -> bool:
        """True if the first call of `calls` checks the starts."""
        return False

    def starts(self) -> Iterator[tuple[int, Array]]:
        """Check the starts only; yield each part's first trajectory and `Output.starts`."""
        raise NotImplementedError

    def calls(self, begin: int) -> Iterator[int]:
        """Run all trajectories to the end; yields the work done after each call of the driver.

        begin : 0, UNSEEN or RESUMED.
        """
        raise NotImplementedError

    def result(self) -> Output:
        return self.output

    @cached_property
    def arrays(self) -> dict[str, NDArray[Any]]:
        """Arrays of the job record."""
        addresses = self.inputs.addresses(self.plan)
        varying = np.flatnonzero(addresses[:, 1])[None]
        inputs = np.zeros((self.threads, len(addresses), self.plan.lanes))
        return {"addresses": addresses, "varying": varying, "inputs": inputs, **self.output.arrays}

    @cached_property
    def memories(self) -> list[dict[str, NDArray[Any]]]:
        """Memory of each thread."""
        return [self.memory_of_thread() for _ in range(self.threads)]

    def memory_of_thread(self) -> dict[str, NDArray[Any]]:
        """Table of a looped plan and memory for one thread; nothing for another plan."""
        plan = self.plan
        if not isinstance(plan, MechanismPlan) or not plan.is_in_memory:
            return {}
        table, rows = table_of(plan)
        # Each number has its derivatives beside it; moved_in_time of an event doubles both.
        rows *= (1 + plan.directions) * (2 if plan.moving and events_of(plan) else 1)
        size = 8 * rows * plan.lanes * self.threads
        require_memory(size, f"memory for {plan.links} links", "lower threads= of lierb.integrate")
        return {"table": table, "memory": aligned(rows, plan.lanes)}

    def run(self, integrate: Any, counter: NDArray[np.int64], jobs: NDArray[Any]) -> float:
        """Run a loop on all threads; return the seconds taken, compilation excluded.

        jobs : [thread][record].
        """
        entry = entry_of(integrate, self.tag, self.arrays["inputs"][0], counter, jobs[0])
        loop = (entry, counter, self.threads, jobs)
        run = compiled(integrate_on_threads, *loop)
        with running(self.threads):
            began = time.perf_counter()
            run(*loop)
            return max(time.perf_counter() - began, 1e-6)


def aligned(rows: int, lanes: int) -> Array:
    """Return zeros, [row][lane], that start at a cache line."""
    raw = np.zeros(rows * lanes + LINE // 8)
    skipped = -raw.ctypes.data % LINE // 8
    return raw[skipped : skipped + rows * lanes].reshape(rows, lanes)
