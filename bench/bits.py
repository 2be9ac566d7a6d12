"""Comparison of two versions of lierb bit by bit: digests of many runs, written or compared.

    python bench/bits.py record before.json         with one version
    python bench/bits.py compare before.json        with another, on the same kind of CPU

The runs of one body are every joint on every c-space, both updates, four methods and every kind of
force, each from starts of its own: with histories, at tiny and at large angles, at another time,
with batched parameters, and going on from where another run ended. Adaptive steps, events and
controllers, mechanisms with and without stabilisation, and the studies of examples/ follow. A
quarter of an hour where nothing is compiled yet.
"""

from __future__ import annotations

import hashlib
import json
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from cases import RECORD, SUBGROUP_JOINTS, integrate, tilted
from clocks.shared import spread_tops, thrown, top_problem
from mechanisms.shared import double_pendulum, four_bar

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

    yield from clocked()
    yield from of_mechanisms()
    yield from of_studies()


@lierb.event(direction=0)
def upright(R):
    return R[2, 2] - 0.5


@lierb.event(direction=-1, terminal=True)
def landed(r):
    return r[2]


@lierb.controller(every=0.05)
def damper(t, omega):
    return {"torque": -0.2 * omega[2]}


@lierb.wrench
def damped(t, R, r, omega, v, params, controls):
    return (0.0, 0.0, controls.torque), (0.0, 0.0, 0.0)


CLOCKS: dict[str, dict[str, Any]] = {
    "DP54": {"rtol": 1e-7, "method": "DP54"},
    "DOP853": {"rtol": 1e-9},
    "RK4, looked at": {"dt": 1e-2},
}


def clocked() -> Iterator[tuple[str, Callable[[], lierb.Result]]]:
    """Adaptive steps, rows at given times, events and controllers of one body."""
    for name in lierb.joints.JOINTS:
        problem, twist = tilted(name)
        events = [upright()]
        watched = lierb.Problem(problem.body, problem.joint, problem.gravity, events=events)
        for way in ("SE3", "SO3xR3"):
            for clock, options in CLOCKS.items():
                given = {"twist0": STARTS * twist, "cspace": way, **options}
                yield f"{name}, {way}, {clock}: events", timed(watched, t_end=0.5, **given)
                if "rtol" in options:
                    saved = {"save_at": [0.1, 0.11, 0.4], "record": ["state", "multipliers"]}
                    yield (
                        f"{name}, {way}, {clock}: saved",
                        timed(problem, t_end=0.5, **given, **saved),
                    )
                    yield f"{name}, {way}, {clock}: continued", timed_on(problem, 0.2, 0.5, **given)
    steered = top_problem(forces=damped(), controllers=[damper()])
    for clock, options in CLOCKS.items():
        tops = {"twist0": spread_tops(20), **options}
        yield f"controller, {clock}", timed(steered, t_end=0.6, **tops)
        yield f"controller, {clock}: goes on", timed_on(steered, 0.23, 0.6, **tops)
        ball, start = thrown([1.0, 2.0, 4.0], [0.0, 1.0, -1.0], events=[landed()])
        yield f"landing, {clock}", timed(ball, t_end=3.0, **start, **options)


def timed(problem: Any, **options: Any) -> Callable[[], lierb.Result]:
    return lambda: lierb.integrate(problem, **options)


def timed_on(problem: Any, t: float, t_end: float, twist0: Any, **options: Any) -> Any:
    def run() -> lierb.Result:
        first = lierb.integrate(problem, twist0=twist0, t_end=t, **options)
        return lierb.integrate(problem, **first.end, t_end=t_end, **options)

    return run


WAYS: dict[str, dict[str, Any]] = {
    "joints": {},
    "SE3": {"cspace": "SE3"},
    "SO3xR3": {"cspace": "SO3xR3"},
}
STABILISED: dict[str, Any] = {
    "project": "project", "Baumgarte": lierb.baumgarte(5.0, 5.0)
}  # fmt: skip


def of_mechanisms() -> Iterator[tuple[str, Callable[[], lierb.Result]]]:
    """Trees and a loop, in each c-space, stabilised and not, with fixed and adaptive steps."""
    tree, loop = double_pendulum(), four_bar()
    speeds = np.array([0.1, 1.0, 3.0, -2.0, 5.0])
    closed = loop.close(loop.pose({"crank": 0.8, "coupler": -0.5, "rocker": 1.2}))
    starts = {
        "double pendulum": (tree, {"twist0": tree.twist({"upper": speeds, "lower": -speeds})}),
        "four-bar": (loop, {
            "pose0": closed,
            "twist0": loop.project(loop.twist({"crank": speeds}, closed), closed),
        }),
    }  # fmt: skip
    for name, (machine, start) in starts.items():
        for way, more in WAYS.items():
            yield f"{name}, {way}, RK4", timed(machine, dt=2e-3, t_end=0.2, **start, **more)
            yield (
                f"{name}, {way}, RK4: saved",
                timed(machine, dt=2e-3, t_end=0.2, save_every=7, record=RECORD, **start, **more),
            )
            for how in (None, *STABILISED):
                stabilise = STABILISED[how] if how else None
                options = {**more, "rtol": 1e-8, "stabilise": stabilise}
                yield (
                    f"{name}, {way}, {how}, adaptive",
                    timed(machine, t_end=0.3, **start, **options),
                )
            yield (
                f"{name}, {way}: goes on",
                lambda m=machine, s=start, o=more: mechanism_on(m, s, dt=2e-3, **o),
            )


def mechanism_on(machine: lierb.Mechanism, start: Any, **options: Any) -> lierb.Result:
    first = lierb.integrate(machine, t_end=0.1, **start, **options)
    return lierb.integrate(machine, **first.end, t_end=0.2, **options)


EXAMPLES = Path(__file__).parents[1] / "examples"
TABLES = ("summary", "history", "events")


def of_studies() -> Iterator[tuple[str, Callable[[], list[pa.Table]]]]:
    """The example studies, of a few trajectories each."""
    for study in sorted(EXAMPLES.glob("*.toml")):
        yield f"study {study.stem}", lambda study=study: study_tables(study)


def study_tables(study: Path) -> list[pa.Table]:
    with tempfile.TemporaryDirectory() as folder:
        dataset = lierb.run(study, out=Path(folder) / "out", changes={"sample.n": 24})
        named = [name for name in TABLES if (dataset.folder / name).is_dir()]
        return [dataset.table(name).to_table() for name in named]


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


def digest(result: lierb.Result | list[pa.Table]) -> str:
    """Digest of every number and word of a result's tables, and of its continuation's start."""
    sha = hashlib.sha256()
    is_result = isinstance(result, lierb.Result)
    tables = [result.summary, result.history, result.events] if is_result else result
    for table in tables:
        for name in table.column_names if table is not None else ():
            column = table[name].combine_chunks()
            sha.update(name.encode())
            sha.update(numbers(column))
    goes_on = is_result and set(result.summary["status"].to_pylist()) == {"ok"}
    for name, value in sorted(result.end.items()) if goes_on else ():
        for part in value.values() if isinstance(value, dict) else [value]:
            sha.update(name.encode() + np.asarray(part, dtype=float).tobytes())
    return sha.hexdigest()


def numbers(column: pa.Array) -> bytes:
    while isinstance(column, pa.FixedSizeListArray):
        column = column.flatten()
    if pa.types.is_floating(column.type) or pa.types.is_integer(column.type):
        return column.to_numpy(zero_copy_only=False).tobytes()
    return json.dumps(column.to_pylist(), default=str).encode()


def recorded() -> dict[str, str]:
    digests = {}
    for name, run in runs():
        print(f"\r{len(digests):4} {name:70}", end="", file=sys.stderr)
        try:
            digests[name] = digest(run())
        except LierbError as error:
            digests[name] = f"{type(error).__name__}: {error}"
    print(file=sys.stderr)
    return digests


def main() -> int:
    try:
        _, deed, file = sys.argv
        act = {"record": record, "compare": compare}[deed]
    except (KeyError, ValueError):
        print(__doc__, file=sys.stderr)
        return 2
    warnings.simplefilter("ignore")  # of bodies that fail, and functions that run body by body
    return act(Path(file), recorded())


def record(file: Path, digests: dict[str, str]) -> int:
    file.write_text(json.dumps(digests, indent=1, ensure_ascii=False))
    failed = sum(":" in digest for digest in digests.values())
    print(f"{len(digests)} runs, {failed} of them refused")
    return 0


def compare(file: Path, digests: dict[str, str]) -> int:
    before = json.loads(file.read_text())
    shared = before.keys() & digests.keys()
    other = [name for name in digests if name in shared and before[name] != digests[name]]
    for name in other:
        print(f"other bits: {name}")
    for name in sorted(before.keys() ^ digests.keys()):
        print(f"only {'before' if name in before else 'now'}: {name}")
    print(f"{len(shared) - len(other)} of {len(digests)} runs have the same bits")
    return int(bool(other) or before.keys() != digests.keys())


if __name__ == "__main__":
    sys.exit(main())
