"""Determine the order of convergence from errors at several steps, and give a verdict on it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lierb.errors import ArgumentError, brief
from lierb.support.arrays import Array, are_finite, as_floats, as_positive

ROUNDING_FLOOR = 1e-11
"""Errors up to this, relative to the size of the quantity, count as rounding."""

SATURATED = 0.5
"""Errors from this on, relative to the size of the quantity, are saturated: they follow no law in
the step size. Two independent orientations differ by 2.2 rad on average, and with a probability of
99 % by more than 0.5 rad."""

LEAST_ORDER = 0.5
"""Smaller slopes do not count as an order: the errors do not fall with the step size."""

ORDER_TOLERANCE = 0.25
"""Largest distance of an observed order from the whole number that is reported for it. With steps
ten times apart, the coarser one is often not yet in the asymptotic range: the universal joint with
global updates shows 3.84 between dt = 1e-2 and 1e-3."""

SLOPE_TOLERANCE = 0.05
"""Largest relative difference of neighbouring slopes in the asymptotic range."""

EXACT = "exact"  # every error is rounding
DRIFTS = "drifts"  # falls with the step size, without a clear order
VIOLATED = "violated"  # does not fall with the step size
FAILED = "failed"  # not a number: the integration broke down


@dataclass(frozen=True)
class Order:
    """The order is the slope of log(error) over log(dt); NaN where the errors show no order.

    `lower_bound`: True if the finer of the two errors is rounding, so that the true slope is at
    least this one.
    `steps`: step sizes of the errors used, s, the coarsest first; empty if too few errors lie
    between rounding and saturation. If there are steps and the slope is NaN, the errors do not
    fall.
    """

    slope: float
    lower_bound: bool = False
    steps: tuple[float, ...] = ()

    @property
    def is_asymptotic(self) -> bool:
        """Return whether two neighbouring pairs of steps show this order."""
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
    """Return the order of convergence observed in `errors`; None if all errors are rounding.

    An error is usable if it is above rounding and below SATURATED times `size`. The order is the
    slope between the two finest steps with usable errors, since coarser steps may not resolve the
    motion. If only one error is usable, its slope to the next finer step, whose error is rounding,
    is a lower bound. The order is NaN if the slope is below LEAST_ORDER or too few errors are
    usable.

    dts : step sizes, s.   errors : one for each step.
    size : characteristic size of the quantity: lengths and distances of the body, m; 1 for angles;
    energies of the motion, J.
    floor : for each step, the error up to which it counts as rounding. Default: ROUNDING_FLOOR
    times `size`.

    Raises ArgumentError unless there is one positive step size for each error.

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
        return Order(math.nan)  # only the finest error is usable
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
    """Fit the order through all errors in the asymptotic range, by least squares.

    The range begins with the two finest usable steps. It extends to coarser steps as long as the
    slope to the next step agrees with the slope between those two, to SLOPE_TOLERANCE. With fewer
    than three steps in the range, the result is that of `observed_order`, not `is_asymptotic`.

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
    """Return steps and errors, the coarsest first, and the indices of two sets of errors.

    The first set has the errors above rounding; the second has those of them below saturation.
    """
    steps, values = as_positive("dts", dts, "s"), as_floats("errors", errors)
    sizes = as_floats("size", size)
    if not (steps.ndim == 1 and values.shape == steps.shape and sizes.shape in ((), steps.shape)):
        raise ArgumentError(
            f"dts, errors and size have shapes {steps.shape}, {values.shape} and {sizes.shape}; "
            "expected (n,) of both, and of size that or one number"
        )
    floors = ROUNDING_FLOOR * sizes if floor is None else as_floats("floor", floor)
    if floors.shape not in ((), steps.shape):
        raise ArgumentError(f"floor has shape {floors.shape}; expected {steps.shape}")
    coarse_first = np.argsort(steps)[::-1]
    error = values[coarse_first]
    floors = np.broadcast_to(floors, error.shape)[coarse_first]
    limits = SATURATED * np.broadcast_to(sizes, values.shape)[coarse_first]
    is_above = np.isfinite(error) & (error > floors) & (error > 0.0)
    above, usable = np.flatnonzero(is_above), np.flatnonzero(is_above & (error < limits))
    return steps[coarse_first], error, above, usable


def _slope(steps: Array, error: Array, coarse: int, fine: int) -> float:
    """Return the slope of log(error) over log(step) between two errors."""
    # The logarithm of a zero error is replaced by that of the smallest number, which gives a bound.
    log_ratio = math.log10(max(error[fine], np.finfo(float).tiny)) - math.log10(error[coarse])
    log_dt = math.log10(steps[fine]) - math.log10(steps[coarse])
    if log_dt == 0.0:
        raise ArgumentError(f"dts has {steps[coarse]} s twice; expected different ones")
    return log_ratio / log_dt


def verdict(errors: Sequence[float], order: Order | None) -> str:
    """Return the verdict on `errors`: one word, or "order n".

    order : result of `observed_order`.
    """
    if not are_finite(as_floats("errors", errors)):
        return FAILED
    if not isinstance(order, Order | None):
        raise ArgumentError(f"order={brief(order)}; expected a result of observed_order")
    if order is None:
        return EXACT
    if not LEAST_ORDER <= order.slope < math.inf:
        return VIOLATED
    nearest = round(order.slope)
    return f"order {nearest}" if abs(order.slope - nearest) <= ORDER_TOLERANCE else DRIFTS
