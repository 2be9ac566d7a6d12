"""SO(3)×R³ is the direct product of rotations and translations.

C = (R, r); X = (ξ, η) and V = (ω, ṙ), angular part first.

Rotation and translation are independent, as with rotation parameters and a position vector. A step
evaluates these formulas on unit quaternions, in `quaternionxr3`.
"""

from __future__ import annotations

from lierb.kernels.groups import so3
from lierb.kernels.groups.coefficients import Coefficients
from lierb.kernels.groups.so3 import angle_coefficients as _angle_coefficients
from lierb.kernels.numbers.vec import ZERO3, Mat, Vec, add, cross, mat_vec, neg

Pose = tuple[Mat, Vec]
identity: Pose = (so3.identity, ZERO3)


def angle_coefficients(x: Vec) -> Coefficients:
    """Return the coefficient functions at θ = ‖ξ‖, shared by the functions below."""
    return _angle_coefficients(x[:3])


def compose(c1: Pose, c2: Pose) -> Pose:
    """Return the product (R₁R₂, r₁ + r₂)  (Müller, eq. MultDirectProduct).

    A step updates the chart by `quaternionxr3.compose_exp`.
    """
    return so3.compose(c1[0], c2[0]), add(c1[1], c2[1])


def inverse(c: Pose) -> Pose:
    """Return the inverse (Rᵀ, −r)."""
    return so3.inverse(c[0]), neg(c[1])


def exp(x: Vec, k: Coefficients | None = None) -> Pose:
    """Return the exponential (exp ξ, η)  (Müller, eq. expSO3xR3).

    A step evaluates C exp X by `quaternionxr3.compose_exp`.
    """
    return so3.exp(x[:3], k), x[3:]


def log(c: Pose) -> Vec:
    """Return the X with exp X = C and ‖ξ‖ ≤ π; its sign at π as in `so3.log`."""
    return so3.log(c[0]) + c[1]


def Ad(c: Pose, x: Vec) -> Vec:
    """Return Ad_C X = (Rξ, η)."""
    return mat_vec(c[0], x[:3]) + x[3:]


def ad(x: Vec, y: Vec) -> Vec:
    """Return the bracket [X, Y] = (ξ×ξ′, 0)  (Müller, eq. adSO3R3)."""
    return cross(x[:3], y[:3]) + ZERO3


def dexp(x: Vec, v: Vec, k: Coefficients | None = None) -> Vec:
    """Apply the right-trivialised differential of exp.

    It is diag(dexp_ξ, I)  (Müller, eq. dexpSO3xR3).
    """
    return so3.dexp(x[:3], v[:3], k) + v[3:]


def dexpinv(x: Vec, v: Vec, k: Coefficients | None = None) -> Vec:
    """Apply the inverse of dexp, diag(dexp⁻¹_ξ, I), ‖ξ‖ < 2π.

    A step evaluates `quaternionxr3.dexpinv` on X/2.
    """
    return so3.dexpinv(x[:3], v[:3], k) + v[3:]
