"""The manifest of a study's results: what a folder holds, and nothing that is not checked.

A manifest bears a checksum of itself. One that was edited, cut off or mixed up is refused by those
who read it; who resumes its study keeps the parts whose files bear it out.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Collection
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    NonNegativeInt,
    PositiveInt,
    TypeAdapter,
    ValidationError,
    model_validator,
)

from lierb.errors import StudyError, StudyFileError
from lierb.studies.description.code import FILE
from lierb.studies.description.study import tables_of_study

FORMAT = 3
PART = "[0-9]{2,}-[0-9]{10,}"  # setting and first body, as `lierb.studies.storage.parts` names them
CHECKSUM = "checksum"
ANEW = "restore it, or run the study anew into another folder"
MENDED = f"--resume (resume=True) of its study keeps the parts that are whole; or {ANEW}"

Sha256 = Annotated[str, Field(pattern="^[0-9a-f]{64}$")]
PartName = Annotated[str, Field(pattern=f"^{PART}$")]
CodeFile = Annotated[str, Field(pattern=f"^{FILE}$")]


def file_of(table: str, part: str) -> str:
    """A part's file, by its path in the folder."""
    return f"{table}/part-{part}.parquet"


class _Checked(BaseModel):
    model_config = ConfigDict(strict=True, extra="forbid")


class _Entry(_Checked):
    """Of a file: its rows, and how many of them failed, by status."""

    rows: NonNegativeInt
    sha256: Sha256
    failed: dict[str, PositiveInt] = {}


class _Integrate(BaseModel):
    """Of the study, what a reader needs before it makes the study."""

    model_config = ConfigDict(strict=True)

    cspace: list[str]
    method: list[str]
    dt: list[float]
    rtol: list[float] = []
    save_every: PositiveInt | None
    save_at: list[float] | dict[str, float] | None = None


class _Problem(BaseModel):
    model_config = ConfigDict(strict=True)

    events: list[dict[str, Any]] = []


class _Study(BaseModel):
    model_config = ConfigDict(strict=True)

    name: str
    problem: _Problem = _Problem()
    integrate: _Integrate


class _Manifest(_Checked):
    """As it is written.

    digest : of the study.   text : SHA-256 of study.toml as a run wrote it; None where the user's
    own was there.   set : what was changed of the study's file.   asked : parts in all.
    stopped : the last part of each setting, of a study that had enough bodies before its time.
    code : SHA-256 of the Python files that the study names.   functions : fingerprints of what they
    compute, by what is made of them.
    """

    format: Literal[3]
    digest: Sha256
    text: Sha256 | None
    study: _Study
    set: dict[str, Any]
    machine: dict[str, str]
    asked: PositiveInt
    stopped: list[PartName] = []
    code: dict[CodeFile, Sha256] = {}
    functions: dict[str, str] = {}
    parts: dict[PartName, dict[str, _Entry]]

    @model_validator(mode="after")
    def _has_whole_parts(self) -> _Manifest:
        tables = tables_of_study(self.study.model_dump())
        for part, files in self.parts.items():
            if files.keys() != {file_of(table, part) for table in tables}:
                raise ValueError(f"part {part} has the files {list(files)}")
        return self


def sealed(manifest: dict[str, Any]) -> bytes:
    """The text of a manifest, with its checksum."""
    whole = {key: value for key, value in manifest.items() if key != CHECKSUM}
    return (json.dumps(whole | {CHECKSUM: _checksum(whole)}, indent=1) + "\n").encode()


def _checksum(manifest: dict[str, Any]) -> str:
    return hashlib.sha256(json.dumps(manifest, sort_keys=True).encode()).hexdigest()


def read_manifest(path: Path) -> dict[str, Any]:
    """What a manifest says. Raises StudyError for one that is not there, damaged or edited."""
    try:
        if path.exists() and not path.is_file():  # a pipe would be waited for
            raise StudyError(f"{path} is no file; choose another folder for the results")
        found = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise StudyError(f"{path.parent} holds no results of a study") from None
    except StudyError:
        raise
    except OSError as error:
        raise StudyFileError(f"{path} cannot be read: {error.strerror}") from error
    except (ValueError, RecursionError) as error:  # no JSON, or no text
        raise StudyError(f"{path} is damaged ({error}); {ANEW}") from None
    if not isinstance(found, dict) or "format" not in found:
        raise StudyError(f"{path} is no manifest of lierb; choose another folder for the results")
    if found["format"] == 1:
        raise StudyError(
            f"{path.parent} holds results of lierb 0.1, whose columns had other names (R, r, "
            "body, in errors/): run its study.toml anew, into another folder, or read its "
            "Parquet files themselves"
        )
    if found["format"] != FORMAT:
        raise StudyError(
            f"{path} is no manifest of this version of lierb: its format is "
            f"{str(found['format'])[:20]}, expected {FORMAT}; go on with the version that wrote "
            "it, or run its study.toml anew into another folder"
        )
    try:
        if found.pop(CHECKSUM, None) != _checksum(found):
            raise StudyError(f"{path} was edited or damaged: its checksum is another; {MENDED}")
        _Manifest.model_validate(found)
    except RecursionError as error:
        raise StudyError(f"{path} is damaged ({error}); {MENDED}") from None
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        where = ".".join(map(str, first["loc"])) or "parts"
        raise StudyError(f"{path} is damaged ({where}: {first['msg']}); {MENDED}") from None
    return found


def claims_of(path: Path, digest: str, tables: Collection[str]) -> dict[str, Any] | None:
    """What a manifest that was edited or damaged claims, or None if it is not of that study.

    parts : entries, in which files have checksums; no more is known of them.
    set, machine, text : where they may be what was written.
    """
    try:
        if not path.is_file():  # a pipe would be waited for
            return None
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return None
    if not isinstance(found, dict) or (found.get("format"), found.get("digest")) != (
        FORMAT,
        digest,
    ):
        return None
    kinds = {"set": dict[str, Any], "machine": dict[str, str], "text": Sha256}
    parts = found.get("parts")
    return {key: found[key] for key, kind in kinds.items() if _is(kind, found.get(key))} | {
        "parts": {
            part: files for part, files in (parts.items() if isinstance(parts, dict) else ())
            if _is(dict[PartName, dict[str, _Entry]], {part: files})
            and files.keys() == {file_of(table, part) for table in tables}
        }
    }  # fmt: skip


def _is(kind: Any, value: Any) -> bool:
    try:
        TypeAdapter(kind).validate_python(value, strict=True)
    except (ValidationError, RecursionError):
        return False
    return True
