"""Timing of a run: steps, tolerances and saved times, converted to clocks of the kernels."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from lierb.kernels.stepping.clock import StepClock, time_of
from lierb.kernels.stepping.lane_clock import Span
from lierb.kernels.stepping.step_size import Tolerances
from lierb.methods import Method
from lierb.model.functions.events import Event
from lierb.runs.continuation import counted
from lierb.runs.lane_engine import LaneTime
from lierb.support.arrays import Array

BLOCKS = ("rotation", "position", "omega", "v", "states")  # each has its own tolerance
IN_RADII = ("position", "v")  # blocks whose default tolerance scales with the radius of gyration
ATOL = 1e-3  # default atol/rtol, in rad, rad/s, units of the states, radii of gyration
LEAST_RTOL = 1e-15


@dataclass(frozen=True)
class Timing:
    """Validated time options of a run.

    steps : number of fixed steps; 0 if steps are adaptive.
    dt : fixed step or first adaptive step, s; 0 for Hairer's choice.
    atol : tolerance of each of BLOCKS; None if it scales with the radius of gyration.
    save_every : 0 for no history.
    is_of_lanes : True if each trajectory has its own clock.
    """

    method: Method
    dt: float
    t0: float
    t_end: float
    steps: int
    measure_every: int
    save_every: int
    rtol: float | None = None
    atol: tuple[float | None, ...] = ()
    dt_min: float = 0.0
    dt_max: float = math.inf
    max_steps: float = math.inf
    save_at: Array | None = None
    discontinuities: Array | None = None
    is_of_lanes: bool = False

    @property
    def is_adaptive(self) -> bool:
        return self.rtol is not None

    @property
    def saves(self) -> bool:
        return bool(self.save_every) or self.save_at is not None

    def plan_fields(
        self, has_events: bool, has_jumps: bool, has_observables: bool
    ) -> dict[str, Any]:
        """Return the fields of the plan that depend on time options.

        has_jumps : True if elements may jump at times that are their parameters.
        """
        if not self.is_of_lanes:
            return {"method": self.method.scheme(False, False)}
        samples = has_observables and self.is_adaptive
        interpolates = has_events or self.saves or samples
        return {
            "method": self.method.scheme(self.is_adaptive, interpolates),
            "clock": "lanes",
            "interpolates": interpolates,
            "samples": samples,
            "jumps": has_jumps or self.discontinuities is not None,
        }

    def clock(self) -> StepClock:
        """Return the clock of fixed steps, shared by all lanes."""
        return StepClock(
            self.dt, self.steps, self.measure_every, self.save_every, *counted(self.t0, self.dt)
        )

    def lane_time(
        self, clock: StepClock | None, events: Iterable[Event], seed: int, numbers: Array
    ) -> LaneTime:
        """Return the clocks of the lanes.

        clock : clock of fixed steps, or None.   numbers : numbers of the trajectories.
        """
        save_at = np.zeros(0) if self.save_at is None else self.save_at
        if clock is None:
            span = Span(self.t0, self.t_end, 0.0, 0.0, float(self.measure_every))
        else:
            start = float(time_of(clock, 0))
            span = Span(start, clock.end, clock.origin, clock.first_step, float(self.measure_every))
            if self.save_every:
                save_at = clock.saved_times()
            else:
                save_at = np.clip(save_at, span.start, span.end)
        share = 1.0 / self.method.calibration
        rtol = max(share * (self.rtol or 0.0), LEAST_RTOL)
        given = dict(zip(BLOCKS, self.atol or (0.0,) * len(BLOCKS), strict=True))
        default = ATOL * (self.rtol or 0.0)
        rotation, position, omega, v, states = (
            share * (default if x is None else x) for x in given.values()
        )
        place_is_own, v_is_own = (float(given[name] is None) for name in IN_RADII)
        tolerances = Tolerances(
            self.dt, rtol, rotation, position, omega, v, states,
            self.dt_min, self.dt_max, self.max_steps, place_is_own, v_is_own,
        )  # fmt: skip
        pairs = [(float(each.direction), float(each.terminal)) for each in events]
        kinds = np.array(pairs or [(0.0, 0.0)]).T.copy()
        steps = clock.saved_steps() if clock is not None and self.save_every else None
        rows = np.ascontiguousarray(save_at)
        jumps = np.zeros(0) if self.discontinuities is None else self.discontinuities
        return LaneTime(span, tolerances, rows, kinds, seed, numbers, steps, jumps)

    def metadata(self) -> dict[str, Any]:
        """Return the options of the lanes' clocks, as keywords of `lierb.integrate`."""

        options: dict[str, Any] = {}
        if not self.is_of_lanes:
            return options
        if self.is_adaptive:
            options["rtol"] = self.rtol
            pairs = zip(BLOCKS, self.atol, strict=True)
            options["atol"] = {name: number for name, number in pairs if number is not None}
            options["dt_min"] = self.dt_min
            options["dt_max"] = None if self.dt_max == math.inf else self.dt_max
        options["max_steps"] = None if self.max_steps == math.inf else int(self.max_steps)
        if self.save_at is not None:
            options["save_at"] = self.save_at
        if self.discontinuities is not None:
            options["discontinuities"] = self.discontinuities
        return options
