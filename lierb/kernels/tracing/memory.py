"""Packs in rows of memory, loops of a length known at run time, and procedures.

A formula on tuples is unrolled: it has instructions for each number. For a system whose size is
known at run time only, the numbers are in memory, and the formula of one part runs in a loop.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from typing import Any

from llvmlite import ir

from lierb.compiler.internals import cgutils
from lierb.kernels.numbers.arithmetic import plain
from lierb.kernels.tracing.arrays import Index
from lierb.kernels.tracing.lanes import DOUBLE, Lane, Trace, constant_of

LINE = 64  # bytes; rows start at a multiple of it or, if they are shorter, of their own length


class Rows:
    """The memory has rows, each a pack of `lanes` numbers.

    rows[i] is row i, and rows[i:j] a tuple of rows; both ends are constants of the trace.
    """

    def __init__(self, memory: Index, lanes: int, first: Index | int = 0) -> None:
        self.trace, self.lanes = memory.trace, lanes
        self.pack = ir.VectorType(DOUBLE, lanes) if lanes > 1 else DOUBLE
        self.align = min(8 * lanes, LINE)
        start = memory.builder.inttoptr(memory.value, self.pack.as_pointer())
        self.start = start if first == 0 else self._at(start, first)

    def _at(self, start: ir.Value, row: Index | int) -> ir.Value:
        offset = row.value if isinstance(row, Index) else ir.IntType(64)(row)
        return self.trace.builder.gep(start, [offset])

    def at(self, first: Index) -> Rows:
        """Rows from `first` on."""
        rows = copy(self)
        rows.start = self._at(self.start, first)
        return rows

    def __getitem__(self, row: Any) -> Any:
        if isinstance(row, slice):
            return tuple(self[i] for i in range(row.start, row.stop))
        return Lane(
            self.trace, self.trace.builder.load(self._at(self.start, row), align=self.align)
        )

    @property
    def zero(self) -> Lane:
        """A pack of zeros."""
        return Lane(self.trace, constant_of(self.pack, 0.0))

    def put(self, row: Index | int, *numbers: Any) -> None:
        """Store numbers in successive rows."""
        for i, number in enumerate(numbers):
            x = plain(number)
            is_traced = isinstance(x, Lane)
            value = x.widened(self.lanes).value if is_traced else constant_of(self.pack, x)
            self.trace.builder.store(value, self._at(self.start, row + i), align=self.align)


def integer_at(table: Index, place: Index | int) -> Index:
    """Load an integer from a table of int64 at the address `table`."""
    builder = table.builder
    start = builder.inttoptr(table.value, table.value.type.as_pointer())
    at = place.value if isinstance(place, Index) else table.value.type(place)
    return Index(table.trace, builder.load(builder.gep(start, [at])))


def for_each(count: Index, do: Callable[[Index], None], backward: bool = False) -> None:
    """Emit a loop that runs `do` for 0 … count − 1."""
    with cgutils.for_range(count.builder, count.value) as loop:
        i = Index(count.trace, loop.index)
        do(count + i * -1 + -1 if backward else i)


def accumulated(
    count: Index,
    start: Sequence[Lane],
    step: Callable[[Index, tuple[Lane, ...]], Sequence[Lane]],
    backward: bool = False,
) -> tuple[Lane, ...]:
    """Emit a loop that replaces some packs by step(i, packs), for i = 0 … count − 1.

    The packs stay in registers.
    """
    builder = count.builder
    slots = [cgutils.alloca_once(builder, x.value.type) for x in start]

    def keep(numbers: Sequence[Lane]) -> None:
        for slot, x in zip(slots, numbers, strict=True):
            builder.store(x.value, slot)

    def kept() -> tuple[Lane, ...]:
        return tuple(Lane(count.trace, builder.load(slot)) for slot in slots)

    keep(start)
    for_each(count, lambda i: keep(step(i, kept())), backward)
    return kept()


def switch(kind: Index, cases: Sequence[Any], do: Callable[[Any], None]) -> None:
    """Emit a switch that runs do(cases[kind]), for an integer that is known at run time."""
    builder = kind.builder
    *others, last = [builder.append_basic_block("case") for _ in cases]
    end = builder.append_basic_block("switched")
    chosen = builder.switch(kind.value, last)
    for number, block in enumerate(others):
        chosen.add_case(kind.value.type(number), block)
    for case, block in zip(cases, (*others, last), strict=True):
        builder.position_at_end(block)
        do(case)
        builder.branch(end)
    builder.position_at_end(end)


def if_not_zero(number: Index, do: Callable[[], None]) -> None:
    """Emit a branch that runs `do` where an integer is not 0."""
    is_some = number.builder.icmp_signed("!=", number.value, number.value.type(0))
    with number.builder.if_then(is_some, likely=True):
        do()


def procedure(name: str, formula: Callable[..., None], *operands: Index | Lane) -> None:
    """Emit a call of formula(*operands), whose code the module has once.

    name : of the code, the same for the same formula and constants.
    """
    trace = operands[0].trace
    module = trace.builder.module
    if name not in module.globals:
        types = [x.value.type for x in operands]
        function = ir.Function(module, ir.FunctionType(ir.VoidType(), types), name)
        function.linkage = "internal"
        function.attributes.alignstack = LINE
        for attribute in ("noinline", "nounwind"):
            function.attributes.add(attribute)
        own = Trace(ir.IRBuilder(function.append_basic_block()), trace.target)
        own.rounds_twice = trace.rounds_twice
        pairs = zip(operands, function.args, strict=True)
        formula(*(type(x)(own, operand) for x, operand in pairs))
        own.builder.ret_void()
    trace.builder.call(module.globals[name], [x.value for x in operands])
