"""Bushings: motion by SciPy's rotations and Newton–Euler, closed forms, energy, and refusals."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

import lierb
from lierb.errors import ArgumentError, PoseError, StiffStepWarning

MASS, INERTIA = 2.0, np.diag((0.1, 0.2, 0.25))
BODY_POINT, GROUND_POINT = np.array((0.1, 0.2, -0.1)), np.array((0.05, 0.0, 0.2))
AXES = Rotation.from_rotvec((0.3, 0.2, -0.5)).as_matrix()
SLACK = Rotation.from_rotvec((-0.3, 0.5, 0.1)).as_matrix()
GRAVITY = np.array((0.0, 0.0, -9.81))
BY_AXIS = np.array((5.0, 6.0, 7.0, 300.0, 400.0, 500.0))
COUPLED = np.diag(BY_AXIS) + 8.0 * np.outer(*2 * (np.array((0.2, -0.1, 0.3, 1.0, 2.0, -1.0)),))
DAMPING = 0.02 * BY_AXIS
T_END = 0.4


def hat(x):
    return np.cross(np.eye(3), x)


def dexp(phi):
    """∫₀¹ exp(s φ̂) ds, as a block of an exponential."""
    whole = np.zeros((6, 6))
    whole[:3, :3], whole[:3, 3:] = hat(phi), np.eye(3)
    return expm(whole)[:3, 3:]


def deflection(turn, place):
    relative = AXES.T @ turn @ SLACK.T @ AXES
    moved = place + turn @ BODY_POINT - GROUND_POINT
    return np.concatenate([Rotation.from_matrix(relative).as_rotvec(), AXES.T @ moved])


def reference(stiffness, damping, twist):
    """Pose and twist at T_END, in ground axes: ω = dexp(φ) φ˙, so τ = dexp(φ)⁻ᵀ Q."""
    stiffness, damping = (np.diag(x) if np.ndim(x) == 1 else x for x in (stiffness, damping))

    def rate(t, y):
        turn = Rotation.from_quat(y[:4]).as_matrix()
        place, omega, v = y[4:7], y[7:10], y[10:]
        q = deflection(turn, place)
        d = dexp(q[:3])
        arm = turn @ BODY_POINT
        q_rate = np.concatenate(
            [np.linalg.solve(d, AXES.T @ omega), AXES.T @ (v + np.cross(omega, arm))]
        )
        pull = -stiffness @ q - damping @ q_rate
        force = AXES @ pull[3:]
        torque = AXES @ np.linalg.solve(d.T, pull[:3]) + np.cross(arm, force)
        inertia = turn @ INERTIA @ turn.T
        spin = np.linalg.solve(inertia, torque - np.cross(omega, inertia @ omega))
        x, w = y[:3], y[3]
        quaternion = 0.5 * np.append(w * omega + np.cross(omega, x), -omega @ x)
        return np.concatenate([quaternion, v, spin, force / MASS + GRAVITY])

    start = np.concatenate([(0.0, 0.0, 0.0, 1.0), np.zeros(3), twist])
    y = solve_ivp(rate, (0.0, T_END), start, method="DOP853", rtol=1e-12, atol=1e-12).y[:, -1]
    turn = Rotation.from_quat(y[:4]).as_matrix()
    return turn, y[4:7], turn.T @ y[7:10], turn.T @ y[10:]


@pytest.mark.slow
@pytest.mark.parametrize(
    "stiffness",
    [
        pytest.param(BY_AXIS, marks=pytest.mark.long, id="by axis"),
        pytest.param(COUPLED, id="coupled"),
    ],
)
def test_body_moves_as_newton_and_euler_say(stiffness):
    bushing = lierb.forces.bushing(
        BODY_POINT, GROUND_POINT, stiffness=stiffness, damping=DAMPING, axes=AXES, rotation=SLACK
    )
    problem = lierb.Problem(lierb.Body(MASS, INERTIA), lierb.joints.free(), GRAVITY, bushing)
    twist = np.array((1.0, 2.0, -1.0, 0.1, 0.2, 0.3))
    result = lierb.integrate(problem, twist0=twist, dt=2e-4, t_end=T_END, cspace="SE3")
    (row,) = result.summary.to_pylist()
    turn, place, omega, v = reference(stiffness, DAMPING, twist)
    for name, expected in (
        ("rotation", turn.ravel()),
        ("position", place),
        ("omega", omega),
        ("v", v),
    ):
        # RK4 with 1250 steps or more in a period, and a reference with 1e-10 or less
        np.testing.assert_allclose(np.ravel(row[name]), expected, atol=1e-8, err_msg=name)
    assert row["work_final"] < -1.0  # J
    assert row["energy_drift_max"] < 1e-8


@pytest.mark.long
def test_turn_about_one_axis_is_a_damped_oscillation():
    """φ¨ + 2ζω₀ φ˙ + ω₀² φ = 0, exactly, to any angle below half a turn."""
    stiffness, damping, inertia = 12.0, 0.6, 0.25
    hinge = lierb.joints.revolute()
    bushing = lierb.forces.bushing(
        stiffness=(3.0, 2.0, stiffness, 1.0, 1.0, 1.0), damping=(1.0, 1.0, damping, 1.0, 1.0, 1.0)
    )
    problem = lierb.Problem(lierb.Body(1.0, (0.1, 0.2, inertia)), hinge, forces=bushing)
    speed = 12.0
    result = lierb.integrate(
        problem, twist0=hinge.twist(omega=(0.0, 0.0, speed)), rtol=1e-11, t_end=1.0
    )
    decay, natural = damping / (2.0 * inertia), stiffness / inertia
    frequency = np.sqrt(natural - decay**2)
    angle = speed / frequency * np.exp(-decay) * np.sin(frequency)
    turn = np.reshape(result.summary["rotation"][0].as_py(), (3, 3))
    assert np.arctan2(turn[1, 0], turn[0, 0]) == pytest.approx(angle, abs=1e-9)  # 100 rtol


def test_fixed_steps_beyond_the_stability_of_a_stiff_bushing_are_warned_of():
    slide = lierb.joints.prismatic()
    bushing = lierb.forces.bushing(stiffness=(0.0,) * 5 + (1e6,))
    problem = lierb.Problem(lierb.Body(1.0, (1.0, 1.0, 1.0)), slide, forces=bushing)
    # ω = 1e3 rad/s, bound 2.83e-3 s; before the run, which needs no kernel where this is an error
    with pytest.raises(StiffStepWarning, match="bushing"):
        lierb.integrate(problem, twist0=slide.twist(), dt=4e-3, t_end=0.4)


@pytest.mark.parametrize(
    ("options", "error", "named"),
    [
        ({"stiffness": (1, 1, 1, 1, 1, -1)}, ArgumentError, "no negative number"),
        ({"stiffness": [[1.0] * 6] * 5 + [[2.0] * 6]}, ArgumentError, "not symmetric"),
        ({"stiffness": np.diag((1, 1, 1, 1, 1, -1))}, ArgumentError, "negative eigenvalue"),
        ({"stiffness": 1.0}, ArgumentError, "stiffness"),
        ({"stiffness": (1,) * 6, "damping": (1.0, 2.0)}, ArgumentError, "damping"),
        ({"stiffness": (1,) * 6, "axes": np.ones((3, 3))}, PoseError, "axes"),
        ({"stiffness": (1,) * 6, "rotation": -np.eye(3)}, PoseError, "reflection"),
    ],
)
def test_numbers_that_no_bushing_has_are_refused(options, error, named):
    with pytest.raises(error, match=named):
        lierb.forces.bushing(**options)
