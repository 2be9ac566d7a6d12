"""Bounds on the length of steps, such that they end at kinks of forces."""

from __future__ import annotations

from typing import Any, NamedTuple

from lierb.kernels.numbers.arithmetic import (
    absolute,
    fma,
    sqrt,
    where,
)
from lierb.kernels.numbers.number import Number

BEFORE = 1.0 - 1e-12  # part of the distance to a kink at which a step ends


class Bound(NamedTuple):
    """Bound h · rate ≤ distance on the length h of a step; rate ≥ 0, distance > 0."""

    rate: Number
    distance: Number


def travel_to_kink(place: Any, start: Any, end: Any, h: Any, kinks: tuple[Any, ...]) -> Bound:
    """Bound that ends a step just before the next kink of a force.

    All stages of the step are then on one side of the kink. Its time is that of a motion whose
    rate changes uniformly from start to end of a step.

    place : coordinate at the start, relative to the middle of the kinks.
    start, end : its rate at both ends of a step of length h, s.
    kinks : coordinates ahead in the positive direction, ascending; their negatives are those in the
        other one. The last one is greater than any coordinate.
    """
    *near, last = kinks

    def distance_to_kink(ahead: Any) -> Any:
        distance: Any = last - ahead
        for kink in reversed(near):
            distance = where(kink > ahead, kink - ahead, distance)
        return distance

    forward = where(start == 0.0, end, start) >= 0.0
    ahead, speed = where(forward, place, -place), absolute(start)
    gain = where(forward, end - start, start - end) / where(h > 0.0, h, 1.0)
    # The distance d is passed in τ, d = speed τ + gain τ²/2; the mean speed until then is d/τ.
    distance, behind = distance_to_kink(ahead), distance_to_kink(-ahead)
    square = fma(2.0 * gain, distance, speed * speed)
    reaches = square >= 0.0  # else it turns back before
    root = sqrt(where(reaches, square, fma(-2.0 * gain, behind, speed * speed)))
    back = root + speed
    mean = where(reaches, 0.5 * back, -gain * behind / where(back > 0.0, back, 1.0))
    return Bound(mean, BEFORE * where(reaches, distance, behind))
