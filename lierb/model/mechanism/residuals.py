"""Residuals of the rows of a mechanism: which members are closed, and why others are not."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lierb.kernels.mechanics.constraints import squares_by_kind
from lierb.kernels.mechanics.saddle import OPEN_PIVOT
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


class Gap(NamedTuple):
    """Residual of a connection, in position or in rotation.

    size : m, or 1 for rotation.   most : what `lierb.integrate` accepts at a start.
    """

    what: str
    unit: str
    size: Any
    most: Any

    def text(self, member: int) -> str:
        """Return the residual of a member, with its bound."""
        size, most = one_of(self.size, member), one_of(self.most, member)
        kind = " in rotation" if self.what == "rotation" else ""
        return f"{size:.3g}{self.unit}{kind} ({most:.3g}{self.unit} is accepted)"


def _gaps(s: ConnectionState, values: list[Any]) -> Iterator[Gap]:
    """Yield the residuals of a connection in position and in rotation, if it has such rows.

    values : residuals of its rows.
    """
    sizes = [size for *_, size in errors_of(s)]
    if s.second is not None:
        sizes = [np.sqrt(plain(x)) for x in squares_by_kind(s.at.rows, values)]
    allowed = START_TOLERANCE * s.length + s.rounding, START_TOLERANCE
    for (what, unit, _), size, most in zip(errors_of(s), sizes, allowed, strict=True):
        if any(r.error_kind == what for r in s.at.rows):
            yield Gap(what, unit, size, most)


def are_accepted(
    count: int, states: list[ConnectionState], off: list[list[Any]]
) -> NDArray[np.bool_]:
    """Mark the members with errors that `lierb.integrate` accepts at a start, (count,)."""
    marks = np.ones(count, dtype=bool)
    for s, values in zip(states, off, strict=True):
        for gap in _gaps(s, values):
            marks &= gap.size <= gap.most
    return marks


def misfit_of(count: int, states: list[ConnectionState]) -> Array:
    """Return the bound of relative rates of redundant rows at a pose, (count,).

    Rows that are redundant at a closed pose are dependent up to their residual at an open one.
    """
    largest = np.zeros(count)
    for s in states:
        (*_, position), (*_, rotation) = errors_of(s)
        largest = np.maximum(largest, np.maximum(position / s.length, rotation))
    return OPEN_PIVOT * largest


def no_convergence(
    system: System, states: list[ConnectionState], off: list[list[Any]], member: int, label: str
) -> str:
    """Message that names the connection with the largest residual."""

    def largest(pair: tuple[ConnectionState, list[Any]]) -> float:
        gaps = (one_of(gap.size / gap.most, member) for gap in _gaps(*pair))
        return float(max(np.nan_to_num([*gaps, 0.0], nan=np.inf)))

    s, values = max(zip(states, off, strict=True), key=largest)
    rows, freedoms = sum(len(each.at.rows) for each in states), 6 * len(system.mechanism.links)
    far = "start nearer to a closed pose, or check the lengths: the links may not reach"
    fit = f"{rows} rows act on {freedoms} freedoms, and close only where lengths and axes match"
    why, fewer = far, "joints with fewer rows, such as spherical, do not need that"
    if rows >= freedoms:
        why = f"{far}; {fit}: {fewer}"
        if largest((s, values)) * START_TOLERANCE < NEARLY:
            why = f"{fit}, to {START_TOLERANCE:g}: give these numbers with more digits; {fewer}"
    residual = " and ".join(gap.text(member) for gap in _gaps(s, values))
    return (
        f"{label}: no closed pose is found in {NEWTON_STEPS} Newton steps; "
        f"{name_of(system.mechanism, s.at)} stays open by {residual}; {why}"
    )
