"""Define the base of the distributions, and checks of their parameters."""

from __future__ import annotations

from dataclasses import fields
from math import prod
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lierb.errors import ArgumentError
from lierb.support.arrays import Array, as_floats, as_matrix
from lierb.support.extras import require

LARGEST = 1e300  # largest parameter: sums of a few, and 39 std, are finite
SHAPES = {
    1: "a number or (d,)",
    2: "a number, (d,) or a matrix",
    3: "k numbers, vectors or matrices",
}


class Distribution:
    """The value of one body is drawn from a distribution; this class is the base of those below.

    Attributes
    ----------
    shape : tuple of int
        Shape of one draw: (), (d,) or (3, 3).
    dimension : int
        Number of uniforms that a draw takes.
    """

    shape: tuple[int, ...]

    @property
    def dimension(self) -> int:
        return prod(self.shape)

    @property
    def moments(self) -> tuple[Array, Array]:
        """Mean, shape (components,), and covariance, (components, components), of a draw."""
        raise NotImplementedError

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
        refuse("u", points, ~((points > 0.0) & (points < 1.0)), "numbers in (0, 1)")
        # One contiguous row a component: on other arrays NumPy's logarithm rounds differently, and
        # a body's bits would depend on the array that contains it.
        parts = self._draw(np.ascontiguousarray(points.T))
        return np.ascontiguousarray(parts.T).reshape(len(points), *self.shape)

    def _draw(self, u: Array) -> Array:
        """Compute (components, n) from uniforms (dimension, n), element by element."""
        raise NotImplementedError

    def _independent(self, mean: Array, variance: Array) -> tuple[Array, Array]:
        """Return the moments of independent components."""
        centre, spread = (np.broadcast_to(x, self.shape).flatten() for x in (mean, variance))
        return centre, np.diag(spread)

    def _column(self, parameter: Array) -> Array:
        """Return a parameter as a column, one row a component."""
        return np.broadcast_to(parameter, self.shape).reshape(-1, 1)

    def _set(self, **values: object) -> None:
        for name, value in values.items():
            object.__setattr__(self, name, value)

    def __repr__(self) -> str:
        values = {f.name: getattr(self, f.name) for f in fields(self)}  # type: ignore[arg-type]
        shown = {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in values.items()}
        inside = ", ".join(f"{k}={v}" for k, v in shown.items() if v is not None)
        return f"{type(self).__name__}({inside})"


# ---- parameters ----------------------------------------------------------------------------------


def _label(field: str, place: tuple[int, ...]) -> str:
    return f"{field}[{', '.join(map(str, place))}]" if place else field


def numbers_of(field: str, value: Any, axes: int = 1, infinite: bool = False) -> Array:
    """Convert to a read-only float64 array of at most `axes` axes; SciPy's `Rotation`, too."""
    array = as_floats(field, as_matrix(field, value), copy=True)
    if array.ndim > axes or array.size == 0:
        raise ArgumentError(f"{field} has shape {array.shape}; expected {SHAPES[axes]}")
    if infinite:
        refuse(field, array, np.isnan(array), "a number or ±inf")
    else:
        refuse(field, array, ~np.isfinite(array), "finite numbers")
        refuse(field, array, np.abs(array) > LARGEST, f"numbers up to {LARGEST:g}")
    array.setflags(write=False)
    return array


def refuse(field: str, array: Array, bad: NDArray[np.bool_], expected: str) -> None:
    """Raise ArgumentError for the first bad entry of `array`."""
    for place in np.argwhere(bad)[:1]:
        where = tuple(int(i) for i in place)
        raise ArgumentError(f"{_label(field, where)} is {array[where]}; expected {expected}")


def common_shape(**parameters: Array) -> tuple[int, ...]:
    """Return the shape () or (d,) of parameters: numbers, and vectors of one length."""
    sizes = {name: array.shape for name, array in parameters.items() if array.ndim}
    if len(set(sizes.values())) > 1:
        listed = ", ".join(f"{name} has {shape[0]}" for name, shape in sizes.items())
        raise ArgumentError(f"parameters differ in their number of components: {listed}")
    return next(iter(sizes.values()), ())


def require_ordered(low: Array, high: Array, strict: bool) -> None:
    low, high = np.broadcast_arrays(low, high)
    for place in np.argwhere(low >= high if strict else low > high)[:1]:
        where = tuple(int(i) for i in place)
        raise ArgumentError(
            f"{_label('low', where)} is {low[where]} and {_label('high', where)} is {high[where]}; "
            f"expected low {'<' if strict else '≤'} high"
        )


def scipy_special() -> Any:
    require("scipy")
    import scipy.special

    return scipy.special
