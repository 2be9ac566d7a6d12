"""The case of a comparison is a model, its start, and the options common to all runs."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from lierb.api import integrate_model
from lierb.model.base import Model
from lierb.results.result import Result
from lierb.runs.options import Options
from lierb.support.progress import Progress


@dataclass(frozen=True)
class Case:
    """A model, its start and the common options of the runs.

    common : keywords of `lierb.integrate`.   norm : norm of an error over the trajectories.
    repeats : number of timed repetitions of a run.
    """

    model: Model
    pose0: Any
    twist0: Any
    t0: float
    t_end: float
    common: dict[str, Any]
    norm: str
    repeats: int

    @property
    def length(self) -> float:
        """t_end − t0, s."""
        return float(self.t_end) - float(self.t0)

    def options(self, **own: Any) -> Options:
        """Return the options of a run. Raises the errors of `lierb.integrate`."""
        return Options.of(self.model, t0=self.t0, t_end=self.t_end, **self.common, **own)

    def integrated(
        self, options: Options, threads: int | None = 1, progress: Progress = False
    ) -> Result:
        """Return the result of a run."""
        return integrate_model(
            self.model, options, self.pose0, self.twist0, threads=threads, progress=progress
        )

    def timed(self, options: Options, tell: Callable[[int], None] = lambda k: None) -> float:
        """Return the least CPU time of this thread over `repeats` runs, s; ∞ without a run."""
        seconds = math.inf
        for k in range(self.repeats):
            tell(k)
            began = time.thread_time()
            self.integrated(options)
            seconds = min(seconds, time.thread_time() - began)
        return seconds
