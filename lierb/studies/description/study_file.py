"""Text of a study's file, the lines of its keys, and conversion to values that a file can hold.

`plain` converts tables from a file or from Python. Its result can be written as TOML and JSON, and
is read back unchanged.
"""

from __future__ import annotations

import io
import re
import tomllib
import unicodedata
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from lierb.errors import LierbError, StudyError, brief
from lierb.sampling.distribution import Distribution
from lierb.sampling.distributions import DISTRIBUTIONS, Constant
from lierb.studies.description.sources import LONGEST_STUDY
from lierb.support.arrays import as_floats, as_matrix, components, pose_matrix

ELEMENTS = ("forces", "constraints", "observables", "events", "states", "controllers")
MOST_TEXT = 1000  # most characters of a text value
MOST_PARTS = 32  # most parts of a dotted key; tomllib's time grows with the square of their number
DEEPEST = 16  # most levels of nested tables and lists; a study needs seven
LARGEST = 2**64 - 1  # largest whole number: the largest seed
LONGEST_MESSAGE = 400  # characters

_KEY = r"""(?:(?<![\w-])[\w-]{1,100}+|"(?:[^"\\\n]|\\.){0,100}+"|'[^'\n]{0,100}+')"""
_LONG_KEY = re.compile(rf"{_KEY}(?:[ \t]*+\.[ \t]*+(?:[\w-]{{1,100}}+|{_KEY})){{{MOST_PARTS},}}+")
_LONG_NUMBER = re.compile(r"\d[\d_]{4000,}")


# ---- text --------------------------------------------------------------------------------------


def read(path: Path) -> str:
    """Read the text of a study's file or pipe.

    Raises StudyError for a folder, a binary file or a too large file; OSError for a missing file.
    """
    try:
        with path.open("rb") as file:
            content = file.read(LONGEST_STUDY + 1)
    except IsADirectoryError:
        raise StudyError(f"{path} is a folder; give the study's file, a TOML file") from None
    if len(content) > LONGEST_STUDY:
        raise StudyError(f"{path.name} is {TOO_LARGE}")
    try:
        return io.TextIOWrapper(io.BytesIO(content), encoding="utf-8-sig").read()
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise StudyError(
            f"{path.name}:{line}: byte {error.start} is not UTF-8 ({error.reason}); "
            "save the file as UTF-8"
        ) from None


TOO_LARGE = (
    f"larger than {LONGEST_STUDY // 2**20} MiB, the most for a study; what each body has of its "
    "own is drawn from a distribution, or given to lierb.integrate as arrays"
)


def tables_in(text: str, source: str) -> dict[str, Any]:
    """Parse a TOML text into tables. Raises StudyError that names the line of an error."""
    if match := _LONG_KEY.search(text):
        raise StudyError(f"{_line_at(text, match.start(), source)}: a key of {MOST_PARTS}+ parts")
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise StudyError(shortened(f"{source}: {error}")) from None
    except RecursionError:
        place = _line_at(text, _deepest(text), source)
        raise StudyError(f"{place}: lists or tables nested too deeply; expected {DEEP}") from None
    except ValueError as error:  # Python rejects integers of more than 4300 digits
        match = _LONG_NUMBER.search(text)
        place = _line_at(text, match.start(), source) if match else source
        raise StudyError(f"{place}: {_TOO_LARGE_NUMBER if match else error}") from None


DEEP = f"at most {DEEPEST}, one in the other"
_TOO_LARGE_NUMBER = "a whole number of more than 64 bits; write it with an exponent, as 1e20"


def _line_at(text: str, index: int, source: str) -> str:
    """Format the location of a text index as `file:line: key`."""
    lines = text[: index + 1].split("\n")
    table: list[str] = []
    for line in lines[:-1]:
        if line.lstrip().startswith("["):
            table = _parts_of(line, table) or table
    whole = text[: text.find("\n", index) % (len(text) + 1)].split("\n")[-1]
    key = ".".join(_parts_of(whole, table) or table)
    return f"{source}:{len(lines)}" + (f": {shortened(key)}" if key else "")


def _deepest(text: str) -> int:
    """Return the index of the deepest nesting of brackets, including brackets in strings."""
    depth, deepest, where = 0, 0, 0
    for bracket in re.finditer(r"[\[\]{}]", text):
        depth += 1 if bracket[0] in "[{" else -1
        if depth > deepest:
            deepest, where = depth, bracket.start()
    return where


def line_of(text: str, path: tuple[Any, ...]) -> int | None:
    """Return the line of a TOML text that sets a key, or else the nearest table around it.

    path : keys; for one of several tables, such as [[problem.links]], also its number or name.
    """
    lines, names = _lines_in(text)
    wanted = _numbered(path, names)
    around = [
        (len(there), -number)
        for number, there in lines
        if 0 < len(there) <= len(wanted) and all(w in (f, ANY) for f, w in zip(there, wanted))
    ]
    return -max(around)[1] if around else None


ANY = None  # in a path: any table of a list
Names = dict[tuple[Any, ...], list[str]]  # names of the tables in each list of tables


def _lines_in(text: str) -> tuple[list[tuple[int, tuple[Any, ...]]], Names]:
    """Return number and path of each line that sets a key or table, and listed tables' names."""
    lines: list[tuple[int, tuple[Any, ...]]] = []
    names: Names = {}
    table: list[str] = []
    for number, line in enumerate(text.split("\n"), start=1):
        parts = _parts_of(line, table)
        if parts is None:
            continue
        stripped = line.strip()
        if stripped.startswith("["):
            table = parts
        if stripped.startswith("[["):
            owner = (*_latest(tuple(parts[:-1]), names), parts[-1])
            names.setdefault(owner, []).append("")
            if len(names[owner]) == 1:
                lines.append((number, owner))  # the list as a whole
        path = _latest(tuple(parts), names)
        lines.append((number, path))
        if path[-1] == "name" and path[:-2] in names:
            names[path[:-2]][-1] = stripped.partition("=")[2].split("#")[0].strip(" \"'")
    return lines, names


def _latest(path: tuple[str, ...], names: Names) -> tuple[Any, ...]:
    """Insert, after each list of tables in a path, the number of the list's latest table."""
    numbered: tuple[Any, ...] = ()
    for part in path:
        numbered += (part,)
        if numbered in names:
            numbered += (len(names[numbered]) - 1,)
    return numbered


def _numbered(path: tuple[Any, ...], names: Names) -> tuple[Any, ...]:
    """Replace names of listed tables by their numbers; insert ANY for a missing name."""
    numbered: tuple[Any, ...] = ()
    for part in path:
        known = names.get(numbered)
        if known is None:
            numbered += (part,) if isinstance(part, str) else ()
        elif isinstance(part, int):
            numbered += (part,)
        elif part in known:
            numbered += (known.index(part),)
        else:
            numbered += (ANY, part)
    return numbered


def _parts_of(line: str, table: list[str]) -> list[str] | None:
    """Return the path of the table or key that a line of TOML sets."""
    stripped = line.strip()
    if stripped.startswith("["):
        return [part.strip(" \"'") for part in stripped.strip("[]").split("]")[0].split(".")]
    key, equals, _ = stripped.partition("=")
    if not equals or stripped.startswith("#"):
        return None
    return table + [part.strip(" \"'") for part in key.split(".")]


def shortened(text: str) -> str:
    """Shorten a long message by leaving out its middle."""
    half = LONGEST_MESSAGE // 2
    return text if len(text) <= LONGEST_MESSAGE else f"{text[:half]} … {text[-half:]}"


# ---- what a file can hold ----------------------------------------------------------------------


def plain(tables: Any) -> dict[str, Any]:
    """Convert tables to values that a file can hold: new dictionaries and lists of numbers, text.

    Arrays and tuples become lists, NumPy numbers become Python numbers, distributions become
    tables, SciPy rotations become matrices, and −0 becomes 0. Values of None are left out.

    Raises StudyError with the key of any other value.
    """
    if not isinstance(tables, Mapping) and not hasattr(tables, "model_dump"):
        raise StudyError(f"a study is made of tables, a dictionary, got a {type(tables).__name__}")
    converted: dict[str, Any] = _Plain().value(tables, ())
    return converted


def plain_changes(changes: Any) -> dict[str, Any]:
    """Convert changes by dotted keys to values that a file can hold; None removes a key."""
    if not isinstance(changes, Mapping):
        raise StudyError(f"changes must be a dictionary by dotted keys, got {brief(changes)}")
    return {
        _checked_key(key, ()): None if value is None else _Plain().value(value, (key,))
        for key, value in changes.items()
    }


class _Plain:
    """Conversion of nested values; `left` bounds their number, since a list may contain itself."""

    def __init__(self) -> None:
        self.left = LONGEST_STUDY // 4  # the shortest line with a value has four characters

    def value(self, given: Any, path: tuple[str, ...]) -> Any:
        self._take(1, path)
        if len(path) > DEEPEST:
            raise StudyError(f"{_key(path[:4])}: nested too deeply; expected {DEEP}")
        match given:
            case bool() | np.bool_():
                raise StudyError(f"{_key(path)}: is {given}; a study has numbers and text only")
            case np.timedelta64():
                pass  # NumPy counts it as an integer
            case int() | np.integer():
                if abs(int(given)) > LARGEST:
                    raise StudyError(f"{_key(path)}: {_TOO_LARGE_NUMBER}")
                return int(given)
            case float() | np.floating():
                return float(given) + 0.0
            case str():
                return _checked_text(given, path)
            case list() | tuple():
                if given and set(map(type, given)) == {float}:  # fast path for long lists
                    self._take(len(given), path)
                    return [each + 0.0 for each in given]
                return [self.value(each, (*path, str(n))) for n, each in enumerate(given)]
            case Mapping():
                named = ((_checked_key(key, path), value) for key, value in given.items())
                return {k: self.value(v, (*path, k)) for k, v in named if v is not None}
            case Distribution():
                return self.value(_table_of(given, path), path)
            case np.ndarray():
                return self._array(given, path)
        if hasattr(given, "as_matrix"):
            return self._array(_matrix_of(given, path), path)
        if hasattr(given, "model_dump"):
            return self.value(given.model_dump(), path)
        raise StudyError(
            f"{_key(path)}: is a {type(given).__name__}; expected a number, text, a list or a "
            "table, as a TOML file has them"
        )

    def _take(self, count: int, path: tuple[str, ...]) -> None:
        self.left -= count
        if self.left < 0:
            raise StudyError(f"{_key(path)}: the study is {TOO_LARGE}")

    def _array(self, given: Any, path: tuple[str, ...]) -> Any:
        self._take(given.size, path)
        self.left += given.size
        if np.ma.is_masked(given):
            raise StudyError(f"{_key(path)}: is an array with masked entries; expected numbers")
        return self.value(given.tolist(), path)


def _checked_text(given: str, path: tuple[str, ...]) -> str:
    if len(given) > MOST_TEXT:
        raise StudyError(
            f"{_key(path)}: text of {len(given)} characters; expected at most {MOST_TEXT}"
        )
    for character in given if not given.isprintable() else "":
        if unicodedata.category(character) in ("Cc", "Cs"):
            raise StudyError(
                f"{_key(path)}: text with the character {character!r}; expected none that control "
                "a terminal, and no halves of a pair"
            )
    return str.__str__(given)


def _checked_key(key: Any, path: tuple[str, ...]) -> str:
    if not isinstance(key, str):
        raise StudyError(f"{_key(path)}: has the key {brief(key)}; expected text")
    return _checked_text(key, path)


def _key(path: tuple[str, ...]) -> str:
    return shortened(".".join(path)) or "study"


def _table_of(distribution: Distribution, path: tuple[str, ...]) -> Any:
    if isinstance(distribution, Constant):
        return distribution.value
    for name, kind in DISTRIBUTIONS.items():
        if type(distribution) is kind:
            names = [field.name for field in fields(kind)]  # type: ignore[arg-type]
            return {"distribution": name} | {each: getattr(distribution, each) for each in names}
    raise StudyError(
        f"{_key(path)}: is a {type(distribution).__name__}, a distribution that no file can name; "
        f"expected one of {', '.join(DISTRIBUTIONS)}"
    )


def _matrix_of(given: Any, path: tuple[str, ...]) -> Any:
    """Convert SciPy's `Rotation` or `RigidTransform`; a frame's rotation is about the origin."""
    try:
        matrix = as_floats("it", as_matrix("it", given))
    except LierbError as error:
        raise StudyError(f"{_key(path)}: {error}") from None
    if path and path[-1].endswith("_frame") and matrix.shape == (3, 3):
        return pose_matrix((components(matrix, 2), (0.0, 0.0, 0.0)))
    return matrix
