"""Files that are whole or not there, and what the system says where they cannot be written."""

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

from lierb.errors import ArgumentError, StudyError, StudyFileError

TEMPORARY = ".unfinished"
URL = re.compile(r"[A-Za-z][\w+.-]+:/")  # of two letters or more: one is a drive
COMMENT = re.compile(rb"<!--.*?-->", re.DOTALL)
HTML = re.compile(rb"(\xef\xbb\xbf)?\s*<(!doctype\s+html|html)\b", re.IGNORECASE)
RESUME = "--resume (resume=True) does"
KEPT = f"finished parts are kept, {RESUME} the rest"
READABLE = f"make it readable, or delete it, and {RESUME} it again"


def folder_of(given: str | os.PathLike[str]) -> Path:
    """The folder for results that is meant, `~` being the user's own.

    Raises StudyError for what is none on this machine, or has a name that Arrow cannot open.
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


def write_whole(path: Path, content: Any) -> None:
    """A file with that content, or as it was: never half of it. Raises StudyFileError.

    What is there and no plain file is written to instead: a link, /dev/stdout, a pipe.
    """
    if path.is_symlink() or (path.exists() and not path.is_file()):
        with naming(path, "written", KEPT):
            path.write_bytes(content)
    else:
        rename(write_aside(path, content), path)


def require_page(path: Path) -> None:
    """Raise StudyFileError where an HTML page would overwrite a file that is none.

    Such as a study's manifest or a part of its results, be it through a link.
    """
    if path.is_file():
        with naming(path, "read", "choose another file for the page"), path.open("rb") as file:
            beginning = COMMENT.sub(b"", file.read(4096))
        if beginning and not HTML.match(beginning):
            raise StudyFileError(
                f"{path} is there and no HTML page, and would be lost; choose another file for the "
                "page, or delete this one"
            )


def write_aside(path: Path, content: Any) -> Path:
    """Write a file beside its place; its path there, which readers of the folder skip."""
    aside = path.with_name(f".{path.name}.{uuid4().hex[:8]}{TEMPORARY}")
    with naming(path.parent, "made", KEPT):
        path.parent.mkdir(parents=True, exist_ok=True)
    with naming(path, "written", KEPT):
        try:
            with aside.open("wb") as file:
                file.write(content)
                file.flush()
                os.fsync(file.fileno())
        except BaseException:
            with suppress(OSError):
                aside.unlink(missing_ok=True)
            raise
    return aside


def rename(aside: Path, path: Path) -> None:
    """Give a file that was written aside its name, for good, or delete it."""
    with naming(path, "written", KEPT):
        try:
            aside.replace(path)
            _sync(path.parent)
        except BaseException:
            with suppress(OSError):
                aside.unlink(missing_ok=True)
            raise


def _sync(folder: Path) -> None:
    """Make renames in a folder last, where the system lets one."""
    if os.name == "posix":
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        except OSError as error:
            if error.errno not in (errno.EINVAL, errno.ENOTSUP):  # as network file systems say
                raise
        finally:
            os.close(handle)


@contextmanager
def naming(path: Path, deed: str, remedy: str) -> Iterator[None]:
    """What the system refuses in the block, with the file that it is about and what helps."""
    try:
        yield
    except StudyFileError:
        raise
    except OSError as error:
        told = "is no folder" if isinstance(error, FileExistsError | NotADirectoryError) else ""
        told = told or f"cannot be {deed}: {reason(error)}"
        raise StudyFileError(f"{path} {told}; {remedy}") from error


def reason(error: Exception) -> str:
    return getattr(error, "strerror", None) or str(error)


def as_it_is(path: Path) -> tuple[int, ...]:
    """By what a change of a file is seen without reading it; () where there is none."""
    with naming(path, "read", READABLE), suppress(FileNotFoundError):
        if path.is_file():
            found = path.stat()
            return found.st_ino, found.st_size, found.st_mtime_ns
    return ()


def sha256_of(path: Path) -> str:
    """Of a file's content; "" where there is no such file."""
    with naming(path, "read", READABLE):
        if not path.is_file():  # nor a pipe, which would be waited for
            return ""
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
