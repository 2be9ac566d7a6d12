"""λ and the saddle point: hand calculations, Newton–Euler's residual, redundant and bad rows."""

from __future__ import annotations

from dataclasses import replace
from operator import methodcaller

import numpy as np
import oracle
import pytest
from cases import GRAVITY, LENGTH, PITCH, box, column, integrate, joint, tiered, tilted
from mpmath import mp

import lierb
from lierb.errors import FailedTrajectoryWarning
from lierb.kernels.groups import quaternion
from lierb.kernels.mechanics.newton_euler import CSPACES
from lierb.kernels.mechanics.rows import JOINT_ROWS
from lierb.kernels.mechanics.saddle import solve
from lierb.kernels.mechanics.support import Load
from lierb.kernels.numbers.vec import IDENTITY
from lierb.kernels.numbers.zero import is_zero
from lierb.kernels.systems.acceleration import accelerate
from lierb.kernels.systems.plan import Plan
from lierb.methods import TABLEAUS


def test_steady_pendulum_pulls_with_weight_and_centrifugal_force():
    """Hanging rod turning about e₂: the axis carries m g cos φ + m ω² l along the rod."""
    mass, length, omega = 1.3, 0.8, 2.1
    held = lierb.joints.revolute(body_point=(0, 0, length), axis=(0, 1, 0))
    problem = lierb.Problem(lierb.Body(mass, (0.02, 0.02, 0.01)), held, GRAVITY)
    result = integrate(
        problem, twist0=held.twist(omega=(0, omega, 0)), dt=1e-4, t_end=1.0, save_every=500
    )
    rotations = column(result.history, "rotation").reshape(-1, 3, 3)
    rates = column(result.history, "omega")[:, 1]
    # −λ is the ground's force on the body, in the ground's joint frame
    axes = held.ground_frame[:3, :3]
    forces = -column(result.history, "lambda")[:, :3] @ axes.T
    towards_axis = rotations[:, :, 2]
    cosine = rotations[:, 2, 2]
    along = np.einsum("ti,ti->t", forces, towards_axis)
    # closed form; the state itself is good to 1e-12
    np.testing.assert_allclose(along, mass * 9.81 * cosine + mass * rates**2 * length, rtol=1e-11)


ROWS = {name: held.rows for name, held in lierb.joints.JOINTS.items() if held.rows}


def _random_state(rows, cspace: str, seed: int = 5, slender: float = 1.0):
    """slender : of the inertia that the other tests have, a part."""
    rng = np.random.default_rng(seed)
    rk4 = TABLEAUS["RK4"]
    plan = Plan(
        lanes=1, rows=rows, cspace=cspace, update="local", method=rk4.scheme(False, False),
        multipliers=True,
    )  # fmt: skip
    held = replace(joint("screw"), length=np.array(LENGTH))  # a number for every kind of row
    solid = box(turned=True)
    problem = lierb.Problem(lierb.Body(solid.mass, slender * solid.inertia), held, GRAVITY)
    body = plan.space.body(problem.parameters())
    q = tuple(lierb.lie.so3.exp(rng.standard_normal(3)).ravel())
    pose = (q, tuple(0.3 * rng.standard_normal(3)))
    return plan, body, pose, tuple(rng.standard_normal(6))


def _number(entry) -> float:
    return 0.0 if is_zero(entry) else float(entry)


def _mass_matrix(body, cspace: str) -> np.ndarray:
    inertia, com = np.reshape(body.inertia, (3, 3)).astype(float), np.zeros(3)
    if cspace == "SE3":
        com = np.array(body.com, dtype=float)
    hat = np.cross(com, np.eye(3)).T  # hat @ x = com × x
    m, hat = mp.mpf(float(body.mass)), exactly(hat)
    about_origin = exactly(inertia) - m * hat @ hat
    return np.block([[about_origin, m * hat], [-m * hat, m * exactly(np.eye(3))]])


exactly = np.vectorize(mp.mpf, otypes=[object])


@pytest.mark.parametrize("slender", [1.0, 1e-8, 1e-15])
@pytest.mark.parametrize("rows", ROWS.values(), ids=ROWS)
@pytest.mark.parametrize("cspace", CSPACES)
def test_acceleration_solves_the_saddle_point_by_lu(rows, cspace, slender):
    """The paper's eq. (index1) as one dense matrix, solved with 60 digits."""
    with mp.workdps(60):
        _compare_with_lu(*_random_state(rows, cspace, slender=slender), rows, cspace)


def _exact(entries):
    """Convert numbers to mpmath's current precision."""
    if isinstance(entries, tuple):
        made = [_exact(x) for x in entries]
        return type(entries)(*made) if hasattr(entries, "_fields") else tuple(made)
    return entries if is_zero(entries) else mp.mpf(float(entries))


def _compare_with_lu(plan, body, pose, velocity, rows, cspace):
    chart = quaternion.from_pose(pose)
    pose = quaternion.pose(chart)
    found = accelerate(plan, body, chart, velocity)
    numbers = np.vectorize(_number)
    x = plan.space.kinematics(body, pose, velocity)
    if all(r.symbol != "cv" for r in rows):  # whose root is of a float
        body, x = _exact(body), plan.space.kinematics(*map(_exact, (body, pose, velocity)))
    jac, eta = (
        np.vectorize(lambda entry: mp.mpf(0) if is_zero(entry) else mp.mpf(entry), [object])(
            np.array([formula(r) for r in rows], dtype=object)
        )
        for formula in (methodcaller(name, x, body) for name in ("jacobian", "acceleration"))
    )
    mass = _mass_matrix(body, cspace)
    omega, v = exactly(velocity[:3]), exactly(velocity[3:])
    p = mass @ exactly(velocity)
    fall = exactly(body.gravity)
    if cspace == "SE3":
        fall = exactly(np.reshape(pose[0], (3, 3))).T @ fall
        ad = np.concatenate([np.cross(p[:3], omega) + np.cross(p[3:], v), np.cross(p[3:], omega)])
        weight = np.concatenate(
            [np.cross(exactly(np.array(body.com, float)), fall), fall]
        ) * mp.mpf(float(body.mass))
    else:
        ad = np.concatenate([np.cross(p[:3], omega), exactly(np.zeros(3))])
        weight = np.concatenate([exactly(np.zeros(3)), fall]) * mp.mpf(float(body.mass))
    m = len(rows)
    matrix = np.block([[mass, jac.T], [jac, exactly(np.zeros((m, m)))]])
    solved = mp.lu_solve(mp.matrix(matrix.tolist()), mp.matrix([*(ad + weight), *eta]))
    expected = np.array([float(z) for z in solved])
    # rounding of α, a and λ, whatever the inertia
    np.testing.assert_allclose(numbers(found.rate), expected[:6], rtol=1e-10, atol=1e-9)
    np.testing.assert_allclose(numbers(found.multipliers), expected[6:], rtol=1e-10, atol=1e-9)
    assert _number(found.singular) == 0.0


@pytest.mark.slow
@pytest.mark.parametrize("name", ROWS)
def test_recorded_multipliers_agree_with_the_world_frame_formulation(name):
    problem, twist0 = tilted(name)
    result = integrate(problem, twist0=twist0, dt=1e-2, t_end=0.01)
    truth = oracle.reference_trajectory(
        name, [0.0], mass=float(problem.body.mass), inertia=problem.body.inertia, twist0=twist0,
        pose0=problem.joint.closed_pose, ground_frame=problem.joint.ground_frame,
        body_frame=problem.joint.body_frame, gravity=problem.gravity, pitch=PITCH,
        length=float(problem.joint.length),
    )  # fmt: skip
    found = column(result.history, "lambda")[0]
    # two dense solves of the same state; λ reaches 100 N
    np.testing.assert_allclose(found, truth.multipliers[0], rtol=1e-10, atol=1e-10)
    wrench = column(result.history, "reaction")[0]
    np.testing.assert_allclose(wrench, truth.reaction[0], rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize("cspace", tiered(CSPACES, ["SE3"], []))
def test_reaction_of_a_moving_body_agrees_with_newton_and_euler(cspace):
    """Multipliers at a state far from the start, in both c-spaces."""
    problem, twist0 = tilted("universal")
    result = integrate(problem, twist0=twist0, dt=2e-4, t_end=0.4, cspace=cspace)
    truth = oracle.reference_trajectory(
        "universal", [0.4], mass=float(problem.body.mass), inertia=problem.body.inertia,
        twist0=twist0, ground_frame=problem.joint.ground_frame,
        body_frame=problem.joint.body_frame, gravity=problem.gravity,
    )  # fmt: skip
    # RK4's error of the state, 1e-11 here, times the stiffness of 100 N
    found = column(result.history, "reaction")[-1]
    np.testing.assert_allclose(found, truth.reaction[0], rtol=1e-8, atol=1e-8)


@pytest.mark.slow
def test_reaction_does_not_depend_on_the_rows():
    """One hinge, its point fixed in the ground's axes and in the body's."""
    problem, twist0 = tilted("revolute")
    frames = {name: getattr(problem.joint, name) for name in ("ground_frame", "body_frame")}
    other = lierb.joints.from_rows(["Qtd3", "Qtd1", "Qtd2", "Omega2", "Omega1"], **frames)
    wrenches = []
    for held in (problem.joint, other):
        run = integrate(
            lierb.Problem(problem.body, held, problem.gravity), twist0=twist0, dt=1e-3, t_end=0.1,
            solver="saddle",
        )  # fmt: skip
        wrenches.append(column(run.history, "reaction"))
    # rounding of 100 steps
    np.testing.assert_allclose(*wrenches, rtol=1e-10, atol=1e-10)


HELD_TWICE = ["d1", "d2", "d3", "Qtd1", "Qtd2", "Qtd3"]
TWICE = {
    "universal": ["d1", "d2", "d3", "Q32", "Qtd3", "Qtd1", "Qtd2"],
    "revolute": [
        "d1", "d2", "d3", "Omega1", "Omega2", "Qtd1", "Qtd2", "Qtd3", "Q13", "Q23", "Q31", "Q32",
    ],
}  # fmt: skip


@pytest.mark.parametrize("name", tiered(TWICE, [], ["revolute"]))
def test_a_joint_given_twice_moves_and_pulls_as_if_given_once(name):
    """Again in other rows, which depend on the first ones: the pivot rule drops them."""
    problem, twist0 = tilted(name)
    frames = {n: getattr(problem.joint, n) for n in ("ground_frame", "body_frame")}
    ends, wrenches = [], []
    for held in (problem.joint, lierb.joints.from_rows(TWICE[name], **frames)):
        run = integrate(
            lierb.Problem(problem.body, held, problem.gravity), twist0=twist0, dt=1e-3, t_end=0.5,
            save_every=100, solver="saddle",
        )  # fmt: skip
        assert run.summary["status"].to_pylist() == ["ok"]
        ends.append(column(run.history, "rotation"))
        wrenches.append(column(run.history, "reaction"))
    # 500 steps of rounding; reactions are up to 100 N and N m
    np.testing.assert_allclose(*ends, atol=1e-10)
    np.testing.assert_allclose(*wrenches, atol=1e-8)


@pytest.mark.slow
def test_rows_that_drift_apart_are_marked():
    """Redundant rows come to contradict each other on SO(3)×R³, as the joint drifts."""
    problem, twist0 = tilted("spherical")
    frames = {n: getattr(problem.joint, n) for n in ("ground_frame", "body_frame")}
    held = lierb.joints.from_rows(HELD_TWICE, **frames)
    with pytest.warns(FailedTrajectoryWarning, match="drifted open"):
        run = lierb.integrate(
            lierb.Problem(problem.body, held, problem.gravity), twist0=twist0, dt=1e-3, t_end=0.5,
            cspace="SO3xR3", method="Heun",
        )  # fmt: skip
    assert run.summary["status"].to_pylist() == ["singular"]


def test_rows_given_again_are_left_out():
    held = lierb.joints.from_rows(["d1", "d2", "d3"] * 2)
    assert held.rows == lierb.joints.spherical.rows


def test_free_body_feels_no_reaction():
    problem, twist0 = tilted("free")
    run = integrate(problem, twist0=twist0, dt=1e-2, t_end=0.02, save_every=1)
    np.testing.assert_array_equal(column(run.history, "reaction"), 0.0)
    unit = run.history.schema.field("reaction").metadata[b"unit"]
    assert unit == b"N m, N m, N m, N, N, N"


def _held_at_its_point(rows):
    """A random state whose point P neither is off its place nor moves."""
    plan, body, _, velocity = _random_state(rows, "SE3")
    return plan, body, ((1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)), (*velocity[:3], 0.0, 0.0, 0.0)


def test_a_row_that_says_the_same_changes_nothing():
    rows = ROWS["spherical"]
    once = accelerate(*_held_at_its_point(rows))
    twice = accelerate(*_held_at_its_point((*rows, JOINT_ROWS["Qtd1"])))
    assert (_number(once.dropped), twice.dropped) == (0.0, 1.0)
    # the dropped row's λ is zero: the arithmetic is the same
    np.testing.assert_array_equal(
        np.vectorize(_number)(twice.rate), np.vectorize(_number)(once.rate)
    )
    np.testing.assert_array_equal(twice.multipliers, (*once.multipliers, 0.0))
    assert twice.singular == 0.0


def test_contradicting_rows_are_marked():
    rows = (*ROWS["spherical"], JOINT_ROWS["Qtd1"])
    plan, body, (_, d), velocity = _held_at_its_point(rows)
    x = plan.space.kinematics(body, (IDENTITY, d), velocity).at_point()
    load = Load((0.1, 0.2, 0.3), (1.0, 2.0, 3.0), (0.1, 0.2, 0.3))
    found = solve(
        body, IDENTITY, rows, methodcaller("jacobian", x, body), (0.0, 0.0, 0.0, 1.0), load
    )
    assert found.singular == 1.0


@pytest.mark.parametrize("cspace", tiered(CSPACES, [], ["SE3"]))
def test_a_rank_that_changes_is_told(cspace):
    """Q32 and Q23 say the same where both frames are in line, and nowhere else."""
    held = lierb.joints.from_rows(["d1", "d2", "d3", "Q32", "Q23"])
    problem = lierb.Problem(lierb.Body(1.0, (0.1, 0.2, 0.25)), held)
    options = {"dt": 1e-2, "t_end": 0.1, "cspace": cspace, "method": "Heun"}
    with pytest.warns(FailedTrajectoryWarning, match="singular"):
        run = lierb.integrate(problem, twist0=(0, 1.0, 0, 0, 0, 0), **options)
    assert run.summary["status"].to_pylist() == ["singular"]
    assert run.summary["t"].to_pylist() == [0.01]


@pytest.mark.parametrize("size", [1e-6, 1e6])
def test_mass_scales_out(size):
    """A body a million times as heavy moves alike, to rounding."""
    problem, twist0 = tilted("revolute")
    heavy = lierb.Body(size * problem.body.mass, size * problem.body.inertia)
    scaled = lierb.Problem(heavy, problem.joint, problem.gravity)
    ends = [
        column(integrate(p, twist0=twist0, dt=1e-3, t_end=1.0).summary, "position")
        for p in (problem, scaled)
    ]
    # 1000 steps of rounding, amplified about tenfold by the motion
    np.testing.assert_allclose(*ends, atol=1e-11)


@pytest.mark.slow
@pytest.mark.parametrize("speed", [0.0, 1e-13, 1e-10])
def test_a_redundant_row_is_no_contradiction_at_any_speed(speed):
    """The allowed violation of a twist leaves noise that only the motion's own scale puts right."""
    held = lierb.joints.from_rows(["d1", "d2", "d3", "Qtd1"])
    problem = lierb.Problem(lierb.Body(1.0, (0.1, 0.2, 0.25)), held)
    twist0 = (1.0, 2.0, 3.0, speed, speed / 3, -speed)
    result = lierb.integrate(problem, twist0=twist0, dt=1e-2, t_end=0.1, method="Heun")
    assert result.summary["status"].to_pylist() == ["ok"]
