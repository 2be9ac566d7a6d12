"""Functions of the user's inside kernels: plain Python, traced like lierb's own formulas.

A function runs on dual numbers that hold lane packs, once, while a kernel is compiled. One that
cannot (it branches on numbers, say) is compiled by Numba and called body by body instead.
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
from lierb.kernels.functions.shapes import Shape, Shapes
from lierb.kernels.functions.signals import NAMES, NO_SIGNALS, Noise, Signals
from lierb.kernels.functions.user_number import UserNumber
from lierb.kernels.numbers.arithmetic import flatten, plain
from lierb.kernels.tracing import calls
from lierb.kernels.tracing.lanes import Lane

BODY: Shapes = (("mass", ()), ("inertia", (3, 3)), ("com", (3,)))
# Reads past an array's end are looked for where functions run body by body: lanes cannot make any.
COMPILED = OPTIONS | {"boundscheck": True, "pipeline_class": CheckedIntegers}


@dataclass(frozen=True)
class Function:
    """A function of the user's, as a tag is made of it.

    form : names of what it takes, in its own order: arguments, "params", "body", "states",
        "controls", "memory".
    shapes : of its parameters, by name.   arguments : of the arguments, by name.
    results : of what it returns.   is_traced : or else compiled by Numba, for a body at a time.
    modules : those of lierb that it names something of.
    states, controls : of the problem that it is bound to, by name.   memory : its own, by name.
    outputs : of the dictionaries that it returns, in place of `results`, by name.
    draws : whether it may draw random numbers.
    """

    name: str
    fingerprint: str
    form: tuple[str, ...]
    arguments: Shapes
    shapes: Shapes
    results: tuple[Shape, ...]
    is_traced: bool
    python: Callable[..., Any] = field(compare=False, repr=False)
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
        """Its results; numbers and vectors as formulas have them, matrices row by row. Of a
        dictionary all numbers side by side, in the order of its names in `outputs`.

        parameters : its own, and then, of an element that sees it, the body's: `BODY`.
        noise : what it may draw random numbers of.
        """
        if not self.is_traced:
            return self._of_one_body(self._members(parameters, arguments, signals))
        return self._taken_apart(self.returned(parameters, arguments, signals, noise))

    def returned(
        self,
        parameters: tuple[Any, ...],
        arguments: tuple[Any, ...],
        signals: Signals,
        noise: Noise | None,
    ) -> Any:
        """What the traced function itself gives back."""
        members = self._members(parameters, arguments, signals)
        duals = (x if isinstance(x, UserNumber) else UserNumber(x) for x in members)
        with drawing(noise):
            return self.python(*self._bundled(duals, numbers))

    def _members(
        self, parameters: tuple[Any, ...], arguments: tuple[Any, ...], signals: Signals
    ) -> list[Any]:
        """All numbers that it is given, in the order of `given_shapes`."""
        own = parameters if self.takes_body else parameters[: len(self.shapes)]
        seen = tuple(getattr(signals, name) for name, _ in self.namespaces)
        for (name, shapes), found in zip(self.namespaces, seen, strict=True):
            if len(found) != size_of(shapes):
                raise ValueError(
                    f"{self.name} sees {size_of(shapes)} numbers of {name}, got {len(found)}"
                )
        return [plain(x) for x in flatten((*arguments, *own, *seen))]

    @property
    def takes_body(self) -> bool:
        return "body" in self.form

    @property
    def takes_signals(self) -> bool:
        """Whether it has to be bound to the states and controllers of a problem."""
        return "states" in self.form or "controls" in self.form

    @property
    def namespaces(self) -> tuple[tuple[str, Shapes], ...]:
        """Of the signals, those that it sees."""
        return tuple((name, getattr(self, name)) for name in NAMES if name in self.form)

    @property
    def given_shapes(self) -> tuple[Shape, ...]:
        """Of the arguments, of the parameters after them, of what is known of the body, and of the
        signals.
        """
        body = BODY if self.takes_body else ()
        seen = (pair for _, shapes in self.namespaces for pair in shapes)
        return tuple(shape for _, shape in (*self.arguments, *self.shapes, *body, *seen))

    def samples(self) -> list[Any]:
        """Arguments such as the function takes, all zero."""
        return self._bundled(repeat(0.0), np.array)

    def _bundled(self, flat: Iterable[Any], array: Callable[[Any], Any]) -> list[Any]:
        """What its members make up, in the order of the function's own arguments."""
        rest = iter(flat)

        def taken(shapes: Shapes) -> Iterator[Any]:
            for _, shape in shapes:
                if shape:
                    yield array(list(islice(rest, math.prod(shape)))).reshape(shape)
                else:
                    yield next(rest)

        made = dict(zip((name for name, _ in self.arguments), taken(self.arguments), strict=True))
        made["params"] = _bundle_type("params", self.shapes)(*taken(self.shapes))
        if self.takes_body:
            made["body"] = _bundle_type("body", BODY)(*taken(BODY))
        for name, shapes in self.namespaces:
            made[name] = _bundle_type(name, shapes)(*taken(shapes))
        return [made[name] for name in self.form]

    def _taken_apart(self, found: Any) -> Any:
        """Checked and taken apart: plain numbers out of duals."""
        if self.outputs:
            return self._by_name(found)
        if len(self.results) == 1:
            return as_result(self.name, found, self.results[0])
        if not isinstance(found, (tuple, list, np.ndarray)) or len(found) != len(self.results):
            raise UnfitFunctionError(
                f"{self.name} must return {len(self.results)} vectors, not {brief(found)}"
            )
        pairs = zip(found, self.results, strict=True)
        return tuple(as_result(self.name, x, shape) for x, shape in pairs)

    def _by_name(self, found: Any) -> Any:
        """The numbers of the dictionaries that it has returned."""
        parts = []
        for given, shapes in zip(self.dictionaries(found), self.outputs, strict=True):
            if given.keys() != dict(shapes).keys():
                expected, got = dictionary_of(dict(shapes)), dictionary_of(given)
                raise UnfitFunctionError(f"{self.name} must return {expected}, not {got}")
            taken = (as_result(f"{self.name}'s {n}", given[n], shape) for n, shape in shapes)
            parts.append(tuple(flatten(tuple(taken))))
        return parts[0] if len(parts) == 1 else tuple(parts)

    def dictionaries(self, found: Any) -> tuple[dict[str, Any], ...]:
        """What it has returned, as often as it has `outputs`."""
        given = (found,) if len(self.outputs) == 1 else found
        is_right = isinstance(given, tuple) and len(given) == len(self.outputs)
        if not (is_right and all(isinstance(each, dict) for each in given)):
            expected = "a dictionary" if len(self.outputs) == 1 else "two dictionaries"
            got = f"{brief(found)}" if not isinstance(found, dict) else "one alone"
            hint = "" if len(self.outputs) == 1 else ", of outputs and of its memory"
            raise UnfitFunctionError(f"{self.name} must return {expected}{hint}, not {got}")
        return tuple(given)

    def _of_one_body(self, members: list[Any]) -> Any:
        compiled, count = dispatcher_of(self), sum(math.prod(shape) for shape in self.results)
        samples = tuple(self.samples())
        if any(isinstance(x, Lane) for x in members):
            numbers = calls.call_compiled(compiled, [samples], self._flat(members), count)
        else:
            numbers = calls.call_in_python(compiled, tuple(self._bundled(members, np.array)), count)
        parts = []
        for shape in self.results:
            size = math.prod(shape)
            parts.append(tuple(numbers[:size]) if shape else numbers[0])
            numbers = numbers[size:]
        return parts[0] if len(parts) == 1 else tuple(parts)

    def _flat(self, members: list[Any]) -> list[Any]:
        """The members in the order in which `_bundled` puts them."""
        return [x for part in self._bundled(members, _object_array) for x in _members_of(part)]


@cache
def _bundle_type(name: str, shapes: Shapes) -> Any:
    return _unchangeable(namedtuple(name, [n for n, _ in shapes]))


def _unchangeable(bundle: Any) -> Any:
    bundle.__setattr__ = bundle.__delattr__ = _refuses_attribute
    bundle.__getattr__ = _lacks_attribute
    return bundle


def _lacks_attribute(self: Any, name: str) -> Any:
    what, there = type(self).__name__, ", ".join(self._fields) or "nothing"
    raise AttributeError(f"{what} has no {name}; it has {there}", name=name, obj=self)


def size_of(shapes: Shapes) -> int:
    """How many numbers there are."""
    return sum(math.prod(shape) for _, shape in shapes)


def _refuses_attribute(_: Any, name: str, *__: Any) -> None:
    raise UnfitFunctionError(NO_CHANGE.format(name))


def _object_array(members: list[Any]) -> Any:
    array = np.empty(len(members), dtype=object)
    array[:] = members
    return array


def _members_of(part: Any) -> list[Any]:
    if isinstance(part, np.ndarray):
        return list(part.flat)
    return [x for p in part for x in _members_of(p)] if isinstance(part, tuple) else [part]


# ---- body by body, compiled by Numba -----------------------------------------------------------


@cache
def dispatcher_of(function: Function) -> Any:
    """function((…,)) → all results as one tuple of doubles."""
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
    return np.float64(float(x))  # of a float32, Numba's float alone is one
