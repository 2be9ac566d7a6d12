"""Characteristic length and speed of a problem, and tolerances of a start relative to them.

The length ℓ is the largest of the radius of gyration √(tr Θ/2m), the arm from the centre of mass to
the joint's point, a rod's length and a pitch. The speed of a start is ‖v‖ + ℓ‖ω‖, v that of the
centre of mass. Neither depends on the frames in which the problem is stated. Positions are rounded
relative to their distance from the origins of those frames, regardless of ℓ; tolerances include
this rounding.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from lierb.kernels.mechanics.constraints import held_axes
from lierb.kernels.mechanics.newton_euler import BodyConstants, Kinematics, Parameters, Pose
from lierb.kernels.mechanics.rows import Rows
from lierb.kernels.numbers.arithmetic import absolute, fma, maximum, sqrt
from lierb.kernels.numbers.number import Number
from lierb.kernels.numbers.vec import Mat, Vec, cross_add, dot, norm, sub

START_TOLERANCE = 1e-9  # largest residuals of a start, relative to ℓ, speed, 1 and speed/ℓ
# Relative rounding error of a position: 16 half-units in the last place from the products of three
# poses, and as many from their factors.
ROUNDING = 2.0**-48


def length_of(p: Parameters) -> Any:
    """Return the characteristic length ℓ, m."""
    trace = p.inertia[0] + p.inertia[4] + p.inertia[8]
    gyration = fma(0.5, trace / p.mass, -dot(p.com, p.com))
    arm = norm(sub(p.body[1], p.com))
    return maximum(
        maximum(sqrt(maximum(gyration, 0.0)), arm), maximum(absolute(p.pitch), absolute(p.length))
    )


def rounding_of(p: Parameters, pose: Pose) -> Any:
    """Return the rounding error of a distance between points that coincide, m."""
    return ROUNDING * (norm(pose[1]) + norm(p.ground[1]) + norm(p.body[1]))


class PoseTolerances(NamedTuple):
    """Hold the tolerances of a start's pose: largest position and rotation error, and ℓ."""

    length: Number  # ℓ, m
    position: Number  # m
    rotation: Number = START_TOLERANCE


def pose_tolerances(p: Parameters, pose: Pose) -> PoseTolerances:
    """Return the tolerances of a pose in the user's frames."""
    length = length_of(p)
    return PoseTolerances(length, fma(START_TOLERANCE, length, rounding_of(p, pose)))


def twist_tolerances(
    rows: Rows, p: Parameters, pose: PoseTolerances, twist: Vec, x: Kinematics, body: BodyConstants
) -> tuple[Number, Number]:
    """Tolerances of a twist in the user's frames, m/s and rad/s; `x`, `body` are in joint axes.

    The tolerance of a velocity has two terms: the pose's, relative to the speed, and the rounding
    of the speed that gravity and motors cause in the problem's characteristic time. A body at rest
    has the second term only.

    pose : tolerances of the pose.
    """
    omega, length = twist[:3], pose.length
    speed = norm(cross_add(omega, p.com, twist[3:])) + length * norm(omega)
    rate = sqrt(norm(p.gravity) / length)  # rad/s
    for r in rows:
        if r.depends_on_time:
            rate = rate + sqrt(absolute(r.acceleration(x, body)))
    rounding = ROUNDING * rate
    velocity = fma(pose.position / length, speed, length * rounding)
    return velocity, fma(START_TOLERANCE, speed / length, rounding)


def bearings(rows: Rows, q: Mat) -> list[Number]:
    """Return numbers that are all positive unless the body is turned half round in its joint.

    Half a turn of an axis that `Omega` rows keep parallel changes no row's value.
    """
    return [q[4 * axis] for axis in held_axes(rows)]
