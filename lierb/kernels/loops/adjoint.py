"""Adjoint of a run: the gradient of one number at its end, by all inputs of a trajectory.

The steps of a run are made again, block by block, and then differentiated backwards, each by its
tape (`lierb.kernels.numbers.tape`). So are the ticks of controllers, each before the step that
starts there, or after the last step. States at the start of every `every`-th step are kept, before
its ticks; those between are computed anew from the last kept one.

The rows of a thread's memory, [row][lane], are gains of the objective: by the inputs, by the
numbers of the body, by those of the state; behind them are the states that are kept.

Griewank and Walther, Evaluating Derivatives (2008), chapter 12.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from lierb.compiler.code import cached
from lierb.compiler.loops import integers_at, numbers_at, shared
from lierb.kernels.loops.gains import (
    END_TIME,
    Adjoint,
    Gains,
    is_constant,
    moving,
    opened_body,
    opened_numbers,
    tape_at,
)
from lierb.kernels.loops.record import load_values
from lierb.kernels.loops.remade_steps import (
    Held,
    Noted,
    begun,
    called,
    first_step,
    interval_at,
    is_ticking,
    keep,
    kept,
    load_bodies,
    load_start,
    step,
    stepped,
    ticked,
    time_at,
    with_start_rank,
)
from lierb.kernels.loops.sharing import pack, take_share
from lierb.kernels.numbers.arithmetic import flatten, load, plain, scatter, where
from lierb.kernels.numbers.dual import Dual, parts_of, value_of, values
from lierb.kernels.numbers.tape import Tape
from lierb.kernels.numbers.zero import ZERO, is_zero
from lierb.kernels.systems.derivatives import euler_slopes, euler_step, in_time
from lierb.kernels.systems.extra_states import with_signals
from lierb.kernels.systems.signals import controllers_of, events_of
from lierb.kernels.systems.system_of import in_memory, system_of
from lierb.kernels.tracing.trace import kernel


def objective(
    run: Adjoint, body: Any, held: Held, time: Any, is_next: bool = False
) -> tuple[Any, tuple[Any, ...]]:
    """Return the objective, and the values of all events.   is_next : at the next state."""
    system, state = system_of(run.plan), held.state
    body = with_signals(run.plan, body, *held)
    seen = system.motion(body, state, time, is_next)
    events = system.events(body, seen, time) if events_of(run.plan) else ()
    if run.objective == END_TIME:
        return time, events
    if run.objective == 0:
        return system.measured(body, state, seen, time).values["energy"], events
    return system.observed(body, seen, time)[run.objective - 1], events


def start_gains(run: Adjoint, body: Any, held: Held, memory: Any, noted: Noted, steps: Any) -> Any:
    """Return the objective at the end of a run; make its gains those after the ticks there.

    Where an event g has ended a trajectory, the end time changes by −∂g/ġ, and the objective f by
    ∂f − (ḟ/ġ) ∂g.
    """
    gains, time = Gains(run, body, memory), time_at(run, noted, steps)
    held = ticked(run, values(body), held, noted, steps)
    like, rate, rates = moving(held)[0], ZERO, list[Any]()
    if events_of(run.plan):
        rate, rates = _rates(run, values(body), held, time)
    tape = tape_at(run, like)
    opened = opened_body(tape, body), opened_numbers(tape, held)
    with tape.recording():
        value, events = objective(run, *opened, time)
    results = [(value, 0.0 * like + 1.0)]
    if events:
        ended = load(noted.ended_by, (0, noted.column), run.lanes)
        results += [
            (event, where(ended == float(i), -rate / own, 0.0))
            for i, (event, own) in enumerate(zip(events, rates, strict=True))
        ]
    found = tape.gains(results)
    gains.put(0, [0.0 * like] * gains.of_body)
    gains.put(gains.of_body, (0.0 * like if is_zero(x) else x for x in found))
    return 0.0 * like + value_of(value)


def _rates(run: Adjoint, body: Any, held: Held, time: Any) -> tuple[Any, list[Any]]:
    """Return the time derivatives of the objective and of all events."""
    like = 0.0 * moving(held)[0]
    if run.plan.is_looped:
        return _rates_in_memory(run, body, held, like + time)
    seen = with_signals(run.plan, body, *held)
    moved = in_time(system_of(run.plan), seen, held.state, like + time)
    there = held._replace(state=moved)
    value, events = objective(run, body, there, Dual(like + time, (1.0,)))
    first, *others = (like + (parts_of(x) or (ZERO,))[0] for x in (value, *events))
    return first, others


def _rates_in_memory(run: Adjoint, body: Any, held: Held, time: Any) -> tuple[Any, list[Any]]:
    """Return `_rates` of a looped plan: gains by the length of a step of 0 s, each by a tape."""
    system, rates = in_memory(run.plan), list[Any]()
    seen, like = with_signals(run.plan, body, *held), 0.0 * time
    slopes = euler_slopes(system, seen, held.state, time)
    for number in range(1 + len(events_of(run.plan))):
        tape = tape_at(run, like)
        h = Dual(like, (tape.input(),))
        with tape.recording():
            moved = euler_step(system, seen, held.state, slopes, h)
            there = held._replace(state=moved)
            first, others = objective(run, body, there, Dual(time, h.parts), is_next=True)
        rates.append(like + plain(tape.gains([((first, *others)[number], like + 1.0)])[0]))
        system.clear_gains(body)
    return rates[0], rates[1:]


def step_back(run: Adjoint, body: Any, held: Held, memory: Any, noted: Noted, k: Any) -> None:
    """Turn gains after step k into those between the ticks at its start and the step."""
    held = ticked(run, values(body), held, noted, k)
    at = interval_at(run, noted, k)
    if run.plan.is_looped:
        in_memory(run.plan).gains_ahead(values(body))
    _go_back(run, body, held, memory, lambda body, held: stepped(run.plan, body, held, at))


def tick_back(run: Adjoint, body: Any, held: Held, memory: Any, noted: Noted, k: Any) -> None:
    """Turn gains after the ticks at the start of step k into those before them."""
    if not controllers_of(run.plan):
        return
    _go_back(
        run, body, held, memory, lambda body, held: called(run, run.plan, body, held, noted, k)
    )


def _go_back(
    run: Adjoint, body: Any, held: Held, memory: Any, move: Callable[[Any, Held], Held]
) -> None:
    """Turn gains after a move into those before it, and by the body."""
    gains = Gains(run, body, memory)
    tape = tape_at(run, moving(held)[0])
    with tape.recording():
        moved = move(opened_body(tape, body), opened_numbers(tape, held))
    pairs = zip(flatten(moved), flatten(held), strict=True)
    results = gains.of(gains.of_state, [x for x, y in pairs if not is_constant(y)])
    found = tape.gains(results)
    behind = gains.of_state - gains.of_body
    gains.add(gains.of_body, found[:behind])
    like = results[0][1]
    gains.put(gains.of_state, (0.0 * like if is_zero(x) else x for x in found[behind:]))


def start_back(
    run: Adjoint, body: Any, held: Held, inputs: Any, tree: Any, memory: Any, noted: Noted
) -> None:
    """Add the gains by the start's inputs and by the body.   held : at the start."""
    gains = Gains(run, body, memory)
    if run.plan.is_looped:
        in_memory(run.plan).gains_ahead(values(body))
    tape, given = _opened_inputs(run, inputs, tree)
    opened = opened_body(tape, body)
    with tape.recording():
        started = begun(run.plan, opened, given, *first_step(run, noted))
    pairs = zip(flatten(started), flatten(held), strict=True)
    results = gains.of(gains.of_state, [x for x, y in pairs if not is_constant(y)])
    gains.add(0, tape.gains(results))  # inputs, then the body


def _opened_inputs(run: Adjoint, inputs: Any, tree: Any) -> tuple[Tape, Any]:
    """Return a tape, and the inputs on it, as for `begun`."""
    if run.plan.is_looped:
        tape = tape_at(run, load(inputs, (0, 0), run.lanes))
        return tape, in_memory(run.plan).inputs_with_gains(inputs, *tree)
    given = load_values(run.plain, inputs)
    tape = tape_at(run, given[0])
    return tape, tape.opened(given)


def body_back(run: Adjoint, body: Any, inputs: Any, tree: Any, memory: Any) -> None:
    """Add the gains by the body's inputs."""
    gains = Gains(run, body, memory)
    tape, given = _opened_inputs(run, inputs, tree)
    with tape.recording():
        if run.plan.is_looped:
            made = flatten(in_memory(run.plan).loaded(given, *tree))
        else:
            made = flatten(system_of(run.plan).body(given))
    results = [x for x, mark in zip(made, flatten(body), strict=True) if isinstance(mark, Dual)]
    gains.add(0, tape.gains(gains.of(gains.of_body, results)))


def put_gains(run: Adjoint, body: Any, memory: Any, value: Any, gains: Any, column: Any) -> None:
    """Store the gains by the inputs, and behind them the objective."""
    if run.plan.is_looped:
        in_memory(run.plan).put_gains(body, value, gains, column)
        return
    numbers = [load(memory, (c, 0), run.lanes) for c in range(run.inputs)]
    places = [(c, column) for c in range(run.inputs + 1)]
    scatter(gains, 1, places, [*numbers, value], run.lanes)


for _formula in (start_gains, step_back, tick_back, start_back, body_back, put_gains):
    kernel(_formula)


@shared
def steps_of_block(times, steps, column, lanes):
    """Return the number of steps of a block; later ones have no length.   steps : the most."""
    while times.shape[1] > 1 and steps > 1:
        for i in range(column, column + lanes):
            if times[steps, i] > times[steps - 1, i]:
                return steps
        steps -= 1
    return steps


@cached()
def differentiate_blocks(run, inputs, counter, jobs):
    """Differentiate the runs of all blocks, until no share of blocks is left.

    The job's `gains` are [column of inputs, then the objective][trajectory].
    """
    job, lanes = jobs[0], inputs.shape[1]
    memory, gains = numbers_at(job.memory), numbers_at(job.gains)
    times, ended_by = numbers_at(job.step_times), numbers_at(job.ended_by)
    noise_indices = numbers_at(job.noise_indices)
    tree = integers_at(job.table), numbers_at(job.nodes)
    steps, every, rows = job.steps, job.kept_every, job.state_rows
    first_row = job.first_row  # of the states that are kept
    between = first_row + rows * (steps // every + 1)
    blocks, is_new = (job.stop - job.first + lanes - 1) // lanes, True
    while True:
        block, behind = take_share(counter, blocks, job.inputs[1])
        if block >= behind:
            break
        for number in range(block, behind):
            column = job.first + number * lanes
            last = steps_of_block(times, steps, column, lanes)
            noted = Noted(times, ended_by, noise_indices, job.seed, job.dt, column)
            pack(job, inputs, number * lanes, is_new)
            is_new = False
            bodies = load_bodies(run, inputs, *tree)
            first = load_start(run, bodies[0], inputs, noted)
            body, of_inputs = with_start_rank(run, bodies, first)
            held = first
            for k in range(last + 1):
                if k % every == 0:
                    keep(run, body, held, memory, first_row + rows * (k // every))
                if k < last:
                    held = step(run, body, held, noted, k)
            value = start_gains(run, of_inputs, held, memory, noted, last)
            for part in range(last // every, -1, -1):
                begin = part * every
                end = min(begin + every, last + 1)
                held = kept(run, body, first, memory, first_row + rows * part)
                for k in range(begin, end):
                    keep(run, body, held, memory, between + rows * (k - begin))
                    if k < end - 1:
                        held = step(run, body, held, noted, k)
                for k in range(end - 1, begin - 1, -1):
                    held = kept(run, body, first, memory, between + rows * (k - begin))
                    if k < last:
                        step_back(run, of_inputs, held, memory, noted, k)
                    if is_ticking(run, body, held, noted, k):
                        tick_back(run, of_inputs, held, memory, noted, k)
            start_back(run, of_inputs, first, inputs, tree, memory, noted)
            body_back(run, of_inputs, inputs, tree, memory)
            put_gains(run, body, memory, value, gains, column)
