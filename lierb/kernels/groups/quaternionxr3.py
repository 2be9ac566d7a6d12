"""SO(3)×R³ with a unit quaternion for the rotation, and with X/2 as `quaternion` has it."""

from __future__ import annotations

from lierb.kernels.groups import quaternion
from lierb.kernels.groups.coefficients import HalfAngleCoefficients
from lierb.kernels.groups.quaternion import Chart
from lierb.kernels.numbers.vec import Vec, axpy


def compose_exp(c: Chart, y: Vec, k: HalfAngleCoefficients | None = None) -> Chart:
    """C exp 2Y."""
    return quaternion.turned(c[0], y[:3], k or quaternion.angle_coefficients(y)), axpy(
        2.0, y[3:], c[1]
    )


def dexpinv(y: Vec, v: Vec, k: HalfAngleCoefficients) -> Vec:
    """`so3xr3.dexpinv` at X = 2Y."""
    return quaternion.dexpinv_so3(y[:3], v[:3], k) + v[3:]
