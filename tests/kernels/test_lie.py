"""exp, inverse, compose, Ad, ad, dexp and dexp⁻¹ of every group against power series in mpmath.

Every entry's error is taken relative to the largest entry of its own 3×3 block (or 3-vector).
"""

import numpy as np
import oracle
import pytest
from cases import slow_but
from oracle import mp

from kernels.samples import (
    GROUPS,
    LINEAR,
    NUMBER_TYPES,
    configurations,
    dim,
    evaluate,
    matrices,
    nearest_rotation,
    norms,
    reference,
    relative_errors,
    sweep,
    twists,
)
from lierb.kernels.groups import so3

everywhere = pytest.mark.parametrize("group", slow_but(GROUPS, "so3", "se3"))
every_number = pytest.mark.parametrize("number_type", NUMBER_TYPES)


def assert_accurate(found, expected, theta):
    """1e-14 up to 5.8 rad: tens of roundings, each of half an ulp, in sums that do not cancel.

    Beyond, 5e-15/(2π − θ): dexp⁻¹ and half its coefficients have a pole at 2π, so that the rounding
    of ‖ξ‖² alone costs about 1e-15/(2π − θ), and twice that where the pole is double.
    """
    errors = relative_errors(found, expected)
    bounds = np.where(theta <= 5.8, 1e-14, 5e-15 / (2.0 * np.pi - theta))
    worst = np.argmax(errors / bounds)
    assert errors[worst] <= bounds[worst], f"{errors[worst]:.2g} at θ = {theta[worst]!r}"


@everywhere
@every_number
def test_exp_sweep(group, number_type):
    X = sweep(group)
    assert_accurate(evaluate(number_type, group, "exp", X), configurations(group), norms(X))


@everywhere
@every_number
@pytest.mark.parametrize("name", LINEAR)
def test_linear_sweep(group, number_type, name):
    arguments = configurations if name == "Ad" else sweep
    found = matrices(number_type, group, name, arguments(group))
    assert_accurate(found, reference(group, name, arguments), norms(sweep(group)))


@everywhere
@every_number
def test_inverse_sweep(group, number_type):
    found = evaluate(number_type, group, "inverse", configurations(group))
    assert_accurate(found, reference(group, "inverse", configurations), norms(sweep(group)))


@everywhere
@every_number
def test_compose_sweep(group, number_type):
    left = configurations(group)
    right = np.roll(left, 1, axis=0)
    product = oracle.lie[group].compose
    expected = [oracle.to_float(product(a.tolist(), b.tolist())) for a, b in zip(left, right)]
    errors = abs(evaluate(number_type, group, "compose", left, right) - np.array(expected))
    # an entry is a sum of at most four products, which may cancel: relative to its largest terms
    scale = 1.0 if group == "so3" else 1.0 + abs(left[:, :3, 3:]) + abs(right[:, :3, 3]).max()
    assert np.max(errors[:, :3] / scale) <= 1e-15


@everywhere
@every_number
@pytest.mark.parametrize("name", ["dexp", "dexpinv", "ad"])
def test_linear_on_vectors(group, number_type, name):
    X = sweep(group)
    V = twists(np.ones(len(X)), dim(group), seed=2)
    found = evaluate(number_type, group, name, X, V)
    M = reference(group, name, sweep)
    expected = np.array([oracle.to_float(mp.matrix(m.tolist()) * mp.matrix(v.tolist()))
                         for m, v in zip(M, V)])  # fmt: skip
    # The terms of M V may cancel, hence relative to |M| |V|, not to M V; 2π: see assert_accurate.
    scale = np.max(abs(M) @ abs(V)[:, :, None], axis=(1, 2))
    errors = np.max(abs(found - expected), axis=1)
    assert np.all(errors * np.minimum(1.0, 2.0 * np.pi - norms(X)) <= 5e-15 * scale)


@pytest.mark.parametrize("group", ["so3", "se3"])
@every_number
def test_exp_beyond_one_turn(group, number_type):
    theta = np.geomspace(6.2, 1e5, 60)
    X = twists(theta, dim(group))
    expected = np.array([oracle.to_float(_exp_closed_form(x.tolist())) for x in X])
    errors = relative_errors(evaluate(number_type, group, "exp", X), expected)
    # θ² is rounded, so the angle itself is off by an ulp or so: relative to θ, not to 1
    assert np.max(errors / theta) <= 1e-15


def _exp_closed_form(X):
    """Rodrigues' formula in mpmath: the oracle's power series needs as many terms as radians."""
    theta = mp.norm(X[:3])
    hat = oracle.lie["so3"].hat(X[:3])
    s, c = mp.sin(theta), mp.cos(theta)
    R = mp.eye(3) + s / theta * hat + (1 - c) / theta**2 * hat**2
    if len(X) == 3:
        return R
    C = mp.eye(4)
    C[:3, :3] = R
    A = mp.eye(3) + (1 - c) / theta**2 * hat + (theta - s) / theta**3 * hat**2
    C[:3, 3] = A * mp.matrix(X[3:])
    return C


@pytest.mark.parametrize("size", [1e-15, 1e-12, 1e-9])
def test_orthonormalised_is_the_nearest_rotation(size):
    R = configurations("so3")
    R = R + np.random.default_rng(12).uniform(-size, size, R.shape)
    exact = [oracle.to_float(nearest_rotation(mp.matrix(r.tolist()))) for r in R]
    found = np.stack(so3.orthonormalised(tuple(R.reshape(-1, 9).T)), axis=-1)
    # one Newton step: the square of what it was off by is 1e-17 at most, so a few roundings of 1
    assert np.max(abs(found - np.reshape(exact, (-1, 9)))) <= 1e-15


@everywhere
@every_number
def test_zero_gives_identity(group, number_type):
    zero = np.zeros((1, dim(group)))
    V = twists(np.ones(1), dim(group))
    identity = evaluate(number_type, group, "exp", zero)
    assert np.array_equal(identity[0], np.eye(identity.shape[1]))
    assert np.array_equal(evaluate(number_type, group, "log", identity), zero)
    for name in ("dexp", "dexpinv"):
        assert np.array_equal(evaluate(number_type, group, name, zero, V), V)


@pytest.mark.parametrize("group", ["se3", "so3xr3"])
@every_number
def test_exp_of_pure_translation_is_exact(group, number_type):
    X = twists(np.zeros(5), 6)
    C = evaluate(number_type, group, "exp", X)
    assert np.array_equal(C[:, :3, 3], X[:, 3:])
    assert np.array_equal(evaluate(number_type, group, "log", C), X)
