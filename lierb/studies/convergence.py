"""How an error falls with the step size: the observed order and the verdict drawn from it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lierb.arrays import are_finite, as_floats, as_positive
from lierb.errors import ArgumentError, told

ROUNDING_FLOOR = 1e-11
"""Errors up to this, relative to the size of what they are errors of, count as rounding."""

ORDER_TOLERANCE = 0.25
"""How far an observed order may lie from a whole number and still be given as that number. With
steps ten times apart the coarser one is often not yet in the asymptotic range: the universal joint
with global updates shows 3.84 between dt = 1e-2 and 1e-3."""

EXACT = "exact"  # every error at rounding
DRIFTS = "drifts"  # falls with the step size, at no clear order
VIOLATED = "violated"  # does not fall with the step size
FAILED = "failed"  # not a number: the integration broke down


@dataclass(frozen=True)
class Order:
    """Slope of log(error) over log(dt).

    `lower_bound`: the finer of the two errors behind it is at rounding, so the true slope is at
    least this.
    """

    slope: float
    lower_bound: bool = False

    def __str__(self) -> str:
        return f"{'>=' if self.lower_bound else ''}{round(self.slope, 2) + 0.0:.2f}"


def observed_order(
    dts: Sequence[float], errors: Sequence[float], size: float | Sequence[float] = 1.0
) -> Order | None:
    """Order of convergence observed in `errors`, or None when all of them are at rounding.

    The slope is that between the two finest steps whose errors are above rounding: coarser ones may
    not resolve the motion yet, errors at rounding say nothing. When only one error is above, its
    slope to the next finer step bounds the order.

    dts : step sizes, s.   errors : one for each.   size : what they are errors of, in their unit:
    the body's lengths and distances, m; 1 for angles; the motion's energies, J.

    Raises ArgumentError for step sizes that are not positive, or not one for each error.

    >>> str(observed_order([1e-2, 1e-3, 1e-4], [3.5e-5, 3.5e-9, 3.8e-13]))
    '4.00'
    >>> str(observed_order([1e-2, 1e-3, 1e-4], [5.1e-8, 5.1e-12, 6.7e-13]))
    '>=4.00'
    """
    steps, found = as_positive("dts", dts, "s"), as_floats("errors", errors)
    sizes = as_floats("size", size)
    if not (steps.ndim == 1 and found.shape == steps.shape and sizes.shape in ((), steps.shape)):
        raise ArgumentError(
            f"dts, errors and size have shapes {steps.shape}, {found.shape} and {sizes.shape}; "
            "expected (n,) of both, and of size that or one number"
        )
    coarse_first = np.argsort(steps)[::-1]
    log_dt, error = np.log10(steps)[coarse_first], found[coarse_first]
    floor = ROUNDING_FLOOR * np.broadcast_to(sizes, error.shape)[coarse_first]
    above = np.flatnonzero(np.isfinite(error) & (error > floor) & (error > 0.0))
    if above.size == 0:
        return None
    coarse, fine = above[-2:] if above.size > 1 else (above[0], above[0] + 1)
    if fine == error.size:
        return Order(math.nan)  # the finest error alone is above: nothing to compare it with
    # An error of exactly zero has no logarithm; the smallest number gives a bound all the same.
    log_ratio = math.log10(max(error[fine], np.finfo(float).tiny)) - math.log10(error[coarse])
    if log_dt[fine] == log_dt[coarse]:
        raise ArgumentError(f"dts has {steps[coarse_first[fine]]} s twice; expected different ones")
    slope = log_ratio / (log_dt[fine] - log_dt[coarse])
    return Order(float(slope), lower_bound=above.size == 1)


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
