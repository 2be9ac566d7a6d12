"""How a function of the user's becomes one that kernels call: its form, its trial, its refusal."""

from __future__ import annotations

import inspect
import warnings
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

from lierb.errors import ForceError, ScalarFunctionWarning
from lierb.kernels.functions.copies import compilable, traceable
from lierb.kernels.functions.fingerprint import fingerprint, modules_named, watched
from lierb.kernels.functions.function import Function
from lierb.kernels.functions.references import UnfitFunctionError
from lierb.kernels.functions.refusals import TEXT
from lierb.kernels.functions.shapes import Shape
from lierb.kernels.functions.source_lines import where_it_was
from lierb.kernels.functions.trials import compile_alone, trial

ARGUMENTS: dict[str, Shape] = {"t": (), "R": (3, 3), "r": (3,), "omega": (3,), "v": (3,)}
SIGNALS = ("states", "controls")
# Measured with AVX-512, one thread, RK4: a spring with drag and a stop, 13 and 14 times on a free
# body, 36 and 58 on a revolute joint. A function that makes no array loses nothing.
BODY_BY_BODY = "10 to 60 times slower"
DERIVATIVES = "its derivatives are needed as well"

_warned: set[str] = set()  # fingerprints of functions that run body by body


def user_function(
    function: Callable[..., Any],
    arguments: tuple[str, ...],
    shapes: dict[str, Shape],
    results: tuple[Shape, ...],
    because: str | None = None,
    form: Callable[[Callable[..., Any], str, bool], tuple[str, ...]] | None = None,
) -> Function:
    """The function as kernels take it: traced if it can be, else compiled by Numba. One that sees
    states or controls is not tried before it is bound to a problem's, by `runnable`.

    because : why it must be traced, if it must.   form : finds what it is given, as `form_of` does.
    """
    given_to = form or partial(form_of, arguments)
    made = described(function, arguments, shapes, results, given_to)
    return made if made.sees_others else runnable(made, function, because)


def described(
    function: Callable[..., Any],
    arguments: tuple[str, ...],
    shapes: dict[str, Shape],
    results: tuple[Shape, ...],
    form: Callable[[Callable[..., Any], str, bool], tuple[str, ...]],
    **more: Any,
) -> Function:
    """The function as it would be traced, not tried yet.   more : fields of a Function."""
    name = getattr(function, "__name__", "function")
    given_to = form(function, name, bool(shapes))
    try:
        mark, references = fingerprint(function), watched(function)
        modules = tuple(sorted(modules_named(function, set(), [])))
        python = traceable(function)
    except UnfitFunctionError as error:
        raise ForceError(f"{name} cannot be compiled: {error}") from None
    given = tuple((argument, ARGUMENTS[argument]) for argument in arguments)
    fields = (name, mark, given_to, given, tuple(shapes.items()), results)
    return Function(*fields, True, python, references, modules, **more)


def runnable(
    traced: Function, function: Callable[..., Any], because: str | None = None
) -> Function:
    """The function that runs: as described where it can be traced, else compiled by Numba.

    function : of the user's, that `traced` is made of.   because : as of `user_function`.
    """
    name = traced.name
    reason = why_untraced(traced, trial)
    if reason is None:
        return traced
    if because:
        raise ForceError(f"{name} must run for many bodies at once, because {because}; {reason}")
    compiled = replace(traced, is_traced=False, python=compilable(function))
    try:
        compile_alone(compiled)
    except UnfitFunctionError as error:
        raise ForceError(f"{name} cannot be compiled: {error}") from None
    except Exception as error:
        raise ForceError(
            f"{name} runs neither for many bodies at once ({reason}) nor, compiled by Numba, for "
            f"one at a time ({_sentence(error)})"
        ) from None
    if traced.fingerprint not in _warned:
        _warned.add(traced.fingerprint)
        warnings.warn(
            f"{name} runs body by body, {BODY_BY_BODY} than for many at once; {reason}",
            ScalarFunctionWarning,
            stacklevel=_frames_of_lierb(),
        )
    return compiled


def why_untraced(function: Function, attempt: Callable[[Function], Any]) -> str | None:
    """Why `attempt`, such as `trial`, cannot trace it; None where it can.

    Raises ForceError for what cannot be compiled either: it is no function of its arguments alone.
    """
    try:
        attempt(function)
    except UnfitFunctionError as error:
        raise ForceError(f"{function.name} cannot be compiled: {_told(error)}") from None
    except Exception as error:  # whatever a function of the user's may raise
        if isinstance(error, ValueError) and "read-only" in str(error):
            raise ForceError(
                f"{function.name} cannot be compiled: {where_it_was(error)}: it changes an array "
                "that is not its own; make a copy in the function"
            ) from None
        return _told(error)
    return None


def _frames_of_lierb() -> int:
    """How far up the caller's line is, for a warning."""
    frame, count = inspect.currentframe(), 0
    while frame is not None and frame.f_globals.get("__name__", "").partition(".")[0] == "lierb":
        frame, count = frame.f_back, count + 1
    return count


def form_of_any(
    signals: tuple[str, ...], function: Callable[..., Any], name: str, has_parameters: bool
) -> tuple[str, ...]:
    """What the function is given, in its own order: any of ARGUMENTS, params, body and signals."""
    signature, known = inspect.signature(function), (*ARGUMENTS, "params", "body", *signals)
    expected = f"any of ({', '.join(known)}) by these names"
    given: list[str] = []
    for parameter in signature.parameters.values():
        is_known = parameter.name in known and parameter.kind in BY_PLACE
        if is_known and len(given) == list(signature.parameters).index(parameter.name):
            given.append(parameter.name)
        elif is_known or parameter.default is inspect.Parameter.empty:
            raise ForceError(
                f"{name} takes {signature}; expected {expected}, what else it may "
                "take after them and with a default"
            )
    if has_parameters and "params" not in given:
        raise ForceError(f"{name} takes {signature}, but has parameters; expected params as well")
    return tuple(given)


def form_of(
    arguments: tuple[str, ...],
    function: Callable[..., Any],
    name: str,
    has_parameters: bool,
    others: tuple[str, ...] = ("body",),
) -> tuple[str, ...]:
    """What the function is given, in its own order: `others` wherever they stand, by their names.

    Without parameters it need not take any.
    """
    signature = inspect.signature(function)
    own = list(signature.parameters.values())
    seen = {p.name: i for i, p in enumerate(own) if p.name in others and p.kind is POSITIONAL}
    for p in own:
        if p.name in SIGNALS and p.name not in others and p.default is inspect.Parameter.empty:
            raise ForceError(
                f"{name} takes {signature}, but sees no {p.name}: wrenches, observables, events, "
                "states and controllers do"
            )
    forms = [(*arguments, "params")]
    if not has_parameters:  # first: what is left may be defaults, and no place for params
        forms.insert(0, arguments)
    for form in forms:
        given = [*form]
        for other, place in seen.items():
            given.insert(place, other)
        try:
            signature.bind(*given)
        except TypeError:
            continue
        return tuple(given)
    listed = f"{', '.join(others[:-1])} or {others[-1]}" if len(others) > 1 else others[0]
    expected = f"({', '.join((*arguments, 'params'))}), and {listed} after these if wanted"
    raise ForceError(f"{name} takes {signature}; expected the form {expected}")


POSITIONAL = inspect.Parameter.POSITIONAL_OR_KEYWORD
BY_PLACE = (POSITIONAL, inspect.Parameter.POSITIONAL_ONLY)


def _told(error: Exception) -> str:
    """What went wrong in a trace, and at which line of the user's."""
    line, sentence = where_it_was(error), _sentence(error)
    if isinstance(error, (AttributeError, NameError, KeyError, IndexError)):
        sentence = f"{type(error).__name__}: {sentence}"
    return sentence if line is None or sentence.startswith("line ") else f"{line}: {sentence}"


# Numba's words for what has a name of its own in Python.
_IN_PLAIN_WORDS = {
    "yield in a closure": "it has a generator expression, such as sum(… for …), which Numba does "
    "not compile: write a list, sum([… for …])",
    "Can't unify return type": "it returns different kinds of things in its branches: return the "
    "same kind everywhere, such as np.array or tuples of numbers",
    "format spec in f-strings": TEXT,
    "Untyped global name 'format'": TEXT,
}


def _sentence(error: Exception) -> str:
    """The line of its message that says most."""
    text = str(error)
    for words, plain in _IN_PLAIN_WORDS.items():
        if words in text:
            return plain
    lines = [line.strip(" -") for line in text.splitlines()]
    telling = [line for line in lines if line and not line.startswith("Failed in")]
    return telling[0] if telling else type(error).__name__
