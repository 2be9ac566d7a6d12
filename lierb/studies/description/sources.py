"""Sources of a study's file, including standard input and pipes, which can be read only once."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext, suppress
from pathlib import Path
from tempfile import TemporaryDirectory, gettempdir
from typing import Any

from lierb.errors import ArgumentError, brief

STDIN = "-"
NAMELESS = ("/dev/", "/proc/")
STUDY, MANIFEST = "study.toml", "manifest.json"  # in a folder with results
COPIED = "lierb-study-"  # prefix of the temporary folder of a copy
LONGEST_STUDY = 4 * 2**20  # most bytes of a study's file: 200 000 numbers with all digits


def path_given(study: Any) -> Path:
    """Convert to a path, with `~` expanded to the home folder. Raises ArgumentError."""
    try:
        return Path(study).expanduser()
    except (TypeError, RuntimeError):  # not a path, or no home folder
        raise ArgumentError(
            f"study={brief(study)}; expected a lierb.Study, or the path of its TOML file"
        ) from None


def name_of(path: Path) -> str:
    """Return the name of a study by its file; in a folder of results, that in the manifest."""
    with suppress(OSError, ValueError, RecursionError, LookupError, TypeError):
        if is_of_results(path):
            return str(json.loads(path.with_name(MANIFEST).read_bytes())["study"]["name"])
    return path.stem


def folder_by(path: Path) -> str:
    """Return the name of a folder for results, by a study's file or the results that it is in."""
    return path.resolve().parent.name if is_of_results(path) else path.stem


def is_of_results(path: Path) -> bool:
    """Return True for the study.toml of a folder with results."""
    return path.name == STUDY and path.with_name(MANIFEST).is_file()


@contextmanager
def as_file(path: Path) -> Iterator[Path]:
    """Yield, in a context, the path of a study's file that has a name and can be read again.

    Standard input (`-`), a pipe, and a file whose name is not text are copied to a temporary
    `study.toml`. At most LONGEST_STUDY + 1 bytes are copied, since a pipe may have no end. Raises
    OSError.
    """
    if _is_plain(path):
        yield path
        return
    with nullcontext(sys.stdin.buffer) if str(path) == STDIN else path.open("rb") as source:
        content = source.read(LONGEST_STUDY + 1)
    with TemporaryDirectory(prefix=COPIED) as folder:
        copy = Path(folder) / STUDY
        copy.write_bytes(content)
        yield copy


def is_copied(folder: Path) -> bool:
    """Return True for the temporary folder of a study from standard input or a pipe."""
    return folder.name.startswith(COPIED) and folder.parent == Path(gettempdir())


def _is_plain(path: Path) -> bool:
    """Return True if a path is a named file or does not exist."""
    if str(path) == STDIN or str(path).startswith(NAMELESS):
        return False
    try:
        path.name.encode()
    except UnicodeEncodeError:
        return False
    return path.is_file() or not path.exists()
