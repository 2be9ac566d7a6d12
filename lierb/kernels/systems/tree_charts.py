"""Compute with the poses and velocities of a mechanism's nodes.

The state has a chart, X and a velocity for every node (`lierb.kernels.mechanics.tree`). On reduced
coordinates they have the structural zeros of the joint's subgroup.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate, pairwise
from typing import Any

from lierb.kernels.functions.function import size_of
from lierb.kernels.groups.ambient import WIDTH
from lierb.kernels.groups.increments import Ambient, Exponential, Increment
from lierb.kernels.groups.quaternion import Chart
from lierb.kernels.mechanics import subgroup
from lierb.kernels.mechanics.tree import FREE, Node, TreeConstants, TreeMotion
from lierb.kernels.mechanics.tree_nodes import tidied
from lierb.kernels.numbers.vec import ZERO6, Vec, dot
from lierb.kernels.numbers.zero import ZERO
from lierb.kernels.systems.combine import StateArithmetic
from lierb.kernels.systems.layout import Columns
from lierb.kernels.systems.one_body import recharted
from lierb.kernels.systems.plan import MechanismPlan
from lierb.kernels.systems.signals import states_of
from lierb.kernels.systems.state import State
from lierb.kernels.systems.tree_inputs import (
    ambient_charts_of,
    charts_of,
    charts_side_by_side,
    sixes,
    state_columns,
    takes_ambient,
)

Charts = tuple[Chart, ...]  # one for each node


@dataclass(frozen=True)
class TreeCharts(StateArithmetic):
    """The state of a mechanism has a chart for each node."""

    plan: MechanismPlan

    @cached_property
    def state(self) -> Columns:
        count = size_of(states_of(self.plan))
        return state_columns(len(self.plan.tree), count, self.plan.carried)

    def state_of(self, numbers: Sequence[Any], body: TreeConstants | None = None) -> State:
        parts = self.state.parts(numbers)
        charts = charts_side_by_side(parts["charts"])
        (work,) = parts["work"]
        own = parts["states"], parts["carried"]
        state = State(charts, parts["x"], parts["v"], work, *own)
        return self.structured(state, body)

    def structured(self, state: State, body: TreeConstants | None = None) -> State:
        """Return the state with the structural zeros of each node's subgroup."""
        plan = self.plan
        charts: list[Chart] = []
        xs: list[Any] = []
        velocities: list[Any] = []
        for i, (node, chart, x, v) in enumerate(
            zip(plan.tree, state.chart, sixes(state.x), sixes(state.v_or_mu), strict=True)
        ):
            if node.is_reduced:
                pitch = 1.0 if body is None else body.nodes[i].pitch
                chart = subgroup.on_subgroup(node.slots, chart)
                x = subgroup.in_subalgebra(node.slots, x, pitch)
                v = subgroup.in_subalgebra(node.slots, v, pitch)
            charts.append(chart)
            xs += ZERO6 if plan.is_local else x
            velocities += v
        work = state.work if plan.does_work else ZERO
        moving = tuple(charts), tuple(xs), tuple(velocities)
        return State(*moving, work, state.states, state.carried)

    def chart_gravity(self, body: TreeConstants, chart: Charts) -> None:
        """Return None: gravity enters at the nodes on the ground."""

    def angular_speeds_squared(self, body: TreeConstants, state: State) -> list[Any]:
        """Return ‖ω‖² of each node, on its joint if reduced, rad²/s²."""
        return [dot(v[:3], v[:3]) for v in sixes(state.v_or_mu)]

    def places(self, chart: Charts) -> Vec:
        return self.turns_and_places(chart)[1]

    def turns_and_places(self, chart: Charts) -> tuple[Vec, Vec]:
        return tuple(p[0] for p, _ in chart), tuple(x for _, d in chart for x in d)

    def moved(self, chart: Charts, x: Vec) -> Charts:
        """Return C₀ exp X, node by node."""
        return tuple(
            charts_of(node).compose_exp(each, part)
            for node, each, part in zip(self.plan.tree, chart, sixes(x), strict=True)
        )

    @cached_property
    def widths(self) -> tuple[int, ...]:
        """Return the number of components of X, or of Y within a step, of each node."""
        return tuple(WIDTH if self._takes_ambient(node) else 6 for node in self.plan.tree)

    @cached_property
    def width(self) -> int:  # type: ignore[override]
        return sum(self.widths)

    def _takes_ambient(self, node: Node) -> bool:
        return self.plan.is_ambient and takes_ambient(node)

    def increments(self, x: Vec) -> list[Increment]:
        """Return the motion of each node since its chart.   x : X/2 or Y, of all nodes."""
        found: list[Increment] = []
        for node, part in zip(self.plan.tree, self._by_node(x), strict=True):
            if self._takes_ambient(node):
                found.append(Ambient.of(ambient_charts_of(node), part))
            else:
                found.append(Exponential.of(charts_of(node), part))
        return found

    def _by_node(self, x: Vec) -> list[Vec]:
        ends = (0, *accumulate(self.widths))
        return [x[i:j] for i, j in pairwise(ends)]

    def ended(self, chart: Charts, x: Vec) -> Charts:
        """Return the charts moved by a step.   x : X/2 or Y, of all nodes."""
        pairs = zip(self.increments(x), chart, strict=True)
        return tuple(step.moved(each) for step, each in pairs)

    def turning_and_moving(self, x: Vec) -> tuple[Vec, Vec]:
        halves = [(part[: len(part) // 2], part[len(part) // 2 :]) for part in self._by_node(x)]
        turning, moving = (tuple(y for half in side for y in half) for side in zip(*halves))
        return turning, moving

    def recharted(self, chart: Charts, x: Vec) -> tuple[Charts, Vec]:
        pairs = [
            recharted(charts_of(node), each, part)
            for node, each, part in zip(self.plan.tree, chart, sixes(x), strict=True)
        ]
        return tuple(pair[0] for pair in pairs), tuple(y for pair in pairs for y in pair[1])

    def in_algebra(self, body: TreeConstants, x: Vec) -> Vec:
        inside: list[Any] = []
        for node, constants, part in zip(self.plan.tree, body.nodes, self._by_node(x), strict=True):
            if node.is_reduced and not self._takes_ambient(node):
                part = subgroup.in_subalgebra(node.slots, part, constants.pitch)
            inside += part
        return tuple(inside)

    @property
    def free(self) -> tuple[int, ...]:
        slots = [slot for node in self.plan.tree for slot in self._slots(node)]
        return tuple(i for i, slot in enumerate(slots) if slot >= 0)

    @staticmethod
    def _slots(node: Node) -> tuple[int, ...]:
        return node.slots if node.is_reduced else FREE

    def completed(self, body: TreeConstants, v_or_mu: Vec) -> Vec:
        return self.in_algebra(body, v_or_mu)

    def tidied(self, body: TreeConstants, chart: Charts) -> Charts:
        """Renormalise the quaternions; project poses of screw joints onto their subgroups."""
        return tuple(
            tidied(self._slots(node), each, constants.pitch)
            for node, constants, each in zip(self.plan.tree, body.nodes, chart, strict=True)
        )

    def motion(
        self, body: TreeConstants, state: State, time: Any, is_next: bool = False
    ) -> TreeMotion:
        chart = state.chart if self.plan.is_local else self.moved(state.chart, state.x)
        return self.motion_at(body, chart, state.v_or_mu, time)

    def motion_at(
        self, body: TreeConstants, chart: Charts, velocity: Vec | None, time: Any
    ) -> TreeMotion:
        """Return the motion of the tree at a chart; at rest if velocity is None."""
        pairs = zip(self.plan.tree, chart, strict=True)
        poses = [charts_of(node).pose(each) for node, each in pairs]
        velocity = velocity or (ZERO,) * (6 * len(chart))
        return TreeMotion(self.plan.tree, body, poses, sixes(velocity), time)
