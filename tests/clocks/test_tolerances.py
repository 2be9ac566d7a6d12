"""Global errors in multiples of rtol: the accuracy requested is attained.

`rtol` bounds the error of a step. What a motion makes of it differs: the errors of all steps add
up, and tops part from each other. The bound is thirty times rtol at the end, in the norm that steps
are chosen by; the lower one says that no steps are wasted.
"""

import functools
import itertools
import json

import numpy as np
import pytest

import lierb
from clocks.truths import DATA, distance, problem_of, reference, states_of
from lierb.kernels.stepping.stages import beside_the_step

FACTOR = 30.0
END = {"heavy_top": "0.5", "free_body": "2", "fast_top": "0.05", "universal": "0.5"}  # about a turn
RTOLS = tuple(10.0**-k for k in range(4, 13))
# The steps of low orders are a million at 1e-12, and their rounding adds up.
LEAST = {"BS32": 1e-8, "DP54": 1e-11, "Tsit5": 1e-11}
METHODS = ("BS32", "DP54", "Tsit5", "Verner65", "Verner87", "Verner98", "DOP853")
QUICK = ("heavy_top", "SE3", "DP54")  # whose kernel test_bits.py has as well
SLOW = ("heavy_top", "SE3", "DOP853"), ("free_body", "SE3", "DP54")
FORMS = [
    pytest.param(
        *form, id="-".join(form),
        marks=() if form == QUICK else pytest.mark.slow if form in SLOW else pytest.mark.long,
    )
    for form in itertools.product(DATA, ("SE3", "SO3xR3"), METHODS)
]  # fmt: skip


@functools.cache
def errors(name: str, cspace: str, method: str, **options) -> dict[float, float]:
    """rtol → error at the end, over rtol."""
    problem, twist0 = problem_of(name)
    true, ratios = reference(name)[END[name]], {}
    for rtol in RTOLS:
        if rtol < LEAST.get(method, 0.0):
            break
        result = lierb.integrate(
            problem, twist0=twist0, t_end=float(END[name]), rtol=rtol, method=method,
            cspace=cspace, **options,
        )  # fmt: skip
        assert result.summary["status"].to_pylist() == ["ok"]
        ratios[rtol] = distance(states_of(result.summary, 0), true) / rtol
    return ratios


@pytest.mark.parametrize("method", METHODS)
def test_errors_weighed_beside_the_step_are_those_of_the_tableau(method):
    tableau = lierb.TABLEAUS[method]
    rows = np.atleast_2d(tableau.error).tolist()
    parts = [beside_the_step(tuple(map(float, tableau.b)), tuple(row)) for row in rows]
    for row, (step, rest) in zip(rows, parts, strict=True):
        total = np.array(rest) + (step or 0.0)
        np.testing.assert_allclose(total, row, rtol=0, atol=2e-16 * max(map(abs, row)))
        assert np.count_nonzero(rest) <= np.count_nonzero(row)
    if method == "DOP853":  # of 12 stages, as its authors give it: b − b̂ (dop853.f, bhh1 to bhh3)
        assert min(np.count_nonzero(rest) for _, rest in parts) == 3


@pytest.mark.parametrize(("name", "cspace", "method"), FORMS)
def test_error_is_within_thirty_times_rtol(name, cspace, method):
    told = errors(name, cspace, method)
    assert max(told.values()) < FACTOR, told


@pytest.mark.parametrize(("name", "cspace", "method"), FORMS)
def test_error_follows_rtol(name, cspace, method):
    """A hundred times less is asked for: 10 to 1000 times less comes out, above rounding."""
    told = errors(name, cspace, method)
    rtols = [r for r in told if r >= 1e-10]
    slope = np.polyfit(np.log(rtols), np.log([told[r] * r for r in rtols]), 1)[0]
    assert 0.75 < slope < 1.35, told


@pytest.mark.long
@pytest.mark.parametrize("options", [
    {"solver": "saddle"}, {"cspace": "reduced"}, {"update": "global"},
    {"cspace": "SO3xR3", "update": "global"}, {"update": "ambient"},
    {"cspace": "SO3xR3", "update": "ambient"},
], ids=str)  # fmt: skip
@pytest.mark.parametrize("name", ["heavy_top", "fast_top"])
def test_other_formulations_keep_the_tolerance(name, options):
    options = {"cspace": "SE3"} | options
    told = errors(name, method="DOP853", **options)
    assert max(told.values()) < FACTOR, told


@pytest.mark.long
def test_a_mechanism_keeps_the_tolerance():
    """Two links agree with a run at a thousandth of the tolerance, in both c-spaces."""
    rod = lierb.bodies.box((0.05, 0.05, 0.5), mass=1.0)
    hinge = {"axis": (0.0, 1.0, 0.0), "body_point": (0.0, 0.0, 0.25)}
    tip = {"parent_point": (0.0, 0.0, -0.25)}
    revolute = lierb.joints.revolute
    links = [
        lierb.Link("upper", rod, revolute(**hinge)),
        lierb.Link("lower", rod, revolute(**hinge, **tip), "upper"),
    ]
    pendulum = lierb.Mechanism(links, gravity=(0.0, 0.0, -9.81))
    pose0 = pendulum.pose({"upper": 1.5, "lower": 0.5})
    start = {"pose0": pose0, "twist0": pendulum.twist({"lower": 1.0}, pose0)}
    fixed = lierb.integrate(pendulum, **start, dt=1e-3, t_end=1.0, method="DOP853")
    true = [states_of(fixed.summary, 0, "lower")]
    for cspace in ("reduced", "SE3", "SO3xR3"):
        for rtol in (1e-4, 1e-7, 1e-10):
            result = lierb.integrate(pendulum, **start, t_end=1.0, rtol=rtol, cspace=cspace)
            off = distance(states_of(result.summary, 0, "lower"), true[0])
            assert off < FACTOR * rtol, (cspace, rtol)


# ---- atol, by block ----------------------------------------------------------------------------


@pytest.mark.long
def test_atol_alone_is_what_counts_where_nothing_moves():
    """A body at rest under no force: one step, whatever its length."""
    problem = lierb.Problem(lierb.Body(1.0, (1.0, 1.0, 1.0)), lierb.joints.free())
    result = lierb.integrate(problem, twist0=np.zeros(6), t_end=1e3, atol=1e-9)
    assert result.summary["status"].to_pylist() == ["ok"]
    assert result.summary["steps"].to_pylist()[0] < 30
    assert result.summary["rejected"].to_pylist() == [0]


@lierb.wrench
def trap(t, R, r, omega, v, body):
    return np.zeros(3), -body.mass * (R.T @ r)


@pytest.mark.long
@pytest.mark.parametrize("cspace", ["SO3xR3", pytest.param("SE3", marks=pytest.mark.long)])
def test_nothing_is_small_in_itself(cspace):
    """A ball as large as it swings, in kilometres and in picometres: the same steps, and errors."""
    pairs = []
    for size in (1.0, 1e3, 1e-6, 1e-12):
        body = lierb.bodies.sphere(size, mass=1.0)
        problem = lierb.Problem(body, lierb.joints.free(), forces=trap())
        pose0 = np.eye(4)
        pose0[0, 3] = size
        result = lierb.integrate(
            problem, pose0=pose0, twist0=np.zeros(6), rtol=1e-6, t_end=20.0, cspace=cspace
        )
        off = result.position[0, 0] / size - np.cos(20.0)
        pairs.append((result.summary["steps"][0].as_py(), off))
    assert 0.0 < abs(pairs[0][1]) < FACTOR * 1e-6
    for steps, off in pairs:
        assert steps == pairs[0][0]
        assert off == pytest.approx(pairs[0][1], rel=0.0, abs=1e-12)  # rounding of 30 steps


@lierb.wrench
def levitating(t, R, r, omega, v, body):
    return np.zeros(3), body.mass * (R.T @ np.array([0.0, 0.0, 9.81]))


@pytest.mark.long
@pytest.mark.parametrize(("radius", "rtol"), [(1e-2, 1e-12), (1e-6, 1e-6), (1e-6, 1e-11)])
def test_what_rounding_leaves_of_weight_costs_no_steps(radius, rtol):
    """A ball that is held up, and turns: what is left of both forces is more than its own size."""
    problem = lierb.Problem(
        lierb.bodies.sphere(radius, density=2000.0), lierb.joints.free(), (0.0, 0.0, -9.81),
        forces=levitating(),
    )  # fmt: skip
    summary = lierb.integrate(
        problem, twist0=(0.3, 2.0, 1.0, 0.0, 0.0, 0.0), rtol=rtol, t_end=2.0, cspace="SO3xR3",
        max_steps=10_000,
    ).summary  # fmt: skip
    free = lierb.integrate(
        lierb.Problem(problem.body, problem.joint, (0.0, 0.0, 0.0), forces=levitating()),
        twist0=(0.3, 2.0, 1.0, 0.0, 0.0, 0.0), rtol=rtol, atol=1e-3, t_end=2.0, cspace="SO3xR3",
    ).summary  # fmt: skip
    assert summary["status"].to_pylist() == ["ok"]
    assert summary["steps"][0].as_py() < 10 * free["steps"][0].as_py() + 10
    # m: rounding of g t²/2 = 20 m, some steps' of it
    assert np.linalg.norm(summary["position"][0].as_py()) < 1e-13


def test_default_atol_is_what_metadata_leave_out():
    """Given back, they are the same run."""
    problem, twist0 = problem_of("heavy_top")
    run = {"twist0": twist0, "t_end": 0.1, "rtol": 1e-6, "method": "DP54"}
    first = lierb.integrate(problem, **run)
    atol = json.loads(first.summary.schema.metadata[b"lierb"])["options"]["atol"]
    assert atol == {"rotation": 1e-9, "omega": 1e-9, "states": 1e-9}
    again = lierb.integrate(problem, **run, atol=atol)
    assert again.summary == first.summary


def steps_with(atol, rtol=1e-9) -> int:
    problem, twist0 = problem_of("free_body")
    result = lierb.integrate(problem, twist0=twist0, t_end=5.0, rtol=rtol, atol=atol, method="DP54")
    return result.summary["steps"].to_pylist()[0]


@pytest.mark.slow
def test_atol_by_block_lets_one_block_go():
    """A body that turns and flies: its v, in its own axes, turns with it. Loose tolerances of all
    take few steps; each block still asks for them where that of the others is let go.
    """
    tight = steps_with(1e-12)
    turning, moving = {"rotation": 1e-2, "omega": 1e-2}, {"position": 1e2, "v": 1e2}
    assert steps_with(turning | moving) < tight / 5
    for loose in (turning, moving, {"rotation": 1e-2}):
        assert steps_with(loose) > tight / 3


@pytest.mark.parametrize(("options", "match"), [
    ({"rtol": -1e-6}, "rtol"), ({"rtol": float("nan")}, "rtol"), ({"rtol": "small"}, "rtol"),
    ({"atol": {"rotatoin": 1e-6}}, "rotation"), ({"atol": -1.0}, "atol"),
    ({"rtol": 1e-6, "method": "RK4"}, "RK4"),
    ({"rtol": 1e-6, "dt_min": 1.0, "dt_max": 0.1}, "dt_m"),
    ({"rtol": 1e-6, "dt_min": float("inf")}, "dt_min"),
    ({"rtol": 1e-6, "max_steps": 0}, "max_steps"),
    ({"rtol": 1e-6, "save_every": 10}, "save_every"),
    ({"rtol": 1e-6, "dt": -0.1}, "dt"),
], ids=str)  # fmt: skip
def test_wrong_tolerances_are_told(options, match):
    problem, twist0 = problem_of("heavy_top")
    with pytest.raises(lierb.errors.LierbError, match=match):
        lierb.integrate(problem, twist0=twist0, t_end=1.0, **options)


# ---- first, shortest, longest step, and their number -------------------------------------------


def told(**options):
    problem, twist0 = problem_of("heavy_top")
    options = {"rtol": 1e-6, "t_end": 1.0} | options
    return lierb.integrate(problem, twist0=twist0, **options).summary


def test_dt_is_the_first_step():
    """Tried first and kept: one step is enough where it reaches the end."""
    assert told(dt=1e-3, t_end=1e-3)["steps"].to_pylist() == [1]
    assert told(dt=1e-3, t_end=1e-3)["rejected"].to_pylist() == [0]


def test_dt_max_bounds_every_step():
    assert told(dt_max=1e-2)["steps"].to_pylist()[0] >= 100
    assert told(dt_max=1e-2)["rejected"].to_pylist() == [0]
    assert told(dt_max=1e-2)["dt_last"].to_pylist()[0] <= 1e-2


@pytest.mark.filterwarnings("ignore::lierb.errors.FailedTrajectoryWarning")
def test_dt_min_ends_with_its_status():
    summary = told(rtol=1e-12, dt=0.1, dt_min=5e-2)
    assert summary["status"].to_pylist() == ["dt_min"]
    assert summary["t"].to_pylist()[0] < 1.0
    assert summary["rejected"].to_pylist()[0] > 0


@pytest.mark.filterwarnings("ignore::lierb.errors.FailedTrajectoryWarning")
def test_max_steps_ends_with_its_status():
    summary = told(max_steps=5)
    assert summary["status"].to_pylist() == ["max_steps"]
    assert summary["steps"].to_pylist() == [5] or (
        summary["steps"].to_pylist()[0] + summary["rejected"].to_pylist()[0] == 5
    )
    assert 0.0 < summary["t"].to_pylist()[0] < 1.0


def test_the_end_is_met_exactly():
    """The last step is cut to what is left; t is t_end to the bit."""
    summary = told(t_end=0.7310585786300049)
    assert summary["t"].to_pylist() == [0.7310585786300049]
    assert summary["dt_last"].to_pylist()[0] > 0.0


def test_t0_shifts_the_clock_alone():
    """Nothing depends on t: steps are the same, what is found to rounding."""
    here, there = told(), told(t0=8.0, t_end=9.0)
    assert here["steps"].to_pylist() == there["steps"].to_pylist()
    assert distance(states_of(there, 0), states_of(here, 0)) < 1e-13
