"""A row with an unreliable number has a status that says so."""

from __future__ import annotations

import mpmath as mp
import numpy as np
import pytest
from cases import column, integrate, joint, tilted

import lierb
from lierb.errors import PoseError
from lierb.kernels.numbers.trigonometry import SINCOS_RANGE

# The statuses are looked at one by one here; tests/test_result.py has what is said of them.
pytestmark = pytest.mark.filterwarnings("ignore::lierb.errors.FailedTrajectoryWarning")

DT = 1e-2
FORMS = [
    {},
    pytest.param({"update": "global"}, marks=pytest.mark.slow),
    pytest.param({"cspace": "SO3xR3"}, marks=pytest.mark.slow),
    pytest.param({"cspace": "SO3xR3", "update": "global"}, marks=pytest.mark.slow),
]


def summary_of(problem, twist0, dt=DT, steps=2, **options):
    return integrate(problem, twist0=twist0, dt=dt, t_end=steps * dt, **options).summary


def is_told(summary) -> np.ndarray:
    """Indices of failed trajectories; all numbers of the others are finite."""
    failed = np.array(summary["status"].to_pylist()) == "non_finite"
    for field in summary.schema:
        if field.name not in ("trajectory", "status", "t"):
            numbers = column(summary, field.name)
            assert np.isfinite(numbers[~failed]).all(), field.name
            if not field.name.endswith("_max"):
                assert np.isnan(numbers[failed]).all(), field.name
    assert (column(summary, "orthogonality_error_max")[~failed] < 1e-12).all()
    return failed


@pytest.mark.parametrize("cspace", ["SE3", "SO3xR3"])
def test_errors_that_overflow_are_a_failure(cspace):
    """A point that flies off at 1e200 m/s: its error's square is no number any more."""
    problem, _ = tilted("spherical")
    speeds = 10.0 ** np.array((-3, 100, 140, 152, 156, 200, 300))
    twist0 = np.zeros((len(speeds), 6))
    twist0[:, 3] = speeds
    summary = summary_of(problem, twist0, cspace=cspace, check="off")
    failed = is_told(summary)
    assert not failed[0]
    assert failed[-3:].all()
    np.testing.assert_array_equal(column(summary, "t")[-3:], 0.0)  # seen in the start itself


def test_an_energy_that_overflows_is_a_failure():
    """A free body at 1e160 m/s moves as well as any, but has no energy that is a number."""
    speeds = 10.0 ** np.array((0, 150, 153, 155, 160, 300))
    twist0 = np.zeros((len(speeds), 6))
    twist0[:, 3] = speeds
    problem = lierb.Problem(lierb.Body(2.0, (0.5, 0.5, 0.5)), lierb.joints.free())
    failed = is_told(summary_of(problem, twist0))
    assert failed.tolist() == [False, False, False, True, True, True]


@pytest.mark.parametrize("options", FORMS, ids=str)
def test_a_step_turns_by_a_number_of_radians_or_fails(options):
    """Turns about an axis at a constant rate are right to the digits of their angle, or fail."""
    held = lierb.joints.revolute()
    problem = lierb.Problem(lierb.Body(2.0, (0.5, 0.5, 0.5)), held)
    angles = np.concatenate(
        [10.0 ** np.arange(-3, 18), SINCOS_RANGE * np.array((0.49, 0.98, 1.02))]
    )
    twist0 = np.zeros((len(angles), 6))
    twist0[:, 2] = angles / DT
    summary = summary_of(problem, twist0, steps=1, **options)
    failed = is_told(summary)
    assert not failed[angles < 0.99 * SINCOS_RANGE].any()
    assert failed[angles > 1.01 * SINCOS_RANGE].all()
    found = column(summary, "rotation")
    for angle, rate, r in zip(angles[~failed], twist0[~failed, 2], found[~failed], strict=True):
        turn = mp.mpf(DT) * mp.mpf(rate)
        cosine, sine = float(mp.cos(turn)), float(mp.sin(turn))
        exact = (cosine, -sine, 0.0, sine, cosine, 0.0, 0.0, 0.0, 1.0)
        # h·Ω and the sums of the method are rounded a dozen times
        np.testing.assert_allclose(r, exact, rtol=0, atol=4e-15 + 12 * 2.0**-53 * angle)


@pytest.mark.parametrize("entry", [1e155, 1e200, 1e308])
@pytest.mark.parametrize("place", [(0, 0), (1, 2), (slice(0, 3), slice(0, 3))])
def test_a_pose_of_huge_entries_is_no_rotation(entry, place):
    problem, twist0 = tilted("spherical")
    pose = np.array(joint("spherical").closed_pose)
    pose[place] = entry
    with pytest.raises(PoseError, match=r"the rotation of pose0 has ‖RᵀR − I‖ = .*expected a rot"):
        summary_of(problem, twist0, pose0=pose)
    with pytest.raises(PoseError, match="the rotation of ground_frame has"):
        joint("spherical", ground_frame=pose)
