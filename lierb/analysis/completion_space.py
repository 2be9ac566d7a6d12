"""`lierb.analysis.completion` takes a mechanism's c-space as configurations, rows, Jacobians.

A configuration has a pose for each node of the integrated tree, and the group is the direct product
of the nodes' groups. The pose of an absolute node is that of its link's joint frame in a common
frame on the ground. The pose of a reduced node is the relative pose D of its joint. All functions
take a batch of configurations.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np

from lierb.kernels.groups import se3, so3xr3
from lierb.kernels.mechanics.constraints import residuals
from lierb.kernels.mechanics.newton_euler import SE3, BodyConstants, Kinematics
from lierb.kernels.mechanics.rows import PITCHED, Row, Rows
from lierb.kernels.mechanics.scale import ROUNDING, bearings, length_of, rounding_of
from lierb.kernels.mechanics.tree import GROUND, HERE, MASSLESS, Node
from lierb.kernels.numbers.arithmetic import plain
from lierb.kernels.numbers.vec import ZERO6, Vec, add, cross_add, mat_t_vec, mat_vec_add, norm, sub
from lierb.kernels.systems.plan import UNSTABILISED
from lierb.kernels.systems.scheme import StagedScheme
from lierb.model.connections import Connection
from lierb.model.joints.coordinates import motions_of
from lierb.model.mechanism.mechanism import Mechanism
from lierb.model.mechanism.plan import mechanism_plan_of
from lierb.support.arrays import Array, Pose, assembled, components, pose_components

Configurations = Array  # (n, nodes, 12): rotations row by row, positions
Motions = dict[int, tuple[Pose, Vec]]  # frames, (n, 1), and twists, (n, freedoms), by node
GROUPS: dict[str, ModuleType] = {"reduced": se3, "SE3": se3, "SO3xR3": so3xr3}


class Place(NamedTuple):
    """A place has the rows between two nodes.

    inner, outer : joint frames in the frames of `body`, `parent`.
    second : second joint of rows that couple two.
    """

    at: Connection
    body: int
    parent: int
    inner: Pose
    outer: Pose
    constants: BodyConstants
    rows: Rows
    second: Place | None = None


class RowValues(NamedTuple):
    """All rows have values and gradients at n configurations, in units of the mechanism's length.

    values : h, (n, rows), zero for rows on velocities.
    gradients : (n, rows, freedoms), divided by `lengths`.
    lengths : (n, rows), of the rows' Jacobians with respect to D.   far : ‖d‖, (n, rows).
    upright : (n, places), False for a joint rotated by half a turn, where the rows vanish as well.
    """

    values: Array
    gradients: Array
    lengths: Array
    far: Array
    upright: Any


class Space:
    """The lengths of a mechanism's c-space are in units of the mechanism's length.

    length : m.   rows : rows of all places, without those of motors.
    """

    def __init__(self, mechanism: Mechanism, cspace: str) -> None:
        self.mechanism, self.cspace = mechanism, cspace
        cspaces = (cspace,) * len(mechanism.links)
        self.tree: tuple[Node, ...] = mechanism_plan_of(
            mechanism,
            cspaces,
            UNSTABILISED,
            update="local",
            method=StagedScheme(stages=((),), weights=(1.0,)),
            multipliers=False,
        ).tree
        self.nodes = {node.link: i for i, node in enumerate(self.tree) if node.link != MASSLESS}
        self.nodes[GROUND] = GROUND
        self.length = self._length()
        self.units = np.repeat((1.0, self.length), 3)
        self.frames = [pose_components(link.joint.body_frame) for link in mechanism.links]
        root = next(link for link in mechanism.links if link.parent == "ground")
        self.ground = pose_components(root.joint.ground_frame)
        self.hangs = [self._hang(i) for i in range(len(self.tree))]
        self.bases = [self._basis(node) for node in self.tree]
        ends = np.cumsum([0, *(len(basis) for basis in self.bases)])
        self.columns = [slice(*pair) for pair in pairwise(ends)]
        self.freedoms = max(int(ends[-1]), 1)  # one column of zeros if all links are fixed
        acting = tuple(at for at in mechanism.places if at.rows)
        self.places = [self._place(at) for at in (*mechanism.joints, *acting)]
        self.rows: Rows = tuple(r for place in self.places for r in place.rows)
        translational = [r.is_translational for r in self.rows]
        self.row_units = np.where(np.array(translational, dtype=bool), self.length, 1.0)

    # ---- constants -----------------------------------------------------------------------------

    def _length(self) -> float:
        """Return the largest length of a link, m, with arms from centre of mass to joints."""
        mechanism = self.mechanism
        lengths = [length_of(mechanism.parameters(at)) for at in mechanism.joints]
        for at in mechanism.joints:
            if at.parent >= 0:
                other = mechanism.parameters(mechanism.joints[at.parent])
                lengths.append(length_of(other._replace(body=mechanism.parameters(at).ground)))
        return float(max(lengths))

    def _outer(self, link: int, frame: Pose) -> Pose:
        """Return a frame on a link or the ground, relative to the node's frame."""
        return se3.compose(se3.inverse(self.ground if link < 0 else self.frames[link]), frame)

    def _hang(self, i: int) -> Pose:
        """Return a reduced node's joint frame on its parent."""
        node = self.tree[i]
        if node.parent >= 0 and self.tree[node.parent].link == MASSLESS:
            return HERE
        at = self.mechanism.joints[self.tree[i + 1 if node.link == MASSLESS else i].link]
        assert at.joint is not None
        return self._outer(at.parent, pose_components(at.joint.ground_frame))

    def _basis(self, node: Node) -> Array:
        """Return a basis of unit velocities, (k, 6), of a node's algebra."""
        basis = np.eye(6)[[slot >= 0 for slot in node.slots]]
        if PITCHED in node.slots:
            basis[:, 5] = basis[:, 2] * self.mechanism.links[node.link].joint.pitch / self.length
        scaled: Array = basis / np.linalg.norm(basis, axis=1, keepdims=True)
        return scaled

    def _place(self, at: Connection) -> Place:
        frames = (HERE, HERE)
        if at.joint is not None:
            frames = pose_components(at.joint.body_frame), pose_components(at.joint.ground_frame)
        inner, outer = self._outer(at.body, frames[0]), self._outer(at.parent, frames[1])
        rows = tuple(r for r in at.rows if not r.depends_on_time)
        nodes = self.nodes[at.body], self.nodes[at.parent]
        second = None
        if at.second >= 0:
            joint = self.mechanism.joints[at.second]
            second = self._place(joint._replace(rows=(), elements=at.elements))
        return Place(at, *nodes, inner, outer, self.mechanism.constants(at), rows, second)

    def path(self, place: Place) -> list[int]:
        """Return the nodes that the rows depend on."""
        if place.second is not None:
            return sorted({*self.path(place._replace(second=None)), *self.path(place.second)})
        if self.cspace != "reduced":
            return sorted(i for i in (place.body, place.parent) if i != GROUND)
        above = [set(self._above(i)) for i in (place.body, place.parent)]
        return sorted(above[0] ^ above[1])

    def _above(self, i: int) -> list[int]:
        return [] if i == GROUND else [i, *self._above(self.tree[i].parent)]

    # ---- configurations ------------------------------------------------------------------------

    def of_poses(self, poses: list[Pose]) -> Configurations:
        """Return the configuration of the links' poses, projected to the joints' subgroups."""
        frames: dict[int, Pose] = {GROUND: HERE}
        configuration: list[Pose] = []
        for i, node in enumerate(self.tree):
            if node.link == MASSLESS:
                continue  # with the node after it
            frame = self._outer(GROUND, se3.compose(poses[node.link], self.frames[node.link]))
            if node.cspace == "SO3xR3":
                frame = frame[0], self._outer(GROUND, poses[node.link])[1]
            own = self._factors(i, frame, frames) if node.is_reduced else [frame]
            for k, pose in enumerate(own, i + 1 - len(own)):
                base = self._base(k, frames) if node.is_reduced else HERE
                frames[k] = se3.compose(base, pose)
            configuration += own
        return np.array([[assembled(q + d) for q, d in configuration]])

    def _factors(self, i: int, frame: Pose, frames: dict[int, Pose]) -> list[Pose]:
        """Return D of a reduced node, or the D of both nodes of a product joint."""
        joint = self.mechanism.links[self.tree[i].link].joint
        base = self._base(i - 1 if joint.factors else i, frames)
        relative = se3.compose(se3.inverse(base), frame)
        motions = motions_of(joint)
        if motions is None:
            return [relative if len(self.bases[i]) else HERE]
        numbers = motions.coordinates(relative)
        if joint.factors:
            return [f.motion(x) for f, x in zip(joint.factors, numbers, strict=True)]
        return [motions.pose(numbers)]

    def _base(self, i: int, frames: Mapping[int, Pose]) -> Pose:
        """Return the frame to which a reduced node's pose is relative."""
        return se3.compose(frames[self.tree[i].parent], self.hangs[i])

    def moved(self, at: Configurations, motions: Array) -> Configurations:
        """Return C exp X, node by node; motions are (n, 6 nodes)."""
        moved = []
        for i, node in enumerate(self.tree):
            group = GROUPS[node.cspace]
            x = components(motions[:, 6 * i : 6 * i + 6] * self.units)
            pose = components(at[:, i, :9]), components(at[:, i, 9:])
            q, d = group.compose(pose, group.exp(x))
            moved.append(assembled(q + d))
        return np.stack(moved, axis=1)

    def lifted(self, velocities: Array) -> Array:
        """Map velocities from (n, freedoms) to (n, 6 nodes)."""
        parts = [velocities[:, c] @ b for c, b in zip(self.columns, self.bases, strict=True)]
        return np.hstack(parts)

    def bracket(self, a: Array, b: Array) -> Array:
        """Return the brackets of elements of the algebra, (n, 6 nodes) each."""
        parts = []
        for i, node in enumerate(self.tree):
            x, y = (components(v[:, 6 * i : 6 * i + 6]) for v in (a, b))
            parts.append(assembled(GROUPS[node.cspace].ad(x, y)))
        return np.hstack(parts)

    # ---- rows ----------------------------------------------------------------------------------

    def _motions(self, at: Configurations) -> Motions:
        """Return each node's frame, and its body-fixed twists by unit velocities."""
        motions: Motions = {GROUND: (HERE, ZERO6)}
        for i, node in enumerate(self.tree):
            pose: Pose = components(at[:, None, i, :9]), components(at[:, None, i, 9:])
            columns = np.zeros((1, self.freedoms, 6))
            columns[:, self.columns[i]] = self.bases[i] * self.units
            own = components(columns)
            if node.cspace == "SO3xR3":
                frame = self.frames[node.link]
                arm = mat_t_vec(frame[0], frame[1])
                own = own[:3] + cross_add(own[:3], arm, mat_t_vec(pose[0], own[3:]))
                pose = pose[0], mat_vec_add(pose[0], arm, pose[1])
            elif node.is_reduced:
                carrying = se3.inverse(se3.compose(self.hangs[i], pose))
                own = add(own, se3.Ad(carrying, motions[node.parent][1]))
                pose = se3.compose(se3.compose(motions[node.parent][0], self.hangs[i]), pose)
            motions[i] = pose, own
        return motions

    def _between(self, place: Place, motions: Motions) -> tuple[Pose, Vec]:
        """Return D, and its twists D⁻¹Ḋ by unit velocities."""
        (body, moving), (parent, carrying) = motions[place.body], motions[place.parent]
        to_parent = se3.inverse(se3.compose(parent, place.outer))
        relative = se3.compose(to_parent, se3.compose(body, place.inner))
        carried = se3.inverse(se3.compose(place.outer, relative))
        own = se3.Ad(se3.inverse(place.inner), moving)
        return relative, sub(own, se3.Ad(carried, carrying))

    def at(self, at: Configurations) -> RowValues:
        """Evaluate all rows."""
        n, motions = len(at), self._motions(at)
        values, gradients, lengths, far = [], [], [], []
        upright = np.ones((n, len(self.places)), dtype=bool)
        for number, place in enumerate(self.places):
            relative, moving = self._between(place, motions)
            x = SE3.kinematics(place.constants, relative, ZERO6)
            for bearing in bearings(place.rows, relative[0]):
                upright[:, number] &= np.ravel(bearing > 0.0)
            away = plain(norm(relative[1]))
            posed = tuple(r for r in place.rows if r.is_holonomic)
            of_pose = dict(zip(posed, residuals(posed, x, place.constants), strict=True))
            for r in place.rows:
                gradient, size = self._gradient(place, r, x, moving)
                if place.second is not None and r.second is not None:
                    other, carried = self._between(place.second, motions)
                    at_second = SE3.kinematics(place.second.constants, other, ZERO6)
                    gradient = (
                        gradient + self._gradient(place.second, r.second, at_second, carried)[0]
                    )
                gradients.append(gradient / size)
                values.append(of_pose.get(r, 0.0))
                lengths.append(size)
                far.append(away)
        return RowValues(
            self._columns(n, values) / self.row_units,
            np.swapaxes(self._columns(n, gradients, self.freedoms), 1, 2),
            self._columns(n, lengths) / self.row_units,
            self._columns(n, far) / self.length,
            upright,
        )

    def _gradient(self, place: Place, r: Row, x: Kinematics, moving: Vec) -> tuple[Array, Array]:
        """J of a row by unit velocities, and its length.   moving : twists by unit velocities."""
        row = assembled(r.jacobian(x, place.constants))
        size = np.sqrt(np.sum((row * self.units) ** 2, axis=-1))
        return np.sum(assembled(moving) * row, axis=-1), np.where(size == 0.0, 1.0, size)

    def _columns(self, n: int, of_rows: list[Any], *shape: int) -> Array:
        """Stack the rows' numbers, batched or not, to (n, rows) or (n, shape, rows)."""
        stacked = np.zeros((n, *(shape or (1,)), len(of_rows)))
        for number, column in enumerate(of_rows):
            stacked[..., number] = plain(column)
        return stacked if shape else stacked[:, 0]

    def rounding(self, poses: list[Pose]) -> Array:
        """Return bounds of rows' rounding errors, (rows,), which grow with the links' distance.

        For rows of joints, these bounds matter only in redundant loops.
        """
        bounds = []
        for place in self.places:
            joint = self.mechanism.joints[place.at.body]
            total = rounding_of(self.mechanism.parameters(joint), poses[place.at.body])
            if place.at.parent >= 0:
                total = total + ROUNDING * norm(poses[place.at.parent][1])
            has_loops = len(self.mechanism.loops) > 0
            bounds += [float(total) * (has_loops or not r.is_of_joint) for r in place.rows]
        return np.array(bounds) / self.length
