"""Regular mass matrices of mechanisms with links that have no mass or no inertia of their own."""

from __future__ import annotations

import numpy as np

from lierb.errors import ArgumentError
from lierb.kernels.mechanics.newton_euler import unit_inertia
from lierb.kernels.mechanics.spatial import Rigid
from lierb.kernels.numbers.vec import axpy
from lierb.model.bodies.body import Body
from lierb.model.joints.coordinates import motions_of
from lierb.model.mechanism.kinematics import TreeKinematics
from lierb.model.numbers import rigid_of
from lierb.support.arrays import Array, components

LIGHT = 1e-9  # mass of a link without mass, relative to all links: at most
MOST = 1e-3  # part of the energy of a motion that the numbers added to light links may have


def require_regular(mechanism: TreeKinematics, names: list[str]) -> None:
    """Raise ArgumentError if a motion at coordinates 0 has no energy but that of the light links.

    names : of the light links, whose mass or inertia was added by `lierb.model.files`.
    """
    pose = mechanism.pose()
    moves = [
        (link.name, mechanism.twist({link.name: rate}, pose))
        for link in mechanism.links
        if (motions := motions_of(link.joint))
        for rate in np.eye(len(motions.names))
    ]
    total = sum(float(link.body.mass) for link in mechanism.links)
    mass, added = np.zeros((2, len(moves), len(moves)))
    for link in mechanism.links:
        twists = np.array([twist[link.name] for _, twist in moves])
        mass += _energies(rigid_of(link.body), twists)
        if link.name in names:
            added += _energies(_added_to(link.body, total), twists)
    scale = 1.0 / np.sqrt(np.diag(mass))
    mass, added = (scale[:, None] * matrix * scale for matrix in (mass, added))
    inverse = np.linalg.inv(np.linalg.cholesky(mass))
    values, vectors = np.linalg.eigh(inverse @ added @ inverse.T)
    if values[-1] > MOST:
        motion = np.abs(scale * (inverse.T @ vectors[:, -1]))
        sizes = [x if name in names else 0.0 for x, (name, _) in zip(motion / scale, moves)]
        name, _ = moves[int(np.argmax(sizes))]
        raise ArgumentError(
            f"body {name} has no mass or no inertia, and can move without the links that it "
            "carries, or turn about an axis through its point mass: the mass matrix is singular; "
            "give the body mass and inertia, or weld it to another"
        )


def _energies(rigid: Rigid, twists: Array) -> Array:
    return np.asarray(twists @ np.array(rigid.momentum(components(twists))))


def _added_to(body: Body, total: float) -> Rigid:
    """Return what a light link has beyond its own numbers: all, or the spin of a point mass."""
    if body.mass <= LIGHT * total:
        return rigid_of(body)
    inertia = axpy(-body.mass, unit_inertia(components(body.com)), components(body.inertia, 2))
    return Rigid(np.float64(0.0), (0.0, 0.0, 0.0), inertia)
