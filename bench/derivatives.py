"""CPU time of runs with derivatives as multiples of the same runs without them.

python bench/derivatives.py              print the table of docs/howto/derivatives.md

All runs of a row take turns in one process, on one thread; the least CPU times are compared. It
takes about four minutes, most of them to compile.
"""

from __future__ import annotations

import sys
import time
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import lierb

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))

from cases import top
from mechanisms.shared import double_pendulum

COUNT, REPEATS = 2048, 5
Run = partial[object]  # a call of lierb.integrate, or with adjoint=True of lierb.gradient


def runs() -> dict[str, tuple[Run, dict[int, list[str]]]]:
    """Return runs by title, each with the parameters of k directions."""
    problem, twist = top()
    spread = problem.joint.twist(omega=np.random.default_rng(0).normal(size=(COUNT, 3)))
    pendulum = double_pendulum()
    angles = np.linspace(0.0, 0.1, COUNT)[:, None]
    hanging = {"pose0": pendulum.pose({"upper": np.pi / 2 + angles})}
    hanging["twist0"] = pendulum.twist({}, pendulum.pose())
    of_body = {1: ["body.mass"], 3: ["omega0"], 12: ["omega0", "body.com", "body.inertia"]}
    of_links = {
        1: ["lower.body.mass"], 3: ["lower.body.com"],
        12: ["lower.omega0", "lower.body.com", "lower.body.inertia"],
    }  # fmt: skip

    def turning(**options: Any) -> Run:
        return partial(call, problem, twist0=twist + spread, t_end=0.99, **options)

    def swinging(**options: Any) -> Run:
        return partial(call, pendulum, **hanging, t_end=0.5, **options)

    def hanging_chain(links: int) -> Run:
        chain, start = swinging_chain(links, COUNT // 8)
        return partial(call, chain, **start, dt=1e-3, t_end=0.5, solver="looped")

    of_chain = {
        1: ["link0.body.mass"], 3: ["link1.body.com"],
        12: ["gravity", "link1.body.com", "link2.body.inertia"],
    }  # fmt: skip
    return {
        "heavy top, RK4, constant gain": (turning(dt=1e-3), of_body),
        "heavy top, RK4, saddle point": (turning(dt=1e-3, solver="saddle"), of_body),
        "heavy top, DOP853, rtol 1e-8": (turning(rtol=1e-8), of_body),
        "heavy top, Rodas4, rtol 1e-5": (turning(rtol=1e-5, method="Rodas4"), of_body),
        "heavy top, RATTLie": (turning(dt=1e-3, method="RATTLie"), of_body),
        "double pendulum, RK4": (swinging(dt=1e-3), of_links),
        "double pendulum, DOP853, rtol 1e-8": (swinging(rtol=1e-8), of_links),
        "chain of 8 links, RK4, looped": (hanging_chain(8), of_chain),
        "chain of 20 links, RK4, looped": (hanging_chain(20), of_chain),
    }


def call(model: Any, adjoint: bool = False, **run: Any) -> object:
    if adjoint:
        return lierb.gradient(model, "energy", "gravity", threads=1, **run)
    return lierb.integrate(model, threads=1, **run)


def swinging_chain(count: int, trajectories: int) -> tuple[lierb.Mechanism, dict[str, Any]]:
    """Return a chain of revolute links on a horizontal axis, and starts near the horizontal."""
    links = [
        lierb.Link(
            f"link{i}", lierb.bodies.rod(0.2, 0.01, mass=0.3),
            lierb.joints.revolute(
                axis=(0.0, 1.0, 0.0), body_point=(0.0, 0.0, 0.1),
                parent_point=(0.0, 0.0, -0.1 if i else 0.0),
            ),
            f"link{i - 1}" if i else "ground",
        )
        for i in range(count)
    ]  # fmt: skip
    chain = lierb.Mechanism(links, gravity=(0.0, 0.0, -9.81))
    pose0 = chain.pose({"link0": np.linspace(1.5, 1.6, trajectories)[:, None]})
    return chain, {"pose0": pose0, "twist0": chain.twist({}, pose0)}


def ratios(run: Run, parameters: dict[int, list[str]]) -> list[float]:
    """Return the CPU times with k directions and of the adjoint, as multiples of that without."""
    calls = [partial(run, with_respect_to=names) for names in ((), *parameters.values())]
    calls.append(partial(run, adjoint=True))
    for each in calls:
        each()  # compile
    least = [float("inf")] * len(calls)
    for _ in range(REPEATS):
        for i, each in enumerate(calls):
            began = time.process_time()
            each()
            least[i] = min(least[i], time.process_time() - began)
    return [seconds / least[0] for seconds in least[1:]]


def main() -> None:
    print(f"{lierb.info()['cpu']}, {COUNT} trajectories, one thread")
    print("| | k = 1 | 3 | 12 | adjoint |\n|---|---|---|---|---|")
    for title, (run, parameters) in runs().items():
        cells = [f"{ratio:.1f}" for ratio in ratios(run, parameters)]
        print(f"| {title} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
