"""World-frame oracle of mechanisms: nothing here knows a formula of `lierb`'s kernels.

Every body is a centre of mass, a unit quaternion and two velocities, all in ground axes. Joints are
what one would draw: points that coincide, axes that stay parallel or perpendicular, an angle that a
rise goes with. Newton's and Euler's equations with these conditions twice differentiated give
accelerations and multipliers, by a singular value decomposition: rows may say a thing twice. The
states are integrated by extrapolation (`mechanisms.extrapolation`), and put back onto all
conditions after each step, in the mass metric.

Everything has a leading axis of n trajectories. Poses are (n, links, 4, 4), twists (n, links, 6),
body-fixed (ω, v) of the user's body frame, as on the public face of lierb.

What reads and makes lierb's objects (`description_of`, `random_mechanism`) is in
`mechanisms.samples`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from oracle import JOINT_ROWS

from mechanisms.extrapolation import integrated

RANK_TOLERANCE = 1e-7  # of the largest singular value: what is smaller says the same twice
LONGEST_STEP = 0.1  # s; steps get shorter where their estimated error asks for it
TOLERANCE = 1e-14  # of a step
CLOSED = 1e-14  # rad and m
NEWTON_STEPS = 8


# ---- what there is -----------------------------------------------------------------------------


@dataclass(frozen=True)
class Body:
    """mass (n,), inertia (n, 3, 3) about the body frame's origin in its axes, com (n, 3)."""

    mass: np.ndarray
    inertia: np.ndarray
    com: np.ndarray


@dataclass(frozen=True)
class Joint:
    """A joint between frame B on a body and frame G on its parent; parent None is the ground.

    kind : a key of `CONDITIONS`.   B, G : (n, 4, 4).   pitch, length : (n,).
    """

    kind: str
    body: int
    parent: int | None
    B: np.ndarray
    G: np.ndarray
    pitch: np.ndarray
    length: np.ndarray


@dataclass(frozen=True)
class AxisTorque:
    """Torque about e₃ of a joint, on its body; the parent gets the reaction. All (n,).

    torque − stiffness·(φ − angle) − damping·Ω₃, with φ − angle brought to [−π, π].
    """

    joint: int
    torque: np.ndarray | float = 0.0
    stiffness: np.ndarray | float = 0.0
    damping: np.ndarray | float = 0.0
    angle: np.ndarray | float = 0.0


@dataclass(frozen=True)
class Spring:
    """Spring and damper from a point of `other` (None: the ground) to one of `body`."""

    body: int
    other: int | None
    point: np.ndarray  # (n, 3), on the body
    anchor: np.ndarray  # (n, 3), on the other
    stiffness: np.ndarray | float = 0.0
    damping: np.ndarray | float = 0.0
    length: np.ndarray | float = 0.0


@dataclass(frozen=True)
class Description:
    """A mechanism as numbers. The joints of the links come first, then those of the loops."""

    bodies: Sequence[Body]
    joints: Sequence[Joint]
    gravity: np.ndarray  # (n, 3)
    forces: Sequence[AxisTorque | Spring] = field(default_factory=tuple)

    @property
    def size(self) -> int:
        return max(len(b.mass) for b in self.bodies)


# ---- vectors that move with bodies -------------------------------------------------------------


class Moving(NamedTuple):
    """A vector, or a number, as a function of two bodies' motion.

    value (n, …), rate (n, …), jacobian (n, …, 12) on (ẋ, ω) of body and parent, and bias (n, …):
    its second derivative is jacobian·(ẍ, ω̇) + bias.
    """

    value: np.ndarray
    rate: np.ndarray
    jacobian: np.ndarray
    bias: np.ndarray

    def __sub__(self, other: "Moving") -> "Moving":
        return Moving(*(a - b for a, b in zip(self, other, strict=True)))

    def __add__(self, other: "Moving") -> "Moving":
        return Moving(*(a + b for a, b in zip(self, other, strict=True)))

    def times(self, factor: np.ndarray) -> "Moving":
        """Product of a number and a constant one, (n,)."""
        scaled = (x * factor for x in (self.value, self.rate, self.bias))
        value, rate, bias = scaled
        return Moving(value, rate, self.jacobian * factor[:, None], bias)


def dot(a: Moving, b: Moving) -> Moving:
    """Scalar product, by the product rule twice."""
    inner = lambda x, y: np.sum(x * y, -1)
    jacobian = (a.value[:, None] @ b.jacobian + b.value[:, None] @ a.jacobian)[:, 0]
    return Moving(
        inner(a.value, b.value),
        inner(a.rate, b.value) + inner(a.value, b.rate),
        jacobian,
        inner(a.bias, b.value) + inner(a.value, b.bias) + 2.0 * inner(a.rate, b.rate),
    )


_SKEW = np.zeros((3, 9))  # v @ _SKEW are the entries of v×
_SKEW[0, 5], _SKEW[0, 7] = -1.0, 1.0
_SKEW[1, 2], _SKEW[1, 6] = 1.0, -1.0
_SKEW[2, 1], _SKEW[2, 3] = -1.0, 1.0


def skew(v: np.ndarray) -> np.ndarray:
    """(…, 3) → (…, 3, 3), of v × ·"""
    return (v @ _SKEW).reshape(*v.shape, 3)


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """a × b, (…, 3): a tenth of the time that NumPy's takes for few of them."""
    return (skew(a) @ b[..., None])[..., 0]


class Placed(NamedTuple):
    """A body in the world: x, u (n, 3) of the centre of mass, R (n, 3, 3), w (n, 3)."""

    x: np.ndarray
    R: np.ndarray
    u: np.ndarray
    w: np.ndarray

    def fixed(self, v: np.ndarray, side: int) -> Moving:
        """A vector (n, 3) of the body; side 0 is the joint's body, 1 its parent."""
        return self.axes(v[..., None], side)[0]

    def axes(self, columns: np.ndarray, side: int) -> list[Moving]:
        """Vectors of the body, the columns of (n, 3, k)."""
        value, turning = self.R @ columns, skew(self.w)
        rate = turning @ value
        bias = turning @ rate
        components = []
        for k in range(columns.shape[-1]):
            jacobian = np.zeros((len(value), 3, 12))
            jacobian[:, :, 6 * side + 3 : 6 * side + 6] = -skew(value[..., k])
            components.append(Moving(value[..., k], rate[..., k], jacobian, bias[..., k]))
        return components

    def point(self, s: np.ndarray, side: int) -> Moving:
        """A point of the body, s (n, 3) from its centre of mass in its axes."""
        arm = self.fixed(s, side)
        arm.jacobian[:, :, 6 * side : 6 * side + 3] = np.eye(3)
        return Moving(self.x + arm.value, self.u + arm.rate, arm.jacobian, arm.bias)

    def turning(self, side: int) -> Moving:
        """ω as if it were the rate of a vector: of use in products with fixed vectors only."""
        jacobian = np.zeros((*self.w.shape, 12))
        jacobian[:, :, 6 * side + 3 : 6 * side + 6] = np.eye(3)
        return Moving(np.zeros_like(self.w), self.w, jacobian, np.zeros_like(self.w))


# ---- joints, as conditions on points and axes --------------------------------------------------


class Seen(NamedTuple):
    """A joint in the world: from its parent's point to its body's, axes f of B and g of G."""

    arm: Moving
    f: list[Moving]
    g: list[Moving]
    w: Moving  # of the body, seen from the parent
    pitch: np.ndarray
    length: np.ndarray


def _held(i):  # the body's point stays in a plane of the parent
    return lambda s: dot(s.g[i - 1], s.arm)


def _slotted(i):  # the parent's point stays in a plane of the body
    return lambda s: dot(s.f[i - 1], s.arm)


def _across(i, j):  # gᵢ of the parent stays perpendicular to fⱼ of the body
    return lambda s: dot(s.g[i - 1], s.f[j - 1])


def _equal_turn(s):  # the trace of what two shafts have turned: f₁·g₂ = f₂·g₁
    return dot(s.g[1], s.f[0]) - dot(s.g[0], s.f[1])


def _rise(s):
    """g₃·arm − pitch·φ, to the nearest turn; φ̇ is the relative ω about g₃ while f₃ = g₃."""
    cosine, sine = dot(s.g[0], s.f[0]).value, dot(s.g[1], s.f[0]).value
    rise, turned = dot(s.g[2], s.arm), dot(s.g[2], s.w)
    # the rate of a vector that has none of its own: dot() counts the change of g₃ twice over
    bias = np.einsum("ni,ni->n", s.g[2].rate, s.w.rate)
    rate = np.einsum("ni,ni->n", s.g[2].value, s.w.rate)
    angle = Moving(np.arctan2(sine, cosine), rate, turned.jacobian, bias)
    residual = rise - angle.times(s.pitch)
    whole = 2.0 * np.pi * np.where(s.pitch == 0.0, 1.0, s.pitch)
    lost = np.where(s.pitch == 0.0, 0.0, whole * np.rint(residual.value / whole))
    return residual._replace(value=residual.value - lost)


def _at_length(square: Moving, length: np.ndarray) -> Moving:
    """(square − length²)/(2 length)."""
    level = Moving(length**2, 0.0 * length, np.zeros_like(square.jacobian), 0.0 * length)
    return (square - level).times(0.5 / length)


def _apart(s):  # a distance between two points
    return _at_length(dot(s.arm, s.arm), s.length)


# By the names that rows have in the oracle of one body; f₃ is along g₃ by Omega1 and Omega2.
ROWS = {
    **{f"d{i}": _held(i) for i in (1, 2, 3)},
    **{f"Qtd{i}": _slotted(i) for i in (1, 2, 3)},
    "Q32": _across(3, 2),
    "Q23": _across(2, 3),
    "Omega1": _across(1, 3),
    "Omega2": _across(2, 3),
    "Omega3": _across(1, 2),
    "screw": _rise,
    "rod": _apart,
    "cv": _equal_turn,
}
CONDITIONS = {joint: [ROWS[n] for n in names.split()] for joint, names in JOINT_ROWS.items()}


# ---- rotations ---------------------------------------------------------------------------------


def matrix_of(q: np.ndarray) -> np.ndarray:
    """(…, 4) unit quaternions (w, x, y, z) → (…, 3, 3)."""
    w, v = q[..., :1, None], q[..., 1:]
    outer = v[..., :, None] * v[..., None, :]
    square = np.sum(v * v, axis=-1)[..., None, None]
    return (w * w - square) * np.eye(3) + 2.0 * outer + 2.0 * w * skew(v)


def quaternion_of(R: np.ndarray) -> np.ndarray:
    """(…, 3, 3) → (…, 4): the eigenvector of the largest eigenvalue (Bar-Itzhack 2000)."""
    K = np.empty((*R.shape[:-2], 4, 4))
    trace = np.trace(R, axis1=-2, axis2=-1)
    vector = np.stack(
        [R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]], -1
    )
    K[..., 0, 0] = trace
    K[..., 0, 1:] = K[..., 1:, 0] = vector
    K[..., 1:, 1:] = R + np.swapaxes(R, -1, -2) - trace[..., None, None] * np.eye(3)
    return np.linalg.eigh(K)[1][..., :, -1]


def product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Product of quaternions (…, 4)."""
    scalar = a[..., :1] * b[..., :1] - np.sum(a[..., 1:] * b[..., 1:], -1, keepdims=True)
    vector = a[..., :1] * b[..., 1:] + b[..., :1] * a[..., 1:] + cross(a[..., 1:], b[..., 1:])
    return np.concatenate([scalar, vector], -1)


# ---- the system --------------------------------------------------------------------------------


class System:
    """The equations of motion of a description.

    A state is (n, links, 13): centre of mass, quaternion, its velocity and ω, all in ground axes.
    """

    def __init__(self, description: Description):
        self.given = description
        n = description.size
        stacked = lambda of, *shape: np.stack(
            [np.broadcast_to(of(b), (n, *shape)) for b in description.bodies], 1
        )
        self.mass = stacked(lambda b: b.mass)
        self.com = stacked(lambda b: b.com, 3)
        square = np.sum(self.com**2, -1)[..., None, None] * np.eye(3)
        steiner = square - self.com[..., :, None] * self.com[..., None, :]
        about_origin = stacked(lambda b: b.inertia, 3, 3)
        self.inertia = about_origin - self.mass[..., None, None] * steiner  # about the com
        self.root = np.linalg.cholesky(self.inertia)
        self.gravity = np.broadcast_to(description.gravity, (n, 3))
        self.size, self.links = n, len(description.bodies)
        self.rank: np.ndarray | None = None

    def inverse(self, A: np.ndarray) -> np.ndarray:
        """A⁺ (n, 6·links, rows), of `rank` where that is known.

        Between the steps states are off the conditions by a little. Where rows say a thing twice,
        as in A04, they contradict each other there, and count for more than what they say: the
        mechanism would lock. Its rank is what it is on the conditions.
        """
        if A.shape[1] == 0:
            return np.swapaxes(A, -1, -2)
        U, s, V = np.linalg.svd(A, full_matrices=False)
        known = self.rank if self.rank is not None else self.rank_of(s)
        kept = np.arange(s.shape[-1]) < known[:, None]
        over = np.where(kept, 1.0 / np.where(kept, s, 1.0), 0.0)
        return np.einsum("nki,nk,nrk->nir", V, over, U)

    @staticmethod
    def rank_of(singular_values: np.ndarray) -> np.ndarray:
        """(n,) from (n, k), in falling order."""
        return np.sum(singular_values > RANK_TOLERANCE * singular_values[:, :1], -1)

    def learn_rank(self, state: np.ndarray) -> None:
        """Fix the rank of the rows at this state, which closes all joints."""
        placed = self._placed(state)
        A = self.conditions(placed)[0].jacobian @ self.whitened(placed)
        if A.shape[1]:
            self.rank = self.rank_of(np.linalg.svd(A, compute_uv=False))

    # -- states

    def state(self, poses: np.ndarray, twists: np.ndarray) -> np.ndarray:
        """State of poses (n, links, 4, 4) and body-fixed twists (n, links, 6)."""
        R = poses[..., :3, :3]
        turned = lambda v: np.einsum("nlij,nlj->nli", R, v)
        x = poses[..., :3, 3] + turned(self.com)
        omega, v = twists[..., :3], twists[..., 3:]
        u = turned(v + cross(omega, self.com))
        return np.concatenate([x, quaternion_of(R), u, turned(omega)], -1)

    def poses(self, state: np.ndarray) -> np.ndarray:
        R = matrix_of(state[..., 3:7])
        pose = np.zeros((*state.shape[:-1], 4, 4))
        pose[..., :3, :3], pose[..., 3, 3] = R, 1.0
        pose[..., :3, 3] = state[..., :3] - np.einsum("...ij,...j->...i", R, self.com)
        return pose

    def twists(self, state: np.ndarray) -> np.ndarray:
        back = np.swapaxes(matrix_of(state[..., 3:7]), -1, -2)
        turned = lambda v: np.einsum("...ij,...j->...i", back, v)
        omega = turned(state[..., 10:])
        v = turned(state[..., 7:10]) - cross(omega, self.com)
        return np.concatenate([omega, v], -1)

    # -- geometry

    def _placed(self, state: np.ndarray) -> list[Placed]:
        R = matrix_of(state[..., 3:7])
        return [
            Placed(state[:, i, :3], R[:, i], state[:, i, 7:10], state[:, i, 10:])
            for i in range(self.links)
        ]

    @property
    def _ground(self) -> Placed:
        zero = np.zeros((self.size, 3))
        return Placed(zero, np.broadcast_to(np.eye(3), (self.size, 3, 3)), zero, zero)

    def _com(self, body: int | None) -> np.ndarray:
        return np.zeros((self.size, 3)) if body is None else self.com[:, body]

    def seen(self, joint: Joint, placed: list[Placed]) -> Seen:
        child = placed[joint.body]
        parent = self._ground if joint.parent is None else placed[joint.parent]
        B = np.broadcast_to(joint.B, (self.size, 4, 4))
        G = np.broadcast_to(joint.G, (self.size, 4, 4))
        tip = child.point(B[:, :3, 3] - self._com(joint.body), 0)
        foot = parent.point(G[:, :3, 3] - self._com(joint.parent), 1)
        f = child.axes(B[:, :3, :3], 0)
        g = parent.axes(G[:, :3, :3], 1)
        w = child.turning(0) - parent.turning(1)
        number = lambda x: np.broadcast_to(np.asarray(x, float), (self.size,))
        if joint.parent is None:  # the ground does not move
            for still in (foot, *g, w):
                still.jacobian[..., 6:] = 0.0
        return Seen(tip - foot, f, g, w, number(joint.pitch), number(joint.length))

    def conditions(self, placed: list[Placed]) -> tuple[Moving, list[slice]]:
        """All rows, with jacobians (n, rows, 6·links), and the rows of each joint."""
        stacked: list[Moving] = []
        places: list[slice] = []
        for joint in self.given.joints:
            seen = self.seen(joint, placed)
            first = len(stacked)
            for condition in CONDITIONS[joint.kind]:
                row = condition(seen)
                wide = np.zeros((self.size, 6 * self.links))
                wide[:, 6 * joint.body : 6 * joint.body + 6] += row.jacobian[:, :6]
                if joint.parent is not None:
                    wide[:, 6 * joint.parent : 6 * joint.parent + 6] += row.jacobian[:, 6:]
                stacked.append(row._replace(jacobian=wide))
            places.append(slice(first, len(stacked)))
        if not stacked:
            none = np.zeros((self.size, 0))
            return Moving(none, none, np.zeros((self.size, 0, 6 * self.links)), none), places
        return Moving(*(np.stack(x, 1) for x in zip(*stacked, strict=True))), places

    def whitened(self, placed: list[Placed]) -> np.ndarray:
        """W (n, 6·links, 6·links) with Wᵀ M W = I, M the mass matrix in ground axes."""
        W = np.zeros((self.size, 6 * self.links, 6 * self.links))
        for i, body in enumerate(placed):
            k = 6 * i
            W[:, k : k + 3, k : k + 3] = np.eye(3) / np.sqrt(self.mass[:, i, None, None])
            back = np.linalg.inv(np.swapaxes(self.root[:, i], -1, -2))
            W[:, k + 3 : k + 6, k + 3 : k + 6] = body.R @ back
        return W

    # -- forces

    def applied(self, placed: list[Placed]) -> np.ndarray:
        """Forces at the centres of mass and torques about them, (n, links, 6), with gyroscopic."""
        load = np.zeros((self.size, self.links, 6))
        for i, body in enumerate(placed):
            load[:, i, :3] = self.mass[:, i, None] * self.gravity
            world = body.R @ self.inertia[:, i] @ np.swapaxes(body.R, -1, -2)
            momentum = np.einsum("nij,nj->ni", world, body.w)
            load[:, i, 3:] = -cross(body.w, momentum)
        for force in self.given.forces:
            act = self._axis_torque if isinstance(force, AxisTorque) else self._spring
            act(force, placed, load)
        return load

    def _axis_torque(self, force: AxisTorque, placed, load) -> None:
        joint = self.given.joints[force.joint]
        seen = self.seen(joint, placed)
        axis = seen.f[2].value
        angle = np.arctan2(dot(seen.g[1], seen.f[0]).value, dot(seen.g[0], seen.f[0]).value)
        turn = angle - force.angle
        turn = turn - 2.0 * np.pi * np.rint(turn / (2.0 * np.pi))
        spin = np.einsum("ni,ni->n", axis, seen.w.rate)
        size = force.torque - force.stiffness * turn - force.damping * spin
        torque = np.broadcast_to(size, (self.size,))[:, None] * axis
        load[:, joint.body, 3:] += torque
        if joint.parent is not None:
            load[:, joint.parent, 3:] -= torque

    def _spring(self, force: Spring, placed, load) -> None:
        other = self._ground if force.other is None else placed[force.other]
        tip = placed[force.body].point(force.point - self._com(force.body), 0)
        foot = other.point(force.anchor - self._com(force.other), 1)
        line = tip.value - foot.value
        long = np.linalg.norm(line, axis=-1)
        rate = np.einsum("ni,ni->n", line, tip.rate - foot.rate) / long
        tension = force.stiffness * (long - force.length) + force.damping * rate
        pull = -(tension / long)[:, None] * line
        for body, point, sign in ((force.body, tip, 1.0), (force.other, foot, -1.0)):
            if body is not None:
                load[:, body, :3] += sign * pull
                load[:, body, 3:] += sign * cross(point.value - placed[body].x, pull)

    # -- motion

    def accelerated(self, state: np.ndarray) -> tuple[np.ndarray, np.ndarray, list[slice], Moving]:
        """(ẍ, ω̇) (n, 6·links), multipliers (n, rows), the rows of each joint, and the rows."""
        placed = self._placed(state)
        rows, places = self.conditions(placed)
        W = self.whitened(placed)
        load = self.applied(placed).reshape(self.size, -1)
        wished = np.einsum("nij,ni->nj", W, load)  # Wᵀ F
        A = rows.jacobian @ W
        inverse = self.inverse(A)
        lacking = np.einsum("nri,ni->nr", A, wished) + rows.bias
        change = np.einsum("nir,nr->ni", inverse, lacking)
        multipliers = np.einsum("nir,ni->nr", inverse, change)  # Aᵀλ = change
        return np.einsum("nij,nj->ni", W, wished - change), multipliers, places, rows

    def rate(self, state: np.ndarray) -> np.ndarray:
        """d/dt of a state."""
        rates = np.empty_like(state)
        acceleration = self.accelerated(state)[0].reshape(self.size, self.links, 6)
        rates[..., :3] = state[..., 7:10]
        spin = np.concatenate([np.zeros_like(state[..., :1]), state[..., 10:]], -1)
        rates[..., 3:7] = 0.5 * product(spin, state[..., 3:7])
        rates[..., 7:] = acceleration
        return rates

    def settled(self, state: np.ndarray) -> np.ndarray:
        """The nearest state on all conditions, in the mass metric: Newton, then the velocities."""
        state = state.copy()
        for _ in range(NEWTON_STEPS):
            state[..., 3:7] /= np.linalg.norm(state[..., 3:7], axis=-1, keepdims=True)
            placed = self._placed(state)
            rows, _ = self.conditions(placed)
            W = self.whitened(placed)
            A = rows.jacobian @ W
            inverse = self.inverse(A)
            if np.max(np.abs(rows.value), initial=0.0) < CLOSED:
                break
            move = -np.einsum("nij,njr,nr->ni", W, inverse, rows.value)
            move = move.reshape(self.size, self.links, 6)
            state[..., :3] += move[..., :3]
            half = np.concatenate([np.ones_like(move[..., :1]), 0.5 * move[..., 3:]], -1)
            state[..., 3:7] = product(half, state[..., 3:7])
        velocity = state[..., 7:].reshape(self.size, -1)
        excess = np.einsum("nij,njr,nr->ni", W, inverse, self._rates(rows, velocity))
        state[..., 7:] -= excess.reshape(self.size, self.links, 6)
        return state

    @staticmethod
    def _rates(rows: Moving, velocity: np.ndarray) -> np.ndarray:
        return np.einsum("nri,ni->nr", rows.jacobian, velocity)

    def reactions(self, state: np.ndarray) -> np.ndarray:
        """(n, joints, 6): torque about the joint's body point and force on the body, in axes of B.

        What is not unique, because rows say a thing twice, is the least-squares choice.
        """
        placed = self._placed(state)
        _, multipliers, places, rows = self.accelerated(state)
        wrenches = np.zeros((self.size, len(self.given.joints), 6))
        for k, (joint, own) in enumerate(zip(self.given.joints, places, strict=True)):
            i = joint.body
            columns = rows.jacobian[:, own, 6 * i : 6 * i + 6]
            wrench = -np.einsum("nri,nr->ni", columns, multipliers[:, own])
            B = np.broadcast_to(joint.B, (self.size, 4, 4))
            point = placed[i].point(B[:, :3, 3] - self.com[:, i], 0).value
            torque = wrench[:, 3:] + cross(placed[i].x - point, wrench[:, :3])
            axes = placed[i].R @ B[:, :3, :3]
            wrenches[:, k, :3] = np.einsum("nij,ni->nj", axes, torque)
            wrenches[:, k, 3:] = np.einsum("nij,ni->nj", axes, wrench[:, :3])
        return wrenches

    def unique(self, state: np.ndarray) -> np.ndarray:
        """(n, joints, 6): which entries of `reactions` follow from the motion.

        They are those that no multipliers without an effect on any body, Jᵀλ = 0, change.
        """
        placed = self._placed(state)
        rows, places = self.conditions(placed)
        fixed = np.ones((self.size, len(self.given.joints), 6), bool)
        for n in range(self.size):
            U, s, _ = np.linalg.svd(rows.jacobian[n])
            idle = U[:, int(np.sum(s > RANK_TOLERANCE * s[:1].max(initial=0.0))) :]
            for k, (joint, own) in enumerate(zip(self.given.joints, places, strict=True)):
                i = joint.body
                wrenches = rows.jacobian[n, own, 6 * i : 6 * i + 6].T @ idle[own]
                if not wrenches.size:
                    continue
                B = np.broadcast_to(joint.B, (self.size, 4, 4))[n]
                arm = placed[i].R[n] @ (B[:3, 3] - self.com[n, i])
                axes = placed[i].R[n] @ B[:3, :3]
                torque = wrenches[3:] - np.cross(arm, wrenches[:3], axisb=0, axisc=0)
                both = np.concatenate([axes.T @ torque, axes.T @ wrenches[:3]])
                fixed[n, k] = np.max(np.abs(both), axis=1) < 1e-8
        return fixed

    # -- what is conserved

    def energy(self, state: np.ndarray) -> np.ndarray:
        """Kinetic energy, that of gravity, and that of springs, (n,)."""
        placed = self._placed(state)
        total = np.zeros(self.size)
        for i, body in enumerate(placed):
            omega = np.einsum("nij,ni->nj", body.R, body.w)
            total += 0.5 * np.einsum("ni,nij,nj->n", omega, self.inertia[:, i], omega)
            total += 0.5 * self.mass[:, i] * np.sum(body.u**2, -1)
            total -= self.mass[:, i] * np.sum(self.gravity * body.x, -1)
        for force in self.given.forces:
            if isinstance(force, Spring):
                other = self._ground if force.other is None else placed[force.other]
                tip = placed[force.body].point(force.point - self._com(force.body), 0).value
                foot = other.point(force.anchor - self._com(force.other), 1).value
                stretch = np.linalg.norm(tip - foot, axis=-1) - force.length
                total += 0.5 * force.stiffness * stretch**2
        return total

    def momentum(self, state: np.ndarray) -> np.ndarray:
        """(n, 6): angular about the ground's origin, and linear, in ground axes."""
        total = np.zeros((self.size, 6))
        for i, body in enumerate(self._placed(state)):
            world = body.R @ self.inertia[:, i] @ np.swapaxes(body.R, -1, -2)
            linear = self.mass[:, i, None] * body.u
            total[:, :3] += np.einsum("nij,nj->ni", world, body.w) + cross(body.x, linear)
            total[:, 3:] += linear
        return total


# ---- what tests call ---------------------------------------------------------------------------


class Motion(NamedTuple):
    """poses (times, n, links, 4, 4), twists (times, n, links, 6), reactions (times, n, joints, 6).

    error : the largest estimate of one step's error, of any entry of a state.
    """

    times: np.ndarray
    poses: np.ndarray
    twists: np.ndarray
    reactions: np.ndarray
    states: np.ndarray
    error: float


def motion(
    description: Description,
    poses,
    twists,
    times,
    longest: float = LONGEST_STEP,
    tolerance: float = TOLERANCE,
) -> Motion:
    """The motion at the given times; poses (n, links, 4, 4) and twists are those of the first.

    tolerance : of the estimated error of a step, relative to 1 + |entry|. Accelerations of 1e6, as
    in A03, are rounded by more than the default allows.
    """
    system, times = System(description), np.asarray(times, float)
    start = system.state(np.asarray(poses, float), np.asarray(twists, float))
    system.learn_rank(system.settled(start))
    with np.errstate(all="ignore"):
        states, error = integrated(system.rate, start, times, longest, system.settled, tolerance)
        reactions = np.stack([system.reactions(s) for s in states])
    place = np.stack([system.poses(s) for s in states])
    speed = np.stack([system.twists(s) for s in states])
    return Motion(times, place, speed, reactions, states, error)


def consistent(description: Description, poses, twists) -> tuple[np.ndarray, np.ndarray]:
    """The nearest poses and twists that all joints allow."""
    system = System(description)
    state = system.settled(system.state(np.asarray(poses, float), np.asarray(twists, float)))
    return system.poses(state), system.twists(state)


def mobility(description: Description, poses) -> np.ndarray:
    """(n,) degrees of freedom at these poses: 6·links − rank."""
    system = System(description)
    state = system.state(np.asarray(poses, float), np.zeros((system.size, system.links, 6)))
    placed = system._placed(state)
    rows, _ = system.conditions(placed)
    A = rows.jacobian @ system.whitened(placed)
    return 6 * system.links - np.linalg.matrix_rank(A, tol=1e-7)
