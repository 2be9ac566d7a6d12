"""The tables and the work–precision diagram of a stored run."""

from __future__ import annotations

from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
from measuring import around_marks

STEPS = 1000  # a simulated second counts as so many body-steps, whatever the method's own steps

FAMILIES = {
    "reduced": "Reduced: minimal coordinates, or a constant gain",
    "general": "General: absolute coordinates, a constraint solve in every stage",
}
# lierb's form and the C++ kernels to hold it against: for a saddle point one that factors it in
# every stage, and one that, as lierb's compiler does, takes what is constant out of the loop.
PAIRS = {
    "reduced, spherical": ("lierb/reduced", "cpp/reduced"),
    "reduced, spherical, ambient": ("lierb/reduced-ambient", "cpp/reduced-quaternion"),
    "constant gain, spherical": ("lierb/gain", "cpp/reduced"),
    "saddle point, spherical (3 rows)": ("lierb/saddle", "cpp/general", "cpp/general-fixed"),
    "saddle point, revolute (5 rows)": (
        "lierb/saddle-revolute", "cpp/general-revolute", "cpp/general-fixed-revolute",
    ),
    "saddle point, universal (4 rows)": (
        "lierb/saddle-universal", "cpp/general-universal", "cpp/general-fixed-universal",
    ),
    "DOP853, reduced, 48 steps a second": ("lierb/reduced-dop853", "cpp/reduced-dop853"),
    "the same, ambient": ("lierb/reduced-ambient-dop853", "cpp/reduced-dop853"),
}  # fmt: skip


# Okabe and Ito's colours, and a marker for each curve
COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
STYLES = [(COLORS[i % len(COLORS)], marker) for i, marker in enumerate("osD^v<>Pp*Xhd8s^Dov<>P")]


def rate(found: dict[str, Any], seconds: str) -> float:
    """M body-steps/s."""
    return found["bodies"] * STEPS / found[seconds] / 1e6


def embedded(text: str, run: dict[str, Any], figure: str) -> str:
    """`text` with this run's tables and figure between its two marks."""
    before, after = around_marks(text, "peers")
    return f"{before}{markdown(run)}\n\n![Work and precision]({figure})\n{after}"


def markdown(run: dict[str, Any]) -> str:
    machine, before, after = run["machine"], run["before"], run["after"]
    lines = [
        f"{machine['cpu']}, {machine['lanes']} lanes, {machine['threads']} cores, "
        f"{before['clock_ghz']:.2f} GHz; measured peak of one core {before['peak_gflops']:.0f} "
        f"GFLOP/s before the run, {after['peak_gflops']:.0f} after it; {run['time'][:10]}.",
    ]
    for family, title in FAMILIES.items():
        lines += ["", f"**{title}**", "", *_family_table(run, family)]
    lines += ["", "**lierb against C++ of the same formulation**", "", *_pair_table(run)]
    crossings = _equal_error_lines(run)
    if crossings:
        lines += ["", "**At equal error, reduced**", "", *crossings]
    missing = [f"{name} ({why})" for name, why in run["unavailable"].items()]
    if missing:
        lines += ["", f"Not available in this run: {'; '.join(missing)}."]
    if "note" in run:
        lines += ["", run["note"]]
    return "\n".join(lines)


def _family_table(run: dict[str, Any], family: str) -> list[str]:
    entries = {
        name: e
        for name, e in run["entries"].items()
        if e["family"] == family and _ok(e.get("threads_1")) and "tilted" not in name
        and not name.endswith(("-revolute", "-universal"))
    }  # fmt: skip
    best = max(
        (rate(e["threads_1"], "cpu_s") for name, e in entries.items() if _is_ours(name, e)),
        default=float("nan"),
    )
    lines = [
        "| | M body-steps/s per core | on 2 cores | first result, s | error at 1 s, m | lierb is |",
        "|---|---|---|---|---|---|",
    ]
    for name, e in sorted(entries.items(), key=lambda item: -rate(item[1]["threads_1"], "cpu_s")):
        one, two = e["threads_1"], e.get("threads_2")
        own = rate(one, "cpu_s")
        ratio = "" if name.startswith("lierb/") else f"{_three(best / own)} ×"
        lines.append(
            f"| {e['label']} | {_three(own)} | {_three(rate(two, 'wall_s')) if _ok(two) else '–'} "
            f"| {one['cold_s']:.1f} | {one['error_m']:.0e} | {ratio} |"
        )
    failed = [
        f"{e['label']}: {e['threads_1']['failed']}"
        for e in run["entries"].values()
        if e["family"] == family and "failed" in e.get("threads_1", {})
    ]
    return lines + ([f"\nFailed: {'; '.join(failed)}."] if failed else [])


def _is_ours(name: str, entry: dict[str, Any]) -> bool:
    """lierb's RK4 at the tables' step: what the ratios refer to."""
    return name.startswith("lierb/") and entry["threads_1"]["accuracy"] == 1e-3


def _pair_table(run: dict[str, Any]) -> list[str]:
    """Each of lierb's forms, aligned and tilted, against C++."""
    lines = [
        "| M body-steps/s per core | lierb | tilted | C++ | ratio | C++, fixed rows | ratio |",
        "|---|---|---|---|---|---|---|",
    ]
    for title, (ours, *theirs) in PAIRS.items():
        own, tilted = _speed(run, ours), _speed(run, f"{ours}-tilted")
        cells = [_cell(own), _cell(tilted)]
        for name in (*theirs, None)[:2]:
            limit = _speed(run, name)
            ratios = [f"{x / limit:.2f}" for x in (own, tilted) if x and limit]
            cells += [_cell(limit), " / ".join(ratios) or "–"]
        if own:
            lines.append(f"| {title} | {' | '.join(cells)} |")
    return lines


def _speed(run: dict[str, Any], name: str | None) -> float | None:
    found = run["entries"].get(name, {}).get("threads_1")
    return rate(found, "cpu_s") if _ok(found) else None


def _cell(speed: float | None) -> str:
    return "–" if speed is None else _three(speed)


def _equal_error_lines(run: dict[str, Any]) -> list[str]:
    """CPU time at two errors, from the curves, by interpolation in their logarithms."""
    curves = {
        "lierb, DOP853": "lierb/reduced-dop853",
        "C++, DOP853": "cpp/reduced-dop853",
        "numbalsoda, DOP853": "numbalsoda_dop853/reduced",
    }
    found = {}
    for label, name in curves.items():
        if name in run["entries"]:
            points = _curve(run["entries"][name])
            found[label] = [_cost_at(points, error) for error in (1e-9, 1e-12)]
    if not found:
        return []
    lines = [
        "| µs of CPU time a body and simulated second | at 1e-9 m | at 1e-12 m |",
        "|---|---|---|",
    ]
    for label, costs in found.items():
        cells = " | ".join("–" if c is None else f"{c * 1e6:.3g}" for c in costs)
        lines.append(f"| {label} | {cells} |")
    return lines


def _curve(entry: dict[str, Any]) -> list[tuple[float, float]]:
    """(error in m, CPU seconds a body) of the measurements that worked, by error."""
    return sorted(
        (p["error_m"], p["cpu_s"] / p["bodies"])
        for p in entry["curve"]
        if _ok(p) and 0.0 < p["error_m"] < 0.1
    )


def _cost_at(points: list[tuple[float, float]], error: float) -> float | None:
    """CPU seconds for an error, between the points, in logarithms; None outside of them."""
    if not points:
        return None
    errors, costs = np.log10(np.array(points).T)
    if not errors[0] <= np.log10(error) <= errors[-1]:
        return None
    return float(10 ** np.interp(np.log10(error), errors, costs))


def _ok(found: dict[str, Any] | None) -> bool:
    return bool(found) and "failed" not in found


def _three(x: float) -> str:
    """Two or three digits, without an exponent."""
    return f"{x:.0f}" if x >= 99.5 else f"{x:.1f}" if x >= 9.95 else f"{x:.2g}"


def draw(run: dict[str, Any], path: Path) -> None:
    """Error over CPU time a body, both families, as PNG."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 2, figsize=(12, 7.5), sharey=True, layout="constrained")
    for ax, (family, title) in zip(axes, FAMILIES.items(), strict=True):
        curves = [(n, e, _curve(e)) for n, e in run["entries"].items() if e["family"] == family]
        styles = cycle(STYLES)
        for name, entry, points in curves:
            if len(points) < 2:
                continue
            ours = name.startswith("lierb/")
            color, marker = next(styles)
            ax.loglog(
                [c * 1e6 for _, c in points], [e for e, _ in points], color=color, marker=marker,
                markersize=5, linewidth=2.6 if ours else 1.0, linestyle="-" if ours else "--",
                label=entry["label"],
            )  # fmt: skip
        ax.set_title(title, fontsize=10)
        ax.set_xlabel("CPU time per body and simulated second / µs")
        ax.grid(True, which="major", alpha=0.3)
        ax.legend(fontsize=8, ncols=2, loc="upper center", bbox_to_anchor=(0.5, -0.12))
    axes[0].set_ylabel("largest error of the centre of mass at t = 1 s / m")
    figure.suptitle("Heavy top Monte Carlo: work and precision on one core")
    figure.savefig(path, dpi=120)
    plt.close(figure)
