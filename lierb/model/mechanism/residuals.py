"""Residuals of the rows of a mechanism: which members are closed, and why others are not."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lierb.kernels.mechanics.constraints import squares_by_kind
from lierb.kernels.mechanics.scale import START_TOLERANCE
from lierb.kernels.numbers.arithmetic import absolute, plain
from lierb.model.mechanism.row_system import (
    CLOSED,
    NEWTON_STEPS,
    ConnectionState,
    System,
    errors_of,
    name_of,
    one_of,
)
from lierb.support.arrays import Array

NEARLY = 1e-3  # residual of lengths and axes that fit each other in part of their digits


def _excesses(s: ConnectionState, values: list[Any]) -> Iterator[Any]:
    """Residual of each row relative to rounding; a row is closed up to 1."""
    small = CLOSED * s.length + s.rounding
    for r, value in zip(s.at.rows, values, strict=True):
        excess = absolute(plain(value)) / (small if r.is_translational else CLOSED)
        yield np.where(np.isfinite(excess), excess, np.inf)


def excess_of(count: int, states: list[ConnectionState], off: list[list[Any]]) -> Array:
    """Return the largest excess of each member, (count,)."""
    largest = np.zeros(count)
    for s, values in zip(states, off, strict=True):
        for excess in _excesses(s, values):
            largest = np.maximum(largest, excess)
    return largest


def are_accepted(
    count: int, states: list[ConnectionState], off: list[list[Any]]
) -> NDArray[np.bool_]:
    """Mark the members with errors that `lierb.integrate` accepts at a start, (count,)."""
    marks = np.ones(count, dtype=bool)
    for s, values in zip(states, off, strict=True):
        sizes = [size for *_, size in errors_of(s)]
        if s.second is not None:
            sizes = [np.sqrt(plain(x)) for x in squares_by_kind(s.at.rows, values)]
        allowed = START_TOLERANCE * s.length + s.rounding, START_TOLERANCE
        for size, most in zip(sizes, allowed, strict=True):
            marks &= size <= most
    return marks


def no_convergence(
    system: System, states: list[ConnectionState], off: list[list[Any]], member: int, label: str
) -> str:
    """Message that names the connection with the largest residual."""

    def largest(pair: tuple[ConnectionState, list[Any]]) -> float:
        return max((float(one_of(x, member)) for x in _excesses(*pair)), default=0.0)

    s, values = max(zip(states, off, strict=True), key=largest)
    rows, freedoms = sum(len(each.at.rows) for each in states), 6 * len(system.mechanism.links)
    far = "start nearer to a closed pose, or look at the links' lengths: they may not reach"
    fit = (
        f"{rows} rows on {freedoms} freedoms are closed only where lengths and axes fit each other"
    )
    why, fewer = far, "joints with fewer rows, such as spherical, ask for less"
    if rows >= freedoms:
        why = f"{far}; {fit}: {fewer}"
        if largest((s, values)) * CLOSED < NEARLY:
            why = f"{fit}, to {START_TOLERANCE:g}: give these numbers with more digits; {fewer}"
    residual = " and ".join(
        f"{one_of(size, member):.3g}{unit}{' in rotation' if what == 'rotation' else ''}"
        for what, unit, size in errors_of(s)
        if any(r.error_kind == what for r in s.at.rows)
    )
    return (
        f"{label} does not come to close in {NEWTON_STEPS} Newton steps: "
        f"{name_of(system.mechanism, s.at)} stays open by {residual}; {why}"
    )
