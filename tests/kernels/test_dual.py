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
from lierb.kernels import dual as module
from lierb.kernels.dual import Dual, where
from lierb.kernels.lanes import DEFAULT_LANES
from lierb.kernels.zero import is_zero

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
    "vector": (
        lambda x: np.linalg.norm(np.cross(np.array([x, 1.0, x * x]), [0.5, x, 2.0])),
        lambda x: mp.sqrt((2 - x**3) ** 2 + (x * x / 2 - 2 * x) ** 2 + (x * x - mp.mpf(0.5)) ** 2),
        (-1.5, 0.8),
    ),
}  # fmt: skip
ROWS = 21  # more than two registers, and a part of one
TWO_NUMBERS = (math.atan2, math.hypot, math.pow, math.copysign, max, min)
EVERY = pytest.mark.parametrize("name", FUNCTIONS)


def second_order(x):
    """A number whose derivatives along itself are 1 and 0."""
    return Dual(Dual(x, (1.0,)), (Dual(1.0, (0.0,)),))


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


@EVERY
def test_lanes_agree_with_floats(name):
    function, _, places = FUNCTIONS[name]
    plain = [taken_apart(function(second_order(np.float64(x)))) for x in np.resize(places, ROWS)]
    found = on_packs()[list(FUNCTIONS).index(name)]
    # fused products, and the C library's functions beside NumPy's: a few roundings
    np.testing.assert_allclose(found.T, plain, rtol=2e-14, atol=1e-15)


@pytest.mark.skipif(bool(config.DISABLE_JIT), reason="the JIT is off")
@pytest.mark.parametrize("lanes", [1, 2])
def test_bits_do_not_depend_on_lanes(lanes):
    assert on_packs(lanes).tobytes() == on_packs().tobytes()


def test_where_chooses_values_and_parts():
    x = Dual(2.0, (1.0,))
    assert where(x > 1.0, x * x, -x).parts == (4.0,)
    assert where(x < 1.0, x * x, -x).parts == (-1.0,)
    assert [y.value for y in where(x > 1.0, np.array([x, x]), 0.0)] == [2.0, 2.0]
    assert where(x > 1.0, 3.0, 4.0) == 3.0


@pytest.mark.parametrize("branching", [bool, float, int, lambda x: 1 if x else 2])
def test_a_number_of_many_bodies_cannot_decide(branching):
    with pytest.raises(TypeError, match=r"lierb\.where|many bodies"):
        branching(Dual(2.0))


@pytest.mark.parametrize("compare", [operator.lt, operator.le, operator.gt, operator.ge])
def test_comparison_is_that_of_values(compare):
    for other in (1.0, 2.0, 3.0, Dual(2.0)):
        assert compare(Dual(2.0), other) == compare(2.0, getattr(other, "value", other))


@pytest.mark.parametrize("function", module.REPLACEMENTS)
def test_replacement_stands_for_its_function(function):
    count = 2 if function in TWO_NUMBERS else 1
    numbers = (0.4, 1.5)[:count]
    found = module.REPLACEMENTS[function](*map(Dual, numbers))
    assert found.value == pytest.approx(function(*numbers), rel=1e-15)
