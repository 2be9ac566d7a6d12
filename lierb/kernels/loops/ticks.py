"""Controllers between steps: their ticks, and what they keep from one tick to the next."""

from __future__ import annotations

from typing import Any

from lierb.kernels.functions.function import size_of
from lierb.kernels.functions.signals import Noise
from lierb.kernels.numbers.arithmetic import absolute, floor, plain, rint, where
from lierb.kernels.numbers.dual import values
from lierb.kernels.numbers.vec import Vec
from lierb.kernels.stepping.lane_clock import rounding_at
from lierb.kernels.systems.extra_states import Control, with_signals
from lierb.kernels.systems.plan import AnyPlan
from lierb.kernels.systems.signals import controllers_of, memory_slices, output_slices, outputs_of
from lierb.kernels.systems.state import State
from lierb.kernels.systems.system_of import system_of


def periods_of(plan: AnyPlan, body: Any) -> Vec:
    """Return the controllers' periods, s."""
    return values(system_of(plan).periods(body)) if controllers_of(plan) else ()


def first_control(plan: AnyPlan, body: Any, start: Any, zero: Any) -> Control:
    """Return outputs and memory before the first tick.

    start : of the run, s.   zero : 0, of the kind of numbers.
    """
    periods = periods_of(plan, body)
    memory = system_of(plan).initial_memory(body) if periods else ()
    return Control(
        (zero,) * size_of(outputs_of(plan)),
        tuple(zero + x for x in memory),
        tuple(zero + _first_tick(start, period) for period in periods),
    )


def _first_tick(start: Any, period: Any) -> Any:
    """Return the number of the first tick that is not before the start."""
    count = plain(start) / period
    whole = rint(count)
    is_whole = absolute(count - whole) <= rounding_at(count)
    return where(is_whole, whole, floor(count) + 1.0)


def is_any_due(plan: AnyPlan, body: Any, control: Control, time: Any, allowed: Any) -> Any:
    """Return where a controller ticks now.   allowed : 1 where controllers may tick."""
    due = allowed < -1.0  # never
    for tick, period in zip(control.ticks, periods_of(plan, body), strict=True):
        due = due | _is_due(time, tick, period, allowed)
    return due


def _is_due(time: Any, tick: Any, period: Any, allowed: Any) -> Any:
    return (allowed > 0.5) & (period * tick - time <= rounding_at(time))


def controlled(
    plan: AnyPlan,
    body: Any,
    state: State,
    control: Control,
    time: Any,
    ticks: Any,
    seed: Any,
    stream: Any,
) -> Control:
    """Run the controllers that are due; each reads the outputs of those before it.

    ticks : 1 where one is due.   seed, stream : of the noise, which has no derivatives.
    """
    system = system_of(plan)
    control = control._replace(ticks=values(control.ticks))
    for number, period in enumerate(periods_of(plan, body)):
        tick = control.ticks[number]
        due = _is_due(time, tick, period, ticks)
        at = with_signals(plan, body, state, control)
        seen = system.motion(at, state, time)
        noise = Noise(seed, stream, tick)
        controls, memory = system.controlled(at, seen, time, number, noise)
        control = Control(
            _set(control.controls, output_slices(plan)[number], controls, due),
            _set(control.memory, memory_slices(plan)[number], memory, due),
            _set(control.ticks, slice(number, number + 1), (tick + 1.0,), due),
        )
    return control


def _set(numbers: Vec, part: slice, new: Vec, mask: Any) -> Vec:
    """Return the numbers with a part replaced where the mask holds."""
    pairs = zip(new, numbers[part], strict=True)
    changed = tuple(where(mask, plain(x), old) for x, old in pairs)
    return numbers[: part.start] + changed + numbers[part.stop :]
