"""Compute initial poses and twists of a study's bodies, from its tables [initial].

The table of a single body has the arguments of `Joint.pose` and `Joint.twist`. Links of a mechanism
are placed relative to their parents, each by its own table `initial`; open loops are then closed.
Angles that count turns start at the coordinates of their joints.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from lierb.errors import ArgumentError, require_name
from lierb.kernels.groups import se3
from lierb.kernels.mechanics.constraints import holds_a_point
from lierb.kernels.mechanics.passive_elements import TurnCounter
from lierb.kernels.numbers.vec import IDENTITY, ZERO6, Vec, add, mat_t_vec
from lierb.model.connections import NOWHERE
from lierb.model.functions.states import ExtraStates
from lierb.model.joints.coordinates import motions_of
from lierb.model.joints.joint import Joint
from lierb.model.joints.motions import as_coordinates
from lierb.model.mechanism.mechanism import Mechanism
from lierb.model.problem import Problem
from lierb.support.arrays import (
    Array,
    Pose,
    as_numbers,
    as_poses,
    as_rotations,
    assembled,
    components,
    finite,
    pose_components,
    pose_matrix,
)
from lierb.support.representations import counted

PLACES = ("rotation", "place")
AUTO, NEVER = "auto", "never"  # closing of loops
TURN = "phi"  # coordinate about the axis e₃
Initial = Mapping[str, Any]


def started(problem: Problem, initial: Initial, t0: float) -> tuple[Array, Array | None]:
    """Compute twists and poses of a single body that satisfy the joint."""
    joint = problem.joint
    pose = _placed(joint, initial)
    kinds = [k for k in ("omega", "twist", "velocities") if k in initial]
    if len(kinds) > 1 or ("point_velocity" in initial and kinds not in ([], ["omega"])):
        raise ArgumentError("give omega and point_velocity, or twist, or velocities")
    if "velocities" in initial:
        where = {"pose": pose}
        if "coordinates" in initial:
            where = {"coordinates": initial["coordinates"]}
        return joint.twist(velocities=initial["velocities"], **where), pose
    if "twist" in initial:
        return problem.project(initial["twist"], pose, t0=t0), pose
    turning = {k: initial[k] for k in ("omega", "point_velocity") if k in initial}
    twist = joint.twist(pose=pose, **turning)
    about_a_point = holds_a_point(problem.rows) and len(problem.rows) == 3
    allowed = not problem.rows or (about_a_point and "point_velocity" not in turning)
    return twist if allowed else problem.project(twist, pose, t0=t0), pose


def _placed(joint: Joint, initial: Initial) -> Array | None:
    """Compute poses from coordinates, or from rotation and place; None for the closed joint."""
    placed = [k for k in PLACES if k in initial]
    if "coordinates" in initial:
        if placed:
            raise ArgumentError(f"give coordinates or {placed[0]}, not both")
        return joint.pose(coordinates=initial["coordinates"])
    if not placed:
        return None
    return pose_matrix(joint.pose_of(_turned_and_placed(initial)))


def _turned_and_placed(initial: Initial) -> Pose:
    """Return the body's joint frame relative to the joint frame of the ground or parent."""
    turn = as_rotations("rotation", initial.get("rotation", np.eye(3)))
    place = as_numbers("place", initial.get("place", (0.0, 0.0, 0.0)), (3,))
    return components(turn, 2), components(place)


# ---- mechanisms --------------------------------------------------------------------------------


def started_mechanism(
    mechanism: Mechanism,
    initial: Mapping[str, Initial],
    close: str,
    hold: Sequence[str],
    count: int,
    t0: float,
) -> tuple[dict[str, Array], dict[str, Array]]:
    """Compute twists, (count, 6), and poses, (count, 4, 4), of all links.

    initial : tables of the links, by name.
    close : AUTO closes open loops and projects twists that violate constraints, to the nearest
        poses and twists in the mass metric; NEVER leaves them.
    hold : links whose given coordinates and velocities are kept.
    """
    places, rates = _held(mechanism, initial, hold)
    with np.errstate(all="ignore"):  # overflow is detected in the result
        placed = _poses(mechanism, initial)
    poses = {
        name: _spread(f"the pose of {name}", pose_matrix(placed[i]), count, 2)
        for i, name in enumerate(mechanism.names)
    }
    is_tree = _is_a_tree(mechanism)
    if close == AUTO and not is_tree:
        poses = mechanism.close(poses, hold=places, t0=t0)
    with np.errstate(all="ignore"):
        moving = _twists(mechanism, initial, poses)
    twists = {
        name: _spread(f"the twist of {name}", assembled(moving[i]), count, 1)
        for i, name in enumerate(mechanism.names)
    }
    is_free = not any({"omega", "twist"} & {*given} for given in initial.values())
    if close == AUTO and not (is_tree and is_free):
        twists = mechanism.project(twists, poses, hold=rates, t0=t0)
    return twists, poses


def _held(
    mechanism: Mechanism, initial: Mapping[str, Initial], hold: Sequence[str]
) -> tuple[dict[str, Array], dict[str, Array]]:
    """Return the coordinates, and the velocities, that held links are given."""
    kept: dict[str, dict[str, Array]] = {"coordinates": {}, "velocities": {}}
    for name in hold:
        require_name("hold", name, mechanism.names)
        given, motions = initial.get(name, {}), motions_of(mechanism.link(name).joint)
        if motions is None or not kept.keys() & given.keys():
            raise ArgumentError(
                f"hold: {name} has neither coordinates nor velocities to keep; give some in "
                f"problem.links.{name}.initial, or leave {name} out"
            )
        for key in kept.keys() & given.keys():
            kept[key][name] = _numbers(f"{name}.{key}", given[key], motions.names)
    return kept["coordinates"], kept["velocities"]


def _spread(what: str, array: Array, count: int, item_axes: int) -> Array:
    item = array.shape[array.ndim - item_axes :]
    return np.ascontiguousarray(np.broadcast_to(finite(what, array), (count, *item)))


def _is_a_tree(mechanism: Mechanism) -> bool:
    """Return True if all rows are satisfied at any joint coordinates."""
    own = {link.name for link in mechanism.links if motions_of(link.joint) or not link.joint.rows}
    rigid = {link.name for link in mechanism.links if link.joint.name == "fixed"}
    return all(at.name in own | rigid for at in mechanism.connections)


def _poses(mechanism: Mechanism, initial: Mapping[str, Initial]) -> dict[int, Pose]:
    poses: dict[int, Pose] = {}
    for i in mechanism.order:
        link, given = mechanism.links[i], initial.get(mechanism.names[i], {})
        kinds = [k for k in ("coordinates", "pose", *PLACES) if k in given]
        if len(kinds) > 1 and kinds != [*PLACES]:
            raise ArgumentError(f"{link.name}: give coordinates, or rotation and place, or pose")
        if "pose" in given:
            poses[i] = pose_components(as_poses(f"{link.name}.pose", given["pose"]))
            continue
        if kinds and kinds[0] in PLACES:
            relative = _turned_and_placed(given)
        else:
            relative = _of_coordinates(link.name, link.joint, given.get("coordinates"))
        local, parent = link.joint.pose_of(relative), mechanism.parents[i]
        poses[i] = local if parent == NOWHERE else se3.compose(poses[parent], local)
    return poses


def _of_coordinates(name: str, joint: Joint, given: Any) -> Pose:
    motions = motions_of(joint)
    if motions is None:
        if given is not None:
            hint = "leave them out" if joint.name == "fixed" else "give rotation and place, or pose"
            raise ArgumentError(f"{name}: a {joint.name} joint has no coordinates; {hint}")
        return IDENTITY, (0.0, 0.0, joint.length)
    numbers = 0.0 if given is None else given
    return motions.pose(components(_numbers(f"{name}.coordinates", numbers, motions.names)))


def _twists(
    mechanism: Mechanism, initial: Mapping[str, Initial], poses: dict[str, Array]
) -> dict[int, Vec]:
    """Compute each link's twist: its joint's rates plus its parent's motion."""
    placed = mechanism.poses("pose0", poses)
    twists: dict[int, Vec] = {}
    for i in mechanism.order:
        link, at = mechanism.links[i], mechanism.joints[i]
        given = initial.get(link.name, {})
        kinds = [k for k in ("velocities", "omega", "twist") if k in given]
        if len(kinds) > 1:
            raise ArgumentError(f"{link.name}: give velocities, or omega, or twist")
        if "twist" in given:
            twists[i] = components(as_numbers(f"{link.name}.twist", given["twist"], (6,)))
            continue
        carried = ZERO6
        if at.parent != NOWHERE:
            carried = mechanism.carried(at, mechanism.relative(at, placed), twists)
        frame = pose_components(link.joint.body_frame)
        if "omega" in given:  # the origin of the link's joint frame moves with the parent
            omega = components(as_numbers(f"{link.name}.omega", given["omega"], (3,)))
            own: Vec = (*mat_t_vec(frame[0], omega), *carried[3:])
        else:
            own = add(_rates(link.name, link.joint, given, mechanism.relative(at, placed)), carried)
        twists[i] = se3.Ad(frame, own)
    return twists


def _rates(name: str, joint: Joint, given: Initial, relative: Pose) -> Vec:
    motions = motions_of(joint)
    if "velocities" not in given:
        return ZERO6
    if motions is None:
        hint = "leave them out" if joint.name == "fixed" else "give omega or twist"
        raise ArgumentError(f"{name}: a {joint.name} joint has no velocities; {hint}")
    rates = _numbers(f"{name}.velocities", given["velocities"], motions.names)
    return motions.twist(components(rates), relative)


def _numbers(argument: str, given: Any, names: tuple[str, ...]) -> Array:
    """Convert joint coordinates to numbers; a list has those of one link, not of a batch."""

    if isinstance(given, list) and len(given) != len(names):
        expected = "a number" if len(names) == 1 else counted(len(names), "number")
        raise ArgumentError(
            f"{argument} has {counted(len(given), 'number')}; expected {expected}, of "
            f"{', '.join(names)}"
        )
    return as_coordinates(argument, given, names)


# ---- angles that count turns -------------------------------------------------------------------


def counted_from_coordinates(
    states: Sequence[ExtraStates],
    joints: Mapping[str, Joint],
    initial: Mapping[str, Initial],
    first: int,
) -> list[ExtraStates]:
    """Return the states; an angle that counts turns starts at its joint's coordinate, if given.

    The pose of a start has lost the whole turns of its coordinates.

    joints, initial : by link; "" for a single body.   first : number of the first trajectory.
    """
    counted = []
    for state in states:
        link = "".join(state.at)
        motions = motions_of(joints[link]) if link in joints else None
        numbers = initial.get(link, {}).get("coordinates")
        if isinstance(state.kind, TurnCounter) and numbers is not None and motions is not None:
            label = f"{link}.coordinates" if link else "coordinates"
            given = _numbers(label, numbers, motions.names)
            if TURN in motions.names:
                angle = given[..., motions.names.index(TURN)]
                _require_near(label, angle, state, first)
                state = replace(state, parameters={"start": angle})
        counted.append(state)
    return counted


def _require_near(label: str, angle: Array, state: ExtraStates, first: int) -> None:
    """Raise ArgumentError for an angle more than half a turn from the start given to its state.

    A start that is not drawn, and within half a turn of 0, its default, determines no turns.
    """
    start = state.parameters["start"]
    is_given = (np.abs(start) > np.pi) | (start.ndim > 0)
    far = is_given & (np.abs(angle - start) > np.pi)
    angles, starts, fars = (np.atleast_1d(x) for x in np.broadcast_arrays(angle, start, far))
    for i in map(int, np.flatnonzero(fars)[:1]):
        raise ArgumentError(
            f"{label}: {TURN} is {angles[i]:.6g} rad in trajectory {first + i}, more than half a "
            f"turn from {starts[i]:.6g} rad, where the state {state.name} starts; leave its start "
            "at 0, and give coordinates that count the turns"
        )
