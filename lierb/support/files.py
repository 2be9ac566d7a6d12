"""Write files atomically, and report errors of the file system with remedies."""

from __future__ import annotations

import errno
import hashlib
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any
from uuid import uuid4

import pyarrow as pa
import pyarrow.parquet as pq

from lierb.errors import ArgumentError, StudyError, StudyFileError

TEMPORARY = ".unfinished"
URL = re.compile(r"[A-Za-z][\w+.-]+:/")  # two letters or more: a single letter is a drive
COMMENT = re.compile(rb"<!--.*?-->", re.DOTALL)
HTML = re.compile(rb"(\xef\xbb\xbf)?\s*<(!doctype\s+html|html)\b", re.IGNORECASE)
RESUME = "--resume (resume=True) does"
KEPT = f"finished parts are kept, {RESUME} the rest"
ROOM = "make room there, or choose another place"
READABLE = f"make it readable, or delete it, and {RESUME} it again"


def folder_of(given: str | os.PathLike[str]) -> Path:
    """Return the path of a folder for results, with `~` expanded.

    Raises StudyError for a URL, and for a name that Arrow cannot open.
    """
    try:
        text = os.fsdecode(given)
    except TypeError:
        raise ArgumentError(f"out={given!r}; expected the path of a folder") from None
    if not text or "\0" in text:
        raise StudyError(f"{text!r} is no folder for results; name one, such as results/top")
    if URL.match(text):
        raise StudyError(
            f"{text} is no folder of this machine; results are written to a local one, which can "
            "be copied there afterwards"
        )
    try:
        folder = Path(text).expanduser()
        str(folder).encode()
    except RuntimeError as error:
        raise StudyError(f"{text}: {error}; name the folder without ~") from None
    except UnicodeEncodeError:
        raise StudyError(
            f"the folder {os.fsencode(text)!r} is not UTF-8, which Arrow cannot open; choose "
            "another for the results"
        ) from None
    return folder


def parquet(table: pa.Table, **options: Any) -> pa.Buffer:
    """Return a table as the content of a Parquet file.   options : of Arrow's `write_table`."""
    content = pa.BufferOutputStream()
    pq.write_table(table, content, **options)
    return content.getvalue()


def write_whole(path: Path, content: Any) -> None:
    """Write a file with that content, or leave it unchanged. Raises StudyFileError.

    Links, pipes and devices such as /dev/stdout are written in place.
    """
    if path.is_symlink() or (path.exists() and not path.is_file()):
        with naming(path, "written", ROOM):
            path.write_bytes(content)
    else:
        rename(write_aside(path, content, ROOM), path, ROOM)


def require_page(path: Path) -> None:
    """Raise StudyFileError if a page would overwrite a file that is not an HTML page.

    Such a file may be a study's manifest or a part of its results.
    """
    if path.is_file():
        with naming(path, "read", "choose another file for the page"), path.open("rb") as file:
            beginning = COMMENT.sub(b"", file.read(4096))
        if beginning and not HTML.match(beginning):
            raise StudyFileError(
                f"{path} is there and no HTML page, and would be lost; choose another file for the "
                "page, or delete this one"
            )


def write_aside(path: Path, content: Any, remedy: str = KEPT) -> Path:
    """Write a temporary file beside `path`; return its path. Readers of the folder skip it."""
    aside = path.with_name(f".{path.name}.{uuid4().hex[:8]}{TEMPORARY}")
    with naming(path.parent, "made", remedy):
        path.parent.mkdir(parents=True, exist_ok=True)
    with naming(path, "written", remedy), _deleted_on_error(aside), aside.open("wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())
    return aside


def rename(aside: Path, path: Path, remedy: str = KEPT) -> None:
    """Rename a temporary file durably; delete it if that fails."""
    with naming(path, "written", remedy), _deleted_on_error(aside):
        aside.replace(path)
        _sync(path.parent)


@contextmanager
def _deleted_on_error(file: Path) -> Iterator[None]:
    try:
        yield
    except BaseException:
        with suppress(OSError):
            file.unlink(missing_ok=True)
        raise


def _sync(folder: Path) -> None:
    """Make renames in a folder durable, where the system supports it."""
    if os.name == "posix":
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        except OSError as error:
            if error.errno not in (errno.EINVAL, errno.ENOTSUP):  # raised by network file systems
                raise
        finally:
            os.close(handle)


@contextmanager
def naming(path: Path, deed: str, remedy: str) -> Iterator[None]:
    """Convert system errors in the context to StudyFileError with the file and a remedy."""
    try:
        yield
    except StudyFileError:
        raise
    except OSError as error:
        is_no_folder = isinstance(error, FileExistsError | NotADirectoryError)
        message = "is no folder" if is_no_folder else f"cannot be {deed}: {reason(error)}"
        raise StudyFileError(f"{path} {message}; {remedy}") from error


def reason(error: Exception) -> str:
    return getattr(error, "strerror", None) or str(error)


def as_it_is(path: Path) -> tuple[int, ...]:
    """Return inode, size and time of a file, to detect changes; () without the file."""
    with naming(path, "read", READABLE), suppress(FileNotFoundError):
        if path.is_file():
            status = path.stat()
            return status.st_ino, status.st_size, status.st_mtime_ns
    return ()


def sha256_of(path: Path) -> str:
    """Return the digest of a file's content; "" without the file."""
    with naming(path, "read", READABLE):
        if not path.is_file():  # a pipe would block
            return ""
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
