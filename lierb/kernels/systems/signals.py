"""What watches a motion or has states and outputs of its own, asked of any system.

Observables, events, extra states and controllers. All numbers stand side by side, in the order of
the plan's elements.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from itertools import accumulate
from typing import Any, TypeVar

from lierb.kernels.functions.function import size_of
from lierb.kernels.functions.shapes import Shapes
from lierb.kernels.functions.signals import Noise
from lierb.kernels.mechanics.elements import (
    Bound,
    UserController,
    UserEvent,
    UserObservable,
    UserStates,
)
from lierb.kernels.mechanics.newton_euler import Motion
from lierb.kernels.numbers.arithmetic import sqrt
from lierb.kernels.numbers.vec import Vec
from lierb.kernels.systems.layout import LANE_END, Columns, Field
from lierb.kernels.systems.plan import AnyPlan

Kind = TypeVar("Kind", UserObservable, UserEvent, UserStates, UserController)


@lru_cache(64)
def states_of(plan: AnyPlan) -> Shapes:
    """All extra states, by name."""
    return tuple(pair for e in plan.elements if isinstance(e, UserStates) for pair in e.states)


@lru_cache(64)
def outputs_of(plan: AnyPlan) -> Shapes:
    """All that controllers put out, by name."""
    return tuple(pair for e in controllers_of(plan) for pair in e.outputs)


@lru_cache(64)
def memory_of(plan: AnyPlan) -> Shapes:
    """All memory of controllers, one after the other; two may have the same names."""
    return tuple(pair for e in controllers_of(plan) for pair in e.memory)


def signals_width(plan: AnyPlan) -> int:
    """Numbers of all extra states and outputs."""
    return size_of(states_of(plan)) + size_of(outputs_of(plan))


@lru_cache(64)
def lane_end(plan: AnyPlan) -> Columns:
    """What a trajectory leaves beside its state, for a run that goes on: the rank of its rows at
    the start, and what belongs to a clock of its own.
    """
    rank = Field("dropped", (int(plan.keeps_rank),))
    if not plan.has_lane_clocks:
        return Columns(rank)
    return Columns(
        rank,
        *LANE_END.fields,
        Field("controls", (size_of(outputs_of(plan)),)),
        Field("memory", (size_of(memory_of(plan)),)),
        Field("ticks", (len(controllers_of(plan)),)),
    )


@lru_cache(64)
def controllers_of(plan: AnyPlan) -> tuple[UserController, ...]:
    """By their numbers."""
    return tuple(e for e in plan.elements if isinstance(e, UserController))


@lru_cache(64)
def events_of(plan: AnyPlan) -> tuple[UserEvent, ...]:
    """By their numbers."""
    return tuple(e for e in plan.elements if isinstance(e, UserEvent))


@lru_cache(64)
def memory_slices(plan: AnyPlan) -> tuple[slice, ...]:
    """Where in all memory that of each controller is."""
    ends = [0, *accumulate(size_of(each.memory) for each in controllers_of(plan))]
    return tuple(map(slice, ends, ends[1:]))


@lru_cache(64)
def output_slices(plan: AnyPlan) -> tuple[slice, ...]:
    """Where in all held outputs those of each controller are."""
    ends = [0, *accumulate(size_of(each.outputs) for each in controllers_of(plan))]
    return tuple(map(slice, ends, ends[1:]))


class Watching:
    """Of a system: what its passive elements give. They see `body.signals`."""

    plan: Any

    def motions(self, body: Any, seen: Any, time: Any) -> Callable[[int], Motion]:
        """What the element of each number sees of a motion, with the signals.

        seen : from `seen`.
        """
        raise NotImplementedError

    def _all(self, kind: type[Kind], body: Any) -> list[tuple[int, Kind, Any]]:
        """The elements of a kind: number, element, what it is made of."""
        pairs = zip(self.plan.elements, body.elements, strict=True)
        return [(i, e, own) for i, (e, own) in enumerate(pairs) if isinstance(e, kind)]

    def travel(
        self, body: Any, start: Any, end: Any, time: Any, watched: bool
    ) -> tuple[Bound, ...]:
        """Bounds on a step, or, where `watched`, on the part of one in which events are looked for.

        start, end : from `seen`.
        """
        size = sqrt(body.girth)
        before, after = (self.motions(body, seen, time) for seen in (start, end))
        pairs = enumerate(zip(self.plan.elements, body.elements, strict=True))
        return tuple(
            bound
            for i, (e, own) in pairs
            if (isinstance(e, UserEvent) if watched else e.bounds_steps)
            for bound in e.travel(own, before(i), after(i), size)
        )

    def jumps(self, body: Any) -> tuple[Any, ...]:
        """Times at which elements may jump, s."""
        pairs = zip(self.plan.elements, body.elements, strict=True)
        return tuple(time for e, own in pairs for time in e.jumps(own))

    def observed(self, body: Any, seen: Any, time: Any) -> tuple[Any, ...]:
        """Each observable's value."""
        return self._values(UserObservable, body, seen, time)

    def events(self, body: Any, seen: Any, time: Any) -> tuple[Any, ...]:
        """Each event's value."""
        return self._values(UserEvent, body, seen, time)

    def events_nearby(self, body: Any, seen: Any, time: Any) -> tuple[Any, ...]:
        """Each event's value where the motion is off by some roundings."""
        x = self.motions(body, seen, time)
        return tuple(e.value_nearby(own, x(i)) for i, e, own in self._all(UserEvent, body))

    def _values(self, kind: Any, body: Any, seen: Any, time: Any) -> tuple[Any, ...]:
        found = self._all(kind, body)
        if not found:
            return ()
        x = self.motions(body, seen, time)
        return tuple(e.value(own, x(i)) for i, e, own in found)

    def state_rates(self, body: Any, seen: Any, time: Any) -> Vec:
        """The derivatives of all extra states."""
        found = self._all(UserStates, body)
        if not found:
            return ()
        x = self.motions(body, seen, time)
        return tuple(rate for i, e, own in found for rate in e.rates(own, x(i)))

    def initial_states(self, body: Any) -> Vec:
        """Of all extra states."""
        return tuple(y for _, e, own in self._all(UserStates, body) for y in e.initial(own))

    def initial_memory(self, body: Any) -> Vec:
        """Of all controllers."""
        return tuple(y for _, e, own in self._all(UserController, body) for y in e.initial(own))

    def periods(self, body: Any) -> Vec:
        """Of all controllers, s."""
        return tuple(e.every(own) for _, e, own in self._all(UserController, body))

    def controlled(
        self, body: Any, seen: Any, time: Any, which: int, noise: Noise
    ) -> tuple[Vec, Vec]:
        """Outputs and memory of controller number `which`, its own alone.

        body.signals : with the memory of all controllers.
        """
        i, element, own = self._all(UserController, body)[which]
        x = self.motions(body, seen, time)(i)
        memory = x.signals.memory[memory_slices(self.plan)[which]]
        return element.called(own, x._replace(signals=x.signals._replace(memory=memory)), noise)
