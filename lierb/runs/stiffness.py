"""Stability of fixed steps: the stiffness and damping of lierb's own forces against the method.

At the start, the forces of `lierb.forces` are linearised along the motions that the constraints
allow: q̈ + D q̇ + K q = 0. A step of length h multiplies a mode e^(λt) by R(hλ), where R is the
method's stability function. The exact modes do not grow, since K and D are positive
semi-definite. Steps are too long if the method lets a mode double during the run.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator
from functools import cached_property
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from lierb.errors import StiffStepWarning
from lierb.kernels.mechanics.elements import Element
from lierb.kernels.mechanics.newton_euler import BodyConstants, Motion, Parameters, frames_of
from lierb.kernels.mechanics.passive_elements import TurnCounter
from lierb.kernels.numbers.arithmetic import plain
from lierb.kernels.numbers.vec import IDENTITY, UNIT, ZERO3, scale
from lierb.kernels.numbers.zero import ZERO
from lierb.methods import Method
from lierb.model.base import Model
from lierb.model.connections import Connection
from lierb.model.mechanism.mechanism import Mechanism
from lierb.model.mechanism.row_system import System
from lierb.model.problem import BODY, Problem, as_mechanism
from lierb.runs.starts import Ready
from lierb.runs.timing import Timing
from lierb.support.arrays import Array, assembled, components, items_at, pose_components
from lierb.support.collected_warnings import are_warnings_collected

Indices = NDArray[np.int64]
Complex = NDArray[np.complex128]
Starts = dict[str, Array]  # poses or twists at the start, by link

MOST_GROWTH = math.log(2.0)  # largest accepted log growth of a mode in a run
FEW = 32  # batch size up to which all members are linearised
SPREAD = 8  # evenly spaced members of a larger batch, linearised beside the stiffest ones
ROUNDING = 1e-14  # rounding error of log|R|
HALVINGS = 1000  # most halvings of a step: beyond, doubles underflow
DIGITS = 20  # binary digits of the longest stable step


def warn_of_stiff_steps(run: Ready, **options: Any) -> None:
    """Issue one StiffStepWarning if fixed steps exceed the stability bound.

    options : keywords of `warnings.warn`.
    """
    if are_warnings_collected():
        return
    start = run.pose0, run.twist0, run.inputs.count
    goes_on = run.before is not None
    if message := stiff_steps(run.model, *start, run.options.timing, goes_on):
        warnings.warn(message, StiffStepWarning, **options)


def stiff_steps(
    problem: Model, pose0: Any, twist0: Any, count: int, timing: Timing, goes_on: bool = False
) -> str:
    """Message of the warning; empty if steps are short enough or adaptive.

    pose0, twist0 : arrays; for a mechanism by link. pose0 is None for the closed joint.
    count : number of trajectories.   goes_on : True if the run continues another one, whose start
        was examined for the same steps.
    """
    if not can_be_stiff(problem, timing):
        return ""
    if problem not in _own_forces:
        _own_forces[problem] = _OwnForces.of(problem)
    if isinstance(problem, Problem):
        pose0 = {BODY: problem.joint.closed_pose if pose0 is None else pose0}
        twist0 = {BODY: twist0}
    try:
        with np.errstate(all="ignore"):
            return _own_forces[problem].message(pose0, twist0, count, timing, goes_on)
    except np.linalg.LinAlgError:  # overflow or underflow, which the run itself reports
        return ""


def can_be_stiff(problem: Model, timing: Timing) -> bool:
    """Return True for fixed steps of a model with a force whose stiffness or damping is known."""
    return not timing.is_adaptive and any(map(_is_known, problem.kinds))


def _is_known(kind: Element) -> bool:
    """Return True if the stiffness and damping of an element are known."""
    return type(kind).tangents is not Element.tangents


class _Modes(NamedTuple):
    """Modes of batch members with the same number of freedoms.

    members : numbers of the members.   exponents : hλ, (members, modes).
    shares : contribution of each force to each mode, (members, modes, forces).
    """

    members: Indices
    exponents: Complex
    shares: Array

    def growth(self, method: Method, steps: float, share: float = 1.0) -> Array:
        """Log growth of each mode in `steps` steps of `share` times the step length."""
        factors = np.abs(method.amplification(share * self.exponents))
        return np.asarray(steps * (np.log(factors) - ROUNDING))


class _OwnForces:
    """Forces of `lierb.forces` in a problem with its rows; caches data common to all starts."""

    def __init__(self, mechanism: Mechanism, is_one_body: bool, is_alike: bool) -> None:
        """is_alike : True if the modes are the same at every start."""
        self.mechanism, self.is_one_body, self.is_alike = mechanism, is_one_body, is_alike
        self._last: tuple[Any, Any, str] = None, None, ""  # steps, start and message

    @classmethod
    def of(cls, problem: Model) -> _OwnForces:
        forces = [f for f in problem.forces if _is_known(f.kind) or f.kind.rows]
        counters = [each for each in problem.states if isinstance(each.kind, TurnCounter)]
        mechanism = as_mechanism(
            problem, forces=forces, constraints=problem.constraints, states=counters
        )
        if not isinstance(problem, Problem):
            return cls(mechanism, False, False)
        # In body axes, neither the mass matrix nor the rows of a subgroup depend on the pose.
        only_joint = problem.joint.subgroup is not None and problem.rows == problem.joint.rows
        is_alike = only_joint and all(force.kind.needs_axis for force in forces)
        return cls(mechanism, True, is_alike)

    def message(
        self, pose0: Starts, twist0: Starts, count: int, timing: Timing, goes_on: bool
    ) -> str:
        """Message of the warning; empty if steps are short enough."""
        steps = timing.method, timing.dt, timing.steps, count
        arrays = () if self.is_alike else (*pose0.values(), *twist0.values())
        start = [array.tobytes() for array in arrays] if count <= FEW or self.is_alike else None
        known_steps, known_start, message = self._last
        if steps != known_steps or not (goes_on or (start == known_start and start is not None)):
            message = self._message(pose0, twist0, count, timing)
            self._last = steps, start, message
        return message

    def _message(self, pose0: Starts, twist0: Starts, count: int, timing: Timing) -> str:
        members, those = self._members(count), self
        if len(members) < count:
            those = _OwnForces(self.mechanism.part(members), self.is_one_body, self.is_alike)
            pose0 = {name: items_at(array, members, 2) for name, array in pose0.items()}
            twist0 = {name: items_at(array, members, 1) for name, array in twist0.items()}
        modes = list(those._modes(pose0, twist0, len(members), timing.dt))
        growths = [each.growth(timing.method, timing.steps) for each in modes]
        most = [growth.max(initial=0.0) for growth in growths]
        if max(most, default=0.0) <= MOST_GROWTH:
            return ""
        worst = int(np.argmax(most))
        member, mode = np.unravel_index(growths[worst].argmax(), growths[worst].shape)
        force = self.mechanism.forces[modes[worst].shares[member, mode].argmax()]
        where = "" if self.is_one_body else f" on {' and '.join(map(repr, force.at))}"
        number = int(members[modes[worst].members[member]])
        whose = f" of trajectory {number}" if count > 1 else ""
        return (
            f"dt={timing.dt:g} s is beyond the stability bound of {timing.method.name} for "
            f"{force.name}{where}{whose}: its errors grow from step to step; take dt of at most "
            f"{_stable_length(modes, timing):g} s, or adaptive steps (rtol=), which find theirs"
        )

    # ---- linearised ----------------------------------------------------------------------------

    @cached_property
    def _places(self) -> list[tuple[Connection, Parameters, BodyConstants]]:
        """Connection, parameters and body constants of each force."""
        mechanism, placed = self.mechanism, []
        for i in range(len(mechanism.forces)):
            at = mechanism.places[i]._replace(elements=(i,))
            placed.append((at, mechanism.parameters(at), mechanism.constants(at)))
        return placed

    @cached_property
    def _system(self) -> System:
        return System(self.mechanism, 1)

    def _modes(self, pose0: Starts, twist0: Starts, count: int, dt: float) -> Iterator[_Modes]:
        """Modes of all forces, then modes of the forces that act throughout a motion."""
        names = self.mechanism.names
        poses = [pose_components(pose0[name]) for name in names]
        twists = [components(twist0[name]) for name in names]
        system = self._system if count == 1 else System(self.mechanism, count)
        rows = system.decomposed(system.states(poses))
        tangents, forces = [], []
        along: list[Array] = []  # for each tangent: q̇ as a row acting on x of `DecomposedRows`
        for i, (at, p, body) in enumerate(self._places):
            x = system.kinematics(at, body, poses, twists)
            for tangent in self.mechanism.forces[i].kind.tangents(body.elements[0], x.motion):
                if not (np.any(plain(tangent.stiffness)) or np.any(plain(tangent.damping))):
                    continue
                row = np.zeros((count, 6 * len(names)))
                for link, wrench in system.wrenches(at, p, x, tangent.direction).items():
                    turning = slice(6 * link, 6 * link + 3)
                    moving = slice(6 * link + 3, 6 * link + 6)
                    row[:, turning] = assembled(wrench[:3])
                    row[:, moving] = rows.lever[:, None] * assembled(wrench[3:])
                along.append(row)
                tangents.append(tangent)
                forces.append(i)
        if not tangents:
            return
        directions = np.stack(along, axis=2)  # (count, 6 links, tangents)
        stiffness = dt * dt * system.column([t.stiffness for t in tangents])
        damping = dt * system.column([t.damping for t in tangents])
        lasting = np.array([t.is_lasting for t in tangents])
        acting = [np.ones_like(lasting)]
        if 0 < np.count_nonzero(lasting) < len(lasting):
            acting.append(lasting)
        root = np.broadcast_to(system.metrics[0].unit, (count,))  # of y's energy
        for rank in np.unique(rows.ranks[rows.freedoms > 0]):
            these = np.flatnonzero(rows.ranks == rank)
            # Coordinates q of the free motions in which the kinetic energy is q̇ᵀq̇/2
            r = np.linalg.qr(np.swapaxes(rows.moving[these, rank:], 1, 2), mode="r")
            gains = rows.vt[these, rank:] @ directions[these]
            gains = np.linalg.solve(np.swapaxes(r, 1, 2), gains) / root[these, None, None]
            for which in acting:
                yield _modes_of(
                    these, gains, stiffness[these] * which, damping[these] * which, forces
                )

    # ---- members of large batches --------------------------------------------------------------

    def _members(self, count: int) -> Indices:
        """Numbers of the members that are linearised."""
        if count <= FEW:
            return np.arange(count)
        spread = np.linspace(0, count - 1, SPREAD).astype(np.int64)
        return np.unique(np.concatenate([spread, self._stiffest]))

    @cached_property
    def _stiffest(self) -> Indices:
        """Members with the largest ratio of a force's stiffness or damping to mass or inertia."""
        mechanism, members = self.mechanism, []
        for force, at in zip(mechanism.forces, mechanism.places, strict=False):
            bodies = [mechanism.links[i].body for i in (at.body, at.parent) if i >= 0]
            sizes = [body.mass for body in bodies]
            sizes += [np.einsum("...ii->...", body.inertia) for body in bodies]
            given = {
                name: components(array, len(shape)) if (shape := force.kind.shapes[name]) else array
                for name, array in force.parameters.items()
            }
            placed = force.kind.placed(given, frames_of(mechanism.parameters(at)))
            for tangent in force.kind.tangents(placed, APART):
                for gain in (tangent.stiffness, tangent.damping):
                    of_all = [plain(gain) / size for size in sizes]
                    members += [int(np.argmax(each)) for each in of_all if np.size(each) > 1]
        return np.unique(np.array(members, dtype=np.int64))


# Motion far from the anchor, where a spring has its stiffness across the line and its damping
# along it.
APART = Motion(ZERO, IDENTITY, scale(1e6, UNIT[0]), ZERO3, UNIT[0])

_own_forces: WeakKeyDictionary[Model, _OwnForces] = WeakKeyDictionary()


def _modes_of(
    members: Indices, gains: Array, stiffness: Array, damping: Array, forces: list[int]
) -> _Modes:
    """Modes of h²K = Σ s g gᵀ and hD = Σ d g gᵀ; the exponents are finite, with Re hλ ≤ 0.

    gains : g of each tangent, (members, freedoms, tangents).   stiffness, damping : s and d.
    forces : number of the force that each tangent belongs to.
    """
    freedoms = gains.shape[1]
    companion = np.zeros((len(members), 2 * freedoms, 2 * freedoms))
    companion[:, :freedoms, freedoms:] = np.eye(freedoms)
    companion[:, freedoms:, :freedoms] = -(gains * stiffness[:, None]) @ np.swapaxes(gains, 1, 2)
    companion[:, freedoms:, freedoms:] = -(gains * damping[:, None]) @ np.swapaxes(gains, 1, 2)
    sound = np.asarray(np.isfinite(companion).all(axis=(1, 2)))
    exponents, vectors = np.linalg.eig(companion[sound])
    sound[sound] = known = np.isfinite(exponents).all(axis=1)
    exponents, vectors = exponents[known], vectors[known]
    stretch = np.abs(np.swapaxes(vectors[:, :freedoms], 1, 2) @ gains[sound]) ** 2
    parts = stretch * np.abs(stiffness[sound, None] + exponents[..., None] * damping[sound, None])
    shares = np.zeros((*exponents.shape, forces[-1] + 1))
    for number, force in enumerate(forces):
        shares[..., force] += parts[..., number]
    exponents = np.minimum(exponents.real, 0.0) + 1j * exponents.imag  # positive only by rounding
    return _Modes(members[sound], exponents, shares)


def _stable_length(modes: list[_Modes], timing: Timing) -> float:
    """Longest step, s, to two digits, with which no mode doubles in the run."""

    def is_stable(share: float) -> bool:
        growths = (each.growth(timing.method, timing.steps / share, share) for each in modes)
        return all(growth.max(initial=0.0) <= MOST_GROWTH for growth in growths)

    share = next((0.5**k for k in range(1, HALVINGS) if is_stable(0.5**k)), 0.5**HALVINGS)
    above = 2.0 * share
    for _ in range(DIGITS):
        middle = 0.5 * (share + above)
        share, above = (middle, above) if is_stable(middle) else (share, middle)
    longest = share * timing.dt
    digit = 10.0 ** (math.floor(math.log10(longest)) - 1)
    return math.floor(longest / digit) * digit
