"""A problem made ready to be integrated: its plan, its start, and whether it goes on from a run."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from lierb.errors import ArgumentError, brief
from lierb.kernels.stepping.clock import StepClock
from lierb.kernels.systems.plan import AnyPlan, Stabilisation
from lierb.kernels.systems.system_of import plan_of, system_of
from lierb.kernels.tracing.cpu import DEFAULT_LANES
from lierb.model.mechanism.mechanism import Mechanism
from lierb.model.problem import Problem
from lierb.runs.continuation import continuation_of, continuing
from lierb.runs.inputs import Inputs
from lierb.runs.plans import CSpace, cspaces_of, mechanism_plan_of
from lierb.support.arrays import Array, as_number, as_numbers, as_poses


class Ready(NamedTuple):
    """pose0, twist0 : as arrays, of a mechanism by link; pose0 is None for the closed joint.

    before : provenance of the run at whose end it starts, from the driver's own state, if it does.
    """

    plan: AnyPlan
    inputs: Inputs
    clock: StepClock | None
    pose0: Any
    twist0: Any
    before: str | None


def ready_body(
    problem: Problem,
    pose0: Any,
    twist0: Any,
    clock: StepClock | None,
    t0: float,
    cspace: str,
    solver: str,
    described: dict[str, Any],
) -> Ready:
    """described : what of the plan does not depend on how the body is held."""
    twists = as_numbers("twist0", twist0, (6,), copy=None)
    poses: Array | None = None
    if pose0 is not None:
        is_an_end = continuation_of(pose0) is not None
        poses = np.asarray(pose0) if is_an_end else as_poses("pose0", pose0, copy=None)
    start = (
        {"twist0": (twists, 1)} if poses is None else {"pose0": (poses, 2), "twist0": (twists, 1)}
    )
    count = problem.batch_size(**start) or 1
    plan = plan_of(
        DEFAULT_LANES,
        rows=problem.rows,
        cspace="SO3xR3" if cspace == "SO3xR3" else "SE3",
        solver=solver,
        **described,
    )
    known = continuing(pose0, problem, plan, twist0, t0)
    if known is not None and clock is not None:
        clock = known.clock_of(clock)
    state = None if known is None else known.state_of(plan)
    starts = {"twist": twists} | ({} if poses is None else {"pose": poses})
    inputs = Inputs(problem, system_of(plan).inputs, starts, count, t0, state)
    return Ready(plan, inputs, clock, poses, twists, None if known is None else known.provenance)


def ready_mechanism(
    mechanism: Mechanism,
    pose0: Any,
    twist0: Any,
    clock: StepClock | None,
    t0: float,
    cspace: CSpace,
    stabilise: Any,
    described: dict[str, Any],
) -> Ready:
    """described : what of the plan does not depend on what hangs on what."""
    poses = arrays_of(mechanism, "pose0", mechanism.pose() if pose0 is None else pose0)
    twists = arrays_of(mechanism, "twist0", twist0)
    sizes = {f"pose0[{name!r}]": (array, 2) for name, array in poses.items()}
    sizes |= {f"twist0[{name!r}]": (array, 1) for name, array in twists.items()}
    count = mechanism.batch_size(**sizes) or 1
    plan = mechanism_plan_of(
        mechanism, cspaces_of(mechanism, cspace), stabilisation_of(stabilise), **described
    )
    starts = {f"{i}.pose": poses[name] for i, name in enumerate(mechanism.names)}
    starts |= {f"{i}.twist": twists[name] for i, name in enumerate(mechanism.names)}
    known = continuing(pose0, mechanism, plan, twist0, t0)
    if known is not None and clock is not None:
        clock = known.clock_of(clock)
    state = None if known is None else known.state_of(plan)
    inputs = Inputs(mechanism, system_of(plan).inputs, starts, count, t0, state)
    return Ready(plan, inputs, clock, poses, twists, None if known is None else known.provenance)


def arrays_of(mechanism: Mechanism, argument: str, given: Any) -> dict[str, Array]:
    """Poses or twists of all links, checked."""
    given = mechanism.by_link(argument, given)
    if argument == "pose0":
        return {n: as_poses(f"pose0[{n!r}]", given[n], copy=None) for n in mechanism.names}
    return {n: as_numbers(f"twist0[{n!r}]", given[n], (6,), copy=None) for n in mechanism.names}


def baumgarte(alpha: float, beta: float) -> Stabilisation:
    """Baumgarte's stabilisation, for `lierb.integrate(…, stabilise=…)`.

    In place of ḧ = 0 the constraints obey ḧ + 2α ḣ + β² h = 0, so that errors decay like e^(−αt)
    where β = α.

    Parameters
    ----------
    alpha : float
        Rate α, 1/s. Values beyond 1/dt make steps unstable.
    beta : float
        Rate β, 1/s.

    Returns
    -------
    Stabilisation
        Value of the argument `stabilise`.

    References
    ----------
    J. Baumgarte, Comput. Methods Appl. Mech. Eng. 1 (1972) 1–16.

    Examples
    --------
    >>> import lierb
    >>> lierb.baumgarte(10.0, 10.0)
    Stabilisation(kind='baumgarte', alpha=10.0, beta=10.0)
    """
    rates = {}
    for name, given in (("alpha", alpha), ("beta", beta)):
        rates[name] = float(as_number(name, given))
        if rates[name] < 0.0:
            raise ArgumentError(f"{name}={brief(given)}; expected zero or a positive number, 1/s")
    return Stabilisation("baumgarte", **rates)


def stabilisation_of(given: Any) -> Stabilisation:
    """Of the argument `stabilise`. Raises ArgumentError for anything else."""
    if given is None:
        return Stabilisation()
    if isinstance(given, Stabilisation):
        return given
    if isinstance(given, str) and given == "project":
        return Stabilisation("project")
    raise ArgumentError(
        f'stabilise={brief(given)}; expected None, "project" or lierb.baumgarte(alpha, beta)'
    )


def told_stabilisation(given: Any) -> str | None:
    """As metadata have it."""
    kept = stabilisation_of(given)
    rates = f"({kept.alpha!r}, {kept.beta!r})" if kept.kind == "baumgarte" else ""
    return None if kept.kind == "none" else f"{kept.kind}{rates}"


def told_cspace(given: CSpace) -> str:
    """As metadata have it."""
    return given if isinstance(given, str) else ", ".join(f"{k}: {v}" for k, v in given.items())


def check_mechanism_options(mechanism: Mechanism, update: str, solver: str, stabilise: Any) -> None:
    kept = stabilisation_of(stabilise)
    if solver != "auto":
        raise ArgumentError(
            f'solver="{solver}" is for a lierb.Problem; a mechanism has none to choose: '
            "leave solver out"
        )
    if kept.kind == "project" and update == "global":
        raise ArgumentError(
            'stabilise="project" needs update="local": it moves poses, and a global update keeps '
            "them in one chart"
        )
