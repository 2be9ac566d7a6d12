"""Merge the welded bodies of a compiled MuJoCo model into the body of one link."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from lierb.errors import ArgumentError, InertiaError, LierbError
from lierb.model.bodies.body import ROUNDING, Body, moved_inertia
from lierb.support.arrays import Array

if TYPE_CHECKING:
    from mujoco import MjModel

WORLD = 0  # MuJoCo's index of the ground

# Files put bodies without mass, or without inertia, between the joints of a mobile base, a hip or
# a shoulder. Such a link gets this part of the mass and the inertia of what hangs on it, which is
# nearly rounding.
PART = 1e-12


def label_of(model: MjModel, i: int) -> str:
    """Name of body i in the file."""
    return model.body(i).name or f"body{i}"


def pose_of(position: Array, quaternion: Array) -> Array:
    """Return the pose, (4, 4), of MuJoCo's position and quaternion."""
    from mujoco import mju_quat2Mat

    rotation, pose = np.empty(9), np.eye(4)
    mju_quat2Mat(rotation, quaternion)
    pose[:3, :3], pose[:3, 3] = rotation.reshape(3, 3), position
    return pose


def moving_body(model: MjModel, i: int, members: list[int]) -> Body:
    """Return the body of a link. members : i, and the bodies merged with it.

    Without any mass it is light, by all that hangs on it; with a mass but no inertia it is a small
    sphere. Raises ArgumentError with their names if nothing with a mass hangs on it, or if the
    inertia is not physical.
    """
    label, hanging = label_of(model, i), _hanging_on(model, i)
    if is_massless(model, hanging):
        raise ArgumentError(
            f"body {label} moves and has no mass, so that its mass matrix is singular; give it "
            "one, or weld it to another"
        )
    try:
        if is_massless(model, members):
            return light_body(model, i)
        if is_point(model, i, members):
            mass, centre, inertia = _sum(model, i, members)
            extent = float(np.trace(_sum(model, i, hanging)[2]))
            if not extent:
                raise InertiaError(
                    "the inertia is not positive definite: a point mass in the origin of its frame "
                    "turns about itself; give it one"
                )
            return Body(mass, inertia + PART * extent * np.eye(3), centre)
        return _body(model, i, members)
    except LierbError as error:
        others = ", ".join(label_of(model, k) for k in members if k != i and _weighs(model, k))
        welded = f", with {others} welded to it" if others else ""
        raise ArgumentError(f"body {label}{welded}: {error}") from error


def light_body(model: MjModel, i: int) -> Body:
    """Return the body, in the frame of body i, of a link without mass that body i hangs on."""
    body = _body(model, i, _hanging_on(model, i))
    return Body(PART * body.mass, PART * body.inertia, body.com)


def _hanging_on(model: MjModel, i: int) -> list[int]:
    """Return body i and all bodies whose way to the ground leads over it."""
    hanging = [i]
    for k in range(i + 1, model.nbody):
        if model.body_parentid[k] in hanging:
            hanging.append(k)
    return hanging


def _body(model: MjModel, i: int, members: list[int]) -> Body:
    """Return the members as one body in the frame of body i."""
    mass, centre, inertia = _sum(model, i, members)
    return Body(mass, inertia, centre)


def _sum(model: MjModel, i: int, members: list[int]) -> tuple[float, Array, Array]:
    """Return the members' mass, centre of mass and inertia about the origin, in body i's frame."""
    mass, moment, inertia = 0.0, np.zeros(3), np.zeros((3, 3))
    for k in members:
        frame = _pose_in(model, i, k) @ pose_of(model.body_ipos[k], model.body_iquat[k])
        R, c, m = frame[:3, :3], frame[:3, 3], float(model.body_mass[k])
        about = R @ np.diag(model.body_inertia[k]) @ R.T
        mass, moment = mass + m, moment + m * c
        inertia += about + m * (c @ c * np.eye(3) - np.outer(c, c))
    if not mass:
        raise InertiaError("mass is zero")
    return mass, moment / mass, 0.5 * (inertia + inertia.T)


def _pose_in(model: MjModel, i: int, k: int) -> Array:
    """Return the pose of body k in the frame of i at qpos0; k hangs on i."""
    if k == i:
        return np.eye(4)
    return _pose_in(model, i, model.body_parentid[k]) @ pose_of(
        model.body_pos[k], model.body_quat[k]
    )


def _refusal(model: MjModel, i: int, members: list[int]) -> str:
    """Return the members' InertiaError message; empty if their inertia is physical."""
    try:
        _body(model, i, members)
    except InertiaError as error:
        return str(error)
    return ""


def _weighs(model: MjModel, i: int) -> bool:
    return bool(model.body_mass[i] or np.any(model.body_inertia[i]))


def is_massless(model: MjModel, members: list[int]) -> bool:
    """Return whether none of the bodies has a mass or an inertia."""
    return not any(_weighs(model, k) for k in members)


def is_point(model: MjModel, i: int, members: list[int]) -> bool:
    """Return whether the members have a mass, all at one point, and no inertia about it."""
    if is_massless(model, members):
        return False
    mass, centre, inertia = _sum(model, i, members)
    about_centre = moved_inertia(np.array(mass), inertia, centre, -1.0)
    extent = np.trace(_sum(model, i, _hanging_on(model, i))[2])
    return bool(np.abs(about_centre).max() <= ROUNDING * extent)


def rigid_groups(model: MjModel, merge_fixed: bool) -> tuple[dict[int, list[int]], dict[int, str]]:
    """Return the bodies of each link by the index of its first body, and messages on merging.

    Each welded body is a link unless `merge_fixed`. A welded body without mass, or with an inertia
    that no rigid body has, is merged with its parent. Bodies welded to such a moving body are
    merged with it until the sum is physical. The messages are on merged bodies with mass.
    """
    parents, is_welded = model.body_parentid, model.body_jntnum == 0
    owners = list(range(model.nbody))
    for i in range(1, model.nbody):
        if is_welded[i] and (merge_fixed or owners[parents[i]] == WORLD):
            owners[i] = owners[parents[i]]
    lost: dict[int, str] = {}

    def members(i: int) -> list[int]:
        return [k for k, owner in enumerate(owners) if owner == i]

    def merge(i: int, because_of: int, reason: str) -> None:
        if _weighs(model, i) and not is_massless(model, members(because_of)):
            lost[i] = (
                f"body {label_of(model, i)} as a link of its own: "
                f"{label_of(model, because_of)}'s {reason}"
            )
        into = owners[parents[i]]
        owners[:] = [into if owner == i else owner for owner in owners]

    for i in reversed(range(1, model.nbody)):
        reason = _refusal(model, i, members(i)) if owners[i] == i else ""
        if reason and is_welded[i]:
            merge(i, i, reason)
            continue
        for k in range(i + 1, model.nbody):
            if reason and is_welded[k] and owners[k] == k and owners[parents[k]] == i:
                merge(k, i, reason)
                reason = _refusal(model, i, members(i))
    return {i: members(i) for i in set(owners)}, lost
