"""A trajectory has extra states, and outputs of its controllers between ticks."""

from __future__ import annotations

from collections.abc import Iterator
from math import prod
from typing import Any, NamedTuple

from lierb.kernels.functions.signals import Signals
from lierb.kernels.numbers.vec import Vec
from lierb.kernels.systems.plan import AnyPlan
from lierb.kernels.systems.signals import controllers_of, states_of
from lierb.kernels.systems.state import State
from lierb.kernels.systems.system import AnySystem


class Control(NamedTuple):
    """Hold the outputs and memory of all controllers between ticks, concatenated.

    ticks : number of each controller's next tick; ticks are at multiples of its period.
    """

    controls: Vec
    memory: Vec
    ticks: Vec


def with_signals(plan: AnyPlan, body: Any, state: State, control: Control) -> Any:
    """Return the body with extra states, outputs and memory, for users' functions."""
    if not (states_of(plan) or controllers_of(plan)):
        return body
    return body._replace(signals=Signals(state.states, control.controls, control.memory))


def with_states(body: Any, state: State) -> Any:
    """Return the body with the extra states of a state in place of its own, if it has any."""
    if not state.states:
        return body
    return body._replace(signals=body.signals._replace(states=state.states))


def with_initial_states(system: AnySystem, body: Any, state: State, zero: Any) -> State:
    """Return the state at the start with the extra states.   zero : 0, of the kind of numbers."""
    own = system.initial_states(body, state) if states_of(system.plan) else ()
    return state._replace(states=tuple(zero + x for x in own))


def in_states(plan: AnyPlan, numbers: Vec) -> Iterator[Vec]:
    """Yield the numbers of each extra state."""
    first = 0
    for _, shape in states_of(plan):
        yield numbers[first : first + prod(shape)]
        first += prod(shape)
