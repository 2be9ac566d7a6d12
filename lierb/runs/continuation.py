"""Going on where a run has ended, to the same bits as without a break.

What the user sees of a state has been turned to the user's frames, and rounded on the way: turned
back, it is not the driver's. So the poses at an end remember the driver's own state, and a run that
starts from them, as they are, starts from that.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from lierb.errors import ArgumentError
from lierb.kernels.loops.record import state_columns
from lierb.kernels.stepping.clock import Clock, StepClock
from lierb.kernels.systems.plan import AnyPlan, MechanismPlan, Plan
from lierb.kernels.systems.signals import lane_end, states_of
from lierb.kernels.systems.state import EVENT, OK
from lierb.model.functions.elements import Element
from lierb.model.mechanism.mechanism import Mechanism
from lierb.model.problem import Problem
from lierb.runs.lane_engine import LaneTime
from lierb.runs.output import Output
from lierb.support.arrays import Array

NAMED = 5  # failed trajectories in a message


@dataclass(frozen=True)
class Continuation:
    """The driver's state at the end of a run, and what it belongs to.

    state : `end_columns` of the plan, [column][body].
    twist0 : (n, 6), of a mechanism by link.   t0 : s.   provenance : of the run.
    """

    problem: Problem | Mechanism
    plan: AnyPlan
    twist0: Any
    t0: float
    clock: Clock
    state: Array
    provenance: str

    def fits(self, problem: Problem | Mechanism, plan: AnyPlan, twist0: Any, t0: float) -> bool:
        """Whether a run that starts so goes on from here; other forces may act from now on."""
        is_one = problem is self.problem
        return (
            t0 == self.t0
            and formulation(plan) == formulation(self.plan)
            and _are_equal(twist0, self.twist0)
            and (is_one or _is_held_alike(problem, self.problem))
            and (is_one or _are_controlled_alike(problem, self.problem))
        )

    def clock_of(self, clock: StepClock) -> StepClock:
        """The clock of fixed steps that starts here: with the same steps it counts on."""
        return StepClock(*clock[:4], *self._origin(clock.dt))

    def _origin(self, dt: float) -> tuple[float, int]:
        """s, and number of the first step."""
        before = self.clock
        if isinstance(before, StepClock) and dt == before.dt:
            return before.origin, before.first_step + before.steps
        if isinstance(before, LaneTime) and self.plan.embedded is None:
            span = before.span
            if dt == before.tolerances.dt and self.t0 == span.end:
                return span.origin, round((span.end - span.origin) / dt)
        return counted(self.t0, dt)

    def state_of(self, plan: AnyPlan) -> Array:
        """`end_columns` of the run that goes on, NaN where the one before says nothing of it."""
        before, after = lane_end(self.plan), lane_end(plan)
        has_its_rows = plan.rows == self.plan.rows
        if after.fields == before.fields and has_its_rows:
            return self.state
        own = len(state_columns(plan))
        found = np.full((own + after.count, self.state.shape[1]), np.nan)
        found[:own] = self.state[:own]
        for field, part in after:
            if field in before.fields and (has_its_rows or field.name != "dropped"):
                found[own:][part] = self.state[own:][before[field.name]]
        return found

    @property
    def own(self) -> list[str]:
        """Names of the user's states, and of what controllers put out."""
        return [column.name for column in self.problem.signals]


def continuing(
    pose0: Any, problem: Problem | Mechanism, plan: AnyPlan, twist0: Any, t0: float
) -> Continuation | None:
    """What the run goes on from, if it does.

    Raises ArgumentError where states or what controllers remember would be lost on the way.
    """
    known = continuation_of(pose0)
    if known is None or known.fits(problem, plan, twist0, t0):
        return known
    if known.own and problem.signals:
        raise ArgumentError(
            f"pose0 is the end of a run that had {', '.join(known.own)} beside the motion, which "
            "go on with result.end as it is alone: with its twist0 and t0, the same c-space, "
            "states, and controllers of the same outputs, memory and periods; to start them anew, "
            "give a copy of pose0, and initial values to the elements that have them"
        )
    return None


def counted(t0: float, dt: float) -> tuple[float, int]:
    """Origin, s, and number of the first step: from 0 on, where t0 is so many steps to the bit."""
    steps = round(t0 / dt)
    return (0.0, steps) if steps * dt == t0 else (t0, 0)


def formulation(plan: AnyPlan) -> tuple[Any, ...]:
    """What a state's numbers mean."""
    if isinstance(plan, MechanismPlan):
        held = plan.tree, plan.connections[: len(plan.joints)], plan.update, plan.stabilisation
        return *held, states_of(plan)
    assert isinstance(plan, Plan)
    return plan.cspace, plan.update, plan.solver, states_of(plan)


def _are_equal(a: Any, b: Any) -> bool:
    if isinstance(b, dict):
        return a is b or (
            isinstance(a, dict) and a.keys() == b.keys() and all(_are_equal(a[k], b[k]) for k in b)
        )
    return a is b or np.array_equal(a, b)


def _is_held_alike(a: Problem | Mechanism, b: Problem | Mechanism) -> bool:
    """Whether bodies, joints and what else holds them have the same numbers and functions."""
    holding = [[e for e in problem.elements if e.kind.rows] for problem in (a, b)]
    return (
        _held(a) == _held(b)
        and all(np.array_equal(array, b.quantities[name]) for name, array in _held_by(a).items())
        and len(holding[0]) == len(holding[1])
        and all(map(_is_same, *holding))
    )


def _held(problem: Problem | Mechanism) -> list[Any]:
    """Names and rows of what has a joint, and what it hangs on."""
    if isinstance(problem, Problem):
        return [problem.joint.rows]
    return [(c.name, c.body, c.parent, c.rows) for c in problem.joints]


def _held_by(problem: Problem | Mechanism) -> dict[str, Any]:
    """Numbers of bodies and joints."""
    return {
        name: array
        for name, array in problem.quantities.items()
        if name != "gravity" and not name.startswith("element")
    }


def _is_same(a: Element, b: Element) -> bool:
    return (
        a.kind == b.kind
        and a.at == b.at
        and all(np.array_equal(values, b.parameters[name]) for name, values in a.parameters.items())
    )


def _are_controlled_alike(a: Problem | Mechanism, b: Problem | Mechanism) -> bool:
    """Whether what controllers hold and remember means the same: outputs, memory and periods; of
    none there is nothing to mean.
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
    """Poses at the end of a run, (n, 4, 4), read-only; what is made of them are plain arrays."""

    continuation: Continuation | None = None  # of what the class makes of itself: a copy has none

    def __getitem__(self, key: Any) -> Any:
        return np.asarray(self)[key]

    def __array_wrap__(self, array: Any, context: Any = None, return_scalar: bool = False) -> Any:
        return array[()] if return_scalar else np.asarray(array)

    def __reduce__(self) -> Any:
        return np.asarray(self).__reduce__()


class EndPoses(dict[str, Array]):
    """Poses of all links at the end of a run, by name; a copy is a plain dictionary."""

    def __init__(self, poses: dict[str, Array]) -> None:
        super().__init__(poses)
        self._poses = dict(poses)
        self._continuation: Continuation | None = None

    @property
    def continuation(self) -> Continuation | None:
        """None as soon as one of the poses is another."""
        kept = self._poses
        is_whole = self.keys() == kept.keys() and all(self[name] is kept[name] for name in kept)
        return self._continuation if is_whole else None

    @continuation.setter
    def continuation(self, given: Continuation) -> None:
        self._continuation = given

    def copy(self) -> dict[str, Array]:
        return dict(self)

    def __reduce__(self) -> Any:
        return dict, (dict(self),)


def continuation_of(pose0: Any) -> Continuation | None:
    """What poses remember of the run at whose end they are, if they do."""
    return pose0.continuation if isinstance(pose0, (EndPose, EndPoses)) else None


@dataclass(frozen=True)
class End:
    """The end of a run, from which it can go on.

    statuses : names of the statuses, by their codes.   provenance : of the run.
    """

    problem: Problem | Mechanism
    plan: AnyPlan
    output: Output
    statuses: dict[int, str]
    provenance: str

    def keywords(self) -> dict[str, Any]:
        """pose0, twist0 and t0. Raises ArgumentError where a trajectory has failed."""
        self._require_all()
        clock, t = self.output.clock, self._time()
        states = [self._state(link) for link in range(self.output.links)]
        twists: Any = states[0][1]
        poses: Any = states[0][0].view(EndPose)
        if isinstance(self.problem, Mechanism):
            pairs = dict(zip(self.problem.names, states, strict=True))
            twists = {name: twist for name, (_, twist) in pairs.items()}
            poses = EndPoses({name: pose for name, (pose, _) in pairs.items()})
        poses.continuation = Continuation(
            self.problem, self.plan, twists, t, clock, self.output.ends, self.provenance
        )
        return {"pose0": poses, "twist0": twists, "t0": t}

    def _time(self) -> float:
        """At which all of them end, s."""
        first, last = float(self.output.t.min()), float(self.output.t.max())
        if first != last:
            raise ArgumentError(
                f"result.end: trajectories ended at times from {first!r} to {last!r} s, by events; "
                "go on with one of them at a time, from its row of result.events"
            )
        return first

    def _state(self, link: int) -> tuple[Array, Array]:
        """Poses and twists of one link."""
        r, place, omega, v = self.output.state_of(link)
        poses = np.zeros((len(r), 4, 4))
        poses[:, :3, :3] = r.reshape(-1, 3, 3)
        poses[:, :3, 3] = place
        poses[:, 3, 3] = 1.0
        twists = np.concatenate([omega, v], axis=1)
        for array in (poses, twists):
            array.setflags(write=False)
        return poses, twists

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
            f"result.end: {failed.size} of {len(self.output.status)} trajectories failed and have "
            f"no end to go on from: {named}{more}; leave them out of the batch, or find what made "
            "them fail (summary, columns status and t) and run again, often with a smaller dt"
        )
