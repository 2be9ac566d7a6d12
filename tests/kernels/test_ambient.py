"""Coordinates of an ambient step, against products of quaternions in NumPy, and mpmath."""

import numpy as np
import pytest
from oracle import mp

from kernels.samples import configurations, sweep, unpacked
from lierb.kernels.groups import ambient, ambientxr3, quaternion, quaternionxr3
from lierb.kernels.groups.increments import Ambient
from lierb.kernels.numbers.zero import ZERO, is_zero

RNG = np.random.default_rng(36)
ROUNDING = 1e-14  # some tens of operations on numbers of about 1


def product(a, b):
    """Product of quaternions (w, x, y, z)."""
    return np.r_[a[0] * b[0] - a[1:] @ b[1:], a[0] * b[1:] + b[0] * a[1:] + np.cross(a[1:], b[1:])]


def conjugate(a):
    return a * (1.0, -1.0, -1.0, -1.0)


def dual_product(a, b):
    return np.r_[product(a[:4], b[:4]), product(a[:4], b[4:]) + product(a[4:], b[:4])]


def rotation(u):
    """Matrix of the rotation x → u x ū/‖u‖²."""
    columns = [product(product(u, np.r_[0.0, x]), conjugate(u))[1:] for x in np.eye(3)]
    return np.column_stack(columns) / (u @ u)


def increments(size):
    """Random Y of this size, of quaternions far from unit length if it is large."""
    return size * RNG.normal(size=(20, 8))


def test_rate_is_the_product_with_the_twist():
    for y, twist in zip(increments(1.0), RNG.normal(size=(20, 6)), strict=True):
        one = np.r_[1.0, np.zeros(7)]
        expected = dual_product(one + y, np.r_[0.0, twist[:3], 0.0, twist[3:]])
        np.testing.assert_allclose(ambient.rate(tuple(y), tuple(twist)), expected, atol=ROUNDING)
        apart = ambientxr3.rate(tuple(y), tuple(twist))
        np.testing.assert_allclose(apart[:4], expected[:4], atol=ROUNDING)
        assert is_zero(apart[4])
        assert apart[5:] == tuple(twist[3:])


@pytest.mark.parametrize("size", [1e-9, 1e-3, 0.02, 0.5])
def test_compose_is_the_normalised_product(size):
    """The chart C₀ (1 + Y)/‖1 + Y‖, as matrices; d of a dual quaternion is 2 q p̄/‖p‖²."""
    for y, p, d in zip(increments(size), RNG.normal(size=(20, 4)), RNG.normal(size=(20, 3))):
        p /= np.linalg.norm(p)
        u, w = np.r_[1.0, 0.0, 0.0, 0.0] + y[:4], y[4:]
        turn = rotation(product(p, u))
        moved = d + rotation(p) @ (2.0 * product(w, conjugate(u))[1:] / (u @ u))
        chart = ambient.compose((tuple(p), tuple(d)), tuple(y))
        assert abs(np.dot(chart[0], chart[0]) - 1.0) <= 1e-15
        q, place = quaternion.pose(chart)
        np.testing.assert_allclose(np.reshape(q, (3, 3)), turn, atol=ROUNDING)
        np.testing.assert_allclose(place, moved, atol=ROUNDING)
        apart = ambientxr3.compose((tuple(p), tuple(d)), tuple(y))
        assert apart[0] == chart[0]
        np.testing.assert_allclose(apart[1], d + 2.0 * y[5:], atol=ROUNDING)


@pytest.mark.parametrize("charts", [ambient, ambientxr3])
def test_a_stage_has_a_proper_pose_at_any_length(charts):
    """Forces and rows see the pose of the chart that the step would end with."""
    for y in increments(0.5):
        chart = (0.6, 0.0, -0.8, 0.0), (1.0, 2.0, 3.0)
        step = Ambient.of(charts, tuple(y))
        q, place = step.pose(chart)
        expected, moved = quaternion.pose(step.moved(chart))
        np.testing.assert_allclose(q, expected, atol=ROUNDING)
        np.testing.assert_allclose(place, moved, atol=ROUNDING)
        turn = np.reshape(q, (3, 3)).T @ np.reshape(quaternion.matrix(chart[0]), (3, 3))
        x = (0.3, -0.2, 0.7)
        np.testing.assert_allclose(step.rotate_back(x), turn @ x, atol=ROUNDING)
        np.testing.assert_allclose(step.rotate(x), turn.T @ x, atol=ROUNDING)


def test_gravity_is_rotated_where_the_length_is_one():
    for v in RNG.normal(size=(20, 4)):
        u = v / np.linalg.norm(v)
        y = (u[0] - 1.0, *u[1:], *(ZERO,) * 4)
        for charts in (ambient, ambientxr3):
            fall = charts.fall(y, (1.0, -2.0, 3.0))
            np.testing.assert_allclose(fall, rotation(u).T @ (1.0, -2.0, 3.0), atol=ROUNDING)


@pytest.mark.parametrize(("charts", "exact"), [(ambient, quaternion), (ambientxr3, quaternionxr3)])
def test_compose_is_that_of_exp_on_the_group(charts, exact):
    """Y of exp X moves a chart as X does."""
    x = unpacked("se3", "x", 0.5 * sweep("se3"))
    chart = quaternion.from_pose(unpacked("se3", "g", configurations("se3")))
    identity = (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    with np.errstate(invalid="ignore"):
        (w, *v), d = exact.compose_exp(identity, x)
    half = tuple(0.5 * each for each in d)
    dual = (0.0 * w, *half)  # w = ½ d u
    if charts is ambient:
        dual = tuple(np.transpose([product(np.r_[0.0, a], b) for a, b in zip(
            np.transpose(half), np.transpose((w, *v)), strict=True)]))  # fmt: skip
    moved = charts.compose(chart, (w - 1.0, *v, *dual))
    expected = exact.compose_exp(chart, x)
    size = 1.0 + np.abs(np.array(expected[1])).max(axis=0)
    for found, true in zip((*moved[0], *moved[1]), (*expected[0], *expected[1]), strict=True):
        assert np.max(np.abs(found - true) / size) <= ROUNDING


def test_shrinking_sweep():
    """Around its cut-overs, and at lengths as far from one as a step of Euler's makes them."""
    sizes = np.concatenate([
        10.0 ** np.linspace(-17, 1, 200),
        *(cut * (1.0 + np.linspace(-1e-3, 1e-3, 21)) for cut in (ambient.TINY, ambient.SHORT)),
    ])  # fmt: skip
    for e in np.concatenate([sizes, -sizes[sizes < 0.9]]).tolist():
        true = 1 / mp.sqrt(1 + mp.mpf(e)) - 1
        # of a factor 1 + x, which is what it is for
        assert abs(ambient.shrinking(e) - true) <= min(3e-16, 5e-16 * abs(e)) + 1e-300 or (
            abs(e) > ambient.SHORT and abs(ambient.shrinking(e) - true) <= 3e-16
        )


def test_steps_of_many_turns_are_not_numbers():
    """As those by exponentials: Euler's step has e = θ²/4."""
    assert np.isfinite(ambient.shrinking(0.9 * 0.25e10))
    for e in (1.1 * 0.25e10, np.inf, np.nan):
        assert np.isnan(ambient.shrinking(e))


def test_structural_zeros_of_a_subgroup_stay():
    """Turns about and slides along one axis."""
    y = (-0.1, ZERO, ZERO, 0.3, 0.2, ZERO, ZERO, 0.5)
    rate = ambient.rate(y, (ZERO, ZERO, 2.0, ZERO, ZERO, 1.0))
    assert [is_zero(x) for x in rate] == [is_zero(x) for x in y]
    p, d = ambient.compose(((0.8, ZERO, ZERO, 0.6), (ZERO, ZERO, 1.0)), y)
    assert [is_zero(x) for x in (*p, *d)] == [False, True, True, False, True, True, False]
    still = ambient.compose(
        ((1.0, ZERO, ZERO, ZERO), (1.0, 2.0, 3.0)), (ZERO,) * 5 + (0.5, 0.0, 0.0)
    )
    assert still == ((1.0, ZERO, ZERO, ZERO), (2.0, 2.0, 3.0))
