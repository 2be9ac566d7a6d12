"""How an error falls with the step size: the observed order and the verdict drawn from it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lierb.arrays import Array, are_finite, as_floats, as_positive
from lierb.errors import ArgumentError, told

ROUNDING_FLOOR = 1e-11
"""Errors up to this, relative to the size of what they are errors of, count as rounding."""

ORDER_TOLERANCE = 0.25
"""How far an observed order may lie from a whole number and still be given as that number. With
steps ten times apart the coarser one is often not yet in the asymptotic range: the universal joint
with global updates shows 3.84 between dt = 1e-2 and 1e-3."""

SLOPE_TOLERANCE = 0.05
"""How far slopes between neighbours may differ, relative to them, in the asymptotic range."""

EXACT = "exact"  # every error at rounding
DRIFTS = "drifts"  # falls with the step size, at no clear order
VIOLATED = "violated"  # does not fall with the step size
FAILED = "failed"  # not a number: the integration broke down


@dataclass(frozen=True)
class Order:
    """Slope of log(error) over log(dt).

    `lower_bound`: the finer of the two errors behind it is at rounding, so the true slope is at
    least this.
    `steps`: the step sizes of the errors behind it, s, the coarsest first.
    """

    slope: float
    lower_bound: bool = False
    steps: tuple[float, ...] = ()

    @property
    def is_asymptotic(self) -> bool:
        """Whether it was seen twice, between steps next to each other."""
        return len(self.steps) > 2 and not self.lower_bound

    def __str__(self) -> str:
        return f"{'>=' if self.lower_bound else ''}{round(self.slope, 2) + 0.0:.2f}"


def observed_order(
    dts: Sequence[float],
    errors: Sequence[float],
    size: float | Sequence[float] = 1.0,
    floor: Sequence[float] | None = None,
) -> Order | None:
    """Order of convergence observed in `errors`, or None when all of them are at rounding.

    The slope is that between the two finest steps whose errors are above rounding: coarser ones may
    not resolve the motion yet, errors at rounding say nothing. When only one error is above, its
    slope to the next finer step bounds the order.

    dts : step sizes, s.   errors : one for each.   size : what they are errors of, in their unit:
    the body's lengths and distances, m; 1 for angles; the motion's energies, J.
    floor : for each, the error up to which it counts as rounding. Default: ROUNDING_FLOOR of size.

    Raises ArgumentError for step sizes that are not positive, or not one for each error.

    >>> str(observed_order([1e-2, 1e-3, 1e-4], [3.5e-5, 3.5e-9, 3.8e-13]))
    '4.00'
    >>> str(observed_order([1e-2, 1e-3, 1e-4], [5.1e-8, 5.1e-12, 6.7e-13]))
    '>=4.00'
    """
    steps, error, above = _above(dts, errors, size, floor)
    if above.size == 0:
        return None
    coarse, fine = above[-2:] if above.size > 1 else (above[0], above[0] + 1)
    if fine == error.size:
        return Order(math.nan)  # the finest error alone is above: nothing to compare it with
    pair = (float(steps[coarse]), float(steps[fine]))
    return Order(_slope(steps, error, coarse, fine), above.size == 1, pair)


def fitted_order(
    dts: Sequence[float],
    errors: Sequence[float],
    size: float | Sequence[float] = 1.0,
    floor: Sequence[float] | None = None,
) -> Order | None:
    """As `observed_order`, through all errors in the asymptotic range, by least squares.

    From the two finest steps above rounding it takes in coarser ones, as long as the slope to the
    next is that between those two, to SLOPE_TOLERANCE. Of fewer than three such steps it is
    `observed_order`, and not `is_asymptotic`.

    >>> order = fitted_order([8e-3, 4e-3, 2e-3, 1e-3], [9e-1, 2.6e-3, 1.6e-4, 1e-5])
    >>> str(order), order.steps
    ('4.01', (0.004, 0.002, 0.001))
    """
    order = observed_order(dts, errors, size, floor)
    if order is None or order.lower_bound or math.isnan(order.slope):
        return order
    steps, error, above = _above(dts, errors, size, floor)
    tolerance = SLOPE_TOLERANCE * max(1.0, abs(order.slope))
    first = above.size - 2
    while first > 0:
        slope = _slope(steps, error, above[first - 1], above[first])
        if abs(slope - order.slope) > tolerance:
            break
        first -= 1
    taken = above[first:]
    slope, _ = np.polyfit(np.log10(steps[taken]), np.log10(error[taken]), 1)
    return Order(float(slope), steps=tuple(steps[taken].tolist()))


def _above(
    dts: Sequence[float],
    errors: Sequence[float],
    size: float | Sequence[float],
    floor: Sequence[float] | None,
) -> tuple[Array, Array, NDArray[np.intp]]:
    """Steps and errors, the coarsest first, and which of the errors are above rounding."""
    steps, found = as_positive("dts", dts, "s"), as_floats("errors", errors)
    sizes = as_floats("size", size)
    if not (steps.ndim == 1 and found.shape == steps.shape and sizes.shape in ((), steps.shape)):
        raise ArgumentError(
            f"dts, errors and size have shapes {steps.shape}, {found.shape} and {sizes.shape}; "
            "expected (n,) of both, and of size that or one number"
        )
    floors = ROUNDING_FLOOR * sizes if floor is None else as_floats("floor", floor)
    if floors.shape not in ((), steps.shape):
        raise ArgumentError(f"floor has shape {floors.shape}; expected {steps.shape}")
    coarse_first = np.argsort(steps)[::-1]
    error = found[coarse_first]
    floors = np.broadcast_to(floors, error.shape)[coarse_first]
    above = np.flatnonzero(np.isfinite(error) & (error > floors) & (error > 0.0))
    return steps[coarse_first], error, above


def _slope(steps: Array, error: Array, coarse: int, fine: int) -> float:
    """Of log(error) over log(step), between two of them."""
    # An error of exactly zero has no logarithm; the smallest number gives a bound all the same.
    log_ratio = math.log10(max(error[fine], np.finfo(float).tiny)) - math.log10(error[coarse])
    log_dt = math.log10(steps[fine]) - math.log10(steps[coarse])
    if log_dt == 0.0:
        raise ArgumentError(f"dts has {steps[coarse]} s twice; expected different ones")
    return log_ratio / log_dt


def verdict(errors: Sequence[float], order: Order | None) -> str:
    """One word, or "order n", for how `errors` behave; `order` as `observed_order` has it."""
    if not are_finite(as_floats("errors", errors)):
        return FAILED
    if not isinstance(order, Order | None):
        raise ArgumentError(f"order={told(order)}; expected what observed_order returns")
    if order is None:
        return EXACT
    if not 0.5 <= order.slope < math.inf:
        return VIOLATED
    nearest = round(order.slope)
    return f"order {nearest}" if abs(order.slope - nearest) <= ORDER_TOLERANCE else DRIFTS
