"""System of a tree of any size: loops over nodes whose numbers are in memory.

The code depends on the kinds of nodes, not on the tree (`lierb.kernels.systems.tree_table`), so
that it is compiled once for all trees. Charts and velocities of a state are in the memory of its
thread, one state at a time: `combine` stores X and V of a stage beside them, `move` makes the stage
the state. A `State` has the sum of all numbers of charts and velocities in place of V: it is finite
if they are.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from math import prod
from typing import Any, NamedTuple

from lierb.kernels.functions.signals import NO_SIGNALS, Signals
from lierb.kernels.groups import se3
from lierb.kernels.mechanics import subgroup, tree_nodes
from lierb.kernels.mechanics.spatial import Pose, Rigid, twist_at
from lierb.kernels.mechanics.tree import (
    FREE,
    GROUND,
    HERE,
    Connection,
    Ends,
    Node,
    NodeConstants,
)
from lierb.kernels.mechanics.tree_nodes import CONSTANTS, DETAILS, MOTION, PASSED, JointKind, Kind
from lierb.kernels.numbers.arithmetic import (
    flatten,
    load,
    maximum,
    plain,
    refilled,
    scatter,
    sqrt,
    store,
    where,
)
from lierb.kernels.numbers.vec import IDENTITY, ZERO3, ZERO6, ZERO9, Vec, add, dot, sub
from lierb.kernels.numbers.zero import ZERO, is_zero
from lierb.kernels.systems import tree_table as at
from lierb.kernels.systems.combine import summed, weighted
from lierb.kernels.systems.layout import POSE_AND_TWIST, Columns, Field, pose_of
from lierb.kernels.systems.measures import JOINT_ERRORS, JOINT_KEPT, Observed, orthogonality_squared
from lierb.kernels.systems.plan import ElementKind, LoopPlan
from lierb.kernels.systems.relatives import multipliers_of_wrench
from lierb.kernels.systems.signals import PassiveElements
from lierb.kernels.systems.state import Factors, Rates, Slopes, Stabilised, State, Units, Weights
from lierb.kernels.systems.tree_inputs import (
    JOINT,
    LINK,
    START,
    chart_of,
    factored,
    given_start,
    node_constants,
    placed_on,
)
from lierb.kernels.systems.tree_table import placed_shape, slopes_of
from lierb.kernels.tracing.arrays import Index
from lierb.kernels.tracing.memory import Rows, for_each, if_not_zero, integer_at, procedure, switch

NAN = float("nan")
NOTHING = Rigid(ZERO, ZERO3, ZERO9)  # of a massless node
WIDTHS = tuple(Columns(*fields).count for fields in (LINK, JOINT, START))
_PAIR = (Node(GROUND, 1, "reduced", FREE, ()), Node(0, 0, "reduced", FREE, ()))
ENERGY, ORTHOGONALITY, ERRORS, POWER = 0, 1, 2, 6  # rows of sums


class LoopBody(NamedTuple):
    """Addresses of a tree's table and of a thread's memory, with the constants of the nodes.

    mass : of the first link, as an example of the number type.   girth : see `TreeConstants`.
    """

    table: Any
    memory: Any
    mass: Any
    gravity: Vec
    girth: Any
    dropped: Any = ZERO
    signals: Signals = NO_SIGNALS


class _Node:
    """A node at run time."""

    def __init__(self, tree: _Tree, i: Index) -> None:
        self.tree, self.i = tree, i

    def entry(self, name: int) -> Index:
        return integer_at(self.tree.table, self.i * at.TABLE + (at.HEADER + name))

    def part(self, first: int, width: int, of: Index | None = None) -> Rows:
        """Rows of a node in a section with `width` rows for each.   of : another node."""
        i = self.i if of is None else of
        return self.tree.rows(self.tree[first] + i * width)

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
        return self.part(at.MOTION_ROW, MOTION, self.entry(at.PARENT))

    def on_joint(self, joint: JointKind) -> tuple[Pose, Vec]:
        """D of the node's joint and V_rel, composed of those of two nodes if it has two."""

        def of(node: _Node, kind: Kind) -> tuple[Pose, Vec]:
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
    def parent(self) -> _Node:
        return self.tree.node(self.entry(at.PARENT))

    def each_kind(self, do: Callable[[Kind], None]) -> None:
        """Emit the code of all kinds, of which the node's runs."""
        switch(self.entry(at.KIND), self.tree.plan.kinds, do)


class _Element:
    """An element at run time."""

    def __init__(self, tree: _Tree, k: Index) -> None:
        self.tree, self.k = tree, k

    def entry(self, name: int) -> Index:
        return integer_at(self.tree.table, self.tree[at.ELEMENT_TABLE] + self.k * at.ELEMENT + name)

    @property
    def node(self) -> _Node:
        return self.tree.node(self.entry(at.NODE))

    @property
    def other(self) -> _Node:
        """Its other node, or the ground."""
        return self.tree.node(self.entry(at.OTHER))

    @property
    def rows(self) -> Rows:
        return self.tree.rows(self.entry(at.ROW))

    def each_kind(self, do: Callable[[ElementKind], None]) -> None:
        """Emit the code of all kinds, of which the element's runs."""
        if self.tree.plan.element_kinds:
            switch(self.entry(at.ELEMENT_KIND), self.tree.plan.element_kinds, do)

    def placed(self, kind: ElementKind) -> tuple[Pose, Any]:
        """Frame on the other node, and parameters of the element."""
        rows, count = self.rows, tree_nodes.FRAME_ROWS
        outer = tree_nodes.hang_of(rows) if kind.on_joint else HERE
        shape = placed_shape(kind)
        stored = sum(not is_zero(x) for x in flatten(shape))
        numbers = iter(rows[count : count + stored])
        filled = (x if is_zero(x) else next(numbers) for x in flatten(shape))
        return outer, refilled(shape, filled)


class _Tree:
    """A tree at run time: tree[name] is a number of the table's header."""

    def __init__(self, plan: LoopPlan, table: Index, memory: Index) -> None:
        self.plan, self.table, self.memory = plan, table, memory

    def __getitem__(self, name: int) -> Index:
        return integer_at(self.table, name)

    def rows(self, first: Index | int) -> Rows:
        return Rows(self.memory, self.plan.lanes, first)

    def section(self, name: int) -> Rows:
        return self.rows(self[name])

    def node(self, i: Index) -> _Node:
        return _Node(self, i)

    @property
    def ground(self) -> _Node:
        return self.node(self[at.NODES] * 0)

    def for_elements(self, do: Callable[[_Element], None]) -> None:
        if self.plan.element_kinds:
            for_each(self[at.ELEMENTS], lambda k: do(_Element(self, k)))

    def for_nodes(self, do: Callable[[_Node], None], backward: bool = False) -> None:
        for_each(self[at.NODES], lambda i: do(self.node(i + 1)), backward)


@dataclass(frozen=True)
class TreeLoop(PassiveElements):
    """A `lierb.kernels.systems.system.System`: a mechanism whose nodes are in memory."""

    plan: LoopPlan

    joints: tuple[Connection, ...] = ()  # their errors are in memory, not in a `Record`
    inputs = Columns(Field("state", (0,)))  # read from memory
    state = Columns(Field("v", (1,)), Field("work"))
    invariant = ()
    is_homogeneous = False
    is_light = False
    takes_small_angle_steps = False
    rows = ()

    def _tree(self, body: LoopBody) -> _Tree:
        return _Tree(self.plan, body.table, body.memory)

    def _run(self, name: str, body: LoopBody | _Tree, do: Callable[..., None], *more: Any) -> None:
        """Call a procedure on the tree, whose code is emitted once."""

        def formula(table: Index, memory: Index, *others: Any) -> None:
            do(_Tree(self.plan, table, memory), *others)

        procedure(f"{__name__}.{name}.{self.plan.lanes}", formula, body.table, body.memory, *more)

    # ---- start ----

    def placed(self, body: LoopBody, numbers: list[Any]) -> tuple[()]:
        return ()

    def pose_check(self, numbers: list[Any], time: Any) -> tuple[()]:
        return ()

    def is_on_joint(self, check: tuple[()], numbers: list[Any], time: Any) -> Any:
        """Return 1: `Mechanism.violation` examines starts before they are packed."""
        return 1.0

    def state_of(self, numbers: Sequence[Any], body: LoopBody | None = None) -> State:
        v, work = numbers
        return State((), (), (v,), work if self.plan.does_work else ZERO)

    def loaded(self, inputs: Any, table: Any, memory: Any) -> LoopBody:
        """Load the constants of all nodes from the inputs into memory."""
        tree = _Tree(self.plan, table.address, memory.address)
        ground = tree.ground

        def numbers(first: Index, count: int) -> Vec:
            return tuple(load(inputs, (first + i, 0), self.plan.lanes) for i in range(count))

        gravity = numbers(tree[at.GRAVITY_COLUMN], 3)
        tree_nodes.set_ground(gravity, ground.motion, ground.details)
        ground.constants.put(0, *gravity)

        def one(node: _Node) -> None:
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
        first = tree.node(tree[at.NODES] * 0 + 1)
        sums = tree.section(at.SUMS_ROW)
        sums.put(0, 0.0, 0.0)

        def weigh(node: _Node) -> None:
            _, inertia = tree_nodes.com_and_inertia(node.details)
            trace = inertia[0] + inertia[4] + inertia[8]
            sums.put(0, sums[0] + node.constants[tree_nodes.MASS], sums[1] + trace)

        tree.for_nodes(weigh)
        girth = 0.5 * sums[1] / sums[0]
        mass = first.constants[tree_nodes.MASS]
        return LoopBody(tree.table, tree.memory, mass, gravity, girth)

    def _load_element(self, element: _Element, numbers: Callable[[Index, int], Vec]) -> None:
        tree, node = element.tree, element.node
        first = tree[at.JOINT_COLUMN] + element.entry(at.ON_JOINT) * WIDTHS[1]
        joint = Columns(*JOINT).parts(numbers(first, WIDTHS[1]))
        constants, details = node.constants, node.details
        mass, (com, inertia) = constants[tree_nodes.MASS], tree_nodes.com_and_inertia(details)
        frame, other = (tree_nodes.frame_of(each.details) for each in (node, element.other))

        def do(kind: ElementKind) -> None:
            own, ground, outer = frame, HERE if kind.on_ground else other, HERE
            if kind.on_joint:
                own, ground = pose_of(joint["body_frame"]), pose_of(joint["ground_frame"])
                outer = se3.compose(se3.inverse(other), ground)
            column, given = element.entry(at.COLUMN), {}
            for name, shape in kind.element.shapes.items():
                found = numbers(column, prod(shape))
                given[name], column = found if shape else found[0], column + prod(shape)
            placed = placed_on(kind.element, given, mass, inertia, com, frame, own, ground)
            pairs = zip(flatten(placed), flatten(placed_shape(kind)), strict=True)
            stored = (x for x, shape in pairs if not is_zero(shape))
            element.rows.put(0, *outer[0], *outer[1], *stored)

        element.each_kind(do)

    def started(self, body: LoopBody, inputs: Any) -> State:
        """Store the start, from poses and twists in the user's frames; return its `State`."""
        tree = self._tree(body)
        zero = tree[at.NODES] * 0
        seats = at.MOTION_ROW  # place and twist of each node, where motions are stored later

        def given(node: _Node) -> None:
            first = tree[at.START_COLUMN] + node.entry(at.LINK) * WIDTHS[2]
            numbers = [load(inputs, (first + i, 0), self.plan.lanes) for i in range(WIDTHS[2])]
            parts = Columns(*START).parts(numbers)
            read = {f"0.{name}": part for name, part in parts.items()}
            frame = tree_nodes.frame_of(node.details)
            place, twist = given_start(frame, read, 0)
            node.part(seats, MOTION).put(0, *place[0], *place[1], *twist)

        tree.for_nodes(given)
        tree.node(zero).part(seats, MOTION).put(0, *IDENTITY, *ZERO3, *ZERO6)

        def relative(node: _Node) -> None:
            base = tree.node(node.entry(at.BASE))
            own, outer = node.part(seats, MOTION), base.above
            outside = outer[0:9], outer[9:12]
            seat = se3.compose(se3.inverse(outside), (own[0:9], own[9:12]))
            moving = sub(own[12:18], twist_at(seat, outer[12:18]))
            hang = tree_nodes.hang_of(base.constants)
            d = se3.compose(se3.inverse(hang), seat)

            def keep(node: _Node, kind: Kind, d: Pose, moving: Vec) -> None:
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
        constants, motion = tree.ground.constants, tree.ground.motion
        tree_nodes.set_ground(constants[0:3], motion, tree.ground.details)
        return self._begun(body)

    def resumed(self, body: LoopBody, inputs: Any) -> State:
        """Store a state to continue from, and return its `State`."""
        tree = self._tree(body)

        def one(node: _Node) -> None:
            before = node.i + -1

            def numbers(name: int, width: int) -> Vec:
                first = tree[name] + before * width
                return tuple(load(inputs, (first + i, 0), self.plan.lanes) for i in range(width))

            chart, v = numbers(at.CHART_COLUMN, 7), numbers(at.V_COLUMN, 6)

            def do(kind: Kind) -> None:
                kind.store_chart(node.next_chart, (chart[:4], chart[4:]))
                node.next_v.put(0, *subgroup.coordinates(kind.slots, v))

            node.each_kind(do)

        tree.for_nodes(one)
        return self._begun(body)

    def _begun(self, body: LoopBody) -> State:
        if not self.plan.has_lane_clocks:
            self.clear_errors(body, 1.0 + 0.0 * body.mass)
        zero = 0.0 * body.mass
        return State((), (), (zero,), zero if self.plan.does_work else ZERO)

    # ---- states in memory ----

    def clear_errors(self, body: LoopBody, mask: Any) -> None:
        """Set JOINT_KEPT to 0 where the mask, 1 or 0, is 1."""
        tree = self._tree(body)
        kept = tree.section(at.KEPT_ROW)
        count = tree[at.LINKS] * len(JOINT_KEPT)
        for_each(count, lambda i: kept.put(i, where(mask > 0.5, 0.0, kept[i])))

    def take_next(self, body: LoopBody, mask: Any) -> None:
        """Make the next state the state where the mask is 1."""
        tree = self._tree(body)
        now, after = self._states(tree)
        for_each(tree[at.STATE], lambda i: now.put(i, where(mask > 0.5, after[i], now[i])))

    def exchange(self, body: LoopBody) -> None:
        """Exchange the state and the next one."""
        tree = self._tree(body)
        now, after = self._states(tree)

        def one(i: Index) -> None:
            first, second = now[i], after[i]
            now.put(i, second)
            after.put(i, first)

        for_each(tree[at.STATE], one)

    def copy_next(self, body: LoopBody, is_back: bool = False) -> None:
        """Copy the next state, or copy it back."""
        tree = self._tree(body)
        _, after = self._states(tree)
        pair = after, tree.section(at.COPY_ROW)
        source, target = reversed(pair) if is_back else pair
        for_each(tree[at.STATE], lambda i: target.put(i, source[i]))

    def _states(self, tree: _Tree) -> tuple[Rows, Rows]:
        first = tree[at.CHART_ROW]
        return tree.rows(first), tree.rows(first + tree[at.AHEAD])

    # ---- steps ----

    def chart_gravity(self, body: LoopBody, chart: Any) -> None:
        """Return None: gravity enters at the ground."""

    def combine(
        self,
        body: LoopBody,
        state: State,
        weights: Weights,
        slopes: Slopes,
        units: Units,
        factors: Factors | None = None,
    ) -> State:
        """Store X/2 and V of a stage."""
        assert factors is None
        tree, lanes = self._tree(body), self.plan.lanes
        stages = [j for j, w in enumerate(weights) if not (isinstance(w, float) and w == 0.0)]
        chosen = tuple(weights[j] for j in stages)
        count = tree[at.FREEDOMS]
        x, v, before = map(tree.section, (at.X_ROW, at.STAGE_ROW, at.V_ROW))
        of_x, of_v = (
            [Rows(body.memory, lanes, tree[name] + count * j) for j in stages]
            for name in (at.X_SLOPES, at.V_SLOPES)
        )

        def one(i: Index) -> None:
            nothing: Vec = (ZERO,)
            half = summed(nothing, units.x, chosen, tuple((k[i],) for k in of_x), units)
            now = summed((before[i],), units.v_or_mu, chosen, tuple((k[i],) for k in of_v), units)
            x.put(i, half[0])
            v.put(i, now[0])

        for_each(count, one)
        (work,) = summed((state.work,), units.other, weights, slopes.work, units)
        return state._replace(work=work)

    def stage_rates(
        self, body: LoopBody, state: State, gravity: None, time: Any, stage: int = 0
    ) -> Rates:
        """Store the slopes of a stage as those of number `stage`."""
        tree = self._tree(body)
        ahead = tree[at.FREEDOMS] * stage
        self._run("rates", body, self._rates, ahead, time)
        power = tree.section(at.SUMS_ROW)[POWER] if self.plan.does_work else ZERO
        return Rates((), (), power)

    def _rates(self, tree: _Tree, ahead: Index, time: Any) -> None:
        acts = bool(self.plan.element_kinds)

        def gather(node: _Node) -> None:
            constants, here = node.constants, node.motion
            own, children = (tree.rows(node.entry(name)) for name in (at.PASSES, at.CHILDREN))

            load = node.part(at.LOADS_ROW, 6)[0:6] if acts else None

            def do(kind: Kind) -> None:
                total, lacking, arm = tree_nodes.gather(kind, constants, children, here, load)
                if_not_zero(
                    node.entry(at.PARENT), lambda: tree_nodes.pass_on(own, total, lacking, arm)
                )

            node.each_kind(do)
            sibling = node.entry(at.SIBLING)

            def add() -> None:
                other = tree.rows(sibling)
                pairs = zip(own[0:PASSED], other[0:PASSED], strict=True)
                own.put(0, *(x + y for x, y in pairs))

            if_not_zero(sibling, add)

        def accelerate(node: _Node) -> None:
            constants, above, here = node.constants, node.above, node.motion
            into = node.slopes(at.V_SLOPES, ahead)
            node.each_kind(
                lambda kind: into.put(0, *tree_nodes.accelerate(kind, constants, above, here))
            )

        self._call_place(tree, ahead, is_whole=acts)
        if acts:
            loads = tree.section(at.LOADS_ROW)
            for_each(tree[at.NODES] * 6 + 6, lambda i: loads.put(i, 0.0))
            tree.section(at.SUMS_ROW).put(POWER, 0.0)
            tree.for_elements(lambda element: self._act(element, time))
        tree.for_nodes(gather, backward=True)
        tree.for_nodes(accelerate)

    def _call_place(self, tree: _Tree, ahead: Index, is_whole: bool) -> None:
        """Emit a call of the outward pass at X and V of the stage, which stores Ẋ."""
        whole = tree[at.NODES] if is_whole else tree[at.NODES] * 0
        self._run("place", tree, self._place, ahead, whole)

    def _place(self, tree: _Tree, ahead: Index, whole: Index) -> None:
        def one(node: _Node) -> None:
            parts = (node.constants, node.chart, node.freedoms(at.X_ROW))
            v, into = node.freedoms(at.STAGE_ROW), node.slopes(at.X_SLOPES, ahead)
            above, here = node.above, node.motion

            def do(kind: Kind) -> None:
                into.put(0, *tree_nodes.place(kind, *parts, v, above, here))
                place = partial(tree_nodes.place_origin, kind, node.constants, v, above, here)
                if_not_zero(whole, place)

            node.each_kind(do)

        tree.for_nodes(one)

    def _act(self, element: _Element, time: Any) -> None:
        """Add an element's wrench to the loads on its nodes, and its power to the sum."""
        node, other, sums = element.node, element.other, element.tree.section(at.SUMS_ROW)
        places = [each.part(at.LOADS_ROW, 6) for each in (node, other)]

        def do(kind: ElementKind) -> None:
            outer, placed = element.placed(kind)
            x, lever = tree_nodes.between(outer, node.motion, other.motion, time)
            wrench = kind.element.wrench(placed, x)
            if kind.element.does_work:
                sums.put(POWER, sums[POWER] + kind.element.power(placed, x, wrench))
            loads = tree_nodes.loads_of(wrench, node.motion, lever)
            for place, more in zip(places, loads, strict=True):
                place.put(0, *add(place[0:6], more))

        element.each_kind(do)

    def move(self, body: LoopBody, state: State) -> State:
        """Make the stage the state."""
        tree = self._tree(body)
        total = tree.section(at.SUMS_ROW)
        total.put(0, 0.0)

        def one(node: _Node) -> None:
            constants, x = node.constants, node.freedoms(at.X_ROW)
            stage = node.freedoms(at.STAGE_ROW)

            def do(kind: Kind) -> None:
                speeds = stage[0 : kind.freedoms]
                node.next_v.put(0, *speeds)
                chart = tree_nodes.moved(kind, constants, node.chart, x)
                numbers = kind.store_chart(node.next_chart, chart)
                total.put(0, sum((*numbers, *speeds), start=total[0]))

            node.each_kind(do)

        tree.for_nodes(one)
        return state._replace(v_or_mu=(total[0],))

    def silenced(self, body: LoopBody, v: Vec, alive: Any) -> Vec:
        """Store NaN in the velocities of the lanes that are not alive."""
        tree = self._tree(body)
        rows = tree.section(at.V_ROW)
        for_each(tree[at.FREEDOMS], lambda i: rows.put(i, where(alive, rows[i], NAN)))
        return v

    def tidied(self, body: LoopBody, chart: Any) -> Any:
        tree = self._tree(body)

        def one(node: _Node) -> None:
            v = node.freedoms(at.V_ROW)

            def do(kind: Kind) -> None:
                chart, pitch = kind.load_chart(node.chart), kind.pitch(node.constants)
                kind.store_chart(node.next_chart, tree_nodes.tidied(kind.slots, chart, pitch))
                node.next_v.put(0, *v[0 : kind.freedoms])

            node.each_kind(do)

        tree.for_nodes(one)
        return chart

    def jumps(self, body: LoopBody) -> tuple[Any, ...]:
        return ()

    # ---- error control: squares of all rotations, positions, ω and v ----

    def sizes(self, body: LoopBody, is_next: bool) -> tuple[Any, Any, Any]:
        """‖y‖² of the positions on the joints, ω and v, of the state or the next one."""

        def measure(tree: _Tree) -> None:
            sums = tree.section(at.SUMS_ROW)
            sums.put(0, 0.0, 0.0, 0.0)

            def one(node: _Node) -> None:
                chart = node.next_chart if is_next else node.chart
                v = node.next_v if is_next else node.freedoms(at.V_ROW)

                def do(kind: Kind) -> None:
                    moving = kind.lifted(v, kind.pitch(node.constants))
                    _add_squares(sums, kind.load_chart(chart)[1], moving[:3], moving[3:])

                node.each_kind(do)

            tree.for_nodes(one)

        self._run(f"sizes.{is_next}", body, measure)
        sums = self._tree(body).section(at.SUMS_ROW)
        return sums[0], sums[1], sums[2]

    def slope_squares(self, body: LoopBody, weights: dict[int, Any]) -> tuple[Any, ...]:
        """Squares of rotations, positions, ω and v in Σ w k.   weights : w by the slope's index."""
        tree, count = self._tree(body), self._tree(body)[at.FREEDOMS]
        for name, into in ((at.X_SLOPES, at.X_ROW), (at.V_SLOPES, at.STAGE_ROW)):
            slopes = [tree.rows(tree[name] + count * j) for j in weights]
            _store_sums(tree.section(into), slopes, tuple(weights.values()), count)
        self._run("squares", body, self._squares)
        return tree.section(at.SUMS_ROW)[0:4]

    def _squares(self, tree: _Tree) -> None:
        """Store the squares of the numbers in the rows of X and V of the stage."""
        sums = tree.section(at.SUMS_ROW)
        sums.put(0, 0.0, 0.0, 0.0, 0.0)

        def one(node: _Node) -> None:
            def do(kind: Kind) -> None:
                pitch = kind.pitch(node.constants)
                x, v = (kind.lifted(node.freedoms(row), pitch) for row in (at.X_ROW, at.STAGE_ROW))
                _add_squares(sums, x[:3], x[3:], v[:3], v[3:])

            node.each_kind(do)

        tree.for_nodes(one)

    def stabilised(
        self, body: LoopBody, before: State, state: State, time: Any, h: Any
    ) -> Stabilised:
        return Stabilised(state)

    def turns_and_places(self, chart: Any) -> tuple[Vec, Vec]:
        return (), ()

    def angular_speeds_squared(self, body: LoopBody, state: State) -> list[Any]:
        return []

    # ---- measures ----

    def motion(self, body: LoopBody, state: State, time: Any) -> None:
        """Store the motion of the nodes at the state."""
        tree = self._tree(body)
        self._stay(tree)
        self._call_place(tree, self._spare(tree), is_whole=True)

    def _spare(self, tree: _Tree) -> Index:
        """Rows of all slopes of a step, behind which those of a state at rest are."""
        return tree[at.FREEDOMS] * slopes_of(self.plan)

    def _stay(self, tree: _Tree) -> None:
        """Make the state the stage."""
        x, v, stage = (tree.section(name) for name in (at.X_ROW, at.V_ROW, at.STAGE_ROW))

        def copy(i: Index) -> None:
            x.put(i, 0.0)
            stage.put(i, v[i])

        for_each(tree[at.FREEDOMS], copy)

    def observed(self, body: LoopBody, motion: None, time: Any) -> tuple[Any, ...]:
        return ()

    def dropped(self, body: LoopBody, state: State) -> Any:
        return ZERO

    def measured(
        self, body: LoopBody, state: State, motion: None, time: Any, first_energy: Any = ZERO
    ) -> Observed:
        """Return every measure; store the errors of the joints."""
        self._run("measure", body, self._measure)
        sums = self._tree(body).section(at.SUMS_ROW)
        energy, orthogonality, *errors = sums[0 : ERRORS + len(JOINT_ERRORS)]
        names = (measure.name for measure in JOINT_ERRORS)
        values = dict(zip(names, errors, strict=True)) | {
            "energy": energy,
            "energy_drift": energy - first_energy - state.work,
            "work": state.work,
            "orthogonality_error": orthogonality,
        }
        return Observed(values)

    def _measure(self, tree: _Tree) -> None:
        sums, gravity = tree.section(at.SUMS_ROW), tree.ground.constants[0:3]
        sums.put(0, *(0.0,) * at.SUMS)

        def one(node: _Node) -> None:
            constants, here = node.constants, node.motion
            own = tree_nodes.energy(constants, node.details, here, gravity)
            off = orthogonality_squared(here[0:9])
            sums.put(ENERGY, sums[ENERGY] + own, maximum(sums[ORTHOGONALITY], off))
            errors = node.part(at.ERRORS_ROW, len(JOINT_ERRORS), node.entry(at.LINK))

            def do(joint: JointKind) -> None:
                if joint.role == tree_nodes.MASSLESS:
                    return  # measured with the next node
                d, moving = node.on_joint(joint)
                pitch = joint.kind.pitch(constants)
                squares = tree_nodes.errors_squared(joint.rows, d, moving, pitch)
                errors.put(0, *squares)
                for row, square in enumerate(squares, ERRORS):
                    if not is_zero(square):
                        sums.put(row, maximum(sums[row], square))

            node.each_joint(do)

        def potential(element: _Element) -> None:
            node, other = element.node.motion, element.other.motion

            def do(kind: ElementKind) -> None:
                outer, placed = element.placed(kind)
                x, _ = tree_nodes.between(outer, node, other, ZERO)  # no potential depends on time
                energy = kind.element.energy(placed, x)
                if not is_zero(energy):
                    sums.put(ENERGY, sums[ENERGY] + energy)

            element.each_kind(do)

        tree.for_nodes(one)
        tree.for_elements(potential)

    def keep_errors(self, body: LoopBody, alive: Any, now: Any) -> None:
        """Update JOINT_KEPT of every joint in memory by the errors that `measured` has stored.

        now : mask of the lanes to update.
        """
        tree = self._tree(body)

        def one(link: Index) -> None:
            errors = tree.rows(tree[at.ERRORS_ROW] + link * len(JOINT_ERRORS))
            kept = tree.rows(tree[at.KEPT_ROW] + link * len(JOINT_KEPT))
            for row, (measure, how) in enumerate(JOINT_KEPT):
                square = errors[JOINT_ERRORS.index(measure)]
                old = kept[row]
                if how == "final":
                    new = where(alive, plain(square), NAN)
                else:
                    new = where(alive, maximum(old, square), old)
                kept.put(row, where(now, new, old))

        for_each(tree[at.LINKS], one)

    # ---- results: written into the result arrays, as many as there are links ----

    def store_errors(
        self, body: LoopBody, history: Any, first: int, row: Any, column: Any, alive: Any
    ) -> None:
        """Store JOINT_ERRORS of every joint in a history, from column `first` on."""
        tree, count = self._tree(body), len(JOINT_ERRORS)

        def one(link: Index) -> None:
            squares = tree.rows(tree[at.ERRORS_ROW] + link * count)[0:count]
            errors = [where(alive, sqrt(square), NAN) for square in squares]
            columns = [link * count + (first + c) for c in range(count)]
            places = [(c, row, column) for c in columns]
            scatter(history, 2, places, errors, self.plan.lanes)

        for_each(tree[at.LINKS], one)

    def store_kept(self, body: LoopBody, summary: Any, first: int, column: Any) -> None:
        """Store JOINT_KEPT of every joint in a summary, from column `first` on."""
        tree, count = self._tree(body), len(JOINT_KEPT)

        def one(link: Index) -> None:
            kept = tree.rows(tree[at.KEPT_ROW] + link * count)[0:count]
            places = [(link * count + (first + c), column) for c in range(count)]
            scatter(summary, 1, places, [sqrt(square) for square in kept], self.plan.lanes)

        for_each(tree[at.LINKS], one)

    def store_links(
        self, body: LoopBody, states: tuple[Any, ...], row: Any, rows: Any, column: Any, alive: Any
    ) -> None:
        """Store R, r, ω and v of every link in the user's frames; NaN where not alive."""
        self.motion(body, State((), (), ()), ZERO)
        tree = self._tree(body)

        def one(node: _Node) -> None:
            is_link = node.entry(at.ROLE) + -tree_nodes.MASSLESS
            if_not_zero(is_link, lambda: link(node))

        def link(node: _Node) -> None:
            numbers = tree_nodes.in_user_frame(node.details, node.motion)
            shown = tuple(where(alive, x, NAN) for x in numbers)
            at_row = node.entry(at.LINK) * rows + row
            for array, part in zip(states, POSE_AND_TWIST.parts(shown).values(), strict=True):
                places = [(at_row, column, c) for c in range(len(part))]
                scatter(array, 1, places, part, self.plan.lanes)

        tree.for_nodes(one)

    def put_links(self, body: LoopBody, shown: Any, alive: Any) -> None:
        """Store the numbers of `store_links` in the rows of a lane's workspace."""
        self.motion(body, State((), (), ()), ZERO)
        tree, width = self._tree(body), POSE_AND_TWIST.count

        def link(node: _Node) -> None:
            numbers = tree_nodes.in_user_frame(node.details, node.motion)
            first = node.entry(at.LINK) * width
            for c, x in enumerate(numbers):
                store(shown, (first + c, 0), where(alive, x, NAN), self.plan.lanes)

        def one(node: _Node) -> None:
            if_not_zero(node.entry(at.ROLE) + -tree_nodes.MASSLESS, lambda: link(node))

        tree.for_nodes(one)

    def store_forces(
        self, body: LoopBody, multipliers: Any, reactions: Any, place: Any, time: Any, alive: Any
    ) -> None:
        """Store λ and the wrench of every joint on its body; NaN where not alive.

        multipliers, reactions : result arrays.   place : row, rows and column in them.
        """
        tree, acts = self._tree(body), bool(self.plan.element_kinds)
        self._stay(tree)
        self._run("rates", body, self._rates, self._spare(tree), time)
        wrenches = tree.section(at.WRENCH_ROW)
        for_each(tree[at.NODES] * 6 + 6, lambda i: wrenches.put(i, 0.0))

        def one(node: _Node) -> None:
            load = node.part(at.LOADS_ROW, 6)[0:6] if acts else None
            own = node.part(at.WRENCH_ROW, 6)
            total = add(own[0:6], tree_nodes.transmitted(node.constants, node.motion, load))
            outer = node.parent.part(at.WRENCH_ROW, 6)
            outer.put(0, *add(outer[0:6], tree_nodes.passed_wrench(total, node.motion)))
            own.put(0, *tree_nodes.in_node_axes(total, node.motion))

        def put(array: Any, first: Any, column: Any, numbers: Vec) -> None:
            shown = [where(alive, x, NAN) for x in numbers]
            places = [(first, place.column, column + c) for c in range(len(shown))]
            scatter(array, 1, places, shown, self.plan.lanes)

        def put_joint(node: _Node) -> None:
            wrench = node.part(at.WRENCH_ROW, 6)[0:6]

            def do(joint: JointKind) -> None:
                if joint.role == tree_nodes.MASSLESS:
                    return
                if self.plan.reaction:
                    first = node.entry(at.LINK) * place.rows + place.row
                    put(reactions, first, tree[at.NODES] * 0, wrench)
                if self.plan.multipliers and joint.rows:
                    x = tree_nodes.kinematics(*node.on_joint(joint))
                    ends = Ends(HERE, HERE, joint.kind.pitch(node.constants))
                    found = multipliers_of_wrench(joint.rows, x, ends, wrench)
                    numbers = tuple(found[row] for row in joint.rows)
                    put(multipliers, place.row, node.entry(at.MULTIPLIER), numbers)

            node.each_joint(do)

        tree.for_nodes(one, backward=True)
        tree.for_nodes(put_joint)

    def store_end(self, body: LoopBody, ends: Any, column: Any) -> None:
        """Store the state for a run that continues: numbers of the charts, then of V_rel."""
        tree = self._tree(body)

        def put(first: Index, numbers: Any) -> None:
            some = [x for x in flatten(numbers) if not is_zero(x)]
            if some:
                places = [(first + c, column) for c in range(len(some))]
                scatter(ends, 1, places, some, self.plan.lanes)

        def one(node: _Node) -> None:
            chart, v, constants = node.chart, node.freedoms(at.V_ROW), node.constants
            columns = node.entry(at.CHART_END), node.entry(at.V_END)

            def do(kind: Kind) -> None:
                put(columns[0], kind.load_chart(chart))
                put(columns[1], kind.lifted(v, kind.pitch(constants)))

            node.each_kind(do)

        tree.for_nodes(one)

    def end_columns(self, body: LoopBody) -> Index:
        """Number of a state's columns at the end of a run."""
        return self._tree(body)[at.END_COLUMNS]

    def lane_column(self, body: LoopBody) -> Index:
        """Column of the inputs with a lane's clock at the end of the run before."""
        return self._tree(body)[at.LANE_COLUMN]

    def store_state(self, body: LoopBody, carried: Any, first: int, column: Any) -> None:
        """Store charts, velocities and JOINT_KEPT between two calls, from row `first` on."""
        tree, lanes = self._tree(body), self.plan.lanes
        rows = tree.section(at.CHART_ROW)
        for_each(tree[at.STATE_ROWS], lambda i: carried.store((i + first, column), rows[i], lanes))

    def load_state(self, body: LoopBody, carried: Any, first: int, column: Any) -> None:
        tree, lanes = self._tree(body), self.plan.lanes
        rows = tree.section(at.CHART_ROW)
        for_each(
            tree[at.STATE_ROWS], lambda i: rows.put(i, carried.load((i + first, column), lanes))
        )


def _store_sums(into: Rows, slopes: list[Rows], weights: tuple[Any, ...], count: Index) -> None:
    """Store Σ w k of so many rows."""

    def one(i: Index) -> None:
        into.put(i, weighted((ZERO,), weights, tuple((row[i],) for row in slopes))[0])

    for_each(count, one)


def _add_squares(sums: Rows, *parts: Vec) -> None:
    for row, part in enumerate(parts):
        square = dot(part, part)
        if not is_zero(square):
            sums.put(row, sums[row] + square)
