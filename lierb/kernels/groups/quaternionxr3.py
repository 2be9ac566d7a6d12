"""SO(3)×R³ is stored with a unit quaternion for the rotation and Y = X/2, as in `quaternion`."""

from __future__ import annotations

from lierb.kernels.groups import quaternion
from lierb.kernels.groups.coefficients import HalfAngleCoefficients
from lierb.kernels.groups.quaternion import Chart, pose
from lierb.kernels.numbers.vec import Vec, axpy

__all__ = ["compose_exp", "dexpinv", "pose"]


def compose_exp(c: Chart, y: Vec, k: HalfAngleCoefficients | None = None) -> Chart:
    """Update C exp 2Y, the product `so3xr3.compose` with `so3xr3.exp` at X = 2Y."""
    k = k or quaternion.angle_coefficients(y)
    return quaternion.turned(c[0], y[:3], k), axpy(2.0, y[3:], c[1])


def dexpinv(y: Vec, v: Vec, k: HalfAngleCoefficients) -> Vec:
    """Evaluate `so3xr3.dexpinv` at X = 2Y."""
    return quaternion.dexpinv_so3(y[:3], v[:3], k) + v[3:]
