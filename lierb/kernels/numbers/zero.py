"""`ZERO` is a component that is zero by structure, not by value.

ZERO·x = ZERO and ZERO + x = x are resolved when a formula is traced or run. Hence a general SE(3)
formula with structural zeros among its operands reduces to the formula of the subgroup, without
code for the subgroup.
"""

from __future__ import annotations

from typing import Any


class Zero:
    """The class has a single value, `ZERO`, which equals the number 0.0."""

    __slots__ = ()
    __array_ufunc__ = None  # arrays and NumPy scalars leave the arithmetic to this class
    rank = 9  # the highest: the result does not depend on the kind of the other numbers

    def __add__(self, other: Any) -> Any:
        return other

    __radd__ = __rsub__ = __add__

    def __sub__(self, other: Any) -> Any:
        return -other

    def __mul__(self, other: Any) -> Zero:
        return self

    __rmul__ = __truediv__ = __mul__

    def __rtruediv__(self, other: Any) -> Any:
        raise ZeroDivisionError("division by a structural zero")

    def __neg__(self) -> Zero:
        return self

    sqrt = absolute = rint = floor = __neg__

    def sincos(self) -> tuple[Any, Any]:
        return self, 1.0

    @staticmethod
    def fma(a: Any, b: Any, c: Any) -> Any:
        return c if a is ZERO or b is ZERO else a * b

    def __float__(self) -> float:
        return 0.0

    def __hash__(self) -> int:
        return hash(0.0)

    def __eq__(self, other: Any) -> Any:
        return 0.0 == other

    def __ne__(self, other: Any) -> Any:
        return 0.0 != other

    def __lt__(self, other: Any) -> Any:
        return 0.0 < other

    def __le__(self, other: Any) -> Any:
        return 0.0 <= other

    def __gt__(self, other: Any) -> Any:
        return 0.0 > other

    def __ge__(self, other: Any) -> Any:
        return 0.0 >= other

    def __repr__(self) -> str:
        return "ZERO"

    def __reduce__(self) -> str:
        return "ZERO"  # pickle restores this module's ZERO


ZERO = Zero()


def is_zero(number: Any, *others: Any) -> bool:
    """Return whether all of these numbers are structural zeros."""
    return number is ZERO and all(x is ZERO for x in others)
