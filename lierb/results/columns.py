"""Make Arrow columns around NumPy's memory.

`pyarrow.array` is not used: it imports pandas if that is installed, which adds 0.2 s to the first
result of each process.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray


def numbers(array: NDArray) -> pa.Array:
    """Return a column of an array's numbers, without a copy if they are contiguous."""
    array = np.ascontiguousarray(array)
    return _column(array.dtype, array.size, pa.py_buffer(array))


def _column(dtype: np.dtype, size: int, buffer: pa.Buffer) -> pa.Array:
    return pa.Array.from_buffers(_type(dtype), size, [None, buffer])


_type = cache(pa.from_numpy_dtype)


def each_row(array: NDArray) -> list[pa.Array]:
    """Return a column for each index of an array's first axis, without a copy as above."""
    if not len(array):
        return []
    array = np.ascontiguousarray(array)
    # Slices of the buffer, since a pickled slice of a column contains the whole column.
    buffer, size, width = pa.py_buffer(array), array[0].size, array[0].nbytes
    return [_column(array.dtype, size, buffer.slice(i * width, width)) for i in range(len(array))]


def vectors(array: NDArray) -> pa.Array:
    """Return a column of fixed-size lists over an array's last axis, without a copy as above."""
    return pa.FixedSizeListArray.from_arrays(numbers(array), array.shape[-1])


def texts(values: Sequence[str]) -> pa.Array:
    """Return a column of strings."""
    encoded = [value.encode() for value in values]
    offsets = np.cumsum([0, *map(len, encoded)]).astype(np.int32)
    return pa.StringArray.from_buffers(
        len(encoded), pa.py_buffer(offsets), pa.py_buffer(b"".join(encoded))
    )


def repeated(value: str, rows: int) -> pa.Array:
    """Return a column that repeats one string, stored once."""
    return pa.DictionaryArray.from_arrays(numbers(np.zeros(rows, np.int32)), texts([value]))


def unit_of(field: pa.Field) -> str:
    """Return a field's unit; "" if it has none."""
    unit: bytes = (field.metadata or {}).get(b"unit", b"")
    return unit.decode()


def as_array(column: pa.ChunkedArray) -> NDArray:
    """Return a column as a read-only array, (rows,), or (rows, width) for fixed-size lists.

    A column of one chunk, such as any of `lierb.integrate`, is not copied.
    """
    whole = _whole(column)
    if pa.types.is_fixed_size_list(whole.type):
        return numbers_of(whole.flatten()).reshape(-1, whole.type.list_size)
    return numbers_of(whole)


def as_codes(column: pa.ChunkedArray) -> tuple[NDArray, list[str]]:
    """Return each row's index into the distinct strings of a column, and the strings."""
    if not pa.types.is_dictionary(column.type):
        column = column.dictionary_encode()
    whole = _whole(column.unify_dictionaries())
    return numbers_of(whole.indices), whole.dictionary.to_pylist()


def _whole(column: pa.ChunkedArray) -> pa.Array:
    return column.chunk(0) if column.num_chunks == 1 else column.combine_chunks()


# NumPy types of Arrow types; a type's `to_pandas_dtype()` would import pandas up to Arrow 18.

DTYPES = {pa.from_numpy_dtype(code): np.dtype(code) for code in "bhilBHILefd"}


def numbers_of(array: pa.Array) -> NDArray:
    """Return an Arrow array as a NumPy array; `to_numpy()` would import pandas."""
    dtype, buffer = DTYPES[array.type], array.buffers()[1]
    numbers: NDArray = np.ndarray(len(array), dtype, buffer, array.offset * dtype.itemsize)
    numbers.setflags(write=False)
    return numbers
