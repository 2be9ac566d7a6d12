"""Read and write the manifest of a study's results: JSON with a checksum of itself.

Keys: `format`; `digest` of the study; `text`, SHA-256 of a study.toml that a run wrote, None where
the user's own was there; `study`, its tables; `set`, the changes of the study's file; `machine`;
`asked`, the number of parts; `moved`, a sentence about starts that closing the loops has moved;
`stopped`, the last part of each setting of a study that ended by its rule; `code`, SHA-256 of each
Python file; `functions`, fingerprints; `parts`, the finished ones: for each of their files `rows`,
`sha256` and the number of failed trajectories by status.
"""

from __future__ import annotations

import hashlib
import json
import re
from pathlib import Path
from typing import Any

from lierb.errors import StudyError, StudyFileError
from lierb.studies.description.code import FILE

FORMAT = 3
PART = "[0-9]{2,}-[0-9]{10,}"  # setting and first body, as `lierb.studies.storage.parts` names them
CHECKSUM = "checksum"
ANEW = "restore it, or run the study anew into another folder"

Manifest = dict[str, Any]


def file_of(table: str, part: str) -> str:
    """Return the path of a part's file, relative to the folder."""
    return f"{table}/part-{part}.parquet"


def sealed(manifest: Manifest) -> bytes:
    """Return the text of a manifest with its checksum."""
    whole = {key: value for key, value in manifest.items() if key != CHECKSUM}
    return (json.dumps(whole | {CHECKSUM: _checksum(whole)}, indent=1) + "\n").encode()


def _checksum(manifest: Manifest) -> str:
    return hashlib.sha256(json.dumps(manifest, sort_keys=True).encode()).hexdigest()


def read_manifest(path: Path) -> Manifest:
    """Read a manifest, without its checksum.

    Raises StudyError for a file that is missing, edited, damaged, or of another format.
    """
    if path.exists() and not path.is_file():  # reading a pipe would block
        raise StudyError(f"{path} is not a file; choose another folder for the results")
    try:
        manifest = json.loads(path.read_text(encoding="utf-8"))
        _require_format(path, manifest)
        is_whole = manifest.pop(CHECKSUM, None) == _checksum(manifest)
    except FileNotFoundError:
        raise StudyError(f"{path.parent} holds no results of a study") from None
    except StudyError:
        raise
    except OSError as error:
        raise StudyFileError(f"{path} cannot be read: {error.strerror}") from error
    except (ValueError, RecursionError) as error:  # neither JSON nor text
        raise StudyError(f"{path} is damaged ({error}); {ANEW}") from None
    if not is_whole:
        raise StudyError(f"{path} was edited or damaged: its checksum is wrong; {ANEW}")
    _require_own_files(path, manifest)
    return dict(manifest)


def _require_format(path: Path, manifest: Any) -> None:
    if not isinstance(manifest, dict) or "format" not in manifest:
        raise StudyError(f"{path} is no manifest of lierb; choose another folder for the results")
    if manifest["format"] == 1:
        raise StudyError(
            f"{path.parent} holds results of lierb 0.1, whose columns had other names (R, r, "
            "body, in errors/): run its study.toml anew, into another folder, or read its "
            "Parquet files themselves"
        )
    if manifest["format"] != FORMAT:
        raise StudyError(
            f"{path} is no manifest of this version of lierb: its format is "
            f"{str(manifest['format'])[:20]}, expected {FORMAT}; continue with the version that "
            "wrote it, or run its study.toml anew into another folder"
        )


def _require_own_files(path: Path, manifest: Manifest) -> None:
    """Raise StudyError for names of files outside the folder."""
    names = [f"code.{file}" for file in manifest.get("code", {}) if not re.fullmatch(FILE, file)]
    for part, files in manifest["parts"].items():
        is_named = re.fullmatch(PART, part)
        own = {file_of(file.partition("/")[0], part) for file in files} if is_named else set()
        names += [f"parts.{part}.{file}" for file in files if file not in own or ".." in file]
    if names:
        raise StudyError(f"{path} is damaged ({names[0]} is no file of the folder); {ANEW}")
