"""lierb provides functions for users' functions: rotations, bounds, tables.

Each function takes traced numbers and NumPy arrays of any batch shape. In users' functions that run
body by body, Numba compiles it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numba import types
from numba.extending import overload

from lierb.kernels.functions.elementary import arctan2, sqrt
from lierb.kernels.functions.numpy_library import Spoken
from lierb.kernels.functions.object_arrays import has_traced, numbers
from lierb.kernels.functions.references import UnfitFunctionError
from lierb.kernels.functions.user_number import UserNumber, choice, raw, value_of, where
from lierb.kernels.groups import so3
from lierb.kernels.numbers.arithmetic import plain
from lierb.kernels.numbers.dual import side_by_side
from lierb.kernels.numbers.vec import Mat, Vec, axial, cross, dot, mat_t_mat, norm, scale
from lierb.kernels.tracing.trace import kernel

SMALL = 0.25  # tan²(θ/2) up to which the series is as accurate as atan2
TERMS = 30  # of the series; the first omitted is below 1e-18, also of two derivatives


class UnfitArgumentError(UnfitFunctionError, ValueError):
    """An argument of these functions is invalid; this is a ValueError outside of kernels, too."""


def clip(x: Any, lower: Any, upper: Any) -> Any:
    """Limit x to the interval from `lower` to `upper`.

    Parameters
    ----------
    x : float or array_like
        Numbers, limited element by element.
    lower : float or array_like
        Lower bound.
    upper : float or array_like
        Upper bound.

    Returns
    -------
    float or ndarray
        The limited numbers.

    Examples
    --------
    >>> import lierb
    >>> lierb.clip([-3.0, 0.5, 2.0], 0.0, 1.0).tolist()
    [0.0, 0.5, 1.0]
    """
    return _clip(x, lower, upper)


def table(x: Any, xs: Any, ys: Any) -> Any:
    """Interpolate linearly between the points (xs, ys); constant beyond the first and the last.

    In a kernel each point costs a comparison and three choices. The interval among more than 32
    constant points is found by bisection.

    Parameters
    ----------
    x : float or array_like
        Abscissas of the values, of any shape.
    xs : array_like, shape (n,)
        Increasing abscissas of the points.
    ys : array_like, shape (n,) or (n, k)
        Ordinates of the points: numbers, or vectors.

    Returns
    -------
    float or ndarray
        Interpolated values, of the shape of x; vectors are along a last axis.

    Raises
    ------
    ValueError
        The points do not make a table.

    Examples
    --------
    >>> import lierb
    >>> lierb.table([-1.0, 0.5, 9.0], (0.0, 1.0, 2.0), (0.0, 10.0, 40.0)).tolist()
    [0.0, 5.0, 40.0]
    """
    if not any(map(has_traced, (x, xs, ys))):
        x, xs, ys = _real("x", x), _real("xs", xs), _real("ys", ys)
    shapes = np.shape(xs), np.shape(ys)
    if len(shapes[0]) != 1 or shapes[0] != shapes[1][:1] or 0 in shapes[1] or len(shapes[1]) > 2:
        raise UnfitArgumentError(
            f"a table's xs and ys have shapes {shapes[0]} and {shapes[1]}; expected (n,) both, or "
            "(n,) and (n, k) for vectors"
        )
    if not has_traced(xs) and not np.all(np.diff(np.asarray(xs, dtype=np.float64)) > 0.0):
        raise UnfitArgumentError("a table's xs must increase; sort the points by x")
    if len(shapes[1]) == 1:
        return _interp(x, xs, ys)
    columns = [_interp(x, xs, [row[i] for row in ys]) for i in range(shapes[1][1])]
    return np.moveaxis(np.array(columns), 0, -1)


_clip, _interp = Spoken(np.clip), Spoken(np.interp)


def quaternion(R: Any) -> Any:
    """Convert a rotation matrix to a unit quaternion (w, x, y, z) with w ≥ 0.

    Parameters
    ----------
    R : array_like, shape (…, 3, 3)
        Rotation matrix.

    Returns
    -------
    ndarray, shape (…, 4)
        Unit quaternion.

    Raises
    ------
    ValueError
        R has the wrong shape, or is not real.

    Examples
    --------
    >>> import lierb
    >>> lierb.quaternion(lierb.lie.so3.exp((0.0, 0.0, 2.0))).round(4).tolist()
    [0.5403, 0.0, 0.0, 0.8415]
    """
    return _of_rotation(R, unit_quaternion)


def log(R: Any) -> Any:
    """Convert a rotation matrix to its rotation vector, axis times angle, of length π at most.

    Parameters
    ----------
    R : array_like, shape (…, 3, 3)
        Rotation matrix.

    Returns
    -------
    ndarray, shape (…, 3)
        Rotation vector, rad.

    Examples
    --------
    >>> import lierb
    >>> lierb.log(lierb.lie.so3.exp((0.1, -0.2, 0.3))).round(4).tolist()
    [0.1, -0.2, 0.3]
    """
    return _of_rotation(R, rotation_vector)


def _of_rotation(R: Any, formula: Any) -> Any:
    value = R.as_matrix() if hasattr(R, "as_matrix") else R
    matrices = numbers(value) if has_traced(value) else _real("R", value)
    if matrices.shape[-2:] != (3, 3):
        raise UnfitArgumentError(f"R has shape {matrices.shape}; expected (…, 3, 3)")
    if matrices.dtype == object:
        return numbers(formula(tuple(matrices.ravel())))
    flat = matrices.reshape(*matrices.shape[:-2], 9)
    with np.errstate(all="ignore"):  # compiled functions do not warn
        return np.stack(formula(tuple(flat[..., i] for i in range(9))), axis=-1)


def _real(argument: str, value: Any) -> np.ndarray:
    """Convert plain numbers to float64."""
    try:
        array = np.asanyarray(value)
        if array.dtype.kind in "iufO" and not np.ma.is_masked(array):
            return np.asarray(array, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise UnfitArgumentError(f"{argument} must be real numbers: {error}") from None
    raise UnfitArgumentError(f"{argument} must be real numbers, got {type(value).__name__}")


def unit_quaternion(r: Mat) -> Vec:
    """Return the unit quaternion (w, x, y, z), w ≥ 0.

    Its derivative is ½ q ⊗ (0, ω) for Ṙ = R ω̂.
    """
    if not any(isinstance(x, UserNumber) for x in r):
        q = so3.quaternion(r)
        return scale(1.0 / norm(q), q)
    values = _values(r)
    q = unit_quaternion(values)
    if not _has_parts(r):
        return tuple(map(UserNumber, q))
    rates = [_rate(q, values, tuple(map(plain, rate))) for rate in side_by_side(*r)]
    return tuple(UserNumber(x, parts) for x, parts in zip(q, zip(*rates, strict=True), strict=True))


def _rate(q: Vec, r: Mat, rate: Mat) -> Vec:
    omega = axial(mat_t_mat(r, rate))
    w, v = q[0], q[1:]
    bent = cross(v, omega)
    return (-0.5 * dot(v, omega), *(0.5 * (w * o + b) for o, b in zip(omega, bent, strict=True)))


def rotation_vector(r: Mat) -> Vec:
    """Return the rotation vector ξ with exp ξ = R, ‖ξ‖ ≤ π."""
    if not any(isinstance(x, UserNumber) for x in r):
        return so3.log(r)
    if not _has_parts(r):
        return tuple(map(UserNumber, rotation_vector(_values(r))))
    w, *v = unit_quaternion(r)
    square = v[0] * v[0] + v[1] * v[1] + v[2] * v[2]
    # ξ = v · 2 atan2(‖v‖, w)/‖v‖; near ‖v‖ = 0 the factor is a series in (‖v‖/w)²
    near = raw(square) <= SMALL * raw(w) * raw(w)
    ratio = choice(near, square, 0.0) / choice(near, w * w, 1.0)
    series: Any = 0.0
    for k in reversed(range(TERMS)):
        series = 1.0 / (2 * k + 1) - ratio * series
    size = sqrt(choice(near, 1.0, square))
    factor = choice(near, 2.0 * series / choice(near, w, 1.0), 2.0 * arctan2(size, w) / size)
    return tuple(factor * x for x in v)


def _has_parts(members: Sequence[Any]) -> bool:
    return any(isinstance(x, UserNumber) and x.parts for x in members)


def _values(r: Mat) -> Mat:
    """Return the numbers without their own parts; their values may be dual numbers."""
    return tuple(value_of(x) if isinstance(x, UserNumber) else plain(x) for x in r)


# ---- for functions that Numba compiles ---------------------------------------------------------

kernel(unit_quaternion, numbers_only=True)
kernel(rotation_vector, numbers_only=True)


def _of_one_body(formula):
    def typed(R):  # no annotations: Numba compares signatures
        return lambda R: np.array(
            formula(
                (R[0, 0], R[0, 1], R[0, 2], R[1, 0], R[1, 1], R[1, 2], R[2, 0], R[2, 1], R[2, 2])
            )
        )

    return typed


overload(quaternion)(_of_one_body(unit_quaternion))
overload(log)(_of_one_body(rotation_vector))


@overload(clip)
def _clip_of_one_body(x, lower, upper):
    return lambda x, lower, upper: np.minimum(np.maximum(x, lower), upper)


@overload(table)
def _table_of_one_body(x, xs, ys):
    return lambda x, xs, ys: np.interp(x, np.asarray(xs), np.asarray(ys))


@overload(where)
def _where_of_one_body(condition, a, b):
    if any(isinstance(x, types.Array) for x in (condition, a, b)):
        return lambda condition, a, b: np.where(condition, a, b)
    if isinstance(a, types.BaseTuple) and isinstance(b, types.BaseTuple):
        if len(a) != len(b):
            return None
        if not len(a):
            return lambda condition, a, b: ()
        return lambda condition, a, b: (
            where(condition, a[0], b[0]),
            *where(condition, a[1:], b[1:]),
        )
    return lambda condition, a, b: a if condition else b
