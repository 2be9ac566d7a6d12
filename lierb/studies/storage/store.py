"""Write a study's folder: its lock, files and manifest."""

from __future__ import annotations

import hashlib
import os
import re
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from lierb.errors import StudyError, StudyFileError
from lierb.runs.provenance import machine
from lierb.studies.description.code import FILE, Code, sha256_of_text
from lierb.studies.description.moved_starts import moved_start
from lierb.studies.description.sources import MANIFEST, STUDY
from lierb.studies.description.study import Study
from lierb.studies.description.study_tables import TABLES
from lierb.studies.storage.files import File, Stored, parquet_in
from lierb.studies.storage.manifest import FORMAT, PART, sealed
from lierb.studies.storage.results import Results
from lierb.support.files import (
    KEPT,
    TEMPORARY,
    as_it_is,
    naming,
    reason,
    rename,
    sha256_of,
    write_aside,
)

LOCK = ".lock"
UNFINISHED = {  # names of the files that a killed process may leave, by folder
    "": re.compile(rf"\.(manifest\.json|study\.toml|{FILE})\.[0-9a-f]{{8}}{re.escape(TEMPORARY)}"),
    **dict.fromkeys(
        TABLES, re.compile(rf"\.part-{PART}\.parquet\.[0-9a-f]{{8}}{re.escape(TEMPORARY)}")
    ),
}
LOCKABLE = (
    "make room, or choose a folder that you may write to, on a file system with locks, such as a "
    "local disk"
)
MANIFEST_SHARE = 0.05  # most of the time that may go into writing a large manifest
QUICK_SECONDS = 0.05  # time to write a manifest that is not large


class Store(Results):
    """A store holds the results of a study that is being run.

    Parameters and errors are those of `lierb.studies.dataset.Dataset`.
    """

    def __init__(self, folder: str | os.PathLike[str]) -> None:
        super().__init__(folder)
        self._written, self._next_writing = True, 0.0

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Hold the folder's lock in the block; the lock ends with its process."""
        with naming(self.folder, "made", "choose another folder"):
            self.folder.mkdir(parents=True, exist_ok=True)
        path = self.folder / LOCK
        try:
            lock = FileLock(path).acquire(timeout=0)
        except Timeout:
            raise StudyError(
                f"{self.folder} is being written by another run, which holds {path}"
            ) from None
        except (OSError, NotImplementedError) as error:  # another user's, or without locks
            raise StudyFileError(f"{path} cannot be locked: {reason(error)}; {LOCKABLE}") from error
        with lock:
            try:
                yield
            finally:
                if not self._written:
                    self._write_manifest()

    def exists(self) -> bool:
        return os.path.lexists(self.folder / MANIFEST)

    # ---- study -----------------------------------------------------------------------------------

    def begin(
        self, study: Study, text: str, parts: int, changes: Mapping[str, Any] | None = None,
        kept: Mapping[str, Any] | None = None,
    ) -> None:  # fmt: skip
        """Write the manifest of a study, its study.toml and its Python files.

        text : of study.toml.   parts : number of parts.   kept : parts of an earlier study that are
        parts of this one, none by default. Files of the earlier study are replaced. Raises
        StudyError for a study.toml or Python file of the user's that differs.
        """
        self.drop(self._replaced())
        missing = self._missing_code(study.code_digests)
        is_there = self.study_text(study.digest()) is not None
        self.manifest = {
            "format": FORMAT, "digest": study.digest(),
            "text": None if is_there else sha256_of_text(text), "study": study.model_dump(),
            "set": dict(changes or {}), "machine": self.manifest["machine"] if kept else machine(),
            "asked": parts, "parts": dict(kept or {}),
        }  # fmt: skip
        if moved := moved_start(study):
            self.manifest["moved"] = moved
        if study.files:
            self.manifest |= {"code": study.code_digests, "functions": study.fingerprints()}
        self._write_manifest()  # the manifest first: a study.toml without one is the user's
        for file in missing:
            self.write(file, study.code[file].encode())
        if not is_there:
            self.write(STUDY, text.encode())

    def require_place(self, study: Study) -> None:
        """Raise StudyError for a study.toml or Python file of the user's, as `begin` would."""
        replaced = self._replaced()
        self._missing_code({f: d for f, d in study.code_digests.items() if f not in replaced})
        if STUDY not in replaced:
            self.study_text(study.digest())

    def _replaced(self) -> list[str]:
        """List the study.toml and Python files of an earlier run that nobody has edited since."""
        begun = self.manifest.get("code", {}) | {STUDY: self.manifest.get("text")}
        return [f for f, sha256 in begun.items() if sha256 == sha256_of(self.folder / f)]

    def restore_code(self, code: Code) -> list[str]:
        """Write the missing Python files of the study; return their names.

        Raises StudyError for one that was edited since.
        """
        missing = self._missing_code(self.manifest.get("code", {}))
        for file in missing:
            self.write(file, code[file].encode())
        return missing

    # ---- parts -----------------------------------------------------------------------------------

    def store(self, files: list[File]) -> list[Stored]:
        """Write a part's files, each under a new name that `enter` replaces.

        Any process may store, only the one with the lock enters: a worker left by an earlier run
        overwrites nothing.
        """
        stored = []
        for file in files:
            aside = write_aside(self.folder / file.path, file.content).relative_to(self.folder)
            entry = {"rows": file.rows, "sha256": hashlib.sha256(file.content).hexdigest()}
            failed = {"failed": file.failed} if file.failed else {}
            stored.append(Stored(file.path, str(aside), entry | failed))
        return stored

    def enter(self, part: str, files: list[Stored]) -> None:
        """Rename a part's files, and enter the part in the manifest.

        The manifest is written at once, unless it has grown so large that this would take more than
        MANIFEST_SHARE of the time; then a killed run repeats its last parts.
        """
        for file in files:
            rename(self.folder / file.aside, self.folder / file.path)
            self._whole[file.path] = as_it_is(self.folder / file.path)
        self._written = False
        self.parts[part] = {file.path: file.entry for file in files}
        if time.monotonic() >= self._next_writing:
            self._write_manifest()

    def end_with(self, last: list[str]) -> None:
        """Enter the last part of each setting, of a study that ends early."""
        if self.manifest.get("stopped", []) != last:
            self.manifest["stopped"] = last
            self._write_manifest()

    def _write_manifest(self) -> None:
        began = time.monotonic()
        self.manifest["parts"] = dict(sorted(self.parts.items()))
        self.write(MANIFEST, sealed(self.manifest))
        self._written = True
        took = time.monotonic() - began
        self._next_writing = began + (took / MANIFEST_SHARE if took > QUICK_SECONDS else 0.0)

    def write(self, name: str, content: Any) -> None:
        """Write a file whole, or not at all."""
        rename(write_aside(self.folder / name, content), self.folder / name)

    # ---- cleaning --------------------------------------------------------------------------------

    def drop_damaged(self) -> list[str]:
        """Remove damaged parts from the manifest, and unfinished files; return the parts' names."""
        damaged = [part for part, files in self.parts.items() if not self._is_whole(files)]
        for part in damaged:
            del self.parts[part]
            self.manifest.pop("stopped", None)
        self.drop_unfinished()
        if damaged:
            self._write_manifest()
        return damaged

    def drop_unfinished(self) -> None:
        """Delete the unfinished files of processes that died."""
        for folder, names in UNFINISHED.items():
            place = self.folder / folder
            if not place.is_dir() or (folder and place.is_symlink()):
                continue
            with naming(place, "cleaned", KEPT), os.scandir(place) as entries:
                for entry in entries:
                    if names.fullmatch(entry.name) and entry.is_file(follow_symlinks=False):
                        Path(entry.path).unlink(missing_ok=True)

    def clear(self) -> None:
        """Delete all parts; the manifest, written first, no longer lists them."""
        files = [file for files in self.parts.values() for file in files]
        if files:
            self.parts.clear()
            self.manifest.pop("stopped", None)
            self._write_manifest()
        self.drop(files)

    def strays(self) -> list[str]:
        """List Parquet files in the tables' folders that the manifest does not enter, sorted."""
        entered = {file for files in self.parts.values() for file in files}
        return sorted(set(parquet_in(self.folder)) - entered)

    def drop(self, files: list[str]) -> None:
        """Delete files of the folder."""
        for file in files:
            with naming(self.folder / file, "deleted", "delete it"):
                (self.folder / file).unlink(missing_ok=True)
