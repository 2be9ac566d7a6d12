"""The two batches, and how far a result is from where the tops are."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from peers import heavy_top as top
from peers.heavy_top import Final

COUNT = 512  # different tops; a timed call has them several times over
SIGMA = 1.0  # of the logarithm of the velocities' factors
REFERENCE = Path(__file__).with_name("reference.npz")
BATCHES = ("lognormal", "one")


def samples(batch: str) -> np.ndarray:
    """(COUNT, 3) rad/s, body axes."""
    if batch == "one":
        return np.tile(top.OMEGA, (COUNT, 1))
    factors = np.exp(SIGMA * np.random.default_rng(top.SEED + 1).standard_normal(COUNT))
    return top.samples(COUNT) * factors[:, None]


class Errors(NamedTuple):
    """Distances of centres of mass from the reference, m."""

    largest: float
    median: float


def errors(batch: str, final: Final) -> Errors:
    """Errors of the first COUNT tops."""
    with np.load(REFERENCE) as stored:
        centre = stored[batch]
    off = np.linalg.norm(final.centre[:COUNT] - centre, axis=1)
    return Errors(float(off.max()), float(np.median(off)))
