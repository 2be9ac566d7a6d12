"""Closed poses and projected twists in which joints have given coordinates and rates."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from lierb.errors import ArgumentError, PoseError, TwistError, brief, items_of, require_name
from lierb.kernels.groups import se3
from lierb.model.connections import NOWHERE
from lierb.model.forces.motors import PositionMotor, motor
from lierb.model.joints import catalogue
from lierb.model.joints.coordinates import motions_of
from lierb.model.joints.motions import TURNS, as_coordinates
from lierb.model.mechanism.closing import ASSEMBLIES, closed, projected
from lierb.model.mechanism.kinematics import TreeKinematics
from lierb.model.mechanism.row_system import System
from lierb.support.arrays import Array, components, pose_components, pose_matrix
from lierb.support.progress import reporter

# Largest change of a held coordinate between two closed poses, rad, or relative to the size of the
# mechanism: a step stays on the branch of the pose before.
STEP = 0.1
SLIDES = "ds"  # first letters of coordinates in m
OFF = 1e-9  # most that a held rate may be off, relative to the largest rate of a joint


def closed_at(mechanism: TreeKinematics, poses: list[Array], hold: Any, t0: float) -> list[Array]:
    """Return closed poses in which joints have the coordinates in `hold`; see `_numbers`.

    The coordinates go there from those of `poses` in small steps, each of which is closed from the
    step before. Angles go the shorter way, unless whole turns count.
    """
    before = mechanism.coordinates(dict(zip(mechanism.names, poses, strict=True)))
    ends = _numbers(mechanism, hold, before)
    starts = {name: before[name] for name in ends}
    length = float(np.max(System(mechanism, 1).length))
    ended = {f"hold[{name!r}]": (end, 1) for name, end in ends.items()}
    given = {f"pose[{i}]": (pose, 2) for i, pose in enumerate(poses)}
    count = mechanism.batch_size(**ended, **given) or 1
    ways, steps = {}, 1
    for name, end in ends.items():
        names = mechanism.link(name).joint.coordinate_names
        ways[name] = end - starts[name]
        if not _counts_turns(mechanism):
            ways[name] -= _whole_turns(starts[name], end, names)
        units = [length if each[0] in SLIDES else 1.0 for each in names]
        steps = max(steps, int(np.ceil(np.max(np.abs(ways[name]) / units) / STEP)))

    def moved(step: int, poses: list[Array], report: Callable[[int], None]) -> list[Array]:
        places = {
            name: end if step == steps else starts[name] + step / steps * ways[name]
            for name, end in ends.items()
        }
        done = (step - 1) * count
        try:
            return closed(held(mechanism, places), poses, t0, lambda n: report(done + n))
        except PoseError as error:
            if steps == 1 or len(ends) == 1:
                raise
            raise PoseError(
                f"{error}; on the way to hold, at step {step} of {steps}: its {len(ends)} joints "
                "move there together, and this does not close. Hold one of them, or all along a "
                "way that closes, by several calls"
            ) from None

    with reporter(None, steps * count, ASSEMBLIES) as report:
        for step in range(1, steps + 1):
            try:
                poses = moved(step, poses, report)
            except PoseError as error:
                raise PoseError(
                    f"{error}; hold gives the coordinates of {', '.join(ends)}"
                ) from None
    return poses


def projected_at(
    mechanism: TreeKinematics, twists: list[Array], poses: list[Array], hold: Any, t0: float
) -> list[Array]:
    """Return the nearest twists in which joints have the rates in `hold`; see `_numbers`."""
    names = mechanism.names
    placed = dict(zip(names, poses, strict=True))
    moving = dict(zip(names, twists, strict=True))
    rates = _numbers(mechanism, hold, mechanism.velocities(moving, placed))
    places, driven = mechanism.coordinates(placed), mechanism.twist(rates, placed)
    still = held(mechanism, {name: places[name] for name in rates}, rates)
    try:
        nearest = projected(still, twists, poses, t0, [driven[name] for name in names])
    except TwistError as error:
        raise TwistError(f"{error}; hold gives the rates of {', '.join(rates)}") from None
    kept = mechanism.velocities(dict(zip(names, nearest, strict=True)), placed)
    most = max(float(np.max(np.abs(rate))) for rate in kept.values())
    for name, rate in rates.items():
        if np.any(np.abs(kept[name] - rate) > OFF * most):
            raise TwistError(
                f"hold[{name!r}]={brief(rate)}: no twist that all joints allow has these rates; "
                "the pose is near a dead point: hold another joint, or start elsewhere"
            )
    return nearest


def _numbers(
    mechanism: TreeKinematics, hold: Any, present: Mapping[str, Array]
) -> dict[str, Array]:
    """Return the coordinates or rates of held joints, (k,) or (n, k) by link.

    hold : dictionary by link; or names of links whose joints keep the numbers in `present`.
    """
    if isinstance(hold, Mapping):
        given = mechanism.by_link("hold", hold, is_whole=False)
    else:
        expected = "names of links, or a dictionary by link"
        names = (hold,) if isinstance(hold, str) else items_of("hold", hold, expected)
        for name in names:
            require_name("hold", name, mechanism.names)
        given = {name: present.get(name) for name in names}
    return {name: coordinates_of(mechanism, name, value) for name, value in given.items()}


def _counts_turns(mechanism: TreeKinematics) -> bool:
    """Return whether a whole turn of a joint leads elsewhere, by a gear or a screw."""
    return any(
        at.second != NOWHERE or (at.joint is not None and np.any(at.joint.pitch))
        for at in mechanism.connections
    )


def _whole_turns(start: Array, end: Array, names: tuple[str, ...]) -> Array:
    """Return the whole turns by which coordinates exceed the nearest equivalent ones of a start.

    They are about the axis of an angle or of a rotation vector.
    """
    excess = np.zeros_like(end - start)
    angles = [[i] for i, name in enumerate(names) if name[0] not in SLIDES]
    for turn in [[0, 1, 2]] if names[:3] == TURNS else angles:
        size = np.linalg.norm(end[..., turn], axis=-1, keepdims=True)
        axis = end[..., turn] / np.where(size, size, 1.0)
        along = np.sum(axis * start[..., turn], axis=-1, keepdims=True)
        excess[..., turn] = 2.0 * np.pi * np.round((size - along) / (2.0 * np.pi)) * axis
    return excess


def coordinates_of(mechanism: TreeKinematics, name: str, value: Any) -> Array:
    """Check the coordinates of a held joint; (k,) or (n, k)."""
    joint = mechanism.link(name).joint
    motions = motions_of(joint)
    if motions is None:
        raise ArgumentError(f"hold[{name!r}]: a {joint.name} joint has no coordinates to hold")
    return as_coordinates(f"hold[{name!r}]", value, motions.names)


def held(
    mechanism: TreeKinematics, places: dict[str, Array], rates: dict[str, Array] | None = None
) -> TreeKinematics:
    """Return the mechanism with joints held: by a motor, or fixed if they have more coordinates.

    Gears act between moving joints, so a joint with one coordinate is not fixed.

    places : coordinates of these joints.   rates : rates that the motors prescribe in their place.
    """
    links = list(mechanism.links)
    motors = []
    for i, link in enumerate(mechanism.links):
        place = places.get(link.name)
        if place is None:
            continue
        if place.shape[-1] == 1:
            rate = rates[link.name][..., 0] if rates else None
            own = motor(position=place[..., 0]) if rate is None else motor(speed=rate)
            motors.append(own.on(link.name))
            continue
        relative = link.joint.motions.pose(components(place))
        ground = se3.compose(pose_components(link.joint.ground_frame), relative)
        fixed = catalogue.fixed(ground_frame=pose_matrix(ground), body_frame=link.joint.body_frame)
        links[i] = replace(link, joint=fixed)
    moved = {} if rates else places
    kept = [
        force
        for force in mechanism.forces
        if force.kind.rows and not (isinstance(force.kind, PositionMotor) and force.at[0] in moved)
    ]
    return type(mechanism)(
        links, mechanism.loops, forces=[*kept, *motors], constraints=mechanism.constraints
    )
