"""Models with other numbers in the same structure of bodies, joints and elements."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from lierb.model.acting import ELEMENTS
from lierb.model.base import Model
from lierb.model.bodies.body import Body
from lierb.model.functions.elements import Element
from lierb.model.joints.joint import Joint
from lierb.model.mechanism.links import Link, Loop
from lierb.model.mechanism.mechanism import Mechanism
from lierb.model.problem import Problem
from lierb.support.arrays import Array, as_numbers, as_poses

Numbers = Mapping[str, Array]  # by field of `Model.inputs`
FRAMES = ("ground_frame", "body_frame")
SCALARS = ("pitch", "length")


def renumbered(model: Model, numbers: Numbers) -> Model:
    """Return a model with other numbers in some of its fields, batched or not.

    numbers : by field of `Model.inputs`, in the shapes that they have there. Raises the errors of
    `lierb.Body`.
    """
    if isinstance(model, Mechanism):
        elements = _elements(model, numbers, "element")
        links = [
            Link(
                x.name, _body(x.body, numbers, f"{i}."), _joint(x.joint, numbers, f"{i}."), x.parent
            )
            for i, x in enumerate(model.links)
        ]
        loops = [
            Loop(x.name, _joint(x.joint, numbers, f"{i}."), x.body, x.parent)
            for i, x in enumerate(model.loops, len(links))
        ]
        return Mechanism(links, loops, numbers.get("gravity", model.gravity), **elements)
    assert isinstance(model, Problem)
    return Problem(
        _body(model.body, numbers), _joint(model.joint, numbers),
        numbers.get("gravity", model.gravity), **_elements(model, numbers, ""),
    )  # fmt: skip


def _body(body: Body, numbers: Numbers, prefix: str = "") -> Body:
    own = {name: numbers.get(f"{prefix}{name}") for name in ("mass", "inertia", "com")}
    if all(x is None for x in own.values()):
        return body
    mass, inertia, com = (getattr(body, k) if x is None else x for k, x in own.items())
    if inertia.ndim == 2 and (mass.ndim or com.ndim > 1):
        inertia = inertia[None]  # without it, a batch of three bodies would be ambiguous
    return Body(mass, inertia, com)


def _joint(joint: Joint, numbers: Numbers, prefix: str = "") -> Joint:
    frames = {name: numbers.get(f"{prefix}{name}") for name in FRAMES}
    scalars = {name: numbers.get(f"{prefix}{name}") for name in SCALARS}
    changed: dict[str, Any] = {k: as_poses(k, x) for k, x in frames.items() if x is not None}
    changed |= {k: as_numbers(k, x, ()) for k, x in scalars.items() if x is not None}
    return replace(joint, **changed) if changed else joint


def _elements(model: Model, numbers: Numbers, prefix: str) -> dict[str, Any]:
    """Return the elements by argument of the constructor."""
    own: dict[str, Any] = {}
    number = 0
    for label in ELEMENTS:
        own[label] = []
        for element in getattr(model, label):
            own[label].append(_element(element, numbers, f"{prefix}{number}."))
            number += 1
    return own


def _element(element: Element, numbers: Numbers, prefix: str) -> Element:
    shapes = element.kind.shapes
    changed = {
        name: as_numbers(name, numbers[f"{prefix}{name}"], shape)
        for name, shape in shapes.items()
        if f"{prefix}{name}" in numbers
    }
    return replace(element, parameters=element.parameters | changed) if changed else element
