"""Compiled code is specialised on schemes, the coefficients of one-step methods."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any, ClassVar

Stages = tuple[tuple[float, ...], ...]  # rows of weights of the stages before


@dataclass(frozen=True)
class Embedded:
    """An embedded method estimates the error of a step.

    weights : one row, b − b̂, or two rows, E₅ and E₃ of DOP853.   order : order of b̂.
    """

    weights: Stages
    order: int


@dataclass(frozen=True)
class Extension:
    """A continuous extension has further stages, and each stage's weight as a polynomial in θ.

    The polynomial is Σ weights[i][k] θᵏ⁺¹.
    """

    stages: Stages
    weights: Stages


@dataclass(frozen=True)
class HashedOnce:
    """Frozen dataclasses with many members inherit a hash that is computed once."""

    def __init_subclass__(cls) -> None:
        cls.__hash__ = HashedOnce.__hash__  # type: ignore[method-assign]  # a dataclass keeps it

    @cached_property
    def _digest(self) -> int:
        return hash(tuple(getattr(self, field.name) for field in fields(self)))

    def __hash__(self) -> int:
        return self._digest


@dataclass(frozen=True, kw_only=True)
class Scheme(HashedOnce):
    """A scheme is what compiled code knows of a one-step method: its coefficients.

    embedded, extension : error estimate and continuous extension; None without these.
    """

    embedded: Embedded | None = None
    extension: Extension | None = None
    iterates: ClassVar[bool] = False  # True if a step solves equations by iteration

    @property
    def described(self) -> dict[str, Any]:
        """Return the arguments of the class in `lierb.methods` that make the same method."""
        own = fields(self)[len(fields(Scheme)) :]
        return {field.name: getattr(self, field.name) for field in own}

    @property
    def length(self) -> float:
        """Return the number of stages in the code of a step; infinite for a method without any."""
        return math.inf

    def carried(self, rows: int, width: int = 6) -> int:
        """Return how many numbers a step passes on to the next one, beside the state.

        rows : number of the system's constraint rows.   width : number of components of V.
        """
        return 0


@dataclass(frozen=True, kw_only=True)
class StagedScheme(Scheme):
    """A method with stages has kᵢ at y + h Σ stages[i][j] kⱼ and ends at y + h Σ bᵢ kᵢ.

    stages : strictly lower triangle of a matrix, row by row; rows for the error estimate are last.
    weights : b.
    """

    stages: Stages
    weights: tuple[float, ...]

    @property
    def described(self) -> dict[str, Any]:
        numbers: dict[str, Any] = {"A": self.stages, "b": self.weights}
        if self.embedded is not None:
            numbers |= {"error": self.embedded.weights, "error_order": self.embedded.order}
        if self.extension is not None:
            numbers["dense"] = self.extension.weights
        return numbers

    @property
    def length(self) -> float:
        return len(self.stages)

    @property
    def last_stage(self) -> int:
        """Return the number of stages needed without error estimate and dense output."""
        return max(i for i, weight in enumerate(self.weights, 1) if weight != 0.0)


@dataclass(frozen=True, kw_only=True)
class ExplicitScheme(StagedScheme):
    """An explicit Runge–Kutta method has the matrix A and weights b of its Butcher tableau.

    exponentials : rows of weights of a commutator-free method, for each stage, then for the end.
    """

    exponentials: tuple[Stages, ...] = ()

    @property
    def described(self) -> dict[str, Any]:
        numbers = super().described
        if self.exponentials:
            numbers["exponentials"] = self.exponentials
        if self.extension is not None:
            numbers["dense_A"] = self.extension.stages
        return numbers


@dataclass(frozen=True, kw_only=True)
class RosenbrockScheme(StagedScheme):
    """A Rosenbrock method solves linear equations in each stage.

    (1 − γhJ) kᵢ = γ (f(t + αᵢ h, y + h Σ Aᵢⱼ kⱼ) + Σ Cᵢⱼ kⱼ + γᵢ h ∂f/∂t).

    stages : A.   couplings : C.   nodes, late : αᵢ and γᵢ.
    """

    gamma: float
    couplings: Stages
    nodes: tuple[float, ...]
    late: tuple[float, ...]

    @property
    def described(self) -> dict[str, Any]:
        return {**super().described, "C": self.couplings, "gamma": self.gamma}


@dataclass(frozen=True, kw_only=True)
class VerletScheme(Scheme):
    """A variational Störmer–Verlet step is composed of substeps.

    shares : lengths of the substeps, as fractions of the step.
    """

    shares: tuple[float, ...]

    iterates = True


@dataclass(frozen=True, kw_only=True)
class RattleScheme(Scheme):
    """RATTLE on a Lie group has no coefficients."""

    iterates = True


@dataclass(frozen=True, kw_only=True)
class ShakeScheme(Scheme):
    """SHAKE on a Lie group has no coefficients."""

    iterates = True

    def carried(self, rows: int, width: int = 6) -> int:
        """Return the number of X and of its failure (1)."""
        return width + 1


@dataclass(frozen=True, kw_only=True)
class BLieDFScheme(Scheme):
    """A backward differentiation formula on a Lie group has an order, its number of steps."""

    order: int

    iterates = True

    def carried(self, rows: int, width: int = 6) -> int:
        """Return the number of V̇, of V and Δ of an earlier step with two steps, and of λ."""
        return (2 * self.order - 1) * width + rows


@dataclass(frozen=True, kw_only=True)
class AlphaScheme(Scheme):
    """A generalised α method has two parameters.

    rho : ρ∞, the amplification of infinitely fast oscillations.
    index : 3, position constraints alone, or 2, velocity constraints as well.
    """

    rho: float
    index: int

    iterates = True

    def carried(self, rows: int, width: int = 6) -> int:
        """Return the number of V̇, a and λ."""
        return 2 * width + rows
