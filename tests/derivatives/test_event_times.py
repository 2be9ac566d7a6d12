"""Derivatives of runs that events end: end times, and states that change with them."""

from __future__ import annotations

import numpy as np
import pytest

import lierb

G = 9.81


@lierb.event(direction=-1, terminal=True, height=0.2)
def landing(r, params):
    return r[2] - params.height


@lierb.event(direction=-1)
def passes(r):
    return r[2] - 0.5


@lierb.event(terminal=True, at=0.4)
def bell(t, params):
    return t - params.at


NAMES = ("twist0", "gravity", "landing.height", "pose0")
START = np.array((0.3, -0.2, 0.4, 1.0, 0.5, 2.0))


def thrown(speeds=(2.0,), events=None, **options):
    """A body thrown up, that turns about its centre of mass as it flies."""
    problem = lierb.Problem(
        lierb.Body(1.0, (0.4, 0.4, 0.4)), lierb.joints.free(), (0.0, 0.0, -G),
        events=[landing(), passes()] if events is None else events,
    )  # fmt: skip
    pose = np.eye(4)
    pose[2, 3] = 1.0
    twists = np.tile(START, (len(speeds), 1))
    twists[:, 5] = speeds
    run = {"dt": 1e-3, "t_end": 2.0, "with_respect_to": NAMES} | options
    return lierb.integrate(problem, pose0=pose, twist0=twists, **run)


def flight(speed, g=G, height=0.2, start=1.0):
    """Time of the landing and vertical speed there."""
    root = np.sqrt(speed**2 + 2.0 * g * (start - height))
    return (speed + root) / g, -root


@pytest.mark.parametrize(
    "options",
    [
        pytest.param({}, marks=pytest.mark.slow),
        pytest.param({"rtol": 1e-12, "dt": None}, marks=pytest.mark.long),
        pytest.param({"rtol": 1e-12, "dt": None, "method": "Rodas4"}, marks=pytest.mark.long),
    ],
    ids=["fixed", "adaptive", "implicit"],
)
def test_times_of_terminal_events_have_exact_derivatives(options):
    speeds = np.array((2.0, 3.0, 0.5, 1.0, 4.0))
    result = thrown(speeds, **options)
    for i, speed in enumerate(speeds):
        t, vertical = flight(speed)
        assert abs(result.summary["t"][i].as_py() - t) < 1e-11
        by = lambda name, i=i: result.sensitivity("t", name)[i]
        # r₃ = 1 + v t − g t²/2 = height there
        assert np.abs(by("twist0")[3:] - (0.0, 0.0, -t / vertical)).max() < 1e-10
        assert np.abs(by("twist0")[:3]).max() < 1e-10
        assert abs(by("landing.height")[0] - 1.0 / vertical) < 1e-10
        assert abs(by("gravity")[2] + 0.5 * t * t / vertical) < 1e-10
        assert abs(by("pose0")[5] + 1.0 / vertical) < 1e-10


@pytest.mark.slow
def test_states_at_terminal_events_change_with_the_end_time():
    result = thrown()
    t, vertical = flight(2.0)
    R, omega = result.rotation[0], result.omega[0]
    velocity = np.array((1.0, 0.5, vertical))
    spin = START[:3]  # constant, for all moments are equal
    assert np.abs(omega - spin).max() < 1e-11
    for name, by_place, by_turn in (
        ("landing.height", np.zeros((3, 1)), np.zeros((3, 1))),
        ("gravity", 0.5 * t * t * np.eye(3), np.zeros((3, 3))),
    ):
        times = result.sensitivity("t", name)[0]
        place = by_place + np.outer(velocity, times)
        turn = by_turn + np.outer(spin, times)
        pose = result.sensitivity("pose", name)[0]
        assert np.abs(pose[:3] - turn).max() < 1e-10
        assert np.abs(pose[3:] - R.T @ place).max() < 1e-10
        # on the ground, whatever changes
        assert np.abs((R @ pose[3:])[2] - (name == "landing.height")).max() < 1e-10
        # v = Rᵀ ṙ turns with the body, and falls
        rates = result.sensitivity("twist", name)[0]
        change = (t if name == "gravity" else 0.0) * np.eye(3)[:, : len(times)]
        fall = change + np.outer((0.0, 0.0, -G), times)
        turned = np.cross(R.T @ velocity, turn.T).T  # −(turn × v)
        assert np.abs(rates[3:] - (R.T @ fall + turned)).max() < 1e-9
        assert np.abs(rates[:3]).max() < 1e-10


@pytest.mark.long
def test_a_time_at_which_a_run_ends_is_its_own_derivative():
    result = thrown(events=bell(), with_respect_to=("bell.at", "twist0"))
    assert abs(result.sensitivity("t", "bell.at")[0, 0] - 1.0) < 1e-14
    assert np.abs(result.sensitivity("t", "twist0")).max() == 0.0
    # along the flow the derivative is the twist
    twist = np.concatenate([result.omega[0], result.v[0]])
    assert np.abs(result.sensitivity("pose", "bell.at")[0, :, 0] - twist).max() < 1e-12


@pytest.mark.slow
def test_trajectories_that_reach_the_end_of_the_run_have_no_change_of_time():
    result = thrown(np.array((2.0, 30.0)))
    assert [row.as_py() for row in result.summary["status"]] == ["event", "ok"]
    assert np.abs(result.sensitivity("t", "twist0")[1]).max() == 0.0
    place = result.rotation[1] @ result.sensitivity("pose", "gravity")[1, 3:]
    assert np.abs(place - 2.0 * np.eye(3)).max() < 1e-10


@pytest.mark.slow
def test_rows_before_the_event_are_at_fixed_times_and_later_ones_nan():
    result = thrown(save_at=(0.0, 0.3, 1.5), record="state")
    rows = result.sensitivity("pose", "gravity")[:, 0]
    R = result.rotation[1, 0]
    assert np.abs(R @ rows[1, 3:] - 0.045 * np.eye(3)).max() < 1e-10
    assert np.isnan(rows[2]).all()


@pytest.mark.slow
def test_every_event_has_the_derivatives_of_its_time_and_of_the_state_there():
    result = thrown(np.array((2.0, 3.0, 0.5)))
    events = result.sensitivities.events
    assert [row.as_py() for row in events["event"]] == ["passes", "landing"] * 3
    assert events["t"].equals(result.events["t"])
    by = lambda name: np.array(events[name].to_pylist())
    for row, speed in ((0, 2.0), (2, 3.0), (4, 0.5)):
        t, vertical = flight(speed, height=0.5)
        assert np.abs(by("t/twist0")[row, 3:] - (0.0, 0.0, -t / vertical)).max() < 1e-10
        assert abs(by("t/gravity")[row, 2] + 0.5 * t * t / vertical) < 1e-10
        assert by("t/landing.height")[row] == 0.0
        # it passes at its height, whatever changes
        R = np.array(result.events["rotation"][row].as_py()).reshape(3, 3)
        place = by("pose/gravity")[row].reshape(6, 3)[3:]
        assert np.abs((R @ place)[2]).max() < 1e-10
    for name in events.column_names[3:]:  # a terminal event is the end
        ends = np.array(result.sensitivities.summary[name].to_pylist())
        np.testing.assert_allclose(by(name)[1::2], ends, rtol=1e-12, atol=1e-13)


@pytest.mark.long
def test_an_event_that_does_not_end_the_run_changes_nothing():
    result = thrown(events=passes(), t_end=0.9, with_respect_to="twist0")
    assert result.events.num_rows == 1
    assert "t" not in result.sensitivities.quantities
    place = result.rotation[0] @ result.sensitivity("pose", "twist0")[0, 3:, 3:]
    assert np.abs(place - 0.9 * np.eye(3)).max() < 1e-11


@pytest.mark.long
def test_events_of_a_mechanism_end_it_on_a_joint():
    hinge = lierb.joints.revolute(axis=(0.0, 1.0, 0.0), body_point=(0.0, 0.0, 0.5))
    rod = lierb.Body(1.0, (0.1, 0.1, 0.01))
    pendulum = lierb.Mechanism(
        lierb.Link("rod", rod, hinge), gravity=(0.0, 0.0, -G),
        events=landing(height=-0.4).on("rod"),
    )  # fmt: skip
    start = pendulum.pose({"rod": 1.5})
    result = lierb.integrate(
        pendulum, pose0=start, twist0=pendulum.twist({"rod": -0.1}, start), rtol=1e-12, t_end=5.0,
        with_respect_to=("rod.landing.height", "rod.twist0", "rod.body.mass"),
    )  # fmt: skip
    # −cos φ / 2 = height: ∂φ = ∂height / (sin φ / 2) however it came there; r₃ is the height
    pose = result["rod"].rotation[0]
    by = lambda name: pose @ result.sensitivity("rod.pose", name)[0, 3:]
    assert np.abs(by("rod.landing.height")[2] - 1.0).max() < 1e-10
    assert np.abs(by("rod.twist0")[2]).max() < 1e-10
    assert np.abs(by("rod.body.mass")[2]).max() < 1e-10
    assert abs(result.sensitivity("t", "rod.body.mass")[0, 0]) > 1e-4


@lierb.states(turned=0.0)
def counter(omega):
    return {"turned": omega[2]}


@lierb.event(terminal=True, level=2.0)
def reached(states, omega, params):
    return states.turned + 0.5 * omega[2] - params.level


@pytest.mark.long
@pytest.mark.parametrize(
    "solver",
    [None, *(pytest.param(x, marks=pytest.mark.long) for x in ("looped", "unrolled"))],
)
def test_events_that_read_extra_states_have_the_derivatives_of_their_closed_form(solver):
    """s = ω₀ t + α t²/2 and ω = ω₀ + α t reach s + ω/2 = 2, α being the torque over 0.25 kg m²."""
    hinge, wheel = lierb.joints.revolute(), lierb.Body(1.0, (0.1, 0.2, 0.25))
    torque, turned, end = lierb.forces.motor(torque=0.3), counter(), reached()
    options = {"t_end": 3.0, "rtol": 1e-11}
    if solver is None:
        model = lierb.Problem(wheel, hinge, forces=torque, states=turned, events=end)
        options["twist0"], name = (0.0, 0.0, 2.0, 0.0, 0.0, 0.0), ""
    else:
        model = lierb.Mechanism(
            lierb.Link("wheel", wheel, hinge), forces=torque.on("wheel"),
            states=turned.on("wheel"), events=end.on("wheel"),
        )  # fmt: skip
        options |= {"twist0": model.twist({"wheel": 2.0}), "solver": solver}
        name = "wheel."
    names = (f"{name}motor.torque", f"{name}reached.level")
    result = lierb.integrate(model, **options, with_respect_to=names)
    t, alpha = result.t[0], 0.3 / 0.25
    rate = 2.0 + alpha * t + 0.5 * alpha  # ġ
    by_torque = -(0.5 * t * t + 0.5 * t) / 0.25 / rate
    assert abs(result.sensitivity("t", names[0])[0, 0] - by_torque) < 1e-10
    assert abs(result.sensitivity("t", names[1])[0, 0] - 1.0 / rate) < 1e-10
    at_end = result.sensitivity("turned", names[1])[0, 0]
    assert abs(at_end - (2.0 + alpha * t) / rate) < 1e-10
