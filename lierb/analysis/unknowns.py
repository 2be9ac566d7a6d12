"""Unknowns of a fit, and the changes of model and start that they stand for.

Unknowns are the numbers of parameters of the model, then changes of each trajectory's start along
the directions that joints and loops admit. Least squares varies coordinates of them: those of
`lierb.analysis.pseudo_inertia` for a body whose inertia is unknown, otherwise the numbers.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from math import prod
from typing import Any, NamedTuple

import numpy as np

from lierb.analysis.followed import Followed, followed
from lierb.analysis.pseudo_inertia import SIZES, body_of, coordinates_of, derivatives_of
from lierb.errors import ArgumentError
from lierb.lie import se3
from lierb.runs.parameters import Parameter, chosen_parameters, labels_of, slices_of, units_of
from lierb.runs.variations import Variation
from lierb.support.arrays import Array

RANK = 1e-9  # relative size of directions that joints do not admit
ROUNDING = 1e-12  # the same of components that joints hold, and of coordinates at a bound


class Charted(NamedTuple):
    """Body whose inertia is unknown.

    unknown : names of SIZES that are.   given : coordinates of all, at the base.
    """

    prefix: str
    unknown: tuple[str, ...]
    given: dict[str, Array]


class Sizes(NamedTuple):
    """Typical sizes of all numbers of the model, and of the unknowns of starts."""

    numbers: Array
    starts: Array

    def part(self, which: Any) -> Sizes:
        """Return those of some experiments."""
        return Sizes(self.numbers[which], self.starts[which])


class Unknowns:
    """Unknowns of one experiment, or of each of several, which have a leading axis in all arrays.

    An experiment has `count` trajectories, those of the next one follow. Shapes are given without
    the axis of experiments.
    """

    def __init__(
        self,
        variation: Variation,
        count: int,
        least: Sizes | None = None,
        experiments: int | None = None,
        follow: Followed | None = None,
    ) -> None:
        """least : `sizes` of the guess; those of numbers are the least ones. None for a guess.

        experiments : number of experiments with unknowns of their own; None for a single one,
        without the axis.
        follow : the model's numbers by their unknowns; those of the variation if None.
        """
        self.variation, self.count, self._least = variation, count, least
        self.follow = follow or followed(variation, count, experiments)
        self.lead = () if experiments is None else (experiments,)
        self.numbers = [p for p in variation.parameters if not p.is_start]
        self.starts = [p for p in variation.parameters if p.is_start]
        self.slices, self.start_parts = slices_of(self.numbers), slices_of(self.starts)
        self.number_count = sum(p.size for p in self.numbers)
        self.shared = len(self.follow.free)  # unknowns of all trajectories together

    # ---- starts --------------------------------------------------------------------------------

    @cached_property
    def bases(self) -> Array:
        """Return the admitted directions of starts, (count, numbers, admitted)."""
        shape = (*self.lead, self.count)
        if not self.starts:
            return np.zeros((*shape, 0, 0))
        moved = [
            np.concatenate(
                [np.concatenate(both, -1) for both in self.variation.moved[p.name].values()], -1
            )
            for p in self.starts
        ]  # (numbers, n or 1, 12 links) each
        rows = np.concatenate(
            [np.broadcast_to(x, (len(x), prod(shape), x.shape[-1])) for x in moved]
        ).swapaxes(0, 1)
        if np.array_equal(rows, np.broadcast_to(rows[:1], rows.shape)):
            rows = rows[:1]  # all starts admit the same
        basis = _admitted(rows)
        basis = np.broadcast_to(basis, (prod(shape), *basis.shape[1:]))
        return basis.reshape(*shape, *basis.shape[1:])

    @property
    def admitted(self) -> int:
        """Return the number of unknowns of a trajectory's start."""
        return int(self.bases.shape[-1])

    @property
    def start_slices(self) -> list[slice]:
        """Return the place of each trajectory's start among the unknowns."""
        firsts = [self.shared + i * self.admitted for i in range(self.count)]
        return [slice(first, first + self.admitted) for first in firsts]

    @cached_property
    def size(self) -> int:
        """Return the number of unknowns."""
        return self.shared + self.count * self.admitted

    @cached_property
    def spread(self) -> Array:
        """Return the matrix from unknowns to all numbers, those of starts as the joints move them.

        A joint turns a change of one number into a motion that it admits: C⁻¹δC and δV of the
        links, whose numbers depend on each other.
        """
        width, moved = self.bases.shape[-2], self._changes_of_starts @ self.bases
        matrix = np.zeros((*self.lead, self.number_count + self.count * width, self.size))
        matrix[..., : self.number_count, : self.shared] = self.follow.matrix
        for i, part in enumerate(self.start_slices):
            first = self.number_count + i * width
            matrix[..., first : first + width, part] = moved[..., i, :, :]
        matrix[np.abs(matrix) < ROUNDING * np.abs(matrix).max(initial=0.0)] = 0.0
        return matrix

    @property
    def _changes_of_starts(self) -> Array:
        """Return the change of each number of the starts by each, (count, numbers, numbers)."""
        trajectories = prod((*self.lead, self.count))
        changes = np.zeros((trajectories, *[sum(p.size for p in self.starts)] * 2))
        for p in self.starts:
            link, is_pose = p.name.rpartition(".")[0], p.name.endswith("pose0")
            for other in self.starts:
                turned, sped = self.variation.moved[other.name][link]
                own = np.moveaxis(turned if is_pose else sped, 0, -1)  # (n or 1, 6, numbers)
                place = self.start_parts[p.name], self.start_parts[other.name]
                changes[:, *place] = own[:, : p.size]
        return changes.reshape(*self.lead, self.count, *changes.shape[1:])

    # ---- coordinates ---------------------------------------------------------------------------

    @cached_property
    def values(self) -> dict[str, Array]:
        """Return the numbers of the model's parameters at the base. Raises ArgumentError."""
        return {name: self._own(name, each) for name, each in self.variation.values.items()}

    def _own(self, name: str, values: Array) -> Array:
        """Return the numbers of a parameter by experiment."""
        if values.ndim == 1:
            return np.broadcast_to(values, (*self.lead, len(values)))
        if not self.lead:
            raise ArgumentError(
                f"{name} has a number for each of {len(values)} trajectories; give the problem one "
                "for all, which is varied"
            )
        values = values.reshape(*self.lead, self.count, -1)
        if np.any(values != values[:, :1]):
            raise ArgumentError(
                f"{name} has different numbers in the trajectories of an experiment; expected one "
                "for all of them, which is varied"
            )
        return np.asarray(values[:, 0])

    @cached_property
    def charted(self) -> list[Charted]:
        """Return the bodies whose inertia is unknown."""
        names = [
            p.name.removesuffix("inertia") for p in self.numbers if p.name.endswith("body.inertia")
        ]
        return [self._charted(prefix) for prefix in names]

    def _charted(self, prefix: str) -> Charted:
        model, base, t0 = self.variation.model, self.variation.base, self.variation.t0
        all_names = [f"{prefix}{name}" for name in SIZES]
        numbers = Variation(base, chosen_parameters(model, all_names), t0).values
        unknown = tuple(name for name in SIZES if f"{prefix}{name}" in self.slices)
        mass, com, inertia = (self._own(name, numbers[name]) for name in all_names)
        return Charted(prefix, unknown, coordinates_of(mass[..., 0], com, inertia))

    @cached_property
    def base(self) -> Array:
        """Return the coordinates at the base, of a start zero."""
        starts = np.zeros((*self.lead, self.size - self.shared))
        return np.concatenate((self.base_of_numbers[..., self.follow.free], starts), -1)

    @cached_property
    def base_of_numbers(self) -> Array:
        """Return the coordinates of all numbers of the model at the base."""
        x = np.zeros((*self.lead, self.number_count))
        for p in self.numbers:
            x[..., self.slices[p.name]] = self.values[p.name]
        for body in self.charted:
            for name in body.unknown:
                x[..., self.slices[f"{body.prefix}{name}"]] = body.given[name]
        return x

    def _of_numbers(self, x: Array) -> Array:
        """Return the coordinates of all numbers of the model."""
        free = x[..., : self.shared]
        if self.shared == self.number_count:
            return free
        change = free - self.base[..., : self.shared]
        x = self.base_of_numbers + (self.follow.matrix @ change[..., None])[..., 0]
        x[..., self.follow.free] = free
        return x

    def _coordinates(self, body: Charted, x: Array) -> dict[str, Array]:
        own = {name: x[..., self.slices[f"{body.prefix}{name}"]] for name in body.unknown}
        return body.given | own

    def numbers_at(self, x: Array) -> dict[str, Array]:
        """Return the numbers of the model's parameters at coordinates."""
        x = self._of_numbers(x)
        numbers = {name: x[..., part] for name, part in self.slices.items()}
        for body in self.charted:
            values = body_of(self._coordinates(body, x))
            numbers |= {f"{body.prefix}{name}": values[name] for name in body.unknown}
        return numbers

    def changes(self, x: Array) -> dict[str, Array]:
        """Return the changes of all parameters at coordinates, as `Variation.at` takes them."""
        numbers = self.numbers_at(x)
        changes = {name: each - self.values[name] for name, each in numbers.items()}
        along = x[..., self.shared :].reshape(*self.lead, self.count, self.admitted, 1)
        moved = (self.bases @ along)[..., 0]
        if self.lead:  # by trajectory
            changes = {name: np.repeat(each, self.count, axis=0) for name, each in changes.items()}
            moved = moved.reshape(self.lead[0] * self.count, moved.shape[-1])
        elif self.count == 1:
            moved = moved[0]
        return changes | {name: moved[..., part] for name, part in self.start_parts.items()}

    def slope(self, x: Array) -> Array:
        """Return the derivatives of the shared unknowns by their coordinates."""
        x, free = self._of_numbers(x), self.follow.free
        slope = np.zeros((*self.lead, self.number_count, self.number_count))
        slope[..., range(self.number_count), range(self.number_count)] = 1.0
        for body in self.charted:
            derivatives = derivatives_of(self._coordinates(body, x))
            for row in body.unknown:
                for column in body.unknown:
                    rows, columns = (self.slices[f"{body.prefix}{x}"] for x in (row, column))
                    slope[..., rows, columns] = derivatives.get((row, column), 0.0)
        return slope[..., free[:, None], free]

    def turned(self, changes: Mapping[str, Array], p: Parameter) -> Array | None:
        """Return the matrices from changes of a moved pose to those of its base; None if equal.

        C₀ exp(ε + δ) = C₀ exp(ε) exp(dexp₋ε δ) for a free body. Joints make this approximate, and
        a fit begins again from the moved pose.
        """
        if not p.name.endswith("pose0") or self.variation.has_rows:
            return None
        return np.asarray(se3.dexp(-np.asarray(changes[p.name])))

    # ---- sizes and names -----------------------------------------------------------------------

    @cached_property
    def sizes(self) -> Sizes:
        """Return the typical sizes: of a number that of its parameter, of others 1."""
        if self._least is not None:
            return self._least._replace(numbers=np.maximum(self._largest, self._least.numbers))
        numbers = np.where(self._largest > 0.0, self._largest, 1.0)
        return Sizes(numbers, np.ones((*self.lead, self.size - self.shared)))

    @cached_property
    def _largest(self) -> Array:
        """Return the largest number of each number's parameter at the base."""
        largest = np.zeros((*self.lead, self.number_count))
        for p in self.numbers:
            own = np.abs(self.values[p.name]).max(axis=-1, keepdims=True)
            largest[..., self.slices[p.name]] = own
        return largest

    def bound_sizes(self, jacobian: Array, most: Array) -> None:
        """Bound the sizes of starts and of parameters that are zero, which the guess does not tell.

        A change by its size changes the residuals by `most` at most.

        jacobian : of the weighted residuals by the unknowns.   most : the largest of the norms of
        the weighted data, of the residuals at the guess, and of noise of a given standard
        deviation.
        """
        norms = np.linalg.norm(jacobian, axis=-2)
        largest = np.asarray(most)[..., None] / np.where(norms > 0.0, norms, np.inf)
        largest = np.where(largest > 0.0, largest, np.inf)
        numbers, starts = self.sizes.numbers.copy(), self.sizes.starts
        free, of_numbers, of_starts = self.follow.free, *np.split(largest, [self.shared], axis=-1)
        is_open = self._largest[..., free] == 0.0
        bounded = np.minimum(numbers[..., free], of_numbers)
        numbers[..., free] = np.where(is_open, bounded, numbers[..., free])
        self.sizes = Sizes(numbers, np.minimum(starts, of_starts))

    @property
    def number_scales(self) -> Array:
        """Return the typical size of the coordinate of each number; logarithms have 1."""
        scales = self.sizes.numbers.copy()
        for body in self.charted:
            for name in ("mass", "inertia"):
                if name in body.unknown:
                    scales[..., self.slices[f"{body.prefix}{name}"]] = 1.0
        return scales

    @property
    def unknown_sizes(self) -> Array:
        """Return the typical size of each unknown."""
        return self._of_unknowns(self.sizes.numbers)

    @property
    def scales(self) -> Array:
        """Return the typical size of each coordinate."""
        return self._of_unknowns(self.number_scales)

    def _of_unknowns(self, numbers: Array) -> Array:
        return np.concatenate((numbers[..., self.follow.free], self.sizes.starts), -1)

    @property
    def labels(self) -> tuple[str, ...]:
        """Return a name for each number of the parameters, starts trajectory by trajectory."""
        labels = [label for p in self.numbers for label in labels_of(p)]
        for i in range(self.count):
            for p in self.starts:
                name = f"{p.name}[{i}]" if self.count > 1 else p.name
                labels += [f"{name}[{k}]" for k in range(p.size)]
        return tuple(labels)

    @property
    def units(self) -> tuple[str, ...]:
        """Return the unit of each number of the parameters."""
        starts = [unit for p in self.starts for unit in units_of(p)]
        return tuple([unit for p in self.numbers for unit in units_of(p)] + self.count * starts)

    @property
    def all_values(self) -> Array:
        """Return the numbers of the parameters at the base; zero for starts, which are changes.

        Numbers that are rounding beside others of their parameter are zero too.
        """
        values = np.zeros((*self.lead, len(self.labels)))
        for p in self.numbers:
            own, part = self.values[p.name], self.slices[p.name]
            is_rounding = np.abs(own) < ROUNDING * self.sizes.numbers[..., part]
            values[..., part] = np.where(is_rounding, 0.0, own)
        return values

    # ---- by parameter --------------------------------------------------------------------------

    def as_given(self, covariance: Array) -> tuple[Array, tuple[str, ...]]:
        """Return a covariance of all numbers, and their labels, in the order of the parameters.

        Starts of several trajectories stay last.
        """
        order = list(range(len(self.labels)))
        if self.count == 1:
            behind = {
                name: slice(self.number_count + part.start, self.number_count + part.stop)
                for name, part in self.start_parts.items()
            }
            places = self.slices | behind
            order = [i for p in self.variation.parameters for i in order[places[p.name]]]
        labels = tuple(self.labels[i] for i in order)
        return covariance[..., order, :][..., order], labels

    @property
    def estimate(self) -> dict[str, Array]:
        """Return the numbers of each parameter at the base, with an axis for trajectories."""
        estimate, base = {}, self.variation.base
        for p in self.variation.parameters:
            if not p.is_start:
                estimate[p.name] = np.array(self.values[p.name])
                continue
            link, _, what = p.name.rpartition(".")
            array = base.poses[link] if what == "pose0" else base.twists[link]
            array = array[..., :3] if what == "omega0" else array
            estimate[p.name] = self._by_experiment(array, 2 if what == "pose0" else 1)
        return estimate

    def _by_experiment(self, array: Array, item_axes: int) -> Array:
        if not self.lead:
            return array
        item = array.shape[-item_axes:]
        several = (self.count,) if self.count > 1 else ()
        array = np.broadcast_to(array, (self.lead[0] * self.count, *item))
        return np.array(array.reshape(*self.lead, *several, *item))

    def by_parameter(self, numbers: Array) -> dict[str, Array]:
        """Return numbers in the order of the labels by parameter, likewise."""
        by_name = {name: numbers[..., part] for name, part in self.slices.items()}
        starts = numbers[..., self.number_count :].reshape(*numbers.shape[:-1], self.count, -1)
        for name, part in self.start_parts.items():
            by_name[name] = starts[..., part] if self.count > 1 else starts[..., 0, part]
        return {p.name: by_name[p.name] for p in self.variation.parameters}


def _admitted(rows: Array) -> Array:
    """Return orthonormal bases of the combinations of numbers that move the starts.

    rows : change of each start by each number, (starts, numbers, components). All numbers are their
    own basis if they are free. The bases are as large as the largest one.
    """
    basis, values, _ = np.linalg.svd(rows, full_matrices=False)
    largest = values.max(axis=-1, keepdims=True, initial=0.0)
    rank = int(np.sum(values > RANK * largest, axis=-1).max())
    numbers = rows.shape[1]
    return np.eye(numbers)[None] if rank == numbers else basis[..., :rank]
