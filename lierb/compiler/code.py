"""Compiled code: the options that all of it has, and its compiling, once a process."""

from __future__ import annotations

import gc
import threading
from collections.abc import Callable
from typing import Any

import numba
import numpy as np
from numba import types

from lierb.compiler.disk_cache import DiskCache
from lierb.compiler.internals import ALLOCATES_NOTHING, COMPILER_LOCK, compile_leanly, set_cache
from lierb.compiler.tags import Tag
from lierb.compiler.threads import begun

# error_model: 1/0 is inf, as in NumPy, without a branch. No fastmath: see lanes.py. Given to every
# function, because the options of its first caller leak into a helper that has none.
OPTIONS: dict[str, Any] = {"error_model": "numpy", "nogil": True}


def cached(parallel: bool = False) -> Callable[[Callable[..., Any]], Any]:
    """Decorator: njit with OPTIONS and the disk cache, for a function that is no closure, and that
    makes no array unless it is parallel.
    """
    options = {"parallel": True} if parallel else ALLOCATES_NOTHING

    def decorate(function: Callable[..., Any]) -> Any:
        dispatcher = numba.njit(**OPTIONS, **options)(function)
        if hasattr(dispatcher, "compile"):  # no: the JIT is off
            set_cache(dispatcher, DiskCache(function))
        return dispatcher

    return decorate


_ready: dict[tuple[Any, ...], Callable[..., Any]] = {}
compiling = threading.RLock()  # which may need something else compiled
_garbage_waits = False  # until a thread has done its work


def compiled(dispatcher: Any, *args: Any) -> Callable[..., Any]:
    """The code of `dispatcher` for arguments of these types, and for no others.

    Compiled, or from the disk cache, once a process.
    """
    if not hasattr(dispatcher, "compile"):  # the JIT is off
        return dispatcher
    key = kinds_of(dispatcher, *args)
    if key not in _ready:
        undisturbed(_compile, key, tuple(map(numba.typeof, args)))
    return _ready[key]


def kinds_of(dispatcher: Any, *args: Any) -> tuple[Any, ...]:
    """Key of compiled code: tags themselves, and what decides on the Numba type of other arguments.

    That type takes 20 times as long to find. Arguments of one type may be of several kinds.
    """
    return dispatcher, *map(_kind, args)


def _kind(argument: Any) -> Any:
    kind = type(argument)
    if kind is np.ndarray:
        return argument.dtype, argument.ndim, argument.flags.num
    if kind is int or kind is float:
        return kind
    return argument if isinstance(argument, Tag) else numba.typeof(argument)


def _compile(key: tuple[Any, ...], operands: tuple[types.Type, ...]) -> None:
    with compiling:
        if key not in _ready:
            _ready[key] = compile_leanly(key[0], operands)


def undisturbed(work: Callable[..., None], *args: Any) -> None:
    """work(*args) to its end, even where Ctrl-C ends the wait for it.

    Handlers of signals run in the main thread, between any two of its instructions: one that raises
    amidst Numba's work leaves its registries half made, and every later call failing. Hence the
    work is done in a thread of its own; what comes next finds it done, or waits for it.
    """
    if threading.current_thread() is threading.main_thread():
        begun(_without_collections, work, *args)()
    else:
        _without_collections(work, *args)


def _without_collections(work: Callable[..., None], *args: Any) -> None:
    """work(*args), its garbage left until it is done.

    A compiler allocates so much that Python would look through it hundreds of times, for a fifth of
    the time to a kernel. So memory peaks higher, by 6 to 60 MB.
    """
    global _garbage_waits
    if not gc.isenabled():  # for another thread, or the user wants none
        work(*args)
        return
    gc.disable()
    _garbage_waits = True
    try:
        work(*args)
    finally:
        gc.enable()
        _garbage_waits = False


def collect_again() -> None:
    """Enable the garbage collector in a forked child, which lacks the thread that would do so."""
    if _garbage_waits:
        gc.enable()


def is_ready(dispatcher: Any, *args: Any) -> bool:
    """Return whether the code is compiled already."""
    return kinds_of(dispatcher, *args) in _ready


def is_compiling() -> bool:
    """Return whether another thread compiles, or one of a parent process did at the fork."""
    for lock in (compiling, COMPILER_LOCK):
        if not lock.acquire(blocking=False):
            return True
        lock.release()
    return False
