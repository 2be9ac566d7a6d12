"""Stops and springs of joints: what comes back with the energy that it had."""

from __future__ import annotations

import numpy as np
import pytest

import lierb
from public_cases.shared import WHEEL, assert_bounces, bounced, wheels


def test_bounced_is_continuous_and_keeps_its_energy():
    """The closed form itself, from one 10 µs to the next: its places are those of its speeds."""
    t, (speed, lower, upper, frequency) = np.arange(0.0, 6.0, 1e-5), (3.0, -1.0, 1.5, 50.0)
    place, rate = bounced(t, speed, lower, upper, frequency)
    np.testing.assert_allclose(np.diff(place), rate[1:] * 1e-5, rtol=0, atol=1e-8)
    beyond = np.maximum(place - upper, 0.0) + np.minimum(place - lower, 0.0)
    np.testing.assert_allclose(rate**2 + (frequency * beyond) ** 2, speed**2, rtol=1e-12)


@pytest.mark.parametrize("rtol", [1e-6, 1e-9])
@pytest.mark.parametrize("speed", [0.1, 3.0, 100.0])
def test_c49_stops_of_a_slide_turn_it_back(speed, rtol):
    """drake#2516. A slider of 1 kg between stops mm to m apart; a dozen of them are met."""
    for upper in np.array([[2e-3], [0.1], [2.0]]):
        lower, stiffness = -0.5 * upper, 1e4 * speed**2 / upper**2  # upper/100 deep
        problem, twist0 = wheels(np.array([speed]), lower, upper, stiffness, "prismatic")
        t = np.linspace(0.0, 20.0, 401) * upper[0] / speed
        result = lierb.integrate(
            problem, twist0=twist0, t_end=t[-1], rtol=rtol, save_at=t, record=["state"]
        )
        assert_bounces(result, t, rtol, speed, lower, upper, stiffness, inertia=WHEEL.mass)
