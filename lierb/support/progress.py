"""Progress of a run: a call of the user's function, or a bar on a terminal or in a notebook."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from lierb.errors import ArgumentError, brief
from lierb.support.extras import remedy

Progress = bool | Callable[[int, int], None] | None

BODY_STEPS = "body-steps"
QUIET_SECONDS = 2.0  # delay of a bar that was not requested
NOTEBOOK_SECONDS = 0.2  # between two updates


def check_progress(progress: Any) -> None:
    """Raise ArgumentError for a value that `reporter` does not accept."""
    if not (progress is None or isinstance(progress, bool) or callable(progress)):
        raise ArgumentError(f"progress={brief(progress)}; expected True, False, None or a function")


@contextmanager
def reporter(
    progress: Progress, total: int, of: str = BODY_STEPS
) -> Iterator[Callable[[int], None]]:
    """Yield a function that reports the amount of work done, out of `total`.

    progress : True for a bar at once, None for a bar after two seconds on a terminal or in a
        notebook, False for none, or a function of (done, total).
    of : unit of the work.
    """
    if callable(progress):
        yield lambda done: progress(done, total)
        return
    bar = _bar(total, of, required=progress is True) if progress is not False else None
    if bar is None:
        yield lambda done: None
        return
    shown_from = time.monotonic() + (0.0 if progress else QUIET_SECONDS)

    def report(done: int) -> None:
        if time.monotonic() >= shown_from:
            bar.show(done)

    try:
        yield report
    finally:
        bar.close()


def _bar(total: int, of: str, required: bool) -> NotebookBar | TerminalBar | None:
    """Return a bar for a notebook or a terminal, None elsewhere.

    Its first `show` draws it, and `close` removes it.
    """
    if _in_notebook():
        return NotebookBar(total, of)
    if not (required or _on_terminal()):
        return None
    try:
        return TerminalBar(total, of)
    except ImportError:
        if required:
            raise ArgumentError(f"progress=True needs rich: {remedy('cli')}") from None
        return None


def _on_terminal() -> bool:
    return sys.stderr is not None and sys.stderr.isatty()  # no console


def _in_notebook() -> bool:
    """Return whether a Jupyter kernel runs the process, not an IPython prompt in a terminal."""
    shell_of = getattr(sys.modules.get("IPython"), "get_ipython", None)
    return getattr(shell_of and shell_of(), "kernel", None) is not None


class TerminalBar:
    """This bar is shown on standard error, by rich. Raises ImportError without rich."""

    def __init__(self, total: int, of: str = BODY_STEPS) -> None:
        from rich import progress
        from rich.console import Console

        self._bar = progress.Progress(
            progress.TextColumn(of), progress.BarColumn(), progress.TaskProgressColumn(),
            progress.TextColumn("{task.fields[rate]}"), progress.TimeRemainingColumn(),
            console=Console(stderr=True), transient=True,
        )  # fmt: skip
        self._task = self._bar.add_task("", total=total, rate="")
        self._of = of

    def show(self, done: int) -> None:
        if not self._bar.live.is_started:
            self._bar.start()
        self._bar.update(self._task, completed=done)
        if self._of == BODY_STEPS and (speed := self._bar.tasks[0].speed):
            self._bar.update(self._task, rate=_rate(speed))

    def close(self) -> None:
        self._bar.stop()


class NotebookBar:
    """This bar is shown below a notebook's cell, by IPython, as rich needs ipywidgets there."""

    def __init__(self, total: int, of: str = BODY_STEPS) -> None:
        self._total, self._of = total, of
        self._handle: Any = None
        self._first = self._last = (0.0, 0)  # time, work done

    def show(self, done: int) -> None:
        from IPython.display import HTML, display

        now = time.monotonic()
        if self._handle is None:
            self._first = self._last = now, done
            self._handle = display(HTML(self._drawn(done, 0.0)), display_id=True)
        elif now - self._last[0] >= NOTEBOOK_SECONDS:
            self._last = now, done
            speed = (done - self._first[1]) / (now - self._first[0])
            self._handle.update(HTML(self._drawn(done, speed)))

    def close(self) -> None:
        from IPython.display import HTML

        if self._handle is not None:
            self._handle.update(HTML(""))

    def _drawn(self, done: int, speed: float) -> str:
        texts = [f"{self._of} {done / max(self._total, 1):.0%}"]
        if speed > 0.0:
            left = (self._total - done) / speed
            texts += [_rate(speed)] if self._of == BODY_STEPS else []
            texts += [f"{left // 60:.0f}:{left % 60:02.0f} left"]
        return f'<progress max="{self._total}" value="{done}"></progress> {" · ".join(texts)}'


def _rate(speed: float) -> str:
    return f"{speed / 1e6:.1f} M body-steps/s"
