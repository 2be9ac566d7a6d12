"""Stability of fixed steps: the stiffness and damping of lierb's own forces against the method.

At the start the forces of `lierb.forces` are linearised along the motions that the joints allow,
q̈ + D q̇ + K q = 0. A method multiplies a mode e^(λt) by R(hλ) in each step of length h, R being its
stability polynomial. Steps are too long where a mode at least doubles in a run in that way: K and D
alone make none grow.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from lierb.errors import StiffStepWarning, body_label
from lierb.kernels.mechanics.elements import Element
from lierb.kernels.mechanics.newton_euler import Motion, frames_of
from lierb.kernels.numbers.arithmetic import plain
from lierb.kernels.numbers.vec import IDENTITY, UNIT, ZERO3, scale
from lierb.kernels.numbers.zero import ZERO
from lierb.links import Link
from lierb.model.mechanism.mechanism import Mechanism
from lierb.model.mechanism.row_system import System
from lierb.model.problem import Problem
from lierb.runs.timing import Timing
from lierb.support.arrays import Array, assembled, components, pose_components, taken
from lierb.tableaus import ButcherTableau

Indices = NDArray[np.int64]
Complex = NDArray[np.complex128]

MOST_GROWTH = math.log(2.0)  # of a mode in a run, as a logarithm
FEW = 32  # members of a batch that are all looked at
SPREAD = 8  # members of a larger batch at equal distances, beside those with the stiffest forces
BODY = "body"  # name of a problem's only link
BEYOND = 1e4  # hλ from which on R is not evaluated: a product of 64 of them is still a number


def warn_of_stiff_steps(
    problem: Problem | Mechanism,
    pose0: Any,
    twist0: Any,
    count: int,
    timing: Timing,
    **options: Any,
) -> None:
    """Issue one StiffStepWarning, if fixed steps are beyond the stability bound.

    pose0, twist0 : of the start, as arrays, of a mechanism by link; None for the closed joint.
    count : of trajectories.   options : of `warnings.warn`.
    """
    if timing.is_adaptive or not any(map(_is_known, problem.kinds)):
        return
    if isinstance(problem, Problem):
        pose0 = {BODY: problem.joint.closed_pose if pose0 is None else pose0}
        twist0 = {BODY: twist0}
    with np.errstate(all="ignore"):  # what overflows fails in the run
        message = _message(
            _bare(problem), pose0, twist0, count, timing, isinstance(problem, Problem)
        )
    if message:
        warnings.warn(message, StiffStepWarning, **options)


def _is_known(kind: Element) -> bool:
    """Whether an element has a stiffness or a damping that is known."""
    return type(kind).tangents is not Element.tangents


_bares: WeakKeyDictionary[Problem | Mechanism, Mechanism] = WeakKeyDictionary()


def _bare(problem: Problem | Mechanism) -> Mechanism:
    """The mechanism with its rows and forces of lierb's own alone, made once."""
    if problem not in _bares:
        forces = [f for f in problem.forces if _is_known(f.kind) or f.kind.rows]
        if isinstance(problem, Mechanism):
            links, loops = problem.links, problem.loops
        else:
            links, loops = (Link(BODY, problem.body, problem.joint),), ()
        _bares[problem] = Mechanism(links, loops, forces=forces, constraints=problem.constraints)
    return _bares[problem]


def _message(
    mechanism: Mechanism,
    poses: Mapping[str, Array],
    twists: Mapping[str, Array],
    count: int,
    timing: Timing,
    is_one_body: bool,
) -> str:
    """The message of the warning; empty where steps are short enough."""
    members = _members(mechanism, poses, twists, count)
    if len(members) < count:
        mechanism = mechanism.part(members)
        poses = {name: taken(array, members, 2) for name, array in poses.items()}
        twists = {name: taken(array, members, 1) for name, array in twists.items()}
    modes = list(_modes(mechanism, poses, twists, len(members), timing.dt))
    worst = max(modes, key=lambda each: each.growth(timing), default=None)
    if worst is None or worst.growth(timing) <= MOST_GROWTH:
        return ""
    force = mechanism.forces[worst.force(timing)]
    where = "" if is_one_body else f" on {' and '.join(map(repr, force.at))}"
    member = members[worst.member(timing)]
    whose = f" of {body_label('trajectory', int(member), count)}" if count > 1 else ""
    return (
        f"dt={timing.dt:g} s is beyond the stability bound of {timing.tableau.name} for "
        f"{force.name}{where}{whose}: errors grow from step to step; take dt of at most "
        f"{_stable(modes, timing):g} s, or adaptive steps (rtol=…), which find their length"
    )


# ---- modes -------------------------------------------------------------------------------------


class _Modes(NamedTuple):
    """Modes of members that have equally many freedoms.

    members : numbers of them.   exponents : hλ, (members, modes).
    shares : of every force, how much it contributes to each mode, (members, modes, forces).
    """

    members: Indices
    exponents: Complex
    shares: Array

    def growths(self, timing: Timing) -> Array:
        """Logarithms of the growth of each mode in the run."""
        return timing.steps * np.log(np.abs(amplification(timing.tableau, self.exponents)))

    def growth(self, timing: Timing) -> float:
        return float(self.growths(timing).max(initial=-math.inf))

    def _worst(self, timing: Timing) -> tuple[int, ...]:
        growths = self.growths(timing)
        return tuple(int(i) for i in np.unravel_index(growths.argmax(), growths.shape))

    def member(self, timing: Timing) -> int:
        """The number of the one whose mode grows most."""
        return int(self.members[self._worst(timing)[0]])

    def force(self, timing: Timing) -> int:
        """The number of the force that contributes most to that mode."""
        return int(self.shares[self._worst(timing)].argmax())


def amplification(tableau: ButcherTableau, z: Complex) -> Complex:
    """R(z) = 1 + z bᵀ(1 − zA)⁻¹(1 … 1)ᵀ, the method's stability polynomial.

    z : hλ. Beyond BEYOND it is taken to that size.
    """
    size = np.abs(z)
    z = np.where(size > BEYOND, z * (BEYOND / np.where(size > 0.0, size, 1.0)), z)
    stages: list[Any] = []
    for row in (*tableau.A, tableau.b):
        stages.append(1.0 + z * sum(a * k for a, k in zip(row, stages, strict=True)))
    found: Complex = stages[-1]
    return found


def _stable(modes: list[_Modes], timing: Timing) -> float:
    """Length of a step, s, to two digits, with which no mode doubles in the run."""

    def is_stable(share: float) -> bool:
        steps = timing.steps / share
        return all(
            steps * np.log(np.abs(amplification(timing.tableau, share * each.exponents))).max()
            <= MOST_GROWTH
            for each in modes
        )

    share = 0.5
    while not is_stable(share):
        share *= 0.5
    most = 2.0 * share
    for _ in range(20):
        middle = 0.5 * (share + most)
        share, most = (middle, most) if is_stable(middle) else (share, middle)
    found = share * timing.dt
    digit = 10.0 ** (math.floor(math.log10(found)) - 1)
    return math.floor(found / digit) * digit


def _modes(
    mechanism: Mechanism,
    pose0: Mapping[str, Array],
    twist0: Mapping[str, Array],
    count: int,
    dt: float,
) -> Iterator[_Modes]:
    """Modes of all forces at once; then, where some act for a time only, those of the others."""
    poses = [pose_components(pose0[name]) for name in mechanism.names]
    twists = [components(twist0[name]) for name in mechanism.names]
    system = System(mechanism, count)
    rows = system.decomposed(system.held(poses))
    tangents, numbers = [], []
    along: list[Array] = []  # of each tangent, q̇ as a row on x
    for i, force in enumerate(mechanism.forces):
        at = mechanism.places[i]._replace(elements=(i,))
        p, body = mechanism.parameters(at), mechanism.constants(at)
        x = system.kinematics(at, body, poses, twists)
        for tangent in force.kind.tangents(body.elements[0], x.motion):
            row = np.zeros((count, 6 * len(mechanism.links)))
            for link, wrench in system.wrenches(at, p, x, tangent.direction).items():
                row[:, 6 * link : 6 * link + 3] = assembled(wrench[:3])
                row[:, 6 * link + 3 : 6 * link + 6] = rows.lever[:, None] * assembled(wrench[3:])
            along.append(row)
            tangents.append(tangent)
            numbers.append(i)
    stiffness = dt * dt * system.column([t.stiffness for t in tangents])
    damping = dt * system.column([t.damping for t in tangents])
    unit = np.broadcast_to(system.metrics[0].unit, (count,))  # √ of that of the kinetic energy
    lasting = np.array([t.is_lasting for t in tangents])
    acting = [np.ones_like(lasting)] + [lasting] * bool(0 < lasting.sum() < len(lasting))
    for rank in np.unique(rows.ranks[rows.freedoms > 0]):
        these = np.flatnonzero(rows.ranks == rank)
        free, moving = rows.vt[these, rank:], rows.moving[these, rank:]
        r = np.linalg.qr(np.swapaxes(moving, 1, 2), mode="r")
        gains = np.stack(along, axis=2)[these]  # (members, 6 links, tangents)
        gains = np.linalg.solve(np.swapaxes(r, 1, 2), free @ gains) / unit[these, None, None]
        for which in acting:
            yield _modes_of(
                these, gains, stiffness[these] * which, damping[these] * which, np.array(numbers)
            )


def _modes_of(
    members: Indices, gains: Array, stiffness: Array, damping: Array, numbers: Indices
) -> _Modes:
    """Of h²K = Σ s g gᵀ and hD = Σ d g gᵀ.

    gains : g of each tangent, (members, freedoms, tangents).   stiffness, damping : s and d.
    numbers : the force of each tangent.
    """
    freedoms = gains.shape[1]
    companion = np.zeros((len(members), 2 * freedoms, 2 * freedoms))
    companion[:, :freedoms, freedoms:] = np.eye(freedoms)
    companion[:, freedoms:, :freedoms] = -(gains * stiffness[:, None]) @ np.swapaxes(gains, 1, 2)
    companion[:, freedoms:, freedoms:] = -(gains * damping[:, None]) @ np.swapaxes(gains, 1, 2)
    sound = np.isfinite(companion).all(axis=(1, 2))
    members, companion = members[sound], companion[sound]
    exponents, vectors = np.linalg.eig(companion)
    stretch = np.abs(np.swapaxes(vectors[:, :freedoms], 1, 2) @ gains[sound]) ** 2
    pull = stiffness[sound, None] + exponents[..., None] * damping[sound, None]
    parts = np.abs(pull) * stretch
    shares = np.stack([parts[..., numbers == i].sum(axis=-1) for i in range(numbers[-1] + 1)], -1)
    exponents = np.minimum(exponents.real, 0.0) + 1j * exponents.imag  # but for rounding it is
    return _Modes(members, exponents, shares)


# ---- members of large batches ------------------------------------------------------------------

_stiffest: WeakKeyDictionary[Mechanism, Indices] = WeakKeyDictionary()


def _members(
    mechanism: Mechanism, poses: Mapping[str, Array], twists: Mapping[str, Array], count: int
) -> Indices:
    """Numbers of the members to look at: those with the stiffest forces on the lightest links."""
    if count <= FEW:
        return np.arange(count)
    spread = np.linspace(0, count - 1, SPREAD).astype(np.int64)
    if mechanism.batch_size() is None or mechanism.batch_size() == 1:
        return spread
    if mechanism not in _stiffest:
        found = [_stiffest_of(mechanism, i) for i in range(len(mechanism.forces))]
        _stiffest[mechanism] = np.unique(np.concatenate(found))
    return np.unique(np.concatenate([spread, _stiffest[mechanism]]))


# Far from its anchor a spring pulls with all its stiffness across the line, and its damping along.
FAR = 1e6  # m
APART = Motion(ZERO, IDENTITY, scale(FAR, UNIT[0]), ZERO3, UNIT[0])


def _stiffest_of(mechanism: Mechanism, number: int) -> Indices:
    """The members with the largest stiffness and damping of a force, over mass and over inertia."""
    force, at = mechanism.forces[number], mechanism.places[number]
    given = {
        name: components(array, len(shape)) if (shape := force.kind.shapes[name]) else array
        for name, array in force.parameters.items()
    }
    placed = force.kind.placed(given, frames_of(mechanism.parameters(at)))
    bodies = [mechanism.links[i].body for i in (at.body, at.parent) if i >= 0]
    sizes = [each.mass for each in bodies]
    sizes += [np.trace(each.inertia, axis1=-2, axis2=-1) for each in bodies]
    found = [
        int(np.argmax(of_all))
        for tangent in force.kind.tangents(placed, APART)
        for gain in (tangent.stiffness, tangent.damping)
        for size in sizes
        if np.size(of_all := plain(gain) / size) > 1
    ]
    return np.array(found, dtype=np.int64)
