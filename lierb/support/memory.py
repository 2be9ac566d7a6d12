"""Allocate memory for results, and measure the free memory.

Linux grants more memory than it has, and kills the process that uses it. Hence a run that does not
fit must be refused before it starts.
"""

from __future__ import annotations

import math
import os
import sys
from contextlib import suppress
from pathlib import Path

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from lierb.errors import MemoryLimitError

ALWAYS = 1 << 26  # bytes that need no check; enough for a run of one body
MEMINFO = Path("/proc/meminfo")
CGROUP = Path("/proc/self/cgroup")
CGROUPS = Path("/sys/fs/cgroup")
POOLED = range(1 << 16, 1 << 25)  # sizes in bytes of allocations from Arrow's pool


def room(shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Allocate an array like `numpy.empty`, from Arrow's pool if that is mimalloc, the default.

    The pool keeps freed memory for the next run. The C library returns it to the system, in some
    processes after every call. The page faults of the next allocation then take as long as two
    steps of each trajectory.
    """
    size = 8 * math.prod(shape)
    if size not in POOLED or pa.default_memory_pool().backend_name != "mimalloc":
        return np.empty(shape)
    return np.frombuffer(pa.allocate_buffer(size)).reshape(shape)


def require_memory(size: int, what: str, remedy: str) -> None:
    """Raise MemoryLimitError unless `size` bytes are free."""
    if not is_free(size):
        raise too_large(what, size, available(), remedy)


def is_free(size: int) -> bool:
    """Return whether `size` bytes are free, after Arrow has released its unused memory."""
    if size <= ALWAYS or size <= available():
        return True
    pa.default_memory_pool().release_unused()
    return size <= available()


def too_large(what: str, size: int, free: int, remedy: str) -> MemoryLimitError:
    """Return the error for a request that exceeds the free memory."""
    return MemoryLimitError(
        f"{what} takes {in_words(size)}, and {in_words(free)} are free; {remedy}"
    )


def available() -> int:
    """Return the bytes allocatable without swapping; the physical memory if unknown."""
    limits = [sys.maxsize, *_left_of_groups()]
    with suppress(OSError, KeyError, ValueError):
        limits.append(1024 * int(_table(MEMINFO)["MemAvailable:"]))
        return max(min(limits), 0)
    with suppress(AttributeError, OSError, ValueError):  # Windows has no sysconf
        limits.append(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    return max(min(limits), 0)


def _left_of_groups() -> list[int]:
    """Return the free bytes within the limit of each control group (version 2) of the process.

    Cached pages of files count as free, because the system releases them when needed.
    """
    left = []
    with suppress(OSError, StopIteration):
        lines = CGROUP.read_text().splitlines()
        own = CGROUPS / next(line[4:] for line in lines if line.startswith("0::/"))
        for group in (own, *own.parents):
            if not group.is_relative_to(CGROUPS):
                break
            with suppress(OSError, KeyError, ValueError):  # no limit: root group, "max"
                limit = int((group / "memory.max").read_text())
                used = int((group / "memory.current").read_text())
                statistics = _table(group / "memory.stat")
                files = int(statistics["active_file"]) + int(statistics["inactive_file"])
                left.append(limit - used + files)
    return left


def _table(path: Path) -> dict[str, str]:
    """Read a file as a dictionary from the first to the second word of each line."""
    return {name: value for name, value, *_ in map(str.split, path.read_text().splitlines())}


def in_words(size: int) -> str:
    """Format a size in bytes, such as `1.5 GB`."""
    units = ("bytes", "kB", "MB", "GB", "TB")
    power = min((len(str(size)) - 1) // 3, len(units) - 1)
    return f"{size / 1000**power:.3g} {units[power]}"
