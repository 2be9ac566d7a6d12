"""`convergence`: methods side by side, on c-spaces and over steps or tolerances."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from itertools import product
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import ArrayLike

from lierb.analysis.comparison import Comparison, comparison
from lierb.analysis.comparison_orders import FLOOR
from lierb.analysis.comparison_tables import QUANTITIES
from lierb.analysis.magnitudes import kinds_of
from lierb.analysis.reference import (
    ERRORS,
    MARGIN,
    METHOD,
    NORMS,
    Ends,
    Reference,
    found_reference,
    given_reference,
    normed,
    rounding,
    sizes_of,
    warn_of_runs,
)
from lierb.api import integrate
from lierb.errors import ArgumentError, TimeGridError, brief, items_of, require_name
from lierb.kernels.systems.plan import Stabilisation
from lierb.methods import TABLEAUS, ButcherTableau, tableau_of
from lierb.model.mechanism.mechanism import Mechanism
from lierb.model.problem import Problem
from lierb.results.columns import as_array
from lierb.results.failures import Failures
from lierb.results.result import Result
from lierb.runs.options import check_options
from lierb.runs.provenance import machine
from lierb.runs.starts import told_cspace
from lierb.runs.timing import checked_seed
from lierb.support.arrays import as_positive, is_whole
from lierb.support.collected_warnings import told_elsewhere
from lierb.support.progress import check_progress, reporter
from lierb.support.shown import counted, rounded

CSpace = str | Mapping[str, str]
Progress = bool | Callable[[int, int, str], object] | None

DRIFTS = {"position": "position_error", "rotation": "rotation_error", "energy": "energy_drift"}
SHARE = 1000  # of a run, in which its progress is told
FIRST_STEPS = 256  # of a reference, where no dt says how fast the motion is
HALVINGS, MORE_HALVINGS = 6, 12  # of the reference's step; where no dt says where to begin
MOST_RUNS = 1000
COUNTED = (
    "Right-hand sides are counted as stages × (steps + rejected), of a trajectory in the mean; a "
    "last stage that is the next step's first is not counted."
)


@dataclass(frozen=True)
class Run:
    """One of those that are compared: a method on a c-space, at a step or a tolerance."""

    tableau: ButcherTableau
    cspace: CSpace
    dt: float | None
    rtol: float | None

    @property
    def label(self) -> str:
        control = f"rtol = {self.rtol:g}" if self.dt is None else f"dt = {self.dt:g} s"
        return f"{self.tableau.name}, {told_cspace(self.cspace)}, {control}"


def convergence(
    problem: Problem | Mechanism,
    methods: str | ButcherTableau | Iterable[str | ButcherTableau] = ("RK4",),
    dts: ArrayLike | None = None,
    *,
    twist0: ArrayLike | Mapping[str, ArrayLike],
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
        As in `integrate`. A batch is integrated as one, each trajectory with the same noise in
        every run.
    methods : str, ButcherTableau or iterable of them, optional
        Names or tableaus.
    dts : array_like, shape (m,), optional
        Fixed steps, s, of which a whole number fits between t0 and t_end. At least one of `dts` and
        `rtols` must be given.
    twist0 : array_like, shape (6,) or (n, 6), or dict of them
        Body-fixed twist at t0, as in `integrate`.
    t_end : float
        Time of the end, s.
    pose0 : array_like or RigidTransform, shape (4, 4) or (n, 4, 4), or dict of them, optional
        Pose at t0, as in `integrate`.
    t0 : float, optional
        Time of the start, s.
    rtols : array_like, shape (m,), optional
        Tolerances of adaptive steps, for the methods with an embedded pair.
    atol : float or dict, optional
        Absolute tolerance that goes with `rtols`, as in `integrate`.
    cspaces : str or iterable of str, optional
        Configuration spaces, as `integrate` takes one. Default: its default.
    update : {"local", "global"}, optional
        As in `integrate`.
    solver : {"auto", "saddle", "subgroup"}, optional
        As in `integrate`.
    stabilise : "project" or Stabilisation, optional
        As in `integrate`.
    measure_every : int, optional
        Number of steps between samples of the drifts.
    seed : int, optional
        Seed of `lierb.noise`.
    reference : Result, dict or pair of poses and twists, optional
        Exact state at t_end: the `lierb.Result` of another run, its `end`, or a pair like pose0 and
        twist0. Default: the same problem by DOP853, its step halved until that no longer helps, on
        "reduced" if the joint has it. The error of this reference is estimated from the step before
        and from another c-space, and an error counts only where it is ten times as large, and
        larger than the rounding of so many steps.
    norm : {"largest", "median"}, optional
        Norm of an error over the trajectories of a batch.
    repeats : int, optional
        Number of timed repetitions of each run, after one that compiles. The least CPU time of the
        one thread counts. 0 measures none.
    name : str, optional
        Title of the figure.
    progress : bool or callable, optional
        True, False or None as in `integrate`, or a function of (runs done, runs in all, name of the
        next one).

    Returns
    -------
    Comparison
        A table of the runs, and the observed orders.

    Raises
    ------
    LierbError
        An argument is wrong. Subclasses say which.

    Warns
    -----
    FailedTrajectoryWarning
        Some trajectories have failed in a run. They are left out of its errors, and counted in
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
    if not isinstance(problem, (Problem, Mechanism)):
        raise ArgumentError(
            f"problem must be a lierb.Problem or a lierb.Mechanism, got {brief(problem)}"
        )
    tableaus = _tableaus(methods)
    spaces = _cspaces(problem, cspaces)
    steps, tolerances = _several("dts", dts), _several("rtols", rtols)
    if atol is not None and not tolerances:
        raise ArgumentError("atol goes with rtols=, the tolerances of adaptive steps; give both")
    require_name("norm", norm, NORMS)
    if not (is_whole(repeats) and repeats >= 0):
        raise ArgumentError(f"repeats={brief(repeats)}; expected a whole number, 0 or more")
    if not isinstance(name, str):
        raise ArgumentError(f"name={brief(name)}; expected a text")
    if not callable(progress):
        check_progress(progress)
    runs = _runs(tableaus, spaces, steps, tolerances)
    kept = {"update": update, "solver": solver, "stabilise": stabilise}
    for run in runs:
        _check(problem, run, t0, t_end, atol, measure_every, kept)
    start = {"twist0": twist0, "pose0": pose0, "t_end": t_end, "t0": t0, "progress": False}
    start["seed"] = checked_seed(seed)
    options = kept | {"measure_every": measure_every} | start
    length = float(t_end) - float(t0)
    given = None if reference is None else given_reference(reference, problem, float(t_end))

    def sizes(ends: Ends) -> dict[str, float]:
        return sizes_of(problem, ends, twist0)

    def fine(cspace: str, dt: float) -> Result:
        own = start | {"stabilise": stabilise, "measure_every": max(round(length / dt), 1)}
        return integrate(problem, dt=dt, method=METHOD, cspace=cspace, **own)

    rows, failures = [], []
    with told_elsewhere(), _telling(progress, len(runs) + (given is None)) as tell:
        done = 0
        if given is None:
            dt, halvings = (
                (min(steps), HALVINGS) if steps else (length / FIRST_STEPS, MORE_HALVINGS)
            )
            tell_of = partial(tell, 0.0)
            given = found_reference(problem, fine, length, dt, halvings, norm, sizes, tell_of)
            done = 1
        measured = sizes(given.ends)
        for run in runs:
            following = partial(_tell_share, tell, done, run.label)
            found = _ran(problem, run, options, atol, repeats, following)
            rows.append(_row(problem, run, found, given, measured, norm, length))
            if told_failures := Failures.of(found.summary):
                failures.append(f"{run.label}: {told_failures}")
            done += 1
        one_step = options | {"dt": length, "method": tableaus[0], "cspace": spaces[0]}
        overhead = _timed(
            lambda: integrate(problem, **one_step, threads=1), repeats if steps else 0
        )
    warn_of_runs(failures)
    count = rows[0]["trajectories"]
    times = float(t0), float(t_end)
    measure_every = min(int(measure_every), 2**53)  # no run has more steps
    notes = _notes(problem, given, norm, repeats, overhead, count, times, measure_every)
    metadata = {
        **machine(), "units": "SI: m, s, rad, J", "norm": norm, "reference": given.what,
        "reference_errors": given.errors, "t0": float(t0), "t_end": float(t_end),
        "repeats": int(repeats), "measure_every": measure_every, "update": update,
    }  # fmt: skip
    seen = {quantity: measured[quantity] for quantity in _quantities(problem)}
    return comparison(rows, tableaus, seen, name, notes, metadata)


# ---- arguments ---------------------------------------------------------------------------------


def _tableaus(given: Any) -> list[ButcherTableau]:
    is_one = isinstance(given, (str, ButcherTableau))
    methods = (given,) if is_one else items_of("methods", given, "names of methods, or tableaus")
    found = [tableau_of(method) for method in methods]
    if not found:
        raise ArgumentError(f"methods is empty; expected some of {', '.join(TABLEAUS)}")
    _require_different("methods", [tableau.name for tableau in found])
    return found


def _cspaces(problem: Problem | Mechanism, given: Any) -> list[CSpace]:
    default = "SE3" if isinstance(problem, Problem) else "reduced"
    if given is None:
        return [default]
    is_one = isinstance(given, (str, Mapping))
    found = [given] if is_one else list(items_of("cspaces", given, "names of c-spaces"))
    if not found:
        raise ArgumentError(f'cspaces is empty; leave it out for "{default}"')
    for each in found:
        if not isinstance(each, (str, Mapping)):
            raise ArgumentError(f"cspaces has {brief(each)}; expected names of c-spaces")
    _require_different("cspaces", [told_cspace(each) for each in found])
    return found


def _several(argument: str, given: Any) -> list[float]:
    """Positive numbers, the largest first; [] for None."""
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
    tableaus: list[ButcherTableau], cspaces: list[CSpace], dts: list[float], rtols: list[float]
) -> list[Run]:
    """Every method and c-space at every step, and at every tolerance if it can adapt its steps."""
    if not (dts or rtols):
        raise ArgumentError("neither dts nor rtols is given; give fixed steps, s, or tolerances")
    if rtols and not dts:
        for tableau in tableaus:
            if tableau.error is None:
                pairs = ", ".join(name for name, each in TABLEAUS.items() if each.error is not None)
                raise ArgumentError(
                    f"{tableau.name} has no embedded pair, which rtols needs; give dts= as well, "
                    f"or take {pairs}"
                )
    found = [Run(*pair, dt, None) for pair in product(tableaus, cspaces) for dt in dts]
    found += [
        Run(tableau, cspace, None, rtol)
        for tableau, cspace in product(tableaus, cspaces) if tableau.error is not None
        for rtol in rtols
    ]  # fmt: skip
    if len(found) > MOST_RUNS:
        raise ArgumentError(f"these are {len(found)} runs; expected {MOST_RUNS} at most")
    return found


def _check(
    problem: Problem | Mechanism,
    run: Run,
    t0: float,
    t_end: float,
    atol: Any,
    measure_every: int,
    kept: dict[str, Any],
) -> None:
    """Raise what `integrate` would, and of a step that does not fit which ones do."""
    length = _length(t0, t_end)

    def check(**control: Any) -> None:
        check_options(
            problem, t_end=t_end, t0=t0, method=run.tableau, cspace=run.cspace, save_every=None,
            measure_every=measure_every, record=(), **control, **kept,
        )  # fmt: skip

    if run.dt is None:
        check(rtol=run.rtol, atol=atol)
        return
    # all but the step, of which we have more to say
    check(dt=length if 0.0 < length < math.inf else run.dt)
    _require_part(run.dt, length)
    check(dt=run.dt)


def _length(t0: Any, t_end: Any) -> float:
    """From t0 to t_end, s; NaN where they are no times, of which check_options says more."""
    if not all(is_whole(t) or isinstance(t, (float, np.floating)) for t in (t0, t_end)):
        return math.nan
    try:
        return float(t_end) - float(t0)
    except OverflowError:
        return math.nan


def _require_part(dt: float, length: float) -> None:
    """Raise TimeGridError where no whole number of steps makes the run; the nearest that do."""
    steps = length / dt
    if steps < 0.5 or abs(steps - round(steps)) > 1e-9 * max(1.0, 1e-3 * steps):
        below = max(math.floor(steps), 1)
        raise TimeGridError(
            f"dts has {dt!r} s, of which no whole number makes t_end − t0 = {length!r} s; the "
            f"nearest that fit are {length / (below + 1)!r} and {length / below!r}"
        )


# ---- runs --------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Ran:
    """A run's summary and ends, and the CPU time that it took, s; ∞ if none was measured."""

    summary: pa.Table
    ends: Ends
    seconds: float


def _ran(
    problem: Problem | Mechanism,
    run: Run,
    options: dict[str, Any],
    atol: Any,
    repeats: int,
    tell: Callable[[float], None],
) -> Ran:
    """Once, which compiles, and then `repeats` times by the clock. tell : of its share done."""
    control: dict[str, Any] = {"dt": run.dt} if run.dt is not None else {"rtol": run.rtol}
    if run.dt is None and atol is not None:
        control["atol"] = atol
    own = options | control | {"method": run.tableau, "cspace": run.cspace, "threads": 1}

    def follow(done: int, total: int) -> None:
        tell(done / max(total, 1) / (repeats + 1))

    tell(0.0)
    result = integrate(problem, **(own | {"progress": follow}))
    seconds = _timed(
        lambda: integrate(problem, **own), repeats, lambda k: tell((k + 1) / (repeats + 1))
    )
    return Ran(result.summary, Ends.of(result.summary, result.links), seconds)


def _timed(
    call: Callable[[], object], repeats: int, tell: Callable[[int], None] = lambda k: None
) -> float:
    """CPU time of this thread, s, the best of `repeats`; ∞ of none."""
    seconds = math.inf
    for k in range(repeats):
        tell(k)
        began = time.thread_time()
        call()
        seconds = min(seconds, time.thread_time() - began)
    return seconds


def _row(
    problem: Problem | Mechanism,
    run: Run,
    found: Ran,
    reference: Reference,
    sizes: dict[str, float],
    norm: str,
    length: float,
) -> dict[str, Any]:
    """A row of the table, by column."""
    summary, ends, failed = found.summary, found.ends, found.ends.failed
    count = len(failed)
    if len(reference.ends.failed) != count:
        raise ArgumentError(
            f"reference has {counted(len(reference.ends.failed), 'trajectory', 'trajectories')}; "
            f"expected {count}, a pose and a twist for each of the batch"
        )
    missing = ends.failed | reference.ends.failed
    if "steps" in summary.column_names:  # of adaptive ones, and of those that a controller ends
        steps, rejected = (as_array(summary[c]).astype(float) for c in ("steps", "rejected"))
    else:
        assert run.dt is not None
        steps, rejected = np.full(count, float(round(length / run.dt))), np.zeros(count)
    mean = float(np.mean(steps[~failed])) if not failed.all() else math.nan
    refused = float(np.mean(rejected[~failed])) if not failed.all() else math.nan
    errors = normed(ends.errors(reference.ends), norm)
    drifts = normed(
        {k: np.where(failed, np.nan, as_array(summary[f"{c}_max"])) for k, c in DRIFTS.items()},
        norm,
    )
    row: dict[str, Any] = {
        "method": run.tableau.name, "cspace": told_cspace(run.cspace), "dt": run.dt,
        "rtol": run.rtol, "step": run.dt if run.dt is not None else _or_none(length / mean),
        "steps": _or_none(mean), "rejected": _or_none(refused),
        "evaluations": _or_none(_evaluations(run.tableau, run.rtol is not None, mean + refused)),
        "cpu_time": _or_none(found.seconds),
        "trajectories": count, "failed": int(missing.sum()),
    }  # fmt: skip
    numbers = {f"error.{k}": v for k, v in errors.items()}
    numbers |= {f"drift.{k}": v for k, v in drifts.items()}
    present = _quantities(problem)
    for quantity in QUANTITIES:
        floor = sizes[quantity] * float(rounding(mean if math.isfinite(mean) else 1.0))
        if quantity.startswith("error."):
            floor = max(floor, MARGIN * reference.errors[quantity.removeprefix("error.")])
        row[quantity] = _or_none(numbers[quantity]) if quantity in present else None
        row[quantity + FLOOR] = floor if quantity in present else None
    return row


def _or_none(number: float) -> float | None:
    return number if math.isfinite(number) else None


def _evaluations(tableau: ButcherTableau, is_adaptive: bool, steps: float) -> float:
    """Right-hand sides of so many steps. Fixed ones need no stage that only the error asks for;
    adaptive ones need all, and two to choose the first step by.
    """
    if is_adaptive:
        return tableau.stages * steps + 2.0
    return (1 + max(i for i, weight in enumerate(tableau.b) if weight)) * steps


def _quantities(problem: Problem | Mechanism) -> list[str]:
    """All errors, and the drifts of what there are rows for; an added row may be of either kind."""
    kinds = kinds_of(problem) | ({"position", "rotation"} if problem.constraints else set())
    absent = {f"drift.{kind}" for kind in ("position", "rotation") if kind not in kinds}
    return [quantity for quantity in QUANTITIES if quantity not in absent]


# ---- words -------------------------------------------------------------------------------------


def _notes(
    problem: Problem | Mechanism, reference: Reference, norm: str, repeats: int, overhead: float,
    count: int, times: tuple[float, float], measure_every: int,
) -> Iterator[str]:  # fmt: skip
    of_all = f", over the {count} trajectories the {norm} each" if count > 1 else ""
    links = ", of the farthest link" if isinstance(problem, Mechanism) else ""
    ended = ", or where an event has ended a trajectory" if problem.events else ""
    yield f"Errors are those at t = {times[1]:g} s{ended}, from t = {times[0]:g} s{links}{of_all}."
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
    yield "Errors in brackets are no more than the reference's own, or than rounding adds up to."
    yield f"Drifts are the largest of the run, looked at every {counted(measure_every, 'step')}."
    if repeats:
        cpu = machine()["cpu"]
        yield (
            f"CPU time is that of the thread, of a whole call of integrate for "
            f"{counted(count, 'trajectory', 'trajectories')} on one thread of {cpu}, compiled "
            f"before, the best of {repeats}."
        )
        if math.isfinite(overhead):
            yield f"Of that a call takes {1e3 * overhead:.2g} ms whatever the steps are."
    yield COUNTED


@contextmanager
def _telling(progress: Progress, total: int) -> Iterator[Callable[[float, str], None]]:
    """A function of the runs done, parts of one included, and what comes next."""
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


def _tell_share(tell: Callable[[float, str], None], done: int, what: str, share: float) -> None:
    tell(done + share, what)
