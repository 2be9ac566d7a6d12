"""Newton–Euler's equations of a rigid body in joint axes are given for both c-spaces.

Joint axes. Every problem is transformed to the joint's own frames before the first step and back
after the last: Q = GᵣᵀRBᵣ turns the body's joint frame to the ground's. Rows of the constraint
Jacobian are then unit vectors and rows of Q, however the joint is tilted.

- On SE(3) the body frame *is* the joint frame: D = G⁻¹CB = (Q, d). C-space and method are
  equivariant under this change (left and right translations), so that the motion is the same.
- On SO(3)×R³ they are equivariant under rotations only: C = (Q, s) with s the position of the body
  frame's origin, and d = s + Q p with p from there to the joint's point. Constraints drift where
  p ≠ 0.

In both c-spaces, forces and accelerations are at the joint's point, in body axes.
"""

from __future__ import annotations

from collections.abc import Callable
from types import ModuleType
from typing import Any, NamedTuple

from lierb.kernels.functions.signals import NO_SIGNALS, Signals
from lierb.kernels.groups import ambient, ambientxr3, quaternion, quaternionxr3, se3
from lierb.kernels.numbers.arithmetic import fma, where
from lierb.kernels.numbers.dual import Dual, parts_of, values
from lierb.kernels.numbers.number import Number
from lierb.kernels.numbers.vec import (
    IDENTITY,
    UNIT,
    ZERO3,
    Mat,
    Vec,
    add,
    axes_along,
    axpy,
    cross,
    cross_add,
    dot,
    inverse_symmetric,
    mat_mat,
    mat_mat_t,
    mat_t_mat,
    mat_t_vec,
    mat_vec,
    mat_vec_add,
    neg,
    norm,
    principal_axes,
    scale,
    sub,
)
from lierb.kernels.numbers.zero import ZERO, is_zero

Pose = tuple[Mat, Vec]
Turn = Callable[[Vec], Vec]  # transforms a vector's components to other axes

Wrench = tuple[Vec, Vec]  # torque and force, in body axes, about the joint's point


class Parameters(NamedTuple):
    """The parameters of a body and its joint are in the user's frames.

    Units are SI; rotation matrices are row by row.
    """

    mass: Any
    inertia: Mat  # about the body frame's origin
    com: Vec  # centre of mass in the body frame
    gravity: Vec  # in the ground frame
    ground: Pose  # joint frame on the ground
    body: Pose  # joint frame on the body
    pitch: Number  # m/rad
    length: Number  # m, of a rod


def frames_of(p: Parameters) -> Frames:
    """Return the frames for transforming forces' points and directions to joint axes."""
    return Frames(p.ground, *p.body)


def closed_pose(ground: Pose, body: Pose, length: Any) -> Pose:
    """Return C = G (I, length·e₃) B⁻¹ of a joint whose frames coincide, or are a rod apart."""
    return se3.compose(se3.compose(ground, (IDENTITY, (ZERO, ZERO, length))), se3.inverse(body))


class BodyConstants(NamedTuple):
    """Hold the constants of a body in joint axes, for the equations of motion."""

    mass: Number
    inertia: Mat  # Θ about the centre of mass
    inertia_inverse: Mat
    com: Vec  # c, from the body frame's origin
    arm: Vec  # p, from the body frame's origin to the joint's point
    gravity: Vec  # in the ground's joint frame
    energy_origin: Number  # potential energy at the ground's joint frame, J
    pitch: Number
    length: Number
    origin_inertia: Mat  # about the body frame's origin
    first_moment: Vec  # m c
    gain: Vec = ()  # (NᵀMN)⁻¹ of a subgroup joint, row by row
    turn: Mat = IDENTITY  # from the user's joint axes on the body to the axes used
    shift: Vec = ZERO3  # from the user's joint point on the body to the point used
    # For a body that turns about a point, in principal axes: K₁ K₂ K₃; K₂ − K₃, K₃ − K₁, K₁ − K₂
    moments: Vec = ()
    differences: Vec = ()
    # K₁₂, K₁₃ and K₂₃ there: structurally zero, with derivatives, along which the axes are fixed
    products: Vec = ()
    dropped: Number = ZERO  # number of dependent rows at the start
    elements: tuple[Any, ...] = ()  # parameters of each force and each further constraint
    signals: Signals = NO_SIGNALS  # at the time of the evaluation
    girth: Number = ZERO  # square of the radius of gyration, m²

    def momentum(self, velocity: Vec) -> Vec:
        """Return M V about the body frame's origin, on SE(3)."""
        omega, v = velocity[:3], velocity[3:]
        angular = cross_add(self.first_moment, v, mat_vec(self.origin_inertia, omega))
        return angular + cross_add(omega, self.first_moment, scale(self.mass, v))

    def wrench(self, fall: Vec, velocity: Vec, momentum: Vec) -> Vec:
        """Return ad_Vᵀ (M V) + W about the body frame's origin, on SE(3)  (Müller, eq. Poincare1).

        A step on a subgroup joint evaluates the projection of this, `subgroup.momentum_rate`.

        fall : gravity in body axes.   momentum : M V, or on a subgroup its projection.
        """
        omega, v = velocity[:3], velocity[3:]
        spin = gyroscopic(self, omega) if self.differences else cross(momentum[:3], omega)
        # For a body that turns and slides about its centre of mass, m v × v is rounding error only.
        torque = spin if not is_zero(*self.shift) else cross_add(momentum[3:], v, spin)
        force = axpy(self.mass, fall, cross(momentum[3:], omega))
        return cross_add(self.first_moment, fall, torque) + force


def girth_of(*bodies: tuple[Any, Mat]) -> Number:
    """Return the square of the radius of gyration of several bodies together, tr Θ / 2m, m².

    bodies : mass and inertia about the centre of mass of each.
    """
    mass: Number = ZERO
    trace: Number = ZERO
    for own, inertia in bodies:
        mass, trace = mass + own, trace + (inertia[0] + inertia[4] + inertia[8])
    return 0.5 * trace / mass


class Kinematics(NamedTuple):
    """Constraint rows depend on these kinematic quantities."""

    q: Mat
    d: Vec  # the joint's point in the ground's joint frame
    omega: Vec
    arm: Vec
    point_rate: Vec  # Qᵀ ḋ
    point_bias: Vec  # Qᵀ d̈ at zero acceleration V̇
    is_body_fixed: bool  # body frame's velocity in body axes (v), or in ground axes (ṙ)
    time: Any = ZERO  # s

    @property
    def motion(self) -> Motion:
        return Motion(self.time, self.q, self.d, self.omega, self.point_rate)

    def translation(self, ground: Vec, body: Vec) -> Vec:
        """Return the translational part of a row along a direction in ground and in body axes."""
        return body if self.is_body_fixed else ground

    def at_point(self) -> Kinematics:
        """Return the kinematics for rows on ω and on the joint point's velocity, in body axes."""
        return self._replace(arm=ZERO3, point_bias=ZERO3, is_body_fixed=True)


class Frames(NamedTuple):
    """Transform points and directions from the user's frames to joint axes."""

    ground: Pose
    axes: Mat  # the joint's axes in the user's body frame
    origin: Vec  # the joint's point in the user's body frame

    def body_point(self, p: Vec) -> Vec:
        return mat_t_vec(self.axes, sub(p, self.origin))

    def body_direction(self, direction: Vec) -> Vec:
        return mat_t_vec(self.axes, direction)

    def ground_point(self, p: Vec) -> Vec:
        return mat_t_vec(self.ground[0], sub(p, self.ground[1]))

    def ground_direction(self, direction: Vec) -> Vec:
        return mat_t_vec(self.ground[0], direction)


class Motion(NamedTuple):
    """Applied forces depend on the motion; body points are relative to the joint's point.

    felt : ω̇, and the acceleration of the joint's point less gravity, in body axes; for elements
        that depend on accelerations, else empty.
    """

    time: Number
    q: Mat
    place: Vec  # the joint's point in the ground's joint frame
    omega: Vec
    v: Vec  # velocity of the joint's point, in body axes
    signals: Signals = NO_SIGNALS
    felt: Vec = ()

    def place_of(self, point: Vec) -> Vec:
        """Return the position of a point of the body in the ground's joint frame."""
        return mat_vec_add(self.q, point, self.place)

    def velocity_of(self, point: Vec) -> Vec:
        """Return the velocity of a point of the body, in body axes."""
        return cross_add(self.omega, point, self.v)


def _body(p: Parameters, origin: Vec, arm: Vec) -> BodyConstants:
    """Constants in joint axes; c is relative to `origin`, a point in the user's body frame."""
    to_joint = p.body[0]
    inertia = mat_t_mat(to_joint, mat_mat(inertia_about_com(p), to_joint))
    com = mat_t_vec(to_joint, sub(p.com, origin))
    return BodyConstants(
        mass=p.mass,
        inertia=inertia,
        inertia_inverse=inverse_symmetric(inertia),
        com=com,
        arm=arm,
        gravity=mat_t_vec(p.ground[0], p.gravity),
        energy_origin=-p.mass * dot(p.gravity, p.ground[1]),
        pitch=p.pitch,
        length=p.length,
        origin_inertia=axpy(p.mass, unit_inertia(com), inertia),
        first_moment=scale(p.mass, com),
    )


def gyroscopic(body: BodyConstants, omega: Vec) -> Vec:
    """Return (Kω) × ω of a body that turns about a point."""
    torque = tuple(d * w for d, w in zip(body.differences, _products(omega), strict=True))
    if not body.products:
        return torque
    return add(torque, cross(_of_products(body, omega), omega))


def _of_products(body: BodyConstants, a: Vec) -> Vec:
    """Return the part of K a from the products of inertia, which has derivatives only."""
    (xy, xz, yz), (x, y, z) = body.products, a
    return fma(xy, y, xz * z), fma(xy, x, yz * z), fma(xz, x, yz * y)


def _products(omega: Vec) -> Vec:
    """Return Ω₂Ω₃, Ω₃Ω₁, Ω₁Ω₂."""
    x, y, z = omega
    return y * z, z * x, x * y


def spinning(body: BodyConstants, omega: Vec, fall: Vec, torque: Vec) -> Vec:
    """Return α of a body that turns freely about a point, by Euler's equations.

    This is the solution of the saddle point, `saddle.solve`, for a spherical joint in the principal
    axes at its point.

    fall : gravity in body axes.   torque : torque of all other forces about the point.
    """
    c = sub(body.com, body.arm)
    products = _products(omega)
    rates = []
    for i, (j, k) in enumerate(((1, 2), (2, 0), (0, 1))):  # the factors of products are constant
        mobility = 1.0 / body.moments[i]
        pull = body.mass * mobility
        rate = fma(pull * c[j], fall[k], -((pull * c[k]) * fall[j]))
        rate = fma(body.differences[i] * mobility, products[i], rate)
        rates.append(fma(mobility, torque[i], rate))
    if not body.products:
        return tuple(rates)
    more = sub(cross(_of_products(body, omega), omega), _of_products(body, tuple(rates)))
    return tuple(fma(1.0 / k, m, x) for k, m, x in zip(body.moments, more, rates, strict=True))


SLENDER = 1e3  # m c²/tr Θ above which Θ is taken in axes along c before m c² is added


def about_a_point(body: BodyConstants) -> tuple[Mat, Vec, Vec, Vec]:
    """Return the principal axes at the joint's point, as the columns of a rotation.

    Also returns, in these axes, c, the moments K_i, and K₂ − K₃, K₃ − K₁, K₁ − K₂. If Θ is small
    relative to m c², the moment about c is accurate nevertheless, and so are the differences.
    """
    c = sub(body.com, body.arm)
    heavy, none = body.mass * dot(c, c), 0.0 * body.mass
    is_slender = heavy > SLENDER * (body.inertia[0] + body.inertia[4] + body.inertia[8])
    along = where(is_slender, axes_along(where(is_slender, c, UNIT[0])), IDENTITY)
    aligned = where(is_slender, (norm(c), none, none), c)
    theta = mat_t_mat(along, mat_mat(body.inertia, along))
    whole = where(is_slender, theta, axpy(body.mass, unit_inertia(c), body.inertia))
    shift = (none, where(is_slender, heavy, 0.0), where(is_slender, heavy, 0.0))
    parts, turn = principal_axes(whole, shift)
    moments = add(parts, shift)
    differences = tuple(
        (shift[i] - shift[j]) + (parts[i] - parts[j]) for i, j in ((1, 2), (2, 0), (0, 1))
    )
    return mat_mat(along, turn), mat_t_vec(turn, aligned), moments, differences


class PrincipalAxes(NamedTuple):
    """Constants of a body in its principal axes at a point; see `about_a_point`.

    products : K₁₂, K₁₃, K₂₃; empty without derivatives.
    """

    turn: Mat
    centre: Vec
    moments: Vec
    differences: Vec
    products: Vec = ()

    @property
    def inertia(self) -> Mat:
        """Return K, row by row."""
        (x, y, z), (xy, xz, yz) = self.moments, self.products or ZERO3
        return (x, xy, xz, xy, y, yz, xz, yz, z)


def principal_axes_at_point(body: BodyConstants) -> PrincipalAxes:
    """Return the constants in the principal axes at the joint's point; the axes are fixed.

    Any axes would do, and those of equal moments have no derivative. K has one, off its diagonal
    too.
    """
    axes = PrincipalAxes(*about_a_point(values(body)))
    c = sub(body.com, body.arm)
    if not any(map(parts_of, (body.mass, *body.inertia, *c))):
        return axes
    about_point = axpy(body.mass, unit_inertia(c), body.inertia)
    k = mat_t_mat(axes.turn, mat_mat(about_point, axes.turn))
    centre = mat_t_vec(axes.turn, c)

    def along(value: Any, slope: Any) -> Any:
        return Dual(value, parts_of(slope)) if parts_of(slope) else value

    pairs = zip(axes.differences, ((1, 2), (2, 0), (0, 1)), strict=True)
    return PrincipalAxes(
        axes.turn,
        tuple(map(along, axes.centre, centre)),
        tuple(map(along, axes.moments, k[::4])),
        tuple(along(d, k[4 * i] - k[4 * j]) for d, (i, j) in pairs),
        tuple(along(ZERO, k[i]) for i in (1, 2, 5)),
    )


def inertia_about_com(p: Parameters) -> Mat:
    """Return the inertia about the centre of mass, in the user's body axes  (Steiner)."""
    return sub(p.inertia, scale(p.mass, unit_inertia(p.com)))


def unit_inertia(c: Vec) -> Mat:
    """Return the inertia (c·c) I − c cᵀ of a unit mass at c."""
    x, y, z = c
    xx, yy, zz = x * x, y * y, z * z
    xy, xz, yz = -(x * y), -(x * z), -(y * z)
    return (yy + zz, xy, xz, xy, xx + zz, yz, xz, yz, xx + yy)


def kinetic_energy(body: BodyConstants, omega: Vec, com_velocity: Vec) -> Number:
    turning = dot(omega, mat_vec(body.inertia, omega))
    return 0.5 * fma(body.mass, dot(com_velocity, com_velocity), turning)


def _potential_energy(body: BodyConstants, com: Vec) -> Number:
    return body.energy_origin - body.mass * dot(body.gravity, com)


class SE3:
    """Velocity (ω, v), both in body axes; v is that of the body frame's origin."""

    charts: ModuleType = quaternion  # the group's formulas that a step evaluates
    ambient: ModuleType = ambient  # those of an ambient update

    @staticmethod
    def centred(body: BodyConstants, c: Vec) -> BodyConstants:
        """Return the body with `c` as the vector from the joint's point to the centre of mass."""
        return body._replace(com=c, first_moment=scale(body.mass, c))

    @staticmethod
    def body(p: Parameters) -> BodyConstants:
        return _body(p, origin=p.body[1], arm=ZERO3)

    @staticmethod
    def to_joint_axes(p: Parameters, pose: Pose, twist: Vec) -> tuple[Pose, Vec]:
        (ground, origin), (turn, point) = p.ground, p.body
        q = mat_t_mat(ground, mat_mat(pose[0], turn))
        d = mat_t_vec(ground, sub(add(pose[1], mat_vec(pose[0], point)), origin))
        omega = mat_t_vec(turn, twist[:3])
        return (q, d), omega + mat_t_vec(turn, add(twist[3:], cross(twist[:3], point)))

    @staticmethod
    def to_user_axes(p: Parameters, pose: Pose, velocity: Vec) -> tuple[Pose, Vec]:
        (ground, origin), (turn, point) = p.ground, p.body
        r = mat_mat(ground, mat_mat_t(pose[0], turn))
        place = sub(add(origin, mat_vec(ground, pose[1])), mat_vec(r, point))
        omega = mat_vec(turn, velocity[:3])
        return (r, place), omega + sub(mat_vec(turn, velocity[3:]), cross(omega, point))

    @staticmethod
    def kinematics(body: BodyConstants, pose: Pose, velocity: Vec) -> Kinematics:
        omega, v = velocity[:3], velocity[3:]
        return Kinematics(pose[0], pose[1], omega, ZERO3, v, cross(omega, v), is_body_fixed=True)

    @staticmethod
    def velocity_rate(
        body: BodyConstants, to_ground: Turn, velocity: Vec, turning: Vec, moving: Vec
    ) -> Vec:
        """Return V̇, given ω̇ and the acceleration Qᵀd̈ of the joint's point."""
        return turning + cross_add(velocity[3:], velocity[:3], moving)

    @staticmethod
    def kinetic_energy(body: BodyConstants, velocity: Vec) -> Number:
        omega = velocity[:3]
        return kinetic_energy(body, omega, cross_add(omega, body.com, velocity[3:]))

    @staticmethod
    def potential_energy(body: BodyConstants, pose: Pose) -> Number:
        """Return the potential energy of gravity."""
        return _potential_energy(body, mat_vec_add(pose[0], body.com, pose[1]))


class SO3xR3:
    """The velocity is mixed, (ω, ṙ): ω in body axes, ṙ in the ground's; body frame at the COM."""

    charts: ModuleType = quaternionxr3
    ambient: ModuleType = ambientxr3

    @staticmethod
    def centred(body: BodyConstants, c: Vec) -> BodyConstants:
        return body._replace(arm=neg(c))

    @staticmethod
    def body(p: Parameters) -> BodyConstants:
        arm = mat_t_vec(p.body[0], p.body[1])
        return _body(p, origin=p.com, arm=arm)._replace(com=ZERO3)

    @staticmethod
    def to_joint_axes(p: Parameters, pose: Pose, twist: Vec) -> tuple[Pose, Vec]:
        (ground, origin), turn = p.ground, p.body[0]
        q = mat_t_mat(ground, mat_mat(pose[0], turn))
        s = mat_t_vec(ground, sub(pose[1], origin))
        rate = mat_t_vec(ground, mat_vec(pose[0], twist[3:]))
        return (q, s), mat_t_vec(turn, twist[:3]) + rate

    @staticmethod
    def to_user_axes(p: Parameters, pose: Pose, velocity: Vec) -> tuple[Pose, Vec]:
        (ground, origin), turn = p.ground, p.body[0]
        r = mat_mat(ground, mat_mat_t(pose[0], turn))
        place = add(origin, mat_vec(ground, pose[1]))
        return (r, place), mat_vec(turn, velocity[:3]) + mat_vec(
            turn, mat_t_vec(pose[0], velocity[3:])
        )

    @staticmethod
    def kinematics(body: BodyConstants, pose: Pose, velocity: Vec) -> Kinematics:
        q, omega = pose[0], velocity[:3]
        swing = cross(omega, body.arm)
        rate = add(mat_t_vec(q, velocity[3:]), swing)
        d = add(pose[1], mat_vec(q, body.arm))
        return Kinematics(q, d, omega, body.arm, rate, cross(omega, swing), is_body_fixed=False)

    @staticmethod
    def velocity_rate(
        body: BodyConstants, to_ground: Turn, velocity: Vec, turning: Vec, moving: Vec
    ) -> Vec:
        """Return V̇, given ω̇ and the acceleration Qᵀd̈ of the joint's point."""
        omega, com = velocity[:3], neg(body.arm)  # relative to the joint's point
        bend = cross_add(omega, cross(omega, com), moving)
        return turning + to_ground(cross_add(turning, com, bend))

    @staticmethod
    def kinetic_energy(body: BodyConstants, velocity: Vec) -> Number:
        return kinetic_energy(body, velocity[:3], velocity[3:])

    @staticmethod
    def potential_energy(body: BodyConstants, pose: Pose) -> Number:
        """Return the potential energy of gravity."""
        return _potential_energy(body, pose[1])


CSPACES: dict[str, type[SE3] | type[SO3xR3]] = {"SE3": SE3, "SO3xR3": SO3xR3}
