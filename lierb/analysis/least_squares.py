"""Levenberg–Marquardt steps of many least-squares problems at once, from triangular factors.

The residuals r and the Jacobian J of a problem are as good as the factor R of [J r] = QR, which has
as many rows as columns. A step minimises ‖J δ + r‖² + λ ‖δ‖² in units of the unknowns, in which the
columns of J have length 1. λ is the least one with which the step stays within a radius (Moré, The
Levenberg–Marquardt algorithm, 1978, by powers of 4).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lierb.analysis.identifiability import Decomposed, decomposed
from lierb.support.arrays import Array

BLOCK = 4096  # numbers of a block of rows; larger ones occupy threads of BLAS, which takes longer
LEAST_DAMPING = 1e-12
MOST_RAISES = 40  # of the damping; 4⁴⁰ times the least one
GOOD, BAD = 0.75, 0.25  # decrease over prediction, beyond which the radius changes


class Steps(NamedTuple):
    """Steps of problems, all arrays [problem].

    change : of the unknowns, [problem][unknown].   length : relative to the scales.
    predicted : decrease of the sum of squares by linear theory.
    is_limited : True if the radius limits the step.
    offset : length of the residuals' part that an unlimited step would remove.
    response : largest change of the residuals by a change of one unknown by its size.
    rank : number of directions told.
    """

    change: Array
    length: Array
    predicted: Array
    is_limited: NDArray[np.bool_]
    offset: Array
    response: Array
    rank: NDArray[np.int64]

    def part(self, which: NDArray[Any]) -> Steps:
        return Steps(*(each[which] for each in self))


def triangular(rows: Array) -> Array:
    """Return the factors R of matrices, (…, k, k), with rows of zeros if they have fewer than k.

    rows : (…, m, k).
    """
    *lead, count, k = rows.shape
    rows = rows.reshape(-1, count, k)
    size = max(2 * k, BLOCK // k)
    while True:
        blocks = -(-rows.shape[1] // size)
        missing = blocks * size - rows.shape[1] if blocks > 1 else max(k - rows.shape[1], 0)
        if missing:
            rows = np.pad(rows, ((0, 0), (0, missing), (0, 0)))
        parts = rows.reshape(len(rows) * blocks, -1, k)
        factors: Any = np.linalg.qr(parts, mode="r")
        rows = factors.reshape(len(rows), blocks * k, k)
        if blocks == 1:
            return np.asarray(rows.reshape(*lead, k, k))


def steps_of(factors: Array, scales: Array, radius: Array) -> Steps:
    """Return the step of each problem.

    factors : R of [J r], [problem][row][unknown, then 1].
    scales : typical size of each unknown, [problem][unknown].
    radius : greatest length of each step relative to the scales.
    """
    jacobians, residuals = factors[..., :-1], factors[..., -1]
    parts = decomposed(jacobians, scales)
    along = np.where(parts.is_told, (residuals[..., None, :] @ parts.left)[..., 0, :], 0.0)
    damping = np.full(len(factors), LEAST_DAMPING)
    change, length = _damped(parts, along, damping, scales)
    is_limited = length > radius
    for _ in range(MOST_RAISES):
        long = np.flatnonzero(length > radius)
        if not long.size:
            break
        damping[long] *= 4.0
        some = parts.part(long)
        change[long], length[long] = _damped(some, along[long], damping[long], scales[long])
    left = damping[:, None] / (parts.values**2 + damping[:, None])
    return Steps(
        change, length, np.sum(along**2 * (1.0 - left**2), axis=-1), is_limited,
        np.linalg.norm(along, axis=-1),
        np.linalg.norm(jacobians * scales[:, None, :], axis=-2).max(axis=-1, initial=0.0),
        parts.rank,
    )  # fmt: skip


def _damped(parts: Decomposed, along: Array, damping: Array, scales: Array) -> tuple[Array, Array]:
    """Return the steps with a damping, and their lengths.   along : Uᵀr of directions told."""
    size = parts.values.shape[-1]
    weights = -along * parts.values / (parts.values**2 + damping[:, None])
    change = (weights[..., None, :] @ parts.rows[..., :size, :])[..., 0, :] * parts.units
    return change, np.linalg.norm(change / scales, axis=-1)


def next_radius(radius: Array, steps: Steps, decrease: Array) -> Array:
    """Return the radius after trials.   decrease : of the sums of squares; −∞ for failed runs."""
    bad = decrease < BAD * steps.predicted
    wider = (decrease > GOOD * steps.predicted) & steps.is_limited
    return np.where(bad, BAD * steps.length, np.where(wider, 2.0 * radius, radius))
