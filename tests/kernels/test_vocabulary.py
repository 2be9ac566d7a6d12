"""Functions that lierb offers to functions of the user's, on plain arrays: any batch shape."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import lierb

VECTORS = np.random.default_rng(3).uniform(-1.7, 1.7, (2, 5, 3))  # ‖ξ‖ < π
MATRICES = lierb.lie.so3.exp(VECTORS)


def test_log_inverts_exp():
    assert lierb.log(MATRICES).shape == (2, 5, 3)
    # the largest angle is 2.9 rad: a few roundings
    np.testing.assert_allclose(lierb.log(MATRICES), VECTORS, atol=1e-14)


def test_quaternion_is_scipys():
    found = lierb.quaternion(MATRICES)
    turned = Rotation.from_matrix(MATRICES.reshape(-1, 3, 3))
    wanted = turned.as_quat(canonical=True, scalar_first=True).reshape(2, 5, 4)
    # a few roundings, here and in SciPy's matrices
    np.testing.assert_allclose(found, wanted, atol=4e-15)
    np.testing.assert_allclose(lierb.quaternion(turned).reshape(2, 5, 4), wanted, atol=4e-15)
    assert (found[..., 0] >= 0.0).all()


def test_half_turns_have_one_quaternion_and_one_vector():
    for axis in np.eye(3):
        turn = 2.0 * np.outer(axis, axis) - np.eye(3)
        np.testing.assert_array_equal(np.abs(lierb.quaternion(turn)), [0.0, *axis])
        np.testing.assert_allclose(np.abs(lierb.log(turn)), np.pi * axis, rtol=1e-15)


def test_table_and_clip_are_numpys():
    x, (xs, ys) = VECTORS, (np.array([-1.0, 0.0, 0.25, 1.0]), np.array([2.0, -1.0, 3.0, 0.5]))
    np.testing.assert_array_equal(lierb.table(x, xs, ys), np.interp(x, xs, ys))
    np.testing.assert_array_equal(lierb.table(x, tuple(xs), list(ys)), np.interp(x, xs, ys))
    np.testing.assert_array_equal(lierb.clip(x, -0.5, 0.5), np.clip(x, -0.5, 0.5))
    np.testing.assert_array_equal(lierb.where(x > 0.0, x, -x), np.abs(x))
    np.testing.assert_array_equal(lierb.where(x > 0.0, 1.0, -1.0), np.sign(x))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: lierb.table(0.5, (0.0, 0.0), (1.0, 2.0)), "xs must increase"),
        (
            lambda: lierb.table(0.5, (0.0, 1.0), (1.0,)),
            r"shapes \(2,\) and \(1,\); expected \(n,\)",
        ),
        (lambda: lierb.log(np.eye(4)), r"R has shape \(4, 4\); expected \(…, 3, 3\)"),
    ],
)
def test_wrong_arguments_are_told(call, message):
    with pytest.raises(ValueError, match=message):
        call()


def test_a_wrong_table_is_told_with_its_line():
    @lierb.wrench
    def push(t, R, r, omega, v, params):
        return lierb.table(t, (0.0, 0.0), (1.0, 2.0)) * r, r

    message = r'push cannot be compiled: line \d+, "return lierb\.table.*": a table.s xs must'
    with pytest.raises(lierb.errors.ForceError, match=message):
        push()
