"""SciPy: solve_ivp with DOP853 on the reduced equations, one top at a time."""

from __future__ import annotations

from collections.abc import Callable
from importlib.metadata import version
from importlib.util import find_spec

import numpy as np

from peers import equations as eq
from peers import heavy_top as top
from peers.heavy_top import Final, Form

FORMS = {
    "reduced": Form(
        "reduced", 64, "SciPy, reduced, DOP853", adaptive=True, accuracy=1e-8,
        accuracies=(1e-5, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11, 1e-12, 1e-13), threads=(1,),
    )
}  # fmt: skip


def available() -> str:
    return "" if find_spec("scipy") else "scipy is not installed"


def config() -> dict[str, object]:
    return {"scipy": version("scipy"), "atol / rtol": 1.0}


def run(form: str, omega0: np.ndarray, accuracy: float, threads: int) -> Callable[[], Final]:
    from scipy.integrate import solve_ivp

    initial = eq.reduced_start(omega0).T

    def solve(y):
        rates = lambda t, state: eq.reduced_rates(*state.tolist())  # plain floats: twice as fast
        end = (0, top.T_END)
        return solve_ivp(rates, end, y, "DOP853", rtol=accuracy, atol=accuracy).y[:, -1]

    return lambda: eq.reduced_final(np.array([solve(y) for y in initial]).T)
