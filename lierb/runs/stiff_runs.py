"""Warning of adaptive runs of explicit methods whose steps are limited by stability."""

from __future__ import annotations

import warnings
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

from lierb.errors import StiffStepWarning
from lierb.kernels.loops.ends import end_columns
from lierb.kernels.systems.extra_states import Control, with_signals
from lierb.kernels.systems.plan import AnyPlan
from lierb.kernels.systems.signals import controllers_of, lane_end
from lierb.kernels.systems.system_of import system_of
from lierb.kernels.systems.unknowns import Unknowns
from lierb.methods import Method
from lierb.runs.output import Output
from lierb.runs.starts import Ready
from lierb.support.arrays import Array
from lierb.support.collected_warnings import are_warnings_collected

MANY = 2000  # steps of a trajectory, from which on it is examined
# Steps limited by accuracy that resolve a decaying motion are shorter than this share of the bound.
SHARE = 0.3
FARTHEST = 100.0  # largest −hλ of a stability bound that is looked for


def warn_of_stiff_run(run: Ready, output: Output, **options: Any) -> None:
    """Issue one StiffStepWarning if stability limits the steps of the trajectory with most steps.

    The Jacobian at its end has an eigenvalue λ < 0 such that hλ, with the mean step h, is near the
    stability bound of the method.   options : keywords of `warnings.warn`.
    """
    timing, plan = run.options.timing, run.plan
    method = timing.method
    if not timing.is_adaptive or method.needs_derivatives or are_warnings_collected():
        return
    if plan.update == "global" or plan.calls_functions or plan.code.is_looped:
        return  # formulas for numbers in the chart of a step, of one size, are needed
    steps = output.of_lanes("steps")
    number = int(np.argmax(steps))
    length = (output.t[number] - timing.t0) / max(steps[number], 1.0)
    if steps[number] < MANY or output.status[number]:
        return
    fastest = -eigenvalues_at_end(run, output, number).real.min()
    if length * fastest < SHARE * stability_bound(method):
        return
    whose = f" of trajectory {number}" if len(steps) > 1 else ""
    warnings.warn(
        f"stability, not accuracy, limits the {int(steps[number])} steps{whose} by {method.name}: "
        f"they are {length:.2g} s long on average, and motions decay within {1.0 / fastest:.2g} s; "
        'method="Rodas4", for stiff problems, makes longer steps',
        StiffStepWarning,
        **options,
    )


def eigenvalues_at_end(run: Ready, output: Output, number: int) -> Array:
    """Eigenvalues of the rates' Jacobian at the end of a trajectory, 1/s."""
    plan: AnyPlan = replace(run.plan, update="local")
    system = system_of(plan)
    body = system.body([float(x) for x in run.inputs.numbers(number)])
    numbers = [0.0] * (system.state.count + lane_end(plan).count)
    for column, value in zip(end_columns(plan), output.ends[:, number], strict=True):
        numbers[column] = float(value)
    state = system.state_of(numbers[: system.state.count], body)
    if controllers_of(plan):
        parts = lane_end(plan).parts(numbers[system.state.count :])
        control = Control(tuple(parts["controls"]), tuple(parts["memory"]), ())
        body = with_signals(plan, body, state, control)
    gravity = system.chart_gravity(body, state.chart)
    _, jacobian = Unknowns(system, state).jacobian(body, gravity, float(output.t[number]))
    rows = np.array([[float(x) for x in row] for row in jacobian.rows])
    if not np.isfinite(rows).all():
        return np.zeros(1)
    return np.linalg.eigvals(rows)


@cache
def stability_bound(method: Method) -> float:
    """Largest x for which |R(−x)| ≤ 1 on [0, x], with R the method's stability function."""
    x = np.linspace(0.0, FARTHEST, 10_001)
    size = np.abs(method.amplification(-x))
    return float(x[max(int(np.argmax(size > 1.0 + 1e-9)) - 1, 0)])
