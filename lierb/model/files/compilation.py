"""Compile MJCF and URDF files by MuJoCo."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import suppress
from operator import attrgetter
from os import PathLike, fspath
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.parsers import expat

import numpy as np

from lierb.errors import ArgumentError, brief
from lierb.model.files import inertials, urdf
from lierb.model.files.welded_bodies import WORLD
from lierb.support.extras import require
from lierb.support.representations import counted

if TYPE_CHECKING:
    from mujoco import MjModel, MjsBody, MjSpec

CONTACT = ("geom_contype", "geom_conaffinity")
DISABLED = {  # by bit of mjtDisableBit, fields of the model to be set to zero
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


def compiled(path: Any, language: str, base: str | None) -> tuple[MjModel, list[str]]:
    """Return the model of a file, and the elements of the file that the model lacks.

    language : "MJCF" or "URDF".   base : "free", "fixed", or None for that of the file.

    Raises ArgumentError for a file that MuJoCo refuses.
    """
    require("mjcf")
    import mujoco

    if not isinstance(path, (str, PathLike)):
        raise ArgumentError(f"path={brief(path)}; expected the path of a file in {language}")
    spec = None
    try:
        robot = urdf.read(path) if language == "URDF" else None
        spec = mujoco.MjSpec.from_file(fspath(path)) if robot is None else robot.spec
        spec.compiler.fusestatic = False  # `welded_bodies` merges them
        left_out = [] if robot is None else robot.left_out
        left_out += _with_base(spec, base)
        model = inertials.compiled(spec)
    except Exception as error:  # the readers of XML, URDF and MJCF raise different errors
        message = " ".join(str(error).split())
        at = _elements_at_line(path, message) + _bodies_with_mesh(spec, message)
        raise ArgumentError(
            f"{brief(fspath(path))} cannot be read as {language}: {message}{at}"
        ) from error
    if robot is not None:
        model.body_mass[WORLD] = robot.world_mass
        for name, ends in robot.limits.items():  # MuJoCo ignores limits that lock a joint
            j = model.joint(name).id
            model.jnt_limited[j], model.jnt_range[j] = True, ends
    _apply_disable_flags(model, mujoco.mjtDisableBit)
    return model, left_out


def _with_base(spec: MjSpec, base: str | None) -> list[str]:
    """Add free joints to the bases, or remove those on the ground; return what was left out."""
    import mujoco

    on_ground = list(spec.worldbody.bodies)
    carrying = [body for body in on_ground if any(part.joints for part in _hanging_on(body))]
    bases = carrying or [body for body in on_ground if any(map(_has_mass, _hanging_on(body)))]
    for body in bases if base == "free" else ():
        if not (body.joints or body.mocap):
            body.add_freejoint()
    for body in on_ground if base else ():
        for joint in list(body.joints) if base == "fixed" else ():
            if joint.type == mujoco.mjtJoint.mjJNT_FREE:
                spec.delete(joint)
    keys = list(spec.keys) if base else []  # their lengths are those of the file's coordinates
    for key in keys:
        spec.delete(key)
    return [counted(len(keys), "keyframe")] if keys else []


def _hanging_on(body: MjsBody) -> Iterator[MjsBody]:
    """Yield a body and all bodies whose way to the ground leads over it."""
    yield body
    for child in body.bodies:
        yield from _hanging_on(child)


def _has_mass(body: MjsBody) -> bool:
    """Return whether a body of a specification has an inertial with a mass, or geoms with one."""
    of_geoms = (geom.density if np.isnan(geom.mass) else geom.mass for geom in body.geoms)
    return bool(body.mass) if body.explicitinertial else any(of_geoms)


def _elements_at_line(path: Any, message: str) -> str:
    """Name the elements on a line of the file, if MuJoCo's message has a line and no name.

    An element without a name is described by the element that encloses it.
    """
    at = re.search(r"Element (?:'(\w+)'|name ''.*), line (\d+)", message)
    if at is None:
        return ""
    kind, line = at[1], int(at[2])
    owners, names = [""], []
    parser = expat.ParserCreate()

    def start(tag: str, attributes: dict[str, str]) -> None:
        owners.append(f"{tag} {attributes['name']}" if "name" in attributes else owners[-1])
        is_meant = tag == kind if kind else "name" not in attributes
        if is_meant and parser.CurrentLineNumber == line and owners[-1]:
            names.append(owners[-1])

    parser.StartElementHandler = start
    parser.EndElementHandler = lambda _: owners.pop()
    with suppress(expat.ExpatError, OSError), Path(path).open("rb") as file:
        parser.ParseFile(file)
    return f" (on this line: {', '.join(dict.fromkeys(names))})" if names else ""


def _bodies_with_mesh(spec: MjSpec | None, message: str) -> str:
    """Name the bodies whose mesh file occurs in MuJoCo's message."""
    if spec is None:
        return ""
    names = {mesh.name for mesh in spec.meshes if mesh.file and mesh.file in message}
    geoms = spec.geoms if names else ()
    bodies = dict.fromkeys(geom.parent.name for geom in geoms if geom.meshname in names)
    return f" (a mesh of body {', '.join(bodies)})" if bodies else ""


def _apply_disable_flags(model: MjModel, bits: Any) -> None:
    """Set the fields that the file's flags disable to zero."""
    for name, fields in DISABLED.items():
        bit = getattr(bits, f"mjDSBL_{name}", None)  # not in all releases
        if bit is not None and model.opt.disableflags & int(bit):
            for path in fields:
                with suppress(AttributeError):
                    attrgetter(path)(model)[:] = 0
