"""A step evaluates the formulas of `se3` with a unit quaternion for the rotation.

C = (p, r) with p = (w, v) of unit length; p and −p are the same rotation, R(p). A vector X = (ξ, η)
of the algebra is stored as Y = (υ, ν) = X/2: exp ξ = R(cos φ, sinc φ υ) with φ = ‖υ‖ = θ/2. Hence a
step takes fewer operations than with matrices and X.
"""

from __future__ import annotations

from typing import Any

from lierb.kernels.groups import so3
from lierb.kernels.groups.coefficients import HalfAngleCoefficients, half_angle_coefficients
from lierb.kernels.numbers.arithmetic import fma
from lierb.kernels.numbers.vec import Mat, Vec, add, axpy, cross, cross_add, dot, neg, norm, scale

Pose = tuple[Mat, Vec]
Quaternion = tuple[Any, ...]
Chart = tuple[Quaternion, Vec]


def of_matrix(r: Mat) -> Quaternion:
    """Return the unit quaternion p of a rotation, with w ≥ 0."""
    p = so3.quaternion(r)
    return scale(1.0 / norm(p), p)


def from_pose(c: Pose) -> Chart:
    """Return the chart (p, r) of the pose (R, r), an element of `se3.compose`'s group."""
    return of_matrix(c[0]), c[1]


def pose(c: Chart) -> Pose:
    return matrix(c[0]), c[1]


def matrix(p: Quaternion, twice: Any = None) -> Mat:
    """Return the matrix R(p), a rotation even if p is not of unit length due to rounding.

    twice : 2/‖p‖², for a p of any length.
    """
    _, x, y, z = p
    w2, x2, y2, z2 = scale(fma(-2.0, dot(p, p), 4.0) if twice is None else twice, p)
    yy, zz = y2 * y, z2 * z
    return (
        1.0 - (yy + zz), fma(x2, y, -(w2 * z)), fma(x2, z, w2 * y),
        fma(x2, y, w2 * z), 1.0 - fma(x2, x, zz), fma(y2, z, -(w2 * x)),
        fma(x2, z, -(w2 * y)), fma(y2, z, w2 * x), 1.0 - fma(x2, x, yy),
    )  # fmt: skip


def normalised(p: Quaternion) -> Quaternion:
    """Return the unit quaternion nearest to a p with rounding errors.

    `so3.orthonormalised` does the same for R.

    The correction is added to p. A product with a factor near 1 would round p, and hence its axis,
    once more, in the same direction in each step.
    """
    return axpy(0.5 - 0.5 * dot(p, p), p, p)


def product(p: Quaternion, x: Vec) -> Quaternion:
    """Return the quaternion product p (0, x)."""
    w, v = p[0], p[1:]
    return (-dot(v, x), *cross_add(v, x, scale(w, x)))


def rotated(p: Quaternion, x: Vec) -> Vec:
    """Return R(p) x = x + 2w v×x + 2 v×(v×x), without the matrix."""
    w, v = p[0], p[1:]
    twice = cross(v, add(x, x))
    return cross_add(v, twice, axpy(w, twice, x))


def rotated_back(p: Quaternion, x: Vec) -> Vec:
    """Return R(p)ᵀ x."""
    return rotated((p[0], *neg(p[1:])), x)


def angle_coefficients(y: Vec) -> HalfAngleCoefficients:
    """Return the coefficient functions at φ = ‖υ‖, shared by the functions below."""
    return half_angle_coefficients(dot(y[:3], y[:3]))


def rotate(y: Vec, x: Vec, k: HalfAngleCoefficients) -> Vec:
    """Return exp(ξ) x = x + 2 sinc θ υ×x + 4a υ×(υ×x)."""
    turned = cross(y[:3], x)
    return axpy(k.a4, cross(y[:3], turned), axpy(k.sinc2, turned, x))


def compose_exp(c: Chart, y: Vec, k: HalfAngleCoefficients | None = None) -> Chart:
    """Update C exp 2Y, the product `se3.compose` with `se3.exp` at X = 2Y.

    The quaternion is computed as p + p (exp υ − 1), so that its rounding is small if υ is.
    """
    k = k or angle_coefficients(y)
    (p, r), upsilon, nu = c, y[:3], y[3:]
    swung = cross(upsilon, nu)
    moved = axpy(k.b8, cross(upsilon, swung), axpy(k.a4, swung, add(nu, nu)))  # dexp_ξ η
    return turned(p, upsilon, k), add(r, rotated(p, moved))


def turned(p: Quaternion, upsilon: Vec, k: HalfAngleCoefficients) -> Quaternion:
    """Return p exp υ, the rotation R(p) times `so3.exp` of ξ = 2υ."""
    return axpy(k.sinc, product(p, upsilon), axpy(k.cos_minus_1, p, p))


def dexpinv_so3(upsilon: Vec, omega: Vec, k: HalfAngleCoefficients) -> Vec:
    """Evaluate `so3.dexpinv` at ξ = 2υ."""
    first = tuple(fma(k.c04, x, -w) for x, w in zip(cross(upsilon, omega), omega, strict=True))
    return cross_add(upsilon, first, omega)


def dexpinv(y: Vec, v: Vec, k: HalfAngleCoefficients) -> Vec:
    """Evaluate `se3.dexpinv` at X = 2Y.

    The terms with −½ and c₀ share their last cross product, which saves a sum.
    """
    upsilon, nu, omega, slide = y[:3], y[3:], v[:3], v[3:]
    swung, bracket = cross(upsilon, omega), cross_add(nu, omega, cross(upsilon, slide))
    pitch = dot(upsilon, nu) * k.c116
    first = tuple(fma(k.c04, x, -w) for x, w in zip(swung, omega, strict=True))
    second = axpy(
        pitch, swung, tuple(fma(k.c04, x, -w) for x, w in zip(bracket, slide, strict=True))
    )
    coupled = cross_add(upsilon, second, cross_add(nu, first, slide))
    return cross_add(upsilon, first, omega) + coupled
