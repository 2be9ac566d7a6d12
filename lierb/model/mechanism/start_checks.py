"""Checks of the start of a run: poses and twists against the rows of all joints."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from lierb.errors import (
    ArgumentError,
    LierbError,
    PoseError,
    TwistError,
    beyond_numbers,
    body_label,
)
from lierb.kernels.groups import so3
from lierb.kernels.mechanics.constraints import squares_by_kind
from lierb.kernels.mechanics.newton_euler import SE3
from lierb.kernels.mechanics.rows import Rows
from lierb.kernels.mechanics.scale import ROUNDING, START_TOLERANCE, length_of, rounding_of
from lierb.kernels.numbers.arithmetic import absolute, plain, sqrt
from lierb.kernels.numbers.vec import Vec, cross_add, norm, sub
from lierb.model.base import Model
from lierb.model.mechanism.closing import closed, mobility, unfit_positions
from lierb.model.mechanism.kinematics import TreeKinematics
from lierb.model.mechanism.residuals import misfit_of
from lierb.model.mechanism.row_system import (
    ConnectionState,
    System,
    errors_of,
    name_of,
    one_of,
    reversed_joint,
    wrong_way,
)
from lierb.model.unfit import unfit_constraint, unfit_rate
from lierb.support.arrays import Array, as_poses, components, first_bad, items_at, pose_components

EVEN_SO = '(check="warn" integrates from it anyway, but not on "reduced")'


class Start(NamedTuple):
    """Joints of a model at the start, with their names in messages.

    speed : m/s, scale of the tolerances of velocities.   time : s.   total : size of the batch.
    only : index of the only member that is checked; None for all.
    turned : text on what to turn if a joint is half a turn off.   closing : text on the effect of
    `close` on a member.   is_default : True if the twist is rest, by default.
    projecting : text on the effect of `project`.
    misfit : bound of the rates of redundant rows, relative to the speed; see `misfit_of`.
    """

    joints: list[tuple[str, ConnectionState]]
    speed: Any
    time: float
    total: int
    only: int | None
    turned: str
    closing: Callable[[int], str]
    is_default: bool
    projecting: str
    misfit: Any = 0.0

    @property
    def size(self) -> int:
        """Number of members that are checked."""
        return self.total if self.only is None else 1

    def label(self, argument: str, member: int) -> str:
        return body_label(argument, member if self.only is None else self.only, self.total)


def start_of_body(
    model: Model, poses: Array, twists: Array | None, t0: float, number: int | None
) -> Start:
    """Return the joint of bodies at valid poses and twists.

    twists : None for rest, the default.   number : index of the only body to check, or None.
    """
    is_default = twists is None
    twists = np.zeros(6) if twists is None else twists
    count = model.batch_size(pose0=(poses, 2), twist0=(twists, 1)) or 1
    if number is not None:
        model = model.of_body(number) if model.batch_size() else model
        poses, twists = items_at(poses, number, 2), items_at(twists, number, 1)
    (at,), ((_, rows),) = model.joints, model.rows_by_name
    assert at.joint is not None
    p, body, pose, twist = (
        model.parameters(at), model.constants(at), pose_components(poses), components(twists),
    )  # fmt: skip
    x = SE3.kinematics(body, *SE3.to_joint_axes(p, pose, twist))._replace(time=np.float64(t0))
    state = ConnectionState(at._replace(rows=rows), p, body, x, length_of(p), rounding_of(p, pose))
    added = [element.name for element in model.elements if element.kind.rows]
    closing = (
        f"problem.close(pose0{_at_time(rows, t0)}) finds a pose near by that does"
        if any(r.is_holonomic and not r.is_of_joint for r in rows)
        else "leave pose0 out for the closed joint, or give the joint frames that it closes"
    )
    return Start(
        joints=[(" with ".join((f"the {at.joint.name} joint", *added)), state)],
        speed=speed_of(twist, p.com, state.length),
        time=t0,
        total=count,
        only=number,
        turned="pose0",
        closing=lambda member: closing,
        is_default=is_default,
        projecting=_projecting("problem", "np.zeros(6)", "the joint allows", rows, t0, is_default),
    )


def start_of_mechanism(mechanism: TreeKinematics, pose: Any, twist: Any, t0: float) -> Start:
    """Return all joints, loops and constraints at valid poses and twists, arrays by link.

    The speed is the sum of the links' speeds: at a dead point the links of a joint may be at rest,
    except for the rounding of the other links' speed.   twist : None for rest, the default.
    """
    is_default = twist is None
    twist = dict.fromkeys(mechanism.names, np.zeros(6)) if twist is None else twist
    placed = [_side_by_side(pose_components(np.asarray(pose[name]))) for name in mechanism.names]
    moving = [_side_by_side(components(np.asarray(twist[name]))) for name in mechanism.names]
    sizes = {f"pose0[{n!r}]": placed[i][1][0] for i, n in enumerate(mechanism.names)}
    sizes |= {f"twist0[{n!r}]": moving[i][0] for i, n in enumerate(mechanism.names)}
    count = mechanism.batch_size(**sizes) or 1
    system = System(mechanism, count)
    joints = [(name_of(mechanism, h.at), h) for h in system.states(placed, moving, np.float64(t0))]
    speed: Any = 0.0
    for velocity, metric, length in zip(moving, system.metrics, system.lengths, strict=True):
        speed = speed + speed_of(velocity, metric.com, length)

    rows = tuple(r for _, h in joints for r in h.at.rows)

    def closing(member: int) -> str:
        return _effect_of_closing(mechanism, pose, member, rows, t0)

    rest = "mechanism.twist({})"
    projecting = _projecting("mechanism", rest, "all joints allow", rows, t0, is_default)
    misfit = misfit_of(count, [h for _, h in joints])
    return Start(joints, speed, t0, count, None, "a link", closing, is_default, projecting, misfit)


def _projecting(
    model: str, rest: str, allowed: str, rows: Rows, t0: float, is_default: bool
) -> str:
    """Text on the effect of `project`.   is_default : True if the twist is rest, by default."""
    arguments = f"{rest if is_default else 'twist0'}, pose0{_at_time(rows, t0)}"
    call = f"{'twist0=' * is_default}{model}.project({arguments})"
    return f"{call} is the nearest twist that {allowed}"


def _side_by_side(parts: Any) -> Any:
    """Return nested tuples of arrays, each contiguous, which are used many times."""
    return tuple(
        _side_by_side(x) if isinstance(x, tuple) else np.ascontiguousarray(x)[()] for x in parts
    )


def _at_time(rows: Rows, t0: float) -> str:
    """Argument t0 in a call that a message advises, if the rows depend on time."""
    return f", t0={t0:g}" if t0 != 0.0 and any(r.depends_on_time for r in rows) else ""


def speed_of(twist: Vec, com: Vec, length: Any) -> Any:
    """‖v‖ + ℓ‖ω‖ of a body, m/s, with v of its centre of mass."""
    return norm(cross_add(twist[:3], com, twist[3:])) + length * norm(twist[:3])


def violation_of(start: Start) -> LierbError | None:
    """Return the error of the first violated joint, or None."""
    for find in (_pose_violation, _twist_violation):
        for name, h in start.joints:
            if error := find(start, name, h):
                return error
    return None


def _pose_violation(start: Start, name: str, h: ConnectionState) -> PoseError | None:
    if unfit := unfit_positions([h], start.time):
        return unfit
    pose = partial(start.label, "pose0")
    where = name[name.find(" (") :] if h.at.name else ""  # " (rod to ground)"
    if unfit := unfit_constraint(h.at.rows, h.x, h.body, pose, where=where):
        return unfit
    for member in wrong_way(h, start.size)[:1].tolist():
        return PoseError(reversed_joint(pose(member), name, start.turned))
    tolerances = START_TOLERANCE * h.length + h.rounding, START_TOLERANCE
    for (what, unit, size), allowed in zip(errors_of(h), tolerances, strict=True):
        for member in _beyond(size, allowed, start.size):
            label = pose(member)
            error, most = one_of(size, member), one_of(allowed, member)
            if not max(error, most) < np.inf:
                return PoseError(beyond_numbers(label, f"{what} error"))
            values = [
                f"{r} = {one_of(r.value(h.x, h.body), member):.3g}"
                for r in h.at.rows
                if r.has_value and r.error_kind == what
            ]
            detail = f" ({', '.join(values)})" if values else ""
            return PoseError(
                f"{label} does not close {name}: {what} error {error:.3g}{unit} > "
                f"{most:.3g}{unit}{detail}; {start.closing(member)} {EVEN_SO}"
            )
    return None


def _twist_violation(start: Start, name: str, h: ConnectionState) -> TwistError | None:
    rates = [r.prescribed_rate(h.x, h.body) for r in h.at.rows]
    if unfit := unfit_rate(h.at.rows, rates, start.time):
        return unfit
    off = [h.rate(r) - rate for r, rate in zip(h.at.rows, rates, strict=True)]
    sizes = map(sqrt, map(plain, squares_by_kind(h.at.rows, off)))
    for what, unit, size, allowed in zip(
        ("velocity", "rotation rate"), ("m/s", "rad/s"), sizes, _rate_tolerances(h, start),
        strict=True,
    ):  # fmt: skip
        for member in _beyond(size, allowed, start.size):
            label = start.label("twist0", member) + " (rest, by default)" * start.is_default
            error, most = one_of(size, member), one_of(allowed, member)
            if not max(error, most) < np.inf:
                return TwistError(beyond_numbers(label, what))
            residuals = ", ".join(
                f"{r}: {one_of(error, member):.3g}"
                for r, error in zip(h.at.rows, off, strict=True)
                if r.is_translational == (what == "velocity")
            )
            return TwistError(
                f"{label} violates {name}: {what} {error:.3g} {unit} > {most:.3g} {unit} "
                f"({residuals}); {start.projecting} {EVEN_SO}"
            )
    return None


def _beyond(size: Any, allowed: Any, count: int) -> list[int]:
    """Return the index of the first member whose error exceeds its tolerance or is NaN."""
    is_fine = np.broadcast_to((size <= allowed) & (allowed < np.inf), (count,))
    indices: list[int] = np.flatnonzero(~is_fine)[:1].tolist()
    return indices


def _rate_tolerances(h: ConnectionState, start: Start) -> tuple[Any, Any]:
    """Tolerances, m/s and rad/s, relative to speed and to the effect of forces in ℓ/speed."""
    relative = START_TOLERANCE + start.misfit
    ahead = sqrt(norm(h.parameters.gravity) / h.length)
    for r in h.at.rows:
        if r.depends_on_time:
            ahead = ahead + sqrt(absolute(plain(r.acceleration(h.x, h.body))))
    brought = ROUNDING * ahead
    return (
        (relative + h.rounding / h.length) * start.speed + h.length * brought,
        relative * start.speed / h.length + brought,
    )


def _effect_of_closing(
    mechanism: TreeKinematics, pose: Any, member: int, rows: Rows, t0: float
) -> str:
    """Describe how far `close` would move the links of one member."""
    call = f"mechanism.close(pose0{_at_time(rows, t0)})"
    own = {name: items_at(as_poses("pose0", pose[name]), member, 2) for name in mechanism.names}
    alone = mechanism.of_body(member) if mechanism.batch_size() else mechanism
    try:
        near = closed(alone, list(own.values()), t0)
    except LierbError as error:
        return f"{call} does not help: {error}"
    far, turned = 0.0, 0.0
    for before, after in zip(own.values(), near, strict=True):
        (q, d), (r, e) = pose_components(before), pose_components(after)
        far = max(far, float(norm(sub(e, d))))
        turned = max(turned, float(norm(so3.log(so3.compose(so3.inverse(q), r)))))
    return f"{call} closes it, and moves links by up to {far:.3g} m and {turned:.3g} rad"


def immobile(mechanism: TreeKinematics, pose: Any) -> ArgumentError | None:
    """Return an error if loops and constraints leave no degree of freedom, or None."""
    added = (r for at in mechanism.places for r in at.rows)
    if all(r.depends_on_time for r in added) and not mechanism.loops:
        return None
    poses = [pose[name] for name in mechanism.names]
    free, redundant = map(np.atleast_1d, mobility(mechanism, poses))
    for number, label in first_bad("pose0", free == 0):
        return ArgumentError(
            f"{label}: the mechanism cannot move, its joints and loops leave no freedom "
            f"({int(redundant[number])} of their rows are redundant); take joints with more "
            "freedoms, such as spherical or universal, or leave a loop out"
        )
    return None
