"""Compute quantiles of the truncated normal distribution, accurate to rounding for any bounds."""

from __future__ import annotations

from typing import Any

import numpy as np

from lierb.sampling.distribution import LARGEST, scipy_special
from lierb.support.arrays import Array

NODES, WEIGHTS = np.polynomial.legendre.leggauss(10)  # exp(−x) over 0 … 2 to 1e-21
LONGEST = 2.0  # log of the density's change for which the quadrature is used
FAR = 1e3  # std, beyond which a normal density is zero
NEWTON_STEPS = 8  # 5 suffice: the number of correct digits doubles in each


def quantiles_of_truncated_normal(
    mean: float, std: float, low: float, high: float, u: Array
) -> Array:
    """Return the quantiles of one component at uniforms u."""
    if mean >= high:  # mirrored, so that a mean outside of the bounds is below them
        return -_between(-mean, std, -high, -low, 1.0 - u, u)
    return _between(mean, std, low, high, u, 1.0 - u)


def _between(mean: float, std: float, low: float, high: float, p: Array, q: Array) -> Array:
    """Return the quantiles for a mean below `high`; p + q = 1."""
    with np.errstate(over="ignore"):
        a, b, w = (np.float64(x) / std for x in (low - mean, high - mean, high - low))
        if w * (max(a, 0.0) + 0.5 * w) <= LONGEST:
            x = low + (high - low) * _nearly_uniform(a * w, w * w, p)
        elif a >= 0.0:
            x = low + std * _tail(min(a, LARGEST), w, p, q)
        else:
            x = mean + std * _cut(a, b, p)
    return np.clip(x, low, high)


def _nearly_uniform(alpha: float, beta: float, p: Array) -> Array:
    """Return quantiles of exp(−αt − βt²/2) on (0, 1), a density whose log changes by ≤ LONGEST."""
    nodes = 0.5 * (NODES + 1.0)

    def mass(t: Array) -> Array:
        """Integrate the density from 0 to t, by Gauss and Legendre's quadrature."""
        total = np.zeros_like(t)
        for node, weight in zip(nodes, WEIGHTS, strict=True):
            total += 0.5 * weight * np.exp(-t * node * (alpha + 0.5 * beta * t * node))
        return total * t

    wanted, t = p * mass(np.ones(1)), p
    for _ in range(NEWTON_STEPS):
        density = np.exp(-t * (alpha + 0.5 * beta * t))
        t = np.clip(t - (mass(t) - wanted) / density, 0.0, 1.0)
    return t


def _tail(a: float, w: float, p: Array, q: Array) -> Array:
    """Return the quantiles of z − a for a standard normal z between a ≥ 0 and a + w; p + q = 1.

    Solves −log(Q(a + s)/Q(a)) = s (a + s/2) − log(M(a + s)/M(a)) with Mills' ratio M = Q/φ.
    """
    functions = scipy_special()

    def mills(z: Any) -> Any:
        return np.sqrt(0.5 * np.pi) * functions.erfcx(np.sqrt(0.5) * z)

    at_bound = mills(a)

    def depth(s: Any) -> Any:
        return s * (a + 0.5 * s) - np.log(mills(a + s) / at_bound)

    end = depth(w) if w < FAR else np.inf
    wanted = np.where(p < 0.5, -np.log1p(p * np.expm1(-end)), -np.log(q + p * np.exp(-end)))
    # The slope, 1/M, grows by less than s: this start is below the root, and the depth convex.
    s: Array = 2.0 * wanted * at_bound / (1.0 + np.sqrt(1.0 + 2.0 * wanted * at_bound * at_bound))
    for _ in range(NEWTON_STEPS):
        s = np.maximum(s - (depth(s) - wanted) * mills(a + s), 0.0)
    return s


def _cut(a: float, b: float, p: Array) -> Array:
    """Return the quantiles of a standard normal between a < 0 and b > 0.

    Solves Φ(z) = (1 − p) Φ(a) + p Φ(b) for log Φ(z) or log Φ(−z), whichever is smaller.
    """
    functions = scipy_special()
    of_low, of_high = np.log1p(-p), np.log(p)
    below = np.logaddexp(of_low + functions.log_ndtr(a), of_high + functions.log_ndtr(b))
    above = np.logaddexp(of_low + functions.log_ndtr(-a), of_high + functions.log_ndtr(-b))
    z = functions.ndtri_exp(np.minimum(below, above))
    quantiles: Array = np.where(below < above, z, -z)
    return quantiles
