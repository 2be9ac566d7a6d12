"""Fingerprints of users' functions, equal for functions that compute the same.

The name of a kernel in the disk cache contains the fingerprints of its users' functions. Hence an
edit of a function, a helper or a constant recompiles the kernel. A function that depends on more
than its arguments has no fingerprint: it is refused before any user's code runs.
"""

from __future__ import annotations

import hashlib
import types
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from lierb.kernels.functions.references import (
    UnfitFunctionError,
    attributes_of,
    is_foreign,
    is_known,
    is_users,
    surroundings,
    undecorated,
)
from lierb.kernels.functions.refusals import require_pure
from lierb.kernels.functions.shapes import UserFunction

LITERALS = (type(None), bool, int, float, complex, str, bytes, slice, range, type(...))


def fingerprint(function: UserFunction) -> str:
    """Return the digest of a function's code and of all that it refers to."""
    require_pure(function, [])
    description = _described_function(function, [function])
    return hashlib.sha256(repr(description).encode()).hexdigest()[:32]


def items_of(value: Any) -> list[Any]:
    """Return the items of a list or tuple, or the values of a dictionary; () otherwise."""
    if isinstance(value, dict):
        return list(value.values())
    return list(value) if isinstance(value, (list, tuple)) else []


def _described(value: Any, name: str, path: list[Any]) -> Any:
    """Describe a value as nested tuples of strings and numbers."""
    value = undecorated(value)
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
        return "array", str(array.dtype), value.shape, hashlib.sha256(array.data).hexdigest()
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
        f"it refers to {name}, a {type(value).__name__}, and lierb cannot detect when that "
        "changes; use numbers, arrays and functions, or parameters"
    )


def _described_function(function: Any, path: list[Any]) -> Any:
    return (
        _described_code(function.__code__, path),
        *((name, _described(value, name, path)) for name, _, _, value in surroundings(function)),
    )


def _described_code(code: types.CodeType, path: list[Any]) -> Any:
    return (
        code.co_code.hex(), code.co_names, code.co_varnames, code.co_freevars, code.co_flags,
        *(_described(constant, "a constant", path) for constant in code.co_consts),
    )  # fmt: skip


def modules_named(value: Any, attributes: set[str], seen: list[tuple[Any, set[str]]]) -> set[str]:
    """Return the names of lierb's modules that a value, or an object that it refers to, uses.

    attributes : attribute names in the code that uses the value.   seen : values visited before.
    """
    value = undecorated(value)
    within = items_of(value)
    if any(value is known and attributes == used for known, used in seen):
        return set()
    seen.append((value, attributes))
    if isinstance(value, types.ModuleType):
        within = [vars(value)[name] for name in attributes & vars(value).keys()]
    elif is_users(value):
        attributes = attributes_of(value)
        within = [x for *_, x in surroundings(value)]
    key = "__name__" if isinstance(value, types.ModuleType) else "__module__"
    name = str(getattr(value, key, ""))
    modules = {name} if name.startswith("lierb.") else set()
    return modules.union(*(modules_named(x, attributes, seen) for x in within))


# ---- changes since a function was compiled -----------------------------------------------------


@dataclass(frozen=True, eq=False)
class Reference:
    """Hold an object that a function refers to, its owner, and its content at compilation."""

    name: str
    owner: Any
    key: str
    value: Any
    content: Any
    is_mutable: bool

    def has_changed(self) -> bool:
        """Return whether the object or its content has changed since."""
        now = (
            self.owner.get(self.key) if type(self.owner) is dict
            else getattr(self.owner, self.key, None)
        )  # fmt: skip
        if now is self.value and not self.is_mutable:
            return False
        try:
            return bool(_described(now, self.name, []) != self.content)
        except UnfitFunctionError:
            return True


def watched(function: Any) -> tuple[Reference, ...]:
    """Return the references to all objects that a function and its callees were compiled with."""
    return tuple(_watched(function, []))


def _watched(function: Any, seen: list[Any]) -> Iterator[Reference]:
    if function in seen:
        return
    seen.append(function)
    for name, owner, key, value in surroundings(function):
        if value is None and owner is function:
            continue
        if type(owner) is dict and key not in owner:  # a built-in
            continue
        if not isinstance(value, types.ModuleType) or not is_known(value):
            content = _described(value, name, [])
            yield Reference(name, owner, key, value, content, _is_mutable(value))
        for inner in _nested(value):
            if is_users(inner):
                yield from _watched(undecorated(inner), seen)


def _is_mutable(value: Any) -> bool:
    return any(isinstance(x, (list, dict, set, np.ndarray)) for x in _nested(value))


def _nested(value: Any) -> Iterator[Any]:
    """Yield a value, and the items of lists, tuples and dictionaries."""
    yield value
    for item in items_of(value):
        yield from _nested(item)
