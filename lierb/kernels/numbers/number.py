"""Protocols describe the operands of formulas, and the operations that a class implements.

| numbers                     | used for                                  | class     | `rank` |
|-----------------------------|-------------------------------------------|-----------|--------|
| float, NumPy scalar, array  | one body or a batch in plain Python       | `Plain`   | 0      |
| lane pack                   | L bodies in compiled code                 | `Lane`    | 1      |
| dual number                 | exact derivatives                         | `Dual`    | 3      |
| number of a user's function | exact derivatives, all Python operators   | `UserNumber` | 4   |
| place on a tape             | parts of dual numbers, for adjoints       | `Linear`  | 5      |
| structural zero             | components that are zero for every body   | `Zero`    | 9      |

A formula uses the operators of `Number` and the functions of `lierb.kernels.numbers.arithmetic`.
Hence it runs unchanged on every kind of number in the table. All quantities are in SI units.
"""

from __future__ import annotations

from typing import Any, Protocol, runtime_checkable


@runtime_checkable
class Number(Protocol):
    """Real numbers of one or several bodies have the shape () or (bodies,).

    Operators return a number. Comparisons return a mask of the same shape, which is false where an
    operand is NaN. If operands are of different kinds, the result has the kind of higher rank.
    """

    def __add__(self, other: Any, /) -> Any: ...
    def __radd__(self, other: Any, /) -> Any: ...
    def __sub__(self, other: Any, /) -> Any: ...
    def __rsub__(self, other: Any, /) -> Any: ...
    def __mul__(self, other: Any, /) -> Any: ...
    def __rmul__(self, other: Any, /) -> Any: ...
    def __truediv__(self, other: Any, /) -> Any: ...
    def __rtruediv__(self, other: Any, /) -> Any: ...
    def __neg__(self) -> Any: ...
    def __lt__(self, other: Any, /) -> Any: ...
    def __le__(self, other: Any, /) -> Any: ...
    def __gt__(self, other: Any, /) -> Any: ...
    def __ge__(self, other: Any, /) -> Any: ...


@runtime_checkable
class Mask(Protocol):
    """A mask is the truth value of one or several bodies: bool, an array of bool, or traced.

    Combine masks by & and |: `and`, `or` and `not` need a single truth value.
    """

    def __and__(self, other: Any, /) -> Any: ...
    def __or__(self, other: Any, /) -> Any: ...


@runtime_checkable
class Operations(Protocol):
    """A class of numbers has operations, as static methods or as methods of its first operand.

    `lierb.kernels.numbers.arithmetic` dispatches each operation to the operands' class of highest
    rank. Every class must implement the operations below. It may also implement `minimum`,
    `maximum`, `sincos`, `atan2`, `repeat`, `joined` and `call`, in place of the general formulas,
    and `trace_of`, which returns the trace of a number.
    """

    rank: int

    @staticmethod
    def fma(a: Any, b: Any, c: Any) -> Any:
        """Return a·b + c, rounded once where the CPU can."""

    def sqrt(self) -> Any:
        """Return √x; NaN for x < 0."""

    def absolute(self) -> Any:
        """Return |x|."""

    def rint(self) -> Any:
        """Return the nearest integer, ties to even."""

    def floor(self) -> Any:
        """Return the largest integer that is at most x."""
