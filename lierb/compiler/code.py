"""Compile functions, once in each process, with common options."""

from __future__ import annotations

import gc
import threading
from collections.abc import Callable
from typing import Any

import numba
import numpy as np
from numba import types

from lierb.compiler.disk_cache import DiskCache
from lierb.compiler.internals import (
    ALLOCATES_NOTHING,
    COMPILER_LOCK,
    compile_leanly,
    compiler_that_translates_once,
    set_cache,
)
from lierb.compiler.tags import Tag, TagType
from lierb.compiler.threads import begun

# error_model: 1/0 is inf, as in NumPy, without a branch. No fastmath: see lanes.py. Every function
# needs these options: Numba compiles a helper without options with those of its first caller.
OPTIONS: dict[str, Any] = {"error_model": "numpy", "nogil": True}
_TranslatesOnce = compiler_that_translates_once(TagType)


def cached(parallel: bool = False) -> Callable[[Callable[..., Any]], Any]:
    """Decorate a function by njit with OPTIONS and the disk cache.

    The function must not be a closure. It may allocate arrays only if it is parallel.
    """
    options: dict[str, Any] = {"parallel": True}
    if not parallel:
        options = ALLOCATES_NOTHING | {"pipeline_class": _TranslatesOnce}

    def decorate(function: Callable[..., Any]) -> Any:
        dispatcher = numba.njit(**OPTIONS, **options)(function)
        if hasattr(dispatcher, "compile"):  # False with the JIT off
            set_cache(dispatcher, DiskCache(function))
        return dispatcher

    return decorate


_ready: dict[tuple[Any, ...], Callable[..., Any]] = {}
compiling = threading.RLock()  # reentrant: compiling one function may compile others
_garbage_waits = False  # True while a compiling thread has disabled the collector


def compiled(dispatcher: Any, *args: Any) -> Callable[..., Any]:
    """Return the code of `dispatcher` for arguments of these types only.

    The first call in a process compiles it or loads it from the disk cache.
    """
    if not hasattr(dispatcher, "compile"):  # the JIT is off
        return dispatcher
    key = kinds_of(dispatcher, *args)
    if key not in _ready:
        run_uninterrupted(_compile, key, tuple(map(numba.typeof, args)))
    return _ready[key]


def kinds_of(dispatcher: Any, *args: Any) -> tuple[Any, ...]:
    """Return the key of compiled code: the dispatcher and the kind of each argument.

    A tag is its own kind. The kind of another argument determines its Numba type, but is computed
    20 times as fast. Arguments of different kinds may have the same Numba type.
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


def run_uninterrupted(work: Callable[..., None], *args: Any) -> None:
    """Run work(*args) to its end, even if Ctrl-C interrupts the caller.

    Python runs signal handlers in the main thread, between any two instructions. A handler that
    raises inside Numba leaves Numba's registries incomplete, and every later call fails. Hence the
    work runs in a thread of its own. A later call waits until it is done.
    """
    if threading.current_thread() is threading.main_thread():
        begun(_without_collections, work, *args)()
    else:
        _without_collections(work, *args)


def _without_collections(work: Callable[..., None], *args: Any) -> None:
    """Run work(*args) with the garbage collector disabled.

    Compilation allocates so much that the collector would run hundreds of times, which takes a
    fifth of the time to a kernel. Without it the memory's peak is 6 to 60 MB higher.
    """
    global _garbage_waits
    if not gc.isenabled():  # disabled by another thread or by the user
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
    """Enable the garbage collector in a forked child, which lacks the thread that disabled it."""
    if _garbage_waits:
        gc.enable()


def is_ready(dispatcher: Any, *args: Any) -> bool:
    """Return whether the code is compiled already."""
    return kinds_of(dispatcher, *args) in _ready


def is_compiling() -> bool:
    """Return whether another thread is compiling, or was in the parent process at the fork."""
    for lock in (compiling, COMPILER_LOCK):
        if not lock.acquire(blocking=False):
            return True
        lock.release()
    return False
