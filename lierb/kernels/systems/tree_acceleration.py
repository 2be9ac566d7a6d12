"""Accelerations and multipliers of a mechanism, rates of its state, and Baumgarte's terms."""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

from lierb.kernels.mechanics.added_inertia import Added, AddedInertia
from lierb.kernels.mechanics.constraints import residuals
from lierb.kernels.mechanics.rows import Row
from lierb.kernels.mechanics.saddle import is_other_rank, kinds_of
from lierb.kernels.mechanics.tree import GROUND, HERE, Ends, TreeConstants, TreeMotion, root_of
from lierb.kernels.mechanics.tree_dynamics import Bodies, Solved, bodies_of, solved
from lierb.kernels.mechanics.tree_rows import NodeRow, add_loads
from lierb.kernels.numbers.arithmetic import fma, sqrt, where
from lierb.kernels.numbers.vec import (
    ZERO3,
    ZERO6,
    Vec,
    add,
    axpy,
    cross,
    cross_add,
    mat_t_vec,
    mat_vec_add,
    neg,
    scale,
    sub,
)
from lierb.kernels.numbers.zero import ZERO
from lierb.kernels.systems.relatives import Relatives, constrained_part, length_of, size_of
from lierb.kernels.systems.state import Rates, State
from lierb.kernels.systems.tree_charts import Charts, TreeCharts
from lierb.kernels.systems.tree_inputs import sixes


class TreeAcceleration(NamedTuple):
    """Solution of the equations of motion.

    rates : V̇ of all nodes, concatenated, in their c-spaces.
    power : of forces and motors, W.   singular : 1 in a singular configuration.
    dropped : number of dependent rows.
    """

    rates: Vec
    power: Any
    singular: Any
    dropped: Any
    bodies: Bodies
    solved: Solved
    relatives: Relatives


class TreeAccelerations(TreeCharts):
    """Equations of motion of a mechanism."""

    @property
    def rows(self) -> tuple[tuple[int, Row], ...]:
        """Rows that have a multiplier, with the index of their connection."""
        return self.plan.rows_with_multipliers

    def relatives(self, body: TreeConstants, motion: TreeMotion) -> Relatives:
        """Relative motion of the plan's connections."""
        return Relatives(self.plan.connections, body.ends, motion)

    def relatives_at(
        self, body: TreeConstants, chart: Charts, velocity: Vec | None, time: Any
    ) -> Relatives:
        """Relative motion at a chart; see `motion_at`."""
        return self.relatives(body, self.motion_at(body, chart, velocity, time))

    def rates(self, body: TreeConstants, state: State, gravity: None, time: Any) -> Rates:
        chart, x, velocity, *_ = state
        steps = self.increments(x)
        poses = [step.pose(each) for step, each in zip(steps, chart, strict=True)]
        motion = TreeMotion(self.plan.tree, body, poses, sixes(velocity), time)
        solution = self.accelerate(body, motion)
        singular = solution.singular
        if self.rows:  # a mechanism of another rank is another mechanism
            singular = where(is_other_rank(solution.dropped, body.dropped), 1.0, singular)
        x_rates: list[Any] = []
        for step, v in zip(steps, sixes(velocity), strict=True):
            x_rates += step.rate(v)
        return Rates(tuple(x_rates), solution.rates, solution.power, singular)

    def accelerate(
        self, body: TreeConstants, motion: TreeMotion, forces: bool = True
    ) -> TreeAcceleration:
        """Solve the equations of motion.   forces : whether elements act."""
        plan = self.plan
        relatives = self.relatives(body, motion)
        loads, power = self.applied(body, relatives) if forces else ({}, ZERO)
        added = self._added(body, relatives) if forces else {}
        add_loads(loads, {i: each.load for i, each in added.items()})
        motion = motion.with_added({i: each.inertia for i, each in added.items()})
        wanted = [self._acceleration(number, row, relatives) for number, row in self.rows]
        fall = {
            i: ZERO3 + neg(body.nodes[i].gravity)
            for i, node in enumerate(plan.tree)
            if node.parent == GROUND
        }
        damped = [self._damped(i, motion) for i in range(len(plan.tree))]
        biases = [add(motion.bias(i), each) for i, each in enumerate(damped)]
        rows = self.equations(relatives, wanted)
        bodies = bodies_of(motion, rows)
        violation = partial(self.violation_of, motion)
        solution = solved(bodies, rows, loads, biases, fall, violation)
        for (number, r), multiplier in zip(self.rows, solution.multipliers, strict=True):
            rate = r.prescribed_rate(relatives[number].x, body.ends[number])
            power = fma(-multiplier, rate, power)
        for i, each in added.items():
            power = power + each.power(solution.response.moved[i], motion.twists[i])
        rates = self._state_rates(motion, solution, damped)
        return TreeAcceleration(
            rates, power, solution.singular, solution.dropped, bodies, solution, relatives
        )

    def violation_of(self, motion: TreeMotion) -> Any:
        """Residual δ of pose and velocity for `lierb.kernels.mechanics.saddle.multipliers_of`."""
        again = motion.again()  # values computed in a branch are not valid outside it
        relatives = self.relatives(motion.body, again)
        length, pose = length_of(motion.body), relatives.violation()
        rates: Any = ZERO
        for number, r in self.rows:
            rate = relatives.rate_error(number, r)
            part = rate if r.is_translational else length * rate
            rates = fma(part, part, rates)
        speed = size_of(length, tuple(x for relative in again.relative for x in relative))
        whole = fma(speed, speed, rates)
        return sqrt(pose + rates / where(whole > 0.0, whole, 1.0))

    def equations(self, relatives: Relatives, wanted: list[Any]) -> list[NodeRow]:
        """Equations of all rows in the nodes' accelerations, stiff for joints of the tree."""
        equations = []
        for (number, r), value in zip(self.rows, wanted, strict=True):
            each = relatives.equation(number, r, value)
            if number < self.plan.links:
                mass, inertia = relatives.motion.body.nodes[each.node].burden
                each = each._replace(stiffness=mass if r.is_translational else inertia)
            equations.append(each)
        return equations

    def applied(self, body: TreeConstants, relatives: Relatives) -> tuple[dict[int, Vec], Any]:
        """Wrenches of all elements on the nodes, and their power."""
        loads: dict[int, Vec] = {}
        power: Any = ZERO
        first = len(self.plan.joints)
        for number, (element, placed) in enumerate(
            zip(self.plan.elements, body.elements, strict=True), first
        ):
            if element.is_passive or element.rows or element.adds_inertia:
                continue
            x = relatives[number].x.motion._replace(signals=body.signals)
            wrench = element.wrench(placed, x)
            power = power + element.power(placed, x, wrench)
            acting = relatives.wrench(number, wrench[0] + wrench[1])
            add_loads(loads, acting.loads())
        return loads, power

    def _added(self, body: TreeConstants, relatives: Relatives) -> dict[int, Added]:
        """Inertia that elements add to nodes."""
        total: dict[int, Added] = {}
        motion, first = relatives.motion, len(self.plan.joints)
        for number, (element, placed) in enumerate(
            zip(self.plan.elements, body.elements, strict=True), first
        ):
            if not isinstance(element, AddedInertia):
                continue
            i = self.plan.connections[number].node
            x = relatives[number].x.motion._replace(signals=body.signals)
            added = element.added(placed, x)
            if not element.has_weight:  # gravity is an acceleration of the ground
                falling = body.nodes[root_of(self.plan.tree, i)].gravity
                weight = added.inertia.momentum(ZERO3 + mat_t_vec(motion.place(i)[0], falling))
                added = added._replace(load=sub(added.load, weight))
            total[i] = total[i].and_also(added) if i in total else added
        return total

    def _acceleration(self, number: int, row: Row, relatives: Relatives) -> Any:
        """Right-hand side of a row, with Baumgarte's terms."""
        kept, wanted = self.plan.stabilisation, relatives.bias(number, row)
        if kept.kind != "baumgarte":
            return wanted
        wanted = fma(-2.0 * kept.alpha, relatives.rate_error(number, row), wanted)
        return fma(-kept.beta * kept.beta, relatives.residual(number, row), wanted)

    def _damped(self, i: int, motion: TreeMotion) -> Vec:
        """Baumgarte's term in the acceleration of a node on its joint."""
        kept = self.plan.stabilisation
        if kept.kind != "baumgarte":
            return ZERO6
        off, moving = self.off_joint(i, motion), constrained_part(motion, i, motion.relative[i])
        return axpy(-2.0 * kept.alpha, moving, scale(-kept.beta * kept.beta, off))

    def off_joint(self, i: int, motion: TreeMotion) -> Vec:
        """Residuals of the rows on whose null space node i is solved, as a motion (6,)."""
        held, fixed, _ = kinds_of(self.plan.tree[i].rows)
        own = (*held.values(), *fixed.values())
        x = motion.kinematics(motion.joint_pose(i), ZERO6)
        values = dict(zip(own, residuals(own, x, Ends(HERE, HERE)), strict=True))
        turn = tuple(values[fixed[k]] if k in fixed else ZERO for k in range(3))
        d = tuple(x.d[j] if j in held else ZERO for j in range(3))
        return turn + mat_t_vec(x.q, d)

    def _state_rates(self, motion: TreeMotion, solution: Solved, damped: list[Vec]) -> Vec:
        """V̇_rel of reduced nodes; V̇ of other nodes, in their c-space."""
        rates: list[Any] = []
        for i, node in enumerate(self.plan.tree):
            if node.is_reduced:
                relative, rate = motion.relative[i], add(solution.response.rates[i], damped[i])
                rates += rate[:3] + cross_add(relative[3:], relative[:3], rate[3:])
                continue
            falling = motion.body.nodes[root_of(self.plan.tree, i)].gravity
            moved, q = solution.response.moved[i], motion.place(i)[0]
            twist, com = motion.twists[i], motion.body.nodes[i].com
            if node.cspace == "SE3":
                moving = cross_add(twist[3:], twist[:3], moved[3:])
                rates += moved[:3] + add(moving, mat_t_vec(q, falling))
                continue
            turning = moved[:3]
            swing = cross_add(twist[:3], cross(twist[:3], com), cross_add(turning, com, moved[3:]))
            rates += turning + mat_vec_add(q, swing, falling)
        return tuple(rates)
