"""Output arrays of a run."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache
from textwrap import shorten
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lierb.kernels.functions.source_lines import line_that_raised
from lierb.kernels.loops.ends import end_columns, end_parts
from lierb.kernels.loops.record import (
    carried_columns,
    history_columns,
    lane_column,
    summary_columns,
)
from lierb.kernels.stepping.clock import Clock, StepClock, time_of
from lierb.kernels.systems.derivatives import derivative_columns
from lierb.kernels.systems.layout import LANE_SUMMARY, POSE_AND_TWIST, Columns
from lierb.kernels.systems.measures import KEPT, SUMMARY
from lierb.kernels.systems.observables import DIFFERENTIATED, observables_of
from lierb.kernels.systems.plan import AnyPlan
from lierb.kernels.systems.signals import events_of
from lierb.kernels.systems.state import OK
from lierb.kernels.systems.system_of import system_of
from lierb.kernels.tracing import calls
from lierb.support.arrays import Array
from lierb.support.memory import room

MESSAGE_LENGTH = 200  # most characters of an exception's message, in one line


@dataclass(frozen=True)
class Output:
    """Results of a run, in the layout of their Arrow columns.

    plan, clock : plan and times of the run.
    summary : [SUMMARY, then KEEPS of each observable][trajectory].
    history : [measure, then observable, then error of a joint][time][trajectory].
    states : [link, time][trajectory][component]; only the state at the end if not recorded.
    multipliers : [time][trajectory][row of any joint].
    reactions : [joint, time][trajectory][component].
    ends : the driver's state at the end, [`end_columns`][trajectory]; then, with derivatives,
        theirs, [column, direction][trajectory].
    derivatives : [time][trajectory][column, direction], of `derivative_columns`.
    end_derivatives : at the end, [column, direction][trajectory]; then, for a model with events,
        those in time, [column][trajectory]; then those of DIFFERENTIATED of each observable,
        [observable, statistic, direction][trajectory].
    raised : description of each trajectory's first exception in a user's function.
    events : [event][trajectory, index, t, state of every link, extra states and outputs], sorted by
        trajectory and time; None without events.
    event_derivatives : at the events, likewise as at the ends, [column, direction; column][event].
    """

    plan: AnyPlan
    clock: Clock
    summary: Array
    history: Array
    states: tuple[Array, ...]  # in the order of POSE_AND_TWIST
    multipliers: Array
    reactions: Array
    ends: Array
    derivatives: Array
    end_derivatives: Array
    raised: dict[int, str]
    events: Array | None = None
    event_derivatives: Array | None = None

    @classmethod
    def empty(cls, plan: AnyPlan, count: int, clock: Clock, with_state: bool) -> Output:
        shapes = _shapes(plan, count, clock.saved_rows, with_state)
        summary, history, *states, multipliers, reactions, ends, rows, end = map(room, shapes)
        results = (summary, history, tuple(states), multipliers, reactions, ends, rows, end)
        return cls(plan, clock, *results, {})

    @cached_property
    def links(self) -> int:
        return system_of(self.plan).links

    @staticmethod
    def size(plan: AnyPlan, count: int, rows: int, with_state: bool) -> int:
        """Return the size in bytes of an output with `rows` saved rows."""
        return 9 * count + 8 * sum(map(math.prod, _shapes(plan, count, rows, with_state)))

    @cached_property
    def arrays(self) -> dict[str, Array]:
        """Arrays of the job record."""
        fields = (field.name for field in POSE_AND_TWIST.fields)
        states = dict(zip(fields, self.states, strict=True))
        names = (
            "summary", "history", "multipliers", "reactions", "ends", "derivatives",
            "end_derivatives",
        )  # fmt: skip
        return states | {name: getattr(self, name) for name in names}

    @cached_property
    def rows(self) -> int:
        """Number of rows in the states of each link."""
        return len(self.states[0]) // self.links

    @property
    def state(self) -> tuple[Array, ...]:
        """State of the first link at the end, [trajectory][component], copied from a history."""
        return self.state_of(0)

    def state_of(self, link: int) -> tuple[Array, ...]:
        """Return the state of a link at the end, [trajectory][component]."""
        last = self.rows * (link + 1) - 1
        return tuple(a[last].copy() if self.rows > 1 else a[last] for a in self.states)

    @property
    def kept(self) -> Array:
        """Retained measures, [KEPT][trajectory]."""
        return self.summary[: len(KEPT)]

    @property
    def observed(self) -> Array:
        """KEEPS of each observable, then JOINT_KEPT of each joint, [column][trajectory]."""
        return self.summary[SUMMARY.count : lane_column(self.plan) - self.plan.method.iterates]

    @property
    def turns(self) -> Array:
        """Turns of all iterations of a method that iterates, [trajectory]."""
        return np.asarray(self.summary[lane_column(self.plan) - 1])

    @cached_property
    def status(self) -> NDArray[np.int8]:
        """Status codes, [trajectory]."""
        return np.asarray(self.summary[SUMMARY.index("status")], np.int8)

    @cached_property
    def t(self) -> Array:
        """End time of each trajectory, s."""
        if not isinstance(self.clock, StepClock):
            return self.of_lanes("t")
        t = np.full(len(self.status), self.clock.end)
        if (failed := self.status != OK).any():
            t[failed] = time_of(self.clock, self.summary[SUMMARY.index("failed_step"), failed])
        return t

    def of_lanes(self, name: str) -> Array:
        """Return a column of LANE_SUMMARY."""
        return np.asarray(self.summary[lane_column(self.plan) + LANE_SUMMARY.index(name)])

    @property
    def signals(self) -> Array:
        """Extra states and outputs at the end, [number][trajectory]."""
        return self.summary[lane_column(self.plan) + LANE_SUMMARY.count :]

    def part(self, which: slice, clock: Clock) -> Output:
        """Return the output of some neighbouring trajectories.   clock : of their run."""
        own = {}
        if self.events is not None and self.event_derivatives is not None:
            at = (self.events[:, 0] >= which.start) & (self.events[:, 0] < which.stop)
            own = {"events": self.events[at], "event_derivatives": self.event_derivatives[:, at]}
            own["events"][:, 0] -= which.start
        return Output(
            self.plan, clock, self.summary[:, which], self.history[..., which],
            tuple(array[:, which] for array in self.states), self.multipliers[:, which],
            self.reactions[:, which], self.ends[:, which], self.derivatives[:, which],
            self.end_derivatives[:, which], {}, **own,
        )  # fmt: skip

    def starts(self, first: int, stop: int) -> Array:
        """Return 1 for each trajectory whose start satisfies the joint, else 0."""
        return self.summary[SUMMARY.index("starts"), first:stop]

    def collect_exceptions(self, chunk: Chunk, is_last: bool) -> None:
        """Collect the exceptions of a call of the driver, and free their memory."""
        count = chunk.stop - chunk.start
        at_end = self.summary[SUMMARY.index("raised"), chunk.start : chunk.stop]
        flags = (
            at_end if is_last else chunk.carried[carried_columns(self.plan).index("flags"), :count]
        )
        self.collect_flags(flags, chunk.start)

    def collect_flags(self, flags: Array, first: int) -> None:
        """Collect the exceptions behind the flags of the trajectories from `first` on."""
        known = np.unique(np.abs(flags)).astype(np.int64).tolist()
        errors = {flag: calls.exception_of(flag) for flag in known if flag > calls.COLLECTED}
        for index in np.flatnonzero(flags > calls.COLLECTED)[:1].tolist():
            if first + index < min(self.raised, default=math.inf):
                self.raised.clear()
                error = errors[int(flags[index])]
                self.raised[first + index] = describe_exception(self.plan, error)


@lru_cache(64)
def _shapes(plan: AnyPlan, count: int, rows: int, with_state: bool) -> tuple[tuple[int, ...], ...]:
    """Return the shapes of an Output's arrays."""
    system = system_of(plan)
    # With one clock per lane, the end is not a row of the history.
    states = ((rows + plan.has_lane_clocks) if with_state else 1) * system.links
    derivatives = derivatives_of(plan).count if plan.moving else 0
    return (
        (summary_columns(plan), count),
        (history_columns(plan), rows, count),
        *((states, count, field.width) for field in POSE_AND_TWIST.fields),
        (rows * plan.multipliers, count, len(plan.rows)),
        (rows * plan.reaction * max(len(system.joints), 1), count, 6),
        (len(end_columns(plan)) + end_parts(plan), count),
        (rows, count, derivatives * plan.directions),
        (_end_derivatives(plan, derivatives), count),
    )


def _end_derivatives(plan: AnyPlan, columns: int) -> int:
    """Return the number of derivatives at the end.   columns : of `derivatives_of`, 0 for none."""
    in_time = columns * bool(events_of(plan))
    return columns * plan.directions + in_time + kept_derivatives(plan) * plan.directions


def kept_derivatives(plan: AnyPlan) -> int:
    """Return the number of statistics of observables that have derivatives."""
    return len(DIFFERENTIATED) * len(observables_of(plan))


def derivatives_of(plan: AnyPlan) -> Columns:
    """Return the columns of an Output's derivatives."""
    system = system_of(plan)
    return derivative_columns(plan, system.links, len(system.joints))


class Chunk(NamedTuple):
    """Trajectories start … stop, integrated together.

    carried : state between calls, [column][trajectory, padded to full blocks]; empty for one call.
    """

    start: int
    stop: int
    carried: Array


def describe_exception(plan: AnyPlan, error: Exception) -> str:
    """Return the message for an exception of a user's function that runs body by body."""
    functions = [f for element in plan.elements for f in element.functions if not f.is_traced]
    names = " or ".join(dict.fromkeys(f.name for f in functions))
    message = shorten(str(error), MESSAGE_LENGTH)
    raised = f"{type(error).__name__}: {message}" if message else type(error).__name__
    line = line_that_raised(error, [f.python for f in functions])
    return f"{names} raised {raised}{f' ({line})' if line else ''}"
