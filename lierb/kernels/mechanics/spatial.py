"""Transform twists, wrenches and inertias between frames, angular part first.

Formulas of Featherstone, Rigid Body Dynamics Algorithms (2008), ch. 2 and 7. A frame is a pose
(R, p): its axes and its origin in the outer frame.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from lierb.kernels.numbers.number import Number
from lierb.kernels.numbers.vec import (
    ZERO6,
    Mat,
    Vec,
    add,
    axpy,
    column,
    cross,
    cross_add,
    diagonal,
    dot,
    mat_mat_t,
    mat_t_vec,
    mat_vec,
    mat_vec_add,
    row,
    skew,
)

Pose = tuple[Mat, Vec]


def twist_at(frame: Pose, twist: Vec) -> Vec:
    """Transform a twist from the outer frame into a frame: `se3.Ad` of the frame's inverse."""
    r, p = frame
    return mat_t_vec(r, twist[:3]) + mat_t_vec(r, cross_add(twist[:3], p, twist[3:]))


def wrench_from(frame: Pose, wrench: Vec) -> Vec:
    """Transform a wrench from a frame into the outer one: (R τ + p × R f, R f)."""
    r, p = frame
    force = mat_vec(r, wrench[3:])
    return cross_add(p, force, mat_vec(r, wrench[:3])) + force


class Rigid(NamedTuple):
    """A rigid body has mass, first moment and inertia about the origin of its frame."""

    mass: Number  # kg
    moment: Vec  # m c, kg m
    inertia: Mat  # J, kg m²

    def momentum(self, twist: Vec, start: Vec = ZERO6) -> Vec:
        """Return start + M V; for an acceleration V, the wrench that it needs besides `bias`."""
        omega, v = twist[:3], twist[3:]
        angular = cross_add(self.moment, v, mat_vec_add(self.inertia, omega, start[:3]))
        return angular + cross_add(omega, self.moment, axpy(self.mass, v, start[3:]))

    def bias(self, omega: Vec) -> Vec:
        """Return the wrench (ω × J ω, ω × (ω × m c)) of a body that turns at ω.

        The origin of its frame does not accelerate. The wrench does not contain the velocity v of
        the origin. The expression −ad_Vᵀ M V has the same value if V̇ is zero, but the rounding of
        its v × m v is a torque.
        """
        return cross(omega, mat_vec(self.inertia, omega)) + cross(omega, cross(omega, self.moment))

    def needed(self, acceleration: Vec, omega: Vec) -> Vec:
        """Return the wrench needed for an acceleration, (ω̇, acceleration of the origin), at ω."""
        return self.momentum(acceleration, self.bias(omega))

    def from_frame(self, frame: Pose) -> Articulated:
        """Transform into the outer frame."""
        r, p = frame
        moment = mat_vec(r, self.moment)
        middle = axpy(0.5 * self.mass, p, moment)  # t: J + 2(p·t) I − t pᵀ − p tᵀ  (Steiner)
        along = 2.0 * dot(p, middle)
        turned = conjugated(r, self.inertia)

        def entry(i: int, j: int) -> Number:
            rest = turned[3 * i + j] - (middle[i] * p[j] + p[i] * middle[j])
            return rest + along if i == j else rest

        return Articulated(
            _symmetric(entry), skew(axpy(self.mass, p, moment)), diagonal((self.mass,) * 3)
        )


class Articulated(NamedTuple):
    """[[J, H], [Hᵀ, L]] is the articulated inertia of connected bodies at the first.

    J and L are symmetric.
    """

    angular: Mat
    mixed: Mat
    linear: Mat

    def momentum(self, twist: Vec) -> Vec:
        omega, v = twist[:3], twist[3:]
        angular = add(mat_vec(self.angular, omega), mat_vec(self.mixed, v))
        return angular + add(mat_t_vec(self.mixed, omega), mat_vec(self.linear, v))

    def and_also(self, other: Articulated) -> Articulated:
        return Articulated(*(add(a, b) for a, b in zip(self, other, strict=True)))

    def less(self, u: Vec, g: Vec) -> Articulated:
        """Subtract u gᵀ; the sum over all pairs of columns must be symmetric."""
        return Articulated(
            _symmetric(lambda i, j: self.angular[3 * i + j] - u[i] * g[j]),
            tuple(self.mixed[3 * i + j] - u[i] * g[3 + j] for i in range(3) for j in range(3)),
            _symmetric(lambda i, j: self.linear[3 * i + j] - u[3 + i] * g[3 + j]),
        )

    def from_frame(self, frame: Pose) -> Articulated:
        """Transform into the outer frame: [[J + p̂Hᵀ − H′p̂, H′], [H′ᵀ, L]] of rotated blocks."""
        r, p = frame
        linear, mixed = conjugated(r, self.linear), mat_conjugated(r, self.mixed)
        levers = [cross(p, row(mixed, i)) for i in range(3)]
        moved = add(mixed, _crossed(p, linear))
        shifted = [cross(p, row(moved, i)) for i in range(3)]
        turned = conjugated(r, self.angular)
        angular = _symmetric(lambda i, j: turned[3 * i + j] + (levers[j][i] + shifted[i][j]))
        return Articulated(angular, moved, linear)


class Augmented(NamedTuple):
    """A rigid body and inertia added to it, about the origin of its frame."""

    rigid: Rigid | Augmented
    added: Articulated

    @property
    def mass(self) -> Number:
        return self.rigid.mass

    @property
    def moment(self) -> Vec:
        return self.rigid.moment

    @property
    def inertia(self) -> Mat:
        return self.rigid.inertia

    def momentum(self, twist: Vec, start: Vec = ZERO6) -> Vec:
        return add(self.rigid.momentum(twist, start), self.added.momentum(twist))

    def bias(self, omega: Vec) -> Vec:
        """Return the bias wrench of the rigid body; that of the added inertia is a load."""
        return self.rigid.bias(omega)

    def needed(self, acceleration: Vec, omega: Vec) -> Vec:
        return self.momentum(acceleration, self.bias(omega))

    def from_frame(self, frame: Pose) -> Articulated:
        return self.rigid.from_frame(frame).and_also(self.added.from_frame(frame))


def _symmetric(entry: Callable[[int, int], Any]) -> Mat:
    """Return the symmetric matrix whose lower triangle is entry(i, j)."""
    lower = {(i, j): entry(i, j) for i in range(3) for j in range(i + 1)}
    return tuple(lower[max(i, j), min(i, j)] for i in range(3) for j in range(3))


def _crossed(p: Vec, m: Mat) -> Mat:
    """Return p̂ m."""
    columns = [cross(p, column(m, j)) for j in range(3)]
    return tuple(columns[j][i] for i in range(3) for j in range(3))


def conjugated(r: Mat, m: Mat) -> Mat:
    """Return R m Rᵀ of a symmetric m."""
    half = mat_mat_t(m, r)
    return _symmetric(lambda i, j: dot(row(r, i), column(half, j)))


def mat_conjugated(r: Mat, m: Mat) -> Mat:
    """Return R m Rᵀ of any m."""
    half = mat_mat_t(m, r)
    return tuple(dot(row(r, i), column(half, j)) for i in range(3) for j in range(3))
