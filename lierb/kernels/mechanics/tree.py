"""Bodies that hang on each other: motion and accelerations of a tree of links, and further rows.

A *node* is a link, or a massless piece between two motions that make up one joint. It hangs on the
node before it, or on the ground, by D = (Q, d): its frame, seen from the joint's frame there. In
joint axes its own frame is the joint's, so that

    T = A D,   V = Ad(T⁻¹) V′ + V_rel,   V̇ = Ad(T⁻¹) V̇′ + b + S ν̇,

with A constant, V′ of the node before it, S the joint's free directions, and b all that V̇ has
without ν̇. *Reduced*: D and V_rel = S ν are the state, S is constant, and b = [Ad(T⁻¹)V′, V_rel].
*Absolute*: C and V of every node are the state; S spans what the joint's rows leave free where the
node is, on its joint or off it, and b satisfies the rows: the saddle point of M and these rows,
solved on their null space, in as many operations as there are nodes. Either way by articulated
bodies (Featherstone, Rigid Body Dynamics Algorithms, 2008, ch. 7).

All other rows, of loops, of joints whose motions are no group, of motors and of the user's, have a
Schur complement on that. Gravity is an acceleration of the ground.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import product
from typing import Any, NamedTuple

from lierb.kernels.groups import se3
from lierb.kernels.mechanics.newton_euler import Kinematics
from lierb.kernels.mechanics.rows import PITCHED, Rows
from lierb.kernels.mechanics.saddle import kinds_of, less, multipliers_of
from lierb.kernels.mechanics.spatial import (
    Articulated,
    Pose,
    Rigid,
    twist_at,
    wrench_from,
)
from lierb.kernels.mechanics.subgroup import Slots, inverse
from lierb.kernels.numbers.arithmetic import fma, sqrt
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
    norm,
    row,
    scale,
    sub,
)
from lierb.kernels.numbers.zero import ZERO, is_zero

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
    """

    nodes: tuple[NodeConstants, ...]
    ends: tuple[Ends, ...]
    gravity: Vec
    elements: tuple[Any, ...] = ()
    dropped: Any = ZERO

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
                carried = _combined([self._rates[j] for j in columns], [*columns.values()])
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

    @cached_property
    def _above(self) -> dict[int, dict[int, Vec]]:
        return {}

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
        while self.nodes[i].parent != GROUND:
            i = self.nodes[i].parent
        return i

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


class ArticulatedBodies:
    """The inertias of a tree, and what any loads do to it."""

    def __init__(self, motion: TreeMotion) -> None:
        self.motion = motion
        nodes, constants = motion.nodes, motion.body.nodes
        self.free = motion.directions
        own: list[Any] = [
            None if n.link == MASSLESS else c.rigid for n, c in zip(nodes, constants, strict=True)
        ]
        carried: list[Articulated | None] = [None] * len(nodes)
        self.inertias: list[list[Any]] = [[] for _ in nodes]
        self.columns: list[list[Vec]] = [[] for _ in nodes]  # U = I S
        self.gains: list[tuple[Any, ...]] = [() for _ in nodes]  # (Sᵀ I S)⁻¹
        for i in reversed(range(len(nodes))):
            self.inertias[i] = [part for part in (own[i], carried[i]) if part is not None]
            self.columns[i] = [self.momentum(i, s) for s in self.free[i]]
            if self.free[i]:
                self.gains[i] = inverse(
                    [[dot(s, u) for u in self.columns[i]] for s in self.free[i]]
                )
            parent = nodes[i].parent
            if parent != GROUND:
                moved = self._passed_on(i)
                before = carried[parent]
                carried[parent] = moved if before is None else before.and_also(moved)

    def momentum(self, i: int, twist: Vec) -> Vec:
        """Of all that hangs on a node and is free to move."""
        return _sum([part.momentum(twist) for part in self.inertias[i]])

    def _passed_on(self, i: int) -> Articulated:
        """I − U (SᵀIS)⁻¹ Uᵀ, seen from the node before."""
        step = self.motion.steps[i]
        parts = [part.from_frame(step) for part in self.inertias[i]]
        total = parts[0] if len(parts) == 1 else parts[0].and_also(parts[1])
        columns = [wrench_from(step, u) for u in self.columns[i]]
        count = len(columns)
        for k in range(count):
            gain = self.gains[i][count * k : count * k + count]
            total = total.less(columns[k], _combined(gain, columns))
        return total

    def respond(
        self,
        loads: dict[int, Vec],
        biases: Sequence[Vec] | None = None,
        fall: dict[int, Vec] | None = None,
    ) -> Response:
        """What the nodes do under loads, wrenches about their frames' origins.

        biases : what they do without ν̇.   fall : what the ground does, by root, in its axes there;
        with it, the nodes have their velocities, else they are at rest.
        """
        nodes, steps = self.motion.nodes, self.motion.steps
        totals = [loads.get(i, ZERO6) for i in range(len(nodes))]
        if fall is not None:
            for i, node in enumerate(nodes):
                if node.link != MASSLESS:
                    bias = self.motion.body.nodes[i].rigid.bias(self.motion.twists[i])
                    totals[i] = sub(totals[i], bias)
        forced: list[Vec] = [()] * len(nodes)
        for i in reversed(range(len(nodes))):
            bias = biases[i] if biases else ZERO6
            lacking = totals[i] if not biases else sub(totals[i], self.momentum(i, bias))
            pushes = tuple(dot(s, lacking) for s in self.free[i])
            forced[i] = _times(self.gains[i], pushes)
            if nodes[i].parent != GROUND:
                passed = sub(lacking, _combined(forced[i], self.columns[i]))
                totals[nodes[i].parent] = add(
                    totals[nodes[i].parent], wrench_from(steps[i], passed)
                )
        moved: list[Vec] = []
        rates: list[Vec] = []
        for i, node in enumerate(nodes):
            before = (fall or {}).get(i, ZERO6) if node.parent == GROUND else moved[node.parent]
            carried = twist_at(steps[i], before)
            held = tuple(dot(u, carried) for u in self.columns[i])
            rate = sub(forced[i], _times(self.gains[i], held)) if held else ()
            start = add(carried, biases[i]) if biases else carried
            relative = _combined(rate, self.free[i])
            rates.append(relative)
            moved.append(add(start, relative))
        return Response(tuple(moved), tuple(rates), tuple(totals))

    def transmitted(self, i: int, response: Response) -> Vec:
        """The wrench by which a joint moves its node, about the node's frame."""
        return sub(self.momentum(i, response.moved[i]), response.totals[i])


class JointSpace:
    """The same by the mass matrix of all free directions: less work for a few of them.

    Kane's method, on the motion's columns: twists of a node by one free direction each.
    """

    def __init__(self, motion: TreeMotion) -> None:
        self.motion = motion
        nodes, constants = motion.nodes, motion.body.nodes
        entries: dict[tuple[int, int], Any] = {}
        for i, node in enumerate(nodes):
            if node.link == MASSLESS:
                continue
            columns = motion.columns(i)
            momenta = {j: constants[i].rigid.momentum(c) for j, c in columns.items()}
            for j, k in product(momenta, momenta):
                if k <= j:
                    found = dot(columns[k], momenta[j])
                    entries[j, k] = found + entries[j, k] if (j, k) in entries else found
        self.count = sum(len(motion.directions[i]) for i in range(len(nodes)))
        rows = range(self.count)
        self.mass = Factored([[entries.get((j, k), ZERO) for k in range(j + 1)] for j in rows])

    def respond(
        self,
        loads: dict[int, Vec],
        biases: Sequence[Vec] | None = None,
        fall: dict[int, Vec] | None = None,
    ) -> Response:
        """As `ArticulatedBodies.respond`."""
        motion = self.motion
        start: list[Vec] = []  # what the nodes do without ν̇
        forces: list[Any] = [ZERO] * self.count
        for i, node in enumerate(motion.nodes):
            before = (fall or {}).get(i, ZERO6) if node.parent == GROUND else start[node.parent]
            carried = motion.carry(i, before)
            start.append(add(carried, biases[i]) if biases else carried)
            lacking = loads.get(i, ZERO6)
            rigid = motion.body.nodes[i].rigid
            if node.link != MASSLESS and fall is not None:
                lacking = sub(lacking, rigid.needed(start[i], motion.twists[i]))
            elif node.link != MASSLESS and biases:
                lacking = sub(lacking, rigid.momentum(start[i]))
            if not is_zero(*lacking):
                for j, column in motion.columns(i).items():
                    forces[j] = forces[j] + dot(column, lacking)
        rates = self.mass.solve(forces)
        moved, relative = [], []
        for i, directions in enumerate(motion.directions):
            columns = motion.columns(i)
            moved.append(_combined([rates[j] for j in columns], [*columns.values()], start[i]))
            relative.append(_combined([rates[j] for j in motion.own[i]], directions))
        totals = [loads.get(i, ZERO6) for i in range(len(motion.nodes))]
        if fall is not None:
            for i, node in enumerate(motion.nodes):
                if node.link != MASSLESS:
                    bias = motion.body.nodes[i].rigid.bias(motion.twists[i])
                    totals[i] = sub(totals[i], bias)
        return Response(tuple(moved), tuple(relative), tuple(totals))

    def transmitted(self, i: int, response: Response) -> Vec:
        """As `ArticulatedBodies.transmitted`."""
        motion = self.motion
        total = neg(response.totals[i])
        if motion.nodes[i].link != MASSLESS:
            total = add(motion.body.nodes[i].rigid.momentum(response.moved[i]), total)
        for child, node in enumerate(motion.nodes):
            if node.parent == i:
                passed = self.transmitted(child, response)
                total = add(total, wrench_from(motion.steps[child], passed))
        return total


class Factored:
    """A symmetric positive definite matrix, given by its lower triangle, as Lᵀ D L.

    From the last row on: the pivots of a chain's last links are constant, and so divided by once.
    """

    def __init__(self, lower: list[list[Any]]) -> None:
        count = len(lower)
        self.upper: list[list[Any]] = [[] for _ in range(count)]  # of row i, from the last on
        self.inverses: list[Any] = [ZERO] * count
        scaled: list[list[Any]] = [[] for _ in range(count)]
        for i in reversed(range(count)):
            for j in reversed(range(i + 1, count)):
                rest = less(lower[j][i], self.upper[i], scaled[j])
                scaled[i].append(rest)
                self.upper[i].append(rest * self.inverses[j])
            self.inverses[i] = 1.0 / less(lower[i][i], self.upper[i], scaled[i])

    def solve(self, right: Sequence[Any]) -> list[Any]:
        count = len(right)
        y: list[Any] = []  # from the last row on
        for i in reversed(range(count)):
            y.append(less(right[i], self.upper[i], y))
        found: list[Any] = []
        for i in range(count):
            x = y[count - 1 - i] * self.inverses[i]
            for j in range(i):
                x = fma(-self.upper[j][count - 1 - i], found[j], x)
            found.append(x)
        return found


Bodies = ArticulatedBodies | JointSpace


def bodies_of(motion: TreeMotion) -> Bodies:
    """By whichever takes fewer operations."""
    return JointSpace(motion) if joint_space_pays(motion.nodes) else ArticulatedBodies(motion)


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


class Response(NamedTuple):
    """moved : each node's V̇, or what stands for it.   rates : S ν̇.   totals : loads, passed on."""

    moved: tuple[Vec, ...]
    rates: tuple[Vec, ...]
    totals: tuple[Vec, ...]


def _sum(vectors: list[Vec]) -> Vec:
    total = vectors[0]
    for v in vectors[1:]:
        total = add(total, v)
    return total


def _combined(weights: Sequence[Any], vectors: Sequence[Vec], start: Vec = ZERO6) -> Vec:
    total = start
    for weight, v in zip(weights, vectors, strict=True):
        total = axpy(weight, v, total)
    return total


def _times(matrix: tuple[Any, ...], x: Vec) -> Vec:
    n = len(x)
    return tuple(dot(matrix[n * i : n * i + n], x) for i in range(n))


# ---- rows beside the tree ----------------------------------------------------------------------


class Asked(NamedTuple):
    """What a row asks of two nodes: push·(motion of one) − pull·(motion of the other) = wanted.

    push, pull : the row as wrenches about the nodes' frames.   fall : that of `Relative`.
    """

    node: int
    other: int
    push: Vec
    pull: Vec
    fall: Vec | None
    wanted: Any

    def loads(self, size: Any = 1.0) -> dict[int, Vec]:
        """size times the wrenches that the row's multiplier has, but for their sign."""
        found = {self.node: scale(size, self.push)}
        if self.other != GROUND:
            found[self.other] = scale(-size, self.pull)
        return found

    def of(self, response: Response) -> Any:
        """What it asks about, of what the nodes do."""
        total = dot(self.push, response.moved[self.node])
        if self.other != GROUND:
            return total - dot(self.pull, response.moved[self.other])
        return total


def asked(
    connection: Connection, relative: Relative, jacobian: Vec, inner: Pose, wanted: Any
) -> Asked:
    """Of a row with this Jacobian, J·V_rel."""
    push = jacobian if connection.hangs else wrench_from(inner, jacobian)
    pull = wrench_from(relative.seat, jacobian)
    return Asked(connection.node, connection.other, push, pull, relative.fall, wanted)


class Solved(NamedTuple):
    """response : with all rows.   multipliers : of the rows asked for.

    singular, dropped : marks, as of `saddle.Solution`.
    """

    response: Response
    multipliers: tuple[Any, ...]
    singular: Any
    dropped: Any


def solved(
    bodies: Bodies,
    rows: Sequence[Asked],
    loads: dict[int, Vec],
    biases: Sequence[Vec] | None = None,
    fall: dict[int, Vec] | None = None,
) -> Solved:
    """What the nodes do under loads and rows; see `ArticulatedBodies.respond`."""
    response = bodies.respond(loads, biases, fall)
    if not rows:
        return Solved(response, (), ZERO, ZERO)
    responses = [bodies.respond(each.loads()) for each in rows]
    schur = [[rows[i].of(responses[j]) for j in range(i + 1)] for i in range(len(rows))]
    excess = []
    for each in rows:
        found = each.of(response) - each.wanted
        excess.append(found if each.fall is None else found - dot(each.pull, ZERO3 + each.fall))
    scales = _Scales(bodies.motion, loads, fall)
    multipliers, singular, dropped = multipliers_of(
        schur, excess, [scales.of(each) for each in rows], lambda i: scales.acceleration(rows[i])
    )
    total = dict(loads)
    for size, each in zip(multipliers, rows, strict=True):
        for i, load in each.loads(-size).items():
            total[i] = add(total[i], load) if i in total else load
    return Solved(bodies.respond(total, biases, fall), tuple(multipliers), singular, dropped)


class _Scales:
    """What rows and loads amount to, measured by the inertia that each node has alone."""

    def __init__(
        self, motion: TreeMotion, loads: dict[int, Vec], fall: dict[int, Vec] | None
    ) -> None:
        self.motion, self.loads, self.fall = motion, loads, fall or {}

    def _easy(self, i: int) -> Vec:
        rigid = self.motion.body.nodes[i].rigid
        return (*(1.0 / rigid.inertia[4 * k] for k in range(3)), *(1.0 / rigid.mass,) * 3)

    def _square(self, i: int, wrench: Vec) -> Any:
        total: Any = ZERO
        for x, easy in zip(wrench, self._easy(i), strict=True):
            total = fma(x * x, easy, total)
        return total

    def of(self, row: Asked) -> Any:
        """Its square: what the row would move."""
        size = self._square(row.node, row.push)
        return size if row.other == GROUND else size + self._square(row.other, row.pull)

    def acceleration(self, row: Asked) -> Any:
        """The acceleration of a row that loads and motion could bring about."""
        return sqrt(self.of(row)) * self._forced

    @cached_property
    def _forced(self) -> Any:
        total: Any = ZERO
        for i, load in self.loads.items():
            total = total + sqrt(self._square(i, load))
        heavy = sum((sqrt(c.rigid.mass) for c in self.motion.body.nodes), start=ZERO)
        for fall in self.fall.values():
            total = total + norm(fall[3:]) * heavy
        for i, twist in enumerate(self.motion.twists):
            if self.motion.nodes[i].link != MASSLESS:
                momentum = self.motion.body.nodes[i].rigid.momentum(twist)
                total = total + norm(twist[:3]) * sqrt(dot(momentum, twist))
        return total
