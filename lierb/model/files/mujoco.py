"""Mechanisms from files: MJCF and URDF, both compiled by MuJoCo.

Its compiler knows defaults, includes, orientation conventions and inertias of geoms, and says where
a file is wrong. `lierb.model.files.urdf` writes its specification for URDF. Nothing of MuJoCo is
left when a simulation runs.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from operator import attrgetter
from os import PathLike, fspath
from pathlib import Path
from typing import Any, NamedTuple
from xml.parsers import expat

import numpy as np

from lierb.errors import ArgumentError, LierbError, told
from lierb.model import forces, joints
from lierb.model.bodies.body import Body
from lierb.model.files import inertials, urdf
from lierb.model.files.composed_joints import SimpleJoint, composed
from lierb.model.files.welded_bodies import WORLD, label_of, moving_body, pose_of, rigid_groups
from lierb.model.functions.elements import Force
from lierb.model.joints.joint import Joint
from lierb.support.arrays import Array, as_positive
from lierb.support.extras import remedy

GROUND = "ground"
KINDS = ("free", "ball", "slide", "hinge")  # by mjtJoint
CONTACT = ("geom_contype", "geom_conaffinity")
DISABLED = {  # by mjtDisableBit: what of a model is then as good as zero
    "GRAVITY": ("opt.gravity",),
    "PASSIVE": ("jnt_stiffness", "jnt_stiffnesspoly", "dof_damping", "dof_dampingpoly"),
    "SPRING": ("jnt_stiffness", "jnt_stiffnesspoly"),
    "DAMPER": ("dof_damping", "dof_dampingpoly"),
    "LIMIT": ("jnt_limited",),
    "EQUALITY": ("eq_active0",),
    "CONTACT": CONTACT,
    "FRICTIONLOSS": ("dof_frictionloss",),
    "CONSTRAINT": ("jnt_limited", "eq_active0", "dof_frictionloss", *CONTACT),
}
READ_OPTIONS = ("gravity", "density", "viscosity", "disableflags")
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
    model, left_out = _compiled(path, language)
    parts = Parts(np.array(model.opt.gravity))
    if limit_stiffness is not None:
        as_positive("limit_stiffness", limit_stiffness, "N m/rad, or N/m")
    try:
        placed = _add_links(model, parts, merge_fixed, limit_stiffness)
        _add_loops(model, placed, parts)
    except LierbError as error:
        raise ArgumentError(f"{told(fspath(path))}: {error}") from error
    if not parts.links:
        raise ArgumentError(f"{told(fspath(path))} has no body that moves")
    parts.left_out += [*_others(model), *left_out]
    return parts


def _compiled(path: Any, language: str) -> tuple[Any, list[str]]:
    """The model of a file, and what of the file is not in it."""
    try:
        import mujoco
    except ImportError:
        raise ArgumentError(f"reading {language} needs mujoco: {remedy('mjcf')}") from None
    if not isinstance(path, (str, PathLike)):
        raise ArgumentError(f"path={told(path)}; expected the path of a file in {language}")
    spec = None
    try:
        robot = urdf.read(path) if language == "URDF" else None
        spec = mujoco.MjSpec.from_file(fspath(path)) if robot is None else robot.spec
        spec.compiler.fusestatic = False  # what is welded is merged here, or not
        model = inertials.compiled(spec)
    except Exception as error:  # of files, whatever the reader finds
        message = " ".join(str(error).split())
        at = _at_line(path, message) + _with_mesh(spec, message)
        raise ArgumentError(
            f"{told(fspath(path))} cannot be read as {language}: {message}{at}"
        ) from error
    if robot is not None:
        model.body_mass[WORLD] = robot.world_mass
        for name, ends in robot.limits.items():  # MuJoCo compiles none that lock a joint
            j = model.joint(name).id
            model.jnt_limited[j], model.jnt_range[j] = True, ends
    _disable(model, mujoco.mjtDisableBit)
    return model, [] if robot is None else robot.left_out


def _at_line(path: Any, message: str) -> str:
    """Names of the elements on a line, where a message of MuJoCo's has the line and no name.

    An element without a name goes by the one that it is in.
    """
    at = re.search(r"Element (?:'(\w+)'|name ''.*), line (\d+)", message)
    if at is None:
        return ""
    kind, line = at[1], int(at[2])
    owners, found = [""], []
    parser = expat.ParserCreate()

    def start(tag: str, attributes: dict[str, str]) -> None:
        owners.append(f"{tag} {attributes['name']}" if "name" in attributes else owners[-1])
        is_meant = tag == kind if kind else "name" not in attributes
        if is_meant and parser.CurrentLineNumber == line and owners[-1]:
            found.append(owners[-1])

    parser.StartElementHandler = start
    parser.EndElementHandler = lambda _: owners.pop()
    with suppress(expat.ExpatError, OSError), Path(path).open("rb") as file:
        parser.ParseFile(file)
    return f" (on this line: {', '.join(dict.fromkeys(found))})" if found else ""


def _with_mesh(spec: Any, message: str) -> str:
    """Names of the bodies with a mesh whose file a message of MuJoCo's gives."""
    meshes = [] if spec is None else [mesh for mesh in spec.meshes if mesh.file]
    names = {mesh.name for mesh in meshes if mesh.file in message}
    bodies = {
        geom.parent.name: 0 for geom in (spec.geoms if names else ()) if geom.meshname in names
    }
    return f" (a mesh of body {', '.join(bodies)})" if bodies else ""


def _disable(model: Any, bits: Any) -> None:
    """Take away what a flag of the file disables."""
    for name, fields in DISABLED.items():
        bit = getattr(bits, f"mjDSBL_{name}", None)  # not all releases have all of them
        if bit is not None and model.opt.disableflags & int(bit):
            for path in fields:
                with suppress(AttributeError):
                    attrgetter(path)(model)[:] = 0


# ---- names -------------------------------------------------------------------------------------


def _free_name(given: str, default: str, parts: Parts) -> str:
    """A name that is an identifier and no other link's or loop's; one that differs is listed."""
    taken = [GROUND, *(link[0] for link in parts.links), *(loop[0] for loop in parts.loops)]
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
    model: Any, parts: Parts, merge_fixed: bool, limit_stiffness: float | None
) -> list[Placed]:
    """Fill in the links; for each body of the file, on which of them it is."""
    placed = [Placed(GROUND, np.eye(4))]
    groups, lost = rigid_groups(model, merge_fixed)
    for i in range(1, model.nbody):
        on, label = placed[model.body_parentid[i]], label_of(model, i)
        where = on.pose @ pose_of(model.body_pos[i], model.body_quat[i])
        if i not in groups:
            placed.append(Placed(on.link, where))
            if i in lost:
                parts.left_out.append(f"{lost[i]}; it is part of {on.link}")
            continue
        try:
            joint = composed(_joints(model, i), where)
        except LierbError as error:
            raise ArgumentError(f"body {label}: {error}") from error
        name = _free_name(model.body(i).name, label, parts)
        parts.links.append((name, moving_body(model, i, groups[i]), joint, on.link))
        placed.append(Placed(name, np.eye(4)))
        for j in _range(model.body_jntadr[i], model.body_jntnum[i]):
            of = JointForces(model, j, label, joint, limit_stiffness)
            try:
                parts.forces += [force.on(name) for force in of.forces()]
            except LierbError as error:
                raise ArgumentError(f"{of.label}: {error}") from error
            parts.left_out += of.left_out()
    fixed = [
        f"{label_of(model, i)} {model.body_mass[i]:.6g} kg"
        for i in groups[WORLD]
        if model.body_mass[i]
    ]
    if fixed:
        parts.left_out.append(f"mass of what is welded to the ground: {', '.join(fixed)}")
    return placed


def _joints(model: Any, i: int) -> list[SimpleJoint]:
    return [
        SimpleJoint(KINDS[model.jnt_type[j]], model.jnt_axis[j].copy(), model.jnt_pos[j].copy())
        for j in _range(model.body_jntadr[i], model.body_jntnum[i])
    ]


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
    def label(self) -> str:
        return f"joint {self.model.joint(self.j).name or self.link}"

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
        least, most = self.model.jnt_range[self.j]
        if not self.has_force:
            return float(least), float(most)
        ends = self._on_axis(least), self._on_axis(most)
        return ends if self._direction > 0.0 else ends[::-1]

    @property
    def _direction(self) -> float:
        """−1 for a slide along a hinge's axis that counts the other way."""
        return float(np.sign(self.model.jnt_axis[self.j] @ self.joint.body_frame[:3, 2]))

    def _on_axis(self, q: float) -> float:
        offset = q - self.model.qpos0[self.model.jnt_qposadr[self.j]]
        return self._direction * float(offset)

    @property
    def _has_stops(self) -> bool:
        if self.range is None or self.limit_stiffness is None or not self.has_force:
            return False
        lower, upper = self.range
        if lower > upper:
            return False
        # The shorter way back to the range has to be the one that the file means.
        return self.kind == "slide" or (upper - lower < 2 * np.pi > abs(lower + upper))

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
        label = self.label
        if any(self.spring) and not self.has_force:
            yield f"{label}: stiffness and damping of a {self.kind} joint"
        elif self._is_wound:
            yield f"{label}: stiffness {self.spring[0]:.6g}, slack at {self._slack:.6g} rad"
        if self.is_polynomial:
            yield f"{label}: stiffness and damping beyond their first coefficients"
        if self.range is not None and not self._has_stops:
            yield f"{label}: limits {self.range[0]:.6g} … {self.range[1]:.6g}"
        least, most = model.jnt_range[self.j]
        if self.range is None and least >= most and (least or most):
            yield f"{label}: limits {least:.6g} … {most:.6g}, which MuJoCo ignores"
        at = model.jnt_dofadr[self.j]
        for what, value in (("friction", model.dof_frictionloss), ("armature", model.dof_armature)):
            if value[at]:
                yield f"{label}: {what} {value[at]:.6g}"
        if hasattr(model, "jnt_springyield") and model.jnt_springyield[self.j]:
            yield f"{label}: springyield"


# ---- loops -------------------------------------------------------------------------------------


def _add_loops(model: Any, placed: list[Placed], parts: Parts) -> None:
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
            title = _free_name(model.equality(k).name, f"loop{k}", parts)
            parts.loops.append((title, joint, ends[0].link, ends[1].link))


def _end(model: Any, k: int, number: int, placed: list[Placed]) -> Placed:
    """The link of one of an equality's bodies, and that body's or site's frame in it."""
    identity = int((model.eq_obj1id if number == 1 else model.eq_obj2id)[k])
    if not _is_by_sites(model, k):
        return placed[identity]
    on = placed[model.site_bodyid[identity]]
    return Placed(on.link, on.pose @ pose_of(model.site_pos[identity], model.site_quat[identity]))


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
    return "fixed", [pose_of(data[3:6], data[6:10]), anchor]


# ---- what is left out --------------------------------------------------------------------------


def _others(model: Any) -> Iterator[str]:
    """What a simulation of the file would have had besides, each kind once, with its number."""
    import mujoco

    collides = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    counts = Counter(
        {
            "geoms that collide": int(collides.sum()),
            "contact pairs": model.npair,
            "actuators": model.nu,
            "tendons": model.ntendon,
            "sensors": model.nsensor,
            "flexes": model.nflex,
            "plugins": model.nplugin,
            "keyframes": model.nkey,
            "joints with limits of their actuators' forces": int(model.jnt_actfrclimited.sum()),
            "bodies with gravcomp": int(np.count_nonzero(model.body_gravcomp)),
            "mocap bodies, which stand still": model.nmocap,
        }
    )
    yield from (f"{count} {what}" for what, count in counts.items() if count)
    if model.opt.density or model.opt.viscosity:
        yield "the fluid's density and viscosity"
    usual = mujoco.MjModel.from_xml_string("<mujoco/>").opt
    changed = [
        name
        for name in dir(usual)
        if name not in READ_OPTIONS
        and not name.startswith("_")
        and np.any(getattr(model.opt, name) != getattr(usual, name))
    ]
    if changed:
        yield f"options of MuJoCo's own solver: {', '.join(changed)}"
