"""Independent reference solutions: nothing here comes from `lierb`.

Three parts, each a different route to numbers that the library computes:

* `lie[group]`: exp, log, Ad, ad, dexp and dexpinv of a matrix group from their *definitions*
  (power series of its generators) at more than 50 digits; `coefficients`, the functions of θ;
* `reference_trajectory`: the constrained body as Newton and Euler wrote it, about the centre of
  mass, all in ground coordinates, joints made of points and axes in space, integrated by DOP853,
  with the forces of `constant_wrench`, `spring_damper`, `torsional_spring`, `drag`,
  `motor_torque` and `wrench` on it;
* motions that are known in closed form: `pendulum`, `torque_free_axisymmetric`,
  `torque_free_triaxial`.

Conventions: vectors of 6 are (angular, linear); a configuration of se3 or so3xr3 is a 4x4 matrix
with R and r (for so3xr3 only a container: the product is (R₁R₂, r₁ + r₂)); dexp is
right-trivialised, dexp_X(Ẋ) = Ċ C⁻¹; quaternions are (w, x, y, z).
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import mpmath
import numpy as np
from scipy.integrate import solve_ivp
from scipy.linalg import expm

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
        x, one = self.hat(X), mp.eye(self.size)
        return self._between(x, one) - self._between(one, x)

    def Ad(self, C):
        """Matrix of Y ↦ C Y C⁻¹."""
        g = self.matrix(C)
        return self._between(g, mp.inverse(g))

    def _between(self, left, right):
        """Matrix of Y ↦ left Y right, in components."""
        result = mp.zeros(self.dim)
        for i, (p, q) in enumerate(self.places):
            for j, (r, c) in enumerate(self.places):
                turned = left[p, c] * right[r, q] if j < 3 else 0
                result[i, j] = left[p, r] * right[c, q] - turned
        return result

    def dexp(self, X):
        """Right-trivialised differential of exp: Σ ad_X^k / (k + 1)!."""
        return self._dexp(tuple(X))

    @cache  # noqa: B019 -- there are three groups, for good
    def _dexp(self, X):
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


class RowKind(NamedTuple):
    """A kind of row by its definition: h of D = G⁻¹ C B = (Q, d), zero where the joint is closed.

    G is the joint frame on the ground, B the one on the body.   value : of Q, d, the row's axes
    (0, 1, 2) and its size, in floats or mpmath's numbers.   size : what the joint needs for it.
    """

    value: Callable
    size: str = ""


def _slip(Q, d, axes, pitch):
    """d₃ − pitch·φ, to the nearest turn."""
    slip, turn = d[2] - pitch * mp.atan2(Q[1, 0], Q[0, 0]), 2 * mp.pi * pitch
    return slip - turn * mp.nint(slip / turn) if pitch else slip


def _kept(Q, d, axes, size):
    """Entry of Q that is zero where all of a joint's rows of angular velocity hold."""
    return Q[((1, 2), (0, 2), (1, 0))[axes[0]]]


def _twist(Q, d, axes, size):
    """2z of Q's quaternion: zero where two shafts have turned by the same."""
    xi = _rotation_vector(Q)
    angle = mp.norm(xi)
    return 2 * mp.sin(angle / 2) * xi[2] / angle if angle else mp.zero


ROW_KINDS = {
    "d": RowKind(lambda Q, d, axes, size: d[axes[0]]),
    "Qtd": RowKind(lambda Q, d, axes, size: sum(Q[k, axes[0]] * d[k] for k in range(3))),
    "Q": RowKind(lambda Q, d, axes, size: Q[axes]),
    "Omega": RowKind(_kept),
    "screw": RowKind(_slip, "pitch"),
    "rod": RowKind(lambda Q, d, axes, size: (sum(x * x for x in d) / size - size) / 2, "length"),
    "cv": RowKind(_twist),
}


def row_parts(name: str) -> tuple[str, tuple[int, ...]]:
    """Kind and axes of a row: Q32 is ("Q", (2, 1))."""
    kind = name.rstrip("123")
    return kind, tuple(int(i) - 1 for i in name[len(kind) :])


def row_value(name: str, Q, d, pitch=0.0, length=0.0):
    """h of a row on D = (Q, d)."""
    kind, axes = row_parts(name)
    definition = ROW_KINDS[kind]
    return definition.value(Q, d, axes, {"pitch": pitch, "length": length}.get(definition.size))


def row_values(joint: str, D, pitch=0.0, length=0.0) -> list:
    """h of all rows of a joint on D, 4x4."""
    Q, d = D[:3, :3], D[:3, 3]
    return [row_value(name, Q, d, pitch, length) for name in JOINT_ROWS[joint].split()]


def row_jacobian(joint: str, D, pitch=0.0, length=0.0) -> np.ndarray:
    """Derivatives of `row_values` along D exp(t X), (rows, 6): differences in 80 digits."""
    D, h, sides = mp.matrix(np.asarray(D).tolist()), mp.mpf("1e-30"), []
    for sign in (1, -1):
        moved = [D + sign * h * D * lie["se3"].hat(e) for e in np.eye(6)]
        sides.append(np.array([row_values(joint, x, pitch, length) for x in moved], object))
    return ((sides[0] - sides[1]) / (2 * h)).astype(float).T


def relative_pose_on(joint: str, start, pitch=0.0, length=0.0) -> np.ndarray:
    """D near `start`, 4x4, on all rows of a joint: Newton's method."""
    D = np.asarray(start, float)
    for _ in range(8):
        values = np.array(row_values(joint, D, pitch, length), dtype=float)
        J = row_jacobian(joint, D, pitch, length)
        step = lie["se3"].hat(-np.linalg.lstsq(J, values, rcond=None)[0])
        D = D @ expm(to_float(step))
    return D


def sizes_of(joint: str, **sizes: float) -> dict[str, float]:
    """Arguments pitch= and length= that a joint's rows need."""
    needed = {ROW_KINDS[row_parts(name)[0]].size for name in JOINT_ROWS[joint].split()}
    return {name: size for name, size in sizes.items() if name in needed}


# Rows of each joint in the order of its multipliers. With s the vector from G's origin to B's and
# g_i and b_i their axes, in ground coordinates:
#   d_i: g_i·s = 0      Qtd_i: b_i·s = 0      Omega_i: b_i·ω = 0      Q_ij: g_i·b_j = 0
#   screw: g_3·s − pitch·φ = 0, at velocity level g_3·ṡ − pitch b_3·ω = 0
#   rod: (s·s − length²)/(2 length) = 0
#   cv: n·ω = 0, n the unit bisector of g_3 and b_3: the same turn about both of them
JOINT_ROWS: dict[str, str] = {
    "free": "",
    "spherical": "d1 d2 d3",
    "revolute": "d1 d2 d3 Omega1 Omega2",
    "cylindrical": "d1 d2 Omega1 Omega2",
    "prismatic": "d1 d2 Omega1 Omega2 Omega3",
    "screw": "d1 d2 screw Omega1 Omega2",
    "planar": "d3 Omega1 Omega2",
    "universal": "d1 d2 d3 Q32",
    "hook": "d1 d2 d3 Q23",
    "pin_in_slot": "d2 d3 Omega1 Omega2",
    "pin_in_slot_body": "Qtd2 Qtd3 Omega1 Omega2",
    "planar_translation": "d3 Omega1 Omega2 Omega3",
    "translation": "Omega1 Omega2 Omega3",
    "helical_planar": "screw Omega1 Omega2",
    "schoenflies": "Omega1 Omega2",
    "fixed": "d1 d2 d3 Omega1 Omega2 Omega3",
    "point_on_line": "d1 d2",
    "point_on_plane": "d3",
    "point_on_sphere": "rod",
    "constant_velocity": "d1 d2 d3 cv",
}


@dataclass(frozen=True)
class Trajectory:
    """States at the requested times; ω and v in the body frame.

    λ in the order of JOINT_ROWS, then those of the extra rows, then that of the prescribed speed.
    """

    t: np.ndarray  # (n,) s
    R: np.ndarray  # (n, 3, 3) body to ground
    r: np.ndarray  # (n, 3) m, the centre of mass in the ground frame
    omega: np.ndarray  # (n, 3) rad/s
    v: np.ndarray  # (n, 3) m/s
    multipliers: np.ndarray  # (n, m) N or N m; the wrench of the rows J on the body is −Jᵀλ
    reaction: np.ndarray  # (n, 6) N m, N: the joint's, with its speed's, about B's origin, B's axes
    energy: np.ndarray  # (n,) J, kinetic, of gravity, and of the forces that have a potential


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


# ---------------------------------------------------------------- forces on the body


class State(NamedTuple):
    """Motion that the caller's forces and rows receive. The body's origin is its centre of mass."""

    t: float  # s
    R: np.ndarray  # (3, 3) body to ground
    r: np.ndarray  # (3,) m, the centre of mass in the ground frame
    omega: np.ndarray  # (3,) rad/s, in ground axes
    v: np.ndarray  # (3,) m/s, ṙ
    G: np.ndarray  # (4, 4) the joint frame on the ground, seen from the ground
    B: np.ndarray  # (4, 4) the joint frame on the body, seen from the body

    @property
    def axis(self) -> np.ndarray:
        """(3,) e3 of the body's joint frame, in ground axes."""
        return self.R @ self.B[:3, 2]

    def seen(self, body_point, ground_point=(0.0, 0.0, 0.0)):
        """A point of the body, given in the body frame, seen from one of the ground.

        (3,) m from the centre of mass to it, (3,) m from the ground's point to it, and its
        velocity (3,) m/s, all in ground axes.
        """
        arm = self.R @ body_point
        return arm, self.r + arm - ground_point, self.v + _cross(self.omega, arm)


@dataclass(frozen=True)
class Force:
    """Called with a state: ((3,) N m about the centre of mass, (3,) N), both in ground axes."""

    load: Callable[[State], tuple[np.ndarray, np.ndarray]]
    potential: Callable[[State], float] | None = None  # J, of what of it is conservative

    def __call__(self, state: State) -> tuple[np.ndarray, np.ndarray]:
        return self.load(state)


def _vectors(*values):
    return [np.array(value, float) for value in values]


def constant_wrench(
    torque=(0.0, 0.0, 0.0), force=(0.0, 0.0, 0.0), point=(0.0, 0.0, 0.0), frame="ground"
) -> Force:
    """(3,) N m, and (3,) N at a point (3,) m of the body, constant in "ground" or in "body" axes.

    Potential −f·x of a force that is constant in the ground; a torque has none.
    """
    torque, force, point = _vectors(torque, force, point)
    assert frame in ("ground", "body"), frame
    if frame == "body":
        whole = torque + _cross(point, force)
        return Force(lambda state: (state.R @ whole, state.R @ force))
    return Force(
        lambda state: (torque + _cross(state.R @ point, force), force),
        lambda state: -force @ state.seen(point)[1],
    )


def spring_damper(body_point, ground_point, stiffness, damping=0.0, length=0.0) -> Force:
    """Force −(k (ℓ − length) + c ℓ˙) along the line from a ground point to a body point.

    body_point: (3,) m in the body frame.   ground_point: (3,) m in the ground frame.
    stiffness: N/m.   damping: N s/m.   length: m, at rest.   Potential ½ k (ℓ − length)².
    Where the points meet, the line is the one along which they are about to part.
    """
    body_point, ground_point = _vectors(body_point, ground_point)

    def load(state):
        arm, s, s_rate = state.seen(body_point, ground_point)
        stretched = math.hypot(*s)
        along = s if stretched else s_rate
        along = along / (math.hypot(*along) or 1.0)
        force = -(stiffness * (stretched - length) + damping * (along @ s_rate)) * along
        return _cross(arm, force), force

    def potential(state):
        return stiffness / 2 * (math.hypot(*state.seen(body_point, ground_point)[1]) - length) ** 2

    return Force(load, potential)


def wrapped(angle: float) -> float:
    """The angle less a number of turns, in (−π, π]."""
    rest = math.remainder(angle, 2 * math.pi)
    return math.pi if rest == -math.pi else rest


def torsional_spring(stiffness, damping=0.0, angle=0.0) -> Force:
    """Torque −(k wrapped(φ − angle) + c φ˙) about e3, for joints that keep e3 parallel to itself.

    φ: turn of the body's joint frame against the ground's, about e3.   stiffness: N m/rad.
    damping: N m s/rad.   angle: rad, at rest.   Potential ½ k wrapped(φ − angle)².
    """

    def turn(state):
        g, b1 = state.G[:3, :3].T, state.R @ state.B[:3, 0]
        return wrapped(math.atan2(g[1] @ b1, g[0] @ b1) - angle)

    def load(state):
        torque = -(stiffness * turn(state) + damping * (state.axis @ state.omega))
        return torque * state.axis, np.zeros(3)

    return Force(load, lambda state: stiffness / 2 * turn(state) ** 2)


def drag(linear=0.0, quadratic=0.0, angular=0.0, point=(0.0, 0.0, 0.0)) -> Force:
    """Force −(linear + quadratic |u|) u on a body point that moves with u, torque −angular ω.

    linear: N s/m.   quadratic: N s²/m².   angular: N m s.   point: (3,) m in the body frame.
    """
    (point,) = _vectors(point)

    def load(state):
        arm, _, u = state.seen(point)
        force = -(linear + quadratic * math.hypot(*u)) * u
        return _cross(arm, force) - angular * state.omega, force

    return Force(load)


def motor_torque(torque: Callable[[float], float]) -> Force:
    """Torque, a function of t in N m, about e3 of the body's joint frame; not of the reaction."""
    return Force(lambda state: (torque(state.t) * state.axis, np.zeros(3)))


def wrench(function) -> Force:
    """function(t, R, r, ω, v) with ω and v in the body frame: (3,) N m about its origin, (3,) N.

    Torque and force in body axes.
    """

    def load(state):
        R = state.R
        torque, force = function(state.t, R, state.r, R.T @ state.omega, R.T @ state.v)
        return R @ torque, R @ force

    return Force(load)


def rod_rows(body_point, ground_point, length):
    """Extra row (s·s − length²)/(2 length) = 0 of a massless rod: a function for `extra_rows`.

    s from a point of the ground, (3,) m, to one of the body, (3,) m in its frame.   length: m.
    """
    body_point, ground_point = _vectors(body_point, ground_point)

    def rows(state):
        arm, s, s_rate = state.seen(body_point, ground_point)
        omega, along = state.omega, s / length
        rest = s_rate @ s_rate / length + along @ _cross(omega, _cross(omega, arm))
        return np.array([[*_cross(arm, along), *along]]), np.array([-rest])

    return rows


# ---------------------------------------------------------------- motion


def _row(name: str, s, s_rate, arm, omega, g, b, pitch, length):
    """One row: its parts on ω̇ and on r̈, and what their sum has to be.

    The origin of B is at r + arm, so its acceleration is r̈ + ω̇×arm + ω×(ω×arm).
    """
    kind, index = row_parts(name)
    zero = np.zeros(3)
    centripetal = _cross(omega, _cross(omega, arm))
    if kind == "Omega":  # (b·ω)˙ = b·ω̇ + (ω×b)·ω, the last is 0
        return b[index[0]], zero, 0.0
    if kind == "Q":
        gi, bj = g[index[0]], b[index[1]]
        return _cross(bj, gi), zero, -gi @ _cross(omega, _cross(omega, bj))
    if kind == "cv":  # ṅ·ω is along (ω×b_3)·ω, which is 0
        return (g[2] + b[2]) / np.linalg.norm(g[2] + b[2]), zero, 0.0
    if kind == "rod":
        along = s / length
        return _cross(arm, along), along, -(s_rate @ s_rate / length + along @ centripetal)
    if kind == "Qtd":
        bi = b[index[0]]
        bi_rate = _cross(omega, bi)
        rest = _cross(omega, bi_rate) @ s + 2 * bi_rate @ s_rate + bi @ centripetal
        return _cross(bi, s) + _cross(arm, bi), bi, -rest
    if kind == "screw":
        return _cross(arm, g[2]) - pitch * b[2], g[2], -g[2] @ centripetal
    if kind == "d":
        gi = g[index[0]]
        return _cross(arm, gi), gi, -gi @ centripetal
    raise KeyError(name)


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
    forces: Sequence[Force] = (),
    extra_rows: Callable[[State], tuple[np.ndarray, np.ndarray]] | None = None,
    speed: tuple[Callable[[float], float], Callable[[float], float]] | None = None,
    rtol: float = 3e-14,
    atol: float = 1e-14,
) -> Trajectory:
    """Motion of a body on one joint to the ground, at increasing times ≥ 0.

    inertia: (3,) or (3, 3) about the centre of mass, which is the body's origin.   twist0: (ω, v)
    in the body frame.   pose0: 4x4; None closes the joint, C = G B⁻¹.   ground_frame, body_frame:
    4x4, the joint frame seen from the ground and from the body; None is the identity.   pitch: of
    the screw and helical_planar joints, m/rad.   length: of the rod of a point_on_sphere joint, m.
    forces: on the body, besides gravity.   extra_rows: further constraints, of a state
    A (k, 6) and b (k,) with A (ω̇, r̈) = b; they are no part of the reaction.   speed: w and dw/dt,
    functions of t, rad/s and rad/s²: a motor in the joint keeps b_3·ω = w.

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
    n = len(names)

    def state(t, y):
        """Variables: quaternion of the rotation since t = 0, r, ω, ṙ."""
        return State(t, rotation_matrix(y[:4]) @ C[:3, :3], y[4:7], y[7:10], y[10:13], G, B)

    def applied(now):
        """Torque about the centre of mass and force of gravity and of `forces`."""
        torque, total = np.zeros(3), weight
        for force in forces:
            tau, f = force(now)
            torque, total = torque + tau, total + f
        return torque, total

    def solution(now):
        """(ω̇, r̈, λ)."""
        R, omega, m = now.R, now.omega, n + k + (speed is not None)
        arm, s, s_rate = now.seen(B[:3, 3], G[:3, 3])
        g, b = G[:3, :3].T, (R @ B[:3, :3]).T
        inertia_now = R @ inertia @ R.T
        torque, force = applied(now)
        system, right = np.zeros((6 + m, 6 + m)), np.zeros(6 + m)
        system[:3, :3], system[3:6, 3:6] = inertia_now, mass * np.eye(3)
        right[:3], right[3:6] = torque - _cross(omega, inertia_now @ omega), force
        for i, name in enumerate(names, start=6):
            system[i, :3], system[i, 3:6], right[i] = _row(
                name, s, s_rate, arm, omega, g, b, pitch, length
            )
        if extra_rows:
            system[6 + n : 6 + n + k, :6], right[6 + n : 6 + n + k] = extra_rows(now)
        if speed:  # (b·ω)˙ = b·ω̇, as in the rows that forbid to turn
            system[-1, :3], right[-1] = b[2], speed[1](now.t)
        system[:6, 6:] = system[6:, :6].T
        return np.linalg.solve(system, right)

    def rate(t, y):
        q, omega = y[:4], y[7:10]
        q_rate = 0.5 * np.array([-omega @ q[1:], *(q[0] * omega + _cross(omega, q[1:]))])
        return np.concatenate([q_rate, y[10:13], solution(state(t, y))[:6]])

    def reaction(now, found):
        """Wrench of the joint for these accelerations, by Newton and Euler."""
        inertia_now = now.R @ inertia @ now.R.T
        torque, force = applied(now)
        force = mass * found[3:6] - force
        torque = inertia_now @ found[:3] + _cross(now.omega, inertia_now @ now.omega) - torque
        if extra_rows:
            rest = extra_rows(now)[0].T @ found[6 + n : 6 + n + k]
            torque, force = torque + rest[:3], force + rest[3:]
        torque = torque - _cross(now.R @ B[:3, 3], force)
        axes = now.R @ B[:3, :3]
        return np.concatenate([axes.T @ torque, axes.T @ force])

    def energy(now):
        omega = now.R.T @ now.omega
        kinetic = (mass * now.v @ now.v + omega @ inertia @ omega) / 2
        return kinetic - weight @ now.r + sum(f.potential(now) for f in forces if f.potential)

    R, twist = C[:3, :3], np.asarray(twist0, float)
    y = np.concatenate([[1, 0, 0, 0], C[:3, 3], R @ twist[:3], R @ twist[3:]])
    k = len(extra_rows(state(0.0, y))[1]) if extra_rows else 0
    if speed:
        turning = B[:3, 2] @ twist[:3]
        assert math.isclose(turning, speed[0](0.0), abs_tol=1e-12), "twist0 has not that speed"
    t, rows = 0.0, []
    for end in times:
        if end > t:  # a run of its own, because interpolated output is of lower order
            run = solve_ivp(rate, (t, end), y, "DOP853", rtol=rtol, atol=atol)
            assert run.success, run.message
            t, y = end, run.y[:, -1]
        now = state(t, y)
        found, R = solution(now), now.R
        twist_now = R.T @ now.omega, R.T @ now.v
        rows.append((t, R, now.r, *twist_now, found[6:], reaction(now, found), energy(now)))
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
