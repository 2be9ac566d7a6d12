"""Names of a model's numbers; its parts with other numbers, and their numbers for formulas."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from lierb.errors import ArgumentError, LierbError, brief, unknown_name
from lierb.kernels.functions.shapes import Shape
from lierb.kernels.mechanics.newton_euler import Parameters
from lierb.kernels.mechanics.passive_elements import EVERY, INITIAL, UserController
from lierb.kernels.mechanics.rows import parameters_of as parameters_of_rows
from lierb.kernels.mechanics.spatial import Rigid
from lierb.kernels.numbers.vec import IDENTITY, ZERO3, scale
from lierb.kernels.systems.layout import INPUTS
from lierb.model.acting import ELEMENTS
from lierb.model.bodies.body import Body, moved_inertia
from lierb.model.forces.built_in import BuiltIn
from lierb.model.functions.elements import Element
from lierb.model.functions.ground_motion import MovingGround
from lierb.model.functions.states import ExtraStates
from lierb.model.joints.joint import JOINT, Joint
from lierb.support.arrays import (
    Array,
    Pose,
    as_numbers,
    as_poses,
    as_positive,
    components,
    pose_components,
)

Numbers = Mapping[str, Array]  # by field of `Model.inputs`
POINTS = {  # points of a joint: field of the frame of which each is the origin
    "body_point": "body_frame",
    "ground_point": "ground_frame",
    "parent_point": "ground_frame",
}
BODY = {"mass": 0, "inertia": 2, "com": 1}  # number of axes of an item, by name of the array
FRAMES = ("ground_frame", "body_frame")
INERTIA: tuple[Shape, ...] = (3,), (3, 3)


class Place(NamedTuple):
    """Place of a named number: its field in `Model.inputs`, and the shapes that it may have.

    unit : "" for the number of a user's function.
    kind : "number", "frame", "point", the origin of a frame, or "time", at which an element jumps.
    binds : True for a number of a joint or a constraint, which a start must satisfy.
    copies : further fields that hold the number, of a ground that moves for several links.
    """

    field: str
    shapes: tuple[Shape, ...]
    unit: str = ""
    kind: str = "number"
    binds: bool = False
    copies: tuple[str, ...] = ()


def qualified(owner: str, name: str) -> str:
    """Return a name after that of its link, loop or element; the single body has none."""
    return f"{owner}.{name}" if owner else name


def places_of(model: Any) -> dict[str, Place]:
    """Return the place of each number of a model, by name."""
    places = {"gravity": Place("gravity", ((3,),), "m/s²")}
    for name, field in zip(model.link_names, model.fields, strict=True):
        for own, shapes in {"mass": ((),), "com": ((3,),), "inertia": INERTIA}.items():
            place = Place(f"{field}{own}", shapes, INPUTS.field(own).unit)
            places[qualified(name, f"body.{own}")] = place
    for at, field in zip(model.joints, model.joint_fields, strict=True):
        prefix = qualified(at.name, "joint")
        for point, frame in POINTS.items():
            if at.name or point != "parent_point":
                place = Place(f"{field}{frame}", ((3,),), "m", "point", binds=True)
                places[f"{prefix}.{point}"] = place
        for name, unit in parameters_of_rows(at.joint.rows).items():
            places[f"{prefix}.{name}"] = Place(f"{field}{name}", ((),), unit, binds=True)
        for frame in FRAMES:
            places[f"{prefix}.{frame}"] = Place(f"{field}{frame}", ((4, 4),), kind="frame")
    grounds, of_grounds = _grounds(model), set[str]()
    for element, label, field in labelled(model):
        binds = bool(element.kind.rows)
        period = (EVERY,) if isinstance(element.kind, UserController) else ()
        for name, shape in element.kind.shapes.items():
            kind = "time" if name in (*element.kind.discontinuities, *period) else "number"
            place = Place(f"{field}{name}", (shape,), _unit(element, name), kind, binds)
            own = f"{grounds.get(label, label)}.{element.short(name)}"
            if own in of_grounds:
                places[own] = places[own]._replace(copies=(*places[own].copies, place.field))
                continue
            if own in places:
                raise ArgumentError(
                    f"{own} is a parameter of {element.name}, and a number of the body or joint; "
                    f'give the element another name: {element.name}(…).named("…")'
                )
            places[own] = place
            if label in grounds:
                of_grounds.add(own)
    return places


def _grounds(model: Any) -> dict[str, str]:
    """Return the names of the motions of a ground by those of their parts, forces on the links."""
    by_link: dict[str, list[str]] = {}
    for element, label, _ in labelled(model):
        if isinstance(element, MovingGround) and element.at:
            by_link.setdefault(element.at[0], []).append(label)
    link, own = next(iter(by_link.items()), ("", []))
    names = [label.removeprefix(f"{link}.") for label in own]
    return {
        label: name
        for labels in by_link.values()
        for label, name in zip(labels, names, strict=True)
    }


def owners(model: Any) -> list[str]:
    """Return the names of the elements in those of their numbers; a ground's parts share one."""
    grounds = _grounds(model)
    return [grounds.get(label, label) for _, label, _ in labelled(model)]


def _unit(element: Element, parameter: str) -> str:
    """Return the unit of an element's parameter; empty for a user's, which is unknown."""
    if isinstance(element.kind, BuiltIn):
        return element.kind.unit_of(parameter)
    if isinstance(element, ExtraStates) and parameter.startswith(INITIAL):
        return element.unit_of_column(element.short(parameter))
    return ""


def labelled(model: Any) -> Iterator[tuple[Element, str, str]]:
    """Yield each element with its name, that of its columns, and the prefix of its fields.

    A number follows the name if several elements have it.
    """
    names = [".".join((*e.at[:1], e.name)) for e in model.elements]
    of_each = zip(model.elements, names, model.element_fields, strict=True)
    for i, (element, name, field) in enumerate(of_each):
        number = f"_{names[:i].count(name) + 1}" if names.count(name) > 1 else ""
        yield element, f"{name}{number}", field


def by_field(model: Any, given: Mapping[str, Any]) -> dict[str, Array]:
    """Return named numbers by field of `Model.inputs`, in the shapes that they have there.

    Raises LierbError for names that do not exist, and for numbers of other shapes.
    """
    if not isinstance(given, Mapping):
        raise ArgumentError(
            f"numbers={brief(given)}; expected a dictionary such as {{'body.mass': 2.0}}"
        )
    places = places_of(model)
    numbers: dict[str, Array] = {}
    for name, value in given.items():
        if name not in places:
            raise unknown_name("numbers", name, places)
        place = places[name]
        field, shapes = place.field, place.shapes
        if field in numbers and place.kind != "point":
            raise ArgumentError(f"{name} and a point of it are given; give one of them")
        if place.kind == "point":
            before = numbers.get(field, model.inputs[field])
            numbers[field] = _moved(before, as_numbers(name, value, *shapes))
        elif place.kind == "frame":
            numbers[field] = as_poses(name, value)
        elif name.endswith("joint.length"):
            numbers[field] = as_positive(name, value, "m")
        else:
            array = as_numbers(name, value, *shapes)
            is_principal = shapes is INERTIA and array.shape[-2:] != (3, 3)
            numbers[field] = array[..., :, None] * np.eye(3) if is_principal else array
        numbers |= dict.fromkeys(place.copies, numbers[field])
    return numbers


def _moved(frame: Array, origin: Array) -> Array:
    lead = np.broadcast_shapes(frame.shape[:-2], origin.shape[:-1])
    moved = np.array(np.broadcast_to(frame, (*lead, 4, 4)))
    moved[..., :3, 3] = origin
    return moved


# ---- parts of a model with other numbers -------------------------------------------------------


def body_with(
    body: Body, numbers: Numbers, field: str, name: str = "", about: str = "origin"
) -> Body:
    """Return a body with other numbers. Raises the errors of `lierb.Body`.

    name : its link.   about : point of inertias, those given and the one kept.
    """
    own = [numbers.get(f"{field}{each}") for each in BODY]
    if all(x is None for x in own):
        return body
    mass, inertia, com = (
        getattr(body, k) if x is None else x for k, x in zip(BODY, own, strict=True)
    )
    if about == "com" and own[1] is None:
        inertia = moved_inertia(body.mass, body.inertia, body.com, -1.0)
    if inertia.ndim == 2 and (mass.ndim or com.ndim > 1):
        inertia = inertia[None]  # without it, a batch of three bodies would be ambiguous
    try:
        return Body(mass, inertia, com, about=about)
    except LierbError as error:
        raise type(error)(f"{name}: {error}" if name else str(error)) from None


def joint_with(joint: Joint, numbers: Numbers, field: str) -> Joint:
    """Return a joint with other frames, pitch or length."""
    changed: dict[str, Any] = {
        name: numbers[f"{field}{name}"] for name in JOINT if f"{field}{name}" in numbers
    }
    return replace(joint, **changed) if changed else joint


def elements_with(model: Any, numbers: Numbers) -> dict[str, list[Element]]:
    """Return a model's elements with other parameters, by argument of its constructor."""
    labels = {label: len(getattr(model, label)) for label in ELEMENTS}
    elements = iter(_element(*each, numbers) for each in labelled(model))
    return {label: [next(elements) for _ in range(count)] for label, count in labels.items()}


def _element(element: Element, label: str, field: str, numbers: Numbers) -> Element:
    changed = {n: numbers[f"{field}{n}"] for n in element.kind.shapes if f"{field}{n}" in numbers}
    if not changed:
        return element
    try:
        return replace(element, parameters=element.parameters | changed).checked()
    except LierbError as error:
        raise type(error)(f"{label}: {error}") from None


# ---- numbers as formulas take them --------------------------------------------------------------


def parameters_of(body: Body, joint: Joint | None, gravity: Array) -> Parameters:
    """Return the parameters of a body for formulas; without a joint, its frame is the body's."""
    own: Pose = (IDENTITY, ZERO3)
    return Parameters(
        mass=body.mass,
        inertia=components(body.inertia, 2),
        com=components(body.com),
        gravity=components(gravity),
        ground=own if joint is None else pose_components(joint.ground_frame),
        body=own if joint is None else pose_components(joint.body_frame),
        pitch=np.float64(0.0) if joint is None else joint.pitch,
        length=np.float64(0.0) if joint is None else joint.length,
    )


def rigid_of(body: Body) -> Rigid:
    """Return the mass, first moment and inertia of a body, one array per component."""
    moment = scale(body.mass, components(body.com))
    return Rigid(body.mass, moment, components(body.inertia, 2))


def numbers_of(elements: Sequence[Element]) -> list[Array]:
    """Return the parameters of elements, one array per component."""
    return [
        x
        for element in elements
        for name, shape in element.kind.shapes.items()
        for x in components(element.parameters[name], len(shape))
    ]
