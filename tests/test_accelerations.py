"""Accelerations in observables, events and controllers: what an IMU on a body reads."""

from __future__ import annotations

import numpy as np
import pytest
from cases import column
from public_cases.shared import summed
from scipy.integrate import solve_ivp

import lierb
from lierb.errors import ForceError

G = 9.81
DOWN = np.array((0.0, 0.0, -G))


@lierb.observable(unit="m/s²", point=(0.0, 0.0, 0.0), axis=(1.0, 0.0, 0.0))
def accelerometer(omega, alpha, specific_force, params):
    """Reading along an axis, of an accelerometer at a point of the body."""
    p = params.point
    reading = specific_force + np.cross(alpha, p) + np.cross(omega, np.cross(omega, p))
    return params.axis @ reading


@lierb.observable(unit="rad/s²", axis=(1.0, 0.0, 0.0))
def angular(alpha, params):
    return params.axis @ alpha


def imu(point, on=()):
    """Three accelerometers and three angular accelerations, in the axes of a body."""
    made = []
    for i, axis in enumerate(np.eye(3)):
        made += [
            accelerometer(point=point, axis=axis).named(f"f{i}"),
            angular(axis=axis).named(f"alpha{i}"),
        ]
    return [each.on(*on) for each in made] if on else made


def readings(result) -> tuple[np.ndarray, np.ndarray]:
    """(rows, 3) of specific force and angular acceleration."""
    names = [f"{what}{i}" for what in ("f", "alpha") for i in range(3)]
    columns = np.array([column(result.history, name) for name in names])
    return columns[:3].T, columns[3:].T


# ---- closed forms ------------------------------------------------------------------------------

POINT = np.array((0.2, -0.3, 0.5))


@pytest.mark.slow
def test_a_body_in_free_fall_feels_its_turns_alone():
    """Right: ω × (ω × p) + ω̇ × p about the centre of mass, with Euler's ω̇."""
    moments, omega, centre = np.array((0.3, 0.4, 0.6)), np.array((1.0, -2.0, 0.5)), (0.1, 0.2, -0.4)
    body = lierb.Body(2.0, moments, centre, about="com")
    problem = lierb.Problem(body, lierb.joints.free(), DOWN, observables=imu(POINT))
    twist0 = np.concatenate([omega, (3.0, 1.0, -2.0)])
    result = lierb.integrate(problem, twist0=twist0, dt=1e-3, t_end=1e-3, save_every=1)
    force, alpha = readings(result)
    right = np.cross(moments * omega, omega) / moments
    np.testing.assert_allclose(alpha[0], right, rtol=0, atol=1e-14)
    arm = POINT - centre
    swing = np.cross(right, arm) + np.cross(omega, np.cross(omega, arm))
    np.testing.assert_allclose(force[0], swing, rtol=0, atol=1e-14)


SPACES = ["SE3", pytest.param("reduced", marks=pytest.mark.slow)]


@pytest.mark.slow
@pytest.mark.parametrize("cspace", SPACES)
def test_a_pendulum_feels_gravity_and_its_swing(cspace):
    """Frames that no axis is aligned with. Right: α = (c × m g)·n / I_n, and p's motion."""
    rng = np.random.default_rng(3)
    frames = []
    for _ in range(2):
        frame = np.eye(4)
        frame[:3, :3] = lierb.lie.so3.exp(rng.normal(size=3))
        frame[:3, 3] = rng.normal(size=3)
        frames.append(frame)
    held = lierb.joints.revolute(ground_frame=frames[0], body_frame=frames[1])
    centre, mass, moments = rng.normal(size=3), 2.0, np.diag((0.3, 0.4, 0.6))
    body = lierb.Body(mass, moments, centre, about="com")
    problem = lierb.Problem(body, held, DOWN, observables=imu(POINT))
    pose0 = held.pose([0.7])
    twist0 = held.twist(velocities=[2.0], pose=pose0)
    result = lierb.integrate(
        problem, pose0=pose0, twist0=twist0, dt=1e-3, t_end=1e-3, save_every=1, cspace=cspace
    )
    force, alpha = readings(result)
    axis, pivot = frames[1][:3, 2], frames[1][:3, 3]
    down, arm = pose0[:3, :3].T @ DOWN, centre - pivot
    whole = moments + mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    rate = axis @ np.cross(arm, mass * down) / (axis @ whole @ axis)
    np.testing.assert_allclose(alpha[0], rate * axis, rtol=0, atol=1e-12)
    lever, omega = POINT - pivot, 2.0 * axis
    right = np.cross(rate * axis, lever) + np.cross(omega, np.cross(omega, lever)) - down
    np.testing.assert_allclose(force[0], right, rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    "held",
    ["spherical", *(pytest.param(name, marks=pytest.mark.long) for name in ("planar", "fixed"))],
)
@pytest.mark.long
def test_one_body_and_a_mechanism_of_it_feel_the_same(held):
    """Right: another formulation; this one has principal axes and joint points of its own."""
    joint = getattr(lierb.joints, held)(body_point=(0.1, 0.0, 0.2))
    body = lierb.Body(2.0, (0.3, 0.4, 0.6), (0.1, -0.2, 0.3), about="com")
    problem = lierb.Problem(body, joint, DOWN, observables=imu(POINT))
    twist0 = problem.project((1.0, -0.5, 2.0, 0.3, 0.2, 0.1))
    machine = lierb.Mechanism(lierb.Link("body", body, joint), gravity=DOWN, observables=imu(POINT))
    options = {"dt": 1e-3, "t_end": 0.01, "save_every": 5}
    alone = readings(lierb.integrate(problem, twist0=twist0, **options))
    tree = readings(lierb.integrate(machine, twist0={"body": twist0}, **options))
    for a, b in zip(alone, tree, strict=True):
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-11)


# ---- mechanisms --------------------------------------------------------------------------------

M, I, L, C = 1.3, 0.04, 0.8, 0.35  # kg, kg m², m, m


@pytest.mark.slow
def test_c56_a_tip_reads_what_scipy_says():
    """IsaacSim#735, IsaacLab#1294, gazebo#893: accelerations are none, or differences.

    The tip of a double pendulum in the plane of e₁ and e₂. Right: Lagrange's equations by SciPy.
    """
    rod = lierb.Body(M, (0.01, I, I), (C, 0.0, 0.0), about="com")
    links = [
        lierb.Link("upper", rod, lierb.joints.revolute()),
        lierb.Link("lower", rod, lierb.joints.revolute(parent_point=(L, 0.0, 0.0)), "upper"),
    ]
    tip = (L, 0.0, 0.0)
    machine = lierb.Mechanism(links, gravity=(0.0, -G, 0.0), observables=imu(tip, ("lower",)))

    def bend(y):
        """Angles from e₁, rates; and the accelerations of the angles."""
        a, b, u, w = y
        mix = M * L * C * np.cos(a - b)
        mass = np.array([[I + M * C * C + M * L * L, mix], [mix, I + M * C * C]])
        turn = M * L * C * np.sin(a - b)
        pull = -M * G * np.array([(C + L) * np.cos(a), C * np.cos(b)])
        return np.linalg.solve(mass, pull + np.array([-turn * w * w, turn * u * u]))

    t = np.linspace(0.0, 2.0, 21)
    y = solve_ivp(
        lambda _, y: [*y[2:], *bend(y)], (0.0, 2.0), [0.3, -0.4, 1.0, -2.0], "DOP853", t_eval=t,
        rtol=1e-12, atol=1e-12,
    ).y  # fmt: skip
    turns = np.array([bend(each) for each in y.T]).T
    a, b, u, w = y
    move = L * np.exp(1j * a) * (1j * turns[0] - u * u) + L * np.exp(1j * b) * (
        1j * turns[1] - w * w
    )
    felt = (move + 1j * G) * np.exp(-1j * b)  # in axes of the lower rod
    pose0 = machine.pose({"upper": 0.3, "lower": -0.7})
    twist0 = machine.twist({"upper": 1.0, "lower": -3.0}, pose0)
    result = lierb.integrate(
        machine, pose0=pose0, twist0=twist0, dt=2.5e-4, t_end=2.0, save_every=400
    )
    force, alpha = readings(result)
    # RK4: 8e-9 of accelerations of some 100, which the two pendulums amplify
    np.testing.assert_allclose(force[:, 0] + 1j * force[:, 1], felt, rtol=0, atol=1e-7)
    np.testing.assert_allclose(alpha[:, 2], turns[1], rtol=0, atol=1e-7)
    np.testing.assert_allclose(force[:, 2], 0.0, atol=1e-12)


@pytest.mark.long
@pytest.mark.parametrize("cspace", ["reduced", pytest.param("SE3", marks=pytest.mark.long)])
def test_readings_are_derivatives_of_the_velocities(cspace):
    """A driven four-bar with a loop. Right: differences of v and ω over 20 µs, of second order."""
    bar = lierb.Body(1.0, (0.001, 0.01, 0.0105))
    pin = lambda point, parent: lierb.joints.revolute((point, 0, 0), parent_point=(parent, 0, 0))
    machine = lierb.Mechanism(
        [
            lierb.Link("crank", bar, pin(-0.1, 0.0)),
            lierb.Link("coupler", bar, pin(-0.3, 0.1), "crank"),
            lierb.Link("rocker", bar, pin(-0.25, 0.5)),
        ],
        lierb.Loop("knee", pin(0.25, 0.3), "rocker", "coupler"),
        gravity=(0.5, -G, 1.0),
        forces=lierb.forces.motor(torque=0.4).on("crank"),
        observables=imu((0.0, 0.0, 0.0), ("coupler",)),
    )
    pose0 = machine.close(machine.pose({"crank": 1.0, "coupler": -0.6, "rocker": 1.5}))
    twist0 = machine.project(machine.twist({"crank": 3.0}, pose0), pose0)
    h = 1e-5
    result = lierb.integrate(
        machine, pose0=pose0, twist0=twist0, dt=h, t_end=2 * h, save_every=1, cspace=cspace,
        record="state",
    )  # fmt: skip
    force, alpha = readings(result)
    link = result["coupler"]
    omega, v = link.omega[:, 0], link.v[:, 0]
    R = link.rotation[1, 0]
    turning = (omega[2] - omega[0]) / (2 * h)
    moving = (v[2] - v[0]) / (2 * h) + np.cross(omega[1], v[1]) - R.T @ (0.5, -G, 1.0)
    np.testing.assert_allclose(alpha[1], turning, rtol=0, atol=1e-6)
    np.testing.assert_allclose(force[1], moving, rtol=0, atol=1e-6)


# ---- events and controllers --------------------------------------------------------------------


@lierb.event(terminal=True, direction=1)
def heavy(specific_force, params):
    return specific_force @ specific_force - params.most**2


@lierb.controller(every=0.01)
def reading(specific_force):
    return {"seen": specific_force}


@pytest.mark.long
def test_events_and_controllers_read_accelerations():
    """A turning wheel is spun up: α = τ/I, so that ‖f‖ = g √… at its rim at a known time."""
    torque, inertia, arm = 0.6, 0.3, 0.5
    held = lierb.joints.revolute(body_point=(-arm, 0.0, 0.0))
    body = lierb.Body(1.0, (0.2, 0.2, inertia), (-arm, 0.0, 0.0), about="com")
    alpha, most = torque / inertia, 8.0
    problem = lierb.Problem(
        body,
        held,
        forces=lierb.forces.motor(torque),
        events=heavy(most=most),
        controllers=reading(),
    )
    result = lierb.integrate(
        problem, twist0=np.zeros(6), rtol=1e-11, method="DOP853", t_end=10.0, save_at=[1.005]
    )
    # ‖f‖² = a² (α² + ω⁴) with ω = α t
    right = ((most / arm) ** 2 - alpha**2) ** 0.25 / alpha
    np.testing.assert_allclose(result.events["t"].to_numpy(), right, rtol=1e-10)
    seen = np.array(result.history["seen"].to_pylist())[0]
    np.testing.assert_allclose(seen, (-arm * (alpha * 1.0) ** 2, arm * alpha, 0.0), rtol=1e-9)


def test_accelerations_are_relative_to_the_ground():
    """Beside them omega and v of another link would be no part of a reading."""
    links = [
        lierb.Link(name, lierb.Body(1.0, (0.1, 0.1, 0.1)), lierb.joints.free()) for name in "ab"
    ]
    with pytest.raises(ForceError, match=r"observables\[0\], angular, .*\.on\('a'\)$"):
        lierb.Mechanism(links, observables=angular().on("a", "b"))


def test_forces_and_states_cannot_depend_on_accelerations():
    @lierb.states(x=0.0)
    def filtered(alpha):
        return {"x": alpha[0]}

    with pytest.raises(ForceError, match=r"takes \(alpha\); expected any of"):
        filtered()
    with pytest.raises(ForceError, match="sees no alpha, which depends on all forces"):
        lierb.wrench(lambda t, R, r, omega, v, alpha: (alpha, v))()


@pytest.mark.slow
def test_a_run_with_accelerations_has_the_same_motion():
    """Right: the bits of the run without."""
    body, held = lierb.Body(1.0, (0.2, 0.25, 0.3)), lierb.joints.revolute((0.1, 0.0, 0.3))
    results = []
    for observables in ((), imu(POINT)):
        problem = lierb.Problem(body, held, DOWN, observables=observables)
        twist0 = problem.project((1.0, 2.0, 3.0, 0.0, 0.0, 0.0))
        results.append(
            lierb.integrate(problem, twist0=twist0, dt=1e-2, t_end=0.5, save_every=50, cspace="SE3")
        )
    for name in ("rotation", "omega"):
        np.testing.assert_array_equal(*(summed(result, name) for result in results))
