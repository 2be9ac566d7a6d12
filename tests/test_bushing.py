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


# ---- a stiff slider-crank, whose loop is closed by a bushing ------------------------------------

CRANK, ROD, STIFF, LOSS = 0.1, 0.3, 1e7, 100.0  # m, N/m, N s/m
BARS = {"crank": (CRANK, 0.2), "rod": (ROD, 0.3), "slider": (0.05, 0.5)}  # m and kg


def slider_crank() -> lierb.Mechanism:
    boxes = {n: lierb.bodies.box((x, 0.02, 0.02), mass=mass) for n, (x, mass) in BARS.items()}
    hinge = lambda x, **place: lierb.joints.revolute((-0.5 * x, 0.0, 0.0), axis=(0, 0, 1), **place)
    end = {"parent_point": (0.5 * CRANK, 0.0, 0.0)}
    links = [
        lierb.Link("crank", boxes["crank"], hinge(CRANK)),
        lierb.Link("rod", boxes["rod"], hinge(ROD, **end), "crank"),
        lierb.Link("slider", boxes["slider"], lierb.joints.prismatic(axis=(1.0, 0.0, 0.0))),
    ]
    pin = lierb.forces.bushing(
        (0.5 * ROD, 0.0, 0.0), stiffness=(0, 0, 0, STIFF, STIFF, 0),
        damping=(0, 0, 0, LOSS, LOSS, 0),
    )  # fmt: skip
    return lierb.Mechanism(links, gravity=(0.0, -9.81, 0.0), forces=pin.on("rod", "slider"))


def penalised(_, y):
    """Lagrange's equations in the angles of crank and rod from e₁ and in the slide."""
    a, b, s, da, db, ds = y
    (_, first), (_, second), (_, third) = BARS.values()
    about = lambda x, mass: mass * (x * x + 0.02**2) / 12.0
    both = 0.5 * CRANK * ROD * second
    coupled, bend = both * np.cos(a - b), both * np.sin(a - b)
    of_crank = about(CRANK, first) + CRANK**2 * (0.25 * first + second)
    of_rod = about(ROD, second) + 0.25 * second * ROD**2
    mass = np.array([[of_crank, coupled], [coupled, of_rod]])
    u, v = CRANK * np.array((-np.sin(a), np.cos(a))), ROD * np.array((-np.sin(b), np.cos(b)))
    end = np.array((CRANK * np.cos(a) + ROD * np.cos(b) - s, CRANK * np.sin(a) + ROD * np.sin(b)))
    force = -STIFF * end - LOSS * (u * da + v * db - (ds, 0.0))
    fall = 9.81 * np.array(((0.5 * first + second) * u[1], 0.5 * second * v[1]))
    loads = np.array((force @ u - bend * db**2, force @ v + bend * da**2)) - fall
    return [da, db, ds, *np.linalg.solve(mass, loads), -force[0] / third]


@pytest.mark.long
def test_a_slider_crank_closed_by_a_penalty_moves_as_radau_says():
    turn, rate = 0.7, 20.0
    lean = -np.arcsin(CRANK * np.sin(turn) / ROD)
    slide = CRANK * np.cos(turn) + ROD * np.cos(lean)
    leaning = -CRANK * np.cos(turn) * rate / (ROD * np.cos(lean))
    sliding = -CRANK * np.sin(turn) * rate - ROD * np.sin(lean) * leaning
    machine, t = slider_crank(), np.linspace(0.0, 0.2, 5)
    pose0 = machine.pose({"crank": turn, "rod": lean - turn, "slider": slide})
    twist0 = machine.twist({"crank": rate, "rod": leaning - rate, "slider": sliding}, pose0)
    options = {"rtol": 1e-9, "method": "Rodas5P", "save_at": t, "record": "state"}
    result = lierb.integrate(machine, pose0=pose0, twist0=twist0, t_end=0.2, **options)
    start = [turn, lean, slide, rate, leaning, sliding]
    right = solve_ivp(
        penalised, (0.0, 0.2), start, "Radau", t_eval=t, rtol=1e-10, atol=1e-12
    ).y  # fmt: skip
    np.testing.assert_allclose(result["slider"].position[:, 0, 0], right[2], rtol=0, atol=1e-10)
    np.testing.assert_allclose(result["crank"].omega[:, 0, 2], right[3], rtol=0, atol=1e-7)
    R = result["crank"].rotation[:, 0]
    sine, cosine = R[:, 1, 0], R[:, 0, 0]
    rigid = CRANK * cosine + np.sqrt(ROD**2 - (CRANK * sine) ** 2)
    # some 50 N on 1e7 N/m
    np.testing.assert_allclose(result["slider"].position[:, 0, 0], rigid, rtol=0, atol=2e-5)
