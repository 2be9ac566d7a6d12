"""Verlet's variational method on a joint's subgroup H is symplectic, and stays on H exactly.

With the discrete Lagrangian h ½ ξᵀMξ − h/2 (U(C₀) + U(C₁)), C₁ = C₀ exp hξ, and W the wrench of all
forces,

    Nᵀ dexp⁻ᵀ_{hξ} Mξ = μ₀ + h/2 NᵀW(C₀),   μ₁ = Nᵀ dexp⁻ᵀ_{−hξ} Mξ + h/2 NᵀW(C₁).

Only the first is implicit, in the coordinates ν of ξ = Nν; its iteration evaluates no force. On a
commutative H its solution is ξ = V(μ₀ + h/2 NᵀW).

Marsden, Pekarsky and Shkoller, Nonlinearity 12 (1999); Hairer, Lubich and Wanner, Geometric
Numerical Integration, II.4 (composition), VI.6 (discrete Lagrangians).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from lierb.kernels.groups import quaternion
from lierb.kernels.groups.quaternion import Chart
from lierb.kernels.mechanics import subgroup
from lierb.kernels.mechanics.elements import Applied, applied_to
from lierb.kernels.numbers.arithmetic import fma, maximum
from lierb.kernels.numbers.newton import newton
from lierb.kernels.numbers.vec import ZERO6, Vec, add, axpy, dot, scale, sub, units
from lierb.kernels.numbers.zero import ZERO
from lierb.kernels.stepping.method import Interval, Step
from lierb.kernels.stepping.unestimated import UnestimatedMethod, ended
from lierb.kernels.systems.formulations import Subgroup
from lierb.kernels.systems.scheme import VerletScheme
from lierb.kernels.systems.state import State


@dataclass(frozen=True)
class Verlet(UnestimatedMethod):
    """A step is one or several Störmer–Verlet steps; the body has the solver "subgroup"."""

    scheme: VerletScheme

    def step(
        self, system: Any, body: Any, state: State, at: Interval, all_stages: bool = False
    ) -> Step:
        unsolved, turns, time = ZERO, ZERO, at.time
        for share in self.scheme.shares:
            part = at.part(share)._replace(time=time)
            state, failed, more = _substep(system, body, state, part)
            unsolved, turns = maximum(unsolved, failed), turns + more
            time = fma(share, at.span, time)
        return ended(state, ZERO, unsolved, turns)


def _substep(system: Subgroup, body: Any, state: State, at: Interval) -> tuple[State, Any, Any]:
    """Return the state after h, 1 where the iteration has not converged, and its turns."""
    half, chart = 0.5 * at.h, state.chart
    first = _push(system, body, chart, state.v_or_mu, at.time)
    momentum = axpy(half, first.wrench, state.v_or_mu)
    velocity, arrived, unsolved, turns = _drift(system, body, momentum, at.h)
    chart = system.moved(chart, scale(half, velocity))
    last = _push(system, body, chart, arrived, at.time + at.span)
    if any(element.depends_on_velocity for element in system.plan.acting):
        # The velocity before the last push is of first order alone.
        predicted = axpy(half, last.wrench, arrived)
        last = _push(system, body, chart, predicted, at.time + at.span)
    mu = axpy(half, last.wrench, arrived)
    work = fma(half, first.power + last.power, state.work) if system.plan.does_work else ZERO
    return state._replace(chart=chart, v_or_mu=mu, work=work), unsolved, turns


def _push(system: Subgroup, body: Any, chart: Chart, mu: Vec, time: Any) -> Applied:
    """Return NᵀW of gravity and all other forces, and their power."""
    applied = Applied(ZERO6, ZERO)
    if system.plan.acting:
        pose, velocity = quaternion.pose(chart), system.velocity(body, mu)
        x = system.plan.space.kinematics(body, pose, velocity)._replace(time=time)
        applied = applied_to(body, system.plan.elements, x.motion)
    fall = quaternion.rotated_back(chart[0], body.gravity)
    wrench = add(body.wrench(fall, ZERO6, ZERO6), applied.wrench)
    projected = subgroup.projected(system.slots, wrench, body.pitch)
    return Applied(projected, applied.power)


def _drift(system: Subgroup, body: Any, momentum: Vec, h: Any) -> tuple[Vec, Vec, Any, Any]:
    """Solve Nᵀ dexp⁻ᵀ_{hξ} Mξ = momentum.

    Return ξ, Nᵀ dexp⁻ᵀ_{−hξ} Mξ, 1 where the iteration has not converged, and its turns.
    """
    guess = system.velocity(body, momentum)
    if subgroup.is_commutative(system.slots):
        return guess, momentum, ZERO, ZERO
    start, known = (subgroup.coordinates(system.slots, x) for x in (guess, momentum))

    def residual(nu: Vec) -> Vec:
        return sub(_pulled(system, body, nu, h), known)

    def in_slots(numbers: Vec) -> Vec:
        return tuple(numbers[slot] if slot >= 0 else ZERO for slot in system.slots)

    # A change with NᵀMN as Jacobian leaves an error of h², for which Newton needs a turn less.
    nearer = sub(momentum, in_slots(residual(start)))
    start = subgroup.coordinates(system.slots, system.velocity(body, nearer))
    nu, unsolved, turns = newton(residual, start, like=start[0] + 0.0 * h)
    mu = in_slots(_pulled(system, body, nu, -h))
    return subgroup.lifted(system.slots, nu, body.pitch), mu, unsolved, turns


def _pulled(system: Subgroup, body: Any, nu: Vec, h: Any) -> Vec:
    """Return Nᵀ dexp⁻ᵀ_{hξ} Mξ of ξ = Nν, in the coordinates of H."""
    velocity = subgroup.lifted(system.slots, nu, body.pitch)
    momentum = body.momentum(velocity)
    half = scale(0.5 * h, velocity)
    k = quaternion.angle_coefficients(half)
    axes = (subgroup.lifted(system.slots, unit, body.pitch) for unit in units(len(nu)))
    return tuple(dot(quaternion.dexpinv(half, axis, k), momentum) for axis in axes)
