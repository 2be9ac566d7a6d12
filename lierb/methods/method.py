"""All methods, of any family, have the interface that a run reads."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from lierb.errors import ArgumentError
from lierb.kernels.systems.plan import UPDATES
from lierb.kernels.systems.scheme import Embedded, Extension, Scheme, Stages
from lierb.methods.calibration import calibration_of
from lierb.methods.checks import MOST_ERROR_ROWS, explicit, require_both, require_order, rows_of

Rows = Sequence[Sequence[float]]
LARGEST = 200.0  # most decimal digits of |hλ|^stages, so that R does not overflow


class Limits(NamedTuple):
    """Limits say to which systems and runs a method is confined, without extra states.

    systems : phrase for messages.   solver : solver of a single body.
    cspaces : configuration spaces.   takes_constraints : True if it satisfies constraints beside
    those of the joint, and the joints of mechanisms.   cuts_steps : True if steps may differ in
    length.
    """

    systems: str
    solver: str
    cspaces: tuple[str, ...]
    takes_constraints: bool
    cuts_steps: bool


class Method(ABC):
    """A one-step method, of any family, has the interface that a run reads.

    `lierb.methods.METHODS` has the methods of the catalogue by name.
    """

    name: str
    order: int | None
    source: str
    error: Rows | None = None
    error_order: int | None = None
    updates: tuple[str, ...] = UPDATES  # values of `update=` with which the method works
    needs_derivatives = False  # of forces and extra states
    limits: Limits | None = None  # None for a method of all systems

    @property
    def evaluations(self) -> float:
        """Return how many right-hand sides a step without estimate needs; NaN if it varies."""
        return math.nan

    @property
    def calibration(self) -> float:
        """Return the ratio of the tolerance to the largest estimated error of a step."""
        return 1.0

    @abstractmethod
    def amplification(self, z: Any) -> Any:
        """Return the factor by which a step changes a mode e^(λt).   z : hλ, complex array."""

    @abstractmethod
    def scheme(self, is_adaptive: bool, interpolates: bool) -> Scheme:
        """Return the coefficients for the kernels, the same object for the same arguments.

        is_adaptive : whether steps have an error estimate.
        interpolates : whether states between steps are needed.
        """


class StagedMethod(Method):
    """A one-step method has stages k_i and ends a step at y + h Σ b_i k_i."""

    A: Rows
    b: Sequence[float]
    dense: Rows | None
    dense_A: Rows
    dense_order: int | None

    @property
    def stages(self) -> int:
        return len(self.b)

    @property
    def evaluations(self) -> float:
        """Return the number of stages of a step without error estimate."""
        return 1 + max(i for i, weight in enumerate(self.b) if weight)

    @cached_property
    def calibration(self) -> float:
        """Return the ratio of the tolerance to the largest estimated error of a step.

        With this ratio, the error of a uniform rotation equals the tolerance after thirty turns.
        The ratio is at least 10; without `error` it is 1.
        """
        if self.error is None or self.error_order is None:
            return 1.0
        return calibration_of(self.linear_stages, self.b, self.error, self.error_order)

    @abstractmethod
    def linear_stages(self, z: Any) -> list[Any]:
        """Return h k_i of a step of length h on ẏ = λy from y = 1.   z : hλ, complex."""

    def amplification(self, z: Any) -> Any:
        """Return the stability function R(z); of a Runge–Kutta method 1 + z bᵀ(1 − zA)⁻¹(1, …, 1)ᵀ.

        z : hλ, scaled down if R would overflow.
        Hairer and Wanner, Solving Ordinary Differential Equations II, IV.2.
        """
        size, most = np.abs(z), 10.0 ** (LARGEST / self.stages)
        z = np.where(size > most, z * (most / np.where(size > 0.0, size, 1.0)), z)
        changes = self.linear_stages(z)
        return 1.0 + sum(b * change for b, change in zip(self.b, changes, strict=True))

    def scheme(self, is_adaptive: bool, interpolates: bool) -> Scheme:
        wanted = is_adaptive, interpolates
        if wanted not in self._schemes:
            embedded = extension = None
            if is_adaptive:
                assert self.error is not None
                assert self.error_order is not None
                embedded = Embedded(floats(self.error), self.error_order)
            if interpolates and self.dense is not None:
                extension = Extension(floats(self.dense_A), floats(self.dense))
            self._schemes[wanted] = self.scheme_of(embedded, extension)
        return self._schemes[wanted]

    @cached_property
    def _schemes(self) -> dict[tuple[bool, bool], Scheme]:
        return {}

    @abstractmethod
    def scheme_of(self, embedded: Embedded | None, extension: Extension | None) -> Scheme:
        """Return coefficients for the kernels, with an error estimate and continuous extension."""

    # ---- checks of a new method ----

    def _set(self, name: str, value: Any) -> None:
        object.__setattr__(self, name, value)

    def _checked_error(self) -> Stages:
        """Return the rows of the error estimate, one for each row given."""
        require_order("error_order", self.error_order, self.stages)
        require_both("error_order", self.error_order, "error", self.error)
        if self.error is None:
            return ()
        if self.error_order is None:
            raise ArgumentError(
                "error is given without error_order; give the order of the embedded method, by "
                "which steps are chosen"
            )
        rows = rows_of("error", self.error)
        if not 1 <= len(rows) <= MOST_ERROR_ROWS:
            raise ArgumentError(
                f"error has {len(rows)} rows; expected one, b − b̂, or the two of DOP853"
            )
        for i, row in enumerate(rows):
            if len(row) != self.stages:
                raise ArgumentError(
                    f"row {i} of error has {len(row)} numbers; expected {self.stages}, one for "
                    "each stage (zeros too)"
                )
            if not any(row):
                raise ArgumentError(f"row {i} of error has zeros alone; it is b − b̂")
        return rows

    def _checked_dense(self, stages: int) -> Stages:
        """Return the rows of the continuous extension, filled up with zeros to one length."""
        assert self.dense is not None
        rows = rows_of("dense", self.dense)
        if len(rows) != stages:
            further = " and dense_A" if stages > self.stages else ""
            raise ArgumentError(
                f"dense has {len(rows)} rows; expected {stages}, one for each row of A{further}"
            )
        degree = max(1, *map(len, rows))
        return tuple((*row, *[0.0] * (degree - len(row))) for row in rows)


def lower_triangle(argument: str, given: Any) -> Stages:
    """Return the strictly lower triangle of a square matrix, or of its triangle, row by row."""
    rows = rows_of(argument, given)
    return tuple(explicit(row, i, f"row {i} of {argument}") for i, row in enumerate(rows))


def floats(rows: Rows) -> Stages:
    return tuple(tuple(row) for row in rows)
