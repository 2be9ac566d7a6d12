"""Designs are values of n bodies, each a function of the seed and the body's number."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from math import prod
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lierb.errors import ArgumentError, require_name
from lierb.sampling.distribution import Distribution
from lierb.sampling.distributions import Constant, Values, as_distribution
from lierb.sampling.sobol import SOBOL_BITS, Sobol
from lierb.sampling.streams import SEED_BITS, UNIFORM_BITS, uniforms_of, words
from lierb.support.arrays import SLICE, Array, as_positive, components, is_whole
from lierb.support.memory import require_memory

METHODS = ("random", "sobol", "saltelli", "grid")
MOST_BODIES = 2**62  # body numbers are int64
LONGEST = 10**40  # largest number written out in a message


@dataclass(frozen=True, eq=False, init=False)
class Design:
    """A design plans which values n bodies get.

    Parameters
    ----------
    quantities : dict of Distribution or array_like
        A distribution, number or array for each name; numbers and arrays are constants.
    n : int, optional
        Number of bodies. A grid has as many as its levels make.
    seed : int, optional
        Seed, 0 to 2⁶⁴ − 1; a grid does not use it.
    method : {"random", "sobol", "saltelli", "grid"}, optional
        Method of drawing, see Notes.

    Raises
    ------
    ArgumentError
        The quantities, n and the method do not go together.
    UnknownNameError
        The method does not exist.

    Notes
    -----
    "random" makes independent draws. Body b takes those of its quantity's stream, whose key is a
    hash of seed and name: they depend neither on the other quantities nor on n.

    "sobol" takes the points of one scrambled Sobol sequence, a coordinate for each uniform of each
    quantity, in their order: they fill the cube more evenly, and means of smooth functions converge
    almost like 1/n, not like 1/√n. It is best with n a power of two; another n does no harm. Draws
    depend on seed and on all quantities, not on n ≤ 2³².

    "saltelli" is for Sobol's sensitivity indices. Of q quantities that are drawn, each q + 2 bodies
    take one point of a Sobol sequence of twice the coordinates, two independent draws A and B of
    everything: the first body is A, the second B, and number 2 + j is A with B's quantity j. n is
    (q + 2)·2ᵏ; all components of a vector are one quantity.

    "grid" takes every combination of the levels of `Values`, the last quantity's changing fastest;
    other quantities must be constants.

    References
    ----------
    A. Saltelli et al., Comput. Phys. Commun. 181 (2010).

    Examples
    --------
    >>> from lierb.sampling import Design, Values
    >>> grid = Design({"mass": Values([1.0, 2.0]), "pitch": Values([0.1, 0.2, 0.3])}, method="grid")
    >>> grid.n, grid.draw()["pitch"].tolist()
    (6, [0.1, 0.2, 0.3, 0.1, 0.2, 0.3])
    """

    quantities: dict[str, Distribution]
    n: int
    seed: int
    method: str

    def __init__(
        self,
        quantities: Mapping[str, Distribution | ArrayLike],
        n: int | None = None,
        seed: int = 0,
        method: str = "random",
    ) -> None:
        require_name("method", method, METHODS)
        if not isinstance(quantities, Mapping) or not quantities:
            raise ArgumentError(
                f"quantities must name what is drawn, got a {type(quantities).__name__}; expected "
                "a dictionary, not empty"
            )
        for name in quantities:
            if not isinstance(name, str) or not name:
                raise ArgumentError(f"quantities has the key {name!r}; expected names")
        distributions = {
            name: as_distribution(f"quantities[{name!r}]", value)
            for name, value in quantities.items()
        }
        if method == "grid":
            n = _size_of_grid(distributions, n)
        elif n is None:
            raise ArgumentError(f"method={method!r} needs n, the number of bodies")
        object.__setattr__(self, "quantities", distributions)
        object.__setattr__(self, "n", _whole("n", n, 1, MOST_BODIES))
        object.__setattr__(self, "method", method)
        if method == "saltelli":
            _check_rows(self.n, len(self.drawn))
        if method in ("sobol", "saltelli") and self._points > 2**SOBOL_BITS:
            raise ArgumentError(
                f"n={n}: a Sobol sequence has 2³² = {2**SOBOL_BITS} points; take as many, or "
                'method="random"'
            )
        object.__setattr__(self, "seed", _whole("seed", seed, 0, 2**SEED_BITS - 1))

    def __len__(self) -> int:
        return self.n

    @property
    def dimension(self) -> int:
        """Return the number of uniforms that a body takes."""
        return sum(quantity.dimension for quantity in self.quantities.values())

    @property
    def drawn(self) -> tuple[str, ...]:
        """Return the names of the quantities that differ between bodies."""
        return tuple(name for name, q in self.quantities.items() if q.dimension)

    @property
    def _points(self) -> int:
        """Return the number of points of the Sobol sequence."""
        return self.n // (len(self.drawn) + 2) if self.method == "saltelli" else self.n

    def draw(self, first: int = 0, count: int | None = None) -> dict[str, Array]:
        """Draw the values of bodies first, first + 1, …, first + count − 1.

        Parameters
        ----------
        first : int, optional
            Number of the first body.
        count : int, optional
            Number of bodies. Default: all from `first` on.

        Returns
        -------
        dict of ndarray, shape (count, …)
            Values by name.

        Raises
        ------
        ArgumentError
            Unless 0 ≤ first < n and 1 ≤ count ≤ n − first.
        MemoryLimitError
            The values are larger than the free memory.
        """
        start = _whole("first", first, 0, self.n - 1)
        left = self.n - start
        many = left if count is None else _whole("count", count, 1, left)
        numbers = many * sum(prod(q.shape) for q in self.quantities.values())
        what = f"what is drawn for {many} bodies"
        require_memory(8 * numbers, what, "draw fewer at a time: first, count")
        drawn = {name: np.empty((many, *q.shape)) for name, q in self.quantities.items()}
        for done in range(0, many, SLICE):
            size = min(SLICE, many - done)
            for name, values in self._part(start + done, size).items():
                drawn[name][done : done + size] = values
        return drawn

    def independent(self, bodies: ArrayLike) -> NDArray[np.bool_]:
        """Mark bodies whose values are drawn independently of each other.

        Confidence intervals by counts of bodies, as those of quantiles, hold for these alone.

        Parameters
        ----------
        bodies : array_like of int, shape (n,)
            Numbers of bodies.

        Returns
        -------
        ndarray of bool, shape (n,)
            True for all bodies of "random" and "sobol", for the first two of each row, A and B, of
            "saltelli", and for no body of "grid".
        """
        numbers = np.asarray(bodies)
        if self.method == "saltelli":
            return np.asarray(numbers % (len(self.drawn) + 2) < 2)
        return np.full(len(numbers), self.method != "grid")

    def _part(self, first: int, count: int) -> dict[str, Array]:
        if self.method == "grid":
            return self._grid_part(first, count)
        if self.method == "sobol":
            points = self._sobol.points(first, count)
        elif self.method == "saltelli":
            points = self._saltelli_points(first, count)
        drawn, column = {}, 0
        for name, quantity in self.quantities.items():
            d = quantity.dimension
            if self.method in ("sobol", "saltelli"):
                u = points[:, column : column + d]
            else:
                u = uniforms_of(words(self.seed, name, first, count, d) >> 64 - UNIFORM_BITS)
            drawn[name] = quantity.draw(u)
            column += d
        return drawn

    def _grid_part(self, first: int, count: int) -> dict[str, Array]:
        """Draw from a grid: levels are the digits of the body's number in a mixed radix."""
        drawn, rest = {}, np.arange(first, first + count)
        for name, quantity in reversed(self.quantities.items()):
            if isinstance(quantity, Values):
                rest, levels = np.divmod(rest, len(quantity))
                drawn[name] = quantity.take(levels)
            else:
                drawn[name] = quantity.draw(np.empty((count, 0)))
        return drawn

    def _saltelli_points(self, first: int, count: int) -> Array:
        """Points (count, dimension): A, B, A with B's first quantity, A with B's second, …"""
        each, d = len(self.drawn) + 2, self.dimension
        bodies = np.arange(first, first + count)
        rows, kinds = bodies // each, bodies % each
        start = int(rows[0])
        both = self._sobol.points(start, int(rows[-1]) - start + 1)[rows - start]
        widths = [self.quantities[name].dimension for name in self.drawn]
        owner = np.repeat(np.arange(len(widths)), widths)  # of each coordinate
        from_b = (kinds[:, None] == 1) | (kinds[:, None] == 2 + owner)
        return np.where(from_b, both[:, d:], both[:, :d])

    @cached_property
    def _sobol(self) -> Sobol:
        draws = 2 if self.method == "saltelli" else 1
        return Sobol(self.seed, self._points, draws * self.dimension)


def _whole(argument: str, value: Any, low: int, high: int) -> int:
    whole = is_whole(value)
    if whole and low <= value <= high:
        return int(value)
    shown = str(value) if whole and abs(int(value)) < LONGEST else f"a {type(value).__name__}"
    if isinstance(value, (bool, float, str)):
        shown = repr(value)
    raise ArgumentError(f"{argument}={shown}; expected a whole number from {low} to {high}")


def _check_rows(n: int, quantities: int) -> None:
    """Raise ArgumentError unless n bodies make a power of two rows, for balanced Sobol points."""
    if not quantities:
        raise ArgumentError('method="saltelli" needs a quantity that is drawn; all are constants')
    each = quantities + 2
    rows = n // each
    if n == rows * each and rows & (rows - 1) == 0:
        return
    below = 1 << max(rows, 1).bit_length() - 1
    raise ArgumentError(
        f"n={n}: a saltelli design of {quantities} quantities takes {each} bodies times a power of "
        f"two; the nearest are {each * below} and {2 * each * below}"
    )


def _size_of_grid(quantities: dict[str, Distribution], n: int | None) -> int:
    levels = []
    for name, quantity in quantities.items():
        if isinstance(quantity, Values):
            levels.append(len(quantity))
        elif not isinstance(quantity, Constant):
            raise ArgumentError(
                f"quantities[{name!r}] is {quantity}; a grid takes Values, numbers and arrays"
            )
    size = prod(levels)
    if n is not None and n != size:
        made = " × ".join(map(str, levels)) or "no levels"
        _whole("n", n, 1, MOST_BODIES)
        raise ArgumentError(f"n={n}, but {made} make a grid of {size} bodies; leave n out")
    return size


def inertia_of(second_moments: ArrayLike) -> Array:
    """Compute inertia matrices from ∫x² dm, ∫y² dm and ∫z² dm along the principal axes.

    Draw these, not the principal moments: three positive numbers need not be a body's moments,
    since each moment is at most the sum of the two others. Here J₁ + J₂ − J₃ = 2c > 0, and every a,
    b, c > 0 belongs to a body: six points of a sixth of the mass m, on the axes at ±√(3a/m),
    ±√(3b/m), ±√(3c/m). Conversely every body with an extent in all directions has such a, b, c.

    Parameters
    ----------
    second_moments : array_like, shape (3,) or (n, 3)
        Second moments (a, b, c), kg m², > 0.

    Returns
    -------
    ndarray, shape (3, 3) or (n, 3, 3)
        Inertia matrices, kg m²: diagonal, with b + c, c + a, a + b. (The principal moments of three
        bodies would look like one matrix.)

    Examples
    --------
    >>> from lierb.sampling import inertia_of
    >>> inertia_of((1.0, 2.0, 3.0)).diagonal().tolist()
    [5.0, 4.0, 3.0]
    """
    a, b, c = components(as_positive("second_moments", second_moments, "kg m²", 3))
    return np.stack((b + c, c + a, a + b), axis=-1)[..., None] * np.eye(3)
