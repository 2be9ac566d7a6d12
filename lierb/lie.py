"""Lie groups on arrays with any leading batch shape.

`lierb.lie.so3`, `.se3` and `.so3xr3` share one interface. Vectors of the algebra hold the angular
part first (rad, then m); elements of the group are matrices, R (…, 3, 3) or C (…, 4, 4). For
SO(3)×R³ the 4×4 matrix only holds (R, r): it composes by `so3xr3.compose`, not by matrix product.

The formulas themselves, on tuples of numbers, are in `lierb.kernels.groups.so3`, `.se3` and
`.so3xr3`, and a user's @njit code can call them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lierb.compiler.code import compiled, is_ready
from lierb.errors import ArgumentError
from lierb.kernels.groups.lie_functions import SIGNATURES, LieFunction, apply
from lierb.kernels.tracing.cpu import DEFAULT_LANES
from lierb.support.arrays import FEWER, Array, as_floats, as_matrix
from lierb.support.forks import check_compiler
from lierb.support.memory import require_memory


@dataclass(frozen=True)
class Group:
    """A Lie group of rotations or rigid motions.

    All functions broadcast their arguments' batch shapes. They take SciPy's `Rotation` (so3) or
    `RigidTransform` (se3, so3xr3) as group elements. They raise ArgumentError for a wrong shape and
    for values that are not real numbers.

    Attributes
    ----------
    name : {"so3", "se3", "so3xr3"}
        Name of the group.
    size : {3, 4}
        Size of its matrices, 3×3 or 4×4.
    dim : {3, 6}
        Dimension of its algebra.
    """

    name: str
    size: int
    dim: int

    def exp(self, X: ArrayLike) -> Array:
        """Compute exp X.

        Parameters
        ----------
        X : array_like, shape (…, dim)
            Element of the algebra, with ‖ξ‖ up to 1e5 rad; the error grows as 1e-15 ‖ξ‖.

        Returns
        -------
        ndarray, shape (…, size, size)
            Element of the group.

        Examples
        --------
        >>> import lierb
        >>> lierb.lie.se3.exp([0, 0, 0, 1.0, 2.0, 3.0])[:3, 3].tolist()
        [1.0, 2.0, 3.0]
        """
        return self._call("exp", X)

    def log(self, C: Any) -> Array:
        """Compute the X with exp X = C and ‖ξ‖ ≤ π.

        At ‖ξ‖ = π the largest component of ξ by size is positive (the first of several equal).

        Parameters
        ----------
        C : array_like, Rotation or RigidTransform, shape (…, size, size)
            Element of the group.

        Returns
        -------
        ndarray, shape (…, dim)
            Element of the algebra.

        Examples
        --------
        >>> import lierb
        >>> lierb.lie.so3.log(lierb.lie.so3.exp([0.1, -0.2, 0.3])).round(12).tolist()
        [0.1, -0.2, 0.3]
        """
        return self._call("log", C)

    def compose(self, C1: Any, C2: Any) -> Array:
        """Compute the product C₁C₂ of the group.

        Parameters
        ----------
        C1 : array_like, Rotation or RigidTransform, shape (…, size, size)
            Element of the group.
        C2 : array_like, Rotation or RigidTransform, shape (…, size, size)
            Element of the group.

        Returns
        -------
        ndarray, shape (…, size, size)
            Their product.

        Examples
        --------
        >>> import lierb
        >>> shift, turn = lierb.lie.se3.exp([[0, 0, 0, 1, 0, 0], [0, 0, 1, 0, 0, 0]])
        >>> lierb.lie.se3.compose(shift, turn)[:3, 3].tolist()
        [1.0, 0.0, 0.0]
        """
        return self._call("compose", C1, C2)

    def inverse(self, C: Any) -> Array:
        """Compute C⁻¹.

        Parameters
        ----------
        C : array_like, Rotation or RigidTransform, shape (…, size, size)
            Element of the group.

        Returns
        -------
        ndarray, shape (…, size, size)
            Its inverse.

        Examples
        --------
        >>> import lierb
        >>> lierb.lie.se3.inverse(lierb.lie.se3.exp([0, 0, 0, 1.0, 2.0, 3.0]))[:3, 3].tolist()
        [-1.0, -2.0, -3.0]
        """
        return self._call("inverse", C)

    def Ad(self, C: Any, X: ArrayLike | None = None) -> Array:
        """Compute Ad_C X, or the matrix Ad_C.

        Parameters
        ----------
        C : array_like, Rotation or RigidTransform, shape (…, size, size)
            Element of the group.
        X : array_like, shape (…, dim), optional
            Element of the algebra.

        Returns
        -------
        ndarray, shape (…, dim) or (…, dim, dim)
            Ad_C X; the matrix Ad_C if X is omitted.

        Examples
        --------
        >>> import lierb
        >>> lierb.lie.se3.Ad(lierb.lie.se3.exp([0, 0, 0, 1.0, 0, 0]), [0, 0, 1.0, 0, 0, 0]).tolist()
        [0.0, 0.0, 1.0, 0.0, -1.0, 0.0]
        """
        return self._linear("Ad", C, X)

    def ad(self, X: ArrayLike, Y: ArrayLike | None = None) -> Array:
        """Compute the bracket [X, Y] = ad_X Y, or the matrix ad_X.

        Parameters
        ----------
        X : array_like, shape (…, dim)
            Element of the algebra.
        Y : array_like, shape (…, dim), optional
            Element of the algebra.

        Returns
        -------
        ndarray, shape (…, dim) or (…, dim, dim)
            ad_X Y; the matrix ad_X if Y is omitted.

        Examples
        --------
        >>> import lierb
        >>> lierb.lie.so3.ad([1.0, 0, 0], [0, 1.0, 0]).tolist()
        [0.0, 0.0, 1.0]
        """
        return self._linear("ad", X, Y)

    def dexp(self, X: ArrayLike, Y: ArrayLike | None = None) -> Array:
        """Compute the right-trivialised differential, dexp_X Ẋ = ĊC⁻¹ for C = exp X, or its matrix.

        Parameters
        ----------
        X : array_like, shape (…, dim)
            Element of the algebra.
        Y : array_like, shape (…, dim), optional
            Rate Ẋ.

        Returns
        -------
        ndarray, shape (…, dim) or (…, dim, dim)
            dexp_X Y; the matrix dexp_X if Y is omitted.

        Examples
        --------
        >>> import lierb
        >>> lierb.lie.se3.dexp([0.1, 0.2, 0.3, 1.0, 2.0, 3.0]).shape
        (6, 6)
        """
        return self._linear("dexp", X, Y)

    def dexpinv(self, X: ArrayLike, V: ArrayLike | None = None) -> Array:
        """Compute dexp_X⁻¹ V for ‖ξ‖ < 2π, or its matrix.

        Parameters
        ----------
        X : array_like, shape (…, dim)
            Element of the algebra.
        V : array_like, shape (…, dim), optional
            Element of the algebra.

        Returns
        -------
        ndarray, shape (…, dim) or (…, dim, dim)
            dexp_X⁻¹ V; the matrix dexp_X⁻¹ if V is omitted.

        Examples
        --------
        >>> import lierb
        >>> X, V = [0.1, 0.2, 0.3], [1.0, -1.0, 0.5]
        >>> lierb.lie.so3.dexpinv(X, lierb.lie.so3.dexp(X, V)).round(12).tolist()
        [1.0, -1.0, 0.5]
        """
        return self._linear("dexpinv", X, V)

    @property
    def identity(self) -> Array:
        return np.eye(self.size)

    def _linear(self, function: str, first: Any, second: Any) -> Array:
        """Apply a function that is linear in its second argument; without it, return the matrix."""
        if second is not None:
            return self._call(function, first, second)
        kind = SIGNATURES[function][0][0]
        element = self._operand(function, kind, first)
        of_each = np.expand_dims(element, -1 - len(self._shape(kind)))  # column of the matrix
        columns = self._call(function, of_each, np.eye(self.dim))
        return np.ascontiguousarray(columns.swapaxes(-1, -2))

    def _shape(self, kind: str) -> tuple[int, ...]:
        """Return the shape of an element of the algebra, "x", or of the group, "g"."""
        return (self.dim,) if kind == "x" else (self.size, self.size)

    def _call(self, function: str, *given: Any) -> Array:
        kinds, result_kind = SIGNATURES[function]
        operands = [self._operand(function, kind, x) for kind, x in zip(kinds, given, strict=True)]
        items, result = [self._shape(kind) for kind in kinds], self._shape(result_kind)
        pairs = [*zip(operands, items, strict=True)]
        try:
            batch = np.broadcast_shapes(*(x.shape[: x.ndim - len(item)] for x, item in pairs))
        except ValueError:
            shapes = " and ".join(str(x.shape) for x in operands)
            raise ArgumentError(
                f"{self.name}.{function}: shapes {shapes} do not broadcast"
            ) from None
        size = 8 * math.prod(batch) * sum(map(math.prod, (*items, result)))
        require_memory(size, f"{self.name}.{function} of a batch {batch}", FEWER)
        wide = [(np.broadcast_to(x, batch + item), math.prod(item)) for x, item in pairs]
        rows = [np.require(x, None, ["C", "A"]).reshape(-1, width) for x, width in wide]
        for row in rows:
            row.flags.writeable = False  # one Numba type for all arguments, hence one compilation
        out = np.empty((len(rows[0]), math.prod(result)))
        tag = LieFunction(self.name, function, DEFAULT_LANES)
        arguments = (rows[0], rows[-1], out, tag.lanes)
        check_compiler(is_needed=not is_ready(apply, tag, *arguments))
        run = compiled(apply, tag, *arguments)
        with np.errstate(all="ignore"):
            run(tag, *arguments)
        return out.reshape(*batch, *result)

    def _operand(self, function: str, kind: str, given: Any) -> Array:
        shape, argument = self._shape(kind), f"{self.name}.{function}: an argument"
        array = as_floats(argument, as_matrix(argument, given) if kind == "g" else given)
        if array.shape[-len(shape) :] != shape:
            expected = ", ".join(map(str, shape))
            raise ArgumentError(f"{argument} has shape {array.shape}; expected (…, {expected})")
        return array


so3 = Group("so3", 3, 3)
se3 = Group("se3", 4, 6)
so3xr3 = Group("so3xr3", 4, 6)

__all__ = ["Group", "se3", "so3", "so3xr3"]


def __dir__() -> list[str]:
    return list(__all__)
