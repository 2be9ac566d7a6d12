"""`lierb.predict` against the measured drift of many mechanisms: `python bench/predictions.py`.

Measures and stores what docs/theory.md tells; a test holds the page and the predictions of today
against the last stored run. Every mechanism in every c-space is a compiled integrator of its own:
it takes about half an hour on one core. Names of shapes as arguments: those alone, not stored.
"""

from __future__ import annotations

import json
import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

import lierb

ROOT = Path(__file__).parent.parent
RESULTS = ROOT / "bench" / "results"
sys.path.insert(0, str(ROOT / "tests"))

from mechanisms import samples  # noqa: E402

KINDS = ("position", "rotation")
METHOD, ORDER = "Heun", 2
STEPS, T_END = (2e-3, 1e-3), 0.1  # s
COUNT = 8  # random mechanisms of every shape
SEED = 7
# Between these no error is found: what is kept is off by rounding, what drifts by the method's.
ROUNDING, DRIFT = 1e-13, 1e-12

NAMES = list(lierb.joints.JOINTS)
# Every joint on the ground and every one between moving bodies, and pairs that move together.
PAIRS = [(name, NAMES[(k + 7) % len(NAMES)]) for k, name in enumerate(NAMES)] + [
    ("revolute", "revolute"), ("spherical", "spherical"), ("universal", "universal"),
    ("free", "fixed"), ("spherical", "fixed"), ("planar", "prismatic"), ("free", "translation"),
    ("planar", "planar"), ("prismatic", "revolute"), ("schoenflies", "schoenflies"),
]  # fmt: skip
# Two links, and what holds the second one to the ground.
LOOPS = [
    ("revolute", "spherical", "point_on_plane"), ("revolute", "universal", "point_on_sphere"),
    ("spherical", "spherical", "spherical"), ("prismatic", "spherical", "point_on_line"),
    ("planar", "cylindrical", "point_on_plane"), ("free", "prismatic", "planar"),
    ("translation", "revolute", "schoenflies"), ("prismatic", "prismatic", "translation"),
    ("planar", "spherical", "constant_velocity"), ("cylindrical", "hook", "spherical"),
]  # fmt: skip


def shapes() -> dict[str, samples.Shape]:
    """Mechanisms: trees and loops of the tests, and many of two links."""
    shapes_by_name = dict(samples.SHAPES)
    for first, last in PAIRS:
        shapes_by_name[f"{first}, {last}"] = samples.Shape(((first, None), (last, 0)))
    for first, last, loop in LOOPS:
        links = ((first, None), (last, 0))
        shapes_by_name[f"{first}, {last}; {loop}"] = samples.Shape(links, ((loop, 1, None),))
    return shapes_by_name


def mechanisms(name: str) -> tuple[lierb.Mechanism, dict[str, Any]]:
    """COUNT of a shape, bodies' frames at their centres of mass, and how they start."""
    samples.SHAPES.setdefault(name, shapes()[name])
    rng = np.random.default_rng([SEED, *name.encode()])
    mechanism, sample = samples.random_mechanism(rng, name, n=COUNT, centred=True)
    return mechanism, samples.start_of(sample)


def predicted(name: str) -> dict[str, dict[str, dict[str, bool]]]:
    """Predicted exactness by c-space, joint and kind of error, of the first one of a shape."""
    mechanism, start = mechanisms(name)
    pose0 = {link: pose[0] for link, pose in start["pose0"].items()}
    predictions = lierb.predict(mechanism.of_body(0), pose0)
    return {
        cspace: {
            joint: {kind: getattr(p, f"{kind}_exact") for kind in KINDS}
            for joint, p in joints.items()
        }
        for cspace, joints in predictions.items()
    }


def measured(name: str, cspace: str) -> dict[str, dict[str, dict[str, float]]]:
    """Least, median and largest error of the smaller step, and its order, by joint and kind."""
    mechanism, start = mechanisms(name)
    runs = []
    for dt in STEPS:
        run = lierb.integrate(
            mechanism, **start, dt=dt, t_end=T_END, cspace=cspace, method=METHOD
        ).summary
        assert set(run["status"].to_pylist()) == {"ok"}, (name, cspace)
        runs.append(run)
    joints = [each.name for each in mechanism.links_and_loops]
    return {
        joint: {
            kind: _told(*(run[f"{joint}.{kind}_error_max"].to_numpy() for run in runs))
            for kind in KINDS
        }
        for joint in joints
    }


def _told(coarse: np.ndarray, fine: np.ndarray) -> dict[str, float]:
    with np.errstate(divide="ignore", invalid="ignore"):
        order = float(np.median(np.log2(coarse / fine)))
    return {
        "least": float(fine.min()), "median": float(np.median(fine)), "largest": float(fine.max()),
        "order": order if np.isfinite(order) else 0.0,
    }  # fmt: skip


def agrees(is_exact: bool, errors: dict[str, float]) -> bool:
    """Return whether a verdict agrees with the measurement."""
    if is_exact:
        return errors["largest"] < ROUNDING
    return errors["least"] > DRIFT and errors["order"] > ORDER - 0.2


def compared(name: str) -> dict[str, Any]:
    """Verdicts and errors of a shape in every c-space."""
    verdicts = predicted(name)
    found = {}
    for cspace, joints in verdicts.items():
        errors = measured(name, cspace)
        found[cspace] = {
            joint: {kind: {"exact": exact[kind], **errors[joint][kind]} for kind in KINDS}
            for joint, exact in joints.items()
        }
    return found


def disagreements(verdicts: dict[str, Any]) -> list[str]:
    return [
        f"{cspace} {joint} {kind}: {told}"
        for cspace, joints in verdicts.items()
        for joint, kinds in joints.items()
        for kind, told in kinds.items()
        if not agrees(told["exact"], told)
    ]


def main() -> None:
    asked = sys.argv[1:] or list(shapes())
    results = {
        "time": datetime.now(UTC).isoformat(timespec="seconds").removesuffix("+00:00"),
        "machine": {k: v for k, v in lierb.info().items() if k not in ("cache", "loaded")},
        "method": METHOD, "dt": STEPS, "t_end": T_END, "count": COUNT, "mechanisms": {},
    }  # fmt: skip
    for number, name in enumerate(asked, 1):
        results["mechanisms"][name] = compared(name)
        wrong = disagreements(results["mechanisms"][name])
        print(f"{number}/{len(asked)} {name}: {wrong or 'agrees'}", flush=True)
    if sys.argv[1:]:
        return
    stamp = results["time"].replace(":", "")
    path = RESULTS / f"predictions-{stamp}-{results['machine']['cpu']}.json"
    path.write_text(json.dumps(results, indent=1) + "\n")
    print(f"stored in {path.relative_to(ROOT)}")


if __name__ == "__main__":
    main()
