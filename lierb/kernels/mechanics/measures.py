"""How well a body keeps its constraints, its energy and its rotation matrix's orthogonality."""

from __future__ import annotations

from typing import Any, NamedTuple

from lierb.kernels.mechanics.constraints import (
    position_error_squared,
    rate_errors_squared,
    rotation_error_squared,
)
from lierb.kernels.mechanics.elements import potential_energy
from lierb.kernels.mechanics.newton_euler import BodyConstants
from lierb.kernels.numbers.arithmetic import fma
from lierb.kernels.numbers.vec import IDENTITY, Vec, mat_t_mat
from lierb.kernels.numbers.zero import ZERO
from lierb.kernels.stepping.plan import Plan
from lierb.kernels.stepping.stepper import Pose


class Measures(NamedTuple):
    """Squares, but for energy and work: the root is taken once, of the largest."""

    position: Any  # m²
    rotation: Any
    velocity: Any  # m²/s²
    rotation_rate: Any  # rad²/s²
    orthogonality: Any  # ‖QᵀQ − I‖², Frobenius
    energy: Any  # J
    work: Any  # J, since the start, of what has no potential


def measure(
    plan: Plan,
    body: BodyConstants,
    pose: Pose,
    velocity: Vec,
    kinetic_energy: Any,
    work: Any,
    time: Any,
) -> Measures:
    x = plan.space.kinematics(body, pose, velocity)._replace(time=time)
    rate, turning_rate = rate_errors_squared(plan.rows, x, body, velocity)
    return Measures(
        position_error_squared(plan.rows, x, body),
        rotation_error_squared(plan.rows, x, body),
        rate,
        turning_rate,
        _orthogonality_squared(pose[0]),
        kinetic_energy + _potential(plan, body, pose, velocity),
        work,
    )


def _potential(plan: Plan, body: BodyConstants, pose: Pose, velocity: Vec) -> Any:
    of_gravity = plan.space.potential_energy(body, pose)
    if not plan.elements:
        return of_gravity
    motion = plan.space.kinematics(body, pose, velocity).motion
    return of_gravity + potential_energy(plan.elements, body, motion)


def _orthogonality_squared(q: Any) -> Any:
    total: Any = ZERO
    for entry, one in zip(mat_t_mat(q, q), IDENTITY, strict=True):
        excess = entry - one
        total = fma(excess, excess, total)
    return total
