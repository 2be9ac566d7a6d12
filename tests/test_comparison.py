"""Methods side by side: errors, orders, work, what is believed, and how it is told."""

from __future__ import annotations

import io
import json
import re

import numpy as np
import pyarrow.parquet as pq
import pytest
from cases import GRAVITY, box, rotation
from mechanisms.shared import double_pendulum
from numpy.testing import assert_allclose
from reference_numbers import BOX_INERTIA, BOX_MASS, BOX_POINT
from scipy.integrate import solve_ivp

import lierb
from lierb.analysis import case, compared_runs, reference
from lierb.analysis.comparison_tables import ESCAPED
from lierb.errors import (
    ArgumentError,
    FailedTrajectoryWarning,
    LierbError,
    TimeGridError,
    UnknownNameError,
)
from lierb.methods import TABLEAUS

OMEGA = np.array([[6.28, 3.14, 0.63], [5.0, -2.0, 1.0], [-1.0, 4.0, 7.0]])
DTS = (8e-3, 4e-3, 2e-3)
T_END = 0.4
LATER = {"pose0": np.eye(4), "twist0": np.zeros(6), "t0": 1.0}
METHODS = {"Euler": 1, "Heun": 2, "RK4": 4}


def box_top() -> lierb.Problem:
    pivot = lierb.joints.spherical(body_point=BOX_POINT)
    return lierb.Problem(box(), pivot, GRAVITY)


def twists(omega=OMEGA) -> np.ndarray:
    return box_top().joint.twist(omega=omega)


def by_scipy(omega: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pose and twist at T_END, from Euler's equations about the pivot, R by its nine entries."""
    arm = -np.array(BOX_POINT)  # from the pivot to the centre of mass
    about = np.diag(BOX_INERTIA) + BOX_MASS * (arm @ arm * np.eye(3) - np.outer(arm, arm))

    def rates(_t, y):
        r, w = y[:9].reshape(3, 3), y[9:]
        torque = np.cross(arm, r.T @ (BOX_MASS * np.array(GRAVITY)))
        hat = np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])
        return np.r_[(r @ hat).ravel(), np.linalg.solve(about, torque - np.cross(w, about @ w))]

    start = np.r_[np.eye(3).ravel(), omega]
    y = solve_ivp(rates, (0.0, T_END), start, method="DOP853", rtol=3e-14, atol=1e-14).y[:, -1]
    pose, w = np.eye(4), y[9:]
    pose[:3, :3] = y[:9].reshape(3, 3)
    pose[:3, 3] = pose[:3, :3] @ arm
    return pose, np.r_[w, np.cross(w, arm)]


@pytest.fixture(scope="module")
def exact() -> tuple[np.ndarray, np.ndarray]:
    poses, moving = zip(*map(by_scipy, OMEGA), strict=True)
    return np.array(poses), np.array(moving)


@pytest.fixture(scope="module")
def found(exact) -> lierb.analysis.comparison.Comparison:
    return lierb.convergence(
        box_top(), METHODS, DTS, twist0=twists(), t_end=T_END, reference=exact, repeats=1
    )


def column(table, name: str) -> np.ndarray:
    return table[name].to_numpy(zero_copy_only=False).astype(float)


# ---- orders and errors -------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("quantity", ["error.rotation", "error.position", "error.omega", "error.v"])
def test_orders_are_those_of_the_methods(found, method, quantity):
    # 8 %: of the next power of h there is 7.1 % left at these steps (Euler, ω)
    assert found.order(method, quantity=quantity) == pytest.approx(METHODS[method], rel=0.08)


@pytest.mark.slow
def test_errors_are_distances_from_the_reference(found, exact):
    result = lierb.integrate(box_top(), twist0=twists(), dt=DTS[-1], t_end=T_END)
    row = found.table.to_pylist()[-1]
    assert (row["method"], row["dt"]) == ("RK4", DTS[-1])
    turned = np.einsum("nji,njk->nik", exact[0][:, :3, :3], result.rotation)
    skew = np.stack(
        [turned[:, i, j] - turned[:, j, i] for i, j in ((2, 1), (0, 2), (1, 0))], axis=1
    )
    # of small angles ‖skew‖ / 2 = sin θ is θ to θ²/6
    angles = np.linalg.norm(skew, axis=1) / 2.0
    assert row["error.rotation"] == pytest.approx(angles.max(), rel=1e-6)
    for name, values, there in (
        ("position", result.position, exact[0][:, :3, 3]),
        ("omega", result.omega, exact[1][:, :3]),
        ("v", result.v, exact[1][:, 3:]),
    ):
        largest = np.linalg.norm(values - there, axis=1).max()
        assert row[f"error.{name}"] == pytest.approx(largest, rel=1e-12)
    assert row["drift.energy"] == np.max(result.summary["energy_drift_max"].to_pylist())


@pytest.mark.slow
def test_motion_starts_at_rest_by_default():
    calls = [
        lierb.convergence(box_top(), "RK4", [0.02, 0.01], t_end=0.1, repeats=0, **start)
        for start in ({}, {"twist0": np.zeros(6)})
    ]
    assert calls[0].table.equals(calls[1].table)
    assert max(calls[0].table["error.omega"].to_pylist()) > 0.0


def test_median_is_that_of_the_trajectories(exact):
    options = {"twist0": twists(), "t_end": T_END, "reference": exact, "repeats": 0}
    median = lierb.convergence(box_top(), "RK4", DTS[0], norm="median", **options).table
    alone = [
        lierb.convergence(
            box_top(), "RK4", DTS[0], twist0=twists()[i], t_end=T_END, repeats=0,
            reference=(exact[0][i], exact[1][i]),
        ).table["error.v"][0].as_py()
        for i in range(3)
    ]  # fmt: skip
    assert median["error.v"][0].as_py() == pytest.approx(np.median(alone), rel=1e-12)


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-3, 2.0, np.pi])
def test_angle_keeps_its_digits(angle):
    turned = rotation(*(angle * np.array([2, -1, 2]) / 3.0))
    (measured,) = reference._angle(np.eye(3)[None], turned[None])
    # 1e-12 itself has four digits in a matrix with ones; at π the sine is flat: half of the digits
    assert measured == pytest.approx(angle, rel=1e-9, abs=1e-7 if angle > 3.0 else 4e-16)


def test_a_mechanism_takes_cspaces_link_by_link_and_the_farthest_link():
    pendulum = double_pendulum()
    pose0 = pendulum.pose({"upper": 1.0, "lower": 0.5})
    start = {"pose0": pose0, "twist0": pendulum.twist({"lower": 1.0}, pose0), "t_end": 0.25}
    fine = lierb.integrate(pendulum, dt=2.5e-4, **start)
    found = lierb.convergence(pendulum, "RK4", [1e-2, 5e-3, 2.5e-3], reference=fine, **start)
    assert found.table["cspace"].unique().to_pylist() == ["reduced"]
    for quantity in ("error.rotation", "error.position"):
        assert found.order("RK4", quantity=quantity) == pytest.approx(4.0, rel=0.1)
    coarse = lierb.integrate(pendulum, dt=1e-2, **start)
    each = [np.linalg.norm(coarse[n].position - fine[n].position) for n in pendulum.names]
    assert found.table["error.position"][0].as_py() == pytest.approx(max(each), rel=1e-12)
    assert "of the farthest link" in found.to_markdown()


# ---- what is believed --------------------------------------------------------------------------


@pytest.mark.slow
def test_the_default_reference_knows_its_own_error(exact):
    """Beside SciPy's solution; and errors that are at its level make no order."""
    found = lierb.convergence(
        box_top(), ["RK4", "DOP853"], (1e-2, 5e-3, 2.5e-3, 1.25e-3),
        cspaces=["SE3", "SO3xR3"], twist0=twists(), t_end=T_END, repeats=0,
    )  # fmt: skip
    told = json.loads(found.table.schema.metadata[b"lierb"])
    assert told["reference"].startswith("DOP853 on reduced")
    assert told["reference"].endswith("beside SO3xR3")
    beside = lierb.convergence(
        box_top(), ["RK4", "DOP853"], (1e-2, 5e-3, 2.5e-3, 1.25e-3),
        cspaces=["SE3", "SO3xR3"], twist0=twists(), t_end=T_END, repeats=0, reference=exact,
    )  # fmt: skip
    for quantity in ("error.rotation", "error.position"):
        name = quantity.removeprefix("error.")
        ours, theirs = (column(each.table, quantity) for each in (found, beside))
        # SciPy's own error: its tolerance, 3e-14, over 0.4 s
        assert_allclose(ours, theirs, rtol=1e-6, atol=2e-12)
        assert told["reference_errors"][name] < 1e-12
        floors = column(found.table, f"{quantity}.floor")
        assert (floors >= 10.0 * told["reference_errors"][name]).all()
        for cspace in ("SE3", "SO3xR3"):
            assert found.order("RK4", cspace, quantity) == pytest.approx(4.0, rel=0.05)
            seen = next(
                each.order for each in found.orders
                if (each.method, each.cspace, each.quantity) == ("DOP853", cspace, quantity)
            )  # fmt: skip
            assert seen is not None
            assert min(seen.steps) > 1.25e-3  # at 1.25e-3 the error is rounding


def test_a_reference_is_halved_until_it_settles(monkeypatch, exact):
    """With RK4 in place of DOP853; the estimate is an upper bound of the true error."""
    monkeypatch.setattr(reference, "METHOD", "RK4")
    monkeypatch.setattr(reference, "CSPACES", ("SE3",))
    found = lierb.convergence(box_top(), "RK4", 4e-3, twist0=twists(), t_end=T_END, repeats=0)
    told = json.loads(found.table.schema.metadata[b"lierb"])
    dt = float(re.search(r"dt = (\S+) s", told["reference"])[1])
    assert 4e-3 / 64 <= dt < 4e-3 / 8
    ends = lierb.integrate(box_top(), twist0=twists(), dt=dt, t_end=T_END).position
    true = np.linalg.norm(ends - exact[0][:, :3, 3], axis=1).max()
    assert true < told["reference_errors"]["position"] < 1e-9


def test_errors_at_rounding_are_in_brackets_and_hollow(exact):
    """A reference that is the run itself leaves nothing but zeros; one nearby, only rounding."""
    start = {"twist0": twists(), "t_end": T_END}
    end = lierb.integrate(box_top(), dt=DTS[-1], **start).end
    nearby = end | {"pose0": end["pose0"] + 0.0, "twist0": end["twist0"] * (1.0 + 1e-15)}
    found = lierb.convergence(box_top(), "RK4", DTS[-1], reference=nearby, repeats=0, **start)
    row = found.table.to_pylist()[0]
    assert row["error.position"] == 0.0
    assert 0.0 < row["error.omega"] <= row["error.omega.floor"]
    header, line = (re.split(r" \| ", text) for text in found.to_markdown().splitlines()[::2][:2])
    assert line[header.index("ω, rad/s")].startswith("(")
    assert found.orders == ()
    with pytest.raises(ArgumentError, match="one step"):
        found.order("RK4")
    hollow = [
        line for line in found.figure("omega").axes[0].lines
        if line.get_markerfacecolor() == "white" and len(line.get_xdata())
    ]  # fmt: skip
    assert len(hollow) == 1


@pytest.mark.filterwarnings("error")
def test_a_reference_that_fails_throughout_is_told_without_warnings_of_numpy():
    fast = twists(np.full((1, 3), 1e5))
    with pytest.raises(ArgumentError, match=r"the reference .* failed: 1 of 1 trajectories"):
        lierb.convergence(box_top(), "RK4", [0.1], twist0=fast, t_end=T_END, repeats=0)


def test_failed_trajectories_are_left_out_and_told(exact):
    wild = twists([*OMEGA, (1e120, 2e120, -1e120)])
    poses, moving = (np.concatenate([each, each[:1]]) for each in exact)
    with pytest.warns(FailedTrajectoryWarning, match=r"RK4, SE3, dt = 0\.008 s: 1 of 4.*failed"):
        found = lierb.convergence(
            box_top(), "RK4", DTS, twist0=wild, t_end=T_END, repeats=0, reference=(poses, moving)
        )
    assert found.table["failed"].to_pylist() == [1, 1, 1]
    assert np.isfinite(column(found.table, "error.position")).all()
    assert np.isnan(found.order("RK4"))  # who is left may differ from step to step


def test_saturated_errors_have_no_order(exact):
    """Beside a reference that is turned by 2.4 rad the errors say nothing of the method."""
    away = exact[0].copy()
    away[:, :3, :3] = exact[0][:, :3, :3] @ rotation(0.0, 0.0, 2.4)
    found = lierb.convergence(
        box_top(), "RK4", DTS, twist0=twists(), t_end=T_END, reference=(away, exact[1]), repeats=0
    )
    assert column(found.table, "error.rotation") == pytest.approx(2.4, rel=1e-3)  # RK4's: 4e-4
    assert np.isnan(found.order("RK4", quantity="error.rotation"))
    texts = {each.quantity: each.text for each in found.orders}
    assert texts["error.rotation"] == "–"
    assert texts["error.omega"].startswith(("3.", "4."))


# ---- work --------------------------------------------------------------------------------------


def test_right_hand_sides_are_counted(found):
    stages = {"Euler": 1, "Heun": 2, "RK4": 4}
    for row in found.table.to_pylist():
        assert row["steps"] == round(T_END / row["dt"])
        assert row["evaluations"] == stages[row["method"]] * row["steps"]


@pytest.mark.parametrize(
    "name", [n for n, tableau in TABLEAUS.items() if tableau.error is not None]
)
def test_right_hand_sides_are_the_stages_of_a_step(name):
    """A last stage that the next step begins with is computed anew there; two choose the first."""
    tableau = TABLEAUS[name]
    scheme = tableau.scheme(is_adaptive=True, interpolates=False)
    least, most = scheme.last_stage, len(scheme.stages)
    assert compared_runs._evaluations(tableau, False, 10.0) == 10.0 * least
    assert compared_runs._evaluations(tableau, True, 10.0) == 10.0 * most + 2.0
    counts = {"BS32": (3, 4), "DP54": (6, 7), "Tsit5": (6, 7), "DOP853": (12, 12)}
    assert counts.get(name, (least, most)) == (least, most)


@pytest.mark.slow
def test_order_is_told_of_what_moves():
    """Of a body that turns about its centre of mass no position has an error."""
    problem = lierb.Problem(box(), lierb.joints.spherical())
    found = lierb.convergence(
        problem, "RK4", DTS, twist0=problem.joint.twist(omega=OMEGA), t_end=T_END, repeats=0
    )
    assert found.order("RK4") == found.order("RK4", quantity="error.rotation")
    assert found.order("RK4") == pytest.approx(4.0, rel=0.1)
    assert np.isnan(found.order("RK4", quantity="error.position"))


def test_cpu_time_is_that_of_the_thread(monkeypatch):
    seconds = iter(np.cumsum([0.0, 5.0, 0.0, 2.0, 0.0, 3.0]))
    monkeypatch.setattr(case.time, "thread_time", lambda: float(next(seconds)))
    calls = []
    monkeypatch.setattr(case.Case, "integrated", lambda self, options: calls.append(options))
    three = case.Case(box_top(), None, twists(), 0.0, T_END, {}, "largest", 3)
    assert three.timed(three.options(dt=DTS[0])) == 2.0
    assert len(calls) == 3


def test_cpu_time_may_be_left_out(found):
    assert (column(found.table, "cpu_time") > 0.0).all()
    start = {"twist0": twists(OMEGA[0]), "t_end": T_END}
    fine = lierb.integrate(box_top(), dt=1e-3, **start)
    without = lierb.convergence(box_top(), "RK4", DTS, reference=fine, repeats=0, **start)
    assert without.table["cpu_time"].null_count == 3
    assert "CPU" not in without.to_markdown()
    assert all("CPU" not in axes.get_xlabel() for axes in without.figure().axes)


@pytest.mark.slow
def test_steps_end_at_discontinuities():
    """A thrust that ends within a step of 0.1 s; steps that end with it have no error."""

    @lierb.wrench
    def thrust(t, R, r, omega, v, params):
        return np.zeros(3), np.array((np.where(t < 0.25, 40.0, 0.0), 0.0, 0.0))

    block = lierb.Problem(
        lierb.bodies.box((0.1, 0.2, 0.3), mass=2.0), lierb.joints.free(), forces=thrust()
    )
    found = lierb.convergence(
        block, "RK4", [0.1, 0.05], t_end=1.0, discontinuities=[0.25], repeats=0
    )
    assert max(column(found.table, "error.v")) < 1e-7  # of 5 m/s; 1.3 m/s without


def test_progress_is_told_run_by_run(exact):
    told = []
    lierb.convergence(
        box_top(), ["Euler", "RK4"], DTS[:2], twist0=twists(), t_end=T_END, reference=exact,
        repeats=1, progress=lambda *given: told.append(given),
    )  # fmt: skip
    assert [done for done, _, _ in told] == [0, 1, 2, 3, 4]
    assert {total for _, total, _ in told} == {4}
    assert told[0][2] == "Euler, SE3, dt = 0.008 s"


def test_tolerances_make_adaptive_runs(monkeypatch, exact):
    """How integrate is asked, and what becomes of the steps that it tells; here they are fixed."""
    asked = []
    steps = {1e-4: (40, 8), 1e-6: (100, 10), 1e-8: (250, 5)}

    def integrate_model(model, options, pose0, twist0, **given):
        timing = options.timing
        given |= {"pose0": pose0, "twist0": twist0, "t_end": timing.t_end, "method": "RK4"}
        if not timing.is_adaptive:
            return lierb.integrate(model, dt=timing.dt, **given)
        asked.append((timing.method.name, timing.rtol, {*timing.atol}, timing.dt))
        taken, rejected = steps[timing.rtol]
        result = lierb.integrate(model, dt=T_END / taken, **given)
        summary = result.summary
        for name, value in (("steps", taken), ("rejected", rejected)):
            summary = summary.append_column(name, [np.full(summary.num_rows, value)])
        return lierb.Result(summary, None)

    monkeypatch.setattr(case, "integrate_model", integrate_model)
    found = lierb.convergence(
        box_top(), ["RK4", "BS32"], DTS[:1], rtols=[1e-6, 1e-4, 1e-8], atol=1e-9,
        twist0=twists(), t_end=T_END, reference=exact, repeats=0,
    )  # fmt: skip
    assert asked == [("BS32", rtol, {1e-9}, 0.0) for rtol in steps]
    fixed, adaptive = found.table.to_pylist()[:2], found.table.to_pylist()[2:]
    assert [(row["method"], row["rtol"]) for row in fixed] == [("RK4", None), ("BS32", None)]
    for row, (rtol, (taken, rejected)) in zip(adaptive, steps.items(), strict=True):
        assert (row["rtol"], row["dt"]) == (rtol, None)
        assert (row["steps"], row["rejected"]) == (taken, rejected)
        assert row["step"] == pytest.approx(T_END / taken)
        assert row["evaluations"] == 4 * (taken + rejected) + 2
    # over the mean step: of RK4, which has made these runs
    assert found.order("BS32", quantity="error.rotation") == pytest.approx(4.0, rel=0.1)
    assert {each.control for each in found.orders} == {"rtol"}
    assert [axes.get_xlabel() for axes in found.figure().axes][2] == "rtol"
    assert "mean step" in found.to_markdown()


@pytest.mark.slow
def test_errors_follow_the_tolerance(exact):
    found = lierb.convergence(
        box_top(), "DP54", rtols=[1e-4, 1e-6, 1e-8], twist0=twists(), t_end=T_END,
        reference=exact, repeats=0,
    )  # fmt: skip
    reach = np.linalg.norm(exact[0][..., :3, 3], axis=-1).max()  # m, that a position is relative to
    for quantity, size in (("error.rotation", 1.0), ("error.position", reach)):
        ratios = column(found.table, quantity) / (size * column(found.table, "rtol"))
        # a tolerance is what thirty turns of a uniform rotation come to, and this is about one
        assert (ratios < 30.0).all()
        assert (ratios > 1.0 / 100.0).all()
        assert ratios.max() < 3.0 * ratios.min()  # of all tolerances the same share
    # p = 5; the largest errors are of one trajectory, mean steps of three
    assert found.order("DP54", quantity="error.rotation") == pytest.approx(5.0, rel=0.1)
    steps, rejected = (column(found.table, name) for name in ("steps", "rejected"))
    assert_allclose(column(found.table, "evaluations"), 7 * (steps + rejected) + 2)


# ---- arguments ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("given", "error", "message"),
    [
        ({"methods": "RK5"}, UnknownNameError, "method='RK5' is unknown.*Did you mean 'RK4'"),
        ({"methods": ["RK4", "RK4"]}, ArgumentError, "methods: 'RK4' is given twice"),
        ({"methods": []}, ArgumentError, "methods is empty"),
        ({"dts": 0.03}, TimeGridError, r"0\.03 s.*0\.4 s; the nearest .* 0\.02857.* and 0\.0307"),
        ({"dts": 1.0}, TimeGridError, r"the nearest that fit are 0\.2 and 0\.4"),
        ({"dts": None}, ArgumentError, "neither dts nor rtols"),
        ({"dts": None, "rtols": 1e-6}, ArgumentError, "Euler has no embedded pair"),
        ({"dts": [-1.0]}, ArgumentError, "dts is .*positive"),
        ({"t_end": float("nan")}, TimeGridError, "t_end=nan"),
        ({"t0": T_END}, TimeGridError, "t_end=0.4; expected a time in s later than t0"),
        ({"cspaces": ["SE3", "SO3"]}, UnknownNameError, "cspace='SO3' is unknown"),
        ({"norm": "mean"}, UnknownNameError, "norm='mean'"),
        ({"repeats": -1}, ArgumentError, "repeats=-1"),
        ({"methods": "DP54", "rtols": 1e-6, "atol": {"spin": 1e-9}}, LierbError, "spin"),
        ({"atol": 1e-9}, ArgumentError, "atol goes with rtols"),
        ({"progress": 3}, ArgumentError, "progress=3"),
        ({"reference": 3}, ArgumentError, "reference=3; expected the lierb.Result"),
        ({"reference": (np.eye(4), np.zeros(5))}, ArgumentError, "reference: twist0 has shape"),
        ({"reference": LATER}, ArgumentError, r"t = 1\.0 s; expected t_end = 0\.4"),
    ],
)  # fmt: skip
def test_convergence_refuses(given, error, message):
    options = {"methods": "Euler", "dts": DTS, "twist0": twists(), "t_end": T_END} | given
    with pytest.raises(error, match=message):
        lierb.convergence(box_top(), **options)


def test_convergence_refuses_another_problem():
    with pytest.raises(ArgumentError, match="problem must be"):
        lierb.convergence(3, "RK4", DTS, twist0=twists(), t_end=T_END)


@pytest.mark.parametrize(
    ("poses", "twists_at_end", "message"),
    [
        (slice(2), slice(2), "reference has 2 trajectories; expected 3"),
        (0, 0, "reference has 1 trajectory; expected 3"),  # NumPy would broadcast it
        (slice(1), slice(1), "reference has 1 trajectory; expected 3"),
        (slice(3), 0, "reference has poses and twists of 1, 3 trajectories"),
        (0, slice(3), "reference has poses and twists of 1, 3 trajectories"),
    ],
)
def test_convergence_refuses_a_reference_of_another_batch(exact, poses, twists_at_end, message):
    given = exact[0][poses], exact[1][twists_at_end]
    with pytest.raises(ArgumentError, match=message):
        lierb.convergence(box_top(), "RK4", DTS, twist0=twists(), t_end=T_END, reference=given)


# ---- how it is told ----------------------------------------------------------------------------


def test_markdown_has_a_row_for_each_run_and_method(found):
    runs, orders, notes = found.to_markdown().strip().split("\n\n")
    for text, rows in ((runs, 9), (orders, 3)):
        lines = text.splitlines()
        assert len(lines) == 2 + rows
        assert len({line.count(" | ") for line in lines}) == 1
    assert all(line.startswith("- ") for line in notes.splitlines())
    assert "the largest over the 3 trajectories" in notes
    assert "taken to be exact" in notes
    few = found.to_markdown(["method", "dt", "error.v"]).splitlines()
    assert few[0] == "| method | dt, s | v, m/s |"
    with pytest.raises(UnknownNameError, match="columns='speed'"):
        found.to_markdown(["speed"])


def test_latex_is_well_formed(exact):
    """Environments close, rows have as many cells as the head, mathematics parses."""
    from matplotlib.mathtext import MathTextParser

    named = lierb.ButcherTableau([[]], [1], name="a_b&c%", order=1)
    found = lierb.convergence(
        box_top(), [named, "RK4"], DTS, twist0=twists(), t_end=T_END, reference=exact, repeats=1
    )
    text = found.to_latex()
    opened = re.findall(r"\\(begin|end)\{(\w+)\}", text)
    stack = []
    for what, name in opened:
        if what == "begin":
            stack.append(name)
        else:
            assert stack.pop() == name
    assert stack == []
    tabulars = re.findall(r"\\begin\{tabular\}\{([lr]+)\}\n(.*?)\\end\{tabular\}", text, re.DOTALL)
    assert len(tabulars) == 2
    for shape, body in tabulars:
        rows = re.findall(r"^(.*?) \\\\$", body, re.MULTILINE)
        assert {len(re.split(r"(?<!\\)&", row)) for row in rows} == {len(shape)}
    assert text.isascii() or not {*text} & {*ESCAPED}
    plain = re.sub(r"\\.", "", re.sub(r"\$[^$]*\$", "", text))
    caption = re.search(r"\\caption\{(.*)\}\n", text)[1]
    assert not set("#%~") & {*plain}
    assert r"a\_b\&c\%" in text
    assert caption.count("{") == caption.count("}")
    parser = MathTextParser("path")
    for formula in set(re.findall(r"\$[^$]*\$", text)):
        parser.parse(formula)


def test_a_comparison_shows_itself(found):
    text = repr(found)
    assert text.startswith("lierb.Comparison: 9 runs")
    assert re.search(r"RK4, SE3 +order of rotation \d\.\d\d \(3 of 3\)", text)
    assert "joint position exact" in text


@pytest.mark.slow
def test_save_writes_whole_files(found, tmp_path):
    paths = found.save(tmp_path / "out")
    names = ["parquet", "md", "tex", "png", "svg"]
    assert [path.name for path in paths] == [f"comparison.{kind}" for kind in names]
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == sorted(
        p.name for p in paths
    )
    table = pq.read_table(paths[0])
    assert table.to_pylist() == found.table.to_pylist()
    assert table.schema.field("error.omega").metadata[b"unit"] == b"rad/s"
    told = json.loads(table.schema.metadata[b"lierb"])
    assert told["norm"] == "largest"
    slopes = {(o["method"], o["quantity"]): o["order"] for o in told["orders"]}
    assert slopes["RK4", "error.v"]["slope"] == found.order("RK4", quantity="error.v")
    assert paths[1].read_text(encoding="utf-8") == found.to_markdown()


def test_figure_has_work_and_precision(found):
    figure = found.figure()
    across = [axes.get_xlabel() for axes in figure.axes if axes.get_visible()]
    assert across == ["CPU time [s]", "right-hand sides", "Δt [s]", "Δt [s]", "Δt [s]"]
    labels = [text.get_text() for text in figure.axes[2].texts]
    assert labels == ["order 1", "order 2", "order 4"]
    assert figure.axes[0].get_xscale() == figure.axes[0].get_yscale() == "log"
    assert "exactly 0" in " ".join(t.get_text() for t in figure.axes[3].texts)  # the pivot
    with pytest.raises(UnknownNameError, match="quantity='speed'"):
        found.figure("speed")
    content = io.BytesIO()
    figure.savefig(content)
    assert content.tell() > 10_000


# ---- the command -------------------------------------------------------------------------------


@pytest.fixture
def command(monkeypatch, exact):
    """`lierb compare`, with a reference by RK4: its kernels are those of the other tests."""
    pytest.importorskip("rich")
    from command import invoke

    monkeypatch.setattr(reference, "METHOD", "RK4")
    monkeypatch.setattr(reference, "CSPACES", ("SE3",))
    return invoke


STUDY = f"""\
[body]
mass = {BOX_MASS}
inertia = {list(BOX_INERTIA)}

[joint]
type = "spherical"
body_point = {list(BOX_POINT)}

[problem]
gravity = {list(GRAVITY)}

[sample]
n = 100

[sample.initial.omega]
distribution = "normal"
mean = [6.28, 3.14, 0.63]
std = 0.1

[integrate]
dt = 4e-3
t_end = {T_END}
"""


@pytest.fixture
def study(tmp_path):
    path = tmp_path / "tops.toml"
    path.write_text(STUDY, encoding="utf-8")
    return path


@pytest.mark.slow
def test_compare_prints_tables_and_writes_files(command, study, tmp_path):
    out = tmp_path / "out"
    result = command("compare", study, "--methods", "Heun,RK4", "--n", 4, "-o", out)
    assert result.exit_code == 0, result.output
    assert "RK4      SE3       0.001" in result.stdout
    assert re.search(r"Heun +SE3 +dt +(2\.0|1\.9)", result.stdout)
    assert f"Written to {out}: comparison.parquet" in result.stdout
    assert "[1/7] Heun, SE3, dt = 0.004 s" in result.stderr
    dts = pq.read_table(out / "comparison.parquet")["dt"].to_pylist()
    assert dts == [4e-3, 2e-3, 1e-3] * 2  # of one dt its half and its quarter


@pytest.mark.slow
@pytest.mark.parametrize(("option", "begins"), [("--markdown", "| method"), ("--latex", r"\begin")])
def test_compare_prints_what_a_paper_takes(command, study, tmp_path, option, begins):
    out = tmp_path / "out"
    words = ("--methods", "RK4", "--dts", "8e-3, 4e-3", "--repeats", 0, option)
    result = command("compare", study, *words, "-o", out)
    assert result.exit_code == 0, result.output
    assert result.stdout.startswith(begins)
    assert "The first 64 of 100 trajectories" in result.stderr
    written = (out / f"comparison.{'md' if option == '--markdown' else 'tex'}").read_text("utf-8")
    assert result.stdout == written


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        (("--methods", "RK5"), 1, "method='RK5' is unknown"),
        (("--dts", "0.03"), 1, "the nearest that fit"),
        (("--dts", "small"), 2, "expected numbers, as 1e-2,5e-3"),
        (("--n", "101"), 2, "the study has 100"),
    ],
)
def test_compare_refuses(command, study, tmp_path, words, code, message):
    result = command("compare", study, *words, "-o", tmp_path / "out")
    assert result.exit_code == code
    assert message in " ".join(result.stderr.split())
    assert not (tmp_path / "out").exists()


def test_compare_that_is_interrupted_leaves_nothing(command, study, tmp_path, monkeypatch):
    def interrupted(*_given, **_options):
        raise KeyboardInterrupt

    monkeypatch.setattr(compared_runs, "_ran", interrupted)
    result = command("compare", study, "--methods", "RK4", "-o", tmp_path / "out")
    assert result.exit_code == 130
    assert not (tmp_path / "out").exists()
