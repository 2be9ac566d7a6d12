"""Dual numbers: x + Σ xᵢ εᵢ with εᵢ εⱼ = 0. Run through them, a formula is differentiated exactly.

Values and parts are of any number type: floats, arrays, traced lanes, or dual numbers again, for
second derivatives. A value has the bits that it has without derivatives.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import islice
from typing import Any

from lierb.kernels.numbers.arithmetic import (
    Turn,
    absolute,
    bearer,
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
from lierb.kernels.numbers.trigonometry import atan2, sincos
from lierb.kernels.numbers.zero import ZERO, is_zero


class Dual:
    """A value and its parts along some directions; () where nothing is differentiated."""

    __slots__ = ("parts", "value")
    __array_ufunc__: Any = None
    __hash__ = None  # type: ignore[assignment]
    rank = 3
    _fields = ("value", "parts")  # as of a named tuple, which it is to compiled code

    def __init__(self, value: Any, parts: tuple[Any, ...] = ()) -> None:
        self.value = value
        self.parts = parts

    def trace_of(self) -> Any:
        return bearer(type(self.value)).trace_of(self.value)

    def __add__(self, other: Any) -> Any:
        if is_zero(other):
            return self
        parts = tuple(p + q for p, q in side_by_side(self, other))
        return Dual(self.value + value_of(other), parts)

    __radd__ = __add__

    def __sub__(self, other: Any) -> Any:
        if is_zero(other):
            return self
        parts = tuple(p - q for p, q in side_by_side(self, other))
        return Dual(self.value - value_of(other), parts)

    def __rsub__(self, other: Any) -> Any:
        return Dual(other - self.value, tuple(-p for p in self.parts))

    def __mul__(self, other: Any) -> Any:
        return ZERO if is_zero(other) else self.fma(self, other, ZERO)

    __rmul__ = __mul__

    def __truediv__(self, other: Any) -> Any:
        inverse = 1.0 / value_of(other)
        value = self.value / value_of(other)
        parts = (fma(-value, q, p) * inverse for p, q in side_by_side(self, other))
        return Dual(value, tuple(parts))

    def __rtruediv__(self, other: Any) -> Any:
        value = other / self.value
        return self.along(-(value / self.value), value)

    def __neg__(self) -> Any:
        return type(self)(-self.value, tuple(-part for part in self.parts))

    def __lt__(self, other: Any) -> Any:
        return raw(self) < raw(other)

    def __le__(self, other: Any) -> Any:
        return raw(self) <= raw(other)

    def __gt__(self, other: Any) -> Any:
        return raw(self) > raw(other)

    def __ge__(self, other: Any) -> Any:
        return raw(self) >= raw(other)

    def __eq__(self, other: Any) -> Any:
        return raw(self) == raw(other)

    def along(self, slope: Any, value: Any) -> Any:
        """f(self), from f(value) and f′(value)."""
        return type(self)(value, tuple(slope * part for part in self.parts))

    @classmethod
    def joined(cls, a: Any, b: Any, join: Callable[[Any, Any], Any]) -> Any:
        value = joined(value_of(a), value_of(b), join)
        return cls(value, tuple(joined(p, q, join) for p, q in side_by_side(a, b)))

    @staticmethod
    def fma(a: Any, b: Any, c: Any) -> Any:
        x, y = value_of(a), value_of(b)
        parts = tuple(fma(y, p, fma(x, q, r)) for p, q, r in side_by_side(a, b, c))
        return Dual(fma(x, y, value_of(c)), parts)

    @staticmethod
    def repeat(start: Any, turn: Turn, most: int, like: Any) -> tuple[Any, Any, Any]:
        """Repeat on values and parts side by side; values alone say when a lane is finished."""
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
    def sqrt(x: Any) -> Any:
        root = sqrt(x.value)
        # of a norm at zero it is a slope that does no harm: ‖v‖v has one there
        is_zero_there = raw(root) == 0.0
        return x.along(where(is_zero_there, 0.0, 0.5 / where(is_zero_there, 1.0, root)), root)

    @staticmethod
    def absolute(x: Any) -> Any:
        return x.along(where(raw(x) < 0.0, -1.0, 1.0), absolute(x.value))

    @staticmethod
    def rint(x: Any) -> Any:
        return rint(x.value)

    @staticmethod
    def floor(x: Any) -> Any:
        return floor(x.value)

    @staticmethod
    def minimum(a: Any, b: Any) -> Any:
        return _either(minimum(value_of(a), value_of(b)), a, b)

    @staticmethod
    def maximum(a: Any, b: Any) -> Any:
        return _either(maximum(value_of(a), value_of(b)), a, b)

    @staticmethod
    def sincos(x: Any) -> Any:
        sine, cosine = sincos(x.value)
        return x.along(cosine, sine), x.along(-sine, cosine)

    @staticmethod
    def atan2(y: Any, x: Any) -> Any:
        top, right = value_of(y), value_of(x)
        inverse = 1.0 / fma(top, top, right * right)
        parts = (inverse * fma(right, p, -(top * q)) for p, q in side_by_side(y, x))
        return Dual(atan2(top, right), tuple(parts))


def _either(value: Any, a: Any, b: Any) -> Dual:
    is_first = raw(value) == raw(a)  # the value is the number, of a number and NaN
    return Dual(value, tuple(where(is_first, p, q) for p, q in side_by_side(a, b)))


def value_of(x: Any) -> Any:
    return x.value if isinstance(x, Dual) else x


def parts_of(x: Any) -> tuple[Any, ...]:
    return x.parts if isinstance(x, Dual) else ()


def side_by_side(*numbers: Any) -> Iterator[tuple[Any, ...]]:
    """Their parts, direction by direction; zeros for one without."""
    parts = [parts_of(x) for x in numbers]
    nothing = (ZERO,) * max(map(len, parts))
    return zip(*(p or nothing for p in parts), strict=True)


def raw(x: Any) -> Any:
    """The number itself, with no derivative left."""
    while isinstance(x, Dual):
        x = x.value
    return plain(x)
