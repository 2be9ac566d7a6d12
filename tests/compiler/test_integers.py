"""Whole numbers in functions that Numba compiles, against Python's own."""

from __future__ import annotations

import itertools
import math
import operator

import numba
import numpy as np
import pytest

from lierb.kernels.functions.function import COMPILED

pytestmark = pytest.mark.skipif(
    bool(numba.config.DISABLE_JIT), reason="Python's own integers do not wrap"
)

MOST = 2**63 - 1
NUMBERS = (
    0, 1, -1, 2, -2, 3, 7, 10, 62, 63, 64, 65, 100, 2**31, 2**32, -(2**32), 3037000499, 3037000500,
    2**62, -(2**62), MOST, -MOST, -MOST - 1,
)  # fmt: skip
MOST_BITS = 10**4  # of a power or a shift that Python computes here


def compiled(function):
    return numba.njit(function, **COMPILED)


def grown(a, b):
    a += b
    a *= 3
    a -= b
    return a


def factorial(n, _):
    product = 1
    for k in range(1, n + 1):
        product *= k
    return product


OPERATIONS = {
    "sum": lambda a, b: a + b, "difference": lambda a, b: a - b, "product": lambda a, b: a * b,
    "power": lambda a, b: a**b, "pow": lambda a, b: pow(a, b), "left": lambda a, b: a << b,
    "right": lambda a, b: a >> b, "quotient": lambda a, b: a // b, "modulo": lambda a, b: a % b,
    "divmod": lambda a, b: divmod(a, b), "negative": lambda a, b: -a, "size": lambda a, b: abs(a),
    "sum of all": lambda a, b: sum((a, b, a)), "sum from": lambda a, b: sum([a, b], b),
    "named": lambda a, b: operator.mul(a, b), "in place": grown, "and": lambda a, b: a & b,
    "factorial": factorial, "part of a float": lambda a, b: 0.5 * (a * b),
}  # fmt: skip


def in_python(name, a, b):
    if name in ("power", "pow", "left") and b > MOST_BITS and a not in (0, 1, -1):
        return None
    if name == "factorial" and a > MOST_BITS:
        return None
    if name == "left" and b > MOST_BITS:
        return 0 if a == 0 else None
    try:
        return OPERATIONS[name](a, b)
    except (ZeroDivisionError, ValueError, OverflowError):
        return None


def holds(found) -> bool:
    """Return whether 64 bits are enough."""
    members = found if isinstance(found, tuple) else (found,)
    return all(isinstance(x, float) or (x is not None and -MOST - 1 <= x <= MOST) for x in members)


@pytest.mark.parametrize("name", OPERATIONS)
def test_whole_numbers_are_pythons_or_an_error(name):
    function = compiled(OPERATIONS[name])
    refused = 0
    for a, b in itertools.product(NUMBERS, repeat=2):
        if name == "factorial" and a > 100:
            continue
        wanted = in_python(name, a, b)
        try:
            found = function(a, b)
        except (OverflowError, ZeroDivisionError, ValueError):
            refused += 1
            # Python gives a float there, or what is between does not fit
            may = name in ("power", "pow", "part of a float", "sum of all", "sum from", "in place")
            assert may or not holds(wanted) or (name, a, b) == ("left", -1, 63), (a, b, wanted)
        else:
            assert found == wanted, (a, b)
    assert refused or name == "and"
    assert refused < len(NUMBERS) ** 2


@pytest.mark.parametrize(
    ("name", "a", "b", "error", "message"),
    [
        ("product", 2**62, 4, OverflowError, "beyond 64 bits; make it a float"),
        ("power", 2, -1, ValueError, r"2\.0\*\*-n for 2\*\*-n"),
        ("quotient", 1, 0, ZeroDivisionError, "by zero"),
        ("modulo", 1, 0, ZeroDivisionError, "by zero"),
        ("left", 1, -1, ValueError, "negative shift count"),
        ("difference", 2**63, 2**63 + 5, OverflowError, "beyond 64 bits"),  # of unsigned ones
    ],
)
def test_what_is_refused_is_told(name, a, b, error, message):
    with pytest.raises(error, match=message):
        compiled(OPERATIONS[name])(a, b)


FLOATS = (
    0.0, -0.0, 0.5, 1.5, 2.5, -2.5, 255.5, 256.0, 2.0**31 - 0.5, -(2.0**31) - 0.5, 2.0**31, 2.0**53,
    math.nextafter(2.0**63, 0.0), 2.0**63, -(2.0**63), 1e300, math.inf, -math.inf, math.nan,
)  # fmt: skip
CONVERSIONS = {
    "int": (lambda x: int(x), math.trunc, 63), "floor": (lambda x: math.floor(x), math.floor, 63),
    "ceil": (lambda x: math.ceil(x), math.ceil, 63), "round": (lambda x: round(x), round, 63),
    "trunc": (lambda x: math.trunc(x), math.trunc, 63),
    "int64": (lambda x: np.int64(x), math.trunc, 63),
    "int32": (lambda x: np.int32(x), math.trunc, 31),
}  # fmt: skip


@pytest.mark.parametrize("name", CONVERSIONS)
def test_whole_parts_of_floats_are_pythons_or_an_error(name):
    function, in_python, bits = CONVERSIONS[name]
    convert = compiled(function)
    for x in FLOATS:
        wanted = in_python(x) if math.isfinite(x) else 2**99
        if -(2**bits) <= wanted < 2**bits:
            assert convert(x) == wanted, x
        else:
            with pytest.raises(OverflowError, match="no integer of these bits"):
                convert(x)


def test_floats_and_arrays_are_left_alone():
    square = compiled(lambda x: x * x)
    assert square(1e200) == math.inf
    np.testing.assert_array_equal(square(np.arange(3)), [0, 1, 4])
    assert compiled(lambda x: round(x, 2))(2.126) == 2.13
