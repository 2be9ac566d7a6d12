"""Numba at its best without lierb: one loop over a block of bodies, which LLVM turns into SIMD."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numba
import numpy as np
from numba import prange

from peers import equations
from peers import heavy_top as top
from peers.heavy_top import Final, Form

FORMS = {"reduced": Form("reduced", 65536, "Numba, rows, reduced")}
BLOCK = 64  # bodies, in the L1 cache
njit = partial(numba.njit, cache=True, error_model="numpy", fastmath={"contract"})
inlined = partial(njit, forceinline=True)
turn_rates, euler_rates = inlined(equations.turn_rates), inlined(equations.euler_rates)


@inlined
def rates(y):
    w, x, y_, z, p, q, r = y
    return turn_rates(w, x, y_, z, p, q, r) + euler_rates(w, x, y_, z, p, q, r)


@inlined
def axpy(s, k, y):
    return (
        y[0] + s * k[0], y[1] + s * k[1], y[2] + s * k[2], y[3] + s * k[3],
        y[4] + s * k[4], y[5] + s * k[5], y[6] + s * k[6],
    )  # fmt: skip


@inlined
def rk4_step(y, h):
    k1 = rates(y)
    k2 = rates(axpy(h / 2, k1, y))
    k3 = rates(axpy(h / 2, k2, y))
    k4 = rates(axpy(h, k3, y))
    return axpy(h / 6, k4, axpy(h / 3, k3, axpy(h / 3, k2, axpy(h / 6, k1, y))))


@njit(parallel=True)
def solve(initial, h, steps):
    """(blocks, 7, BLOCK)."""
    final = np.empty_like(initial)
    for b in prange(len(initial)):
        block = initial[b].copy()
        for _ in range(steps):
            for i in range(BLOCK):
                (
                    block[0, i], block[1, i], block[2, i], block[3, i],
                    block[4, i], block[5, i], block[6, i],
                ) = rk4_step(
                    (
                        block[0, i], block[1, i], block[2, i], block[3, i],
                        block[4, i], block[5, i], block[6, i],
                    ), h,
                )  # fmt: skip
        final[b] = block
    return final


def available() -> str:
    return ""


def config() -> dict[str, object]:
    return {"numba": numba.__version__, "block": BLOCK}


def run(form: str, omega0: np.ndarray, accuracy: float, threads: int) -> Callable[[], Final]:
    numba.set_num_threads(threads)
    padded = np.resize(omega0, (-(-len(omega0) // BLOCK) * BLOCK, 3))
    initial = np.ascontiguousarray(
        equations.reduced_start(padded).reshape(7, -1, BLOCK).transpose(1, 0, 2)
    )
    steps = round(top.T_END / accuracy)

    def integrate() -> Final:
        states = solve(initial, top.T_END / steps, steps).transpose(1, 0, 2).reshape(7, -1)
        return equations.reduced_final(states[:, : len(omega0)])

    return integrate
