"""Independent reference solutions: nothing here comes from `lierb`.

Three parts, each a different route to numbers that the library computes:

* `lie[group]`: exp, log, Ad, ad, dexp and dexpinv of a matrix group from their *definitions*
  (power series of its generators) at more than 50 digits; `coefficients`, the functions of θ;
* `reference_trajectory`: the constrained body as Newton and Euler wrote it, about the centre of
  mass, all in ground coordinates, joints made of points and axes in space, integrated by DOP853;
* motions that are known in closed form: `pendulum`, `torque_free_axisymmetric`,
  `torque_free_triaxial`.

Conventions: vectors of 6 are (angular, linear); a configuration of se3 or so3xr3 is a 4x4 matrix
with R and r (for so3xr3 only a container: the product is (R₁R₂, r₁ + r₂)); dexp is
right-trivialised, dexp_X(Ẋ) = Ċ C⁻¹; quaternions are (w, x, y, z).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import mpmath
import numpy as np
from scipy.integrate import solve_ivp

DIGITS = 80
BITS = 320  # of the fractions in `_power_series`: 96 digits, so that even 1e-36 keeps 60

mp = mpmath.mp.clone()  # a context of our own: the caller's precision is neither used nor changed
mp.dps = DIGITS


def to_float(matrix) -> np.ndarray:
    """The nearest float64 of every entry; a column becomes an array of one dimension."""
    values = np.array(matrix.tolist(), dtype=float)
    return values[:, 0] if matrix.cols == 1 else values


# ---------------------------------------------------------------- matrix groups, from definitions


def _power_series(matrix, shift: int):
    """Sum over k ≥ 0 of matrix^k / (k + shift)!, for shift 0 (exp) or 1 (dexp).

    Summed on Python integers (fractions with BITS binary digits), ten times faster than on mpf.
    """
    n = matrix.rows
    a = np.array([int(mp.ldexp(x, BITS)) for x in matrix], dtype=object).reshape(n, n)
    total = term = np.array([[int(i == j) << BITS for j in range(n)] for i in range(n)], object)
    k = 0
    while abs(term).max() > 1:  # a negative number shifted right ends at −1, not at 0
        k += 1
        term = (term @ a >> BITS) // (k + shift)
        total = total + term
    return mp.matrix([[mp.ldexp(int(x), -BITS) for x in row] for row in total])


class Group:
    """A matrix group, given by its generators E_i: everything follows from them.

    places[i] is the entry (row, column) where E_i is 1; the first three, the rotations, are
    antisymmetric. `matrix` and `configuration` translate between what callers see and the faithful
    representation, in which the group's product is the matrix product.
    """

    def __init__(self, size: int, places: Sequence[tuple[int, int]]):
        self.size, self.places, self.dim = size, places, len(places)

    def hat(self, X):
        """Matrix of the algebra element X = Σ X_i E_i."""
        total = mp.zeros(self.size)
        for i, (x, (r, c)) in enumerate(zip(X, self.places, strict=True)):
            total[r, c] = mp.mpf(x)
            if i < 3:
                total[c, r] = -mp.mpf(x)
        return total

    def vee(self, matrix):
        """Components of a matrix of the algebra: inverse of `hat`."""
        return mp.matrix([matrix[place] for place in self.places])

    def matrix(self, C):
        """Faithful representation of a configuration."""
        return mp.matrix(C)

    def configuration(self, g):
        """Configuration of an element of the faithful representation."""
        return g

    def compose(self, C1, C2):
        """Product C1 C2."""
        return self.configuration(self.matrix(C1) * self.matrix(C2))

    def inverse(self, C):
        """Inverse element."""
        return self.configuration(mp.inverse(self.matrix(C)))

    def exp(self, X):
        """Exponential: Σ hat(X)^k / k!."""
        return self.configuration(_power_series(self.hat(X), 0))

    def log(self, C):
        """The X with exp X = C and |ξ| ≤ π.

        ξ by the quaternion of R, its largest component first (good up to π). The translation of
        exp(ξ, η) is linear in η: its three columns come from exp itself, η from solving.
        """
        C = mp.matrix(C)
        xi = _rotation_vector(C)
        if self.dim == 3:
            return xi
        columns = mp.matrix(3)
        for j in range(3):
            columns[:, j] = self.exp([*xi, *(int(i == j) for i in range(3))])[:3, 3]
        return mp.matrix([*xi, *mp.lu_solve(columns, C[:3, 3])])

    def ad(self, X):
        """Matrix of Y ↦ [X, Y], the commutator of matrices."""
        x = self.hat(X)
        return self._matrix_of(lambda y: x * y - y * x)

    def Ad(self, C):
        """Matrix of Y ↦ C Y C⁻¹."""
        g = self.matrix(C)
        g_inverse = mp.inverse(g)
        return self._matrix_of(lambda y: g * y * g_inverse)

    def _matrix_of(self, linear_map):
        result = mp.zeros(self.dim)
        for j in range(self.dim):
            result[:, j] = self.vee(linear_map(self.hat(mp.eye(self.dim)[:, j])))
        return result

    def dexp(self, X):
        """Right-trivialised differential of exp: Σ ad_X^k / (k + 1)!."""
        return _power_series(self.ad(X), 1)

    def dexpinv(self, X):
        """Inverse matrix of `dexp`, |ξ| < 2π."""
        return mp.inverse(self.dexp(X))


class DirectProduct(Group):
    """SO(3)×R³, represented by blockdiag(R, [[I, r], [0, 1]])."""

    def matrix(self, C):
        C = mp.matrix(C)
        g = mp.eye(7)
        g[:3, :3] = C[:3, :3]
        g[3:6, 6] = C[:3, 3]
        return g

    def configuration(self, g):
        C = mp.eye(4)
        C[:3, :3] = g[:3, :3]
        C[:3, 3] = g[3:6, 6]
        return C


def _rotation_vector(R):
    """Principal rotation vector of R (Shepperd's quaternion, then the angle by atan2)."""
    trace = R[0, 0] + R[1, 1] + R[2, 2]
    squares = [1 + trace, *(1 + 2 * R[i, i] - trace for i in range(3))]  # 4 w², 4 x², 4 y², 4 z²
    largest = max(range(4), key=lambda i: squares[i])
    skew = [R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]]  # 4 w (x, y, z)
    if largest == 0:
        q = [squares[0], *skew]
    else:
        i = largest - 1
        q = [skew[i], *(R[i, j] + R[j, i] if j != i else squares[largest] for j in range(3))]
    if q[0] < 0:
        q = [-x for x in q]
    length = mp.norm(q[1:])
    scale = 2 * mp.atan2(length, q[0]) / length if length else mp.zero
    return mp.matrix([scale * x for x in q[1:]])


ROTATIONS = ((2, 1), (0, 2), (1, 0))
lie: dict[str, Group] = {
    "so3": Group(3, ROTATIONS),
    "se3": Group(4, (*ROTATIONS, (0, 3), (1, 3), (2, 3))),
    "so3xr3": DirectProduct(7, (*ROTATIONS, (3, 6), (4, 6), (5, 6))),
}


def coefficients(theta) -> dict[str, float]:
    """The scalar functions of θ behind the closed forms, each rounded once to float64.

    Closed forms and their derivatives by the quotient rule, with digits to spare: c1 loses four
    times those of 1/θ, six times are added. θ = 0 is the limit, taken at 1e-40 (error of order θ²).
    """
    t = mp.mpf(theta) if theta else mp.mpf("1e-40")
    with mp.workdps(DIGITS + 6 * max(0, int(-mp.log10(t)) + 1)):
        s, c = mp.sin(t), mp.cos(t)
        cot = mp.cot(t / 2)
        values = {
            "sinc": s / t,
            "a": (1 - c) / t**2,
            "b": (t - s) / t**3,
            "a1": (t * s - 2 * (1 - c)) / t**4,
            "b1": (t * (1 - c) - 3 * (t - s)) / t**5,
            "c0": (1 - t / 2 * cot) / t**2,
            "c1": (t**2 / 4 * (1 + cot**2) + t / 2 * cot - 2) / t**4,
        }
    return {name: float(value) for name, value in values.items()}


# ---------------------------------------------------------------- constrained body, in space

# Rows of each joint in the order of its multipliers. G is the joint frame on the ground, B the one
# on the body, s the vector from G's origin to B's, g_i and b_i their axes, in ground coordinates:
#   d_i: g_i·s = 0      slot_i: b_i·s = 0      turn_i: b_i·ω = 0      cross_ij: g_i·b_j = 0
#   screw: g_3·s − pitch·φ = 0, at velocity level g_3·ṡ − pitch b_3·ω = 0
#   rod: (s·s − length²)/(2 length) = 0      equal: (g_2·b_1 − g_1·b_2)/2 = 0
JOINT_ROWS: dict[str, str] = {
    "free": "",
    "spherical": "d1 d2 d3",
    "revolute": "d1 d2 d3 turn1 turn2",
    "cylindrical": "d1 d2 turn1 turn2",
    "prismatic": "d1 d2 turn1 turn2 turn3",
    "screw": "d1 d2 screw turn1 turn2",
    "planar": "d3 turn1 turn2",
    "universal": "d1 d2 d3 cross32",
    "pin_in_slot": "d2 d3 turn1 turn2",
    "pin_in_slot_body": "slot2 slot3 turn1 turn2",
    "planar_translation": "d3 turn1 turn2 turn3",
    "translation": "turn1 turn2 turn3",
    "helical_planar": "screw turn1 turn2",
    "schoenflies": "turn1 turn2",
    "fixed": "d1 d2 d3 turn1 turn2 turn3",
    "point_on_line": "d1 d2",
    "point_on_plane": "d3",
    "point_on_sphere": "rod",
    "constant_velocity": "d1 d2 d3 equal",
}


@dataclass(frozen=True)
class Trajectory:
    """States at the requested times; ω and v in the body frame, λ in the order of JOINT_ROWS."""

    t: np.ndarray  # (n,) s
    R: np.ndarray  # (n, 3, 3) body to ground
    r: np.ndarray  # (n, 3) m, the centre of mass in the ground frame
    omega: np.ndarray  # (n, 3) rad/s
    v: np.ndarray  # (n, 3) m/s
    multipliers: np.ndarray  # (n, m) N or N m; the joint's wrench on the body is −Jᵀλ
    reaction: np.ndarray  # (n, 6) N m, N: that wrench, about B's origin and in B's axes


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """a × b; np.cross takes ten times as long."""
    (ax, ay, az), (bx, by, bz) = a.tolist(), b.tolist()
    return np.array([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])


def rotation_matrix(q: np.ndarray) -> np.ndarray:
    """Rotation of a quaternion (w, x, y, z) of any length but 0."""
    w, x, y, z = q / np.linalg.norm(q)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def _row(name: str, s, s_rate, arm, omega, g, b, pitch, length):
    """One row: its parts on ω̇ and on r̈, and what their sum has to be.

    The origin of B is at r + arm, so its acceleration is r̈ + ω̇×arm + ω×(ω×arm).
    """
    kind, index = name.rstrip("123"), [int(i) - 1 for i in name if i.isdigit()]
    zero = np.zeros(3)
    centripetal = _cross(omega, _cross(omega, arm))
    if kind == "turn":  # (b·ω)˙ = b·ω̇ + (ω×b)·ω, the last is 0
        return b[index[0]], zero, 0.0
    if kind == "cross":
        gi, bj = g[index[0]], b[index[1]]
        return _cross(bj, gi), zero, -gi @ _cross(omega, _cross(omega, bj))
    if kind == "equal":
        parts = [
            _row(cross, s, s_rate, arm, omega, g, b, pitch, length)
            for cross in ("cross21", "cross12")
        ]
        return (parts[0][0] - parts[1][0]) / 2, zero, (parts[0][2] - parts[1][2]) / 2
    if kind == "rod":
        along = s / length
        return _cross(arm, along), along, -(s_rate @ s_rate / length + along @ centripetal)
    if kind == "slot":
        bi = b[index[0]]
        bi_rate = _cross(omega, bi)
        rest = _cross(omega, bi_rate) @ s + 2 * bi_rate @ s_rate + bi @ centripetal
        return _cross(bi, s) + _cross(arm, bi), bi, -rest
    gi = g[2 if kind == "screw" else index[0]]
    angular = _cross(arm, gi)
    if kind == "screw":
        angular = angular - pitch * b[2]
    return angular, gi, -gi @ centripetal


def reference_trajectory(
    joint: str,
    times: Sequence[float],
    *,
    mass: float,
    inertia,
    twist0,
    pose0=None,
    ground_frame=None,
    body_frame=None,
    gravity=(0.0, 0.0, 0.0),
    pitch: float = 0.0,
    length: float = 0.0,
    rtol: float = 3e-14,
    atol: float = 1e-14,
) -> Trajectory:
    """Motion of a body on one joint to the ground, at increasing times ≥ 0.

    inertia: (3,) or (3, 3) about the centre of mass, which is the body's origin.   twist0: (ω, v)
    in the body frame.   pose0: 4x4; None closes the joint, C = G B⁻¹.   ground_frame, body_frame:
    4x4, the joint frame seen from the ground and from the body; None is the identity.   pitch: of
    the screw and helical_planar joints, m/rad.   length: of the rod of a point_on_sphere joint, m.

    Newton and Euler about the centre of mass, m r̈ = m g + f and (I ω)˙ = τ, with the joint's rows
    at acceleration level, all in ground coordinates: one linear system for (ω̇, r̈, λ).
    """
    inertia = np.asarray(inertia, float)
    inertia = np.diag(inertia) if inertia.ndim == 1 else inertia
    G = np.eye(4) if ground_frame is None else np.asarray(ground_frame, float)
    B = np.eye(4) if body_frame is None else np.asarray(body_frame, float)
    rod = np.eye(4)
    rod[2, 3] = length
    C = G @ rod @ np.linalg.inv(B) if pose0 is None else np.asarray(pose0, float)
    names = JOINT_ROWS[joint].split()
    weight = mass * np.asarray(gravity, float)
    m = len(names)

    def solution(y):
        """(ω̇, r̈, λ) of the state: quaternion of the turn since t = 0, r, ω, ṙ."""
        R, r, omega, v = rotation_matrix(y[:4]) @ C[:3, :3], y[4:7], y[7:10], y[10:13]
        arm = R @ B[:3, 3]
        s, s_rate = r + arm - G[:3, 3], v + _cross(omega, arm)
        g, b = G[:3, :3].T, (R @ B[:3, :3]).T
        inertia_now = R @ inertia @ R.T
        system, right = np.zeros((6 + m, 6 + m)), np.zeros(6 + m)
        system[:3, :3], system[3:6, 3:6] = inertia_now, mass * np.eye(3)
        right[:3], right[3:6] = -_cross(omega, inertia_now @ omega), weight
        for i, name in enumerate(names, start=6):
            system[i, :3], system[i, 3:6], right[i] = _row(
                name, s, s_rate, arm, omega, g, b, pitch, length
            )
        system[:6, 6:] = system[6:, :6].T
        return np.linalg.solve(system, right)

    def rate(t, y):
        q, omega = y[:4], y[7:10]
        q_rate = 0.5 * np.array([-omega @ q[1:], *(q[0] * omega + _cross(omega, q[1:]))])
        return np.concatenate([q_rate, y[10:13], solution(y)[:6]])

    def reaction(y):
        """What the joint must exert for the body to be accelerated so, by Newton and Euler."""
        turn = rotation_matrix(y[:4]) @ C[:3, :3]
        found, omega = solution(y), y[7:10]
        inertia_now = turn @ inertia @ turn.T
        force = mass * found[3:6] - weight
        torque = inertia_now @ found[:3] + _cross(omega, inertia_now @ omega)
        torque = torque - _cross(turn @ B[:3, 3], force)
        axes = turn @ B[:3, :3]
        return np.concatenate([axes.T @ torque, axes.T @ force])

    R, twist = C[:3, :3], np.asarray(twist0, float)
    y = np.concatenate([[1, 0, 0, 0], C[:3, 3], R @ twist[:3], R @ twist[3:]])
    t, rows = 0.0, []
    for end in times:
        if end > t:  # a run of its own, because interpolated output is of lower order
            run = solve_ivp(rate, (t, end), y, "DOP853", rtol=rtol, atol=atol)
            assert run.success, run.message
            t, y = end, run.y[:, -1]
        R = rotation_matrix(y[:4]) @ C[:3, :3]
        rows.append((t, R, y[4:7], R.T @ y[7:10], R.T @ y[10:13], solution(y)[6:], reaction(y)))
    return Trajectory(*(np.array(column) for column in zip(*rows)))


# ---------------------------------------------------------------- motions in closed form


class Pendulum(NamedTuple):
    """Point at distance `length` below the axis for angle 0; x = length·sin, z = −length·cos."""

    x: float  # m
    z: float  # m
    angle: float  # rad
    rate: float  # rad/s
    period: float  # s


def pendulum(t, *, mass, length, inertia, gravity=9.81, amplitude=None) -> Pendulum:
    """Physical pendulum released from rest at `amplitude` (None: horizontal, π/2), in (0, π).

    length: from the axis to the centre of mass.   inertia: about the centre of mass.
    sin(angle/2) = k sn(K − wt | k²), k = sin(amplitude/2), w² = mgl / (J + ml²), period 4K / w.
    """
    mass, length, inertia, gravity = map(mp.mpf, (mass, length, inertia, gravity))
    k = mp.sin((mp.pi / 2 if amplitude is None else mp.mpf(amplitude)) / 2)
    w = mp.sqrt(mass * gravity * length / (inertia + mass * length**2))
    K = mp.ellipk(k**2)
    u = K - w * mp.mpf(t)
    angle = 2 * mp.asin(k * mp.ellipfun("sn", u, m=k**2))
    rate = -2 * k * w * mp.ellipfun("cn", u, m=k**2)
    state = length * mp.sin(angle), -length * mp.cos(angle), angle, rate, 4 * K / w
    return Pendulum(*map(float, state))


def torque_free_axisymmetric(inertia, omega0, t) -> tuple[np.ndarray, np.ndarray]:
    """Quaternion (from the identity, continuous in t) and body ω of a free body with J₁ = J₂.

    R = exp(t L/J₁) exp(t s e₃): precession about the constant L = J ω₀, spin s = (1 − J₃/J₁) ω₃.
    """
    J1, J2, J3 = map(mp.mpf, inertia)
    assert J1 == J2, "the axis of symmetry is e3"
    w1, w2, w3 = map(mp.mpf, omega0)
    t = mp.mpf(t)
    spin = (1 - J3 / J1) * w3
    precession = [w1, w2, w3 * J3 / J1]
    rate = mp.norm(precession)
    c, sn = mp.cos(rate * t / 2), mp.sin(rate * t / 2)
    x, y, z = (sn * p / rate for p in precession) if rate else (0, 0, 0)
    c3, s3 = mp.cos(spin * t / 2), mp.sin(spin * t / 2)
    q = [c * c3 - z * s3, x * c3 + y * s3, y * c3 - x * s3, c * s3 + z * c3]
    turn = mp.expj(-spin * t) * mp.mpc(w1, w2)
    return to_float(mp.matrix(q)), to_float(mp.matrix([turn.real, turn.imag, w3]))


def torque_free_triaxial(inertia, omega0, t) -> np.ndarray:
    """Body ω of a free body with three different moments of inertia.

    ω_i = a cn, ω_j = b sn, ω_k = c dn of (τ | m), with j the middle axis and k the one that ω
    encircles (of the two extreme ones): Landau and Lifshitz, Mechanics, §37.
    """
    J, w, t = [mp.mpf(x) for x in inertia], [mp.mpf(x) for x in omega0], mp.mpf(t)
    if sum(x != 0 for x in w) < 2:  # a steady spin about one of the axes
        return to_float(mp.matrix(w))
    twice_energy = sum(J[i] * w[i] ** 2 for i in range(3))
    momentum2 = sum((J[i] * w[i]) ** 2 for i in range(3))
    i, j, k = sorted(range(3), key=lambda axis: J[axis])
    if momentum2 < twice_energy * J[j]:
        i, k = k, i
    low, high = momentum2 - twice_energy * J[i], twice_energy * J[k] - momentum2
    a = mp.sqrt(high / (J[i] * (J[k] - J[i])))
    b = mp.sqrt(high / (J[j] * (J[k] - J[j])))
    c = mp.sign(w[k]) * mp.sqrt(low / (J[k] * (J[k] - J[i])))
    m = (J[j] - J[i]) * high / ((J[k] - J[j]) * low)
    handed = 1 if (j - i) % 3 == 1 else -1  # of the axes (i, j, k)
    rate = handed * mp.sign(J[k] - J[i]) * mp.sign(c)
    rate *= mp.sqrt((J[k] - J[j]) * low / (J[0] * J[1] * J[2]))
    tau = mp.ellipf(mp.atan2(w[j] / b, w[i] / a), m) + rate * t
    result = mp.zeros(3, 1)
    for axis, factor, name in ((i, a, "cn"), (j, b, "sn"), (k, c, "dn")):
        result[axis] = factor * mp.ellipfun(name, tau, m=m)
    return to_float(result)
