"""Butcher tableaus: coefficients of Runge–Kutta methods, checked when a tableau is made."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from lierb.errors import ArgumentError, brief, items_of
from lierb.methods.calibration import calibration_of
from lierb.support.arrays import are_finite, as_floats, is_whole

# Published coefficients have 15 to 20 digits, which limits the accuracy of their sums.
_TOLERANCE = 1e-13
MOST_STAGES = 64  # a step is compiled stage by stage; methods of order 14 have 35
MOST_ERROR_ROWS = 2

Row = tuple[float, ...]


def _numbers(argument: str, given: Any) -> Row:
    numbers = as_floats(argument, given)
    if numbers.ndim != 1:
        raise ArgumentError(f"{argument} is {brief(given)}; expected a row of numbers")
    if numbers.size > MOST_STAGES:
        raise ArgumentError(
            f"{argument} has {numbers.size} numbers; expected {MOST_STAGES} at most"
        )
    if not are_finite(numbers):
        raise ArgumentError(f"{argument} is {brief(given)}; expected finite numbers")
    return tuple(numbers.tolist())


def _rows(argument: str, given: Any) -> tuple[Row, ...]:
    """Convert to rows of numbers, of any lengths."""
    items = items_of(argument, given, "rows of numbers")
    if len(items) > MOST_STAGES:
        raise ArgumentError(f"{argument} has {len(items)} rows; expected {MOST_STAGES} at most")
    return tuple(_numbers(f"row {i} of {argument}", item) for i, item in enumerate(items))


def _explicit(row: Row, known: int, what: str) -> Row:
    """Return the weights of the first `known` stages; raise if a later weight is not zero."""
    if len(row) < known or any(x != 0.0 for x in row[known:]):
        raise ArgumentError(
            f"{what} is {brief(row)}; an explicit method has {known} numbers there, "
            "and zeros after them"
        )
    return row[:known]


def _require_length(row: Row, length: int, what: str) -> None:
    if len(row) != length:
        raise ArgumentError(
            f"{what} has {len(row)} numbers; expected {length}, one for each stage (zeros too)"
        )


def _require_sum(numbers: Iterable[float], expected: float, what: str, told_expected: str) -> None:
    """Raise unless the numbers add up to `expected`, up to rounding."""
    summed = tuple(numbers)
    total = sum(summed)
    if not abs(total - expected) <= _TOLERANCE * max(1.0, *map(abs, (*summed, 0.0))):
        raise ArgumentError(f"{what} adds up to {total!r}, not to {told_expected}")


def _require_order(name: str, order: Any, most: int) -> None:
    if order is not None and not (is_whole(order) and 1 <= order <= most):
        raise ArgumentError(
            f"{name}={brief(order)}; expected a whole number, 1 … {most}: an explicit method has "
            "at least as many stages as its order"
        )


def _require_both(name: str, order: Any, of: str, given: Any) -> None:
    """Raise if an order is set without the coefficients that it describes."""
    if order is not None and given is None:
        raise ArgumentError(f"{name}={order} is given without {of}; give {of}= too")


@dataclass(frozen=True)
class ButcherTableau:
    """An explicit Runge–Kutta method: k_i = f(t + c_i h, y + h Σ_j A_ij k_j), y ← y + h Σ b_i k_i.

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

    def _set(self, name: str, value: Any) -> None:
        object.__setattr__(self, name, value)

    def _check_steps(self) -> None:
        b = _numbers("b", self.b)
        if not isinstance(self.name, str):
            raise ArgumentError(f"name={brief(self.name)}; expected a text")
        rows = _rows("A", self.A)
        if len(rows) != len(b):
            raise ArgumentError(f"the tableau has {len(rows)} rows of A for {len(b)} weights b")
        lower = tuple(_explicit(row, i, f"row {i} of A") for i, row in enumerate(rows))
        sums = tuple(float(sum(row)) for row in lower)
        c = sums if self.c is None else _numbers("c", self.c)
        if len(c) != len(b):
            raise ArgumentError(f"the tableau has {len(c)} nodes c for {len(b)} weights b")
        for i, (total, node) in enumerate(zip(sums, c, strict=True)):
            if abs(total - node) > _TOLERANCE:
                raise ArgumentError(f"row {i} of A adds up to {total!r}, but c[{i}] = {node!r}")
        if abs(sum(b) - 1.0) > _TOLERANCE:
            raise ArgumentError(f"the weights b add up to {sum(b)!r}, not to 1")
        _require_order("order", self.order, len(b))
        self._set("A", lower)
        self._set("b", b)
        self._set("c", c)

    def _check_error(self) -> None:
        _require_order("error_order", self.error_order, self.stages)
        _require_both("error_order", self.error_order, "error", self.error)
        if self.error is None:
            return
        if self.error_order is None:
            raise ArgumentError(
                "error is given without error_order; give the order of the embedded method, by "
                "which steps are chosen"
            )
        rows = _rows("error", self.error)
        if not 1 <= len(rows) <= MOST_ERROR_ROWS:
            raise ArgumentError(
                f"error has {len(rows)} rows; expected one, b − b̂, or the two of DOP853"
            )
        for i, row in enumerate(rows):
            _require_length(row, self.stages, f"row {i} of error")
            _require_sum(row, 0.0, f"row {i} of error", "0; it is b − b̂, both of which add up to 1")
            if not any(row):
                raise ArgumentError(f"row {i} of error has zeros alone; it is b − b̂")
        self._set("error", rows)

    def _check_dense(self) -> None:
        further = _rows("dense_A", self.dense_A)
        _require_order("dense_order", self.dense_order, self.stages + len(further))
        _require_both("dense_order", self.dense_order, "dense", self.dense)
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
            tuple(_explicit(row, i, f"row {i - self.stages} of dense_A") for i, row in named),
        )
        rows = _rows("dense", self.dense)
        if len(rows) != stages:
            raise ArgumentError(
                f"dense has {len(rows)} rows; expected {stages}, one for each row of A and dense_A"
            )
        degree = max(1, *map(len, rows))
        rows = tuple((*row, *[0.0] * (degree - len(row))) for row in rows)
        self._check_continuity(rows)
        self._set("dense", rows)

    def _check_continuity(self, rows: tuple[Row, ...]) -> None:
        """Raise unless the extension starts at y in the direction k₁ and ends at the step's end."""
        for i, row in enumerate(rows):
            slope = float(i == 0)
            if abs(row[0] - slope) > _TOLERANCE:
                raise ArgumentError(
                    f"row {i} of dense starts with {row[0]!r}; expected {slope}: a step starts in "
                    "the direction of its first stage"
                )
            end = self.b[i] if i < self.stages else 0.0
            whose = f"b[{i}] = {end!r}" if i < self.stages else "0, as of a stage of dense_A"
            _require_sum(row, end, f"row {i} of dense", whose)
        for power, column in enumerate(zip(*rows, strict=True), 1):
            expected = float(power == 1)
            _require_sum(column, expected, f"what dense has of θ^{power}", f"{expected}: Σ bᵢ(θ)=θ")

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
                _explicit(row, len(whole), f"row {j} of {what}")
                for j, row in enumerate(_rows(what, item))
            )
            for j, weight in enumerate(whole):
                name = f"b[{j}]" if i == self.stages else f"A[{i}][{j}]"
                _require_sum((row[j] for row in rows), weight, f"column {j} of {what}",
                             f"{name} = {weight!r}")  # fmt: skip
            weights.append(rows)
        self._set("exponentials", tuple(weights))

    @property
    def stages(self) -> int:
        return len(self.b)

    @cached_property
    def calibration(self) -> float:
        """Ratio of the tolerance to the largest estimated error of a step.

        With this ratio, the error of a uniform rotation equals the tolerance after thirty turns.
        The ratio is at least 10; without `error` it is 1.
        """
        if self.error is None or self.error_order is None:
            return 1.0
        return calibration_of(self.A, self.b, self.error, self.error_order)

    @property
    def is_fsal(self) -> bool:
        """True if the last stage is f at the end of the step, hence the next step's first stage."""
        return self.stages > 1 and self.b[-1] == 0.0 and self.A[-1] == self.b[:-1]
