"""Events, output times, and forces that switch: against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from clocks.shared import G, rows_of, spinning, thrown
from clocks.test_events import EXACT, NEVER, NEVER_SO_FAST, height, turned

import lierb
from public_cases.shared import angles_of, summed

# ---- c02: a parachute that lands ---------------------------------------------------------------


@lierb.event(direction=-1, terminal=True)
def on_the_ground(r):
    return r[2]


@pytest.mark.slow
@pytest.mark.parametrize("rtol", [1e-8, 1e-11])
def test_c02_output_times_leave_the_landing_alone(rtol):
    """scipy#10319, scipy#12100: output times spoil a terminal event. Right: ln cosh.

    Falling with quadratic drag from rest: z = h − v²/g · ln cosh(g t/v), v the terminal speed.
    """
    h, mass, terminal = np.array([30.0, 80.0, 200.0]), 90.0, 6.0
    drag = lierb.forces.drag(quadratic=mass * G / terminal**2)
    problem = lierb.Problem(
        lierb.Body(mass, (5.0, 6.0, 7.0)), lierb.joints.translation(), (0.0, 0.0, -G), forces=drag,
        events=on_the_ground(),
    )  # fmt: skip
    pose0 = np.tile(np.eye(4), (3, 1, 1))
    pose0[:, 2, 3] = h
    right = terminal / G * np.arccosh(np.exp(h * G / terminal**2))
    t = np.sort([*np.linspace(0.0, 40.0, 81), *right])  # at the landings, too
    start = {"pose0": pose0, "twist0": np.zeros((3, 6)), "method": "DP54"}
    result = lierb.integrate(problem, **start, t_end=40.0, rtol=rtol, save_at=t, record=["state"])
    assert result.summary["status"].to_pylist() == ["event"] * 3
    # 30 rtol of a height of 200 m, at 6 m/s, and as much of the speed
    landed = summed(result, "t")
    np.testing.assert_allclose(landed, right, rtol=0, atol=30 * rtol * 200.0 / terminal)
    z = result.position[..., 2]
    fallen = h - terminal**2 / G * np.log(np.cosh(G * t[:, None] / terminal))
    before = t[:, None] < landed - 1e-9
    after = t[:, None] > landed + 1e-9
    np.testing.assert_allclose(z[before], fallen[before], rtol=0, atol=30 * rtol * 200.0)
    assert np.all(np.isnan(z[after]))
    # the same to the bit, whatever output is asked for
    other = lierb.integrate(
        problem, **start, t_end=40.0, rtol=rtol, save_at=[1.0, 39.0], record=["state"]
    )
    np.testing.assert_array_equal(summed(other, "t"), landed)


# ---- c03: levels that steps end on -------------------------------------------------------------


MARKS = np.arange(1.0, 51.0) / 8.0


@pytest.mark.parametrize(
    ("method", "clock"),
    [
        ("DP54", {"rtol": 1e-6, "dt": 0.125, "dt_max": 0.125}),
        ("DP54", {"rtol": 1e-6}),
        ("RK4", {"dt": 0.125}),
        pytest.param("DP54", {"dt": 0.125}, marks=pytest.mark.slow),
    ],
)
@pytest.mark.parametrize("direction", [0, 1])
@pytest.mark.parametrize("cspace", ["SO3xR3", pytest.param("SE3", marks=pytest.mark.long)])
def test_c03_levels_on_ends_of_steps_are_crossed_once(cspace, direction, method, clock):
    """DifferentialEquations.jl#258: they are missed, or counted twice. Right: z = t, exactly.

    Steps of 1/8 s: what moves at 1 m/s is on each of 50 marks at the end of one, to the last bit.
    """
    level = height(MARKS, "mark", direction=direction)
    problem, start = thrown(np.zeros(50), np.ones(50), events=[level, NEVER])
    problem = lierb.Problem(problem.body, problem.joint, events=[level, NEVER])  # weightless
    result = lierb.integrate(problem, **start, t_end=10.0, cspace=cspace, method=method, **clock)
    assert result.events["trajectory"].to_pylist() == list(range(50))
    np.testing.assert_allclose(rows_of(result.events, "t"), MARKS, rtol=0, atol=EXACT)


# ---- c44: relays and saturation ----------------------------------------------------------------


@lierb.controller(every=0.1, force=0.0)
def relay(r, params):
    return {"push": lierb.where(r[0] > 0.0, -params.force, params.force)}


@lierb.wrench(stiffness=0.0, most=1.0)
def switching(t, R, r, omega, v, params, controls):
    limited = lierb.clip(-params.stiffness * r[0], -params.most, params.most)
    return np.zeros(3), R.T @ np.array([controls.push + limited, 0.0, 0.0])


def cart(force=0.0, **saturated):
    """1 kg that is pushed along x by a sampled relay and by a saturated spring."""
    return lierb.Problem(
        lierb.Body(1.0, (0.1, 0.1, 0.1)), lierb.joints.translation(),
        forces=switching(**saturated), controllers=relay(force=force),
    )  # fmt: skip


def at(x) -> np.ndarray:
    pose = np.eye(4)
    pose[0, 3] = x
    return pose


@pytest.mark.slow
def test_c44_a_sampled_relay_draws_parabolas():
    """bullet3#2831: discontinuous control. Right: constant acceleration from tick to tick."""
    x, v, seen = 0.3517, 0.2, [0.3517]
    for _ in range(200):
        a = -2.0 if x > 0.0 else 2.0
        x, v = x + 0.1 * v + 0.005 * a, v + 0.1 * a
        seen.append(x)
    result = lierb.integrate(
        cart(force=2.0), pose0=at(0.3517), twist0=(0.0, 0.0, 0.0, 0.2, 0.0, 0.0), t_end=20.0,
        dt=0.1, save_every=1, record=["state"],
    )  # fmt: skip
    # RK4 is exact; rounding of 200 steps
    np.testing.assert_allclose(result.position[:, 0, 0], seen, rtol=0, atol=1e-13)


@pytest.mark.slow
def test_c44_a_saturated_spring_is_parabola_and_cosine():
    """bullet3#2831 and solver users. Right: a quarter period in closed form.

    The force is −clip(k x, ±F); from rest at x₀ a parabola down to s = F/k, then a cosine.
    """
    k, F, x0 = 40.0, 3.0, 0.6
    s, w = F / k, np.sqrt(k)
    first = np.sqrt(2.0 * (x0 - s) / F)  # until it is at s
    speed = F * first
    quarter = first + np.arctan2(w * s, speed) / w  # from s to zero
    steps = 2000
    result = lierb.integrate(
        cart(stiffness=k, most=F), pose0=at(x0), twist0=np.zeros(6), t_end=quarter,
        dt=quarter / steps, save_every=steps, record=["state"],
    )  # fmt: skip
    # one step of 0.3 ms has the kink: k v dt is what the force is off by there, for dt
    off = k * speed * (quarter / steps) ** 2
    assert abs(summed(result, "position")[0, 0]) < off * quarter
    # ½ v² is what the force did: F (x₀ − s) + ½ F s
    right = -np.sqrt(2.0 * (F * (x0 - s) + 0.5 * F * s))
    np.testing.assert_allclose(summed(result, "v")[0, 0], right, rtol=0, atol=off)


# ---- c30: springs through their anchor ---------------------------------------------------------


@pytest.mark.slow
def test_c30_a_spring_goes_through_its_anchor():
    """Modelica#476, Modelica#2171: its ends meet. Right: a damped harmonic oscillation.

    A spring of no length is k x whatever its direction, and its damper acts along the line.
    """
    k, c, x0 = 30.0, 0.8, np.array([0.4, 0.4, 1e-6])
    line = np.array([(1.0, 0.0, 0.0), (0.6, 0.0, 0.8), (0.6, -0.64, 0.48)])
    spring = lierb.forces.spring_damper(
        ground_point=(0.2, 0.1, -0.3), stiffness=k, damping=[0.0, c, c]
    )
    problem = lierb.Problem(lierb.Body(1.0, (0.1,) * 3), lierb.joints.translation(), forces=spring)
    pose0 = np.tile(np.eye(4), (3, 1, 1))
    pose0[:, :3, 3] = np.array((0.2, 0.1, -0.3)) + x0[:, None] * line
    result = lierb.integrate(
        problem, pose0=pose0, twist0=np.zeros((3, 6)), dt=1e-3, t_end=5.0, save_every=50,
        record=["state"],
    )  # fmt: skip
    t, rate = 0.05 * np.arange(101)[:, None], 0.5 * np.array([0.0, c, c])
    w = np.sqrt(k - rate**2)
    right = x0 * np.exp(-rate * t) * (np.cos(w * t) + rate / w * np.sin(w * t))
    moved = result.position - (0.2, 0.1, -0.3)
    # RK4 of w dt = 0.005, 27 radians: 27 · 0.005⁴/120 of 0.4 m
    np.testing.assert_allclose(moved, right[..., None] * line, rtol=0, atol=1e-9)


@pytest.mark.slow
def test_c30_a_damper_takes_nothing_across_its_line():
    """PlanarMechanics#183: damping along the line. Right: a circle round the anchor stays one."""
    k, radius, slack = 50.0, 0.5, 0.3
    w = np.sqrt(k * (radius - slack) / radius)
    spring = lierb.forces.spring_damper(stiffness=k, damping=[0.0, 5.0, 5.0], length=slack)
    problem = lierb.Problem(lierb.Body(1.0, (0.1,) * 3), lierb.joints.translation(), forces=spring)
    twist0 = np.zeros((3, 6))
    twist0[:, 4] = radius * w
    result = lierb.integrate(
        problem, pose0=at(radius), twist0=twist0, dt=1e-3, t_end=5.0, save_every=50,
        record=["state"],
    )  # fmt: skip
    angle = 0.05 * w * np.arange(101)
    right = radius * np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)
    found = result.position
    # RK4 of w dt = 0.0045, as above; 1.4e-10 m are measured
    np.testing.assert_allclose(found, np.repeat(right[:, None], 3, 1), rtol=0, atol=1e-9)


# ---- c53: counting turns -----------------------------------------------------------------------
# scipy/scipy#9228, SciML/DifferentialEquations.jl#258: a step that is longer than what an event
# does between its ends. Right: R₂₁ = sin ωt.

RATES = np.array([0.3, 1.0, 2.0, 5.0, 5.123, 7.7, 12.0, 20.0])  # rad/s


def passes(rate, t_end) -> np.ndarray:
    """Times after 0 at which sin ωt rises through zero."""
    return np.arange(1, 1 + int(rate * t_end / (2 * np.pi))) * 2 * np.pi / rate


@pytest.mark.long
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


@pytest.mark.slow
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
@pytest.mark.parametrize("method", [None, pytest.param("DOP853", marks=pytest.mark.long)])
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
    """Drop from 10 m, e = 0.8, dt = 0.01 s: bounce 27 is the first within a step of the last."""
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
