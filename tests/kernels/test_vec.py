"""3-vectors and 3×3 matrices on tuples."""

from itertools import permutations

import numpy as np
import oracle
import pytest
from oracle import mp

from kernels.packs import on_lanes
from kernels.samples import NUMBER_TYPES
from lierb.kernels.numbers import vec
from lierb.kernels.numbers.vec import inverse_symmetric, principal_axes

A, B = np.array([[1, -2, 3], [4, 5, -6], [-7, 8, 9]]), np.array([[2, 0, -1], [1, 3, 5], [-4, 6, 7]])
a, b = A[0], B[1]

# What each function gives on integers, where every operation is exact, and NumPy's way to say it
CASES = {
    "add": ((a, b), a + b),
    "sub": ((a, b), a - b),
    "neg": ((a,), -a),
    "scale": ((3.0, a), 3 * a),
    "axpy": ((3.0, a, b), 3 * a + b),
    "dot": ((a, b), a @ b),
    "norm": (((3.0, 0.0, -4.0),), 5),
    "cross": ((a, b), np.cross(a, b)),
    "row": ((A, 1), A[1]),
    "column": ((A, 2), A[:, 2]),
    "transpose": ((A,), A.T),
    "mat_vec": ((A, b), A @ b),
    "mat_t_vec": ((A, b), A.T @ b),
    "mat_mat": ((A, B), A @ B),
    "mat_t_mat": ((A, B), A.T @ B),
    "mat_mat_t": ((A, B), A @ B.T),
}


@pytest.mark.parametrize("name", CASES)
def test_vec_on_integers(name):
    arguments, expected = CASES[name]
    numbers = [tuple(map(float, x.ravel())) if isinstance(x, np.ndarray) else x for x in arguments]
    assert np.array_equal(np.ravel(getattr(vec, name)(*numbers)), np.ravel(expected))


# ---------------------------------------------------------------- inverse of a symmetric matrix


def inverses(number_type, matrices):
    entries = matrices.reshape(-1, 9)
    if number_type == "lanes":
        columns = on_lanes("inverse_symmetric", *entries.T, results=9)
    elif number_type == "arrays":
        columns = np.array(inverse_symmetric(tuple(entries.T)))
    else:
        columns = np.array([inverse_symmetric(tuple(row)) for row in entries.tolist()]).T
    return columns.T.reshape(-1, 3, 3)


def exact_inverses(matrices):
    return np.array([oracle.to_float(mp.inverse(mp.matrix(m.tolist()))) for m in matrices])


def rotations(n):
    rng = np.random.default_rng(11)
    return np.linalg.qr(rng.normal(size=(n, 3, 3)))[0]


every_number = pytest.mark.parametrize("number_type", NUMBER_TYPES)


@every_number
@pytest.mark.parametrize("unit", [1e-6, 1.0, 1e6])
@pytest.mark.parametrize("moments", [(1.0, 2.0, 2.5), (1e-3, 1.0, 1.0), (1e-6, 1.0, 1.0)], ids=str)
def test_inverse_symmetric_of_tilted_bodies(number_type, moments, unit):
    Q = rotations(40)
    M = Q * (unit * np.array(moments)) @ Q.transpose(0, 2, 1)
    M = (M + M.transpose(0, 2, 1)) / 2
    exact = exact_inverses(M)
    errors = abs(inverses(number_type, M) - exact).max(axis=(1, 2)) / abs(exact).max(axis=(1, 2))
    # Rounding M's own entries moves the inverse by cond·1.1e-16, so no method does better; the
    # small moment of a tilted rod is what is left of entries of size 1.
    condition = max(moments) / min(moments)
    assert errors.max() <= 4e-16 * condition


@every_number
@pytest.mark.parametrize("scales", list(permutations([1e-3, 1.0, 1e3])), ids=str)
def test_inverse_symmetric_keeps_small_entries_when_aligned(number_type, scales):
    # D B D with B well conditioned (10): an entry's error is relative to its row and its column
    Q = rotations(20)
    B = Q * np.array([0.2, 1.0, 2.0]) @ Q.transpose(0, 2, 1)
    D = np.array(scales)
    M = D[:, None] * ((B + B.transpose(0, 2, 1)) / 2) * D
    M = (M + M.transpose(0, 2, 1)) / 2
    error = abs(inverses(number_type, M) - exact_inverses(M)) * D[:, None] * D
    assert error.max() <= 5 * 10 * 1.1e-16 * 10  # entries of B⁻¹ ≤ 5, cond 10, ten roundings


@every_number
def test_inverse_symmetric_of_diagonals_is_rounded_once(number_type):
    diagonals = np.array([[1e-6, 3.0, 7.0], [15.234375, 0.46875, 1e9]])
    M = diagonals[:, :, None] * np.eye(3)
    assert np.array_equal(inverses(number_type, M), (1.0 / diagonals)[:, :, None] * np.eye(3))


@every_number
def test_inverse_symmetric_is_symmetric_to_the_bit(number_type):
    Q = rotations(10)
    M = Q * np.array([1e-6, 1.0, 1.0]) @ Q.transpose(0, 2, 1)
    found = inverses(number_type, (M + M.transpose(0, 2, 1)) / 2)
    assert np.array_equal(found, found.transpose(0, 2, 1))


# ---------------------------------------------------------------- principal axes


def principal(number_type, matrices):
    """Moments (n, 3) and axes (n, 3, 3)."""
    entries = matrices.reshape(-1, 9)
    if number_type == "lanes":
        columns = on_lanes("principal_axes", *entries.T, results=12)
    elif number_type == "arrays":
        columns = np.array(sum(principal_axes(tuple(entries.T)), ()))
    else:
        columns = np.array([sum(principal_axes(tuple(row)), ()) for row in entries.tolist()]).T
    return columns[:3].T, columns[3:].T.reshape(-1, 3, 3)


@every_number
@pytest.mark.parametrize("unit", [1e-6, 1e6])
@pytest.mark.parametrize(
    "moments",
    [(1.0, 2.0, 2.5), (1e-6, 1.0, 1.0), (1.0, 1.0, 1.0), (1.0, 1.0 + 1e-9, 1.9), (3.0, 2.0, 3.0)],
    ids=str,
)
def test_principal_axes_of_tilted_bodies(number_type, moments, unit):
    Q = rotations(60)
    M = Q * (unit * np.array(moments)) @ Q.transpose(0, 2, 1)
    M = (M + M.transpose(0, 2, 1)) / 2
    found, axes = principal(number_type, M)
    # 12 rotations, each of which rounds entries of the matrix's size and of 1
    put_back = axes * found[:, None, :] @ axes.transpose(0, 2, 1)
    assert abs(put_back - M).max() <= 5e-15 * unit * max(moments)
    assert abs(np.sort(found) - np.sort(moments) * unit).max() <= 3e-15 * unit * max(moments)
    assert abs(axes.transpose(0, 2, 1) @ axes - np.eye(3)).max() <= 3e-15
    assert np.linalg.det(axes) == pytest.approx(1.0, abs=1e-14)


@every_number
def test_principal_axes_of_diagonals_are_their_own(number_type):
    moments = np.array([[3.0, 1e-6, 7.0], [2.0, 2.0, 2.0], [1.0, 5.0, 1.0]])
    found, axes = principal(number_type, moments[:, :, None] * np.eye(3))
    assert np.array_equal(found, moments)
    assert np.array_equal(axes, np.broadcast_to(np.eye(3), (3, 3, 3)))
