"""Refuse users' functions that depend on more than their arguments, while they are traced.

`lierb.kernels.functions.refusals` checks a function's code before it runs. Here the function runs
twice. Both runs must give the same trace, must not draw from random generators, and must not call a
function that reads a clock, a file or the system, under any name.
"""

from __future__ import annotations

import random
import sys
import types
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from lierb.compiler.internals import names_in, runs_python
from lierb.kernels.functions.references import UnfitFunctionError, attributes_of
from lierb.kernels.functions.refusals import ALONE, CLOCKS, RANDOM, TEXT, refusal, refusal_of_call
from lierb.kernels.functions.source_lines import MARK, at

# Attempts at a trace without random draws: draws of other threads are seen, too.
TRIES = 20
# Modules whose calls are not checked; a warning reads its line from a file, for example.
TRUSTED = ("lierb", "llvmlite", "numba", "warnings", "linecache", "traceback", "importlib")


def require_repeatable(run: Callable[[], str]) -> None:
    """Raise UnfitFunctionError unless two calls of `run` return the same text of a trace."""
    for tried in range(1, TRIES + 1):
        try:
            with _other_states(tried), _watching():
                first = run()
            break
        except _DrawingError:
            if tried == TRIES:
                raise
    if run() != first:
        raise UnfitFunctionError(
            "it does not do the same when it is called again: it reads or changes something beside "
            f"its arguments (a random generator, a clock, a counter); {ALONE}"
        )


@contextmanager
def _other_states(tried: int) -> Iterator[None]:
    """Change the states of the random generators, from the second attempt on."""
    if tried == 1:
        yield
        return
    state, is_numpy = random.getstate(), "numpy.random" in sys.modules
    legacy = np.random.get_state() if is_numpy else None  # noqa: NPY002
    random.seed(f"lierb, try {tried}")
    if is_numpy:
        np.random.seed(0xA5A5A500 + tried)  # noqa: NPY002
    try:
        yield
    finally:
        random.setstate(state)
        if legacy is not None:
            np.random.set_state(legacy)  # noqa: NPY002


class _DrawingError(UnfitFunctionError):
    """A thread drew random numbers during a trace."""


@contextmanager
def _watching() -> Iterator[None]:
    """Refuse forbidden calls and random draws of a traced function.

    Calls are not checked while another profiler is active.
    """
    before, calls = _random_states(), _Calls()
    profiled = sys.getprofile() is not None
    if not profiled:
        sys.setprofile(calls)
    try:
        yield
    finally:
        if not profiled:
            sys.setprofile(None)
    if calls.refused is not None:  # the function has caught the error
        raise UnfitFunctionError(calls.refused)
    if _random_states() != before:
        raise _DrawingError(
            "it draws random numbers: they would be the same constants for every body and in every "
            f"step; {ALONE}: sample a parameter instead, or draw lierb.noise.normal in a "
            "controller"
        )


def _random_states() -> tuple[Any, ...]:
    states: tuple[Any, ...] = (random.getstate(),)
    if "numpy.random" in sys.modules:
        name, keys, *rest = np.random.get_state()  # noqa: NPY002
        states += (name, np.asarray(keys).tobytes(), *rest)
    return states


class _Calls:
    """A profiler refuses calls by which a user's function depends on more than its arguments."""

    refused: str | None = None

    def __call__(self, frame: types.FrameType, event: str, argument: Any) -> None:
        caller = frame if event == "c_call" else frame.f_back
        if event not in ("c_call", "call") or caller is None or _is_trusted(caller):
            return
        if event == "c_call":
            why = refusal_of_call(argument, _name_of(argument))
        else:
            why = _of_module(frame.f_globals.get("__name__", ""), frame.f_code.co_name)
        if why is None:
            return
        place = _users_line(caller)
        if place is not None:
            self.refused = f"{place}: {why}"
            raise UnfitFunctionError(self.refused)


def _name_of(function: Any) -> str:
    owner = getattr(function, "__self__", None)
    first = getattr(owner, "__name__", type(owner).__name__) if owner is not None else ""
    name = getattr(function, "__name__", str(function))
    return name if first in ("", "builtins") else f"{first}.{name}"


def _of_module(module: str, name: str) -> str | None:
    """Reason why a Python function of a module may not be called; None if it may."""
    top = module.split(".")[0]
    if top == "numpy" and module.endswith(".arrayprint"):
        return TEXT
    if top in RANDOM or top in CLOCKS or module.startswith("numpy.random") or top in _SYSTEM:
        return refusal(sys.modules.get(module, types.ModuleType(module)), f"{module}.{name}")
    return None


_SYSTEM = (
    "os", "posixpath", "pathlib", "subprocess", "socket", "tempfile", "shutil", "glob", "io",
    "threading", "logging", "urllib", "http", "platform", "getpass", "locale",
)  # fmt: skip


def _users_line(frame: types.FrameType | None) -> str | None:
    """Return the line of the user's function that made a call; None for a call by trusted code."""
    while frame is not None:
        if MARK in frame.f_globals:
            return at(frame.f_code, frame.f_lineno)
        if _is_trusted(frame):
            return None
        frame = frame.f_back
    return None


def _is_trusted(frame: types.FrameType) -> bool:
    module: str = frame.f_globals.get("__name__", "")
    return module.partition(".")[0] in TRUSTED


# ---- compiled by Numba -------------------------------------------------------------------------


def require_pure_code(dispatcher: Any, seen: list[Any] | None = None) -> None:
    """Raise UnfitFunctionError if code compiled by Numba refers to a forbidden object."""
    seen = [] if seen is None else seen
    if dispatcher in seen or not hasattr(dispatcher, "overloads"):
        return
    seen.append(dispatcher)
    names = attributes_of(dispatcher.py_func)
    for result in list(dispatcher.overloads.values()):
        if runs_python(result):
            raise UnfitFunctionError(f"it runs Python code of its own (objmode); {ALONE}")
        for value, ty, line in names_in(result):
            if hasattr(ty, "dispatcher"):
                require_pure_code(ty.dispatcher, seen)
                continue
            # Numba compiles np.array by np.empty; then the user's code does not name np.empty.
            why = TEXT if _is_text_of_numbers(ty) else None
            if value is not None:
                is_named = getattr(value, "__name__", "") in names
                why = (refusal if is_named else refusal_of_call)(value, _dotted(value))
            if why is not None:
                place = at(dispatcher.py_func.__code__, line) if line else dispatcher.__name__
                raise UnfitFunctionError(f"{place}: {why}")


def _is_text_of_numbers(ty: Any) -> bool:
    """Return whether a literal is a type's name, as Numba writes it for a number or an array."""
    text = getattr(ty, "literal_value", None)
    return isinstance(text, str) and text.startswith("<object type:")


def _dotted(value: Any) -> str:
    if isinstance(value, types.ModuleType):
        return value.__name__.replace("numpy", "np", 1)
    owner = type(getattr(value, "__self__", None))
    module = str(getattr(value, "__module__", None) or owner.__module__)
    prefix = "np.random." if module.startswith("numpy.random") else f"{module}."
    prefix = "np." if module == "numpy" else prefix
    name = getattr(value, "__name__", str(value))
    return name if module in ("builtins", "") else f"{prefix}{name}"
