"""Methods whose steps compute derivatives along many directions in a loop.

A formula on dual numbers of several parts has code for each part, and its numbers leave no
registers. Here a step is traced once, with one part that is a place on a tape
(`lierb.kernels.numbers.tape`). The operations of the tape are the body of a loop over directions.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from lierb.kernels.numbers.arithmetic import alike, flatten, plain, recorded_on
from lierb.kernels.numbers.dual import Dual, parts_of, value_of, values
from lierb.kernels.numbers.tape import Linear, Tape
from lierb.kernels.numbers.zero import is_zero
from lierb.kernels.stepping.differentiable import WrappedMethod
from lierb.kernels.stepping.method import Interval, Step
from lierb.kernels.systems.state import State
from lierb.kernels.systems.system import AnySystem


@dataclass(frozen=True)
class TapedMethod(WrappedMethod):
    """A loop over the directions computes the derivatives of the method's steps.

    with_slopes : True if the slopes of a step have derivatives, for dense output.
    """

    with_slopes: bool

    def evaluated(self, formula: Callable[..., Any], *operands: Any) -> Any:
        return with_loop(formula, *operands)

    def step(
        self, system: AnySystem, body: Any, state: State, at: Interval, all_stages: bool = False
    ) -> Step:
        def formula(body: Any, state: State, at: Interval) -> Step:
            made = self.method.step(system, body, state, at, all_stages)
            slopes = made.slopes if self.with_slopes else values(made.slopes)
            only_values: Step = values(made)
            return only_values._replace(state=made.state, slopes=slopes)

        return self.evaluated(formula, body, state, at)


def with_loop(formula: Callable[..., Any], *operands: Any) -> Any:
    """Return formula(*operands); a loop over the directions computes the derivatives."""
    duals = [x for x in flatten(operands) if isinstance(x, Dual)]
    count = max((len(x.parts) for x in duals), default=0)
    if not count:
        return formula(*operands)
    like, tape, rows = duals[0].value, Tape(), list[tuple[Any, ...]]()

    def opened(x: Any) -> Any:
        """Return dual numbers with inputs of the tape as parts; note the parts in `rows`."""
        if isinstance(x, tuple):
            return alike(x, map(opened, x))
        if all(map(is_zero, parts_of(x))):
            return value_of(x)
        rows.append(tuple(map(plain, x.parts)))
        return Dual(x.value, (tape.input(),))

    with recorded_on(tape, like):
        results = formula(*map(opened, operands))
    linear = [part for x in flatten(results) for part in parts_of(x) if isinstance(part, Linear)]
    along = tape.derivatives(linear, list(zip(*rows, strict=True)), like)
    derivatives = zip(*along, strict=True)

    def closed(x: Any) -> Any:
        if isinstance(x, tuple):
            return alike(x, map(closed, x))
        is_linear = any(isinstance(part, Linear) for part in parts_of(x))
        return Dual(x.value, next(derivatives)) if is_linear else value_of(x)

    return closed(results)
