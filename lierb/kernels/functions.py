"""Functions of the user's inside kernels: plain Python, traced like lierb's own formulas.

A function runs on dual numbers that hold lane packs, once, while a kernel is compiled. One that
cannot (it branches on numbers, say) is compiled by Numba and called body by body instead.
"""

from __future__ import annotations

import builtins
import math
import types
from collections import namedtuple
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from functools import cache, partial
from itertools import islice, repeat
from typing import Any

import numba
import numpy as np
from numba.core.registry import CPUDispatcher
from numba.extending import overload

from lierb.kernels import _jit
from lierb.kernels.arithmetic import flatten, plain
from lierb.kernels.dual import REPLACEMENTS, Dual, where
from lierb.kernels.fingerprint import UnfitFunctionError, is_foreign, references
from lierb.kernels.lanes import Lane

Shape = tuple[int, ...]
Shapes = tuple[tuple[str, Shape], ...]
ANY: Shape = (-1,)  # a vector of as many components as there are


@dataclass(frozen=True)
class Function:
    """A function of the user's, as a tag is made of it.

    shapes : of its parameters, by name.   arguments : of what comes before them.
    results : of what it returns.   is_traced : or else compiled by Numba, for a body at a time.
    """

    name: str
    fingerprint: str
    arguments: tuple[Shape, ...]
    shapes: Shapes
    results: tuple[Shape, ...]
    is_traced: bool
    python: Callable[..., Any] = field(compare=False, repr=False)

    def __call__(self, parameters: tuple[Any, ...], *arguments: Any) -> Any:
        """Its results; numbers and vectors as formulas have them, matrices row by row."""
        members = [plain(x) for x in flatten((*arguments, *parameters))]
        if not self.is_traced:
            return self._of_one_body(members)
        duals = (x if isinstance(x, Dual) else Dual(x) for x in members)
        return self._taken_apart(self.python(*self._bundled(duals, _object_array)))

    @property
    def given_shapes(self) -> tuple[Shape, ...]:
        """Of the arguments, and of the parameters after them."""
        return (*self.arguments, *(shape for _, shape in self.shapes))

    def samples(self) -> list[Any]:
        """Arguments such as the function takes, all zero."""
        return self._bundled(repeat(0.0), np.array)

    def _bundled(self, flat: Iterable[Any], array: Callable[[Any], Any]) -> list[Any]:
        """The arguments that its members make up, `params` last."""
        rest = iter(flat)
        made = [
            array(list(islice(rest, math.prod(shape)))).reshape(shape) if shape else next(rest)
            for shape in self.given_shapes
        ]
        count = len(self.arguments)
        names = tuple(name for name, _ in self.shapes)
        return [*made[:count], _bundle_type(names)(*made[count:])]

    def _taken_apart(self, found: Any) -> Any:
        """Checked and taken apart: plain numbers out of duals."""
        if len(self.results) == 1:
            return _as_result(self.name, found, self.results[0])
        if not isinstance(found, (tuple, list)) or len(found) != len(self.results):
            raise UnfitFunctionError(
                f"{self.name} must return {len(self.results)} vectors, not {_brief(found)}"
            )
        pairs = zip(found, self.results, strict=True)
        return tuple(_as_result(self.name, x, shape) for x, shape in pairs)

    def _of_one_body(self, members: list[Any]) -> Any:
        compiled, count = _dispatcher(self), sum(math.prod(shape) for shape in self.results)
        if any(isinstance(x, Lane) for x in members):
            numbers = _jit.call_compiled(compiled, self.samples(), members, count)
        else:
            numbers = compiled(*self._bundled(members, np.array))
        parts = []
        for shape in self.results:
            size = math.prod(shape)
            parts.append(tuple(numbers[:size]) if shape else numbers[0])
            numbers = numbers[size:]
        return parts[0] if len(parts) == 1 else tuple(parts)


@cache
def _bundle_type(names: tuple[str, ...]) -> Any:
    return namedtuple("params", names)


def _object_array(members: list[Any]) -> Any:
    array = np.empty(len(members), dtype=object)
    array[:] = members
    return array


def _as_result(name: str, found: Any, shape: Shape) -> Any:
    if not shape:
        return _number(name, found)
    members = np.asarray(found, dtype=object)
    if shape in (ANY, (1,)):  # one number will do for a vector of one
        members = np.atleast_1d(members)
    if members.shape != shape and not (shape == ANY and members.ndim == 1):
        raise UnfitFunctionError(f"{name} must return {shape[0]} components, not {_brief(found)}")
    return tuple(_number(name, x) for x in members.flat)


def _number(name: str, x: Any) -> Any:
    if isinstance(x, np.ndarray) and x.ndim == 0:
        x = x.item()
    if isinstance(x, Dual):
        return x if x.parts else x.value
    if isinstance(x, (int, float, np.integer, np.floating)):
        return float(x)
    raise UnfitFunctionError(f"{name} must return numbers, not {_brief(x)}")


def _brief(x: Any) -> str:
    text = repr(x)
    return text if len(text) < 60 and "object at" not in text else f"a {type(x).__name__}"


# ---- body by body, compiled by Numba -----------------------------------------------------------


@cache
def _dispatcher(function: Function) -> Any:
    """function(…) → all results as one tuple of floats."""
    compiled = numba.njit(function.python, **_jit.OPTIONS)

    def number_of_time(t, params):
        return (float(compiled(t, params)),)

    def number_of_pose(R, r, params):
        return (float(compiled(R, r, params)),)

    def wrench(t, R, r, omega, v, params):
        torque, force = compiled(t, R, r, omega, v, params)
        x, y, z = torque[0], torque[1], torque[2]
        return float(x), float(y), float(z), float(force[0]), float(force[1]), float(force[2])

    # Numba cannot compile a function of *arguments ahead of its first call.
    forms = {1: number_of_time, 2: number_of_pose, 5: wrench}
    return numba.njit(forms[len(function.arguments)], **_jit.OPTIONS)


# ---- whether it runs ---------------------------------------------------------------------------


def trial(function: Function) -> int:
    """Trace the function once; how many numbers it returns.

    Raises whatever a function of the user's may raise when it is given packs of numbers.
    """

    def call(*numbers: Any) -> Any:
        results = function((), *numbers)
        return tuple(x if isinstance(x, Lane) else 0.0 for x in flatten(results))

    size = sum(math.prod(shape) for shape in function.given_shapes)
    return len(_jit.trial(call, size))


def compile_alone(function: Function) -> None:
    """Compile the function for one body at a time; raises what Numba raises."""
    compiled, samples = _dispatcher(function), function.samples()
    if hasattr(compiled, "compile"):
        compiled.compile(tuple(numba.typeof(x) for x in samples))
    else:  # the JIT is off
        compiled(*samples)


# ---- made fit for either way -------------------------------------------------------------------

Replace = Callable[[Any], Any]


def traceable(function: Callable[..., Any]) -> Callable[..., Any]:
    """The function, and all that it calls, with `math` replaced by what dual numbers bear."""
    return _rebuilt(function, lambda helper: helper, _for_duals, {})


def compilable(function: Callable[..., Any]) -> Callable[..., Any]:
    """The function with all that it calls compiled by Numba."""
    return _rebuilt(function, partial(numba.njit, **_jit.OPTIONS), lambda known: known, {})


def _for_duals(known: Any) -> Any:
    if known is math:
        return _MATH
    is_function = isinstance(known, (types.BuiltinFunctionType, types.FunctionType, type))
    return REPLACEMENTS.get(known, known) if is_function else known


def _rebuilt(function: Any, helper: Replace, known: Replace, done: dict[int, Any]) -> Any:
    """A copy in which functions of the user's are replaced by `helper`, all else by `known`."""
    if id(function) in done:
        return done[id(function)]

    def replaced(value: Any) -> Any:
        if isinstance(value, CPUDispatcher):
            value = value.py_func
        if isinstance(value, types.FunctionType) and not is_foreign(value):
            return helper(_rebuilt(value, helper, known, done))
        return known(value)

    rebuilt = types.FunctionType(
        function.__code__, {"__builtins__": builtins}, function.__name__, function.__defaults__,
        tuple(types.CellType() for _ in function.__closure__ or ()) or None,
    )  # fmt: skip
    rebuilt.__kwdefaults__ = function.__kwdefaults__
    done[id(function)] = rebuilt
    rebuilt.__globals__.update((name, replaced(value)) for name, value in references(function))
    for cell, old in zip(rebuilt.__closure__ or (), function.__closure__ or (), strict=True):
        cell.cell_contents = replaced(old.cell_contents)
    return rebuilt


@overload(where)
def _where_of_one_body(condition, a, b):  # no annotations: Numba compares signatures
    return lambda condition, a, b: a if condition else b


_MATH = types.SimpleNamespace(
    **vars(math) | {f.__name__: new for f, new in REPLACEMENTS.items() if f.__module__ == "math"}
)
