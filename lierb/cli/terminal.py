"""What commands print: wide tables, progress on standard error."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from rich.table import Table

INTERRUPTED = 130  # 128 + SIGINT, as shells have it


def print_whole(table: Table) -> None:
    """In a window that is too narrow the lines wrap, but no number is cut."""
    from rich.console import Console

    console = Console(highlight=False)
    console.width = max(console.width, Console(width=1000).measure(table).maximum)
    console.print(table)


@contextmanager
def progress_of_cases() -> Iterator[Callable[[int, int, str], None]]:
    """A bar on standard error; where that is no terminal, a line for each joint or figure."""
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
