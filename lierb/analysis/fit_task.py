"""Residuals of a fit and their derivatives by its unknowns."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lierb.analysis.identifiability import Identified, identified
from lierb.analysis.least_squares import steps_of, triangular
from lierb.analysis.measurements import Measured, Measurements
from lierb.analysis.unknowns import Sizes, Unknowns
from lierb.analysis.varied_runs import Runs
from lierb.errors import ArgumentError, LierbError
from lierb.results.failures import Failures
from lierb.results.result import Result
from lierb.runs.variations import Variation, Varied
from lierb.support.arrays import Array
from lierb.support.memory import require_memory

DATA_ROUNDING = 1e-11  # relative change of all data together that is rounding
PULL = 1e-6  # weight of the base, relative to the data's, where they do not tell all directions


class Task:
    """Residuals and their derivatives by the coordinates of unknowns."""

    def __init__(
        self, variation: Variation, data: Measurements, runs: Runs, least: Sizes | None = None
    ) -> None:
        """least : least sizes of the numbers; that of one that becomes zero is no guide."""
        self.variation, self.data, self.runs = variation, data, runs
        self.unknowns = Unknowns(variation, data.count, least)
        self.refusal = ""  # why the last point has no run that was asked for in vain

    def varied(self, x: Array) -> Varied:
        return self.variation.at(self.unknowns.changes(x))

    @cached_property
    def at_base(self) -> Result:
        """Return the run of the base, with derivatives. Raises ArgumentError if it fails."""
        result = self.runs.result(self.variation.base, self.variation.parameters)
        if failures := Failures.of(result.summary):
            raise ArgumentError(f"the run of the guess fails, {failures}; give a better guess")
        if not np.isfinite(self.weighted(result)).all():
            ends = result.summary.to_pylist()
            early = [
                f"; an event ends it at t = {x['t']:g} s" for x in ends if x["status"] == "event"
            ]
            raise ArgumentError(
                "the run of the guess is not finite at all times of the data"
                f"{''.join(early[:1])}; give a better guess"
            )
        return result

    @cached_property
    def trials(self) -> Runs:
        """Return runs that end at MOST_STEPS times the steps of the base, if steps are adaptive."""
        most = self.runs.most_steps(self.at_base.summary)
        if most is None:
            return self.runs
        return self.runs._replace(keywords=self.runs.keywords | {"max_steps": most})

    @cached_property
    def slope(self) -> Array:
        """Return the derivatives of the weighted residuals by the unknowns at the base.

        Raises ArgumentError if they are not finite.
        """
        slope = self.by_unknowns(self.at_base, self.unknowns.changes(self.unknowns.base))
        if (lost := np.flatnonzero(~np.isfinite(slope).all(axis=0))).size:
            first, unknowns = int(lost[0]), self.unknowns
            is_shared = first < unknowns.shared
            label = unknowns.labels[unknowns.follow.free[first]] if is_shared else "the start"
            raise ArgumentError(
                f"derivatives of the run of the guess by {label} are not finite: a force or "
                "function has none at its start or along its motion"
            )
        return slope

    @cached_property
    def told(self) -> Identified:
        """Return the unknowns at the base as far as data tell them."""
        (norm,) = self.data.norms(self.data.count)
        least = DATA_ROUNDING * float(norm)
        return identified(self.slope, self.unknowns.unknown_sizes, least)

    @property
    def chi2(self) -> float:
        """Return the sum of squares at the base."""
        weighted = self.weighted(self.at_base)
        return float(weighted @ weighted)

    def is_better_than(self, other: Task) -> bool:
        """Return whether the base fits the data as well as another one, or better.

        A start that is closed and projected again may differ, and its run may fail.
        """
        try:
            return self.chi2 <= other.chi2
        except LierbError:
            return False

    def is_minimum(self, free: NDArray[np.bool_]) -> bool:
        """Return whether no step from the base decreases the sum of squares beyond rounding.

        free : False for unknowns at their bounds.
        """
        rows = np.column_stack([self.slope[:, free], self.weighted(self.at_base)])
        steps = steps_of(
            triangular(rows)[None], self.unknowns.unknown_sizes[None, free], np.array([np.inf])
        )
        freedoms = max(len(rows) - self.told.rank, 1)
        return bool(steps.are_close(np.sqrt([self.chi2 / freedoms])).all())

    @cached_property
    def pull(self) -> Array:
        """Return weights of residuals that keep the coordinates near the base; empty without.

        The data must not tell all directions: the others would be free to go anywhere. A task that
        begins at the result removes the bias, of PULL² over the square of a singular value.
        """
        if not len(self.told.null):
            return np.zeros(0)
        unknowns = self.unknowns
        jacobian, scales = self._by_coordinates(self.at_base, unknowns.base), unknowns.scales
        norms = np.linalg.norm(jacobian * scales, axis=0)
        return PULL * np.where(norms > 0.0, norms, norms.max() or 1.0) / scales

    def residuals(self, x: Array) -> Array:
        """Return the weighted residuals; infinite if no body has the numbers, or the run fails."""
        try:
            at_base = np.array_equal(x, self.unknowns.base)
            result = self.at_base if at_base else self.trials.result(self.varied(x))
            residuals = self.weighted(result)
        except LierbError as error:
            self.refusal = str(error)
            residuals = np.full(self.data.size, np.inf)
        residuals = np.where(np.isfinite(residuals), residuals, np.inf)
        if not len(self.pull):
            return residuals
        return np.concatenate([residuals, self.pull * (x - self.unknowns.base)])

    def weighted(self, result: Result) -> Array:
        parts = [
            (off / column.sigma)[column.present]
            for column, off in zip(self.data.columns, self.differences(result), strict=True)
        ]
        return np.concatenate(parts)

    def differences(self, result: Result) -> list[Array]:
        """Return run minus data of each column, (times, n, width); NaN without a sample."""
        return [column.difference(result) for column in self.data.columns]

    def jacobian(self, x: Array) -> Array:
        """Return the derivatives of the weighted residuals by the coordinates."""
        at_base = np.array_equal(x, self.unknowns.base)
        parameters = self.variation.parameters
        result = self.at_base if at_base else self.runs.result(self.varied(x), parameters)
        jacobian = self._by_coordinates(result, x)
        return np.concatenate([jacobian, np.diag(self.pull)]) if len(self.pull) else jacobian

    def _by_coordinates(self, result: Result, x: Array) -> Array:
        shared, jacobian = self.unknowns.shared, self.by_unknowns(result, self.unknowns.changes(x))
        jacobian[:, :shared] = jacobian[:, :shared] @ self.unknowns.slope(x)
        return jacobian

    def by_unknowns(self, result: Result, changes: Mapping[str, Array]) -> Array:
        """Return the derivatives of the weighted residuals by the unknowns."""
        size = self.unknowns.size
        require_memory(3 * 8 * self.data.size * size, "the Jacobian", "fit fewer trajectories")
        jacobian, first = np.zeros((self.data.size, size)), 0
        for column, off in zip(self.data.columns, self.differences(result), strict=True):
            count = int(column.present.sum())
            self._fill(jacobian[first : first + count], column, off, result, changes)
            first += count
        return jacobian

    def _fill(
        self,
        rows: Array,
        column: Measured,
        off: Array,
        result: Result,
        changes: Mapping[str, Array],
    ) -> None:
        """Fill in the rows of one column of the data."""
        unknowns, starts = self.unknowns, []
        numbers = np.zeros((len(rows), unknowns.number_count))
        slope = column.quantity.slope(off)
        for p in self.variation.parameters:
            own = column.derivative(result, p, slope)
            if p.is_start:
                turned = unknowns.turned(changes, p)
                starts.append(own if turned is None else own @ turned)
            else:
                numbers[:, unknowns.slices[p.name]] = own[column.present]
        rows[:, : unknowns.shared] = unknowns.follow.by_unknowns(numbers)
        if not starts:
            return
        moved = np.concatenate(starts, -1)
        places = np.cumsum(column.present).reshape(column.present.shape)
        pairs = zip(unknowns.bases, unknowns.start_slices, strict=True)
        for i, (basis, part) in enumerate(pairs):
            chosen = column.present[:, i]
            rows[places[:, i][chosen] - 1, part] = moved[:, i][chosen] @ basis
