"""Order of convergence observed from errors at several steps, and a verdict on it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lierb.errors import ArgumentError, brief
from lierb.support.arrays import Array, are_finite, as_floats, as_positive

ROUNDING_FLOOR = 1e-11
"""Errors up to this, relative to the size of what they are errors of, count as rounding."""

SATURATED = 0.5
"""Errors from this on, relative to the size of what they are errors of, are too large to fall with
the step size in any law: orientations that have nothing to do with each other differ by 2.2 rad in
the mean, and 99 % of them by more than 0.5 rad."""

LEAST_ORDER = 0.5
"""A smaller slope is no order: the errors do not fall with the step size."""

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
    """Slope of log(error) over log(dt); NaN where the errors show no order.

    `lower_bound`: the finer of the two errors behind it is at rounding, so the true slope is at
    least this.
    `steps`: the step sizes of the errors behind it, s, the coarsest first; none where too few
    errors lie between rounding and saturation. With steps and without a slope, the errors do not
    fall.
    """

    slope: float
    lower_bound: bool = False
    steps: tuple[float, ...] = ()

    @property
    def is_asymptotic(self) -> bool:
        """True where two neighbouring pairs of steps show this order."""
        return len(self.steps) > 2 and not self.lower_bound

    def __str__(self) -> str:
        if math.isnan(self.slope):
            return "–"
        return f"{'>=' if self.lower_bound else ''}{self.slope:.2f}"


def observed_order(
    dts: Sequence[float],
    errors: Sequence[float],
    size: float | Sequence[float] = 1.0,
    floor: Sequence[float] | None = None,
) -> Order | None:
    """Order of convergence observed in `errors`, or None when all of them are at rounding.

    The slope is that between the two finest steps whose errors are usable, that is above rounding
    and below SATURATED times `size`: coarser steps may not resolve the motion yet. When only one
    error is usable, its slope to the next finer step, at rounding, bounds the order. A slope below
    LEAST_ORDER is no order, nor is there one when too few errors are usable: it is NaN then.

    dts : step sizes, s.   errors : one for each.   size : what they are errors of, in their unit:
    the body's lengths and distances, m; 1 for angles; the motion's energies, J.
    floor : for each, the error up to which it counts as rounding. Default: ROUNDING_FLOOR of size.

    Raises ArgumentError for step sizes that are not positive, or not one for each error.

    >>> str(observed_order([1e-2, 1e-3, 1e-4], [3.5e-5, 3.5e-9, 3.8e-13]))
    '4.00'
    >>> str(observed_order([1e-2, 1e-3, 1e-4], [5.1e-8, 5.1e-12, 6.7e-13]))
    '>=4.00'
    >>> str(observed_order([1e-2, 5e-3, 2.5e-3], [2.1, 2.0, 2.4]))  # rad: saturated
    '–'
    """
    steps, error, above, usable = _usable(dts, errors, size, floor)
    if above.size == 0:
        return None
    if usable.size == 0 or usable[-1] != above[-1]:
        return Order(math.nan)  # the finest error above rounding is saturated
    coarse, fine = usable[-2:] if usable.size > 1 else (usable[0], usable[0] + 1)
    if fine == error.size:
        return Order(math.nan)  # the finest error alone is usable: nothing to compare it with
    pair = (float(steps[coarse]), float(steps[fine]))
    slope = _slope(steps, error, coarse, fine)
    if slope < LEAST_ORDER:
        return Order(math.nan, steps=pair)
    return Order(slope, usable.size == 1, pair)


def fitted_order(
    dts: Sequence[float],
    errors: Sequence[float],
    size: float | Sequence[float] = 1.0,
    floor: Sequence[float] | None = None,
) -> Order | None:
    """Order fitted through all errors in the asymptotic range, by least squares.

    From the two finest usable steps it takes in coarser ones, as long as the slope to the
    next is that between those two, to SLOPE_TOLERANCE. Of fewer than three such steps it is
    `observed_order`, and not `is_asymptotic`.

    >>> order = fitted_order([8e-3, 4e-3, 2e-3, 1e-3], [9e-1, 2.6e-3, 1.6e-4, 1e-5])
    >>> str(order), order.steps
    ('4.01', (0.004, 0.002, 0.001))
    """
    order = observed_order(dts, errors, size, floor)
    if order is None or order.lower_bound or math.isnan(order.slope):
        return order
    steps, error, _, usable = _usable(dts, errors, size, floor)
    tolerance = SLOPE_TOLERANCE * max(1.0, abs(order.slope))
    first = usable.size - 2
    while first > 0:
        slope = _slope(steps, error, usable[first - 1], usable[first])
        if abs(slope - order.slope) > tolerance:
            break
        first -= 1
    taken = usable[first:]
    slope, _ = np.polyfit(np.log10(steps[taken]), np.log10(error[taken]), 1)
    return Order(float(slope), steps=tuple(steps[taken].tolist()))


def _usable(
    dts: Sequence[float],
    errors: Sequence[float],
    size: float | Sequence[float],
    floor: Sequence[float] | None,
) -> tuple[Array, Array, NDArray[np.intp], NDArray[np.intp]]:
    """Steps and errors, the coarsest first; indices of the errors above rounding, and of the usable
    ones among them, which are not saturated.
    """
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
    limits = SATURATED * np.broadcast_to(sizes, found.shape)[coarse_first]
    is_above = np.isfinite(error) & (error > floors) & (error > 0.0)
    above, usable = np.flatnonzero(is_above), np.flatnonzero(is_above & (error < limits))
    return steps[coarse_first], error, above, usable


def _slope(steps: Array, error: Array, coarse: int, fine: int) -> float:
    """Return the slope of log(error) over log(step) between two errors."""
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
        raise ArgumentError(f"order={brief(order)}; expected what observed_order returns")
    if order is None:
        return EXACT
    if not LEAST_ORDER <= order.slope < math.inf:
        return VIOLATED
    nearest = round(order.slope)
    return f"order {nearest}" if abs(order.slope - nearest) <= ORDER_TOLERANCE else DRIFTS
