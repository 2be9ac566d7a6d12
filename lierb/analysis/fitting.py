"""`fit` estimates parameters of a problem from measured motions, by least squares."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lierb.analysis.bounds import bounds_of
from lierb.analysis.fit_result import Fit
from lierb.analysis.fit_task import Task
from lierb.analysis.followed import held_directions
from lierb.analysis.guesses import guessed
from lierb.analysis.identifiability import (
    Direction,
    Identified,
    described,
    few_samples,
    of_numbers,
)
from lierb.analysis.measurements import Measurements, measurements
from lierb.analysis.minimising import REASONS, STUCK
from lierb.analysis.quantities import records_of, require_derivatives
from lierb.analysis.unknowns import Unknowns
from lierb.analysis.varied_runs import Runs, runs_of
from lierb.api import checked_model
from lierb.errors import ArgumentError, brief
from lierb.model.base import Model
from lierb.model.mechanism.mechanism import Mechanism
from lierb.model.problem import Problem
from lierb.runs.parameters import Parameter, separate_parameters
from lierb.runs.switches import warn_of_switches
from lierb.runs.variations import Variation, Varied, fixed_directions, with_directions, with_start
from lierb.support.arrays import Array, is_whole
from lierb.support.collected_warnings import warnings_collected
from lierb.support.extras import require
from lierb.support.representations import counted

ROUNDS = 5  # beginnings from the last estimate, at most
FIRST_STEP = 0.3  # largest first change of all unknowns, of their sizes; later ones may be larger
MOVED = 1e-10  # relative change of an estimate that counts as none
AT_BOUND = 1e-6  # distance from a bound, in first steps, that counts as none
TOLERANCES = {"ftol": 1e-13, "xtol": 1e-11, "gtol": 1e-15}


def fit(
    problem: Problem | Mechanism,
    data: Any,
    parameters: str | Iterable[str] | Mapping[str, ArrayLike | None],
    *,
    sigma: Mapping[str, ArrayLike] | None = None,
    bounds: Mapping[str, tuple[ArrayLike, ArrayLike]] | None = None,
    twist0: ArrayLike | Mapping[str, ArrayLike] | None = None,
    pose0: Any = None,
    t0: float = 0.0,
    t_end: float | None = None,
    max_evaluations: int = 200,
    **options: Any,
) -> Fit:
    """Estimate parameters from measured motions: least squares with exact derivatives of the run.

    Parameters
    ----------
    problem : Problem or Mechanism
        The model; its numbers are the guess. Parameters to be estimated have one value for all
        trajectories.
    data : mapping, pyarrow.Table, pandas.DataFrame, or list of them
        Columns by name: "t", (m,), ascending times in s, and measured columns, (m, …), or
        (m, n, …) for n trajectories. A list has a table for each trajectory, whose times may
        differ. A missing sample is NaN. Columns are "omega", "v", "twist", "position", "rotation"
        (or "R"), "quaternion", "pose", "coordinates", "energy", names of observables and states,
        "lambda" and "reaction"; for a mechanism "rod.omega", "rod.coordinates", "pin.reaction".
        A quaternion is (w, x, y, z) of length 1.
        `Result.history` and its data frames are such tables.
    parameters : str, iterable of str, or mapping
        Parameters by the names of `with_respect_to` in `integrate`, or a dictionary with a guess
        of each, or None for the problem's numbers. "omega0", "twist0" and "pose0" are estimated
        for each trajectory, along the directions that the joints admit.
    sigma : mapping, optional
        Standard deviations of the noise by column: a number, or one for each component. Default:
        all weights are 1, and the covariance is scaled by the variance of the residuals.
    bounds : mapping, optional
        Pairs (low, high) by parameter. An inertia needs none: its estimate is always that of a
        rigid body. `status` of the result names the numbers that end at a bound.
    twist0 : array_like, shape (6,) or (n, 6), or dict of them, optional
        Twist at t0, or its guess, as in `integrate`.
    pose0 : array_like, Rotation or RigidTransform, (4, 4) or (n, 4, 4), or dict of them, optional
        Pose at t0, or its guess, as in `integrate`.
    t0 : float, optional
        Start time, s.
    t_end : float, optional
        End time of the runs, s. Default: the last time of the data.
    max_evaluations : int, optional
        Largest number of runs without derivatives.
    **options : object
        Options of `integrate`: dt, rtol, atol, method, cspace, solver, stabilise, threads and the
        like. Default: rtol=1e-9.

    Returns
    -------
    Fit
        Estimate, standard errors and covariance, unidentifiable directions, the fitted problem and
        its run.

    Raises
    ------
    LierbError
        An argument is wrong, or the run of the guess fails. The subclasses classify the error.
    MissingExtraError
        SciPy is not installed; it is the extra `lierb[scipy]`.

    Notes
    -----
    The minimum is a local one: the run of the guess must stay near the data, for a turning body
    within half a turn. Standard errors hold for independent Gaussian noise with the given `sigma`.
    Differences of rotations and poses are log(R_dataᵀ R) and log(C_data⁻¹ C), in body axes. If
    "body.inertia" is a parameter, mass, centre of mass and inertia are varied in log-Cholesky
    coordinates of the pseudo-inertia. If a step of the iteration leads to numbers that no body has,
    or to a run that fails, a shorter one is tried. The Jacobian is a dense matrix. `lierb.fits`
    fits many experiments with unknowns of their own.

    Examples
    --------
    >>> import lierb
    >>> hinge = lierb.joints.revolute(axis=(0.0, 1.0, 0.0), body_point=(0.0, 0.0, 0.15))
    >>> rod = lierb.bodies.rod(0.3, 0.01, mass=0.2)
    >>> def pendulum(stiffness, damping):
    ...     spring = lierb.forces.torsional_spring(stiffness=stiffness, damping=damping)
    ...     return lierb.Problem(rod, hinge, (0.0, 0.0, -9.81), spring)
    >>> run = {"twist0": hinge.twist(omega=(0.0, 3.0, 0.0)), "dt": 1e-2}
    >>> saved = {"save_at": [0.5, 1.0, 1.5, 2.0], "record": "state"}
    >>> measured = lierb.integrate(pendulum(0.1, 2e-3), **run, t_end=2.0, **saved)
    >>> data = {"t": measured.t, "omega": measured.omega}
    >>> unknown = ["torsional_spring.stiffness", "torsional_spring.damping"]
    >>> fitted = lierb.fit(pendulum(0.15, 1e-3), data, unknown, **run)
    >>> {name: x.round(9).tolist() for name, x in fitted.estimate.items()}
    {'torsional_spring.stiffness': [0.1], 'torsional_spring.damping': [0.002]}
    """
    require("scipy")
    model = checked_model(problem)
    given = measurements(model, data, sigma)
    chosen, by_name = chosen_and_guesses(model, given, parameters)
    require_whole("max_evaluations", max_evaluations)
    base = _of_trajectories(with_start(model, pose0, twist0), given.count, chosen)
    runs = fit_runs(given, t0, t_end, options)
    warn_of_switches(model, stacklevel=3)
    variation = guessed(Variation(base, chosen, runs.options(model).timing.t0), by_name)
    runs.warn_of_long_steps(variation.base, chosen)
    with warnings_collected(), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return _solved(variation, given, runs, bounds, int(max_evaluations))


def chosen_and_guesses(
    model: Model, given: Measurements, parameters: Any
) -> tuple[tuple[Parameter, ...], dict[str, Any]]:
    """Return the parameters of a fit, and their guesses by name. Raises ArgumentError."""
    guesses = dict(parameters) if isinstance(parameters, Mapping) else {}
    names = [*guesses] if isinstance(parameters, Mapping) else parameters
    chosen = separate_parameters(model, names)
    if not chosen:
        raise ArgumentError("parameters is empty; expected names, such as body.mass")
    for column in given.columns:
        require_derivatives(column.quantity, chosen)
    return chosen, {p.name: x for p, x in zip(chosen, guesses.values(), strict=False)}


def require_whole(argument: str, given: Any) -> None:
    """Raise ArgumentError unless an argument is a whole number, 1 or more."""
    if not (is_whole(given) and given > 0):
        raise ArgumentError(f"{argument}={brief(given)}; expected a whole number, 1 or more")


def fit_runs(given: Measurements, t0: Any, t_end: Any, options: dict[str, Any]) -> Runs:
    """Return the runs that save the measured quantities at the times of the data."""
    record = records_of([c.quantity for c in given.columns])
    return runs_of("data: t", given.t, t0, t_end, record, options)


def _of_trajectories(base: Varied, count: int, parameters: tuple[Parameter, ...]) -> Varied:
    """Return the start of each trajectory, if there are several. Raises ArgumentError."""
    own = base.batch_size
    if own not in (1, count):
        raise ArgumentError(
            f"data has {counted(count, 'trajectory', 'trajectories')} and the problem with its "
            f"start {own}; expected as many, or one for all"
        )
    if count == 1:
        return base
    twists = {k: np.broadcast_to(x, (count, 6)).copy() for k, x in base.twists.items()}
    if not any(p.name.endswith("pose0") for p in parameters):
        return base._replace(twists=twists)
    poses = {k: np.broadcast_to(x, (count, 4, 4)).copy() for k, x in base.poses.items()}
    return base._replace(poses=poses, twists=twists)


# ---- least squares -----------------------------------------------------------------------------


def _solved(variation: Variation, data: Measurements, runs: Runs, bounds: Any, most: int) -> Fit:
    """Minimise; begin again at the estimate where the path to it matters; report."""
    parameters = with_directions(variation.parameters, fixed_directions(variation))
    variation = Variation(variation.base, parameters, variation.t0)
    evaluations, task = 0, Task(variation, data, runs)
    if data.size < task.unknowns.size:
        samples = few_samples(data.size, task.unknowns.size)
        raise ArgumentError(f"data has {samples}; expected as many samples or more")
    response = np.maximum(data.responses(data.count)[0], task.chi2**0.5)
    task.unknowns.bound_sizes(task.slope, response)
    for _ in range(ROUNDS):
        before = task.unknowns
        x, solution, sides = _minimised(task, bounds, max(most - evaluations, 1))
        evaluations, refusal = evaluations + int(solution.nfev), task.refusal
        moved = Variation(task.varied(x), variation.parameters, variation.t0)
        nearer = Task(moved, data, runs, before.sizes)
        if not nearer.is_better_than(task):
            break
        task = nearer
        has_moved = np.any(np.abs(x - before.base) > MOVED * (np.abs(x) + before.scales))
        # Such a start depends on the steps towards it, not on the last numbers alone.
        has_a_path = variation.has_rows and variation.moves_poses
        begins_again = has_a_path or len(task.told.null)
        if not (begins_again and has_moved) or evaluations >= most:
            break
    return _report(task, solution, evaluations, sides, refusal)


def _minimised(task: Task, bounds: Any, most: int) -> tuple[Array, Any, Array]:
    """Return the coordinates of least residuals, the result of SciPy, and `_sides`.

    The variables of SciPy are zero at the base. Its first steps are then of length 1 at most.
    """
    from scipy.optimize import least_squares

    _ = task.at_base  # raises if the run of the guess fails
    x, scales = task.unknowns.base, FIRST_STEP * task.unknowns.scales
    low, high = ((end - x) / scales for end in bounds_of(task.unknowns, bounds))
    solution = least_squares(
        lambda u: task.residuals(x + scales * u),
        np.zeros_like(x),
        lambda u: task.jacobian(x + scales * u) * scales,
        (low, high), "trf", max_nfev=most, **TOLERANCES,
    )  # fmt: skip
    return x + scales * solution.x, solution, _sides(solution, low, high)


def _sides(solution: Any, low: Array, high: Array) -> Array:
    """Return −1 for variables at their lower bounds, 1 at their upper ones, 0 for the others.

    At a bound, a Gauss–Newton step of the variable alone would leave it.
    """
    x, curvatures = solution.x, np.sum(solution.jac**2, axis=0)
    step = -solution.grad / np.where(curvatures > 0.0, curvatures, 1.0)
    is_low = (x - low <= AT_BOUND) & (step <= low - x)
    is_high = (high - x <= AT_BOUND) & (step >= high - x)
    return np.asarray(is_high.astype(float) - is_low)


def _report(task: Task, solution: Any, evaluations: int, sides: Array, refusal: str) -> Fit:
    unknowns, varied, result, told = task.unknowns, task.variation.base, task.at_base, task.told
    differences, chi2, freedoms = task.differences(result), task.chi2, task.data.size - told.rank
    scale = 1.0 if task.data.has_sigma else chi2 / freedoms if freedoms else np.nan
    covariance, deviations = of_numbers(told, unknowns.spread, scale)
    covariance, labels = unknowns.as_given(covariance)
    residuals = {
        column.quantity.name: np.where(column.present, off, np.nan)
        for column, off in zip(task.data.columns, differences, strict=True)
    }
    at_bounds = {
        unknowns.labels[unknowns.follow.free[i]]: "upper" if sides[i] > 0.0 else "lower"
        for i in np.flatnonzero(sides)
    }
    model: Any = varied.model
    # Along directions that the data do not tell, the estimate may move on for ever.
    has_ended = solution.status > 0 or len(told.null) > 0
    is_minimum = has_ended and task.is_minimum(sides == 0.0)
    return Fit(
        estimate=unknowns.estimate, standard_errors=unknowns.by_parameter(deviations),
        covariance=covariance, labels=labels,
        unidentifiable=described_directions(
            unknowns, told, unknowns.spread, unknowns.all_values
        ),
        held=held_directions(unknowns.numbers, unknowns.follow.held),
        problem=model, start={**varied.start, "t0": task.variation.t0}, result=result,
        t=task.data.t, residuals=residuals,
        units={column.quantity.name: column.quantity.unit for column in task.data.columns},
        has_sigma=task.data.has_sigma,
        chi2=chi2, freedoms=freedoms,
        converged=is_minimum, status=_status(solution, is_minimum, refusal, at_bounds),
        evaluations=evaluations, _at_bounds=at_bounds,
    )  # fmt: skip


def _status(solution: Any, is_minimum: bool, refusal: str, at_bounds: Mapping[str, str]) -> str:
    reasons = {
        0: "max_evaluations is reached; raise it, or begin with a better guess",
        1: "the gradient is zero", 2: "the sum of squares decreases no more",
        3: "the estimate changes no more",
        4: "neither the sum of squares nor the estimate changes any more",
    }  # fmt: skip
    reason = reasons[int(solution.status)]
    if is_minimum and solution.status == 0:
        reason = "the sum of squares is at its minimum, along all directions that the data tell"
    elif solution.status > 0 and not is_minimum:
        nearby = f"no step decreases the sum of squares, for there is no run nearby: {refusal}"
        reason = nearby if refusal else REASONS[STUCK]
    bounded = [f"{label} is at its {side} bound" for label, side in at_bounds.items()]
    return "; ".join((reason, *bounded))


def described_directions(
    unknowns: Unknowns, told: Identified, spread: Array, values: Array
) -> tuple[Direction, ...]:
    """Describe the directions that data do not tell.

    spread, values : `Unknowns.spread` and `Unknowns.all_values` of one experiment.
    """
    labels, units = unknowns.labels, unknowns.units
    return tuple(described(spread @ change, labels, values, units) for change in told.null)
