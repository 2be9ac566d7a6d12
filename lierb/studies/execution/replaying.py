"""Run one trajectory of a study alone, or compile a study's kernels alone."""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pyarrow as pa

from lierb.api import integrate_model
from lierb.studies.description.differentiated import parameters_of
from lierb.studies.description.settings import Setting
from lierb.studies.description.study import Study
from lierb.studies.execution.opening import loaded
from lierb.studies.storage.parts import Part
from lierb.studies.storage.replaying import require_trajectory, with_history
from lierb.support.collected_warnings import warnings_collected

REPLAY = "`lierb run STUDY --only NUMBER`, or `Dataset.replay`, shows all that one of them did"


def replay(
    study: Study | str | Path, trajectory: int, *, save_every: int = 1, threads: int | None = None
) -> list[tuple[Setting, dict[str, pa.Table]]]:
    """Integrate one trajectory of a study, with everything recorded, in each setting.

    save_every : see `lierb.studies.storage.replaying.with_history`.

    Its row of the summary, and its events, are those of the study, bit for bit.
    """
    given, _ = loaded(study)
    trajectory = require_trajectory(given, trajectory)
    recorded = with_history(given, save_every)
    return [
        (setting, Part("", setting, trajectory, 1).tables(recorded, given.design, threads))
        for setting in recorded.settings
    ]


def compile_for(
    study: Study | str | Path, changes: Mapping[str, Any] | None = None
) -> list[tuple[Setting, float]]:
    """Compile the kernels of a study, by one step in each setting; return the seconds taken."""
    given, _ = loaded(study, changes)
    batch = given.batch(0, 1)
    parameters, seconds = parameters_of(given, batch.problem), []
    for setting in given.settings:
        one_step = {"max_steps": 1} if given.has_lane_clocks else {"t0": 0.0, "t_end": setting.dt}
        options = given.options(setting, batch.problem, **one_step)
        began = time.perf_counter()
        with warnings_collected():
            integrate_model(
                batch.problem, options, batch.pose0, batch.twist0,
                with_respect_to=[p.name for p in parameters.values()], progress=False,
            )  # fmt: skip
        seconds.append((setting, time.perf_counter() - began))
    return seconds
