"""NumPy's modules, constructors and functions for users' functions while they are traced."""

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
    """Replace a constructor: an array of floats holds objects."""

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
    """Function of NumPy's that takes lists of traced numbers, too."""

    def __init__(self, function: Any) -> None:
        self.function = function

    def __call__(self, *given: Any, **options: Any) -> Any:
        if self.function in UNINITIALISED:  # not named in the code: a default, say
            raise UnfitFunctionError(refusal(self.function, f"np.{self.function.__name__}"))
        if self.function in MADE:
            return MADE[self.function](*given, **options)
        if not (any(map(has_traced, given)) or any(map(has_traced, options.values()))):
            return self.function(*given, **options)
        return call(self.function, *map(_gathered, given), **options)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.function, name)


def _gathered(x: Any) -> Any:
    """Make an array of a list with traced numbers, unless it is ragged."""
    if not isinstance(x, (list, tuple)) or not has_traced(x):
        return x
    shapes = {np.shape(boxed(y)) for y in x}
    return numbers(x) if len(shapes) == 1 and not any(callable(y) for y in x) else x


class Library:
    """Module of NumPy's whose functions take traced numbers."""

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
    """Replacement of a module, a type or a function of NumPy's for traced numbers."""
    if isinstance(value, types.ModuleType):
        return Library(value)
    if isinstance(value, type):
        return _FLOATS.get(value, value)
    return Spoken(value) if callable(value) else value


def is_numpy(value: Any) -> bool:
    """Return whether an object is a module or a function of NumPy's."""
    if isinstance(value, types.ModuleType):
        return value.__name__.split(".")[0] == "numpy"
    if isinstance(value, np.ufunc):
        return True
    module = getattr(value, "__module__", None) or ""
    return callable(value) and isinstance(module, str) and module.split(".")[0] == "numpy"
