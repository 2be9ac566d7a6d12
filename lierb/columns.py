"""Arrow columns around NumPy's memory.

`pyarrow.array` would do, but it looks for pandas first, and so imports it where it is installed:
0.2 s of every process's first result.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray


def numbers(array: NDArray) -> pa.Array:
    """A column of all of an array's numbers, without a copy if they lie in order."""
    array = np.ascontiguousarray(array)
    return _column(array.dtype, array.size, pa.py_buffer(array))


def _column(dtype: np.dtype, size: int, buffer: pa.Buffer) -> pa.Array:
    return pa.Array.from_buffers(_type(dtype), size, [None, buffer])


_type = cache(pa.from_numpy_dtype)


def each_row(array: NDArray) -> list[pa.Array]:
    """A column for each index along an array's first axis, without a copy as above."""
    array = np.ascontiguousarray(array)
    # Of the buffer: a slice of a column would drag all of it along when it is pickled.
    buffer, size, width = pa.py_buffer(array), array[0].size, array[0].nbytes
    return [_column(array.dtype, size, buffer.slice(i * width, width)) for i in range(len(array))]


def vectors(array: NDArray) -> pa.Array:
    """A column of fixed-size lists over an array's last axis, without a copy as above."""
    return pa.FixedSizeListArray.from_arrays(numbers(array), array.shape[-1])


def texts(values: Sequence[str]) -> pa.Array:
    """A column of these strings."""
    encoded = [value.encode() for value in values]
    offsets = np.cumsum([0, *map(len, encoded)]).astype(np.int32)
    return pa.StringArray.from_buffers(
        len(encoded), pa.py_buffer(offsets), pa.py_buffer(b"".join(encoded))
    )


def repeated(value: str, rows: int) -> pa.Array:
    """A column of one string, stored once."""
    return pa.DictionaryArray.from_arrays(numbers(np.zeros(rows, np.int32)), texts([value]))
