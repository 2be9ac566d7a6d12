"""Running a batch whose lanes have a clock each: adaptive steps, output, events, controls."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from struct import Struct
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lierb.compiler.code import compiled
from lierb.compiler.entries import entry_of
from lierb.kernels.loops.event_search import watch
from lierb.kernels.loops.job import ARRAYS, RESUMED, UNSEEN
from lierb.kernels.loops.lanes import integrate_lanes, integrate_lanes_on_threads
from lierb.kernels.loops.record import carried_columns, lane_column
from lierb.kernels.loops.workspace import (
    ACTIVE,
    EVENT_COLUMNS,
    FATE,
    LANE_JOB,
    OWN_ARRAYS,
    SERVICE,
    SHARE,
    SHARE_END,
    TOLD,
    desk_of,
    room_of_step,
    serve,
)
from lierb.kernels.stepping.lane_clock import Span
from lierb.kernels.stepping.step_size import Tolerances
from lierb.kernels.systems.layout import POSE_AND_TWIST
from lierb.kernels.systems.measures import SUMMARY
from lierb.kernels.systems.plan import AnyPlan
from lierb.kernels.systems.signals import events_of, signals_width
from lierb.kernels.tracing import calls
from lierb.runs.inputs import Inputs
from lierb.runs.output import Output
from lierb.runs.threads import CALL_SECONDS, running, threads_for
from lierb.support.arrays import Array
from lierb.support.forks import check_threads
from lierb.support.memory import require_memory
from lierb.support.progress import Progress, reporter

FIRST_TURNS = 200  # of a thread's first call, to find out how fast a plan runs
EVENT_ROOM = 4096  # on a desk, at the least, between two calls
SHARES = 1000  # of a trajectory's time, for the progress
COPIES = 4  # of events, while they become a table
IDLE = 1.0  # the fate of a lane that nobody has been in
_CODES = {"i": "q", "f": "d", "V": "4q"}
_PACKED = Struct("=" + "".join(_CODES[LANE_JOB[name].kind] for name in LANE_JOB.names or ()))


@dataclass(frozen=True)
class LaneTime:
    """When a run is, how its steps are chosen, and what is looked at.

    save_at : s, of the rows of its history.   kinds : [direction, is terminal][event].
    seed, numbers : of the noise, and each trajectory's own.
    steps : of the rows of a history of every so many fixed steps.
    jumps : times at which forces may jump, s: every step that meets one ends there.
    """

    span: Span
    tolerances: Tolerances
    save_at: Array
    kinds: Array
    seed: int = 0
    numbers: Array = field(default_factory=lambda: np.zeros(0))
    steps: NDArray[np.int64] | None = None
    jumps: Array = field(default_factory=lambda: np.zeros(0))

    @property
    def saved_rows(self) -> int:
        return len(self.save_at)

    def saved_steps(self) -> NDArray[np.int64]:
        """Of fixed steps, or numbers of the rows."""
        return np.arange(self.saved_rows) if self.steps is None else self.steps

    def saved_times(self) -> Array:
        return self.save_at

    @property
    def end(self) -> float:
        return self.span.end


class _OneTime(NamedTuple):
    """What a desk's arrays are as large as."""

    saved_rows: int = 1
    end: float = 0.0

    def saved_steps(self) -> NDArray[np.int64]:
        return np.zeros(1, np.int64)

    def saved_times(self) -> Array:
        return np.zeros(1)


class Desk(NamedTuple):
    """A thread's: one time of as many trajectories as it has lanes, and what they carry."""

    output: Output
    arrays: dict[str, NDArray]


class Events(NamedTuple):
    """Of a run, in the order in which they were found: [event][EVENT_COLUMNS, state, signals]."""

    rows: list[Array]
    width: int

    def add(self, found: Array) -> None:
        """Raise MemoryLimitError once there are more than a table has room for: nobody can know
        before how many there will be.
        """
        self.rows.append(found.copy())
        size = COPIES * sum(each.nbytes for each in self.rows)
        remedy = "take fewer trajectories at a time, a shorter run, or an event that is rarer"
        require_memory(size, "the table of the events so far", remedy)

    @property
    def table(self) -> Array:
        """Sorted by trajectory and time, those of one time as they were found; without those that
        come after an end.
        """
        found = np.concatenate([np.zeros((0, self.width)), *self.rows])
        found = found[found[:, 0] >= 0]
        order = np.lexsort((found[:, 2], found[:, 0]))
        return np.ascontiguousarray(found[order])


@dataclass(frozen=True)
class LaneRun:
    """What all calls of the driver have in common."""

    plan: AnyPlan
    inputs: Inputs
    times: LaneTime
    output: Output
    threads: int
    events: Events

    @cached_property
    def _arrays(self) -> dict[str, NDArray]:
        """Of the batch."""
        places = self.inputs.places(self.plan)
        nothing = np.empty((1, 1))
        return {
            "places": places,
            "varying": np.flatnonzero(places[:, 1])[None],
            "inputs": np.zeros((self.threads, len(places), self.plan.lanes)),
            "carried": nothing,
            "desk": nothing,
            "told": nothing,
            "save_at": self.times.save_at[None],
            "numbers": np.ascontiguousarray(self.times.numbers[None]),
            "events": nothing,
            "kinds": self.times.kinds,
            "jumps": self.times.jumps[None],
            **self.output.arrays,
        }

    @cached_property
    def _desks(self) -> list[Desk]:
        return [self._desk() for _ in range(self.threads)]

    def _desk(self) -> Desk:
        plan, lanes = self.plan, self.plan.lanes
        output = Output.empty(plan, lanes, _OneTime(), with_state=False)
        rows = np.zeros((desk_of(plan).count, lanes))
        rows[FATE] = IDLE
        watched = len(events_of(plan))
        room = max(EVENT_ROOM, 2 * room_of_step(lanes, watched)) if watched else 0
        arrays = {
            "carried": np.zeros((carried_columns(plan), lanes)),
            "desk": rows,
            "told": np.zeros((1, TOLD)),
            "events": np.zeros((1 + room, self.events.width)),
        }
        return Desk(output, arrays | output.arrays)

    @cached_property
    def _counter(self) -> NDArray[np.int64]:
        return np.zeros(2, dtype=np.int64)

    @cached_property
    def _jobs(self) -> NDArray:
        """[thread][of the batch, of its desk], but for what differs from call to call."""
        whole = self._record(self._arrays)
        records = [whole + self._record(self._arrays | desk.arrays) for desk in self._desks]
        return np.frombuffer(bytearray(b"".join(records)), LANE_JOB).reshape(self.threads, 2)

    def call(self, begin: int, turns: int, is_first: bool) -> float:
        """So many iterations of every thread's lanes; the seconds they took, compilation apart."""
        jobs, counter = self._jobs, self._counter
        jobs["begin"], jobs["turns"] = (begin, 0 if is_first else 1), turns
        given = (self._arrays["inputs"][0], counter, jobs[0])
        jobs["serve"] = entry_of(serve, SERVICE, *given)
        if events_of(self.plan):
            jobs["watch"] = entry_of(watch, SERVICE, *given)
        entry = entry_of(integrate_lanes, self.plan, *given)
        loop = (entry, counter, self.threads, jobs)
        run = compiled(integrate_lanes_on_threads, *loop)
        with running(self.threads):
            began = time.perf_counter()
            run(*loop)
            return max(time.perf_counter() - began, 1e-6)

    def _record(self, arrays: dict[str, NDArray]) -> bytes:
        numbers: list[int] = []
        for name in (*ARRAYS, *OWN_ARRAYS):
            array = arrays[name]
            extents = array.shape + (1,) * (3 - array.ndim)
            numbers += (array.__array_interface__["data"][0], *extents)
        plan, columns = self.plan, desk_of(self.plan)
        sizes = (
            0, self.inputs.count, 0, 0, self.inputs.differ, self.output.rows,
            len(events_of(plan)), columns["sides"].start, columns["values"].start,
            columns["shown"].start, lane_column(plan), 0, 0,
        )  # fmt: skip
        times = self.times
        return _PACKED.pack(*numbers, *sizes, times.seed, *times.span, *times.tolerances)

    def look_at_starts(self) -> None:
        """Whether trajectories start on their joints, all of them."""
        self.call(UNSEEN, 0, True)
        self._counter[0] = 0

    def take_events(self) -> None:
        """Off the desks."""
        for desk in self._desks:
            rows = desk.arrays["events"]
            count = int(rows[0, 0])
            if count:
                self.events.add(rows[1 : 1 + count])
                rows[0, 0] = 0.0

    def hear(self) -> None:
        """Take what functions have raised in trajectories that have ended, once of each."""
        marks = self.output.summary[SUMMARY.index("raised")]
        self.output.hear_marks(self.plan, np.nan_to_num(marks), 0)
        marks[marks > calls.HEARD] = calls.HEARD

    def to_do(self) -> bool:
        """Whether a trajectory is on its way."""
        return any((desk.arrays["desk"][ACTIVE] > 0.0).any() for desk in self._desks)

    def done(self) -> float:
        """Trajectories so far, those on their way by their time."""
        waiting, going, share = 0.0, 0, 0.0
        first = desk_of(self.plan)["clock"].start
        span = self.times.span
        for desk in self._desks:
            rows, told = desk.arrays["desk"], desk.arrays["told"][0]
            waiting += max(told[SHARE_END] - told[SHARE], 0.0)
            on_way = rows[ACTIVE] > 0.0
            going += int(np.count_nonzero(on_way))
            share += float(((rows[first, on_way] - span.start) / (span.end - span.start)).sum())
        return min(int(self._counter[0]), self.inputs.count) - waiting - going + share


def integrate(
    plan: AnyPlan,
    inputs: Inputs,
    times: LaneTime,
    with_state: bool = False,
    threads: int | None = None,
    progress: Progress = None,
    check: Callable[[Array, int], bool] | None = None,
) -> Output:
    """Run every trajectory to its end; arguments as of `lierb.runs.engine.integrate`."""
    check_threads()
    output = Output.empty(plan, inputs.count, times, with_state)
    used = threads_for(threads, -(-inputs.count // plan.lanes))
    if times.saved_rows:  # of what comes after an end
        for array in (output.history, *output.states, output.multipliers, output.reactions):
            array.fill(np.nan)
    output.summary[SUMMARY.index("raised")] = calls.CLEAR  # `hear` looks at those on their way, too
    width = EVENT_COLUMNS + output.links * POSE_AND_TWIST.count + signals_width(plan)
    run = LaneRun(plan, inputs, times, output, used, Events([], width))
    if check is not None:
        run.look_at_starts()
        check(output.starts(0, inputs.count), 0)
    begin = RESUMED if inputs.state is not None else 0
    with reporter(progress, inputs.count * SHARES, "trajectories") as report:
        for done in _run(run, begin):
            report(int(done * SHARES))
    return replace(output, events=run.events.table)


def _run(run: LaneRun, begin: int) -> Iterator[float]:
    turns, is_first = FIRST_TURNS, True
    while is_first or run.to_do():
        seconds = run.call(begin, turns, is_first)
        is_first = False
        run.take_events()
        if run.plan.calls_functions:
            run.hear()
        turns = max(int(turns * CALL_SECONDS / seconds), 1) if seconds > 0.0 else turns
        turns = min(turns, 1 << 30)
        yield run.done()
