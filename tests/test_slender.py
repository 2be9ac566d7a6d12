"""A small body on a long arm: 1 kg at 1 m, and moments of inertia from 1e-1 to 1e-15 kg m²."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from cases import GRAVITY, column, integrate, slow_but
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import lierb

ARM = np.array([1.0, 2.0, 2.0]) / 3.0  # from the body's origin, its centre of mass, to the joint
AXIS = np.array([2.0, -2.0, 1.0]) / 3.0
SIZES = 10.0 ** -np.arange(1, 16)
SHAPE = np.array([1.0, 1.1, 1.3])
BODIES = lierb.Body(1.0, SIZES[:, None, None] * (SHAPE * np.eye(3)))
CSPACES = ("SE3", "SO3xR3")
END = 2.0


@cache
def driven(cspace: str) -> lierb.Result:
    """About a hinge, by a motor at 3 rad/s."""
    hinge = lierb.joints.revolute(body_point=ARM, axis=AXIS)
    problem = lierb.Problem(BODIES, hinge, GRAVITY, forces=lierb.forces.motor(speed=3.0))
    return integrate(
        problem, twist0=hinge.twist(omega=3.0 * AXIS), dt=1e-3, t_end=END, cspace=cspace,
        save_every=2000,
    )  # fmt: skip


@cache
def falling(cspace: str, solver: str) -> lierb.Result:
    """Release from rest, about a ball joint."""
    ball = lierb.joints.spherical(body_point=ARM)
    return integrate(
        lierb.Problem(BODIES, ball, GRAVITY), twist0=np.zeros(6), dt=1e-3, t_end=END,
        cspace=cspace, solver=solver, save_every=2000,
    )  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("cspace", CSPACES)
def test_a_driven_hinge_carries_what_the_motion_needs(cspace):
    """The motion is given, and so is the wrench that it takes."""
    result = driven(cspace)
    turned = Rotation.from_rotvec(3.0 * END * AXIS).as_matrix()
    com = -ARM  # from the joint's point, in body axes
    inward = -9.0 * com  # its acceleration
    force = inward - turned.T @ np.asarray(GRAVITY)
    hinge = lierb.joints.revolute(body_point=ARM, axis=AXIS)
    axes = hinge.body_frame[:3, :3]
    spun = SIZES[:, None] * np.cross(3.0 * AXIS, SHAPE * (3.0 * AXIS))
    torque = spun + np.cross(com, force)
    found = column(result.history, "reaction")[-len(SIZES) :]
    assert set(result.summary["status"].to_pylist()) == {"ok"}
    # a force of 16 N, 2000 steps of rounding in the angle
    np.testing.assert_allclose(found[:, 3:] @ axes.T, np.tile(force, (len(SIZES), 1)), atol=1e-11)
    np.testing.assert_allclose(found[:, :3] @ axes.T, torque, atol=1e-11)
    lam = column(result.history, "lambda")[-len(SIZES) :]
    ground = hinge.ground_frame[:3, :3]
    np.testing.assert_allclose(
        -lam[:, :3] @ ground.T, np.tile(turned @ force, (len(SIZES), 1)), atol=1e-11
    )
    np.testing.assert_allclose(-lam[:, 3:], torque @ axes, atol=1e-11)


@pytest.mark.parametrize("cspace", slow_but(CSPACES, "SE3"))
@pytest.mark.parametrize("solver", ["auto", "saddle"])
def test_a_ball_joint_swings_as_euler_says(cspace, solver):
    """Euler's equations about the joint, in axes along the arm, where nothing cancels."""
    if (cspace, solver) == ("SO3xR3", "auto"):
        pytest.skip("there it is the saddle point")
    result = falling(cspace, solver)
    assert set(result.summary["status"].to_pylist()) == {"ok"}
    forces = column(result.history, "reaction")[-len(SIZES) :]
    lam = column(result.history, "lambda")[-len(SIZES) :]
    omegas = column(result.summary, "omega")
    axes = lierb.joints.spherical(body_point=ARM).body_frame[:3, :3]
    for size, reaction, multipliers, omega in zip(SIZES, forces, lam, omegas, strict=True):
        force, spin, rotation = swung(size)
        # RK4 at 5 rad/s and 1e-3 s leaves 1e-11, amplified by the swing to some 1e-10
        np.testing.assert_allclose(axes @ reaction[3:], force, atol=1e-9)
        np.testing.assert_allclose(reaction[:3], 0.0, atol=1e-12)
        np.testing.assert_allclose(-multipliers, axes.T @ rotation @ force, atol=1e-9)
        np.testing.assert_allclose(omega, spin, atol=1e-9)


@cache
def swung(size: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The joint's force and ω in body axes, and R, at the end."""
    along = np.linalg.svd(ARM[None])[2].T  # first column ± the arm
    if np.linalg.det(along) < 0.0:
        along[:, 2] *= -1.0
    com = np.array([-along[:, 0] @ ARM, 0.0, 0.0])
    theta = size * along.T @ np.diag(SHAPE) @ along
    inertia = theta + np.diag([0.0, 1.0, 1.0])

    def rates(t, state):
        q, w = state[:4], state[4:]
        fall = Rotation.from_quat(q).inv().apply(along.T @ np.asarray(GRAVITY))
        # com × fall and ω × (inertia ω) less what the arm makes of itself
        torque = -np.cross(w, theta @ w) + np.cross(com, fall - (com @ w) * w)
        scale = np.array([np.sqrt(size), 1.0, 1.0])
        alpha = np.linalg.solve(inertia / np.outer(scale, scale), torque / scale) / scale
        x, y, z, s = q
        drift = 0.5 * np.array(
            [s * w[0] + y * w[2] - z * w[1], s * w[1] + z * w[0] - x * w[2],
             s * w[2] + x * w[1] - y * w[0], -(x * w[0] + y * w[1] + z * w[2])]
        )  # fmt: skip
        return np.concatenate([drift, alpha])

    start = np.concatenate([[0.0, 0.0, 0.0, 1.0], np.zeros(3)])
    found = solve_ivp(rates, (0.0, END), start, method="DOP853", rtol=1e-13, atol=1e-14)
    state = found.y[:, -1]
    alpha = rates(END, state)[4:]
    w, turn = state[4:], Rotation.from_quat(state[:4])
    fall = turn.inv().apply(along.T @ np.asarray(GRAVITY))
    force = np.cross(alpha, com) + np.cross(w, np.cross(w, com)) - fall
    return along @ force, along @ w, along @ turn.as_matrix() @ along.T


@pytest.mark.slow
@pytest.mark.parametrize("cspace", CSPACES)
def test_the_joint_stays_closed(cspace):
    """SE(3) keeps the joint to rounding; on SO(3)×R³ it drifts with the method, at any inertia."""
    for run in (driven(cspace), falling(cspace, "saddle")):
        opened = column(run.summary, "position_error_max")
        if cspace == "SE3":
            assert opened.max() <= 1e-13
        else:  # the motions differ a little, and so do their drifts
            assert opened.max() < 2.0 * opened[0]
            assert opened.max() < 1e-11


@pytest.mark.parametrize("name", ["spherical", "revolute", "universal", "point_on_plane"])
def test_projected_twists_and_closed_poses_satisfy_the_joint(name):
    made = getattr(lierb.joints, name)(body_point=ARM)
    problem = lierb.Problem(BODIES, made, GRAVITY)
    off = lierb.lie.se3.exp(0.01 * np.array([1.0, -2.0, 0.5, 0.3, 1.0, -0.7]))
    pose = problem.close(off)
    twist = problem.project((1.0, 2.0, 3.0, 1.0, -1.0, 0.5), pose)
    point = twist[:, 3:] + np.cross(twist[:, :3], ARM)
    place = pose[:, :3, :3] @ ARM + pose[:, :3, 3]
    rows = [2] if name == "point_on_plane" else [0, 1, 2]
    velocity = np.einsum("nij,nj->ni", pose[:, :3, :3], point)
    # a few roundings of a motion of 3 rad/s and 2 m/s, and of places of 1 m
    np.testing.assert_allclose(velocity[:, rows], 0.0, atol=1e-14)
    np.testing.assert_allclose(place[:, rows], 0.0, atol=1e-13)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["planar", "schoenflies"])
def test_a_body_that_slides_turns_as_it_likes(name):
    """Gravity has no moment about the centre of mass: the spin stays, whatever the arm."""
    made = getattr(lierb.joints, name)(body_point=ARM, axis=AXIS)
    gravity = np.array((0.3, 1.0, -9.81))
    problem = lierb.Problem(BODIES, made, gravity)
    start = problem.project(np.concatenate([0.5 * AXIS, (0.2, 0.1, 0.3)]))
    result = integrate(problem, twist0=start, dt=1e-3, t_end=END)
    # 2000 steps of a quotient's rounding
    np.testing.assert_allclose(column(result.summary, "omega") @ AXIS, 0.5, rtol=0, atol=1e-13)
    assert column(result.summary, "energy_drift_max").max() < 1e-11
    force = -(gravity @ AXIS) * AXIS if name == "planar" else np.zeros(3)
    spun = SIZES[:, None] * np.cross(0.5 * AXIS, SHAPE * 0.5 * AXIS)
    axes = made.body_frame[:3, :3]
    found = column(result.history, "reaction")[-len(SIZES) :]
    np.testing.assert_allclose(found[:, 3:] @ axes.T, np.tile(force, (len(SIZES), 1)), atol=1e-13)
    np.testing.assert_allclose(found[:, :3] @ axes.T, spun + np.cross(-ARM, force), atol=1e-12)


def test_a_pose_is_closed_near_by():
    """A tilt of 5e-5 is turned back by as much; the kinetic metric alone turned by 0.8."""
    made = lierb.joints.planar(body_point=ARM, axis=AXIS)
    problem = lierb.Problem(BODIES, made)
    off = made.closed_pose @ lierb.lie.se3.exp((1e-5, 5e-5, 2e-5, 1e-4, -2e-4, 0.0))
    closed = problem.close(off)
    turned = lierb.log(off[:3, :3].T @ closed[:, :3, :3])
    assert np.linalg.norm(turned, axis=1).max() < 1e-3
    assert np.linalg.norm(closed[:, :3, 3] - off[:3, 3], axis=1).max() < 1e-3
