"""Signals at a random time of a first call, while its kernels are compiled.

Ctrl-C, twice, a handler of SIGALRM that raises, and Ctrl-C while another thread compiles. What must
hold: the call ends in what the handler raised or in its result, and in nothing else; the next calls
in the process, of the same function and of another one, compile and give what they ought to; no
process hangs.
"""

from __future__ import annotations

import os
import random
import signal
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from faults.caches import COMPILED_IN, LIE, Cache, require_fall, require_lie
from faults.crash import Alone, in_child, told_with

# By weight: a first integration takes much longer than a first function of a group.
WAYS = {
    "Ctrl-C": 30, "two Ctrl-C": 15, "alarm": 15, "beside a thread": 15, "compiled before": 15,
    "integrate": 10,
}  # fmt: skip


class Alarm(Exception):
    """Exception of the handler of SIGALRM."""


class Interrupts(Alone):
    """Children that compile from nothing, in this process's state, with an empty cache."""

    full = 510

    def __init__(self, folder: Path) -> None:
        assert os.getpid() not in COMPILED_IN, "this process has compiled: interrupts come first"
        self.cache = Cache(folder)
        self.seconds: dict[str, float] = {}

    def trial(self, number: int, rng: random.Random) -> str:
        (way,) = rng.choices([*WAYS], [*WAYS.values()])
        name, other = rng.sample(sorted(LIE), 2)
        work: Callable[[], Any] = lambda: require_lie(name)
        if way == "integrate":
            work = require_fall
        third = rng.choice(sorted(LIE.keys() - {name, other}))
        before = [third] if way == "compiled before" else []
        whole = self._whole(way, name, before, work)
        times = sorted(rng.uniform(0.0, 1.1 * whole) for _ in range(1 + (way == "two Ctrl-C")))
        self.cache.clear()

        def interrupted() -> str:
            require_lie(*before)
            ended = _in_thread(work, times) if way == "beside a thread" else _sent(work, way, times)
            work()
            require_lie(name, other)
            return ended

        told = ", ".join(f"{t:.3f} s" for t in times)
        what = "a fall" if way == "integrate" else f"so3.{name}"
        with told_with(f"{what}, {way} at {told} of {whole:.3f} s"):
            return in_child(interrupted)

    def _whole(self, way: str, name: str, before: list[str], work: Callable[[], Any]) -> float:
        """Duration of the call without interruption, in s."""
        key = f"{name} {bool(before)}" if way != "integrate" else way

        def timed() -> float:
            require_lie(*before)
            began = time.perf_counter()
            work()
            return time.perf_counter() - began

        if key not in self.seconds:
            self.cache.clear()
            self.seconds[key] = in_child(timed)
        return self.seconds[key]


def _sent(work: Callable[[], Any], way: str, times: list[float]) -> str:
    """Outcome of work() with signals at these times, in s."""
    number = signal.SIGALRM if way == "alarm" else signal.SIGINT

    def ring(*_: Any) -> None:
        raise Alarm

    handler = ring if way == "alarm" else signal.default_int_handler
    bell = 0
    try:
        signal.signal(number, handler)
        bell = os.fork()
        if bell == 0:
            _ring(number, times)
        try:
            work()
            return "result"
        finally:
            signal.signal(number, signal.SIG_IGN)
    except (KeyboardInterrupt, Alarm):  # a second one, in the `finally`, leads here too
        signal.signal(number, signal.SIG_IGN)
        return "interrupted"
    finally:
        os.waitpid(bell, 0)


def _ring(number: int, times: list[float]) -> None:
    """Send the parent these signals, from a child process."""
    began = time.perf_counter()
    for seconds in times:
        time.sleep(max(0.0, began + seconds - time.perf_counter()))
        os.kill(os.getppid(), number)
    os._exit(0)


def _in_thread(work: Callable[[], Any], times: list[float]) -> str:
    """The main thread gets the signals while another one works, undisturbed."""
    raised: list[BaseException] = []

    def run() -> None:
        try:
            work()
        except BaseException as error:
            raised.append(error)

    thread = threading.Thread(target=run)

    def join() -> None:
        thread.start()
        thread.join()

    ended = _sent(join, "Ctrl-C", times)
    if thread.ident is not None:  # else it was not even started
        thread.join()
    assert not raised, repr(raised[0])
    return ended
