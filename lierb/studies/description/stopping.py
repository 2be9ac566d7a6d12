"""Stopping rule that ends a study early: `[sample] stop_when`.

    width of 95% of pointing_error_max < 0.01      interval of the quantile, in the column's unit
    width of 95% of pointing_error_max < 2%        the same, relative to the quantile
    width of failed < 0.001                        interval of the share of failed bodies

After each part, in the order of the parts, the rule is applied to all bodies of the setting so far.
The first part after which the rule holds is the last part of the setting. The end of a study
therefore depends on the study alone, not on processes or interruptions.
"""

from __future__ import annotations

import re
from typing import NamedTuple

import numpy as np
import pyarrow as pa

from lierb.errors import StudyError, brief, unknown_name
from lierb.kernels.systems.measures import JOINT_KEPT, KEPT
from lierb.kernels.systems.observables import KEEPS
from lierb.model.mechanism.mechanism import Mechanism
from lierb.model.problem import Problem
from lierb.results.columns import as_array
from lierb.results.failures import has_failed
from lierb.results.tables import COUNTS
from lierb.sampling import Design
from lierb.studies.description.quantiles import quantile_of, share_width
from lierb.support.arrays import Array

FAILED = "failed"
NUMBER = r"[0-9]+(?:\.[0-9]*)?(?:e[-+]?[0-9]+)?"
FORM = re.compile(
    rf"\s*width\s+of\s+(?:({NUMBER})\s*%\s+of\s+)?([\w.]+)\s*<\s*({NUMBER})\s*(%?)\s*",
    re.IGNORECASE,
)
EXPECTED = '"width of 95% of COLUMN < 0.01", "… < 2%", or "width of failed < 0.001"'


class Rule(NamedTuple):
    """Bound on the width of the confidence interval of a column's quantile or the failed share.

    probability : of the quantile; None for the failed share.   bound : of the interval's width.
    is_relative : True if the bound is relative to the quantile.
    """

    probability: float | None
    column: str
    bound: float
    is_relative: bool

    def holds(self, bodies: Bodies) -> bool:
        """Return True if the rule holds; False for too few bodies for an interval."""
        if self.probability is None:
            return share_width(bodies.failed, bodies.count) < self.bound
        quantile = quantile_of(bodies.ordered, self.probability)
        return quantile.width < self.bound * (abs(quantile.value) if self.is_relative else 1.0)


def rule_of(text: str, problem: Problem | Mechanism, has_lane_clocks: bool = False) -> Rule:
    """Parse a rule about a column of the problem's summary. Raises StudyError.

    has_lane_clocks : True if each trajectory has its own steps, which summary columns count.
    """
    match = FORM.fullmatch(text)
    share, column, bound, percent = match.groups("") if match else ("",) * 4
    if not match or (share == "") != (column == FAILED) or (column == FAILED and percent):
        raise StudyError(f"sample.stop_when: {brief(text)}; expected {EXPECTED}")
    probability = float(share) / 100.0 if share else None
    if probability is not None and not 0.0 < probability < 1.0:
        raise StudyError(f"sample.stop_when: {share}%; expected more than 0 and less than 100")
    names = number_columns(problem, has_lane_clocks)
    if column != FAILED and column not in names:
        raise StudyError(f"sample.stop_when: {unknown_name('column', column, names)}")
    limit = float(bound) / (100.0 if percent else 1.0)
    if not limit > 0.0:
        raise StudyError(f"sample.stop_when: {bound}; expected a positive bound")
    return Rule(probability, column, limit, bool(percent))


def observed_columns(problem: Problem | Mechanism) -> list[str]:
    """Return the names of the summary's columns of observables."""
    return [f"{each.name}_{how}" for each in problem.observables for how in KEEPS]


def number_columns(problem: Problem | Mechanism, has_lane_clocks: bool) -> list[str]:
    """Return the columns of a problem's summary that have one number for each trajectory.

    has_lane_clocks : True if each trajectory has its own steps, which columns count.
    """
    names = [f"{measure.name}_{how}" for measure, how in KEPT]
    names += observed_columns(problem)
    names += [name for name, shape, _ in problem.signals if shape == ()]
    names += [*COUNTS, "dt_last", "t"] if has_lane_clocks else []
    if isinstance(problem, Mechanism):
        kept = [f"{measure.name}_{how}" for measure, how in JOINT_KEPT]
        names += [f"{each.name}.{name}" for each in problem.links_and_loops for name in kept]
    return names


class Bodies:
    """Statistics of the finished bodies in one setting, for a stopping rule.

    Only bodies that the design draws independently of each other count.
    """

    def __init__(self, rule: Rule, design: Design) -> None:
        self.rule, self.design = rule, design
        self.count = self.failed = 0
        self.ordered: Array = np.empty(0)  # column values of the ok bodies

    @property
    def columns(self) -> list[str]:
        """Names of the summary columns on which the rule depends."""
        own = [] if self.rule.probability is None else [self.rule.column]
        return ["trajectory", "status", *own]

    def add(self, summary: pa.Table) -> None:
        own = self.design.independent(as_array(summary["trajectory"]))
        failed = has_failed(summary)[own]
        self.count += len(failed)
        self.failed += int(failed.sum())
        if self.rule.probability is not None:
            values = as_array(summary[self.rule.column])[own][~failed]
            joined = np.concatenate((self.ordered, np.sort(values[~np.isnan(values)])))
            joined.sort(kind="stable")  # a merge of two sorted runs
            self.ordered = joined
