"""Calibration of tolerances: ratio of a method's errors to its estimates of them.

Each method estimates the error of another one than it steps by, so one tolerance gives errors that
differ a hundredfold from method to method. What all bodies do is turn; so that is what tolerances
are calibrated by: ẏ = iy, by steps that each are estimated to be off by a tolerance.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Sequence

from lierb.kernels.stepping.step_size import DOP853_MIX, SAFETY

TURNS = 30.0  # after so many, the error is the tolerance: 30 times less after one, more after 900
# Long steps of high orders may be far worse than they seem: those of Verner's 8(7) on a universal
# joint by a factor of 100, which a uniform rotation does not show.
LEAST = 10.0
_TOLERANCE = 1e-8  # where errors are as their leading terms, and rounding is not seen
_LONGEST = 3.0  # rad, in a step
_HALVINGS = 60
_LARGEST = 1e4

Rows = Sequence[Sequence[float]]


def calibration_of(A: Rows, b: Sequence[float], error: Rows, error_order: int) -> float:
    """Ratio of a tolerance to the estimate of a step that leads to it after TURNS turns.

    At least LEAST, to two digits.
    """
    aim = _TOLERANCE * SAFETY ** (error_order + 1)
    low, high = 0.0, _LONGEST
    for _ in range(_HALVINGS):
        h = 0.5 * (low + high)
        low, high = (low, h) if _turned(A, b, error, h)[1] > aim else (h, high)
    defect, _ = _turned(A, b, error, high)
    total = 2.0 * math.pi * TURNS / high * defect / _TOLERANCE
    return float(f"{min(max(total, LEAST), _LARGEST):.2g}")


def _turned(A: Rows, b: Sequence[float], error: Rows, h: float) -> tuple[float, float]:
    """A step's error, and what it is estimated to be."""
    rates: list[complex] = []
    for row in A:
        rates.append(1j * (1.0 + h * _weighted(row, rates)))
    defect = abs(1.0 + h * _weighted(b, rates) - cmath.exp(1j * h))
    fine, *coarse = (abs(h * _weighted(row, rates)) for row in error)
    if coarse and fine > 0.0:
        return defect, fine * fine / math.sqrt(fine * fine + DOP853_MIX * coarse[0] ** 2)
    return defect, fine


def _weighted(weights: Sequence[float], rates: Sequence[complex]) -> complex:
    return sum((w * k for w, k in zip(weights, rates, strict=False)), 0j)
