"""Mechanisms: poses and twists along the tree, loops that close, and what is refused.

Oracles: products of 4×4 matrices, derivatives of poses along time, a planar four-bar by the law of
cosines, and the saddle point by NumPy's least squares on Jacobians made by differences.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from cases import GRAVITY, LENGTH, PITCH, frame, rotation, slow_but
from scipy.linalg import block_diag, expm

import lierb
from lierb.errors import (
    ArgumentError,
    ForceError,
    PoseError,
    TwistError,
    UnknownNameError,
)
from lierb.kernels.mechanics.newton_euler import SE3
from lierb.kernels.mechanics.rows import Row

RNG = np.random.default_rng(19)
WITH_COORDINATES = [n for n, e in lierb.joints.JOINTS.items() if e.subgroup or e.factors]
EVERY_JOINT = pytest.mark.parametrize("name", list(lierb.joints.JOINTS))
STEP = 1e-3  # s: differences of fourth order, 1e-11 off


def turned_body(number: int) -> lierb.Body:
    """A box with a full inertia and its centre of mass anywhere."""
    rng = np.random.default_rng(number)
    turn, com = rotation(*rng.uniform(-1, 1, 3)), rng.uniform(-0.2, 0.2, 3)
    about_com = turn @ np.diag((0.02, 0.03, 0.04)) @ turn.T
    mass = 1.0 + number
    return lierb.Body(mass, about_com + mass * (com @ com * np.eye(3) - np.outer(com, com)), com)


def tilted_joint(name: str, number: int) -> lierb.joints.Joint:
    rng = np.random.default_rng(100 + number)
    frames = {
        which: frame(rng.uniform(-1, 1, 3), rng.uniform(-0.4, 0.4, 3))
        for which in ("body_frame", "parent_frame")
    }
    values = {"pitch": PITCH, "length": LENGTH}
    entry = lierb.joints.JOINTS[name]
    return entry(**frames, **{n: x for n, x in values.items() if n in entry.options})


def tree(first: str, second: str) -> lierb.Mechanism:
    """Two links on each other, the second one first in the list, and a third one beside."""
    return lierb.Mechanism(
        [
            lierb.Link("rod", turned_body(1), tilted_joint(second, 1), "crank"),
            lierb.Link("crank", turned_body(2), tilted_joint(first, 2)),
            lierb.Link("arm", turned_body(3), tilted_joint("revolute", 3), "crank"),
        ],
        gravity=GRAVITY,
    )


def drawn(mechanism: lierb.Mechanism, seed: int) -> dict[str, np.ndarray]:
    """Coordinates of all joints that have some; of one with three turns less than π."""
    rng = np.random.default_rng(seed)
    return {
        link.name: rng.uniform(-1.5, 1.5, len(link.joint.coordinate_names))
        for link in mechanism.links
        if link.joint.name in WITH_COORDINATES
    }


def derivative(function):
    """d/dt at t = 0."""
    ahead, before = (function(s * STEP) - function(-s * STEP) for s in (1, 2))
    return (8 * ahead - before) / (12 * STEP)


def body_fixed(pose, rate):
    """(ω, v) of C⁻¹Ċ."""
    V = np.linalg.inv(pose) @ rate
    return np.array([V[2, 1], V[0, 2], V[1, 0], *V[:3, 3]])


# ---- along the tree ----------------------------------------------------------------------------


@EVERY_JOINT
def test_pose_is_the_product_of_the_joints_along_the_tree(name):
    arm = tree("cylindrical", name)
    given = drawn(arm, 1)
    poses = arm.pose(given)
    assert list(poses) == ["rod", "crank", "arm"]
    local = {
        link.name: link.joint.pose(coordinates=given[link.name])
        if link.name in given
        else link.joint.closed_pose
        for link in arm.links
    }
    expected = {"crank": local["crank"]}
    expected |= {n: local["crank"] @ local[n] for n in ("rod", "arm")}
    for link in arm.links:
        np.testing.assert_allclose(poses[link.name], expected[link.name], rtol=0, atol=2e-15)
    np.testing.assert_array_equal(poses["crank"], local["crank"])  # on the ground: the very bits


@pytest.mark.parametrize("name", WITH_COORDINATES)
def test_coordinates_and_velocities_are_the_ways_back(name):
    arm = tree("spherical", name)
    given = drawn(arm, 2)
    rates = {n: np.random.default_rng(3).uniform(-2, 2, x.shape) for n, x in given.items()}
    pose = arm.pose(given)
    twist = arm.twist(rates, pose)
    back, rates_back = arm.coordinates(pose), arm.velocities(twist, pose)
    for link in given:
        np.testing.assert_allclose(back[link], given[link], rtol=0, atol=5e-15)
        np.testing.assert_allclose(rates_back[link], rates[link], rtol=0, atol=5e-14)


@pytest.mark.parametrize("name", WITH_COORDINATES)
def test_twist_is_the_rate_of_the_pose(name):
    arm = tree("universal", name)
    given = drawn(arm, 4)
    rates = {n: np.random.default_rng(5).uniform(-2, 2, x.shape) for n, x in given.items()}
    pose = arm.pose(given)
    twist = arm.twist(rates, pose)
    for link in arm.names:

        def moved(t, link=link):
            return arm.pose({n: given[n] + t * rates[n] for n in given})[link]

        rate = derivative(moved)
        # fourth order in 1e-3 of motions at some rad/s
        np.testing.assert_allclose(twist[link], body_fixed(pose[link], rate), rtol=0, atol=3e-10)


def test_a_member_of_a_batch_has_the_bits_it_has_alone():
    """Batches of coordinates, poses and masses, through the tree, closing and projection."""
    bars = fourbar(l1=np.linspace(0.2, 0.4, 5))
    start = bars.pose({"crank": np.linspace(0.3, 0.5, 5), "rod": -0.1, "rocker": [1.7] * 5})
    start = {n: x @ lierb.lie.se3.exp(0.05 * np.ones(6)) for n, x in start.items()}
    closed = bars.close(start)
    twist = bars.twist({"crank": np.linspace(1.0, 2.0, 5)}, closed)
    along = bars.project(twist, closed)
    back = bars.coordinates(closed)
    for i in (0, 3):
        one = bars.of_body(i)
        own = {n: x[i] for n, x in start.items()}
        alone = one.close(own)
        for n in bars.names:
            np.testing.assert_array_equal(alone[n], closed[n][i])
            projected = one.project({k: v[i] for k, v in twist.items()}, alone)
            np.testing.assert_array_equal(projected[n], along[n][i])
            np.testing.assert_array_equal(one.coordinates(alone)[n], back[n][i])


def test_a_number_or_one_for_each_is_enough_for_one_coordinate():
    arm = tree("revolute", "spherical")
    several = arm.pose({"crank": [0.1, 0.2, 0.3], "arm": 0.4})
    assert several["crank"].shape == several["arm"].shape == (3, 4, 4)
    for i, angle in enumerate((0.1, 0.2, 0.3)):
        one = arm.pose({"crank": (angle,), "arm": [0.4]})
        np.testing.assert_array_equal(one["rod"], several["rod"][i])


def test_a_rotation_or_a_whole_pose_stands_for_coordinates():
    arm = tree("spherical", "point_on_line")
    R, C = rotation(0.4, 0.1, -0.3), frame((0.2, 0.3, 0.4), (1.0, 2.0, 3.0))
    poses = arm.pose({"crank": R[None], "rod": C})
    np.testing.assert_allclose(
        poses["crank"][0], arm.link("crank").joint.pose(rotation=R), rtol=0, atol=0
    )
    np.testing.assert_array_equal(poses["rod"], C[None])
    np.testing.assert_array_equal(arm.coordinates(poses)["rod"], C[None])
    twist = arm.twist({"rod": np.arange(6.0)}, poses)
    np.testing.assert_array_equal(twist["rod"], np.arange(6.0)[None])
    np.testing.assert_array_equal(arm.velocities(twist, poses)["rod"], np.arange(6.0)[None])


def test_a_link_without_rates_moves_with_its_parent():
    """V = Ad(C⁻¹ C_parent) V_parent, whatever its joint."""
    arm = tree("free", "constant_velocity")
    pose = arm.pose(drawn(arm, 6))
    twist = arm.twist({"crank": np.arange(1.0, 7.0)}, pose)
    for link in ("rod", "arm"):
        seen = np.linalg.inv(pose[link]) @ pose["crank"]
        expected = lierb.lie.se3.Ad(seen, twist["crank"])
        np.testing.assert_allclose(twist[link], expected, rtol=0, atol=1e-14)


def test_parent_frames_are_ground_frames_by_another_name():
    a = lierb.joints.revolute(parent_point=(1.0, 2.0, 3.0), axis=(1.0, 1.0, 0.0))
    b = lierb.joints.revolute(ground_point=(1.0, 2.0, 3.0), axis=(1.0, 1.0, 0.0))
    np.testing.assert_array_equal(a.ground_frame, b.ground_frame)
    c = lierb.joints.from_rows(["d1"], parent_frame=frame((0.1, 0.2, 0.3), (1, 2, 3)))
    np.testing.assert_array_equal(c.ground_frame, frame((0.1, 0.2, 0.3), (1, 2, 3)))
    with pytest.raises(ArgumentError, match="ground_point or parent_point"):
        lierb.joints.spherical(ground_point=(0, 0, 0), parent_point=(0, 0, 0))


# ---- loops -------------------------------------------------------------------------------------


def fourbar(l1=0.3, l2=0.8, l3=0.6, base=0.9, loop="revolute", turn=(0.0, 0.0, 0.0), speed=None):
    """Crank, rod and rocker in a general plane; bars along e₁, joints about e₃."""
    tilt = frame(turn, (0.5, -2.0, 1.0))

    def at(x):
        place = np.zeros((*np.shape(x), 3))
        place[..., 0] = x
        return place

    def hinge(body, parent):
        return lierb.joints.revolute(body, parent_point=parent)

    ground = [lierb.joints.revolute(-at(0.5 * np.asarray(x))) for x in (l1, l3)]
    held = [
        lierb.joints.revolute(
            body_frame=joint.body_frame, parent_frame=tilt @ frame((0, 0, 0), (x, 0, 0))
        )
        for joint, x in zip(ground, (0.0, base), strict=True)
    ]
    half = [0.5 * np.asarray(x) for x in (l1, l2, l3)]
    links = [
        lierb.Link("crank", turned_body(1), held[0]),
        lierb.Link("rod", turned_body(2), hinge(-at(half[1]), at(half[0])), "crank"),
        lierb.Link("rocker", turned_body(3), held[1]),
    ]
    pin = getattr(lierb.joints, loop)(at(half[2]), parent_point=at(half[1]))
    forces = () if speed is None else lierb.forces.motor(speed=speed).on("crank")
    return lierb.Mechanism(links, lierb.Loop("pin", pin, "rocker", "rod"), GRAVITY, forces)


def expected_fourbar(crank, l1=0.3, l2=0.8, l3=0.6, base=0.9):
    """Angles of rod (from the crank) and rocker, rod above: two circles meet."""
    a = l1 * np.array((np.cos(crank), np.sin(crank)))
    line = np.array((base, 0.0)) - a
    span = np.hypot(*line)
    along = (l2**2 - l3**2 + span**2) / (2 * span)
    up = np.sqrt(l2**2 - along**2)
    e = line / span
    b = a + along * e + up * np.array((-e[1], e[0]))
    rod = np.arctan2(*(b - a)[::-1])
    rocker = np.arctan2(b[1], b[0] - base)
    return rod - crank, rocker


# What a planar loop has too many of: the axes are parallel, and the rod stays in the plane.
REDUNDANT = {"revolute": 3, "spherical": 1, "universal": 2, "cylindrical": 2}


@pytest.mark.parametrize("loop", REDUNDANT)
def test_a_four_bar_closes_as_two_circles_meet(loop):
    bars = fourbar(loop=loop, turn=(0.5, -0.8, 0.3))
    start = bars.pose({"crank": 0.7, "rod": -0.1, "rocker": 1.7})
    closed = bars.close(start)
    q = {n: x.item() for n, x in bars.coordinates(closed).items()}
    rod, rocker = expected_fourbar(q["crank"])
    assert q["rod"] == pytest.approx(rod, abs=1e-12)
    assert q["rocker"] == pytest.approx(rocker, abs=1e-12)
    freedoms, redundant = bars.freedoms(closed)
    assert (freedoms, redundant) == (1, REDUNDANT[loop])
    assert bars.violation(closed, bars.twist({}, closed)) is None
    again = bars.close(closed)  # closed to rounding: as it is
    assert all(np.array_equal(again[n], closed[n]) for n in bars.names)


def off_plane(bars: lierb.Mechanism, misfit: float) -> lierb.Mechanism:
    """The four-bar with its pin off the plane on the rod, by a misfit in m."""
    (pin,) = bars.loops
    parent = frame((0, 0, 0), (0, 0, misfit)) @ pin.joint.ground_frame
    joint = lierb.joints.revolute(body_frame=pin.joint.body_frame, parent_frame=parent)
    return lierb.Mechanism(bars.links, lierb.Loop("pin", joint, pin.body, pin.parent), GRAVITY)


@pytest.mark.parametrize("misfit", [1e-13, 1e-12, 1e-10, 5e-10])
def test_a_planar_loop_closes_to_the_digits_of_its_numbers(misfit):
    """Where a run accepts the start; angles are off by less than the misfit over 0.3 m of crank."""
    bars = off_plane(fourbar(turn=(0.5, -0.8, 0.3)), misfit)
    closed = bars.close(bars.pose({"crank": [0.7, 0.9], "rod": -0.1, "rocker": 1.7}))
    q = bars.coordinates(closed)
    for i in range(2):
        rod, rocker = expected_fourbar(q["crank"][i, 0])
        assert q["rod"][i, 0] == pytest.approx(rod, abs=1e-12 + misfit / 0.3)
        assert q["rocker"][i, 0] == pytest.approx(rocker, abs=1e-12 + misfit / 0.3)
    moving = bars.project({n: np.ones(6) for n in bars.names}, closed)
    assert bars.violation(closed, moving) is None
    held = bars.close(closed, hold={"crank": [1.1]})
    assert bars.coordinates(held)["crank"] == pytest.approx(np.full((2, 1), 1.1), abs=misfit / 0.3)
    assert bars.violation(held, bars.twist({}, held)) is None


@pytest.mark.parametrize("misfit", [1e-8, 1e-5])
def test_close_asks_for_digits_where_a_planar_loop_does_not_fit(misfit):
    bars = off_plane(fourbar(), misfit)
    with pytest.raises(PoseError, match=r"axes match, to 1e-09: give .* more digits") as caught:
        bars.close(bars.pose({"crank": 0.7, "rod": -0.1, "rocker": 1.7}))
    assert "may not reach" not in str(caught.value)


def test_close_tells_of_what_does_not_beside_a_motor_of_given_speed():
    """Whose row is of velocities alone."""
    crank = lierb.Link("crank", lierb.Body(1.0, (1.0, 1.0, 1.0)), lierb.joints.revolute())
    driven = lierb.Mechanism([crank], forces=lierb.forces.motor(speed=1.0).on("crank"))
    far = np.eye(4)
    far[1, 3] = 1e30
    with pytest.raises(PoseError, match=r"the joint of crank .* stays open by 1e\+30 m"):
        driven.close({"crank": far})


def test_close_takes_what_is_off_in_every_direction():
    """Also off the plane, where redundant rows contradict each other on the way."""
    bars = fourbar(turn=(0.5, -0.8, 0.3))
    rng = np.random.default_rng(7)
    near = bars.close(bars.pose({"crank": 0.7, "rod": -0.1, "rocker": 1.7}))
    pose = {n: x @ lierb.lie.se3.exp(rng.uniform(-0.1, 0.1, (20, 6))) for n, x in near.items()}
    closed = bars.close(pose)
    angles = bars.coordinates(closed)
    for i in range(20):
        rod, rocker = expected_fourbar(angles["crank"][i, 0])
        assert angles["rod"][i, 0] == pytest.approx(rod, abs=1e-12)
        assert angles["rocker"][i, 0] == pytest.approx(rocker, abs=1e-12)
    assert bars.violation(closed, bars.twist({}, closed)) is None


def bricard() -> lierb.Mechanism:
    """Six links of 1 m, each joint's axis normal to the next one's: Bricard's, with one freedom
    where Grübler counts none. The sixth link is the ground."""
    sides = [frame((turn * np.pi / 2, 0, 0), (1.0, 0, 0)) for turn in (1, -1) * 3]
    ball = lierb.bodies.sphere(0.1, mass=1.0)
    links = [
        lierb.Link(
            f"l{i}",
            ball,
            lierb.joints.revolute(
                body_frame=np.eye(4), parent_frame=sides[i - 1] if i else np.eye(4)
            ),
            f"l{i - 1}" if i else "ground",
        )
        for i in range(5)
    ]
    last = lierb.joints.revolute(body_frame=sides[4], parent_frame=np.linalg.inv(sides[5]))
    return lierb.Mechanism(links, lierb.Loop("last", last, "l4"))


def test_bricard_closes_from_afar_and_moves():
    """Angles alternate, as the linkage's symmetry has them: ±π/2 is one of its places."""
    linkage, rng = bricard(), np.random.default_rng(0)
    place = np.array((1, -1, 1, -1, 1)) * np.pi / 2
    starts = place + rng.uniform(-0.5, 0.5, (4, 5))
    pose = linkage.close(linkage.pose({f"l{i}": starts[:, i] for i in range(5)}))
    assert linkage.violation(pose, linkage.twist({}, pose)) is None
    freedoms, redundant = linkage.freedoms(pose)
    assert freedoms.tolist() == [1] * 4
    assert redundant.tolist() == [1] * 4
    angles = np.hstack([linkage.coordinates(pose)[n] for n in linkage.names])
    # cos aᵢ + cos aᵢ₊₁ + cos aᵢ cos aᵢ₊₁ = 0 of neighbours; every second one is the same
    a, b = np.cos(angles[:, 0]), np.cos(angles[:, 1])
    np.testing.assert_allclose(a + b + a * b, 0.0, rtol=0, atol=1e-11)
    np.testing.assert_allclose(angles[:, 2:], angles[:, :3], rtol=0, atol=1e-11)


def test_members_that_are_closed_stay_as_they_are():
    bars = fourbar()
    near = bars.close(bars.pose({"crank": 0.7, "rod": -0.1, "rocker": 1.7}))
    off = lierb.lie.se3.exp(0.01 * np.ones(6))
    pose = {n: np.stack([x, x @ off]) for n, x in near.items()}
    closed = bars.close(pose)
    for n in bars.names:
        np.testing.assert_array_equal(closed[n][0], near[n])
        assert np.abs(closed[n][1] - pose[n][1]).max() > 1e-4


def test_a_tree_of_its_own_poses_is_closed():
    for name in WITH_COORDINATES:
        arm = tree("universal", name)
        pose = arm.pose(drawn(arm, 8))
        closed = arm.close(pose)
        assert all(np.array_equal(closed[n], pose[n]) for n in arm.names), name


@cache
def along(axis, t):
    """exp of t times one of the six unit twists."""
    screw, unit = np.zeros((4, 4)), np.eye(6)[axis]
    screw[:3, :3], screw[:3, 3] = np.cross(unit[:3], np.eye(3)).T, unit[3:]
    return expm(t * screw)


def jacobian(mechanism, pose):
    """Jacobian of all rows of all joints on all body-fixed twists, by differences along screws.

    Rows on D: their values' derivatives, and Ω for rows that have none.
    """
    names, rows = mechanism.names, []
    for at in mechanism.joints:
        body = mechanism.constants(at)
        p = [np.linalg.inv(at.joint.ground_frame), at.joint.body_frame]

        def relative(poses, at=at, p=p):
            parent = np.eye(4) if at.parent < 0 else poses[names[at.parent]]
            return p[0] @ np.linalg.inv(parent) @ poses[names[at.body]] @ p[1]

        def values(D, at=at, body=body):
            x = SE3.kinematics(body, lierb.support.arrays.pose_components(D), (0.0,) * 6)
            return np.array([float(r.value(x, body)) if r.has_value else 0.0 for r in at.rows])

        columns = []
        for link in names:
            for axis in range(6):

                def moved(t, link=link, axis=axis, relative=relative):
                    return relative({**pose, link: pose[link] @ along(axis, t)})

                rate = derivative(lambda t, v=values, m=moved: v(m(t)))
                omega = body_fixed(moved(0.0), derivative(moved))[:3]
                fixed = [
                    omega[r.fixed_axis] if not r.has_value else value
                    for r, value in zip(at.rows, rate, strict=True)
                ]
                columns.append(fixed)
        rows.append(np.array(columns).T)
    return np.vstack(rows)


def mass_matrix(body):
    m, c = float(body.mass), np.array(body.com)
    hat = np.cross(c, np.eye(3)).T
    return np.block([[body.inertia, m * hat], [-m * hat, m * np.eye(3)]])


@pytest.mark.parametrize("loop", ["revolute", "spherical", "point_on_sphere", "point_on_line"])
def test_projection_is_the_saddle_point_with_pseudo_inverse(loop):
    if loop in ("revolute", "spherical"):
        bars = fourbar(loop=loop, turn=(0.5, -0.8, 0.3))
        pose = bars.close(bars.pose({"crank": 0.7, "rod": -0.1, "rocker": 1.7}))
    else:
        links = tree("spherical", "universal")
        extra = lierb.Loop("extra", tilted_joint(loop, 9), "rod", "arm")
        bars = lierb.Mechanism(links.links, extra)
        pose = bars.close(bars.pose(drawn(bars, 10)))
    twist = {n: np.random.default_rng(i).uniform(-1, 1, 6) for i, n in enumerate(bars.names)}
    V = np.concatenate([twist[n] for n in bars.names])
    M = block_diag(*(mass_matrix(link.body) for link in bars.links))
    J = jacobian(bars, pose)
    easy = np.linalg.inv(M)
    # differences leave 1e-10 of redundant rows
    expected = V - easy @ J.T @ np.linalg.pinv(J @ easy @ J.T, rcond=1e-7) @ (J @ V)
    projected = bars.project(twist, pose)
    for i, n in enumerate(bars.names):
        np.testing.assert_allclose(projected[n], expected[6 * i : 6 * i + 6], rtol=0, atol=1e-8)
    assert bars.violation(pose, projected) is None


def weighing(made, masses, gyrations):
    """The mechanism with links of other masses, and radii of gyration by these factors."""
    links = [
        replace(x, body=lierb.Body(m, np.asarray(x.body.inertia) / x.body.mass * m * k * k))
        for x, m, k in zip(made.links, masses, gyrations, strict=True)
    ]
    return lierb.Mechanism(links, made.loops, made.gravity, made.forces)


@pytest.mark.parametrize("size", slow_but([1e-6, 1.0, 1e3], 1e3))
@pytest.mark.parametrize("gyration", slow_but([1e-6, 1e-3, 1.0, 1e3], 1e-6, 1e3))
def test_ranks_and_rates_do_not_depend_on_masses(size, gyration):
    lengths = {"l1": 0.3, "l2": 0.8, "l3": 0.6, "base": 0.9}
    made = planar_fourbar(size, **lengths)
    angles = expected_fourbar(0.7)
    pose = made.pose({"crank": 0.7, "rod": angles[0], "rocker": angles[1]})
    # ω of rod and rocker by the derivative of the closed form, to 1e-10 with a step of 1e-5
    step = 1e-5
    change = np.subtract(expected_fourbar(0.7 + step), expected_fourbar(0.7 - step))
    rod, rocker = 3.0 * change / (2.0 * step)
    for number in range(3):
        for mass in (1e-12, 1e-8, 1e12):
            masses, gyrations = np.ones(3), np.ones(3)
            masses[number], gyrations[number] = mass, gyration
            unequal = weighing(made, masses, gyrations)
            assert unequal.freedoms(pose) == (1, 3)
            twist = unequal.project(unequal.twist({}, pose), pose)
            rates = {n: x.item() for n, x in unequal.velocities(twist, pose).items()}
            assert rates["crank"] == pytest.approx(3.0, abs=1e-12)
            assert rates["rod"] == pytest.approx(rod, abs=1e-8)
            assert rates["rocker"] == pytest.approx(rocker, abs=1e-8)
            assert unequal.violation(pose, twist) is None


def planar_fourbar(size, l1, l2, l3, base):
    """A four-bar of rods of 1 kg about e₃, whose crank turns at 3 rad/s."""

    def at(x):
        return (x * size, 0.0, 0.0)

    bodies = [
        lierb.bodies.box((x * size, 0.01 * size, 0.01 * size), mass=1.0) for x in (l1, l2, l3)
    ]
    revolute = lierb.joints.revolute
    return lierb.Mechanism(
        [
            lierb.Link("crank", bodies[0], revolute(at(-l1 / 2))),
            lierb.Link("rod", bodies[1], revolute(at(-l2 / 2), parent_point=at(l1 / 2)), "crank"),
            lierb.Link("rocker", bodies[2], revolute(at(-l3 / 2), ground_point=at(base))),
        ],
        lierb.Loop("pin", revolute(at(l3 / 2), parent_point=at(l2 / 2)), "rocker", "rod"),
        forces=lierb.forces.motor(speed=3.0).on("crank"),
    )


def test_projection_is_of_least_energy_with_unequal_masses():
    """A wheel at the end of a rod: an impulse at the hub, and none about its axis."""
    rod = lierb.bodies.box((1.0, 0.01, 0.01), mass=1.0)
    wheel = lierb.bodies.cylinder(0.1, 0.02, mass=1.0)
    free = lierb.joints.free()
    hub = lierb.joints.revolute(parent_point=(0.5, 0.0, 0.0))
    made = lierb.Mechanism([lierb.Link("rod", rod, free), lierb.Link("wheel", wheel, hub, "rod")])
    for mass in (1e-12, 1e-6, 1e6, 1e12):
        unequal = weighing(made, (1.0, mass), (1.0, 1e-3))
        pose = unequal.pose()
        twist = {"rod": np.array((0, 0, 0.3, 0, 0, 0)), "wheel": np.array((0, 0, 2.0, 0, 0.4, 0))}
        projected = unequal.project(twist, pose)
        heavy = float(unequal.link("rod").body.inertia[2, 2])
        # impulse J along e₂ at the hub: v_w' = 0.4 − J/m, v_r' = J/1, ω' = 0.3 + 0.5 J/I
        impulse = (0.4 - 0.15) / (1.0 / mass + 1.0 + 0.25 / heavy)
        np.testing.assert_allclose(projected["rod"][[2, 4]], (0.3 + 0.5 * impulse / heavy, impulse),
                                   rtol=0, atol=1e-12)  # fmt: skip
        assert projected["wheel"][2] == pytest.approx(
            2.0, abs=1e-9
        )  # 1e-16 of the rod's, 1e9 times as heavy


def folded(size):
    """A parallelogram, whose flat pose is a change point."""
    made = planar_fourbar(size, 0.2, 0.5, 0.2, 0.5)
    return lierb.Mechanism(made.links, made.loops)


@pytest.mark.parametrize(
    "offset", slow_but([0.0, 1e-12, 1e-9, 1e-8, 3e-8, 1e-7, 3e-7, 1e-6, 1e-3], 0.0, 3e-8, 1e-6)
)
def test_a_projected_twist_is_accepted_near_a_singular_pose(offset):
    for size in (1e-3, 1.0):
        made = folded(size)
        for flat in (0.0, np.pi):
            angle = flat + offset
            pose = made.pose({"crank": angle, "rod": -angle, "rocker": angle})
            for _ in range(3):
                scale = np.repeat((1.0, size), 3)
                twist = made.project({n: scale * RNG.uniform(-1, 1, 6) for n in made.names}, pose)
                assert made.violation(pose, twist) is None
                assert max(np.abs(twist[n][2]) for n in made.names) > 1e-3  # it still moves


def slider_crank(width=0.02, misfit=0.0):
    """Crank of 0.1 m, rod of 0.3 m, slider along e₁; the pin is off the plane by a misfit in m."""
    bars = {x: lierb.bodies.box((x, width, width), density=2700.0) for x in (0.1, 0.3, 0.05)}
    revolute = lierb.joints.revolute
    rod = revolute((-0.15, 0.0, 0.0), parent_point=(0.05, 0.0, 0.0))
    return lierb.Mechanism(
        [
            lierb.Link("crank", bars[0.1], revolute((-0.05, 0.0, 0.0))),
            lierb.Link("rod", bars[0.3], rod, "crank"),
            lierb.Link("slider", bars[0.05], lierb.joints.prismatic(axis=(1.0, 0.0, 0.0))),
        ],
        lierb.Loop("pin", revolute((0.15, 0.0, misfit)), "rod", "slider"),
    )


@pytest.mark.parametrize("share", np.linspace(0.3, 1.0, 8).round(1))
def test_a_twist_is_projected_where_a_pin_is_off_its_plane(share):
    """`close` leaves gaps of up to 1e-9; rates that its rows cannot keep are as small."""
    made, angle, rate = slider_crank(0.6, share * 1e-9), 0.7, 9.0
    tilt = np.arcsin(np.sin(angle) / 3.0)
    near = {
        "crank": angle,
        "rod": -angle - tilt,
        "slider": 0.1 * np.cos(angle) + 0.3 * np.cos(tilt),
    }
    pose = made.close(made.pose(near))
    slope = np.cos(angle) / (3.0 * np.cos(tilt))  # of the rod's tilt by the crank's angle
    rates = {
        "crank": rate,
        "rod": -rate * (1.0 + slope),
        "slider": -rate * (0.1 * np.sin(angle) + 0.3 * np.sin(tilt) * slope),
    }
    twist = made.project(made.twist(rates, pose), pose)
    for name, found in made.velocities(twist, pose).items():
        assert found.item() == pytest.approx(rates[name], rel=1e-7)
    assert made.violation(pose, twist) is None
    turning = made.project(made.twist({"crank": rate}, pose), pose)
    assert made.violation(pose, turning) is None
    assert np.abs(turning["crank"][2]) > 0.1


@pytest.mark.parametrize("offset", [0.0, 1e-12, 1e-9, 1e-6])
def test_a_projected_twist_is_accepted_at_a_dead_point(offset):
    """Crank and rod in line: the slider is at rest, but for rounding."""
    made = slider_crank()
    for crank, slider in ((0.0, 0.4), (np.pi, 0.2)):
        near = {"crank": crank + offset, "rod": -crank - 1.3 * offset, "slider": slider}
        pose = made.close(made.pose(near))
        for rate in (30.0, 1e-3):
            twist = made.project(made.twist({"crank": rate}, pose), pose)
            assert made.violation(pose, twist) is None


def test_project_gives_motors_their_speed():
    bars = fourbar(speed=lambda t: 2.0 + t)
    pose = bars.close(bars.pose({"crank": 0.7, "rod": -0.1, "rocker": 1.7}))
    twist = bars.project(bars.twist({}, pose), pose, t0=0.5)
    assert bars.velocities(twist, pose)["crank"].item() == pytest.approx(2.5, abs=1e-13)
    assert bars.violation(pose, twist, 0.5) is None
    assert isinstance(bars.violation(pose, twist, 0.0), TwistError)
    assert bars.freedoms(pose).freedoms == 1  # the motor is not counted


def test_one_link_closes_and_projects_as_a_problem_does():
    held, body = tilted_joint("universal", 4), turned_body(4)
    problem = lierb.Problem(body, held)
    single = lierb.Mechanism(lierb.Link("bar", body, held))
    off = held.pose([0.3, -0.4]) @ lierb.lie.se3.exp((0.01, 0.02, -0.01, 0.02, 0.01, 0.03))
    closed = single.close({"bar": off})["bar"]
    # both close, one step of Newton's at a time: nearest up to second order of what was off
    np.testing.assert_allclose(closed, problem.close(off), rtol=0, atol=1e-3)
    twist = (1.0, 2.0, 3.0, -1.0, 0.5, 0.2)
    projected = single.project({"bar": twist}, {"bar": closed})["bar"]
    np.testing.assert_allclose(projected, problem.project(twist, closed), rtol=0, atol=1e-13)


# ---- what is wrong with a start ----------------------------------------------------------------


def test_an_open_loop_is_told_by_name_size_and_remedy():
    bars = fourbar()
    pose = bars.pose({"crank": 0.7, "rod": -0.1, "rocker": [1.7, 1.8]})
    error = bars.violation(pose, bars.twist({}, pose))
    assert isinstance(error, PoseError)
    tip = [pose["rocker"][0] @ (0.3, 0, 0, 1), pose["rod"][0] @ (0.4, 0, 0, 1)]
    opening = np.linalg.norm(tip[0] - tip[1])
    for word in (r"pose0[0]", "loop pin (revolute, rocker to rod)", f"{opening:.3g} m", "close("):
        assert word in str(error)


def test_a_twist_that_opens_the_loop_is_told():
    bars = fourbar()
    pose = bars.close(bars.pose({"crank": 0.7, "rod": -0.1, "rocker": 1.7}))
    error = bars.violation(pose, bars.twist({"crank": 1.0}, pose))
    assert isinstance(error, TwistError)
    assert "loop pin" in str(error)
    assert "project(" in str(error)


def test_lengths_that_do_not_reach_are_told():
    bars = fourbar(base=3.0)
    with pytest.raises(PoseError, match=r"stays open by .* m.*links may not reach"):
        bars.close(bars.pose())


def test_a_joint_the_wrong_way_round_is_told():
    arm = tree("revolute", "spherical")
    pose = arm.pose()
    flip = arm.link("crank").joint.body_frame
    half = flip @ frame((np.pi, 0, 0), (0, 0, 0)) @ np.linalg.inv(flip)
    turned = {n: x if n != "crank" else x @ half for n, x in pose.items()}
    alone = lierb.Mechanism(arm.link("crank"))
    error = alone.violation({"crank": turned["crank"]}, {"crank": np.zeros(6)})
    assert "the wrong way round" in str(error)


def test_a_mechanism_that_cannot_move_is_told():
    """A truss: three bars, three hinges in a plane."""
    bars = fourbar(l1=0.5, l2=0.8, l3=0.6)
    pose = bars.close(bars.pose({"crank": 0.7, "rod": -0.1, "rocker": 1.7}))
    rigid = lierb.Mechanism(
        bars.links,
        [
            *bars.loops,
            lierb.Loop(
                "weld",
                lierb.joints.fixed(
                    body_frame=np.eye(4),
                    parent_frame=np.linalg.inv(pose["crank"]) @ pose["rocker"],
                ),
                "rocker",
                "crank",
            ),
        ],
    )
    assert rigid.freedoms(pose).freedoms == 0
    error = rigid.violation(pose, rigid.twist({}, pose))
    assert "cannot move" in str(error)


def test_contradicting_motors_are_told():
    bars = fourbar()
    forces = [lierb.forces.motor(speed=1.0).on(n) for n in ("crank", "rocker")]
    driven = lierb.Mechanism(bars.links, bars.loops, forces=forces)
    pose = driven.close(driven.pose({"crank": 0.7, "rod": -0.1, "rocker": 1.7}))
    with pytest.raises(TwistError, match="contradict each other"):
        driven.project(driven.twist({}, pose), pose)


def test_motors_say_nothing_of_the_pose_that_closes():
    bars = fourbar()
    forces = [lierb.forces.motor(speed=1.0).on(n) for n in ("crank", "rocker")]
    driven = lierb.Mechanism(bars.links, bars.loops, forces=forces)
    near = bars.pose({"crank": 0.7, "rod": -0.1, "rocker": 1.7})
    closed, expected = driven.close(near), bars.close(near)
    assert all(np.array_equal(closed[name], expected[name]) for name in bars.names)


# ---- elements ----------------------------------------------------------------------------------


@lierb.constraint(length=0.7)
def apart(R, r, params):
    return (r @ r / params.length - params.length) / 2


def test_a_constraint_between_two_links_sees_one_from_the_other():
    arm = tree("spherical", "free")
    held = lierb.Mechanism(arm.links, constraints=apart().on("rod", "arm"))
    closed = held.close(held.pose(drawn(held, 11)))
    distance = np.linalg.norm(closed["rod"][:3, 3] - closed["arm"][:3, 3])
    assert distance == pytest.approx(0.7, abs=1e-12)
    twist = held.project({n: RNG.uniform(-1, 1, 6) for n in held.names}, closed)
    later = {n: closed[n] @ lierb.lie.se3.exp(1e-4 * twist[n]) for n in held.names}
    apart_later = np.linalg.norm(later["rod"][:3, 3] - later["arm"][:3, 3])
    assert apart_later == pytest.approx(0.7, abs=1e-7)  # second order in 1e-4


def test_elements_know_their_place():
    spring = lierb.forces.spring_damper(stiffness=[1.0, 2.0])
    arm = lierb.Mechanism(
        tree("revolute", "prismatic").links,
        forces=[
            spring.on("rod", "arm"), spring.on("rod"), spring.on("rod", "ground"),
            lierb.forces.motor(1.0).on("crank"), lierb.forces.slide_spring(stiffness=1.0).on("rod"),
        ],
    )  # fmt: skip
    assert arm.batch_size() == 2
    ends = [(at.body, at.parent) for at in arm.places]
    assert ends == [(0, 2), (0, -1), (0, -1), (1, -1), (0, 1)]
    assert [at.joint is not None for at in arm.places] == [False, False, False, True, True]
    assert arm.of_body(1).forces[0].parameters["stiffness"] == 2.0
    single = lierb.Mechanism(arm.link("crank"), forces=lierb.forces.motor(1.0))
    assert single.forces[0].at == ("crank",)
    assert "on crank" in repr(single.forces[0])


BALL = lierb.bodies.sphere(0.1, mass=1.0)
HINGE = lierb.joints.revolute()


def link(name="a", parent="ground", held=HINGE):
    return lierb.Link(name, BALL, held, parent)


def two(**more):
    return lierb.Mechanism([link("a"), link("b", "a", lierb.joints.spherical())], **more)


REFUSED = {
    "no links": (lambda: lierb.Mechanism([]), ArgumentError, "at least"),
    "not a link": (lambda: lierb.Mechanism([BALL]), ArgumentError, r"links\[0\] must be .*Link"),
    "cycle": (
        lambda: lierb.Mechanism([link("a", "c"), link("b", "a"), link("c", "b")]),
        ArgumentError, "cycle, a → c → b → a.*lierb.Loop",
    ),
    "own parent": (lambda: lierb.Mechanism([link("a", "a")]), ArgumentError, "cycle, a → a"),
    "two parents": (
        lambda: lierb.Mechanism([link("a"), link("b"), link("b", "a")]),
        ArgumentError, "two parts are named b.*two parents is one Link, and a Loop",
    ),
    "loop named as a link": (
        lambda: two(loops=lierb.Loop("a", HINGE, "b")), ArgumentError, "a link and a loop",
    ),
    "unknown parent": (
        lambda: lierb.Mechanism([link("a"), link("b", "aa")]), UnknownNameError, "Did you mean 'a'",
    ),
    "unknown parent, of which only the ground is left": (
        lambda: lierb.Mechanism([link("a", "b")]), UnknownNameError,
        r"link a: parent='b' is unknown; choose from ground\.$",
    ),
    "unknown parent, and links that hang on it": (
        lambda: lierb.Mechanism([link("a", "d"), link("b", "a"), link("c"), link("e", "b")]),
        UnknownNameError, r"parent='d' is unknown; choose from c, ground\.",
    ),
    "unknown parent of a loop": (
        lambda: two(loops=lierb.Loop("pin", HINGE, "a", "x")),
        UnknownNameError, r"loop pin: parent='x' is unknown; choose from b, ground\.",
    ),
    "force between a link and nothing": (
        lambda: two(forces=lierb.forces.spring_damper(stiffness=1.0).on("b", "x")),
        UnknownNameError, r"on='x' is unknown; choose from a, ground\.",
    ),
    "unknown body of a loop": (
        lambda: two(loops=lierb.Loop("pin", HINGE, "c")), UnknownNameError, "loop pin: body='c'",
    ),
    "loop on itself": (lambda: lierb.Loop("pin", HINGE, "a", "a"), ArgumentError, "itself"),
    "loop of the ground": (
        lambda: two(loops=lierb.Loop("pin", HINGE, "ground", "a")), ArgumentError, "as parent",
    ),
    "site of nothing": (
        lambda: two(sites={"tip": ("c", np.eye(4))}), UnknownNameError, "site tip: link='c'",
    ),
    "site without a pose": (lambda: two(sites={"tip": "a"}), ArgumentError, "site tip: .*pose"),
    "named ground": (lambda: link("ground"), ArgumentError, "fixed frame"),
    "no name": (lambda: link("my link"), ArgumentError, "letters, digits and _"),
    "no body": (lambda: lierb.Link("a", 3, HINGE), ArgumentError, "body of link a must be"),
    "no joint": (lambda: lierb.Link("a", BALL, 3), ArgumentError, "joint of link a must be"),
    "force nowhere": (
        lambda: two(forces=lierb.forces.drag(linear=1.0)), ArgumentError, r"\.on\('a'\)",
    ),
    "force on nothing": (
        lambda: two(forces=lierb.forces.drag(linear=1.0).on("c")), UnknownNameError, "on='c'",
    ),
    "force on a loop": (
        lambda: two(
            loops=lierb.Loop("pin", HINGE, "b"), forces=lierb.forces.drag(linear=1.0).on("pin")
        ),
        UnknownNameError, "on='pin'",
    ),
    "no axis": (
        lambda: two(forces=lierb.forces.motor(1.0).on("b")), ForceError, "spherical joint does not",
    ),
    "axis between two": (
        lambda: two(forces=lierb.forces.motor(1.0).on("b", "a")), ArgumentError, "of one joint",
    ),
    "on the same": (lambda: lierb.forces.drag().on("a", "a"), ArgumentError, "two different"),
    "on a number": (lambda: lierb.forces.drag().on(3), ArgumentError, "name of a link"),
    "placed in a problem": (
        lambda: lierb.Problem(BALL, HINGE, forces=lierb.forces.drag().on("a")),
        ArgumentError, "one body and no names",
    ),
    "batches": (
        lambda: lierb.Mechanism([
            link("a"), lierb.Link("b", lierb.bodies.sphere(0.1, mass=[1.0, 2.0]), HINGE, "a"),
        ], gravity=np.zeros((3, 3))),
        ArgumentError, "gravity has 3, b.mass has 2",
    ),
    "unknown link of a pose": (lambda: two().pose({"c": 1.0}), UnknownNameError, "coordinates='c'"),
    "coordinates of a list": (lambda: two().pose([1.0]), ArgumentError, "dictionary"),
    "shape": (lambda: two().pose({"b": (1.0, 2.0)}), ArgumentError, r"\(3,\) or \(n, 3\)"),
    "two readings": (lambda: two().pose({"b": np.eye(3)}), ArgumentError, r"R\[None\]"),
    "no coordinates": (
        lambda: lierb.Mechanism(link(held=lierb.joints.fixed())).pose({"a": 1.0}),
        ArgumentError, "no coordinates; leave it out",
    ),
    "lacking pose": (lambda: two().close({"a": np.eye(4)}), ArgumentError, "pose lacks b"),
    "poses that differ in number": (
        lambda: two().pose({"a": np.zeros(3), "b": np.zeros((2, 3))}),
        ArgumentError, r"coordinates\['a'\] has 3, coordinates\['b'\] has 2",
    ),
    "rates that differ in number": (
        lambda: two().twist({"a": np.zeros(3), "b": np.zeros((2, 3))}),
        ArgumentError, r"velocities\['a'\] has 3, velocities\['b'\] has 2",
    ),
    "twists and poses that differ in number": (
        lambda: two().velocities(two().twist({"a": np.zeros(3)}), two().pose({"a": np.zeros(2)})),
        ArgumentError, r"pose\['a'\] has 2, .*twist\['a'\] has 3",
    ),
    "unknown link": (lambda: two().link("c"), UnknownNameError, "link='c'"),
    "member": (lambda: two().of_body(1), ArgumentError, "body=1"),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_what_is_wrong_is_told_in_a_sentence(case):
    make, error, message = REFUSED[case]
    with pytest.raises(error, match=message):
        make()


@pytest.mark.parametrize("speed", [1e160, 1.7e308])
def test_a_twist_whose_squares_overflow_is_told_as_such(speed):
    arm = two()
    error = arm.violation(arm.pose(), {"a": (0, 0, speed, 0, 0, 0), "b": np.zeros(6)})
    assert isinstance(error, TwistError)
    assert "beyond all numbers" in str(error)


def test_order_has_parents_first_and_shows_itself():
    chain = lierb.Mechanism([link("c", "b"), link("b", "a"), link("a"), link("d")])
    assert [chain.names[i] for i in chain.order] == ["a", "d", "b", "c"]
    assert chain.parents == (1, 2, -1, -1)
    text = repr(fourbar(speed=1.0))
    for words in ("3 links and 1 loop", "pin: revolute joint of rocker to rod", "on crank"):
        assert words in text


def test_rows_of_all_connections_are_rows():
    bars = fourbar(speed=1.0)
    assert [at.name for at in bars.connections] == ["crank", "rod", "rocker", "pin", "motor"]
    assert all(isinstance(r, Row) for at in bars.connections for r in at.rows)
