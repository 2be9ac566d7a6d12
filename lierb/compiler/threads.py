"""One piece of work in a thread of its own."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextvars import copy_context
from typing import Any


def begun(work: Callable[..., Any], *args: Any) -> Callable[[], Any]:
    """work(*args) in a thread of its own, with the context of this one; what waits for it, and
    returns or raises what it does.

    Where no thread is to be had, because there are too many or Python ends, it is done here.
    """
    pool = ThreadPoolExecutor(1, "lierb")
    try:
        return pool.submit(copy_context().run, work, *args).result
    except RuntimeError:
        found = work(*args)
        return lambda: found
    finally:
        pool.shutdown(wait=False)
