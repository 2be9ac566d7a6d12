"""Trials of every kind, counted; what is printed and stored."""

from __future__ import annotations

import argparse
import json
import os
import random
import signal
import sys
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import UTC, datetime
from importlib import import_module
from pathlib import Path
from typing import Any, Protocol

from faults.crash import Child, Serving
from lierb.runs.provenance import machine


class Trials(Protocol):
    """Trials of one kind, made once with a folder of its own.

    full : trials of the whole campaign.
    """

    full: int

    def trial(self, number: int, rng: random.Random) -> str:
        """The outcome. Raises AssertionError, with the input, if what must hold does not."""

    def end(self) -> None:
        """End the processes that are still there."""


@dataclass(frozen=True)
class Kind:
    """A row of the table: what is broken; each trial counts as so many."""

    broken: str
    make: Callable[[Path], Trials]
    each: int = 1


class Calls(Serving):
    """A module's `campaign(count, seed)`, which counts outcomes, `each` inputs a trial."""

    def __init__(self, module: str, each: int, count: int) -> None:
        super().__init__()
        self.module, self.each, self.full = module, each, -(-count // each)
        self.counted: Counter[str] = Counter()

    def answer(self, seed: int) -> Counter[str]:
        return import_module(f"faults.{self.module}").campaign(self.each, seed)

    def trial(self, number: int, rng: random.Random) -> str:
        self.counted += self.ask(rng.randrange(2**31))
        return ""


def _of(module: str, name: str) -> Callable[[Path], Trials]:
    return lambda folder: getattr(import_module(f"faults.{module}"), name)(folder)


# They run in this order. Interrupts want a process that has compiled nothing; what empties the
# disk cache goes before studies, whose kernels stay in it.
KINDS: dict[str, Kind] = {
    "interrupts": Kind("a signal while kernels are compiled", _of("interrupts", "Interrupts")),
    "cache": Kind("a writer of the disk cache dies", _of("kills", "CacheKills")),
    "cache disk": Kind("no room for the disk cache", _of("disks", "CacheDisks")),
    "cache files": Kind("files of the disk cache are damaged", _of("damage", "DamagedCaches")),
    "study": Kind("the run of a study dies", _of("kills", "StudyKills")),
    "study disk": Kind("no room for a study's results", _of("disks", "StudyDisks")),
    "manifests": Kind("a manifest is damaged", _of("damage", "DamagedManifests")),
    "parts": Kind("a part is damaged", _of("damage", "DamagedParts")),
    "cluster": Kind("a Dask worker dies, or its run", _of("clusters", "ClusterKills")),
    "arguments": Kind("hostile arguments", lambda _: Calls("arguments", 2_000, 1_000_000), 2_000),
    "study files": Kind(
        "hostile study files", lambda _: Calls("study_files", 1_000, 100_000), 1_000
    ),
}


@dataclass
class Count:
    """Outcomes of the trials of a kind.

    seconds, cpu : on the clock, and of the processor, children included, in s.
    """

    tried: int = 0
    seconds: float = 0.0
    cpu: float = 0.0
    outcomes: Counter[str] = field(default_factory=Counter)
    violations: list[str] = field(default_factory=list)

    @property
    def told(self) -> dict[str, Any]:
        return {
            "tried": self.tried, "violations": len(self.violations),
            "outcomes": dict(self.outcomes.most_common()),
            "seconds": round(self.seconds, 1), "cpu": round(self.cpu, 1),
        }  # fmt: skip


def run(
    name: str, kind: Kind, folder: Path, options: argparse.Namespace, until: float, count: Count
) -> None:
    """Trials of a kind, counted as they are done, until then on the monotonic clock."""
    began, cpu = time.monotonic(), sum(os.times()[:4])
    trials = kind.make(folder)
    numbers = range(max(1, round(options.share * trials.full)))
    try:
        for number in numbers if options.only is None else [options.only]:
            if time.monotonic() > until:
                break
            try:
                outcome = trials.trial(number, random.Random(f"{options.seed} {number}"))
            except AssertionError as error:
                again = f"python -m faults '{name}' --seed {options.seed} --only {number}"
                count.violations.append(f"{again}\n{error}")
            else:
                count.outcomes.update([outcome] if outcome else [])
            count.tried += kind.each
            if sys.stderr.isatty():
                told = f"{name}: {count.tried} of {len(numbers) * kind.each}"
                print(f"\r{told}, {len(count.violations)} violations", end="", file=sys.stderr)
    finally:
        trials.end()
        count.outcomes.update(getattr(trials, "counted", {}))
        count.seconds, count.cpu = time.monotonic() - began, sum(os.times()[:4]) - cpu


def table(counts: dict[str, Count]) -> str:
    """Report in Markdown."""
    lines = ["| | what is broken | tried | outcomes | violations |", "|---|---|--:|---|--:|"]
    for name, count in counts.items():
        outcomes = ", ".join(f"{n:,} {outcome}" for outcome, n in count.outcomes.most_common())
        lines.append(
            f"| {name} | {KINDS[name].broken} | {count.tried:,} | {outcomes} "
            f"| {len(count.violations)} |"
        )
    return "\n".join(lines)


def shortened(violation: str) -> str:
    """Traceback without the middle, if it is long."""
    lines = violation.splitlines()
    return "\n".join(lines if len(lines) < 15 else [*lines[:3], "  ...", *lines[-10:]])


def main(scratch: Path) -> int:
    """The command; its exit status."""
    options = _options()
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # its children end with it
    signal.signal(signal.SIGINT, signal.default_int_handler)
    counts: dict[str, Count] = {}
    until = time.monotonic() + 60.0 * options.minutes
    try:
        for name, kind in KINDS.items():
            if name in (options.kinds or KINDS) and time.monotonic() < until:
                count = counts[name] = Count()
                run(name, kind, scratch / name.replace(" ", "-"), options, until, count)
                print(f"\r{name}: {count.told}", file=sys.stderr)
    except KeyboardInterrupt:
        print("\nStopped; so far:", file=sys.stderr)
    finally:
        for child in [*Child.alive]:
            child.end()
    violations = [each for count in counts.values() for each in count.violations]
    for each in violations[: options.show]:
        print(f"\n{shortened(each)}")
    print(f"\n{table(counts)}")
    if options.out:
        _store(options.out, options.seed, counts, violations)
    return 1 if violations else 0


def _store(out: Path, seed: int, counts: dict[str, Count], violations: list[str]) -> None:
    told = {
        "date": f"{datetime.now(UTC):%Y-%m-%d}", "machine": machine(), "seed": seed,
        "kinds": {name: count.told for name, count in counts.items()}, "violations": violations,
    }  # fmt: skip
    out.parent.mkdir(parents=True, exist_ok=True)
    out.with_suffix(".json").write_text(json.dumps(told, indent=1) + "\n")
    out.with_suffix(".md").write_text(table(counts) + "\n")


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m faults", description="The fault campaign; see docs/faults.md."
    )
    parser.add_argument("kinds", nargs="*", metavar="KIND", help=f"all of them: {', '.join(KINDS)}")
    parser.add_argument("--share", type=float, default=1.0, help="of the whole campaign")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", type=int, metavar="N", help="trial N alone, again")
    parser.add_argument("--minutes", type=float, default=float("inf"), help="at most, in all")
    parser.add_argument("--show", type=int, default=10, help="violations to print")
    parser.add_argument("--out", type=Path, help="store figures and violations: OUT.json, OUT.md")
    options = parser.parse_args()
    if unknown := set(options.kinds) - KINDS.keys():
        parser.error(f"unknown: {', '.join(unknown)}; expected {', '.join(KINDS)}")
    return options
