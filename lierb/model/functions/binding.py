"""Bind a problem's functions to its extra states and controllers' outputs."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from functools import lru_cache
from typing import Any, NamedTuple

from lierb.errors import ArgumentError, ForceError
from lierb.kernels.functions.function import Function
from lierb.kernels.functions.shapes import Shape, Shapes
from lierb.kernels.functions.trials import outputs_of, returns_condition
from lierb.model.functions.controllers import Controller, untraceable
from lierb.model.functions.elements import Element, seeing
from lierb.model.functions.events import Event
from lierb.model.functions.states import ExtraStates
from lierb.model.functions.tracing import why_untraced
from lierb.model.functions.wrenches import Force


class Column(NamedTuple):
    """A column belongs to an extra state or to an output of a controller."""

    name: str
    shape: Shape
    unit: str


def columns_of(elements: Iterable[Element]) -> tuple[Column, ...]:
    """Return the columns of all extra states, then of all outputs, in the order of `Signals`."""
    return tuple(
        Column(name, shape, each.unit_of_column(name))
        for each in sorted(elements, key=lambda e: isinstance(e, Controller))
        for name, shape in each.columns
    )


Elements = tuple[Any, ...]


def bound(
    forces: tuple[Force, ...],
    states: tuple[ExtraStates, ...],
    controllers: tuple[Controller, ...],
    *others: Elements,
) -> tuple[Elements, ...]:
    """Bind forces, states, controllers and other elements to the problem's states and outputs.

    Raises ForceError for a function that takes states or outputs that do not exist, for one that
    cannot run, and for an event that returns a condition; ArgumentError for a name that occurs
    twice.
    """
    _require_different((*forces, *states))
    state_columns = tuple(pair for each in (*forces, *states) for pair in each.columns)
    controllers = _with_outputs(controllers, state_columns)
    _require_different((*forces, *states, *controllers))
    output_columns = tuple(pair for each in controllers for pair in each.columns)
    parts: tuple[Elements, ...] = (forces, states, controllers, *others)
    result = tuple(tuple(e.bound(state_columns, output_columns) for e in part) for part in parts)
    for each in (e for part in result for e in part if isinstance(e, Event)):
        _require_number(each)
    return result


def _require_number(event: Event) -> None:
    """Raise ForceError if an event is a condition, which jumps instead of crossing zero."""
    if any(f.is_traced and returns_condition(f) for f in event.kind.functions):
        raise ForceError(
            f"{event.name} returns a condition; an event is where a number crosses zero: return "
            "the difference, such as t - 0.3 for t > 0.3, and give direction="
        )


def _require_different(elements: Iterable[Element]) -> None:
    """Raise ArgumentError for a name that occurs twice; SQL ignores case."""
    owners: dict[str, str] = {}
    for each in elements:
        for name, _ in each.columns:
            if name.lower() in owners:
                hint = ', such as state="…" of a force' if isinstance(each, Force) else ""
                raise ArgumentError(
                    f"two states or outputs are named {name}, of {owners[name.lower()]} and of "
                    f"{each.name}; give each state and each output its own name{hint}"
                )
            owners[name.lower()] = each.name


def require_different_events(events: Iterable[Event]) -> None:
    """Raise ArgumentError if two events have the same name."""
    seen: set[str] = set()
    for each in events:
        if each.name.lower() in seen:
            raise ArgumentError(
                f"two events are named {each.name}; give one another name: "
                f'{each.name}(…).named("…")'
            )
        seen.add(each.name.lower())


def _with_outputs(controllers: tuple[Controller, ...], states: Shapes) -> tuple[Controller, ...]:
    """Return copies of the controllers with the names and shapes of their outputs."""
    unbound = (
        replace(seeing(f, states, ()), outputs=((), *f.outputs[1:]))
        for f in (each.kind.function for each in controllers)
    )
    outputs = _outputs_together(tuple(unbound))
    return tuple(e.with_outputs(shapes) for e, shapes in zip(controllers, outputs, strict=True))


@lru_cache(64)  # each part of a batch is a problem
def _outputs_together(functions: tuple[Function, ...]) -> tuple[Shapes, ...]:
    """Return the shapes of controllers' outputs, each traced with known outputs of the others."""
    outputs: dict[int, Shapes] = {}
    while len(outputs) < len(functions):
        known = tuple(pair for i in sorted(outputs) for pair in outputs[i])
        waiting = {i: f for i, f in enumerate(functions) if i not in outputs}
        for i, function in waiting.items():
            shapes, _ = _outputs_or_unknown(function, known)
            if shapes is not None:
                outputs[i] = shapes
        if outputs.keys().isdisjoint(waiting):
            outputs |= _outputs_in_a_ring(waiting, known)
    return tuple(outputs[i] for i in range(len(functions)))


def _outputs_or_unknown(function: Function, known: Shapes) -> tuple[Shapes | None, str]:
    """Trace a controller; return its outputs, or None and the name of an unknown one it takes.

    known : known outputs of all controllers.
    """
    controlled = seeing(function, function.states, known)
    unknown = ""

    def attempt(traced: Function) -> None:
        nonlocal unknown
        try:
            outputs_of(traced)
        except AttributeError as error:
            if type(error.obj).__name__ == "controls":
                unknown = error.name or ""
            raise

    reason = why_untraced(controlled, attempt)
    if reason is None:
        return outputs_of(controlled), ""
    if not unknown:
        raise untraceable(controlled, reason)
    return None, unknown


TRIES = 10  # largest number of guesses at shapes that depend on each other


def _outputs_in_a_ring(functions: dict[int, Function], known: Shapes) -> dict[int, Shapes]:
    """Return the outputs of controllers that take their own outputs, or each other's.

    The first guess is that all outputs are numbers. Tracing is repeated with the shapes that it
    returns, until they no longer change.
    """
    guessed: dict[str, Shape] = {}
    names = ", ".join(function.name for function in functions.values())
    for _ in range(TRIES):
        outputs: dict[int, Shapes] = {}
        for i, function in functions.items():
            while i not in outputs:
                try:
                    traced, unknown = _outputs_or_unknown(function, (*known, *guessed.items()))
                except ForceError as error:
                    raise ForceError(
                        f"{error} (it reads {', '.join(guessed)}, which depends on it and was "
                        "assumed to be a number; keep the output in memory instead)"
                    ) from None
                if traced is None:
                    guessed[unknown] = ()
                else:
                    outputs[i] = traced
        shapes = {name: shape for pairs in outputs.values() for name, shape in pairs}
        for name in guessed:
            if name not in shapes:
                existing = ", ".join((*dict(known), *shapes)) or "nothing"
                raise ForceError(
                    f"no controller has the output {name}, which {names} reads; there is {existing}"
                )
        if all(shapes[name] == shape for name, shape in guessed.items()):
            return outputs
        guessed = {name: shapes[name] for name in guessed}
    raise ForceError(
        f"the shapes of the outputs of {names} depend on each other without end; keep these "
        "outputs in memory instead"
    )
