"""Copy users' functions, and all that they refer to, for traces and for Numba."""

from __future__ import annotations

import builtins
import types
from collections.abc import Callable
from functools import partial
from typing import Any

import numba
import numpy as np
from numba.extending import is_jitted

from lierb.kernels.functions.function import COMPILED
from lierb.kernels.functions.math_functions import for_traces_of
from lierb.kernels.functions.numpy_library import for_traces, is_numpy
from lierb.kernels.functions.references import (
    UnfitFunctionError,
    attributes_of,
    is_foreign,
    is_known,
    members,
    references,
)
from lierb.kernels.functions.refusals import ALONE, NO_ORDER
from lierb.kernels.functions.shapes import UserFunction
from lierb.kernels.functions.source_lines import MARK

Replace = Callable[[Any], Any]


def traceable(function: UserFunction) -> UserFunction:
    """Copy a function and its callees, with `math` and NumPy replaced for traced numbers.

    Objects that the function refers to are copied, so that later changes have no effect.
    """
    return _Copier(lambda helper: helper, _for_traces, _frozen).function(function)


def compilable(function: UserFunction) -> UserFunction:
    """Copy a function as `traceable` does, its callees compiled by Numba."""
    return _Copier(partial(numba.njit, **COMPILED), lambda known: known, _constant).function(
        function
    )


def _for_traces(value: Any) -> Any:
    return for_traces(value) if is_numpy(value) else for_traces_of(value)


class _Copier:
    """A copier replaces the objects that the copied functions refer to.

    helper : replaces users' functions.   known : replaces objects of known packages.
    container : replaces lists, dictionaries and sets, from (name, copy of the container).
    """

    def __init__(
        self, helper: Replace, known: Replace, container: Callable[[str, Any], Any]
    ) -> None:
        self.helper, self.known, self.container = helper, known, container
        self.done: dict[int, Any] = {}

    def function(self, function: Any) -> Any:
        if id(function) in self.done:
            return self.done[id(function)]
        rebuilt = types.FunctionType(
            function.__code__, {"__builtins__": builtins, MARK: True}, function.__name__,
            self.value(function.__defaults__, "a default", set()),
            tuple(types.CellType() for _ in function.__closure__ or ()) or None,
        )  # fmt: skip
        rebuilt.__kwdefaults__ = function.__kwdefaults__ and {
            name: self.value(x, "a default", set()) for name, x in function.__kwdefaults__.items()
        }
        self.done[id(function)] = rebuilt
        attributes = attributes_of(function)
        rebuilt.__globals__.update(
            (name, self.value(value, name, attributes)) for name, value in references(function)
        )
        cells = zip(rebuilt.__closure__ or (), function.__closure__ or (), strict=True)
        for (cell, old), name in zip(cells, function.__code__.co_freevars, strict=True):
            cell.cell_contents = self.value(old.cell_contents, name, attributes)
        return rebuilt

    def value(self, value: Any, name: str, attributes: set[str]) -> Any:
        if is_jitted(value):
            value = value.py_func
        if isinstance(value, types.FunctionType) and not is_foreign(value):
            return self.helper(self.function(value))
        if isinstance(value, types.ModuleType) and not is_known(value):
            return self._module(value, name, attributes)
        if isinstance(value, np.ndarray):
            value = value.copy()
            value.setflags(write=False)
            return value
        if type(value) in (tuple, list):
            return self.container(name, type(value)(self.value(x, name, set()) for x in value))
        if type(value) is dict:
            made = {key: self.value(x, name, set()) for key, x in value.items()}
            return self.container(name, made)
        if type(value) in (set, frozenset):
            return self.container(name, frozenset(value))
        return self.known(value)

    def _module(self, module: types.ModuleType, name: str, attributes: set[str]) -> Any:
        copied = _Module(module.__name__)
        for inner, owner, attribute, value in members(name, module, attributes):
            if owner is module:
                vars(copied)[attribute] = self.value(value, inner, attributes)
        return copied


class _Module(types.ModuleType):
    """Hold the members of a user's module that a function uses."""

    def __setattr__(self, name: str, value: Any) -> None:
        raise UnfitFunctionError(f"it changes {self.__name__}.{name}; {ALONE}")


def _constant(name: str, value: Any) -> Any:
    """Convert a constant for Numba, which compiles tuples but not lists."""
    return tuple(value) if type(value) is list else value


def _frozen(name: str, value: Any) -> Any:
    if type(value) is frozenset:
        return _Set(value)
    if type(value) not in (list, dict):
        return value
    frozen = _FrozenList(value) if type(value) is list else _FrozenDict(value)
    frozen.name = name
    return frozen


def _refuses_change(self: Any, *_: Any, **__: Any) -> Any:
    raise UnfitFunctionError(f"it changes {self.name}, which is not its own; {ALONE}")


class _FrozenList(list):
    name = ""
    append = extend = insert = pop = remove = clear = sort = reverse = _refuses_change
    __setitem__ = __delitem__ = __iadd__ = __imul__ = _refuses_change


class _FrozenDict(dict):
    name = ""
    pop = popitem = clear = update = setdefault = _refuses_change
    __setitem__ = __delitem__ = __ior__ = _refuses_change


class _Set:
    """A set in a trace has `in` and `len` only, as its order may differ between processes."""

    def __init__(self, members: frozenset[Any]) -> None:
        self.__contains, self.__count = members.__contains__, len(members)

    def __contains__(self, member: Any) -> bool:
        return self.__contains(member)

    def __len__(self) -> int:
        return self.__count

    def _refuses_more(self, *_: Any) -> Any:
        raise UnfitFunctionError(NO_ORDER)

    __hash__ = None  # type: ignore[assignment]
    __iter__ = __getattr__ = __eq__ = __lt__ = __le__ = __gt__ = __ge__ = _refuses_more
    __or__ = __and__ = __sub__ = __xor__ = __ror__ = __rand__ = __rsub__ = __rxor__ = _refuses_more
