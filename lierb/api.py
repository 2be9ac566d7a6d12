"""`integrate`: validate the options and the start, run, and make the tables."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Mapping
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lierb.errors import ArgumentError, InconsistentStateWarning, brief
from lierb.errors.synonyms import ARGUMENTS
from lierb.kernels.systems.plan import AnyPlan, Stabilisation
from lierb.methods import Method
from lierb.model.base import Model
from lierb.model.functions.events import Event
from lierb.model.mechanism.mechanism import Mechanism
from lierb.model.problem import Problem
from lierb.results.failures import (
    STATUS_NAMES,
    Failures,
    has_position_motors,
    warn_of,
    warn_of_motors,
)
from lierb.results.result import Result
from lierb.results.sensitivities import Untabled, sensitivities
from lierb.results.tables import events_table, history_table, no_room, require_memory, summary_table
from lierb.runs import engine
from lierb.runs.continuation import End, continuation_of
from lierb.runs.derivative_steps import examine_steps
from lierb.runs.derivatives import Derivatives, integrate_with_derivatives, require_differentiable
from lierb.runs.options import Options
from lierb.runs.output import Output
from lierb.runs.parameters import Parameter, chosen_parameters
from lierb.runs.provenance import provenance
from lierb.runs.starts import Ready, ready
from lierb.runs.stiff_runs import warn_of_stiff_run
from lierb.runs.stiffness import warn_of_stiff_steps
from lierb.runs.switches import warn_of_switches
from lierb.runs.unfit_functions import unfit_function
from lierb.support.arrays import Array
from lierb.support.keywords import explains_keywords
from lierb.support.progress import Progress, check_progress


@explains_keywords(ARGUMENTS)
def integrate(
    problem: Problem | Mechanism,
    *,
    # the start
    twist0: ArrayLike | Mapping[str, ArrayLike] | None = None,
    pose0: Any = None,
    # time and steps
    dt: float | None = None,
    t_end: float,
    t0: float = 0.0,
    rtol: float | None = None,
    atol: float | Mapping[str, float] | None = None,
    dt_min: float | None = None,
    dt_max: float | None = None,
    max_steps: int | None = None,
    discontinuities: ArrayLike | None = None,
    # equations and method
    method: str | Method | None = None,
    cspace: str | Mapping[str, str] | None = None,
    update: str = "local",
    solver: str = "auto",
    stabilise: str | Stabilisation | None = None,
    check: str = "raise",
    # results
    save_every: int | None = None,
    save_at: ArrayLike | None = None,
    record: Iterable[str] = (),
    measure_every: int = 1,
    events: Event | Iterable[Event] = (),
    with_respect_to: str | Iterable[str] = (),
    # the call
    seed: int = 0,
    trajectories: ArrayLike | None = None,
    threads: int | None = None,
    progress: Progress = None,
) -> Result:
    """Integrate a body or a mechanism, or a batch of them, from t0 to t_end.

    For a mechanism, poses and twists are dictionaries by link.

    Parameters
    ----------
    problem : Problem or Mechanism
        The body with its joint and forces, or the mechanism; batched or shared.
    twist0 : array_like, shape (6,) or (n, 6), or dict of them, optional
        Body-fixed twist (ω, v) at t0, rad/s and m/s; see `Joint.twist` and `Mechanism.twist`.
        Default: at rest.
    pose0 : array_like, Rotation or RigidTransform, (4, 4) or (n, 4, 4), or dict of them, optional
        Pose at t0; a Rotation of SciPy is a pose with the position 0. Default: the closed joint;
        for a mechanism `Mechanism.pose()`, all coordinates 0.
    dt : float, optional
        Length of the fixed steps, s; t_end − t0 must be a multiple of it. With adaptive steps,
        length of the first step; default: Hairer's choice.
    t_end : float
        End time, s.
    t0 : float, optional
        Start time, s. To continue a run, pass its `Result.end`: pose0, twist0 and t0.
    rtol : float, optional
        Relative tolerance; it makes steps adaptive, separately for each trajectory. See Notes.
        Default: 1e-6 if only atol is given.
    atol : float or dict, optional
        Absolute tolerance in SI units; it makes steps adaptive too. One number, or a dictionary by
        block: "rotation", "position", "omega", "v", and "states" for all of the user's states.
        Default: 1e-3 rtol, times the body's radius of gyration (m and m/s) for position and v. The
        radius of a mechanism is that of all its links as one body.
    dt_min : float, optional
        Shortest adaptive step, s. A trajectory that needs a shorter one ends with status "dt_min".
        Default: the rounding of t.
    dt_max : float, optional
        Longest adaptive step, s. Default: no bound.
    max_steps : int, optional
        Number of attempted steps after which a trajectory ends with status "max_steps". Default: no
        bound.
    discontinuities : array_like, shape (m,), optional
        Times, s, in ascending order, at which a function of t jumps or has a kink. A step ends at
        each of these times, and no step evaluates the function on the other side of it.
        Times that differ between trajectories are parameters of a `lierb.wrench`. Default: none.
    method : str or Method, optional
        A name of `lierb.methods.METHODS`, a `ButcherTableau`, a `RosenbrockTableau` or a
        `generalised_alpha`. Adaptive steps need an embedded method. Default: "RK4"; with adaptive
        steps "DOP853".
    cspace : {"SE3", "SO3xR3", "reduced"} or dict, optional
        Configuration space. "SE3": screw motions. "SO3xR3": rotation and position decoupled.
        "reduced": the joint's own subgroup of SE(3), without constraints (Müller, eqs. 3a, b),
        where every start is consistent. For a mechanism, the c-space is the product of the links'
        c-spaces, which a dictionary link → "SE3" or "SO3xR3" can set separately; "reduced" is the
        product of the joints' subgroups. Default: "SE3", and "reduced" for a mechanism.
    update : {"local", "global", "ambient"}, optional
        "local": Munthe-Kaas, a new chart at each step. "global": one chart, moved at ‖ξ‖ = π.
        "ambient": quaternions and positions, normalised after each step; faster, not for
        commutator-free methods. In a mechanism, joints about or along one axis keep "local".
    solver : {"auto", "saddle", "subgroup", "looped", "unrolled"}, optional
        "saddle" solves the index-1 saddle-point problem in every stage, as the paper does.
        "subgroup" is for a joint whose motions form a subgroup of SE(3), on "SE3" or "reduced": the
        solution is a constant gain, computed once. It requires check="raise"; a start that violates
        the joint by less than the tolerance is projected onto the subgroup. "auto" is "subgroup" if
        possible, otherwise "saddle". For a mechanism, "looped" is code that loops over the links of
        any tree on reduced coordinates and is compiled once for all trees; an error names what it
        does not support. "unrolled" is code that is compiled for one tree. "auto" is "looped" for
        more than seven links, if possible.
    stabilise : "project" or Stabilisation, optional
        Stabilisation of a mechanism's loops, and of its joints on "SE3" and "SO3xR3", which drift
        otherwise. "project" projects pose and velocity onto the constraints after each step, by the
        change of least kinetic energy. `lierb.baumgarte(alpha, beta)` adds Baumgarte's terms.
        Default: none.
    check : {"raise", "warn", "off"}, optional
        Treatment of a pose or twist that violates the joint. On "reduced" it is always "raise".
    save_every : int, optional
        Number of steps between rows of `history`. Default: no history.
    save_at : array_like, shape (m,), optional
        Times of the rows of `history`, s, in ascending order. States at these times come from the
        method's continuous extension or, if it has none, from an extra step. The column `step` is
        then the row's number.
    record : iterable of str, optional
        Extra columns of `history`: "state", pose and twist; "energy", with the work of forces;
        "multipliers", λ (a free body has none); "reaction", the joint's wrench on the body (torque,
        force), N m and N, about the origin of the body's joint frame and in its axes.
    measure_every : int, optional
        Number of steps between samples of the maxima in `summary`.
    events : Event or iterable of Event, optional
        Events made by `lierb.event`, in addition to the problem's own; see `Result.events`. A
        terminal event ends its trajectory with status "event".
    with_respect_to : str or iterable of str, optional
        Parameters with respect to which the run is differentiated, exactly: see
        `Result.sensitivities` and `Result.sensitivity`. Starts: "omega0", "twist0", and "pose0", as
        C exp ε. Numbers of the model: "gravity", "body.mass", "body.com", "body.inertia" (11, 22,
        33, 12, 13, 23), "joint.body_point", "joint.ground_point", "joint.pitch", "joint.length",
        and parameters of forces, functions and states, such as "spring_damper.stiffness". The names
        of a mechanism begin with the link, the loop or the element's link: "rod.omega0",
        "rod.body.mass", "rod.joint.body_point", "rod.spring_damper.stiffness". See Notes.
    seed : int, optional
        Seed of `lierb.noise`.
    trajectories : array_like of int, shape (n,), optional
        Numbers of the batch members, which select their noise. Default: 0 … n−1.
    threads : int, optional
        Number of threads in this call. Default: Numba's.
    progress : bool or callable, optional
        True for a bar on stderr (needs `lierb[cli]`) or, in a notebook, below the cell; False for
        none; or a function of (done, total). The unit is body-steps; with adaptive steps it is
        thousandths of trajectories. Default: a bar after two seconds, on a terminal or in a
        notebook.

    Returns
    -------
    Result
        Tables with a row for each trajectory, saved time and event.

    Raises
    ------
    LierbError
        An argument is wrong. The subclasses, all of them ValueErrors, classify the error. Errors
        are raised before the run or, for an inconsistent start of up to 4096 bodies, within the
        first fraction of a second.
    MemoryLimitError
        The results are larger than the free memory.

    Warns
    -----
    FailedTrajectoryWarning
        Some trajectories have failed during the run. Each has a status in `summary`; the other
        trajectories are unaffected. The warning names forces and states that are not finite at the
        start, and variable masses that are negative.
    StiffStepWarning
        Fixed steps exceed the method's stability bound for the stiffness or damping of a force of
        `lierb.forces`, or stability limits adaptive steps. The run continues.
    InconsistentStateWarning
        With check="warn", a start violates the joint. Or joints are far off the positions that
        motors prescribe, because a prescribed rate jumps.
    DerivativeWarning
        A force or function switches by a comparison; derivatives are right only if it is
        continuous there. Or, with adaptive steps, derivatives change by more than a tenth if the
        steps are halved.

    Notes
    -----
    Derivatives are those of the method's steps: dual numbers go through the same code, a few
    directions at a time. Values and steps are those of a run without derivatives, to the bit. A
    direction of a start is projected onto the motions that joints and loops admit, by least kinetic
    energy, as by `Problem.project`. So the derivatives times an admitted change are its effect. If
    a joint's point changes, the joint's frames keep their relative motion.

    With adaptive steps, the error estimate of a step is kept below
    √(atol² + rtol² size²)/`ButcherTableau.calibration` in each block. Blocks are rotation (of size
    1 rad), position, omega, v, and each of the user's states.

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
    model = checked_model(problem)
    model = model.with_(events=events) if events else model
    options = Options.of(
        model, cspace=cspace, update=update, record=record, check=check, solver=solver,
        stabilise=stabilise, seed=seed, trajectories=trajectories,
        dt=dt, t_end=t_end, t0=t0, method=method, rtol=rtol, atol=atol, dt_min=dt_min,
        dt_max=dt_max, max_steps=max_steps, save_every=save_every, save_at=save_at,
        discontinuities=discontinuities, measure_every=measure_every,
    )  # fmt: skip
    return integrate_model(
        model, options, pose0, twist0, with_respect_to=with_respect_to, threads=threads,
        progress=progress, stacklevel=4,
    )  # fmt: skip


def checked_model(problem: object) -> Model:
    """Return `problem` if it is a Problem or Mechanism; raise ArgumentError otherwise."""
    if not isinstance(problem, Model):
        raise ArgumentError(
            f"problem must be a lierb.Problem or a lierb.Mechanism, got {brief(problem)}"
        )
    return problem


def integrate_model(
    model: Model,
    options: Options,
    pose0: Any,
    twist0: Any,
    *,
    with_respect_to: str | Iterable[str | Parameter] = (),
    threads: int | None = None,
    progress: Progress = None,
    stacklevel: int = 2,
    has_tables: bool = True,
    argument: str = "with_respect_to",
) -> Result:
    """Integrate a model with validated options; arguments as in `integrate`.

    has_tables : False for derivatives without tables, for `Result.sensitivity` alone.
    stacklevel : stack level of warnings; 2 is the caller of this function.
    argument : the caller's name of `with_respect_to`, for messages.
    """
    model.require_unchanged()
    check_progress(progress)
    parameters = chosen_parameters(model, with_respect_to)
    prepared = ready(model, options, pose0, twist0)
    require_memory(prepared)
    if parameters:
        known = continuation_of(pose0)
        if prepared.before is None and known is not None and known.derivatives is not None:
            raise ArgumentError(
                f"{argument}: pose0 is the end of a run with derivatives, which go on with "
                "result.end as it is alone; begin with a copy of its poses, pose0=pose0.copy(), "
                "and apply the chain rule"
            )
        require_differentiable(prepared, parameters, argument)
        warn_of_switches(model, stacklevel=stacklevel + 1)
    warn_of_stiff_steps(prepared, stacklevel=stacklevel + 1)
    described = provenance(prepared)
    check = start_check(prepared, stacklevel + 3 + bool(parameters))
    try:
        report_start(prepared, stacklevel + 1)
        call = "state" in options.record, threads, progress, check
        derivatives = None
        if parameters:
            output, derivatives = integrate_with_derivatives(prepared, parameters, *call)
            examine_steps(prepared, output, derivatives, threads, stacklevel=stacklevel + 2)
        else:
            output = engine.integrate(prepared.plan, prepared.inputs, prepared.times, *call)
        warn_of_stiff_run(prepared, output, stacklevel=stacklevel + 1)
        result = _result(prepared, output, derivatives, described(), has_tables)
    except MemoryError as error:
        raise no_room(prepared) from error
    if np.count_nonzero(output.status):  # OK is 0; quicker than any()
        failures = Failures.of(result.summary)
        look = f"`failed` of the result lists them{unfit_function(prepared, output)}"
        warn_of(failures, look, stacklevel=stacklevel + 1)
    if has_position_motors(model):
        warn_of_motors(model, result.summary, stacklevel=stacklevel + 1)
    return result


def start_check(prepared: Ready, stacklevel: int) -> engine.StartCheck | None:
    """Return a function that checks the starts flagged by the kernels; None for no check."""
    model, options = prepared.model, prepared.options
    if not (prepared.is_checked and model.flags_starts and prepared.plan.rows):
        return None

    def check(is_on_joint: Array, first: int) -> bool:
        for body in np.flatnonzero(is_on_joint == 0.0).tolist():
            if error := model.violation(*prepared.start, number=first + body):
                _report(error, options, stacklevel)
                return False
        return True  # the flagged start is at the tolerance, up to rounding

    return check


_checked_plans: set[AnyPlan] = set()


def report_start(prepared: Ready, stacklevel: int) -> None:
    """Check a start that the kernels do not check.

    Of a plan that has not run yet, check the first start: its error need not wait for a kernel to
    be compiled.
    """
    model, options, plan = prepared.model, prepared.options, prepared.plan
    if not prepared.is_checked:
        return
    if not model.flags_starts:
        _report(model.violation(*prepared.start), options, stacklevel + 1)
    elif options.on_violation == "raise" and plan.rows and plan not in _checked_plans:
        _report(model.violation(*prepared.start, number=0), options, stacklevel + 1)
        _checked_plans.add(plan)


def _report(error: ValueError | None, options: Options, stacklevel: int) -> None:
    """Raise the error of a start that violates the joints, or issue it as a warning."""
    if error is None:
        return
    if options.on_violation == "raise":
        raise error
    warnings.warn(str(error), InconsistentStateWarning, stacklevel=stacklevel)


def _result(
    prepared: Ready,
    output: Output,
    derivatives: Derivatives | None,
    metadata: str,
    has_tables: bool,
) -> Result:
    model, plan = prepared.model, prepared.plan
    record, saves = prepared.options.record, prepared.options.timing.saves
    history = history_table(output, record, plan, metadata, model) if saves else None
    events = events_table(output, metadata, model) if model.events else None
    of_run: Any = None
    if derivatives is not None:
        of_run = Untabled(derivatives, model)
        if has_tables:
            of_run = sensitivities(derivatives, output, model, history, events, metadata)
    return Result(
        partial(summary_table, output, metadata, model),
        history,
        End(model, plan, output, STATUS_NAMES, metadata, derivatives and derivatives.state),
        events,
        of_run,
    )
