"""A problem's characteristic lengths and energies are the scales of its errors and rounding."""

from __future__ import annotations

from typing import Any

import numpy as np

from lierb.kernels.mechanics.newton_euler import SE3
from lierb.kernels.mechanics.scale import length_of
from lierb.kernels.numbers.arithmetic import plain
from lierb.kernels.numbers.vec import norm
from lierb.model.base import Model
from lierb.model.mechanism.mechanism import Mechanism
from lierb.model.problem import Problem
from lierb.support.arrays import Array, components, pose_components


def kinds_of(model: Model) -> set[str]:
    """Return the kinds of constraint error of the joints: "position", "rotation"."""
    return {kind for at in model.joints if at.joint for kind in at.joint.error_kinds}


def magnitudes(model: Model, poses: Any, twists: Any) -> tuple[Array, Array]:
    """Return the length, m, and energy, J, of each member; poses is None for the closed joint."""
    with np.errstate(all="ignore"):  # a diverging body is accepted until it overflows
        if isinstance(model, Mechanism):
            return _of_links(model, poses, twists)
        assert isinstance(model, Problem)
        placed = model.joint.closed_pose if poses is None else poses
        return _of_body(model, placed, twists)


def _of_links(
    mechanism: Mechanism, poses: dict[str, Array], twists: dict[str, Array]
) -> tuple[Array, Array]:
    """Return the largest length of the links, and the sum of their energies without springs."""
    size, total = np.zeros(1), np.zeros(1)
    for link, at in zip(mechanism.links, mechanism.joints, strict=False):
        pose, twist, body = poses[link.name], twists[link.name], link.body
        parameters, omega, v = mechanism.parameters(at), twist[:, :3], twist[:, 3:]
        length = length_of(parameters)
        com = np.broadcast_to(body.com, v.shape)
        inertia, mass = np.broadcast_to(body.inertia, (len(v), 3, 3)), body.mass
        along = np.einsum("ni,ni->n", v, 0.5 * v + np.cross(omega, com))
        kinetic = mass * along + 0.5 * np.einsum("ni,nij,nj->n", omega, inertia, omega)
        place = pose[:, :3, 3] + np.einsum("nij,nj->ni", pose[:, :3, :3], com)
        gravity = np.broadcast_to(mechanism.gravity, v.shape)
        height = np.abs(np.einsum("ni,ni->n", gravity, place))
        total = total + kinetic + mass * (height + np.linalg.norm(gravity, axis=1) * length)
        size = np.maximum(size, length + np.linalg.norm(pose[:, :3, 3], axis=1))
    return size, total


def _of_body(problem: Problem, poses: Array, twists: Array) -> tuple[Array, Array]:
    parameters, body = problem.parameters(), problem.in_joint_axes(SE3)
    length = length_of(parameters)
    placed, velocity = SE3.to_joint_axes(parameters, pose_components(poses), components(twists))
    motion = SE3.kinematics(body, placed, velocity).motion
    energies = [
        SE3.kinetic_energy(body, velocity),
        SE3.potential_energy(body, placed),
        parameters.mass * norm(parameters.gravity) * length,
        *(e.energy(own, motion) for e, own in zip(problem.kinds, body.elements, strict=True)),
    ]
    total = sum(np.abs(plain(energy)) for energy in energies)
    size = length + norm(components(poses[..., :3, 3]))
    return size, np.broadcast_to(total, len(twists))
