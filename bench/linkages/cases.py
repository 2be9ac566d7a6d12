"""The mechanisms that every peer integrates: chains of revolute links, and a four-bar.

Joint frames are turned anyhow, inertias are full, and each trajectory has numbers of its own. All
is given once in the axes of the joints: link i's frame is at its joint, e₃ along the axis.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

Array = np.ndarray
GRAVITY = np.array((0.0, 0.0, -9.81))  # m/s²
T_END = 1.0  # s
DT = 1e-3  # s
CHECKED = 8  # trajectories that are compared with the reference
SEED = 20261123
REFERENCE = Path(__file__).with_name("reference.npz")
MECHANISMS = ("chain2", "chain3", "chain5", "chain8", "chain20", "fourbar")
NUMBERS = 19  # that vary of a link: mass, 3 edges, com, 2 rotations, point, q0, v0, placing


@dataclass(frozen=True)
class Form:
    """Function by which a peer integrates one mechanism.

    count : trajectories that make one timed call last about a second.
    allowed : m, how far a link may be from the reference at T_END. Default: what RK4 allows.
    dt : s, of one step; None for a method that chooses its own.
    """

    mechanism: str
    label: str
    count: int
    allowed: float | None = None
    dt: float | None = DT

    @property
    def limit(self) -> float:
        """Allowed error, m: RK4 at 1 ms leaves 1e-6 for eight links, and 7e-9 for five."""
        default = {"chain8": 3e-6, "chain20": 1e-3}.get(self.mechanism, 1e-7)
        return default if self.allowed is None else self.allowed


@dataclass(frozen=True)
class Tree:
    """A batch of mechanisms. Axis 0 of every array is the trajectory, axis 1 the link.

    parents : of each link; −1 is the ground.
    frames : (n, k, 4, 4), the link's joint frame at q = 0, seen from its parent's.
    mass, com, inertia : (n, k) kg, (n, k, 3) m, (n, k, 3, 3) kg m² about the centre of mass.
    bodies : (n, k, 4, 4), where the user's body frame is, seen from the joint's.
    q0, v0 : (n, k), rad and rad/s.
    loop : (n, 2, 3), m: a point of link 1 and one of link 2 that stay together; None for a chain.
    """

    parents: tuple[int, ...]
    frames: Array
    mass: Array
    com: Array
    inertia: Array
    bodies: Array
    q0: Array
    v0: Array
    loop: Array | None = None

    def __len__(self) -> int:
        return len(self.mass)

    def first(self, count: int) -> Tree:
        arrays = {
            name: None if value is None else value[:count]
            for name, value in vars(self).items()
            if name != "parents"
        }
        return Tree(self.parents, **arrays)


def tree_of(mechanism: str, count: int) -> Tree:
    """`chain2`, `chain3`, … or `fourbar`; the first trajectories are the same for every count."""
    if mechanism == "fourbar":
        return _fourbar(count)
    return _chain(int(mechanism.removeprefix("chain")), count)


def _drawn(links: int, count: int) -> Array:
    """(count, links, NUMBERS), standard normal."""
    return np.random.default_rng(SEED).standard_normal((count, links, NUMBERS))


def _poses(rotation: Rotation | Array, point: Array) -> Array:
    poses = np.zeros((*point.shape[:-1], 4, 4))
    matrices = rotation.as_matrix() if isinstance(rotation, Rotation) else rotation
    poses[..., :3, :3] = matrices.reshape(*point.shape[:-1], 3, 3)
    poses[..., :3, 3], poses[..., 3, 3] = point, 1.0
    return poses


def _chain(links: int, count: int) -> Tree:
    rng, z = np.random.default_rng([SEED, links]), _drawn(links, count)
    about = lambda base, spread, turns: (  # a rotation of each link, and of each trajectory
        Rotation.concatenate([base] * count) * Rotation.from_rotvec(spread * turns.reshape(-1, 3))
    )
    points = 0.3 * _directions(rng, links) + 0.02 * z[..., 4:7]
    points[:, 0] = 0.01 * z[:, 0, 4:7]
    com = 0.15 * _directions(rng, links) + 0.01 * z[..., 7:10]
    return Tree(
        parents=tuple(range(-1, links - 1)),
        frames=_poses(about(Rotation.random(links, rng=rng), 0.1, z[..., 10:13]), points),
        mass=2.0 * np.exp(0.1 * z[..., 0]),
        com=com,
        inertia=_inertias(z, about(Rotation.random(links, rng=rng), 0.1, z[..., 13:16])),
        bodies=_poses(about(Rotation.random(links, rng=rng), 0.1, z[..., 16:19]), com),
        q0=rng.uniform(-1, 1, links) + 0.2 * z[..., 1],
        v0=rng.uniform(-1, 1, links) + 0.2 * z[..., 2],
    )


def _directions(rng: np.random.Generator, links: int) -> Array:
    return Rotation.random(links, rng=rng).as_matrix()[:, 0]


def _inertias(z: Array, axes: Rotation) -> Array:
    """Inertias of boxes of 2 kg and about 0.3 m × 0.2 m × 0.1 m, turned."""
    edges = np.array((0.3, 0.2, 0.1)) * np.exp(0.1 * z[..., 1:4])
    squares = edges**2
    moments = 2.0 / 12.0 * (squares.sum(axis=-1, keepdims=True) - squares)
    R = axes.as_matrix().reshape(*z.shape[:2], 3, 3)
    return np.einsum("...ij,...j,...kj->...ik", R, moments, R)


def _fourbar(count: int) -> Tree:
    """Crank, coupler on it, rocker on the ground; crank 0.2, coupler 0.5, rocker 0.4, ground 0.5 m.

    The plane is turned anyhow, in each trajectory otherwise.
    """
    rng, z = np.random.default_rng([SEED, 4]), _drawn(3, count)
    a, b, c = (np.array((0.2, 0.5, 0.4)) * np.exp(0.03 * z[..., 0])).T
    d = 0.5 * np.exp(0.03 * z[:, 0, 1])
    crank = 0.7 + 0.2 * z[:, 1, 1]
    end = np.stack([a * np.cos(crank), a * np.sin(crank)], axis=-1)
    across = np.stack([d, 0 * d], axis=-1) - end  # to the rocker's pivot
    r = np.linalg.norm(across, axis=-1)
    coupler = np.arctan2(*across.T[::-1]) + np.arccos((r**2 + b**2 - c**2) / (2 * r * b))
    pin = end + b[:, None] * np.stack([np.cos(coupler), np.sin(coupler)], axis=-1)
    rocker = np.arctan2(pin[:, 1], pin[:, 0] - d)
    speed = 6.0 + 0.5 * z[:, 2, 1]
    turns = _loop_speeds(speed, end, pin, d)
    plane = (
        Rotation.random(1, rng=rng).as_matrix()[0]
        @ Rotation.from_rotvec(0.2 * z[:, 0, 4:7]).as_matrix()
    )
    pivots, places = np.zeros((count, 3, 3)), np.tile(np.eye(3), (count, 3, 1, 1))
    pivots[:, 1, 0], pivots[:, 2] = a, d[:, None] * plane[..., 0]
    places[:, 0] = places[:, 2] = plane
    com = 0.5 * np.stack([a, b, c], axis=-1)[..., None] * np.eye(3)[0] + 0.01 * z[..., 7:10]
    turned = lambda numbers: (
        Rotation.random(3 * count, rng=np.random.default_rng(1))
        * (Rotation.from_rotvec(0.1 * numbers.reshape(-1, 3)))
    )
    loop = np.zeros((count, 2, 3))
    loop[:, 0, 0], loop[:, 1, 0] = b, c
    return Tree(
        parents=(-1, 0, -1),
        frames=_poses(places, pivots),
        mass=np.exp(0.1 * z[..., 3]),
        com=com,
        inertia=0.25 * _inertias(z, turned(z[..., 10:13])),
        bodies=_poses(turned(z[..., 13:16]), com),
        q0=np.stack([crank, coupler - crank, rocker], axis=-1),
        v0=np.stack([turns[0], turns[1] - turns[0], turns[2]], axis=-1),
        loop=loop,
    )


def _loop_speeds(speed: Array, end: Array, pin: Array, d: Array) -> tuple[Array, Array, Array]:
    """Absolute angular velocities: the pin's velocity is the same seen from both its links."""
    turn = lambda v: np.stack([-v[:, 1], v[:, 0]], axis=-1)
    pivot = np.stack([d, 0 * d], axis=-1)
    columns = np.stack([turn(pin - end), -turn(pin - pivot)], axis=-1)
    coupler, rocker = np.linalg.solve(columns, -(speed[:, None] * turn(end))[..., None])[..., 0].T
    return speed, coupler, rocker


# ---- kinematics and the reference --------------------------------------------------------------


def places(tree: Tree, q: Array) -> list[Array]:
    """(n, 4, 4) of each link's joint frame in the ground."""
    poses: list[Array] = []
    for i, parent in enumerate(tree.parents):
        turn = _poses(Rotation.from_rotvec(q[:, i, None] * np.eye(3)[2]), np.zeros((len(q), 3)))
        here = tree.frames[:, i] @ turn
        poses.append(here if parent < 0 else poses[parent] @ here)
    return poses


def positions(tree: Tree, q: Array) -> Array:
    """(n, k, 3) m: where the origins of the bodies' frames are."""
    frames = places(tree, q)
    return np.stack([(g @ tree.bodies[:, i])[:, :3, 3] for i, g in enumerate(frames)], axis=1)


def _ancestors(tree: Tree, link: int) -> list[int]:
    return ([*_ancestors(tree, tree.parents[link])] if tree.parents[link] >= 0 else []) + [link]


def equations(tree: Tree, q: Array, v: Array) -> tuple[Array, Array]:
    """M(q) and the generalised force of everything but accelerations, (n, k, k) and (n, k).

    By the Jacobians of every link in ground axes: M = Σ JᵀmJ, and what is left of Newton and Euler
    at q̈ = 0.
    """
    n, k = q.shape
    frames, M, f = places(tree, q), np.zeros((n, k, k)), np.zeros((n, k))
    axes, origins = [g[:, :3, 2] for g in frames], [g[:, :3, 3] for g in frames]
    omega, bias, carried = _rates(tree, frames, v)
    for i, g in enumerate(frames):
        R = g[:, :3, :3]
        arm = np.einsum("nij,nj->ni", R, tree.com[:, i])
        inertia = R @ tree.inertia[:, i] @ R.transpose(0, 2, 1)
        turning, moving = np.zeros((n, 3, k)), np.zeros((n, 3, k))
        for j in _ancestors(tree, i):
            turning[..., j] = axes[j]
            moving[..., j] = np.cross(axes[j], origins[i] + arm - origins[j])
        m, w, alpha = tree.mass[:, i, None, None], omega[i], bias[i]
        M += turning.transpose(0, 2, 1) @ inertia @ turning + m * moving.transpose(0, 2, 1) @ moving
        a = carried[i] + np.cross(alpha, arm) + np.cross(w, np.cross(w, arm)) - GRAVITY
        spin = np.einsum("nij,nj->ni", inertia, w)
        moment = np.einsum("nij,nj->ni", inertia, alpha) + np.cross(w, spin)
        f -= np.einsum("nik,ni->nk", turning, moment) + np.einsum(
            "nik,ni->nk", moving, m[..., 0] * a
        )
    return M, f


def _rates(tree: Tree, frames: list[Array], v: Array) -> tuple[list[Array], ...]:
    """ω, and at q̈ = 0 ω̇ and the acceleration of the joint's origin, in ground axes."""
    omega: list[Array] = []
    alpha: list[Array] = []
    moved: list[Array] = []
    zero = np.zeros((len(v), 3))
    for i, parent in enumerate(tree.parents):
        own = v[:, i, None] * frames[i][:, :3, 2]
        w, turned, a = (omega[parent], alpha[parent], moved[parent]) if parent >= 0 else (zero,) * 3
        if parent >= 0:
            arm = frames[i][:, :3, 3] - frames[parent][:, :3, 3]
            a = a + np.cross(turned, arm) + np.cross(w, np.cross(w, arm))
        omega.append(w + own)
        alpha.append(turned + np.cross(w, own))
        moved.append(a)
    return omega, alpha, moved


def accelerations(tree: Tree, q: Array, v: Array) -> Array:
    """(n, k); of a loop by its rows, of least norm where they say a thing twice."""
    M, f = equations(tree, q, v)
    if tree.loop is None:
        return np.linalg.solve(M, f[..., None])[..., 0]
    frames = places(tree, q)
    omega, alpha, moved = _rates(tree, frames, v)
    J, eta = np.zeros((len(q), 3, q.shape[1])), np.zeros((len(q), 3))
    for sign, i, point in zip((1, -1), (1, 2), np.moveaxis(tree.loop, 1, 0)):
        arm = np.einsum("nij,nj->ni", frames[i][:, :3, :3], point)
        for j in _ancestors(tree, i):
            lever = frames[i][:, :3, 3] + arm - frames[j][:, :3, 3]
            J[..., j] += sign * np.cross(frames[j][:, :3, 2], lever)
        w = omega[i]
        eta -= sign * (moved[i] + np.cross(alpha[i], arm) + np.cross(w, np.cross(w, arm)))
    k = q.shape[1]
    whole, right = np.zeros((len(q), k + 3, k + 3)), np.concatenate([f, eta], axis=1)
    whole[:, :k, :k], whole[:, :k, k:], whole[:, k:, :k] = M, J.transpose(0, 2, 1), J
    return (np.linalg.pinv(whole, rcond=1e-11) @ right[..., None])[:, :k, 0]


@cache
def reference(mechanism: str) -> Array:
    """(CHECKED, k, 3) m: where the links are at T_END; stored, as it takes `solved` a minute."""
    return np.asarray(np.load(REFERENCE)[mechanism])


def solved(mechanism: str, count: int = CHECKED, t_end: float = T_END) -> Array:
    """(count, k, 3) m: where the links are at t_end, by DOP853 at 1e-12."""
    tree = tree_of(mechanism, count)
    shape = tree.q0.shape

    def rates(t: float, y: Array) -> Array:
        q, v = y.reshape(2, *shape)
        return np.concatenate([v.ravel(), accelerations(tree, q, v).ravel()])

    start = np.concatenate([tree.q0.ravel(), tree.v0.ravel()])
    solution = solve_ivp(rates, (0, t_end), start, "DOP853", rtol=1e-12, atol=1e-12)
    return positions(tree, solution.y[:, -1].reshape(2, *shape)[0])


def error(mechanism: str, states: Array) -> float:
    """The largest distance, m, of a link from the reference."""
    truth = reference(mechanism)
    count = min(len(truth), len(states))
    return float(np.linalg.norm(states[:count] - truth[:count], axis=-1).max())


# ---- the double pendulum by Lagrange's equations -----------------------------------------------


def harmonics(tree: Tree) -> Array:
    """(17, n): coefficients of a chain of two in the functions of its angles.

    M₁₁ of (1, cos q₂, sin q₂, cos 2q₂, sin 2q₂); M₁₂ of (1, cos q₂, sin q₂); M₂₂; the potential
    energy of (c₁, s₁)⊗(1, c₂, s₂), then of (c₂, s₂), with c = cos q, s = sin q. Found by Fourier's
    sums over as many angles as make them exact.
    """
    n, turns = len(tree), 2 * np.pi * np.arange(5) / 5
    zero = np.zeros((n, 2))
    M = np.stack([equations(tree, zero + np.array((0.0, t)), zero)[0] for t in turns])
    waves = lambda y, k: (2 / 5 * np.cos(k * turns) @ y, 2 / 5 * np.sin(k * turns) @ y)
    first, second = M[:, :, 0, 0], M[:, :, 0, 1]
    rows = [first.mean(0), *waves(first, 1), *waves(first, 2)]
    rows += [second.mean(0), *waves(second, 1), M[0, :, 1, 1]]
    angles = 2 * np.pi * np.arange(3) / 3
    V = np.array([[potential(tree, zero + np.array((p, r))) for r in angles] for p in angles])
    basis = np.stack([np.ones(3), np.cos(angles), np.sin(angles)])
    weights = np.array((1 / 3, 2 / 3, 2 / 3))[:, None] * basis
    v = np.einsum("ip,jr,prn->ijn", weights, weights, V)
    return np.stack([*rows, *v[1], *v[2], v[0, 1], v[0, 2]])


def potential(tree: Tree, q: Array) -> Array:
    torques = np.zeros(len(q))
    for i, g in enumerate(places(tree, q)):
        centre = g[:, :3, 3] + np.einsum("nij,nj->ni", g[:, :3, :3], tree.com[:, i])
        torques -= tree.mass[:, i] * (centre @ GRAVITY)
    return torques
