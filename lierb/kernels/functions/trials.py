"""Trials of users' functions, by two traces or by Numba, before a kernel calls them."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache
from itertools import islice
from typing import Any

import numba
import numpy as np

from lierb.compiler.code import run_uninterrupted
from lierb.kernels.functions.function import BODY, Function, dispatcher_of, size_of
from lierb.kernels.functions.purity import require_pure_code, require_repeatable
from lierb.kernels.functions.returned_values import as_array
from lierb.kernels.functions.shapes import Shapes
from lierb.kernels.functions.signals import Noise, Signals
from lierb.kernels.functions.user_number import Condition, UserNumber, noted_switches
from lierb.kernels.numbers.arithmetic import flatten
from lierb.kernels.tracing import trace


@lru_cache(256)  # keys are fingerprints: a sweep makes one force a thousand times
def trial(function: Function) -> int:
    """Trace the function twice; return the number of its results.

    Raises any exception that the user's function raises on lane packs, and UnfitFunctionError if it
    depends on more than its arguments.
    """

    def call(own: Any, arguments: Any, signals: Signals, noise: Noise | None) -> Any:
        results = function(own, *arguments, signals=signals, noise=noise)
        return results, len(flatten(results))

    return int(_traced_twice(function, call))


@lru_cache(256)
def outputs_of(function: Function) -> Shapes:
    """Return the names and shapes of the function's first returned dictionary, by a trial."""

    def call(*inputs: Any) -> Any:
        first = function.dictionaries(function.returned(*inputs))[0]
        return (), tuple((name, np.shape(as_array(x))) for name, x in first.items())

    return _traced_twice(function, call)


@lru_cache(256)
def returns_condition(function: Function) -> bool:
    """Return whether a traced function returns a condition in place of a number."""

    def call(*inputs: Any) -> Any:
        return (), isinstance(function.returned(*inputs), (Condition, bool, np.bool_))

    return bool(_traced_twice(function, call))


@lru_cache(256)
def switches(function: Function, times: tuple[str, ...] = ()) -> bool:
    """Return whether a traced function compares numbers of the motion or parameters, or jumps.

    Comparisons of the time alone, and of parameters that are times, do not count.

    times : names of these parameters.
    """
    noted_switches()

    def marked(value: Any, is_marked: bool) -> Any:
        if isinstance(value, tuple):
            return tuple(marked(x, is_marked) for x in value)
        return UserNumber(value, (1.0,)) if is_marked else value

    def call(own: Any, arguments: Any, signals: Signals, noise: Noise | None) -> Any:
        of_motion = [n != "t" for n, shape in function.arguments for _ in range(math.prod(shape))]
        of_motion_marked = tuple(map(marked, arguments, of_motion))
        names = [name for name, _ in function.shapes]
        parameters = tuple(
            marked(x, i >= len(names) or names[i] not in times) for i, x in enumerate(own)
        )
        known = Signals(*marked(tuple(signals), True))
        function.returned(parameters, of_motion_marked, known, noise)
        return (), noted_switches()

    return bool(_traced_twice(function, call))


def _traced_twice(function: Function, call: Callable[..., tuple[Any, Any]]) -> Any:
    """Trace `call` twice on lane packs in the shapes of the function's inputs.

    call : (parameters, arguments, signals, noise) → (traced results, information). The information
    of the last trace is returned.
    """
    size = sum(math.prod(shape) for shape in function.input_shapes)
    draws = len(Noise._fields) if function.draws else 0
    information: Any = None

    def traced(*numbers: Any) -> Any:
        nonlocal information
        rest = iter(numbers)
        body = BODY if function.takes_body else ()
        arguments = tuple(islice(rest, size_of(function.arguments)))
        own = tuple(
            tuple(islice(rest, math.prod(shape))) if shape else next(rest)
            for _, shape in (*function.shapes, *body)
        )
        signals = Signals(
            **{name: tuple(islice(rest, size_of(shapes))) for name, shapes in function.namespaces}
        )
        results, information = call(own, arguments, signals, Noise(*rest) if draws else None)
        return results

    require_repeatable(lambda: trace.trial(traced, size + draws)[1])
    return information


def compile_alone(function: Function) -> None:
    """Compile the function for one body at a time. Raises any error of Numba."""
    compiled, samples = dispatcher_of(function), tuple(function.samples())
    if hasattr(compiled, "compile"):
        run_uninterrupted(compiled.compile, (numba.typeof(samples),))
        require_pure_code(compiled)
    else:  # the JIT is off
        compiled(samples)
