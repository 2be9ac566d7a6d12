"""Derivatives of observables' minima, maxima and means: closed forms, differences of whole runs."""

import numpy as np
import pytest

import lierb
from derivatives.complex_steps import H
from derivatives.test_through_controllers import (
    INERTIA,
    LENGTHS,
    NAMES,
    START,
    VALUES,
    torques,
    wheel,
)

G, HIGH, END = 9.81, 2.0, 1.0
STATISTICS = ("min", "max", "mean")


@lierb.observable
def height(r):
    return r[2]


@lierb.observable
def falling(v):
    return -v[2]


@lierb.event(terminal=True, direction=-1)
def lands(r):
    return r[2]


def ball(**elements):
    return lierb.Problem(
        lierb.bodies.sphere(0.1, mass=1.0), lierb.joints.free(), gravity=(0.0, 0.0, -G),
        observables=[height(), falling()], **elements,
    )  # fmt: skip


def thrown(speeds):
    twists, poses = np.zeros((len(speeds), 6)), np.tile(np.eye(4), (len(speeds), 1, 1))
    twists[:, 5], poses[:, 2, 3] = speeds, HIGH
    return {"twist0": twists, "pose0": poses}


@pytest.mark.slow
@pytest.mark.parametrize("every", [1, 3])
def test_fixed_steps_measure_extremes_at_steps(every):
    speeds, times = np.array((3.0, 5.0, 8.0)), np.linspace(0.0, END, 101)[::every]
    times = np.append(times, END) if times[-1] < END else times
    start = thrown(speeds)
    options = {"dt": 0.01, "t_end": END, "measure_every": every}
    result = lierb.integrate(
        ball(), **start, **options, with_respect_to=["twist0", "pose0", "gravity"]
    )
    plain = lierb.integrate(ball(), **start, **options)
    assert result.summary.equals(plain.summary)
    heights = HIGH + np.outer(speeds, times) - 0.5 * G * times**2
    largest, least = (times[pick(heights, axis=1)] for pick in (np.argmax, np.argmin))
    close = {"rtol": 1e-12, "atol": 1e-13}  # rounding of 100 steps
    for name, at in (("max", largest), ("min", least)):
        by_twist, by_pose, by_gravity = (
            result.sensitivity(f"height_{name}", p) for p in ("twist0", "pose0", "gravity")
        )
        np.testing.assert_allclose(by_twist[:, 5], at, **close)
        np.testing.assert_allclose(by_pose[:, 5], 1.0, **close)
        np.testing.assert_allclose(by_gravity[:, 2], 0.5 * at**2, **close)
    mean = result.sensitivity("height_mean", "twist0")[:, 5]
    np.testing.assert_allclose(mean, 0.5 * END, rtol=1e-2)  # a sum of few samples
    np.testing.assert_allclose(result.sensitivity("falling_mean", "twist0")[:, 5], -1.0, **close)


@pytest.mark.long
def test_extremes_and_means_change_with_the_time_of_a_terminal_event():
    speeds = np.array((3.0, 5.0, 0.5))
    result = lierb.integrate(
        ball(events=lands()), **thrown(speeds), rtol=1e-9, t_end=4.0,
        with_respect_to="twist0",
    )  # fmt: skip
    root = np.sqrt(speeds**2 + 2.0 * G * HIGH)
    times, by_speed = (speeds + root) / G, (1.0 + speeds / root) / G
    means = HIGH + 0.5 * speeds * times - G * times**2 / 6.0
    mean_rate = 0.5 * (times + speeds * by_speed) - G * times * by_speed / 3.0
    expected = {
        "height_min": 0.0 * speeds, "height_max": speeds / G, "height_mean": mean_rate,
        "falling_max": speeds / root, "falling_min": np.full(3, -1.0),
        "falling_mean": HIGH / times**2 * -by_speed,
    }  # fmt: skip
    for name, exact in (
        ("height_min", 0.0), ("height_max", HIGH + 0.5 * speeds**2 / G), ("height_mean", means),
        ("falling_max", root), ("falling_min", -speeds), ("falling_mean", HIGH / times),
    ):  # fmt: skip
        np.testing.assert_allclose(result.summary[name].to_numpy(), exact, atol=1e-12)
    for name, exact in expected.items():
        found = result.sensitivity(name, "twist0")[:, 5]
        np.testing.assert_allclose(found, exact, atol=1e-12)  # parabolas are exact


@lierb.observable
def held(controls):
    return controls.torque


@pytest.mark.long
def test_statistics_of_a_held_output_have_the_derivatives_of_closed_forms():
    result = lierb.integrate(
        wheel(observables=held()), **START, dt=0.01, with_respect_to=list(NAMES.values())
    )

    def exact(**values):
        each, *_ = torques(**values)
        least, largest = (each[pick(each.real)] for pick in (np.argmin, np.argmax))
        return np.array((least, largest, each @ LENGTHS / LENGTHS.sum()))

    at = VALUES | {"speed": 1.0, "inertia": INERTIA}
    found = [result.summary[f"held_{of}"][0].as_py() for of in STATISTICS]
    np.testing.assert_allclose(found, exact(**at), rtol=1e-11)  # rounding of 110 steps
    for key, name in NAMES.items():
        which = 2 if key in ("speed", "inertia") else 0  # about e₃: the third direction
        by = [result.sensitivity(f"held_{of}", name)[0, which] for of in STATISTICS]
        moved = exact(**at | {key: at[key] + 1j * H}).imag / H
        np.testing.assert_allclose(by, moved, rtol=1e-9, atol=1e-11)
