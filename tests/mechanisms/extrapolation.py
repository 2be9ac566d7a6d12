"""Gragg's extrapolated midpoint rule: an integrator of order 2·COLUMNS for any number type.

E. Hairer, S. P. Nørsett, G. Wanner, Solving Ordinary Differential Equations I, section II.9. The
even powers of the error of the midpoint rule with n = 2, 4, 6, … substeps are eliminated one by
one. It shares nothing with the Runge–Kutta methods that lierb steps with, and takes float64
and longdouble as they come.
"""

from collections.abc import Callable
from itertools import pairwise

import numpy as np

COLUMNS = 8  # order 16, in 65 evaluations


def step(
    rate: Callable[[np.ndarray], np.ndarray], y: np.ndarray, h: float, columns: int = COLUMNS
) -> tuple[np.ndarray, np.ndarray]:
    """y(t + h) of ẏ = rate(y), and how far it is from the extrapolation of one column less."""
    first, number = rate(y), y.dtype.type
    table: list[np.ndarray] = []
    for j in range(1, columns + 1):
        n = 2 * j
        small = h / n
        behind, here = y, y + small * first
        for _ in range(n - 1):
            behind, here = here, behind + 2 * small * rate(here)
        row = [here]
        for k, lower in enumerate(table, start=1):
            n_low = number((j - k) ** 2)
            divisor = (number(j * j) - n_low) / n_low
            row.append(row[-1] + (row[-1] - lower) / divisor)
        table = row
    return table[-1], table[-1] - table[-2]


def integrated(
    rate: Callable[[np.ndarray], np.ndarray],
    y0: np.ndarray,
    times,
    longest: float,
    settled: Callable[[np.ndarray], np.ndarray] = lambda y: y,
    tolerance: float = 1e-14,
    columns: int = COLUMNS,
) -> tuple[np.ndarray, float]:
    """y at the given times, the first of which has y0, in steps of at most `longest`.

    settled : applied after every step, as to put a state back onto its constraints.
    tolerance : of the estimated error of a step, relative to 1 + |y|; steps get shorter until they
        keep it, down to 2⁻¹⁰ of `longest`, and longer again.
    Returns y, (times, …), and the largest estimate among the steps taken.
    """
    y, worst, wished = settled(y0), 0.0, y0.dtype.type(longest)
    states = [y]
    for t, end in pairwise(times):
        left = y0.dtype.type(end - t)
        while left > 0:
            count = np.ceil(left / wished * (1 - 1e-9))
            h = left / count
            found, error = step(rate, y, h, columns)
            off = float(np.max(np.abs(error) / (1 + np.abs(found))))
            if not off <= tolerance and wished > longest * 2.0**-10:
                wished = h / 2
                continue
            y, worst = settled(found), max(worst, off)
            left = left - h if count > 1 else left * 0
            # the estimate is of order 2·columns − 1: half of the way is 2¹⁵ times more exact
            wished = min(longest, 2 * h) if off < tolerance * 2.0**-17 or off == 0.0 else wished
        states.append(y)
    return np.stack(states), worst
