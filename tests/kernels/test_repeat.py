"""Loops in formulas: Newton's iterations against mpmath, each lane with turns of its own."""

from functools import cache, partial

import numpy as np
import pytest
from numba import config
from oracle import mp

from kernels.packs import FORMULAS, on_lanes
from lierb.kernels.numbers import repeat
from lierb.kernels.numbers.arithmetic import (
    absolute,
    all_lanes,
    assumptions,
    branch,
    flatten,
    sqrt,
    taken_for_granted,
    where,
)
from lierb.kernels.numbers.dual import Dual
from lierb.kernels.numbers.trigonometry import sincos
from lierb.kernels.numbers.zero import ZERO
from lierb.kernels.tracing.trace import trial

LANES = (1,) if config.DISABLE_JIT else (1, 2, 8)
MOST = 60
needs_jit = pytest.mark.skipif(bool(config.DISABLE_JIT), reason="the JIT is off")
on_all_lanes = pytest.mark.parametrize("lanes", LANES)


def square_root(x, most=MOST):
    """Newton's iteration from 1, for any x > 0."""

    def turn(numbers):
        (y,) = numbers
        change = 0.5 * (x / y - y)
        # the next change is a half of its square, so less than half a unit in the last place
        return (y + change,), absolute(change) > 1e-8 * y

    return repeat((1.0,), turn, most, x)


def kepler(mean, eccentricity, most=MOST):
    """E of E − e sin E = M, from π on, where Newton's iteration never passes the root."""

    def turn(numbers):
        (anomaly,) = numbers
        s, c = sincos(anomaly)
        change = (mean - anomaly + eccentricity * s) / (1.0 - eccentricity * c)
        return (anomaly + change,), absolute(change) > 1e-13

    return repeat((np.pi,), turn, most, mean)


def numbers_of(result):
    """Members, mask and number of turns, as numbers."""
    numbers, is_unfinished, turns = result
    return (*flatten(numbers), where(is_unfinished, 1.0, 0.0), turns)


def kepler_slopes(mean, eccentricity):
    """E, ∂E/∂M and ∂E/∂e by dual numbers."""
    operands = Dual(mean, (1.0, 0.0)), Dual(eccentricity, (0.0, 1.0))
    (anomaly,), is_unfinished, turns = kepler(*operands)
    return (anomaly.value, *anomaly.parts, where(is_unfinished, 1.0, 0.0), turns)


FORMULAS |= {
    "square_root": lambda x: numbers_of(square_root(x)),
    "five_turns": lambda x: numbers_of(square_root(x, 5)),
    "kepler": lambda m, e: numbers_of(kepler(m, e)),
    "kepler_slopes": kepler_slopes,
}

# In an order that puts few turns beside many; 23 is no multiple of any number of lanes.
SQUARES = np.array(
    [1.0, 1e12, 2.0, 1e-12, 4.0, 1.0, 1e6, 0.25, 3.0, 1e-3, *np.geomspace(0.5, 8, 13)]
)
MEANS, ECCENTRICITIES = np.array(
    [(m, e) for e in (0.0, 0.3, 0.9, 0.97) for m in (1e-3, 0.2, 1.5, 3.0, np.pi, 4.5)]
).T


def of_each(formula, *columns):
    """The plain loop, on one float after the other."""
    return np.array([numbers_of(formula(*map(float, row))) for row in zip(*columns)]).T


def same_bits(a, b):
    return np.array_equal(np.asarray(a).view(np.int64), np.asarray(b).view(np.int64))


@cache
def exact_anomalies():
    return [
        mp.findroot(lambda x, m=m, e=e: x - e * mp.sin(x) - m, mp.mpf(m) + e * mp.sin(m), tol=1e-60)
        for m, e in zip(map(mp.mpf, MEANS), map(mp.mpf, ECCENTRICITIES))
    ]


@on_all_lanes
def test_square_root_by_newton(lanes):
    root, unfinished, turns = on_lanes("square_root", SQUARES, results=3, lanes=lanes)
    exact = np.array([float(mp.sqrt(mp.mpf(x))) for x in SQUARES])
    # the last change rounds three times, of numbers near it; then one sum
    np.testing.assert_allclose(root, exact, rtol=4 * 2.0**-53)
    assert not unfinished.any()
    assert turns.min() == 1
    assert turns.max() > 20  # 10¹² is halved down to its root first
    assert len(set(turns[:8])) > 3  # in one pack


@on_all_lanes
def test_kepler_by_newton(lanes):
    anomaly, unfinished, _ = on_lanes("kepler", MEANS, ECCENTRICITIES, results=3, lanes=lanes)
    exact = np.array([float(x) for x in exact_anomalies()])
    # rounding of M − E + e sin E, by the slope there: 1 − e cos E is 0.03 at the least
    condition = 1.0 - ECCENTRICITIES * np.cos(exact)
    assert np.all(abs(anomaly - exact) <= 4 * 2.0**-52 * np.pi / condition)
    assert not unfinished.any()


@on_all_lanes
def test_derivatives_are_those_of_the_implicit_function(lanes):
    anomaly, by_mean, by_eccentricity, _, turns = on_lanes(
        "kepler_slopes", MEANS, ECCENTRICITIES, results=5, lanes=lanes
    )
    exact = np.array([float(x) for x in exact_anomalies()])
    condition = 1.0 - ECCENTRICITIES * np.cos(exact)
    # An error δ of E, of 1e-13 before the last turn at the most, is one of e sin E δ/condition in
    # these quotients.
    tolerance = 1e-12 / condition**2
    assert np.all(abs(by_mean * condition - 1.0) <= tolerance)
    assert np.all(abs(by_eccentricity * condition - np.sin(exact)) <= tolerance)
    plain = on_lanes("kepler", MEANS, ECCENTRICITIES, results=3, lanes=lanes)
    assert same_bits((anomaly, turns), plain[::2])


@needs_jit
@on_all_lanes
@pytest.mark.parametrize("name", ["square_root", "kepler_slopes"])
def test_bits_of_a_lane_do_not_depend_on_its_neighbours(name, lanes):
    columns = (SQUARES,) if name == "square_root" else (MEANS, ECCENTRICITIES)
    results = 3 if name == "square_root" else 5
    alone = on_lanes(name, *columns, results=results, lanes=1)
    for seed in range(3):
        order = np.random.default_rng(seed).permutation(len(columns[0]))
        found = on_lanes(name, *(c[order] for c in columns), results=results, lanes=lanes)
        assert same_bits(found, alone[:, order])


@on_all_lanes
def test_a_lane_without_an_end_takes_all_turns(lanes):
    _, unfinished, turns = on_lanes("five_turns", SQUARES, results=3, lanes=lanes)
    _, _, needed = on_lanes("square_root", SQUARES, results=3, lanes=lanes)
    np.testing.assert_array_equal(turns, np.minimum(needed, 5))
    np.testing.assert_array_equal(unfinished, needed > 5)


@on_all_lanes
def test_a_lane_with_nan_stops_and_holds_up_no_other(lanes):
    spoilt = SQUARES.copy()
    spoilt[1::4] = np.nan
    found = on_lanes("square_root", spoilt, results=3, lanes=lanes)
    clean = on_lanes("square_root", SQUARES, results=3, lanes=lanes)
    is_bad = np.isnan(spoilt)
    assert same_bits(found[:, ~is_bad], clean[:, ~is_bad])
    np.testing.assert_array_equal(found[:, is_bad].T, [[np.nan, 0.0, 1.0]] * is_bad.sum())


@pytest.mark.parametrize(("formula", "columns"), [
    (square_root, (SQUARES,)), (kepler, (MEANS, ECCENTRICITIES)),
    (partial(square_root, most=5), (SQUARES,)),
])  # fmt: skip
def test_arrays_take_the_turns_that_floats_take(formula, columns):
    assert same_bits(np.stack(numbers_of(formula(*columns))), of_each(formula, *columns))


def test_duals_on_floats_and_arrays():
    columns = MEANS, ECCENTRICITIES
    floats = np.array([kepler_slopes(*map(float, row)) for row in zip(*columns)]).T
    assert same_bits(np.stack(kepler_slopes(*columns)), floats)
    assert same_bits(floats[[0, 4]], of_each(kepler, *columns)[[0, 2]])


def test_second_derivatives():
    x = Dual(Dual(2.0, (1.0,)), (Dual(1.0, (0.0,)),))

    def turn(numbers):
        (y,) = numbers
        change = 0.5 * (x / y - y)
        return (y + change,), absolute(change) > 1e-30  # until nothing changes: all parts are there

    (root,), _, _ = repeat((1.0,), turn, 8, x)
    found = root.value.value, root.parts[0].value, root.parts[0].parts[0]
    # 8 turns of which the last three change nothing but rounding, of numbers near 1
    np.testing.assert_allclose(found, (2**0.5, 0.5 / 2**0.5, -0.25 / 2**1.5), rtol=1e-15)


# ---------------------------------------------------------------- what a turn may do


def doubled(x, y):
    """2ⁿ x beyond y, from structural zeros and constants on; with branches and another loop."""

    def inner(numbers):
        return (numbers[0] + 1.0,), numbers[0] < 2.5

    def turn(numbers):
        (size, (count, always)), rest = numbers
        near = size < 8.0
        assert not taken_for_granted(near)  # of which only the last turn's would be looked at
        size = branch(all_lanes(near), lambda: 2.0 * size, lambda: size + size)
        (three,), _, _ = repeat((ZERO,), inner, 9, x)
        return ((size, (count + three, always)), rest), size < y

    with assumptions(x) as masks:
        numbers, is_unfinished, turns = repeat(((x, (ZERO, 7.0)), ZERO), turn, 30, x)
    assert masks == []
    return numbers_of((numbers, is_unfinished, turns))


FORMULAS["doubled"] = doubled


@on_all_lanes
def test_turns_have_nested_tuples_branches_and_loops(lanes):
    x = np.array([1.0, 3.0, 0.5, 1.0, 7.0, 2.0, 0.1, 1.0, 9.0])
    y = np.array([9.0, 4.0, 700.0, 1.5, 1e5, 3.0, 0.2, np.nan, 1e12])
    size, count, always, rest, unfinished, turns = on_lanes("doubled", x, y, results=6, lanes=lanes)
    needed = [1 if np.isnan(b) else max(1, int(np.ceil(np.log2(b / a)))) for a, b in zip(x, y)]
    np.testing.assert_array_equal(turns, np.minimum(needed, 30))
    np.testing.assert_array_equal(size, x * 2.0**turns)
    np.testing.assert_array_equal(count, 4.0 * turns)
    assert np.all(always == 7.0)
    assert not rest.any()
    np.testing.assert_array_equal(unfinished, np.array(needed) > 30)


@needs_jit
def test_a_turn_is_traced_once():
    texts = [trial(lambda x, n=n: square_root(x, n)[0], 1)[1] for n in (5, 50)]
    assert [text.count("fdiv") for text in texts] == [1, 1]
    assert texts[0].replace(", 5\n", ", 50\n") == texts[1]


def test_the_mean_of_two_means():
    """Two numbers that converge together, in closed form: the arithmetic–geometric mean."""

    def turn(numbers):
        a, b = numbers
        a, b = 0.5 * (a + b), sqrt(a * b)
        return (a, b), a - b > 1e-9 * a  # the next difference is below 1e-19

    (mean, _), _, turns = repeat((1.0, 0.5), turn, 20, 1.0)
    assert mean == pytest.approx(float(mp.agm(1, mp.mpf("0.5"))), rel=4 * 2.0**-53)
    assert turns == 4
