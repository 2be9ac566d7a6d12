"""Files of the disk cache: each says what it is and that it is whole, or counts for none.

A file holds the digest of the rest, a key in full, and the content. It is written aside and
renamed.
"""

from __future__ import annotations

import hashlib
import inspect
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any
from uuid import uuid4

import numba

from lierb.compiler.internals import (
    InTreeCacheLocator,
    UserProvidedCacheLocator,
    UserWideCacheLocator,
)

UNFINISHED = ".unfinished"
DIGEST_SIZE = hashlib.sha256().digest_size


def folders_of(function: Callable[..., Any]) -> list[Path]:
    """Folders in which a function's files may be, in the order of search: Numba's own choice."""
    source = inspect.getfile(function)
    chosen = (
        [UserProvidedCacheLocator]
        if numba.config.CACHE_DIR
        else [InTreeCacheLocator, UserWideCacheLocator]
    )
    found = (Path(each(function, source).get_cache_path()) for each in chosen)
    return [folder for folder in found if folder.is_absolute() or numba.config.CACHE_DIR]


def read(path: Path, key: str) -> bytes | None:
    """The content of a file, if it is the one asked for and as it was written."""
    if not path.is_file():  # a pipe would be waited for
        return None
    stored = path.read_bytes()
    digest, content = stored[:DIGEST_SIZE], stored[DIGEST_SIZE:]
    begin = key.encode() + b"\0"
    if hashlib.sha256(content).digest() != digest or not content.startswith(begin):
        return None
    return content[len(begin) :]


def write(path: Path, key: str, content: bytes) -> None:
    """A file with that content, or none."""
    sealed = key.encode() + b"\0" + content
    path.parent.mkdir(parents=True, exist_ok=True)
    aside = path.with_name(f".{path.stem}.{uuid4().hex[:8]}{path.suffix}{UNFINISHED}")
    try:
        aside.write_bytes(hashlib.sha256(sealed).digest() + sealed)
        aside.replace(path)
    except BaseException:
        with suppress(OSError):
            aside.unlink(missing_ok=True)
        raise
