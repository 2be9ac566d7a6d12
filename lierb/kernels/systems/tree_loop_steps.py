"""Steps of a tree in memory, and the sizes of their errors."""

from __future__ import annotations

from typing import Any

from lierb.kernels.functions.signals import Signals
from lierb.kernels.mechanics import tree_nodes
from lierb.kernels.mechanics.tree_connections import loads_of
from lierb.kernels.mechanics.tree_nodes import PASSED, Kind
from lierb.kernels.numbers.arithmetic import maximum, where
from lierb.kernels.numbers.dual import value_of, values
from lierb.kernels.numbers.vec import Vec, add, dot, scale, sub
from lierb.kernels.numbers.zero import ZERO, is_zero
from lierb.kernels.systems import tree_places as at
from lierb.kernels.systems.combine import NAN, summed, weighted
from lierb.kernels.systems.plan import ElementKind
from lierb.kernels.systems.state import Factors, Rates, Slopes, State, Units, Weights
from lierb.kernels.systems.tree_loop_motion import LoopMotion, LoopMotions
from lierb.kernels.systems.tree_memory import LoopBody, MemoryElement, MemoryNode, MemoryTree
from lierb.kernels.tracing.arrays import Index
from lierb.kernels.tracing.lanes import Lane
from lierb.kernels.tracing.memory import Rows, for_each, if_not_zero


class LoopSteps(LoopMotions):
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
        states = summed(state.states, units.other, weights, slopes.states, units)
        return state._replace(work=work, states=states)

    def stage_rates(
        self, body: LoopBody, state: State, gravity: None, time: Any, stage: int = 0
    ) -> Rates:
        """Store the slopes of a stage as those of number `stage`."""
        tree = self._tree(body)
        body = body._replace(signals=body.signals._replace(states=state.states))
        self._call_rates(body, tree[at.FREEDOMS] * stage, time)
        power = tree.section(at.SUMS_ROW)[at.POWER] if self.plan.does_work else ZERO
        is_constrained = bool(self.plan.constraint_kinds)
        singular = tree.values.section(at.SUMS_ROW)[at.SINGULAR] if is_constrained else ZERO
        of_states = self.state_rates(body, LoopMotion(self._of_listed(body)), time)
        return Rates((), (), power, singular, of_states)

    def _call_rates(self, body: LoopBody, ahead: Index, time: Any) -> None:
        """Emit a call that stores the rates of the stage.   ahead : rows of the slopes before."""
        more = *self._scales(body), *self._signal_numbers(body)
        self._run("rates", body, self._rates, ahead, time, *more)

    def _rates(self, tree: MemoryTree, ahead: Index, time: Any, *numbers: Lane) -> None:
        count = 3 if self.plan.constraint_kinds else 0  # of `_scales`
        scales, rest = numbers[:count], numbers[count:]
        self._load(tree, ahead, time, self._signals(rest))
        if scales:
            self._constrain(tree, time, *scales)
        self._accelerate(tree, ahead)

    def _load(self, tree: MemoryTree, ahead: Index, time: Any, signals: Signals) -> None:
        """Store motions, loads and articulated inertias."""
        plan, acts = self.plan, bool(self.plan.element_kinds)
        is_whole = acts or bool(plan.constraint_kinds or plan.listed_kinds)

        self._call_place(tree, ahead, is_whole)
        if plan.does_work:
            tree.section(at.SUMS_ROW).put(at.POWER, 0.0)
        if acts:
            loads = tree.section(at.LOADS_ROW)
            for_each(tree[at.NODES] * 6 + 6, lambda i: loads.put(i, 0.0))
            tree.for_elements(lambda element: self._act(element, time, signals))
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

    def _act(self, element: MemoryElement, time: Any, signals: Signals) -> None:
        """Add an element's wrench to the loads on its nodes, and its power to the sum."""
        node, other, sums = element.node, element.other, element.tree.section(at.SUMS_ROW)
        places = [each.part(at.LOADS_ROW, 6) for each in (node, other)]

        def do(kind: ElementKind) -> None:
            placed, frame, x, lever = element.placed(kind, time)
            x = x._replace(signals=signals)
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
        total = tree.values.section(at.SUMS_ROW)
        if self.projects:
            total.put(at.SPEED, self._size(tree, tree[at.V_ROW], value_of(body.length)))
        total.put(0, 0.0)

        def one(node: MemoryNode) -> None:
            constants, x = node.constants, node.freedoms(at.X_ROW)
            stage = node.freedoms(at.STAGE_ROW)

            def do(kind: Kind) -> None:
                speeds = stage[0 : kind.freedoms]
                node.next_v.put(0, *speeds)
                chart = tree_nodes.moved(kind, constants, node.chart, x)
                numbers = kind.store_chart(node.next_chart, chart)
                total.put(0, sum(values((*numbers, *speeds)), start=total[0]))

            node.each_kind(do)

        tree.for_nodes(one)
        return state._replace(v_or_mu=(total[0],))

    def silenced(self, body: LoopBody, v: Vec, alive: Any) -> Vec:
        """Store NaN in the velocities of the lanes that are not alive."""
        tree = self._tree(body).values
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

    def is_rough(self, body: LoopBody, stages: int, h: Any, rough: float, throw: float) -> Any:
        """Return whether a stage's rate, over the step, would change a velocity by far more than
        the step does.   rough, throw : `lierb.kernels.stepping.step_size.ROUGH` and THROW.
        """
        first, *rest = self._tree(body).slopes(at.V_SLOPES, range(stages))
        found = self._tree(body).section(at.SUMS_ROW)
        found.put(0, 0.0)

        def one(node: MemoryNode) -> None:
            freedom = node.entry(at.FREEDOM)
            rows = [slope.at(freedom) for slope in (first, *rest)]
            ends = node.freedoms(at.V_ROW), node.next_v

            def do(kind: Kind) -> None:
                pitch = kind.pitch(node.constants)
                start, *changes = (kind.lifted(row, pitch) for row in rows)
                before, after = (kind.lifted(row, pitch) for row in ends)
                for part, size in ((slice(3), 1.0), (slice(3, 6), body.girth)):
                    speed = maximum(*(dot(v[part], v[part]) for v in (before, after)))
                    for change in changes:
                        by = scale(h, sub(change[part], start[part]))
                        square = dot(by, by)
                        if not is_zero(square):
                            is_fast = square > rough * rough * speed
                            moves = h * h * square > throw * throw * size
                            found.put(0, where(is_fast & moves, 1.0, found[0]))

            node.each_kind(do)

        self._tree(body).for_nodes(one)
        return found[0] > 0.5

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
