"""Find the names in the code of users' functions, and the values of these names."""

from __future__ import annotations

import builtins
import dis
import sys
import types
from collections.abc import Iterator
from typing import Any

import numpy as np
from numba.extending import is_jitted

# Packages whose functions are known by name.
KNOWN = {"numpy", "numba", "lierb", *sys.stdlib_module_names}


class UnfitFunctionError(TypeError):
    """A user's function cannot run in lierb's kernels."""


def references(function: Any) -> Iterator[tuple[str, Any]]:
    """Yield the globals and built-ins in the code of a function and its inner functions."""
    names = sorted(
        {
            instruction.argval
            for code in codes(function.__code__)
            for instruction in dis.get_instructions(code)
            if instruction.opname in ("LOAD_GLOBAL", "LOAD_NAME")
        }
    )
    for name in names:
        if name in function.__globals__:
            yield name, function.__globals__[name]
        elif hasattr(builtins, name):
            yield name, getattr(builtins, name)


def cells(function: Any) -> Iterator[tuple[str, Any]]:
    """Yield the variables of a function's closure."""
    for name, cell in zip(function.__code__.co_freevars, function.__closure__ or (), strict=True):
        try:
            yield name, cell.cell_contents
        except ValueError:
            raise UnfitFunctionError(f"it refers to {name}, which has no value yet") from None


def codes(code: types.CodeType) -> Iterator[types.CodeType]:
    """Yield the code of a function and of its inner functions."""
    yield code
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            yield from codes(constant)


def attributes_of(function: Any) -> set[str]:
    """Return the names that may occur as attributes in a function's code."""
    return {name for code in codes(function.__code__) for name in code.co_names}


def members(name: str, module: types.ModuleType, attributes: set[str]) -> Iterator[Any]:
    """Yield members of a user's module and its submodules that a function may use.

    A member is (dotted name, module, attribute, value).
    """
    if is_known(module):
        return
    for attribute in sorted(attributes & set(vars(module))):
        value = getattr(module, attribute)
        inner = f"{name}.{attribute}"
        yield inner, module, attribute, value
        if isinstance(value, types.ModuleType) and value.__name__.startswith(module.__name__):
            yield from members(inner, value, attributes)


def is_known(module: types.ModuleType) -> bool:
    """Return whether a module belongs to a known package."""
    return module.__name__.split(".")[0] in KNOWN


def undecorated(value: Any) -> Any:
    return value.py_func if is_jitted(value) else value


def is_users(value: Any) -> bool:
    value = undecorated(value)
    return isinstance(value, types.FunctionType) and not is_foreign(value)


def surroundings(function: Any) -> Iterator[tuple[str, Any, Any, Any]]:
    """Yield (name, owner, key, value) for each object a function refers to; value = owner[key]."""
    yield "a default", function, "__defaults__", function.__defaults__
    yield "a default", function, "__kwdefaults__", function.__kwdefaults__
    named = [(n, function.__globals__, n, value) for n, value in references(function)]
    places = dict(zip(function.__code__.co_freevars, function.__closure__ or (), strict=True))
    named += [(n, places[n], "cell_contents", value) for n, value in cells(function)]
    attributes = attributes_of(function)
    for name, owner, key, value in named:
        yield name, owner, key, value
        if isinstance(value, types.ModuleType):
            yield from members(name, value, attributes)


def is_foreign(value: Any) -> bool:
    """Return whether a known package has this object, not an equal one, under its name."""
    if isinstance(value, np.ufunc):
        return getattr(np, value.__name__, None) is value
    package, name = getattr(value, "__module__", None), getattr(value, "__qualname__", None)
    if not callable(value) or not package or not name or package.split(".")[0] not in KNOWN:
        return False
    member: Any = sys.modules.get(package)
    for part in name.split("."):
        member = getattr(member, part, None)
    return member is value
