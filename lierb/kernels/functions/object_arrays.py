"""NumPy in functions of the user's: arrays of numbers that are traced, and what is done to them.

NumPy hands its functions over to arrays of a class of their own. Elementwise functions then run on
the numbers one by one, comparisons give conditions, and linear algebra of small matrices is spelled
out. What is made of nothing but constants is NumPy's own business.
"""

from __future__ import annotations

import math
import operator
import types
from collections.abc import Callable
from functools import reduce
from typing import Any

import numpy as np

from lierb.kernels.functions import user_number as user
from lierb.kernels.functions.fingerprint import UNINITIALISED, UnfitFunctionError, refusal
from lierb.kernels.functions.user_number import Condition, UserNumber, choice

MOST_ROWS = 4  # of matrices that are inverted: by cofactors, of which there are n!
TRACED = (UserNumber, Condition)


class UntraceableError(TypeError):
    """A function of NumPy's that packs of numbers cannot go through."""


class Numbers(np.ndarray):
    """An array of objects, some of which are traced numbers or conditions."""

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **options: Any) -> Any:
        return _apply(ufunc, method, inputs, options)

    def __array_function__(self, function: Any, _: Any, given: Any, options: Any) -> Any:
        return call(function, *given, **options)

    def astype(self, dtype: Any, *_: Any, **__: Any) -> Any:
        return self.copy() if _is_real(dtype) else super().astype(dtype)

    def round(self, decimals: Any = 0, out: Any = None) -> Any:
        return call(np.round, self, decimals)

    def __getitem__(self, place: Any) -> Any:
        return super().__getitem__(_as_index(place))

    def __setitem__(self, place: Any, value: Any) -> None:
        super().__setitem__(_as_index(place), value)


def _as_index(place: Any) -> Any:
    for part in place if isinstance(place, tuple) else (place,):
        if isinstance(part, (*TRACED, Numbers)):
            raise UntraceableError(
                "an index or a mask must be made of constants: write np.where(condition, a, b), or "
                "lierb.table(x, xs, ys) to look a number up"
            )
    return place


def numbers(members: Any) -> Any:
    """An array of traced numbers, from nested sequences of them."""
    return np.array(_bare(members), dtype=object).view(Numbers)


def has_traced(x: Any) -> bool:
    """Whether there are traced numbers in nested sequences."""
    if isinstance(x, (list, tuple)):
        return any(map(has_traced, x))
    return isinstance(x, (*TRACED, Numbers))


def _bare(x: Any) -> Any:
    """Arrays without the class, so that NumPy goes on by itself."""
    if isinstance(x, (list, tuple)):
        return list(map(_bare, x))
    return x.view(np.ndarray) if isinstance(x, Numbers) else x


def _plain(x: Any) -> Any:
    """The same with a number in a box of its own, for which NumPy would ask the number again."""
    x = _bare(x)
    if isinstance(x, TRACED):
        box = np.empty((), dtype=object)
        box[()] = x
        return box
    return x


def _dressed(found: Any) -> Any:
    if isinstance(found, tuple):
        return tuple(map(_dressed, found))
    if isinstance(found, list):
        return list(map(_dressed, found))
    if isinstance(found, np.ndarray) and found.dtype == object:
        return found.view(Numbers) if found.ndim else found.item()
    return found


# ---- elementwise functions ---------------------------------------------------------------------


def _logical(combine: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
    return lambda a, b: combine(user.as_condition(a), user.as_condition(b))


ELEMENTWISE: dict[Any, Callable[..., Any]] = {
    np.sin: user.sin, np.cos: user.cos, np.tan: user.tan, np.exp: user.exp, np.expm1: user.expm1,
    np.exp2: user.exp2, np.log: user.log, np.log1p: user.log1p, np.log10: user.log10,
    np.log2: user.log2, np.sqrt: user.sqrt, np.cbrt: user.cbrt, np.square: user.square,
    np.reciprocal: user.reciprocal, np.sinh: user.sinh, np.cosh: user.cosh, np.tanh: user.tanh,
    np.arcsin: user.arcsin, np.arccos: user.arccos, np.arctan: user.arctan,
    np.arcsinh: user.arcsinh, np.arccosh: user.arccosh, np.arctanh: user.arctanh,
    np.arctan2: user.arctan2, np.hypot: user.hypot, np.power: user.power,
    np.float_power: user.power, np.absolute: abs, np.fabs: abs,
    np.maximum: user.maximum, np.minimum: user.minimum, np.fmax: user.fmax, np.fmin: user.fmin,
    np.sign: user.sign, np.copysign: user.copysign, np.heaviside: user.heaviside,
    np.floor: user.whole_floor, np.ceil: user.whole_ceil, np.trunc: user.whole_part,
    np.rint: user.nearest, np.remainder: user.remainder, np.fmod: user.fmod,
    np.floor_divide: user.floor_divide,
    np.divmod: lambda x, y: (user.floor_divide(x, y), user.remainder(x, y)),
    np.modf: lambda x: (user.fraction(x), user.whole_part(x)),
    np.radians: lambda x: x * (math.pi / 180.0), np.deg2rad: lambda x: x * (math.pi / 180.0),
    np.degrees: lambda x: x * (180.0 / math.pi), np.rad2deg: lambda x: x * (180.0 / math.pi),
    np.isnan: user.is_nan, np.isfinite: user.is_finite, np.isinf: user.is_infinite,
    np.signbit: user.has_sign_bit, np.positive: lambda x: x, np.conjugate: lambda x: x,
    np.logaddexp: user.logaddexp,
    np.logical_and: _logical(lambda a, b: a & b), np.logical_or: _logical(lambda a, b: a | b),
    np.logical_xor: _logical(lambda a, b: a ^ b),
    np.logical_not: lambda a: user.as_condition(a) ^ True,
    np.invert: lambda a: user.as_condition(a) ^ True,
    np.less: operator.lt, np.less_equal: operator.le, np.greater: operator.gt,
    np.greater_equal: operator.ge, np.equal: operator.eq, np.not_equal: operator.ne,
}  # fmt: skip
# Those without a public name: np.clip's and, from NumPy 2.5 on, those of x.real and x.imag.
UNNAMED: dict[str, Callable[..., Any]] = {
    "clip": user.clipped, "real": lambda x: x, "imag": lambda x: 0.0 * x,
}  # fmt: skip
# The operators, which objects bear themselves.
OPERATORS = (
    np.add, np.subtract, np.multiply, np.true_divide, np.negative, np.matmul, np.bitwise_and,
    np.bitwise_or, np.bitwise_xor,
    *(getattr(np, name) for name in ("vecdot", "matvec", "vecmat") if hasattr(np, name)),
)  # fmt: skip


def _apply(ufunc: Any, method: str, inputs: Any, options: dict[str, Any]) -> Any:
    """A universal function of NumPy's, or one of its methods such as `reduce`."""
    options = {k: v for k, v in options.items() if not _is_default(k, v)}
    out = options.pop("out", (None,))
    if ufunc.__name__ in UNNAMED:
        of: Any = np.frompyfunc(UNNAMED[ufunc.__name__], ufunc.nin, ufunc.nout)
    elif ufunc in ELEMENTWISE:
        of = np.frompyfunc(ELEMENTWISE[ufunc], ufunc.nin, ufunc.nout)
    elif ufunc in OPERATORS:
        of = ufunc
    else:
        raise UntraceableError(_no_function(ufunc))
    if method == "at":
        raise UntraceableError(_no_function(ufunc, f".{method}"))
    if method in ("reduce", "accumulate"):
        array = np.asarray(_plain(inputs[0]), dtype=object)
        if method == "reduce" and options.get("axis", 0) is None:  # over all members
            sizes = (1,) * array.ndim if options.pop("keepdims", False) else ()
            found = _apply(ufunc, method, (array.ravel(),), options | {"axis": 0})
            return _filled(sizes, found) if sizes else found
        inputs = (array, *inputs[1:])
    found = _dressed(getattr(of, method)(*map(_plain, inputs), **options))
    if out[0] is None:
        return found
    if not isinstance(out[0], np.ndarray) or out[0].dtype != object:
        raise UntraceableError(
            "it writes numbers of many bodies into a plain array; make the array in the function"
        )
    _plain(out[0])[...] = _plain(found)
    return out[0]


def _is_default(name: str, value: Any) -> bool:
    if name == "dtype":
        return value is None or _is_real(value)
    if value is None:
        return name != "axis"  # of which no default is None
    return (name == "where" and value is True) or (name == "keepdims" and value is False)


def _is_real(dtype: Any) -> bool:
    return dtype in (float, np.float64, "float", "float64", "d", "f8", object) or (
        isinstance(dtype, type) and issubclass(dtype, float)
    )


def _no_function(function: Any, method: str = "") -> str:
    module = (getattr(function, "__module__", None) or "numpy").replace("numpy", "np", 1)
    name = f"{'np' if module.startswith('np._') else module}.{function.__name__}{method}"
    return f"{name} does not take numbers of many bodies; {_remedy(function.__name__)}"


REMEDIES = {
    "sort": "np.minimum and np.maximum put two numbers in order",
    "argsort": "np.minimum and np.maximum put two numbers in order",
    "argmax": "choose by np.where(condition, a, b)",
    "argmin": "choose by np.where(condition, a, b)",
    "searchsorted": "lierb.table(x, xs, ys) looks numbers up",
    "digitize": "lierb.table(x, xs, ys) looks numbers up",
    "eig": "write out what you need of it", "eigh": "write out what you need of it",
    "svd": "write out what you need of it",
}  # fmt: skip


def _remedy(name: str) -> str:
    return REMEDIES.get(name, "write it with operators, np.where and what docs/forces.md lists")


# ---- other functions ---------------------------------------------------------------------------


def call(function: Any, *given: Any, **options: Any) -> Any:
    """One of NumPy's functions, with traced numbers anywhere among its arguments."""
    if isinstance(function, np.ufunc):
        return _apply(function, "__call__", given, options)
    if not _has_numbers(given) and not _has_numbers(tuple(options.values())):
        found = function(*map(_as_floats, given), **{k: _as_floats(x) for k, x in options.items()})
        return _array(found) if isinstance(found, np.ndarray) else found
    try:
        if function in SPELLED_OUT:
            return _dressed(SPELLED_OUT[function](*given, **options))
        implementation = getattr(function, "_implementation", None)
        if implementation is None:
            raise UntraceableError(_no_function(function))
        given = tuple(_as_arrays(x) for x in given)
        return _dressed(implementation(*given, **options))
    except (UntraceableError, UnfitFunctionError):
        raise
    except ValueError as error:
        raise UnfitFunctionError(f"np.{function.__name__}: {error}") from None
    except (TypeError, AttributeError) as error:
        raise UntraceableError(_no_function(function)) from error


def _has_numbers(x: Any) -> bool:
    """Whether any member of nested sequences and arrays is traced: arrays may be of floats only."""
    if isinstance(x, (list, tuple)):
        return any(map(_has_numbers, x))
    if isinstance(x, Numbers):
        return any(not isinstance(y, (int, float)) for y in x.flat)
    return isinstance(x, TRACED)


def _as_floats(x: Any) -> Any:
    if isinstance(x, (list, tuple)):
        return type(x)(map(_as_floats, x)) if type(x) in (list, tuple) else x
    return np.asarray(x, dtype=np.float64) if isinstance(x, Numbers) else x


def _as_arrays(x: Any) -> Any:
    if isinstance(x, TRACED):
        return _plain(x).view(Numbers)
    if isinstance(x, list):
        return [_as_arrays(y) for y in x]
    return x


def _where(condition: Any, a: Any = None, b: Any = None) -> Any:
    if a is None or b is None:
        raise UntraceableError(
            "np.where with a condition alone asks which bodies meet it; write "
            "np.where(condition, a, b)"
        )
    return np.frompyfunc(choice, 3, 1)(*map(_objects, (condition, a, b)))


def _objects(x: Any) -> Any:
    return _plain(x) if isinstance(x, (*TRACED, Numbers)) else np.asarray(numbers(x))


def _clip(x: Any, a_min: Any = None, a_max: Any = None, out: Any = None, **given: Any) -> Any:
    lower, upper = given.get("min", a_min), given.get("max", a_max)
    return np.frompyfunc(user.clipped, 3, 1)(*map(_objects, (x, lower, upper)))


def _interp(
    x: Any, xp: Any, fp: Any, left: Any = None, right: Any = None, period: Any = None
) -> Any:
    if period is not None:
        raise UntraceableError("np.interp with a period: write np.interp(x % period, xp, fp)")
    return np.frompyfunc(lambda one: user.interpolated(one, list(xp), list(fp), left, right), 1, 1)(
        _objects(x)
    )


def _select(conditions: Any, choices: Any, default: Any = 0.0) -> Any:
    found = default
    for condition, chosen in reversed(list(zip(conditions, choices, strict=True))):
        found = _where(condition, chosen, found)
    return found


def _piecewise(x: Any, conditions: Any, functions: Any, *given: Any) -> Any:
    conditions, functions = list(conditions), list(functions)
    default: Any = functions.pop() if len(functions) > len(conditions) else 0.0
    choices = [f(x, *given) if callable(f) else f for f in (*functions, default)]
    return _select(conditions, choices[: len(conditions)], choices[-1] if default else 0.0)


def _einsum(subscripts: Any, *operands: Any, **options: Any) -> Any:
    arrays = [np.asarray(_objects(x)) for x in operands]
    return np.einsum(subscripts, *arrays)


def _norm(x: Any, ord: Any = None, axis: Any = None, keepdims: bool = False) -> Any:
    x = numbers(x)
    is_vector = isinstance(axis, int) or (axis is None and x.ndim == 1)
    if ord in (None, "fro") or (ord == 2 and is_vector):
        square = (x.ravel() @ x.ravel()) if axis is None else None
        return np.sqrt((x * x).sum(axis=axis, keepdims=keepdims) if square is None else square)
    if is_vector and ord in (1, np.inf, -np.inf):
        of: Any = {1: np.add, np.inf: np.maximum, -np.inf: np.minimum}[ord]
        return of.reduce(abs(x), axis=-1 if axis is None else axis, keepdims=keepdims)
    raise UntraceableError(f"np.linalg.norm has ord {ord!r} for constants only; write it out")


def _matrix(given: Any) -> Any:
    a = np.asarray(_objects(given))
    if a.ndim != 2 or a.shape[0] != a.shape[1]:
        raise UnfitFunctionError(f"a square matrix is needed, not an array of shape {a.shape}")
    if len(a) > MOST_ROWS:
        raise UntraceableError(
            f"a {len(a)}×{len(a)} matrix of numbers of many bodies: at most {MOST_ROWS}×{MOST_ROWS}"
        )
    return a


def _det(given: Any) -> Any:
    return _determinant(_matrix(given))


def _determinant(a: Any) -> Any:
    if len(a) < 2:
        return a[0, 0] if len(a) else 1.0
    rest = np.arange(len(a))
    terms = (a[0, j] * _determinant(a[1:][:, rest != j]) * (-1.0) ** j for j in rest.tolist())
    return reduce(lambda x, y: x + y, terms)


def _inv(given: Any) -> Any:
    a = _matrix(given)
    rest = np.arange(len(a))
    adjugate = np.empty_like(a)
    for i in rest.tolist():
        for j in rest.tolist():
            adjugate[j, i] = _determinant(a[rest != i][:, rest != j]) * (-1.0) ** (i + j)
    return adjugate * (1.0 / (a[0] @ adjugate[:, 0]))


def _solve(a: Any, b: Any) -> Any:
    return _inv(a) @ np.asarray(_objects(b))


def _cross(
    a: Any, b: Any, axisa: int = -1, axisb: int = -1, axisc: int = -1, axis: int | None = None
) -> Any:
    # NumPy's own, of rows: before 2.3 it makes a buffer of a single product, a float if it is of
    # constants, and then writes numbers into it.
    if axis is not None:
        axisa = axisb = axisc = axis
    a, b = (np.moveaxis(np.asarray(_objects(x)), i, -1)[None] for x, i in ((a, axisa), (b, axisb)))
    found = np.cross(a, b)[0]
    return found if a.shape[-1] == b.shape[-1] == 2 else np.moveaxis(found, -1, axisc)


def _all(x: Any, axis: Any = None, **options: Any) -> Any:
    return np.logical_and.reduce(numbers(x), axis=axis, **options)


def _any(x: Any, axis: Any = None, **options: Any) -> Any:
    return np.logical_or.reduce(numbers(x), axis=axis, **options)


def _largest(of: Any) -> Callable[..., Any]:
    return lambda x, axis=None, **options: of.reduce(numbers(x), axis=axis, **options)


def _sinc(x: Any) -> Any:
    def one(x: Any) -> Any:
        y = math.pi * choice(user.raw(x) == 0.0, 1e-20, x)
        return user.sin(y) / y

    return np.frompyfunc(one, 1, 1)(_objects(x))


def _round(x: Any, decimals: int = 0, out: Any = None) -> Any:
    return np.frompyfunc(lambda one: user.rounded(one, decimals), 1, 1)(_objects(x))


def _fix(x: Any, out: Any = None) -> Any:
    return np.trunc(numbers(x))


def _isclose(
    a: Any, b: Any, rtol: float = 1e-5, atol: float = 1e-8, equal_nan: bool = False
) -> Any:
    return abs(numbers(a) - numbers(b)) <= atol + rtol * abs(numbers(b))


def _allclose(a: Any, b: Any, *given: Any, **options: Any) -> Any:
    return np.all(_isclose(a, b, *given, **options))


def _linspace(start: Any, stop: Any, num: int = 50) -> Any:
    return start + np.arange(num) * ((stop - start) / (num - 1))


def _nan_to_num(x: Any, copy: bool = True, nan: float = 0.0, **_: Any) -> Any:
    return np.frompyfunc(
        lambda one: choice(user.is_nan(one), nan, user.clipped(one, *_FINITE)), 1, 1
    )(_objects(x))


_FINITE = (-np.finfo(float).max, np.finfo(float).max)


def _filled_like(value: Any) -> Callable[..., Any]:
    return lambda x, *_, **__: _filled(np.shape(x), value)


def _full_like(x: Any, value: Any, *_: Any, **__: Any) -> Any:
    return _filled(np.shape(x), value)


def _filled(shape: Any, value: Any) -> Any:
    array = np.empty(shape, dtype=object)
    array[...] = _plain(value)
    return array.view(Numbers)


SPELLED_OUT: dict[Any, Callable[..., Any]] = {
    np.where: _where, np.clip: _clip, np.interp: _interp, np.select: _select,
    np.piecewise: _piecewise, np.einsum: _einsum, np.linalg.norm: _norm, np.linalg.inv: _inv,
    np.linalg.det: _det, np.linalg.solve: _solve, np.cross: _cross, np.all: _all, np.any: _any,
    np.max: _largest(np.maximum), np.min: _largest(np.minimum), np.amax: _largest(np.maximum),
    np.amin: _largest(np.minimum), np.sinc: _sinc, np.round: _round, np.around: _round,
    np.fix: _fix, np.isclose: _isclose, np.allclose: _allclose, np.linspace: _linspace,
    np.nan_to_num: _nan_to_num,
    np.zeros_like: _filled_like(0.0), np.ones_like: _filled_like(1.0),
    np.empty_like: _filled_like(None), np.full_like: _full_like,  # for NumPy's own functions
    np.real: lambda x: x, np.imag: lambda x: 0.0 * x,
    np.dot: lambda a, b, out=None: np.dot(np.asarray(_objects(a)), np.asarray(_objects(b))),
}  # fmt: skip
for _function, _spelled in list(SPELLED_OUT.items()):
    SPELLED_OUT.setdefault(getattr(_function, "_implementation", _function), _spelled)


for _class in TRACED:  # numbers by themselves hand NumPy's functions over in the same way
    for _name in ("__array_ufunc__", "__array_function__"):
        setattr(_class, _name, vars(Numbers)[_name])


# ---- NumPy as functions of the user's see it ---------------------------------------------------


def _array(given: Any, dtype: Any = None, **_: Any) -> Any:
    """Of floats, an array of objects too: a function may write numbers of the motion into it."""
    if has_traced(given):
        if dtype is not None and not _is_real(dtype):
            raise UntraceableError(f"numbers of many bodies do not become {dtype}; use np.floor")
        return numbers(given)
    found = np.array(given, dtype=None if dtype is not None and _is_real(dtype) else dtype)
    if found.dtype.kind == "M":
        raise UnfitFunctionError(refusal(np.datetime64, "np.datetime64"))
    if found.dtype.kind in "f" or (dtype is not None and _is_real(dtype)):
        return found.astype(float).astype(object).view(Numbers)
    return found


def _zeros(shape: Any, dtype: Any = None, **_: Any) -> Any:
    return _made(np.zeros, shape, dtype)


def _ones(shape: Any, dtype: Any = None, **_: Any) -> Any:
    return _made(np.ones, shape, dtype)


def _full(shape: Any, value: Any, dtype: Any = None, **_: Any) -> Any:
    return _filled(shape, value)


def _eye(rows: int, columns: int | None = None, k: int = 0, dtype: Any = None, **_: Any) -> Any:
    return np.eye(rows, columns, k).astype(object).view(Numbers)


def _made(of: Any, shape: Any, dtype: Any) -> Any:
    if dtype is not None and not _is_real(dtype):
        return of(shape, dtype)
    return of(shape).astype(object).view(Numbers)


MADE: dict[Any, Callable[..., Any]] = {
    np.array: _array, np.asarray: _array, np.asanyarray: _array, np.ascontiguousarray: _array,
    np.zeros: _zeros, np.ones: _ones, np.full: _full, np.eye: _eye,
    np.identity: _eye,
}  # fmt: skip
_FLOATS: dict[type, type] = {np.float64: user.Float}


class Spoken:
    """A function of NumPy's that finds traced numbers inside lists as well."""

    def __init__(self, function: Any) -> None:
        self.function = function

    def __call__(self, *given: Any, **options: Any) -> Any:
        if self.function in UNINITIALISED:  # and named where nobody has looked: as a default, say
            raise UnfitFunctionError(refusal(self.function, f"np.{self.function.__name__}"))
        if self.function in MADE:
            return MADE[self.function](*given, **options)
        if not (any(map(has_traced, given)) or any(map(has_traced, options.values()))):
            return self.function(*given, **options)
        return call(self.function, *map(_gathered, given), **options)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.function, name)


def _gathered(x: Any) -> Any:
    """A list with traced numbers in it as an array, unless it is ragged."""
    if not isinstance(x, (list, tuple)) or not has_traced(x):
        return x
    shapes = {np.shape(_plain(y)) for y in x}
    return numbers(x) if len(shapes) == 1 and not any(callable(y) for y in x) else x


class Library:
    """A module of NumPy's, as functions of the user's see it while they are traced."""

    def __init__(self, module: types.ModuleType) -> None:
        self.__dict__["module"] = module

    def __getattr__(self, name: str) -> Any:
        value = getattr(self.module, name)
        why = refusal(value, f"{self.module.__name__}.{name}".replace("numpy", "np", 1))
        if why is not None:
            raise UnfitFunctionError(why)
        return for_traces(value)

    def __setattr__(self, name: str, value: Any) -> None:
        raise UnfitFunctionError(f"it changes {self.module.__name__}.{name}")


def for_traces(value: Any) -> Any:
    """Something of NumPy's that stands for itself on traced numbers."""
    if isinstance(value, types.ModuleType):
        return Library(value)
    if isinstance(value, type):
        return _FLOATS.get(value, value)
    return Spoken(value) if callable(value) else value


def is_numpy(value: Any) -> bool:
    """Whether it is NumPy itself, or a module or function of its."""
    if isinstance(value, types.ModuleType):
        return value.__name__.split(".")[0] == "numpy"
    if isinstance(value, np.ufunc):
        return True
    module = getattr(value, "__module__", None) or ""
    return callable(value) and isinstance(module, str) and module.split(".")[0] == "numpy"
