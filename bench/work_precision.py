"""Measurements of docs/howto/choosing.md: `python bench/work_precision.py` stores them.

Methods, c-spaces, steps and tolerances side by side, by `lierb.convergence`, on batches of three
motions and on one whose velocities are of all sizes. A test holds the page against the last stored
run. It takes about a quarter of an hour, most of it compiling.

python bench/work_precision.py                  measure, store, draw, write tables into the pages
python bench/work_precision.py --report FILE    the same with a stored run
"""

from __future__ import annotations

import argparse
import json
import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

import lierb
from lierb.results.colours import CSPACE_COLOURS

ROOT = Path(__file__).parent.parent
RESULTS = ROOT / "bench" / "results"
PAGES = (ROOT / "docs" / "howto" / "choosing.md", ROOT / "docs" / "theory.md")
sys.path.insert(0, str(ROOT / "tests"))

from clocks.truths import DATA, problem_of  # noqa: E402

COUNT = 2048  # trajectories: what a call costs whatever its steps are is then little
SIGMA = 1.0  # of the logarithm of the velocities' factors, in the batch of all sizes
CSPACES = ("SE3", "SO3xR3")
RTOLS = tuple(10.0**-k for k in range(4, 13))
FINEST = {"BS32": 1e-8, "DP54": 1e-11, "Tsit5": 1e-11}  # rtol; what is beyond takes a million steps
ADAPTIVE = ("BS32", "DP54", "Tsit5", "Verner65", "Verner87", "Verner98", "DOP853")
REPEATS = 7  # of each timed run, of which the best counts
SHORTEST = 5e-5  # s, of fixed steps
STEPS = {  # in a second
    "RK4": [2**k for k in range(4, 13)],
    "CF4": [2**k for k in range(4, 13)],
    "DOP853": [6, 8, 12, 16, 24, 32, 48, 64, 96, 128, 192, 256],
}
DRAWN = ("BS32", "Tsit5", "DOP853", "Verner98", "RK4")  # the others are close to one of them
KEPT = (
    "method", "cspace", "dt", "rtol", "steps", "rejected", "evaluations", "cpu_time", "failed",
    "error.rotation", "error.rotation.floor", "error.position", "error.position.floor",
    "drift.position", "drift.rotation", "drift.energy",
)  # fmt: skip


@dataclass(frozen=True)
class Motion:
    """title : of its panels.   t_end : s, about a turn of the body.   sizes : of the velocities:
    alike, or log-normal.   finer : so much shorter are its fixed steps.
    """

    name: str
    title: str
    t_end: float
    sizes: str = "alike"
    cspaces: tuple[str, ...] = CSPACES
    adaptive: tuple[str, ...] = ADAPTIVE
    finer: int = 1


MOTIONS = {
    "heavy_top": Motion("heavy_top", "heavy top, spherical joint", 1.0),
    "free_body": Motion("free_body", "free body, no torque", 4.0),
    "universal": Motion("universal", "box on a universal joint", 1.0),
    "all_sizes": Motion(
        "heavy_top", "heavy tops, velocities of all sizes", 1.0, "log-normal", ("SE3",),
        ("Tsit5", "DOP853"), 16,
    ),
}  # fmt: skip


def batch(motion: Motion) -> tuple[lierb.Problem, np.ndarray]:
    """The problem, and (COUNT, 6) twists: velocities by up to some 20 % around the motion's."""
    problem, twist0 = problem_of(motion.name)
    rng = np.random.default_rng(5)
    factors = 1.0 + 0.1 * rng.standard_normal((COUNT, 6))
    twists = twist0 * factors
    if motion.sizes == "log-normal":
        twists *= np.exp(SIGMA * rng.standard_normal((COUNT, 1)))
    return problem, problem.project(twists) if DATA[motion.name].centre else twists


# ---- measuring ---------------------------------------------------------------------------------


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--report", type=Path)
    given = parser.parse_args()
    path = measured() if given.report is None else given.report.resolve()
    stored = json.loads(path.read_text(encoding="utf-8"))
    print(f"drawn: {drawn(stored, path).relative_to(ROOT)}")
    for page in PAGES:
        page.write_text(embedded(page.read_text(encoding="utf-8"), stored, path.stem))
        print(f"written into {page.relative_to(ROOT)}")


def measured() -> Path:
    found: dict[str, Any] = {
        "time": datetime.now(UTC).isoformat(timespec="seconds").removesuffix("+00:00"),
        "machine": {k: v for k, v in lierb.info().items() if k not in ("cache", "loaded")},
        "trajectories": COUNT,
        "motions": {name: list(rows_of(name)) for name in MOTIONS},
        "kept": kept(),
    }
    path = RESULTS / f"choosing-{found['time'].replace(':', '')}-{found['machine']['cpu']}.json"
    path.write_text(json.dumps(found, indent=None).replace("}, {", "},\n{") + "\n")
    print(f"stored in {path.relative_to(ROOT)}")
    return path


def rows_of(name: str) -> Iterator[dict[str, Any]]:
    """Runs of a motion, a row each."""
    motion = MOTIONS[name]
    problem, twists = batch(motion)
    given = {"twist0": twists, "t_end": motion.t_end, "cspaces": motion.cspaces}
    given["repeats"] = REPEATS
    for method in motion.adaptive:
        rtols = [rtol for rtol in RTOLS if rtol >= 0.99 * FINEST.get(method, 0.0)]
        yield from told(lierb.convergence(problem, method, rtols=rtols, **given))
    for method, counts in STEPS.items():
        if method == "CF4" and motion.sizes != "alike":
            continue
        dts = [1.0 / (motion.finer * count) for count in counts]
        dts = [dt for dt in dts if dt > SHORTEST]
        yield from told(lierb.convergence(problem, method, dts, **given))


def told(found: lierb.analysis.comparison.Comparison) -> Iterator[dict[str, Any]]:
    for row in found.table.to_pylist():
        row["cpu_time"] /= COUNT
        shown = {k: row[k] for k in KEPT if row[k] is not None}
        yield {k: float(f"{v:.4g}") if isinstance(v, float) else v for k, v in shown.items()}
    print(found.to_markdown().split("\n\n")[0], flush=True)


def kept() -> dict[str, dict[str, float]]:
    """Largest position error of the heavy tops' joint, m, with the saddle point solved in every
    stage: of adaptive methods at rtol = 1e-3, of commutator-free ones at dt = 2⁻⁵ s.
    """
    problem, twists = batch(MOTIONS["heavy_top"])
    found: dict[str, dict[str, float]] = {}
    clocks = {method: {"rtol": 1e-3} for method in ADAPTIVE}
    clocks |= {method: {"dt": 2.0**-5} for method in ("CF4", "CG3", "CG4")}
    for method, clock in clocks.items():
        found[method] = {}
        for cspace in CSPACES:
            run = lierb.integrate(
                problem, twist0=twists, t_end=1.0, method=method, cspace=cspace, solver="saddle",
                **clock,
            )  # fmt: skip
            found[method][cspace] = float(run.summary["position_error_max"].to_numpy().max())
        print(method, found[method], flush=True)
    return found


# ---- reading -----------------------------------------------------------------------------------


def lines_of(rows: list[dict[str, Any]]) -> dict[tuple[str, str, str], list[dict[str, Any]]]:
    """Method, c-space, "adaptive" or "fixed" → its rows, from the coarsest on."""
    found: dict[tuple[str, str, str], list[dict[str, Any]]] = {}
    for row in rows:
        control = "fixed" if "dt" in row else "adaptive"
        found.setdefault((row["method"], row["cspace"], control), []).append(row)
    return found


def believed(row: dict[str, Any]) -> bool:
    """Return whether all trajectories reached their end, with an error above rounding."""
    return not row["failed"] and row["error.rotation"] > row["error.rotation.floor"]


def cost(rows: list[dict[str, Any]], target: float, of: str = "cpu_time") -> float:
    """Cost of an error of rotation of `target` rad, interpolated between logarithms; NaN
    where the method does not get there, or that is not to be told from rounding.
    """
    seen = [row for row in rows if believed(row)]
    for before, after in pairwise(seen):
        ends = np.log([before["error.rotation"], after["error.rotation"]])
        if ends[1] <= np.log(target) <= ends[0]:
            share = (np.log(target) - ends[0]) / (ends[1] - ends[0])
            work = np.log([before[of], after[of]])
            return float(np.exp(work[0] + share * (work[1] - work[0])))
    if seen and seen[0]["error.rotation"] < target:  # the coarsest does better
        return float(seen[0][of])
    return float("nan")


TARGETS = (1e-3, 1e-6, 1e-9, 1e-11)
NAMES = {"SE3": "SE(3)", "SO3xR3": "SO(3)×ℝ³"}


def tables(stored: dict[str, Any]) -> dict[str, str]:
    """Tables of the page, as Markdown, by name."""
    return {
        "methods": method_table(stored),
        "cspaces": cspace_table(stored),
        "tolerances": tolerance_table(stored),
        "sizes": size_table(stored),
        "kept": kept_table(stored),
    }


def embedded(text: str, stored: dict[str, Any], stem: str) -> str:
    """A page with this run's tables between their marks, and its name in links."""
    for name, table in tables(stored).items():
        mark, end = f"<!-- {name} -->\n", f"<!-- /{name} -->"
        before, found, rest = text.partition(mark)
        if found:
            text = f"{before}{mark}\n{table}\n\n{end}{rest.partition(end)[2]}"
    return re.sub(r"choosing-[\w-]+(?=\.(?:json|png))", stem, text)


def _table(header: list[str], rows: list[list[str]]) -> str:
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def method_table(stored: dict[str, Any]) -> str:
    """CPU time at an error, in multiples of the quickest, on the three motions: least and most."""
    several = [n for n, m in MOTIONS.items() if m.sizes == "alike"]
    lines = {
        (name, *key): rows
        for name in several for key, rows in lines_of(stored["motions"][name]).items()
    }  # fmt: skip
    best = {
        (name, cspace, target): np.nanmin(
            [cost(own, target) for key, own in lines.items() if key[::2] == (name, cspace)]
        )
        for name in several for cspace in CSPACES for target in TARGETS
    }  # fmt: skip
    rows = []
    for method, control in dict.fromkeys((method, control) for _, method, _, control in lines):
        cells = [
            _span([
                cost(lines[name, method, cspace, control], target) / best[name, cspace, target]
                for name in several for cspace in CSPACES
            ])
            for target in TARGETS
        ]  # fmt: skip
        rows.append([f"{method}, {control}", *cells])
    return _table(["", *(f"{t:.0e} rad" for t in TARGETS)], rows)


def _span(ratios: list[float]) -> str:
    if not np.isfinite(ratios).all():
        return "–"
    low, high = (f"{x:.1f}" if x < 9.95 else f"{x:.0f}" for x in (min(ratios), max(ratios)))
    return low if low == high else f"{low} … {high}"


def cspace_table(stored: dict[str, Any]) -> str:
    """CPU time on SO(3)×R³ over that on SE(3), at the same error, of DOP853; and the drifts."""
    rows = []
    for name, motion in MOTIONS.items():
        if len(motion.cspaces) < 2:
            continue
        lines = lines_of(stored["motions"][name])
        cells = []
        for target in TARGETS[1:]:
            a, b = (cost(lines["DOP853", c, "adaptive"], target) for c in CSPACES)
            cells.append(f"{b / a:.2g}")
        rows.append([motion.title, *cells])
    return _table(["", *(f"{t:.0e} rad" for t in TARGETS[1:])], rows)


def tolerance_table(stored: dict[str, Any]) -> str:
    """The largest error of rotation over rtol: of three motions and two c-spaces; and of the batch
    of velocities of all sizes.
    """
    alike = [name for name, motion in MOTIONS.items() if motion.sizes == "alike"]
    rows = [[method, *_over_rtol(stored, method, alike)] for method in ADAPTIVE]
    rows += [
        [f"{method}, all sizes", *_over_rtol(stored, method, ["all_sizes"])]
        for method in MOTIONS["all_sizes"].adaptive
    ]
    return _table(["", *(f"{rtol:.0e}" for rtol in RTOLS)], rows)


def _over_rtol(stored: dict[str, Any], method: str, motions: list[str]) -> Iterator[str]:
    for rtol in RTOLS:
        found = [
            row["error.rotation"] / rtol
            for name in motions for row in stored["motions"][name]
            if row["method"] == method and abs(row.get("rtol", 0.0) / rtol - 1.0) < 1e-9
        ]  # fmt: skip
        yield f"{float(f'{max(found):.2g}'):g}" if found else "–"


def size_table(stored: dict[str, Any]) -> str:
    """CPU time of velocities of all sizes, in multiples of the quickest."""
    lines = lines_of(stored["motions"]["all_sizes"])
    targets = TARGETS[:3]
    best = {t: np.nanmin([cost(rows, t) for rows in lines.values()]) for t in targets}
    rows = [
        [f"{method}, {control}", *(_span([cost(own, t) / best[t]]) for t in targets)]
        for (method, _, control), own in lines.items()
    ]
    return _table(["", *(f"{t:.0e} rad" for t in targets)], rows)


def kept_table(stored: dict[str, Any]) -> str:
    rows = [
        [method, *(f"{each[c]:.0e}" if each[c] else "0" for c in CSPACES)]
        for method, each in stored["kept"].items()
    ]
    return _table(["", *(NAMES[c] for c in CSPACES)], rows)


# ---- drawing -----------------------------------------------------------------------------------


SHAPES = dict(zip(DRAWN, "^vosD", strict=True))
LABELS = {
    "evaluations": "right-hand sides of a trajectory", "cpu_time": "CPU time of a trajectory [µs]",
}  # fmt: skip


def drawn(stored: dict[str, Any], path: Path) -> Path:
    """Error over work: a row of panels for each motion."""
    import matplotlib.pyplot as plt
    from matplotlib.lines import Line2D
    from matplotlib.ticker import NullFormatter

    figure, axes = plt.subplots(
        len(MOTIONS), 2, figsize=(10.0, 3.4 * len(MOTIONS)), layout="constrained", sharey="row"
    )
    for (name, motion), row in zip(MOTIONS.items(), axes, strict=True):
        for (method, cspace, control), rows in lines_of(stored["motions"][name]).items():
            if method not in DRAWN:
                continue
            seen = [r for r in rows if believed(r)]
            errors = [r["error.rotation"] for r in seen]
            style = {
                "color": CSPACE_COLOURS[cspace], "marker": SHAPES[method], "markersize": 4.5,
                "linestyle": "--" if control == "fixed" else "-", "linewidth": 1.0,
            }  # fmt: skip
            for panel, (of, _) in zip(row, LABELS.items(), strict=True):
                scale = 1e6 if of == "cpu_time" else 1.0
                panel.plot([scale * r[of] for r in seen], errors, **style)
        for panel, label in zip(row, LABELS.values(), strict=True):
            panel.set(xscale="log", yscale="log", xlabel=label, ylim=(1e-13, 1.0))
            panel.xaxis.set_minor_formatter(NullFormatter())
            panel.grid(color="#dddddd", linewidth=0.5)
            panel.spines[["top", "right"]].set_visible(False)
        row[0].set_ylabel("rotation error at the end [rad]")
        row[0].set_title(motion.title, loc="left", fontsize=10)
    keys = [Line2D([], [], color="#444444", marker=m, label=n) for n, m in SHAPES.items()]
    keys += [Line2D([], [], color=CSPACE_COLOURS[c], label=NAMES[c]) for c in CSPACES]
    keys += [Line2D([], [], color="#444444", linestyle="--", label="fixed steps")]
    figure.legend(handles=keys, loc="outside upper center", ncols=6, frameon=False)
    picture = path.with_suffix(".png")
    figure.savefig(picture, dpi=110)
    return picture


if __name__ == "__main__":
    main()
