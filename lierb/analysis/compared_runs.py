"""Run a comparison: methods on c-spaces at steps or tolerances, and their rows of the table."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from lierb.analysis.case import Case
from lierb.analysis.comparison_orders import FLOOR
from lierb.analysis.comparison_tables import QUANTITIES
from lierb.analysis.magnitudes import DRIFTS, kinds_of
from lierb.analysis.reference import MARGIN, Ends, Reference, normed, rounding
from lierb.errors import ArgumentError
from lierb.methods.method import Method, StagedMethod
from lierb.model.base import Model
from lierb.model.formulation import CSpace, described_cspace
from lierb.results.columns import as_array
from lierb.results.failures import Failures
from lierb.results.result import Result
from lierb.runs.options import Options
from lierb.support.representations import counted


@dataclass(frozen=True)
class Run:
    """A run is a method on a c-space, at a step, s, or a tolerance."""

    method: Method
    cspace: CSpace
    dt: float | None
    rtol: float | None
    options: Options | None = None

    @property
    def label(self) -> str:
        control = f"rtol = {self.rtol:g}" if self.dt is None else f"dt = {self.dt:g} s"
        return f"{self.method.name}, {described_cspace(self.cspace)}, {control}"


def compared(
    case: Case,
    runs: list[Run],
    exact: Reference,
    sizes: dict[str, float],
    tell: Callable[[int, str, float], None],
) -> tuple[list[dict[str, Any]], list[str]]:
    """Run each method; return the rows of the table, and messages of failed trajectories.

    tell : function of (number of finished runs, label of the current run, its fraction).
    """
    rows, failures = [], []
    for done, run in enumerate(runs):
        result, seconds = _ran(case, run, partial(tell, done, run.label))
        rows.append(_row(case, run, result, seconds, exact, sizes))
        if failed := Failures.of(result.summary):
            failures.append(f"{run.label}: {failed}")
    return rows, failures


def _ran(case: Case, run: Run, tell: Callable[[float], None]) -> tuple[Result, float]:
    """Run once to compile, then `repeats` times to measure the CPU time, s; ∞ if it is not."""
    assert run.options is not None
    parts = case.repeats + 1
    tell(0.0)
    result = case.integrated(
        run.options, progress=lambda done, total: tell(done / max(total, 1) / parts)
    )
    return result, case.timed(run.options, lambda k: tell((k + 1) / parts))


def _row(
    case: Case, run: Run, result: Result, seconds: float, reference: Reference,
    sizes: dict[str, float],
) -> dict[str, Any]:  # fmt: skip
    """Return a row of the table, by column."""
    summary, ends = result.summary, Ends.of(result.summary, result.links)
    failed, count = ends.failed, len(ends.failed)
    if len(reference.ends.failed) != count:
        raise ArgumentError(
            f"reference has {counted(len(reference.ends.failed), 'trajectory', 'trajectories')}; "
            f"expected {count}, a pose and a twist for each of the batch"
        )
    missing = ends.failed | reference.ends.failed
    if "steps" in summary.column_names:  # adaptive steps, or steps that end at a controller's tick
        steps, rejected = (as_array(summary[c]).astype(float) for c in ("steps", "rejected"))
    else:
        assert run.dt is not None
        steps, rejected = np.full(count, float(round(case.length / run.dt))), np.zeros(count)
    mean = float(np.mean(steps[~failed])) if not failed.all() else math.nan
    refused = float(np.mean(rejected[~failed])) if not failed.all() else math.nan
    errors = normed(ends.errors(reference.ends), case.norm)
    drifts = normed(
        {k: np.where(failed, np.nan, as_array(summary[f"{c}_max"])) for k, c in DRIFTS.items()},
        case.norm,
    )
    row: dict[str, Any] = {
        "method": run.method.name, "cspace": described_cspace(run.cspace), "dt": run.dt,
        "rtol": run.rtol, "step": run.dt if run.dt is not None else _or_none(case.length / mean),
        "steps": _or_none(mean), "rejected": _or_none(refused),
        "evaluations": _or_none(_evaluations(run.method, run.rtol is not None, mean + refused)),
        "cpu_time": _or_none(seconds),
        "trajectories": count, "failed": int(missing.sum()),
    }  # fmt: skip
    numbers = {f"error.{k}": v for k, v in errors.items()}
    numbers |= {f"drift.{k}": v for k, v in drifts.items()}
    present = quantities_of(case.model)
    for quantity in QUANTITIES:
        floor = sizes[quantity] * float(rounding(mean if math.isfinite(mean) else 1.0))
        if quantity.startswith("error."):
            floor = max(floor, MARGIN * reference.errors[quantity.removeprefix("error.")])
        row[quantity] = _or_none(numbers[quantity]) if quantity in present else None
        row[quantity + FLOOR] = floor if quantity in present else None
    return row


def _or_none(number: float) -> float | None:
    return number if math.isfinite(number) else None


def _evaluations(method: Method, is_adaptive: bool, steps: float) -> float:
    """Return the number of right-hand sides.

    It is NaN for a method whose iteration evaluates them. Fixed steps omit the stages that only
    the error estimate uses. Adaptive steps need all stages, and two evaluations to choose the first
    step.
    """
    if is_adaptive:
        assert isinstance(method, StagedMethod)
        return method.stages * steps + 2.0
    return method.evaluations * steps


def quantities_of(model: Model) -> list[str]:
    """Return the names of all errors, and of the drifts of each kind with rows.

    A row of a constraint may be of either kind.
    """
    kinds = kinds_of(model) | ({"position", "rotation"} if model.constraints else set())
    absent = {f"drift.{kind}" for kind in ("position", "rotation") if kind not in kinds}
    return [quantity for quantity in QUANTITIES if quantity not in absent]
