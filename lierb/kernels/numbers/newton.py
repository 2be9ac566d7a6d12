"""Newton's iteration solves the equations of a step, for lanes that stop at their own turns.

The Jacobian is exact, by dual numbers. Where the equations depend on numbers with derivatives,
which are `lifted`, the iteration has the values alone. The solution has the derivatives −J⁻¹∂r of
the residual's, by the implicit function theorem.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from lierb.kernels.numbers.arithmetic import absolute, repeat, where
from lierb.kernels.numbers.dual import Dual, lifted, parts_of, values
from lierb.kernels.numbers.elimination import Factored
from lierb.kernels.numbers.vec import Vec, sub, units
from lierb.kernels.numbers.zero import ZERO

MOST_TURNS = 50
# The last change, relative to the size of the unknowns: a quadratic iteration then is at rounding.
HALF_THE_DIGITS = 2.0**-26
# The same for a linear iteration: its next change would be rounding. Where rounding is larger, the
# iteration also ends at a change below NEARLY that does not fall to less than HALF the last one.
ROUNDING, NEARLY, HALF = 2.0**-47, 2.0**-36, 0.5
# Smaller numbers of a solution become 0. Out of the plane of a planar mechanism they would fall
# from step to step to denormal numbers, which take ten times as long.
NOTHING = 2.0**-500

Residual = Callable[[Vec], Vec]


class Solved(NamedTuple):
    """The unknowns solve the equations of a step.

    unsolved : 1 where they have not converged.   turns : number of changes of the unknowns.
    """

    unknowns: Vec
    unsolved: Any
    turns: Any


def linearised(residual: Residual, at: Vec, left_out: Vec = ()) -> tuple[Vec, Factored]:
    """Return the residual and its factored Jacobian, without derivatives.

    The residual has derivatives where the equations do.   left_out : as for `Factored`.
    """
    n = len(at)
    found = residual(tuple(map(Dual, at, units(n))))
    rows = [list(values(parts_of(value)) or (ZERO,) * n) for value in found]
    return values(found), Factored(rows, left_out)


def newton(residual: Residual, start: Vec, like: Any) -> Solved:
    """Solve residual = 0, with a new Jacobian in each turn.

    like : as for `lierb.kernels.numbers.arithmetic.repeat`.
    """

    def turn(numbers: tuple[Vec, Any]) -> tuple[Any, Any]:
        unknowns, _ = numbers
        found, factored = linearised(residual, unknowns)
        change = factored.solve(values(found))
        after = sub(unknowns, change)
        excess = total(change) - HALF_THE_DIGITS * total(after)
        return (after, excess), excess > 0.0

    begun = without_derivatives(start)
    (unknowns, excess), _, turns = repeat((begun, 0.0), turn, MOST_TURNS, without_derivatives(like))
    solution = _with_derivatives(residual, unknowns, start)
    return Solved(solution, _unsolved(excess <= 0.0, total(begun)), turns)


def simplified_newton(
    residual: Residual, start: Vec, size: Callable[[Vec], Any], like: Any, left_out: Vec = ()
) -> Solved:
    """Solve residual = 0 with the Jacobian at the start.

    size : size of a change, relative to that of the unknowns.   left_out : as for `Factored`;
    equations that depend on others, and unknowns that keep their numbers at the start.
    """
    begun = without_derivatives(start)
    found, factored = linearised(residual, begun, left_out)
    change = factored.solve(values(found))
    first = without_derivatives(size(change))

    def turn(numbers: tuple[Vec, Any]) -> tuple[Any, Any]:
        unknowns, before = numbers
        change = factored.solve(without_derivatives(residual(unknowns)))
        now = without_derivatives(size(change))
        goes_on = (now > ROUNDING) & ((now > NEARLY) | (now < HALF * before))
        return (sub(unknowns, change), now), goes_on

    start_of_turns = sub(begun, change), first
    (unknowns, last), _, turns = repeat(start_of_turns, turn, MOST_TURNS, without_derivatives(like))
    unknowns = tuple((x + NOTHING) - NOTHING for x in unknowns)
    solution = _with_derivatives(residual, unknowns, start, left_out)
    return Solved(solution, _unsolved(last <= NEARLY, first), 1.0 + turns)


def without_derivatives(numbers: Any) -> Any:
    """Return numbers, `lifted` or not, without derivatives."""
    return values(values(numbers))


def _with_derivatives(residual: Residual, solution: Vec, start: Vec, left_out: Vec = ()) -> Vec:
    """Return the solution, with the derivatives −J⁻¹∂r and `lifted` where the start is."""
    if not any(isinstance(x, Dual) for x in start):
        return solution
    found, factored = linearised(residual, solution, left_out)
    count = max(len(parts_of(x)) for x in found)
    parts = (tuple((parts_of(x) or (ZERO,) * count)[i] for x in found) for i in range(count))
    changes = zip(*(factored.solve(part) for part in parts), strict=True)
    pairs = zip(solution, changes, strict=True)
    return lifted(tuple(Dual(x, tuple(-c for c in change)) for x, change in pairs))


def _unsolved(is_solved: Any, at_start: Any) -> Any:
    """Return 1 where an iteration has not converged; 0 where its start is not a number.

    is_solved : false for NaN.
    """
    return where(is_solved, 0.0, where(at_start == at_start, 1.0, 0.0))


def total(numbers: Vec) -> Any:
    """Return the sum of the magnitudes."""
    return sum(map(absolute, numbers), start=ZERO)
