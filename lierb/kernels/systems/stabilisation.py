"""Stabilise by projecting pose and velocity onto all rows after each step.

Baumgarte's terms are in the accelerations, `lierb.kernels.systems.tree_acceleration`.
"""

from __future__ import annotations

from functools import partial
from typing import Any

from lierb.kernels.mechanics.tree import TreeConstants
from lierb.kernels.mechanics.tree_dynamics import bodies_of, solved
from lierb.kernels.numbers.arithmetic import any_lanes, branch, fma, maximum, where
from lierb.kernels.numbers.vec import Vec, add, cross_add, mat_vec, neg, scale
from lierb.kernels.systems.relatives import Relatives, constrained_part, length_of, size_of
from lierb.kernels.systems.state import Stabilised, State
from lierb.kernels.systems.tree_acceleration import TreeAccelerations
from lierb.kernels.systems.tree_charts import Charts

CLOSED = 1e-14  # rad, or relative to the mechanism's length: residual at which Newton may end
OPEN = 1e-2  # same units: a larger residual that two Newton steps do not halve will not converge
# Same units: largest correction of a mechanism at rest, whose start may have a residual of 1e-9
# and whose rows may be near a singular pose.
UNMOVED = 1e-6


class Projection(TreeAccelerations):
    """Project poses and velocities onto all rows, with the least kinetic energy."""

    def stabilised(
        self, body: TreeConstants, before: State, state: State, time: Any, h: Any
    ) -> Stabilised:
        """Project pose and velocity onto all rows, with the least kinetic energy.

        before : the state at the start of the step, h seconds earlier.

        The step is marked as singular where Newton's method diverges, and where a correction is
        larger than the drift of the step can be. With s = h ‖V‖ and the mechanism's length ℓ, the
        step moves the pose by s and turns the rows by s/ℓ; the drift is a fraction of s in the pose
        and of ‖V‖ s/ℓ in V. A larger correction leads to another branch of the rows, across a jump
        in them, or along directions that are free in a singular pose. The bound on V applies only
        if no motor prescribes a rate, which may jump.
        """
        if self.plan.stabilisation.kind != "project":
            return Stabilised(state)
        length = length_of(body)
        nearer = self._newton_step(body, state.chart, time)
        first = self.moved(state.chart, scale(0.5, nearer))
        off, way = self._violation(body, first, time), size_of(length, nearer)

        def again() -> Any:
            further = self._newton_step(body, first, time)
            second = self.moved(first, scale(0.5, further)), add(nearer, further)
            is_open = off > CLOSED * CLOSED
            second, x = where(is_open, second, (first, nearer))
            left, opened = (self._violation(body, chart, time) for chart in (second, state.chart))
            mark = where((left > OPEN * OPEN) & (left >= 0.25 * opened), 1.0, 0.0)
            return second, x, where(is_open, way + size_of(length, further), way), mark

        chart, x, way, mark = branch(
            any_lanes(off > CLOSED * CLOSED), again, lambda: (first, nearer, way, 0.0), likely=False
        )
        speed = maximum(*(size_of(length, each.v_or_mu) for each in (before, state)))
        most = fma(h, speed, UNMOVED * length)
        mark = where(way > most, 1.0, mark)
        change = self._onto_rows(body, chart, state.v_or_mu, time)
        if not any(row.depends_on_time for _, row in self.rows):
            mark = where(h * length * size_of(length, change) > most * most, 1.0, mark)
        kept = state._replace(chart=chart, v_or_mu=add(state.v_or_mu, change))
        return Stabilised(kept, mark, x, change)

    def _violation(self, body: TreeConstants, chart: Charts, time: Any) -> Any:
        """Return the violation of the rows at a pose; see `Relatives.violation`."""
        return self.relatives_at(body, chart, None, time).violation()

    def _newton_step(self, body: TreeConstants, chart: Charts, time: Any) -> Vec:
        """Return the Newton step onto all rows, in the algebra."""
        relatives = self.relatives_at(body, chart, None, time)
        wanted = [-relatives.residual(number, row) for number, row in self.rows]
        count = len(self.plan.tree)
        biases = [neg(self.off_joint(i, relatives.motion)) for i in range(count)]
        return self._displaced(relatives, wanted, biases)

    def _onto_rows(self, body: TreeConstants, chart: Charts, velocity: Vec, time: Any) -> Vec:
        """Least change of the velocity such that it satisfies all rows."""
        relatives = self.relatives_at(body, chart, velocity, time)
        motion = relatives.motion
        wanted = [-relatives.rate_error(number, row) for number, row in self.rows]
        biases = [
            neg(constrained_part(motion, i, relative)) for i, relative in enumerate(motion.relative)
        ]
        return self._displaced(relatives, wanted, biases)

    def _displaced(self, relatives: Relatives, wanted: list[Any], biases: list[Vec]) -> Vec:
        """Return the smallest motion, in the kinetic metric, with row components `wanted`."""
        motion = relatives.motion
        rows = [each.on_still_ground() for each in self.equations(relatives, wanted)]
        violation = partial(self.violation_of, motion)
        solution = solved(bodies_of(motion, rows), rows, {}, biases, violation=violation)
        moved: list[Any] = []
        for i, node in enumerate(self.plan.tree):
            twist = solution.response.moved[i]
            if node.is_reduced:
                moved += add(solution.response.rates[i], biases[i])
            elif node.cspace == "SE3":
                moved += twist
            else:
                com = motion.body.nodes[i].com
                along = mat_vec(motion.place(i)[0], cross_add(twist[:3], com, twist[3:]))
                moved += twist[:3] + along
        return tuple(moved)
