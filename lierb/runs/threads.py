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

# One call of the driver shall last about this long: short enough for Ctrl-C and a moving bar, long
# enough that the 30 µs of a call do not show, nor the half microsecond that it takes to bring a
# body into the registers and out again.
CALL_SECONDS = 0.15


_driver_lock = threading.Lock()  # Numba's workqueue layer aborts the process when entered twice


def threading_layer() -> str:
    """Numba's threading layer, its threads started."""
    check_threads()
    with _driver_lock:
        numba.get_num_threads()  # starts them
    return str(numba.threading_layer())


def threads_for(count: int | None, blocks: int) -> int:
    """How many threads a call uses: as many as asked for, but no more than it has blocks."""
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
    """Where compiled code runs on so many threads."""
    with _driver_lock, _thread_mask(threads), np.errstate(all="ignore"):
        yield


@contextmanager
def _thread_mask(count: int) -> Iterator[None]:
    """This Python thread's number of Numba threads set, and set back."""
    before = numba.get_num_threads()
    if count != before:
        numba.set_num_threads(count)
    try:
        yield
    finally:
        if count != before:
            numba.set_num_threads(before)
