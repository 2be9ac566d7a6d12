"""The tables of a stored run."""

from __future__ import annotations

from typing import Any

from measuring import around_marks, headline

TARGETS = ("1e-06", "1e-09", "1e-12")
TITLES = {"lognormal": "Velocities of all sizes", "one": "One velocity for all"}


def embedded(text: str, run: dict[str, Any]) -> str:
    """`text` with this run's tables between its two marks."""
    before, after = around_marks(text, "tolerances")
    return f"{before}{markdown(run)}\n{after}"


def markdown(run: dict[str, Any]) -> str:
    lines = [headline(run)]
    for batch, title in TITLES.items():
        lines += ["", f"**{title}**", "", *_table(run, batch)]
    for title, items in (
        ("Lanes that are busy, velocities of all sizes", busy_lanes(run)),
        ("Time of adaptive steps over that of fixed ones, one velocity", over_fixed(run)),
    ):
        lines += ["", f"{title}: {'; '.join(items)}."] if items else []
    missing = [f"{name} ({why})" for name, why in run["unavailable"].items()]
    failed = [
        f"{e['label']}: {e['failed']}" for e in run["entries"].values() if "failed" in e
    ]  # fmt: skip
    for title, items in (("Not available in this run", missing), ("Failed", failed)):
        lines += ["", f"{title}: {'; '.join(items)}."] if items else []
    return "\n".join(lines)


def _table(run: dict[str, Any], batch: str) -> list[str]:
    entries = {
        name: e
        for name, e in run["entries"].items()
        if e["batch"] == batch and "failed" not in e
    }  # fmt: skip
    best = {t: _least(entries, t) for t in TARGETS}
    lines = [
        "| µs of CPU time a top and simulated second | "
        + " | ".join(f"at {t.replace('e-0', 'e-')} m | lierb is" for t in TARGETS) + " |",
        "|---|" + "---|" * (2 * len(TARGETS)),
    ]  # fmt: skip
    order = lambda item: item[1].get(TARGETS[1], {}).get("cpu_us", float("inf"))
    for name, e in sorted(entries.items(), key=order):
        cells = []
        for t in TARGETS:
            cost = e.get(t, {}).get("cpu_us")
            cells.append("–" if cost is None else f"{cost:.3g}")
            ours = name.startswith("lierb/")
            cells.append("" if ours or None in (cost, best[t]) else f"{cost / best[t]:.3g} ×")
        lines.append(f"| {e['label']} | {' | '.join(cells)} |")
    return lines


def _least(entries: dict[str, Any], target: str) -> float | None:
    """The least time of lierb's own adaptive ones."""
    costs = [
        e[target]["cpu_us"]
        for name, e in entries.items()
        if name.startswith("lierb/") and "adaptive" in name and "cpu_us" in e.get(target, {})
    ]
    return min(costs, default=None)


def busy_lanes(run: dict[str, Any]) -> list[str]:
    """Share of busy lanes of each adaptive method, at each error."""
    return [
        f"{e['label']} " + ", ".join(f"{e[t]['busy']:.1%}" for t in TARGETS if "busy" in e[t])
        for e in run["entries"].values()
        if e["batch"] == "lognormal" and any("busy" in e.get(t, {}) for t in TARGETS)
    ]


def over_fixed(run: dict[str, Any]) -> list[str]:
    """DOP853's, at each error."""
    forms = (run["entries"].get(f"lierb/reduced-{form}/one", {}) for form in ("adaptive", "dop853"))
    adaptive, fixed = forms
    return [
        f"{adaptive[t]['cpu_us'] / fixed[t]['cpu_us']:.3g} at {t} m"
        for t in TARGETS
        if all("cpu_us" in form.get(t, {}) for form in (adaptive, fixed))
    ]
