"""Mechanisms from files: MJCF and URDF, both read by MuJoCo's own compiler.

It knows defaults, includes, orientation conventions, inertias of geoms, and what URDF's planar and
floating joints and mimics mean, and says where a file is wrong. Nothing of it is left when a
simulation runs.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from operator import attrgetter
from os import PathLike, fspath
from typing import Any, NamedTuple

import numpy as np

from lierb import forces, joints
from lierb.arrays import Array, as_positive
from lierb.composed_joints import SimpleJoint, composed
from lierb.errors import ArgumentError, LierbError, told
from lierb.extras import remedy
from lierb.joints import Joint
from lierb.model import Body
from lierb.user_elements import Force

WORLD = 0  # MuJoCo's number of the ground
GROUND = "ground"
KINDS = ("free", "ball", "slide", "hinge")  # by mjtJoint
DISABLED = {  # by mjtDisableBit: what of a model is then as good as zero
    "GRAVITY": ("opt.gravity",),
    "PASSIVE": ("jnt_stiffness", "jnt_stiffnesspoly", "dof_damping", "dof_dampingpoly"),
    "SPRING": ("jnt_stiffness", "jnt_stiffnesspoly"),
    "DAMPER": ("dof_damping", "dof_dampingpoly"),
    "LIMIT": ("jnt_limited",),
    "EQUALITY": ("eq_active0",),
    "CONSTRAINT": ("jnt_limited", "eq_active0"),
}
HAVE_FORCES = {  # kinds of the file, and joints about or along whose axis forces act
    "hinge": ("revolute", "cylindrical", "planar", "schoenflies"),
    "slide": ("prismatic", "cylindrical"),
}


class Placed(NamedTuple):
    """A body of the file: on which link it is, by name, and where in that link's body frame."""

    link: str
    pose: Array


@dataclass
class Parts:
    """What a `lierb.Mechanism` is made of, and what of the file is not in it."""

    gravity: Array
    links: list[tuple[str, Body, Joint, str]] = field(default_factory=list)
    loops: list[tuple[str, Joint, str, str]] = field(default_factory=list)
    forces: list[Force] = field(default_factory=list)
    left_out: list[str] = field(default_factory=list)


def read(path: Any, language: str, merge_fixed: bool, limit_stiffness: float | None) -> Parts:
    """The parts of a file. language : "MJCF" or "URDF".   limit_stiffness : N m/rad or N/m.

    Raises ArgumentError for a file that MuJoCo does not take, or that has what lierb has not.
    """
    model = _compiled(path, language)
    parts = Parts(np.array(model.opt.gravity))
    names = _names(model, parts)
    if limit_stiffness is not None:
        as_positive("limit_stiffness", limit_stiffness, "N m/rad, or N/m")
    try:
        placed = _add_links(model, names, parts, merge_fixed, limit_stiffness)
        _add_loops(model, names, placed, parts)
    except LierbError as error:
        raise ArgumentError(f"{told(fspath(path))}: {error}") from error
    if not parts.links:
        raise ArgumentError(f"{told(fspath(path))} has no body that moves")
    parts.left_out += _others(model)
    return parts


def _compiled(path: Any, language: str) -> Any:
    try:
        import mujoco
    except ImportError:
        raise ArgumentError(f"reading {language} needs mujoco: {remedy('mjcf')}") from None
    if not isinstance(path, (str, PathLike)):
        raise ArgumentError(f"path={told(path)}; expected the path of a file in {language}")
    try:
        ground = _named_world(path) if language == "URDF" else None
        if ground is None:
            spec = mujoco.MjSpec.from_file(fspath(path))
        else:
            spec = mujoco.MjSpec.from_string(ground)
        spec.compiler.fusestatic = False  # what is welded is merged here, or not
        if language == "URDF":
            for geom in list(spec.geoms):  # their meshes need not be there, and weigh nothing
                spec.delete(geom)
        model = spec.compile()
        _disable(model, mujoco.mjtDisableBit)
        return model
    except Exception as error:  # of files, whatever the reader finds
        raise ArgumentError(
            f"{told(fspath(path))} cannot be read as {language}: {told(str(error))}"
        ) from error


def _named_world(path: Any) -> str | None:
    """URDF with its root link called world, where a floating joint is on it: MuJoCo takes one only
    there. None for a file that needs no other name.
    """
    robot = ElementTree.parse(fspath(path)).getroot()
    held = {joint: joint.find("parent") for joint in robot.findall("joint")}
    children = {child.get("link") for joint in held for child in joint.findall("child")}
    roots = [link for link in robot.findall("link") if link.get("name") not in children]
    floats = {
        parent.get("link")
        for joint, parent in held.items()
        if parent is not None and joint.get("type") == "floating"
    }
    names = {link.get("name") for link in robot.findall("link")}
    if len(roots) != 1 or roots[0].get("name") not in floats or "world" in names:
        return None
    for parent in held.values():
        if parent is not None and parent.get("link") == roots[0].get("name"):
            parent.set("link", "world")
    roots[0].set("name", "world")
    return ElementTree.tostring(robot, encoding="unicode")


def _disable(model: Any, bits: Any) -> None:
    """Take away what a flag of the file disables."""
    for name, fields in DISABLED.items():
        bit = getattr(bits, f"mjDSBL_{name}", None)  # not all releases have all of them
        if bit is not None and model.opt.disableflags & int(bit):
            for path in fields:
                with suppress(AttributeError):
                    attrgetter(path)(model)[:] = 0


# ---- names -------------------------------------------------------------------------------------


def _names(model: Any, parts: Parts) -> list[str]:
    """A name for each body that is an identifier and no other's; the world's is the ground's."""
    found = [GROUND]
    for i in range(1, model.nbody):
        found.append(_free_name(model.body(i).name, f"body{i}", found, parts))
    return found


def _free_name(given: str, default: str, taken: list[str], parts: Parts) -> str:
    name = re.sub(r"\W", "_", given, flags=re.ASCII) or default
    name = name if name.isidentifier() else f"_{name}"
    unique, known = name, {other.lower() for other in taken}  # SQL, too, is blind to case
    for number in range(2, len(taken) + 3):
        if unique.lower() not in known:
            break
        unique = f"{name}_{number}"
    if unique != given and given:
        parts.left_out.append(f"the name {given!r}: it is {unique}")
    return unique


# ---- bodies and joints -------------------------------------------------------------------------


def _add_links(
    model: Any, names: list[str], parts: Parts, merge_fixed: bool, limit_stiffness: float | None
) -> list[Placed]:
    """Fill in the links; for each body of the file, on which of them it is."""
    placed = [Placed(GROUND, np.eye(4))]
    bodies: dict[str, list[tuple[float, Array, Array]]] = {}  # by link: mass, centre, inertia
    held: dict[str, tuple[Joint, str]] = {}
    for i in range(1, model.nbody):
        on, sequence = placed[model.body_parentid[i]], _joints(model, i)
        where = on.pose @ _pose(model.body_pos[i], model.body_quat[i])
        massless = model.body_mass[i] == 0.0
        # What hangs on a link without mass of its own is that link's mass.
        is_merged = massless or merge_fixed or on.link == GROUND or not bodies[on.link]
        if not sequence and is_merged:
            placed.append(Placed(on.link, where))
            if not massless and on.link != GROUND:
                bodies[on.link].append(_mass(model, i, where))
            continue
        try:
            held[names[i]] = composed(sequence, where), on.link
        except LierbError as error:
            raise ArgumentError(f"body {names[i]}: {error}") from error
        bodies[names[i]] = [] if massless else [_mass(model, i, np.eye(4))]
        placed.append(Placed(names[i], np.eye(4)))
        for j in _range(model.body_jntadr[i], model.body_jntnum[i]):
            of = JointForces(model, j, names[i], held[names[i]][0], limit_stiffness)
            parts.forces += [force.on(names[i]) for force in of.forces()]
            parts.left_out += of.left_out()
    for name, (joint, parent) in held.items():
        parts.links.append((name, _body(name, bodies[name]), joint, parent))
    return placed


def _joints(model: Any, i: int) -> list[SimpleJoint]:
    return [
        SimpleJoint(KINDS[model.jnt_type[j]], model.jnt_axis[j].copy(), model.jnt_pos[j].copy())
        for j in _range(model.body_jntadr[i], model.body_jntnum[i])
    ]


def _mass(model: Any, i: int, where: Array) -> tuple[float, Array, Array]:
    """Mass, centre and inertia about the frame's origin, of body i at a pose in that frame."""
    frame = where @ _pose(model.body_ipos[i], model.body_iquat[i])
    R, c, m = frame[:3, :3], frame[:3, 3], float(model.body_mass[i])
    about = R @ np.diag(model.body_inertia[i]) @ R.T
    return m, c, about + m * (c @ c * np.eye(3) - np.outer(c, c))


def _body(name: str, masses: list[tuple[float, Array, Array]]) -> Body:
    """All that is welded together as one."""
    if not masses:
        raise ArgumentError(
            f"body {name} moves and has no mass, so that its mass matrix is singular; give it one, "
            "or weld it to another"
        )
    total = sum(m for m, _, _ in masses)
    centre = sum(m * c for m, c, _ in masses) / total
    inertia = np.sum([I for _, _, I in masses], axis=0)
    try:
        return Body(total, 0.5 * (inertia + inertia.T), centre)
    except LierbError as error:
        raise ArgumentError(f"body {name}: {error}") from error


def _pose(position: Array, quaternion: Array) -> Array:
    from mujoco import mju_quat2Mat

    rotation, pose = np.empty(9), np.eye(4)
    mju_quat2Mat(rotation, quaternion)
    pose[:3, :3], pose[:3, 3] = rotation.reshape(3, 3), position
    return pose


def _range(first: int, count: int) -> range:
    return range(first, first + count)


# ---- springs, dampers and stops of joints ------------------------------------------------------


@dataclass(frozen=True)
class JointForces:
    """What acts in joint j of the file, which is on a link and part of a joint of the catalogue."""

    model: Any
    j: int
    link: str
    joint: Joint
    limit_stiffness: float | None

    @property
    def kind(self) -> str:
        return KINDS[self.model.jnt_type[self.j]]

    @property
    def has_force(self) -> bool:
        """Whether lierb's forces about or along a joint's axis fit."""
        return self.joint.name in HAVE_FORCES.get(self.kind, ())

    @property
    def spring(self) -> tuple[float, float]:
        """Stiffness and damping."""
        damping = self.model.dof_damping[self.model.jnt_dofadr[self.j]]
        return float(self.model.jnt_stiffness[self.j]), float(damping)

    @property
    def is_polynomial(self) -> bool:
        """Whether stiffness or damping have coefficients beyond the first."""
        further = [
            getattr(self.model, name)[at]
            for name, at in (
                ("jnt_stiffnesspoly", self.j),
                ("dof_dampingpoly", self.model.jnt_dofadr[self.j]),
            )
            if hasattr(self.model, name)  # not in all releases
        ]
        return any(np.any(numbers) for numbers in further)

    @property
    def _slack(self) -> float:
        """Where the spring is slack, from qpos0 on."""
        return self._on_axis(self.model.qpos_spring[self.model.jnt_qposadr[self.j]])

    @property
    def _is_wound(self) -> bool:
        """Whether its spring is slack more than half a turn away: no pose tells which way."""
        stiffness, _ = self.spring
        return self.kind == "hinge" and stiffness > 0.0 and abs(self._slack) > np.pi

    @property
    def range(self) -> tuple[float, float] | None:
        """The limits, from qpos0 on, along the axis of the joint of the catalogue; as the file has
        them where the joint has no such coordinate.
        """
        if not self.model.jnt_limited[self.j]:
            return None
        if not self.has_force:
            least, most = self.model.jnt_range[self.j]
            return float(least), float(most)
        lower, upper = sorted(self._on_axis(x) for x in self.model.jnt_range[self.j])
        return lower, upper

    def _on_axis(self, q: float) -> float:
        """A slide along a hinge's axis may count the other way."""
        direction = np.sign(self.model.jnt_axis[self.j] @ self.joint.body_frame[:3, 2])
        return float(direction * (q - self.model.qpos0[self.model.jnt_qposadr[self.j]]))

    @property
    def _has_stops(self) -> bool:
        if self.range is None or self.limit_stiffness is None or not self.has_force:
            return False
        lower, upper = self.range
        return self.kind == "slide" or upper - lower < 2 * np.pi

    def forces(self) -> Iterator[Force]:
        stiffness, damping = self.spring
        if (stiffness or damping) and self.has_force:
            slack = self._slack
            if self._is_wound:
                stiffness = slack = 0.0
            spring = {"stiffness": stiffness, "damping": damping}
            if self.kind == "hinge":
                yield forces.torsional_spring(**spring, angle=slack)
            else:
                yield forces.slide_spring(**spring, position=slack)
        if self._has_stops and self.range is not None and self.limit_stiffness is not None:
            stop = forces.joint_limit if self.kind == "hinge" else forces.slide_limit
            lower, upper = self.range
            yield stop(lower=lower, upper=upper, stiffness=self.limit_stiffness)

    def left_out(self) -> Iterator[str]:
        model = self.model
        label = f"joint {model.joint(self.j).name or self.link}"
        if any(self.spring) and not self.has_force:
            yield f"{label}: stiffness and damping of a {self.kind} joint"
        elif self._is_wound:
            yield f"{label}: stiffness {self.spring[0]:.6g}, slack at {self._slack:.6g} rad"
        if self.is_polynomial:
            yield f"{label}: stiffness and damping beyond their first coefficients"
        if self.range is not None and not self._has_stops:
            yield f"{label}: limits {self.range[0]:.6g} … {self.range[1]:.6g}"
        at = model.jnt_dofadr[self.j]
        for what, value in (("friction", model.dof_frictionloss), ("armature", model.dof_armature)):
            if value[at]:
                yield f"{label}: {what} {value[at]:.6g}"


# ---- loops -------------------------------------------------------------------------------------


def _add_loops(model: Any, names: list[str], placed: list[Placed], parts: Parts) -> None:
    import mujoco

    makers = {int(mujoco.mjtEq.mjEQ_CONNECT): _connect, int(mujoco.mjtEq.mjEQ_WELD): _weld}
    for k in range(model.neq):
        label = model.equality(k).name or f"equality {k}"
        maker = makers.get(int(model.eq_type[k]))
        if maker is None:
            kind = mujoco.mjtEq(model.eq_type[k]).name.removeprefix("mjEQ_").lower()
            parts.left_out.append(f"{label}: equality/{kind}")
        elif not model.eq_active0[k]:
            parts.left_out.append(f"{label}: an equality that is not active")
        else:
            ends = [_end(model, k, number, placed) for number in (1, 2)]
            name, frames = maker(model, k)
            frames = [end.pose @ frame for end, frame in zip(ends, frames, strict=True)]
            if ends[0].link == ends[1].link:
                parts.left_out.append(f"{label}: both of its bodies are {ends[0].link}")
                continue
            if ends[0].link == GROUND:
                ends, frames = ends[::-1], frames[::-1]
            joint = joints.JOINTS[name](body_frame=frames[0], parent_frame=frames[1])
            taken = [*names, *(loop[0] for loop in parts.loops)]
            title = _free_name(model.equality(k).name, f"loop{k}", taken, parts)
            parts.loops.append((title, joint, ends[0].link, ends[1].link))


def _end(model: Any, k: int, number: int, placed: list[Placed]) -> Placed:
    """The link of one of an equality's bodies, and that body's or site's frame in it."""
    identity = int((model.eq_obj1id if number == 1 else model.eq_obj2id)[k])
    if not _is_by_sites(model, k):
        return placed[identity]
    on = placed[model.site_bodyid[identity]]
    return Placed(on.link, on.pose @ _pose(model.site_pos[identity], model.site_quat[identity]))


def _is_by_sites(model: Any, k: int) -> bool:
    import mujoco

    return int(model.eq_objtype[k]) == int(mujoco.mjtObj.mjOBJ_SITE)


def _connect(model: Any, k: int) -> tuple[str, list[Array]]:
    """A point of each of the two bodies: 3 numbers each; sites are such points."""
    frames = [np.eye(4), np.eye(4)]
    if not _is_by_sites(model, k):
        frames[0][:3, 3], frames[1][:3, 3] = model.eq_data[k, :3], model.eq_data[k, 3:6]
    return "spherical", frames


def _weld(model: Any, k: int) -> tuple[str, list[Array]]:
    """An anchor in the second body, and the pose of its frame in the first."""
    anchor = np.eye(4)
    if _is_by_sites(model, k):
        return "fixed", [np.eye(4), anchor]
    data = model.eq_data[k]
    anchor[:3, 3] = data[:3]
    return "fixed", [_pose(data[3:6], data[6:10]), anchor]


# ---- what is left out --------------------------------------------------------------------------


def _others(model: Any) -> Iterator[str]:
    """What a simulation of the file would have had besides, each kind once, with its number."""
    collides = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    counts = Counter(
        {
            "geoms that collide": int(collides.sum()),
            "actuators": model.nu,
            "tendons": model.ntendon,
            "sensors": model.nsensor,
            "flexes": model.nflex,
            "plugins": model.nplugin,
            "bodies with gravcomp": int(np.count_nonzero(model.body_gravcomp)),
            "mocap bodies, which stand still": model.nmocap,
        }
    )
    yield from (f"{count} {what}" for what, count in counts.items() if count)
    if model.opt.density or model.opt.viscosity:
        yield "the fluid's density and viscosity"
