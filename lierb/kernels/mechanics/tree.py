"""Bodies that hang on each other: a tree of links, and how it moves.

A *node* is a link, or a massless piece between two motions that make up one joint. It hangs on the
node before it, or on the ground, by D = (Q, d): its frame, seen from the joint's frame there. In
joint axes its own frame is the joint's, so that

    T = A D,   V = Ad(T⁻¹) V′ + V_rel,   V̇ = Ad(T⁻¹) V̇′ + b + S ν̇,

with A constant, V′ of the node before it, S the joint's free directions, and b all that V̇ has
without ν̇. *Reduced*: D and V_rel = S ν are the state, S is constant, and b = [Ad(T⁻¹)V′, V_rel].
*Absolute*: C and V of every node are the state; S spans what the joint's rows leave free where the
node is, on its joint or off it, and b satisfies the rows: the saddle point of M and these rows,
solved on their null space. `lierb.kernels.mechanics.tree_dynamics` has ν̇.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

from lierb.kernels.functions.signals import NO_SIGNALS, Signals
from lierb.kernels.groups import se3
from lierb.kernels.mechanics.newton_euler import Kinematics
from lierb.kernels.mechanics.rows import PITCHED, Rows
from lierb.kernels.mechanics.saddle import kinds_of
from lierb.kernels.mechanics.spatial import (
    Pose,
    Rigid,
    twist_at,
)
from lierb.kernels.mechanics.subgroup import Slots
from lierb.kernels.numbers.vec import (
    IDENTITY,
    UNIT,
    ZERO3,
    ZERO6,
    Mat,
    Vec,
    add,
    axpy,
    cross,
    cross_add,
    dot,
    mat_t_vec,
    mat_vec_add,
    neg,
    row,
    sub,
)
from lierb.kernels.numbers.zero import ZERO

GROUND = -1  # in place of a node's number
MASSLESS = -1  # in place of a link's number
NONE = -1  # in place of a joint's number
FEW = 3  # columns whose sum is less than a twist carried on
FREE: Slots = (0, 1, 2, 3, 4, 5)
HERE: Pose = (IDENTITY, ZERO3)


@dataclass(frozen=True)
class Node:
    """A link, or a massless piece, and how it hangs on what is before it.

    parent : number of that node, or GROUND.   link : number of its link, or MASSLESS.
    cspace : "reduced", or "SE3" or "SO3xR3" of its own pose.
    slots : of reduced coordinates: which components of V_rel are free.
    rows : what its joint asks for beyond the slots.
    """

    parent: int
    link: int
    cspace: str
    slots: Slots
    rows: Rows

    @property
    def is_reduced(self) -> bool:
        return self.cspace == "reduced"

    @cached_property
    def free(self) -> tuple[int, ...]:
        """Of the six directions of its joint those in which it is free; see `TreeMotion.free`."""
        if self.is_reduced:
            return tuple(i for i, slot in enumerate(self.slots) if slot >= 0)
        held, fixed, _ = kinds_of(self.rows)
        turns = tuple(k for k in range(3) if k not in fixed)
        return turns + tuple(3 + j for j in range(3) if j not in held)

    @cached_property
    def others(self) -> Rows:
        """The rows that are not kept by the null space of rows on which the tree is solved."""
        return self.rows if self.is_reduced else tuple(kinds_of(self.rows)[2])


@dataclass(frozen=True)
class Connection:
    """What acts between a frame on a node and one on another, or on the ground.

    rows : that act there.
    hangs : whether its frames are those of the joint by which `node` hangs on `other`: D is known.
    joint : number of the joint whose frames they are; NONE: the nodes' own, and the user's ground.
    """

    node: int
    other: int
    rows: Rows = ()
    hangs: bool = False
    joint: int = NONE


class NodeConstants(NamedTuple):
    """Of a node, in joint axes.

    rigid : about its joint's point.   inertia, com : about, and of, the centre of mass.
    hang : A, the joint's frame on the node before it, or on the ground.
    gravity : of a node on the ground, in the joint's axes there; else nothing.
    frame : its own frame, seen from the user's body frame.
    """

    rigid: Rigid
    inertia: Mat
    com: Vec
    hang: Pose
    gravity: Vec
    frame: Pose
    pitch: Any


class Ends(NamedTuple):
    """A connection's frames on both nodes, or on the ground; what its rows are made of."""

    inner: Pose
    outer: Pose
    pitch: Any = ZERO
    length: Any = ZERO
    elements: tuple[Any, ...] = ()


class TreeConstants(NamedTuple):
    """Everything about a mechanism that does not change.

    ends : of the plan's connections.   elements : what each is made of.
    dropped : how many rows depended on others at the start.
    signals : of the time that the mechanism is asked about.
    girth : of all nodes, as of one body.
    """

    nodes: tuple[NodeConstants, ...]
    ends: tuple[Ends, ...]
    gravity: Vec
    elements: tuple[Any, ...] = ()
    dropped: Any = ZERO
    signals: Signals = NO_SIGNALS
    girth: Any = ZERO

    @property
    def mass(self) -> Any:
        """Of some link: a number such as all are."""
        return next(n.rigid.mass for n in self.nodes if n.rigid.mass is not ZERO)


class Relative(NamedTuple):
    """How a connection's inner frame moves, seen from the outer one.

    seat : the inner frame seen from the other node, or from the ground.
    carried : twist of the inner frame, did it rest on the other node.
    fall : acceleration of the ground, if that is the other, seen from where `seat` is; else None.
    """

    x: Kinematics
    seat: Pose
    carried: Vec
    fall: Vec | None


class TreeMotion:
    """A tree at one state.

    poses : D of reduced nodes; C of others, seen from the ground's frame at their tree's root.
    velocities : V_rel of reduced nodes; V of others, as their c-space has it.
    """

    def __init__(
        self,
        nodes: Sequence[Node],
        body: TreeConstants,
        poses: Sequence[Pose],
        velocities: Sequence[Vec],
        time: Any = ZERO,
    ) -> None:
        self.nodes, self.body, self.time = tuple(nodes), body, time
        self.steps: list[Pose] = []  # T
        self.carried: list[Vec] = []  # Ad(T⁻¹) V′
        self.relative: list[Vec] = []  # V_rel
        self.twists: list[Vec] = []  # V, of a frame in joint axes
        self.directions: list[list[Vec]] = []  # S
        self.own: list[range] = []  # numbers of these among all
        self._poses = [*poses]
        self._places: dict[int, Pose] = {}
        self._columns: dict[int, dict[int, Vec]] = {}
        self._above: dict[int, dict[int, Vec]] = {}
        self._rates: dict[int, Any] = {}  # ν
        for i, (node, constants) in enumerate(zip(nodes, body.nodes, strict=True)):
            first = self.own[-1].stop if self.own else 0
            self.own.append(range(first, first + len(node.free)))
            if node.is_reduced:
                self._hang_on(i, node, constants, poses[i], velocities[i])
            else:
                self._place_apart(i, node, constants, poses[i], velocities[i])
            self.directions.append(self.free(i))

    def _hang_on(
        self, i: int, node: Node, constants: NodeConstants, d: Pose, velocity: Vec
    ) -> None:
        is_root = node.parent == GROUND
        self.steps.append(d if is_root else se3.compose(constants.hang, d))
        self._rates |= zip(self.own[i], (velocity[k] for k in node.free), strict=True)
        carried = ZERO6
        if not is_root:
            columns = self._from_above(i) if joint_space_pays(self.nodes) else {}
            if 0 < len(columns) <= FEW:
                carried = combined([self._rates[j] for j in columns], [*columns.values()])
            else:
                carried = self.carry(i, self.twists[node.parent])
        self.carried.append(carried)
        self.relative.append(velocity)
        self.twists.append(add(carried, velocity))

    def _place_apart(
        self, i: int, node: Node, constants: NodeConstants, c: Pose, velocity: Vec
    ) -> None:
        place, twist = c, velocity
        if node.cspace == "SO3xR3":
            arm = neg(constants.com)  # from the centre of mass to the joint's point
            place = c[0], mat_vec_add(c[0], arm, c[1])
            moving = cross_add(velocity[:3], arm, mat_t_vec(c[0], velocity[3:]))
            twist = velocity[:3] + moving
        self._places[i] = place
        step, carried = place, ZERO6
        if node.parent != GROUND:
            step = se3.compose(se3.inverse(self.place(node.parent)), place)
            carried = twist_at(step, self.twists[node.parent])
        self.steps.append(step)
        self.carried.append(carried)
        self.relative.append(sub(twist, carried))
        self.twists.append(twist)

    def columns(self, i: int) -> dict[int, Vec]:
        """Twists of a node, by the motion of one free direction each: of its own joint, and of all
        before it.
        """
        if i not in self._columns:
            own = dict(zip(self.own[i], self.directions[i], strict=True))
            self._columns[i] = self._from_above(i) | own
        return self._columns[i]

    def _from_above(self, i: int) -> dict[int, Vec]:
        """Those of the joints before its own."""
        parent = self.nodes[i].parent
        if parent == GROUND:
            return {}
        if i not in self._above:
            self._above[i] = {
                j: self.carry(i, column, is_constant=j in self.own[parent])
                for j, column in self.columns(parent).items()
            }
        return self._above[i]

    def carry(self, i: int, twist: Vec, is_constant: bool = False) -> Vec:
        """What a node would have of a twist of the node before it, did it rest there: Ad(T⁻¹) V.

        is_constant : whether the twist is: then Ad(A⁻¹) V is, and found once.
        """
        node = self.nodes[i]
        if node.is_reduced and node.parent != GROUND:
            is_next = self.nodes[node.parent].parent == GROUND  # of whose twists most is zero
            if is_constant or is_next:
                return twist_at(self._poses[i], twist_at(self.body.nodes[i].hang, twist))
        return twist_at(self.steps[i], twist)

    def place(self, i: int) -> Pose:
        """A node's frame, seen from the ground's frame at its tree's root."""
        if i not in self._places:
            parent = self.nodes[i].parent
            step = self.steps[i]
            self._places[i] = step if parent == GROUND else se3.compose(self.place(parent), step)
        return self._places[i]

    def root(self, i: int) -> int:
        return root_of(self.nodes, i)

    def pose(self, i: int) -> Pose:
        """A node's frame, seen from the ground."""
        return se3.compose(self.body.nodes[self.root(i)].hang, self.place(i))

    def hung(self, i: int) -> Pose:
        """D of a node."""
        node, hang = self.nodes[i], self.body.nodes[i].hang
        if node.is_reduced or node.parent == GROUND:
            return self._poses[i] if node.is_reduced else self.place(i)
        return se3.compose(se3.inverse(hang), self.steps[i])

    def between(self, connection: Connection, ends: Ends) -> Relative:
        i, other = connection.node, connection.other
        if connection.hangs:
            seat, carried, d = self.steps[i], self.carried[i], self.hung(i)
            fall = neg(self.body.nodes[i].gravity) if other == GROUND else None
            return Relative(self.kinematics(d, self.relative[i]), seat, carried, fall)
        seat = se3.compose(self._seen_from(other, i), ends.inner)
        carried = ZERO6 if other == GROUND else twist_at(seat, self.twists[other])
        velocity = sub(twist_at(ends.inner, self.twists[i]), carried)
        d = se3.compose(se3.inverse(ends.outer), seat)
        fall = neg(self.body.gravity) if other == GROUND else None
        return Relative(self.kinematics(d, velocity), seat, carried, fall)

    def kinematics(self, d: Pose, velocity: Vec) -> Kinematics:
        omega, v = velocity[:3], velocity[3:]
        return Kinematics(d[0], d[1], omega, ZERO3, v, cross(omega, v), True, self.time)

    def _seen_from(self, other: int, i: int) -> Pose:
        """A node's frame, seen from another node's, or from the ground."""
        if other == GROUND:
            return self.pose(i)
        if self.root(other) == self.root(i):
            return se3.compose(se3.inverse(self.place(other)), self.place(i))
        return se3.compose(se3.inverse(self.pose(other)), self.pose(i))

    def free(self, i: int) -> list[Vec]:
        """S, the directions in which a node can move on its joint."""
        node, pitch = self.nodes[i], self.body.nodes[i].pitch
        if node.is_reduced:
            return free_directions(node.slots, pitch)
        held, fixed, _ = kinds_of(node.rows)
        turns = [UNIT[k] + ZERO3 for k in range(3) if k not in fixed]
        if not held:
            return [*turns, *(ZERO3 + UNIT[j] for j in range(3))]
        q = self.hung(i)[0] if len(held) < 3 else IDENTITY
        return [*turns, *(ZERO3 + row(q, j) for j in range(3) if j not in held)]

    def held(self, i: int, v: Vec) -> Vec:
        """Of a vector in a node's axes, the part along which its joint's rows hold the point."""
        held, _, _ = kinds_of(self.nodes[i].rows)
        if self.nodes[i].is_reduced or not held:
            return ZERO3
        if len(held) == 3:
            return v
        total, q = ZERO3, self.hung(i)[0]
        for j in held:
            total = axpy(dot(row(q, j), v), row(q, j), total)
        return total

    def biases(self) -> list[Vec]:
        """b of every node."""
        found = []
        for i, (carried, relative) in enumerate(zip(self.carried, self.relative, strict=True)):
            bend = cross(relative[:3], relative[3:])
            b = se3.ad(carried, relative)
            found.append(b[:3] + sub(b[3:], self.held(i, bend)))
        return found


def root_of(nodes: Sequence[Node], i: int) -> int:
    """The node on the ground that another one hangs on in the end."""
    while nodes[i].parent != GROUND:
        i = nodes[i].parent
    return i


def free_directions(slots: Slots, pitch: Any) -> list[Vec]:
    """S of slots: unit vectors, and for a screw one combination."""
    directions = []
    for i, slot in enumerate(slots):
        if slot >= 0:
            unit: list[Any] = [1.0 if j == i else ZERO for j in range(6)]
            if i == 2 and slots[5] == PITCHED:
                unit[5] = pitch
            directions.append(tuple(unit))
    return directions


@lru_cache(64)
def joint_space_pays(nodes: tuple[Node, ...]) -> bool:
    """Whether the mass matrix takes fewer operations than articulated bodies.

    By numbers of multiplications: of a column carried to one more node, with its products, 60; of
    an inertia, 170; of a factorisation, n³/6.
    """
    free = [len(node.free) for node in nodes]
    above: list[int] = []
    for node in nodes:
        is_root = node.parent == GROUND
        above.append(0 if is_root else above[node.parent] + free[node.parent])
    hanging = sum(node.parent != GROUND for node in nodes)
    blocks = sum(n**3 for n in free) / 2
    return 60 * sum(above) + sum(free) ** 3 / 6 <= 170 * hanging + blocks


def combined(weights: Sequence[Any], vectors: Sequence[Vec], start: Vec = ZERO6) -> Vec:
    total = start
    for weight, v in zip(weights, vectors, strict=True):
        total = axpy(weight, v, total)
    return total
