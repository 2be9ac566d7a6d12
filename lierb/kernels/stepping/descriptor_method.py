"""Implicit methods solve the descriptor form at the end of a step, with V̇₁ and λ₁ as unknowns.

Index 3 has constraints of the position alone, the stabilised index 2 also those of the velocity,
and unknowns η for them. A method says how the end depends on V̇₁, by numbers x, x′, v and v′:

    C₁ = C₀ exp(x + x′ (V̇₁ − M⁻¹J₀ᵀη)),   V₁ = v + v′ V̇₁,
    M V̇₁ + J₁ᵀλ₁ = ad_V₁ᵀ M V₁ + W₁,   h(C₁, t₁) = 0,   and with index 2 J₁ V₁ = w(t₁).

A step passes V̇, numbers of the method's own and λ on to the next one. The iteration begins with V̇
and λ.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from lierb.kernels.numbers.arithmetic import fma, where
from lierb.kernels.numbers.newton import simplified_newton
from lierb.kernels.numbers.vec import Vec, add, axpy, scale, sub
from lierb.kernels.numbers.zero import ZERO
from lierb.kernels.stepping.method import Interval, Step
from lierb.kernels.stepping.unestimated import UnestimatedMethod, ended
from lierb.kernels.systems.descriptor import Descriptor
from lierb.kernels.systems.state import State
from lierb.kernels.systems.tree_descriptor import descriptor_of


class Predicted(NamedTuple):
    """The end of a step without V̇₁: X and V₁, and the factors x′ and v′ of V̇₁ in them."""

    x: Vec
    velocity: Vec
    to_x: Any
    to_v: Any


class DescriptorMethod(UnestimatedMethod):
    """A step is for the descriptor form; all steps have one length."""

    is_stabilised = False  # True for the stabilised index 2

    def predicted(self, state: State, h: Any) -> Predicted:
        raise NotImplementedError

    def own(self, state: State, h: Any, x: Vec, rate: Vec) -> Vec:
        """Return the numbers of the method's own that a step passes on.

        state : at the beginning of the step.   x : X.   rate : V̇₁.
        """
        raise NotImplementedError

    def step(
        self, system: Any, body: Any, state: State, at: Interval, all_stages: bool = False
    ) -> Step:
        form, time = descriptor_of(system, body), at.time + at.span
        n, m = form.width, form.rows
        predicted = self.predicted(state, at.h)
        to_x, to_v = predicted.to_x, predicted.to_v
        before = form.constraints(state.chart, at.time)
        dependent = form.dependent(before)
        pulls = form.per_mass(before) if self.is_stabilised else before

        def end(unknowns: Vec) -> tuple[Vec, Any, Vec]:
            """Return X, C₁ and V₁."""
            x = axpy(to_x, unknowns[:n], predicted.x)
            if self.is_stabilised:
                x = sub(x, scale(to_x, pulls.force(unknowns[n + m :])))
            return x, form.moved(state.chart, x), axpy(to_v, unknowns[:n], predicted.velocity)

        def residual(unknowns: Vec) -> Vec:
            _, chart, velocity = end(unknowns)
            constraints = form.constraints(chart, time)
            pushes = add(form.gyroscopic(velocity), form.applied(chart, velocity, time).wrench)
            balance = sub(form.momentum(unknowns[:n]), pushes)
            balance = add(balance, constraints.force(unknowns[n : n + m]))
            rates = constraints.rates(velocity) if self.is_stabilised else ()
            return (*balance, *scale(1.0 / to_x, constraints.values), *scale(1.0 / to_v, rates))

        def size(change: Vec) -> Any:
            return form.size(state.chart, scale(to_x, change[:n]))

        multipliers = state.carried[len(state.carried) - m :]
        if dependent:
            marked = zip(dependent, multipliers, strict=True)
            multipliers = tuple(where(mark > 0.5, 0.0, x) for mark, x in marked)
        guess = (*state.carried[:n], *multipliers, *(ZERO,) * (m * self.is_stabilised))
        like, left_out = state.v_or_mu[0] + 0.0 * at.h, dependent * (1 + self.is_stabilised)
        solved = simplified_newton(residual, guess, size, like, left_out)
        x, chart, velocity = end(solved.unknowns)
        rate, multipliers = solved.unknowns[:n], solved.unknowns[n : n + m]
        carried = (*rate, *self.own(state, at.h, x, rate), *multipliers)
        moved = state._replace(chart=chart, v_or_mu=velocity, carried=carried)
        moved, singular = with_work(form, state, moved, at), form.singular(dependent)
        return ended(moved, singular, solved.unsolved, solved.turns)


def with_work(form: Descriptor, before: State, after: State, at: Interval) -> State:
    """Return the state after a step with the work of its forces, by the trapezoidal rule."""
    if not form.plan.does_work:
        return after
    first = form.power(before.chart, before.v_or_mu, at.time)
    last = form.power(after.chart, after.v_or_mu, at.time + at.span)
    return after._replace(work=fma(0.5 * at.h, first + last, before.work))


def look_ahead(system: Any, body: Any, state: State, at: Interval) -> tuple[Vec, Vec, Vec]:
    """Return V̇ and λ at the start, and V̇ about one step later."""
    velocity, form = state.v_or_mu, descriptor_of(system, body)
    rate, multipliers = form.accelerations(state.chart, velocity, at.time)
    chart = form.moved(state.chart, scale(at.h, velocity))
    later, _ = form.accelerations(chart, axpy(at.h, rate, velocity), at.time + at.span)
    return rate, multipliers, later
