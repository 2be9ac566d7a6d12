"""Systems of linear equations of known size, unrolled; structural zeros take no operations."""

from __future__ import annotations

from typing import Any

from lierb.kernels.numbers.arithmetic import fma, where
from lierb.kernels.numbers.vec import Vec
from lierb.kernels.numbers.zero import ZERO, is_zero


class Factored:
    """Factor A = L U without exchange of rows, so that all lanes take the same operations.

    It suits matrices whose pivots do not vanish, such as 1 − hγJ of a Rosenbrock method; a pivot
    that does makes the solution infinite or NaN.
    """

    def __init__(self, rows: list[list[Any]], left_out: Vec = ()) -> None:
        """Factor A.

        rows : A, row by row.   left_out : 1 for each of the last rows and unknowns that are left
        out, and are 0 in solutions; else 0.
        """
        n = len(rows)
        marks = (*(ZERO,) * (n - len(left_out)), *left_out)
        self.upper = [list(row) for row in rows]
        self.lower: list[list[Any]] = [[ZERO] * n for _ in rows]
        self.inverses: list[Any] = []
        for k, pivot_row in enumerate(self.upper):
            inverse = _inverse(pivot_row[k], marks[k])
            self.inverses.append(inverse)
            for i in range(k + 1, n):
                if is_zero(self.upper[i][k]):
                    continue
                factor = self.upper[i][k] * inverse
                self.lower[i][k] = factor
                self.upper[i] = [
                    ZERO if j <= k else less(y, factor, x)
                    for j, (x, y) in enumerate(zip(pivot_row, self.upper[i], strict=True))
                ]

    def solve(self, right: Vec) -> Vec:
        """Return A⁻¹ b.   right : b."""
        x = list(right)
        for i, row in enumerate(self.lower):
            for j in range(i):
                x[i] = less(x[i], row[j], x[j])
        for i, row in reversed([*enumerate(self.upper)]):
            for j in range(i + 1, len(x)):
                x[i] = less(x[i], row[j], x[j])
            x[i] = x[i] * self.inverses[i]
        return tuple(x)


def _inverse(pivot: Any, is_left_out: Any) -> Any:
    if is_zero(is_left_out):
        return 1.0 / pivot
    leaves = is_left_out > 0.5
    return where(leaves, 0.0, 1.0 / where(leaves, 1.0, pivot))


def less(x: Any, factor: Any, y: Any) -> Any:
    """Return x − factor · y."""
    return x if is_zero(factor) or is_zero(y) else fma(-factor, y, x)
