"""Read and write files of the disk cache, verified by a key and a digest.

A file holds the digest of the rest, the whole key, and the content. It is written under a temporary
name and renamed. A file with another key or digest counts as absent.
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
    """Return the folders, chosen by Numba, in which a function's files may be, in search order."""
    source = inspect.getfile(function)
    chosen = (
        [UserProvidedCacheLocator]
        if numba.config.CACHE_DIR
        else [InTreeCacheLocator, UserWideCacheLocator]
    )
    folders = (Path(each(function, source).get_cache_path()) for each in chosen)
    return [folder for folder in folders if folder.is_absolute() or numba.config.CACHE_DIR]


def read(path: Path, key: str) -> bytes | None:
    """Return the content of a file; None if the key differs or the digest is wrong."""
    if not path.is_file():  # a pipe would block
        return None
    stored = path.read_bytes()
    digest, content = stored[:DIGEST_SIZE], stored[DIGEST_SIZE:]
    begin = key.encode() + b"\0"
    if hashlib.sha256(content).digest() != digest or not content.startswith(begin):
        return None
    return content[len(begin) :]


def write(path: Path, key: str, content: bytes) -> None:
    """Write a file with that content; leave no partial file behind."""
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
