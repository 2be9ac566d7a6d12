"""Adaptive steps beside what acts, or is watched, in a part of the way alone."""

from __future__ import annotations

import numpy as np
import pytest
from cases import long_but

import lierb

INERTIA = 0.02  # kg m², about the axis
SPEEDS = np.linspace(1.0, 20.0, 64)  # rad/s
LAST = 20.0  # s
ROTOR = lierb.Body(1.0, (INERTIA, INERTIA, INERTIA))


def rotor(**elements) -> lierb.Problem:
    return lierb.Problem(ROTOR, lierb.joints.revolute(), **elements)


def turning(rates) -> np.ndarray:
    twists = np.zeros((np.size(rates), 6))
    twists[:, 2] = rates
    return twists


def angles(result) -> np.ndarray:
    return np.arctan2(result.rotation[:, 1, 0], result.rotation[:, 0, 0])


def between_stops(speed, lower, upper, stiffness, t, inertia=INERTIA):
    """Angle of a wheel that starts at 0 with `speed` > 0: it turns freely between the stops, and is
    half a period of a harmonic oscillator in each of them.
    """
    rate = np.sqrt(stiffness / inertia)
    contact, way = np.pi / rate, (upper - lower) / speed
    since = np.mod(t - upper / speed, 2.0 * (way + contact))  # since the upper stop was met
    back = since - contact - way  # since the lower one was met
    phases = [
        (t < upper / speed, speed * t),
        (since < contact, upper + speed / rate * np.sin(rate * since)),
        (back < 0.0, upper - speed * (since - contact)),
        (back < contact, lower - speed / rate * np.sin(rate * back)),
    ]
    rest = lower + speed * (back - contact)
    return np.select([mask for mask, _ in phases], [x for _, x in phases], rest)


def beyond(params, phi):
    above = lierb.where(phi > params.upper, phi - params.upper, 0.0)
    return above + lierb.where(phi < params.lower, phi - params.lower, 0.0)


@lierb.wrench(lower=-1.0, upper=1.0, stiffness=1.0)
def own_stops(t, R, r, omega, v, params):
    above = beyond(params, np.arctan2(R[1, 0], R[0, 0]))
    return (0.0, 0.0, -params.stiffness * above), (0.0, 0.0, 0.0)


@lierb.wrench(lower=-1.0, upper=1.0, stiffness=1.0)
def branching_stops(t, R, r, omega, v, params):
    phi, above = np.arctan2(R[1, 0], R[0, 0]), 0.0
    if phi > params.upper:
        above = phi - params.upper
    elif phi < params.lower:
        above = phi - params.lower
    return (0.0, 0.0, -params.stiffness * above), (0.0, 0.0, 0.0)


STOPS = {
    "joint_limit": lierb.forces.joint_limit,
    "traced": own_stops,
    "body by body": branching_stops,
}


def allowed(kind, rtol):
    """An error of ω of rtol in each of some hundred contacts adds up over 20 s. Where stops are the
    user's own, their kinks are met within steps, which are of low order there.
    """
    return 3e4 * rtol if kind == "joint_limit" else 2e3 * rtol ** (2 / 3)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::lierb.errors.ScalarFunctionWarning")
@pytest.mark.parametrize(
    ("kind", "method"),
    [
        ("joint_limit", "DOP853"),
        *(
            pytest.param(*case, marks=pytest.mark.long)
            for case in (("body by body", "Tsit5"), ("joint_limit", "Tsit5"))
        ),
        pytest.param("traced", "DOP853", marks=pytest.mark.long),
    ],
)
def test_integrate_meets_every_stop(kind, method):
    """Closed form. In free flight the error estimate is zero: steps were whole turns long."""
    for degrees, stiffness in ((60, 200.0), (90, 2000.0), (120, 200.0), (150, 200.0), (165, 200.0)):
        stop = np.radians(degrees)
        # the energy must be less than that of a stop pressed in up to half a turn
        most = np.sqrt(0.9 * stiffness / INERTIA) * (np.pi - stop)
        speeds = np.array([speed for speed in SPEEDS if speed < most])
        for lower, upper in ((-stop, stop), (-0.5 * stop, 0.9 * stop)):
            force = STOPS[kind](lower=lower, upper=upper, stiffness=stiffness)
            expected = between_stops(speeds, lower, upper, stiffness, LAST)
            for rtol in (1e-6, 1e-9):
                result = lierb.integrate(
                    rotor(forces=force), twist0=turning(speeds), rtol=rtol, t_end=LAST,
                    method=method, cspace="reduced",
                )  # fmt: skip
                assert set(result.summary["status"].to_pylist()) == {"ok"}
                off = np.angle(np.exp(1j * (angles(result) - expected)))
                assert np.abs(off).max() < allowed(kind, rtol)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "most"), [("DOP853", 280), pytest.param("Rodas4", 1100, marks=pytest.mark.long)]
)
def test_stops_are_met_without_a_search(method, most):
    """A wheel that a torque pulls to a stop meets 20 kinks in 10 s.

    A step that would pass one is repeated once, up to where the accelerated motion meets it. Steps
    that approach it by fractions of the distance are 561 with DOP853, and 1241 with Rodas4; those
    counted here are 247 and 1024.
    """
    stop = lierb.forces.joint_limit(lower=-1.0, upper=1.0, stiffness=200.0)
    torque = lierb.forces.constant_wrench(torque=(0.0, 0.0, 0.3))
    joint = lierb.joints.revolute()
    wheel = lierb.Problem(lierb.Body(1.0, (0.02, 0.02, 0.02)), joint, forces=[stop, torque])
    twist0 = joint.twist(omega=(0.0, 0.0, 5.0))
    result = lierb.integrate(wheel, twist0=twist0, t_end=10.0, rtol=1e-6, method=method)
    tried = sum(result.summary[name][0].as_py() for name in ("steps", "rejected"))
    assert tried < most
    # energy of 0.25 J, error of some 100 steps at rtol 1e-6 each
    assert result.summary["energy_drift_max"][0].as_py() < 1e-4


@pytest.mark.slow
@pytest.mark.parametrize("spin", [0.0, 300.0])
def test_integrate_meets_stops_between_links(spin):
    """Two wheels on one axis, the second one limited against the first: their relative turn is that
    of one wheel with the inertia Θ₁Θ₂/(Θ₁ + Θ₂), however fast both turn together.
    """
    first = lierb.Body(1.0, (0.06, 0.06, 0.06))
    joints = lierb.joints.revolute()
    links = [lierb.Link("hub", first, joints), lierb.Link("wheel", ROTOR, joints, "hub")]
    reduced, stop, stiffness = 0.06 * INERTIA / (0.06 + INERTIA), np.radians(165.0), 200.0
    force = lierb.forces.joint_limit(lower=-stop, upper=stop, stiffness=stiffness)
    mechanism = lierb.Mechanism(links, forces=force.on("wheel"))
    speeds = np.linspace(1.0, 20.0, 32)
    twists = {"hub": turning(np.full(32, spin)), "wheel": turning(spin + speeds)}
    result = lierb.integrate(mechanism, twist0=twists, rtol=1e-8, t_end=LAST)
    assert set(result.summary["status"].to_pylist()) == {"ok"}
    hub, wheel = angles(result["hub"]), angles(result["wheel"])
    expected = between_stops(speeds, -stop, stop, stiffness, LAST, reduced)
    off = np.angle(np.exp(1j * (wheel - hub - expected)))
    # an error of 1e-8 of 320 rad/s in each of some hundred contacts, over 20 s
    assert np.abs(off).max() < 3e4 * 1e-8 * (1.0 + spin / 20.0)


@pytest.mark.slow
@pytest.mark.parametrize("method", long_but(["DOP853", "DP54"], "DOP853"))
def test_integrate_meets_a_floor_after_free_fall(method):
    """Free fall is exact for any step: nothing but the stop bounds it. A fall from rest at height h
    and its contact with a spring, x < 0, have the closed period below.
    """
    gravity, stiffness, mass = 9.81, 1e4, 2.0
    height = np.linspace(0.1, 5.0, 50)
    force = lierb.forces.slide_limit(lower=0.0, upper=100.0, stiffness=stiffness)
    problem = lierb.Problem(
        lierb.Body(mass, (0.1, 0.1, 0.1)), lierb.joints.prismatic(), (0.0, 0.0, -gravity), force
    )
    pose0 = np.tile(np.eye(4), (len(height), 1, 1))
    pose0[:, 2, 3] = height
    # in the stop x = −d + A cos(ω t + φ) with d = m g / k, from x = 0 down at √(2 g h) and back
    rate, sink = np.sqrt(stiffness / mass), mass * gravity / stiffness
    fall, speed = np.sqrt(2.0 * height / gravity), np.sqrt(2.0 * gravity * height)
    contact = 2.0 * (np.pi - np.arctan(speed / (rate * sink))) / rate
    # `contact` above counts from the turn with x = 0 on the way down to that on the way up
    period = 2.0 * fall + contact
    since = np.mod(10.0 - fall, period)
    flight = speed * (since - contact) - 0.5 * gravity * (since - contact) ** 2
    amplitude = np.hypot(sink, speed / rate)
    pressed = -sink + amplitude * np.cos(rate * since + np.arctan2(speed / rate, sink))
    expected = np.where(since < contact, pressed, flight)
    for rtol in (1e-6, 1e-9):
        result = lierb.integrate(
            problem, pose0=pose0, twist0=np.zeros(6), rtol=rtol, t_end=10.0, method=method,
            cspace="reduced",
        )  # fmt: skip
        assert set(result.summary["status"].to_pylist()) == {"ok"}
        found = np.array(result.summary["position"].to_pylist())[:, 2]
        # up to 60 contacts; a time of arrival counts by up to 10 m/s
        np.testing.assert_allclose(found, expected, atol=2e4 * rtol)


@pytest.mark.slow
def test_integrate_meets_damped_stops():
    """A damped contact, from x = 0 to x = 0, leaves exp(−ζπ/√(1−ζ²)) of the speed."""
    stiffness, damping = 500.0, 0.4
    rate = np.sqrt(stiffness / INERTIA)
    ratio = damping / (2.0 * INERTIA * rate)
    left = np.exp(-np.pi * ratio / np.sqrt(1.0 - ratio**2))
    contact = np.pi / (rate * np.sqrt(1.0 - ratio**2))
    force = lierb.forces.joint_limit(lower=-1.0, upper=1.0, stiffness=stiffness, damping=damping)
    speeds = np.linspace(2.0, 20.0, 50)
    result = lierb.integrate(
        rotor(forces=force), twist0=turning(speeds), rtol=1e-9, t_end=3.0, cspace="reduced"
    )
    for speed, angle, omega in zip(speeds, angles(result), result.omega[:, 2], strict=True):
        time, place, side = 1.0 / speed, 1.0, 1.0
        while time + contact + 2.0 / (left * speed) < 3.0:
            speed *= left
            time, side = time + contact + 2.0 / speed, -side
        rest = 3.0 - time - contact
        if rest > 0.0:  # in free flight, the others are in a contact
            assert omega == pytest.approx(-side * left * speed, rel=1e-6)
            assert angle == pytest.approx(side * (place - left * speed * rest), abs=1e-6)


@pytest.mark.long
def test_integrate_follows_a_spring_past_half_a_turn():
    """A torsional spring jumps half a turn from where it is slack. Energy is kept across the jump,
    ½k(π)² on both sides; a wheel that turns through has a period by quadrature.
    """
    stiffness = 0.4
    force = lierb.forces.torsional_spring(stiffness=stiffness)
    least = np.pi * np.sqrt(stiffness / INERTIA)
    speeds = least * np.array([1.05, 1.5, 3.0])
    # φ = A sin(ω t) up to φ = π, the other half turn mirrored
    rate = np.sqrt(stiffness / INERTIA)
    period = 2.0 * np.arcsin(np.pi / (speeds / rate)) / rate
    since = np.mod(20.0 + 0.5 * period, period) - 0.5 * period
    expected = speeds / rate * np.sin(rate * since)
    result = lierb.integrate(
        rotor(forces=force), twist0=turning(speeds), rtol=1e-9, t_end=20.0, cspace="reduced"
    )
    off = np.angle(np.exp(1j * (angles(result) - expected)))
    assert np.abs(off).max() < 2e-5  # 1e-9 of 40 rad/s in each of some 200 turns, over 20 s


@lierb.event(direction=1)
def upright(R):
    return R[1, 0]


@lierb.event(teeth=6.0)
def tooth(R, params):
    return np.sin(params.teeth * np.arctan2(R[1, 0], R[0, 0]))


@pytest.mark.long
def test_integrate_counts_every_turn_of_a_free_rotor():
    """5 rad/s for 100 s are 79.6 turns; found were 6 of 79 crossings at rtol 1e-6, 4 at 1e-9."""
    problem = rotor(events=(upright(), tooth()))
    for method in ("DOP853", "Tsit5"):
        for rtol in (1e-3, 1e-6, 1e-9):
            result = lierb.integrate(
                problem, twist0=turning(5.0), rtol=rtol, t_end=100.0, method=method
            )
            times, names = (result.events[name].to_numpy() for name in ("t", "event"))
            times = {name: times[names == name] for name in ("upright", "tooth")}
            turns = 2.0 * np.pi / 5.0 * np.arange(1, 80)
            np.testing.assert_allclose(times["upright"], turns, rtol=1e-12)
            eighths = 2.0 * np.pi / 60.0 * np.arange(1, 955)  # ± each, 12 in a turn
            np.testing.assert_allclose(times["tooth"], eighths, rtol=1e-12)


# ---- times at which functions of t jump --------------------------------------------------------


@lierb.wrench(on=1.0, off=2.0, size=1.0)
def pulse(t, R, r, omega, v, params):
    is_on = (t >= params.on) & (t < params.off)
    return (0.0, 0.0, lierb.where(is_on, params.size, 0.0)), (0.0, 0.0, 0.0)


@lierb.wrench(on=1.0, off=2.0, discontinuities=("on", "off"))
def own_pulse(t, R, r, omega, v, params):
    is_on = (t > params.on) & (t <= params.off)  # closed at the other end
    return (0.0, 0.0, lierb.where(is_on, 1.0, 0.0)), (0.0, 0.0, 0.0)


def gained(result) -> np.ndarray:
    return result.omega[:, 2]


@pytest.mark.slow
@pytest.mark.parametrize(
    "steps",
    [
        {"rtol": 1e-3}, {"rtol": 1e-9},
        pytest.param({"dt": 0.1, "method": "DOP853"}, marks=pytest.mark.long),
    ],
)  # fmt: skip
def test_discontinuities_are_met_by_steps(steps):
    """A torque of 1 N m for 1 s, somewhere in 100 s, gives 1/Θ rad/s, to rounding."""
    problem = rotor(forces=pulse(on=50.0, off=51.0))
    for start in (0.0, 1.0):
        result = lierb.integrate(
            problem, twist0=turning(start), t_end=100.0, discontinuities=[50.0, 51.0], **steps
        )
        assert gained(result)[0] - start == pytest.approx(1.0 / INERTIA, rel=1e-13)


@pytest.mark.slow
@pytest.mark.parametrize(
    "steps",
    [{"rtol": 1e-6}, pytest.param({"dt": 100 / 777, "method": "DOP853"}, marks=pytest.mark.long)],
)
def test_discontinuities_of_a_wrench_are_each_trajectory_s_own(steps):
    on, off = np.array([50.0, 20.0, 99.0, 0.0, 3.0]), np.array([51.0, 20.1, 100.0, 1e-3, 3.0])
    problem = rotor(forces=own_pulse(on=on, off=off))
    result = lierb.integrate(problem, twist0=turning(1.0)[0], t_end=100.0, **steps)
    # 100 s are known to 1e-14 s, and 1 N m turns for 1 s at most
    np.testing.assert_allclose(gained(result) - 1.0, (off - on) / INERTIA, atol=1e-11)
    alone = lierb.integrate(
        rotor(forces=own_pulse(on=20.0, off=20.1)), twist0=turning(1.0)[0], t_end=100.0, **steps
    )
    assert gained(alone)[0] == gained(result)[1]


@pytest.mark.slow
def test_discontinuities_break_nothing_that_goes_on():
    """A run that ends at a jump and another one from there are the whole run."""
    problem = rotor(forces=own_pulse(on=2.0, off=3.5))
    options = {"rtol": 1e-6, "discontinuities": [1.0, 4.0]}
    whole = lierb.integrate(problem, twist0=turning(1.0), t_end=5.0, **options)
    first = lierb.integrate(problem, twist0=turning(1.0), t_end=3.5, **options)
    rest = lierb.integrate(problem, **first.end, t_end=5.0, **options)
    assert gained(rest)[0] == pytest.approx(gained(whole)[0], rel=1e-14)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ([2.0, 1.0], "ascend"),
        ([], "row of finite times"),
        ([np.nan], "row of finite times"),
        ([[1.0]], "row of finite times"),
    ],
)
def test_discontinuities_are_checked(given, message):
    with pytest.raises(lierb.errors.TimeGridError, match=f"discontinuities.*{message}"):
        lierb.integrate(rotor(), twist0=turning(1.0), rtol=1e-6, t_end=1.0, discontinuities=given)


def test_discontinuities_name_parameters():
    with pytest.raises(lierb.errors.UnknownNameError, match=r"discontinuities='of'.*on, off"):

        @lierb.wrench(on=1.0, off=2.0, discontinuities=("on", "of"))
        def unknown(t, R, r, omega, v, params):
            return (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
