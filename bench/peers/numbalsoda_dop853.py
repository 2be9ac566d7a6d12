"""numbalsoda: Hairer's DOP853 in Fortran on the reduced equations, each top with steps of its own.

Built from source, `pip install numbalsoda` needs gfortran and CMake.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib.metadata import version
from importlib.util import find_spec

import numpy as np

from peers import equations
from peers import heavy_top as top
from peers.heavy_top import Final, Form

FORMS = {
    "reduced": Form(
        "reduced", 32768, "numbalsoda, reduced, DOP853", adaptive=True, accuracy=1e-8,
        accuracies=(1e-5, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11, 1e-12, 1e-13),
    )
}  # fmt: skip
ATOL_PER_RTOL = 1.0  # of a quaternion and of ω, which are of order one


def available() -> str:
    return "" if find_spec("numbalsoda") else "numbalsoda is not installed"


def config() -> dict[str, object]:
    return {"numbalsoda": version("numbalsoda"), "atol / rtol": ATOL_PER_RTOL}


def run(form: str, omega0: np.ndarray, accuracy: float, threads: int) -> Callable[[], Final]:
    import numba
    from numba import cfunc, njit, prange
    from numbalsoda import dop853, lsoda_sig

    numba.set_num_threads(threads)
    inlined = njit(forceinline=True)
    turn_rates, euler_rates = inlined(equations.turn_rates), inlined(equations.euler_rates)

    @cfunc(lsoda_sig)
    def rates(t, s, rate, data):
        w, x, y, z, p, q, r = s[0], s[1], s[2], s[3], s[4], s[5], s[6]
        rate[0], rate[1], rate[2], rate[3] = turn_rates(w, x, y, z, p, q, r)
        rate[4], rate[5], rate[6] = euler_rates(w, x, y, z, p, q, r)

    address = rates.address
    times = np.array((0.0, top.T_END))
    data = np.zeros(1)
    initial = np.ascontiguousarray(equations.reduced_start(omega0).T)

    @njit(parallel=True)
    def solve(initial, final, rtol):
        done = 0
        for i in prange(len(initial)):
            states, good = dop853(address, initial[i], times, data, rtol, ATOL_PER_RTOL * rtol)
            final[i] = states[1]
            done += good
        return done

    def integrate() -> Final:
        final = np.empty_like(initial)
        if solve(initial, final, accuracy) < len(initial):
            raise RuntimeError("DOP853 failed")
        return equations.reduced_final(final.T)

    return integrate
