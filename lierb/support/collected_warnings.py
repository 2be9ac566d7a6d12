"""Warnings that a caller of many runs collects, to issue one for all of them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

# A context variable, not `warnings.catch_warnings`, which threads share.
_are_collected: ContextVar[bool] = ContextVar("are_warnings_collected", default=False)


@contextmanager
def warnings_collected() -> Iterator[None]:
    """Suppress warnings of failures and stiff steps: the caller issues one for all runs."""
    token = _are_collected.set(True)
    try:
        yield
    finally:
        _are_collected.reset(token)


def are_warnings_collected() -> bool:
    """Return whether the caller collects warnings."""
    return _are_collected.get()
