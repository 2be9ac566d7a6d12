"""Compute points of a scrambled Sobol sequence, from any number on."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lierb.errors import ArgumentError
from lierb.sampling.streams import UNIFORM_BITS, uniforms_of, words
from lierb.support.arrays import Array
from lierb.support.extras import require

SOBOL_BITS = 32  # limit of SciPy's Sobol.fast_forward; the other digits are random
WALKED_BITS = 12  # bits of a point's number up to which SciPy's points are compared with its table


@dataclass(frozen=True)
class Sobol:
    """The Sobol sequence is scrambled by a seed.

    size : number of points, up to 2³².   coordinates : of each point.
    """

    seed: int
    size: int
    coordinates: int

    def points(self, first: int, count: int) -> Array:
        """Points first, …, first + count − 1, (count, coordinates).

        Point i is point i − 1 with one direction added, bit by bit.
        """
        origin, directions = self._directions
        gray = first ^ first >> 1
        start = origin.copy()
        for bit, direction in enumerate(directions):
            if gray >> bit & 1:
                start ^= direction
        later = np.arange(first + 1, first + count, dtype=np.uint64)
        trailing_zeros = np.bitwise_count(~later & (later - np.uint64(1)))
        steps = np.concatenate((start[None], directions[trailing_zeros]))
        leading = np.bitwise_xor.accumulate(steps, axis=0)
        added = UNIFORM_BITS - SOBOL_BITS
        trailing = words(self.seed, "", first, count, self.coordinates) >> 64 - added
        return uniforms_of(leading << added | trailing)

    @cached_property
    def _directions(self) -> tuple[NDArray[np.uint64], NDArray[np.uint64]]:
        """Return the first point, (d,), and the directions, (bits of size − 1, d).

        In the Gray code of 2ᵏ bits k and k − 1 are set, so point 2ᵏ is point 0 with directions k
        and k − 1 added. SciPy walks there from point to point, at 2 to 7 ns each: half a minute to
        the last one. Its own table is used where it agrees with its points.
        """
        require("scipy")
        from scipy.stats import qmc

        most = qmc.Sobol.MAXDIM
        if self.coordinates > most:
            raise ArgumentError(f"the draws take {self.coordinates} uniforms; Sobol has {most}")
        rng = np.random.default_rng(self.seed)
        engine = qmc.Sobol(self.coordinates, bits=SOBOL_BITS, rng=rng)
        points = [engine.random(1)]
        bits = (self.size - 1).bit_length()
        for bit in range(bits):
            if bit == WALKED_BITS:
                first, walked = _directions_between(points)
                table = np.asarray(getattr(engine, "_sv", np.empty((0, 0)))).T.astype(np.uint64)
                if len(table) >= bits and np.array_equal(table[:bit], walked):
                    return first, table[:bits]
            engine.fast_forward(2**bit - engine.num_generated)
            points.append(engine.random(1))
        return _directions_between(points)


def _directions_between(points: list[Array]) -> tuple[NDArray[np.uint64], NDArray[np.uint64]]:
    """Return point 0, and the directions that lead to points 1, 2, 4, 8, …"""
    numbers = (np.concatenate(points) * 2.0**SOBOL_BITS).astype(np.uint64)
    return numbers[0], np.bitwise_xor.accumulate(numbers[1:] ^ numbers[0], axis=0)
