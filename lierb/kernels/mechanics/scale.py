"""A problem's own length and speed, and how far off its joint a start may be, relative to them.

The length ℓ is the largest of the radius of gyration √(tr Θ/2m), the arm from the centre of mass to
the joint's point, a rod's length and a pitch. The speed of a start is ‖v‖ + ℓ‖ω‖, v that of the
centre of mass. Both are the same in whatever frames the problem is stated. Places are rounded
relative to their distance from the origins of those frames, whatever ℓ is: that is allowed for.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from lierb.kernels.mechanics.constraints import held_axes
from lierb.kernels.mechanics.newton_euler import BodyConstants, Kinematics, Parameters, Pose
from lierb.kernels.mechanics.rows import Rows
from lierb.kernels.numbers.arithmetic import absolute, fma, maximum, sqrt
from lierb.kernels.numbers.vec import Mat, Vec, cross_add, dot, norm, sub

START_TOLERANCE = 1e-9  # how far off its joint a start may be, relative to ℓ, speed, 1 and speed/ℓ
# What rounding leaves, relative to the numbers that are rounded: 16 half-units in the last place
# from the products of three poses, as many again from those who made them.
ROUNDING = 2.0**-48


def length_of(p: Parameters) -> Any:
    """ℓ, m."""
    trace = p.inertia[0] + p.inertia[4] + p.inertia[8]
    gyration = fma(0.5, trace / p.mass, -dot(p.com, p.com))
    arm = norm(sub(p.body[1], p.com))
    return maximum(
        maximum(sqrt(maximum(gyration, 0.0)), arm), maximum(absolute(p.pitch), absolute(p.length))
    )


def rounding_of(p: Parameters, pose: Pose) -> Any:
    """What rounding may leave of a distance between points that coincide, m."""
    return ROUNDING * (norm(pose[1]) + norm(p.ground[1]) + norm(p.body[1]))


class PoseTolerances(NamedTuple):
    """The largest errors that the pose of a start may have, and ℓ, m."""

    length: Any
    position: Any  # m
    rotation: Any = START_TOLERANCE


class TwistTolerances(NamedTuple):
    """The largest errors that its twist may have."""

    velocity: Any  # m/s
    rotation_rate: Any  # rad/s


def pose_tolerances(p: Parameters, pose: Pose) -> PoseTolerances:
    """Of a pose in the user's frames."""
    length = length_of(p)
    return PoseTolerances(length, fma(START_TOLERANCE, length, rounding_of(p, pose)))


def twist_tolerances(
    rows: Rows, p: Parameters, held: PoseTolerances, twist: Vec, x: Kinematics, body: BodyConstants
) -> TwistTolerances:
    """Of a twist in the user's frames; `x` and `body` are the same in joint axes.

    A velocity may be off as a position may, and by the rounding of the speed that gravity and
    motors bring about in the problem's own time: a body at rest has none but that.

    held : of the pose.
    """
    omega, length = twist[:3], held.length
    speed = norm(cross_add(omega, p.com, twist[3:])) + length * norm(omega)
    ahead = sqrt(norm(p.gravity) / length)  # rad/s
    for r in rows:
        if not r.is_holonomic:
            ahead = ahead + sqrt(absolute(r.acceleration(x, body)))
    brought = ROUNDING * ahead
    return TwistTolerances(
        fma(held.position / length, speed, length * brought),
        fma(START_TOLERANCE, speed / length, brought),
    )


def bearings(rows: Rows, q: Mat) -> list[Any]:
    """Numbers that are positive where the joint is held the right way round.

    No row sees half a turn of an axis that `Omega` rows hold.
    """
    return [q[4 * axis] for axis in held_axes(rows)]
