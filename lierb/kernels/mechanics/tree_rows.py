"""Rows constrain the accelerations of two nodes of a tree."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from lierb.kernels.mechanics.spatial import Pose, wrench_from
from lierb.kernels.mechanics.tree import GROUND, Connection, Relative
from lierb.kernels.numbers.arithmetic import fma
from lierb.kernels.numbers.number import Number
from lierb.kernels.numbers.vec import ZERO3, Vec, add, dot, scale
from lierb.kernels.numbers.zero import ZERO, is_zero


class Response(NamedTuple):
    """Hold the accelerations of all nodes under some loads."""

    moved: tuple[Vec, ...]  # A of each node, or of unit loads
    rates: tuple[Vec, ...]  # S ν̇
    totals: tuple[Vec, ...]  # loads, including those transmitted by descendants


class NodeRow(NamedTuple):
    """A row constrains the accelerations of two nodes: push·A − pull·A_other = wanted.

    push, pull : the row as wrenches about the nodes' frames.   fall : see `Relative`.
    stiffness : s, for a row of the joint that connects `node` to its parent `other`.
    also : rest of the row, at a second joint.
    """

    node: int
    other: int
    push: Vec
    pull: Vec
    fall: Vec | None
    wanted: Number
    stiffness: Number = ZERO
    also: NodeRow | None = None

    @property
    def parts(self) -> tuple[NodeRow, ...]:
        """The row at each of its joints."""
        return (self,) if self.also is None else (self, self.also)

    def loads(self, size: Number = 1.0) -> dict[int, Vec]:
        """Return the wrenches on the nodes for a multiplier −size."""
        wrenches: dict[int, Vec] = {}
        for each in self.parts:
            add_loads(wrenches, {each.node: scale(size, each.push)})
            if each.other != GROUND:
                add_loads(wrenches, {each.other: scale(-size, each.pull)})
        return wrenches

    def of(self, response: Response) -> Number:
        """Return the left-hand side of the row at some accelerations."""
        total: Number = ZERO
        for each in self.parts:
            total = total + dot(each.push, response.moved[each.node])
            if each.other != GROUND:
                total = total - dot(each.pull, response.moved[each.other])
        return total

    def of_ground(self) -> Number:
        """Part of the left-hand side due to the acceleration of the ground."""
        falls = (dot(each.pull, ZERO3 + each.fall) for each in self.parts if each.fall is not None)
        return sum(falls, start=ZERO)

    def on_still_ground(self) -> NodeRow:
        also = self.also and self.also.on_still_ground()
        return self._replace(fall=None, also=also)


def add_loads(total: dict[int, Vec], more: dict[int, Vec]) -> None:
    """Add wrenches on nodes to others."""
    for i, load in more.items():
        total[i] = add(total[i], load) if i in total else load


def node_row(
    connection: Connection, relative: Relative, jacobian: Vec, inner: Pose, wanted: Any
) -> NodeRow:
    """Return a connection's row, in the accelerations of its nodes.   jacobian : J of J·V_rel."""
    push = jacobian if connection.hangs else wrench_from(inner, jacobian)
    pull = wrench_from(relative.seat, jacobian)
    return NodeRow(connection.node, connection.other, push, pull, relative.fall, wanted)


def stiffness_of(rows: Sequence[NodeRow], i: int, directions: list[Vec]) -> list[list[Number]]:
    """Return Σ s BᵀB over the rows B ν̇ that make node i stiff."""
    count = len(directions)
    total: list[list[Number]] = [[ZERO] * count for _ in range(count)]
    for each in rows:
        if each.node == i and not is_zero(each.stiffness):
            b = [dot(each.push, s) for s in directions]
            total = [
                [fma(each.stiffness * x, y, k) for y, k in zip(b, ks, strict=True)]
                for x, ks in zip(b, total, strict=True)
            ]
    return total
