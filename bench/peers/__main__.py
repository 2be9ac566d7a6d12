"""`make bench-peers`: run every peer, store what was found, write the tables and the diagram.

    python -m peers                   all peers, from bench/
    python -m peers --only cpp lierb  some of them
    python -m peers --report FILE     the tables of a stored run

Each measurement is a process of its own. The whole list is gone through several times, and each
entry's best run counts: on a shared machine slow minutes come and go.
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

import peers
from peers import report

RESULTS = Path(__file__).parent.parent / "results"
README = Path(__file__).parent.parent / "README.md"  # has the tables of the last whole run
TIMEOUT = 600  # s, for one measurement
NOT_PEERS = {"__init__", "__main__", "equations", "heavy_top", "reference", "report", "worker"}


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m peers")
    names = sorted(m.name for m in pkgutil.iter_modules(peers.__path__) if m.name not in NOT_PEERS)
    parser.add_argument("--only", nargs="+", choices=names, default=names, metavar="PEER")
    parser.add_argument("--passes", type=int, default=2, help="through the whole list; default 2")
    parser.add_argument("--report", type=Path, help="write the tables of a stored run")
    given = parser.parse_args()
    if given.report is None:
        run = measured(given.only, given.passes)
        RESULTS.mkdir(exist_ok=True)
        path = RESULTS / f"peers-{run['time'].replace(':', '')}-{run['machine']['cpu']}.json"
        path.write_text(json.dumps(run, indent=1) + "\n")
    else:
        path = given.report
        run = json.loads(path.read_text())
    print(report.markdown(run))
    figure = path.with_suffix(".png")
    report.draw(run, figure)
    print(f"\nstored in {path} and {figure}")
    if given.only == names:  # of some peers alone the tables would not be whole
        page = README.read_text(encoding="utf-8")
        page = report.embedded(page, run, f"results/{figure.name}")
        README.write_text(page, encoding="utf-8")
        print(f"written into {README}")


def measured(names: list[str], passes: int) -> dict[str, Any]:
    from calibration import clock_ghz, peak_gflops

    import lierb

    machine = {k: v for k, v in lierb.info().items() if k != "cache"}
    before = {"clock_ghz": clock_ghz(), "peak_gflops": peak_gflops(0.5)}
    entries: dict[str, dict[str, Any]] = {}
    unavailable: dict[str, str] = {}
    for turn in range(passes):
        for name in names:
            peer = importlib.import_module(f"peers.{name}")
            if reason := peer.available():
                unavailable[name] = reason
                continue
            for form_name, form in peer.FORMS.items():
                entry = entries.setdefault(
                    f"{name}/{form_name}",
                    {"label": form.label, "family": form.family, "adaptive": form.adaptive,
                     "curve": []},
                )  # fmt: skip
                print(f"[{turn + 1}/{passes}] {name}/{form_name}", file=sys.stderr, flush=True)
                for threads in form.threads:
                    curve = threads == 1 and not entry["curve"]
                    found = worker(name, form_name, threads, curve)
                    entry["curve"] = found.pop("curve", entry["curve"])
                    keep(entry, f"threads_{threads}", found)
    return {
        "time": datetime.now(UTC).isoformat(timespec="seconds").removesuffix("+00:00"),
        "machine": machine,
        "before": before,
        "after": {"clock_ghz": clock_ghz(), "peak_gflops": peak_gflops(0.5)},
        "unavailable": unavailable,
        "entries": entries,
    }


def worker(peer: str, form: str, threads: int, curve: bool) -> dict[str, Any]:
    """One measurement; {"failed": why} where it broke."""
    command = [sys.executable, "-m", "peers.worker", peer, form, "--threads", str(threads)]
    command += ["--curve"] if curve else []
    pools = ("OMP", "MKL", "OPENBLAS")
    environment = os.environ | {f"{pool}_NUM_THREADS": str(threads) for pool in pools}
    try:
        done = subprocess.run(
            command, cwd=Path(__file__).parent.parent, env=environment, capture_output=True,
            text=True, timeout=TIMEOUT, check=True,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return {"failed": f"took more than {TIMEOUT} s"}
    except subprocess.CalledProcessError as error:
        return {"failed": (error.stderr.strip().splitlines() or ["no message"])[-1]}
    return json.loads(done.stdout.strip().splitlines()[-1])


def keep(entry: dict[str, Any], name: str, found: dict[str, Any]) -> None:
    """Keep the best of several runs, figure by figure."""
    best = entry.setdefault(name, found)
    if "failed" in best:
        entry[name] = found
    elif "failed" not in found:
        for figure in ("wall_s", "cpu_s", "cold_s"):
            best[figure] = min(best[figure], found[figure])


if __name__ == "__main__":
    main()
