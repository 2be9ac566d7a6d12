"""The tables of a run: schema, rows, and every number recomputed from the recorded state."""

import hashlib
import json
import threading
from types import SimpleNamespace

import duckdb
import numpy as np
import pyarrow as pa
import pytest
from cases import RECORD, slow_but, tiered
from mechanisms.shared import four_bar

import lierb
from lierb import joints
from lierb.errors import FailedTrajectoryWarning, UnknownNameError
from lierb.kernels.tracing.cpu import DEFAULT_LANES
from lierb.runs import engine

BOX = (0.0126563, 0.0468281, 0.0569531)
POINT = (-0.15, 0.0375, 0.0)
STEPS = 10
DT = 1e-2
COUNT = 5  # no multiple of any number of lanes


# ---------------------------------------------------------------- helpers


def run(problem, twist0, **given):
    arguments = {"dt": DT, "t_end": STEPS * DT} | given
    return lierb.integrate(problem, twist0=twist0, **arguments)


@pytest.fixture(scope="module")
def top():
    """Müller's box on a spherical joint under gravity, and twists for COUNT of them."""
    problem = lierb.Problem(lierb.Body(6.075, BOX), joints.spherical(POINT), (0, 0, -9.81))
    omegas = np.outer(np.linspace(0.2, 1.0, COUNT), (2 * np.pi, np.pi, 0.2 * np.pi))
    return problem, problem.joint.twist(omegas)


def column(table, name):
    """A column as an array, vectors as rows."""
    array = table[name].combine_chunks()
    if pa.types.is_fixed_size_list(array.type):
        return array.flatten().to_numpy().reshape(-1, array.type.list_size)
    return array.to_numpy()


def by_body(table, name, count=COUNT):
    """A column of a history as [time][body]."""
    flat = column(table, name)
    return flat.reshape(-1, count, *flat.shape[1:])


def assert_same_bits(one, other, names=None):
    for name in names or one.column_names:
        if name != "status":
            np.testing.assert_array_equal(column(one, name), column(other, name), err_msg=name)
    if names is None:
        assert one["status"].to_pylist() == other["status"].to_pylist()


# ---------------------------------------------------------------- schema

VECTOR = {"rotation": 9, "position": 3, "omega": 3, "v": 3}
STATE_UNITS = {"rotation": "1", "position": "m", "omega": "rad/s", "v": "m/s"}
SUMMARY_UNITS = {
    "trajectory": None, "status": None, "t": "s",
    "position_error_max": "m", "position_error_final": "m",
    "rotation_error_max": "1", "rotation_error_final": "1",
    "velocity_error_max": "m/s", "rotation_rate_error_max": "rad/s",
    "energy_drift_max": "J", "work_final": "J", "orthogonality_error_max": "1", **STATE_UNITS,
}  # fmt: skip
ERRORS_UNITS = {
    "trajectory": None, "step": None, "t": "s", "position_error": "m", "rotation_error": "1",
    "velocity_error": "m/s", "rotation_rate_error": "rad/s", "energy_drift": "J",
    "orthogonality_error": "1",
}  # fmt: skip
RECORDED = {
    "state": STATE_UNITS,
    "energy": {"energy": "J", "work": "J"},
    "multipliers": {"lambda": "N, N, N"},
    "reaction": {"reaction": "N m, N m, N m, N, N, N"},
}


ALL_REVERSED = ("reaction", "multipliers", "energy", "state")


def expected_type(name):
    if name in ("trajectory", "step"):
        return pa.int64()
    if name in VECTOR or name in ("lambda", "reaction"):
        return pa.list_(pa.float64(), {**VECTOR, "lambda": 3, "reaction": 6}[name])
    return pa.float64()


def assert_schema(table, units):
    assert table.column_names == list(units)
    for field in table.schema:
        if field.name == "status":
            assert pa.types.is_dictionary(field.type)
            assert field.type.value_type == pa.string()
        else:
            assert field.type == expected_type(field.name), field.name
        told = (field.metadata or {}).get(b"unit")
        assert (told.decode() if told else None) == units[field.name], field.name
    table.validate(full=True)


def test_summary_schema(top):
    assert_schema(run(*top).summary, SUMMARY_UNITS)


def test_errors_schema(top):
    assert_schema(run(*top, save_every=5).history, ERRORS_UNITS)


@pytest.mark.parametrize(
    "record",
    tiered(
        [("state",), ("energy",), ("multipliers",), ALL_REVERSED],
        [("state",), ("energy",)], [ALL_REVERSED],
    ),
)  # fmt: skip
def test_record_adds_its_columns_in_a_fixed_order(top, record):
    added = {}
    for name in RECORDED:
        added |= RECORDED[name] if name in record else {}
    assert_schema(run(*top, save_every=5, record=record).history, ERRORS_UNITS | added)


def test_record_may_be_one_name(top):
    assert_schema(
        run(*top, save_every=5, record="energy").history, ERRORS_UNITS | RECORDED["energy"]
    )


@pytest.mark.slow
def test_multiplier_units_are_those_of_the_rows():
    problem = lierb.Problem(lierb.Body(6.075, BOX), joints.revolute())
    table = run(problem, np.zeros(6), save_every=1, record=RECORD).history
    field = table.schema.field("lambda")
    assert field.metadata[b"unit"] == b"N, N, N, N m, N m"
    assert field.type.list_size == 5


@pytest.mark.long
def test_a_state_may_have_another_shape_in_the_next_run():
    """Schemas are kept from run to run, by names and shapes."""

    @lierb.states(turn=0.0)
    def one(omega):
        return {"turn": omega[0]}

    @lierb.states(turn=(0.0, 0.0))
    def two(omega):
        return {"turn": omega[:2]}

    for states, shape in ((one(), (1,)), (two(), (1, 2))):
        flight = lierb.Problem(lierb.bodies.sphere(0.1, mass=1.0), joints.free(), states=states)
        result = lierb.integrate(flight, twist0=np.ones(6), dt=0.1, t_end=0.2)
        assert result["turn"].shape == shape


@pytest.mark.slow
def test_multipliers_of_a_free_body_survive_parquet(tmp_path):
    # there are none; Arrow's Parquet reader refuses a column of lists of length 0
    parquet = pytest.importorskip("pyarrow.parquet")
    problem = lierb.Problem(lierb.Body(6.075, BOX), joints.free())
    table = run(problem, np.zeros(6), save_every=1, record=RECORD).history
    parquet.write_table(table, tmp_path / "free.parquet")
    assert parquet.read_table(tmp_path / "free.parquet").equals(table)


def test_column_names_differ_where_case_is_ignored(top):
    """SQL is blind to case: of two columns `R` and `r` it gives the first for either."""
    result = run(*top, save_every=5, record=RECORD)
    for table in (result.summary, result.history):
        lowered = [name.lower() for name in table.column_names]
        assert len(set(lowered)) == len(lowered)
    found = duckdb.from_arrow(result.history).query("history", "SELECT position FROM history")
    np.testing.assert_array_equal(found.fetchall(), column(result.history, "position")[:, None])


def test_no_history_without_save_every(top):
    result = run(*top)
    assert result.history is None
    assert f"{COUNT} trajectories" in repr(result)


def test_status_lists_its_names(top):
    status = run(*top).summary["status"].combine_chunks()
    assert status.to_pylist() == ["ok"] * COUNT
    assert set(status.dictionary.to_pylist()) >= {"ok", "singular", "non_finite"}


def test_tables_survive_parquet(top, tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet")
    result = run(*top, save_every=4, record=("state", "energy"))
    for table in (result.summary, result.history):
        parquet.write_table(table, tmp_path / "table.parquet")
        again = parquet.read_table(tmp_path / "table.parquet")
        assert again.schema.metadata[b"lierb"] == table.schema.metadata[b"lierb"]
        for field in table.schema:
            assert _less_indices(again.schema.field(field.name).type) == _less_indices(field.type)
            unit = (field.metadata or {}).get(b"unit")
            assert (again.schema.field(field.name).metadata or {}).get(b"unit") == unit
        assert again.cast(table.schema).equals(table)


def _less_indices(kind):
    """Arrow up to 19 reads int32 as the indices of every dictionary."""
    return kind.value_type if pa.types.is_dictionary(kind) else kind


# ---------------------------------------------------------------- rows


@pytest.mark.parametrize(
    ("save_every", "steps"),
    [(1, list(range(11))), (4, [0, 4, 8, 10]), (5, [0, 5, 10]), (10, [0, 10]), (17, [0, 10])],
)
def test_errors_are_time_major_with_the_first_and_last_step(top, save_every, steps):
    table = run(*top, save_every=save_every).history
    assert column(table, "step").tolist() == np.repeat(steps, COUNT).tolist()
    assert column(table, "trajectory").tolist() == list(range(COUNT)) * len(steps)
    # t = k·dt, one product
    np.testing.assert_array_equal(column(table, "t"), np.repeat(np.array(steps) * DT, COUNT))


def test_one_step_is_a_whole_run(top):
    table = run(*top, save_every=1, t_end=DT).history
    assert by_body(table, "step")[:, 0].tolist() == [0, 1]


@pytest.mark.parametrize("save_every", [3, 4, 17])
def test_save_every_changes_no_bit(top, save_every):
    full = run(*top, save_every=1, record=("state", "energy"))
    thin = run(*top, save_every=save_every, record=("state", "energy"))
    steps = by_body(thin.history, "step")[:, 0]
    for name in full.history.column_names:
        np.testing.assert_array_equal(
            by_body(thin.history, name), by_body(full.history, name)[steps], err_msg=name
        )
    assert_same_bits(thin.summary, full.summary)


def test_summary_does_not_depend_on_the_history(top):
    with_history = run(*top, save_every=3, record=ALL_REVERSED).summary
    assert_same_bits(run(*top).summary, with_history)


def test_summary_ends_where_the_history_ends(top):
    result = run(*top, save_every=4, record="state")
    for name in VECTOR:
        np.testing.assert_array_equal(
            column(result.summary, name), by_body(result.history, name)[-1], err_msg=name
        )
    for name in ("position_error", "rotation_error"):
        np.testing.assert_array_equal(
            column(result.summary, f"{name}_final"), by_body(result.history, name)[-1]
        )
    assert column(result.summary, "t").tolist() == [STEPS * DT] * COUNT
    assert column(result.summary, "trajectory").tolist() == list(range(COUNT))


def test_history_starts_with_the_given_state(top):
    problem, twists = top
    table = run(*top, save_every=5, record="state").history
    start = {name: by_body(table, name)[0] for name in VECTOR}
    # taken to the joint's frame, which is parallel to the body's here, and back
    np.testing.assert_allclose(start["omega"], twists[:, :3], rtol=0, atol=1e-15)
    np.testing.assert_allclose(start["v"], twists[:, 3:], rtol=0, atol=2e-15)
    C = problem.joint.closed_pose
    turned = np.tile(C[:3, :3].reshape(-1), (COUNT, 1))
    np.testing.assert_allclose(start["rotation"], turned, atol=1e-15)
    np.testing.assert_allclose(start["position"], np.tile(C[:3, 3], (COUNT, 1)), atol=1e-15)


MAXIMA = (
    "position_error", "rotation_error", "velocity_error", "rotation_rate_error",
    "orthogonality_error",
)  # fmt: skip


@pytest.mark.parametrize("save_every", [None, 3])
@pytest.mark.parametrize("measure_every", [1, 3, 4, 10, 17])
def test_measure_every_takes_maxima_over_its_steps_and_the_last(top, measure_every, save_every):
    full = run(*top, save_every=1, cspace="SO3xR3").history
    measured = np.unique([*range(0, STEPS, measure_every), STEPS])
    summary = run(*top, measure_every=measure_every, save_every=save_every, cspace="SO3xR3").summary
    for name in MAXIMA:
        expected = by_body(full, name)[measured].max(axis=0)
        np.testing.assert_array_equal(column(summary, f"{name}_max"), expected, err_msg=name)
    drift = np.abs(by_body(full, "energy_drift")[measured]).max(axis=0)
    np.testing.assert_array_equal(column(summary, "energy_drift_max"), drift)


def test_measure_every_matters_here(top):
    # else the test above could not fail: the largest error is at none of the steps 0, 4, 8, 10
    drift = np.abs(by_body(run(*top, save_every=1, cspace="SO3xR3").history, "position_error"))
    assert (drift.argmax(axis=0) % 4 != 0).any()


@pytest.mark.parametrize("one", ["save_every", "measure_every"])
def test_strides_may_be_numpy_integers(top, one):
    assert_same_bits(run(*top, **{one: np.int64(4)}).summary, run(*top, **{one: 4}).summary)


# ---------------------------------------------------------------- measures


def rotation(rng):
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return q * np.linalg.det(q)


def pose_of(R, r):
    C = np.eye(4)
    C[:3, :3], C[:3, 3] = R, r
    return C


def random_frames(rng, count=COUNT):
    return np.array([pose_of(rotation(rng), rng.normal(size=3)) for _ in range(count)])


def random_inertias(rng, count=COUNT):
    """Of clouds of points: physical by construction."""
    points = rng.normal(size=(count, 10, 3))
    squares = np.einsum("nki,nki->n", points, points)[:, None, None] * np.eye(3)
    return 0.01 * (squares - np.einsum("nki,nkj->nij", points, points))


def hat(a):
    return np.array([[0, -a[2], a[1]], [a[2], 0, -a[0]], [-a[1], a[0], 0]])


# Joints whose rows are of every kind; the twists and poses below violate all of them.
MEASURED = {
    "screw": lambda frames: joints.screw(pitch=np.linspace(0.1, 0.5, COUNT), **frames),
    "prismatic": lambda frames: joints.prismatic(**frames),
    "rows": lambda frames: joints.from_rows(["d1", "Qtd2", "Q32"], **frames),
}


def violated(name, cspace):
    """A batch with tilted frames, full inertias and states far from what the joint allows.

    Returns the problem and the state, as arguments of `run`.
    """
    rng = np.random.default_rng(list(MEASURED).index(name))
    joint = MEASURED[name]({"body_frame": random_frames(rng), "ground_frame": random_frames(rng)})
    masses, inertias = rng.uniform(1, 5, COUNT), random_inertias(rng)
    com = np.zeros((COUNT, 3)) if cspace == "SO3xR3" else 0.3 * rng.normal(size=(COUNT, 3))
    steiner = np.array([-m * hat(c) @ hat(c) for m, c in zip(masses, com, strict=True)])
    problem = lierb.Problem(
        lierb.Body(masses, inertias + steiner, com), joint, rng.normal(size=(COUNT, 3))
    )
    state = {"twist0": rng.normal(size=(COUNT, 6)), "pose0": random_frames(rng), "check": "off"}
    return problem, state


def row_errors(row, D, twist_at_point, omega, pitch):
    """(h, ḣ) of one row, from the design's definitions; h of an `Omega` row is None.

    twist_at_point: ḋ in ground joint axes.   omega: Ω in the body's joint axes.
    """
    Q, d = D[:3, :3], D[:3, 3]
    if row.symbol == "Omega":
        return None, omega[row.i]
    if row.symbol == "Q":
        return Q[row.i, row.j], (Q @ hat(omega))[row.i, row.j]
    if row.symbol == "Qtd":
        b = Q.T @ d
        return b[row.i], (Q.T @ twist_at_point - np.cross(omega, b))[row.i]
    if row.symbol == "d":
        return d[row.i], twist_at_point[row.i]
    slip = d[2] - pitch * np.arctan2(Q[1, 0], Q[0, 0])
    turn = 2 * np.pi * pitch
    return slip - turn * np.round(slip / turn), twist_at_point[2] - pitch * omega[2]


def axis_error(rows, Q):
    """Square of the rotation error of the `Omega` rows: about the axis left free, or about none."""
    fixed = [row.i for row in rows if row.symbol == "Omega"]
    if len(fixed) == 3:
        return 0.5 * ((Q**2).sum() - (np.diag(Q) ** 2).sum())
    if len(fixed) == 2:
        (axis,) = {0, 1, 2} - set(fixed)
        return sum(Q[i, axis] ** 2 for i in fixed)
    return 0.0


def measures_of(problem, i, state):
    """All columns of the history for body i, from its recorded state."""
    R, r, omega, v = state["rotation"].reshape(3, 3), state["position"], state["omega"], state["v"]
    joint, body = problem.joint, problem.body
    G, B = joint.ground_frame[i], joint.body_frame[i]
    pitch = np.broadcast_to(joint.pitch, COUNT)[i]
    D = np.linalg.inv(G) @ pose_of(R, r) @ B
    at_point = G[:3, :3].T @ R @ (v + np.cross(omega, B[:3, 3]))
    turning = B[:3, :3].T @ omega
    found = [(row, *row_errors(row, D, at_point, turning, pitch)) for row in joint.rows]
    position = [h for row, h, _ in found if row.is_translational]
    turned = [h for row, h, _ in found if row.symbol == "Q"]
    turning_rates = [x for row, _, x in found if not row.is_translational]
    m, inertia, c, g = body.mass[i], body.inertia[i], body.com[i], problem.gravity[i]
    kinetic = 0.5 * omega @ inertia @ omega + m * omega @ np.cross(c, v) + 0.5 * m * v @ v
    return {
        "position_error": np.linalg.norm(position),
        "rotation_error": np.sqrt(sum(h * h for h in turned) + axis_error(joint.rows, D[:3, :3])),
        "velocity_error": np.linalg.norm([x for row, _, x in found if row.is_translational]),
        "rotation_rate_error": np.linalg.norm(turning_rates),
        "energy": kinetic - m * g @ (r + R @ c),
    }  # fmt: skip


# Everything below is of size 0.1 to 30 and rounded some dozen times on either side, in other frames
# and in another order: 1e-13 relative to what is added up, 1e-12 where the energy (30 J) cancels.
MEASURE_TOLERANCES = {
    "position_error": 1e-13, "rotation_error": 1e-13, "velocity_error": 1e-13,
    "rotation_rate_error": 1e-13, "energy": 1e-12,
}  # fmt: skip


@pytest.mark.parametrize("cspace", tiered(["SE3", "SO3xR3"], ["SE3"], []))
@pytest.mark.parametrize("name", tiered(MEASURED, ["screw"], ["rows"]))
def test_measures_follow_from_the_recorded_state(name, cspace):
    problem, given = violated(name, cspace)
    result = run(problem, **given, cspace=cspace, save_every=3, record=(*RECORD, "energy"))
    assert result.summary["status"].to_pylist() == ["ok"] * COUNT
    table = result.history
    state = {name: by_body(table, name) for name in VECTOR}
    rows = len(state["rotation"])
    energies = by_body(table, "energy")
    for k, i in np.ndindex(rows, COUNT):
        expected = measures_of(problem, i, {name: state[name][k, i] for name in VECTOR})
        for measure, tolerance in MEASURE_TOLERANCES.items():
            got = by_body(table, measure)[k, i]
            assert got == pytest.approx(expected[measure], rel=0, abs=tolerance), (measure, k, i)
    # the very same subtraction
    np.testing.assert_array_equal(by_body(table, "energy_drift"), energies - energies[0])


@pytest.mark.parametrize("name", slow_but(MEASURED, "screw"))
def test_measured_states_violate_what_they_shall(name):
    # else the test above would compare zeros with zeros
    problem, given = violated(name, "SE3")
    table = run(problem, **given, save_every=3, record=RECORD).history
    for measure in ("position_error", "rotation_error", "velocity_error", "rotation_rate_error"):
        assert by_body(table, measure).min() > 1e-3, measure


@pytest.mark.parametrize("cspace", tiered(["SE3", "SO3xR3"], ["SE3"], []))
def test_orthogonality_error_follows_from_the_recorded_rotation(cspace):
    problem, given = violated("screw", cspace)
    # rotations stretched by what still passes for rounding of whoever made them
    given["pose0"][:, :3, :3] *= 1 + 5e-11 * np.arange(1, COUNT + 1)[:, None, None]
    table = run(problem, **given, cspace=cspace, save_every=3, record=RECORD).history
    R = by_body(table, "rotation").reshape(-1, COUNT, 3, 3)
    expected = np.linalg.norm(R.swapaxes(-1, -2) @ R - np.eye(3), axis=(-2, -1))
    assert expected.max() < 1e-14  # put right at the start, by making a quaternion of it
    # 3e-15: nine products near 1, on rotations in other frames
    np.testing.assert_allclose(by_body(table, "orthogonality_error"), expected, rtol=0, atol=3e-15)


# ---------------------------------------------------------------- λ


def kkt(problem, i, state):
    """V̇ and λ of a joint with d₁ d₂ d₃ and any Ω rows, from Newton and Euler about the origin."""
    R, omega, v = state["rotation"].reshape(3, 3), state["omega"], state["v"]
    joint, body = problem.joint, problem.body
    G, B = joint.ground_frame[i], joint.body_frame[i]
    m, inertia, c, g = body.mass[i], body.inertia[i], body.com[i], R.T @ problem.gravity[i]
    mass = np.block([[inertia, m * hat(c)], [-m * hat(c), m * np.eye(3)]])
    momentum_rate = np.cross(omega, v) + np.cross(omega, np.cross(omega, c))
    torque = -np.cross(omega, inertia @ omega) + m * np.cross(c, g - np.cross(omega, v))
    force = m * (g - momentum_rate)
    turn, p = G[:3, :3].T @ R, B[:3, 3]
    J = [np.hstack([-turn @ hat(p), turn])]
    eta = [-turn @ np.cross(omega, v + np.cross(omega, p))]
    for row in joint.rows[3:]:
        assert row.symbol == "Omega"
        J.append(np.hstack([B[:3, row.i], np.zeros(3)])[None])
        eta.append(np.zeros(1))
    J, eta = np.vstack(J), np.concatenate(eta)
    zero = np.zeros((len(J), len(J)))
    return np.linalg.solve(np.block([[mass, J.T], [J, zero]]), np.concatenate([torque, force, eta]))


@pytest.mark.parametrize(
    ("make", "cspace"),
    [(joints.revolute, "SE3"), pytest.param(joints.spherical, "SO3xR3", marks=pytest.mark.slow)],
)
def test_multipliers_solve_newton_and_euler(make, cspace):
    problem, given = violated("prismatic", cspace)
    joint = make(body_frame=problem.joint.body_frame, ground_frame=problem.joint.ground_frame)
    held = lierb.Problem(problem.body, joint, problem.gravity)
    twist0 = held.project(given["twist0"])
    table = run(held, twist0, cspace=cspace, save_every=3, record=RECORD).history
    got = by_body(table, "lambda")
    state = {name: by_body(table, name) for name in VECTOR}
    for k, i in np.ndindex(*got.shape[:2]):
        expected = kkt(held, i, {name: state[name][k, i] for name in VECTOR})[6:]
        # forces up to 1e2 N; a dense 11×11 solve with a condition number of about 1e3
        np.testing.assert_allclose(got[k, i], expected, rtol=0, atol=1e-11)


@pytest.mark.slow
def test_multiplier_at_rest_is_the_weight():
    body = lierb.Body(2.0, (1.0, 1.0, 1.0))
    problem = lierb.Problem(body, joints.spherical(), gravity=(0.0, 0.0, -9.81))
    table = run(problem, np.zeros(6), save_every=10, record="multipliers").history
    # the joint's force on the body is −Jᵀλ = +m g e₃: λ₃ = −2·9.81, one product
    np.testing.assert_allclose(column(table, "lambda"), [[0, 0, -19.62]] * 2, rtol=0, atol=4e-15)


# ---------------------------------------------------------------- shapes of the input


def test_one_body_gives_one_row(top):
    problem, twists = top
    single = run(problem, twists[0], save_every=5, record="state")
    assert single.summary.num_rows == 1
    assert single.history.num_rows == 3
    batch = run(problem, twists[:1], save_every=5, record="state")
    assert_same_bits(single.summary, batch.summary)
    assert_same_bits(single.history, batch.history, single.history.column_names)


def test_batch_gives_each_body_the_bits_that_it_has_alone(top):
    problem, twists = top
    together = run(problem, twists).summary
    for i in range(COUNT):
        alone = run(problem, twists[i]).summary
        names = [name for name in alone.column_names if name not in ("trajectory", "status")]
        assert_same_bits(alone, together.slice(i, 1), names)


@pytest.mark.parametrize("differs", ["mass", "gravity", "point"])
def test_bodies_that_differ_have_constants_of_their_own_in_every_block(top, differs):
    """What all bodies share is found once a thread, and must not be where they do not."""
    count = 3 * DEFAULT_LANES + 1
    scale = 1.0 + 0.1 * np.arange(count)
    given = {"mass": 6.075, "gravity": np.array([0, 0, -9.81]), "point": np.array(POINT)}

    def problem_of(scale):
        own = given | {differs: np.multiply.outer(scale, given[differs])}
        body = lierb.Body(own["mass"], np.diag(BOX))
        return lierb.Problem(body, joints.spherical(own["point"]), own["gravity"])

    omega = top[1][0, :3]
    problem = problem_of(scale)
    together = run(problem, problem.joint.twist(omega=omega)).summary
    names = [name for name in together.column_names if name not in ("trajectory", "status")]
    for i in (1, DEFAULT_LANES, count - 1):
        one = problem_of(scale[i])
        assert_same_bits(
            run(one, one.joint.twist(omega=omega)).summary, together.slice(i, 1), names
        )


@pytest.mark.parametrize(
    "batched", ["mass", "inertia", "gravity", "joint", "pose0", "pitch", "everything"]
)
def test_batched_argument_equals_a_shared_one(batched):
    def many(value, name):
        value = np.asarray(value, dtype=float)
        return np.tile(value, (2, *(1,) * value.ndim)) if batched in (name, "everything") else value

    inertia = many(np.diag(BOX), "inertia")
    body = lierb.Body(many(6.075, "mass"), inertia if inertia.ndim == 3 else inertia[None])
    point, axis = many(POINT, "joint"), (1.0, 2.0, -0.5)
    joint = joints.screw(point, axis=axis, pitch=many(0.2, "pitch"))
    problem = lierb.Problem(body, joint, many((0, 0, -9.81), "gravity"))
    single = joints.screw(POINT, axis=axis, pitch=0.2)
    pose0 = many(single.closed_pose, "pose0")
    twist0 = many(single.twist((0.5, 1.0, -0.25), np.array(axis) * 0.1), "everything")
    # the twist is none that the joint allows
    given = {"check": "off", "save_every": STEPS, "record": RECORD}
    result = run(problem, twist0, pose0=pose0, **given).summary
    shared = lierb.Problem(lierb.Body(6.075, np.diag(BOX)), single, (0, 0, -9.81))
    alone = run(shared, single.twist((0.5, 1.0, -0.25), np.array(axis) * 0.1), **given)
    assert result.num_rows == 2
    names = [name for name in result.column_names if name not in ("trajectory", "status")]
    for i in range(2):
        assert_same_bits(result.slice(i, 1), alone.summary, names)


@pytest.mark.parametrize("count", [None, 3])
def test_pose_may_be_scipys(top, count):
    transform = pytest.importorskip("scipy.spatial.transform")
    problem, twists = top
    rng = np.random.default_rng(7)
    R = rotation(rng) if count is None else np.array([rotation(rng) for _ in range(count)])
    turned = transform.RigidTransform.from_components(-R @ POINT, transform.Rotation.from_matrix(R))
    given = run(problem, twists[0], pose0=turned).summary
    assert given.num_rows == (count or 1)
    assert_same_bits(given, run(problem, twists[0], pose0=turned.as_matrix()).summary)


def test_pose_may_be_scipys_rotation(top):
    transform = pytest.importorskip("scipy.spatial.transform")
    turned = transform.Rotation.from_rotvec((0.1, 0.2, 0.3))
    problem = lierb.Problem(lierb.Body(6.075, BOX), joints.spherical())
    given = run(problem, (1, 2, 3, 0, 0, 0), pose0=turned).summary
    C = pose_of(turned.as_matrix(), (0, 0, 0))
    assert_same_bits(given, run(problem, (1, 2, 3, 0, 0, 0), pose0=C).summary)


def test_lists_and_integers_are_numbers_too(top):
    # with all of gravity, a step of 1 s overflows
    problem = lierb.Problem(top[0].body, top[0].joint, gravity=[0, 0, -0.01])
    given = run(problem, [0, 0, 0, 0, 0, 0], dt=1, t_end=2)
    assert given.failed.size == 0
    assert_same_bits(given.summary, run(problem, np.zeros(6), dt=1.0, t_end=2.0).summary)


# ---------------------------------------------------------------- failure of one body


@pytest.fixture(scope="module")
def failing(top):
    """The batch, with a body that overflows, and without."""
    problem, twists = top
    sick = twists.copy()
    sick[2, :3] = 1e100  # its energy is finite, what it turns in a step means nothing
    given = {"save_every": 2, "record": (*RECORD, "energy"), "check": "off"}
    with pytest.warns(FailedTrajectoryWarning, match="1 non_finite"):
        failed = run(problem, sick, **given)
    return SimpleNamespace(sick=failed, well=run(problem, twists, **given))


def test_failed_body_gets_a_status_and_the_time(failing):
    summary = failing.sick.summary
    assert summary["status"].to_pylist() == ["ok", "ok", "non_finite", "ok", "ok"]
    assert column(summary, "t").tolist() == [STEPS * DT] * 2 + [DT] + [STEPS * DT] * 2


def test_failed_body_has_no_state_but_finite_maxima(failing):
    summary = failing.sick.summary
    for name in [*VECTOR, "position_error_final", "rotation_error_final", "work_final"]:
        assert np.isnan(column(summary, name)[2]).all(), name
    for name in [f"{measure}_max" for measure in (*MAXIMA, "energy_drift")]:
        assert np.isfinite(column(summary, name)[2]), name


def test_failed_body_is_nan_in_the_history_from_then_on(failing):
    table = failing.sick.history
    for name in set(table.column_names) - {"trajectory", "step", "t"}:
        assert np.isnan(by_body(table, name)[1:, 2]).all(), name
    assert np.isfinite(by_body(table, "omega")[0]).all()


def test_failed_body_leaves_its_neighbours_bits(failing):
    others = [0, 1, 3, 4]
    for name in failing.well.history.column_names:
        sick, well = (by_body(r.history, name)[:, others] for r in (failing.sick, failing.well))
        np.testing.assert_array_equal(sick, well, err_msg=name)
    for i in others:
        names = [n for n in failing.well.summary.column_names if n != "status"]
        one, other = (r.summary.slice(i, 1) for r in (failing.sick, failing.well))
        assert_same_bits(one, other, names)


@pytest.mark.slow
def test_contradictory_rows_are_singular():
    # d₁ = 0 and (Qᵀd)₁ = 0 coincide at the closed pose; a point that moves while the body turns
    # needs two different accelerations
    joint = joints.from_rows(["d1", "Qtd1"])
    problem = lierb.Problem(lierb.Body(1.0, (1.0, 1.0, 1.0)), joint)
    moving, resting = (0, 0, 1.0, 0, 1.0, 0), (0, 0, 0, 0, 1.0, 0)
    twists = np.array([moving, resting])
    with pytest.warns(FailedTrajectoryWarning, match="2 singular"):
        summary = run(problem, twists, method="Euler", check="off").summary
    assert summary["status"].to_pylist() == ["singular", "singular"]
    # The one contradicts itself at once; the other leaves the place where the rows say the same.
    assert column(summary, "t").tolist() == [DT, 2 * DT]


@lierb.wrench
def lost(t, R, r, omega, v):
    return np.array([0.0, 0.0, lierb.where(t > 1.5 * DT, np.nan, 0.0)]), np.zeros(3)


@pytest.mark.long
def test_a_force_that_is_nan_contradicts_no_row():
    """Of a row in the Schur complement, and of a loop with rows that depend on others."""
    joint = joints.universal(body_point=(0.0, 0.0, 0.3))
    problem = lierb.Problem(lierb.Body(1.0, (1.0, 2.0, 2.5)), joint, forces=lost())
    twist = problem.project((0.1, 0.2, 0.3, 0.0, 0.0, 0.0))
    bars = four_bar()
    mechanism = lierb.Mechanism(bars.links, bars.loops, forces=lost().on("crank"))
    pose0 = mechanism.close(mechanism.pose({"crank": 1.0}))
    start = {"pose0": pose0, "twist0": mechanism.twist({}, pose0)}
    with pytest.warns(FailedTrajectoryWarning, match="non_finite"):
        found = [
            run(problem, twist, method="Euler", t_end=4 * DT),
            lierb.integrate(mechanism, **start, dt=DT, t_end=4 * DT, method="Euler"),
        ]
    for result in found:
        assert result.summary["status"].to_pylist() == ["non_finite"]
        assert column(result.summary, "t").tolist() == [3 * DT]


# ---------------------------------------------------------------- metadata


def provenance(table):
    return json.loads(table.schema.metadata[b"lierb"])


def test_metadata_names_versions_machine_and_lanes(top):
    told = provenance(run(*top).summary)
    assert told["lierb"] == lierb.__version__
    assert set(told) >= {"numba", "numpy", "python", "cpu", "platform", "lanes", "units"}
    assert told["lanes"] in (1, 2, 4, 8)
    assert told["units"].startswith("SI")


def test_metadata_is_the_same_in_both_tables(top):
    result = run(*top, save_every=5)
    assert result.summary.schema.metadata == result.history.schema.metadata


@pytest.mark.slow
def test_metadata_names_every_option(top):
    given = {
        "method": "Euler", "cspace": "SE3", "update": "local", "save_every": 5, "measure_every": 2,
        "record": ["state"], "check": "warn",
    }  # fmt: skip
    told = provenance(run(*top, **given).history)["options"]
    assert told.items() >= (given | {"dt": DT, "t_end": STEPS * DT}).items()


def run_again(told):
    """A run from nothing but the metadata of another one."""
    p, tableau = told["problem"], told["tableau"]
    frames = {name: p[name] for name in ("body_frame", "ground_frame", "pitch")}
    body = lierb.Body(p["mass"], p["inertia"], p["com"])
    joint = joints.from_rows(p["rows"], **frames)
    options = told["options"] | {"method": lierb.ButcherTableau(tableau["A"], tableau["b"])}
    return lierb.integrate(
        lierb.Problem(body, joint, p["gravity"]), twist0=p["twist0"], pose0=p["pose0"], **options
    )


def test_metadata_is_enough_to_run_again():
    problem, given = violated("screw", "SE3")
    # three bodies of the batch: short enough to be listed in full
    body = lierb.Body(problem.body.mass[:3], problem.body.inertia[:3], problem.body.com[:3])
    joint = joints.screw(
        pitch=problem.joint.pitch[:3],
        body_frame=problem.joint.body_frame[:3],
        ground_frame=problem.joint.ground_frame[:3],
    )
    given |= {"twist0": given["twist0"][:3], "pose0": given["pose0"][:3]}
    held = lierb.Problem(body, joint, problem.gravity[:3])
    once = run(held, **given, save_every=5, record=RECORD)
    again = run_again(provenance(once.summary))
    # decimal numbers in JSON come back to the last bit
    assert_same_bits(again.summary, once.summary)
    assert_same_bits(again.history, once.history, once.history.column_names)


def test_metadata_options_are_accepted_again(top):
    problem, twists = top
    told = provenance(run(problem, twists, save_every=5, record="energy").summary)
    # the solver told is the one that was found to fit, not the one asked for
    options = {name: value for name, value in told["options"].items() if name != "solver"}
    again = lierb.integrate(problem, twist0=twists, **options)
    assert provenance(again.summary) == told


@lierb.controller(every=0.1)
def shaky(omega):
    return {"torque": -omega + lierb.noise.normal("gyro", 3)}


@pytest.fixture
def nothing_steps(monkeypatch):
    """Lanes with clocks of their own: their tables, of zeros, and nothing compiled."""

    def integrate(plan, inputs, times, with_state, *_):
        output = engine.Output.empty(plan, inputs.count, times, with_state)
        for array in output.arrays.values():
            array.fill(0.0)
        return output

    monkeypatch.setattr(engine, "integrate", integrate)


@pytest.mark.usefixtures("nothing_steps")
@pytest.mark.parametrize(
    "given",
    [
        {"rtol": 1e-7},
        {"rtol": 1e-5, "atol": {"omega": 1e-3, "states": 0.0}, "dt": 1e-3, "method": "BS32"},
        {"atol": 1e-9, "dt_min": 1e-6, "dt_max": 0.1, "max_steps": 1000, "method": "Tsit5"},
        {"rtol": 1e-7, "save_at": (0.25, 0.5), "method": "DP54"},
        {"dt": 0.01, "save_every": 5, "seed": 7, "trajectories": (3, 1, 4, 1, 5)},
    ],
    ids=lambda given: ", ".join(given),
)
def test_metadata_options_of_adaptive_runs_are_accepted_again(given, top):
    problem, twists = top
    shaken = lierb.Problem(problem.body, problem.joint, problem.gravity, controllers=shaky())
    once = lierb.integrate(shaken, twist0=twists, t_end=0.5, **given)
    told = provenance(once.summary)
    options = {name: value for name, value in told["options"].items() if name != "solver"}
    again = provenance(lierb.integrate(shaken, twist0=twists, **options).summary)
    assert again == told
    assert given.keys() <= options.keys()
    tableau = lierb.ButcherTableau(**told["tableau"])  # which is as good as its name
    options["method"] = tableau
    again = provenance(lierb.integrate(shaken, twist0=twists, **options).summary)
    assert again["tableau"] == told["tableau"]


@pytest.mark.usefixtures("nothing_steps")
def test_steps_of_a_history_are_those_of_the_run(top):
    """With a clock for each lane, too."""
    problem, twists = top
    plain = run(problem, twists, save_every=3).history["step"]
    told = run(problem, twists, save_every=3, max_steps=STEPS).history["step"]
    assert told == plain


def test_metadata_of_a_large_batch_is_a_digest(top):
    problem, twists = top
    many = np.tile(twists, (200, 1))
    told = [
        provenance(run(problem, scale * many, t_end=DT).summary)["problem"]["twist0"]
        for scale in (1, 2)
    ]
    assert told[0]["shape"] == [1000, 6]
    assert told[0]["sha256"] != told[1]["sha256"]


def test_the_digest_of_a_start_is_that_of_its_bytes(top):
    """Of a large one, which is made beside the run, too."""
    problem, twists = top
    for count in (11, 1 << 14):
        many = np.linspace(0.5, 1.0, count)[:, None] * twists[0]
        told = provenance(run(problem, many, t_end=DT).summary)["problem"]["twist0"]
        digest = hashlib.sha256(many.tobytes()).hexdigest()
        assert told == {"shape": [count, 6], "sha256": digest}


def test_a_large_start_runs_where_no_thread_is_to_be_had(top, monkeypatch):
    """As at the end of a process, or beyond a limit of the system's."""
    problem, twists = top
    many = np.linspace(0.5, 1.0, 1 << 14)[:, None] * twists[0]
    beside = run(problem, many, t_end=DT).summary

    def none_left(thread):
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr(threading.Thread, "start", none_left)
    alone = run(problem, many, t_end=DT).summary
    assert provenance(alone) == provenance(beside)


def test_metadata_names_a_users_tableau(top):
    mine = lierb.ButcherTableau([[]], [1.0], name="mine")
    told = provenance(run(*top, method=mine).summary)
    assert told["options"]["method"] == "mine"
    assert told["tableau"] == {"A": [[]], "b": [1.0]}


# ---------------------------------------------------------------- memory


@pytest.fixture
def kept_output(monkeypatch):
    """The arrays that the driver wrote into, of each run."""
    kept = []
    original = engine.integrate

    def integrate(*arguments, **named):
        kept.append(original(*arguments, **named))
        return kept[-1]

    monkeypatch.setattr(engine, "integrate", integrate)
    return kept


def address(arrow_array):
    return arrow_array.buffers()[-1].address + 8 * arrow_array.offset


def test_history_columns_are_views_of_the_kernels_arrays(top, kept_output):
    table = run(*top, save_every=3, record=(*RECORD, "energy")).history
    (output,) = kept_output
    own = ("t", "work")  # no work is done here
    scalars = [f.name for f in table.schema if f.type == pa.float64() and f.name not in own]
    places = {array.ctypes.data for array in output.history}
    assert {address(table[name].chunk(0)) for name in scalars} == places
    for name, array in zip(VECTOR, output.states, strict=True):
        assert address(table[name].chunk(0).values) == array.ctypes.data
    assert address(table["lambda"].chunk(0).values) == output.multipliers.ctypes.data


def test_tables_outlive_the_run(top):
    table = run(*top, save_every=1, record="state").history
    before = by_body(table, "rotation").copy()
    for _ in range(3):  # would overwrite what Arrow only borrowed
        run(*top, save_every=1, record="state", method="RK4", cspace="SE3")
    np.testing.assert_array_equal(by_body(table, "rotation"), before)


class Unprintable:
    def __repr__(self) -> str:
        raise RuntimeError("no")


@pytest.mark.slow
def test_names_that_cannot_be_printed_are_refused():
    flight = lierb.Problem(lierb.bodies.sphere(0.1, mass=1.0), joints.free())
    result = lierb.integrate(flight, dt=0.1, t_end=0.2)
    with pytest.raises(UnknownNameError, match="is unknown"):
        result[Unprintable()]
