"""Extra states by users' functions, integrated with the motion: `lierb.states`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, ClassVar, Self, overload

from numpy.typing import ArrayLike

from lierb.errors import ArgumentError
from lierb.kernels.functions.shapes import Shapes
from lierb.kernels.mechanics import elements as kinds
from lierb.model.functions.decorated import Decorated, decorated
from lierb.model.functions.elements import Element, seeing
from lierb.model.functions.named_values import (
    checked_units,
    initial_and_parameters,
    initial_values,
    parameter_defaults,
    prefixed,
    python_of,
    shapes_of,
)
from lierb.model.functions.tracing import ARGUMENTS, SIGNALS, described, form_of_any, runnable

INTEGRATED = "it is integrated with the motion, of many at once"


@dataclass(frozen=True, eq=False, repr=False)
class ExtraStates(Element):
    """States beside the bodies', by their derivatives; made by `lierb.states`.

    units : of the states, by name; "1" where there is none.
    """

    kind: kinds.UserStates
    units: Mapping[str, str] = field(default_factory=dict)
    words: ClassVar = "states", "states"

    @property
    def columns(self) -> Shapes:
        """Names and shapes of the states."""
        return self.kind.states

    def bound(self, states: Shapes, controls: Shapes) -> Self:
        function = seeing(self.kind.function, states, controls)
        made = runnable(function, python_of(self), INTEGRATED)
        return self.of_kind(function=made)


class StatesFunction(Decorated):
    """What `lierb.states` makes of a function."""

    def __init__(self, function: Callable[..., Any], defaults: dict[str, Any]) -> None:
        given = dict(defaults)
        units, parameters = given.pop("unit", {}), given.pop("params", {})
        self.initial = initial_values("a state", given)
        if not given:
            raise ArgumentError(
                f"{function.__name__} has no states; name them with their initial values, such as "
                "@lierb.states(wheel=(0.0, 0.0, 0.0))"
            )
        self.units = checked_units(units, given)
        self.own = tuple(given)
        super().__init__(function, parameter_defaults(parameters, given))

    def __call__(self, **given: ArrayLike) -> ExtraStates:
        """The states with these initial values and parameters, of all bodies or of each."""
        initial, parameters = initial_and_parameters(given, self.initial)
        shapes, states = self._shapes(parameters), shapes_of(self.initial)
        form = partial(form_of_any, SIGNALS)
        function = described(self.function, tuple(ARGUMENTS), shapes, (), form, outputs=(states,))
        if not function.sees_others:
            function = runnable(function, self.function, INTEGRATED)
        kind = kinds.UserStates(function, states)
        made = ExtraStates.of(
            function.name, kind, **self.defaults | parameters | prefixed(self.initial | initial)
        )
        return replace(made, units=self.units, made_by=self)


@overload
def states(function: Callable[..., Any], /) -> StatesFunction: ...
@overload
def states(
    *,
    unit: Mapping[str, str] = ...,
    params: Mapping[str, ArrayLike] = ...,
    **initial: ArrayLike,
) -> Callable[[Callable[..., Any]], StatesFunction]: ...
def states(function: Callable[..., Any] | None = None, /, **given: Any) -> Any:
    """Make a function the equations of extra states: `@lierb.states(wheel=(0.0, 0.0, 0.0))`.

    The function takes any of t, R, r, omega, v, params, body, states and controls, by these names
    and in any order, each as in `lierb.wrench`, and returns the states' derivatives, a dictionary
    by their names. The states are integrated with the motion; wrenches, observables, events,
    controllers and other states have them as `states.NAME`. They are columns of `history` and
    `summary`. The function cannot branch on numbers except by `lierb.where`.

    Parameters
    ----------
    function : callable, optional
        The function; left out where there are defaults or settings.
    unit : dict of str, optional
        Unit of each state, by name, for the columns' metadata. Default: "1".
    params : dict of array_like, optional
        Default of each parameter, by name. Without them all parameters are numbers.
    **initial : array_like
        Initial value of each state, a number or a vector of fixed length.

    Returns
    -------
    callable
        Function that makes states for `Problem(states=…)`. A keyword with a state's name is its
        initial value, any other one a parameter.

    Raises
    ------
    ForceError
        The function has another form, or cannot be compiled.
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
