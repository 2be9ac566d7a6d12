"""Code compiled once: by a thread of its own, with Python's garbage left lying meanwhile."""

from __future__ import annotations

import gc
import threading

import pytest

from lierb.compiler.code import run_uninterrupted


@pytest.fixture
def collecting():
    assert gc.isenabled()
    yield
    gc.enable()


def seen(*, fails=False):
    """(thread, whether garbage is collected) during uninterrupted work."""
    found = []

    def work():
        found.extend((threading.current_thread(), gc.isenabled()))
        if fails:
            raise ArithmeticError

    try:
        run_uninterrupted(work)
    except ArithmeticError:
        assert fails
    return found


@pytest.mark.parametrize("fails", [False, True])
def test_garbage_waits_until_work_is_done(collecting, fails):
    thread, collects = seen(fails=fails)
    assert thread is not threading.main_thread()
    assert not collects
    assert gc.isenabled()


def test_who_collects_no_garbage_is_not_made_to(collecting):
    gc.disable()
    assert not seen()[1]
    assert not gc.isenabled()


@pytest.mark.parametrize("fails", [False, True])
def test_work_is_done_here_where_no_thread_is_to_be_had(collecting, monkeypatch, fails):
    """Compilation in a handler of atexit, or beyond a limit of threads."""

    def none_left(thread):
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr(threading.Thread, "start", none_left)
    assert seen(fails=fails) == [threading.main_thread(), False]
    assert gc.isenabled()


def test_another_thread_does_its_work_itself(collecting):
    found = []
    worker = threading.Thread(target=lambda: found.extend((seen(), gc.isenabled())))
    worker.start()
    worker.join()
    assert found == [[worker, False], True]
