"""The completion group of a mechanism in a c-space, found by walking over its configurations.

Runge–Kutta's stages move C₀ by exponentials of velocities that solve the rows where they stand, and
of brackets of these. All that keeps these stages together is which rows are constant on C₀K; K has
to hold the solutions at *all* of C₀K, therefore: of the constraint set, and of what is beside it.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from lierb.arrays import Array, Pose
from lierb.completion_space import Configuration, Place, Space
from lierb.kernels.mechanics.scale import ROUNDING, START_TOLERANCE
from lierb.mechanism_closing import DAMPING, least

# Singular values below this part of the largest count as none. Dependent directions leave 1e-13, by
# the error of Newton's method; independent ones 1e-3 and more, unless they are to a user as well.
RANK_TOLERANCE = 1e-8
CONSTANT = 1e-9  # how far a row that is constant on C₀K may be off, over 1 + ‖d‖/ℓ
BATCH = 8  # configurations between two looks at the rank; it is stable after two without a rise
STEP = 0.7  # rad, or so many times the mechanism's length, from one sample to the next
NEWTON_STEPS = 20
SEED = 2016


class OpenError(ValueError):
    """A start does not close a place."""

    def __init__(self, place: Place) -> None:
        super().__init__()
        self.place = place


class Completion:
    """algebra : (k, 6 nodes), a basis of that of K, of length 1 each.   exact : of each row."""

    def __init__(self, space: Space, poses: list[Pose]) -> None:
        """Raises OpenError."""
        self.space = space
        self.random = np.random.default_rng(SEED)
        self.rounding = space.rounding(poses)
        start = space.of_poses(poses)
        self._require_closed(start)
        self.left = np.zeros(len(space.rows))  # what is open however near Newton's method comes
        self.start = self._closed(start) or self._nearest(start)
        self.algebra = self._completed()
        self.exact = self._kept()

    def _require_closed(self, start: Configuration) -> None:
        space = self.space
        off = np.abs(space.at(start)[0]) > START_TOLERANCE + self.rounding
        owners = [place for place in space.places for _ in place.rows]
        if wrong := [place for place, is_off in zip(owners, off, strict=True) if is_off]:
            raise OpenError(wrong[0])
        if place := space.reversed(start):
            raise OpenError(place)

    def _nearest(self, start: Configuration) -> Configuration:
        """A start that rows contradict each other at, as lengths that are rounded make them."""
        self.left = 2.0 * np.abs(self.space.at(start)[0])
        return start

    # ---- configurations ------------------------------------------------------------------------

    def _closed(self, found: Configuration) -> Configuration | None:
        """Newton's method onto the joints; None where it does not get there."""
        space = self.space
        for _ in range(NEWTON_STEPS):
            values, jac, lengths = space.at(found)
            if self._vanish(values, found, 2e-14):
                return found
            wanted = -values / lengths
            damping = np.array([DAMPING * float(wanted @ wanted)])
            step = least(jac[None], wanted[None], damping)[0]
            if not np.isfinite(step).all() or np.linalg.norm(step) > np.sqrt(len(space.tree)):
                return None
            found = space.moved(found, space.lifted(step[None])[0])
        return found if self._vanish(space.at(found)[0], found, 1e-12) else None

    def _vanish(self, values: Array, at: Configuration, most: float) -> bool:
        """Whether the values of all rows are that small, or rounding."""
        allowed = most + ROUNDING * self.space.sizes(at) + self.rounding + self.left
        return bool(np.all(np.abs(values) <= allowed))

    def _feasible(self) -> Iterator[Array]:
        """Velocities, (n, 6 nodes) of unit length, at configurations that hang together."""
        space, here = self.space, self.start
        while True:
            free = self._solutions(here)
            yield free
            reach = STEP
            while reach > 1e-3 and len(free):
                motion = self.random.normal(size=len(free)) @ free
                size = np.linalg.norm(motion)
                tried = self._closed(space.moved(here, reach * motion / (size or 1.0)))
                if tried is not None:
                    here = tried
                    break
                reach *= 0.5

    def _solutions(self, at: Configuration) -> Array:
        """Velocities that all rows allow."""
        return self.space.lifted(null_space(self.space.at(at)[1]))

    # ---- the group -----------------------------------------------------------------------------

    def _completed(self) -> Array:
        algebra = np.empty((0, 6 * len(self.space.tree)))
        stable = 0
        feasible = self._feasible()
        while stable < 2 and len(algebra) < self.space.freedoms:
            found = [next(feasible) for _ in range(BATCH)]
            if len(algebra):
                found += [self._solutions(self._anywhere(algebra)) for _ in range(BATCH)]
            larger = self._closed_under_brackets(np.vstack([algebra, *found]))
            stable = stable + 1 if len(larger) == len(algebra) else 0
            algebra = larger
        return algebra

    def _anywhere(self, algebra: Array) -> Configuration:
        """A product of random elements of K, from the start on."""
        found = self.start
        for _ in range(3):
            found = self.space.moved(found, self.random.normal(size=len(algebra)) @ algebra)
        return found

    def _closed_under_brackets(self, vectors: Array) -> Array:
        basis = row_space(vectors)
        while len(basis) > 1:
            i, j = np.tril_indices(len(basis), -1)
            larger = row_space(np.vstack([basis, self.space.bracket(basis[i], basis[j])]))
            if len(larger) == len(basis):
                break
            basis = larger
        return basis

    def _kept(self) -> Array:
        """Whether each row is constant on C₀K: looked at on products of random elements of K."""
        exact = np.ones(len(self.space.rows), dtype=bool)
        for _ in range(3 * BATCH):
            at = self._anywhere(self.algebra)
            allowed = CONSTANT * (1.0 + self.space.sizes(at)) + self.rounding + self.left
            exact &= np.abs(self.space.at(at)[0]) <= allowed
        return exact


def null_space(jac: Array) -> Array:
    """(k, columns); rows of `jac` are of length 1, or nothing."""
    _, sizes, vectors = np.linalg.svd(np.vstack([jac, np.zeros((1, jac.shape[1]))]))
    rank = int((sizes > RANK_TOLERANCE * max(float(sizes[0]), 1.0)).sum()) if sizes.size else 0
    found: Array = vectors[rank:]
    return found


def row_space(vectors: Array) -> Array:
    """Orthonormal basis of the rows' span."""
    if not len(vectors):
        return vectors
    _, sizes, basis = np.linalg.svd(vectors, full_matrices=False)
    found: Array = basis[sizes > RANK_TOLERANCE * max(float(sizes[0]), 1.0)]
    return found


# ---- names -------------------------------------------------------------------------------------

POWERS = ("", "R", "R²", "R³")
TWISTED = 1e-9  # ℓ/rad, from which on a turn displaces; Newton's method leaves 1e-13


def group_name(cspace: str, algebra: Array) -> str:
    """The name of a subgroup of SE(3), as in Müller's table 1, or of SO(3)×R³.

    algebra : (k, 6), lengths in units of the problem's own.
    """
    turning = row_space(algebra[:, :3])
    shifts = _pure_translations(algebra)
    if not len(turning):
        return POWERS[len(shifts)] or "{I}"
    if cspace == "SO3xR3":
        base = f"SO({2 if len(turning) == 1 else 3})"
        if _drift(algebra, shifts) > TWISTED:
            base = "{(exp tê, ta)}"  # turns that displace in proportion (errata E17)
        return "×".join(filter(None, (base, POWERS[len(shifts)])))
    if len(turning) == 3:
        return "SE(3)" if len(shifts) else "SO(3)"
    if len(shifts) in (1, 3):
        return ("SO(2)×R", "SO(2)⋉R³")[len(shifts) // 2]
    rising = abs(_pitch(algebra, turning[0])) > TWISTED
    if len(shifts) == 2:
        return "H_p⋉R²" if rising else "SE(2)"
    return "H_p" if rising else "SO(2)"


def _pure_translations(algebra: Array) -> Array:
    """Basis, (k, 3), of the velocities without rotation."""
    turning = algebra[:, :3]
    _, sizes, mixed = np.linalg.svd(turning.T, full_matrices=True)
    still = mixed[int((sizes > RANK_TOLERANCE).sum()) :]
    return row_space(still @ algebra[:, 3:])


def _drift(algebra: Array, shifts: Array) -> float:
    """How much a turn of the algebra displaces, beside its pure translations."""
    rest = algebra[:, 3:] - algebra[:, 3:] @ shifts.T @ shifts
    return float(np.abs(rest).max(initial=0.0))


def _pitch(algebra: Array, axis: Array) -> float:
    """v·e over ω·e of the turns about `axis`, ℓ/rad."""
    rates = algebra[:, :3] @ axis
    best = int(np.abs(rates).argmax())
    return float(algebra[best, 3:] @ axis / rates[best])
