"""The numbers of a body's input columns give its parameters, constants and start."""

from __future__ import annotations

from typing import Any, NamedTuple

from lierb.kernels.groups.quaternion import Chart
from lierb.kernels.mechanics.elements import Element, body_with
from lierb.kernels.mechanics.newton_euler import (
    SE3,
    BodyConstants,
    Parameters,
    Pose,
    SO3xR3,
    closed_pose,
)
from lierb.kernels.mechanics.scale import PoseTolerances
from lierb.kernels.numbers.arithmetic import rounded_as_numpy, where
from lierb.kernels.numbers.vec import IDENTITY, ZERO3, ZERO9, Mat, Vec, mat_mat, mat_vec_add
from lierb.kernels.numbers.zero import ZERO
from lierb.kernels.systems.layout import INPUTS, pose_of


class Placed(NamedTuple):
    """Initial pose of a body, shared by all starts in it.

    frames : with the joint axes used.   pose : in the user's frames.   chart : C₀.
    """

    frames: Parameters
    pose: Pose
    chart: Chart


class PoseCheck(NamedTuple):
    """Check of an initial pose, shared by all starts in it.

    user_pose, pose : the pose in the user's frames, and in joint axes.
    allowed : tolerances.   fits : 1 where the pose is on the joint, else 0.
    """

    frames: Parameters
    body: BodyConstants
    user_pose: Pose
    pose: Pose
    allowed: PoseTolerances
    fits: Any


def parameters_of(
    numbers: list[Any], turn: Mat = IDENTITY, shift: Vec = ZERO3
) -> tuple[Parameters, Pose, Vec]:
    """Return parameters, pose and twist from the numbers of the input columns.

    A pose of NaN stands for `lierb.joints.Joint.closed_pose`, in which the joint is closed.

    turn : rotation of the joint's axes on the body.   shift : of its point, in these axes.
    """
    parts = INPUTS.parts(numbers)
    parameters = Parameters(
        mass=parts["mass"][0],
        inertia=parts["inertia"],
        com=parts["com"],
        gravity=parts["gravity"],
        ground=pose_of(parts["ground_frame"]),
        body=pose_of(parts["body_frame"]),
        pitch=parts["pitch"][0],
        length=parts["length"][0],
    )
    pose = pose_of(parts["pose"])
    with rounded_as_numpy(parameters.mass):
        closed = closed_pose(parameters.ground, parameters.body, parameters.length)
    axes, point = parameters.body
    return (
        parameters._replace(body=(mat_mat(axes, turn), mat_vec_add(axes, shift, point))),
        where(pose[1][0] == pose[1][0], pose, closed),
        parts["twist"],
    )


def body_of(
    space: type[SE3] | type[SO3xR3],
    elements: tuple[Element, ...],
    numbers: list[Any],
    turn: Mat = IDENTITY,
    shift: Vec = ZERO3,
) -> BodyConstants:
    """Return the constants of the body, with its elements, from all input columns' numbers."""
    parameters, _, _ = parameters_of(numbers, turn, shift)
    return body_with(space, parameters, elements, numbers[INPUTS.count :])


# A twist depends on some of the parameters and constants only. The others would pass through the
# compiler unused, which costs a tenth of a kernel's time.


def frames_alone(parameters: Parameters) -> Parameters:
    """Drop the parameters that no twist depends on."""
    return parameters._replace(mass=ZERO, inertia=ZERO9, pitch=ZERO, length=ZERO)


def rows_alone(body: BodyConstants) -> BodyConstants:
    """Drop the constants that no row depends on."""
    return body._replace(
        mass=ZERO, inertia=ZERO9, inertia_inverse=ZERO9, com=ZERO3, gravity=ZERO3,
        energy_origin=ZERO, origin_inertia=ZERO9, first_moment=ZERO3,
    )  # fmt: skip
