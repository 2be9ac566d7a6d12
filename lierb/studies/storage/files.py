"""The Parquet files of a part have contents, and names in the folder."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow as pa

from lierb.results.failures import Failures
from lierb.studies.description.study_tables import TABLES
from lierb.studies.storage.manifest import PART, file_of
from lierb.support.files import parquet

PARQUET = b"PAR1"  # first bytes of a Parquet file


@dataclass(frozen=True)
class File:
    """Hold the content of a part's file.

    path : in the folder.   failed : number of failed trajectories by status.
    """

    path: str
    rows: int
    content: pa.Buffer
    failed: dict[str, int]


@dataclass(frozen=True)
class Stored:
    """A stored file is synced to the folder under the name `aside`, which readers skip.

    path : as in File.   entry : of the file in the manifest.
    """

    path: str
    aside: str
    entry: dict[str, Any]


def parquet_files(part: str, tables: dict[str, pa.Table], compression: str) -> list[File]:
    """Write a part's tables as Parquet; the bytes depend on the tables alone."""
    files = []
    for name, table in tables.items():
        # No two doubles are alike: looking for a dictionary of them takes most of the time.
        repeated = [f.name for f in table.schema if pa.types.is_dictionary(f.type)]
        content = parquet(table, compression=compression, use_dictionary=repeated)
        failures = Failures.of(table) if "status" in table.column_names else None
        failed = failures.counts if failures else {}
        files.append(File(file_of(name, part), table.num_rows, content, failed))
    return files


def part_named(file: str) -> str | None:
    """Name of the part that a path in the folder belongs to; None for another file."""
    match = re.fullmatch(rf"(?:{'|'.join(TABLES)})/part-({PART})\.parquet", file)
    return match[1] if match else None


def parquet_in(folder: Path) -> Iterator[str]:
    """Yield all Parquet files in the tables' folders that a reader of the folder opens."""
    for table in TABLES:
        for root, inner, files in os.walk(folder / table):
            inner[:] = [name for name in inner if name[0] not in "._"]
            way = Path(root).relative_to(folder).as_posix()
            for name in files:
                if name[0] not in "._" and _is_parquet(folder / way / name):
                    yield f"{way}/{name}"


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
