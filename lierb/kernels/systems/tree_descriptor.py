"""The descriptor form of a mechanism has the rows of all joints, loops and constraints.

M is block diagonal: every node is a body on SE(3), at its joint's point, or on SO(3)×R³. A row
couples two nodes.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from lierb.kernels.mechanics.constraints import smooth_residuals
from lierb.kernels.mechanics.elements import Applied
from lierb.kernels.mechanics.newton_euler import Kinematics
from lierb.kernels.mechanics.rows import HeldBody, Row
from lierb.kernels.mechanics.tree import GROUND, TreeConstants, TreeMotion, root_of
from lierb.kernels.mechanics.tree_rows import NodeRow
from lierb.kernels.numbers.dual import Dual, lifted, parts_of, value_of
from lierb.kernels.numbers.vec import (
    ZERO6,
    Vec,
    add,
    axpy,
    cross_add,
    dot,
    mat_t_vec,
    mat_vec,
    neg,
    scale,
)
from lierb.kernels.numbers.zero import ZERO
from lierb.kernels.systems.descriptor import (
    BodyDescriptor,
    Constraints,
    Descriptor,
    pulled_by,
    size_of,
    spun,
)
from lierb.kernels.systems.plan import MechanismPlan
from lierb.kernels.systems.relatives import Relatives
from lierb.kernels.systems.tree_charts import Charts
from lierb.kernels.systems.tree_inputs import charts_of, sixes
from lierb.kernels.systems.tree_system import TreeFormulation


def descriptor_of(system: Any, body: Any) -> Descriptor:
    """Return the descriptor form of one body or of a mechanism."""
    if isinstance(body, TreeConstants):
        return TreeDescriptor(system, body)
    return BodyDescriptor(system, body)


class TreeDescriptor(Descriptor):
    """The descriptor form of a mechanism whose nodes are all absolute."""

    plan: MechanismPlan

    def __init__(self, system: TreeFormulation, body: TreeConstants) -> None:
        self.system, self.body, self.plan = system, body, system.plan
        self.nodes = self.plan.tree
        self.width, self.rows = 6 * len(self.nodes), len(self.plan.rows)

    @property
    def may_depend(self) -> bool:
        return bool(self.plan.rows_with_multipliers)

    def momentum(self, velocity: Vec) -> Vec:
        return _joined(self._momentum(i, v) for i, v in enumerate(sixes(velocity)))

    def _momentum(self, i: int, velocity: Vec) -> Vec:
        constants = self.body.nodes[i]
        if self._is_mixed(i):
            turning = mat_vec(constants.inertia, velocity[:3])
            return turning + scale(constants.rigid.mass, velocity[3:])
        return constants.rigid.momentum(velocity)

    def applied(self, chart: Charts, velocity: Vec, time: Any) -> Applied:
        relatives = self.system.relatives_at(self.body, chart, velocity, time)
        motion = relatives.motion
        loads, power = self.system.applied(self.body, relatives)
        wrenches = []
        for i in range(len(self.nodes)):
            rigid = self.body.nodes[i].rigid
            falling = self.body.nodes[root_of(self.nodes, i)].gravity
            wrench = self._in_cspace(i, motion, loads.get(i, ZERO6))
            if self._is_mixed(i):
                wrench = wrench[:3] + axpy(rigid.mass, falling, wrench[3:])
            else:
                fall = mat_t_vec(motion.place(i)[0], falling)
                torque = cross_add(rigid.moment, fall, wrench[:3])
                wrench = torque + axpy(rigid.mass, fall, wrench[3:])
            wrenches.append(wrench)
        return Applied(_joined(wrenches), power)

    def gyroscopic(self, velocity: Vec) -> Vec:
        return _joined(
            spun(v, self._momentum(i, v), self._is_mixed(i)) for i, v in enumerate(sixes(velocity))
        )

    def constraints(self, chart: Charts, time: Any) -> Constraints:
        relatives = self.system.relatives_at(self.body, chart, None, time)
        values: list[Any] = []
        jacobian: list[Vec] = []
        for number, connection in enumerate(self.plan.connections):
            if not connection.rows:
                continue
            values += smooth_residuals(connection.rows, relatives[number].x, self.body.ends[number])
            equations = (relatives.equation(number, row, ZERO) for row in connection.rows)
            jacobian += (self._row(relatives.motion, equation) for equation in equations)
        rates = self._of_rows(relatives, lambda row, x, ends: row.prescribed_rate(x, ends))
        return Constraints(tuple(values), tuple(jacobian), rates, self.width)

    def _of_rows(
        self, relatives: Relatives, number_of: Callable[[Row, Kinematics, HeldBody], Any]
    ) -> Vec:
        """Return a number of each row, of its motion and its frames."""
        return tuple(
            number_of(row, relatives[number].x, self.body.ends[number])
            for number, connection in enumerate(self.plan.connections)
            for row in connection.rows
        )

    def _row(self, motion: TreeMotion, equation: NodeRow) -> Vec:
        """Return a row of J."""
        parts = [ZERO6] * len(self.nodes)
        for i, wrench in ((equation.node, equation.push), (equation.other, neg(equation.pull))):
            if i != GROUND:
                parts[i] = add(parts[i], self._in_cspace(i, motion, wrench))
        return _joined(parts)

    def accelerations(self, chart: Charts, velocity: Vec, time: Any) -> tuple[Vec, Vec]:
        constraints = self.constraints(chart, time)
        along = (value_of(v) for v in velocity)  # without parts if it is `lifted`
        turning = self.moved(chart, tuple(Dual(0.0 * v, (v,)) for v in along))
        relatives = self.system.relatives_at(self.body, chart, None, time)
        slopes = self._of_rows(relatives, lambda row, x, ends: row.prescribed_slope(x, ends))
        bends = tuple(
            slope - sum(lifted(parts_of(dot(row, velocity))), start=ZERO)
            for row, slope in zip(self.constraints(turning, time).jacobian, slopes, strict=True)
        )
        wrench = add(self.gyroscopic(velocity), self.applied(chart, velocity, time).wrench)
        consistent = self.consistent(constraints, self.dependent(constraints))
        solution = consistent.solve((*wrench, *bends))
        return solution[: self.width], solution[self.width :]

    def pulled(self, x: Vec, momentum: Vec) -> Vec:
        triples = zip(self.nodes, sixes(x), sixes(momentum), strict=True)
        return _joined(pulled_by(charts_of(node), *pair) for node, *pair in triples)

    def size(self, chart: Charts, x: Vec) -> Any:
        pairs = zip(chart, sixes(x), strict=True)
        return sum((size_of(self.body.girth, *pair) for pair in pairs), start=ZERO)

    def _is_mixed(self, i: int) -> bool:
        return self.nodes[i].cspace == "SO3xR3"

    def _in_cspace(self, i: int, motion: TreeMotion, wrench: Vec) -> Vec:
        """Return a wrench in a node's frame in the node's c-space."""
        if not self._is_mixed(i):
            return wrench
        com, force = self.body.nodes[i].com, wrench[3:]
        return cross_add(force, com, wrench[:3]) + mat_vec(motion.place(i)[0], force)


def _joined(parts: Any) -> Vec:
    return tuple(x for part in parts for x in part)
