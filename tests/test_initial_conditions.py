"""Coordinates of a joint, and poses closed by Newton's method, against matrices and definitions."""

import numpy as np
import oracle
import pytest
from cases import PITCH, SUBGROUP_JOINTS, column, frame, integrate, joint, slow_but
from scipy.linalg import expm, logm
from scipy.spatial.transform import Rotation

import lierb
from lierb.compiler.entries import kernels_loaded
from lierb.errors import ArgumentError, LierbError, PoseError

BODY = lierb.Body(2.5, [[1.2, 0.1, -0.2], [0.1, 1.0, 0.05], [-0.2, 0.05, 0.9]], (0.1, -0.2, 0.3))
PRODUCTS = [name for name, entry in lierb.joints.JOINTS.items() if entry.factors]
OTHERS = [n for n in lierb.joints.JOINTS if n not in (*SUBGROUP_JOINTS, *PRODUCTS)]
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
    "universal": ("alpha", "beta"),
    "hook": ("alpha", "beta"),
    "pin_in_slot": ("d1", "phi"),
    "pin_in_slot_body": ("phi", "s"),
}
EULER = {"universal": "ZY", "hook": "YZ"}  # axes that turn with the body
HELICAL = ("screw", "helical_planar")


def relative(held, pose):
    return np.linalg.inv(held.ground_frame) @ pose @ held.body_frame


def expected_relative(name, values):
    """D of coordinates, by SciPy's rotations."""
    given = dict(zip(NAMES[name], values, strict=True))
    if name in EULER:
        D = np.eye(4)
        D[:3, :3] = Rotation.from_euler(EULER[name], values).as_matrix()
        return D
    turn = [given.get(f"xi{i}", 0.0) for i in (1, 2, 3)]
    turn[2] += given.get("phi", 0.0)
    D = np.eye(4)
    D[:3, :3] = Rotation.from_rotvec(turn).as_matrix()
    D[:3, 3] = [given.get(f"d{i}", 0.0) for i in (1, 2, 3)]
    if name == "pin_in_slot_body":
        D[:3, 3] = given["s"] * D[:3, 0]
    if name in HELICAL:
        D[2, 3] = PITCH * given["phi"]
    return D


def test_every_group_and_product_has_coordinates():
    assert set(NAMES) == {*SUBGROUP_JOINTS, *PRODUCTS}


@pytest.mark.parametrize("name", PRODUCTS)
def test_factors_are_subgroups_of_one_freedom_whose_product_is_the_joint(name):
    """Each by its own rows; the joint's rows vanish on their product."""
    held = lierb.joints.JOINTS[name]()
    a, b = (
        lierb.joints.from_rows(factor.rows, body_frame=np.eye(4), ground_frame=np.eye(4))
        for factor in held.factors
    )
    for one in (a, b):
        assert len(one.rows) == 5
    numbers = np.array([0.4, -1.1])
    parts = [f.motion(x) for f, x in zip(held.factors, numbers, strict=True)]
    for factor, part, alone in zip(held.factors, parts, (a, b), strict=True):
        pose = lierb.support.arrays.pose_matrix(part)
        free = lierb.Problem(BODY, alone).close(pose)
        np.testing.assert_allclose(free, pose, rtol=0, atol=1e-15)  # its own rows: nothing to close
        assert np.flatnonzero(np.array(factor.twist(1.0), dtype=float)).tolist() == [factor.slot]
    product = lierb.support.arrays.pose_matrix(parts[0]) @ lierb.support.arrays.pose_matrix(
        parts[1]
    )
    np.testing.assert_allclose(held.pose(numbers), product, rtol=0, atol=1e-15)
    closed = lierb.Problem(BODY, held).close(product)
    np.testing.assert_allclose(closed, product, rtol=0, atol=1e-14)


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
    if name == "fixed":
        assert joint(name).coordinate_names == ()
    else:
        with pytest.raises(ArgumentError, match="no coordinates"):
            _ = joint(name).coordinate_names
    for call in (
        lambda held: held.coordinates(np.eye(4)),
        lambda held: held.pose([0.0]),
        lambda held: held.velocities(np.zeros(6)),
        lambda held: held.twist(velocities=[0.0]),
    ):
        with pytest.raises(ArgumentError, match="no coordinates"):
            call(joint(name))


def test_wrong_number_of_coordinates_is_refused():
    with pytest.raises(ArgumentError, match="coordinates has shape"):
        joint("planar").pose([0.1, 0.2])


# ---- rates of coordinates ----------------------------------------------------------------------

STEP = 1e-3
# Central differences of order 4: STEP⁴ times fifth derivatives of up to a few hundred, and rounding
# of 1e-14/STEP.
DIFFERENCED = 1e-9


def derivative(function):
    """dx/dt at t = 0, by central differences."""
    ahead, before = (function(s * STEP) - function(-s * STEP) for s in (1, 2))
    return (8 * ahead - before) / (12 * STEP)


def moved(pose, twist, t):
    """C exp(tV)."""
    screw = np.zeros((4, 4))
    screw[:3, :3], screw[:3, 3] = hat(twist[:3]), twist[3:]
    return pose @ expm(t * screw)


def hat(w):
    """The matrix of w ×."""
    return np.cross(w, np.eye(3)).T


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("seed", slow_but([11, 12, 13], 11))
def test_velocities_are_the_rates_of_coordinates_along_the_motion(name, seed):
    held, rng = joint(name), np.random.default_rng(seed)
    k = len(NAMES[name])
    pose = held.pose(rng.uniform(-1.7, 1.7, size=k))  # far from closed; ‖ξ‖ < π
    rates = rng.uniform(-2.0, 2.0, size=k)
    twist = held.twist(velocities=rates, pose=pose)
    found = derivative(lambda t: held.coordinates(moved(pose, twist, t)))
    np.testing.assert_allclose(found, rates, rtol=0, atol=DIFFERENCED)
    if name in SUBGROUP_JOINTS:  # it stays on the joint: nothing moves but the coordinates
        later = moved(pose, twist, 0.01)
        np.testing.assert_allclose(held.pose(held.coordinates(later)), later, rtol=0, atol=1e-14)
    # products of some matrices, and dexp of up to 3 rad
    np.testing.assert_allclose(held.velocities(twist, pose), rates, rtol=0, atol=1e-13)


@pytest.mark.parametrize("name", NAMES)
def test_velocities_at_given_coordinates_are_the_rates_of_the_pose(name):
    """Rotation vectors beyond π, too, whose pose has another one."""
    held, rng = joint(name), np.random.default_rng(12)
    values, rates = (rng.uniform(-3.5, 3.5, size=len(NAMES[name])) for _ in range(2))
    twist = held.twist(velocities=rates, coordinates=values)
    change = np.linalg.inv(held.pose(values)) @ derivative(lambda t: held.pose(values + t * rates))
    omega = (change[2, 1], change[0, 2], change[1, 0])
    np.testing.assert_allclose(twist, (*omega, *change[:3, 3]), rtol=0, atol=DIFFERENCED)


def test_velocities_follow_the_integrated_motion():
    held = joint("spherical")
    problem = lierb.Problem(BODY, held, (0.0, 0.0, -9.81))
    values, rates = (0.4, -0.9, 1.3), (1.0, 2.0, -1.5)
    run = integrate(
        problem, pose0=held.pose(values), twist0=held.twist(velocities=rates, coordinates=values),
        dt=STEP, t_end=0.1, save_every=1,
    )  # fmt: skip
    poses = np.tile(np.eye(4), (101, 1, 1))
    poses[:, :3, :3] = column(run.history, "rotation").reshape(-1, 3, 3)
    poses[:, :3, 3] = column(run.history, "position")
    twists = np.hstack([column(run.history, "omega"), column(run.history, "v")])
    along, found = held.coordinates(poses), held.velocities(twists, poses)
    np.testing.assert_allclose(found[0], rates, rtol=0, atol=1e-13)
    ahead, before = along[3:-1] - along[1:-3], along[4:] - along[:-4]
    differenced = (8 * ahead - before) / (12 * STEP)
    # as above; RK4's own error of a step is the smaller
    np.testing.assert_allclose(found[2:-2], differenced, rtol=0, atol=10 * DIFFERENCED)


def test_velocities_of_a_batch_are_those_of_its_members():
    held, rng = joint("free"), np.random.default_rng(13)
    values, rates = (rng.uniform(-1.0, 1.0, size=(4, 6)) for _ in range(2))
    poses = held.pose(values)
    twists = held.twist(velocities=rates, pose=poses)
    found = held.velocities(twists, poses)
    for i in range(4):
        np.testing.assert_array_equal(twists[i], held.twist(velocities=rates[i], pose=poses[i]))
        np.testing.assert_array_equal(found[i], held.velocities(twists[i], poses[i]))
    one = held.twist(velocities=rates[0], coordinates=values)  # the same rates everywhere
    np.testing.assert_array_equal(one[0], held.twist(velocities=rates[0], coordinates=values[0]))


def test_closed_joint_is_meant_where_no_pose_is_given():
    held = joint("cylindrical")
    twist = held.twist(velocities=(2.0, 0.5))
    np.testing.assert_allclose(held.velocities(twist), (2.0, 0.5), rtol=0, atol=1e-15)
    again = held.twist(velocities=(2.0, 0.5), coordinates=(0.0, 0.0))
    np.testing.assert_allclose(twist, again, rtol=0, atol=1e-15)  # its pose is rounded


@pytest.mark.parametrize("name", ["spherical", "free"])
def test_rates_of_a_rotation_vector_are_its_derivative(name):
    """Right: central differences of the pose. The docstrings say so."""
    machine = lierb.Mechanism(lierb.Link("ball", BODY, joint(name)))
    start = np.array((0.8, -0.5, 1.1, 0.1, 0.2, 0.3))[: len(joint(name).coordinate_names)]
    rates, h = np.array((0.3, 1.0, -2.0, 1.0, 2.0, 3.0))[: len(start)], 1e-5
    pose = machine.pose({"ball": start})
    twist = machine.twist({"ball": rates}, pose)["ball"]
    before, after = (machine.pose({"ball": start + s * h * rates})["ball"] for s in (-1.0, 1.0))
    moving = np.linalg.solve(pose["ball"], after - before) / (2.0 * h)
    found = [moving[2, 1], moving[0, 2], moving[1, 0], *moving[:3, 3]]
    np.testing.assert_allclose(twist, found, rtol=0, atol=1e-8)  # h² of 30 1/s³, ε/h
    for function in (lierb.Mechanism.twist, lierb.joints.Joint.twist):
        assert "dξ/dt" in function.__doc__


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"velocities": (1.0,), "omega": (0, 0, 1)}, "velocities or omega"),
        ({"velocities": (1.0,), "point_velocity": (0, 0, 1)}, "velocities or point_velocity"),
        (
            {"velocities": ((1.0, 2.0),)},
            r"velocities has shape \(1, 2\); expected a number.* of phi",
        ),
        ({"velocities": (1.0,), "pose": np.eye(4), "coordinates": (1.0,)}, "pose or coordinates"),
        ({"velocities": np.ones((2, 1)), "coordinates": np.ones((4, 1))}, "differ in their number"),
    ],
)
def test_velocities_that_make_no_twist_are_refused(given, told):
    with pytest.raises(ArgumentError, match=told):
        joint("revolute").twist(**given)


# ---- rotations, and shapes with two readings ---------------------------------------------------

TURN = Rotation.from_rotvec((0.3, -1.1, 0.8))
TURNS = Rotation.from_rotvec([(0.3, -1.1, 0.8), (0.1, 0.2, 0.3), (1.0, 0.0, -1.0)])


def test_pose_takes_a_rotation_that_says_that_it_is_one():
    held = joint("spherical")
    expected = held.pose(TURN.as_rotvec())
    for given in (
        held.pose(TURN),
        held.pose(rotation=TURN),
        held.pose(rotation=TURN.as_matrix()),
        held.pose(TURN.as_matrix()[None])[0],
    ):
        np.testing.assert_allclose(given, expected, rtol=0, atol=1e-15)
    three = held.pose(coordinates=TURNS.as_rotvec())
    np.testing.assert_allclose(three[0], expected, rtol=0, atol=1e-15)
    np.testing.assert_allclose(held.pose(TURNS), three, rtol=0, atol=1e-15)
    np.testing.assert_allclose(held.pose(TURNS.as_matrix()), three, rtol=0, atol=1e-15)


def test_pose_refuses_what_may_be_a_matrix_or_three_rotation_vectors():
    for given in (TURN.as_matrix(), TURNS.as_rotvec()):
        with pytest.raises(ArgumentError, match=r"\(3, 3\).*rotation=R.*coordinates=xi"):
            joint("spherical").pose(given)
    assert joint("planar").pose(np.ones((3, 3))).shape == (3, 4, 4)  # which turns about an axis


@pytest.mark.parametrize("name", ["revolute", "planar", "free"])
def test_pose_takes_a_rotation_only_of_a_joint_that_turns_about_a_point(name):
    with pytest.raises(ArgumentError, match="takes no rotation: its coordinates are"):
        joint(name).pose(TURN)


def test_pose_needs_coordinates_or_a_rotation():
    held = joint("spherical")
    for given in ({}, {"coordinates": (0, 0, 0), "rotation": TURN}):
        with pytest.raises(ArgumentError, match="one of the two"):
            held.pose(**given)
    with pytest.raises(PoseError, match="is a reflection"):
        held.pose(rotation=-np.eye(3))


@pytest.mark.parametrize("shape", [(3, 3), (5, 3, 3)])
def test_rotation_in_place_of_a_pose_is_told_both_ways(shape):
    given = np.broadcast_to(np.eye(3), shape)
    problem = lierb.Problem(BODY, joint("spherical"))
    for call in (
        lambda: lierb.integrate(problem, twist0=np.zeros(6), pose0=given, dt=1e-2, t_end=1.0),
        lambda: problem.close(given),
        lambda: problem.joint.coordinates(given),
        lambda: lierb.joints.spherical(body_frame=given),
    ):
        with pytest.raises(ArgumentError, match=r"C\[:3, :3\] = R.*joint.pose\(rotation=R\)"):
            call()


def test_a_single_coordinate_may_be_a_number():
    hinge = joint("revolute")
    np.testing.assert_array_equal(hinge.pose(0.5), hinge.pose([0.5]))
    np.testing.assert_array_equal(hinge.pose(coordinates=[0.1, 0.2]), hinge.pose([[0.1], [0.2]]))
    np.testing.assert_array_equal(
        hinge.twist(velocities=2.0, coordinates=0.5), hinge.twist(velocities=[2.0])
    )
    with pytest.raises(ArgumentError, match=r"expected \(2,\) or \(n, 2\), of alpha, beta"):
        joint("universal").pose(0.5)


def test_frames_take_rotations():
    held = lierb.joints.revolute(body_frame=TURN, ground_frame=TURN)
    np.testing.assert_array_equal(held.body_frame[:3, :3], TURN.as_matrix())
    np.testing.assert_array_equal(held.ground_frame[:3, 3], np.zeros(3))


@pytest.mark.parametrize(
    "function",
    [
        lierb.integrate, lierb.fit, lierb.propagate, lierb.predict, lierb.convergence,
        lierb.Problem.close, lierb.joints.JointType.__call__, lierb.joints.from_rows,
        lierb.joints.Joint.coordinates,
    ],
)  # fmt: skip
def test_docstrings_of_poses_and_frames_mention_rotations(function):
    assert ": array_like, Rotation or RigidTransform, " in function.__doc__


# ---- closing -----------------------------------------------------------------------------------


def off_the_joint(held, seed, size):
    """The closed pose, moved by a random screw motion."""
    motion = size * np.random.default_rng(seed).uniform(-1, 1, size=6)
    screw = np.zeros((4, 4))
    screw[:3, :3], screw[:3, 3] = hat(motion[:3]), motion[3:]
    return held.closed_pose @ expm(screw)


def violation(name, held, pose):
    """Residual of D in the joint, from its definition."""
    D = relative(held, pose)
    sizes = oracle.sizes_of(name, pitch=float(held.pitch), length=float(held.length))
    return max((abs(float(h)) for h in oracle.row_values(name, D, **sizes)), default=0.0)


@EVERY_JOINT
@pytest.mark.parametrize("size", slow_but([1e-6, 0.1, 0.6], 0.6))
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


def test_twist_may_be_left_out_for_a_start_from_rest():
    """A body falls from rest: r = g t²/2, exactly by RK4."""
    flight = lierb.Problem(
        lierb.bodies.sphere(0.1, mass=1.0), lierb.joints.free(), (0.0, 0.0, -9.81)
    )
    result = lierb.integrate(flight, dt=0.1, t_end=1.0)
    assert result.position[0, 2] == pytest.approx(-0.5 * 9.81, abs=1e-14)
    with pytest.raises(ArgumentError, match="give its twist0 too"):
        lierb.integrate(flight, pose0=result.end["pose0"], t0=1.0, dt=0.1, t_end=2.0)


@lierb.observable
def late(t):
    return t


def test_a_first_start_off_its_joint_is_refused_before_a_kernel_is_compiled():
    before, off = kernels_loaded(), np.eye(4)
    off[0, 3] = 0.5
    problem = lierb.Problem(BODY, lierb.joints.hook(), observables=late())
    with pytest.raises(PoseError, match="does not close the hook joint"):
        lierb.integrate(problem, pose0=off, dt=0.01, t_end=0.1)
    assert kernels_loaded() == before


@pytest.mark.parametrize("shape", [(4,), (7,), (3, 4), (2, 7)])
def test_quaternions_are_refused_with_their_two_orders(shape):
    problem = lierb.Problem(BODY, lierb.joints.free())
    with pytest.raises(ArgumentError, match=r"from_quat\(q\), for q = \(x, y, z, w\), or with sc"):
        lierb.integrate(problem, pose0=np.ones(shape), dt=0.1, t_end=0.1)
