"""Load the Python files of a study: `type = "python:FILE.py:NAME"`, FILE beside the study's file.

A study holds the texts of its files, not their paths: they are copied into the results, sent to the
workers of a cluster, and part of its digest. They are executed when the problem is made.
"""

from __future__ import annotations

import ast
import hashlib
import linecache
import re
import sys
import threading
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from traceback import walk_tb
from types import ModuleType
from typing import Any, NamedTuple

from lierb.errors import StudyError, brief
from lierb.kernels.functions.references import KNOWN
from lierb.kernels.functions.source_lines import at
from lierb.model.functions.constraints import ConstraintFunction
from lierb.model.functions.controllers import ControllerFunction
from lierb.model.functions.decorated import Decorated
from lierb.model.functions.events import EventFunction
from lierb.model.functions.observables import ObservableFunction
from lierb.model.functions.states import StatesFunction
from lierb.model.functions.wrenches import JumpingFunction
from lierb.studies.description.sources import LONGEST_STUDY, is_copied
from lierb.support.files import reason

PREFIX = "python:"
FILE = r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,95}\.py"
NAME = "[A-Za-z_][A-Za-z0-9_]{0,99}"
PATTERN = rf"^{PREFIX}{FILE}:{NAME}$"
EXPECTED = (
    '"python:FILE.py:NAME", FILE.py beside the study and NAME a function in it, both of the '
    "letters A to z, digits and _, the file also of . and -"
)
KINDS: dict[str, tuple[type[Decorated], str]] = {
    "forces": (JumpingFunction, "wrench, @lierb.variable_mass or @lierb.ground_motion"),
    "constraints": (ConstraintFunction, "constraint"),
    "observables": (ObservableFunction, "observable"),
    "events": (EventFunction, "event"),
    "states": (StatesFunction, "states"),
    "controllers": (ControllerFunction, "controller"),
}

Code = Mapping[str, str]  # the text of each file, by its name


class Named(NamedTuple):
    """File and name of a function that a type refers to."""

    file: str
    name: str


def named(kind: str) -> Named | None:
    """Parse a type that refers to a file; None for another type."""
    if not re.fullmatch(PATTERN, kind):
        return None
    return Named(*kind.removeprefix(PREFIX).split(":"))


def sha256_of_text(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


# ---- reading -----------------------------------------------------------------------------------


def read_code(folder: Path, files: Iterable[str]) -> dict[str, str]:
    """Read Python files of a folder. Raises StudyError, also for links that lead out of it."""
    return {file: _text_of(folder, file) for file in sorted(set(files))}


def _text_of(folder: Path, file: str) -> str:
    path = folder / file
    try:
        if not path.resolve().is_relative_to(folder.resolve()):
            raise StudyError(
                f"{file} is a link to {path.resolve()}; nothing outside the study's folder is run: "
                "put the file itself there"
            )
        if path.exists() and not path.is_file():
            raise StudyError(f"{path} is not a file")
        with path.open("rb") as opened:
            content = opened.read(LONGEST_STUDY + 1)
    except FileNotFoundError:
        if is_copied(folder):
            raise StudyError(
                f"{file} cannot be found: a study from standard input or a pipe has no folder; "
                "save it in the folder of its Python files, and give its path"
            ) from None
        raise StudyError(
            f"{file} is not in {folder.resolve()}, beside the study, which names it; put it there"
        ) from None
    except OSError as error:
        raise StudyError(f"{path} cannot be read: {reason(error)}") from error
    if len(content) > LONGEST_STUDY:
        raise StudyError(f"{path} is larger than {LONGEST_STUDY // 2**20} MiB")
    try:
        text = content.decode()
    except UnicodeDecodeError as error:
        raise StudyError(f"{path} is not UTF-8 ({error.reason}); save it as UTF-8") from None
    _require_alone(_parsed(file, text), file, folder)
    return text


def _parsed(file: str, text: str) -> ast.Module:
    try:
        return ast.parse(text.removeprefix("\ufeff"), file)  # Python skips a byte-order mark
    except (SyntaxError, ValueError, RecursionError) as error:
        line = getattr(error, "lineno", None)
        raise StudyError(
            f"{file}{f':{line}' if line else ''}: {getattr(error, 'msg', error)}"
        ) from None


def _require_alone(tree: ast.Module, file: str, folder: Path) -> None:
    """Raise StudyError for imports of files beside this one, which are not copied with it."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            names = ["." * node.level + (node.module or "")]
        else:
            continue
        for name in names:
            top = name.split(".")[0]
            lies_there = (folder / f"{top}.py").exists() or (folder / top).is_dir()
            if not top or (lies_there and top not in KNOWN):
                raise StudyError(
                    f"{file}:{node.lineno}: it imports {name}, which lies beside it; a study's "
                    "file stands alone: have what it needs in one file, or in an installed package"
                )


# ---- running -----------------------------------------------------------------------------------

_modules: dict[str, ModuleType] = {}
_texts: dict[str, tuple[str, str]] = {}  # file name and text, by the file name in its code objects
_lock = threading.RLock()
_loading: ContextVar[str] = ContextVar("loading", default="")


def is_loading() -> str:
    """Name of the file that is being executed for a study; "" if none is."""
    return _loading.get()


def module_of(file: str, text: str) -> ModuleType:
    """Execute a file, once in a process for each text; return its module."""
    digest = sha256_of_text(text)[:16]
    stem = re.sub(r"\W", "_", Path(file).stem)
    name, place = f"study_code_{stem}_{digest}", f"<{file} of a study, {digest}>"
    with _lock:
        if name not in _modules:
            lines = text.splitlines(keepends=True)
            linecache.cache[place] = (len(text), None, lines, place)  # source lines of tracebacks
            _texts[place] = file, text
            module = sys.modules[name] = ModuleType(name)
            try:
                with _running(file):
                    code = compile(_parsed(file, text), place, "exec", dont_inherit=True)
                    exec(code, vars(module))
            except BaseException:
                del sys.modules[name]
                raise
            _modules[name] = module
        return _modules[name]


@contextmanager
def _running(file: str) -> Iterator[None]:
    """Context that turns an exception of the file into a StudyError."""
    token = _loading.set(file)
    try:
        yield
    except StudyError:
        raise
    except (Exception, SystemExit) as error:
        line = _line_of(error, f"<{file} of a study, ")
        where = f"{file}: {line}" if line else file
        raise StudyError(f"{where}: {type(error).__name__}: {brief(str(error))}") from error
    finally:
        _loading.reset(token)


def _line_of(error: BaseException, place: str) -> str:
    """Innermost line of a file that an exception has passed; "" if there is none."""
    line = ""
    for frame, number in walk_tb(error.__traceback__):
        if frame.f_code.co_filename.startswith(place):
            line = at(frame.f_code, number)
    return line


def function_of(table: str, kind: str, code: Code) -> Any:
    """Return the decorated function that a type of a table of the problem refers to.

    table : of KINDS.   Raises StudyError.
    """
    there = named(kind)
    if there is None:
        raise StudyError(f"problem.{table}: type = {brief(kind)}; expected {EXPECTED}")
    if there.file not in code:
        raise StudyError(
            f"problem.{table}: {kind}: this study has no {there.file}, since it was made without a "
            "folder; use lierb.Study.load, or lierb.Study.of(…, folder=…)"
        )
    function = getattr(module_of(there.file, code[there.file]), there.name, None)
    expected, decorator = KINDS[table]
    if function is None:
        raise StudyError(f"problem.{table}: {there.file} defines no {there.name}")
    if not isinstance(function, expected):
        raise StudyError(
            f"problem.{table}: {there.name} in {there.file} is {brief(function)}; expected a "
            f"function with @lierb.{decorator} before it"
        )
    return function


def source_of(decorated: Decorated) -> tuple[str, str, str]:
    """Return file, text and name of a function that was defined in Python.

    Raises StudyError for one that no file has for others to load.
    """
    function = decorated.function
    code = function.__code__
    if function.__qualname__ != function.__name__ or not function.__name__.isidentifier():
        raise StudyError(
            f"{function.__qualname__} is defined inside another function; a study needs it at the "
            "top of a file, so that it can be loaded again: what differs is a parameter"
        )
    if code.co_filename in _texts:
        return *_texts[code.co_filename], function.__name__
    path = Path(code.co_filename)
    if not path.is_file():
        raise StudyError(
            f"{function.__name__} is defined in {brief(code.co_filename)}, from where it cannot be "
            "loaded again; write it in a file NAME.py, and import it from there (in a notebook: "
            "%%writefile NAME.py)"
        )
    for name, form in ((path.name, FILE), (function.__name__, NAME)):
        if not re.fullmatch(form, name):
            raise StudyError(
                f"{function.__name__} is defined in {brief(path.name)}; a study names functions "
                f"as {EXPECTED}; rename {name}"
            )
    return path.name, _text_of(path.parent, path.name), function.__name__
