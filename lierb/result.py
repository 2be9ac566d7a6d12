"""What `lierb.integrate` gives back."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import pyarrow as pa

from lierb.continuation import End
from lierb.errors import ArgumentError


@dataclass(frozen=True)
class Result:
    """What `integrate` gives back; its tables are pyarrow's.

    summary: one row per trajectory.   history: one row per saved time and trajectory, time-major;
    None without `save_every`.
    """

    summary: pa.Table
    history: pa.Table | None
    _end: End | None = field(default=None, repr=False, compare=False)

    @cached_property
    def end(self) -> dict[str, Any]:
        """Where the run ended, as the keywords `pose0`, `twist0` and `t0` with which it goes on.

        `lierb.integrate(problem, **result.end, dt=…, t_end=…)` continues: with the same body, joint
        and formulation, in the same process, from the driver's own state, so that with the same dt
        and method the bits are those of one run without a break. A state that has drifted off its
        joint goes on as it is. Maxima, energy drift and work count from the new start. Copies and
        parts of `pose0`, or another twist or time with it, start as any other pose does.

        Raises ArgumentError where a trajectory has failed.

        >>> import lierb
        >>> hinge = lierb.joints.revolute(axis=(0.0, 1.0, 0.0), body_point=(0.0, 0.0, 0.15))
        >>> box = lierb.bodies.box((0.1, 0.2, 0.3), mass=1.0)
        >>> pendulum = lierb.Problem(box, hinge, gravity=(0.0, 0.0, -9.81))
        >>> twist0 = hinge.twist(omega=(0.0, 3.0, 0.0))
        >>> first = lierb.integrate(pendulum, twist0=twist0, dt=1e-3, t_end=0.5)
        >>> second = lierb.integrate(pendulum, **first.end, dt=1e-3, t_end=1.0)
        >>> whole = lierb.integrate(pendulum, twist0=twist0, dt=1e-3, t_end=1.0)
        >>> second.summary["omega"] == whole.summary["omega"]
        True
        """
        if self._end is None:
            raise ArgumentError("result.end: only a result that integrate returned has an end")
        return self._end.keywords()

    def __reduce__(self) -> Any:
        """Without its end, whose problem may have functions that cannot be pickled."""
        return Result, (self.summary, self.history)

    def __repr__(self) -> str:
        rows = "no history" if self.history is None else f"{self.history.num_rows} history rows"
        return f"<lierb.Result: {self.summary.num_rows} trajectories, {rows}>"
