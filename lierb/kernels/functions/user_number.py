"""What functions of the user's compute with: dual numbers, with all that users expect of a number.

Operators, methods, NumPy's functions, and comparisons that give conditions. Without parts they are
plain numbers.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial, reduce
from itertools import pairwise
from typing import Any

import numpy as np

from lierb.kernels.functions.fingerprint import TEXT, UnfitFunctionError
from lierb.kernels.numbers.arithmetic import (
    PI,
    absolute,
    all_lanes,
    branch,
    floor,
    fma,
    plain,
    rint,
)
from lierb.kernels.numbers.arithmetic import sqrt as root
from lierb.kernels.numbers.arithmetic import where as select
from lierb.kernels.numbers.dual import Dual, parts_of, side_by_side
from lierb.kernels.numbers.trigonometry import SINCOS_RANGE, atan2, sincos
from lierb.kernels.numbers.zero import ZERO, Zero, is_zero
from lierb.kernels.tracing.lane_by_lane import call_library, row_at
from lierb.kernels.tracing.lanes import Lane, Mask, call_intrinsic

FEW_LINES = 32  # of a table; from there on a bisection of 8 lanes is less work
HUGE = 2.0**1000  # beyond, sums of two numbers may overflow
WHOLE = 2.0**52  # quotients below it have a floor that is exact

DECIDES = (
    "it decides by a number of the motion; write lierb.where(condition, a, b) instead of if, & and "
    "| instead of and and or, (a < x) & (x < b) instead of a < x < b"
)
NO_PLAIN_NUMBER = (
    "it needs a plain number, which one of many bodies at once is not; write np.trunc(x) for "
    "int(x), lierb.table(x, xs, ys) for xs[x], and np.zeros(n) in the function for an array to fill"
)


class UserNumber(Dual):
    """factors : the two numbers whose product it is, if it is one: a sum with it is then fused."""

    __slots__ = ("factors",)
    __hash__ = None
    rank = 4

    def __init__(
        self, value: Any, parts: tuple[Any, ...] = (), factors: tuple[Any, ...] = ()
    ) -> None:
        super().__init__(value, parts)
        self.factors = factors

    @staticmethod
    def fma(a: Any, b: Any, c: Any) -> Any:
        return a * b + c

    def __repr__(self) -> str:
        raise UnfitFunctionError(TEXT)

    def __format__(self, _: str) -> str:
        raise UnfitFunctionError(TEXT)

    def __add__(self, other: Any) -> Any:
        return _combined(self, other, _sum, 1.0, 1.0)

    __radd__ = __add__

    def __sub__(self, other: Any) -> Any:
        return _combined(self, other, _difference, 1.0, -1.0)

    def __rsub__(self, other: Any) -> Any:
        return _combined(other, self, _difference, 1.0, -1.0)

    def __mul__(self, other: Any) -> Any:
        if not _is_number(other):
            return NotImplemented
        factors = self.value, value_of(other)
        product = _combined(self, other, lambda x, y: factors[0] * factors[1], *factors[::-1])
        product.factors = factors
        return product

    __rmul__ = __mul__

    def __truediv__(self, other: Any) -> Any:
        return _quotient(self, other)

    def __rtruediv__(self, other: Any) -> Any:
        return _quotient(other, self)

    def __pos__(self) -> UserNumber:
        return self

    def __abs__(self) -> UserNumber:
        sign = _chosen(raw(self) < 0.0, -1.0, 1.0)
        return self.along(sign, absolute_value(self.value))

    def __pow__(self, exponent: Any) -> Any:
        return power(self, exponent)

    def __rpow__(self, base: Any) -> Any:
        return power(base, self)

    def __mod__(self, other: Any) -> Any:
        return remainder(self, other)

    def __rmod__(self, other: Any) -> Any:
        return remainder(other, self)

    def __floordiv__(self, other: Any) -> Any:
        return floor_divide(self, other)

    def __rfloordiv__(self, other: Any) -> Any:
        return floor_divide(other, self)

    def __divmod__(self, other: Any) -> Any:
        return floor_divide(self, other), remainder(self, other)

    def __rdivmod__(self, other: Any) -> Any:
        return floor_divide(other, self), remainder(other, self)

    def __round__(self, digits: int | None = None) -> Any:
        return rounded(self, digits or 0)

    def __floor__(self) -> Any:
        return whole_floor(self)

    def __ceil__(self) -> Any:
        return whole_ceil(self)

    def __trunc__(self) -> Any:
        return whole_part(self)

    def conjugate(self) -> UserNumber:
        return self

    @property
    def real(self) -> UserNumber:
        return self

    @property
    def imag(self) -> float:
        return 0.0

    def __lt__(self, other: Any) -> Any:
        return _compared(self, other, lambda x, y: x < y)

    def __le__(self, other: Any) -> Any:
        return _compared(self, other, lambda x, y: x <= y)

    def __gt__(self, other: Any) -> Any:
        return _compared(self, other, lambda x, y: x > y)

    def __ge__(self, other: Any) -> Any:
        return _compared(self, other, lambda x, y: x >= y)

    def __eq__(self, other: Any) -> Any:
        return _compared(self, other, lambda x, y: x == y)

    def __ne__(self, other: Any) -> Any:
        equal = self == other
        return equal if equal is NotImplemented else ~equal  # true for NaN

    def __bool__(self) -> bool:
        raise TypeError(DECIDES)

    def __float__(self) -> float:
        raise TypeError(NO_PLAIN_NUMBER)

    __int__ = __index__ = __complex__ = __float__


class Condition:
    """What a comparison of such numbers gives: true or false for each body.

    As with NumPy's own, &, |, ^ and ~ combine conditions, and in arithmetic one is 1 or 0.
    """

    __slots__ = ("mask",)
    __hash__ = None  # type: ignore[assignment]

    def __init__(self, mask: Any) -> None:
        self.mask = mask

    __repr__, __format__ = UserNumber.__repr__, UserNumber.__format__

    def __bool__(self) -> bool:
        raise TypeError(DECIDES)

    def __and__(self, other: Any) -> Any:
        return _joined(self, other, lambda x, y: x & y)

    def __or__(self, other: Any) -> Any:
        return _joined(self, other, lambda x, y: x | y)

    def __xor__(self, other: Any) -> Any:
        return (self & ~other) | (~self & other) if isinstance(other, Condition) else self != other

    __rand__, __ror__, __rxor__ = __and__, __or__, __xor__

    def __invert__(self) -> Condition:
        return Condition(_inverted(self.mask))

    def __eq__(self, other: Any) -> Any:
        return ~(self ^ other) if isinstance(other, Condition) else self if other else ~self

    def __ne__(self, other: Any) -> Any:
        return ~(self == other)

    def number(self) -> UserNumber:
        """1 where it holds, 0 elsewhere."""
        return UserNumber(select(self.mask, 1.0, 0.0))


def _joined(a: Condition, b: Any, combine: Callable[[Any, Any], Any]) -> Any:
    if not isinstance(b, (Condition, bool, np.bool_)):
        return NotImplemented
    return Condition(combine(a.mask, b.mask if isinstance(b, Condition) else bool(b)))


def _inverted(mask: Any) -> Any:
    return ~mask if isinstance(mask, (Mask, np.ndarray)) else not mask


def _compared(a: UserNumber, b: Any, holds: Callable[[Any, Any], Any]) -> Any:
    return Condition(holds(raw(a), raw(b))) if _is_number(b) else NotImplemented


def raw(x: Any) -> Any:
    """The number itself, with no derivative left."""
    while isinstance(x, Dual):
        x = x.value
    if isinstance(x, Condition):
        return select(x.mask, 1.0, 0.0)
    return float(x) if isinstance(x, (int, np.number)) else plain(x)


def _is_number(x: Any) -> bool:
    return isinstance(x, (Dual, Condition, Lane, Zero, int, float, np.number, np.bool_))


# What a user may come to read in a message.
UserNumber.__name__ = UserNumber.__qualname__ = "number"
Condition.__name__ = Condition.__qualname__ = "condition"


def value_of(x: Any) -> Any:
    if isinstance(x, Dual):
        return x.value
    return raw(x) if isinstance(x, (Condition, int, np.integer)) else x


def _combined(a: Any, b: Any, operation: Callable[[Any, Any], Any], left: Any, right: Any) -> Any:
    """operation(a, b), with the derivatives `left` and `right` of its value."""
    if not (_is_number(a) and _is_number(b)):
        return NotImplemented
    parts = (_total(left, p, right, q) for p, q in side_by_side(a, b))
    return _kind_of(a, b)(operation(a, b), tuple(parts))


def _kind_of(*numbers: Any) -> type[Dual]:
    """The class of what is made of them: within a user's number there may be other duals."""
    return UserNumber if any(isinstance(x, UserNumber) for x in numbers) else Dual


def _sum(a: Any, b: Any) -> Any:
    for x, y in ((a, b), (b, a)):
        if isinstance(x, UserNumber) and x.factors:
            left, right = x.factors
            return fma(left, right, value_of(y))
    return value_of(a) + value_of(b)


def _difference(a: Any, b: Any) -> Any:
    return value_of(a) - value_of(b)  # not fused: x·x − x·x shall be zero


def _total(left: Any, p: Any, right: Any, q: Any) -> Any:
    """left·p + right·q; slopes of ±1 cost no product."""
    if _is_sign(left):
        return _scaled(left, p) + _scaled(right, q)
    return fma(left, p, _scaled(right, q))


def _scaled(slope: Any, part: Any) -> Any:
    if is_zero(part):
        return ZERO
    if _is_sign(slope):
        return part if slope == 1.0 else -part
    return slope * part


def _is_sign(slope: Any) -> bool:
    return isinstance(slope, float) and slope in (1.0, -1.0)


def _quotient(a: Any, b: Any) -> Any:
    if not (_is_number(a) and _is_number(b)):
        return NotImplemented
    top, bottom = value_of(a), value_of(b)
    if not parts_of(b):
        return UserNumber(top / bottom, tuple(part / bottom for part in parts_of(a)))
    inverse = 1.0 / bottom
    value = top * inverse
    return _combined(a, b, lambda x, y: value, inverse, -(value * inverse))


def where(condition: Any, a: Any, b: Any) -> Any:
    """Choose `a` where the condition holds, `b` elsewhere, in functions given to lierb.

    It replaces `if` there. Both values are computed.

    Parameters
    ----------
    condition : bool or array_like of bool
        The condition.
    a : float, array_like or tuple of them
        Value where it holds.
    b : float, array_like or tuple of them
        Value elsewhere.

    Returns
    -------
    float, ndarray or tuple of them
        The chosen values.

    Examples
    --------
    >>> import lierb
    >>> lierb.where(2.0 > 1.0, 10.0, 20.0)
    10.0
    """
    if any(isinstance(x, np.ndarray) for x in (condition, a, b)) or isinstance(condition, list):
        return np.where(condition, a, b)
    if isinstance(a, (tuple, list)) or isinstance(b, (tuple, list)):
        count = len(a) if isinstance(a, (tuple, list)) else len(b)
        pairs = (x if isinstance(x, (tuple, list)) else (x,) * count for x in (a, b))
        return tuple(where(condition, x, y) for x, y in zip(*pairs, strict=True))
    return choice(condition, a, b)


def choice(condition: Any, a: Any, b: Any) -> Any:
    """`where` of two numbers."""
    chosen = _chosen(condition, a, b)
    of_constants = not isinstance(a, Lane) and not isinstance(b, Lane)
    return UserNumber(chosen) if of_constants and isinstance(chosen, Lane) else chosen


def _chosen(condition: Any, a: Any, b: Any) -> Any:
    mask = condition.mask if isinstance(condition, Condition) else condition
    if isinstance(mask, (UserNumber, Lane)):  # as NumPy has it: any number but 0
        mask = _inverted(raw(mask) == 0.0)
    a, b = (x.number() if isinstance(x, Condition) else x for x in (a, b))
    return select(mask, a, b)


# ---- elementary functions ----------------------------------------------------------------------


def absolute_value(x: Any) -> Any:
    return abs(x) if isinstance(x, UserNumber) else absolute(x)


def _library(name: str, *operands: Any) -> Any:
    """The C library's function, number by number."""
    if any(isinstance(x, Lane) for x in operands):
        return call_library(name, *map(plain, operands))
    if hasattr(np, _IN_NUMPY.get(name, name)):
        return getattr(np, _IN_NUMPY.get(name, name))(*map(plain, operands))
    found = np.frompyfunc(getattr(math, name), len(operands), 1)(*map(plain, operands))
    return np.asarray(found, dtype=np.float64)[()]


_IN_NUMPY = {
    "pow": "power", "asin": "arcsin", "acos": "arccos", "asinh": "arcsinh", "acosh": "arccosh",
    "atanh": "arctanh",
}  # fmt: skip


def _sine_or_cosine(name: str, x: Any) -> Any:
    which = 0 if name == "sin" else 1
    near = absolute(x) <= SINCOS_RANGE
    found = branch(
        all_lanes(near),
        lambda: sincos(x)[which],
        lambda: select(near, sincos(x)[which], _library(name, x)),
    )
    return select(x == 0.0, x, found) if name == "sin" else found  # sin −0 is −0


def _elementary(
    name: str, of: Callable[[Any], Any], slope: Callable[[Any, Any], Any]
) -> Callable[[Any], Any]:
    """The function `name` from its value and from its slope at (x, value)."""

    def function(x: Any) -> Any:
        if isinstance(x, Condition):
            x = x.number()
        if not isinstance(x, Dual):
            return of(x)
        value = function(x.value)
        return x.along(slope(x.value, value), value) if x.parts else type(x)(value)

    function.__name__ = name
    return function


sin: Callable[[Any], Any] = _elementary("sin", partial(_sine_or_cosine, "sin"), lambda x, y: cos(x))
cos: Callable[[Any], Any] = _elementary(
    "cos", partial(_sine_or_cosine, "cos"), lambda x, y: -sin(x)
)
tan = _elementary("tan", partial(_library, "tan"), lambda x, y: 1.0 + y * y)
exp = _elementary("exp", partial(_library, "exp"), lambda x, y: y)
expm1 = _elementary("expm1", partial(_library, "expm1"), lambda x, y: y + 1.0)
log = _elementary("log", partial(_library, "log"), lambda x, y: 1.0 / x)
log1p = _elementary("log1p", partial(_library, "log1p"), lambda x, y: 1.0 / (1.0 + x))
sqrt = _elementary("sqrt", root, lambda x, y: 0.5 / y)
sinh: Callable[[Any], Any] = _elementary("sinh", partial(_library, "sinh"), lambda x, y: cosh(x))
cosh: Callable[[Any], Any] = _elementary("cosh", partial(_library, "cosh"), lambda x, y: sinh(x))
tanh = _elementary("tanh", partial(_library, "tanh"), lambda x, y: 1.0 - y * y)
arcsin = _elementary(
    "arcsin", partial(_library, "asin"), lambda x, y: 1.0 / sqrt((1.0 - x) * (1.0 + x))
)
arccos = _elementary(
    "arccos", partial(_library, "acos"), lambda x, y: -1.0 / sqrt((1.0 - x) * (1.0 + x))
)
arctan = _elementary("arctan", lambda x: _angle(x, 1.0), lambda x, y: 1.0 / (1.0 + x * x))
arcsinh = _elementary("arcsinh", partial(_library, "asinh"), lambda x, y: 1.0 / sqrt(1.0 + x * x))
arccosh = _elementary(
    "arccosh", partial(_library, "acosh"), lambda x, y: 1.0 / sqrt((x - 1.0) * (x + 1.0))
)
arctanh = _elementary(
    "arctanh", partial(_library, "atanh"), lambda x, y: 1.0 / ((1.0 - x) * (1.0 + x))
)
cbrt = _elementary("cbrt", partial(_library, "cbrt"), lambda x, y: 1.0 / (3.0 * y * y))
exp2 = _elementary("exp2", partial(_library, "exp2"), lambda x, y: math.log(2.0) * y)
erf: Callable[[Any], Any] = _elementary(
    "erf", partial(_library, "erf"), lambda x, y: 2.0 / math.sqrt(math.pi) * exp(-(x * x))
)
erfc: Callable[[Any], Any] = _elementary(
    "erfc", partial(_library, "erfc"), lambda x, y: -2.0 / math.sqrt(math.pi) * exp(-(x * x))
)


def _angle(y: Any, x: Any) -> Any:
    """atan2 of plain numbers with C's signs of zeros, infinities, and no overflow on the way."""
    y, x = plain(y), plain(x)
    ax, ay = absolute(x), absolute(y)
    are_infinite = (ax == math.inf) & (ay == math.inf)
    down = select((ax > HUGE) | (ay > HUGE), 0.125, 1.0)
    top, right = select(are_infinite, 1.0, ay * down), select(are_infinite, 1.0, ax * down)
    angle = atan2(top, _copysign(right, x))
    angle = select((top == 0.0) & (_copysign(1.0, x) < 0.0), PI, angle)
    return _copysign(angle, y)


def arctan2(y: Any, x: Any) -> Any:
    """The angle of (x, y), rad."""
    if not (isinstance(y, Dual) or isinstance(x, Dual)):
        return _angle(y, x)
    top, right = value_of(y), value_of(x)
    value = arctan2(top, right)
    if not (parts_of(y) or parts_of(x)):
        return _kind_of(y, x)(value)
    inverse = 1.0 / (top * top + right * right)
    return _combined(y, x, lambda a, b: value, right * inverse, -(top * inverse))


def power(base: Any, exponent: Any) -> Any:
    """base ** exponent; a whole exponent by products."""
    if isinstance(exponent, (int, np.integer)) or (
        isinstance(exponent, float) and exponent.is_integer() and abs(exponent) <= 16
    ):
        return _whole_power(base, int(exponent))
    if isinstance(exponent, float) and abs(exponent) == 0.5:
        found = choice(raw(base) == -math.inf, math.inf, sqrt(base + 0.0))  # of −0 it is +0
        return found if exponent > 0.0 else 1.0 / found
    if not (isinstance(base, Dual) or isinstance(exponent, Dual)):
        return _library("pow", base, exponent)
    x, n = value_of(base), value_of(exponent)
    value = power(x, n)
    if not (parts_of(base) or parts_of(exponent)):
        return _kind_of(base, exponent)(value)
    by_exponent = value * log(x) if parts_of(exponent) else ZERO
    return _combined(base, exponent, lambda a, b: value, n * power(x, n - 1.0), by_exponent)


def _whole_power(base: Any, exponent: int) -> Any:
    if exponent < 0:
        return 1.0 / _whole_power(base, -exponent)
    if exponent < 2:
        return base if exponent else 1.0
    half = _whole_power(base, exponent // 2)
    return half * half * base if exponent % 2 else half * half


def square(x: Any) -> Any:
    return x * x


def reciprocal(x: Any) -> Any:
    return 1.0 / x


def hypot(*numbers: Any) -> Any:
    """Root of the sum of squares, by a power of two where those overflow or underflow."""
    sizes = [absolute(raw(x)) for x in numbers]
    largest = reduce(lambda a, b: select(b > a, b, a), sizes)
    down, up = largest > 2.0**500, largest < 2.0**-500
    scale = UserNumber(select(down, 2.0**-600, select(up, 2.0**600, 1.0)))
    found = sqrt(sum((x * scale) * (x * scale) for x in numbers)) / scale
    is_infinite = reduce(lambda a, b: a | b, [size == math.inf for size in sizes])
    return choice(is_infinite, math.inf, found)


def logarithm(x: Any, base: float | None = None) -> Any:
    return log(x) if base is None else log(x) / math.log(base)


def log10(x: Any) -> Any:
    return log(x) / math.log(10.0)


def log2(x: Any) -> Any:
    return log(x) / math.log(2.0)


class Float(float):
    """`float` in functions of the user's: numbers of many bodies stay what they are."""

    def __new__(cls, x: Any = 0.0) -> Any:
        return x if isinstance(x, Dual) else float(x)


# ---- by steps and by comparison ----------------------------------------------------------------


def _steps(name: str, of: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """A function with steps: its slope is zero."""

    def function(x: Any) -> Any:
        return UserNumber(of(raw(x))) if isinstance(x, (UserNumber, Condition)) else of(x)

    function.__name__ = name
    return function


def _intrinsic(name: str, x: Any) -> Any:
    return call_intrinsic(name, x) if isinstance(x, Lane) else getattr(np, name)(plain(x))


whole_floor = _steps("floor", floor)
whole_ceil = _steps("ceil", partial(_intrinsic, "ceil"))
whole_part = _steps("trunc", partial(_intrinsic, "trunc"))
nearest = _steps("rint", rint)


def rounded(x: Any, digits: int = 0) -> Any:
    """To so many decimals; halves to even."""
    return nearest(x * 10.0**digits) / 10.0**digits if digits else nearest(x)


def _of_two(
    of: Callable[[Any, Any], Any], slopes: Callable[[Any, Any], tuple[Any, Any]]
) -> Callable[[Any, Any], Any]:
    """A function of two numbers from its value and its slopes, which are constant by parts."""

    def function(x: Any, y: Any) -> Any:
        if not any(isinstance(n, (Dual, Condition)) for n in (x, y)):
            return of(x, y)
        value = function(value_of(x), value_of(y))
        if not (parts_of(x) or parts_of(y)):
            return UserNumber(value)
        return _combined(x, y, lambda a, b: value, *slopes(raw(x), raw(y)))

    return function


def _exact_quotient(x: Any, y: Any, q: Callable[[Any], Any], name: str) -> Any:
    """x − q(x/y) y for lanes: exact where the quotient's whole part is, else the C library's."""
    quotient = plain(x) / plain(y)
    fits = (absolute(quotient) < WHOLE) & (absolute(y) < math.inf)
    return branch(
        all_lanes(fits),
        lambda: fma(-q(quotient), y, x),
        lambda: select(fits, fma(-q(quotient), y, x), call_library(name, x, y)),
    )


def _remainder(x: Any, y: Any) -> Any:
    if not (isinstance(x, Lane) or isinstance(y, Lane)):
        return np.remainder(plain(x), plain(y))
    # The quotient, rounded, may have reached a whole number: then the rest is one y too small.
    rest = _exact_quotient(x, y, floor, "fmod")
    other_side = ((rest < 0.0) & (y > 0.0)) | ((rest > 0.0) & (y < 0.0))
    rest = select(other_side, rest + y, rest)
    return select(rest == 0.0, _copysign(0.0, y), rest)


def _fmod(x: Any, y: Any) -> Any:
    if not (isinstance(x, Lane) or isinstance(y, Lane)):
        return np.fmod(plain(x), plain(y))
    size, step = absolute(x), absolute(y)
    rest = _exact_quotient(size, step, floor, "fmod")
    return _copysign(select(rest < 0.0, rest + step, rest), x)


def _floor_divide(x: Any, y: Any) -> Any:
    if not (isinstance(x, Lane) or isinstance(y, Lane)):
        return np.floor_divide(plain(x), plain(y))
    # As NumPy and Python do it, to the bit.
    rest = _fmod(x, y)
    quotient = (x - rest) / y
    other_side = ((rest < 0.0) & (y > 0.0)) | ((rest > 0.0) & (y < 0.0))
    quotient = select(other_side, quotient - 1.0, quotient)
    whole = floor(quotient)
    whole = select(quotient - whole > 0.5, whole + 1.0, whole)
    whole = select(quotient == 0.0, _copysign(0.0, x / y), whole)
    return select(y == 0.0, x / y, whole)


def _copysign(x: Any, y: Any) -> Any:
    if isinstance(x, Lane) or isinstance(y, Lane):
        return call_intrinsic("copysign", plain(x), plain(y))
    return np.copysign(plain(x), plain(y))


def _fraction(x: Any) -> Any:
    part = select(absolute(x) == math.inf, 0.0, x - _intrinsic("trunc", x))
    return _copysign(part, x)


fraction = _elementary("fraction", _fraction, lambda x, y: 1.0)
remainder = _of_two(_remainder, lambda x, y: (1.0, -_floor_divide(x, y)))
fmod = _of_two(_fmod, lambda x, y: (1.0, -_intrinsic("trunc", x / y)))
floor_divide = _of_two(_floor_divide, lambda x, y: (0.0, 0.0))
copysign = _of_two(_copysign, lambda x, y: (_copysign(1.0, x) * _copysign(1.0, y), 0.0))


def is_nan(x: Any) -> Any:
    return _condition(x, lambda number: _inverted(number == number))


def is_finite(x: Any) -> Any:
    return _condition(x, lambda number: absolute(number) < math.inf)


def is_infinite(x: Any) -> Any:
    return _condition(x, lambda number: absolute(number) == math.inf)


def has_sign_bit(x: Any) -> Any:
    return _condition(x, lambda number: _copysign(1.0, number) < 0.0)


def logaddexp(a: Any, b: Any) -> Any:
    """log(exp a + exp b)."""
    apart = choice((raw(a) == raw(b)) & is_infinite(raw(a)), 0.0, a - b)
    return maximum(a, b) + log1p(exp(-abs(apart)))


def _condition(x: Any, holds: Callable[[Any], Any]) -> Any:
    found = holds(raw(x))
    return Condition(found) if isinstance(x, (UserNumber, Condition)) else found


def maximum(a: Any, b: Any) -> Any:
    """The larger one; NaN where one is."""
    return choice((raw(a) >= raw(b)) | is_nan(raw(a)), a, b)


def minimum(a: Any, b: Any) -> Any:
    """The smaller one; NaN where one is."""
    return choice((raw(a) <= raw(b)) | is_nan(raw(a)), a, b)


def fmax(a: Any, b: Any) -> Any:
    """The larger one; the other one where one is NaN."""
    return choice((raw(a) >= raw(b)) | is_nan(raw(b)), a, b)


def fmin(a: Any, b: Any) -> Any:
    """The smaller one; the other one where one is NaN."""
    return choice((raw(a) <= raw(b)) | is_nan(raw(b)), a, b)


def clipped(x: Any, lower: Any = None, upper: Any = None) -> Any:
    """No less than `lower`, no more than `upper`; None for no bound."""
    x = x if lower is None else maximum(x, lower)
    return x if upper is None else minimum(x, upper)


def larger(*numbers: Any) -> Any:
    """The largest of several numbers, or of a sequence, as Python's max has it."""
    return _folded(numbers, lambda a, b: choice(raw(b) > raw(a), b, a))


def smaller(*numbers: Any) -> Any:
    """The smallest of several numbers, or of a sequence, as Python's min has it."""
    return _folded(numbers, lambda a, b: choice(raw(b) < raw(a), b, a))


def _folded(numbers: tuple[Any, ...], chosen: Callable[[Any, Any], Any]) -> Any:
    return reduce(chosen, numbers[0] if len(numbers) == 1 else numbers)


def sign(x: Any) -> Any:
    return _sign(x)


_sign = _steps("sign", lambda x: _signum(x))


def _signum(x: Any) -> Any:
    return _chosen(x > 0.0, 1.0, _chosen(x < 0.0, -1.0, absolute(0.0 * x)))  # NaN stays


def heaviside(x: Any, at_zero: Any) -> Any:
    """0 below zero, 1 above, `at_zero` at zero."""
    step = _signum(raw(x))
    found = choice(step > 0.0, 1.0, choice(step < 0.0, 0.0, choice(step == 0.0, at_zero, step)))
    return UserNumber(found) if isinstance(found, Lane) else found


def interpolated(x: Any, xs: Any, ys: Any, left: Any = None, right: Any = None) -> Any:
    """Linear between the points (xs, ys), constant beyond them, or `left` and `right`.

    Among few lines a choice, one after the other: each costs a comparison and three choices. Among
    many that are constant a search.
    """
    points = list(zip(xs, ys, strict=True))
    lines: list[Any] = [(x0, y0, (y1 - y0) / (x1 - x0)) for (x0, y0), (x1, y1) in pairwise(points)]
    lines = lines or [(*points[0], 0.0)]
    are_constant = all(isinstance(n, (int, float, np.number)) for line in lines for n in line)
    if len(lines) > FEW_LINES and are_constant and isinstance(raw(x), Lane):
        columns = [[float(n) for n in column] for column in zip(*lines, strict=True)]
        at, value, slope = map(UserNumber, row_at(raw(x), columns))
    else:
        at, value, slope = lines[0]
        for line in lines[1:]:
            beyond = raw(x) >= raw(line[0])
            at, value, slope = (
                choice(beyond, new, old) for new, old in zip(line, (at, value, slope), strict=True)
            )
    (first, start), (last, end) = points[0], points[-1]
    found = value + slope * (x - at)
    found = choice(raw(x) < raw(first), start if left is None else left, found)
    found = choice(raw(x) == raw(last), end, found)
    return choice(raw(x) > raw(last), end if right is None else right, found)


_METHODS = (
    sin, cos, tan, exp, expm1, log, log1p, log10, log2, sqrt, sinh, cosh, tanh, arcsin, arccos,
    arctan, arctan2, hypot,
)  # fmt: skip
for _function in _METHODS:  # what NumPy calls on objects
    setattr(UserNumber, _function.__name__, _function)


def _arithmetic_of_conditions() -> None:
    """A condition computes as the number that it is."""
    for name in (
        "add", "radd", "sub", "rsub", "mul", "rmul", "truediv", "rtruediv", "pow", "rpow", "mod",
        "neg", "abs", "lt", "le", "gt", "ge",
    ):  # fmt: skip
        method = getattr(UserNumber, f"__{name}__")
        setattr(
            Condition, f"__{name}__", lambda self, *others, of=method: of(self.number(), *others)
        )


_arithmetic_of_conditions()


def _every(conditions: Any) -> Any:
    return reduce(lambda a, b: a & b, [as_condition(x) for x in conditions], True)


def _any(conditions: Any) -> Any:
    return reduce(lambda a, b: a | b, [as_condition(x) for x in conditions], False)


def as_condition(x: Any) -> Any:
    if isinstance(x, Dual):
        return x != 0.0
    return x if isinstance(x, Condition) else bool(x)


# What stands for the functions of `math`, and for built-in ones, in functions of the user's.
REPLACEMENTS: dict[Any, Any] = {
    math.sin: sin, math.cos: cos, math.tan: tan, math.exp: exp, math.expm1: expm1,
    math.log: logarithm,
    math.log10: log10, math.log2: log2, math.radians: lambda x: x * (math.pi / 180.0),
    math.degrees: lambda x: x * (180.0 / math.pi),
    math.log1p: log1p, math.sqrt: sqrt, math.sinh: sinh, math.cosh: cosh, math.tanh: tanh,
    math.asin: arcsin, math.acos: arccos, math.atan: arctan, math.atan2: arctan2,
    math.asinh: arcsinh, math.acosh: arccosh, math.atanh: arctanh, math.erf: erf, math.erfc: erfc,
    math.hypot: hypot, math.pow: power, math.fabs: absolute_value, math.copysign: copysign,
    math.fmod: fmod, math.floor: whole_floor, math.ceil: whole_ceil, math.trunc: whole_part,
    math.isnan: is_nan, math.isfinite: is_finite, math.isinf: is_infinite,
    max: larger, min: smaller, float: Float, all: _every, any: _any,
}  # fmt: skip
REPLACEMENTS |= {math.cbrt: cbrt, math.exp2: exp2}
