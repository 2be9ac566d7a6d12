"""Users' functions compute with dual numbers, which have all operators, methods, comparisons.

Comparisons return conditions, one truth value for each body. A number without parts has no
derivatives. The modules `elementary` and `steps` add the operators that need their functions, such
as ** and %.
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any

import numpy as np

from lierb.kernels.functions.references import UnfitFunctionError
from lierb.kernels.functions.refusals import TEXT
from lierb.kernels.numbers.arithmetic import absolute, fma, plain
from lierb.kernels.numbers.arithmetic import where as select
from lierb.kernels.numbers.dual import Dual, parts_of, side_by_side
from lierb.kernels.numbers.zero import ZERO, Zero, is_zero
from lierb.kernels.tracing.lanes import Lane, Mask

DECIDES = (
    "it decides by a number of the motion; write lierb.where(condition, a, b) instead of if, & and "
    "| instead of and and or, (a < x) & (x < b) instead of a < x < b"
)
NO_PLAIN_NUMBER = (
    "it needs a plain number, which one of many bodies at once is not; write np.trunc(x) for "
    "int(x), lierb.table(x, xs, ys) for xs[x], and np.zeros(n) in the function for an array to fill"
)


def _compares(holds: Callable[[Any, Any], Any]) -> Any:
    def compared(self: UserNumber, other: Any) -> Any:
        if not _is_number(other):
            return NotImplemented
        note_switch(self, other)
        return Condition(holds(raw(self), raw(other)))

    return compared


class UserNumber(Dual):
    """A user's number is a dual number in a user's function.

    factors : the two factors if the number is a product, () otherwise; a sum fuses them.
    """

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
        return combined(self, other, _sum, 1.0, 1.0)

    __radd__ = __add__

    def __sub__(self, other: Any) -> Any:
        return combined(self, other, _difference, 1.0, -1.0)

    def __rsub__(self, other: Any) -> Any:
        return combined(other, self, _difference, 1.0, -1.0)

    def __mul__(self, other: Any) -> Any:
        if not _is_number(other):
            return NotImplemented
        factors = self.value, value_of(other)
        product = combined(self, other, lambda x, y: factors[0] * factors[1], *factors[::-1])
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
        sign = selected(raw(self) < 0.0, -1.0, 1.0)
        size = abs(self.value) if isinstance(self.value, UserNumber) else absolute(self.value)
        return self.along(sign, size)

    def conjugate(self) -> UserNumber:
        return self

    @property
    def real(self) -> UserNumber:
        return self

    @property
    def imag(self) -> float:
        return 0.0

    __lt__, __le__ = _compares(operator.lt), _compares(operator.le)
    __gt__, __ge__ = _compares(operator.gt), _compares(operator.ge)
    __eq__ = _compares(operator.eq)

    def __ne__(self, other: Any) -> Any:
        equal = self == other
        return equal if equal is NotImplemented else ~equal  # true for NaN

    def __bool__(self) -> bool:
        raise TypeError(DECIDES)

    def __float__(self) -> float:
        raise TypeError(NO_PLAIN_NUMBER)

    __int__ = __index__ = __complex__ = __float__


_switches: list[bool] = []  # for each comparison and jump of the function that is traced


def note_switch(*operands: Any) -> None:
    """Note a comparison or a jump, and whether it depends on numbers with derivatives."""
    _switches.append(any(parts_of(x) for x in operands))


def noted_switches() -> bool:
    """Return whether any noted switch depends on numbers with derivatives; forget all of them."""
    depends = any(_switches)
    _switches.clear()
    return depends


class Condition:
    """A condition, the result of a comparison, is true or false for each body.

    &, |, ^ and ~ combine conditions, and arithmetic takes one as 1 or 0, as in NumPy.
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
        return Condition(inverted(self.mask))

    def __eq__(self, other: Any) -> Any:
        return ~(self ^ other) if isinstance(other, Condition) else self if other else ~self

    def __ne__(self, other: Any) -> Any:
        return ~(self == other)

    def number(self) -> UserNumber:
        """Return 1 where the condition holds, 0 elsewhere."""
        return UserNumber(select(self.mask, 1.0, 0.0))


def define(**methods: Callable[..., Any]) -> None:
    """Add methods to the class of users' numbers, from modules that import this one."""
    for name, method in methods.items():
        setattr(UserNumber, name, method)


def _joined(a: Condition, b: Any, combine: Callable[[Any, Any], Any]) -> Any:
    if not isinstance(b, (Condition, bool, np.bool_)):
        return NotImplemented
    return Condition(combine(a.mask, b.mask if isinstance(b, Condition) else bool(b)))


def inverted(mask: Any) -> Any:
    return ~mask if isinstance(mask, (Mask, np.ndarray)) else not mask


def raw(x: Any) -> Any:
    """Return the value without any derivative."""
    while isinstance(x, Dual):
        x = x.value
    if isinstance(x, Condition):
        return select(x.mask, 1.0, 0.0)
    return float(x) if isinstance(x, (int, np.number)) else plain(x)


def _is_number(x: Any) -> bool:
    return isinstance(x, (Dual, Condition, Lane, Zero, int, float, np.number, np.bool_))


# Names in messages to users.
UserNumber.__name__ = UserNumber.__qualname__ = "number"
Condition.__name__ = Condition.__qualname__ = "condition"


def value_of(x: Any) -> Any:
    if isinstance(x, Dual):
        return x.value
    return raw(x) if isinstance(x, (Condition, int, np.integer)) else x


def combined(a: Any, b: Any, operation: Callable[[Any, Any], Any], left: Any, right: Any) -> Any:
    """Return operation(a, b), whose derivatives by a and b are `left` and `right`."""
    if not (_is_number(a) and _is_number(b)):
        return NotImplemented
    parts = (_total(left, p, right, q) for p, q in side_by_side(a, b))
    return kind_of(a, b)(operation(a, b), tuple(parts))


def kind_of(*numbers: Any) -> type[Dual]:
    """Return a result's class: UserNumber if an operand is one, Dual in values of such numbers."""
    return UserNumber if any(isinstance(x, UserNumber) for x in numbers) else Dual


def _sum(a: Any, b: Any) -> Any:
    for x, y in ((a, b), (b, a)):
        if isinstance(x, UserNumber) and x.factors:
            left, right = x.factors
            return fma(left, right, value_of(y))
    return value_of(a) + value_of(b)


def _difference(a: Any, b: Any) -> Any:
    return value_of(a) - value_of(b)  # not fused: x·x − x·x must be zero


def _total(left: Any, p: Any, right: Any, q: Any) -> Any:
    """Compute left·p + right·q, without products by slopes of ±1."""
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
    return combined(a, b, lambda x, y: value, inverse, -(value * inverse))


def where(condition: Any, a: Any, b: Any) -> Any:
    """Choose `a` where the condition holds, `b` elsewhere, in functions passed to lierb.

    The function replaces `if`. Both values are computed.

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
    """Choose between two numbers, as `where` does."""
    number = selected(condition, a, b)
    are_constants = not isinstance(a, Lane) and not isinstance(b, Lane)
    return UserNumber(number) if are_constants and isinstance(number, Lane) else number


def selected(condition: Any, a: Any, b: Any) -> Any:
    mask = condition.mask if isinstance(condition, Condition) else condition
    if isinstance(mask, (UserNumber, Lane)):  # a nonzero number is true, as in NumPy
        mask = inverted(raw(mask) == 0.0)
    a, b = (x.number() if isinstance(x, Condition) else x for x in (a, b))
    return select(mask, a, b)


def as_condition(x: Any) -> Any:
    if isinstance(x, Dual):
        return x != 0.0
    return x if isinstance(x, Condition) else bool(x)


class Float(float):
    """Replace `float`, but leave traced numbers unchanged."""

    def __new__(cls, x: Any = 0.0) -> Any:
        return x if isinstance(x, Dual) else float(x)
