"""Table of a tree whose nodes are in memory: its nodes, and the places of their numbers.

A table is an array of int64: HEADER numbers, then TABLE numbers for each node. Node 0 is the
ground; each node comes after its parent. *Rows* are those of a thread's memory, [row][lane].
"""

from __future__ import annotations

from functools import lru_cache
from itertools import accumulate
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lierb.kernels.mechanics import subgroup
from lierb.kernels.mechanics.tree import HERE, MASSLESS
from lierb.kernels.mechanics.tree_nodes import (
    CONSTANTS,
    DETAILS,
    FRAME_ROWS,
    MOTION,
    PASSED,
    JointKind,
    Kind,
)
from lierb.kernels.numbers.arithmetic import flatten
from lierb.kernels.numbers.zero import is_zero
from lierb.kernels.systems.measures import JOINT_ERRORS, JOINT_KEPT
from lierb.kernels.systems.plan import AnyPlan, ElementKind, MechanismPlan
from lierb.kernels.systems.tree_inputs import first_of_joint, inputs_of, placed_on, state_columns

# Header: numbers of nodes (without the ground), freedoms and links; columns of the inputs;
(
    NODES, FREEDOMS, LINKS, JOINT_COLUMN, GRAVITY_COLUMN, START_COLUMN, CHART_COLUMN, V_COLUMN,
    # the number of elements, and their place in the table;
    ELEMENTS, ELEMENT_TABLE,
    # first rows of the nodes' constants; of the state: charts, velocities, JOINT_KEPT of each link;
    CONSTANTS_ROW, DETAILS_ROW, CHART_ROW, V_ROW, KEPT_ROW, STATE_ROWS,
    # and of a stage: X/2 and V, motion, what nodes pass on, slopes of X and V, errors, sums.
    X_ROW, STAGE_ROW, MOTION_ROW, PASSED_ROW, X_SLOPES, V_SLOPES, ERRORS_ROW, SUMS_ROW,
    # loads on the nodes, wrenches of the joints, and rows of the elements.
    LOADS_ROW, WRENCH_ROW, ELEMENT_ROWS,
    # Numbers of a state; rows from a state to the one that a step leads to, 0 for one in its place;
    # a copy of that. Numbers of a state at the end of a run, and column of a lane's end in inputs.
    STATE, AHEAD, COPY_ROW, END_COLUMNS, LANE_COLUMN, HEADER,
) = range(33)  # fmt: skip
# A node's numbers: its kind and that of its joint; its role, and the first node of its joint; its
# parent; rows of its chart; its first freedom; rows of what it passes on, of what its children pass
# on, and of what its next sibling passes on, or 0; its link, or that of the next node for a
# massless one; columns of chart and velocity at the end of a run, and of its joint's first λ.
(
    KIND, JOINT, ROLE, BASE, PARENT, CHART, FREEDOM, PASSES, CHILDREN, SIBLING, LINK, CHART_END,
    V_END, MULTIPLIER, TABLE,
) = range(15)  # fmt: skip
# An element's numbers: its kind, its two nodes, its link's joint, its first column and its row.
ELEMENT_KIND, NODE, OTHER, ON_JOINT, COLUMN, ROW, ELEMENT = range(7)
# Rows of sums over all nodes: energy, orthogonality error, largest errors of the joints, power.
ENERGY, ORTHOGONALITY, ERRORS, POWER, SUMS = 0, 1, 2, 2 + len(JOINT_ERRORS), 3 + len(JOINT_ERRORS)


@lru_cache(64)
def table_of(plan: MechanismPlan) -> tuple[NDArray[np.int64], int]:
    """Return a plan's table, and the number of rows of a thread's memory."""
    count, joints = len(plan.tree), [joint_kind_of(plan, i) for i in range(len(plan.tree))]
    kinds = [joint.kind for joint in joints]
    freedoms, charts = (sum(x) for x in zip(*((k.freedoms, len(k.chart_rows)) for k in kinds)))
    inputs = inputs_of(plan.links, plan.loops, plan.elements)
    header = np.zeros(HEADER, np.int64)
    header[[NODES, FREEDOMS, LINKS]] = count, freedoms, plan.links
    header[JOINT_COLUMN] = inputs["0.ground_frame"].start
    header[GRAVITY_COLUMN], header[START_COLUMN] = inputs["gravity"].start, inputs["0.pose"].start
    state = state_columns(count, 0)
    header[[CHART_COLUMN, V_COLUMN]] = [
        inputs.count + state[name].start for name in ("charts", "v")
    ]
    nodes = np.zeros((count + 1, TABLE), np.int64)
    slots = _slots(plan, nodes)
    slopes = slopes_of(plan) + 1
    sizes = {
        CONSTANTS_ROW: (count + 1) * CONSTANTS,
        DETAILS_ROW: (count + 1) * DETAILS,
        CHART_ROW: charts,
        V_ROW: freedoms,
        KEPT_ROW: len(JOINT_KEPT) * plan.links,
        X_ROW: freedoms,
        STAGE_ROW: freedoms,
        MOTION_ROW: (count + 1) * MOTION,
        PASSED_ROW: slots * PASSED,
        X_SLOPES: slopes * freedoms,
        V_SLOPES: slopes * freedoms,
        ERRORS_ROW: len(JOINT_ERRORS) * plan.links,
        SUMS_ROW: SUMS,
        LOADS_ROW: 6 * (count + 1),
        WRENCH_ROW: 6 * (count + 1),
        ELEMENT_ROWS: sum(map(element_rows, plan.element_kinds)),
        AHEAD: (charts + freedoms) * plan.has_lane_clocks,
        COPY_ROW: (charts + freedoms) * plan.has_lane_clocks,
    }
    end = 0
    for name, size in sizes.items():
        header[name], end = end, end + size
    header[STATE] = charts + freedoms
    header[AHEAD] = header[AHEAD] - header[CHART_ROW] if plan.has_lane_clocks else 0
    header[END_COLUMNS] = sum(map(sum, map(_stored, kinds)))
    header[LANE_COLUMN] = inputs.count + state.count
    header[STATE_ROWS] = charts + freedoms + sizes[KEPT_ROW]
    multipliers = [*accumulate((len(at.rows) for at in plan.connections), initial=0)]
    chart, freedom, ends = header[CHART_ROW], 0, [0, sum(_stored(k)[0] for k in kinds)]
    for i, (node, kind) in enumerate(zip(plan.tree, kinds, strict=True), 1):
        nodes[i, [CHART_END, V_END]] = ends
        ends = [end + size for end, size in zip(ends, _stored(kind), strict=True)]
        link = node.link if node.link != MASSLESS else plan.tree[i].link
        nodes[i, [KIND, PARENT, LINK]] = plan.kinds.index(kind), node.parent + 1, link
        nodes[i, ROLE] = joints[i - 1].role
        nodes[i, BASE] = first_of_joint(plan.tree, i - 1) + 1
        nodes[i, MULTIPLIER] = multipliers[link]
        nodes[i, JOINT] = plan.joint_kinds.index(joints[i - 1])
        nodes[i, [CHART, FREEDOM]] = chart, freedom
        chart, freedom = chart + len(kind.chart_rows), freedom + kind.freedoms
    nodes[:, [PASSES, CHILDREN]] *= PASSED
    nodes[:, [PASSES, CHILDREN]] += header[PASSED_ROW]
    nodes[:, SIBLING] = np.where(
        nodes[:, SIBLING], header[PASSED_ROW] + PASSED * nodes[:, SIBLING], 0
    )
    elements = _elements(plan, int(header[ELEMENT_ROWS]))
    header[[ELEMENTS, ELEMENT_TABLE]] = len(elements), HEADER + nodes.size
    return np.concatenate([header, nodes.ravel(), elements.ravel()])[None], end


def _elements(plan: MechanismPlan, row: int) -> NDArray[np.int64]:
    table = np.zeros((len(plan.elements), ELEMENT), np.int64)
    kinds = tuple(dict.fromkeys(plan.element_kinds))
    columns = inputs_of(plan.links, plan.loops, plan.elements)
    places = plan.connections[len(plan.joints) :]
    for k, (kind, at) in enumerate(zip(plan.element_kinds, places, strict=True)):
        names = list(kind.element.shapes)
        column = columns[f"element{k}.{names[0]}"].start if names else 0
        table[k] = kinds.index(kind), at.node + 1, at.other + 1, max(at.joint, 0), column, row
        row += element_rows(kind)
    return table


def element_rows(kind: ElementKind) -> int:
    """Rows of an element: the frame on its other node, and its parameters."""
    return FRAME_ROWS + sum(not is_zero(x) for x in flatten(placed_shape(kind)))


@lru_cache(256)
def placed_shape(kind: ElementKind) -> Any:
    """Parameters of an element between two nodes, of which only the structural zeros matter."""
    given: dict[str, Any] = {
        name: (0.7,) * prod(shape) if shape else 0.7 for name, shape in kind.element.shapes.items()
    }
    frame = (0.7,) * 9, (0.7,) * 3
    ground = HERE if kind.on_ground and not kind.on_joint else frame
    return placed_on(kind.element, given, 0.7, frame[0], frame[1], frame, frame, ground)


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
    extension = plan.method.extension
    return len(plan.method.stages) + (len(extension.stages) if extension else 0)


def _stored(kind: Kind) -> tuple[int, int]:
    """Numbers of a node's chart and velocity that are stored at the end of a run."""
    ones = (1.0,) * 6
    chart = subgroup.on_subgroup(kind.slots, (ones[:4], ones[:3]))
    parts = chart, subgroup.lifted(kind.slots, ones, 1.0)
    some = [sum(not is_zero(x) for x in flatten(part)) for part in parts]
    return some[0], some[1]


def _slots(plan: MechanismPlan, nodes: NDArray[np.int64]) -> int:
    """Assign to each node a slot for what it passes on; return the number of slots.

    A node takes over the slot of its first child, so that few slots suffice, which stay in the
    cache. Slot 0 remains zero, for nodes without children.
    """
    children: list[list[int]] = [[] for _ in nodes]
    for i, node in enumerate(plan.tree, 1):
        children[node.parent + 1].append(i)
    known, unused = 0, list[int]()
    for i in range(len(plan.tree), 0, -1):
        if children[i]:
            first = nodes[children[i][0], PASSES]
            nodes[i, [PASSES, CHILDREN]] = first
        else:
            known += not unused
            nodes[i, PASSES] = unused.pop() if unused else known
        parent = plan.tree[i - 1].parent + 1
        later = [k for k in children[parent] if k > i]
        if later and parent:
            nodes[i, SIBLING] = nodes[later[0], PASSES]
            unused.append(int(nodes[later[0], PASSES]))
    return known + 1
