"""`make bench-peers`: run every peer, store what was found, write the tables and the diagram.

    python -m peers                   all peers, from bench/
    python -m peers --only cpp lierb  some of them
    python -m peers --report FILE     the tables of a stored run

Each measurement is a process of its own. The whole list is gone through several times, and each
entry's best run counts: on a shared machine slow minutes come and go.
"""

from __future__ import annotations

import argparse
import json
import pkgutil
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import measuring
from measuring import README, Entries

import peers
from peers import report

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
        run = measuring.measured("peers", given.only, given.passes, measure)
        path = measuring.stored(run, "peers")
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


def measure(name: str, peer: ModuleType, entries: Entries, turn: str) -> None:
    """All forms of a peer, on all numbers of threads; the curve once."""
    for form_name, form in peer.FORMS.items():
        entry = entries.setdefault(
            f"{name}/{form_name}",
            {"label": form.label, "family": form.family, "adaptive": form.adaptive, "curve": []},
        )
        print(f"{turn} {name}/{form_name}", file=sys.stderr, flush=True)
        for threads in form.threads:
            curve = threads == 1 and not entry["curve"]
            options = ("--threads", str(threads), *(["--curve"] if curve else []))
            found = measuring.in_process(
                "peers.worker", name, form_name, *options, timeout=TIMEOUT, threads=threads
            )
            entry["curve"] = found.pop("curve", entry["curve"])
            measuring.keep(entry, f"threads_{threads}", found, better)


def better(best: dict[str, Any], found: dict[str, Any]) -> None:
    """Figure by figure."""
    measuring.keep_least(best, found, ("wall_s", "cpu_s", "cold_s"))


if __name__ == "__main__":
    main()
