"""The practical limit on this CPU: the double pendulum in C++ on SIMD lanes (pendulum.cpp).

`chain2-bodies` is what lierb's reduced c-space integrates: links in their joints' axes, forces from
body to body. `chain2-series` is what only this one mechanism has: Lagrange's equations worked out,
mass matrix and potential as Fourier series in the angles.
"""

from __future__ import annotations

import ctypes
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from peers import cpp as compiler

from linkages import cases
from linkages.cases import Form, Tree

FORMS = {
    "chain2-bodies": Form("chain2", "C++, body by body, RK4", 16384),
    "chain2-series": Form("chain2", "C++, Lagrange's equations as series, RK4", 65536),
}
SOURCE = Path(__file__).with_name("pendulum.cpp")
EXTRA = {"chain2-bodies": [], "chain2-series": []}
_settings: dict[str, tuple[int, int]] = {}  # lanes and blocks side by side, of each form that ran


def available() -> str:
    return compiler.available()


def config() -> dict[str, object]:
    return {**compiler.config(), "lanes and blocks": dict(_settings)}


def run(form: str, tree: Tree) -> Callable[[], np.ndarray]:
    few = tree.first(1024)
    widths = (4, 8) if "__AVX512F__" in compiler.target() else (4,)
    kinds = [(w, g) for w in widths for g in (1, 2, 4, 8)]
    taken = {kind: _duration(_integrator(form, few, *kind)) for kind in kinds}
    _settings[form] = min(taken, key=taken.get)
    return _integrator(form, tree, *_settings[form])


def _integrator(form: str, tree: Tree, lanes: int, group: int) -> Callable[[], np.ndarray]:
    count, kind = len(tree), form.partition("-")[2]
    padded = lambda rows: np.pad(rows, ((0, 0), (0, -count % lanes)), mode="edge").copy()
    numbers = padded(cases.harmonics(tree) if kind == "series" else _bodies(tree))
    turns = np.stack([np.cos(tree.q0), np.sin(tree.q0)], axis=-1).reshape(count, 4)
    start = padded(np.concatenate([turns, tree.v0], axis=-1).T)
    library = compiler.library(SOURCE, lanes, ("-UGROUP", f"-DGROUP={group}", *EXTRA[form]))
    kernel, steps = getattr(library, kind), round(cases.T_END / cases.DT)
    kernel.restype = None

    def integrate() -> np.ndarray:
        out = np.empty_like(start)
        pointers = (ctypes.c_void_p(a.ctypes.data) for a in (numbers, start, out))
        kernel(
            *pointers, ctypes.c_long(out.shape[1]), ctypes.c_long(steps), ctypes.c_double(cases.DT)
        )
        checked = out[:, : min(count, cases.CHECKED)]
        q = np.arctan2(checked[[1, 3]], checked[[0, 2]]).T
        return cases.positions(tree.first(len(q)), q)

    return integrate


def _bodies(tree: Tree) -> np.ndarray:
    """(35, n): the members of `Bodies` in pendulum.cpp."""
    ground, second = tree.frames[:, 0, :3, :3], tree.frames[:, 1]
    E, p = second[:, :3, :3], second[:, :3, 3]
    e3 = np.broadcast_to(np.eye(3)[2], p.shape)
    back = lambda a: np.einsum("nji,nj->ni", E, a)
    u = back(np.cross(e3, p))
    c = tree.com
    squares = np.einsum("nki,nki->nk", c, c)[..., None, None] * np.eye(3)
    steiner = squares - np.einsum("nki,nkj->nkij", c, c)
    J = tree.inertia + tree.mass[..., None, None] * steiner
    moment = tree.mass[..., None] * c
    g = np.einsum("nji,j->ni", ground, cases.GRAVITY)
    t = back(np.cross(e3, np.cross(e3, p)))
    rows, columns = (0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)
    parts = (
        g, moment[:, 0], J[:, 0, 2:, 2], back(e3), u, t,
        E.transpose(0, 2, 1).reshape(-1, 9), tree.mass[:, 1:], moment[:, 1],
        J[:, 1][:, rows, columns],
    )  # fmt: skip
    return np.concatenate(parts, axis=-1).T


def _duration(integrate: Callable[[], np.ndarray]) -> float:
    def once() -> float:
        start = time.process_time()
        integrate()
        return time.process_time() - start

    return min(once() for _ in range(5))
