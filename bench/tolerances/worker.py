"""One peer, one form, one batch: `python -m tolerances.worker PEER FORM BATCH` prints JSON."""

from __future__ import annotations

import argparse
import importlib
import json
import os
from collections.abc import Callable

import numpy as np
from peers import heavy_top as top
from peers.heavy_top import Final
from peers.worker import timed

from tolerances.tops import COUNT, Errors, errors, samples

TARGETS = (1e-6, 1e-9, 1e-12)  # m
CLOSE = 0.7  # an error of so much of the wanted one is close enough
MOST_TRIES = 12
ROUNDS = 3


def tuned(
    solved: Callable[[float], Final], batch: str, wanted: float, is_fixed: bool, order: int
) -> tuple[float, Errors]:
    """The loosest tolerance found (or the longest step) whose largest error is the wanted one.

    Raises RuntimeError where none reaches it.
    """
    given = 0.01 if is_fixed else wanted
    within, beyond = None, None  # (accuracy, errors) on either side of what is wanted
    for _ in range(MOST_TRIES):
        found = errors(batch, solved(given))
        if found.largest <= wanted:
            within = max(within or (given, found), (given, found))
            if found.largest >= CLOSE * wanted:
                break
        else:
            beyond = min(beyond or given, given)
        off = wanted * (1 + CLOSE) / 2 / max(found.largest, 1e-3 * wanted)
        off = off if np.isfinite(off) else 1e-3
        given *= float(np.clip(off ** (1 / order if is_fixed else 1.0), 1e-2, 1e2))
        if within and beyond and not within[0] < given < beyond:
            given = float(np.sqrt(within[0] * beyond))
        if within and beyond and beyond / within[0] < 1.02:
            break
        if is_fixed:
            given = top.T_END / np.ceil(top.T_END / given)
        elif given < 1e-17:
            break
    if within is None:
        raise RuntimeError(f"no tolerance reaches {wanted:g} m")
    return within


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("peer")
    parser.add_argument("form")
    parser.add_argument("batch")
    given = parser.parse_args()
    os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:1])
    peer = importlib.import_module(f"peers.{given.peer}")
    form = peer.FORMS[given.form]
    omega0 = samples(given.batch)
    times = max(1, form.bodies // 4 // COUNT)  # so often are the tops in a timed call
    many = np.tile(omega0, (times, 1))
    is_fixed = not form.adaptive

    def solved(accuracy: float) -> Final:
        return peer.run(given.form, omega0, accuracy, 1)()

    found: dict[str, object] = {"tops": COUNT * times, "config": peer.config()}
    for wanted in TARGETS:
        try:
            accuracy, off = tuned(solved, given.batch, wanted, is_fixed, order=8)
            integrate = peer.run(given.form, many, accuracy, 1)
            integrate()
            wall, cpu, _ = timed(integrate, ROUNDS)
            found[f"{wanted:g}"] = {
                "accuracy": accuracy, "largest_m": off.largest, "median_m": off.median,
                "wall_us": wall / (COUNT * times) * 1e6, "cpu_us": cpu / (COUNT * times) * 1e6,
            }  # fmt: skip
            if hasattr(peer, "work"):
                found[f"{wanted:g}"] |= peer.work(given.form, many, accuracy)
        except RuntimeError as error:
            found[f"{wanted:g}"] = {"failed": str(error)}
    print(json.dumps(found))


if __name__ == "__main__":
    main()
