"""Variations of a model and its start along parameters of `with_respect_to`, of any size.

The derivatives of a run are those of these variations at zero.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from lierb.kernels.systems.layout import POSE
from lierb.lie import se3
from lierb.model.base import Model
from lierb.model.mechanism.mechanism import Mechanism
from lierb.model.problem import Problem
from lierb.runs.parameters import Parameter, seeds_of
from lierb.runs.start_directions import Seeds, Start, carried
from lierb.runs.starts import start_of
from lierb.support.arrays import Array, Which, assembled, pose_matrix

Changes = Mapping[str, Array]  # by parameter: (k,), or (n, k) for each trajectory
PosesAndTwists = tuple[dict[str, Array], dict[str, Array]]  # by link


class Varied(NamedTuple):
    """Model with its start.   poses, twists : by link."""

    model: Model
    poses: dict[str, Array]
    twists: dict[str, Array]

    @property
    def batch_size(self) -> int:
        """Return the number of trajectories. Raises ArgumentError if arrays disagree."""
        sizes = {f"pose0 {k}": (x, 2) for k, x in self.poses.items()}
        sizes |= {f"twist0 {k}": (x, 1) for k, x in self.twists.items()}
        return self.model.batch_size(**sizes) or 1

    @property
    def start(self) -> dict[str, Any]:
        """Return the keywords pose0 and twist0 of `lierb.integrate`."""
        from_links = self.model.from_links
        return {"pose0": from_links(self.poses), "twist0": from_links(self.twists)}


def with_start(model: Model, pose0: Any, twist0: Any) -> Varied:
    """Return a model with its validated start, as arrays that stay as they are."""
    poses, twists = start_of(model, pose0, twist0)
    if poses is None:
        (at,) = model.joints  # a mechanism has poses
        assert at.joint is not None
        poses = dict.fromkeys(model.link_names, at.joint.closed_pose)
    copies = ({k: np.array(x) for k, x in each.items()} for each in (poses, twists))
    return Varied(model, *copies)


class Variation:
    """Model and start that change along parameters, from a base at which all changes are zero."""

    def __init__(self, base: Varied, parameters: tuple[Parameter, ...], t0: float) -> None:
        self.base, self.parameters, self.t0 = base, parameters, t0
        self.model = base.model
        self.has_rows = any(rows for _, rows in base.model.rows_by_name)
        self.moves_poses = any(p.name.endswith("pose0") or p.moves_start for p in parameters)

    @cached_property
    def values(self) -> dict[str, Array]:
        """Return the numbers of the model's parameters, by name: (k,), or (n, k) of a batch."""
        return {p.name: self._value(p) for p in self.parameters if not p.is_start}

    @cached_property
    def start(self) -> Start:
        return Start(self.model, self.base.poses, self.base.twists, self.t0)

    @cached_property
    def moved(self) -> dict[str, dict[str, tuple[Array, Array]]]:
        """Return directions of the start, by parameter and link: C⁻¹δC and δV, (k, n or 1, 6)."""
        moved, pairs = {}, [*zip(self.model.fields, self.model.link_names, strict=True)]
        with np.errstate(all="ignore"):
            starts = (p for p in self.parameters if p.is_start)
            for name, seeds in seeds_of(starts, self.start).items():
                moved[name] = {link: self._moved(seeds, field, link) for field, link in pairs}
        return moved

    def at(self, changes: Changes) -> Varied:
        """Return the model and the start with these changes. Raises the errors of their making."""
        numbers: dict[str, Array] = {}
        for p in self.parameters:
            if not p.is_start:
                own = self.model.inputs[p.fields[0]]
                before = numbers.get(p.fields[0], own)  # several points may share a frame
                values = self.values[p.name] + changes[p.name]
                changed = _replaced(before, item_shape(own, p), p, values)
                numbers |= dict.fromkeys(p.own_fields, changed)
        model = self.model.renumbered(numbers) if numbers else self.model
        poses, twists = self._moved_start(model, changes)
        return Varied(model, poses, twists)

    def _moved_start(self, model: Model, changes: Changes) -> PosesAndTwists:
        poses, twists = dict(self.base.poses), dict(self.base.twists)
        if any(p.moves_start for p in self.parameters):
            poses, twists = self._carried(model)
        for p in (p for p in self.parameters if p.is_start):
            change = np.asarray(changes[p.name])
            for link, (turned, sped) in self.moved[p.name].items():
                if p.name.endswith("pose0"):
                    poses[link] = poses[link] @ se3.exp(_along(change, turned))
                twists[link] = twists[link] + _along(change, sped)
        if self.moves_poses and self.has_rows:
            return self._closed(model, poses, twists)
        return poses, twists

    def _carried(self, model: Model) -> PosesAndTwists:
        """Return the start with which the relative motions in the joints stay."""
        start, links = self.start, self.model.link_names
        changed = Start(model, self.base.poses, self.base.twists, self.t0).mechanism
        joints = {at.name: changed.parameters(at) for at in changed.joints}
        poses, twists = carried(
            start.mechanism, lambda at: joints[at.name], start.placed, start.moving
        )
        return (
            {link: pose_matrix(poses[i]) for i, link in enumerate(links)},
            {link: assembled(twists[i]) for i, link in enumerate(links)},
        )

    def _closed(self, model: Model, *start: dict[str, Array]) -> PosesAndTwists:
        """Return the nearest start that satisfies joints, loops and constraints."""
        assert isinstance(model, (Problem, Mechanism))
        poses, twists = map(model.from_links, start)
        closed: Any = model.close(poses, t0=self.t0)
        projected: Any = model.project(twists, closed, t0=self.t0)
        return model.by_link("pose0", closed), model.by_link("twist0", projected)

    def _moved(self, seeds: Mapping[str, Array], field: str, link: str) -> tuple[Array, Array]:
        twists = seeds[f"{field}twist"]
        frames = seeds.get(f"{field}pose")
        if frames is None:
            return np.zeros_like(twists), twists
        rotation = self.base.poses[link][..., :3, :3]
        turned = np.einsum(
            "...ji,k...jl->k...il", rotation, frames[..., :9].reshape(*frames.shape[:-1], 3, 3)
        )
        axis = np.stack((turned[..., 2, 1], turned[..., 0, 2], turned[..., 1, 0]), -1)
        place = np.einsum("...ji,k...j->k...i", rotation, frames[..., 9:])
        return np.concatenate((axis, place), -1), twists

    def _value(self, p: Parameter) -> Array:
        own, units = self.model.inputs[p.fields[0]], _units(p)
        shape = item_shape(own, p)
        flat = own.reshape(*own.shape[: own.ndim - len(shape)], -1)
        return np.asarray(flat[..., np.argmax(units != 0.0, axis=1)])


def fixed_directions(variation: Variation) -> dict[str, Seeds]:
    """Return the seeds of starts that stay those of the base, by parameter; empty if poses move.

    The rates of links that no parameter names follow by least kinetic energy, which depends on
    masses: the directions are fixed, so that a start depends on its unknowns alone.
    """
    if variation.moves_poses:
        return {}
    with np.errstate(all="ignore"):
        return seeds_of((p for p in variation.parameters if p.is_start), variation.start)


def with_directions(
    parameters: tuple[Parameter, ...], fixed: Mapping[str, Seeds], which: Which = slice(None)
) -> tuple[Parameter, ...]:
    """Return parameters whose directions are fixed, those of some trajectories."""

    def directed(p: Parameter) -> Parameter:
        if p.name not in fixed:
            return p
        own = {k: x[:, which] if x.shape[1] > 1 else x for k, x in fixed[p.name].items()}
        return p._replace(seeds=lambda start: own, follows="")

    return tuple(directed(p) for p in parameters)


def item_shape(own: Array, p: Parameter) -> tuple[int, ...]:
    """Return the shape of one member of a parameter's array in `Model.inputs`."""
    return own.shape if own.size == _units(p).shape[1] else own.shape[1:]


def _units(p: Parameter) -> Array:
    """Return the changes of the numbers of a field's array, (directions, numbers)."""
    assert p.units is not None
    if not p.fields[0].endswith(("ground_frame", "body_frame")):
        return p.units
    units = np.zeros((len(p.units), 16))
    units[:, POSE] = p.units
    return units


def _replaced(before: Array, shape: tuple[int, ...], p: Parameter, values: Array) -> Array:
    """Return a field's array with other values of a parameter.   values : (k,) or (n, k)."""
    units = _units(p)
    lead = values.shape[:-1] or before.shape[: before.ndim - len(shape)]
    array = np.array(np.broadcast_to(before, (*lead, *shape)))
    flat = array.reshape(*lead, -1)
    for i, unit in enumerate(units):
        flat[..., unit != 0.0] = values[..., i, None]
    return array


def _along(change: Array, directions: Array) -> Array:
    """Return Σ change · direction, (6,) or (n, 6).

    change : (k,) or (n, k).   directions : (k, n or 1, 6).
    """
    if directions.shape[1] == 1:
        return np.asarray(change @ directions[:, 0])
    changes = np.broadcast_to(change, (directions.shape[1], len(directions)))
    return np.asarray(np.einsum("...k,k...i->...i", changes, directions))
