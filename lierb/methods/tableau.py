"""Butcher tableaus are coefficients of Runge–Kutta methods, checked when a tableau is made."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from lierb.errors import ArgumentError, brief, items_of
from lierb.kernels.systems.plan import UPDATES
from lierb.kernels.systems.scheme import Embedded, ExplicitScheme, Extension
from lierb.methods.checks import (
    MOST_STAGES,
    TOLERANCE,
    Row,
    explicit,
    require_both,
    require_order,
    require_sum,
    row_of,
    rows_of,
)
from lierb.methods.method import StagedMethod, floats, lower_triangle

__all__ = ["MOST_STAGES", "ButcherTableau"]


@dataclass(frozen=True)
class ButcherTableau(StagedMethod):
    """A Butcher tableau defines an explicit Runge–Kutta method.

    k_i = f(t + c_i h, y + h Σ_j A_ij k_j), y ← y + h Σ b_i k_i.

    Parameters
    ----------
    A : sequence of rows, shape (s, s)
        Matrix A, or its strictly lower triangle as rows of 0, 1, …, s−1 numbers.
    b : sequence of float, shape (s,)
        Weights.
    c : sequence of float, shape (s,), optional
        Nodes; they must be the row sums of A.
    name : str, optional
        Name of the method.
    order : int, optional
        Order of the method.
    source : str, optional
        Publication.
    error : sequence of rows, shape (1, s) or (2, s), optional
        Weights of the error estimate, for adaptive steps. One row: b − b̂ of an embedded method,
        whose error is h Σ (b_i − b̂_i) k_i. Two rows: the errors e₅ and e₃ of DOP853, combined to
        e₅²/√(e₅² + 0.01 e₃²).
    error_order : int, optional
        Order q of the embedded method: the error falls with h^(q+1).
    dense : sequence of rows, optional
        Coefficients of the continuous extension, y(t + θh) = y + h Σ b_i(θ) k_i with b_i(θ) = Σ_k
        dense[i][k] θ^(k+1), for output between steps: a row for each stage, then a row for each
        stage of `dense_A`.
    dense_A : sequence of rows, optional
        Rows of s, s + 1, … numbers: weights of further stages, evaluated for `dense` only.
    dense_order : int, optional
        Order of the continuous extension.
    exponentials : sequence of sequences of rows, optional
        Weights of Crouch–Grossman and commutator-free methods: an item for each stage and one for
        the end of the step. The rows w_1, w_2, … of an item update a pose C, Ċ = C V, to C exp(h
        Σ_j w_1j V_j) exp(h Σ_j w_2j V_j) …. The rows of an item add up to the stage's row of A, or
        to b. A and b step everything except the pose.

    Raises
    ------
    ArgumentError
        A is not strictly lower triangular, Σ_j A_ij ≠ c_i, Σ b_i ≠ 1, a row of `error` does not add
        up to 0, dense does not start with k₁, end with b or have Σ b_i(θ) = θ, or the rows of
        `exponentials` do not add up to those of A and b.

    Examples
    --------
    >>> import lierb
    >>> lierb.ButcherTableau(A=[[], [2 / 3]], b=[1 / 4, 3 / 4], name="Ralston", order=2).stages
    2
    """

    A: Sequence[Sequence[float]]
    b: Sequence[float]
    c: Sequence[float] | None = None
    name: str = "user's"
    order: int | None = None
    source: str = field(default="", repr=False)
    error: Sequence[Sequence[float]] | None = field(default=None, repr=False)
    error_order: int | None = None
    dense: Sequence[Sequence[float]] | None = field(default=None, repr=False)
    dense_A: Sequence[Sequence[float]] = field(default=(), repr=False)
    dense_order: int | None = None
    exponentials: Sequence[Sequence[Sequence[float]]] | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        self._check_steps()
        self._check_error()
        self._check_dense()
        self._check_exponentials()

    def _check_steps(self) -> None:
        b = row_of("b", self.b)
        if not isinstance(self.name, str):
            raise ArgumentError(f"name={brief(self.name)}; expected a text")
        lower = lower_triangle("A", self.A)
        if len(lower) != len(b):
            raise ArgumentError(f"the tableau has {len(lower)} rows of A for {len(b)} weights b")
        sums = tuple(float(sum(row)) for row in lower)
        c = sums if self.c is None else row_of("c", self.c)
        if len(c) != len(b):
            raise ArgumentError(f"the tableau has {len(c)} nodes c for {len(b)} weights b")
        for i, (total, node) in enumerate(zip(sums, c, strict=True)):
            if abs(total - node) > TOLERANCE:
                raise ArgumentError(f"row {i} of A adds up to {total!r}, but c[{i}] = {node!r}")
        if abs(sum(b) - 1.0) > TOLERANCE:
            raise ArgumentError(f"the weights b add up to {sum(b)!r}, not to 1")
        require_order("order", self.order, len(b))
        self._set("A", lower)
        self._set("b", b)
        self._set("c", c)

    def _check_error(self) -> None:
        rows = self._checked_error()
        for i, row in enumerate(rows):
            require_sum(row, 0.0, f"row {i} of error", "0; it is b − b̂, both of which add up to 1")
        self._set("error", rows or None)

    def _check_dense(self) -> None:
        further = rows_of("dense_A", self.dense_A)
        require_order("dense_order", self.dense_order, self.stages + len(further))
        require_both("dense_order", self.dense_order, "dense", self.dense)
        if self.dense is None:
            if further:
                raise ArgumentError("dense_A is given without dense; give dense= too")
            self._set("dense_A", ())
            return
        stages = self.stages + len(further)
        if stages > MOST_STAGES:
            raise ArgumentError(f"A and dense_A have {stages} rows; expected {MOST_STAGES} at most")
        named = enumerate(further, self.stages)
        self._set(
            "dense_A",
            tuple(explicit(row, i, f"row {i - self.stages} of dense_A") for i, row in named),
        )
        rows = self._checked_dense(stages)
        self._check_continuity(rows)
        self._set("dense", rows)

    def _check_continuity(self, rows: tuple[Row, ...]) -> None:
        """Raise unless the extension starts at y in the direction k₁ and ends at the step's end."""
        for i, row in enumerate(rows):
            slope = float(i == 0)
            if abs(row[0] - slope) > TOLERANCE:
                raise ArgumentError(
                    f"row {i} of dense starts with {row[0]!r}; expected {slope}: a step starts in "
                    "the direction of its first stage"
                )
            end = self.b[i] if i < self.stages else 0.0
            whose = f"b[{i}] = {end!r}" if i < self.stages else "0, as of a stage of dense_A"
            require_sum(row, end, f"row {i} of dense", whose)
        for power, column in enumerate(zip(*rows, strict=True), 1):
            expected = float(power == 1)
            require_sum(column, expected, f"what dense has of θ^{power}", f"{expected}: Σ bᵢ(θ)=θ")

    def _check_exponentials(self) -> None:
        if self.exponentials is None:
            return
        if self.dense is not None:
            raise ArgumentError(
                "exponentials and dense are both given: a continuous extension is of methods "
                "without exponentials; leave one out"
            )
        items = items_of("exponentials", self.exponentials, "rows of weights for each stage")
        if len(items) != self.stages + 1:
            raise ArgumentError(
                f"exponentials has {len(items)} entries; expected {self.stages + 1}, one for each "
                "stage and one for the end of the step"
            )
        weights = []
        for i, (item, whole) in enumerate(zip(items, (*self.A, self.b), strict=True)):
            what = f"exponentials[{i}]"
            rows = tuple(
                explicit(row, len(whole), f"row {j} of {what}")
                for j, row in enumerate(rows_of(what, item))
            )
            for j, weight in enumerate(whole):
                name = f"b[{j}]" if i == self.stages else f"A[{i}][{j}]"
                require_sum((row[j] for row in rows), weight, f"column {j} of {what}",
                             f"{name} = {weight!r}")  # fmt: skip
            weights.append(rows)
        self._set("exponentials", tuple(weights))

    @property
    def is_fsal(self) -> bool:
        """Return whether the last stage is f at the step's end, the next step's first stage."""
        return self.stages > 1 and self.b[-1] == 0.0 and self.A[-1] == self.b[:-1]

    @property
    def updates(self) -> tuple[str, ...]:  # type: ignore[override]
        return ("local",) if self.exponentials else UPDATES

    def linear_stages(self, z: Any) -> list[Any]:
        stages: list[Any] = []
        for row in self.A:
            stages.append(z * (1.0 + sum(a * k for a, k in zip(row, stages, strict=True))))
        return stages

    def scheme_of(self, embedded: Embedded | None, extension: Extension | None) -> ExplicitScheme:
        return ExplicitScheme(
            stages=floats(self.A),
            weights=tuple(self.b),
            exponentials=tuple(map(floats, self.exponentials or ())),
            embedded=embedded,
            extension=extension,
        )
