"""Check integers in functions that Numba compiles: overflow of 64 bits raises an error.

Python's integers have any number of digits. Numba's wrap at 64 bits, and a conversion of a larger
float is undefined. `CheckedIntegers` compiles a function with the implementations below in place of
Python's operators on integers and its conversions of floats to integers. Of the functions of
floats, only NumPy's are replaced, where Numba's values differ. Integers in arrays wrap, as
NumPy's do.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from inspect import signature
from typing import Any

import numba
import numpy as np
from numba import types
from numba.extending import intrinsic, overload

from lierb.compiler.internals import compiler_that_replaces

BEYOND = "a whole number beyond 64 bits; make it a float, such as 2.0**64 for 2**64"
NO_WHOLE = "a number that no integer of these bits is: NaN, infinite or too large"
BY_ZERO = "integer division or modulo by zero"
TO_NEGATIVE = "a whole number to a negative power; make it a float, such as 2.0**-n for 2**-n"
SHIFT = "negative shift count"

CHECKED: dict[tuple[Any, int], Callable[..., Any]] = {}
"""Replacements by (replaced operator, function or type, number of operands)."""


def _stands_for(*replaced: Any) -> Callable[[Any], Any]:
    """Register a function (argument types) → implementation, or None for other types."""

    def decorate(typed: Any) -> Any:
        def checked(*_: Any) -> Any:
            raise NotImplementedError(f"{typed.__name__} is for compiled code")

        overload(checked)(typed)
        count = len(signature(typed).parameters)
        CHECKED.update(dict.fromkeys(((each, count) for each in replaced), checked))
        return checked

    return decorate


def _kind(*kinds: types.Type) -> Any:
    """Return the common integer type, np.int64 or np.uint64; None if there is none."""
    if not all(isinstance(kind, (types.Integer, types.Boolean)) for kind in kinds):
        return None
    signed = [isinstance(kind, types.Boolean) or kind.signed for kind in kinds]
    return np.int64 if all(signed) else None if any(signed) else np.uint64


# ---- operators on integers; no annotations: Numba compares signatures --------------------------


def _with_overflow(operation: str) -> Any:
    """Return the intrinsic (a, b) → (a ∘ b modulo 2⁶⁴, overflow flag) for a 64-bit integer type."""

    @intrinsic
    def computed(context, a, b):
        instruction = f"{'s' if a.signed else 'u'}{operation}_with_overflow"

        def generate(context, builder, sig, values):
            pair = getattr(builder, instruction)(*values)
            parts = [builder.extract_value(pair, i) for i in range(2)]
            return context.make_tuple(builder, sig.return_type, parts)

        return types.Tuple((a, types.boolean))(a, b), generate

    return computed


def _checked(computed: Any) -> Any:
    def typed(a, b):
        whole = _kind(a, b)
        if whole is None:
            return None

        def implementation(a, b):
            result, is_beyond = computed(whole(a), whole(b))
            if is_beyond:
                raise OverflowError(BEYOND)
            return result

        return implementation

    return typed


plus = _stands_for(operator.add, operator.iadd)(_checked(_with_overflow("add")))
minus = _stands_for(operator.sub, operator.isub)(_checked(_with_overflow("sub")))
times = _stands_for(operator.mul, operator.imul)(_checked(_with_overflow("mul")))


@_stands_for(operator.neg)
def negative(a):
    whole = _kind(a)
    return None if whole is None else lambda a: minus(whole(0), a)


@_stands_for(abs)
def size(a):
    return None if _kind(a) is not np.int64 else lambda a: minus(0, a) if a < 0 else np.int64(a)


@_stands_for(pow, operator.pow, operator.ipow)
def power(a, b):
    whole = _kind(a)
    if whole is None or _kind(b) is None:
        return None

    def implementation(a, b):
        if b < 0:
            raise ValueError(TO_NEGATIVE)
        result, factor, rest = whole(1), whole(a), np.int64(b)
        while rest > 0:
            if rest & 1:
                result = times(result, factor)
            rest >>= 1
            if rest > 0:
                factor = times(factor, factor)
        return result

    return implementation


@_stands_for(operator.floordiv, operator.ifloordiv)
def quotient(a, b):
    whole = _kind(a, b)
    if whole is None:
        return None

    def implementation(a, b):
        x, y = whole(a), whole(b)
        if y == 0:
            raise ZeroDivisionError(BY_ZERO)
        return minus(whole(0), x) if y == -1 else x // y

    return implementation


@_stands_for(operator.mod, operator.imod)
def modulo(a, b):
    whole = _kind(a, b)
    if whole is None:
        return None

    def implementation(a, b):
        x, y = whole(a), whole(b)
        if y == 0:
            raise ZeroDivisionError(BY_ZERO)
        return whole(0) if y == -1 else x % y

    return implementation


@_stands_for(divmod)
def quotient_and_modulo(a, b):
    return None if _kind(a, b) is None else lambda a, b: (quotient(a, b), modulo(a, b))


@_stands_for(operator.lshift, operator.ilshift)
def left(a, b):
    whole = _kind(a)
    if whole is None or _kind(b) is None:
        return None

    def implementation(a, b):
        if b < 0:
            raise ValueError(SHIFT)
        return whole(0) if a == 0 else times(whole(a), power(whole(2), b))

    return implementation


@_stands_for(operator.rshift, operator.irshift)
def right(a, b):
    whole = _kind(a)
    if whole is None or _kind(b) is None:
        return None

    def implementation(a, b):
        if b < 0:
            raise ValueError(SHIFT)
        if b > 63:
            return whole(-1) if a < 0 else whole(0)
        return whole(a) >> b

    return implementation


def _are_whole(members: types.Type) -> bool:
    return _kind(getattr(members, "dtype", None)) is np.int64


@_stands_for(sum)
def total(members):
    return (lambda members: total_from(members, 0)) if _are_whole(members) else None


@_stands_for(sum)
def total_from(members, start):
    def implementation(members, start):
        result = np.int64(start)
        for member in members:
            result = plus(result, member)
        return result

    return implementation if _are_whole(members) and _kind(start) is np.int64 else None


# ---- conversions to integers ---------------------------------------------------------------------


def _whole_part(kind: types.Integer, whole: Any) -> Any:
    """Return the conversion of a float to an integer type, after rounding by `whole`."""
    lowest, beyond, convert = float(kind.minval), float(kind.maxval + 1), getattr(np, kind.name)

    def typed(x):
        def of_float(x):
            number = whole(np.float64(x))
            if not lowest <= number < beyond:
                raise OverflowError(NO_WHOLE)
            return convert(number)

        return of_float if isinstance(x, types.Float) else None

    return typed


def _of_kind(kind: types.Integer) -> Any:
    """Return the conversion of any number to an integer type."""
    of_float, convert = _whole_part(kind, np.trunc), getattr(np, kind.name)

    def typed(x):
        def of_integer(x):
            number = convert(x)
            if number != x:
                raise OverflowError(NO_WHOLE)
            return number

        return of_integer if isinstance(x, types.Integer) else of_float(x)

    return typed


_stands_for(int, math.trunc)(_whole_part(types.int64, np.trunc))
_stands_for(math.floor)(_whole_part(types.int64, np.floor))
_stands_for(math.ceil)(_whole_part(types.int64, np.ceil))
_stands_for(round)(_whole_part(types.int64, np.rint))
for _integer in types.integer_domain:  # np.int8 … np.uint64, as Numba types
    _stands_for(_integer)(_of_kind(_integer))


# ---- functions of floats whose values differ between Numba and NumPy ---------------------------


def _of_floats(computed: Any) -> Any:
    """Return the implementation computed(a, b) for numbers of which at least one is a float."""

    def typed(a, b):
        kinds = types.Float, types.Integer, types.Boolean
        if not (isinstance(a, kinds) and isinstance(b, kinds)):
            return None
        if _kind(a) and _kind(b):
            return None
        return lambda a, b: computed(np.float64(a), np.float64(b))

    return typed


_quotient = numba.njit(lambda a, b: a // b, error_model="numpy")
_remainder = numba.njit(lambda a, b: a % b, error_model="numpy")
_both = numba.njit(lambda a, b: (a // b, a % b), error_model="numpy")
_stands_for(np.floor_divide)(_of_floats(_quotient))  # Numba rounds a/b first
_stands_for(np.remainder)(_of_floats(_remainder))  # Numba's zero has the sign of a
_stands_for(np.divmod)(_of_floats(_both))

CheckedIntegers = compiler_that_replaces(CHECKED)
