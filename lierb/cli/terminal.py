"""Print the output of commands: wide tables, and progress on standard error."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from rich.table import Table

INTERRUPTED = 130  # exit code 128 + SIGINT, as of shells


def print_whole(table: Table) -> None:
    """Print a table; a narrow window wraps its lines, but cuts no number."""
    from rich.console import Console

    console = Console(highlight=False, markup=False)  # names and units may have brackets
    wide = Console(width=1000, markup=False)
    console.width = max(console.width, wide.measure(table).maximum)
    console.print(table)


@contextmanager
def progress_of_cases() -> Iterator[Callable[[int, int, str], None]]:
    """Yield a progress bar on standard error, or lines where that is no terminal."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

    console = Console(stderr=True)
    if not console.is_terminal:
        yield _progress_lines()
        return
    columns = (BarColumn(), MofNCompleteColumn(), TextColumn("{task.description}"))
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("", total=None)

        def show(done: int, total: int, what: str) -> None:
            bar.update(task, completed=done, total=total, description=what)

        yield show


def _progress_lines() -> Callable[[int, int, str], None]:
    shown = ""

    def show(done: int, total: int, what: str) -> None:
        nonlocal shown
        topic = what.split(":")[0]
        if topic and topic != shown:
            click.echo(f"[{done}/{total}] {topic}", err=True)
        shown = topic

    return show


def wrapped(text: str) -> str:
    return textwrap.fill(text, width=80, subsequent_indent="  ")
