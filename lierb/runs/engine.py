"""Running a batch: where its numbers are, the driver called in short calls, progress."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property, lru_cache
from textwrap import shorten
from typing import NamedTuple, Protocol
from weakref import WeakKeyDictionary

import numba
import numpy as np
from numpy.typing import NDArray

from lierb.arrays import Array, is_whole
from lierb.compiler import calls
from lierb.compiler.code import compiled
from lierb.compiler.entries import entry_of
from lierb.errors import ArgumentError, told
from lierb.kernels.functions.function import line_that_raised
from lierb.kernels.stepping.clock import Clock, time_of
from lierb.kernels.stepping.driver import (
    BODIES,
    POSES,
    RESUMED,
    TWISTS,
    UNSEEN,
    carried_columns,
    end_columns,
    history_columns,
    integrate_blocks,
    integrate_on_threads,
    job_of,
    lane_column,
    marks_column,
    summary_columns,
)
from lierb.kernels.stepping.layout import LANE_SUMMARY, POSE_AND_TWIST, Columns, Field
from lierb.kernels.stepping.measures import KEPT, SUMMARY
from lierb.kernels.stepping.plan import AnyPlan
from lierb.kernels.stepping.status import OK
from lierb.kernels.stepping.systems import system_of
from lierb.mechanism import Mechanism
from lierb.model import Problem
from lierb.runs.forks import check_threads
from lierb.runs.memory import room
from lierb.runs.progress import Progress, reporter

CLOSED = np.full((4, 4), np.nan)  # the pose that stands for the joint's closed one
ZEROS = np.zeros(1)  # where numbers are read that nobody asks for

# In one chunk at the least: what is carried of them stays in the cache beside the state.
CHUNK_BODIES = 4096
# One call of the driver shall last about this long: short enough for Ctrl-C and a moving bar, long
# enough that the 30 µs of a call do not show, nor the half microsecond that it takes to bring a
# body into the registers and out again.
CALL_SECONDS = 0.15
FIRST_CALL_BLOCK_STEPS = 20_000  # about 10 ms, to find out how fast a plan runs
MESSAGE_LENGTH = 200  # of an exception's words, in one line


Places = NDArray[np.int64]  # [column][address of the first trajectory's number, bytes to the next]


class Times(Protocol):
    """When a run is, and which times of it are saved."""

    @property
    def saved_rows(self) -> int: ...
    def saved_steps(self) -> NDArray[np.int64]: ...
    def saved_times(self) -> Array: ...
    @property
    def end(self) -> float: ...


class _Layout(NamedTuple):
    """Where a problem's numbers are.

    differ : whether any of them are others for other bodies.
    arrays : which shall outlive `places`.
    """

    places: Places
    differ: bool
    arrays: tuple[Array, ...]


_layouts: WeakKeyDictionary[Problem | Mechanism, _Layout] = WeakKeyDictionary()


def _places_of(field: Field, array: Array) -> Places:
    """Where the numbers of a field are, in an array with an item for every body or one for all."""
    ahead = array.ndim - len(field.shape)
    places = np.empty((field.width, 2), dtype=np.int64)
    places[:, 0] = _offsets(field, array.strides[ahead:])
    places[:, 0] += array.__array_interface__["data"][0]
    places[:, 1] = 0 if _is_shared(field, array) else array.strides[0]
    return places


def _is_shared(field: Field, array: Array) -> bool:
    """Whether it has one item for all bodies."""
    return array.ndim == len(field.shape) or len(array) == 1


def _nowhere(count: int) -> Places:
    """Of so many columns that nobody asks for: a zero, for all bodies."""
    return np.full((count, 2), (ZEROS.ctypes.data, 0), dtype=np.int64)


@lru_cache(64)
def _offsets(field: Field, strides: tuple[int, ...]) -> NDArray[np.int64]:
    """Of a field's numbers in an item, in bytes."""
    offsets = np.zeros((), dtype=np.int64)
    for size, stride in zip(field.shape, strides, strict=True):
        offsets = offsets[..., None] + stride * np.arange(size)
    return offsets.ravel()[list(field.entries)] if field.entries else offsets.ravel()


def _layout(problem: Problem | Mechanism, columns: Columns) -> _Layout:
    """Found once: of a call for one body it takes a tenth of the time."""
    if problem not in _layouts:
        arrays = numbers_of(problem)
        places = _nowhere(columns["state"].start)
        for field, part in columns:
            if field.name in arrays:
                places[part] = _places_of(field, arrays[field.name])
        _layouts[problem] = _Layout(places, bool(places[:, 1].any()), tuple(arrays.values()))
    return _layouts[problem]


def numbers_of(problem: Problem | Mechanism) -> dict[str, Array]:
    """What a problem has of the driver's inputs, by field."""
    if isinstance(problem, Mechanism):
        return problem.quantities
    parameters = {
        f"{number}.{name}": element.parameters[name]
        for number, element in enumerate(problem.elements)
        for name in element.kind.shapes
    }
    return {**problem.quantities, **parameters, "pose": CLOSED}  # unless a start has others


@dataclass(frozen=True)
class Inputs:
    """Everything about every body, where the user has it.

    columns : what is read, of the plan's system.
    starts : arrays of poses, (4, 4) or (n, 4, 4), and of twists, (6,) or (n, 6), by field.
    time : s, of the start.
    state : to start from instead of pose and twist, if any: the driver's own, `end_columns` of the
        plan, [column][body or 1].
    """

    problem: Problem | Mechanism
    columns: Columns
    starts: dict[str, Array]
    count: int
    time: float = 0.0
    state: Array | None = None

    @property
    def differ(self) -> int:
        """What does from trajectory to trajectory: TWISTS, POSES or BODIES."""
        if _layout(self.problem, self.columns).differ:
            return BODIES
        are_one = self.state is not None or all(
            _is_shared(self.columns.field(name), array)
            for name, array in self.starts.items()
            if name != "twist"
        )
        return TWISTS if are_one else POSES

    def places(self, plan: AnyPlan) -> Places:
        """Of every column: a run that goes on asks for no pose and twist, others for no state."""
        columns, places = self.columns, _layout(self.problem, self.columns).places.copy()
        if self.state is None:
            for name, array in self.starts.items():
                places[columns[name]] = _places_of(columns.field(name), array)
            return places
        at = columns["state"].start
        of_state = _nowhere(columns.count - at)
        for row, column in zip(self.state, end_columns(plan), strict=True):
            of_state[column] = row.ctypes.data, row.strides[0] if len(row) > 1 else 0
        return np.concatenate([places, of_state])

    def numbers(self, body: int) -> list[np.float64]:
        """Of one body, in the order of the columns, as far as they are there without a run."""
        arrays, found = numbers_of(self.problem) | self.starts, []
        for field, _ in self.columns:
            if field.name in arrays:
                array = arrays[field.name]
                which = 0 if _is_shared(field, array) else body
                item = array.reshape(-1, *field.shape)[which].ravel()
                found += list(item if field.entries is None else item[list(field.entries)])
        return found


@dataclass(frozen=True)
class Output:
    """Results of a run, as they become Arrow columns.

    clock : the times of the run.
    summary : [SUMMARY, then KEEPS of each observable][body].
    history : [measure, then observable, then error of a joint][time][body].
    states : [link, time][body][component]; if not recorded, of the end alone.
    multipliers : [time][body][row of any joint].   reactions : [joint, time][body][component].
    ends : the driver's own state at the end, [column][body], the columns being `end_columns`.
    raised : what a function of the user's has raised, in words, by body: of the first such body.
    plan : of the run.
    events : [event][trajectory, which, t, state of every link, states and outputs], if there are
        any; sorted by the first and third.
    """

    plan: AnyPlan
    clock: Times
    summary: Array
    history: Array
    states: tuple[Array, ...]  # in the order of POSE_AND_TWIST
    multipliers: Array
    reactions: Array
    ends: Array
    raised: dict[int, str]
    events: Array | None = None

    @classmethod
    def empty(cls, plan: AnyPlan, count: int, clock: Times, with_state: bool) -> Output:
        shapes = _shapes(plan, count, clock.saved_rows, with_state)
        summary, history, *states, multipliers, reactions, ends = map(room, shapes)
        return cls(plan, clock, summary, history, tuple(states), multipliers, reactions, ends, {})

    @property
    def links(self) -> int:
        return system_of(self.plan).links

    @staticmethod
    def size(plan: AnyPlan, count: int, rows: int, with_state: bool) -> int:
        """Bytes of one with so many saved rows, by whole numbers without an end."""
        return 9 * count + 8 * sum(map(math.prod, _shapes(plan, count, rows, with_state)))

    @cached_property
    def arrays(self) -> dict[str, Array]:
        """As the driver takes them."""
        states = {
            field.name: a for field, a in zip(POSE_AND_TWIST.fields, self.states, strict=True)
        }
        names = ("summary", "history", "multipliers", "reactions", "ends")
        return states | {name: getattr(self, name) for name in names}

    @property
    def rows(self) -> int:
        """Of the states, for each link."""
        return len(self.states[0]) // self.links

    @property
    def state(self) -> tuple[Array, ...]:
        """At the end, in memory apart from the history's: [body][component]."""
        return self.state_of(0)

    def state_of(self, link: int) -> tuple[Array, ...]:
        """The same of one link."""
        last = self.rows * (link + 1) - 1
        return tuple(a[last].copy() if self.rows > 1 else a[last] for a in self.states)

    @property
    def kept(self) -> Array:
        """[KEPT][body]."""
        return self.summary[: len(KEPT)]

    @property
    def observed(self) -> Array:
        """KEEPS of each observable: [column][body]."""
        return self.summary[SUMMARY.count : lane_column(self.plan)]  # then JOINT_KEPT of each joint

    @cached_property
    def status(self) -> NDArray[np.int8]:
        """By trajectory."""
        codes: NDArray[np.int8] = self.summary[SUMMARY.index("status")].astype(np.int8)
        return codes

    @cached_property
    def t(self) -> Array:
        """Of the end of each trajectory, s: [body]."""
        if not isinstance(self.clock, Clock):
            return self.of_lanes("t")
        t = np.full(len(self.status), self.clock.end)
        if (failed := self.status != OK).any():
            t[failed] = time_of(self.clock, self.summary[SUMMARY.index("failed_step"), failed])
        return t

    def of_lanes(self, name: str) -> Array:
        """A column of LANE_SUMMARY."""
        found: Array = self.summary[lane_column(self.plan) + LANE_SUMMARY.index(name)]
        return found

    @property
    def signals(self) -> Array:
        """The user's states and outputs at the end: [number][body]."""
        return self.summary[lane_column(self.plan) + LANE_SUMMARY.count :]

    def starts(self, first: int, stop: int) -> Array:
        """1 for each of these bodies that starts on its joint, else 0."""
        found: Array = self.summary[SUMMARY.index("starts"), first:stop]
        return found

    def hear(self, plan: AnyPlan, chunk: Chunk, is_last: bool) -> None:
        """Take what functions have raised in a call of the driver, and free its memory."""
        count = chunk.stop - chunk.start
        at_end = self.summary[SUMMARY.index("raised"), chunk.start : chunk.stop]
        self.hear_marks(
            plan, at_end if is_last else chunk.carried[marks_column(plan), :count], chunk.start
        )

    def hear_marks(self, plan: AnyPlan, marks: Array, first: int) -> None:
        """The same of trajectories from `first` on."""
        found = np.unique(np.abs(marks)).astype(np.int64).tolist()
        errors = {mark: calls.exception_of(mark) for mark in found if mark > calls.HEARD}
        for body in np.flatnonzero(marks > calls.HEARD)[:1].tolist():
            if first + body < min(self.raised, default=math.inf):
                self.raised.clear()
                error = errors[int(marks[body])]
                self.raised[first + body] = exception_told(plan, error)


@lru_cache(64)
def _shapes(plan: AnyPlan, count: int, rows: int, with_state: bool) -> tuple[tuple[int, ...], ...]:
    """Of an Output's arrays."""
    system = system_of(plan)
    # The end is no row of the history where lanes have clocks of their own.
    states = ((rows + plan.has_lane_clocks) if with_state else 1) * system.links
    return (
        (summary_columns(plan), count),
        (history_columns(plan), rows, count),
        *((states, count, field.width) for field in POSE_AND_TWIST.fields),
        (rows * plan.multipliers, count, len(plan.rows)),
        (rows * plan.reaction * max(len(system.joints), 1), count, 6),
        (len(end_columns(plan)), count),
    )


class Chunk(NamedTuple):
    """Bodies start … stop, which are integrated together.

    carried : [column][body, padded to full blocks], if it takes more than one call.
    """

    start: int
    stop: int
    carried: Array


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


def exception_told(plan: AnyPlan, error: Exception) -> str:
    """What a function of the user's that runs body by body has raised, in words."""
    functions = [f for element in plan.elements for f in element.functions if not f.is_traced]
    names = " or ".join(dict.fromkeys(f.name for f in functions))
    message = shorten(str(error), MESSAGE_LENGTH)
    what = f"{type(error).__name__}: {message}" if message else type(error).__name__
    line = line_that_raised(error, functions)
    return f"{names} raised {what}{f' ({line})' if line else ''}"


# ---- threads -----------------------------------------------------------------------------------

_driver_lock = threading.Lock()  # Numba's workqueue layer aborts the process when entered twice


def threading_layer() -> str:
    """Numba's threading layer, its threads started."""
    check_threads()
    with _driver_lock:
        numba.get_num_threads()  # starts them
    return str(numba.threading_layer())


def threads_for(count: int | None, blocks: int) -> int:
    """How many threads a call uses: as many as asked for, but no more than it has blocks."""
    most = numba.config.NUMBA_NUM_THREADS
    if count is None:
        count = numba.get_num_threads()
    if not (is_whole(count) and 1 <= count <= most):
        raise ArgumentError(
            f"threads={told(count)}; expected 1 … {most}, the threads that Numba started with"
        )
    return min(int(count), blocks)


@contextmanager
def running(threads: int) -> Iterator[None]:
    """Where compiled code runs on so many threads."""
    with _driver_lock, _thread_mask(threads), np.errstate(all="ignore"):
        yield


@contextmanager
def _thread_mask(count: int) -> Iterator[None]:
    """This Python thread's number of Numba threads set, and set back."""
    before = numba.get_num_threads()
    if count != before:
        numba.set_num_threads(count)
    try:
        yield
    finally:
        if count != before:
            numba.set_num_threads(before)
