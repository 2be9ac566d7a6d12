"""Distributions of numbers, vectors and rotations are functions of uniforms.

Each draw is an inverse distribution function of `dimension` uniforms, without rejection. Its bits
are the same alone and in any batch, on one kind of CPU. Parameters are a number, the same for all
components, or (d,); units are the caller's.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lierb.errors import ArgumentError
from lierb.kernels.groups import quaternion, so3
from lierb.sampling.distribution import (
    Distribution,
    common_shape,
    numbers_of,
    refuse,
    require_ordered,
)
from lierb.sampling.normal import LogNormal, Normal, TruncatedNormal
from lierb.support.arrays import Array


@dataclass(frozen=True, eq=False, init=False, repr=False)
class Constant(Distribution):
    """One value for every body; a number or an array in place of a distribution becomes one.

    Parameters
    ----------
    value : float or array_like, shape (d,) or (d, d)
        The value.

    Examples
    --------
    >>> from lierb.sampling import Constant
    >>> import numpy as np
    >>> Constant((0.0, 0.0, -9.81)).draw(np.empty((2, 0))).tolist()
    [[0.0, 0.0, -9.81], [0.0, 0.0, -9.81]]
    """

    dimension = 0
    value: Array

    def __init__(self, value: ArrayLike) -> None:
        array = numbers_of("value", value, axes=2)
        self._set(value=array, shape=array.shape)

    def _draw(self, u: Array) -> Array:
        return np.repeat(self.value.reshape(-1, 1), u.shape[1], axis=1)

    @property
    def moments(self) -> tuple[Array, Array]:
        return self._independent(self.value, np.zeros(()))


@dataclass(frozen=True, eq=False, init=False, repr=False)
class Uniform(Distribution):
    """The distribution is uniform between two bounds, independent in each component.

    Parameters
    ----------
    low : float or array_like, shape (d,)
        Lower bound.
    high : float or array_like, shape (d,)
        Upper bound, high ≥ low.

    Raises
    ------
    ArgumentError
        `high` is less than `low`, or a bound is not finite.

    Examples
    --------
    >>> from lierb.sampling import Uniform
    >>> Uniform(1.0, (3.0, 5.0)).draw([[0.5, 0.25]]).tolist()
    [[2.0, 2.0]]
    """

    low: Array
    high: Array

    def __init__(self, low: ArrayLike, high: ArrayLike) -> None:
        lowest, highest = numbers_of("low", low), numbers_of("high", high)
        shape = common_shape(low=lowest, high=highest)
        require_ordered(lowest, highest, strict=False)
        self._set(low=lowest, high=highest, shape=shape)

    def _draw(self, u: Array) -> Array:
        low, high = self._column(self.low), self._column(self.high)
        return np.minimum(low + (high - low) * u, high)  # rounding may pass it by an ulp

    @property
    def moments(self) -> tuple[Array, Array]:
        width = self.high - self.low
        return self._independent(self.low + 0.5 * width, width**2 / 12.0)


@dataclass(frozen=True, eq=False, init=False, repr=False)
class Direction(Distribution):
    """The vectors of the distribution point anywhere with equal probability.

    z = 1 − 2u₀ is uniform in (−1, 1) and the azimuth 2πu₁ in (0, 2π), by Archimedes' theorem that a
    sphere and its cylinder have equal zones; the length takes further uniforms.

    Parameters
    ----------
    length : float or Distribution, optional
        Norm of the vectors, ≥ 0.

    Examples
    --------
    >>> from lierb.sampling import Direction
    >>> Direction(2.0).draw([[0.5, 0.25]]).round(15).tolist()
    [[0.0, 2.0, 0.0]]
    """

    shape = (3,)
    length: Distribution

    def __init__(self, length: Distribution | ArrayLike = 1.0) -> None:
        along = as_distribution("length", length)
        if along.shape != ():
            raise ArgumentError(f"length has shape {along.shape}; expected numbers, one a vector")
        if isinstance(along, Constant):
            refuse("length", along.value, along.value < 0.0, "zero or a positive number")
        self._set(length=along)

    @property
    def dimension(self) -> int:
        return 2 + self.length.dimension

    def _draw(self, u: Array) -> Array:
        across = 2.0 * np.sqrt(u[0] * (1.0 - u[0]))  # radius √(1 − z²)
        azimuth = 2.0 * np.pi * u[1]
        unit = np.stack((across * np.cos(azimuth), across * np.sin(azimuth), 1.0 - 2.0 * u[0]))
        return unit * self.length._draw(u[2:])

    @property
    def moments(self) -> tuple[Array, Array]:
        mean, variance = self.length.moments
        return np.zeros(3), np.eye(3) * (mean**2 + variance[0]) / 3.0


@dataclass(frozen=True, eq=False, init=False, repr=False)
class Rotation(Distribution):
    """Rotation matrices are uniform over SO(3), invariant under any fixed rotation.

    The quaternion (√u₀ (cos 2πu₂, sin 2πu₂), √(1 − u₀) (sin 2πu₁, cos 2πu₁)) is uniform over the
    unit sphere. RᵀR is I to 1e-15 in every entry.

    References
    ----------
    K. Shoemake, Uniform random rotations, Graphics Gems III (1992) 124.

    Examples
    --------
    >>> from lierb.sampling import Rotation
    >>> Rotation().draw([[0.5, 0.0625, 0.9375]]).shape
    (1, 3, 3)
    """

    shape = (3, 3)
    dimension = 3

    def _draw(self, u: Array) -> Array:
        first, second = 2.0 * np.pi * u[1], 2.0 * np.pi * u[2]
        r1, r2 = np.sqrt(1.0 - u[0]), np.sqrt(u[0])
        w, x = r2 * np.cos(second), r1 * np.sin(first)
        y, z = r1 * np.cos(first), r2 * np.sin(second)
        return np.stack(so3.orthonormalised(quaternion.matrix((w, x, y, z), twice=2.0)))

    @property
    def moments(self) -> tuple[Array, Array]:
        return np.zeros(9), np.eye(9) / 3.0  # E RᵢⱼRₖₗ = δᵢₖδⱼₗ/3, by invariance


@dataclass(frozen=True, eq=False, init=False, repr=False)
class Values(Distribution):
    """Distribution over a list, each value equally probable; in a grid, the levels of a factor.

    Parameters
    ----------
    values : array_like, shape (k,), (k, d) or (k, d, d)
        k numbers, vectors or matrices.

    Examples
    --------
    >>> from lierb.sampling import Values
    >>> Values([1.0, 2.0, 5.0]).draw([[0.1], [0.5], [0.9]]).tolist()
    [1.0, 2.0, 5.0]
    """

    dimension = 1
    values: Array

    def __init__(self, values: ArrayLike) -> None:
        listed = numbers_of("values", values, axes=3)
        if listed.ndim == 0:
            raise ArgumentError(f"values is {listed}; expected a list of numbers, or of arrays")
        self._set(values=listed, shape=listed.shape[1:])

    def __len__(self) -> int:
        return len(self.values)

    def _draw(self, u: Array) -> Array:
        # The largest double below 1, times k, rounds to one below k.
        return self.take((u[0] * len(self)).astype(np.int64)).reshape(u.shape[1], -1).T

    def take(self, levels: NDArray[np.int64]) -> Array:
        """Return the values at these indices, (n, *shape)."""
        return self.values[levels]

    @property
    def moments(self) -> tuple[Array, Array]:
        flat = self.values.reshape(len(self), -1)
        off = flat - flat.mean(axis=0)
        return flat.mean(axis=0), off.T @ off / len(self)


DISTRIBUTIONS = {  # by their names in studies
    "normal": Normal,
    "uniform": Uniform,
    "truncated_normal": TruncatedNormal,
    "log_normal": LogNormal,
    "direction": Direction,
    "rotation": Rotation,
    "values": Values,
}


def as_distribution(label: str, value: Distribution | ArrayLike) -> Distribution:
    """Return a distribution itself; convert numbers to a constant."""
    if isinstance(value, Distribution):
        return value
    return Constant(numbers_of(label, value, axes=2))
