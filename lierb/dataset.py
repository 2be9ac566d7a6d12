"""A study's results on the disk: Parquet parts, entered in a manifest once they are safe there.

    DIR/study.toml            as it was run
    DIR/manifest.json         digest of the study, versions, every finished part with its checksums
    DIR/summary/part-*.parquet, DIR/history/part-*.parquet

A file is written under another name, synced, renamed, and then entered; a process may die at any
moment. What is not in the manifest does not count.
"""

from __future__ import annotations

import hashlib
import json
import os
import time
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from uuid import uuid4

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.dataset as ds
import pyarrow.parquet as pq
from filelock import FileLock, Timeout

from lierb.errors import StudyError
from lierb.failures import COLUMNS, Failures
from lierb.provenance import machine
from lierb.shown import FAILED, Lines, Shown
from lierb.study import Setting, settings_told

MANIFEST = "manifest.json"
STUDY = "study.toml"
TABLES = ("summary", "history")
FORMAT = 2
KEYS = {"format", "digest", "study", "machine", "asked", "parts"}
TEMPORARY = ".unfinished"
MANIFEST_SHARE = 0.05  # of the time, at most, that is spent on writing a large manifest
QUICK_SECONDS = 0.05  # to write one that is not large


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
        files.append(File(f"{name}/part-{part}.parquet", table.num_rows, sink.getvalue(), failed))
    return files


class Dataset(Shown):
    """The folder of one study's results."""

    def __init__(self, folder: str | Path) -> None:
        self.folder = Path(folder)
        self.manifest: dict[str, Any] = {}
        self._written, self._next_writing = True, 0.0

    @property
    def parts(self) -> dict[str, Any]:
        """The finished parts by name."""
        found: dict[str, Any] = self.manifest.get("parts", {})
        return found

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Nobody else writes to the folder meanwhile; the lock goes with its process."""
        self.folder.mkdir(parents=True, exist_ok=True)
        lock = FileLock(self.folder / ".lock")
        try:
            lock.acquire(timeout=0)
        except Timeout:
            raise StudyError(f"{self.folder} is being written by another run") from None
        try:
            yield
        finally:
            try:
                if not self._written:
                    self._write_manifest()
            finally:
                lock.release()

    def exists(self) -> bool:
        return (self.folder / MANIFEST).exists()

    def read(self) -> None:
        """Read the manifest. Raises StudyError where there is none, or no more of one."""
        path = self.folder / MANIFEST
        try:
            found = json.loads(path.read_text(encoding="utf-8"))
        except FileNotFoundError:
            raise StudyError(f"{self.folder} holds no results of a study") from None
        except ValueError as error:  # no JSON, or no text
            raise StudyError(f"{path} is damaged ({error}); delete the folder") from None
        if isinstance(found, dict) and found.get("format") == 1:
            raise StudyError(
                f"{self.folder} holds results of lierb 0.1, whose columns had other names (R, r, "
                "body, in errors/): run its study.toml anew, into another folder, or read its "
                "Parquet files themselves"
            )
        if not (isinstance(found, dict) and found.keys() >= KEYS and found["format"] == FORMAT):
            raise StudyError(f"{path} is no manifest of this version of lierb")
        self.manifest = found

    @property
    def changes(self) -> dict[str, Any]:
        """What was changed of the study's file when it was run, by dotted keys."""
        found: dict[str, Any] = self.manifest.get("set", {})
        return found

    def begin(
        self,
        digest: str,
        study: dict[str, Any],
        text: str,
        asked: int,
        changes: Mapping[str, Any] | None = None,
    ) -> None:
        """Start the folder of a study of so many parts."""
        self.write(STUDY, text.encode())
        self.manifest = {
            "format": FORMAT, "digest": digest, "study": study,
            "set": dict(changes or {}), "machine": machine(), "asked": asked, "parts": {},
        }  # fmt: skip
        self._write_manifest()

    def store(self, files: list[File]) -> list[Stored]:
        """Write a part's files, each under a name of its own that `enter` replaces.

        Any process may do this, the one with the lock alone enters: a worker that another run has
        left behind overwrites nothing.
        """
        return [
            Stored(
                file.path, self._write_aside(file.path, file.content), file.rows,
                hashlib.sha256(file.content).hexdigest(), file.failed,
            )
            for file in files
        ]  # fmt: skip

    def enter(self, part: str, files: list[Stored]) -> None:
        """Give a part's files their names, and count it among the finished ones.

        The manifest is written at once, unless it has grown so large that this would take more than
        a share of the time; then a killed run does the last parts again.
        """
        for file in files:
            self._rename(file.aside, file.path)
        self.parts[part] = {file.path: _entry(file) for file in files}
        self._written = False
        if time.monotonic() >= self._next_writing:
            self._write_manifest()

    def _write_manifest(self) -> None:
        began = time.monotonic()
        self.manifest["parts"] = dict(sorted(self.parts.items()))
        self.write(MANIFEST, (json.dumps(self.manifest, indent=1) + "\n").encode())
        self._written = True
        took = time.monotonic() - began
        self._next_writing = began + (took / MANIFEST_SHARE if took > QUICK_SECONDS else 0.0)

    def write(self, name: str, content: Any) -> None:
        """A file with that content, or none: never half of it."""
        self._rename(self._write_aside(name, content), name)

    def _write_aside(self, name: str, content: Any) -> str:
        """Write a file beside its place; its name there, which readers of the folder skip."""
        path = self.folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        aside = path.with_name(f".{path.name}.{uuid4().hex[:8]}{TEMPORARY}")
        try:
            with aside.open("wb") as file:
                file.write(content)
                file.flush()
                os.fsync(file.fileno())
        except BaseException:
            aside.unlink(missing_ok=True)
            raise
        return str(aside.relative_to(self.folder))

    def _rename(self, aside: str, name: str) -> None:
        path = self.folder / name
        (self.folder / aside).replace(path)
        _sync(path.parent)

    def drop_damaged(self) -> list[str]:
        """Forget parts whose files are not what was entered, and what was left unfinished."""
        damaged = [part for part, files in self.parts.items() if not self._is_whole(files)]
        for part in damaged:
            del self.parts[part]
        self.drop_unfinished()
        if damaged:
            self._write_manifest()
        return damaged

    def drop_unfinished(self) -> None:
        """Delete what processes that died have left unfinished."""
        for leftover in self.folder.rglob(f"*{TEMPORARY}"):
            leftover.unlink(missing_ok=True)

    def _is_whole(self, files: dict[str, Any]) -> bool:
        for name, entry in files.items():
            try:
                with (self.folder / name).open("rb") as file:
                    if hashlib.file_digest(file, "sha256").hexdigest() != entry["sha256"]:
                        return False
            except FileNotFoundError:
                return False
        return True

    def table(self, name: str = "summary") -> ds.Dataset:
        """The finished parts of a table, as an Arrow dataset."""
        paths = [str(self.folder / file) for files in self.parts.values() for file in files]
        chosen = [path for path in paths if Path(path).parent.name == name]
        if not chosen:
            raise StudyError(f"{self.folder} has no finished part with {name}")
        return ds.dataset(chosen, format="parquet")

    @property
    def trajectories(self) -> int:
        """How many rows the summary has, by the manifest."""
        return sum(entry["rows"] for _, entry in self._summaries())

    def failures(self) -> Failures | None:
        """The trajectories that failed, by the manifest; None if all are ok."""
        failing = [
            (path, entry["failed"]) for path, entry in self._summaries() if "failed" in entry
        ]
        if not failing:
            return None
        columns = ["cspace", "method", "dt", *COLUMNS]
        table = ds.dataset(failing[0][0], format="parquet")
        (first,) = table.head(1, columns=columns, filter=pc.field("status") != "ok").to_pylist()
        setting = Setting(*(first.pop(name) for name in columns[:3]))
        counts: Counter[str] = Counter()
        for _, failed in failing:
            counts.update(failed)
        return Failures(self.trajectories, dict(counts), **first, setting=setting.label)

    def _summaries(self) -> Iterator[tuple[Path, dict[str, Any]]]:
        """Files of the summary, setting by setting, and their entries."""
        for _, files in sorted(self.parts.items()):
            for name, entry in files.items():
                if Path(name).parent.name == "summary":
                    yield self.folder / name, entry

    def _shown(self) -> tuple[str, Lines]:
        if not self.manifest:
            return f"lierb.Dataset of {self.folder}, not read", []
        study, done, asked = self.manifest["study"], len(self.parts), self.manifest["asked"]
        run = study["integrate"]
        lines = [
            ("settings", settings_told(run["cspace"], run["method"], run["dt"])),
            ("trajectories", str(self.trajectories)),
            ("parts", f"{done} of {asked}{'' if done == asked else '; resume=True does the rest'}"),
        ]
        if failed := sum(sum(entry.get("failed", {}).values()) for _, entry in self._summaries()):
            lines.append((FAILED, f"{failed} of {self.trajectories}; failures() says more"))
        tables = ("summary", "history") if run["save_every"] else ("summary",)
        lines.append(("tables", ", ".join(f'.table("{name}")' for name in tables)))
        return f"lierb.Dataset of {self.folder}: study {study['name']!r}", lines


def _entry(file: Stored) -> dict[str, Any]:
    """Of the manifest."""
    entry: dict[str, Any] = {"rows": file.rows, "sha256": file.sha256}
    return entry | {"failed": file.failed} if file.failed else entry


def _sync(folder: Path) -> None:
    """Make renames in a folder last, where the system lets one."""
    if os.name == "posix":
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
