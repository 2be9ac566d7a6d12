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
import json
import pkgutil
import sys
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any

import measuring
from measuring import README, Entries

import linkages
from linkages import report

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
    asked = partial(measure, given.mechanisms)
    run = measuring.measured("linkages", given.only, given.passes, asked)
    path = measuring.stored(run, "mechanisms")
    print(report.markdown(run))
    print(f"\nstored in {path}")
    if given.only == names and given.mechanisms == every:  # else the tables would not be whole
        page = report.embedded(README.read_text(encoding="utf-8"), run)
        README.write_text(page, encoding="utf-8")
        print(f"written into {README}")


def measure(which: list[str], name: str, peer: ModuleType, entries: Entries, turn: str) -> None:
    """All forms of a peer that are of these mechanisms."""
    for form_name, form in peer.FORMS.items():
        if form.mechanism in which:
            label = f"{name}/{form_name}"
            print(f"{turn} {label}", file=sys.stderr, flush=True)
            fixed = {"label": form.label, "mechanism": form.mechanism, "allowed_m": form.limit}
            found = measuring.in_process("linkages.worker", name, form_name, timeout=TIMEOUT)
            measuring.keep(entries, label, fixed | found, better)


def better(best: dict[str, Any], found: dict[str, Any]) -> None:
    """Figure by figure; the largest error."""
    measuring.keep_least(best, found, ("wall_s", "cpu_s", "cold_s"))
    best["error_m"] = max(best["error_m"], found["error_m"])


if __name__ == "__main__":
    main()
