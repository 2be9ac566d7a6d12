"""Change a study's settings by dotted keys: `lierb run STUDY --set integrate.dt=1e-4`.

    integrate.dt                 a key of a table
    sample.initial.omega.mean    of a table in a table
    problem.forces.0.damping     of one of several tables: by its number, its name or its type

Missing tables and keys are added; the study's model checks them afterwards.
"""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Mapping, Sequence
from contextlib import suppress
from copy import deepcopy
from typing import Any

from lierb.errors import StudyError

WORD = re.compile(r"[^\W\d][^\s\"'\[\]{},=#]*")  # text that is no number, list or table


def parsed(text: str) -> tuple[str, Any]:
    """Parse `KEY=VALUE`; VALUE is as in a TOML file, but words need no quotes.

    >>> parsed("integrate.dt=[1e-3, 1e-4]"), parsed("integrate.cspace=reduced")
    (('integrate.dt', [0.001, 0.0001]), ('integrate.cspace', 'reduced'))

    Raises StudyError for what is neither.
    """
    key, equals, value = text.partition("=")
    if not equals:
        raise StudyError(f"{text!r} is no KEY=VALUE, such as integrate.dt=1e-4")
    path_of(key)
    return key.strip(), _value(key.strip(), value.strip())


def _value(key: str, text: str) -> Any:
    try:
        tables = tomllib.loads(f"value = {text}")
    except (ValueError, RecursionError) as error:
        if WORD.fullmatch(text):
            return text
        if re.fullmatch(r"\[[^\[\]\"'{}]*\]", text):  # possibly words: [SE3, reduced]
            return [_value(key, item.strip()) for item in text[1:-1].rstrip(" ,").split(",")]
        why = str(error).partition(" (at")[0]  # whose column counts from `value = `
        raise StudyError(f"{key}={text}: no value of TOML ({why}); text needs quotes") from None
    if tables.keys() != {"value"}:
        raise StudyError(f"{key}={text}: expected one value")
    return tables["value"]


def path_of(key: str) -> tuple[str, ...]:
    """Split a dotted key into its parts; a part that contains dots is in quotes."""
    inner: Any = {}
    with suppress(ValueError, RecursionError):
        inner = tomllib.loads(f"{key} = 0")
    path = []
    while isinstance(inner, dict) and len(inner) == 1:
        ((part, inner),) = inner.items()
        path.append(part)
    if not path or isinstance(inner, dict):
        raise StudyError(f"{key!r} is no key of a study, such as sample.n or integrate.dt")
    return tuple(path)


def applied(tables: dict[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return a study's tables with changes applied in their order.

    Raises StudyError where a key leads through what is no table.
    """
    changed = deepcopy(tables)
    for key, value in changes.items():
        *way, last = path_of(key)
        place: Any = changed
        for n, part in enumerate(way):
            if isinstance(place, dict):
                place.setdefault(part, {})
            place = place[_index(place, part, ".".join(way[:n]))]
            if not isinstance(place, (dict, list)):
                raise StudyError(f"{key}: {'.'.join(way[: n + 1])} is {place!r}, no table")
        place[_index(place, last, ".".join(way))] = deepcopy(value)
    return changed


def _index(place: dict[str, Any] | list[Any], part: str, of: str) -> Any:
    return index_of(place, part, of) if isinstance(place, list) else part


def index_of(items: Sequence[Any], part: str, of: str) -> int:
    """Return the index of an item by its number, name or type.   of : key of the list."""
    if part.isdecimal() and int(part) < len(items):
        return int(part)
    names = [label_of(x) if isinstance(x, dict) else str(n) for n, x in enumerate(items)]
    if part not in names:
        raise StudyError(f"{of}.{part}: there is none; known: {', '.join(names)}")
    return names.index(part)


def label_of(table: Mapping[str, Any]) -> str:
    """Return the name of a link, loop or element by its table; without one that of its type."""
    return str(table.get("name") or str(table.get("type")).rpartition(":")[2])


def written(changes: Mapping[str, Any]) -> list[str]:
    """Format changes as `parsed` reads them."""
    return [f"{key}={_toml(value)}" for key, value in changes.items()]


def _toml(value: Any) -> str:
    """Format a value as one line of TOML."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{_toml(k)} = {_toml(v)}" for k, v in value.items()) + "}"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(map(_toml, value)) + "]"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    return str(value).lower() if isinstance(value, bool) else str(value)
