"""Memory for results: where it comes from, and how much there is.

Linux grants memory that it does not have, and kills the process that comes to use it: that a run
does not fit has to be known beforehand.
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

ALWAYS = 1 << 26  # bytes that nobody asks for: a run of one body shall not read files for it
MEMINFO = Path("/proc/meminfo")
CGROUP = Path("/proc/self/cgroup")
CGROUPS = Path("/sys/fs/cgroup")
POOLED = range(1 << 16, 1 << 25)  # bytes: less is had at once, and more is not to be kept


def room(shape: tuple[int, ...]) -> NDArray[np.float64]:
    """As `numpy.empty`, from Arrow's pool where that is mimalloc, as it is by default.

    The pool keeps what is given back for the next run. The C library gives it back to the system,
    in some processes after every call, and the page faults of taking it again then last as long as
    two steps of each trajectory.
    """
    size = 8 * math.prod(shape)
    if size not in POOLED or pa.default_memory_pool().backend_name != "mimalloc":
        return np.empty(shape)
    return np.frombuffer(pa.allocate_buffer(size)).reshape(shape)


def require_memory(size: int, what: str, remedy: str) -> None:
    """Raise MemoryLimitError unless so many bytes are free."""
    if not is_free(size):
        raise too_large(what, size, available(), remedy)


def is_free(size: int) -> bool:
    """Whether so many bytes are, what Arrow keeps for later included."""
    if size <= ALWAYS or size <= available():
        return True
    pa.default_memory_pool().release_unused()
    return size <= available()


def too_large(what: str, size: int, free: int, remedy: str) -> MemoryLimitError:
    """The error for what takes more memory than there is."""
    return MemoryLimitError(
        f"{what} takes {in_words(size)}, and {in_words(free)} are free; {remedy}"
    )


def available() -> int:
    """Bytes that the process may take without swapping; all there are where nobody tells."""
    known = [sys.maxsize, *_of_groups()]
    with suppress(OSError, KeyError, ValueError):
        known.append(1024 * int(_table(MEMINFO)["MemAvailable:"]))
        return max(min(known), 0)
    with suppress(AttributeError, OSError, ValueError):  # Windows has no sysconf
        known.append(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    return max(min(known), 0)


def _of_groups() -> list[int]:
    """What each control group above the process (version 2) leaves, where it has a limit.

    Pages of files count as used there, and are given back when needed.
    """
    left = []
    with suppress(OSError, StopIteration):
        lines = CGROUP.read_text().splitlines()
        own = CGROUPS / next(line[4:] for line in lines if line.startswith("0::/"))
        for group in (own, *own.parents):
            if not group.is_relative_to(CGROUPS):
                break
            with suppress(OSError, KeyError, ValueError):  # the root has none; "max" is no number
                limit = int((group / "memory.max").read_text())
                used = int((group / "memory.current").read_text())
                found = _table(group / "memory.stat")
                files = int(found["active_file"]) + int(found["inactive_file"])
                left.append(limit - used + files)
    return left


def _table(path: Path) -> dict[str, str]:
    """The second word of each line by its first."""
    return {name: value for name, value, *_ in map(str.split, path.read_text().splitlines())}


def in_words(size: int) -> str:
    """`1.5 GB`."""
    units = ("bytes", "kB", "MB", "GB", "TB")
    power = min((len(str(size)) - 1) // 3, len(units) - 1)
    return f"{size / 1000**power:.3g} {units[power]}"
