"""A c-space of a mechanism as `lierb.completion` explores it: configurations, rows, Jacobians.

A configuration is a tuple of poses, one for each node of the tree that is integrated, and the group
is the direct product of the nodes'. Absolute nodes have the pose of the joint's frame on their link,
seen from one frame of the ground; reduced ones the pose that their joint's coordinates are of.
"""

from __future__ import annotations

from types import ModuleType
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from lierb.arrays import Array, Pose, assembled, components, pose_components
from lierb.kernels.groups import se3, so3xr3
from lierb.kernels.mechanics.constraints import residuals
from lierb.kernels.mechanics.newton_euler import SE3, BodyConstants
from lierb.kernels.mechanics.rows import PITCHED, Rows
from lierb.kernels.mechanics.scale import ROUNDING, bearings, rounding_of
from lierb.kernels.mechanics.tree import GROUND, HERE, MASSLESS, Node
from lierb.kernels.numbers.vec import (
    ZERO6,
    add,
    cross_add,
    mat_t_vec,
    mat_vec_add,
    norm,
    scale,
    sub,
)
from lierb.link_coordinates import motions_of
from lierb.links import Connection
from lierb.mechanism_rows import System
from lierb.kernels.stepping.mechanism import NONE
from lierb.runs.mechanisms import plan_of

if TYPE_CHECKING:
    from lierb.mechanism import Mechanism

Configuration = tuple[Pose, ...]
GROUPS: dict[str, ModuleType] = {"reduced": se3, "SE3": se3, "SO3xR3": so3xr3}


class Place(NamedTuple):
    """Of rows between two nodes: their frames on both, and what they are made of.

    inner, outer : seen from the nodes' own frames; `outer` of the ground, where it is one of it.
    """

    at: Connection
    body: int
    parent: int
    inner: Pose
    outer: Pose
    constants: BodyConstants
    rows: Rows


class Space:
    """Lengths are in units of the mechanism's own, so that nothing depends on the unit of length.

    length : m.   rows : that say something of the pose, of all places.
    """

    def __init__(self, mechanism: Mechanism, cspace: str) -> None:
        self.mechanism, self.cspace = mechanism, cspace
        cspaces = (cspace,) * len(mechanism.links)
        self.tree: tuple[Node, ...] = plan_of(
            mechanism, cspaces, NONE, update="local", stages=((),), weights=(1.0,), multipliers=False
        ).tree
        self.nodes = {node.link: i for i, node in enumerate(self.tree) if node.link != MASSLESS}
        self.nodes[GROUND] = GROUND
        self.length = float(np.max(System(mechanism, 1).length))
        self.units = np.repeat((1.0, self.length), 3)
        self.frames = [pose_components(link.joint.body_frame) for link in mechanism.links]
        root = next(link for link in mechanism.links if link.parent == "ground")
        self.ground = pose_components(root.joint.ground_frame)
        self.hangs = [self._hang(i) for i in range(len(self.tree))]
        self.bases = [self._basis(node) for node in self.tree]
        ends = np.cumsum([0, *(len(basis) for basis in self.bases)])
        self.columns = [slice(*pair) for pair in zip(ends, ends[1:], strict=False)]
        self.freedoms = int(ends[-1])
        self.places = [self._place(at) for at in mechanism.connections]
        self.rows: Rows = tuple(r for place in self.places for r in place.rows)
        translational = [r.is_translational for r in self.rows]
        self.row_units = np.where(np.array(translational, dtype=bool), self.length, 1.0)

    # ---- what does not move --------------------------------------------------------------------

    def _outer(self, link: int, frame: Pose) -> Pose:
        """A frame on a link, or on the ground, seen from the node's own."""
        return se3.compose(se3.inverse(self.ground if link < 0 else self.frames[link]), frame)

    def _hang(self, i: int) -> Pose:
        """A reduced node's joint frame on what it hangs on."""
        node = self.tree[i]
        if node.parent >= 0 and self.tree[node.parent].link == MASSLESS:
            return HERE
        at = self.mechanism.joints[self.tree[i + 1 if node.link == MASSLESS else i].link]
        assert at.joint is not None
        return self._outer(at.parent, pose_components(at.joint.ground_frame))

    def _basis(self, node: Node) -> Array:
        """Unit velocities, (k, 6), of a node's algebra."""
        found = np.eye(6)[[slot >= 0 for slot in node.slots]]
        if PITCHED in node.slots:
            found[:, 5] = found[:, 2] * self.mechanism.links[node.link].joint.pitch / self.length
        return found / np.linalg.norm(found, axis=1, keepdims=True)

    def _place(self, at: Connection) -> Place:
        frames = (HERE, HERE)
        if at.joint is not None:
            frames = pose_components(at.joint.body_frame), pose_components(at.joint.ground_frame)
        inner, outer = self._outer(at.body, frames[0]), self._outer(at.parent, frames[1])
        rows = tuple(r for r in at.rows if r.is_holonomic)
        nodes = self.nodes[at.body], self.nodes[at.parent]
        return Place(at, *nodes, inner, outer, self.mechanism.constants(at), rows)

    def path(self, place: Place) -> list[int]:
        """The nodes that its rows depend on."""
        if self.cspace != "reduced":
            return sorted(i for i in (place.body, place.parent) if i != GROUND)
        above = [set(self._above(i)) for i in (place.body, place.parent)]
        return sorted(above[0] ^ above[1])

    def _above(self, i: int) -> list[int]:
        return [] if i == GROUND else [i, *self._above(self.tree[i].parent)]

    # ---- configurations ------------------------------------------------------------------------

    def of_poses(self, poses: list[Pose]) -> Configuration:
        """Of the links' poses in the ground's frame; what is off a joint's subgroup is left."""
        seats: dict[int, Pose] = {}
        found: list[Pose] = []
        for i, node in enumerate(self.tree):
            if node.link == MASSLESS:
                continue  # with the node after it
            seat = self._outer(GROUND, se3.compose(poses[node.link], self.frames[node.link]))
            if node.cspace == "SE3":
                found.append(seat)
            elif node.cspace == "SO3xR3":
                found.append((seat[0], self._outer(GROUND, poses[node.link])[1]))
            else:
                found += self._relative(i, seat, seats)
                seat = self._seat(i, found, seats)
            seats[i] = seat
        return tuple(found)

    def _relative(self, i: int, seat: Pose, seats: dict[int, Pose]) -> list[Pose]:
        """D of a reduced node, or of both that make up its joint."""
        joint = self.mechanism.links[self.tree[i].link].joint
        first = i - 1 if joint.factors else i
        base = self._base(first, seats)
        relative = se3.compose(se3.inverse(base), seat)
        motions = motions_of(joint)
        if motions is None:
            rigid = not len(self.bases[i])
            return [HERE if rigid else relative]
        numbers = motions.coordinates(relative)
        if joint.factors:
            return [f.motion(x) for f, x in zip(joint.factors, numbers, strict=True)]
        return [motions.pose(numbers)]

    def _base(self, i: int, seats: dict[int, Pose]) -> Pose:
        parent = self.tree[i].parent
        return self.hangs[i] if parent == GROUND else se3.compose(seats[parent], self.hangs[i])

    def _seat(self, i: int, configuration: list[Pose], seats: dict[int, Pose]) -> Pose:
        """A reduced node's frame; that of a massless one before it is filled in."""
        parent = self.tree[i].parent
        if parent != GROUND and parent not in seats:
            seats[parent] = self._seat(parent, configuration, seats)
        return se3.compose(self._base(i, seats), configuration[i])

    def moved(self, configuration: Configuration, motion: Array) -> Configuration:
        """C exp X, node by node; X is (6 nodes,)."""
        found = []
        for node, pose, x in zip(self.tree, configuration, motion.reshape(-1, 6), strict=True):
            group = GROUPS[node.cspace]
            found.append(group.compose(pose, group.exp(tuple(x * self.units))))
        return tuple(found)

    def lifted(self, velocities: Array) -> Array:
        """(n, freedoms) → (n, 6 nodes)."""
        parts = [velocities[:, c] @ b for c, b in zip(self.columns, self.bases, strict=True)]
        return np.hstack(parts)

    def bracket(self, a: Array, b: Array) -> Array:
        """Of elements of the algebra, (n, 6 nodes) each."""
        parts = []
        for i, node in enumerate(self.tree):
            x, y = (components(v[:, 6 * i : 6 * i + 6]) for v in (a, b))
            found = assembled(GROUPS[node.cspace].ad(x, y))
            parts.append(np.broadcast_to(found, (len(a), 6)))
        return np.hstack(parts)

    # ---- rows ----------------------------------------------------------------------------------

    def _movements(self, configuration: Configuration) -> dict[int, tuple[Pose, Array]]:
        """Of every node its frame, and (freedoms, 6) how the velocities move it, body-fixed."""
        found: dict[int, tuple[Pose, Array]] = {GROUND: (HERE, np.zeros((self.freedoms, 6)))}
        seats: dict[int, Pose] = {}
        for i, node in enumerate(self.tree):
            pose = configuration[i]
            own = np.zeros((self.freedoms, 6))
            own[self.columns[i]] = self.bases[i] * self.units
            if node.cspace == "SO3xR3":
                link = self.frames[node.link]
                arm = mat_t_vec(link[0], link[1])
                omega = components(own[:, :3])
                sliding = mat_t_vec(pose[0], components(own[:, 3:]))
                own = assembled(omega + cross_add(omega, arm, sliding))
                pose = pose[0], mat_vec_add(pose[0], arm, pose[1])
            elif node.is_reduced:
                carried = se3.inverse(se3.compose(self.hangs[i], pose))
                own = own + assembled(se3.Ad(carried, components(found[node.parent][1])))
                pose = se3.compose(self._base(i, seats), pose)
            seats[i] = pose
            found[i] = pose, own
        return found

    def at(self, configuration: Configuration) -> tuple[Array, Array, Array]:
        """h of all rows, their gradients, (rows, freedoms), over their lengths as rows on D, and
        these lengths."""
        nodes = self._movements(configuration)
        values, gradients, lengths = [], [], []
        for place in self.places:
            relative, moving = self._relative_motion(place, nodes)
            x = SE3.kinematics(place.constants, relative, ZERO6)
            values += residuals(place.rows, x, place.constants)
            for r in place.rows:
                row = assembled(r.jacobian(x, place.constants))
                size = float(np.linalg.norm(row * self.units)) or 1.0
                gradients.append(moving @ row / size)
                lengths.append(size)
        jac = np.array(gradients).reshape(-1, self.freedoms)
        return (
            np.array([float(h) for h in values]) / self.row_units,
            jac,
            np.array(lengths) / self.row_units,
        )

    def _relative_motion(
        self, place: Place, nodes: dict[int, tuple[Pose, Array]]
    ) -> tuple[Pose, Array]:
        """D, and how the velocities move it, (freedoms, 6)."""
        (body, moving), (parent, carrying) = nodes[place.body], nodes[place.parent]
        outer = se3.compose(parent, place.outer)
        relative = se3.compose(se3.inverse(outer), se3.compose(body, place.inner))
        own = se3.Ad(se3.inverse(place.inner), components(moving))
        carried = se3.inverse(se3.compose(place.outer, relative))
        return relative, assembled(sub(own, se3.Ad(carried, components(carrying))))

    def relatives(self, configuration: Configuration) -> list[Pose]:
        """D of every place."""
        nodes = self._movements(configuration)
        return [self._relative_motion(place, nodes)[0] for place in self.places]

    def sizes(self, configuration: Configuration) -> Array:
        """‖d‖ of every row, in units of the mechanism's length."""
        found = [
            float(norm(relative[1]))
            for place, relative in zip(self.places, self.relatives(configuration), strict=True)
            for _ in place.rows
        ]
        return np.array(found) / self.length

    def rounding(self, poses: list[Pose]) -> Array:
        """What rounding may leave of every row: places are rounded as far away as they are."""
        found = []
        for place in self.places:
            total = rounding_of(self.mechanism.parameters(self.mechanism.joints[place.at.body]),
                                poses[place.at.body])  # fmt: skip
            if place.at.parent >= 0:
                total = total + ROUNDING * norm(poses[place.at.parent][1])
            seen = len(self.mechanism.loops) > 0
            found += [float(total) * (seen or not r.is_of_joint) for r in place.rows]
        return np.array(found) / self.length

    def reversed(self, configuration: Configuration) -> Place | None:
        """A place that is held half a turn the wrong way round, which no row sees."""
        for place, relative in zip(self.places, self.relatives(configuration), strict=True):
            if any(bearing <= 0.0 for bearing in bearings(place.rows, relative[0])):
                return place
        return None
