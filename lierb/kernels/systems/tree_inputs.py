"""Inputs of a mechanism: columns; constants and start of the tree, in joint axes."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

from lierb.kernels.functions.function import BODY
from lierb.kernels.groups import ambient, ambientxr3, quaternion, quaternionxr3, se3, turns
from lierb.kernels.groups.quaternion import Chart
from lierb.kernels.mechanics.elements import Element
from lierb.kernels.mechanics.newton_euler import Frames, unit_inertia
from lierb.kernels.mechanics.rows import FIXED, PITCHED
from lierb.kernels.mechanics.spatial import Pose, Rigid, conjugated, twist_at
from lierb.kernels.mechanics.subgroup import Slots
from lierb.kernels.mechanics.tree import (
    GROUND,
    HERE,
    MASSLESS,
    Connection,
    Ends,
    Node,
    NodeConstants,
)
from lierb.kernels.mechanics.tree_nodes import charts_of_slots
from lierb.kernels.numbers.arithmetic import fma
from lierb.kernels.numbers.vec import (
    IDENTITY,
    ZERO3,
    Mat,
    Vec,
    axpy,
    column,
    cross_add,
    diagonal,
    dot,
    mat_t_vec,
    mat_vec,
    mat_vec_add,
    row,
    scale,
    sub,
    transpose,
)
from lierb.kernels.numbers.zero import ZERO
from lierb.kernels.systems.layout import POSE, Columns, Field, pose_of
from lierb.kernels.systems.plan import MechanismPlan

LINK = (  # fields of each link
    Field("mass", (), "kg"),
    Field("inertia", (3, 3), "kg m²"),
    Field("com", (3,), "m"),
)
JOINT = (  # fields of the joint of each link and each loop
    Field("ground_frame", (4, 4), "1, m", POSE),
    Field("body_frame", (4, 4), "1, m", POSE),
    Field("pitch", (), "m/rad"),
    Field("length", (), "m"),
)
START = (Field("pose", (4, 4), "1, m", POSE), Field("twist", (6,), "rad/s, m/s"))
GRAVITY = Field("gravity", (3,), "m/s²")


@lru_cache(64)
def inputs_of(links: int, loops: int, elements: tuple[Element, ...]) -> Columns:
    """Columns of a mechanism: f"{link}.mass", f"{joint}.pitch", f"element{k}.{name}", …

    Joints are numbered like the plan's connections: those of links, then those of loops.
    """
    own = (f._replace(name=f"{i}.{f.name}") for i in range(links) for f in LINK)
    held = (f._replace(name=f"{i}.{f.name}") for i in range(links + loops) for f in JOINT)
    parameters = (
        Field(f"element{k}.{name}", shape)
        for k, element in enumerate(elements)
        for name, shape in element.shapes.items()
    )
    starts = (f._replace(name=f"{i}.{f.name}") for i in range(links) for f in START)
    return Columns(*own, *held, GRAVITY, *parameters, *starts)


def state_columns(nodes: int, states: int, carried: int = 0) -> Columns:
    """Columns of a mechanism's state.

    states : number of the extra states' numbers.   carried : of those that the method passes on.
    """
    return Columns(
        Field("charts", (7 * nodes,)), Field("x", (6 * nodes,)), Field("v", (6 * nodes,)),
        Field("work"), Field("states", (states,)), Field("carried", (carried,)),
    )  # fmt: skip


def charts_of(node: Node) -> Any:
    """Module with the formulas of the group of a node's chart."""
    if node.is_reduced:
        return charts_of_slots(node.slots)
    return quaternionxr3 if node.cspace == "SO3xR3" else quaternion


def takes_ambient(node: Node) -> bool:
    """Return whether a node has coordinates Y in an ambient update, instead of X.

    Reduced nodes whose motions commute have X, because dexp⁻¹ is the identity there and exp exact.
    So have reduced nodes with a pitch, which Y does not keep.
    """
    if not node.is_reduced:
        return True
    turning, sliding = ([i for i in range(3) if node.slots[first + i] != FIXED] for first in (0, 3))
    about_one_axis = len(turning) == 1 and sliding in ([], turning)
    return bool(turning) and not about_one_axis and PITCHED not in node.slots


def ambient_charts_of(node: Node) -> Any:
    """Module with the formulas of the group of a node in an ambient update."""
    return ambientxr3 if node.cspace == "SO3xR3" else ambient


def charts_side_by_side(numbers: Vec) -> tuple[Chart, ...]:
    return tuple((numbers[i : i + 4], numbers[i + 4 : i + 7]) for i in range(0, len(numbers), 7))


def sixes(numbers: Vec) -> list[Vec]:
    return [numbers[i : i + 6] for i in range(0, len(numbers), 6)]


def with_burdens(
    tree: tuple[Node, ...], nodes: tuple[NodeConstants, ...]
) -> tuple[NodeConstants, ...]:
    """Add each node's `burden`, computed in the pose where all slides are 0."""
    burdens = [(n.rigid.mass, 0.5 * sum(n.rigid.inertia[::4], start=ZERO)) for n in nodes]
    for i in reversed(range(len(tree))):
        mass, inertia = burdens[i]
        parent, arm = tree[i].parent, nodes[i].hang[1]
        if parent != GROUND:
            before, about = burdens[parent]
            burdens[parent] = before + mass, about + fma(mass, dot(arm, arm), inertia)
    return tuple(n._replace(burden=each) for n, each in zip(nodes, burdens, strict=True))


def first_of_joint(tree: tuple[Node, ...], i: int) -> int:
    """Index of the first of the nodes that form the joint of a link's node."""
    parent = tree[i].parent
    return parent if parent != GROUND and tree[parent].link == MASSLESS else i


def node_constants(tree: tuple[Node, ...], i: int, read: dict[str, Vec]) -> NodeConstants:
    """Constants of node i.   read : numbers of all inputs, by name."""
    node = tree[i]
    link = node.link
    if link == MASSLESS:  # the first motion of the next node's joint
        nothing = Rigid(ZERO, ZERO3, diagonal(ZERO3))
        link = tree[i + 1].link
        rigid, inertia, com, frame = nothing, nothing.inertia, ZERO3, HERE
    else:
        (mass,) = read[f"{link}.mass"]
        frame = pose_of(read[f"{link}.body_frame"])
        theta = sub(read[f"{link}.inertia"], scale(mass, unit_inertia(read[f"{link}.com"])))
        inertia = conjugated(transpose(frame[0]), theta)
        com = mat_t_vec(frame[0], sub(read[f"{link}.com"], frame[1]))
        about_point = axpy(mass, unit_inertia(com), inertia)
        rigid = Rigid(mass, scale(mass, com), about_point)
    hang, gravity = HERE, ZERO3
    if first_of_joint(tree, i) == i:
        ground = pose_of(read[f"{link}.ground_frame"])
        hang = ground
        if node.parent == GROUND:
            gravity = mat_t_vec(ground[0], read["gravity"])
        else:
            hang = se3.compose(
                se3.inverse(pose_of(read[f"{tree[node.parent].link}.body_frame"])), ground
            )
    (pitch,) = read[f"{link}.pitch"]
    return NodeConstants(rigid, inertia, com, hang, gravity, frame, pitch)


def joint_ends(
    plan: MechanismPlan, nodes: tuple[NodeConstants, ...], number: int, read: dict[str, Vec]
) -> Ends:
    """Frames of joint `number` on its two nodes."""
    joint = plan.joints[number]
    (pitch,), (length,) = read[f"{number}.pitch"], read[f"{number}.length"]
    inner = se3.compose(se3.inverse(nodes[joint.node].frame), pose_of(read[f"{number}.body_frame"]))
    outer = pose_of(read[f"{number}.ground_frame"])
    if joint.other != GROUND:
        outer = se3.compose(se3.inverse(nodes[joint.other].frame), outer)
    if number < plan.links:
        inner = HERE
    return Ends(inner, outer, pitch, length)


def placed_element(
    element: Element, k: int, c: Connection, nodes: tuple[NodeConstants, ...], read: dict[str, Vec]
) -> Any:
    """Parameters of an element in the two frames between which it acts."""
    given = {
        name: read[f"element{k}.{name}"] if shape else read[f"element{k}.{name}"][0]
        for name, shape in element.shapes.items()
    }
    body = nodes[c.node]
    own, ground = body.frame, HERE if c.other == GROUND else nodes[c.other].frame
    if c.joint >= 0:
        own, ground = (pose_of(read[f"{c.joint}.{name}_frame"]) for name in ("body", "ground"))
    constants = body.rigid.mass, body.inertia, body.com, body.frame
    return placed_on(element, given, *constants, own, ground)


def placed_on(
    element: Element, given: dict[str, Any], mass: Any, inertia: Mat, com: Vec, frame: Pose,
    own: Pose, ground: Pose,
) -> Any:  # fmt: skip
    """Parameters of an element on a node.

    inertia, com : of the node, in its axes.   frame : the node's frame in the user's body frame.
    own, ground : frames between which the element acts, in the user's frames of the two bodies.
    """
    if element.takes_body:
        turned = conjugated(frame[0], inertia)
        constants = mass, turned, mat_vec_add(frame[0], com, frame[1])
        given |= {f"body.{name}": x for (name, _), x in zip(BODY, constants, strict=True)}
    return element.placed(given, Frames(ground, *own))


# ---- starts ------------------------------------------------------------------------------------


class CheckedStarts:
    """Starts of a mechanism, which `Mechanism.violation` examines before they are packed."""

    def placed(self, body: Any, numbers: list[Any]) -> tuple[()]:
        """Return an empty tuple: starts of links depend on twists and poses together."""
        return ()

    def pose_check(self, numbers: list[Any], time: Any) -> tuple[()]:
        return ()

    def is_on_joint(self, check: tuple[()], numbers: list[Any], time: Any) -> Any:
        return 1.0


def given_start(frame: Pose, read: dict[str, Vec], link: int) -> tuple[Pose, Vec]:
    """Pose of a node in the ground frame, and its twist.   frame : its frame in the user's."""
    pose = se3.compose(pose_of(read[f"{link}.pose"]), frame)
    return pose, twist_at(frame, read[f"{link}.twist"])


def apart(
    node: Node, constants: NodeConstants, root: Pose, place: Pose, twist: Vec
) -> tuple[Chart, Vec]:
    """Chart and velocity of an absolute node.   root : frame of the root of its tree."""
    q, d = se3.compose(se3.inverse(root), place)
    if node.cspace == "SE3":
        return quaternion.from_pose((q, d)), twist
    com = constants.com
    rate = mat_vec(q, cross_add(twist[:3], com, twist[3:]))
    return quaternion.from_pose((q, mat_vec_add(q, com, d))), twist[:3] + rate


def chart_of(node: Node, d: Pose) -> Chart:
    """Chart of a reduced node with the pose D on its joint."""
    if charts_of(node) is turns:
        return turns.from_pose(d, node.slots.index(0))
    return quaternion.from_pose(d)


def factored(first: Slots, last: Slots, d: Pose, relative: Vec) -> list[tuple[Pose, Vec]]:
    """Factor D into two motions of one freedom each; return both, with their D⁻¹Ḋ.

    The first follows from D in the ground's axes, the last from D in the body's.
    """
    i, j = first.index(0), last.index(0)
    q, place = d
    if i < 3:  # Q e = F₁ e, for the axis e of the last turn
        axis = j if j < 3 else (i + 1) % 3
        opening = _turn(i, axis, column(q, axis)), ZERO3
    else:
        opening = IDENTITY, tuple(place[k] if 3 + k == i else ZERO for k in range(3))
    if j < 3:  # Qᵀe = F₂ᵀe, for the axis e of the first
        axis = i if i < 3 else (j + 1) % 3
        closing = transpose(_turn(j, axis, row(q, axis))), ZERO3
    else:
        within = mat_t_vec(q, place)
        closing = IDENTITY, tuple(within[k] if 3 + k == j else ZERO for k in range(3))
    along = row(q, i % 3)
    rates = dot(along, relative[:3] if i < 3 else relative[3:]), relative[j]
    return [
        (pose, tuple(rate if k == slot else ZERO for k in range(6)))
        for pose, rate, slot in zip((opening, closing), rates, (i, j), strict=True)
    ]


def _turn(about: int, axis: int, image: Vec) -> Mat:
    """Rotation about one axis that maps another axis to the direction of its image, times the
    length of the image's projection.
    """
    third = 3 - about - axis
    sign = 1.0 if axis == (about + 1) % 3 else -1.0
    return turns.matrix_about(about, image[axis], sign * image[third])
