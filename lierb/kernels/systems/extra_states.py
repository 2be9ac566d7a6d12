"""The user's own states, and what controllers hold between ticks, as a trajectory carries them."""

from __future__ import annotations

from collections.abc import Iterator
from math import prod
from typing import Any, NamedTuple

from lierb.kernels.functions.signals import Signals
from lierb.kernels.numbers.vec import Vec
from lierb.kernels.systems.plan import AnyPlan
from lierb.kernels.systems.signals import controllers_of, states_of
from lierb.kernels.systems.state import State
from lierb.kernels.systems.system_of import system_of


class Held(NamedTuple):
    """What controllers have set.

    controls, memory : of all of them, side by side.
    ticks : of each, the number of the next one: it runs at the multiples of its period.
    """

    controls: Vec
    memory: Vec
    ticks: Vec


def with_signals(plan: AnyPlan, body: Any, state: State, held: Held) -> Any:
    """The body as functions of the user's see it at a time."""
    if not (states_of(plan) or controllers_of(plan)):
        return body
    return body._replace(signals=Signals(state.states, held.controls, held.memory))


def with_states(body: Any, states: Vec) -> Any:
    """The body in a stage of a step: with other states, and what is held."""
    return body._replace(signals=body.signals._replace(states=states)) if states else body


def in_states(plan: AnyPlan, numbers: Vec) -> Iterator[Vec]:
    """The numbers of each of the user's states."""
    first = 0
    for _, shape in states_of(plan):
        yield numbers[first : first + prod(shape)]
        first += prod(shape)


def rates_of_states(plan: AnyPlan, body: Any, state: State, time: Any) -> Vec:
    """Their derivatives."""
    system = system_of(plan)
    found: Vec = system.state_rates(body, system.seen(body, state, time), time)
    return found
