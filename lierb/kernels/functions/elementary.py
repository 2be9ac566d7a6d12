"""Sines, exponentials, roots and powers of users' numbers have derivatives."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cache, partial, reduce
from typing import Any

import numpy as np

from lierb.kernels.functions.user_number import (
    Condition,
    UserNumber,
    choice,
    combined,
    define,
    kind_of,
    raw,
    value_of,
)
from lierb.kernels.numbers.arithmetic import PI, absolute, all_lanes, apart, branch, plain
from lierb.kernels.numbers.arithmetic import sqrt as root
from lierb.kernels.numbers.arithmetic import where as select
from lierb.kernels.numbers.dual import Dual, parts_of
from lierb.kernels.numbers.trigonometry import SINCOS_RANGE, atan2, sincos
from lierb.kernels.numbers.zero import ZERO
from lierb.kernels.tracing import lane_by_lane
from lierb.kernels.tracing.lanes import Lane, call_intrinsic

HUGE = 2.0**1000  # sums of two larger numbers may overflow


def smooth(
    name: str, of: Callable[[Any], Any], slope: Callable[[Any, Any], Any]
) -> Callable[[Any], Any]:
    """Make the function `name` from of(x), its value, and slope(x, value), its derivative."""

    def function(x: Any) -> Any:
        if isinstance(x, Condition):
            x = x.number()
        if not isinstance(x, Dual):
            return of(x)
        value = function(x.value)
        return x.along(slope(x.value, value), value) if x.parts else type(x)(value)

    function.__name__ = name
    return function


def copysign_of(x: Any, y: Any) -> Any:
    if isinstance(x, Lane) or isinstance(y, Lane):
        return call_intrinsic("copysign", plain(x), plain(y))
    return np.copysign(plain(x), plain(y))


def _library(name: str, *operands: Any) -> Any:
    """Call the C library's function on each number."""
    if any(isinstance(x, Lane) for x in operands):
        return _of_library(name)(*map(plain, operands))[0]
    if hasattr(np, IN_NUMPY.get(name, name)):
        return getattr(np, IN_NUMPY.get(name, name))(*map(plain, operands))
    values = np.frompyfunc(getattr(math, name), len(operands), 1)(*map(plain, operands))
    return np.asarray(values, dtype=np.float64)[()]


@cache
def _of_library(name: str) -> Callable[..., tuple[Any]]:
    """Return the C library's function on lanes, whose code is called apart."""

    def formula(*operands: Any) -> tuple[Any]:
        return (lane_by_lane.call_library(name, *operands),)

    formula.__qualname__ = f"_of_library.{name}"
    return apart(1)(formula)


IN_NUMPY = {
    "pow": "power", "asin": "arcsin", "acos": "arccos", "atan": "arctan", "atan2": "arctan2",
    "asinh": "arcsinh", "acosh": "arccosh", "atanh": "arctanh",
}  # fmt: skip


@apart(1)
def _sine(x: Any) -> tuple[Any]:
    return (select(x == 0.0, x, _sine_or_cosine("sin", x)),)  # sin(−0) is −0


@apart(1)
def _cosine(x: Any) -> tuple[Any]:
    return (_sine_or_cosine("cos", x),)


def _sine_or_cosine(name: str, x: Any) -> Any:
    which = 0 if name == "sin" else 1
    near = absolute(x) <= SINCOS_RANGE
    return branch(
        all_lanes(near),
        lambda: sincos(x)[which],
        lambda: select(near, sincos(x)[which], _library(name, x)),
    )


_is_constraint = ContextVar("_is_constraint", default=False)


@contextmanager
def constraint() -> Iterator[None]:
    """Let roots have infinite slopes at zero in the context: a zero row of J would be no row."""
    token = _is_constraint.set(True)
    try:
        yield
    finally:
        _is_constraint.reset(token)


def _slope_of_root(x: Any, y: Any) -> Any:
    """Return the slope of y = √x; 0 at zero, as `Dual.sqrt`: ‖v‖v has its derivative there."""
    if _is_constraint.get():
        return 0.5 / y
    is_zero_there = raw(y) == 0.0
    return choice(is_zero_there, 0.0, 0.5 / choice(is_zero_there, 1.0, y))


sin: Callable[[Any], Any] = smooth("sin", lambda x: _sine(x)[0], lambda x, y: cos(x))
cos: Callable[[Any], Any] = smooth("cos", lambda x: _cosine(x)[0], lambda x, y: -sin(x))
tan = smooth("tan", partial(_library, "tan"), lambda x, y: 1.0 + y * y)
exp = smooth("exp", partial(_library, "exp"), lambda x, y: y)
expm1 = smooth("expm1", partial(_library, "expm1"), lambda x, y: exp(x))
log = smooth("log", partial(_library, "log"), lambda x, y: 1.0 / x)
log1p = smooth("log1p", partial(_library, "log1p"), lambda x, y: 1.0 / (1.0 + x))
sqrt = smooth("sqrt", root, _slope_of_root)
sinh: Callable[[Any], Any] = smooth("sinh", partial(_library, "sinh"), lambda x, y: cosh(x))
cosh: Callable[[Any], Any] = smooth("cosh", partial(_library, "cosh"), lambda x, y: sinh(x))
tanh = smooth("tanh", partial(_library, "tanh"), lambda x, y: 1.0 / (cosh(x) * cosh(x)))
arcsin = smooth("arcsin", partial(_library, "asin"), lambda x, y: 1.0 / sqrt((1.0 - x) * (1.0 + x)))
arccos = smooth(
    "arccos", partial(_library, "acos"), lambda x, y: -1.0 / sqrt((1.0 - x) * (1.0 + x))
)
arctan = smooth("arctan", lambda x: _angle(x, 1.0), lambda x, y: 1.0 / (1.0 + x * x))
arcsinh = smooth("arcsinh", partial(_library, "asinh"), lambda x, y: 1.0 / sqrt(1.0 + x * x))
arccosh = smooth(
    "arccosh", partial(_library, "acosh"), lambda x, y: 1.0 / sqrt((x - 1.0) * (x + 1.0))
)
arctanh = smooth("arctanh", partial(_library, "atanh"), lambda x, y: 1.0 / ((1.0 - x) * (1.0 + x)))
cbrt = smooth("cbrt", partial(_library, "cbrt"), lambda x, y: 1.0 / (3.0 * y * y))
exp2 = smooth("exp2", partial(_library, "exp2"), lambda x, y: math.log(2.0) * y)
erf: Callable[[Any], Any] = smooth(
    "erf", partial(_library, "erf"), lambda x, y: 2.0 / math.sqrt(math.pi) * exp(-(x * x))
)
erfc: Callable[[Any], Any] = smooth(
    "erfc", partial(_library, "erfc"), lambda x, y: -2.0 / math.sqrt(math.pi) * exp(-(x * x))
)


def _angle(y: Any, x: Any) -> Any:
    """Compute atan2 of plain numbers as C does: signs of zeros, infinities, no overflow."""
    y, x = plain(y), plain(x)
    ax, ay = absolute(x), absolute(y)
    are_infinite = (ax == math.inf) & (ay == math.inf)
    down = select((ax > HUGE) | (ay > HUGE), 0.125, 1.0)
    top, right = select(are_infinite, 1.0, ay * down), select(are_infinite, 1.0, ax * down)
    angle = atan2(top, copysign_of(right, x))
    angle = select((top == 0.0) & (copysign_of(1.0, x) < 0.0), PI, angle)
    return copysign_of(angle, y)


def arctan2(y: Any, x: Any) -> Any:
    """Return the angle of the point (x, y), rad."""
    if not (isinstance(y, Dual) or isinstance(x, Dual)):
        return _angle(y, x)
    top, right = value_of(y), value_of(x)
    value = arctan2(top, right)
    if not (parts_of(y) or parts_of(x)):
        return kind_of(y, x)(value)
    inverse = 1.0 / (top * top + right * right)
    return combined(y, x, lambda a, b: value, right * inverse, -(top * inverse))


def power(base: Any, exponent: Any) -> Any:
    """Compute base ** exponent, by products for a whole exponent."""
    if isinstance(exponent, (int, np.integer)) or (
        isinstance(exponent, float) and exponent.is_integer() and abs(exponent) <= 16
    ):
        return _whole_power(base, int(exponent))
    if isinstance(exponent, float) and abs(exponent) == 0.5:
        root_of = choice(raw(base) == -math.inf, math.inf, sqrt(base + 0.0))  # −0 becomes +0
        return root_of if exponent > 0.0 else 1.0 / root_of
    if not (isinstance(base, Dual) or isinstance(exponent, Dual)):
        return _library("pow", base, exponent)
    x, n = value_of(base), value_of(exponent)
    value = power(x, n)
    if not (parts_of(base) or parts_of(exponent)):
        return kind_of(base, exponent)(value)
    by_exponent: Any = ZERO
    if parts_of(exponent):  # 0 where 0 ** n is 0 for all n nearby
        is_nothing = (raw(x) == 0.0) & (raw(value) == 0.0)
        by_exponent = value * log(select(is_nothing, 1.0, x))
    return combined(base, exponent, lambda a, b: value, n * power(x, n - 1.0), by_exponent)


def _whole_power(base: Any, exponent: int) -> Any:
    if exponent < 0:
        return 1.0 / _whole_power(base, -exponent)
    if exponent < 2:
        return base if exponent else 1.0
    half = _whole_power(base, exponent // 2)
    return half * half * base if exponent % 2 else half * half


def square(x: Any) -> Any:
    return x * x


def reciprocal(x: Any) -> Any:
    return 1.0 / x


def hypot(*numbers: Any) -> Any:
    """Return the root of the sum of squares.

    The numbers are scaled by a power of two if squares overflow or underflow.
    """
    sizes = [absolute(raw(x)) for x in numbers]
    largest = reduce(lambda a, b: select(b > a, b, a), sizes)
    down, up = largest > 2.0**500, largest < 2.0**-500
    scale = UserNumber(select(down, 2.0**-600, select(up, 2.0**600, 1.0)))
    size = sqrt(sum((x * scale) * (x * scale) for x in numbers)) / scale
    is_infinite = reduce(lambda a, b: a | b, [size == math.inf for size in sizes])
    return choice(is_infinite, math.inf, size)


def log10(x: Any) -> Any:
    return log(x) / math.log(10.0)


def log2(x: Any) -> Any:
    return log(x) / math.log(2.0)


define(__pow__=power, __rpow__=lambda self, base: power(base, self))
NAMED = (  # methods that NumPy calls on arrays of objects
    sin, cos, tan, exp, expm1, log, log1p, log10, log2, sqrt, sinh, cosh, tanh, arcsin, arccos,
    arctan, arctan2, hypot,
)  # fmt: skip
define(**{function.__name__: function for function in NAMED})
