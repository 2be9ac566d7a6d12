"""`lierb.states` makes extra states, integrated with the motion by users' functions."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, overload

from numpy.typing import ArrayLike

from lierb.errors import ArgumentError
from lierb.kernels.functions.shapes import UserFunction
from lierb.kernels.mechanics.passive_elements import UserStates
from lierb.model.functions.decorated import Decorated, decorated
from lierb.model.functions.named_values import (
    NamedValues,
    checked_units,
    parameter_defaults,
    shapes_of,
    values_of,
)
from lierb.model.functions.tracing import MOTION, by_name, described, runnable


@dataclass(frozen=True, eq=False, repr=False)
class ExtraStates(NamedValues):
    """Extra states made by `lierb.states` are in addition to those of bodies."""

    words: ClassVar = "states", "states"
    because: ClassVar = "it is integrated with the motion, of many at once"


class StatesFunction(Decorated):
    """A function decorated by `lierb.states` returns derivatives of extra states."""

    def __init__(self, function: UserFunction, defaults: dict[str, Any]) -> None:
        initial = dict(defaults)
        units, parameters = initial.pop("unit", {}), initial.pop("params", {})
        self.initial, self.states = initial, shapes_of("a state", initial)
        if not initial:
            raise ArgumentError(
                f"{function.__name__} has no states; name them with their initial values, such as "
                "@lierb.states(wheel=(0.0, 0.0, 0.0))"
            )
        self.units = checked_units(units, initial)
        self.own = tuple(initial)
        super().__init__(function, parameter_defaults(parameters, initial))

    def __call__(self, **arguments: ArrayLike) -> ExtraStates:
        """Make the states with these initial values and parameters.

        Each is one value for all bodies, or one for each.
        """
        parameters, values = values_of(arguments, self.initial, self.defaults)
        shapes, outputs = self._shapes(parameters), (self.states,)
        function = described(self.function, MOTION, shapes, (), by_name, outputs=outputs)
        if not function.takes_signals:
            function = runnable(function, self.function, ExtraStates.because)
        kind = UserStates(function, self.states)
        return ExtraStates.of(function.name, kind, values, units=self.units, made_by=self)


@overload
def states(function: UserFunction, /) -> StatesFunction: ...
@overload
def states(
    *, unit: Mapping[str, str] = ..., params: Mapping[str, ArrayLike] = ..., **initial: ArrayLike
) -> Callable[[UserFunction], StatesFunction]: ...
def states(function: UserFunction | None = None, /, **given: Any) -> Any:
    """Make extra states from a function: `@lierb.states(wheel=(0.0, 0.0, 0.0))`.

    The function takes any of t, R, r, omega, v, params, body, states and controls, by these names
    and in any order, each as in `lierb.wrench`, and returns the derivatives of the states, a
    dictionary by name. The states are integrated with the motion; wrenches, observables, events,
    controllers and other states read them as `states.NAME`. They are columns of `history` and
    `summary`. The function cannot branch on numbers except by `lierb.where`.

    Parameters
    ----------
    function : callable, optional
        The function; omitted if the decorator has arguments.
    unit : dict of str, optional
        Unit of each state, by name, for the columns' metadata. Default: "1".
    params : dict of array_like, optional
        Default of each parameter, by name. Without them all parameters are numbers.
    **initial : array_like
        Initial value of each state, a number or a vector of fixed length.

    Returns
    -------
    callable
        Function that makes states for `Problem(states=…)`. Keywords with names of states are
        initial values; all others are parameters.

    Raises
    ------
    ForceError
        The function's arguments are wrong, or it cannot be compiled.
    ArgumentError
        Columns of that name exist already.

    Examples
    --------
    >>> import lierb
    >>> @lierb.states(wheel=(0.0, 0.0, 0.0), filtered=0.0, unit={"wheel": "N m s"})
    ... def wheel_and_filter(omega, states, controls, params):
    ...     return {
    ...         "wheel": -controls.torque,
    ...         "filtered": (omega[2] - states.filtered) / params.tau,
    ...     }
    >>> wheel_and_filter(tau=0.5, filtered=[0.0, 0.1])
    <wheel_and_filter: tau, initial.wheel, initial.filtered>
    """
    return decorated(StatesFunction, function, given)
