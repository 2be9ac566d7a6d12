"""What a formula may use besides + - * /: one function, every number type.

A formula that keeps to these functions runs unchanged as plain Python, over whole arrays, as SIMD
code, and with derivatives. Each class of numbers bears its operations; here they are handed to the
class of highest `rank` among the operands. One without a `rank` is `Plain`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache, partial, wraps
from typing import Any

import numpy as np

from lierb.kernels.numbers.zero import is_zero

PI = 3.141592653589793


class Plain:
    """Floats, NumPy's scalars and its arrays; indices and conditions of such."""

    rank = 0
    sqrt, absolute, rint, floor = np.sqrt, np.abs, np.rint, np.floor
    minimum, maximum = np.fmin, np.fmax
    real = float

    @staticmethod
    def trace_of(number: Any) -> None:
        return None

    @staticmethod
    def fma(a: Any, b: Any, c: Any) -> Any:
        return a * b + c

    @staticmethod
    def select(mask: Any, a: Any, b: Any) -> Any:
        if isinstance(mask, np.ndarray):
            return np.where(mask, a, b)
        return a if mask else b

    @staticmethod
    def reduced(mask: Any, kind: str) -> bool:
        return bool(np.all(mask) if kind == "and" else np.any(mask))

    @staticmethod
    def branch(
        predicate: Any, then: Callable[[], Any], otherwise: Callable[[], Any], likely: bool
    ) -> Any:
        return then() if predicate else otherwise()

    @staticmethod
    def load(array: Any, index: tuple[Any, ...], width: int) -> Any:
        return array[index]

    @staticmethod
    def store(array: Any, index: tuple[Any, ...], number: Any, width: int) -> None:
        array[index] = number

    @staticmethod
    def prefetch(array: Any, index: tuple[Any, ...], count: int) -> None:
        pass

    @staticmethod
    def gather(array: Any, axis: int, place: tuple[Any, ...], width: int) -> Any:
        return array[place]

    @staticmethod
    def scatter(
        array: Any, axis: int, places: Sequence[tuple[Any, ...]], numbers: Sequence[Any], width: int
    ) -> None:
        for place, number in zip(places, numbers, strict=True):
            array[place] = number


def _bearer(*kinds: Any) -> Any:
    """The class that bears the operations on things of these types."""
    ranked = (kind for kind in kinds if hasattr(kind, "rank"))
    return max(ranked, key=lambda kind: kind.rank, default=Plain)


bearer: Callable[..., Any] = cache(_bearer)


def unless_borne(formula: Callable[..., Any]) -> Callable[..., Any]:
    """Decorator: a formula, but for numbers whose class bears an operation of that name."""

    @wraps(formula)
    def dispatched(*numbers: Any) -> Any:
        return getattr(bearer(*map(type, numbers)), formula.__name__, formula)(*numbers)

    return dispatched


def fma(a: Any, b: Any, c: Any) -> Any:
    """a·b + c, rounded once where traced for a CPU that can; rounded twice in plain Python."""
    # Most of the time of a formula in Python goes by here.
    return bearer(type(a), type(b), type(c)).fma(a, b, c)


def sqrt(x: Any) -> Any:
    return bearer(type(x)).sqrt(x)


def absolute(x: Any) -> Any:
    return bearer(type(x)).absolute(x)


def rint(x: Any) -> Any:
    """Nearest integer, ties to even."""
    return bearer(type(x)).rint(x)


def floor(x: Any) -> Any:
    return bearer(type(x)).floor(x)


def minimum(a: Any, b: Any) -> Any:
    """The smaller one; the other one if one is NaN."""
    a, b = plain(a), plain(b)
    return bearer(type(a), type(b)).minimum(a, b)


def maximum(a: Any, b: Any) -> Any:
    """The larger one; the other one if one is NaN."""
    if is_zero(a, b):
        return a
    a, b = plain(a), plain(b)
    return bearer(type(a), type(b)).maximum(a, b)


def plain(x: Any) -> Any:
    """A structural zero as a number."""
    return 0.0 if is_zero(x) else x


Cuts = tuple[tuple[Any, int], ...]  # a mask, and how many terms are taken where it holds


def horner(z: Any, terms: tuple[float, ...], cuts: Cuts = ()) -> Any:
    """Σ terms[k] zᵏ; where it is cut, to the bits of the shorter series."""
    total: Any = terms[-1]
    for k in range(len(terms) - 2, -1, -1):
        for mask, count in cuts:
            if count == k + 1:
                total = where(mask, 0.0, total)
        total = fma(z, total, terms[k])
    return total


# ---- choices -----------------------------------------------------------------------------------


def where(mask: Any, a: Any, b: Any) -> Any:
    """`a` where the mask holds, `b` elsewhere, lane by lane; tuples member by member."""
    return joined(a, b, partial(bearer(type(mask)).select, mask))


def joined(a: Any, b: Any, join: Callable[[Any, Any], Any]) -> Any:
    """`join` of the numbers in two tuples of one shape, of duals value by value and part by part;
    constants on which both agree stay what they are.
    """
    if isinstance(a, tuple):
        return alike(a, (joined(x, y, join) for x, y in zip(a, b, strict=True)))
    if is_zero(a, b) or (type(a) is float and type(b) is float and a == b):
        return a
    a, b = plain(a), plain(b)
    of_kind = getattr(bearer(type(a), type(b)), "joined", None)
    return of_kind(a, b, join) if of_kind else join(a, b)


def alike(a: tuple[Any, ...], members: Iterable[Any]) -> Any:
    """A tuple of the same class, with other members."""
    return tuple(members) if type(a) is tuple else type(a)(*members)


def all_lanes(mask: Any) -> Any:
    """Whether the mask holds in every lane: something to `branch` on."""
    return bearer(type(mask)).reduced(mask, "and")


def any_lanes(mask: Any) -> Any:
    """Whether the mask holds in some lane: something to `branch` on."""
    return bearer(type(mask)).reduced(mask, "or")


def branch(
    predicate: Any, then: Callable[[], Any], otherwise: Callable[[], Any], likely: bool = True
) -> Any:
    """`then()` or `otherwise()`, of which only one is computed; both give tuples of one shape.

    For speed alone: a lane's bits must be the same on either side, or they would depend on the
    neighbours that share its pack.

    likely : whether `then` is the side that nearly always runs.
    """
    return bearer(type(predicate)).branch(predicate, then, otherwise, likely)


Turn = Callable[[Any], tuple[Any, Any]]  # of a nested tuple: the next one, and a mask


@unless_borne
def repeat(start: Any, turn: Turn, most: int, like: Any) -> tuple[Any, Any, Any]:
    """Repeat `turn` on numbers until it is finished, each lane for as many turns as it needs.

    A lane that is finished keeps its numbers while others go on, so that its bits do not depend on
    them. An ordered comparison, such as `error > tolerance`, is false with NaN: a lane whose error
    is NaN stops, and holds up no other.

    Parameters
    ----------
    start : tuple
        Numbers, also in nested tuples.
    turn : function
        Takes such a tuple; returns the next one, of the same shape, and a mask of the lanes that
        are not finished with it. Its results for finished lanes are dropped.
    most : int
        Largest number of turns, at least 1.
    like : number
        Every number of the tuple becomes one of this kind: a float, an array, a `Lane` of as many
        lanes as there are, a `Dual` over one of these in as many directions. Only a float's and an
        array's constants and structural zeros remain what they are.

    Returns
    -------
    numbers : tuple
        The last tuple of each lane.
    unfinished : mask
        Lanes that took `most` turns and are not finished.
    turns : number
        Number of turns of each lane.

    Examples
    --------
    Newton's iteration for the square root of 2:

    >>> def turn(numbers):
    ...     (x,) = numbers
    ...     change = 0.5 * (2.0 / x - x)
    ...     return (x + change,), abs(change) > 1e-9
    >>> repeat((1.0,), turn, 20, 1.0)
    ((1.414213562373095,), False, 5.0)
    """
    numbers, is_unfinished, turns = start, True, 0.0
    for _ in range(most):
        after, remain = turn(numbers)
        numbers = where(is_unfinished, after, numbers)
        turns = where(is_unfinished, turns + 1.0, turns)
        is_unfinished = is_unfinished & remain
        if not any_lanes(is_unfinished):
            break
    return numbers, is_unfinished, turns


def apart(count: int) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Decorator: a formula that traces call, instead of having its instructions each time.

    For what is long and nearly never runs: it is compiled once, not in every stage.

    count : how many numbers it returns, in a tuple.
    """

    def decorator(formula: Callable[..., Any]) -> Callable[..., Any]:
        @wraps(formula)
        def evaluated(*numbers: Any) -> Any:
            call = getattr(bearer(*map(type, numbers)), "call", None)
            return call(formula, count, *numbers) if call else formula(*numbers)

        return evaluated

    return decorator


# ---- what the trace is told --------------------------------------------------------------------


@contextmanager
def rounded_as_numpy(number: Any) -> Iterator[None]:
    """Here, `fma` rounds twice: a formula gives the bits that it gives on arrays.

    number : one of the formula's, by whose trace it goes.
    """
    trace = bearer(type(number)).trace_of(number)
    if trace is None:
        yield
        return
    before, trace.rounds_twice = trace.rounds_twice, True
    yield
    trace.rounds_twice = before


@contextmanager
def assumptions(number: Any) -> Iterator[list[Any]]:
    """Here, what a formula asks of `taken_for_granted` holds; gives the masks that it asked for.

    Where they hold, the bits are the same.   number : as of `rounded_as_numpy`.
    """
    masks: list[Any] = []
    trace = bearer(type(number)).trace_of(number)
    if trace is not None:
        trace.assumed = masks
    yield masks
    if trace is not None:
        trace.assumed = None


def taken_for_granted(mask: Any) -> bool:
    """Whether a formula may take it that a mask holds in all lanes: it is looked at afterwards."""
    trace = bearer(type(mask)).trace_of(mask)
    if trace is None or trace.assumed is None:
        return False
    trace.assumed.append(mask)
    return True


# ---- tuples, indices and arrays ----------------------------------------------------------------


def flatten(numbers: Any) -> list[Any]:
    """The members of nested tuples, in order."""
    if isinstance(numbers, tuple):
        return [x for part in numbers for x in flatten(part)]
    return [numbers]


def refilled(shape: Any, numbers: Iterator[Any]) -> Any:
    """Nested tuples of the same shape, with other members, taken in order."""
    if isinstance(shape, tuple):
        return alike(shape, (refilled(part, numbers) for part in shape))
    return next(numbers)


def real(index: Any) -> Any:
    """An integer as a double."""
    return bearer(type(index)).real(index)


def load(array: Any, index: tuple[Any, ...], width: int) -> Any:
    """A pack of `width` consecutive doubles from `index` on; one number in plain Python."""
    return bearer(type(array)).load(array, index, width)


def store(array: Any, index: tuple[Any, ...], number: Any, width: int) -> None:
    """Write a pack to `width` consecutive places from `index` on."""
    bearer(type(array)).store(array, index, plain(number), width)


def prefetch(array: Any, index: tuple[Any, ...], count: int) -> None:
    """Have the memory of `count` consecutive places from `index` on at hand, to write there."""
    bearer(type(array)).prefetch(array, index, count)


def gather(array: Any, axis: int, place: tuple[Any, ...], width: int) -> Any:
    """Lane i from `place` moved by i along `axis`; past the array's end, its last element."""
    return bearer(type(array)).gather(array, axis, place, width)


def scatter(
    array: Any, axis: int, places: Sequence[tuple[Any, ...]], numbers: Sequence[Any], width: int
) -> None:
    """Write lane i of each pack at its place moved by i along `axis`, while inside the array."""
    bearer(type(array)).scatter(array, axis, places, [plain(x) for x in numbers], width)
