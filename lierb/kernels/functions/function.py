"""Kernels trace users' functions, which are plain Python, like lierb's own formulas.

A function runs once, on dual numbers over lane packs, while a kernel is compiled. A function that
cannot be traced, for example because it branches on numbers, is compiled by Numba and called body
by body.
"""

from __future__ import annotations

import math
from collections import namedtuple
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from functools import cache
from itertools import islice, repeat
from typing import Any

import numba
import numpy as np

from lierb.compiler.code import OPTIONS
from lierb.compiler.integers import CheckedIntegers
from lierb.kernels.functions.fingerprint import Reference
from lierb.kernels.functions.noise import drawing
from lierb.kernels.functions.object_arrays import numbers
from lierb.kernels.functions.references import UnfitFunctionError
from lierb.kernels.functions.refusals import NO_CHANGE
from lierb.kernels.functions.returned_values import as_result, brief, dictionary_of
from lierb.kernels.functions.shapes import Shape, Shapes, UserFunction
from lierb.kernels.functions.signals import NAMES, NO_SIGNALS, Noise, Signals
from lierb.kernels.functions.user_number import UserNumber
from lierb.kernels.numbers.arithmetic import flatten, plain
from lierb.kernels.tracing import calls
from lierb.kernels.tracing.lanes import Lane

BODY: Shapes = (("mass", ()), ("inertia", (3, 3)), ("com", (3,)))
WRENCH = ((3,), (3,))  # shapes of torque and force
# boundscheck: compiled indices may exceed an array; a trace checks them in Python.
COMPILED = OPTIONS | {"boundscheck": True, "pipeline_class": CheckedIntegers}


@dataclass(frozen=True)
class Function:
    """A user's function is a part of a kernel's tag.

    form : names of its arguments in the order of its signature: those of `arguments`, "params",
        "body", "states", "controls", "memory".
    arguments : names and shapes of the arguments.   shapes : shapes of the parameters.
    results : shapes of the results.
    is_traced : True if traced, False if compiled by Numba for one body at a time.
    references : objects that it refers to.   modules : modules of lierb that it uses.
    states, controls : names and shapes of the problem's states and controls.
    memory : names and shapes of the function's own memory.
    outputs : names and shapes of the dictionaries that it returns in place of `results`.
    draws : True if it may draw random numbers.
    """

    name: str
    fingerprint: str
    form: tuple[str, ...]
    arguments: Shapes
    shapes: Shapes
    results: tuple[Shape, ...]
    is_traced: bool
    python: UserFunction = field(compare=False, repr=False)
    references: tuple[Reference, ...] = field(compare=False, repr=False, default=())
    modules: tuple[str, ...] = field(compare=False, repr=False, default=())
    states: Shapes = ()
    controls: Shapes = ()
    memory: Shapes = ()
    outputs: tuple[Shapes, ...] = ()
    draws: bool = False

    def __call__(
        self,
        parameters: tuple[Any, ...],
        *arguments: Any,
        signals: Signals = NO_SIGNALS,
        noise: Noise | None = None,
    ) -> Any:
        """Evaluate the function; return numbers, vectors, and matrices row by row.

        A dictionary is returned as its numbers, in the order of its names in `outputs`.

        parameters : the function's parameters, followed by `BODY`'s if it takes the body.
        noise : source of random numbers.
        """
        if not self.is_traced:
            return self._of_one_body(self._numbers(parameters, arguments, signals))
        return self._checked(self.returned(parameters, arguments, signals, noise))

    def returned(
        self,
        parameters: tuple[Any, ...],
        arguments: tuple[Any, ...],
        signals: Signals,
        noise: Noise | None,
    ) -> Any:
        """Run the traced function; return its value unchecked."""
        inputs = self._numbers(parameters, arguments, signals)
        duals = (x if isinstance(x, UserNumber) else UserNumber(x) for x in inputs)
        with drawing(noise):
            return self.python(*self._bundled(duals, numbers))

    def _numbers(
        self, parameters: tuple[Any, ...], arguments: tuple[Any, ...], signals: Signals
    ) -> list[Any]:
        """Return the function's inputs as a list, in the order of `input_shapes`."""
        own = parameters if self.takes_body else parameters[: len(self.shapes)]
        taken = tuple(getattr(signals, name) for name, _ in self.namespaces)
        for (name, shapes), values in zip(self.namespaces, taken, strict=True):
            if len(values) != size_of(shapes):
                raise ValueError(
                    f"{self.name} takes {size_of(shapes)} numbers of {name}, got {len(values)}"
                )
        return [plain(x) for x in flatten((*arguments, *own, *taken))]

    @property
    def takes_body(self) -> bool:
        return "body" in self.form

    @property
    def takes_signals(self) -> bool:
        """Return whether the function must be bound to the states and controllers of a problem."""
        return "states" in self.form or "controls" in self.form

    @property
    def namespaces(self) -> tuple[tuple[str, Shapes], ...]:
        """Return the kinds of signals that the function takes, each with its names and shapes."""
        return tuple((name, getattr(self, name)) for name in NAMES if name in self.form)

    @property
    def input_shapes(self) -> tuple[Shape, ...]:
        """Return the shapes of arguments, parameters, the body's constants and signals."""
        body = BODY if self.takes_body else ()
        signals = (pair for _, shapes in self.namespaces for pair in shapes)
        return tuple(shape for _, shape in (*self.arguments, *self.shapes, *body, *signals))

    def samples(self) -> list[Any]:
        """Return zero arguments in the order of the function's signature."""
        return self._bundled(repeat(0.0), np.array)

    def _bundled(self, flat: Iterable[Any], array: Callable[[Any], Any]) -> list[Any]:
        """Group numbers in the order of `input_shapes` to arguments in that of the signature."""
        rest = iter(flat)

        def values(shapes: Shapes) -> Iterator[Any]:
            for _, shape in shapes:
                if shape:
                    yield array(list(islice(rest, math.prod(shape)))).reshape(shape)
                else:
                    yield next(rest)

        made = dict(zip((name for name, _ in self.arguments), values(self.arguments), strict=True))
        bundles = [("params", self.shapes), *self.namespaces]
        if self.takes_body:
            bundles.insert(1, ("body", BODY))
        for name, shapes in bundles:
            made[name] = _bundle_type(name, shapes)(*values(shapes))
        return [made[name] for name in self.form]

    def _checked(self, result: Any) -> Any:
        """Check a traced result; return its numbers."""
        if self.outputs:
            return self._by_name(result)
        if len(self.results) == 1:
            return as_result(self.name, result, self.results[0])
        if not isinstance(result, (tuple, list, np.ndarray)) or len(result) != len(self.results):
            raise UnfitFunctionError(
                f"{self.name} must return {len(self.results)} vectors"
                f"{', torque and force' if self.results == WRENCH else ''}, not {brief(result)}"
            )
        pairs = zip(result, self.results, strict=True)
        return tuple(as_result(self.name, x, shape) for x, shape in pairs)

    def _by_name(self, result: Any) -> Any:
        """Check returned dictionaries; return their numbers."""
        parts = []
        for values, shapes in zip(self.dictionaries(result), self.outputs, strict=True):
            if values.keys() != dict(shapes).keys():
                expected, got = dictionary_of(dict(shapes)), dictionary_of(values)
                raise UnfitFunctionError(f"{self.name} must return {expected}, not {got}")
            checked = (as_result(f"{self.name}'s {n}", values[n], shape) for n, shape in shapes)
            parts.append(tuple(flatten(tuple(checked))))
        return parts[0] if len(parts) == 1 else tuple(parts)

    def dictionaries(self, result: Any) -> tuple[dict[str, Any], ...]:
        """Return the returned dictionaries as a tuple, one for each item of `outputs`."""
        are_two = len(self.outputs) == 2
        parts = result if are_two else (result,)
        if (
            isinstance(parts, tuple)
            and len(parts) == len(self.outputs)
            and all(isinstance(each, dict) for each in parts)
        ):
            return parts
        expected = "two dictionaries, of outputs and of its memory" if are_two else "a dictionary"
        got = "one alone" if isinstance(result, dict) else brief(result)
        raise UnfitFunctionError(f"{self.name} must return {expected}, not {got}")

    def _of_one_body(self, inputs: list[Any]) -> Any:
        compiled, count = dispatcher_of(self), sum(math.prod(shape) for shape in self.results)
        if any(isinstance(x, Lane) for x in inputs):
            arguments = flatten(tuple(self._bundled(inputs, _Elements)))
            results = calls.call_compiled(compiled, [tuple(self.samples())], arguments, count)
        else:
            results = calls.call_in_python(compiled, tuple(self._bundled(inputs, np.array)), count)
        parts = []
        for shape in self.results:
            size = math.prod(shape)
            parts.append(tuple(results[:size]) if shape else results[0])
            results = results[size:]
        return parts[0] if len(parts) == 1 else tuple(parts)


class _Elements(tuple):  # elements of an array, row by row; `reshape` is a no-op
    def reshape(self, _: Shape) -> _Elements:
        return self


@cache
def _bundle_type(name: str, shapes: Shapes) -> Any:
    methods = {
        "__slots__": (), "__getattr__": _miss_attribute,
        "__setattr__": _refuse_attribute, "__delattr__": _refuse_attribute,
    }  # fmt: skip
    return type(name, (namedtuple("_Bundle", [n for n, _ in shapes]),), methods)


def _refuse_attribute(_: Any, name: str, *__: Any) -> None:
    raise UnfitFunctionError(NO_CHANGE.format(name))


def _miss_attribute(self: Any, name: str) -> Any:
    bundle, fields = type(self).__name__, ", ".join(self._fields) or "nothing"
    raise AttributeError(f"{bundle} has no {name}; it has {fields}", name=name, obj=self)


def size_of(shapes: Shapes) -> int:
    """Count the numbers in arrays of these shapes."""
    return sum(math.prod(shape) for _, shape in shapes)


@cache
def dispatcher_of(function: Function) -> Any:
    """Compile f((argument, …)) → (double, …) with all results of one body."""
    compiled = numba.njit(function.python, **COMPILED)
    double = numba.njit(_double, **COMPILED)

    def number(arguments):
        return (double(compiled(*arguments)),)

    def wrench(arguments):
        torque, force = compiled(*arguments)
        x, y, z = double(torque[0]), double(torque[1]), double(torque[2])
        return x, y, z, double(force[0]), double(force[1]), double(force[2])

    return numba.njit(number if function.results == ((),) else wrench, **COMPILED)


def _double(x):  # no annotations: Numba compares signatures
    return np.float64(float(x))  # in Numba, float() of a float32 is a float32
