"""Run one trajectory of a study alone, or compile a study's kernels alone."""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from lierb.api import integrate_model
from lierb.errors import StudyError
from lierb.studies.description.settings import Setting
from lierb.studies.description.study import Study
from lierb.studies.execution.opening import loaded
from lierb.studies.storage.parts import Part
from lierb.support.collected_warnings import warnings_collected

REPLAYED = 1000  # equal intervals of the history of a replay with adaptive steps
REPLAY = (
    "lierb.studies.execution.replaying.replay, or `lierb run STUDY --only NUMBER`, shows all that "
    "one of them did"
)


def replay(
    study: Study | str | Path, trajectory: int, *, save_every: int = 1, threads: int | None = None
) -> list[tuple[Setting, dict[str, pa.Table]]]:
    """Integrate one trajectory of a study, with everything recorded, in each setting.

    save_every : steps between rows of its history; with adaptive steps the rows are at REPLAYED
        equal intervals, and at the study's own times.

    Its row of the summary, and its events, are those of the study, bit for bit.
    """
    given, _ = loaded(study)
    last = len(given.design) - 1
    if not 0 <= trajectory <= last:
        raise StudyError(f"there is no trajectory {trajectory} in the study; it has 0 … {last}")
    recorded = _with_history(given, save_every)
    return [
        (setting, Part("", setting, trajectory, 1).tables(recorded, given.design, threads))
        for setting in recorded.settings
    ]


def _with_history(study: Study, save_every: int) -> Study:
    """Return the study with its whole history recorded."""
    run = study.integrate
    changes: dict[str, Any] = {"save_every": save_every, "save_at": None}
    if run.is_adaptive:
        times = np.linspace(run.t0, run.t_end, REPLAYED + 1)
        if run.times is not None:
            times = np.union1d(times, np.clip(run.times, run.t0, run.t_end))
        changes = {"save_every": None, "save_at": times.tolist()}
    changes["record"] = ["state", "energy", "multipliers", "reaction"]
    return study.model_copy(update={"integrate": run.model_copy(update=changes)})


def compile_for(
    study: Study | str | Path, changes: Mapping[str, Any] | None = None
) -> list[tuple[Setting, float]]:
    """Compile the kernels of a study, by one step in each setting; return the seconds taken."""
    given, _ = loaded(study, changes)
    batch = given.batch(0, 1)
    seconds = []
    for setting in given.settings:
        one_step = {"max_steps": 1} if given.has_lane_clocks else {"t0": 0.0, "t_end": setting.dt}
        options = given.options(setting, batch.problem, **one_step)
        began = time.perf_counter()
        with warnings_collected():
            integrate_model(batch.problem, options, batch.pose0, batch.twist0, progress=False)
        seconds.append((setting, time.perf_counter() - began))
    return seconds
