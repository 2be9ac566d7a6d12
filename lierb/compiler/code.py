"""Compiled code: the options that all of it has, and its compiling, once a process."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextvars import copy_context
from typing import Any

import numba
from numba import types

from lierb.compiler.disk_cache import DiskCache
from lierb.compiler.internals import COMPILER_LOCK, set_cache
from lierb.compiler.tags import Tag

# error_model: 1/0 is inf, as in NumPy, without a branch. No fastmath: see lanes.py. Given to every
# function, because the options of its first caller leak into a helper that has none.
OPTIONS: dict[str, Any] = {"error_model": "numpy", "nogil": True}


def cached(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Decorator: njit with OPTIONS and the disk cache, for a function that is no closure."""

    def decorate(function: Callable[..., Any]) -> Any:
        dispatcher = numba.njit(**OPTIONS, **options)(function)
        if hasattr(dispatcher, "compile"):  # no: the JIT is off
            set_cache(dispatcher, DiskCache(function))
        return dispatcher

    return decorate


_ready: dict[tuple[Any, Tag], Callable[..., Any]] = {}
_compiling = threading.RLock()  # compiling may need something compiled


def compiled(dispatcher: Any, tag: Tag, *args: Any) -> Callable[..., Any]:
    """The code of `dispatcher` for (tag, *args): compiled, or from the disk cache, once a process.

    A function of such arguments, and of no others: it spares Numba's look at each one's type.
    """
    key = dispatcher, tag
    if key not in _ready:
        if not hasattr(dispatcher, "compile"):  # the JIT is off
            return dispatcher
        operands = tuple(map(numba.typeof, (tag, *args)))
        undisturbed(_compile, key, operands)
    return _ready[key]


def _compile(key: tuple[Any, Tag], operands: tuple[types.Type, ...]) -> None:
    with _compiling:
        if key not in _ready:
            _ready[key] = key[0].compile(operands)


def undisturbed(work: Callable[..., None], *args: Any) -> None:
    """work(*args) to its end, even where Ctrl-C ends the wait for it.

    Handlers of signals run in the main thread, between any two of its instructions: one that raises
    amidst Numba's work leaves its registries half made, and every later call failing. Hence the
    work is done in a thread of its own; what comes next finds it done, or waits for it.
    """
    if threading.current_thread() is not threading.main_thread():
        work(*args)
        return
    pool = ThreadPoolExecutor(1, "lierb")
    try:
        pool.submit(copy_context().run, work, *args).result()
    finally:
        pool.shutdown(wait=False)


def is_ready(dispatcher: Any, tag: Tag) -> bool:
    """Whether `compiled` has nothing to do any more."""
    return (dispatcher, tag) in _ready


def is_compiling() -> bool:
    """Whether another thread compiles, lierb or anybody: in a forked child, one that it lacks."""
    for lock in (_compiling, COMPILER_LOCK):
        if not lock.acquire(blocking=False):
            return True
        lock.release()
    return False
