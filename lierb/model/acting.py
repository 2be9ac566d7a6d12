"""Elements of a model: checks, and binding to its bodies, states and controllers."""

from __future__ import annotations

import inspect
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

from lierb.errors import ArgumentError, ForceError, brief, items_of
from lierb.kernels.functions.function import size_of
from lierb.kernels.mechanics.passive_elements import TurnCounter
from lierb.kernels.mechanics.rows import keeps_axis, slides, turns
from lierb.model.functions.binding import bound, columns_of, require_different_events
from lierb.model.functions.column_names import require_free
from lierb.model.functions.constraints import Constraint
from lierb.model.functions.controllers import Controller
from lierb.model.functions.decorated import reject_functions
from lierb.model.functions.elements import Element
from lierb.model.functions.events import Event
from lierb.model.functions.observables import Observable
from lierb.model.functions.states import ExtraStates
from lierb.model.functions.wrenches import Force
from lierb.model.joints.joint import Joint
from lierb.support.representations import quantity

# Arguments of problems and mechanisms that are elements, in the order of all elements.
ELEMENTS: dict[str, type[Element]] = {
    "forces": Force,
    "constraints": Constraint,
    "observables": Observable,
    "events": Event,
    "states": ExtraStates,
    "controllers": Controller,
}
DECORATORS = {
    "forces": "wrench", "constraints": "constraint", "observables": "observable",
    "events": "event", "states": "states", "controllers": "controller",
}  # fmt: skip


def shown_element(element: Element) -> str:
    shapes = element.kind.shapes
    given = (f"{n} {quantity(a, item_axes=len(shapes[n]))}" for n, a in element.parameters.items())
    where = f", on {' and '.join(element.at)}" if element.at else ""
    return f"{element.name}: {', '.join(given) or 'no parameters'}{where}"


def require(argument: str, value: object, kind: type, expected: str) -> None:
    if not isinstance(value, kind):
        hint = "; call it, with its parameters" if callable(value) else ""
        raise ArgumentError(f"{argument} must be {expected}, got {brief(value)}{hint}")


def all_of(argument: str, given: Any, kind: type, one: str, several: str) -> Any:
    """Return the items of an argument, or the one item that it is. Raises ArgumentError."""
    is_one = isinstance(given, str) or not isinstance(given, Iterable)
    items = (given,) if is_one else items_of(argument, given, several)
    for number, item in enumerate(items):
        reject_functions(f"{argument}[{number}]", item)
        if argument in DECORATORS and inspect.isroutine(item):
            name = getattr(item, "__name__", "function")
            raise ArgumentError(
                f"{argument}[{number}] is the function {name}; decorate it with "
                f"@lierb.{DECORATORS[argument]}, and call it, with its parameters if it has any: "
                f"{name}(…)"
            )
        require(f"{argument}[{number}]", item, kind, one)
    return items


def on_one_body(label: str, element: Element, joint: Joint) -> Any:
    """Return the element for a problem's joint; raise if it cannot act there."""
    if element.at:
        raise ArgumentError(
            f"{label} is on {' and '.join(element.at)}; a Problem has one body and no names: "
            "leave .on(…) out, or make a lierb.Mechanism"
        )
    if element.kind.adds_inertia:
        raise ForceError(
            f"{label}, {element.name}, adds inertia, and the equations of a Problem are those "
            "of constant bodies; make a lierb.Mechanism, which can have one link"
        )
    if element.kind.joints > 1:
        raise ForceError(
            f"{label}, {element.name}, couples two joints, and a Problem has one; make a "
            "lierb.Mechanism"
        )
    return fitted(element, joint)


def bind(problem: Any) -> None:
    """Bind functions of a problem or a mechanism to its states and controllers.

    Raises ForceError for a function of states or outputs that do not exist, ArgumentError for
    column names that exist already.
    """
    labels = ("forces", "states", "controllers", "observables", "events")
    parts = bound(*(getattr(problem, label) for label in labels))
    for label, elements in zip(labels, parts, strict=True):
        object.__setattr__(problem, label, elements)
    having = (*problem.forces, *problem.states)
    forces = tuple(_with_index(force, having) for force in problem.forces)
    object.__setattr__(problem, "forces", forces)
    require_different_events(problem.events)
    require_free(problem.observables, columns_of((*having, *problem.controllers)))


def _with_index(force: Force, having: tuple[Element, ...]) -> Force:
    """Return a force that reads a state, its own or its joint's counted angle, with its index.

    having : elements that may have states, in their order.
    """
    turns = getattr(force.kind, "turns", "")
    if not (turns or force.columns):
        return force

    def has_its_state(each: Element) -> bool:
        if not turns:
            return each is force
        is_counter = isinstance(each.kind, TurnCounter) and each.name == turns
        return is_counter and each.at == force.at

    first = 0
    for each in having:
        if has_its_state(each):
            return force.of_kind(index=first)
        first += size_of(each.columns)
    where, place = (f" on {force.at[0]!r}", f".on({force.at[0]!r})") if force.at else ("", "")
    raise ForceError(
        f"{force.name}{where} counts turns by the state {turns}, which does not count those of its "
        f"joint; give states=lierb.turns({turns!r}){place}"
    )


def fitted(element: Any, *joints: Joint) -> Any:
    """Return the element for its joints. Raises ForceError if it has changed or does not fit."""
    element.require_unchanged()
    if element.kind.needs_axis:
        for number, joint in enumerate(joints):
            element = replace(element, kind=element.kind.on_joint(joint.rows, number))
            _require_axis(element, number, joint)
    return element


def _require_axis(element: Element, number: int, joint: Joint) -> None:
    """Raise ForceError if the joint has not the axis at which the element acts."""
    name = f"{element.name} on {element.at[number]!r}" if element.at else element.name
    needs_slide = element.kind.slides_at(number)
    acts = f"{name} acts {'along' if needs_slide else 'about'} the joint axis"
    if not keeps_axis(joint.rows):
        raise ForceError(
            f"{acts}, which a {joint.name} joint does not keep: its body turns about others too; "
            "take a joint such as revolute, or a constant_wrench or lierb.wrench"
        )
    if needs_slide and not slides(joint.rows):
        raise ForceError(
            f"{acts}, along which a {joint.name} joint does not slide; take a joint such as "
            "prismatic, or a torque about the axis"
        )
    if not needs_slide and not turns(joint.rows):
        raise ForceError(
            f"{acts}, about which a {joint.name} joint does not turn; take a joint such as "
            "revolute, or what acts along the axis: motor(force=…), slide_spring, slide_friction "
            "or slide_limit"
        )
