"""A rotation about one axis in SE(3) is stored as (c, s e), cosine and sine, for (w, v).

The functions are those of `quaternion`, with Y = X/2 for X, at half the operations.
"""

from __future__ import annotations

from typing import Any

from lierb.kernels.groups.coefficients import HalfAngleCoefficients
from lierb.kernels.groups.quaternion import Chart, Pose, angle_coefficients, dexpinv
from lierb.kernels.numbers.arithmetic import fma
from lierb.kernels.numbers.vec import IDENTITY, Mat, Vec, dot, norm, scale
from lierb.kernels.numbers.zero import is_zero

__all__ = ["axis_of", "compose_exp", "dexpinv", "from_pose", "matrix", "matrix_about", "pose"]


def axis_of(p: Vec) -> int:
    """Return the index of the axis e, the only component of s e that is not a structural zero."""
    (axis,) = (i for i in range(3) if not is_zero(p[1 + i]))
    return axis


def matrix_about(axis: int, cosine: Any, sine: Any) -> Mat:
    """Return the matrix of a rotation about an axis, from the cosine and sine of its angle."""
    i, j = (axis + 1) % 3, (axis + 2) % 3
    q = list(IDENTITY)
    q[4 * i] = q[4 * j] = cosine
    q[3 * j + i], q[3 * i + j] = sine, -sine
    return tuple(q)


def matrix(p: Vec) -> Mat:
    axis = axis_of(p)
    return matrix_about(axis, p[0], p[1 + axis])


def pose(c: Chart) -> Pose:
    return matrix(c[0]), c[1]


def from_pose(c: Pose, axis: int = 2) -> Chart:
    """Return the chart (c, s e) of a pose whose rotation is about `axis`, up to rounding."""
    i, j = (axis + 1) % 3, (axis + 2) % 3
    turn = c[0][4 * i], c[0][3 * j + i]
    cosine, sine = scale(1.0 / norm(turn), turn)
    return (cosine, *(sine if k == axis else 0.0 * sine for k in range(3))), c[1]


def compose_exp(c: Chart, y: Vec, k: HalfAngleCoefficients | None = None) -> Chart:
    """Update C exp 2Y; the rotation of `se3.exp` at X = 2Y is about the same axis."""
    k = k or angle_coefficients(y)
    (cosine, *rest), place = c
    axis = axis_of(c[0])
    s, less = k.sinc2 * y[axis], -(k.a4 * dot(y[:3], y[:3]))  # sin θ and cos θ − 1, θ = 2‖υ‖
    sine = rest[axis]
    moved = cosine + fma(cosine, less, -(sine * s)), sine + fma(sine, less, cosine * s)
    return (moved[0], *(moved[1] if i == axis else x for i, x in enumerate(rest))), place
