"""Random mechanisms, and the way from lierb's objects to the oracle's plain numbers and back.

A mechanism that closes is easily had: bodies are put anywhere, joint frames anywhere between them,
and the parent's joint frame where the joint, displaced along one of its motions, wants it.
"""

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from oracle import JOINT_ROWS, sizes_of

import lierb
from mechanisms import oracle

# ---- shapes ------------------------------------------------------------------------------------


class Shape(NamedTuple):
    """links: (joint, place of the parent or None); loops: (joint, body, parent).

    is_planar : all axes are parallel and all joints' points in one plane.
    """

    links: tuple[tuple[str, int | None], ...]
    loops: tuple[tuple[str, int, int | None], ...] = ()
    is_planar: bool = False


SHAPES = {
    # trees; together they have every joint of the catalogue
    "chain": Shape((("revolute", None), ("spherical", 0), ("universal", 1), ("revolute", 2))),
    "star": Shape((("free", None), ("prismatic", 0), ("cylindrical", 0), ("screw", 0))),
    "branched": Shape((("hook", None), ("planar", 0), ("pin_in_slot", 0), ("fixed", 1),
                       ("constant_velocity", 1))),
    "sliding": Shape((("schoenflies", None), ("helical_planar", 0), ("planar_translation", 1),
                      ("translation", 2))),
    "loosely": Shape((("pin_in_slot_body", None), ("point_on_line", 0), ("point_on_plane", 1),
                      ("point_on_sphere", 2))),
    # closed loops
    "four_bar": Shape((("revolute", None), ("revolute", 0), ("revolute", None)),
                      (("revolute", 1, 2),), is_planar=True),
    "slider_crank": Shape((("revolute", None), ("spherical", 0), ("prismatic", None)),
                          (("universal", 1, 2),)),
    "rssr": Shape((("revolute", None), ("spherical", 0), ("revolute", None)),
                  (("spherical", 1, 2),)),
    "two_loops": Shape((("revolute", None), ("universal", 0), ("spherical", 1), ("prismatic", 0)),
                       (("point_on_sphere", 2, 3), ("point_on_plane", 3, None))),
    "floating_loop": Shape((("free", None), ("revolute", 0), ("hook", 0), ("spherical", 1)),
                           (("pin_in_slot", 3, 2),)),
    "many_loops": Shape((("free", None), ("spherical", None), ("planar", None)),
                        (("cylindrical", 0, 1), ("constant_velocity", 1, 2))),
}  # fmt: skip
TREES = ("chain", "star", "branched", "sliding", "loosely")
LOOPS = tuple(name for name in SHAPES if name not in TREES)
WITH_PITCH, WITH_LENGTH = (
    tuple(name for name in JOINT_ROWS if sizes_of(name, **{size: 1.0}))
    for size in ("pitch", "length")
)


# ---- random numbers ----------------------------------------------------------------------------


def rotation(vector: np.ndarray) -> np.ndarray:
    """(n, 3) rotation vectors → (n, 3, 3)."""
    angle = np.linalg.norm(vector, axis=-1, keepdims=True)
    axis = vector / np.where(angle == 0.0, 1.0, angle)
    return oracle.matrix_of(np.concatenate([np.cos(angle / 2), np.sin(angle / 2) * axis], -1))


def frame(R: np.ndarray, r: np.ndarray) -> np.ndarray:
    """(n, 4, 4)."""
    found = np.zeros((len(r), 4, 4))
    found[:, :3, :3], found[:, :3, 3], found[:, 3, 3] = R, r, 1.0
    return found


def inverse(C: np.ndarray) -> np.ndarray:
    back = np.swapaxes(C[:, :3, :3], -1, -2)
    return frame(back, -np.einsum("nij,nj->ni", back, C[:, :3, 3]))


def _anyhow(rng: np.random.Generator, n: int) -> np.ndarray:
    q = rng.normal(size=(n, 4))
    return oracle.matrix_of(q / np.linalg.norm(q, axis=-1, keepdims=True))


def random_body(rng: np.random.Generator, n: int, *, centred: bool = False) -> oracle.Body:
    """A cloud of eight points, so that its inertia is one that a body has."""
    points = 0.15 * rng.normal(size=(n, 8, 3))
    weights = rng.uniform(0.5, 1.5, size=(n, 8)) * rng.uniform(0.1, 0.3, size=(n, 1))
    mass = weights.sum(1)
    points -= (weights[..., None] * points).sum(1, keepdims=True) / mass[:, None, None]
    com = np.zeros((n, 3)) if centred else 0.2 * rng.normal(size=(n, 3))
    points = points + com[:, None]
    square = np.sum(points**2, -1)[..., None, None] * np.eye(3)
    each = square - points[..., :, None] * points[..., None, :]
    return oracle.Body(mass, np.einsum("nk,nkij->nij", weights, each), com)


def displacement(
    kind: str, rng: np.random.Generator, pitch: np.ndarray, length: np.ndarray
) -> np.ndarray:
    """D (n, 4, 4): some place on the joint, turned by up to a radian or so."""
    n = len(pitch)
    zero, some = np.zeros(n), lambda: rng.uniform(-0.8, 0.8, n)
    about = lambda *xi: rotation(np.stack(xi, -1))
    angle, turn = some(), rotation(0.5 * rng.normal(size=(n, 3)))
    slide = 0.3 * rng.normal(size=(n, 3))
    rows = JOINT_ROWS[kind].split()
    turns = {
        "universal": about(zero, zero, angle) @ about(zero, some(), zero),
        "hook": about(zero, angle, zero) @ about(zero, zero, some()),
        "constant_velocity": about(angle, some(), zero),
    }
    if "Omega3" in rows:
        Q = np.broadcast_to(np.eye(3), (n, 3, 3))
    elif "Omega1" in rows:
        Q = about(zero, zero, angle)
    else:
        Q = turns.get(kind, turn)
    d = slide * [f"d{i}" not in rows and f"Qtd{i}" not in rows for i in (1, 2, 3)]
    if "screw" in rows:
        d[:, 2] = pitch * angle
    if "rod" in rows:
        d = length[:, None] * slide / np.linalg.norm(slide, axis=-1, keepdims=True)
    if "Qtd3" in rows:
        d = np.einsum("nij,nj->ni", Q, d)
    return frame(Q, d)


class Sample(NamedTuple):
    """A mechanism as numbers with a start that all of its joints allow."""

    description: oracle.Description
    poses: np.ndarray  # (n, links, 4, 4)
    twists: np.ndarray  # (n, links, 6)


def random_description(
    rng: np.random.Generator, shape: str, n: int = 4, *, centred: bool = False, forces: bool = False
) -> Sample:
    """n random mechanisms of a shape, in general frames, with full inertias, and their starts.

    centred : bodies' frames are at their centres of mass, as the c-space SO(3)×R³ wants it.
    forces : with a spring between the first link and the last one, and one about an axis.
    """
    given = SHAPES[shape]
    tilt, plane = _anyhow(rng, n), rng.normal(size=(n, 3))
    flat = np.array([1.0, 1.0, 0.0]) if given.is_planar else np.ones(3)
    corners = np.array([[0.0, 0.4, 0.0], [0.5, 0.7, 0.0], [0.9, 0.4, 0.0]])  # of a four-bar

    def world(local: np.ndarray) -> np.ndarray:
        return plane + np.einsum("nij,nj->ni", tilt, local * flat)

    places = []
    for i, (_, parent) in enumerate(given.links):
        hung = np.zeros((n, 3)) if parent is None else places[parent]
        places.append(corners[i] + 0.05 * rng.normal(size=(n, 3)) if given.is_planar else
                      hung + 0.4 * rng.normal(size=(n, 3)))  # fmt: skip
    poses = [frame(_anyhow(rng, n), world(p)) for p in places]
    # a four-bar's joints are between its bodies: crank 0, coupler 1, rocker 2, with both pivots
    pivots = {(0, None): [0.0, 0.0, 0.0], (1, 0): [0.1, 0.8, 0.0], (2, None): [1.0, 0.0, 0.0],
              (1, 2): [0.9, 0.75, 0.0]}  # fmt: skip

    def joint(kind: str, body: int, parent: int | None) -> oracle.Joint:
        pitch = rng.uniform(0.05, 0.2, n) if kind in WITH_PITCH else np.zeros(n)
        length = rng.uniform(0.2, 0.5, n) if kind in WITH_LENGTH else np.zeros(n)
        at = np.zeros((n, 3)) if parent is None else places[parent]
        middle = 0.5 * (at + places[body]) + 0.1 * rng.normal(size=(n, 3))
        axes = _anyhow(rng, n)
        if given.is_planar:
            middle = np.array(pivots[body, parent]) + 0.05 * rng.normal(size=(n, 3))
            axes = tilt @ rotation(np.array([0.0, 0.0, 1.0]) * rng.normal(size=(n, 1)))
        on_body = frame(axes, world(middle))
        on_parent = on_body @ inverse(displacement(kind, rng, pitch, length))
        G = on_parent if parent is None else inverse(poses[parent]) @ on_parent
        return oracle.Joint(kind, body, parent, inverse(poses[body]) @ on_body, G, pitch, length)

    joints = [joint(kind, i, parent) for i, (kind, parent) in enumerate(given.links)]
    joints += [joint(*loop) for loop in given.loops]
    bodies = [random_body(rng, n, centred=centred) for _ in given.links]
    made = oracle.Description(bodies, joints, 5.0 * rng.normal(size=(n, 3)))
    if forces:
        made = replace(made, forces=_forces(rng, made, n))
    start = np.stack(poses, 1)
    wanted = 0.7 * rng.normal(size=(n, len(bodies), 6))
    return Sample(made, *oracle.consistent(made, start, wanted))


# Joints that keep the axis and turn about it, so that a torque about it acts.
AXIS_KEPT = ("revolute", "cylindrical", "screw", "planar", "pin_in_slot")


def _forces(rng: np.random.Generator, made: oracle.Description, n: int) -> tuple[Any, ...]:
    last = len(made.bodies) - 1
    point, anchor = 0.3 * rng.normal(size=(2, n, 3))
    number = lambda low, high: rng.uniform(low, high, n)
    between = oracle.Spring(
        last, 0 if last else None, point, anchor, number(5, 20), number(0.1, 0.5), number(0.2, 0.4)
    )
    kept = [k for k, j in enumerate(made.joints[: last + 1]) if j.kind in AXIS_KEPT]
    if not kept:
        return (between,)
    about = oracle.AxisTorque(kept[-1], 0.0, number(1, 3), number(0.05, 0.2), number(-0.5, 0.5))
    driven = oracle.AxisTorque(kept[0], number(-0.5, 0.5))
    return between, about, driven


# ---- lierb's objects ---------------------------------------------------------------------------


def link_name(i: int) -> str:
    return f"link{i}"


def loop_name(i: int) -> str:
    return f"loop{i}"


def mechanism_of(description: oracle.Description, **more: Any) -> Any:
    """The `lierb.Mechanism` of these numbers: links `link0`, …, loops `loop0`, …"""
    count = len(description.bodies)
    name = lambda parent: "ground" if parent is None else link_name(parent)
    links = [
        lierb.Link(link_name(j.body), _body(description.bodies[j.body]), _joint(j), name(j.parent))
        for j in description.joints[:count]
    ]
    loops = [
        lierb.Loop(loop_name(k), _joint(j), link_name(j.body), name(j.parent))
        for k, j in enumerate(description.joints[count:])
    ]
    forces = [_force(f, description) for f in description.forces]
    return lierb.Mechanism(
        links=links, loops=loops, gravity=description.gravity, forces=forces, **more
    )


def random_mechanism(rng: np.random.Generator, shape: str, **options: Any) -> tuple[Any, Sample]:
    """A `lierb.Mechanism` of a shape of `SHAPES`, and the sample that it is made of."""
    sample = random_description(rng, shape, **options)
    return mechanism_of(sample.description), sample


def by_name(values: np.ndarray, names: list[str]) -> dict[str, np.ndarray]:
    """(n, links, …) → link: (n, …)."""
    return {name: values[:, i] for i, name in enumerate(names)}


def start_of(sample: Sample) -> dict[str, dict[str, np.ndarray]]:
    """pose0 and twist0 as `lierb.integrate` takes them."""
    names = [link_name(i) for i in range(len(sample.description.bodies))]
    return {"pose0": by_name(sample.poses, names), "twist0": by_name(sample.twists, names)}


def _body(body: oracle.Body) -> lierb.Body:
    return lierb.Body(body.mass, 0.5 * (body.inertia + np.swapaxes(body.inertia, -1, -2)), body.com)


def _joint(joint: oracle.Joint) -> lierb.joints.Joint:
    options = {"body_frame": joint.B, "ground_frame": joint.G}
    if joint.kind in WITH_PITCH:
        options["pitch"] = joint.pitch
    if joint.kind in WITH_LENGTH:
        options["length"] = joint.length
    return lierb.joints.JOINTS[joint.kind](**options)


def _force(force: Any, description: oracle.Description) -> Any:
    if isinstance(force, oracle.Spring):
        made = lierb.forces.spring_damper(
            force.point, force.anchor, stiffness=force.stiffness, damping=force.damping,
            length=force.length,
        )  # fmt: skip
        at = [link_name(force.body)] + ([] if force.other is None else [link_name(force.other)])
        return made.on(*at)
    count = len(description.bodies)
    k = force.joint
    place = link_name(description.joints[k].body) if k < count else loop_name(k - count)
    if np.any(np.asarray(force.stiffness) != 0.0) or np.any(np.asarray(force.damping) != 0.0):
        return lierb.forces.torsional_spring(
            stiffness=force.stiffness, damping=force.damping, angle=force.angle
        ).on(place)
    return lierb.forces.motor(torque=force.torque).on(place)


def description_of(mechanism: Any) -> oracle.Description:
    """A `lierb.Mechanism` by its public attributes. Its forces: springs, motors of given torque."""
    count = mechanism.batch_size() or 1
    names = [link.name for link in mechanism.links]
    place = lambda name: None if name == "ground" else names.index(name)

    def many(value: Any, *shape: int) -> np.ndarray:
        return np.broadcast_to(np.asarray(value, float), (count, *shape))

    def joint(held: Any, body: str, parent: str) -> oracle.Joint:
        return oracle.Joint(
            held.name, place(body), place(parent), many(held.body_frame, 4, 4),
            many(held.ground_frame, 4, 4), many(held.pitch), many(held.length),
        )  # fmt: skip

    bodies = [
        oracle.Body(many(x.body.mass), many(x.body.inertia, 3, 3), many(x.body.com, 3))
        for x in mechanism.links
    ]
    joints = [joint(x.joint, x.name, x.parent) for x in mechanism.links]
    joints += [joint(x.joint, x.body, x.parent) for x in mechanism.loops]
    held = [*names, *(x.name for x in mechanism.loops)]

    def force(of: Any) -> Any:
        given, at = of.parameters, of.at or (names[0],)
        if of.name == "spring_damper":
            numbers = (many(given[k]) for k in ("stiffness", "damping", "length"))
            other = place(at[1]) if len(at) > 1 else None
            points = many(given["body_point"], 3), many(given["ground_point"], 3)
            return oracle.Spring(place(at[0]), other, *points, *numbers)
        known = {"torque", "stiffness", "damping", "angle"}
        if of.name not in ("motor", "torsional_spring") or not set(given) <= known:
            raise NotImplementedError(f"the oracle has no {of.name} with {', '.join(given)}")
        return oracle.AxisTorque(held.index(at[0]), **{k: many(v) for k, v in given.items()})

    return oracle.Description(
        bodies, joints, many(mechanism.gravity, 3), tuple(force(f) for f in mechanism.forces)
    )
