"""Warning of adaptive steps that resolve a motion, but not its derivatives."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from lierb.errors import DerivativeWarning
from lierb.runs.derivatives import Derivatives, integrate_with_derivatives
from lierb.runs.output import Output
from lierb.runs.parameters import chosen_parameters, slices_of
from lierb.runs.starts import Ready, ready
from lierb.support.arrays import Array, items_at
from lierb.support.collected_warnings import are_warnings_collected

EXAMINED = 8  # first trajectories of a batch, which run a second time
CHANGE = 0.1  # largest change of a derivative by half the steps, relative to the largest one
ROUNDING = 1e-10  # of derivatives by a parameter without effect, relative to those by others


def is_examined(run: Ready) -> bool:
    """Return True if the steps of a run are to be examined for its derivatives."""
    is_first = run.options.timing.is_adaptive and run.before is None
    return is_first and not are_warnings_collected()


def examine_steps(
    run: Ready, output: Output, found: Derivatives, threads: int | None, **options: Any
) -> None:
    """Run the first trajectories again, and warn if half the steps change derivatives at the end.

    options : keywords of `warnings.warn`.
    """
    if not is_examined(run):
        return
    lasted = output.t - run.options.timing.t0
    halved = with_half_steps(run, lasted, output.of_lanes("steps"))
    parameters = chosen_parameters(halved.model, [p.name for p in found.parameters])
    _, again = integrate_with_derivatives(halved, parameters, False, threads, False, None)
    ends = [x.ends[x.columns["links"], :, :EXAMINED] for x in (found, again)]
    pairs = {
        name: (ends[0][:, part], ends[1][:, part])
        for name, part in slices_of(found.parameters).items()
    }
    warn_of_long_steps(pairs, **options)


def with_half_steps(run: Ready, lasted: Array, steps: Array) -> Ready:
    """Return the run of the first trajectories with at most half of their mean steps.

    lasted, steps : duration, s, and number of steps of each trajectory.
    """
    first, timing = slice(0, EXAMINED), run.options.timing
    means = (lasted / np.maximum(steps, 1.0))[first]
    longest = 0.5 * means[means > 0.0].min(initial=timing.dt_max)
    numbers = np.arange(run.inputs.count) if run.trajectories is None else run.trajectories
    options = replace(
        run.options, timing=replace(timing, dt_max=longest), trajectories=numbers[first]
    )
    several = (run.model.batch_size() or 1) > 1
    model = run.model.part(first) if several else run.model
    return ready(model, options, _part(run.pose0, 2), _part(run.twist0, 1))


def _part(start: Any, axes: int) -> Any:
    if isinstance(start, dict):
        return {link: _part(each, axes) for link, each in start.items()}
    return None if start is None else items_at(start, slice(0, EXAMINED), axes)


def warn_of_long_steps(pairs: Mapping[str, tuple[Array, Array]], **options: Any) -> None:
    """Issue one DerivativeWarning if derivatives differ from those with half the steps.

    The motion alone decides on adaptive steps. They are too long for its derivatives where it is
    simpler than motions nearby: about a steady rotation or an equilibrium, at an amplitude of zero.

    pairs : derivatives with the steps and with half of them, [number][trajectory] of EXAMINED
        trajectories, NaN where a run has failed; by the name of the parameter or quantity.
    options : keywords of `warnings.warn`.
    """
    sizes = {name: np.nanmax(np.abs(again), initial=0.0) for name, (_, again) in pairs.items()}
    least = ROUNDING * max(sizes.values(), default=0.0)
    for name, (found, again) in pairs.items():
        change = np.nanmax(np.abs(again - found), initial=0.0)
        if change > CHANGE * max(sizes[name], least):
            share = 100.0 * change / (sizes[name] or change)
            warnings.warn(
                f"derivatives of or by {name} change by {share:.2g} % if steps are halved: "
                "adaptive steps resolve the motion alone, which is simpler than motions nearby; "
                "give dt or dt_max",
                DerivativeWarning,
                **options,
            )
            return
