"""A problem made ready to be integrated: its plan, its start, and whether it goes on from a run."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from lierb.arrays import Array, as_numbers, as_poses
from lierb.kernels.numbers.lanes import DEFAULT_LANES
from lierb.kernels.stepping.clock import Clock
from lierb.kernels.stepping.plan import AnyPlan, plan_of
from lierb.kernels.stepping.systems import system_of
from lierb.model import Problem
from lierb.runs.continuation import continuation_of, continuing
from lierb.runs.engine import Inputs


class Ready(NamedTuple):
    """pose0, twist0 : as arrays, of a mechanism by link; pose0 is None for the closed joint.

    before : provenance of the run at whose end it starts, from the driver's own state, if it does.
    """

    plan: AnyPlan
    inputs: Inputs
    clock: Clock | None
    pose0: Any
    twist0: Any
    before: str | None


def ready_body(
    problem: Problem,
    pose0: Any,
    twist0: Any,
    clock: Clock | None,
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
