"""Digest of the sources of compiled code, without the parts that do not change code.

Code is made of the module that its function is written in, of those that its tag's classes are
written in, and of all modules of lierb that these import. What counts of each is its syntax tree,
without comments, docstrings and places: an edit of any of them is never missed, and a new docstring
or another file's edit compiles nothing anew.
"""

from __future__ import annotations

import ast
import hashlib
import json
import os
import sys
from collections.abc import Iterator
from contextlib import suppress
from functools import cache
from pathlib import Path
from threading import Lock
from typing import Any

import llvmlite
import numba
import numpy as np

from lierb.compiler import sealed

PACKAGE = "lierb"
ANYTHING = "*"  # imported by what may import whatever there is
IMPORTERS = {"importlib", "pkgutil"}  # by names that are made at run time

_parsing = Lock()  # of two threads that parse at once, Python 3.11 fails one (gh-106905)


def _read(folder: str, package: str) -> Iterator[tuple[str, bytes]]:
    """The sources in a folder and below, by their modules' names."""
    with os.scandir(folder) as entries:
        for entry in entries:
            module = entry.name.removesuffix(".py")
            if module != entry.name:
                name = package if module == "__init__" else f"{package}.{module}"
                with suppress(OSError), open(entry.path, "rb", buffering=0) as file:  # noqa: PTH123
                    yield name, file.read()  # in half the time that a Path takes
            elif module != "__pycache__" and entry.is_dir():
                yield from _read(entry.path, f"{package}.{module}")


# Now: later, a file may differ from what this process has imported.
SOURCES = dict(_read(str(Path(__file__).parents[1]), PACKAGE))


@cache
def source_stamp(*modules: str) -> str:
    """Digest of all that code from these modules is made of, and of what compiles it."""
    versions = numba.__version__, llvmlite.__version__, np.__version__  # it computes constants
    described = repr((versions, sorted(parts(*modules).items())))
    return hashlib.sha256(described.encode()).hexdigest()[:16]


def parts(*modules: str) -> dict[str, str]:
    """The modules that code from these is made of, and the digests of their syntax trees."""
    _recall()
    known, found, ahead = len(_trees), {}, list(modules)
    while ahead:
        module = ahead.pop()
        if module not in found:
            found[module], names = _tree_of(module)
            for name in names:
                ahead += SOURCES if name == ANYTHING else _modules_of(name)
    if len(_trees) > known:
        _remember()
    return found


def _modules_of(name: str) -> list[str]:
    """Modules that an import of a name runs: the module that has it, the packages around it.

    Not lierb/__init__.py, whose imports are all of lierb, unless the name is in no other.
    """
    words = name.split(".")
    found = [".".join(words[:n]) for n in range(1, len(words) + 1)]
    found = [module for module in found if module in SOURCES]
    return found[1:] or found


# ---- syntax trees ------------------------------------------------------------------------------

Tree = tuple[str, list[str]]  # its digest, and the names that the module imports of lierb


@cache
def _tree_of(module: str) -> Tree:
    source = SOURCES.get(module)
    if source is None:  # not lierb's
        try:
            source = Path(str(sys.modules[module].__file__)).read_bytes()
        except (KeyError, AttributeError, OSError):  # typed at a prompt
            return "", [ANYTHING]
    digest = hashlib.sha256(source).hexdigest()
    if digest not in _trees:
        _trees[digest] = described(source)
    return _trees[digest]


def described(source: bytes) -> Tree:
    """The syntax tree of a module's source."""
    imports: list[ast.Import | ast.ImportFrom] = []
    with _parsing:
        tree = ast.parse(source)
    plain = _plain(tree, imports)
    names = sorted({name for node in imports for name in _names(node)})
    return hashlib.sha256(repr(plain).encode()).hexdigest(), names


def _plain(node: Any, imports: list[Any]) -> Any:
    """A syntax tree as nested lists, the same by every version of Python; fills `imports`.

    Left out are docstrings (strings that stand for themselves), what is empty, which older versions
    may not know, and contexts, which follow from the rest.
    """
    if isinstance(node, list):
        return [_plain(x, imports) for x in node if not _is_docstring(x)]
    if not isinstance(node, ast.AST):
        return node
    if isinstance(node, (ast.Import, ast.ImportFrom)):
        imports.append(node)
    held: list[Any] = [type(node).__name__]
    for name in node._fields:
        x = getattr(node, name, None)
        if x is not None and x != [] and name != "ctx":
            held += name, _plain(x, imports)
    return held


def _is_docstring(node: Any) -> bool:
    text = node.value if isinstance(node, ast.Expr) else None
    return isinstance(text, ast.Constant) and isinstance(text.value, str)


def _names(node: ast.Import | ast.ImportFrom) -> Iterator[str]:
    """Names of lierb that one statement imports."""
    prefix, is_relative = "", False
    if isinstance(node, ast.ImportFrom):
        prefix, is_relative = f"{node.module}.", node.level > 0
    for alias in node.names:
        name = f"{prefix}{alias.name}"
        package = name.split(".")[0]
        if is_relative or package in IMPORTERS:
            yield ANYTHING
        elif package == PACKAGE:
            yield name


# ---- trees known before, by the digests of their sources ---------------------------------------

MOST_TREES = 256
SUFFIX = ".trees"
FILE = f"{sys.implementation.cache_tag}{SUFFIX}"
# And of what has made them.
KEY = hashlib.sha256(SOURCES.get(__name__, b"")).hexdigest()
_trees: dict[str, Tree] = {}


@cache
def _recall() -> None:
    """Have those that some process has made before: they take half a second for all of lierb."""
    for folder in sealed.folders_of(described):
        with suppress(OSError, ValueError):
            _trees.update(json.loads(sealed.read(folder / FILE, KEY) or "{}"))


def _remember() -> None:
    content = json.dumps(dict(list(_trees.items())[-MOST_TREES:])).encode()
    for folder in sealed.folders_of(described):
        with suppress(OSError):
            sealed.write(folder / FILE, KEY, content)
            return


def forget() -> None:
    """Delete them."""
    for folder in sealed.folders_of(described):
        for path in folder.glob(f"*{SUFFIX}*"):
            path.unlink(missing_ok=True)
