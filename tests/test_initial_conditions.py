"""Coordinates of a joint, and poses closed by Newton's method, against matrices and definitions."""

import numpy as np
import pytest
from cases import PITCH, SUBGROUP_JOINTS, frame, integrate, joint
from scipy.linalg import expm, logm
from scipy.spatial.transform import Rotation

import lierb
from lierb.errors import ArgumentError, LierbError, PoseError

BODY = lierb.Body(2.5, [[1.2, 0.1, -0.2], [0.1, 1.0, 0.05], [-0.2, 0.05, 0.9]], (0.1, -0.2, 0.3))
OTHERS = [name for name, entry in lierb.joints.JOINTS.items() if entry.subgroup is None]
EVERY_JOINT = pytest.mark.parametrize("name", list(lierb.joints.JOINTS))

# ---- coordinates -------------------------------------------------------------------------------

NAMES = {
    "spherical": ("xi1", "xi2", "xi3"),
    "revolute": ("phi",),
    "cylindrical": ("phi", "d3"),
    "prismatic": ("d3",),
    "screw": ("phi",),
    "planar": ("phi", "d1", "d2"),
    "planar_translation": ("d1", "d2"),
    "translation": ("d1", "d2", "d3"),
    "helical_planar": ("phi", "d1", "d2"),
    "schoenflies": ("phi", "d1", "d2", "d3"),
    "free": ("xi1", "xi2", "xi3", "d1", "d2", "d3"),
}
HELICAL = ("screw", "helical_planar")


def relative(held, pose):
    return np.linalg.inv(held.ground_frame) @ pose @ held.body_frame


def expected_relative(name, values):
    """D of coordinates, by SciPy's rotations."""
    given = dict(zip(NAMES[name], values, strict=True))
    turn = [given.get(f"xi{i}", 0.0) for i in (1, 2, 3)]
    turn[2] += given.get("phi", 0.0)
    D = np.eye(4)
    D[:3, :3] = Rotation.from_rotvec(turn).as_matrix()
    D[:3, 3] = [given.get(f"d{i}", 0.0) for i in (1, 2, 3)]
    if name in HELICAL:
        D[2, 3] = PITCH * given["phi"]
    return D


def test_every_group_has_coordinates():
    assert set(NAMES) == set(SUBGROUP_JOINTS)


@pytest.mark.parametrize("name", NAMES)
def test_pose_is_where_its_coordinates_say(name):
    held, rng = joint(name), np.random.default_rng(3)
    assert held.coordinate_names == NAMES[name]
    for _ in range(20):
        values = rng.uniform(-1.7, 1.7, size=len(NAMES[name]))  # ‖ξ‖ < π
        pose = held.pose(values)
        # products of three 4×4 matrices
        np.testing.assert_allclose(
            relative(held, pose), expected_relative(name, values), rtol=0, atol=5e-15
        )
        np.testing.assert_allclose(held.coordinates(pose), values, rtol=0, atol=2e-14)


@pytest.mark.parametrize("name", NAMES)
def test_coordinates_of_a_batch_are_those_of_its_members(name):
    held, rng = joint(name), np.random.default_rng(4)
    values = rng.uniform(-1.0, 1.0, size=(5, len(NAMES[name])))
    poses = held.pose(values)
    assert poses.shape == (5, 4, 4)
    found = held.coordinates(poses)
    for i in range(5):
        np.testing.assert_array_equal(poses[i], held.pose(values[i]))
        np.testing.assert_array_equal(found[i], held.coordinates(poses[i]))


@pytest.mark.parametrize("turns", [-3, 0, 7])
@pytest.mark.parametrize("name", HELICAL)
def test_screw_counts_its_turns(name, turns):
    held = joint(name)
    values = np.array([2 * np.pi * turns + 1.0, 0.3, -0.2][: len(NAMES[name])])
    assert held.coordinates(held.pose(values)) == pytest.approx(values, abs=1e-12)


def test_screw_without_pitch_does_not_count():
    held = lierb.joints.screw(pitch=0.0)
    assert held.coordinates(held.pose([2 * np.pi + 1.0])) == pytest.approx([1.0], abs=1e-15)


@pytest.mark.parametrize("name", OTHERS)
def test_joint_without_a_group_has_no_coordinates(name):
    for call in (
        lambda held: held.coordinate_names,
        lambda held: held.coordinates(np.eye(4)),
        lambda held: held.pose([0.0]),
    ):
        with pytest.raises(ArgumentError, match="no coordinates"):
            call(joint(name))


def test_wrong_number_of_coordinates_is_refused():
    with pytest.raises(ArgumentError, match="coordinates has shape"):
        joint("planar").pose([0.1, 0.2])


# ---- closing -----------------------------------------------------------------------------------


def hat(w):
    """The matrix of w ×."""
    return np.cross(w, np.eye(3)).T


def off_the_joint(held, seed, size):
    """The closed pose, moved by a random screw motion."""
    motion = size * np.random.default_rng(seed).uniform(-1, 1, size=6)
    screw = np.zeros((4, 4))
    screw[:3, :3], screw[:3, 3] = hat(motion[:3]), motion[3:]
    return held.closed_pose @ expm(screw)


def violation(name, held, pose):
    """How far D is off the joint, from its definition."""
    D = relative(held, pose)
    Q, d = D[:3, :3], D[:3, 3]
    slip, whole_turn = d[2] - PITCH * np.arctan2(Q[1, 0], Q[0, 0]), 2 * np.pi * PITCH
    rows = {
        **{f"d{i + 1}": d[i] for i in range(3)},
        **{f"Qtd{i + 1}": (Q.T @ d)[i] for i in range(3)},
        "Q32": Q[2, 1],
        "Q23": Q[1, 2],
        "screw": slip - whole_turn * np.round(slip / whole_turn),
        "rod": np.linalg.norm(d) - held.length,
        "cv": Rotation.from_matrix(Q).as_rotvec()[2],
    }
    names = [str(row) for row in held.rows]
    errors = [rows[n] for n in names if not n.startswith("Omega")]
    if names.count("Omega3"):
        errors += list(np.real(logm(Q)).ravel())
    elif names.count("Omega1"):
        errors += list(Q[2, :2])
    return np.abs(errors).max(initial=0.0)


@EVERY_JOINT
@pytest.mark.parametrize("size", [1e-6, 0.1, 0.6])
def test_closed_pose_meets_the_joint(name, size):
    held = joint(name)
    problem = lierb.Problem(BODY, held)
    for seed in range(5):
        start = off_the_joint(held, seed, size)
        pose = problem.close(start)
        assert violation(name, held, pose) < 2e-13
        assert np.abs(pose[:3, :3].T @ pose[:3, :3] - np.eye(3)).max() < 2e-15
        # nowhere but near: no further than a few times as far as the joint was off
        assert np.abs(pose - start).max() < 4 * size


@EVERY_JOINT
def test_closing_a_closed_pose_moves_it_by_rounding_only(name):
    held = joint(name)
    pose = lierb.Problem(BODY, held).close(held.closed_pose)
    np.testing.assert_allclose(pose, held.closed_pose, rtol=0, atol=3e-15)


def test_closing_takes_the_way_of_least_kinetic_energy():
    """Off by little, what is done is M-orthogonal to every motion that the joint allows."""
    held = lierb.joints.universal(body_frame=frame((0.3, 0.1, -0.4), (0.2, 0.1, 0.0)))
    problem = lierb.Problem(BODY, held)
    start = off_the_joint(held, 7, 1e-5)
    done = np.real(logm(np.linalg.inv(start) @ problem.close(start)))
    taken = np.array([done[2, 1], done[0, 2], done[1, 0], *done[:3, 3]])
    allowed = problem.project(np.random.default_rng(8).normal(size=(5, 6)), start)
    m, c = float(BODY.mass), BODY.com
    c_hat = hat(c)
    mass = np.block([[BODY.inertia, m * c_hat], [-m * c_hat, m * np.eye(3)]])
    # 1e-5 off: orthogonal to first order, so to 1e-10 of numbers of size 1
    np.testing.assert_allclose(allowed @ mass @ taken, 0.0, atol=1e-9)


def test_each_pose_of_a_batch_is_closed_as_alone():
    held = joint("universal")
    problem = lierb.Problem(BODY, held)
    starts = np.array([off_the_joint(held, seed, 10.0**-seed) for seed in range(1, 6)])
    together = problem.close(starts)
    for start, pose in zip(starts, together, strict=True):
        np.testing.assert_array_equal(pose, problem.close(start))


def test_closed_pose_and_projected_twist_are_what_integrate_accepts():
    held = joint("universal")
    problem = lierb.Problem(BODY, held)
    pose = problem.close(off_the_joint(held, 9, 0.3))
    twist = problem.project((1.0, 2.0, 3.0, 0.4, 0.5, 0.6), pose)
    result = integrate(problem, pose0=pose, twist0=twist, dt=1e-2, t_end=0.02)
    assert result.summary["status"].to_pylist() == ["ok"]


def test_hopeless_start_is_an_error():
    held = lierb.joints.point_on_sphere(length=1.0)
    start = np.eye(4)  # the end of the rod at its own beginning: no way is the shortest
    with pytest.raises(PoseError, match="start nearer"):
        lierb.Problem(BODY, held).close(start)


def test_hopeless_member_of_a_batch_is_named():
    held = lierb.joints.point_on_sphere(length=1.0)
    with pytest.raises(PoseError, match=r"pose\[1\]"):
        lierb.Problem(BODY, held).close([held.closed_pose, np.eye(4)])


@pytest.mark.parametrize("given", [np.zeros((4, 4)), np.eye(3), "here"])
def test_what_is_no_pose_is_refused(given):
    with pytest.raises(LierbError):
        lierb.Problem(BODY, joint("revolute")).close(given)
