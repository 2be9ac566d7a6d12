"""Choose colours and dashes of a study's settings in its figures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from lierb.results.colours import colours_of
from lierb.results.panels import DASHES, MOST_SETTINGS, Key
from lierb.results.plots import MATH_NAMES
from lierb.studies.description.settings import Setting
from lierb.studies.description.study import Study


@dataclass(frozen=True)
class Look:
    """Line style of a setting: a colour for each c-space and method, a dash for each step.

    width : of its line; the first ones are thicker, so that a line that lies on another shows both.
    """

    setting: Setting
    key: Key
    width: float


def step_sizes(study: Study) -> list[float]:
    """Return the steps, or tolerances, of a study's settings, the largest first."""
    return sorted({setting.step for setting in study.settings}, reverse=True)


def looks(study: Study, settings: Sequence[Setting] | None = None) -> list[Look]:
    """Return the line styles of the settings that are drawn, by default of all."""
    spaces = list(dict.fromkeys((s.cspace, s.method) for s in study.settings))
    sizes = step_sizes(study)
    colours = dict(zip(spaces, colours_of([cspace for cspace, _ in spaces])))
    several = len({method for _, method in spaces}) > 1
    shown = list(settings or study.settings)[:MOST_SETTINGS]
    styles = []
    for n, setting in enumerate(shown):
        colour = colours[setting.cspace, setting.method]
        parts = [MATH_NAMES.get(setting.cspace, setting.cspace)]
        parts += [setting.method] if several else []
        step = f"Δt = {setting.dt:g} s" if setting.rtol is None else setting.step_label
        parts += [step] if len(sizes) > 1 else []
        key = Key(", ".join(parts), colour, DASHES[sizes.index(setting.step) % len(DASHES)])
        styles.append(Look(setting, key, 1.2 + 1.6 * (len(shown) - 1 - n) / len(shown)))
    return styles
