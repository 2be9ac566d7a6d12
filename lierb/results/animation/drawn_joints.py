"""A scene shows joints by frames, axes of rotation and sliding, and gaps.

The gap of a joint is the displacement of its body that the animation magnifies.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from lierb.kernels.groups import se3
from lierb.kernels.mechanics.constraints import residuals
from lierb.kernels.mechanics.newton_euler import SE3
from lierb.kernels.mechanics.rows import keeps_axis
from lierb.model.base import Model
from lierb.model.connections import NOWHERE, Connection
from lierb.model.joints.joint import Joint
from lierb.results.animation.encoding import RUNAWAY, encoded
from lierb.support.arrays import Array, assembled, pose_components


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

    def take_rounding_off(self, errors: Mapping[str, Array]) -> None:
        """Set gaps to 0 that are rounding of the poses, where all errors of the run are 0."""
        for name, part in (("rotation_error", slice(0, 3)), ("position_error", slice(3, 6))):
            if name in errors and not np.nanmax(errors[name], initial=0.0) > 0.0:
                self.gap[:, part] *= 0.0  # NaN stays NaN

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


def gap_of(model: Model, at: Connection, poses: list[Array]) -> Array:
    """Return the displacement of a joint's body off its constraint set, (times, 6).

    A row has a rotation vector, rad, and the displacement of the joint's point, m, in the ground's
    axes. They are the shortest displacements that give the constraint residuals h to first order,
    δ = J⁺ h, separately for the rows of rotation and of position. They are computed here in double
    precision, since the page's single precision cannot resolve 1e-7 m beside 1 m.

    model : of one member.   at : a joint with rows.   poses : of each link, (times, 4, 4).
    """
    assert at.joint is not None
    rows, body, own = at.joint.rows, model.constants(at), poses[at.body]
    parameters = model.parameters(at)
    if at.parent != NOWHERE:
        ground = se3.compose(pose_components(poses[at.parent]), parameters.ground)
        parameters = parameters._replace(ground=ground)
    rotation, position = np.zeros((len(own), 3)), np.zeros((len(own), 3))
    with np.errstate(all="ignore"):  # after a failure all is NaN
        placed, still = SE3.to_joint_axes(parameters, pose_components(own), (0.0,) * 6)
        x = SE3.kinematics(body, placed, still)
        values = assembled(tuple(residuals(rows, x, body)))
        values = np.broadcast_to(values, (len(own), len(rows)))
        jacobian = np.stack(
            [np.broadcast_to(assembled(r.jacobian(x, body)), (len(own), 6)) for r in rows], axis=1
        )
    is_translational = np.array([r.is_translational for r in rows])
    alive = np.isfinite(values).all(axis=1)
    for columns, chosen, gaps in (
        (slice(0, 3), ~is_translational, rotation), (slice(3, 6), is_translational, position),
    ):  # fmt: skip
        gaps[~alive] = np.nan
        if chosen.any():
            inverse = np.linalg.pinv(jacobian[alive][:, chosen, columns], rcond=1e-9)
            gaps[alive] = np.einsum("tij,tj->ti", inverse, values[alive][:, chosen])
    to_ground = own[:, :3, :3] @ at.joint.body_frame[:3, :3]  # from the body's joint axes
    return np.hstack([np.einsum("tij,tj->ti", to_ground, each) for each in (rotation, position)])
