"""List the settings of a study: the product of its lists of c-spaces, methods and steps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from lierb.studies.description.sections.running import IntegrateSection


@dataclass(frozen=True)
class Setting:
    """Setting of a study: one run over all bodies.

    dt : fixed step, or first adaptive step or None, s.   rtol : None for fixed steps.
    """

    cspace: str
    method: str
    dt: float | None
    rtol: float | None = None

    @classmethod
    def of_row(cls, row: Mapping[str, Any]) -> Setting:
        """Make the setting of a row of a study's table."""
        return cls(row["cspace"], row["method"], row.get("dt"), row.get("rtol"))

    @property
    def column(self) -> str:
        """Name of the tables' column that holds `step`."""
        return "dt" if self.rtol is None else "rtol"

    @property
    def step(self) -> float:
        """Return the fixed step, s, or the relative tolerance."""
        step = self.dt if self.rtol is None else self.rtol
        assert step is not None
        return step

    @property
    def step_label(self) -> str:
        return f"dt = {self.dt:g} s" if self.rtol is None else f"rtol = {self.rtol:g}"

    @property
    def label(self) -> str:
        return f"{self.cspace}, {self.method}, {self.step_label}"


def settings_label(run: IntegrateSection) -> str:
    """Format settings as a product, such as `SE3 × RK4, DOP853 × dt = 0.001 s`."""
    steps = ", ".join(f"{dt if rtol is None else rtol:g}" for dt, rtol in run.steps)
    step = f"rtol = {steps}" if run.is_adaptive else f"dt = {steps} s"
    return f"{', '.join(run.cspace)} × {', '.join(run.method)} × {step}"
