"""`integrate`: check → pack → run → Arrow. No formula here."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Mapping
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lierb.errors import (
    ArgumentError,
    InconsistentStateWarning,
    brief,
)
from lierb.kernels.stepping.clock import Clock
from lierb.kernels.systems.plan import Stabilisation
from lierb.methods import ButcherTableau
from lierb.model.functions.events import Event
from lierb.model.mechanism.mechanism import Mechanism
from lierb.model.problem import Problem
from lierb.results.failures import STATUS_NAMES, Failures, warn_of
from lierb.results.result import Result
from lierb.results.tables import (
    _no_room,
    _require_memory,
    events_table,
    history_table,
    summary_table,
)
from lierb.runs import engine
from lierb.runs import start_checks as checks
from lierb.runs.continuation import End
from lierb.runs.mechanism_checks import violation
from lierb.runs.options import check_options
from lierb.runs.provenance import described_array, provenance
from lierb.runs.starts import (
    ready_body,
    ready_mechanism,
    told_cspace,
    told_stabilisation,
)
from lierb.runs.stiffness import warn_of_stiff_steps
from lierb.runs.timing import (
    checked_numbers,
    checked_seed,
    has_jumps,
)
from lierb.support.arrays import Array
from lierb.support.progress import Progress, check_progress


def integrate(
    problem: Problem | Mechanism,
    *,
    twist0: ArrayLike | Mapping[str, ArrayLike],
    pose0: Any = None,
    dt: float | None = None,
    t_end: float,
    t0: float = 0.0,
    rtol: float | None = None,
    atol: float | Mapping[str, float] | None = None,
    dt_min: float | None = None,
    dt_max: float | None = None,
    max_steps: int | None = None,
    method: str | ButcherTableau | None = None,
    cspace: str | Mapping[str, str] | None = None,
    update: str = "local",
    save_every: int | None = None,
    save_at: ArrayLike | None = None,
    discontinuities: ArrayLike | None = None,
    measure_every: int = 1,
    record: Iterable[str] = (),
    events: Event | Iterable[Event] = (),
    check: str = "raise",
    solver: str = "auto",
    stabilise: str | Stabilisation | None = None,
    seed: int = 0,
    trajectories: ArrayLike | None = None,
    threads: int | None = None,
    progress: Progress = None,
) -> Result:
    """Integrate a body or a mechanism, or every member of a batch of them, from t0 to t_end.

    Poses and twists of a mechanism are dictionaries with those of every link.

    Parameters
    ----------
    problem : Problem or Mechanism
        The body with its joint and forces, or the mechanism; batched or shared.
    twist0 : array_like, shape (6,) or (n, 6), or dict of them
        Body-fixed twist (ω, v) at t0, rad/s and m/s; see `Joint.twist` and `Mechanism.twist`.
    pose0 : array_like or RigidTransform, shape (4, 4) or (n, 4, 4), or dict of them, optional
        Pose at t0. Default: the closed joint; for a mechanism `Mechanism.pose()`, all coordinates
        0.
    dt : float, optional
        Length of fixed steps, s; a whole number of them must fit between t0 and t_end. With
        adaptive steps, the length of the first one; default: Hairer's choice.
    t_end : float
        Time of the end, s.
    t0 : float, optional
        Time of the start, s. `Result.end` has the pose0, twist0 and t0 with which a run continues.
    rtol : float, optional
        Relative tolerance; it makes steps adaptive, each trajectory's its own. See Notes. Default:
        1e-6 where only atol is given.
    atol : float or dict, optional
        Absolute tolerance in SI units; it makes steps adaptive too. One number, or a dictionary by
        block: "rotation", "position", "omega", "v", and "states" for all of the user's. Default:
        1e-3 rtol; for position and v times the body's radius of gyration, m, and that per second. A
        mechanism's radius is that of all its links as one body.
    dt_min : float, optional
        Shortest adaptive step, s. A trajectory that needs a shorter one ends with status "dt_min".
        Default: the rounding of t.
    dt_max : float, optional
        Longest adaptive step, s. Default: no bound.
    max_steps : int, optional
        Number of tried steps after which a trajectory ends with status "max_steps". Default: no
        bound.
    method : str or ButcherTableau, optional
        A name of `lierb.TABLEAUS`, or a tableau. Default: "RK4", and "DOP853" with adaptive steps,
        which need a method with an embedded one.
    cspace : {"SE3", "SO3xR3", "reduced"} or dict, optional
        Configuration space. "SE3": screw motions. "SO3xR3": rotation and position decoupled.
        "reduced": the joint's own subgroup of SE(3), without constraints (Müller, eqs. 3a, b),
        where no start can be inconsistent. For a mechanism the product of those of its links, or a
        dictionary link → "SE3" or "SO3xR3"; "reduced" is the product of the joints' subgroups.
        Default: "SE3", and "reduced" for a mechanism.
    update : {"local", "global"}, optional
        "local": Munthe-Kaas, a new chart at each step. "global": one chart, moved at ‖ξ‖ = π.
    save_every : int, optional
        Number of steps between rows of `history`. Default: no history.
    save_at : array_like, shape (m,), optional
        Times of the rows of `history`, s, in ascending order. States there come from the method's
        continuous extension or, where it has none, from a step of their own. The column `step` is
        then the row's number.
    discontinuities : array_like, shape (m,), optional
        Times, s, in ascending order, at which a function of t jumps or has a kink. A step ends at
        each of them, and its stages see t on their own side. Times that differ from trajectory to
        trajectory are parameters of a `lierb.wrench`. Default: none.
    measure_every : int, optional
        Number of steps between samples of the maxima in `summary`.
    record : iterable of str, optional
        Extra columns of `history`: "state"; "energy"; "multipliers", λ (a free body has none);
        "reaction", the joint's wrench on the body (torque, force), N m and N, about the origin of
        the body's joint frame and in its axes, whatever rows describe the joint.
    events : Event or iterable of Event, optional
        Events made by `lierb.event`, beside the problem's own; see `Result.events`. A terminal one
        ends its trajectory with status "event".
    check : {"raise", "warn", "off"}, optional
        Treatment of a pose or twist that violates the joint. On "reduced" it always raises.
    solver : {"auto", "saddle", "subgroup"}, optional
        "saddle" solves the index-1 saddle point in every stage, as the paper does. "subgroup" is
        for a joint whose motions are a subgroup of SE(3), on "SE3" or "reduced": the solution is a
        constant gain, computed once. It needs check="raise"; a start that violates the joint by
        less than the tolerance is put on the subgroup. "auto" is "subgroup" where possible, else
        "saddle". A mechanism has no choice.
    stabilise : "project" or Stabilisation, optional
        Stabilisation of a mechanism's loops, and of its joints on "SE3" and "SO3xR3", which drift
        otherwise. "project" puts pose and velocity back on them after each step, by the change of
        least kinetic energy. `lierb.baumgarte(alpha, beta)` adds Baumgarte's terms. Default: none.
    seed : int, optional
        Seed of `lierb.noise`.
    trajectories : array_like of int, shape (n,), optional
        Numbers of the batch's members, by which noise is drawn. Default: 0 … n−1.
    threads : int, optional
        Number of threads in this call. Default: Numba's.
    progress : bool or callable, optional
        True for a bar on stderr (needs `lierb[cli]`) or, in a notebook, below the cell; False for
        none; or a function of (done, total). These count body-steps or, where each trajectory has
        its own clock, thousandths of trajectories. Default: a bar after two seconds, on a terminal
        or in a notebook.

    Returns
    -------
    Result
        Tables with a row for each trajectory, each saved time and each event.

    Raises
    ------
    LierbError
        An argument is wrong. Subclasses, all of them ValueErrors, say which. They are raised before
        anything runs or, for a start of up to 4096 bodies off its joint, within the first fraction
        of a second.
    MemoryLimitError
        The results are larger than the free memory.

    Warns
    -----
    FailedTrajectoryWarning
        Some trajectories have failed on the way. Each has a status in `summary`; the others are
        untouched.
    StiffStepWarning
        Fixed steps are beyond the method's stability bound for the stiffness or damping of a force
        of `lierb.forces`. The run goes on.

    Notes
    -----
    With adaptive steps, the method's embedded error of a step is in each block at most √(atol² +
    rtol² size²), over the method's `ButcherTableau.calibration`. Blocks are rotation (of size 1
    rad), position, omega, v, and each of the user's states.

    Examples
    --------
    >>> import lierb
    >>> body = lierb.Body(mass=6.075, inertia=(0.0126563, 0.0468281, 0.0569531))
    >>> top = lierb.Problem(body, lierb.joints.spherical(body_point=(-0.15, 0.0375, 0.0)))
    >>> twist0 = top.joint.twist(omega=(6.28, 3.14, 0.63))
    >>> result = lierb.integrate(top, twist0=twist0, dt=1e-3, t_end=0.1)
    >>> result.summary["status"].to_pylist()
    ['ok']
    """
    if not isinstance(problem, (Problem, Mechanism)):
        raise ArgumentError(
            f"problem must be a lierb.Problem or a lierb.Mechanism, got {brief(problem)}"
        )
    problem.require_unchanged()
    problem = problem.with_events(events) if events else problem
    space = ("SE3" if isinstance(problem, Problem) else "reduced") if cspace is None else cspace
    recorded, timing, found_by = check_options(
        problem, dt=dt, t_end=t_end, t0=t0, rtol=rtol, atol=atol, dt_min=dt_min, dt_max=dt_max,
        max_steps=max_steps, method=method, cspace=space, update=update, save_every=save_every,
        save_at=save_at, discontinuities=discontinuities, measure_every=measure_every,
        record=record, check=check, solver=solver, stabilise=stabilise,
    )  # fmt: skip
    check_progress(progress)
    noise_seed = checked_seed(seed)
    clock = None if timing.is_adaptive else timing.clock()
    options = {
        "dt": timing.dt or None, "t_end": float(t_end), "t0": float(t0),
        "method": timing.tableau.name, "cspace": told_cspace(space), "update": update,
        "save_every": timing.save_every or None, "measure_every": timing.measure_every,
        "record": recorded, "check": check, "solver": found_by,
    }  # fmt: skip
    if problem.controllers:
        options["seed"] = noise_seed
    more = timing.options()
    described = {
        "update": update, **timing.described(bool(problem.events), has_jumps(problem)),
        "multipliers": "multipliers" in recorded, "reaction": "reaction" in recorded,
        "elements": problem.kinds,
    }  # fmt: skip
    if isinstance(problem, Problem):
        assert isinstance(space, str)
        ready = ready_body(problem, pose0, twist0, clock, float(t0), space, found_by, described)
    else:
        options["stabilise"] = told_stabilisation(stabilise)
        ready = ready_mechanism(
            problem, pose0, twist0, clock, float(t0), space, stabilise, described
        )
    plan, inputs, count = ready.plan, ready.inputs, ready.inputs.count
    times: Clock
    numbers = None if trajectories is None else checked_numbers(trajectories, count)
    if numbers is not None and problem.controllers:
        more["trajectories"] = described_array(numbers)
    if timing.is_of_lanes:
        numbers = np.arange(count, dtype=np.float64) if numbers is None else numbers
        times = timing.lane_time(ready.clock, problem.events, noise_seed, numbers)
    else:
        assert ready.clock is not None
        times = ready.clock
    on_violation = "raise" if space == "reduced" else check  # there it has no room

    def check_start(starts: Array, first: int) -> bool:
        error = checks.violation(inputs, starts, first)
        _report(error, on_violation, stacklevel=5)
        return error is None

    _require_memory(plan, times, count, recorded)
    start = ready.pose0, ready.twist0, count
    warn_of_stiff_steps(problem, start, timing, ready.before is not None, stacklevel=3)
    checked = on_violation != "off" and ready.before is None
    described_run = provenance(
        problem,
        twist0=ready.twist0,
        pose0=ready.pose0,
        before=ready.before,
        plan=plan,
        options=options,
        more=more,
    )
    is_seen = checked and isinstance(problem, Problem) and bool(problem.rows)
    try:
        if checked and isinstance(problem, Mechanism):
            error = violation(problem, ready.pose0, ready.twist0, float(t0))
            _report(error, on_violation, stacklevel=3)
        checked_start = check_start if is_seen else None
        run = partial(
            engine.integrate,
            with_state="state" in recorded, threads=threads, progress=progress, check=checked_start,
        )  # fmt: skip
        output = run(plan, inputs, times)
        metadata = described_run()
        result = Result(
            summary_table(output, metadata, problem),
            history_table(output, recorded, plan, metadata, problem) if timing.saves else None,
            End(problem, plan, output, STATUS_NAMES, metadata),
            events_table(output, metadata, problem) if problem.events else None,
        )
    except MemoryError as error:
        raise _no_room(plan, times, count, recorded) from error
    if np.count_nonzero(output.status):  # OK is 0; quicker than any()
        warn_of(Failures.of(result.summary), "`failed` of the result lists them", stacklevel=3)
    return result


# ---- arguments ---------------------------------------------------------------------------------


def _report(error: ValueError | None, check: str, stacklevel: int) -> None:
    """stacklevel : of the caller of `integrate`."""
    if error is None:
        return
    if check == "raise":
        raise error
    warnings.warn(str(error), InconsistentStateWarning, stacklevel=stacklevel)
