"""Equations with multipliers of a tree in memory: loops, motors, gears, users' constraints.

Each equation hands its wrenches inward on its path to the ground, and leaves u = Sᵀw and
(SᵀIS)⁻¹u at every node. These give J M⁻¹ Jᵀ, and what multipliers change of the nodes' ν̇: no pass
outward is needed before λ is known.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from lierb.kernels.mechanics.rows import Row
from lierb.kernels.mechanics.saddle import PIVOT_TOLERANCE
from lierb.kernels.mechanics.tree_connections import Connected, Path, square_of
from lierb.kernels.mechanics.tree_nodes import Kind, action_of, easy_of
from lierb.kernels.numbers.arithmetic import fma, minimum, sqrt, where
from lierb.kernels.numbers.dual import value_of
from lierb.kernels.numbers.vec import Vec, dot, norm, scale
from lierb.kernels.numbers.zero import ZERO, is_zero
from lierb.kernels.systems import tree_places as at
from lierb.kernels.systems.connection_table import EASY
from lierb.kernels.systems.plan import ConstraintKind
from lierb.kernels.systems.tree_elimination import MemoryEquation, eliminate, settle
from lierb.kernels.systems.tree_loop_start import LoopStart
from lierb.kernels.systems.tree_memory import LoopBody, MemoryConstraint, MemoryNode, MemoryTree
from lierb.kernels.tracing.arrays import Index
from lierb.kernels.tracing.lanes import Lane
from lierb.kernels.tracing.memory import accumulated, for_each, if_not_zero, integer_at


class LoopRows(LoopStart):
    """Multipliers of all equations."""

    def _scales(self, body: LoopBody) -> tuple[Lane, ...]:
        """Numbers of a trajectory for `_constrain`; none without constraints."""
        if not self.plan.constraint_kinds:
            return ()
        zero, length, heavy = map(value_of, (0.0 * body.mass, body.length, body.heavy))
        return zero + body.dropped, length, heavy

    def _constrain(
        self, tree: MemoryTree, time: Any, dropped: Lane, length: Lane, heavy: Lane
    ) -> None:
        """Solve for λ, and add its effect to the nodes' ν̇ by loads alone."""
        self._ask(tree, time, self._excess)
        self._factor(tree)
        forced = partial(self._forced, tree, heavy)
        violation = partial(self._violation, tree, time, length)
        settle(tree, self._run, dropped, forced, violation)
        self._run("push", tree, self._push)
        if self.plan.does_work:
            sums, count = tree.section(at.SUMS_ROW), tree[at.EQUATIONS]
            solution, rates = (tree.vector(x) for x in (at.MULTIPLIERS, at.RATE))
            (power,) = accumulated(
                count, (sums[at.POWER],), lambda i, x: (fma(-solution[i], rates[i], x[0]),)
            )
            sums.put(at.POWER, power)

    def _ask(self, tree: MemoryTree, time: Any, value: Callable[..., Any]) -> None:
        """Store right-hand side and mobility of each equation, and u at its nodes.

        value : (rows at their motion, row, its wrenches): its right-hand side without ν̇.
        """

        def one(constraint: MemoryConstraint) -> None:
            wrenches = tree.section(at.WALK_ROW)
            vectors = [constraint.vector(x) for x in (at.EXCESS, at.MOBILITY, at.RATE)]

            def do(kind: ConstraintKind) -> None:
                connected, count = constraint.connected(kind, time), len(kind.rows)
                starts = [(part, EASY + k) for part in constraint.parts(kind) for k in (0, 4)]
                easy = [part.rows[k : k + 4] for part, k in starts]
                for i, r in enumerate(kind.rows):
                    loads = connected.loads(r)
                    for end, load in enumerate(loads):
                        wrenches.put(6 * (end * count + i), *load)
                    numbers = (
                        value(connected, r, loads),
                        connected.mobility(loads, easy),
                        r.prescribed_rate(connected.x, connected.ends),
                    )
                    for vector, number in zip(vectors, numbers, strict=True):
                        vector.put(i, number)

            constraint.each_kind(do)
            self._hand_on(tree, constraint)

        tree.for_constraints(one)

    def _factor(self, tree: MemoryTree) -> None:
        """Store J M⁻¹ Jᵀ, its factors, and λ without the rows that depend on others."""
        self._run("assemble", tree, self._assemble)
        tolerance = tree.values.rows(0).zero + PIVOT_TOLERANCE
        eliminate(tree, self._run, tolerance, at.MULTIPLIERS)

    def _excess(self, connected: Connected, r: Row, loads: tuple[Vec, ...]) -> Any:
        """J V̇ − η, with Baumgarte's terms."""
        kept, excess = self.plan.stabilisation, connected.excess(r, loads)
        if kept.kind != "baumgarte":
            return excess
        excess = fma(2.0 * kept.alpha, connected.rate_error(r), excess)
        return fma(kept.beta * kept.beta, connected.residuals.get(r, ZERO), excess)

    def _hand_on(self, tree: MemoryTree, constraint: MemoryConstraint) -> None:
        """Hand the wrenches of a constraint's equations to the ground, leg by leg."""
        legs, first = constraint.entry(at.LEGS), tree[at.WALK_ROW]

        def leg(k: Index) -> None:
            entries = [integer_at(tree.table, legs + k * at.LEG + c) for c in range(at.LEG)]
            joining, wrenches = entries[at.JOINING], first + entries[at.HANDED]

            def join() -> None:
                into, more = tree.rows(wrenches), tree.rows(first + joining)
                numbers = constraint.entry(at.HOLDS) * 6
                for_each(numbers, lambda i: into.put(i, into[i] + more[i]))

            if_not_zero(joining, join)
            steps = entries[at.LEG_STEPS], entries[at.LEG_LENGTH]
            self._run("walk", tree, self._walk, constraint.first, *steps, wrenches)

        for_each(constraint.entry(at.LEG_COUNT), leg)

    def _walk(
        self, tree: MemoryTree, constraint: Index, place: Index, steps: Index, first: Index
    ) -> None:
        """Hand wrenches inward over some nodes.

        place : of the first step in the table.   first : row of the first wrench.
        """
        own = MemoryConstraint(tree, constraint)
        count, length = own.entry(at.HOLDS), own.entry(at.LENGTH)
        excess = own.vector(at.EXCESS)

        def step(k: Index) -> None:
            numbers = place + k * at.STEP
            node = tree.node(integer_at(tree.table, numbers + at.PATH_NODE))
            left = own.entry(at.LEFT) + integer_at(tree.table, numbers + at.ON_PATH)

            def do(kind: Kind) -> None:
                path = Path.of(kind, node.constants, node.motion)

                def equation(i: Index) -> None:
                    wrench = tree.rows(first + i * 6)
                    u, moved, asked, above = path.passed(wrench[0:6])
                    wrench.put(0, *above)
                    if u:
                        tree.rows(left + i * length).put(0, *u)
                        tree.rows(left + (count + i) * length).put(0, *moved)
                        excess.put(i, excess[i] + asked)

                for_each(count, equation)

            node.each_kind(do)

        for_each(steps, step)

    def _assemble(self, tree: MemoryTree) -> None:
        """Store J M⁻¹ Jᵀ: the sums of u·(SᵀIS)⁻¹u over the nodes that two equations share."""

        def pair(p: Index) -> None:
            place = tree[at.PAIR_TABLE] + p * at.PAIR
            entries = [integer_at(tree.table, place + k) for k in range(at.PAIR)]
            after, before = (tree.constraint(entries[k]) for k in (at.AFTER, at.BEFORE))
            first, start = after.entry(at.FIRST), before.entry(at.FIRST)
            lengths = [each.entry(at.LENGTH) for each in (after, before)]
            others = before.entry(at.HOLDS)

            def row(i: Index) -> None:
                schur = MemoryEquation(tree, first + i).row(at.SCHUR_ROW)
                u = tree.rows(after.entry(at.LEFT) + i * lengths[0])

                def column(j: Index) -> None:
                    moved = tree.rows(before.entry(at.LEFT) + (others + j) * lengths[1])
                    schur.put(start + j, _shared(tree, u, moved, entries))

                for_each(others.or_less(first + i + 1 - start), column)

            for_each(after.entry(at.HOLDS), row)

        for_each(tree[at.PAIRS], pair)

    def _push(self, tree: MemoryTree) -> None:
        """Subtract the effect of λ from the nodes' ν̇ by loads alone."""

        def one(constraint: MemoryConstraint) -> None:
            count, length = constraint.entry(at.HOLDS), constraint.entry(at.LENGTH)
            solution, place = constraint.vector(at.MULTIPLIERS), constraint.entry(at.PATH)
            moved = constraint.entry(at.LEFT) + count * length

            def step(k: Index) -> None:
                numbers = place + k * at.STEP
                forced = tree.rows(integer_at(tree.table, numbers + at.FORCED))
                first = moved + integer_at(tree.table, numbers + at.ON_PATH)

                def freedom(n: Index) -> None:
                    def equation(i: Index, x: Any) -> Any:
                        return (fma(-solution[i], tree.rows(first + i * length)[n], x[0]),)

                    forced.put(n, *accumulated(count, (forced[n],), equation))

                for_each(integer_at(tree.table, numbers + at.MOVES), freedom)

            for_each(constraint.entry(at.STEPS), step)

        tree.for_constraints(one)

    # ---- tests of dependent rows: see `lierb.kernels.mechanics.tree_dynamics` ----

    def _forced(self, tree: MemoryTree, heavy: Lane | None) -> Lane:
        """Bound on accelerations by loads and motion, relative to the size of a row.

        heavy : None for accelerations by the motion alone.
        """
        tree = tree.values
        sums, gravity = tree.section(at.SUMS_ROW), tree.ground.constants[0:3]
        sums.put(0, 0.0 if heavy is None else norm(gravity) * heavy * tree[at.ROOTS].real())

        def one(node: MemoryNode) -> None:
            constants, here = node.constants, node.motion
            if self.plan.element_kinds and heavy is not None:
                load = node.part(at.LOADS_ROW, 6)[0:6]
                size = sqrt(square_of(load, easy_of(constants), here))
                sums.put(0, sums[0] + size)
            # The drift of a whole mechanism causes no acceleration.
            hangs = minimum(node.entry(at.PARENT).real(), 1.0)

            def do(kind: Kind) -> None:
                slide = kind.lifted(node.freedoms(at.STAGE_ROW), kind.pitch(constants))[3:]
                sums.put(0, sums[0] + action_of(constants, here, scale(hangs, slide)))

            node.each_kind(do)

        tree.for_nodes(one)
        return sums[0]

    def _violation(self, tree: MemoryTree, time: Any, length: Lane) -> Any:
        """Residual δ of pose and velocity, relative to the mechanism's length and speed."""
        tree = tree.values
        sums = tree.section(at.SUMS_ROW)
        pose, speed = self._open(tree, time, length), self._size(tree, tree[at.STAGE_ROW], length)
        sums.put(0, 0.0)

        def rates(connected: Connected, r: Row) -> None:
            rate = connected.rate_error(r)
            rate = rate if r.is_translational else length * rate
            sums.put(0, fma(rate, rate, sums[0]))

        _for_equations(tree, time, rates)
        whole = speed + sums[0]
        return sqrt(pose + sums[0] / where(whole > 0.0, whole, 1.0))

    def _open(self, tree: MemoryTree, time: Any, length: Lane) -> Lane:
        """Sum of the squares of all residuals, with lengths relative to the mechanism's."""
        tree = tree.values
        sums, inverse = tree.section(at.SUMS_ROW), 1.0 / length
        sums.put(0, 0.0)

        def one(connected: Connected, r: Row) -> None:
            off = connected.residuals.get(r, ZERO)
            off = off * inverse if r.is_translational else off
            if not is_zero(off):
                sums.put(0, fma(off, off, sums[0]))

        _for_equations(tree, time, one)
        return sums[0]

    def _size(self, tree: MemoryTree, first: Index, length: Lane) -> Lane:
        """Square of the size of a motion of all nodes, m or m/s; turns are multiplied by `length`.

        first : row of the first of its numbers, one for each freedom.
        """
        tree = tree.values
        sums = tree.section(at.SUMS_ROW)
        sums.put(0, 0.0)

        def one(node: MemoryNode) -> None:
            rows = tree.rows(first + node.entry(at.FREEDOM))

            def do(kind: Kind) -> None:
                moving = kind.lifted(rows, kind.pitch(node.constants))
                turning = scale(length, moving[:3])
                total = dot(turning, turning) + dot(moving[3:], moving[3:])
                if not is_zero(total):
                    sums.put(0, sums[0] + total)

            node.each_kind(do)

        tree.for_nodes(one)
        return sums[0]


def _for_equations(tree: MemoryTree, time: Any, do: Callable[[Connected, Row], None]) -> None:
    def one(constraint: MemoryConstraint) -> None:
        def each(kind: ConstraintKind) -> None:
            connected = constraint.connected(kind, time)
            for r in kind.rows:
                do(connected, r)

        constraint.each_kind(each)

    tree.for_constraints(one)


def _shared(tree: MemoryTree, u: Any, moved: Any, pair: list[Index]) -> Lane:
    """Sum of u·moved over the freedoms that are on both paths of a pair."""

    def stretch(k: Index, total: Any) -> Any:
        place = pair[at.STRETCHES] + k * at.STRETCH
        first, second, count = (integer_at(tree.table, place + c) for c in range(at.STRETCH))
        return accumulated(count, total, lambda n, x: (fma(u[first + n], moved[second + n], x[0]),))

    return accumulated(pair[at.COUNT], (u.zero,), stretch)[0]
