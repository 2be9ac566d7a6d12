"""Tolerances are calibrated by the ratio of a method's global errors to its error estimates.

A pair estimates the error of one method and steps by the other. Hence one tolerance gives errors
that differ a hundredfold from pair to pair. The calibration problem is a uniform rotation, ẏ = iy,
as rotation is common to all bodies. Its steps have an estimated error of one tolerance each.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable, Sequence

from lierb.kernels.stepping.step_size import DOP853_MIX, SAFETY

TURNS = 30.0  # at which the error equals the tolerance; 1/30 of it after 1, 30 times after 900
# The error of long steps of a high order may be far above its estimate: 100 times for Verner's 8(7)
# on a universal joint. A uniform rotation does not show this.
LEAST = 10.0
_TOLERANCE = 1e-8  # leading terms dominate the errors; rounding is negligible
_LONGEST = 3.0  # rad, longest step
_HALVINGS = 60
_LARGEST = 1e4

Rows = Sequence[Sequence[float]]
Stages = Callable[[complex], list[complex]]


def calibration_of(stages: Stages, b: Sequence[float], error: Rows, error_order: int) -> float:
    """Ratio of the error after TURNS turns to the tolerance of each step's estimated error.

    stages : h k_i of a step on ẏ = λy from y = 1, by hλ.
    The ratio is rounded to two digits and is at least LEAST.
    """
    aim = _TOLERANCE * SAFETY ** (error_order + 1)
    low, high = 0.0, _LONGEST
    for _ in range(_HALVINGS):
        h = 0.5 * (low + high)
        low, high = (low, h) if _turned(stages, b, error, h)[1] > aim else (h, high)
    defect, _ = _turned(stages, b, error, high)
    total = 2.0 * math.pi * TURNS / high * defect / _TOLERANCE
    return float(f"{min(max(total, LEAST), _LARGEST):.2g}")


def _turned(stages: Stages, b: Sequence[float], error: Rows, h: float) -> tuple[float, float]:
    """Return the error of a step h on ẏ = iy, and the estimate of it."""
    changes = stages(1j * h)
    defect = abs(1.0 + _weighted(b, changes) - cmath.exp(1j * h))
    fine, *coarse = (abs(_weighted(row, changes)) for row in error)
    if coarse and fine > 0.0:
        return defect, fine * fine / math.sqrt(fine * fine + DOP853_MIX * coarse[0] ** 2)
    return defect, fine


def _weighted(weights: Sequence[float], changes: Sequence[complex]) -> complex:
    return sum((w * k for w, k in zip(weights, changes, strict=True)), 0j)
