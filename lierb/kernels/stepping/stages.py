"""A step with stages ends at y + h Σ bᵢ kᵢ; error and dense output are sums of kᵢ too."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from lierb.kernels.numbers.arithmetic import fma, maximum
from lierb.kernels.numbers.vec import Vec, axpy
from lierb.kernels.numbers.zero import ZERO, is_zero
from lierb.kernels.stepping.method import Defect, Interval, Step
from lierb.kernels.systems.combine import weighted
from lierb.kernels.systems.scheme import StagedScheme, Stages
from lierb.kernels.systems.state import Factors, Slopes, State, Units, Weights
from lierb.kernels.systems.system import AnySystem


@dataclass(frozen=True)
class StageMethod:
    """This base of methods with stages lacks the equations for each kᵢ; see `Method`."""

    scheme: StagedScheme

    def with_stages(
        self, system: AnySystem, body: Any, state: State, at: Interval, slopes: Slopes, rows: Stages
    ) -> tuple[Slopes, Any]:
        """Return the slopes with those of further stages, and 1 where any stage is singular."""
        raise NotImplementedError

    def started(self, system: AnySystem, body: Any, state: State, at: Interval) -> State:
        return state

    def step(
        self, system: AnySystem, body: Any, state: State, at: Interval, all_stages: bool = False
    ) -> Step:
        scheme = self.scheme
        rows = scheme.stages if all_stages else scheme.stages[: scheme.last_stage]
        slopes, singular = self.with_stages(system, body, state, at, Slopes(), rows)
        ended = self._ended(system, body, state, at.h, slopes, scheme.weights, self.end_factors)
        kept = system.stabilised(body, state, ended, at.time + at.span, at.h)
        if not is_zero(kept.singular):
            singular = maximum(singular, kept.singular)
        return Step(kept.state, slopes, singular, kept)

    def extended(
        self, system: AnySystem, body: Any, state: State, at: Interval, slopes: Slopes
    ) -> Slopes:
        """Append the further stages of the continuous extension."""
        assert self.scheme.extension is not None
        rows = self.scheme.extension.stages
        return self.with_stages(system, body, state, at, slopes, rows)[0] if rows else slopes

    def between(
        self, system: AnySystem, body: Any, state: State, at: Interval, slopes: Slopes, theta: Any
    ) -> State:
        """Return the state at time + θ h, by the continuous extension or else by a step of θ h.

        The pose is C₀ exp X(θ): on the group, and for a subgroup joint on its subgroup.
        """
        if self.scheme.extension is None:
            return self.step(system, body, state, at.part(theta)).state
        weights = tuple(_polynomial(theta, terms) for terms in self.scheme.extension.weights)
        ended = self._ended(system, body, state, at.h, slopes, weights, None)
        time = fma(theta, at.span, at.time)
        return system.stabilised(body, state, ended, time, theta * at.h).state

    def defects(self, system: AnySystem, body: Any, slopes: Slopes, h: Any) -> tuple[Defect, ...]:
        """Return h Σ weights · slopes for the weights of each error estimate."""
        assert self.scheme.embedded is not None
        return tuple(
            self._defect(system, body, slopes, h, weights)
            for weights in self.scheme.embedded.weights
        )

    def extrapolated(self, system: AnySystem, state: State, slopes: Slopes, h: Any) -> State:
        unit = self.slope_units(system, h)[1]
        return state._replace(v_or_mu=axpy(unit, slopes.v_or_mu[0], state.v_or_mu))

    def _defect(
        self, system: AnySystem, body: Any, slopes: Slopes, h: Any, weights: tuple[float, ...]
    ) -> Defect:
        base, rest = beside_the_step(self.scheme.weights, weights)

        def times(unit: Any, rates: tuple[Vec, ...]) -> Vec:
            total = weighted((ZERO,) * len(rates[0]), base, rates)
            return tuple(unit * each for each in weighted(total, rest, rates))

        x_unit, unit = self.slope_units(system, h)
        x, v_or_mu = times(x_unit, slopes.x), times(unit, slopes.v_or_mu)
        states = times(h, slopes.states)
        turning, moving = system.turning_and_moving(system.in_algebra(body, x))
        return Defect(turning, moving, system.velocity(body, v_or_mu), states)

    def _ended(
        self,
        system: AnySystem,
        body: Any,
        state: State,
        h: Any,
        slopes: Slopes,
        weights: Weights,
        factors: Factors | None,
    ) -> State:
        """Add h Σ weights · slopes to the state; the pose by all factors, or one exponential."""
        x_unit, unit = self.slope_units(system, h)
        # Sums without the state also appear in error estimates.
        units = Units(0.5 * x_unit, unit, h, self.scheme.embedded is not None)
        ended = system.combine(body, state, weights, slopes, units, factors)
        return ended if factors is not None else system.move(body, ended)

    @property
    def end_factors(self) -> Factors | None:
        """Weights of the exponentials of a step's end; None for one exponential of X."""
        return None

    def slope_units(self, system: AnySystem, h: Any) -> tuple[Any, Any]:
        """Return the factors of the sums of slopes for X, and for V or μ."""
        return h, h


def beside_the_step(
    step: tuple[float, ...], error: tuple[float, ...]
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Split an error's weights into those of the step and few others, if that is shorter.

    The step's sum is emitted as in the step itself, so that LLVM computes it only once. DOP853's
    weights of third order differ from the step's in 3 of 12.
    """
    step += (0.0,) * (len(error) - len(step))
    rest = tuple(e - b for e, b in zip(error, step, strict=True))
    if sum(map(bool, rest)) < sum(map(bool, error)):
        return step, rest
    return (), error


def _polynomial(theta: Any, terms: tuple[float, ...]) -> Any:
    """Return Σ terms[k] θᵏ⁺¹; 0.0 where there are none."""
    if not any(terms):
        return 0.0
    *lower, total = terms
    total = theta * total
    for term in reversed(lower):
        total = theta * (total + term)
    return total
