"""Regular mass matrices of mechanisms with links without mass."""

from __future__ import annotations

import numpy as np

from lierb.errors import ArgumentError
from lierb.model.joints.coordinates import motions_of
from lierb.model.mechanism.kinematics import TreeKinematics
from lierb.model.numbers import rigid_of
from lierb.support.arrays import components

LEAST = 1e-9  # smallest eigenvalue of a regular mass matrix with ones on its diagonal


def require_regular(mechanism: TreeKinematics, names: list[str]) -> None:
    """Raise ArgumentError if a motion at coordinates 0 has no energy but that of the light links.

    names : of the light links.
    """
    pose = mechanism.pose()
    moves = [
        (link.name, mechanism.twist({link.name: rate}, pose))
        for link in mechanism.links
        if (motions := motions_of(link.joint))
        for rate in np.eye(len(motions.names))
    ]
    mass = np.zeros((len(moves), len(moves)))
    for x in mechanism.links:
        twists = np.array([twist[x.name] for _, twist in moves])
        mass += twists @ np.array(rigid_of(x.body).momentum(components(twists)))
    scale = 1.0 / np.sqrt(np.diag(mass))
    values, vectors = np.linalg.eigh(scale[:, None] * mass * scale)
    if values[0] < LEAST:
        sizes = [
            abs(x) if name in names else 0.0
            for x, (name, _) in zip(vectors[:, 0], moves, strict=True)
        ]
        name, _ = moves[int(np.argmax(sizes))]
        raise ArgumentError(
            f"body {name} has no mass or no inertia, and can move without what hangs on it: the "
            "mass matrix is singular; give it one, or weld it to another"
        )
