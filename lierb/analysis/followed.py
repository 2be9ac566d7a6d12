"""Directions of a model's numbers along which its loops and constraints stay closed.

The pin of a planar loop may move in the plane, but not across it. A fit holds such directions: the
model has no start beside them, or cannot move. A redundant third crank of a parallelogram closes at
one pose with a pin that is off along the coupler's path; rows are therefore compared at other poses
of the motion, too.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lierb.analysis.identifiability import HELD, Direction, described
from lierb.errors import LierbError
from lierb.lie import se3
from lierb.model.problem import as_mechanism
from lierb.runs.parameters import Parameter, labels_of, misfits_of, slices_of, units_of
from lierb.runs.start_directions import Start
from lierb.runs.variations import Variation
from lierb.support.arrays import Array

TURN = 0.2  # of the fastest link between poses that are compared, rad
SLOWEST = 1e-6  # turn of a link by a random motion of 1 rad/s and 1 m/s, if it can turn
SEED = 2016
FELT = 1e-9  # least change of scaled rows by 1 m or 1 rad that is more than rounding
MISSED = 1e-6  # share of a change that no motion of the links follows, if it is not rounding
ROUNDING = 1e-9  # of the combinations of numbers that loops follow


class Followed(NamedTuple):
    """Changes of a model's numbers by those of them that are unknowns.

    free : indices of the unknowns among the numbers.
    matrix : (…, numbers, unknowns), with the unit matrix in the rows `free`.
    """

    free: NDArray[np.int64]
    matrix: Array

    def part(self, which: Any) -> Followed:
        """Return those of some experiments."""
        return self._replace(matrix=self.matrix[which])

    def by_unknowns(self, derivatives: Array) -> Array:
        """Return derivatives by the unknowns.   derivatives : by all numbers, (…, numbers)."""
        return derivatives if len(self.free) == self.matrix.shape[-2] else derivatives @ self.matrix

    @property
    def depends(self) -> NDArray[np.bool_]:
        """Return True for the numbers that change with others, [number]."""
        changes = np.count_nonzero(self.matrix, axis=-1)
        depends = np.any(np.atleast_2d(changes), axis=0)
        depends[self.free] = False
        return np.asarray(depends)

    @property
    def held(self) -> Array:
        """Return the directions that are held, (…, directions, numbers)."""
        count = self.matrix.shape[-2]
        others = np.setdiff1d(np.arange(count), self.free)
        held = np.broadcast_to(np.eye(count)[others], (*self.matrix.shape[:-2], len(others), count))
        held = held.copy()
        held[..., self.free] = -self.matrix[..., others, :]
        return held


def followed(variation: Variation, count: int, experiments: int | None = None) -> Followed:
    """Return the changes of a model's numbers with which all starts of an experiment close.

    count : trajectories of an experiment.   experiments : their number; None for a single one,
    without the axis.
    """
    numbers = [p for p in variation.parameters if not p.is_start]
    size, lead = sum(p.size for p in numbers), () if experiments is None else (experiments,)
    matrix = np.broadcast_to(np.eye(size), (*lead, size, size))
    free = Followed(np.arange(size), matrix)
    moving = [p for p in numbers if p.moves_start]
    start = variation.start
    if not moving or not (start.mechanism.loops or start.with_rows):
        return free
    pairs = [misfits_of(moving, each) for each in (start, *_elsewhere(start))]
    wanted, missed = (
        np.concatenate([_by_experiment(x, count) for x in arrays], axis=1)
        for arrays in zip(*pairs, strict=True)
    )
    scales = np.maximum(np.linalg.norm(wanted, axis=1).max(axis=0), FELT)
    missed = missed / scales
    slices = slices_of(numbers)
    columns = np.concatenate([np.arange(size)[slices[p.name]] for p in moving])
    held = _pivots(missed)
    if not held:
        return free
    rest = [i for i in range(len(columns)) if i not in held]
    follow = -np.linalg.pinv(missed[..., held], rcond=MISSED) @ missed[..., rest]
    follow[np.abs(follow) < ROUNDING] = 0.0
    follow *= scales[rest] / scales[held][:, None]
    matrix = matrix.copy()
    matrix[..., columns[held], columns[held]] = 0.0
    rows, others = np.meshgrid(columns[held], columns[rest], indexing="ij")
    matrix[..., rows, others] = follow if lead else follow[0]
    kept = np.setdiff1d(np.arange(size), columns[held])
    return Followed(kept, matrix[..., kept])


def _elsewhere(start: Start) -> list[Start]:
    """Return the start at other poses of the mechanism's motion, without its motors."""
    gears = [force for force in start.mechanism.forces if force.kind.joints > 1]
    walking = as_mechanism(start.model, forces=gears, constraints=start.mechanism.constraints)
    links, random = walking.names, np.random.default_rng(SEED)
    poses = dict(zip(links, start.poses, strict=True))
    given = {link: random.uniform(-1.0, 1.0, 6) for link in links}
    t0, starts = float(start.t0), []
    try:
        twists = walking.project(given, poses, t0=t0)
        fastest = max(float(np.max(np.linalg.norm(x[..., :3], axis=-1))) for x in twists.values())
        for step in (-TURN, TURN) if fastest > SLOWEST else ():
            moved = {k: poses[k] @ se3.exp(step / fastest * twists[k]) for k in links}
            closed = walking.close(moved, t0=t0)
            at_rest = dict.fromkeys(start.model.link_names, np.zeros(6))
            own = dict(zip(start.model.link_names, closed.values(), strict=True))
            starts.append(Start(start.model, own, at_rest, t0))
    except LierbError:  # beyond a dead point, for instance
        pass
    return starts


def held_directions(numbers: Sequence[Parameter], held: Array) -> tuple[Direction, ...]:
    """Describe directions that loops hold.

    numbers : parameters of the model.   held : `Followed.held` of one experiment.
    """
    labels, units = ([x for p in numbers for x in names(p)] for names in (labels_of, units_of))
    return tuple(described(change, labels, np.zeros(len(labels)), units, HELD) for change in held)


def _by_experiment(changes: Array, count: int) -> Array:
    """Return changes (directions, n or 1, rows) as (experiments or 1, rows, directions)."""
    n = changes.shape[1]
    groups = n // count if n > 1 else 1
    return np.moveaxis(changes, 0, -1).reshape(groups, -1, len(changes))


def _pivots(missed: Array) -> list[int]:
    """Return the columns that depend on the other ones if all combinations are to vanish.

    missed : (experiments, rows, columns); the Gram–Schmidt process takes the largest column first.
    """
    missed, pivots = missed.copy(), list[int]()
    while (sizes := np.linalg.norm(missed, axis=1)).max(initial=0.0) > MISSED:
        pivot = int(np.argmax(np.sum(sizes**2, axis=0)))
        size = sizes[:, pivot]
        own = missed[..., pivot] / np.where(size > MISSED, size, np.inf)[:, None]
        for _ in range(2):  # the second time removes rounding
            missed -= own[..., None] * (own[:, None, :] @ missed)
        missed[..., pivot] = 0.0
        pivots.append(pivot)
    return pivots
