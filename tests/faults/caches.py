"""The disk cache in known states, and compiled functions whose results are known by hand."""

from __future__ import annotations

import os
import shutil
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
import numpy as np

import lierb
from faults.crash import in_child


def cross(x: Any, y: Any) -> list[float]:
    return [x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0]]


X, Y = (1.0, 2.0, 3.0), (4.0, -5.0, 6.0)
TURN = ((0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0))  # about z by a right angle
QUARTER = (0.0, 0.0, 1.5707963267948966)

# Functions of SO(3), operands, and what they give by hand; all in one index of the cache.
LIE: dict[str, tuple[tuple[Any, ...], Any]] = {
    "ad": ((X, Y), cross(X, Y)),
    "dexp": ((QUARTER, (1.0, 0.0, 5.0)), (0.6366197723675814, 0.6366197723675814, 5.0)),  # 2/π
    "inverse": ((TURN,), [list(row) for row in zip(*TURN)]),
    "Ad": ((TURN, Y), (5.0, 4.0, 6.0)),
    "exp": ((QUARTER,), TURN),
    "compose": ((TURN, TURN), ((-1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, 1.0))),
    "log": ((TURN,), QUARTER),
    "dexpinv": ((QUARTER, (0.6366197723675814, 0.6366197723675814, 5.0)), (1.0, 0.0, 5.0)),
}


COMPILED_IN: set[int] = set()  # processes, and not those that are forked from them


def require_lie(*names: str, warned: int = 0) -> None:
    """These functions give what they ought to, with so many warnings at most, one after another."""
    COMPILED_IN.add(os.getpid())
    heard: list[str] = []
    for name in names:
        operands, expected = LIE[name]
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            found = getattr(lierb.lie.so3, name)(*operands)
        # a few roundings of numbers up to 30
        assert np.allclose(found, expected, rtol=0, atol=2e-14), f"so3.{name} gives {found}"
        heard += [str(warning.message) for warning in told]
    assert len(heard) <= warned, heard


def require_fall() -> None:
    """A free fall by Euler's method has the speed −g t, exact in binary."""
    body = lierb.Body(mass=2.0, inertia=(1.0, 1.0, 1.0))
    problem = lierb.Problem(body, lierb.joints.free(), gravity=(0.0, 0.0, -8.0))
    run = lierb.integrate(
        problem, twist0=[0.0] * 6, dt=0.25, t_end=1.0, method="Euler", threads=1, progress=False
    )
    speed = run.summary["v"][0].as_py()[2]
    assert speed == -8.0, f"a fall gives {speed}"


class Cache:
    """The folder of this process's disk cache, in several states."""

    def __init__(self, folder: Path) -> None:
        self.folder = Path(numba.config.CACHE_DIR)
        self.states = folder
        self.states.mkdir(parents=True)

    def clear(self, state: str | None = None) -> None:
        """Restore the cache folder stored under that name, or empty it."""
        shutil.rmtree(self.folder, ignore_errors=True)
        self.folder.mkdir(parents=True)
        if state is not None:
            shutil.copytree(self.states / state, self.folder, dirs_exist_ok=True)

    def keep(self, state: str) -> None:
        shutil.rmtree(self.states / state, ignore_errors=True)
        shutil.copytree(self.folder, self.states / state)

    def made(self, state: str, work: Callable[[], Any]) -> None:
        """A state, by what a child does with an empty cache."""
        self.clear()
        in_child(work)
        self.keep(state)

    @property
    def files(self) -> list[Path]:
        return sorted(p for p in self.folder.rglob("*") if p.is_file() and p.suffix != ".lock")
