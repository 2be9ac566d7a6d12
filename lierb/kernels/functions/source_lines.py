"""Describe lines of users' source in messages."""

from __future__ import annotations

import linecache
import types
from collections.abc import Iterable
from traceback import walk_tb

from lierb.kernels.functions.shapes import UserFunction

MARK = "__lierb_traced__"  # global name in the copies of users' functions


def at(code: types.CodeType, line: int | None) -> str:
    """Describe a line by its number and text."""
    source = linecache.getline(code.co_filename, line or 0).strip()
    return f'line {line}, "{source}"' if source else f"line {line} of {code.co_name}"


def where_it_was(error: BaseException) -> str | None:
    """Describe the innermost line of users' functions in an exception's traceback, if any."""
    frames = walk_tb(error.__traceback__)
    lines = [at(frame.f_code, line) for frame, line in frames if MARK in frame.f_globals]
    return lines[-1] if lines else None


def line_that_raised(error: Exception, functions: Iterable[UserFunction]) -> str | None:
    """Describe the line of users' functions at which compiled code raised, if Numba reports it.

    Numba adds a frame with no other data of the function than its file and line.
    """
    *_, (frame, line) = walk_tb(error.__traceback__)
    files = {function.__code__.co_filename for function in functions}
    return at(frame.f_code, line) if frame.f_code.co_filename in files else None
