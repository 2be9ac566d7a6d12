"""Normal distributions are independent, correlated, truncated, or of the logarithm."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from lierb.errors import ArgumentError
from lierb.sampling.distribution import (
    LARGEST,
    Distribution,
    common_shape,
    numbers_of,
    refuse,
    require_ordered,
    scipy_special,
)
from lierb.sampling.truncated import quantiles_of_truncated_normal
from lierb.support.arrays import Array

FARTHEST_Z = 8.3  # std from the mean to the largest draw
NODES = 200  # of the quadrature of a truncated distribution, of error 1e-12 without a bound
SEMIDEFINITE = 1e-14  # pivot, relative to the variance, below which it is zero
SYMMETRY_TOLERANCE = 1e-12  # relative to the largest entry


@dataclass(frozen=True, eq=False, init=False, repr=False)
class Normal(Distribution):
    """The distribution is normal, with independent or correlated components.

    x = mean + L z with LLᵀ = covariance (Cholesky), z = Φ⁻¹(u).

    Parameters
    ----------
    mean : float or array_like, shape (d,)
        Mean.
    std : float or array_like, shape (d,), optional
        Standard deviations of independent components, ≥ 0.
    covariance : array_like, shape (d, d), optional
        Covariance matrix, symmetric positive semi-definite, in place of `std`.

    Raises
    ------
    ArgumentError
        `std` is negative, `covariance` is not positive semi-definite, or both or neither are given.

    Examples
    --------
    >>> from lierb.sampling import Normal
    >>> Normal((1.0, 2.0), 0.1).draw([[0.5, 0.5]]).tolist()
    [[1.0, 2.0]]
    >>> Normal(0.0, covariance=[[4.0, 2.0], [2.0, 1.0]]).dimension
    2
    """

    mean: Array
    std: Array | None
    covariance: Array | None

    def __init__(
        self, mean: ArrayLike, std: ArrayLike | None = None, *, covariance: ArrayLike | None = None
    ) -> None:
        if (std is None) == (covariance is None):
            raise ArgumentError("give std or covariance=, one of the two")
        centre = numbers_of("mean", mean)
        self._set(mean=centre, std=None, covariance=None)
        if covariance is None:
            spread = numbers_of("std", std)
            refuse("std", spread, spread < 0.0, "zero or a positive number")
            self._set(std=spread, shape=common_shape(mean=centre, std=spread))
        else:
            matrix = _covariance(covariance)
            shape = common_shape(mean=centre, covariance=matrix[0])
            self._set(covariance=matrix, shape=shape)

    def _draw(self, u: Array) -> Array:
        z: Array = scipy_special().ndtri(u)
        mean = self._column(self.mean)
        if self.std is not None:
            return mean + self._column(self.std) * z
        assert self.covariance is not None
        # Sums in a fixed order: the one in which a matrix product adds depends on n.
        x = np.repeat(mean, u.shape[1], axis=1)
        for i, row in enumerate(_cholesky(self.covariance)):
            for j in np.flatnonzero(row):
                x[i] += row[j] * z[j]
        return x

    @property
    def moments(self) -> tuple[Array, Array]:
        std = np.zeros(()) if self.std is None else self.std
        mean, covariance = self._independent(self.mean, std**2)
        return mean, covariance if self.covariance is None else self.covariance


def _covariance(value: ArrayLike) -> Array:
    matrix = numbers_of("covariance", value, axes=2)
    if matrix.ndim != 2 or len(matrix) != matrix.shape[1]:
        raise ArgumentError(f"covariance has shape {matrix.shape}; expected (d, d)")
    skew = np.abs(matrix - matrix.T).max()
    if skew > SYMMETRY_TOLERANCE * np.abs(matrix).max():
        raise ArgumentError(f"covariance is not symmetric: entries differ by {skew:.3g}")
    with np.errstate(all="ignore"):  # an invalid covariance may overflow
        lower = _cholesky(matrix)
        size = np.sqrt(np.abs(np.diag(matrix)))
        left = np.abs(lower @ lower.T - matrix)
    # The root of two zero pivots bounds the covariance that is left.
    if not (left <= 2.0 * np.sqrt(SEMIDEFINITE) * np.outer(size, size)).all():
        raise ArgumentError(
            "covariance is not positive semi-definite: its smallest eigenvalue is "
            f"{np.linalg.eigvalsh(matrix)[0]:.6g}"
        )
    return matrix


def _cholesky(matrix: Array) -> Array:
    """Return the Cholesky factor, lower triangular, with a column of zeros for each zero pivot."""
    lower = np.zeros_like(matrix)
    for j in range(len(matrix)):
        rest = matrix[j:, j] - sum(lower[j:, k] * lower[j, k] for k in range(j))
        if rest[0] > SEMIDEFINITE * matrix[j, j]:
            lower[j:, j] = rest / np.sqrt(rest[0])
    return lower


@dataclass(frozen=True, eq=False, init=False, repr=False)
class TruncatedNormal(Distribution):
    """The normal distribution is truncated to an interval, independent in each component.

    The quantiles are accurate to rounding for any ratio of std and high − low, and for a mean
    anywhere: their limits are the uniform distribution between the bounds, and the exponential one
    beyond a bound. Three equations, each solved where it is well conditioned.

    Parameters
    ----------
    mean : float or array_like, shape (d,)
        Mean of the normal distribution before truncation.
    std : float or array_like, shape (d,)
        Standard deviation of the normal distribution before truncation, > 0.
    low : float or array_like, shape (d,), optional
        Lower bound, may be −inf.
    high : float or array_like, shape (d,), optional
        Upper bound, high > low, may be inf.

    Examples
    --------
    >>> from lierb.sampling import TruncatedNormal
    >>> import numpy as np
    >>> tail = TruncatedNormal(0.0, 1.0, low=8.0, high=np.inf)
    >>> tail.draw([[0.5]]).round(4).tolist()
    [8.0849]
    """

    mean: Array
    std: Array
    low: Array
    high: Array

    def __init__(
        self, mean: ArrayLike, std: ArrayLike, low: ArrayLike = -np.inf, high: ArrayLike = np.inf
    ) -> None:
        centre, spread = numbers_of("mean", mean), numbers_of("std", std)
        lowest = numbers_of("low", low, infinite=True)
        highest = numbers_of("high", high, infinite=True)
        refuse("std", spread, spread <= 0.0, "a positive number")
        parameters = {"mean": centre, "std": spread, "low": lowest, "high": highest}
        shape = common_shape(**parameters)
        require_ordered(lowest, highest, strict=True)
        self._set(**parameters, shape=shape)

    def _draw(self, u: Array) -> Array:
        mean, std, low, high = (
            self._column(x)[:, 0].tolist() for x in (self.mean, self.std, self.low, self.high)
        )
        return np.stack(list(map(quantiles_of_truncated_normal, mean, std, low, high, u)))

    @property
    def moments(self) -> tuple[Array, Array]:
        # Integrals of the quantiles over u = s³ (10 − 15 s + 6 s²), whose ends are flat where
        # quantiles have none. scipy.stats.truncnorm has no digit of the variance of a width of
        # 1e-6 std.
        nodes, weights = np.polynomial.legendre.leggauss(NODES)
        s = 0.5 + 0.5 * nodes
        values = self._draw(np.tile(s**3 * (10.0 - 15.0 * s + 6.0 * s**2), (self.dimension, 1)))
        weights *= 15.0 * s**2 * (1.0 - s) ** 2
        mean = values @ weights
        off = values - mean[:, None]
        return mean, np.diag(off**2 @ weights)


@dataclass(frozen=True, eq=False, init=False, repr=False)
class LogNormal(Distribution):
    """The distribution is that of exp of a normal variable.

    It is for positive quantities known up to a factor.

    Parameters
    ----------
    median : float or array_like, shape (d,)
        Median, > 0.
    sigma : float or array_like, shape (d,)
        Standard deviation of the natural logarithm, ≥ 0.

    Examples
    --------
    >>> from lierb.sampling import LogNormal
    >>> LogNormal(3.0, 0.2).draw([[0.5]]).tolist()
    [3.0]
    """

    median: Array
    sigma: Array

    def __init__(self, median: ArrayLike, sigma: ArrayLike) -> None:
        middle, spread = numbers_of("median", median), numbers_of("sigma", sigma)
        refuse("median", middle, middle <= 0.0, "a positive number")
        refuse("sigma", spread, spread < 0.0, "zero or a positive number")
        shape = common_shape(median=middle, sigma=spread)
        reach = np.log(middle) + FARTHEST_Z * spread
        most = "less: its draws overflow, or a smaller median"
        refuse("sigma", np.broadcast_to(spread, reach.shape), reach > np.log(LARGEST), most)
        self._set(median=middle, sigma=spread, shape=shape)

    def _draw(self, u: Array) -> Array:
        z: Array = scipy_special().ndtri(u)
        median, exponent = self._column(self.median), self._column(self.sigma) * z
        with np.errstate(over="ignore"):
            whole, half = median * np.exp(exponent), np.exp(0.5 * exponent)
        # in two factors, since one may exceed a double's range
        return np.where(exponent < 700.0, whole, median * half * half)

    @property
    def moments(self) -> tuple[Array, Array]:
        with np.errstate(over="ignore"):
            mean = self.median * np.exp(0.5 * self.sigma**2)
            return self._independent(mean, mean**2 * np.expm1(self.sigma**2))
