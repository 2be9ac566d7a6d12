"""System of a tree of any size: loops over nodes whose numbers are in memory.

The code depends on the kinds of nodes, not on the tree (`lierb.kernels.systems.tree_table`), so
that it is compiled once for all trees. Charts and velocities of a state are in the memory of its
thread, one state at a time: `combine` stores X and V of a stage beside them, `move` makes the stage
the state. A `State` has the sum of all numbers of charts and velocities in place of V: it is finite
if they are.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from lierb.kernels.mechanics import tree_nodes
from lierb.kernels.mechanics.tree_nodes import Kind
from lierb.kernels.numbers.arithmetic import flatten, scatter, sqrt, store, where
from lierb.kernels.numbers.dual import values
from lierb.kernels.numbers.zero import is_zero
from lierb.kernels.systems import tree_places as at
from lierb.kernels.systems.combine import NAN
from lierb.kernels.systems.derivatives import completed, in_time, moved_in_body, parts_side_by_side
from lierb.kernels.systems.extra_states import with_states
from lierb.kernels.systems.layout import POSE_AND_TWIST
from lierb.kernels.systems.measures import JOINT_ERRORS, JOINT_KEPT
from lierb.kernels.systems.observables import observables_of
from lierb.kernels.systems.signals import events_of, signals_width
from lierb.kernels.systems.state import State
from lierb.kernels.systems.tree_loop_gains import LoopGains
from lierb.kernels.systems.tree_memory import LoopBody, MemoryNode, MemoryTree
from lierb.kernels.tracing.arrays import Index
from lierb.kernels.tracing.memory import for_each

PLACES = ("table", "memory")  # addresses of a `LoopBody`


class TreeLoop(LoopGains):
    """A `lierb.kernels.systems.system.System`: a mechanism whose nodes are in memory."""

    def store_errors(
        self, body: LoopBody, history: Any, first: int, row: Any, column: Any, alive: Any
    ) -> Index:
        """Store JOINT_ERRORS of every joint in a history, from column `first` on.

        Return the column behind them.
        """
        tree, count = self._tree(body).values, len(JOINT_ERRORS)

        def one(link: Index) -> None:
            squares = tree.of_link(at.ERRORS_ROW, link, count)[0:count]
            errors = [where(alive, sqrt(square), NAN) for square in squares]
            columns = [link * count + (first + c) for c in range(count)]
            places = [(c, row, column) for c in columns]
            scatter(history, 2, places, errors, self.plan.lanes)

        for_each(tree[at.JOINTS], one)
        return tree[at.JOINTS] * count + first

    def store_kept(self, body: LoopBody, summary: Any, first: int, column: Any) -> None:
        """Store JOINT_KEPT of every joint in a summary, from column `first` on."""
        tree, count = self._tree(body).values, len(JOINT_KEPT)

        def one(link: Index) -> None:
            kept = tree.of_link(at.KEPT_ROW, link, count)[0:count]
            places = [(link * count + (first + c), column) for c in range(count)]
            scatter(summary, 1, places, [sqrt(square) for square in kept], self.plan.lanes)

        for_each(tree[at.JOINTS], one)

    def store_links(
        self, body: LoopBody, states: tuple[Any, ...], row: Any, rows: Any, column: Any, alive: Any
    ) -> None:
        """Store R, r, ω and v of every link in the user's frames; NaN where not alive."""
        tree = self._tree(body).values
        self._see(tree, is_next=False)

        def link(node: MemoryNode) -> None:
            numbers = tree_nodes.in_user_frame(node.details, node.motion)
            shown = tuple(where(alive, x, NAN) for x in numbers)
            at_row = node.entry(at.LINK) * rows + row
            for array, part in zip(states, POSE_AND_TWIST.parts(shown).values(), strict=True):
                places = [(at_row, column, c) for c in range(len(part))]
                scatter(array, 1, places, part, self.plan.lanes)

        tree.for_links(link)

    def put_links(self, body: LoopBody, shown: Any, alive: Any) -> Index:
        """Store the numbers of `store_links` in the rows of a lane's workspace; return the row
        behind them.
        """
        tree, width = self._tree(body).values, POSE_AND_TWIST.count
        self._see(tree, is_next=False)

        def link(node: MemoryNode) -> None:
            numbers = tree_nodes.in_user_frame(node.details, node.motion)
            first = node.entry(at.LINK) * width
            for c, x in enumerate(numbers):
                store(shown, (first + c, 0), where(alive, x, NAN), self.plan.lanes)

        tree.for_links(link)
        return tree[at.LINKS] * width

    def store_derivatives(
        self,
        body: LoopBody,
        state: State,
        array: Any,
        placed: Callable[[Any], tuple[Any, ...]],
        time: Any,
        alive: Any,
        in_time: bool = False,
    ) -> None:
        """Store the derivatives of `lierb.kernels.systems.derivatives.derivative_columns`; NaN
        where not alive.

        placed : function that returns the place of a number, [column, direction], in the array, as
            in `lierb.kernels.loops.tables`; with `in_time`, those of the first direction are stored
            behind all others, [column].
        """
        tree, directions = self._tree(body), self.plan.directions
        stored, start = directions, tree.index(0)
        if in_time:
            stored, start = 1, self._columns(tree) * directions

        def put(column: Index, parts: Sequence[Any]) -> None:
            shown = [where(alive, x, NAN) for i, x in enumerate(parts) if i % directions < stored]
            places = [placed(start + column * stored + c) for c in range(len(shown))]
            if shown:
                scatter(array, 1, places, shown, self.plan.lanes)

        def put_at(column: Index, numbers: Any) -> None:
            put(column, parts_side_by_side(numbers, directions))

        seen = self.motion(body, state, time)

        def link(node: MemoryNode) -> None:
            numbers = tree_nodes.in_user_frame(node.details, node.motion)
            put(node.entry(at.LINK) * 12, moved_in_body(numbers, directions))

        tree.for_links(link)
        column = tree[at.LINKS] * 12
        energy = self.measured(body, state, seen, time).values["energy"]
        work = (state.work,) * self.plan.does_work
        observed = self.observed(body, seen, time)
        scalars = (*state.states, *body.signals.controls, energy, *work, *observed)
        put_at(column, scalars)
        column = column + len(scalars)
        rows = tree[at.ROWS] * int(self.plan.multipliers)
        put_at(column + rows + self._reactions(tree), self.events(body, seen, time))
        if self.plan.multipliers or self.plan.reaction:
            self.put_forces(
                body,
                time,
                lambda number, numbers: put_at(column + number, numbers),
                lambda joint, wrench: put_at(column + rows + joint * 6, wrench),
            )

    def _reactions(self, tree: MemoryTree) -> Index:
        """Return the number of columns of reactions."""
        return tree[at.JOINTS] * (6 * int(self.plan.reaction))

    def _columns(self, tree: MemoryTree) -> Index:
        """Return the number of differentiated quantities."""
        scalars = signals_width(self.plan) + 1 + self.plan.does_work
        scalars += len(observables_of(self.plan))
        numbers = tree[at.LINKS] * 12 + (scalars + len(events_of(self.plan)))
        return numbers + tree[at.ROWS] * int(self.plan.multipliers) + self._reactions(tree)

    def moved_in_time(self, body: LoopBody, state: State, time: Any) -> tuple[LoopBody, State]:
        """Return body and state with their derivatives in time as first direction.

        Their numbers are in the second half of the memory.
        """
        tree, body, state = self._tree(body).values, values(body), values(state)
        plan = self.plan
        memory = body.memory + tree[at.MEMORY] * (8 * plan.packs * plan.lanes)
        kept = {
            name: completed(plan, x) for name, x in body._asdict().items() if name not in PLACES
        }
        body = body._replace(memory=memory, **kept)
        rows, own = tree.rows(0), self._tree(body).rows(0)
        for_each(tree[at.MEMORY], lambda i: own.put(i, rows[i]))
        moved = in_time(self, body, completed(plan, state), time, plan.directions)
        self.take_next(body, 1.0 + 0.0 * values(body.mass))
        return with_states(body, moved), moved

    def store_end(self, body: LoopBody, state: State, put_at: Callable[..., None]) -> None:
        """Store the state for a run that continues: charts, V_rel, extra states.

        put_at : function of the first row of some numbers, and the numbers.
        """
        tree = self._tree(body)

        def put(first: Index, numbers: Any) -> None:
            put_at(first, [x for x in flatten(numbers) if not is_zero(x)])

        def one(node: MemoryNode) -> None:
            chart, v, constants = node.chart, node.freedoms(at.V_ROW), node.constants
            columns = node.entry(at.CHART_END), node.entry(at.V_END)

            def do(kind: Kind) -> None:
                put(columns[0], kind.load_chart(chart))
                put(columns[1], kind.lifted(v, kind.pitch(constants)))

            node.each_kind(do)

        tree.for_nodes(one)
        put(tree[at.END_COLUMNS] + -len(state.states), state.states)

    def end_columns(self, body: LoopBody) -> Index:
        """Number of a state's columns at the end of a run."""
        return self._tree(body)[at.END_COLUMNS]

    def store_state(self, body: LoopBody, carried: Any, first: int, column: Any) -> None:
        """Store charts, velocities and JOINT_KEPT between two calls, from row `first` on."""
        tree, lanes = self._tree(body), self.plan.lanes
        packs, count = tree.packs(tree[at.CHART_ROW]), self._carried(tree)
        for_each(count, lambda i: carried.store((i + first, column), packs[i], lanes))

    def load_state(self, body: LoopBody, carried: Any, first: int, column: Any) -> None:
        tree, lanes = self._tree(body), self.plan.lanes
        packs, count = tree.packs(tree[at.CHART_ROW]), self._carried(tree)
        for_each(count, lambda i: packs.put(i, carried.load((i + first, column), lanes)))

    def _carried(self, tree: MemoryTree) -> Index:
        """Return the number of packs of a state and of JOINT_KEPT."""
        return tree[at.STATE_ROWS] * self.plan.packs
