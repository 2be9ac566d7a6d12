"""Motion as given: positions and speeds of joints as functions of time."""

from __future__ import annotations

import numpy as np
import pytest
from cases import column, integrate
from scipy.integrate import solve_ivp

import lierb

G = 9.81  # m/s²
MASS, INERTIA, ARM = 0.8, 0.02, 0.3  # kg, kg m² about the centre of mass, m from the pivot
AMPLITUDE, FREQUENCY = 0.04, 30.0  # m, rad/s


def shaken(t, params):
    return params.amplitude * np.sin(params.frequency * t)


def pendulum_on_a_cart() -> lierb.Mechanism:
    """A cart that slides along e₁, and a pendulum on it that turns about e₂ × e₁ = −e₃."""
    rod = lierb.Body(MASS, (INERTIA, INERTIA, INERTIA), (0.0, -ARM, 0.0), about="com")
    cart = lierb.Body(2.0, (0.1, 0.1, 0.1))
    motor = lierb.forces.motor(position=shaken, amplitude=AMPLITUDE, frequency=FREQUENCY)
    return lierb.Mechanism(
        [
            lierb.Link("cart", cart, lierb.joints.prismatic(axis=(1.0, 0.0, 0.0))),
            lierb.Link("rod", rod, lierb.joints.revolute(), parent="cart"),
        ],
        gravity=(0.0, -G, 0.0),
        forces=motor.on("cart"),
    )


def test_c29_a_pendulum_on_a_shaken_cart_moves_as_scipy_says():
    """drake#2623, drake#19234, chrono#26, chrono#438: a joint follows a function of time.

    Right: (I + m a²) φ̈ = −m a (g sin φ + ẍ cos φ) by SciPy, and the motor's force, which is the
    rate of the momentum of cart and pendulum along e₁.
    """
    machine = pendulum_on_a_cart()
    pose0 = machine.pose({"rod": 0.5})
    twist0 = machine.project(machine.twist({"rod": 1.0}, pose0), pose0)
    assert machine.velocities(twist0, pose0)["cart"][0] == pytest.approx(AMPLITUDE * FREQUENCY)
    t = np.linspace(0.0, 2.0, 21)
    whole, pull = INERTIA + MASS * ARM**2, MASS * ARM

    def rate(t, y):
        push = -AMPLITUDE * FREQUENCY**2 * np.sin(FREQUENCY * t)
        return [y[1], -pull * (G * np.sin(y[0]) + push * np.cos(y[0])) / whole]

    # the nearest twist in kinetic energy takes the rod along: its rate is not that before
    start = [0.5, machine.velocities(twist0, pose0)["rod"][0]]
    right = solve_ivp(rate, (0.0, 2.0), start, "DOP853", t_eval=t, rtol=1e-12, atol=1e-12)
    angle, speed = right.y
    push = -AMPLITUDE * FREQUENCY**2 * np.sin(FREQUENCY * t)
    bend = np.array([rate(*each)[1] for each in zip(t, right.y.T, strict=True)])
    force = (2.0 + MASS) * push + pull * (bend * np.cos(angle) - speed**2 * np.sin(angle))
    result = integrate(
        machine, pose0=pose0, twist0=twist0, dt=5e-4, t_end=2.0, save_every=200,
        stabilise="project",
    )  # fmt: skip
    assert result.failed.size == 0
    place = result["cart"].position[:, 0, 0]
    # projected onto the row: rounding of 0.04 m and of 60 rad
    np.testing.assert_allclose(place, AMPLITUDE * np.sin(FREQUENCY * t), rtol=0, atol=1e-15)
    R = result["rod"].rotation[:, 0]
    found = np.arctan2(R[:, 1, 0], R[:, 0, 0])
    # RK4 of 30 rad/s at 0.5 ms: (0.015)⁴ of 2 s
    np.testing.assert_allclose(found, angle, rtol=0, atol=1e-7)
    found = -column(result.history, "cart.motor.lambda").ravel()
    np.testing.assert_allclose(found, force, rtol=0, atol=1e-4)


def test_c29b_a_slide_follows_a_speed():
    """A motor of given speed on a slide was refused, or ended as singular. Right: its integral."""
    held = lierb.joints.prismatic(axis=(0.0, 0.0, 1.0))
    motor = lierb.forces.motor(speed=lambda t: 3.0 * t * t)
    problem = lierb.Problem(lierb.Body(2.0, (0.1, 0.1, 0.1)), held, (0.0, 0.0, -G), motor)
    result = integrate(problem, twist0=problem.project(np.zeros(6)), dt=0.01, t_end=2.0)
    assert result.failed.size == 0
    np.testing.assert_allclose(result.position[-1, 0], (0.0, 0.0, 8.0), atol=1e-13)  # RK4: exact
    force = -column(result.history, "lambda")[-1, -1]
    assert force == pytest.approx(2.0 * (G + 12.0), rel=1e-14)
    assert result.summary["work_final"][0].as_py() == pytest.approx(
        2.0 * (G * 8.0 + 0.5 * 12.0**2), rel=1e-12
    )


def test_c45_a_four_bar_is_closed_at_a_given_angle():
    """Articraft#127, Articraft#120, PlanarMechanics#20: a crank angle is asked for, and moved.

    A motor of given position holds the crank while the rest closes. Right: the cosine law.
    """
    a, b, c, d = 0.1, 0.4, 0.3, 0.35  # crank, coupler, rocker, ground
    bar = lambda length: lierb.Body(1.0, (1e-3, 0.02, 0.02))
    pin = lambda point, parent: lierb.joints.revolute((point, 0, 0), parent_point=(parent, 0, 0))
    machine = lierb.Mechanism(
        [
            lierb.Link("crank", bar(a), pin(-a / 2, 0.0)),
            lierb.Link("coupler", bar(b), pin(-b / 2, a / 2), "crank"),
            lierb.Link("rocker", bar(c), pin(-c / 2, d)),
        ],
        lierb.Loop("knee", pin(c / 2, b / 2), "rocker", "coupler"),
        forces=lierb.forces.motor(position=np.linspace(-3.0, 3.0, 13)).on("crank"),
    )
    asked = np.linspace(-3.0, 3.0, 13)
    for side in (1.0, -1.0):
        near = machine.pose({"crank": asked, "coupler": side * 0.8 - asked, "rocker": side * 1.7})
        found = machine.coordinates(machine.close(near))
        line = d - a * np.exp(1j * asked)
        inner = np.arccos((abs(line) ** 2 + b * b - c * c) / (2.0 * b * abs(line)))
        right = np.exp(1j * (np.angle(line) + side * inner - asked))
        np.testing.assert_allclose(found["crank"][:, 0], asked, rtol=0, atol=1e-13)
        np.testing.assert_allclose(np.exp(1j * found["coupler"][:, 0]), right, rtol=0, atol=1e-12)
