"""Folder of a study: files, parts, manifest, and what is damaged, missing or left over."""

from __future__ import annotations

import hashlib
import os
import re
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.dataset as ds
import pyarrow.parquet as pq
from filelock import FileLock, Timeout

from lierb.errors import LierbError, StudyError, StudyFileError
from lierb.results.failures import COLUMNS, FINE, Failures
from lierb.runs.provenance import machine
from lierb.studies.description.code import FILE, Code, read_code, sha256_of_text
from lierb.studies.description.study import TABLES, Setting, Study
from lierb.studies.storage.manifest import FORMAT, PART, claims_of, file_of, read_manifest, sealed
from lierb.support.files import (
    KEPT,
    RESUME,
    TEMPORARY,
    as_it_is,
    folder_of,
    naming,
    reason,
    rename,
    sha256_of,
    write_aside,
)
from lierb.support.shown import Shown

MANIFEST = "manifest.json"
STUDY = "study.toml"
LOCK = ".lock"
UNFINISHED = {  # names of what a process that died may have left, by folder
    "": re.compile(rf"\.(manifest\.json|study\.toml|{FILE})\.[0-9a-f]{{8}}{re.escape(TEMPORARY)}"),
    **dict.fromkeys(
        TABLES, re.compile(rf"\.part-{PART}\.parquet\.[0-9a-f]{{8}}{re.escape(TEMPORARY)}")
    ),
}
LOCKABLE = (
    "make room, or choose a folder that you may write to, on a file system with locks, such as a "
    "local disk"
)
PARQUET = b"PAR1"  # how such a file begins
MANIFEST_SHARE = 0.05  # of the time, at most, that is spent on writing a large manifest
QUICK_SECONDS = 0.05  # to write one that is not large
IS_FINE = pc.field("status").isin(FINE)  # of rows: to the end, or to an event that ends it


@dataclass(frozen=True)
class File:
    """A part's table as it will be in the folder.

    failed : rows whose status is not ok, by status.
    """

    path: str
    rows: int
    content: pa.Buffer
    failed: dict[str, int]


@dataclass(frozen=True)
class Stored:
    """A file that is safe in the folder under a name that no reader sees.

    failed : as in File.
    """

    path: str
    aside: str
    rows: int
    sha256: str
    failed: dict[str, int]


def parquet_files(part: str, tables: dict[str, pa.Table], compression: str) -> list[File]:
    """A part's tables as Parquet files, the same bytes wherever they are made."""
    files = []
    for name, table in tables.items():
        # No two doubles are alike: looking for a dictionary of them takes most of the time.
        repeated = [f.name for f in table.schema if pa.types.is_dictionary(f.type)]
        sink = pa.BufferOutputStream()
        pq.write_table(table, sink, compression=compression, use_dictionary=repeated)
        failures = Failures.of(table) if "status" in table.column_names else None
        failed = failures.counts if failures else {}
        files.append(File(file_of(name, part), table.num_rows, sink.getvalue(), failed))
    return files


def part_named(file: str) -> str | None:
    """The part whose table that file is, by its path in the folder."""
    found = re.fullmatch(rf"(?:{'|'.join(TABLES)})/part-({PART})\.parquet", file)
    return found[1] if found else None


def setting_columns(schema: pa.Schema) -> list[str]:
    """The columns of a study's table that say in which setting a row is."""
    return ["cspace", "method", "rtol" if "rtol" in schema.names else "dt"]


def _fresh(digest: str, study: dict[str, Any], asked: int) -> dict[str, Any]:
    """The manifest of a study of which no part is done."""
    return {
        "format": FORMAT, "digest": digest, "text": None, "study": study, "set": {},
        "machine": machine(), "asked": asked, "parts": {},
    }  # fmt: skip


def _entry(rows: int, sha256: str, failed: dict[str, int]) -> dict[str, Any]:
    """Of the manifest."""
    entry: dict[str, Any] = {"rows": rows, "sha256": sha256}
    return entry | {"failed": failed} if failed else entry


def _says(path: Path, digest: str) -> bool:
    """Whether a file is the study of that digest, in whatever words."""
    try:
        return path.is_file() and Study.load(path).digest() == digest
    except (LierbError, OSError, RecursionError):
        return False


def _seen(folder: Path, table: str) -> Iterator[str]:
    """Files of a table's folder that its readers do not skip, by their paths in `folder`."""
    for root, inner, files in os.walk(folder / table):
        inner[:] = [name for name in inner if name[0] not in "._"]
        way = Path(root).relative_to(folder).as_posix()
        yield from (f"{way}/{name}" for name in files if name[0] not in "._")


def _is_parquet(path: Path) -> bool:
    if path.suffix.lower() == ".parquet":
        return True
    try:
        if not path.is_file():
            return False
        with path.open("rb") as file:
            return file.read(len(PARQUET)) == PARQUET
    except OSError:
        return False


class Store(Shown):
    """Folder with one study's results: its manifest, and the tables of its finished parts.

    Parameters and errors are those of `lierb.studies.dataset.Dataset`.
    """

    def __init__(self, folder: str | os.PathLike[str]) -> None:
        self.folder = folder_of(folder)
        self.manifest: dict[str, Any] = {}
        self._written, self._next_writing = True, 0.0
        self._whole: dict[str, tuple[int, ...]] = {}  # files that were looked at, as they were

    @property
    def parts(self) -> dict[str, Any]:
        """Finished parts, by name."""
        found: dict[str, Any] = self.manifest.get("parts", {})
        return found

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Nobody else writes to the folder meanwhile; the lock goes with its process."""
        with naming(self.folder, "made", "choose another folder"):
            self.folder.mkdir(parents=True, exist_ok=True)
        path = self.folder / LOCK
        lock = FileLock(path)
        try:
            lock.acquire(timeout=0)
        except Timeout:
            raise StudyError(
                f"{self.folder} is being written by another run, which holds {path}"
            ) from None
        except (OSError, NotImplementedError) as error:  # of others, or no file system with locks
            raise StudyFileError(f"{path} cannot be locked: {reason(error)}; {LOCKABLE}") from error
        try:
            yield
        finally:
            try:
                if not self._written:
                    self._write_manifest()
            finally:
                lock.release()

    def exists(self) -> bool:
        return os.path.lexists(self.folder / MANIFEST)

    def read(self) -> None:
        """Read the manifest again.

        Raises
        ------
        StudyError
            The folder has no manifest, or not any more.
        """
        self.manifest = read_manifest(self.folder / MANIFEST)

    def _read_once(self) -> None:
        """For whoever opened a folder: `Dataset(folder).table()`."""
        if not self.manifest:
            self.read()

    @property
    def changes(self) -> dict[str, Any]:
        """Changes of the study's file with which it was run, by dotted keys."""
        found: dict[str, Any] = self.manifest.get("set", {})
        return found

    def begin(
        self,
        digest: str,
        study: dict[str, Any],
        text: str,
        asked: int,
        changes: Mapping[str, Any] | None = None,
        code: Code | None = None,
        functions: Mapping[str, str] | None = None,
    ) -> None:
        """Start the folder of a study of so many parts, or of another than was begun in it.

        code : the texts of its Python files.   functions : as the manifest has them.
        Raises StudyError for a study.toml, or Python file, of the user's that says something else.
        """
        begun, texts = self.manifest.get("text"), code or {}
        if begun and sha256_of(self.folder / STUDY) == begun:
            self.drop([STUDY])
        for file, digest_begun in self.manifest.get("code", {}).items():
            if sha256_of(self.folder / file) == digest_begun:
                self.drop([file])
        digests = {file: sha256_of_text(text) for file, text in texts.items()}
        missing = self._missing_code(digests)
        is_there = self.study_text(digest) is not None
        self.manifest = _fresh(digest, study, asked) | {"set": dict(changes or {})}
        if texts:
            self.manifest |= {"code": digests, "functions": dict(functions or {})}
        if not is_there:
            self.manifest["text"] = sha256_of_text(text)
        self._write_manifest()  # first: a study.toml without one is the user's
        for file in missing:
            self.write(file, texts[file].encode())
        if not is_there:
            self.write(STUDY, text.encode())

    def _missing_code(self, digests: Mapping[str, str]) -> list[str]:
        """Those of these Python files that are not there.

        Raises StudyError for one that is there and another one.
        """
        for file, digest in digests.items():
            path = self.folder / file
            if os.path.lexists(path) and sha256_of(path) != digest:
                raise StudyError(
                    f"{path} is not the file that the study is run with: one of the two was edited "
                    "since; restore it, or choose another folder for the results"
                )
        return [file for file in digests if not os.path.lexists(self.folder / file)]

    def restore_code(self, code: Code) -> list[str]:
        """Write those of the study's Python files that are missing; which they are.

        Raises StudyError for one that was edited since.
        """
        missing = self._missing_code(self.manifest.get("code", {}))
        for file in missing:
            self.write(file, code[file].encode())
        return missing

    def code(self) -> Code:
        """The texts of the Python files that the results were made with.

        Raises StudyError where one is missing or was edited since.
        """
        digests = self.manifest.get("code", {})
        if missing := self._missing_code(digests):
            raise StudyError(f"{self.folder / missing[0]} is missing; {RESUME} it again")
        return read_code(self.folder, digests)

    def study_text(self, digest: str | None = None) -> str | None:
        """What study.toml says, the study of that digest or of the manifest; None if there is none.

        Raises StudyError where it says another one: somebody has edited it, or put it there.
        """
        path, digest = self.folder / STUDY, digest or self.manifest["digest"]
        if not os.path.lexists(path):
            return None
        entered = self.manifest.get("digest") == digest and self.manifest.get("text")
        if sha256_of(path) != entered and not _says(path, digest):
            raise StudyError(
                f"{path} says another study than the one that the folder is for, and is not "
                "written over; move it elsewhere, or choose another folder"
            )
        return path.read_text(encoding="utf-8")

    def store(self, files: list[File]) -> list[Stored]:
        """Write a part's files, each under a name of its own that `enter` replaces.

        Any process may do this, the one with the lock alone enters: a worker that another run has
        left behind overwrites nothing.
        """
        return [
            Stored(
                file.path,
                str(write_aside(self.folder / file.path, file.content).relative_to(self.folder)),
                file.rows, hashlib.sha256(file.content).hexdigest(), file.failed,
            )
            for file in files
        ]  # fmt: skip

    def enter(self, part: str, files: list[Stored]) -> None:
        """Give a part's files their names, and count it among the finished ones.

        The manifest is written at once, unless it has grown so large that this would take more than
        a share of the time; then a killed run does the last parts again.
        """
        for file in files:
            rename(self.folder / file.aside, self.folder / file.path)
            self._whole[file.path] = as_it_is(self.folder / file.path)
        self._written = False
        self.parts[part] = {f.path: _entry(f.rows, f.sha256, f.failed) for f in files}
        if time.monotonic() >= self._next_writing:
            self._write_manifest()

    def end_with(self, last: list[str]) -> None:
        """Note that no more parts will come: the last one of each setting."""
        if self.manifest.get("stopped", []) != last:
            self.manifest["stopped"] = last
            self._write_manifest()

    @property
    def is_complete(self) -> bool:
        """Whether no part is missing."""
        stopped: list[str] = self.manifest.get("stopped", [])
        return bool(stopped) or len(self.parts) == self.manifest["asked"]

    def _write_manifest(self) -> None:
        began = time.monotonic()
        self.manifest["parts"] = dict(sorted(self.parts.items()))
        self.write(MANIFEST, sealed(self.manifest))
        self._written = True
        took = time.monotonic() - began
        self._next_writing = began + (took / MANIFEST_SHARE if took > QUICK_SECONDS else 0.0)

    def write(self, name: str, content: Any) -> None:
        """A file with that content, or none: never half of it."""
        rename(write_aside(self.folder / name, content), self.folder / name)

    def drop_damaged(self) -> list[str]:
        """Forget parts whose files are not what was entered, and what was left unfinished."""
        damaged = [part for part, files in self.parts.items() if not self._is_whole(files)]
        for part in damaged:
            del self.parts[part]
            self.manifest.pop("stopped", None)
        self.drop_unfinished()
        if damaged:
            self._write_manifest()
        return damaged

    def mend(self, study: Study, asked: int) -> bool:
        """Enter anew, of a damaged manifest, the parts whose files are as it says.

        Returns whether it is one of that study; else nothing is changed.
        """
        claims = claims_of(self.folder / MANIFEST, study.digest(), study.table_names)
        if claims is None:
            return False
        if claims.get("text") != sha256_of(self.folder / STUDY):
            claims["text"] = None  # it is not as a run wrote it
        parts = {
            part: {name: self._recounted(name, entry["sha256"]) for name, entry in files.items()}
            for part, files in claims["parts"].items() if self._is_whole(files)
        }  # fmt: skip
        fresh = _fresh(study.digest(), study.model_dump(), asked)
        if study.files:
            fresh |= {"code": study.code_digests, "functions": study.fingerprints()}
        self.manifest = fresh | claims | {"parts": parts}
        self._write_manifest()
        return True

    def _recounted(self, name: str, sha256: str) -> dict[str, Any]:
        """The entry of a file that is whole."""
        file = pq.ParquetFile(self.folder / name)
        has_status = "status" in file.schema_arrow.names
        failures = Failures.of(file.read(columns=list(COLUMNS))) if has_status else None
        return _entry(file.metadata.num_rows, sha256, failures.counts if failures else {})

    def drop_unfinished(self) -> None:
        """Delete what processes that died have left unfinished, and nothing else."""
        for folder, names in UNFINISHED.items():
            place = self.folder / folder
            if not place.is_dir() or (folder and place.is_symlink()):
                continue
            with naming(place, "cleaned", KEPT), os.scandir(place) as entries:
                for entry in entries:
                    if names.fullmatch(entry.name) and entry.is_file(follow_symlinks=False):
                        Path(entry.path).unlink(missing_ok=True)

    def strays(self) -> list[str]:
        """Parquet files that other readers take for parts of a table and no manifest enters."""
        entered = {file for files in self.parts.values() for file in files}
        found = (file for table in TABLES for file in _seen(self.folder, table))
        return sorted(
            file for file in found if file not in entered and _is_parquet(self.folder / file)
        )

    def drop(self, files: list[str]) -> None:
        """Delete files of the folder."""
        for file in files:
            with naming(self.folder / file, "deleted", "delete it"):
                (self.folder / file).unlink(missing_ok=True)

    def _is_whole(self, files: dict[str, Any]) -> bool:
        for name, entry in files.items():
            before = as_it_is(self.folder / name)
            if not before:
                return False
            if self._whole.get(name) != before:
                if sha256_of(self.folder / name) != entry["sha256"]:
                    return False
                self._whole[name] = before
        return True

    def _require_whole(self, files: Iterable[str]) -> None:
        for name in files:
            part = Path(name).stem.removeprefix("part-")
            if not self._is_whole({name: self.parts[part][name]}):
                raise StudyError(f"{self.folder / name} is damaged or missing; {RESUME} it again")

    def table(self, name: str = "summary", *, check: bool = True) -> ds.Dataset:
        """Open the finished parts of a table, as an Arrow dataset.

        Parameters
        ----------
        name : {"summary", "history", "events"}, optional
            Name of the table.
        check : bool, optional
            Compare each file with its checksum, once; it is read for that.

        Returns
        -------
        pyarrow.dataset.Dataset
            The table.

        Raises
        ------
        StudyError
            The study has no such table, or a file is damaged.
        """
        self._read_once()
        chosen = [
            file for part, files in self.parts.items()
            for file in files if file == file_of(name, part)
        ]  # fmt: skip
        if not chosen:
            raise StudyError(f"{self.folder} has no finished part with {name}")
        if check:
            self._require_whole(chosen)
        return ds.dataset([str(self.folder / file) for file in chosen], format="parquet")

    def part_of(self, name: str, part: str, columns: list[str]) -> pa.Table:
        """Columns of one part of a table."""
        file = file_of(name, part)
        self._require_whole([file])
        return pq.read_table(self.folder / file, columns=columns)

    @property
    def trajectories(self) -> int:
        """Number of rows of the summary, by the manifest."""
        return sum(entry["rows"] for _, entry in self._summaries())

    def rest(self, remedy: str) -> str:
        """Why there are fewer parts than were asked for, and what helps; "" where all are there."""
        if self.manifest.get("stopped"):
            return f"; enough, by {self.manifest['study']['sample']['stop_when']}"
        return "" if self.is_complete else f"; {remedy}"

    def failures(self) -> Failures | None:
        """Return the trajectories that failed, by the manifest.

        Returns
        -------
        Failures or None
            The failures; None if all are ok.
        """
        failing = [
            (path, entry["failed"]) for path, entry in self._summaries() if "failed" in entry
        ]
        if not failing:
            return None
        self._require_whole([failing[0][0]])
        table = ds.dataset(str(self.folder / failing[0][0]), format="parquet")
        columns = [*setting_columns(table.schema), *COLUMNS]
        (row,) = table.head(1, columns=columns, filter=~IS_FINE).to_pylist()
        setting, first = Setting.of_row(row), {name: row[name] for name in COLUMNS}
        counts: Counter[str] = Counter()
        for _, failed in failing:
            counts.update(failed)
        return Failures(self.trajectories, dict(counts), **first, setting=setting.label)

    def _summaries(self) -> Iterator[tuple[str, dict[str, Any]]]:
        """Files of the summary, setting by setting, and their entries."""
        for part, files in sorted(self.parts.items()):
            yield (name := file_of("summary", part)), files[name]
