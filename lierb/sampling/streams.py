"""Draw streams of random words and uniforms, by seed, name and number."""

from __future__ import annotations

from hashlib import blake2b

import numpy as np
from numpy.typing import NDArray

from lierb.support.arrays import Array

SEED_BITS = 64
UNIFORM_BITS = 52  # with the half that is added, the 53 of a double


def words(seed: int, name: str, first: int, count: int, each: int) -> NDArray[np.uint64]:
    """Random words of 64 bits of the bodies from `first` on, (count, each), of one stream.

    Philox turns a counter into four words, by a bijection that its key chooses (J. K. Salmon et
    al., Parallel random numbers: as easy as 1, 2, 3, SC11). Word w of body b is number b·each + w.
    """
    digest = blake2b(name.encode(), digest_size=16, key=seed.to_bytes(SEED_BITS // 8, "little"))
    stream = np.random.Philox(key=int.from_bytes(digest.digest(), "little"))
    counter, skipped = divmod(first * each, 4)
    stream.advance(counter)
    return stream.random_raw(skipped + count * each)[skipped:].reshape(count, each)


def uniforms_of(numbers: NDArray[np.integer]) -> Array:
    """Return uniforms (k + ½)/2⁵² of whole numbers k < 2⁵²: exact, symmetric, never 0 or 1."""
    return (numbers.astype(np.float64) + 0.5) * 2.0**-UNIFORM_BITS
