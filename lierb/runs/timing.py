"""When a run is: its arguments, checked, as the clock of all lanes or of each."""

from __future__ import annotations

import math
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lierb.errors import ArgumentError, TimeGridError, brief, unknown_name
from lierb.kernels.stepping.clock import StepClock, time_of
from lierb.kernels.stepping.lane_clock import Span
from lierb.kernels.stepping.step_size import Tolerances
from lierb.kernels.systems.plan import Embedded, Extension
from lierb.methods import TABLEAUS, ButcherTableau, tableau_of
from lierb.model.functions.controllers import Controller
from lierb.model.functions.events import Event
from lierb.model.mechanism.mechanism import Mechanism
from lierb.model.problem import Problem
from lierb.runs.continuation import counted
from lierb.runs.lane_engine import LaneTime
from lierb.runs.provenance import described_array
from lierb.support.arrays import Array, are_finite, as_floats, is_whole

MOST_STEPS = 2.0**53  # beyond, not every step has a number
MOST_TICKS = 2.0**48  # beyond, steps between them would be a few roundings of t long
BLOCKS = ("rotation", "position", "omega", "v", "states")  # that have a tolerance of their own
ADAPTIVE_METHOD = "DOP853"  # where none is given
RTOL = 1e-6  # where only atol is given
# Of rtol, where only that is given: in rad, rad/s, units of the states, and radii of gyration.
ATOL = 1e-3
IN_RADII = ("position", "v")
LEAST_RTOL = 1e-15  # of what steps are held against, too
MOST_SEED = 2**53


@dataclass(frozen=True)
class Timing:
    """The arguments of `lierb.integrate` that say when: checked, in plain numbers.

    steps : of a grid of fixed steps; 0 with adaptive ones.   dt : of adaptive steps the first, or 0
        to choose it.   atol : of each of BLOCKS; None where it is the body's own.
    save_every : 0 for none.   save_at : s, or None.
    is_of_lanes : whether each lane has a clock of its own.
    """

    tableau: ButcherTableau
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

    def described(self, looks: bool, jumps: bool) -> dict[str, Any]:
        """Fields of the plan that depend on it.

        looks : whether there are events.   jumps : whether elements may jump at given times.
        """
        tableau = self.tableau
        found = {
            "stages": tableau.A,
            "weights": tableau.b,
            "exponentials": tableau.exponentials or (),
        }
        if not self.is_of_lanes:
            return found
        looks = looks or self.saves
        embedded = None
        if self.is_adaptive:
            assert tableau.error is not None
            assert tableau.error_order is not None
            embedded = Embedded(_rows(tableau.error), tableau.error_order)
        extension = None
        if looks and tableau.dense is not None:
            extension = Extension(_rows(tableau.dense_A), _rows(tableau.dense))
        return found | {
            "clock": "lanes", "embedded": embedded, "extension": extension, "looks": looks,
            "jumps": jumps or self.discontinuities is not None,
        }  # fmt: skip

    def clock(self) -> StepClock:
        """Of fixed steps, the same in all lanes."""
        return StepClock(
            self.dt, self.steps, self.measure_every, self.save_every, *counted(self.t0, self.dt)
        )

    def lane_time(
        self, clock: StepClock | None, events: Iterable[Event], seed: int, numbers: Array
    ) -> LaneTime:
        """clock : of fixed steps, as a run goes on with it.   numbers : of the trajectories."""
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
        share = 1.0 / self.tableau.calibration
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

    def options(self) -> dict[str, Any]:
        """As metadata have them, beside those of every run: what `lierb.integrate` takes again."""
        if not self.is_of_lanes:
            return {}
        found: dict[str, Any] = {}
        if self.is_adaptive:
            found["rtol"] = self.rtol
            pairs = zip(BLOCKS, self.atol, strict=True)
            found["atol"] = {name: number for name, number in pairs if number is not None}
            found["dt_min"] = self.dt_min
            found["dt_max"] = None if self.dt_max == math.inf else self.dt_max
        found["max_steps"] = None if self.max_steps == math.inf else int(self.max_steps)
        if self.save_at is not None:
            found["save_at"] = described_array(self.save_at)
        if self.discontinuities is not None:
            found["discontinuities"] = described_array(self.discontinuities)
        return found


def _rows(weights: Sequence[Sequence[float]]) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(row) for row in weights)


def timing_of(
    *,
    dt: float | None,
    t_end: float,
    t0: float,
    method: str | ButcherTableau | None,
    update: str,
    save_every: int | None,
    measure_every: int,
    rtol: float | None,
    atol: float | Mapping[str, float] | None,
    dt_min: float | None,
    dt_max: float | None,
    max_steps: int | None,
    save_at: ArrayLike | None,
    discontinuities: ArrayLike | None,
    has_own_time: bool,
) -> Timing:
    """The arguments of `lierb.integrate` that say when. Raises what `lierb.integrate` would.

    has_own_time : whether the problem has something that happens along a trajectory's own time:
        events, states, controllers, forces that jump at given times.
    """
    start = checked_time("t0", t0, after=-math.inf)
    end = checked_time("t_end", t_end, after=start)
    is_adaptive = rtol is not None or atol is not None
    given = (ADAPTIVE_METHOD if is_adaptive else "RK4") if method is None else method
    tableau = tableau_of(given)
    if tableau.exponentials and update == "global":
        raise ArgumentError(
            f'{tableau.name} makes each pose of several exponentials and needs update="local"; '
            'update="global" keeps one chart'
        )
    _check_counts(save_every, measure_every)
    times = None if save_at is None else _checked_save_at(save_at, start, end)
    if times is not None and save_every is not None:
        raise ArgumentError("save_every and save_at are both given; choose one of them")
    most = math.inf if max_steps is None else _checked_max_steps(max_steps)
    jumps = None if discontinuities is None else _checked_times("discontinuities", discontinuities)
    has_own_time = has_own_time or times is not None or jumps is not None
    if is_adaptive:
        return _adaptive(
            tableau, dt, start, end, save_every, int(measure_every), rtol, atol, dt_min, dt_max,
            most, times, jumps,
        )  # fmt: skip
    for name, got in (("dt_min", dt_min), ("dt_max", dt_max)):
        if got is not None:
            raise ArgumentError(
                f"{name}={brief(got)} is for adaptive steps; give rtol= (or atol=) as well"
            )
    if dt is None:
        raise TimeGridError("integrate needs dt=, the step in s, or rtol= for adaptive steps")
    steps = checked_steps(dt, end, start)
    measured, saved = (min(int(every or 0), steps) for every in (measure_every, save_every))
    return Timing(
        tableau, float(dt), start, end, steps, measured, saved,
        max_steps=most, save_at=times, discontinuities=jumps,
        is_of_lanes=has_own_time or most < math.inf,
    )  # fmt: skip


def _adaptive(
    tableau: ButcherTableau,
    dt: float | None,
    start: float,
    end: float,
    save_every: int | None,
    measure_every: int,
    rtol: float | None,
    atol: float | Mapping[str, float] | None,
    dt_min: float | None,
    dt_max: float | None,
    most: float,
    times: Array | None,
    jumps: Array | None,
) -> Timing:
    if tableau.error is None:
        able = ", ".join(name for name, each in TABLEAUS.items() if each.error is not None)
        raise ArgumentError(
            f"rtol= and atol= need a method with an embedded one to tell errors by ({able}), not "
            f"{tableau.name}; give another method=, or dt= for fixed steps"
        )
    if save_every is not None:
        raise ArgumentError(
            f"save_every={brief(save_every)} counts steps, of which each trajectory has its own "
            "with rtol=; give save_at=, times in s"
        )
    relative = RTOL if rtol is None else _checked_rtol(rtol)
    first = 0.0 if dt is None else checked_time("dt", dt)
    least = 0.0 if dt_min is None else _checked_length("dt_min", dt_min, zero=True)
    longest = math.inf if dt_max is None else _checked_length("dt_max", dt_max)
    if least > longest:
        raise ArgumentError(f"dt_min={dt_min!r} s is longer than dt_max={dt_max!r} s")
    return Timing(
        tableau, first, start, end, 0, measure_every, 0, relative, _checked_atol(atol, relative),
        least, longest, most, times, jumps, is_of_lanes=True,
    )  # fmt: skip


def _checked_rtol(rtol: Any) -> float:
    given = _real(rtol)
    if not LEAST_RTOL <= given < 1.0:
        raise ArgumentError(
            f"rtol={brief(rtol)}; expected a number from {LEAST_RTOL:g}, near rounding, to less "
            "than 1"
        )
    return given


def _checked_atol(atol: Any, rtol: float) -> tuple[float | None, ...]:
    """Of each block; None where it counts in the body's own radius of gyration."""
    if atol is None:
        atol = {}
    if isinstance(atol, Mapping):
        for name in atol:
            if name not in BLOCKS:
                raise unknown_name("atol", str(name), BLOCKS)
        return tuple(
            _checked_tolerance(f"atol[{name!r}]", atol[name]) if name in atol
            else None if name in IN_RADII else ATOL * rtol
            for name in BLOCKS
        )  # fmt: skip
    return (_checked_tolerance("atol", atol),) * len(BLOCKS)


def _checked_tolerance(name: str, given: Any) -> float:
    number = _real(given)
    if not 0.0 <= number < math.inf:
        raise ArgumentError(
            f"{name}={brief(given)}; expected a number, zero or positive, in the unit of its block "
            "(rad, m, rad/s, m/s), or a dictionary of such by block"
        )
    return number


def _checked_length(name: str, given: Any, zero: bool = False) -> float:
    number = _real(given)
    fits = 0.0 <= number < math.inf if zero else 0.0 < number <= math.inf
    if not fits:
        raise ArgumentError(f"{name}={brief(given)}; expected a positive time in s")
    return number


def _checked_max_steps(given: Any) -> float:
    if not (is_whole(given) and given >= 1):
        raise ArgumentError(f"max_steps={brief(given)}; expected a whole number, at least 1")
    return float(given)


def _real(given: Any) -> float:
    """NaN for what is no number."""
    is_real = is_whole(given) or isinstance(given, (float, np.floating))
    try:
        return float(given) if is_real else math.nan
    except OverflowError:
        return math.inf


def _checked_save_at(given: Any, start: float, end: float) -> Array:
    times = _checked_times("save_at", given)
    rounding = 4 * sys.float_info.epsilon * max(abs(start), abs(end))
    for time in (times[0], times[-1]):
        if not start - rounding <= time <= end + rounding:
            raise TimeGridError(
                f"save_at has {float(time)!r} s, which is not within t0={start!r} s and "
                f"t_end={end!r} s"
            )
    return np.clip(times, start, end)


def _checked_times(name: str, given: Any) -> Array:
    """A row of times in ascending order. Raises TimeGridError."""
    times = as_floats(name, given)
    if times.ndim != 1 or not times.size or not are_finite(times):
        raise TimeGridError(f"{name}={brief(given)}; expected a row of finite times in s")
    if not (np.diff(times) > 0.0).all():
        raise TimeGridError(f"{name} has times that do not ascend; sort them, each once")
    return np.ascontiguousarray(times)


def _check_counts(save_every: Any, measure_every: Any) -> None:
    for name, every in (("save_every", save_every), ("measure_every", measure_every)):
        is_left_out = every is None and name == "save_every"
        if not (is_left_out or (is_whole(every) and int(every or 0) >= 1)):
            raise TimeGridError(
                f"{name}={brief(every)}; expected a whole number of steps, at least 1"
            )


def has_jumps(problem: Problem | Mechanism) -> bool:
    """Whether a force may jump at times that are parameters of it."""
    return any(element.kind.discontinuities for element in problem.elements)


def has_own_time(problem: Problem | Mechanism) -> bool:
    """Whether something happens along a trajectory's own time."""
    watched = problem.events or problem.states or problem.controllers
    return bool(watched) or has_jumps(problem)


def check_periods(controllers: Iterable[Controller], timing: Timing) -> None:
    """Raise TimeGridError where a controller's ticks are so many that they have no numbers."""
    latest = max(abs(timing.t0), abs(timing.t_end))
    for each in controllers:
        shortest = float(np.min(each.parameters["every"], initial=math.inf))
        if latest / shortest > MOST_TICKS:
            raise TimeGridError(
                f"{each.name} ticks every {shortest!r} s, which is below what t = {latest!r} s is "
                "rounded to; give a longer every=, or times nearer to 0 s"
            )


def checked_seed(seed: Any) -> int:
    if not (is_whole(seed) and 0 <= seed < MOST_SEED):
        raise ArgumentError(f"seed={brief(seed)}; expected a whole number from 0 to 2**53 - 1")
    return int(seed)


def checked_numbers(trajectories: Any, count: int) -> Array:
    """Of the members of the batch, by which noise is drawn."""
    numbers = as_floats("trajectories", trajectories)
    is_fit = numbers.shape == (count,) and (numbers == np.floor(numbers)).all()
    if not (is_fit and (numbers >= 0).all() and (numbers < MOST_SEED).all()):
        raise ArgumentError(
            f"trajectories={brief(trajectories)}; expected the number of each of the {count} "
            "trajectories, whole numbers from 0 to 2**53 - 1"
        )
    return np.ascontiguousarray(numbers)


def checked_steps(dt: float, t_end: float, t0: float) -> int:
    """How many fixed steps lead from t0 to t_end. Raises TimeGridError unless they do."""
    dt = checked_time("dt", dt)
    largest = max(abs(t0), abs(t_end))
    if largest / dt > MOST_STEPS:
        name = "t_end" if largest == abs(t_end) else "t0"
        raise TimeGridError(f"{name} is more than {MOST_STEPS:g} steps of dt={dt!r} s from 0 s")
    length = t_end - t0
    if length == math.inf:
        raise TimeGridError(f"from t0={t0!r} s to t_end={t_end!r} s is beyond all numbers")
    steps = round(length / dt)
    rounding = 4 * sys.float_info.epsilon * largest  # of the times and of N·dt themselves
    if steps < 1 or abs(length - steps * dt) > 1e-9 * dt + rounding:
        below = max(int(length / dt), 1)
        misfit = "no multiple" if t0 == 0.0 else f"after t0={t0!r} s no whole number of steps"
        raise TimeGridError(
            f"t_end={t_end!r} s is {misfit} of dt={dt!r} s; the nearest are "
            f"{t0 + below * dt:.15g} and {t0 + (below + 1) * dt:.15g}"
        )
    return steps


def checked_time(name: str, given: Any, after: float = 0.0) -> float:
    """A time in s, later than `after`."""
    seconds = _real(given)
    if not after < seconds < math.inf:
        late = "positive time in s" if after == 0.0 else f"time in s later than t0={after!r}"
        expected = "finite time in s" if after == -math.inf else late
        raise TimeGridError(f"{name}={brief(given)}; expected a {expected}")
    return seconds
