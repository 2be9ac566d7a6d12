"""Levenberg–Marquardt steps of many least-squares problems at once, from triangular factors.

The residuals r and the Jacobian J of a problem are as good as the factor R of [J r] = QR, which has
as many rows as columns. A step minimises ‖J δ + r‖². If it is longer than a radius, relative to the
scales of the unknowns, it minimises ‖J δ + r‖² + λ ‖δ‖² with the λ by which it is as long as the
radius (Moré, The Levenberg–Marquardt algorithm, 1978).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lierb.analysis.identifiability import decomposed
from lierb.support.arrays import Array

CLOSE = 1e-3  # offset from a minimum, in standard deviations of the residuals, that counts as none
CLOSE_ROUNDING = 1e-9  # the same relative to the response
BLOCK = 4096  # numbers of a block of rows; larger ones occupy threads of BLAS, which takes longer
PULL = 1e-8  # weight of the point, relative to the data's: directions that these do not tell stay
HALVINGS = 40  # of the interval of log λ
WIDEST = 46.0  # its length
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

    def are_close(self, deviation: Array) -> NDArray[np.bool_]:
        """Return True for problems near a minimum.   deviation : of the residuals, [problem]."""
        most = np.maximum(CLOSE * deviation, CLOSE_ROUNDING * self.response)
        return np.asarray(self.offset <= most)


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
    weights = -along / np.where(parts.is_told, parts.values, 1.0)
    change = (weights[..., None, :] @ parts.rows)[..., 0, :] * parts.units
    is_limited = np.linalg.norm(change / scales, axis=-1) > radius
    if is_limited.any():
        change[is_limited] = _of_length(factors[is_limited], scales[is_limited], radius[is_limited])
    effect = (jacobians @ change[..., None])[..., 0]
    return Steps(
        change, np.linalg.norm(change / scales, axis=-1),
        -np.sum(effect * (2.0 * residuals + effect), axis=-1), is_limited,
        np.linalg.norm(along, axis=-1),
        np.linalg.norm(jacobians * scales[:, None, :], axis=-2).max(axis=-1, initial=0.0),
        parts.rank,
    )  # fmt: skip


def _of_length(factors: Array, scales: Array, radius: Array) -> Array:
    """Return damped steps as long as the radius."""
    jacobians, residuals = factors[..., :-1] * scales[:, None, :], factors[..., -1]
    norms = np.linalg.norm(jacobians, axis=-2)
    pull = PULL * norms[..., None] * np.eye(norms.shape[-1])
    left, values, rows = np.linalg.svd(np.concatenate([jacobians, pull], -2), full_matrices=False)
    gradient = values * (residuals[:, None, :] @ left[:, : residuals.shape[-1]])[:, 0]
    high = np.log(np.linalg.norm(gradient, axis=-1) / radius)  # ‖δ‖ is less than ‖gradient‖/λ
    low = high - WIDEST
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        length = np.linalg.norm(gradient / (values**2 + np.exp(middle)[:, None]), axis=-1)
        is_long = length > radius
        low, high = np.where(is_long, middle, low), np.where(is_long, high, middle)
    weights = -gradient / (values**2 + np.exp(high)[:, None])
    return np.asarray((weights[:, None, :] @ rows)[:, 0] * scales)


def next_radius(radius: Array, steps: Steps, decrease: Array) -> Array:
    """Return the radius after trials.   decrease : of the sums of squares; −∞ for failed runs."""
    bad = decrease < BAD * steps.predicted
    wider = (decrease > GOOD * steps.predicted) & steps.is_limited
    return np.where(bad, BAD * steps.length, np.where(wider, 2.0 * radius, radius))
