"""Progress of a run: to a function, a terminal, a notebook, or nowhere."""

from __future__ import annotations

import io
import re
import sys
from itertools import pairwise
from types import ModuleType, SimpleNamespace

import pytest
from cases import integrate, top
from studies import study

import lierb
from lierb.errors import ArgumentError
from lierb.runs import engine
from lierb.support import progress

STEPS = 6
TOTAL = 50 * 2 * (50 + 25)  # body-steps of the study: bodies, c-spaces, steps at either dt


class Notebook:
    """IPython as it is in a Jupyter kernel: what it shows, and what that becomes."""

    def __init__(self, shell=None):
        self.shown: list[str] = []
        self.shell = shell or SimpleNamespace(kernel=object())

    def get_ipython(self):
        return self.shell

    def install(self, monkeypatch):
        ipython, display = ModuleType("IPython"), ModuleType("IPython.display")
        ipython.get_ipython = self.get_ipython
        display.HTML = str
        display.display = self.display
        monkeypatch.setitem(sys.modules, "IPython", ipython)
        monkeypatch.setitem(sys.modules, "IPython.display", display)

    def display(self, html, display_id):
        assert display_id is True
        self.shown.append(html)
        return SimpleNamespace(update=self.shown.append)


class Terminal(io.StringIO):
    def isatty(self):
        return True


@pytest.fixture
def notebook(monkeypatch):
    found = Notebook()
    found.install(monkeypatch)
    return found


def terminal_in(monkeypatch):
    """No fixture: pytest puts its own stderr in place between those and the test."""
    pytest.importorskip("rich")
    found = Terminal()
    monkeypatch.setattr(sys, "stderr", found)
    monkeypatch.setenv("TERM", "xterm")
    return found


@pytest.fixture
def call_by_call(monkeypatch):
    """Let the driver make a call for every step, each of which is reported."""
    monkeypatch.setattr(engine, "CALL_SECONDS", 0.0)
    monkeypatch.setattr(engine, "FIRST_CALL_BLOCK_STEPS", 1)
    monkeypatch.setattr(progress, "NOTEBOOK_SECONDS", 0.0)


def run(**given):
    problem, twist0 = top()
    return integrate(problem, twist0=twist0, dt=1e-2, t_end=STEPS * 1e-2, **given)


def values(shown):
    return [int(re.search(r'max="6" value="(\d+)"', html)[1]) for html in shown]


# ---- notebooks ---------------------------------------------------------------------------------


@pytest.mark.usefixtures("call_by_call")
def test_a_notebook_shows_a_bar_and_removes_it(notebook, capfd):
    run(progress=True)
    *bars, last = notebook.shown
    assert values(bars) == [1, 2, 3, 4, 5, 6]
    assert "M body-steps/s" in bars[1]
    assert last == ""
    assert capfd.readouterr() == ("", "")


@pytest.mark.usefixtures("call_by_call")
def test_a_notebook_shows_a_bar_after_two_seconds(notebook, monkeypatch):
    seconds = iter(0.5 * k for k in range(100))  # one look at the clock as the run starts, …
    monkeypatch.setattr(progress.time, "monotonic", lambda: next(seconds))
    assert progress.QUIET_SECONDS == 2.0
    with progress.reporter(None, 6) as report:
        for done in range(1, 7):
            report(done)
    # … and one at each report, but two where a bar is drawn: at 2, 3 and 4 s
    assert values(notebook.shown[:-1]) == [4, 5, 6]


def test_a_short_run_shows_none_in_a_notebook(notebook):
    run()
    run(progress=False)
    assert notebook.shown == []


def test_a_notebook_that_is_interrupted_has_no_bar_left(notebook):
    def interrupted():
        with progress.reporter(True, 6) as report:
            report(1)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert notebook.shown[-1] == ""


def test_ipython_in_a_terminal_is_no_notebook(monkeypatch):
    prompt = Notebook(shell=SimpleNamespace())
    prompt.install(monkeypatch)
    with progress.reporter(None, 6) as report:
        report(1)
    assert prompt.shown == []
    assert not progress._in_notebook()


# ---- terminals ---------------------------------------------------------------------------------


@pytest.mark.usefixtures("call_by_call")
def test_a_terminal_shows_a_bar(monkeypatch):
    terminal = terminal_in(monkeypatch)
    run(progress=True)
    assert "body-steps" in terminal.getvalue()


def test_a_terminal_shows_none_of_a_short_run(monkeypatch):
    terminal = terminal_in(monkeypatch)
    run()
    run(progress=False)
    assert terminal.getvalue() == ""


def test_without_rich_a_bar_that_is_asked_for_is_missed(monkeypatch):
    monkeypatch.setitem(sys.modules, "rich.console", None)
    with pytest.raises(ArgumentError, match="needs rich"):
        run(progress=True)
    run()


# ---- studies -----------------------------------------------------------------------------------


def test_a_study_tells_a_function(tmp_path):
    told = []
    lierb.run(study(), tmp_path, progress=lambda *of: told.append(of))
    done, totals = zip(*told, strict=True)
    assert set(totals) == {TOTAL}
    assert all(a <= b for a, b in pairwise(done))
    assert done[-1] == TOTAL


@pytest.mark.parametrize("choice", [False, None])
def test_a_study_is_silent(choice, tmp_path, capfd):
    lierb.run(study(sample={"n": 3}), tmp_path, progress=choice)
    assert capfd.readouterr() == ("", "")


def test_a_study_shows_a_bar(tmp_path, monkeypatch):
    terminal = terminal_in(monkeypatch)
    lierb.run(study(sample={"n": 3}), tmp_path, progress=True)
    assert "body-steps" in terminal.getvalue()


def test_a_study_shows_a_bar_in_a_notebook(tmp_path, notebook):
    lierb.run(study(sample={"n": 3}), tmp_path, progress=True)
    assert "<progress" in notebook.shown[0]
    assert notebook.shown[-1] == ""


def test_another_progress_is_refused_before_anything_is_written(tmp_path):
    with pytest.raises(ArgumentError, match="progress='yes'"):
        lierb.run(study(), tmp_path / "out", progress="yes")
    assert not (tmp_path / "out").exists()
