"""Report failed trajectories, and motors that miss their positions: messages and warnings."""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lierb.errors import FailedTrajectoryWarning, InconsistentStateWarning
from lierb.kernels.mechanics.scale import length_of
from lierb.kernels.systems import state
from lierb.model.base import Model
from lierb.model.forces.motors import PositionMotor
from lierb.results.columns import as_array, as_codes
from lierb.support.collected_warnings import are_warnings_collected

if TYPE_CHECKING:
    import pyarrow as pa

STATUS_NAMES = {
    state.OK: "ok",
    state.SINGULAR: "singular",
    state.NON_FINITE: "non_finite",
    state.RAISED: "raised",
    state.NO_CONVERGENCE: "no_convergence",
    state.MAX_STEPS: "max_steps",
    state.DT_MIN: "dt_min",
    state.EVENT: "event",
}
SUCCESSES = (STATUS_NAMES[state.OK], STATUS_NAMES[state.EVENT])  # statuses without failure
REMEDIES = {
    "singular": "singular: the constraint rows contradicted each other, as in a configuration that "
    "the joint cannot be in, or where it has drifted open; or a projection onto them was larger "
    "than the step allows, as near a change point, or where a constraint jumps like arctan2; a "
    "smaller dt, a larger rtol near a change point, a c-space that keeps the joint (lierb.predict) "
    "or rows that do not say a thing twice may help",
    "non_finite": "non_finite: a number overflowed or became NaN, mostly as dt is too long for "
    "the stiffest force or the fastest turn; a smaller dt helps there",
    "raised": "raised: a function of yours that runs body by body raised an exception; return "
    "numbers there instead, or end the run before",
    "no_convergence": "no_convergence: the iteration for a step did not end, mostly as dt is too "
    "long for the fastest turn, or for constraints that bend; a smaller dt helps there, or a "
    "method without iteration",
    "max_steps": "max_steps: as many steps were tried as max_steps allows; a larger one, a shorter "
    "run, longer steps or a larger rtol help",
    "dt_min": "dt_min: the error would have asked for a shorter step than dt_min, or than rounding "
    "of t allows; a force that jumps, a singularity ahead or rtol near rounding does that",
}
RAISED_KEY = b"lierb.raised"  # key in a summary's metadata: first exception
COLUMNS = ("trajectory", "status", "t")
OFF = 1e-2  # error of a motor's position that is no drift: rad, or relative to the size of a link


def has_failed(summary: pa.Table) -> NDArray[np.bool_]:
    """True for each row whose status is neither ok nor event."""
    codes, names = as_codes(summary["status"])
    failed = np.array([name not in SUCCESSES for name in names], dtype=bool)
    return np.asarray(failed[codes])


@dataclass(frozen=True)
class Raised:
    """Exception of a user's function, as text, with trajectory and time, s."""

    trajectory: int
    t: float
    what: str


@dataclass(frozen=True)
class Failures:
    """Summary of failed trajectories, at least one.

    runs : number of all trajectories.   counts : number of failed trajectories, by status.
    trajectory, status, t : of the first failed trajectory in the table; t in s.
    setting : setting of the study in which that trajectory ran.
    raised : exception of the first trajectory in the table that has one.
    """

    runs: int
    counts: dict[str, int]
    trajectory: int
    status: str
    t: float
    setting: str = ""
    raised: Raised | None = None

    @classmethod
    def of(cls, summary: pa.Table) -> Failures | None:
        """Return the failures in a summary; None if no trajectory has failed."""
        failed = has_failed(summary)
        if not failed.any():
            return None
        codes, names = as_codes(summary["status"])
        counts = np.bincount(codes[failed], minlength=len(names))
        first = _row(summary, int(failed.argmax()))
        numbers = {name: int(count) for name, count in zip(names, counts, strict=True) if count}
        raised = None
        if STATUS_NAMES[state.RAISED] in numbers:
            row = _row(summary, int((codes == names.index(STATUS_NAMES[state.RAISED])).argmax()))
            what = (summary.schema.metadata or {}).get(RAISED_KEY, b"").decode()
            raised = Raised(row["trajectory"], row["t"], what) if what else None
        return cls(len(failed), numbers, **first, raised=raised)

    @classmethod
    def joined(cls, each: Sequence[Failures], runs: int) -> Failures | None:
        """Merge the failures of several summaries with `runs` trajectories in total."""
        if not each:
            return None
        counts: Counter[str] = Counter()
        for failures in each:
            counts.update(failures.counts)
        raised = next((failures.raised for failures in each if failures.raised), None)
        return replace(each[0], runs=runs, counts=dict(counts), raised=raised)

    @property
    def count(self) -> int:
        return sum(self.counts.values())

    def __str__(self) -> str:
        end = f"{self.status} at t = {self.t:g} s"
        if self.runs == 1:
            return f"the trajectory failed: {end}{self._exception}"
        counted = ", ".join(f"{count} {status}" for status, count in self.counts.items())
        where = f" ({self.setting})" if self.setting else ""
        return (
            f"{self.count} of {self.runs} trajectories failed ({counted}); the first is "
            f"trajectory {self.trajectory}, {end}{where}{self._exception}"
        )

    @property
    def _exception(self) -> str:
        """Describe the first exception; name its trajectory unless it failed first."""
        if self.raised is None:
            return ""
        raised = self.raised
        if raised.trajectory == self.trajectory:
            return f": {raised.what}"
        return f"; in trajectory {raised.trajectory}, at t = {raised.t:g} s, {raised.what}"

    @property
    def remedies(self) -> list[str]:
        """Return the meaning and remedy of each status."""
        return [REMEDIES[status] for status in self.counts]


def _row(summary: pa.Table, number: int) -> dict[str, Any]:
    (values,) = summary.select(COLUMNS).slice(number, 1).to_pylist()
    row: dict[str, Any] = values
    return row


# ---- warnings ----------------------------------------------------------------------------------


def warn_of(failures: Failures | None, look: str, **options: Any) -> None:
    """Issue one FailedTrajectoryWarning unless there are no failures or the caller suppresses it.

    look : advice on where to find the failures.   options : keywords of `warnings.warn`.
    """
    if failures is not None and not are_warnings_collected():
        lines = (f"{failures}; {look}", *failures.remedies)
        warnings.warn("\n  ".join(lines), FailedTrajectoryWarning, **options)


def has_position_motors(model: Model) -> bool:
    """Return whether motors prescribe positions of joints."""
    return any(isinstance(force.kind, PositionMotor) for force in model.forces)


def warn_of_motors(model: Model, summary: pa.Table, **options: Any) -> None:
    """Issue one InconsistentStateWarning if joints are far off the positions of their motors.

    options : keywords of `warnings.warn`.
    """
    if are_warnings_collected():
        return
    length = max(float(np.max(length_of(model.parameters(at)))) for at in model.joints if at.joint)
    alive = ~has_failed(summary)
    for kind, size, unit in (("rotation", 1.0, "rad"), ("position", length, "m")):
        off = np.where(alive, as_array(summary[f"{kind}_error_max"]), 0.0)
        if off.max() > OFF * size:
            warnings.warn(
                f"joints are up to {off.max():.2g} {unit} off the positions that motors prescribe, "
                f"in trajectory {off.argmax()}: the rate of a position jumps, which would take an "
                "impulse, or the steps are too long; give positions with continuous rates, shorter "
                'steps, or stabilise="project"',
                InconsistentStateWarning,
                **options,
            )
            return
