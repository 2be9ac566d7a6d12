"""SE(3) is the group of rigid motions.

C = (R, r), r in m; X = (ξ, η) and V = (ω, v), angular part first.

These are the paper's formulas. A step evaluates them on unit quaternions and X/2, in `quaternion`.
"""

from __future__ import annotations

from lierb.kernels.groups import so3
from lierb.kernels.groups.coefficients import Coefficients
from lierb.kernels.groups.so3 import angle_coefficients as _angle_coefficients
from lierb.kernels.numbers.vec import (
    ZERO3,
    Mat,
    Vec,
    axpy,
    cross,
    cross_add,
    dot,
    mat_vec,
    mat_vec_add,
    neg,
)

Pose = tuple[Mat, Vec]
identity: Pose = (so3.identity, ZERO3)


def angle_coefficients(x: Vec) -> Coefficients:
    """Return the coefficient functions at θ = ‖ξ‖, shared by the functions below."""
    return _angle_coefficients(x[:3])


def compose(c1: Pose, c2: Pose) -> Pose:
    """Return the product (R₁R₂, r₁ + R₁r₂).

    The chart C₀ of a run holds a quaternion for R, `quaternion.from_pose`, and a step updates it by
    `quaternion.compose_exp`.
    """
    return so3.compose(c1[0], c2[0]), mat_vec_add(c1[0], c2[1], c1[1])


def inverse(c: Pose) -> Pose:
    """Return the inverse (Rᵀ, −Rᵀr); the paper prints R for Rᵀ (errata E5)."""
    rt = so3.inverse(c[0])
    return rt, neg(mat_vec(rt, c[1]))


def exp(x: Vec, k: Coefficients | None = None) -> Pose:
    """Return the exponential (exp ξ, dexp_ξ η)  (Müller, eq. expX).

    A step evaluates C exp X by `quaternion.compose_exp`, and by `turns.compose_exp` if the node of
    a mechanism turns about one axis.
    """
    k = k or angle_coefficients(x)
    return so3.exp(x[:3], k), so3.dexp(x[:3], x[3:], k)


def log(c: Pose) -> Vec:
    """Return the X with exp X = C and ‖ξ‖ ≤ π; its sign at π as in `so3.log`."""
    xi = so3.log(c[0])
    return xi + so3.dexpinv(xi, c[1])


def Ad(c: Pose, x: Vec) -> Vec:
    """Return Ad_C X = (Rξ, r × Rξ + Rη), a body-fixed twist in the other frame.

    A mechanism evaluates Ad of the inverse of C, by `spatial.twist_at`.
    """
    xi = mat_vec(c[0], x[:3])
    return xi + cross_add(c[1], xi, mat_vec(c[0], x[3:]))


def ad(x: Vec, y: Vec) -> Vec:
    """Return the bracket [X, Y] = (ξ×ξ′, ξ×η′ + η×ξ′)  (Müller, eq. adse3)."""
    return cross(x[:3], y[:3]) + cross_add(x[:3], y[3:], cross(x[3:], y[:3]))


def dexp(x: Vec, v: Vec, k: Coefficients | None = None) -> Vec:
    """Apply the right-trivialised differential of exp, [[A, 0], [Q, A]].

    A is dexp of SO(3), and

    Q = a η̂ + b (η̂ξ̂ + ξ̂η̂) + (ξ·η)(a₁ ξ̂ + b₁ ξ̂²).
    """
    k = k or angle_coefficients(x)
    xi, eta = x[:3], x[3:]
    xw, ew, pitch = cross(xi, v[:3]), cross(eta, v[:3]), dot(xi, eta)
    xxw = cross(xi, xw)
    rate = axpy(k.b, xxw, axpy(k.a, xw, v[:3]))
    mixed = cross_add(eta, xw, cross(xi, ew))
    coupled = axpy(k.b, mixed, axpy(k.a, ew, so3.dexp(xi, v[3:], k)))
    return rate + axpy(pitch * k.b1, xxw, axpy(pitch * k.a1, xw, coupled))


def dexpinv(x: Vec, v: Vec, k: Coefficients | None = None) -> Vec:
    """Apply the inverse of dexp, [[B, 0], [U, B]].

    B is dexp⁻¹ of SO(3), ‖ξ‖ < 2π, and

    U = −½ η̂ + c₀ (η̂ξ̂ + ξ̂η̂) + (ξ·η) c₁ ξ̂².

    The paper's eq. dexpInvSE3Park prints γ = (2/θ) cot(θ/2) for (θ/2) cot(θ/2) (errata E1) and
    p/θ³ for p/θ² before ξ̂² (E2). A step evaluates `quaternion.dexpinv` on X/2.
    """
    k = k or angle_coefficients(x)
    xi, eta = x[:3], x[3:]
    xw, bracket = cross(xi, v[:3]), cross_add(eta, v[:3], cross(xi, v[3:]))
    xxw = cross(xi, xw)
    rate = axpy(k.c0, xxw, axpy(-0.5, xw, v[:3]))
    second = cross_add(eta, xw, cross(xi, bracket))
    coupled = axpy(k.c0, second, axpy(-0.5, bracket, v[3:]))
    return rate + axpy(dot(xi, eta) * k.c1, xxw, coupled)
