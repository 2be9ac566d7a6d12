"""Output where it is asked for: between steps, on the group, and on the joint's subgroup."""

import numpy as np
import pytest
from cases import SUBGROUP_JOINTS, slow_but, tiered, tilted

import lierb
from clocks.shared import rows_of, spread_tops, table_bits, thrown, top_problem
from clocks.truths import DATA, distance, problem_of, reference, states_of

METHODS = ("BS32", "DP54", "Tsit5", "Verner65", "Verner87", "Verner98", "DOP853")
ORDER = {"BS32": 3, "DP54": 5, "Tsit5": 5, "Verner65": 6, "Verner87": 8, "Verner98": 9, "DOP853": 8}
ORDER |= {"Euler": 1, "Heun": 2, "RK4": 4}


def heavy_top(**options) -> lierb.Result:
    problem, twist0 = problem_of("heavy_top")
    record = ("state",) if {"save_at", "save_every"} & set(options) else ()
    options = {"t_end": 1.0, "record": record} | options
    return lierb.integrate(problem, twist0=twist0, **options)


# ---- adaptive ----------------------------------------------------------------------------------


@pytest.mark.parametrize("form", tiered(
    [f"{method}-{cspace}" for method in METHODS for cspace in ("SE3", "SO3xR3")],
    ["DOP853-SE3"], [],
))  # fmt: skip
def test_save_at_meets_the_truth_as_the_end_does(form):
    """Times that are no step's end, except by chance; thirty times rtol as everywhere."""
    name, rtol = "heavy_top", 1e-6
    method, cspace = form.split("-")
    problem, twist0 = problem_of(name)
    times = [float(t) for t in DATA[name].times]
    rows = lierb.integrate(
        problem, twist0=twist0, t_end=times[-1], rtol=rtol, method=method, cspace=cspace,
        save_at=times, record=("state",),
    ).history  # fmt: skip
    assert rows["t"].to_pylist() == times
    for row, t in enumerate(DATA[name].times):
        assert distance(states_of(rows, row), reference(name)[t]) < 30 * rtol, t


def test_save_at_ends_are_the_start_and_the_end():
    result = heavy_top(rtol=1e-6, save_at=(0.0, 0.3, 1.0))
    twist0 = problem_of("heavy_top")[1]
    first, last = states_of(result.history, 0), states_of(result.history, 2)
    np.testing.assert_allclose(first.omega, twist0[:3], rtol=4e-16)
    np.testing.assert_allclose(first.rotation, np.eye(3), atol=4e-16)
    ended = states_of(result.summary, 0)
    for a, b in zip(last, ended, strict=True):
        np.testing.assert_array_equal(a, b)


def test_save_at_row_is_a_run_that_ends_there():
    """Two runs agree to their tolerance, as the last step of one is cut."""
    rtol, t = 1e-9, 0.41
    row = states_of(heavy_top(rtol=rtol, save_at=(t,)).history, 0)
    there = states_of(heavy_top(rtol=rtol, t_end=t, save_at=(t,)).summary, 0)
    assert distance(row, there) < 30 * rtol


def test_many_rows_within_a_step():
    """A thousand rows, some thirty steps: rows follow the motion smoothly."""
    times = np.linspace(0.0, 1.0, 1001)
    result = heavy_top(rtol=1e-10, save_at=times)
    assert result.summary["steps"][0].as_py() < 300
    omega = rows_of(result.history, "omega")
    fourth = np.abs(np.diff(omega, n=4, axis=0)).max()
    # h⁴ of the fourth derivative, 1.15e6 rad/s⁵ by short fixed steps; 16 errors of 30 rtol of 7
    assert fourth < 1.2e6 * 1e-12 + 16 * 30 * 1e-10 * 7


def test_rows_follow_the_times_then_the_trajectories():
    problem, twist0 = problem_of("heavy_top")
    twists = np.array([twist0, 0.5 * twist0, 2.0 * twist0])
    rows = lierb.integrate(
        problem, twist0=twists, t_end=0.5, rtol=1e-6, save_at=(0.1, 0.2), record=("state",)
    ).history
    assert rows["t"].to_pylist() == [0.1] * 3 + [0.2] * 3
    assert rows["trajectory"].to_pylist() == [0, 1, 2] * 2


def test_no_time_asked_for_is_an_empty_history():
    run = {"t_end": 0.25, "rtol": 1e-6, "method": "DP54"}  # whose kernel test_bits.py has
    assert lierb.integrate(top_problem(), twist0=spread_tops()[:1], **run).history is None


@pytest.mark.parametrize("times", [
    (0.2, 0.1), (0.1, 0.1), (-0.1, 0.5), (0.5, 1.1), (0.5, float("nan")), ((0.1, 0.2),), ("soon",),
], ids=str)  # fmt: skip
def test_wrong_times_are_told(times):
    with pytest.raises(lierb.errors.LierbError, match="save_at"):
        heavy_top(rtol=1e-6, save_at=times)


def test_save_at_and_save_every_exclude_each_other():
    with pytest.raises(lierb.errors.LierbError, match="save_every"):
        heavy_top(dt=1e-2, save_at=(0.1,), save_every=10)


# ---- on the group, on the subgroup -------------------------------------------------------------


TIMES = np.linspace(0.0, 0.5, 38)


@pytest.mark.parametrize("form", tiered(
    [f"{method}-{cspace}" for method in METHODS for cspace in ("SE3", "SO3xR3")],
    [], ["DOP853-SE3"],
))  # fmt: skip
def test_pose_between_steps_is_on_the_group(form):
    """RᵀR = 1 to rounding, however loose the tolerance."""
    method, cspace = form.split("-")
    rows = heavy_top(rtol=1e-3, save_at=TIMES, t_end=0.5, method=method, cspace=cspace).history
    R = rows_of(rows, "rotation").reshape(-1, 3, 3)
    np.testing.assert_allclose(R @ R.transpose(0, 2, 1), np.broadcast_to(np.eye(3), R.shape),
                               atol=2e-14)  # fmt: skip


@pytest.mark.long
@pytest.mark.parametrize("solver", ["auto", pytest.param("saddle", marks=pytest.mark.long)])
@pytest.mark.parametrize("name", tiered(SUBGROUP_JOINTS, [], ["spherical", "screw"]))
def test_pose_between_steps_is_on_the_subgroup(name, solver):
    """Steps of rtol = 1e-3; all numbers are of order one or grow as ½gt² ≈ 1 m."""
    problem, twist0 = tilted(name)
    if solver == "auto" and not problem.rows:
        pytest.skip("a free body has no rows")
    found = lierb.integrate(
        problem, twist0=twist0, t_end=0.5, rtol=1e-3, method="DP54", save_at=TIMES, solver=solver
    ).history
    assert np.abs(rows_of(found, "position_error")).max() < 1e-13
    assert np.abs(rows_of(found, "rotation_error")).max() < 1e-13


# ---- fixed steps -------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("method", tiered([*METHODS, "RK4", "Heun", "Euler"], ["RK4"], []))
def test_save_at_on_steps_is_save_every(method):
    """Rows at the ends of steps differ by rounding, without interpolation."""
    options = {"dt": 1e-2, "t_end": 0.3, "method": method}
    every = heavy_top(**options, save_every=10).history
    found = heavy_top(**options, save_at=[0.0, 0.1, 0.2, 0.3]).history
    for name in ("rotation", "position", "omega", "v"):
        np.testing.assert_allclose(rows_of(found, name), rows_of(every, name), rtol=0, atol=2e-13)


@pytest.mark.parametrize("cspace", ["SE3", pytest.param("SO3xR3", marks=pytest.mark.long)])
@pytest.mark.parametrize(
    "method", tiered([*METHODS, "RK4", "Heun", "Euler"], [], ["RK4", "DOP853"])
)
def test_output_between_steps_has_the_methods_order_less_one(method, cspace):
    """An extension of order p − 1 is off by h^p between steps: errors fall as h^(p − 1) at least.

    Measured with the largest error of 37 times over three halvings, above rounding.
    """
    name = "heavy_top"
    problem, twist0 = problem_of(name)
    p = ORDER[method]
    times = np.linspace(0.003, 0.497, 37)
    true = lierb.integrate(
        problem, twist0=twist0, dt=5e-4, t_end=0.5, method="DOP853", save_every=1,
        record=("state",), cspace="SE3",
    ).history  # fmt: skip
    grid = rows_of(true, "omega")
    times = np.round(times / 5e-4) * 5e-4
    at = np.round(times / 5e-4).astype(int)
    longest = {1: 2e-3, 2: 5e-3, 3: 1e-2, 4: 1e-2, 5: 2.5e-2}.get(p, 5e-2)
    off = []
    for dt in (longest, longest / 2, longest / 4):
        rows = lierb.integrate(
            problem, twist0=twist0, dt=dt, t_end=0.5, method=method, save_at=times,
            record=("state",), cspace=cspace,
        ).history  # fmt: skip
        off.append(np.abs(rows_of(rows, "omega") - grid[at]).max())
    kept = [e for e in off if e > 1e-12]
    assert len(kept) >= 2, off
    order = np.log2(kept[0] / kept[-1]) / (len(kept) - 1)
    assert order > p - 1 - 0.2, (order, off)


# ---- after the end -----------------------------------------------------------------------------


@lierb.event(direction=-1, terminal=True)
def ground(r):
    return r[2]


@pytest.mark.slow
def test_rows_after_the_end_are_nan():
    problem, start = thrown([1.0, 100.0], [0.0, 0.0], events=[ground()])
    result = lierb.integrate(
        problem, **start, t_end=1.0, rtol=1e-6, save_at=(0.2, 0.4, 0.6, 0.8), record=("state",),
        method="DP54",
    )  # fmt: skip
    position = rows_of(result.history, "position").reshape(4, 2, 3)
    ended = float(np.sqrt(2.0 / 9.81))  # 0.4515 s
    assert result.summary["t"].to_pylist()[0] == pytest.approx(ended, abs=1e-12)
    assert np.isnan(position[2:, 0]).all()
    assert np.isfinite(position[:2, 0]).all()
    assert np.isfinite(position[:, 1]).all()
    assert result.history["t"].to_pylist() == [0.2, 0.2, 0.4, 0.4, 0.6, 0.6, 0.8, 0.8]


@pytest.mark.parametrize(
    "clock", slow_but([{"rtol": 1e-6}, {"rtol": None, "dt": 0.1}], {"rtol": 1e-6}), ids=str
)
@pytest.mark.parametrize("end", [1.0, 1e9 + 1.0])
def test_rows_within_rounding_of_the_end_are_all_there(clock, end):
    times = [end - 0.5, *(end - n * np.spacing(end) for n in (3, 2, 1)), end]
    result = heavy_top(t0=end - 1.0, t_end=end, save_at=times, **clock)
    assert np.isfinite(rows_of(result.history, "position_error")).all()
    assert np.isfinite(rows_of(result.history, "omega")).all()


def test_rows_do_not_depend_on_other_times():
    """A row is the same whatever else is asked for."""
    few = heavy_top(rtol=1e-6, save_at=(0.3, 0.7)).history
    many = heavy_top(rtol=1e-6, save_at=(0.1, 0.3, 0.30001, 0.7, 0.9)).history
    few, many = (table.drop(["step"]) for table in (few, many))  # the number of the row
    np.testing.assert_array_equal(table_bits(few), table_bits(many)[[1, 3]])
