"""Functions of one problem that see its states and what its controllers put out.

Only a problem knows what there is to see: here its elements are bound to each other, and tried.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from functools import lru_cache
from typing import Any, NamedTuple

from lierb.errors import ArgumentError, ForceError
from lierb.kernels.functions.function import Function
from lierb.kernels.functions.shapes import Shape, Shapes
from lierb.kernels.functions.trials import gives_condition, outputs_of
from lierb.model.functions.controllers import Controller, untraceable
from lierb.model.functions.elements import Element, seeing
from lierb.model.functions.events import Event
from lierb.model.functions.states import ExtraStates
from lierb.model.functions.tracing import why_untraced


class Column(NamedTuple):
    """Of a state, or of an output of a controller."""

    name: str
    shape: Shape
    unit: str


def columns_of(elements: Iterable[Element]) -> tuple[Column, ...]:
    """Of all states, then of all that controllers put out, as they stand side by side."""
    elements = tuple(elements)
    return tuple(
        Column(name, shape, each.units.get(name, "1"))
        for kind in (ExtraStates, Controller)
        for each in elements
        if isinstance(each, kind)
        for name, shape in each.columns
    )


Elements = tuple[Any, ...]


def bound(
    states: tuple[ExtraStates, ...], controllers: tuple[Controller, ...], *others: Elements
) -> tuple[Elements, ...]:
    """States, controllers and other elements of a problem, with all functions that see states or
    controls tried on those of the problem.

    Raises ForceError for a function that sees others, or cannot run, or of an event says whether it
    has happened; ArgumentError for names that there are twice.
    """
    _require_different(states)
    states_there = tuple(pair for each in states for pair in each.columns)
    controllers = _with_outputs(controllers, states_there)
    _require_different((*states, *controllers))
    controls = tuple(pair for each in controllers for pair in each.columns)
    parts: tuple[Elements, ...] = (states, controllers, *others)
    found = tuple(tuple(e.bound(states_there, controls) for e in part) for part in parts)
    for each in (e for part in found for e in part if isinstance(e, Event)):
        _require_number(each)
    return found


def _require_number(event: Event) -> None:
    """Raise ForceError for a condition, which crosses nothing: it jumps from 0 to 1."""
    if any(f.is_traced and gives_condition(f) for f in event.kind.functions):
        raise ForceError(
            f"{event.name} returns whether something is so; an event is where a number crosses "
            "zero: return the difference, such as t - 0.3 for t > 0.3, and give direction="
        )


def _require_different(elements: Iterable[ExtraStates | Controller]) -> None:
    """Raise ArgumentError for a name that two have; SQL is blind to case, so are we."""
    owners: dict[str, str] = {}
    for each in elements:
        for name, _ in each.columns:
            if name.lower() in owners:
                raise ArgumentError(
                    f"two are named {name}, of {owners[name.lower()]} and of {each.name}; states "
                    "and outputs of controllers need names of their own"
                )
            owners[name.lower()] = each.name


def require_different_events(events: Iterable[Event]) -> None:
    """Raise ArgumentError for two of one name."""
    seen: set[str] = set()
    for each in events:
        if each.name.lower() in seen:
            raise ArgumentError(
                f"two events are named {each.name}; give one another name: "
                f'{each.name}(…).named("…")'
            )
        seen.add(each.name.lower())


def _with_outputs(controllers: tuple[Controller, ...], states: Shapes) -> tuple[Controller, ...]:
    """All of them with their outputs."""
    unbound = (
        replace(seeing(f, states, ()), outputs=((), *f.outputs[1:]))
        for f in (each.kind.function for each in controllers)
    )
    found = _outputs_together(tuple(unbound))
    return tuple(e.putting_out(outputs) for e, outputs in zip(controllers, found, strict=True))


@lru_cache(64)  # a batch is taken apart, and each part a problem
def _outputs_together(functions: tuple[Function, ...]) -> tuple[Shapes, ...]:
    """What controllers put out, by tracing each with what it sees of the others."""
    found: dict[int, Shapes] = {}
    while len(found) < len(functions):
        known = tuple(pair for i in sorted(found) for pair in found[i])
        waiting = {i: f for i, f in enumerate(functions) if i not in found}
        for i, function in waiting.items():
            outputs = _Lacking().outputs_of(_controlled(function, known))
            if outputs is not None:
                found[i] = outputs
        if found.keys().isdisjoint(waiting):
            found |= _outputs_in_a_ring(waiting, known)
    return tuple(found[i] for i in range(len(functions)))


def _controlled(function: Function, controls: Shapes) -> Function:
    return seeing(function, function.states, controls)


class _Lacking:
    """An attempt to find outputs, and which of the others' it has lacked."""

    name: str | None = None
    reason: str | None = None

    def outputs_of(self, function: Function) -> Shapes | None:
        """Those of the function; None where it sees outputs that are not known."""

        def attempt(given: Function) -> None:
            try:
                outputs_of(given)
            except AttributeError as error:
                if type(error.obj).__name__ == "controls":
                    self.name = error.name
                raise

        self.reason = why_untraced(function, attempt)
        if self.reason is None:
            return outputs_of(function)
        if self.name is None:
            raise untraceable(function, self.reason)
        return None


TRIES = 10  # of guesses at shapes that depend on each other


def _outputs_in_a_ring(functions: dict[int, Function], known: Shapes) -> dict[int, Shapes]:
    """Of controllers that see their own outputs, or each other's: shapes that come out as they went
    in, from numbers on.
    """
    guessed: dict[str, Shape] = {}
    names = ", ".join(function.name for function in functions.values())
    for _ in range(TRIES):
        found: dict[int, Shapes] = {}
        for i, function in functions.items():
            while i not in found:
                lacking = _Lacking()
                seen = (*known, *guessed.items())
                try:
                    outputs = lacking.outputs_of(_controlled(function, seen))
                except ForceError as error:
                    raise ForceError(
                        f"{error} (it sees {', '.join(guessed)}, which depends on it and was taken "
                        "for a number to find its shape; keep in memory what it has put out)"
                    ) from None
                if outputs is not None:
                    found[i] = outputs
                elif lacking.name is not None:
                    guessed[lacking.name] = ()
        shapes = {name: shape for outputs in found.values() for name, shape in outputs}
        for name in guessed:
            if name not in shapes:
                there = ", ".join((*dict(known), *shapes)) or "nothing"
                raise ForceError(
                    f"no controller puts out {name}, which {names} sees; there is {there}"
                )
        if all(shapes[name] == shape for name, shape in guessed.items()):
            return found
        guessed = {name: shapes[name] for name in guessed}
    raise ForceError(
        f"the shapes of what {names} put out depend on each other without end; keep in memory what "
        "they have put out"
    )
