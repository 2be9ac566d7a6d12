"""Find the combinations of unknowns that data cannot tell, and describe them by name."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lierb.support.arrays import Array
from lierb.support.representations import counted

NO_EFFECT = 1e-12
"""Columns of the scaled Jacobian up to this, relative to the largest, have no effect."""

NO_DIFFERENCE = 1e-8
"""Singular values up to this, relative to the largest, belong to directions without effect."""

SHARE = 1e-6  # smaller components of a unit vector count as zero
SAME = 1e-3  # relative changes that differ by less are one scale
MOST_NAMED = 4  # numbers in the description of a direction
NEUTRAL = "has no effect", "together have no effect"
HELD = "is held by loops", "together are held by loops"


class Direction(NamedTuple):
    """Combination of unknowns that the data cannot tell.

    Attributes
    ----------
    changes : dict of float
        Changes that leave the data as they are, together, by number of a parameter; SI units. The
        largest is that of the first.
    sentence : str
        Description in a line: one number, the common scale of parameters, or numbers that change
        together, the largest relative changes first.
    """

    changes: dict[str, float]
    sentence: str

    def __str__(self) -> str:
        return self.sentence


class Identified(NamedTuple):
    """Unknowns as far as data tell them.

    covariance : of the directions that they tell, for residuals of variance 1.
    null : directions that they do not tell, [direction][unknown].
    is_known : False for the unknowns in any of these.   rank : number of directions told.
    """

    covariance: Array
    null: Array
    is_known: NDArray[np.bool_]
    rank: int


class Decomposed(NamedTuple):
    """Singular values of a Jacobian, or of each of a stack, in units of the unknowns.

    Columns are of unit length in these units, those without effect are zero.

    units : change of each unknown that is its unit, (…, unknowns).
    is_felt : False for unknowns without effect.
    left, values, rows : decomposition U, S, Vᵀ; V is complete.
    is_told : True for the directions with an effect, (…, values).
    """

    units: Array
    is_felt: NDArray[np.bool_]
    left: Array
    values: Array
    rows: Array
    is_told: NDArray[np.bool_]

    @property
    def rank(self) -> NDArray[np.int64]:
        """Return the number of directions told, (…)."""
        return np.asarray(self.is_told.sum(-1))

    @property
    def covariance(self) -> Array:
        """Return the covariance of the directions told, for residuals of variance 1."""
        size = self.values.shape[-1]
        inverse = np.where(self.is_told, 1.0 / np.where(self.is_told, self.values, 1.0), 0.0)
        half = self.units[..., None] * self.rows[..., :size, :].swapaxes(-1, -2)
        half = half * inverse[..., None, :]
        return np.asarray(half @ half.swapaxes(-1, -2))

    @property
    def is_known(self) -> NDArray[np.bool_]:
        """Return False for the unknowns in any direction without effect, (…, unknowns)."""
        numbers = np.arange(self.rows.shape[-1])
        null = np.where((numbers >= self.rank[..., None])[..., None], self.rows, 0.0)
        return np.asarray(self.is_felt & (np.linalg.norm(null, axis=-2) <= SHARE))


def decomposed(jacobian: Array, sizes: Array, least: float = 0.0) -> Decomposed:
    """Decompose Jacobians by singular values.

    jacobian : (…, residuals, unknowns).   sizes : typical size of each unknown, (…, unknowns).
    least : change of all residuals together that is rounding.
    """
    scaled = jacobian * sizes[..., None, :]
    norms = np.linalg.norm(scaled, axis=-2)
    largest = norms.max(axis=-1, keepdims=True, initial=0.0)
    is_felt = norms > np.maximum(NO_EFFECT * largest, least)
    units = np.where(is_felt, sizes / np.where(is_felt, norms, 1.0), 0.0)
    left, values, rows = np.linalg.svd(jacobian * units[..., None, :], full_matrices=False)
    if rows.shape[-2] < rows.shape[-1]:  # fewer residuals than unknowns
        rows = np.linalg.svd(jacobian * units[..., None, :], full_matrices=True)[2]
    is_told = values > NO_DIFFERENCE * values.max(axis=-1, keepdims=True, initial=0.0)
    return Decomposed(units, is_felt, left, values, rows, is_told)


def identified(jacobian: Array, sizes: Array, least: float = 0.0) -> Identified:
    """Find the directions that data tell, and those that they do not.

    jacobian : (residuals, unknowns).   sizes : typical size of each unknown.
    least : as in `decomposed`.
    """
    parts = decomposed(jacobian, sizes, least)
    is_felt, rank, count = parts.is_felt, int(parts.rank), len(sizes)
    null = np.zeros((count - rank, count))
    first = count - int(is_felt.sum())
    null[range(first), np.flatnonzero(~is_felt)] = sizes[~is_felt]
    # an orthonormal basis of the vectors that are orthogonal to the directions told
    _, _, directions = np.linalg.svd(parts.rows[:rank, is_felt], full_matrices=True)
    together = _sparse(directions[rank:])
    null[first:, is_felt] = together * parts.units[is_felt]
    is_known = is_felt.copy()
    is_known[is_felt] &= ~np.any(np.abs(together) > SHARE, axis=0)
    return Identified(parts.covariance, null, is_known, rank)


def of_numbers(told: Identified | Decomposed, spread: Array, scale: Any) -> tuple[Array, Array]:
    """Return covariance and standard deviations of numbers, infinite for those not known.

    spread : matrix from unknowns to numbers, (…, numbers, unknowns).   scale : variance of the
    residuals, (…).
    """
    scale = np.asarray(scale)[..., None, None]
    covariance = scale * (spread @ told.covariance @ spread.swapaxes(-1, -2))
    deviations = np.sqrt(np.diagonal(covariance, axis1=-2, axis2=-1))
    sizes = np.abs(spread)
    depends = sizes > SHARE * sizes.max(axis=-1, keepdims=True, initial=0.0)
    is_open = np.any(depends & ~told.is_known[..., None, :], axis=-1)
    return covariance, np.where(is_open, np.inf, deviations)


def few_samples(samples: int, unknowns: int) -> str:
    """Return the numbers of samples and unknowns as text, for messages."""
    return f"{counted(samples, 'sample')} for {counted(unknowns, 'unknown number')}"


def _sparse(rows: Array) -> Array:
    """Eliminate between rows, with the largest entries as pivots, and clear what rounding left."""
    rows = rows.copy()
    free = list(range(len(rows)))
    while free:
        which = np.unravel_index(np.argmax(np.abs(rows[free])), rows[free].shape)
        i, j = free.pop(int(which[0])), int(which[1])
        rows[i] /= rows[i, j]
        for other in range(len(rows)):
            if other != i:
                rows[other] -= rows[other, j] * rows[i]
    rows[np.abs(rows) < SHARE] = 0.0
    return rows


def described(
    changes: Array,
    labels: Sequence[str],
    values: Array,
    units: Sequence[str],
    ending: tuple[str, str] = NEUTRAL,
) -> Direction:
    """Return a direction with its description.

    changes : of all numbers.   values : of all numbers, zero for those of starts.
    ending : of the sentences on one number or scale, and on several numbers.
    """
    one, several = ending
    weights = np.abs(changes) / np.where(values != 0.0, np.abs(values), 1.0)
    chosen = np.flatnonzero(changes)
    chosen = chosen[np.argsort(-weights[chosen], kind="stable")]
    chosen = chosen[weights[chosen] > SHARE * weights[chosen[0]]]
    changes = changes / changes[chosen[0]]
    order = sorted(chosen.tolist())
    names = [labels[i] for i in order]
    by_label = {labels[i]: float(changes[i]) for i in order}
    if len(names) == 1:
        return Direction(by_label, f"{names[0]} {one}")
    own = values[order]
    ratios = changes[order] / np.where(own != 0.0, own, np.nan)
    if np.all(np.abs(ratios / ratios[0] - 1.0) < SAME):
        owners = dict.fromkeys(name.rpartition("[")[0] or name for name in names)
        return Direction(by_label, f"the common scale of {_listed(list(owners))} {one}")
    parts = [f"{labels[i]} by {changes[i]:+.4g} {units[i]}".rstrip() for i in chosen]
    return Direction(by_label, f"{_listed(parts)} {several}")


def _listed(parts: Sequence[str]) -> str:
    """Join words; name the first ones only if there are many."""
    if len(parts) > MOST_NAMED:
        parts = [*parts[: MOST_NAMED - 1], counted(len(parts) - MOST_NAMED + 1, "other number")]
    return " and ".join(filter(None, (", ".join(parts[:-1]), parts[-1])))
