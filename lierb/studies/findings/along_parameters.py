"""Sampled numbers x of a study along the parameters p of its derivatives: ∂g/∂x = ∂g/∂p · ∂p/∂x.

A sampled number may change several inputs of a run, such as the radius of a solid, or the start
alone, such as the rate of a joint. Its changes of all inputs, by central differences of how they
are made, are written as a sum of the directions along which the run was differentiated.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cached_property

import numpy as np

from lierb.errors import LierbError
from lierb.kernels.mechanics.passive_elements import TurnCounter
from lierb.kernels.systems.layout import POSE
from lierb.runs.parameters import all_directions, parameters_by_name
from lierb.runs.start_directions import Start
from lierb.runs.variations import Varied, with_start
from lierb.studies.description.batches import batch_at
from lierb.studies.description.differentiated import KEY, names_of, parameters_of
from lierb.studies.description.study import Study
from lierb.support.arrays import Array

STEP = 1e-4  # of the differences, standard deviations
RANK = 1e-10  # relative size of singular values that count as zero
NEGLIGIBLE = 1e-6  # change by a standard deviation, relative to the largest number of the field
COORDINATES = "initial.coordinates"
AXES = "axes"  # of a frame, by which nothing is differentiated

Fields = dict[str, Array]  # by field of the inputs, (n, numbers, …)


class AlongParameters:
    """Derivatives of parameters by the sampled numbers of some bodies.

    draws : of all quantities, (n, …).   deviations : standard deviations, (components,) of each.
    """

    def __init__(
        self, study: Study, draws: Mapping[str, Array], deviations: Mapping[str, Array]
    ) -> None:
        self.study, self.draws, self.deviations = study, draws, deviations
        self.count = len(next(iter(draws.values())))
        self.base = base = self._made({})
        self.parameters = parameters_of(study, base.model)
        start = Start(base.model, base.poses, base.twists, study.integrate.t0)
        with np.errstate(all="ignore"):
            each = all_directions(self.parameters.values(), start)
        widths = {f: array.shape[-1] for direction in each for f, array in direction.items()}
        self.directions: Fields = {
            field: np.stack(
                [np.broadcast_to(d.get(field, 0.0), (self.count, width)) for d in each], axis=-1
            )
            for field, width in widths.items()
        }

    def along(self, quantity: str) -> Array | str:
        """Return ∂p/∂x, (n, numbers of p, components of x), or the reason why there is none."""
        deviation = self.deviations[quantity]
        if self.draws[quantity].ndim > 2:
            return "lierb has no derivative by the entries of a matrix"
        try:
            change = self._change(quantity)
        except LierbError as error:
            return f"a small change of it is refused: {error}"
        parts = [
            self._scales[field] * change.get(field, np.zeros((*d.shape[:2], len(deviation))))
            for field, d in self.directions.items()
        ]
        weights = self._inverse @ np.concatenate(parts, axis=1)
        if fields := [*self._unexplained(change, weights)]:
            return self._remedy(fields, quantity)
        return np.asarray(weights / np.where(deviation > 0.0, deviation, 1.0))

    def _made(self, changed: Mapping[str, Array]) -> Varied:
        batch = batch_at(self.study, {**self.draws, **changed}, 0, self.count)
        return with_start(batch.problem, batch.pose0, batch.twist0)

    def _change(self, quantity: str) -> Fields:
        """Return the changes of all inputs by a standard deviation of each component."""
        draws, change = self.draws[quantity], Fields()
        ignored = self._counted if quantity.endswith(COORDINATES) else set[str]()
        steps = STEP * np.diag(self.deviations[quantity])
        for component, step in enumerate(steps):
            by = step.reshape(draws.shape[1:])
            up, down = (_inputs_of(self._made({quantity: draws + s * by})) for s in (1.0, -1.0))
            for field in up:
                if field not in ignored and np.any(up[field] != down[field]):
                    off = _numbers(up[field] - down[field]) / (2.0 * STEP)
                    own = change.setdefault(field, np.zeros((*off.shape, len(steps))))
                    own[..., component] = off
        return change

    @cached_property
    def _counted(self) -> set[str]:
        """Fields of the starts of counted angles, which take whole turns alone from coordinates."""
        elements = zip(self.base.model.element_fields, self.base.model.elements, strict=True)
        return {f"{field}start" for field, each in elements if isinstance(each.kind, TurnCounter)}

    @cached_property
    def _scales(self) -> dict[str, float]:
        """Return a factor of each field, by which its largest direction is 1."""
        return {f: 1.0 / (np.abs(d).max() or 1.0) for f, d in self.directions.items()}

    @cached_property
    def _inverse(self) -> Array:
        """Return the pseudoinverse of all directions, (n, directions, numbers).

        Directions of a start may depend on each other; along any of their sums the run has one
        derivative. Those that the joints do not admit are rounding.
        """
        parts = [self._scales[f] * d for f, d in self.directions.items()]
        inverse: Array = np.linalg.pinv(np.concatenate(parts, axis=1), rcond=RANK)
        return inverse

    def _unexplained(self, change: Fields, weights: Array) -> Iterator[str]:
        """Yield the fields whose changes are no sum of the directions; AXES for a frame's axes."""
        inputs = _inputs_of(self.base)
        for field, own in change.items():
            along = self.directions.get(field)
            off = np.abs(own if along is None else own - along @ weights)
            least = NEGLIGIBLE * np.abs(inputs[field]).max()
            if field.endswith("_frame") and off[:, :9].max() > least:
                yield AXES
            elif off.max() > least:
                yield field

    def _remedy(self, fields: list[str], quantity: str) -> str:
        """Return the message for fields that are not differentiated.

        Of several names of a field, such as those of a joint's points, it has that of the quantity.
        """
        model = self.base.model
        by_name = parameters_by_name(model)
        names = names_of(self.study, model)
        ordered = sorted(names.items(), key=lambda pair: pair[0] == quantity)
        owners = {
            field: name
            for name, own in ordered
            if not by_name[own].is_start
            for field in by_name[own].own_fields
        }
        for field, link in zip(model.fields, model.link_names, strict=True):
            prefix = f"{link}." if link else ""
            owners |= {f"{field}{x}": f"{prefix}{x}0" for x in ("pose", "twist")}
        changed = dict.fromkeys(owners.get(field, AXES) for field in fields)
        lacking = [name for name in changed if name not in self.parameters]
        if AXES in lacking or not lacking:
            return "lierb has no derivative by what it changes"
        return f"{KEY} lacks what it changes, {', '.join(lacking)}"


def _inputs_of(varied: Varied) -> Fields:
    """Return all inputs of a run, model and start."""
    inputs = dict(varied.model.inputs)
    for field, link in zip(varied.model.fields, varied.model.link_names, strict=True):
        inputs |= {f"{field}pose": varied.poses[link], f"{field}twist": varied.twists[link]}
    return inputs


def _numbers(array: Array) -> Array:
    """Return the numbers of a field of all bodies, (n, numbers)."""
    flat = array.reshape(len(array), -1)
    return flat[:, POSE] if array.shape[-2:] == (4, 4) else flat
