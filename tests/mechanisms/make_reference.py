"""Make `reference.json`: every benchmark in minimal coordinates, and how far the oracle agrees.

    python -m mechanisms.make_reference            # in tests/, of all; minutes
    python -m mechanisms.make_reference A03 rssr   # of some

y is found in minimal coordinates in extended precision (`mechanisms.minimal`). `agreement` says, by
time, how far another way is from that: the oracle in maximal coordinates (the largest difference of
positions in m, rotations, and velocities in m/s and rad/s of all links, relative to 1 + the largest
of its kind), the elliptic functions of A01 and A02 (of the sine and cosine), and what is published
(relative). `error of a step` is the largest estimate that either integration has taken.
"""

import json
import sys
from pathlib import Path

import mpmath
import numpy as np

from mechanisms import oracle
from mechanisms.benchmarks import A03_PUBLISHED, BENCHMARKS, Benchmark, a02_square
from mechanisms.minimal import REAL, LinkState, pendulum_from_rest, pendulum_over_the_top
from mechanisms.samples import description_of

PATH = Path(__file__).with_name("reference.json")
ORACLE_STEPS = {"A03": (3e-4, 1e-11)}  # the longest, s, and what they may be off by
ORACLE_UNTIL = 1.0  # s: the oracle takes long, and says nothing beyond a singular place


def off(found: list[LinkState], other: list[LinkState], free_axis=()) -> float:
    """The largest difference of two states of all links, relative to 1 + the size of its kind."""
    worst = 0.0
    for i, (a, b) in enumerate(zip(found, other, strict=True)):
        shown, across = slice(None), np.eye(3)
        if i in free_axis:
            shown, across = slice(2, 3), np.eye(3) - np.outer(a.R[:, 2], a.R[:, 2])
        pairs = [
            (a.x, b.x),
            (a.R[:, shown], b.R[:, shown]),
            (a.v, b.v),
            (across @ a.w, across @ b.w),
        ]
        for x, y in pairs:
            size = 1.0 + float(np.max(np.abs(x)))
            worst = max(worst, float(np.max(np.abs(x - y))) / size)
    return worst


def by_oracle(given: Benchmark, times: list[float], longest: float, tolerance: float):
    """States of the links at the times, in maximal coordinates, and the error of a step."""
    description = description_of(given.mechanism)
    stacked = [
        np.stack([given.start[k][link.name] for link in given.mechanism.links])[None]
        for k in ("pose0", "twist0")
    ]
    moved = oracle.motion(description, *stacked, [0.0, *times], longest, tolerance)
    found = []
    for state in moved.states[1:]:
        R = oracle.matrix_of(state[0, :, 3:7])
        found.append([LinkState(s[:3], R[i], s[7:10], s[10:]) for i, s in enumerate(state[0])])
    return found, moved.error


def closed_form(name: str, times) -> list | None:
    """A01: (cos θ, sin θ); A02: (sin φ, cos φ); at the times."""
    if name == "A01":  # φ = θ + π/2 from hanging starts at −π/2: (cos θ, sin θ) = (sin φ, −cos φ)
        with mpmath.workdps(40):
            w0 = mpmath.sqrt(mpmath.mpf("9.81"))
        return [(-s, -c) for s, c in pendulum_from_rest(times, w0, mpmath.pi / 2)]
    if name.startswith("A02"):
        return pendulum_over_the_top(times, a02_square(int(name.split("_")[1])), 1)
    return None


def made(name: str) -> dict:
    given = BENCHMARKS[name]()
    times = ["0", *given.times]
    y, error = given.solve(times)
    states = [given.links(x) for x in y]
    free = [i for i, x in enumerate(given.mechanism.links) if x.name in given.free_axis]
    agreement = {}
    until = ORACLE_UNTIL if not name.startswith("A02") else 0.5
    early = [t for t in given.times if float(t) <= until]
    found, step_error = by_oracle(
        given, [float(t) for t in early], *ORACLE_STEPS.get(name, (0.1, 1e-14))
    )
    agreement["maximal coordinates"] = {
        t: off(states[1 + i], found[i], free) for i, t in enumerate(early)
    }
    if exact := closed_form(name, given.times):
        agreement["elliptic functions"] = {}
        for t, x, (s, c) in zip(given.times, y[1:], exact, strict=True):
            here = (np.cos(x[0]), np.sin(x[0])) if name == "A01" else (np.sin(x[0]), np.cos(x[0]))
            there = (REAL(mpmath.nstr(s, 30)), REAL(mpmath.nstr(c, 30)))
            agreement["elliptic functions"][t] = float(np.max(np.abs(np.subtract(here, there))))
    if name == "A03":
        far = np.abs(y[-1].astype(float) - A03_PUBLISHED) / np.abs(A03_PUBLISHED)
        agreement["test set, PSIDE"] = {
            "0.03": float(far[:7].max()),
            "0.03, rates": float(far[7:].max()),
        }
    return {
        "times": list(given.times),
        "y": [[np.format_float_positional(v, unique=True) for v in row] for row in y[1:]],
        "error of a step": {"minimal coordinates": error, "maximal coordinates": step_error},
        "agreement": agreement,
    }


def main(names: list[str]) -> None:
    for name in names or BENCHMARKS:
        found = made(name)
        kept = json.loads(PATH.read_text()) if PATH.exists() else {}  # another run may have added
        kept[name] = found
        ordered = {k: kept[k] for k in BENCHMARKS if k in kept}
        PATH.write_text(json.dumps(ordered, indent=1, ensure_ascii=False) + "\n")
        print(name, json.dumps(found["error of a step"]), json.dumps(found["agreement"]))


if __name__ == "__main__":
    main(sys.argv[1:])
