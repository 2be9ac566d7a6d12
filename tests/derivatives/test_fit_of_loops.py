"""Fits of numbers of loops, which close for some of their combinations only."""

import numpy as np
import pytest

import lierb
from lierb.analysis.followed import followed, held_directions
from lierb.errors import ArgumentError
from lierb.runs.parameters import separate_parameters
from lierb.runs.variations import Variation, with_start

AXIS = np.array([2.0, 3.0, 6.0]) / 7.0  # normal of the plane, in all bodies and in the ground
ALONG = np.array([3.0, -2.0, 0.0]) / np.sqrt(13.0)
UP = np.cross(AXIS, ALONG)
CRANK, ROD = 0.08, 0.31
TIMES = np.linspace(0.02, 0.4, 20)
RUN = {"dt": 4e-3, "solver": "looped"}
UNKNOWN = ["pin.joint.body_point", "crank.pose0", "crank.twist0"]


def slider_crank(pin=ROD * ALONG):
    """Crank, rod and slider in a tilted plane; the pin is a point of the rod."""
    revolute = lierb.joints.revolute
    box = lierb.bodies.box
    bars = {
        n: box((0.05, 0.08, 0.1), mass=m)
        for n, m in (("crank", 0.7), ("rod", 0.9), ("slider", 1.3))
    }
    return lierb.Mechanism(
        [
            lierb.Link("crank", bars["crank"], revolute(axis=AXIS)),
            lierb.Link(
                "rod", bars["rod"], revolute(axis=AXIS, parent_point=CRANK * ALONG), "crank"
            ),
            lierb.Link("slider", bars["slider"], lierb.joints.prismatic(axis=ALONG)),
        ],
        lierb.Loop("pin", revolute(pin, axis=AXIS), "rod", "slider"),
        (1.0, 2.0, -9.0),
    )


def start(made, rate=9.0):
    tilt = np.arcsin(CRANK * np.sin(0.7) / ROD)
    near = {"crank": 0.7, "rod": -0.7 - tilt, "slider": CRANK * np.cos(0.7) + ROD * np.cos(tilt)}
    pose = made.close(made.pose(near), hold={"crank": 0.7})
    return {"pose0": pose, "twist0": made.project(made.twist({}, pose), pose, hold={"crank": rate})}


def measured(made, **given):
    """Return the data of a run; with derivatives, which spares the compile of another kernel."""
    saved = {"t_end": 0.4, "save_at": TIMES, "record": "state", "with_respect_to": UNKNOWN}
    run = lierb.integrate(made, **given, **RUN, **saved)
    return {
        "t": TIMES,
        "slider.position": run["slider"].position,
        "rod.rotation": run["rod"].rotation,
    }


@pytest.mark.slow
def test_a_fit_keeps_the_pin_of_a_planar_loop_in_its_plane():
    truth, guess = slider_crank(), slider_crank((ROD - 5e-3) * ALONG + 1e-3 * UP)
    data = measured(truth, **start(truth))
    fit = lierb.fit(guess, data, UNKNOWN, **start(guess, 8.0), **RUN)
    assert fit.converged
    assert fit.estimate["pin.joint.body_point"] == pytest.approx(ROD * ALONG, abs=1e-9)
    (held,) = fit.held
    direction = np.array([held.changes[f"pin.joint.body_point[{i}]"] for i in range(3)])
    assert np.abs(direction) @ np.abs(AXIS) == pytest.approx(np.linalg.norm(direction), rel=1e-9)
    assert "together are held by loops" in str(held)
    (place,) = np.flatnonzero(direction == 1.0)  # the number that follows the other two
    low = np.full(3, -np.inf)
    low[place] = -1.0
    with pytest.raises(ArgumentError, match=rf"loops move pin.joint.body_point\[{place}\] tog"):
        lierb.fit(
            guess, data, UNKNOWN, bounds={UNKNOWN[0]: (low, np.inf)}, **start(guess, 8.0), **RUN
        )
    assert not fit.unidentifiable
    assert np.isfinite(fit.standard_errors["crank.twist0"]).all()
    assert AXIS @ fit.covariance[:3, :3] @ AXIS < 1e-12 * np.trace(fit.covariance[:3, :3])


@pytest.mark.slow
def test_fits_keep_the_pins_of_planar_loops_in_their_planes():
    truth, guess = slider_crank(), slider_crank((ROD - 5e-3) * ALONG)
    data = measured(truth, **start(truth))
    noise = np.random.default_rng(3).normal(scale=1e-4, size=(20, 40, 3))
    turned = np.repeat(data["rod.rotation"].reshape(20, 1, 3, 3), 40, axis=1)
    noisy = {
        "t": TIMES,
        "slider.position": data["slider.position"].reshape(20, 1, 3) + noise,
        "rod.rotation": turned,
    }
    options = {"sigma": {"slider.position": 1e-4, "rod.rotation": 1e-4}, **start(guess), **RUN}
    many = lierb.fits(guess, noisy, UNKNOWN, **options)
    assert many.converged.all()
    one = lierb.fit(
        guess, {k: x if k == "t" else x[:, 7] for k, x in noisy.items()}, UNKNOWN, **options
    )
    assert one.chi2 == pytest.approx(many.chi2[7], rel=1e-6)
    assert many.estimate["pin.joint.body_point"][7] == pytest.approx(
        one.estimate["pin.joint.body_point"], abs=1e-8
    )
    assert [str(x) for x in many.held] == [str(x) for x in one.held]
    off = many.estimate["pin.joint.body_point"] - ROD * ALONG
    assert np.abs(off @ AXIS).max() < 1e-12  # scattered in the plane only


@pytest.mark.slow
def test_a_covariance_across_the_plane_is_refused():
    made, name = slider_crank(), "pin.joint.body_point"
    across = {name: np.outer(AXIS, AXIS) * 1e-10}
    in_plane = {name: (np.eye(3) - np.outer(AXIS, AXIS)) * 1e-10}
    given = name, [0.1], "slider.position"
    with pytest.raises(ArgumentError, match="together are held by loops; expected no variance"):
        lierb.propagate(made, across, *given, **start(made), **RUN)
    with pytest.raises(ArgumentError, match="held by loops"):
        lierb.propagate(made, {name: 1e-5}, *given, **start(made), **RUN)
    spread = lierb.propagate(made, in_plane, *given, **start(made), **RUN, monte_carlo=20)
    assert spread.holds["slider.position"].all()


def test_directions_that_take_the_mobility_are_held():
    """A third crank of a parallelogram: its pin may move along no direction of the plane.

    Along the coupler's path the loop closes to first order, and even exactly, at the start alone.
    """
    length, base = 0.2, 0.3
    x, z = np.eye(3)[0], np.eye(3)[2]

    def crank(name, place):
        body = lierb.bodies.box((length, 0.02, 0.02), mass=0.3)
        joint = lierb.joints.revolute(-0.5 * length * x, parent_point=place * x, axis=z)
        return lierb.Link(name, body, joint)

    half = 0.5 * length * x
    coupler = lierb.joints.revolute(-0.5 * base * x, parent_point=half, axis=z)
    bar = lierb.bodies.box((base, 0.02, 0.02), mass=0.4)
    links = [crank("first", 0.0), lierb.Link("coupler", bar, coupler, "first")]
    links += [crank("second", base), crank("third", 0.5 * base)]
    revolute = lierb.joints.revolute
    loops = [
        lierb.Loop("end", revolute(0.5 * base * x, parent_point=half, axis=z), "coupler", "second"),
        lierb.Loop("pin", revolute(parent_point=half, axis=z), "coupler", "third"),
    ]
    made = lierb.Mechanism(links, loops)
    pose = made.pose({"first": -0.9, "coupler": 0.9, "second": -0.9, "third": -0.9})
    base_start = with_start(made, pose, made.twist({}, pose))

    def held(*names):
        chosen = separate_parameters(made, names)
        found = followed(Variation(base_start, chosen, 0.0), 1)
        return [str(x) for x in held_directions(chosen, found.held)]

    pin = "pin.joint.body_point"
    assert sorted(held(pin)) == [f"{pin}[{i}] is held by loops" for i in range(3)]
    both = held(pin, "third.joint.ground_point")  # both may be shifted by the same
    assert len(both) == 3
    assert all("together are held" in sentence for sentence in both)
