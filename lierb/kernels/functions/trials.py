"""Trials of users' functions before a kernel calls them: traced twice, or compiled by Numba."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache
from itertools import islice
from typing import Any, NamedTuple

import numba
import numpy as np

from lierb.compiler.code import undisturbed
from lierb.kernels.functions.function import BODY, Function, dispatcher_of, size_of
from lierb.kernels.functions.purity import require_pure_code, require_repeatable
from lierb.kernels.functions.returned_values import as_array
from lierb.kernels.functions.shapes import Shapes
from lierb.kernels.functions.signals import Noise, Signals
from lierb.kernels.functions.user_number import Condition
from lierb.kernels.numbers.arithmetic import flatten
from lierb.kernels.tracing import trace

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
        found.append(tuple((name, np.shape(as_array(x))) for name, x in first.items()))
        return ()

    _traced_twice(function, call)
    return found[-1]


@lru_cache(256)
def returns_condition(function: Function) -> bool:
    """Whether a traced function returns whether something is so, in place of a number."""
    found: list[bool] = []

    def call(given: Given) -> Any:
        returned = function.returned(given.own, given.arguments, given.signals, given.noise)
        found.append(isinstance(returned, (Condition, bool, np.bool_)))
        return ()

    _traced_twice(function, call)
    return found[-1]


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
        body = BODY if function.takes_body else ()
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
    compiled, samples = dispatcher_of(function), tuple(function.samples())
    if hasattr(compiled, "compile"):
        undisturbed(compiled.compile, (numba.typeof(samples),))
        require_pure_code(compiled)
    else:  # the JIT is off
        compiled(samples)
