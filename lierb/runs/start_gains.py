"""Gains of an objective by what moves the start of a tree: transposed directions of a start.

`lierb.runs.start_directions` projects each direction. The transposed map serves all directions at
once, and needs no decomposition of all rows, as the motions of a tree are known: the links are
carried by relative motions in the joints.

Where a joint moves on its bodies, the links are carried along, and no row is violated. A change of
poses or twists is projected by least kinetic energy, P = S (SᵀMS)⁻¹ SᵀM for motions S of the links
by free relative motions. Twists follow changed poses by (1 − P) of any twists that fit them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property

import numpy as np

from lierb.kernels.groups import se3
from lierb.kernels.mechanics.rows import Rows
from lierb.kernels.numbers.arithmetic import plain
from lierb.kernels.numbers.dual import Dual
from lierb.kernels.numbers.tape import Tape
from lierb.kernels.numbers.vec import Vec, add, cross_add, dot
from lierb.model.connections import NOWHERE
from lierb.model.mechanism.decomposition import RANK_TOLERANCE
from lierb.model.mechanism.row_system import velocity_of
from lierb.runs.parameters import Parameter
from lierb.runs.start_directions import Frames, Start, carried, turned
from lierb.support.arrays import Array

FRAMES = ("ground_frame", "body_frame")
Gains = Mapping[str, Array]  # by numbers of fields of the inputs, [number][trajectory]


class TreeStart:
    """Start of a tree whose joints have rows of poses, none of which depends on others."""

    def __init__(self, start: Start) -> None:
        self.start, self.mechanism, self.count = start, start.mechanism, start.count
        self.links = range(len(start.poses))

    @cached_property
    def is_regular(self) -> bool:
        """True if this is such a tree."""
        rows = self._rows
        if self.mechanism.loops or self.start.with_rows:
            return False
        if not all(r.is_holonomic and r.second is None for own in rows for r in own):
            return False
        sizes = [values for _, values, _ in self._decomposed]
        return all((x[:, -1:] > RANK_TOLERANCE * x[:, :1]).all() for x in sizes if x.size)

    def moves(self, p: Parameter) -> bool:
        """Return whether a parameter is of the start, or of frames of joints."""
        of_frames = p.moves_start and all(name.endswith(FRAMES) for name in p.seeds(self.start))
        return self.is_regular and (p.is_start or of_frames)

    def gains_of_frames(self, gains: Gains) -> dict[str, Array]:
        """Return the gains by joints' frames through the start.   gains : by the start."""
        start, frames = self.start, _RecordedFrames(self.start)
        poses, twists = carried(self.mechanism, frames.parameters, start.placed, start.moving)
        results = [
            pair
            for i, prefix in enumerate(start.model.fields)
            for name, numbers in (("pose", sum(poses[i], ())), ("twist", twists[i]))
            for pair in zip(numbers, gains[f"{prefix}{name}"], strict=True)
        ]
        found: dict[str, list[Array]] = {}
        for field, gain in zip(frames.fields, frames.tape.gains(results), strict=True):
            found.setdefault(field, []).append(gain)
        return {field: np.stack([plain(x) for x in own]) for field, own in found.items()}

    def gains_of_start(self, gains: Gains) -> dict[str, Array]:
        """Return the gains by changes of poses and twists in the body's axes, by field."""
        start, fields, tape = self.start, self.start.model.fields, Tape()
        of_twists = np.concatenate([gains[f"{prefix}twist"] for prefix in fields]).T
        admitted = self._projected_back(of_twists)
        changes: list[Vec] = [tuple(tape.input() for _ in range(6)) for _ in fields]
        poses = [turned(pose, own) for pose, own in zip(start.placed, changes, strict=True)]
        results = [
            pair
            for prefix, pose in zip(fields, poses, strict=True)
            for pair in zip(sum(pose, ()), gains[f"{prefix}pose"], strict=True)
        ]
        relative = self._relative_back(of_twists - admitted)
        frames = Frames(start, {})
        for i in self.links:
            x, body, _ = frames.kinematics(self.mechanism.joints[i], poses, start.moving)
            u, sizes, vt = self._decomposed[i]
            along = _times(vt[:, : sizes.shape[1]], relative[:, i])
            of_rows = _times(u, along / sizes)
            for r, gain in zip(self._rows[i], of_rows.T, strict=True):
                rate = r.prescribed_rate(x, body) - dot(r.jacobian(x, body), velocity_of(x))
                results.append((rate, gain))
        of_poses = np.stack(np.broadcast_arrays(*tape.gains(results)), -1)
        parts = (("twist", admitted), ("pose", self._projected_back(of_poses)))
        return {
            f"{prefix}{name}": array[:, 6 * i : 6 * i + 6].T
            for name, array in parts
            for i, prefix in enumerate(fields)
        }

    def _projected_back(self, gains: Array) -> Array:
        """Return Pᵀ gains, (n, 6 links)."""
        motions, metrics = self._motions, self._metrics
        moving = np.concatenate(
            [metrics[i] @ motions[:, 6 * i : 6 * i + 6] for i in self.links], axis=1
        )
        sizes = np.sqrt((moving * moving).sum(axis=1))
        q, r = np.linalg.qr(moving / sizes[:, None])
        of_motions = _times(np.swapaxes(motions, 1, 2), gains) / sizes
        y = _times(q, np.linalg.solve(np.swapaxes(r, 1, 2), of_motions[..., None])[..., 0])
        parts = [_times(np.swapaxes(metrics[i], 1, 2), y[:, 6 * i : 6 * i + 6]) for i in self.links]
        return np.concatenate(parts, axis=1)

    def _relative_back(self, gains: Array) -> Array:
        """Return gains by relative twists, (n, links, 6).   gains : by twists, (n, 6 links)."""
        tape = Tape()
        relative: list[Vec] = [tuple(tape.input() for _ in range(6)) for _ in self.links]
        twists = (Dual(0.0, (x,)) for twist in self._twists(relative) for x in twist)
        found = np.stack(np.broadcast_arrays(*tape.gains(zip(twists, gains.T, strict=True))), -1)
        return found.reshape(-1, len(self.links), 6)

    # ---- motions of the links -------------------------------------------------------------------

    @cached_property
    def _rows(self) -> list[Rows]:
        return [self.mechanism.joints[i].rows for i in self.links]

    @cached_property
    def _decomposed(self) -> list[tuple[Array, Array, Array]]:
        """Singular value decompositions of the rows of each joint, by its relative twist."""
        frames, found = Frames(self.start, {}), []
        for i, rows in enumerate(self._rows):
            at = self.mechanism.joints[i]
            x, body, _ = frames.kinematics(at, self.start.placed, self.start.moving)
            matrix = [_stacked(r.jacobian(x, body), self.count) for r in rows]
            shape = self.count, len(rows), 6
            found.append(np.linalg.svd(np.stack(matrix, 1) if matrix else np.zeros(shape)))
        return [(u[..., : v.shape[1]], v, vt) for u, v, vt in found]

    def _twists(self, relative: Sequence[Vec]) -> list[Vec]:
        """Return twists of all links for relative twists in their joints."""
        twists: dict[int, Vec] = {}
        for i in self.mechanism.order:
            at, own = self.mechanism.joints[i], relative[i]
            if at.parent != NOWHERE:
                d = self.mechanism.relative(at, self.start.placed)
                own = add(own, self.mechanism.carried(at, d, twists))
            twists[i] = se3.Ad(self.mechanism.parameters(at).body, own)
        return [twists[i] for i in self.links]

    @cached_property
    def _motions(self) -> Array:
        """Twists of all links by free relative twists, (n, 6 links, freedoms)."""
        free = [vt[:, sizes.shape[1] :] for _, sizes, vt in self._decomposed]
        ends = np.cumsum([0, *(x.shape[1] for x in free)])
        relative = []
        for first, own in zip(ends, free, strict=False):
            units = np.zeros((6, ends[-1], self.count))
            units[:, first : first + own.shape[1]] = own.T
            relative.append(tuple(units))
        return _by_trajectory([x for twist in self._twists(relative) for x in twist])

    @cached_property
    def _metrics(self) -> list[Array]:
        """Matrices from the twist of a link to y, with ‖y‖² twice its kinetic energy."""
        matrices = []
        for metric in self.start.system.metrics:
            twist = tuple(np.eye(6)[:, :, None])
            moving = cross_add(twist[:3], metric.com, twist[3:])
            y = metric(twist[:3], moving)
            rows = [np.broadcast_to(x, (6, self.count)) for x in y]
            matrices.append(_by_trajectory(rows))
        return matrices


class _RecordedFrames(Frames):
    """Joints whose frames are inputs of a tape."""

    def __init__(self, start: Start) -> None:
        super().__init__(start, {})
        self.tape, self.fields = Tape(), list[str]()

    def _numbers(self, field: str, numbers: Vec) -> Vec:
        if not field.endswith(FRAMES):
            return numbers
        self.fields += [field] * len(numbers)
        return tuple(self.tape.opened(numbers))


def _times(matrix: Array, vector: Array) -> Array:
    """Return products of which no bit depends on the number of trajectories."""
    return np.asarray((matrix @ np.ascontiguousarray(vector)[..., None])[..., 0])


def _by_trajectory(rows: Sequence[Array]) -> Array:
    """Return matrices, of which NumPy multiplies each by the same code, from rows (k, n)."""
    return np.ascontiguousarray(np.moveaxis(np.stack(rows), -1, 0))


def _stacked(numbers: Sequence, count: int) -> Array:
    return np.stack([np.broadcast_to(plain(x), (count,)) for x in numbers], -1)
