"""Gains of an objective by the numbers of a tree in memory, each beside its number.

Behind the tree's rows there is one for each input, of which only the gain is used.
"""

from __future__ import annotations

from typing import Any

from lierb.kernels.numbers.arithmetic import flatten, load, scatter, store
from lierb.kernels.numbers.zero import is_zero
from lierb.kernels.systems import tree_places as at
from lierb.kernels.systems.connection_table import placed_shape
from lierb.kernels.systems.plan import LoopPlan
from lierb.kernels.systems.tree_loop_forces import LoopForces
from lierb.kernels.systems.tree_memory import LoopBody, MemoryTree
from lierb.kernels.tracing.arrays import Index
from lierb.kernels.tracing.memory import Rows, for_each

LISTED_FRAMES = 24  # numbers of the two frames of a listed element at a joint


class InputsWithGains:
    """An array of inputs whose gains are in memory."""

    rank = 1

    def __init__(self, array: Any, gains: Rows) -> None:
        self.array, self.gains = array, gains

    def load(self, index: tuple[Any, int], lanes: int) -> Any:
        return self.gains.beside(index[0], self.array.load(index, lanes))


class LoopGains(LoopForces):
    """States of a tree, and gains by them and by the inputs."""

    def inputs_with_gains(self, inputs: Any, table: Any, memory: Any) -> InputsWithGains:
        """Return inputs to be recorded.   table, memory : arrays, as for `loaded`."""
        tree = MemoryTree(self.plan, table.address, memory.address)
        return InputsWithGains(inputs, tree.section(at.MEMORY))

    def clear_gains(self, body: LoopBody) -> None:
        tree = self._tree(body)
        gains = tree.gains(0)
        for_each(tree[at.MEMORY] + tree[at.SEEDS], lambda i: gains.put(i, 0.0))

    def put_gains(self, body: LoopBody, value: Any, into: Any, column: Any) -> None:
        """Store the gains by all inputs in an array, and behind them a value."""
        tree = self._tree(body)
        gains, lanes = tree.gains(tree[at.MEMORY]), self.plan.lanes
        for_each(tree[at.SEEDS], lambda c: scatter(into, 1, [(c, column)], [gains[c]], lanes))
        scatter(into, 1, [(tree[at.SEEDS], column)], [value], lanes)

    def gains_ahead(self, body: LoopBody) -> None:
        """Turn the gains by the state into those by the next state."""
        tree = self._tree(body)
        now, after = self._states(tree, tree.gains)

        def one(i: Index) -> None:
            after.put(i, now[i])
            now.put(i, 0.0)

        for_each(tree[at.STATE], one)

    def go_ahead(self, body: LoopBody) -> None:
        """Make the next state the state."""
        tree = self._tree(body)
        now, after = self._states(tree, tree.rows)
        for_each(tree[at.STATE], lambda i: now.put(i, after[i]))

    def keep(self, body: LoopBody, memory: Any, row: Any) -> None:
        """Keep the state in an array, in rows from `row` on."""
        tree = self._tree(body)
        now, lanes = tree.section(at.CHART_ROW), self.plan.lanes
        for_each(tree[at.STATE], lambda i: store(memory, (i + row, 0), now[i], lanes))

    def take_kept(self, body: LoopBody, memory: Any, row: Any) -> None:
        tree = self._tree(body)
        now, lanes = tree.section(at.CHART_ROW), self.plan.lanes
        for_each(tree[at.STATE], lambda i: now.put(i, load(memory, (i + row, 0), lanes)))


def numbers_of_listed(plan: LoopPlan) -> int:
    """Return the number of constants of listed elements, at most."""
    return sum(
        sum(not is_zero(x) for x in flatten(placed_shape(kind))) + LISTED_FRAMES * kind.on_joint
        for kind in plan.listed_kinds
    )
