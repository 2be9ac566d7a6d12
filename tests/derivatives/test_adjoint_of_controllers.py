"""`lierb.gradient` through controllers: sampled loops in closed form, and derivatives forwards."""

from __future__ import annotations

import numpy as np
import pytest

import lierb
from derivatives.complex_steps import H
from derivatives.test_adjoint import JOINT as SOCKET
from derivatives.test_adjoint import ROUNDING, agree, drive, top
from derivatives.test_of_mechanisms import double_pendulum, four_bar
from derivatives.test_through_controllers import echo, loud
from lierb.runs import adjoint

AXLE = lierb.joints.revolute()
VALUES = {"gain": 2.0, "damping": 0.3, "share": 0.7, "last": 0.2, "scale": 1.0}
# Trajectories tick at each other's times and at times of their own, at start and end or not.
PERIODS = {
    "sensor": np.array((0.05, 0.04, 0.07, 0.1, 0.05)),
    "motor": np.array((0.05, 0.1, 0.03, 0.04, 2.0)),
}
SPAN = {"t0": 0.1, "t_end": 0.5}
NAMES = {
    "gain": "motor.gain", "damping": "motor.damping", "share": "sensor.share",
    "last": "sensor.last", "scale": "turn.scale", "inertia": "body.inertia", "speed": "twist0",
}  # fmt: skip


@lierb.controller(every=0.05, memory={"last": 0.2}, share=0.7, noise=0.0)
def sensor(R, params, memory):
    angle = np.arctan2(R[1, 0], R[0, 0])
    seen = params.share * angle + (1.0 - params.share) * memory.last
    return {"seen": seen + params.noise * lierb.noise.normal("seen")}, {"last": seen}


@lierb.controller(every=0.05, gain=2.0, damping=0.3)
def motor(omega, params, controls):
    return {"torque": -params.gain * controls.seen - params.damping * omega[2]}


@lierb.wrench(scale=1.0)
def turn(t, R, r, omega, v, params, controls):
    return (0.0, 0.0, params.scale * controls.torque), (0.0, 0.0, 0.0)


@lierb.observable
def aim(R, omega, controls):
    return R[1, 0] + 0.3 * omega[2] + 0.2 * controls.torque + 0.1 * controls.seen


def wheel(periods=PERIODS, noise=0.0) -> lierb.Problem:
    controllers = sensor(every=periods["sensor"], noise=noise), motor(every=periods["motor"])
    return lierb.Problem(
        lierb.Body(1.0, (0.1, 0.1, 0.1)), AXLE, forces=turn(), controllers=controllers,
        observables=aim(),
    )  # fmt: skip


def exact(periods, gain, damping, share, last, scale, inertia, speed):
    """`aim` at the end: the torque is constant from tick to tick, and the sensor ticks first."""
    first, end = SPAN["t0"], SPAN["t_end"]
    ticks = [
        (round(n * period, 9), which)
        for which, period in enumerate(periods)
        for n in range(round(end / period + 1.0))
        if first - 1e-9 <= n * period <= end + 1e-9
    ]
    time, angle, rate, seen, torque = first, 0.0, speed, 0.0, 0.0
    for at, which in [*sorted(ticks), (end, None)]:
        h, faster = at - time, scale * torque / inertia
        angle, rate, time = angle + rate * h + 0.5 * faster * h * h, rate + faster * h, at
        if which == 0:
            seen = last = share * angle + (1.0 - share) * last
        elif which == 1:
            torque = -gain * seen - damping * rate
    return np.sin(angle) + 0.3 * rate + 0.2 * torque + 0.1 * seen


RUN = {"twist0": AXLE.twist(omega=(0.0, 0.0, 1.0)), **SPAN}


@pytest.mark.slow
@pytest.mark.parametrize(
    "options", [{"dt": 0.01}, pytest.param({"rtol": 1e-12}, marks=pytest.mark.long)]
)
def test_a_sampled_loop_has_the_gradient_of_its_closed_form(options):
    found = lierb.gradient(wheel(), "aim", **RUN, **options)
    values = VALUES | {"inertia": 0.1, "speed": 1.0}
    for i, periods in enumerate(zip(*PERIODS.values(), strict=True)):
        # steps of constant torque are exact: rounding of some tens of them
        assert found.value[i] == pytest.approx(exact(periods, **values), rel=1e-12)
        for key, name in NAMES.items():
            moved = exact(periods, **values | {key: values[key] + 1j * H}).imag / H
            which = 2 if key in ("speed", "inertia") else 0  # about e₃: the third number
            assert found[name][i, which] == pytest.approx(moved, rel=1e-9, abs=1e-12), (i, key)


@pytest.mark.slow
def test_ticks_change_no_bit_with_the_batch_or_the_memory(monkeypatch):
    run = RUN | {"dt": 0.01, "seed": 3}
    whole = lierb.gradient(wheel(noise=1e-2), "aim", **run)
    one = {which: period[0] for which, period in PERIODS.items()}
    alone = lierb.gradient(wheel(one, noise=1e-2), "aim", **run)
    monkeypatch.setattr(adjoint, "MOST_KEPT", 0)
    parts = lierb.gradient(wheel(noise=1e-2), "aim", **run)
    for name, part in whole.parts.items():
        assert np.array_equal(alone[name][0], part[0]), name
        assert np.array_equal(parts[name], part), name


@pytest.mark.slow
def test_noise_has_no_derivatives_and_a_failure_stays_alone():
    run = RUN | {"dt": 0.01, "seed": 3}
    found, *sides = (
        lierb.gradient(wheel(noise=1e-2 + change), "aim", **run) for change in (0.0, -1e-5, 1e-5)
    )
    slope = (sides[1].value - sides[0].value) / 2e-5
    # a difference of numbers near 1, and its error of third order
    np.testing.assert_allclose(found["sensor.noise"][:, 0], slope, rtol=1e-7, atol=1e-9)
    speeds = np.outer((1.0, 1e60, 1.0, 1.0, 1.0), (0.0, 0.0, 1.0))
    with pytest.warns(lierb.errors.FailedTrajectoryWarning, match="1 trajectory failed"):
        beside = lierb.gradient(
            wheel(noise=1e-2), "aim", **run | {"twist0": AXLE.twist(omega=speeds)}
        )
    fine = [0, 2, 3, 4]
    assert np.isnan(beside["motor.gain"][1]).all()
    assert np.array_equal(beside["motor.gain"][fine], found["motor.gain"][fine])


# ---- terminal events ---------------------------------------------------------------------------


@lierb.observable(share=0.5)
def heard(t, r, controls, params):
    return controls.u * r[2] + params.share * t


@pytest.mark.long
def test_events_that_read_outputs_end_between_ticks_or_stay_at_them(monkeypatch):
    """z = v t + t²/4, and the event u + z/10 = level, where u = gain z at the last tick.

    It is reached before the tick at 0.25 s, by the jump at 0.5 s, between ticks, and never.
    """
    level = np.array((0.02, 0.6, 0.65, 50.0))
    push = lierb.forces.constant_wrench(force=(0.0, 0.0, 0.5))
    slide = lierb.Problem(
        lierb.Body(1.0, (0.1, 0.2, 0.25)), lierb.joints.prismatic(), controllers=echo(),
        forces=push, events=loud(level=level), observables=heard(),
    )  # fmt: skip
    run = {"twist0": (0.0, 0.0, 0.0, 0.0, 0.0, 1.0), "t_end": 1.0, "rtol": 1e-10}
    at_tick = np.array((0.0, 0.5625, 0.5625, 1.25))  # z at the last tick, also at the end
    z = np.array((0.2, 0.5625, 10.0 * (0.65 - 0.5625), 1.25))
    end = 2.0 * (np.sqrt(1.0 + z) - 1.0)
    free = np.array((1.0, 0.0, 1.0, 0.0))  # of trajectories whose end time changes
    rate = 1.0 + 0.5 * end
    by_level, by_gain = free * 10.0 / rate, -free * 10.0 * at_tick / rate
    for each in (adjoint.MOST_KEPT, 0):
        monkeypatch.setattr(adjoint, "MOST_KEPT", each)
        found = lierb.gradient(slide, "heard", **run)
        assert np.abs(found.value - (at_tick * z + 0.5 * end)).max() < 1e-12
        along = at_tick * rate + 0.5  # d/dt of the observable, whose u is constant
        assert np.abs(found["loud.level"][:, 0] - along * by_level).max() < 1e-10
        expected = along * by_gain + at_tick * z
        assert np.abs(found["echo.gain"][:, 0] - expected).max() < 1e-10
        assert np.abs(found["heard.share"][:, 0] - end).max() < 1e-12
    time = lierb.gradient(slide, "t", **run)
    assert np.abs(time["loud.level"][:, 0] - by_level).max() < 1e-10
    assert np.abs(time["echo.gain"][:, 0] - by_gain).max() < 1e-10


# ---- every kind of run: derivatives forwards ---------------------------------------------------


@lierb.controller(every=0.03, memory={"last": 0.1, "past": np.zeros(2)}, gain=0.4)
def feel(t, specific_force, alpha, omega, params, memory):
    outputs = {"felt": params.gain * specific_force[0] + 0.1 * t * memory.past[1], "rate": alpha[1]}
    return outputs, {"last": omega[1], "past": np.array((memory.last, memory.past[0]))}


@lierb.controller(every=0.05, gain=0.4)
def pull(omega, params, controls):
    return {"u": -params.gain * omega[1] + 0.02 * controls.felt + 0.01 * controls.rate}


@lierb.wrench(scale=1.1)
def bend(t, R, r, omega, v, params, controls):
    return (0.0, params.scale * controls.u, 0.0), (0.01 * controls.felt, 0.0, 0.0)


@lierb.states(spent=0.2)
def usage(controls, states):
    return {"spent": controls.u**2 + 0.1 * states.spent}


@lierb.observable
def shown(R, omega, controls, states):
    return R[0, 2] + omega[1] * controls.u + states.spent


@pytest.mark.long
@pytest.mark.parametrize(
    ("of", "options"),
    [
        ("energy", {"dt": 2e-3}),
        ("shown", {"rtol": 1e-8}),
        ("shown", {"dt": 2e-3, "method": "Rodas4"}),
        ("energy", {"dt": 2e-3, "solver": "saddle"}),
        ("shown", {"dt": 2e-3, "discontinuities": [0.0513, 0.1]}),
    ],
)
def test_one_body_has_its_adjoint(of, options):
    count = 11
    twists = SOCKET.twist(omega=np.random.default_rng(4).normal(size=(count, 3)) * (1.0, 3.0, 2.0))
    controllers = (
        feel(every=np.linspace(0.04, 0.09, count)), pull(every=np.linspace(0.05, 0.013, count))
    )  # fmt: skip
    problem = top(
        np.linspace(5.0, 7.0, count), forces=(bend(), drive()), states=usage(),
        controllers=controllers, observables=shown(),
    )  # fmt: skip
    agree(problem, of, twist0=twists, t0=-0.16, t_end=0.2, **options)


@pytest.mark.long
@pytest.mark.parametrize("options", [{"dt": 2e-3}, {"rtol": 1e-8}])
def test_a_double_pendulum_has_its_adjoint(options):
    plain, every = double_pendulum(), np.linspace(0.02, 0.05, 5)
    controlled = lierb.Mechanism(
        plain.links, gravity=plain.gravity, forces=[*plain.forces, bend().on("lower")],
        controllers=[feel(every=every).on("lower"), pull().on("upper")],
        states=usage().on("upper"), observables=shown().on("lower"),
    )  # fmt: skip
    pose0 = controlled.pose({"upper": 0.7, "lower": np.linspace(0.0, 0.3, 5)[:, None]})
    start = {"pose0": pose0, "twist0": controlled.twist({"upper": 1.0}, pose0), "t_end": 0.4}
    agree(controlled, "shown", **start, **options)


@pytest.mark.long
def test_a_loop_has_its_adjoint():
    plain, pose0, twist0 = four_bar()
    controlled = lierb.Mechanism(
        plain.links, loops=plain.loops, gravity=plain.gravity,
        forces=[*plain.forces, bend().on("rocker")], states=usage().on("crank"),
        controllers=[feel().on("coupler"), pull().on("crank")], observables=shown().on("coupler"),
    )  # fmt: skip
    run = {"pose0": pose0, "twist0": twist0, "t_end": 0.2, "dt": 2e-3, "stabilise": "project"}
    agree(controlled, "shown", 10.0 * ROUNDING, **run)
