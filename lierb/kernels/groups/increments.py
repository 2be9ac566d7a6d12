"""An increment is the motion since the chart C₀, in the coordinates of a step.

`Exponential` holds X of C = C₀ exp X, `Ambient` holds Y of C = C₀ (1 + Y)/‖1 + Y‖.
"""

from __future__ import annotations

from types import ModuleType
from typing import Any, NamedTuple, Protocol

from lierb.kernels.groups import ambient, quaternion
from lierb.kernels.groups.coefficients import HalfAngleCoefficients
from lierb.kernels.groups.quaternion import Chart, Pose
from lierb.kernels.numbers.vec import Vec, neg


class Increment(Protocol):
    """An increment is the motion since a chart.   c : the chart."""

    def rotate(self, x: Vec) -> Vec:
        """Transform x from body axes to the axes of the chart."""

    def rotate_back(self, x: Vec) -> Vec:
        """Transform x from the axes of the chart to body axes."""

    def fall(self, gravity: Vec) -> Vec:
        """Transform gravity from the axes of the chart to body axes."""

    def place(self, c: Chart) -> Vec:
        """Return the position, m."""

    def pose(self, c: Chart) -> Pose:
        """Return the pose, with a rotation matrix."""

    def moved(self, c: Chart) -> Chart:
        """Return the chart at the end of a step."""

    def rate(self, velocity: Vec) -> Vec:
        """Return twice the rate of the coordinates, from V, as the state has X/2 and Y."""


class Exponential(NamedTuple):
    """The increment is exp X.   charts : formulas of the group.   x : X/2.   k : at its angle."""

    charts: ModuleType
    x: Vec
    k: HalfAngleCoefficients

    @classmethod
    def of(cls, charts: ModuleType, x: Vec) -> Exponential:
        return cls(charts, x, quaternion.angle_coefficients(x))

    def rotate(self, x: Vec) -> Vec:
        return quaternion.rotate(self.x, x, self.k)

    def rotate_back(self, x: Vec) -> Vec:
        return quaternion.rotate(neg(self.x), x, self.k)

    def fall(self, gravity: Vec) -> Vec:
        return self.rotate_back(gravity)

    def place(self, c: Chart) -> Vec:
        return self.moved(c)[1]

    def pose(self, c: Chart) -> Pose:
        return self.charts.pose(self.moved(c))

    def moved(self, c: Chart) -> Chart:
        return self.charts.compose_exp(c, self.x, self.k)

    def rate(self, velocity: Vec) -> Vec:
        return self.charts.dexpinv(neg(self.x), velocity, self.k)


class Ambient(NamedTuple):
    """The increment is (1 + Y)/‖1 + Y‖.

    charts : formulas of the group.   y : Y.   twice : 2/‖u‖².
    """

    charts: ModuleType
    y: Vec
    twice: Any

    @classmethod
    def of(cls, charts: ModuleType, y: Vec) -> Ambient:
        return cls(charts, y, ambient.twice_inverse(y))

    def rotate(self, x: Vec) -> Vec:
        return ambient.rotate(self.y, x, self.twice)

    def rotate_back(self, x: Vec) -> Vec:
        return ambient.rotate_back(self.y, x, self.twice)

    def fall(self, gravity: Vec) -> Vec:
        return self.charts.fall(self.y, gravity)

    def place(self, c: Chart) -> Vec:
        return self.charts.place(c, self.y, self.twice)

    def pose(self, c: Chart) -> Pose:
        return ambient.turned(c[0], self.y), self.place(c)

    def moved(self, c: Chart) -> Chart:
        return self.charts.compose(c, self.y)

    def rate(self, velocity: Vec) -> Vec:
        return self.charts.rate(self.y, velocity)
