"""Warnings of a study's fixed steps that are too long for its forces."""

from __future__ import annotations

import warnings
from typing import Any

from lierb.errors import StiffStepWarning
from lierb.runs.stiffness import stiff_steps
from lierb.studies.description.study import Study
from lierb.support.collected_warnings import are_warnings_collected

MOST_BODIES = 4096  # first bodies of a study that are examined


def warn_of_stiff_steps(study: Study, **options: Any) -> None:
    """Issue one StiffStepWarning for all settings of a study.   options : of `warnings.warn`."""
    if not are_warnings_collected() and (messages := stiff_settings(study)):
        warnings.warn("\n  ".join(messages), StiffStepWarning, **options)


def stiff_settings(study: Study) -> list[str]:
    """Return a message for each setting with too long steps for the first bodies of a study."""
    design = study.design
    count = min(len(design), MOST_BODIES)
    batch = study.batch(0, count, design)
    messages = []
    for setting in study.settings:
        timing = study.options(setting, batch.problem).timing
        messages.append(stiff_steps(batch.problem, batch.pose0, batch.twist0, count, timing))
    return [message for message in dict.fromkeys(messages) if message]
