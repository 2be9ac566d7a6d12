"""Closed poses of a mechanism whose joints are held at given coordinates."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from lierb.errors import ArgumentError
from lierb.kernels.groups import se3
from lierb.model.forces.motors import PositionMotor, motor
from lierb.model.joints import catalogue
from lierb.model.joints.coordinates import motions_of
from lierb.model.joints.motions import as_coordinates
from lierb.model.mechanism.closing import closed
from lierb.model.mechanism.row_system import System
from lierb.support.arrays import Array, components, pose_components, pose_matrix

if TYPE_CHECKING:
    from lierb.model.mechanism.kinematics import TreeKinematics

# Largest change of a held coordinate between two closed poses, rad, or relative to the size of the
# mechanism: a step stays on the branch of the pose before.
STEP = 0.1


def closed_at(mechanism: TreeKinematics, poses: list[Array], hold: Any, t0: float) -> list[Array]:
    """Return closed poses in which joints have the coordinates in `hold`, a dictionary by link.

    The coordinates go there from those of `poses` in small steps, each of which is closed from the
    step before.
    """
    ends = {
        name: _coordinates(mechanism, name, value)
        for name, value in mechanism.by_link("hold", hold, is_whole=False).items()
    }
    before = mechanism.coordinates(dict(zip(mechanism.names, poses, strict=True)))
    starts = {name: before[name] for name in ends}
    length = float(np.max(System(mechanism, 1).length))
    steps = 1
    for name, end in ends.items():
        names = mechanism.link(name).joint.coordinate_names
        units = [length if each[0] in "ds" else 1.0 for each in names]
        farthest = np.max(np.abs(end - starts[name]) / units)
        steps = max(steps, int(np.ceil(farthest / STEP)))
    for step in range(1, steps + 1):
        places = {
            name: end if step == steps else starts[name] + step / steps * (end - starts[name])
            for name, end in ends.items()
        }
        poses = closed(_held(mechanism, places), poses, t0)
    return poses


def _coordinates(mechanism: TreeKinematics, name: str, value: Any) -> Array:
    """Check the coordinates of a held joint; (k,) or (n, k)."""
    joint = mechanism.link(name).joint
    motions = motions_of(joint)
    if motions is None:
        raise ArgumentError(f"hold[{name!r}]: a {joint.name} joint has no coordinates to hold")
    return as_coordinates(f"hold[{name!r}]", value, motions.names)


def _held(mechanism: TreeKinematics, places: dict[str, Array]) -> TreeKinematics:
    """Return the mechanism with joints held: by a motor, or fixed if they have more coordinates.

    Gears act between moving joints, so a joint with one coordinate is not fixed.
    """
    links = list(mechanism.links)
    motors = []
    for i, link in enumerate(mechanism.links):
        place = places.get(link.name)
        if place is None:
            continue
        if place.shape[-1] == 1:
            motors.append(motor(position=place[..., 0]).on(link.name))
            continue
        relative = link.joint.motions.pose(components(place))
        ground = se3.compose(pose_components(link.joint.ground_frame), relative)
        fixed = catalogue.fixed(ground_frame=pose_matrix(ground), body_frame=link.joint.body_frame)
        links[i] = replace(link, joint=fixed)
    kept = [
        force
        for force in mechanism.forces
        if force.kind.rows and not (isinstance(force.kind, PositionMotor) and force.at[0] in places)
    ]
    return type(mechanism)(
        links, mechanism.loops, forces=[*kept, *motors], constraints=mechanism.constraints
    )
