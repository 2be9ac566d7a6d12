"""Compute the relative motion of the two frames of each connection."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from lierb.kernels.mechanics.constraints import residuals
from lierb.kernels.mechanics.newton_euler import Kinematics
from lierb.kernels.mechanics.rows import PITCHED, Row, Rows
from lierb.kernels.mechanics.saddle import kinds_of
from lierb.kernels.mechanics.tree import Connection, Ends, Relative, TreeConstants, TreeMotion
from lierb.kernels.mechanics.tree_dynamics import Factored
from lierb.kernels.mechanics.tree_rows import NodeRow, node_row
from lierb.kernels.numbers.arithmetic import fma, maximum, sqrt, where
from lierb.kernels.numbers.vec import Vec, dot, norm, row, scale
from lierb.kernels.numbers.zero import ZERO, is_zero
from lierb.kernels.systems.tree_inputs import sixes


class Relatives:
    """Relative motion of every connection's frames, computed on first use."""

    def __init__(
        self, connections: tuple[Connection, ...], ends: tuple[Ends, ...], motion: TreeMotion
    ) -> None:
        self.connections, self.ends, self.motion = connections, ends, motion
        self._known: dict[int, Relative] = {}
        self._residuals: dict[int, dict[Row, Any]] = {}

    def __getitem__(self, number: int) -> Relative:
        if number not in self._known:
            pair = self.connections[number], self.ends[number]
            self._known[number] = self.motion.between(*pair)
        return self._known[number]

    def parts(self, number: int, row: Row) -> list[tuple[int, Row]]:
        """Return the part of a connection's row at each connection that it depends on."""
        own = [(number, row)]
        return own if row.second is None else [*own, (self.connections[number].second, row.second)]

    def rate(self, number: int, row: Row) -> Any:
        """Return J V of a connection's row."""
        total: Any = ZERO
        for at, part in self.parts(number, row):
            x = self[at].x
            total = total + dot(part.jacobian(x, self.ends[at]), x.omega + x.point_rate)
        return total

    def rate_error(self, number: int, row: Row) -> Any:
        """Return J V of a connection's row less its prescribed rate."""
        return self.rate(number, row) - row.prescribed_rate(self[number].x, self.ends[number])

    def bias(self, number: int, row: Row) -> Any:
        """Return the right-hand side of a row on A_a − Ad A_b of a connection's nodes."""
        total: Any = ZERO
        for at, part in self.parts(number, row):
            relative, ends = self[at], self.ends[at]
            jacobian = part.jacobian(relative.x, ends)
            total = total + (part.acceleration(relative.x, ends) + dot(jacobian, relative.bias))
        return total

    def equation(self, number: int, row: Row, wanted: Any) -> NodeRow:
        """Return the equation of a connection's row in the nodes' accelerations."""
        (first, *rest) = (
            self.wrench(at, part.jacobian(self[at].x, self.ends[at]), wanted)
            for at, part in self.parts(number, row)
        )
        return first._replace(also=rest[0]) if rest else first

    def wrench(self, number: int, jacobian: Vec, wanted: Any = ZERO) -> NodeRow:
        """Return the equation with a Jacobian (6,), or a wrench between a connection's frames."""
        relative, ends, connection = self[number], self.ends[number], self.connections[number]
        return node_row(connection, relative, jacobian, ends.inner, wanted)

    def residuals(self, number: int, rows: Rows) -> dict[Row, Any]:
        """Return the constraint residuals h of a connection's holonomic rows."""
        rows = tuple(r for r in rows if r.is_holonomic)
        return dict(zip(rows, residuals(rows, self[number].x, self.ends[number]), strict=True))

    def residual(self, number: int, row: Row) -> Any:
        """Return the constraint residual h of one row, zero if the row is not holonomic."""
        if number not in self._residuals:
            self._residuals[number] = self.residuals(number, self.connections[number].rows)
        return self._residuals[number].get(row, ZERO)

    def violation(self) -> Any:
        """Return the sum of squares of all residuals, with lengths relative to the mechanism's."""
        inverse = 1.0 / length_of(self.motion.body)
        total: Any = ZERO
        for number, connection in enumerate(self.connections):
            for r, value in self.residuals(number, connection.rows).items():
                part = value * inverse if r.is_translational else value
                total = fma(part, part, total)
        return total


def constrained_part(motion: TreeMotion, i: int, velocity: Vec) -> Vec:
    """Return the part of V_rel that violates the rows on whose null space node i is solved."""
    fixed = kinds_of(motion.nodes[i].rows)[1]
    turning = tuple(velocity[k] if k in fixed else ZERO for k in range(3))
    return turning + motion.held(i, velocity[3:])


def largest(squares: Sequence[Any]) -> Any:
    """Return the largest of some numbers; NaN where any of them is."""
    total: Any = ZERO
    for square in squares:
        if is_zero(total) or is_zero(square):
            total = square if is_zero(total) else total
            continue
        larger = where(square == square, maximum(total, square), square)
        total = where(total == total, larger, total)
    return total


def multipliers_of_wrench(rows: Rows, x: Kinematics, ends: Ends, wrench: Vec) -> dict[Row, Any]:
    """Return the multipliers λ of rows, such that the wrenches −Jᵀλ add up to `wrench`."""
    torque, force = wrench[:3], wrench[3:]
    multipliers: dict[Row, Any] = {}
    for r in rows:
        if r.held_axis is not None:
            multipliers[r] = -dot(row(x.q, r.held_axis), force)
        elif r.fixed_axis is not None:
            multipliers[r] = -torque[r.fixed_axis]
        elif r.slot == (5, PITCHED):
            multipliers[r] = -force[2]
    if len(multipliers) == len(rows):
        return multipliers
    jacobians = [r.jacobian(x, ends) for r in rows]  # for a joint whose rows are not orthogonal
    gram = Factored([[dot(j, k) for k in jacobians[: i + 1]] for i, j in enumerate(jacobians)])
    return dict(zip(rows, gram.solve([-dot(j, wrench) for j in jacobians]), strict=True))


def length_of(body: TreeConstants) -> Any:
    """Return the characteristic length, m: radius of gyration of a link plus all lever arms."""
    heavy = next(c for c in body.nodes if c.rigid.mass is not ZERO)
    trace = heavy.inertia[0] + heavy.inertia[4] + heavy.inertia[8]
    total: Any = sqrt(trace / heavy.rigid.mass)
    for constants in body.nodes:
        total = total + norm(constants.com) + norm(constants.hang[1])
    return total


def size_of(length: Any, motion: Vec) -> Any:
    """Norm of a motion or velocity of all nodes, m or m/s; rotations are multiplied by `length`."""
    parts = ((scale(length, each[:3]), each[3:]) for each in sixes(motion))
    return sqrt(sum((dot(turn, turn) + dot(move, move) for turn, move in parts), start=ZERO))
