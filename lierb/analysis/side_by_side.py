"""Runs of many experiments in one batch: residuals and derivatives, as triangular factors."""

from __future__ import annotations

from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lierb.analysis.least_squares import triangular
from lierb.analysis.measurements import Measurements
from lierb.analysis.unknowns import Unknowns
from lierb.analysis.varied_runs import Runs
from lierb.errors import ArgumentError, LierbError, MemoryLimitError
from lierb.results.columns import as_array, as_codes
from lierb.results.failures import has_failed
from lierb.results.result import Result
from lierb.runs.variations import Variation, Varied, fixed_directions, item_shape, with_directions
from lierb.support.arrays import Array

State = dict[str, Array]  # arrays by name, [experiment]
Members = NDArray[np.int64]  # indices of experiments
NUMBER, POSE, TWIST = "number ", "pose ", "twist "  # prefixes of names: of fields and links
DERIVED = 20  # differentiated numbers of a link: pose, twist and what may be measured beside them


def part_of(state: State, which: Any) -> State:
    """Return the state of some experiments."""
    return {name: array[which] for name, array in state.items()}


def _by_trajectory(point: State, prefix: str) -> dict[str, Array]:
    """Return the arrays with a prefix, by field or link, [trajectory]."""
    return {
        name.removeprefix(prefix): array.reshape(-1, *array.shape[2:])
        for name, array in point.items()
        if name.startswith(prefix)
    }


class Experiments:
    """Experiments with unknowns of their own, any of which can be run beside each other.

    The point of an experiment is a state of "number …", numbers of the model's fields, "pose …" and
    "twist …", [experiment][trajectory].
    """

    def __init__(self, variation: Variation, data: Measurements, count: int, runs: Runs) -> None:
        """variation : at the guess, of all trajectories.   count : trajectories of each."""
        self.variation, self.data, self.count, self.runs = variation, data, count, runs
        self.model, self.parameters = variation.model, variation.parameters
        self.total = data.count // count
        self.fixed = fixed_directions(variation)
        unknowns = Unknowns(variation, count, experiments=self.total)
        self.size, self.shared, self.follow = unknowns.size, unknowns.shared, unknowns.follow
        self.sizes, self.bases = unknowns.sizes, unknowns.bases  # of the guess
        self.responses, self.residuals = data.responses(count), data.samples(count)
        self.most_steps: int | None = None

    # ---- points --------------------------------------------------------------------------------

    def point_of(self, base: Varied) -> State:
        """Return the points of models and starts of some experiments."""
        state = {}
        for p in self.parameters:
            if not p.is_start:
                shape = item_shape(self.model.inputs[p.fields[0]], p)
                for field in p.own_fields:
                    state[NUMBER + field] = self._grouped(base.model.inputs[field], shape)
        state |= {POSE + k: self._grouped(x, (4, 4)) for k, x in base.poses.items()}
        return state | {TWIST + k: self._grouped(x, (6,)) for k, x in base.twists.items()}

    def at_guess(self) -> State:
        """Return the points of all experiments, with room for what `tried` returns."""
        n, size, shared = self.total, self.size, self.shared
        point = self.point_of(self.variation.base)
        return {
            k: np.broadcast_to(x, (n, *x.shape[1:])).copy() for k, x in point.items()
        } | {
            "factor": np.zeros((n, size + 1, size + 1)), "chi2": np.full(n, np.inf),
            "slope": np.zeros((n, shared, shared)), "sizes": np.ones((n, size)),
            "scales": np.ones((n, size)), "bases": self.bases.copy(),
            "reason": np.full(n, "", dtype=object),
        }  # fmt: skip

    def _grouped(self, array: Array, shape: tuple[int, ...]) -> Array:
        if array.ndim == len(shape):
            array = array[None]
        if len(array) == 1:
            array = np.broadcast_to(array, (self.count, *shape))
        return np.asarray(array.reshape(-1, self.count, *shape))

    def varied(self, members: Members, point: State) -> Varied:
        """Return model and start of some experiments at their points."""
        which = self.trajectories(members)
        is_single = len(which) == 1
        model = self.model
        if (model.batch_size() or 1) > 1:
            model = model.part(int(which[0]) if is_single else which)
        numbers = _by_trajectory(point, NUMBER)
        if is_single:
            numbers = {field: np.array(x[0]) for field, x in numbers.items()}
        model = model.renumbered(numbers) if numbers else model
        return Varied(model, _by_trajectory(point, POSE), _by_trajectory(point, TWIST))

    def trajectories(self, members: Members) -> NDArray[np.int64]:
        """Return the indices of the trajectories of some experiments."""
        return np.asarray((members[:, None] * self.count + np.arange(self.count)).ravel())

    def unknowns(
        self, members: Members, variation: Variation, bases: Array | None = None
    ) -> Unknowns:
        """Return the unknowns of some experiments.

        bases : those by which "factor" differentiates; others may span the same directions.
        """
        unknowns = Unknowns(
            variation, self.count, self.sizes.part(members), len(members), self.follow.part(members)
        )
        if bases is not None:
            unknowns.bases = bases
        return unknowns

    # ---- runs ----------------------------------------------------------------------------------

    def tried(self, members: Members, point: State, steps: Array) -> State:
        """Run experiments at steps from their points; return the state there.

        steps : changes of the coordinates, zero for a guess.

        Returns the point with "factor", R of [J r] by the unknowns, "chi2", infinite if the run
        fails or no body has the numbers, "slope", derivatives of the shared unknowns by their
        coordinates, "bases" of starts, "sizes", "scales" and "reason" of a failure. Raises
        LierbError for a guess.
        """
        try:
            return self._tried(members, point, steps)
        except MemoryLimitError:
            raise
        except LierbError as error:
            if not steps.any():
                raise
            if len(members) == 1:
                reason = np.array([str(error)], dtype=object)
                return point | {"chi2": np.array([np.inf]), "reason": reason}
        half = len(members) // 2  # to find those that cannot be run
        first, second = (
            self.tried(members[part], part_of(point, part), steps[part])
            for part in (slice(half), slice(half, None))
        )
        return {name: np.concatenate([first[name], second[name]]) for name in first}

    def varying(self, members: Members, base: Varied) -> Variation:
        """Return the variation of some experiments from a base, with the guess's directions."""
        parameters = with_directions(self.parameters, self.fixed, self.trajectories(members))
        return Variation(base, parameters, self.variation.t0)

    def _tried(self, members: Members, point: State, steps: Array) -> State:
        variation = self.varying(members, self.varied(members, point))
        if steps.any():
            unknowns = self.unknowns(members, variation, point["bases"])
            moved = variation.at(unknowns.changes(unknowns.base + steps))
            variation = self.varying(members, moved)
        unknowns = self.unknowns(members, variation)
        if unknowns.size != self.size:
            raise ArgumentError("joints or loops admit other motions of the start than the guess")
        result = self._runs(members, not steps.any()).result(
            variation.base, variation.parameters, has_tables=False
        )
        if self.most_steps is None:
            self.most_steps = self.runs.most_steps(result.summary)
        factors, is_whole = self._factors(members, result, unknowns)
        squares = np.sum(factors[..., -1] ** 2, axis=-1)
        if not steps.any():
            most = np.maximum(self.responses[members], np.sqrt(squares))
            unknowns.bound_sizes(factors[..., :-1], most)
            for own, bounded in zip(self.sizes, unknowns.sizes, strict=True):
                own[members] = bounded
        chi2 = np.where(is_whole, squares, np.inf)
        return self.point_of(variation.base) | {
            "factor": factors, "chi2": chi2, "bases": unknowns.bases,
            "slope": unknowns.slope(unknowns.base), "sizes": unknowns.unknown_sizes,
            "scales": unknowns.scales, "reason": self._reasons(result, is_whole),
        }  # fmt: skip

    def _runs(self, members: Members, is_guess: bool) -> Runs:
        """Return the runs with the numbers of their trajectories, which select noise."""
        given, which = self.runs.keywords.get("trajectories"), self.trajectories(members)
        keywords: dict[str, Any] = {
            "trajectories": which if given is None else np.asarray(given)[which]
        }
        if not is_guess and self.most_steps is not None:
            keywords["max_steps"] = self.most_steps
        return self.runs._replace(keywords=self.runs.keywords | keywords)

    def _reasons(self, result: Result, is_whole: NDArray[np.bool_]) -> Array:
        reasons = np.full(len(is_whole), "", dtype=object)
        failed, t = has_failed(result.summary), as_array(result.summary["t"])
        codes, names = as_codes(result.summary["status"])
        for i in np.flatnonzero(~is_whole):
            group = slice(i * self.count, (i + 1) * self.count)
            k = int(failed[group].argmax()) + group.start
            where = f"trajectory {k - group.start} of the experiment" if self.count > 1 else "run"
            reasons[i] = f"the {where} ends as {names[codes[k]]} at t = {t[k]:g} s"
            if names[codes[k]] == "ok":
                reasons[i] = f"the {where} has numbers or derivatives that are not finite"
        return reasons

    # ---- derivatives ---------------------------------------------------------------------------

    def _factors(
        self, members: Members, result: Result, unknowns: Unknowns
    ) -> tuple[Array, NDArray[np.bool_]]:
        """Return R of [J r] by the unknowns, and False for experiments without all residuals."""
        rows = self._rows(members, result, unknowns)
        is_finite = np.isfinite(rows).all((-2, -1)).reshape(-1, self.count)
        if not is_finite.all():
            rows[~is_finite.ravel()] = 0.0
        raw, numbers = triangular(rows), unknowns.number_count
        lead = raw.reshape(len(members), self.count, *raw.shape[1:])
        starts = lead[..., numbers:-1] @ unknowns.bases
        height = raw.shape[-2]
        whole = np.zeros((len(members), self.count * height, self.size + 1))
        for i, part in enumerate(unknowns.start_slices):
            own = whole[:, i * height : (i + 1) * height]
            own[..., : unknowns.shared] = unknowns.follow.by_unknowns(lead[:, i, :, :numbers])
            own[..., part] = starts[:, i]
            own[..., -1] = lead[:, i, :, -1]
        return triangular(whole), np.all(is_finite, axis=-1)

    def _rows(self, members: Members, result: Result, unknowns: Unknowns) -> Array:
        """Return [J r] of each trajectory by its numbers, (n, rows, numbers + 1)."""
        which, parameters = self.trajectories(members), [*unknowns.numbers, *unknowns.starts]
        width = sum(p.size for p in parameters) + 1
        blocks = []
        for column in self.data.columns:
            own = column.part(which)
            off = own.difference(result)
            slope = own.quantity.slope(off)
            rows = np.empty((len(which), *off.shape[::2], width))
            first = 0
            for p in parameters:
                part = rows[..., first : first + p.size]
                own.derivative(result, p, slope, out=part.swapaxes(0, 1))
                first += p.size
            rows[..., -1] = (off / own.sigma).swapaxes(0, 1)
            if not own.present.all():
                rows[~own.present.swapaxes(0, 1)] = 0.0
            blocks.append(rows.reshape(len(which), -1, width))
        return blocks[0] if len(blocks) == 1 else np.concatenate(blocks, axis=1)

    @property
    def bytes_each(self) -> int:
        """Return an estimate of the memory of one experiment in a run with derivatives."""
        directions = sum(p.size for p in self.parameters) + 1
        widths = sum(column.quantity.width for column in self.data.columns)
        numbers = 3 * DERIVED * len(self.model.link_names) + 3 * widths
        return 8 * self.count * len(self.data.t) * directions * numbers

    @property
    def bytes_of_state(self) -> int:
        """Return the memory of what is kept of all experiments."""
        inputs = sum(prod(np.shape(x)) for x in self.variation.base.poses.values())
        return 8 * (self.total * 6 * (self.size + 1) ** 2 + 2 * inputs)
