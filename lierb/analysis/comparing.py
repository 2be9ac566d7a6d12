"""`convergence` compares methods on c-spaces, over steps or tolerances."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lierb.analysis.case import Case
from lierb.analysis.compared_runs import Run, compared, quantities_of
from lierb.analysis.comparison import Comparison, comparison
from lierb.analysis.reference import (
    ERRORS,
    MARGIN,
    NORMS,
    Reference,
    found_reference,
    given_reference,
    sizes_of,
    warn_of_runs,
)
from lierb.api import checked_model
from lierb.errors import ArgumentError, TimeGridError, brief, items_of, require_name
from lierb.errors.synonyms import ARGUMENTS
from lierb.kernels.systems.plan import Stabilisation
from lierb.methods import METHODS, Method, method_named
from lierb.model.base import Model
from lierb.model.formulation import CSpace, described_cspace
from lierb.model.mechanism.mechanism import Mechanism
from lierb.model.problem import Problem
from lierb.runs.options import Options
from lierb.runs.provenance import machine
from lierb.runs.time_options import checked_time
from lierb.support.arrays import as_positive, is_whole
from lierb.support.collected_warnings import warnings_collected
from lierb.support.keywords import explains_keywords
from lierb.support.progress import check_progress, reporter
from lierb.support.representations import counted, rounded

Progress = bool | Callable[[int, int, str], object] | None

SHARE = 1000  # progress units in a run
MOST_RUNS = 1000
COUNTED = (
    "Right-hand sides are counted as stages × (steps + rejected), the mean over trajectories; a "
    "last stage that is the next step's first is not counted."
)


@explains_keywords(ARGUMENTS)
def convergence(
    problem: Problem | Mechanism,
    methods: str | Method | Iterable[str | Method] = ("RK4",),
    dts: ArrayLike | None = None,
    *,
    twist0: ArrayLike | Mapping[str, ArrayLike] | None = None,
    t_end: float,
    pose0: Any = None,
    t0: float = 0.0,
    rtols: ArrayLike | None = None,
    atol: float | Mapping[str, float] | None = None,
    cspaces: CSpace | Iterable[CSpace] | None = None,
    update: str = "local",
    solver: str = "auto",
    stabilise: str | Stabilisation | None = None,
    measure_every: int = 1,
    discontinuities: ArrayLike | None = None,
    seed: int = 0,
    reference: Any = None,
    norm: str = "largest",
    repeats: int = 3,
    name: str = "comparison",
    progress: Progress = None,
) -> Comparison:
    """Compare methods, c-spaces and steps: orders, errors over work, drifts.

    Parameters
    ----------
    problem : Problem or Mechanism
        As in `integrate`. A batch is integrated as a whole; each trajectory has the same noise in
        every run.
    methods : str, Method or iterable of them, optional
        Methods, or names of them.
    dts : array_like, shape (m,), optional
        Fixed steps, s; a whole number of each must fit between t0 and t_end. At least one of `dts`
        and `rtols` is required.
    twist0 : array_like, shape (6,) or (n, 6), or dict of them, optional
        Body-fixed twist at t0, as in `integrate`. Default: at rest.
    t_end : float
        End time, s.
    pose0 : array_like, Rotation or RigidTransform, (4, 4) or (n, 4, 4), or dict of them, optional
        Pose at t0, as in `integrate`.
    t0 : float, optional
        Start time, s.
    rtols : array_like, shape (m,), optional
        Relative tolerances of adaptive steps, for the methods with an embedded pair.
    atol : float or dict, optional
        Absolute tolerance that goes with `rtols`, as in `integrate`.
    cspaces : str or iterable of str, optional
        Configuration spaces, as in `integrate`. Default: the default of `integrate`.
    update : {"local", "global", "ambient"}, optional
        As in `integrate`.
    solver : {"auto", "saddle", "subgroup", "looped", "unrolled"}, optional
        As in `integrate`.
    stabilise : "project" or Stabilisation, optional
        As in `integrate`.
    measure_every : int, optional
        Number of steps between samples of the drifts.
    discontinuities : array_like, shape (k,), optional
        Times at which functions of time jump, s, as in `integrate`.
    seed : int, optional
        Seed of `lierb.noise`.
    reference : Result, dict or pair of poses and twists, optional
        Exact state at t_end: the `lierb.Result` of another run, its `end`, or a pair in the form of
        pose0 and twist0. Default: the same problem by DOP853, on "reduced" if the joint has it; the
        step is halved until the error no longer decreases. The error of this reference is estimated
        from the preceding step and from another c-space. An error of a run counts only if it is ten
        times the reference's error and larger than the rounding of its number of steps.
    norm : {"largest", "median"}, optional
        Norm of an error over the trajectories of a batch.
    repeats : int, optional
        Number of timed repetitions of each run, after a first run that compiles. The least CPU time
        counts, on one thread. 0 measures no times.
    name : str, optional
        Title of the figure.
    progress : bool or callable, optional
        True, False or None as in `integrate`, or a function of (number of finished runs, number of
        all runs, name of the next run).

    Returns
    -------
    Comparison
        A table of the runs, and the observed orders.

    Raises
    ------
    LierbError
        An argument is wrong. The subclasses classify the error.

    Warns
    -----
    FailedTrajectoryWarning
        Some trajectories have failed in a run. They are left out of the run's errors and counted in
        `failed`.

    Examples
    --------
    >>> import lierb
    >>> body = lierb.Body(mass=6.075, inertia=(0.0126563, 0.0468281, 0.0569531))
    >>> top = lierb.Problem(body, lierb.joints.spherical(body_point=(-0.15, 0.0375, 0.0)))
    >>> start = {"twist0": top.joint.twist(omega=(6.28, 3.14, 0.63)), "t_end": 0.5}
    >>> fine = lierb.integrate(top, dt=5e-4, **start)
    >>> found = lierb.convergence(top, "RK4", [2e-2, 1e-2, 5e-3], reference=fine, **start)
    >>> round(found.order("RK4"))
    4
    >>> found.table.num_rows
    3
    """
    model = checked_model(problem)
    several = _methods(methods)
    spaces = _cspaces(model, cspaces)
    steps, tolerances = _several("dts", dts), _several("rtols", rtols)
    _check(atol, tolerances, norm, repeats, name, progress)
    common = {
        "update": update, "solver": solver, "stabilise": stabilise, "seed": seed,
        "measure_every": measure_every, "discontinuities": discontinuities,
    }  # fmt: skip
    case = Case(model, pose0, twist0, t0, t_end, common, norm, repeats)
    runs = [
        replace(run, options=_options(case, run, atol))
        for run in _runs(several, spaces, steps, tolerances)
    ]
    given = None if reference is None else given_reference(reference, model, float(t_end))
    with warnings_collected(), _telling(progress, len(runs) + (given is None)) as tell:
        exact = found_reference(case, steps, partial(tell, 0.0)) if given is None else given
        sizes = sizes_of(model, exact.ends, twist0)
        before = given is None
        rows, failures = compared(
            case, runs, exact, sizes, lambda done, what, part: tell(before + done + part, what)
        )
        one_step = case.options(dt=case.length, method=several[0], cspace=spaces[0])
        overhead = case.timed(one_step) if steps else math.inf
    warn_of_runs(failures)
    measure_every = min(int(measure_every), 2**53)  # no run has more steps
    notes = _notes(case, exact, overhead, rows[0]["trajectories"], measure_every)
    metadata = {
        **machine(), "units": "SI: m, s, rad, J", "norm": norm, "reference": exact.what,
        "reference_errors": exact.errors, "t0": float(t0), "t_end": float(t_end),
        "repeats": int(repeats), "measure_every": measure_every, "update": update,
    }  # fmt: skip
    seen = {quantity: sizes[quantity] for quantity in quantities_of(model)}
    return comparison(rows, several, seen, name, notes, metadata)


# ---- arguments ---------------------------------------------------------------------------------


def _methods(given: Any) -> list[Method]:
    is_one = isinstance(given, (str, Method))
    several = (given,) if is_one else items_of("methods", given, "methods, or their names")
    methods = [method_named(method) for method in several]
    if not methods:
        raise ArgumentError(f"methods is empty; expected some of {', '.join(METHODS)}")
    _require_different("methods", [method.name for method in methods])
    return methods


def _cspaces(model: Model, given: Any) -> list[CSpace]:
    default = model.default_cspace
    if given is None:
        return [default]
    is_one = isinstance(given, (str, Mapping))
    cspaces = [given] if is_one else list(items_of("cspaces", given, "names of c-spaces"))
    if not cspaces:
        raise ArgumentError(f'cspaces is empty; leave it out for "{default}"')
    for each in cspaces:
        if not isinstance(each, (str, Mapping)):
            raise ArgumentError(f"cspaces has {brief(each)}; expected names of c-spaces")
    _require_different("cspaces", [described_cspace(each) for each in cspaces])
    return cspaces


def _several(argument: str, given: Any) -> list[float]:
    """Return positive numbers, the largest first; none for None."""
    if given is None:
        return []
    unit = "s" if argument == "dts" else "of the size of what is integrated"
    numbers = np.atleast_1d(as_positive(argument, given, unit)).tolist()
    _require_different(argument, numbers)
    return sorted(numbers, reverse=True)


def _require_different(argument: str, given: Sequence[Any]) -> None:
    for n, each in enumerate(given):
        if each in given[:n]:
            raise ArgumentError(f"{argument}: {each!r} is given twice; expected different ones")


def _runs(
    methods: list[Method], cspaces: list[CSpace], dts: list[float], rtols: list[float]
) -> list[Run]:
    """Return the runs: all methods and c-spaces at all steps; adaptive methods at all rtols."""
    if not (dts or rtols):
        raise ArgumentError("neither dts nor rtols is given; give fixed steps, s, or tolerances")
    if rtols and not dts:
        for method in methods:
            if method.error is None:
                pairs = ", ".join(name for name, each in METHODS.items() if each.error is not None)
                raise ArgumentError(
                    f"{method.name} has no embedded pair, which rtols needs; give dts= as well, "
                    f"or take {pairs}"
                )
    adaptive = [method for method in methods if method.error is not None]
    runs = [Run(*each, None) for each in product(methods, cspaces, dts)]
    runs += [Run(m, space, None, rtol) for m, space, rtol in product(adaptive, cspaces, rtols)]
    if len(runs) > MOST_RUNS:
        raise ArgumentError(f"these are {len(runs)} runs; expected {MOST_RUNS} at most")
    return runs


def _check(
    atol: Any, rtols: list[float], norm: str, repeats: Any, name: Any, progress: Progress
) -> None:
    if atol is not None and not rtols:
        raise ArgumentError("atol goes with rtols=, the tolerances of adaptive steps; give both")
    require_name("norm", norm, NORMS)
    if not (is_whole(repeats) and repeats >= 0):
        raise ArgumentError(f"repeats={brief(repeats)}; expected a whole number, 0 or more")
    if not isinstance(name, str):
        raise ArgumentError(f"name={brief(name)}; expected a text")
    if not callable(progress):
        check_progress(progress)


def _options(case: Case, run: Run, atol: Any) -> Options:
    """Return the options of a run; the error for a step that does not fit names fitting steps."""
    given = {"method": run.method, "cspace": run.cspace}
    if run.dt is None:
        return case.options(rtol=run.rtol, atol=atol, **given)
    start = checked_time("t0", case.t0, after=-math.inf)
    length = checked_time("t_end", case.t_end, after=start) - start
    case.options(dt=length if length < math.inf else run.dt, **given)  # all but the step
    _require_part(run.dt, length)
    return case.options(dt=run.dt, **given)


def _require_part(dt: float, length: float) -> None:
    """Raise TimeGridError, with the nearest fits, unless dt divides the length of the run."""
    steps = length / dt
    if steps < 0.5 or abs(steps - round(steps)) > 1e-9 * max(1.0, 1e-3 * steps):
        below = max(math.floor(steps), 1)
        raise TimeGridError(
            f"dts has {dt!r} s, of which no whole number makes t_end − t0 = {length!r} s; the "
            f"nearest that fit are {length / (below + 1)!r} and {length / below!r}"
        )


# ---- words -------------------------------------------------------------------------------------


def _notes(
    case: Case, reference: Reference, overhead: float, count: int, measure_every: int
) -> Iterator[str]:
    model, norm, repeats = case.model, case.norm, case.repeats
    of_all = f", the {norm} over the {count} trajectories" if count > 1 else ""
    links = ", of the farthest link" if model.joint_names else ""
    may_end = any(event.terminal for event in model.events)
    ended = ", or where an event has ended a trajectory" if may_end else ""
    yield f"Errors are those at t = {case.t_end:g} s{ended}, from t = {case.t0:g} s{links}{of_all}."
    if reference.errors and any(reference.errors.values()):
        each = ", ".join(
            f"{rounded(reference.errors[name])} {unit} ({name})" for name, unit in ERRORS.items()
        )
        yield (
            f"Reference: {reference.what}; off by about {each}, and an error counts from "
            f"{MARGIN:g} times that."
        )
    else:
        yield f"Reference: {reference.what}, taken to be exact."
    yield "Errors in brackets do not exceed those of the reference, or the accumulated rounding."
    yield f"Drifts are the largest of the run, measured every {counted(measure_every, 'step')}."
    if repeats:
        cpu = machine()["cpu"]
        yield (
            f"CPU time is that of the thread, of a whole call of integrate for "
            f"{counted(count, 'trajectory', 'trajectories')} on one thread of {cpu}, compiled "
            f"before, the best of {repeats}."
        )
        if math.isfinite(overhead):
            yield f"A call takes {1e3 * overhead:.2g} ms of that, whatever the number of steps."
    yield COUNTED


@contextmanager
def _telling(progress: Progress, total: int) -> Iterator[Callable[[float, str], None]]:
    """Yield a function that reports the number of runs done, with fractions, and the next one."""
    is_function = callable(progress)
    shown: Any = False if is_function else progress
    with reporter(shown, total * SHARE, "runs") as report:
        last = ""

        def tell(done: float, what: str) -> None:
            nonlocal last
            report(int(done * SHARE))
            if callable(progress) and what != last:
                progress(int(done), total, what)
            last = what

        yield tell
        if callable(progress):
            progress(total, total, "")
