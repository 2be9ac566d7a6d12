"""A scene shows joints by frames, axes of rotation and sliding, and gaps."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from lierb.kernels.mechanics.rows import keeps_axis
from lierb.model.base import Model
from lierb.model.joints.joint import Joint
from lierb.results.animation.encoding import RUNAWAY, encoded
from lierb.results.animation.gaps import gap_of
from lierb.support.arrays import Array


class DrawnJoint(NamedTuple):
    """Drawn joint; parent and child are indices of bodies, None for the ground."""

    name: str
    joint: Joint
    parent: int | None
    child: int
    closes: bool
    gap: Array

    def described(self) -> dict[str, Any]:
        """Return the joint as plain data for the page."""
        joint = self.joint
        ground, body = _axes(joint)
        slides, child_slides = _slides(joint)
        return {
            "name": self.name, "parent": self.parent, "child": self.child, "closes": self.closes,
            "parent_frame": joint.ground_frame.ravel().tolist(),
            "child_frame": joint.body_frame.ravel().tolist(),
            "parent_axes": ground, "child_axes": body,
            "slides": slides, "child_slides": child_slides,
            "is_rod": "rod" in map(str, joint.rows),
            "gap": encoded(self.gap),
        }  # fmt: skip

    def gap_size(self, size: float) -> float:
        """Return the largest gap relative to the bodies' size, or in rad."""
        with np.errstate(invalid="ignore"):
            near = self.gap[(np.abs(self.gap) < RUNAWAY).all(axis=1)]
        turned, moved = (np.linalg.norm(part, axis=1) for part in (near[:, :3], near[:, 3:]))
        return float(np.max(np.maximum(turned, moved / size), initial=0.0))


def drawn_joints(model: Model, poses: list[Array]) -> list[DrawnJoint]:
    """Return the joints with rows, parents first; loops come after the links."""
    count = len(model.bodies)
    return [
        DrawnJoint(
            at.name or at.joint.name, at.joint, at.parent if at.parent >= 0 else None, at.body,
            n >= count, gap_of(model, at, poses),
        )
        for n in (*model.order, *range(count, len(model.joints)))
        if (at := model.joints[n]).joint is not None and at.rows
    ]  # fmt: skip


def _axes(joint: Joint) -> tuple[list[int], list[int]]:
    """Return the axes of the joint's frames on the ground and on the body about which it turns."""
    ground, body = set(), set()
    if keeps_axis(joint.rows) and not {"Omega3"} & {*map(str, joint.rows)}:
        ground.add(2)
        body.add(2)
    for row in joint.rows:
        if row.symbol == "Q":
            ground.add(row.i)
            body.add(row.j)
        if row.symbol == "cv":
            ground.add(2)
            body.add(2)
    return sorted(ground), sorted(body)


def _slides(joint: Joint) -> tuple[list[int], list[int]]:
    """Return the axes of the joint's frames on the ground and on the body along which it slides."""
    slides = []
    for symbol in ("d", "Qtd"):
        fixed = {row.i for row in joint.rows if row.symbol == symbol}
        if "screw" in map(str, joint.rows) and symbol == "d" and len(fixed) < 2:
            fixed = {0, 1, 2}  # a rising plane has no line to draw
        slides.append([i for i in range(3) if i not in fixed] if len(fixed) == 2 else [])
    return slides[0], slides[1]
