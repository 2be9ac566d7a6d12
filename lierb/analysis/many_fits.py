"""`fits` estimates parameters of many experiments side by side, each with unknowns of its own."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lierb.analysis.experiments import flat_start, measured_experiments, of_experiments
from lierb.analysis.fitting import chosen_and_guesses, described_directions, fit_runs, require_whole
from lierb.analysis.followed import held_directions
from lierb.analysis.guesses import guessed
from lierb.analysis.identifiability import (
    Direction,
    decomposed,
    few_samples,
    identified,
    of_numbers,
)
from lierb.analysis.many_fits_result import Fits
from lierb.analysis.minimising import Minimisation
from lierb.analysis.side_by_side import Experiments, State
from lierb.analysis.unknowns import Unknowns
from lierb.api import checked_model
from lierb.errors import ArgumentError, FailedFitWarning
from lierb.model.mechanism.mechanism import Mechanism
from lierb.model.problem import Problem
from lierb.runs.switches import warn_of_switches
from lierb.runs.variations import Variation, with_start
from lierb.support.collected_warnings import warnings_collected
from lierb.support.memory import require_memory
from lierb.support.progress import Progress, check_progress, reporter
from lierb.support.representations import counted

ROOM = 1 << 28  # bytes of the runs at a time; twice as much is no faster


def fits(
    problem: Problem | Mechanism,
    data: Any,
    parameters: str | Iterable[str] | Mapping[str, ArrayLike | None],
    *,
    sigma: Mapping[str, ArrayLike] | None = None,
    twist0: ArrayLike | Mapping[str, ArrayLike] | None = None,
    pose0: Any = None,
    t0: float = 0.0,
    t_end: float | None = None,
    max_iterations: int = 100,
    progress: Progress = None,
    **options: Any,
) -> Fits:
    """Estimate parameters of many experiments side by side, each with unknowns of its own.

    It is `lierb.fit` for each of n experiments, which are integrated in one batch: a Monte Carlo
    study of an identification, or the same measurement of many bodies.

    Parameters
    ----------
    problem : Problem or Mechanism
        The model; its numbers are the guess, one for all experiments or one for each.
    data : mapping, pyarrow.Table, pandas.DataFrame, or list
        Columns by name as for `fit`: "t", (times,), and measured columns, (times, n, …) for n
        experiments of one trajectory, or (times, n, m, …) for n experiments of m trajectories. A
        list has the data of `fit` for each experiment. A missing sample is NaN.
    parameters : str, iterable of str, or mapping
        Parameters by the names of `with_respect_to` in `integrate`, or a dictionary with a guess
        of each, (k,), or (n, k) by experiment, or None for the problem's numbers. "omega0",
        "twist0" and "pose0" are estimated for each trajectory.
    sigma : mapping, optional
        Standard deviations of the noise by column: a number, or one for each component. Default:
        all weights are 1, and each covariance is scaled by the variance of its residuals.
    twist0 : array_like, shape (6,), (n, 6), (m, 6) or (n, m, 6), or dict of them, optional
        Twist at t0, or its guess: for all, by experiment of one trajectory, or by trajectory.
    pose0 : array_like or RigidTransform, shape (4, 4) or (…, 4, 4), or dict of them, optional
        Pose at t0, or its guess, likewise.
    t0 : float, optional
        Start time, s.
    t_end : float, optional
        End time of the runs, s. Default: the last time of the data.
    max_iterations : int, optional
        Largest number of runs of an experiment after that of the guess.
    progress : bool or callable, optional
        As in `integrate`; the unit is fits.
    **options : object
        Options of `integrate`: dt, rtol, atol, method, cspace, solver, stabilise, threads and the
        like. Default: rtol=1e-9.

    Returns
    -------
    Fits
        Estimates, standard errors and covariances, which fits have converged, and unidentifiable
        directions.

    Raises
    ------
    LierbError
        An argument is wrong. The subclasses classify the error.

    Warns
    -----
    FailedFitWarning
        Some fits have not converged or have fewer samples than unknowns, or the run of their guess
        has failed. The other fits are unaffected.

    Notes
    -----
    The method is that of Levenberg and Marquardt. Each iteration runs all experiments that have not
    ended in one batch, with exact derivatives. Step and convergence are decided for each experiment
    separately: an estimate converges when the next step is less than a millionth of a standard
    error. Experiments run in groups that need 0.3 GB of memory; when one ends, another takes its
    place. There are no bounds. The notes of `fit` hold here too.

    Examples
    --------
    >>> import lierb, numpy as np
    >>> hinge = lierb.joints.revolute(axis=(0.0, 1.0, 0.0), body_point=(0.0, 0.0, 0.15))
    >>> rod = lierb.bodies.rod(0.3, 0.01, mass=0.2)
    >>> def pendulum(damping):
    ...     friction = lierb.forces.torsional_spring(damping=damping)
    ...     return lierb.Problem(rod, hinge, (0.0, 0.0, -9.81), friction)
    >>> run = {"twist0": hinge.twist(omega=(0.0, 3.0, 0.0)), "dt": 1e-2}
    >>> truth = lierb.integrate(pendulum(2e-3), **run, t_end=2.0, save_every=10, record="state")
    >>> noise = np.random.default_rng(0).normal(scale=0.05, size=(21, 300, 3))
    >>> data = {"t": truth.t, "omega": truth.omega + noise}
    >>> many = lierb.fits(
    ...     pendulum(1e-3), data, "torsional_spring.damping", sigma={"omega": 0.05}, **run
    ... )
    >>> many.estimate["torsional_spring.damping"].shape, bool(many.converged.all())
    ((300, 1), True)
    >>> bool(abs(many.ratio["torsional_spring.damping"][0] - 1.0) < 0.15)
    True
    """
    model = checked_model(problem)
    check_progress(progress)
    given, count = measured_experiments(model, data, sigma)
    chosen, guesses = chosen_and_guesses(model, given, parameters)
    require_whole("max_iterations", max_iterations)
    start = with_start(model, flat_start(pose0, 2), flat_start(twist0, 1))
    base = of_experiments(start, given.count // count, count)
    runs = fit_runs(given, t0, t_end, options)
    warn_of_switches(model, stacklevel=3)
    variation = Variation(base, chosen, runs.options(model).timing.t0)
    with warnings_collected(), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        variation = guessed(variation, guesses, given.count // count, count)
        experiments = Experiments(variation, given, count, runs)
        many = _solved(experiments, int(max_iterations), progress)
    _warn(many)
    return many


def _solved(experiments: Experiments, max_iterations: int, progress: Progress) -> Fits:
    if not np.any(experiments.residuals >= experiments.size):
        samples = few_samples(experiments.residuals.max(), experiments.size)
        raise ArgumentError(
            f"no experiment has enough data, at most {samples}; expected as many samples or more"
        )
    each = experiments.bytes_each
    most = max(ROOM // each, 1)
    size = experiments.bytes_of_state + each * min(most, experiments.total)
    require_memory(
        size, "a run of the fits", "fit fewer experiments at a time, or with fewer samples"
    )
    minimisation = Minimisation(experiments, max_iterations)
    with reporter(progress, experiments.total, "fits") as report:
        minimisation.run(most, report)
    return _report(experiments, minimisation)


def _report(experiments: Experiments, ends: Minimisation) -> Fits:
    state, everyone = ends.state, np.arange(experiments.total)
    has_run = np.isfinite(state["chi2"])
    chi2 = np.where(has_run, state["chi2"], np.nan)
    varied = experiments.varied(everyone, state)
    variation = experiments.varying(everyone, varied)
    unknowns = experiments.unknowns(everyone, variation, state["bases"])
    told = decomposed(state["factor"][..., :-1], state["sizes"])
    freedoms = experiments.residuals - told.rank
    scale = np.where(has_run, 1.0, np.nan)
    if not experiments.data.has_sigma:
        scale = np.where(freedoms > 0, chi2 / np.maximum(freedoms, 1), np.nan)
    covariance, deviations = of_numbers(told, unknowns.spread, scale)
    covariance, labels = unknowns.as_given(covariance)
    deviations[~has_run] = np.nan
    estimate = unknowns.estimate
    for array in estimate.values():
        array[~has_run] = np.nan
    not_told = np.where(has_run, experiments.size - told.rank, 0)
    model: Any = varied.model
    return Fits(
        estimate=estimate, standard_errors=unknowns.by_parameter(deviations),
        covariance=covariance, labels=labels, has_sigma=experiments.data.has_sigma,
        chi2=chi2, freedoms=freedoms, converged=ends.converged, status=ends.reasons,
        iterations=ends.iterations, not_told=not_told,
        unidentifiable=_directions(unknowns, state, not_told),
        held=held_directions(unknowns.numbers, unknowns.follow.held[0]),
        problem=model,
        start={**varied.start, "t0": variation.t0},
        units={p.name: p.unit for p in experiments.parameters},
    )  # fmt: skip


def _directions(
    unknowns: Unknowns, state: State, not_told: NDArray[np.int64]
) -> tuple[Direction, ...]:
    """Describe the directions that the data of the first such experiment do not tell."""
    if not not_told.any():
        return ()
    i = int(np.flatnonzero(not_told)[0])
    told = identified(state["factor"][i, :, :-1], state["sizes"][i])
    return described_directions(unknowns, told, unknowns.spread[i], unknowns.all_values[i])


def _warn(many: Fits) -> None:
    bad = np.flatnonzero(~many.converged)
    if bad.size:
        warnings.warn(
            f"{bad.size} of {counted(len(many.converged), 'fit')} "
            f"{'has' if bad.size == 1 else 'have'} not converged; the first is fit {bad[0]}: "
            f"{many.status[bad[0]]}; `converged` of the result lists them",
            FailedFitWarning, stacklevel=3,
        )  # fmt: skip
