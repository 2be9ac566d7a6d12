"""All rows of a mechanism together, at poses of its links, in the metric of its kinetic energy.

J V = ḣ, V the twists of all links. With M = SSᵀ and y = SᵀV, ‖y‖ is that metric, and rows of J S⁻ᵀ
are brought to length 1.
"""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from lierb.arrays import Array, assembled
from lierb.kernels.groups import se3
from lierb.kernels.mechanics.constraints import position_error_squared, rotation_error_squared
from lierb.kernels.mechanics.newton_euler import (
    SE3,
    BodyConstants,
    Kinematics,
    Parameters,
    Pose,
    inertia_about_com,
)
from lierb.kernels.mechanics.scale import ROUNDING, bearings, length_of, rounding_of
from lierb.kernels.numbers.arithmetic import maximum, plain, sqrt, where
from lierb.kernels.numbers.vec import (
    Mat,
    Vec,
    add,
    cross,
    cross_add,
    diagonal,
    mat_vec,
    neg,
    norm,
    scale,
    sub,
)
from lierb.kernels.numbers.zero import ZERO
from lierb.model import LEAST_GYRATION

if TYPE_CHECKING:
    from lierb.links import Connection
    from lierb.mechanism import Mechanism


class Metric:
    """The kinetic energy of one link, from its body-fixed twist: Θ = LLᵀ, m and c."""

    def __init__(self, p: Parameters, unit: Any, least: Any) -> None:
        """unit : in kg m², what makes y a number.   least : kg m², the inertia's trace at least."""
        inertia = inertia_about_com(p)
        trace = inertia[0] + inertia[4] + inertia[8]
        added = where(trace < least, least, 0.0 * trace)
        self.lower = _cholesky(add(inertia, diagonal((added, added, added))))
        self.com, self.root, self.unit = p.com, np.sqrt(p.mass), np.sqrt(unit)

    def row(self, wrench: Vec) -> Vec:
        """A row on V, of y."""
        torque, force = wrench[:3], wrench[3:]
        turning = _solved(self.lower, sub(torque, cross(self.com, force)))
        return scale(self.unit, turning + scale(1.0 / self.root, force))

    def twist(self, y: Vec) -> Vec:
        """V of a y."""
        omega = _solved_transposed(self.lower, scale(self.unit, y[:3]))
        moving = scale(self.unit / self.root, y[3:])
        return omega + sub(moving, cross(omega, self.com))


def _cholesky(m: Mat) -> Mat:
    """L of m = LLᵀ, row by row."""
    a = np.sqrt(m[0])
    b, d = m[3] / a, m[6] / a
    c = np.sqrt(m[4] - b * b)
    e = (m[7] - d * b) / c
    f = np.sqrt(m[8] - d * d - e * e)
    return (a, ZERO, ZERO, b, c, ZERO, d, e, f)


def _solved(lower: Mat, x: Vec) -> Vec:
    """L⁻¹ x."""
    a = x[0] / lower[0]
    b = (x[1] - lower[3] * a) / lower[4]
    return a, b, (x[2] - lower[6] * a - lower[7] * b) / lower[8]


def _solved_transposed(lower: Mat, x: Vec) -> Vec:
    """L⁻ᵀ x."""
    c = x[2] / lower[8]
    b = (x[1] - lower[7] * c) / lower[4]
    return (x[0] - lower[3] * b - lower[6] * c) / lower[0], b, c


class Held(NamedTuple):
    """A connection at a pose."""

    at: Connection
    parameters: Parameters
    body: BodyConstants
    x: Kinematics
    length: Any  # m: the larger one of the lengths of its two links
    rounding: Any  # m, of the distance between points that coincide


class System:
    """A mechanism's rows at given poses of its links, all members of its batch at once."""

    def __init__(self, mechanism: Mechanism, count: int, is_stout: bool = False) -> None:
        """is_stout : whether a link that is small beside its arms counts as larger."""
        self.mechanism, self.count = mechanism, count
        of_links = [mechanism.parameters(at) for at in mechanism.joints[: len(mechanism.links)]]
        self.lengths = [length_of(p) for p in of_links]
        self.length = _largest(self.lengths)
        total: Any = 0.0
        for p in of_links:
            total = total + p.mass
        unit = total * self.length**2
        self.metrics = [
            Metric(p, unit, p.mass * (LEAST_GYRATION * length) ** 2 if is_stout else 0.0)
            for p, length in zip(of_links, self.lengths, strict=True)
        ]

    @cached_property
    def connections(self) -> list[tuple[Connection, Parameters, BodyConstants, Any]]:
        """With what is the same at all poses: parameters, constants and length."""
        mechanism, found = self.mechanism, []
        for at in mechanism.connections:
            p = mechanism.parameters(at)
            length = self.lengths[at.body] if at.joint is None else length_of(p)
            if at.parent >= 0:
                other = mechanism.parameters(mechanism.joints[at.parent])
                if at.joint is not None:  # with the arm from its centre of mass to this joint
                    other = other._replace(body=p.ground)
                length = maximum(length, length_of(other))
            found.append((at, p, mechanism.constants(at), length))
        return found

    def held(self, poses: list[Pose], twists: list[Vec] | None = None, t0: Any = 0.0) -> list[Held]:
        """Every connection, moving at these twists."""
        found = []
        for at, p, body, length in self.connections:
            relative = self.mechanism.relative(at, poses)
            moving: Vec = (0.0,) * 6
            if twists is not None:
                moving = self.mechanism.relative_twist(at, poses, twists)
            x = SE3.kinematics(body, relative, moving)._replace(time=t0)
            rounding = rounding_of(p, poses[at.body])
            if at.parent >= 0:
                rounding = rounding + ROUNDING * norm(poses[at.parent][1])
            found.append(Held(at, p, body, x, length, rounding))
        return found

    def matrix(self, held: list[Held]) -> tuple[Array, Array]:
        """J S⁻ᵀ with rows of length 1, (count, rows, 6 links), and their lengths before."""
        total = sum(len(h.at.rows) for h in held)
        found = np.zeros((self.count, total, 6 * len(self.metrics)))
        number = 0
        for h in held:
            seen = se3.compose(h.parameters.ground, (h.x.q, h.x.d))  # B from the parent
            for r in h.at.rows:
                row = r.jacobian(h.x, h.body)
                self._put(found, number, h.at.body, _moved(h.parameters.body, row))
                if h.at.parent >= 0:
                    self._put(found, number, h.at.parent, neg(_moved(seen, row)))
                number += 1
        found[~np.isfinite(found).all(axis=(1, 2))] = 0.0  # no step, so that it stays open
        lengths = np.sqrt(summed(found * found))
        lengths = np.where(lengths == 0.0, 1.0, lengths)
        return found / lengths[..., None], lengths

    def _put(self, matrix: Array, row: int, link: int, wrench: Vec) -> None:
        matrix[:, row, 6 * link : 6 * link + 6] = assembled(self.metrics[link].row(wrench))

    def twists(self, y: Array) -> list[Vec]:
        """V of every link."""
        parts = tuple(y[:, i] for i in range(y.shape[1]))
        return [m.twist(parts[6 * i : 6 * i + 6]) for i, m in enumerate(self.metrics)]

    def column(self, numbers: list[Any]) -> Array:
        """One number for each row, (count, rows)."""
        found = np.empty((self.count, len(numbers)))
        for i, number in enumerate(numbers):
            found[:, i] = plain(number)
        return found


def _moved(frame: Pose, wrench: Vec) -> Vec:
    """A wrench in a frame, in what the frame is seen from."""
    force = mat_vec(frame[0], wrench[3:])
    return cross_add(frame[1], force, mat_vec(frame[0], wrench[:3])) + force


def _largest(lengths: list[Any]) -> Any:
    found = lengths[0]
    for length in lengths[1:]:
        found = maximum(found, length)
    return found


def summed(array: Array) -> Array:
    """Over the last axis, in its order: `sum` may take another one in another batch."""
    total = np.zeros(array.shape[:-1])
    for i in range(array.shape[-1]):
        total = total + array[..., i]
    return total


def wrong_way(h: Held, count: int) -> Any:
    """Numbers of members that hold a joint half a turn off, which no row sees."""
    against = np.zeros(count, dtype=bool)
    for bearing in bearings(h.at.rows, h.x.q):
        against |= np.broadcast_to(bearing <= 0.0, (count,))
    return np.flatnonzero(against)


def reversed_joint(mechanism: Mechanism, at: Connection, label: str) -> str:
    return (
        f"{label} holds {name_of(mechanism, at)} the wrong way round, half a turn off, which no "
        "row sees; turn a link or one of the joint's frames by 180°"
    )


def name_of(mechanism: Mechanism, at: Connection) -> str:
    """A connection for a message."""
    ends = " to ".join(mechanism.names[i] if i >= 0 else "ground" for i in (at.body, at.parent))
    if at.joint is None or at.elements:
        return f"{at.name} ({ends})"
    what = "joint of" if at.name == mechanism.names[at.body] else "loop"
    return f"the {what} {at.name} ({at.joint.name}, {ends})"


def errors_of(h: Held) -> tuple[tuple[str, str, Any], tuple[str, str, Any]]:
    rows = h.at.rows
    return (
        ("position", " m", sqrt(plain(position_error_squared(rows, h.x, h.body)))),
        ("rotation", "", sqrt(plain(rotation_error_squared(rows, h.x, h.body)))),
    )


def one_of(numbers: Any, member: int) -> float:
    """The number of one member of the batch, or of all of them."""
    array = np.atleast_1d(plain(numbers))
    return float(array[member if len(array) > 1 else 0])


def velocity_of(x: Kinematics) -> Vec:
    """D⁻¹Ḋ."""
    return x.omega + x.point_rate
