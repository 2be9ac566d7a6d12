"""Compiled code on the disk: one file for each kernel, which says what it is and that it is whole.

A file is named after the digest of all that its code depends on, the sources among it, and holds
the digest of the rest, that key in full, and the code. There is no index and no lock: a file is
written aside and renamed, and one that is damaged, foreign or half there is no file at all. What
cannot be read is compiled anew; what cannot be written is not kept, and a warning says so.
"""

from __future__ import annotations

import hashlib
import inspect
import os
import pickle
import sys
import time
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any
from uuid import uuid4

import llvmlite
import numba
from numba.core.caching import (
    InTreeCacheLocator,
    NullCache,
    UserProvidedCacheLocator,
    UserWideCacheLocator,
)
from numba.core.compiler import CompileResult
from numba.core.runtime import rtsys
from numba.core.serialize import dumps

SUFFIX = ".nbc"
UNFINISHED = ".unfinished"
ABANDONED = 3600.0  # s, after which what is unfinished has been left by a process that died
MOST_BYTES = 1 << 29  # in one folder, about 2500 kernels: what was used last stays
DIGEST_SIZE = hashlib.sha256().digest_size


def sources() -> list[Path]:
    """Every source that compiled code depends on; formulas of forces are beside the kernels."""
    package = Path(__file__).parents[1]
    formulas = (package / "kernels").rglob("*.py")
    return sorted([*formulas, *(package / "compiler").glob("*.py"), package / "forces.py"])


@cache
def source_stamp() -> str:
    """Digest of the sources, and of the compilers."""
    digest = hashlib.sha256(f"{numba.__version__} {llvmlite.__version__}".encode())
    for path in sources():
        digest.update(path.name.encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()[:16]


source_stamp()  # now: later, a file may differ from what this process has imported


class DiskCache(NullCache):
    """What Numba asks for a function's code before it compiles it, and gives it afterwards."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self._function = function
        stem = f"{function.__module__.rpartition('.')[2]}.{function.__qualname__}"
        self._stem = stem.replace("<", "").replace(">", "")  # not in names on Windows
        _caches.append(self)

    @property
    def folders(self) -> list[Path]:
        """Where code may be, those that come first being asked first: Numba's own choice."""
        source = inspect.getfile(self._function)
        chosen = (
            [UserProvidedCacheLocator]
            if numba.config.CACHE_DIR
            else [InTreeCacheLocator, UserWideCacheLocator]
        )
        found = (Path(each(self._function, source).get_cache_path()) for each in chosen)
        return [folder for folder in found if folder.is_absolute() or numba.config.CACHE_DIR]

    @property
    def cache_path(self) -> str | None:
        """The folder that code is written to; None if there is no such one."""
        return next((str(each) for each in self.folders if _is_writable(each)), None)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Compiled code, or None.

        Without what only a compiler needs: Numba would import all its overloads first, and with
        them scipy.linalg where SciPy is installed, two thirds of the time to a first result.
        """
        key = self._key(sig, target_context.codegen())
        for folder in self.folders:
            try:
                path = folder / self._name(key)
                if not path.is_file():  # a pipe would be waited for
                    continue
                content = _whole(path.read_bytes(), key)
                if content is None:
                    continue
                rtsys.initialize(target_context)  # arrays count references
                found = CompileResult._rebuild(target_context, *pickle.loads(content))
            except Exception:  # there is no telling what reading nonsense raises
                continue
            with suppress(OSError):
                os.utime(path)  # used last
            return found
        return None

    def save_overload(self, sig: Any, data: Any) -> None:
        if any(not lifted.can_cache for lifted in data.lifted) or data.library.has_dynamic_globals:
            return
        key = self._key(sig, data.codegen)
        content = key.encode() + b"\0" + dumps(data._reduce())
        refusals = []
        for folder in self.folders:
            try:
                _write(folder / self._name(key), hashlib.sha256(content).digest() + content)
            except OSError as error:
                refusals.append(f"{folder}: {error.strerror or error}")
            else:
                self._prune(folder)
                return
        _warn_once(refusals or ["there is no folder for it"])

    def files(self, folder: Path) -> Iterator[Path]:
        """Its code in a folder, of whatever version of the sources, and its unfinished files."""
        with suppress(OSError):
            yield from folder.glob(f"{self._stem}-*{SUFFIX}")
            yield from folder.glob(f".{self._stem}-*{SUFFIX}{UNFINISHED}")

    def entries(self) -> list[Path]:
        """The code of this version of the sources, in all folders."""
        mine = f"{self._stem}-{source_stamp()}-"
        return [
            path
            for folder in self.folders
            for path in sorted(self.files(folder))
            if path.name.startswith(mine)
        ]

    def _key(self, sig: Any, codegen: Any) -> str:
        """All that code depends on: the function, its arguments' types, CPU, Python, the sources.

        A tag's type has the digest of the tag in its name.
        """
        code = hashlib.sha256(self._function.__code__.co_code).hexdigest()
        versions = source_stamp(), sys.implementation.cache_tag
        return repr((self._stem, sig, code, codegen.magic_tuple(), *versions))

    def _name(self, key: str) -> str:
        digest = hashlib.sha256(key.encode()).hexdigest()[:24]
        return f"{self._stem}-{source_stamp()}-{digest}{SUFFIX}"

    def _prune(self, folder: Path) -> None:
        """Delete what nothing asks for any more, and beyond MOST_BYTES what was used first."""
        mine = f"{self._stem}-{source_stamp()}-"
        kept = []
        for path in self.files(folder):
            with suppress(OSError):
                status = path.stat()
                if path.suffix == UNFINISHED:
                    if time.time() - status.st_mtime > ABANDONED:
                        path.unlink()
                elif path.name.startswith(mine):
                    kept.append((status.st_mtime, status.st_size, path))
                else:  # of sources that were edited since, or of another numba
                    path.unlink()
        excess = sum(size for _, size, _ in kept) - MOST_BYTES
        for _, size, path in sorted(kept):
            if excess <= 0:
                break
            with suppress(OSError):
                path.unlink()
            excess -= size


_caches: list[DiskCache] = []  # of this process


def clear() -> dict[Path, int]:
    """Delete all code of lierb on the disk, of whatever version; what there was, and its bytes.

    Raises OSError for a file that may not be deleted.
    """
    there = dict(sized(p for each in _caches for f in each.folders for p in each.files(f)))
    for path in there:
        path.unlink(missing_ok=True)
    return there


def sized(paths: Iterable[Path]) -> Iterator[tuple[Path, int]]:
    """Files that are there, and their bytes."""
    for path in paths:
        with suppress(FileNotFoundError):  # other processes delete, too
            yield path, path.stat().st_size


def _whole(stored: bytes, key: str) -> bytes | None:
    """The code in a file, if it is the one asked for and as it was written."""
    digest, content = stored[:DIGEST_SIZE], stored[DIGEST_SIZE:]
    begin = key.encode() + b"\0"
    if hashlib.sha256(content).digest() != digest or not content.startswith(begin):
        return None
    return content[len(begin) :]


def _write(path: Path, content: bytes) -> None:
    """A file with that content, or none."""
    path.parent.mkdir(parents=True, exist_ok=True)
    aside = path.with_name(f".{path.name[: -len(SUFFIX)]}.{uuid4().hex[:8]}{SUFFIX}{UNFINISHED}")
    try:
        aside.write_bytes(content)
        aside.replace(path)
    except BaseException:
        with suppress(OSError):
            aside.unlink(missing_ok=True)
        raise


def _is_writable(folder: Path) -> bool:
    """Whether one may write there, or make it."""
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
