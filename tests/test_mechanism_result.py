"""Results of mechanisms: the state link by link, data frames, and runs that go on."""

from __future__ import annotations

import pickle
import re

import numpy as np
import pytest
from mechanisms.shared import double_pendulum

import lierb
from lierb.errors import ArgumentError, UnknownNameError
from lierb.model.functions.column_names import COMPONENTS
from lierb.results.columns import as_array, numbers

LINKS = ("upper", "lower")
STATE = {"rotation": (3, 3), "position": (3,), "omega": (3,), "v": (3,)}
COUNT, STEPS, DT = 3, 20, 1e-2
TIMES = 5
RECORD = ("state", "energy", "multipliers", "reaction")


def run(steps: int = STEPS, **given) -> lierb.Result:
    pendulum = double_pendulum()
    pose0 = pendulum.pose({"upper": np.linspace(0.3, 1.0, COUNT), "lower": 0.2})
    start = {"pose0": pose0, "twist0": pendulum.twist({"upper": 1.0}, pose0)}
    return lierb.integrate(pendulum, **(start | {"dt": DT, "t_end": steps * DT} | given))


@pytest.fixture(scope="module")
def result() -> lierb.Result:
    return run(save_every=5, record=RECORD)


@pytest.mark.parametrize("link", LINKS)
@pytest.mark.parametrize("name", STATE)
def test_state_of_a_link_is_that_of_its_columns(result, link, name):
    found = getattr(result[link], name)
    assert found.shape == (TIMES, COUNT, *STATE[name])
    columns = as_array(result.history[f"{link}.{name}"])
    np.testing.assert_array_equal(found.reshape(TIMES * COUNT, -1), columns)
    end = lierb.Result(result.summary, None)[link]
    np.testing.assert_array_equal(getattr(end, name), found[-1])


def test_link_turns_by_its_quaternion(result):
    from scipy.spatial.transform import Rotation

    found = Rotation.from_quat(result["lower"].quaternion[:, 0], scalar_first=True).as_matrix()
    np.testing.assert_allclose(found, result["lower"].rotation[:, 0], rtol=0, atol=1e-15)
    assert result["lower"].t.tolist() == result.t.tolist()


@pytest.mark.parametrize("name", [*STATE, "quaternion"])
def test_state_of_a_mechanism_names_its_links(result, name):
    with pytest.raises(ArgumentError, match=re.escape(f"result['lower'].{name}")):
        getattr(result, name)


def test_unknown_links_are_named(result):
    with pytest.raises(UnknownNameError, match="Did you mean 'lower'"):
        result["lowr"]
    with pytest.raises(
        UnknownNameError, match="link or column=0 is unknown; choose from upper, lower"
    ):
        result[0]
    flight = lierb.Problem(lierb.bodies.sphere(0.1, mass=1.0), lierb.joints.free())
    alone = lierb.Result(
        lierb.integrate(flight, twist0=np.zeros(6), dt=1.0, t_end=1.0).summary, None
    )
    with pytest.raises(UnknownNameError, match="column='body' is unknown; choose from trajectory"):
        alone["body"]


def test_columns_are_arrays_of_the_history_or_the_summary(result):
    angles = result["lower.omega"]
    assert angles.shape == (*result["lower"].omega.shape,)
    np.testing.assert_array_equal(angles, result["lower"].omega)
    assert result["status"].tolist() == ["ok"] * result.summary.num_rows
    expected = result.summary["energy_drift_max"].to_pylist()
    np.testing.assert_array_equal(result["energy_drift_max"], expected)


def test_data_frames_have_a_column_for_each_component(result):
    frame = result.to_pandas("history")
    for link in LINKS:
        for name in STATE:
            columns = [f"{link}.{name}_{part}" for part in COMPONENTS[name]]
            values = as_array(result.history[f"{link}.{name}"])
            np.testing.assert_array_equal(frame[columns].to_numpy(), values)
        assert frame.attrs["units"][f"{link}.position_x"] == "m"
        assert frame.attrs["units"][f"{link}.reaction_torque_y"] == "N m"
    names = [name.lower() for name in frame.columns]  # SQL is blind to case
    assert len(set(names)) == len(names)


def test_links_and_loops_differ_where_case_is_ignored():
    ball = lierb.bodies.sphere(0.1, mass=1.0)
    links = [lierb.Link(name, ball, lierb.joints.free()) for name in ("rod", "Rod")]
    with pytest.raises(ArgumentError, match="two parts are named Rod, a link and a link"):
        lierb.Mechanism(links)


def test_result_shows_its_links(result):
    shown = repr(result)
    assert shown.startswith("lierb.Result: 3 trajectories of 2 links to t = 0.2 s (reduced, RK4")
    assert "result['upper'], result['lower']" in shown
    assert "errors, state, energy, work, lambda, reaction" in shown
    assert repr(result["upper"]).startswith(
        "lierb.results.states.LinkResult 'upper': 3 trajectories"
    )


def test_result_shows_the_joint_with_the_largest_error(result):
    """Errors as an absolute c-space has them, without the time to compile one."""
    drift = np.array([1e-9, 3e-7, 2e-8])
    summary = result.summary
    for name in ("position_error_max", "lower.position_error_max"):
        index = summary.column_names.index(name)
        summary = summary.set_column(index, summary.schema.field(name), numbers(drift))
    assert "position error 3e-07 m (lower)" in repr(lierb.Result(summary, None))


def test_pickled_result_has_its_links(result):
    again = pickle.loads(pickle.dumps(result))
    np.testing.assert_array_equal(again["lower"].v, result["lower"].v)
    link = pickle.loads(pickle.dumps(result["lower"]))
    np.testing.assert_array_equal(link.v, result["lower"].v)


@pytest.mark.parametrize("steps", [1, 7])
def test_end_of_a_mechanism_goes_on_to_the_bits_of_one_run(steps):
    whole, first = run(), run(steps)
    second = lierb.integrate(first._end.model, **first.end, dt=DT, t_end=STEPS * DT)
    for link in LINKS:
        for name in STATE:
            np.testing.assert_array_equal(
                getattr(second[link], name).view(np.int64),
                getattr(whole[link], name).view(np.int64),
            )
