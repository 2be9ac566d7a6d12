"""Result of a fit: estimate, covariance, what the data cannot tell, and the run at the estimate."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lierb.analysis.identifiability import Direction
from lierb.errors import unknown_name
from lierb.lie import so3
from lierb.model.mechanism.mechanism import Mechanism
from lierb.model.problem import Problem
from lierb.results.result import Result
from lierb.support.arrays import Array
from lierb.support.extras import require
from lierb.support.representations import FAILED, Lines, Represented, counted

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MOST_LISTED = 40  # lines of numbers in a description
HELD = ", held"  # by joints or loops: a number that cannot change
ROUNDED = 12  # decimals of printed poses, whose zeros are rounding errors
# Least chi2 per freedom f that counts as a misfit, and its least excess over 1, in standard
# deviations √(2/f) of chi2/f: noise does not reach it, and a sigma rough by a third neither.
MISFIT, DEVIATIONS = 2.0, 5.0


class Estimates(Represented):
    """Estimates with lines for their numbers in their description."""

    estimate: dict[str, Array]
    labels: tuple[str, ...]

    @property
    def parameters(self) -> tuple[str, ...]:
        """Return the names of the parameters."""
        return tuple(self.estimate)

    def _lines(self, name: str, labels: list[str]) -> Iterator[tuple[str, str]]:
        """Yield the lines of a parameter.   labels : of its numbers."""
        raise NotImplementedError

    def _numbers(self) -> Iterator[tuple[str, str]]:
        """Yield the first lines of numbers, and how many there are beyond."""
        lines: list[tuple[str, str]] = []
        for name in self.estimate:
            lines += self._lines(name, [x for x in self.labels if x.partition("[")[0] == name])
        yield from lines[:MOST_LISTED]
        if len(lines) > MOST_LISTED:
            yield "…", counted(len(lines) - MOST_LISTED, "more line")


@dataclass(frozen=True, repr=False, eq=False)
class Fit(Estimates):
    """Estimate of parameters by `lierb.fit`, with its uncertainty.

    The covariance is that of linear theory for Gaussian noise: it holds near the estimate, and for
    residuals that are noise. `lierb.propagate` shows how far it holds for a motion.

    Attributes
    ----------
    estimate : dict of ndarray
        Numbers of each parameter, by name; those of a start are (6,) or (3,), a pose (4, 4), with
        an axis (n, …) for several trajectories.
    standard_errors : dict of ndarray
        Standard deviation of each number, likewise; of a pose (6,), of ε in C exp ε. Infinite for
        numbers that the data do not tell, 0 for those that joints or loops hold.
    covariance : ndarray, shape (p, p)
        Covariance of all numbers, in the order of `labels`, of the directions that the data tell.
    labels : tuple of str
        Name of each number, such as "body.inertia[12]", or "omega0[3][0]" for trajectory 3.
    unidentifiable : tuple of Direction
        Combinations of numbers that the data cannot tell, each with `changes` and a `sentence`.
    held : tuple of Direction
        Combinations of the model's numbers that stay as they are, likewise, because the loops do
        not close otherwise, or cannot move: the pin of a planar loop stays in its plane.
    problem : Problem or Mechanism
        The problem with the estimated numbers.
    start : dict
        Keywords pose0, twist0 and t0 of `lierb.integrate`, with the estimated start.
    result : Result
        The run at the estimate, at the times `t`, with its derivatives.
    t : ndarray, shape (times,)
        Times of the data, s.
    residuals : dict of ndarray, shape (times, n, width)
        Run minus data, by column, SI units; NaN for a missing sample.
    units : dict of str
        Unit of the residuals, by column.
    has_sigma : bool
        True if the fit was given `sigma`.
    chi2 : float
        Sum of the squares of all residuals, each divided by its `sigma` if there is one.
    freedoms : int
        Number of residuals minus number of directions that the data tell.
    converged : bool
        True if the estimate is a minimum: no small step decreases chi2 beyond rounding.
    status : str
        Reason why the iteration has ended, then the numbers that bounds stop, such as
        "body.mass is at its upper bound". Standard errors do not hold there.
    evaluations : int
        Number of runs without derivatives.
    """

    estimate: dict[str, Array]
    standard_errors: dict[str, Array]
    covariance: Array
    labels: tuple[str, ...]
    unidentifiable: tuple[Direction, ...]
    held: tuple[Direction, ...]
    problem: Problem | Mechanism
    start: dict[str, Any]
    result: Result
    t: Array
    residuals: dict[str, Array]
    units: dict[str, str]
    has_sigma: bool
    chi2: float
    freedoms: int
    converged: bool
    status: str
    evaluations: int
    _at_bounds: Mapping[str, str] = field(default_factory=dict, repr=False, compare=False)

    @property
    def reduced_chi2(self) -> float:
        """Return chi2 over `freedoms`, about 1 for noise of the given sigma; NaN without any."""
        return self.chi2 / self.freedoms if self.freedoms > 0 else np.nan

    @property
    def misfit(self) -> str:
        """Return a sentence if noise of the given sigma cannot explain chi2; empty otherwise.

        Without sigma nothing is known of the noise.
        """
        reduced = self.reduced_chi2
        if not (self.has_sigma and is_misfit(reduced, self.freedoms)):
            return ""
        bounded = "".join(
            f"{label} is at its {side} bound, which may be wrong.\n"
            for label, side in self._at_bounds.items()
        )
        return (
            f"the model does not explain the data: residuals are {np.sqrt(reduced):.3g} times "
            f"their sigma.\n{bounded}A force may be missing, a fixed number wrong, the minimum a "
            "local one, or sigma too small."
        )

    def covariance_of(self, *names: str) -> Array:
        """Return the covariance of some of the numbers, a block of `covariance`.

        Parameters
        ----------
        *names : str
            Names of parameters, or of single numbers as in `labels`, in the order of the block.

        Returns
        -------
        ndarray, shape (k, k)
            Covariance, in SI units.

        Raises
        ------
        UnknownNameError
            A name is neither a parameter's nor a label.

        Examples
        --------
        >>> import numpy as np
        >>> import lierb
        >>> flight = lierb.Problem(lierb.bodies.sphere(0.1, mass=1.0), lierb.joints.free())
        >>> data = {"t": [0.0, 1.0], "omega": [[0.0, 0.0, 1.0], [0.0, 0.0, 1.1]]}
        >>> run = {"twist0": np.eye(6)[2], "dt": 0.1, "sigma": {"omega": 0.1}}
        >>> fit = lierb.fit(flight, data, "omega0", **run)
        >>> fit.covariance_of("omega0[2]").round(4).tolist()
        [[0.005]]
        """
        chosen = []
        for name in names:
            own = [i for i, x in enumerate(self.labels) if name in (x, x.partition("[")[0])]
            if not own:
                raise unknown_name("name", name, (*self.estimate, *self.labels))
            chosen += own
        return self.covariance[np.ix_(chosen, chosen)]

    @property
    def correlation(self) -> Array:
        """Return the correlations of all numbers, (p, p); NaN for numbers without variance."""
        deviations = np.sqrt(np.diag(self.covariance))
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(self.covariance / np.outer(deviations, deviations))

    def plot(self) -> Figure:
        """Draw the residuals over time and the correlations; needs `lierb[plot]`.

        Correlations are drawn for 2 to 30 numbers.

        Returns
        -------
        matplotlib.figure.Figure
            The figure.

        Raises
        ------
        MissingExtraError
            Matplotlib is not installed.

        Examples
        --------
        >>> import numpy as np
        >>> import lierb
        >>> flight = lierb.Problem(lierb.bodies.sphere(0.1, mass=1.0), lierb.joints.free())
        >>> data = {"t": [0.0, 1.0], "omega": [[0.0, 0.0, 1.0], [0.0, 0.0, 1.1]]}
        >>> fit = lierb.fit(flight, data, "omega0", twist0=np.eye(6)[2], dt=0.1)
        >>> [panel.get_title(loc="left") for panel in fit.plot().axes[:2]]
        ['omega, run minus data [rad/s]', 'correlations of the estimate']
        """
        require("plot")
        from lierb.analysis.estimate_figures import fit_figure

        return fit_figure(self.t, self.residuals, self.units, self.labels, self.correlation)

    def _representation(self) -> tuple[str, Lines]:
        count = sum(int(np.isfinite(each).sum()) for each in self.residuals.values())
        names = counted(len(self.labels), "number")
        title = f"lierb.Fit: {names} from {counted(count, 'residual')}"
        rows = [*self._numbers()]
        rows.append(
            ("chi2", f"{self.chi2:.6g}, {self.reduced_chi2:.4g} per freedom of {self.freedoms}")
        )
        if self.unidentifiable:
            rows.append(("not told", "\n".join(map(str, self.unidentifiable))))
        if self.held:
            rows.append(("held", "\n".join(map(str, self.held))))
        if self.misfit:
            rows.append(("misfit", self.misfit))
        rows.append(("ended" if self.converged else FAILED, self.status))
        return title, rows

    def _lines(self, name: str, labels: list[str]) -> Iterator[tuple[str, str]]:
        deviations = self.standard_errors[name].ravel()
        spreads = [self._spread(*each) for each in zip(labels, deviations, strict=True)]
        if name.endswith("pose0"):
            yield from lines_of_poses(self.estimate[name], labels, spreads)
            return
        for label, value, spread in zip(labels, self.estimate[name].ravel(), spreads, strict=True):
            yield label, f"{value:.7g}{spread}"

    def _spread(self, label: str, deviation: float) -> str:
        """Return the uncertainty of a number as text."""
        if deviation == 0.0 and (self.has_sigma or self.chi2 > 0.0):
            return HELD
        if label in self._at_bounds:
            return f", at its {self._at_bounds[label]} bound"
        return f" ± {deviation:.2g}"


def lines_of_poses(
    poses: Array, labels: Sequence[str], spreads: Sequence[str], what: str = ""
) -> Iterator[tuple[str, str]]:
    """Yield a line for each pose C, followed by those of the numbers of ε in C exp ε."""
    for i, pose in enumerate(poses.reshape(-1, 4, 4)):
        own = slice(6 * i, 6 * i + 6)
        turned, place = (_listed(x) for x in (so3.log(pose[:3, :3]), pose[:3, 3]))
        text = f"{what}rotation vector {turned} rad, position {place} m; ε of C exp ε:"
        yield labels[own][0].rpartition("[")[0], text
        yield from zip(labels[own], (f"ε{spread}" for spread in spreads[own]), strict=True)


def _listed(numbers: Array) -> str:
    return f"({', '.join(f'{x:.7g}' for x in np.round(numbers, ROUNDED) + 0.0)})"


def is_misfit(reduced: Any, freedoms: Any) -> NDArray[np.bool_]:
    """Return True where noise of the given sigma cannot explain chi2 per freedom."""
    with np.errstate(divide="ignore"):
        most = np.maximum(MISFIT, 1.0 + DEVIATIONS * np.sqrt(2.0 / np.asarray(freedoms, float)))
    return np.asarray(reduced > most)
