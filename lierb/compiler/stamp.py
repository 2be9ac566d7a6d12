"""Compute the digest of the sources of compiled code, without parts that do not change code.

A kernel's code depends on the module of its function, the modules of its tag's classes, and all
modules of lierb that these import. The digest covers their syntax trees, without comments,
docstrings and line numbers. Hence every edit of code in these modules recompiles the kernel; an
edit of a docstring or of another module does not.
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
ANYTHING = "*"  # imports of a module that may import any module
IMPORTERS = {"importlib", "pkgutil"}  # they import by names computed at run time

_parsing = Lock()  # concurrent parsing fails in Python 3.11 (gh-106905)


def _read(folder: str, package: str) -> Iterator[tuple[str, bytes]]:
    """Yield (module, source) for the files in a folder and its subfolders."""
    with os.scandir(folder) as entries:
        for entry in entries:
            module = entry.name.removesuffix(".py")
            if module != entry.name:
                name = package if module == "__init__" else f"{package}.{module}"
                with suppress(OSError), open(entry.path, "rb", buffering=0) as file:  # noqa: PTH123
                    yield name, file.read()  # takes half the time of a Path
            elif module != "__pycache__" and entry.is_dir():
                yield from _read(entry.path, f"{package}.{module}")


# Read at import: a file may change after this process has imported it.
SOURCES = dict(_read(str(Path(__file__).parents[1]), PACKAGE))


@cache
def source_stamp(*modules: str) -> str:
    """Return a digest of the sources of these modules' code and of the compiler's versions."""
    versions = numba.__version__, llvmlite.__version__, np.__version__  # NumPy computes constants
    described = repr((versions, sorted(parts(*modules).items())))
    return hashlib.sha256(described.encode()).hexdigest()[:16]


def parts(*modules: str) -> dict[str, str]:
    """Return digests of the syntax trees of these modules and all that they import, by name."""
    _recall()
    known, trees, ahead = len(_trees), {}, list(modules)
    while ahead:
        module = ahead.pop()
        if module not in trees:
            trees[module], names = _tree_of(module)
            for name in names:
                ahead += SOURCES if name == ANYTHING else _modules_of(name)
    if len(_trees) > known:
        _remember()
    return trees


def _modules_of(name: str) -> list[str]:
    """Return the modules that an import of a name runs: the name's module and its parent packages.

    lierb/__init__.py, which imports all of lierb, counts only if no other module has the name.
    """
    words = name.split(".")
    candidates = [".".join(words[:n]) for n in range(1, len(words) + 1)]
    candidates = [module for module in candidates if module in SOURCES]
    return candidates[1:] or candidates


# ---- syntax trees ------------------------------------------------------------------------------

Tree = tuple[str, list[str]]  # digest of a syntax tree, names that it imports from lierb


@cache
def _tree_of(module: str) -> Tree:
    source = SOURCES.get(module)
    if source is None:  # not a module of lierb
        try:
            source = Path(str(sys.modules[module].__file__)).read_bytes()
        except (KeyError, AttributeError, OSError):  # typed at a prompt
            return "", [ANYTHING]
    digest = hashlib.sha256(source).hexdigest()
    if digest not in _trees:
        _trees[digest] = described(source)
    return _trees[digest]


def described(source: bytes) -> Tree:
    """Return the digest of a source's syntax tree, and the names that it imports from lierb."""
    imports: list[ast.Import | ast.ImportFrom] = []
    with _parsing:
        tree = ast.parse(source)
    plain = _plain(tree, imports)
    names = sorted({name for node in imports for name in _names(node)})
    return hashlib.sha256(repr(plain).encode()).hexdigest(), names


def _plain(node: Any, imports: list[Any]) -> Any:
    """Convert a syntax tree to nested lists, equal in all versions of Python; fill `imports`.

    The lists omit docstrings (strings as statements), empty fields, which older versions may lack,
    and contexts, which follow from the rest.
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
    """Yield the names that a statement imports from lierb."""
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


# ---- syntax trees on the disk, by the digests of their sources ---------------------------------

MOST_TREES = 256
SUFFIX = ".trees"
FILE = f"{sys.implementation.cache_tag}{SUFFIX}"
# The key changes with this module, whose functions digest the trees.
KEY = hashlib.sha256(SOURCES.get(__name__, b"")).hexdigest()
_trees: dict[str, Tree] = {}


@cache
def _recall() -> None:
    """Load stored syntax trees; to parse all of lierb takes half a second."""
    for folder in sealed.folders_of(described):
        with suppress(OSError, ValueError):
            _trees.update(json.loads(sealed.read(folder / FILE, KEY) or "{}"))


def _remember() -> None:
    content = json.dumps(dict(list(_trees.items())[-MOST_TREES:])).encode()
    for folder in sealed.folders_of(described):
        with suppress(OSError):
            sealed.write(folder / FILE, KEY, content)
            return


def files() -> Iterator[Path]:
    """Yield the files with stored syntax trees, of any version, and unfinished ones."""
    for folder in sealed.folders_of(described):
        yield from folder.glob(f"*{SUFFIX}*")
