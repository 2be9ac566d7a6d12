"""Crash points: the calls by which a process changes files, numbered, and faults at one of them.

A run without a fault counts its points (`points_of`). A fault at point k is then set up in a child,
forked from a process that has imported lierb and started none of Numba's threads.
"""

from __future__ import annotations

import builtins
import errno
import faulthandler
import io
import multiprocessing
import os
import signal
import stat
import tempfile
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

HANG_SECONDS = 120.0

# ---- children ----------------------------------------------------------------------------------


class Died(AssertionError):
    """A child that hangs, exit status None, or ended without an answer."""

    def __init__(self, told: str, status: int | None = None) -> None:
        super().__init__(told)
        self.status = status


class Child:
    """A forked process that answers requests with `answer(request)`, one at a time."""

    alive: ClassVar[set[Child]] = set()

    def __init__(self, answer: Callable[[Any], Any]) -> None:
        self.said = tempfile.TemporaryFile("w+")  # noqa: SIM115  # its output, closed by `end`
        context = multiprocessing.get_context("fork")
        self.pipe, theirs = context.Pipe()
        self.process = context.Process(target=self._serve, args=(answer, theirs))
        self.process.start()
        self.alive.add(self)
        theirs.close()

    def _serve(self, answer: Callable[[Any], Any], pipe: Any) -> None:
        os.setsid()  # Ctrl-C at the campaign's terminal is not for it
        self.pipe.close()
        for stream in (1, 2):
            os.dup2(self.said.fileno(), stream)
        while True:
            try:
                request = pipe.recv()
            except EOFError:
                return
            faulthandler.dump_traceback_later(HANG_SECONDS - 5.0, file=self.said)
            try:
                pipe.send((answer(request), None))
            except AssertionError as error:
                pipe.send((None, str(error)))
            except BaseException:
                pipe.send((None, traceback.format_exc()))
            faulthandler.cancel_dump_traceback_later()

    def ask(self, request: Any = None) -> Any:
        """The answer. Raises Died for a child that died or hangs, AssertionError if it raised."""
        self.pipe.send(request)
        if not self.pipe.poll(HANG_SECONDS):
            self.end()
            raise Died(f"hangs after {HANG_SECONDS:g} s:\n{self.output}")
        try:
            value, raised = self.pipe.recv()
        except (EOFError, ConnectionResetError):
            self.process.join()
            status = self.process.exitcode
            self.end()
            raise Died(f"ended with {status}:\n{self.output}", status) from None
        assert raised is None, raised
        return value

    def dismiss(self) -> None:
        """Let it end by itself. Raises Died if it does not, or not well."""
        self.pipe.close()
        self.process.join(HANG_SECONDS)
        status = self.process.exitcode
        self.end()
        if status != 0:
            raise Died(f"its work done, ended with {status}:\n{self.output}", status)

    def end(self) -> None:
        """End it, and whatever it has started."""
        self.alive.discard(self)
        self.pipe.close()
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(self.process.pid, signal.SIGKILL)
        self.process.kill()
        self.process.join()
        if not self.said.closed:
            self.said.seek(0)
            self.output = self.said.read()[-3000:]
            self.said.close()


def in_child(work: Callable[[], Any]) -> Any:
    """Result of work(), called in a child process."""
    child = Child(lambda _: work())
    try:
        value = child.ask()
        child.dismiss()
        return value
    finally:
        child.end()


def killed_in_child(work: Callable[[], Any]) -> bool:
    """Return whether a child is killed during work(), as it should be."""
    try:
        in_child(work)
    except Died as died:
        if died.status != -signal.SIGKILL:
            raise
        return True
    return False


@contextmanager
def told_with(what: str) -> Iterator[None]:
    """Report a failure with its input."""
    try:
        yield
    except AssertionError as error:
        raise AssertionError(f"{what}: {error}") from None


class Alone:
    """Trials each of whose processes has ended when it has."""

    def end(self) -> None:
        pass


class Serving:
    """Trials in a child that goes on to the next one: for those that change no process."""

    recycled = 200  # trials of a child

    def __init__(self) -> None:
        self.child: Child | None = None
        self.asked = 0

    def answer(self, request: Any) -> Any:
        """Run in the child process."""
        raise NotImplementedError

    def ask(self, request: Any) -> Any:
        if self.child is None or self.asked >= self.recycled:
            self.end()
            self.child, self.asked = Child(self.answer), 0
        self.asked += 1
        try:
            return self.child.ask(request)
        except Died:
            self.child = None
            raise

    def end(self) -> None:
        if self.child is not None:
            self.child.end()
            self.child = None


# ---- points ------------------------------------------------------------------------------------

Fault = Callable[["Points", str, str], None]
WRITES = frozenset(("open", "write", "half", "fsync", "mkdir"))  # what a full disk refuses


class Points:
    """The crash points of this process below a folder, from now on and for good.

    fault : called as fault(points, call, path) at each point from number `at` on.
    """

    def __init__(self, folder: Path, at: int | None = None, fault: Fault | None = None) -> None:
        self.folder, self.at, self.fault = os.path.realpath(folder), at, fault
        self.passed: list[bool] = []  # whether something written was not synced then
        self.unsynced: set[tuple[int, int]] = set()  # device and inode
        self._patch()

    def reach(self, call: str, path: Any) -> None:
        number = len(self.passed)
        self.passed.append(bool(self.unsynced))
        if self.fault is not None and self.at is not None and number >= self.at:
            self.fault(self, call, os.fsdecode(path))

    def _is_ours(self, path: Any) -> bool:
        if isinstance(path, int):
            return stat.S_ISREG(os.fstat(path).st_mode)
        real = os.path.realpath(os.fsdecode(path))
        return real == self.folder or real.startswith(self.folder + os.sep)

    def _patch(self) -> None:
        for name in ("rename", "replace", "unlink", "remove", "mkdir", "rmdir", "link", "truncate"):
            setattr(os, name, self._numbered(name, getattr(os, name)))
        os.open = self._opened_low(os.open)
        os.write = self._written_low(os.write)
        os.fsync = self._synced(os.fsync)
        io.open = builtins.open = self._opened(io.open)

    def _numbered(self, name: str, call: Callable) -> Callable:
        def numbered(path: Any, *args: Any, **options: Any) -> Any:
            # below an open folder (shutil.rmtree) there is no path to tell whose it is
            if options.get("dir_fd") is None and self._is_ours(path):
                self.reach(name, path)
            return call(path, *args, **options)

        return numbered

    def _opened_low(self, call: Callable) -> Callable:
        def opened(path: Any, flags: int, *args: Any, **options: Any) -> int:
            writes = flags & (os.O_CREAT | os.O_WRONLY | os.O_RDWR)
            if writes and options.get("dir_fd") is None and self._is_ours(path):
                self.reach("open", path)
            return call(path, flags, *args, **options)

        return opened

    def _written_low(self, call: Callable) -> Callable:
        def written(handle: int, content: Any) -> int:
            return self.write(call, handle, content)

        return written

    def write(self, call: Callable, handle: int, content: Any) -> int:
        """Write in two halves, with a crash point before each."""
        if not self._is_ours(handle):
            return call(handle, content)
        status = os.fstat(handle)
        self.unsynced.add((status.st_dev, status.st_ino))
        view = memoryview(content).cast("B")
        self.reach("write", f"{handle}")
        done = call(handle, view[: len(view) // 2])
        self.reach("half", f"{handle}")
        return done + call(handle, view[len(view) // 2 :])

    def _synced(self, call: Callable) -> Callable:
        def synced(handle: Any) -> None:
            status = os.fstat(handle if isinstance(handle, int) else handle.fileno())
            self.reach("fsync", f"{handle}")
            call(handle)
            self.unsynced.discard((status.st_dev, status.st_ino))

        return synced

    def _opened(self, call: Callable) -> Callable:
        points = self

        class Raw(io.FileIO):
            def write(self, content: Any) -> int:
                plain = super().write
                return points.write(lambda _, part: plain(part), self.fileno(), content)

        def opened(
            file: Any, mode: str = "r", buffering: int = -1, encoding: str | None = None,
            errors: str | None = None, newline: str | None = None, closefd: bool = True,
            opener: Any = None,
        ) -> Any:  # fmt: skip
            if not set(mode) & set("wax+") or not self._is_ours(file):
                return call(file, mode, buffering, encoding, errors, newline, closefd, opener)
            if not isinstance(file, int):
                self.reach("open", file)
            raw = Raw(file, mode.replace("b", "").replace("t", ""), closefd, opener)
            if buffering == 0:
                return raw
            binary = io.BufferedRandom(raw) if "+" in mode else io.BufferedWriter(raw)
            if "b" in mode:
                return binary
            return io.TextIOWrapper(binary, encoding or "utf-8", errors, newline)

        return opened


def points_of(work: Callable[[], Any], folder: Path) -> list[bool]:
    """The points that work() passes below a folder: whether something was not synced at each."""

    def counted() -> list[bool]:
        points = Points(folder)
        work()
        return points.passed

    return in_child(counted)


# ---- faults ------------------------------------------------------------------------------------


def killed(points: Points, call: str, path: str) -> None:
    os.kill(os.getpid(), signal.SIGKILL)


_truncate = os.truncate  # not a point of its own


def power_lost(points: Points, call: str, path: str) -> None:
    """Killed, and files that were written and not synced are empty, as ext4 and xfs leave them."""
    for file in _unsynced(points):
        _truncate(file, 0)
    killed(points, call, path)


def torn(points: Points, call: str, path: str) -> None:
    """Killed, and the second half of what was not synced is zeros: not all blocks were written."""
    for file in _unsynced(points):
        size = file.stat().st_size
        _truncate(file, size // 2)
        _truncate(file, size)
    killed(points, call, path)


def _unsynced(points: Points) -> Iterator[Path]:
    """Files by their current names."""
    for file in Path(points.folder).rglob("*"):
        status = file.lstat()
        if (status.st_dev, status.st_ino) in points.unsynced:
            yield file


@dataclass(frozen=True)
class Refused:
    """Everything that needs room fails from the point on: a full disk, a quota, a broken one."""

    number: int

    def __call__(self, points: Points, call: str, path: str) -> None:
        if call in WRITES:
            named = (path,) if call in ("open", "mkdir") else ()  # as the system does it
            raise OSError(self.number, os.strerror(self.number), *named)


def ends_at(point: bool) -> tuple[str, ...]:
    """The ways to end there that leave different files behind."""
    return tuple(ENDS) if point else ("killed",)


ENDS: dict[str, Fault] = {"killed": killed, "power lost": power_lost, "torn": torn}
REFUSALS: dict[str, Fault] = {
    name: Refused(getattr(errno, name))
    for name in ("ENOSPC", "EDQUOT", "EIO", "EROFS")
    if hasattr(errno, name)
}
