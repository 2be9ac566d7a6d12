"""`make bench-peers`: run every peer on every mechanism, store what was found, write the tables.

    python -m linkages                       all, from bench/
    python -m linkages --only cpp lierb      some of them
    python -m linkages --mechanisms chain2   one mechanism
    python -m linkages --report FILE         the tables of a stored run

Each measurement is a process of its own; the list is gone through several times, and the best run
of each entry counts, as for heavy tops (`python -m peers`).
"""

from __future__ import annotations

import argparse
import importlib
import json
import os
import pkgutil
import subprocess
import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import linkages
from linkages import report

RESULTS = Path(__file__).parent.parent / "results"
README = Path(__file__).parent.parent / "README.md"  # has the tables of the last whole run
TIMEOUT = 900  # s, for one measurement; the first one of Pinocchio compiles it
NOT_PEERS = {"__init__", "__main__", "cases", "report", "worker"}


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m linkages")
    found = pkgutil.iter_modules(linkages.__path__)
    names = sorted(m.name for m in found if m.name not in NOT_PEERS)
    every = list(report.TITLES)
    parser.add_argument("--only", nargs="+", choices=names, default=names, metavar="PEER")
    parser.add_argument("--mechanisms", nargs="+", choices=every, default=every, metavar="NAME")
    parser.add_argument("--passes", type=int, default=2, help="through the whole list; default 2")
    parser.add_argument("--report", type=Path, help="write the tables of a stored run")
    given = parser.parse_args()
    if given.report is not None:
        print(report.markdown(json.loads(given.report.read_text(encoding="utf-8"))))
        return
    run = measured(given.only, given.mechanisms, given.passes)
    RESULTS.mkdir(exist_ok=True)
    path = RESULTS / f"mechanisms-{run['time'].replace(':', '')}-{run['machine']['cpu']}.json"
    path.write_text(json.dumps(run, indent=1) + "\n", encoding="utf-8")
    print(report.markdown(run))
    print(f"\nstored in {path}")
    if given.only == names and given.mechanisms == every:  # else the tables would not be whole
        page = report.embedded(README.read_text(encoding="utf-8"), run)
        README.write_text(page, encoding="utf-8")
        print(f"written into {README}")


def measured(names: list[str], which: list[str], passes: int) -> dict[str, Any]:
    from calibration import clock_ghz, peak_gflops

    import lierb

    machine = {k: v for k, v in lierb.info().items() if k != "cache"}
    before = {"clock_ghz": clock_ghz(), "peak_gflops": peak_gflops(0.5)}
    entries: dict[str, dict[str, Any]] = {}
    unavailable: dict[str, str] = {}
    for turn in range(passes):
        for name in names:
            peer = importlib.import_module(f"linkages.{name}")
            if reason := peer.available():
                unavailable[name] = reason
                continue
            for form_name, form in peer.FORMS.items():
                if form.mechanism in which:
                    label = f"{name}/{form_name}"
                    print(f"[{turn + 1}/{passes}] {label}", file=sys.stderr, flush=True)
                    fixed = {
                        "label": form.label, "mechanism": form.mechanism, "allowed_m": form.limit,
                    }  # fmt: skip
                    keep(entries, label, fixed | worker(name, form_name))
    return {
        "time": datetime.now(UTC).isoformat(timespec="seconds").removesuffix("+00:00"),
        "machine": machine,
        "before": before,
        "after": {"clock_ghz": clock_ghz(), "peak_gflops": peak_gflops(0.5)},
        "unavailable": unavailable,
        "entries": entries,
    }


def worker(peer: str, form: str) -> dict[str, Any]:
    """One measurement; {"failed": why} where it broke."""
    command = [sys.executable, "-m", "linkages.worker", peer, form]
    pools = ("OMP", "MKL", "OPENBLAS")
    environment = os.environ | {f"{pool}_NUM_THREADS": "1" for pool in pools}
    try:
        done = subprocess.run(
            command, cwd=Path(__file__).parent.parent, env=environment, capture_output=True,
            text=True, timeout=TIMEOUT, check=True,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return {"failed": f"took more than {TIMEOUT} s"}
    except subprocess.CalledProcessError as error:
        return {"failed": (error.stderr.strip().splitlines() or ["no message"])[-1]}
    return dict(json.loads(done.stdout.strip().splitlines()[-1]))


def keep(entries: dict[str, dict[str, Any]], name: str, found: dict[str, Any]) -> None:
    """Keep the best of several runs, figure by figure; the largest error."""
    best = entries.setdefault(name, found)
    if "failed" in best:
        entries[name] = found
    elif "failed" not in found:
        for figure in ("wall_s", "cpu_s", "cold_s"):
            best[figure] = min(best[figure], found[figure])
        best["error_m"] = max(best["error_m"], found["error_m"])


if __name__ == "__main__":
    main()
