"""Steps of a tree in memory, and the sizes of their errors."""

from __future__ import annotations

from functools import partial
from typing import Any

from lierb.kernels.mechanics import tree_nodes
from lierb.kernels.mechanics.tree_connections import loads_of
from lierb.kernels.mechanics.tree_nodes import PASSED, Kind
from lierb.kernels.numbers.arithmetic import where
from lierb.kernels.numbers.vec import Vec, add, dot
from lierb.kernels.numbers.zero import ZERO, is_zero
from lierb.kernels.systems import tree_places as at
from lierb.kernels.systems.combine import NAN, summed, weighted
from lierb.kernels.systems.plan import ElementKind
from lierb.kernels.systems.state import Factors, Rates, Slopes, State, Units, Weights
from lierb.kernels.systems.tree_loop_rows import LoopRows
from lierb.kernels.systems.tree_memory import LoopBody, MemoryElement, MemoryNode, MemoryTree
from lierb.kernels.systems.tree_table import slopes_of
from lierb.kernels.tracing.arrays import Index
from lierb.kernels.tracing.lanes import Lane
from lierb.kernels.tracing.memory import Rows, for_each, if_not_zero


class LoopSteps(LoopRows):
    """Steps and error control."""

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
        tree = self._tree(body)
        stages = [j for j, w in enumerate(weights) if not (isinstance(w, float) and w == 0.0)]
        chosen = tuple(weights[j] for j in stages)
        count = tree[at.FREEDOMS]
        x, v, before = map(tree.section, (at.X_ROW, at.STAGE_ROW, at.V_ROW))
        of_x, of_v = (tree.slopes(name, stages) for name in (at.X_SLOPES, at.V_SLOPES))

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
        self._run("rates", body, self._rates, ahead, time, *self._scales(body))
        sums = tree.section(at.SUMS_ROW)
        power = sums[at.POWER] if self.plan.does_work else ZERO
        return Rates((), (), power, sums[at.SINGULAR] if self.plan.constraint_kinds else ZERO)

    def _rates(self, tree: MemoryTree, ahead: Index, time: Any, *scales: Lane) -> None:
        self._load(tree, ahead, time)
        if scales:
            self._constrain(tree, time, *scales)
        self._accelerate(tree, ahead)

    def _load(self, tree: MemoryTree, ahead: Index, time: Any) -> None:
        """Store motions, loads and articulated inertias."""
        acts = bool(self.plan.element_kinds)

        self._call_place(tree, ahead, is_whole=acts or bool(self.plan.constraint_kinds))
        if self.plan.does_work:
            tree.section(at.SUMS_ROW).put(at.POWER, 0.0)
        if acts:
            loads = tree.section(at.LOADS_ROW)
            for_each(tree[at.NODES] * 6 + 6, lambda i: loads.put(i, 0.0))
            tree.for_elements(lambda element: self._act(element, time))
        self._gather(tree, acts)

    def _gather(self, tree: MemoryTree, acts: bool) -> None:
        """Store articulated inertias, and ν̇ by loads alone.   acts : whether elements act."""

        def one(node: MemoryNode) -> None:
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

        tree.for_nodes(one, backward=True)

    def _accelerate(self, tree: MemoryTree, ahead: Index) -> None:
        """Store ν̇ in the slopes."""

        def one(node: MemoryNode) -> None:
            constants, above, here = node.constants, node.above, node.motion
            into = node.slopes(at.V_SLOPES, ahead)
            node.each_kind(
                lambda kind: into.put(0, *tree_nodes.accelerate(kind, constants, above, here))
            )

        tree.for_nodes(one)

    def _call_place(
        self, tree: MemoryTree, ahead: Index, is_whole: bool, of_next: bool = False
    ) -> None:
        """Emit a call of the outward pass at X and V of the stage, which stores Ẋ.

        of_next : whether to begin at the charts to which a step leads.
        """
        whole, behind = tree.index(int(is_whole)), tree[at.AHEAD] if of_next else tree.index(0)
        self._run("place", tree, self._place, ahead, whole, behind)

    def _place(self, tree: MemoryTree, ahead: Index, whole: Index, behind: Index) -> None:
        def one(node: MemoryNode) -> None:
            chart = tree.rows(node.entry(at.CHART) + behind)
            parts = (node.constants, chart, node.freedoms(at.X_ROW))
            v, into = node.freedoms(at.STAGE_ROW), node.slopes(at.X_SLOPES, ahead)
            above, here = node.above, node.motion

            def do(kind: Kind) -> None:
                into.put(0, *tree_nodes.place(kind, *parts, v, above, here))
                place = partial(tree_nodes.place_origin, kind, node.constants, v, above, here)
                if_not_zero(whole, place)

            node.each_kind(do)

        tree.for_nodes(one)

    def _act(self, element: MemoryElement, time: Any) -> None:
        """Add an element's wrench to the loads on its nodes, and its power to the sum."""
        node, other, sums = element.node, element.other, element.tree.section(at.SUMS_ROW)
        places = [each.part(at.LOADS_ROW, 6) for each in (node, other)]

        def do(kind: ElementKind) -> None:
            placed, frame, x, lever = element.placed(kind, time)
            wrench = kind.element.wrench(placed, x)
            if kind.element.does_work:
                sums.put(at.POWER, sums[at.POWER] + kind.element.power(placed, x, wrench))
            loads = loads_of(wrench, frame, lever)
            for place, more in zip(places, loads, strict=True):
                place.put(0, *add(place[0:6], more))

        element.each_kind(do)

    def move(self, body: LoopBody, state: State) -> State:
        """Make the stage the state."""
        tree = self._tree(body)
        total = tree.section(at.SUMS_ROW)
        if self.projects:
            total.put(at.SPEED, self._size(tree, tree[at.V_ROW], body.length))
        total.put(0, 0.0)

        def one(node: MemoryNode) -> None:
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

        def one(node: MemoryNode) -> None:
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

        def measure(tree: MemoryTree) -> None:
            sums = tree.section(at.SUMS_ROW)
            sums.put(0, 0.0, 0.0, 0.0)

            def one(node: MemoryNode) -> None:
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
            slopes = tree.slopes(name, weights)
            _store_sums(tree.section(into), slopes, tuple(weights.values()), count)
        self._run("squares", body, self._squares)
        return tree.section(at.SUMS_ROW)[0:4]

    def _squares(self, tree: MemoryTree) -> None:
        """Store the squares of the numbers in the rows of X and V of the stage."""
        sums = tree.section(at.SUMS_ROW)
        sums.put(0, 0.0, 0.0, 0.0, 0.0)

        def one(node: MemoryNode) -> None:
            def do(kind: Kind) -> None:
                pitch = kind.pitch(node.constants)
                x, v = (kind.lifted(node.freedoms(row), pitch) for row in (at.X_ROW, at.STAGE_ROW))
                _add_squares(sums, x[:3], x[3:], v[:3], v[3:])

            node.each_kind(do)

        tree.for_nodes(one)

    def _spare(self, tree: MemoryTree) -> Index:
        """Rows of all slopes of a step, behind which those of a state at rest are."""
        return tree[at.FREEDOMS] * slopes_of(self.plan)

    def _stay(self, tree: MemoryTree) -> None:
        """Make the state the stage."""
        x, v, stage = (tree.section(name) for name in (at.X_ROW, at.V_ROW, at.STAGE_ROW))

        def copy(i: Index) -> None:
            x.put(i, 0.0)
            stage.put(i, v[i])

        for_each(tree[at.FREEDOMS], copy)

    def turns_and_places(self, chart: Any) -> tuple[Vec, Vec]:
        return (), ()

    def angular_speeds_squared(self, body: LoopBody, state: State) -> list[Any]:
        return []


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
