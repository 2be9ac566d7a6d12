"""The completion group of a mechanism in a c-space, found by walking over its configurations.

Runge–Kutta's stages move C₀ by exponentials of velocities that solve the rows where they stand, and
of brackets of these. All that keeps these stages together is which rows are constant on C₀K; K has
to hold the solutions at *all* of C₀K, therefore: of the constraint set, and of what is beside it.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from lierb.arrays import Array, Pose
from lierb.completion_space import Configurations, Place, Seen, Space
from lierb.kernels.mechanics.scale import ROUNDING, START_TOLERANCE
from lierb.mechanism_closing import DAMPING, least

Mask = Any  # an array of truth values

# Singular values below this part of the largest count as none. Dependent directions leave 1e-13, by
# the error of Newton's method; independent ones 1e-3 and more, unless they are to a user as well.
RANK_TOLERANCE = 1e-8
CONSTANT = 1e-9  # how far a row that is constant on C₀K may be off, over 1 + ‖d‖/ℓ
BATCH = 8  # configurations between two looks at the rank; it is stable after two without a rise
STEP = 0.7  # rad, or so many times the mechanism's length, from one sample to the next
NEWTON_STEPS = 20
MOST_BATCHES = 25
# Rounding turns J's kernel by 1e-16 over the square of its least singular value, and a direction of
# the algebra by that over how much of it was seen.
MARGIN = 1e-2  # of J, for a configuration to count
SETTLED = 1e-4  # of the algebra's strongest direction, for another one to count at once
SEED = 2016


class OpenError(ValueError):
    """A start does not close a place."""

    def __init__(self, place: Place) -> None:
        super().__init__()
        self.place = place


class Completion:
    """algebra : (k, 6 nodes), an orthonormal basis of that of K.   exact : of each row."""

    def __init__(self, space: Space, poses: list[Pose]) -> None:
        """Raises OpenError."""
        self.space = space
        self.random = np.random.default_rng(SEED)
        self.rounding = space.rounding(poses)
        start = space.of_poses(poses)
        self._require_closed(start)
        self.left = np.zeros(len(space.rows))
        found, is_closed = self._closed(start)
        if not is_closed[0]:  # rows contradict each other by as much as their numbers are rounded
            found, self.left = start, 2.0 * np.abs(space.at(start).values[0])
        self.start = np.repeat(found, BATCH, axis=0)
        self.algebra = self._completed()
        self.exact = self._kept()

    def _require_closed(self, start: Configurations) -> None:
        seen = self.space.at(start)
        off = np.abs(seen.values[0]) > START_TOLERANCE + self.rounding
        owners = [place for place in self.space.places for _ in place.rows]
        wrong = [place for place, is_off in zip(owners, off, strict=True) if is_off]
        wrong += [self.space.places[k] for k in np.flatnonzero(~seen.upright[0])]
        if wrong:
            raise OpenError(wrong[0])

    # ---- configurations ------------------------------------------------------------------------

    def _closed(self, at: Configurations) -> tuple[Configurations, Mask]:
        """Newton's method onto the joints, and where it gets there."""
        lost: Mask = np.zeros(len(at), dtype=bool)
        for _ in range(NEWTON_STEPS):
            seen = self.space.at(at)
            is_closed = self._vanish(seen, 2e-14)
            at, lost = self._stepped(at, seen, lost)  # of a closed one too, for J's kernel
            if (is_closed | lost).all():
                return at, is_closed & ~lost
        return at, self._vanish(self.space.at(at), 1e-12) & ~lost

    def _stepped(self, at: Configurations, seen: Seen, lost: Mask) -> tuple[Configurations, Mask]:
        """A step of Newton's, and where there was none so far."""
        wanted, gradients = -seen.values / seen.lengths, seen.gradients
        lost = lost | ~(np.isfinite(wanted).all(axis=1) & np.isfinite(gradients).all(axis=(1, 2)))
        wanted[lost], gradients[lost] = 0.0, 0.0
        steps = least(gradients, wanted, DAMPING * np.sum(wanted**2, axis=1))
        lost = lost | ~(np.linalg.norm(steps, axis=1) <= np.sqrt(len(self.space.tree)))
        steps[lost] = 0.0
        return self.space.moved(at, self.space.lifted(steps)), lost

    def _vanish(self, seen: Seen, most: float) -> Mask:
        """Whether the values of all rows are that small, or rounding."""
        allowed = most + ROUNDING * seen.far + self.rounding + self.left
        return np.all(np.abs(seen.values) <= allowed, axis=1)

    def _walked(self, at: Configurations, solutions: list[Array]) -> Configurations:
        """From each configuration a step along its solutions, as large as Newton's method takes."""
        found, waiting = at.copy(), np.arange(len(at))
        reach = STEP
        while reach > 1e-3 and len(waiting):
            motions = []
            for i in waiting:
                motion = self.random.normal(size=len(solutions[i])) @ solutions[i]
                size = float(np.linalg.norm(motion))
                motions.append(reach * motion / (size or 1.0))
            tried, arrived = self._closed(self.space.moved(at[waiting], np.array(motions)))
            found[waiting[arrived]] = tried[arrived]
            waiting = waiting[~arrived]
            reach *= 0.5
        return found

    def _solutions(self, at: Configurations) -> tuple[list[Array], Array]:
        """Velocities that all rows allow, (k, 6 nodes) at each configuration, of length 1; and how
        far from losing its rank J is."""
        found, margins = [], []
        for gradients in self.space.at(at).gradients:
            free, margin = null_space(gradients)
            found.append(self.space.lifted(free))
            margins.append(margin)
        return found, np.array(margins)

    def _anywhere(self, algebra: Array, count: int) -> Configurations:
        """Products of random elements of K, from the start on."""
        found = np.repeat(self.start[:1], count, axis=0)
        for _ in range(3):
            weights = self.random.normal(size=(count, len(algebra)))
            found = self.space.moved(found, weights @ algebra)
        return found

    # ---- the group -----------------------------------------------------------------------------

    def _completed(self) -> Array:
        """From solutions at more and more configurations, until twice there is nothing new."""
        here, vectors, algebra = self.start, [], np.empty((0, 6 * len(self.space.tree)))
        stable = 0
        for _ in range(MOST_BATCHES):
            free, margins = self._solutions(here)
            vectors += _reliable(free, margins)
            if len(algebra):
                vectors += _reliable(*self._solutions(self._anywhere(algebra, BATCH)))
            spanned = row_space(np.vstack(vectors), SETTLED)
            larger = self._closed_under_brackets(spanned)
            unsettled = len(row_space(np.vstack([larger, *vectors]))) - len(larger)
            stable = 0 if unsettled or len(larger) > len(algebra) else stable + 1
            algebra = larger
            if stable == 2 or len(algebra) == self.space.freedoms:
                return algebra
            here = self._walked(here, free)
        return self._closed_under_brackets(row_space(np.vstack(vectors)))

    def _closed_under_brackets(self, basis: Array) -> Array:
        while len(basis) > 1:
            i, j = np.tril_indices(len(basis), -1)
            larger = row_space(np.vstack([basis, self.space.bracket(basis[i], basis[j])]), SETTLED)
            if len(larger) == len(basis):
                break
            basis = larger
        return basis

    def _kept(self) -> Mask:
        """Whether each row is constant on C₀K: looked at on products of random elements of K."""
        seen = self.space.at(self._anywhere(self.algebra, 3 * BATCH))
        allowed = CONSTANT * (1.0 + seen.far) + self.rounding + self.left
        return np.all(np.abs(seen.values) <= allowed, axis=0)


def _reliable(solutions: list[Array], margins: Array) -> list[Array]:
    """Those at configurations far from singular ones, near which rounding turns them."""
    least_one = min(MARGIN, 0.1 * float(margins.max()))
    return [x for x, margin in zip(solutions, margins, strict=True) if margin >= least_one]


def null_space(jac: Array) -> tuple[Array, float]:
    """(k, columns); and the least singular value that is one. Rows have length 1, or nothing."""
    _, sizes, vectors = np.linalg.svd(np.vstack([jac, np.zeros((1, jac.shape[1]))]))
    counted = sizes[sizes > RANK_TOLERANCE * max(1.0, *sizes)]
    return vectors[len(counted) :], float(counted.min(initial=1.0))


def row_space(vectors: Array, tolerance: float = RANK_TOLERANCE) -> Array:
    """Orthonormal basis of the rows' span."""
    if not len(vectors):
        return vectors
    _, sizes, basis = np.linalg.svd(vectors, full_matrices=False)
    found: Array = basis[sizes > tolerance * max(float(sizes[0]), 1.0)]
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
