"""Locate errors in a study: line and key of its file."""

from __future__ import annotations

import inspect
import re
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from difflib import get_close_matches
from functools import reduce
from typing import Any, get_args

from pydantic import BaseModel, ValidationError

from lierb.errors import LierbError, StudyError
from lierb.studies.description.changes import path_of, written
from lierb.studies.description.study_file import ELEMENTS, line_of, shortened

MOST_LISTED = 10  # most errors of a file that are listed


@contextmanager
def at(table: str, keys: Collection[str] = ()) -> Iterator[None]:
    """Convert a LierbError, in a context, into a StudyError about a table of the file.

    If the message begins with one of `keys`, the key is appended to the table's name. A StudyError
    about a body or a joint gets the whole name of its table.
    """
    try:
        yield
    except StudyError as error:
        owner, _, last = table.rpartition(".")
        if owner and last not in ELEMENTS and re.match(rf"{last}\b", str(error)):
            raise StudyError(f"{owner}.{error}") from None
        raise
    except LierbError as error:
        first = re.match(r"\w+", str(error))
        key = f".{first[0]}" if first and first[0] in keys else ""
        raise StudyError(f"{table}{key}: {error}") from None


def called(table: str, function: Any, values: dict[str, Any]) -> Any:
    """Return function(**values). Raises StudyError for a key that is not one of its arguments."""
    signature = inspect.signature(function)
    known = [n for n, p in signature.parameters.items() if p.kind is not p.VAR_KEYWORD]
    for name in values:
        if name not in known:
            raise StudyError(f"{table}.{name}: unknown key{suggestion(name, known)}")
    needed = [n for n, p in signature.parameters.items() if p.default is p.empty and n in known]
    if lacking := [name for name in needed if name not in values]:
        name = getattr(function, "__name__", "it")
        raise StudyError(
            f"{table}: {' and '.join(lacking)} missing; {name} needs {', '.join(needed)}"
        )
    return function(**values)


def suggestion(name: str, known: list[str]) -> str:
    near = get_close_matches(name, known, n=1, cutoff=0.5)
    return f"; did you mean {near[0]}?" if near else f"; known: {', '.join(known)}"


@dataclass(frozen=True)
class Given:
    """Source of a study: name and text of its file, and changes to its tables."""

    source: str
    text: str
    changes: Mapping[str, Any]

    def place(self, path: tuple[Any, ...]) -> str:
        """Return file and line of a key, and the changes of its table."""
        keys = [path_of(key) for key in self.changes]
        if path and path[0] in ELEMENTS:  # its parameters are in a table of [[problem.forces]]
            path = ("problem", path[0], *path[2:])
        names = tuple(map(str, path))
        line = None if any(names[: len(key)] == key for key in keys) else line_of(self.text, path)
        place = f"{self.source}:{line}" if line else self.source
        near = [each for key, each in zip(keys, written(self.changes)) if key[:1] == names[:1]]
        return f"{place} with {', '.join(near)}" if near else place


WORDS = {  # TOML's terms for Python's terms in pydantic's messages
    r"a valid dictionary( or instance of \w+)?": "a table",
    r"a valid string": "text",
    r"a valid list": "a list",
}


def messages(
    errors: ValidationError, model: type[BaseModel], tables: dict[str, Any], given: Given
) -> str:
    """Format the first of pydantic's errors, one per line.   model : model of the whole file."""
    every = errors.errors(include_url=False, include_context=False)
    lines = [_message(error, model, tables, given) for error in every[:MOST_LISTED]]
    if rest := every[MOST_LISTED:]:
        lines.append(f"{given.source}: and {len(rest)} more")
    return "\n".join(dict.fromkeys(lines))


def _message(error: Any, model: type[BaseModel], tables: dict[str, Any], given: Given) -> str:
    """Format one of pydantic's errors as a line: place, key, error, input."""
    path = tuple(error["loc"])
    while path and reduce(_item, path, tables) is None and error["type"] != "missing":
        path = path[:-1]  # pydantic adds the names of the alternatives that it tried
    key = ".".join(_named(path, tables))
    what = error["msg"][0].lower() + error["msg"][1:]
    for python, toml in WORDS.items():
        what = re.sub(python, toml, what)
    if error["type"] == "extra_forbidden":
        *table, name = path
        known = _fields_at(model, tuple(table))
        inner = [f"{each}.{name}" for each in known if name in _fields_at(model, (*table, each))]
        hint = f"; did you mean {inner[0]}?" if inner else suggestion(str(name), known)
        what = f"unknown key{hint}"
    elif error["type"] == "missing":
        what = "is missing"
    elif not isinstance(error["input"], dict):
        what += f", got {shortened(repr(error['input']))}"
    return f"{given.place(path)}: {key}: {what}"


def _named(path: tuple[Any, ...], tables: Any) -> Iterator[str]:
    """Yield the parts of a path; links, loops and elements with a name have it for their number."""
    for part in path:
        tables = _item(tables, part)
        name = tables.get("name") if isinstance(part, int) and isinstance(tables, dict) else None
        yield name if isinstance(name, str) else str(part)


def _item(tables: Any, part: Any) -> Any:
    """Return an entry of tables or a list, which is never None; None if there is none."""
    try:
        return tables[part]
    except (KeyError, IndexError, TypeError):
        return None


def _fields_at(model: Any, path: tuple[Any, ...]) -> list[str]:
    for part in path:
        if isinstance(part, int):  # index of a list
            continue
        field = model.model_fields.get(part)
        model = _model_in(field.annotation) if field else BaseModel
        if model is None:
            return []
    return list(model.model_fields)


def _model_in(annotation: Any) -> Any:
    """Return the model of a field, or of the items of a list field."""
    if inspect.isclass(annotation) and issubclass(annotation, BaseModel):
        return annotation
    return next(filter(None, map(_model_in, get_args(annotation))), None)


def located(message: str, given: Given) -> str:
    """Prefix a message that begins with a key by the key's location: `table.key: …`."""
    key = message.partition(":")[0]
    return f"{given.place(tuple(key.split('.')))}: {shortened(message)}"


@contextmanager
def at_lines(given: Given) -> Iterator[None]:
    """Convert a StudyError, in a context, to one with the location of its key."""
    try:
        yield
    except StudyError as error:
        raise StudyError(located(str(error), given)) from None
