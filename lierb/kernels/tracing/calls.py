"""Lane-by-lane calls of users' functions compiled by Numba, and exceptions that they raise."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, ClassVar

import numba
import numpy as np
from llvmlite import ir
from numba import types

from lierb.compiler.code import OPTIONS, run_uninterrupted
from lierb.compiler.entries import raise_again
from lierb.compiler.internals import INT64, call_linked, cgutils, link, populate_array
from lierb.kernels.numbers.arithmetic import branch, where
from lierb.kernels.tracing.lanes import (
    BIT,
    DOUBLE,
    INT32,
    Lane,
    Predicate,
    Trace,
    pack_of,
    value_as,
)


def call_compiled(
    dispatcher: Any, samples: list[Any], numbers: list[Any], count: int
) -> list[Lane]:
    """Call an @njit function lane by lane; return its `count` results.

    samples : arguments of the types that the function takes: numbers, arrays, tuples of these.
    numbers : all numbers of the arguments, in order.

    The results are NaN in lanes in which the function raises or is not called; see `Marks`.
    """
    lanes = [x for x in numbers if isinstance(x, Lane)]
    trace, width = lanes[0].trace, max(x.lanes for x in lanes)
    builder, context = trace.builder, trace.target
    if context is None:
        return [Lane(trace, ir.Constant(pack_of(width), ir.Undefined))] * count
    types_of = tuple(numba.typeof(sample) for sample in samples)
    dispatcher.compile(types_of)
    result = dispatcher.overloads[types_of]
    link(context, result)

    marks = Marks.of(trace, width)
    code = _Lanes(context, result, types_of, samples, len(numbers), count, width)
    packs = [value_as(pack_of(width), x) for x in numbers]

    def all_called() -> tuple[Lane, ...]:
        inward, outward = code.memory(builder)
        code.put(builder, packs, inward)
        code.call_each(builder, inward, outward, marks)
        return code.results(trace, outward)

    def some_called() -> tuple[Lane, ...]:
        inward, outward = code.memory(builder)
        code.put(builder, packs, inward)
        builder.call(code.apart(builder.module, marks.lanes), [inward, outward, marks.memory])
        return code.results(trace, outward)

    results = branch(marks.are_clear, all_called, some_called)
    fine = marks.pack == float(CLEAR)
    return [where(fine, x, math.nan) for x in results]


@dataclass(frozen=True)
class _Lanes:
    """Emit the code that calls a compiled function lane by lane.

    inputs, count : numbers of inputs and results of the function.   width : number of lanes.
    """

    context: Any
    compiled: Any
    types_of: tuple[types.Type, ...]
    samples: list[Any]
    inputs: int
    count: int
    width: int

    def _packs(self, count: int) -> ir.Type:
        return ir.ArrayType(ir.ArrayType(DOUBLE, self.width), count)

    def memory(self, builder: ir.IRBuilder) -> tuple[ir.Value, ir.Value]:
        """Allocate a pack for each input and each result of the function."""
        inward = cgutils.alloca_once(builder, self._packs(self.inputs))
        return inward, cgutils.alloca_once(builder, self._packs(self.count))

    def _whole(self, builder: ir.IRBuilder, buffer: ir.Value, n: int) -> ir.Value:
        return builder.bitcast(_place(builder, buffer, n, 0), pack_of(self.width).as_pointer())

    def put(self, builder: ir.IRBuilder, packs: list[ir.Value], inward: ir.Value) -> None:
        for n, value in enumerate(packs):
            builder.store(value, self._whole(builder, inward, n), align=8)

    def results(self, trace: Trace, outward: ir.Value) -> tuple[Lane, ...]:
        places = (self._whole(trace.builder, outward, n) for n in range(self.count))
        return tuple(Lane(trace, trace.builder.load(place, align=8)) for place in places)

    def call_each(
        self,
        builder: ir.IRBuilder,
        inward: ir.Value,
        outward: ir.Value,
        marks: Marks,
        only_clear: bool = False,
    ) -> None:
        """Emit calls for all lanes; with `only_clear`, for lanes whose mark is CLEAR."""
        one = cgutils.alloca_once(builder, ir.ArrayType(DOUBLE, self.inputs))
        with cgutils.for_range(builder, ir.Constant(INT64, self.width)) as loop:
            lane = loop.index if self.width == marks.lanes else None
            is_called = marks.is_clear(lane) if only_clear else BIT(1)
            with builder.if_then(is_called):
                for n in range(self.inputs):
                    number = builder.load(_place(builder, inward, n, loop.index))
                    builder.store(number, _place(builder, one, n))
                cells = (_place(builder, one, n) for n in range(self.inputs))
                arguments = [
                    _argument(self.context, builder, ty, sample, cells)
                    for ty, sample in zip(self.types_of, self.samples, strict=True)
                ]
                status, results = call_linked(self.context, builder, self.compiled, arguments)
                with builder.if_then(status.is_error, likely=False):
                    address = builder.ptrtoint(status.excinfoptr, INT64)
                    known = builder.select(status.is_user_exc, address, INT64(STOPPED))
                    marks.put(lane, builder.uitofp(known, DOUBLE))
                for n in range(self.count):
                    number = builder.extract_value(results, n)
                    builder.store(number, _place(builder, outward, n, loop.index))

    def apart(self, module: ir.Module, lanes: int) -> ir.Function:
        """Return an LLVM function (inward, outward, marks) with calls for CLEAR lanes only.

        A condition for each lane prevents vectorisation of the calls: a cheap function then takes
        1.4 times as long. A second loop in the calling function costs a factor of 1.1.
        """
        name = f"{self.compiled.fndesc.mangled_name}.{self.width}.{lanes}.clear"
        if name in module.globals:
            return module.globals[name]
        marked = ir.ArrayType(DOUBLE, lanes)
        kinds = (self._packs(self.inputs), self._packs(self.count), marked)
        kind = ir.FunctionType(ir.VoidType(), [ty.as_pointer() for ty in kinds])
        function = ir.Function(module, kind, name)
        function.linkage = "internal"
        function.attributes.add("noinline")
        builder = ir.IRBuilder(function.append_basic_block())
        inward, outward, memory = function.args
        marks = Marks(Trace(builder, self.context), lanes, memory)
        self.call_each(builder, inward, outward, marks, only_clear=True)
        builder.ret_void()
        return function


def _place(builder: ir.IRBuilder, buffer: ir.Value, *index: Any) -> ir.Value:
    steps = (i if isinstance(i, ir.Value) else ir.Constant(INT32, i) for i in (0, *index))
    return builder.gep(buffer, list(steps))


# ---- exceptions --------------------------------------------------------------------------------

CLEAR, SUPPRESSED, COLLECTED, STOPPED = 0, 1, 2, 3  # marks; larger ones are addresses of exceptions


class Marks:
    """A block has an exception flag for each lane, a number in the emitted function's memory.

    CLEAR: users' functions are called. SUPPRESSED: they are not called, as for a failed body.
    COLLECTED: the exception was collected. A function that raises sets the flag to the address of
    its exception, or to STOPPED for StopIteration, which has no address. Numba's error status,
    which each caller propagates, would end the other lanes, too.

    A double holds an address exactly: addresses have at most 52 bits on supported systems.
    """

    def __init__(self, trace: Trace, lanes: int, memory: ir.Value) -> None:
        self.trace, self.lanes, self.memory = trace, lanes, memory

    @classmethod
    def of(cls, trace: Trace, lanes: int) -> Marks:
        """Return the marks of the emitted function; the first call fixes the number of lanes."""
        function = trace.builder.function
        if not hasattr(function, "lierb_marks"):
            memory = cgutils.alloca_once(trace.builder, ir.ArrayType(DOUBLE, lanes))  # zeroed
            function.lierb_marks = cls(trace, lanes, memory)
        marks: Marks = function.lierb_marks
        marks.trace = trace
        return marks

    @property
    def builder(self) -> ir.IRBuilder:
        return self.trace.builder

    @property
    def whole(self) -> ir.Value:
        """Return the pointer to all marks, as a pack."""
        return self.builder.bitcast(self.memory, pack_of(self.lanes).as_pointer())

    @property
    def pack(self) -> Lane:
        return Lane(self.trace, self.builder.load(self.whole, align=8))

    @property
    def are_clear(self) -> Predicate:
        """Return whether all marks are CLEAR."""
        return (self.pack == float(CLEAR)).reduced("and")

    def is_clear(self, lane: ir.Value | None) -> ir.Value:
        """Return whether a lane's mark is CLEAR; for None, whether any mark is."""
        if lane is None:
            return (self.pack == float(CLEAR)).reduced("or").value
        mark = self.builder.load(_place(self.builder, self.memory, lane))
        return self.builder.fcmp_ordered("==", mark, DOUBLE(CLEAR))

    def put(self, lane: ir.Value | None, mark: ir.Value) -> None:
        """Set a lane's mark; for None, the marks of all lanes that are CLEAR."""
        if lane is not None:
            self.builder.store(mark, _place(self.builder, self.memory, lane))
            return
        before = self.pack
        after = where(before == float(CLEAR), Lane(self.trace, mark), before)
        self.builder.store(after.value, self.whole, align=8)


class _Python:
    """Hold the mark and exceptions with the JIT off, which integrates one body at a time."""

    mark = float(CLEAR)
    exceptions: ClassVar[dict[int, Exception]] = {}


def call_in_python(function: Callable[..., Any], arguments: Any, count: int) -> Any:
    """Call a function on the plain numbers of one body; NaN as in `call_compiled`."""
    if _Python.mark != CLEAR:
        return (math.nan,) * count
    try:
        return function(arguments)
    except Exception as error:
        _Python.mark = float(id(error))
        _Python.exceptions[id(error)] = error
        return (math.nan,) * count


def exception_flags(like: Any) -> Any:
    """Return the marks of a block in a formula.   like : a pack of the block."""
    return Marks.of(like.trace, like.lanes).pack if isinstance(like, Lane) else _Python.mark


def set_exception_flags(numbers: Any) -> None:
    """Write the marks of a block."""
    if isinstance(numbers, Lane):
        known = Marks.of(numbers.trace, numbers.lanes)
        numbers.builder.store(numbers.value, known.whole, align=8)
    else:
        _Python.mark = float(numbers)


def exception_of(mark: int) -> Exception:
    """Return the exception of a mark. Call it once for each address: it frees the memory.

    Arrays among the exception's arguments are replaced by a description of their shape if their
    memory belonged to the function's caller, as that memory no longer exists.
    """
    if mark == STOPPED:
        return StopIteration()
    if mark in _Python.exceptions:
        return _Python.exceptions.pop(mark)
    run_uninterrupted(_raise.compile, (types.int64,))
    try:
        _raise(mark)
    except Exception as error:
        error.args = tuple(map(_lasting, error.args))
        return error
    raise AssertionError(f"no exception at {mark:#x}")


def _lasting(argument: Any) -> Any:
    if isinstance(argument, (tuple, list)):
        return tuple(map(_lasting, argument))
    if isinstance(argument, np.ndarray) and argument.base is None and not argument.flags.owndata:
        return f"an array of shape {argument.shape}"
    return argument


@numba.njit(**OPTIONS)
def _raise(address):  # no annotations: Numba compares signatures
    raise_again(address)


def _argument(
    context: Any, builder: ir.IRBuilder, ty: types.Type, sample: Any, cells: Iterator[ir.Value]
) -> ir.Value:
    """Return a value of type `ty`, with members loaded from the pointers `cells` in order."""
    if isinstance(ty, types.Array):
        pointers = [next(cells) for _ in range(sample.size)]
        array = context.make_array(ty)(context, builder)
        sizes = [context.get_constant(types.intp, n) for n in (*sample.shape, *sample.strides)]
        populate_array(
            array, data=pointers[0], shape=sizes[: ty.ndim], strides=sizes[ty.ndim :],
            itemsize=context.get_constant(types.intp, sample.itemsize), meminfo=None,
        )  # fmt: skip
        return array._getvalue()
    if isinstance(ty, types.BaseTuple):
        members = [
            _argument(context, builder, t, x, cells) for t, x in zip(ty, sample, strict=True)
        ]
        return context.make_tuple(builder, ty, members)
    return builder.load(next(cells))
