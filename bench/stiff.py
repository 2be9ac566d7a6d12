"""Rosenbrock methods beside explicit ones on stiff problems, for docs/howto/stiff.md.

python bench/stiff.py       measure, store, print the table

All methods run in turn in one process, on one thread; the least CPU times are compared. It takes
half a minute.
"""

from __future__ import annotations

import json
import time
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

import lierb

RESULTS = Path(__file__).parent / "results"
COUNT, REPEATS = 64, 3
MASS, MOMENTS = 6.075, (0.0126563, 0.0468281, 0.0569531)
POINT = np.array((-0.15, 0.0375, 0.0))
GRAVITY = (0.0, 0.0, -9.81)
RUNS = {  # method and rtol, with which errors are below 1e-5 rad
    "Rodas4": 1e-4, "Rodas5P": 1e-4, "DOP853": 1e-4, "BS32": 1e-4,
}  # fmt: skip


def bushing(frequency: float) -> tuple[lierb.Problem, dict[str, Any]]:
    """Tops on a bushing of this natural frequency, rad/s, with half its critical damping."""
    k, c = 2.0 * frequency**2, 2.0 * frequency
    force = lierb.forces.bushing(POINT, stiffness=(0, 0, 0, k, k, k), damping=(0, 0, 0, c, c, c))
    top = lierb.Problem(lierb.Body(MASS, MOMENTS), lierb.joints.free(), GRAVITY, force)
    rng = np.random.default_rng(0)
    omega = np.array((6.28, 3.14, 0.63)) + rng.normal(scale=0.5, size=(COUNT, 3))
    pose = np.tile(np.eye(4), (COUNT, 1, 1))
    pose[:, :3, 3] = -POINT
    twist = np.concatenate([omega, np.cross(omega, -POINT)], axis=1)
    return top, {"pose0": pose, "twist0": twist, "t_end": 1.0}


def friction(speed: float) -> tuple[lierb.Problem, dict[str, Any]]:
    """Wheels braked by Coulomb's friction, smooth below this speed, rad/s."""
    hinge = lierb.joints.revolute()
    force = lierb.forces.joint_friction(coulomb=0.1, speed=speed)
    wheel = lierb.Problem(lierb.Body(1.0, (0.02, 0.02, 0.02)), hinge, forces=force)
    omega = np.zeros((COUNT, 3))
    omega[:, 2] = np.linspace(2.0, 4.0, COUNT)
    return wheel, {"twist0": hinge.twist(omega=omega), "t_end": 2.0}


PROBLEMS = {
    **{f"bushing, {w:g} rad/s": (bushing, w) for w in (1e3, 1e4, 1e5)},
    **{f"friction, smooth below {s:g} rad/s": (friction, s) for s in (1e-2, 1e-4, 1e-6)},
}


def rotation(result: lierb.Result) -> np.ndarray:
    return np.array(result.summary["rotation"].to_pylist()).reshape(COUNT, 9)


def measured(title: str) -> list[dict[str, Any]]:
    make, size = PROBLEMS[title]
    problem, start = make(size)
    truth = rotation(lierb.integrate(problem, rtol=1e-10, method="Rodas5P", **start))
    found: dict[str, dict[str, Any]] = {}
    for repeat in range(REPEATS):
        for method, rtol in RUNS.items():
            begun = time.thread_time()
            result = lierb.integrate(
                problem, method=method, rtol=rtol, threads=1, progress=False, **start
            )
            seconds = time.thread_time() - begun
            if repeat == 0:  # compiles
                found[method] = {
                    "problem": title, "method": method, "rtol": rtol, "seconds": np.inf,
                    "steps": float(np.mean(result.summary["steps"].to_pylist())),
                    "error": float(np.abs(rotation(result) - truth).max()),
                }  # fmt: skip
            else:
                found[method]["seconds"] = min(found[method]["seconds"], seconds)
    return list(found.values())


def table(rows: list[dict[str, Any]]) -> str:
    """Markdown table: steps, and CPU time in multiples of Rodas4's."""
    lines = ["|  | " + " | ".join(RUNS) + " |", "|" + " --- |" * (len(RUNS) + 1)]
    for title in PROBLEMS:
        own = {row["method"]: row for row in rows if row["problem"] == title}
        cells = (
            f"{own[m]['seconds'] / own['Rodas4']['seconds']:.2g} ({own[m]['steps']:.3g})"
            for m in RUNS
        )
        lines.append(f"| {title} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def main() -> None:
    rows = [row for title in PROBLEMS for row in measured(title)]
    machine = {k: v for k, v in lierb.info().items() if k not in ("cache", "loaded")}
    name = f"stiff-{datetime.now(UTC):%Y-%m-%dT%H%M%S}-{machine['cpu']}.json"
    text = json.dumps({"machine": machine, "rows": rows}, indent=1)
    (RESULTS / name).write_text(text + "\n", encoding="utf-8")
    print(name)
    print(max(row["error"] for row in rows))
    print(table(rows))


if __name__ == "__main__":
    main()
