"""One peer, one form, in a process of its own: `python -m peers.worker PEER FORM …` prints JSON."""

from __future__ import annotations

import time

START = time.time()  # before anything heavy is imported

import argparse  # noqa: E402
import importlib  # noqa: E402
import json  # noqa: E402
import os  # noqa: E402
import resource  # noqa: E402

os.environ["OPENBLAS_NUM_THREADS"] = "1"  # its idle threads spin, and slow down the next run


def cpu_seconds() -> float:
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


def timed(integrate, rounds: int) -> tuple[float, float, object]:
    """The best wall and CPU seconds of so many rounds, and what came out."""
    walls, cpus = [], []
    for _ in range(rounds):
        wall, cpu = time.perf_counter(), cpu_seconds()
        final = integrate()
        walls.append(time.perf_counter() - wall)
        cpus.append(cpu_seconds() - cpu)
    return min(walls), min(cpus), final


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("peer")
    parser.add_argument("form")
    parser.add_argument("--bodies", type=int, help="default: the form's own")
    parser.add_argument("--accuracy", type=float, help="default: the form's own")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--curve", action="store_true", help="also at the form's other accuracies")
    given = parser.parse_args()
    os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[: given.threads])

    peer = importlib.import_module(f"peers.{given.peer}")
    from peers import heavy_top

    reason = peer.available()
    if reason:
        print(json.dumps({"unavailable": reason}))
        return
    form = peer.FORMS[given.form]

    def measured(accuracy: float, bodies: int, rounds: int) -> dict[str, object]:
        integrate = peer.run(given.form, heavy_top.samples(bodies), accuracy, given.threads)
        integrate()
        cold = time.time() - START
        wall, cpu, final = timed(integrate, rounds)
        return {
            "bodies": bodies,
            "accuracy": accuracy,
            "wall_s": wall,
            "cpu_s": cpu,
            "cold_s": cold,
            "error_m": heavy_top.error(final),
        }

    accuracy = form.accuracy if given.accuracy is None else given.accuracy
    found = measured(accuracy, given.bodies or form.bodies, given.rounds)
    if given.curve:
        few = max(64, form.bodies // 4)
        found["curve"] = [measured(a, few, rounds=2) for a in form.accuracies]
    print(json.dumps({**found, "threads": given.threads, "config": peer.config()}))


if __name__ == "__main__":
    main()
