"""Elements and constraints in the table of a tree in memory: frames, rows, paths to the ground.

A *constraint* is a connection whose rows have multipliers: a loop's joint, a motor that prescribes
a speed, a user's constraint. An *equation* is one of its rows. J M⁻¹ Jᵀ of two equations is a sum
over the nodes on both paths to the ground. It is stored by rows, each from the first constraint
on that shares a node with its own: the factors L and L D have no entry outside this envelope.
"""

from __future__ import annotations

from functools import lru_cache
from itertools import accumulate
from math import prod
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lierb.kernels.mechanics.tree import HERE
from lierb.kernels.mechanics.tree_connections import FRAME_ROWS
from lierb.kernels.mechanics.tree_nodes import MOTION, PULLS
from lierb.kernels.numbers.arithmetic import flatten
from lierb.kernels.numbers.zero import is_zero
from lierb.kernels.systems import tree_places as at
from lierb.kernels.systems.plan import ElementKind, LoopPlan, MechanismPlan
from lierb.kernels.systems.tree_inputs import inputs_of, placed_on

# Rows of a constraint: two frames, pitch and length, mobilities of both nodes, and parameters.
INNER, OUTER, PITCH, SIZE, EASY, PLACED = 0, 12, 24, 25, 26, 34
TRAVEL = 18  # rows of a motion between two nodes: Q, d, ω, v


def element_rows(kind: ElementKind) -> int:
    """Rows of an element: frames on its other node and on its loop's, and its parameters."""
    return FRAME_ROWS * (1 + kind.on_loop) + placed_rows(kind)


def placed_rows(kind: ElementKind) -> int:
    return sum(not is_zero(x) for x in flatten(placed_shape(kind)))


@lru_cache(256)
def placed_shape(kind: ElementKind) -> Any:
    """Parameters of an element between two nodes, of which only the structural zeros matter."""
    given: dict[str, Any] = {
        name: (0.7,) * prod(shape) if shape else 0.7 for name, shape in kind.element.shapes.items()
    }
    frame = (0.7,) * 9, (0.7,) * 3
    ground = HERE if kind.on_ground and not kind.on_joint else frame
    return placed_on(kind.element, given, 0.7, frame[0], frame[1], frame, frame, ground)


def elements_of(plan: MechanismPlan) -> tuple[NDArray[np.int64], int]:
    """Table of the elements that act without rows, and the number of their rows of memory."""
    table, kinds, row = [], _code(plan).element_kinds, 0
    for k, kind in enumerate(plan.element_kinds):
        if not (kind.element.rows or kind.element.is_passive):
            table.append((kinds.index(kind), *_connection(plan, len(plan.joints) + k), row))
            row += element_rows(kind)
    return np.array(table, np.int64).reshape(-1, at.ELEMENT), row


def listed_of(plan: MechanismPlan) -> NDArray[np.int64]:
    """Table of the elements that the code has one by one, without kinds and rows."""
    first = len(plan.joints)
    table = [(0, *_connection(plan, first + k), 0) for k in plan.listed]
    return np.array(table, np.int64).reshape(-1, at.ELEMENT)


def _connection(plan: MechanismPlan, number: int) -> tuple[int, int, int, int]:
    """Nodes of a connection, its joint, and the first column of its element's parameters."""
    place, k = plan.connections[number], number - len(plan.joints)
    column = 0
    if k >= 0 and (names := list(plan.elements[k].shapes)):
        columns = inputs_of(plan.links, plan.loops, plan.elements)
        column = columns[f"element{k}.{names[0]}"].start
    joint = number if k < 0 else max(place.joint, 0)
    return place.node + 1, place.other + 1, joint, column


def _code(plan: MechanismPlan) -> LoopPlan:
    code = plan.code
    assert isinstance(code, LoopPlan)
    return code


class Constraints(NamedTuple):
    """Constraints of a plan.   sizes : rows of each section of memory."""

    constraints: NDArray[np.int64]
    paths: NDArray[np.int64]
    equations: NDArray[np.int64]
    pairs: NDArray[np.int64]
    stretches: NDArray[np.int64]
    sizes: dict[int, int]

    def tables(self, header: NDArray[np.int64], place: int) -> list[NDArray[np.int64]]:
        """Fill in the header, and return what stands behind it, from `place` on."""
        self.constraints[:, at.PATH] += place + self.constraints.size
        self.constraints[:, at.ROW] += header[at.CONSTRAINT_ROWS]
        self.constraints[:, at.LEFT] += header[at.LEFT_ROW]
        self.constraints[:, at.WRENCH] += header[at.WRENCH_ROW]
        self.paths[:, at.FORCED] += header[at.MOTION_ROW]
        header[[at.CONSTRAINTS, at.CONSTRAINT_TABLE]] = len(self.constraints), place
        place += self.constraints.size + self.paths.size
        header[[at.EQUATIONS, at.EQUATION_TABLE]] = len(self.equations), place
        place += self.equations.size
        header[[at.PAIRS, at.PAIR_TABLE]] = len(self.pairs), place
        self.pairs[:, at.STRETCHES] += place + self.pairs.size
        parts = self.constraints, self.paths, self.equations, self.pairs, self.stretches
        return [part.ravel() for part in parts]


def constraints_of(plan: MechanismPlan, freedoms: list[int]) -> Constraints:
    """Table of the constraints.   freedoms : number of each node."""
    kinds, above = _code(plan).constraint_kinds, [-1, *(node.parent + 1 for node in plan.tree)]
    multipliers = [*accumulate((len(c.rows) for c in plan.connections), initial=0)]
    table: list[tuple[int, ...]] = []
    steps: list[tuple[int, ...]] = []
    equations: list[tuple[int, ...]] = []
    pairs: list[tuple[int, ...]] = []
    stretches: list[tuple[int, int, int]] = []
    places: list[dict[int, range]] = []
    constants = left = schur = 0
    firsts: list[int] = []
    for number, kind in plan.constraints:
        nodes = _connection(plan, number)
        walks = _walks(above, *nodes[:2])
        path = sorted(i for walk in walks for i in walk)
        own = dict(zip(path, accumulate((freedoms[i - 1] for i in path), initial=0), strict=False))
        length = sum(freedoms[i - 1] for i in path)
        first, count = len(equations), len(kind.rows)
        places.append({i: range(own[i], own[i] + freedoms[i - 1]) for i in path})
        firsts.append(first)
        table.append((
            kinds.index(kind), *nodes, constants, first, count, multipliers[number], left,
            len(steps) * at.STEP, *map(len, walks), length, _wrench_row(plan, number),
        ))  # fmt: skip
        for i in (i for walk in walks for i in walk):
            moves = freedoms[i - 1]
            steps.append((i, own[i], moves, i * MOTION + PULLS + 6 * moves))
        constants += PLACED + (placed_rows(kind.element) if kind.element else 0)
        left += 2 * count * length
        shared = [_stretches(places[-1], before) for before in places]
        envelope = next(k for k, some in enumerate(shared) if some or k == len(table) - 1)
        for k in range(envelope, len(table)):
            pairs.append((len(table) - 1, k, len(stretches) * at.STRETCH, len(shared[k])))
            stretches += shared[k]
        for i in range(first, first + count):
            equations.append((firsts[envelope], schur - firsts[envelope]))
            schur += i + 1 - firsts[envelope]
    most = max((len(kind.rows) for _, kind in plan.constraints), default=0)
    sizes = {
        at.CONSTRAINT_ROWS: constants, at.LEFT_ROW: left, at.WALK_ROW: 12 * most,
        at.SCHUR_ROW: schur, at.LOWER_ROW: schur, at.SCALED_ROW: schur,
        at.VECTOR_ROWS: at.VECTORS * len(equations),
    }  # fmt: skip
    rows = (
        (table, at.CONSTRAINT), (steps, at.STEP), (equations, at.EQUATION), (pairs, at.PAIR),
        (stretches, at.STRETCH),
    )  # fmt: skip
    parts = [np.array(numbers, np.int64).reshape(-1, width) for numbers, width in rows]
    return Constraints(parts[0], parts[1], parts[2], parts[3], parts[4], sizes)


def _wrench_row(plan: MechanismPlan, number: int) -> int:
    """Row of the wrench of a constraint's joint: those of loops stand behind those of all nodes."""
    place = plan.connections[number]
    joint = number if number < len(plan.joints) else place.joint
    behind = joint - plan.links
    return 6 * (len(plan.tree) + 1 + behind if behind >= 0 else place.node + 1)


def _walks(above: list[int], node: int, other: int) -> tuple[list[int], list[int], list[int]]:
    """Nodes from `node` to the fork of both paths, from `other` to it, and from it to the ground.

    above : parent of each node, the ground being node 0.
    """
    own, others = ([*_to_ground(above, i)] for i in (node, other))
    common = [i for i in own if i in others]
    return [i for i in own if i not in common], [i for i in others if i not in common], common


def _to_ground(above: list[int], i: int) -> list[int]:
    path = []
    while i > 0:
        path.append(i)
        i = above[i]
    return path


def _stretches(one: dict[int, range], other: dict[int, range]) -> list[tuple[int, int, int]]:
    """Stretches of freedoms that are on both paths, by their beginnings and length."""
    found: list[tuple[int, int, int]] = []
    for i in sorted(one.keys() & other.keys()):
        first, second, count = one[i].start, other[i].start, len(one[i])
        if found and (found[-1][0] + found[-1][2], found[-1][1] + found[-1][2]) == (first, second):
            found[-1] = *found[-1][:2], found[-1][2] + count
        elif count:
            found.append((first, second, count))
    return found
