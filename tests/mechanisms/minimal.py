"""Benchmarks in coordinates of their own, in extended precision: no multipliers, no quaternions.

What two ways have found to the same digits is true: the other way is `mechanisms.oracle`, in
maximal coordinates. Here are
* `Chain`: planar mechanisms as sums of complex exponentials of angles (A03, N-four-bars);
* `OneWay`: mechanisms of one freedom, as a curve of poses, by the principle of d'Alembert, with
  second derivatives from truncated Taylor series (A04, slider-crank, RSSR);
* `DoubleTop`: two bodies on ball joints, by their rotation matrices;
* the elliptic functions of a pendulum (A01, A02), by mpmath.

All states are `numpy.longdouble`: 64 bits of mantissa on x86, 19 digits.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import mpmath
import numpy as np

from mechanisms.extrapolation import integrated

REAL = np.longdouble
PI = REAL("3.14159265358979323846264338327950288")


def solved(A: np.ndarray, b: np.ndarray) -> np.ndarray:
    """A⁻¹b by elimination with pivots: LAPACK has no extended precision."""
    M = np.concatenate([A, b[:, None]], 1)
    n = len(b)
    for k in range(n):
        p = k + int(np.argmax(np.abs(M[k:, k])))
        M[[k, p]] = M[[p, k]]
        M[k + 1 :, k:] -= (M[k + 1 :, k : k + 1] / M[k, k]) * M[k : k + 1, k:]
    x = np.zeros(n, M.dtype)
    for k in reversed(range(n)):
        x[k] = (M[k, n] - M[k, k + 1 : n] @ x[k + 1 :]) / M[k, k]
    return x


# ---- the pendulum, in closed form --------------------------------------------------------------


def pendulum_from_rest(times: Sequence[str], frequency, angle) -> list[tuple]:
    """(sin φ, cos φ) of φ̈ = −frequency² sin φ, from rest at `angle`, in 30 digits."""
    with mpmath.workdps(40):
        w0, k = mpmath.mpf(frequency), mpmath.sin(mpmath.mpf(angle) / 2)
        quarter = mpmath.ellipk(k * k)
        found = []
        for t in times:
            s = k * mpmath.ellipfun("sn", quarter - w0 * mpmath.mpf(t), m=k * k)
            c = mpmath.ellipfun("dn", quarter - w0 * mpmath.mpf(t), m=k * k)
            found.append((2 * s * c, 1 - 2 * s * s))  # sin, cos of φ, of its half
        return found


def pendulum_over_the_top(times: Sequence, square, speed) -> list[tuple]:
    """(sin φ, cos φ) of φ̈ = square·sin φ, φ from upright, φ(0) = 0, φ̇(0) = speed ≠ 0."""
    with mpmath.workdps(40):
        square, speed = mpmath.mpf(square), mpmath.mpf(speed)
        # ψ = φ/2 from upright: ψ̇² = (speed/2)² + square·sin²ψ
        # from hanging, χ = ψ − π/2: χ̇² = W²(1 − m sin²χ)
        W = mpmath.sqrt(speed**2 / 4 + square)
        m = square / W**2
        quarter = mpmath.ellipk(m)
        found = []
        for t in times:
            u = W * mpmath.mpf(t) - quarter
            s, c = mpmath.ellipfun("sn", u, m=m), mpmath.ellipfun("cn", u, m=m)
            sine, cosine = c, -s  # of ψ = χ + π/2
            found.append((2 * sine * cosine, 1 - 2 * sine * sine))
        return found


class LinkState(NamedTuple):
    """Centre of mass x, rotation R, velocity v and angular velocity w, all in ground axes."""

    x: np.ndarray
    R: np.ndarray
    v: np.ndarray
    w: np.ndarray


# ---- planar mechanisms -------------------------------------------------------------------------


class Arm(NamedTuple):
    """z·exp(i·(rows @ q)): a vector of the plane that turns with angles."""

    z: complex
    turns: tuple[float, ...]


class Planar(NamedTuple):
    """A body: mass, inertia about its centre of mass, the arms to that, and how it turns."""

    mass: float
    inertia: float
    com: tuple[Arm, ...]
    turns: tuple[float, ...]


class Pull(NamedTuple):
    """A spring from the ground's `anchor` to the end of arms."""

    arms: tuple[Arm, ...]
    anchor: complex
    stiffness: float
    length: float


@dataclass(frozen=True)
class Chain:
    """Planar bodies on angles q, with loops: arms that end at given places.

    gravity : along −i.   torques : on the angles, constant.
    """

    bodies: tuple[Planar, ...]
    loops: tuple[tuple[tuple[Arm, ...], complex], ...]
    torques: tuple[float, ...]
    gravity: float = 0.0
    springs: tuple[Pull, ...] = ()

    @property
    def size(self) -> int:
        return len(self.torques)

    def end(self, arms, q, w=None):
        """Place, Jacobian and bias of the end of arms: z, dz/dq, z̈ at q̈ = 0."""
        L = np.array([a.turns for a in arms], REAL)
        e = np.array([a.z for a in arms], np.clongdouble) * np.exp(1j * (L @ q))
        jacobian = (1j * e) @ L
        bias = None if w is None else -(e @ (L @ w) ** 2)
        return e.sum(), jacobian, bias

    def rate(self, y: np.ndarray) -> np.ndarray:
        """d/dt of (q, q̇)."""
        n, m = self.size, 2 * len(self.loops)
        q, w = y[:n], y[n:]
        A, b = np.zeros((n + m, n + m), REAL), np.zeros(n + m, REAL)
        b[:n] = np.array(self.torques, REAL)
        for body in self.bodies:
            _, J, bias = self.end(body.com, q, w)
            turns = np.array(body.turns, REAL)
            mass = REAL(body.mass)
            A[:n, :n] += mass * (np.outer(J.real, J.real) + np.outer(J.imag, J.imag))
            A[:n, :n] += REAL(body.inertia) * np.outer(turns, turns)
            force = -mass * (bias + 1j * REAL(self.gravity))
            b[:n] += J.real * force.real + J.imag * force.imag
        for spring in self.springs:
            z, J, _ = self.end(spring.arms, q)
            line = z - np.clongdouble(spring.anchor)
            long = np.abs(line)
            pull = -REAL(spring.stiffness) * (long - REAL(spring.length)) / long * line
            b[:n] += J.real * pull.real + J.imag * pull.imag
        for k, (arms, _) in enumerate(self.loops):
            _, J, bias = self.end(arms, q, w)
            for row, part in enumerate((J.real, J.imag)):
                A[n + 2 * k + row, :n] = A[:n, n + 2 * k + row] = part
            b[n + 2 * k : n + 2 * k + 2] = -bias.real, -bias.imag
        return np.concatenate([w, solved(A, b)[:n]])

    def settled(self, y: np.ndarray) -> np.ndarray:
        """Back onto the loops, by the least change of angles and then of their rates."""
        n = self.size
        q, w = y[:n].copy(), y[n:]
        for _ in range(6):
            ends = [self.end(arms, q) for arms, _ in self.loops]
            off = np.array([z - np.clongdouble(at) for (z, *_), (_, at) in
                            zip(ends, self.loops, strict=True)], np.clongdouble)  # fmt: skip
            J = np.concatenate([np.stack([e[1].real, e[1].imag]) for e in ends])
            if np.max(np.abs(off)) < 1e-19:
                break
            h = np.stack([off.real, off.imag], 1).ravel()
            q -= J.T @ solved(J @ J.T, h)
        w = w - J.T @ solved(J @ J.T, J @ w)
        return np.concatenate([q, w])

    def links(self, y: np.ndarray) -> "list[LinkState]":
        """State of every body, with its frame at the centre of mass, turned by `turns @ q`."""
        q, w = y[: self.size], y[self.size :]
        found, flat = [], lambda z: np.array([z.real, z.imag, 0], REAL)
        for body in self.bodies:
            z, J, _ = self.end(body.com, q, w)
            turns = np.array(body.turns, REAL)
            e, still = np.exp(1j * (turns @ q)), np.array([0, 0, 1], REAL)
            R = np.stack([flat(e), flat(1j * e), still], 1)
            found.append(LinkState(flat(z), R, flat(J @ w), (turns @ w) * still))
        return found

    def motion(self, q, w, times, longest) -> tuple[np.ndarray, float]:
        """(q, q̇) at the times, (times, 2 angles)."""
        start = np.concatenate([np.array(q, REAL), np.array(w, REAL)])
        settled = self.settled if self.loops else lambda y: y
        times = np.array(times, REAL)
        return integrated(self.rate, start, times, longest, settled, tolerance=1e-18)


# ---- one freedom -------------------------------------------------------------------------------


class Jet(NamedTuple):
    """A value and its first two derivatives along a curve."""

    x: np.ndarray
    d: np.ndarray
    dd: np.ndarray

    @classmethod
    def constant(cls, x) -> "Jet":
        x = np.asarray(x, REAL)
        return cls(x, 0 * x, 0 * x)

    def __add__(self, o):
        o = o if isinstance(o, Jet) else Jet.constant(o)
        return Jet(self.x + o.x, self.d + o.d, self.dd + o.dd)

    def __sub__(self, o):
        return self + (o if isinstance(o, Jet) else Jet.constant(o)).by(REAL(-1))

    def by(self, factor):
        return Jet(self.x * factor, self.d * factor, self.dd * factor)

    def _product(self, o, of):
        o = o if isinstance(o, Jet) else Jet.constant(o)
        return Jet(
            of(self.x, o.x),
            of(self.d, o.x) + of(self.x, o.d),
            of(self.dd, o.x) + 2 * of(self.d, o.d) + of(self.x, o.dd),
        )

    def __mul__(self, o):
        return self._product(o, np.multiply)

    def __matmul__(self, o):
        return self._product(o, np.matmul)

    def cross(self, o):
        return self._product(o, np.cross)

    def dot(self, o):
        return self._product(o, np.dot)

    def of(self, f, f1, f2):
        """f of a number, with its derivatives f1 and f2 there."""
        return Jet(f, f1 * self.d, f1 * self.dd + f2 * self.d**2)

    def sin(self):
        return self.of(np.sin(self.x), np.cos(self.x), -np.sin(self.x))

    def cos(self):
        return self.of(np.cos(self.x), -np.sin(self.x), -np.cos(self.x))

    def sqrt(self):
        root = np.sqrt(self.x)
        return self.of(root, 1 / (2 * root), -1 / (4 * root**3))

    def inverse(self):
        return self.of(1 / self.x, -1 / self.x**2, 2 / self.x**3)

    def unit(self):
        return self * self.dot(self).sqrt().inverse()


def vector(*parts) -> Jet:
    """A vector of numbers and jets."""
    jets = [p if isinstance(p, Jet) else Jet.constant(p) for p in parts]
    return Jet(*(np.stack(x) for x in zip(*jets, strict=True)))


def columns(*vectors: Jet) -> Jet:
    """A matrix of its columns."""
    return Jet(*(np.stack(x, 1) for x in zip(*vectors, strict=True)))


def turned(axis: int, angle: Jet) -> Jet:
    """Rotation about a coordinate axis."""
    s, c, one, zero = angle.sin(), angle.cos(), Jet.constant(1), Jet.constant(0)
    e = [[one, zero, zero], [zero, one, zero], [zero, zero, one]]
    j, k = (axis + 1) % 3, (axis + 2) % 3
    e[j][j] = e[k][k] = c
    e[k][j], e[j][k] = s, s.by(REAL(-1))
    return columns(*(vector(*(e[r][col] for r in range(3))) for col in range(3)))


class Moved(NamedTuple):
    """A body on the curve: its centre of mass, its rotation, its inertia about that in its axes."""

    mass: float
    inertia: np.ndarray
    x: Jet
    R: Jet


def _vee(S):
    return np.array([S[2, 1] - S[1, 2], S[0, 2] - S[2, 0], S[1, 0] - S[0, 1]], REAL) / 2


@dataclass(frozen=True)
class OneWay:
    """Bodies whose poses are functions of one coordinate.

    flow : what the coordinates along the curve are as jets, of their values.
    bodies : of these jets.   gravity : (3,).
    """

    flow: Callable[[np.ndarray], list[Jet]]
    bodies: Callable[[list[Jet]], list[Moved]]
    gravity: tuple[float, ...]

    def balance(self, p: np.ndarray):
        """M, C and G of M σ̇ + C σ² = G, with σ the rate along the curve."""
        M, C, G, g = REAL(0), REAL(0), REAL(0), np.array(self.gravity, REAL)
        for body in self.bodies(self.flow(p)):
            m, x, R = REAL(body.mass), body.x, body.R
            w = _vee(R.d @ R.x.T)
            ww = _vee(R.dd @ R.x.T)  # antisymmetric part: that of ω's own rate
            inertia = R.x @ np.asarray(body.inertia, REAL) @ R.x.T
            M += m * (x.d @ x.d) + w @ inertia @ w
            C += m * (x.d @ x.dd) + w @ inertia @ ww
            G += m * (x.d @ g)
        return M, C, G

    def rate(self, y: np.ndarray) -> np.ndarray:
        """d/dt of (coordinates, σ)."""
        M, C, G = self.balance(y[:-1])
        sigma = y[-1]
        along = np.array([j.d for j in self.flow(y[:-1])], REAL)
        return np.append(along * sigma, (G - C * sigma**2) / M)

    def energy(self, y: np.ndarray) -> float:
        """Kinetic and of gravity."""
        bodies = self.bodies(self.flow(y[:-1]))
        g = np.array(self.gravity, REAL)
        return self.balance(y[:-1])[0] * y[-1] ** 2 / 2 - sum(
            REAL(b.mass) * (g @ b.x.x) for b in bodies
        )

    def links(self, y: np.ndarray) -> list[LinkState]:
        found, sigma = [], y[-1]
        for body in self.bodies(self.flow(y[:-1])):
            w = _vee(body.R.d @ body.R.x.T)
            found.append(LinkState(body.x.x, body.R.x, sigma * body.x.d, sigma * w))
        return found

    def motion(self, p, sigma, times, longest) -> tuple[np.ndarray, float]:
        """(coordinates, σ) at the times."""
        start = np.array([*p, sigma], REAL)
        return integrated(self.rate, start, np.array(times, REAL), longest, tolerance=1e-18)


# ---- two tops on each other --------------------------------------------------------------------


@dataclass(frozen=True)
class DoubleTop:
    """Two bodies, a ball joint on the ground and one between them; all in axes of the bodies.

    Of each: mass, inertia about the centre of mass, arm from its upper joint to that; `rod` from
    the first body's upper joint to the lower one. State: R₁, R₂ row by row, ω₁, ω₂ in body axes.
    """

    mass: tuple[float, float]
    inertia: tuple[np.ndarray, np.ndarray]
    arm: tuple[np.ndarray, np.ndarray]
    rod: np.ndarray
    gravity: np.ndarray

    def rate(self, y: np.ndarray) -> np.ndarray:
        R = y[:9].reshape(3, 3), y[9:18].reshape(3, 3)
        w = y[18:21], y[21:24]
        # accelerations of the centres of mass: arms × ω̇ and centripetal, on 6 unknowns ω̇
        lever = [(R[0], self.arm[0], 0)], [(R[0], self.rod, 0), (R[1], self.arm[1], 1)]
        A, b = np.zeros((6, 6), REAL), np.zeros(6, REAL)
        for k in range(2):
            J, bias = np.zeros((3, 6), REAL), np.zeros(3, REAL)
            for rotation, s, i in lever[k]:
                s = np.asarray(s, REAL)
                J[:, 3 * i : 3 * i + 3] += -rotation @ _hat(s)
                bias += rotation @ np.cross(w[i], np.cross(w[i], s))
            m, inertia = REAL(self.mass[k]), np.asarray(self.inertia[k], REAL)
            A += m * J.T @ J
            b += m * J.T @ (np.asarray(self.gravity, REAL) - bias)
            own = slice(3 * k, 3 * k + 3)
            A[own, own] += inertia
            b[own] -= np.cross(w[k], inertia @ w[k])
        rates = [(R[k] @ _hat(w[k])).ravel() for k in range(2)]
        return np.concatenate([*rates, solved(A, b)])

    def settled(self, y: np.ndarray) -> np.ndarray:
        """Rotation matrices that are ones: R ← R(3 − RᵀR)/2."""
        y = y.copy()
        for k in (0, 9):
            R = y[k : k + 9].reshape(3, 3)
            y[k : k + 9] = (R @ (3 * np.eye(3, dtype=REAL) - R.T @ R) / 2).ravel()
        return y

    def links(self, y: np.ndarray) -> list[LinkState]:
        R = y[:9].reshape(3, 3), y[9:18].reshape(3, 3)
        w = y[18:21], y[21:24]
        arm, rod = [np.asarray(a, REAL) for a in self.arm], np.asarray(self.rod, REAL)
        x = R[0] @ arm[0], R[0] @ rod + R[1] @ arm[1]
        v = (
            R[0] @ np.cross(w[0], arm[0]),
            R[0] @ np.cross(w[0], rod) + R[1] @ np.cross(w[1], arm[1]),
        )
        return [LinkState(x[k], R[k], v[k], R[k] @ w[k]) for k in range(2)]

    def energy(self, y: np.ndarray):
        g, total = np.asarray(self.gravity, REAL), REAL(0)
        for k, link in enumerate(self.links(y)):
            w, m = link.R.T @ link.w, REAL(self.mass[k])
            total += m * (link.v @ link.v / 2 - g @ link.x)
            total += w @ np.asarray(self.inertia[k], REAL) @ w / 2
        return total

    def motion(self, R, w, times, longest) -> tuple[np.ndarray, float]:
        start = np.concatenate([np.array(x, REAL).ravel() for x in (*R, *w)])
        times = np.array(times, REAL)
        return integrated(self.rate, start, times, longest, self.settled, tolerance=1e-18)


def _hat(v) -> np.ndarray:
    x, y, z = v
    return np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]], REAL)
