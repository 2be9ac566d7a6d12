"""What a function refers to, and its fingerprint: equal for functions that compute the same.

A kernel's name in the disk cache holds the fingerprints of the user's functions in it, so that an
edited function, helper or constant is compiled anew.
"""

from __future__ import annotations

import builtins
import dis
import hashlib
import sys
import types
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numba.core.registry import CPUDispatcher

LITERALS = (type(None), bool, int, float, complex, str, bytes, slice, range, type(...))
KNOWN = {"numpy", "numba", "lierb", *sys.stdlib_module_names}  # packages whose names say it all
# With these a function gets at what nobody can see from outside.
HIDDEN = ("getattr", "eval", "exec", "globals", "locals", "vars", "open", "__import__")


class UnfitFunctionError(TypeError):
    """A function that lierb cannot run in its kernels; says why."""


def fingerprint(function: Callable[..., Any]) -> str:
    """A digest of the function's code and of everything that it refers to."""
    description = _described_function(function, [function])
    return hashlib.sha256(repr(description).encode()).hexdigest()[:32]


def references(function: Any) -> Iterator[tuple[str, Any]]:
    """The globals and built-ins that a function's code names, its inner functions' included."""
    names = sorted(
        {
            instruction.argval
            for code in _codes(function.__code__)
            for instruction in dis.get_instructions(code)
            if instruction.opname in ("LOAD_GLOBAL", "LOAD_NAME")
        }
    )
    for name in names:
        if name in function.__globals__:
            yield name, function.__globals__[name]
        elif hasattr(builtins, name):
            yield name, getattr(builtins, name)


def _codes(code: types.CodeType) -> Iterator[types.CodeType]:
    yield code
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            yield from _codes(constant)


def _described(value: Any, name: str, path: list[Any]) -> Any:
    """A value as nested tuples of text and numbers, equal for what computes the same."""
    if isinstance(value, CPUDispatcher):
        value = value.py_func
    if isinstance(value, LITERALS):
        return repr(value)
    if type(value) in (set, frozenset):
        return "set", *sorted(map(repr, value))
    if type(value) in (tuple, list):
        return type(value).__name__, *(_described(x, name, path) for x in value)
    if type(value) is dict:
        return "dict", *(_described(item, name, path) for item in value.items())
    if isinstance(value, (np.ndarray, np.generic)) and value.dtype != object:
        array = np.ascontiguousarray(value)
        return "array", str(array.dtype), array.shape, hashlib.sha256(array.data).hexdigest()
    if isinstance(value, types.ModuleType):
        return "module", value.__name__
    if isinstance(value, types.FunctionType) and not is_foreign(value):
        if value in path:
            return "itself", path.index(value)
        return _described_function(value, [*path, value])
    if isinstance(value, types.CodeType):
        return _described_code(value, path)
    if is_foreign(value):
        return "known", str(getattr(value, "__module__", "")), getattr(value, "__qualname__", name)
    raise UnfitFunctionError(
        f"it refers to {name}, a {type(value).__name__}, of which lierb cannot tell when it "
        "changes; use numbers, arrays and functions, or parameters"
    )


def _described_function(function: Any, path: list[Any]) -> Any:
    cells = zip(function.__code__.co_freevars, function.__closure__ or (), strict=True)
    named = [*references(function), *((name, cell.cell_contents) for name, cell in cells)]
    codes = list(_codes(function.__code__))
    if any(i.opname == "IMPORT_NAME" for code in codes for i in dis.get_instructions(code)):
        raise UnfitFunctionError("it imports something itself; import that before the function")
    for name, value in named:
        if name in HIDDEN and value is getattr(builtins, name):
            raise UnfitFunctionError(f"it uses {name}, behind which lierb cannot look")
    attributes = {n for code in codes for n in code.co_names}
    modules = [(name, value) for name, value in named if isinstance(value, types.ModuleType)]
    members = [member for name, value in modules for member in _members(name, value, attributes)]
    return (
        _described_code(function.__code__, path),
        _described(function.__defaults__, "a default", path),
        _described(function.__kwdefaults__, "a default", path),
        *((name, _described(value, name, path)) for name, value in named + members),
    )


def _members(name: str, module: types.ModuleType, attributes: set[str]) -> Iterator[Any]:
    """What a function may mean by `module.attribute`, and by what is in modules that it names."""
    if module.__name__.split(".")[0] in KNOWN:
        return
    for attribute in sorted(attributes & set(vars(module))):
        value = getattr(module, attribute)
        inner = f"{name}.{attribute}"
        yield inner, value
        if isinstance(value, types.ModuleType) and value.__name__.startswith(module.__name__):
            yield from _members(inner, value, attributes)


def _described_code(code: types.CodeType, path: list[Any]) -> Any:
    return (
        code.co_code.hex(), code.co_names, code.co_varnames, code.co_freevars, code.co_flags,
        *(_described(constant, "a constant", path) for constant in code.co_consts),
    )  # fmt: skip


def is_foreign(value: Any) -> bool:
    """Whether it is what a known package has under its name, so that the name says it all."""
    if isinstance(value, np.ufunc):
        return getattr(np, value.__name__, None) is value
    package, name = getattr(value, "__module__", None), getattr(value, "__qualname__", None)
    if not callable(value) or not package or not name or package.split(".")[0] not in KNOWN:
        return False
    found: Any = sys.modules.get(package)
    for part in name.split("."):
        found = getattr(found, part, None)
    return found is value
