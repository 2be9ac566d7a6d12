"""Check users' numbers, and convert between arrays and tuples of components.

Formulas take one array for each component, of any batch shape. Componentwise arithmetic gives a
body the same bits alone and in any batch; `matmul` may not.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence, Set, Sized, ValuesView
from numbers import Complex, Real
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lierb.errors import ArgumentError, LierbError, MemoryLimitError, PoseError, body_label, brief
from lierb.kernels.numbers.vec import Mat, Vec, cross, dot, mat_t_mat
from lierb.support.memory import require_memory

Array = NDArray[np.float64]
Pose = tuple[Mat, Vec]

SLICE = 16384  # bodies checked at a time; this bounds the memory of checks
MOST_AXES = 16  # most axes of an argument; NumPy's limit is 64
PLAIN = {float, int, np.float64, np.float32, np.int64}  # numbers without further checks
LETTERS = {  # names of directions in other tools
    **{f"{sign}x": f"({sign.strip('+')}1, 0, 0)" for sign in ("", "+", "-")},
    **{f"{sign}y": f"(0, {sign.strip('+')}1, 0)" for sign in ("", "+", "-")},
    **{f"{sign}z": f"(0, 0, {sign.strip('+')}1)" for sign in ("", "+", "-")},
}
QUATERNION = (
    "whose order differs from tool to tool; give SciPy's "
    "Rotation.from_quat(q), for q = (x, y, z, w), or with scalar_first=True for (w, x, y, z)"
)
TWIST = (
    ": ω, then v, in body axes; joint.twist(omega=…) makes one, and mechanism.twist those of links"
)
GRAVITY = ", in the ground frame, such as (0, 0, -9.81)"
NO_NUMBERS = (bool, str, bytes, bytearray)
FEWER = "give fewer bodies at a time"
ROTATION_TOLERANCE = 1e-9  # largest ‖RᵀR − I‖ of a rotation with rounding errors


def as_floats(argument: str, value: Any, copy: bool | None = None) -> Array:
    """Convert a user's numbers to float64 in the same shape; copy=None keeps an array of float64.

    All users' numbers are converted here. Raises ArgumentError for text, bytes, dates, flags,
    complex numbers, masked entries, units, unordered collections and numbers beyond float64.
    Raises MemoryLimitError for a copy larger than the memory.
    """
    try:
        is_plain = type(value) is np.ndarray and value.dtype == np.float64
        array = value if is_plain else _read(argument, value)
        if array.ndim > MOST_AXES:
            raise ArgumentError(f"{argument} has {array.ndim} axes; expected {MOST_AXES} at most")
        if copy or array.dtype != np.float64:
            _require_room(argument, array.shape)
        with np.errstate(over="raise"):
            return np.array(array, dtype=np.float64, copy=copy)
    except (OverflowError, FloatingPointError) as error:
        raise ArgumentError(
            f"{argument} is {brief(value)}, beyond the largest float64; choose larger units"
        ) from error
    except LierbError:
        raise
    except MemoryError as error:
        raise MemoryLimitError(f"{argument}: {brief(str(error))}; {FEWER}") from error
    except Exception as error:  # __array__ of a user's class may raise any
        raise _no_numbers(argument, value) from error


def _require_room(argument: str, shape: tuple[int, ...]) -> None:
    require_memory(8 * math.prod(shape), f"{argument} of shape {shape}", FEWER)


def _read(argument: str, value: Any) -> NDArray:
    """Read a value as an array of real numbers of any type."""
    _refuse(argument, value)
    array = np.asanyarray(value)
    if isinstance(array, np.ma.MaskedArray):
        _refuse(argument, array)
    array = _stacked(argument, array)
    if array.dtype.kind == "O":
        is_real = all(map(_is_real, set(map(type, array.ravel()))))
    else:
        is_real = array.dtype.kind in "iuf"
    if not is_real:
        raise _no_numbers(argument, value)
    return np.asarray(array)


def _stacked(argument: str, array: NDArray) -> NDArray:
    """Stack an array of arrays or lists, such as a column of lists in Arrow or pandas."""
    depth = 0
    lists = {np.ndarray, list, tuple}
    while array.dtype.kind == "O" and array.size and set(map(type, array.ravel())) <= lists:
        depth += 1
        items = array.ravel().tolist()
        _refuse(argument, items, depth)
        inner = np.stack([np.asarray(item) for item in items])
        array = inner.reshape(array.shape + inner.shape[1:])
    return array


def _is_real(kind: type) -> bool:
    """Return whether instances of a class are real numbers, also of other packages."""
    if issubclass(kind, (np.generic, Complex)):
        is_time_or_flag = issubclass(kind, (bool, np.timedelta64))
        return issubclass(kind, (np.floating, np.integer, Real)) and not is_time_or_flag
    return hasattr(kind, "__float__") and not issubclass(kind, np.ndarray)


def is_whole(value: object) -> bool:
    """Return whether a value is an integer; flags and NumPy times are not."""
    return isinstance(value, (int, np.integer)) and not isinstance(value, (bool, np.timedelta64))


def _refuse(argument: str, value: Any, depth: int = 0) -> None:
    """Raise ArgumentError for flags, masked entries and units, which NumPy converts to numbers.

    Items of sequences are checked, too, as NumPy drops their units.
    """
    kind = type(value)
    if kind in PLAIN:
        return
    is_list = kind is list or kind is tuple  # fast path for most values and for items of long lists
    if not is_list:
        _refuse_one(argument, value)
    if is_list or (isinstance(value, Sequence) and not isinstance(value, memoryview)):
        if depth == MOST_AXES:
            raise ArgumentError(f"{argument} has lists more than {MOST_AXES} deep")
        if depth == 0:
            _require_room(argument, (len(value),))
        if kind is not range and not set(map(type, value)) <= PLAIN:
            for item in value:
                _refuse(argument, item, depth + 1)


def _refuse_one(argument: str, value: Any) -> None:
    if isinstance(value, np.ma.MaskedArray) and np.ma.getmaskarray(value).any():
        raise ArgumentError(f"{argument} has masked entries; fill them, or leave those bodies out")
    is_other = isinstance(value, (np.ndarray, np.generic)) and value.dtype.kind not in "iufO"
    is_bytes = isinstance(value, memoryview) and value.itemsize == 1
    if is_other or is_bytes or isinstance(value, NO_NUMBERS):
        raise _no_numbers(argument, value)
    units = (getattr(value, name, None) for name in ("units", "unit"))  # of pint, unyt, Astropy
    if type(value) is not np.ndarray and any(unit is not None for unit in units):
        raise ArgumentError(
            f"{argument} has units: {brief(value)}; give its plain numbers in SI units, such as "
            '`.to("m").magnitude` or `.to_value("m")`'
        )


def _no_numbers(argument: str, value: Any) -> ArgumentError:
    hint = "; give a list" if isinstance(value, Iterable) and not isinstance(value, Sized) else ""
    if isinstance(value, str) and value.lower() in LETTERS:
        hint = f"; a direction is given by components, such as {LETTERS[value.lower()]}"
    if isinstance(value, (Set, Mapping, ValuesView)):
        hint = ", which has no order; give a list"
    return ArgumentError(f"{argument} must be numbers, got {brief(value)}{hint}")


def as_numbers(
    argument: str,
    value: ArrayLike,
    *tails: tuple[int, ...],
    copy: bool | None = True,
    hint: str = "",
) -> Array:
    """Convert to finite float64 with a shape of `tails`, or a batch axis followed by such a shape.

    The copy is read-only, so that checked values cannot change. For use within a call, copy=None
    returns a view of the caller's array if it is float64.

    hint : end of the message about a shape that does not fit.
    """
    array = as_floats(argument, value, copy).view()
    array.setflags(write=False)
    fits = any(
        array.ndim - len(tail) in (0, 1) and array.shape[array.ndim - len(tail) :] == tail
        for tail in tails
    )
    if not fits:
        expected = " or ".join(f"{_shape(tail)} or {_shape(('n', *tail))}" for tail in tails)
        raise ArgumentError(f"{argument} has shape {array.shape}; expected {expected}{hint}")
    if array.size == 0:
        raise ArgumentError(f"{argument} has shape {array.shape}: a batch of no bodies")
    if not are_finite(array):
        where = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
        raise ArgumentError(
            f"{argument}{list(where) if where else ''} is {array[where]}; expected finite numbers"
        )
    return array


def as_number(argument: str, value: Any) -> np.float64:
    """Convert to one finite float64, whose division by zero is inf or NaN as for arrays."""
    array = as_floats(argument, value)
    if array.shape or not np.isfinite(array):
        raise ArgumentError(f"{argument} is {brief(value)}; expected one finite number")
    return np.float64(array)


def as_positive(argument: str, value: ArrayLike, unit: str, *shape: int) -> Array:
    """Convert to positive numbers, with items of `shape` for one or several bodies."""
    array = as_numbers(argument, value, shape)
    items = array.reshape(-1, *shape)
    for body, label in first_bad(argument, (items <= 0.0).reshape(len(items), -1).any(axis=1)):
        raise ArgumentError(f"{label} is {items[body]} {unit}; expected positive numbers")
    return array


def first_bad(argument: str, is_bad: Any) -> Iterator[tuple[int, str]]:
    """Yield the index and the label of the first body that is marked, if any is."""
    marks = np.atleast_1d(is_bad)
    for body in np.flatnonzero(marks)[:1].tolist():
        yield body, body_label(argument, body, marks.size)


def finite(what: str, array: Array) -> Array:
    """Return an array; raise ArgumentError if its computation has overflowed."""
    if not are_finite(array):
        raise ArgumentError(
            f"{what} is beyond all numbers: its computation overflows; give smaller numbers, or "
            "choose larger units"
        )
    return array


def are_finite(array: Array) -> bool:
    return all(np.isfinite(part).all() for part in slices(_unequal(array)))


def _unequal(array: Array) -> Array:
    """Return an array; if it is broadcast along its first axis, its single item."""
    return array[:1] if array.ndim and array.strides[0] == 0 else array


def slices(array: Array) -> Iterator[Array]:
    """Yield parts of an array along its first axis, so that temporaries are small."""
    if array.ndim == 0:
        yield array
    for start in range(0, len(array) if array.ndim else 0, SLICE):
        yield array[start : start + SLICE]


def _shape(sizes: tuple[Any, ...]) -> str:
    return f"({', '.join(map(str, sizes))}{',' if len(sizes) == 1 else ''})"


def batch_size(**arguments: Array | tuple[Array, int]) -> int | None:
    """Return the common length of the batch axes, or None.   A tuple is (array, item axes)."""
    lengths: dict[str, int] = {}
    for name, entry in arguments.items():
        array, item_axes = entry if isinstance(entry, tuple) else (entry, 0)
        if array.ndim > item_axes:
            lengths[name] = array.shape[0]
    sizes = set(lengths.values()) - {1}
    if len(sizes) > 1:
        listed = ", ".join(f"{name} has {size}" for name, size in lengths.items() if size != 1)
        raise ArgumentError(f"batched arguments differ in their number of bodies: {listed}")
    return sizes.pop() if sizes else (1 if lengths else None)


Which = int | slice | NDArray[np.int64]  # one body of a batch, or some of them


def items_at(array: Array, which: Which, item_axes: int = 0) -> Array:
    """Return the items of one or several bodies of a batch; a shared item as is."""
    if array.ndim == item_axes:
        return array
    if len(array) > 1:
        return np.asarray(array[which])
    return np.asarray(array[0]) if isinstance(which, int) else array


def member_of(body: Any, size: int | None) -> int:
    """Check the index of a body in a batch; return it as an int."""
    count = size or 1
    if not (is_whole(body) and 0 <= body < count):
        raise ArgumentError(f"body={brief(body)}; expected a whole number, 0 … {count - 1}")
    return int(body)


def components(array: Array, axes: int = 1) -> Vec:
    """Return the entries of the last `axes` axes, row by row."""
    flat = array.reshape(*array.shape[: array.ndim - axes], -1)
    return tuple(flat[..., i] for i in range(flat.shape[-1]))


def assembled(parts: Vec, *shape: int) -> Array:
    """Stack components along a last axis, or axes of `shape`; the inverse of `components`."""
    columns = np.broadcast_arrays(*(np.asarray(p, dtype=np.float64) for p in map(_number, parts)))
    stacked = np.stack(columns, axis=-1)
    return stacked.reshape(*stacked.shape[:-1], *shape) if shape else stacked


def _number(x: Any) -> Any:
    return x if isinstance(x, (float, np.ndarray, np.generic)) else 0.0


def pose_components(pose: Array) -> Pose:
    return components(pose[..., :3, :3], 2), components(pose[..., :3, 3])


def pose_matrix(pose: Pose) -> Array:
    """Return the homogeneous matrices (…, 4, 4) of poses."""
    r, p = assembled(pose[0], 3, 3), assembled(pose[1])
    batch = np.broadcast_shapes(r.shape[:-2], p.shape[:-1])
    matrix = np.zeros((*batch, 4, 4))
    matrix[..., :3, :3] = r
    matrix[..., :3, 3] = p
    matrix[..., 3, 3] = 1.0
    return matrix


def as_poses(argument: str, value: Any, copy: bool | None = True) -> Array:
    """Convert arrays, or SciPy's `RigidTransform` or `Rotation`, to poses (4, 4) or (n, 4, 4)."""
    matrices = as_floats(argument, as_matrix(argument, value))
    if matrices.shape[-2:] == (3, 3):
        if not hasattr(value, "as_matrix"):
            raise ArgumentError(
                f"{argument} has shape {matrices.shape}, rotations without a position: expected "
                "(4, 4) or (n, 4, 4), as C = np.eye(4); C[:3, :3] = R; C[:3, 3] = r; "
                "joint.pose(rotation=R) is the pose of a body turned about its joint's point"
            )
        matrices = pose_matrix((components(matrices, 2), (0.0, 0.0, 0.0)))  # without a translation
    elif matrices.ndim < 3 and matrices.shape[-1:] in ((4,), (7,)) and matrices.shape != (4, 4):
        raise ArgumentError(
            f"{argument} has shape {matrices.shape}, as quaternions have, {QUATERNION}; its "
            "RigidTransform has a position too"
        )
    of_joints = "; joint.pose and mechanism.pose make poses of the coordinates of joints"
    poses = as_numbers(argument, matrices, (4, 4), copy=copy, hint=of_joints)
    check_rotations(argument, poses[..., :3, :3])
    for number, part in enumerate(slices(_unequal(poses.reshape(-1, 4, 4)))):
        for body in np.flatnonzero((part[:, 3] != (0.0, 0.0, 0.0, 1.0)).any(axis=-1))[:1].tolist():
            label = body_label(argument, number * SLICE + body, poses.size // 16)
            raise PoseError(f"{label} is no homogeneous matrix: its last row must be (0, 0, 0, 1)")
    return poses


def as_rotations(argument: str, value: Any) -> Array:
    """Convert arrays, or SciPy's `Rotation`, to rotation matrices (3, 3) or (n, 3, 3)."""
    given = as_floats(argument, as_matrix(argument, value))
    if given.ndim < 3 and given.shape[-1:] == (4,):
        raise ArgumentError(
            f"{argument} has shape {given.shape}, as quaternions have, {QUATERNION}"
        )
    angles = "; give SciPy's Rotation.from_euler for angles, Rotation.from_rotvec for a vector"
    matrices = as_numbers(argument, given, (3, 3), hint=angles * (given.shape[-1:] == (3,)))
    check_rotations(argument, matrices)
    return matrices


def as_twists(argument: str, value: Any, copy: bool | None = True) -> Array:
    """Convert to twists (ω, v), (6,) or (n, 6)."""
    array = as_floats(argument, value)
    is_turned = array.ndim == 2 and array.shape[0] == 6
    hint = f"; give {argument}.T" if is_turned else TWIST
    return as_numbers(argument, array, (6,), copy=copy, hint=hint)


def as_matrix(argument: str, value: Any) -> Any:
    """Return value.as_matrix() if a value has this method, the value otherwise."""
    try:
        return value.as_matrix() if hasattr(value, "as_matrix") else value
    except Exception as error:  # a user's class may raise any exception
        raise ArgumentError(
            f"{argument} is {brief(value)}, whose as_matrix() raised {type(error).__name__}: "
            f"{brief(str(error))}"
        ) from error


def check_rotations(argument: str, matrices: Array) -> None:
    """Raise PoseError unless all matrices are orthogonal and right-handed."""
    for number, part in enumerate(slices(_unequal(matrices.reshape(-1, 3, 3)))):
        with np.errstate(all="ignore"):  # large entries may overflow
            r: Vec = tuple(np.ascontiguousarray(part.reshape(-1, 9).T))
            excess = tuple(g - float(i % 4 == 0) for i, g in enumerate(mat_t_mat(r, r)))
            errors = np.sqrt(dot(excess, excess))
            volume = dot(r[:3], cross(r[3:6], r[6:]))
            bad = ~((errors <= ROTATION_TOLERANCE) & (volume > 0.0))  # NaN is bad
        for body in np.flatnonzero(bad)[:1].tolist():
            error = errors[body]
            size = f"{error:.2g}" if np.isfinite(error) else "beyond all numbers"
            what = "is a reflection" if error <= ROTATION_TOLERANCE else f"has ‖RᵀR − I‖ = {size}"
            label = body_label(argument, number * SLICE + body, matrices.size // 9)
            raise PoseError(
                f"the rotation of {label} {what}; expected a rotation matrix to "
                f"{ROTATION_TOLERANCE:g}"
            )
