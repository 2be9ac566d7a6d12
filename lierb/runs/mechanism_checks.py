"""Whether pose and twist satisfy a mechanism's joints and loops, before anything runs."""

from __future__ import annotations

from typing import Any

import numpy as np

from lierb.errors import (
    ArgumentError,
    LierbError,
    PoseError,
    TwistError,
    beyond_numbers,
    body_label,
)
from lierb.kernels.groups import so3
from lierb.kernels.mechanics.constraints import rate_errors_squared
from lierb.kernels.mechanics.scale import ROUNDING, START_TOLERANCE
from lierb.kernels.numbers.arithmetic import absolute, plain, sqrt
from lierb.kernels.numbers.vec import Vec, cross_add, norm, sub
from lierb.model.acting import unfit_rate
from lierb.model.mechanism.closing import closed
from lierb.model.mechanism.kinematics import TreeKinematics
from lierb.model.mechanism.mechanism import Mechanism
from lierb.model.mechanism.row_system import (
    ConnectionState,
    System,
    errors_of,
    name_of,
    one_of,
    reversed_joint,
    velocity_of,
    wrong_way,
)
from lierb.support.arrays import as_poses, pose_components, taken


def violation(mechanism: Mechanism, pose: Any, twist: Any, t0: float = 0.0) -> LierbError | None:
    """What is wrong with a start, as an error to raise or to warn of; None if nothing is.

    pose, twist : of all links, as `lierb.integrate` takes them.   t0 : s.

    Tolerances are those of one body (`lierb.kernels.mechanics.scale`), with the larger one of the
    two lengths of the links that a joint is between and the speed of the mechanism.
    """
    placed, moving = mechanism.poses("pose0", pose), mechanism.twists("twist0", twist)
    sizes = {f"pose0[{n!r}]": placed[i][1][0] for i, n in enumerate(mechanism.names)}
    sizes |= {f"twist0[{n!r}]": moving[i][0] for i, n in enumerate(mechanism.names)}
    count = mechanism.batch_size(**sizes) or 1
    with np.errstate(all="ignore"):
        system = System(mechanism, count)
        held = system.states(placed, moving, np.float64(t0))
        found = _pose_violation(system, held, pose) or _twist_violation(system, held, moving, t0)
        return found or _immobile(mechanism, pose, count)


def _pose_violation(system: System, held: list[ConnectionState], pose: Any) -> PoseError | None:
    mechanism, count = system.mechanism, system.count
    for h in held:
        for number in wrong_way(h, count)[:1]:
            label = body_label("pose0", int(number), count)
            return PoseError(reversed_joint(mechanism, h.at, label))
        tolerances = {
            "position": START_TOLERANCE * h.length + h.rounding,
            "rotation": START_TOLERANCE,
        }
        for what, unit, size in errors_of(h):
            allowed = tolerances[what]
            bad = np.flatnonzero(~np.broadcast_to((size <= allowed) & (allowed < np.inf), (count,)))
            for number in bad[:1]:
                member = int(number)
                label = body_label("pose0", member, count)
                if not max(one_of(size, member), one_of(allowed, member)) < np.inf:
                    return PoseError(beyond_numbers(label, f"{what} error"))
                remedy = _what_close_does(mechanism, pose, member)
                error, most = (f"{one_of(x, member):.3g}{unit}" for x in (size, allowed))
                return PoseError(
                    f"{label} does not close "
                    f"{name_of(mechanism, h.at)}: {what} error {error} > {most}; {remedy} "
                    '(check="warn" integrates it all the same, but not on "reduced")'
                )
    return None


def _what_close_does(mechanism: TreeKinematics, pose: Any, member: int) -> str:
    """How far `close` would move the links of one member."""
    own = {name: taken(as_poses("pose0", pose[name]), member, 2) for name in mechanism.names}
    alone = mechanism.of_body(member) if mechanism.batch_size() else mechanism
    try:
        near = closed(alone, list(own.values()))
    except LierbError as error:
        return f"mechanism.close(pose0) does not help: {error}"
    far, turned = 0.0, 0.0
    for before, after in zip(own.values(), near, strict=True):
        (q, d), (r, e) = pose_components(before), pose_components(after)
        far = max(far, float(norm(sub(e, d))))
        turned = max(turned, float(norm(so3.log(so3.compose(so3.inverse(q), r)))))
    return (
        f"mechanism.close(pose0) closes it, and moves links by up to {far:.3g} m and "
        f"{turned:.3g} rad"
    )


def _twist_violation(
    system: System, held: list[ConnectionState], twists: list[Vec], t0: float
) -> TwistError | None:
    count, speed = system.count, _speed(system, twists)
    for h in held:
        rates = [r.prescribed_rate(h.x, h.body) for r in h.at.rows]
        if unfit := unfit_rate(h.at.rows, rates, t0):
            return unfit
        allowed = _rate_tolerances(h, speed)
        squares = rate_errors_squared(h.at.rows, h.x, h.body, velocity_of(h.x))
        for what, unit, square, most in zip(
            ("velocity", "rotation rate"), ("m/s", "rad/s"), squares, allowed, strict=True
        ):
            error = sqrt(plain(square))
            bad = np.flatnonzero(~np.broadcast_to((error <= most) & (most < np.inf), (count,)))
            for number in bad[:1]:
                member = int(number)
                label = body_label("twist0", member, count)
                if not max(one_of(error, member), one_of(most, member)) < np.inf:
                    return TwistError(beyond_numbers(label, what))
                found, bound = (f"{one_of(x, member):.3g} {unit}" for x in (error, most))
                return TwistError(
                    f"{label} violates "
                    f"{name_of(system.mechanism, h.at)}: {what} {found} > {bound}; "
                    "mechanism.project(twist0, pose0) is the nearest twist that all joints allow "
                    '(check="warn" integrates it all the same, but not on "reduced")'
                )
    return None


def _speed(system: System, twists: list[Vec]) -> Any:
    """Sum of the links' speeds ‖v‖ + ℓ‖ω‖, m/s.

    The links of a single joint do not do: at a dead point they may be at rest but for the rounding
    of the others' speed.
    """
    speed: Any = 0.0
    for twist, metric, length in zip(twists, system.metrics, system.lengths, strict=True):
        moving = cross_add(twist[:3], metric.com, twist[3:])
        speed = speed + norm(moving) + length * norm(twist[:3])
    return speed


def _rate_tolerances(h: ConnectionState, speed: Any) -> tuple[Any, Any]:
    """In m/s and rad/s, as of one body: by the speed, and by what is brought about in its time."""
    position = START_TOLERANCE * h.length + h.rounding
    ahead = sqrt(norm(h.parameters.gravity) / h.length)
    for r in h.at.rows:
        if not r.is_holonomic:
            ahead = ahead + sqrt(absolute(plain(r.acceleration(h.x, h.body))))
    brought = ROUNDING * ahead
    return (
        position / h.length * speed + h.length * brought,
        START_TOLERANCE * speed / h.length + brought,
    )


def _immobile(mechanism: Mechanism, pose: Any, count: int) -> ArgumentError | None:
    """The error where loops and constraints leave nothing of the freedoms that the tree has."""
    if not any(at.rows and at.joint is None for at in mechanism.places) and not mechanism.loops:
        return None
    free, redundant = mechanism.freedoms(pose)
    for number in np.flatnonzero(np.atleast_1d(free) == 0)[:1]:
        excess = int(np.atleast_1d(redundant)[number])
        return ArgumentError(
            f"{body_label('pose0', int(number), count)}: the mechanism cannot move, its joints and "
            f"loops leave no freedom ({excess} of their rows are redundant); take joints with more "
            "freedoms, such as spherical or universal, or leave a loop out"
        )
    return None
