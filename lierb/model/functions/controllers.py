"""`lierb.controller` makes sampled controllers from users' functions."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, ClassVar, Self, overload

from numpy.typing import ArrayLike

from lierb.errors import ArgumentError, ForceError, unknown_name
from lierb.kernels.functions.function import Function
from lierb.kernels.functions.shapes import Shapes, UserFunction
from lierb.kernels.functions.trials import outputs_of
from lierb.kernels.mechanics.passive_elements import FELT, UserController
from lierb.model.functions.decorated import Decorated, decorated
from lierb.model.functions.named_values import (
    NamedValues,
    checked_units,
    mapping_of,
    parameter_defaults,
    require_attribute,
    shapes_of,
    values_of,
)
from lierb.model.functions.tracing import SIGNALS, described, form_of_any, seen_by, why_untraced
from lierb.support.arrays import as_positive


@dataclass(frozen=True, eq=False, repr=False)
class Controller(NamedValues):
    """Sampled controller, made by `lierb.controller`; outputs are constant for a period."""

    words: ClassVar = "a controller", "controllers"
    because: ClassVar = "it is called for many at once, each at its own time"

    @property
    def columns(self) -> Shapes:
        """Names and shapes of the outputs; they are known once it is part of a problem."""
        return tuple(self.kind.outputs)

    def with_outputs(self, outputs: Shapes) -> Self:
        """Copy of the controller with these names and shapes of outputs."""
        for name, shape in outputs:
            require_attribute(f"{self.name}: an output", name)
            if len(shape) > 1 or math.prod(shape) == 0:
                raise ForceError(
                    f"{self.name}: its output {name} has shape {shape}; expected a number or a "
                    "vector"
                )
        if not outputs:
            raise ForceError(
                f"{self.name} puts nothing out; expected a dictionary of numbers and vectors, such "
                'as {"torque": …}'
            )
        for name in self.units:
            if name not in dict(outputs):
                raise unknown_name(f"{self.name}: unit of", name, dict(outputs))
        function = self.kind.function
        function = replace(function, outputs=(outputs, *function.outputs[1:]))
        return self.of_kind(function=function, outputs=outputs)


class ControllerFunction(Decorated):
    """A function decorated by `lierb.controller` returns outputs at sampled times."""

    def __init__(self, function: UserFunction, defaults: dict[str, Any]) -> None:
        parameters = dict(defaults)
        self.every = parameters.pop("every", None)
        if self.every is not None:
            as_positive("every", self.every, "s")
        self.units = checked_units(parameters.pop("unit", {}), None)
        expected = 'initial values by name, such as {"integral": 0.0}'
        self.initial = mapping_of("memory", parameters.pop("memory", {}), expected)
        self.memory = shapes_of("memory", self.initial)
        self.own = ("every", *self.initial)
        super().__init__(function, parameter_defaults(parameters, self.initial))

    def __call__(self, **arguments: ArrayLike) -> Controller:
        """Make the controller with this period, initial memory and parameters.

        Each is one value for all bodies, or one for each.
        """
        every = arguments.pop("every", self.every)
        name = self.function.__name__
        if every is None:
            raise ArgumentError(f"{name} has no period; give every=, s, such as {name}(every=0.1)")
        parameters, values = values_of(arguments, self.initial, self.defaults)
        function = described(
            self.function, seen_by(self.function), self._shapes(parameters), (),
            partial(form_of_any, (*SIGNALS, "memory") if self.memory else SIGNALS, further=FELT),
            memory=self.memory, outputs=((), self.memory) if self.memory else ((),), draws=True,
        )  # fmt: skip
        kind = UserController(function, self.memory)
        values = {"every": as_positive("every", every, "s"), **values}
        controller = Controller.of(name, kind, values, units=self.units, made_by=self)
        if function.takes_signals:
            return controller
        return controller.with_outputs(_outputs_of(function)).bound((), ())


def _outputs_of(function: Function) -> Shapes:
    """Names and shapes of a controller's outputs; raises ForceError if it cannot be traced."""
    reason = why_untraced(function, outputs_of)
    if reason is not None:
        raise untraceable(function, reason)
    return outputs_of(function)


def untraceable(function: Function, reason: str) -> ForceError:
    return ForceError(
        f"{function.name} must run for many bodies at once, because {Controller.because}; {reason}"
    )


@overload
def controller(function: UserFunction, /) -> ControllerFunction: ...
@overload
def controller(
    *,
    every: ArrayLike | None = None,
    memory: Mapping[str, ArrayLike] = ...,
    unit: Mapping[str, str] = ...,
    **defaults: ArrayLike,
) -> Callable[[UserFunction], ControllerFunction]: ...
def controller(function: UserFunction | None = None, /, **given: Any) -> Any:
    """Make a sampled controller from a function: `@lierb.controller(every=0.1)`.

    The function takes any of t, R, r, omega, v, params, body, states, controls, memory, alpha and
    specific_force, by these names and in any order, each as in `lierb.observable`; accelerations
    are those with the outputs before the call. It returns its outputs, a dictionary of numbers and
    vectors by name; with memory (outputs, memory), two dictionaries.

    The function is called at multiples of its period, 0, T, 2T, …, from the start of the run on.
    Outputs are constant until the next call, and zero before the first one. Wrenches, observables,
    events, states and controllers read them as `controls.NAME`. They are columns of `history` and
    `summary`. Their names and shapes are determined by tracing the function once. It cannot branch
    on numbers except by `lierb.where`; `lierb.noise.normal` draws random numbers.

    Parameters
    ----------
    function : callable, optional
        The function; omitted if the decorator has arguments.
    every : float or array_like, shape (n,), optional
        Period T, s. It can also be an argument of the call.
    memory : dict of array_like, optional
        Initial value of each variable that persists from call to call, by name: a number or a
        vector. In the function they are `memory.NAME`.
    unit : dict of str, optional
        Unit of each output, by name, for the columns' metadata. Default: "1".
    **defaults : array_like
        Default of each parameter, as in `lierb.wrench`.

    Returns
    -------
    callable
        Function that makes a controller for `Problem(controllers=…)`. The keyword `every` is the
        period; keywords with names of memory are initial values; all others are parameters.

    Raises
    ------
    ForceError
        The function's arguments are wrong, or it cannot be compiled.
    ArgumentError
        Columns of that name exist already.

    Examples
    --------
    >>> import lierb
    >>> @lierb.controller(
    ...     every=0.1, memory={"integral": (0.0, 0.0, 0.0)}, unit={"torque": "N m"}, gain=0.5,
    ... )
    ... def attitude(omega, params, memory):
    ...     integral = memory.integral + 0.1 * omega
    ...     return {"torque": -params.gain * (omega + integral)}, {"integral": integral}
    >>> attitude(gain=[0.5, 1.0], every=0.05)
    <attitude: every, gain, initial.integral>
    """
    return decorated(ControllerFunction, function, given)
