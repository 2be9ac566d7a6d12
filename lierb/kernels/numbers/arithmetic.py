"""Formulas use these operations besides + − * /, on every kind of number.

A formula that uses only these functions runs unchanged in plain Python, on arrays, as SIMD code,
and with derivatives (`lierb.kernels.numbers.number`). Each class of numbers implements its own
operations. The functions here dispatch to the class of highest `rank` among the operands; operands
without a `rank` belong to `Plain`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from functools import cache, partial, wraps
from typing import Any

import numpy as np

from lierb.kernels.numbers.number import Mask, Number
from lierb.kernels.numbers.zero import is_zero

PI = 3.141592653589793


Place = tuple[Any, ...]  # indices of an array's element


class Plain:
    """Implement operations on floats, NumPy scalars and arrays, integer indices and bool masks."""

    rank = 0
    sqrt, absolute, rint, floor = np.sqrt, np.abs, np.rint, np.floor
    minimum, maximum = np.fmin, np.fmax
    real = float

    @staticmethod
    def trace_of(number: Number) -> None:
        return None

    @staticmethod
    def fma(a: Number, b: Number, c: Number) -> Number:
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
    def load(array: Any, place: Place, width: int) -> Any:
        return array[place]

    @staticmethod
    def store(array: Any, place: Place, number: Number, width: int) -> None:
        array[place] = number

    @staticmethod
    def prefetch(array: Any, place: Place, count: int) -> None:
        pass

    @staticmethod
    def gather(array: Any, axis: int, place: Place, width: int) -> Any:
        return array[place]

    @staticmethod
    def scatter(
        array: Any, axis: int, places: Sequence[Place], numbers: Sequence[Number], width: int
    ) -> None:
        for place, number in zip(places, numbers, strict=True):
            array[place] = number


def _class_of(*kinds: Any) -> Any:
    ranked = (kind for kind in kinds if hasattr(kind, "rank"))
    return max(ranked, key=lambda kind: kind.rank, default=Plain)


class_of: Callable[..., Any] = cache(_class_of)  # class that implements operations on these types


def overridable(formula: Callable[..., Any]) -> Callable[..., Any]:
    """Decorate a formula that a class of numbers may replace by an operation of its name."""

    @wraps(formula)
    def dispatched(*numbers: Any) -> Any:
        return getattr(class_of(*map(type, numbers)), formula.__name__, formula)(*numbers)

    return dispatched


def fma(a: Number, b: Number, c: Number) -> Any:
    """Return a·b + c, rounded once in traced code on CPUs with FMA, twice in plain Python."""
    # A formula in plain Python spends most of its time here.
    return class_of(type(a), type(b), type(c)).fma(a, b, c)


def sqrt(x: Number) -> Any:
    return class_of(type(x)).sqrt(x)


def absolute(x: Number) -> Any:
    return class_of(type(x)).absolute(x)


def rint(x: Number) -> Any:
    """Return the nearest integer, ties to even."""
    return class_of(type(x)).rint(x)


def floor(x: Number) -> Any:
    return class_of(type(x)).floor(x)


def minimum(a: Number, b: Number) -> Any:
    """Return the smaller number; if one is NaN, the other."""
    a, b = plain(a), plain(b)
    return class_of(type(a), type(b)).minimum(a, b)


def maximum(a: Number, b: Number) -> Any:
    """Return the larger number; if one is NaN, the other."""
    if is_zero(a, b):
        return a
    a, b = plain(a), plain(b)
    return class_of(type(a), type(b)).maximum(a, b)


def plain(x: Number) -> Any:
    """Return x, with 0.0 in place of a structural zero."""
    return 0.0 if is_zero(x) else x


Cuts = tuple[tuple[Mask, int], ...]  # (mask, number of terms where the mask holds)


def horner(z: Number, terms: tuple[float, ...], cuts: Cuts = ()) -> Any:
    """Return Σ terms[k] zᵏ, and where a cut's mask holds, exactly its shorter series."""
    total: Any = terms[-1]
    for k in range(len(terms) - 2, -1, -1):
        for mask, count in cuts:
            if count == k + 1:
                total = where(mask, 0.0, total)
        total = fma(z, total, terms[k])
    return total


# ---- choices -----------------------------------------------------------------------------------


def where(mask: Mask, a: Any, b: Any) -> Any:
    """Return `a` where the mask holds, `b` elsewhere, lane by lane; tuples member by member."""
    return joined(a, b, partial(class_of(type(mask)).select, mask))


def joined(a: Any, b: Any, join: Callable[[Any, Any], Any]) -> Any:
    """Join two tuples of one shape number by number, duals value by value and part by part.

    A constant that is equal in both tuples remains a constant.
    """
    if isinstance(a, tuple):
        return alike(a, (joined(x, y, join) for x, y in zip(a, b, strict=True)))
    if is_zero(a, b) or (type(a) is float and type(b) is float and a == b):
        return a
    a, b = plain(a), plain(b)
    of_kind = getattr(class_of(type(a), type(b)), "joined", None)
    return of_kind(a, b, join) if of_kind else join(a, b)


def alike(a: tuple[Any, ...], members: Iterable[Any]) -> Any:
    """Return a tuple of the class of `a` with these members."""
    return tuple(members) if type(a) is tuple else type(a)(*members)


def all_lanes(mask: Mask) -> Any:
    """Return whether the mask holds in every lane, a predicate for `branch`."""
    return class_of(type(mask)).reduced(mask, "and")


def any_lanes(mask: Mask) -> Any:
    """Return whether the mask holds in some lane, a predicate for `branch`."""
    return class_of(type(mask)).reduced(mask, "or")


def branch(
    predicate: Any, then: Callable[[], Any], otherwise: Callable[[], Any], likely: bool = True
) -> Any:
    """Compute and return either `then()` or `otherwise()`, tuples of one shape.

    A branch only saves time. Both sides must give a lane the same bits; otherwise a lane's bits
    would depend on the other lanes of its pack.

    likely : True if `then` runs nearly always.
    """
    return class_of(type(predicate)).branch(predicate, then, otherwise, likely)


Turn = Callable[[Any], tuple[Any, Any]]  # nested tuple → (next tuple, mask of unfinished lanes)


@overridable
def repeat(start: Any, turn: Turn, most: int, like: Number) -> tuple[Any, Any, Any]:
    """Repeat `turn` on numbers until each lane is finished, each with its own number of turns.

    A finished lane keeps its numbers while others continue, so that its bits do not depend on them.
    An ordered comparison, such as `error > tolerance`, is false with NaN: a lane whose error is NaN
    stops, and the others do not wait for it.

    Parameters
    ----------
    start : tuple
        Numbers or nested tuples of numbers.
    turn : function
        Function of such a tuple. It returns the next tuple, of the same shape, and a mask of the
        unfinished lanes. Results for finished lanes are dropped.
    most : int
        Largest number of turns, at least 1.
    like : number
        Sets the kind of all numbers of the tuple: a float, an array, a `Lane` with the number of
        lanes, or a `Dual` of these with the number of directions. Constants and structural zeros
        are converted, too, except for floats and arrays.

    Returns
    -------
    numbers : tuple
        The last tuple of each lane.
    unfinished : mask
        Lanes that are not finished after `most` turns.
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


@overridable
def for_rows(like: Number, formula: Callable[..., Any], *rows: tuple[Any, ...]) -> list[Any]:
    """Return formula(*row) for each row; traced code has the formula once, in a loop over the rows.

    rows : several rows of numbers, of equal length.   like : sets the kind of all numbers, as in
    `repeat`.   formula : its result is a tuple of numbers.
    """
    return [formula(*row) for row in rows]


def apart(count: int) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Decorate a formula that traced code calls as a function instead of inlining it.

    A long formula that rarely runs is thus compiled once, not in every stage.

    count : number of results; the formula returns a tuple of them.
    """

    def decorator(formula: Callable[..., Any]) -> Callable[..., Any]:
        @wraps(formula)
        def evaluated(*numbers: Any) -> Any:
            call = getattr(class_of(*map(type, numbers)), "call", None)
            return call(formula, count, *numbers) if call else formula(*numbers)

        return evaluated

    return decorator


# ---- settings of a trace -----------------------------------------------------------------------


@contextmanager
def _setting(number: Number, name: str, value: Any) -> Iterator[None]:
    """Change a setting of a number's trace in a context; without a trace there is none."""
    trace = class_of(type(number)).trace_of(number)
    if trace is None:
        yield
        return
    before = getattr(trace, name)
    setattr(trace, name, value)
    yield
    setattr(trace, name, before)


def rounded_as_numpy(number: Number) -> AbstractContextManager[None]:
    """Let `fma` round twice in a context, so that a formula has the same bits as on arrays.

    number : one of the formula's numbers; the setting applies to its trace.
    """
    return _setting(number, "rounds_twice", True)


def recorded_on(tape: Any, number: Number) -> AbstractContextManager[None]:
    """Let branches record the linear numbers of both sides on a tape, in a context.

    number : as in `rounded_as_numpy`.
    """
    return _setting(number, "tape", tape)


@contextmanager
def assumptions(number: Number) -> Iterator[list[Mask]]:
    """Assume, in a context, that the masks passed to `taken_for_granted` hold.

    Yields the list of these masks, which the caller checks. Where all hold, the bits are those of
    the formula without assumptions.   number : as in `rounded_as_numpy`.
    """
    masks: list[Any] = []
    with _setting(number, "assumed", masks):
        yield masks


def taken_for_granted(mask: Mask) -> bool:
    """Return whether a formula may assume that a mask holds in all lanes; see `assumptions`."""
    trace = class_of(type(mask)).trace_of(mask)
    if trace is None or trace.assumed is None:
        return False
    trace.assumed.append(mask)
    return True


# ---- tuples, indices and arrays ----------------------------------------------------------------


def flatten(numbers: Any) -> list[Any]:
    """Return the members of nested tuples, in order."""
    if isinstance(numbers, tuple):
        return [x for part in numbers for x in flatten(part)]
    return [numbers]


def refilled(shape: Any, numbers: Iterator[Number]) -> Any:
    """Return nested tuples of the same shape, with the given numbers in order."""
    if isinstance(shape, tuple):
        return alike(shape, (refilled(part, numbers) for part in shape))
    return next(numbers)


def real(index: Any) -> Any:
    """Return an integer as a double."""
    return class_of(type(index)).real(index)


def load(array: Any, place: Place, width: int) -> Any:
    """Return the pack of `width` elements from index `place` on; one element in plain Python."""
    return class_of(type(array)).load(array, place, width)


def store(array: Any, place: Place, number: Number, width: int) -> None:
    """Write a pack to `width` consecutive elements from index `place` on."""
    class_of(type(array)).store(array, place, plain(number), width)


def prefetch(array: Any, place: Place, count: int) -> None:
    """Prefetch `count` consecutive elements from index `place` on, for writing."""
    class_of(type(array)).prefetch(array, place, count)


def gather(array: Any, axis: int, place: Place, width: int) -> Any:
    """Load lane i from index `place` + i along `axis`, limited to the last element."""
    return class_of(type(array)).gather(array, axis, place, width)


def scatter(
    array: Any, axis: int, places: Sequence[Place], numbers: Sequence[Number], width: int
) -> None:
    """Write lane i of each pack to its index + i along `axis`; skip lanes beyond the array."""
    class_of(type(array)).scatter(array, axis, places, [plain(x) for x in numbers], width)
