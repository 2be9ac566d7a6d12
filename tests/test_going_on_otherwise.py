"""Runs that go on from the end of another with other forces, and what is felt in open loops."""

from __future__ import annotations

import numpy as np
import pytest
from cases import long_but
from numpy.testing import assert_allclose

import lierb
from lierb.errors import ArgumentError, DerivativeWarning


@lierb.event(terminal=True)
def turn(v):
    return v[2]


def cart(force, **more):
    push = lierb.forces.constant_wrench(force=(0.0, 0.0, force))
    body = lierb.Body(1.0, (0.1, 0.1, 0.1))
    return lierb.Problem(body, lierb.joints.prismatic(), forces=push, **more)


@pytest.mark.slow
@pytest.mark.parametrize("force", [3.0, -3.0])
def test_an_event_at_the_end_of_a_run_is_none_at_the_start_of_the_next(force):
    """The cart turns back at 1/3 s. Then it is pushed on, or as before."""
    start = {"twist0": (0.0, 0.0, 0.0, 0.0, 0.0, 1.0), "rtol": 1e-9}
    ended = lierb.integrate(cart(-3.0, events=turn()), **start, t_end=5.0)
    assert_allclose(ended.t, 1.0 / 3.0, rtol=1e-12)
    on = lierb.integrate(cart(force, events=turn()), **ended.end, rtol=1e-9, t_end=5.0)
    assert on.events.num_rows == 0
    assert_allclose(on.v[0, 2], force * (5.0 - 1.0 / 3.0), rtol=1e-12)


METHODS = long_but(["SHAKELie", "alpha2", "alpha3", "BLieDF2"], "SHAKELie")


@pytest.mark.parametrize("method", METHODS)
def test_what_a_method_carries_ends_with_the_forces(method):
    """A cart at rest for 1 s, then pushed by 3 N: v = 3 m/s, z = 1.5 m at the end, to rounding."""
    options = {"dt": 0.02, "method": method}
    end = lierb.integrate(cart(0.0), t_end=1.0, **options).end
    pushed = lierb.integrate(cart(3.0), **end, t_end=2.0, **options)
    assert_allclose([pushed.v[0, 2], pushed.position[0, 2]], [3.0, 1.5], rtol=1e-10)


@pytest.mark.slow
def test_derivatives_do_not_go_on_with_another_twist():
    first = lierb.integrate(cart(1.0), dt=0.01, t_end=1.0, with_respect_to="body.mass")
    changed = first.end | {"twist0": -first.end["twist0"]}
    with pytest.raises(ArgumentError, match="go on with result"):
        lierb.integrate(cart(1.0), **changed, dt=0.01, t_end=2.0, with_respect_to="body.mass")


@pytest.mark.slow
def test_derivatives_do_not_go_on_with_other_forces_from_an_event():
    """A heavier cart turns back later, at 1/3 s · mass, and then is pushed by another force."""
    start = {"twist0": (0.0, 0.0, 0.0, 0.0, 0.0, 1.0), "rtol": 1e-9}
    by_mass, names = {"with_respect_to": "body.mass"}, ["body.mass", "joint.ground_point"]
    ended = lierb.integrate(cart(-3.0, events=turn()), **start, t_end=5.0, with_respect_to=names)
    assert_allclose(ended.sensitivity("t", "body.mass"), [[1.0 / 3.0]], rtol=1e-9)
    on = {"rtol": 1e-9, "t_end": 1.0}
    with pytest.raises(ArgumentError, match=r"whose time depends on body\.mass, and forces are"):
        lierb.integrate(cart(-6.0, events=turn()), **ended.end, **on, **by_mass)
    # the place of the rail does not change the time, and the same force goes on
    rail = "joint.ground_point"
    moved = lierb.integrate(cart(-6.0, events=turn()), **ended.end, **on, with_respect_to=rail)
    assert_allclose(moved.sensitivity("pose", rail)[0, 3:], np.eye(3), atol=1e-12)
    same = lierb.integrate(cart(-3.0, events=turn()), **ended.end, **on, **by_mass)
    assert_allclose(same.sensitivity("twist", "body.mass")[0, 5], 3.0, rtol=1e-9)


@lierb.event(terminal=True)
def land(r):
    return r[2] - 1.0


@lierb.event
def level(r):
    return 1.0 - r[2] ** 3


@pytest.mark.slow
@pytest.mark.parametrize("steps", [{"rtol": 1e-9}, {"dt": 0.01}])
def test_events_at_the_instant_of_a_terminal_one_are_kept(steps):
    thrown = np.c_[np.zeros((64, 5)), np.linspace(1.0, 2.0, 64)]
    run = lierb.integrate(cart(0.5, events=[land(), level()]), twist0=thrown, t_end=3.0, **steps)
    names = [row["event"] for row in run.events.to_pylist()]
    assert (names.count("land"), names.count("level")) == (64, 64)
    assert max(row["t"] for row in run.events.to_pylist()) <= run.t.max()


@lierb.observable
def drive(t):
    return np.where(t < 2.0, 10.0, 0.0)


@lierb.wrench(discontinuities="off", off=2.0)
def thrust(t, R, r, omega, v, params):
    return np.zeros(3), np.array((0.0, 0.0, np.where(t < params.off, 10.0, 0.0)))


@pytest.mark.slow
def test_means_end_at_declared_jumps():
    body = lierb.Body(1.0, (0.1, 0.1, 0.1))
    given = lierb.Problem(body, lierb.joints.free(), forces=thrust(), observables=drive())
    run = lierb.integrate(given, rtol=1e-8, t_end=5.0)
    assert_allclose(run["drive_mean"], 4.0, rtol=1e-12)


@pytest.mark.slow
def test_propagation_tells_of_steps_and_of_runs_that_end():
    rotor, twist0 = balanced_rotor()
    spread = {"body.com": (1e-5,) * 3}
    with pytest.warns(DerivativeWarning, match="if steps are halved"):
        lierb.propagate(rotor, spread, "body.com", [1.0, 3.0], "omega", twist0=twist0)
    thrown = {"twist0": (0.0, 0.0, 0.0, 0.0, 0.0, 1.0), "dt": 0.01}
    with pytest.raises(ArgumentError, match=r"an event ends the nominal run at t = 0.333"):
        lierb.propagate(
            cart(-3.0, events=turn()), {"body.mass": 0.01}, "body.mass", [0.2, 0.5], "position",
            **thrown,
        )  # fmt: skip


@pytest.mark.slow
def test_a_ground_that_moves_along_one_axis_has_implicit_steps():
    """∂/∂t of the constant components is a constant, which compiled code must return too."""
    pin = lierb.joints.revolute(axis=(0.0, 1.0, 0.0), body_point=(0.0, 0.0, 0.3))
    body = lierb.Body(1.0, (0.1, 0.1, 0.1))
    shaken = lierb.Problem(
        body, pin, gravity=(0.0, 0.0, -9.81), ground_motion=lambda t: (0.1 * t**2, 0.0, 0.0)
    )
    start = {"pose0": pin.pose([0.3]), "t_end": 0.3}
    fine = lierb.integrate(shaken, **start, dt=1e-3)
    stiff = lierb.integrate(shaken, **start, dt=1e-2, method="Rodas4")
    assert_allclose(stiff.omega, fine.omega, atol=1e-7)  # of order 4, at 10 ms


@lierb.controller(every=0.1)
def hold(omega):
    return {"torque": -0.2 * omega}


@lierb.wrench
def act(t, R, r, omega, v, controls):
    return controls.torque, np.zeros(3)


@pytest.mark.slow
def test_long_adaptive_runs_with_controllers_end():
    """From 2000 steps on, a run is examined for stability at its end, where it needs controls."""
    held = lierb.Problem(
        lierb.Body(1.0, (0.1, 0.12, 0.15)), lierb.joints.spherical(), forces=act(),
        controllers=hold(),
    )  # fmt: skip
    run = lierb.integrate(held, twist0=(1, 2, 3, 0, 0, 0), rtol=1e-6, t_end=210.0)
    assert run["steps"][0] > 2000


@lierb.observable
def rate(omega):
    return omega[1]


def balanced_rotor():
    hinge = lierb.joints.revolute(axis=(0.0, 1.0, 0.0))
    body = lierb.Body(2.0, (0.03, 0.05, 0.03))
    rotor = lierb.Problem(body, hinge, (0.0, 0.0, -9.81), observables=rate())
    return rotor, hinge.twist(omega=(0.0, 20.0, 0.0))


@pytest.mark.slow
def test_steps_that_resolve_the_motion_alone_are_told():
    """A steady rotation takes steps of half a second; ∂ω/∂com turns with 20 rad/s.

    ω̇ = m g com₁ cos 20 t/I, so that ∂ω/∂com₁ = m g sin(20 t)/(20 I).
    """
    rotor, twist0 = balanced_rotor()
    run = {"twist0": twist0, "t_end": 3.0}
    for differentiate in (
        lambda **steps: lierb.gradient(rotor, "rate", ["body.com"], **run, **steps)["body.com"],
        lambda **steps: lierb.integrate(
            rotor, **run, **steps, with_respect_to="body.com"
        ).sensitivity("rate", "body.com"),
    ):
        with pytest.warns(DerivativeWarning, match="if steps are halved"):
            differentiate(rtol=1e-9)
        right = 2.0 * 9.81 / 0.05 / 20.0 * np.sin(60.0)
        assert_allclose(differentiate(rtol=1e-9, dt_max=0.01)[0, 0], right, rtol=1e-9)


def test_a_parameter_that_would_take_the_name_of_the_bodys_is_refused():
    @lierb.wrench(mass=2.0)
    def body(t, R, r, omega, v, params):
        return np.zeros(3), np.array((0.0, 0.0, params.mass))

    given = lierb.Problem(lierb.Body(1.0, (0.1, 0.1, 0.1)), lierb.joints.free(), forces=body())
    with pytest.raises(ArgumentError, match=r"body.mass is a .* rename the function or its"):
        lierb.integrate(given, dt=0.1, t_end=1.0, with_respect_to="body.mass")


@pytest.mark.slow
def test_a_power_of_zero_has_derivatives_by_its_exponent():
    """A body falls from rest against a drag c v^n: ∂z/∂n is finite."""

    @lierb.wrench(n=1.5)
    def air(t, R, r, omega, v, params):
        speed = np.sqrt(v[0] ** 2 + v[1] ** 2 + v[2] ** 2)
        return np.zeros(3), np.array((0.0, 0.0, 0.3 * speed**params.n))  # it falls

    def fallen(n, **more):
        given = lierb.Problem(
            lierb.Body(1.0, (0.1, 0.1, 0.1)), lierb.joints.free(), (0.0, 0.0, -9.81),
            forces=air(n=n),
        )  # fmt: skip
        return lierb.integrate(given, dt=1e-2, t_end=1.0, **more)

    by_exponent = fallen(1.5, with_respect_to="air.n").sensitivity("pose", "air.n")[0, 5, 0]
    step = 1e-5
    high, low = (fallen(1.5 + s).position[0, 2] for s in (step, -step))
    assert_allclose(by_exponent, (high - low) / (2.0 * step), rtol=1e-6)  # of the difference


# ---- loops whose rows are redundant only while they are closed ---------------------------------


def _hinge_axes(turn, length):
    """Denavit and Hartenberg's frame of the next hinge."""
    c, s, frame = np.cos(turn), np.sin(turn), np.eye(4)
    frame[1:3, 1:3], frame[0, 3] = [[c, -s], [s, c]], length
    return frame


@lierb.observable(unit="rad/s²")
def seen(alpha):
    return alpha[2]


@pytest.mark.slow
def test_accelerations_in_a_loop_that_drifts_are_those_of_its_motion():
    """Bennett's linkage has three redundant rows, which its drift makes independent."""
    first, second = np.radians(50.0), np.radians(25.0)
    a = 0.3
    b = a * np.sin(second) / np.sin(first)
    hinge, at = lierb.joints.revolute, np.eye(4)

    def bar(length):
        inertia, com = (0.004, 0.005, 0.006), (0.5 * length, 0.01, 0.0)
        return lierb.Body(0.5 + length, inertia, com, about="com")

    linkage = lierb.Mechanism(
        [
            lierb.Link("l1", bar(a), hinge(body_frame=at, ground_frame=at)),
            lierb.Link(
                "l2", bar(b), hinge(body_frame=at, parent_frame=_hinge_axes(first, a)), "l1"
            ),
            lierb.Link(
                "l3", bar(a), hinge(body_frame=at, parent_frame=_hinge_axes(second, b)), "l2"
            ),
        ],
        lierb.Loop(
            "j4",
            hinge(
                body_frame=_hinge_axes(first, a),
                parent_frame=np.linalg.inv(_hinge_axes(second, b)),
            ),
            "l3",
        ),
        gravity=(0.0, -3.0, -9.0),
        observables=seen().on("l1"),
    )
    pose0 = linkage.close(linkage.pose({"l1": 0.8, "l2": -2.5, "l3": -0.8}), hold={"l1": 0.8})
    twist0 = linkage.project(linkage.twist({"l1": 4.0}, pose0), pose0, hold="l1")
    dt = 1e-3
    run = lierb.integrate(
        linkage, pose0=pose0, twist0=twist0, dt=dt, t_end=1.0, save_every=1, record=["state"]
    )
    omega = run["l1"].omega[:, 0, 2]
    differences = (omega[2:] - omega[:-2]) / (2.0 * dt)
    found = np.array(run.history["seen"])[1:-1]
    # 17 rad/s² at most; garbage of 6000 rad/s² without the rank at the start.
    assert_allclose(found, differences, atol=0.1)
