"""Diffrax: the reduced equations on components, mapped over the bodies in chunks by JAX.

In an adaptive chunk every top takes steps of its own size, but as many as the slowest one.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib.metadata import version
from importlib.util import find_spec

import numpy as np

from peers import equations as eq
from peers import heavy_top as top
from peers.heavy_top import Final, Form
from peers.jax_vmap import FLAGS, over_bodies, start_jax

FORMS = {
    "reduced-tsit5": Form("reduced", 1024, "Diffrax, reduced, Tsit5, fixed steps"),
    "reduced-dopri8": Form(
        "reduced", 8192, "Diffrax, reduced, Dopri8", adaptive=True, accuracy=1e-8,
        accuracies=(1e-5, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11, 1e-12, 1e-13),
    ),
}  # fmt: skip
CHUNK = 256
ATOL_PER_RTOL = 1.0  # of a quaternion and of ω, which are of order one


def available() -> str:
    return "" if find_spec("diffrax") else "diffrax is not installed"


def config() -> dict[str, object]:
    return {
        "diffrax": version("diffrax"), "jax": version("jax"), "XLA_FLAGS": FLAGS, "chunk": CHUNK,
        "atol / rtol": ATOL_PER_RTOL,
    }  # fmt: skip


def run(form: str, omega0: np.ndarray, accuracy: float, threads: int) -> Callable[[], Final]:
    jax = start_jax(threads)
    import diffrax

    adaptive = FORMS[form].adaptive
    term = diffrax.ODETerm(lambda t, state, _: eq.reduced_rates(*state))

    def solve(state):
        return diffrax.diffeqsolve(
            term,
            diffrax.Dopri8() if adaptive else diffrax.Tsit5(),
            t0=0.0,
            t1=top.T_END,
            dt0=None if adaptive else top.T_END / round(top.T_END / accuracy),
            y0=state,
            stepsize_controller=diffrax.PIDController(accuracy, ATOL_PER_RTOL * accuracy)
            if adaptive
            else diffrax.ConstantStepSize(),
            adjoint=diffrax.ForwardMode(),  # no checkpoints
            max_steps=None,
            throw=False,
        )

    initial = tuple(eq.reduced_start(omega0))
    compiled = over_bodies(lambda state: tuple(y[0] for y in solve(state).ys), CHUNK)
    return lambda: eq.reduced_final(np.array(jax.device_get(compiled(initial))))
