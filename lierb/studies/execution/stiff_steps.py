"""Warnings of a study's fixed steps that are too long for its forces."""

from __future__ import annotations

import warnings
from typing import Any

from lierb.errors import StiffStepWarning
from lierb.runs.stiffness import can_be_stiff, stiff_steps
from lierb.studies.description.study import Study
from lierb.support.collected_warnings import are_warnings_collected

MOST_BODIES = 4096  # first bodies of a study that are examined


def warn_of_stiff_steps(study: Study, **options: Any) -> None:
    """Issue one StiffStepWarning for all settings of a study.   options : of `warnings.warn`."""
    if not are_warnings_collected() and (messages := stiff_settings(study)):
        warnings.warn("\n  ".join(messages), StiffStepWarning, **options)


def stiff_settings(study: Study) -> list[str]:
    """Return a message for each setting with too long steps for the first bodies of a study."""
    model = study.batch(0, 1).problem
    timings = [study.options(setting, model).timing for setting in study.settings]
    timings = [timing for timing in timings if can_be_stiff(model, timing)]
    if not timings:  # bodies are drawn, and loops closed, for those that can be
        return []
    design = study.design
    count = min(len(design), MOST_BODIES)
    batch = study.batch(0, count, design)
    start = batch.problem, batch.pose0, batch.twist0, count
    messages = [stiff_steps(*start, timing) for timing in timings]
    return [message for message in dict.fromkeys(messages) if message]
