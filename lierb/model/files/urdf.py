"""Read URDF; build a specification for MuJoCo's compiler.

MuJoCo's reader of URDF ignores limits that lock a joint, treats a negative mass as zero, and names
neither link nor joint in most of its errors.
"""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from os import PathLike, fspath
from typing import TYPE_CHECKING, Any

import numpy as np

from lierb.errors import ArgumentError, brief
from lierb.support.arrays import Array
from lierb.support.representations import counted

if TYPE_CHECKING:
    from mujoco import MjsBody, MjSpec

Element = ElementTree.Element
TYPES = ("revolute", "continuous", "prismatic", "fixed", "floating", "planar", "spherical")
SCALAR = ("revolute", "continuous", "prismatic")  # joints with one coordinate
SHORT = 1e-10  # least length of an axis, as in MuJoCo
MOMENTS = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")  # in the order of MuJoCo's fullinertia
NONE: set[str] = set()
READ = {  # elements within an element and its attributes: read, or without effect on the motion
    "robot": ({"link", "joint", "material", "mujoco"}, {"name", "version"}),
    "link": ({"inertial", "visual", "collision"}, {"name"}),
    "inertial": ({"origin", "mass", "inertia"}, NONE),
    "mass": (NONE, {"value"}),
    "inertia": (NONE, {*MOMENTS}),
    "joint": (
        {"parent", "child", "origin", "axis", "limit", "dynamics", "mimic"}, {"name", "type"},
    ),
    "parent": (NONE, {"link"}),
    "child": (NONE, {"link"}),
    "origin": (NONE, {"xyz", "rpy", "quat_xyzw"}),
    "axis": (NONE, {"xyz"}),
    "limit": (NONE, {"lower", "upper", "effort", "velocity"}),
    "dynamics": (NONE, {"damping", "friction"}),
    "mimic": (NONE, {"joint", "multiplier", "offset"}),
}  # fmt: skip


@dataclass
class Robot:
    """A robot is a specification for MuJoCo's compiler, and data that the specification lacks.

    limits : lower and upper end by joint, rad or m.   world_mass : kg, of a root named world.
    left_out : messages on elements that mechanisms do not have.
    """

    spec: MjSpec
    world_mass: float = 0.0
    limits: dict[str, tuple[float, float]] = field(default_factory=dict)
    left_out: list[str] = field(default_factory=list)


def read(path: str | PathLike[str]) -> Robot:
    """Read a robot; raises ArgumentError with the name of the link or joint at fault."""
    import mujoco

    root = ElementTree.parse(fspath(path)).getroot()
    if root.tag != "robot":
        raise ArgumentError(f"its root element is <{root.tag}>; expected <robot>")
    links, joints = _by_name(root, "link"), _by_name(root, "joint")
    settings = root.find("mujoco")  # MuJoCo's extension of URDF: <compiler> and <option>
    text = "<mujoco/>" if settings is None else ElementTree.tostring(settings, encoding="unicode")
    robot = Robot(mujoco.MjSpec.from_string(text))
    bodies: dict[str, MjsBody] = {}
    for link, joint in _in_order(links, joints):
        inertial = _inertial(f"link {link}", links[link])
        if joint is not None:
            parent = bodies[_end(joints[joint], "parent", joint, links)]
            bodies[link] = _add_body(robot, parent, link, joint, joints[joint])
        elif link == "world":  # MuJoCo's name for the ground
            bodies[link], robot.world_mass = robot.spec.worldbody, inertial.get("mass", 0.0)
            continue
        else:
            bodies[link] = robot.spec.worldbody.add_body(name=link)
        for name, value in inertial.items():
            setattr(bodies[link], name, value)
    for name in joints:
        _add_mimic(robot, name, joints)
    if settings is not None and settings.find("option[@gravity]") is not None:
        robot.left_out.append("gravity, which is an argument")
    robot.left_out += _lacking(root, links, joints)
    return robot


# ---- the tree ----------------------------------------------------------------------------------


def _by_name(root: Element, tag: str) -> dict[str, Element]:
    named: dict[str, Element] = {}
    for number, element in enumerate(root.findall(tag), 1):
        name = element.get("name")
        if not name:
            raise ArgumentError(f"{tag} {number} of the file has no name; give it one")
        if name in named:
            raise ArgumentError(f"two {tag}s are named {name}; give each its own name")
        named[name] = element
    return named


def _in_order(
    links: dict[str, Element], joints: dict[str, Element]
) -> Iterator[tuple[str, str | None]]:
    """Return the links, each after its parent, with the joint to its parent; None for the root.

    The order is that of MuJoCo's reader: depth first, children in the order of their joints.
    """
    joint_of: dict[str, str] = {}
    children: dict[str, list[str]] = {link: [] for link in links}
    for name, joint in joints.items():
        parent, child = (_end(joint, end, name, links) for end in ("parent", "child"))
        if child in joint_of:
            raise ArgumentError(
                f"link {child} is the child of two joints, {joint_of[child]} and {name}; expected "
                "one, since the links of URDF are a tree"
            )
        joint_of[child] = name
        children[parent].append(child)
    roots = [link for link in links if link not in joint_of]
    if len(roots) > 1:
        raise ArgumentError(
            f"the links {', '.join(roots)} are children of no joint; expected one such link, the "
            "root"
        )
    order, waiting = [], roots
    while waiting:
        order.append(waiting.pop())
        waiting += reversed(children[order[-1]])
    if len(order) < len(links):
        rest = [link for link in links if link not in order]
        raise ArgumentError(
            f"the links {', '.join(rest)} do not hang on a root: joints go round in a circle there"
        )
    return ((link, joint_of.get(link)) for link in order)


def _end(joint: Element, end: str, name: str, links: dict[str, Element]) -> str:
    """Name of the parent or the child of a joint."""
    element = _only(joint, end, f"joint {name}")
    link = None if element is None else element.get("link")
    if link is None:
        raise ArgumentError(f"joint {name} has no {end}; expected <{end} link=…/>")
    if link not in links:
        raise ArgumentError(f"joint {name}: its {end} {link} is no link of the file")
    return link


# ---- links and joints --------------------------------------------------------------------------


def _add_body(robot: Robot, parent: MjsBody, link: str, joint: str, element: Element) -> MjsBody:
    """Add the body of a link to MuJoCo's specification, with its joints."""
    import mujoco

    label, kind = f"joint {joint}", element.get("type")
    if kind not in TYPES:
        raise ArgumentError(f"{label}: type={kind!r}; expected one of {', '.join(TYPES)}")
    if link == "world":
        raise ArgumentError("link world: only the root can have this name; give it another one")
    position, quaternion = _origin(element, label)
    body = parent.add_body(name=link, pos=position, quat=quaternion)
    axis = _numbers(_only(element, "axis", label), "xyz", 3, label, (1.0, 0.0, 0.0))
    if np.linalg.norm(axis) < SHORT and kind not in ("fixed", "floating", "spherical"):
        listed = " ".join(f"{x:.6g}" for x in axis)
        raise ArgumentError(f"{label}: its axis {listed} has no direction")
    dynamics = _only(element, "dynamics", label)
    damping, friction = (_number(dynamics, what, label, 0.0) for what in ("damping", "friction"))
    if kind == "floating" and (damping or friction):
        robot.left_out.append(f"{label}: damping {damping:.6g} and friction {friction:.6g}")
        damping = friction = 0.0
    for ending, motion, along in _motions(kind, axis):
        motion = getattr(mujoco.mjtJoint, f"mjJNT_{motion}")
        added = body.add_joint(name=joint + ending, type=motion, axis=along)
        # coefficients of a polynomial in newer releases, a number in older ones
        added.damping = (damping, 0.0, 0.0) if np.ndim(added.damping) else damping
        added.frictionloss = friction
    _read_limit(robot, joint, kind, _only(element, "limit", label))
    return body


def _add_mimic(robot: Robot, name: str, joints: dict[str, Element]) -> None:
    """Add the equality of a joint's <mimic>: its coordinate is multiplier · other + offset."""
    import mujoco

    label = f"joint {name}"
    mimic = _only(joints[name], "mimic", label)
    if mimic is None:
        return
    other = mimic.get("joint")
    multiplier = _number(mimic, "multiplier", label, 1.0)
    offset = _number(mimic, "offset", label, 0.0)
    kinds = {each: joint.get("type") for each, joint in joints.items()}
    if other == name or not {kinds[name], kinds.get(other or "")} <= {*SCALAR}:
        robot.left_out.append(f"{label}: mimic of {other}")
        return
    equality = robot.spec.add_equality(
        name=f"{label}: mimic of {other}", type=mujoco.mjtEq.mjEQ_JOINT,
        objtype=mujoco.mjtObj.mjOBJ_JOINT, name1=name, name2=other,
    )  # fmt: skip
    equality.data[:5] = offset, multiplier, 0.0, 0.0, 0.0


def _motions(kind: str, axis: Array) -> list[tuple[str, str, Array]]:
    """Return MuJoCo's joints for a joint of URDF: name suffix, type and axis of each."""
    along = np.eye(3)
    if kind in ("revolute", "continuous"):
        return [("", "HINGE", axis)]
    if kind == "prismatic":
        return [("", "SLIDE", axis)]
    if kind == "spherical":  # MuJoCo's extension of URDF
        return [("", "BALL", along[2])]
    if kind == "planar":
        first, second = _across(axis)
        return [("_TX", "SLIDE", first), ("_TY", "SLIDE", second), ("_RZ", "HINGE", axis)]
    if kind == "floating":  # MuJoCo allows free joints on the ground only
        slides = zip(("_TX", "_TY", "_TZ"), along, strict=True)
        return [*((ending, "SLIDE", e) for ending, e in slides), ("", "BALL", along[2])]
    return []


def _read_limit(robot: Robot, joint: str, kind: str, element: Element | None) -> None:
    label = f"joint {joint}"
    lower, upper = (_number(element, end, label, 0.0) for end in ("lower", "upper"))
    if element is None or kind == "fixed":
        return
    if kind in ("revolute", "prismatic"):
        robot.limits[joint] = lower, upper
    elif "lower" in element.attrib or "upper" in element.attrib:
        robot.left_out.append(
            f"{label}: limits {lower:.6g} … {upper:.6g}, which a {kind} joint does not have"
        )


def _inertial(label: str, link: Element) -> dict[str, Any]:
    """Return mass, centre and inertia of a link, as fields of MuJoCo's body."""
    from mujoco import mju_quat2Mat

    element = _only(link, "inertial", label)
    if element is None:
        return {}
    parts = {tag: _only(element, tag, label) for tag in ("mass", "inertia")}
    for tag, part in parts.items():
        if part is None:
            raise ArgumentError(f"{label}: its <inertial> has no <{tag}>")
    position, quaternion = _origin(element, label)
    xx, yy, zz, xy, xz, yz = (_number(parts["inertia"], name, label) for name in MOMENTS)
    axes = np.empty(9)
    mju_quat2Mat(axes, quaternion)
    R = axes.reshape(3, 3)
    inertia = R @ np.array(((xx, xy, xz), (xy, yy, yz), (xz, yz, zz))) @ R.T
    return {
        "mass": _number(parts["mass"], "value", label),
        "ipos": position,
        "fullinertia": inertia[(0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)],
        "explicitinertial": True,
    }


def _origin(element: Element, label: str) -> tuple[Array, Array]:
    """Return position and quaternion of an element's <origin>.

    Angles rpy are about fixed x, y, z; a quaternion takes their place (URDF 1.1).
    """
    from mujoco import mju_euler2Quat

    origin, quaternion = _only(element, "origin", label), np.empty(4)
    position = _numbers(origin, "xyz", 3, label, (0.0, 0.0, 0.0))
    if origin is None or "quat_xyzw" not in origin.attrib:
        mju_euler2Quat(quaternion, _numbers(origin, "rpy", 3, label, (0.0, 0.0, 0.0)), "XYZ")
        return position, quaternion
    given = _numbers(origin, "quat_xyzw", 4, label)
    if "rpy" in origin.attrib or np.linalg.norm(given) < SHORT:
        raise ArgumentError(f"{label}: <origin> has rpy and quat_xyzw, or a quaternion of zeros")
    return position, np.roll(given, 1) / np.linalg.norm(given)


def _across(axis: Array) -> tuple[Array, Array]:
    """Return e₁ and e₂ after the shortest rotation from e₃ to the axis, as in MuJoCo."""
    from mujoco import mju_quatZ2Vec, mju_rotVecQuat

    quaternion, first, second = np.empty(4), np.empty(3), np.empty(3)
    mju_quatZ2Vec(quaternion, axis / np.linalg.norm(axis))
    mju_rotVecQuat(first, np.eye(3)[0], quaternion)
    mju_rotVecQuat(second, np.eye(3)[1], quaternion)
    return first, second


# ---- elements and numbers ----------------------------------------------------------------------


def _only(element: Element, tag: str, label: str) -> Element | None:
    inside = element.findall(tag)
    if len(inside) > 1:
        raise ArgumentError(f"{label} has {len(inside)} elements <{tag}>; expected one")
    return inside[0] if inside else None


def _numbers(
    element: Element | None,
    attribute: str,
    count: int,
    label: str,
    default: tuple[float, ...] | None = None,
) -> Array:
    text = None if element is None else element.get(attribute)
    if text is None and default is not None:
        return np.array(default)
    tag = "" if element is None else element.tag
    if text is None:
        raise ArgumentError(f"{label}: <{tag}> has no {attribute}")
    try:
        numbers = np.array([float(word) for word in text.split()])
    except ValueError:
        numbers = np.empty(0)
    if numbers.size != count or not np.all(np.isfinite(numbers)):
        expected = "a finite number" if count == 1 else f"{count} finite numbers"
        raise ArgumentError(f"{label}: <{tag} {attribute}={brief(text)}>; expected {expected}")
    return numbers


def _number(
    element: Element | None, attribute: str, label: str, default: float | None = None
) -> float:
    values = None if default is None else (default,)
    return float(_numbers(element, attribute, 1, label, values)[0])


def _lacking(root: Element, links: dict[str, Element], joints: dict[str, Element]) -> Iterator[str]:
    """Yield the elements of the file that the mechanism lacks, with their counts."""
    collisions = sum(len(link.findall("collision")) for link in links.values())
    if collisions:
        yield counted(collisions, "geom that collides", "geoms that collide")
    bounded = sum(
        joint.get("type") != "fixed" and not {"effort", "velocity"}.isdisjoint(limit.attrib)
        for joint in joints.values()
        for limit in joint.findall("limit")
    )
    if bounded:
        yield f"limits of effort and velocity of {counted(bounded, 'joint')}"
    for words, count in Counter(_unread(root)).items():
        yield counted(count, *words)


def _unread(element: Element) -> Iterator[tuple[str, str]]:
    """Yield each element and attribute that is not read, in singular and plural."""
    elements, attributes = READ[element.tag]
    for name in element.attrib:
        if name not in attributes:
            what = f"{_short(name)} of <{element.tag}>"
            yield f"attribute {what}", f"attributes {what}"
    for child in element:
        if child.tag not in elements:
            what = f"{_short(child.tag)} element"
            yield what, f"{what}s"
        elif child.tag in READ:
            yield from _unread(child)


def _short(name: str) -> str:
    """Return a name with the last part of its name space."""
    return name.rpartition("/")[2].replace("}", ":")
