"""Linear system J V = ḣ of all rows of a mechanism at a pose, V the twists of all links.

`lierb.model.mechanism.decomposition` solves it.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property, reduce
from typing import Any, NamedTuple

import numpy as np

from lierb.kernels.groups import se3
from lierb.kernels.mechanics.constraints import position_error_squared, rotation_error_squared
from lierb.kernels.mechanics.newton_euler import SE3, BodyConstants, Kinematics, Parameters, Pose
from lierb.kernels.mechanics.rows import Row
from lierb.kernels.mechanics.scale import ROUNDING, bearings, length_of, rounding_of
from lierb.kernels.numbers.arithmetic import maximum, plain, sqrt
from lierb.kernels.numbers.vec import Vec, add, cross, cross_add, mat_vec, neg, norm, sub
from lierb.model.connections import Connection
from lierb.model.mechanism.decomposition import DecomposedRows, Metric
from lierb.model.mechanism.kinematics import TreeKinematics
from lierb.support.arrays import Array, assembled

NEWTON_STEPS = 50  # starts that converge do so quadratically, in 4 to 6 steps
CLOSED = 1e-13  # rad, or relative to the problem's length: residual due to rounding
LEAST_GYRATION = 0.03  # least radius of gyration of a link in `close`, relative to its length


class ConnectionState(NamedTuple):
    """Connection at a pose and twist of its links.

    length : the larger characteristic length of its two links, m.
    rounding : rounding of the distance between points that coincide, m.
    second : state of the second joint, for rows that couple two.
    """

    at: Connection
    parameters: Parameters
    body: BodyConstants
    x: Kinematics
    length: Any
    rounding: Any
    second: ConnectionState | None = None

    def parts(self, row: Row) -> Iterator[tuple[ConnectionState, Any]]:
        """Yield the joints that a row depends on, each with its part of the row."""
        yield self, row
        if row.second is not None:
            assert self.second is not None
            yield self.second, row.second

    def rate(self, row: Row) -> Any:
        """J V of a row."""
        total: Any = 0.0
        for s, part in self.parts(row):
            for a, b in zip(part.jacobian(s.x, s.body), velocity_of(s.x), strict=True):
                total = total + a * b
        return total


# Connection, its parameters and constants, and its length, which do not depend on poses
Described = tuple[Any, Parameters, BodyConstants, Any]


class System:
    """Rows of a mechanism, for all members of its batch at once."""

    def __init__(self, mechanism: TreeKinematics, count: int, is_stout: bool = False) -> None:
        """is_stout : True to enlarge the inertia of links that are small relative to their arms."""
        self.mechanism, self.count = mechanism, count
        of_links = [mechanism.parameters(at) for at in mechanism.joints[: len(mechanism.links)]]
        self.lengths = [length_of(p) for p in of_links]
        self.length = reduce(maximum, self.lengths)
        total: Any = 0.0
        for p in of_links:
            total = total + p.mass
        unit = total * self.length**2
        self.metrics = [
            Metric(p, unit, p.mass * (LEAST_GYRATION * length) ** 2 if is_stout else 0.0)
            for p, length in zip(of_links, self.lengths, strict=True)
        ]

    @cached_property
    def connections(self) -> list[Described]:
        """Connections with data that do not depend on poses."""
        return [self._described(at) for at in self.mechanism.connections]

    @cached_property
    def seconds(self) -> dict[int, Described]:
        """Second joint of each connection that couples two, by the connection's index."""
        joints = self.mechanism.joints
        return {
            i: self._described(joints[at.second]._replace(elements=at.elements))
            for i, at in enumerate(self.mechanism.connections)
            if at.second >= 0
        }

    def _described(self, at: Connection) -> Described:
        mechanism, p = self.mechanism, self.mechanism.parameters(at)
        length = self.lengths[at.body] if at.joint is None else length_of(p)
        if at.parent >= 0:
            other = mechanism.parameters(mechanism.joints[at.parent])
            if at.joint is not None:  # the arm from the parent's centre of mass to this joint
                other = other._replace(body=p.ground)
            length = maximum(length, length_of(other))
        return at, p, mechanism.constants(at), length

    def states(
        self, poses: list[Pose], twists: list[Vec] | None = None, t0: Any = 0.0
    ) -> list[ConnectionState]:
        """Return all connections at these poses and twists."""

        def state(at: Connection, p: Parameters, body: BodyConstants, length: Any) -> Any:
            x = self.kinematics(at, body, poses, twists)._replace(time=t0)
            rounding = rounding_of(p, poses[at.body])
            if at.parent >= 0:
                rounding = rounding + ROUNDING * norm(poses[at.parent][1])
            return ConnectionState(at, p, body, x, length, rounding)

        states = [state(*described) for described in self.connections]
        for i, described in self.seconds.items():
            states[i] = states[i]._replace(second=state(*described))
        return states

    def kinematics(
        self, at: Connection, body: BodyConstants, poses: list[Pose], twists: list[Vec] | None
    ) -> Kinematics:
        """Return the relative motion of a connection's two frames; at rest without twists."""
        relative = self.mechanism.relative(at, poses)
        moving: Vec = (0.0,) * 6
        if twists is not None:
            moving = self.mechanism.relative_twist(at, relative, twists)
        return SE3.kinematics(body, relative, moving)

    def wrenches(self, at: Connection, p: Parameters, x: Kinematics, row: Vec) -> dict[int, Vec]:
        """Return a connection's row as wrenches on its links, about their centres of mass."""
        wrenches = {at.body: _moved(p.body, row)}
        if at.parent >= 0:
            in_parent = se3.compose(p.ground, (x.q, x.d))  # the body's joint frame
            wrenches[at.parent] = neg(_moved(in_parent, row))
        return {
            link: sub(wrench[:3], cross(self.metrics[link].com, wrench[3:])) + wrench[3:]
            for link, wrench in wrenches.items()
        }

    def decomposed(self, states: list[ConnectionState]) -> DecomposedRows:
        """Return the decomposition of all rows of these connections."""
        total = sum(len(s.at.rows) for s in states)
        matrix = np.zeros((self.count, total, 6 * len(self.metrics)))
        levers = np.zeros(self.count)
        number = 0
        for s in states:
            for r in s.at.rows:
                for link, wrench in self._wrenches_of(s, r).items():
                    matrix[:, number, 6 * link : 6 * link + 6] = assembled(wrench)
                    if r.is_translational:
                        with np.errstate(all="ignore"):  # no force, no lever
                            lever = np.divide(plain(norm(wrench[:3])), plain(norm(wrench[3:])))
                        levers = np.fmax(levers, np.where(np.isfinite(lever), lever, 0.0))
                number += 1
        matrix[~np.isfinite(matrix).all(axis=(1, 2))] = 0.0  # no step: the member does not converge
        lever = np.where(levers > 0.0, levers, 1.0)
        for link in range(len(self.metrics)):
            matrix[:, :, 6 * link + 3 : 6 * link + 6] *= lever[:, None, None]
        return DecomposedRows(self.metrics, matrix, lever)

    def _wrenches_of(self, s: ConnectionState, r: Row) -> dict[int, Vec]:
        """Return a row as wrenches on all links that it depends on."""
        total: dict[int, Vec] = {}
        for each, part in s.parts(r):
            row = part.jacobian(each.x, each.body)
            for link, wrench in self.wrenches(each.at, each.parameters, each.x, row).items():
                total[link] = add(total[link], wrench) if link in total else wrench
        return total

    def column(self, numbers: list[Any]) -> Array:
        """Return numbers of all rows as an array, (count, rows)."""
        column = np.empty((self.count, len(numbers)))
        for i, number in enumerate(numbers):
            column[:, i] = plain(number)
        return column


def _moved(frame: Pose, wrench: Vec) -> Vec:
    """Transform a wrench from a frame to the outer frame."""
    force = mat_vec(frame[0], wrench[3:])
    return cross_add(frame[1], force, mat_vec(frame[0], wrench[:3])) + force


# ---- residuals and messages --------------------------------------------------------------------


def wrong_way(s: ConnectionState, count: int) -> Any:
    """Return the indices of members whose joint is half a turn off; rows vanish there, too."""
    against = np.zeros(count, dtype=bool)
    for bearing in bearings(s.at.rows, s.x.q):
        against |= np.broadcast_to(bearing <= 0.0, (count,))
    return np.flatnonzero(against)


def reversed_joint(label: str, name: str, turned: str = "a link") -> str:
    """Message for a joint that is half a turn off.   turned : what can be turned."""
    return (
        f"{label} holds {name} the wrong way round, half a turn off, where its rows are zero too; "
        f"turn {turned} or one of the joint's frames by 180°"
    )


def name_of(mechanism: TreeKinematics, at: Connection) -> str:
    """Name of a connection in messages."""
    ends = ends_of(mechanism, at)
    if at.second >= 0:
        (element,) = at.elements
        return f"{at.name} ({' and '.join(mechanism.elements[element].at)})"
    if at.joint is None or at.elements:
        return f"{at.name} ({ends})"
    what = "joint of" if at.name == mechanism.names[at.body] else "loop"
    return f"the {what} {at.name} ({at.joint.name}, {ends})"


def ends_of(mechanism: TreeKinematics, at: Connection) -> str:
    """Names of the two links of a connection in messages."""
    return " to ".join(mechanism.names[i] if i >= 0 else "ground" for i in (at.body, at.parent))


def is_fixed(mechanism: TreeKinematics, at: Connection) -> bool:
    """Return whether a connection is the fixed joint between a link and its parent."""
    is_rigid = at.joint is not None and at.joint.name == "fixed"
    return is_rigid and not at.elements and at.name == mechanism.names[at.body]


def errors_of(s: ConnectionState) -> tuple[tuple[str, str, Any], tuple[str, str, Any]]:
    """Kind, unit and magnitude of the position error and of the rotation error."""
    rows = s.at.rows
    return (
        ("position", " m", sqrt(plain(position_error_squared(rows, s.x, s.body)))),
        ("rotation", "", sqrt(plain(rotation_error_squared(rows, s.x, s.body)))),
    )


def one_of(numbers: Any, member: int) -> float:
    """Return the number of one member of the batch, from (n,) or a number for all."""
    array = np.atleast_1d(plain(numbers))
    return float(array[member if len(array) > 1 else 0])


def velocity_of(x: Kinematics) -> Vec:
    """Relative twist D⁻¹Ḋ."""
    return x.omega + x.point_rate
