"""Current speed of this core: fused multiply–adds that depend only on themselves.

A machine that is shared runs at another speed from minute to minute. Rates are compared between
runs only after division by this one, measured beside each of them.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from numba import njit

from lierb.compiler.code import OPTIONS, compiled
from lierb.compiler.tags import Tag
from lierb.kernels.numbers.arithmetic import fma, load, store
from lierb.kernels.tracing.cpu import DEFAULT_LANES
from lierb.kernels.tracing.trace import kernel

CHAINS = 12  # enough to hide the latency of two units; with the operands, they fit 16 registers
TURNS = 200_000


@dataclass(frozen=True)
class Calibration(Tag):
    """Chains of multiply–adds on packs of `lanes` numbers."""

    lanes: int


def begin(tag, numbers):
    return tuple(load(numbers, (0, c * tag.lanes), tag.lanes) for c in range(CHAINS))


def turn(tag, chains, factor, shift):
    return tuple(fma(factor, chain, shift) for chain in chains)


def finish(tag, chains, numbers):
    for c, chain in enumerate(chains):
        store(numbers, (0, c * tag.lanes), chain, tag.lanes)


for _formula in (begin, turn, finish):
    kernel(_formula)


@njit(cache=True, **OPTIONS)
def churn(tag, numbers, turns, factor, shift):
    chains = begin(tag, numbers)
    for _ in range(turns):
        chains = turn(tag, chains, factor, shift)
    finish(tag, chains, numbers)


def peak_gflops(seconds: float = 0.03) -> float:
    """The best rate of one core within about so many seconds, GFLOP/s in double precision."""
    tag = Calibration(DEFAULT_LANES)
    numbers = np.ones((1, CHAINS * DEFAULT_LANES))
    arguments = (numbers, TURNS, 0.75, 0.25)
    run = compiled(churn, tag, *arguments)
    best, end = np.inf, time.perf_counter() + seconds
    while time.perf_counter() < end:
        began = time.perf_counter()
        run(tag, *arguments)
        best = min(best, time.perf_counter() - began)
    return 2e-9 * CHAINS * DEFAULT_LANES * TURNS / best


@njit(cache=True, **OPTIONS)
def _chain(turns: int, mask: int) -> int:
    x = 1
    for i in range(turns):
        x = (x + i) ^ mask  # two cycles, each waiting for the one before
    return x


def clock_ghz() -> float:
    """The core's clock, from a chain of dependent integer operations of one cycle each."""
    turns, best = 2_000_000, np.inf
    _chain(1, 5)
    for _ in range(5):
        began = time.perf_counter()
        _chain(turns, 5)
        best = min(best, time.perf_counter() - began)
    return 2e-9 * turns / best
