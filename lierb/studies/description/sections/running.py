"""Tables of the integration and of the output."""

from __future__ import annotations

from typing import Literal

from pydantic import ConfigDict, Field

from lierb.kernels.systems.plan import UPDATES
from lierb.runs.time_options import RTOL
from lierb.studies.description.sections.fields import SECTION, Count, Names, Section, Several
from lierb.studies.description.times import SaveAt, saved_times
from lierb.support.arrays import Array


class Baumgarte(Section):
    """Rates of Baumgarte's stabilisation, 1/s."""

    alpha: float
    beta: float


class IntegrateSection(Section):
    """Arguments of `lierb.integrate`; lists of cspace, method, dt and rtol are run as a product.

    With rtol or atol, steps are adaptive and dt is the first step.
    sensitivities : inputs by which the end of each trajectory is differentiated: names of
    `with_respect_to` in `lierb.integrate`; numbers of elements as in [sample].
    """

    model_config = SECTION | ConfigDict(
        json_schema_extra={"anyOf": [{"required": [key]} for key in ("dt", "rtol", "atol")]}
    )

    t_end: float
    t0: float = 0.0
    dt: Several = []
    rtol: Several = []
    atol: float | dict[str, float] | None = None
    dt_min: float | None = None
    dt_max: float | None = None
    max_steps: Count | None = None
    cspace: Names = Field(default=["SE3"], min_length=1)
    method: Names = Field(default=["RK4"], min_length=1)
    update: str = Field(default="local", json_schema_extra={"enum": [*UPDATES]})
    solver: str = "auto"
    stabilise: Literal["project"] | Baumgarte | None = None
    save_every: Count | None = None
    save_at: SaveAt | None = None
    discontinuities: list[float] | None = Field(default=None, min_length=1)
    measure_every: Count = 1
    record: list[str] = []
    sensitivities: Names = []

    @property
    def is_adaptive(self) -> bool:
        return bool(self.rtol) or self.atol is not None

    @property
    def saves(self) -> bool:
        """True if there is a history."""
        return self.save_every is not None or self.save_at is not None

    @property
    def times(self) -> Array | None:
        """Return the times of the history's rows, s; None unless `save_at` is set."""
        return None if self.save_at is None else saved_times(self.save_at, self.t0, self.t_end)

    @property
    def steps(self) -> list[tuple[float | None, float | None]]:
        """Return (dt, rtol) pairs: rtol is None for fixed steps, dt may be for adaptive ones."""
        if not self.is_adaptive:
            return [(dt, None) for dt in self.dt]
        first = self.dt[0] if self.dt else None
        return [(first, rtol) for rtol in self.rtol or [RTOL]]


class OutputSection(Section):
    """Files of the results."""

    part: Count = 16384  # bodies in a part
    compression: Literal["none", "snappy", "zstd"] = "snappy"
