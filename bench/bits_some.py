"""Whether two versions of lierb give the same bits: digests of many runs, written or compared.

    python bench/bits.py record before.json         with one version
    python bench/bits.py compare before.json        with another, on the same kind of CPU

The runs are every joint on every c-space, both updates, four methods and every kind of force, each
from starts of its own: with histories, at tiny and at large angles, at another time, with batched
parameters, and going on from where another run ended. Some minutes where nothing is compiled yet.
"""

from __future__ import annotations

import hashlib
import json
import sys
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from cases import SUBGROUP_JOINTS, integrate, tilted

import lierb
from lierb import forces
from lierb.errors import LierbError

POINT, ANCHOR = (0.05, 0.02, 0.01), (0.1, 0.2, 0.3)
LARGE = 0.05  # s, a step of large angles
STARTS = np.array([[1e-3], [0.3], [1.0], [-0.7], [2.0]])  # times a lively twist


@lierb.wrench(rate=3.0)
def swaying(t, R, r, omega, v, params):
    force = R.T @ np.array((np.sin(params.rate * t), 0.0, 1.0)) - 0.1 * v
    return -0.01 * omega, force


@lierb.wrench(limit=1.0)
def limited(t, R, r, omega, v, params):
    drag = np.zeros(3)
    for i in range(3):
        if abs(omega[i]) > params.limit:
            drag[i] = -0.01 * omega[i]
    return drag, np.zeros(3)


@lierb.constraint
def level(R, r):
    return R[2, 0] * R[2, 1] - 0.05


FORCES: dict[str, tuple[str, Callable[[], Any]]] = {
    "constant wrench": ("free", lambda: forces.constant_wrench((0.01, 0.0, 0.02), (0.0, 1.0, 0.0))),
    "thruster": ("revolute", lambda: forces.constant_wrench(force=(0.0, 0.0, 2.0), frame="body")),
    "spring": (
        "spherical",
        lambda: forces.spring_damper(POINT, ANCHOR, stiffness=20.0, damping=0.5, length=0.1),
    ),
    "torsional spring": ("revolute", lambda: forces.torsional_spring(stiffness=2.0, damping=0.1)),
    "drag": ("planar", lambda: forces.drag(0.1, 0.2, angular=0.01, point=POINT)),
    "torque": ("cylindrical", lambda: forces.motor(torque=0.1)),
    "speed": ("screw", lambda: forces.motor(speed=1.0)),
    "traced function": ("spherical", swaying),
    "traced function, free": ("free", swaying),
    "compiled function": ("revolute", limited),
    "constraint": ("spherical", level),
}


def settings() -> Iterator[tuple[str, lierb.Problem, np.ndarray, dict[str, Any]]]:
    """Name, problem, lively twist and options of every plan."""
    methods = {"RK4": "local", "Heun": "global"}
    for name in lierb.joints.JOINTS:
        problem, twist = tilted(name)
        ways: dict[str, dict[str, Any]] = {
            "SE3": {}, "saddle": {"solver": "saddle"}, "SO3xR3": {"cspace": "SO3xR3"},
        }  # fmt: skip
        if not (problem.joint.subgroup and problem.joint.rows):
            del ways["saddle"]  # is the same
        for (method, update), (way, options) in (
            (m, w) for m in methods.items() for w in ways.items()
        ):
            run = {"method": method, "update": update, **options}
            yield f"{name}, {way}, {method}, {update}", problem, twist, run
    for name in SUBGROUP_JOINTS:
        problem, twist = tilted(name)
        if problem.joint.rows:
            yield f"{name}, reduced", problem, twist, {"cspace": "reduced"}
    for name, cspace in (("spherical", "SE3"), ("universal", "SE3"), ("revolute", "SO3xR3")):
        for method in ("Euler", "RK38", "DOP853"):
            problem, twist = tilted(name)
            yield f"{name}, {cspace}, {method}", problem, twist, {
                "method": method, "cspace": cspace, "solver": "saddle",
            }  # fmt: skip
    for what, (name, make) in FORCES.items():
        plain, _ = tilted(name)
        force = make()
        added = {"constraints" if what == "constraint" else "forces": [force]}
        problem = lierb.Problem(plain.body, plain.joint, plain.gravity, **added)
        twist = problem.project(tilted(name)[1])
        for way in ("auto", "saddle"):
            yield f"{what}, {way}", problem, twist, {"solver": way}


def runs() -> Iterator[tuple[str, Callable[[], lierb.Result]]]:
    """Name of every run, and what makes it."""
    for name, problem, twist, options in settings():
        if "speed" in name or problem.constraints:  # whose starts are no multiples of each other
            options["check"] = "off" if problem.constraints else "raise"
            yield f"{name}: small steps", go(problem, twist, dt=1e-3, steps=40, **options)
            yield f"{name}: large steps", go(problem, twist, dt=1e-2, steps=35, **options)
            continue
        starts, few = STARTS * twist, {"save_every": 3, "measure_every": 2}
        yield f"{name}: small steps", go(problem, starts, dt=1e-3, steps=40, **(options | few))
        yield f"{name}: large steps", go(problem, starts, dt=LARGE, steps=35, **options)
        yield f"{name}: heavier", go(heavier(problem), starts, dt=1e-2, steps=20, **options)
        yield f"{name}: goes on", goes_on(problem, starts, dt=1e-2, **options)


def heavier(problem: lierb.Problem) -> lierb.Problem:
    """Five bodies of other masses and inertias, in another gravity."""
    more = np.linspace(1.0, 3.0, len(STARTS))
    body = problem.body
    inertia = more[:, None, None] * body.inertia
    other = lierb.Body(more * body.mass, inertia, com=body.com)
    gravity = np.outer(more, (0.1, 0.2, -3.0))
    return lierb.Problem(other, problem.joint, gravity, [*problem.forces])


def go(problem: Any, twist: Any, *, steps: int, dt: float, **options: Any) -> Any:
    return lambda: integrate(problem, twist0=twist, dt=dt, t_end=steps * dt, **options)


def goes_on(problem: Any, twist: Any, *, dt: float, **options: Any) -> Any:
    def run() -> lierb.Result:
        first = integrate(problem, twist0=twist, t0=1.0, dt=dt, t_end=1.0 + 7 * dt, **options)
        return integrate(problem, **first.end, dt=dt, t_end=1.0 + 20 * dt, **options)

    return run


def digest(result: lierb.Result) -> str:
    """Of every number and word of a result's tables, and of how a run goes on from it."""
    found = hashlib.sha256()
    for table in (result.summary, result.history):
        for name in table.column_names if table is not None else ():
            column = table[name].combine_chunks()
            found.update(name.encode())
            found.update(numbers(column))
    for name, value in sorted(result.end.items()) if not len(result.failed) else ():
        found.update(name.encode() + np.asarray(value, dtype=float).tobytes())
    return found.hexdigest()


def numbers(column: pa.Array) -> bytes:
    while isinstance(column, pa.FixedSizeListArray):
        column = column.flatten()
    if pa.types.is_floating(column.type) or pa.types.is_integer(column.type):
        return column.to_numpy(zero_copy_only=False).tobytes()
    return json.dumps(column.to_pylist(), default=str).encode()


def recorded() -> dict[str, str]:
    found = {}
    import os

    k = int(os.environ.get("EVERY", "1"))
    kernels = {}
    for name, run in runs():
        plan = name.split(":")[0]
        if kernels.setdefault(plan, len(kernels)) % k != 3:
            continue
        print(f"\r{len(found):4} {name:70}", end="", file=sys.stderr)
        try:
            found[name] = digest(run())
        except LierbError as error:
            found[name] = f"{type(error).__name__}: {error}"
    print(file=sys.stderr)
    return found


def main() -> int:
    try:
        _, deed, file = sys.argv
        act = {"record": record, "compare": compare}[deed]
    except (KeyError, ValueError):
        print(__doc__, file=sys.stderr)
        return 2
    warnings.simplefilter("ignore")  # of bodies that fail, and functions that run body by body
    return act(Path(file), recorded())


def record(file: Path, found: dict[str, str]) -> int:
    file.write_text(json.dumps(found, indent=1, ensure_ascii=False))
    failed = sum(":" in digest for digest in found.values())
    print(f"{len(found)} runs, {failed} of them refused")
    return 0


def compare(file: Path, found: dict[str, str]) -> int:
    before = json.loads(file.read_text())
    shared = before.keys() & found.keys()
    other = [name for name in found if name in shared and before[name] != found[name]]
    for name in other:
        print(f"other bits: {name}")
    for name in sorted(found.keys() - before.keys()):
        print(f"only {'before' if name in before else 'now'}: {name}")
    print(f"{len(shared) - len(other)} of {len(found)} runs have the same bits")
    return int(bool(other) or before.keys() != found.keys())


if __name__ == "__main__":
    sys.exit(main())
