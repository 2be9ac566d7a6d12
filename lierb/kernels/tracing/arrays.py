"""Traced indices, and arrays read and written a pack at a time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from llvmlite import ir
from numba import types

from lierb.compiler.internals import cgutils
from lierb.kernels.tracing.lanes import DOUBLE, INT32, Lane, Trace, Traced, pack_of, value_as

LINE = 8  # doubles in a cache line


class Index(Traced):
    """A traced integer (intp) is the index of an array's element."""

    __slots__ = ()

    def __add__(self, other: int | Index) -> Index:
        added = other.value if isinstance(other, Index) else self.value.type(other)
        return Index(self.trace, self.builder.add(self.value, added))

    def __sub__(self, other: Index) -> Index:
        return Index(self.trace, self.builder.sub(self.value, other.value))

    def __mul__(self, other: int | Index) -> Index:
        factor = other.value if isinstance(other, Index) else self.value.type(other)
        return Index(self.trace, self.builder.mul(self.value, factor))

    def real(self) -> Lane:
        return Lane(self.trace, self.builder.sitofp(self.value, DOUBLE))

    def or_more(self, other: Index) -> Index:
        """Return the larger of two integers."""
        is_more = self.builder.icmp_signed(">", self.value, other.value)
        return Index(self.trace, self.builder.select(is_more, self.value, other.value))

    def or_less(self, other: Index) -> Index:
        """Return the smaller of two integers."""
        is_less = self.builder.icmp_signed("<", self.value, other.value)
        return Index(self.trace, self.builder.select(is_less, self.value, other.value))


class ArrayRef(Traced):
    """A traced array is C-contiguous.

    It is of float64, read and written a pack at a time, or of int64.
    """

    __slots__ = ("data", "index_type", "shape")

    def __init__(self, trace: Trace, context: Any, ty: types.Array, value: ir.Value) -> None:
        super().__init__(trace, value)
        array = context.make_array(ty)(context, self.builder, value)
        self.data = array.data
        self.shape = cgutils.unpack_tuple(self.builder, array.shape, ty.ndim)
        self.index_type = self.shape[0].type

    @property
    def address(self) -> Index:
        return Index(self.trace, self.builder.ptrtoint(self.data, self.index_type))

    def _as_value(self, i: Any) -> ir.Value:
        return i.value if isinstance(i, Index) else ir.Constant(self.index_type, i)

    def _pointer(self, index: Sequence[Any]) -> ir.Value:
        offset = self._as_value(index[0])
        for i, extent in zip(index[1:], self.shape[1:], strict=True):
            offset = self.builder.add(self.builder.mul(offset, extent), self._as_value(i))
        return self.builder.gep(self.data, [offset])

    def load(self, index: Sequence[Any], lanes: int) -> Lane:
        """Load `lanes` consecutive doubles from `index` on."""
        pointer = self.builder.bitcast(self._pointer(index), pack_of(lanes).as_pointer())
        return Lane(self.trace, self.builder.load(pointer, align=8))

    def store(self, index: Sequence[Any], number: Any, lanes: int) -> None:
        """Write a pack to `lanes` consecutive elements from `index` on."""
        pack = pack_of(lanes)
        value = value_as(pack, number)
        pointer = self.builder.bitcast(self._pointer(index), pack.as_pointer())
        self.builder.store(value, pointer, align=8)

    def prefetch(self, index: Sequence[Any], count: int) -> None:
        """Prefetch the cache lines of `count` consecutive doubles from `index` on."""
        builder, byte = self.builder, ir.IntType(8).as_pointer()
        kind = ir.FunctionType(ir.VoidType(), [byte, INT32, INT32, INT32])
        fetch = cgutils.get_or_insert_function(builder.module, kind, "llvm.prefetch.p0")
        start = self._pointer(index)
        to_write, everywhere, data = INT32(1), INT32(3), INT32(1)
        for place in (*range(0, count, LINE), count - 1):
            line = builder.gep(start, [ir.Constant(self.index_type, place)])
            builder.call(fetch, [builder.bitcast(line, byte), to_write, everywhere, data])

    def gather(self, axis: int, place: Sequence[Any], lanes: int) -> Lane:
        """Load lane i from index `place` + i along `axis`, limited to the last element."""
        builder = self.builder
        start = self._as_value(place[axis])
        last = builder.sub(self.shape[axis], ir.Constant(self.index_type, 1))
        pack: ir.Value = ir.Constant(ir.VectorType(DOUBLE, lanes), ir.Undefined)
        for lane in range(lanes):
            moved = builder.add(start, ir.Constant(self.index_type, lane))
            moved = builder.select(builder.icmp_signed("<", moved, last), moved, last)
            element = builder.load(
                self._pointer([*place[:axis], Index(self.trace, moved), *place[axis + 1 :]])
            )
            if lanes == 1:
                return Lane(self.trace, element)
            pack = builder.insert_element(pack, element, ir.Constant(INT32, lane))
        return Lane(self.trace, pack)

    def scatter(
        self, axis: int, places: Sequence[Sequence[Any]], numbers: Sequence[Any], lanes: int
    ) -> None:
        """Write lane i of each pack to its index + i along `axis`; skip lanes beyond the array."""
        builder = self.builder
        start = self._as_value(places[0][axis])
        room = builder.sub(self.shape[axis], start)
        width = ir.Constant(self.index_type, lanes)
        if axis < len(self.shape) - 1:
            count = builder.select(builder.icmp_signed("<", room, width), room, width)
            self._scatter_lanes(axis, places, numbers, lanes, count)
            return
        with builder.if_else(builder.icmp_signed(">=", room, width), likely=True) as (whole, part):
            with whole:
                for place, number in zip(places, numbers, strict=True):
                    self.store(place, number, lanes)
            with part:
                self._scatter_lanes(axis, places, numbers, lanes, room)

    def _scatter_lanes(
        self,
        axis: int,
        places: Sequence[Sequence[Any]],
        numbers: Sequence[Any],
        lanes: int,
        count: ir.Value,
    ) -> None:
        """Write the first `count` lanes, one at a time."""
        builder = self.builder
        packs = ir.ArrayType(ir.ArrayType(DOUBLE, lanes), len(numbers))
        buffer, pack = cgutils.alloca_once(builder, packs), pack_of(lanes)
        zero = ir.Constant(INT32, 0)
        for n, number in enumerate(numbers):
            value = value_as(pack, number)
            pointer = builder.gep(buffer, [zero, ir.Constant(INT32, n), zero])
            builder.store(value, builder.bitcast(pointer, pack.as_pointer()), align=8)
        start = self._as_value(places[0][axis])
        with cgutils.for_range(builder, count) as loop:
            moved = Index(self.trace, builder.add(start, loop.index))
            for n, place in enumerate(places):
                pointer = builder.gep(buffer, [zero, ir.Constant(INT32, n), loop.index])
                target = self._pointer([*place[:axis], moved, *place[axis + 1 :]])
                builder.store(builder.load(pointer), target, align=8)
