"""What a formula may use besides + - * /: one function, every number type.

The number types are float (or NumPy scalar), NumPy array, `Zero`, and the traced `Lane`. A formula
that keeps to these functions runs unchanged as plain Python, over whole arrays, and as SIMD code.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any

import numpy as np

from lierb.kernels.numbers import lanes
from lierb.kernels.numbers.lanes import ArrayRef, Index, Lane, Mask, Predicate
from lierb.kernels.numbers.zero import ZERO, Zero, is_zero

PI = 3.141592653589793


def _traced(*numbers: Any) -> bool:
    return any(isinstance(x, Lane) for x in numbers)


def fma(a: Any, b: Any, c: Any) -> Any:
    """a·b + c, rounded once where traced for a CPU that can; rounded twice in plain Python."""
    # Most of the time of a formula in Python goes by here.
    if isinstance(a, Zero) or isinstance(b, Zero):
        return c
    if isinstance(c, Zero):
        return a * b
    if lanes.HAS_FMA and (isinstance(a, Lane) or isinstance(b, Lane) or isinstance(c, Lane)):
        return a * b + c if _as_numpy.get() else lanes.call_intrinsic("fma", a, b, c)
    return a * b + c


_as_numpy: ContextVar[bool] = ContextVar("as_numpy", default=False)


@contextmanager
def rounded_as_numpy() -> Iterator[None]:
    """Here, `fma` rounds twice everywhere: a formula gives the bits that it gives on arrays."""
    token = _as_numpy.set(True)
    try:
        yield
    finally:
        _as_numpy.reset(token)


def sqrt(x: Any) -> Any:
    if is_zero(x):
        return ZERO
    return lanes.call_intrinsic("sqrt", x) if _traced(x) else np.sqrt(x)


def absolute(x: Any) -> Any:
    if is_zero(x):
        return ZERO
    return lanes.call_intrinsic("fabs", x) if _traced(x) else np.abs(x)


def rint(x: Any) -> Any:
    """Nearest integer, ties to even."""
    return lanes.call_intrinsic("rint", x) if _traced(x) else np.rint(x)


def floor(x: Any) -> Any:
    return lanes.call_intrinsic("floor", x) if _traced(x) else np.floor(x)


def minimum(a: Any, b: Any) -> Any:
    """The smaller one; the other one if one is NaN."""
    a, b = plain(a), plain(b)
    return lanes.call_intrinsic("minnum", a, b) if _traced(a, b) else np.fmin(a, b)


def maximum(a: Any, b: Any) -> Any:
    """The larger one; the other one if one is NaN."""
    if is_zero(a, b):
        return ZERO
    a, b = plain(a), plain(b)
    return lanes.call_intrinsic("maxnum", a, b) if _traced(a, b) else np.fmax(a, b)


def plain(x: Any) -> Any:
    """A structural zero as a number."""
    return 0.0 if is_zero(x) else x


def where(mask: Any, a: Any, b: Any) -> Any:
    """`a` where the mask holds, `b` elsewhere, lane by lane; tuples member by member."""
    if isinstance(a, tuple):
        return tuple(where(mask, x, y) for x, y in zip(a, b, strict=True))
    if _same_constant(a, b):
        return a
    if isinstance(mask, Mask):
        return lanes.select(mask, plain(a), plain(b))
    if isinstance(mask, np.ndarray):
        return np.where(mask, plain(a), plain(b))
    return a if mask else b


def _same_constant(a: Any, b: Any) -> bool:
    return is_zero(a, b) or (type(a) is float and type(b) is float and a == b)


def all_lanes(mask: Any) -> Any:
    """Whether the mask holds in every lane: something to `branch` on."""
    return mask.reduced("and") if isinstance(mask, Mask) else bool(np.all(mask))


def any_lanes(mask: Any) -> Any:
    """Whether the mask holds in some lane: something to `branch` on."""
    return mask.reduced("or") if isinstance(mask, Mask) else bool(np.any(mask))


def branch(
    predicate: Any, then: Callable[[], Any], otherwise: Callable[[], Any], likely: bool = True
) -> Any:
    """`then()` or `otherwise()`, of which only one is computed; both give tuples of one shape.

    For speed alone: a lane's bits must be the same on either side, or they would depend on the
    neighbours that share its pack.

    likely : whether `then` is the side that nearly always runs.
    """
    if not isinstance(predicate, Predicate):
        return then() if predicate else otherwise()
    results: list[Any] = []

    def flat(side: Callable[[], Any]) -> Callable[[], list[Any]]:
        def run() -> list[Any]:
            results.append(side())
            return [plain(x) for x in flatten(results[-1])]

        return run

    merged = iter(lanes.branch_on(predicate, flat(then), flat(otherwise), likely))
    left, right = results
    return _merged(left, right, merged)


def _merged(left: Any, right: Any, numbers: Iterator[Any]) -> Any:
    """`numbers` in the shape of both sides; constants where both sides agree on one."""
    if isinstance(left, tuple):
        return tuple(_merged(a, b, numbers) for a, b in zip(left, right, strict=True))
    number = next(numbers)
    return left if _same_constant(left, right) else number


def flatten(numbers: Any) -> list[Any]:
    """The members of nested tuples, in order."""
    if isinstance(numbers, tuple):
        return [x for part in numbers for x in flatten(part)]
    return [numbers]


def real(index: Any) -> Any:
    """An integer as a double."""
    return index.real() if isinstance(index, Index) else float(index)


def load(array: Any, index: tuple[Any, ...], width: int) -> Any:
    """A pack of `width` consecutive doubles from `index` on; one number in plain Python."""
    return array.load(index, width) if isinstance(array, ArrayRef) else array[index]


def store(array: Any, index: tuple[Any, ...], number: Any, width: int) -> None:
    """Write a pack to `width` consecutive places from `index` on."""
    if isinstance(array, ArrayRef):
        array.store(index, plain(number), width)
    else:
        array[index] = plain(number)


def prefetch(array: Any, index: tuple[Any, ...], count: int) -> None:
    """Have the memory of `count` consecutive places from `index` on at hand, to write there."""
    if isinstance(array, ArrayRef):
        array.prefetch(index, count)


def gather(array: Any, axis: int, place: tuple[Any, ...], width: int) -> Any:
    """Lane i from `place` moved by i along `axis`; past the array's end, its last element."""
    return array.gather(axis, place, width) if isinstance(array, ArrayRef) else array[place]


def scatter(
    array: Any, axis: int, places: Sequence[tuple[Any, ...]], numbers: Sequence[Any], width: int
) -> None:
    """Write lane i of each pack at its place moved by i along `axis`, while inside the array."""
    numbers = [plain(x) for x in numbers]
    if isinstance(array, ArrayRef):
        array.scatter(axis, places, numbers, width)
    else:
        for place, number in zip(places, numbers, strict=True):
            array[place] = number
