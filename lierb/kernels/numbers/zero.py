"""`ZERO`: a component that is zero by structure, not by value.

0·x → ZERO and 0 + x → x are decided when a formula is traced or run, so a general SE(3) formula
that is given structural zeros folds down to the subgroup's own, with no code for any subgroup.
"""

from __future__ import annotations

from typing import Any


class Zero:
    """The only value of this class is `ZERO`. Comparisons treat it as the number 0."""

    __slots__ = ()
    __array_ufunc__ = None  # arrays and NumPy scalars leave the arithmetic to us

    def __add__(self, other: Any) -> Any:
        return other

    __radd__ = __rsub__ = __add__

    def __sub__(self, other: Any) -> Any:
        return -other

    def __mul__(self, other: Any) -> Zero:
        return self

    __rmul__ = __truediv__ = __mul__

    def __neg__(self) -> Zero:
        return self

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


ZERO = Zero()


def is_zero(number: Any, *others: Any) -> bool:
    """Whether every one of these numbers is a structural zero."""
    return isinstance(number, Zero) and all(isinstance(x, Zero) for x in others)
