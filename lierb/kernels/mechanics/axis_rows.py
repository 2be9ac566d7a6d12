"""Rows on the coordinates of joint axes: those of motors and gears."""

from __future__ import annotations

from lierb.kernels.mechanics.newton_euler import Kinematics
from lierb.kernels.mechanics.rows import AddedRow, HeldBody, Point
from lierb.kernels.numbers.arithmetic import PI, fma, rint
from lierb.kernels.numbers.number import Number
from lierb.kernels.numbers.trigonometry import atan2
from lierb.kernels.numbers.vec import UNIT, ZERO3, Vec
from lierb.kernels.numbers.zero import ZERO

SLIDING = Point(2)


class AxisRow(AddedRow):
    """Row on the coordinate of a joint's axis e₃: its angle φ, or its slide d₃.

    The element's `needs_slide` decides which.
    """

    @property
    def is_translational(self) -> bool:  # type: ignore[override]
        return bool(self.element.needs_slide)

    @property
    def held_axis(self) -> int | None:
        return 2 if self.is_translational else None

    @property
    def fixed_axis(self) -> int | None:
        return None if self.is_translational else 2

    def jacobian(self, x: Kinematics, body: HeldBody) -> Vec:
        return SLIDING.jacobian(x, body) if self.is_translational else UNIT[2] + ZERO3

    def bend(self, x: Kinematics, body: HeldBody) -> Number:
        """Right-hand side η of a constant rate."""
        return SLIDING.acceleration(x, body) if self.is_translational else ZERO

    def coordinate(self, x: Kinematics) -> Number:
        """Coordinate of the axis; an angle in [−π, π]."""
        return x.d[2] if self.is_translational else atan2(x.q[3], x.q[0])

    def moved(self, x: Kinematics, before: Kinematics, body: HeldBody) -> Number:
        """Change of the coordinate since another motion, less than half a turn."""
        return self.distance(x, self.coordinate(before))

    def distance(self, x: Kinematics, start: Number) -> Number:
        """Coordinate relative to `start`; an angle in [−π, π]."""
        way = self.coordinate(x) - start
        if self.is_translational:
            return way
        return fma(-2.0 * PI, rint(way * (0.5 / PI)), way)
