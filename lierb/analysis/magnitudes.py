"""A problem's characteristic lengths and energies are the scales of its errors and rounding."""

from __future__ import annotations

from itertools import chain
from typing import Any

import numpy as np

from lierb.kernels.functions.signals import Signals
from lierb.kernels.mechanics.newton_euler import SE3
from lierb.kernels.mechanics.passive_elements import AddedStates
from lierb.kernels.mechanics.scale import length_of
from lierb.kernels.numbers.arithmetic import plain
from lierb.kernels.numbers.vec import dot, mat_vec_add, norm
from lierb.model.base import Model
from lierb.model.mechanism.mechanism import Mechanism
from lierb.model.numbers import rigid_of
from lierb.model.problem import Problem
from lierb.support.arrays import Array, components, pose_components

DRIFTS = {"position": "position_error", "rotation": "rotation_error", "energy": "energy_drift"}


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
        pose, twist = pose_components(poses[link.name]), components(twists[link.name])
        length, gravity = length_of(mechanism.parameters(at)), components(mechanism.gravity)
        kinetic = 0.5 * dot(twist, rigid_of(link.body).momentum(twist))
        place = mat_vec_add(pose[0], components(link.body.com), pose[1])
        height = np.abs(dot(gravity, place))
        total = total + kinetic + link.body.mass * (height + norm(gravity) * length)
        size = np.maximum(size, length + norm(pose[1]))
    return size, total


def _of_body(problem: Problem, poses: Array, twists: Array) -> tuple[Array, Array]:
    """Return the length and the energies; counted angles are those nearest to their start."""
    parameters, body = problem.parameters(), problem.constants()
    length = length_of(parameters)
    placed, velocity = SE3.to_joint_axes(parameters, pose_components(poses), components(twists))
    motion = SE3.kinematics(body, placed, velocity).motion
    elements = list(zip(problem.kinds, body.elements, strict=True))
    states = (e.at_start(own, motion) for e, own in elements if isinstance(e, AddedStates))
    motion = motion._replace(signals=Signals(tuple(chain.from_iterable(states))))
    energies = [
        SE3.kinetic_energy(body, velocity),
        SE3.potential_energy(body, placed),
        parameters.mass * norm(parameters.gravity) * length,
        *(e.energy(own, motion) for e, own in elements),
    ]
    total = sum(np.abs(plain(energy)) for energy in energies)
    size = length + norm(components(poses[..., :3, 3]))
    return size, np.broadcast_to(total, len(twists))
