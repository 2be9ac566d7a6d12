"""Motion as given, and rolling: positions and speeds of joints, constraints on velocities."""

from __future__ import annotations

import numpy as np
import pytest
from cases import column, integrate
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

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


@pytest.mark.long
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


@pytest.mark.slow
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


# ---- c25: a rolling disc -----------------------------------------------------------------------

DISC_MASS, DISC_RADIUS = 0.8, 0.25  # kg, m
ACROSS, ALONG = 0.25 * DISC_MASS * DISC_RADIUS**2, 0.5 * DISC_MASS * DISC_RADIUS**2


@lierb.constraint(radius=DISC_RADIUS)
def on_the_floor(R, r, params):
    return r[2] - params.radius * np.sqrt(1.0 - R[2, 2] * R[2, 2])


@lierb.velocity_constraint(radius=DISC_RADIUS)
def no_slip(R, omega, v, params):
    edge = -params.radius / np.sqrt(1.0 - R[2, 2] * R[2, 2])
    slip = R @ (v + np.cross(omega, np.array([edge * R[2, 0], edge * R[2, 1], 0.0])))
    return slip[0], slip[1]


def rolled(t, start):
    """Solution by SciPy, in the axes (e₁ level, e₂ up the disc, e₃ its axis), of Euler's equations.

    start : ψ, θ, φ and ω in these axes; e₃ = Rz(ψ) Rx(θ) e_z. About the moving contact −a e₂:
    (A + m a²) ω̇₁ = A ω₂² cot θ − (C + m a²) ω₂ω₃ − m g a cos θ, A ω̇₂ = C ω₁ω₃ − A ω₁ω₂ cot θ,
    (C + m a²) ω̇₃ = m a² ω₁ω₂.
    """
    a, m = DISC_RADIUS, DISC_MASS
    heavy = m * a * a

    def rate(_, y):
        psi, theta, _, w1, w2, w3, *_ = y
        cot = np.cos(theta) / np.sin(theta)
        e1 = np.array((np.cos(psi), np.sin(psi)))
        e3 = np.sin(theta) * np.array((np.sin(psi), -np.cos(psi)))
        return [
            w2 / np.sin(theta), w1, w3 - w2 * cot,
            (ACROSS * w2 * w2 * cot - (ALONG + heavy) * w2 * w3 - m * G * a * np.cos(theta))
            / (ACROSS + heavy),
            (ALONG * w1 * w3 - ACROSS * w1 * w2 * cot) / ACROSS,
            heavy * w1 * w2 / (ALONG + heavy),
            *(a * (w1 * e3 - w3 * e1)),
        ]  # fmt: skip

    y0 = [*start, 0.0, 0.0]
    y = solve_ivp(rate, (0.0, t[-1]), y0, "DOP853", t_eval=t, rtol=1e-12, atol=1e-13).y
    w1, w2, w3 = y[3:6]
    turning = np.array([rate(0.0, each)[3:6] for each in y.T]).T
    cot = np.cos(y[1]) / np.sin(y[1])
    force = m * np.array([
        -a * turning[2] + a * w1 * w2,
        -a * w2 * w3 * cot - a * w1 * w1 + G * np.sin(y[1]),
        a * turning[0] + a * w2 * w3 + G * np.cos(y[1]),
    ])  # fmt: skip
    return y, force


@pytest.mark.slow
def test_c25_a_disc_rolls_as_scipy_says():
    """sympy#27631, mujoco#450: a disc that rolls without slip. Right: SciPy, with its reactions."""
    start = (0.4, 1.1, 0.3, 0.2, 0.8, -6.0)  # ψ, θ, φ, ω₁, ω₂, ω₃
    t = np.linspace(0.0, 2.0, 11)
    right, force = rolled(t, start)
    psi, theta, phi = right[:3]
    turn = Rotation.from_euler("ZXZ", np.stack([psi, theta, phi], 1)).as_matrix()
    level = Rotation.from_euler("ZX", np.stack([psi, theta], 1)).as_matrix()
    body = lierb.Body(DISC_MASS, (ACROSS, ACROSS, ALONG))
    problem = lierb.Problem(
        body, lierb.joints.free(), (0.0, 0.0, -G), constraints=[on_the_floor(), no_slip()]
    )
    pose0, omega = np.eye(4), level[0] @ start[3:]
    pose0[:3, :3], pose0[2, 3] = turn[0], DISC_RADIUS * np.sin(start[1])
    moving = np.cross(omega, DISC_RADIUS * level[0][:, 1])
    twist0 = np.concatenate([turn[0].T @ omega, turn[0].T @ moving])
    result = integrate(
        problem, pose0=pose0, twist0=twist0, dt=5e-4, t_end=2.0, save_every=400, method="RK4"
    )
    assert result.failed.size == 0
    # RK4 of 6 rad/s at 0.5 ms, on a path of 3 m
    np.testing.assert_allclose(result.position[:, 0, :2].T, right[6:], rtol=0, atol=1e-9)
    np.testing.assert_allclose(result.rotation[:, 0], turn, rtol=0, atol=1e-9)
    contact = np.einsum("nij,jn->ni", level, force)
    found = -column(result.history, "lambda")[:, [1, 2, 0]]
    np.testing.assert_allclose(found, contact, rtol=0, atol=1e-7)
    assert np.max(column(result.summary, "energy_drift_max")) < 1e-8
