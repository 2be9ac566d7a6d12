"""Rounding, remainders, extremes and tables are piecewise functions of users' numbers."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np

from lierb.kernels.functions.elementary import copysign_of, exp, log1p, smooth
from lierb.kernels.functions.user_number import (
    Condition,
    UserNumber,
    choice,
    combined,
    define,
    inverted,
    note_switch,
    raw,
    selected,
    value_of,
)
from lierb.kernels.numbers.arithmetic import absolute, all_lanes, branch, fma, plain
from lierb.kernels.numbers.arithmetic import floor as whole
from lierb.kernels.numbers.arithmetic import rint as nearest
from lierb.kernels.numbers.arithmetic import where as select
from lierb.kernels.numbers.dual import Dual, parts_of
from lierb.kernels.tracing import lane_by_lane
from lierb.kernels.tracing.lanes import Lane, call_intrinsic

FEW_LINES = 32  # of a table; above it a bisection of 8 lanes is faster
WHOLE = 2.0**52  # the floor of smaller quotients is exact


def _steps(name: str, of: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """Make a step function, whose derivative is zero."""

    def function(x: Any) -> Any:
        note_switch(x)
        return UserNumber(of(raw(x))) if isinstance(x, (UserNumber, Condition)) else of(x)

    function.__name__ = name
    return function


def _intrinsic(name: str, x: Any) -> Any:
    return call_intrinsic(name, x) if isinstance(x, Lane) else getattr(np, name)(plain(x))


floor = _steps("floor", whole)
ceil = _steps("ceil", partial(_intrinsic, "ceil"))
trunc = _steps("trunc", partial(_intrinsic, "trunc"))
rint = _steps("rint", nearest)


def rounded(x: Any, digits: int = 0) -> Any:
    """Round to a number of decimals, halves to even."""
    return rint(x * 10.0**digits) / 10.0**digits if digits else rint(x)


def _of_two(
    of: Callable[[Any, Any], Any], slopes: Callable[[Any, Any], tuple[Any, Any]]
) -> Callable[[Any, Any], Any]:
    """Make a function of two numbers from its value and its piecewise constant slopes."""

    def function(x: Any, y: Any) -> Any:
        if not any(isinstance(n, (Dual, Condition)) for n in (x, y)):
            return of(x, y)
        note_switch(x, y)
        value = function(value_of(x), value_of(y))
        if not (parts_of(x) or parts_of(y)):
            return UserNumber(value)
        return combined(x, y, lambda a, b: value, *slopes(raw(x), raw(y)))

    return function


def _rest(x: Any, y: Any) -> Any:
    """Compute x − ⌊x/y⌋ y of lanes, by the C library if ⌊x/y⌋ is inexact."""
    quotient = plain(x) / plain(y)
    fits = (absolute(quotient) < WHOLE) & (absolute(y) < math.inf)
    return branch(
        all_lanes(fits),
        lambda: fma(-whole(quotient), y, x),
        lambda: select(fits, fma(-whole(quotient), y, x), lane_by_lane.call_library("fmod", x, y)),
    )


def _remainder(x: Any, y: Any) -> Any:
    if not (isinstance(x, Lane) or isinstance(y, Lane)):
        return np.remainder(plain(x), plain(y))
    # Rounding may raise the quotient to a whole number; the remainder is then too small by y.
    rest = _rest(x, y)
    other_side = ((rest < 0.0) & (y > 0.0)) | ((rest > 0.0) & (y < 0.0))
    rest = select(other_side, rest + y, rest)
    return select(rest == 0.0, copysign_of(0.0, y), rest)


def _fmod(x: Any, y: Any) -> Any:
    if not (isinstance(x, Lane) or isinstance(y, Lane)):
        return np.fmod(plain(x), plain(y))
    size, step = absolute(x), absolute(y)
    rest = _rest(size, step)
    return copysign_of(select(rest < 0.0, rest + step, rest), x)


def _floor_divide(x: Any, y: Any) -> Any:
    if not (isinstance(x, Lane) or isinstance(y, Lane)):
        return np.floor_divide(plain(x), plain(y))
    # Algorithm of NumPy and Python, with the same bits.
    rest = _fmod(x, y)
    quotient = (x - rest) / y
    other_side = ((rest < 0.0) & (y > 0.0)) | ((rest > 0.0) & (y < 0.0))
    quotient = select(other_side, quotient - 1.0, quotient)
    result = whole(quotient)
    result = select(quotient - result > 0.5, result + 1.0, result)
    result = select(quotient == 0.0, copysign_of(0.0, x / y), result)
    return select(y == 0.0, x / y, result)


def _fraction(x: Any) -> Any:
    part = select(absolute(x) == math.inf, 0.0, x - _intrinsic("trunc", x))
    return copysign_of(part, x)


fraction = smooth("fraction", _fraction, lambda x, y: 1.0)
remainder = _of_two(_remainder, lambda x, y: (1.0, -_floor_divide(x, y)))
fmod = _of_two(_fmod, lambda x, y: (1.0, -_intrinsic("trunc", x / y)))
floor_divide = _of_two(_floor_divide, lambda x, y: (0.0, 0.0))
copysign = _of_two(copysign_of, lambda x, y: (copysign_of(1.0, x) * copysign_of(1.0, y), 0.0))


def _predicate(holds: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """Make a function whose result is a condition."""

    def function(x: Any) -> Any:
        mask = holds(raw(x))
        return Condition(mask) if isinstance(x, (UserNumber, Condition)) else mask

    return function


isnan = _predicate(lambda x: inverted(x == x))
isfinite = _predicate(lambda x: absolute(x) < math.inf)
isinf = _predicate(lambda x: absolute(x) == math.inf)
signbit = _predicate(lambda x: copysign_of(1.0, x) < 0.0)


def logaddexp(a: Any, b: Any) -> Any:
    """Compute log(exp a + exp b)."""
    apart = choice((raw(a) == raw(b)) & isinf(raw(a)), 0.0, a - b)
    return maximum(a, b) + log1p(exp(-abs(apart)))


def maximum(a: Any, b: Any) -> Any:
    """Return the larger of two numbers; NaN if either is."""
    return choice((raw(a) >= raw(b)) | isnan(raw(a)), a, b)


def minimum(a: Any, b: Any) -> Any:
    """Return the smaller of two numbers; NaN if either is."""
    return choice((raw(a) <= raw(b)) | isnan(raw(a)), a, b)


def fmax(a: Any, b: Any) -> Any:
    """Return the larger of two numbers; the other if one is NaN."""
    return choice((raw(a) >= raw(b)) | isnan(raw(b)), a, b)


def fmin(a: Any, b: Any) -> Any:
    """Return the smaller of two numbers; the other if one is NaN."""
    return choice((raw(a) <= raw(b)) | isnan(raw(b)), a, b)


def clipped(x: Any, lower: Any = None, upper: Any = None) -> Any:
    """Limit a number to the interval from `lower` to `upper`; None for no bound."""
    x = x if lower is None else maximum(x, lower)
    return x if upper is None else minimum(x, upper)


def _signum(x: Any) -> Any:
    return selected(x > 0.0, 1.0, selected(x < 0.0, -1.0, absolute(0.0 * x)))  # NaN stays


sign = _steps("sign", _signum)


def heaviside(x: Any, at_zero: Any) -> Any:
    """Return 0 below zero, 1 above, and `at_zero` at zero."""
    note_switch(x)
    step = _signum(raw(x))
    value = choice(step > 0.0, 1.0, choice(step < 0.0, 0.0, choice(step == 0.0, at_zero, step)))
    return UserNumber(value) if isinstance(value, Lane) else value


def interpolated(x: Any, xs: Any, ys: Any, left: Any = None, right: Any = None) -> Any:
    """Interpolate linearly between the points (xs, ys); constant, `left` or `right` beyond them.

    A short table evaluates every line, at a comparison and three choices each. A table of more than
    FEW_LINES constant points is searched by bisection.
    """
    points = list(zip(xs, ys, strict=True))
    lines: list[Any] = [(x0, y0, (y1 - y0) / (x1 - x0)) for (x0, y0), (x1, y1) in pairwise(points)]
    lines = lines or [(*points[0], 0.0)]
    are_constant = all(isinstance(n, (int, float, np.number)) for line in lines for n in line)
    if len(lines) > FEW_LINES and are_constant and isinstance(raw(x), Lane):
        columns = [[float(n) for n in column] for column in zip(*lines, strict=True)]
        at, value, slope = map(UserNumber, lane_by_lane.row_at(raw(x), columns))
    else:
        at, value, slope = lines[0]
        for line in lines[1:]:
            beyond = raw(x) >= raw(line[0])
            at, value, slope = (
                choice(beyond, new, old) for new, old in zip(line, (at, value, slope), strict=True)
            )
    (first, start), (last, end) = points[0], points[-1]
    result = value + slope * (x - at)
    result = choice(raw(x) < raw(first), start if left is None else left, result)
    result = choice(raw(x) == raw(last), end, result)
    return choice(raw(x) > raw(last), end if right is None else right, result)


def _reflected(function: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
    return lambda self, other: function(other, self)


def divmod(x: Any, y: Any) -> Any:
    return floor_divide(x, y), remainder(x, y)


define(
    __mod__=remainder, __rmod__=_reflected(remainder),
    __floordiv__=floor_divide, __rfloordiv__=_reflected(floor_divide),
    __divmod__=divmod, __rdivmod__=_reflected(divmod),
    __floor__=floor, __ceil__=ceil, __trunc__=trunc,
    __round__=lambda self, digits=None: rounded(self, digits or 0),
)  # fmt: skip


def _of_number(name: str) -> Callable[..., Any]:
    method = getattr(UserNumber, name)
    return lambda self, *others: method(self.number(), *others)


for _name in (
    "add", "radd", "sub", "rsub", "mul", "rmul", "truediv", "rtruediv", "pow", "rpow", "mod",
    "neg", "abs", "lt", "le", "gt", "ge",
):  # fmt: skip
    setattr(Condition, f"__{_name}__", _of_number(f"__{_name}__"))
