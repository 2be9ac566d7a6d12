"""Common part of comparisons with other tools.

Each measurement runs in a process of its own; the tables of the last whole run go into the page.
"""

from __future__ import annotations

import importlib
import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterable
from datetime import UTC, datetime
from pathlib import Path
from types import ModuleType
from typing import Any

BENCH = Path(__file__).parent
RESULTS = BENCH / "results"
README = BENCH / "README.md"  # has the tables of the last whole run
POOLS = ("OMP", "MKL", "OPENBLAS")

Entries = dict[str, dict[str, Any]]


def measured(
    package: str,
    names: list[str],
    passes: int,
    measure: Callable[[str, ModuleType, Entries, str], None],
) -> dict[str, Any]:
    """A run: of every peer that is there, all that `measure(name, peer, entries, turn)` enters.

    package : of the peers.   turn : as it is printed.
    """
    from calibration import clock_ghz, peak_gflops

    import lierb

    machine = {k: v for k, v in lierb.info().items() if k != "cache"}
    before = {"clock_ghz": clock_ghz(), "peak_gflops": peak_gflops(0.5)}
    entries: Entries = {}
    unavailable: dict[str, str] = {}
    for turn in range(passes):
        for name in names:
            peer = importlib.import_module(f"{package}.{name}")
            if reason := peer.available():
                unavailable[name] = reason
            else:
                measure(name, peer, entries, f"[{turn + 1}/{passes}]")
    return {
        "time": datetime.now(UTC).isoformat(timespec="seconds").removesuffix("+00:00"),
        "machine": machine,
        "before": before,
        "after": {"clock_ghz": clock_ghz(), "peak_gflops": peak_gflops(0.5)},
        "unavailable": unavailable,
        "entries": entries,
    }


def stored(run: dict[str, Any], kind: str) -> Path:
    """Store a run; return its path."""
    RESULTS.mkdir(exist_ok=True)
    path = RESULTS / f"{kind}-{run['time'].replace(':', '')}-{run['machine']['cpu']}.json"
    path.write_text(json.dumps(run, indent=1) + "\n", encoding="utf-8")
    return path


def in_process(module: str, *arguments: str, timeout: float, threads: int = 1) -> dict[str, Any]:
    """Last line of `python -m module`, as JSON; {"failed": why} if it failed.

    timeout : s.
    """
    environment = os.environ | {f"{pool}_NUM_THREADS": str(threads) for pool in POOLS}
    try:
        done = subprocess.run(
            [sys.executable, "-m", module, *arguments], cwd=BENCH, env=environment,
            capture_output=True, text=True, timeout=timeout, check=True,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return {"failed": f"took more than {timeout} s"}
    except subprocess.CalledProcessError as error:
        return {"failed": (error.stderr.strip().splitlines() or ["no message"])[-1]}
    return dict(json.loads(done.stdout.strip().splitlines()[-1]))


def keep(
    entries: Entries,
    name: str,
    found: dict[str, Any],
    better: Callable[[dict[str, Any], dict[str, Any]], None],
) -> None:
    """Enter what one of several runs has found; `better(best, found)` where both did not fail."""
    best = entries.setdefault(name, found)
    if "failed" in best:
        entries[name] = found
    elif "failed" not in found:
        better(best, found)


def keep_least(best: dict[str, Any], found: dict[str, Any], figures: Iterable[str]) -> None:
    for figure in figures:
        best[figure] = min(best[figure], found[figure])


def around_marks(text: str, name: str) -> tuple[str, str]:
    """Text before and after the content between the two marks of this name."""
    begin, finish = f"<!-- {name} -->", f"<!-- /{name} -->"
    before, mark, rest = text.partition(f"{begin}\n")
    _, end, after = rest.partition(finish)
    if not (mark and end):
        raise ValueError(f"no place for the tables: {begin} and {finish} are missing")
    return before + mark, end + after


def headline(run: dict[str, Any]) -> str:
    """The machine, and when it was."""
    machine, before, after = run["machine"], run["before"], run["after"]
    return (
        f"{machine['cpu']}, {machine['lanes']} lanes, one core, {before['clock_ghz']:.2f} GHz; "
        f"measured peak {before['peak_gflops']:.0f} GFLOP/s before the run, "
        f"{after['peak_gflops']:.0f} after it; {run['time'][:10]}."
    )
