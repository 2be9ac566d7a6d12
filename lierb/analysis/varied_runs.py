"""Runs of a varied model, with the options of `lierb.integrate` that fits and propagation take."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any, NamedTuple

import pyarrow as pa

from lierb.api import integrate_model
from lierb.errors import TimeGridError, unknown_name
from lierb.results.columns import as_array
from lierb.results.result import Result
from lierb.runs.derivative_steps import examine_steps, is_examined
from lierb.runs.derivatives import integrate_with_derivatives
from lierb.runs.options import Options
from lierb.runs.parameters import Parameter
from lierb.runs.starts import ready
from lierb.runs.time_options import checked_steps, checked_time, checked_within
from lierb.runs.variations import Varied
from lierb.support.arrays import Array

OPTIONS = (
    "dt", "rtol", "atol", "dt_min", "dt_max", "max_steps", "discontinuities", "method", "cspace",
    "update", "solver", "stabilise", "check", "seed", "trajectories", "threads",
)  # fmt: skip
MOST_STEPS = 10  # attempted steps of a trial, by those of the guess; wild numbers would take ages
RTOL = 1e-9  # of runs without a step or tolerance


class Runs(NamedTuple):
    """Runs of a fit.   keywords : of `Options.of`.   threads : of `lierb.integrate`."""

    keywords: dict[str, Any]
    threads: int | None

    def options(self, model: Any) -> Options:
        return Options.of(model, **self.keywords, statistics=False)

    def result(
        self, varied: Varied, parameters: Iterable[str | Parameter] = (), has_tables: bool = True
    ) -> Result:
        """Return the run of a model from its start.

        has_tables : False for derivatives without tables, for `Result.sensitivity` alone.
        """
        start = varied.start
        return integrate_model(
            varied.model, self.options(varied.model), start["pose0"], start["twist0"],
            with_respect_to=parameters, threads=self.threads, progress=False,
            has_tables=has_tables, argument="parameters",
        )  # fmt: skip

    def warn_of_long_steps(self, varied: Varied, parameters: tuple[Parameter, ...]) -> None:
        """Issue a DerivativeWarning if adaptive steps are too long for derivatives."""
        start = varied.start
        run = ready(varied.model, self.options(varied.model), start["pose0"], start["twist0"])
        if is_examined(run):
            found = integrate_with_derivatives(run, parameters, False, self.threads, False, None)
            examine_steps(run, *found, self.threads, stacklevel=5)

    def most_steps(self, summary: pa.Table) -> int | None:
        """Return MOST_STEPS times the attempted steps of a run; None if steps are not adaptive."""
        given = {name for name, value in self.keywords.items() if value is not None}
        if "max_steps" in given or not given & {"rtol", "atol"}:
            return None
        steps = as_array(summary["steps"]) + as_array(summary["rejected"])
        return MOST_STEPS * (int(steps.max()) + 10)


def runs_of(
    name: str, times: Array, t0: Any, t_end: Any, record: list[str], options: dict[str, Any]
) -> Runs:
    """Return the runs that save these times.   name : of the times, for messages.

    Raises ArgumentError for an unknown option, TimeGridError for times that do not fit.
    """
    keywords, threads = options_and_threads(options)
    end = _end_of(name, times, t0, t_end, keywords)
    keywords |= {"t0": t0, "t_end": end, "save_at": times, "record": record}
    return Runs(keywords, threads)


def _end_of(name: str, times: Array, t0: Any, t_end: Any, keywords: dict[str, Any]) -> float:
    """Return the end of runs that save these times, by default the last of them."""
    start, last = checked_time("t0", t0, after=-math.inf), float(times[-1])
    if t_end is None and last <= start:
        raise TimeGridError(f"{name} ends at {last!r} s; expected a time later than t0={start!r} s")
    end = last if t_end is None else checked_time("t_end", t_end, after=start)
    checked_within(name, times, start, end)
    if t_end is None and all(keywords.get(each) is None for each in ("rtol", "atol")):
        step = checked_time("dt", keywords["dt"])
        try:
            checked_steps(step, end, start)
        except TimeGridError as error:
            raise TimeGridError(
                f"{name} ends at {last!r} s, and t_end= is not given: {error}"
            ) from None
    return end


def options_and_threads(options: dict[str, Any]) -> tuple[dict[str, Any], int | None]:
    """Return keywords of `Options.of`, and threads. Raises ArgumentError for an unknown option."""
    for name in options:
        if name not in OPTIONS:
            raise unknown_name("option", name, OPTIONS)
    keywords = dict(options)
    threads = keywords.pop("threads", None)
    if all(keywords.get(name) is None for name in ("dt", "rtol", "atol")):
        keywords["rtol"] = RTOL
    return keywords, threads
