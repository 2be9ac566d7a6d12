"""A tape records the linear part of a formula, to be evaluated along directions, or backwards.

A formula on `Dual` numbers whose parts are `Linear` computes its values as ever. The parts are no
numbers but places on a tape: a list of linear operations, whose coefficients are those values. From
parts of the inputs the tape gives those of the results, the Jacobian times a vector. From the gains
of an objective by the formula's results it gives those by the inputs, the transposed Jacobian times
a vector, in as many operations.

Griewank and Walther, Evaluating Derivatives (2008), chapter 6.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from contextlib import AbstractContextManager, nullcontext
from functools import partial
from typing import Any, NamedTuple

from lierb.kernels.numbers.arithmetic import fma, for_rows, where
from lierb.kernels.numbers.dual import Dual, parts_of
from lierb.kernels.numbers.number import Number
from lierb.kernels.numbers.zero import ZERO, is_zero


class Gained(dict[int, Any]):
    """Gains of an objective, by places on a tape.

    of_choices : places of numbers that reach the results through choices alone. Where such a number
    is not chosen, its gain is zero and its derivatives may be infinite or NaN, as those of √x for
    x < 0. They are left out.
    """

    def __init__(self) -> None:
        super().__init__()
        self.of_choices = set[int]()

    def add(self, place: int, gain: Any, is_of_choice: bool = False) -> None:
        self.put(place, self[place] + gain if place in self else gain, is_of_choice)

    def put(self, place: int, gain: Any, is_of_choice: bool) -> None:
        """Replace a gain by its sum with another one, which is of a choice or not."""
        if not is_of_choice:
            self.of_choices.discard(place)
        elif place not in self:
            self.of_choices.add(place)
        self[place] = gain


class Operation(NamedTuple):
    """An operation is Σ factorᵢ xᵢ or, with a mask, a choice of x₀ where it holds, x₁ elsewhere.

    terms : (factor, place of x); a factor of None stands for 1.   mask : None for a sum.
    """

    terms: tuple[tuple[Any, int], ...]
    mask: Any = None

    def of(self, known: Mapping[int, Any]) -> Any:
        """Return the result.   known : numbers by place."""
        (factor, x), *others = self.terms
        if self.mask is not None:
            return where(self.mask, known[x], known[others[0][1]])
        if not others:
            return -known[x] if type(factor) is float and factor == -1.0 else factor * known[x]
        ((second, y),) = others
        if factor is not None:
            return fma(factor, known[x], known[y])
        return known[x] + known[y] if second is None else known[x] - known[y]

    def back(self, place: int, gained: Gained) -> None:
        """Add the gain by the result to those by the numbers in the operation."""
        terms, mask = self
        if place not in gained or not terms:
            return
        gain, is_of_choice = gained.pop(place), place in gained.of_choices
        if mask is not None:
            (_, first), (_, second) = terms
            if first >= 0:
                gained.add(first, where(mask, gain, 0.0), True)
            if second >= 0:
                gained.add(second, where(mask, 0.0, gain), True)
            return
        for factor, x in terms:
            if factor is None:
                gained.add(x, gain, is_of_choice)
                continue
            more = fma(factor, gain, gained[x]) if x in gained else factor * gain
            if is_of_choice and type(factor) is not float:  # which may be infinite or NaN
                more = where(gain == 0.0, gained.get(x, 0.0), more)
            gained.put(x, more, is_of_choice)


class Tape:
    """A tape has inputs, numbered in the order of their making, and operations."""

    def __init__(self) -> None:
        self.operations: list[Any] = []  # `Operation`s, or others with a method `back`
        self.inputs: list[int] = []  # places

    def recording(self) -> AbstractContextManager[None]:
        """Return a context in which a formula is recorded."""
        return nullcontext()

    def input(self) -> Linear:
        """Return the next input."""
        place = self._add(())
        self.inputs.append(place.place)
        return place

    def opened(self, numbers: Any) -> list[Dual]:
        """Return numbers as dual numbers, each with an input of its own."""
        return [Dual(x, (self.input(),)) for x in numbers]

    def gains(self, results: Iterable[tuple[Number, Number]]) -> list[Any]:
        """Return the gains of an objective by all inputs; structural zeros where there are none.

        results : numbers of the formula, each with the objective's gain by it.
        """
        gained = Gained()
        for number, gain in results:
            for part in parts_of(number):
                if isinstance(part, Linear):
                    gained.add(part.place, gain)
        self.give_back(gained)
        return [gained.get(place, ZERO) for place in self.inputs]

    def give_back(self, gained: Gained, first: int = 0) -> None:
        """Turn gains by results of operations, from number `first` on, into those by the others."""
        for place in range(len(self.operations) - 1, first - 1, -1):
            self.operations[place].back(place, gained)

    def derivatives(
        self, results: list[Linear], rows: list[tuple[Any, ...]], like: Number
    ) -> list[tuple[Any, ...]]:
        """Return results of the formula along several directions, [direction][result].

        rows : numbers of all inputs, [direction][input].   like : as for `for_rows`.
        """
        needed, waiting = set[int](), [x.place for x in results]
        while waiting:
            place = waiting.pop()
            if place not in needed:
                needed.add(place)
                waiting += [x for _, x in self.operations[place].terms if x != NOWHERE]
        used = [i for i, place in enumerate(self.inputs) if place in needed]

        def along(*numbers: Any) -> tuple[Any, ...]:
            known = dict(zip([self.inputs[i] for i in used], numbers, strict=True))
            known[NOWHERE] = 0.0
            for place in sorted(needed - known.keys()):
                known[place] = self.operations[place].of(known)
            return tuple(known[x.place] for x in results)

        return for_rows(like, along, *(tuple(row[i] for i in used) for row in rows))

    def replace(self, first: int, last: int, replaced: Callable[[Any], Any]) -> None:
        """Replace the factors and masks of some operations."""
        for i in range(first, last):
            terms, mask = self.operations[i]
            pairs = ((x if x is None else replaced(x), place) for x, place in terms)
            self.operations[i] = Operation(tuple(pairs), None if mask is None else replaced(mask))

    def _add(self, terms: tuple[tuple[Any, int], ...], mask: Any = None) -> Linear:
        self.operations.append(Operation(terms, mask))
        return Linear(self, len(self.operations) - 1)


NOWHERE = -1  # place of a zero


class Linear:
    """A linear number is the result of an operation on a tape; factors are other numbers."""

    __slots__ = ("place", "tape")
    __array_ufunc__: Any = None
    rank = 5

    def __init__(self, tape: Tape, place: int) -> None:
        self.tape = tape
        self.place = place

    def __add__(self, other: Any) -> Any:
        return self._sum(other, None)

    __radd__ = __add__

    def __sub__(self, other: Any) -> Any:
        return self._sum(other, -1.0)

    def __rsub__(self, other: Any) -> Any:
        return (-self) + other

    def __neg__(self) -> Linear:
        return self.tape._add(((-1.0, self.place),))

    def __mul__(self, factor: Any) -> Any:
        return ZERO if is_zero(factor) else self.tape._add(((factor, self.place),))

    __rmul__ = __mul__

    def _sum(self, other: Any, factor: Any) -> Any:
        if _is_nothing(other):
            return self
        return self.tape._add(((None, self.place), (factor, other.place)))

    @staticmethod
    def fma(a: Any, b: Any, c: Any) -> Any:
        x, factor = (a, b) if isinstance(a, Linear) else (b, a)
        if not isinstance(x, Linear):
            return c if _is_nothing(a) or _is_nothing(b) else a * b + c
        if is_zero(factor):
            return c
        if _is_nothing(c):
            return x * factor
        return x.tape._add(((factor, x.place), (None, c.place)))

    @staticmethod
    def joined(a: Any, b: Any, join: partial[Any]) -> Any:
        """Choose one of two numbers.   join : function whose first argument is a mask."""
        if isinstance(a, Linear) and isinstance(b, Linear) and a.place == b.place:
            return a
        (mask,) = join.args
        tape = (a if isinstance(a, Linear) else b).tape
        places = ((None, x.place if isinstance(x, Linear) else NOWHERE) for x in (a, b))
        return tape._add(tuple(places), mask)


def _is_nothing(x: Any) -> bool:
    """Return whether a number is a constant zero."""
    return is_zero(x) or (isinstance(x, float) and x == 0.0)
