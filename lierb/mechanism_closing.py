"""Newton's method on all joints and loops of a mechanism, in the metric of its kinetic energy.

All rows together are J V = ḣ, V the twists of all links. With M = SSᵀ and y = SᵀV the nearest is
the one of least ‖y‖, that of the pseudo-inverse of J S⁻ᵀ, whose rows are brought to length 1:
redundant rows, as every planar loop of revolute joints has, ask for no choice. Members of a batch
are each looked at alone: bits do not depend on their neighbours.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from lierb.arrays import Array, as_poses, assembled, pose_components, pose_matrix, taken
from lierb.errors import ArgumentError, LierbError, PoseError, TwistError, body_label
from lierb.kernels.groups import se3, so3
from lierb.kernels.mechanics.constraints import (
    position_error_squared,
    rate_errors_squared,
    residuals,
    rotation_error_squared,
)
from lierb.kernels.mechanics.newton_euler import (
    SE3,
    BodyConstants,
    Kinematics,
    Parameters,
    Pose,
    inertia_about_com,
)
from lierb.kernels.mechanics.scale import (
    ROUNDING,
    START_TOLERANCE,
    bearings,
    length_of,
    rounding_of,
)
from lierb.kernels.numbers.arithmetic import absolute, maximum, plain, sqrt, where
from lierb.kernels.numbers.vec import (
    Mat,
    Vec,
    add,
    cross,
    cross_add,
    diagonal,
    mat_vec,
    neg,
    norm,
    scale,
    sub,
)
from lierb.kernels.numbers.zero import ZERO
from lierb.model import CLOSED, LEAST_GYRATION, NEWTON_STEPS, unfit_rate

if TYPE_CHECKING:
    from lierb.mechanism import Connection, Mechanism

# Singular values of rows of length 1, relative to the largest, below which rows depend on others: a
# start may be off its joints by 1e-9, and redundant rows are dependent only as far as it is closed.
RANK_TOLERANCE = 1e-7
CONTRADICTION = 1e-6  # of what motors prescribe, that may be left over
MOST_NUMBERS = 2**22  # of the matrices that are looked at together


class Mobility(NamedTuple):
    """What joints and loops leave: numbers, or (n,) of them.

    freedoms : of the links' velocities.   redundant : rows that say what others say already.
    """

    freedoms: Any
    redundant: Any


class _Metric:
    """The kinetic energy of one link, from its body-fixed twist: Θ = LLᵀ, m and c."""

    def __init__(self, p: Parameters, unit: Any, least: Any) -> None:
        """unit : in kg m², what makes y a number.   least : kg m², the inertia's trace at least."""
        inertia = inertia_about_com(p)
        trace = inertia[0] + inertia[4] + inertia[8]
        added = where(trace < least, least, 0.0 * trace)
        self.lower = _cholesky(add(inertia, diagonal((added, added, added))))
        self.com, self.root, self.unit = p.com, np.sqrt(p.mass), np.sqrt(unit)

    def row(self, wrench: Vec) -> Vec:
        """A row on V, of y."""
        torque, force = wrench[:3], wrench[3:]
        turning = _solved(self.lower, sub(torque, cross(self.com, force)))
        return scale(self.unit, turning + scale(1.0 / self.root, force))

    def twist(self, y: Vec) -> Vec:
        """V of a y."""
        omega = _solved_transposed(self.lower, scale(self.unit, y[:3]))
        moving = scale(self.unit / self.root, y[3:])
        return omega + sub(moving, cross(omega, self.com))


def _cholesky(m: Mat) -> Mat:
    """L of m = LLᵀ, row by row."""
    a = np.sqrt(m[0])
    b, d = m[3] / a, m[6] / a
    c = np.sqrt(m[4] - b * b)
    e = (m[7] - d * b) / c
    f = np.sqrt(m[8] - d * d - e * e)
    return (a, ZERO, ZERO, b, c, ZERO, d, e, f)


def _solved(lower: Mat, x: Vec) -> Vec:
    """L⁻¹ x."""
    a = x[0] / lower[0]
    b = (x[1] - lower[3] * a) / lower[4]
    return a, b, (x[2] - lower[6] * a - lower[7] * b) / lower[8]


def _solved_transposed(lower: Mat, x: Vec) -> Vec:
    """L⁻ᵀ x."""
    c = x[2] / lower[8]
    b = (x[1] - lower[7] * c) / lower[4]
    return (x[0] - lower[3] * b - lower[6] * c) / lower[0], b, c


class _Held(NamedTuple):
    """A connection at a pose."""

    at: Connection
    parameters: Parameters
    body: BodyConstants
    x: Kinematics
    length: Any  # m: the larger one of the lengths of its two links
    rounding: Any  # m, of the distance between points that coincide


class System:
    """A mechanism's rows at given poses of its links, all members of its batch at once."""

    def __init__(self, mechanism: Mechanism, count: int, is_stout: bool = False) -> None:
        """is_stout : whether a link that is small beside its arms counts as larger."""
        self.mechanism, self.count = mechanism, count
        of_links = [mechanism.parameters(at) for at in mechanism.joints[: len(mechanism.links)]]
        self.lengths = [length_of(p) for p in of_links]
        self.length = _largest(self.lengths)
        total: Any = 0.0
        for p in of_links:
            total = total + p.mass
        unit = total * self.length**2
        self.metrics = [
            _Metric(p, unit, p.mass * (LEAST_GYRATION * length) ** 2 if is_stout else 0.0)
            for p, length in zip(of_links, self.lengths, strict=True)
        ]

    @cached_property
    def connections(self) -> list[tuple[Connection, Parameters, BodyConstants, Any]]:
        """With what is the same at all poses: parameters, constants and length."""
        mechanism, found = self.mechanism, []
        for at in mechanism.connections:
            p = mechanism.parameters(at)
            length = self.lengths[at.body] if at.joint is None else length_of(p)
            if at.parent >= 0:
                other = mechanism.parameters(mechanism.joints[at.parent])
                if at.joint is not None:  # with the arm from its centre of mass to this joint
                    other = other._replace(body=p.ground)
                length = maximum(length, length_of(other))
            found.append((at, p, mechanism.constants(at), length))
        return found

    def held(
        self, poses: list[Pose], twists: list[Vec] | None = None, t0: Any = 0.0
    ) -> list[_Held]:
        """Every connection, moving at these twists."""
        found = []
        for at, p, body, length in self.connections:
            relative = self.mechanism.relative(at, poses)
            moving: Vec = (0.0,) * 6
            if twists is not None:
                moving = self.mechanism.relative_twist(at, poses, twists)
            x = SE3.kinematics(body, relative, moving)._replace(time=t0)
            rounding = rounding_of(p, poses[at.body])
            if at.parent >= 0:
                rounding = rounding + ROUNDING * norm(poses[at.parent][1])
            found.append(_Held(at, p, body, x, length, rounding))
        return found

    def matrix(self, held: list[_Held]) -> tuple[Array, Array]:
        """J S⁻ᵀ with rows of length 1, (count, rows, 6 links), and their lengths before."""
        total = sum(len(h.at.rows) for h in held)
        found = np.zeros((self.count, total, 6 * len(self.metrics)))
        number = 0
        for h in held:
            seen = se3.compose(h.parameters.ground, (h.x.q, h.x.d))  # B from the parent
            for r in h.at.rows:
                row = r.jacobian(h.x, h.body)
                self._put(found, number, h.at.body, _moved(h.parameters.body, row))
                if h.at.parent >= 0:
                    self._put(found, number, h.at.parent, neg(_moved(seen, row)))
                number += 1
        found[~np.isfinite(found).all(axis=(1, 2))] = 0.0  # no step, so that it stays open
        lengths = np.sqrt(_summed(found * found))
        lengths = np.where(lengths == 0.0, 1.0, lengths)
        return found / lengths[..., None], lengths

    def _put(self, matrix: Array, row: int, link: int, wrench: Vec) -> None:
        matrix[:, row, 6 * link : 6 * link + 6] = assembled(self.metrics[link].row(wrench))

    def twists(self, y: Array) -> list[Vec]:
        """V of every link."""
        parts = tuple(y[:, i] for i in range(y.shape[1]))
        return [m.twist(parts[6 * i : 6 * i + 6]) for i, m in enumerate(self.metrics)]

    def column(self, numbers: list[Any]) -> Array:
        """One number for each row, (count, rows)."""
        found = np.empty((self.count, len(numbers)))
        for i, number in enumerate(numbers):
            found[:, i] = plain(number)
        return found


def _moved(frame: Pose, wrench: Vec) -> Vec:
    """A wrench in a frame, in what the frame is seen from."""
    force = mat_vec(frame[0], wrench[3:])
    return cross_add(frame[1], force, mat_vec(frame[0], wrench[:3])) + force


def _largest(lengths: list[Any]) -> Any:
    found = lengths[0]
    for length in lengths[1:]:
        found = maximum(found, length)
    return found


def _summed(array: Array) -> Array:
    """Over the last axis, in its order: `sum` may take another one in another batch."""
    total = np.zeros(array.shape[:-1])
    for i in range(array.shape[-1]):
        total = total + array[..., i]
    return total


def _least(matrix: Array, wanted: Array, damping: Array | float = 0.0) -> Array:
    """The least y with A y = wanted, of a damped one the y of least ‖A y − wanted‖² + damping ‖y‖².

    damping : (count,).
    """
    u, values, vt = np.linalg.svd(matrix, full_matrices=False)
    kept = values > RANK_TOLERANCE * values[:, :1]
    squares = values * values + np.reshape(damping, (-1, 1))
    gains = np.where(kept, values, 0.0) / np.where(kept, squares, 1.0)
    parts = gains * _summed(np.swapaxes(u, 1, 2) * wanted[:, None, :])
    return _summed(np.swapaxes(vt, 1, 2) * parts[:, None, :])


def parts_of(mechanism: Mechanism, count: int) -> Iterator[slice]:
    """The batch, in parts whose matrices are small."""
    rows = sum(len(at.rows) for at in mechanism.connections)
    size = max(1, MOST_NUMBERS // max(1, rows * 6 * len(mechanism.links)))
    for start in range(0, count, size):
        yield slice(start, min(start + size, count))


# ---- poses -------------------------------------------------------------------------------------


def closed(mechanism: Mechanism, poses: list[Array]) -> list[Array]:
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
    mechanism: Mechanism, given: list[Array], first: int, count: int
) -> tuple[list[Array], bool]:
    """Newton's steps, damped by the square of what is open (Levenberg, Marquardt): they converge
    quadratically where rows are redundant too, which away from closed poses they are only nearly.
    """
    system = System(mechanism, len(given[0]), is_stout=True)
    poses = [pose_components(pose) for pose in given]
    was_closed = np.zeros(system.count, dtype=bool)
    for step in range(NEWTON_STEPS + 1):
        held = system.held(poses)
        off = [residuals(h.at.rows, h.x, h.body) for h in held]
        is_closed = np.ones(system.count, dtype=bool)
        for h, values in zip(held, off, strict=True):
            for excess in _excesses(h, values):
                is_closed &= excess <= 1.0
        if step == 0:
            was_closed = is_closed
        if is_closed.all() or step == NEWTON_STEPS:
            break
        matrix, lengths = system.matrix(held)
        wanted = system.column([-plain(h) for values in off for h in values]) / lengths
        wanted = np.where(np.isfinite(wanted), wanted, 0.0)
        y = _least(matrix, wanted, _summed(wanted * wanted))
        for i, screw in enumerate(system.twists(y)):
            moved = se3.compose(poses[i], se3.exp(screw))
            moved = so3.orthonormalised(moved[0]), moved[1]
            poses[i] = where(is_closed, poses[i], moved)  # nobody waits, or moves on, for another
    label = "pose" if count == 1 else "pose[{}]"
    for number in np.flatnonzero(~is_closed)[:1]:
        raise PoseError(
            _still_open(system, held, off, int(number), label.format(first + int(number)))
        )
    for h in held:
        for number in _wrong_way(h, system.count)[:1]:
            raise PoseError(_reversed(mechanism, h.at, label.format(first + int(number))))
    kept = was_closed[:, None, None]
    found = [
        np.where(kept, before, np.broadcast_to(pose_matrix(after), before.shape))
        for before, after in zip(given, poses, strict=True)
    ]
    return found, bool(not was_closed.all())


def _excesses(h: _Held, values: list[Any]) -> Iterator[Any]:
    """How far each row is off, relative to where rounding ends; 1 and below is closed."""
    small = CLOSED * h.length + h.rounding
    for r, value in zip(h.at.rows, values, strict=True):
        excess = absolute(plain(value)) / (small if r.is_translational else CLOSED)
        yield np.where(np.isfinite(excess), excess, np.inf)


def _wrong_way(h: _Held, count: int) -> Any:
    """Numbers of members that hold a joint half a turn off, which no row sees."""
    against = np.zeros(count, dtype=bool)
    for bearing in bearings(h.at.rows, h.x.q):
        against |= np.broadcast_to(bearing <= 0.0, (count,))
    return np.flatnonzero(against)


def _still_open(
    system: System, held: list[_Held], off: list[list[Any]], number: int, label: str
) -> str:
    mechanism = system.mechanism

    def worst(pair: tuple[_Held, list[Any]]) -> float:
        return max(float(_of(x, number)) for x in _excesses(*pair))

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
        f"{_named(mechanism, h.at)} stays open by {_opening(h, number)}; {why}"
    )


def _reversed(mechanism: Mechanism, at: Connection, label: str) -> str:
    return (
        f"{label} holds {_named(mechanism, at)} the wrong way round, half a turn off, which no row "
        "sees; turn a link or one of the joint's frames by 180°"
    )


def _named(mechanism: Mechanism, at: Connection) -> str:
    """A connection for a message."""
    ends = " to ".join(mechanism.names[i] if i >= 0 else "ground" for i in (at.body, at.parent))
    if at.joint is None or at.elements:
        return f"{at.name} ({ends})"
    what = "joint of" if at.name == mechanism.names[at.body] else "loop"
    return f"the {what} {at.name} ({at.joint.name}, {ends})"


def _errors(h: _Held) -> tuple[tuple[str, str, Any], tuple[str, str, Any]]:
    rows = h.at.rows
    return (
        ("position", " m", sqrt(plain(position_error_squared(rows, h.x, h.body)))),
        ("rotation", "", sqrt(plain(rotation_error_squared(rows, h.x, h.body)))),
    )


def _opening(h: _Held, number: int) -> str:
    found = [
        f"{_of(size, number):.3g}{unit}{' in rotation' if what == 'rotation' else ''}"
        for what, unit, size in _errors(h)
        if any(r.error_kind == what for r in h.at.rows)
    ]
    return " and ".join(found)


def _of(numbers: Any, member: int) -> float:
    """The number of one member of the batch, or of all of them."""
    array = np.atleast_1d(plain(numbers))
    return float(array[member if len(array) > 1 else 0])


# ---- twists and freedoms -----------------------------------------------------------------------


def projected(
    mechanism: Mechanism, twists: list[Array], poses: list[Array], t0: float
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
    mechanism: Mechanism,
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
    matrix, lengths = system.matrix(held)
    goal = system.column(wanted) / lengths
    before = np.abs(_rates(system, poses, twists, t0) / lengths)
    for _ in range(2):  # the second time, for what rounding has left of a large part
        lacking = goal - _rates(system, poses, twists, t0) / lengths
        changes = system.twists(_least(matrix, lacking))
        twists = [add(twist, change) for twist, change in zip(twists, changes, strict=True)]
    left = np.abs(goal - _rates(system, poses, twists, t0) / lengths)
    most = np.max(CONTRADICTION * np.abs(goal) + START_TOLERANCE * before, axis=1, keepdims=True)
    for number, row in np.argwhere((left > most) & np.any(goal, axis=1, keepdims=True))[:1]:
        at = [h.at for h in held for _ in h.at.rows][int(row)]
        label = body_label("twist", first + int(number), count)
        raise TwistError(
            f"{label}: no twist satisfies {_named(mechanism, at)} beside the other joints and "
            "motors, which contradict each other; leave out a speed, or give one that fits"
        )
    return [np.broadcast_to(assembled(twist), (system.count, 6)) for twist in twists]


def _rates(system: System, poses: list[Pose], twists: list[Vec], t0: float) -> Array:
    """J V, (count, rows)."""
    held = system.held(poses, twists, np.float64(t0))
    rates = []
    for h in held:
        velocity = _velocity(h.x)
        for r in h.at.rows:
            row = r.jacobian(h.x, h.body)
            total: Any = 0.0
            for a, b in zip(row, velocity, strict=True):
                total = total + a * b
            rates.append(total)
    return system.column(rates)


def _velocity(x: Kinematics) -> Vec:
    """D⁻¹Ḋ."""
    return x.omega + x.point_rate


def mobility(mechanism: Mechanism, poses: list[Array]) -> Mobility:
    """Freedoms and redundant rows at these poses; motors are left out of both."""
    size = mechanism.batch_size(**{f"pose[{i}]": (pose, 2) for i, pose in enumerate(poses)})
    count = size or 1
    free, redundant = [], []
    for part in parts_of(mechanism, count):
        system = System(mechanism.part(part) if count > 1 else mechanism, part.stop - part.start)
        placed = [np.broadcast_to(pose, (count, 4, 4))[part] for pose in poses]
        held = [
            h._replace(at=h.at._replace(rows=tuple(r for r in h.at.rows if r.is_holonomic)))
            for h in system.held([pose_components(pose) for pose in placed])
        ]
        matrix, _ = system.matrix(held)
        ranks = _ranks(matrix)
        free.append(matrix.shape[2] - ranks)
        redundant.append(matrix.shape[1] - ranks)
    found = Mobility(np.concatenate(free), np.concatenate(redundant))
    return found if size else Mobility(*(int(x[0]) for x in found))


def _ranks(matrix: Array) -> Any:
    if matrix.shape[1] == 0:
        return np.zeros(len(matrix), dtype=np.int64)
    values = np.linalg.svd(matrix, compute_uv=False)
    return np.count_nonzero(values > RANK_TOLERANCE * values[:, :1], axis=1)


# ---- starts ------------------------------------------------------------------------------------


def violation(mechanism: Mechanism, pose: Any, twist: Any, t0: float = 0.0) -> LierbError | None:
    """What is wrong with a start, as an error to raise or to warn of; None if nothing is.

    pose, twist : of all links, as `lierb.integrate` takes them.   t0 : s.

    Tolerances are those of one body (`lierb.kernels.mechanics.scale`), of the larger one of the two
    lengths and the sum of the speeds of the links that a joint is between.
    """
    placed, moving = mechanism.poses("pose0", pose), mechanism.twists("twist0", twist)
    sizes = {f"pose0[{n!r}]": placed[i][1][0] for i, n in enumerate(mechanism.names)}
    sizes |= {f"twist0[{n!r}]": moving[i][0] for i, n in enumerate(mechanism.names)}
    count = mechanism.batch_size(**sizes) or 1
    with np.errstate(all="ignore"):
        system = System(mechanism, count)
        held = system.held(placed, moving, np.float64(t0))
        found = _pose_violation(system, held, pose) or _twist_violation(system, held, moving, t0)
        return found or _immobile(mechanism, pose, count)


def _pose_violation(system: System, held: list[_Held], pose: Any) -> PoseError | None:
    mechanism, count = system.mechanism, system.count
    for h in held:
        for number in _wrong_way(h, count)[:1]:
            label = body_label("pose0", int(number), count)
            return PoseError(_reversed(mechanism, h.at, label))
        most = {"position": START_TOLERANCE * h.length + h.rounding, "rotation": START_TOLERANCE}
        for what, unit, size in _errors(h):
            allowed = most[what]
            bad = np.flatnonzero(~np.broadcast_to((size <= allowed) & (allowed < np.inf), (count,)))
            for number in bad[:1]:
                member = int(number)
                remedy = _what_close_does(mechanism, pose, member)
                return PoseError(
                    f"{body_label('pose0', member, count)} does not close "
                    f"{_named(mechanism, h.at)}: {what} error {_of(size, member):.3g}{unit} > "
                    f'{_of(allowed, member):.3g}{unit}; {remedy} (check="warn" integrates it all '
                    "the same)"
                )
    return None


def _what_close_does(mechanism: Mechanism, pose: Any, member: int) -> str:
    """How far `close` would move the links of one member."""
    own = {name: taken(as_poses("pose0", pose[name]), member, 2) for name in mechanism.names}
    alone = mechanism.of_body(member) if mechanism.batch_size() else mechanism
    try:
        near = closed(alone, list(own.values()))
    except LierbError as error:
        return f"mechanism.close(pose0) does not help: {error}"
    far, turned = 0.0, 0.0
    for before, after in zip(own.values(), near, strict=True):
        (q, d), (r, e) = pose_components(before), pose_components(after)
        far = max(far, float(norm(sub(e, d))))
        turned = max(turned, float(norm(so3.log(so3.compose(so3.inverse(q), r)))))
    return (
        f"mechanism.close(pose0) closes it, and moves links by up to {far:.3g} m and "
        f"{turned:.3g} rad"
    )


def _twist_violation(
    system: System, held: list[_Held], twists: list[Vec], t0: float
) -> TwistError | None:
    count = system.count
    for h in held:
        rates = [r.prescribed_rate(h.x, h.body) for r in h.at.rows]
        if unfit := unfit_rate(h.at.rows, rates, t0):
            return unfit
        allowed = _rate_tolerances(system, h, twists)
        squares = rate_errors_squared(h.at.rows, h.x, h.body, _velocity(h.x))
        for what, unit, square, most in zip(
            ("velocity", "rotation rate"), ("m/s", "rad/s"), squares, allowed, strict=True
        ):
            error = sqrt(plain(square))
            bad = np.flatnonzero(~np.broadcast_to((error <= most) & (most < np.inf), (count,)))
            for number in bad[:1]:
                member = int(number)
                return TwistError(
                    f"{body_label('twist0', member, count)} violates "
                    f"{_named(system.mechanism, h.at)}: {what} {_of(error, member):.3g} {unit} > "
                    f"{_of(most, member):.3g} {unit}; mechanism.project(twist0, pose0) is the "
                    'nearest twist that all joints allow (check="warn" integrates it all the same)'
                )
    return None


def _rate_tolerances(system: System, h: _Held, twists: list[Vec]) -> tuple[Any, Any]:
    """In m/s and rad/s, as of one body: by the speed, and by what is brought about in its time."""
    speed: Any = 0.0
    for i in (h.at.body, h.at.parent):
        if i >= 0:
            omega, com = twists[i][:3], system.metrics[i].com
            speed = speed + norm(cross_add(omega, com, twists[i][3:])) + h.length * norm(omega)
    position = START_TOLERANCE * h.length + h.rounding
    ahead = sqrt(norm(h.parameters.gravity) / h.length)
    for r in h.at.rows:
        if not r.is_holonomic:
            ahead = ahead + sqrt(absolute(plain(r.acceleration(h.x, h.body))))
    brought = ROUNDING * ahead
    return (
        position / h.length * speed + h.length * brought,
        START_TOLERANCE * speed / h.length + brought,
    )


def _immobile(mechanism: Mechanism, pose: Any, count: int) -> ArgumentError | None:
    """The error where loops and constraints leave nothing of the freedoms that the tree has."""
    if not any(at.rows and at.joint is None for at in mechanism.places) and not mechanism.loops:
        return None
    free, redundant = mechanism.freedoms(pose)
    for number in np.flatnonzero(np.atleast_1d(free) == 0)[:1]:
        excess = int(np.atleast_1d(redundant)[number])
        return ArgumentError(
            f"{body_label('pose0', int(number), count)}: the mechanism cannot move, its joints and "
            f"loops leave no freedom ({excess} of their rows are redundant); take joints with more "
            "freedoms, such as spherical or universal, or leave a loop out"
        )
    return None


__all__ = ["Mobility", "System", "closed", "mobility", "projected", "violation"]
