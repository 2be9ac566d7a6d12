"""Words are integers of up to 64 bits in formulas, with *, +, ^, &, >>, and bits of doubles.

Words are Python integers for floats, NumPy arrays for arrays, and packs for lane packs.
Formulas must keep products below 2⁶⁴; the operations do not check this.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from llvmlite import ir

from lierb.kernels.numbers.arithmetic import floor
from lierb.kernels.tracing.lanes import DOUBLE, Lane, Traced, splat

INT64 = ir.IntType(64)
LOW = 0xFFFFFFFF  # mask of the lower 32 bits


def words_of(x: Any) -> Any:
    """Return the word of a whole number |x| < 2⁵³, modulo 2⁶⁴."""
    if isinstance(x, Lane):
        kind = _like(INT64, x.value.type)
        return Words(x.trace, x.builder.fptosi(x.value, kind))
    if isinstance(x, np.ndarray) and x.ndim:
        return x.astype(np.int64).astype(np.uint64)
    return int(x) & (2**64 - 1)


def real_of(word: Any) -> Any:
    """Return the number of a word below 2⁵³."""
    if isinstance(word, Words):
        kind = _like(DOUBLE, word.value.type)
        return Lane(word.trace, word.builder.sitofp(word.value, kind))
    return word.astype(np.float64) if isinstance(word, np.ndarray) else float(word)


def bits_of(x: Any) -> Any:
    """Return the 64 bits of a double."""
    if isinstance(x, Lane):
        return Words(x.trace, x.builder.bitcast(x.value, _like(INT64, x.value.type)))
    if isinstance(x, np.ndarray) and x.ndim:
        return x.view(np.uint64)
    return int(np.float64(x).view(np.uint64))


def of_bits(word: Any) -> Any:
    """Return the double with these bits."""
    if isinstance(word, Words):
        kind = _like(DOUBLE, word.value.type)
        return Lane(word.trace, word.builder.bitcast(word.value, kind))
    return (
        word.view(np.float64)
        if isinstance(word, np.ndarray)
        else float(np.uint64(word).view(np.float64))
    )


def rough_log2(x: Any) -> Any:
    """Return log₂ x, up to 0.0861 too small, for normal x > 0."""
    return real_of(bits_of(x)) * 2.0**-52 - 1023.0


def rough_exp2(x: Any) -> Any:
    """Return 2ˣ with an error of 0.33 % at most, for |x| < 1000."""
    whole = floor(x)
    part = x - whole
    return of_bits(words_of((whole + 1023.0) * 2.0**52)) * (1.0 + part * (0.6565 + 0.3435 * part))


def _like(scalar: ir.Type, pack: ir.Type) -> ir.Type:
    return ir.VectorType(scalar, pack.count) if isinstance(pack, ir.VectorType) else scalar


def _emits(instruction: str) -> Callable[[Words, Any], Words]:
    def operation(self: Words, other: Any) -> Words:
        a, b = self.widened(other), self.constant_or(other).widened(self)
        return Words(self.trace, getattr(self.builder, instruction)(a, b))

    return operation


class Words(Traced):
    """A pack of words has a traced word of each lane."""

    __slots__ = ()
    __array_ufunc__ = None

    __add__ = __radd__ = _emits("add")
    __mul__ = __rmul__ = _emits("mul")
    __xor__ = __rxor__ = _emits("xor")
    __and__ = __rand__ = _emits("and_")
    __rshift__ = _emits("lshr")

    def constant_or(self, other: Any) -> Words:
        """Return `other`; convert an integer to a constant word."""
        return other if isinstance(other, Words) else Words(self.trace, INT64(other))

    def widened(self, other: Any) -> ir.Value:
        """Return the LLVM value, broadcast to the lanes of another word."""
        is_pack = isinstance(other, Words) and isinstance(other.value.type, ir.VectorType)
        if not is_pack:
            return self.value
        return splat(self.builder, self.value, other.value.type.count)
