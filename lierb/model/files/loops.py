"""Make loops and couplings from the equality constraints of a compiled MuJoCo model."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from lierb.model import forces, joints
from lierb.model.files.joint_forces import JointForces, is_coupling, is_curved
from lierb.model.files.parts import GROUND, Parts, Placed
from lierb.model.files.welded_bodies import pose_of
from lierb.support.arrays import Array

if TYPE_CHECKING:
    from mujoco import MjModel

TORQUESCALE = 10  # index among a weld's numbers: weight of the rotation, 0 for a free one
COORDINATES = {"hinge": "turn", "slide": "slide"}  # by kind of MuJoCo's joint


def add_loops(model: MjModel, placed: list[Placed], parts: Parts) -> None:
    """Add a loop for each equality/connect and weld, and a coupling for each equality/joint.

    placed : by index of the body.
    """
    import mujoco

    makers = {int(mujoco.mjtEq.mjEQ_CONNECT): _connect, int(mujoco.mjtEq.mjEQ_WELD): _weld}
    for k in range(model.neq):
        label = model.equality(k).name or f"equality {k}"
        maker = makers.get(int(model.eq_type[k]))
        if maker is None and not is_coupling(model, k):
            kind = mujoco.mjtEq(model.eq_type[k]).name.removeprefix("mjEQ_").lower()
            parts.left_out.append(f"{label}: equality/{kind}")
            continue
        if not model.eq_active0[k]:
            parts.left_out.append(f"{label}: an equality that is not active")
            continue
        if maker is None:
            _add_coupling(model, k, label, parts)
            continue
        is_by_sites = int(model.eq_objtype[k]) == int(mujoco.mjtObj.mjOBJ_SITE)
        ends = [
            placed_site(model, i, placed) if is_by_sites else placed[i]
            for i in (model.eq_obj1id[k], model.eq_obj2id[k])
        ]
        name, frames = maker(model.eq_data[k], is_by_sites)
        frames = [end.pose @ frame for end, frame in zip(ends, frames, strict=True)]
        if ends[0].link == ends[1].link:
            parts.left_out.append(f"{label}: both of its bodies are {ends[0].link}")
            continue
        if ends[0].link == GROUND:
            ends, frames = ends[::-1], frames[::-1]
        joint = joints.JOINTS[name](body_frame=frames[0], parent_frame=frames[1])
        title = parts.free_name(model.equality(k).name, f"loop{k}")
        parts.loops.append((title, joint, ends[0].link, ends[1].link))


def placed_site(model: MjModel, i: int, placed: list[Placed]) -> Placed:
    """Return the link of site i, and its frame in the link."""
    on = placed[model.site_bodyid[i]]
    return Placed(on.link, on.pose @ pose_of(model.site_pos[i], model.site_quat[i]))


def _connect(data: Array, is_by_sites: bool) -> tuple[str, list[Array]]:
    """Return the joint's name and frames: a point of each body, or the two sites."""
    frames = [np.eye(4), np.eye(4)]
    if not is_by_sites:
        frames[0][:3, 3], frames[1][:3, 3] = data[:3], data[3:6]
    return "spherical", frames


def _weld(data: Array, is_by_sites: bool) -> tuple[str, list[Array]]:
    """Return the joint's name and frames: the anchor in the second body, its pose in the first."""
    name = "fixed" if data[TORQUESCALE] else "spherical"
    anchor = np.eye(4)
    if is_by_sites:
        return name, [np.eye(4), anchor]
    anchor[:3, 3] = data[:3]
    return name, [pose_of(data[3:6], data[6:10]), anchor]


def _add_coupling(model: MjModel, k: int, label: str, parts: Parts) -> None:
    """Add a gear for equality/joint k, y = a₀ + a₁ x, or a motor that holds y = a₀."""
    if is_curved(model, k):
        parts.left_out.append(f"{label}: equality/joint with a polynomial beyond a₁")
        return
    offset, slope = (float(x) for x in model.eq_data[k][:2])
    first, second = (int(i[k]) for i in (model.eq_obj1id, model.eq_obj2id))
    couples = second >= 0 and slope != 0.0
    joints = {name: joint for name, _, joint, _ in parts.links}
    ends = []
    for j in (first, second)[: 1 + couples]:
        link = parts.link_of_joint[j]
        ends.append(JointForces(model, j, link, joints[link], None))
    kinds = [COORDINATES[end.kind] for end in ends]
    if not couples:
        holding = forces.motor(position=ends[0].direction * offset, coordinate=kinds[0])
        parts.forces.append(holding.on(ends[0].link))
        return
    ratio = ends[0].direction * slope * ends[1].direction
    gear = forces.gear(ratio, coordinates=kinds)
    parts.forces.append(gear.on(ends[0].link, ends[1].link))
    if offset != 0.0:
        parts.left_out.append(
            f"{label}: its offset {offset:.6g}, which coordinates at the start have to have"
        )
