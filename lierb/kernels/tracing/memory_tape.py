"""A tape of a formula on rows of memory, each of which has a gain beside its number.

A load is an input of the tape, whose gain is added to that of the row. A store takes the gain of
its row, which is zero then. Loops, switches and procedures are not unrolled: the tape notes their
code, and emits its transpose in their place. For this it records the code once more, within one
turn or case, and with its loads from memory as it is after the formula. So a formula must not store
a row after code that has loaded it, unless its numbers enter sums alone. Procedures may overwrite
rows of those before; before the transpose of one, it is run again, with the loops since the one
before it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

from llvmlite import ir

from lierb.kernels.numbers.dual import Dual, parts_of
from lierb.kernels.numbers.tape import Gained, Linear, Tape
from lierb.kernels.tracing.lanes import Lane, Trace, constant_of, pack_of, value_as

Emit = Callable[[Callable[..., None]], None]


class MemoryTape(Tape):
    """The tape of a trace.

    runs : True to run the code of loops, switches and procedures when it is noted, and to store;
    False for code whose results are in memory.
    """

    def __init__(self, trace: Trace, lanes: int, runs: bool = True) -> None:
        super().__init__()
        self.trace, self.lanes, self.pack, self.runs = trace, lanes, pack_of(lanes), runs
        self.is_open = False
        trace.tape = self

    @contextmanager
    def recording(self, is_open: bool = True, runs: bool | None = None) -> Iterator[None]:
        before = self.is_open, self.runs
        self.is_open, self.runs = is_open, self.runs if runs is None else runs
        yield
        self.is_open, self.runs = before

    def gains(self, results: Any) -> list[Any]:
        with self.recording(is_open=False):
            return super().gains(results)

    def loaded(self, number: Lane, gain: ir.Value) -> Dual:
        """Return a number that is loaded from a row.   gain : pointer to the row's gain."""
        self.operations.append(_Load(self, gain))
        return Dual(number, (Linear(self, len(self.operations) - 1),))

    def stored(self, number: Any, gain: ir.Value) -> None:
        """Note that a number is stored in a row."""
        parts = [part.place for part in parts_of(number) if isinstance(part, Linear)]
        self.operations.append(_Store(self, gain, parts))

    def note(self, do: Callable[..., None], run: Emit, back: Emit | None = None) -> None:
        """Note a loop or a switch.

        do : the code inside.   run : function that emits the loop or switch around some code.
        back : the same, for a loop with its turns in reversed order.
        """
        self.note_code(_Code(self, do, run, back or run))

    def note_code(self, code: Any) -> None:
        """Note an operation, and run it if the tape runs its code."""
        self.operations.append(code)
        if self.runs:
            with self.recording(is_open=False):
                code.again()

    def load(self, pointer: ir.Value) -> Lane:
        return Lane(self.trace, self.trace.builder.load(pointer, align=self.pack_bytes))

    def store(self, pointer: ir.Value, number: Any) -> None:
        value = value_as(self.pack, number)
        self.trace.builder.store(value, pointer, align=self.pack_bytes)

    @property
    def pack_bytes(self) -> int:
        return 8 * self.lanes

    def slot(self, count: int = 1) -> ir.Value:
        """Return a pointer to packs in the stack frame of the function."""
        builder = self.trace.builder
        with builder.goto_entry_block():
            slot = builder.alloca(self.pack, count)
        slot.align = self.pack_bytes
        return slot


class _Load(NamedTuple):
    tape: MemoryTape
    gain: ir.Value

    def back(self, place: int, gained: Gained) -> None:
        if place in gained:
            self.tape.store(self.gain, self.tape.load(self.gain) + gained.pop(place))


class _Store(NamedTuple):
    tape: MemoryTape
    gain: ir.Value
    parts: list[int]

    def back(self, place: int, gained: Gained) -> None:
        for part in self.parts:
            gained.add(part, self.tape.load(self.gain))
        self.tape.store(self.gain, 0.0)


class _Code(NamedTuple):
    """Code of a loop or a switch; see `MemoryTape.note`."""

    tape: MemoryTape
    do: Callable[..., None]
    run: Emit
    reverse: Emit

    def again(self) -> None:
        self.run(self.do)

    def back(self, place: int, gained: Gained) -> None:
        """Emit the transposed code; add its gains by numbers that are computed before it."""
        tape, slots = self.tape, dict[int, ir.Value]()

        def transposed(*arguments: Any) -> None:
            first, own = len(tape.operations), Gained()
            with tape.recording(runs=False):
                self.do(*arguments)
            with tape.recording(is_open=False, runs=False):
                tape.give_back(own, first)
            del tape.operations[first:]
            for outer, gain in own.items():
                if outer not in slots:
                    slots[outer] = tape.slot()
                tape.store(slots[outer], tape.load(slots[outer]) + gain)

        before = tape.trace.builder.block
        self.reverse(transposed)
        start = ir.IRBuilder(before)
        start.position_before(before.terminator)
        for outer, slot in slots.items():
            start.store(constant_of(tape.pack, 0.0), slot, align=tape.pack_bytes)
            gained.add(outer, tape.load(slot))


class Procedure(NamedTuple):
    """Call of a procedure.

    run : calls it.   transpose : calls its transpose, with a pointer to a pack for the gain by each
    of the operands in `linear`.
    """

    tape: MemoryTape
    run: Callable[[], None]
    transpose: Callable[[ir.Value], None]
    linear: list[int]

    def again(self) -> None:
        self.run()

    def back(self, place: int, gained: Gained) -> None:
        tape = self.tape
        if tape.runs:
            first = place
            while first and not isinstance(tape.operations[first - 1], Procedure):
                first -= 1
            for code in tape.operations[first : place + 1]:
                if isinstance(code, _Code | Procedure):
                    code.again()
        slots = tape.slot(max(len(self.linear), 1))
        self.transpose(slots)
        for i, part in enumerate(self.linear):
            pointer = tape.trace.builder.gep(slots, [ir.IntType(32)(i)])
            gained.add(part, tape.load(pointer))


def open_tape(trace: Trace) -> MemoryTape | None:
    """Return the tape that records the trace, if any."""
    tape = trace.tape
    return tape if isinstance(tape, MemoryTape) and tape.is_open else None
