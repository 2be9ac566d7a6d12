"""Calls of the C library and table look-up operate on one lane at a time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from llvmlite import ir

from lierb.compiler.internals import cgutils
from lierb.kernels.tracing.lanes import DOUBLE, INT32, Lane, same_type, trace_of_any


def call_library(name: str, *operands: Any) -> Lane:
    """Call a function of the C library for each lane."""
    trace = trace_of_any(operands)
    builder, values = trace.builder, same_type(trace, *operands)
    signature = ir.FunctionType(DOUBLE, [DOUBLE] * len(values))
    function = cgutils.get_or_insert_function(builder.module, signature, name)
    ty = values[0].type
    if not isinstance(ty, ir.VectorType):
        return Lane(trace, builder.call(function, values))
    pack: ir.Value = ir.Constant(ty, ir.Undefined)
    for lane in range(ty.count):
        place = ir.Constant(INT32, lane)
        result = builder.call(function, [builder.extract_element(v, place) for v in values])
        pack = builder.insert_element(pack, result, place)
    return Lane(trace, pack)


def row_at(x: Lane, columns: Sequence[Sequence[float]]) -> list[Lane]:
    """Find the last row of a table whose first column is at most x, or the first row if none is.

    The first column increases. Each lane uses a bisection without branches.
    """
    builder, count = x.builder, 1
    while count < len(columns[0]):
        count *= 2
    filled = [[*column, *[math.inf] * (count - len(column))] for column in columns]
    ty = ir.ArrayType(DOUBLE, count)
    memory = [
        cgutils.global_constant(builder.module, "table", ir.Constant(ty, column))
        for column in filled
    ]

    def entry(column: ir.Value, place: ir.Value) -> ir.Value:
        return builder.load(builder.gep(column, [ir.Constant(INT32, 0), place]))

    def row_of(one: ir.Value) -> ir.Value:
        place, step = ir.Constant(INT32, 0), count // 2
        while step:
            further = builder.add(place, ir.Constant(INT32, step))
            is_below = builder.fcmp_ordered("<=", entry(memory[0], further), one)
            place, step = builder.select(is_below, further, place), step // 2
        return place

    if not isinstance(x.value.type, ir.VectorType):
        place = row_of(x.value)
        return [Lane(x.trace, entry(column, place)) for column in memory]
    packs: list[ir.Value] = [ir.Constant(x.value.type, ir.Undefined) for _ in memory]
    for lane in range(x.lanes):
        index = ir.Constant(INT32, lane)
        place = row_of(builder.extract_element(x.value, index))
        packs = [
            builder.insert_element(pack, entry(column, place), index)
            for pack, column in zip(packs, memory, strict=True)
        ]
    return [Lane(x.trace, pack) for pack in packs]
