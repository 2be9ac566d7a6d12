"""Two ways to the same motion: a saddle point in every stage, and a subgroup's constant gain."""

from __future__ import annotations

import json
from functools import cache

import numpy as np
import pyarrow.compute as pc
import pytest
from cases import (
    COMPOSED,
    GRAVITY,
    SUBGROUP_JOINTS,
    column,
    integrate,
    long_but,
    slow_but,
    tilted,
)

import lierb
from lierb.errors import FailedTrajectoryWarning
from lierb.kernels.groups.coefficients import TINY
from lierb.model import problem as problem_module
from lierb.runs import engine

JOINTS = [name for name in SUBGROUP_JOINTS if name != "free"]
NO_GRAVITY = (0.0, 0.0, 0.0)
FAST = {"gain": {}, "reduced": {"cspace": "reduced"}}


@cache
def _history(name: str, update: str, solver: str) -> lierb.Result:
    problem, twist0 = tilted(name)
    options = FAST.get(solver, {"solver": "saddle"})
    return integrate(
        problem, twist0=twist0, dt=1e-3, t_end=1.0, update=update, save_every=100, **options
    )


@pytest.mark.parametrize(
    "name", long_but(JOINTS, *(name for name in JOINTS if name not in COMPOSED))
)
def test_a_constant_gain_makes_the_saddle_points_motion(name):
    slow, fast = _history(name, "local", "saddle"), _history(name, "local", "gain")
    # 1000 steps of rounding in another order; the forces reach 100 N
    for quantity, tolerance in (
        ("rotation", 1e-12), ("position", 1e-12), ("omega", 1e-11), ("lambda", 1e-10),
        ("reaction", 1e-10),
    ):  # fmt: skip
        np.testing.assert_allclose(
            column(fast.history, quantity), column(slow.history, quantity), atol=tolerance
        )


@pytest.mark.parametrize("name", slow_but(["spherical", "screw"], "spherical"))
def test_the_reduced_cspace_takes_the_steps_of_the_gain(name):
    gain, reduced = _history(name, "local", "gain"), _history(name, "local", "reduced")
    assert gain.history.equals(reduced.history)


@pytest.mark.parametrize(
    "name", long_but(["spherical", "revolute", "screw", "planar"], "spherical")
)
def test_a_constant_gain_makes_the_saddle_points_motion_in_global_charts(name):
    slow, fast = _history(name, "global", "saddle"), _history(name, "global", "gain")
    for quantity, tolerance in (("rotation", 1e-12), ("position", 1e-12), ("lambda", 1e-10)):
        np.testing.assert_allclose(
            column(fast.history, quantity), column(slow.history, quantity), atol=tolerance
        )


def _state(result: lierb.Result) -> np.ndarray:
    names = ("rotation", "position", "omega", "v")
    return np.concatenate([column(result.summary, n) for n in names], axis=1).view(np.int64)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "solver", "update"),
    [  # every pair of values
        ("spherical", "gain", "local"),
        pytest.param("spherical", "reduced", "global", marks=pytest.mark.long),
        ("screw", "gain", "global"),
        pytest.param("screw", "reduced", "local", marks=pytest.mark.long),
    ],
)
def test_bits_do_not_depend_on_lanes_batch_or_chunks(name, solver, update, monkeypatch):
    problem, twist0 = tilted(name)
    speeds = np.linspace(0.1, 30.0, 21)[:, None]  # small and large angles in one pack

    def end(bodies=slice(None)) -> np.ndarray:
        return _state(
            integrate(
                problem,
                twist0=(speeds * twist0)[bodies],
                dt=1e-2,
                t_end=1.0,
                update=update,
                **FAST[solver],
            )
        )

    expected = end()
    np.testing.assert_array_equal(end(slice(4, 7)), expected[4:7])
    monkeypatch.setattr(problem_module, "DEFAULT_LANES", 1)
    np.testing.assert_array_equal(end(), expected)
    monkeypatch.setattr(engine, "FIRST_CALL_BLOCK_STEPS", 1)
    monkeypatch.setattr(engine, "CALL_SECONDS", 0.0)
    np.testing.assert_array_equal(end(), expected)


@pytest.mark.parametrize("name", slow_but(JOINTS, "spherical"))
def test_steps_of_tiny_angles_are_the_same_beside_a_body_whose_angles_are_not(name):
    """A slow body without a fast neighbour takes steps without a branch."""
    problem, twist0 = tilted(name)
    fast = 40.0 * twist0  # a quarter of a radian a step, if it turns about a point
    options = {"dt": 1e-3, "t_end": 0.2, "save_every": 1}
    alone = integrate(problem, twist0=[twist0, 0.5 * twist0], **options)
    beside = integrate(problem, twist0=[twist0, 0.5 * twist0, fast], **options)
    assert np.linalg.norm(column(alone.history, "omega"), axis=1).max() * 1e-3 < np.sqrt(TINY)
    for table in ("summary", "history"):
        slow = getattr(beside, table).filter(pc.field("trajectory") < 2)
        assert slow.equals(getattr(alone, table))


@pytest.mark.slow
@pytest.mark.parametrize("neighbours", [1, 40], ids=["gentle", "fast"])
def test_a_force_without_end_fails_in_its_own_step(neighbours):
    """However the steps before it were made; the last stage of step 100 meets it."""

    @lierb.wrench
    def blow(t, R, r, omega, v, params):
        return (0.0, 0.0, lierb.where(t > 0.0998, np.inf, 0.1)), (0.0, 0.0, 0.0)

    problem, twist0 = tilted("spherical")
    problem = lierb.Problem(problem.body, problem.joint, GRAVITY, forces=[blow()])
    with pytest.warns(FailedTrajectoryWarning, match=r"2 non_finite.* t = 0\.1 s"):
        result = lierb.integrate(problem, twist0=[twist0, neighbours * twist0], dt=1e-3, t_end=0.2)
    assert result.summary["status"].to_pylist() == ["non_finite"] * 2
    assert result.summary["t"].to_pylist() == [0.1, 0.1]


@pytest.mark.parametrize("name", slow_but(["spherical", "revolute"], "spherical"))
@pytest.mark.parametrize("gravity", [NO_GRAVITY, GRAVITY], ids=["weightless", "gravity"])
@pytest.mark.parametrize("solver", [*FAST, "saddle"])
def test_exactness_lasts_a_million_steps(name, gravity, solver):
    """Steady rotation about a tilted axis is the worst case: rounding adds up linearly there."""
    problem, twist0 = tilted(name, gravity)
    result = integrate(
        problem, twist0=twist0, dt=1e-4, t_end=100.0, measure_every=10,
        **FAST.get(solver, {"solver": solver}),
    )  # fmt: skip
    (summary,) = result.summary.to_pylist()
    far = 1.0 + np.linalg.norm(summary["position"])
    assert summary["position_error_max"] <= 2e-15 * far
    assert summary["rotation_error_max"] <= 2e-15 * far
    assert summary["orthogonality_error_max"] <= 1e-14
    # and in the state that is handed out, not only by the kernel's own measure
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = np.reshape(summary["rotation"], (3, 3)), summary["position"]
    d = np.linalg.inv(problem.joint.ground_frame) @ pose @ problem.joint.body_frame
    np.testing.assert_allclose(d[:3, 3], 0.0, atol=2e-15)


@pytest.mark.slow
def test_rotation_matrices_stay_orthogonal_on_every_path():
    for name, options in (
        ("universal", {}),
        ("revolute", {"solver": "saddle"}),
        ("revolute", {"cspace": "SO3xR3"}),
    ):
        problem, twist0 = tilted(name, NO_GRAVITY)
        result = integrate(problem, twist0=twist0, dt=1e-4, t_end=10.0, **options)
        # without projection a steady rotation is off by 1e-11 here
        assert result.summary["orthogonality_error_max"][0].as_py() < 1e-14


@pytest.mark.parametrize(
    ("name", "options", "expected"),
    [
        ("spherical", {}, "subgroup"),
        ("spherical", {"solver": "saddle"}, "saddle"),
        ("spherical", {"check": "off"}, "saddle"),
        ("spherical", {"cspace": "SO3xR3"}, "saddle"),
        ("spherical", {"cspace": "reduced"}, "subgroup"),
        ("universal", {}, "saddle"),
        ("free", {}, "saddle"),
    ],
)
def test_solver_is_chosen_by_joint_cspace_and_check(name, options, expected):
    problem, twist0 = tilted(name)
    result = integrate(problem, twist0=twist0, dt=1e-2, t_end=1e-2, **options)
    metadata = json.loads(result.summary.schema.metadata[b"lierb"])
    assert metadata["options"]["solver"] == expected
    again = integrate(
        problem, twist0=twist0, dt=1e-2, t_end=1e-2, **(options | {"solver": expected})
    )
    assert again.summary.equals(result.summary)


@pytest.mark.parametrize(
    ("name", "options", "told"),
    [
        ("universal", {}, r'solver="subgroup" needs a joint.*not a universal joint'),
        ("spherical", {"cspace": "SO3xR3"}, r'solver="subgroup" needs cspace="SE3" or "reduced"'),
        ("spherical", {"check": "off"}, r'and check="raise", got .* check="off"'),
    ],
)
def test_subgroup_is_refused_where_there_is_none(name, options, told):
    problem, twist0 = tilted(name)
    with pytest.raises(lierb.errors.ArgumentError, match=told):
        lierb.integrate(problem, twist0=twist0, dt=1e-2, t_end=1e-2, solver="subgroup", **options)


@pytest.mark.parametrize("name", ["universal", "pin_in_slot", "free"])
def test_reduced_refuses_what_is_no_subgroup(name):
    problem, twist0 = tilted(name)
    with pytest.raises(lierb.errors.ArgumentError, match=f"subgroup.*not a {name} joint"):
        lierb.integrate(problem, twist0=twist0, dt=1e-2, t_end=1.0, cspace="reduced")


@pytest.mark.parametrize(
    "name", slow_but(["revolute", "prismatic", "screw", "planar", "translation"], "revolute")
)
@pytest.mark.parametrize("cspace", ["SE3", "reduced"])
def test_a_joint_held_the_wrong_way_round_is_an_error(name, cspace):
    """Half a turn across the axis: every error reads zero, yet the joint has no such pose."""
    problem, twist0 = tilted(name)
    flip = np.diag([1.0, -1.0, -1.0, 1.0])
    pose0 = problem.joint.ground_frame @ flip @ np.linalg.inv(problem.joint.body_frame)
    with pytest.raises(lierb.errors.PoseError, match="wrong way round"):
        integrate(problem, twist0=twist0, pose0=pose0, dt=1e-2, t_end=0.1, cspace=cspace)


@pytest.mark.parametrize("solver", FAST)
def test_a_start_off_by_less_than_the_tolerance_is_put_on_the_subgroup(solver):
    problem, twist0 = tilted("spherical")
    pose0 = problem.joint.closed_pose.copy()
    pose0[:3, 3] += 5e-11  # 8.7e-11 in all; 1e-9 of the arm, 0.156 m, is allowed
    result = integrate(problem, twist0=twist0, pose0=pose0, dt=1e-2, t_end=0.1, **FAST[solver])
    assert result.summary["position_error_max"][0].as_py() < 1e-15


@pytest.mark.parametrize("name", slow_but(["spherical", "revolute", "universal"], "spherical"))
@pytest.mark.parametrize("cspace", ["SE3", "SO3xR3"])
def test_what_rows_keep_still_changes_no_bit(name, cspace):
    """Alone, a start that is on its joint takes steps without what its rows keep at zero; beside
    one that is off by what passes for rounding of whoever made it, it takes general ones.
    """
    problem, twist0 = tilted(name)
    options = {"dt": 1e-3, "t_end": 0.1, "cspace": cspace, "solver": "saddle"}
    alone = integrate(problem, twist0=twist0, **options)
    off = twist0 + 1e-11 * np.array([0.0, 0.0, 0.0, 1.0, -2.0, 1.0])
    beside = integrate(problem, twist0=np.stack([twist0, off]), **options)
    for table in ("summary", "history"):
        mine = getattr(beside, table).filter(pc.field("trajectory") == 0)
        assert mine.equals(getattr(alone, table))
    if cspace == "SE3":  # the other one has something to lose
        opened = column(beside.summary, "position_error_max")
        assert opened[0] < 1e-16 < 1e-13 < opened[1]
