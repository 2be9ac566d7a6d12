"""Collection of the warnings of many runs, for which a caller issues a single one."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

# A context variable: threads share the state of `warnings.catch_warnings`.
_are_collected: ContextVar[bool] = ContextVar("are_warnings_collected", default=False)


@contextmanager
def warnings_collected() -> Iterator[None]:
    """Suppress warnings of failures, stiff steps and switches; the caller issues one for all."""
    token = _are_collected.set(True)
    try:
        yield
    finally:
        _are_collected.reset(token)


def are_warnings_collected() -> bool:
    """Return whether the caller collects warnings."""
    return _are_collected.get()
