"""User arrays ↔ the tuples of components that formulas take: one array a component, any batch.

Componentwise arithmetic gives a body the same bits alone and in any batch; `matmul` need not.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence, Set, Sized, ValuesView
from numbers import Complex, Real
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lierb.errors import ArgumentError, LierbError, MemoryLimitError, PoseError, body_label, told
from lierb.kernels.numbers.vec import Mat, Vec, dot, mat_t_mat
from lierb.support.memory import require_memory

Array = NDArray[np.float64]
Pose = tuple[Mat, Vec]

SLICE = 16384  # bodies looked at together: bounds the memory of checks
MOST_AXES = 16  # of an argument: NumPy ends at 64, and nobody's batch has so many
PLAIN = {float, int, np.float64, np.float32, np.int64}  # numbers that need no second look
NO_NUMBERS = (bool, str, bytes, bytearray)
FEWER = "give fewer bodies at a time"
ROTATION_TOLERANCE = 1e-9  # ‖RᵀR − I‖ that passes as rounding of whoever made R


def as_floats(argument: str, value: Any, copy: bool | None = None) -> Array:
    """`value` as float64, in its own shape; with copy=None the caller's own array where it is that.

    The one door for the user's numbers. Raises ArgumentError for what is no real number (text,
    bytes, dates, flags, complex numbers, masked entries), what has units or no order, and what
    float64 does not hold; MemoryLimitError for a copy that the memory does not hold.
    """
    try:
        is_plain = type(value) is np.ndarray and value.dtype == np.float64
        given = value if is_plain else _read(argument, value)
        if given.ndim > MOST_AXES:
            raise ArgumentError(f"{argument} has {given.ndim} axes; expected {MOST_AXES} at most")
        if copy or given.dtype != np.float64:
            _require_room(argument, given.shape)
        with np.errstate(over="raise"):
            return np.array(given, dtype=np.float64, copy=copy)
    except (OverflowError, FloatingPointError) as error:
        raise ArgumentError(
            f"{argument} is {told(value)}, beyond the largest float64; choose larger units"
        ) from error
    except LierbError:
        raise
    except MemoryError as error:
        raise MemoryLimitError(f"{argument}: {told(str(error))}; {FEWER}") from error
    except Exception as error:  # a class of the user's may raise anything in __array__
        raise _no_numbers(argument, value) from error


def _require_room(argument: str, shape: tuple[int, ...]) -> None:
    require_memory(8 * math.prod(shape), f"{argument} of shape {shape}", FEWER)


def _read(argument: str, value: Any) -> NDArray:
    """`value` as an array of real numbers of any type."""
    _refuse(argument, value)
    given = np.asanyarray(value)
    if isinstance(given, np.ma.MaskedArray):
        _refuse(argument, given)
    given = _stacked(argument, given)
    if given.dtype.kind == "O":
        is_real = all(map(_is_real, set(map(type, given.ravel()))))
    else:
        is_real = given.dtype.kind in "iuf"
    if not is_real:
        raise _no_numbers(argument, value)
    return np.asarray(given)


def _stacked(argument: str, given: NDArray) -> NDArray:
    """An array of arrays or lists as one array, as NumPy has a column of lists (Arrow, pandas)."""
    depth = 0
    while given.dtype.kind == "O" and given.size and _are_lists(given):
        depth += 1
        items = given.ravel().tolist()
        _refuse(argument, items, depth)
        inner = np.stack([np.asarray(item) for item in items])
        given = inner.reshape(given.shape + inner.shape[1:])
    return given


def _are_lists(given: NDArray) -> bool:
    return set(map(type, given.ravel())) <= {np.ndarray, list, tuple}


def _is_real(kind: type) -> bool:
    """Of an item of an array of objects; also what others make of numbers, such as mpmath."""
    if issubclass(kind, (np.generic, Complex)):
        is_time_or_flag = issubclass(kind, (bool, np.timedelta64))
        return issubclass(kind, (np.floating, np.integer, Real)) and not is_time_or_flag
    return hasattr(kind, "__float__") and not issubclass(kind, np.ndarray)


def is_whole(given: object) -> bool:
    """Whether it is an integer; neither a flag is one, nor a time, which NumPy takes for one."""
    return isinstance(given, (int, np.integer)) and not isinstance(given, (bool, np.timedelta64))


def _refuse(argument: str, value: Any, depth: int = 0) -> None:
    """Raise for what NumPy would take all the same: flags, what is masked, what has units.

    In sequences as well: of their items NumPy sees the numbers alone.
    """
    kind = type(value)
    if kind in PLAIN:
        return
    is_list = kind is list or kind is tuple  # by far the most, and in long lists of them
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
    if type(value) is not np.ndarray and _has_units(value):
        raise ArgumentError(
            f"{argument} has units: {told(value)}; give its plain numbers in SI units, such as "
            '`.to("m").magnitude` or `.to_value("m")`'
        )


def _has_units(value: Any) -> bool:
    """As the quantities of pint, unyt, Astropy and others have them."""
    return any(getattr(value, name, None) is not None for name in ("units", "unit"))


def _no_numbers(argument: str, value: Any) -> ArgumentError:
    hint = "; give a list" if isinstance(value, Iterable) and not isinstance(value, Sized) else ""
    if isinstance(value, (Set, Mapping, ValuesView)):
        hint = ", which has no order; give a list"
    return ArgumentError(f"{argument} must be numbers, got {told(value)}{hint}")


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
    if not are_finite(array):
        where = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
        raise ArgumentError(
            f"{argument}{list(where) if where else ''} is {array[where]}; expected finite numbers"
        )
    return array


def as_number(argument: str, value: Any) -> np.float64:
    """One finite number, which divides by zero as arrays do."""
    array = as_floats(argument, value)
    if array.shape or not np.isfinite(array):
        raise ArgumentError(f"{argument} is {told(value)}; expected one finite number")
    return np.float64(array)


def as_positive(argument: str, value: ArrayLike, unit: str, *shape: int) -> Array:
    """Numbers of that shape for each body, all above zero."""
    array = as_numbers(argument, value, shape)
    items = array.reshape(-1, *shape)
    bad = np.flatnonzero((items <= 0.0).reshape(len(items), -1).any(axis=1))
    if bad.size:
        label = body_label(argument, int(bad[0]), len(items))
        raise ArgumentError(f"{label} is {items[bad[0]]} {unit}; expected positive numbers")
    return array


def finite(what: str, found: Array) -> Array:
    """`found`, computed from finite numbers. Raises ArgumentError where that overflows."""
    if not are_finite(found):
        raise ArgumentError(
            f"{what} is beyond all numbers: what it is made of overflows; give smaller numbers, or "
            "choose larger units"
        )
    return found


def are_finite(array: Array) -> bool:
    return all(np.isfinite(part).all() for part in slices(_unequal(array)))


def _unequal(array: Array) -> Array:
    """The array, or of one that is broadcast along its first axis the one item."""
    return array[:1] if array.ndim and array.strides[0] == 0 else array


def slices(array: Array) -> Iterator[Array]:
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


Which = int | slice | NDArray[np.int64]  # one body of a batch, or some of them


def taken(array: Array, which: Which, item_axes: int = 0) -> Array:
    """The item of one body, or of a part of the batch; of all bodies, where they share it."""
    if array.ndim == item_axes:
        return array
    if len(array) > 1:
        return np.asarray(array[which])
    return np.asarray(array[0]) if isinstance(which, int) else array


def member_of(body: Any, size: int | None) -> int:
    """The number of a body of a batch. Raises ArgumentError for a number of none."""
    count = size or 1
    if not (is_whole(body) and 0 <= body < count):
        raise ArgumentError(f"body={told(body)}; expected a whole number, 0 … {count - 1}")
    return int(body)


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
    given = as_floats(argument, as_matrix(argument, value))
    if given.shape[-2:] == (3, 3):
        if not hasattr(value, "as_matrix"):
            raise ArgumentError(
                f"{argument} has shape {given.shape}, rotations R without a place r: expected "
                "(4, 4) or (n, 4, 4), as C = np.eye(4); C[:3, :3] = R; C[:3, 3] = r; "
                "joint.pose(rotation=R) is the pose of a body turned about its joint's point"
            )
        given = pose_matrix((components(given, 2), (0.0, 0.0, 0.0)))  # about the origin
    poses = as_numbers(argument, given, (4, 4), copy=copy)
    check_rotations(argument, poses[..., :3, :3])
    first = 0
    for part in slices(_unequal(poses.reshape(-1, 4, 4))):
        off = np.flatnonzero((part[:, 3] != (0.0, 0.0, 0.0, 1.0)).any(axis=-1))
        if off.size:
            label = body_label(argument, first + int(off[0]), poses.size // 16)
            raise PoseError(f"{label} is no homogeneous matrix: its last row must be (0, 0, 0, 1)")
        first += len(part)
    return poses


def as_rotations(argument: str, value: Any) -> Array:
    """3×3 rotation matrices from arrays or from SciPy's `Rotation`."""
    matrices = as_numbers(argument, as_matrix(argument, value), (3, 3))
    check_rotations(argument, matrices)
    return matrices


def as_matrix(argument: str, value: Any) -> Any:
    """What `value.as_matrix()` returns where it has such a method; numbers or not."""
    try:
        return value.as_matrix() if hasattr(value, "as_matrix") else value
    except Exception as error:  # of a class of the user's, any
        raise ArgumentError(
            f"{argument} is {told(value)}, whose as_matrix() raised {type(error).__name__}: "
            f"{told(str(error))}"
        ) from error


def check_rotations(argument: str, matrices: Array) -> None:
    """Raise unless each is orthogonal and right-handed."""
    first = 0
    for part in slices(_unequal(matrices.reshape(-1, 3, 3))):
        _check_rotations(argument, part, first, matrices.size // 9)
        first += len(part)


@np.errstate(all="ignore")  # of entries that are far too large
def _check_rotations(argument: str, matrices: Array, first: int, count: int) -> None:
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
