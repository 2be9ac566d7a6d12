"""Users' functions that are not finite at a start are named, with the number."""

from __future__ import annotations

import numpy as np
import pytest

import lierb
from lierb.errors import FailedTrajectoryWarning, ForceError, PoseError

BODY = lierb.Body(1.3, (0.1, 0.1, 0.15))
FREE = lierb.joints.free()
FLAT, UPRIGHT = np.eye(4), np.eye(4)
UPRIGHT[:3, :3] = [[1, 0, 0], [0, 0, -1], [0, 1, 0]]
AT_REST = np.zeros(6)


@lierb.velocity_constraint
def roll(R, omega, v):  # a disc on the floor, which has no lowest point if it lies flat
    down = np.array([R[2, 0], R[2, 1], 0.0 * R[2, 0]])
    return R @ (v + np.cross(omega, -0.25 * down / np.sqrt(down @ down)))


@lierb.constraint
def ratio(R, r):
    return r[0] / r[1]


@lierb.constraint
def distance(R, r):  # whose derivative is 0/0 where it is zero
    return np.sqrt(r[0] * r[0])


CASES = {
    r"roll1 .*is nan": roll,
    "ratio .*is nan": ratio,
    "the derivative of distance .*is nan": distance,
}


@pytest.mark.parametrize("text", CASES)
def test_constraint_that_is_nan_is_named(text):
    made = CASES[text]()
    problem = lierb.Problem(BODY, FREE, constraints=made)
    mechanism = lierb.Mechanism(lierb.Link("disc", BODY, FREE), constraints=made)
    calls = {
        "pose0": [
            lambda: lierb.predict(problem),
            lambda: lierb.predict(mechanism, {"disc": FLAT}),
            lambda: lierb.integrate(problem, dt=0.1, t_end=0.1),
            lambda: lierb.integrate(mechanism, dt=0.1, t_end=0.1),
        ],
        "pose": [
            lambda: problem.project(AT_REST),
            lambda: mechanism.project({"disc": AT_REST}),
            lambda: mechanism.freedoms(),
        ],
    }
    if made.name == "ratio":  # the others are closed, or not on poses
        calls["pose"] += [lambda: problem.close(FLAT), lambda: mechanism.close({"disc": FLAT})]
    for argument, each in calls.items():
        for call in each:
            with pytest.raises(PoseError, match=f"^{text} at {argument}; "):
                call()
    for model, pose0, twist0 in (
        (problem, None, AT_REST),
        (mechanism, {"disc": FLAT}, {"disc": AT_REST}),
    ):
        assert str(model.violation(pose0, twist0)).startswith(text.split(" .*")[0])


def test_rolling_disc_has_three_freedoms_where_it_stands():
    disc = lierb.Mechanism(lierb.Link("disc", BODY, FREE), constraints=roll())
    assert disc.freedoms({"disc": UPRIGHT}) == (3, 0)
    both = np.stack([UPRIGHT, FLAT])
    with pytest.raises(PoseError, match=r"roll1 \(disc to ground\) is nan at pose\[1\];"):
        disc.freedoms({"disc": both})


def test_predict_leaves_out_poses_where_a_constraint_is_nan():
    """√(1 + x) = 1 + x + x³/10 at x = 0 alone, and it is NaN for half of all places."""

    @lierb.constraint
    def root(R, r):
        return 1.0 + r[0] + 0.1 * r[0] ** 3 - np.sqrt(1.0 + r[0])

    @lierb.constraint
    def plane(R, r):
        return r[0]

    kept = [
        {
            name: (each.group, each.rows_exact)
            for name, each in lierb.predict(lierb.Problem(BODY, FREE, constraints=row())).items()
        }
        for row in (root, plane)
    ]
    assert kept[0]["SO3xR3"] == kept[1]["SO3xR3"] == ("SO(3)×R²", (True,))


@pytest.mark.slow
def test_force_that_is_nan_at_the_start_is_named():
    @lierb.wrench
    def pull(t, R, r, omega, v):
        return 0.0 * r, -r / np.sqrt(r @ r) ** 3

    planet = lierb.Problem(BODY, FREE, forces=pull())
    pose0 = np.stack([np.eye(4)] * 3)
    pose0[[0, 2], 0, 3] = 1.0
    with pytest.warns(FailedTrajectoryWarning, match=r"pull is nan at the start\[1\]"):
        result = lierb.integrate(planet, pose0=pose0, dt=1e-2, t_end=0.02)
    assert result.summary["status"].to_pylist() == ["ok", "non_finite", "ok"]


def test_message_of_a_velocity_constraint_with_an_unknown_argument():
    @lierb.velocity_constraint
    def driven(t, v):
        return v[0]

    text = (
        r"any of \(R, r, omega, v, params, body\) by these names; a further argument .* unlike t$"
    )
    with pytest.raises(ForceError, match=text):
        driven()
