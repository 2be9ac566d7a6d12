"""Choices, norms and functions of small matrices are written out for traced numbers."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import reduce
from typing import Any

import numpy as np

from lierb.kernels.functions import elementary, steps
from lierb.kernels.functions.object_arrays import UntraceableError, filled, numbers, objects
from lierb.kernels.functions.references import UnfitFunctionError
from lierb.kernels.functions.user_number import choice, raw
from lierb.kernels.numbers.arithmetic import absolute

NEAR = 0.5  # rad; below it the series of sin y/y, whose other terms are less than 1e-19
SINC = tuple((-1.0) ** k / math.factorial(2 * k + 1) for k in range(9))
MOST_ROWS = 4  # largest matrix to invert: its determinant is written out as n! terms


def _each(function: Callable[..., Any], *arrays: Any) -> Any:
    """Apply a function of numbers element by element."""
    return np.frompyfunc(function, len(arrays), 1)(*map(objects, arrays))


def _where(condition: Any, a: Any = None, b: Any = None) -> Any:
    if a is None or b is None:
        raise UntraceableError(
            "np.where with a condition alone returns indices, which differ between bodies; write "
            "np.where(condition, a, b)"
        )
    return _each(choice, condition, a, b)


def _clip(x: Any, a_min: Any = None, a_max: Any = None, out: Any = None, **bounds: Any) -> Any:
    return _each(steps.clipped, x, bounds.get("min", a_min), bounds.get("max", a_max))


def _interp(
    x: Any, xp: Any, fp: Any, left: Any = None, right: Any = None, period: Any = None
) -> Any:
    if period is not None:
        raise UntraceableError("np.interp with a period: write np.interp(x % period, xp, fp)")
    xs, ys = list(xp), list(fp)
    return _each(lambda one: steps.interpolated(one, xs, ys, left, right), x)


def _select(conditions: Any, choices: Any, default: Any = 0.0) -> Any:
    result = default
    for condition, chosen in reversed(list(zip(conditions, choices, strict=True))):
        result = _where(condition, chosen, result)
    return result


def _piecewise(x: Any, conditions: Any, functions: Any, *given: Any) -> Any:
    conditions, functions = list(conditions), list(functions)
    default: Any = functions.pop() if len(functions) > len(conditions) else 0.0
    choices = [f(x, *given) if callable(f) else f for f in (*functions, default)]
    return _select(conditions, choices[: len(conditions)], choices[-1] if default else 0.0)


def _einsum(subscripts: Any, *operands: Any, optimize: Any = False) -> Any:
    return np.einsum(subscripts, *(np.asarray(objects(x)) for x in operands))


def _norm(x: Any, ord: Any = None, axis: Any = None, keepdims: bool = False) -> Any:
    x = numbers(x)
    is_vector = isinstance(axis, int) or (axis is None and x.ndim == 1)
    if ord in (None, "fro") or (ord == 2 and is_vector):
        if axis is None:
            size = np.sqrt(x.ravel() @ x.ravel())
            return numbers([size]).reshape((1,) * x.ndim) if keepdims else size
        return np.sqrt((x * x).sum(axis=axis, keepdims=keepdims))
    if is_vector and ord in (1, np.inf, -np.inf):
        of: Any = {1: np.add, np.inf: np.maximum, -np.inf: np.minimum}[ord]
        return of.reduce(abs(x), axis=-1 if axis is None else axis, keepdims=keepdims)
    raise UntraceableError(f"np.linalg.norm has ord {ord!r} for constants only; write it out")


def _matrix(values: Any) -> Any:
    a = np.asarray(objects(values))
    if a.ndim != 2 or a.shape[0] != a.shape[1]:
        raise UnfitFunctionError(f"a square matrix is needed, not an array of shape {a.shape}")
    if len(a) > MOST_ROWS:
        raise UntraceableError(
            f"a {len(a)}×{len(a)} matrix of numbers of many bodies: at most {MOST_ROWS}×{MOST_ROWS}"
        )
    return a


def _determinant(a: Any) -> Any:
    if len(a) < 2:
        return a[0, 0] if len(a) else 1.0
    rest = np.arange(len(a))
    terms = (a[0, j] * _determinant(a[1:][:, rest != j]) * (-1.0) ** j for j in rest.tolist())
    return reduce(lambda x, y: x + y, terms)


def _inv(values: Any) -> Any:
    a = _matrix(values)
    rest = np.arange(len(a))
    adjugate = np.empty_like(a)
    for i in rest.tolist():
        for j in rest.tolist():
            adjugate[j, i] = _determinant(a[rest != i][:, rest != j]) * (-1.0) ** (i + j)
    return adjugate * (1.0 / (a[0] @ adjugate[:, 0]))


def _cross(
    a: Any, b: Any, axisa: int = -1, axisb: int = -1, axisc: int = -1, axis: int | None = None
) -> Any:
    # np.cross on rows: for single vectors, releases before 2.3 allocate the result as floats if the
    # first product is of constants, and cannot write traced numbers into it.
    if axis is not None:
        axisa = axisb = axisc = axis
    a, b = (np.moveaxis(np.asarray(objects(x)), i, -1)[None] for x, i in ((a, axisa), (b, axisb)))
    product = np.cross(a, b)[0]
    return product if a.shape[-1] == b.shape[-1] == 2 else np.moveaxis(product, -1, axisc)


def _reduction(ufunc: Any) -> Callable[..., Any]:
    return lambda x, axis=None, **options: ufunc.reduce(numbers(x), axis=axis, **options)


def _sinc(x: Any) -> Any:
    def one(x: Any) -> Any:
        y = math.pi * x
        square, series = y * y, 0.0
        for coefficient in reversed(SINC):
            series = series * square + coefficient
        is_near = absolute(raw(y)) < NEAR
        far = choice(is_near, 1.0, y)
        # Derivatives of sin y/y are differences of nearly equal numbers near zero.
        return choice(is_near, series, elementary.sin(far) / far)

    return _each(one, x)


def _round(x: Any, decimals: int = 0, out: Any = None) -> Any:
    return _each(lambda one: steps.rounded(one, decimals), x)


def _isclose(
    a: Any, b: Any, rtol: float = 1e-5, atol: float = 1e-8, equal_nan: bool = False
) -> Any:
    a, b = numbers(a), numbers(b)
    close = (abs(a - b) <= atol + rtol * abs(b)) & np.isfinite(b) | (a == b)
    return close | np.isnan(a) & np.isnan(b) if equal_nan else close


def _linspace(start: Any, stop: Any, num: int = 50) -> Any:
    return start + np.arange(num) * ((stop - start) / max(num - 1, 1))


_FINITE = (-np.finfo(float).max, np.finfo(float).max)


def _nan_to_num(
    x: Any,
    copy: bool = True,
    nan: float = 0.0,
    posinf: float | None = None,
    neginf: float | None = None,
) -> Any:
    least, most = (given if given is not None else limit
                   for given, limit in zip((neginf, posinf), _FINITE))  # fmt: skip

    def finite(one: Any) -> Any:
        one = choice(one == np.inf, most, choice(one == -np.inf, least, one))
        return choice(steps.isnan(one), nan, one)

    return _each(finite, x)


def _filled_like(value: Any) -> Callable[..., Any]:
    return lambda x, *_, **__: filled(np.shape(x), value)


SPELLED_OUT: dict[Any, Callable[..., Any]] = {
    np.where: _where, np.clip: _clip, np.interp: _interp, np.select: _select,
    np.piecewise: _piecewise, np.einsum: _einsum, np.linalg.norm: _norm, np.linalg.inv: _inv,
    np.linalg.det: lambda a: _determinant(_matrix(a)),
    np.linalg.solve: lambda a, b: _inv(a) @ np.asarray(objects(b)), np.cross: _cross,
    np.all: _reduction(np.logical_and), np.any: _reduction(np.logical_or),
    np.max: _reduction(np.maximum), np.min: _reduction(np.minimum),
    np.amax: _reduction(np.maximum), np.amin: _reduction(np.minimum),
    np.sinc: _sinc, np.round: _round, np.around: _round,
    np.fix: lambda x, out=None: np.trunc(numbers(x)), np.isclose: _isclose,
    np.allclose: lambda a, b, *given, **options: np.all(_isclose(a, b, *given, **options)),
    np.linspace: _linspace, np.nan_to_num: _nan_to_num,
    np.zeros_like: _filled_like(0.0), np.ones_like: _filled_like(1.0),
    np.empty_like: _filled_like(None),  # NumPy's own functions call it and np.full_like
    np.full_like: lambda x, value, *_, **__: filled(np.shape(x), value),
    np.real: lambda x: x, np.imag: lambda x: 0.0 * x,
    np.dot: lambda a, b, out=None: np.dot(np.asarray(objects(a)), np.asarray(objects(b))),
}  # fmt: skip
for _function, _spelled in list(SPELLED_OUT.items()):
    SPELLED_OUT.setdefault(getattr(_function, "_implementation", _function), _spelled)
