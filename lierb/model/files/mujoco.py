"""Read mechanisms in MJCF and URDF files, both compiled by MuJoCo.

MuJoCo's compiler resolves defaults, includes, orientation conventions and inertias of geoms, and
reports errors in files. Simulation of the mechanism does not use MuJoCo.
"""

from __future__ import annotations

from collections.abc import Iterator
from os import fspath
from typing import TYPE_CHECKING, Any

import numpy as np

from lierb.errors import ArgumentError, LierbError, brief, require_name
from lierb.model.bodies.body import Body
from lierb.model.files.compilation import compiled
from lierb.model.files.composed_joints import SimpleJoint, composed, separate
from lierb.model.files.joint_forces import KINDS, JointForces, coupled
from lierb.model.files.loops import add_loops, placed_site
from lierb.model.files.parts import GROUND, Parts, Placed
from lierb.model.files.welded_bodies import (
    PART,
    WORLD,
    is_massless,
    is_point,
    label_of,
    light_body,
    moving_body,
    pose_of,
    rigid_groups,
)
from lierb.support.arrays import as_positive
from lierb.support.representations import counted

if TYPE_CHECKING:
    from mujoco import MjModel

BASES, FRAMES = ("free", "fixed"), ("file", "centre")
READ_OPTIONS = ("gravity", "density", "viscosity", "disableflags")


def read(
    path: Any, language: str, merge_fixed: bool, limit_stiffness: float | None,
    base: str | None, frames: str,
) -> Parts:  # fmt: skip
    """Read the parts of a mechanism from a file.

    language : "MJCF" or "URDF".   limit_stiffness : N m/rad or N/m.   base : "free", "fixed" or
    None.   frames : "file" or "centre".

    Raises ArgumentError for a file that MuJoCo refuses, or that lierb cannot represent.
    """
    if base is not None:
        require_name("base", base, BASES)
    require_name("frames", frames, FRAMES)
    model, left_out = compiled(path, language, base)
    elements = [*map(model.body, range(model.nbody)), *map(model.equality, range(model.neq))]
    parts = Parts(np.array(model.opt.gravity), [element.name for element in elements])
    if limit_stiffness is not None:
        as_positive("limit_stiffness", limit_stiffness, "N m/rad, or N/m")
    try:
        placed = _add_links(model, parts, merge_fixed, limit_stiffness)
        add_loops(model, placed, parts)
        _add_sites(model, placed, parts)
    except LierbError as error:
        raise ArgumentError(f"{brief(fspath(path))}: {error}") from error
    if not parts.links:
        raise ArgumentError(f"{brief(fspath(path))} has no body that moves")
    if parts.light:
        parts.left_out.append(
            f"links without mass or inertia, which have {PART:.0e} of what hangs on them: "
            + ", ".join(parts.light)
        )
    parts.left_out += [*_lacking(model), *left_out]
    if frames == "centre":
        parts.move_frames()
    return parts


def _add_links(
    model: MjModel, parts: Parts, merge_fixed: bool, limit_stiffness: float | None
) -> list[Placed]:
    """Add the links and their forces; return the link of each body of the file."""
    placed = [Placed(GROUND, np.eye(4))]
    groups, lost = rigid_groups(model, merge_fixed)
    for i in range(1, model.nbody):
        on, label = placed[model.body_parentid[i]], label_of(model, i)
        where = on.pose @ pose_of(model.body_pos[i], model.body_quat[i])
        if i not in groups:
            placed.append(Placed(on.link, where))
            if i in lost:
                parts.left_out.append(f"{lost[i]}; it is part of {on.link}")
            continue
        name = parts.free_name(model.body(i).name, label)
        placed.append(Placed(name, np.eye(4)))
        body = moving_body(model, i, groups[i])
        if is_massless(model, groups[i]) or is_point(model, i, groups[i]):
            parts.light.append(name)
        _add_chain(model, parts, i, Placed(on.link, where), name, body, limit_stiffness)
    fixed = [
        f"{label_of(model, i)} {model.body_mass[i]:.6g} kg"
        for i in groups[WORLD]
        if model.body_mass[i]
    ]
    if fixed:
        parts.left_out.append(f"mass of what is welded to the ground: {', '.join(fixed)}")
    return placed


def _add_sites(model: MjModel, placed: list[Placed], parts: Parts) -> None:
    """Add the sites with a name, and the bodies that are part of another one's link."""
    sites = {model.site(i).name: placed_site(model, i, placed) for i in range(model.nsite)}
    links = {name for name, *_ in parts.links}
    named_last = sorted(range(1, model.nbody), key=lambda i: bool(model.body(i).name))
    bodies = {label_of(model, i): placed[i] for i in named_last}
    merged = {name: at for name, at in bodies.items() if at.link != name and name not in links}
    parts.sites = {name: at for name, at in (merged | sites).items() if name}
    hidden = [name for name in merged if name in sites]
    parts.left_out += [f"the frame of body {name}: a site has its name" for name in hidden]


def _add_chain(
    model: MjModel, parts: Parts, i: int, base: Placed, name: str, body: Body,
    limit_stiffness: float | None,
) -> None:  # fmt: skip
    """Add the link of body i, with links without mass between the joints that do not compose.

    Joints compose if the catalogue has a joint with their motions, about whose axes their springs,
    dampers, stops and couplings can act, unless they are coupled to each other.

    base : pose of the body at q = 0, in its parent.
    """
    first, parent, label = model.body_jntadr[i], base.link, label_of(model, i)
    sequence = [*range(first, first + model.body_jntnum[i])]
    simple = [
        SimpleJoint(KINDS[model.jnt_type[j]], model.jnt_axis[j].copy(), model.jnt_pos[j].copy())
        for j in sequence
    ]
    chain = composed(simple, base.pose)
    acting = [JointForces(model, j, label, chain[0], limit_stiffness) for j in sequence]
    is_cut_off = any(x.needs_its_axis and not x.has_force for x in acting)
    if len(chain) == 1 and (is_cut_off or any({*pair} <= {*sequence} for pair in coupled(model))):
        chain = separate(simple, base.pose)
    for k, joint in enumerate(chain, 1):
        link, own = name, body
        if k < len(chain):
            link, own = parts.free_name("", f"{name}_{k}"), light_body(model, i)
            parts.light.append(link)
        parts.links.append((link, own, joint, parent))
        parent = link
        for j in sequence if len(chain) == 1 else sequence[k - 1 : k]:
            parts.link_of_joint[j] = link
            of_joint = JointForces(model, j, label, joint, limit_stiffness)
            try:
                forces, states = of_joint.on(link)
            except LierbError as error:
                raise ArgumentError(f"{of_joint.label}: {error}") from error
            parts.forces += forces
            parts.states += states
            parts.left_out += of_joint.left_out()


def _lacking(model: MjModel) -> Iterator[str]:
    """Yield the elements of the file that the mechanism lacks, with their counts."""
    import mujoco

    collides = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    counts = (
        (collides.sum(), "geom that collides", "geoms that collide"),
        (model.npair, "contact pair", ""),
        (model.nu, "actuator", ""),
        (model.ntendon, "tendon", ""),
        (model.nsensor, "sensor", ""),
        (model.nflex, "flex", "flexes"),
        (model.nplugin, "plugin", ""),
        (model.nkey, "keyframe", ""),
        (
            model.jnt_actfrclimited.sum(),
            "joint with limits of its actuators' forces",
            "joints with limits of their actuators' forces",
        ),
        (np.count_nonzero(model.body_gravcomp), "body with gravcomp", "bodies with gravcomp"),
        (model.nmocap, "mocap body, which stands still", "mocap bodies, which stand still"),
    )
    yield from (counted(int(count), one, several) for count, one, several in counts if count)
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
