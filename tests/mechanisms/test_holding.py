"""Assemblies whose joints are held, against geometry by hand."""

from contextlib import contextmanager

import numpy as np
import pytest
from cases import long_but

import lierb
from lierb.model.mechanism import closing, holding

GROUND, CRANK, COUPLER, ROCKER = 0.4, 0.1, 0.35, 0.3
TURNING = {"axis": (0.0, 0.0, 1.0)}


def rod(name, length, parent, parent_point):
    """A rod along x, from its joint with the parent."""
    body = lierb.Body(1.0, (1e-4, length**2 / 12, length**2 / 12))
    point = (-length / 2, 0.0, 0.0)
    joint = lierb.joints.revolute(**TURNING, body_point=point, parent_point=parent_point)
    return lierb.Link(name, body, joint, parent)


def arm_with_a_tie():
    """A carriage with an arm on a ball joint, whose end a tie keeps at a distance from a stay."""
    box = lierb.bodies.box((0.1, 0.1, 0.1), mass=1.0)
    links = [
        lierb.Link("carriage", box, lierb.joints.prismatic()),
        lierb.Link("ball", box, lierb.joints.spherical(body_point=(-0.2, 0, 0)), "carriage"),
        lierb.Link("stay", box, lierb.joints.spherical(ground_point=(0.5, 0.0, 0.4))),
    ]
    tie = lierb.joints.point_on_sphere(body_point=(0.1, 0, 0), parent_point=(0.1, 0, 0), length=0.4)
    return lierb.Mechanism(links, lierb.Loop("tie", tie, "stay", "ball"))


def end_of(length):
    return (length / 2, 0.0, 0.0)


def four_bar(forces=()):
    links = [
        rod("crank", CRANK, "ground", (0.0, 0.0, 0.0)),
        rod("coupler", COUPLER, "crank", end_of(CRANK)),
        rod("rocker", ROCKER, "ground", (GROUND, 0.0, 0.0)),
    ]
    pin = lierb.joints.revolute(**TURNING, body_point=end_of(ROCKER), parent_point=end_of(COUPLER))
    return lierb.Mechanism(links, lierb.Loop("pin", pin, "rocker", "coupler"), forces=forces)


def meeting(first, second, radii, branch):
    """Cosine law: where circles about two points meet, left (1) or right (-1) of the line."""
    diagonal, (a, b) = second - first, radii
    length = np.hypot(*diagonal)
    along, e = (a**2 - b**2 + length**2) / (2 * length), diagonal / length
    return first + along * e + branch * np.sqrt(a**2 - along**2) * np.array((-e[1], e[0]))


def pin_of(crank, branch):
    """Cosine law: where coupler and rocker meet, above (1) or below (-1) of the diagonal."""
    start = CRANK * np.array((np.cos(crank), np.sin(crank)))
    return meeting(start, np.array((GROUND, 0.0)), (COUPLER, ROCKER), branch)


def found_pin(pose):
    rocker = pose["rocker"]
    return (rocker @ [*end_of(ROCKER), 1.0])[..., :2]


@pytest.mark.slow
@pytest.mark.parametrize("branch", [1, pytest.param(-1, marks=pytest.mark.long)])
def test_c45_a_four_bar_is_closed_at_crank_angles_on_its_branch(branch):
    """A whole turn and a half in one call. Right: cosine law."""
    bars = four_bar()
    rough = bars.pose({"crank": 0.5, "coupler": branch * 0.4, "rocker": branch * 1.9})
    angles = np.linspace(-3.0, 6.5, 40)
    pose = bars.close(rough, hold={"crank": angles})
    for i, angle in enumerate(angles):
        turned = pose["crank"][i, :2, :2]
        np.testing.assert_allclose(turned[:, 0], (np.cos(angle), np.sin(angle)), atol=1e-13)
        # the joints are closed to rounding; the pin is 5 rad m/m away from them
        np.testing.assert_allclose(found_pin(pose)[i], pin_of(angle, branch), atol=1e-12)


def test_one_angle_gives_one_pose_and_a_motor_on_the_joint_gives_way():
    bars = four_bar(lierb.forces.motor(position=1.0).on("crank"))
    rough = bars.pose({"crank": 0.5, "coupler": 0.4, "rocker": 1.9})
    pose = bars.close(rough, hold={"crank": 0.3})
    assert pose["rocker"].shape == (4, 4)
    np.testing.assert_allclose(found_pin(pose), pin_of(0.3, 1), atol=1e-12)
    np.testing.assert_allclose(found_pin(bars.close(pose)), pin_of(1.0, 1), atol=1e-12)


def test_an_angle_out_of_reach_is_told():
    bars = four_bar()
    rough = bars.pose({"crank": 0.5, "coupler": 0.4, "rocker": 1.9})
    with pytest.raises(lierb.errors.PoseError, match="stays open"):
        bars.close(rough, hold={"rocker": 0.0})
    with pytest.raises(lierb.errors.LierbError, match="hold"):
        bars.close(rough, hold={"shaft": 0.0})


def test_joints_that_do_not_close_together_on_the_way_are_named_as_the_reason():
    bars = four_bar()
    near = bars.close(bars.pose({"crank": 0.5, "coupler": 0.4, "rocker": 1.9}))
    far = bars.coordinates(bars.close(near, hold={"crank": 2.0}))
    both = {name: float(far[name][0]) for name in ("crank", "rocker")}
    with pytest.raises(lierb.errors.PoseError, match=r"on the way to hold, at step .* together"):
        bars.close(near, hold=both)


def test_a_wheel_follows_one_that_is_held_by_their_gear():
    wheel = lierb.bodies.cylinder(0.1, 0.02, mass=1.0)
    links = [
        lierb.Link("left", wheel, lierb.joints.revolute()),
        lierb.Link("right", wheel, lierb.joints.revolute(ground_point=(0.3, 0.0, 0.0))),
    ]
    pair = lierb.Mechanism(links, forces=lierb.forces.gear(ratio=-2.0).on("left", "right"))
    turned = pair.close(pair.pose(), hold={"left": [0.5, 1.5]})
    right = pair.coordinates(turned)["right"][:, 0]
    ratio = right / pair.coordinates(turned)["left"][:, 0]
    np.testing.assert_allclose(ratio, ratio[0], rtol=1e-12)
    assert ratio[0] in (pytest.approx(-2.0, rel=1e-12), pytest.approx(-0.5, rel=1e-12))


def test_joints_with_several_coordinates_and_slides_are_held():
    arm = arm_with_a_tie()
    hold = {"carriage": 0.1, "ball": (0.1, 0.2, -0.3)}
    closed = arm.close(arm.pose(), hold=hold)
    found = arm.coordinates(closed)
    np.testing.assert_allclose(found["carriage"], [0.1], atol=1e-13)
    np.testing.assert_allclose(found["ball"], hold["ball"], atol=1e-13)
    ends = (closed["stay"][:3, :] - closed["ball"][:3, :]) @ [0.1, 0.0, 0.0, 1.0]
    assert np.linalg.norm(ends) == pytest.approx(0.4, abs=1e-12)


@pytest.fixture
def counted(monkeypatch):
    """Numbers of assemblies that progress is reported of, and their total."""
    seen = []

    @contextmanager
    def reporter(progress, total, of):
        yield lambda done: seen.append((done, total))

    for module in (closing, holding):
        monkeypatch.setattr(module, "reporter", reporter)
    return seen


def test_angles_go_the_shorter_way(counted):
    """From 0.5 to 0.3 + 40 turns: two steps of 0.1 rad, for each of three crank angles."""
    bars = four_bar()
    rough = bars.pose({"crank": 0.5, "coupler": 0.4, "rocker": 1.9})
    angles = 0.3 + 2.0 * np.pi * np.array([40.0, -40.0, 0.0])
    pose = bars.close(rough, hold={"crank": angles})
    assert counted == [(3, 6), (6, 6)]
    bars.close(pose)
    assert counted[2:] == [(3, 3)]
    for i in range(3):
        # 40 turns of rounding
        np.testing.assert_allclose(found_pin(pose)[i], pin_of(0.3, 1), atol=1e-12)


def test_rotation_vectors_go_the_shorter_way(counted):
    box = lierb.bodies.box((0.1, 0.1, 0.1), mass=1.0)
    ball = lierb.Mechanism(lierb.Link("ball", box, lierb.joints.spherical(body_point=(-0.2, 0, 0))))
    axis, start = np.array((0.6, 0.0, 0.8)), (0.6, 0.1, 0.8)
    pose = ball.close(ball.pose({"ball": start}), hold={"ball": (0.9 - 6.0 * np.pi) * axis})
    assert counted == [(1, 1)]
    right = ball.pose({"ball": 0.9 * axis})["ball"]
    np.testing.assert_allclose(pose["ball"], right, rtol=0, atol=1e-14)


def test_whole_turns_count_beside_a_gear_and_on_a_screw(counted):
    wheel = lierb.bodies.cylinder(0.1, 0.02, mass=1.0)
    links = [
        lierb.Link("left", wheel, lierb.joints.revolute()),
        lierb.Link("right", wheel, lierb.joints.revolute(ground_point=(0.3, 0.0, 0.0))),
    ]
    pair = lierb.Mechanism(links, forces=lierb.forces.gear(ratio=2.0).on("left", "right"))
    turned = pair.close(pair.pose(), hold={"left": 2.0 * np.pi})
    right = pair.coordinates(turned)["right"].item()
    assert abs(right) == pytest.approx(np.pi, rel=1e-12)
    nut = lierb.Mechanism(lierb.Link("nut", wheel, lierb.joints.screw(pitch=0.01)))
    raised = nut.close(nut.pose(), hold={"nut": 2.0 * np.pi})["nut"]
    assert raised[2, 3] == pytest.approx(0.02 * np.pi, rel=1e-12)


# ---- rates -------------------------------------------------------------------------------------


def test_project_holds_the_rate_of_a_crank():
    """Pin of the rocker: 20 times its derivative by the crank's angle, by the cosine law."""
    bars = four_bar()
    rough = bars.pose({"crank": 0.5, "coupler": 0.4, "rocker": 1.9})
    angles = np.array([-1.0, 0.3, 2.0])
    pose = bars.close(rough, hold={"crank": angles})
    given = bars.twist({"crank": 20.0}, pose)
    assert np.all(np.abs(bars.velocities(bars.project(given, pose), pose)["crank"] - 20.0) > 0.1)
    rates = np.full(3, 20.0)
    for hold in ({"crank": 20.0}, {"crank": rates}, "crank", ["crank"]):
        twist = bars.project(given, pose, hold=hold)
        got = bars.velocities(twist, pose)
        np.testing.assert_allclose(got["crank"][:, 0], 20.0, rtol=1e-14)
        for i, angle in enumerate(angles):
            step = 1e-5  # the difference is good to 1e-10 of the slope
            slope = (pin_of(angle + step, 1) - pin_of(angle - step, 1)) / (2.0 * step)
            arm = found_pin(pose)[i] - np.array((GROUND, 0.0))
            moved = got["rocker"][i, 0] * np.array((-arm[1], arm[0]))
            np.testing.assert_allclose(moved, 20.0 * slope, rtol=0, atol=1e-7)
    assert bars.violation(pose, twist) is None


def test_project_holds_slides_and_rotation_vectors():
    arm = arm_with_a_tie()
    pose = arm.close(arm.pose(), hold={"carriage": 0.1, "ball": (0.1, 0.2, -0.3)})
    hold = {"carriage": 0.7, "ball": (1.0, -2.0, 0.5)}
    twist = arm.project(arm.twist({"stay": (1.0, 1.0, 1.0)}, pose), pose, hold=hold)
    got = arm.velocities(twist, pose)
    for name, rates in hold.items():
        np.testing.assert_allclose(got[name], np.atleast_1d(rates), rtol=1e-13)
    # The ends of the tie do not come nearer: differences of the poses after a short time.
    step, ends = 1e-6, []
    for sign in (-1.0, 1.0):
        moved = {n: pose[n] @ lierb.lie.se3.exp(sign * step * twist[n]) for n in arm.names}
        ends.append((moved["stay"][:3] - moved["ball"][:3]) @ [0.1, 0.0, 0.0, 1.0])
    first, last = map(np.linalg.norm, ends)
    assert abs(last - first) / (2.0 * step) < 1e-8
    assert arm.violation(pose, twist) is None


def test_rates_that_no_motion_has_are_refused_with_the_reason():
    bars = four_bar()
    rough = bars.pose({"crank": 0.5, "coupler": 0.4, "rocker": 1.9})
    pose = bars.close(rough, hold={"crank": [0.3, 0.5]})
    rest = bars.twist({}, pose)
    with pytest.raises(lierb.errors.TwistError, match=r"^twist\[0\]: .*hold gives the rates of"):
        bars.project(rest, pose, hold={"crank": 20.0, "rocker": 5.0})
    driven = four_bar(lierb.forces.motor(speed=3.0).on("crank"))
    with pytest.raises(lierb.errors.TwistError, match=r"contradict each other.*of crank"):
        driven.project(rest, pose, hold={"crank": 20.0})
    with pytest.raises(lierb.errors.UnknownNameError, match="Did you mean 'crank'"):
        bars.project(rest, pose, hold="krank")
    # At the dead point of the rocker crank and coupler are in line: the rocker cannot turn.
    reach = (GROUND**2 + (CRANK + COUPLER) ** 2 - ROCKER**2) / (2.0 * GROUND * (CRANK + COUPLER))
    dead = bars.close(rough, hold={"crank": np.arccos(reach)})
    with pytest.raises(lierb.errors.TwistError, match="hold"):
        bars.project(bars.twist({}, dead), dead, hold={"rocker": 1.0})


def test_close_keeps_the_coordinates_of_named_joints():
    bars = four_bar()
    rough = bars.pose({"crank": 0.5, "coupler": 0.4, "rocker": 1.9})
    closed = bars.close(rough, hold="crank")
    np.testing.assert_allclose(bars.coordinates(closed)["crank"], [0.5], atol=1e-14)
    np.testing.assert_allclose(found_pin(closed), pin_of(0.5, 1), atol=1e-12)


# ---- all branches ------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("angle", long_but([-2.5, 0.0, 0.8], 0.8))
def test_c45_a_four_bar_has_two_assemblies(angle):
    """Articraft#127: all branches on request. Right: both of the cosine law."""
    bars = four_bar()
    poses = bars.assemblies({"crank": angle})
    pins = found_pin(poses)
    order = np.argsort(-pins[:, 1])
    right = np.array([pin_of(angle, branch) for branch in (1, -1)])
    # closed to rounding, as above
    np.testing.assert_allclose(pins[order], right, rtol=0, atol=1e-12)
    for each in order:  # each of them is the nearest to itself
        near = {name: pose[each] for name, pose in poses.items()}
        first = found_pin(bars.assemblies({"crank": angle}, pose=near))[0]
        np.testing.assert_allclose(first, pins[each], rtol=0, atol=1e-12)


def test_c45_two_four_bars_in_series_have_four_assemblies():
    """The second one's crank is the first one's rocker. Right: the cosine law, twice."""
    first, far, rods = four_bar(), np.array((0.9, 0.1)), (0.5, 0.4)
    links = [
        *first.links,
        rod("second", rods[0], "rocker", end_of(ROCKER)),
        rod("output", rods[1], "ground", (*far, 0.0)),
    ]
    tip = lierb.joints.revolute(**TURNING, body_point=end_of(rods[1]), parent_point=end_of(rods[0]))
    bars = lierb.Mechanism(links, [*first.loops, lierb.Loop("tip", tip, "output", "second")])
    poses = bars.assemblies({"crank": 0.8}, starts=100)
    tips = (poses["output"] @ [*end_of(rods[1]), 1.0])[:, :2]
    found = np.concatenate([found_pin(poses), tips], axis=1)
    right = [
        [*(pin := pin_of(0.8, one)), *meeting(pin, far, rods, two)]
        for one in (1, -1)
        for two in (1, -1)
    ]
    assert len(found) == 4
    # closed to rounding; the second pin amplifies that of the first by some ten
    ordered = [sorted(each, key=lambda x: x.round(6).tolist()) for each in (found, np.array(right))]
    np.testing.assert_allclose(*ordered, rtol=0, atol=1e-11)


def test_assemblies_that_cannot_be_listed_are_refused():
    bars, wheel = four_bar(), lierb.bodies.cylinder(0.1, 0.02, mass=1.0)
    with pytest.raises(lierb.errors.ArgumentError, match="hold leaves 1 freedom, so"):
        bars.assemblies(starts=5)
    with pytest.raises(lierb.errors.ArgumentError, match=r"hold\['crank'\] has 2 members"):
        bars.assemblies({"crank": [0.1, 0.2]})
    with pytest.raises(
        lierb.errors.PoseError, match="none of 5 random starts leads to a closed pose"
    ):
        bars.assemblies({"rocker": 0.0}, starts=5)
    with pytest.raises(lierb.errors.ArgumentError, match="starts=0; expected a whole number"):
        bars.assemblies({"crank": 0.1}, starts=0)
    links = [lierb.Link(name, wheel, lierb.joints.revolute()) for name in ("left", "right")]
    pair = lierb.Mechanism(links, forces=lierb.forces.gear(ratio=2.0).on("left", "right"))
    with pytest.raises(lierb.errors.ArgumentError, match="how gears mesh depends on the start"):
        pair.assemblies({"left": 0.1})
