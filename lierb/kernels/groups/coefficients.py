"""Scalar functions of θ², θ = ‖ξ‖, on which exp, dexp and dexp⁻¹ are built, and the angles' own.

    sinc = sin θ/θ     a = (1 − cos θ)/θ²      b = (θ − sin θ)/θ³
    a₁ = a′/θ          b₁ = b′/θ
    c₀ = (1 − (θ/2) cot(θ/2))/θ²               c₁ = c₀′/θ

Each form where it loses nothing: five Taylor terms below 0.1 rad and eight below 0.5 rad (a time
step's angles: RK4, and DOP853 or a spinning top); up to π the entire alternating series with
2a = sinc²(θ/2), c₀ = −a₁/(2a), c₁ = e/(2a); closed forms above. The usual test against a tiny ε
would be wrong: at θ = 1e-4 the closed forms of b₁ and c₁ are off by factors of 150 and 1900.
`tests/kernels/test_coefficients.py` measures the errors.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from fractions import Fraction
from math import factorial
from typing import Any, NamedTuple

from lierb.kernels.numbers.arithmetic import (
    PI,
    all_lanes,
    branch,
    floor,
    fma,
    minimum,
    rint,
    sqrt,
    where,
)
from lierb.kernels.numbers.arithmetic import absolute as abs_

TINY = 0.0215**2  # θ² up to which a time step makes do with three terms, and four of sinc
TINY_TERMS = 3
SMALL = 0.1**2  # θ² below which five terms are exact to 2⁻⁵³
MEDIUM = 0.5**2  # and eight
SERIES = PI**2  # θ² up to which the entire series is used
NAN = float("nan")
SINCOS_RANGE = 1e5  # rad, of `sincos`: beyond, reducing an angle loses digits, at 1e16 rad all


class Coefficients(NamedTuple):
    sinc: Any
    a: Any
    b: Any
    a1: Any
    b1: Any
    c0: Any
    c1: Any


def _alternating(terms: int, term: Any) -> tuple[float, ...]:
    return tuple(float((-1) ** k * Fraction(term(k))) for k in range(terms))


SINC_TERMS = _alternating(8, lambda k: Fraction(1, factorial(2 * k + 1)))
A_TERMS = _alternating(14, lambda k: Fraction(1, factorial(2 * k + 2)))
B_TERMS = _alternating(13, lambda k: Fraction(1, factorial(2 * k + 3)))
A1_TERMS = _alternating(13, lambda k: Fraction(-(2 * k + 2), factorial(2 * k + 4)))
B1_TERMS = _alternating(13, lambda k: Fraction(-(2 * k + 2), factorial(2 * k + 5)))
E_TERMS = _alternating(12, lambda k: Fraction(2 * k + 2, factorial(2 * k + 6)))  # e = 2a c₁

# c₀ = Σ |B₂ₖ₊₂| zᵏ/(2k+2)!, with the Bernoulli numbers |B₂| … |B₁₈|
_BERNOULLI = "1/6 1/30 1/42 1/30 5/66 691/2730 7/6 3617/510 43867/798".split()
_C0 = [Fraction(number) / factorial(2 * k + 2) for k, number in enumerate(_BERNOULLI)]
C0_TERMS = tuple(float(c) for c in _C0[:8])
C1_TERMS = tuple(float(2 * (k + 1) * c) for k, c in enumerate(_C0[1:]))


# 2 sinc, 4a, 8b, 4c₀ and 16c₁ at 2φ, as series in φ²
DOUBLE_ANGLE_TERMS = tuple(
    tuple(factor * 4.0**k * term for k, term in enumerate(terms))
    for factor, terms in (
        (2.0, SINC_TERMS), (4.0, A_TERMS), (8.0, B_TERMS), (4.0, C0_TERMS), (16.0, C1_TERMS)
    )
)  # fmt: skip


Cuts = tuple[tuple[Any, int], ...]  # a mask, and how many terms are taken where it holds


def horner(z: Any, terms: tuple[float, ...], cuts: Cuts = ()) -> Any:
    """Σ terms[k] zᵏ; where it is cut, to the bits of the shorter series."""
    total: Any = terms[-1]
    for k in range(len(terms) - 2, -1, -1):
        for mask, count in cuts:
            if count == k + 1:
                total = where(mask, 0.0, total)
        total = fma(z, total, terms[k])
    return total


def coefficients(z: Any) -> Coefficients:
    """All coefficient functions at z = θ²; c₀ and c₁ have a pole at θ = 2π.

    A caller takes what it needs: what is left over is dropped when the formula is compiled.
    """
    return Coefficients(*_anywhere(z, 1.0, _taylor, _long))


class HalfAngleCoefficients(NamedTuple):
    """Functions of φ = θ/2, on which formulas of ξ/2 are built."""

    cos_minus_1: Any  # cos φ − 1
    sinc: Any  # sinc φ
    sinc2: Any  # 2 sinc θ
    a4: Any  # 4 a(θ)
    b8: Any  # 8 b(θ)
    c04: Any  # 4 c₀(θ)
    c116: Any  # 16 c₁(θ)


def half_angle_coefficients(z: Any) -> HalfAngleCoefficients:
    """For a time step, in which φ² = z is small: what they multiply there is smaller still.

    Up to θ = 0.0215 rad three terms, and four of sinc θ, leave out less than 2⁻⁵⁴ of exp X and
    dexp⁻¹ V, though a coefficient itself may be off by 3e-15. Beyond SINCOS_RANGE they are NaN:
    what such a step leads to is seen to be no motion.
    """
    tiny = z <= 0.25 * TINY
    if taken_for_granted(tiny):
        return HalfAngleCoefficients(*_half_taylor(z, TINY_TERMS, ()))

    def within_range(z: Any) -> tuple[Any, ...]:
        return _half_long(where(z <= 0.25 * SINCOS_RANGE**2, z, NAN))

    found: tuple[Any, ...] = branch(
        all_lanes(tiny),
        lambda: _half_taylor(z, TINY_TERMS, ()),
        lambda: _anywhere(z, 0.25, _half_taylor, within_range, ((tiny, TINY_TERMS),)),
    )
    return HalfAngleCoefficients(*found)


_conditions: ContextVar[list[Any] | None] = ContextVar("conditions", default=None)


@contextmanager
def angles_taken_for_tiny() -> Iterator[list[Any]]:
    """Here, a time step's angles are all as small as its short series ask for, with no branch.

    Gives the conditions for that, a mask for each angle: where they hold, the bits are the same.
    """
    conditions: list[Any] = []
    token = _conditions.set(conditions)
    try:
        yield conditions
    finally:
        _conditions.reset(token)


def taken_for_granted(condition: Any) -> bool:
    """Whether a formula may take it that a mask holds in all lanes: it is looked at afterwards."""
    conditions = _conditions.get()
    if conditions is None:
        return False
    conditions.append(condition)
    return True


Taylor = Callable[[Any, int, Cuts], tuple[Any, ...]]  # of z, so many terms or, where cut, fewer
Beyond = Callable[[Any], tuple[Any, ...]]


def _anywhere(
    z: Any, share: float, taylor: Taylor, beyond: Beyond, cuts: Cuts = ()
) -> tuple[Any, ...]:
    small = z < share * SMALL

    def beyond_small() -> Any:
        medium = z < share * MEDIUM
        series = taylor(z, 8, (*cuts, (small, 5)))
        return branch(all_lanes(medium), lambda: series, lambda: where(medium, series, beyond(z)))

    found: tuple[Any, ...] = branch(all_lanes(small), lambda: taylor(z, 5, cuts), beyond_small)
    return found


def _taylor(z: Any, terms: int, cuts: Cuts) -> tuple[Any, ...]:
    series = (A_TERMS, B_TERMS, A1_TERMS, B1_TERMS, C0_TERMS, C1_TERMS)
    return (
        _sinc_series(z, SINC_TERMS, terms, cuts),
        *(horner(z, every[:terms], cuts) for every in series),
    )


def _half_taylor(z: Any, terms: int, cuts: Cuts) -> tuple[Any, ...]:
    sinc2, *series = DOUBLE_ANGLE_TERMS
    return (
        -(z * horner(z, A_TERMS[:terms], cuts)),
        horner(z, SINC_TERMS[:terms], cuts),
        _sinc_series(z, sinc2, terms, cuts),
        *(horner(z, every[:terms], cuts) for every in series),
    )


def _sinc_series(z: Any, series: tuple[float, ...], terms: int, cuts: Cuts) -> Any:
    """Of θ: a term more than the others for tiny angles."""

    def taken(terms: int) -> int:
        return terms + (terms == TINY_TERMS)

    return horner(z, series[: taken(terms)], tuple((mask, taken(n)) for mask, n in cuts))


def _long(z: Any) -> tuple[Any, ...]:
    # Each form is fed arguments it can bear, the other's lanes are thrown away; NaN stays NaN.
    below = z < SERIES
    return where(below, _entire(minimum(z, SERIES)), _closed(where(below, SERIES, z)))


def _half_long(z: Any) -> tuple[Any, ...]:
    half, whole = Coefficients(*_long(z)), Coefficients(*_long(4.0 * z))
    return (
        -(z * half.a), half.sinc, 2.0 * whole.sinc, 4.0 * whole.a, 8.0 * whole.b, 4.0 * whole.c0,
        16.0 * whole.c1,
    )  # fmt: skip


def _entire(z: Any) -> tuple[Any, ...]:
    a, b = horner(z, A_TERMS), horner(z, B_TERMS)
    a1, b1 = horner(z, A1_TERMS), horner(z, B1_TERMS)
    half_inverse = 0.5 / a
    return (1.0 - z * b, a, b, a1, b1, -a1 * half_inverse, horner(z, E_TERMS) * half_inverse)


def _closed(z: Any) -> tuple[Any, ...]:
    theta = sqrt(z)
    s, c = sincos(0.5 * theta)
    sinc = 2.0 * s * c / theta
    a2 = 4.0 * s * s / z  # 2a; 1 − cos θ = 2 sin²(θ/2) does not cancel
    a = 0.5 * a2
    b = (1.0 - sinc) / z
    a1 = (sinc - a2) / z
    b1 = (a - 3.0 * b) / z
    c0 = (a2 - sinc) / (a2 * z)
    c1 = (1.0 + sinc - 2.0 * a2) / (a2 * z * z)
    return (sinc, a, b, a1, b1, c0, c1)


# ---- trigonometric functions on every number type ----------------------------------------------
# Kernel and reduction constants as in FreeBSD msun (k_sin.c, k_cos.c, e_rem_pio2.c, s_atan.c).

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


def sincos(x: Any) -> tuple[Any, Any]:
    """sin x and cos x for |x| ≤ SINCOS_RANGE, by Cody–Waite reduction to [−π/4, π/4]."""
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


def atan2(y: Any, x: Any) -> Any:
    """Angle of (x, y) in [−π, π] rad; 0 at the origin."""
    ax, ay = abs_(x), abs_(y)
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
