"""Files that are not as they were written: manifests, parts and the disk cache.

Bits flipped, cut, emptied, zeros, deleted, exchanged; in manifests also values, keys and whole
branches that are others. What must hold: `show`, `plot` and `report` tell what the study found, or
one sentence; `run --resume` leads to the bytes of a run without faults, or to one sentence; from
the disk cache comes what is right, or it is compiled anew.
"""

from __future__ import annotations

import json
import pickle
import random
import shutil
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

from faults.caches import LIE, Cache, require_fall, require_lie
from faults.crash import Alone, Serving, in_child, told_with
from faults.folders import Space, command

FIGURES = 0.015  # share of the trials that draw them: a second each

# ---- what is done to a file --------------------------------------------------------------------


def choice(rng: random.Random, **weights: int) -> str:
    """One of the names, as often as its weight says."""
    (name,) = rng.choices([*weights], [*weights.values()])
    return name


def damaged(content: bytes, rng: random.Random) -> tuple[str, bytes]:
    """Some bytes that are not the content, and how they came about."""
    size = len(content)
    at = rng.randrange(size) if size else 0
    length = min(size - at, rng.choice((1, 16, 512, 4096)))
    noise = rng.randbytes(length)
    flipped = bytearray(content)
    for place in [at, *(rng.randrange(size) for _ in range(rng.choice((0, 0, 7))))] if size else ():
        flipped[place] ^= 1 << rng.randrange(8)
    ways = {
        "bits flipped": bytes(flipped),
        "cut": content[:at],
        "emptied": b"",
        "zeros": content[:at] + bytes(length) + content[at + length :],
        "all zeros": bytes(size),
        "noise": content[:at] + noise + content[at + length :],
        "longer": content + rng.choice((b"\0" * 100, content[: size // 2], b"more")),
        "begins later": content[at:],
        "something else": rng.choice((b"no such file", b"\xff\xfe", b"{}", b"[]", b"null", b"7")),
    }
    how = rng.choice([way for way, other in ways.items() if other != content])
    return how, ways[how]


VALUES = (
    None, True, 0, -1, 3, 10**30, 0.5, -1e300, "", "x", "../../etc/passwd", "\ud800", [], {}, [[]],
    [1, 2], {"x": 1}, ["SE3"], "NaN", 1e-3, "0" * 64,
)  # fmt: skip


def places(found: Any, place: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """The keys that lead to anything in a JSON document."""
    items = found.items() if isinstance(found, dict) else enumerate(found)
    for key, value in items:
        yield (*place, key)
        if isinstance(value, (dict, list)):
            yield from places(value, (*place, key))


def edited(text: str, rng: random.Random) -> tuple[str, str]:
    """A JSON document with something else in it, and what."""
    document = json.loads(text)
    told = []
    for _ in range(rng.choice((1, 1, 2))):
        # sections are small beside the parts: each has its share
        section = rng.choice([*document] or [None])
        *way, key = rng.choice([p for p in places(document) if p[0] == section] or [(section,)])
        inside = document
        for each in way:
            inside = inside[each]
        deed = rng.choice(("set", "set", "set", "delete", "rename", "copy"))
        told.append(f"{deed} {'.'.join(map(str, (*way, key)))}")
        if deed == "set":
            value = rng.choice(VALUES)
            told[-1] += f" = {value!r}"
            inside[key] = value
        elif deed == "copy":
            *there, last = rng.choice(list(places(document)))
            value = document
            for each in (*there, last):
                value = value[each]
            told[-1] += f" from {'.'.join(map(str, (*there, last)))}"
            inside[key] = json.loads(json.dumps(value))
        elif isinstance(inside, list):
            del inside[key]
        else:
            value = inside.pop(key)
            if deed == "rename":
                inside[f"{key}."] = value
    return "; ".join(told), json.dumps(document)


ODD = {
    "nested deeply": "[" * 100_000,
    "a long number": '{"format": ' + "9" * 5000 + "}",
    "keys twice": '{"format": 2, "format": 1}',
    "a list of all": "[{}]",
    "infinity": '{"format": Infinity}',
}

# ---- folders of studies ------------------------------------------------------------------------


class DamagedFolders(Serving):
    """Results of a study, looked at and resumed in a child that goes on to the next trial."""

    full = 0

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self.space = Space(folder)
        self.shown = {}
        for study in ("summary", "history"):
            self.space.whole(study)
            self.space.clear(self.space.whole(study))
            self.shown[study] = in_child(partial(command, "show", self.space.out)).output

    def damage(self, study: str, rng: random.Random) -> str:
        """Damage `out`; return a description."""
        raise NotImplementedError

    def trial(self, number: int, rng: random.Random) -> str:
        return self.ask(rng)

    def answer(self, rng: random.Random) -> str:
        space = self.space
        study = rng.choice([*self.shown])
        space.clear(space.whole(study))
        how = self.damage(study, rng)
        with told_with(f"{study}, {how}"):
            told = self._looked_at(study, rng)
            again = space.run(study).required_clear()
            space.require_decoys()
            if again.status:
                assert "Error: " in again.output, again.output
                return f"{told}, resume refused"
            space.require_whole(study)
            return f"{told}, resumed"

    def _looked_at(self, study: str, rng: random.Random) -> str:
        out = self.space.out
        if rng.random() < FIGURES:
            command(rng.choice(("plot", "report")), out).required_clear()
            shutil.rmtree(out / "figures", ignore_errors=True)  # those that whole parts gave
            (out / "report.html").unlink(missing_ok=True)
        shown = command("show", out).required_clear()
        if shown.status:
            assert "Error: " in shown.output, shown.output
            return "refused"
        if "the rest with" in shown.output:
            return "shown in part"
        assert shown.output == self.shown[study], f"shown otherwise:\n{shown.output}"
        return "shown"


class DamagedManifests(DamagedFolders):
    """The manifest and study.toml."""

    full = 3000

    def damage(self, study: str, rng: random.Random) -> str:
        file = self.space.out / choice(rng, **{"manifest.json": 9, "study.toml": 1})
        content = file.read_bytes()
        kind = choice(rng, edited=60, bytes=30, deleted=4, odd=3, other=3)
        if kind == "deleted":
            file.unlink()
            return f"{file.name} deleted"
        if kind == "odd":
            name = rng.choice([*ODD])
            file.write_text(ODD[name])
            return f"{file.name} is {name}"
        if kind == "other":
            other = "history" if study == "summary" else "summary"
            shutil.copy(self.space.whole(other) / file.name, file)
            return f"{file.name} is that of another study"
        if kind == "edited" and file.suffix == ".json":
            how, text = edited(content.decode(), rng)
            file.write_text(text)
            return f"{file.name}: {how}"
        how, content = damaged(content, rng)
        file.write_bytes(content)
        return f"{file.name} {how}"


class DamagedParts(DamagedFolders):
    """Parquet files: one, or two exchanged, or one that no manifest knows of."""

    full = 1500

    def damage(self, study: str, rng: random.Random) -> str:
        files = sorted(self.space.out.glob("[sh]*/part-*.parquet"))
        file, other = rng.sample(files, 2)
        kind = choice(rng, bytes=80, deleted=5, exchanged=5, orphan=5, folder=5)
        name = f"{file.parent.name}/{file.name}"
        if kind == "deleted":
            file.unlink()
        elif kind == "exchanged":
            contents = file.read_bytes(), other.read_bytes()
            other.write_bytes(contents[0])
            file.write_bytes(contents[1])
        elif kind == "orphan":
            shutil.copy(file, file.with_name("part-07-0000000000.parquet"))
        elif kind == "folder":
            file.unlink()
            file.mkdir()
        else:
            kind, content = damaged(file.read_bytes(), rng)
            file.write_bytes(content)
        return f"{name} {kind}"


# ---- the disk cache ----------------------------------------------------------------------------

PLAIN = (None, {}, [], "0.1", (1, 2), ("0.1", {}), {"key": b"code"}, 10**20)
PICKLES = tuple(map(pickle.dumps, PLAIN))


class DamagedCaches(Alone):
    """Index, data files, stamps: whatever is there; then processes that load or compile."""

    full = 600

    def __init__(self, folder: Path) -> None:
        self.cache = Cache(folder)
        require_lie("exp")  # what Numba imports to compile, once for all children
        self.names = sorted(LIE.keys() - {"exp"})
        self.cache.made("functions", lambda: require_lie(*self.names))
        self.cache.made("integration", require_fall)

    def trial(self, number: int, rng: random.Random) -> str:
        state = choice(rng, functions=98, integration=2)
        self.cache.clear(state)
        told = [self._damage(rng) for _ in range(rng.choice((1, 1, 1, 2, 5)))]
        names = rng.sample(self.names, 2)
        # Where a folder is in a file's place, no code can be kept, as a warning says.
        warned = int(any(each.endswith("folder") for each in told))
        functions = partial(require_lie, *names, warned=warned)
        work = require_fall if state == "integration" else functions
        with told_with(f"{state}, {', '.join(told)}"):
            in_child(work)
            in_child(work)  # what the first process has saved is right as well
        return "results right"

    def _damage(self, rng: random.Random) -> str:
        files = [file for file in self.cache.files if file.suffix != ".py"]
        if len(files) < 2:
            return "nothing left"
        file, other = rng.sample(files, 2)
        kind = choice(rng, bytes=70, deleted=5, exchanged=15, pickle=5, folder=5)
        content = file.read_bytes()
        if kind == "deleted":
            file.unlink()
        elif kind == "exchanged":
            file.write_bytes(other.read_bytes())
            other.write_bytes(content)
            kind = f"exchanged with {other.name}"
        elif kind == "folder":
            file.unlink()
            file.mkdir()
        elif kind == "pickle":
            file.write_bytes(b"".join(rng.choices(PICKLES, k=rng.choice((1, 2)))))
        else:
            kind, content = damaged(content, rng)
            file.write_bytes(content)
        return f"{file.name} {kind}"
