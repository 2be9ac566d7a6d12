"""`make bench-peers`: every tool at the same error, on velocities of all sizes.

python -m tolerances                     all, from bench/
python -m tolerances --only lierb        some peers
python -m tolerances --report FILE       the tables of a stored run
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import measuring
from measuring import README, Entries

from tolerances import report
from tolerances.tops import BATCHES

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
    run = measuring.measured("peers", given.only, given.passes, measure)
    path = measuring.stored(run, "tolerances")
    print(report.markdown(run))
    print(f"\nstored in {path}")
    if given.only == list(ENTRIES):  # of some peers alone the tables would not be whole
        page = report.embedded(README.read_text(encoding="utf-8"), run)
        README.write_text(page, encoding="utf-8")
        print(f"written into {README}")


def measure(name: str, peer: ModuleType, entries: Entries, turn: str) -> None:
    """Its forms that are compared here, on both batches."""
    for form in ENTRIES[name]:
        for batch in BATCHES:
            label = f"{name}/{form}/{batch}"
            print(f"{turn} {label}", file=sys.stderr, flush=True)
            fixed = {"label": peer.FORMS[form].label, "batch": batch}
            found = measuring.in_process("tolerances.worker", name, form, batch, timeout=TIMEOUT)
            measuring.keep(entries, label, fixed | found, better)


def better(best: dict[str, Any], found: dict[str, Any]) -> None:
    """Error by error."""
    for key, one in found.items():
        if isinstance(one, dict) and "cpu_us" in one and "cpu_us" in best[key]:
            measuring.keep_least(best[key], one, ("wall_us", "cpu_us"))


if __name__ == "__main__":
    main()
