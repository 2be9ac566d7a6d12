"""Check the coefficients of methods."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from lierb.errors import ArgumentError, brief, items_of
from lierb.support.arrays import are_finite, as_floats, is_whole

# Published coefficients have 15 to 20 digits, which limits the accuracy of their sums.
TOLERANCE = 1e-13
MOST_STAGES = 64  # a step is compiled stage by stage; methods of order 14 have 35
MOST_ERROR_ROWS = 2

Row = tuple[float, ...]


def row_of(argument: str, given: Any) -> Row:
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


def rows_of(argument: str, given: Any) -> tuple[Row, ...]:
    """Convert to rows of numbers, of any lengths."""
    items = items_of(argument, given, "rows of numbers")
    if len(items) > MOST_STAGES:
        raise ArgumentError(f"{argument} has {len(items)} rows; expected {MOST_STAGES} at most")
    return tuple(row_of(f"row {i} of {argument}", item) for i, item in enumerate(items))


def explicit(row: Row, known: int, what: str) -> Row:
    """Return the weights of the first `known` stages; raise if a later weight is not zero."""
    if len(row) < known or any(x != 0.0 for x in row[known:]):
        raise ArgumentError(
            f"{what} is {brief(row)}; an explicit method has {known} numbers there, "
            "and zeros after them"
        )
    return row[:known]


def require_sum(numbers: Iterable[float], expected: float, what: str, told_expected: str) -> None:
    """Raise unless the numbers add up to `expected`, up to rounding."""
    summed = tuple(numbers)
    total = sum(summed)
    if not abs(total - expected) <= TOLERANCE * max(1.0, *map(abs, (*summed, 0.0))):
        raise ArgumentError(f"{what} adds up to {total!r}, not to {told_expected}")


def require_order(name: str, order: Any, most: int) -> None:
    if order is not None and not (is_whole(order) and 1 <= order <= most):
        raise ArgumentError(
            f"{name}={brief(order)}; expected a whole number, 1 … {most}: an explicit method has "
            "at least as many stages as its order"
        )


def require_both(name: str, order: Any, of: str, given: Any) -> None:
    """Raise if an order is set without the coefficients that it describes."""
    if order is not None and given is None:
        raise ArgumentError(f"{name}={order} is given without {of}; give {of}= too")
