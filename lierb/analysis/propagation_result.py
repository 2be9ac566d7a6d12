"""Result of `lierb.propagate`: covariances by linear theory and of a Monte Carlo sample."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lierb.errors import require_name
from lierb.support.arrays import Array
from lierb.support.extras import require
from lierb.support.representations import Lines, Represented, counted

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MOST_LISTED = 12  # times in the table of a description


@dataclass(frozen=True, repr=False, eq=False)
class Propagation(Represented):
    """Covariances of quantities over time, by linear theory and of a sample of runs.

    Arrays are in dictionaries by quantity. Deviations of rotations and poses are in body axes,
    log(R₀ᵀR) in rad and log(C₀⁻¹C) in rad and m; w is 3 and 6 for them.

    Attributes
    ----------
    t : ndarray, shape (times,)
        Times, s.
    linear : dict of ndarray, shape (times, w, w)
        Covariance J Σ Jᵀ about the nominal run, with the exact derivatives J of the run.
    sample : dict of ndarray, shape (times, w, w)
        Covariance of the sample about its mean, that of a rotation or pose on the group.
    shift : dict of ndarray, shape (times, w)
        Mean of the sample minus nominal run. Linear theory has 0.
    ratio : dict of ndarray, shape (times, w)
        Standard deviations of the sample over those of linear theory; NaN for 0/0.
    holds : dict of ndarray, shape (times,)
        True where linear theory holds: each ratio differs from 1, and each shift from 0 in
        standard deviations, by less than a tenth and three standard errors of the sample.
    size : int
        Number of runs in the sample, without those that failed.
    failed : int
        Number of runs that failed.
    """

    t: Array
    linear: dict[str, Array]
    sample: dict[str, Array]
    shift: dict[str, Array]
    ratio: dict[str, Array]
    holds: dict[str, NDArray[np.bool_]]
    units: dict[str, str]
    size: int
    failed: int

    def standard_deviations(self, of: str, how: str = "linear") -> Array:
        """Return the standard deviations of a quantity, (times, w).

        Parameters
        ----------
        of : str
            Name of the quantity.
        how : {"linear", "sample"}, optional
            Linear theory or the sample.

        Returns
        -------
        ndarray, shape (times, w)
            Standard deviations, SI units.
        """
        require_name("how", how, ("linear", "sample"))
        covariances = getattr(self, how)
        require_name("of", of, covariances)
        return deviations_of(covariances[of])

    def holds_until(self, of: str) -> float:
        """Return the last time up to which linear theory holds, s; NaN if it never does.

        Parameters
        ----------
        of : str
            Name of the quantity.

        Returns
        -------
        float
            The last of the times before the first at which it does not hold.
        """
        require_name("of", of, self.holds)
        fails = np.flatnonzero(~self.holds[of])
        last = len(self.t) - 1 if not len(fails) else int(fails[0]) - 1
        return float(self.t[last]) if last >= 0 else np.nan

    def plot(self, quantities: str | Iterable[str] = ()) -> Figure:
        """Draw standard deviations over time, linear and of the sample; needs `lierb[plot]`.

        Parameters
        ----------
        quantities : str or iterable of str, optional
            Names of quantities, one for each panel. Default: all.

        Returns
        -------
        matplotlib.figure.Figure
            The figure.

        Raises
        ------
        UnknownNameError
            A quantity was not propagated.
        MissingExtraError
            Matplotlib is not installed.

        Examples
        --------
        >>> import lierb
        >>> flight = lierb.Problem(lierb.bodies.sphere(0.1, mass=1.0), lierb.joints.free())
        >>> run = {"twist0": (0.0, 0.0, 0.0, 2.0, 0.0, 0.0), "dt": 0.1, "monte_carlo": 20}
        >>> deviations = {"twist0": (0.0, 0.0, 0.0, 0.1, 0.1, 0.1)}
        >>> spread = lierb.propagate(flight, deviations, "twist0", [0.5, 1.0], "position", **run)
        >>> [panel.get_title(loc="left") for panel in spread.plot().axes]
        ['position, standard deviation [m]']
        """
        given = [quantities] if isinstance(quantities, str) else [*quantities]
        names = given or [*self.linear]
        for name in names:
            require_name("quantities", name, self.linear)
        require("plot")
        from lierb.analysis.estimate_figures import propagation_figure

        linear, sample = (
            {name: self.standard_deviations(name, how) for name in names}
            for how in ("linear", "sample")
        )
        return propagation_figure(self.t, linear, sample, self.holds, self.units, self.size)

    def _representation(self) -> tuple[str, Lines]:
        title = f"lierb.Propagation: {counted(len(self.t), 'time')}, {counted(self.size, 'run')}"
        rows = [("failed", counted(self.failed, "run"))] if self.failed else []
        return title, [*rows, *(row for name in self.linear for row in self._table(name))]

    def _table(self, name: str) -> Iterator[tuple[str, str]]:
        until = self.holds_until(name)
        end = "never holds" if np.isnan(until) else f"holds until t = {until:g} s"
        linear = "linear theory " + ("holds" if self.holds[name].all() else end)
        yield name, f"{self.units[name]}; {linear}"
        every = -(-len(self.t) // MOST_LISTED)
        deviations = self.standard_deviations(name)
        for i in range(0, len(self.t), every):
            ratios = self.ratio[name][i]
            known = ratios[np.isfinite(ratios)]
            shown = f"{known.min():.3g} … {known.max():.3g}" if len(known) else "–"
            mark = "" if self.holds[name][i] else ", linear theory does not hold"
            listed = ", ".join(f"{x:.3g}" for x in deviations[i])
            yield f"  t = {self.t[i]:g} s", f"({listed}), sample / linear {shown}{mark}"


def deviations_of(covariances: Array) -> Array:
    """Return the standard deviations of covariances, (…, w)."""
    variances = np.diagonal(covariances, axis1=-2, axis2=-1)
    return np.asarray(np.sqrt(np.maximum(variances, 0.0)))
