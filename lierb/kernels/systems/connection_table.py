"""Elements and constraints in the table of a tree in memory: frames, rows, paths to the ground.

A *constraint* is a connection whose rows have multipliers: a loop's joint, a motor that prescribes
a speed, a gear, a user's constraint. An *equation* is one of its rows. A gear has a *part* at each
of its two joints; others have one. J M⁻¹ Jᵀ of two equations is a sum over the nodes on both paths
to the ground. It is stored by rows, each from the first constraint on that shares a node with its
own: the factors L and L D have no entry outside this envelope.
"""

from __future__ import annotations

from functools import lru_cache
from itertools import accumulate, combinations, pairwise, takewhile
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

# Rows of a part of a constraint: two frames, pitch and length, mobilities of both nodes, and the
# parameters, which the second part reads from the first.
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
    """Constraints of a plan.

    parts : tables of constraints, steps, legs, equations, pairs and stretches.   sizes : rows of
    each section of memory.
    """

    parts: list[NDArray[np.int64]]
    sizes: dict[int, int]

    def tables(self, header: NDArray[np.int64], place: int) -> list[NDArray[np.int64]]:
        """Fill in the header, and return what stands behind it, from `place` on."""
        constraints, steps, legs, equations, pairs, _ = self.parts
        places = [*accumulate((part.size for part in self.parts), initial=place)]
        constraints[:, at.PATH] += places[1]
        constraints[:, at.LEGS] += places[2]
        constraints[:, at.LEFT] += header[at.LEFT_ROW]
        for part in (0, at.SECOND_PART):
            constraints[:, part + at.ROW] += header[at.CONSTRAINT_ROWS]
            constraints[:, part + at.WRENCH] += header[at.WRENCH_ROW]
        steps[:, at.FORCED] += header[at.MOTION_ROW]
        legs[:, at.LEG_STEPS] += places[1]
        pairs[:, at.STRETCHES] += places[5]
        header[[at.CONSTRAINTS, at.CONSTRAINT_TABLE]] = len(constraints), places[0]
        header[[at.EQUATIONS, at.EQUATION_TABLE]] = len(equations), places[3]
        header[[at.PAIRS, at.PAIR_TABLE]] = len(pairs), places[4]
        return [part.ravel() for part in self.parts]


def constraints_of(plan: MechanismPlan, freedoms: list[int]) -> Constraints:
    """Table of the constraints.   freedoms : number of each node."""
    kinds, above = _code(plan).constraint_kinds, [-1, *(node.parent + 1 for node in plan.tree)]
    multipliers = [*accumulate((len(c.rows) for c in plan.connections), initial=0)]
    table: list[tuple[int, ...]] = []
    steps: list[tuple[int, ...]] = []
    legs: list[tuple[int, ...]] = []
    paths: list[dict[int, range]] = []
    counts: list[int] = []
    constants = left = walked = 0
    for number, kind in plan.constraints:
        first, second, size = _parts(plan, number, kinds.index(kind), constants)
        ends = [part[name] for part in (first, second) for name in (at.NODE, at.OTHER)]
        walks, before = legs_of(above, ends), len(steps)
        equation, count = sum(counts), len(kind.rows)
        path = _freedoms_on(sorted(i for *_, nodes in walks for i in nodes), freedoms)
        length = sum(map(len, path.values()))
        table.append((
            *first, equation, count, multipliers[number], left,
            before * at.STEP, len(path), len(legs) * at.LEG, len(walks), length, *second,
        ))  # fmt: skip
        for handed, joining, nodes in walks:
            wrenches = 6 * count * handed, 6 * count * joining
            legs.append((*wrenches, len(steps) * at.STEP, len(nodes)))
            own = ((i, path[i].start, len(path[i])) for i in nodes)
            steps += [(i, *moves, i * MOTION + PULLS + 6 * moves[1]) for i, *moves in own]
        paths.append(path)
        counts.append(count)
        constants, left = constants + size, left + 2 * count * length
        walked = max(walked, 6 * count * len(ends))
    equations, pairs, stretches, schur = _pairs(paths, counts)
    sizes = {
        at.CONSTRAINT_ROWS: constants, at.LEFT_ROW: left, at.WALK_ROW: walked,
        at.SCHUR_ROW: schur, at.LOWER_ROW: schur, at.SCALED_ROW: schur,
        at.VECTOR_ROWS: at.VECTORS * len(equations),
    }  # fmt: skip
    rows = (
        (table, at.CONSTRAINT), (steps, at.STEP), (legs, at.LEG), (equations, at.EQUATION),
        (pairs, at.PAIR), (stretches, at.STRETCH),
    )  # fmt: skip
    return Constraints([np.array(part, np.int64).reshape(-1, width) for part, width in rows], sizes)


def _parts(
    plan: MechanismPlan, number: int, index: int, row: int
) -> tuple[tuple[int, ...], tuple[int, ...], int]:
    """Numbers of both parts of a constraint, and the number of their rows.

    index : of its kind.   row : first row of the constants.
    """

    def part(number: int, row: int) -> tuple[int, ...]:
        return index, *_connection(plan, number), row, _wrench_row(plan, number)

    kind = _code(plan).constraint_kinds[index]
    size = PLACED + (placed_rows(kind.element) if kind.element else 0)
    if not kind.is_on_two_joints:
        return part(number, row), (0,) * at.PART, size
    return part(number, row), part(plan.connections[number].second, row + size), size + PLACED


def _freedoms_on(path: list[int], freedoms: list[int]) -> dict[int, range]:
    """Freedoms of the nodes of a path among those of the path."""
    ends = [*accumulate((freedoms[i - 1] for i in path), initial=0)]
    return {i: range(*pair) for i, pair in zip(path, pairwise(ends), strict=True)}


def _pairs(
    paths: list[dict[int, range]], counts: list[int]
) -> tuple[list[tuple[int, ...]], list[tuple[int, ...]], list[tuple[int, ...]], int]:
    """Equations, pairs of constraints that share nodes, their stretches, and the entries of S.

    counts : equations of each constraint.
    """
    equations: list[tuple[int, ...]] = []
    pairs: list[tuple[int, ...]] = []
    stretches: list[tuple[int, ...]] = []
    firsts, schur = [*accumulate(counts, initial=0)], 0
    for after, path in enumerate(paths):
        shared = [_stretches(path, before) for before in paths[: after + 1]]
        envelope = next(k for k, some in enumerate(shared) if some or k == after)
        for k in range(envelope, after + 1):
            pairs.append((after, k, len(stretches) * at.STRETCH, len(shared[k])))
            stretches += shared[k]
        for i in range(firsts[after], firsts[after + 1]):
            equations.append((firsts[envelope], schur - firsts[envelope]))
            schur += i + 1 - firsts[envelope]
    return equations, pairs, stretches, schur


def _wrench_row(plan: MechanismPlan, number: int) -> int:
    """Row of the wrench of a constraint's joint: those of loops stand behind those of all nodes."""
    place = plan.connections[number]
    joint = number if number < len(plan.joints) else place.joint
    behind = joint - plan.links
    return 6 * (len(plan.tree) + 1 + behind if behind >= 0 else place.node + 1)


def legs_of(above: list[int], ends: list[int]) -> list[tuple[int, int, list[int]]]:
    """Legs of the way of wrenches to the ground: a wrench, another one that joins it first, or 0,
    and the nodes that hand it on. A wrench waits at the first node that others have yet to pass.

    above : parent of each node, the ground being node 0.   ends : node of each wrench.
    """
    legs: list[tuple[int, int, list[int]]] = []
    now = [*ends]

    def walk(end: int, joining: int = 0) -> None:
        others = {i for k, x in enumerate(now) if k != end for i in _to_ground(above, x)}
        nodes = [*takewhile(lambda i: i not in others, _to_ground(above, now[end]))]
        if nodes or joining:
            legs.append((end, joining, nodes))
        now[end] = above[nodes[-1]] if nodes else now[end]

    for end in range(len(ends)):
        walk(end)
    while any(now):
        pairs = combinations(range(len(ends)), 2)
        end, joining = next((i, k) for i, k in pairs if now[i] == now[k] > 0)
        now[joining] = 0
        walk(end, joining)
    return legs


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
