"""Rank a study's bodies by a column of the summary, the worst first."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lierb.errors import require_name
from lierb.studies.description.stopping import number_columns
from lierb.studies.description.study import Study
from lierb.studies.findings.sizes import errors_seen
from lierb.studies.storage.results import Results
from lierb.support.arrays import Array

SMALLEST = "-"  # prefix of a column whose smallest numbers are the worst


class Ranking(NamedTuple):
    """Column of the summary by which bodies are ranked.

    is_reversed : True if the smallest number is the worst; otherwise the largest is.
    """

    column: str
    is_reversed: bool = False

    @property
    def label(self) -> str:
        return f"{'smallest' if self.is_reversed else 'largest'} {self.column}"

    def order(self, values: Array) -> NDArray[np.intp]:
        """Return indices from the worst value to the best; NaN is left out."""
        ranks = np.argsort(values if self.is_reversed else -values, kind="stable")
        return ranks[~np.isnan(values[ranks])]


def ranking_named(study: Study, rank_by: str) -> Ranking:
    """Return the ranking by a column.   rank_by : its name; `-NAME` ranks the smallest first.

    Raises UnknownNameError for a name that is no column of one number in the summary.
    """
    known = number_columns(study.batch(0, 1).problem, study.has_lane_clocks)
    column = rank_by.removeprefix(SMALLEST) if isinstance(rank_by, str) else rank_by
    require_name("rank_by", column, known)
    return Ranking(column, column != rank_by)


def rankings(dataset: Results, rank_by: str | None = None) -> list[Ranking]:
    """Return the rankings of a report, the most important one first.

    rank_by : see `ranking_named`. Default: the column of the study's stopping rule, or else the
    maximum of the first observable, or else every error that is not negligible.
    """
    study = dataset.study
    if rank_by is not None:
        return [ranking_named(study, rank_by)]
    rule = study.stopping_rule
    if rule is not None and rule.probability is not None:
        return [Ranking(rule.column)]
    if observables := study.batch(0, 1).problem.observables:
        return [Ranking(f"{observables[0].name}_max")]
    return [Ranking(column) for column in errors_seen(dataset).values()]
