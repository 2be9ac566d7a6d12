"""Numba as first written: a loop over the bodies, small arrays, linalg.solve in every stage."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from importlib.util import find_spec

import numba
import numpy as np
from numba import prange

from peers import equations
from peers import heavy_top as top
from peers.heavy_top import Final, Form

FORMS = {"general": Form("general", 128, "Numba, small arrays, linalg.solve")}
njit = partial(numba.njit, cache=True)
MASS, INERTIA, CENTRE, GRAVITY = top.MASS, top.INERTIA, top.CENTRE, top.GRAVITY
matrix, turn_rates = njit(equations.matrix), njit(equations.turn_rates)


@njit
def cross(a, b):
    return np.array(
        (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])
    )


@njit
def skew(a):
    return np.array(((0.0, -a[2], a[1]), (a[2], 0.0, -a[0]), (-a[1], a[0], 0.0)))


@njit
def rates(state):
    """Quaternion, place, ω, velocity; J = [R ĉ | I] on (ω, ṙ)."""
    w, x, y, z, _, _, _, p, q, r = state[:10]
    omega = state[7:10]
    turn = np.array(matrix(w, x, y, z))
    jacobian = np.hstack((turn @ skew(CENTRE), np.eye(3)))
    saddle = np.zeros((9, 9))
    saddle[:6, :6] = np.diag(np.append(INERTIA, np.full(3, MASS)))
    saddle[:6, 6:] = jacobian.T
    saddle[6:, :6] = jacobian
    right = np.empty(9)
    right[:3] = cross(INERTIA * omega, omega)
    right[3:6] = MASS * GRAVITY
    right[6:] = turn @ cross(omega, cross(omega, CENTRE))
    rate = np.empty(13)
    rate[:4] = turn_rates(w, x, y, z, p, q, r)
    rate[4:7] = state[10:]
    rate[7:] = np.linalg.solve(saddle, right)[:6]
    return rate


@njit(parallel=True)
def solve(initial, h, steps):
    final = np.empty_like(initial)
    for i in prange(len(initial)):
        y = initial[i]
        for _ in range(steps):
            k1 = rates(y)
            k2 = rates(y + h / 2 * k1)
            k3 = rates(y + h / 2 * k2)
            k4 = rates(y + h * k3)
            y = y + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        final[i] = y
    return final


def available() -> str:
    return "" if find_spec("scipy") else "scipy, which has Numba's LAPACK, is not installed"


def config() -> dict[str, object]:
    return {"numba": numba.__version__}


def run(form: str, omega0: np.ndarray, accuracy: float, threads: int) -> Callable[[], Final]:
    numba.set_num_threads(threads)
    initial = np.ascontiguousarray(equations.general_start(omega0).T)
    steps = round(top.T_END / accuracy)
    return lambda: equations.general_final(solve(initial, top.T_END / steps, steps).T)
