"""heyoka: Taylor's method of high order on lanes, on the reduced equations.

All lanes of a batch step until the slowest is done: tops are brought together that turn about
equally fast, which makes velocities of all sizes up to twice as fast. Measured beside it and
slower: 4 and 16 lanes, one top at a time, and heyoka's own ensembles, which copy the integrator.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib.util import find_spec

import numpy as np

from peers import equations as eq
from peers import heavy_top as top
from peers.heavy_top import Final, Form

ACCURACIES = (1e-5, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11, 1e-12, 1e-13, 1e-15)
FORMS = {
    "reduced": Form(
        "reduced", 32768, "heyoka, reduced, Taylor", adaptive=True, accuracy=1e-8,
        accuracies=ACCURACIES, threads=(1,),
    ),
    "reduced-as-they-come": Form(
        "reduced", 32768, "heyoka, reduced, Taylor, tops in any order", adaptive=True,
        accuracy=1e-8, accuracies=(), threads=(1,),
    ),
}  # fmt: skip


def available() -> str:
    return "" if find_spec("heyoka") else "heyoka is not installed"


def config() -> dict[str, object]:
    import heyoka

    return {"heyoka": heyoka.__version__, "lanes": heyoka.recommended_simd_size()}


def run(form: str, omega0: np.ndarray, accuracy: float, threads: int) -> Callable[[], Final]:
    import heyoka as hy

    lanes, count = hy.recommended_simd_size(), len(omega0)
    variables = hy.make_vars("w", "x", "y", "z", "p", "q", "r")
    integrator = hy.taylor_adaptive_batch(
        list(zip(variables, eq.reduced_rates(*variables), strict=True)), np.zeros((7, lanes)),
        tol=accuracy, high_accuracy=False, compact_mode=False, fast_math=True,
    )  # fmt: skip
    initial = eq.reduced_start(omega0)

    def integrate() -> Final:
        order = np.arange(count)
        if form == "reduced":
            order = np.argsort(np.linalg.norm(omega0, axis=1), kind="stable")
        order = np.pad(order, (0, -count % lanes), mode="edge")
        start = np.ascontiguousarray(initial[:, order])
        found = np.empty_like(start)
        for i in range(0, start.shape[1], lanes):
            here = slice(i, i + lanes)
            integrator.set_time(0.0)
            integrator.state[:] = start[:, here]
            integrator.propagate_until(top.T_END)
            found[:, here] = integrator.state
        final = np.empty_like(initial)
        final[:, order] = found
        return eq.reduced_final(final)

    return integrate
