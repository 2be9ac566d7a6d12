"""Running a batch: bodies packed into columns, the driver called in short calls, progress."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from textwrap import shorten
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

import numba
import numpy as np
from numpy.typing import NDArray

from lierb.arrays import Array, is_whole
from lierb.compiler import calls
from lierb.compiler.code import compiled
from lierb.compiler.entries import entry_of
from lierb.compiler.tags import Sources
from lierb.errors import ArgumentError, told
from lierb.kernels.functions.function import line_that_raised
from lierb.kernels.stepping.driver import (
    CARRIED_COLUMNS,
    INPUT_COLUMNS,
    INPUT_SLICES,
    MARKS,
    OK,
    RAISED_AT_END,
    RESUMED,
    STARTS,
    STATE_COLUMNS,
    SUMMARY_COLUMNS,
    UNSEEN,
    end_columns,
    error_columns,
    input_columns,
    integrate_block,
    integrate_blocks,
)
from lierb.kernels.stepping.plan import Plan
from lierb.model import Problem
from lierb.runs.forks import check_threads
from lierb.runs.progress import Progress, reporter

SUMMARY_SCALARS = (
    "position_error_max", "rotation_error_max", "velocity_error_max", "rotation_rate_error_max",
    "orthogonality_error_max", "energy_drift_max", "position_error_final", "rotation_error_final",
    "work_final",
)  # fmt: skip
STATE_WIDTHS = {"rotation": 9, "position": 3, "omega": 3, "v": 3}

SOURCES = Sources()
CLOSED = np.full((4, 4), np.nan)  # the pose that stands for the joint's closed one

# Bodies in one chunk: about 1 kB each, so that a chunk stays in the cache beside the state.
CHUNK_BODIES = 4096
# One call of the driver shall last about this long: short enough for Ctrl-C and a moving bar, long
# enough that the 30 µs of a call do not show, nor the half microsecond that it takes to bring a
# body into the registers and out again.
CALL_SECONDS = 0.15
FIRST_CALL_BLOCK_STEPS = 20_000  # about 10 ms, to find out how fast a plan runs
MESSAGE_LENGTH = 200  # of an exception's words, in one line


@dataclass(frozen=True)
class Grid:
    """The times of a run: `steps` steps of `dt` s, measured and saved every so many (0: never).

    origin, first_step : the start is `first_step` steps after `origin`, s.
    """

    dt: float
    steps: int
    measure_every: int
    save_every: int
    origin: float = 0.0
    first_step: int = 0

    def time(self, step: Any) -> Any:
        """Of a step, or of an array of steps, s; to the bit as the driver has it."""
        return self.origin + self.dt * (self.first_step + step)

    @property
    def saved_rows(self) -> int:
        return -(-self.steps // self.save_every) + 1 if self.save_every else 0

    def saved_steps(self) -> NDArray[np.int64]:
        return np.minimum(np.arange(self.saved_rows) * self.save_every, self.steps)


class Field(NamedTuple):
    """Where some of the driver's input columns come from."""

    columns: slice
    array: Array  # an item for every body, or one for all of them
    shape: tuple[int, ...] = ()  # of an item

    @property
    def is_shared(self) -> bool:
        return self.array.ndim == len(self.shape) or len(self.array) == 1

    def put(self, packed: Array, start: int, stop: int) -> None:
        """Bodies start … stop, the last one repeated, or what all share."""
        place = packed[self.columns].reshape(*self.shape, -1)
        if self.is_shared:
            place[...] = self.array.reshape(*self.shape, 1)
            return
        items = np.moveaxis(self.array[start:stop], 0, -1)
        place[..., : stop - start] = items
        place[..., stop - start :] = items[..., -1:]


def _pose_fields(name: str, poses: Array) -> tuple[Field, Field]:
    first = INPUT_SLICES[name].start
    rotations, places = poses[..., :3, :3], poses[..., :3, 3]
    return (
        Field(slice(first, first + 9), rotations, (3, 3)),
        Field(slice(first + 9, first + 12), places, (3,)),
    )


def _problem_fields(problem: Problem) -> Iterator[Field]:
    body, joint = problem.body, problem.joint
    yield Field(INPUT_SLICES["mass"], body.mass)
    yield Field(INPUT_SLICES["inertia"], body.inertia, (3, 3))
    yield Field(INPUT_SLICES["com"], body.com, (3,))
    yield Field(INPUT_SLICES["gravity"], problem.gravity, (3,))
    yield from _pose_fields("ground_frame", joint.ground_frame)
    yield from _pose_fields("body_frame", joint.body_frame)
    yield Field(INPUT_SLICES["pitch"], joint.pitch)
    yield Field(INPUT_SLICES["length"], joint.length)
    yield from _pose_fields("pose", CLOSED)  # unless a start has others
    first = INPUT_COLUMNS
    for element in problem.elements:
        for name, shape in element.kind.shapes.items():
            last = first + math.prod(shape)
            yield Field(slice(first, last), element.parameters[name], shape)
            first = last


_layouts: WeakKeyDictionary[Problem, tuple[Array, list[Field]]] = WeakKeyDictionary()


def _layout(problem: Problem) -> tuple[Array, list[Field]]:
    """The columns that all bodies of a problem share, [column][1], and where the others come from.

    Worked out once: of a call for one body it takes a tenth of the time.
    """
    if problem not in _layouts:
        fields = list(_problem_fields(problem))
        shared = np.zeros((input_columns(problem.kinds), 1))
        for field in fields:
            if field.is_shared:
                field.put(shared, 0, 1)
        _layouts[problem] = shared, [field for field in fields if not field.is_shared]
    return _layouts[problem]


@dataclass(frozen=True)
class Inputs:
    """Everything about every body, as given; packed chunk by chunk, never copied as a whole.

    poses : (4, 4) or (n, 4, 4); None for the closed joint.   twists : (6,) or (n, 6).
    time : s, of the start.
    state : to start from instead of pose and twist, if any: the driver's own, `end_columns` of the
        plan, [column][body or 1].
    """

    problem: Problem
    poses: Array | None
    twists: Array
    count: int
    time: float = 0.0
    state: Array | None = None

    def packed(self, start: int, stop: int, packed: Array, is_new: bool = True) -> Array:
        """Bodies start … stop as [column][body], the last one repeated to fill `packed`.

        is_new : whether `packed` lacks even the columns that all bodies share.
        """
        shared, fields = _layout(self.problem)
        if is_new:
            packed[:] = shared
        for field in (*fields, *self._start):
            if is_new or not field.is_shared:
                field.put(packed, start, stop)
        return packed

    def put_state(self, plan: Plan, chunk: Chunk) -> None:
        """Carry the state to start from."""
        assert self.state is not None
        width = chunk.stop - chunk.start
        is_shared = self.state.shape[1] == 1
        own = self.state if is_shared else self.state[:, chunk.start : chunk.stop]
        columns = list(end_columns(plan))
        chunk.carried[:STATE_COLUMNS] = 0.0
        chunk.carried[columns, :width] = own
        chunk.carried[columns, width:] = own[:, -1:]

    @cached_property
    def _start(self) -> tuple[Field, ...]:
        twists = Field(INPUT_SLICES["twist"], self.twists, (6,))
        return (twists, *_pose_fields("pose", self.poses)) if self.poses is not None else (twists,)

    @property
    def columns(self) -> int:
        """Numbers of a body."""
        return input_columns(self.problem.kinds)


# Of the last run, for the next: memory fresh from the system takes as long as a dozen steps.
_spare: list[Array] = []


@dataclass(frozen=True)
class Chunk:
    """Bodies start … stop while they are integrated: [column][body, padded to full blocks]."""

    start: int
    stop: int
    inputs: Array
    carried: Array
    summary: Array
    memory: Array  # that the three are parts of

    @classmethod
    def of(cls, inputs: Inputs, start: int, lanes: int, spent: Chunk | None = None) -> Chunk:
        """The bodies from `start` on, in the memory of a chunk that is not needed any more."""
        stop = min(start + CHUNK_BODIES, inputs.count)
        width = -(-(stop - start) // lanes) * lanes
        if spent is not None and spent.inputs.shape[1] == width:
            inputs.packed(start, stop, spent.inputs, is_new=False)
            return replace(spent, start=start, stop=stop)
        rows = inputs.columns, inputs.columns + CARRIED_COLUMNS
        count = rows[1] + SUMMARY_COLUMNS
        memory = spent.memory if spent is not None else _memory(count * width)
        columns = memory[: count * width].reshape(count, width)
        packed = inputs.packed(start, stop, columns[: rows[0]])
        return cls(start, stop, packed, columns[rows[0] : rows[1]], columns[rows[1] :], memory)

    @property
    def found(self) -> Array:
        """`summary` without the padding."""
        return self.summary[:, : self.stop - self.start]

    @property
    def starts(self) -> Array:
        """1 for a body that starts on its joint, else 0."""
        starts: Array = self.found[STARTS]
        return starts


def _memory(size: int) -> Array:
    """So many numbers or more, uninitialised."""
    with suppress(IndexError):  # none is left, or another thread was faster
        if (spare := _spare.pop()).size >= size:
            return spare
    return np.empty(size)


@dataclass(frozen=True)
class Output:
    """Results of a run, as they become Arrow columns.

    status, t (s), scalars : [body].
    errors : [column][time][body].   states, multipliers, reactions : [time][body][component].
    ends : the driver's own state at the end, [column][body], the columns being `end_columns`.
    raised : what a function of the user's has raised, in words, by body: of the first such body.
    """

    status: NDArray[np.int8]
    t: Array
    scalars: Array  # in the order of SUMMARY_SCALARS
    errors: Array
    states: tuple[Array, ...]  # in the order of STATE_WIDTHS; if not recorded, the last row alone
    multipliers: Array
    reactions: Array
    ends: Array
    raised: dict[int, str]

    @classmethod
    def empty(cls, plan: Plan, count: int, grid: Grid, with_state: bool) -> Output:
        shapes = _shapes(plan, count, grid.saved_rows, with_state)
        scalars, errors, *states, multipliers, reactions, ends = map(np.empty, shapes)
        return cls(
            np.empty(count, dtype=np.int8), np.empty(count), scalars, errors, tuple(states),
            multipliers, reactions, ends, {},
        )  # fmt: skip

    @staticmethod
    def size(plan: Plan, count: int, rows: int, with_state: bool) -> int:
        """Bytes of one with so many saved rows, by whole numbers without an end."""
        return 9 * count + 8 * sum(map(math.prod, _shapes(plan, count, rows, with_state)))

    @property
    def arrays(self) -> tuple[Array, ...]:
        """As the driver takes them."""
        return (self.errors, *self.states, self.multipliers, self.reactions, self.ends)

    @property
    def state(self) -> tuple[Array, ...]:
        """At the end, in memory apart from the history's: [body][component]."""
        return tuple(a[-1].copy() if len(a) > 1 else a[-1] for a in self.states)

    def take(self, chunk: Chunk, grid: Grid) -> None:
        """Keep a finished chunk's summary."""
        bodies, found = slice(chunk.start, chunk.stop), chunk.found
        first = len(SUMMARY_SCALARS)
        self.scalars[:, bodies] = found[:first]
        status, failed_step = found[first : first + 2]
        self.status[bodies] = status
        self.t[bodies] = grid.time(grid.steps)
        if (failed := status != OK).any():
            self.t[bodies][failed] = grid.time(failed_step[failed])

    def hear(self, plan: Plan, chunk: Chunk, is_last: bool) -> None:
        """Take what functions have raised in a call of the driver, and free its memory."""
        marks = chunk.summary[RAISED_AT_END] if is_last else chunk.carried[MARKS]
        found = np.unique(np.abs(marks)).astype(np.int64).tolist()
        errors = {mark: calls.exception_of(mark) for mark in found if mark > calls.HEARD}
        for body in np.flatnonzero(marks > calls.HEARD)[:1].tolist():
            if chunk.start + body < min(self.raised, default=math.inf):
                self.raised.clear()
                error = errors[int(marks[body])]
                self.raised[chunk.start + body] = exception_told(plan, error)


def _shapes(plan: Plan, count: int, rows: int, with_state: bool) -> list[tuple[int, ...]]:
    """Of an Output's arrays of numbers, `scalars` and those after it."""
    states = rows if with_state else 1
    return [
        (len(SUMMARY_SCALARS), count),
        (len(error_columns(plan)), rows, count),
        *((states, count, width) for width in STATE_WIDTHS.values()),
        (rows * plan.multipliers, count, len(plan.rows)),
        (rows * plan.reaction, count, 6),
        (len(end_columns(plan)), count),
    ]


def integrate(
    plan: Plan,
    inputs: Inputs,
    grid: Grid,
    with_state: bool = False,
    threads: int | None = None,
    progress: Progress = None,
    check: Callable[[Array, int], bool] | None = None,
) -> Output:
    """Run every body to the end, chunk by chunk.

    check : a function of a chunk's `starts` and the number of its first body; it raises, or says
        whether it wants to see the next chunk. It sees all of them before the first step, or, where
        they are but one chunk, after the driver's first call.
    """
    check_threads()
    used = _threads(threads, -(-inputs.count // plan.lanes))
    output = Output.empty(plan, inputs.count, grid, with_state)
    chunks = _Chunks(inputs, plan.lanes)
    if check is not None and inputs.count > CHUNK_BODIES:
        for chunk in chunks:
            _call_driver(plan, chunk, output, grid, UNSEEN, 0, used)
            if not check(chunk.starts, chunk.start):
                break
        check = None
    with reporter(progress, inputs.count * grid.steps) as report:
        for chunk in chunks:
            begin = 0 if check is None else UNSEEN
            if inputs.state is not None:
                inputs.put_state(plan, chunk)
                begin = RESUMED
            for done in _run_chunk(plan, chunk, grid, output, used, begin):
                if check is not None:
                    check(chunk.starts, chunk.start)
                    check = None
                report(chunk.start * grid.steps + (chunk.stop - chunk.start) * done)
    _spare[:] = [chunk.memory]
    return output


class _Chunks:
    """All bodies, chunk by chunk, as often as asked; one chunk's memory at a time."""

    def __init__(self, inputs: Inputs, lanes: int) -> None:
        self.inputs, self.lanes = inputs, lanes
        self.held: Chunk | None = None

    def __iter__(self) -> Iterator[Chunk]:
        for start in range(0, self.inputs.count, CHUNK_BODIES):
            if self.held is None or self.held.start != start:
                self.held = Chunk.of(self.inputs, start, self.lanes, self.held)
            yield self.held


def _run_chunk(
    plan: Plan, chunk: Chunk, grid: Grid, output: Output, threads: int, begin: int
) -> Iterator[int]:
    """Run a chunk to the end; yields the steps done after each call of the driver.

    begin : 0, UNSEEN or RESUMED.
    """
    done, blocks, pace = 0, chunk.inputs.shape[1] // plan.lanes, _pace(plan, grid.dt)
    ahead = pace.steps(0.5 * CALL_SECONDS)  # these bodies may be slower than the last ones
    while done < grid.steps:
        left = grid.steps - done
        calls = max(1, round(left * blocks / ahead))
        end = done + -(-left // calls)
        seconds = _call_driver(plan, chunk, output, grid, begin, end, threads)
        if plan.calls_functions:
            output.hear(plan, chunk, is_last=end == grid.steps)
        pace.seconds = seconds / ((end - done) * blocks)
        ahead = pace.steps(CALL_SECONDS)
        begin = done = end
        yield done
    output.take(chunk, grid)


@dataclass
class _Pace:
    """How long a step of one block took in the last call, in s; None before there was one."""

    seconds: float | None = None

    def steps(self, seconds: float) -> float:
        """Steps of one block for so many seconds."""
        if self.seconds is None:
            return max(FIRST_CALL_BLOCK_STEPS, 1)
        return max(seconds / self.seconds, 1)


@lru_cache(64)
def _pace(plan: Plan, dt: float) -> _Pace:
    """One for all runs of a plan with steps of dt: the larger a step's angles, the slower it is."""
    return _Pace()


def _call_driver(
    plan: Plan, chunk: Chunk, output: Output, grid: Grid, begin: int, end: int, threads: int
) -> float:
    """Steps begin … end of a chunk; returns the seconds that they took, compilation apart."""
    arguments = (
        chunk.inputs, chunk.carried, chunk.summary, *output.arrays, chunk.start, begin, end,
        grid.steps, grid.origin, grid.first_step, grid.dt, grid.measure_every, grid.save_every,
    )  # fmt: skip
    entry = entry_of(integrate_block, plan, 0, *arguments)
    counter = np.zeros(2, dtype=np.int64)
    loop = (SOURCES, entry, counter, plan.lanes, threads, *arguments)
    run = compiled(integrate_blocks, *loop)
    with _driver_lock, _thread_mask(threads), np.errstate(all="ignore"):
        began = time.perf_counter()
        run(*loop)
        return max(time.perf_counter() - began, 1e-6)


def exception_told(plan: Plan, error: Exception) -> str:
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


def _threads(count: int | None, blocks: int) -> int:
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
