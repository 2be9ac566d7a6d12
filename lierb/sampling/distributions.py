"""Distributions of numbers, vectors and rotations, as functions of uniforms.

Every one is an inverse: `dimension` uniforms go in, one draw comes out, and none is rejected. What
comes out of some uniforms has the same bits alone and in any batch, on one kind of CPU.

Parameters are a number, the same for all components, or (d,); units are the caller's.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property
from math import prod
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lierb.errors import ArgumentError
from lierb.kernels.groups import so3
from lierb.support.arrays import Array, as_floats, as_matrix
from lierb.support.extras import require

LARGEST = 1e300  # of a parameter: sums of a few, and 39 of a normal's std, are numbers still
FARTHEST_Z = 8.3  # of the uniforms next to 1, in std
NODES, WEIGHTS = np.polynomial.legendre.leggauss(10)  # exp(−x) over 0 … 2 to 1e-21
LONGEST = 2.0  # log of a density's change that they are used for
FAR = 1e3  # std: of a normal nothing is left beyond
NEWTON_STEPS = 8  # of which 5 suffice: the number of correct digits doubles in each
SEMIDEFINITE = 1e-14  # relative to a variance: what is left of it below this counts as nothing
SYMMETRY_TOLERANCE = 1e-12  # relative to the largest entry
SHAPES = {
    1: "a number or (d,)",
    2: "a number, (d,) or a matrix",
    3: "k numbers, vectors or matrices",
}


class Distribution:
    """Distribution that the value of one body is drawn from: the base of those below.

    Attributes
    ----------
    shape : tuple of int
        Shape of one draw: (), (d,) or (3, 3).
    dimension : int
        Number of uniforms that a draw takes.
    """

    @property
    def shape(self) -> tuple[int, ...]:
        raise NotImplementedError

    @property
    def dimension(self) -> int:
        return prod(self.shape)

    def draw(self, u: ArrayLike) -> Array:
        """Compute values at points of the unit cube.

        Parameters
        ----------
        u : array_like, shape (n, dimension)
            Points, in (0, 1).

        Returns
        -------
        ndarray, shape (n, …)
            Values of the distribution's shape; row i depends on u[i] alone.

        Raises
        ------
        ArgumentError
            u has another shape, or numbers outside (0, 1).
        """
        points = as_floats("u", u)
        if points.ndim != 2 or points.shape[1] != self.dimension:
            raise ArgumentError(
                f"u has shape {points.shape}; {type(self).__name__} takes (n, {self.dimension})"
            )
        _refuse("u", points, ~((points > 0.0) & (points < 1.0)), "numbers in (0, 1)")
        # One contiguous row a component: for others NumPy's logarithm takes a path that rounds
        # otherwise, and a body's bits would depend on how it came to be in an array.
        parts = self._draw(np.ascontiguousarray(points.T))
        return np.ascontiguousarray(parts.T).reshape(len(points), *self.shape)

    def _draw(self, u: Array) -> Array:
        """(dimension, n) → (components, n), by operations on one element at a time."""
        raise NotImplementedError

    def _column(self, parameter: Array) -> Array:
        """One row a component, to go with (components, n)."""
        return np.broadcast_to(parameter, self.shape).reshape(-1, 1)

    def _set(self, **values: object) -> None:
        for name, value in values.items():
            object.__setattr__(self, name, value)

    def __repr__(self) -> str:
        given = {f.name: getattr(self, f.name) for f in fields(self)}  # type: ignore[arg-type]
        shown = {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in given.items()}
        inside = ", ".join(f"{k}={v}" for k, v in shown.items() if v is not None)
        return f"{type(self).__name__}({inside})"


@dataclass(frozen=True, eq=False, init=False, repr=False)
class Constant(Distribution):
    """One value for every body; a number or an array in place of a distribution becomes one.

    Parameters
    ----------
    value : float or array_like, shape (d,) or (d, d)
        The value.

    Examples
    --------
    >>> Constant((0.0, 0.0, -9.81)).draw(np.empty((2, 0))).tolist()
    [[0.0, 0.0, -9.81], [0.0, 0.0, -9.81]]
    """

    value: Array

    def __init__(self, value: ArrayLike) -> None:
        self._set(value=_numbers("value", value, axes=2))

    @property
    def shape(self) -> tuple[int, ...]:
        return self.value.shape

    @property
    def dimension(self) -> int:
        return 0

    def _draw(self, u: Array) -> Array:
        return np.repeat(self.value.reshape(-1, 1), u.shape[1], axis=1)


@dataclass(frozen=True, eq=False, init=False, repr=False)
class Uniform(Distribution):
    """Uniform distribution between two bounds, independent in each component.

    Parameters
    ----------
    low : float or array_like, shape (d,)
        Lower bound.
    high : float or array_like, shape (d,)
        Upper bound, high ≥ low.

    Examples
    --------
    >>> Uniform(1.0, (3.0, 5.0)).draw([[0.5, 0.25]]).tolist()
    [[2.0, 2.0]]
    """

    low: Array
    high: Array

    def __init__(self, low: ArrayLike, high: ArrayLike) -> None:
        lowest, highest = _numbers("low", low), _numbers("high", high)
        _common_shape(low=lowest, high=highest)
        _ordered(lowest, highest, strict=False)
        self._set(low=lowest, high=highest)

    @property
    def shape(self) -> tuple[int, ...]:
        return _common_shape(low=self.low, high=self.high)

    def _draw(self, u: Array) -> Array:
        low, high = self._column(self.low), self._column(self.high)
        return np.minimum(low + (high - low) * u, high)  # rounding may pass it by an ulp


@dataclass(frozen=True, eq=False, init=False, repr=False)
class Normal(Distribution):
    """Normal distribution, with independent or correlated components.

    x = mean + L z with LLᵀ = covariance (Cholesky), z = Φ⁻¹(u).

    Parameters
    ----------
    mean : float or array_like, shape (d,)
        Mean.
    std : float or array_like, shape (d,), optional
        Standard deviations of independent components, ≥ 0.
    covariance : array_like, shape (d, d), optional
        Covariance matrix, symmetric positive semi-definite, in place of `std`.

    Examples
    --------
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
        centre = _numbers("mean", mean)
        self._set(mean=centre, std=None, covariance=None)
        if covariance is None:
            spread = _numbers("std", std)
            _refuse("std", spread, spread < 0.0, "zero or a positive number")
            _common_shape(mean=centre, std=spread)
            self._set(std=spread)
        else:
            matrix = _covariance(covariance)
            _common_shape(mean=centre, covariance=matrix[0])
            self._set(covariance=matrix)

    @property
    def shape(self) -> tuple[int, ...]:
        spread = self.std if self.covariance is None else self.covariance[0]
        assert spread is not None
        return _common_shape(mean=self.mean, spread=spread)

    def _draw(self, u: Array) -> Array:
        z: Array = _special().ndtri(u)
        mean = self._column(self.mean)
        if self.std is not None:
            return mean + self._column(self.std) * z
        # Sums in a fixed order: the one in which a matrix product adds depends on n.
        x = np.repeat(mean, u.shape[1], axis=1)
        for i, row in enumerate(self._factor):
            for j in np.flatnonzero(row):
                x[i] += row[j] * z[j]
        return x

    @cached_property
    def _factor(self) -> Array:
        assert self.covariance is not None
        return _cholesky(self.covariance)


def _covariance(value: ArrayLike) -> Array:
    matrix = _numbers("covariance", value, axes=2)
    if matrix.ndim != 2 or len(matrix) != matrix.shape[1]:
        raise ArgumentError(f"covariance has shape {matrix.shape}; expected (d, d)")
    skew = np.abs(matrix - matrix.T).max()
    if skew > SYMMETRY_TOLERANCE * np.abs(matrix).max():
        raise ArgumentError(f"covariance is not symmetric: entries differ by {skew:.3g}")
    with np.errstate(all="ignore"):  # where it is none, numbers overflow
        lower = _cholesky(matrix)
        size = np.sqrt(np.abs(np.diag(matrix)))
        left = np.abs(lower @ lower.T - matrix)
    # Of two variances of which nothing is left, the root bounds the covariance that is.
    if not (left <= 2.0 * np.sqrt(SEMIDEFINITE) * np.outer(size, size)).all():
        raise ArgumentError(
            "covariance is not positive semi-definite: its smallest eigenvalue is "
            f"{np.linalg.eigvalsh(matrix)[0]:.6g}"
        )
    return matrix


def _cholesky(matrix: Array) -> Array:
    """Lower triangular; columns of zeros where a component is a combination of those before it."""
    lower = np.zeros_like(matrix)
    for j in range(len(matrix)):
        rest = matrix[j:, j] - sum(lower[j:, k] * lower[j, k] for k in range(j))
        if rest[0] > SEMIDEFINITE * matrix[j, j]:
            lower[j:, j] = rest / np.sqrt(rest[0])
    return lower


@dataclass(frozen=True, eq=False, init=False, repr=False)
class TruncatedNormal(Distribution):
    """Normal distribution truncated to an interval, independent in each component.

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
        Lower bound, may be −inf. The interval must reach to within 10⁶ std of the mean.
    high : float or array_like, shape (d,), optional
        Upper bound, high > low, may be inf.

    Examples
    --------
    >>> tail = TruncatedNormal(0.0, 1.0, low=8.0, high=np.inf)
    >>> tail.draw([[0.5]]).round(4).tolist()
    [8.0849]
    """

    mean: Array
    std: Array
    low: Array
    high: Array

    def __init__(
        self,
        mean: ArrayLike,
        std: ArrayLike,
        low: ArrayLike = -np.inf,
        high: ArrayLike = np.inf,
    ) -> None:
        centre, spread = _numbers("mean", mean), _numbers("std", std)
        lowest, highest = _numbers("low", low, infinite=True), _numbers("high", high, infinite=True)
        _refuse("std", spread, spread <= 0.0, "a positive number")
        _common_shape(mean=centre, std=spread, low=lowest, high=highest)
        _ordered(lowest, highest, strict=True)
        self._set(mean=centre, std=spread, low=lowest, high=highest)

    @property
    def shape(self) -> tuple[int, ...]:
        return _common_shape(mean=self.mean, std=self.std, low=self.low, high=self.high)

    def _draw(self, u: Array) -> Array:
        mean, std, low, high = (
            self._column(x)[:, 0].tolist() for x in (self.mean, self.std, self.low, self.high)
        )
        return np.stack(list(map(_truncated, mean, std, low, high, u)))


def _truncated(mean: float, std: float, low: float, high: float, u: Array) -> Array:
    """Quantiles of one component."""
    if mean >= high:  # mirrored, so that a mean outside of the bounds is below them
        return -_between(-mean, std, -high, -low, 1.0 - u, u)
    return _between(mean, std, low, high, u, 1.0 - u)


def _between(mean: float, std: float, low: float, high: float, p: Array, q: Array) -> Array:
    """Quantiles for a mean below `high`; p + q = 1."""
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
    """Quantiles of the density exp(−αt − βt²/2) on (0, 1), whose log changes by LONGEST at most."""
    nodes = 0.5 * (NODES + 1.0)

    def mass(t: Array) -> Array:
        """Integral of the density from 0 to t, by Gauss and Legendre's quadrature."""
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
    """Quantiles of z − a for a standard normal z between a ≥ 0 and a + w; p + q = 1.

    Solves −log(Q(a + s)/Q(a)) = s (a + s/2) − log(M(a + s)/M(a)) with Mills' ratio M = Q/φ.
    """
    special = _special()

    def mills(z: Any) -> Any:
        return np.sqrt(0.5 * np.pi) * special.erfcx(np.sqrt(0.5) * z)

    at_bound = mills(a)

    def depth(s: Any) -> Any:
        return s * (a + 0.5 * s) - np.log(mills(a + s) / at_bound)

    end = depth(w) if w < FAR else np.inf
    wanted = np.where(p < 0.5, -np.log1p(p * np.expm1(-end)), -np.log(q + p * np.exp(-end)))
    # The slope, 1/M, grows by less than s: so this start is below the root, and the depth convex.
    s: Array = 2.0 * wanted * at_bound / (1.0 + np.sqrt(1.0 + 2.0 * wanted * at_bound * at_bound))
    for _ in range(NEWTON_STEPS):
        s = np.maximum(s - (depth(s) - wanted) * mills(a + s), 0.0)
    return s


def _cut(a: float, b: float, p: Array) -> Array:
    """Quantiles of a standard normal between a < 0 and b > 0.

    Solves Φ(z) = (1 − p) Φ(a) + p Φ(b) for log Φ(z) or log Φ(−z), whichever is smaller.
    """
    special = _special()
    of_low, of_high = np.log1p(-p), np.log(p)
    below = np.logaddexp(of_low + special.log_ndtr(a), of_high + special.log_ndtr(b))
    above = np.logaddexp(of_low + special.log_ndtr(-a), of_high + special.log_ndtr(-b))
    z = special.ndtri_exp(np.minimum(below, above))
    found: Array = np.where(below < above, z, -z)
    return found


@dataclass(frozen=True, eq=False, init=False, repr=False)
class LogNormal(Distribution):
    """Distribution of exp of a normal variable: for positive quantities known up to a factor.

    Parameters
    ----------
    median : float or array_like, shape (d,)
        Median, > 0.
    sigma : float or array_like, shape (d,)
        Standard deviation of the natural logarithm, ≥ 0.

    Examples
    --------
    >>> LogNormal(3.0, 0.2).draw([[0.5]]).tolist()
    [3.0]
    """

    median: Array
    sigma: Array

    def __init__(self, median: ArrayLike, sigma: ArrayLike) -> None:
        middle, spread = _numbers("median", median), _numbers("sigma", sigma)
        _refuse("median", middle, middle <= 0.0, "a positive number")
        _refuse("sigma", spread, spread < 0.0, "zero or a positive number")
        _common_shape(median=middle, sigma=spread)
        reach = np.log(middle) + FARTHEST_Z * spread
        most = "less: its draws overflow, or a smaller median"
        _refuse("sigma", np.broadcast_to(spread, reach.shape), reach > np.log(LARGEST), most)
        self._set(median=middle, sigma=spread)

    @property
    def shape(self) -> tuple[int, ...]:
        return _common_shape(median=self.median, sigma=self.sigma)

    def _draw(self, u: Array) -> Array:
        z: Array = _special().ndtri(u)
        median, exponent = self._column(self.median), self._column(self.sigma) * z
        with np.errstate(over="ignore"):
            whole, half = median * np.exp(exponent), np.exp(0.5 * exponent)
        # beyond a double's range, beside a small median: in two factors
        return np.where(exponent < 700.0, whole, median * half * half)


@dataclass(frozen=True, eq=False, init=False, repr=False)
class Direction(Distribution):
    """Distribution of vectors that point anywhere with equal probability.

    z = 1 − 2u₀ is uniform in (−1, 1) and the azimuth 2πu₁ in (0, 2π), by Archimedes' theorem that a
    sphere and its cylinder have equal zones; the length takes further uniforms.

    Parameters
    ----------
    length : float or Distribution, optional
        Norm of the vectors, ≥ 0.

    Examples
    --------
    >>> Direction(2.0).draw([[0.5, 0.25]]).round(15).tolist()
    [[0.0, 2.0, 0.0]]
    """

    length: Distribution

    def __init__(self, length: Distribution | ArrayLike = 1.0) -> None:
        along = as_distribution("length", length)
        if along.shape != ():
            raise ArgumentError(f"length has shape {along.shape}; expected numbers, one a vector")
        if isinstance(along, Constant):
            _refuse("length", along.value, along.value < 0.0, "zero or a positive number")
        self._set(length=along)

    @property
    def shape(self) -> tuple[int, ...]:
        return (3,)

    @property
    def dimension(self) -> int:
        return 2 + self.length.dimension

    def _draw(self, u: Array) -> Array:
        across = 2.0 * np.sqrt(u[0] * (1.0 - u[0]))  # √(1 − z²)
        azimuth = 2.0 * np.pi * u[1]
        unit = np.stack((across * np.cos(azimuth), across * np.sin(azimuth), 1.0 - 2.0 * u[0]))
        return unit * self.length._draw(u[2:])


@dataclass(frozen=True, eq=False, init=False, repr=False)
class Rotation(Distribution):
    """Uniform distribution of rotation matrices over SO(3), invariant under any fixed rotation.

    The quaternion (√u₀ (cos 2πu₂, sin 2πu₂), √(1 − u₀) (sin 2πu₁, cos 2πu₁)) is uniform over the
    unit sphere. RᵀR is I to 1e-15 in every entry.

    References
    ----------
    K. Shoemake, Uniform random rotations, Graphics Gems III (1992) 124.

    Examples
    --------
    >>> Rotation().draw([[0.5, 0.0625, 0.9375]]).shape
    (1, 3, 3)
    """

    def __init__(self) -> None:
        pass

    @property
    def shape(self) -> tuple[int, ...]:
        return (3, 3)

    @property
    def dimension(self) -> int:
        return 3

    def _draw(self, u: Array) -> Array:
        first, second = 2.0 * np.pi * u[1], 2.0 * np.pi * u[2]
        r1, r2 = np.sqrt(1.0 - u[0]), np.sqrt(u[0])
        w, x = r2 * np.cos(second), r1 * np.sin(first)
        y, z = r1 * np.cos(first), r2 * np.sin(second)
        x2, y2, z2 = 2.0 * x, 2.0 * y, 2.0 * z
        matrix = (
            1.0 - (y2 * y + z2 * z), x2 * y - z2 * w, x2 * z + y2 * w,
            x2 * y + z2 * w, 1.0 - (x2 * x + z2 * z), y2 * z - x2 * w,
            x2 * z - y2 * w, y2 * z + x2 * w, 1.0 - (x2 * x + y2 * y),
        )  # fmt: skip
        return np.stack(so3.orthonormalised(matrix))


@dataclass(frozen=True, eq=False, init=False, repr=False)
class Values(Distribution):
    """Distribution over a list, each value equally probable; in a grid, the levels of a factor.

    Parameters
    ----------
    values : array_like, shape (k,), (k, d) or (k, d, d)
        k numbers, vectors or matrices.

    Examples
    --------
    >>> Values([1.0, 2.0, 5.0]).draw([[0.1], [0.5], [0.9]]).tolist()
    [1.0, 2.0, 5.0]
    """

    values: Array

    def __init__(self, values: ArrayLike) -> None:
        listed = _numbers("values", values, axes=3)
        if listed.ndim == 0:
            raise ArgumentError(f"values is {listed}; expected a list of numbers, or of arrays")
        self._set(values=listed)

    def __len__(self) -> int:
        return len(self.values)

    @property
    def shape(self) -> tuple[int, ...]:
        return self.values.shape[1:]

    @property
    def dimension(self) -> int:
        return 1

    def _draw(self, u: Array) -> Array:
        # The largest double below 1, times k, rounds to one below k.
        return self.take((u[0] * len(self)).astype(np.int64)).reshape(u.shape[1], -1).T

    def take(self, levels: NDArray[np.int64]) -> Array:
        """The values of these numbers, (n, *shape)."""
        return self.values[levels]


DISTRIBUTIONS = {  # by the names that studies give them
    "normal": Normal,
    "uniform": Uniform,
    "truncated_normal": TruncatedNormal,
    "log_normal": LogNormal,
    "direction": Direction,
    "rotation": Rotation,
    "values": Values,
}


def as_distribution(label: str, value: Distribution | ArrayLike) -> Distribution:
    """`value` itself, or the constant that it is."""
    if isinstance(value, Distribution):
        return value
    return Constant(_numbers(label, value, axes=2))


# ---- parameters ----------------------------------------------------------------------------------


def _label(field: str, place: tuple[int, ...]) -> str:
    return f"{field}[{', '.join(map(str, place))}]" if place else field


def _numbers(field: str, value: Any, axes: int = 1, infinite: bool = False) -> Array:
    """float64 of at most so many axes: a copy that nobody writes to. Takes SciPy's `Rotation`."""
    array = as_floats(field, as_matrix(field, value), copy=True)
    if array.ndim > axes or array.size == 0:
        raise ArgumentError(f"{field} has shape {array.shape}; expected {SHAPES[axes]}")
    if infinite:
        _refuse(field, array, np.isnan(array), "a number or ±inf")
    else:
        _refuse(field, array, ~np.isfinite(array), "finite numbers")
        _refuse(field, array, np.abs(array) > LARGEST, f"numbers up to {LARGEST:g}")
    array.setflags(write=False)
    return array


def _refuse(field: str, array: Array, bad: NDArray[np.bool_], expected: str) -> None:
    """Raise for the first entry of `array` that is bad."""
    for place in np.argwhere(bad)[:1]:
        where = tuple(int(i) for i in place)
        raise ArgumentError(f"{_label(field, where)} is {array[where]}; expected {expected}")


def _common_shape(**given: Array) -> tuple[int, ...]:
    """() or (d,): numbers go with vectors, vectors with vectors of their length."""
    sizes = {name: array.shape for name, array in given.items() if array.ndim}
    if len(set(sizes.values())) > 1:
        listed = ", ".join(f"{name} has {shape[0]}" for name, shape in sizes.items())
        raise ArgumentError(f"parameters differ in their number of components: {listed}")
    return next(iter(sizes.values()), ())


def _ordered(low: Array, high: Array, strict: bool) -> None:
    low, high = np.broadcast_arrays(low, high)
    for place in np.argwhere(low >= high if strict else low > high)[:1]:
        where = tuple(int(i) for i in place)
        raise ArgumentError(
            f"{_label('low', where)} is {low[where]} and {_label('high', where)} is {high[where]}; "
            f"expected low {'<' if strict else '≤'} high"
        )


def _special() -> Any:
    require("scipy")
    import scipy.special

    return scipy.special
