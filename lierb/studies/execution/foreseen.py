"""Warnings that a study issues once, before it runs, for all settings."""

from __future__ import annotations

import warnings

from lierb.errors import DerivativeWarning, StiffStepWarning
from lierb.runs.stiffness import can_be_stiff, stiff_steps
from lierb.runs.switches import switches_of
from lierb.studies.description.study import Study
from lierb.support.collected_warnings import are_warnings_collected

MOST_BODIES = 4096  # first bodies of a study that are examined


def warn_before(study: Study, stacklevel: int) -> None:
    """Issue the warnings of steps that are too long for forces, and of switches.

    stacklevel : stack level of warnings; 2 is the caller of this function.
    """
    for category, messages in ({} if are_warnings_collected() else foreseen(study)).items():
        warnings.warn("\n  ".join(messages), category, stacklevel=stacklevel)


def foreseen(study: Study) -> dict[type[Warning], list[str]]:
    """Return the messages of a study's warnings, by category."""
    messages: dict[type[Warning], list[str]] = {StiffStepWarning: stiff_settings(study)}
    if study.integrate.sensitivities:
        messages[DerivativeWarning] = [switches_of(study.batch(0, 1).problem)]
    return {category: own for category, own in messages.items() if any(own)}


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
