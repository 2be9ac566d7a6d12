"""Directions of a start: poses and twists of all links that change along parameters.

A start must stay on its joints and loops. A direction is therefore projected onto the motions that
these admit, by least kinetic energy, as `Problem.project` and `Mechanism.project` do. Where a joint
moves on its bodies, the relative motion D, D⁻¹Ḋ of its two frames is kept; loops, pitches, lengths
and constraints are then satisfied by the least change. Twists follow the poses.

Derivatives are parts of dual numbers over arrays, so that rows are differentiated exactly. A number
has one part, an array over all directions and trajectories.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lierb.kernels.groups import se3
from lierb.kernels.mechanics import elements as kinds
from lierb.kernels.mechanics.newton_euler import SE3, BodyConstants, Kinematics, Parameters, Pose
from lierb.kernels.numbers.arithmetic import plain
from lierb.kernels.numbers.dual import Dual, parts_of
from lierb.kernels.numbers.vec import Vec, add, cross, dot, mat_mat, mat_t_vec, mat_vec, skew
from lierb.kernels.systems.layout import POSE as POSE_NUMBERS
from lierb.model.base import Model
from lierb.model.connections import NOWHERE, Connection
from lierb.model.mechanism.decomposition import DecomposedRows
from lierb.model.mechanism.mechanism import Mechanism
from lierb.model.mechanism.row_system import System, velocity_of
from lierb.model.problem import as_mechanism
from lierb.support.arrays import Array, assembled, components, pose_components

POSE, TWIST, JOINT = "pose", "twist", "joint"  # what a parameter changes
Seeds = dict[str, Array]  # by field of the inputs, (directions, n or 1, numbers)


class Moved(NamedTuple):
    """Changes of all links along some directions, (directions, n, 6) each.

    poses : C⁻¹δC.   twists : δV.
    """

    poses: list[Array]
    twists: list[Array]


class Start:
    """Start of a run with the rows that it satisfies."""

    def __init__(
        self, model: Model, poses: Mapping[str, Array], twists: Mapping[str, Array], t0: float
    ) -> None:
        """poses, twists : by link."""
        self.model, self.poses, self.twists = model, [*poses.values()], [*twists.values()]
        self.t0 = np.float64(t0)
        self.with_rows = [i for i, e in enumerate(model.elements) if e.kind.rows]
        self._known: dict[bool, DecomposedRows] = {}

    @cached_property
    def at_rest(self) -> Start:
        """Return the same poses at rest, of which there may be fewer."""
        links = self.model.link_names
        poses = dict(zip(links, self.poses, strict=True))
        return Start(self.model, poses, dict.fromkeys(links, np.zeros(6)), float(self.t0))

    @cached_property
    def mechanism(self) -> Mechanism:
        """Return the model as a mechanism, without elements that have no rows."""
        motors = [force for force in self.model.forces if force.kind.rows]
        return as_mechanism(self.model, forces=motors, constraints=self.model.constraints)

    def moved(self, follows: str, changes: Seeds) -> Moved:
        """Change the start with poses or twists of some links, or with joints and constraints.

        follows : POSE, TWIST or JOINT.   changes : of fields of the inputs; of poses and twists
            directions in the body's axes.
        """
        if follows == JOINT:
            return self._of_joints(changes)
        start = self.at_rest if follows == TWIST else self  # what joints admit depends on poses
        units = [changes.get(f"{prefix}{follows}") for prefix in self.model.fields]
        admitted = start._admitted(units, is_rate=follows == TWIST)
        none = [np.zeros_like(each) for each in admitted]
        if follows == TWIST:
            return Moved(none, admitted)
        return self._following(Frames(self, {}), Moved(admitted, none))

    def _of_joints(self, seeds: Seeds) -> Moved:
        """Change the start with frames, pitches and lengths of joints, and with constraints."""
        frames = Frames(self, seeds)
        moved = self._carried(frames)
        off = self._changes(frames, moved, is_rate=False)
        if off is not None:
            pairs = zip(moved.poses, self._lightest(off, is_rate=False), strict=True)
            moved = moved._replace(poses=[pose + change for pose, change in pairs])
        return self._following(frames, moved)

    def misfits(self, seeds: Seeds) -> tuple[Array, Array]:
        """Return the changes that joints, loops and constraints ask of the rows of poses.

        seeds : of fields of the inputs, as in `moved`.

        The first array has all changes, (directions, n, rows), for rows of length 1. The second one
        has the part that no motion of the links satisfies.
        """
        frames = Frames(self, seeds)
        off = self._changes(frames, self._carried(frames), is_rate=False)
        rows = self._decomposed(is_rate=False)
        wanted = off / rows.lengths
        return wanted, np.stack([rows.missed(each) for each in wanted])

    # ---- projection ----------------------------------------------------------------------------

    @cached_property
    def count(self) -> int:
        """Return the number of different starts, 1 if all trajectories start alike."""
        poses = {f"pose[{i}]": (pose, 2) for i, pose in enumerate(self.poses)}
        twists = {f"twist[{i}]": (twist, 1) for i, twist in enumerate(self.twists)}
        return self.mechanism.batch_size(**poses, **twists) or 1

    @cached_property
    def system(self) -> System:
        return System(self.mechanism, self.count)

    @cached_property
    def placed(self) -> list[Pose]:
        return [pose_components(pose) for pose in self.poses]

    @cached_property
    def moving(self) -> list[Vec]:
        return [components(twist) for twist in self.twists]

    def _decomposed(self, is_rate: bool) -> DecomposedRows:
        """Return the decomposition of all rows, or of those of poses."""
        known = self._known
        if is_rate not in known:
            states = self.system.states(self.placed, self.moving, self.t0)
            kept = [s._replace(at=s.at._replace(rows=_rows(s.at, is_rate))) for s in states]
            known[is_rate] = self.system.decomposed(kept)
        return known[is_rate]

    @cached_property
    def _meshes(self) -> NDArray[np.bool_]:
        """Return True for the meshes of teeth among the rows of poses, [row]."""
        rows = (r for at in self.mechanism.connections for r in _rows(at, is_rate=False))
        return np.array([r.second is not None for r in rows])

    def _lightest(self, wanted: Array, is_rate: bool) -> list[Array]:
        """Return the changes of all links, (directions, n, 6), by which rows change as wanted.

        wanted : (directions, n, rows).
        """
        rows = self._decomposed(is_rate)
        changes = [rows.lightest(each / rows.lengths) for each in wanted]
        return [
            np.stack([np.broadcast_to(assembled(of_all[i]), (self.count, 6)) for of_all in changes])
            for i in range(len(self.poses))
        ]

    def _admitted(self, units: Sequence[Array | None], is_rate: bool) -> list[Array]:
        """Project directions of all links: changes, (directions, n, 6).

        units : by link, (directions, n or 1, 6), or None.
        is_rate : True for those of twists, which all rows bind; `_rows` are those of poses.
        """
        shape = (max(len(each) for each in units if each is not None), self.count, 6)
        moved = [np.zeros(shape) if x is None else np.broadcast_to(x, shape) for x in units]
        given = moved
        for _ in range(2):  # the second step corrects the rounding of the first
            rates = self._rates(moved, is_rate)
            if rates is None:
                break
            if not is_rate and self._meshes.any():  # teeth mesh in any pose, and then stay there
                off = self._rates([own - x for own, x in zip(moved, given, strict=True)], is_rate)
                assert off is not None
                rates = np.where(self._meshes, off, rates)
            pairs = zip(moved, self._lightest(-rates, is_rate), strict=True)
            moved = [own + change for own, change in pairs]
        return moved

    def _rates(self, moved: list[Array], is_rate: bool) -> Array | None:
        """Return J X of all rows, or of those of poses, (directions, n, rows); None without."""
        states = self.system.states(self.placed, [components(each) for each in moved], self.t0)
        rates = [s.rate(r) for s in states for r in _rows(s.at, is_rate)]
        shape = moved[0].shape[:2]
        return np.stack([np.broadcast_to(plain(x), shape) for x in rates], -1) if rates else None

    # ---- poses and twists that follow ----------------------------------------------------------

    def _carried(self, frames: Frames) -> Moved:
        """Return the changes of the links that keep the relative motions in their joints."""
        shape = (frames.count, self.count, 6)
        poses, twists = carried(self.mechanism, frames.parameters, self.placed, self.moving)
        links = range(len(self.poses))
        return Moved(
            [_parts(_moved_in_body(self.placed[i], poses[i]), shape) for i in links],
            [_parts(twists[i], shape) for i in links],
        )

    def _following(self, frames: Frames, moved: Moved) -> Moved:
        """Change the twists by least kinetic energy, so that they fit the changed poses."""
        off = self._changes(frames, moved, is_rate=True)
        if off is None:
            return moved
        pairs = zip(moved.twists, self._lightest(off, is_rate=True), strict=True)
        return moved._replace(twists=[twist + change for twist, change in pairs])

    def _changes(self, frames: Frames, moved: Moved, is_rate: bool) -> Array | None:
        """Return missing changes of all rows, or of their rates, (directions, n, rows)."""
        pairs = zip(self.placed, moved.poses, strict=True)
        poses = [_turned(pose, change) for pose, change in pairs]
        twists = [
            _with_parts(v, change) for v, change in zip(self.moving, moved.twists, strict=True)
        ]
        shape, missing = (len(moved.poses[0]), self.count, 1), []
        for at in self.mechanism.connections:
            x, body, change = frames.kinematics(at, poses, twists)
            for r in _rows(at, is_rate):
                if is_rate:
                    off = r.prescribed_rate(x, body) - dot(r.jacobian(x, body), velocity_of(x))
                    if r.second is not None:
                        joint = self.mechanism.joints[at.second]._replace(elements=at.elements)
                        other, ends, _ = frames.kinematics(joint, poses, twists)
                        off = off - dot(r.second.jacobian(other, ends), velocity_of(other))
                elif r.second is not None:
                    off = 0.0  # the teeth stay where they mesh
                elif r.has_value:
                    off = -r.value(x, body)
                else:
                    off = -dot(r.jacobian(x, body), change)
                missing.append(_parts((off,), shape))
        return np.concatenate(missing, axis=-1) if missing else None


def carried(
    mechanism: Mechanism,
    parameters: Callable[[Connection], Parameters],
    placed: list[Pose],
    moving: list[Vec],
) -> tuple[dict[int, Pose], dict[int, Vec]]:
    """Return poses and twists by link with other joints, but the relative motions of the old ones.

    mechanism : with the old joints.   parameters : function of a connection, of the new joints.
    placed, moving : poses and twists of all links with the old joints.
    """
    poses: dict[int, Pose] = {}
    twists: dict[int, Vec] = {}
    for i in mechanism.order:
        at = mechanism.joints[i]
        p, relative = parameters(at), mechanism.relative(at, placed)
        outside, twist = p.ground, mechanism.relative_twist(at, relative, moving)
        if at.parent != NOWHERE:
            outside = se3.compose(poses[at.parent], p.ground)
            twist = add(twist, mechanism.carried(at, relative, twists, p))
        poses[i] = se3.compose(se3.compose(outside, relative), se3.inverse(p.body))
        twists[i] = se3.Ad(p.body, twist)
    return poses, twists


class Frames:
    """Joints and constraints of a start, with derivatives along parameters.

    seeds : of fields of the inputs.
    """

    def __init__(self, start: Start, seeds: Seeds) -> None:
        self.start, self.seeds = start, seeds

    @property
    def count(self) -> int:
        """Return the number of directions."""
        return len(next(iter(self.seeds.values())))

    def parameters(self, at: Connection) -> Parameters:
        """Return the parameters of a connection, as dual numbers where its joint changes."""
        mechanism = self.start.mechanism
        p = mechanism.parameters(at)
        if at.joint is None:
            return p
        ends = at.body, at.parent, at.joint
        number = [(x.body, x.parent, x.joint) for x in mechanism.joints].index(ends)
        prefix = self.start.model.joint_fields[number]
        return p._replace(
            ground=self._frame(f"{prefix}ground_frame", p.ground),
            body=self._frame(f"{prefix}body_frame", p.body),
            pitch=self._numbers(f"{prefix}pitch", (p.pitch,))[0],
            length=self._numbers(f"{prefix}length", (p.length,))[0],
        )

    def kinematics(
        self, at: Connection, poses: list[Pose], twists: list[Vec]
    ) -> tuple[Kinematics, BodyConstants, Vec]:
        """Return the relative motion of a connection, its constants, and D⁻¹δD as parts."""
        start, mechanism, p = self.start, self.start.mechanism, self.parameters(at)
        relative = mechanism.relative(at, poses, p)
        velocity = mechanism.relative_twist(at, relative, twists, p)
        given = [x for i in at.elements for x in self._element(i)]
        acting = tuple(mechanism.elements[i].kind for i in at.elements)
        body = kinds.body_with(SE3, p, acting, given)
        x = SE3.kinematics(body, relative, velocity)._replace(time=start.t0)
        return x, body, _moved_in_body(mechanism.relative(at, start.placed), relative)

    def _element(self, i: int) -> Iterator[Any]:
        """Yield the parameters of an element, component by component."""
        prefix = self.start.model.element_fields[self.start.with_rows[i]]
        element = self.start.mechanism.elements[i]
        for name, shape in element.kind.shapes.items():
            own = components(element.parameters[name], len(shape))
            yield from self._numbers(f"{prefix}{name}", own)

    def _frame(self, field: str, frame: Pose) -> Pose:
        numbers = self._numbers(field, (*frame[0], *frame[1]))
        return numbers[:9], numbers[9:]

    def _numbers(self, field: str, numbers: Vec) -> Vec:
        if field not in self.seeds:
            return tuple(numbers)
        return _with_parts(tuple(numbers), self.seeds[field])


def frame_seeds(frame: Array, changes: Array) -> Array:
    """Return the derivatives of the numbers of poses F exp δ, (directions, n or 1, 12).

    frame : (4, 4) or (n, 4, 4).   changes : δ, (directions, n or 1, 6).
    """
    turned = _turned(pose_components(frame), changes)
    count = max(changes.shape[1], 1 if frame.ndim == 2 else len(frame))
    return _parts((*turned[0], *turned[1]), (len(changes), count, len(POSE_NUMBERS)))


def _rows(at: Connection, is_rate: bool) -> tuple[Any, ...]:
    """Return the rows of a connection, or those of its pose: holonomic ones and meshes of teeth."""
    if is_rate:
        return at.rows
    return tuple(r for r in at.rows if r.is_holonomic or r.second is not None)


def _with_parts(numbers: Vec, changes: Array) -> Vec:
    """Return dual numbers.   changes : derivatives, (directions, n or 1, numbers)."""
    return tuple(Dual(x, (changes[..., i],)) for i, x in enumerate(numbers))


def _turned(pose: Pose, change: Array) -> Pose:
    """Return `turned` for a change (directions, n or 1, 6)."""
    return turned(pose, components(change))


def turned(pose: Pose, axis: Vec) -> Pose:
    """Return C exp δ as dual numbers, with derivatives C δ.   axis : components of δ."""
    moved = mat_mat(pose[0], skew(axis[:3])) + mat_vec(pose[0], axis[3:])
    numbers = tuple(Dual(x, (part,)) for x, part in zip(sum(pose, ()), moved, strict=True))
    return numbers[:9], numbers[9:]


def _moved_in_body(before: Pose, after: Pose) -> Vec:
    """Return C⁻¹δC, angular then linear, as dual numbers of value zero.

    after : with derivatives.
    """
    columns = [
        tuple(after[0][3 * i + j] - before[0][3 * i + j] for i in range(3)) for j in range(3)
    ]
    x, y, z = (mat_t_vec(before[0], column) for column in columns)
    axis = tuple(0.5 * a for a in (y[2] - z[1], z[0] - x[2], x[1] - y[0]))
    place = tuple(a - b for a, b in zip(after[1], before[1], strict=True))
    return axis + mat_t_vec(before[0], place)


def _parts(numbers: Vec, shape: tuple[int, ...]) -> Array:
    """Return the derivatives of numbers, (directions, n, numbers)."""
    parts = np.zeros(shape)
    for i, x in enumerate(numbers):
        for part in parts_of(x):
            parts[..., i] = plain(part)
    return parts


def omega_units(frame: Array) -> Array:
    """Return turns about a joint's point on the body, which stays, (3, n or 1, 6)."""
    point = np.atleast_2d(frame[..., :3, 3])
    units = np.zeros((3, len(point), 6))
    for i in range(3):
        axis = np.eye(3)[i]
        units[i, :, :3] = axis
        units[i, :, 3:] = np.stack(cross(tuple(point.T), tuple(axis)), -1)
    return units
