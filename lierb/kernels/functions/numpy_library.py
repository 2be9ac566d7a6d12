"""Replace NumPy's modules, constructors and functions in traces."""

from __future__ import annotations

import types
from collections.abc import Callable
from typing import Any

import numpy as np

from lierb.kernels.functions import numpy_functions
from lierb.kernels.functions.object_arrays import (
    SPELLED_OUT,
    Numbers,
    array_of,
    boxed,
    call,
    filled,
    has_traced,
    is_real,
    numbers,
)
from lierb.kernels.functions.references import UnfitFunctionError
from lierb.kernels.functions.refusals import UNINITIALISED, refusal
from lierb.kernels.functions.user_number import Float

SPELLED_OUT.update(numpy_functions.SPELLED_OUT)


def _made(of: Callable[..., Any]) -> Callable[..., Any]:
    """Replace a constructor by one whose arrays of floats hold objects."""

    def made(shape: Any, dtype: Any = None, **_: Any) -> Any:
        if dtype is not None and not is_real(dtype):
            return of(shape, dtype)
        return of(shape).astype(object).view(Numbers)

    return made


def _eye(rows: int, columns: int | None = None, k: int = 0, dtype: Any = None, **_: Any) -> Any:
    return np.eye(rows, columns, k).astype(object).view(Numbers)


MADE: dict[Any, Callable[..., Any]] = {
    np.array: array_of, np.asarray: array_of, np.asanyarray: array_of,
    np.ascontiguousarray: array_of, np.zeros: _made(np.zeros), np.ones: _made(np.ones),
    np.full: lambda shape, value, dtype=None, **_: filled(shape, value),
    np.eye: _eye, np.identity: _eye,
}  # fmt: skip
_FLOATS: dict[type, type] = {np.float64: Float}


class Spoken:
    """A NumPy function in a trace also takes lists of traced numbers."""

    def __init__(self, function: Any) -> None:
        self.function = function

    def __call__(self, *given: Any, **options: Any) -> Any:
        if self.function in UNINITIALISED:  # not by name: a default argument, say
            raise UnfitFunctionError(refusal(self.function, f"np.{self.function.__name__}"))
        if self.function in MADE:
            return MADE[self.function](*given, **options)
        if not (any(map(has_traced, given)) or any(map(has_traced, options.values()))):
            return self.function(*given, **options)
        return call(self.function, *map(_gathered, given), **options)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.function, name)


def _gathered(x: Any) -> Any:
    """Convert a list with traced numbers to an array; leave ragged lists."""
    if not isinstance(x, (list, tuple)) or not has_traced(x):
        return x
    shapes = {np.shape(boxed(y)) for y in x}
    return numbers(x) if len(shapes) == 1 and not any(callable(y) for y in x) else x


class Library:
    """The functions of this NumPy module take traced numbers."""

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
    """Return the replacement of a NumPy module, type or function for traced numbers."""
    if isinstance(value, types.ModuleType):
        return Library(value)
    if isinstance(value, type):
        return _FLOATS.get(value, value)
    return Spoken(value) if callable(value) else value


def is_numpy(value: Any) -> bool:
    """Return whether an object is a NumPy module or function."""
    if isinstance(value, types.ModuleType):
        return value.__name__.split(".")[0] == "numpy"
    if isinstance(value, np.ufunc):
        return True
    module = getattr(value, "__module__", None) or ""
    return callable(value) and isinstance(module, str) and module.split(".")[0] == "numpy"
