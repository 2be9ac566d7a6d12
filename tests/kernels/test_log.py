"""log on [0, π] against mpmath, and its sign at π."""

from functools import cache
from itertools import product

import numpy as np
import oracle
import pytest
from oracle import mp

from kernels.samples import (
    GROUPS,
    NUMBER_TYPES,
    angles,
    dim,
    evaluate,
    nearest_rotation,
    relative_errors,
    twists,
)

EDGES = [0.0, np.pi - 1e-4, np.pi - 1e-8, np.pi - 1e-12, np.pi - 1e-15, np.pi]

everywhere = pytest.mark.parametrize("group", GROUPS)
every_number = pytest.mark.parametrize("number_type", NUMBER_TYPES)


def principal_angles():
    theta = angles()
    return np.concatenate([theta[theta <= np.pi], np.repeat(EDGES, 4)])


@cache
def rounded_configurations(group):
    """exp X in mpmath, each entry rounded to float64: what log is given."""
    X = twists(principal_angles(), dim(group), seed=3)
    return np.array([oracle.to_float(oracle.lie[group].exp(x.tolist())) for x in X])


@cache
def reference_logs(group):
    """mpmath's log of the rotation nearest to each rounded matrix, and of the other one near π.

    The rounded matrix is no rotation, and its log not the X that it came from: the 1e-16 by which
    rounding moved it would count as log's error. The nearest rotation (polar decomposition) is what
    it says. At π, ξ and −ξ are the same rotation; rounding puts the matrix on either side of π.
    """
    logs = []
    for C in rounded_configurations(group):
        C = mp.matrix(C.tolist())
        C[:3, :3] = nearest_rotation(C[:3, :3])
        logs.append(_both_logs(oracle.lie[group], C))
    return np.array(logs).swapaxes(0, 1)


def _both_logs(lie, C):
    X = lie.log(C)
    theta = mp.norm(X[:3])
    if theta < np.pi - 1e-14:
        return [oracle.to_float(X)] * 2
    xi = X[:3] * ((theta - 2 * mp.pi) / theta)
    other = [*xi, *X[3:]]
    if lie is oracle.lie["se3"]:
        columns = mp.matrix(3)
        for j in range(3):
            columns[:, j] = lie.exp([*xi, *(int(i == j) for i in range(3))])[:3, 3]
        other[3:] = mp.lu_solve(columns, C[:3, 3])
    return [oracle.to_float(X), oracle.to_float(mp.matrix(other))]


@everywhere
@every_number
def test_log_sweep(group, number_type):
    found = evaluate(number_type, group, "log", rounded_configurations(group))
    X, other = reference_logs(group)
    errors = np.minimum(relative_errors(found, X), relative_errors(found, other))
    # relative to ‖ξ‖ even at 1e-12: the skew part of R carries ξ to 16 digits, and nothing cancels
    assert errors.max() <= 1e-14, f"θ = {principal_angles()[errors.argmax()]!r}"


@everywhere
@every_number
def test_log_inverts_exp(group, number_type):
    theta = principal_angles()[:-8]  # without π itself, where the sign is a convention
    X = twists(theta, dim(group), seed=4)
    C = evaluate(number_type, group, "exp", X)
    error = abs(evaluate(number_type, group, "log", C) - X).max(axis=1)
    # absolute: exp's entries are good to 1e-15 of the largest, and log keeps absolute errors
    assert np.all(error <= 1e-14 * np.maximum(1.0, abs(X).max(axis=1)))


@every_number
def test_log_stays_within_pi(number_type):
    R = rounded_configurations("so3")
    angle = np.linalg.norm(evaluate(number_type, "so3", "log", R), axis=1)
    assert angle.max() <= np.pi * (1 + 5e-16)  # two roundings of ‖ξ‖ itself


# ---------------------------------------------------------------- the sign at π


def half_turn(axis):
    """2 n nᵀ − I, symmetric to the last bit: ‖ξ‖ is π, and n and −n give the same matrix."""
    n = np.array(axis, dtype=float)
    return 2.0 * np.outer(n, n) / (n @ n) - np.eye(3)


AXES = [
    *(axis for axis in product((-1, 0, 1), repeat=3) if any(axis)),
    (-0.7, 0.7, 0.1), (0.3, -0.9, 0.9), (-0.61, -0.2, 0.61),
    (1, 2, -3), (-1, 2, -3), (-3, 1, 2), (3, -1, -2), (1, -2, 0), (0, -1, 2), (-2, 0, 1),
    (-1e-3, 1e-9, -1.0), (1e-12, -1.0, 1e-12), (-1.0, 0.999, 0.998),
]  # fmt: skip


@every_number
@pytest.mark.parametrize("axis", AXES, ids=str)
def test_log_at_pi_makes_the_largest_component_positive(number_type, axis):
    xi = evaluate(number_type, "so3", "log", half_turn(axis)[None])[0]
    n = np.array(axis, dtype=float)
    largest = np.argmax(abs(n))  # the first of several
    expected = np.sign(n[largest]) * np.pi * n / np.linalg.norm(n)
    assert xi == pytest.approx(expected, abs=1e-15 * np.pi, rel=0)  # a few roundings of R and ξ
    assert xi[largest] > 0


@every_number
def test_log_at_pi_breaks_ties_for_the_first(number_type):
    rng = np.random.default_rng(9)
    size, other = rng.uniform(0.5, 1.0, 300), rng.uniform(-0.5, 0.5, 300)
    axes = rng.permuted(np.stack([-size, size, other], axis=1), axis=1)
    xi = evaluate(number_type, "so3", "log", np.array([half_turn(axis) for axis in axes]))
    assert np.all(np.take_along_axis(xi, np.argmax(abs(axes), axis=1)[:, None], axis=1) > 0)


@everywhere
@every_number
@pytest.mark.parametrize("axis", AXES[::4], ids=str)
def test_log_at_pi_is_a_logarithm(group, number_type, axis):
    C = np.eye(3 if group == "so3" else 4)
    C[:3, :3] = half_turn(axis)
    if group != "so3":
        C[:3, 3] = 0.3, -2.0, 1.1
    X = evaluate(number_type, group, "log", C[None])[0]
    back = oracle.to_float(oracle.lie[group].exp(X.tolist()))
    assert abs(back - C).max() <= 2e-15  # X is rounded: π·1.1e-16 in ξ, times ‖r‖ = 2.3


@every_number
@pytest.mark.parametrize("angle", [np.pi - 1e-6, np.pi + 1e-6])
def test_log_takes_the_shorter_way_round(number_type, angle):
    axis = np.array([-2.0, 1.0, 2.0]) / 3.0
    R = oracle.to_float(oracle.lie["so3"].exp((angle * axis).tolist()))
    expected = (angle if angle < np.pi else angle - 2.0 * np.pi) * axis
    xi = evaluate(number_type, "so3", "log", R[None])[0]
    assert xi == pytest.approx(expected, abs=2e-15)  # rounding of R and of the expected value


@everywhere
@every_number
def test_log_of_a_nan_is_no_rotation(group, number_type):
    size = 3 if group == "so3" else 4
    for entry in product(range(3), repeat=2):
        C = np.eye(size)[None].copy()
        C[0][entry] = np.nan
        assert np.isnan(evaluate(number_type, group, "log", C)[0, :3]).all()
