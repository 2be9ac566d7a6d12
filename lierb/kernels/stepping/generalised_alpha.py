"""Generalised α methods on a Lie group have index 3 or the stabilised index 2.

The end of a step, which `lierb.kernels.stepping.descriptor_method` solves for V̇₁, λ₁ and η, is

    (1 − α_m) a₁ + α_m a₀ = (1 − α_f) V̇₁ + α_f V̇₀,
    C₁ = C₀ exp(h V₀ + h² ((½ − β) a₀ + β a₁) − M⁻¹J₀ᵀη),   V₁ = V₀ + h ((1 − γ) a₀ + γ a₁).

The published method has J₀ᵀη, which adds radians and metres: its motion depends on the unit of
length. M⁻¹J₀ᵀη is the correction in the kinetic-energy metric, and has the same order.

A step passes V̇, a and λ on to the next one. a approximates V̇ at t + (α_m − α_f) h, and so it must
at the start: with a₀ = V̇₀ the velocity would have an error of h² after the first step, not of h³.

Brüls, Cardona and Arnold, Mech. Mach. Theory 48 (2012); Arnold, Brüls and Cardona, Numerische
Mathematik 129 (2015); Chung and Hulbert, J. Appl. Mech. 60 (1993).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

from lierb.kernels.numbers.vec import Vec, axpy, scale, sub
from lierb.kernels.stepping.descriptor_method import DescriptorMethod, Predicted, look_ahead
from lierb.kernels.stepping.method import Interval
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


@dataclass(frozen=True)
class GeneralisedAlpha(DescriptorMethod):
    """A step has the parameter ρ∞ and the index of its scheme."""

    scheme: AlphaScheme

    @cached_property
    def coefficients(self) -> Coefficients:
        return Coefficients.of(self.scheme.rho)

    @property
    def is_stabilised(self) -> bool:  # type: ignore[override]
        return self.scheme.index == 2

    def started(self, system: Any, body: Any, state: State, at: Interval) -> State:
        """Return the state with V̇, a and λ at the start, a by a look ahead of one step."""
        c = self.coefficients
        rate, multipliers, later = look_ahead(system, body, state, at)
        a = axpy(c.alpha_m - c.alpha_f, sub(later, rate), rate)
        return state._replace(carried=(*rate, *a, *multipliers))

    def predicted(self, state: State, h: Any) -> Predicted:
        c, known, n = self.coefficients, self._known(state), len(state.v_or_mu)
        a = state.carried[n : 2 * n]
        of_x, of_v = c.beta * (h * h), c.gamma * h
        x = axpy((0.5 - c.beta) * (h * h), a, scale(h, state.v_or_mu))
        velocity = axpy((1.0 - c.gamma) * h, a, state.v_or_mu)
        return Predicted(
            axpy(of_x, known, x), axpy(of_v, known, velocity), c.share * of_x, c.share * of_v
        )

    def own(self, state: State, h: Any, x: Vec, rate: Vec) -> Vec:
        """Return a₁."""
        return axpy(self.coefficients.share, rate, self._known(state))

    def _known(self, state: State) -> Vec:
        """Return a₁ without its term with V̇₁."""
        c, n = self.coefficients, len(state.v_or_mu)
        rate, a = state.carried[:n], state.carried[n : 2 * n]
        return scale(1.0 / (1.0 - c.alpha_m), axpy(-c.alpha_m, a, scale(c.alpha_f, rate)))
