"""Newton's method on all joints and loops of a mechanism, in the metric of its kinetic energy.

All rows together are J V = ḣ, V the twists of all links, and the nearest V is that of least kinetic
energy (`lierb.model.mechanism.row_system.DecomposedRows`): redundant rows, as every planar loop of
revolute joints has, need no choice. Each member of a batch is decomposed alone: its bits do not
depend on its neighbours.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from lierb.errors import PoseError, TwistError, body_label
from lierb.kernels.groups import se3, so3
from lierb.kernels.mechanics.constraints import residuals
from lierb.kernels.mechanics.newton_euler import Pose
from lierb.kernels.mechanics.scale import START_TOLERANCE
from lierb.kernels.numbers.arithmetic import absolute, plain, where
from lierb.kernels.numbers.vec import Vec, add
from lierb.model.acting import unfit_rate
from lierb.model.mechanism.row_system import (
    CLOSED,
    NEWTON_STEPS,
    Held,
    System,
    errors_of,
    name_of,
    one_of,
    reversed_joint,
    summed,
    velocity_of,
    wrong_way,
)
from lierb.support.arrays import Array, assembled, pose_components, pose_matrix

if TYPE_CHECKING:
    from lierb.model.mechanism.kinematics import TreeKinematics

# Of Newton's steps, by the square of what is open. Of 240 starts, four-bars and a Bricard linkage
# up to 0.8 off in every coordinate, all close with 0.1 to 1e-4, 229 with 1, 224 with none.
DAMPING = 1e-2
MISSED = 0.1 * START_TOLERANCE  # of the speed: what rows may be off in a projected twist
CONTRADICTION = 1e-6  # of what motors prescribe, that may be left over
MOST_NUMBERS = 2**22  # of the matrices that are looked at together


class Mobility(NamedTuple):
    """What joints and loops leave: numbers, or (n,) of them.

    freedoms : of the links' velocities.   redundant : rows that say what others say already.
    """

    freedoms: Any
    redundant: Any


def parts_of(mechanism: TreeKinematics, count: int) -> Iterator[slice]:
    """The batch, in parts whose matrices are small."""
    rows = sum(len(at.rows) for at in mechanism.connections)
    size = max(1, MOST_NUMBERS // max(1, rows * 6 * len(mechanism.links)))
    for start in range(0, count, size):
        yield slice(start, min(start + size, count))


# ---- poses -------------------------------------------------------------------------------------


def closed(mechanism: TreeKinematics, poses: list[Array]) -> list[Array]:
    """The poses nearest to these that close all joints and loops; those that do as they are."""
    size = mechanism.batch_size(**{f"pose[{i}]": (pose, 2) for i, pose in enumerate(poses)})
    count = size or 1
    spread = [np.broadcast_to(pose, (count, 4, 4)) for pose in poses]
    parts, was_open = [], False
    for part in parts_of(mechanism, count):
        of_part = mechanism.part(part) if count > 1 else mechanism
        found, moved = _closed(of_part, [pose[part] for pose in spread], part.start, count)
        parts.append(found)
        was_open = was_open or moved
    if not was_open:
        return poses
    whole = [np.concatenate(of_link) for of_link in zip(*parts, strict=True)]
    return [pose if size else pose[0] for pose in whole]


def _closed(
    mechanism: TreeKinematics, given: list[Array], first: int, count: int
) -> tuple[list[Array], bool]:
    """Newton's steps, damped by the square of what is open (Levenberg, Marquardt): they converge
    quadratically where rows are redundant too, which away from closed poses they are only nearly.
    """
    system = System(mechanism, len(given[0]), is_stout=True)
    poses = [pose_components(pose) for pose in given]
    was_closed = np.zeros(system.count, dtype=bool)
    for step in range(NEWTON_STEPS + 1):
        held = _of_poses(system.held(poses))
        off = [residuals(h.at.rows, h.x, h.body) for h in held]
        is_closed = np.ones(system.count, dtype=bool)
        for h, values in zip(held, off, strict=True):
            for excess in _excesses(h, values):
                is_closed &= excess <= 1.0
        if step == 0:
            was_closed = is_closed
        if is_closed.all() or step == NEWTON_STEPS:
            break
        rows = system.decomposed(held)
        wanted = system.column([-plain(h) for values in off for h in values]) / rows.lengths
        wanted = np.where(np.isfinite(wanted), wanted, 0.0)
        moves = rows.lightest(wanted, DAMPING * summed(wanted * wanted))
        for i, screw in enumerate(moves):
            moved = se3.compose(poses[i], se3.exp(screw))
            moved = so3.orthonormalised(moved[0]), moved[1]
            poses[i] = where(is_closed, poses[i], moved)  # nobody waits, or moves on, for another
    label = "pose" if count == 1 else "pose[{}]"
    for number in np.flatnonzero(~is_closed)[:1]:
        raise PoseError(
            _still_open(system, held, off, int(number), label.format(first + int(number)))
        )
    for h in held:
        for number in wrong_way(h, system.count)[:1]:
            raise PoseError(reversed_joint(mechanism, h.at, label.format(first + int(number))))
    kept = was_closed[:, None, None]
    found = [
        np.where(kept, before, np.broadcast_to(pose_matrix(after), before.shape))
        for before, after in zip(given, poses, strict=True)
    ]
    return found, bool(not was_closed.all())


def _of_poses(held: list[Held]) -> list[Held]:
    """Without the rows of motors, which are of velocities alone."""
    return [
        h._replace(at=h.at._replace(rows=tuple(r for r in h.at.rows if r.is_holonomic)))
        for h in held
    ]


def _excesses(h: Held, values: list[Any]) -> Iterator[Any]:
    """How far each row is off, relative to where rounding ends; 1 and below is closed."""
    small = CLOSED * h.length + h.rounding
    for r, value in zip(h.at.rows, values, strict=True):
        excess = absolute(plain(value)) / (small if r.is_translational else CLOSED)
        yield np.where(np.isfinite(excess), excess, np.inf)


def _still_open(
    system: System, held: list[Held], off: list[list[Any]], number: int, label: str
) -> str:
    mechanism = system.mechanism

    def worst(pair: tuple[Held, list[Any]]) -> float:
        return max((float(one_of(x, number)) for x in _excesses(*pair)), default=0.0)

    h, _ = max(zip(held, off, strict=True), key=worst)
    rows, freedoms = sum(len(each.at.rows) for each in held), 6 * len(mechanism.links)
    why = "start nearer to a closed pose, or look at the links' lengths: they may not reach"
    if rows >= freedoms:
        why += (
            f"; {rows} rows on {freedoms} freedoms are closed only where lengths and axes fit each "
            "other: joints with fewer rows, such as spherical, ask for less"
        )
    return (
        f"{label} does not come to close in {NEWTON_STEPS} Newton steps: "
        f"{name_of(mechanism, h.at)} stays open by {_opening(h, number)}; {why}"
    )


def _opening(h: Held, number: int) -> str:
    found = [
        f"{one_of(size, number):.3g}{unit}{' in rotation' if what == 'rotation' else ''}"
        for what, unit, size in errors_of(h)
        if any(r.error_kind == what for r in h.at.rows)
    ]
    return " and ".join(found)


# ---- twists and freedoms -----------------------------------------------------------------------


def projected(
    mechanism: TreeKinematics, twists: list[Array], poses: list[Array], t0: float
) -> list[Array]:
    """The twists nearest to these that satisfy all joints and loops."""
    sizes = {f"twist[{i}]": (twist, 1) for i, twist in enumerate(twists)}
    sizes |= {f"pose[{i}]": (pose, 2) for i, pose in enumerate(poses)}
    size = mechanism.batch_size(**sizes)
    count = size or 1
    parts = []
    for part in parts_of(mechanism, count):
        of_part = mechanism.part(part) if count > 1 else mechanism
        moving = [np.broadcast_to(twist, (count, 6))[part] for twist in twists]
        placed = [np.broadcast_to(pose, (count, 4, 4))[part] for pose in poses]
        parts.append(_projected(of_part, moving, placed, t0, part.start, count))
    whole = [np.concatenate(of_link) for of_link in zip(*parts, strict=True)]
    return [twist if size else twist[0] for twist in whole]


def _projected(
    mechanism: TreeKinematics,
    given: list[Array],
    placed: list[Array],
    t0: float,
    first: int,
    count: int,
) -> list[Array]:
    system = System(mechanism, len(given[0]))
    poses = [pose_components(pose) for pose in placed]
    twists = [tuple(twist[:, i] for i in range(6)) for twist in given]
    held = system.held(poses, twists, np.float64(t0))
    wanted = [r.prescribed_rate(h.x, h.body) for h in held for r in h.at.rows]
    rows = tuple(r for h in held for r in h.at.rows)
    if error := unfit_rate(rows, wanted, t0):
        raise error
    if not rows:
        return given
    decomposed = system.decomposed(held)
    lengths = decomposed.lengths
    goal = system.column(wanted) / lengths
    before = np.abs(_rates(system, poses, twists, t0) / lengths)

    def lacking(twists: list[Vec]) -> Array:
        return goal - _rates(system, poses, twists, t0) / lengths

    def nearest(twists: list[Vec]) -> list[Vec]:
        for _ in range(2):  # the second time, for what rounding has left of a large part
            changes = decomposed.lightest(lacking(twists))
            twists = [add(twist, change) for twist, change in zip(twists, changes, strict=True)]
        return twists

    is_driven = np.any(goal, axis=1)
    twists = nearest(twists)
    # Near a singular pose a row that hardly depends on the others decides whether a start is taken.
    missed = np.max(np.abs(lacking(twists)), axis=1) > MISSED * decomposed.speed(twists)
    missed &= ~is_driven
    if missed.any():
        decomposed.ranks = np.where(missed, decomposed.ranks_above(MISSED), decomposed.ranks)
        pairs = zip(nearest(twists), twists, strict=True)
        twists = [where(missed, again, before) for again, before in pairs]
    left = np.abs(lacking(twists))
    most = np.max(CONTRADICTION * np.abs(goal) + START_TOLERANCE * before, axis=1, keepdims=True)
    for number, row in np.argwhere((left > most) & is_driven[:, None])[:1]:
        at = [h.at for h in held for _ in h.at.rows][int(row)]
        label = body_label("twist", first + int(number), count)
        raise TwistError(
            f"{label}: no twist satisfies {name_of(mechanism, at)} beside the other joints and "
            "motors, which contradict each other; leave out a speed, or give one that fits"
        )
    return [np.broadcast_to(assembled(twist), (system.count, 6)) for twist in twists]


def _rates(system: System, poses: list[Pose], twists: list[Vec], t0: float) -> Array:
    """J V, (count, rows)."""
    held = system.held(poses, twists, np.float64(t0))
    rates = []
    for h in held:
        velocity = velocity_of(h.x)
        for r in h.at.rows:
            row = r.jacobian(h.x, h.body)
            total: Any = 0.0
            for a, b in zip(row, velocity, strict=True):
                total = total + a * b
            rates.append(total)
    return system.column(rates)


def mobility(mechanism: TreeKinematics, poses: list[Array]) -> Mobility:
    """Freedoms and redundant rows at these poses; motors are left out of both."""
    size = mechanism.batch_size(**{f"pose[{i}]": (pose, 2) for i, pose in enumerate(poses)})
    count = size or 1
    free, redundant = [], []
    for part in parts_of(mechanism, count):
        system = System(mechanism.part(part) if count > 1 else mechanism, part.stop - part.start)
        placed = [np.broadcast_to(pose, (count, 4, 4))[part] for pose in poses]
        held = _of_poses(system.held([pose_components(pose) for pose in placed]))
        found = system.decomposed(held)
        free.append(found.freedoms)
        redundant.append(found.lengths.shape[1] - found.ranks)
    mobility = Mobility(np.concatenate(free), np.concatenate(redundant))
    return mobility if size else Mobility(*(int(x[0]) for x in mobility))
