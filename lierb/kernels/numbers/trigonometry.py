"""Compute sin, cos and atan2 of every kind of number.

Kernel and reduction constants as in FreeBSD msun (k_sin.c, k_cos.c, e_rem_pio2.c, s_atan.c).
"""

from __future__ import annotations

from typing import Any

from lierb.kernels.numbers.arithmetic import (
    PI,
    absolute,
    floor,
    fma,
    horner,
    overridable,
    rint,
    where,
)
from lierb.kernels.numbers.number import Number

SINCOS_RANGE = 1e5  # rad; above it the reduction to [−π/4, π/4] loses digits, all at 1e16 rad
_SIN = (
    -1.66666666666666324348e-01,
    8.33333333332248946124e-03,
    -1.98412698298579493134e-04,
    2.75573137070700676789e-06,
    -2.50507602534068634195e-08,
    1.58969099521155010221e-10,
)
_COS = (
    4.16666666666666019037e-02,
    -1.38888888888741095749e-03,
    2.48015872894767294178e-05,
    -2.75573143513906633035e-07,
    2.08757232129817482790e-09,
    -1.13596475577881948265e-11,
)
_ATAN = (
    3.33333333333329318027e-01,
    -1.99999999998764832476e-01,
    1.42857142725034663711e-01,
    -1.11111104054623557880e-01,
    9.09088713343650656196e-02,
    -7.69187620504482999495e-02,
    6.66107313738753120669e-02,
    -5.83357013379057348645e-02,
    4.97687799461593236017e-02,
    -3.65315727442169155270e-02,
    1.62858201153657823623e-02,
)
_HALF_PI = (1.57079632673412561417e00, 6.07710050630396597660e-11, 2.02226624879595063154e-21)
_TAN_PI_8 = 0.41421356237309503


@overridable
def sincos(x: Number) -> tuple[Any, Any]:
    """Return sin x and cos x, |x| ≤ SINCOS_RANGE, by Cody–Waite reduction to [−π/4, π/4]."""
    quarters = rint(x * (2.0 / PI))
    y = x
    for part in _HALF_PI:
        y = fma(-quarters, part, y)
    z = y * y
    s = fma(y * z, horner(z, _SIN), y)
    c = fma(z * z, horner(z, _COS), fma(-0.5, z, 1.0))
    quadrant = quarters - 4.0 * floor(quarters * 0.25)
    odd = (quadrant == 1.0) | (quadrant == 3.0)
    sine, cosine = where(odd, (c, s), (s, c))
    return (
        where(quadrant >= 2.0, -sine, sine),
        where((quadrant == 1.0) | (quadrant == 2.0), -cosine, cosine),
    )


@overridable
def atan2(y: Number, x: Number) -> Any:
    """Return the angle of (x, y) in [−π, π] rad; 0 at the origin."""
    ax, ay = absolute(x), absolute(y)
    steep = ay > ax
    low, high = where(steep, (ax, ay), (ay, ax))
    far = low > _TAN_PI_8 * high  # then atan t = π/4 + atan((t − 1)/(t + 1))
    top, bottom = where(far, (low - high, low + high), (low, high))
    t = top / where(bottom == 0.0, 1.0, bottom)
    z = t * t
    angle = fma(-(t * z), horner(z, _ATAN), t) + where(far, 0.25 * PI, 0.0)
    angle = where(steep, 0.5 * PI - angle, angle)
    angle = where(x < 0.0, PI - angle, angle)
    return where(y < 0.0, -angle, angle)
