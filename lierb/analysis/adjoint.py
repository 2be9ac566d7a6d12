"""`gradient` differentiates one number at the end of a run by all parameters, by its adjoint."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lierb.analysis.varied_runs import options_and_threads
from lierb.api import checked_model, integrate_model, report_start, start_check
from lierb.errors import ArgumentError, FailedTrajectoryWarning, unknown_name
from lierb.kernels.loops.gains import END_TIME
from lierb.kernels.systems.layout import Columns
from lierb.model.base import Model
from lierb.model.connections import NOWHERE
from lierb.model.mechanism.mechanism import Mechanism
from lierb.model.problem import Problem
from lierb.runs.adjoint import gains_of, plan_backwards
from lierb.runs.derivative_steps import (
    EXAMINED,
    is_examined,
    warn_of_long_steps,
    with_half_steps,
)
from lierb.runs.derivatives import fixed_names, obstacles, start_and_inputs, unfit_names
from lierb.runs.options import Options
from lierb.runs.parameters import Parameter, chosen_parameters, parameters_by_name, seeds_of
from lierb.runs.start_directions import Seeds, Start
from lierb.runs.start_gains import TreeStart
from lierb.runs.starts import Ready, ready
from lierb.runs.stiffness import warn_of_stiff_steps
from lierb.runs.switches import warn_of_switches
from lierb.support.arrays import Array
from lierb.support.progress import Progress, check_progress
from lierb.support.representations import Lines, Represented, counted

ENERGY = "energy"


@dataclass(frozen=True, repr=False, eq=False)
class Gradient(Represented):
    """Gradient of one number at the end of each trajectory.

    `gradient["body.mass"]` is an array (n, k), for the k numbers of a parameter; a failed
    trajectory has NaN.

    Attributes
    ----------
    of : str
        Name of the number.
    value : ndarray, shape (n,)
        The number at the end of each trajectory.
    parts : dict of ndarray, shape (n, k)
        Derivatives by the numbers of each parameter.
    units : dict of str
        Unit of each parameter.
    """

    of: str
    value: Array
    parts: dict[str, Array]
    units: dict[str, str]

    def __getitem__(self, name: str) -> Array:
        if name not in self.parts:
            raise unknown_name("parameter", name, self.parts)
        return self.parts[name]

    def _representation(self) -> tuple[str, Lines]:
        title = f"gradient of {self.of}, {counted(len(self.value), 'trajectory', 'trajectories')}"
        rows = [
            (name, f"{np.array2string(part[0], precision=6)} per {self.units[name]}")
            for name, part in self.parts.items()
        ]
        return title, rows


def gradient(
    problem: Problem | Mechanism,
    of: str,
    with_respect_to: str | Iterable[str] | None = None,
    *,
    twist0: ArrayLike | Mapping[str, ArrayLike] | None = None,
    pose0: Any = None,
    t_end: float,
    t0: float = 0.0,
    progress: Progress = None,
    **options: Any,
) -> Gradient:
    """Differentiate one number at the end of a run by its start and all numbers of the model.

    The cost is that of three to six runs, whatever the number of parameters. To differentiate by
    few parameters, or several quantities, use `with_respect_to` of `integrate`. Looped code with
    closed loops, motors of given speed or constraints has no adjoint; there a gradient takes two to
    three runs for each number of the parameters.

    Parameters
    ----------
    problem : Problem or Mechanism
        The body or mechanism; batched or shared.
    of : str
        Name of an observable of one number (`lierb.observable`), "energy", or "t", the time at
        which a terminal event ends the run. An integral over the run is the end value of an extra
        state (`lierb.states`) that an observable returns.
    with_respect_to : str or iterable of str, optional
        Parameters, as in `integrate`. Default: all, with the start as "twist0" and "pose0".
    twist0 : array_like, shape (6,) or (n, 6), or dict of them, optional
        Twist at t0, as in `integrate`.
    pose0 : array_like, Rotation or RigidTransform, (4, 4) or (n, 4, 4), or dict of them, optional
        Pose at t0, as in `integrate`.
    t_end : float
        End time, s.
    t0 : float, optional
        Start time, s.
    progress : bool or callable, optional
        As in `integrate`.
    **options : object
        Options of `integrate`, such as dt, rtol, method, cspace and threads. Default: rtol=1e-9.

    Returns
    -------
    Gradient
        Value and derivatives for each trajectory.

    Raises
    ------
    LierbError
        An argument is wrong, or a function runs body by body.
    MemoryLimitError
        Gradients are larger than the free memory.

    Warns
    -----
    FailedTrajectoryWarning
        Some trajectories have failed, and their gradients are NaN.
    DerivativeWarning
        A force or function switches by a comparison. Or, with adaptive steps, derivatives change
        by more than a tenth if the steps are halved.

    Notes
    -----
    The run is made once. Then its steps are differentiated backwards, each by the transposed
    Jacobian. Lengths of adaptive steps, times of controllers' ticks and noise are constant in the
    derivatives; the time of a terminal event is not. Directions of a start are projected onto the
    motions that the joints admit, as in `integrate`.

    References
    ----------
    Griewank and Walther, Evaluating Derivatives (2008); Cao, Li, Petzold and Serban, SIAM J. Sci.
    Comput. 24 (2003).

    Examples
    --------
    >>> import lierb
    >>> @lierb.observable
    ... def height(r):
    ...     return r[2]
    >>> ball = lierb.Problem(
    ...     lierb.bodies.sphere(0.1, mass=1.0), lierb.joints.free(), gravity=(0.0, 0.0, -9.81),
    ...     observables=height(),
    ... )
    >>> thrown = lierb.gradient(ball, "height", twist0=(0, 0, 0, 0, 0, 3), dt=0.01, t_end=0.5)
    >>> thrown["twist0"].round(9).tolist()[0][5], thrown["gravity"].round(9).tolist()[0][2]
    (0.5, 0.125)
    """
    model = checked_model(problem)
    model.require_unchanged()
    check_progress(progress)
    keywords, threads = options_and_threads(options)
    chosen = None if with_respect_to is None else chosen_parameters(model, with_respect_to)
    keywords |= {"t0": t0, "t_end": t_end, "statistics": False}
    prepared = ready(model, Options.of(model, **keywords), pose0, twist0)
    parameters = tuple(_all(prepared)) if chosen is None else chosen
    for obstacle in (*obstacles(prepared), *unfit_names(prepared, parameters)):
        raise ArgumentError(f"lierb.gradient: {obstacle}")
    if prepared.before is not None:
        raise ArgumentError(
            "lierb.gradient: the start is the end of another run, from which an adjoint does not "
            "go back; begin with a copy of its poses, pose0=pose0.copy()"
        )
    number = _number(model, of)
    plan = plan_backwards(prepared)
    if plan is None:
        return _along_directions(model, of, parameters, keywords, pose0, twist0, threads, progress)
    warn_of_switches(model, stacklevel=3)
    warn_of_stiff_steps(prepared, stacklevel=3)
    report_start(prepared, 3)
    start, inputs = start_and_inputs(prepared)
    prepared = prepared._replace(inputs=inputs)
    gains, ends = gains_of(
        prepared, plan, number, threads, progress, start_check(prepared, 6 + plan.has_lane_clocks)
    )
    if is_examined(prepared):
        steps = np.count_nonzero(np.diff(ends[:, : gains.shape[1]], axis=0) > 0.0, axis=0)
        lasted = (ends[-1] - ends[0])[: gains.shape[1]]
        halved = with_half_steps(prepared, lasted, steps.astype(float))
        halved = halved._replace(inputs=start_and_inputs(halved)[1])
        again, _ = gains_of(halved, plan, number, threads, False, None)
        pairs = (gains[:-1, :EXAMINED], again[:-1])
        warn_of_long_steps({of: pairs}, stacklevel=2)
    failed = int(np.isnan(gains[-1]).sum())
    if failed:
        has = "has" if failed == 1 else "have"
        warnings.warn(
            f"{counted(failed, 'trajectory', 'trajectories')} failed and {has} no gradient; "
            "lierb.integrate says why",
            FailedTrajectoryWarning,
            stacklevel=2,
        )
    tree = TreeStart(start) if plan.is_in_memory else None
    parts = _parts(parameters, start, tree, inputs.columns, gains)
    return Gradient(of, gains[-1], parts, {p.name: p.unit for p in parameters})


def _all(prepared: Ready) -> Iterator[Parameter]:
    """Yield all parameters that can change, each number by one name.

    omega0 is a part of twist0, and a joint's point on its parent has two names.
    """
    other_names = fixed_names(prepared)
    for at in prepared.model.joints:
        if at.name:
            other = "parent_point" if at.parent == NOWHERE else "ground_point"
            other_names.add(f"{at.name}.joint.{other}")
    for name, parameter in parameters_by_name(prepared.model).items():
        is_omega = parameter.is_start and name.endswith("omega0")
        if name not in other_names and not is_omega:
            yield parameter


def _number(model: Model, of: Any) -> int:
    """Return the number of an objective; see `lierb.kernels.loops.gains.Adjoint`."""
    names = [ENERGY, *(each.name for each in model.observables)]
    ends = ["t"] if any(event.terminal for event in model.events) else []
    if not (isinstance(of, str) and of in (*names, *ends)):
        raise unknown_name("of", of, [*names, *ends])
    return END_TIME if of == "t" else names.index(of)


def _along_directions(
    model: Model,
    of: str,
    parameters: tuple[Parameter, ...],
    keywords: dict[str, Any],
    pose0: Any,
    twist0: Any,
    threads: int | None,
    progress: Progress,
) -> Gradient:
    """Return the gradient from derivatives along all directions, for looped code with loops."""
    if of == ENERGY:
        if any(event.terminal for event in model.events):
            raise ArgumentError(
                "lierb.gradient: looped code saves the energy at t_end alone, and a terminal event "
                'may end the run before; take an observable, or solver="unrolled"'
            )
        keywords = keywords | {"save_at": [keywords["t_end"]], "record": ENERGY}
    result = integrate_model(
        model, Options.of(model, **keywords), pose0, twist0, with_respect_to=parameters,
        threads=threads, progress=progress, stacklevel=4, has_tables=False,
    )  # fmt: skip
    value = result[ENERGY][-1] if of == ENERGY else result["t" if of == "t" else f"{of}_final"]
    parts = {p.name: result.sensitivity(of, p.name).reshape(-1, p.size) for p in parameters}
    return Gradient(of, value, parts, {p.name: p.unit for p in parameters})


def _parts(
    parameters: tuple[Parameter, ...],
    start: Start,
    tree: TreeStart | None,
    columns: Columns,
    gains: Array,
) -> dict[str, Array]:
    """Return the derivatives by the numbers of each parameter, (n, k).

    tree : the start, if it may be that of a tree.
    """
    moving = [p for p in parameters if tree and tree.moves(p)]
    by_field = {f.name: gains[at] for f, at in columns}
    with np.errstate(all="ignore"):  # of starts that violate their joints
        seeds = seeds_of([p for p in parameters if p not in moving], start)
        parts = {name: _part(own, by_field) for name, own in seeds.items()}
        through: dict[str, Array] = {}
        if tree and any(p.is_start for p in moving):
            through = tree.gains_of_start(by_field)
        if tree and not all(p.is_start for p in moving):
            of_frames = tree.gains_of_frames(by_field)
            through |= {name: by_field[name] + own for name, own in of_frames.items()}
        parts |= {p.name: _part(p.seeds(start), through) for p in moving}
    return {p.name: parts[p.name] for p in parameters}


def _part(seeds: Seeds, gains: Mapping[str, Array]) -> Array:
    """Return the derivatives by the numbers of a parameter, (n, k)."""
    (size, *_), *_ = (array.shape for array in seeds.values())
    total = np.zeros((len(next(iter(gains.values()))[0]), size))
    for field, array in seeds.items():  # [direction][trajectory or 1][number]
        for of_number, gain in zip(np.moveaxis(array, -1, 0), gains[field], strict=True):
            total += of_number.T * gain[:, None]  # in one order, whatever the batch
    return total
