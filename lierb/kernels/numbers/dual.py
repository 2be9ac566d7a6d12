"""Dual numbers x + Σ xᵢ εᵢ, where εᵢ εⱼ = 0, differentiate a formula exactly.

Values and parts are numbers of any kind: floats, arrays, traced lanes, or, for second derivatives,
dual numbers. Values have the same bits as without derivatives.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterator
from functools import wraps
from itertools import islice
from typing import Any

from lierb.kernels.numbers.arithmetic import (
    Turn,
    absolute,
    alike,
    apart,
    class_of,
    flatten,
    floor,
    fma,
    joined,
    maximum,
    minimum,
    plain,
    refilled,
    repeat,
    rint,
    sqrt,
    where,
)
from lierb.kernels.numbers.number import Number
from lierb.kernels.numbers.trigonometry import atan2, sincos
from lierb.kernels.numbers.zero import ZERO, is_zero


def _compares(holds: Callable[[Any, Any], Any]) -> Any:
    return lambda self, other: holds(raw(self), raw(other))


class Dual:
    """A dual number has derivatives, `parts`, along some directions; () without directions."""

    __slots__ = ("parts", "value")
    __array_ufunc__: Any = None
    __hash__ = None  # type: ignore[assignment]
    rank = 3
    _fields = ("value", "parts")  # compiled code holds a dual number as a named tuple

    def __init__(self, value: Number, parts: tuple[Any, ...] = ()) -> None:
        self.value = value
        self.parts = parts

    def trace_of(self) -> Any:
        return class_of(type(self.value)).trace_of(self.value)

    def __add__(self, other: Number) -> Any:
        if is_zero(other):
            return self
        parts = tuple(p + q for p, q in side_by_side(self, other))
        return Dual(self.value + value_of(other), parts)

    __radd__ = __add__

    def __sub__(self, other: Number) -> Any:
        if is_zero(other):
            return self
        parts = tuple(p - q for p, q in side_by_side(self, other))
        return Dual(self.value - value_of(other), parts)

    def __rsub__(self, other: Number) -> Any:
        return Dual(other - self.value, tuple(-p for p in self.parts))

    def __mul__(self, other: Number) -> Any:
        return ZERO if is_zero(other) else self.fma(self, other, ZERO)

    __rmul__ = __mul__

    def __truediv__(self, other: Number) -> Any:
        inverse = 1.0 / value_of(other)
        value = self.value / value_of(other)
        parts = (fma(-value, q, p) * inverse for p, q in side_by_side(self, other))
        return Dual(value, tuple(parts))

    def __rtruediv__(self, other: Number) -> Any:
        value = other / self.value
        return self.along(-(value / self.value), value)

    def __neg__(self) -> Any:
        return type(self)(-self.value, tuple(-part for part in self.parts))

    __lt__, __le__ = _compares(operator.lt), _compares(operator.le)
    __gt__, __ge__ = _compares(operator.gt), _compares(operator.ge)
    __eq__ = _compares(operator.eq)

    def along(self, slope: Number, value: Number) -> Any:
        """Return f(self), for `value` and `slope` of f and f′ at the number's value."""
        return type(self)(value, tuple(slope * part for part in self.parts))

    @staticmethod
    def call(formula: Callable[..., Any], count: int, *numbers: Number) -> Any:
        """Call a formula of one number apart, for values and slopes; see `arithmetic.apart`.

        A formula of several numbers is inlined.
        """
        if len(numbers) > 1:
            return formula(*numbers)
        x: Any = numbers[0]

        def with_slopes(z: Number) -> tuple[Any, ...]:
            results = formula(Dual(z, (1.0,)))
            slopes = (parts_of(y)[0] for y in results)
            # a slope may be a constant, which traced code cannot return
            numbers = (0.0 * z + s if isinstance(s, float) else s for s in slopes)
            return (*map(value_of, results), *numbers)

        with_slopes.__module__ = formula.__module__
        with_slopes.__qualname__ = f"{formula.__qualname__}.with_slopes"
        results = apart(2 * count)(with_slopes)(x.value)
        pairs = zip(results[:count], results[count:], strict=True)
        return tuple(x.along(slope, value) for value, slope in pairs)

    @classmethod
    def joined(cls, a: Number, b: Number, join: Callable[[Any, Any], Any]) -> Any:
        value = joined(value_of(a), value_of(b), join)
        return cls(value, tuple(joined(p, q, join) for p, q in side_by_side(a, b)))

    @staticmethod
    def fma(a: Number, b: Number, c: Number) -> Any:
        x, y = value_of(a), value_of(b)
        parts = tuple(fma(y, p, fma(x, q, r)) for p, q, r in side_by_side(a, b, c))
        return Dual(fma(x, y, value_of(c)), parts)

    @staticmethod
    def repeat(start: Any, turn: Turn, most: int, like: Dual) -> tuple[Any, Any, Any]:
        """Repeat `turn` on values and parts; the values alone decide when a lane is finished."""
        count = len(like.parts)

        def spread(numbers: Any) -> tuple[Any, ...]:
            duals = ((value_of(x), parts_of(x) or (ZERO,) * count) for x in flatten(numbers))
            return tuple(part for value, parts in duals for part in (value, *parts))

        def gathered(members: tuple[Any, ...]) -> Any:
            rest = iter(members)
            duals = (type(like)(value, tuple(islice(rest, count))) for value in rest)
            return refilled(start, duals)

        def inner(members: tuple[Any, ...]) -> tuple[Any, Any]:
            numbers, is_unfinished = turn(gathered(members))
            return spread(numbers), is_unfinished

        members, is_unfinished, turns = repeat(spread(start), inner, most, like.value)
        return gathered(members), is_unfinished, turns

    @staticmethod
    def sqrt(x: Dual) -> Any:
        root = sqrt(x.value)
        # Slope 0 at zero: then ‖v‖ is finite there, and the derivative of ‖v‖v is right.
        is_zero_there = raw(root) == 0.0
        return x.along(where(is_zero_there, 0.0, 0.5 / where(is_zero_there, 1.0, root)), root)

    @staticmethod
    def absolute(x: Dual) -> Any:
        return x.along(where(raw(x) < 0.0, -1.0, 1.0), absolute(x.value))

    @staticmethod
    def rint(x: Dual) -> Any:
        return rint(x.value)

    @staticmethod
    def floor(x: Dual) -> Any:
        return floor(x.value)

    @staticmethod
    def minimum(a: Number, b: Number) -> Any:
        return _either(minimum(value_of(a), value_of(b)), a, b)

    @staticmethod
    def maximum(a: Number, b: Number) -> Any:
        return _either(maximum(value_of(a), value_of(b)), a, b)

    @staticmethod
    def sincos(x: Dual) -> Any:
        sine, cosine = sincos(x.value)
        return x.along(cosine, sine), x.along(-sine, cosine)

    @staticmethod
    def atan2(y: Number, x: Number) -> Any:
        top, right = value_of(y), value_of(x)
        inverse = 1.0 / fma(top, top, right * right)
        parts = (inverse * fma(right, p, -(top * q)) for p, q in side_by_side(y, x))
        return Dual(atan2(top, right), tuple(parts))


def by_chain_rule(formula: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """Decorate a formula of one number: its slopes are computed once for all directions."""

    @wraps(formula)
    def evaluated(x: Number) -> Any:
        if type(x) is not Dual:
            return formula(x)
        if not x.parts:
            return lifted(evaluated(x.value))

        def with_slopes(z: Number) -> tuple[Any, Any]:
            results = formula(Dual(z, (1.0,)))
            return values(results), _first_parts(results)

        return _along(x, *by_chain_rule(with_slopes)(x.value))

    return evaluated


def _first_parts(x: Any) -> Any:
    if isinstance(x, tuple):
        return alike(x, map(_first_parts, x))
    return parts_of(x)[0] if parts_of(x) else ZERO


def _along(x: Dual, value: Any, slope: Any) -> Any:
    """Apply `Dual.along` to nested tuples of values and slopes."""
    if isinstance(value, tuple):
        return alike(value, (_along(x, y, s) for y, s in zip(value, slope, strict=True)))
    return value if is_zero(slope) else x.along(slope, value)


def _either(value: Number, a: Number, b: Number) -> Dual:
    is_first = raw(value) == raw(a)  # false where a is NaN
    return Dual(value, tuple(where(is_first, p, q) for p, q in side_by_side(a, b)))


def value_of(x: Number) -> Any:
    return x.value if isinstance(x, Dual) else x


def values(x: Any) -> Any:
    """Return nested tuples of numbers without derivatives."""
    if isinstance(x, tuple):
        return alike(x, map(values, x))
    return value_of(x)


def lifted(x: Any) -> Any:
    """Return nested tuples of numbers with dual numbers as values of dual numbers without parts.

    Formulas can then be differentiated along other directions: beside Dual(Dual(x, p), q), a dual
    number that depends on those of p alone is Dual(Dual(x, p), ()).
    """
    if isinstance(x, tuple):
        return alike(x, map(lifted, x))
    return Dual(x) if isinstance(x, Dual) else x


def parts_of(x: Number) -> tuple[Any, ...]:
    return x.parts if isinstance(x, Dual) else ()


def side_by_side(*numbers: Number) -> Iterator[tuple[Any, ...]]:
    """Return the parts of several numbers by direction; zeros for a number without parts."""
    parts = [parts_of(x) for x in numbers]
    nothing = (ZERO,) * max(map(len, parts))
    return zip(*(p or nothing for p in parts), strict=True)


def raw(x: Number) -> Any:
    """Return the value of a number, also of nested dual numbers."""
    while isinstance(x, Dual):
        x = x.value
    return plain(x)
