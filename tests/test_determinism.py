"""A body's bits depend on its own inputs and the kind of CPU, and on nothing else."""

from __future__ import annotations

import numpy as np
import pytest
from cases import BODY_FRAME, GRAVITY, GROUND_FRAME, RECORD, box, joint, slow_but, tiered

import lierb
from lierb.errors import FailedTrajectoryWarning, PoseError, TwistError
from lierb.kernels.stepping.clock import StepClock
from lierb.kernels.systems.layout import inputs_of
from lierb.kernels.systems.plan import Plan
from lierb.kernels.systems.state import NON_FINITE, OK, SINGULAR
from lierb.kernels.tracing.cpu import DEFAULT_LANES
from lierb.model import problem as problem_module
from lierb.runs import engine

# At dt = 1e-2 some of the fastest of TWISTS fail: in any batch at the same step, or bits differ.
pytestmark = pytest.mark.filterwarnings("ignore::lierb.errors.FailedTrajectoryWarning")

STEPS = 50
SUMMARY = [
    "position_error_max", "rotation_error_max", "velocity_error_max", "rotation_rate_error_max",
    "energy_drift_max", "work_final", "orthogonality_error_max", "position_error_final", "t",
]  # fmt: skip


def _twists(count: int, seed: int = 11) -> np.ndarray:
    """Slow to fast rates: at dt = 1e-2 the steps' angles lie on both sides of every cut-over."""
    rng = np.random.default_rng(seed)
    omega = rng.standard_normal((count, 3)) * 10.0 ** rng.uniform(-1.5, 2.3, (count, 1))
    return joint("spherical").twist(omega=omega)


def _problem(count: int | None = None) -> lierb.Problem:
    """Shared parameters, or the same ones for each of `count` bodies."""
    body = box(turned=True)
    if count is None:
        return lierb.Problem(body, joint("spherical"), GRAVITY)

    def each(array):
        return np.broadcast_to(array, (count, *np.shape(array))).copy()

    held = joint("spherical", each(GROUND_FRAME), each(BODY_FRAME))
    own = lierb.Body(each(body.mass), each(body.inertia))
    return lierb.Problem(own, held, each(GRAVITY))


def _run(twist0, problem=None, **options) -> lierb.Result:
    options = {"dt": 1e-2, "t_end": STEPS * 1e-2, "check": "off"} | options
    return lierb.integrate(problem or _problem(), twist0=twist0, **options)


def _bits(result: lierb.Result) -> np.ndarray:
    """Every number of the summary, as integers: −0 and NaN count as themselves."""
    rows = [np.array(result.summary[name].to_pylist(), dtype=float)[:, None] for name in SUMMARY]
    rows += [
        np.array(result.summary[name].to_pylist(), dtype=float)
        for name in ("rotation", "position", "omega", "v")
    ]
    return np.concatenate(rows, axis=1).view(np.int64)


TWISTS = _twists(1000)


@pytest.fixture(scope="module")
def expected() -> np.ndarray:
    return _bits(_run(TWISTS))


@pytest.mark.parametrize("solver", slow_but(["auto", "saddle"], "auto"))
def test_bits_do_not_depend_on_the_poses_of_the_others(solver):
    """Quantities of a pose are computed once for a common pose, and per block otherwise."""
    problem, count = _problem(), 37
    twists, hinge = TWISTS[:count], problem.joint.body_frame[:3, 3]
    held = problem.joint.closed_pose
    turned = held[:3, :3] @ lierb.lie.so3.exp(np.random.default_rng(4).normal(size=(count, 3)))
    poses = np.tile(held, (count, 1, 1))
    poses[:, :3, :3] = turned
    poses[:, :3, 3] += (held[:3, :3] - turned) @ hinge  # the joint's point stays
    together = _bits(_run(twists, pose0=poses, solver=solver, check="raise"))
    for i in (0, 9, 36):
        alone = _bits(_run(twists[i : i + 1], pose0=poses[i], solver=solver, check="raise"))
        np.testing.assert_array_equal(together[i : i + 1], alone)


@pytest.mark.parametrize("which", ["pose0", "twist0"])
def test_a_start_off_its_joint_is_found_behind_others(which):
    """Violations are found by the compiled check, which examines a common pose once."""
    problem = _problem()
    poses = np.tile(problem.joint.closed_pose, (37, 1, 1))
    given = {"pose0": poses, "twist0": TWISTS[:37].copy()}
    given[which][29, ..., -1] += 1e-3
    if which == "twist0":
        del given["pose0"]
    with pytest.raises((PoseError, TwistError), match=rf"{which}\[29\]"):
        _run(given.pop("twist0"), check="raise", **given)


@pytest.mark.parametrize("count", [1, 2, 3, 5, 17])
def test_bits_do_not_depend_on_batch_size(count, expected):
    np.testing.assert_array_equal(_bits(_run(TWISTS[:count])), expected[:count])


def test_bits_do_not_depend_on_place_in_batch(expected):
    order = np.random.default_rng(2).permutation(len(TWISTS))
    np.testing.assert_array_equal(_bits(_run(TWISTS[order])), expected[order])


@pytest.mark.slow
@pytest.mark.parametrize("lanes", tiered([1, 2, 4, 8], [1], [8]))
def test_bits_do_not_depend_on_lanes(lanes, expected, monkeypatch):
    monkeypatch.setattr(problem_module, "DEFAULT_LANES", lanes)
    np.testing.assert_array_equal(_bits(_run(TWISTS)), expected)


@pytest.mark.parametrize("threads", [1, 2])
def test_bits_do_not_depend_on_threads(threads, expected):
    import numba

    if threads > numba.config.NUMBA_NUM_THREADS:
        pytest.skip("one core only")
    np.testing.assert_array_equal(_bits(_run(TWISTS, threads=threads)), expected)


@pytest.mark.slow
@pytest.mark.parametrize(
    "options",
    [
        {"save_every": 1},
        {"save_every": 7},
        {"save_every": 1, "record": ["state", "energy"]},
        {"save_every": 3, "record": [*RECORD, "energy"]},
    ],
    ids=str,
)
def test_bits_do_not_depend_on_history_and_record(options, expected):
    np.testing.assert_array_equal(_bits(_run(TWISTS[:100], **options)), expected[:100])


def test_bits_do_not_depend_on_sharing_of_parameters(expected):
    own = _problem(len(TWISTS))
    np.testing.assert_array_equal(_bits(_run(TWISTS, own)), expected)


@pytest.mark.parametrize(("bodies", "block_steps"), [(64, 8), (1000, 1), (17, 10_000)])
def test_bits_do_not_depend_on_chunks(bodies, block_steps, expected, monkeypatch):
    monkeypatch.setattr(engine, "CHUNK_BODIES", bodies)
    monkeypatch.setattr(engine, "FIRST_CALL_BLOCK_STEPS", block_steps)
    monkeypatch.setattr(engine, "CALL_SECONDS", 0.0)
    np.testing.assert_array_equal(_bits(_run(TWISTS[:100])), expected[:100])


@pytest.mark.parametrize(
    ("cspace", "update"),
    [
        pytest.param("SE3", "global", marks=pytest.mark.long),
        pytest.param("SO3xR3", "local", marks=pytest.mark.long),
        pytest.param("SO3xR3", "global", marks=pytest.mark.long),
        pytest.param("SE3", "ambient", marks=pytest.mark.long),
        pytest.param("SO3xR3", "ambient", marks=pytest.mark.long),
    ],
)
def test_lanes_do_not_matter_in_other_forms(cspace, update, monkeypatch):
    """Re-charting too goes lane by lane."""
    form = {"cspace": cspace, "update": update, "save_every": STEPS, "record": RECORD}
    results = []
    for lanes in (1, DEFAULT_LANES):
        monkeypatch.setattr(problem_module, "DEFAULT_LANES", lanes)
        results.append(_bits(_run(TWISTS[:64], **form)))
    np.testing.assert_array_equal(*results)


# ---- failures ----------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("victim", [0, 3, 16])
@pytest.mark.parametrize(("fault", "seen"), [(np.nan, 0), (np.inf, 0), (1e200, 0), (1e100, 1)])
def test_a_failing_body_leaves_its_neighbours_alone(victim, fault, seen, expected):
    """Fed to the runner directly: the public face lets no NaN in."""
    twists = TWISTS[:17].copy()
    twists[victim, 1] = fault
    rk4 = lierb.methods.TABLEAUS["RK4"]
    plan = Plan(
        lanes=DEFAULT_LANES, rows=_problem().joint.rows, cspace="SE3", update="local",
        method=rk4.scheme(False, False), multipliers=False,
    )  # fmt: skip
    problem = _problem()
    inputs = engine.Inputs(problem, inputs_of(problem.kinds), {"twist": twists}, 17)
    output = engine.integrate(plan, inputs, StepClock(1e-2, STEPS, 1, 0))
    others = np.arange(17) != victim
    state = np.concatenate(output.state, axis=1)
    undisturbed = expected[:17, len(SUMMARY) :]
    np.testing.assert_array_equal(state[others].view(np.int64), undisturbed[others])
    assert output.status[victim] == NON_FINITE
    assert output.t[victim] == seen * 1e-2
    assert np.isnan(state[victim]).all()
    assert (output.status[others] == OK).all()


@pytest.mark.slow
def test_an_overflowing_body_gets_its_status_and_time():
    """Euler with a step far too long: the body spins up until it overflows."""
    fast = np.concatenate([_twists(4), joint("spherical").twist(omega=[(3e3, 2e3, 1e3)])])
    with pytest.warns(FailedTrajectoryWarning, match="trajectory 0, non_finite"):
        result = _run(fast, dt=0.5, t_end=200.0, method="Euler")
    statuses = result.summary["status"].to_pylist()
    assert statuses[-1] == "non_finite"
    failed_at = result.summary["t"][4].as_py()
    assert 0.0 < failed_at < 200.0
    assert np.isnan(result.summary["position"][4].as_py()).all()
    assert np.isfinite(result.summary["position_error_max"][4].as_py())


@pytest.mark.slow
def test_a_singular_configuration_is_marked():
    """Q₃₂ = 0 and Q₂₃ = 0 and Q₃₃ = 0 at once ask for more than a rotation can give."""
    held = lierb.joints.from_rows(["Q32", "Q31", "Q33"])
    problem = lierb.Problem(lierb.Body(1.0, (0.1, 0.2, 0.25)), held)
    with pytest.warns(FailedTrajectoryWarning, match="3 singular"):
        result = lierb.integrate(
            problem, twist0=[(0.3, 0.2, 0.5, 0, 0, 0)] * 3, dt=1e-2, t_end=0.1, check="off",
            method="Euler",
        )  # fmt: skip
    assert set(result.summary["status"].to_pylist()) == {"singular"}
    np.testing.assert_array_equal(result.summary["t"].to_numpy(), 1e-2)
    assert SINGULAR == 1
