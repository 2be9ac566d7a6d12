"""Decomposition of the linear system J V = ḣ of all rows of a mechanism.

There are two metrics: x = (ω, v/ℓ) of every link, v of its centre of mass and ℓ the mechanism's
longest lever arm; and y, with ‖y‖² twice the kinetic energy. Redundancy depends on geometry alone:
ranks are determined in x, with rows of length 1. Masses select among the motions that all rows
allow.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property
from typing import Any

import numpy as np

from lierb.kernels.mechanics.newton_euler import Parameters, inertia_about_com
from lierb.kernels.numbers.arithmetic import where
from lierb.kernels.numbers.vec import (
    Mat,
    Vec,
    add,
    cross,
    cross_add,
    diagonal,
    dot,
    mat_t_vec,
    scale,
    sub,
)
from lierb.kernels.numbers.zero import ZERO
from lierb.support.arrays import Array, assembled

# Bound between nonzero and zero singular values, relative to the largest. A start
# may violate its joints by 1e-9, and redundant rows are then dependent only to that accuracy.
RANK_TOLERANCE = 1e-7


class Metric:
    """Kinetic energy of one link: Θ = LLᵀ, m and c."""

    def __init__(self, p: Parameters, unit: Any, least: Any) -> None:
        """unit : unit of y², kg m².   least : lower bound for the trace of the inertia, kg m²."""
        inertia = inertia_about_com(p)
        trace = inertia[0] + inertia[4] + inertia[8]
        added = where(trace < least, least, 0.0 * trace)
        self.lower = _cholesky(add(inertia, diagonal((added, added, added))))
        self.com, self.root, self.unit = p.com, np.sqrt(p.mass), np.sqrt(unit)

    def __call__(self, omega: Vec, moving: Vec) -> Vec:
        """Compute y from angular velocity and velocity of the centre of mass."""
        turning = mat_t_vec(self.lower, omega)
        return scale(1.0 / self.unit, turning + scale(self.root, moving))


def _cholesky(m: Mat) -> Mat:
    """Factor L of m = LLᵀ, row by row."""
    a = np.sqrt(m[0])
    b, d = m[3] / a, m[6] / a
    c = np.sqrt(m[4] - b * b)
    e = (m[7] - d * b) / c
    f = np.sqrt(m[8] - d * d - e * e)
    return (a, ZERO, ZERO, b, c, ZERO, d, e, f)


class Decomposed:
    """Singular value decompositions of matrices A, (count, rows, n)."""

    def __init__(self, matrix: Array) -> None:
        u, self.values, self.vt = np.linalg.svd(matrix)
        self.u = u[..., : self.values.shape[1]]
        self.ranks = self.ranks_above(RANK_TOLERANCE)

    def ranks_above(self, tolerance: Array | float) -> Array:
        """Return the number of singular values above a fraction of the largest one.

        tolerance : the fraction, (count,) or for all.
        """
        kept = self.values > np.reshape(tolerance, (-1, 1)) * self.values[:, :1]
        return np.asarray(np.count_nonzero(kept, axis=1))

    def least(self, wanted: Array, damping: Array | float = 0.0) -> Array:
        """Return the least x with A x = wanted, or the minimum of ‖A x − wanted‖² + damping ‖x‖².

        wanted : (count, rows).   damping : (count,).
        """
        count = self.values.shape[1]
        kept = np.arange(count) < self.ranks[:, None]
        squares = self.values * self.values + np.reshape(damping, (-1, 1))
        gains = np.where(kept, self.values, 0.0) / np.where(kept, squares, 1.0)
        parts = gains * summed(np.swapaxes(self.u, 1, 2) * wanted[:, None, :])
        return summed(np.swapaxes(self.vt[:, :count], 1, 2) * parts[:, None, :])

    def missed(self, wanted: Array) -> Array:
        """Return the part of `wanted` that A x reaches for no x, (count, rows)."""
        kept = np.arange(self.values.shape[1]) < self.ranks[:, None]
        for _ in range(2):  # the second time removes rounding
            parts = summed(np.swapaxes(self.u, 1, 2) * wanted[:, None, :])
            wanted = wanted - summed(self.u * np.where(kept, parts, 0.0)[:, None, :])
        return wanted


class DecomposedRows(Decomposed):
    """Decomposition of all rows, in x and scaled to length 1.

    lengths : (count, rows), lengths before scaling.
    """

    def __init__(self, metrics: list[Metric], matrix: Array, lever: Array) -> None:
        """matrix : (count, rows, 6 links), Jacobian with respect to x.   lever : ℓ, m, (count,)."""
        lengths = np.sqrt(summed(matrix * matrix))
        self.metrics, self.lever = metrics, lever
        self.lengths = np.where(lengths == 0.0, 1.0, lengths)
        super().__init__(matrix / self.lengths[..., None])

    @property
    def freedoms(self) -> Array:
        """Dimension of the space of motions that all rows allow, (count,)."""
        return np.asarray(self.vt.shape[1] - self.ranks)

    @cached_property
    def moving(self) -> Array:
        """Motions `vt` in y, (count, n, n); those from index `ranks` on are free."""
        return np.swapaxes(self._energetic(np.swapaxes(self.vt, 0, 1)), 0, 1)

    def speed(self, twists: list[Vec]) -> Array:
        """Return ‖x‖ of all links' twists, rad/s, (count,)."""
        total: Any = 0.0
        for twist, metric in zip(twists, self.metrics, strict=True):
            moving = scale(1.0 / self.lever, cross_add(twist[:3], metric.com, twist[3:]))
            total = total + dot(twist[:3], twist[:3]) + dot(moving, moving)
        return np.asarray(np.sqrt(total))

    def lightest(self, wanted: Array, damping: Array | float = 0.0) -> list[Vec]:
        """Return the twists of least kinetic energy with J V = wanted, for rows of length 1.

        damping : as in `least`; it does not act on the free motions that are added.
        """
        x = self.least(wanted, damping)
        y = self._energetic(x)
        moving = self.moving
        for rank in np.unique(self.ranks[self.freedoms > 0]):
            these = self.ranks == rank
            x[these] += _easing(self.vt[these, rank:], moving[these, rank:], y[these])
        return [
            omega + sub(velocity, cross(omega, metric.com))
            for omega, velocity, metric in self._parts(x)
        ]

    def _parts(self, x: Array) -> Iterator[tuple[Vec, Vec, Metric]]:
        """Angular velocity, velocity of the centre of mass and metric of every link."""
        for i, metric in enumerate(self.metrics):
            part = tuple(x[..., 6 * i + k] for k in range(6))
            yield part[:3], scale(self.lever, part[3:]), metric

    def _energetic(self, x: Array) -> Array:
        """Convert x to y, (…, count, 6 links)."""
        return np.concatenate([assembled(metric(*v)) for *v, metric in self._parts(x)], axis=-1)


def _easing(free: Array, moving: Array, y: Array) -> Array:
    """Combination of free motions with the least ‖y‖, (count, n).

    free, moving : (count, freedoms, n), in x and in y.

    With masses of different orders of magnitude the columns of y are nearly parallel, dominated by
    the heaviest link. Gaussian elimination with complete pivoting gives columns that move lighter
    and lighter links, and that are well-conditioned once scaled to length 1.
    """
    free, moving, (count, freedoms, n) = free.copy(), moving.copy(), free.shape
    each = np.arange(count)
    for j in range(freedoms):
        largest = np.abs(moving[:, j:]).reshape(count, -1).argmax(axis=1)
        column, row = j + largest // n, largest % n
        for columns in (free, moving):
            columns[each, column], columns[:, j] = columns[:, j].copy(), columns[each, column]
        shares = moving[each, j + 1 :, row] / moving[each, j, row][:, None]
        for columns in (free, moving):
            columns[:, j + 1 :] -= shares[..., None] * columns[:, None, j]
    sizes = np.sqrt(summed(moving * moving))
    q, r = np.linalg.qr(np.swapaxes(moving / sizes[..., None], 1, 2))
    parts = -summed(np.swapaxes(q, 1, 2) * y[:, None, :])
    try:
        parts = np.linalg.solve(r, parts[..., None])[..., 0] / sizes
    except np.linalg.LinAlgError:  # free motions that are equal to rounding, as of a mass of 1e300
        parts = np.full_like(parts, np.nan)  # the caller's iteration does not converge
    return summed(np.swapaxes(free, 1, 2) * parts[:, None, :])


def summed(array: Array) -> Array:
    """Sum over the last axis, in order; the order in `np.sum` depends on the batch."""
    total = np.zeros(array.shape[:-1])
    for i in range(array.shape[-1]):
        total = total + array[..., i]
    return total
