"""`propagate` carries a covariance of start and parameters to later times, linearly and by runs."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import ArrayLike, NDArray

from lierb.analysis.followed import followed, held_directions
from lierb.analysis.propagation_result import Propagation, deviations_of
from lierb.analysis.quantities import Quantity, quantity_named, records_of, require_derivatives
from lierb.analysis.varied_runs import Runs, runs_of
from lierb.api import checked_model
from lierb.errors import ArgumentError, FailedTrajectoryWarning, LierbError, brief, items_of
from lierb.model.mechanism.mechanism import Mechanism
from lierb.model.problem import Problem
from lierb.results.failures import Failures, has_failed
from lierb.results.result import Result
from lierb.runs.parameters import Parameter, separate_parameters, slices_of
from lierb.runs.switches import warn_of_switches
from lierb.runs.variations import Variation, with_start
from lierb.support.arrays import Array, as_floats, is_whole
from lierb.support.collected_warnings import warnings_collected

TOLERANCE = 0.1  # relative difference of standard deviations, with which linear theory holds
ERRORS = 3.0  # standard errors of the sample that may come on top
SYMMETRY = 1e-10  # relative to the standard deviations of both numbers
MEANS = 20  # iterations of a mean on a group, at most
LEAST_RUNS = 10
ROUNDING = 1e-12  # smaller standard deviations, relative to the largest in time, count as zero
VALUE_ROUNDING = 1e-13  # the same, relative to the largest value of the quantity


def propagate(
    problem: Problem | Mechanism,
    covariance: ArrayLike | Mapping[str, ArrayLike],
    parameters: str | Iterable[str],
    times: ArrayLike,
    of: str | Iterable[str] | None = None,
    *,
    twist0: ArrayLike | Mapping[str, ArrayLike] | None = None,
    pose0: Any = None,
    t0: float = 0.0,
    t_end: float | None = None,
    monte_carlo: int = 400,
    seed: int = 0,
    **options: Any,
) -> Propagation:
    """Propagate a covariance of start and parameters, by linear theory and a Monte Carlo sample.

    Parameters
    ----------
    problem : Problem or Mechanism
        The model, not a batch. Its numbers are the mean of the Gaussian.
    covariance : array_like, shape (p, p), or mapping
        Covariance of all numbers of the parameters, in order, such as that of a `Fit`; or a
        dictionary by parameter with a covariance (k, k), or standard deviations, (k,) or a number.
    parameters : str or iterable of str
        Parameters by the names of `with_respect_to` in `integrate`.
    times : array_like, shape (times,)
        Times, s, ascending.
    of : str or iterable of str, optional
        Quantities: "pose", "rotation", "position", "twist", "omega", "v", "coordinates",
        "energy", names of observables and states, "lambda" and "reaction"; for a mechanism
        "rod.pose". Default: pose and twist of every link.
    twist0 : array_like, shape (6,), or dict of them, optional
        Twist at t0, as in `integrate`.
    pose0 : array_like, Rotation or RigidTransform, shape (4, 4), or dict of them, optional
        Pose at t0, as in `integrate`.
    t0 : float, optional
        Start time, s.
    t_end : float, optional
        End time of the runs, s. Default: the last of the times.
    monte_carlo : int, optional
        Number of runs in the sample, at least 10.
    seed : int, optional
        Seed of the sample. The noise of controllers is that of the nominal run in all members.
    **options : object
        Options of `integrate`, such as dt, rtol, method, cspace and threads. Default: rtol=1e-9.

    Returns
    -------
    Propagation
        Covariances by linear theory and of the sample, their ratios, and the times at which linear
        theory holds.

    Raises
    ------
    LierbError
        An argument is wrong, a member of the sample is no rigid body, or the nominal run fails.

    Warns
    -----
    FailedTrajectoryWarning
        Some runs of the sample have failed.

    Notes
    -----
    Linear theory, J Σ Jᵀ with the exact derivatives J of the run, holds while the motion is linear
    in the deviations. The sample is drawn from the same Gaussian and integrated as one batch; its
    standard deviations have a standard error of 3.5 % for 400 runs. Changes of a start are
    projected onto the motions that the joints admit, as in `integrate`.

    Examples
    --------
    >>> import lierb
    >>> flight = lierb.Problem(lierb.bodies.sphere(0.1, mass=1.0), lierb.joints.free())
    >>> start = {"twist0": (0.0, 0.0, 0.0, 2.0, 0.0, 0.0), "dt": 0.1}
    >>> deviations = {"twist0": (0.0, 0.0, 0.0, 0.1, 0.1, 0.1)}
    >>> spread = lierb.propagate(flight, deviations, "twist0", [0.5, 1.0], "position", **start)
    >>> spread.standard_deviations("position").round(9).tolist()
    [[0.05, 0.05, 0.05], [0.1, 0.1, 0.1]]
    >>> spread.holds["position"].tolist()
    [True, True]
    """
    model = checked_model(problem)
    chosen = separate_parameters(model, parameters)
    if not chosen:
        raise ArgumentError("parameters is empty; expected names, such as omega0 or body.mass")
    quantities = _quantities(model, of)
    for quantity in quantities:
        require_derivatives(quantity, chosen)
    if not (is_whole(monte_carlo) and monte_carlo >= LEAST_RUNS):
        raise ArgumentError(
            f"monte_carlo={brief(monte_carlo)}; expected a whole number, {LEAST_RUNS} or more: "
            "linear theory is not shown without a sample"
        )
    t = np.atleast_1d(as_floats("times", times))
    if t.ndim != 1 or not t.size or not np.isfinite(t).all() or np.any(np.diff(t) <= 0.0):
        raise ArgumentError(f"times={brief(times)}; expected finite times in s, ascending")
    sigma = _covariance(covariance, chosen)
    base = with_start(model, pose0, twist0)
    if base.batch_size != 1:
        raise ArgumentError(
            "the problem with its start has several trajectories; expected one, "
            "such as problem.of_body(0)"
        )
    runs = runs_of("times", t, t0, t_end, records_of(quantities), options)
    warn_of_switches(model, stacklevel=3)
    variation = Variation(base, chosen, runs.options(model).timing.t0)
    _require_followed(variation, sigma)
    runs.warn_of_long_steps(base, chosen)
    with warnings_collected(), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = _propagated(variation, runs, quantities, sigma, t, int(monte_carlo), seed)
    if found.failed:
        warnings.warn(
            f"{found.failed} of {found.size + found.failed} runs of the sample failed, or ended "
            "by an event before the last time; its deviations are those of the others",
            FailedTrajectoryWarning,
            stacklevel=2,
        )
    return found


def _propagated(
    variation: Variation, runs: Runs, quantities: list[Quantity], sigma: Array, t: Array,
    count: int, seed: int,
) -> Propagation:  # fmt: skip
    nominal = runs.result(variation.base, [p.name for p in variation.parameters])
    if failures := Failures.of(nominal.summary):
        raise ArgumentError(f"the nominal run fails, {failures}")
    if not _lasts(nominal, t[-1])[0]:
        (ended,) = nominal.summary["t"].to_pylist()
        raise ArgumentError(
            f"an event ends the nominal run at t = {ended:g} s; give earlier times, or an event "
            "that is not terminal"
        )
    members = _sample(variation, runs, sigma, count, seed)
    whole = ~has_failed(members.summary) & _lasts(members, t[-1])
    size = int(whole.sum())
    linear, sample, shift, ratio, holds = ({} for _ in range(5))
    for each in quantities:
        name = each.name
        jacobian = np.concatenate(
            [each.derivative(nominal, p)[:, 0] for p in variation.parameters], axis=-1
        )
        linear[name] = jacobian @ sigma @ jacobian.swapaxes(-1, -2)
        values = each.values(members)[:, whole]
        at_nominal = each.values(nominal)[:, 0]
        shift[name], sample[name] = _moments(each, at_nominal, values)
        least = VALUE_ROUNDING * float(np.abs(at_nominal).max(initial=0.0))
        ratio[name], holds[name] = _compared(linear[name], sample[name], shift[name], size, least)
    units = {each.name: each.unit for each in quantities}
    return Propagation(t, linear, sample, shift, ratio, holds, units, size, count - size)


def _lasts(result: Result, last: float) -> NDArray[np.bool_]:
    """Return False for the trajectories that an event has ended before the time `last`, s."""
    is_event = pc.equal(result.summary["status"].cast(pa.string()), "event")
    return np.asarray(~(is_event.to_numpy() & (result.summary["t"].to_numpy() < last)))


def _quantities(model: Any, of: Any) -> list[Quantity]:
    if of is None:
        prefixes = [f"{link}." if link else "" for link in model.link_names]
        names = [f"{prefix}{what}" for prefix in prefixes for what in ("pose", "twist")]
    else:
        names = [of] if isinstance(of, str) else [*items_of("of", of, "names of quantities")]
    if not names:
        raise ArgumentError("of is empty; expected names of quantities, such as pose or twist")
    named = {q.name: q for q in (quantity_named(model, "of", name) for name in names)}
    return [*named.values()]


def _covariance(given: Any, parameters: tuple[Parameter, ...]) -> Array:
    """Return the covariance of all numbers. Raises ArgumentError."""
    size = sum(p.size for p in parameters)
    if not isinstance(given, Mapping):
        return _checked("covariance", given, size)
    names = [p.name for p in parameters]
    if set(given) != set(names):
        raise ArgumentError(
            f"covariance has {', '.join(map(str, given))}; expected an entry for each of "
            f"{', '.join(names)}"
        )
    sigma, slices = np.zeros((size, size)), slices_of(parameters)
    for p in parameters:
        label = f"covariance[{p.name!r}]"
        own = as_floats(label, given[p.name])
        if own.shape in ((), (p.size,)):
            if not np.all(own >= 0.0):
                raise ArgumentError(f"{label}={brief(own)}; expected deviations, 0 or more")
            own = np.diag(np.broadcast_to(own, p.size) ** 2)
        part = slices[p.name]
        sigma[part, part] = _checked(label, own, p.size)
    return sigma


def _require_followed(variation: Variation, sigma: Array) -> None:
    """Raise ArgumentError for a variance along a direction that loops do not follow."""
    numbers = [p for p in variation.parameters if not p.is_start]
    slices = slices_of(variation.parameters)
    places = np.array([i for p in numbers for i in range(len(sigma))[slices[p.name]]], dtype=int)
    own, held = sigma[np.ix_(places, places)], followed(variation, 1).held
    for row, direction in zip(held, held_directions(numbers, held), strict=True):
        if row @ own @ row > ROUNDING * np.max(np.diag(own) * row**2):
            raise ArgumentError(
                f"covariance: {direction}; expected no variance along this direction, in which "
                "they do not close"
            )


def _checked(label: str, given: Any, size: int) -> Array:
    sigma = as_floats(label, given)
    if sigma.shape != (size, size):
        raise ArgumentError(
            f"{label} has shape {sigma.shape}; expected ({size}, {size}), in the order of the "
            "parameters and their numbers"
        )
    if not np.isfinite(sigma).all():
        raise ArgumentError(f"{label} has numbers that are not finite; expected finite ones")
    units = _units(sigma)
    unit = sigma / np.outer(units, units)
    if np.abs(unit - unit.T).max() > SYMMETRY or np.linalg.eigvalsh(unit).min() < -size * SYMMETRY:
        raise ArgumentError(f"{label} is not symmetric with eigenvalues of 0 or more")
    return np.asarray(0.5 * (sigma + sigma.T))


def _units(sigma: Array) -> Array:
    """Return the standard deviation of each number, 1 for a number without any."""
    scale = np.sqrt(np.abs(np.diag(sigma)))
    return np.where(scale > 0.0, scale, 1.0)


def _sample(variation: Variation, runs: Runs, sigma: Array, count: int, seed: int) -> Result:
    """Integrate a sample of the Gaussian as one batch, with the noise of the nominal run."""
    units = _units(sigma)
    values, vectors = np.linalg.eigh(sigma / np.outer(units, units))
    half = units[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
    draws = np.random.default_rng(seed).standard_normal((count, len(sigma))) @ half.T
    slices = slices_of(variation.parameters)
    changes = {name: draws[:, part] for name, part in slices.items()}
    try:
        varied = variation.at(changes)
    except LierbError as error:
        raise type(error)(f"a member of the sample cannot be made: {error}") from None
    (number,) = np.atleast_1d(runs.keywords.get("trajectories") or 0)
    own = runs.keywords | {"trajectories": np.full(count, number)}
    return runs._replace(keywords=own).result(varied)


def _moments(quantity: Quantity, nominal: Array, values: Array) -> tuple[Array, Array]:
    """Return the shift of the mean, (times, w), and the covariance about it, (times, w, w).

    nominal : (times, …).   values : (times, n, …).
    """
    mean = nominal[:, None]
    for _ in range(MEANS):
        step = np.mean(quantity.difference(mean, values), axis=1)
        mean = quantity.moved(mean, step[:, None])
        if not np.any(np.abs(step) > 1e-14):
            break
    off = quantity.difference(mean, values)
    covariance = np.einsum("tni,tnj->tij", off, off) / (values.shape[1] - 1)
    return quantity.difference(nominal, mean[:, 0]), covariance


def _compared(
    linear: Array, sample: Array, shift: Array, size: int, least: float
) -> tuple[Array, Any]:
    """Return the ratios of standard deviations, and where linear theory holds.

    least : largest standard deviation that is rounding of the values.
    """
    expected, got = deviations_of(linear), deviations_of(sample)
    least = max(least, ROUNDING * expected.max())
    is_zero = (expected <= least) & (got <= least)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.where(is_zero, np.nan, got / expected)
        shifts = np.where(is_zero, 0.0, np.abs(shift) / np.maximum(expected, got))
    differs = np.abs(np.where(is_zero, 1.0, ratio) - 1.0)
    fits = differs < TOLERANCE + ERRORS / np.sqrt(2.0 * size)
    fits &= shifts < TOLERANCE + ERRORS / np.sqrt(size)
    return ratio, np.all(fits, axis=-1)
