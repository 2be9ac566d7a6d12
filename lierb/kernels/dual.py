"""Dual numbers: x + Σ xᵢ εᵢ with εᵢ εⱼ = 0. Run through them, a function is differentiated exactly.

They are what functions of the user's compute with. Values and parts are of any number type: floats,
arrays, traced lanes, or dual numbers again, for second derivatives. Without parts they are plain
numbers with the operators, the methods and the NumPy functions that users expect.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from lierb.kernels import lanes
from lierb.kernels.arithmetic import absolute, all_lanes, branch, fma, plain
from lierb.kernels.arithmetic import sqrt as root
from lierb.kernels.arithmetic import where as select
from lierb.kernels.coefficients import SINCOS_RANGE, atan2, sincos
from lierb.kernels.lanes import Lane
from lierb.kernels.zero import ZERO, is_zero


class Dual:
    """A value and its parts along some directions; () where nothing is differentiated.

    factors : the two numbers whose product it is, if it is one: a sum with it is then fused.
    """

    __slots__ = ("value", "parts", "factors")
    __hash__ = None  # type: ignore[assignment]

    def __init__(
        self, value: Any, parts: tuple[Any, ...] = (), factors: tuple[Any, ...] = ()
    ) -> None:
        self.value = value
        self.parts = parts
        self.factors = factors

    def __repr__(self) -> str:
        return f"Dual({self.value!r}, {self.parts!r})"

    def _along(self, slope: Any, value: Any) -> Dual:
        """f(self), from f(value) and f′(value)."""
        return Dual(value, tuple(slope * part for part in self.parts))

    def __add__(self, other: Any) -> Any:
        return _combined(self, other, _sum, 1.0, 1.0)

    __radd__ = __add__

    def __sub__(self, other: Any) -> Any:
        return _combined(self, other, _difference, 1.0, -1.0)

    def __rsub__(self, other: Any) -> Any:
        return _combined(other, self, _difference, 1.0, -1.0)

    def __mul__(self, other: Any) -> Any:
        if isinstance(other, np.ndarray):
            return NotImplemented
        factors = self.value, _value(other)
        product = _combined(self, other, lambda x, y: factors[0] * factors[1], *factors[::-1])
        product.factors = factors
        return product

    __rmul__ = __mul__

    def __truediv__(self, other: Any) -> Any:
        return _quotient(self, other)

    def __rtruediv__(self, other: Any) -> Any:
        return _quotient(other, self)

    def __neg__(self) -> Dual:
        return Dual(-self.value, tuple(-part for part in self.parts))

    def __pos__(self) -> Dual:
        return self

    def __abs__(self) -> Dual:
        sign = _chosen(self.value < 0.0, -1.0, 1.0)
        return self._along(sign, absolute_value(self.value))

    def __pow__(self, exponent: Any) -> Any:
        return power(self, exponent)

    def __rpow__(self, base: Any) -> Any:
        return power(base, self)

    def __lt__(self, other: Any) -> Any:
        return self.value < _value(other)

    def __le__(self, other: Any) -> Any:
        return self.value <= _value(other)

    def __gt__(self, other: Any) -> Any:
        return self.value > _value(other)

    def __ge__(self, other: Any) -> Any:
        return self.value >= _value(other)

    def __eq__(self, other: Any) -> Any:
        return self.value == _value(other)

    def __ne__(self, other: Any) -> Any:
        return (self.value < _value(other)) | (self.value > _value(other))

    def __bool__(self) -> bool:
        raise TypeError("it branches on a number: use lierb.where(condition, a, b), not if")

    def __float__(self) -> float:
        raise TypeError("it needs a plain number, which one of many bodies at once is not")

    __int__ = __index__ = __float__

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **options: Any) -> Any:
        """NumPy's functions, member by member: on objects they call the operators and methods."""
        if method != "__call__":
            return NotImplemented
        if ufunc in _BY_COMPARISON and not any(isinstance(x, np.ndarray) for x in inputs):
            return _BY_COMPARISON[ufunc](*inputs)
        return ufunc(*(_boxed(x) if isinstance(x, Dual) else x for x in inputs), **options)


def _boxed(x: Dual) -> Any:
    box = np.empty((), dtype=object)
    box[()] = x
    return box


def _value(x: Any) -> Any:
    return x.value if isinstance(x, Dual) else x


def _combined(a: Any, b: Any, operation: Callable[[Any, Any], Any], left: Any, right: Any) -> Any:
    """operation(a, b), with the derivatives `left` and `right` of its value."""
    if isinstance(a, np.ndarray) or isinstance(b, np.ndarray):
        return NotImplemented
    value = operation(a, b)
    a_parts, b_parts = _parts(a), _parts(b)
    count = max(len(a_parts), len(b_parts))
    nothing = (ZERO,) * count
    return Dual(
        value,
        tuple(
            _total(left, p, right, q)
            for p, q in zip(a_parts or nothing, b_parts or nothing, strict=True)
        ),
    )


def _sum(a: Any, b: Any) -> Any:
    for x, y in ((a, b), (b, a)):
        if isinstance(x, Dual) and x.factors:
            left, right = x.factors
            return _fused(left, right, _value(y))
    return _value(a) + _value(b)


def _fused(a: Any, b: Any, c: Any) -> Any:
    return a * b + c if any(isinstance(x, Dual) for x in (a, b, c)) else fma(a, b, c)


def _difference(a: Any, b: Any) -> Any:
    return _value(a) - _value(b)  # not fused: x·x − x·x shall be zero


def _parts(x: Any) -> tuple[Any, ...]:
    return x.parts if isinstance(x, Dual) else ()


def _total(left: Any, p: Any, right: Any, q: Any) -> Any:
    """left·p + right·q; slopes of ±1 cost no product."""
    if _is_sign(left):
        return _scaled(left, p) + _scaled(right, q)
    return _fused(left, p, _scaled(right, q))


def _scaled(slope: Any, part: Any) -> Any:
    if is_zero(part):
        return ZERO
    if _is_sign(slope):
        return part if slope == 1.0 else -part
    return slope * part


def _is_sign(slope: Any) -> bool:
    return isinstance(slope, float) and slope in (1.0, -1.0)


def _quotient(a: Any, b: Any) -> Any:
    if isinstance(a, np.ndarray) or isinstance(b, np.ndarray):
        return NotImplemented
    top, bottom = _value(a), _value(b)
    if not _parts(b):
        return Dual(top / bottom, tuple(part / bottom for part in _parts(a)))
    inverse = 1.0 / bottom
    value = top * inverse
    return _combined(a, b, lambda x, y: value, inverse, -(value * inverse))


def where(condition: Any, a: Any, b: Any) -> Any:
    """`a` where the condition holds, `b` elsewhere: for functions given to lierb, instead of `if`.

    Numbers, or tuples and arrays of them. Both are computed.
    """
    if isinstance(a, np.ndarray) or isinstance(b, np.ndarray):
        pairs = np.broadcast(a, b)
        chosen = np.empty(pairs.shape, dtype=object)
        chosen[...] = np.array([where(condition, x, y) for x, y in pairs], object).reshape(
            pairs.shape
        )
        return chosen
    if isinstance(a, (tuple, list)):
        return tuple(where(condition, x, y) for x, y in zip(a, b, strict=True))
    chosen = _chosen(condition, a, b)
    of_constants = not isinstance(a, Lane) and not isinstance(b, Lane)
    return Dual(chosen) if of_constants and isinstance(chosen, Lane) else chosen


def _chosen(condition: Any, a: Any, b: Any) -> Any:
    if not (isinstance(a, Dual) or isinstance(b, Dual)):
        return select(condition, a, b)
    nothing = (ZERO,) * max(len(_parts(a)), len(_parts(b)))
    parts = zip(_parts(a) or nothing, _parts(b) or nothing, strict=True)
    return Dual(
        _chosen(condition, _value(a), _value(b)),
        tuple(_chosen(condition, p, q) for p, q in parts),
    )


# ---- elementary functions ----------------------------------------------------------------------


def absolute_value(x: Any) -> Any:
    return abs(x) if isinstance(x, Dual) else absolute(x)


def _library(name: str, *operands: Any) -> Any:
    """The C library's function, number by number."""
    if any(isinstance(x, Lane) for x in operands):
        return lanes.call_library(name, *map(plain, operands))
    numpy_name = {"pow": "power", "asin": "arcsin", "acos": "arccos", "fmod": "fmod"}
    return getattr(np, numpy_name.get(name, name))(*map(plain, operands))


def _sine_or_cosine(name: str, x: Any) -> Any:
    if is_zero(x):
        return ZERO if name == "sin" else 1.0
    which = 0 if name == "sin" else 1
    near = absolute(x) <= SINCOS_RANGE
    return branch(
        all_lanes(near),
        lambda: sincos(x)[which],
        lambda: select(near, sincos(x)[which], _library(name, x)),
    )


def _elementary(
    name: str, of: Callable[[Any], Any], slope: Callable[[Any, Any], Any]
) -> Callable[[Any], Any]:
    """The function `name` from its value and from its slope at (x, value)."""

    def function(x: Any) -> Any:
        if isinstance(x, np.ndarray) and x.dtype == object:
            return np.frompyfunc(function, 1, 1)(x)
        if not isinstance(x, Dual):
            return of(x)
        value = function(x.value)
        return x._along(slope(x.value, value), value) if x.parts else Dual(value)

    function.__name__ = name
    return function


sin: Callable[[Any], Any] = _elementary("sin", partial(_sine_or_cosine, "sin"), lambda x, y: cos(x))
cos: Callable[[Any], Any] = _elementary(
    "cos", partial(_sine_or_cosine, "cos"), lambda x, y: -sin(x)
)
tan = _elementary("tan", partial(_library, "tan"), lambda x, y: 1.0 + y * y)
exp = _elementary("exp", partial(_library, "exp"), lambda x, y: y)
expm1 = _elementary("expm1", partial(_library, "expm1"), lambda x, y: y + 1.0)
log = _elementary("log", partial(_library, "log"), lambda x, y: 1.0 / x)
log1p = _elementary("log1p", partial(_library, "log1p"), lambda x, y: 1.0 / (1.0 + x))
sqrt = _elementary("sqrt", root, lambda x, y: 0.5 / y)
sinh: Callable[[Any], Any] = _elementary("sinh", partial(_library, "sinh"), lambda x, y: cosh(x))
cosh: Callable[[Any], Any] = _elementary("cosh", partial(_library, "cosh"), lambda x, y: sinh(x))
tanh = _elementary("tanh", partial(_library, "tanh"), lambda x, y: 1.0 - y * y)
arcsin = _elementary(
    "arcsin", partial(_library, "asin"), lambda x, y: 1.0 / sqrt((1.0 - x) * (1.0 + x))
)
arccos = _elementary(
    "arccos", partial(_library, "acos"), lambda x, y: -1.0 / sqrt((1.0 - x) * (1.0 + x))
)
arctan = _elementary("arctan", lambda x: atan2(x, 1.0), lambda x, y: 1.0 / (1.0 + x * x))


def arctan2(y: Any, x: Any) -> Any:
    """The angle of (x, y), rad."""
    if not (isinstance(y, Dual) or isinstance(x, Dual)):
        return atan2(y, x)
    top, right = _value(y), _value(x)
    value = arctan2(top, right)
    if not (_parts(y) or _parts(x)):
        return Dual(value)
    inverse = 1.0 / (top * top + right * right)
    return _combined(y, x, lambda a, b: value, right * inverse, -(top * inverse))


def power(base: Any, exponent: Any) -> Any:
    """base ** exponent; a whole exponent by products."""
    if isinstance(exponent, (int, np.integer)) or (
        isinstance(exponent, float) and exponent.is_integer() and abs(exponent) <= 16
    ):
        return _whole_power(base, int(exponent))
    if isinstance(exponent, float) and abs(exponent) == 0.5:
        return sqrt(base) if exponent > 0.0 else 1.0 / sqrt(base)
    if not (isinstance(base, Dual) or isinstance(exponent, Dual)):
        return _library("pow", base, exponent)
    x, n = _value(base), _value(exponent)
    value = power(x, n)
    if not (_parts(base) or _parts(exponent)):
        return Dual(value)
    by_exponent = value * log(x) if _parts(exponent) else ZERO
    return _combined(base, exponent, lambda a, b: value, n * power(x, n - 1.0), by_exponent)


def _whole_power(base: Any, exponent: int) -> Any:
    if exponent < 0:
        return 1.0 / _whole_power(base, -exponent)
    if exponent < 2:
        return base if exponent else 1.0
    half = _whole_power(base, exponent // 2)
    return half * half * base if exponent % 2 else half * half


def hypot(*numbers: Any) -> Any:
    return sqrt(sum(x * x for x in numbers))


def logarithm(x: Any, base: float | None = None) -> Any:
    return log(x) if base is None else log(x) / math.log(base)


def log10(x: Any) -> Any:
    return log(x) / math.log(10.0)


def log2(x: Any) -> Any:
    return log(x) / math.log(2.0)


class _Float(float):
    """`float` in functions of the user's: numbers of many bodies stay what they are."""

    def __new__(cls, x: Any = 0.0) -> Any:
        return x if isinstance(x, Dual) else float(x)


def copysign(x: Any, y: Any) -> Any:
    size = absolute_value(x)
    return where(_value(y) < 0.0, -size, size)


def larger(*numbers: Any) -> Any:
    """The largest of several numbers, or of a sequence."""
    return _folded(numbers, lambda a, b: where(a >= b, a, b))


def smaller(*numbers: Any) -> Any:
    """The smallest of several numbers, or of a sequence."""
    return _folded(numbers, lambda a, b: where(a <= b, a, b))


def _folded(numbers: tuple[Any, ...], chosen: Callable[[Any, Any], Any]) -> Any:
    members = list(numbers[0]) if len(numbers) == 1 else list(numbers)
    result = members[0]
    for x in members[1:]:
        result = chosen(result, x)
    return result


def sign(x: Any) -> Any:
    value = _value(x)
    found = _chosen(value > 0.0, 1.0, _chosen(value < 0.0, -1.0, 0.0 * value))
    return Dual(found) if isinstance(x, Dual) else found


_METHODS = (
    sin, cos, tan, exp, expm1, log, log1p, log10, log2, sqrt, sinh, cosh, tanh, arcsin, arccos,
    arctan, arctan2, hypot,
)  # fmt: skip
for _function in _METHODS:  # what NumPy calls on objects
    setattr(Dual, _function.__name__, _function)

_BY_COMPARISON = {
    np.maximum: larger, np.minimum: smaller, np.fmax: larger, np.fmin: smaller, np.sign: sign,
    np.copysign: copysign, np.float_power: power, np.arctan2: arctan2, np.hypot: hypot,
}  # fmt: skip

# What stands for the functions of `math`, and for built-in ones, in functions of the user's.
REPLACEMENTS: dict[Any, Any] = {
    math.sin: sin, math.cos: cos, math.tan: tan, math.exp: exp, math.expm1: expm1,
    math.log: logarithm,
    math.log10: log10, math.log2: log2, math.radians: lambda x: x * (math.pi / 180.0),
    math.degrees: lambda x: x * (180.0 / math.pi),
    math.log1p: log1p, math.sqrt: sqrt, math.sinh: sinh, math.cosh: cosh, math.tanh: tanh,
    math.asin: arcsin, math.acos: arccos, math.atan: arctan, math.atan2: arctan2,
    math.hypot: hypot, math.pow: power, math.fabs: absolute_value, math.copysign: copysign,
    max: larger, min: smaller, float: _Float,
}  # fmt: skip
