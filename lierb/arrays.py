"""User arrays ↔ the tuples of components that formulas take: one array a component, any batch.

Componentwise arithmetic gives a body the same bits alone and in any batch; `matmul` need not.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lierb.errors import ArgumentError, PoseError, body_label
from lierb.kernels.vec import Mat, Vec, dot, mat_t_mat

Array = NDArray[np.float64]
Pose = tuple[Mat, Vec]

SLICE = 16384  # bodies looked at together: bounds the memory of checks
ROTATION_TOLERANCE = 1e-9  # ‖RᵀR − I‖ that passes as rounding of whoever made R


def as_floats(argument: str, value: ArrayLike, copy: bool | None = None) -> Array:
    """`value` as float64, in its own shape; with copy=None the caller's own array where it is that.

    Raises ArgumentError for complex numbers, text and whatever else is no real number.
    """
    try:
        given = np.asarray(value)
        if given.dtype.kind not in "biufO":
            raise TypeError(given.dtype.name)
        return np.array(given, dtype=np.float64, copy=copy)
    except (TypeError, ValueError) as error:
        raise ArgumentError(f"{argument} must be numbers, got {value!r}") from error


def as_numbers(
    argument: str, value: ArrayLike, *tails: tuple[int, ...], copy: bool | None = True
) -> Array:
    """`value` as float64 with a shape that ends in one of `tails`, after at most one batch axis.

    A copy that nobody writes to, so that what was checked stays so; with copy=None a view of the
    caller's own array where it is float64, for use within a call.
    """
    array = as_floats(argument, value, copy).view()
    array.setflags(write=False)
    fits = any(
        array.ndim - len(tail) in (0, 1) and array.shape[array.ndim - len(tail) :] == tail
        for tail in tails
    )
    if not fits:
        expected = " or ".join(f"{_shape(tail)} or {_shape(('n', *tail))}" for tail in tails)
        raise ArgumentError(f"{argument} has shape {array.shape}; expected {expected}")
    if array.size == 0:
        raise ArgumentError(f"{argument} has shape {array.shape}: a batch of no bodies")
    if not all(np.isfinite(part).all() for part in _slices(array)):
        where = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
        raise ArgumentError(
            f"{argument}{list(where) if where else ''} is {array[where]}; expected finite numbers"
        )
    return array


def as_positive(argument: str, value: ArrayLike, unit: str, *shape: int) -> Array:
    """Numbers of that shape for each body, all above zero."""
    array = as_numbers(argument, value, shape)
    items = array.reshape(-1, *shape)
    bad = np.flatnonzero((items <= 0.0).reshape(len(items), -1).any(axis=1))
    if bad.size:
        label = body_label(argument, int(bad[0]), len(items))
        raise ArgumentError(f"{label} is {items[bad[0]]} {unit}; expected positive numbers")
    return array


def _slices(array: Array) -> Iterator[Array]:
    """The array along its first axis, in parts whose temporaries are small."""
    if array.ndim == 0:
        yield array
    for start in range(0, len(array) if array.ndim else 0, SLICE):
        yield array[start : start + SLICE]


def _shape(sizes: tuple[Any, ...]) -> str:
    return f"({', '.join(map(str, sizes))}{',' if len(sizes) == 1 else ''})"


def batch_size(**arguments: Array | tuple[Array, int]) -> int | None:
    """Common length of the batch axes; None if there are none. Values: (array, item axes)."""
    found: dict[str, int] = {}
    for name, entry in arguments.items():
        array, item_axes = entry if isinstance(entry, tuple) else (entry, 0)
        if array.ndim > item_axes:
            found[name] = array.shape[0]
    sizes = set(found.values()) - {1}
    if len(sizes) > 1:
        listed = ", ".join(f"{name} has {size}" for name, size in found.items() if size != 1)
        raise ArgumentError(f"batched arguments differ in their number of bodies: {listed}")
    return sizes.pop() if sizes else (1 if found else None)


def components(array: Array, axes: int = 1) -> Vec:
    """The entries of the last `axes` axes, row by row."""
    flat = array.reshape(*array.shape[: array.ndim - axes], -1)
    return tuple(flat[..., i] for i in range(flat.shape[-1]))


def assembled(parts: Vec, *shape: int) -> Array:
    """Inverse of `components`: last axis, or axes of `shape`."""
    columns = np.broadcast_arrays(*(np.asarray(p, dtype=np.float64) for p in map(_number, parts)))
    stacked = np.stack(columns, axis=-1)
    return stacked.reshape(*stacked.shape[:-1], *shape) if shape else stacked


def _number(x: Any) -> Any:
    return x if isinstance(x, (float, np.ndarray, np.generic)) else 0.0


def pose_components(pose: Array) -> Pose:
    return components(pose[..., :3, :3], 2), components(pose[..., :3, 3])


def pose_matrix(pose: Pose) -> Array:
    """4×4 homogeneous matrices."""
    r, p = assembled(pose[0], 3, 3), assembled(pose[1])
    batch = np.broadcast_shapes(r.shape[:-2], p.shape[:-1])
    matrix = np.zeros((*batch, 4, 4))
    matrix[..., :3, :3] = r
    matrix[..., :3, 3] = p
    matrix[..., 3, 3] = 1.0
    return matrix


def as_poses(argument: str, value: Any, copy: bool | None = True) -> Array:
    """4×4 rigid motions from arrays or from SciPy's `RigidTransform` or `Rotation`."""
    if hasattr(value, "as_matrix"):
        given = value.as_matrix()
        if given.shape[-2:] == (3, 3):  # a Rotation: about the origin
            given = pose_matrix((components(given, 2), (0.0, 0.0, 0.0)))
    else:
        given = as_floats(argument, value)
        if given.shape[-2:] == (3, 3):
            raise ArgumentError(
                f"{argument} has shape {given.shape}, rotations R without a place r: expected "
                "(4, 4) or (n, 4, 4), as C = np.eye(4); C[:3, :3] = R; C[:3, 3] = r; "
                "joint.pose(rotation=R) is the pose of a body turned about its joint's point"
            )
    poses = as_numbers(argument, given, (4, 4), copy=copy)
    check_rotations(argument, poses[..., :3, :3])
    off = np.flatnonzero((poses[..., 3, :] != (0.0, 0.0, 0.0, 1.0)).any(axis=-1))
    if off.size:
        label = body_label(argument, int(off[0]), poses.size // 16)
        raise PoseError(f"{label} is no homogeneous matrix: its last row must be (0, 0, 0, 1)")
    return poses


def as_rotations(argument: str, value: Any) -> Array:
    """3×3 rotation matrices from arrays or from SciPy's `Rotation`."""
    given = value.as_matrix() if hasattr(value, "as_matrix") else value
    matrices = as_numbers(argument, given, (3, 3))
    check_rotations(argument, matrices)
    return matrices


def check_rotations(argument: str, matrices: Array) -> None:
    """Raise unless each is orthogonal and right-handed."""
    first = 0
    for part in _slices(matrices.reshape(-1, 3, 3)):
        _check_rotations(argument, part, first, matrices.size // 9)
        first += len(part)


def _check_rotations(argument: str, matrices: Array, first: int, count: int) -> None:
    with np.errstate(all="ignore"):  # of entries that are far too large
        _check_few_rotations(argument, matrices, first, count)


def _check_few_rotations(argument: str, matrices: Array, first: int, count: int) -> None:
    r = components(matrices, 2)
    gram = mat_t_mat(r, r)
    excess = tuple(g - float(i % 4 == 0) for i, g in enumerate(gram))
    errors = np.sqrt(dot(excess, excess))
    handed = np.linalg.det(matrices)
    bad = np.flatnonzero(~((errors <= ROTATION_TOLERANCE) & (handed > 0.0)))  # false for NaN
    if bad.size:
        body = int(bad[0])
        far = f"{errors[body]:.2g}" if np.isfinite(errors[body]) else "beyond all numbers"
        is_mirrored = errors[body] <= ROTATION_TOLERANCE
        what = "is a reflection" if is_mirrored else f"has ‖RᵀR − I‖ = {far}"
        raise PoseError(
            f"the rotation of {body_label(argument, first + body, count)} {what}; "
            f"expected a rotation matrix to {ROTATION_TOLERANCE:g}"
        )
