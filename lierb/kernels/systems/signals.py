"""Observables, events, extra states and controllers of any system.

Their numbers are concatenated in the order of the plan's elements.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from itertools import accumulate
from typing import Any, TypeVar

from lierb.kernels.functions.function import size_of
from lierb.kernels.functions.shapes import Shapes
from lierb.kernels.functions.signals import Noise
from lierb.kernels.mechanics.kinks import Bound
from lierb.kernels.mechanics.newton_euler import Motion
from lierb.kernels.mechanics.passive_elements import (
    AddedStates,
    UserController,
    UserEvent,
    UserObservable,
)
from lierb.kernels.numbers.arithmetic import sqrt
from lierb.kernels.numbers.vec import Vec
from lierb.kernels.numbers.zero import ZERO
from lierb.kernels.systems.layout import LANE_END, Columns, Field
from lierb.kernels.systems.plan import AnyPlan

Kind = TypeVar("Kind", UserObservable, UserEvent, AddedStates, UserController)


@lru_cache(64)
def states_of(plan: AnyPlan) -> Shapes:
    """All extra states, by name."""
    return tuple(pair for e in plan.elements if isinstance(e, AddedStates) for pair in e.states)


@lru_cache(64)
def outputs_of(plan: AnyPlan) -> Shapes:
    """All outputs of controllers, by name."""
    return tuple(pair for e in controllers_of(plan) for pair in e.outputs)


@lru_cache(64)
def memory_of(plan: AnyPlan) -> Shapes:
    """Memory of all controllers, in order; two controllers may use the same names."""
    return tuple(pair for e in controllers_of(plan) for pair in e.memory)


def signals_width(plan: AnyPlan) -> int:
    """Number of components of all extra states and outputs."""
    return size_of(states_of(plan)) + size_of(outputs_of(plan))


HELD = ("controls", "memory")  # fields of controllers that have derivatives


@lru_cache(64)
def controller_fields(plan: AnyPlan) -> tuple[Field, ...]:
    """Fields of controllers between ticks: outputs, memory, number of the next tick."""
    return (
        Field("controls", (size_of(outputs_of(plan)),)),
        Field("memory", (size_of(memory_of(plan)),)),
        Field("ticks", (len(controllers_of(plan)),)),
    )


@lru_cache(64)
def lane_end(plan: AnyPlan) -> Columns:
    """Columns, beside the state, from which another run can continue: the rank of the rows at the
    start, and the clock and controllers of a lane.
    """
    rank = Field("dropped", (int(plan.keeps_rank),))
    if not plan.has_lane_clocks:
        return Columns(rank)
    return Columns(rank, *LANE_END.fields, *controller_fields(plan))


@lru_cache(64)
def controllers_of(plan: AnyPlan) -> tuple[UserController, ...]:
    """Controllers, by number."""
    return tuple(e for e in plan.elements if isinstance(e, UserController))


@lru_cache(64)
def events_of(plan: AnyPlan) -> tuple[UserEvent, ...]:
    """Events, by number."""
    return tuple(e for e in plan.elements if isinstance(e, UserEvent))


@lru_cache(64)
def memory_slices(plan: AnyPlan) -> tuple[slice, ...]:
    """Slice of each controller in the memory of all."""
    return _slices(*(size_of(each.memory) for each in controllers_of(plan)))


@lru_cache(64)
def output_slices(plan: AnyPlan) -> tuple[slice, ...]:
    """Slice of each controller in the outputs of all."""
    return _slices(*(size_of(each.outputs) for each in controllers_of(plan)))


def _slices(*widths: int) -> tuple[slice, ...]:
    ends = [0, *accumulate(widths)]
    return tuple(map(slice, ends, ends[1:]))


class PassiveElements:
    """Evaluation of a system's passive elements, which read `body.signals`.

    A `motion` is that of `System.motion`.
    """

    plan: Any

    motion: Callable[..., Any]
    motions: Callable[..., Callable[[int], Motion]]  # motion by element index
    felt: Callable[..., Callable[[int], Vec]]  # `Motion.felt` by element index

    def travel(
        self, body: Any, start: Any, end: Any, time: Any, h: Any, watched: type | None
    ) -> tuple[Bound, ...]:
        """Bounds on a step's length; on that of its parts for elements of the class `watched`.

        start, end : motions at the ends of a step, of length h, s; one before it is tried.
        """
        size, bounds = sqrt(body.girth), list[Bound]()
        before, after = (self.motions(body, motion, time) for motion in (start, end))
        for i, (e, own) in enumerate(zip(self.plan.elements, body.elements, strict=True)):
            if isinstance(e, watched) if watched else e.bounds_steps:
                first = before(i)
                bounds += e.travel(own, first, first if end is start else after(i), h, size)
        return tuple(bounds)

    def jumps(self, body: Any) -> tuple[Any, ...]:
        """Times at which elements may jump, s."""
        pairs = zip(self.plan.elements, body.elements, strict=True)
        return tuple(time for e, own in pairs for time in e.jumps(own))

    def observed(self, body: Any, motion: Any, time: Any) -> tuple[Any, ...]:
        """Value of each observable."""
        return self._values(UserObservable, body, motion, time)

    def events(self, body: Any, motion: Any, time: Any) -> tuple[Any, ...]:
        """Value of each event's function."""
        return self._values(UserEvent, body, motion, time)

    def events_nearby(self, body: Any, motion: Any, time: Any) -> tuple[Any, ...]:
        """Value of each event's function at a motion perturbed by some rounding errors."""
        elements = self._all(UserEvent, body)
        x = self._seen(elements, body, motion, time)
        return tuple(e.value_nearby(own, x(i)) for i, e, own in elements)

    def state_rates(self, body: Any, motion: Any, time: Any) -> Vec:
        """Derivatives of all extra states."""
        elements = self._all(AddedStates, body)
        if not elements:
            return ()
        x = self.motions(body, motion, time)
        return tuple(rate for i, e, own in elements for rate in e.rates(own, x(i)))

    def initial_states(self, body: Any, state: Any) -> Vec:
        """Initial values of all extra states.   state : the state at the start without them."""
        elements = self._all(AddedStates, body)
        motion_of: Callable[[int], Motion | None] = lambda _: None
        if any(e.depends_on_pose for _, e, _ in elements):
            motion_of = self.motions(body, self.motion(body, state, ZERO, is_next=True), ZERO)
        return tuple(y for i, e, own in elements for y in e.at_start(own, motion_of(i)))

    def initial_memory(self, body: Any) -> Vec:
        """Initial memory of all controllers."""
        return tuple(y for _, e, own in self._all(UserController, body) for y in e.initial(own))

    def periods(self, body: Any) -> Vec:
        """Periods of all controllers, s."""
        return tuple(e.every(own) for _, e, own in self._all(UserController, body))

    def controlled(
        self, body: Any, motion: Any, time: Any, which: int, noise: Noise
    ) -> tuple[Vec, Vec]:
        """Outputs and memory of controller number `which` only.

        body.signals : signals, with the memory of all controllers.
        """
        i, element, own = self._all(UserController, body)[which]
        x = self._seen([(i, element, own)], body, motion, time)(i)
        memory = x.signals.memory[memory_slices(self.plan)[which]]
        return element.called(own, x._replace(signals=x.signals._replace(memory=memory)), noise)

    def _all(self, kind: type[Kind], body: Any) -> list[tuple[int, Kind, Any]]:
        """Index, element and parameters of all elements of a kind."""
        pairs = zip(self.plan.elements, body.elements, strict=True)
        return [(i, e, own) for i, (e, own) in enumerate(pairs) if isinstance(e, kind)]

    def _values(self, kind: Any, body: Any, motion: Any, time: Any) -> tuple[Any, ...]:
        elements = self._all(kind, body)
        if not elements:
            return ()
        x = self._seen(elements, body, motion, time)
        return tuple(e.value(own, x(i)) for i, e, own in elements)

    def _seen(
        self, elements: Sequence[tuple[int, Any, Any]], body: Any, motion: Any, time: Any
    ) -> Callable[[int], Motion]:
        """Motion by element index, with accelerations if one of the elements takes them."""
        motions = self.motions(body, motion, time)
        if not any(element.feels for _, element, _ in elements):
            return motions
        felt = self.felt(body, motion, time)
        return lambda i: motions(i)._replace(felt=felt(i))
