"""One peer, one form, in a process of its own: `python -m peers.worker PEER FORM …` prints JSON."""

from __future__ import annotations

import time

START = time.time()  # before anything heavy is imported

import argparse  # noqa: E402
import importlib  # noqa: E402
import json  # noqa: E402
import os  # noqa: E402
import resource  # noqa: E402


def cpu_seconds() -> float:
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("peer")
    parser.add_argument("form")
    parser.add_argument("--bodies", type=int, help="default: the form's own")
    parser.add_argument("--accuracy", type=float, help="default: the form's own")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--rounds", type=int, default=3)
    given = parser.parse_args()
    os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[: given.threads])

    peer = importlib.import_module(f"peers.{given.peer}")
    from peers import heavy_top

    reason = peer.available()
    if reason:
        print(json.dumps({"unavailable": reason}))
        return
    form = peer.FORMS[given.form]
    accuracy = form.accuracy if given.accuracy is None else given.accuracy
    omega0 = heavy_top.samples(given.bodies or form.bodies)
    integrate = peer.run(given.form, omega0, accuracy, given.threads)
    final = integrate()
    cold = time.time() - START
    rounds = []
    for _ in range(given.rounds):
        wall, cpu = time.perf_counter(), cpu_seconds()
        final = integrate()
        rounds.append((time.perf_counter() - wall, cpu_seconds() - cpu))
    print(
        json.dumps(
            {
                "bodies": len(omega0),
                "accuracy": accuracy,
                "threads": given.threads,
                "wall_s": min(wall for wall, _ in rounds),
                "cpu_s": min(cpu for _, cpu in rounds),
                "cold_s": cold,
                "error_m": heavy_top.error(final),
                "config": peer.config(),
            }
        )
    )


if __name__ == "__main__":
    main()
