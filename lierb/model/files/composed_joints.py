"""Compose the simple joints of a body into one joint of the catalogue.

Files describe a joint with several degrees of freedom as a sequence of hinges, slides and balls,
C = C₀ exp(S₁q₁) exp(S₂q₂) …, all in the axes of the body at q = 0. The sequence is replaced by one
joint of the catalogue with the same motions, if there is one.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from lierb.model import joints
from lierb.model.joints.joint import Joint
from lierb.support.arrays import Array

PARALLEL = 1e-9  # largest sine of the angle between parallel axes, cosine for right angles
MEETING = 1e-9  # m, largest distance between axes that meet: files have rounded numbers


class SimpleJoint(NamedTuple):
    """Hinge, slide, ball or free joint of a file; axis and point are in the body at q = 0."""

    kind: str
    axis: Array
    point: Array


def composed(sequence: list[SimpleJoint], placed: Array) -> list[Joint]:
    """Return one joint for the whole sequence, or else one for each of its members.

    placed : (4, 4), C₀ in the parent's body frame.
    """
    whole = _of_catalogue(sequence)
    return _joints([whole], placed) if whole else separate(sequence, placed)


def separate(sequence: list[SimpleJoint], placed: Array) -> list[Joint]:
    """Return one joint for each member of the sequence, placed as in `composed`."""
    return _joints([_single(x) for x in sequence], placed)


def _joints(entries: list[tuple[str, Array]], placed: Array) -> list[Joint]:
    return [
        joints.JOINTS[name](body_frame=frame, parent_frame=frame if k else placed @ frame)
        for k, (name, frame) in enumerate(entries)
    ]


def _of_catalogue(sequence: list[SimpleJoint]) -> tuple[str, Array] | None:
    """Return the name of the joint and its frame in the body, (4, 4); None if there is none."""
    if not sequence:
        return "fixed", np.eye(4)
    if len(sequence) == 1:
        return _single(sequence[0])
    kinds = [x.kind for x in sequence]
    hinges = [x for x in sequence if x.kind == "hinge"]
    slides = [x.axis for x in sequence if x.kind == "slide"]
    if len(slides) > 1 and np.linalg.svd(slides, compute_uv=False)[-1] < 1e-6:
        return None  # two along one line, or three in a plane
    turns = [*hinges, *(x for x in sequence if x.kind == "ball")]
    if "free" in kinds or len(turns) + len(slides) != len(sequence):
        return None
    if len(turns) == kinds.count("ball") == 1 and len(slides) == 3:
        return "free", _at(turns[0].point)
    if len(turns) != len(hinges):
        return None
    return _of_hinges_and_slides(hinges, slides, hinge_first=kinds[0] == "hinge")


def _single(x: SimpleJoint) -> tuple[str, Array]:
    if x.kind == "free":
        return "free", np.eye(4)
    if x.kind == "ball":
        return "spherical", _at(x.point)
    return {"hinge": "revolute", "slide": "prismatic"}[x.kind], _along(x.axis, x.point)


def _of_hinges_and_slides(
    hinges: list[SimpleJoint], slides: list[Array], hinge_first: bool
) -> tuple[str, Array] | None:
    if len(hinges) == 1:
        return _hinge_with_slides(hinges[0], slides, hinge_first)
    if not hinges:
        if len(slides) == 3:
            return "translation", np.eye(4)
        first, second = slides
        return "planar_translation", _along(np.cross(first, second), np.zeros(3), first)
    if not all(_is_right(a.axis, b.axis) for a, b in pairwise(hinges)):
        return None
    point = _meeting_point(hinges)
    if point is None or len(hinges) > 3 or len(slides) not in (0, 3):
        return None
    if len(hinges) == 3:
        return ("free" if slides else "spherical"), _at(point)
    if slides:
        return None
    first, second = (x.axis for x in hinges)
    return "universal", _along(first, point, np.cross(second, first))


def _hinge_with_slides(
    hinge: SimpleJoint, slides: list[Array], hinge_first: bool
) -> tuple[str, Array] | None:
    axis, point = hinge.axis, hinge.point
    if len(slides) == 3:
        return "schoenflies", _along(axis, point)
    if len(slides) == 1 and np.linalg.norm(np.cross(axis, slides[0])) < PARALLEL:
        return "cylindrical", _along(axis, point)
    if not all(_is_right(axis, slide) for slide in slides):
        return None
    if len(slides) == 2:
        return "planar", _along(axis, point, slides[0])
    return ("pin_in_slot_body" if hinge_first else "pin_in_slot"), _along(axis, point, slides[0])


def _is_right(a: Array, b: Array) -> bool:
    return bool(abs(a @ b) < PARALLEL)


def _meeting_point(hinges: list[SimpleJoint]) -> Array | None:
    """Return the point x common to all axes, Σ (I − aaᵀ)(x − p) = 0; None if they do not meet."""
    across = [np.eye(3) - np.outer(x.axis, x.axis) for x in hinges]
    right = sum(A @ x.point for A, x in zip(across, hinges, strict=True))
    point = np.asarray(np.linalg.solve(np.sum(across, axis=0), right))
    off = max(float(np.linalg.norm(A @ (point - x.point))) for A, x in zip(across, hinges))
    return point if off < MEETING else None


def _at(point: Array) -> Array:
    frame = np.eye(4)
    frame[:3, 3] = point
    return frame


def _along(axis: Array, point: Array, first: Array | None = None) -> Array:
    """Return the frame with e₃ along the axis and, if given, e₁ along `first`."""
    options = {} if first is None else {"slot": first}
    kind = joints.revolute if first is None else joints.pin_in_slot
    return kind(axis=axis, body_point=point, **options).body_frame
