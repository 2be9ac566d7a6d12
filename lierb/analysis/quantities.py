"""Quantities of a run with their derivatives, as fits compare them and propagation follows them.

Values may lie on a group. Differences of two values, and derivatives, are vectors: those of a
rotation and a pose are in body axes, log(R₁ᵀR₂) and log(C₁⁻¹C₂).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lierb.errors import ArgumentError, unknown_name
from lierb.lie import Group, se3, so3
from lierb.model.base import Model
from lierb.model.joints.coordinates import motions_of
from lierb.model.problem import Problem
from lierb.results.result import Result
from lierb.runs.parameters import POSE_UNITS, TWIST_UNITS, Parameter
from lierb.support.arrays import Array, components, pose_matrix

ALIASES = {"R": "rotation", "C": "pose"}
QUATERNION = "quaternion"  # values that are read as rotations
WRAPPED = ("phi", "alpha", "beta")  # coordinates in [−π, π]
RECORDS = {"lambda": "multipliers", "reaction": "reaction", "energy": "energy"}


@dataclass(frozen=True)
class Quantity:
    """A quantity whose values are vectors or numbers, in one column of a history.

    name : name of the quantity.   shape : shape of one value.   unit : unit of its differences.
    of, part : quantity of `Result.sensitivity`, and the range of its numbers.
    """

    name: str
    shape: tuple[int, ...]
    unit: str
    of: str
    part: tuple[int, int | None] = (0, None)

    @property
    def link(self) -> str:
        """Return the prefix of the link's columns."""
        link, dot, _ = self.name.rpartition(".")
        return link + dot

    def of_trajectories(self, which: NDArray[np.int64]) -> Quantity:
        """Return the quantity of some trajectories."""
        return self

    @property
    def width(self) -> int:
        """Return the number of components of a difference."""
        return prod(self.shape)

    def values(self, result: Result) -> Array:
        """Return the values at the saved times, (times, n, *shape)."""
        column = np.asarray(result[self.name])
        return column.reshape(*column.shape[:2], *self.shape)

    def difference(self, first: Array, second: Array) -> Array:
        """Return the vector from the first value to the second, (…, width)."""
        lead = second.ndim - len(self.shape)
        return np.asarray((second - first).reshape(*second.shape[:lead], self.width))

    def derivative(self, result: Result, p: Parameter) -> Array:
        """Return the derivatives by a parameter, (times, n, width, k)."""
        array = result.sensitivity(self.of, p.name)
        array = array.reshape(*array.shape[:2], -1, array.shape[-1])
        return np.asarray(array[..., slice(*self.part), :])

    def slope(self, difference: Array) -> Array | None:
        """Return the derivative of a difference by its second value; None for the identity."""
        return None

    def moved(self, value: Array, change: Array) -> Array:
        """Return the value at a difference from another one."""
        return np.asarray(value + change.reshape(value.shape))


class Twist(Quantity):
    """Twist (ω, v), which has two columns."""

    def values(self, result: Result) -> Array:
        return np.concatenate([np.asarray(result[f"{self.link}{x}"]) for x in ("omega", "v")], -1)


class Position(Quantity):
    """Position in the ground's axes, whose derivatives by the pose are in the body's."""

    def derivative(self, result: Result, p: Parameter) -> Array:
        return rotations(result, self.link) @ super().derivative(result, p)


class OfGroup(Quantity):
    """Rotation or pose."""

    @property
    def group(self) -> Group:
        return se3 if self.shape == (4, 4) else so3

    @property
    def width(self) -> int:
        return self.group.dim

    def values(self, result: Result) -> Array:
        turned = rotations(result, self.link)
        if self.group is so3:
            return turned
        position = np.asarray(result[f"{self.link}position"])
        return pose_matrix((components(turned, 2), components(position)))

    def difference(self, first: Array, second: Array) -> Array:
        first, second = np.broadcast_arrays(first, second)
        known = np.isfinite(first).all((-2, -1)) & np.isfinite(second).all((-2, -1))
        off = np.full((*known.shape, self.width), np.nan)
        off[known] = self.group.log(self.group.inverse(first[known]) @ second[known])
        return off

    def slope(self, difference: Array) -> Array:
        return self.group.dexpinv(-difference)

    def moved(self, value: Array, change: Array) -> Array:
        return value @ self.group.exp(change)


@dataclass(frozen=True)
class Coordinates(Quantity):
    """Coordinates of a joint, whose derivatives are the rates of a twist C⁻¹∂C."""

    model: Model | None = None
    wrapped: tuple[bool, ...] = ()

    def values(self, result: Result) -> Array:
        return self._by_joint("coordinates", _poses(result))

    def difference(self, first: Array, second: Array) -> Array:
        apart = second - first
        turns = np.where(self.wrapped, np.rint(apart / (2.0 * np.pi)), 0.0)
        return np.asarray(apart - 2.0 * np.pi * turns)

    def derivative(self, result: Result, p: Parameter) -> Array:
        poses, columns = _poses(result), []
        changes = {link: result.sensitivity(f"{link}pose", p.name) for link in poses}
        for k in range(p.size):
            twists = {link: change[..., k] for link, change in changes.items()}
            columns.append(self._by_joint("velocities", twists, poses))
        return np.stack(columns, -1)

    def _by_joint(self, function: str, *given: dict[str, Array]) -> Array:
        """Call a function of the model on all rows at once; those of failed runs are NaN."""
        first = next(iter(given[-1].values()))
        lead = first.shape[:2]
        known = np.isfinite(first).all((-2, -1))
        model: Any = self.model
        if self.is_batched:
            model = model.part(np.nonzero(known)[1])
        flat = [{link.rstrip("."): array[known] for link, array in each.items()} for each in given]
        values = np.full((*lead, self.width), np.nan)
        if isinstance(model, Problem):
            rows = getattr(model.joint, function)(*(each[""] for each in flat))
        else:
            rows = getattr(model, function)(*flat)[self.link.rstrip(".")]
        values[known] = rows
        return values

    @property
    def is_batched(self) -> bool:
        """Return whether the model differs from trajectory to trajectory."""
        return self.model is not None and (self.model.batch_size() or 1) > 1

    def of_trajectories(self, which: NDArray[np.int64]) -> Coordinates:
        if not self.is_batched:
            return self
        assert self.model is not None
        # the model may have numbers for the trajectories of one experiment, which hold for all
        size = self.model.batch_size() or 1
        return replace(self, model=self.model.part(which % size))


def rotations(result: Result, link: str) -> Array:
    """Return the rotations at the saved times, (times, n, 3, 3)."""
    columns = np.asarray(result[f"{link}rotation"])
    return columns.reshape(*columns.shape[:2], 3, 3)


def _poses(result: Result) -> dict[str, Array]:
    """Return the poses of all links at the saved times, by prefix."""
    return {
        prefix: OfGroup(f"{prefix}pose", (4, 4), POSE_UNITS, "").values(result)
        for prefix in ([f"{link}." for link in result.links] or [""])
    }


# ---- names -------------------------------------------------------------------------------------


def quantity_named(model: Model, argument: str, name: Any) -> Quantity:
    """Return a quantity of a model. Raises UnknownNameError."""
    known = {q.name: q for q in quantities_of(model)}
    link, dot, last = name.rpartition(".") if isinstance(name, str) else ("", "", name)
    alias = f"{link}{dot}{ALIASES.get(last, last)}".replace(QUATERNION, "rotation")
    if alias not in known:
        raise unknown_name(argument, name, [*known])
    return known[alias]


def records_of(quantities: list[Quantity]) -> list[str]:
    """Return the columns that a run must record for the values of quantities."""
    last = [q.name.rpartition(".")[2] for q in quantities]
    return ["state", *dict.fromkeys(RECORDS[x] for x in last if x in RECORDS)]


def quantities_of(model: Model) -> Iterator[Quantity]:
    """Yield all quantities of a model."""
    for link, at in zip(model.link_names, model.joints, strict=False):
        prefix = f"{link}." if link else ""
        pose, twist = f"{prefix}pose", f"{prefix}twist"
        yield OfGroup(pose, (4, 4), POSE_UNITS, pose)
        yield OfGroup(f"{prefix}rotation", (3, 3), "rad", pose, (0, 3))
        yield Position(f"{prefix}position", (3,), "m", pose, (3, 6))
        yield Twist(twist, (6,), TWIST_UNITS, twist)
        yield Quantity(f"{prefix}omega", (3,), "rad/s", twist, (0, 3))
        yield Quantity(f"{prefix}v", (3,), "m/s", twist, (3, 6))
        assert at.joint is not None
        if motions := motions_of(at.joint):
            names = motions.names
            wrapped = tuple(name in WRAPPED for name in names)
            unit = ", ".join("m" if name[0] in "ds" else "rad" for name in names)
            yield Coordinates(
                f"{prefix}coordinates", (len(names),), unit, pose, model=model, wrapped=wrapped
            )
    yield Quantity("energy", (), "J", "energy")
    for signal in model.signals:
        yield Quantity(signal.name, signal.shape, signal.unit, signal.name)
    for each in model.observables:
        yield Quantity(each.name, (), each.unit, each.name)
    for name, rows in model.rows_by_name:
        if rows:
            label = f"{name}.lambda" if name else "lambda"
            yield Quantity(label, (len(rows),), ", ".join(row.unit for row in rows), label)
    for name in model.joint_names or ("",):
        label = f"{name}.reaction" if name else "reaction"
        yield Quantity(label, (6,), "N m, N m, N m, N, N, N", label)


def require_derivatives(quantity: Quantity, parameters: tuple[Parameter, ...]) -> None:
    """Raise ArgumentError for coordinates whose derivatives would lack those of the joint."""
    if not (isinstance(quantity, Coordinates) and not all(quantity.wrapped)):
        return
    for p in parameters:
        owner, is_of_joint, _ = f".{p.name}".rpartition(".joint.")
        if not p.is_start and is_of_joint and owner[1:] == quantity.link.rstrip("."):
            raise ArgumentError(
                f"{quantity.name} depends on {p.name} directly, which is not differentiated; "
                "take the pose, or an observable"
            )
