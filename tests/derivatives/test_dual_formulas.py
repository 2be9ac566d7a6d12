"""Formulas of a step on dual numbers: exponentials with coefficients by the chain rule."""

from __future__ import annotations

import numpy as np
import pytest
from oracle import lie, to_float

from lierb.kernels.groups import quaternion
from lierb.kernels.groups.coefficients import half_angle_coefficients
from lierb.kernels.numbers.dual import Dual, parts_of, value_of, values

# Dense around the cut-overs, 0.0215, 0.1, 0.75 and π rad, and beyond.
ANGLES = (0.0, 1e-9, 1e-4, 0.0214, 0.0216, 0.099, 0.101, 0.74, 0.76, 2.0, 3.14, 3.15, 5.0)
UNIT_CHART = ((1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


@pytest.mark.parametrize("angle", ANGLES)
def test_exp_has_the_derivative_dexp(angle):
    axis = np.array((2.0, -1.0, 2.0)) / 3.0
    x = np.concatenate([angle * axis, (0.4, -0.3, 0.2)])
    directions = np.eye(6)
    half = tuple(Dual(0.5 * a, tuple(0.5 * directions[:, i])) for i, a in enumerate(x))
    chart = quaternion.compose_exp(UNIT_CHART, half)
    R, r = quaternion.pose(chart)
    turn, place = np.array(values(R)).reshape(3, 3), np.array(values(r))
    expected = to_float(lie["se3"].dexp(-x))  # C⁻¹∂C is dexp₋ₓ δX
    for j in range(6):
        moved = np.array([parts_of(a)[j] for a in R]).reshape(3, 3)
        spin = turn.T @ moved
        found = [spin[2, 1], spin[0, 2], spin[1, 0], *(turn.T @ [parts_of(a)[j] for a in r])]
        # series of a step are cut where a coefficient times its small angle is exact to rounding
        assert np.abs(found - expected[:, j]).max() < 2e-15 * (1.0 + np.abs(expected).max())
    assert np.abs(turn - to_float(lie["se3"].exp(x))[:3, :3]).max() < 1e-15
    assert place.shape == (3,)


@pytest.mark.parametrize("angle", ANGLES)
def test_the_chain_rule_leaves_values_as_they_are(angle):
    z = 0.25 * angle * angle
    plain = half_angle_coefficients(z)
    dual = half_angle_coefficients(Dual(z, (1.0, -2.0)))
    assert type(dual) is type(plain)
    assert [value_of(x) for x in dual] == [*plain]
    for x in dual:
        assert parts_of(x)[1] == -2.0 * parts_of(x)[0]
