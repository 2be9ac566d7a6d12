"""A process that writes a study's folder, or the disk cache, dies at each of its crash points.

Killed, or without power: what was written and not synced is empty, or half of it zeros. What must
hold: the next run ends well, every byte is that of a run without faults, readers of the folder see
its rows, and files that are not lierb's are as they were. After a dead cache writer the next
processes compute what is right and say nothing.
"""

from __future__ import annotations

import random
import shutil
from functools import partial
from pathlib import Path
from typing import Any

from faults.caches import Cache, require_lie
from faults.crash import (
    ENDS,
    Alone,
    Points,
    ends_at,
    in_child,
    killed_in_child,
    points_of,
    told_with,
)
from faults.folders import STUDIES, Space


def shuffled(items: list[Any]) -> list[Any]:
    """So that a short campaign sees something of everything."""
    return random.Random(0).sample(items, len(items))


AFTERWARDS = (
    "resumed", "without manifest", "another study", "another study without manifest",
)  # fmt: skip


class StudyKills(Alone):
    """Runs of a study, from several states of its folder."""

    def __init__(self, folder: Path) -> None:
        self.space = Space(folder)
        self.states: dict[tuple[str, str], Path | None] = {}
        points = []
        for study in STUDIES:
            self.space.whole(study)
            for state in ("empty", "cut short", "damaged") if study != "sobol" else ("empty",):
                kept = self.states[study, state] = self._state(study, state)
                self.space.clear(kept, decoys=())
                passed = points_of(partial(self.space.run, study), self.space.out)
                for at, point in enumerate(passed):
                    for end in ends_at(point):
                        every = (state, end) == ("empty", "killed")
                        following = AFTERWARDS if every else AFTERWARDS[:1]
                        points += [(study, state, at, end, then) for then in following]
        self.points = shuffled(points)
        self.full = len(self.points)

    def _state(self, study: str, state: str) -> Path | None:
        """A folder as a run finds it."""
        if state == "empty":
            return None
        kept = self.space.folder / "states" / f"{study} {state}"
        if state == "damaged":
            shutil.copytree(self.space.whole(study), kept)
            first, *_, last = sorted((kept / "summary").glob("part-*.parquet"))
            first.write_bytes(first.read_bytes()[:-100])
            last.unlink()
            return kept
        self.space.clear(decoys=())
        middle = len(points_of(lambda: self.space.run(study), self.space.out)) // 2
        self.space.clear(decoys=())
        assert killed_in_child(lambda: self._dying(study, middle, "killed"))
        shutil.copytree(self.space.out, kept)
        return kept

    def _dying(self, study: str, at: int, end: str) -> None:
        Points(self.space.out, at, ENDS[end])
        self.space.run(study)

    def trial(self, number: int, rng: random.Random) -> str:
        study, state, at, end, then = self.points[number % self.full]
        space = self.space
        space.clear(self.states[study, state])
        is_dead = killed_in_child(lambda: self._dying(study, at, end))
        with told_with(f"{study}, {state}, {end} at point {at}, {then}"):
            space.require_decoys()
            # a manifest that takes long to write is not written for every part: fewer points
            return self._afterwards(study, then) if is_dead else "not reached"

    def _afterwards(self, study: str, then: str) -> str:
        space = self.space
        if "without manifest" in then:
            (space.out / "manifest.json").unlink(missing_ok=True)
        other = "sobol" if study == "summary" else "summary"
        asked = other if "another" in then else study

        def run() -> Any:
            ended = space.run(asked)
            if ended.status == 0:
                space.require_readers_rows(asked)
            return ended

        ended = in_child(run).required_clear()
        space.require_decoys()
        if ended.status and then != "resumed":
            assert str(space.out) in ended.output, ended.output
            return "refused"
        assert ended.status == 0, ended.output
        space.require_whole(asked)
        return then


class CacheKills(Alone):
    """Writers of the disk cache: of the first function, of another one, over what is damaged."""

    def __init__(self, folder: Path) -> None:
        self.cache = Cache(folder)
        require_lie("exp")  # what Numba imports to compile, once for all children
        self.cache.made("one", lambda: require_lie("inverse"))
        self.cache.made("half of it gone", lambda: require_lie("ad", "inverse"))
        for file in self.cache.files[::2]:
            file.unlink()
        self.cache.keep("half of it gone")
        points = []
        for state in (None, "one", "half of it gone"):
            self.cache.clear(state)
            passed = points_of(lambda: require_lie("ad", "dexp"), self.cache.folder)
            for at, point in enumerate(passed):
                points += [(state, at, end) for end in ends_at(point)]
        self.points = shuffled(points)
        self.full = len(points)

    def trial(self, number: int, rng: random.Random) -> str:
        state, at, end = self.points[number % self.full]
        self.cache.clear(state)

        def dying() -> None:
            Points(self.cache.folder, at, ENDS[end])
            require_lie("ad", "dexp")

        is_dead = killed_in_child(dying)
        with told_with(f"cache {state or 'empty'}, {end} at point {at}"):
            for names in (("dexp", "ad"), ("ad", "dexp", "inverse")):
                in_child(partial(require_lie, *names))
        return f"right after {end}" if is_dead else "not reached"
