"""NumPy functions work on arrays of traced numbers in users' functions.

NumPy delegates its functions to the class of the arrays. Elementwise functions then run number by
number, comparisons return conditions, and linear algebra of small matrices is written out. NumPy
itself computes functions of constants.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from lierb.kernels.functions.elementwise import BY_NAME
from lierb.kernels.functions.references import UnfitFunctionError
from lierb.kernels.functions.refusals import refusal
from lierb.kernels.functions.user_number import Condition, UserNumber

TRACED = (UserNumber, Condition)


class UntraceableError(TypeError):
    """A NumPy function does not take lane packs."""


class Numbers(np.ndarray):
    """Some of the objects in this array are traced numbers or conditions."""

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **options: Any) -> Any:
        return _apply(ufunc, method, inputs, options)

    def __array_function__(self, function: Any, _: Any, arguments: Any, options: Any) -> Any:
        return call(function, *arguments, **options)

    def astype(self, dtype: Any, *_: Any, **__: Any) -> Any:
        return self.copy() if is_real(dtype) else super().astype(dtype)

    def round(self, decimals: Any = 0, out: Any = None) -> Any:
        return call(np.round, self, decimals)

    def __getitem__(self, index: Any) -> Any:
        return super().__getitem__(_constant(index))

    def __setitem__(self, index: Any, value: Any) -> None:
        super().__setitem__(_constant(index), value)


def _constant(index: Any) -> Any:
    """Return an index; raise UntraceableError if it contains traced numbers."""
    for part in index if isinstance(index, tuple) else (index,):
        if isinstance(part, (*TRACED, Numbers)):
            raise UntraceableError(
                "an index or a mask must be made of constants: write np.where(condition, a, b), or "
                "lierb.table(x, xs, ys) to look a number up"
            )
    return index


def numbers(members: Any) -> Any:
    """Make an array of nested sequences of traced numbers."""
    return np.array(_bare(members), dtype=object).view(Numbers)


def has_traced(x: Any) -> bool:
    """Return whether a value is traced, or nested sequences contain a traced value."""
    if isinstance(x, (list, tuple)):
        return any(map(has_traced, x))
    return isinstance(x, (*TRACED, Numbers))


def _bare(x: Any) -> Any:
    """Convert arrays to plain ones, for which NumPy does not delegate."""
    if isinstance(x, (list, tuple)):
        return list(map(_bare, x))
    return x.view(np.ndarray) if isinstance(x, Numbers) else x


def boxed(x: Any) -> Any:
    """Convert as `_bare` does, and a number to an array without axes."""
    x = _bare(x)
    if isinstance(x, TRACED):
        box = np.empty((), dtype=object)
        box[()] = x
        return box
    return x


def _dressed(result: Any) -> Any:
    """Convert arrays of objects in a NumPy result to `Numbers`."""
    if isinstance(result, (tuple, list)):
        return (tuple if isinstance(result, tuple) else list)(map(_dressed, result))
    if isinstance(result, np.ndarray) and result.dtype == object:
        return result.view(Numbers) if result.ndim else result.item()
    return result


# Ufuncs of operators, which the objects implement.
OPERATORS = (
    np.add, np.subtract, np.multiply, np.true_divide, np.negative, np.matmul, np.bitwise_and,
    np.bitwise_or, np.bitwise_xor,
    *(getattr(np, name) for name in ("vecdot", "matvec", "vecmat") if hasattr(np, name)),
)  # fmt: skip


def _apply(ufunc: Any, method: str, inputs: Any, options: dict[str, Any]) -> Any:
    """Apply a NumPy ufunc, or one of its methods such as `reduce`."""
    options = {k: v for k, v in options.items() if not _is_default(k, v)}
    out = options.pop("out", (None,))
    if ufunc in OPERATORS:
        of = ufunc
    elif ufunc.__name__ in BY_NAME:
        of = np.frompyfunc(BY_NAME[ufunc.__name__], ufunc.nin, ufunc.nout)
    else:
        raise UntraceableError(_no_function(ufunc))
    if method == "at":
        raise UntraceableError(_no_function(ufunc, f".{method}"))
    if method in ("reduce", "accumulate"):
        array = np.asarray(boxed(inputs[0]), dtype=object)
        if method == "reduce" and options.get("axis", 0) is None:  # over all elements
            sizes = (1,) * array.ndim if options.pop("keepdims", False) else ()
            total = _apply(ufunc, method, (array.ravel(),), options | {"axis": 0})
            return filled(sizes, total) if sizes else total
        inputs = (array, *inputs[1:])
    result = _dressed(getattr(of, method)(*map(boxed, inputs), **options))
    if out[0] is None:
        return result
    if not isinstance(out[0], np.ndarray) or out[0].dtype != object:
        raise UntraceableError(
            "it writes numbers of many bodies into a plain array; make the array in the function"
        )
    boxed(out[0])[...] = boxed(result)
    return out[0]


def _is_default(name: str, value: Any) -> bool:
    if name == "dtype":
        return value is None or is_real(value)
    if value is None:
        return name != "axis"  # its default is never None
    return (name == "where" and value is True) or (name == "keepdims" and value is False)


def is_real(dtype: Any) -> bool:
    return dtype in (float, np.float64, "float", "float64", "d", "f8", object) or (
        isinstance(dtype, type) and issubclass(dtype, float)
    )


def _no_function(function: Any, method: str = "") -> str:
    module = (getattr(function, "__module__", None) or "numpy").replace("numpy", "np", 1)
    name = f"{'np' if module.startswith('np._') else module}.{function.__name__}{method}"
    return (
        f"{name} does not take numbers of many bodies; {REMEDIES.get(function.__name__, REWRITE)}"
    )


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
REWRITE = "write it with operators, np.where and what docs/forces.md lists"
SPELLED_OUT: dict[Any, Callable[..., Any]] = {}  # filled by `numpy_library`


def call(function: Any, *arguments: Any, **options: Any) -> Any:
    """Call a NumPy function with traced numbers anywhere in its arguments."""
    if isinstance(function, np.ufunc):
        return _apply(function, "__call__", arguments, options)
    if not _has_numbers(arguments) and not _has_numbers(tuple(options.values())):
        floats = {name: _as_floats(x) for name, x in options.items()}
        result = function(*map(_as_floats, arguments), **floats)
        return array_of(result) if isinstance(result, np.ndarray) else result
    try:
        if function in SPELLED_OUT:
            return _dressed(SPELLED_OUT[function](*arguments, **options))
        implementation = getattr(function, "_implementation", None)
        if implementation is None:
            raise UntraceableError(_no_function(function))
        return _dressed(implementation(*map(_as_arrays, arguments), **options))
    except (UntraceableError, UnfitFunctionError):
        raise
    except ValueError as error:
        raise UnfitFunctionError(f"np.{function.__name__}: {error}") from None
    except (TypeError, AttributeError) as error:
        raise UntraceableError(_no_function(function)) from error


def _has_numbers(x: Any) -> bool:
    """Return whether nested sequences and arrays contain a traced number."""
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
        return boxed(x).view(Numbers)
    if isinstance(x, list):
        return [_as_arrays(y) for y in x]
    return x


def objects(x: Any) -> Any:
    return boxed(x) if isinstance(x, (*TRACED, Numbers)) else np.asarray(numbers(x))


def filled(shape: Any, value: Any) -> Any:
    array = np.empty(shape, dtype=object)
    array[...] = boxed(value)
    return array.view(Numbers)


for _class in TRACED:  # NumPy also delegates functions of single numbers
    for _name in ("__array_ufunc__", "__array_function__"):
        setattr(_class, _name, vars(Numbers)[_name])


def array_of(values: Any, dtype: Any = None, **_: Any) -> Any:
    """Make an array; an array of floats holds objects, so that traced numbers fit into it."""
    if has_traced(values):
        if dtype is not None and not is_real(dtype):
            raise UntraceableError(f"numbers of many bodies do not become {dtype}; use np.floor")
        return numbers(values)
    array = np.array(values, dtype=None if dtype is not None and is_real(dtype) else dtype)
    if array.dtype.kind == "M":
        raise UnfitFunctionError(refusal(np.datetime64, "np.datetime64"))
    if array.dtype.kind in "f" or (dtype is not None and is_real(dtype)):
        return array.astype(float).astype(object).view(Numbers)
    return array
