"""Support @njit loops by functions that run compiled or not, and memory at an address."""

from __future__ import annotations

from collections.abc import Callable
from ctypes import c_char, c_double
from math import prod
from typing import Any, TypeVar

import numba
import numpy as np
from llvmlite import ir
from numba import config, types
from numba.extending import intrinsic, register_jitable

from lierb.compiler.code import OPTIONS
from lierb.compiler.internals import populate_array

F = TypeVar("F", bound=Callable[..., Any])

part_of_loop = numba.njit(**OPTIONS, inline="always")  # compiled only as part of its caller


def shared(function: F) -> F:
    """Decorate a function of numbers that both Python and @njit code can call."""
    return register_jitable(**OPTIONS)(function)


def _number_at(address: int) -> float:
    """Return the float64 at an address, which need not be aligned."""
    return c_double.from_address(int(address)).value


def _put_number_at(address: int, number: float) -> None:
    """Store a float64 at an address, which need not be aligned."""
    c_double.from_address(int(address)).value = number


@intrinsic
def _store(context: Any, address: Any, number: Any) -> Any:
    def generate(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> Any:
        place = builder.inttoptr(args[0], ir.DoubleType().as_pointer())
        builder.store(args[1], place, align=1)
        return context.get_dummy_value()

    return types.void(address, types.float64), generate


@intrinsic
def _load(context: Any, address: Any) -> Any:
    def generate(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> Any:
        place = builder.inttoptr(args[0], ir.DoubleType().as_pointer())
        return builder.load(place, align=1)

    return types.float64(address), generate


def _array_at(axes: int, item: types.Type) -> Any:
    """Make a function that returns the C-contiguous array at an address.

    The function takes the address and the extents, as one array of int64 in this order. Its caller
    keeps the memory alive.
    """
    dtype = np.dtype(item.name)

    def array(place: Any) -> Any:
        address, *shape = (int(x) for x in place[: axes + 1])
        size = prod(shape) * dtype.itemsize
        return np.ndarray(shape, dtype, (c_char * size).from_address(address))

    @intrinsic
    def compiled(context: Any, place: Any) -> Any:
        made = types.Array(item, axes, "C")

        def generate(context: Any, builder: ir.IRBuilder, sig: Any, args: Any) -> Any:
            numbers = context.make_array(place)(context, builder, args[0]).data
            cells = (builder.gep(numbers, [ir.IntType(32)(i)]) for i in range(axes + 1))
            address, *shape = map(builder.load, cells)
            strides = [context.get_constant(types.intp, dtype.itemsize)]
            for extent in reversed(shape[1:]):
                strides.insert(0, builder.mul(extent, strides[0]))
            view = context.make_array(made)(context, builder)
            data = builder.inttoptr(address, context.get_data_type(item).as_pointer())
            populate_array(view, data, shape, strides, strides[-1], meminfo=None)
            return view._getvalue()

        return made(place), generate

    return array if config.DISABLE_JIT else compiled


number_at = _number_at if config.DISABLE_JIT else _load
put_number_at = _put_number_at if config.DISABLE_JIT else _store
numbers_at = _array_at(2, types.float64)
histories_at = _array_at(3, types.float64)
integers_at = _array_at(2, types.int64)
