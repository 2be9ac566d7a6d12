"""Multipliers and reactions of a tree in memory."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from lierb.kernels.mechanics import tree_nodes
from lierb.kernels.mechanics.tree import HERE, Ends
from lierb.kernels.mechanics.tree_connections import Connected
from lierb.kernels.mechanics.tree_nodes import JointKind
from lierb.kernels.numbers.arithmetic import scatter, where
from lierb.kernels.numbers.vec import Vec, add, axpy
from lierb.kernels.systems import tree_places as at
from lierb.kernels.systems.combine import NAN
from lierb.kernels.systems.plan import ConstraintKind
from lierb.kernels.systems.relatives import multipliers_of_wrench
from lierb.kernels.systems.tree_loop_measures import LoopMeasures
from lierb.kernels.systems.tree_memory import LoopBody, MemoryConstraint, MemoryNode, MemoryTree
from lierb.kernels.tracing.arrays import Index
from lierb.kernels.tracing.memory import for_each


class LoopForces(LoopMeasures):
    """Multipliers, and the wrench of every joint on its body."""

    def store_forces(
        self, body: LoopBody, multipliers: Any, reactions: Any, place: Any, time: Any, alive: Any
    ) -> None:
        """Store λ and the wrench of every joint on its body; NaN where not alive.

        multipliers, reactions : result arrays.   place : row, rows and column in them.
        """
        zero = self._tree(body).index(0)

        def put(array: Any, first: Any, column: Any, numbers: Vec) -> None:
            shown = [where(alive, x, NAN) for x in numbers]
            places = [(first, place.column, column + c) for c in range(len(shown))]
            scatter(array, 1, places, shown, self.plan.lanes)

        self.put_forces(
            body,
            time,
            lambda column, numbers: put(multipliers, place.row, column, numbers),
            lambda joint, wrench: put(reactions, joint * place.rows + place.row, zero, wrench),
        )

    def put_forces(
        self,
        body: LoopBody,
        time: Any,
        put_multipliers_at: Callable[[Index, Vec], None],
        put_reaction: Callable[[Index, Vec], None],
    ) -> None:
        """Call functions of a column and its λ, and of a joint and its wrench, if recorded."""
        tree = self._tree(body)
        self._stay(tree)
        self._call_rates(body, self._spare(tree), time)
        self._store_wrenches(tree, time)

        def put_multipliers(node: MemoryNode) -> None:
            wrench = node.part(at.WRENCH_ROW, 6)[0:6]

            def do(joint: JointKind) -> None:
                if joint.role == tree_nodes.MASSLESS or not joint.rows:
                    return
                x = tree_nodes.kinematics(*node.on_joint(joint))
                ends = Ends(HERE, HERE, joint.kind.pitch(node.constants))
                found = multipliers_of_wrench(joint.rows, x, ends, wrench)
                numbers = tuple(found[row] for row in joint.rows)
                put_multipliers_at(node.entry(at.MULTIPLIER), numbers)

            node.each_joint(do)

        def put_solution(constraint: MemoryConstraint) -> None:
            solution, first = constraint.vector(at.MULTIPLIERS), constraint.entry(at.LAMBDA)
            for_each(
                constraint.entry(at.HOLDS), lambda i: put_multipliers_at(first + i, (solution[i],))
            )

        if self.plan.multipliers:
            tree.for_nodes(put_multipliers)
            tree.for_constraints(put_solution)
        if self.plan.reaction:
            tree.for_constraints(lambda constraint: _add_reaction(constraint, time))

            def put_wrench(joint: Index, wrench: Index) -> None:
                put_reaction(joint, tree.rows(wrench)[0:6])

            wrenches, count = tree[at.WRENCH_ROW], tree[at.LINKS]
            tree.for_links(lambda n: put_wrench(n.entry(at.LINK), wrenches + n.i * 6))
            loops = wrenches + tree[at.NODES] * 6 + 6
            for_each(tree[at.JOINTS] - count, lambda i: put_wrench(count + i, loops + i * 6))

    def _store_wrenches(self, tree: MemoryTree, time: Any) -> None:
        """Store the wrench of every joint of the tree on its node, in the node's axes."""
        acts, is_loaded = self.plan.element_kinds, bool(self.plan.constraint_kinds)
        wrenches, loads = tree.section(at.WRENCH_ROW), tree.section(at.LOADS_ROW)
        loops = tree[at.JOINTS] - tree[at.LINKS]
        for_each((tree[at.NODES] + loops) * 6 + 6, lambda i: wrenches.put(i, 0.0))
        if is_loaded and not acts:
            for_each(tree[at.NODES] * 6 + 6, lambda i: loads.put(i, 0.0))

        def constrain(constraint: MemoryConstraint) -> None:
            solution = constraint.vector(at.MULTIPLIERS)

            def do(kind: ConstraintKind) -> None:
                connected, ends = constraint.connected(kind, time), constraint.ends(kind)
                for i, r in enumerate(kind.rows):
                    for node, load in zip(ends, connected.loads(r), strict=True):
                        total = node.part(at.LOADS_ROW, 6)
                        total.put(0, *axpy(-solution[i], load, total[0:6]))

            constraint.each_kind(do)

        def one(node: MemoryNode) -> None:
            load = node.part(at.LOADS_ROW, 6)[0:6] if acts or is_loaded else None
            own = node.part(at.WRENCH_ROW, 6)
            total = add(own[0:6], tree_nodes.transmitted(node.constants, node.motion, load))
            outer = node.parent.part(at.WRENCH_ROW, 6)
            outer.put(0, *add(outer[0:6], tree_nodes.passed_wrench(total, node.motion)))
            own.put(0, *tree_nodes.in_node_axes(total, node.motion))

        tree.for_constraints(constrain)
        tree.for_nodes(one, backward=True)


def _add_reaction(constraint: MemoryConstraint, time: Any) -> None:
    """Add −Jᵀλ of a loop's joint, or of a motor or gear in a joint, to the wrench of the joint."""
    solution = constraint.vector(at.MULTIPLIERS)

    def do(kind: ConstraintKind) -> None:
        if kind.element is not None and not kind.element.on_joint:
            return
        connected: Connected | None = constraint.connected(kind, time)
        for part in constraint.parts(kind):
            assert connected
            into = constraint.tree.rows(part.entry(at.WRENCH))
            total: Vec = into[0:6]
            for i, r in enumerate(connected.rows):
                total = axpy(-solution[i], r.jacobian(connected.x, connected.ends), total)
            into.put(0, *total)
            connected = connected.second

    constraint.each_kind(do)
