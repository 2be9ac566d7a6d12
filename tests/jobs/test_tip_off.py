"""docs/jobs/tip_off.md against impulse theory, its formulas and SciPy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from .page import names_of

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    return names_of("tip_off", tmp_path_factory.mktemp("tip_off"))


def test_rates_have_the_deviations_of_linear_theory(page):
    """Sampling: 1/√(2n) = 0.5 %; four of these, and as much for the second order of 2 %."""
    ratio = page["rates"][:, :2].std(axis=0) / page["sigma"]
    assert np.abs(ratio - 1.0).max() < 4.0 / np.sqrt(2.0 * len(page["rates"])) + 0.001


def test_rates_are_uncorrelated_and_have_no_spin(page):
    """Sampling: 1/√n for a correlation. No spring acts about z; precession is of second order."""
    correlation = np.corrcoef(page["rates"][:, :2].T)[0, 1]
    assert abs(correlation) < 4.0 / np.sqrt(len(page["rates"]))
    assert np.abs(page["rates"][:, 2]).max() < 0.01 * page["q"]


def test_quantile_is_that_of_linear_theory(page):
    """Sampling: √(p (1 − p)/n) over the density, of Rayleigh's tail; four of these."""
    q, p, n = page["theory"], 0.0027, len(page["rate"])
    density = p * q / page["sigma"].max() ** 2  # smaller than the density, which errs on this side
    assert abs(page["q"] - q) < 4.0 * np.sqrt(p / n) / density
    assert page["sure"].low < page["q"] < page["sure"].high


def test_theory_is_the_tail_of_two_normal_components(page):
    """A million draws: √(p/n) = 2 % of the tail; four of these."""
    draws = np.random.default_rng(3).normal(size=(1_000_000, 2)) * page["sigma"]
    beyond = np.mean(np.linalg.norm(draws, axis=1) > page["theory"])
    assert abs(beyond / 0.0027 - 1.0) < 4.0 / np.sqrt(2700.0)


def test_speed_is_that_of_the_springs_energy(page):
    """The work differs at second order of the tilt: height × ω × θ / v, at most 4e-4 here."""
    assert page["off"] < 4e-4
    sigma = 0.5 * 0.5 * np.sqrt(0.01**2 + 0.01**2 + 0.01**2)  # ½ v of k̄, s̄² and m: 1 % each
    assert abs(page["speed"].std() / sigma - 1.0) < 4.0 / np.sqrt(2.0 * len(page["speed"]))


def test_a_satellite_moves_as_scipy_integrates_newton_and_euler(page):
    """Fixed steps across the springs' end: F′ dt²/J = 2e-6 rad/s at most, of some 1e-2."""
    drawn, number = page["drawn"], int(page["rate"].argmax())
    k, s, x, y = (drawn[name][number] for name in ("stiffness", "stroke", "x", "y"))
    com, mass, J = drawn["com"][number], drawn["mass"][number], page["inertia"]
    points = np.stack([x, y, np.zeros(4)], axis=1) - com

    def slope(t, state):
        """State: height of the centre of mass, its speed, last row of R, ω in body axes."""
        height, speed, axis, omega = state[0], state[1], state[2:5], state[5:]
        push = k * np.maximum(s - height - points @ axis, 0.0)
        torque = np.array((points[:, 1] @ push, -points[:, 0] @ push, 0.0))
        turning = (torque - np.cross(omega, J * omega)) / J
        lift = push.sum() * axis[2] / mass
        return np.concatenate([[speed, lift], np.cross(axis, omega), turning])

    start = np.array((com[2], 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0))
    peer = solve_ivp(slope, (0.0, 0.25), start, rtol=1e-10, atol=1e-12, max_step=1e-3).y[:, -1]
    assert np.abs(peer[5:] - page["result"].omega[number]).max() < 2e-5
    assert abs(peer[1] - page["speed"][number]) < 2e-5
