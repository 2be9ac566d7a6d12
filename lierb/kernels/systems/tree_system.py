"""The system of a mechanism has inputs and start; base classes have states, rates, measures."""

from __future__ import annotations

from functools import cached_property
from typing import Any

from lierb.kernels.groups import se3
from lierb.kernels.groups.quaternion import Chart
from lierb.kernels.mechanics.newton_euler import girth_of
from lierb.kernels.mechanics.rows import AddedRow
from lierb.kernels.mechanics.spatial import twist_at
from lierb.kernels.mechanics.tree import GROUND, HERE, MASSLESS, NONE, Ends, TreeConstants, root_of
from lierb.kernels.numbers.vec import ZERO6, Vec, sub
from lierb.kernels.systems.combine import NAN
from lierb.kernels.systems.layout import Columns, with_end
from lierb.kernels.systems.signals import lane_end
from lierb.kernels.systems.stabilisation import Projection
from lierb.kernels.systems.state import State
from lierb.kernels.systems.tree_inputs import (
    CheckedStarts,
    apart,
    chart_of,
    factored,
    first_of_joint,
    given_start,
    inputs_of,
    joint_ends,
    node_constants,
    placed_element,
    with_burdens,
)
from lierb.kernels.systems.tree_measures import TreeMeasures

SMALL_ANGLE_STAGES = 8  # largest nodes × stages; with more, compilation takes long


class TreeFormulation(Projection, TreeMeasures, CheckedStarts):
    """This is the system of a mechanism; see `lierb.kernels.systems.system.System`."""

    invariant = ()
    is_homogeneous = False
    is_light = False  # registers never hold two packs of several bodies

    @property
    def takes_small_angle_steps(self) -> bool:
        """Return True for small mechanisms on absolute c-spaces.

        With two links on SE(3) such steps save a sixth of the time; on reduced coordinates they
        save nothing. The second step adds half to the compile time.
        """
        plan = self.plan
        is_small = len(plan.tree) * plan.method.length <= SMALL_ANGLE_STAGES
        is_plain = not self.rows and plan.stabilisation.kind == "none"
        return is_small and is_plain and not any(node.is_reduced for node in plan.tree)

    @cached_property
    def inputs(self) -> Columns:
        plan = self.plan
        fields = inputs_of(plan.links, plan.loops, plan.elements).fields
        lane = lane_end(plan).count
        return with_end(fields, self.state.count, lane, plan.moving, plan.directions)

    def body(self, numbers: list[Any]) -> TreeConstants:
        plan, read = self.plan, self.inputs.parts(numbers)
        nodes = tuple(node_constants(plan.tree, i, read) for i in range(len(plan.tree)))
        nodes = with_burdens(plan.tree, nodes)
        ends = [joint_ends(plan, nodes, number, read) for number in range(len(plan.joints))]
        acting = [*zip(plan.elements, plan.connections[len(ends) :], strict=True)]
        placed = tuple(
            placed_element(element, k, c, nodes, read) for k, (element, c) in enumerate(acting)
        )
        ends += [Ends(HERE, HERE) if c.joint < 0 else ends[c.joint] for _, c in acting]
        return TreeConstants(
            nodes,
            tuple(
                end._replace(elements=tuple(x if i in own else () for i, x in enumerate(placed)))
                if own
                else end
                for own, end in zip(self._read_by_rows, ends, strict=True)
            ),
            read["gravity"],
            placed,
            girth=girth_of(*((n.rigid.mass, n.inertia) for n in nodes)),
        )

    @cached_property
    def _read_by_rows(self) -> tuple[set[int], ...]:
        """Indices of the elements whose parameters the rows of each connection read."""
        read: tuple[set[int], ...] = tuple(set() for _ in self.plan.connections)
        for i, connection in enumerate(self.plan.connections):
            places = {row.place for row in connection.rows if isinstance(row, AddedRow)}
            for number in (i, connection.second):
                if number != NONE:
                    read[number].update(places)
        return read

    def start(self, body: TreeConstants, placed: tuple[()], numbers: list[Any]) -> State:
        """Return the state; components off a joint's subgroup are dropped."""
        plan, read = self.plan, self.inputs.parts(numbers)
        starts = {
            i: given_start(body.nodes[i].frame, read, node.link)
            for i, node in enumerate(plan.tree)
            if node.link != MASSLESS
        }
        starts[GROUND] = HERE, ZERO6
        charts: list[Chart] = []
        velocities: list[Vec] = []
        for i, (place, twist) in [*starts.items()][:-1]:
            first = first_of_joint(plan.tree, i)
            outside, moving = starts[plan.tree[first].parent]
            seat = se3.compose(se3.inverse(outside), place)
            relative = sub(twist, twist_at(seat, moving))
            d = se3.compose(se3.inverse(body.nodes[first].hang), seat)
            if not plan.tree[i].is_reduced:
                root = body.nodes[root_of(plan.tree, i)].hang
                chart, velocity = apart(plan.tree[i], body.nodes[i], root, place, twist)
                charts.append(chart)
                velocities.append(velocity)
                continue
            parts = [(d, relative)]
            if first != i:
                parts = factored(plan.tree[first].slots, plan.tree[i].slots, d, relative)
            for node, (part, velocity) in zip(plan.tree[first : i + 1], parts, strict=True):
                charts.append(chart_of(node, part))
                velocities.append(velocity)
        velocity = tuple(x for v in velocities for x in v)
        x = tuple(0.0 * v for v in velocity)
        nothing = 0.0 * body.mass
        carried = (nothing + NAN,) * plan.carried  # not yet known
        state = State(tuple(charts), x, velocity, nothing, carried=carried)
        tidied = self.tidied(body, self.structured(state, body).chart)
        return self.structured(state._replace(chart=tidied), body)
