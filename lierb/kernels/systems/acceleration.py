"""Compute accelerations and multipliers of one body, from the saddle point of M and its rows."""

from __future__ import annotations

from functools import partial
from operator import methodcaller
from typing import Any, NamedTuple

from lierb.kernels.groups import quaternion
from lierb.kernels.groups.quaternion import Chart
from lierb.kernels.mechanics.elements import Applied, applied_to
from lierb.kernels.mechanics.newton_euler import BodyConstants, Kinematics, Turn, spinning
from lierb.kernels.mechanics.saddle import solve
from lierb.kernels.mechanics.support import Load
from lierb.kernels.numbers.arithmetic import fma
from lierb.kernels.numbers.vec import (
    Mat,
    Vec,
    add,
    axpy,
    cross,
    cross_add,
    dot,
    mat_t_vec,
    mat_vec,
    scale,
    sub,
)
from lierb.kernels.numbers.zero import ZERO
from lierb.kernels.systems.plan import Plan


class Acceleration(NamedTuple):
    """Hold the solution of the saddle point.

    rate : V̇, (6,).   turning, moving : ω̇, and the acceleration of the joint's point, in body axes.
    multipliers : λ, in the order of the plan's rows.
    reaction : the joint's wrench on the body, (6,), about the joint's point, in its axes there.
    power : of forces and motors, W.   singular : 1 in a singular configuration.
    dropped : number of dependent rows.
    """

    rate: Vec
    multipliers: tuple[Any, ...]
    reaction: Vec
    power: Any
    singular: Any
    dropped: Any
    turning: Vec
    moving: Vec


def accelerate(
    plan: Plan,
    body: BodyConstants,
    chart: Chart,
    velocity: Vec,
    time: Any = ZERO,
    q: Mat | None = None,
    fall: Vec | None = None,
    to_ground: Turn | None = None,
    applied: Applied | None = None,
) -> Acceleration:
    """Solve the saddle point at one pose and velocity.

    q, fall, to_ground, applied : rotation matrix of the chart, gravity in body axes, rotation of
        vectors from body axes to the ground's, and all other forces; computed if None.
    """
    to_ground = to_ground or partial(quaternion.rotated, chart[0])
    q = quaternion.matrix(chart[0]) if q is None else q
    x = plan.space.kinematics(body, (q, chart[1]), velocity)._replace(time=time)
    at_point = x.at_point()
    rows = plan.rows
    fall = mat_t_vec(q, body.gravity) if fall is None else fall
    applied = applied or applied_to(body, plan.elements, x.motion)
    turning = None
    if body.moments:
        turning = spinning(body, x.omega, fall, applied.wrench[:3])
    solution = solve(
        body,
        x.q,
        rows,
        methodcaller("jacobian", at_point, body),
        tuple(r.acceleration(at_point, body) for r in rows),
        _load(body, x.omega, fall, applied.wrench),
        x.omega + x.point_rate,
        turning,
    )
    torque, force = solution.wrench[:3], solution.wrench[3:]
    aside = cross(body.shift, force)  # about the user's joint point
    multipliers = tuple(
        x if r.fixed_axis is None else x - aside[r.fixed_axis]
        for r, x in zip(rows, solution.multipliers, strict=True)
    )
    return Acceleration(
        plan.space.velocity_rate(body, to_ground, velocity, solution.turning, solution.moving),
        multipliers,
        mat_vec(body.turn, add(torque, aside)) + mat_vec(body.turn, force),
        applied.power + _driving_power(plan, body, x, multipliers),
        solution.singular,
        solution.dropped,
        solution.turning,
        solution.moving,
    )


def _load(body: BodyConstants, omega: Vec, fall: Vec, applied: Vec) -> Load:
    """Return ad_Vᵀ M V + W − m ω × (ω × c), with c from the joint's point to the centre of mass.

    fall : gravity in body axes.   applied : wrench of all other forces, about the joint's point.
    """
    centre = sub(body.com, body.arm)
    spin = cross(mat_vec(body.inertia, omega), omega)
    bent = cross(omega, cross(omega, centre))
    force = axpy(body.mass, sub(fall, bent), applied[3:])
    # c × (ω×(ω×c)) = (c·ω) c×ω
    pull = axpy(-dot(centre, omega), omega, fall)
    return Load(
        add(spin, cross_add(applied[3:], centre, applied[:3])),
        force,
        cross_add(scale(body.mass, centre), pull, add(spin, applied[:3])),
    )


def _driving_power(
    plan: Plan, body: BodyConstants, x: Kinematics, multipliers: tuple[Any, ...]
) -> Any:
    """Return −λ·w, the power of all constraints J V = w with a prescribed rate w, W."""
    total: Any = ZERO
    for r, multiplier in zip(plan.rows, multipliers, strict=True):
        total = fma(-multiplier, r.prescribed_rate(x, body), total)
    return total
