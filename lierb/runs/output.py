"""Output arrays of a run."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache
from textwrap import shorten
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from lierb.kernels.functions.source_lines import line_that_raised
from lierb.kernels.loops.record import (
    end_columns,
    history_columns,
    lane_column,
    marks_column,
    summary_columns,
)
from lierb.kernels.stepping.clock import Clock, time_of
from lierb.kernels.systems.layout import LANE_SUMMARY, POSE_AND_TWIST
from lierb.kernels.systems.measures import KEPT, SUMMARY
from lierb.kernels.systems.plan import AnyPlan
from lierb.kernels.systems.state import OK
from lierb.kernels.systems.system_of import system_of
from lierb.kernels.tracing import calls
from lierb.support.arrays import Array
from lierb.support.memory import room

MESSAGE_LENGTH = 200  # of an exception's words, in one line


class Times(Protocol):
    """When a run is, and which times of it are saved."""

    @property
    def saved_rows(self) -> int: ...
    def saved_steps(self) -> NDArray[np.int64]: ...
    def saved_times(self) -> Array: ...
    @property
    def end(self) -> float: ...


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


def exception_told(plan: AnyPlan, error: Exception) -> str:
    """What a function of the user's that runs body by body has raised, in words."""
    functions = [f for element in plan.elements for f in element.functions if not f.is_traced]
    names = " or ".join(dict.fromkeys(f.name for f in functions))
    message = shorten(str(error), MESSAGE_LENGTH)
    what = f"{type(error).__name__}: {message}" if message else type(error).__name__
    line = line_that_raised(error, [f.python for f in functions])
    return f"{names} raised {what}{f' ({line})' if line else ''}"
