"""Derivatives of forces that kink or lose their direction: stops, dampers of no length, roots."""

import numpy as np
import pytest
from scipy.linalg import expm

import lierb
from lierb.kernels.mechanics.kinks import Travelled, travel_to_kink

MASS, GRAVITY = 1.3, 9.7
BALL = lierb.Body(MASS, (0.02, 0.02, 0.02))
SLIDE = lierb.joints.prismatic()
BOTH = ["pose0", "twist0"]


class Bounced:
    """A mass is thrown up, meets a stop that is a spring, and is let go."""

    def __init__(self, stop: float, stiffness: float) -> None:
        self.stop, self.turn = stop, np.sqrt(stiffness / MASS)

    def motion(self, speed: float, time: float) -> tuple[float, float]:
        """Place and velocity at a time after the release, by arcs in closed form."""
        at_stop = np.sqrt(speed**2 - 2.0 * GRAVITY * self.stop)
        met = (speed - at_stop) / GRAVITY
        # beyond the stop s = −g/ω² (1 − cos ωτ) + v/ω sin ωτ, zero again where tan(ωτ/2) = vω/g
        held = 2.0 * np.arctan2(at_stop * self.turn, GRAVITY) / self.turn
        free = time - met - held
        assert free > 0.0
        return self.stop - at_stop * free - 0.5 * GRAVITY * free**2, -at_stop - GRAVITY * free


@pytest.mark.slow
@pytest.mark.parametrize("solver", ["auto", pytest.param("looped", marks=pytest.mark.long)])
@pytest.mark.parametrize("rtol", [1e-6, 1e-9])
def test_adaptive_steps_end_where_a_stop_lets_go(rtol, solver):
    """Derivatives after the release: with the kink within a step they were off by 1e-3.

    A step of 1e-9 of the usual length contains it; that of a millionth was off by 1e-6.
    """
    speed, stop, stiffness, end, h = 3.0, 0.3, 2000.0, 0.25, 1e-6
    truth = Bounced(stop, stiffness)
    force = lierb.forces.slide_limit(lower=-5.0, upper=stop, stiffness=stiffness)
    gravity = (0.0, 0.0, -GRAVITY)
    made = lierb.Problem(BALL, SLIDE, gravity, force)
    run, by = {"twist0": (0.0, 0.0, 0.0, 0.0, 0.0, speed)}, "twist0"
    if solver == "looped":
        link = lierb.Link("ball", BALL, SLIDE)
        made = lierb.Mechanism(link, gravity=gravity, forces=force.on("ball"))
        run, by = {"twist0": {"ball": run["twist0"]}}, "ball.twist0"
    result = lierb.integrate(made, **run, rtol=rtol, t_end=end, solver=solver, with_respect_to=by)
    prefix = "ball." if solver == "looped" else ""
    columns = [result.sensitivity(f"{prefix}{of}", by) for of in ("pose", "twist")]
    by_speed = [column.reshape(-1, 6, 6)[-1, 5, 5] for column in columns]
    ahead, behind = (np.array(truth.motion(speed + s, end)) for s in (h, -h))
    expected = (ahead - behind) / (2.0 * h)
    np.testing.assert_allclose(by_speed, expected, rtol=2e-8)


@pytest.mark.parametrize("part", [1.6, 1.2, 1.01, 0.9])
def test_steps_close_in_on_the_kink_of_a_sine(part):
    """Steps that pass the release are cut to end a thousandth before it."""
    turn, half = 12.4, 0.35
    release = np.pi / turn
    for _ in range(4):
        h = part * release
        change, rate = 0.1 * np.sin(turn * h), 0.1 * turn * np.cos(turn * h)
        bound = travel_to_kink(
            half + 1e-12, 0.1 * turn, Travelled(change, rate), h, (-half, half), half
        )
        longest = bound.distance / bound.rate
        if h <= bound.slack * longest:
            break
        part = longest / release
    assert h < release
    assert part > 0.79


@pytest.mark.parametrize(
    "options",
    [{"dt": 5e-3}, pytest.param({"dt": 5e-3, "cspace": "SO3xR3"}, marks=pytest.mark.long)],
)
@pytest.mark.parametrize("speed", [0.0, 1.0])
def test_a_damper_of_no_length_acts_along_the_velocity(speed, options):
    """At rest on its anchor and moving through it, along a slide: the matrix exponential."""
    k, c = 20.0, 4.0
    slide = lierb.joints.prismatic(axis=(1.0, 0.0, 0.0))
    spring = lierb.forces.spring_damper(stiffness=k, damping=c)
    made = lierb.Problem(BALL, slide, forces=spring)
    result = lierb.integrate(
        made, twist0=(0.0, 0.0, 0.0, speed, 0.0, 0.0), t_end=0.5, with_respect_to=BOTH,
        **options,
    )  # fmt: skip
    flow = expm(0.5 * np.array([[0.0, 1.0], [-k / MASS, -c / MASS]]))
    found = [
        [result.sensitivity(of, by)[0, 3, 3] for by in ("pose0", "twist0")]
        for of in ("pose", "twist")
    ]
    np.testing.assert_allclose(found, flow, atol=1e-7)  # of RK4 at 5 ms
    np.testing.assert_allclose(result.position[0, 0], flow[0, 1] * speed, atol=1e-8)
    assert max(result.summary["energy_drift_max"].to_pylist()) < 1e-7


@lierb.wrench(c=0.4)
def by_norm(t, R, r, omega, v, params):
    return (0.0, 0.0, 0.0), -params.c * np.linalg.norm(v) * v


@lierb.wrench(c=0.4)
def by_power(t, R, r, omega, v, params):
    return (0.0, 0.0, 0.0), -params.c * (v @ v) ** 0.5 * v


@pytest.mark.slow
@pytest.mark.parametrize("air", [by_norm, pytest.param(by_power, marks=pytest.mark.long)])
def test_a_root_at_zero_has_no_slope(air):
    """From rest: ‖v‖v has a derivative there, that of quadratic drag."""
    run = {"dt": 0.01, "t_end": 0.5}
    free, gravity = lierb.joints.free(), (0.0, 0.0, -9.0)
    drag = lierb.Problem(BALL, free, gravity, lierb.forces.drag(quadratic=0.4))
    own = lierb.Problem(BALL, free, gravity, air())
    expected = lierb.integrate(drag, with_respect_to=["drag.quadratic", "twist0"], **run)
    name = f"{air.function.__name__}.c"
    found = lierb.integrate(own, with_respect_to=[name, "twist0"], **run)
    for by, of_drag in ((name, "drag.quadratic"), ("twist0", "twist0")):
        np.testing.assert_allclose(
            found.sensitivity("pose", by), expected.sensitivity("pose", of_drag), atol=1e-13
        )


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::lierb.errors.DerivativeWarning")  # of stops with dampers
@pytest.mark.parametrize("options", [{"dt": 0.01}, {"rtol": 1e-9}])
@pytest.mark.parametrize("stop", [0.3, -0.7])
@pytest.mark.parametrize("off", [0.0, 1e-14])
@pytest.mark.parametrize("damping", [0.0, 0.3])
def test_the_direction_decides_on_a_stop(stop, off, damping, options):
    """A mass starts on a stop: one way it is free, the other way an oscillator with a damper.

    Its first stage was of the other kind: derivatives by the stop were off by 0.9.
    """
    other, stiffness, end = -np.sign(stop) * 2.0, 2.0, 0.8
    limits = {"lower": min(stop, other), "upper": max(stop, other)}
    force = lierb.forces.slide_limit(**limits, stiffness=stiffness, damping=damping)
    made = lierb.Problem(BALL, SLIDE, (0.0, 0.0, 0.0), force)
    by, number = [f"slide_limit.{'upper' if stop > 0.0 else 'lower'}"], np.sign(stop)
    result = lierb.integrate(
        made, pose0=SLIDE.pose([stop + number * off]), t_end=end, with_respect_to=by,
        twist0=np.array([[0.0, 0.0, 0.0, 0.0, 0.0, sign * number] for sign in (1.0, -1.0)]),
        **options,
    )  # fmt: skip
    by_stop = result.sensitivity("pose", by[0]).reshape(-1, 2, 6)[-1, :, 5]
    decay = 0.5 * damping / MASS
    turn = np.sqrt(stiffness / MASS - decay**2)
    fall = np.exp(-decay * end)
    into = number * fall * np.sin(turn * end) / turn
    places = result.position.reshape(-1, 2, 3)[-1, :, 2]
    np.testing.assert_allclose(places, [stop + into, stop - number * end], rtol=1e-8)
    if not damping:  # which would act at another instant
        np.testing.assert_allclose(by_stop, [1.0 - np.cos(turn * end), 0.0], rtol=1e-7, atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("options", [{"rtol": 1e-9}, {"dt": 1e-4}])
@pytest.mark.parametrize("turns", [None, "turned"])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_stop_does_not_depend_on_a_far_one(sign, turns, options):
    """A mass or a wheel meets one of two stops; the other one is out of reach.

    Distances were taken from the middle of both: it passed a stop at 0 beside one at 1e18.
    """
    far, turn, start, speed, end = np.array([1.0, 1e9, 1e30]), 20.0, 0.1, 1.0, 0.2
    ends = {"lower": 0.0, "upper": far} if sign > 0.0 else {"lower": -far, "upper": 0.0}
    if turns:
        joint, states = lierb.joints.revolute(axis=(0.0, 0.0, 1.0)), lierb.turns(turns)
        force = lierb.forces.joint_limit(**ends, stiffness=turn**2 * 0.02, turns=turns)
        twist0 = (0.0, 0.0, -sign * speed, 0.0, 0.0, 0.0)
    else:
        joint, states = SLIDE, ()
        force = lierb.forces.slide_limit(**ends, stiffness=turn**2 * MASS)
        twist0 = (0.0, 0.0, 0.0, 0.0, 0.0, -sign * speed)
    made = lierb.Problem(BALL, joint, forces=force, states=states)
    result = lierb.integrate(
        made, pose0=joint.pose([sign * start]), twist0=twist0, t_end=end, **options
    )
    beyond = speed / turn * np.sin(turn * (end - start / speed))
    turned = np.arctan2(result.rotation[:, 1, 0], result.rotation[:, 0, 0])
    places = turned if turns else result.position[:, 2]
    np.testing.assert_allclose(places, -sign * beyond, rtol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(("lower", "upper"), [(1.0, 1.1), (-2.0, -1.999), (2.9, 3.0)])
@pytest.mark.parametrize("number", [0, 1])
def test_a_hinge_on_a_stop_is_an_oscillator_of_order_four(lower, upper, number):
    """Angles are rounded: the first stage lacked the damper."""
    joint, stiffness, damping, end = lierb.joints.revolute(axis=(0.0, 0.0, 1.0)), 2.0, 0.1, 0.1
    force = lierb.forces.joint_limit(lower=lower, upper=upper, stiffness=stiffness, damping=damping)
    made = lierb.Problem(BALL, joint, forces=force)
    stop, sign = (lower, upper)[number], 2.0 * number - 1.0
    errors = []
    for dt in (0.01, 0.005):
        result = lierb.integrate(
            made, pose0=joint.pose([stop]), twist0=(0.0, 0.0, sign, 0.0, 0.0, 0.0), dt=dt, t_end=end
        )
        rates = [[0.0, 1.0], [-stiffness / 0.02, -damping / 0.02]]
        exact = stop + sign * expm(end * np.array(rates))[0, 1]
        found = np.arctan2(result.rotation[0, 1, 0], result.rotation[0, 0, 0])
        errors.append(abs(np.angle(np.exp(1j * (found - exact)))))
    assert errors[1] < errors[0] / 12.0
    assert errors[0] < 1e-5
