"""Compute the kinematics of a tree of links.

A *node* is a link, or a massless frame between two motions that form one joint. It is connected
to its parent node, or to the ground; D = (Q, d) is its frame in the joint's frame there. In joint
axes the node's own frame is the joint's, so that

    T = H D,   V = Ad(T⁻¹) V′ + V_rel,   A = Ad(T⁻¹) A′ + b + S ν̇,

with H constant, V′ and A′ of the parent, S the joint's free directions. A = (ω̇, v̇ + ω × v) is the
acceleration of the frame and of its origin, in its axes. S ν̇ = (ω̇_rel, Qᵀd̈) is the acceleration
on the joint. b = (ω′ × ω_rel, ω′ × (ω′ × p) + 2 ω′ × v_rel) is the centripetal and Coriolis part,
in the node's axes, p the node's position on the parent. The equations contain no absolute velocity:
a mechanism in uniform motion is computed like one at rest, and no rounding of v × m v acts as a
torque.

*Reduced*: D and V_rel = S ν are the state, and S is constant. *Absolute*: C and V of every node are
the state; S spans the directions that the joint's rows leave free at the node's pose, even where
it violates them. This solves the saddle point of M and these rows on their null space.
`lierb.kernels.mechanics.tree_dynamics` solves for ν̇.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

from lierb.kernels.functions.signals import NO_SIGNALS, Signals
from lierb.kernels.groups import se3
from lierb.kernels.mechanics.newton_euler import Kinematics
from lierb.kernels.mechanics.rows import PITCHED, Rows
from lierb.kernels.mechanics.saddle import kinds_of
from lierb.kernels.mechanics.spatial import Articulated, Augmented, Pose, Rigid, twist_at
from lierb.kernels.mechanics.subgroup import Slots
from lierb.kernels.numbers.number import Number
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
from lierb.kernels.numbers.zero import ZERO, is_zero

GROUND = -1  # in place of a node's index
MASSLESS = -1  # in place of a link's index
NONE = -1  # in place of a joint's index
FEW = 3  # up to so many columns, their sum costs less than the transformation of a twist
FREE: Slots = (0, 1, 2, 3, 4, 5)
HERE: Pose = (IDENTITY, ZERO3)


@dataclass(frozen=True)
class Node:
    """A node is a link, or a massless frame, and the joint that connects it to its parent.

    parent : index of the parent node, or GROUND.   link : index of the link, or MASSLESS.
    cspace : "reduced" for coordinates on the joint, or the c-space of its pose, "SE3" or "SO3xR3".
    slots : free components of V_rel, for reduced coordinates.
    rows : rows of the joint beyond the slots.
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
        """Return indices of the joint's six directions that are free; see `TreeMotion.free`."""
        if not self.rows:
            return tuple(i for i, slot in enumerate(self.slots) if slot >= 0)
        held, fixed, _ = kinds_of(self.rows)
        turns = tuple(k for k in range(3) if k not in fixed)
        return turns + tuple(3 + j for j in range(3) if j not in held)

    @cached_property
    def others(self) -> Rows:
        """Return the rows that are solved with multipliers, not by the null space S."""
        return tuple(kinds_of(self.rows)[2])


@dataclass(frozen=True)
class Connection:
    """A connection has rows between two frames, on a node and on another node or the ground.

    hangs : True if the frames are those of the joint that connects `node` to its parent `other`.
    joint : index of the joint that has the frames; NONE for the frames of nodes and of the ground.
    second : index of the joint with the second part of the rows, for rows that couple two joints.
    """

    node: int
    other: int
    rows: Rows = ()
    hangs: bool = False
    joint: int = NONE
    second: int = NONE


class NodeConstants(NamedTuple):
    """Hold the constants of a node, in joint axes.

    rigid : mass, first moment and inertia about the joint's point, with added inertia if any.
    inertia : inertia about the centre of mass.   com : centre of mass.
    hang : H, the joint's frame on the parent, or on the ground.
    gravity : gravity in the joint's axes on the ground, for a node on the ground; else zero.
    frame : the node's frame in the user's body frame.
    burden : mass and approximate inertia of the node and its descendants.
    """

    rigid: Rigid | Augmented
    inertia: Mat
    com: Vec
    hang: Pose
    gravity: Vec
    frame: Pose
    pitch: Number
    burden: tuple[Number, Number] = (ZERO, ZERO)


class Ends(NamedTuple):
    """A connection has frames on its two nodes, or on the ground, and parameters of its rows."""

    inner: Pose
    outer: Pose
    pitch: Number = ZERO
    length: Number = ZERO
    elements: tuple[Any, ...] = ()


class TreeConstants(NamedTuple):
    """Hold the constants of a mechanism.

    ends : frames of the plan's connections.   elements : parameters of each element.
    dropped : number of dependent rows at the start.
    signals : signals at the time of the evaluation.
    girth : square of the radius of gyration of all nodes together, m².
    """

    nodes: tuple[NodeConstants, ...]
    ends: tuple[Ends, ...]
    gravity: Vec
    elements: tuple[Any, ...] = ()
    dropped: Number = ZERO
    signals: Signals = NO_SIGNALS
    girth: Number = ZERO

    @property
    def mass(self) -> Number:
        """Return the mass of the first link, as an example of the number type."""
        return next(n.rigid.mass for n in self.nodes if n.rigid.mass is not ZERO)


class Relative(NamedTuple):
    """Hold the motion of a connection's inner frame relative to the outer one.

    x : kinematics for rows.
    seat : the inner frame in the other node's frame, or in the ground's.
    bias : A of the node less A of the other at zero (ω̇_rel, Qᵀd̈), both at the inner frame, from
        ω̇ and the acceleration of the nodes' origins, without centripetal terms.
    fall : acceleration of the ground in the frame of `seat`, if `other` is the ground; else None.
    """

    x: Kinematics
    seat: Pose
    bias: Vec
    fall: Vec | None


class TreeMotion:
    """Compute the motion of a tree at one state.

    poses : D of reduced nodes; C of others, in the ground's frame at the root of their tree.
    velocities : V_rel of reduced nodes; V of others, in their c-space.
    """

    def __init__(
        self,
        nodes: Sequence[Node],
        body: TreeConstants,
        poses: Sequence[Pose],
        velocities: Sequence[Vec],
        time: Number = ZERO,
    ) -> None:
        self.nodes, self.body, self.time = tuple(nodes), body, time
        self.steps: list[Pose] = []  # T
        self.carried: list[Vec] = []  # Ad(T⁻¹) V′
        self.relative: list[Vec] = []  # V_rel
        self.twists: list[Vec] = []  # V, of a frame in joint axes
        self.directions: list[list[Vec]] = []  # S
        self.own: list[range] = []  # indices of each node's directions among all
        self._poses, self._velocities = [*poses], velocities
        self._places: dict[int, Pose] = {}
        self._columns: dict[int, dict[int, Vec]] = {}
        self._above: dict[int, dict[int, Vec]] = {}
        self._rates: dict[int, Number] = {}  # ν, if V_rel is exactly S ν
        self._biases: dict[int, Vec] = {}
        self._paths: dict[tuple[int, int], tuple[Pose, Vec]] = {}
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
        if not node.rows:
            self._rates |= zip(self.own[i], (velocity[k] for k in node.free), strict=True)
        carried = ZERO6
        if not is_root:
            columns = self._from_above(i) if joint_space_pays(self.nodes) else {}
            if 0 < len(columns) <= FEW and columns.keys() <= self._rates.keys():
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

    def again(self) -> TreeMotion:
        """Return a motion of the same state, without cached values."""
        return TreeMotion(self.nodes, self.body, self._poses, self._velocities, self.time)

    def with_added(self, inertias: Mapping[int, Articulated]) -> TreeMotion:
        """Return the same motion of nodes with added inertia."""
        motion, nodes = copy(self), list(self.body.nodes)
        for i, added in inertias.items():
            nodes[i] = nodes[i]._replace(rigid=Augmented(nodes[i].rigid, added))
        motion.body = self.body._replace(nodes=tuple(nodes))
        return motion

    def columns(self, i: int) -> dict[int, Vec]:
        """Return a node's twists by unit rates of free directions of its joint and ancestors'."""
        if i not in self._columns:
            own = dict(zip(self.own[i], self.directions[i], strict=True))
            self._columns[i] = self._from_above(i) | own
        return self._columns[i]

    def _from_above(self, i: int) -> dict[int, Vec]:
        """Return a node's twists by unit rates of its ancestors' free directions."""
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
        """Return Ad(T⁻¹) V, the parent's twist V in a node's frame.

        is_constant : True for a constant twist, for which Ad(H⁻¹) V is constant, too.
        """
        node = self.nodes[i]
        if node.is_reduced and node.parent != GROUND:
            is_next = self.nodes[node.parent].parent == GROUND  # most of V is zero
            if is_constant or is_next:
                return twist_at(self._poses[i], twist_at(self.body.nodes[i].hang, twist))
        return twist_at(self.steps[i], twist)

    def place(self, i: int) -> Pose:
        """Return a node's frame in the ground's joint frame at the root of its tree."""
        if i not in self._places:
            parent = self.nodes[i].parent
            step = self.steps[i]
            self._places[i] = step if parent == GROUND else se3.compose(self.place(parent), step)
        return self._places[i]

    def root(self, i: int) -> int:
        return root_of(self.nodes, i)

    def pose(self, i: int) -> Pose:
        """Return a node's frame in the ground frame."""
        return se3.compose(self.body.nodes[self.root(i)].hang, self.place(i))

    def joint_pose(self, i: int) -> Pose:
        """Return D of a node."""
        node, hang = self.nodes[i], self.body.nodes[i].hang
        if node.is_reduced or node.parent == GROUND:
            return self._poses[i] if node.is_reduced else self.place(i)
        return se3.compose(se3.inverse(hang), self.steps[i])

    def between(self, connection: Connection, ends: Ends) -> Relative:
        i, other = connection.node, connection.other
        if connection.hangs:
            fall = neg(self.body.nodes[i].gravity) if other == GROUND else None
            x = self.kinematics(self.joint_pose(i), self.relative[i])
            return Relative(x, self.steps[i], self.bias(i), fall)
        fork = self._fork(i, other)
        is_one_tree = other != GROUND and self.root(i) == self.root(other)
        of_ground = self.place if is_one_tree else self.pose
        place, twist = self._seen_from(fork, i, of_ground)
        around, carrying = self._seen_from(fork, other, of_ground)
        seat = se3.compose(place, ends.inner)
        if other != fork:
            seat = se3.compose(se3.inverse(around), seat)
        velocity = sub(twist_at(ends.inner, twist), twist_at(seat, carrying))
        x = self.kinematics(se3.compose(se3.inverse(ends.outer), seat), velocity)
        turning = ZERO3 if other == GROUND else self.twists[other][:3]
        carried, own = (
            twist_at(frame, omega + ZERO3)
            for frame, omega in ((seat, turning), (ends.inner, self.twists[i][:3]))
        )
        bias = carried_bias(carried[:3], carried[3:], velocity)
        fall = neg(self.body.gravity) if other == GROUND else None
        return Relative(x, seat, bias[:3] + sub(bias[3:], cross(own[:3], own[3:])), fall)

    def kinematics(self, d: Pose, velocity: Vec) -> Kinematics:
        """Return the kinematics for rows that act on ω̇ and on Qᵀd̈."""
        omega, v = velocity[:3], velocity[3:]
        return Kinematics(d[0], d[1], omega, ZERO3, v, ZERO3, True, self.time)

    def _fork(self, i: int, other: int) -> int:
        """Return the last common ancestor of two nodes or one of them; GROUND if absolute."""
        above = [GROUND]
        while other != GROUND and self.nodes[i].is_reduced:
            above.append(other)
            other = self.nodes[other].parent
        while i not in above:
            i = self.nodes[i].parent
        return i

    def _seen_from(self, fork: int, i: int, of_ground: Callable[[int], Pose]) -> tuple[Pose, Vec]:
        """Return a node's frame and twist relative to an ancestor, or to the ground.

        They are composed along the tree, so that the motion of the ancestor causes no rounding.
        """
        if i == fork:
            return HERE, ZERO6
        if fork == GROUND:
            return of_ground(i), self.twists[i]
        if (fork, i) not in self._paths:
            parent = self.nodes[i].parent
            step, twist = self.steps[i], self.relative[i]
            if parent != fork:
                place, moving = self._seen_from(fork, parent, of_ground)
                step, twist = se3.compose(place, step), add(self.carry(i, moving), twist)
            self._paths[fork, i] = step, twist
        return self._paths[fork, i]

    def free(self, i: int) -> list[Vec]:
        """Return S, the directions in which a node can move on its joint."""
        node, pitch = self.nodes[i], self.body.nodes[i].pitch
        if not node.rows:
            return free_directions(node.slots, pitch)
        held, fixed, _ = kinds_of(node.rows)
        turns = [UNIT[k] + ZERO3 for k in range(3) if k not in fixed]
        if not held:
            return [*turns, *(ZERO3 + UNIT[j] for j in range(3))]
        q = self.joint_pose(i)[0] if len(held) < 3 else IDENTITY
        return [*turns, *(ZERO3 + row(q, j) for j in range(3) if j not in held)]

    def held(self, i: int, v: Vec) -> Vec:
        """Return a vector's part, in node axes, along the directions in which joint rows fix P."""
        held, _, _ = kinds_of(self.nodes[i].rows)
        if not held:
            return ZERO3
        if len(held) == 3:
            return v
        total, q = ZERO3, self.joint_pose(i)[0]
        for j in held:
            total = axpy(dot(row(q, j), v), row(q, j), total)
        return total

    def bias(self, i: int) -> Vec:
        """Return b of a node."""
        if i not in self._biases:
            parent, carried = self.nodes[i].parent, self.carried[i]
            swept = carried[3:]
            if parent != GROUND and not is_zero(*self.twists[parent][3:]):
                swept = self.carry(i, self.twists[parent][:3] + ZERO3)[3:]
            self._biases[i] = carried_bias(carried[:3], swept, self.relative[i])
        return self._biases[i]


def carried_bias(turning: Vec, swept: Vec, relative: Vec) -> Vec:
    """Return b, the centripetal and Coriolis part of an acceleration.

    The frame with twist `relative` is on a turning frame.

    turning : ω′.   swept : ω′ × p.   All three are in the moving frame's axes.
    """
    return cross(turning, relative[:3]) + cross(turning, axpy(2.0, relative[3:], swept))


def root_of(nodes: Sequence[Node], i: int) -> int:
    """Return the index of the root of a node's tree, a node on the ground."""
    while nodes[i].parent != GROUND:
        i = nodes[i].parent
    return i


def free_directions(slots: Slots, pitch: Any) -> list[Vec]:
    """Return S for slots: unit vectors, and for a screw a combination of two."""
    directions = []
    for i, slot in enumerate(slots):
        if slot >= 0:
            unit: list[Number] = [1.0 if j == i else ZERO for j in range(6)]
            if i == 2 and slots[5] == PITCHED:
                unit[5] = pitch
            directions.append(tuple(unit))
    return directions


@lru_cache(64)
def joint_space_pays(nodes: tuple[Node, ...]) -> bool:
    """Return whether the mass matrix needs fewer multiplications than articulated bodies.

    Transforming a column to one more node needs 60, with its products; transforming an inertia
    needs 170; a factorisation n³/6.
    """
    free = [len(node.free) for node in nodes]
    above: list[int] = []
    for node in nodes:
        is_root = node.parent == GROUND
        above.append(0 if is_root else above[node.parent] + free[node.parent])
    hanging = sum(node.parent != GROUND for node in nodes)
    blocks = sum(n**3 for n in free) / 2
    return 60 * sum(above) + sum(free) ** 3 / 6 <= 170 * hanging + blocks


def combined(weights: Sequence[Number], vectors: Sequence[Vec], start: Vec = ZERO6) -> Vec:
    total = start
    for weight, v in zip(weights, vectors, strict=True):
        total = axpy(weight, v, total)
    return total
