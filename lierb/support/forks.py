"""What a forked process lacks: the threads of its parent, and what they were about to do."""

from __future__ import annotations

import os
from contextlib import suppress

import numba

from lierb.compiler.code import collect_again, is_compiling
from lierb.errors import ForkError

REMEDY = "start workers with multiprocessing.get_context('spawn')"

_lacks_threads = _lacks_compiler = False


def check_threads() -> None:
    """Raise ForkError where no parallel loop can run.

    Before any lock is taken: a forked child may have inherited it locked.
    """
    if _lacks_threads:
        raise ForkError(
            "this process was forked after Numba's threads had started in its parent, which it "
            f"lacks; {REMEDY}"
        )
    check_compiler(is_needed=True)


def check_compiler(is_needed: bool) -> None:
    """Raise ForkError where nothing can be compiled any more, if something has to be."""
    if _lacks_compiler and is_needed:
        raise ForkError(
            "this process was forked while a thread of its parent was compiling, which it lacks; "
            f"{REMEDY}"
        )


def _after_fork() -> None:
    """In a forked child: what the parent had started, lierb or anybody."""
    global _lacks_threads, _lacks_compiler
    _lacks_compiler |= is_compiling()
    collect_again()
    with suppress(ValueError):  # what Numba raises before its threads have started
        numba.threading_layer()
        _lacks_threads = True


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_after_fork)
