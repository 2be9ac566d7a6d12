"""Result of many fits side by side: estimates, covariances, and their scatter."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from lierb.analysis.fit_result import HELD, Estimates, is_misfit, lines_of_poses
from lierb.analysis.identifiability import Direction
from lierb.lie import se3
from lierb.model.mechanism.mechanism import Mechanism
from lierb.model.problem import Problem
from lierb.results.columns import numbers, texts, vectors
from lierb.support.arrays import Array
from lierb.support.representations import FAILED, Lines, counted


@dataclass(frozen=True, repr=False, eq=False)
class Fits(Estimates):
    """Estimates of many experiments by `lierb.fits`, with their uncertainties.

    Arrays have an axis of fits, (n, …). An axis of trajectories, (n, m, …), follows for starts of
    experiments of several trajectories. The estimate of a fit whose first run fails, or that has
    fewer samples than unknowns, is NaN; one that has not converged is the last point of its
    iteration: take those of `converged`.

    Attributes
    ----------
    estimate : dict of ndarray
        Numbers of each parameter, by name, (n, k); those of a start are (n, 6) or (n, 3), a pose
        (n, 4, 4).
    standard_errors : dict of ndarray
        Standard deviation of each number, likewise; of a pose (n, 6), of ε in C exp ε. Infinite
        for numbers that the data of this experiment do not tell, 0 for those that joints or loops
        hold.
    covariance : ndarray, shape (n, p, p)
        Covariance of all numbers, in the order of `labels`, of the directions that the data tell.
    labels : tuple of str
        Name of each number, such as "body.inertia[12]", or "omega0[3][0]" for trajectory 3.
    has_sigma : bool
        True if the fits were given `sigma`.
    chi2 : ndarray, shape (n,)
        Sum of the squares of all residuals, each divided by its `sigma` if there is one.
    freedoms : ndarray, shape (n,)
        Number of residuals minus number of directions that the data tell.
    converged : ndarray, shape (n,)
        True for estimates that are minima, to the tolerance.
    status : tuple of str
        Reason why each iteration has ended.
    iterations : ndarray, shape (n,)
        Number of runs after that of the guess.
    not_told : ndarray, shape (n,)
        Number of directions that the data of each experiment do not tell.
    unidentifiable : tuple of Direction
        These directions of the first such experiment, each with `changes` and a `sentence`.
    held : tuple of Direction
        Combinations of the model's numbers that loops hold, as in `Fit`, of the first experiment.
    problem : Problem or Mechanism
        The problem with the estimated numbers of all trajectories, experiment by experiment.
    start : dict
        Keywords pose0, twist0 and t0 of `lierb.integrate`, with the estimated starts.
    units : dict of str
        Units by parameter.
    """

    estimate: dict[str, Array]
    standard_errors: dict[str, Array]
    covariance: Array
    labels: tuple[str, ...]
    has_sigma: bool
    chi2: Array
    freedoms: NDArray[np.int64]
    converged: NDArray[np.bool_]
    status: tuple[str, ...]
    iterations: NDArray[np.int64]
    not_told: NDArray[np.int64]
    unidentifiable: tuple[Direction, ...]
    held: tuple[Direction, ...]
    problem: Problem | Mechanism
    start: dict[str, Any]
    units: dict[str, str]

    @property
    def reduced_chi2(self) -> Array:
        """Return chi2 over `freedoms`, (n,), about 1 for noise of the given sigma."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(self.freedoms > 0, self.chi2 / self.freedoms, np.nan)

    @property
    def misfit(self) -> NDArray[np.bool_]:
        """Return True for fits, (n,), whose chi2 noise of the given sigma cannot explain.

        The minimum is then a local one, the model is wrong, or sigma is too small. Without sigma
        nothing is known of the noise.
        """
        return self.has_sigma & is_misfit(self.reduced_chi2, self.freedoms)

    @property
    def scatter(self) -> dict[str, Array]:
        """Return the standard deviations of the estimates over all converged fits, by name.

        Deviations of a pose are log(C₀⁻¹C), with the first converged fit's C₀.
        """
        return {name: _spread(each) for name, each in self._deviations.items()}

    @property
    def ratio(self) -> dict[str, Array]:
        """Return the standard deviation of (estimate − mean)/standard error, by name.

        It is about 1 if all experiments measure the same numbers and linear theory holds, but for
        a pose that points of its joint move, which are estimated too. It is NaN for numbers that
        joints or loops hold.
        """
        ratios = {}
        for name, each in self._deviations.items():
            errors = self.standard_errors[name][self.converged]
            ratios[name] = _spread(each / np.where(errors > 0.0, errors, np.nan))
        return ratios

    @property
    def table(self) -> pa.Table:
        """Return a table with a row for each fit.

        Columns are "fit", "converged", "status", "chi2", "freedoms", "misfit", "iterations",
        "not_told" and two for each parameter: its name, and with ".error" the standard errors.
        Metadata have the units.
        """
        n = len(self.chi2)
        columns = {
            "fit": numbers(np.arange(n)), "converged": pa.array(self.converged),
            "status": texts(self.status), "chi2": numbers(self.chi2),
            "freedoms": numbers(self.freedoms), "misfit": pa.array(self.misfit),
            "iterations": numbers(self.iterations), "not_told": numbers(self.not_told),
        }  # fmt: skip
        fields = [pa.field(name, column.type) for name, column in columns.items()]
        for name in self.estimate:
            for label, values in (
                (name, self.estimate[name]), (f"{name}.error", self.standard_errors[name])
            ):  # fmt: skip
                flat = values.reshape(n, -1)
                columns[label] = numbers(flat) if flat.shape[1] == 1 else vectors(flat)
                unit = {b"unit": self.units[name]}
                fields.append(pa.field(label, columns[label].type, metadata=unit))
        return pa.Table.from_arrays(list(columns.values()), schema=pa.schema(fields))

    @cached_property
    def _deviations(self) -> dict[str, Array]:
        """Deviations of the converged fits from their mean, by name."""
        deviations = {}
        for name, each in self.estimate.items():
            values = each[self.converged]
            if name.endswith("pose0") and len(values):
                values = se3.log(se3.inverse(values[:1]) @ values)
            deviations[name] = values - values.mean(axis=0) if len(values) else values
        return deviations

    # ---- description ---------------------------------------------------------------------------

    def _representation(self) -> tuple[str, Lines]:
        n, good = len(self.chi2), int(self.converged.sum())
        title = f"lierb.Fits: {counted(n, 'fit')} of {counted(len(self.labels), 'number')}"
        rows = [("converged", f"{good} of {n}")]
        if good < n:
            i = int(np.argmin(self.converged))
            rows.append((FAILED, f"{n - good} of {n}, the first is fit {i}: {self.status[i]}"))
        if good:
            mean = np.mean(self.reduced_chi2[self.converged])
            rows.append(("chi2", f"{mean:.4g} per freedom, the mean of all that have converged"))
        if len(some := np.flatnonzero(self.misfit)):
            text = "whose residuals the noise does not explain: a local minimum, or a wrong model"
            rows.append(("misfit", f"{counted(len(some), 'fit')}, the first is {some[0]}, {text}"))
        if len(some := np.flatnonzero(self.not_told)):
            first = "; ".join(each.sentence for each in self.unidentifiable)
            rows.append(("not told", f"in {counted(len(some), 'fit')}, in fit {some[0]}: {first}"))
        if self.held:
            rows.append(("held", "\n".join(map(str, self.held))))
        return title, [*rows, *(self._numbers() if good else ())]

    def _lines(self, name: str, labels: list[str]) -> Iterator[tuple[str, str]]:
        ratios, scatter = (np.ravel(each[name]) for each in (self.ratio, self.scatter))
        values, errors = (x[name][self.converged] for x in (self.estimate, self.standard_errors))
        noisy = self.has_sigma | (self.chi2[self.converged] > 0.0)
        is_held = np.ravel(np.all(errors[noisy] == 0.0, axis=0)) & noisy.any()
        spreads = [
            HELD if held else f", scatter {deviation:.2g}, {ratio:.3g} standard errors"
            for held, deviation, ratio in zip(is_held, scatter, ratios, strict=True)
        ]
        if name.endswith("pose0"):
            yield from lines_of_poses(_mean_pose(values), labels, spreads, "mean ")
            return
        for label, mean, spread in zip(labels, values.mean(axis=0).ravel(), spreads, strict=True):
            yield label, f"mean {mean:.6g}{spread}"


def _mean_pose(poses: Array) -> Array:
    """Return the mean of poses (n, …, 4, 4), by logarithms from the first one."""
    first = poses[:1]
    return np.asarray(first @ se3.exp(se3.log(se3.inverse(first) @ poses).mean(axis=0)))


def _spread(deviations: Array) -> Array:
    """Return the standard deviation of deviations from a mean; NaN of less than two."""
    if len(deviations) < 2:
        return np.full(deviations.shape[1:], np.nan)
    return np.asarray(np.sqrt(np.sum(deviations**2, axis=0) / (len(deviations) - 1)))
