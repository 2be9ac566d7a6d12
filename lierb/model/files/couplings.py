"""Couplings of two joints from the equality constraints of a compiled MuJoCo model."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from lierb.model import forces
from lierb.model.files.joint_forces import JointForces
from lierb.model.files.parts import Parts

if TYPE_CHECKING:
    from mujoco import MjModel

COORDINATES = {"hinge": "turn", "slide": "slide"}  # by kind of MuJoCo's joint


def add_coupling(model: MjModel, k: int, label: str, parts: Parts) -> None:
    """Add a gear for equality/joint k, y = a₀ + a₁ x, or a motor that holds y = a₀."""
    offset, slope, *rest = (float(x) for x in model.eq_data[k][:5])
    first, second = (int(i[k]) for i in (model.eq_obj1id, model.eq_obj2id))
    couples = second >= 0 and slope != 0.0
    joints = {name: joint for name, _, joint, _ in parts.links}
    ends = []
    for j in (first, second)[: 1 + couples]:
        link = parts.link_of_joint[j]
        ends.append(JointForces(model, j, link, joints[link], None))
    lacking = [end for end in ends if not end.has_force]
    if second >= 0 and np.any(rest):
        parts.left_out.append(f"{label}: equality/joint with a polynomial beyond a₁")
        return
    if lacking:
        parts.left_out.append(
            f"{label}: equality/joint of {lacking[0].label}, which is part of a "
            f"{lacking[0].joint.name} joint"
        )
        return
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
