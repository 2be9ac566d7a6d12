"""Gains of an objective, in rows of memory, and numbers that have gains."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, TypeVar

from lierb.compiler.tags import Tag
from lierb.kernels.numbers.arithmetic import alike, class_of, flatten, load, refilled, store
from lierb.kernels.numbers.dual import Dual, parts_of, value_of
from lierb.kernels.numbers.tape import Tape
from lierb.kernels.numbers.zero import is_zero
from lierb.kernels.systems.plan import AnyPlan
from lierb.kernels.systems.system_of import system_of
from lierb.kernels.tracing.memory_tape import MemoryTape

Numbers = TypeVar("Numbers", bound=tuple[Any, ...])
END_TIME = -1  # the time at which an event ends a trajectory, as an objective
MARK = (1.0,)  # parts of a number of the body that has gains


@dataclass(frozen=True)
class Adjoint(Tag):
    """Tag of the code that differentiates one number at the end of the runs of a plan.

    plan : with derivatives of all inputs or, if it is looped, with gains.
    objective : END_TIME, 0 for the energy, else 1 + the index of an observable.
    """

    plan: AnyPlan
    objective: int

    @cached_property
    def plain(self) -> AnyPlan:
        """Return the plan of the same run without derivatives."""
        return replace(self.plan, moving=())

    @cached_property
    def inputs(self) -> int:
        """Return the number of inputs with gains: all but a state to continue from."""
        return int(system_of(self.plain).inputs["state"].start)

    @property
    def lanes(self) -> int:
        return self.plan.lanes


def tape_at(run: Adjoint, number: Any) -> Tape:
    """Return the tape of the formula to which a number belongs."""
    trace = class_of(type(number)).trace_of(number)
    if run.plan.is_looped:
        return MemoryTape(trace, run.lanes)
    return Tape() if trace is None else trace.tape


def marked(body: Any) -> Any:
    """Mark the numbers that depend on inputs."""
    if isinstance(body, tuple):
        return alike(body, map(marked, body))
    return Dual(value_of(body), MARK) if parts_of(body) else value_of(body)


def with_all_marked(numbers: Any) -> Any:
    """Mark all numbers that are no constants."""
    return refilled(numbers, (x if is_constant(x) else Dual(x, MARK) for x in flatten(numbers)))


def opened_body(tape: Tape, body: Any) -> Any:
    """Give the marked numbers inputs of the tape."""
    if isinstance(body, tuple):
        return alike(body, [opened_body(tape, x) for x in body])
    return Dual(body.value, (tape.input(),)) if isinstance(body, Dual) else body


def opened_numbers(tape: Tape, numbers: Numbers) -> Numbers:
    """Give the numbers of nested tuples inputs of the tape; constants have none."""
    opened = (x if is_constant(x) else Dual(x, (tape.input(),)) for x in flatten(numbers))
    return refilled(numbers, opened)


def is_constant(x: Any) -> bool:
    return is_zero(x) or type(x) is float


def moving(numbers: Any) -> list[Any]:
    """Return the numbers that are no constants."""
    return [x for x in flatten(numbers) if not is_constant(x)]


def marks(body: Any) -> int:
    """Return how many numbers of a body are marked."""
    return sum(isinstance(x, Dual) for x in flatten(body))


class Gains:
    """Gains are rows of memory."""

    def __init__(self, run: Adjoint, body: Any, memory: Any) -> None:
        self.memory, self.lanes = memory, run.lanes
        self.of_body = run.inputs
        self.of_state = self.of_body + marks(body)

    def __getitem__(self, row: int) -> Any:
        return load(self.memory, (row, 0), self.lanes)

    def of(self, first: int, numbers: list[Any]) -> list[tuple[Any, Any]]:
        """Return numbers with their gains, in rows from `first` on."""
        return [(x, self[first + i]) for i, x in enumerate(numbers)]

    def put(self, first: int, gains: Iterable[Any]) -> None:
        for i, gain in enumerate(gains):
            store(self.memory, (first + i, 0), gain, self.lanes)

    def add(self, first: int, gains: Iterable[Any]) -> None:
        for i, gain in enumerate(gains):
            if not is_zero(gain):
                store(self.memory, (first + i, 0), self[first + i] + gain, self.lanes)
