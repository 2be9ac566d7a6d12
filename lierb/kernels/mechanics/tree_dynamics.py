"""Compute the accelerations of a tree of links under loads and further rows.

Every node has A = Ad(T⁻¹) A′ + b + S ν̇ (`lierb.kernels.mechanics.tree`). ν̇ is computed by
articulated bodies, at a cost proportional to the number of nodes (Featherstone, Rigid Body Dynamics
Algorithms, 2008, ch. 7), or by the mass matrix of all ν (Kane), which costs less for few nodes.

All other rows are solved by a Schur complement: those of loops, of joints whose motions are no
group, of motors, and of users' constraints. Gravity is an acceleration of the ground.

A row of a joint of the tree is made stiff at its node: s (B ν̇ − η)² / 2 is added to the function
that ν̇ minimises, with s of the size of the inertia of the node and its descendants. The term
vanishes if the row is satisfied. With it the entries of the complement are near 1/s for any masses;
without it, digits cancel down to the mass ratio of a light link and a heavy one on it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property, reduce
from itertools import product
from typing import Any, NamedTuple

from lierb.kernels.mechanics.saddle import LIGHTEST, less, multipliers_of
from lierb.kernels.mechanics.spatial import Articulated, twist_at, wrench_from
from lierb.kernels.mechanics.subgroup import inverse
from lierb.kernels.mechanics.tree import GROUND, MASSLESS, TreeMotion, combined, joint_space_pays
from lierb.kernels.mechanics.tree_rows import NodeRow, Response, add_loads, stiffness_of
from lierb.kernels.numbers.arithmetic import fma, maximum, sqrt
from lierb.kernels.numbers.number import Number
from lierb.kernels.numbers.vec import ZERO3, ZERO6, Vec, add, axpy, dot, neg, norm, sub
from lierb.kernels.numbers.zero import ZERO, is_zero


class ArticulatedBodies:
    """Solve for a tree by articulated inertias."""

    def __init__(self, motion: TreeMotion, rows: Sequence[NodeRow] = ()) -> None:
        self.motion = motion
        nodes, constants = motion.nodes, motion.body.nodes
        self.free = motion.directions
        own: list[Any] = [
            None if n.link == MASSLESS else c.rigid for n, c in zip(nodes, constants, strict=True)
        ]
        carried: list[Articulated | None] = [None] * len(nodes)
        self.inertias: list[list[Any]] = [[] for _ in nodes]
        self.columns: list[list[Vec]] = [[] for _ in nodes]  # U = I S
        self.gains: list[Vec] = [() for _ in nodes]  # (Sᵀ I S)⁻¹
        for i in reversed(range(len(nodes))):
            self.inertias[i] = [part for part in (own[i], carried[i]) if part is not None]
            self.columns[i] = [self.momentum(i, s) for s in self.free[i]]
            stiff = stiffness_of(rows, i, self.free[i])
            self.gains[i] = inverse(
                [
                    [dot(s, u) + k for u, k in zip(self.columns[i], ks, strict=True)]
                    for s, ks in zip(self.free[i], stiff, strict=True)
                ]
            )
            parent = nodes[i].parent
            if parent != GROUND:
                moved = self._passed_on(i)
                before = carried[parent]
                carried[parent] = moved if before is None else before.and_also(moved)

    def momentum(self, i: int, twist: Vec) -> Vec:
        """Return the momentum of the articulated body of a node."""
        return reduce(add, [part.momentum(twist) for part in self.inertias[i]])

    def _passed_on(self, i: int) -> Articulated:
        """Return I − U (SᵀIS)⁻¹ Uᵀ in the parent's frame."""
        step = self.motion.steps[i]
        parts = [part.from_frame(step) for part in self.inertias[i]]
        total = reduce(Articulated.and_also, parts)
        columns = [wrench_from(step, u) for u in self.columns[i]]
        count = len(columns)
        for k in range(count):
            gain = self.gains[i][count * k : count * k + count]
            total = total.less(columns[k], combined(gain, columns))
        return total

    def respond(
        self,
        loads: dict[int, Vec],
        biases: Sequence[Vec] | None = None,
        fall: dict[int, Vec] | None = None,
    ) -> Response:
        """Return the nodes' accelerations under loads, wrenches about their frames' origins.

        biases : b of each node.   fall : acceleration of the ground for each root, in its joint's
        axes. Without it, the nodes are at rest; with it, they have their velocities.
        """
        nodes, steps = self.motion.nodes, self.motion.steps
        totals = _net_loads(self.motion, loads, is_moving=fall is not None)
        forced: list[Vec] = [()] * len(nodes)
        for i in reversed(range(len(nodes))):
            bias = biases[i] if biases else ZERO6
            rest = totals[i] if not biases else sub(totals[i], self.momentum(i, bias))
            pushes = tuple(dot(s, rest) for s in self.free[i])
            forced[i] = _times(self.gains[i], pushes)
            if nodes[i].parent != GROUND:
                passed = sub(rest, combined(forced[i], self.columns[i]))
                totals[nodes[i].parent] = add(
                    totals[nodes[i].parent], wrench_from(steps[i], passed)
                )
        moved: list[Vec] = []
        rates: list[Vec] = []
        for i, node in enumerate(nodes):
            before = (fall or {}).get(i, ZERO6) if node.parent == GROUND else moved[node.parent]
            carried = twist_at(steps[i], before)
            held = tuple(dot(u, carried) for u in self.columns[i])
            rate = sub(forced[i], _times(self.gains[i], held))
            start = add(carried, biases[i]) if biases else carried
            relative = combined(rate, self.free[i])
            rates.append(relative)
            moved.append(add(start, relative))
        return Response(tuple(moved), tuple(rates), tuple(totals))

    def transmitted(self, i: int, response: Response) -> Vec:
        """Return the wrench by which a joint moves its node, about the node's frame."""
        return sub(self.momentum(i, response.moved[i]), response.totals[i])


class JointSpace:
    """Solve by the mass matrix of all free directions, cheaper if they are few.

    Kane's method on the columns of `TreeMotion.columns`.
    """

    def __init__(self, motion: TreeMotion, rows: Sequence[NodeRow] = ()) -> None:
        self.motion = motion
        nodes, constants = motion.nodes, motion.body.nodes
        entries: dict[tuple[int, int], Number] = {}
        for i, node in enumerate(nodes):
            if node.link == MASSLESS:
                continue
            columns = motion.columns(i)
            momenta = {j: constants[i].rigid.momentum(c) for j, c in columns.items()}
            for j, k in product(momenta, momenta):
                if k <= j:
                    entry = dot(columns[k], momenta[j])
                    entries[j, k] = entry + entries[j, k] if (j, k) in entries else entry
        for i, own in enumerate(motion.own):
            stiff = stiffness_of(rows, i, motion.directions[i])
            for (j, ks), (k, x) in product(zip(own, stiff, strict=True), enumerate(own)):
                if x <= j:
                    entries[j, x] = entries.get((j, x), ZERO) + ks[k]
        self.count = sum(len(motion.directions[i]) for i in range(len(nodes)))
        self.mass = Factored(
            [[entries.get((j, k), ZERO) for k in range(j + 1)] for j in range(self.count)]
        )

    def respond(
        self,
        loads: dict[int, Vec],
        biases: Sequence[Vec] | None = None,
        fall: dict[int, Vec] | None = None,
    ) -> Response:
        """Return the accelerations of the nodes under loads; see `ArticulatedBodies.respond`."""
        motion = self.motion
        start: list[Vec] = []  # A at ν̇ = 0
        forces: list[Number] = [ZERO] * self.count
        for i, node in enumerate(motion.nodes):
            before = (fall or {}).get(i, ZERO6) if node.parent == GROUND else start[node.parent]
            carried = motion.carry(i, before)
            start.append(add(carried, biases[i]) if biases else carried)
            rest = loads.get(i, ZERO6)
            rigid = motion.body.nodes[i].rigid
            if node.link != MASSLESS and fall is not None:
                rest = sub(rest, rigid.needed(start[i], motion.twists[i][:3]))
            elif node.link != MASSLESS and biases:
                rest = sub(rest, rigid.momentum(start[i]))
            if not is_zero(*rest):
                for j, column in motion.columns(i).items():
                    forces[j] = forces[j] + dot(column, rest)
        rates = self.mass.solve(forces)
        moved, relative = [], []
        for i, directions in enumerate(motion.directions):
            columns = motion.columns(i)
            moved.append(combined([rates[j] for j in columns], [*columns.values()], start[i]))
            relative.append(combined([rates[j] for j in motion.own[i]], directions))
        totals = _net_loads(motion, loads, is_moving=fall is not None)
        return Response(tuple(moved), tuple(relative), tuple(totals))

    def transmitted(self, i: int, response: Response) -> Vec:
        """Return the wrench by which a joint moves its node, about the node's frame."""
        motion = self.motion
        total = neg(response.totals[i])
        if motion.nodes[i].link != MASSLESS:
            total = add(motion.body.nodes[i].rigid.momentum(response.moved[i]), total)
        for child, node in enumerate(motion.nodes):
            if node.parent == i:
                passed = self.transmitted(child, response)
                total = add(total, wrench_from(motion.steps[child], passed))
        return total


class Factored:
    """Factor a symmetric positive definite matrix, given by its lower triangle, to Lᵀ D L.

    Elimination begins at the last row: the pivots of a chain's last links are constant, so that
    their inverses are computed once.
    """

    def __init__(self, lower: list[list[Number]]) -> None:
        count = len(lower)
        self.upper: list[list[Number]] = [[] for _ in range(count)]  # of row i, last row first
        self.inverses: list[Number] = [ZERO] * count
        scaled: list[list[Number]] = [[] for _ in range(count)]
        for i in reversed(range(count)):
            for j in reversed(range(i + 1, count)):
                rest = less(lower[j][i], self.upper[i], scaled[j])
                scaled[i].append(rest)
                self.upper[i].append(rest * self.inverses[j])
            self.inverses[i] = 1.0 / less(lower[i][i], self.upper[i], scaled[i])

    def solve(self, right: Sequence[Number]) -> list[Number]:
        count = len(right)
        y: list[Number] = []  # last row first
        for i in reversed(range(count)):
            y.append(less(right[i], self.upper[i], y))
        solution: list[Number] = []
        for i in range(count):
            x = y[count - 1 - i] * self.inverses[i]
            for j in range(i):
                x = fma(-self.upper[j][count - 1 - i], solution[j], x)
            solution.append(x)
        return solution


Bodies = ArticulatedBodies | JointSpace


def bodies_of(motion: TreeMotion, rows: Sequence[NodeRow] = ()) -> Bodies:
    """Return the cheaper solver.   rows : further rows; some make their nodes stiff."""
    return (JointSpace if joint_space_pays(motion.nodes) else ArticulatedBodies)(motion, rows)


def _net_loads(motion: TreeMotion, loads: dict[int, Vec], is_moving: bool) -> list[Vec]:
    """Return the loads on all nodes, less their bodies' bias wrenches if these move."""
    totals = [loads.get(i, ZERO6) for i in range(len(motion.nodes))]
    for i, node in enumerate(motion.nodes):
        if is_moving and node.link != MASSLESS:
            bias = motion.body.nodes[i].rigid.bias(motion.twists[i][:3])
            totals[i] = sub(totals[i], bias)
    return totals


def _times(matrix: Vec, x: Vec) -> Vec:
    n = len(x)
    return tuple(dot(matrix[n * i : n * i + n], x) for i in range(n))


# ---- further rows ------------------------------------------------------------------------------


class Solved(NamedTuple):
    """Hold the accelerations and multipliers of a tree with further rows.

    multipliers : λ of the rows, in order.   singular, dropped : as in `saddle.Solution`.
    bias : wrench s η of the stiff rows about each node; it is not a load.
    """

    response: Response
    multipliers: Vec
    singular: Number
    dropped: Number
    bias: dict[int, Vec]

    def transmitted(self, bodies: Bodies, i: int) -> Vec:
        """Return the wrench of a joint on its node, about the node's frame.

        The multipliers of the joint's rows are not included.
        """
        return add(bodies.transmitted(i, self.response), self.bias.get(i, ZERO6))


def solved(
    bodies: Bodies,
    rows: Sequence[NodeRow],
    loads: dict[int, Vec],
    biases: Sequence[Vec] | None = None,
    fall: dict[int, Vec] | None = None,
    violation: Callable[[], Any] | None = None,
) -> Solved:
    """Solve for accelerations under loads and rows; see `ArticulatedBodies.respond`.

    violation : see `saddle.multipliers_of`.
    """
    if not rows:
        return Solved(bodies.respond(loads, biases, fall), (), ZERO, ZERO, {})
    total = dict(loads)
    bias: dict[int, Vec] = {}
    for each in rows:
        if not is_zero(each.stiffness):
            assert biases is not None
            size = each.stiffness * (each.wanted - dot(each.push, biases[each.node]))
            bias[each.node] = axpy(size, each.push, bias.get(each.node, ZERO6))
            add_loads(total, each.loads(size))
    response = bodies.respond(total, biases, fall)
    responses = [bodies.respond(each.loads()) for each in rows]
    schur = [[rows[i].of(responses[j]) for j in range(i + 1)] for i in range(len(rows))]
    excess = [each.of(response) - each.wanted - each.of_ground() for each in rows]
    scales = _TreeScales(bodies.motion, loads, fall)
    sizes = [scales.of(each) for each in rows]
    alone = [size / fma(each.stiffness, size, 1.0) for size, each in zip(sizes, rows, strict=True)]
    multipliers, singular, dropped = multipliers_of(
        schur,
        excess,
        alone,
        lambda i: scales.acceleration(rows[i]),
        bodies.motion.body.dropped,
        violation,
    )
    for size, each in zip(multipliers, rows, strict=True):
        add_loads(total, each.loads(-size))
    response = bodies.respond(total, biases, fall)
    return Solved(response, multipliers, singular, dropped, bias)


class _TreeScales:
    """Measure rows and loads in the metric of each node's own inertia."""

    def __init__(
        self, motion: TreeMotion, loads: dict[int, Vec], fall: dict[int, Vec] | None
    ) -> None:
        self.motion, self.loads, self.fall = motion, loads, fall or {}

    def _square(self, i: int, wrench: Vec, part: float = 0.0) -> Number:
        """Return the square of the size of a wrench.   part : of its burden that a node has."""
        node = self.motion.body.nodes[i]
        mass, inertia = (part * x for x in node.burden)
        own = (*node.rigid.inertia[::4], *(node.rigid.mass,) * 3)
        total: Number = ZERO
        for x, y, least in zip(wrench, own, (*(inertia,) * 3, *(mass,) * 3), strict=True):
            total = fma(x * x, 1.0 / (maximum(y, least) if part else y), total)
        return total

    def of(self, row: NodeRow) -> Number:
        """Return the square of the size of a row."""
        total: Number = ZERO
        for each in row.parts:
            total = total + self._square(each.node, each.push, LIGHTEST)
            if each.other != GROUND:
                total = total + self._square(each.other, each.pull, LIGHTEST)
        return total

    def acceleration(self, row: NodeRow) -> Number:
        """Return the bound on the acceleration of a row by loads and motion."""
        return sqrt(self.of(row)) * self._forced

    @cached_property
    def _forced(self) -> Number:
        total: Number = ZERO
        for i, load in self.loads.items():
            total = total + sqrt(self._square(i, load))
        heavy = sum((sqrt(c.rigid.mass) for c in self.motion.body.nodes), start=ZERO)
        for fall in self.fall.values():
            total = total + norm(fall[3:]) * heavy
        for i, node in enumerate(self.motion.nodes):
            if node.link != MASSLESS:
                omega = self.motion.twists[i][:3]
                # The drift of a whole mechanism causes no acceleration.
                drifts = node.parent == GROUND and not node.rows
                twist = omega + (ZERO3 if drifts else self.motion.relative[i][3:])
                momentum = self.motion.body.nodes[i].rigid.momentum(twist)
                total = total + norm(omega) * sqrt(dot(momentum, twist))
        return total
