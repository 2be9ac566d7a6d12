"""Validation of the time options of a run: steps, tolerances, saved times."""

from __future__ import annotations

import math
import sys
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lierb.errors import ArgumentError, TimeGridError, brief, unknown_name
from lierb.methods import METHODS, Method, method_named
from lierb.model.functions.controllers import Controller
from lierb.runs.timing import ATOL, BLOCKS, IN_RADII, LEAST_RTOL, Timing
from lierb.support.arrays import Array, are_finite, as_floats, is_whole

MOST_STEPS = 2.0**53  # larger step numbers are not exact in a double
MOST_TICKS = 2.0**48  # with more ticks, the steps between them would be a few roundings of t long
MOST_SEED = 2**53
ADAPTIVE_METHOD = "DOP853"  # default with adaptive steps
RTOL = 1e-6  # default where only atol is given


def timing_of(
    *,
    t_end: float,
    has_own_time: bool,
    dt: float | None = None,
    t0: float = 0.0,
    method: str | Method | None = None,
    save_every: int | None = None,
    measure_every: int = 1,
    rtol: float | None = None,
    atol: float | Mapping[str, float] | None = None,
    dt_min: float | None = None,
    dt_max: float | None = None,
    max_steps: int | None = None,
    save_at: ArrayLike | None = None,
    discontinuities: ArrayLike | None = None,
) -> Timing:
    """Validate the time options of `lierb.integrate`. Raises its errors.

    has_own_time : True where each trajectory needs a clock of its own.
    """
    start = checked_time("t0", t0, after=-math.inf)
    end = checked_time("t_end", t_end, after=start)
    is_adaptive = rtol is not None or atol is not None
    given = (ADAPTIVE_METHOD if is_adaptive else "RK4") if method is None else method
    method = method_named(given)
    _check_counts(save_every, measure_every)
    times = None if save_at is None else checked_within("save_at", save_at, start, end)
    if times is not None and save_every is not None:
        raise ArgumentError("save_every and save_at are both given; choose one of them")
    most = math.inf if max_steps is None else _checked_max_steps(max_steps)
    jumps = None if discontinuities is None else _checked_times("discontinuities", discontinuities)
    has_own_time = has_own_time or times is not None or jumps is not None
    if is_adaptive:
        return Timing(
            method, 0.0 if dt is None else checked_time("dt", dt), start, end, 0,
            int(measure_every), 0, *_tolerances(method, save_every, rtol, atol, dt_min, dt_max),
            most, times, jumps, is_of_lanes=True,
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
        method, float(dt), start, end, steps, measured, saved,
        max_steps=most, save_at=times, discontinuities=jumps,
        is_of_lanes=has_own_time or most < math.inf,
    )  # fmt: skip


def _tolerances(
    method: Method, save_every: Any, rtol: Any, atol: Any, dt_min: Any, dt_max: Any
) -> tuple[float, tuple[float | None, ...], float, float]:
    """Validate the options of adaptive steps; return rtol, atol, dt_min and dt_max."""
    if method.error is None:
        able = ", ".join(name for name, each in METHODS.items() if each.error is not None)
        raise ArgumentError(
            f"rtol= and atol= need a method with an embedded error estimate ({able}), not "
            f"{method.name}; give another method=, or dt= for fixed steps"
        )
    if save_every is not None:
        raise ArgumentError(
            f"save_every={brief(save_every)} counts steps, which differ between trajectories "
            "with rtol=; give save_at=, times in s"
        )
    relative = RTOL if rtol is None else _checked_rtol(rtol)
    least = 0.0 if dt_min is None else _checked_length("dt_min", dt_min, zero=True)
    longest = math.inf if dt_max is None else _checked_length("dt_max", dt_max)
    if least > longest:
        raise ArgumentError(f"dt_min={dt_min!r} s is longer than dt_max={dt_max!r} s")
    return relative, _checked_atol(atol, relative), least, longest


def _checked_rtol(rtol: Any) -> float:
    given = _real(rtol)
    if not LEAST_RTOL <= given < 1.0:
        raise ArgumentError(
            f"rtol={brief(rtol)}; expected a number from {LEAST_RTOL:g}, near rounding, to less "
            "than 1"
        )
    return given


def _checked_atol(atol: Any, rtol: float) -> tuple[float | None, ...]:
    """Return the tolerance of each block; None if it scales with the radius of gyration."""
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
        raise ArgumentError(f"{name}={brief(given)}; expected a positive number, in s")
    return number


def _checked_max_steps(given: Any) -> float:
    if not (is_whole(given) and given >= 1):
        raise ArgumentError(f"max_steps={brief(given)}; expected a whole number, at least 1")
    return float(given)


def _real(given: Any) -> float:
    """Return a float; NaN for anything but a real number."""
    is_real = is_whole(given) or isinstance(given, (float, np.floating))
    try:
        return float(given) if is_real else math.nan
    except OverflowError:
        return math.inf


def checked_within(name: str, given: Any, start: float, end: float) -> Array:
    """Return ascending times of a run, (m,). Raises TimeGridError."""
    times = _checked_times(name, given)
    rounding = 4 * sys.float_info.epsilon * max(abs(start), abs(end))
    for time in (times[0], times[-1]):
        if not start - rounding <= time <= end + rounding:
            raise TimeGridError(
                f"{name} has {float(time)!r} s, which is not within t0={start!r} s and "
                f"t_end={end!r} s"
            )
    return np.clip(times, start, end)


def _checked_times(name: str, given: Any) -> Array:
    """Return times in ascending order, (m,). Raises TimeGridError."""
    times = as_floats(name, given)
    if times.ndim != 1 or not times.size or not are_finite(times):
        raise TimeGridError(f"{name}={brief(given)}; expected a row of finite times in s")
    if not (np.diff(times) > 0.0).all():
        raise TimeGridError(f"{name} has times that do not ascend; sort them, each once")
    return np.ascontiguousarray(times)


def _check_counts(save_every: Any, measure_every: Any) -> None:
    for name, every in (("save_every", save_every), ("measure_every", measure_every)):
        is_left_out = every is None and name == "save_every"
        if not (is_left_out or (is_whole(every) and every >= 1)):
            raise TimeGridError(
                f"{name}={brief(every)}; expected a whole number of steps, at least 1"
            )


def check_periods(controllers: Iterable[Controller], timing: Timing) -> None:
    """Raise TimeGridError if a controller's period is below the rounding of t."""
    latest = max(abs(timing.t0), abs(timing.t_end))
    for each in controllers:
        shortest = float(np.min(each.parameters["every"], initial=math.inf))
        if latest / shortest > MOST_TICKS:
            raise TimeGridError(
                f"{each.name} ticks every {shortest!r} s, which is below the rounding of "
                f"t = {latest!r} s; give a longer every=, or times nearer to 0 s"
            )


def checked_seed(seed: Any) -> int:
    if not (is_whole(seed) and 0 <= seed < MOST_SEED):
        raise ArgumentError(f"seed={brief(seed)}; expected a whole number from 0 to 2**53 - 1")
    return int(seed)


def checked_numbers(trajectories: Any, count: int) -> Array:
    """Validate the trajectory numbers, which select each trajectory's noise."""
    numbers = as_floats("trajectories", trajectories)
    is_fit = numbers.shape == (count,) and (numbers == np.floor(numbers)).all()
    if not (is_fit and (numbers >= 0).all() and (numbers < MOST_SEED).all()):
        raise ArgumentError(
            f"trajectories={brief(trajectories)}; expected the number of each of the {count} "
            "trajectories, whole numbers from 0 to 2**53 - 1"
        )
    return np.ascontiguousarray(numbers)


def checked_steps(dt: float, t_end: float, t0: float) -> int:
    """Return the number of fixed steps from t0 to t_end.

    Raises TimeGridError if no whole number of steps fits.
    """
    dt = checked_time("dt", dt)
    largest = max(abs(t0), abs(t_end))
    if largest / dt > MOST_STEPS:
        name = "t_end" if largest == abs(t_end) else "t0"
        raise TimeGridError(f"{name} is more than {MOST_STEPS:g} steps of dt={dt!r} s from 0 s")
    length = t_end - t0
    if length == math.inf:
        raise TimeGridError(f"from t0={t0!r} s to t_end={t_end!r} s is beyond all numbers")
    steps = round(length / dt)
    rounding = 4 * sys.float_info.epsilon * largest  # rounding error of the times and of N·dt
    if steps < 1 or abs(length - steps * dt) > 1e-9 * dt + rounding:
        if steps < 1:
            raise TimeGridError(f"dt={dt!r} s is longer than the run of {length:.15g} s")
        below = max(int(length / dt), 1)
        since = "" if t0 == 0.0 else f", counted from t0={t0!r} s"
        raise TimeGridError(
            f"t_end={t_end!r} s is no multiple of dt={dt!r} s{since}; the nearest are "
            f"{t0 + below * dt:.15g} and {t0 + (below + 1) * dt:.15g}; dt={length / steps:.9g} s "
            "fits, and so do adaptive steps, rtol="
        )
    return steps


def checked_time(name: str, given: Any, after: float = 0.0) -> float:
    """Return a time in s, later than `after`. Raises TimeGridError."""
    seconds = _real(given)
    if not after < seconds < math.inf:
        late = "positive time in s" if after == 0.0 else f"time in s later than t0={after!r}"
        expected = "finite time in s" if after == -math.inf else late
        raise TimeGridError(f"{name}={brief(given)}; expected a {expected}")
    return seconds
