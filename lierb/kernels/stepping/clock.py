"""A clock holds the times of the steps, the saved rows and the end of a run."""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from lierb.compiler.loops import shared

TIDY_EVERY = 30  # steps; 16 to 64 work equally; 30 is measured too with measure_every=10


class Clock(Protocol):
    """Times of a run, with fixed steps (`StepClock`) or a clock for each lane (`LaneTime`)."""

    @property
    def saved_rows(self) -> int:
        """Return the number of rows of the history, 0 without one."""

    @property
    def end(self) -> float:
        """Return the end of the run, s."""

    def saved_steps(self) -> NDArray[np.int64]:
        """Return the indices of saved steps, (saved_rows,); for adaptive steps, of the rows."""

    def saved_times(self) -> NDArray[np.float64]:
        """Return the times of the saved rows, (saved_rows,), s."""


class StepClock(NamedTuple):
    """The clock has `steps` steps of `dt` s.

    The intervals of measurement and of saving are in steps (0: never).

    origin, first_step : the start is `first_step` steps after `origin`, s. A continued run counts
        on, so that its times and its renormalisation are the same as without a break.
    """

    dt: float
    steps: int
    measure_every: int
    save_every: int
    origin: float = 0.0
    first_step: int = 0

    @property
    def saved_rows(self) -> int:
        return -(-self.steps // self.save_every) + 1 if self.save_every else 0

    def saved_steps(self) -> NDArray[np.int64]:
        return np.minimum(np.arange(self.saved_rows) * self.save_every, self.steps)

    def saved_times(self) -> NDArray[np.float64]:
        return time_of(self, self.saved_steps())

    @property
    def end(self) -> float:
        return float(time_of(self, self.steps))


@shared
def time_of(clock: Any, step: Any) -> Any:
    """Return the time of a step, or of an array of steps, s."""
    return clock.origin + clock.dt * (clock.first_step + step)


@shared
def seen_at(clock: Any, step: Any) -> Any:
    """Return whether a step is measured, whether it is saved, and its row of the history."""
    is_last, every = step == clock.steps, clock.save_every
    is_measured = is_last or step % clock.measure_every == 0
    if every == 0:
        return is_measured, False, 0
    return is_measured, is_last or step % every == 0, (step + every - 1) // every


@shared
def share_of(clock: Any, step: Any) -> Any:
    """Weight of a measured step in a mean over the whole time, by the trapezoidal rule.

    The weight is half the interval between the measured steps before and after it.
    """
    every = clock.measure_every
    before = max(step - 1, 0) // every * every
    after = min(step + every, clock.steps)
    return 0.5 * (after - before) / clock.steps


@shared
def ahead_of(clock: Any, step: Any, stop: Any) -> Any:
    """Return the next step that is measured, saved or tidied, but at most `stop`; and whether this
    step is tidied, that is, starts from a renormalised pose.
    """
    counted = clock.first_step + step
    ahead = min(clock.measure_every - step % clock.measure_every, TIDY_EVERY - counted % TIDY_EVERY)
    if clock.save_every > 0:
        ahead = min(ahead, clock.save_every - step % clock.save_every)
    return min(step + ahead, stop), counted % TIDY_EVERY == 0
