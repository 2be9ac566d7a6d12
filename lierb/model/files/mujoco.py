"""Read mechanisms in MJCF and URDF files, both compiled by MuJoCo.

MuJoCo's compiler resolves defaults, includes, orientation conventions and inertias of geoms, and
reports errors in files. Simulation of the mechanism does not use MuJoCo.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from os import fspath
from typing import TYPE_CHECKING, Any

import numpy as np

from lierb.errors import ArgumentError, LierbError, brief
from lierb.model.files.compilation import compiled
from lierb.model.files.composed_joints import SimpleJoint, composed
from lierb.model.files.joint_forces import KINDS, JointForces
from lierb.model.files.loops import add_loops
from lierb.model.files.parts import GROUND, Parts, Placed
from lierb.model.files.welded_bodies import WORLD, label_of, moving_body, pose_of, rigid_groups
from lierb.support.arrays import as_positive

if TYPE_CHECKING:
    from mujoco import MjModel

READ_OPTIONS = ("gravity", "density", "viscosity", "disableflags")


def read(path: Any, language: str, merge_fixed: bool, limit_stiffness: float | None) -> Parts:
    """Read the parts of a mechanism from a file.

    language : "MJCF" or "URDF".   limit_stiffness : N m/rad or N/m.

    Raises ArgumentError for a file that MuJoCo refuses, or that lierb cannot represent.
    """
    model, left_out = compiled(path, language)
    parts = Parts(np.array(model.opt.gravity))
    if limit_stiffness is not None:
        as_positive("limit_stiffness", limit_stiffness, "N m/rad, or N/m")
    try:
        placed = _add_links(model, parts, merge_fixed, limit_stiffness)
        add_loops(model, placed, parts)
    except LierbError as error:
        raise ArgumentError(f"{brief(fspath(path))}: {error}") from error
    if not parts.links:
        raise ArgumentError(f"{brief(fspath(path))} has no body that moves")
    parts.left_out += [*_lacking(model), *left_out]
    return parts


def _add_links(
    model: MjModel, parts: Parts, merge_fixed: bool, limit_stiffness: float | None
) -> list[Placed]:
    """Add the links and their forces; return the link of each body of the file."""
    placed = [Placed(GROUND, np.eye(4))]
    groups, lost = rigid_groups(model, merge_fixed)
    for i in range(1, model.nbody):
        on, label = placed[model.body_parentid[i]], label_of(model, i)
        first = model.body_jntadr[i]
        numbers = range(first, first + model.body_jntnum[i])
        where = on.pose @ pose_of(model.body_pos[i], model.body_quat[i])
        if i not in groups:
            placed.append(Placed(on.link, where))
            if i in lost:
                parts.left_out.append(f"{lost[i]}; it is part of {on.link}")
            continue
        try:
            joint = composed([_simple_joint(model, j) for j in numbers], where)
        except LierbError as error:
            raise ArgumentError(f"body {label}: {error}") from error
        name = parts.free_name(model.body(i).name, label)
        parts.links.append((name, moving_body(model, i, groups[i]), joint, on.link))
        placed.append(Placed(name, np.eye(4)))
        for j in numbers:
            acting = JointForces(model, j, label, joint, limit_stiffness)
            try:
                parts.forces += [force.on(name) for force in acting.forces()]
            except LierbError as error:
                raise ArgumentError(f"{acting.label}: {error}") from error
            parts.left_out += acting.left_out()
    fixed = [
        f"{label_of(model, i)} {model.body_mass[i]:.6g} kg"
        for i in groups[WORLD]
        if model.body_mass[i]
    ]
    if fixed:
        parts.left_out.append(f"mass of what is welded to the ground: {', '.join(fixed)}")
    return placed


def _simple_joint(model: MjModel, j: int) -> SimpleJoint:
    return SimpleJoint(KINDS[model.jnt_type[j]], model.jnt_axis[j].copy(), model.jnt_pos[j].copy())


def _lacking(model: MjModel) -> Iterator[str]:
    """Yield the elements of the file that the mechanism lacks, with their counts."""
    import mujoco

    collides = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    counts = Counter(
        {
            "geoms that collide": int(collides.sum()),
            "contact pairs": model.npair,
            "actuators": model.nu,
            "tendons": model.ntendon,
            "sensors": model.nsensor,
            "flexes": model.nflex,
            "plugins": model.nplugin,
            "keyframes": model.nkey,
            "joints with limits of their actuators' forces": int(model.jnt_actfrclimited.sum()),
            "bodies with gravcomp": int(np.count_nonzero(model.body_gravcomp)),
            "mocap bodies, which stand still": model.nmocap,
        }
    )
    yield from (f"{count} {what}" for what, count in counts.items() if count)
    if model.opt.density or model.opt.viscosity:
        yield "the fluid's density and viscosity"
    usual = mujoco.MjModel.from_xml_string("<mujoco/>").opt
    changed = [
        name
        for name in dir(usual)
        if name not in READ_OPTIONS
        and not name.startswith("_")
        and np.any(getattr(model.opt, name) != getattr(usual, name))
    ]
    if changed:
        yield f"options of MuJoCo's own solver: {', '.join(changed)}"
