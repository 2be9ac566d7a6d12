"""Sample quantiles and their confidence intervals."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lierb.errors import ArgumentError, brief
from lierb.support.arrays import Array
from lierb.support.extras import require

CONFIDENCE = 0.95  # level of every interval
PROBABILITIES = (0.05, 0.5, 0.95)  # of the quantiles that are shown unless others are asked for

BASIS = {  # remark on the quantiles of a design, by its method
    "saltelli": "Quantiles are of the first two bodies of each row of the design, A and B, which "
    "alone are drawn independently.",
    "grid": "Quantiles of a grid have no intervals: its bodies are chosen, not drawn.",
}


class Quantile(NamedTuple):
    """Sample quantile, and a confidence interval of the population's quantile.

    value : the least number with at least this share of the bodies at or below it.
    low, high : order statistics of the sample; their ranks follow from the binomial distribution,
        whatever the population's. NaN if there are too few bodies.
    """

    probability: float
    value: float
    low: float
    high: float

    @property
    def width(self) -> float:
        """Return the width of the interval; NaN if it has no end."""
        return self.high - self.low


def quantile_of(ordered: Array, probability: float) -> Quantile:
    """Compute a quantile of sorted numbers, by `scipy.stats.quantile_test`.

    The interval is the exact one of Conover, Practical Nonparametric Statistics, 3rd ed., 3.2.

    Raises ArgumentError unless 0 < probability < 1.
    """
    if not 0.0 < probability < 1.0:
        remedy = f"; for {probability:g} % give {probability / 100.0:.12g}"
        raise ArgumentError(
            f"probability={brief(probability)}; expected more than 0 and less than 1"
            f"{remedy if 1.0 <= probability < 100.0 else ''}"
        )
    if not len(ordered):
        return Quantile(probability, np.nan, np.nan, np.nan)
    require("scipy")
    from scipy.stats import quantile_test

    value = float(np.quantile(ordered, probability, method="inverted_cdf"))
    interval = quantile_test(ordered, q=value, p=probability).confidence_interval(CONFIDENCE)
    return Quantile(probability, value, float(interval.low), float(interval.high))


def quantiles_of(
    values: Array, is_independent: NDArray[np.bool_], probabilities: Sequence[float]
) -> tuple[Quantile, ...]:
    """Compute quantiles of the bodies that `Design.independent` marks.

    Quantiles of a design without such bodies, a grid, are those of all bodies, without intervals.
    """
    is_drawn = bool(is_independent.any())
    ordered = np.sort(values[is_independent] if is_drawn else values)
    quantiles = tuple(quantile_of(ordered, p) for p in probabilities)
    return quantiles if is_drawn else tuple(q._replace(low=np.nan, high=np.nan) for q in quantiles)


def percent(probability: float) -> str:
    """Format a probability as a percentage, such as `99.73%`."""
    return f"{100.0 * probability:.12g}%"


def share_width(count: int, of: int) -> float:
    """Return the width of a share's interval, by Clopper and Pearson; `scipy.stats.binomtest`."""
    require("scipy")
    from scipy.stats import binomtest

    interval = binomtest(count, of).proportion_ci(CONFIDENCE, method="exact")
    return float(interval.high - interval.low)
