"""Hostile arguments, drawn at random: see faults/arguments.py."""

import numpy as np
import pytest
from cases import RECORD, top
from faults.arguments import campaign

import lierb
from lierb.errors import ArgumentError, ForceError, TwistError

RUN = {"dt": 1e-2, "t_end": 0.2, "save_every": 1, "record": RECORD}


@pytest.mark.slow
def test_hostile_arguments_end_in_a_result_or_lierbs_own_error():
    outcomes = campaign(2000, seed=16)
    assert outcomes.total() == 2000
    assert outcomes["result"] > 200  # what is refused at the first door tests nothing behind it


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_many_hostile_arguments_end_in_a_result_or_lierbs_own_error(seed):
    assert campaign(2000, seed).total() == 2000


def test_progress_that_raises_leaves_the_next_run_as_it_was():
    problem, twist0 = top()
    before = lierb.integrate(problem, twist0=twist0, **RUN).history

    def stop(done, total):
        raise RuntimeError("enough")

    with pytest.raises(RuntimeError, match="enough"):
        lierb.integrate(problem, twist0=twist0, progress=stop, **RUN)
    assert lierb.integrate(problem, twist0=twist0, **RUN).history == before


def _driven(speed):
    body = lierb.Body(1.0, (1.0, 1.0, 1.0))
    return lierb.Problem(body, lierb.joints.revolute(), forces=[lierb.forces.motor(speed=speed)])


def test_motor_without_a_speed_at_the_start_is_told_as_such():
    """Such a function is none the worse from another time on."""
    driven = _driven(lambda t: 1.0 / t)
    with pytest.raises(TwistError, match=r"speed that motor prescribes is inf rad/s at t0=0 s"):
        driven.project(np.zeros(6))
    np.testing.assert_array_equal(driven.project(np.zeros(6), t0=2.0)[:3], (0.0, 0.0, 0.5))
    with pytest.raises(ForceError, match="division by zero"):
        lierb.forces.motor(speed=lambda t: t + 1 / 0)


@pytest.mark.slow
def test_motor_without_a_speed_at_some_time_runs_until_there():
    driven = _driven(lambda t: 1.0 / t)
    with pytest.raises(TwistError, match=r"motor prescribes is inf"):
        lierb.integrate(driven, twist0=np.zeros(6), dt=0.1, t_end=0.2)
    start = {"twist0": driven.project(np.zeros(6), t0=1.0), "t0": 1.0}
    later = lierb.integrate(driven, **start, dt=0.1, t_end=1.2)
    assert later.summary["status"].to_pylist() == ["ok"]
    np.testing.assert_allclose(later.omega[0], (0.0, 0.0, 1.0 / 1.2), rtol=1e-4)  # RK4, two steps
    with pytest.warns(lierb.errors.FailedTrajectoryWarning):
        at_once = lierb.integrate(driven, twist0=np.zeros(6), dt=0.1, t_end=0.2, check="off")
    assert at_once.summary["status"].to_pylist() == ["non_finite"]


@pytest.mark.parametrize("default", [[1, [2, 3]], "1.0", np.ma.masked, {1.0, 2.0}], ids=str)
def test_wrench_rejects_defaults_that_are_no_numbers(default):
    @lierb.wrench(anchor=default)
    def tether(t, R, r, omega, v, params):
        return (0.0, 0.0, 0.0), r - params.anchor

    with pytest.raises(ArgumentError, match=r"^anchor "):
        tether()
