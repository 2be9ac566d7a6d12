"""Measurements of the tables of docs/theory.md: `python bench/drift.py` stores them.

A test holds the page against the last stored run. It takes about two minutes.
"""

from __future__ import annotations

import json
import sys
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

import lierb

ROOT = Path(__file__).parent.parent
RESULTS = ROOT / "bench" / "results"
sys.path.insert(0, str(ROOT / "tests"))

from cases import BODY_FRAME, GRAVITY, GROUND_FRAME, box, joint, tilted  # noqa: E402

LIVELY = (2 * np.pi, np.pi, 0.2 * np.pi, 0.4, 0.3, -1.0)  # rad/s, m/s
NONE = (0.0, 0.0, 0.0)
KEPT = ("spherical", "revolute", "cylindrical", "screw", "planar", "helical_planar", "universal")
JOINTS = (*KEPT, "pin_in_slot")
ROUNDING = ("spherical", "revolute", "cylindrical", "screw", "planar")


def main() -> None:
    found = {
        "time": datetime.now(UTC).isoformat(timespec="seconds").removesuffix("+00:00"),
        "machine": {k: v for k, v in lierb.info().items() if k not in ("cache", "loaded")},
        "frames": {name: told(over_frames(name)) for name in KEPT},
        "drift": {name: told(drift(name)) for name in JOINTS},
        "rounding": {name: told(rounding(name)) for name in ROUNDING},
    }
    stamp = found["time"].replace(":", "")
    path = RESULTS / f"drift-{stamp}-{found['machine']['cpu']}.json"
    path.write_text(json.dumps(found, indent=1) + "\n")
    print(f"stored in {path.relative_to(ROOT)}")


def told(values: dict[str, list[float]]) -> dict[str, list[float]]:
    print({key: [f"{x:.1e}" for x in listed] for key, listed in values.items()}, flush=True)
    return values


def over_frames(name: str, count: int = 512) -> dict[str, list[float]]:
    """Median and largest position and rotation error, m and 1, of pairs of random frames."""
    rng = np.random.default_rng(0)
    frames = []
    for point in (GROUND_FRAME[:3, 3], BODY_FRAME[:3, 3]):
        frames.append(np.tile(np.eye(4), (count, 1, 1)))
        frames[-1][:, :3, :3] = Rotation.random(count, rng=rng).as_matrix()
        frames[-1][:, :3, 3] = point
    problem = lierb.Problem(box(), joint(name, *frames), GRAVITY)
    twists = problem.project(LIVELY)
    run = lierb.integrate(problem, twist0=twists, dt=1e-3, t_end=10.0, solver="saddle")
    return {
        kind: [float(np.median(errors)), float(errors.max())]
        for kind in ("position", "rotation")
        for errors in [run.summary[f"{kind}_error_max"].to_numpy()]
    }


def drift(name: str) -> dict[str, list[float]]:
    """Largest errors over 10 s in tilted frames at 10⁻² and 10⁻³ s, in both c-spaces.

    origin: on SO(3)×R³ with the joint at the body frame's origin.
    """
    gravity = NONE if name == "pin_in_slot" else GRAVITY
    at_origin = BODY_FRAME.copy()
    at_origin[:3, 3] = 0.0
    problem = lierb.Problem(box(), joint(name), gravity)
    central = lierb.Problem(box(), joint(name, body_frame=at_origin), gravity)
    cases = {
        "SE3": (problem, problem.project(LIVELY), "SE3"),
        "SO3xR3": (problem, problem.project(LIVELY), "SO3xR3"),
        "origin": (central, central.project(LIVELY), "SO3xR3"),
    }
    found = {}
    for label, (held, start, cspace) in cases.items():
        runs = [
            lierb.integrate(held, twist0=start, dt=dt, t_end=10.0, cspace=cspace, solver="saddle")
            for dt in (1e-2, 1e-3)
        ]
        for kind in ("position", "rotation"):
            errors = [run.summary[f"{kind}_error_max"][0].as_py() for run in runs]
            found[f"{label} {kind}"] = errors
    return found


def rounding(name: str) -> dict[str, list[float]]:
    """Largest position error, m, after 10⁵ and 10⁶ steps of 10⁻⁴ s; and ‖RᵀR − I‖."""
    problem, twist0 = tilted(name, NONE)
    found = {}
    for solver in ("saddle", "auto"):
        runs = [
            lierb.integrate(
                problem, twist0=twist0, dt=1e-4, t_end=t_end, solver=solver, measure_every=10
            )
            for t_end in (10.0, 100.0)
        ]
        for kind, column in (("", "position_error_max"), (" RᵀR", "orthogonality_error_max")):
            found[solver + kind] = [run.summary[column][0].as_py() for run in runs]
    return found


if __name__ == "__main__":
    main()
