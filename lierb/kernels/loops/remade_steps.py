"""Steps of a run made again, with their ticks, from the ends that the run has noted."""

from __future__ import annotations

from itertools import count
from typing import Any, NamedTuple

from lierb.kernels.loops.gains import (
    Adjoint,
    is_constant,
    marked,
    moving,
    tape_at,
    with_all_marked,
)
from lierb.kernels.loops.lane_steps import interval_of
from lierb.kernels.loops.record import load_values
from lierb.kernels.loops.ticks import controlled, first_control, is_any_due
from lierb.kernels.numbers.arithmetic import (
    all_lanes,
    any_lanes,
    branch,
    flatten,
    load,
    maximum,
    real,
    refilled,
    store,
    where,
)
from lierb.kernels.numbers.dual import Dual, side_by_side, value_of, values
from lierb.kernels.numbers.zero import is_zero
from lierb.kernels.stepping.lane_clock import Trial
from lierb.kernels.stepping.method import Interval
from lierb.kernels.stepping.method_of import method_of
from lierb.kernels.systems.extra_states import Control, with_initial_states, with_signals
from lierb.kernels.systems.plan import AnyPlan
from lierb.kernels.systems.signals import controllers_of
from lierb.kernels.systems.state import State
from lierb.kernels.systems.system_of import in_memory, system_of
from lierb.kernels.tracing.trace import kernel


class Held(NamedTuple):
    """A trajectory between two steps has a state and what its controllers keep."""

    state: State
    control: Control


class Noted(NamedTuple):
    """A run has noted the steps of all trajectories.

    times : ends of the steps, s, [step][trajectory or 1]; row 0 has the start.
    ended_by : [0] index of the event whose zero is the end, −1 for none; [1] number of the steps if
        an event has ended the trajectory, else infinite; [which][trajectory].
    noise_indices, seed : of the controllers' noise, [1][trajectory].
    dt : length of steps that all trajectories share, s.   column : of a block's first trajectory.
    """

    times: Any
    ended_by: Any
    noise_indices: Any
    seed: Any
    dt: Any
    column: Any


def time_at(run: Adjoint, noted: Noted, k: Any) -> Any:
    """Return the start of step k, s."""
    if not run.plan.has_lane_clocks:
        return load(noted.times, (k, 0), 1)
    return load(noted.times, (k, noted.column), run.lanes)


def interval_at(run: Adjoint, noted: Noted, k: Any) -> Interval:
    """Return the interval of step k."""
    start = time_at(run, noted, k)
    if not run.plan.has_lane_clocks:
        return Interval(start, noted.dt, noted.dt)
    end = time_at(run, noted, k + 1)
    return interval_of(run.plan, Trial(start, end - start, end, 0.0))


# ---- start ----


def load_bodies(run: Adjoint, inputs: Any, table: Any, nodes: Any) -> tuple[Any, Any]:
    """Return the body, and with marks in place of derivatives.

    table, nodes : of a looped plan, whose gains are cleared.
    """
    if run.plan.is_looped:
        system = in_memory(run.plan)
        body = system.loaded(inputs, table, nodes)
        system.clear_gains(body)
        listed = with_all_marked((body.elements, body.frames))
        return body, body._replace(elements=listed[0], frames=listed[1])
    numbers = load_values(run.plain, inputs)
    tape = tape_at(run, numbers[0])
    return (
        system_of(run.plain).body(numbers),
        marked(system_of(run.plan).body(tape.opened(numbers))),
    )


def load_start(run: Adjoint, body: Any, inputs: Any, noted: Noted) -> Held:
    given = inputs if run.plan.is_looped else load_values(run.plain, inputs)
    held = begun(run.plain, body, given, *first_step(run, noted))
    go_ahead(run, body)
    return held


def with_start_rank(run: Adjoint, bodies: tuple[Any, Any], held: Held) -> tuple[Any, Any]:
    """Return the bodies with the number of redundant rows at the start."""
    body, of_inputs = bodies
    dropped = 0.0 * body.mass + system_of(run.plain).dropped(body, held.state)
    return body._replace(dropped=dropped), of_inputs._replace(dropped=dropped)


def begun(plan: AnyPlan, body: Any, given: Any, at: Interval, time: Any) -> Held:
    """Return the start, at a time, before the first tick.

    given : numbers of the inputs or, for a looped plan, their array.   at : interval of the first
    step.
    """
    system, zero = system_of(plan), 0.0 * body.mass
    if plan.is_looped:
        state = in_memory(plan).started(body, given)
    else:
        state = system.start(body, system.placed(body, given), given)
    state = with_initial_states(system, body, state, zero)
    if state.carried:
        state = method_of(plan).started(system, body, state, at)
    return Held(state, first_control(plan, body, time, value_of(zero)))


def first_step(run: Adjoint, noted: Noted) -> tuple[Interval, Any]:
    """Return the interval of the first step, and the start, s."""
    return interval_at(run, noted, 0), time_at(run, noted, 0)


# ---- steps ----


def step(run: Adjoint, body: Any, held: Held, noted: Noted, k: Any) -> Held:
    """Make the ticks at the start of step k, then the step; the state is NaN where it fails."""
    held = ticked(run, body, held, noted, k)
    held = stepped(run.plain, body, held, interval_at(run, noted, k))
    go_ahead(run, body)
    return held


def go_ahead(run: Adjoint, body: Any) -> None:
    """Make the next state in memory the state."""
    if run.plan.is_looped:
        in_memory(run.plan).go_ahead(body)


def stepped(plan: AnyPlan, body: Any, held: Held, at: Interval) -> Held:
    state, body = held.state, with_signals(plan, body, *held)
    made = method_of(plan).step(system_of(plan), body, state, at)
    moved, off = made.state, maximum(made.singular, made.unsolved)
    if not (plan.moving or is_zero(off)):
        moved = moved._replace(v_or_mu=system_of(plan).silenced(body, moved.v_or_mu, off <= 0.5))
    if plan.has_lane_clocks:  # trajectories that have ended stay
        pairs = zip(flatten(moved), flatten(state), strict=True)
        has_ended = at.h == 0.0
        moved = refilled(
            state, (x if is_constant(y) else _chosen(has_ended, y, x) for x, y in pairs)
        )
    return held._replace(state=moved)


def _chosen(mask: Any, a: Any, b: Any) -> Any:
    """Return `where`, which a tape records as a sum.

    After a choice, each operation of the step would compare its gain with zero.
    """
    value = where(mask, value_of(a), value_of(b))
    share = where(mask, 1.0, 0.0 * value_of(a))
    parts = tuple(p * share + q * (1.0 - share) for p, q in side_by_side(a, b))
    return Dual(value, parts) if parts else value


# ---- ticks ----


def is_ticking(run: Adjoint, body: Any, held: Held, noted: Noted, k: Any) -> Any:
    """Return whether controllers of any lane tick at the start of step k."""
    if not controllers_of(run.plan):
        return all_lanes(body.mass < body.mass)  # never
    return any_lanes(_ticks(run, body, held, noted, k) > 0.5)


def _ticks(run: Adjoint, body: Any, held: Held, noted: Noted, k: Any) -> Any:
    """Return 1 where controllers tick at the start of step k.

    None does where an event has just ended the trajectory.
    """
    time, ended = time_at(run, noted, k), load(noted.ended_by, (1, noted.column), run.lanes)
    allowed = where(ended > real(k), 1.0, 0.0 * time)
    return where(is_any_due(run.plain, body, held.control, time, allowed), 1.0, 0.0 * time)


def ticked(run: Adjoint, body: Any, held: Held, noted: Noted, k: Any) -> Held:
    """Make the ticks at the start of step k."""
    if not controllers_of(run.plan):
        return held
    some_tick = is_ticking(run, body, held, noted, k)
    return branch(
        some_tick, lambda: called(run, run.plain, body, held, noted, k), lambda: held, likely=False
    )


def called(run: Adjoint, plan: AnyPlan, body: Any, held: Held, noted: Noted, k: Any) -> Held:
    """Call all controllers, for the lanes in which they are due."""
    time, ticks = time_at(run, noted, k), _ticks(run, values(body), values(held), noted, k)
    stream = load(noted.noise_indices, (0, noted.column), run.lanes)
    return held._replace(control=controlled(plan, body, *held, time, ticks, noted.seed, stream))


# ---- a trajectory in memory ----


def keep(run: Adjoint, body: Any, held: Held, memory: Any, row: Any) -> None:
    """Keep a trajectory in rows of the memory, from `row` on."""
    numbers = moving(held)
    for i, x in enumerate(numbers):
        store(memory, (row + i, 0), x, run.lanes)
    if run.plan.is_looped:
        in_memory(run.plan).keep(body, memory, row + len(numbers))


def kept(run: Adjoint, body: Any, like: Held, memory: Any, row: Any) -> Held:
    """Return a trajectory that is kept.   like : another one."""
    rows = count()
    numbers = (
        x if is_constant(x) else load(memory, (row + next(rows), 0), run.lanes)
        for x in flatten(like)
    )
    held = refilled(like, numbers)
    if run.plan.is_looped:
        in_memory(run.plan).take_kept(body, memory, row + next(rows))
    return held


for _formula in (load_bodies, load_start, with_start_rank, step, is_ticking, keep, kept):
    kernel(_formula)
