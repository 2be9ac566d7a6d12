"""SHAKE on a Lie group (SHAKELie) is the leapfrog whose multipliers satisfy rows of position alone.

With C₁ = C₀ exp X₀ and the momenta before and after the forces at t₁ act,

    h p⁻ = dexp⁻ᵀ_{−X₀} M X₀,   h p⁺ = dexp⁻ᵀ_X₁ M X₁ = h p⁻ + h² W(C₁) − J₁ᵀΛ,   h(C₁ exp X₁) = 0,
    V₁ = ½ M⁻¹ (p⁻ + p⁺).

Λ = h² λ₁ is known when the pose after C₁ is. A step therefore solves for X₁, which it passes on to
the next one, with 1 where this iteration has not converged. X₀ at the start is that of RATTLE, and
so are all poses: RATTLE's multipliers add a multiple of Jᵀ to its momenta, which Λ absorbs. J V is
not zero, as V is a central difference; it is of order h².

W is at the velocity 2X₀/h − V₀ if it depends on one.

Ryckaert, Ciccotti and Berendsen, J. Comput. Phys. 23 (1977); Hairer, Lubich and Wanner, Geometric
Numerical Integration, VII.1.4; on Lie groups Hante and Arnold, J. Comput. Appl. Math. 387 (2021).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from lierb.kernels.numbers.arithmetic import maximum
from lierb.kernels.numbers.elimination import Factored
from lierb.kernels.numbers.vec import add, axpy, neg, scale
from lierb.kernels.stepping.descriptor_method import with_work
from lierb.kernels.stepping.method import Interval, Step
from lierb.kernels.stepping.rattle import displacement
from lierb.kernels.stepping.unestimated import UnestimatedMethod, ended
from lierb.kernels.systems.scheme import ShakeScheme
from lierb.kernels.systems.state import State
from lierb.kernels.systems.tree_descriptor import descriptor_of


@dataclass(frozen=True)
class Shake(UnestimatedMethod):
    """A step is for the descriptor form; all steps have one length."""

    scheme: ShakeScheme

    def started(self, system: Any, body: Any, state: State, at: Interval) -> State:
        """Return the state with X₀, which is that of RATTLE."""
        form = descriptor_of(system, body)
        wrench = form.applied(state.chart, state.v_or_mu, at.time).wrench
        momentum = axpy(0.5 * at.h, wrench, form.momentum(state.v_or_mu))
        solved, _ = displacement(form, state, momentum, at.h, at.time + at.span)
        return state._replace(carried=(*solved.unknowns[: form.width], solved.unsolved))

    def step(
        self, system: Any, body: Any, state: State, at: Interval, all_stages: bool = False
    ) -> Step:
        form, inverse, time = descriptor_of(system, body), 1.0 / at.h, at.time + at.span
        x, failed = state.carried[:-1], state.carried[-1]
        velocity = axpy(2.0 * inverse, x, neg(state.v_or_mu))
        there = state._replace(chart=form.moved(state.chart, x), v_or_mu=velocity)
        wrench = form.applied(there.chart, velocity, time).wrench
        before = scale(inverse, form.pulled(neg(x), form.momentum(x)))
        momentum = axpy(at.h, wrench, before)
        solved, dependent = displacement(form, there, momentum, at.h, time + at.span)
        after = solved.unknowns[: form.width]
        momenta = add(before, scale(inverse, form.pulled(after, form.momentum(after))))
        mass = Factored([list(column) for column in form.mass_matrix()])
        velocity = mass.solve(scale(0.5, momenta))
        unsolved = maximum(solved.unsolved, failed)
        moved = there._replace(v_or_mu=velocity, carried=(*after, unsolved))
        moved, singular = with_work(form, state, moved, at), form.singular(dependent)
        return ended(moved, singular, unsolved, solved.turns)
