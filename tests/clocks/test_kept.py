"""The theorem under every clock and method: a subgroup joint on SE(3) is kept, whatever the step.

Every stage and every end of a step is a product of exponentials of elements of the subalgebra. The
saddle point solves for accelerations, so that nothing but the theorem keeps the joint.
"""

import numpy as np
import pytest
from cases import SUBGROUP_JOINTS, final, long_but, tilted

import lierb

ADAPTIVE = ("BS32", "DP54", "Tsit5", "Verner65", "Verner87", "Verner98", "DOP853")
COMMUTATOR_FREE = ("CF4", "CG3", "CG4")
QUICK = {("spherical", "DP54"), ("spherical", "CF4")}
BOUND = 1e-13  # m and 1, of motions of order one: some hundred roundings


def forms(methods):
    return [
        pytest.param(
            name, method, marks=() if (name, method) in QUICK else pytest.mark.long,
            id=f"{name}-{method}",
        )
        for name in SUBGROUP_JOINTS
        for method in methods
    ]  # fmt: skip


def kept(result: lierb.Result) -> None:
    assert result.summary["status"].to_pylist() == ["ok"]
    size = max(1.0, float(np.linalg.norm(final(result, "position"))))
    assert final(result, "position_error_max") < BOUND * size
    assert final(result, "rotation_error_max") < BOUND


@pytest.mark.slow
@pytest.mark.parametrize(("name", "method"), forms(ADAPTIVE))
def test_adaptive_steps_keep_a_subgroup_joint(name, method):
    problem, twist0 = tilted(name)
    result = lierb.integrate(
        problem, twist0=twist0, t_end=1.0, rtol=1e-3, method=method, solver="saddle"
    )
    kept(result)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "method"), forms(COMMUTATOR_FREE))
def test_commutator_free_steps_keep_a_subgroup_joint(name, method):
    problem, twist0 = tilted(name)
    result = lierb.integrate(
        problem, twist0=twist0, dt=2e-2, t_end=1.0, method=method, solver="saddle"
    )
    kept(result)


@pytest.mark.parametrize("method", long_but(["DP54", "CF4"]))
def test_so3xr3_does_not_keep_it(method):
    """Else the tests above could not fail: there the joint opens by the method's error."""
    problem, twist0 = tilted("spherical")
    clock = {"dt": 2e-2} if method == "CF4" else {"rtol": 1e-3}
    result = lierb.integrate(
        problem, twist0=twist0, t_end=1.0, method=method, cspace="SO3xR3", **clock
    )
    assert final(result, "position_error_max") > 1e-8
