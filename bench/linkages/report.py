"""The tables of a stored run, in Markdown."""

from __future__ import annotations

from typing import Any

from measuring import around_marks, headline
from peers.report import _three as three

AS_GOOD = 2.0  # most of lierb's error over a peer's, where the two are compared
STEPS = 1000  # a simulated second counts as so many steps, whatever a method takes itself
TITLES = {
    "chain2": "2 revolute links",
    "chain3": "3 revolute links",
    "chain5": "5 revolute links",
    "chain8": "8 revolute links",
    "chain20": "20 revolute links, looped code",
    "fourbar": "Four-bar with a loop",
}


def rate(entry: dict[str, Any]) -> float:
    """M mechanism-steps/s on one core."""
    return entry["count"] * STEPS / entry["cpu_s"] / 1e6


def is_right(entry: dict[str, Any]) -> bool:
    """Return whether the peer ran and reproduced the common motion."""
    return "failed" not in entry and entry["error_m"] <= entry["allowed_m"]


def markdown(run: dict[str, Any]) -> str:
    lines = [headline(run)]
    for mechanism, title in TITLES.items():
        rows = _rows(run, mechanism)
        if rows:
            head = "| | M mechanism-steps/s | first result, s | error at 1 s, m | lierb is |"
            lines += ["", f"**{title}**", "", head, "|---|---|---|---|---|", *rows]
    wrong = [
        f"{e['label']} ({TITLES[e['mechanism']]}): {e.get('failed') or _deviation(e)}"
        for e in run["entries"].values()
        if not is_right(e)
    ]
    lines += ["", "Without a time, for it failed or is another motion:", ""] if wrong else []
    lines += [f"- {text}" for text in wrong]
    if run["unavailable"]:
        missing = "; ".join(f"{name} ({why})" for name, why in run["unavailable"].items())
        lines += ["", f"Not available in this run: {missing}."]
    return "\n".join([*lines, "", _versions(run)])


def _deviation(entry: dict[str, Any]) -> str:
    return f"off by {entry['error_m']:.0e} m, where {entry['allowed_m']:.0e} is allowed"


def _rows(run: dict[str, Any], mechanism: str) -> list[str]:
    entries = {
        name: e for name, e in run["entries"].items() if e["mechanism"] == mechanism and is_right(e)
    }
    ours = [e for name, e in entries.items() if name.startswith("lierb/")]
    rows = []
    for name, e in sorted(entries.items(), key=lambda item: -rate(item[1])):
        best = max((rate(x) for x in ours if x["error_m"] <= AS_GOOD * e["error_m"]), default=0.0)
        is_peer = best and not name.startswith("lierb/")
        ratio = f"{three(best / rate(e))} ×" if is_peer else ""
        speed = three(rate(e)) if rate(e) >= 0.1 else f"{rate(e):.2g}"
        rows.append(
            f"| {e['label']} | {speed} | {e['cold_s']:.1f} | {e['error_m']:.0e} | {ratio} |"
        )
    return rows


def _versions(run: dict[str, Any]) -> str:
    known = ("mujoco", "pin", "drake", "exudyn", "heyoka", "g++", "numba")
    found: dict[str, str] = {}
    for e in run["entries"].values():
        config = e.get("config", {})
        found |= {name: str(config[name]).strip('"') for name in known if name in config}
    return f"Versions: {', '.join(f'{name} {version}' for name, version in found.items())}."


def embedded(text: str, run: dict[str, Any]) -> str:
    """`text` with this run's tables between its two marks."""
    before, after = around_marks(text, "mechanisms")
    return f"{before}{markdown(run)}\n{after}"
