"""Count the occurrences of a study's events, and collect their first times."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pyarrow.compute as pc

from lierb.results.columns import as_array
from lierb.studies.description.quantiles import PROBABILITIES, Quantile, quantiles_of
from lierb.studies.description.settings import Setting
from lierb.studies.description.study import Study
from lierb.studies.findings.columns import ok_columns, rows_of
from lierb.studies.storage.results import Results
from lierb.support.arrays import Array


class Occurred(NamedTuple):
    """Count an event in one setting, over the bodies that did not fail.

    crossings : in all bodies.   bodies : number of those with a crossing, out of `of`.
    first : quantiles of the time of a body's first crossing, s; ∞ for a body without one.
    """

    setting: Setting
    name: str
    crossings: int
    bodies: int
    of: int
    first: tuple[Quantile, ...]


def event_names(study: Study) -> list[str]:
    """Return the names of the events in the tables."""
    return [each.label for each in study.problem.events]


def first_times(dataset: Results, setting: Setting, name: str) -> tuple[Array, Array, int]:
    """Return bodies, when an event first happened to each, and how often it happened in all.

    Times are in s, ∞ where it did not happen. Failed bodies do not count.
    """
    own = rows_of(setting)
    fine = ok_columns(dataset, setting, ["trajectory"])["trajectory"]
    rows = dataset.table("events").to_table(
        columns=["trajectory", "t"], filter=own & (pc.field("event") == name)
    )
    bodies, times = as_array(rows["trajectory"]), as_array(rows["t"])
    counted = np.isin(bodies, fine)
    order = np.argsort(fine, kind="stable")
    first = np.full(len(fine), np.inf)
    if counted.any():
        at = order[np.searchsorted(fine, bodies[counted], sorter=order)]
        np.minimum.at(first, at, times[counted])
    return fine, first, int(counted.sum())


def crossings(dataset: Results, probabilities: Sequence[float] = PROBABILITIES) -> list[Occurred]:
    """Return the occurrences of every event, setting by setting; [] without events."""
    occurred = []
    for setting in dataset.study.settings:
        for name in event_names(dataset.study):
            own, first, count = first_times(dataset, setting, name)
            independent = dataset.study.design.independent(own)
            quantiles = quantiles_of(first, independent, probabilities)
            had = int(np.isfinite(first).sum())
            occurred.append(Occurred(setting, name, count, had, len(first), quantiles))
    return occurred
