"""Log-Cholesky coordinates of mass, centre of mass and inertia, all of whose values are physical.

A rigid body exists if and only if its pseudo-inertia, of mass and second moments of mass, is
positive definite. Its triangular factor U has a positive diagonal e^α (e^d₁, e^d₂, e^d₃, 1):

P = U Uᵀ = [[Σ, mc], [mcᵀ, m]],  Σ = ½ tr(Θ) 1 − Θ

(Rucker & Wensing, Smooth parameterization of rigid-body inertia, IEEE RA-L 7, 2022). With Θ about
the origin of the body frame, α = ½ log m, and the last column of U/e^α is the centre of mass.
"""

from __future__ import annotations

import numpy as np

from lierb.errors import InertiaError
from lierb.runs.parameters import SYMMETRIC
from lierb.support.arrays import Array

UPPER = ((0, 1), (0, 2), (1, 2))
SIZES = {"mass": 1, "com": 3, "inertia": 6}  # of the numbers and of the coordinates
# coordinates: α; c; d₁, d₂, d₃, s₁₂, s₁₃, s₂₃


def coordinates_of(mass: float, com: Array, inertia: Array) -> dict[str, Array]:
    """Return the coordinates of a body, by the names of SIZES.

    inertia : entries 11, 22, 33, 12, 13, 23. Raises InertiaError unless P is positive definite.
    """
    about_com = second_moments(inertia) - mass * np.outer(com, com)
    try:  # U Uᵀ by Cholesky's method from the last row on
        factor = np.linalg.cholesky(about_com[::-1, ::-1] / mass)[::-1, ::-1]
    except np.linalg.LinAlgError:
        raise InertiaError(
            "inertia is that of a flat body or a rod, at the limit of what is possible, where a "
            "fit cannot start; give a guess with all principal moments A + B > C"
        ) from None
    return {
        "mass": np.array([0.5 * np.log(mass)]),
        "com": np.array(com),
        "inertia": np.array([*np.log(np.diag(factor)), *(factor[i, j] for i, j in UPPER)]),
    }


def body_of(coordinates: dict[str, Array]) -> dict[str, Array]:
    """Return mass, centre of mass and inertia; the inverse of `coordinates_of`."""
    mass = np.exp(2.0 * coordinates["mass"])
    factor = np.sqrt(mass) * _factor(coordinates)
    return {"mass": mass, "com": coordinates["com"], "inertia": _inertia(factor @ factor.T)}


def derivatives_of(coordinates: dict[str, Array]) -> dict[tuple[str, str], Array]:
    """Return the derivatives of numbers by coordinates, by the names of both, that are not zero."""
    size = np.exp(coordinates["mass"][0])
    factor = size * _factor(coordinates)
    columns: dict[str, list[Array]] = {"mass": [factor], "com": [], "inertia": []}
    for i in range(3):
        change = np.zeros((3, 4))
        change[i, 3] = size
        columns["com"].append(change)
    for i, j in ((0, 0), (1, 1), (2, 2), *UPPER):
        change = np.zeros((3, 4))
        change[i, j] = factor[i, i] if i == j else size
        columns["inertia"].append(change)
    derivatives = {
        ("inertia", name): np.stack([_inertia(d @ factor.T + factor @ d.T) for d in each], -1)
        for name, each in columns.items()
    }
    derivatives["mass", "mass"] = np.array([[2.0 * size**2]])
    derivatives["com", "com"] = np.eye(3)
    return derivatives


def _factor(coordinates: dict[str, Array]) -> Array:
    """Return the first three rows of U/e^α."""
    d, s = np.split(coordinates["inertia"], 2)
    factor = np.zeros((3, 4))
    factor[range(3), range(3)] = np.exp(d)
    for (i, j), entry in zip(UPPER, s, strict=True):
        factor[i, j] = entry
    factor[:, 3] = coordinates["com"]
    return factor


def second_moments(inertia: Array) -> Array:
    """Return Σ = ½ tr(Θ) 1 − Θ of six entries."""
    matrix = np.zeros((3, 3))
    for (i, j), entry in zip(SYMMETRIC, inertia, strict=True):
        matrix[i, j] = matrix[j, i] = entry
    return np.asarray(0.5 * np.trace(matrix) * np.eye(3) - matrix)


def _inertia(moments: Array) -> Array:
    """Return the six entries of Θ = tr(Σ) 1 − Σ."""
    matrix = np.trace(moments) * np.eye(3) - moments
    return np.array([matrix[i, j] for i, j in SYMMETRIC])
