"""All assemblies of a mechanism whose joints are held, by a search from random poses."""

from __future__ import annotations

from typing import Any

import numpy as np

from lierb.errors import ArgumentError, PoseError, brief
from lierb.kernels.groups import so3
from lierb.model.connections import NOWHERE
from lierb.model.joints.coordinates import is_rigid, motions_of
from lierb.model.joints.motions import TURNS
from lierb.model.mechanism.closing import closed_members, mobility
from lierb.model.mechanism.holding import SLIDES, coordinates_of, held
from lierb.model.mechanism.kinematics import TreeKinematics
from lierb.model.mechanism.row_system import System
from lierb.support.arrays import Array, components, is_whole, pose_matrix
from lierb.support.representations import counted

# Assemblies that differ by less, as rotation matrices and relative to the size of the mechanism,
# are one. At a dead point, where two meet, Newton's method ends at the root of its tolerance.
SAME = 1e-5
REACH = 2.0  # random slides, relative to the size of the mechanism


def assemblies_at(
    mechanism: TreeKinematics, hold: Any, near: dict[str, Array], starts: int, t0: float
) -> list[Array]:
    """Return the poses of all assemblies that the search finds, the nearest to `near` first.

    Every start has random coordinates of all joints but the held ones.
    """
    _require_one(mechanism, near, starts)
    fixed = {
        name: coordinates_of(mechanism, name, value)
        for name, value in mechanism.by_link("hold", hold or {}, is_whole=False).items()
    }
    for name, numbers in fixed.items():
        if numbers.ndim > 1 and len(numbers) > 1:
            raise ArgumentError(
                f"hold[{name!r}] has {len(numbers)} members; assemblies searches for one: call it "
                "for each"
            )
    length = float(np.max(System(mechanism, 1).length))
    begin = _random_coordinates(mechanism, near, length, starts) | fixed
    before = mechanism.pose_arrays("pose", mechanism.pose(begin))
    machine = held(mechanism, fixed)
    poses, chosen = closed_members(machine, before, t0)
    if not len(chosen):
        raise PoseError(
            f"none of {starts} random starts leads to a closed pose; check the lengths of the "
            "links, and whether the coordinates in hold are within reach"
        )
    poses = [pose[chosen] for pose in poses]
    _require_isolated(machine, poses)
    kept = _distinct(_numbers(poses, length))
    poses = [pose[kept] for pose in poses]
    own = [near[name] for name in mechanism.names]
    # rounded, so that mirror images, which are as far, have the order of their positions
    numbers = _numbers(poses, length)
    far = np.linalg.norm(numbers - _numbers(own, length), axis=1)
    keys = np.round(np.concatenate([far[:, None], numbers], axis=1) / SAME)
    order = np.lexsort(keys.T[::-1])
    return [pose[order] for pose in poses]


def _require_one(mechanism: TreeKinematics, near: dict[str, Array], starts: int) -> None:
    if not is_whole(starts) or starts < 1:
        raise ArgumentError(f"starts={brief(starts)}; expected a whole number, 1 or more")
    if (mechanism.batch_size(**{f"pose[{n!r}]": (x, 2) for n, x in near.items()}) or 1) > 1:
        raise ArgumentError(
            "assemblies searches for one member of the batch; use mechanism.of_body(…)"
        )
    if any(at.second != NOWHERE for at in mechanism.connections):
        raise ArgumentError(
            "how gears mesh depends on the start, so the assemblies of a mechanism with gears are "
            "not determined; leave the gears out, or use close"
        )


def _random_coordinates(
    mechanism: TreeKinematics, near: dict[str, Array], length: float, count: int
) -> dict[str, Any]:
    """Return random coordinates of all joints, or poses of links whose joint has none."""
    random = np.random.default_rng(0)
    places: dict[str, Any] = {}
    about = mechanism.coordinates(near)
    for link in mechanism.links:
        motions = motions_of(link.joint)
        if motions is None:
            if not is_rigid(link.joint):
                places[link.name] = _random_poses(random, about[link.name], length, count)
            continue
        names = motions.names
        numbers = random.uniform(-np.pi, np.pi, (count, len(names)))
        for i, name in enumerate(names):
            if name[0] in SLIDES:
                slides = _random_slides(random, (count,), length)
                numbers[:, i] = about[link.name][..., i] + slides
        if names[:3] == TURNS:
            numbers[:, :3] = _random_turns(random, count)
        places[link.name] = numbers
    return places


def _random_turns(random: np.random.Generator, count: int) -> Array:
    """Return rotation vectors of any direction, up to half a turn."""
    axes = random.standard_normal((count, 3))
    sizes = np.linalg.norm(axes, axis=1, keepdims=True)
    return np.asarray(axes / sizes * random.uniform(0.0, np.pi, (count, 1)))


def _random_poses(random: np.random.Generator, about: Array, length: float, count: int) -> Array:
    places = components(about.reshape(4, 4)[:3, 3] + _random_slides(random, (count, 3), length))
    return pose_matrix((so3.exp(components(_random_turns(random, count))), places))


def _random_slides(random: np.random.Generator, shape: tuple[int, ...], length: float) -> Array:
    return REACH * length * random.uniform(-1.0, 1.0, shape)


def _require_isolated(machine: TreeKinematics, poses: list[Array]) -> None:
    freedoms = int(np.min(mobility(machine, poses, lambda row: row.is_holonomic).freedoms))
    if freedoms:
        raise ArgumentError(
            f"hold leaves {counted(freedoms, 'freedom')}, so there are assemblies without number, "
            "or all are at dead points; hold further coordinates"
        )


def _numbers(poses: list[Array], length: float) -> Array:
    """Return rotation matrices, and positions relative to the size, of all links, (n, 12 links)."""
    unit = np.array((1.0, 1.0, 1.0, length))
    return np.concatenate([(pose[..., :3, :] / unit).reshape(-1, 12) for pose in poses], axis=1)


def _distinct(numbers: Array) -> list[int]:
    """Return the index of the first of all rows that are the same."""
    kept, left = [], np.arange(len(numbers))
    while len(left):
        kept.append(int(left[0]))
        far = np.abs(numbers[left] - numbers[left[0]]).max(axis=1)
        left = left[far > SAME]
    return kept
