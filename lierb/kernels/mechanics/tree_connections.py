"""Formulas of a connection between two nodes in memory: relative motion, wrenches, rows.

All vectors are in the ground's axes, about the nodes' origins, unless a name says otherwise.
Accelerations are those of points, (α, a), so that a row J on the motion (ω, Qᵀḋ) of an inner frame
relative to an outer one is, in the accelerations of the two nodes,

    w·(α, a) − w′·(α′, a′) + f·β + τ·(ω × ω′) = η,
    w = (τ + ρ × f, f),   w′ = (τ + ρ′ × f, f),   (τ, f) = C J,
    β = ω × (ω × ρ) − ω′ × (ω′ × ρ′) − 2 ω′ × ṗ,

with C the inner frame's axes, ρ and ρ′ its origin from the two nodes' origins, and ṗ the velocity
of this origin relative to the other node.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

from lierb.kernels.groups import se3
from lierb.kernels.mechanics.constraints import errors_squared, residuals
from lierb.kernels.mechanics.newton_euler import Kinematics, Motion
from lierb.kernels.mechanics.rows import Row, Rows
from lierb.kernels.mechanics.spatial import Pose, wrench_from
from lierb.kernels.mechanics.tree import HERE, Ends, combined
from lierb.kernels.mechanics.tree_nodes import ARM, OMEGA, PLACE, PULLS, SPEED, START, TURN, Kind
from lierb.kernels.numbers.vec import (
    IDENTITY,
    ZERO3,
    Mat,
    Vec,
    add,
    axpy,
    cross,
    cross_add,
    dot,
    mat_mat,
    mat_t_vec,
    mat_vec,
    neg,
    sub,
)
from lierb.kernels.numbers.zero import ZERO

FRAME_ROWS = 12  # of a frame in memory


class Frame(NamedTuple):
    """Axes, angular velocity, place and velocity of a frame on a node.

    arm : its origin from the node's.
    """

    turn: Mat
    omega: Vec
    place: Vec
    speed: Vec
    arm: Vec = ZERO3


def frame_on(here: Any, inner: Pose = HERE) -> Frame:
    """Frame `inner` on a node.   here : motion of the node, with place and velocity."""
    turn, omega = here[TURN : TURN + 9], here[OMEGA : OMEGA + 3]
    place, speed = here[PLACE : PLACE + 3], here[SPEED : SPEED + 3]
    if inner is HERE:
        return Frame(turn, omega, place, speed)
    arm = mat_vec(turn, inner[1])
    moving = cross_add(omega, arm, speed)
    return Frame(mat_mat(turn, inner[0]), omega, add(place, arm), moving, arm)


def between(outer: Pose, frame: Frame, other: Any, time: Any) -> tuple[Motion, Vec]:
    """Motion of a frame relative to one on another node, and its origin from that node's.

    other : motion of the other node, with place and velocity.
    """
    base, origin = other[TURN : TURN + 9], other[PLACE : PLACE + 3]
    spin, drift = other[OMEGA : OMEGA + 3], other[SPEED : SPEED + 3]
    seat = se3.compose((base, origin), outer)
    q, d = se3.compose(se3.inverse(seat), (frame.turn, frame.place))
    lever = sub(frame.place, origin)
    turning = sub(frame.omega, spin)
    moving = sub(frame.speed, cross_add(spin, lever, drift))
    motion = Motion(time, q, d, mat_t_vec(frame.turn, turning), mat_t_vec(frame.turn, moving))
    return motion, lever


def loads_of(wrench: tuple[Vec, Vec], frame: Frame, lever: Vec) -> tuple[Vec, Vec]:
    """Wrenches on both nodes about their origins, for one in the axes of the frame."""
    torque, force = (mat_vec(frame.turn, part) for part in wrench)
    own = cross_add(frame.arm, force, torque) + force
    return own, neg(cross_add(lever, force, torque) + force)


@dataclass(frozen=True)
class Connected:
    """Rows between two frames at their motion.

    here, other : motions of the two nodes, in memory.
    second : the rows' part at a second joint, if they have one.
    """

    rows: Rows
    ends: Ends
    here: Any
    other: Any
    time: Any
    second: Connected | None = None

    @cached_property
    def frame(self) -> Frame:
        return frame_on(self.here, self.ends.inner)

    @cached_property
    def _between(self) -> tuple[Motion, Vec]:
        return between(self.ends.outer, self.frame, self.other, self.time)

    @cached_property
    def x(self) -> Kinematics:
        """Kinematics for rows that act on ω̇ and on Qᵀd̈."""
        at, _ = self._between
        return Kinematics(at.q, at.place, at.omega, ZERO3, at.v, ZERO3, True, self.time)

    @cached_property
    def velocity(self) -> Vec:
        return self.x.omega + self.x.point_rate

    @cached_property
    def residuals(self) -> dict[Row, Any]:
        """Residuals h of the holonomic rows."""
        rows = tuple(r for r in self.rows if r.is_holonomic)
        return dict(zip(rows, residuals(rows, self.x, self.ends), strict=True))

    @cached_property
    def errors_squared(self) -> tuple[Any, ...]:
        """Squares of `measures.JOINT_ERRORS`."""
        rates = [self.rate_error(r) for r in self.rows]
        return errors_squared(self.rows, self.x, self.ends, rates)

    def rate_error(self, r: Row) -> Any:
        """J V less the prescribed rate."""
        moving = dot(r.jacobian(self.x, self.ends), self.velocity)
        rate = moving - r.prescribed_rate(self.x, self.ends)
        return rate + self.second.rate_error(r.second) if self.second and r.second else rate

    def loads(self, r: Row) -> tuple[Vec, ...]:
        """Wrenches w and −w′ of a row, at each of its joints."""
        jacobian = r.jacobian(self.x, self.ends)
        own = loads_of((jacobian[:3], jacobian[3:]), self.frame, self._between[1])
        return own + self.second.loads(r.second) if self.second and r.second else own

    def excess(self, r: Row, loads: tuple[Vec, ...]) -> Any:
        """w·(α, a) − w′·(α′, a′) − η of a row, without ν̇, summed over its joints."""
        own, pull, *others = loads
        total = dot(own, self.here[START : START + 6]) - r.acceleration(self.x, self.ends)
        total = total + dot(pull, self.other[START : START + 6])
        jacobian = r.jacobian(self.x, self.ends)
        torque, force = (mat_vec(self.frame.turn, part) for part in (jacobian[:3], jacobian[3:]))
        total = total + dot(torque + force, self._bias)
        if self.second and r.second:
            total = total + self.second.excess(r.second, tuple(others))
        return total

    @cached_property
    def _bias(self) -> Vec:
        omega, spin = self.frame.omega, self.other[OMEGA : OMEGA + 3]
        along = mat_vec(self.frame.turn, self.x.point_rate)
        swung = axpy(2.0, along, cross(spin, self._between[1]))
        return cross(omega, spin) + sub(
            cross(omega, cross(omega, self.frame.arm)), cross(spin, swung)
        )

    @property
    def motions(self) -> tuple[Any, ...]:
        """Motions of the nodes on which `loads` act."""
        own = self.here, self.other
        return own + self.second.motions if self.second else own

    def mobility(self, loads: tuple[Vec, ...], easy: Sequence[Vec]) -> Any:
        """Square of the size of a row in the metric of each node's own inertia.

        easy : reciprocals of the inertia's diagonal and of the mass, of all nodes.
        """
        triples = zip(loads, easy, self.motions, strict=True)
        return sum((square_of(*triple) for triple in triples), start=ZERO)


def square_of(wrench: Vec, easy: Vec, here: Any) -> Any:
    """Square of the size of a wrench in the metric of a node's own inertia."""
    torque, force = mat_t_vec(here[TURN : TURN + 9], wrench[:3]), wrench[3:]
    turning = dot(tuple(x * x for x in torque), easy[:3])
    return turning + easy[3] * dot(force, force)


# ---- a row on its path to the ground -------------------------------------------------------------


class Path(NamedTuple):
    """Response of a node to wrenches on it: S, (SᵀIS)⁻¹Uᵀ about the parent's origin, ν̇ by loads
    alone, (SᵀIS)⁻¹, and r.
    """

    free: list[Vec]
    pulls: list[Vec]
    forced: Vec
    gains: Vec
    arm: Vec

    @classmethod
    def of(cls, kind: Kind, constants: Any, here: Any) -> Path:
        free = kind.free(here[TURN : TURN + 9], kind.pitch(constants))
        count = len(free)
        pulls = [here[PULLS + 6 * k : PULLS + 6 * k + 6] for k in range(count)]
        rest = PULLS + 6 * count
        gains = here[rest + count : rest + count + count * count]
        return cls(free, pulls, here[rest : rest + count], gains, here[ARM : ARM + 3])

    def passed(self, wrench: Vec) -> tuple[Vec, Vec, Any, Vec]:
        """Return u = Sᵀw, (SᵀIS)⁻¹u, u·(ν̇ by loads alone), and the wrench on the parent.

        J M⁻¹ Jᵀ of two rows is the sum of u·(SᵀIS)⁻¹u over the nodes on both paths: a row passes on
        w − U (SᵀIS)⁻¹ u, so that no other response is needed.
        """
        count = len(self.free)
        left = tuple(dot(s, wrench) for s in self.free)
        moved = tuple(dot(self.gains[count * k : count * k + count], left) for k in range(count))
        above = combined(neg(left), self.pulls, wrench_from((IDENTITY, self.arm), wrench))
        return left, moved, dot(left, self.forced) if left else ZERO, above
