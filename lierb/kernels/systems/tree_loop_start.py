"""Constants, starts and states of a tree in memory."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from itertools import islice
from math import prod
from typing import Any

from lierb.kernels.functions.function import size_of
from lierb.kernels.groups import se3
from lierb.kernels.mechanics import subgroup, tree_nodes
from lierb.kernels.mechanics.saddle import LIGHTEST
from lierb.kernels.mechanics.spatial import Pose, Rigid, twist_at
from lierb.kernels.mechanics.tree import FREE, GROUND, HERE, Node, NodeConstants
from lierb.kernels.mechanics.tree_nodes import JointKind, Kind
from lierb.kernels.numbers.arithmetic import flatten, fma, load, sqrt, where
from lierb.kernels.numbers.dual import Dual
from lierb.kernels.numbers.vec import IDENTITY, ZERO3, ZERO6, ZERO9, Vec, dot, norm, sub
from lierb.kernels.numbers.zero import ZERO, is_zero
from lierb.kernels.systems import tree_places as at
from lierb.kernels.systems.connection_table import EASY, placed_shape
from lierb.kernels.systems.layout import Columns, pose_of
from lierb.kernels.systems.measures import JOINT_KEPT
from lierb.kernels.systems.plan import ConstraintKind, ElementKind
from lierb.kernels.systems.signals import states_of
from lierb.kernels.systems.state import State
from lierb.kernels.systems.tree_inputs import (
    JOINT,
    LINK,
    START,
    CheckedStarts,
    chart_of,
    factored,
    given_start,
    node_constants,
    placed_on,
)
from lierb.kernels.systems.tree_memory import (
    LoopBody,
    MemoryConnection,
    MemoryConstraint,
    MemoryElement,
    MemoryNode,
    MemoryTree,
    TreeInMemory,
)
from lierb.kernels.tracing.arrays import Index
from lierb.kernels.tracing.memory import Rows, for_each, if_not_zero, switch

NOTHING = Rigid(ZERO, ZERO3, ZERO9)  # of a massless node
Numbers = Callable[[Index, int], Vec]  # some columns of the inputs, from one on
WIDTHS = tuple(Columns(*fields).count for fields in (LINK, JOINT, START))
_PAIR = (Node(GROUND, 1, "reduced", FREE, ()), Node(0, 0, "reduced", FREE, ()))


class LoopStart(TreeInMemory, CheckedStarts):
    """Constants, starts and states in memory."""

    def state_of(self, numbers: Sequence[Any], body: LoopBody | None = None) -> State:
        v, work, *states = numbers
        return State((), (), (v,), work if self.plan.does_work else ZERO, tuple(states))

    def _numbers(self, inputs: Any, first: Index, count: int) -> Vec:
        """Numbers of some columns of the inputs, without derivatives."""
        return tuple(load(inputs, (first + i, 0), self.plan.lanes) for i in range(count))

    def _given(
        self, tree: MemoryTree, inputs: Any, first: Index, count: int, seeds_at: int = at.SEEDS
    ) -> Vec:
        """Numbers of some columns of the inputs.   seeds_at : END_SEEDS for those of an end."""
        directions, numbers = tree.parts, self._numbers(inputs, first, count)
        if not directions:
            return numbers
        seeds = tree[seeds_at] + first * directions
        parts = iter(self._numbers(inputs, seeds, count * directions))
        return tuple(Dual(x, tuple(islice(parts, directions))) for x in numbers)

    def loaded(self, inputs: Any, table: Any, memory: Any) -> LoopBody:
        """Load the constants of all nodes from the inputs into memory."""
        tree = MemoryTree(self.plan, table.address, memory.address)
        ground = tree.ground

        numbers = partial(self._given, tree, inputs)
        gravity = numbers(tree[at.GRAVITY_COLUMN], 3)
        tree_nodes.set_ground(gravity, ground.motion, ground.details)
        ground.constants.put(0, *gravity)

        def one(node: MemoryNode) -> None:
            number = node.entry(at.LINK)
            own = numbers(number * WIDTHS[0], WIDTHS[0])
            held = numbers(tree[at.JOINT_COLUMN] + number * WIDTHS[1], WIDTHS[1])
            parts = Columns(*LINK).parts(own) | Columns(*JOINT).parts(held)
            read = {f"0.{name}": part for name, part in parts.items()}
            frame = tree_nodes.frame_of(node.parent.details)
            read["1.body_frame"] = frame[0] + frame[1]
            found = node_constants(_PAIR, 1, read)

            nothing = NodeConstants(NOTHING, NOTHING.inertia, ZERO3, found.hang, ZERO3, HERE, ZERO)
            cases = (found, nothing, found._replace(hang=HERE))  # by role
            into = node.constants, node.details
            switch(node.entry(at.ROLE), cases, lambda n: tree_nodes.store_constants(n, *into))

        tree.for_nodes(one)
        tree.for_elements(lambda element: self._load_element(element, numbers))
        first = tree.node(tree.index(1))
        sums = tree.section(at.SUMS_ROW)
        sums.put(0, 0.0, 0.0)

        def weigh(node: MemoryNode) -> None:
            _, inertia = tree_nodes.com_and_inertia(node.details)
            trace = inertia[0] + inertia[4] + inertia[8]
            sums.put(0, sums[0] + node.constants[tree_nodes.MASS], sums[1] + trace)

        tree.for_nodes(weigh)
        girth = 0.5 * sums[1] / sums[0]
        mass = first.constants[tree_nodes.MASS]
        body = LoopBody(tree.table, tree.memory, mass, gravity, girth)
        body = self._with_elements(tree, body, numbers)
        if not self.plan.constraint_kinds:
            return body
        tree.for_nodes(_weigh)
        tree.for_nodes(_burden, backward=True)
        tree.for_constraints(partial(self._load_constraint, numbers))
        sums.put(0, sqrt(2.0 * girth), 0.0)
        tree.for_nodes(partial(_measure_node, sums))
        return body._replace(length=sums[0], heavy=sums[1])

    def _with_elements(self, tree: MemoryTree, body: LoopBody, numbers: Numbers) -> LoopBody:
        """Return the constants with those of listed elements, and the times of jumps."""
        placed: list[Any] = []
        frames: list[tuple[Any, ...]] = []
        for k, kind in enumerate(self.plan.listed_kinds):
            inner, outer, found = _placed(tree.listed(k), kind, numbers)
            placed.append(found)
            frames.append((inner, outer) if kind.on_joint else ())
        count = sum(e.is_listed for e in self.plan.elements)
        others: tuple[Any, ...] = ((),) * (len(self.plan.elements) - count)
        jumping = zip(self.plan.listed_kinds, placed, strict=True)
        jumps = (time for kind, own in jumping for time in kind.element.jumps(own))
        return body._replace(
            elements=(*others, *placed[:count]), frames=tuple(frames[:count]), jumps=tuple(jumps)
        )

    def _load_element(self, element: MemoryElement, numbers: Numbers) -> None:
        def do(kind: ElementKind) -> None:
            inner, outer, placed = _placed(element, kind, numbers)
            frames = (outer, inner) if kind.on_loop else (outer,)
            element.rows.put(0, *flatten(frames), *_stored(kind, placed))

        element.each_kind(do)

    def _load_constraint(self, numbers: Numbers, constraint: MemoryConstraint) -> None:
        def given(part: MemoryConnection) -> tuple[dict[str, Vec], list[Any]]:
            easy = [x for each in (part.node, part.other) for x in _easy_of(each)]
            return _joint_of(part, numbers), easy

        first = given(constraint)

        def do(kind: ConstraintKind) -> None:
            for part in constraint.parts(kind):
                joint, easy = first if part is constraint else given(part)
                stored: Sequence[Any] = ()
                if kind.element is None:
                    frames = _frames_on(part, joint)
                else:
                    inner, outer, placed = _placed(part, kind.element, numbers)
                    frames = inner, outer
                    stored = _stored(kind.element, placed) if part is constraint else ()
                part.rows.put(0, *flatten(frames), *joint["pitch"], *joint["length"])
                part.rows.put(EASY, *easy, *stored)

        constraint.each_kind(do)

    def started(self, body: LoopBody, inputs: Any) -> State:
        """Store the start, from poses and twists in the user's frames; return its `State`."""
        tree = self._tree(body)

        def seat_of(node: MemoryNode) -> Rows:
            """Return rows for place and twist of a node, where its `pulls` are stored later."""
            return node.motion.at(tree.index(tree_nodes.PULLS))

        def given(node: MemoryNode) -> None:
            first = tree[at.START_COLUMN] + node.entry(at.LINK) * WIDTHS[2]
            parts = Columns(*START).parts(self._given(tree, inputs, first, WIDTHS[2]))
            read = {f"0.{name}": part for name, part in parts.items()}
            frame = tree_nodes.frame_of(node.details)
            place, twist = given_start(frame, read, 0)
            seat_of(node).put(0, *place[0], *place[1], *twist)

        tree.for_nodes(given)
        seat_of(tree.ground).put(0, *IDENTITY, *ZERO3, *ZERO6)

        def relative(node: MemoryNode) -> None:
            base = tree.node(node.entry(at.BASE))
            own, outer = seat_of(node), seat_of(base.parent)
            outside = outer[0:9], outer[9:12]
            seat = se3.compose(se3.inverse(outside), (own[0:9], own[9:12]))
            moving = sub(own[12:18], twist_at(seat, outer[12:18]))
            hang = tree_nodes.hang_of(base.constants)
            d = se3.compose(se3.inverse(hang), seat)

            def keep(node: MemoryNode, kind: Kind, d: Pose, moving: Vec) -> None:
                slots, pitch = kind.slots, kind.pitch(node.constants)
                chart = chart_of(Node(GROUND, 0, "reduced", slots, ()), d)
                chart = subgroup.on_subgroup(slots, chart)
                kind.store_chart(node.next_chart, tree_nodes.tidied(slots, chart, pitch))
                node.next_v.put(0, *subgroup.coordinates(slots, moving))

            def do(joint: JointKind) -> None:
                if joint.role == tree_nodes.MASSLESS:
                    return  # stored with the next node
                if joint.first is None:
                    keep(node, joint.kind, d, moving)
                    return
                first, last = factored(joint.first, joint.kind.slots, d, moving)
                keep(base, Kind(joint.first), *first)
                keep(node, joint.kind, *last)

            node.each_joint(do)

        tree.for_nodes(relative)
        return self._begun(body)

    def resumed(self, body: LoopBody, inputs: Any) -> State:
        """Store a state to continue from, and return its `State`."""
        tree = self._tree(body)
        given = partial(self._given, tree, inputs, seeds_at=at.END_SEEDS)

        def one(node: MemoryNode) -> None:
            chart, v = (
                given(tree[name] + (node.i + -1) * width, width)
                for name, width in ((at.CHART_COLUMN, 7), (at.V_COLUMN, 6))
            )

            def do(kind: Kind) -> None:
                kind.store_chart(node.next_chart, (chart[:4], chart[4:]))
                node.next_v.put(0, *subgroup.coordinates(kind.slots, v))

            node.each_kind(do)

        tree.for_nodes(one)
        states = given(tree[at.STATES_COLUMN], size_of(states_of(self.plan)))
        return self._begun(body)._replace(states=states)

    def resumed_lane(self, body: LoopBody, inputs: Any, count: int) -> Vec:
        """Load the numbers of a lane at the end of the run before."""
        tree = self._tree(body)
        return self._given(tree, inputs, tree[at.LANE_COLUMN], count, at.END_SEEDS)

    def _begun(self, body: LoopBody) -> State:
        if not self.plan.has_lane_clocks:
            self.clear_errors(body, 1.0 + 0.0 * body.mass)
        zero = 0.0 * body.mass
        return State((), (), (zero,), zero if self.plan.does_work else ZERO)

    # ---- states in memory ----

    def clear_errors(self, body: LoopBody, mask: Any) -> None:
        """Set JOINT_KEPT to 0 where the mask, 1 or 0, is 1."""
        tree = self._tree(body).values
        kept = tree.section(at.KEPT_ROW)
        count = tree[at.JOINTS] * len(JOINT_KEPT)
        for_each(count, lambda i: kept.put(i, where(mask > 0.5, 0.0, kept[i])))

    def take_next(self, body: LoopBody, mask: Any) -> None:
        """Make the next state the state where the mask is 1."""
        tree = self._tree(body)
        now, after = self._states(tree, tree.packs)
        for_each(self._packs(tree), lambda i: now.put(i, where(mask > 0.5, after[i], now[i])))

    def exchange(self, body: LoopBody) -> None:
        """Exchange the state and the next one."""
        tree = self._tree(body)
        now, after = self._states(tree, tree.packs)

        def one(i: Index) -> None:
            first, second = now[i], after[i]
            now.put(i, second)
            after.put(i, first)

        for_each(self._packs(tree), one)

    def copy_next(self, body: LoopBody, mask: Any, is_back: bool = False) -> None:
        """Copy the next state, or copy it back, where the mask is 1."""
        tree = self._tree(body)
        _, after = self._states(tree, tree.packs)
        pair = after, tree.packs(tree[at.COPY_ROW])
        source, target = reversed(pair) if is_back else pair
        count = self._packs(tree)
        for_each(count, lambda i: target.put(i, where(mask > 0.5, source[i], target[i])))

    def _states(self, tree: MemoryTree, rows: Callable[[Index], Rows]) -> tuple[Rows, Rows]:
        """Return the rows of the state, and of the next one.   rows : from a number on."""
        first = tree[at.CHART_ROW]
        return rows(first), rows(first + tree[at.AHEAD])

    def _packs(self, tree: MemoryTree) -> Index:
        """Return the number of packs of a state."""
        return tree[at.STATE] * self.plan.packs


def _joint_of(connection: MemoryConnection, numbers: Numbers) -> dict[str, Vec]:
    """Inputs of a connection's joint."""
    first = connection.tree[at.JOINT_COLUMN] + connection.entry(at.ON_JOINT) * WIDTHS[1]
    return Columns(*JOINT).parts(numbers(first, WIDTHS[1]))


def _frames_on(connection: MemoryConnection, joint: dict[str, Vec]) -> tuple[Pose, Pose]:
    """Frames of a joint on the two nodes of a connection."""
    frames = (tree_nodes.frame_of(x.details) for x in (connection.node, connection.other))
    own, ground = pose_of(joint["body_frame"]), pose_of(joint["ground_frame"])
    inner, outer = (
        se3.compose(se3.inverse(frame), place)
        for frame, place in zip(frames, (own, ground), strict=True)
    )
    return inner, outer


def _placed(
    connection: MemoryConnection, kind: ElementKind, numbers: Numbers
) -> tuple[Pose, Pose, Any]:
    """Frames between which an element acts, on its nodes, and its parameters there."""
    node = connection.node
    frame, other = (tree_nodes.frame_of(x.details) for x in (node, connection.other))
    own, ground, inner, outer = frame, HERE if kind.on_ground else other, HERE, HERE
    if kind.on_joint:
        joint = _joint_of(connection, numbers)
        own, ground = pose_of(joint["body_frame"]), pose_of(joint["ground_frame"])
        inner, outer = _frames_on(connection, joint)
    column, given = connection.entry(at.COLUMN), {}
    for name, shape in kind.element.shapes.items():
        found = numbers(column, prod(shape))
        given[name], column = found if shape else found[0], column + prod(shape)
    mass, (com, inertia) = (
        node.constants[tree_nodes.MASS], tree_nodes.com_and_inertia(node.details)
    )  # fmt: skip
    placed = placed_on(kind.element, given, mass, inertia, com, frame, own, ground)
    return inner, outer, placed


def _stored(kind: ElementKind, placed: Any) -> list[Any]:
    """Numbers of an element's parameters that are in memory."""
    pairs = zip(flatten(placed), flatten(placed_shape(kind)), strict=True)
    return [x for x, shape in pairs if not is_zero(shape)]


def _measure_node(sums: Any, node: MemoryNode) -> None:
    """Add a node's lever arms to the mechanism's length, and the root of its mass to the other."""
    com, _ = tree_nodes.com_and_inertia(node.details)
    _, point = tree_nodes.hang_of(node.constants)
    root = sqrt(node.constants[tree_nodes.MASS])
    sums.put(0, sums[0] + norm(com) + norm(point), sums[1] + root)


# ---- mobilities of nodes -----------------------------------------------------------------------


def _weigh(node: MemoryNode) -> None:
    """Store mass and approximate inertia, where the motion is stored later."""
    *inertia, mass = tree_nodes.inertias_of(node.constants)
    node.motion.put(0, mass, 0.5 * sum(inertia))


def _burden(node: MemoryNode) -> None:
    """Add a node's mass and inertia to those of its parent; see `tree_inputs.with_burdens`."""
    (mass, inertia), parent = node.motion[0:2], node.parent.motion
    _, arm = tree_nodes.hang_of(node.constants)

    def add() -> None:
        before, about = parent[0:2]
        parent.put(0, before + mass, about + fma(mass, dot(arm, arm), inertia))

    if_not_zero(node.entry(at.PARENT), add)


def _easy_of(node: MemoryNode) -> Vec:
    mass, inertia = (LIGHTEST * x for x in node.motion[0:2])
    return tree_nodes.easy_of(node.constants, (*(inertia,) * 3, mass))
