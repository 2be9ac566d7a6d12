"""Nodes, elements and numbers of a tree in memory, as formulas see them at run time.

Numbers are in rows of a thread's memory, whose places the tree's table has
(`lierb.kernels.systems.tree_table`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

from lierb.kernels.functions.function import size_of
from lierb.kernels.functions.signals import NO_SIGNALS, Signals
from lierb.kernels.groups import se3
from lierb.kernels.mechanics import tree_nodes
from lierb.kernels.mechanics.newton_euler import Motion
from lierb.kernels.mechanics.rows import Rows as JointRows
from lierb.kernels.mechanics.spatial import Pose, twist_at
from lierb.kernels.mechanics.tree import HERE, Connection, Ends
from lierb.kernels.mechanics.tree_connections import FRAME_ROWS, Connected, Frame, between, frame_on
from lierb.kernels.mechanics.tree_nodes import CONSTANTS, DETAILS, MOTION, JointKind, Kind
from lierb.kernels.numbers.arithmetic import flatten, refilled
from lierb.kernels.numbers.dual import Dual, parts_of
from lierb.kernels.numbers.tape import Linear
from lierb.kernels.numbers.vec import Vec, add
from lierb.kernels.numbers.zero import ZERO, is_zero
from lierb.kernels.systems import tree_places as at
from lierb.kernels.systems.connection_table import (
    INNER,
    OUTER,
    PITCH,
    PLACED,
    SIZE,
    placed_rows,
    placed_shape,
)
from lierb.kernels.systems.layout import Columns, Field
from lierb.kernels.systems.plan import ConstraintKind, ElementKind, LoopPlan
from lierb.kernels.systems.signals import PassiveElements, states_of
from lierb.kernels.tracing.arrays import Index
from lierb.kernels.tracing.lanes import Lane
from lierb.kernels.tracing.memory import Rows, for_each, if_not_zero, integer_at, procedure, switch


class LoopBody(NamedTuple):
    """Addresses of a tree's table and of a thread's memory, with the constants of the nodes.

    mass : of the first link, as an example of the number type.
    dropped, signals, girth : see `TreeConstants`.   length : characteristic length, m.
    heavy : sum of the roots of all masses, √kg.   elements : parameters of listed elements, behind
    nothing for each other element of the plan.   frames : of each listed element at a joint, on
    its two nodes; () for others.   jumps : times at which elements may jump, s.
    """

    table: Any
    memory: Any
    mass: Any
    gravity: Vec
    girth: Any
    dropped: Any = ZERO
    signals: Signals = NO_SIGNALS
    length: Any = ZERO
    heavy: Any = ZERO
    elements: tuple[Any, ...] = ()
    frames: tuple[Any, ...] = ()
    jumps: Vec = ()


class MemoryNode:
    """A node at run time."""

    def __init__(self, tree: MemoryTree, i: Index) -> None:
        self.tree, self.i = tree, i

    def entry(self, name: int) -> Index:
        return integer_at(self.tree.table, self.i * at.TABLE + (at.HEADER + name))

    def part(self, first: int, width: int) -> Rows:
        """Rows of a node in a section with `width` rows for each."""
        return self.tree.rows(self.tree[first] + self.i * width)

    @property
    def constants(self) -> Rows:
        return self.part(at.CONSTANTS_ROW, CONSTANTS)

    @property
    def details(self) -> Rows:
        return self.part(at.DETAILS_ROW, DETAILS)

    @property
    def chart(self) -> Rows:
        return self.tree.rows(self.entry(at.CHART))

    @property
    def next_chart(self) -> Rows:
        """Rows of the chart to which a step leads."""
        return self.tree.rows(self.entry(at.CHART) + self.tree[at.AHEAD])

    @property
    def next_v(self) -> Rows:
        return self.tree.rows(self.tree[at.V_ROW] + self.tree[at.AHEAD] + self.entry(at.FREEDOM))

    def freedoms(self, first: int) -> Rows:
        """Rows of a node in a section with a row for each freedom."""
        return self.tree.rows(self.tree[first] + self.entry(at.FREEDOM))

    def slopes(self, first: int, ahead: Index) -> Rows:
        """Rows of a node in a section of slopes.   ahead : rows of the stages before."""
        return self.tree.rows(self.tree[first] + ahead + self.entry(at.FREEDOM))

    @property
    def motion(self) -> Rows:
        return self.part(at.MOTION_ROW, MOTION)

    @property
    def above(self) -> Rows:
        return self.parent.motion

    def on_joint(self, joint: JointKind) -> tuple[Pose, Vec]:
        """D of the node's joint and V_rel, composed of those of two nodes if it has two."""

        def of(node: MemoryNode, kind: Kind) -> tuple[Pose, Vec]:
            return tree_nodes.on_joint(kind, node.constants, node.chart, node.freedoms(at.V_ROW))

        d, moving = of(self, joint.kind)
        if joint.first is None:
            return d, moving
        first, turning = of(self.parent, Kind(joint.first))
        return se3.compose(first, d), add(twist_at(d, turning), moving)

    def each_joint(self, do: Callable[[JointKind], None]) -> None:
        """Emit the code of all kinds of joints, of which that of the node's joint runs."""
        switch(self.entry(at.JOINT), self.tree.plan.joint_kinds, do)

    @property
    def parent(self) -> MemoryNode:
        return self.tree.node(self.entry(at.PARENT))

    def each_kind(self, do: Callable[[Kind], None]) -> None:
        """Emit the code of all kinds, of which the node's runs."""
        switch(self.entry(at.KIND), self.tree.plan.kinds, do)


class MemoryConnection:
    """An element or a constraint at run time.   first : place of its numbers in the table."""

    def __init__(self, tree: MemoryTree, first: Index) -> None:
        self.tree, self.first = tree, first

    def entry(self, name: int) -> Index:
        return integer_at(self.tree.table, self.first + name)

    @property
    def node(self) -> MemoryNode:
        return self.tree.node(self.entry(at.NODE))

    @property
    def other(self) -> MemoryNode:
        """Its other node, or the ground."""
        return self.tree.node(self.entry(at.OTHER))

    @property
    def rows(self) -> Rows:
        return self.tree.rows(self.entry(at.ROW))

    def parameters(self, kind: ElementKind, first: int) -> Any:
        """Parameters of an element, which are in its rows from `first` on."""
        shape, rows = placed_shape(kind), self.rows
        numbers = iter(rows[first : first + placed_rows(kind)])
        filled = (x if is_zero(x) else next(numbers) for x in flatten(shape))
        return refilled(shape, filled)


class MemoryElement(MemoryConnection):
    """An element at run time.   k : its number."""

    def __init__(self, tree: MemoryTree, k: Index) -> None:
        super().__init__(tree, tree[at.ELEMENT_TABLE] + k * at.ELEMENT)
        self.k = k

    def each_kind(self, do: Callable[[ElementKind], None]) -> None:
        """Emit the code of all kinds, of which the element's runs."""
        switch(self.entry(at.CONNECTION_KIND), self.tree.plan.element_kinds, do)

    def placed(self, kind: ElementKind, time: Any) -> tuple[Any, Frame, Motion, Vec]:
        """Parameters, frame on the node, motion relative to the other node, and its lever there."""
        rows = self.rows
        outer = frame_at(rows, 0) if kind.on_joint else HERE
        inner = frame_at(rows, FRAME_ROWS) if kind.on_loop else HERE
        frame = frame_on(self.node.motion, inner)
        x, lever = between(outer, frame, self.other.motion, time)
        return self.parameters(kind, FRAME_ROWS * (1 + kind.on_loop)), frame, x, lever


class MemoryConstraint(MemoryConnection):
    """A constraint at run time."""

    def each_kind(self, do: Callable[[ConstraintKind], None]) -> None:
        """Emit the code of all kinds, of which the constraint's runs."""
        switch(self.entry(at.CONNECTION_KIND), self.tree.plan.constraint_kinds, do)

    def connected(self, kind: ConstraintKind, time: Any) -> Connected:
        """Rows at the motion in memory."""
        element = kind.element
        own = element is None or element.on_loop
        on_joint = own or (element is not None and element.on_joint)
        placed = (self.parameters(element, PLACED),) if element else ()
        seconds = tuple(r.second for r in kind.rows if r.second)

        def at_part(
            part: MemoryConnection, rows: JointRows, second: Connected | None = None
        ) -> Connected:
            numbers = part.rows
            inner = frame_at(numbers, INNER) if own else HERE
            outer = frame_at(numbers, OUTER) if on_joint else HERE
            ends = Ends(inner, outer, numbers[PITCH], numbers[SIZE], placed)
            return Connected(rows, ends, part.node.motion, part.other.motion, time, second)

        first, *others = self.parts(kind)
        return at_part(first, kind.rows, *(at_part(part, seconds) for part in others))

    def parts(self, kind: ConstraintKind) -> list[MemoryConnection]:
        """The constraint at its joint, and at a second one if its rows have it."""
        if not kind.is_on_two_joints:
            return [self]
        return [self, MemoryConnection(self.tree, self.first + at.SECOND_PART)]

    def ends(self, kind: ConstraintKind) -> list[MemoryNode]:
        """The nodes on which wrenches of its rows act."""
        return [node for part in self.parts(kind) for node in (part.node, part.other)]

    def vector(self, name: int) -> Rows:
        """Rows of the constraint's equations in a vector of all equations."""
        return self.tree.vector(name, self.entry(at.FIRST))


def frame_at(rows: Rows, first: int) -> Pose:
    return rows[first : first + 9], rows[first + 9 : first + 12]


class MemoryTree:
    """A tree at run time: tree[name] is a number of the table's header.

    parts : derivatives of the numbers that are read and written.
    """

    def __init__(
        self, plan: LoopPlan, table: Index, memory: Index, parts: int | None = None
    ) -> None:
        self.plan, self.table, self.memory = plan, table, memory
        self.parts = plan.directions if parts is None else parts

    @property
    def values(self) -> MemoryTree:
        """The tree without derivatives."""
        return MemoryTree(self.plan, self.table, self.memory, 0)

    def __getitem__(self, name: int) -> Index:
        return integer_at(self.table, name)

    def rows(self, first: Index | int) -> Rows:
        return Rows(self.memory, self.plan.lanes, first, self.plan.packs, self.parts)

    def gains(self, first: Index | int) -> Rows:
        """Gains of the rows from `first` on."""
        memory = self.memory + 8 * self.plan.lanes
        return Rows(memory, self.plan.lanes, first, self.plan.packs)

    def packs(self, first: Index) -> Rows:
        """Rows from `first` on, each pack of which is a row."""
        return Rows(self.memory, self.plan.lanes, first * self.plan.packs)

    def section(self, name: int) -> Rows:
        return self.rows(self[name])

    def node(self, i: Index) -> MemoryNode:
        return MemoryNode(self, i)

    @property
    def ground(self) -> MemoryNode:
        return self.node(self.index(0))

    def index(self, number: int) -> Index:
        """A constant."""
        return Index(self.table.trace, self.table.value.type(number))

    def slopes(self, name: int, stages: Iterable[int]) -> list[Rows]:
        """Rows of the slopes of some stages, in a section of slopes."""
        return [self.rows(self[name] + self[at.FREEDOMS] * stage) for stage in stages]

    def of_link(self, name: int, link: Index, width: int) -> Rows:
        """Rows of a link, or of any joint, in a section with `width` rows for each."""
        return self.rows(self[name] + link * width)

    def for_elements(self, do: Callable[[MemoryElement], None]) -> None:
        if self.plan.element_kinds:
            for_each(self[at.ELEMENTS], lambda k: do(MemoryElement(self, k)))

    def listed(self, k: int) -> MemoryConnection:
        """An element that the code has one by one."""
        return MemoryConnection(self, self[at.LISTED_TABLE] + k * at.ELEMENT)

    def for_constraints(self, do: Callable[[MemoryConstraint], None]) -> None:
        if self.plan.constraint_kinds:
            for_each(self[at.CONSTRAINTS], lambda k: do(self.constraint(k)))

    def constraint(self, k: Index) -> MemoryConstraint:
        return MemoryConstraint(self, self[at.CONSTRAINT_TABLE] + k * at.CONSTRAINT)

    def vector(self, name: int, first: Index | int = 0) -> Rows:
        """Rows of a vector of all equations, from equation `first` on."""
        return self.rows(self[at.VECTOR_ROWS] + self[at.EQUATIONS] * name + first)

    def for_links(self, do: Callable[[MemoryNode], None]) -> None:
        """Run `do` for all nodes but massless ones."""

        def one(node: MemoryNode) -> None:
            is_link = node.entry(at.ROLE) + -tree_nodes.MASSLESS
            if_not_zero(is_link, lambda: do(node))

        self.for_nodes(one)

    def for_nodes(self, do: Callable[[MemoryNode], None], backward: bool = False) -> None:
        for_each(self[at.NODES], lambda i: do(self.node(i + 1)), backward)


@dataclass(frozen=True)
class TreeInMemory(PassiveElements):
    """Base of a mechanism whose nodes are in memory."""

    plan: LoopPlan

    joints: tuple[Connection, ...] = ()  # their errors are in memory, not in a `Record`
    inputs = Columns(Field("state", (0,)))  # read from memory
    invariant = ()
    is_homogeneous = False
    is_light = False
    takes_small_angle_steps = False
    rows = ()

    @cached_property
    def state(self) -> Columns:
        states = Field("states", (size_of(states_of(self.plan)),))
        return Columns(Field("v", (1,)), Field("work"), states)

    @property
    def projects(self) -> bool:
        """True if each step ends with a projection onto the constraints."""
        return self.plan.stabilisation.kind == "project" and bool(self.plan.constraint_kinds)

    def _tree(self, body: LoopBody) -> MemoryTree:
        """Return the tree, without derivatives for a body without them."""
        return MemoryTree(self.plan, body.table, body.memory, len(parts_of(body.mass)))

    def _run(
        self, name: str, body: LoopBody | MemoryTree, do: Callable[..., None], *more: Any
    ) -> None:
        """Call a procedure on the tree, whose code is emitted once, for numbers and integers."""
        tree = body if isinstance(body, MemoryTree) else self._tree(body)
        sizes = [len(parts_of(x)) for x in more]

        def formula(table: Index, memory: Index, *others: Any) -> None:
            do(MemoryTree(self.plan, table, memory, tree.parts), *others)

        name = ".".join(map(str, (__name__, name, self.plan.lanes, tree.parts, *sizes)))
        procedure(name, formula, tree.table, tree.memory, *map(self._widened, more))

    def _signal_numbers(self, body: LoopBody) -> Iterator[Any]:
        """Yield the body's signals as operands of `_run`; see `_signals`."""
        zero = 0.0 * body.mass
        return (zero + x for x in (*body.signals.states, *body.signals.controls))

    def _signals(self, numbers: Vec) -> Signals:
        count = size_of(states_of(self.plan))
        return Signals(numbers[:count], numbers[count:])

    def _widened(self, x: Any) -> Any:
        """Return an operand with all lanes."""
        if isinstance(x, Dual):
            value = self._widened(x.value)
            if any(isinstance(part, Linear) for part in x.parts):
                return Dual(value, x.parts)
            return Dual(value, tuple(self._widened(0.0 * value + part) for part in x.parts))
        return x.widened(self.plan.lanes) if isinstance(x, Lane) else x
