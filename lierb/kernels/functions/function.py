"""Functions of the user's inside kernels: plain Python, traced like lierb's own formulas.

A function runs on dual numbers that hold lane packs, once, while a kernel is compiled. One that
cannot (it branches on numbers, say) is compiled by Numba and called body by body instead.
"""

from __future__ import annotations

import builtins
import math
import types
from collections import namedtuple
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from functools import cache, lru_cache, partial
from itertools import islice, repeat
from typing import Any, NamedTuple

import numba
import numpy as np
from numba.extending import is_jitted

from lierb.compiler.code import OPTIONS, undisturbed
from lierb.compiler.integers import CheckedIntegers
from lierb.kernels.functions.fingerprint import (
    ALONE,
    NO_CHANGE,
    NO_ORDER,
    Reference,
    UnfitFunctionError,
    at,
    attributes_of,
    is_foreign,
    is_known,
    members,
    references,
)
from lierb.kernels.functions.math_functions import for_traces_of
from lierb.kernels.functions.noise import drawing
from lierb.kernels.functions.numpy_library import for_traces, is_numpy
from lierb.kernels.functions.object_arrays import has_traced, numbers
from lierb.kernels.functions.purity import MARK, require_pure_code, require_repeatable
from lierb.kernels.functions.signals import NAMES, NO_SIGNALS, Noise, Signals
from lierb.kernels.functions.user_number import Condition, UserNumber
from lierb.kernels.numbers.arithmetic import flatten, plain
from lierb.kernels.tracing import calls, trace
from lierb.kernels.tracing.lanes import Lane

Shape = tuple[int, ...]
Shapes = tuple[tuple[str, Shape], ...]
ANY: Shape = (-1,)  # a vector of as many components as there are
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
        own = parameters if self.sees_body else parameters[: len(self.shapes)]
        seen = tuple(getattr(signals, name) for name, _ in self.namespaces)
        for (name, shapes), found in zip(self.namespaces, seen, strict=True):
            if len(found) != size_of(shapes):
                raise ValueError(
                    f"{self.name} sees {size_of(shapes)} numbers of {name}, got {len(found)}"
                )
        return [plain(x) for x in flatten((*arguments, *own, *seen))]

    @property
    def sees_body(self) -> bool:
        return "body" in self.form

    @property
    def sees_others(self) -> bool:
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
        body = BODY if self.sees_body else ()
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
        if self.sees_body:
            made["body"] = _bundle_type("body", BODY)(*taken(BODY))
        for name, shapes in self.namespaces:
            made[name] = _bundle_type(name, shapes)(*taken(shapes))
        return [made[name] for name in self.form]

    def _taken_apart(self, found: Any) -> Any:
        """Checked and taken apart: plain numbers out of duals."""
        if self.outputs:
            return self._by_name(found)
        if len(self.results) == 1:
            return _as_result(self.name, found, self.results[0])
        if not isinstance(found, (tuple, list, np.ndarray)) or len(found) != len(self.results):
            raise UnfitFunctionError(
                f"{self.name} must return {len(self.results)} vectors, not {_brief(found)}"
            )
        pairs = zip(found, self.results, strict=True)
        return tuple(_as_result(self.name, x, shape) for x, shape in pairs)

    def _by_name(self, found: Any) -> Any:
        """The numbers of the dictionaries that it has returned."""
        parts = []
        for given, shapes in zip(self.dictionaries(found), self.outputs, strict=True):
            if given.keys() != dict(shapes).keys():
                raise UnfitFunctionError(
                    f"{self.name} must return {_named(dict(shapes))}, not {_named(given)}"
                )
            taken = (_as_result(f"{self.name}'s {n}", given[n], shape) for n, shape in shapes)
            parts.append(tuple(flatten(tuple(taken))))
        return parts[0] if len(parts) == 1 else tuple(parts)

    def dictionaries(self, found: Any) -> tuple[dict[str, Any], ...]:
        """What it has returned, as often as it has `outputs`."""
        given = (found,) if len(self.outputs) == 1 else found
        is_right = isinstance(given, tuple) and len(given) == len(self.outputs)
        if not (is_right and all(isinstance(each, dict) for each in given)):
            expected = "a dictionary" if len(self.outputs) == 1 else "two dictionaries"
            got = f"{_brief(found)}" if not isinstance(found, dict) else "one alone"
            hint = "" if len(self.outputs) == 1 else ", of outputs and of its memory"
            raise UnfitFunctionError(f"{self.name} must return {expected}{hint}, not {got}")
        return tuple(given)

    def _of_one_body(self, members: list[Any]) -> Any:
        compiled, count = _dispatcher(self), sum(math.prod(shape) for shape in self.results)
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


def _as_result(name: str, found: Any, shape: Shape) -> Any:
    if not shape:
        return _number(name, found)
    members = np.asarray(found if not has_traced(found) else numbers(found), dtype=object)
    if shape in (ANY, (1,)):  # one number will do for a vector of one
        members = np.atleast_1d(members)
    if members.shape != shape and not (shape == ANY and members.ndim == 1):
        raise UnfitFunctionError(f"{name} must return {shape[0]} components, not {_brief(found)}")
    return tuple(_number(name, x) for x in members.flat)


def _number(name: str, x: Any) -> Any:
    if isinstance(x, np.ndarray) and x.ndim == 0:
        x = x.item()
    if isinstance(x, Condition):
        x = x.number()
    if isinstance(x, UserNumber):
        return x if x.parts else x.value
    if isinstance(x, (int, float, np.integer, np.floating, np.bool_)):
        return float(x)
    raise UnfitFunctionError(f"{name} must return numbers, not {_brief(x)}")


def _brief(x: Any) -> str:
    if has_traced(x) or isinstance(x, np.ndarray):
        return f"an array of shape {np.shape(x)}" if isinstance(x, np.ndarray) else f"a {_kind(x)}"
    try:
        text = repr(x)
    except UnfitFunctionError:  # there are traced numbers deep inside
        return f"a {_kind(x)}"
    return text if len(text) < 60 and "object at" not in text else f"a {type(x).__name__}"


def _named(given: Iterable[Any]) -> str:
    return f"a dictionary of {', '.join(map(str, given)) or 'nothing'}"


def _kind(x: Any) -> str:
    return f"{type(x).__name__} of {len(x)}" if isinstance(x, (tuple, list)) else type(x).__name__


# ---- body by body, compiled by Numba -----------------------------------------------------------


@cache
def _dispatcher(function: Function) -> Any:
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


# ---- whether it runs ---------------------------------------------------------------------------


@lru_cache(256)  # by all that matters, its fingerprint: a sweep makes one force a thousand times
def trial(function: Function) -> int:
    """Trace the function, twice; how many numbers it returns.

    Raises whatever a function of the user's may raise when it is given packs of numbers, and
    UnfitFunctionError for one that is not a function of its arguments alone.
    """
    sizes = []

    def call(given: Given) -> Any:
        results = function(given.own, *given.arguments, signals=given.signals, noise=given.noise)
        sizes.append(len(flatten(results)))
        return results

    _traced_twice(function, call)
    return sizes[-1]


@lru_cache(256)
def outputs_of(function: Function) -> Shapes:
    """Names and shapes of the first dictionary that the function returns, by tracing it.

    Raises as `trial` does.
    """
    found: list[Shapes] = []

    def call(given: Given) -> Any:
        returned = function.returned(given.own, given.arguments, given.signals, given.noise)
        first = function.dictionaries(returned)[0]
        found.append(tuple((name, np.shape(_as_array(x))) for name, x in first.items()))
        return ()

    _traced_twice(function, call)
    return found[-1]


@lru_cache(256)
def gives_condition(function: Function) -> bool:
    """Whether a traced function returns whether something is so, in place of a number."""
    found: list[bool] = []

    def call(given: Given) -> Any:
        returned = function.returned(given.own, given.arguments, given.signals, given.noise)
        found.append(isinstance(returned, (Condition, bool, np.bool_)))
        return ()

    _traced_twice(function, call)
    return found[-1]


def _as_array(x: Any) -> Any:
    return numbers(x) if has_traced(x) and isinstance(x, (tuple, list)) else x


class Given(NamedTuple):
    """What a function is called with in a trial."""

    own: tuple[Any, ...]
    arguments: tuple[Any, ...]
    signals: Signals
    noise: Noise | None


def _traced_twice(function: Function, call: Callable[[Given], Any]) -> None:
    """Trace `call`, which gets packs of numbers such as the function takes, twice."""
    size = sum(math.prod(shape) for shape in function.given_shapes)
    draws = len(Noise._fields) if function.draws else 0

    def traced(*members: Any) -> Any:
        rest = iter(members)
        body = BODY if function.sees_body else ()
        arguments = tuple(islice(rest, size_of(function.arguments)))
        own = tuple(
            tuple(islice(rest, math.prod(shape))) if shape else next(rest)
            for _, shape in (*function.shapes, *body)
        )
        seen = {name: tuple(islice(rest, size_of(shapes))) for name, shapes in function.namespaces}
        noise = Noise(*rest) if draws else None
        return call(Given(own, arguments, Signals(**seen), noise))

    require_repeatable(lambda: trace.trial(traced, size + draws)[1])


def compile_alone(function: Function) -> None:
    """Compile the function for one body at a time; raises what Numba raises."""
    compiled, samples = _dispatcher(function), tuple(function.samples())
    if hasattr(compiled, "compile"):
        undisturbed(compiled.compile, (numba.typeof(samples),))
        require_pure_code(compiled)
    else:  # the JIT is off
        compiled(samples)


def where_it_was(error: BaseException | None) -> str | None:
    """The innermost line of the user's that an exception has passed; None if there is none."""
    found, trace = None, error.__traceback__ if error else None
    while trace is not None:
        if MARK in trace.tb_frame.f_globals:
            found = at(trace.tb_frame.f_code, trace.tb_lineno)
        trace = trace.tb_next
    return found


def line_that_raised(error: Exception, functions: Iterable[Function]) -> str | None:
    """The line of the user's at which compiled code has raised, if Numba knows it.

    It adds a frame for it that has a file and a line, and nothing else of the function's.
    """
    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    files = {function.python.__code__.co_filename for function in functions}
    if trace is None or trace.tb_frame.f_code.co_filename not in files:
        return None
    return at(trace.tb_frame.f_code, trace.tb_lineno)


# ---- made fit for either way -------------------------------------------------------------------

Replace = Callable[[Any], Any]


def traceable(function: Callable[..., Any]) -> Callable[..., Any]:
    """The function, and all that it calls, with `math` and NumPy as dual numbers bear them.

    What it refers to is copied: what becomes of it later changes nothing here.
    """
    return _Rebuilt(lambda helper: helper, _for_traces, _frozen).function(function)


def compilable(function: Callable[..., Any]) -> Callable[..., Any]:
    """The function with all that it calls compiled by Numba; copied as by `traceable`."""
    return _Rebuilt(partial(numba.njit, **COMPILED), lambda known: known, _constant).function(
        function
    )


def _for_traces(value: Any) -> Any:
    return for_traces(value) if is_numpy(value) else for_traces_of(value)


class _Rebuilt:
    """Makes copies of functions, in which all that they refer to is replaced.

    helper : what stands for functions of the user's.   known : for what a known package has.
    container : for lists, dictionaries and sets, made of (name, the container with its members
    replaced).
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
    """What a function uses of a module of the user's."""

    def __setattr__(self, name: str, value: Any) -> None:
        raise UnfitFunctionError(f"it changes {self.__name__}.{name}; {ALONE}")


def _constant(name: str, value: Any) -> Any:
    """As Numba knows constants: it has tuples, and no lists."""
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
    """A set of the user's: no more than what is in it, for it has an order of each process."""

    def __init__(self, members: frozenset[Any]) -> None:
        self.__contains = members.__contains__
        self.__count = len(members)

    def __contains__(self, member: Any) -> bool:
        return self.__contains(member)

    def __len__(self) -> int:
        return self.__count

    def _refuses_more(self, *_: Any) -> Any:
        raise UnfitFunctionError(NO_ORDER)

    __hash__ = None  # type: ignore[assignment]
    __iter__ = __getattr__ = __eq__ = __lt__ = __le__ = __gt__ = __ge__ = _refuses_more
    __or__ = __and__ = __sub__ = __xor__ = __ror__ = __rand__ = __rsub__ = __rxor__ = _refuses_more
