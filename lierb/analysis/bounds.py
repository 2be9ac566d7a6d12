"""Bounds of a fit's unknowns."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from lierb.analysis.unknowns import ROUNDING, Unknowns
from lierb.errors import ArgumentError, brief, unknown_name
from lierb.support.arrays import Array, as_floats


def bounds_of(unknowns: Unknowns, given: Any) -> tuple[Array, Array]:
    """Return the bounds of the coordinates of unknowns. Raises ArgumentError.

    given : pairs (low, high) by parameter, or None.
    """
    count, free = unknowns.number_count, unknowns.follow.free
    low, high = np.full(count, -np.inf), np.full(count, np.inf)
    given = {} if given is None else given
    if not isinstance(given, Mapping):
        raise ArgumentError(f"bounds={brief(given)}; expected {{parameter: (low, high)}}")
    masses = [f"{body.prefix}mass" for body in unknowns.charted]
    for name, pair in given.items():
        part = _bounded(unknowns, name)
        for end, value in zip((low, high), _pair(name, pair, part), strict=True):
            if name in masses:
                value = 0.5 * np.log(np.maximum(value, np.finfo(float).tiny))
            end[part] = value
        at, rounding = unknowns.base_of_numbers[part], ROUNDING * unknowns.number_scales[part]
        is_outside = (at < low[part] - rounding) | (at > high[part] + rounding)
        if np.any(low[part] >= high[part]) or np.any(is_outside):
            raise ArgumentError(
                f"bounds[{name!r}]={brief(pair)}; expected low < high, with the guess between"
            )
        low[part], high[part] = np.minimum(low[part], at), np.maximum(high[part], at)
    is_bounded = np.isfinite(low) | np.isfinite(high)
    for i in np.flatnonzero(is_bounded & unknowns.follow.depends)[:1]:
        raise ArgumentError(
            f"bounds: loops move {unknowns.labels[i]} together with other numbers; leave the "
            "bounds of this number out, as -inf and inf"
        )
    starts = np.full(unknowns.size - unknowns.shared, np.inf)
    return np.concatenate((low[free], -starts)), np.concatenate((high[free], starts))


def _bounded(unknowns: Unknowns, name: str) -> slice:
    for body in unknowns.charted:
        if name == f"{body.prefix}inertia":
            raise ArgumentError(
                f"bounds[{name!r}]: an inertia has no bounds, it stays that of a rigid body; "
                "leave them out"
            )
    if name in (p.name for p in unknowns.starts):
        raise ArgumentError(f"bounds[{name!r}]: a start has no bounds; leave them out")
    if name not in unknowns.slices:
        raise unknown_name("bounds", name, unknowns.slices)
    return unknowns.slices[name]


def _pair(name: str, pair: Any, part: slice) -> list[Array]:
    expected = f"bounds[{name!r}]={brief(pair)}; expected a pair (low, high)"
    try:
        low, high = pair
    except (TypeError, ValueError):
        raise ArgumentError(expected) from None
    ends = [as_floats(f"bounds[{name!r}]", end) for end in (low, high)]
    if any(end.shape not in ((), (part.stop - part.start,)) or np.isnan(end).any() for end in ends):
        raise ArgumentError(expected)
    return ends
