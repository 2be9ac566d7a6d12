"""`make bench-peers`: every tool at the same error, on velocities of all sizes.

python -m tolerances                     all, from bench/
python -m tolerances --only lierb        some peers
python -m tolerances --report FILE       the tables of a stored run
"""

from __future__ import annotations

import argparse
import importlib
import json
import os
import subprocess
import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from tolerances import report
from tolerances.tops import BATCHES

BENCH = Path(__file__).parent.parent
RESULTS, README = BENCH / "results", BENCH / "README.md"
TIMEOUT = 1200  # s, for one measurement: SciPy takes minutes to tune
ENTRIES = {
    "lierb": (
        "reduced-adaptive", "reduced-adaptive-tsit5", "reduced-adaptive-verner87",
        "reduced-adaptive-verner98", "reduced-dop853",
    ),
    "heyoka_taylor": ("reduced", "reduced-as-they-come"),
    "numbalsoda_dop853": ("reduced",),
    "scipy_ivp": ("reduced",),
}  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tolerances")
    parser.add_argument("--only", nargs="+", choices=ENTRIES, default=list(ENTRIES), metavar="PEER")
    parser.add_argument("--passes", type=int, default=2, help="through the whole list; default 2")
    parser.add_argument("--report", type=Path, help="write the tables of a stored run")
    given = parser.parse_args()
    if given.report is not None:
        print(report.markdown(json.loads(given.report.read_text(encoding="utf-8"))))
        return
    run = measured(given.only, given.passes)
    RESULTS.mkdir(exist_ok=True)
    path = RESULTS / f"tolerances-{run['time'].replace(':', '')}-{run['machine']['cpu']}.json"
    path.write_text(json.dumps(run, indent=1) + "\n", encoding="utf-8")
    print(report.markdown(run))
    print(f"\nstored in {path}")
    if given.only == list(ENTRIES):  # of some peers alone the tables would not be whole
        page = report.embedded(README.read_text(encoding="utf-8"), run)
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
            for form in ENTRIES[name]:
                for batch in BATCHES:
                    label = f"{name}/{form}/{batch}"
                    print(f"[{turn + 1}/{passes}] {label}", file=sys.stderr, flush=True)
                    fixed = {"label": peer.FORMS[form].label, "batch": batch}
                    keep(entries, label, fixed | worker(name, form, batch))
    return {
        "time": datetime.now(UTC).isoformat(timespec="seconds").removesuffix("+00:00"),
        "machine": machine,
        "before": before,
        "after": {"clock_ghz": clock_ghz(), "peak_gflops": peak_gflops(0.5)},
        "unavailable": unavailable,
        "entries": entries,
    }


def worker(peer: str, form: str, batch: str) -> dict[str, Any]:
    """One measurement; {"failed": why} where it broke."""
    command = [sys.executable, "-m", "tolerances.worker", peer, form, batch]
    pools = ("OMP", "MKL", "OPENBLAS")
    environment = os.environ | {f"{pool}_NUM_THREADS": "1" for pool in pools}
    try:
        done = subprocess.run(
            command, cwd=BENCH, env=environment, capture_output=True, text=True, timeout=TIMEOUT,
            check=True,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return {"failed": f"took more than {TIMEOUT} s"}
    except subprocess.CalledProcessError as error:
        return {"failed": (error.stderr.strip().splitlines() or ["no message"])[-1]}
    return dict(json.loads(done.stdout.strip().splitlines()[-1]))


def keep(entries: dict[str, dict[str, Any]], name: str, found: dict[str, Any]) -> None:
    """Keep the best of several runs, error by error."""
    best = entries.setdefault(name, found)
    if "failed" in best:
        entries[name] = found
    elif "failed" not in found:
        for key, one in found.items():
            if isinstance(one, dict) and "cpu_us" in one and "cpu_us" in best[key]:
                for figure in ("wall_us", "cpu_us"):
                    best[key][figure] = min(best[key][figure], one[figure])


if __name__ == "__main__":
    main()
