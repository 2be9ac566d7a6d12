"""Bounds on a step: regions in which an element acts, and parts that are searched for events."""

from __future__ import annotations

from typing import Any, NamedTuple

from lierb.kernels.mechanics.passive_elements import UserEvent
from lierb.kernels.numbers.arithmetic import absolute, floor, maximum, minimum, where
from lierb.kernels.numbers.zero import is_zero
from lierb.kernels.stepping.step_size import EPS, INF
from lierb.kernels.systems.plan import AnyPlan
from lierb.kernels.systems.signals import events_of
from lierb.kernels.systems.state import State
from lierb.kernels.systems.system_of import system_of

LEAST_OF_STEP = 1e-9  # least bound, a fraction of a step, so that the next step passes a kink
LEAST_OF_TIME = 1e4 * EPS  # of the time: rounding of a step's ends is less than its slack
MOST_PARTS = 32  # largest number of parts of a step, each searched for events


class Longest(NamedTuple):
    """The longest step, s, and the longest that is accepted if it has been made."""

    step: Any
    made: Any


def longest_step(
    plan: AnyPlan, body: Any, state: State, moved: State, time: Any, h: Any, wanted: Any
) -> Longest | None:
    """Return the longest step from `state` that does not pass over a region in which an element
    acts; None if no element bounds it.

    moved : `state` before the step is tried, its end afterwards.   h : length of the step, s.
    wanted : step that error control proposes, s. The bound is limited from below, relative to it
        and to the rounding of time, so that a trajectory does not stall.
    """
    if not (events_of(plan) or any(element.bounds_steps for element in plan.elements)):
        return None
    system = system_of(plan)
    if state.states:
        body = body._replace(signals=body.signals._replace(states=state.states))
    start = system.motion(body, state, time)
    end = start if moved is state else system.motion(body, moved, time, is_next=True)
    least = maximum(LEAST_OF_STEP * wanted, LEAST_OF_TIME * absolute(time))
    longest = Longest(INF, INF)
    for watched, parts in ((None, 1.0), (UserEvent, float(MOST_PARTS))):
        for rate, distance, slack in system.travel(body, start, end, time, h, watched):
            if not is_zero(rate):
                moves = rate > 0.0
                bound = maximum(parts * distance / where(moves, rate, 1.0), least)
                bound = where(moves, bound, INF)
                made = minimum(longest.made, slack * bound)
                longest = Longest(minimum(longest.step, bound), made)
    return longest


def parts_to_watch(
    plan: AnyPlan, body: Any, state: State, moved: State, trial: Any, watched: type, most: int
) -> Any:
    """Return the number of equal parts of a step that are searched one by one, at most `most`.

    watched : class of the elements whose values are searched for.
    """
    system = system_of(plan)
    start = system.motion(body, state, trial.start)
    end = system.motion(body, moved, trial.start, is_next=True)
    fastest: Any = 0.0 * trial.h
    for at in (start, end):
        for rate, distance, _ in system.travel(body, start, at, trial.start, trial.h, watched):
            if not is_zero(rate):
                fastest = maximum(fastest, rate / distance)
    return minimum(floor(trial.h * fastest) + 1.0, float(most))
