"""The formulas of exp, dexp and dexp⁻¹ need these scalar functions of θ², θ = ‖ξ‖.

    sinc = sin θ/θ     a = (1 − cos θ)/θ²      b = (θ − sin θ)/θ³
    a₁ = a′/θ          b₁ = b′/θ
    c₀ = (1 − (θ/2) cot(θ/2))/θ²               c₁ = c₀′/θ

Each form is used where it loses no digits:

    θ < 0.1 rad     five Taylor terms (angles in a step of RK4)
    θ < 0.75 rad    eight Taylor terms (angles in a step of DOP853 or of a spinning top)
    θ ≤ π           entire alternating series, with 2a = sinc²(θ/2), c₀ = −a₁/(2a), c₁ = e/(2a)
    θ > π           closed forms

A cut-over at a tiny angle fails: at θ = 1e-4 the closed forms of b₁ and c₁ are off by factors of
150 and 1900.
`tests/kernels/test_coefficients.py` measures the errors.
"""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from math import factorial
from typing import NamedTuple

from lierb.kernels.numbers.arithmetic import (
    PI,
    Cuts,
    all_lanes,
    apart,
    branch,
    fma,
    horner,
    minimum,
    sqrt,
    taken_for_granted,
    where,
)
from lierb.kernels.numbers.dual import by_chain_rule
from lierb.kernels.numbers.number import Number
from lierb.kernels.numbers.trigonometry import SINCOS_RANGE, sincos
from lierb.kernels.numbers.vec import Vec

TINY = 0.0215**2  # θ² up to which a time step needs three terms, four for sinc
TINY_TERMS = 3
SMALL = 0.1**2  # θ² below which five terms suffice to 2⁻⁵³
MEDIUM = 0.75**2  # eight terms; nine and ten for c₀ and c₁, which have a pole
MEDIUM_TERMS = 8
SERIES = PI**2  # θ² up to which the entire series is used
NAN = float("nan")


class Coefficients(NamedTuple):
    sinc: Number
    a: Number
    b: Number
    a1: Number
    b1: Number
    c0: Number
    c1: Number


def _alternating(terms: int, term: Callable[[int], Fraction]) -> tuple[float, ...]:
    return tuple(float((-1) ** k * Fraction(term(k))) for k in range(terms))


SINC_TERMS = _alternating(8, lambda k: Fraction(1, factorial(2 * k + 1)))
A_TERMS = _alternating(14, lambda k: Fraction(1, factorial(2 * k + 2)))
B_TERMS = _alternating(13, lambda k: Fraction(1, factorial(2 * k + 3)))
A1_TERMS = _alternating(13, lambda k: Fraction(-(2 * k + 2), factorial(2 * k + 4)))
B1_TERMS = _alternating(13, lambda k: Fraction(-(2 * k + 2), factorial(2 * k + 5)))
E_TERMS = _alternating(12, lambda k: Fraction(2 * k + 2, factorial(2 * k + 6)))  # e = 2a c₁

# c₀ = Σ |B₂ₖ₊₂| zᵏ/(2k+2)!, with the Bernoulli numbers |B₂| … |B₂₂|
_BERNOULLI = "1/6 1/30 1/42 1/30 5/66 691/2730 7/6 3617/510 43867/798 174611/330 854513/138".split()
_C0 = [Fraction(number) / factorial(2 * k + 2) for k, number in enumerate(_BERNOULLI)]
C0_TERMS = tuple(float(c) for c in _C0[:9])
C1_TERMS = tuple(float(2 * (k + 1) * c) for k, c in enumerate(_C0[1:]))

# (sinc φ − cos φ)/φ², and 16e at 2φ, as series in φ² for φ ≤ π/2
G_TERMS = _alternating(10, lambda k: Fraction(2 * k + 2, factorial(2 * k + 3)))
HALF_E_TERMS = tuple(16.0 * 4.0**k * term for k, term in enumerate(E_TERMS))

# 2 sinc, 4a, 8b, 4c₀ and 16c₁ at 2φ, as series in φ²
DOUBLE_ANGLE_TERMS = tuple(
    tuple(factor * 4.0**k * term for k, term in enumerate(terms))
    for factor, terms in (
        (2.0, SINC_TERMS), (4.0, A_TERMS), (8.0, B_TERMS), (4.0, C0_TERMS), (16.0, C1_TERMS)
    )
)  # fmt: skip


def coefficients(z: Number) -> Coefficients:
    """Coefficient functions at z = θ²; c₀ and c₁ have a pole at θ = 2π.

    A compiled formula evaluates only the functions that it uses.
    """
    return Coefficients(*_anywhere(z, 1.0, _taylor, _long))


class HalfAngleCoefficients(NamedTuple):
    """Hold the coefficient functions of φ = θ/2, for formulas in ξ/2."""

    cos_minus_1: Number  # cos φ − 1
    sinc: Number  # sinc φ
    sinc2: Number  # 2 sinc θ
    a4: Number  # 4 a(θ)
    b8: Number  # 8 b(θ)
    c04: Number  # 4 c₀(θ)
    c116: Number  # 16 c₁(θ)


@by_chain_rule
def half_angle_coefficients(z: Number) -> HalfAngleCoefficients:
    """Return the coefficient functions at z = φ², for a time step.

    Up to θ = 0.0215 rad, three terms (four for sinc θ) truncate exp X and dexp⁻¹ V by less than
    2⁻⁵⁴. A coefficient itself may have an error of 3e-15, but it multiplies a small angle. Beyond
    SINCOS_RANGE the functions are NaN, so that a run reports such a step as a failure.
    """
    tiny = z <= 0.25 * TINY
    if taken_for_granted(tiny):
        return HalfAngleCoefficients(*_half_taylor(z, TINY_TERMS, ()))

    def within_range(z: Number) -> Vec:
        return _half_long(where(z <= 0.25 * SINCOS_RANGE**2, z, NAN))

    values: Vec = branch(
        all_lanes(tiny),
        lambda: _half_taylor(z, TINY_TERMS, ()),
        lambda: _anywhere(z, 0.25, _half_taylor, within_range, ((tiny, TINY_TERMS),)),
    )
    return HalfAngleCoefficients(*values)


Taylor = Callable[[Number, int, Cuts], Vec]  # (z, number of terms, cuts) → values
Beyond = Callable[[Number], Vec]


def _anywhere(z: Number, share: float, taylor: Taylor, beyond: Beyond, cuts: Cuts = ()) -> Vec:
    small = z < share * SMALL

    def beyond_small() -> Vec:
        medium = z < share * MEDIUM
        series = taylor(z, MEDIUM_TERMS, (*cuts, (small, 5)))
        return branch(all_lanes(medium), lambda: series, lambda: where(medium, series, beyond(z)))

    return branch(all_lanes(small), lambda: taylor(z, 5, cuts), beyond_small)


def _taylor(z: Number, terms: int, cuts: Cuts) -> Vec:
    series = (A_TERMS, B_TERMS, A1_TERMS, B1_TERMS)
    return (
        _sinc_series(z, SINC_TERMS, terms, cuts),
        *(horner(z, every[:terms], cuts) for every in series),
        *(_pole_series(z, every, terms, cuts) for every in (C0_TERMS, C1_TERMS)),
    )


def _half_taylor(z: Number, terms: int, cuts: Cuts) -> Vec:
    sinc2, a4, b8, c04, c116 = DOUBLE_ANGLE_TERMS
    return (
        -(z * horner(z, A_TERMS[:terms], cuts)),
        horner(z, SINC_TERMS[:terms], cuts),
        _sinc_series(z, sinc2, terms, cuts),
        *(horner(z, every[:terms], cuts) for every in (a4, b8)),
        *(_pole_series(z, every, terms, cuts) for every in (c04, c116)),
    )


def _sinc_series(z: Number, series: tuple[float, ...], terms: int, cuts: Cuts) -> Number:
    """Sum the series of sinc θ, with one term more than the others for tiny angles."""

    def terms_of(terms: int) -> int:
        return terms + (terms == TINY_TERMS)

    return horner(z, series[: terms_of(terms)], tuple((mask, terms_of(n)) for mask, n in cuts))


def _pole_series(z: Number, series: tuple[float, ...], terms: int, cuts: Cuts) -> Number:
    """Sum the series of c₀ or c₁, with all its terms for medium angles."""
    return horner(z, series if terms == MEDIUM_TERMS else series[:terms], cuts)


def _long(z: Number) -> Vec:
    # Arguments outside a form's range are replaced, and its lanes dropped. NaN stays NaN.
    below = z < SERIES
    return where(below, _entire(minimum(z, SERIES)), _closed(where(below, SERIES, z)))


def _half_long(z: Number) -> Vec:
    below = z < 0.25 * SERIES
    return branch(all_lanes(below), lambda: _half_entire(z), lambda: _half_anywhere(z))


@apart(len(HalfAngleCoefficients._fields))
def _half_anywhere(z: Number) -> Vec:
    below = z < 0.25 * SERIES
    entire = _half_entire(minimum(z, 0.25 * SERIES))
    return where(below, entire, _half_closed(where(below, 0.25 * SERIES, z)))


def _half_entire(z: Number) -> Vec:
    """Compute the functions for angles up to π.

    They follow from a = (1 − cos φ)/φ² and g = (sinc φ − cos φ)/φ²; 4c₀ = g/sinc φ.
    """
    a, g = horner(z, A_TERMS[:10]), horner(z, G_TERMS)
    cos = 1.0 - z * a
    sinc = fma(z, g, cos)
    inverse = 1.0 / sinc
    return (
        -(z * a), sinc, 2.0 * (sinc * cos), 2.0 * (sinc * sinc), 2.0 * fma(cos, a - g, a),
        g * inverse, horner(z, HALF_E_TERMS) * (inverse * inverse),
    )  # fmt: skip


def _half_closed(z: Number) -> Vec:
    half, whole = Coefficients(*_long(z)), Coefficients(*_closed(4.0 * z))
    return (
        -(z * half.a), half.sinc, 2.0 * whole.sinc, 4.0 * whole.a, 8.0 * whole.b, 4.0 * whole.c0,
        16.0 * whole.c1,
    )  # fmt: skip


def _entire(z: Number) -> Vec:
    a, b = horner(z, A_TERMS), horner(z, B_TERMS)
    a1, b1 = horner(z, A1_TERMS), horner(z, B1_TERMS)
    half_inverse = 0.5 / a
    return (1.0 - z * b, a, b, a1, b1, -a1 * half_inverse, horner(z, E_TERMS) * half_inverse)


def _closed(z: Number) -> Vec:
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
