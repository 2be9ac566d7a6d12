"""Compute the observed orders of a comparison of methods."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from lierb.analysis.convergence import EXACT, Order, fitted_order, verdict

FLOOR = ".floor"  # suffix of a column with the smallest error that exceeds rounding


@dataclass(frozen=True)
class Observed:
    """Hold the observed order of a quantity, for a method on a c-space.

    Attributes
    ----------
    method : str
        Name of the method.
    cspace : str
        Configuration space.
    control : {"dt", "rtol"}
        Option that controls the steps.
    quantity : str
        A column of the comparison's table, such as "error.position".
    order : Order or None
        The order; None if all errors are rounding or below the reference's error.
    of_method : int or None
        Order of the method, if known.
    runs : int
        Number of runs.
    verdict : str
        "exact", "order 4", "drifts" …; see `lierb.analysis.convergence`.
    """

    method: str
    cspace: str
    control: str
    quantity: str
    order: Order | None
    of_method: int | None
    runs: int
    verdict: str

    @property
    def text(self) -> str:
        """Return the order and the number of fitted runs, such as `3.99 (4 of 5)`."""
        if self.order is None:
            return EXACT if self.quantity.startswith("drift.") else "–"
        if self.order.lower_bound:
            return f"≥ {self.order.slope:.2f}"
        if math.isnan(self.order.slope):
            return "does not fall" if self.order.steps else "–"
        return f"{self.order.slope:.2f} ({len(self.order.steps)} of {self.runs})"

    def as_json(self) -> dict[str, Any]:
        """Return the order as plain data."""
        has_slope = self.order is not None and math.isfinite(self.order.slope)
        return asdict(self if has_slope else replace(self, order=None))


def observed_orders(
    rows: Sequence[dict[str, Any]], known: dict[str, int | None], sizes: dict[str, float]
) -> Iterator[Observed]:
    """Yield the observed orders of a comparison's rows.

    known : orders of the methods, by name.   sizes : characteristic size of each quantity.

    Runs with failures are left out, since their remaining trajectories differ from step to step.
    """
    keyed: dict[tuple[str, str, str], list[dict[str, Any]]] = {}
    for row in rows:
        control = "rtol" if row["dt"] is None else "dt"
        keyed.setdefault((row["method"], row["cspace"], control), []).append(row)
    for (method, cspace, control), of in keyed.items():
        by_step = {row["step"]: row for row in of if row["step"] is not None}
        steps, of = list(by_step), list(by_step.values())
        if len(steps) < 2:
            continue
        for quantity, size in sizes.items():
            # None becomes NaN
            errors = np.array([None if r["failed"] else r[quantity] for r in of], dtype=float)
            floors = np.array([row[quantity + FLOOR] for row in of], dtype=float)
            order = fitted_order(steps, errors, size, floors)  # type: ignore[arg-type]
            words = verdict(errors, order)  # type: ignore[arg-type]
            yield Observed(method, cspace, control, quantity, order, known[method], len(of), words)
