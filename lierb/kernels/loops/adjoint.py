"""Adjoint of a run: the gradient of one number at its end, by all inputs of a trajectory.

The steps of a run are made again, block by block, and then differentiated backwards, each by its
tape (`lierb.kernels.numbers.tape`). States at the start of every `every`-th step are kept; those
between are computed anew from the last kept one.

The rows of a thread's memory, [row][lane], are gains of the objective: by the inputs, by the
numbers of the body, by those of the state; behind them are the states that are kept.

Griewank and Walther, Evaluating Derivatives (2008), chapter 12.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import count
from typing import Any

from lierb.compiler.code import cached
from lierb.compiler.loops import numbers_at
from lierb.compiler.tags import Tag
from lierb.kernels.loops.lane_steps import inside
from lierb.kernels.loops.record import load_values
from lierb.kernels.loops.sharing import pack, take_share
from lierb.kernels.numbers.arithmetic import (
    alike,
    class_of,
    flatten,
    load,
    maximum,
    refilled,
    scatter,
    store,
    where,
)
from lierb.kernels.numbers.dual import Dual, parts_of, value_of, values
from lierb.kernels.numbers.tape import Tape
from lierb.kernels.numbers.zero import ZERO, is_zero
from lierb.kernels.stepping.lane_clock import Trial
from lierb.kernels.stepping.method import Interval
from lierb.kernels.stepping.method_of import method_of
from lierb.kernels.systems.derivatives import in_time
from lierb.kernels.systems.extra_states import Control, with_initial_states, with_signals
from lierb.kernels.systems.plan import AnyPlan
from lierb.kernels.systems.signals import events_of
from lierb.kernels.systems.state import State
from lierb.kernels.systems.system_of import system_of
from lierb.kernels.tracing.trace import kernel

NO_CONTROL = Control((), (), ())
END_TIME = -1  # the time at which an event ends a trajectory, as an objective
MARK = (1.0,)  # parts of a number of the body that has gains


@dataclass(frozen=True)
class Adjoint(Tag):
    """Tag of the code that differentiates one number at the end of the runs of a plan.

    plan : with derivatives of all inputs.   objective : END_TIME, 0 for the energy, else 1 + the
    index of an observable.
    """

    plan: AnyPlan
    objective: int

    @cached_property
    def plain(self) -> AnyPlan:
        """Return the plan of the same run without derivatives."""
        return replace(self.plan, moving=())

    @cached_property
    def inputs(self) -> int:
        """Return the number of inputs with gains: all but a state to continue from."""
        return int(system_of(self.plain).inputs["state"].start)

    @property
    def lanes(self) -> int:
        return self.plan.lanes


# ---- numbers with gains ------------------------------------------------------------------------


def tape_at(number: Any) -> Tape:
    """Return the tape of the formula to which a number belongs."""
    trace = class_of(type(number)).trace_of(number)
    return Tape() if trace is None else trace.tape


def marked(body: Any) -> Any:
    """Mark the numbers that depend on inputs."""
    if isinstance(body, tuple):
        return alike(body, map(marked, body))
    return Dual(value_of(body), MARK) if parts_of(body) else value_of(body)


def opened_body(tape: Tape, body: Any) -> Any:
    """Give the marked numbers inputs of the tape."""
    if isinstance(body, tuple):
        return alike(body, [opened_body(tape, x) for x in body])
    return Dual(body.value, (tape.input(),)) if isinstance(body, Dual) else body


def opened_state(tape: Tape, state: State) -> State:
    numbers = (x if is_constant(x) else Dual(x, (tape.input(),)) for x in flatten(state))
    opened: State = refilled(state, numbers)
    return opened


def is_constant(x: Any) -> bool:
    return is_zero(x) or type(x) is float


def moving(numbers: Any) -> list[Any]:
    """Return the numbers that are no constants."""
    return [x for x in flatten(numbers) if not is_constant(x)]


def marks(body: Any) -> int:
    """Return how many numbers of a body are marked."""
    return sum(isinstance(x, Dual) for x in flatten(body))


class Gains:
    """Gains are rows of memory."""

    def __init__(self, run: Adjoint, body: Any, memory: Any) -> None:
        self.memory, self.lanes = memory, run.lanes
        self.of_body = run.inputs
        self.of_state = self.of_body + marks(body)

    def __getitem__(self, row: int) -> Any:
        return load(self.memory, (row, 0), self.lanes)

    def of(self, first: int, numbers: list[Any]) -> list[tuple[Any, Any]]:
        """Return numbers with their gains, in rows from `first` on."""
        return [(x, self[first + i]) for i, x in enumerate(numbers)]

    def put(self, first: int, gains: Iterable[Any]) -> None:
        for i, gain in enumerate(gains):
            store(self.memory, (first + i, 0), gain, self.lanes)

    def add(self, first: int, gains: Iterable[Any]) -> None:
        for i, gain in enumerate(gains):
            if not is_zero(gain):
                store(self.memory, (first + i, 0), self[first + i] + gain, self.lanes)


# ---- forwards ----------------------------------------------------------------------------------


def load_bodies(run: Adjoint, inputs: Any) -> tuple[Any, Any]:
    """Return the body, and with marks in place of derivatives."""
    numbers = load_values(run.plain, inputs)
    tape = tape_at(numbers[0])
    return (
        system_of(run.plain).body(numbers),
        marked(system_of(run.plan).body(tape.opened(numbers))),
    )


def load_start(run: Adjoint, body: Any, inputs: Any, at: Interval) -> State:
    return begun(run.plain, body, load_values(run.plain, inputs), at)


def with_start_rank(run: Adjoint, bodies: tuple[Any, Any], state: State) -> tuple[Any, Any]:
    """Return the bodies with the number of redundant rows at the start."""
    body, of_inputs = bodies
    dropped = 0.0 * body.mass + system_of(run.plain).dropped(body, state)
    return body._replace(dropped=dropped), of_inputs._replace(dropped=dropped)


def begun(plan: AnyPlan, body: Any, numbers: list[Any], at: Interval) -> State:
    system = system_of(plan)
    state = system.start(body, system.placed(body, numbers), numbers)
    state = with_initial_states(system, body, state, 0.0 * body.mass)
    return method_of(plan).started(system, body, state, at) if state.carried else state


def interval_at(run: Adjoint, times: Any, k: Any, column: Any, dt: Any) -> Interval:
    """Return the interval of step k.   times : ends of the steps, s, [step][trajectory or 1]."""
    if not run.plan.has_lane_clocks:
        return Interval(load(times, (k, 0), 1), dt, dt)
    start, end = (load(times, (i, column), run.lanes) for i in (k, k + 1))
    time, span = inside(run.plan, Trial(start, end - start, end, 0.0))
    return Interval(time, span, end - start)


def step(run: Adjoint, body: Any, state: State, at: Interval) -> State:
    """Make a step; the state is NaN where it fails."""
    return _stepped(run.plain, body, state, at)


def _stepped(plan: AnyPlan, body: Any, state: State, at: Interval) -> State:
    made = method_of(plan).step(system_of(plan), body, state, at)
    moved, off = made.state, maximum(made.singular, made.unsolved)
    if not (plan.moving or is_zero(off)):
        moved = moved._replace(v_or_mu=system_of(plan).silenced(body, moved.v_or_mu, off <= 0.5))
    if plan.has_lane_clocks:  # trajectories that have ended stay
        pairs = zip(flatten(moved), flatten(state), strict=True)
        has_ended = at.h == 0.0
        moved = refilled(state, (x if is_constant(y) else where(has_ended, y, x) for x, y in pairs))
    return moved


def keep(run: Adjoint, state: State, memory: Any, row: Any) -> None:
    """Keep a state in rows of the memory, from `row` on."""
    for i, x in enumerate(moving(state)):
        store(memory, (row + i, 0), x, run.lanes)


def kept(run: Adjoint, like: State, memory: Any, row: Any) -> State:
    """Return a state that is kept.   like : another one."""
    rows = count()
    numbers = (
        x if is_constant(x) else load(memory, (row + next(rows), 0), run.lanes)
        for x in flatten(like)
    )
    found: State = refilled(like, numbers)
    return found


# ---- backwards ---------------------------------------------------------------------------------


def objective(run: Adjoint, body: Any, state: State, time: Any) -> tuple[Any, tuple[Any, ...]]:
    """Return the objective, and the values of all events."""
    system = system_of(run.plan)
    body = with_signals(run.plan, body, state, NO_CONTROL)
    seen = system.motion(body, state, time)
    events = system.events(body, seen, time) if events_of(run.plan) else ()
    if run.objective == END_TIME:
        return time, events
    if run.objective == 0:
        return system.measured(body, state, seen, time).values["energy"], events
    return system.observed(body, seen, time)[run.objective - 1], events


def start_gains(
    run: Adjoint, body: Any, state: State, memory: Any, time: Any, ended_by: Any, column: Any
) -> Any:
    """Return the objective at the end of a run; make its gains those by the state there.

    ended_by : index of the event g that has ended a trajectory, −1 for none, [1][trajectory]. The
    end time then changes by −∂g/ġ, and the objective f by ∂f − (ḟ/ġ) ∂g.
    """
    gains = Gains(run, body, memory)
    like = moving(state)[0]
    tape = tape_at(like)
    opened = opened_body(tape, body), opened_state(tape, state)
    value, events = objective(run, *opened, time)
    results = [(value, 0.0 * like + 1.0)]
    if events:
        rate, rates = _rates(run, values(body), state, time)
        ended = load(ended_by, (0, column), run.lanes)
        results += [
            (event, where(ended == float(i), -rate / own, 0.0))
            for i, (event, own) in enumerate(zip(events, rates, strict=True))
        ]
    found = tape.gains(results)
    gains.put(0, [0.0 * like] * gains.of_body)
    gains.put(gains.of_body, (0.0 * like if is_zero(x) else x for x in found))
    return 0.0 * like + value_of(value)


def _rates(run: Adjoint, body: Any, state: State, time: Any) -> tuple[Any, list[Any]]:
    """Return the time derivatives of the objective and of all events."""
    like = 0.0 * moving(state)[0]
    seen = with_signals(run.plan, body, state, NO_CONTROL)
    moved = in_time(system_of(run.plan), seen, state, like + time)
    value, events = objective(run, body, moved, Dual(like + time, (1.0,)))
    first, *others = (like + (parts_of(x) or (ZERO,))[0] for x in (value, *events))
    return first, others


def end_time(run: Adjoint, times: Any, steps: Any, column: Any, end: Any) -> Any:
    return load(times, (steps, column), run.lanes) if run.plan.has_lane_clocks else end


def step_back(run: Adjoint, body: Any, state: State, memory: Any, at: Interval) -> None:
    """Turn gains by the state after a step into those by the state before, and by the body."""
    gains = Gains(run, body, memory)
    tape = tape_at(moving(state)[0])
    numbers = opened_body(tape, body), opened_state(tape, state)
    moved = _stepped(run.plan, *numbers, at)
    pairs = zip(flatten(moved), flatten(state), strict=True)
    results = gains.of(gains.of_state, [x for x, y in pairs if not is_constant(y)])
    found = tape.gains(results)
    behind = gains.of_state - gains.of_body
    gains.add(gains.of_body, found[:behind])
    like = results[0][1]
    gains.put(gains.of_state, (0.0 * like if is_zero(x) else x for x in found[behind:]))


def start_back(run: Adjoint, body: Any, state: State, inputs: Any, memory: Any, at: Any) -> None:
    """Add the gains by the start's inputs and by the body.   state : at the start."""
    gains = Gains(run, body, memory)
    given = load_values(run.plain, inputs)
    tape = tape_at(given[0])
    numbers, opened = tape.opened(given), opened_body(tape, body)
    started = begun(run.plan, opened, numbers, at)
    pairs = zip(flatten(started), flatten(state), strict=True)
    results = gains.of(gains.of_state, [x for x, y in pairs if not is_constant(y)])
    gains.add(0, tape.gains(results))  # inputs, then the body


def body_back(run: Adjoint, body: Any, inputs: Any, memory: Any) -> None:
    """Add the gains by the body's inputs."""
    gains = Gains(run, body, memory)
    given = load_values(run.plain, inputs)
    tape = tape_at(given[0])
    made = flatten(system_of(run.plan).body(tape.opened(given)))
    results = [x for x, mark in zip(made, flatten(body), strict=True) if isinstance(mark, Dual)]
    gains.add(0, tape.gains(gains.of(gains.of_body, results)))


def put_gains(run: Adjoint, memory: Any, value: Any, gains: Any, column: Any) -> None:
    """Store the gains by the inputs, and behind them the objective."""
    numbers = [load(memory, (c, 0), run.lanes) for c in range(run.inputs)]
    places = [(c, column) for c in range(run.inputs + 1)]
    scatter(gains, 1, places, [*numbers, value], run.lanes)


for _formula in (
    load_bodies, load_start, with_start_rank, interval_at, step, keep, kept, end_time, start_gains,
    step_back, start_back, body_back, put_gains,
):  # fmt: skip
    kernel(_formula)


@cached()
def differentiate_blocks(run, inputs, counter, jobs):
    """Differentiate the runs of all blocks, until no share of blocks is left.

    The job's `gains` are [column of inputs, then the objective][trajectory].
    """
    job, lanes = jobs[0], inputs.shape[1]
    times, memory, gains = numbers_at(job.step_times), numbers_at(job.memory), numbers_at(job.gains)
    ended_by = numbers_at(job.ended_by)
    steps, every, rows, dt = job.steps, job.kept_every, job.state_rows, job.dt
    first_row = job.first_row  # of the states that are kept
    between = first_row + rows * ((steps + every - 1) // every)
    blocks, is_new = (job.stop - job.first + lanes - 1) // lanes, True
    while True:
        block, behind = take_share(counter, blocks, job.inputs[1])
        if block >= behind:
            break
        for number in range(block, behind):
            column = job.first + number * lanes
            pack(job, inputs, number * lanes, is_new)
            is_new = False
            at = interval_at(run, times, 0, column, dt)
            bodies = load_bodies(run, inputs)
            start = load_start(run, bodies[0], inputs, at)
            body, of_inputs = with_start_rank(run, bodies, start)
            state = start
            for k in range(steps):
                if k % every == 0:
                    keep(run, state, memory, first_row + rows * (k // every))
                state = step(run, body, state, interval_at(run, times, k, column, dt))
            time = end_time(run, times, steps, column, job.end)
            value = start_gains(run, of_inputs, state, memory, time, ended_by, column)
            for part in range((steps - 1) // every, -1, -1):
                first = part * every
                last = min(first + every, steps)
                state = kept(run, start, memory, first_row + rows * part)
                for k in range(first, last):
                    keep(run, state, memory, between + rows * (k - first))
                    if k < last - 1:
                        state = step(run, body, state, interval_at(run, times, k, column, dt))
                for k in range(last - 1, first - 1, -1):
                    state = kept(run, start, memory, between + rows * (k - first))
                    at = interval_at(run, times, k, column, dt)
                    step_back(run, of_inputs, state, memory, at)
            at = interval_at(run, times, 0, column, dt)
            start_back(run, of_inputs, start, inputs, memory, at)
            body_back(run, of_inputs, inputs, memory)
            put_gains(run, memory, value, gains, column)
