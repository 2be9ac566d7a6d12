"""Check for forked processes, which lack the threads of their parents."""

from __future__ import annotations

import os
from contextlib import suppress

import numba

from lierb.compiler.code import collect_again, is_compiling
from lierb.errors import ForkError

REMEDY = "start workers with multiprocessing.get_context('spawn')"

_lacks_threads = _lacks_compiler = False


def check_threads() -> None:
    """Raise ForkError if parallel loops cannot run.

    Call this before using locks: a forked child may have inherited them locked.
    """
    if _lacks_threads:
        raise ForkError(
            "this process was forked after Numba's threads had started in its parent, which it "
            f"lacks; {REMEDY}"
        )
    check_compiler(is_needed=True)


def check_compiler(is_needed: bool) -> None:
    """Raise ForkError if compilation is needed but impossible."""
    if _lacks_compiler and is_needed:
        raise ForkError(
            "this process lacks a thread of its parent that was compiling when it was forked; "
            f"{REMEDY}"
        )


def _after_fork() -> None:
    """Record in a forked child whether the parent had started threads or was compiling."""
    global _lacks_threads, _lacks_compiler
    _lacks_compiler |= is_compiling()
    collect_again()
    with suppress(ValueError):  # raised by Numba before its threads start
        numba.threading_layer()
        _lacks_threads = True


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_after_fork)
