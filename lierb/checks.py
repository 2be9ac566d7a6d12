"""Whether pose and twist satisfy the joint, row by row, before anything runs."""

from __future__ import annotations

from typing import Any

import numpy as np

from lierb.arrays import Array, components, pose_components
from lierb.errors import ArgumentError, LierbError, PoseError, TwistError, body_label
from lierb.kernels.arithmetic import sqrt
from lierb.kernels.constraints import (
    Row,
    jacobian,
    position_error_squared,
    rotation_error_squared,
    value,
)
from lierb.kernels.newton_euler import SE3, Kinematics, Parameters
from lierb.kernels.vec import dot
from lierb.model import Problem

TOLERANCE = 1e-9  # m, rad, m/s, rad/s; relative to 1 + the size of what is checked
SLICE = 65536  # bodies checked at once: bounds the memory


def require_central_com(problem: Problem) -> None:
    """SO(3)×R³ decouples Newton's equation from Euler's at the centre of mass only."""
    if np.any(problem.body.com != 0.0):
        raise ArgumentError(
            'cspace="SO3xR3" needs the body frame at the centre of mass (com = 0): elsewhere its '
            'equations do not decouple; move the frame, or use cspace="SE3"'
        )


def violation(problem: Problem, poses: Array, twists: Array, count: int) -> LierbError | None:
    """The first body's violation of the joint, as an error to raise or to warn of."""
    if not problem.joint.rows:
        return None
    for start in range(0, count, SLICE):
        bodies = slice(start, min(start + SLICE, count))
        with np.errstate(all="ignore"):
            found = _violation_in(problem, poses, twists, bodies, count)
        if found is not None:
            return found
    return None


def _violation_in(
    problem: Problem, poses: Array, twists: Array, bodies: slice, count: int
) -> LierbError | None:
    def cut(array: Any, axes: int = 0) -> Any:
        return array[bodies] if array.ndim > axes and len(array) > 1 else array

    def cut_all(parts: Any) -> Any:
        return tuple(map(cut_all, parts)) if isinstance(parts, tuple) else cut(parts)

    parameters = Parameters(*(cut_all(p) for p in problem.parameters()))
    pose = cut_all(pose_components(poses))
    velocity = cut_all(components(twists))
    body = SE3.body(parameters)
    placed, joint_velocity = SE3.to_joint_axes(parameters, pose, velocity)
    x = SE3.kinematics(body, placed, joint_velocity)
    size = 1.0 + np.sqrt(np.asarray(dot(pose[1], pose[1])))
    return _pose_violation(problem, x, body.pitch, size, bodies.start, count) or _twist_violation(
        problem, x, body.pitch, velocity, joint_velocity, bodies.start, count
    )


def _worst(errors: Any, allowed: Any) -> int | None:
    """The first body whose error exceeds what is allowed, or is no number."""
    errors, allowed = np.broadcast_arrays(np.atleast_1d(errors), np.atleast_1d(allowed))
    bad = np.flatnonzero(~(errors <= allowed) | ~np.isfinite(errors))
    return int(bad[0]) if bad.size else None


def _at(numbers: Any, body: int) -> float:
    flat = np.atleast_1d(numbers)
    return float(flat[body if flat.size > 1 else 0])


def _flipped_axis(rows: tuple[Row, ...], x: Kinematics) -> int | None:
    """The first body turned by 180° against its `Omega` rows, which their errors cannot see."""
    fixed = sorted({r.i for r in rows if r.kind == "Omega"})
    axes = {2: [3 - sum(fixed)], 3: [0, 1, 2]}.get(len(fixed), [])
    cosines = [np.atleast_1d(x.q[4 * axis]) for axis in axes]
    if not axes:
        return None
    bad = np.flatnonzero(np.min(np.broadcast_arrays(*cosines), axis=0) <= 0.0)
    return int(bad[0]) if bad.size else None


def _pose_violation(
    problem: Problem, x: Kinematics, pitch: Any, size: Any, start: int, count: int
) -> PoseError | None:
    joint = problem.joint
    flipped = _flipped_axis(joint.rows, x)
    if flipped is not None:
        return PoseError(
            f"{body_label('pose0', start + flipped, count)} holds the {joint.name} joint the wrong "
            "way round: its axis on the body points against that on the ground; turn pose0 or one "
            "of the joint's frames by 180°"
        )
    for what, unit, squared, allowed in (
        ("position", " m", position_error_squared(joint.rows, x, pitch), TOLERANCE * size),
        ("rotation", "", rotation_error_squared(joint.rows, x), TOLERANCE),
    ):
        error = np.asarray(sqrt(squared) if isinstance(squared, np.ndarray | np.generic) else 0.0)
        body = _worst(error, allowed)
        if body is None:
            continue
        rows = [
            f"{r} = {_at(value(r, x, pitch), body):.3g}"
            for r in joint.rows
            if r.kind != "Omega" and r.is_translational == (what == "position")
        ]
        detail = f" ({', '.join(rows)})" if rows else ""
        label = body_label("pose0", start + body, count)
        return PoseError(
            f"{label} does not close the {joint.name} joint: {what} error "
            f"{_at(error, body):.3g}{unit} > {_at(allowed, body):.3g}{detail}; leave pose0 out for "
            "the closed joint, or give the joint frames that this pose closes "
            '(check="warn" integrates it all the same)'
        )
    return None


def _twist_violation(
    problem: Problem, x: Kinematics, pitch: Any, twist: Any, velocity: Any, start: int, count: int
) -> TwistError | None:
    joint = problem.joint
    allowed = TOLERANCE * (1.0 + np.sqrt(np.asarray(dot(twist, twist))))
    rates = [(r, np.asarray(dot(jacobian(r, x, pitch), velocity))) for r in joint.rows]
    for what, unit, translational in (("velocity", "m/s", True), ("rotation rate", "rad/s", False)):
        chosen = [(r, rate) for r, rate in rates if r.is_translational == translational]
        error = np.sqrt(sum(np.square(rate) for _, rate in chosen) if chosen else 0.0)
        body = _worst(error, allowed)
        if body is None:
            continue
        rows = ", ".join(f"{r}: {_at(rate, body):.3g}" for r, rate in chosen)
        label = body_label("twist0", start + body, count)
        return TwistError(
            f"{label} violates the {joint.name} joint: {what} {_at(error, body):.3g} {unit} > "
            f"{_at(allowed, body):.3g} ({rows}); use problem.project(twist0, pose0) for the "
            'nearest twist that the joint allows, or check="warn" to integrate it all the same'
        )
    return None
