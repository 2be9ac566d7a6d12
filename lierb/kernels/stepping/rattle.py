"""RATTLE on a Lie group (RATTLie) is variational, and satisfies rows of position and velocity.

With X = hξ, C₁ = C₀ exp X, and Λ = ½ h² λ the multipliers at the step's start,

    dexp⁻ᵀ_X MX = h (M V₀ + h/2 W(C₀)) − J₀ᵀΛ,   h(C₁, t₁) = 0;
    M V₁ + J₁ᵀΛ′ = h⁻¹ dexp⁻ᵀ_{−X} MX + h/2 W(C₁),   J₁ V₁ = w(t₁).

The first two are solved by iteration, which evaluates no force; the last two are linear.

Hante and Arnold, J. Comput. Appl. Math. 387 (2021); Hairer, Lubich and Wanner, Geometric Numerical
Integration, VII.1.4.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from lierb.kernels.numbers.arithmetic import absolute, where
from lierb.kernels.numbers.newton import Solved, simplified_newton
from lierb.kernels.numbers.vec import Vec, add, axpy, neg, scale, sub
from lierb.kernels.numbers.zero import ZERO
from lierb.kernels.stepping.descriptor_method import with_work
from lierb.kernels.stepping.method import Interval, Step
from lierb.kernels.stepping.unestimated import UnestimatedMethod, ended
from lierb.kernels.systems.descriptor import Descriptor
from lierb.kernels.systems.scheme import RattleScheme
from lierb.kernels.systems.state import State
from lierb.kernels.systems.tree_descriptor import descriptor_of


@dataclass(frozen=True)
class Rattle(UnestimatedMethod):
    """A step of RATTLE is for the descriptor form."""

    scheme: RattleScheme

    def step(
        self, system: Any, body: Any, state: State, at: Interval, all_stages: bool = False
    ) -> Step:
        form, h = descriptor_of(system, body), at.h
        moves = absolute(h) > 0.0  # false for idle lanes
        first, time = form.applied(state.chart, state.v_or_mu, at.time), at.time + at.span
        momentum = axpy(0.5 * h, first.wrench, form.momentum(state.v_or_mu))
        solved, dependent = displacement(form, state, momentum, h, time)
        x = solved.unknowns[: form.width]
        chart, inverse = form.moved(state.chart, x), 1.0 / where(moves, h, 1.0)
        arrived = scale(inverse, form.pulled(neg(x), form.momentum(x)))
        constraints = form.constraints(chart, time)
        consistent = form.consistent(constraints, dependent)

        def end(velocity: Vec) -> Vec:
            """Return V₁ with forces at a velocity near it."""
            pushed = axpy(0.5 * h, form.applied(chart, velocity, time).wrench, arrived)
            return consistent.solve((*pushed, *constraints.prescribed))[: form.width]

        velocity = end(scale(inverse, x))
        if form.forces_depend_on_velocity:  # the mean velocity is of first order alone
            velocity = end(velocity)
        moved = with_work(form, state, state._replace(chart=chart, v_or_mu=velocity), at)
        if system.plan.has_lane_clocks:
            moved = where(moves, moved, state)
        return ended(moved, form.singular(dependent), solved.unsolved, solved.turns)


def displacement(
    form: Descriptor, state: State, momentum: Vec, h: Any, time: Any
) -> tuple[Solved, Vec]:
    """Return X and Λ of a step, and the rows left out.

    momentum : M V₀ + h/2 W(C₀).   time : at the end of the step, s.
    """
    chart, aim, n = state.chart, scale(h, momentum), form.width
    before = form.constraints(chart, time)
    dependent = form.dependent(before)

    def residual(unknowns: Vec) -> Vec:
        x, multipliers = unknowns[:n], unknowns[n:]
        balance = sub(form.pulled(x, form.momentum(x)), aim)
        held = form.constraints(form.moved(chart, x), time).values
        return (*add(balance, before.force(multipliers)), *held)

    def size(change: Vec) -> Any:
        return form.size(chart, change[:n])

    guess = (*scale(h, state.v_or_mu), *(ZERO,) * form.rows)
    like = state.v_or_mu[0] + 0.0 * h
    return simplified_newton(residual, guess, size, like, dependent), dependent
