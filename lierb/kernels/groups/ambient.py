"""An ambient update of SE(3) works in the algebra of dual quaternions.

The motion since the chart C₀ is a dual quaternion 1 + Y = u + ε w, which need not be of unit
length. Its rate is linear in it, Ẏ = ½ (1 + Y) V, so that a step needs neither exp nor dexp⁻¹. The
pose is that of C₀ (1 + Y)/‖1 + Y‖.

Y has eight numbers: u − 1, scalar part first, then w.
"""

from __future__ import annotations

from typing import Any

from lierb.kernels.groups.quaternion import Chart, Quaternion, matrix, product, rotated
from lierb.kernels.numbers.arithmetic import absolute, all_lanes, branch, fma, horner, sqrt, where
from lierb.kernels.numbers.number import Number
from lierb.kernels.numbers.trigonometry import SINCOS_RANGE
from lierb.kernels.numbers.vec import Mat, Vec, add, axpy, cross, cross_add, dot, neg, scale
from lierb.kernels.numbers.zero import is_zero

WIDTH = 8  # numbers of Y
# 1/√(1 + e) − 1 = e Σ terms[k] eᵏ. The terms left out add less than 2⁻⁵² |e|.
TERMS = (-1 / 2, 3 / 8, -5 / 16, 35 / 128, -63 / 256)
TINY, TINY_TERMS = 5e-6, 3  # largest |e| and terms; RK4 turns by up to 0.5 rad in such a step
SHORT = 1e-3
NAN = float("nan")


def rate(y: Vec, v: Vec) -> Vec:
    """Return 2Ẏ = (1 + Y) V.   v : (ω, v)."""
    u, omega, slide = turn_of(y), v[:3], v[3:]
    return product(u, omega) + add(product(u, slide), product(y[4:], omega))


def turn_of(y: Vec) -> Quaternion:
    """Return the quaternion u, of any length."""
    return (1.0 + y[0], *y[1:4])


def twice_inverse(y: Vec) -> Any:
    """Return 2/‖u‖²."""
    if is_zero(*y[:4]):
        return 2.0
    u = turn_of(y)
    return 2.0 / dot(u, u)


def rotate(y: Vec, x: Vec, twice: Any) -> Vec:
    """Return x + s (w v×x + v×(v×x)), with u = (w, v).

    twice : s. With 2/‖u‖² it is a rotation; with 2 it is a smooth extension of that to all u.
    """
    v, turned = y[1:4], cross(y[1:4], scale(twice, x))
    return cross_add(v, turned, axpy(1.0 + y[0], turned, x))


def rotate_back(y: Vec, x: Vec, twice: Any) -> Vec:
    """Return the transpose of `rotate`, applied to x."""
    return rotate((y[0], *neg(y[1:4])), x, twice)


def fall(y: Vec, gravity: Vec) -> Vec:
    """Return gravity in body axes, by the smooth extension of the rotation.

    A division for each stage would take a tenth of a spherical joint's step.
    """
    return rotate_back(y, gravity, 2.0)


def place(c: Chart, y: Vec, twice: Any) -> Vec:
    """Return the position d of C₀ (1 + Y)/‖1 + Y‖.   twice : 2/‖u‖²."""
    return add(c[1], rotated(c[0], scale(twice, _displacement(y))))


def _displacement(y: Vec) -> Vec:
    """Return the vector part of w ū, which is ‖u‖²/2 times the displacement."""
    v, w = y[1:4], y[5:]
    return cross_add(v, w, axpy(-y[4], v, scale(1.0 + y[0], w)))


def turned(p: Quaternion, y: Vec) -> Mat:
    """Return the matrix of the rotation p u/‖u‖ at a stage."""
    if is_zero(*y[:4]):
        return matrix(p)
    moved = composed(p, y[:4])
    return matrix(moved, 2.0 / dot(moved, moved))


def composed(p: Quaternion, y: Vec) -> Quaternion:
    """Return p + p (u − 1), whose rounding is small if u − 1 is.   y : u − 1."""
    return add(product(p, y[1:]), axpy(y[0], p, p))


def compose(c: Chart, y: Vec) -> Chart:
    """Update C₀ (1 + Y)/‖1 + Y‖ at the end of a step."""
    p, twice = normalised(c[0], y[:4])
    return p, place(c, y, twice)


def normalised(p: Quaternion, y: Vec) -> tuple[Quaternion, Any]:
    """Return p u/‖u‖, and 2/‖u‖².   y : u − 1."""
    if is_zero(*y):
        return p, 2.0
    # ‖u‖² − 1, in an order that waits for few operations
    excess = fma(y[0], 2.0 + y[0], y[1] * y[1]) + fma(y[2], y[2], y[3] * y[3])
    less = shrinking(excess)
    inverse = 1.0 + less
    return composed(p, axpy(less, (1.0 + y[0], *y[1:]), y)), 2.0 * (inverse * inverse)


def shrinking(e: Number) -> Any:
    """Return 1/√(1 + e) − 1; NaN for steps of about 10⁵ rad and more, which a run reports."""
    size = absolute(e)
    is_tiny, is_short = size <= TINY, size <= SHORT

    def beyond() -> Any:
        series = e * horner(e, TERMS, ((is_tiny, TINY_TERMS),))

        def anywhere() -> Any:
            exact = 1.0 / sqrt(1.0 + e) - 1.0
            return where(is_short, series, where(e <= 0.25 * SINCOS_RANGE**2, exact, NAN))

        return branch(all_lanes(is_short), lambda: series, anywhere)

    return branch(all_lanes(is_tiny), lambda: e * horner(e, TERMS[:TINY_TERMS]), beyond)
