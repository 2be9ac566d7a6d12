"""Newton's iteration solves the equations of a step, for lanes that stop at their own turns.

The Jacobian is exact, by dual numbers.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from lierb.kernels.numbers.arithmetic import absolute, repeat, where
from lierb.kernels.numbers.dual import Dual, parts_of, value_of
from lierb.kernels.numbers.elimination import Factored
from lierb.kernels.numbers.vec import Vec, sub
from lierb.kernels.numbers.zero import ZERO

MOST_TURNS = 50
# The last change, relative to the size of the unknowns: a quadratic iteration then is at rounding.
HALF_THE_DIGITS = 2.0**-26
# The same for a linear iteration: its next change would be rounding. Where rounding is larger, the
# iteration also ends at a change below NEARLY that does not fall to less than HALF the last one.
ROUNDING, NEARLY, HALF = 2.0**-47, 2.0**-36, 0.5

Residual = Callable[[Vec], Vec]


class Solved(NamedTuple):
    """The unknowns solve the equations of a step.   unsolved : 1 where they have not converged."""

    unknowns: Vec
    unsolved: Any


def linearised(residual: Residual, at: Vec) -> tuple[Vec, Factored]:
    """Return the value and the factored Jacobian of a residual."""
    n = len(at)
    units = (tuple(1.0 if i == j else ZERO for j in range(n)) for i in range(n))
    values = residual(tuple(map(Dual, at, units)))
    rows = [list(parts_of(value) or (ZERO,) * n) for value in values]
    return tuple(map(value_of, values)), Factored(rows)


def newton(residual: Residual, start: Vec, like: Any) -> Solved:
    """Solve residual = 0, with a new Jacobian in each turn.

    like : as for `lierb.kernels.numbers.arithmetic.repeat`.
    """

    def turn(numbers: tuple[Vec, Any]) -> tuple[Any, Any]:
        unknowns, _ = numbers
        values, factored = linearised(residual, unknowns)
        change = factored.solve(values)
        after = sub(unknowns, change)
        excess = total(change) - HALF_THE_DIGITS * total(after)
        return (after, excess), excess > 0.0

    (unknowns, excess), _, _ = repeat((start, 0.0), turn, MOST_TURNS, like)
    return Solved(unknowns, _unsolved(excess <= 0.0, total(start)))


def simplified_newton(
    residual: Residual, start: Vec, size: Callable[[Vec], Any], like: Any
) -> Solved:
    """Solve residual = 0 with the Jacobian at the start.

    size : size of a change, relative to that of the unknowns.
    """
    values, factored = linearised(residual, start)
    change = factored.solve(values)
    first = size(change)

    def turn(numbers: tuple[Vec, Any]) -> tuple[Any, Any]:
        unknowns, before = numbers
        change = factored.solve(residual(unknowns))
        now = size(change)
        goes_on = (now > ROUNDING) & ((now > NEARLY) | (now < HALF * before))
        return (sub(unknowns, change), now), goes_on

    (unknowns, last), _, _ = repeat((sub(start, change), first), turn, MOST_TURNS, like)
    return Solved(unknowns, _unsolved(last <= NEARLY, first))


def _unsolved(is_solved: Any, at_start: Any) -> Any:
    """Return 1 where an iteration has not converged; 0 where its start is not a number.

    is_solved : false for NaN.
    """
    return where(is_solved, 0.0, where(at_start == at_start, 1.0, 0.0))


def total(numbers: Vec) -> Any:
    """Return the sum of the magnitudes."""
    result: Any = ZERO
    for x in numbers:
        result = result + absolute(x)
    return result
