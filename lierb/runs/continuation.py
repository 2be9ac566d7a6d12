"""Continuation of a run from the end of another, bit for bit as one uninterrupted run.

Conversion to the user's frames rounds the state of the kernels. The pose objects at a run's end
therefore carry the kernels' state, and a run that starts from these objects starts from that state.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from lierb.errors import ArgumentError
from lierb.kernels.loops.ends import state_columns
from lierb.kernels.stepping.clock import Clock, StepClock
from lierb.kernels.systems.plan import AnyPlan, MechanismPlan, Plan
from lierb.kernels.systems.signals import lane_end, states_of
from lierb.kernels.systems.state import EVENT, OK
from lierb.model.base import Model
from lierb.model.functions.elements import Element
from lierb.runs.lane_engine import LaneTime
from lierb.runs.output import Output
from lierb.support.arrays import Array, components, pose_matrix

NAMED = 5  # most failed trajectories listed in a message


class EndDerivatives(NamedTuple):
    """Derivatives of the state of the kernels at the end of a run.

    directions : those of each parameter, by name.
    parts : at a fixed time, [`end_columns`][direction][trajectory].
    times : of the end times, s, [direction][trajectory]; zero but for ends by events.
    """

    directions: dict[str, slice]
    parts: Array
    times: Array

    def move_end(self, name: str) -> bool:
        """Return True if an event ends a trajectory at a time that depends on a parameter."""
        return bool(self.times[self.directions[name]].any())


@dataclass(frozen=True)
class Continuation:
    """State of the kernels at the end of a run.

    model, plan, clock, provenance : of the run that has ended.
    twist0 : twists at the end, (n, 6); for a mechanism by link.   t0 : time of the end, s.
    state : `end_columns` of the plan, [column][body].
    derivatives : None for a run without derivatives.
    """

    model: Model
    plan: AnyPlan
    twist0: Any
    t0: float
    clock: Clock
    state: Array
    provenance: str
    derivatives: EndDerivatives | None

    def fits(self, model: Model, plan: AnyPlan, twist0: Any, t0: float) -> bool:
        """Return True if a run with this start continues from here; its forces may differ."""
        is_one = model is self.model
        return (
            t0 == self.t0
            and formulation(plan) == formulation(self.plan)
            and _are_equal(twist0, self.twist0)
            and (is_one or _have_equal_joints(model, self.model))
            and (is_one or _have_equal_controllers(model, self.model))
        )

    def keeps_sides(self, model: Model) -> bool:
        """Return True if events of a model begin on the sides that they had at the end."""
        is_one = model is self.model
        return is_one or (self.has_forces_of(model) and _are_same(model.events, self.model.events))

    def has_forces_of(self, model: Model) -> bool:
        """Return True if a model has the forces of the run that has ended."""
        return model is self.model or _have_equal_forces(model, self.model)

    def clock_of(self, clock: StepClock) -> StepClock:
        """Return the clock of fixed steps from here; equal steps continue the count."""
        return StepClock(*clock[:4], *self._origin(clock.dt))

    def _origin(self, dt: float) -> tuple[float, int]:
        """Return the time origin, s, and the number of the first step."""
        before = self.clock
        if isinstance(before, StepClock) and dt == before.dt:
            return before.origin, before.first_step + before.steps
        if isinstance(before, LaneTime) and not self.plan.is_adaptive:
            span = before.span
            if dt == before.tolerances.dt and self.t0 == span.end:
                return span.origin, round((span.end - span.origin) / dt)
        return counted(self.t0, dt)

    def state_of(self, model: Model, plan: AnyPlan, dt: float) -> Array:
        """Return the state that a new run of a model, with a step dt, s, continues from."""
        return self._columns_of(model, plan, dt, self.state)

    def parts_of(self, model: Model, plan: AnyPlan, dt: float, names: Iterable[str]) -> Array:
        """Return the derivatives of `state_of` by some parameters, [column][direction][body]."""
        assert self.derivatives is not None
        known, parts, _ = self.derivatives
        own = [parts[:, known[name]] for name in names]
        return self._columns_of(model, plan, dt, np.concatenate(own, axis=1))

    def _columns_of(self, model: Model, plan: AnyPlan, dt: float, columns: Array) -> Array:
        """Return `end_columns` of another plan from those of this one; NaN for those it lacks.

        What the method carries goes on with the same method, step dt, s, and forces alone.
        """
        before, after = lane_end(self.plan), lane_end(plan)
        has_its_rows = plan.rows == self.plan.rows
        known, own = len(state_columns(self.plan)), len(state_columns(plan))
        carried = plan.carried
        goes_on = plan.method == self.plan.method and has_its_rows and dt == self._dt
        if carried:
            goes_on = goes_on and self.has_forces_of(model)
        is_whole = known == own and (goes_on or not carried)
        if after.fields == before.fields and has_its_rows and is_whole:
            return columns
        content = np.full((own + after.count, *columns.shape[1:]), np.nan)
        shared = own if goes_on else own - carried
        content[:shared] = columns[:shared]
        for field, part in after:
            if field in before.fields and (has_its_rows or field.name != "dropped"):
                content[own:][part] = columns[known:][before[field.name]]
        return content

    @property
    def _dt(self) -> float:
        """Step of the run that has ended, s; the first one if steps are adaptive."""
        if isinstance(self.clock, LaneTime):
            return self.clock.tolerances.dt
        assert isinstance(self.clock, StepClock)
        return self.clock.dt


def continuing(
    pose0: Any, model: Model, plan: AnyPlan, twist0: Any, t0: float
) -> Continuation | None:
    """Return the end that a run continues from; None for any other run.

    Raises ArgumentError if extra states or controllers' memory would be lost.
    """
    known = continuation_of(pose0)
    if known is None or known.fits(model, plan, twist0, t0):
        return known
    own = ", ".join(column.name for column in known.model.signals)
    if own and model.signals:
        raise ArgumentError(
            f"pose0 is the end of a run that had {own} beside the motion, which "
            "go on with result.end as it is alone: with its twist0 and t0, the same c-space, "
            "states, and controllers of the same outputs, memory and periods; to start them anew, "
            "give a copy of pose0, and initial values to the elements that have them"
        )
    return None


def counted(t0: float, dt: float) -> tuple[float, int]:
    """Return the time origin, s, and the first step's number, counted from 0 s if t0 = k·dt."""
    steps = round(t0 / dt)
    return (0.0, steps) if steps * dt == t0 else (t0, 0)


def formulation(plan: AnyPlan) -> tuple[Any, ...]:
    """Return the fields of a plan that determine the meaning of the state columns."""
    if isinstance(plan, MechanismPlan):
        joints = plan.connections[: len(plan.joints)]
        return plan.tree, joints, plan.update, plan.stabilisation, states_of(plan)
    assert isinstance(plan, Plan)
    return plan.cspace, plan.update, plan.solver, states_of(plan)


def _are_equal(a: Any, b: Any) -> bool:
    if isinstance(b, dict):
        return a is b or (
            isinstance(a, dict) and a.keys() == b.keys() and all(_are_equal(a[k], b[k]) for k in b)
        )
    return a is b or np.array_equal(a, b)


def _have_equal_joints(a: Model, b: Model) -> bool:
    """Return True if bodies, joints and constraints have equal numbers and functions."""
    constraints = [[e for e in model.elements if e.kind.rows] for model in (a, b)]
    return (
        a.topology == b.topology
        and all(
            np.array_equal(array, b.quantities[name])
            for name, array in a.quantities.items()
            if name != "gravity"
        )
        and _are_same(*constraints)
    )


def _have_equal_forces(a: Model, b: Model) -> bool:
    """Return True if gravity and all elements that may act are equal."""
    passive = {id(element) for m in (a, b) for element in (*m.events, *m.observables)}
    acting = [[e for e in m.elements if id(e) not in passive] for m in (a, b)]
    return np.array_equal(a.gravity, b.gravity) and _are_same(*acting)


def _are_same(a: Sequence[Element], b: Sequence[Element]) -> bool:
    return len(a) == len(b) and all(map(_is_same, a, b))


def _is_same(a: Element, b: Element) -> bool:
    return (
        a.kind == b.kind
        and a.at == b.at
        and all(np.array_equal(values, b.parameters[name]) for name, values in a.parameters.items())
    )


def _have_equal_controllers(a: Model, b: Model) -> bool:
    """Return True if the controllers have the same outputs, memory and periods.

    Also True if one of the models has no controllers.
    """
    if not (a.controllers and b.controllers):
        return True
    pairs = zip(a.controllers, b.controllers, strict=False)
    return len(a.controllers) == len(b.controllers) and all(
        (x.kind.outputs, x.kind.memory) == (y.kind.outputs, y.kind.memory)
        and np.array_equal(x.parameters["every"], y.parameters["every"])
        for x, y in pairs
    )


class EndPose(np.ndarray):
    """Poses at the end of a run, (n, 4, 4), read-only. Slices and copies are plain arrays."""

    continuation: Continuation | None = None

    def __getitem__(self, key: Any) -> Any:
        return np.asarray(self)[key]

    def __array_wrap__(self, array: Any, context: Any = None, return_scalar: bool = False) -> Any:
        return array[()] if return_scalar else np.asarray(array)

    def __reduce__(self) -> Any:
        return np.asarray(self).__reduce__()


class EndPoses(dict[str, Array]):
    """Poses of all links at the end of a run, by name. A copy is a plain dictionary."""

    def __init__(self, poses: dict[str, Array]) -> None:
        super().__init__(poses)
        self._poses = dict(poses)
        self._continuation: Continuation | None = None

    @property
    def continuation(self) -> Continuation | None:
        """Continuation of the run; None after a pose has been replaced."""
        own = self._poses
        is_whole = self.keys() == own.keys() and all(self[name] is own[name] for name in own)
        return self._continuation if is_whole else None

    @continuation.setter
    def continuation(self, given: Continuation) -> None:
        self._continuation = given

    def copy(self) -> dict[str, Array]:
        return dict(self)

    def __reduce__(self) -> Any:
        return dict, (dict(self),)


def continuation_of(pose0: Any) -> Continuation | None:
    """Return the continuation that `pose0` carries; None for ordinary poses."""
    return pose0.continuation if isinstance(pose0, (EndPose, EndPoses)) else None


@dataclass(frozen=True)
class End:
    """End of a run, from which another run can continue.

    statuses : status names by code.   derivatives : None for a run without derivatives.
    """

    model: Model
    plan: AnyPlan
    output: Output
    statuses: dict[int, str]
    provenance: str
    derivatives: EndDerivatives | None = None

    def keywords(self) -> dict[str, Any]:
        """Return pose0, twist0 and t0. Raises ArgumentError if a trajectory has failed."""
        self._require_all()
        clock, t = self.output.clock, self._time()
        of_poses, of_twists = {}, {}
        for link, name in enumerate(self.model.link_names):
            rotation, place, omega, v = self.output.state_of(link)
            of_poses[name] = pose_matrix((components(rotation), components(place)))
            of_twists[name] = np.concatenate([omega, v], axis=1)
            for array in (of_poses[name], of_twists[name]):
                array.setflags(write=False)
        poses, twists = self.model.from_links(of_poses), self.model.from_links(of_twists)
        marked: Any = EndPoses(poses) if isinstance(poses, dict) else poses.view(EndPose)
        marked.continuation = Continuation(
            self.model, self.plan, twists, t, clock, self.output.ends, self.provenance,
            self.derivatives,
        )  # fmt: skip
        return {"pose0": marked, "twist0": twists, "t0": t}

    def _time(self) -> float:
        """Return the time at which all trajectories ended, s."""
        first, last = float(self.output.t.min()), float(self.output.t.max())
        if first != last:
            raise ArgumentError(
                f"result.end: trajectories ended at times from {first!r} to {last!r} s, by events; "
                "go on with one of them at a time, from its row of result.events"
            )
        return first

    def _require_all(self) -> None:
        failed = np.flatnonzero((self.output.status != OK) & (self.output.status != EVENT))
        if not failed.size:
            return
        named = ", ".join(
            f"{i} ({self.statuses[int(self.output.status[i])]} at {self.output.t[i]:g} s)"
            for i in failed[:NAMED].tolist()
        )
        more = f" and {failed.size - NAMED} more" if failed.size > NAMED else ""
        raise ArgumentError(
            f"result.end: {failed.size} of {len(self.output.status)} trajectories failed and "
            f"{'has' if failed.size == 1 else 'have'} no end to go on from: {named}{more}; leave "
            "them out of the batch, or find what made them fail (summary, columns status and t) "
            "and run again, often with a smaller dt"
        )
