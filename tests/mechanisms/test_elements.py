"""Elements between links: users' functions against lierb's own forces and joints."""

from dataclasses import replace

import numpy as np
import pytest
from cases import tiered

import lierb
from mechanisms.shared import double_pendulum, four_bar

STIFF, LENGTH, ANCHOR = 30.0, 0.2, (0.1, 0.05, 0.2)
RUN = {"dt": 1e-3, "t_end": 0.1, "method": "Heun"}


@lierb.wrench(stiffness=STIFF, length=LENGTH, anchor=ANCHOR)
def tether(t, R, r, omega, v, params):
    """A spring from the other link's point to this one's frame."""
    line = r - params.anchor
    size = np.sqrt(line @ line)
    pull = -params.stiffness * (size - params.length) / size * (R.T @ line)
    return np.zeros(3), pull


@lierb.observable(unit="rad")
def fold(R):
    return np.arctan2(R[0, 2], R[2, 2])


@lierb.observable(unit="m")
def height(r):
    return r[2]


@lierb.constraint(length=0.6)
def strut(R, r, params):
    return (r @ r / params.length - params.length) / 2


def start(made):
    pose0 = made.pose({"upper": 0.4, "lower": -0.7})
    return {"pose0": pose0, "twist0": made.twist({"upper": 1.0, "lower": 3.0}, pose0)}


@pytest.mark.slow
def test_users_wrench_between_links_does_what_a_spring_does():
    """Of two pendulums each has one of both: the other one's stiffness is zero."""
    plain = double_pendulum()
    spring = lierb.forces.spring_damper(ground_point=ANCHOR, stiffness=[0.0, STIFF], length=LENGTH)
    made = lierb.Mechanism(
        plain.links, gravity=plain.gravity,
        forces=[force.on("lower", "upper") for force in (tether(stiffness=[STIFF, 0.0]), spring)],
        observables=[fold().on("lower", "upper"), height().on("lower")],
    )  # fmt: skip
    found = lierb.integrate(made, **start(made), **RUN)
    for name in ("upper", "lower"):  # the same force, rounded in another order
        np.testing.assert_allclose(*found[name].omega, atol=1e-12)
        np.testing.assert_allclose(*found[name].position, atol=1e-13)
    # The one's potential energy is the other one's work.
    work = found.summary["work_final"].to_pylist()
    assert abs(work[0]) > 0.1
    assert work[1] == 0.0
    assert max(map(abs, found.summary["energy_drift_max"].to_pylist())) < 1e-4  # Heun's, of 20 J
    turned = found["upper"].rotation[1].T @ found["lower"].rotation[1]
    angle = np.arctan2(turned[0, 2], turned[2, 2])
    assert abs(found.summary["fold_final"][1].as_py() - angle) < 1e-14
    assert found.summary["height_final"][1].as_py() == found["lower"].position[1, 2]


@pytest.mark.long
def test_users_constraint_on_a_link_holds_as_a_loop_does():
    # a rod from the ground's origin to the frame of a free link that hangs on a pendulum's arm
    arm = double_pendulum().links[0]
    ball = lierb.Link(
        "ball", lierb.bodies.sphere(0.05, mass=0.5), lierb.joints.free(), parent="upper"
    )
    loop = lierb.Loop("rod", lierb.joints.point_on_sphere(length=0.6), "ball")
    pose0 = {"upper": arm.joint.pose([0.3]), "ball": np.eye(4)}
    pose0["ball"][:3, 3] = (0.6, 0.0, 0.0)
    twist0 = {"upper": np.zeros(6), "ball": np.array([0.0, 1.0, 2.0, 0.0, 0.5, -0.3])}
    results = [
        lierb.integrate(made, pose0=pose0, twist0=twist0, **RUN)
        for made in (
            lierb.Mechanism([arm, ball], constraints=strut().on("ball")),
            lierb.Mechanism([arm, ball], loop),
        )
    ]
    ours, theirs = results
    np.testing.assert_allclose(ours["ball"].position, theirs["ball"].position, atol=1e-13)
    assert ours.summary["position_error_max"][0].as_py() < 1e-6  # it drifts as the loop does
    np.testing.assert_allclose(
        ours.summary["position_error_max"][0].as_py(),
        theirs.summary["rod.position_error_max"][0].as_py(),
        rtol=1e-6,
    )


@pytest.mark.slow
def test_motor_of_given_speed_turns_its_joint_at_that_speed():
    plain = double_pendulum()
    made = lierb.Mechanism(
        plain.links, gravity=plain.gravity, forces=lierb.forces.motor(speed=2.0).on("lower")
    )
    pose0 = made.pose({"upper": 0.4})
    twist0 = made.twist({"upper": 1.0, "lower": 2.0}, pose0)
    result = lierb.integrate(
        made, pose0=pose0, twist0=twist0, **RUN, save_every=10,
        record=["state", "energy", "multipliers", "reaction"],
    )  # fmt: skip
    end = {name: np.eye(4) for name in made.names}
    for name in made.names:
        end[name][:3, :3] = result[name].rotation[-1, 0]
        end[name][:3, 3] = result[name].position[-1, 0]
    angle = made.coordinates(end)["lower"][0]
    assert abs(angle - 2.0 * RUN["t_end"]) < 1e-13
    assert result.summary["rotation_rate_error_max"][0].as_py() < 1e-13
    # −λ of its row is its torque, which the joint's reaction has about its axis, and whose power is
    # what E gains.
    torque = -np.array(result.history["lower.motor.lambda"].to_pylist())[:, 0]
    about_axis = np.array(result.history["lower.reaction"].to_pylist())[:, 2]
    np.testing.assert_allclose(about_axis, torque, rtol=1e-12)
    energy = result.history["energy"].to_numpy()
    done = np.trapezoid(2.0 * torque, result.t)  # over 10 ms: to 1e-4 of it
    assert abs(energy[-1] - energy[0] - done) < 1e-3 * abs(done)
    # What the motor does is work: the energy is accounted for, to Heun's error.
    assert abs(result.summary["energy_drift_max"][0].as_py()) < 1e-4


RECORDED = {"save_every": 1, "record": ["state", "energy"]}


def resisted(joint="lower", viscous=0.0, links=None, **spring) -> lierb.Mechanism:
    """The pendulum with friction and a spring in a joint, which share a kernel at all strengths."""
    plain = double_pendulum()
    forces = [
        lierb.forces.joint_friction(viscous=viscous).on(joint),
        lierb.forces.torsional_spring(**{"stiffness": 0.0} | spring).on(joint),
    ]
    return lierb.Mechanism(links or plain.links, gravity=plain.gravity, forces=forces)


@pytest.mark.slow
def test_friction_on_an_inner_joint_takes_the_energy_that_it_should():
    made = resisted(viscous=0.2)
    result = lierb.integrate(made, **start(made), **RUN, **RECORDED)
    twists = {n: np.hstack([result[n].omega[:, 0], result[n].v[:, 0]]) for n in made.names}
    poses = {}
    for name in made.names:
        poses[name] = np.tile(np.eye(4), (len(result.t), 1, 1))
        poses[name][:, :3, :3] = result[name].rotation[:, 0]
        poses[name][:, :3, 3] = result[name].position[:, 0]
    rate = made.velocities(twists, poses)["lower"][:, 0]
    lost = np.trapezoid(-0.2 * rate**2, result.t)
    energy = result.history["energy"].to_numpy()
    assert abs(energy[-1] - energy[0] - lost) < 1e-4  # of 0.4 J; both are of second order


@pytest.mark.slow
def test_a_joint_may_be_given_in_other_frames_along_its_axis():
    # the same pendulum, with joint frames that are turned about the axis: the same motion, and the
    # same angle for a spring
    plain = double_pendulum()
    c, s = np.cos(0.7), np.sin(0.7)
    turn = np.eye(4)
    turn[:2, :2] = [[c, -s], [s, c]]
    links = [
        replace(x, joint=replace(x.joint, body_frame=x.joint.body_frame @ turn,
                                 ground_frame=x.joint.ground_frame @ turn))
        for x in plain.links
    ]  # fmt: skip
    given = {"viscous": 0.2, "stiffness": 5.0, "angle": 0.3}
    both = resisted(**given), resisted(links=links, **given)
    ends = [lierb.integrate(made, **start(plain), **RUN, **RECORDED) for made in both]
    for name in plain.names:
        np.testing.assert_allclose(ends[0][name].omega, ends[1][name].omega, atol=1e-12)


@pytest.mark.parametrize("name", tiered(["upper", "lower"], [], ["lower"]))
def test_a_spring_about_an_inner_joint_is_slack_at_its_angle(name):
    plain = resisted(name, stiffness=5.0, angle=0.3)
    made = lierb.Mechanism(plain.links, forces=plain.forces)
    at_rest = made.pose({name: 0.3})
    still = {n: np.zeros(6) for n in made.names}
    result = lierb.integrate(made, pose0=at_rest, twist0=still, **RUN, **RECORDED)
    for each in made.names:
        assert np.abs(result[each].omega).max() < 1e-15


@pytest.mark.slow
def test_momentum_is_that_of_the_bodies_and_stays_where_nothing_acts_from_outside():
    rng = np.random.default_rng(1)
    body = lierb.Body(1.5, np.diag([0.03, 0.04, 0.05]) + 1.5 * 0.01 * np.diag([0, 1, 1]),
                      (0.1, 0.0, 0.0))  # fmt: skip
    joint = lierb.joints.revolute(body_point=(0.0, 0.0, 0.2), parent_point=(0.0, 0.1, 0.0))
    pair = lierb.Mechanism([
        lierb.Link("a", body, lierb.joints.free()), lierb.Link("b", body, joint, "a"),
    ])  # fmt: skip
    pose0 = pair.pose({"b": 0.4})
    twist0 = pair.twist({"a": rng.normal(size=6), "b": 2.0}, pose0)
    result = lierb.integrate(
        pair, pose0=pose0, twist0=twist0, dt=1e-3, t_end=0.1, save_every=50, record="state"
    )
    wanted = np.zeros(6)
    for name in pair.names:  # particle by particle: m c and second moments of each body
        R, r = pose0[name][:3, :3], pose0[name][:3, 3]
        w, v = R @ twist0[name][:3], R @ twist0[name][3:]
        c = R @ body.com
        central = body.inertia - body.mass * (body.com @ body.com * np.eye(3)
                                              - np.outer(body.com, body.com))  # fmt: skip
        p = body.mass * (v + np.cross(w, c))
        wanted += np.r_[np.cross(r + c, p) + R @ central @ R.T @ w, p]
    np.testing.assert_allclose(result.momentum[0, 0], wanted, atol=1e-14)
    np.testing.assert_allclose(result.momentum[-1, 0], wanted, atol=1e-11)  # RK4's error


@pytest.mark.long
@pytest.mark.parametrize(
    "name", tiered(["point_on_line", "constant_velocity"], [], ["constant_velocity"])
)
def test_projection_closes_joints_whose_motions_are_no_group(name):
    rng = np.random.default_rng(7)
    ball = lierb.bodies.box((0.1, 0.2, 0.3), mass=1.0)
    held = lierb.joints.JOINTS[name]
    tail = lierb.joints.spherical((0.0, 0.0, 0.2), parent_point=(0.0, 0.0, -0.2))
    made = lierb.Mechanism(
        [lierb.Link("a", ball, held((0.1, 0.05, 0.2))), lierb.Link("b", ball, tail, "a")],
        gravity=(1.0, 2.0, -9.81),
    )
    pose0 = made.close(made.pose())
    twist0 = made.project({n: rng.normal(size=6) for n in made.names}, pose0)
    result = lierb.integrate(
        made, pose0=pose0, twist0=twist0, dt=1e-2, t_end=1.0, method="Heun", stabilise="project"
    )
    assert result.summary["status"][0].as_py() == "ok"
    assert result.summary["position_error_max"][0].as_py() < 1e-14
    assert result.summary["rotation_error_max"][0].as_py() < 1e-14
    plain = lierb.integrate(made, pose0=pose0, twist0=twist0, dt=1e-2, t_end=1.0, method="Heun")
    kind = "position" if name == "point_on_line" else "rotation"
    assert plain.summary[f"{kind}_error_max"][0].as_py() > 1e-7  # which drifts otherwise


def test_largest_error_of_joints_is_nan_where_one_is():
    from lierb.kernels.numbers.zero import ZERO
    from lierb.kernels.systems.relatives import largest

    for order in ([1.0, np.nan, 0.5], [np.nan, 1.0], [ZERO, 0.5, np.nan]):
        assert np.isnan(largest(order))
    assert largest([ZERO, 0.5, 2.0, ZERO]) == 2.0


@pytest.mark.slow
def test_an_end_with_another_pose_is_another_start():
    made = resisted(viscous=0.2)
    first = lierb.integrate(made, **start(made), **RUN, **RECORDED)
    end = first.end
    assert end["pose0"].continuation is not None
    moved = made.pose({"upper": 1.0, "lower": 0.5})
    end["pose0"].update(moved)
    twist0 = made.twist({"upper": 0.0}, moved)
    went_on = lierb.integrate(
        made, pose0=end["pose0"], twist0=twist0, t0=end["t0"], **RUN | {"t_end": 0.2}, **RECORDED
    )
    fresh = lierb.integrate(
        made, pose0=moved, twist0=twist0, t0=end["t0"], **RUN | {"t_end": 0.2}, **RECORDED
    )
    np.testing.assert_array_equal(went_on["lower"].position, fresh["lower"].position)
    assert end["pose0"].continuation is None


@pytest.mark.slow
def test_a_projection_that_leads_away_is_told():
    # bars of a millionth of a gram beside one of a kilogram: no step of 1 ms follows their swing
    plain = four_bar()
    links = [
        replace(x, body=lierb.Body(x.body.mass * f, x.body.inertia * f))
        for x, f in ((plain.link("crank"), 1e-6), (plain.link("rocker"), 1.0),
                     (plain.link("coupler"), 1e-6))
    ]  # fmt: skip
    # in this order and with a spring, though of no stiffness, it has the kernel of test_bits.py
    spring = lierb.forces.spring_damper(stiffness=0.0).on("crank", "rocker")
    made = lierb.Mechanism(links, plain.loops, plain.gravity, forces=spring)
    pose0 = made.close(made.pose({"crank": 0.3, "rocker": -1.6, "coupler": -0.5}))
    twist0 = made.project(made.twist({"crank": 10.0}, pose0), pose0)
    with pytest.warns(lierb.errors.FailedTrajectoryWarning):
        result = lierb.integrate(
            made, pose0=pose0, twist0=twist0, dt=2e-2, t_end=20.0, method="Heun",
            stabilise="project",
        )  # fmt: skip
    assert result.summary["status"][0].as_py() in ("singular", "non_finite")
