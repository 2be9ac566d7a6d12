"""SO(3) is the rotation group.

R: 9 entries row by row; ξ, ω: 3 components, rad and rad/s.

These are the paper's formulas. A step evaluates them on unit quaternions, in `quaternion`.
"""

from __future__ import annotations

from typing import Any

from lierb.kernels.groups.coefficients import Coefficients, coefficients
from lierb.kernels.numbers.arithmetic import fma, where
from lierb.kernels.numbers.trigonometry import atan2
from lierb.kernels.numbers.vec import (
    IDENTITY,
    Mat,
    Vec,
    add,
    axpy,
    cross,
    dot,
    mat_mat,
    mat_t_mat,
    mat_vec,
    neg,
    norm,
    scale,
    transpose,
)

identity: Mat = IDENTITY


def angle_coefficients(xi: Vec) -> Coefficients:
    """Return the coefficient functions at θ = ‖ξ‖, shared by the functions below."""
    return coefficients(dot(xi, xi))


def compose(r1: Mat, r2: Mat) -> Mat:
    """Return R₁ R₂."""
    return mat_mat(r1, r2)


def inverse(r: Mat) -> Mat:
    """Return R⁻¹ = Rᵀ."""
    return transpose(r)


def exp(xi: Vec, k: Coefficients | None = None) -> Mat:
    """Return the rotation by ‖ξ‖ about ξ: I + sinc ξ̂ + a ξ̂² (Rodrigues).

    A step evaluates R exp ξ by `quaternion.turned`.
    """
    return add(IDENTITY, _exp_minus_identity(xi, k or angle_coefficients(xi)))


def _exp_minus_identity(xi: Vec, k: Coefficients) -> Mat:
    """Return sinc ξ̂ + a ξ̂²."""
    x, y, z = xi
    ax, ay, az = scale(k.a, xi)
    sx, sy, sz = scale(k.sinc, xi)
    yy, zz = ay * y, az * z
    return (
        -fma(ay, y, zz), fma(ax, y, -sz), fma(ax, z, sy),
        fma(ax, y, sz), -fma(ax, x, zz), fma(ay, z, -sx),
        fma(ax, z, -sy), fma(ay, z, sx), -fma(ax, x, yy),
    )  # fmt: skip


def orthonormalised(q: Mat) -> Mat:
    """Return the rotation nearest to a Q with rounding errors: Q (3 I − QᵀQ)/2.

    A run applies `quaternion.normalised` to the quaternion instead.
    """
    gram = mat_t_mat(q, q)
    return mat_mat(q, tuple(1.5 - 0.5 * g if i % 4 == 0 else -0.5 * g for i, g in enumerate(gram)))


def quaternion(r: Mat) -> tuple[Any, ...]:
    """Return the quaternion (w, x, y, z) of a rotation with w ≥ 0, of any length.

    The largest component is computed first, so that no digits cancel at any angle.
    """
    # 4 q² for each component; the largest is at least 1
    w2, x2 = 1.0 + r[0] + r[4] + r[8], 1.0 + r[0] - r[4] - r[8]
    y2, z2 = 1.0 - r[0] + r[4] - r[8], 1.0 - r[0] - r[4] + r[8]
    wx, wy, wz = r[7] - r[5], r[2] - r[6], r[3] - r[1]
    xy, xz, yz = r[1] + r[3], r[2] + r[6], r[5] + r[7]
    q = where(r[4] >= r[8], (wy, xy, y2, yz), (wz, xz, yz, z2))
    q = where((r[0] >= r[4]) & (r[0] >= r[8]), (wx, x2, xy, xz), q)
    q = where((w2 >= x2) & (w2 >= y2) & (w2 >= z2), (w2, wx, wy, wz), q)
    return where(q[0] < 0.0, neg(q), q)


def log(r: Mat) -> Vec:
    """Return the ξ with exp ξ = R and ‖ξ‖ ≤ π.

    At ‖ξ‖ = π, where ξ and −ξ give the same R, the largest component of ξ by size is positive (the
    first of several equal ones).
    """
    q = quaternion(r)
    n = norm(q[1:])
    is_identity = n == 0.0  # derivatives need the limit there
    limit = 2.0 / where(is_identity, q[0], 1.0)
    quotient = 2.0 * atan2(n, q[0]) / where(is_identity, 1.0, n)
    return scale(where(is_identity, limit, quotient), q[1:])


def Ad(r: Mat, x: Vec) -> Vec:
    """Return Ad_R x = R x."""
    return mat_vec(r, x)


def ad(x: Vec, y: Vec) -> Vec:
    """Return [x, y] = x × y."""
    return cross(x, y)


def dexp(xi: Vec, w: Vec, k: Coefficients | None = None) -> Vec:
    """Apply the right-trivialised differential of exp.

    It is w + a ξ×w + b ξ×(ξ×w)  (Müller, eq. dexpSO3).
    """
    k = k or angle_coefficients(xi)
    xw = cross(xi, w)
    return axpy(k.b, cross(xi, xw), axpy(k.a, xw, w))


def dexpinv(xi: Vec, w: Vec, k: Coefficients | None = None) -> Vec:
    """Apply the inverse of dexp: w − ½ ξ×w + c₀ ξ×(ξ×w), ‖ξ‖ < 2π  (Müller, eq. dexpInvSO3).

    A step evaluates `quaternion.dexpinv_so3` on ξ/2.
    """
    k = k or angle_coefficients(xi)
    xw = cross(xi, w)
    return axpy(k.c0, cross(xi, xw), axpy(-0.5, xw, w))
