"""Compute the gap of a joint: the displacement of its body that the animation magnifies."""

from __future__ import annotations

import numpy as np

from lierb.kernels.groups import se3
from lierb.kernels.mechanics.constraints import residuals
from lierb.kernels.mechanics.newton_euler import SE3
from lierb.model.base import Model
from lierb.model.connections import NOWHERE, Connection
from lierb.support.arrays import Array, assembled, pose_components


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
