"""Derivatives through controllers, whose outputs are held from tick to tick: closed forms."""

import numpy as np
import pytest

import lierb
from derivatives.complex_steps import H
from lierb.errors import ArgumentError, DerivativeWarning

INERTIA, PERIOD, TICKS = 0.1, 0.05, 20
LENGTHS = PERIOD * np.array((*[1.0] * TICKS, 0.4))  # of the times between ticks, s
END = LENGTHS.sum()
JOINT = lierb.joints.revolute()
START = {"twist0": JOINT.twist(omega=(0.0, 0.0, 1.0)), "t_end": END}
VALUES = {"gain": 2.0, "damping": 0.3, "share": 0.7, "last": 0.2, "bias": 0.0}


@lierb.controller(
    every=PERIOD,
    memory={"last": 0.2},
    **{k: VALUES[k] for k in ("gain", "damping", "share", "bias")},
)
def servo(R, omega, params, memory):
    angle = np.arctan2(R[1, 0], R[0, 0])
    seen = params.share * angle + (1.0 - params.share) * memory.last
    torque = -params.gain * seen - params.damping * omega[2]
    return {"torque": torque + params.bias * lierb.noise.normal("torque")}, {"last": seen}


@lierb.wrench
def drive(t, R, r, omega, v, params, controls):
    return (0.0, 0.0, controls.torque), (0.0, 0.0, 0.0)


@lierb.observable
def turned(R):
    return np.arctan2(R[1, 0], R[0, 0])


def wheel(observables=(), **values):
    body = lierb.Body(1.0, (INERTIA, INERTIA, INERTIA))
    return lierb.Problem(
        body, JOINT, forces=drive(), controllers=servo(**values), observables=observables
    )


def torques(gain, damping, share, last, inertia=INERTIA, speed=1.0, **_):
    """Torque from tick to tick; angle and rate at the end."""
    angle, rate, held = 0.0, speed, []
    for h in LENGTHS:
        last = share * angle + (1.0 - share) * last
        held.append(-gain * last - damping * rate)
        angle += rate * h + 0.5 * held[-1] / inertia * h * h
        rate += held[-1] / inertia * h
    return np.array(held), angle, rate


def exact(**values):
    """Angle, rate and torque at the end."""
    held, angle, rate = torques(**values)
    return np.array((angle, rate, held[-1]))


def angles(speed=1.0, inertia=INERTIA, **values):
    """Angle at the ends of steps of 0.01 s."""
    angle, rate, seen = 0.0, speed, []
    for torque, length in zip(torques(**values)[0], LENGTHS, strict=True):
        steps = 0.01 * np.arange(1, round(length / 0.01) + 1)
        seen += [angle + rate * h + 0.5 * torque / inertia * h * h for h in steps]
        angle, rate = seen[-1], rate + torque / inertia * length
    return np.array(seen)


NAMES = {
    "gain": "servo.gain", "damping": "servo.damping", "share": "servo.share", "last": "servo.last",
    "speed": "omega0", "inertia": "body.inertia",
}  # fmt: skip
ALL = [*NAMES.values(), "servo.bias"]


@pytest.mark.slow
@pytest.mark.parametrize(
    "options",
    [pytest.param({"rtol": 1e-12}, marks=pytest.mark.long), {"dt": 0.01}],
    ids=["adaptive", "fixed"],
)
def test_derivatives_are_those_of_the_sampled_loop(options):
    result = lierb.integrate(wheel(), **START, **options, with_respect_to=ALL)
    values = VALUES | {"inertia": INERTIA, "speed": 1.0}
    for key, name in NAMES.items():
        moved = exact(**values | {key: values[key] + 1j * H}).imag / H
        which = 2 if key in ("speed", "inertia") else 0  # about e₃: the third direction
        found = [result.sensitivity(of, name)[0] for of in ("pose", "twist")]
        turned, faster = (x[2, which] for x in found)
        torque = result.sensitivity("torque", name)[0, which]
        # steps of constant torque are exact: rounding of 21 of them
        np.testing.assert_allclose((turned, faster, torque), moved, rtol=1e-9, atol=1e-12)
    plain = lierb.integrate(wheel(), **START, **options)
    for name in ("omega", "torque", "rotation"):
        assert plain.summary[name].equals(result.summary[name])


@pytest.mark.slow
def test_noise_depends_on_nothing():
    noisy = lierb.integrate(wheel(bias=1e-3), **START, dt=0.01, seed=3, with_respect_to=ALL)
    clean = lierb.integrate(wheel(), **START, dt=0.01, with_respect_to=ALL)
    ends = [
        lierb.integrate(wheel(bias=b), **START, dt=0.01, seed=3).summary["omega"][0].as_py()[2]
        for b in (0.0, 2e-3)
    ]
    # linear in noise: a difference is the derivative, to rounding over its step
    slope = (ends[1] - ends[0]) / 2e-3
    assert noisy.sensitivity("twist", "servo.bias")[0, 2, 0] == pytest.approx(slope, rel=1e-9)
    gains = [x.sensitivity("twist", "servo.gain")[0, 2, 0] for x in (noisy, clean)]
    assert gains[0] != gains[1]
    assert gains[0] == pytest.approx(gains[1], rel=0.1)


@pytest.mark.slow
def test_a_trajectory_keeps_its_noise_and_derivatives_in_a_batch():
    problem, numbers = wheel(bias=1e-3), [7, 2]
    start = {"twist0": np.stack([START["twist0"], 0.5 * np.asarray(START["twist0"])])}
    run = START | {"dt": 0.01, "seed": 3, "with_respect_to": ALL}
    both = lierb.integrate(problem, **run | start, trajectories=numbers)
    for i, number in enumerate(numbers):
        one = {"twist0": start["twist0"][i]}
        alone = lierb.integrate(problem, **run | one, trajectories=[number])
        assert np.array_equal(both.omega[i], alone.omega[0])
        for name in ALL:
            found, expected = (each.sensitivity("twist", name) for each in (both, alone))
            assert np.array_equal(found[i], expected[0]), name


@lierb.controller(every=0.1, level=0.5)
def relay(omega, params):
    return {"torque": lierb.where(omega[2] > params.level, -1.0, 1.0)}


def test_controllers_that_switch_are_named_and_periods_refused():
    """Before the run, which needs no kernel here, where warnings are errors."""
    body = lierb.Body(1.0, (INERTIA, INERTIA, INERTIA))
    problem = lierb.Problem(body, JOINT, forces=drive(), controllers=relay())
    with pytest.raises(DerivativeWarning, match="relay: switches by a comparison"):
        lierb.integrate(problem, **START, dt=0.01, with_respect_to="body.mass")
    with pytest.raises(
        ArgumentError, match=r"servo\.every.* determines times at which servo jumps"
    ):
        lierb.integrate(wheel(), **START, dt=0.01, with_respect_to="servo.every")


@pytest.mark.long
def test_looped_code_carries_them_too():
    links = [lierb.Link("wheel", lierb.Body(1.0, (INERTIA,) * 3), JOINT)]
    mechanism = lierb.Mechanism(
        links, forces=drive().on("wheel"), controllers=servo().on("wheel"),
        observables=turned().on("wheel"),
    )  # fmt: skip
    pose0 = mechanism.pose()
    result = lierb.integrate(
        mechanism, pose0=pose0, twist0=mechanism.twist({"wheel": 1.0}, pose0), t_end=END, dt=0.01,
        solver="looped", with_respect_to=["wheel.servo.gain"],
    )  # fmt: skip
    values = VALUES | {"inertia": INERTIA, "speed": 1.0, "gain": VALUES["gain"] + 1j * H}
    moved = exact(**values).imag / H
    found = result.sensitivity("wheel.twist", "wheel.servo.gain")[0, 2, 0]
    assert found == pytest.approx(moved[1], rel=1e-9)
    held = result.sensitivity("torque", "wheel.servo.gain")[0, 0]
    assert held == pytest.approx(moved[2], rel=1e-9)
    seen = angles(**values)
    largest = result.sensitivity("turned_max", "wheel.servo.gain")[0, 0]
    assert largest == pytest.approx(seen[np.argmax(seen.real)].imag / H, rel=1e-9)


@lierb.controller(every=0.25, gain=1.0)
def echo(r, params):
    return {"u": params.gain * r[2]}


@lierb.event(terminal=True, level=0.6)
def loud(controls, r, params):
    return controls.u + 0.1 * r[2] - params.level


@pytest.mark.slow
def test_an_event_by_the_jump_of_an_output_stays_at_its_tick():
    """z = v t + t²/4: u + z/10 jumps over 0.6 at the tick at 0.5 s, whatever changes."""
    push = lierb.forces.constant_wrench(force=(0.0, 0.0, 0.5))
    slide = lierb.Problem(
        lierb.Body(1.0, (0.1, 0.2, 0.25)), lierb.joints.prismatic(), controllers=echo(),
        forces=push, events=loud(),
    )  # fmt: skip
    names = ("twist0", "echo.gain", "loud.level")
    result = lierb.integrate(
        slide, twist0=(0.0, 0.0, 0.0, 0.0, 0.0, 1.0), t_end=3.0, rtol=1e-9, with_respect_to=names
    )
    assert abs(result.t[0] - 0.5) < 1e-15
    assert result.summary["status"].to_pylist() == ["event"]
    for name in names:
        assert not result.sensitivity("t", name).any()
    assert abs(result.sensitivity("pose", "twist0")[0, 5, 5] - 0.5) < 1e-12
    assert abs(result.sensitivity("u", "twist0")[0, 5] - 0.5) < 1e-12
    assert abs(result.sensitivity("u", "echo.gain")[0, 0] - 0.5625) < 1e-12
