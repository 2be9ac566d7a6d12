"""Rule by which a study ends early: `[sample] stop_when`.

    width of 95% of pointing_error_max < 0.01      the interval of that quantile, in its own unit
    width of 95% of pointing_error_max < 2%        relative to the quantile
    width of failed < 0.001                        of the share of bodies that fail

After each part, in the order of the parts, the rule is applied to all bodies of the setting up to
there; the first part after which it holds is the setting's last. The end of a study depends on the
study alone, not on the process that runs its parts, or on interruptions.
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
    """Bound on a confidence interval's width: of a column's quantile, or of the failed share.

    probability : of the quantile; None for the share that fails.   bound : on the interval's width.
    is_relative : True if the bound is a share of the quantile's size.
    """

    probability: float | None
    column: str
    bound: float
    is_relative: bool

    def holds(self, bodies: Bodies) -> bool:
        """Return whether the bodies are enough; False if they are too few for an interval."""
        if self.probability is None:
            return share_width(bodies.failed, bodies.count) < self.bound
        quantile = quantile_of(bodies.ordered, self.probability)
        return quantile.width < self.bound * (abs(quantile.value) if self.is_relative else 1.0)


def rule_of(text: str, problem: Problem | Mechanism, has_lane_clocks: bool = False) -> Rule:
    """Parse a rule about a column of the problem's summaries. Raises StudyError.

    has_lane_clocks : True if each trajectory has its own steps, and columns that count them.
    """
    match = FORM.fullmatch(text)
    share, column, bound, percent = match.groups("") if match else ("",) * 4
    if not match or (share == "") != (column == FAILED) or (column == FAILED and percent):
        raise StudyError(f"sample.stop_when: {brief(text)}; expected {EXPECTED}")
    probability = float(share) / 100.0 if share else None
    if probability is not None and not 0.0 < probability < 1.0:
        raise StudyError(f"sample.stop_when: {share}%; expected more than 0 and less than 100")
    names = [f"{measure.name}_{how}" for measure, how in KEPT]
    names += [f"{each.name}_{how}" for each in problem.observables for how in KEEPS]
    names += [name for name, shape, _ in problem.signals if shape == ()]
    names += [*COUNTS, "dt_last", "t"] if has_lane_clocks else []
    if isinstance(problem, Mechanism):
        kept = [f"{measure.name}_{how}" for measure, how in JOINT_KEPT]
        names += [f"{each.name}.{name}" for each in problem.links_and_loops for name in kept]
    if column != FAILED and column not in names:
        raise StudyError(f"sample.stop_when: {unknown_name('column', column, names)}")
    limit = float(bound) / (100.0 if percent else 1.0)
    if not limit > 0.0:
        raise StudyError(f"sample.stop_when: {bound}; expected a positive bound")
    return Rule(probability, column, limit, bool(percent))


class Bodies:
    """Statistics of the bodies so far in one setting, which a rule is applied to."""

    def __init__(self, rule: Rule) -> None:
        self.rule = rule
        self.count = self.failed = 0
        self.ordered: Array = np.empty(0)  # the column, over the bodies that are ok

    @property
    def columns(self) -> list[str]:
        """Names of the summary's columns that the rule depends on."""
        return ["status"] if self.rule.probability is None else ["status", self.rule.column]

    def add(self, summary: pa.Table) -> None:
        failed = has_failed(summary)
        self.count += len(failed)
        self.failed += int(failed.sum())
        if self.rule.probability is not None:
            values = as_array(summary[self.rule.column])[~failed]
            joined = np.concatenate((self.ordered, np.sort(values[~np.isnan(values)])))
            joined.sort(kind="stable")  # a merge of two sorted runs
            self.ordered = joined
