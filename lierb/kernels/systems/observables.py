"""Compute statistics of observables along a trajectory, from values at times of measurement."""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

from lierb.kernels.mechanics.passive_elements import UserObservable
from lierb.kernels.numbers.arithmetic import fma, where
from lierb.kernels.systems.plan import AnyPlan

INF, NAN = float("inf"), float("nan")
KEEPS = ("min", "max", "mean", "final")  # columns of a summary, for each observable
DIFFERENTIATED = KEEPS[:3]  # those whose derivatives are numbers of `Kept`


class Kept(NamedTuple):
    """Hold the statistics of an observable so far.

    total, lost : the sum for the mean so far, and its rounding error (Kahan).
    """

    least: Any
    largest: Any
    total: Any
    lost: Any
    last: Any


@lru_cache(64)
def observables_of(plan: AnyPlan) -> tuple[UserObservable, ...]:
    """Return the observables, in the order of their columns."""
    return tuple(e for e in plan.elements if isinstance(e, UserObservable))


def may_raise(plan: AnyPlan) -> bool:
    """Return whether any observable is called body by body, and so may raise."""
    return any(not each.function.is_traced for each in observables_of(plan))


def nothing_kept(plan: AnyPlan, like: Any) -> tuple[Kept, ...]:
    """Return statistics before the first value.   like : zero, of the body's number type."""
    fresh = Kept(like + INF, like - INF, like, like, like + NAN)
    return (fresh,) * len(observables_of(plan))


def kept_of(numbers: tuple[Any, ...]) -> tuple[Kept, ...]:
    """Return the statistics from their concatenated numbers."""
    width = len(Kept._fields)
    return tuple(Kept(*numbers[i : i + width]) for i in range(0, len(numbers), width))


def with_value(kept: Kept, value: Any, share: Any, alive: Any, by_halves: bool = False) -> Kept:
    """Add one value; extremes and mean stay NaN after a NaN.

    value : NaN after a failure; mean and final value are then NaN.
    share : weight of the value in the mean, a fraction of the run's time; with `by_halves`, weight
        of the sum of the value and the one before it.
    alive : mask of bodies that have not failed.
    """
    is_number = value == value
    least = where(is_number, where(value < kept.least, value, kept.least), value)
    largest = where(is_number, where(value > kept.largest, value, kept.largest), value)
    counted = value
    if by_halves:
        counted = where(kept.last == kept.last, value + kept.last, where(is_number, 0.0, value))
    added = where(is_number, fma(share, counted, -kept.lost), value)
    total = kept.total + added
    lost = (total - kept.total) - added
    return Kept(
        where(alive, least, kept.least),
        where(alive, largest, kept.largest),
        total,
        where(lost == lost, lost, 0.0),  # NaN from ∞ − ∞: an infinite mean stays infinite
        value,
    )


def columns_of(kept: Kept) -> tuple[Any, ...]:
    """Numbers of KEEPS; NaN where there was no value."""
    is_known = kept.least <= kept.largest  # false for NaN
    extremes = where(is_known, (kept.least, kept.largest), (NAN, NAN))
    return (*extremes, kept.total, kept.last)
