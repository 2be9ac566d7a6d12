"""Stops and springs of joints: what comes back with the energy that it had."""

from __future__ import annotations

import numpy as np
import pytest

import lierb
from public_cases.shared import INERTIA, WHEEL, angles_of, assert_bounces, bounced, summed, wheels


def test_bounced_is_continuous_and_keeps_its_energy():
    """The closed form itself, from one 10 µs to the next: its places are those of its speeds."""
    t, (speed, lower, upper, frequency) = np.arange(0.0, 6.0, 1e-5), (3.0, -1.0, 1.5, 50.0)
    place, rate = bounced(t, speed, lower, upper, frequency)
    np.testing.assert_allclose(np.diff(place), rate[1:] * 1e-5, rtol=0, atol=1e-8)
    beyond = np.maximum(place - upper, 0.0) + np.minimum(place - lower, 0.0)
    np.testing.assert_allclose(rate**2 + (frequency * beyond) ** 2, speed**2, rtol=1e-12)


@pytest.mark.slow
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


# ---- c49, c49b: stops of joints ----------------------------------------------------------------
# RobotLocomotion/drake#2516, google-deepmind/mujoco#169, bulletphysics/bullet3#2863: joints pass
# their limits, or gain energy there. Right: free flight, and half a harmonic oscillation in the
# stop.

WIDE = np.radians([60.0, 90.0, 120.0, 150.0, 165.0])
SPEEDS = np.linspace(1.0, 20.0, 20)  # rad/s


METHODS = [
    "DOP853",
    *(pytest.param(name, marks=pytest.mark.long) for name in ("DP54", "Tsit5", "BS32")),
]


@pytest.mark.long
@pytest.mark.parametrize("rtol", [1e-6, 1e-8])
@pytest.mark.parametrize("method", METHODS)
def test_c49b_wide_stops_turn_every_wheel_back(method, rtol):
    """drake#2516, mujoco#169. Wheels of 1 … 20 rad/s between stops at ±60° … ±165°."""
    speeds, stops = (x.ravel() for x in np.meshgrid(SPEEDS, WIDE))
    problem, twist0 = wheels(speeds, -stops, stops, 200.0)
    t = np.linspace(0.0, 10.0, 401)
    result = lierb.integrate(
        problem, twist0=twist0, t_end=10.0, rtol=rtol, method=method, save_at=t, record=["state"]
    )
    assert_bounces(result, t, rtol, speeds, -stops, stops, 200.0)


@pytest.mark.slow
def test_c49b_wheel_bounces_for_ever():
    """drake#2516, mujoco#169. 250 wheels for 100 s, none of which passes through ±180°."""
    speeds = np.linspace(1.0, 20.0, 250)
    problem, twist0 = wheels(speeds, -WIDE[-1], WIDE[-1], 200.0)
    result = lierb.integrate(
        problem, twist0=twist0, t_end=100.0, rtol=1e-6, save_at=np.linspace(0.0, 100.0, 2001),
        record=["state"],
    )  # fmt: skip
    angle = angles_of(result)
    # as deep as the energy takes it, which may drift by 1 % (`assert_bounces`)
    deepest = 1.01 * speeds / np.sqrt(200.0 / INERTIA)
    assert np.all(np.abs(angle) < WIDE[-1] + deepest)
    # who turns through has the other sign of the angle 0.05 s later
    assert np.all(np.abs(np.diff(angle, axis=0)) < 1.01 * 0.05 * speeds + 1e-3)
    energy = 0.5 * INERTIA * speeds**2
    assert np.all(summed(result, "energy_drift_max") < 1e-2 * energy)


@pytest.mark.slow
@pytest.mark.parametrize("rtol", [1e-6, 1e-7, 1e-8, 1e-9, 1e-10])
def test_c49_hard_stops_give_back_what_they_took(rtol):
    """drake#2516, bullet3#2863. Stops at −1 and 1.5 rad, harder by a factor of up to 1000."""
    speeds, stiffness = (
        x.ravel() for x in np.meshgrid(np.linspace(1.0, 20.0, 96), [2e2, 2e3, 2e4, 2e5])
    )
    lower, upper = np.full_like(speeds, -1.0), np.full_like(speeds, 1.5)
    problem, twist0 = wheels(speeds, lower, upper, stiffness)
    t = np.linspace(0.0, 5.0, 401)
    result = lierb.integrate(
        problem, twist0=twist0, t_end=5.0, rtol=rtol, save_at=t, record=["state"]
    )
    assert_bounces(result, t, rtol, speeds, lower, upper, stiffness)


@pytest.mark.long
def test_c49b_stops_of_a_link_turn_it_back():
    """drake#2516, mujoco#169: a wheel of a mechanism, whose stops act in a joint between links."""
    hub = lierb.Link("hub", lierb.Body(3.0, (0.1, 0.1, 0.1)), lierb.joints.fixed())
    wheel = lierb.Link("wheel", WHEEL, lierb.joints.revolute(), "hub")
    speeds, stop = SPEEDS, WIDE[-1]
    stops = lierb.forces.joint_limit(lower=-stop, upper=stop, stiffness=200.0).on("wheel")
    machine = lierb.Mechanism([hub, wheel], forces=stops)
    t = np.linspace(0.0, 10.0, 401)
    result = lierb.integrate(
        machine, twist0=machine.twist({"wheel": speeds}), t_end=10.0, rtol=1e-6, save_at=t,
        record=["state"],
    )  # fmt: skip
    angle = angles_of(result["wheel"])
    right, _ = bounced(t[:, None], speeds, -stop, stop, np.sqrt(200.0 / INERTIA))
    # as in `assert_bounces`, of a stop met each 0.29 s by the fastest
    drift = summed(result, "energy_drift_max") / (0.5 * INERTIA * speeds**2)
    assert np.all(drift < 1e-2)
    allowed = (drift + 300e-6 * (1.0 + 10.0 / 0.29)) * (1.0 + 10.0 * speeds)
    np.testing.assert_array_less(np.abs(angle - right).max(axis=0), allowed)
