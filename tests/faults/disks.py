"""Disks that are full, over quota, read-only or broken, from one call on or by a limit on files.

What must hold: a study's run ends with one sentence that names its folder, and, with parts done,
`--resume`, which leads to the bytes of a run without faults; a function whose code cannot be cached
gives its result, with one warning at most, and so do the processes after it.
"""

from __future__ import annotations

import random
import resource
from functools import partial
from pathlib import Path

from faults.caches import Cache, require_lie
from faults.crash import REFUSALS, Alone, Points, in_child, points_of, told_with
from faults.folders import Ended, Space
from faults.kills import shuffled

LIMIT = "RLIMIT_FSIZE"
LIMITS = (0, 1, 300, 1500, 3000, 6000, 12_000)  # bytes of a file, by the system's own limit


class StudyDisks(Alone):
    """Runs of studies."""

    def __init__(self, folder: Path) -> None:
        self.space = Space(folder)
        places: list[tuple[str, int, str]] = []
        for study in ("summary", "history"):
            self.space.whole(study)
            self.space.clear(decoys=())
            passed = points_of(partial(self.space.run, study), self.space.out)
            places += [(study, at, why) for at in range(len(passed)) for why in whys(at)]
            places += [(study, limit, LIMIT) for limit in LIMITS]
        self.places = shuffled(places)
        self.full = len(places)

    def trial(self, number: int, rng: random.Random) -> str:
        study, at, why = self.places[number % self.full]
        with told_with(f"{study}, {why} from point or size {at}"):
            return self._run(study, at, why)

    def _run(self, study: str, at: int, why: str) -> str:
        space = self.space
        space.clear()

        def run() -> Ended:
            refuse(space.out, at, why)
            return space.run(study)

        ended = in_child(run).required_clear()
        space.require_decoys()
        if ended.status:
            assert str(space.out) in ended.output, f"names no folder: {ended.output}"
            done = list(space.out.glob("summary/part-*.parquet"))
            assert not done or "--resume" in ended.output, f"says no --resume: {ended.output}"
        again = in_child(partial(space.run, study)).required_clear()
        assert again.status == 0, again.output
        space.require_whole(study)
        return "told, resumed" if ended.status else "ran to its end"


class CacheDisks(Alone):
    """First calls of functions, which compile."""

    def __init__(self, folder: Path) -> None:
        self.cache = Cache(folder)
        require_lie("exp")  # what Numba imports to compile, once for all children
        self.cache.clear()
        passed = points_of(partial(require_lie, "ad", "dexp"), self.cache.folder)
        places = [(at, why) for at in range(len(passed)) for why in whys(at)]
        self.places = shuffled(places + [(limit, LIMIT) for limit in LIMITS])
        self.full = len(self.places)

    def trial(self, number: int, rng: random.Random) -> str:
        at, why = self.places[number % self.full]
        self.cache.clear()

        def call() -> None:
            refuse(self.cache.folder, at, why)
            require_lie("ad", "dexp", warned=1)

        with told_with(f"{why} from point or size {at}"):
            in_child(call)
            for names in (("dexp",), ("ad", "dexp", "inverse")):
                in_child(partial(require_lie, *names))
        return "results right"


def whys(at: int) -> list[str]:
    """A full disk at each point, and one other reason at each."""
    return sorted({"ENOSPC", [*REFUSALS][at % len(REFUSALS)]})


def refuse(folder: Path, at: int, why: str) -> None:
    """Install the fault in a child process."""
    if why == LIMIT:
        resource.setrlimit(resource.RLIMIT_FSIZE, (at, at))
    else:
        Points(folder, at, REFUSALS[why])
