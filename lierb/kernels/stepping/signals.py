"""The user's own states, and controls that are held between ticks, as trajectories carry them."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from math import prod
from typing import Any, NamedTuple

from lierb.kernels.mechanics.elements import Signals, UserController, UserEvent, UserStates
from lierb.kernels.numbers.vec import Vec
from lierb.kernels.stepping.plan import AnyPlan
from lierb.kernels.stepping.state import State
from lierb.kernels.stepping.systems import system_of

Shapes = tuple[tuple[str, tuple[int, ...]], ...]


class Held(NamedTuple):
    """What controllers have set.

    ticks : of each, the number of the next: it runs at multiples of its period.
    """

    controls: Vec
    memory: Vec
    ticks: Vec


@lru_cache(64)
def controllers_of(plan: AnyPlan) -> tuple[UserController, ...]:
    return tuple(e for e in plan.elements if isinstance(e, UserController))


@lru_cache(64)
def events_of(plan: AnyPlan) -> tuple[UserEvent, ...]:
    return tuple(e for e in plan.elements if isinstance(e, UserEvent))


@lru_cache(64)
def states_of(plan: AnyPlan) -> Shapes:
    """Names and shapes of the user's states."""
    return tuple(s for e in plan.elements if isinstance(e, UserStates) for s in e.states)


@lru_cache(64)
def controls_of(plan: AnyPlan) -> Shapes:
    return tuple(s for e in controllers_of(plan) for s in e.outputs)


@lru_cache(64)
def memory_of(plan: AnyPlan) -> Shapes:
    return tuple(s for e in controllers_of(plan) for s in e.memory)


def width_of(shapes: Shapes) -> int:
    return sum(prod(shape) for _, shape in shapes)


def in_states(plan: AnyPlan, numbers: Vec) -> Iterator[Vec]:
    """The numbers of each of the user's states."""
    first = 0
    for _, shape in states_of(plan):
        yield numbers[first : first + prod(shape)]
        first += prod(shape)


def has_signals(plan: AnyPlan) -> bool:
    return bool(states_of(plan) or controllers_of(plan))


def seen_by_functions(plan: AnyPlan, body: Any, state: State, held: Held) -> Any:
    """The body as functions of the user's see it: with states and controls."""
    if not has_signals(plan):
        return body
    return body._replace(signals=Signals(state.states, held.controls, held.memory))


def rates_of_states(plan: AnyPlan, body: Any, state: State, time: Any) -> Vec:
    """Derivatives of the user's states."""
    system = system_of(plan)
    found: Vec = system.state_rates(body, system.seen(body, state, time), time)
    return found
