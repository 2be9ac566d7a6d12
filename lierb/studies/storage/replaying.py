"""Replays: a study with one trajectory's whole history recorded, and the call that replays it."""

from __future__ import annotations

import operator
from typing import Any

import numpy as np

from lierb.errors import ArgumentError, StudyError, brief
from lierb.studies.description.settings import Setting
from lierb.studies.description.study import Study

REPLAYED = 1000  # equal intervals of the history of a replay with adaptive steps
KEYS = ("cspace", "method", "dt", "rtol")  # of a setting


def require_trajectory(study: Study, trajectory: int) -> int:
    """Return a trajectory's number. Raises StudyError if the study has no such trajectory."""
    last = len(study.design) - 1
    try:
        number = operator.index(trajectory)
    except TypeError:
        raise ArgumentError(f"trajectory={brief(trajectory)}; expected a whole number") from None
    if not 0 <= number <= last:
        raise StudyError(f"there is no trajectory {number} in the study; it has 0 … {last}")
    return number


def with_history(study: Study, save_every: int) -> Study:
    """Return the study with its whole history recorded.

    save_every : steps between rows; with adaptive steps the rows are at REPLAYED equal intervals,
        and at the study's own times. No number of a trajectory depends on it.
    """
    run = study.integrate
    changes: dict[str, Any] = {"save_every": save_every, "save_at": None}
    if run.is_adaptive:
        times = np.linspace(run.t0, run.t_end, REPLAYED + 1)
        if run.times is not None:
            times = np.union1d(times, np.clip(run.times, run.t0, run.t_end))
        changes = {"save_every": None, "save_at": times.tolist()}
    changes["record"] = ["state", "energy", "multipliers", "reaction"]
    return study.model_copy(update={"integrate": run.model_copy(update=changes)})


def only_setting(study: Study, given: dict[str, Any]) -> Setting:
    """Return the one setting that has the given values of KEYS; None fits any value.

    Raises ArgumentError if there are several, or none.
    """
    asked = {key: value for key, value in given.items() if value is not None}
    fitting = [
        setting
        for setting in study.settings
        if all(getattr(setting, key) == value for key, value in asked.items())
    ]
    if len(fitting) != 1:
        words = ", ".join(f"{key}={brief(value)}" for key, value in asked.items())
        listed = "; ".join(_named(study, setting) for setting in fitting or study.settings)
        what = "several settings" if fitting else "no setting"
        choose = "choose one of" if len(study.settings) > 1 else "the only one is"
        raise ArgumentError(
            f"{what} of the study {f'with {words}' if words else 'fit'}; {choose} {listed}"
        )
    return fitting[0]


def call_of(study: Study, setting: Setting, trajectory: int) -> str:
    """Return the call of `Dataset.replay` for a trajectory."""
    named = _named(study, setting) if len(study.settings) > 1 else ""
    return f"dataset.replay({trajectory}{f', {named}' if named else ''})"


def _named(study: Study, setting: Setting) -> str:
    """Return the keywords that tell a setting from the study's others; all of the only one."""
    is_only = len(study.settings) == 1
    return ", ".join(
        f"{key}={value!r}"
        for key in KEYS
        if (value := getattr(setting, key)) is not None
        and (is_only or len({getattr(each, key) for each in study.settings}) > 1)
    )
