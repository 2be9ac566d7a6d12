"""Results as arrays and data frames, and what is said of trajectories that failed."""

from __future__ import annotations

import os
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from cases import RECORD, integrate, top
from click.testing import CliRunner
from studies import TEXT, sorted_rows, study

import lierb
from lierb.cli import cli
from lierb.errors import (
    ArgumentError,
    FailedTrajectoryWarning,
    MissingExtraError,
    StiffStepWarning,
    UnknownNameError,
)
from lierb.model.functions.column_names import COMPONENTS
from lierb.results.columns import as_array, as_codes, numbers, texts, vectors
from lierb.results.failures import REMEDIES, STATUS_NAMES, SUCCESSES, Failures

COUNT, STEPS, DT = 5, 6, 1e-2
TIMES = 4  # steps 0, 2, 4, 6
TESTS = Path(__file__).parent
STATE = {"rotation": (3, 3), "position": (3,), "omega": (3,), "v": (3,)}


def run(count=COUNT, **given):
    problem, twist0 = top()
    twists = np.linspace(0.2, 1.0, count)[:, None] * twist0
    options = {"dt": DT, "t_end": STEPS * DT, "save_every": 2} | given
    return integrate(problem, twist0=twists, **options)


@pytest.fixture(scope="module")
def result():
    return run()


@pytest.fixture(scope="module")
def final(result):
    """Result as if no state had been recorded."""
    names = [name for name in result.history.column_names if name not in STATE]
    return lierb.Result(result.summary, result.history.select(names))


def listed(table, name):
    return np.array(table[name].to_pylist())


# ---- arrays ------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", STATE)
def test_arrays_are_of_the_history_that_has_the_state(result, name):
    array = getattr(result, name)
    assert array.shape == (TIMES, COUNT, *STATE[name])
    flat = listed(result.history, name).reshape(array.shape)
    np.testing.assert_array_equal(array, flat)
    for row in (0, COUNT + 1, TIMES * COUNT - 1):  # time-major
        k, i = divmod(row, COUNT)
        assert result.history["trajectory"][row].as_py() == i
        assert result.history["t"][row].as_py() == result.t[k]
        np.testing.assert_array_equal(array[k, i].reshape(-1), result.history[name][row].as_py())


@pytest.mark.parametrize("name", STATE)
def test_arrays_are_of_the_end_without_a_state_in_the_history(final, name):
    for given in (final, lierb.Result(final.summary, None)):
        array = getattr(given, name)
        assert array.shape == (COUNT, *STATE[name])
        np.testing.assert_array_equal(array.reshape(COUNT, -1), listed(final.summary, name))


def test_times_are_those_of_the_state(result, final):
    np.testing.assert_array_equal(result.t, np.array([0, 2, 4, 6]) * DT)
    np.testing.assert_array_equal(final.t, np.full(COUNT, STEPS * DT))


@pytest.mark.parametrize("name", ["t", *STATE])
def test_arrays_are_the_tables_memory_which_nobody_writes_to(result, final, name):
    for given, table in ((result, result.history), (final, final.summary)):
        array = getattr(given, name)
        column = table[name].chunk(0)
        buffer = (column.flatten() if name != "t" else column).buffers()[1]
        assert array.__array_interface__["data"][0] == buffer.address
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0.0


def test_a_batch_of_one_keeps_its_axis():
    one = run(1)
    assert one.t.shape == (TIMES,)
    assert one.position.shape == (TIMES, 1, 3)
    assert one.rotation.shape == (TIMES, 1, 3, 3)
    assert lierb.Result(one.summary, None).quaternion.shape == (1, 4)


def turned_result(rotations):
    """A result whose trajectories end with these rotations."""
    flat = np.ascontiguousarray(rotations).reshape(-1, 9)
    return lierb.Result(pa.table({"rotation": vectors(flat)}), None)


def test_quaternion_is_scipys(result):
    """All angles are included, also half turns, where w = 0 and another component is largest."""
    transform = pytest.importorskip("scipy.spatial.transform")
    rng = np.random.default_rng(5)
    half_turns = np.pi * np.concatenate((np.eye(3), [[0.6, 0.8, 0.0], [0.6, 0.0, 0.8]]))
    turns = np.concatenate((rng.normal(size=(200, 3)) * rng.uniform(0, 6, (200, 1)), half_turns))
    rotations = transform.Rotation.from_rotvec(turns)
    quaternion = turned_result(rotations.as_matrix()).quaternion
    expected = rotations.as_quat(scalar_first=True)
    assert (quaternion[:, 0] >= 0.0).all()
    # p and −p are one rotation; some of each sign come out of SciPy
    aligned = expected * np.sign((quaternion * expected).sum(axis=1))[:, None]
    # SciPy's matrix and back: a few roundings of numbers up to 1
    np.testing.assert_allclose(quaternion, aligned, rtol=0, atol=2e-15)
    assert result.quaternion.shape == (TIMES, COUNT, 4)
    along = transform.Rotation.from_matrix(result.rotation[-1]).as_quat(
        canonical=True, scalar_first=True
    )
    np.testing.assert_allclose(result.quaternion[-1], along, rtol=0, atol=2e-15)


def test_chunked_and_sliced_columns_become_arrays():
    """Tables of several chunks, as read from files; those of `integrate` have one."""
    array = np.arange(12.0).reshape(4, 3)
    chunks = pa.chunked_array([vectors(array).slice(1, 2), vectors(array)])
    np.testing.assert_array_equal(as_array(chunks), np.concatenate((array[1:3], array)))
    sliced = pa.chunked_array([numbers(np.arange(6)).slice(2, 3)])
    assert as_array(sliced).tolist() == [2, 3, 4]
    parts = [texts(["ok", "ok"]).dictionary_encode(), texts(["bad", "ok"]).dictionary_encode()]
    codes, names = as_codes(pa.chunked_array(parts))
    assert [names[code] for code in codes] == ["ok", "ok", "bad", "ok"]
    assert as_codes(pa.chunked_array([texts(["b", "a", "b"])]))[1] == ["b", "a"]


@pytest.mark.slow
def test_arrays_need_no_pandas():
    """Arrow's own `to_numpy` imports it where it is installed: 0.2 s of a process."""
    code = """
import sys, lierb
from cases import RECORD, integrate, top
problem, twist0 = top()
result = integrate(problem, twist0=twist0, dt=1e-2, t_end=0.06, save_every=2)
repr(result), result.t, result.position, result.quaternion, result.failed
sys.exit({"pandas", "polars"} & set(sys.modules) or 0)
"""
    paths = os.pathsep.join(map(str, (TESTS, TESTS.parent)))
    environment = os.environ | {"PYTHONPATH": paths}
    subprocess.run([sys.executable, "-c", code], check=True, env=environment)


# ---- data frames -------------------------------------------------------------------------------


@pytest.mark.parametrize("table", ["summary", "history"])
def test_pandas_has_a_column_for_each_component(result, table):
    pytest.importorskip("pandas")
    frame, given = result.to_pandas(table), getattr(result, table)
    assert len(frame) == given.num_rows
    expected = {}
    for name in given.column_names:
        values = listed(given, name)
        if values.ndim == 1:
            expected[name] = values
        else:
            endings = COMPONENTS.get(name, [str(i + 1) for i in range(values.shape[1])])
            for i, ending in enumerate(endings):
                expected[f"{name}_{ending}"] = values[:, i]
    assert list(frame.columns) == list(expected)
    for name, values in expected.items():
        np.testing.assert_array_equal(frame[name], values, err_msg=name)
        assert frame[name].dtype != object


def test_pandas_names_and_units(result):
    pytest.importorskip("pandas")
    frame = result.to_pandas("history")
    last = frame.iloc[-1]
    assert [last[f"position_{i}"] for i in "xyz"] == result.position[-1, -1].tolist()
    assert last["rotation_xy"] == result.rotation[-1, -1, 0, 1]
    assert last["rotation_yx"] == result.rotation[-1, -1, 1, 0]
    units = frame.attrs["units"]
    assert units["t"] == "s"
    assert units["v_y"] == "m/s"
    assert units["reaction_torque_z"] == "N m"
    assert units["reaction_force_x"] == "N"
    assert units["lambda_3"] == "N"
    assert set(units) == set(frame.columns) - {"trajectory", "step"}


@pytest.mark.parametrize("table", ["summary", "history"])
def test_polars_has_what_pandas_has(result, table):
    pytest.importorskip("polars")
    pytest.importorskip("pandas")
    polars, pandas = result.to_polars(table), result.to_pandas(table)
    assert polars.columns == list(pandas.columns)
    for name in polars.columns:
        assert polars[name].to_list() == pandas[name].tolist(), name


@pytest.mark.parametrize("convert", ["to_pandas", "to_polars"])
def test_data_frames_say_what_they_lack(result, convert, monkeypatch):
    with pytest.raises(ArgumentError, match="save_every="):
        getattr(lierb.Result(result.summary, None), convert)("history")
    with pytest.raises(UnknownNameError, match="Did you mean 'history'"):
        getattr(result, convert)("histories")
    package = convert.removeprefix("to_")
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(MissingExtraError, match=rf"{package} data frame needs {package}"):
        getattr(result, convert)()


# ---- failures ----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def failing():
    """The third and the last of the batch overflow."""
    problem, twist0 = top()
    twists = np.linspace(0.2, 1.0, COUNT)[:, None] * twist0
    twists[[2, 4]] *= 1e100
    with pytest.warns(FailedTrajectoryWarning) as told:
        result = integrate(
            problem, twist0=twists, dt=DT, t_end=STEPS * DT, save_every=2, check="off"
        )
    return result, told


def test_a_failure_is_told_once_where_integrate_was_called(failing):
    result, told = failing
    assert len(told) == 1
    text = str(told[0].message)
    assert "2 of 5 trajectories failed (2 non_finite)" in text
    assert "the first is trajectory 2, non_finite at t = 0.01 s" in text
    assert result.summary["t"][2].as_py() == 0.01
    assert "smaller dt" in text
    assert REMEDIES["singular"] not in text
    assert told[0].filename.endswith("cases.py")  # whose `integrate` calls lierb's


def test_failed_lists_the_trajectories(failing, result):
    assert failing[0].failed.tolist() == [2, 4]
    assert result.failed.tolist() == []


def test_arrays_of_failed_trajectories_are_nan(failing):
    result, _ = failing
    for name in ("position", "rotation", "quaternion", "omega", "v"):
        array = getattr(result, name)
        assert np.isnan(array[1:, [2, 4]]).all(), name
        assert np.isfinite(array[:, [0, 1, 3]]).all(), name
    ends = lierb.Result(result.summary, None)
    assert ends.t.tolist() == [0.06, 0.06, 0.01, 0.06, 0.01]


def test_every_failure_has_a_remedy():
    assert set(REMEDIES) == set(STATUS_NAMES.values()) - set(SUCCESSES)


def test_one_trajectory_is_not_counted():
    problem, twist0 = top()
    with pytest.warns(FailedTrajectoryWarning, match="the trajectory failed: non_finite at t = "):
        integrate(problem, twist0=1e100 * twist0, dt=DT, t_end=STEPS * DT, check="off")


def test_of_failures_without_any_there_is_nothing_to_say(result):
    assert Failures.of(result.summary) is None
    assert Failures.joined([], 5) is None


def test_repr_tells_what_failed(failing, result):
    assert "2 of 5 trajectories failed (2 non_finite)" in repr(failing[0])
    assert "failed" in failing[0]._repr_html_()
    assert "status   all ok" in repr(result)
    assert "failed" not in repr(result)


def test_repr_tells_the_largest_errors_that_there_are_rows_for(result, failing):
    """A spherical joint has no rows for rotation: no zero is said to be kept."""
    drift = max(result.summary["energy_drift_max"].to_pylist())
    assert f"largest  position error 0 m, energy drift {drift:.2g} J" in repr(result)
    assert "rotation error" not in repr(result)
    ok = [0, 1, 3]
    drift = max(failing[0].summary["energy_drift_max"].to_numpy()[ok])
    assert f"energy drift {drift:.2g} J" in repr(failing[0])


def test_repr_tells_from_when_to_when():
    problem, twist0 = top()
    options = {"twist0": twist0, "dt": DT, "record": RECORD}
    begun = lierb.integrate(problem, **options, t_end=0.02, save_every=1)
    assert "1 trajectory to t = 0.02 s (SE3, RK4, dt = 0.01 s)" in repr(begun)
    options |= begun.end
    on = lierb.integrate(problem, **options, t_end=0.06, save_every=1)
    assert "1 trajectory from t = 0.02 s to 0.06 s" in repr(on)
    np.testing.assert_allclose(on.t, [0.02, 0.03, 0.04, 0.05, 0.06], rtol=1e-15)  # k·dt, rounded


# ---- failures of studies -----------------------------------------------------------------------

# Drag so strong that steps of a millisecond overflow, for some of the bodies.
DRAG = {"distribution": "log_normal", "median": 0.1, "sigma": 15.0}


def stiff(**changes):
    drawn = study().sample.model_dump(exclude_none=True)
    return study(sample=drawn | {"forces": {"drag": {"linear": DRAG}}}, **changes)


@pytest.fixture(scope="module")
def ran(tmp_path_factory):
    """A dataset with failures in it, and what was warned of while it was made."""
    folder = tmp_path_factory.mktemp("stiff") / "out"
    with (
        pytest.warns(FailedTrajectoryWarning) as told,
        pytest.warns(StiffStepWarning, match="drag"),
    ):
        dataset = lierb.run(stiff(), folder)
    return dataset, told


def failed_rows(folder):
    return [row for row in sorted_rows(folder) if row["status"] != "ok"]


def test_a_study_tells_of_its_failures_once(ran):
    dataset, told = ran
    failed = failed_rows(dataset.folder)
    assert 0 < len(failed) < 200
    assert len(told) == 1
    assert f"{len(failed)} of 200 trajectories failed" in str(told[0].message)
    assert told[0].filename == __file__


def test_failures_of_a_dataset_are_those_of_its_tables(ran):
    dataset, _ = ran
    failed = failed_rows(dataset.folder)
    found = dataset.failures()
    counts = {s: sum(row["status"] == s for row in failed) for s in found.counts}
    assert found.counts == counts
    assert found.count == len(failed)
    assert found.runs == dataset.trajectories == 200
    first = next(row for row in failed if (row["cspace"], row["dt"]) == ("SE3", 1e-3))
    assert (found.trajectory, found.t) == (first["trajectory"], first["t"])
    assert found.setting == "SE3, RK4, dt = 0.001 s"


def test_a_folder_that_is_read_again_tells_the_same(ran):
    again = type(ran[0])(ran[0].folder)
    again.read()
    assert again.failures() == ran[0].failures()


def test_a_stream_tells_at_its_end(ran):
    with pytest.warns(StiffStepWarning, match="drag") as before:
        reader = lierb.integrate_batches(stiff())
    assert [each.filename for each in before] == [__file__]
    with pytest.warns(FailedTrajectoryWarning) as told:
        rows = sum(batch.num_rows for batch in reader)
    assert rows == 200
    assert len(told) == 1
    assert str(ran[0].failures()) in str(told[0].message)


@pytest.mark.slow
def test_the_commands_end_with_failures_and_how_to_replay_one(ran, tmp_path):
    dataset, _ = ran
    (tmp_path / "study.toml").write_text(stiff().to_toml())
    commands = {
        tmp_path / "out": ["run", str(tmp_path / "study.toml"), "--out", str(tmp_path / "out")],
        dataset.folder: ["show", str(dataset.folder)],
    }
    for folder, command in commands.items():
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            done = CliRunner().invoke(cli, command)
        assert done.exit_code == 0, done.output
        assert told == []  # said in its own words instead
        lines = done.output.rstrip().splitlines()
        failures = dataset.failures()
        assert str(failures) in lines
        words = " ".join(done.output.split())
        assert ("stability bound of RK4 for drag" in words) is (command[0] == "run")
        assert lines[-1].startswith("  lierb run ")
        assert lines[-1].endswith(f"--out {folder} --only {failures.trajectory}")
    replayed = CliRunner().invoke(cli, lines[-1].split()[1:])
    assert replayed.exit_code == 0, replayed.output
    assert failures.status in replayed.output


def test_a_study_without_failures_says_nothing_of_them(tmp_path):
    (tmp_path / "study.toml").write_text(TEXT)
    command = ["run", str(tmp_path / "study.toml"), "--out", str(tmp_path / "out")]
    done = CliRunner().invoke(cli, command)
    assert done.exit_code == 0, done.output
    assert "trajectories failed" not in done.output
