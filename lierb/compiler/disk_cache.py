"""Cache compiled code on the disk, one file a kernel, named after all that its code depends on.

The cache has no index and no lock. A damaged, foreign or incomplete file counts as absent, and the
kernel is compiled again. If a file cannot be written, a warning is issued.
"""

from __future__ import annotations

import hashlib
import os
import sys
import time
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

from lierb.compiler import sealed, stamp
from lierb.compiler.internals import NullCache, as_bytes, from_bytes, machine_of
from lierb.compiler.stamp import source_stamp

SUFFIX = ".nbc"
ABANDONED = 3600.0  # s; an older unfinished file was left by a process that died
MOST_BYTES = 1 << 29  # in one folder, about 2500 kernels; the oldest by use are deleted


class DiskCache(NullCache):
    """The disk cache of a function's compiled code replaces Numba's."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self._function = function
        stem = f"{function.__module__.rpartition('.')[2]}.{function.__qualname__}"
        self._stem = stem.replace("<", "").replace(">", "")  # Windows forbids them in names
        _caches.append(self)

    @property
    def folders(self) -> list[Path]:
        """Return the folders in which code may be, in the order of search."""
        return sealed.folders_of(self._function)

    @property
    def cache_path(self) -> str | None:
        """Return the folder that code is written to; None if no folder is writable."""
        return next((str(each) for each in self.folders if _is_writable(each)), None)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Load compiled code; None if there is none."""
        key = self._key(sig, target_context.codegen())
        for folder in self.folders:
            try:
                path = folder / self._name(key)
                content = sealed.read(path, key)
                if content is None:
                    continue
                code = from_bytes(content, target_context)
            except Exception:  # a foreign file may raise any exception
                continue
            with suppress(OSError):
                os.utime(path)  # time of the last use, for `_prune`
            return code
        return None

    def save_overload(self, sig: Any, data: Any) -> None:
        code = as_bytes(data)
        if code is None:
            return
        key = self._key(sig, data.codegen)
        refusals = []
        for folder in self.folders:
            try:
                sealed.write(folder / self._name(key), key, code)
            except OSError as error:
                refusals.append(f"{folder}: {error.strerror or error}")
            else:
                self._prune(folder)
                return
        _warn_once(refusals or ["there is no folder for it"])

    def files(self, folder: Path) -> Iterator[Path]:
        """Yield the function's files in a folder: of any version of the sources, and unfinished."""
        with suppress(OSError):
            yield from folder.glob(f"{self._stem}-*{SUFFIX}")
            yield from folder.glob(f".{self._stem}-*{SUFFIX}{sealed.UNFINISHED}")

    def entries(self) -> list[Path]:
        """Return the files with code of this version of the sources, in all folders."""
        mine = self._prefix
        return [
            path
            for folder in self.folders
            for path in sorted(self.files(folder))
            if path.name.startswith(mine)
        ]

    def _key(self, sig: Any, codegen: Any) -> str:
        """Return all that code depends on: function, argument types, CPU, Python and sources.

        The name of a tag's type contains the tag's digest.
        """
        code = hashlib.sha256(self._function.__code__.co_code).hexdigest()
        version = sys.implementation.cache_tag
        return repr((self._prefix, sig, code, machine_of(codegen), version))

    def _name(self, key: str) -> str:
        digest = hashlib.sha256(key.encode()).hexdigest()[:24]
        return f"{self._prefix}{digest}{SUFFIX}"

    @property
    def _prefix(self) -> str:
        """Return the prefix of the file names of this version of the sources."""
        return f"{self._stem}-{source_stamp(self._function.__module__)}-"

    def _prune(self, folder: Path) -> None:
        """Delete files of other versions, abandoned files and, beyond MOST_BYTES, the oldest."""
        mine = self._prefix
        kept = []
        for path in self.files(folder):
            with suppress(OSError):
                status = path.stat()
                if path.suffix == sealed.UNFINISHED:
                    if time.time() - status.st_mtime > ABANDONED:
                        path.unlink()
                elif path.name.startswith(mine):
                    kept.append((status.st_mtime, status.st_size, path))
                else:  # files of edited sources or of another release of Numba
                    path.unlink()
        excess = sum(size for _, size, _ in kept) - MOST_BYTES
        for _, size, path in sorted(kept):
            if excess <= 0:
                break
            with suppress(OSError):
                path.unlink()
            excess -= size


_caches: list[DiskCache] = []  # caches of this process


def clear() -> dict[Path, int]:
    """Delete all compiled code and syntax trees on the disk, of any version; return their sizes.

    Raises OSError for a file that cannot be deleted.
    """
    code = (p for each in _caches for f in each.folders for p in each.files(f))
    there = dict(sized((*code, *stamp.files())))
    for path in there:
        path.unlink(missing_ok=True)
    return there


def compiled() -> dict[Path, int]:
    """Return the files of this version's compiled code, with their sizes."""
    return dict(sized(path for each in _caches for path in each.entries()))


def sized(paths: Iterable[Path]) -> Iterator[tuple[Path, int]]:
    """Yield the existing files and their sizes in bytes."""
    for path in paths:
        with suppress(FileNotFoundError):  # another process may have deleted it
            yield path, path.stat().st_size


def _is_writable(folder: Path) -> bool:
    """Return whether a folder can be written to or created."""
    there = next(each for each in (folder, *folder.parents) if os.access(each, os.F_OK))
    return there.is_dir() and os.access(there, os.W_OK | os.X_OK)


_has_warned = False


def _warn_once(refusals: list[str]) -> None:
    global _has_warned
    if not _has_warned:
        _has_warned = True
        warnings.warn(
            f"compiled code cannot be kept ({'; '.join(refusals)}): every process compiles anew; "
            "set NUMBA_CACHE_DIR to a folder that can be written",
            RuntimeWarning,
            stacklevel=2,
        )
