"""SE(3) by unit quaternions against the same functions of matrices, in mpmath."""

import numpy as np
import oracle
from oracle import mp

from kernels.samples import configurations, norms, packed, reference, sweep, twists, unpacked
from lierb.kernels.groups import quaternion
from lierb.kernels.numbers.vec import dot
from lierb.kernels.numbers.zero import ZERO, is_zero


def charts():
    """`configurations` with quaternions."""
    return quaternion.from_pose(unpacked("se3", "g", configurations("se3")))


def matrices(chart):
    return packed("se3", "g", quaternion.pose(chart), np.shape(chart[1][0]))


def halves():
    return unpacked("se3", "x", 0.5 * sweep("se3"))


def test_a_pose_comes_back():
    assert abs(dot(charts()[0], charts()[0]) - 1.0).max() <= 5e-16
    assert abs(matrices(charts()) - configurations("se3")).max() <= 1e-15


def test_a_half_turn_has_a_quaternion():
    for axis in range(3):
        R = -np.eye(3)
        R[axis, axis] = 1.0
        p, _ = quaternion.from_pose((tuple(R.ravel()), (0.0, 0.0, 0.0)))
        assert np.array_equal(np.abs(p), np.eye(4)[1 + axis])
        assert np.array_equal(quaternion.matrix(p), R.ravel())


def test_compose_exp_sweep():
    left, X = configurations("se3"), sweep("se3")
    compose, exp = oracle.lie["se3"].compose, oracle.lie["se3"].exp
    expected = [oracle.to_float(compose(c, exp(x))) for c, x in zip(left.tolist(), X.tolist())]
    errors = abs(matrices(quaternion.compose_exp(charts(), halves())) - np.array(expected))
    # a dozen roundings of numbers up to 1; the displacement comes with up to 20 m
    scale = 1.0 + abs(left[:, :3, 3]).max(axis=1) + abs(X[:, 3:]).max(axis=1)
    assert np.max(errors[:, :3, :3]) <= 3e-15
    assert np.max(errors[:, :3, 3] / scale[:, None]) <= 3e-15


def test_small_steps_leave_the_length_alone():
    """Steps from one p differ by the rounding of the last sums, half an ulp each."""
    p, r = charts()
    X = twists(np.full(len(sweep("se3")), 1e-3), 6)
    moved, _ = quaternion.compose_exp((p, r), unpacked("se3", "x", 0.5 * X))
    assert abs(dot(moved, moved) - dot(p, p)).max() <= 6e-16


def test_dexpinv_sweep():
    X = sweep("se3")
    V = twists(np.ones(len(X)), 6, seed=2)
    k = quaternion.angle_coefficients(halves())
    found = packed("se3", "x", quaternion.dexpinv(halves(), unpacked("se3", "x", V), k), len(X))
    M = reference("se3", "dexpinv", sweep)
    expected = np.array([oracle.to_float(mp.matrix(m.tolist()) * mp.matrix(v.tolist()))
                         for m, v in zip(M, V)])  # fmt: skip
    # as for `lierb.lie`: terms may cancel, and there is a pole at 2π
    scale = np.max(abs(M) @ abs(V)[:, :, None], axis=(1, 2))
    errors = np.max(abs(found - expected), axis=1)
    assert np.all(errors * np.minimum(1.0, 2.0 * np.pi - norms(X)) <= 5e-15 * scale)


def test_vectors_are_rotated_as_by_the_matrix():
    R = configurations("se3")[:, :3, :3]
    x = np.random.default_rng(5).normal(size=(len(R), 3))
    p, _ = charts()
    k = quaternion.angle_coefficients(halves())
    there, back = np.einsum("nij,nj->in", R, x), np.einsum("nji,nj->in", R, x)
    # R = exp ξ of the sweep; a few roundings of numbers up to 4
    assert abs(quaternion.rotated(p, tuple(x.T)) - there).max() <= 5e-15
    assert abs(quaternion.rotated_back(p, tuple(x.T)) - back).max() <= 5e-15
    assert abs(quaternion.rotate(halves(), tuple(x.T), k) - there).max() <= 5e-15


def test_a_length_that_is_off_by_rounding_does_no_harm():
    p, r = charts()
    off = tuple(x * (1.0 + 1e-12) for x in p)
    R = matrices((off, r))[:, :3, :3]
    assert abs(np.swapaxes(R, 1, 2) @ R - np.eye(3)).max() <= 1e-15
    assert abs(dot(quaternion.normalised(off), quaternion.normalised(off)) - 1.0).max() <= 5e-16


def test_structural_zeros_stay():
    """About an axis, formulas of the whole group come down to those of the plane."""
    p, d = (0.6, ZERO, ZERO, 0.8), (1.0, 2.0, ZERO)
    (w, x, y, z), place = quaternion.compose_exp((p, d), (ZERO, ZERO, 0.1, 0.3, 0.4, ZERO))
    assert is_zero(x, y, place[2])
    assert not any(is_zero(number) for number in (w, z, *place[:2]))
    entries = quaternion.matrix(p)
    assert [is_zero(entry) for entry in entries] == [i in (2, 5, 6, 7) for i in range(9)]
    assert entries[8] == 1.0
