"""Replace Python's `math` and built-in functions in traces of users' functions."""

from __future__ import annotations

import math
import types
from collections.abc import Callable, Iterator
from functools import reduce
from typing import Any

from lierb.kernels.functions.elementary import IN_NUMPY, erf, erfc, log
from lierb.kernels.functions.elementwise import BY_NAME
from lierb.kernels.functions.object_arrays import UntraceableError, has_traced
from lierb.kernels.functions.user_number import Float, as_condition, choice, raw


def logarithm(x: Any, base: float | None = None) -> Any:
    return log(x) if base is None else log(x) / math.log(base)


def _largest(*numbers: Any) -> Any:
    return _folded(numbers, lambda a, b: choice(raw(b) > raw(a), b, a))


def _smallest(*numbers: Any) -> Any:
    return _folded(numbers, lambda a, b: choice(raw(b) < raw(a), b, a))


def _folded(numbers: tuple[Any, ...], either: Callable[[Any, Any], Any]) -> Any:
    """Fold numbers, or one sequence of numbers, by `either`, as Python's max does."""
    return reduce(either, numbers[0] if len(numbers) == 1 else numbers)


def _every(conditions: Any) -> Any:
    return reduce(lambda a, b: a & b, [as_condition(x) for x in conditions], True)


def _any(conditions: Any) -> Any:
    return reduce(lambda a, b: a | b, [as_condition(x) for x in conditions], False)


SAME_AS_NUMPY = (
    "acos", "acosh", "asin", "asinh", "atan", "atan2", "atanh", "cbrt", "ceil", "copysign", "cos",
    "cosh", "degrees", "exp", "exp2", "expm1", "fabs", "floor", "fmod", "hypot", "isfinite",
    "isinf", "isnan", "log10", "log1p", "log2", "pow", "radians", "sin", "sinh", "sqrt", "tan",
    "tanh", "trunc",
)  # fmt: skip
ON_TRACED: dict[Any, Callable[..., Any]] = {
    getattr(math, name): BY_NAME[IN_NUMPY.get(name, name)] for name in SAME_AS_NUMPY
} | {
    math.log: logarithm, math.erf: erf, math.erfc: erfc,
    max: _largest, min: _smallest, all: _every, any: _any,
}  # fmt: skip


def _where_traced(function: Any) -> Any:
    """Wrap a function so that its replacement runs if an argument is traced."""
    replacement = ON_TRACED.get(function)

    def either(*arguments: Any, **options: Any) -> Any:
        if len(arguments) == 1 and isinstance(arguments[0], Iterator):
            arguments = (list(arguments[0]),)
        if not any(map(has_traced, arguments)):
            return function(*arguments, **options)
        if replacement is None:
            raise UntraceableError(
                f"math.{function.__name__} does not take numbers of many bodies; write it with "
                "operators and what docs/forces.md lists"
            )
        return replacement(*arguments, **options)

    either.__name__ = function.__name__
    return either


_REPLACED: dict[Any, Any] = {float: Float} | {
    function: _where_traced(function)
    for function in (*ON_TRACED, *vars(math).values())
    if callable(function)
}
_MATH = types.SimpleNamespace(
    **vars(math) | {f.__name__: new for f, new in _REPLACED.items() if f.__module__ == "math"}
)


def for_traces_of(value: Any) -> Any:
    """Return the replacement of `math`, of its functions or of built-ins; other values as is."""
    if value is math:
        return _MATH
    is_function = isinstance(value, (types.BuiltinFunctionType, types.FunctionType, type))
    return _REPLACED.get(value, value) if is_function else value
