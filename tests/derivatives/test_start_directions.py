"""Directions of starts, without a run: against closed forms of a geared five-bar."""

import numpy as np
import pytest

import lierb
from lierb.lie import so3
from lierb.runs.parameters import separate_parameters
from lierb.runs.start_directions import JOINT, Start
from lierb.runs.variations import with_start

CRANK, ROD, BASE, RATIO = 0.12, 0.25, 0.2, -2.0
AXIS = np.array([1.0, 2.0, 2.0]) / 3.0
ALONG, UP = np.array([2.0, 1.0, -2.0]) / 3.0, np.array([-2.0, 2.0, -1.0]) / 3.0  # e₁ and e₂
ANGLES = np.array([1.5, 1.0])  # of the cranks


def geared_five_bar(gears=()):
    """Two cranks with rods that are pinned to each other; all frames are parallel at zero."""

    def bar(name, length, parent, place):
        shape = lierb.Body(0.3 + length, np.full(3, 0.1 * length**2))
        joint = lierb.joints.revolute(-0.5 * length * ALONG, parent_point=place, axis=AXIS)
        return lierb.Link(name, shape, joint, parent)

    links = [
        bar("a", CRANK, "ground", np.zeros(3)), bar("b", ROD, "a", 0.5 * CRANK * ALONG),
        bar("e", CRANK, "ground", BASE * ALONG), bar("c", ROD, "e", 0.5 * CRANK * ALONG),
    ]  # fmt: skip
    half = 0.5 * ROD * ALONG
    pin = lierb.joints.revolute(half, parent_point=half, axis=AXIS)
    return lierb.Mechanism(links, lierb.Loop("pin", pin, "b", "c"), forces=gears)


def rods(pin, angles=ANGLES):
    """Return the angles of both rods: two circles meet.   pin : its place on the first rod."""
    first, second = (CRANK * np.array((np.cos(x), np.sin(x))) for x in angles)
    line = second - first + np.array((BASE, 0.0))
    own = np.array((0.5 * ROD + pin[0], pin[1]))
    length, span = np.hypot(*own), np.hypot(*line)
    cosine = (length**2 + span**2 - ROD**2) / (2.0 * length * span)
    far = np.arctan2(*line[::-1]) + np.arccos(cosine)
    rest = length * np.array((np.cos(far), np.sin(far))) - line
    return np.array((far - np.arctan2(*own[::-1]), np.arctan2(*rest[::-1])))


@pytest.mark.parametrize("driven", [False, True])
def test_teeth_stay_meshed_when_a_loop_moves(driven):
    """The rods' angles change as circles meet; without a motor the cranks turn as their teeth."""
    gears = [lierb.forces.gear(RATIO).on("e", "a")]
    if driven:
        gears.append(lierb.forces.motor(position=lambda t: ANGLES[0] + t).on("a"))
    made, pin = geared_five_bar(gears), "pin.joint.body_point"
    b, c = rods((0.5 * ROD, 0.0), ANGLES)
    angles = {"a": ANGLES[0], "b": b - ANGLES[0], "e": ANGLES[1], "c": c - ANGLES[1]}
    pose = made.close(made.pose(angles))
    base = with_start(made, pose, made.twist({}, pose))
    start = Start(made, base.poses, base.twists, 0.0)
    (parameter,) = separate_parameters(made, [pin])
    turns = [x[:, 0, :3] @ AXIS for x in start.moved(JOINT, parameter.seeds(start)).poses]
    a, b, e, c = (dict(zip(made.names, turns, strict=True))[n] for n in "abec")
    np.testing.assert_allclose(e, RATIO * a, atol=1e-12)
    if driven:
        np.testing.assert_allclose(a, 0.0, atol=1e-12)
    assert np.abs(a @ AXIS) < 1e-12  # across the plane nothing moves
    h = 1e-5
    for unit, direction in enumerate((ALONG, UP)):
        place, turn = np.array([0.5 * ROD, 0.0]), np.array([a @ direction, e @ direction])
        ends = [rods(place + x * np.eye(2)[unit], ANGLES + x * turn) for x in (h, -h)]
        expected = (ends[0] - ends[1]) / (2.0 * h)
        np.testing.assert_allclose([b @ direction, c @ direction], expected, rtol=1e-8, atol=1e-8)
        moved = made.with_({pin: 0.5 * ROD * ALONG + h * direction}).close(pose)
        turned = AXIS @ so3.log(pose["a"][:3, :3].T @ moved["a"][:3, :3])
        assert turned / h == pytest.approx(a @ direction, abs=1e-3)  # the least change
