"""Read a study's folder: its manifest, and the tables of its finished parts."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from functools import cached_property
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.dataset as ds
import pyarrow.parquet as pq
from pydantic import ValidationError

from lierb.errors import LierbError, StudyError
from lierb.results.failures import COLUMNS, SUCCESSES, Failures
from lierb.studies.description.code import Code, read_code
from lierb.studies.description.settings import Setting
from lierb.studies.description.sources import MANIFEST, STUDY
from lierb.studies.description.study import Study
from lierb.studies.description.study_tables import require_table, tables_of_study
from lierb.studies.storage.manifest import Manifest, file_of, read_manifest
from lierb.support.files import RESUME, as_it_is, folder_of, sha256_of
from lierb.support.representations import Represented

IS_SUCCESS = pc.field("status").isin(SUCCESSES)  # rows of trajectories that ended as they should


def setting_columns(schema: pa.Schema) -> list[str]:
    """Return the names of the columns that identify a row's setting."""
    return ["cspace", "method", "rtol" if "rtol" in schema.names else "dt"]


class Results(Represented):
    """The results are the finished parts of the study in a folder.

    Parameters and errors are those of `lierb.studies.dataset.Dataset`.
    """

    def __init__(self, folder: str | os.PathLike[str]) -> None:
        self.folder = folder_of(folder)
        self.manifest: Manifest = {}
        self._whole: dict[str, tuple[int, ...]] = {}  # state of each file whose checksum was right

    @property
    def parts(self) -> dict[str, Any]:
        """Return the finished parts, by name."""
        parts: dict[str, Any] = self.manifest.get("parts", {})
        return parts

    @property
    def changes(self) -> dict[str, Any]:
        """Return the changes of the study's file with which it was run, by dotted keys."""
        changes: dict[str, Any] = self.manifest.get("set", {})
        return changes

    def read(self) -> None:
        """Read the manifest again.

        Raises
        ------
        StudyError
            The folder has no manifest, or not any more.
        """
        self.manifest = read_manifest(self.folder / MANIFEST)
        self.__dict__.pop("study", None)

    def _read_once(self) -> None:
        if not self.manifest:
            self.read()

    # ---- study -----------------------------------------------------------------------------------

    @cached_property
    def study(self) -> Study:
        """Return the study as it was run, with its Python files.

        Raises StudyError where a file is missing or was edited since.
        """
        self._read_once()
        try:
            return Study.model_validate(self.manifest["study"]).with_code(self.code())
        except ValidationError as error:
            raise StudyError(f"{self.folder} is of another version of lierb: {error}") from None

    def study_text(self, digest: str | None = None) -> str | None:
        """Return the text of study.toml; None if there is none.

        digest : of the study that the file must describe, by default the manifest's.
        Raises StudyError where it describes another one.
        """
        path, digest = self.folder / STUDY, digest or self.manifest["digest"]
        if not os.path.lexists(path):
            return None
        entered = self.manifest.get("digest") == digest and self.manifest.get("text")
        if sha256_of(path) != entered and not _describes(path, digest):
            raise StudyError(
                f"{path} says another study than that of the folder, and is not "
                "overwritten; move it elsewhere, or choose another folder"
            )
        return path.read_text(encoding="utf-8")

    def code(self) -> Code:
        """Return the texts of the Python files that the results were made with.

        Raises StudyError where one is missing or was edited since.
        """
        digests = self.manifest.get("code", {})
        if missing := self._missing_code(digests):
            raise StudyError(f"{self.folder / missing[0]} is missing; {RESUME} it again")
        return read_code(self.folder, digests)

    def _missing_code(self, digests: Mapping[str, str]) -> list[str]:
        """List the Python files that are missing. Raises StudyError for an edited one."""
        for file, digest in digests.items():
            path = self.folder / file
            if os.path.lexists(path) and sha256_of(path) != digest:
                raise StudyError(
                    f"{path} is not the file that the study is run with: one of the two was "
                    "edited; restore it, or choose another folder for the results"
                )
        return [file for file in digests if not os.path.lexists(self.folder / file)]

    # ---- tables ----------------------------------------------------------------------------------

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
        ArgumentError
            The study has no such table.
        StudyError
            No part is finished yet, or a file is damaged.
        """
        self._read_once()
        require_table("name", name, tables_of_study(self.manifest["study"]))
        files = [file_of(name, part) for part, own in self.parts.items()
                 if file_of(name, part) in own]  # fmt: skip
        if not files:
            raise StudyError(f"{self.folder} has no finished part with {name}")
        if check:
            self._require_whole(files)
        return ds.dataset([str(self.folder / file) for file in files], format="parquet")

    def part_of(self, name: str, part: str, columns: list[str]) -> pa.Table:
        """Read columns of one part of a table."""
        file = file_of(name, part)
        self._require_whole([file])
        return pq.read_table(self.folder / file, columns=columns)

    def _require_whole(self, files: Iterable[str]) -> None:
        for name in files:
            part = Path(name).stem.removeprefix("part-")
            if not self._is_whole({name: self.parts[part][name]}):
                raise StudyError(f"{self.folder / name} is damaged or missing; {RESUME} it again")

    def _is_whole(self, files: dict[str, Any]) -> bool:
        """Return whether files have their checksums; each is read once."""
        for name, entry in files.items():
            before = as_it_is(self.folder / name)
            if not before:
                return False
            if self._whole.get(name) != before:
                if sha256_of(self.folder / name) != entry["sha256"]:
                    return False
                self._whole[name] = before
        return True

    # ---- counts ----------------------------------------------------------------------------------

    @property
    def is_complete(self) -> bool:
        """Return whether no part is missing."""
        return bool(self.manifest.get("stopped")) or len(self.parts) == self.manifest["asked"]

    @property
    def trajectories(self) -> int:
        """Return the number of rows of the summary, by the manifest."""
        return sum(entry["rows"] for _, entry in self._summaries())

    def rest(self, remedy: str) -> str:
        """Reason why parts are missing, and a remedy; "" if the results are complete."""
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
        (row,) = table.head(1, columns=columns, filter=~IS_SUCCESS).to_pylist()
        setting, first = Setting.of_row(row), {name: row[name] for name in COLUMNS}
        counts = sum((Counter(failed) for _, failed in failing), Counter())
        raised = None
        for path in [path for path, failed in failing if "raised" in failed][:1]:
            self._require_whole([path])
            found = Failures.of(pq.read_table(self.folder / path))
            raised = found.raised if found else None
        return Failures(
            self.trajectories, dict(counts), **first, setting=setting.label, raised=raised
        )

    def _summaries(self) -> Iterator[tuple[str, dict[str, Any]]]:
        """Yield the files of the summary, setting by setting, and their entries in the manifest."""
        for part, files in sorted(self.parts.items()):
            yield (name := file_of("summary", part)), files[name]


def _describes(path: Path, digest: str) -> bool:
    """Return whether a file describes the study of that digest, in whatever words."""
    try:
        return path.is_file() and Study.load(path).digest() == digest
    except (LierbError, OSError, RecursionError):
        return False
