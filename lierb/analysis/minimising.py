"""Levenberg–Marquardt iterations of many experiments, each with a radius and an end of its own."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from lierb.analysis.identifiability import few_samples
from lierb.analysis.least_squares import Steps, next_radius, steps_of
from lierb.analysis.side_by_side import Experiments, Members, State, part_of
from lierb.support.arrays import Array

FIRST_STEP = 0.3  # length of the first step relative to sizes; later ones may be longer
OFFSET = 1e-6  # of the estimate from the minimum, in standard errors: Bates and Watts's criterion
STILL = 1e-11  # step, relative to sizes, that counts as none
ROUNDING = 1e-12  # change of the residuals, relative to that by unknowns of their sizes
SUM_ROUNDING = 1e-12  # relative, of a sum of squares

RUNNING, CONVERGED, UNCHANGED, STUCK, LIMIT, FAILED, FEW = range(7)
REASONS = {
    CONVERGED: "the estimate is within a millionth of its standard errors of the minimum",
    UNCHANGED: "the estimate changes no more",
    STUCK: "no step decreases the sum of squares: runs nearby fail, or residuals jump",
    LIMIT: "max_iterations is reached; raise it, or begin with a better guess",
    FAILED: "the run of the guess fails",
    FEW: "too few data",
}


class Minimisation:
    """State of the iterations of all experiments, and their ends."""

    def __init__(self, experiments: Experiments, max_iterations: int) -> None:
        self.experiments, self.max_iterations = experiments, max_iterations
        total = experiments.total
        self.state = experiments.at_guess()
        self.codes = np.full(total, RUNNING)
        self.iterations = np.full(total, -1)  # the run of the guess is number 0
        self.radius = np.full(total, FIRST_STEP)
        for i in np.flatnonzero(experiments.residuals < experiments.size):
            self.codes[i], self.iterations[i] = FEW, 0
            self.state["reason"][i] = few_samples(experiments.residuals[i], experiments.size)

    @property
    def converged(self) -> NDArray[np.bool_]:
        """Return True for experiments at a minimum, [experiment]."""
        return np.isin(self.codes, (CONVERGED, UNCHANGED))

    @property
    def reasons(self) -> tuple[str, ...]:
        """Return the reason why each iteration has ended."""
        texts = [REASONS.get(int(code), "") for code in self.codes]
        details = self.state["reason"].tolist()
        return tuple(
            f"{text}: {detail}" if code in (FAILED, FEW) else text
            for text, detail, code in zip(texts, details, self.codes, strict=True)
        )

    def run(self, most: int, report: Callable[[int], None]) -> None:
        """Iterate until all experiments have ended.

        most : number of experiments that run at a time; others take the places of those that end.
            Guesses run without others: they have no step, and no bound on their number of steps.
        report : function of the number of experiments that have ended.
        """
        while (running := np.flatnonzero(self.codes == RUNNING)[:most]).size:
            begun = self.iterations[running] >= 0
            running = running if begun.all() else running[~begun]
            own = part_of(self.state, running)
            steps = steps_of(in_coordinates(own), own["scales"], self.radius[running])
            self.codes[running] = self._ends(running, own, steps)
            going = self.codes[running] == RUNNING
            if going.any():
                self._iterate(running[going], part_of(own, going), steps.part(going))
            report(int(np.count_nonzero(self.codes)))

    def _ends(self, running: Members, own: State, steps: Steps) -> NDArray[np.int64]:
        """Return the codes of experiments at their points."""
        freedoms = np.maximum(self.experiments.residuals[running] - steps.rank, 1)
        deviation = np.sqrt(own["chi2"] / freedoms)
        begun = self.iterations[running] >= 0
        exact = steps.offset <= ROUNDING * steps.response
        converged = (steps.offset <= OFFSET * deviation) | exact
        shortest = np.minimum(steps.length, self.radius[running]) <= STILL
        is_last = self.iterations[running] >= self.max_iterations
        return np.select(
            [~begun, converged, shortest & steps.are_close(deviation), shortest, is_last],
            [RUNNING, CONVERGED, UNCHANGED, STUCK, LIMIT],
            RUNNING,
        )

    def _iterate(self, members: Members, own: State, steps: Steps) -> None:
        """Run experiments at their steps; go there if the sum of squares decreases."""
        trial = self.experiments.tried(members, own, steps.change)
        is_guess = self.iterations[members] < 0
        self.iterations[members] += 1
        with np.errstate(invalid="ignore"):
            decrease = own["chi2"] * (1.0 + SUM_ROUNDING) - trial["chi2"]
        decrease[~np.isfinite(trial["chi2"])] = -np.inf
        better = np.where(is_guess, np.isfinite(trial["chi2"]), decrease > 0.0)
        radius = next_radius(self.radius[members], steps, decrease)
        self.radius[members] = np.where(is_guess, FIRST_STEP, radius)
        for name, array in self.state.items():
            array[members[better]] = trial[name][better]
        failed = is_guess & ~better
        self.codes[members[failed]] = FAILED
        self.state["reason"][members[failed]] = trial["reason"][failed]


def in_coordinates(state: State) -> Array:
    """Return R of [J r] by the coordinates of the unknowns."""
    factors, slope = state["factor"].copy(), state["slope"]
    shared = slope.shape[-1]
    factors[..., :shared] = factors[..., :shared] @ slope
    return factors
