"""Draw the errors over the step, with the order of each method."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from lierb.analysis.convergence import ROUNDING_FLOOR
from lierb.methods import method_named
from lierb.results.panels import MOST_KEYS, Key, Sheet, label_lines, log_axes, order_lines, positive
from lierb.results.plots import MATH_NAMES
from lierb.studies.findings.findings import SettingErrors, findings
from lierb.studies.findings.sizes import errors_seen, least_drawn
from lierb.studies.pages.columns import AXES
from lierb.studies.pages.looks import looks
from lierb.studies.storage.results import Results

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def order_sheet(dataset: Results) -> Sheet:
    """Draw quantiles of the errors over dt, with a line of the method's order."""
    study, seen, least = dataset.study, errors_seen(dataset), least_drawn(dataset)
    summaries = findings(dataset)
    spaces = list(dict.fromkeys((s.cspace, s.method) for s in study.settings))
    first = [next(s for s in study.settings if (s.cspace, s.method) == own) for own in spaces]
    keys = []
    for look in looks(study, first):
        name = MATH_NAMES.get(look.setting.cspace, look.setting.cspace)
        keys.append(Key(f"{name}, {look.setting.method}", look.key.colour))
    panels = [
        partial(_draw_orders, summaries, list(zip(spaces, keys)), kind, least[kind])
        for kind in seen
    ]
    return Sheet("errors over the step: median, 95 % and largest", panels, keys)


def _draw_orders(
    summaries: list[SettingErrors],
    spaces: list[tuple[tuple[str, str], Key]],
    kind: str,
    least: float,
    panel: Axes,
) -> None:
    zeros, ends = [], []
    lines: dict[int, float] = {}  # ordinate at which each order's line begins
    for n, ((cspace, method), key) in enumerate(spaces):
        of = [f for f in summaries if (f.setting.cspace, f.setting.method) == (cspace, method)]
        of.sort(key=lambda f: f.setting.step)
        dts = np.array([f.setting.step for f in of])
        drawn = positive([f.quantiles[kind] for f in of], least)
        if np.isfinite([f.quantiles[kind] for f in of]).all() and not np.isfinite(drawn).any():
            zeros.append(key.label)
            continue
        for i, (marker, dash) in enumerate(zip("o^s", ("-", "--", ":"))):
            panel.plot(dts, drawn[:, i], color=key.colour, marker=marker, linestyle=dash,
                       markersize=4 + 3 * (n == 0 and len(spaces) > 1),
                       markerfacecolor="none" if n == 0 else None,
                       linewidth=2.2 if n == 0 else 1.2)  # fmt: skip
        ends += [(key.label, key.colour, dts[-1], y) for y in drawn[-1, :1] if np.isfinite(y)]
        median, size = drawn[-1, 0], of[-1].sizes[kind]
        if (order := method_named(method).order) and median > ROUNDING_FLOOR * size:
            lines[order] = min(lines.get(order, np.inf), median)
    order_lines(panel, lines, dts)
    panel.set_xlabel("Δt [s]")
    panel.set_ylabel(AXES[kind])
    log_axes(panel, "xy", zeros)
    if ends:
        panel.set_xticks(dts, [f"{dt:g}" for dt in dts], minor=False)
        panel.set_xticks([], minor=True)
    if len(spaces) > MOST_KEYS and ends:
        label_lines(panel, ends)
