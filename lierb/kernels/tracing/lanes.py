"""A lane pack has L bodies' numbers side by side in SIMD registers, as one number of a formula.

A `Lane` represents an LLVM value, `<L x double>` or `double`, while a formula is traced: each
operator emits an instruction and returns its result. No instruction has a fast-math flag: with
`contract`, LLVM fuses a product or not, depending on the product's other uses, so that a body's
bits would depend on the recorded columns. Formulas write fused multiply-adds as `fma`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache, partial
from typing import Any

from llvmlite import ir

from lierb.compiler.internals import cgutils
from lierb.kernels.numbers.arithmetic import Turn, flatten, joined, plain, refilled, where
from lierb.kernels.numbers.tape import Tape
from lierb.kernels.tracing.cpu import HAS_FMA

DOUBLE = ir.DoubleType()
BIT = ir.IntType(1)
INT32 = ir.IntType(32)


# ---- traced numbers ----------------------------------------------------------------------------


def splat(builder: ir.IRBuilder, value: ir.Value, lanes: int) -> ir.Value:
    """Broadcast a value to `lanes` lanes, unless it has that many."""
    if _count(value.type) == lanes:
        return value
    vector = ir.VectorType(value.type, lanes)
    undefined = ir.Constant(vector, ir.Undefined)
    first = builder.insert_element(undefined, value, ir.Constant(INT32, 0))
    return builder.shuffle_vector(
        first, undefined, ir.Constant(ir.VectorType(INT32, lanes), [0] * lanes)
    )


def pack_of(lanes: int) -> ir.Type:
    """Return the LLVM type of a pack, or of one double."""
    return ir.VectorType(DOUBLE, lanes) if lanes > 1 else DOUBLE


def constant_of(like: ir.Type, value: float) -> ir.Constant:
    return _constant_pack(_count(like), float(value).hex())


@cache
def _constant_pack(lanes: int, digits: str) -> ir.Constant:
    """Return a constant pack of a number in hexadecimal: as cache keys, 0.0 and −0.0 are equal."""
    value = float.fromhex(digits)
    return ir.Constant(pack_of(lanes), value if lanes == 1 else [value] * lanes)


class Trace:
    """All numbers of one trace share a state.

    builder : builder of the emitted LLVM code.   target : Numba's target context; None for a trace
    that is thrown away.   rounds_twice : True if `fma` rounds as in NumPy.   assumed : masks that
    formulas have taken for granted; None if assumptions are not allowed.   tape : of the linear
    numbers in the formula, if any.
    """

    __slots__ = ("assumed", "builder", "declared", "rounds_twice", "tape", "target")

    def __init__(self, builder: ir.IRBuilder, target: Any = None) -> None:
        self.builder = builder
        self.target = target
        self.rounds_twice = not HAS_FMA
        self.assumed: list[Mask] | None = None
        self.tape = Tape()
        self.declared: dict[tuple[str, int], ir.Function] = {}

    def intrinsic(self, name: str, operands: Sequence[Any]) -> Lane:
        """Emit a call of the intrinsic `llvm.<name>`."""
        values = same_type(self, *operands)
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
        """Return the LLVM function of a formula in the traced module; add it on first use."""
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


def same_type(trace: Trace, *operands: Any) -> list[ir.Value]:
    """Convert operands to LLVM values of the widest type; Python numbers become constants."""
    # This function takes a quarter of a trace's time.
    widest: Any = None
    for x in operands:
        if type(x) is Lane and (widest is None or type(x.value.type) is ir.VectorType):
            widest = x.value.type

    def convert(x: Any) -> ir.Value:
        if type(x) is not Lane:
            return constant_of(widest, x)
        is_same = x.value.type is widest
        return x.value if is_same else splat(trace.builder, x.value, _count(widest))

    return [convert(x) for x in operands]


def _emits(method: str) -> tuple[Any, Any]:
    """Make an operator that emits an instruction, and its reflected operator."""
    emit = getattr(ir.IRBuilder, method)

    def operator(self: Lane, other: Any) -> Any:
        if not isinstance(other, (Lane, int, float)):
            return NotImplemented
        return Lane(self.trace, emit(self.builder, *same_type(self.trace, self, other)))

    def reflected(self: Lane, other: Any) -> Any:
        if not isinstance(other, (int, float)):
            return NotImplemented
        return Lane(self.trace, emit(self.builder, *same_type(self.trace, other, self)))

    return operator, reflected


def _compares(symbol: str) -> Any:
    def operator(self: Lane, other: Any) -> Any:
        if not isinstance(other, (Lane, int, float)):
            return NotImplemented
        operands = same_type(self.trace, self, other)
        return Mask(self.trace, self.trace.builder.fcmp_ordered(symbol, *operands))

    return operator


def _calls(name: str) -> Any:
    return staticmethod(partial(call_intrinsic, name))


def call_intrinsic(name: str, *operands: Any) -> Lane:
    """Emit a call of `llvm.<name>` on lanes, scalars and constants."""
    return trace_of_any(operands).intrinsic(name, operands)


class _Packs:
    """Packs in the stack frame of a function."""

    def __init__(self, builder: ir.IRBuilder, ty: ir.Type, count: int) -> None:
        self.builder, self.align = builder, 8 * _count(ty)
        with builder.goto_entry_block():
            self.start = builder.alloca(ty, INT32(count))
        self.start.align = self.align

    def load(self, place: ir.Value) -> ir.Value:
        return self.builder.load(self.builder.gep(self.start, [place]), align=self.align)

    def store(self, place: ir.Value, pack: ir.Value) -> None:
        self.builder.store(pack, self.builder.gep(self.start, [place]), align=self.align)


def trace_of_any(operands: Sequence[Any]) -> Trace:
    for x in operands:
        if type(x) is Lane:
            return x.trace
    raise TypeError("none of these numbers is traced")


class Traced:
    """A traced value is backed by an LLVM value."""

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
    """A lane pack is a traced double or pack of doubles.

    Comparisons are ordered: false if an operand is NaN.
    """

    __slots__ = ()
    __array_ufunc__ = None
    __hash__ = None  # type: ignore[assignment]

    @property
    def lanes(self) -> int:
        return _count(self.value.type)

    __add__, __radd__ = _emits("fadd")
    __sub__, __rsub__ = _emits("fsub")
    __mul__, __rmul__ = _emits("fmul")
    __truediv__, __rtruediv__ = _emits("fdiv")
    __lt__, __le__ = _compares("<"), _compares("<=")
    __gt__, __ge__ = _compares(">"), _compares(">=")
    __eq__ = _compares("==")

    sqrt, absolute, rint, floor = map(_calls, ("sqrt", "fabs", "rint", "floor"))
    minimum, maximum = _calls("minnum"), _calls("maxnum")

    @staticmethod
    def fma(a: Any, b: Any, c: Any) -> Any:
        trace = trace_of_any((a, b, c))
        return a * b + c if trace.rounds_twice else trace.intrinsic("fma", (a, b, c))

    @staticmethod
    def call(formula: Callable[..., Any], count: int, *numbers: Any) -> tuple[Lane, ...]:
        """Emit the call of a formula; see `lierb.kernels.numbers.arithmetic.apart`."""
        trace = trace_of_any(numbers)
        values = same_type(trace, *numbers)
        function = trace.function_of(formula, [v.type for v in values], count)
        results = trace.builder.call(function, values)
        return tuple(Lane(trace, trace.builder.extract_value(results, k)) for k in range(count))

    @staticmethod
    def repeat(start: Any, turn: Turn, most: int, like: Lane) -> tuple[Any, Mask, Lane]:
        """Emit `turn` once, as the body of a loop with its state in phi nodes."""
        trace, builder, ty = like.trace, like.builder, like.value.type

        everywhere, none = (like == like) | True, like.constant(0.0)
        given = (value_as(ty, plain(x)) for x in flatten(start))
        first = [*given, everywhere.value, none.value, INT32(0)]
        entry = builder.block
        loop, after = (builder.append_basic_block(name) for name in ("repeat", "repeated"))
        builder.branch(loop)
        builder.position_at_end(loop)
        phis = [builder.phi(value.type) for value in first]
        *states, going, turns, count = phis
        old = refilled(start, (Lane(trace, state) for state in states))
        mask, taken = Mask(trace, going), Lane(trace, turns)

        # No assumptions in the loop: a mask would be checked for the last turn only.
        assumed, trace.assumed = trace.assumed, None
        new, is_unfinished = turn(old)
        trace.assumed = assumed
        new, taken = where(mask, new, old), where(mask, taken + 1.0, taken)
        mask = mask & is_unfinished

        counted = builder.add(count, INT32(1))
        is_allowed = builder.icmp_signed("<", counted, INT32(most))
        is_next = builder.and_(mask.reduced("or").value, is_allowed)
        last = [*(x.value for x in flatten(new)), mask.value, taken.value, counted]
        for phi, before, now in zip(phis, first, last, strict=True):
            phi.add_incoming(before, entry)
            phi.add_incoming(now, builder.block)
        builder.cbranch(is_next, loop, after)
        builder.position_at_end(after)
        return new, mask, taken

    @staticmethod
    def for_rows(
        like: Lane, formula: Callable[..., Any], *rows: tuple[Any, ...]
    ) -> list[tuple[Lane, ...]]:
        """Emit `formula` once, as the body of a loop over rows in memory."""
        trace, builder, ty = like.trace, like.builder, like.value.type
        given = _Packs(builder, ty, len(rows) * len(rows[0]))
        for i, x in enumerate(x for row in rows for x in row):
            given.store(INT32(i), value_as(ty, x))
        with cgutils.for_range(builder, INT32(len(rows))) as loop:
            first = builder.mul(loop.index, INT32(len(rows[0])))
            places = [builder.add(first, INT32(i)) for i in range(len(rows[0]))]
            numbers = formula(*(Lane(trace, given.load(place)) for place in places))
            made = _Packs(builder, ty, len(rows) * len(numbers))
            first = builder.mul(loop.index, INT32(len(numbers)))
            for i, x in enumerate(numbers):
                made.store(builder.add(first, INT32(i)), x.value)
        results = [Lane(trace, made.load(INT32(i))) for i in range(len(rows) * len(numbers))]
        starts = range(0, len(results), len(numbers))
        return [tuple(results[i : i + len(numbers)]) for i in starts]

    def real(self) -> Lane:
        return self

    def __neg__(self) -> Lane:
        return Lane(self.trace, self.builder.fneg(self.value))

    def __bool__(self) -> bool:
        raise TypeError("a lane pack has no single truth value: use where(mask, a, b), not if")

    def constant(self, number: float) -> Lane:
        """Return a constant with the same number of lanes."""
        return Lane(self.trace, constant_of(self.value.type, number))

    def widened(self, lanes: int) -> Lane:
        """Broadcast the number to `lanes` lanes."""
        return Lane(self.trace, splat(self.builder, self.value, lanes))


def value_as(pack: ir.Type, x: Any) -> ir.Value:
    """Convert a number to an LLVM value of the type `pack`."""
    if not isinstance(x, Lane):
        return constant_of(pack, x)
    return splat(x.builder, x.value, _count(pack))


class Mask(Traced):
    """A mask is a traced truth value per lane."""

    __slots__ = ()

    def _combine(self, other: Any, method: str) -> Mask:
        if isinstance(other, Mask):
            widest = max(_count(self.value.type), _count(other.value.type))
            both = (splat(self.builder, mask.value, widest) for mask in (self, other))
            return Mask(self.trace, getattr(self.builder, method)(*both))
        neutral = method == "and_"  # True & m = m, False | m = m
        if bool(other) == neutral:
            return self
        bits = ir.Constant(BIT, int(other))
        return Mask(self.trace, splat(self.builder, bits, _count(self.value.type)))

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
        """Reduce to one truth value: kind "and" (all lanes) or "or" (any lane)."""
        if not isinstance(self.value.type, ir.VectorType):
            return Predicate(self.trace, self.value)
        signature = ir.FunctionType(BIT, [self.value.type])
        name = f"llvm.vector.reduce.{kind}.v{self.value.type.count}i1"
        function = cgutils.get_or_insert_function(self.builder.module, signature, name)
        return Predicate(self.trace, self.builder.call(function, [self.value]))

    def select(self, a: Any, b: Any) -> Lane:
        """Select `a` where the mask holds, `b` elsewhere; a scalar mask decides for all lanes."""
        widths = (x.lanes for x in (a, b) if isinstance(x, Lane))
        pack = pack_of(max(_count(self.value.type), *widths, 1))
        values = (value_as(pack, x) for x in (a, b))
        return Lane(self.trace, self.builder.select(self.value, *values))


class Predicate(Traced):
    """A predicate is a traced truth value of the whole pack, for a branch."""

    __slots__ = ()

    def __bool__(self) -> bool:
        raise TypeError("the truth of a traced predicate is known at run time only: use branch()")

    def branch(
        self, then: Callable[[], Any], otherwise: Callable[[], Any], likely: bool = True
    ) -> Any:
        """Emit both sides as blocks, of which one runs; both return tuples of one shape.

        likely : True if the first block runs nearly always. LLVM then moves the other block to
            the end, and reserves no registers for its values.
        """
        trace, builder, tape = self.trace, self.builder, self.trace.tape
        begin = len(tape.operations)
        with builder.if_else(self.value, likely=likely) as (first, second):
            with first:
                left = then()
                left_block, middle = builder.block, len(tape.operations)
            with second:
                right = otherwise()
                right_block, end = builder.block, len(tape.operations)

        def merged(predicate: Mask, a: Any, b: Any) -> Lane:
            widest = _widest_type((a, b))
            phi = builder.phi(widest)
            phi.add_incoming(_at_end_of(left_block, a, widest), left_block)
            phi.add_incoming(_at_end_of(right_block, b, widest), right_block)
            return Lane(trace, phi)

        def or_zero(own: ir.Block, other: ir.Block, x: Any) -> Any:
            """Return a factor or mask of a side behind the branch: zero if the other side ran."""
            if not isinstance(x, Traced):
                return x
            phi = builder.phi(x.value.type)
            phi.add_incoming(x.value, own)
            phi.add_incoming(ir.Constant(x.value.type, None), other)
            return type(x)(trace, phi)

        tape.replace(begin, middle, partial(or_zero, left_block, right_block))
        tape.replace(middle, end, partial(or_zero, right_block, left_block))
        return joined(left, right, partial(merged, Mask(trace, self.value)))


def _widest_type(numbers: Sequence[Any]) -> ir.Type:
    kinds = [x.value.type for x in numbers if isinstance(x, Lane)] or [DOUBLE]
    return next((t for t in kinds if isinstance(t, ir.VectorType)), kinds[0])


def _at_end_of(block: ir.Block, x: Any, ty: ir.Type) -> ir.Value:
    if not isinstance(x, Lane):
        return constant_of(ty, x)
    builder = ir.IRBuilder(block)
    builder.position_before(block.terminator)
    return splat(builder, x.value, _count(ty))
