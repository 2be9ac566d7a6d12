"""Linear system J V = ḣ of all rows of a mechanism at a pose, V the twists of all links.

There are two metrics: x = (ω, v/ℓ) of every link, v of its centre of mass and ℓ the mechanism's
longest lever arm; and y, with ‖y‖² twice the kinetic energy. Redundancy depends on geometry alone:
ranks are determined in x, with rows of length 1. Masses select among the motions that all rows
allow.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property, reduce
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

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
    dot,
    mat_t_vec,
    mat_vec,
    neg,
    norm,
    scale,
    sub,
)
from lierb.kernels.numbers.zero import ZERO
from lierb.support.arrays import Array, assembled

if TYPE_CHECKING:
    from lierb.model.connections import Connection
    from lierb.model.mechanism.kinematics import TreeKinematics

# Bound between nonzero and zero singular values, relative to the largest. A start
# may violate its joints by 1e-9, and redundant rows are then dependent only to that accuracy.
RANK_TOLERANCE = 1e-7
NEWTON_STEPS = 50  # starts that converge do so quadratically, in 4 to 6 steps
CLOSED = 1e-13  # rad, or relative to the problem's length: residual due to rounding
LEAST_GYRATION = 0.03  # least radius of gyration of a link in `close`, relative to its length


class Metric:
    """Kinetic energy of one link: Θ = LLᵀ, m and c."""

    def __init__(self, p: Parameters, unit: Any, least: Any) -> None:
        """unit : unit of y², kg m².   least : lower bound for the trace of the inertia, kg m²."""
        inertia = inertia_about_com(p)
        trace = inertia[0] + inertia[4] + inertia[8]
        added = where(trace < least, least, 0.0 * trace)
        self.lower = _cholesky(add(inertia, diagonal((added, added, added))))
        self.com, self.root, self.unit = p.com, np.sqrt(p.mass), np.sqrt(unit)

    def __call__(self, omega: Vec, moving: Vec) -> Vec:
        """Compute y from angular velocity and velocity of the centre of mass."""
        turning = mat_t_vec(self.lower, omega)
        return scale(1.0 / self.unit, turning + scale(self.root, moving))


def _cholesky(m: Mat) -> Mat:
    """Factor L of m = LLᵀ, row by row."""
    a = np.sqrt(m[0])
    b, d = m[3] / a, m[6] / a
    c = np.sqrt(m[4] - b * b)
    e = (m[7] - d * b) / c
    f = np.sqrt(m[8] - d * d - e * e)
    return (a, ZERO, ZERO, b, c, ZERO, d, e, f)


class ConnectionState(NamedTuple):
    """Connection at a pose and twist of its links.

    length : the larger characteristic length of its two links, m.
    rounding : rounding of the distance between points that coincide, m.
    """

    at: Connection
    parameters: Parameters
    body: BodyConstants
    x: Kinematics
    length: Any
    rounding: Any


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
    def connections(self) -> list[tuple[Connection, Parameters, BodyConstants, Any]]:
        """Connections with data that do not depend on poses: parameters, constants and length."""
        mechanism, connections = self.mechanism, []
        for at in mechanism.connections:
            p = mechanism.parameters(at)
            length = self.lengths[at.body] if at.joint is None else length_of(p)
            if at.parent >= 0:
                other = mechanism.parameters(mechanism.joints[at.parent])
                if at.joint is not None:  # the arm from the parent's centre of mass to this joint
                    other = other._replace(body=p.ground)
                length = maximum(length, length_of(other))
            connections.append((at, p, mechanism.constants(at), length))
        return connections

    def states(
        self, poses: list[Pose], twists: list[Vec] | None = None, t0: Any = 0.0
    ) -> list[ConnectionState]:
        """Return all connections at these poses and twists."""
        states = []
        for at, p, body, length in self.connections:
            x = self.kinematics(at, body, poses, twists)._replace(time=t0)
            rounding = rounding_of(p, poses[at.body])
            if at.parent >= 0:
                rounding = rounding + ROUNDING * norm(poses[at.parent][1])
            states.append(ConnectionState(at, p, body, x, length, rounding))
        return states

    def kinematics(
        self, at: Connection, body: BodyConstants, poses: list[Pose], twists: list[Vec] | None
    ) -> Kinematics:
        """Return the relative motion of a connection's two frames; at rest without twists."""
        relative = self.mechanism.relative(at, poses)
        moving: Vec = (0.0,) * 6
        if twists is not None:
            moving = self.mechanism.relative_twist(at, poses, twists)
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
                row = r.jacobian(s.x, s.body)
                for link, wrench in self.wrenches(s.at, s.parameters, s.x, row).items():
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
        return DecomposedRows(self, matrix, lever)

    def column(self, numbers: list[Any]) -> Array:
        """Return numbers of all rows as an array, (count, rows)."""
        column = np.empty((self.count, len(numbers)))
        for i, number in enumerate(numbers):
            column[:, i] = plain(number)
        return column


class Decomposed:
    """Singular value decompositions of matrices A, (count, rows, n)."""

    def __init__(self, matrix: Array) -> None:
        u, self.values, self.vt = np.linalg.svd(matrix)
        self.u = u[..., : self.values.shape[1]]
        self.ranks = self.ranks_above(RANK_TOLERANCE)

    def ranks_above(self, tolerance: float) -> Array:
        """Return the number of singular values above this fraction of the largest one."""
        kept = self.values > tolerance * self.values[:, :1]
        ranks: Array = np.count_nonzero(kept, axis=1)
        return ranks

    def least(self, wanted: Array, damping: Array | float = 0.0) -> Array:
        """Return the least x with A x = wanted, or the minimum of ‖A x − wanted‖² + damping ‖x‖².

        wanted : (count, rows).   damping : (count,).
        """
        count = self.values.shape[1]
        kept = np.arange(count) < self.ranks[:, None]
        squares = self.values * self.values + np.reshape(damping, (-1, 1))
        gains = np.where(kept, self.values, 0.0) / np.where(kept, squares, 1.0)
        parts = gains * summed(np.swapaxes(self.u, 1, 2) * wanted[:, None, :])
        return summed(np.swapaxes(self.vt[:, :count], 1, 2) * parts[:, None, :])


class DecomposedRows(Decomposed):
    """Decomposition of all rows, in x and scaled to length 1.

    lengths : (count, rows), lengths before scaling.
    """

    def __init__(self, system: System, matrix: Array, lever: Array) -> None:
        """matrix : (count, rows, 6 links), Jacobian with respect to x.   lever : ℓ, m, (count,)."""
        lengths = np.sqrt(summed(matrix * matrix))
        self.system, self.lever = system, lever
        self.lengths = np.where(lengths == 0.0, 1.0, lengths)
        super().__init__(matrix / self.lengths[..., None])

    @property
    def freedoms(self) -> Array:
        """Dimension of the space of motions that all rows allow, (count,)."""
        freedoms: Array = self.vt.shape[1] - self.ranks
        return freedoms

    @cached_property
    def moving(self) -> Array:
        """Motions `vt` in y, (count, n, n); those from index `ranks` on are free."""
        return np.swapaxes(self._energetic(np.swapaxes(self.vt, 0, 1)), 0, 1)

    def speed(self, twists: list[Vec]) -> Array:
        """Return ‖x‖ of all links' twists, rad/s, (count,)."""
        total: Any = 0.0
        for twist, metric in zip(twists, self.system.metrics, strict=True):
            moving = scale(1.0 / self.lever, cross_add(twist[:3], metric.com, twist[3:]))
            total = total + dot(twist[:3], twist[:3]) + dot(moving, moving)
        size: Array = np.sqrt(total)
        return size

    def lightest(self, wanted: Array, damping: Array | float = 0.0) -> list[Vec]:
        """Return the twists of least kinetic energy with J V = wanted, for rows of length 1.

        damping : as in `least`; it does not act on the free motions that are added.
        """
        x = self.least(wanted, damping)
        y = self._energetic(x)
        moving = self.moving
        for rank in np.unique(self.ranks[self.freedoms > 0]):
            these = self.ranks == rank
            x[these] += _easing(self.vt[these, rank:], moving[these, rank:], y[these])
        return [
            omega + sub(velocity, cross(omega, metric.com))
            for omega, velocity, metric in self._parts(x)
        ]

    def _parts(self, x: Array) -> Iterator[tuple[Vec, Vec, Metric]]:
        """Angular velocity, velocity of the centre of mass and metric of every link."""
        for i, metric in enumerate(self.system.metrics):
            part = tuple(x[..., 6 * i + k] for k in range(6))
            yield part[:3], scale(self.lever, part[3:]), metric

    def _energetic(self, x: Array) -> Array:
        """Convert x to y, (…, count, 6 links)."""
        return np.concatenate([assembled(metric(*v)) for *v, metric in self._parts(x)], axis=-1)


def _easing(free: Array, moving: Array, y: Array) -> Array:
    """Combination of free motions with the least ‖y‖, (count, n).

    free, moving : (count, freedoms, n), in x and in y.

    With masses of different orders of magnitude the columns of y are nearly parallel, dominated by
    the heaviest link. Gaussian elimination with complete pivoting gives columns that move lighter
    and lighter links, and that are well-conditioned once scaled to length 1.
    """
    free, moving, (count, freedoms, n) = free.copy(), moving.copy(), free.shape
    each = np.arange(count)
    for j in range(freedoms):
        largest = np.abs(moving[:, j:]).reshape(count, -1).argmax(axis=1)
        column, row = j + largest // n, largest % n
        for columns in (free, moving):
            columns[each, column], columns[:, j] = columns[:, j].copy(), columns[each, column]
        shares = moving[each, j + 1 :, row] / moving[each, j, row][:, None]
        for columns in (free, moving):
            columns[:, j + 1 :] -= shares[..., None] * columns[:, None, j]
    sizes = np.sqrt(summed(moving * moving))
    q, r = np.linalg.qr(np.swapaxes(moving / sizes[..., None], 1, 2))
    parts = -summed(np.swapaxes(q, 1, 2) * y[:, None, :])
    parts = np.linalg.solve(r, parts[..., None])[..., 0] / sizes
    return summed(np.swapaxes(free, 1, 2) * parts[:, None, :])


def _moved(frame: Pose, wrench: Vec) -> Vec:
    """Transform a wrench from a frame to the outer frame."""
    force = mat_vec(frame[0], wrench[3:])
    return cross_add(frame[1], force, mat_vec(frame[0], wrench[:3])) + force


def summed(array: Array) -> Array:
    """Sum over the last axis, in order; the order in `np.sum` depends on the batch."""
    total = np.zeros(array.shape[:-1])
    for i in range(array.shape[-1]):
        total = total + array[..., i]
    return total


# ---- residuals and messages --------------------------------------------------------------------


def wrong_way(s: ConnectionState, count: int) -> Any:
    """Return the indices of members whose joint is half a turn off; rows vanish there, too."""
    against = np.zeros(count, dtype=bool)
    for bearing in bearings(s.at.rows, s.x.q):
        against |= np.broadcast_to(bearing <= 0.0, (count,))
    return np.flatnonzero(against)


def reversed_joint(mechanism: TreeKinematics, at: Connection, label: str) -> str:
    """Message for a joint that is half a turn off."""
    return (
        f"{label} holds {name_of(mechanism, at)} the wrong way round, half a turn off, which no "
        "row sees; turn a link or one of the joint's frames by 180°"
    )


def name_of(mechanism: TreeKinematics, at: Connection) -> str:
    """Name of a connection in messages."""
    ends = " to ".join(mechanism.names[i] if i >= 0 else "ground" for i in (at.body, at.parent))
    if at.joint is None or at.elements:
        return f"{at.name} ({ends})"
    what = "joint of" if at.name == mechanism.names[at.body] else "loop"
    return f"the {what} {at.name} ({at.joint.name}, {ends})"


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
