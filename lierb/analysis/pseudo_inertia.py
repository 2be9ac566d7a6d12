"""Log-Cholesky coordinates of mass, centre of mass and inertia, all of whose values are physical.

A rigid body exists if and only if its pseudo-inertia, of mass and second moments of mass, is
positive definite. Its triangular factor U has a positive diagonal e^α (e^d₁, e^d₂, e^d₃, 1):

P = U Uᵀ = [[Σ, mc], [mcᵀ, m]],  Σ = ½ tr(Θ) 1 − Θ

(Rucker & Wensing, Smooth parameterization of rigid-body inertia, IEEE RA-L 7, 2022). With Θ about
the origin of the body frame, α = ½ log m, and the last column of U/e^α is the centre of mass.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from lierb.errors import InertiaError
from lierb.runs.parameters import SYMMETRIC
from lierb.support.arrays import Array

UPPER = (0, 0, 1), (1, 2, 2)  # rows and columns of the entries above the diagonal
ENTRIES = tuple(np.transpose(SYMMETRIC))  # rows and columns of the entries of an inertia
SIZES = {"mass": 1, "com": 3, "inertia": 6}  # of the numbers and of the coordinates
# coordinates: α; c; d₁, d₂, d₃, s₁₂, s₁₃, s₂₃


def coordinates_of(mass: ArrayLike, com: Array, inertia: Array) -> dict[str, Array]:
    """Return the coordinates of a body, or of each of a batch, by the names of SIZES.

    mass : (…).   com : (…, 3).   inertia : entries 11, 22, 33, 12, 13, 23, (…, 6).
    Raises InertiaError unless P is positive definite.
    """
    mass = np.asarray(mass)[..., None, None]
    about_com = second_moments(inertia) - mass * (com[..., :, None] * com[..., None, :])
    try:  # U Uᵀ by Cholesky's method from the last row on
        factor = np.linalg.cholesky(about_com[..., ::-1, ::-1] / mass)[..., ::-1, ::-1]
    except np.linalg.LinAlgError:
        raise InertiaError(
            "inertia is that of a flat body or a rod, at the limit of what is possible, where a "
            "fit cannot start; give a guess with all principal moments A + B > C"
        ) from None
    return {
        "mass": 0.5 * np.log(mass[..., 0]),
        "com": np.array(com),
        "inertia": np.concatenate(
            [np.log(np.diagonal(factor, axis1=-2, axis2=-1)), factor[..., *UPPER]], axis=-1
        ),
    }


def body_of(coordinates: dict[str, Array]) -> dict[str, Array]:
    """Return mass, centre of mass and inertia; the inverse of `coordinates_of`."""
    mass = np.exp(2.0 * coordinates["mass"])
    factor = np.sqrt(mass)[..., None] * _factor(coordinates)
    return {"mass": mass, "com": coordinates["com"], "inertia": _inertia(_outer(factor, factor))}


def derivatives_of(coordinates: dict[str, Array]) -> dict[tuple[str, str], Array]:
    """Return the derivatives of numbers by coordinates, by the names of both, that are not zero.

    They are (…, numbers, coordinates).
    """
    size = np.exp(coordinates["mass"])
    factor = size[..., None] * _factor(coordinates)
    entries = {"com": [(i, 3) for i in range(3)], "inertia": [(i, i) for i in range(3)]}
    entries["inertia"] += zip(*UPPER, strict=True)
    columns: dict[str, list[Array]] = {"mass": [factor], "com": [], "inertia": []}
    for name, of_name in entries.items():
        for i, j in of_name:
            change = np.zeros_like(factor)
            change[..., i, j] = factor[..., i, i] if i == j else size[..., 0]
            columns[name].append(change)
    derivatives = {
        ("inertia", name): np.stack(
            [_inertia(_outer(d, factor) + _outer(factor, d)) for d in each], axis=-1
        )
        for name, each in columns.items()
    }
    derivatives["mass", "mass"] = 2.0 * size[..., None] ** 2
    derivatives["com", "com"] = np.eye(3)
    return derivatives


def _factor(coordinates: dict[str, Array]) -> Array:
    """Return the first three rows of U/e^α, (…, 3, 4)."""
    d, s = np.split(coordinates["inertia"], 2, axis=-1)
    factor = np.zeros((*d.shape[:-1], 3, 4))
    factor[..., range(3), range(3)] = np.exp(d)
    factor[..., *UPPER] = s
    factor[..., 3] = coordinates["com"]
    return factor


def _outer(first: Array, second: Array) -> Array:
    return first @ second.swapaxes(-1, -2)


def second_moments(inertia: Array) -> Array:
    """Return Σ = ½ tr(Θ) 1 − Θ of six entries."""
    matrix = np.zeros((*inertia.shape[:-1], 3, 3))
    matrix[..., *ENTRIES] = matrix[..., *ENTRIES[::-1]] = inertia
    half = 0.5 * np.trace(matrix, axis1=-2, axis2=-1)
    return np.asarray(half[..., None, None] * np.eye(3) - matrix)


def _inertia(moments: Array) -> Array:
    """Return the six entries of Θ = tr(Σ) 1 − Σ."""
    trace = np.trace(moments, axis1=-2, axis2=-1)
    return np.asarray((trace[..., None, None] * np.eye(3) - moments)[..., *ENTRIES])
