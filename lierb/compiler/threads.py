"""One piece of work in a thread of its own."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from contextvars import copy_context
from typing import Any


def begun(work: Callable[..., Any], *args: Any) -> Callable[[], Any]:
    """work(*args) in a thread of its own, with the context of this one; what waits for it, and
    returns or raises what it does.

    Where no thread is to be had, because there are too many or Python ends, it is done here.
    """
    pool = ThreadPoolExecutor(1, "lierb")
    with suppress(RuntimeError):
        waiting = pool.submit(copy_context().run, work, *args)
        pool.shutdown(wait=False)
        return waiting.result
    found = work(*args)
    return lambda: found
