"""NumPy in several threads: its loops over matrices work without Python's lock."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from numba import get_num_threads

T = TypeVar("T")


def in_parts(
    function: Callable[[slice], T], count: int, least: int, threads: int | None = None
) -> list[T]:
    """Call a function on consecutive ranges of a batch, each in a thread; return the results.

    count : members of the batch.   least : those of a range that are worth a thread.
    threads : largest number of threads; None for Numba's.
    """
    size = max(-(-count // (threads or get_num_threads())), least)
    parts = [slice(first, min(first + size, count)) for first in range(0, count, size)]
    if len(parts) <= 1:
        return [function(slice(0, count))]
    with ThreadPoolExecutor(len(parts)) as pool:
        return [*pool.map(function, parts)]
