"""One peer, one form, in a process of its own: `python -m linkages.worker PEER FORM` → JSON."""

from __future__ import annotations

import time

START = time.time()  # before anything heavy is imported

import argparse  # noqa: E402
import importlib  # noqa: E402
import json  # noqa: E402
import os  # noqa: E402


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("peer")
    parser.add_argument("form")
    parser.add_argument("--count", type=int, help="trajectories; default: the form's own")
    parser.add_argument("--rounds", type=int, default=3)
    given = parser.parse_args()
    os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:1])

    from peers.worker import timed

    from linkages import cases

    peer = importlib.import_module(f"linkages.{given.peer}")
    form = peer.FORMS[given.form]
    tree = cases.tree_of(form.mechanism, given.count or form.count)
    integrate = peer.run(given.form, tree)
    integrate()
    cold = time.time() - START
    wall, cpu, found = timed(integrate, given.rounds)
    result = {
        "count": len(tree), "wall_s": wall, "cpu_s": cpu, "cold_s": cold,
        "error_m": cases.error(form.mechanism, found), "config": peer.config(),
    }  # fmt: skip
    print(json.dumps(result))


if __name__ == "__main__":
    main()
