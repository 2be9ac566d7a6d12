"""Generalised α methods on a Lie group have index 3 or the stabilised index 2.

Unknowns at the end of a step are V̇₁ and λ₁, and η with index 2:

    (1 − α_m) a₁ + α_m a₀ = (1 − α_f) V̇₁ + α_f V̇₀,
    C₁ = C₀ exp(h V₀ + h² ((½ − β) a₀ + β a₁) − J₀ᵀη),   V₁ = V₀ + h ((1 − γ) a₀ + γ a₁),
    M V̇₁ + J₁ᵀλ₁ = ad_V₁ᵀ M V₁ + W₁,   h(C₁) = 0,   and with index 2 J₁ V₁ = 0.

A step passes V̇, a and λ on to the next one; λ is where the iteration begins. a approximates V̇ at
t + (α_m − α_f) h, and so it must at the start: with a₀ = V̇₀ the velocity would have an error of h²
after the first step, not of h³.

Brüls, Cardona and Arnold, Mech. Mach. Theory 48 (2012); Arnold, Brüls and Cardona, Numerische
Mathematik 129 (2015); Chung and Hulbert, J. Appl. Mech. 60 (1993).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

from lierb.kernels.numbers.arithmetic import fma
from lierb.kernels.numbers.newton import simplified_newton
from lierb.kernels.numbers.vec import Vec, add, axpy, scale, sub
from lierb.kernels.numbers.zero import ZERO
from lierb.kernels.stepping.method import Interval, Step
from lierb.kernels.stepping.unestimated import UnestimatedMethod, ended
from lierb.kernels.systems.acceleration import accelerate
from lierb.kernels.systems.descriptor import Descriptor
from lierb.kernels.systems.scheme import AlphaScheme
from lierb.kernels.systems.state import State


class Coefficients(NamedTuple):
    """The coefficients are those of Chung and Hulbert.   share : (1 − α_f)/(1 − α_m)."""

    alpha_m: float
    alpha_f: float
    beta: float
    gamma: float

    @classmethod
    def of(cls, rho: float) -> Coefficients:
        alpha_m, alpha_f = (2.0 * rho - 1.0) / (rho + 1.0), rho / (rho + 1.0)
        gamma = 0.5 + alpha_f - alpha_m
        return cls(alpha_m, alpha_f, 0.25 * (gamma + 0.5) ** 2, gamma)

    @property
    def share(self) -> float:
        return (1.0 - self.alpha_f) / (1.0 - self.alpha_m)


class Predicted(NamedTuple):
    """The end of a step lacks the terms with V̇₁: a₁, X, V₁, and factors of V̇₁ in X and V₁."""

    a: Vec
    x: Vec
    velocity: Vec
    to_x: Any
    to_v: Any


@dataclass(frozen=True)
class GeneralisedAlpha(UnestimatedMethod):
    """A step is for a body with the solver "saddle"; all steps have one length."""

    scheme: AlphaScheme

    @cached_property
    def coefficients(self) -> Coefficients:
        return Coefficients.of(self.scheme.rho)

    def started(self, system: Any, body: Any, state: State, at: Interval) -> State:
        """Return the state with V̇, a and λ at the start, a by a look ahead of one step."""
        c, plan = self.coefficients, system.plan
        velocity, form = state.v_or_mu, Descriptor(system, body)
        now = accelerate(plan, body, state.chart, velocity, at.time)
        chart = form.moved(state.chart, scale(at.h, velocity))
        later = accelerate(plan, body, chart, axpy(at.h, now.rate, velocity), at.time + at.span)
        a = axpy(c.alpha_m - c.alpha_f, sub(later.rate, now.rate), now.rate)
        return state._replace(carried=(*now.rate, *a, *now.multipliers))

    def step(
        self, system: Any, body: Any, state: State, at: Interval, all_stages: bool = False
    ) -> Step:
        form, time, m = Descriptor(system, body), at.time + at.span, len(system.plan.rows)
        predicted = self._predicted(state, at.h)
        to_x, to_v = predicted.to_x, predicted.to_v
        before = form.constraints(state.chart) if self.is_stabilised else None

        def end(unknowns: Vec) -> tuple[Any, Vec]:
            """Return C₁ and V₁."""
            x = axpy(to_x, unknowns[:6], predicted.x)
            if before is not None:  # η in units in which its column is as large as that of λ
                x = sub(x, scale(to_x, before.force(unknowns[6 + m :])))
            return form.moved(state.chart, x), axpy(to_v, unknowns[:6], predicted.velocity)

        def residual(unknowns: Vec) -> Vec:
            chart, velocity = end(unknowns)
            constraints = form.constraints(chart)
            pushes = add(form.gyroscopic(velocity), form.applied(chart, velocity, time).wrench)
            balance = sub(form.momentum(unknowns[:6]), pushes)
            balance = add(balance, constraints.force(unknowns[6 : 6 + m]))
            rates = constraints.rates(velocity) if self.is_stabilised else ()
            return (*balance, *scale(1.0 / to_x, constraints.values), *scale(1.0 / to_v, rates))

        def size(change: Vec) -> Any:
            return form.size(state.chart, scale(to_x, change[:6]))

        guess = (*state.carried[:6], *state.carried[12:], *(ZERO,) * (m * self.is_stabilised))
        solved = simplified_newton(residual, guess, size, state.v_or_mu[0] + 0.0 * at.h)
        chart, velocity = end(solved.unknowns)
        rate, multipliers = solved.unknowns[:6], solved.unknowns[6 : 6 + m]
        a = axpy(self.coefficients.share, rate, predicted.a)
        moved = state._replace(chart=chart, v_or_mu=velocity, carried=(*rate, *a, *multipliers))
        if system.plan.does_work:
            first = form.applied(state.chart, state.v_or_mu, at.time).power
            last = form.applied(chart, velocity, time).power
            moved = moved._replace(work=fma(0.5 * at.h, first + last, state.work))
        return ended(moved, form.singular, solved.unsolved)

    @property
    def is_stabilised(self) -> bool:
        return self.scheme.index == 2

    def _predicted(self, state: State, h: Any) -> Predicted:
        c = self.coefficients
        before, a = state.carried[:6], state.carried[6:12]
        known = axpy(-c.alpha_m, a, scale(c.alpha_f, before))
        known = scale(1.0 / (1.0 - c.alpha_m), known)
        of_x, of_v = c.beta * (h * h), c.gamma * h
        x = axpy((0.5 - c.beta) * (h * h), a, scale(h, state.v_or_mu))
        velocity = axpy((1.0 - c.gamma) * h, a, state.v_or_mu)
        return Predicted(
            known, axpy(of_x, known, x), axpy(of_v, known, velocity), c.share * of_x, c.share * of_v
        )
