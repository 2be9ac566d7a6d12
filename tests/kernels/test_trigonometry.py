"""sincos and atan2 against mpmath, in units in the last place of the exact value."""

from functools import cache
from itertools import product

import numpy as np
import pytest
from oracle import mp

from kernels.packs import on_lanes
from kernels.samples import NUMBER_TYPES
from lierb.kernels.numbers.trigonometry import atan2, sincos

every_number = pytest.mark.parametrize("number_type", NUMBER_TYPES)


def evaluate(number_type, formula, *columns, results):
    """One row for each result of the formula, computed with one of NUMBER_TYPES."""
    if number_type == "lanes":
        return on_lanes(formula.__name__, *columns, results=results)
    if number_type == "arrays":
        return np.atleast_2d(formula(*columns))
    rows = [np.atleast_1d(formula(*row)) for row in zip(*(c.tolist() for c in columns))]
    return np.array(rows).T


def ulps(found, exact):
    """Error in units in the last place of the exact value."""
    errors = [abs(mp.mpf(f) - e) / np.spacing(abs(float(e))) for f, e in zip(found.tolist(), exact)]
    return np.array(errors, dtype=float)


@cache
def angles():
    """Within a turn and up to 1e5 rad; at, beside and near multiples of π/4; tiny; both signs."""
    rng = np.random.default_rng(7)
    turns = rng.integers(-16_000, 16_000, 100)
    quarters = np.concatenate([np.arange(-16, 17), 8 * turns + np.arange(100) % 8]) * (np.pi / 4)
    beside = [np.nextafter(quarters, 1e9), np.nextafter(quarters, -1e9), quarters * (1 + 1e-12)]
    tiny = np.geomspace(1e-300, 1.0, 60)
    random = [rng.uniform(-7.0, 7.0, 600), rng.uniform(-1e5, 1e5, 200)]
    return np.concatenate([quarters, *beside, tiny, -tiny, *random])


@every_number
def test_sincos_ulps(number_type):
    x = angles()
    s, c = evaluate(number_type, sincos, x, results=2)
    # half an ulp from the last addition, one from the polynomial and the reduced angle, and without
    # fma up to another half: also beside multiples of π/2, where sin or cos is as small as 1e-16
    nonzero = x != 0.0
    assert ulps(s[nonzero], map(mp.sin, x[nonzero].tolist())).max() <= 2.0
    assert ulps(c, map(mp.cos, x.tolist())).max() <= 2.0


@every_number
def test_sincos_at_zero_is_exact(number_type):
    s, c = evaluate(number_type, sincos, np.array([0.0, -0.0]), results=2)
    assert np.array_equal(s, [0.0, 0.0])
    assert np.array_equal(c, [1.0, 1.0])


@every_number
def test_sincos_is_odd_and_even_to_the_bit(number_type):
    s, c = evaluate(number_type, sincos, angles(), results=2)
    s_minus, c_minus = evaluate(number_type, sincos, -angles(), results=2)
    assert np.array_equal(s_minus, -s)
    assert np.array_equal(c_minus, c)


@every_number
def test_atan2_ulps(number_type):
    rng = np.random.default_rng(8)
    angle, radius = rng.uniform(-np.pi, np.pi, 600), np.exp(rng.uniform(-300, 300, 600))
    # from the x-axis to the y-axis; dense where the formula changes: tan π/8, 1, cot π/8
    cutovers = np.tan(np.pi / 8 * np.array([[1.0], [2.0], [3.0]])) * rng.uniform(0.99, 1.01, 100)
    slope = np.concatenate([np.geomspace(1e-300, 1e300, 60), *cutovers])
    y = np.concatenate([radius * np.sin(angle), slope, -slope, slope])
    x = np.concatenate([radius * np.cos(angle), *[np.ones_like(slope)] * 2, -np.ones_like(slope)])
    found = evaluate(number_type, atan2, y, x, results=1)[0]
    # the quotient, its polynomial, and one subtraction from π/4, π/2 or π each: at most three ulps
    assert ulps(found, map(mp.atan2, y.tolist(), x.tolist())).max() <= 3.0


@every_number
def test_atan2_on_the_axes(number_type):
    y, x = np.array(list(product([-2.0, 0.0, 2.0], repeat=2))).T
    found = evaluate(number_type, atan2, y, x, results=1)[0]
    assert np.array_equal(found, np.arctan2(y, x))  # multiples of π/4, which round to themselves


@every_number
def test_atan2_takes_minus_zero_for_zero(number_type):
    y, x = np.array(list(product([0.0, -0.0], [-1.0, -0.0, 0.0, 1.0]))).T
    found = evaluate(number_type, atan2, y, x, results=1)[0]
    assert np.array_equal(found, np.where(x < 0, np.pi, 0.0))


@every_number
def test_atan2_passes_nan_on(number_type):
    y, x = np.array(
        [[np.nan, 1.0], [1.0, np.nan], [np.nan, np.nan], [np.nan, 0.0], [0.0, np.nan]]
    ).T
    assert np.isnan(evaluate(number_type, atan2, y, x, results=1)).all()
