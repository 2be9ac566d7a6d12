"""Convert users' functions to functions for kernels: arguments, trial, errors."""

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
from lierb.kernels.functions.shapes import Shape, UserFunction
from lierb.kernels.functions.source_lines import where_it_was
from lierb.kernels.functions.trials import compile_alone, trial
from lierb.kernels.mechanics.passive_elements import FELT

ARGUMENTS: dict[str, Shape] = {"t": (), "R": (3, 3), "r": (3,), "omega": (3,), "v": (3,)}
MOTION, POSE, VELOCITY = tuple(ARGUMENTS), ("R", "r"), ("omega", "v")
FURTHER: dict[str, Shape] = ARGUMENTS | dict.fromkeys(FELT, (3,))
SIGNALS = ("states", "controls")
# Measured with AVX-512, one thread, RK4: a spring with drag and a stop, 13 and 14 times on a free
# body, 36 and 58 on a revolute joint. A function that makes no array loses nothing.
BODY_BY_BODY = "10 to 60 times slower"
DERIVATIVES = "its derivatives are needed as well"

_warned: set[str] = set()  # fingerprints of functions that run body by body


def user_function(
    function: UserFunction,
    arguments: tuple[str, ...],
    shapes: dict[str, Shape],
    results: tuple[Shape, ...],
    because: str | None = None,
    form: Callable[[UserFunction, str, bool], tuple[str, ...]] | None = None,
) -> Function:
    """Convert a user's function to one for kernels: traced if possible, else compiled by Numba.

    A function of states or controls is tried when it is bound to those of a problem.

    because : reason why it must be traced, or None.   form : returns its arguments, see `form_of`.
    """
    made = described(function, arguments, shapes, results, form or partial(form_of, arguments))
    return made if made.takes_signals else runnable(made, function, because)


def number_of_motion(function: UserFunction, shapes: dict[str, Shape]) -> Function:
    """Convert a user's function of the motion that returns a number; see `user_function`."""
    form = partial(form_of_any, SIGNALS, further=FELT)
    return user_function(function, seen_by(function), shapes, ((),), form=form)


def described(
    function: UserFunction,
    arguments: tuple[str, ...],
    shapes: dict[str, Shape],
    results: tuple[Shape, ...],
    form: Callable[[UserFunction, str, bool], tuple[str, ...]],
    **fields: Any,
) -> Function:
    """Convert a user's function to one that is traced, without a trial.

    fields : further fields of a Function.
    """
    name = getattr(function, "__name__", "function")
    own_form = form(function, name, bool(shapes))
    try:
        digest, references = fingerprint(function), watched(function)
        modules = tuple(sorted(modules_named(function, set(), [])))
        python = traceable(function)
    except UnfitFunctionError as error:
        raise ForceError(f"{name} cannot be compiled: {error}") from None
    return Function(
        name, digest, own_form, tuple((x, FURTHER[x]) for x in arguments), tuple(shapes.items()),
        results, True, python, references, modules, **fields,
    )  # fmt: skip


def runnable(traced: Function, function: UserFunction, because: str | None = None) -> Function:
    """Try the function: return it if it can be traced, else one that Numba compiles.

    function : the user's function of `traced`.   because : see `user_function`.
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
    """Return the reason why `attempt`, such as `trial`, cannot trace the function; None if it can.

    Raises ForceError for a function that depends on more than its arguments; Numba must not
    compile it either.
    """
    try:
        attempt(function)
    except UnfitFunctionError as error:
        raise ForceError(f"{function.name} cannot be compiled: {_described(error)}") from None
    except Exception as error:  # the user's function may raise any
        if isinstance(error, ValueError) and "read-only" in str(error):
            raise ForceError(
                f"{function.name} cannot be compiled: {where_it_was(error)}: it changes an array "
                "that is not its own; make a copy in the function"
            ) from None
        return _described(error)
    return None


def _frames_of_lierb() -> int:
    """Count the frames of lierb above the caller's, for the stack level of a warning."""
    frame, count = inspect.currentframe(), 0
    while frame is not None and frame.f_globals.get("__name__", "").partition(".")[0] == "lierb":
        frame, count = frame.f_back, count + 1
    return count


def form_of_any(
    signals: tuple[str, ...],
    function: UserFunction,
    name: str,
    has_parameters: bool,
    arguments: tuple[str, ...] = MOTION,
    further: tuple[str, ...] = (),
) -> tuple[str, ...]:
    """List the function's arguments in its order.

    They are any of `arguments`, params, body, `signals` and `further`.
    """
    signature = inspect.signature(function)
    known = (*arguments, "params", "body", *signals, *further)
    expected = f"any of ({', '.join(known)}) by these names"
    form: list[str] = []
    for parameter in signature.parameters.values():
        is_known = parameter.name in known and parameter.kind in BY_PLACE
        if is_known and len(form) == list(signature.parameters).index(parameter.name):
            form.append(parameter.name)
        elif is_known or parameter.default is inspect.Parameter.empty:
            raise ForceError(
                f"{name} takes {signature}; expected {expected}; a further argument comes after "
                f"them and has a default, unlike {parameter.name}"
            )
    if has_parameters and "params" not in form:
        raise ForceError(f"{name} takes {signature}, but has parameters; expected params as well")
    return tuple(form)


by_name = partial(form_of_any, SIGNALS)


def seen_by(function: UserFunction) -> tuple[str, ...]:
    """Arguments of a function of the motion: MOTION, and FELT if it takes any of these."""
    names = inspect.signature(function).parameters
    return (*MOTION, *FELT) if any(name in names for name in FELT) else MOTION


def form_of(
    arguments: tuple[str, ...],
    function: UserFunction,
    name: str,
    has_parameters: bool,
    others: tuple[str, ...] = ("body",),
) -> tuple[str, ...]:
    """Names of the function's arguments in its order; `others` may be in any position, by name.

    A function without parameters need not take `params`.
    """
    signature = inspect.signature(function)
    own = list(signature.parameters.values())
    named = {p.name: i for i, p in enumerate(own) if p.name in others and p.kind is POSITIONAL}
    for p in own:
        if p.name in FELT:
            raise ForceError(
                f"{name} takes {signature}, but sees no {p.name}, which depends on all forces; "
                "observables, events and controllers do"
            )
        if p.name in SIGNALS and p.name not in others and p.default is inspect.Parameter.empty:
            raise ForceError(
                f"{name} takes {signature}, but sees no {p.name}: wrenches, observables, events, "
                "states and controllers do"
            )
    forms = [(*arguments, "params")]
    if not has_parameters:  # checked first: a further argument may have a default and not be params
        forms.insert(0, arguments)
    for form in forms:
        arranged = [*form]
        for other, index in named.items():
            arranged.insert(index, other)
        try:
            signature.bind(*arranged)
        except TypeError:
            continue
        return tuple(arranged)
    listed = f"{', '.join(others[:-1])} or {others[-1]}" if len(others) > 1 else others[0]
    expected = f"({', '.join((*arguments, 'params'))}), and {listed} after these if wanted"
    raise ForceError(f"{name} takes {signature}; expected the form {expected}")


POSITIONAL = inspect.Parameter.POSITIONAL_OR_KEYWORD
BY_PLACE = (POSITIONAL, inspect.Parameter.POSITIONAL_ONLY)


def _described(error: Exception) -> str:
    """Describe an error of a trace, with the line of the user's function where it occurred."""
    line, sentence = where_it_was(error), _sentence(error)
    if isinstance(error, (AttributeError, NameError, KeyError, IndexError)):
        sentence = f"{type(error).__name__}: {sentence}"
    return sentence if line is None or sentence.startswith("line ") else f"{line}: {sentence}"


# Sentences for Numba's error messages.
_IN_PLAIN_WORDS = {
    "yield in a closure": "it has a generator expression, such as sum(… for …), which Numba does "
    "not compile: write a list, sum([… for …])",
    "Can't unify return type": "it returns different kinds of things in its branches: return the "
    "same kind everywhere, such as np.array or tuples of numbers",
    "format spec in f-strings": TEXT,
    "Untyped global name 'format'": TEXT,
}


def _sentence(error: Exception) -> str:
    """Return the first informative line of an error's message."""
    text = str(error)
    for words, plain in _IN_PLAIN_WORDS.items():
        if words in text:
            return plain
    lines = [line.strip(" -") for line in text.splitlines()]
    informative = [line for line in lines if line and not line.startswith("Failed in")]
    return informative[0] if informative else type(error).__name__
