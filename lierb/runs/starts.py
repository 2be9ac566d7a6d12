"""Preparation of a run: plan, inputs and clocks, made from a model, a start and options."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from lierb.errors import ArgumentError
from lierb.kernels.stepping.clock import StepClock
from lierb.kernels.systems.plan import AnyPlan
from lierb.kernels.systems.system_of import system_of
from lierb.model.base import Model
from lierb.runs.continuation import Continuation, continuation_of, continuing
from lierb.runs.inputs import Inputs
from lierb.runs.lane_engine import LaneTime
from lierb.runs.options import Options
from lierb.runs.time_options import checked_numbers
from lierb.support.arrays import Array, as_poses, as_twists

ByLink = dict[str, Array]


class Ready(NamedTuple):
    """A run, ready to be integrated.

    pose0, twist0 : arrays; for a mechanism, arrays by link. pose0 is None for the closed joint.
    is_at_rest : True if twist0 is the default, rest.
    trajectories : numbers of the trajectories, if the caller passes them.
    before : end of the run whose kernel state this run continues from, or None.
    """

    model: Model
    options: Options
    plan: AnyPlan
    inputs: Inputs
    times: StepClock | LaneTime
    pose0: Any
    twist0: Any
    is_at_rest: bool
    trajectories: Array | None
    before: Continuation | None

    @property
    def start(self) -> tuple[Any, Any, float]:
        """Arguments of `Model.violation`: pose0, twist0, which is None for the default, and t0."""
        return self.pose0, None if self.is_at_rest else self.twist0, self.options.timing.t0

    @property
    def is_checked(self) -> bool:
        """True if the start is checked against the joints; the start of a continued run is not."""
        return self.options.on_violation != "off" and self.before is None


def ready(model: Model, options: Options, pose0: Any, twist0: Any) -> Ready:
    """Validate a start and return the run that begins there."""
    poses, twists = start_of(model, pose0, twist0)
    sizes = {model.label("pose0", link): (array, 2) for link, array in (poses or {}).items()}
    sizes |= {model.label("twist0", link): (array, 1) for link, array in twists.items()}
    count = model.batch_size(**sizes) or 1
    plan = model.plan(options.formulation, **options.plan_fields(model))
    timing = options.timing
    clock = None if timing.is_adaptive else timing.clock()
    known = continuing(pose0, model, plan, twist0, timing.t0)
    if known is not None and clock is not None:
        clock = known.clock_of(clock)
    starts = {}
    for field, link in zip(model.fields, model.link_names, strict=True):
        starts[f"{field}twist"] = twists[link]
        if poses is not None:
            starts[f"{field}pose"] = poses[link]
    state = None if known is None else known.state_of(model, plan, timing.dt)
    inputs = Inputs(model, system_of(plan).inputs, starts, count, timing.t0, state)
    given = options.trajectories
    numbers = None if given is None else checked_numbers(given, count)
    if timing.is_of_lanes:
        all_numbers = np.arange(count, dtype=np.float64) if numbers is None else numbers
        of_lanes = timing.lane_time(clock, model.events, options.seed, all_numbers)
        if known is not None and model.events:
            of_lanes = replace(of_lanes, keeps_sides=known.keeps_sides(model))
        times: StepClock | LaneTime = of_lanes
    else:
        assert clock is not None
        times = clock
    return Ready(
        model, options, plan, inputs, times,
        None if poses is None else model.from_links(poses), model.from_links(twists),
        twist0 is None, numbers, known,
    )  # fmt: skip


def start_of(model: Model, pose0: Any, twist0: Any) -> tuple[ByLink | None, ByLink]:
    """Validate a start; return its poses, None for the closed joint, and its twists."""
    if twist0 is None:
        if continuation_of(pose0) is not None:  # it has a velocity
            raise ArgumentError(
                "pose0 is the end of a run; give its twist0 too (**result.end), or zeros to start "
                "from rest there"
            )
        twist0 = model.from_links({link: np.zeros(6) for link in model.link_names})
    given = model.default_pose() if pose0 is None else pose0
    poses = None if given is None else arrays_of(model, "pose0", given)
    return poses, arrays_of(model, "twist0", twist0)


def arrays_of(model: Model, argument: str, given: Any) -> ByLink:
    """Validate the poses (argument pose0) or twists of all links; return them as arrays."""
    values = model.by_link(argument, given)
    labels = {link: model.label(argument, link) for link in model.link_names}
    if not argument.endswith("pose0"):
        return {k: as_twists(label, values[k], copy=None) for k, label in labels.items()}
    if continuation_of(given) is not None:  # the end of a run, which may have drifted
        return {link: np.asarray(each) for link, each in values.items()}
    return {link: as_poses(label, values[link], copy=None) for link, label in labels.items()}
