"""Find the combinations of unknowns that data cannot tell, and describe them by name."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

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


def identified(jacobian: Array, sizes: Array) -> Identified:
    """Decompose a Jacobian by singular values.

    jacobian : (residuals, unknowns).   sizes : typical size of each unknown.
    """
    scaled = jacobian * sizes
    norms = np.linalg.norm(scaled, axis=0)
    is_felt = norms > NO_EFFECT * norms.max(initial=0.0)
    count = len(sizes)
    units = sizes[is_felt] / norms[is_felt]
    _, values, rows = np.linalg.svd(scaled[:, is_felt] / norms[is_felt], full_matrices=False)
    rank = int(np.sum(values > NO_DIFFERENCE * values.max(initial=0.0)))
    covariance = np.zeros((count, count))
    half = units[:, None] * rows[:rank].T / values[:rank]
    covariance[np.ix_(is_felt, is_felt)] = half @ half.T
    null = np.zeros((count - rank, count))
    first = count - int(is_felt.sum())
    null[range(first), np.flatnonzero(~is_felt)] = sizes[~is_felt]
    together = _sparse(_complement(rows[:rank]))
    null[first:, is_felt] = together * units
    is_known = is_felt.copy()
    is_known[is_felt] &= ~np.any(np.abs(together) > SHARE, axis=0)
    return Identified(covariance, null, is_known, rank)


def _complement(rows: Array) -> Array:
    """Return an orthonormal basis of the vectors that are orthogonal to orthonormal rows."""
    _, _, all_rows = np.linalg.svd(rows, full_matrices=True)
    return all_rows[len(rows) :]


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
    changes: Array, labels: Sequence[str], values: Array, units: Sequence[str]
) -> Direction:
    """Return a direction with its description.

    changes : of all numbers.   values : of all numbers, zero for those of starts.
    """
    weights = np.abs(changes) / np.where(values != 0.0, np.abs(values), 1.0)
    chosen = np.flatnonzero(np.abs(changes) > 0.0)
    chosen = chosen[np.argsort(-weights[chosen], kind="stable")] if len(chosen) else chosen
    chosen = chosen[weights[chosen] > SHARE * weights[chosen[:1]].max(initial=0.0)]
    changes = changes / changes[chosen[0]]
    order = sorted(chosen.tolist())
    names = [labels[i] for i in order]
    by_label = {labels[i]: float(changes[i]) for i in order}
    if len(names) == 1:
        return Direction(by_label, f"{names[0]} has no effect")
    own = values[order]
    ratios = changes[order] / np.where(own != 0.0, own, np.nan)
    if np.all(np.abs(ratios / ratios[0] - 1.0) < SAME):
        owners = dict.fromkeys(name.rpartition("[")[0] or name for name in names)
        return Direction(by_label, f"the common scale of {_listed(list(owners))} has no effect")
    parts = [f"{labels[i]} by {changes[i]:+.4g} {units[i]}".rstrip() for i in chosen]
    return Direction(by_label, f"{_listed(parts)} together have no effect")


def _listed(parts: Sequence[str]) -> str:
    """Join words; name the first ones only if there are many."""
    if len(parts) > MOST_NAMED:
        parts = [*parts[: MOST_NAMED - 1], counted(len(parts) - MOST_NAMED + 1, "other number")]
    return " and ".join(filter(None, (", ".join(parts[:-1]), parts[-1])))
