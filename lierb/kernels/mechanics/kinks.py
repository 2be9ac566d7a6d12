"""Bounds on the length of steps, such that they end at kinks of forces."""

from __future__ import annotations

from typing import Any, NamedTuple

from lierb.kernels.numbers.arithmetic import absolute, fma, maximum, minimum, sqrt, where
from lierb.kernels.numbers.number import Number

# Part of the distance to a kink at which a step ends: its last stages are off by the stage's error,
# and one that is beyond the kink has other derivatives. The next step covers most of the rest.
BEFORE = 0.999
LOOSE = 1.1  # factor by which a step may exceed a bound by a velocity, which changes in it
TIGHT = 1.0005  # the same for a kink, which would be within the step
LEAST = 1e-11  # least distance to a kink, of a coordinate: steps pass one that is nearer
FAR = 1e100  # rad, m: distance where there is no kink
NEWTON_STEPS = 3
NEAR = 1.5  # part of a step up to which its cubic is used


class Bound(NamedTuple):
    """Bound h · rate ≤ distance on the length h of a step; rate ≥ 0, distance > 0.

    slack : factor by which a step that has been made may exceed it.
    """

    rate: Number
    distance: Number
    slack: Number = LOOSE


class Travelled(NamedTuple):
    """The end of a step that has been tried: change of a coordinate, and its rate there."""

    change: Number
    rate: Number


def travel_to_kink(
    place: Any, rate: Any, tried: Travelled | None, h: Any, kinks: tuple[Any, ...], unit: Any
) -> Bound:
    """Bound that ends a step just before the next kink of a force.

    All stages of the step are then on one side of the kink. Before a step is tried, the kink's time
    is that of a uniform motion. Afterwards it is that of the cubic with the places and rates of
    both ends; a shorter step, to this time, has a better one.

    place, rate : coordinate at the start, and its rate.
    tried : the end of a step of length h, s; None before it is tried.
    kinks : coordinates, ascending.   unit : a coordinate of usual size.
    """
    least = LEAST * maximum(unit, absolute(place))
    above = below = FAR
    for kink in reversed(kinks):
        above = where(kink > place, kink - place, above)
    for kink in kinks:
        below = where(kink < place, place - kink, below)
    above, below = maximum(above, least), maximum(below, least)
    if tried is None:
        return Bound(absolute(rate), BEFORE * where(rate >= 0.0, above, below))
    h, forward = where(h > 0.0, h, 1.0), where(rate == 0.0, tried.rate, rate) >= 0.0
    distance, behind = where(forward, above, below), where(forward, below, above)
    change = where(forward, tried.change, -tried.change)
    speed, end = absolute(rate), where(forward, tried.rate, -tried.rate)
    # With uniform acceleration d is passed in τ, d = speed τ + gain τ²/2; d/τ is the mean speed.
    gain = (end - speed) / h
    square = fma(2.0 * gain, distance, speed * speed)
    reaches = where(change >= distance, 1.0, where(change <= -behind, -1.0, square)) >= 0.0
    root = sqrt(where(reaches, absolute(square), fma(-2.0 * gain, behind, speed * speed)))
    back = root + speed
    mean = where(reaches, 0.5 * back, -gain * behind / where(back > 0.0, back, 1.0))
    nearest = where(reaches, distance, behind)
    target = where(reaches, nearest, -nearest)
    is_reached = mean > 0.0
    part = nearest / where(is_reached, mean * h, 1.0)  # of the step
    is_passed = (change >= distance) | (change <= -behind)
    first, final = h * speed, h * end
    cubic, bend = first + final - 2.0 * change, 3.0 * change - 2.0 * first - final
    begin = better = where(is_passed, minimum(part, 1.0), part)
    for _ in range(NEWTON_STEPS):
        found = fma(better, fma(better, fma(better, cubic, bend), first), -target)
        slope = fma(better, fma(3.0 * better, cubic, 2.0 * bend), first)
        better = better - found / where(slope == 0.0, 1.0, slope)
    is_better = is_reached & (better > 0.0) & (better <= where(is_passed, 1.0, NEAR))
    is_better = is_better & (begin <= NEAR)
    time = h * where(is_better, better, where(is_passed, minimum(part, 0.5), part))
    rate = where(is_reached, nearest / where(is_reached, time, 1.0), 0.0)
    return Bound(rate, BEFORE * nearest, TIGHT)
