"""Local and ambient updates side by side, for docs/howto/choosing.md.

python bench/updates.py                  measure, store, write the table into the page
python bench/updates.py --report FILE    the same with a stored run

Both updates run in turn in one process, on one thread; the least CPU times are compared. A test
holds the page against the last stored run. It takes about three minutes.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
import time
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

import lierb

ROOT = Path(__file__).parent.parent
RESULTS = ROOT / "bench" / "results"
PAGE = ROOT / "docs" / "howto" / "choosing.md"
sys.path.insert(0, str(ROOT / "tests"))

from clocks.truths import problem_of  # noqa: E402

COUNT, REPEATS = 2048, 15
UPDATES = ("local", "ambient")
ORDERS = {"RK4": 4, "DOP853": 8}


@dataclass(frozen=True)
class Motion:
    """title : in the table.   t_end : s.   steps : of each method, in a run.   cspace : of it."""

    title: str
    t_end: float
    steps: dict[str, int]
    cspace: str = "SE3"


MOTIONS = {
    "heavy_top": Motion("heavy top, 7 rad/s, spherical joint", 1.0, {"RK4": 256, "DOP853": 32}),
    "pendulum": Motion("box on a hinge, 7 rad/s", 1.0, {"RK4": 256, "DOP853": 32}),
    "universal": Motion("box on a universal joint", 1.0, {"RK4": 256, "DOP853": 32}),
    "free_body": Motion("free body that tumbles", 4.0, {"RK4": 256, "DOP853": 32}),
    "fast_top": Motion("heavy top, 150 rad/s", 0.5, {"RK4": 2048, "DOP853": 256}),
    "spinner": Motion("free body that spins at 150 rad/s", 0.5, {"RK4": 2048, "DOP853": 256}),
}


def problem(name: str) -> tuple[lierb.Problem, np.ndarray]:
    if name == "spinner":
        body = lierb.Body(15.0, np.diag((0.234375, 0.234375, 0.46875)))
        return lierb.Problem(body, lierb.joints.free()), np.array((0.5, 0.0, 150.0, 0.0, 0.0, 0.0))
    held, twist = problem_of("heavy_top" if name == "pendulum" else name)
    if name == "pendulum":
        hinge = lierb.joints.revolute(body_point=held.joint.body_frame[:3, 3], axis=(1.0, 0.0, 0.0))
        held = lierb.Problem(held.body, hinge, held.gravity)
        twist = hinge.twist(velocities=(7.0,))
    return held, twist


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--report", type=Path)
    path = parser.parse_args().report or measured()
    stored = json.loads(path.read_text(encoding="utf-8"))
    text = embedded(PAGE.read_text(encoding="utf-8"), stored, path.stem)
    PAGE.write_text(text, encoding="utf-8")
    print(table(stored))


def measured() -> Path:
    found = {
        "time": datetime.now(UTC).isoformat(timespec="seconds").removesuffix("+00:00"),
        "machine": {k: v for k, v in lierb.info().items() if k not in ("cache", "loaded")},
        "runs": {name: runs(name, motion) for name, motion in MOTIONS.items()},
    }
    stamp = found["time"].replace(":", "")
    path = RESULTS / f"updates-{stamp}-{found['machine']['cpu']}.json"
    path.write_text(json.dumps(found, indent=1) + "\n")
    return path


def runs(name: str, motion: Motion) -> dict[str, dict[str, dict[str, float]]]:
    """CPU time, s, and largest error of rotation, rad, by method and update."""
    held, twist = problem(name)
    factors = 1.0 + 0.05 * np.random.default_rng(0).standard_normal((COUNT, 1))
    start: dict[str, Any] = {
        "twist0": factors * twist, "t_end": motion.t_end, "cspace": motion.cspace, "threads": 1,
    }  # fmt: skip
    true = lierb.integrate(held, **start, rtol=1e-13, method="Verner98").rotation
    ways: dict[str, dict[str, Any]] = {
        method: {"method": method, "dt": motion.t_end / steps}
        for method, steps in motion.steps.items()
    }
    ways["DOP853, adaptive"] = {"method": "DOP853", "rtol": 1e-8}
    found: dict[str, dict[str, dict[str, float]]] = {}
    for way, options in ways.items():
        found[way] = {}
        for update in UPDATES:
            run = lierb.integrate(held, **start, **options, update=update)
            error = np.linalg.norm(run.rotation - true, axis=(1, 2)).max() / np.sqrt(2.0)
            found[way][update] = {"error": float(error), "cpu_time": np.inf}
        for _ in range(REPEATS):
            for update in UPDATES:
                begin = time.process_time()
                lierb.integrate(held, **start, **options, update=update)
                spent = time.process_time() - begin
                found[way][update]["cpu_time"] = min(spent, found[way][update]["cpu_time"])
        print(name, way, found[way], flush=True)
    return found


def table(stored: dict[str, Any]) -> str:
    """Time, error, and time at equal error of the ambient update, over those of the local one."""
    lines = [
        "|  | method | time of a step | error | time at equal error |",
        "| --- | --- | --- | --- | --- |",
    ]
    for name, of_motion in stored["runs"].items():
        for way, both in of_motion.items():
            cost, error = (both["ambient"][of] / both["local"][of] for of in ("cpu_time", "error"))
            order = ORDERS[way.split(",")[0]]
            cells = [MOTIONS[name].title, way]
            cells += [f"{x:.2g}" for x in (cost, error, cost * error ** (1.0 / order))]
            lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def embedded(text: str, stored: dict[str, Any], stem: str) -> str:
    """Page with the table, and links to the stored run."""
    block = re.compile(r"(<!-- updates -->\n).*?(\n<!-- /updates -->)", re.DOTALL)
    text = block.sub(lambda found: f"{found[1]}\n{table(stored)}\n{found[2]}", text)
    return re.sub(r"updates-[\w-]+(?=\.json)", stem, text)


if __name__ == "__main__":
    main()
