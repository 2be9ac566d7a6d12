"""Commutator-free and Crouch–Grossman methods have their order on groups, in a loop of the test's.

Ċ = C V̂ with body-fixed twists V, so the exponentials multiply from the right. The reference is
SciPy's DOP853 on matrices, which knows nothing of groups.
"""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from lierb.methods import TABLEAUS

METHODS = {name: tableau for name, tableau in TABLEAUS.items() if tableau.exponentials}
T_END = 1.0


def cross_matrix(w):
    return np.array(((0.0, -w[2], w[1]), (w[2], 0.0, -w[0]), (-w[1], w[0], 0.0)))


class Turning:
    """Motion on SO(3): an asymmetric body in a field that turns with time. Ṽ = f(C, V, t)."""

    pose0 = expm(cross_matrix((0.3, -0.2, 0.5)))
    twist0 = np.array((1.2, -0.7, 0.9))
    hat = staticmethod(cross_matrix)
    inertia = np.array((1.0, 1.7, 2.6))

    def rate(self, C, V, t):
        field = np.array((math.sin(2 * t), 0.5, math.cos(t)))
        return (
            np.cross(self.inertia * V, V) + np.cross((0.4, -1.1, 0.8), C.T @ field)
        ) / self.inertia


class Flying:
    """Motion on SE(3): the velocity couples with the position."""

    pose0 = np.eye(4)
    twist0 = np.array((1.2, -0.7, 0.9, 0.4, 0.3, -0.6))
    turning = Turning()

    @staticmethod
    def hat(V):
        return np.block([[cross_matrix(V[:3]), V[3:, None]], [np.zeros((1, 4))]])

    def rate(self, C, V, t):
        R, r, omega, v = C[:3, :3], C[:3, 3], V[:3], V[3:]
        turned = self.turning.rate(R, omega, t) + 0.3 * np.cross(r, v)
        return np.array((*turned, *(np.cross(v, omega) - R.T @ (r + np.array((0.0, t, 0.2))))))


class Guided:
    """Motion on SE(3): V = F(C, t), no velocity equation."""

    pose0 = Flying.pose0
    twist0 = np.zeros(0)
    hat = staticmethod(lambda V: Flying.hat(V))

    def rate(self, C, V, t):
        return V

    def twist(self, C, V, t):
        R, r = C[:3, :3], C[:3, 3]
        return np.array((*(R.T @ (1.0, math.sin(3 * t), r[0])), *(R[2] - 0.5 * r)))


OTHERS = [Turning(), Flying()]


def _twist(system, C, V, t):
    return system.twist(C, V, t) if hasattr(system, "twist") else V


def _exact(system):
    n = system.pose0.size

    def rates(t, y):
        C, V = y[:n].reshape(system.pose0.shape), y[n:]
        return (*(C @ system.hat(_twist(system, C, V, t))).flat, *system.rate(C, V, t))

    start = np.concatenate((system.pose0.flat, system.twist0))
    return solve_ivp(rates, (0, T_END), start, "DOP853", rtol=1e-13, atol=1e-14).y[:, -1]


def _pushed(system, C, rows, twists, h, order):
    """C exp(h Σ w₁ⱼ Vⱼ) exp(h Σ w₂ⱼ Vⱼ) …"""
    for row in order(rows):
        C = C @ expm(h * system.hat(sum(w * V for w, V in zip(row, twists, strict=True))))
    return C


def _solve(tableau, system, steps, order):
    h = T_END / steps
    C, V = system.pose0, system.twist0
    *of_stages, of_end = tableau.exponentials
    for step in range(steps):
        twists, rates = [], []
        for node, row, rows in zip(tableau.c, tableau.A, of_stages, strict=True):
            t = (step + node) * h
            stage_V = V + h * sum((a * k for a, k in zip(row, rates, strict=True)), 0 * V)
            stage_C = _pushed(system, C, rows, twists, h, order)
            twists.append(_twist(system, stage_C, stage_V, t))
            rates.append(system.rate(stage_C, stage_V, t))
        C = _pushed(system, C, of_end, twists, h, order)
        V = V + h * sum(b * k for b, k in zip(tableau.b, rates, strict=True))
    return np.concatenate((C.flat, V))


def observed_order(tableau, system, order=lambda rows: rows):
    exact = _exact(system)
    coarse, fine = (np.abs(_solve(tableau, system, n, order) - exact).max() for n in (16, 32))
    return math.log2(coarse / fine)


@pytest.mark.parametrize(
    "system",
    [*(pytest.param(system, marks=pytest.mark.slow) for system in OTHERS), Guided()],
    ids=lambda system: type(system).__name__,
)
@pytest.mark.parametrize("tableau", METHODS.values(), ids=METHODS)
def test_method_has_its_order_on_the_group(tableau, system):
    # ±0.3: sixteen steps are not quite asymptotic; a wrong order would be off by 1
    assert observed_order(tableau, system) == pytest.approx(tableau.order, abs=0.3)


@pytest.mark.parametrize("tableau", METHODS.values(), ids=METHODS)
def test_exponentials_in_the_wrong_order_lose_the_order(tableau):
    """The order in which they stand counts, and the test above sees it."""
    assert observed_order(tableau, Guided(), lambda rows: rows[::-1]) < tableau.order - 0.5


def test_crouch_grossman_methods_have_one_exponential_for_each_weight():
    for name in ("CG3", "CG4"):
        tableau = TABLEAUS[name]
        for rows, weights in zip(tableau.exponentials, (*tableau.A, tableau.b), strict=True):
            assert np.array_equal(np.diag(weights), rows) or not weights
