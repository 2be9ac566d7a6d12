"""Tableaus of Rosenbrock methods are checked when a tableau is made."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lierb.errors import ArgumentError, brief
from lierb.kernels.systems.scheme import Embedded, Extension, RosenbrockScheme
from lierb.methods.checks import MOST_STAGES, require_both, require_order, row_of
from lierb.methods.method import StagedMethod, floats, lower_triangle

# Sums of coefficients up to 165 with 15 digits.
_TOLERANCE = 1e-12


@dataclass(frozen=True)
class RosenbrockTableau(StagedMethod):
    """A Rosenbrock method is for stiff systems; a step solves linear equations, without iteration.

    With the Jacobian J of f at the start of a step, its stages are (1 − γhJ) k_i = γ (f(t + α_i h,
    y + h Σ_j A_ij k_j) + Σ_j C_ij k_j + γ_i h ∂f/∂t), and y ← y + h Σ b_i k_i. This is the form in
    which codes evaluate such methods, u_i = h k_i in Hairer and Wanner, Solving ODEs II, IV.7,
    eq. 7.25; `from_standard` converts the other one.

    Parameters
    ----------
    A : sequence of rows, shape (s, s)
        Matrix A, or its strictly lower triangle as rows of 0, 1, …, s−1 numbers.
    b : sequence of float, shape (s,)
        Weights.
    C : sequence of rows, shape (s, s)
        Matrix C, or its strictly lower triangle.
    gamma : float
        Coefficient γ of the Jacobian.
    name : str, optional
        Name of the method.
    order : int, optional
        Order of the method.
    source : str, optional
        Publication.
    error : sequence of one row, shape (1, s), optional
        Weights b − b̂ of the error estimate, for adaptive steps.
    error_order : int, optional
        Order q of the embedded method: the error falls with h^(q+1).
    dense : sequence of rows, shape (s, m), optional
        Coefficients of the continuous extension, y(t + θh) = y + h Σ b_i(θ) k_i with b_i(θ) = Σ_k
        dense[i][k] θ^(k+1), for output between steps.
    dense_order : int, optional
        Order of the continuous extension.

    Raises
    ------
    ArgumentError
        A or C is not strictly lower triangular, γ is not positive, the method is not consistent
        (for constant f a step must end at y + h f), or the rows of `error` and `dense` do not fit.

    Examples
    --------
    >>> import lierb
    >>> euler = lierb.methods.RosenbrockTableau([[]], [1], [[]], gamma=1, order=1)
    >>> euler.nodes
    (0.0,)
    """

    A: Sequence[Sequence[float]]
    b: Sequence[float]
    C: Sequence[Sequence[float]]
    gamma: float
    name: str = "user's"
    order: int | None = None
    source: str = field(default="", repr=False)
    error: Sequence[Sequence[float]] | None = field(default=None, repr=False)
    error_order: int | None = None
    dense: Sequence[Sequence[float]] | None = field(default=None, repr=False)
    dense_order: int | None = None

    updates = ("local",)
    needs_derivatives = True
    dense_A = ()

    @classmethod
    def from_standard(
        cls,
        alpha: ArrayLike,
        gamma: ArrayLike,
        b: ArrayLike,
        error: ArrayLike | None = None,
        **more: Any,
    ) -> RosenbrockTableau:
        """Convert k_i = h f(y + Σ_j α_ij k_j) + h J Σ_j γ_ij k_j, y ← y + Σ b_i k_i.

        Parameters
        ----------
        alpha, gamma : array_like, shape (s, s)
            Coefficients; γ lower triangular, with one number on its diagonal.
        b : array_like, shape (s,)
            Weights.
        error : array_like, shape (s,), optional
            b − b̂.
        **more
            name, order, source and error_order, as for the class.

        Returns
        -------
        RosenbrockTableau
            The same method.

        References
        ----------
        Hairer and Wanner, Solving Ordinary Differential Equations II, IV.7, eqs. 7.4, 7.23 to 7.25.
        """
        slopes = np.array(gamma, dtype=float)
        inverse = np.linalg.inv(slopes)
        diagonal = float(slopes[0, 0])

        def cleaned(row: Any) -> list[float]:
            return [0.0 if abs(x) < _TOLERANCE else float(x) for x in row]

        def lower(matrix: Any) -> list[list[float]]:
            return [cleaned(row[:i]) for i, row in enumerate(matrix)]

        if error is not None:
            more["error"] = [cleaned(np.asarray(error) @ inverse)]
        return cls(
            lower(np.asarray(alpha) @ inverse), cleaned(np.asarray(b) @ inverse),
            lower(np.eye(len(slopes)) / diagonal - inverse), diagonal, **more,
        )  # fmt: skip

    def __post_init__(self) -> None:
        b = row_of("b", self.b)
        matrices = {name: lower_triangle(name, getattr(self, name)) for name in ("A", "C")}
        for name, rows in matrices.items():
            if len(rows) != len(b):
                raise ArgumentError(f"{name} has {len(rows)} rows for {len(b)} weights b")
        (gamma,) = row_of("gamma", [self.gamma])
        if not gamma > 0.0:
            raise ArgumentError(f"gamma={brief(self.gamma)}; expected a positive number")
        for name, value in (*matrices.items(), ("b", b), ("gamma", gamma)):
            self._set(name, value)
        require_order("order", self.order, MOST_STAGES)
        self._require_sum("b", b, 1.0)
        self._check_error()
        self._check_dense()

    def _check_error(self) -> None:
        rows = self._checked_error()
        for row in rows:
            self._require_sum("error", row, 0.0)
        self._set("error", rows or None)

    def _check_dense(self) -> None:
        require_order("dense_order", self.dense_order, MOST_STAGES)
        require_both("dense_order", self.dense_order, "dense", self.dense)
        if self.dense is None:
            return
        rows = self._checked_dense(self.stages)
        for power, column in enumerate(zip(*rows, strict=True), 1):
            self._require_sum(f"what dense has of θ^{power}", column, float(power == 1))
        for i, row in enumerate(rows):
            if abs(sum(row) - self.b[i]) > _TOLERANCE * max(1.0, *map(abs, row)):
                raise ArgumentError(
                    f"row {i} of dense adds up to {sum(row)!r}; expected b[{i}] = {self.b[i]!r}, "
                    "the end of the step"
                )
        self._set("dense", rows)

    def _require_sum(self, what: str, weights: Sequence[float], expected: float) -> None:
        """Raise unless Σ weights k_i = expected for f = 1."""
        terms = [w * k for w, k in zip(weights, self.constant_stages, strict=True)]
        if abs(sum(terms) - expected) > _TOLERANCE * max(1.0, *map(abs, terms)):
            raise ArgumentError(f"{what}: for f = 1, Σ b_i k_i is {sum(terms)!r}, not {expected}")

    @cached_property
    def constant_stages(self) -> tuple[float, ...]:
        """k_i for f = 1; they are also γ_i = Σ_j γ_ij."""
        stages: list[float] = []
        for couplings in self.C:
            coupled = sum(c * k for c, k in zip(couplings, stages, strict=True))
            stages.append(_exact(self.gamma * (1.0 + coupled)))
        return tuple(stages)

    @cached_property
    def nodes(self) -> tuple[float, ...]:
        """Return the node α_i of each stage."""
        return tuple(
            _exact(sum(a * k for a, k in zip(row, self.constant_stages, strict=False)))
            for row in self.A
        )

    def linear_stages(self, z: Any) -> list[Any]:
        stages: list[Any] = []
        for weights, couplings in zip(self.A, self.C, strict=True):
            change = z * (1.0 + sum(a * k for a, k in zip(weights, stages, strict=True)))
            coupled = sum(c * k for c, k in zip(couplings, stages, strict=True))
            stages.append(self.gamma * (change + coupled) / (1.0 - self.gamma * z))
        return stages

    def scheme_of(self, embedded: Embedded | None, extension: Extension | None) -> RosenbrockScheme:
        return RosenbrockScheme(
            stages=floats(self.A),
            weights=tuple(self.b),
            gamma=self.gamma,
            couplings=floats(self.C),
            nodes=self.nodes,
            late=self.constant_stages,
            embedded=embedded,
            extension=extension,
        )


def _exact(number: float) -> float:
    """Return 0 or 1 for a number that is so up to the rounding of published coefficients."""
    nearest = round(number)
    return float(nearest) if abs(number - nearest) < _TOLERANCE else number
