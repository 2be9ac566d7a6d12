"""Table of a tree whose nodes are in memory: its nodes, and the places of their numbers.

A table is an array of int64: HEADER numbers, then TABLE numbers for each node, then elements and
constraints (`lierb.kernels.systems.tree_places` names them all). Node 0 is the ground; each node
comes after its parent.
"""

from __future__ import annotations

from functools import lru_cache
from itertools import accumulate

import numpy as np
from numpy.typing import NDArray

from lierb.kernels.functions.function import size_of
from lierb.kernels.mechanics import subgroup
from lierb.kernels.mechanics.tree import GROUND, MASSLESS
from lierb.kernels.mechanics.tree_nodes import CONSTANTS, DETAILS, MOTION, PASSED, JointKind, Kind
from lierb.kernels.numbers.arithmetic import flatten
from lierb.kernels.numbers.zero import is_zero
from lierb.kernels.systems import tree_places as at
from lierb.kernels.systems.connection_table import TRAVEL, constraints_of, elements_of, listed_of
from lierb.kernels.systems.measures import JOINT_ERRORS, JOINT_KEPT
from lierb.kernels.systems.plan import AnyPlan, MechanismPlan
from lierb.kernels.systems.scheme import StagedScheme
from lierb.kernels.systems.signals import lane_end, states_of
from lierb.kernels.systems.tree_inputs import first_of_joint, inputs_of, state_columns


@lru_cache(64)
def table_of(plan: MechanismPlan, apart: bool = False) -> tuple[NDArray[np.int64], int]:
    """Return a plan's table, and the number of rows of a thread's memory.

    apart : True if what each node passes on has rows of its own, and so has the next state.
    """
    count, joints = len(plan.tree), [joint_kind_of(plan, i) for i in range(len(plan.tree))]
    kinds = [joint.kind for joint in joints]
    freedoms, charts = (sum(x) for x in zip(*((k.freedoms, len(k.chart_rows)) for k in kinds)))
    inputs = inputs_of(plan.links, plan.loops, plan.elements)
    header = np.zeros(at.HEADER, np.int64)
    numbers = [count, freedoms, plan.links, len(plan.joints)]
    header[[at.NODES, at.FREEDOMS, at.LINKS, at.JOINTS]] = numbers
    header[at.ROOTS] = sum(node.parent == GROUND for node in plan.tree)
    header[at.ROWS] = len(plan.rows)
    names = {at.JOINT_COLUMN: "0.ground_frame", at.GRAVITY_COLUMN: "gravity"}
    for column, name in (names | {at.START_COLUMN: "0.pose"}).items():
        header[column] = inputs[name].start
    extra = size_of(states_of(plan))
    state = state_columns(count, extra)
    moving = inputs.count + (state.count + lane_end(plan).count) * ("state" in plan.moving)
    seeds = plan.directions * moving
    seeded = inputs.count + seeds  # columns of inputs and derivatives; those of an end are behind
    header[[at.SEEDS, at.END_SEEDS]] = inputs.count, inputs.count - plan.directions * seeds
    header[[at.CHART_COLUMN, at.V_COLUMN, at.STATES_COLUMN]] = [
        seeded + state[name].start for name in ("charts", "v", "states")
    ]
    nodes = np.zeros((count + 1, at.TABLE), np.int64)
    slots, errors = _slots(plan, nodes, apart), len(plan.joints)
    has_next = plan.has_lane_clocks or apart
    slopes = freedoms * (slopes_of(plan) + 1)
    elements, rows = elements_of(plan)
    constraints = constraints_of(plan, [kind.freedoms for kind in kinds])
    ahead = (charts + freedoms) * has_next
    sizes = {
        at.CONSTANTS_ROW: (count + 1) * CONSTANTS, at.DETAILS_ROW: (count + 1) * DETAILS,
        at.CHART_ROW: charts, at.V_ROW: freedoms, at.KEPT_ROW: len(JOINT_KEPT) * errors,
        at.X_ROW: freedoms, at.STAGE_ROW: freedoms, at.MOTION_ROW: (count + 1) * MOTION,
        at.PASSED_ROW: slots * PASSED, at.X_SLOPES: slopes, at.V_SLOPES: slopes,
        at.ERRORS_ROW: len(JOINT_ERRORS) * errors, at.SUMS_ROW: at.SUMS,
        at.LOADS_ROW: 6 * (count + 1), at.WRENCH_ROW: 6 * (count + 1 + plan.loops),
        at.ELEMENT_ROWS: rows, at.TRAVEL_ROW: TRAVEL * plan.has_lane_clocks * len(elements),
        **constraints.sizes, at.OFF_ROW: freedoms * bool(plan.constraints),
        at.AHEAD: ahead, at.COPY_ROW: ahead,
    }  # fmt: skip
    end = 0
    for section, size in sizes.items():
        header[section], end = end, end + size
    header[at.MEMORY] = end
    header[at.STATE] = charts + freedoms
    header[at.AHEAD] = header[at.AHEAD] - header[at.CHART_ROW] if has_next else 0
    header[at.END_COLUMNS] = sum(map(sum, map(_stored, kinds))) + extra
    header[at.LANE_COLUMN] = seeded + state.count
    header[at.STATE_ROWS] = charts + freedoms + sizes[at.KEPT_ROW]
    _fill_in(plan, joints, header, nodes)
    elements[:, at.ROW] += header[at.ELEMENT_ROWS]
    place = at.HEADER + nodes.size
    header[[at.ELEMENTS, at.ELEMENT_TABLE]] = len(elements), place
    header[at.LISTED_TABLE] = place + elements.size
    tables = [part.ravel() for part in (nodes, elements, listed_of(plan))]
    tables += constraints.tables(header, at.HEADER + sum(part.size for part in tables))
    return np.concatenate([header, *tables])[None], end


def _fill_in(
    plan: MechanismPlan,
    joints: list[JointKind],
    header: NDArray[np.int64],
    nodes: NDArray[np.int64],
) -> None:
    """Fill in the numbers of all nodes but their slots."""
    kinds = [joint.kind for joint in joints]
    multipliers = [*accumulate((len(c.rows) for c in plan.connections), initial=0)]
    chart, freedom, ends = header[at.CHART_ROW], 0, [0, sum(_stored(k)[0] for k in kinds)]
    for i, (node, kind) in enumerate(zip(plan.tree, kinds, strict=True), 1):
        nodes[i, [at.CHART_END, at.V_END]] = ends
        ends = [end + size for end, size in zip(ends, _stored(kind), strict=True)]
        link = node.link if node.link != MASSLESS else plan.tree[i].link
        nodes[i, [at.KIND, at.PARENT, at.LINK]] = plan.kinds.index(kind), node.parent + 1, link
        nodes[i, at.ROLE] = joints[i - 1].role
        nodes[i, at.BASE] = first_of_joint(plan.tree, i - 1) + 1
        nodes[i, at.MULTIPLIER] = multipliers[link]
        nodes[i, at.JOINT] = plan.joint_kinds.index(joints[i - 1])
        nodes[i, [at.CHART, at.FREEDOM]] = chart, freedom
        chart, freedom = chart + len(kind.chart_rows), freedom + kind.freedoms
    first = header[at.PASSED_ROW]
    nodes[:, [at.PASSES, at.CHILDREN]] = PASSED * nodes[:, [at.PASSES, at.CHILDREN]] + first
    nodes[:, at.SIBLING] = np.where(nodes[:, at.SIBLING], first + PASSED * nodes[:, at.SIBLING], 0)


def joint_kind_of(plan: MechanismPlan, i: int) -> JointKind:
    """Kind of the joint of node i."""
    node = plan.tree[i]
    if node.link == MASSLESS:
        return JointKind(Kind(node.slots), ())
    first = first_of_joint(plan.tree, i)
    before = plan.tree[first].slots if first != i else None
    return JointKind(Kind(node.slots), plan.connections[node.link].rows, before)


def slopes_of(plan: AnyPlan) -> int:
    """Number of slopes of a step; those of a state at rest in memory come behind."""
    assert isinstance(plan.method, StagedScheme)
    extension = plan.method.extension
    return len(plan.method.stages) + (len(extension.stages) if extension else 0)


def _stored(kind: Kind) -> tuple[int, int]:
    """Numbers of a node's chart and velocity that are stored at the end of a run."""
    ones = (1.0,) * 6
    chart = subgroup.on_subgroup(kind.slots, (ones[:4], ones[:3]))
    parts = chart, subgroup.lifted(kind.slots, ones, 1.0)
    some = [sum(not is_zero(x) for x in flatten(part)) for part in parts]
    return some[0], some[1]


def _slots(plan: MechanismPlan, nodes: NDArray[np.int64], apart: bool) -> int:
    """Assign to each node a slot for what it passes on; return the number of slots.

    A node takes over the slot of its first child, so that few slots suffice, which stay in the
    cache. Slot 0 remains zero, for nodes without children.   apart : see `table_of`.
    """
    children: list[list[int]] = [[] for _ in nodes]
    for i, node in enumerate(plan.tree, 1):
        children[node.parent + 1].append(i)
    known, unused = 0, list[int]()
    for i in range(len(plan.tree), 0, -1):
        if children[i]:
            nodes[i, [at.PASSES, at.CHILDREN]] = nodes[children[i][0], at.PASSES]
        if apart or not children[i]:
            known += not unused
            nodes[i, at.PASSES] = unused.pop() if unused else known
        parent = plan.tree[i - 1].parent + 1
        later = [k for k in children[parent] if k > i]
        if later and parent:
            nodes[i, at.SIBLING] = nodes[later[0], at.PASSES]
            unused += [int(nodes[later[0], at.PASSES])] * (not apart)
    return known + 1
