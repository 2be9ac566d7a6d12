"""Measures of a tree in memory."""

from __future__ import annotations

from typing import Any

from lierb.kernels.mechanics import tree_nodes
from lierb.kernels.mechanics.tree_nodes import JointKind
from lierb.kernels.numbers.arithmetic import maximum, where
from lierb.kernels.numbers.zero import ZERO, is_zero
from lierb.kernels.systems import tree_places as at
from lierb.kernels.systems.measures import (
    JOINT_ERRORS,
    JOINT_KEPT,
    Observed,
    orthogonality_squared,
    retained,
)
from lierb.kernels.systems.plan import ConstraintKind, ElementKind
from lierb.kernels.systems.state import State
from lierb.kernels.systems.tree_loop_motion import LoopMotion
from lierb.kernels.systems.tree_loop_projection import LoopProjection
from lierb.kernels.systems.tree_memory import (
    LoopBody,
    MemoryConstraint,
    MemoryElement,
    MemoryNode,
    MemoryTree,
)
from lierb.kernels.tracing.arrays import Index
from lierb.kernels.tracing.memory import for_each


class LoopMeasures(LoopProjection):
    """Motion, energy, errors of the joints."""

    def dropped(self, body: LoopBody, state: State) -> Any:
        if not self.plan.constraint_kinds:
            return ZERO
        tree = self._tree(body)
        self._stay(tree)
        self._run("rank", body, self._rank, self._spare(tree))
        return tree.values.section(at.SUMS_ROW)[at.DEPENDENT]

    def _rank(self, tree: MemoryTree, ahead: Index) -> None:
        """Count the rows that depend on others."""
        self._call_place(tree, ahead, is_whole=True)
        self._gather(tree, acts=False)
        self._ask(tree, ZERO, lambda *_: 0.0)
        self._factor(tree)

    def measured(
        self, body: LoopBody, state: State, motion: LoopMotion, time: Any, first_energy: Any = ZERO
    ) -> Observed:
        """Return every measure; store the errors of the joints."""
        times = (time,) if self.plan.constraint_kinds else ()
        self._run("measure", body, self._measure, *times, *self._signal_numbers(body))
        sums = self._tree(body).section(at.SUMS_ROW)
        energy, orthogonality, *errors = sums[0 : at.POWER]
        names = (measure.name for measure in JOINT_ERRORS)
        values = dict(zip(names, errors, strict=True)) | {
            "energy": energy,
            "energy_drift": energy - first_energy - state.work,
            "work": state.work,
            "orthogonality_error": orthogonality,
        }
        return Observed(values)

    def _measure(self, tree: MemoryTree, *numbers: Any) -> None:
        time, *rest = numbers if self.plan.constraint_kinds else (ZERO, *numbers)
        signals = self._signals(tuple(rest))
        sums, gravity = tree.section(at.SUMS_ROW), tree.ground.constants[0:3]
        sums.put(0, *(0.0,) * at.SUMS)

        def add(squares: tuple[Any, ...]) -> None:
            for row, square in enumerate(squares, at.ERRORS):
                if not is_zero(square):
                    sums.put(row, maximum(sums[row], square))

        def one(node: MemoryNode) -> None:
            constants, here = node.constants, node.motion
            own = tree_nodes.energy(constants, node.details, here, gravity)
            off = orthogonality_squared(here[0:9])
            sums.put(at.ENERGY, sums[at.ENERGY] + own, maximum(sums[at.ORTHOGONALITY], off))
            errors = tree.of_link(at.ERRORS_ROW, node.entry(at.LINK), len(JOINT_ERRORS))

            def do(joint: JointKind) -> None:
                if joint.role == tree_nodes.MASSLESS:
                    return  # measured with the next node
                d, moving = node.on_joint(joint)
                pitch = joint.kind.pitch(constants)
                squares = tree_nodes.errors_squared(joint.rows, d, moving, pitch)
                errors.put(0, *squares)
                add(squares)

            node.each_joint(do)

        def constrained(constraint: MemoryConstraint) -> None:
            number = constraint.entry(at.ON_JOINT)

            def do(kind: ConstraintKind) -> None:
                connected = constraint.connected(kind, time)
                squares = connected.errors_squared
                if kind.element is None:
                    tree.of_link(at.ERRORS_ROW, number, len(JOINT_ERRORS)).put(0, *squares)
                add(squares)

            constraint.each_kind(do)

        def potential(element: MemoryElement) -> None:
            def do(kind: ElementKind) -> None:
                placed, _, x, _ = element.placed(kind, ZERO)  # no potential depends on time
                energy = kind.element.energy(placed, x._replace(signals=signals))
                if not is_zero(energy):
                    sums.put(at.ENERGY, sums[at.ENERGY] + energy)

            element.each_kind(do)

        tree.for_nodes(one)
        tree.for_constraints(constrained)
        tree.for_elements(potential)

    def keep_errors(self, body: LoopBody, alive: Any, now: Any) -> None:
        """Update JOINT_KEPT of every joint in memory by the errors that `measured` has stored.

        now : mask of the lanes to update.
        """
        tree = self._tree(body).values

        def one(link: Index) -> None:
            errors = tree.of_link(at.ERRORS_ROW, link, len(JOINT_ERRORS))
            kept = tree.of_link(at.KEPT_ROW, link, len(JOINT_KEPT))
            for row, (measure, how) in enumerate(JOINT_KEPT):
                square, old = errors[JOINT_ERRORS.index(measure)], kept[row]
                kept.put(row, where(now, retained(how, old, square, square, alive), old))

        for_each(tree[at.JOINTS], one)
