"""Closed poses, projected twists and freedoms of a mechanism.

All rows together are J V = ḣ, V the twists of all links. The nearest V is that of least kinetic
energy (`lierb.model.mechanism.decomposition.DecomposedRows`), even for redundant rows, which every
planar loop of revolute joints has. Each member of a batch is decomposed separately: its bits do not
depend on the other members.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from lierb.errors import PoseError, TwistError, body_label
from lierb.kernels.groups import se3, so3
from lierb.kernels.mechanics.constraints import residuals
from lierb.kernels.mechanics.newton_euler import Pose
from lierb.kernels.mechanics.rows import Row
from lierb.kernels.mechanics.scale import START_TOLERANCE
from lierb.kernels.numbers.arithmetic import plain, where
from lierb.kernels.numbers.vec import Vec, add
from lierb.model.mechanism.decomposition import RANK_TOLERANCE, summed
from lierb.model.mechanism.kinematics import TreeKinematics
from lierb.model.mechanism.residuals import are_accepted, excess_of, misfit_of, no_convergence
from lierb.model.mechanism.row_system import (
    NEWTON_STEPS,
    ConnectionState,
    System,
    ends_of,
    is_fixed,
    name_of,
    reversed_joint,
    wrong_way,
)
from lierb.model.unfit import unfit_constraint, unfit_place, unfit_rate
from lierb.support.arrays import Array, assembled, components, pose_components, pose_matrix
from lierb.support.progress import reporter

# Damping of Newton's steps, relative to the squared residual. Of 240 starts (four-bars, a
# Bricard linkage, up to 0.8 off in every coordinate) all converge with 0.1 to 1e-4, 229 with 1,
# 224 without damping.
DAMPING = 1e-2
# In a search from random starts: 183 of 200 of a four-bar close in 15 steps and no more in 50; of
# two four-bars in series 86 of 100 in 15 steps, 88 in 30. The others would take all steps.
SEARCH_STEPS = 20
STALLED = 5  # steps in which a residual that still converges falls to less than half
MISSED = 0.1 * START_TOLERANCE  # largest residual of a projected twist, relative to the speed
CONTRADICTION = 1e-6  # largest residual of rows with prescribed rates, relative to these
MOST_NUMBERS = 2**22  # largest number of entries of the matrices that are decomposed at once
ASSEMBLIES = "assemblies"  # unit of progress


class Mobility(NamedTuple):
    """Numbers of freedoms and of redundant rows, each an integer or (n,).

    freedoms : freedoms of the links' velocities.   redundant : rows that are implied by others.
    """

    freedoms: Any
    redundant: Any


@dataclass(frozen=True)
class Part:
    """Range of a batch, which has at least one member.

    arrays : arguments of its members.   first : index of its first member.
    count : size of the whole batch.   is_batch : False if nothing is batched.
    """

    mechanism: TreeKinematics
    arrays: list[Array]
    first: int
    count: int
    is_batch: bool

    def label(self, argument: str, member: int) -> str:
        return body_label(argument, self.first + member, self.count)

    def pose_label(self, member: int) -> str:
        return self.label("pose", member)


def _parts(mechanism: TreeKinematics, arguments: list[tuple[str, list[Array], int]]) -> list[Part]:
    """Split the batch into parts whose matrices fit in memory.

    arguments : name, arrays of all links, and axes of an item.
    """
    sizes = {f"{name}[{i}]": (x, n) for name, arrays, n in arguments for i, x in enumerate(arrays)}
    size = mechanism.batch_size(**sizes)
    count = size or 1
    rows = sum(len(at.rows) for at in mechanism.connections)
    step = max(1, MOST_NUMBERS // max(1, rows * 6 * len(mechanism.links)))
    spread = [np.broadcast_to(x, (count, *x.shape[x.ndim - n :])) for x, n in sizes.values()]
    parts = []
    for i in range(0, count, step):
        own = mechanism.part(slice(i, min(i + step, count))) if count > 1 else mechanism
        parts.append(Part(own, [x[i : i + step] for x in spread], i, count, size is not None))
    return parts


def _joined(parts: list[list[Array]], is_batch: bool) -> list[Array]:
    """Join the arrays of all parts, link by link."""
    whole = [np.concatenate(of_link) for of_link in zip(*parts, strict=True)]
    return whole if is_batch else [array[0] for array in whole]


# ---- poses -------------------------------------------------------------------------------------


def closed(
    mechanism: TreeKinematics,
    poses: list[Array],
    t0: float = 0.0,
    report: Callable[[int], None] | None = None,
) -> list[Array]:
    """Return the nearest poses that close all joints and loops; closed poses are unchanged.

    report : function of the number of members done; None for a progress bar.
    """
    parts = _parts(mechanism, [("pose", poses, 2)])
    results = []
    shown = nullcontext(report) if report else reporter(None, parts[0].count, ASSEMBLIES)
    with shown as show:
        for part in parts:
            results.append(_closed(part, t0))
            show(part.first + len(part.arrays[0]))
    if not any(has_moved for _, has_moved in results):
        return poses
    return _joined([arrays for arrays, _ in results], parts[0].is_batch)


def closed_members(
    mechanism: TreeKinematics, poses: list[Array], t0: float
) -> tuple[list[Array], Array]:
    """Return the nearest closed poses of a batch, and the indices of the members that close."""
    parts = _parts(mechanism, [("pose", poses, 2)])
    results, chosen = [], []
    with reporter(None, parts[0].count, ASSEMBLIES) as report:
        for part in parts:
            last = _newton(part, t0, SEARCH_STEPS)
            against = [wrong_way(s, last.system.count) for s in last.states]
            is_closed = last.is_closed.copy()
            is_closed[np.concatenate([*against, np.zeros(0, np.int64)])] = False
            results.append(last.arrays(part))
            chosen.append(part.first + np.flatnonzero(is_closed))
            report(part.first + len(part.arrays[0]))
    return _joined(results, is_batch=True), np.concatenate(chosen)


def _closed(part: Part, t0: float) -> tuple[list[Array], bool]:
    """Return the closed poses of a part, and whether any pose has changed.

    Raises PoseError for the first member that does not close.
    """
    last = _newton(part, t0)
    for member in np.flatnonzero(~last.is_closed)[:1].tolist():
        if error := unfit_constraints(part.mechanism, last.first, part.pose_label, member):
            raise error
        label = part.label("pose", member)
        raise PoseError(no_convergence(last.system, last.states, last.off, member, label))
    for s in last.states:
        for member in wrong_way(s, last.system.count)[:1].tolist():
            name = name_of(part.mechanism, s.at)
            raise PoseError(reversed_joint(part.label("pose", member), name))
    return last.arrays(part), bool(not last.was_closed.all())


class Iterate(NamedTuple):
    """Last iterate of Newton's method.

    states, first : connections at `poses`, and at the first iterate.   off : residuals of rows.
    is_closed, was_closed : (count,), at the last and at the first iterate.
    """

    system: System
    states: list[ConnectionState]
    first: list[ConnectionState]
    off: list[list[Any]]
    poses: list[Pose]
    is_closed: Any
    was_closed: Any

    def arrays(self, part: Part) -> list[Array]:
        """Return the poses; those that were closed at first are unchanged."""
        unchanged = self.was_closed[:, None, None]
        return [
            np.where(unchanged, before, np.broadcast_to(pose_matrix(after), before.shape))
            for before, after in zip(part.arrays, self.poses, strict=True)
        ]


def _newton(part: Part, t0: float, steps: int = NEWTON_STEPS) -> Iterate:
    """Close the poses of a part.

    Newton's steps are damped by the squared residual (Levenberg, Marquardt). Convergence is then
    quadratic for redundant rows too, which are only nearly redundant away from closed poses. A
    member is closed if its residuals are rounding, or if they no longer fall and a run accepts them
    as a start: the numbers of a planar loop, given with 12 digits, fit each other no better.
    """
    system = System(part.mechanism, len(part.arrays[0]), is_stout=True)
    poses = [pose_components(pose) for pose in part.arrays]
    was_closed = np.zeros(system.count, dtype=bool)
    excesses: list[Array] = []
    for step in range(steps + 1):
        states = system.states(poses, None, np.float64(t0))
        states = _with_rows(states, lambda r: r.is_holonomic or r.second is not None)
        if step == 0:
            first = states
            if error := unfit_positions(states, t0):
                raise error
        off = [_residuals(s, before) for s, before in zip(states, first, strict=True)]
        excess = excess_of(system.count, states, off)
        is_closed = excess <= 1.0
        if step == 0:
            was_closed = is_closed
        if step == steps or step >= STALLED:  # misfits of redundant rows keep residuals open
            has_stalled = (step == steps) | (2.0 * excess > excesses[max(step - STALLED, 0)])
            is_closed = is_closed | (has_stalled & are_accepted(system.count, states, off))
        excesses.append(excess)
        if is_closed.all() or step == steps:
            break
        rows = system.decomposed(states)
        wanted = system.column([-plain(h) for values in off for h in values]) / rows.lengths
        wanted = np.where(np.isfinite(wanted), wanted, 0.0)
        moves = rows.lightest(wanted, DAMPING * summed(wanted * wanted))
        for i, screw in enumerate(moves):
            moved = se3.compose(poses[i], se3.exp(screw))
            moved = so3.orthonormalised(moved[0]), moved[1]
            poses[i] = where(is_closed, poses[i], moved)  # converged members are frozen
    return Iterate(system, states, first, off, poses, is_closed, was_closed)


def _residuals(s: ConnectionState, before: ConnectionState) -> list[Any]:
    """Values of a connection's rows; of a gear, relative to the mesh in the first pose."""
    if s.second is None:
        return residuals(s.at.rows, s.x, s.body)
    pairs = (zip(s.parts(r), before.parts(r), strict=True) for r in s.at.rows)
    return [
        sum(part.moved(now.x, then.x, now.body) for (now, part), (then, _) in pair)
        for pair in pairs
    ]


def _with_rows(
    states: list[ConnectionState], is_kept: Callable[[Row], bool]
) -> list[ConnectionState]:
    """Connections with part of their rows."""
    return [s._replace(at=s.at._replace(rows=tuple(filter(is_kept, s.at.rows)))) for s in states]


def unfit_positions(states: list[ConnectionState], t0: float) -> PoseError | None:
    """Error for the first position of a motor that is not finite at t0."""
    errors = (
        unfit_place(s.at.rows, [r.prescribed_place(s.x, s.body) for r in s.at.rows], t0)
        for s in states
    )
    return next(filter(None, errors), None)


def unfit_constraints(
    mechanism: TreeKinematics,
    states: list[ConnectionState],
    label: Callable[[int], str],
    member: int | None = None,
) -> PoseError | None:
    """Error for the first user's constraint that is not finite, or a derivative of it.

    label : function of a member's index that names its pose.   member : the only one to check.
    """
    for s in states:
        where = f" ({ends_of(mechanism, s.at)})"
        if error := unfit_constraint(s.at.rows, s.x, s.body, label, where=where, member=member):
            return error
    return None


# ---- twists and freedoms -----------------------------------------------------------------------


def projected(
    mechanism: TreeKinematics,
    twists: list[Array],
    poses: list[Array],
    t0: float,
    driven: list[Array] | None = None,
) -> list[Array]:
    """Return the nearest twists that satisfy all joints and loops.

    driven : twists of all links, by which fixed joints in the tree move; they are at rest if None.
    """
    arguments = [("twist", twists, 1), ("pose", poses, 2)]
    arguments += [("hold", driven, 1)] if driven else []
    parts = _parts(mechanism, arguments)
    return _joined([_projected(part, t0) for part in parts], parts[0].is_batch)


def _projected(part: Part, t0: float) -> list[Array]:
    links = len(part.mechanism.links)
    given, driven = part.arrays[:links], [components(x) for x in part.arrays[2 * links :]]
    poses = [pose_components(pose) for pose in part.arrays[links : 2 * links]]
    system = System(part.mechanism, len(given[0]))
    start = [tuple(twist[:, i] for i in range(6)) for twist in given]
    states = system.states(poses, start, np.float64(t0))
    rows = tuple(r for s in states for r in s.at.rows)
    prescribed = _prescribed(system, states, poses, driven)
    if error := unfit_rate(rows, prescribed, t0):
        raise error
    if error_of_pose := unfit_constraints(part.mechanism, states, part.pose_label):
        raise error_of_pose
    if not rows:
        return given
    decomposed = system.decomposed(states)
    goal = system.column(prescribed) / decomposed.lengths

    def rates(twists: list[Vec]) -> Array:
        return _rates(system, poses, twists, t0) / decomposed.lengths

    def nearest(twists: list[Vec]) -> list[Vec]:
        for _ in range(2):  # the second step corrects the rounding of the first
            changes = decomposed.lightest(goal - rates(twists))
            twists = [add(twist, change) for twist, change in zip(twists, changes, strict=True)]
        return twists

    is_driven = np.any(goal, axis=1)
    twists = nearest(start)
    # Near a singular pose, nearly redundant rows decide whether a start is accepted, unless the
    # pose leaves them open: redundant rows are then dependent only to that accuracy.
    missed = np.max(np.abs(goal - rates(twists)), axis=1) > MISSED * decomposed.speed(twists)
    missed &= ~is_driven
    if missed.any():
        least = np.clip(misfit_of(system.count, states), MISSED, RANK_TOLERANCE)
        decomposed.ranks = np.where(missed, decomposed.ranks_above(least), decomposed.ranks)
        pairs = zip(nearest(twists), twists, strict=True)
        twists = [where(missed, second, first) for second, first in pairs]
    residual = np.abs(goal - rates(twists))
    allowed = CONTRADICTION * np.abs(goal) + START_TOLERANCE * np.abs(rates(start))
    contradicted = (residual > np.max(allowed, axis=1, keepdims=True)) & is_driven[:, None]
    for member, row in np.argwhere(contradicted)[:1].tolist():
        at = [s.at for s in states for _ in s.at.rows][row]
        raise TwistError(
            f"{part.label('twist', member)}: no twist satisfies {name_of(part.mechanism, at)} "
            "beside the other joints and motors, which contradict each other; leave out a speed, "
            "or give one that fits"
        )
    return [np.broadcast_to(assembled(twist), (system.count, 6)) for twist in twists]


def _prescribed(
    system: System, states: list[ConnectionState], poses: list[Pose], driven: list[Vec]
) -> list[Any]:
    """Return the prescribed rate of each row; of a fixed joint in the tree by `driven`, if any."""
    rates = [r.prescribed_rate(s.x, s.body) for s in states for r in s.at.rows]
    if not driven:
        return rates
    moves = [(s, r) for s in system.states(poses, driven) for r in s.at.rows]
    return [
        s.rate(r) if is_fixed(system.mechanism, s.at) else rate
        for (s, r), rate in zip(moves, rates, strict=True)
    ]


def _rates(system: System, poses: list[Pose], twists: list[Vec], t0: float) -> Array:
    """Rates J V of the rows, (count, rows)."""
    states = system.states(poses, twists, np.float64(t0))
    return system.column([s.rate(r) for s in states for r in s.at.rows])


def mobility(
    mechanism: TreeKinematics,
    poses: list[Array],
    is_counted: Callable[[Row], bool] = lambda row: not row.depends_on_time,
) -> Mobility:
    """Count freedoms and redundant rows at these poses, by default without motors."""
    parts, counts = _parts(mechanism, [("pose", poses, 2)]), []
    for part in parts:
        system = System(part.mechanism, len(part.arrays[0]))
        states = system.states([pose_components(x) for x in part.arrays])
        states = _with_rows(states, is_counted)
        if error := unfit_constraints(part.mechanism, states, part.pose_label):
            raise error
        rows = system.decomposed(states)
        counts.append([rows.freedoms, rows.lengths.shape[1] - rows.ranks])
    numbers = _joined(counts, parts[0].is_batch)
    return Mobility(*(numbers if parts[0].is_batch else map(int, numbers)))
