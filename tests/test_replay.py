"""`Dataset.replay`: one trajectory of a study again, with its problem and start."""

from __future__ import annotations

import numpy as np
import pytest
from studies import study

import lierb
from lierb.errors import ArgumentError, StudyError
from lierb.results.columns import as_array
from lierb.studies.dataset import Dataset
from lierb.studies.description.study import Study

RECORD = ["state", "energy", "multipliers", "reaction"]  # of a replay


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    given = study(sample={"n": 20}, integrate={"save_every": 10})
    lierb.run(given, folder := tmp_path_factory.mktemp("replay") / "out")
    return Dataset(folder)  # not read


def row_of(dataset, table, replay, number) -> dict:
    """The study's rows of that trajectory and setting, as lists by column."""
    own, rows = replay.setting, dataset.table(table).to_table().to_pylist()
    names = ("cspace", "method", own.column)
    setting = (own.cspace, own.method, own.step)
    chosen = [r for r in rows if (*(r[n] for n in names), r["trajectory"]) == (*setting, number)]
    return {name: [row[name] for row in chosen] for name in rows[0]}


def assert_is_the_studys(dataset, replay, number) -> None:
    stored, summary = row_of(dataset, "summary", replay, number), replay.result.summary
    assert stored["trajectory"] == [number]
    for name in summary.column_names:
        if name != "trajectory":
            assert summary[name].to_pylist() == stored[name], name


@pytest.mark.slow
@pytest.mark.parametrize("number", [0, 17])
def test_replay_is_the_studys_bit_for_bit(dataset, number):
    replay = dataset.replay(number, cspace="SO3xR3", dt=2e-3)
    assert (replay.setting.cspace, replay.setting.method, replay.setting.dt) == (
        "SO3xR3",
        "RK4",
        2e-3,
    )
    assert_is_the_studys(dataset, replay, number)
    stored, history = row_of(dataset, "history", replay, number), replay.result.history
    assert history.num_rows == 26  # each step and the start
    saved = np.isin(as_array(history["step"]), stored["step"])
    assert saved.sum() == len(stored["step"]) == 4
    for name in ("t", "position_error", "energy_drift", "velocity_error"):
        assert as_array(history[name])[saved].tolist() == stored[name], name
    assert {"lambda", "reaction", "energy", "rotation"} <= set(history.column_names)


def test_replay_has_the_problem_and_the_start_of_the_trajectory(dataset):
    """Integrated again by the user they give the same bits."""
    replay = dataset.replay(11, cspace="SE3", dt=1e-3)
    stored = row_of(dataset, "summary", replay, 11)
    assert [replay.problem.body.mass] == stored["sample.body.mass"]
    assert replay.twist0.shape == (6,)
    assert replay.twist0[:3].tolist() == stored["sample.initial.omega"][0]
    assert replay.pose0 is None  # the study gives none
    again = lierb.integrate(
        replay.problem, pose0=replay.pose0, twist0=replay.twist0, dt=1e-3, t_end=0.05,
        cspace="SE3", save_every=1, record=RECORD,
    )  # fmt: skip
    assert again.history.equals(replay.result.history)


def test_replay_saves_as_often_as_asked(dataset):
    replay = dataset.replay(3, cspace="SE3", dt=1e-3, save_every=25)
    assert as_array(replay.result.history["step"]).tolist() == [0, 25, 50]
    assert_is_the_studys(dataset, replay, 3)


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({}, r"several settings of the study fit; choose one of cspace='SE3', dt=0\.001; .*"),
        ({"dt": 1e-3}, r"several settings of the study with dt=0\.001; choose one of cspace='SE3'"),
        ({"dt": 5e-3}, r"no setting of the study with dt=0\.005; choose one of .*dt=0\.002"),
        ({"rtol": 1e-6}, r"no setting of the study with rtol=1e-06; choose one of"),
    ],
)
def test_replay_refuses_other_than_one_setting(dataset, given, told):
    with pytest.raises(ArgumentError, match=told):
        dataset.replay(0, **given)


@pytest.mark.parametrize("number", [-1, 20])
def test_replay_refuses_a_number_beyond_the_study(dataset, number):
    with pytest.raises(StudyError, match=f"no trajectory {number} in the study; it has 0 … 19"):
        dataset.replay(number, cspace="SE3", dt=1e-3)


@pytest.mark.parametrize("number", [1.0, "1", None])
def test_replay_refuses_what_is_no_number(dataset, number):
    with pytest.raises(ArgumentError, match=r"trajectory=.*; expected a whole number"):
        dataset.replay(number, cspace="SE3", dt=1e-3)


@pytest.mark.long
def test_replay_of_adaptive_steps_of_a_mechanism(tmp_path):
    """A pendulum of two links, its start by coordinates, in the study's one setting."""
    body = {"solid": "rod", "length": 0.3, "radius": 0.01, "density": 2700.0}
    joint = {"type": "revolute", "axis": [0.0, 1.0, 0.0]}
    links = [
        {"name": name, "body": body, "joint": joint, "parent": parent}
        for name, parent in (("upper", "ground"), ("lower", "upper"))
    ]
    given = Study.of({
        "problem": {"links": links, "gravity": [0.0, 0.0, -9.81]},
        "sample": {"n": 6, "upper": {"initial": {"coordinates": {
            "distribution": "uniform", "low": [0.5], "high": [1.5],
        }}}},
        "integrate": {"rtol": 1e-7, "t_end": 0.3},
    })  # fmt: skip
    dataset = lierb.run(given, tmp_path / "out")
    replay = dataset.replay(4)
    assert_is_the_studys(dataset, replay, 4)
    angle = replay.problem.coordinates(replay.pose0)["upper"]
    drawn = row_of(dataset, "summary", replay, 4)["sample.upper.initial.coordinates"]
    # Coordinates are made of the pose's rotation by arctan2: a few roundings.
    np.testing.assert_allclose(np.squeeze(angle), np.squeeze(drawn), rtol=0, atol=1e-15)
    assert replay.twist0["lower"].shape == (6,)
    assert replay.result.t[[0, -1]].tolist() == [0.0, 0.3]
    assert replay.result.history.num_rows == 1001


def test_replay_of_a_study_with_one_setting_names_it(tmp_path):
    given = study(sample={"n": 2}, integrate={"cspace": "SE3", "dt": 1e-3})
    dataset = lierb.run(given, tmp_path / "out")
    only = (
        r"no setting of the study with dt=0\.0001; the only one is cspace='SE3', method='RK4', dt="
    )
    with pytest.raises(ArgumentError, match=only):
        dataset.replay(0, dt=1e-4)
    assert dataset.replay(0).trajectory == 0
