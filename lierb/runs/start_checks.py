"""Whether pose and twist satisfy the joint, row by row, before anything runs."""

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
from lierb.kernels.mechanics.constraints import (
    position_error_squared,
    rate_errors_squared,
    rotation_error_squared,
)
from lierb.kernels.mechanics.newton_euler import SE3, BodyConstants, Kinematics
from lierb.kernels.mechanics.scale import (
    PoseTolerances,
    TwistTolerances,
    bearings,
    pose_tolerances,
    twist_tolerances,
)
from lierb.kernels.numbers.vec import Vec, dot
from lierb.kernels.numbers.zero import is_zero
from lierb.kernels.systems.body_inputs import body_of, parameters_of
from lierb.kernels.systems.layout import inputs_of
from lierb.model.acting import unfit_rate
from lierb.model.problem import Problem
from lierb.runs.inputs import Inputs
from lierb.support.arrays import Array


def require_central_com(problem: Problem) -> None:
    """SO(3)×R³ decouples Newton's equation from Euler's at the centre of mass only."""
    if np.any(problem.body.com != 0.0):
        raise ArgumentError(
            'cspace="SO3xR3" needs the body frame at the centre of mass (com = 0): elsewhere its '
            'equations do not decouple; move the frame, or use cspace="SE3"'
        )


def require_consistent(
    problem: Problem, twists: Array, poses: Array | None, t0: float = 0.0
) -> None:
    """Raise for the first body whose start violates the joint."""
    starts = {"twist": twists} | ({} if poses is None else {"pose": poses})
    inputs = Inputs(problem, inputs_of(problem.kinds), starts, len(twists), t0)
    found = violation(inputs, np.zeros(inputs.count))
    if found is not None:
        raise found


def violation(inputs: Inputs, starts: Array, first: int = 0) -> LierbError | None:
    """The first violation of the joint, as an error to raise or to warn of.

    starts : 1 for a body that starts on its joint, else 0, for those from number `first` on.
    """
    for body in np.flatnonzero(starts == 0.0).tolist():
        with np.errstate(all="ignore"):
            found = _violation_of(inputs, first + body)
        if found is not None:  # else it is at the tolerance, to rounding
            return found
    return None


def _violation_of(inputs: Inputs, number: int) -> LierbError | None:
    """What is wrong with one body, row by row."""
    problem = inputs.problem
    assert isinstance(problem, Problem)  # mechanisms have `lierb.runs.mechanism_checks`
    numbers = inputs.numbers(number)
    parameters, pose, twist = parameters_of(numbers)
    body = body_of(SE3, problem.kinds, numbers)
    placed, velocity = SE3.to_joint_axes(parameters, pose, twist)
    x = SE3.kinematics(body, placed, velocity)._replace(time=np.float64(inputs.time))
    labels = [body_label(argument, number, inputs.count) for argument in ("pose0", "twist0")]
    held = pose_tolerances(parameters, pose)
    moving = twist_tolerances(problem.rows, parameters, held, twist, x, body)
    return _pose_violation(problem, x, body, held, labels[0]) or _twist_violation(
        problem, x, body, velocity, moving, labels[1]
    )


def _pose_violation(
    problem: Problem, x: Kinematics, body: BodyConstants, allowed: PoseTolerances, label: str
) -> PoseError | None:
    rows, joint = problem.rows, problem.joint
    if any(bearing <= 0.0 for bearing in bearings(rows, x.q)):
        return PoseError(
            f"{label} holds the {joint.name} joint the wrong way round, half a turn off, which no "
            "row sees; turn pose0 or one of the joint's frames by 180°"
        )
    for what, unit, squared, most in (
        ("position", " m", position_error_squared(rows, x, body), allowed.position),
        ("rotation", "", rotation_error_squared(rows, x, body), allowed.rotation),
    ):
        error = _root(squared)
        if error <= most < np.inf:
            continue
        if not max(error, most) < np.inf:
            return PoseError(beyond_numbers(label, f"{what} error"))
        values = [
            f"{r} = {_plain(r.value(x, body)):.3g}"
            for r in rows
            if r.has_value and r.error_kind == what
        ]
        detail = f" ({', '.join(values)})" if values else ""
        remedy = (
            "problem.close(pose0) finds a pose near by that does"
            if problem.constraints
            else "leave pose0 out for the closed joint, or give the joint frames that it closes"
        )
        return PoseError(
            f"{label} does not close the {_held_by(problem)}: {what} error {error:.3g}{unit} > "
            f"{most:.3g}{unit}{detail}; {remedy} "
            '(check="warn" integrates it all the same, but not on "reduced")'
        )
    return None


def _twist_violation(
    problem: Problem,
    x: Kinematics,
    body: BodyConstants,
    velocity: Vec,
    allowed: TwistTolerances,
    label: str,
) -> TwistError | None:
    rates = [r.prescribed_rate(x, body) for r in problem.rows]
    if unfit := unfit_rate(problem.rows, rates, x.time):
        return unfit
    squares = rate_errors_squared(problem.rows, x, body, velocity)
    for what, unit, squared, most in zip(
        ("velocity", "rotation rate"), ("m/s", "rad/s"), squares, allowed, strict=True
    ):
        error = _root(squared)
        if error <= most < np.inf:
            continue
        if not max(error, most) < np.inf:
            return TwistError(beyond_numbers(label, what))
        rows = ", ".join(
            f"{r}: {dot(r.jacobian(x, body), velocity) - r.prescribed_rate(x, body):.3g}"
            for r in problem.rows
            if r.is_translational == (what == "velocity")
        )
        return TwistError(
            f"{label} violates the {_held_by(problem)}: {what} {error:.3g} {unit} > {most:.3g} "
            f"{unit} ({rows}); use problem.project(twist0, pose0) for the nearest twist that the "
            'joint allows, or check="warn" to integrate it all the same, but not on "reduced"'
        )
    return None


def _held_by(problem: Problem) -> str:
    """What the rows are of, for messages."""
    added = [element.name for element in problem.elements if element.kind.rows]
    return " with ".join((f"{problem.joint.name} joint", *added))


def _plain(x: Any) -> float:
    return 0.0 if is_zero(x) else float(x)


def _root(square: Any) -> float:
    return 0.0 if is_zero(square) else float(np.sqrt(square))
