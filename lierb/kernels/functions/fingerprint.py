"""What a function refers to, and its fingerprint: equal for functions that compute the same.

A kernel's name in the disk cache holds the fingerprints of the user's functions in it, so that an
edited function, helper or constant is compiled anew. What cannot have a fingerprint, because it is
no function of its arguments, is refused here: by name, before anything runs.
"""

from __future__ import annotations

import builtins
import dis
import hashlib
import linecache
import sys
import types
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba.extending import is_jitted

LITERALS = (type(None), bool, int, float, complex, str, bytes, slice, range, type(...))
KNOWN = {"numpy", "numba", "lierb", *sys.stdlib_module_names}  # packages whose names say it all
# Of the standard library, what does nothing but compute.
COMPUTING = {
    "builtins", "math", "cmath", "operator", "_operator", "functools", "_functools", "itertools",
    "numbers", "fractions", "collections", "_collections", "_collections_abc", "typing", "types",
    "enum", "abc", "dataclasses", "copy", "__future__",
}  # fmt: skip
RANDOM = ("random", "_random", "secrets", "uuid", "numpy.random")
CLOCKS = ("time", "datetime", "_datetime", "zoneinfo")
# With these a function gets at what nobody can see from outside.
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
ALONE = "a function of the user's is one of its arguments alone"
NO_CHANGE = (
    "it changes .{}: parameters cannot be changed, nor what else it is given; use a variable of "
    "your own"
)


class UnfitFunctionError(TypeError):
    """A function that lierb cannot run in its kernels; says why."""


def fingerprint(function: Callable[..., Any]) -> str:
    """A digest of the function's code and of everything that it refers to."""
    _require_pure(function, [])
    description = _described_function(function, [function])
    return hashlib.sha256(repr(description).encode()).hexdigest()[:32]


def at(code: types.CodeType, line: int | None) -> str:
    """A line of the user's source, for messages."""
    source = linecache.getline(code.co_filename, line or 0).strip()
    return f'line {line}, "{source}"' if source else f"line {line} of {code.co_name}"


# ---- what it refers to -------------------------------------------------------------------------


def references(function: Any) -> Iterator[tuple[str, Any]]:
    """The globals and built-ins that a function's code names, its inner functions' included."""
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
    """Its closure: variables of the functions around it, as far as they have values."""
    for name, cell in zip(function.__code__.co_freevars, function.__closure__ or (), strict=True):
        try:
            yield name, cell.cell_contents
        except ValueError:
            raise UnfitFunctionError(f"it refers to {name}, which has no value yet") from None


def codes(code: types.CodeType) -> Iterator[types.CodeType]:
    """The code, and that of the functions inside."""
    yield code
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            yield from codes(constant)


def attributes_of(function: Any) -> set[str]:
    """Names that may stand after a dot in its code."""
    return {name for code in codes(function.__code__) for name in code.co_names}


def members(name: str, module: types.ModuleType, attributes: set[str]) -> Iterator[Any]:
    """What a function may mean by `module.attribute`, and by what is in modules that it names.

    Yields (dotted name, module, attribute, value).
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
    """Whether its name says it all."""
    return module.__name__.split(".")[0] in KNOWN


# ---- what no function of its arguments does ----------------------------------------------------


def refusal(value: Any, name: str) -> str | None:
    """Why a function may not name this, known to it as `name`; None if it may."""
    if any(value is known for known in UNINITIALISED):  # which NumPy's own functions call
        return (
            f"it uses {name}, whose numbers are whatever was in memory before; write "
            f"{name.replace('empty', 'zeros')}"
        )
    if value is set or value is frozenset:
        return NO_ORDER
    return refusal_of_call(value, name)


def refusal_of_call(value: Any, name: str) -> str | None:
    """Why neither a function nor what it calls may use this; None if they may."""
    if _is_users(value):
        return None
    module = _origin(value)
    top = module.split(".")[0]
    if any(module == known or module.startswith(known + ".") for known in RANDOM):
        return (
            f"it draws random numbers, {name}: they would be the same constants for every body and "
            f"in every step; {ALONE}: sample a parameter instead, or draw "
            "lierb.noise.normal in a controller"
        )
    if top in CLOCKS or value is np.datetime64:  # of "now"
        return f"it reads a clock, {name}; {ALONE}: time in s is the argument t"
    bare = getattr(value, "__name__", "")
    if top == "numpy" and bare in TEXT_NUMPY and value is getattr(np, bare, None):
        return TEXT
    outside = (
        (top == "builtins" and value is getattr(builtins, bare, None) and bare in OUTSIDE)
        or (module in ("io", "_io"))
        or (top == "numpy" and bare in OUTSIDE_NUMPY and value is getattr(np, bare, None))
        or (top == "numba" and bare == "objmode")
        or (top in sys.stdlib_module_names and top not in COMPUTING)
    )
    if outside:
        return f"it uses {name}; {ALONE}: make what it reads a parameter"
    if top == "builtins" and bare in HIDDEN and value is getattr(builtins, bare):
        return f"it uses {name}, behind which lierb cannot look"
    return None


def _origin(value: Any) -> str:
    """The module that something comes from: for methods, that of what they belong to."""
    if isinstance(value, types.ModuleType):
        return value.__name__
    owner = getattr(value, "__self__", None)
    if callable(value) and owner is not None and not isinstance(owner, types.ModuleType):
        value = owner
    if not (isinstance(value, type) or callable(value)):
        value = type(value)
    if not isinstance(value, type) and not isinstance(getattr(value, "__module__", None), str):
        value = type(value)
    return str(getattr(value, "__module__", ""))


def _require_pure(function: Any, seen: list[Any]) -> None:
    """Raise for what a function's code names and may not, line by line."""
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
                if _is_users(value):
                    _require_pure(_undecorated(value), seen)
        steps: list[Any] = [None, *dis.get_instructions(code), None]
        for before, step, after in zip(steps, steps[1:], steps[2:], strict=False):
            why = _refusal_of_step(before, step, after, free)
            if why:
                line = step.positions.lineno if step.positions else None
                raise UnfitFunctionError(f"{at(code, line)}: {why}")


_CHANGES_GLOBAL = ("STORE_GLOBAL", "DELETE_GLOBAL")
_OF_ARRAYS = ("shape", "dtype", "strides", "real", "imag", "flat")  # attributes that can be set


def _refusal_of_step(before: Any, step: Any, after: Any, free: frozenset[str]) -> str | None:
    """What is wrong with one instruction between two others."""
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
    """Whether an instruction reads a variable that is not the function's own."""
    return getattr(step, "opname", "") == "LOAD_GLOBAL" or (
        getattr(step, "opname", "") == "LOAD_DEREF" and step.argval in free
    )


def _makes_set(step: Any) -> bool:
    return step.opname == "BUILD_SET" or (
        step.opname == "LOAD_CONST" and isinstance(step.argval, frozenset)
    )


def _scopes(code: types.CodeType, free: frozenset[str]) -> Iterator[tuple[Any, frozenset[str]]]:
    """The code and what is inside, each with the variables that are not the function's own."""
    yield code, free
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            yield from _scopes(constant, free & frozenset(constant.co_freevars))


Chain = list[tuple[str, Any, int | None]]


def _chains(code: types.CodeType, known: dict[str, Any]) -> Iterator[Chain]:
    """Names with what follows them dot by dot: (dotted name, value in its module, line) each."""
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


def _undecorated(value: Any) -> Any:
    return value.py_func if is_jitted(value) else value


def _is_users(value: Any) -> bool:
    value = _undecorated(value)
    return isinstance(value, types.FunctionType) and not is_foreign(value)


# ---- descriptions ------------------------------------------------------------------------------


def _described(value: Any, name: str, path: list[Any]) -> Any:
    """A value as nested tuples of text and numbers, equal for what computes the same."""
    value = _undecorated(value)
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
        f"it refers to {name}, a {type(value).__name__}, of which lierb cannot tell when it "
        "changes; use numbers, arrays and functions, or parameters"
    )


def _described_function(function: Any, path: list[Any]) -> Any:
    return (
        _described_code(function.__code__, path),
        *((name, _described(value, name, path)) for name, _, _, value in _surroundings(function)),
    )


def _surroundings(function: Any) -> Iterator[tuple[str, Any, Any, Any]]:
    """What a function refers to: (name, owner, key, value), where owner[key] is the value."""
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


def modules_named(value: Any, attributes: set[str], seen: list[tuple[Any, set[str]]]) -> set[str]:
    """The modules of lierb that a value, and all that it refers to, names something of.

    attributes : what may stand after a dot where it is used.   seen : what has been looked at.
    """
    value, within = _undecorated(value), []
    if any(value is known and attributes == used for known, used in seen):
        return set()
    seen.append((value, attributes))
    if isinstance(value, (tuple, list)):
        within = list(value)
    elif isinstance(value, dict):
        within = list(value.values())
    elif isinstance(value, types.ModuleType):
        within = [vars(value)[name] for name in attributes & vars(value).keys()]
    elif _is_users(value):
        attributes = attributes_of(value)
        within = [x for *_, x in _surroundings(value)]
    key = "__name__" if isinstance(value, types.ModuleType) else "__module__"
    name = str(getattr(value, key, ""))
    found = {name} if name.startswith("lierb.") else set()
    return found.union(*(modules_named(x, attributes, seen) for x in within))


# ---- whether it is still what it was -----------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Reference:
    """What a function refers to, where it found it, and what that was."""

    name: str
    owner: Any
    key: str
    value: Any
    content: Any
    is_mutable: bool

    def has_changed(self) -> bool:
        """Whether there is something else now; at once where the object is and stays the same."""
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
    """Everything outside that a function, and those that it calls, have been compiled with."""
    return tuple(_watched(function, []))


def _watched(function: Any, seen: list[Any]) -> Iterator[Reference]:
    if function in seen:
        return
    seen.append(function)
    for name, owner, key, value in _surroundings(function):
        if value is None and owner is function:
            continue
        if type(owner) is dict and key not in owner:  # a built-in
            continue
        mutable = _is_mutable(value)
        if not isinstance(value, types.ModuleType) or not is_known(value):
            content = _described(value, name, [])
            yield Reference(name, owner, key, value, content, mutable)
        for inner in _functions_in(value):
            yield from _watched(inner, seen)


def _is_mutable(value: Any) -> bool:
    if isinstance(value, tuple):
        return any(map(_is_mutable, value))
    return isinstance(value, (list, dict, set, np.ndarray))


def _functions_in(value: Any) -> Iterator[Any]:
    if isinstance(value, (tuple, list)):
        for x in value:
            yield from _functions_in(x)
    elif isinstance(value, dict):
        yield from _functions_in(list(value.values()))
    elif _is_users(value):
        yield _undecorated(value)
