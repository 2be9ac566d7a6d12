"""Packs in rows of memory, loops of a length known at run time, and procedures.

A formula on tuples is unrolled: it has instructions for each number. For a system whose size is
known at run time only, the numbers are in memory, and the formula of one part runs in a loop.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from functools import partial
from itertools import islice
from typing import Any

from llvmlite import ir

from lierb.compiler.internals import cgutils
from lierb.kernels.numbers.arithmetic import plain
from lierb.kernels.numbers.dual import Dual, parts_of, value_of
from lierb.kernels.tracing.arrays import Index
from lierb.kernels.tracing.lanes import Lane, Trace, constant_of, pack_of, value_as
from lierb.kernels.tracing.memory_tape import MemoryTape, Procedure, open_tape

LINE = 64  # bytes; rows start at a multiple of it or, if they are shorter, of their own length


class Rows:
    """The memory has rows, each a pack of `lanes` numbers.

    rows[i] is row i, and rows[i:j] a tuple of rows; both ends are constants of the trace.

    packs : packs of a row: a number, and its derivatives if the memory has them.
    parts : derivatives that are read and written, packs − 1, or 0 for the numbers alone.

    An open `MemoryTape` takes the second pack of a row as its gain.
    """

    def __init__(
        self, memory: Index, lanes: int, first: Index | int = 0, packs: int = 1, parts: int = 0
    ) -> None:
        self.trace, self.lanes, self.packs, self.parts = memory.trace, lanes, packs, parts
        self.pack = pack_of(lanes)
        self.align = min(8 * lanes, LINE)
        start = memory.builder.inttoptr(memory.value, self.pack.as_pointer())
        self.start = start if first == 0 else self._at(start, first)

    def _at(self, start: ir.Value, row: Index | int, part: int = 0) -> ir.Value:
        place = row if self.packs == 1 else row * self.packs + part
        offset = place.value if isinstance(place, Index) else ir.IntType(64)(place)
        return self.trace.builder.gep(start, [offset])

    def _load(self, row: Index | int, part: int) -> Lane:
        place = self._at(self.start, row, part)
        return Lane(self.trace, self.trace.builder.load(place, align=self.align))

    def at(self, first: Index) -> Rows:
        """Rows from `first` on."""
        rows = copy(self)
        rows.start = self._at(self.start, first)
        return rows

    def __getitem__(self, row: Any) -> Any:
        if isinstance(row, slice):
            return tuple(self[i] for i in range(row.start, row.stop))
        if self.packs > 1 and (tape := open_tape(self.trace)):
            return tape.loaded(self._load(row, 0), self._at(self.start, row, 1))
        value, *parts = (self._load(row, part) for part in range(1 + self.parts))
        return Dual(value, tuple(parts)) if parts else value

    def beside(self, row: Index | int, number: Lane) -> Any:
        """Return a number from elsewhere, of which the row has the gain."""
        tape = open_tape(self.trace)
        return tape.loaded(number, self._at(self.start, row, 1)) if tape else number

    @property
    def zero(self) -> Any:
        """A pack of zeros."""
        zero = Lane(self.trace, constant_of(self.pack, 0.0))
        return Dual(zero, (zero,) * self.parts) if self.parts else zero

    def put(self, row: Index | int, *numbers: Any) -> None:
        """Store numbers in successive rows."""
        tape = open_tape(self.trace) if self.packs > 1 else None
        for i, number in enumerate(numbers):
            if tape:
                tape.stored(number, self._at(self.start, row + i, 1))
                if not tape.runs:
                    continue
            for part, member in enumerate(_members(number, self.parts)):
                value = value_as(self.pack, plain(member))
                place = self._at(self.start, row + i, part)
                self.trace.builder.store(value, place, align=self.align)


def _members(number: Any, count: int) -> tuple[Any, ...]:
    """Return the value and the first `count` parts of a number, zeros if it has none."""
    return value_of(number), *(parts_of(number) or (0.0,) * count)[:count]


def integer_at(table: Index, place: Index | int) -> Index:
    """Load an integer from a table of int64 at the address `table`."""
    builder = table.builder
    start = builder.inttoptr(table.value, table.value.type.as_pointer())
    at = place.value if isinstance(place, Index) else table.value.type(place)
    return Index(table.trace, builder.load(builder.gep(start, [at])))


def for_each(count: Index, do: Callable[[Index], None], backward: bool = False) -> None:
    """Emit a loop that runs `do` for 0 … count − 1."""
    if tape := open_tape(count.trace):
        run, back = (partial(for_each, count, backward=x) for x in (backward, not backward))
        tape.note(do, run, back)
        return
    with cgutils.for_range(count.builder, count.value) as loop:
        i = Index(count.trace, loop.index)
        do(count + i * -1 + -1 if backward else i)


def accumulated(
    count: Index, start: Sequence[Any], step: Callable[[Index, tuple[Any, ...]], Sequence[Any]]
) -> tuple[Any, ...]:
    """Emit a loop that replaces some numbers by step(i, numbers), for i = 0 … count − 1.

    The numbers, packs or dual numbers of packs, stay in registers.
    """
    builder = count.builder
    sizes = [len(parts_of(x)) for x in start]
    slots = [
        [cgutils.alloca_once(builder, value_of(x).value.type) for _ in range(1 + size)]
        for x, size in zip(start, sizes, strict=True)
    ]

    def keep(numbers: Sequence[Any]) -> None:
        for places, size, x in zip(slots, sizes, numbers, strict=True):
            for slot, member in zip(places, _members(x, size), strict=True):
                builder.store(value_as(slot.type.pointee, member), slot)

    def kept() -> tuple[Any, ...]:
        loaded = ([Lane(count.trace, builder.load(slot)) for slot in places] for places in slots)
        return tuple(Dual(x, tuple(parts)) if parts else x for x, *parts in loaded)

    keep(start)
    for_each(count, lambda i: keep(step(i, kept())))
    return kept()


def switch(kind: Index, cases: Sequence[Any], do: Callable[[Any], None]) -> None:
    """Emit a switch that runs do(cases[kind]), for an integer that is known at run time."""
    if tape := open_tape(kind.trace):
        tape.note(do, partial(switch, kind, cases))
        return
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
    if tape := open_tape(number.trace):
        tape.note(do, partial(if_not_zero, number))
        return
    is_some = number.builder.icmp_signed("!=", number.value, number.value.type(0))
    with number.builder.if_then(is_some, likely=True):
        do()


def procedure(name: str, formula: Callable[..., None], *operands: Any) -> None:
    """Emit a call of formula(*operands), whose code the module has once.

    name : of the code, the same for the same formula and constants.
    operands : integers, packs, and dual numbers of packs.
    """
    trace, sizes = operands[0].trace, [len(parts_of(x)) for x in operands]
    if tape := open_tape(trace):
        _note_procedure(tape, name, formula, operands)
        return
    members = [m for x, size in zip(operands, sizes, strict=True) for m in _members(x, size)]
    module = trace.builder.module
    if name not in module.globals:
        types = [x.value.type for x in members]
        function = ir.Function(module, ir.FunctionType(ir.VoidType(), types), name)
        function.linkage = "internal"
        function.attributes.alignstack = LINE
        for attribute in ("noinline", "nounwind"):
            function.attributes.add(attribute)
        own = Trace(ir.IRBuilder(function.append_basic_block()), trace.target)
        own.rounds_twice = trace.rounds_twice
        pairs = zip(members, function.args, strict=True)
        given = iter([type(x)(own, operand) for x, operand in pairs])
        whole = [(next(given), tuple(islice(given, size))) for size in sizes]
        formula(*(Dual(x, parts) if parts else x for x, parts in whole))
        own.builder.ret_void()
    trace.builder.call(module.globals[name], [x.value for x in members])


def _note_procedure(
    tape: MemoryTape, name: str, formula: Callable[..., None], operands: tuple[Any, ...]
) -> None:
    """Note a call of formula(*operands) on a tape."""
    own = [value_of(x) for x in operands]
    is_linear = [bool(parts_of(x)) for x in operands]

    def transposed(*numbers: Any) -> None:
        *given, address = numbers
        inner = MemoryTape(address.trace, tape.lanes, runs=False)
        pairs = zip(given, is_linear, strict=True)
        opened = [Dual(x, (inner.input(),)) if linear else x for x, linear in pairs]
        with inner.recording():
            formula(*opened)
        Rows(address, tape.lanes).put(0, *inner.gains(()))

    def transpose(slots: Any) -> None:
        address = tape.trace.builder.ptrtoint(slots, operands[0].value.type)
        procedure(f"{name}.transposed", transposed, *own, Index(tape.trace, address))

    linear = [part.place for x in operands for part in parts_of(x)]
    tape.note_code(Procedure(tape, lambda: procedure(name, formula, *own), transpose, linear))
