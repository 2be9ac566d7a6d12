"""Twists, wrenches and inertias in other frames against 6×6 matrices; turns about one axis."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lierb.kernels.groups import quaternion, turns
from lierb.kernels.mechanics.spatial import Rigid, twist_at, wrench_from
from lierb.kernels.mechanics.tree_dynamics import Factored
from lierb.kernels.numbers.zero import ZERO

RNG = np.random.default_rng(8)


def hat(a):
    x, y, z = a
    return np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])


def adjoint(R, p):
    return np.block([[R, np.zeros((3, 3))], [hat(p) @ R, R]])


def matrix_of(rigid):
    """Matrix M of the momentum M V about a frame's origin, from the definition."""
    c = hat(rigid.moment)
    return np.block([[np.reshape(rigid.inertia, (3, 3)), c], [-c, rigid.mass * np.eye(3)]])


def blocks(articulated):
    J, H, L = (np.reshape([float(x) for x in block], (3, 3)) for block in articulated)
    return np.block([[J, H], [H.T, L]])


@pytest.fixture
def frame():
    R = Rotation.random(random_state=3).as_matrix()
    return R, np.array([0.3, -0.7, 1.1])


@pytest.fixture
def rigid():
    c, points = np.array([0.2, 0.1, -0.4]), RNG.normal(size=(6, 3))
    theta = sum((p @ p) * np.eye(3) - np.outer(p, p) for p in points - points.mean(0))
    about = theta + 1.7 * ((c @ c) * np.eye(3) - np.outer(c, c))
    return Rigid(1.7, tuple(1.7 * c), tuple(about.ravel()))


def flat(frame):
    return tuple(frame[0].ravel()), tuple(frame[1])


def test_twists_and_wrenches_are_carried_by_adjoints(frame):
    v, f = RNG.normal(size=(2, 6))
    Ad = adjoint(*frame)
    np.testing.assert_allclose(twist_at(flat(frame), tuple(v)), np.linalg.solve(Ad, v), atol=1e-14)
    # the same power in both frames
    np.testing.assert_allclose(
        wrench_from(flat(frame), tuple(f)), np.linalg.solve(Ad, np.eye(6)).T @ f, atol=1e-13
    )


def test_inertias_are_carried_by_adjoints(frame, rigid):
    back = np.linalg.inv(adjoint(*frame))
    M = matrix_of(rigid)
    moved = rigid.from_frame(flat(frame))
    np.testing.assert_allclose(blocks(moved), back.T @ M @ back, atol=1e-12)
    u = RNG.normal(size=6)
    bent = moved.less(tuple(u), tuple(0.3 * u))
    np.testing.assert_allclose(blocks(bent), blocks(moved) - 0.3 * np.outer(u, u), atol=1e-13)
    twice = bent.from_frame(flat(frame))
    np.testing.assert_allclose(blocks(twice), back.T @ blocks(bent) @ back, atol=1e-12)


def test_needed_wrench_is_the_rate_of_momentum(rigid):
    """M V̇ − ad_Vᵀ M V by 6×6 matrices, with V̇ from the acceleration of the origin, v̇ + ω × v."""
    acceleration, twist = RNG.normal(size=(2, 6))
    M, w, v = matrix_of(rigid), hat(twist[:3]), hat(twist[3:])
    rate = acceleration - np.concatenate([np.zeros(3), w @ twist[3:]])
    wanted = M @ rate + np.block([[w, v], [np.zeros((3, 3)), w]]) @ M @ twist
    needed = rigid.needed(tuple(acceleration), tuple(twist[:3]))
    np.testing.assert_allclose(needed, wanted, atol=1e-12)  # of numbers of up to 10


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_turns_about_one_axis_are_those_of_quaternions(axis):
    unit = np.eye(3)[axis]
    zeros = (0.0, 0.0, 0.0)
    matrix = tuple(Rotation.from_rotvec(0.7 * unit).as_matrix().ravel())
    chart = turns.from_pose((matrix, zeros), axis)
    p = (chart[0][0], *(x if k == axis else ZERO for k, x in enumerate(chart[0][1:])))
    y = (*(0.2 if k == axis else ZERO for k in range(3)), ZERO, ZERO, ZERO)
    moved = turns.compose_exp((p, zeros), y)
    wanted = Rotation.from_rotvec(1.1 * unit).as_matrix()
    np.testing.assert_allclose(
        [float(x) for x in turns.matrix(moved[0])], wanted.ravel(), atol=2e-16
    )
    other = quaternion.compose_exp(quaternion.from_pose((matrix, zeros)), tuple(0.2 * unit) + zeros)
    np.testing.assert_allclose(quaternion.matrix(other[0]), wanted.ravel(), atol=4e-16)


@pytest.mark.parametrize("n", [1, 2, 5])
def test_factored_matrices_solve(n):
    A = RNG.normal(size=(n, n))
    A, b = A @ A.T + np.eye(n), RNG.normal(size=n)
    made = Factored([[A[i, j] for j in range(i + 1)] for i in range(n)])
    np.testing.assert_allclose(made.solve(list(b)), np.linalg.solve(A, b), rtol=1e-12)
