"""`make bench`: run the benchmarks, store what they found, print the change since the last run.

Results are kept in bench/results, one JSON file a run, and compared with the last run on the same
CPU with the same lanes. Rates are first divided by the core's peak, measured beside each of them.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console
from rich.markup import escape
from rich.table import Table

BENCH = Path(__file__).parent
RESULTS = BENCH / "results"
NOISE = 0.1  # a smaller change is not marked


def main() -> int:
    with tempfile.TemporaryDirectory() as folder:
        raw = Path(folder) / "benchmarks.json"
        options = ["--benchmark-only", "--benchmark-quiet", "--benchmark-json", str(raw), "-q"]
        code = pytest.main([str(BENCH), *options, *sys.argv[1:]])
        if not raw.exists() or not raw.stat().st_size:
            return int(code) or 1
        run = shortened(json.loads(raw.read_text()))
    Console(width=100, highlight=False).print(change_table(run, latest(kind(run))))
    if code != 0:
        print("not stored: a benchmark failed")
        return int(code)
    RESULTS.mkdir(exist_ok=True)
    path = RESULTS / f"{run['time'].replace(':', '')}-{kind(run)}.json"
    path.write_text(json.dumps(run, indent=1) + "\n")
    print(f"stored in {path.relative_to(BENCH.parent)}")
    return 0


def shortened(raw: dict[str, Any]) -> dict[str, Any]:
    """Reference for later runs, from pytest-benchmark's JSON."""
    info = raw["machine_info"]
    commit = subprocess.run(
        ["git", "-C", str(BENCH), "rev-parse", "--short", "HEAD"],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    return {
        "time": datetime.now(UTC).isoformat(timespec="seconds").removesuffix("+00:00"),
        "commit": commit.stdout.strip(),
        "machine": {
            **{k: v for k, v in info["lierb"].items() if k != "cache"},
            "brand": info["cpu"].get("brand_raw"),
            "clock_ghz": info["clock_ghz"],
            "peak_gflops": info["peak_gflops"],
        },
        "benchmarks": {
            entry["name"].removeprefix("test_"): {
                "seconds": entry["stats"]["min"],
                **entry["extra_info"],
            }
            for entry in raw["benchmarks"]
        },
    }


def kind(run: dict[str, Any]) -> str:
    """The kind of machine that rates may be compared on."""
    return f"{run['machine']['cpu']}-L{run['machine']['lanes']}"


def latest(wanted: str) -> dict[str, Any] | None:
    """The last stored run on such a machine, with what it left out taken from those before it."""
    stored = [json.loads(path.read_text()) for path in sorted(RESULTS.glob(f"2*-{wanted}.json"))]
    if not stored:
        return None
    entries = {name: entry for run in stored for name, entry in run["benchmarks"].items()}
    return {**stored[-1], "benchmarks": entries}


def figure(entry: dict[str, Any]) -> tuple[str, float, bool]:
    """Label of a benchmark, its number to compare, and whether more is better."""
    if "rate" in entry:
        return f"{entry['rate']:.1f} {entry['unit']}", entry["rate"] / entry["peak_gflops"], True
    if "ratio" in entry:
        return f"{entry['ratio']:.2f} {entry['unit']}", entry["ratio"], True
    if "growth_MB" in entry:
        return f"{entry['growth_MB']:.1f} MB", max(entry["growth_MB"], 1.0), False
    seconds = entry["seconds"]
    text = f"{seconds:.2f} s" if seconds > 0.1 else f"{seconds * 1e6:.0f} µs"
    return text, seconds, False


def change_table(run: dict[str, Any], last: dict[str, Any] | None) -> Table:
    machine = run["machine"]
    table = Table(
        title=f"{machine['brand']}, {machine['lanes']} lanes, {machine['clock_ghz']:.2f} GHz, "
        f"peak {machine['peak_gflops']:.0f} GFLOP/s a core",
        caption="No earlier run on this kind of machine."
        if last is None
        else f"Change since {last['time']} ({last['commit']}), rates over the core's peak then.",
    )
    table.add_column("benchmark")
    table.add_column("found", justify="right")
    table.add_column("change", justify="right")
    for name, entry in run["benchmarks"].items():
        text, number, more_is_better = figure(entry)
        before = last and last["benchmarks"].get(name)
        comparable = before and before.get("unit") == entry.get("unit")
        change = number / figure(before)[1] - 1.0 if comparable else None
        table.add_row(escape(name), text, "" if change is None else _marked(change, more_is_better))
    return table


def _marked(change: float, more_is_better: bool) -> str:
    text = f"{change:+.0%}"
    if abs(change) < NOISE:
        return text
    return f"[green]{text}[/]" if (change > 0) == more_is_better else f"[red]{text}[/]"


if __name__ == "__main__":
    sys.exit(main())
