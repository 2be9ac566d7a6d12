"""Relative motion of the two frames of each connection."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from lierb.kernels.mechanics.constraints import residuals
from lierb.kernels.mechanics.newton_euler import Kinematics
from lierb.kernels.mechanics.rows import PITCHED, Row, Rows
from lierb.kernels.mechanics.saddle import kinds_of
from lierb.kernels.mechanics.tree import Connection, Ends, Relative, TreeMotion
from lierb.kernels.mechanics.tree_dynamics import Factored
from lierb.kernels.mechanics.tree_rows import Asked, asked
from lierb.kernels.numbers.arithmetic import maximum, where
from lierb.kernels.numbers.vec import Vec, dot, row
from lierb.kernels.numbers.zero import ZERO, is_zero


class _Relatives:
    """How every connection's frames move, each found when it is first asked for."""

    def __init__(
        self, connections: tuple[Connection, ...], ends: tuple[Ends, ...], motion: TreeMotion
    ) -> None:
        self.connections, self.ends, self.motion = connections, ends, motion
        self._found: dict[int, Relative] = {}
        self._residuals: dict[int, dict[Row, Any]] = {}

    def __getitem__(self, number: int) -> Relative:
        if number not in self._found:
            pair = self.connections[number], self.ends[number]
            self._found[number] = self.motion.between(*pair)
        return self._found[number]

    def asked(self, number: int, row: Row | Vec, wanted: Any) -> Asked:
        """Of a row there, or of one with this Jacobian."""
        relative, ends, connection = self[number], self.ends[number], self.connections[number]
        jacobian = row if isinstance(row, tuple) else row.jacobian(relative.x, ends)
        return asked(connection, relative, jacobian, ends.inner, wanted)

    def residuals(self, number: int, rows: Rows) -> dict[Row, Any]:
        """h of each row there."""
        rows = tuple(r for r in rows if r.is_holonomic)
        return dict(zip(rows, residuals(rows, self[number].x, self.ends[number]), strict=True))

    def residual(self, number: int, row: Row) -> Any:
        """h of one row, zero of one that says nothing of the pose."""
        if number not in self._residuals:
            self._residuals[number] = self.residuals(number, self.connections[number].rows)
        return self._residuals[number].get(row, ZERO)


def _bound(motion: TreeMotion, i: int, velocity: Vec) -> Vec:
    """Of V_rel, what a node's rows forbid that its null space keeps."""
    fixed = kinds_of(motion.nodes[i].rows)[1]
    turning = tuple(velocity[k] if k in fixed else ZERO for k in range(3))
    return turning + motion.held(i, velocity[3:])


def _largest(squares: Sequence[Any]) -> Any:
    """NaN where one of them is."""
    total: Any = ZERO
    for square in squares:
        if is_zero(total) or is_zero(square):
            total = square if is_zero(total) else total
            continue
        larger = where(square == square, maximum(total, square), square)
        total = where(total == total, larger, total)
    return total


def _held_multipliers(rows: Rows, x: Kinematics, ends: Ends, wrench: Vec) -> dict[Row, Any]:
    """λ of rows whose wrenches, −Jᵀλ, make up this one."""
    torque, force = wrench[:3], wrench[3:]
    found: dict[Row, Any] = {}
    for r in rows:
        if r.held_axis is not None:
            found[r] = -dot(row(x.q, r.held_axis), force)
        elif r.fixed_axis is not None:
            found[r] = -torque[r.fixed_axis]
        elif r.slot == (5, PITCHED):
            found[r] = -force[2]
    if len(found) == len(rows):
        return found
    jacobians = [r.jacobian(x, ends) for r in rows]  # of a joint whose rows are not at right angles
    gram = Factored([[dot(j, k) for k in jacobians[: i + 1]] for i, j in enumerate(jacobians)])
    return dict(zip(rows, gram.solve([-dot(j, wrench) for j in jacobians]), strict=True))
