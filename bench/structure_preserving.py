"""Measure structure-preserving methods, for docs/howto/structure.md.

python bench/structure_preserving.py       measure, store, print the tables

Errors on the heavy top of Brüls and Cardona; steps a second beside RK4; energy of tops over 5000 s
beside the CPU time; energy that methods with constraints lose in 10 s; steps of chains on absolute
c-spaces. All runs are on one thread, in turn; the least CPU times count. It takes some ten minutes.
"""

from __future__ import annotations

import json
import time
from datetime import UTC, datetime
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

import lierb

RESULTS = Path(__file__).parent / "results"
REPEATS = 3
CONSTRAINED = ("RATTLie", "SHAKELie", "alpha3", "alpha2", "BLieDF1", "BLieDF2")
FORMS = [
    *product(("RK4", "Verlet", "Verlet4", *CONSTRAINED), ("SE3",)),
    *product(("RK4", *CONSTRAINED), ("SO3xR3",)),
]
CHAIN_FORMS = [
    ("RK4", "reduced"), *product(("RK4", "RATTLie", "SHAKELie", "alpha3", "BLieDF2"), ("SE3",)),
    ("RATTLie", "SO3xR3"),
]  # fmt: skip
STEPS = (2e-3, 1e-3, 5e-4)
LONG, COUNT = 5000.0, 32  # s; tops
LONG_RUNS = {
    "RK4": (1e-2, 5e-3, 2.5e-3), "Verlet": (1e-2, 5e-3, 2.5e-3), "Verlet4": (2e-2, 1e-2, 5e-3),
    "RATTLie": (1e-2, 5e-3), "SHAKELie": (1e-2, 5e-3), "DOP853": (4e-2, 2e-2, 1e-2),
}  # fmt: skip


def fast_top() -> tuple[lierb.Problem, np.ndarray]:
    """The heavy top of Brüls and Cardona (2010)."""
    pivot = lierb.joints.spherical(body_point=(0.0, -1.0, 0.0))
    body = lierb.Body(15.0, (0.234375, 0.46875, 0.234375))
    return lierb.Problem(body, pivot, (0.0, 0.0, -9.81)), pivot.twist(omega=(0.0, 150.0, -4.61538))


def tops(count: int, spread: float) -> tuple[lierb.Problem, np.ndarray]:
    """Müller's box on a pivot, with angular velocities that differ by some 0.5 rad/s."""
    pivot = lierb.joints.spherical(body_point=(-0.15, 0.0375, 0.0))
    body = lierb.Body(6.075, (0.0126563, 0.0468281, 0.0569531))
    rng = np.random.default_rng(0)
    omega = np.array((6.28, 3.14, 0.63)) + spread * rng.normal(size=(count, 3))
    return lierb.Problem(body, pivot, (0.0, 0.0, -9.81)), pivot.twist(omega=omega)


def end(method: str, cspace: str, dt: float) -> dict[str, np.ndarray]:
    problem, twist0 = fast_top()
    result = lierb.integrate(
        problem, twist0=twist0, dt=dt, t_end=1.0, method=method, cspace=cspace,
        save_every=round(1.0 / dt), record=["multipliers"], progress=False,
    )  # fmt: skip
    summary = result.summary.to_pylist()[0]
    multipliers = result.history["lambda"].to_pylist()[-1]
    named = {name: np.array(summary[name]) for name in ("position", "omega")}
    return named | {"lambda": np.array(multipliers), "joint": summary["position_error_max"]}


def errors() -> list[dict[str, Any]]:
    truth = end("DOP853", "SE3", 1e-4)
    rows = []
    for (method, cspace), dt in product(FORMS, STEPS):
        found = end(method, cspace, dt)
        off = {k: float(np.abs(found[k] - truth[k]).max()) for k in ("position", "omega", "lambda")}
        rows.append({"method": method, "cspace": cspace, "dt": dt, "joint": found["joint"], **off})
    return rows


def seconds(problem: lierb.Problem | lierb.Mechanism, **options: Any) -> tuple[float, Any]:
    """Least CPU time of a run, s, and its result."""
    best, result = np.inf, None
    for _ in range(REPEATS + 1):  # the first one compiles
        begun = time.thread_time()
        result = lierb.integrate(problem, threads=1, progress=False, **options)
        best = min(best, time.thread_time() - begun)
    return best, result


def speeds() -> list[dict[str, Any]]:
    """Steps a second of 2048 tops, dt = 1 ms, and multiples of RK4's time on SE(3)."""
    problem, twist0 = tops(2048, 1.0)
    run = {"dt": 1e-3, "t_end": 0.25, "measure_every": 250}
    rows = []
    for method, cspace in FORMS:
        spent, _ = seconds(problem, twist0=twist0, method=method, cspace=cspace, **run)
        rows.append({"method": method, "cspace": cspace, "steps_per_s": 2048 * 250 / spent})
    return rows


def energies() -> list[dict[str, Any]]:
    """Largest |E − E₀| in the first hundredth and the last half of a long run, and its CPU time."""
    problem, twist0 = tops(COUNT, 0.5)
    rows = []
    for method, dts in LONG_RUNS.items():
        for dt in dts:
            steps = round(LONG / dt)
            run = {"dt": dt, "t_end": LONG, "method": method, "measure_every": steps}
            spent, _ = seconds(problem, twist0=twist0, **run)
            result = lierb.integrate(
                problem,
                twist0=twist0,
                save_every=100,
                progress=False,
                **(run | {"measure_every": 100}),
            )
            drift = np.abs(result.history["energy_drift"].to_numpy().reshape(-1, COUNT))
            first, last = drift[: len(drift) // 100].max(), drift[len(drift) // 2 :].max()
            rows.append({
                "method": method, "dt": dt, "seconds": spent,
                "first": float(first), "last": float(last),
            })  # fmt: skip
    return rows


def losses() -> list[dict[str, Any]]:
    """Mean E − E₀ of tops after 10 s."""
    problem, twist0 = tops(COUNT, 0.5)
    rows = []
    for method, dt in product(CONSTRAINED, (1e-2, 2.5e-3)):
        result = lierb.integrate(
            problem, twist0=twist0, dt=dt, t_end=10.0, method=method, cspace="SO3xR3",
            save_every=round(10.0 / dt), progress=False,
        )  # fmt: skip
        change = result.history["energy_drift"].to_numpy()[-COUNT:].mean()
        rows.append({"method": method, "dt": dt, "change": float(change)})
    return rows


def chain(links: int, count: int) -> tuple[lierb.Mechanism, dict[str, Any]]:
    """Boxes of 0.4 m on revolute joints whose axes cross, with rates that differ by 10 %."""
    rod, joined = lierb.bodies.box((0.1, 0.05, 0.4), mass=1.0), []
    for i in range(links):
        axis = (0.0, 1.0, 0.0) if i % 2 == 0 else (1.0, 0.0, 0.0)
        place = {"parent_point": (0.0, 0.0, -0.2)} if i else {}
        joint = lierb.joints.revolute(axis=axis, body_point=(0.0, 0.0, 0.2), **place)
        joined.append(lierb.Link(f"link{i}", rod, joint, f"link{i - 1}" if i else "ground"))
    made = lierb.Mechanism(joined, gravity=(0.0, 0.0, -9.81))
    pose0 = made.close(made.pose())
    rates = {f"link{i}": (2.0 + i) * np.linspace(0.95, 1.05, count) for i in range(links)}
    return made, {"pose0": pose0, "twist0": made.twist(rates, pose0)}


def chains() -> list[dict[str, Any]]:
    """Steps a second of 512 chains, dt = 1 ms, and the largest opening of a joint, m."""
    rows = []
    for links, (method, cspace) in product((2, 3, 5), CHAIN_FORMS):
        made, start = chain(links, 512)
        spent, result = seconds(
            made, **start, method=method, cspace=cspace, dt=1e-3, t_end=0.25, measure_every=250
        )
        opening = max(result.summary["position_error_max"].to_pylist())
        rows.append({
            "links": links, "method": method, "cspace": cspace,
            "steps_per_s": 512 * 250 / spent, "joint": float(opening),
        })  # fmt: skip
    return rows


def tables(found: dict[str, list[dict[str, Any]]]) -> str:
    """Markdown tables of the measurements."""
    lines = ["| method | c-space | " + " | ".join(f"{1e3 * dt:g} ms" for dt in STEPS) + " |"]
    lines.append("|" + " --- |" * (2 + len(STEPS)))
    for method, cspace in FORMS:
        rows = [r for r in found["errors"] if (r["method"], r["cspace"]) == (method, cspace)]
        cells = (f"{r['position']:.1e}, {r['omega']:.1e}, {r['lambda']:.1e}" for r in rows)
        lines.append(f"| {method} | {cspace} | " + " | ".join(cells) + " |")
    base = found["speeds"][0]["steps_per_s"]
    lines += ["", "| method | c-space | time of a step | M steps/s |", "|" + " --- |" * 4]
    lines += [
        f"| {r['method']} | {r['cspace']} | {base / r['steps_per_s']:.2g} | "
        f"{r['steps_per_s'] / 1e6:.1f} |"
        for r in found["speeds"]
    ]
    unit = min(r["seconds"] for r in found["energies"])
    lines += ["", "| method | dt | time | first hundredth | last half |", "|" + " --- |" * 5]
    lines += [
        f"| {r['method']} | {1e3 * r['dt']:g} ms | {r['seconds'] / unit:.2g} | {r['first']:.1e} | "
        f"{r['last']:.1e} |"
        for r in found["energies"]
    ]
    lines += ["", "| method | dt | E − E₀ |", "|" + " --- |" * 3]
    lines += [
        f"| {r['method']} | {1e3 * r['dt']:g} ms | {r['change']:.1e} |" for r in found["losses"]
    ]
    lines += [
        "",
        "| links | method | c-space | time of a step | joints open by |",
        "|" + " --- |" * 5,
    ]
    for r in found["chains"]:
        base = next(b["steps_per_s"] for b in found["chains"] if b["links"] == r["links"])
        lines.append(
            f"| {r['links']} | {r['method']} | {r['cspace']} | {base / r['steps_per_s']:.2g} | "
            f"{r['joint']:.0e} m |"
        )
    return "\n".join(lines)


def main() -> None:
    found = {
        "errors": errors(),
        "speeds": speeds(),
        "energies": energies(),
        "losses": losses(),
        "chains": chains(),
    }
    machine = {k: v for k, v in lierb.info().items() if k not in ("cache", "loaded")}
    name = f"structure-{datetime.now(UTC):%Y-%m-%dT%H%M%S}-{machine['cpu']}.json"
    text = json.dumps({"machine": machine, **found}, indent=1)
    (RESULTS / name).write_text(text + "\n", encoding="utf-8")
    print(name)
    print(tables(found))


if __name__ == "__main__":
    main()
