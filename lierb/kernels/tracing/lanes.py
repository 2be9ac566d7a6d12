"""Lane packs: L bodies side by side in SIMD registers, as a number that formulas compute with.

A `Lane` stands for an LLVM value, `<L x double>` or `double`, while a formula is being traced: each
operator emits the instruction and returns the result. No instruction carries a fast-math flag: with
`contract` LLVM may or may not fuse a product depending on what else uses it, and a body's bits
would depend on what is recorded. Fused multiply-adds are written as `fma` in the formulas instead.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Sequence
from functools import cache, partial
from typing import Any

import llvmlite.binding as llvm
from llvmlite import ir
from numba import config, types
from numba.extending import models, register_model

from lierb.compiler.internals import cgutils
from lierb.kernels.numbers.arithmetic import joined

DOUBLE = ir.DoubleType()
BIT = ir.IntType(1)
INT32 = ir.IntType(32)


def _host_features() -> frozenset[str]:
    """CPU features that Numba compiles for (its own override respected)."""
    if config.CPU_FEATURES is not None:
        return frozenset(f[1:] for f in config.CPU_FEATURES.split(",") if f.startswith("+"))
    if config.CPU_NAME == "generic":
        return frozenset()
    return frozenset(name for name, present in llvm.get_host_cpu_features().items() if present)


def _default_lanes() -> int:
    """Doubles in one vector register: 8 with AVX-512, 4 with AVX, 2 otherwise."""
    override = os.environ.get("LIERB_LANES")
    if override is not None:
        if override not in {"1", "2", "4", "8"}:
            raise ValueError(f"LIERB_LANES must be 1, 2, 4 or 8, got {override!r}")
        return int(override)
    if "avx512f" in CPU_FEATURES:
        return 8
    return 4 if "avx" in CPU_FEATURES else 2


CPU_FEATURES = _host_features()
IS_X86 = llvm.get_process_triple().split("-")[0] in {"x86_64", "i386", "i686", "amd64"}
# Without the instruction, llvm.fma would call libm once a lane.
HAS_FMA = "fma" in CPU_FEATURES or not IS_X86
DEFAULT_LANES = 1 if config.DISABLE_JIT else _default_lanes()


# ---- the Numba type that carries lanes between traced formulas ---------------------------------


class LaneType(types.Type):
    """Numba type of a pack of `lanes` doubles."""

    def __init__(self, lanes: int) -> None:
        self.lanes = lanes
        super().__init__(name=f"Lane<{lanes}>")


@register_model(LaneType)
class _LaneModel(models.PrimitiveModel):
    def __init__(self, manager: Any, fe_type: LaneType) -> None:
        super().__init__(manager, fe_type, ir.VectorType(DOUBLE, fe_type.lanes))


# ---- traced numbers ----------------------------------------------------------------------------


def _splat(builder: ir.IRBuilder, value: ir.Value, lanes: int) -> ir.Value:
    vector = ir.VectorType(value.type, lanes)
    undefined = ir.Constant(vector, ir.Undefined)
    first = builder.insert_element(undefined, value, ir.Constant(INT32, 0))
    return builder.shuffle_vector(
        first, undefined, ir.Constant(ir.VectorType(INT32, lanes), [0] * lanes)
    )


def _constant(like: ir.Type, value: float) -> ir.Constant:
    lanes = like.count if isinstance(like, ir.VectorType) else 1
    return _constant_pack(lanes, float(value).hex())


@cache
def _constant_pack(lanes: int, digits: str) -> ir.Constant:
    """By its hexadecimal digits: as numbers, 0 and −0 would be the same."""
    value = float.fromhex(digits)
    if lanes == 1:
        return ir.Constant(DOUBLE, value)
    return ir.Constant(ir.VectorType(DOUBLE, lanes), [value] * lanes)


class Trace:
    """What all numbers of one trace share.

    builder : of the LLVM code that is emitted.   target : Numba's context that it is for; None for
    a trace that is thrown away.   rounds_twice : whether `fma` rounds as NumPy does.   assumed :
    masks that were taken for granted; None where nothing is.
    """

    __slots__ = ("assumed", "builder", "declared", "rounds_twice", "target")

    def __init__(self, builder: ir.IRBuilder, target: Any = None) -> None:
        self.builder = builder
        self.target = target
        self.rounds_twice = not HAS_FMA
        self.assumed: list[Mask] | None = None
        self.declared: dict[tuple[str, int], ir.Function] = {}

    def intrinsic(self, name: str, operands: Sequence[Any]) -> Lane:
        """`llvm.<name>` of some numbers."""
        values = _same_type(self, *operands)
        ty = values[0].type
        key = name, _count(ty)
        if key not in self.declared:
            suffix = f"v{ty.count}f64" if isinstance(ty, ir.VectorType) else "f64"
            signature = ir.FunctionType(ty, [ty] * len(values))
            self.declared[key] = cgutils.get_or_insert_function(
                self.builder.module, signature, f"llvm.{name}.{suffix}"
            )
        return Lane(self, self.builder.call(self.declared[key], values))

    def function_of(
        self, formula: Callable[..., Any], operands: list[ir.Type], count: int
    ) -> ir.Function:
        """A function in the module that is traced, of `count` results; made where it is missing."""
        module, ty = self.builder.module, operands[0]
        rounding = "twice" if self.rounds_twice else "once"
        name = f"{formula.__module__}.{formula.__qualname__}.{_count(ty)}.rounded_{rounding}"
        if name not in module.globals:
            kind = ir.LiteralStructType([ty] * count)
            function = ir.Function(module, ir.FunctionType(kind, operands), name)
            function.linkage = "internal"
            for attribute in ("cold", "noinline", "nounwind"):
                function.attributes.add(attribute)
            trace = Trace(ir.IRBuilder(function.append_basic_block()), self.target)
            trace.rounds_twice = self.rounds_twice
            result: ir.Value = ir.Constant(kind, ir.Undefined)
            for k, x in enumerate(formula(*(Lane(trace, operand) for operand in function.args))):
                result = trace.builder.insert_value(result, x.value, k)
            trace.builder.ret(result)
        return module.globals[name]


def _count(ty: ir.Type) -> int:
    return ty.count if isinstance(ty, ir.VectorType) else 1


def _same_type(trace: Trace, *operands: Any) -> list[ir.Value]:
    """LLVM values of one type: the widest among `operands`; Python numbers become constants."""
    # A quarter of a trace's time goes by here.
    widest: Any = None
    for x in operands:
        if type(x) is Lane and (widest is None or type(x.value.type) is ir.VectorType):
            widest = x.value.type

    def convert(x: Any) -> ir.Value:
        if type(x) is not Lane:
            return _constant(widest, x)
        if x.value.type is widest or x.value.type == widest:
            return x.value
        return _splat(trace.builder, x.value, widest.count)

    return [convert(x) for x in operands]


def _emits(method: str) -> Any:
    emit = getattr(ir.IRBuilder, method)

    def operator(self: Lane, other: Any) -> Any:
        if not isinstance(other, (Lane, int, float)):
            return NotImplemented
        trace = self.trace
        return Lane(trace, emit(trace.builder, *_same_type(trace, self, other)))

    return operator


def _emits_reflected(method: str) -> Any:
    emit = getattr(ir.IRBuilder, method)

    def operator(self: Lane, other: Any) -> Any:
        if not isinstance(other, (int, float)):
            return NotImplemented
        trace = self.trace
        return Lane(trace, emit(trace.builder, *_same_type(trace, other, self)))

    return operator


def _compares(symbol: str) -> Any:
    def operator(self: Lane, other: Any) -> Any:
        if not isinstance(other, (Lane, int, float)):
            return NotImplemented
        operands = _same_type(self.trace, self, other)
        return Mask(self.trace, self.trace.builder.fcmp_ordered(symbol, *operands))

    return operator


def _calls(name: str) -> Any:
    return staticmethod(partial(call_intrinsic, name))


def call_intrinsic(name: str, *operands: Any) -> Lane:
    """`llvm.<name>` on lanes, scalars and constants mixed."""
    return _trace_of_any(operands).intrinsic(name, operands)


def _trace_of_any(operands: Sequence[Any]) -> Trace:
    for x in operands:
        if type(x) is Lane:
            return x.trace
    raise TypeError("none of these numbers is traced")


class Traced:
    """What an LLVM value stands for."""

    __slots__ = ("trace", "value")
    rank = 1

    def __init__(self, trace: Trace, value: ir.Value) -> None:
        self.trace = trace
        self.value = value

    @property
    def builder(self) -> ir.IRBuilder:
        return self.trace.builder

    def trace_of(self) -> Trace:
        return self.trace


class Lane(Traced):
    """A traced double, or pack of doubles. Comparisons are ordered: false with a NaN."""

    __slots__ = ()
    __array_ufunc__ = None
    __hash__ = None  # type: ignore[assignment]

    @property
    def lanes(self) -> int:
        return _count(self.value.type)

    __add__, __radd__ = _emits("fadd"), _emits_reflected("fadd")
    __sub__, __rsub__ = _emits("fsub"), _emits_reflected("fsub")
    __mul__, __rmul__ = _emits("fmul"), _emits_reflected("fmul")
    __truediv__, __rtruediv__ = _emits("fdiv"), _emits_reflected("fdiv")
    __lt__, __le__ = _compares("<"), _compares("<=")
    __gt__, __ge__ = _compares(">"), _compares(">=")
    __eq__ = _compares("==")

    sqrt, absolute, rint, floor = map(_calls, ("sqrt", "fabs", "rint", "floor"))
    minimum, maximum = _calls("minnum"), _calls("maxnum")

    @staticmethod
    def fma(a: Any, b: Any, c: Any) -> Any:
        trace = _trace_of_any((a, b, c))
        return a * b + c if trace.rounds_twice else trace.intrinsic("fma", (a, b, c))

    @staticmethod
    def call(formula: Callable[..., Any], count: int, *numbers: Any) -> tuple[Lane, ...]:
        """Of `lierb.kernels.numbers.arithmetic.apart`."""
        trace = _trace_of_any(numbers)
        values = _same_type(trace, *numbers)
        function = trace.function_of(formula, [v.type for v in values], count)
        found = trace.builder.call(function, values)
        return tuple(Lane(trace, trace.builder.extract_value(found, k)) for k in range(count))

    def real(self) -> Lane:
        return self

    def __neg__(self) -> Lane:
        return Lane(self.trace, self.builder.fneg(self.value))

    def __bool__(self) -> bool:
        raise TypeError("a lane pack has no single truth value: use where(mask, a, b), not if")

    def constant(self, number: float) -> Lane:
        """A number of this one's kind."""
        return Lane(self.trace, _constant(self.value.type, number))

    def widened(self, lanes: int) -> Lane:
        """The same number in every one of `lanes` lanes."""
        if self.lanes == lanes:
            return self
        return Lane(self.trace, _splat(self.builder, self.value, lanes))


class Mask(Traced):
    """A traced truth value per lane."""

    __slots__ = ()

    def _widened(self, lanes: int) -> ir.Value:
        if _count(self.value.type) == lanes:
            return self.value
        return _splat(self.builder, self.value, lanes)

    def _combine(self, other: Any, method: str) -> Mask:
        if isinstance(other, Mask):
            widest = max(_count(self.value.type), _count(other.value.type))
            both = self._widened(widest), other._widened(widest)
            return Mask(self.trace, getattr(self.builder, method)(*both))
        neutral = method == "and_"  # True & m = m, False | m = m
        if bool(other) == neutral:
            return self
        ty = self.value.type
        bits = [int(other)] * ty.count if isinstance(ty, ir.VectorType) else int(other)
        return Mask(self.trace, ir.Constant(ty, bits))

    def __and__(self, other: Any) -> Mask:
        return self._combine(other, "and_")

    def __or__(self, other: Any) -> Mask:
        return self._combine(other, "or_")

    __rand__, __ror__ = __and__, __or__

    def __invert__(self) -> Mask:
        return Mask(self.trace, self.builder.not_(self.value))

    def __bool__(self) -> bool:
        raise TypeError(
            "a condition on many bodies has no single truth value: use lierb.where(condition, a, "
            "b) in place of if, and &, | in place of and, or"
        )

    def reduced(self, kind: str) -> Predicate:
        """One truth value for the whole pack: kind "and" (all lanes) or "or" (any lane)."""
        if not isinstance(self.value.type, ir.VectorType):
            return Predicate(self.trace, self.value)
        signature = ir.FunctionType(BIT, [self.value.type])
        name = f"llvm.vector.reduce.{kind}.v{self.value.type.count}i1"
        function = cgutils.get_or_insert_function(self.builder.module, signature, name)
        return Predicate(self.trace, self.builder.call(function, [self.value]))

    def select(self, a: Any, b: Any) -> Lane:
        """Lane by lane: `a` where it holds, `b` elsewhere; one for all lanes, if it is scalar."""
        widths = (x.lanes for x in (a, b) if isinstance(x, Lane))
        count = max(_count(self.value.type), *widths, 1)
        like = ir.VectorType(DOUBLE, count) if count > 1 else DOUBLE

        def convert(x: Any) -> ir.Value:
            return x.widened(count).value if isinstance(x, Lane) else _constant(like, x)

        return Lane(self.trace, self.builder.select(self.value, convert(a), convert(b)))


class Predicate(Traced):
    """A traced truth value of the whole pack, fit for a branch."""

    __slots__ = ()

    def __bool__(self) -> bool:
        raise TypeError("the truth of a traced predicate is known at run time only: use branch()")

    def branch(
        self, then: Callable[[], Any], otherwise: Callable[[], Any], likely: bool = True
    ) -> Any:
        """Emit both sides as blocks, of which one runs; they give numbers in one shape.

        likely : whether the first one does, nearly always. LLVM then keeps the other side out of
            the way, and what it needs out of the registers.
        """
        trace, builder = self.trace, self.builder
        with builder.if_else(self.value, likely=likely) as (first, second):
            with first:
                left = then()
                left_block = builder.block
            with second:
                right = otherwise()
                right_block = builder.block

        def merged(a: Any, b: Any) -> Lane:
            widest = _widest_type((a, b))
            phi = builder.phi(widest)
            phi.add_incoming(_at_end_of(left_block, a, widest), left_block)
            phi.add_incoming(_at_end_of(right_block, b, widest), right_block)
            return Lane(trace, phi)

        return joined(left, right, merged)


def call_library(name: str, *operands: Any) -> Lane:
    """A function of the C library, called for one lane after the other."""
    trace = _trace_of_any(operands)
    builder, values = trace.builder, _same_type(trace, *operands)
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
    """The last row of a table whose first column, which increases, is at most x; else the first.

    Lane by lane, by bisection without branches.
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

    def place_of(one: ir.Value) -> ir.Value:
        place, step = ir.Constant(INT32, 0), count // 2
        while step:
            further = builder.add(place, ir.Constant(INT32, step))
            is_below = builder.fcmp_ordered("<=", entry(memory[0], further), one)
            place, step = builder.select(is_below, further, place), step // 2
        return place

    if not isinstance(x.value.type, ir.VectorType):
        place = place_of(x.value)
        return [Lane(x.trace, entry(column, place)) for column in memory]
    packs: list[ir.Value] = [ir.Constant(x.value.type, ir.Undefined) for _ in memory]
    for lane in range(x.lanes):
        index = ir.Constant(INT32, lane)
        place = place_of(builder.extract_element(x.value, index))
        packs = [
            builder.insert_element(pack, entry(column, place), index)
            for pack, column in zip(packs, memory, strict=True)
        ]
    return [Lane(x.trace, pack) for pack in packs]


def _widest_type(numbers: Sequence[Any]) -> ir.Type:
    found = [x.value.type for x in numbers if isinstance(x, Lane)] or [DOUBLE]
    return next((t for t in found if isinstance(t, ir.VectorType)), found[0])


def _at_end_of(block: ir.Block, x: Any, ty: ir.Type) -> ir.Value:
    if not isinstance(x, Lane):
        return _constant(ty, x)
    if x.value.type == ty:
        return x.value
    builder = ir.IRBuilder(block)
    builder.position_before(block.terminator)
    return _splat(builder, x.value, ty.count)


# ---- traced integers and arrays ----------------------------------------------------------------


LINE = 8  # doubles in a cache line


class Index(Traced):
    """A traced integer (intp), for array positions."""

    __slots__ = ()

    def __add__(self, other: int | Index) -> Index:
        added = other.value if isinstance(other, Index) else self.value.type(other)
        return Index(self.trace, self.builder.add(self.value, added))

    def real(self) -> Lane:
        return Lane(self.trace, self.builder.sitofp(self.value, DOUBLE))


class ArrayRef(Traced):
    """A C-contiguous float64 array of any dimension, read and written a pack at a time."""

    __slots__ = ("data", "index_type", "shape")

    def __init__(self, trace: Trace, context: Any, ty: types.Array, value: ir.Value) -> None:
        super().__init__(trace, value)
        array = context.make_array(ty)(context, self.builder, value)
        self.data = array.data
        self.shape = cgutils.unpack_tuple(self.builder, array.shape, ty.ndim)
        self.index_type = self.shape[0].type

    def _as_value(self, i: Any) -> ir.Value:
        return i.value if isinstance(i, Index) else ir.Constant(self.index_type, i)

    def _pointer(self, index: Sequence[Any]) -> ir.Value:
        offset = self._as_value(index[0])
        for i, extent in zip(index[1:], self.shape[1:], strict=True):
            offset = self.builder.add(self.builder.mul(offset, extent), self._as_value(i))
        return self.builder.gep(self.data, [offset])

    def load(self, index: Sequence[Any], lanes: int) -> Lane:
        """`lanes` consecutive doubles from `index` on."""
        pointer = self._pointer(index)
        if lanes > 1:
            pointer = self.builder.bitcast(pointer, ir.VectorType(DOUBLE, lanes).as_pointer())
        return Lane(self.trace, self.builder.load(pointer, align=8))

    def store(self, index: Sequence[Any], number: Any, lanes: int) -> None:
        """Write a pack to `lanes` consecutive places from `index` on."""
        ty = ir.VectorType(DOUBLE, lanes) if lanes > 1 else DOUBLE
        value = number.widened(lanes).value if isinstance(number, Lane) else _constant(ty, number)
        pointer = self._pointer(index)
        if lanes > 1:
            pointer = self.builder.bitcast(pointer, ty.as_pointer())
        self.builder.store(value, pointer, align=8)

    def prefetch(self, index: Sequence[Any], count: int) -> None:
        """Have the cache lines of `count` consecutive doubles from `index` on at hand."""
        builder, byte = self.builder, ir.IntType(8).as_pointer()
        kind = ir.FunctionType(ir.VoidType(), [byte, INT32, INT32, INT32])
        fetch = cgutils.get_or_insert_function(builder.module, kind, "llvm.prefetch.p0")
        start = self._pointer(index)
        to_write, everywhere, data = INT32(1), INT32(3), INT32(1)
        for place in (*range(0, count, LINE), count - 1):
            line = builder.gep(start, [ir.Constant(self.index_type, place)])
            builder.call(fetch, [builder.bitcast(line, byte), to_write, everywhere, data])

    def gather(self, axis: int, place: Sequence[Any], lanes: int) -> Lane:
        """Lane i from `place` moved by i along `axis`; past the array's end, its last element."""
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
        """Write lane i of each pack at its place moved by i along `axis`, while inside."""
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
        """Lane by lane, `count` of them."""
        builder = self.builder
        packs = ir.ArrayType(ir.ArrayType(DOUBLE, lanes), len(numbers))
        buffer = cgutils.alloca_once(builder, packs)
        zero = ir.Constant(INT32, 0)
        for n, number in enumerate(numbers):
            ty = ir.VectorType(DOUBLE, lanes) if lanes > 1 else DOUBLE
            value = (
                number.widened(lanes).value if isinstance(number, Lane) else _constant(ty, number)
            )
            pointer = builder.gep(buffer, [zero, ir.Constant(INT32, n), zero])
            builder.store(value, builder.bitcast(pointer, ty.as_pointer()), align=8)
        start = self._as_value(places[0][axis])
        with cgutils.for_range(builder, count) as loop:
            moved = Index(self.trace, builder.add(start, loop.index))
            for n, place in enumerate(places):
                pointer = builder.gep(buffer, [zero, ir.Constant(INT32, n), loop.index])
                target = self._pointer([*place[:axis], moved, *place[axis + 1 :]])
                builder.store(builder.load(pointer), target, align=8)
