"""Angles, directions and number types that the tests of the Lie groups share.

A formula is run three ways ("number types"): on lane packs, as `lierb.lie` compiles it; on NumPy
arrays; on Python floats. The references come from `oracle`, once for each group and function.
"""

from functools import cache

import numpy as np
import oracle
from oracle import mp

import lierb
from lierb.kernels.groups.lie_functions import GROUPS, SIGNATURES
from lierb.kernels.numbers.arithmetic import flatten
from lierb.kernels.numbers.zero import is_zero

CUTOVERS = (0.1, 0.75, np.pi)  # rad: series of five terms, of eight, long series, closed forms
NUMBER_TYPES = ("lanes", "arrays", "floats")
LINEAR = ("Ad", "ad", "dexp", "dexpinv")  # in their second argument


def around(centre: float) -> np.ndarray:
    """Both neighbours of `centre`, and from there away from it in growing steps."""
    steps = centre * np.geomspace(1e-15, 0.05, 8)
    neighbours = np.nextafter(centre, 0.0), centre, np.nextafter(centre, 9.0)
    return np.concatenate([centre - steps, neighbours, centre + steps])


def angles(random: int = 100, logarithmic: int = 60) -> np.ndarray:
    """θ from 1e-12 to 6.2: a log sweep, dense around each cut-over, and random ones."""
    rng = np.random.default_rng(20160101)
    return np.concatenate(
        [np.geomspace(1e-12, 6.2, logarithmic), *map(around, CUTOVERS), rng.uniform(0, 6.2, random)]
    )


def near_two_pi() -> np.ndarray:
    """θ from 5.8 to 6.28, where dexp⁻¹ is about to lose its inverse."""
    return 2.0 * np.pi - np.geomspace(0.48, 2.0 * np.pi - 6.28, 12)


def twists(theta: np.ndarray, dim: int, seed: int = 1) -> np.ndarray:
    """An (n, dim) sample with ‖ξ‖ = θ in random directions, some of them a coordinate axis.

    η (0.05 to 20 m) is neither orthogonal nor parallel to ξ.
    """
    rng = np.random.default_rng(seed)
    n = len(theta)
    direction = rng.normal(size=(n, 3))
    direction[::7] = np.eye(3)[rng.integers(0, 3, len(direction[::7]))]
    xi = theta[:, None] * direction / np.linalg.norm(direction, axis=1)[:, None]
    eta = rng.normal(size=(n, 3)) * np.exp(rng.uniform(np.log(0.05), np.log(20.0), (n, 1)))
    return np.concatenate([xi, eta], axis=1)[:, :dim]


def dim(group: str) -> int:
    return oracle.lie[group].dim


@cache
def sweep(group: str) -> np.ndarray:
    """The twists at which every function of the group is compared with the oracle."""
    theta = np.concatenate([angles(), near_two_pi()])
    return twists(theta, dim(group))


@cache
def configurations(group: str) -> np.ndarray:
    """Group elements exp X for the X of `sweep`, each entry the nearest float64."""
    return reference(group, "exp", sweep)


@cache
def reference(group: str, name: str, arguments) -> np.ndarray:
    """oracle.lie[group].name of each of arguments(group), rounded to float64."""
    function = getattr(oracle.lie[group], name)
    values = np.array([oracle.to_float(function(x.tolist())) for x in arguments(group)])
    values[abs(values) < 1e-60] = 0.0  # what 80 digits of an inverse leave of a zero
    return values


def nearest_rotation(R):
    """Polar decomposition of a 3×3 mpmath matrix that is off by 1e-8 or less."""
    for _ in range(4):  # Newton's iteration doubles the digits each time
        R = (R + mp.inverse(R).T) / 2
    return R


# ---------------------------------------------------------------- one formula, three number types


def unpacked(group: str, kind: str, array: np.ndarray):
    """The numbers a formula takes: tuples whose members have the batch's shape."""
    if kind == "x":
        return tuple(np.moveaxis(array, -1, 0))
    rotation = tuple(array[..., i, j] for i in range(3) for j in range(3))
    return rotation if group == "so3" else (rotation, tuple(array[..., i, 3] for i in range(3)))


def packed(group: str, kind: str, result, batch=()) -> np.ndarray:
    """Inverse of `unpacked`; structural zeros become 0."""
    numbers = [0.0 if is_zero(x) else x for x in flatten(result)]
    columns = np.stack([np.broadcast_to(x, batch) for x in numbers], axis=-1)
    if kind == "x":
        return columns
    matrix = np.zeros((*batch, 3, 3) if group == "so3" else (*batch, 4, 4))
    matrix[..., :3, :3] = columns[..., :9].reshape(*batch, 3, 3)
    if group != "so3":
        matrix[..., :3, 3], matrix[..., 3, 3] = columns[..., 9:], 1.0
    return matrix


def evaluate(number_type: str, group: str, name: str, *operands: np.ndarray) -> np.ndarray:
    """f(a, b) for each row of the operands, computed with one of NUMBER_TYPES."""
    if number_type == "lanes":
        return getattr(getattr(lierb.lie, group), name)(*operands)
    formula = getattr(GROUPS[group], name)
    kinds, result = SIGNATURES[name]
    batch = operands[0].shape[: operands[0].ndim - (2 if kinds[0] == "g" else 1)]
    if number_type == "arrays":
        numbers = [unpacked(group, kind, x) for kind, x in zip(kinds, operands)]
        return packed(group, result, formula(*numbers), batch)
    rows = [
        packed(
            group, result, formula(*(_floats(unpacked(group, k, x)) for k, x in zip(kinds, row)))
        )
        for row in zip(*operands)
    ]
    return np.array(rows)


def _floats(numbers):
    return tuple(map(_floats, numbers)) if isinstance(numbers, tuple) else float(numbers)


def matrices(number_type: str, group: str, name: str, first: np.ndarray) -> np.ndarray:
    """Matrix of the linear function f(first, ·) for each row; on lanes as `lierb.lie` gives it."""
    if number_type == "lanes":
        return getattr(getattr(lierb.lie, group), name)(first)
    n, size = len(first), dim(group)
    basis = np.tile(np.eye(size), (n, 1))
    columns = evaluate(number_type, group, name, np.repeat(first, size, axis=0), basis)
    return np.swapaxes(columns.reshape(n, size, size), 1, 2)


# ---------------------------------------------------------------- errors


def blocks(array: np.ndarray) -> list[np.ndarray]:
    """3-vectors of vectors; R and r of 4×4 configurations; 3×3 blocks of 3×3 and 6×6 matrices."""
    if array.ndim == 2:
        return [array[:, i : i + 3] for i in range(0, array.shape[1], 3)]
    if array.shape[1:] == (4, 4):
        return [array[:, :3, :3], array[:, :3, 3], array[:, 3, :]]
    starts = range(0, array.shape[1], 3)
    return [array[:, i : i + 3, j : j + 3] for i in starts for j in starts]


def relative_errors(found: np.ndarray, expected: np.ndarray) -> np.ndarray:
    """Largest error of an entry relative to the largest entry of its block, for each row.

    A block by itself, not the whole matrix: a small translation must not hide behind the rotation.
    """
    worst = np.zeros(len(expected))
    for f, e in zip(blocks(found), blocks(expected), strict=True):
        axes = tuple(range(1, e.ndim))
        scale, error = abs(e).max(axis=axes), abs(f - e).max(axis=axes)
        worst = np.maximum(worst, np.divide(error, scale, out=error.copy(), where=scale > 0))
    return worst


def norms(X: np.ndarray) -> np.ndarray:
    """‖ξ‖ of each row."""
    return np.array([float(mp.norm(row[:3].tolist())) for row in X])
