"""Threads of a run."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

import numba
import numpy as np

from lierb.errors import ArgumentError, brief
from lierb.support.arrays import is_whole
from lierb.support.forks import check_threads

# Duration of one call of the driver, s. It is short enough for Ctrl-C and the progress bar; the
# 30 µs of a call and the 0.5 µs of loading and storing a block are negligible beside it.
CALL_SECONDS = 0.15


_driver_lock = threading.Lock()  # Numba's workqueue layer aborts the process when entered twice


def threading_layer() -> str:
    """Return Numba's threading layer, with its threads started."""
    check_threads()
    with _driver_lock:
        numba.get_num_threads()  # starts them
    return str(numba.threading_layer())


def threads_for(count: int | None, blocks: int) -> int:
    """Return the number of threads of a call: `count`, at most the number of blocks."""
    most = numba.config.NUMBA_NUM_THREADS
    if count is None:
        count = numba.get_num_threads()
    if not (is_whole(count) and 1 <= count <= most):
        raise ArgumentError(
            f"threads={brief(count)}; expected 1 … {most}, the threads that Numba started with"
        )
    return min(int(count), blocks)


@contextmanager
def running(threads: int) -> Iterator[None]:
    """Context manager: compiled code that this Python thread calls runs on `threads` threads."""
    with _driver_lock, np.errstate(all="ignore"):
        before = numba.get_num_threads()
        if threads != before:
            numba.set_num_threads(threads)
        try:
            yield
        finally:
            if threads != before:
                numba.set_num_threads(before)
