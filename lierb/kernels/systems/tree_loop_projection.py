"""Projection of a tree in memory onto its constraints after each step.

It is that of `lierb.kernels.systems.stabilisation.Projection`.
"""

from __future__ import annotations

from functools import partial
from typing import Any

from lierb.kernels.mechanics.rows import Row
from lierb.kernels.mechanics.tree_connections import Connected
from lierb.kernels.mechanics.tree_nodes import PULLS, Kind, moved
from lierb.kernels.numbers.arithmetic import any_lanes, branch, fma, maximum, sqrt, where
from lierb.kernels.numbers.vec import Vec
from lierb.kernels.numbers.zero import ZERO
from lierb.kernels.systems import tree_places as at
from lierb.kernels.systems.stabilisation import CLOSED, OPEN, UNMOVED
from lierb.kernels.systems.state import Stabilised, State
from lierb.kernels.systems.tree_elimination import settle
from lierb.kernels.systems.tree_loop_steps import LoopSteps
from lierb.kernels.systems.tree_memory import LoopBody, MemoryNode, MemoryTree
from lierb.kernels.tracing.arrays import Index
from lierb.kernels.tracing.lanes import Lane
from lierb.kernels.tracing.memory import accumulated, for_each


class LoopProjection(LoopSteps):
    """Projection of the state to which a step leads."""

    def stabilised(
        self, body: LoopBody, before: State, state: State, time: Any, h: Any
    ) -> Stabilised:
        """Project the next state; x and v_or_mu are squares of the corrections.

        They are those of rotation and position, and of ω and v. See `Projection.stabilised`.
        """
        if not self.projects:
            return Stabilised(state)
        tree = self._tree(body)
        self._run("project", body, self._project, time, h, *self._scales(body)[:2])
        sums = tree.values.section(at.SUMS_ROW)
        kept, mark = state._replace(v_or_mu=(sums[at.TOTAL],)), sums[at.SINGULAR]
        if not self.plan.has_lane_clocks:
            return Stabilised(kept, mark)
        return Stabilised(kept, mark, sums[0:2], sums[2:4])

    def _project(self, tree: MemoryTree, time: Any, h: Lane, dropped: Lane, length: Lane) -> None:
        """Move pose and velocity of the next state; store the total, the mark and the squares."""
        seen, correction = tree.values, tree.rows(self._correction(tree))
        sums = seen.section(at.SUMS_ROW)
        way, mark = self._project_pose(tree, time, dropped, length)
        now = self._size(tree, tree[at.V_ROW] + tree[at.AHEAD], length)
        speed = sqrt(maximum(now, sums[at.SPEED]))
        most = fma(h, speed, UNMOVED * length)
        mark = where(way > most, 1.0, mark)

        self._put_next(tree, is_moving=True)
        self._displace(tree, time, dropped, length, 1)
        change = sqrt(self._size(tree, self._correction(tree), length))
        if not any(r.depends_on_time for kind in self.plan.constraint_kinds for r in kind.rows):
            mark = where(h * length * change > most * most, 1.0, mark)
        velocity = tree.rows(tree[at.V_ROW] + tree[at.AHEAD])
        count = tree[at.FREEDOMS]
        for_each(count, lambda i: velocity.put(i, velocity[i] + correction[i]))
        numbers = seen.rows(tree[at.CHART_ROW] + tree[at.AHEAD])
        (total,) = accumulated(tree[at.STATE], (sums.zero,), lambda i, x: (x[0] + numbers[i],))
        sums.put(at.SINGULAR, mark)
        sums.put(at.TOTAL, total)
        if self.plan.has_lane_clocks:
            x, v, off = (seen.section(name) for name in (at.X_ROW, at.STAGE_ROW, at.OFF_ROW))
            moved = seen.rows(self._correction(tree))
            for_each(count, lambda i: x.put(i, off[i]))
            for_each(count, lambda i: v.put(i, moved[i]))
            self._run("squares", seen, self._squares)

    def _project_pose(
        self, tree: MemoryTree, time: Any, dropped: Lane, length: Lane
    ) -> tuple[Lane, Lane]:
        """Move the next charts onto the rows; return the length of the way, and a mark."""
        first, off = self._correction(tree), tree.section(at.OFF_ROW)
        correction, count = tree.rows(first), tree[at.FREEDOMS]
        self._put_next(tree, is_moving=False)
        opened = self._open(tree, time, length)
        self._displace(tree, time, dropped, length, 0)
        way = sqrt(self._size(tree, first, length))
        for_each(count, lambda i: off.put(i, correction[i]))
        self._move_next(tree, way >= 0.0)
        self._put_next(tree, is_moving=False)
        now = self._open(tree, time, length)
        is_open = now > CLOSED * CLOSED

        def again() -> tuple[Lane, Lane]:
            self._displace(tree, time, dropped, length, 0)
            further = sqrt(self._size(tree, first, length))
            self._move_next(tree, is_open)
            for_each(count, lambda i: off.put(i, where(is_open, off[i] + correction[i], off[i])))
            self._put_next(tree, is_moving=False)
            left = self._open(tree, time, length)
            mark = where((left > OPEN * OPEN) & (left >= 0.25 * opened), 1.0, 0.0)
            return where(is_open, way + further, way), mark

        return branch(any_lanes(is_open), again, lambda: (way, 0.0 * way), likely=False)

    def _correction(self, tree: MemoryTree) -> Index:
        """Row of the first number of a correction, one for each freedom."""
        return tree[at.V_SLOPES] + self._spare(tree)

    def _put_next(self, tree: MemoryTree, is_moving: bool) -> None:
        """Store the motion of the nodes at the next state, at rest or not."""
        x, stage = tree.section(at.X_ROW), tree.section(at.STAGE_ROW)
        velocity = tree.rows(tree[at.V_ROW] + tree[at.AHEAD])

        def one(i: Index) -> None:
            x.put(i, 0.0)
            stage.put(i, velocity[i] if is_moving else 0.0)

        for_each(tree[at.FREEDOMS], one)
        self._call_place(tree, self._spare(tree), is_whole=True, of_next=True)

    def _move_next(self, tree: MemoryTree, mask: Any) -> None:
        """Move the next charts by a correction where the mask is true."""
        x, correction = tree.section(at.X_ROW), tree.rows(self._correction(tree))
        for_each(tree[at.FREEDOMS], lambda i: x.put(i, 0.5 * correction[i]))

        def one(node: MemoryNode) -> None:
            chart, half = node.next_chart, node.freedoms(at.X_ROW)

            def do(kind: Kind) -> None:
                before = kind.load_chart(chart)
                after = moved(kind, node.constants, chart, half)
                kind.store_chart(chart, where(mask, after, before))

            node.each_kind(do)

        tree.for_nodes(one)

    def _displace(
        self, tree: MemoryTree, time: Any, dropped: Lane, length: Lane, rates: int
    ) -> None:
        """Store the smallest motion in the kinetic metric that closes all rows to first order.

        rates : 1 for a change of the velocities, 0 for one of the pose.
        """
        self._run(f"displace.{rates}", tree, partial(self._displaced, rates), time, dropped, length)

    def _displaced(
        self, rates: int, tree: MemoryTree, time: Any, dropped: Lane, length: Lane
    ) -> None:
        def value(connected: Connected, r: Row, loads: tuple[Vec, ...]) -> Any:
            return connected.rate_error(r) if rates else connected.residuals.get(r, ZERO)

        def rest(node: MemoryNode) -> None:
            node.each_kind(
                lambda kind: node.motion.put(PULLS + 6 * kind.freedoms, *(0.0,) * kind.freedoms)
            )

        self._gather(tree, acts=False)
        tree.for_nodes(rest)
        self._ask(tree, time, value)
        self._factor(tree)
        violation = partial(self._violation, tree, time, length)
        settle(tree, self._run, dropped, partial(self._forced, tree, None), violation)
        self._run("push", tree, self._push)
        self._accelerate(tree, self._spare(tree))
