"""Warnings that a caller of many runs collects, to issue one for all of them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

_told_elsewhere: ContextVar[bool] = ContextVar("told_elsewhere", default=False)


@contextmanager
def told_elsewhere() -> Iterator[None]:
    """Suppress warnings of failures and stiff steps: the caller issues one for all runs."""
    token = _told_elsewhere.set(True)
    try:
        yield
    finally:
        _told_elsewhere.reset(token)


def is_told_elsewhere() -> bool:
    """Return whether the caller collects warnings."""
    return _told_elsewhere.get()
