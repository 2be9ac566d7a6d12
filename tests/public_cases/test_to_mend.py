"""Cases that lierb gets wrong: each test here fails until its fault is mended.

A test that passes moves to the file of its subject.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from cases import integrate, rotation
from clocks.shared import G, rows_of, spinning, thrown
from clocks.test_events import NEVER, NEVER_SO_FAST, height, turned

import lierb
from public_cases.shared import (
    CRANK,
    INERTIA,
    WHEEL,
    angles_of,
    assert_bounces,
    assert_turns_by_cardan,
    bounced,
    cardan,
    read_urdf,
    slider_crank,
    summed,
    urdf_joint,
    urdf_link,
    wheels,
)
from public_cases.test_linkages import slider_at
from public_cases.test_rigid_bodies import VELOCITIES

# ---- c49, c49b: stops of joints ----------------------------------------------------------------
# RobotLocomotion/drake#2516, google-deepmind/mujoco#169, bulletphysics/bullet3#2863: joints pass
# their limits, or gain energy there. Right: free flight, and half a harmonic oscillation in the
# stop.

WIDE = np.radians([60.0, 90.0, 120.0, 150.0, 165.0])
SPEEDS = np.linspace(1.0, 20.0, 20)  # rad/s


METHODS = [
    "DOP853",
    *(pytest.param(name, marks=pytest.mark.slow) for name in ("Tsit5", "DP54", "BS32")),
]


@pytest.mark.parametrize("rtol", [1e-6, 1e-8])
@pytest.mark.parametrize("method", METHODS)
def test_c49b_wide_stops_turn_every_wheel_back(method, rtol):
    """drake#2516, mujoco#169. Wheels of 1 … 20 rad/s between stops at ±60° … ±165°."""
    speeds, stops = (x.ravel() for x in np.meshgrid(SPEEDS, WIDE))
    problem, twist0 = wheels(speeds, -stops, stops, 200.0)
    t = np.linspace(0.0, 10.0, 401)
    result = lierb.integrate(
        problem, twist0=twist0, t_end=10.0, rtol=rtol, method=method, save_at=t, record=["state"]
    )
    assert_bounces(result, t, rtol, speeds, -stops, stops, 200.0)


def test_c49b_wheel_bounces_for_ever():
    """drake#2516, mujoco#169. 1000 wheels for 100 s, none of which passes through ±180°."""
    speeds = np.linspace(1.0, 20.0, 1000)
    problem, twist0 = wheels(speeds, -WIDE[-1], WIDE[-1], 200.0)
    result = lierb.integrate(
        problem, twist0=twist0, t_end=100.0, rtol=1e-6, save_at=np.linspace(0.0, 100.0, 2001),
        record=["state"],
    )  # fmt: skip
    angle = angles_of(result)
    # as deep as the energy takes it, which may drift by 1 % (`assert_bounces`)
    deepest = 1.01 * speeds / np.sqrt(200.0 / INERTIA)
    assert np.all(np.abs(angle) < WIDE[-1] + deepest)
    # who turns through has the other sign of the angle 0.05 s later
    assert np.all(np.abs(np.diff(angle, axis=0)) < 1.01 * 0.05 * speeds + 1e-3)
    energy = 0.5 * INERTIA * speeds**2
    assert np.all(summed(result, "energy_drift_max") < 1e-2 * energy)


@pytest.mark.parametrize("rtol", [1e-6, 1e-7, 1e-8, 1e-9, 1e-10])
def test_c49_hard_stops_give_back_what_they_took(rtol):
    """drake#2516, bullet3#2863. Stops at −1 and 1.5 rad, harder by a factor of up to 1000."""
    speeds, stiffness = (
        x.ravel() for x in np.meshgrid(np.linspace(1.0, 20.0, 96), [2e2, 2e3, 2e4, 2e5])
    )
    lower, upper = np.full_like(speeds, -1.0), np.full_like(speeds, 1.5)
    problem, twist0 = wheels(speeds, lower, upper, stiffness)
    t = np.linspace(0.0, 5.0, 401)
    result = lierb.integrate(
        problem, twist0=twist0, t_end=5.0, rtol=rtol, save_at=t, record=["state"]
    )
    assert_bounces(result, t, rtol, speeds, lower, upper, stiffness)


@pytest.mark.slow
def test_c49b_stops_of_a_link_turn_it_back():
    """drake#2516, mujoco#169: a wheel of a mechanism, whose stops act in a joint between links."""
    hub = lierb.Link("hub", lierb.Body(3.0, (0.1, 0.1, 0.1)), lierb.joints.fixed())
    wheel = lierb.Link("wheel", WHEEL, lierb.joints.revolute(), "hub")
    speeds, stop = SPEEDS, WIDE[-1]
    stops = lierb.forces.joint_limit(lower=-stop, upper=stop, stiffness=200.0).on("wheel")
    machine = lierb.Mechanism([hub, wheel], forces=stops)
    t = np.linspace(0.0, 10.0, 401)
    result = lierb.integrate(
        machine, twist0=machine.twist({"wheel": speeds}), t_end=10.0, rtol=1e-6, save_at=t,
        record=["state"],
    )  # fmt: skip
    angle = angles_of(result["wheel"])
    right, _ = bounced(t[:, None], speeds, -stop, stop, np.sqrt(200.0 / INERTIA))
    # as in `assert_bounces`, of a stop met each 0.29 s by the fastest
    drift = summed(result, "energy_drift_max") / (0.5 * INERTIA * speeds**2)
    assert np.all(drift < 1e-2)
    allowed = (drift + 300e-6 * (1.0 + 10.0 / 0.29)) * (1.0 + 10.0 * speeds)
    np.testing.assert_array_less(np.abs(angle - right).max(axis=0), allowed)


# ---- c53: counting turns -----------------------------------------------------------------------
# scipy/scipy#9228, SciML/DifferentialEquations.jl#258: a step that is longer than what an event
# does between its ends. Right: R₂₁ = sin ωt.

RATES = np.array([0.3, 1.0, 2.0, 5.0, 5.123, 7.7, 12.0, 20.0])  # rad/s


def passes(rate, t_end) -> np.ndarray:
    """Times after 0 at which sin ωt rises through zero."""
    return np.arange(1, 1 + int(rate * t_end / (2 * np.pi))) * 2 * np.pi / rate


@pytest.mark.parametrize("rtol", [1e-3, 1e-6, 1e-9])
@pytest.mark.parametrize("method", [None, "DP54"])
def test_c53_revolutions_are_all_counted(method, rtol):
    """scipy#9228, DifferentialEquations.jl#258. A free rotor for 100 s, some at 5 rad/s: 79."""
    problem, start = spinning(RATES, events=[turned(sine=0.0), NEVER_SO_FAST])
    result = lierb.integrate(problem, **start, t_end=100.0, rtol=rtol, method=method)
    t, which = rows_of(result.events, "t"), rows_of(result.events, "trajectory")
    for i, rate in enumerate(RATES):
        risen = np.sort(np.concatenate([passes(rate, 100.0), passes(rate, 100.0) - np.pi / rate]))
        last = risen[-1] + np.pi / rate if risen.size else np.pi / rate
        right = risen if last > 100.0 else np.append(risen, last)
        # the group's exponential turns it without error; what is left is rounding of an angle of up
        # to 2000 rad, and of a continuous extension in steps of up to 25 rad
        np.testing.assert_allclose(t[which == i], right, rtol=0, atol=1e-11 + 4e-16 * 2000 / rate)


# ---- c54: a pulse ------------------------------------------------------------------------------
# Users of thrusters: a short pulse in a force of t is stepped over. Right: closed form.


@lierb.wrench(torque=0.1, begin=1.0, end=2.0)
def pulse(t, R, r, omega, v, params):
    on = (params.begin <= t) & (t < params.end)
    return (0.0, 0.0, lierb.where(on, params.torque, 0.0)), (0.0, 0.0, 0.0)


@pytest.mark.parametrize("rtol", [1e-6, 1e-9])
@pytest.mark.parametrize(
    ("begin", "end", "t_end"), [(1.0, 2.0, 10.0), (1.0, 2.0, 1000.0), (7.0, 7.001, 100.0)]
)
def test_c54_pulse_is_met_where_it_is_told(begin, end, t_end, rtol):
    """A torque pulse on a free body at rest, or turning about the same axis; breakpoints given."""
    spin, moment = np.array([0.0, 0.3, -2.0]), 0.4
    problem = lierb.Problem(
        lierb.Body(1.0, (moment, moment, moment)), lierb.joints.free(),
        forces=pulse(torque=0.1, begin=begin, end=end),
    )  # fmt: skip
    twist0 = np.zeros((3, 6))
    twist0[:, 2] = spin
    result = lierb.integrate(
        problem, twist0=twist0, t_end=t_end, rtol=rtol, discontinuities=[begin, end]
    )
    gained = 0.1 * (end - begin) / moment
    # 30 rtol, as of any smooth motion (clocks/test_tolerances.py), of 1 rad/s; and what that turns
    off = np.abs(summed(result, "omega")[:, 2] - spin - gained)
    assert np.all(off < 30.0 * rtol)
    angle = spin * t_end + gained * (0.5 * (end - begin) + t_end - end)
    apart = angles_of(result) - angle
    assert np.all(np.abs(np.sin(0.5 * apart)) < 30.0 * rtol * (1.0 + t_end))


# ---- c04: a bouncing ball ----------------------------------------------------------------------
# SciML/DifferentialEquations.jl#138, #551, #696, sksat/orts#545: the ball falls through the floor
# after some bounces. Right: parabolas.


@pytest.mark.parametrize("dt", [0.01, 0.05])
@pytest.mark.parametrize("method", [None, pytest.param("DOP853", marks=pytest.mark.slow)])
def test_c04_flights_shorter_than_a_step_end_on_the_floor(method, dt):
    """Thrown up from the floor, flights from 3 s down to 3 µs, all with the same step."""
    speeds = 14.0 * 0.8 ** np.arange(62)
    landing = height(0.0, "landing", direction=-1, terminal=True)
    problem, start = thrown(np.zeros(62), speeds, events=[landing, NEVER])
    result = lierb.integrate(problem, **start, t_end=5.0, dt=dt, method=method, cspace="SO3xR3")
    assert result.summary["status"].to_pylist() == ["event"] * 62
    # the height is rounded to 1e-16 of the step's rise and fall, up to 0.1 m: 1e-17 m over a speed
    allowed = 1e-12 + 1e-16 / speeds
    np.testing.assert_array_less(np.abs(result.t - 2.0 * speeds / G), allowed)


def test_c04_bounces_go_on_below_a_step():
    """From 10 m, e = 0.8, dt = 0.01 s: bounce 27 is the first within a step of the one before."""
    landing = height(0.0, "landing", direction=-1, terminal=True)
    problem, start = thrown([10.0], [0.0], events=[landing, NEVER])
    first, speed = np.sqrt(2.0 * 10.0 / G), np.sqrt(2.0 * 10.0 * G)
    later = np.cumsum(2.0 * speed / G * 0.8 ** np.arange(1, 40))
    t = 0.0
    for right in first + np.concatenate([[0.0], later]):
        result = lierb.integrate(problem, **start, t_end=3.0, dt=0.01, cspace="SO3xR3")
        assert result.summary["status"].to_pylist() == ["event"]
        t += result.t[0]
        # each bounce starts where rounding has put it, 1e-16 m beside the floor, at up to 2 mm/s
        assert t == pytest.approx(right, abs=1e-10)
        up = summed(result, "v")
        up[:, 2] *= -0.8
        twist0 = np.concatenate([np.zeros((1, 3)), up], axis=1)
        pose0 = np.eye(4)[None].copy()
        pose0[:, :3, 3] = summed(result, "position")
        start = {"pose0": pose0, "twist0": twist0}


# ---- c15b: a start in a dead point -------------------------------------------------------------
# KmolYuan/Pyslvs-UI#49: a slider-crank that starts in line. Right: what `project` is defined to be.


@pytest.mark.parametrize("dead_point", ["stretched", "folded"])
@pytest.mark.parametrize("speed", [1e-3, 30.0, 3e4])
def test_c15b_twist_of_project_is_taken_in_a_dead_point(dead_point, speed):
    """Pyslvs-UI#49. In line, the slider stands still at first whatever the crank does."""
    machine = slider_crank()
    folded = {"crank": np.pi, "rod": np.pi, "slider": -2.0 * CRANK}
    pose0 = machine.close(machine.pose(folded if dead_point == "folded" else {}))
    twist0 = machine.project(machine.twist({"crank": speed}, pose0), pose0)
    rates = machine.velocities(twist0, pose0)
    # rounding, of speeds at the pins of 0.1 … 0.35 m times the crank's
    assert abs(rates["slider"][0]) < 1e-15 * abs(rates["crank"][0])
    turn = np.pi / abs(rates["crank"][0])
    result = integrate(machine, pose0=pose0, twist0=twist0, dt=turn / 500, t_end=turn)
    assert result.summary["status"].to_pylist() == ["ok"]
    omega = result["crank"].omega[-1, 0, 2]
    x, _, _, mass, _ = slider_at(angles_of(result["crank"])[-1, 0])
    # ½ M(φ) ω² stays. RK4 of half a turn in 500 steps, and a loop that drifts with it
    np.testing.assert_allclose(result["slider"].position[-1, 0, 0], x, rtol=0, atol=1e-9)
    start = slider_at(0.0 if dead_point == "stretched" else np.pi)[3]
    right = rates["crank"][0] * np.sqrt(start / mass)
    np.testing.assert_allclose(omega, right, rtol=1e-8)


# ---- c13: two Cardan shafts side by side -------------------------------------------------------
# OpenModelica/OpenModelica#8365: with a second branch between two shafts there is no simulation.


@pytest.mark.xfail(
    reason="ends `singular`: the pivot rule keeps a row that is redundant up to drift", strict=False
)
@pytest.mark.slow
@pytest.mark.parametrize(
    ("branches", "closed_by", "redundant"),
    [
        (("first",), "cross", 1),
        (("first", "second"), "bearing", 3),
        pytest.param(("first", "second"), "cross", 3, marks=pytest.mark.long),
    ],
)
def test_c13_cardan_shafts_turn_whatever_closes_the_loop(branches, closed_by, redundant):
    """OpenModelica#8365. Right: Cardan's formula. Rows are redundant in space, not in a plane."""
    machine = cardan(branches, closed_by)
    assert tuple(machine.freedoms()) == (1, redundant)
    assert_turns_by_cardan(machine, branches)


# ---- c29b: a motor of given speed on a slide ---------------------------------------------------


def test_c29b_motor_of_given_speed_on_a_slide_is_refused():
    """By definition: a joint that does not turn about an axis has no speed about it."""
    cart = lierb.Link("cart", lierb.Body(1.0, (0.1, 0.1, 0.1)), lierb.joints.prismatic())
    with pytest.raises(lierb.errors.LierbError, match="motor"):
        lierb.Mechanism(cart, forces=lierb.forces.motor(speed=1.0).on("cart"))


# ---- c37, c52: URDF files of robots ------------------------------------------------------------


NONE, SMALL = (0.0, 0.0, 0.0), (1e-4, 1e-4, 1e-4)  # kg m²
NO_BODYS = (1e-5, 1e-5, 1.0)  # one is more than the two others together


def robot(root, foot, limit='lower="-1" upper="1"') -> str:
    """A leg; `root` and `foot`, which is welded to its shin, are moments of inertia."""
    return f"""<robot name="leg">
      {urdf_link("base", 2.0, root)}
      {urdf_link("thigh", 1.5, xyz="0 0.01 -0.1")}
      {urdf_link("shin", 0.7, (0.004, 0.005, 0.006), xyz="0.02 0 -0.15")}
      {urdf_link("foot", 0.1, foot)}
      {
        urdf_joint(
            "hip",
            "revolute",
            "base",
            "thigh",
            f'<axis xyz="0 1 0"/><limit {limit} effort="1" velocity="1"/>',
        )
    }
      {
        urdf_joint(
            "knee", "continuous", "thigh", "shin", '<origin xyz="0 0 -0.3"/><axis xyz="0 1 0"/>'
        )
    }
      {urdf_joint("ankle", "fixed", "shin", "foot", '<origin xyz="0.03 0 -0.3"/>')}
    </robot>"""


@pytest.mark.parametrize(
    ("root", "foot", "merge_fixed"),
    [
        (NONE, NONE, True), (NO_BODYS, SMALL, True), (NO_BODYS, NONE, True),
        (NONE, NONE, False), (NO_BODYS, NONE, False),
    ],
)  # fmt: skip
def test_c37_inertias_of_root_and_welded_links_do_not_matter(tmp_path, root, foot, merge_fixed):
    """Gepetto/example-robot-data: 13 of 68 robots have such links. Right: the XML's own numbers.

    A welded link that is no body by itself is part of what it is welded to.
    """
    text = robot(root, foot)
    machine, _ = read_urdf(tmp_path / "leg.urdf", text, merge_fixed=merge_fixed)
    assert machine.names == ("thigh", "shin")
    shin = machine.link("shin").body
    # both together: parallel axes, by hand
    points = [(0.7, np.array((0.02, 0.0, -0.15))), (0.1, np.array((0.03, 0.0, -0.3)))]
    np.testing.assert_allclose(shin.mass, 0.8, rtol=1e-14)
    np.testing.assert_allclose(shin.com, sum(m * x for m, x in points) / 0.8, rtol=0, atol=1e-15)
    about = np.diag([0.004, 0.005, 0.006]) + np.diag(foot)
    about = about + sum(m * (x @ x * np.eye(3) - np.outer(x, x)) for m, x in points)
    np.testing.assert_allclose(shin.inertia, about, rtol=0, atol=1e-15)


def test_c37_roots_mass_is_listed_as_left_out(tmp_path):
    """Gepetto/example-robot-data: the ground has no mass, and 37 files said nothing of theirs."""
    _, left_out = read_urdf(tmp_path / "leg.urdf", robot(SMALL, SMALL))
    assert any("base" in what and "mass" in what for what in left_out), left_out


@pytest.mark.parametrize("limit_stiffness", [None, 500.0])
def test_c52_a_locked_joint_is_locked_or_listed(tmp_path, limit_stiffness):
    """mujoco#3527, drake#11109. Limits 0 … 0 hold a joint: it is held, or listed as left out."""
    text = robot(SMALL, SMALL, 'lower="0" upper="0"')
    machine, left_out = read_urdf(tmp_path / "leg.urdf", text, limit_stiffness=limit_stiffness)
    is_held = machine.link("thigh").joint.name == "fixed" or machine.forces
    assert is_held or any("hip" in what and "limit" in what for what in left_out), left_out


@pytest.mark.parametrize("depth", [1, 6, 20])
def test_c52_the_link_at_fault_is_named(tmp_path, depth):
    """mujoco#3527, drake#11109: a message that names no link is none, however long the path."""
    folder = tmp_path
    for number in range(depth):
        folder = folder / f"a_folder_of_some_length_{number}"
    folder.mkdir(parents=True)
    bad = "left_front_lower_suspension_link_with_a_name_as_exporters_write_them"
    text = robot(SMALL, SMALL).replace("shin", bad)
    text = text.replace('ixx="0.004"', 'ixx="0.4"')  # more than the other two together
    with pytest.raises(lierb.errors.ArgumentError) as caught:
        read_urdf(folder / "leg.urdf", text)
    assert bad in str(caught.value)


# ---- c58: a satellite in a moving frame --------------------------------------------------------
# newton-physics/newton#3868, AVSLab/basilisk (hinged panels): right by Galileo, as at rest.


@cache
def satellite() -> lierb.Mechanism:
    """A hub of 200 kg with two sprung panels and a wheel, in no field of gravity."""
    hinge = lambda side: lierb.joints.revolute(
        (-side * 0.9, 0.0, 0.0), parent_point=(side * 0.6, 0.0, 0.0), axis=(0.0, 1.0, 0.0)
    )
    panel, spring = lierb.Body(12.0, (1.0, 3.3, 4.3)), lierb.forces.torsional_spring
    bearing = lierb.joints.revolute(parent_point=(0.1, 0.05, -0.1))
    return lierb.Mechanism(
        [
            lierb.Link("hub", lierb.Body(200.0, (30.0, 35.0, 40.0)), lierb.joints.free()),
            lierb.Link("left", panel, hinge(-1.0), "hub"),
            lierb.Link("right", panel, hinge(1.0), "hub"),
            lierb.Link("wheel", lierb.Body(8.0, (0.05, 0.05, 0.09)), bearing, "hub"),
        ],
        forces=[spring(stiffness=15.0, damping=0.2).on(side) for side in ("left", "right")],
    )


@pytest.mark.slow
def test_c58_a_satellite_moves_as_at_rest_at_orbital_speed():
    """newton#3868, Basilisk's hinged panels. 50 s, panels bent at first, the wheel at 60 rad/s."""
    machine, spin = satellite(), rotation(0.3, -0.2, 0.5)
    pose0 = machine.pose({"left": 0.2, "right": -0.1})
    for name, pose in pose0.items():
        pose0[name] = np.block([[spin, np.zeros((3, 1))], [np.zeros((1, 3)), 1.0]]) @ pose
    twists = [
        machine.twist({"hub": (0.02, 0.0, 0.1, *velocity), "wheel": 60.0}, pose0)
        for velocity in VELOCITIES
    ]
    twist0 = {name: np.stack([twist[name] for twist in twists]) for name in machine.names}
    result = lierb.integrate(
        machine, pose0=pose0, twist0=twist0, t_end=50.0, rtol=1e-9, max_steps=3000
    )
    assert result.summary["status"].to_pylist() == ["ok"] * 4
    steps = summed(result, "steps")
    assert np.all(steps <= 1.2 * steps[0] + 5)
    for name, turn in (("hub", 6.0), ("left", 6.0), ("right", 6.0), ("wheel", 3000.0)):
        R = summed(result, f"{name}.rotation").reshape(-1, 3, 3)
        # 30 times rtol, and of the angle by which it has turned
        np.testing.assert_allclose(R, np.broadcast_to(R[0], R.shape), rtol=0, atol=30e-9 * turn)
