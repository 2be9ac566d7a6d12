"""The coordinates of a mechanism's link are numbers, a rotation, or the pose of the link."""

from __future__ import annotations

from typing import Any

import numpy as np

from lierb.errors import ArgumentError, two_readings
from lierb.kernels.numbers.vec import IDENTITY
from lierb.model.joints.joint import FIXED, Joint, Sizes
from lierb.model.joints.motions import TURNS, Motions
from lierb.support.arrays import Pose, as_floats, as_matrix


def motions_of(joint: Joint) -> Motions | None:
    """Return the coordinates of a joint's motions; None for a joint without coordinates."""
    return joint.motions if joint.subgroup or joint.factors else None


def is_rigid(joint: Joint) -> bool:
    return joint.name == FIXED


def is_pose(argument: str, given: Any, joint: Joint) -> bool:
    """Return whether a link's coordinates are its pose: (4, 4) matrices, not a rotation."""
    array = as_floats(argument, as_matrix(argument, given))
    if hasattr(given, "as_matrix"):
        return array.shape[-1:] == (4,)
    if array.shape[-2:] != (4, 4):
        return False
    motions = motions_of(joint)
    if array.ndim > 2 or motions is None or len(motions.names) != 4:
        return True
    if tuple(array[3]) == (0.0, 0.0, 0.0, 1.0):
        raise two_readings(
            argument, array.shape, a_pose="pose[None]",
            four_coordinates_of_each_of_four_members="joint.pose(coordinates=…)",
        )  # fmt: skip
    return False


def relative_of(argument: str, given: Any, joint: Joint) -> tuple[Pose, Sizes]:
    """Return D for a joint's coordinates or rotation, and the argument for `batch_size`."""
    motions = motions_of(joint)
    if motions is None:
        if given is not None:
            names = "; leave it out" if is_rigid(joint) else "; give the link's pose, (4, 4)"
            raise ArgumentError(f"{argument}: a {joint.name} joint has no coordinates{names}")
        return (IDENTITY, (0.0, 0.0, joint.length)), {}
    if given is None:
        given = np.zeros(len(motions.names))
    is_turn = hasattr(given, "as_matrix")
    if motions.names == TURNS and not is_turn:
        shape = as_floats(argument, given).shape
        is_turn = len(shape) == 3
        if shape == (3, 3):
            raise two_readings(
                argument, shape, a_rotation_matrix="R[None]",
                three_rotation_vectors="scipy's Rotation.from_rotvec(xi)",
            )  # fmt: skip
    return joint.turned(argument, given) if is_turn else joint.at_coordinates(argument, given)
