"""Refuse users' functions whose code depends on more than their arguments."""

from __future__ import annotations

import builtins
import dis
import sys
import types
from collections.abc import Iterator
from typing import Any

import numpy as np

from lierb.kernels.functions.references import (
    UnfitFunctionError,
    cells,
    is_users,
    references,
    undecorated,
)
from lierb.kernels.functions.source_lines import at

# Modules of the standard library without side effects.
COMPUTING = {
    "builtins", "math", "cmath", "operator", "_operator", "functools", "_functools", "itertools",
    "numbers", "fractions", "collections", "_collections", "_collections_abc", "typing", "types",
    "enum", "abc", "dataclasses", "copy", "__future__",
}  # fmt: skip
RANDOM = ("random", "_random", "secrets", "uuid", "numpy.random")
CLOCKS = ("time", "datetime", "_datetime", "zoneinfo")
# Built-ins through which a function reaches objects that its code does not name.
HIDDEN = ("getattr", "setattr", "delattr", "eval", "exec", "compile", "globals", "locals", "vars",
          "__import__", "breakpoint")  # fmt: skip
OUTSIDE = ("print", "input", "open", "id", "hash")
OUTSIDE_NUMPY = (
    "load", "loadtxt", "genfromtxt", "fromfile", "memmap", "save", "savez", "savez_compressed",
    "savetxt", "seterr", "geterr", "set_printoptions", "get_printoptions", "setbufsize",
)  # fmt: skip
TEXT_NUMPY = ("array2string", "array_str", "array_repr", "format_float_positional",
              "format_float_scientific")  # fmt: skip
UNINITIALISED = (np.empty, np.empty_like)
TEXT = (
    "it makes text of numbers (str, repr, format, an f-string), which have no digits before they "
    "run: compute with the numbers themselves"
)
NO_ORDER = (
    "it uses a set, whose order may be another one in every process, for more than `in`: write a "
    "tuple or a list"
)
ALONE = "a function must depend on its arguments alone"
NO_CHANGE = (
    "it changes .{}: parameters cannot be changed, nor other arguments; use a variable of your own"
)


def refusal(value: Any, name: str) -> str | None:
    """Return why a function's code may not refer to an object by `name`; None if it may."""
    if any(value is known for known in UNINITIALISED):  # allowed as callees of NumPy functions
        return (
            f"it uses {name}, whose numbers are whatever was in memory before; write "
            f"{name.replace('empty', 'zeros')}"
        )
    if value is set or value is frozenset:
        return NO_ORDER
    return refusal_of_call(value, name)


def refusal_of_call(value: Any, name: str) -> str | None:
    """Return why neither a function nor its callees may use an object; None if they may."""
    if is_users(value):
        return None
    module = _origin(value)
    top = module.split(".")[0]
    if any(module == known or module.startswith(known + ".") for known in RANDOM):
        return (
            f"it draws random numbers, {name}: they would be the same constants for every body and "
            f"in every step; {ALONE}: sample a parameter instead, or draw "
            "lierb.noise.normal in a controller"
        )
    if top in CLOCKS or value is np.datetime64:  # it reads the clock for "now"
        return f"it reads a clock, {name}; {ALONE}: time in s is the argument t"
    bare = getattr(value, "__name__", "")
    is_builtin = top == "builtins" and value is getattr(builtins, bare, None)
    is_numpys = top == "numpy" and value is getattr(np, bare, None)
    if is_numpys and bare in TEXT_NUMPY:
        return TEXT
    if (
        (is_builtin and bare in OUTSIDE)
        or (is_numpys and bare in OUTSIDE_NUMPY)
        or (top == "numba" and bare == "objmode")
        or (top in sys.stdlib_module_names and top not in COMPUTING)
    ):
        return f"it uses {name}; {ALONE}: make what it reads a parameter"
    if is_builtin and bare in HIDDEN:
        return f"it uses {name}, which hides what it refers to from lierb"
    return None


def _origin(value: Any) -> str:
    """Name of an object's module; for a method, the module of its owner."""
    if isinstance(value, types.ModuleType):
        return value.__name__
    owner = getattr(value, "__self__", None)
    if callable(value) and owner is not None and not isinstance(owner, types.ModuleType):
        value = owner
    has_module = callable(value) and isinstance(getattr(value, "__module__", None), str)
    if not (isinstance(value, type) or has_module):
        value = type(value)
    return str(getattr(value, "__module__", ""))


def require_pure(function: Any, seen: list[Any]) -> None:
    """Raise UnfitFunctionError for the first forbidden object or instruction."""
    if function in seen:
        return
    seen.append(function)
    own, outer = function.__code__, dict(cells(function))
    known = dict(references(function)) | outer
    for code, free in _scopes(own, frozenset(own.co_freevars)):
        for chain in _chains(code, known):
            for _, value, line in chain:
                why = refusal(value, chain[-1][0])
                if why is not None:
                    raise UnfitFunctionError(f"{at(code, line)}: {why}")
                if is_users(value):
                    require_pure(undecorated(value), seen)
        steps: list[Any] = [None, *dis.get_instructions(code), None]
        for before, step, after in zip(steps, steps[1:], steps[2:], strict=False):
            why = _refusal_of_step(before, step, after, free)
            if why:
                line = step.positions.lineno if step.positions else None
                raise UnfitFunctionError(f"{at(code, line)}: {why}")


_CHANGES_GLOBAL = ("STORE_GLOBAL", "DELETE_GLOBAL")
_OF_ARRAYS = ("shape", "dtype", "strides", "real", "imag", "flat")  # they can be assigned


def _refusal_of_step(before: Any, step: Any, after: Any, free: frozenset[str]) -> str | None:
    """Return why an instruction, between two others, is forbidden; None if it is allowed."""
    if step.opname == "IMPORT_NAME":
        return "it imports something itself; import that outside"
    if _makes_set(step) and getattr(after, "opname", "") != "CONTAINS_OP":
        return NO_ORDER
    is_outer = step.opname in ("STORE_DEREF", "DELETE_DEREF") and step.argval in free
    changed = step.argval if is_outer or step.opname in _CHANGES_GLOBAL else None
    if step.opname in ("STORE_ATTR", "DELETE_ATTR"):
        if _is_outside(before, free):
            changed = f"{before.argval}.{step.argval}"
        elif step.argval not in _OF_ARRAYS:
            return NO_CHANGE.format(step.argval)
    return None if changed is None else f"it changes {changed}, which is not its own; {ALONE}"


def _is_outside(step: Any, free: frozenset[str]) -> bool:
    """Return whether an instruction reads a variable of an outer scope."""
    name = getattr(step, "opname", "")
    return name == "LOAD_GLOBAL" or (name == "LOAD_DEREF" and step.argval in free)


def _makes_set(step: Any) -> bool:
    return step.opname == "BUILD_SET" or (
        step.opname == "LOAD_CONST" and isinstance(step.argval, frozenset)
    )


def _scopes(code: types.CodeType, free: frozenset[str]) -> Iterator[tuple[Any, frozenset[str]]]:
    """Yield code and inner code, each with its variables of outer scopes."""
    yield code, free
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            yield from _scopes(constant, free & frozenset(constant.co_freevars))


Chain = list[tuple[str, Any, int | None]]


def _chains(code: types.CodeType, known: dict[str, Any]) -> Iterator[Chain]:
    """Yield (dotted name, value, line) for each name and the attributes that follow it."""
    chain: Chain = []
    for step in dis.get_instructions(code):
        line = step.positions.lineno if step.positions else None
        if step.opname in ("LOAD_ATTR", "LOAD_METHOD") and chain:
            name, value, _ = chain[-1]
            inner = (
                getattr(value, step.argval, None) if isinstance(value, types.ModuleType) else None
            )
            chain.append((f"{name}.{step.argval}", inner, line))
            continue
        if chain:
            yield chain
        named = step.opname in ("LOAD_GLOBAL", "LOAD_NAME", "LOAD_DEREF", "LOAD_CLASSDEREF")
        chain = [(step.argval, known.get(step.argval), line)] if named else []
