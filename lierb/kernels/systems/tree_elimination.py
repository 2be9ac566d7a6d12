"""Factorisation S = L D Lᵀ of the equations of a tree in memory, and their multipliers λ.

The pivot rule and the tests are those of `lierb.kernels.mechanics.saddle.multipliers_of`; S is in
memory, by rows, without the entries left of its envelope (`connection_table`).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from lierb.kernels.mechanics.saddle import (
    CONSISTENCY_TOLERANCE,
    OPEN_PIVOT,
    PIVOT_TOLERANCE,
    ROUNDED_PIVOT,
    is_other_rank,
)
from lierb.kernels.numbers.arithmetic import absolute, any_lanes, branch, fma, maximum, sqrt, where
from lierb.kernels.numbers.dual import value_of
from lierb.kernels.systems import tree_places as at
from lierb.kernels.systems.tree_memory import MemoryTree
from lierb.kernels.tracing.arrays import Index
from lierb.kernels.tracing.lanes import Lane
from lierb.kernels.tracing.memory import Rows, accumulated, for_each, integer_at

Run = Callable[..., None]  # (name, procedure, operands): see `TreeInMemory._run`


class MemoryEquation:
    """An equation at run time: the rows of its row of S, L and L D, at equation 0."""

    def __init__(self, tree: MemoryTree, i: Index) -> None:
        self.tree, self.i = tree, i
        place = tree[at.EQUATION_TABLE] + i * at.EQUATION
        self.envelope = integer_at(tree.table, place + at.ENVELOPE)
        self.at = integer_at(tree.table, place + at.AT)

    def row(self, section: int) -> Rows:
        return self.tree.rows(self.tree[section] + self.at)


def eliminate(tree: MemoryTree, run: Run, tolerance: Lane, into: int) -> None:
    """Store L, L D and λ, without rows whose pivots are within the tolerance; count these.

    into : the vector for λ.
    """
    run("eliminate", tree, _eliminate, tolerance, tree.index(into))


def settle(tree: MemoryTree, run: Run, dropped: Lane, forced: Any, violation: Any) -> None:
    """Store whether rows that are left out contradict the others, and λ if it is another one.

    dropped : number of dependent rows at the start.   forced : function that returns the bound on
    accelerations by loads and motion.   violation : function that returns the residual δ.
    """
    sums = tree.values.section(at.SUMS_ROW)
    like = 0.0 * dropped
    count = sums[at.DEPENDENT]
    sums.put(at.SINGULAR, 0.0)
    sums.put(at.DROPPED, count)

    def checked() -> tuple[()]:
        bound = forced()
        contradicts = _contradicts(tree, bound, like + CONSISTENCY_TOLERANCE)
        sums.put(at.SINGULAR, contradicts)
        is_open = (dropped - count > 0.5) | (contradicts > 0.5)

        def repeated() -> tuple[()]:
            off = maximum(OPEN_PIVOT * violation(), PIVOT_TOLERANCE)
            rounded = maximum(off, ROUNDED_PIVOT)
            eliminate(tree, run, rounded, at.SECOND)
            second = _contradicts(tree, bound, sqrt(off))
            sums.put(at.SINGULAR, where(is_open, second, contradicts))
            sums.put(at.DROPPED, where(is_open, sums[at.DEPENDENT], count))
            first, other = tree.vector(at.MULTIPLIERS), tree.vector(at.SECOND)
            sums.put(at.DEPENDENT, count)
            for_each(tree[at.EQUATIONS], lambda i: first.put(i, where(is_open, other[i], first[i])))
            return ()

        branch(any_lanes(is_open), repeated, lambda: (), likely=False)
        return ()

    branch(any_lanes(maximum(count, dropped) > 0.5), checked, lambda: (), likely=False)
    singular = where(is_other_rank(sums[at.DROPPED], dropped), 1.0, sums[at.SINGULAR])
    sums.put(at.SINGULAR, singular)


def _eliminate(tree: MemoryTree, tolerance: Lane, into: Index) -> None:
    sums = tree.values.section(at.SUMS_ROW)
    sums.put(at.DEPENDENT, 0.0)
    inverse, reduced = tree.vector(at.INVERSE), tree.vector(at.REDUCED)
    for_each(tree[at.EQUATIONS], lambda i: _eliminate_row(MemoryEquation(tree, i), tolerance))
    found = tree.rows(tree[at.VECTOR_ROWS] + tree[at.EQUATIONS] * into)
    for_each(tree[at.EQUATIONS], lambda i: found.put(i, reduced[i] * inverse[i]))

    def back(i: Index) -> None:
        own = MemoryEquation(tree, i)
        lower, solved = own.row(at.LOWER_ROW), found[i]

        def one(k: Index) -> None:
            j = own.envelope + k
            found.put(j, fma(-lower[j], solved, found[j]))

        for_each(i - own.envelope, one)

    for_each(tree[at.EQUATIONS], back, backward=True)


def _eliminate_row(own: MemoryEquation, tolerance: Lane) -> None:
    tree, i, first = own.tree, own.i, own.envelope
    inverse, reduced = tree.vector(at.INVERSE), tree.vector(at.REDUCED)
    schur, lower, scaled = (own.row(x) for x in (at.SCHUR_ROW, at.LOWER_ROW, at.SCALED_ROW))

    def entry(k: Index) -> None:
        j = first + k
        before = MemoryEquation(tree, j)
        start, theirs = first.or_more(before.envelope), before.row(at.SCALED_ROW)
        (rest,) = accumulated(
            j - start,
            (schur[j],),
            lambda m, rest: (fma(-lower[start + m], theirs[start + m], rest[0]),),
        )
        scaled.put(j, rest)
        lower.put(j, rest * inverse[j])

    for_each(i - first, entry)

    def last(k: Index, sums: tuple[Lane, ...]) -> tuple[Lane, ...]:
        x = -lower[first + k]
        return fma(x, scaled[first + k], sums[0]), fma(x, reduced[first + k], sums[1])

    start = schur[i], tree.vector(at.EXCESS)[i]
    pivot, y = accumulated(i - first, start, last)
    reduced.put(i, y)
    # False for NaN, whose row is kept.
    is_dependent = pivot <= tolerance * (schur[i] + tree.vector(at.MOBILITY)[i])
    inverse.put(i, where(is_dependent, 0.0, 1.0) / where(is_dependent, 1.0, pivot))
    mark = where(is_dependent, 1.0, 0.0 * value_of(pivot))
    tree.vector(at.IS_DEPENDENT).put(i, mark)
    sums = tree.values.section(at.SUMS_ROW)
    sums.put(at.DEPENDENT, sums[at.DEPENDENT] + mark)


def _contradicts(tree: MemoryTree, forced: Any, tolerance: Any) -> Lane:
    """Return 1 where a row that is left out contradicts the others, else 0."""
    tree = tree.values
    marks, reduced = tree.vector(at.IS_DEPENDENT), tree.vector(at.REDUCED)
    mobility = tree.vector(at.MOBILITY)

    def one(i: Index, found: tuple[Lane, ...]) -> tuple[Lane, ...]:
        own = MemoryEquation(tree, i)
        lower, first = own.row(at.LOWER_ROW), own.envelope
        (size,) = accumulated(
            i - first,
            (sqrt(mobility[i]) * forced,),
            lambda k, size: (size[0] + absolute(lower[first + k] * reduced[first + k]),),
        )
        is_one = (marks[i] > 0.5) & (absolute(reduced[i]) > tolerance * size)
        return (where(is_one, 1.0, found[0]),)

    (found,) = accumulated(tree[at.EQUATIONS], (0.0 * forced,), one)
    return found
