"""Runs with one clock per lane: adaptive steps, output at saved times, events, controllers."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lierb.compiler.entries import entry_of
from lierb.kernels.loops import lane_samples as samples
from lierb.kernels.loops import workspace as ws
from lierb.kernels.loops.event_search import watch
from lierb.kernels.loops.job import UNSEEN, job_of, jobs_of
from lierb.kernels.loops.lanes import integrate_lanes
from lierb.kernels.loops.record import carried_columns, carried_rows, lane_column
from lierb.kernels.stepping.lane_clock import Span
from lierb.kernels.stepping.step_size import Tolerances
from lierb.kernels.systems.layout import POSE_AND_TWIST
from lierb.kernels.systems.measures import SUMMARY
from lierb.kernels.systems.observables import observables_of
from lierb.kernels.systems.signals import events_of, signals_width
from lierb.kernels.tracing import calls
from lierb.runs.driver import Run
from lierb.runs.lane_copies import copies
from lierb.runs.output import Output
from lierb.runs.threads import CALL_SECONDS
from lierb.support.arrays import Array
from lierb.support.memory import require_memory

FIRST_ITERATIONS = 200  # iterations of a thread's first call, which measures the plan's speed
MOST_ITERATIONS = 1 << 30
EVENT_ROOM = 1 << 17  # numbers of the events of one call for which a workspace has room, at least
SHARES = 1000  # units of progress of a trajectory
COPIES = 4  # copies of the events in memory while the table is made
NOT_NOTED = np.zeros((0, 0))  # in place of the ends of steps
IDLE = 1.0  # termination code of a lane before its first trajectory


@dataclass(frozen=True)
class LaneTime:
    """Times of a run with one clock per lane.

    save_at : times of the rows of a history, s.   kinds : [direction, is terminal][event].
    seed : seed of the noise.   numbers : index of each trajectory's noise.
    steps : numbers of the fixed steps that the rows follow; None for rows at other times.
    jumps : times at which forces may jump, s; a step that would cross one ends there.
    keeps_sides : whether events begin on the sides that they had in the run before.
    """

    span: Span
    tolerances: Tolerances
    save_at: Array
    kinds: Array
    seed: int = 0
    numbers: Array = field(default_factory=lambda: np.zeros(0))
    steps: NDArray[np.int64] | None = None
    jumps: Array = field(default_factory=lambda: np.zeros(0))
    keeps_sides: bool = False

    @property
    def saved_rows(self) -> int:
        return len(self.save_at)

    def saved_steps(self) -> NDArray[np.int64]:
        """Return the numbers of fixed steps, or of the rows."""
        return np.arange(self.saved_rows) if self.steps is None else self.steps

    def saved_times(self) -> Array:
        return self.save_at

    @property
    def end(self) -> float:
        return self.span.end


ONE_TIME = LaneTime(
    Span(0.0, 0.0, 0.0, 0.0, 0.0), Tolerances(*[0.0] * 12), np.zeros(1), np.zeros(0)
)


@dataclass(frozen=True)
class LaneRun(Run[LaneTime]):
    """A run with one clock per lane.

    step_times : ends of the steps, [step][trajectory], s, to be filled in; row 0 is not. NOT_NOTED
        for none.
    """

    step_times: Array

    @property
    def total(self) -> tuple[int, str]:
        return self.inputs.count * SHARES, "trajectories"

    def starts(self) -> Iterator[tuple[int, Array]]:
        self.call(UNSEEN, 0, is_first=True)
        self._counter[0] = 0
        yield 0, self.output.starts(0, self.inputs.count)

    def calls(self, begin: int) -> Iterator[int]:
        iterations, is_first = FIRST_ITERATIONS, True
        while is_first or self._any_active():
            seconds = self.call(begin, iterations, is_first)
            is_first = False
            self._take_events()
            if self.plan.calls_functions:
                self._collect_exceptions()
            iterations = min(max(int(iterations * CALL_SECONDS / seconds), 1), MOST_ITERATIONS)
            yield int(self._done() * SHARES)

    def call(self, begin: int, iterations: int, is_first: bool) -> float:
        """Iterate the lanes of all threads; return the seconds taken, compilation excluded."""
        jobs, counter = self._jobs, self._counter
        jobs["begin"], jobs["until"] = (begin, 0 if is_first else 1), iterations
        return self.run(integrate_lanes, counter, jobs)

    def result(self) -> Output:
        """Return the output, with the events in order of trajectory and time.

        Events at equal times keep their order; those after a trajectory's end are left out.
        """
        rows = np.concatenate([np.zeros((0, self._event_width)), *self._events])
        rows = rows[rows[:, 0] >= 0]
        rows = rows[np.lexsort((rows[:, 2], rows[:, 0]))]
        events, derivatives = np.split(rows, [self._event_width - self._derivatives], axis=1)
        return replace(
            self.output,
            events=np.ascontiguousarray(events),
            event_derivatives=np.ascontiguousarray(derivatives.T),
        )

    @cached_property
    def arrays(self) -> dict[str, NDArray[Any]]:
        output, times = self.output, self.times
        for array in (output.history, *output.states, output.multipliers, output.reactions):
            if times.saved_rows:
                array.fill(np.nan)  # rows after a trajectory's end
        output.summary[SUMMARY.index("raised")] = calls.CLEAR  # of running trajectories
        return super().arrays | {
            "save_at": times.save_at[None],
            "noise_indices": np.ascontiguousarray(times.numbers[None]),
            "kinds": times.kinds,
            "jumps": times.jumps[None],
            "step_times": self.step_times,
        }

    @property
    def _event_width(self) -> int:
        """Numbers of an event: EVENT_COLUMNS, state, signals, derivatives."""
        state = self.output.links * POSE_AND_TWIST.count
        return ws.EVENT_COLUMNS + state + signals_width(self.plan) + self._derivatives

    @property
    def _derivatives(self) -> int:
        """Number of derivatives at an event."""
        return len(self.output.end_derivatives)

    @cached_property
    def _events(self) -> list[Array]:
        """Events in the order of their detection, [event][number], an array for each call."""
        return []

    @cached_property
    def _counter(self) -> NDArray[np.int64]:
        return np.zeros(2, dtype=np.int64)

    def memory_of_thread(self) -> dict[str, NDArray[Any]]:
        """Workspace of a thread: results of its lanes at one time, and work arrays."""
        plan, lanes, width = self.plan, self.plan.lanes, self._event_width
        output = Output.empty(plan, lanes, ONE_TIME, with_state=False)
        watched = len(events_of(plan))
        room = max(EVENT_ROOM // width, 2 * ws.most_events(lanes, watched)) if watched else 0
        arrays = {
            "carried": np.zeros((carried_rows(plan), lanes)),
            **super().memory_of_thread(),
            "rows": np.zeros((ws.ROWS, lanes)),
            "request": np.zeros((1, ws.REQUEST)),
            "shown": np.zeros((width - ws.EVENT_COLUMNS - self._derivatives, lanes)),
            "sides": np.zeros((watched, lanes)),
            "values": np.zeros((ws.SAMPLES + 2, watched, lanes)),
            "samples": np.zeros((samples.ROWS, len(observables_of(plan)), lanes)),
            "dips": np.zeros((2, watched, lanes)),
            "roundings": np.zeros((watched, lanes)),
            "events": np.zeros((1 + room, width)),
        }
        arrays["rows"][ws.TERMINATION] = IDLE
        arrays |= output.arrays
        return arrays | copies(arrays, self.output)

    @cached_property
    def _jobs(self) -> NDArray[Any]:
        """Job records, [thread][batch, workspace]."""
        plan, times = self.plan, self.times
        numbers = {
            "stop": self.inputs.count, "differ": self.inputs.differ,
            "rows_per_link": self.output.rows, "watched": len(events_of(plan)),
            "lane_column": lane_column(plan), "seed": times.seed, "keeps_sides": times.keeps_sides,
            **times.span._asdict(), **times.tolerances._asdict(),
        }  # fmt: skip
        batch = job_of(self.arrays, numbers)
        records = [batch + job_of(self.arrays | own, numbers) for own in self.memories]
        jobs = jobs_of(*records, per_thread=2)
        arguments = (self.arrays["inputs"][0], self._counter, jobs[0])
        jobs["serve"] = entry_of(ws.serve, ws.SERVICE, *arguments)
        if events_of(plan):
            jobs["watch"] = entry_of(watch, ws.SERVICE, *arguments)
        return jobs

    def _take_events(self) -> None:
        """Move the events from the workspaces to the run's list.

        Raises MemoryLimitError if their table, whose size no one knows before, would not fit.
        """
        for workspace in self.memories:
            rows = workspace["events"]
            count = int(rows[0, 0])
            if count:
                self._events.append(rows[1 : 1 + count].copy())
                rows[0, 0] = 0.0
                size = COPIES * sum(each.nbytes for each in self._events)
                remedy = "take fewer trajectories at a time, a shorter run, or a rarer event"
                require_memory(size, "the table of the events so far", remedy)

    def _collect_exceptions(self) -> None:
        """Collect the exceptions of ended trajectories, each one once."""
        flags = self.output.summary[SUMMARY.index("raised")]
        self.output.collect_flags(np.nan_to_num(flags), 0)
        flags[flags > calls.COLLECTED] = calls.COLLECTED

    def _any_active(self) -> bool:
        return any((own["rows"][ws.ACTIVE] > 0.0).any() for own in self.memories)

    def _done(self) -> float:
        """Return the number of finished trajectories plus the fractions of the running ones."""
        waiting, running, share = 0.0, 0, 0.0
        time = carried_columns(self.plan.code)["clock"].start  # row of the clock's t
        span = self.times.span
        for workspace in self.memories:
            request = workspace["request"][0]
            waiting += max(request[ws.SHARE_END] - request[ws.SHARE], 0.0)
            active = workspace["rows"][ws.ACTIVE] > 0.0
            running += int(np.count_nonzero(active))
            t = workspace["carried"][time, active]
            share += float(((t - span.start) / (span.end - span.start)).sum())
        return min(int(self._counter[0]), self.inputs.count) - waiting - running + share
