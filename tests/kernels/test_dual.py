"""Dual numbers: every function's value and first two derivatives against mpmath."""

from __future__ import annotations

import math
import operator
from functools import cache

import numpy as np
import pytest
from numba import config
from oracle import mp

from kernels.packs import FORMULAS, on_lanes
from lierb.kernels.functions.elementary import erf, erfc
from lierb.kernels.functions.math_functions import ON_TRACED
from lierb.kernels.functions.object_arrays import numbers
from lierb.kernels.functions.user_number import Condition, UserNumber, raw, where
from lierb.kernels.functions.vocabulary import clip, log, quaternion, table
from lierb.kernels.numbers.zero import is_zero
from lierb.kernels.tracing.cpu import DEFAULT_LANES


def matrix(x):
    """A 3×3 matrix, of that number's kind."""
    return [[x, 1.0, 2.0], [0.5, x * x, 1.0], [1.0, -1.0, 3.0 + x]]


def mp_solution(x, row):
    """Solution of matrix(x) y = (x, 1, 2)."""
    return mp.lu_solve(mp.matrix(matrix(x)), mp.matrix([x, 1, 2]))[row]


POINTS = (-1.0, 0.0, 0.5, 2.0), (1.0, -1.0, 0.25, 3.0)
PLACES = (-3.0, -0.5, 0.2, 1.0, 7.0)  # before, between and beyond them


LONG = np.linspace(0.0, 1.0, 101), np.linspace(0.0, 1.0, 101) ** 2  # searched on lanes


def mp_long_table(x):
    n = min(max(int(mp.floor(x * 100)), 0), 99)
    (x0, x1), (y0, y1) = (map(mp.mpf, points[n : n + 2]) for points in LONG)
    return y0 + (y1 - y0) * (min(max(x, 0), 1) - x0) / (x1 - x0)


def mp_clip(x):
    return min(max(x * x, 0.5), 2)


def mp_table(x):
    xs, ys = POINTS
    for x0, x1, y0, y1 in zip(xs, xs[1:], ys, ys[1:]):
        if x0 <= x <= x1:
            return y0 + (y1 - y0) * (x - x0) / (x1 - x0)
    return mp.mpf(ys[0] if x < xs[0] else ys[-1])


# q = (0.8, 0.6 n) turned on about another axis by x
AXIS, TURNED = (2.0 / 3.0, -1.0 / 3.0, 2.0 / 3.0), (0.8, 0.36, 0.48, 0.0)


def mp_quaternion(x):
    axis = [mp.mpf(2) / 3, -mp.mpf(1) / 3, mp.mpf(2) / 3]
    w, a = mp.mpf("0.8"), [mp.mpf("0.36"), mp.mpf("0.48"), mp.mpf(0)]
    c, b = mp.cos(x / 2), [mp.sin(x / 2) * n for n in axis]
    cross = [a[i - 2] * b[i - 1] - a[i - 1] * b[i - 2] for i in range(3)]
    scalar = w * c - sum(p * q for p, q in zip(a, b, strict=True))
    q = [scalar, *(w * p + c * o + n for p, o, n in zip(b, a, cross, strict=True))]
    return [-n for n in q] if scalar < 0 else q


def mp_rotation_vector(x):
    w, *v = mp_quaternion(x)
    size = mp.sqrt(sum(n * n for n in v))
    return [2 * mp.atan2(size, w) / size * n for n in v]


def rotation(x):
    """R of `mp_quaternion`, of that number's kind: Rodrigues' formula, after a constant one."""
    n, s, c = AXIS, np.sin(x), np.cos(x)
    skew = ((0.0, -n[2], n[1]), (n[2], 0.0, -n[0]), (-n[1], n[0], 0.0))
    turn = [
        [(i == j) * c + (1.0 - c) * n[i] * n[j] + s * skew[i][j] for j in range(3)]
        for i in range(3)
    ]
    w, a = TURNED[0], TURNED[1:]
    first = [
        [
            (i == j) * (2 * w * w - 1)
            + 2 * a[i] * a[j]
            + 2 * w * ((0.0, -a[2], a[1]), (a[2], 0.0, -a[0]), (-a[1], a[0], 0.0))[i][j]
            for j in range(3)
        ]
        for i in range(3)
    ]
    return np.array(first) @ numbers(turn)


# function of a number, the same in mpmath, where it is looked at
FUNCTIONS = {
    "sin": (np.sin, mp.sin, (-7.0, 0.3, 2.0, 3e5)),
    "cos": (np.cos, mp.cos, (-7.0, 0.3, 2.0, 3e5)),
    "tan": (np.tan, mp.tan, (-1.2, 0.3, 2.0)),
    "exp": (np.exp, mp.exp, (-3.0, 0.1, 4.0)),
    "expm1": (np.expm1, mp.expm1, (-3.0, 1e-9, 4.0)),
    "log": (np.log, mp.log, (1e-3, 0.9, 40.0)),
    "log1p": (np.log1p, mp.log1p, (-0.9, 1e-9, 40.0)),
    "sqrt": (np.sqrt, mp.sqrt, (1e-3, 0.9, 40.0)),
    "sinh": (np.sinh, mp.sinh, (-3.0, 0.1, 4.0)),
    "cosh": (np.cosh, mp.cosh, (-3.0, 0.1, 4.0)),
    "tanh": (np.tanh, mp.tanh, (-3.0, 1e-9, 4.0)),
    "arcsin": (np.arcsin, mp.asin, (-0.9, 1e-9, 0.7)),
    "arccos": (np.arccos, mp.acos, (-0.9, 0.1, 0.7)),
    "arctan": (np.arctan, mp.atan, (-9.0, 1e-9, 0.7)),
    "arctan2": (lambda x: np.arctan2(x, x * x - 2), lambda x: mp.atan2(x, x * x - 2), (-1.0, 0.4)),
    "hypot": (lambda x: np.hypot(x, 2.0), lambda x: mp.hypot(x, 2), (-3.0, 0.4)),
    "cube": (lambda x: x**3, lambda x: x**3, (-3.0, 0.4)),
    "inverse square": (lambda x: x**-2, lambda x: x**-2, (-3.0, 0.4)),
    "root": (lambda x: x**0.5, mp.sqrt, (0.3, 9.0)),
    "real power": (lambda x: x**1.7, lambda x: x ** mp.mpf(1.7), (0.3, 9.0)),
    "power of two": (lambda x: 2.0**x, lambda x: mp.mpf(2) ** x, (-0.3, 3.0)),
    "power of itself": (lambda x: x**x, lambda x: x**x, (0.3, 3.0)),
    "quotient": (lambda x: (x + 1.0) / (x * x - 5), lambda x: (x + 1) / (x * x - 5), (-1.0, 3.0)),
    "absolute": (lambda x: abs(x) * x, lambda x: abs(x) * x, (-1.5, 2.5)),
    "maximum": (lambda x: np.maximum(x * x, 2.0), lambda x: max(x * x, 2), (-1.5, 1.0)),
    "arcsinh": (np.arcsinh, mp.asinh, (-9.0, 1e-9, 0.7)),
    "arccosh": (np.arccosh, mp.acosh, (1.1, 9.0)),
    "arctanh": (np.arctanh, mp.atanh, (-0.9, 1e-9, 0.7)),
    "cbrt": (np.cbrt, mp.cbrt, (0.3, 9.0)),
    "exp2": (np.exp2, lambda x: mp.mpf(2) ** x, (-3.0, 0.3)),
    "erf": (erf, mp.erf, (-1.5, 0.3)),
    "erfc": (erfc, mp.erfc, (-1.5, 0.3)),
    "square": (np.square, lambda x: x * x, (-1.5, 0.3)),
    "degrees": (np.degrees, lambda x: x * 180 / mp.pi, (-1.5, 0.3)),
    "floor": (lambda x: np.floor(x) * x, lambda x: mp.floor(x) * x, (-1.5, 0.3)),
    "ceil": (lambda x: np.ceil(x) * x, lambda x: mp.ceil(x) * x, (-1.5, 0.3)),
    "rint": (lambda x: np.rint(x) * x, lambda x: mp.nint(x) * x, (-1.7, 2.3)),
    "two decimals": (lambda x: np.round(x, 2) * x, lambda x: mp.nint(100 * x) / 100 * x, (0.333,)),
    "remainder": (lambda x: x % 0.75, lambda x: x % mp.mpf(0.75), (-1.6, 0.4, 1e9 + 0.3, -1e9)),
    "rest by it": (lambda x: 5.0 % x, lambda x: 5 - x * mp.floor(5 / x), (-1.6, 0.4)),
    "far rest": (lambda x: x % 0.7, lambda x: x % mp.mpf(0.7), (1e17, -3e17)),
    "fmod": (
        lambda x: np.fmod(x, 0.7),
        lambda x: mp.sign(x) * (abs(x) % mp.mpf(0.7)), (-1.6, 1.6, 3e17),
    ),
    "floored": (lambda x: x // 0.7 * x, lambda x: mp.floor(x / mp.mpf(0.7)) * x, (-1.6, 9.0)),
    "sign": (lambda x: np.sign(x) * x * x, lambda x: mp.sign(x) * x * x, (-1.5, 2.0)),
    "copysign": (lambda x: np.copysign(x * x, -x), lambda x: -mp.sign(x) * x * x, (-1.5, 2.0)),
    "heaviside": (lambda x: np.heaviside(x, 0.5) * x, lambda x: x * (x > 0), (-1.5, 2.0)),
    "minimum": (lambda x: np.minimum(x * x, 2.0), lambda x: min(x * x, 2), (-1.5, 1.0)),
    "clip": (lambda x: np.clip(x * x, 0.5, 2.0), mp_clip, (-9.0, 1.0, 0.1)),
    "clip of ours": (lambda x: clip(x * x, 0.5, 2.0), mp_clip, (-9.0, 1.0)),
    "where": (lambda x: np.where(x > 1.0, x * x, -x), lambda x: x * x if x > 1 else -x, (0.5, 2.0)),
    "condition": (lambda x: (x > 1.0) * x * x, lambda x: x * x * (x > 1), (0.5, 2.0)),
    "table": (lambda x: table(x, *POINTS) * x, lambda x: mp_table(x) * x, PLACES),
    "interp": (lambda x: np.interp(x, *POINTS), mp_table, PLACES),
    "long table": (
        lambda x: table(x, *LONG), mp_long_table, (-1.0, 0.003, 0.505, 0.7751, 0.9999, 3.0),
    ),
    "determinant": (
        lambda x: np.linalg.det(numbers(matrix(x))),
        lambda x: mp.det(mp.matrix(matrix(x))), (0.7, 2.0),
    ),
    "inverse": (
        lambda x: np.linalg.inv(numbers(matrix(x)))[1, 2],
        lambda x: mp.inverse(mp.matrix(matrix(x)))[1, 2], (0.7, 2.0),
    ),
    "solution": (
        lambda x: np.linalg.solve(numbers(matrix(x)), numbers([x, 1.0, 2.0]))[0],
        lambda x: mp_solution(x, 0), (0.7, 2.0),
    ),
    "einsum": (
        lambda x: np.einsum("ij,jk->ik", numbers(matrix(x)), numbers(matrix(x)))[2, 0],
        lambda x: (mp.matrix(matrix(x)) ** 2)[2, 0], (0.7, 2.0),
    ),
    "pieces": (
        lambda x: np.concatenate([np.stack([x, 2.0 * x]), numbers([x * x])]) @ np.arange(1.0, 4.0),
        lambda x: 5 * x + 3 * x * x, (0.7, 2.0),
    ),
    "quaternion": (
        lambda x: quaternion(rotation(x))[2], lambda x: mp_quaternion(x)[2], (-2.0, 0.3, 3.0, 5.0),
    ),
    "rotation vector": (  # by the series, by atan2, and near half a turn
        lambda x: log(rotation(x))[1],
        lambda x: mp_rotation_vector(x)[1], (-2.0, -0.3, 0.3, 1.6, 2.4),
    ),
    "vector": (
        lambda x: np.linalg.norm(np.cross(np.array([x, 1.0, x * x]), [0.5, x, 2.0])),
        lambda x: mp.sqrt((2 - x**3) ** 2 + (x * x / 2 - 2 * x) ** 2 + (x * x - mp.mpf(0.5)) ** 2),
        (-1.5, 0.8),
    ),
}  # fmt: skip
ROWS = 21  # more than two registers, and a part of one
TWO_NUMBERS = (math.atan2, math.hypot, math.pow, math.copysign, math.fmod, max, min)
OF_MANY = (all, any)
EVERY = pytest.mark.parametrize("name", FUNCTIONS)


def second_order(x):
    """A number whose derivatives along itself are 1 and 0."""
    return UserNumber(UserNumber(x, (1.0,)), (UserNumber(1.0, (0.0,)),))


def taken_apart(found):
    """Value, first and second derivative."""
    numbers = found.value.value, found.parts[0].value, found.parts[0].parts[0]
    return tuple(0.0 if is_zero(x) else x for x in numbers)


def all_functions(*numbers):
    """Value and derivatives of every function, each at a number of its own."""
    pairs = zip(FUNCTIONS.values(), numbers, strict=True)
    return tuple(y for (function, *_), x in pairs for y in taken_apart(function(second_order(x))))


FORMULAS["duals"] = all_functions


@cache
def on_packs(lanes=DEFAULT_LANES):
    """(function, value or derivative, place): all functions in one kernel."""
    columns = [np.resize(places, ROWS) for *_, places in FUNCTIONS.values()]
    found = on_lanes("duals", *columns, results=3 * len(FUNCTIONS), lanes=lanes)
    return found.reshape(len(FUNCTIONS), 3, ROWS)


@EVERY
def test_derivatives_are_exact(name):
    function, exact, places = FUNCTIONS[name]
    for place in places:
        found = taken_apart(function(second_order(np.float64(place))))
        wanted = [float(mp.diff(exact, mp.mpf(place), n)) for n in range(3)]
        # a few roundings; those of sin and cos at 3e5 are relative to 1
        np.testing.assert_allclose(found, wanted, rtol=2e-14, atol=1e-15, err_msg=f"at {place}")


@pytest.mark.slow
@EVERY
def test_lanes_agree_with_floats(name):
    function, _, places = FUNCTIONS[name]
    plain = [taken_apart(function(second_order(np.float64(x)))) for x in np.resize(places, ROWS)]
    found = on_packs()[list(FUNCTIONS).index(name)]
    # fused products, and the C library's functions beside NumPy's: a few roundings
    np.testing.assert_allclose(found.T, plain, rtol=2e-14, atol=1e-15)


@pytest.mark.slow
@pytest.mark.skipif(bool(config.DISABLE_JIT), reason="the JIT is off")
@pytest.mark.parametrize("lanes", [1, 2])
def test_bits_do_not_depend_on_lanes(lanes):
    assert on_packs(lanes).tobytes() == on_packs().tobytes()


def test_where_chooses_values_and_parts():
    x = UserNumber(2.0, (1.0,))
    assert where(x > 1.0, x * x, -x).parts == (4.0,)
    assert where(x < 1.0, x * x, -x).parts == (-1.0,)
    assert [y.value for y in where(x > 1.0, np.array([x, x]), 0.0)] == [2.0, 2.0]
    assert where(x > 1.0, 3.0, 4.0) == 3.0
    assert raw(where((x > 1.0) & (x < 2.0), 3.0, 4.0)) == 4.0


@pytest.mark.parametrize("branching", [bool, float, int, lambda x: 1 if x else 2])
def test_a_number_of_many_bodies_cannot_decide(branching):
    with pytest.raises(TypeError, match=r"lierb\.where|many bodies"):
        branching(UserNumber(2.0))


@pytest.mark.parametrize("compare", [operator.lt, operator.le, operator.gt, operator.ge])
def test_comparison_is_that_of_values(compare):
    for other in (1.0, 2.0, 3.0, UserNumber(2.0)):
        found = compare(UserNumber(2.0), other)
        assert found.mask == compare(2.0, getattr(other, "value", other))
        assert (~found).mask == (not found.mask)


@pytest.mark.parametrize("function", [f for f in ON_TRACED if f not in OF_MANY])
def test_replacement_stands_for_its_function(function):
    numbers = (1.4 if function is math.acosh else 0.4, 1.5)[: 2 if function in TWO_NUMBERS else 1]
    found = ON_TRACED[function](*map(UserNumber, numbers))
    value = found.mask if isinstance(found, Condition) else found.value
    assert value == pytest.approx(function(*numbers), rel=1e-15)


@pytest.mark.parametrize("function", OF_MANY)
@pytest.mark.parametrize("members", [(True, True), (True, False), (False, False)])
def test_replacement_folds_conditions(function, members):
    folded = ON_TRACED[function]([Condition(x) for x in members])
    assert folded.mask == function(members)


@pytest.mark.parametrize(
    "function", [np.maximum, np.minimum, np.fmax, np.fmin, np.copysign, np.heaviside, np.remainder]
)
def test_odd_numbers_are_numpys(function):
    odd = (math.nan, -0.0, 0.0, 1.0, -1.5, math.inf)
    with np.errstate(all="ignore"):
        for x, y in ((x, y) for x in odd for y in odd):
            found = raw(function(UserNumber(x), UserNumber(y)))
            # np.maximum may give either zero
            np.testing.assert_array_equal(found, function(x, y), err_msg=f"{x}, {y}")
    assert math.copysign(1.0, raw(np.copysign(UserNumber(2.0), UserNumber(-0.0)))) == -1.0


def odd_numbers(x, y):
    x, y = UserNumber(x), UserNumber(y)
    found = (
        np.maximum(x, y), np.minimum(x, y), np.fmax(x, y), np.copysign(x, y), np.heaviside(x, y),
        x % y, np.fmod(x, y), np.sign(x), np.where(np.isnan(x), 1.0, 0.0),
        np.where(x != x, 1.0, 0.0),
    )  # fmt: skip
    return tuple(map(raw, found))


FORMULAS["odd numbers"] = odd_numbers


def test_odd_numbers_on_lanes_are_numpys():
    odd = np.array((math.nan, -0.0, 0.0, 1.0, -1.5, 7.25, -math.inf))
    x, y = (a.ravel() for a in np.meshgrid(odd, odd))
    found = on_lanes("odd numbers", x, y, results=10)
    with np.errstate(all="ignore"):
        wanted = odd_numbers(x, y)
    for n, (mine, numpys) in enumerate(zip(found, wanted, strict=True)):
        np.testing.assert_array_equal(mine, numpys, err_msg=str(n))
    np.testing.assert_array_equal(np.signbit(found[3]), np.signbit(wanted[3]))
