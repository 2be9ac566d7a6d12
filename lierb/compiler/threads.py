"""Start a function call in a new thread."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from contextvars import copy_context
from typing import Any


def begun(work: Callable[..., Any], *args: Any) -> Callable[[], Any]:
    """Start work(*args) in a new thread, with a copy of the context of the calling one.

    Returns a function that waits for the result, and returns it or raises the exception. If no
    thread can be started (too many threads, or at exit), the calling thread does the work.
    """
    pool = ThreadPoolExecutor(1, "lierb")
    with suppress(RuntimeError):
        waiting = pool.submit(copy_context().run, work, *args)
        pool.shutdown(wait=False)
        return waiting.result
    outcome = work(*args)
    return lambda: outcome
