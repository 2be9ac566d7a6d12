"""What a problem has along its time: events, states beside the bodies', sampled controllers.

All are functions of the user's, as `lierb.wrench` is. Functions of a problem see all of its states
and of its controllers' outputs by their names; so they are tried when the problem is made.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from keyword import iskeyword
from typing import Any, ClassVar, Self, overload

from numpy.typing import ArrayLike

from lierb.errors import ArgumentError, ForceError, told, unknown_name
from lierb.kernels.functions.function import Function
from lierb.kernels.functions.shapes import Shapes
from lierb.kernels.functions.trials import outputs_of
from lierb.kernels.mechanics import elements as kinds
from lierb.model.functions.elements import (
    Decorated,
    Element,
    column_name,
    decorated,
    require_unit,
    seeing,
)
from lierb.model.functions.tracing import (
    ARGUMENTS,
    SIGNALS,
    described,
    form_of_any,
    runnable,
    user_function,
    why_untraced,
)
from lierb.support.arrays import as_floats, as_positive

INTEGRATED = "it is integrated with the motion, of many at once"
SAMPLED = "it is called for many at once, each at its own time"


# ---- elements ----------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False, repr=False)
class Event(Element):
    """A crossing of zero by a number, located along the motion; made by `lierb.event`.

    Attributes
    ----------
    name : str
        Name in the table of events.
    parameters : dict of ndarray
        Parameters by name, each in its own shape, or with an axis for the bodies before it.
    made_by : callable or None
        The user's function, as it was decorated.
    at : tuple of str
        Place in a mechanism: a link or two.
    direction : {-1, 0, 1}
        Crossings that count: 1 rising, −1 falling, 0 both.
    terminal : bool
        True if the trajectory ends there.
    """

    direction: int = 0
    terminal: bool = False
    words: ClassVar = "an event", "events"

    def named(self, name: str) -> Self:
        """Rename the event: a problem may have one function several times.

        Parameters
        ----------
        name : str
            Name in the table of events.

        Returns
        -------
        Event
            The event of that name.

        Examples
        --------
        >>> import lierb
        >>> @lierb.event(height=0.0)
        ... def crossing(r, params):
        ...     return r[2] - params.height
        >>> crossing(height=2.0).named("the_roof")
        <the_roof: height>
        """
        return replace(self, name=column_name("name", name))


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
        made = runnable(function, _python_of(self), INTEGRATED)
        return self.of_kind(function=made)


@dataclass(frozen=True, eq=False, repr=False)
class Controller(Element):
    """What is called once a period, and whose outputs are held; made by `lierb.controller`.

    units : of the outputs, by name; "1" where there is none.
    """

    kind: kinds.UserController
    units: Mapping[str, str] = field(default_factory=dict)
    words: ClassVar = "a controller", "controllers"

    @property
    def columns(self) -> Shapes:
        """Names and shapes of the outputs; known in a problem."""
        return self.kind.outputs

    def bound(self, states: Shapes, controls: Shapes) -> Self:
        function = seeing(self.kind.function, states, controls)
        made = runnable(function, _python_of(self), SAMPLED)
        return self.of_kind(function=made)

    def putting_out(self, outputs: Shapes) -> Self:
        """The same with these outputs."""
        for name, shape in outputs:
            _require_name(f"{self.name}: an output", name)
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


def _python_of(element: Element) -> Callable[..., Any]:
    assert element.made_by is not None
    return element.made_by.function


# ---- decorators --------------------------------------------------------------------------------


class EventFunction(Decorated):
    """What `lierb.event` makes of a function."""

    def __init__(self, function: Callable[..., Any], defaults: dict[str, Any]) -> None:
        direction, terminal = defaults.pop("direction", 0), defaults.pop("terminal", False)
        if isinstance(direction, bool) or direction not in (-1, 0, 1):
            raise ArgumentError(
                f"direction={told(direction)}; expected -1 (falling), 1 (rising) or 0 (both)"
            )
        if not isinstance(terminal, bool):
            raise ArgumentError(f"terminal={told(terminal)}; expected True or False")
        super().__init__(function, defaults)
        self.direction, self.terminal = int(direction), terminal

    def __call__(self, **parameters: ArrayLike) -> Event:
        """The event with these parameters; each is one for all bodies or one for each."""
        shapes = self._shapes(parameters)
        form = partial(form_of_any, SIGNALS)
        function = user_function(self.function, tuple(ARGUMENTS), shapes, ((),), form=form)
        name = column_name("the event's name", function.name)
        made = Event.of(name, kinds.UserEvent(function), **self.defaults | parameters)
        return replace(made, direction=self.direction, terminal=self.terminal, made_by=self)


class StatesFunction(Decorated):
    """What `lierb.states` makes of a function."""

    def __init__(self, function: Callable[..., Any], defaults: dict[str, Any]) -> None:
        given = dict(defaults)
        units, parameters = given.pop("unit", {}), given.pop("params", {})
        self.initial = _initial_values("a state", given)
        if not given:
            raise ArgumentError(
                f"{function.__name__} has no states; name them with their initial values, such as "
                "@lierb.states(wheel=(0.0, 0.0, 0.0))"
            )
        self.units = _units(units, given)
        self.own = tuple(given)
        super().__init__(function, _parameters(parameters, given))

    def __call__(self, **given: ArrayLike) -> ExtraStates:
        """The states with these initial values and parameters, of all bodies or of each."""
        initial, parameters = _apart(given, self.initial)
        shapes, states = self._shapes(parameters), _shapes_of(self.initial)
        form = partial(form_of_any, SIGNALS)
        function = described(self.function, tuple(ARGUMENTS), shapes, (), form, outputs=(states,))
        if not function.sees_others:
            function = runnable(function, self.function, INTEGRATED)
        kind = kinds.UserStates(function, states)
        made = ExtraStates.of(
            function.name, kind, **self.defaults | parameters | _prefixed(self.initial | initial)
        )
        return replace(made, units=self.units, made_by=self)


class ControllerFunction(Decorated):
    """What `lierb.controller` makes of a function."""

    def __init__(self, function: Callable[..., Any], defaults: dict[str, Any]) -> None:
        given = dict(defaults)
        self.every = given.pop("every", None)
        units, memory = given.pop("unit", {}), given.pop("memory", {})
        if self.every is not None:
            as_positive("every", self.every, "s")
        if not isinstance(memory, Mapping):
            raise ArgumentError(
                f"memory={told(memory)}; expected initial values by name, such as "
                '{"integral": 0.0}'
            )
        self.memory = _initial_values("memory", memory)
        self.units = _units(units, None)
        self.own = ("every", *memory)
        super().__init__(function, _parameters(given, memory))

    def __call__(self, **given: ArrayLike) -> Controller:
        """The controller with this period, initial memory and parameters, of all or of each."""
        every = given.pop("every", self.every)
        name = self.function.__name__
        if every is None:
            raise ArgumentError(f"{name} has no period; give every=, s, such as {name}(every=0.1)")
        initial, parameters = _apart(given, self.memory)
        shapes, memory = self._shapes(parameters), _shapes_of(self.memory)
        seen = (*SIGNALS, "memory") if memory else SIGNALS
        function = described(
            self.function, tuple(ARGUMENTS), shapes, (), partial(form_of_any, seen),
            memory=memory, outputs=((), memory) if memory else ((),), draws=True,
        )  # fmt: skip
        kind = kinds.UserController(function, memory)
        numbers = self.defaults | parameters | _prefixed(self.memory | initial)
        made = Controller.of(name, kind, every=as_positive("every", every, "s"), **numbers)
        made = replace(made, units=self.units, made_by=self)
        if function.sees_others:
            return made
        return made.putting_out(_outputs_of(function)).bound((), ())


def _outputs_of(function: Function) -> Shapes:
    """What a controller puts out. Raises ForceError where it cannot be traced."""
    reason = why_untraced(function, outputs_of)
    if reason is not None:
        raise untraceable(function, reason)
    return outputs_of(function)


def untraceable(function: Function, reason: str) -> ForceError:
    return ForceError(
        f"{function.name} must run for many bodies at once, because {SAMPLED}; {reason}"
    )


def _require_name(what: str, name: Any) -> str:
    """A name that a column, and an attribute, may have."""
    column_name(f"{what}'s name", name)
    if iskeyword(name) or name.startswith("_"):
        raise ArgumentError(f"{what} is named {name}, which no attribute can be; give another name")
    return str(name)


def _initial_values(what: str, given: Mapping[str, Any]) -> dict[str, Any]:
    """Values by name, as given. Raises ArgumentError for what is no number or vector."""
    for name, value in given.items():
        _require_name(what, name)
        shape = as_floats(name, value).shape
        if len(shape) > 1 or math.prod(shape) == 0:
            raise ArgumentError(
                f"{name} has shape {shape}; expected the initial value of one body, a number or a "
                "vector"
            )
    return dict(given)


def _shapes_of(given: Mapping[str, Any]) -> Shapes:
    return tuple((name, as_floats(name, value).shape) for name, value in given.items())


def _units(given: Any, names: Iterable[str] | None) -> dict[str, str]:
    """Checked; names : those that there are, if that is known."""
    if not isinstance(given, Mapping):
        raise ArgumentError(
            f'unit={told(given)}; expected units by name, such as {{"wheel": "N m s"}}'
        )
    for name, unit in given.items():
        if names is not None and name not in names:
            raise unknown_name("unit of", name, names)
        require_unit(f"unit[{told(name)}]", unit)
    return dict(given)


def _parameters(given: Any, others: Iterable[str]) -> dict[str, Any]:
    """Defaults of parameters, none of which is named as something else."""
    if not isinstance(given, Mapping):
        raise ArgumentError(
            f'params={told(given)}; expected defaults by name, such as {{"tau": 0.5}}'
        )
    for name in given:
        if name in others:
            raise ArgumentError(f"two are named {name}: a parameter and an initial value")
    return dict(given)


def _apart(
    given: dict[str, Any], names: Mapping[str, Any]
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Initial values, and parameters."""
    initial = {name: value for name, value in given.items() if name in names}
    return initial, {name: value for name, value in given.items() if name not in names}


def _prefixed(initial: Mapping[str, Any]) -> dict[str, Any]:
    return {f"{kinds.INITIAL}{name}": value for name, value in initial.items()}


@overload
def event(function: Callable[..., Any], /) -> EventFunction: ...
@overload
def event(
    *, direction: int = 0, terminal: bool = False, **defaults: ArrayLike
) -> Callable[[Callable[..., Any]], EventFunction]: ...
def event(function: Callable[..., Any] | None = None, /, **defaults: Any) -> Any:
    """Make a function an event: `@lierb.event(terminal=True)`, with defaults as in `wrench`.

    The function takes any of t, R, r, omega, v, params, body, states and controls, by these names
    and in any order, each as in `lierb.wrench`, and returns one number, which should be smooth. The
    event is where that number crosses zero. The crossings are in `result.events`.

    Parameters
    ----------
    function : callable, optional
        The function; left out where there are defaults or settings.
    direction : {-1, 0, 1}, optional
        Crossings that count: 1 rising, −1 falling, 0 both.
    terminal : bool, optional
        End the trajectory at the first crossing.
    **defaults : array_like
        Default of each parameter, as in `lierb.wrench`.

    Returns
    -------
    callable
        Function of the parameters, by keyword, that makes an event for `Problem(events=…)` and
        `lierb.integrate(events=…)`.

    Raises
    ------
    ForceError
        The function has another form, or cannot be compiled.
    ArgumentError
        The direction is another number.

    Examples
    --------
    >>> import lierb
    >>> @lierb.event(direction=-1, terminal=True, ground=0.0)
    ... def landing(r, params):
    ...     return r[2] - params.ground
    >>> landing(ground=[0.0, 0.5])
    <landing: ground>
    """
    return decorated(EventFunction, function, defaults)


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


@overload
def controller(function: Callable[..., Any], /) -> ControllerFunction: ...
@overload
def controller(
    *,
    every: ArrayLike | None = None,
    memory: Mapping[str, ArrayLike] = ...,
    unit: Mapping[str, str] = ...,
    **defaults: ArrayLike,
) -> Callable[[Callable[..., Any]], ControllerFunction]: ...
def controller(function: Callable[..., Any] | None = None, /, **given: Any) -> Any:
    """Make a function a sampled controller: `@lierb.controller(every=0.1)`.

    The function takes any of t, R, r, omega, v, params, body, states, controls and memory, by these
    names and in any order, each as in `lierb.wrench`. It returns its outputs, a dictionary of
    numbers and vectors by name; with memory (outputs, memory), two dictionaries.

    It is called at the multiples of its period, 0, T, 2T, …, from the start of the run on. Outputs
    are held until the next call, and are zero before the first one; wrenches, observables, events,
    states and controllers have them as `controls.NAME`. They are columns of `history` and
    `summary`. Tracing the function once gives the names and shapes of outputs. It cannot branch on
    numbers except by `lierb.where`; `lierb.noise.normal` draws random numbers.

    Parameters
    ----------
    function : callable, optional
        The function; left out where there are defaults or settings.
    every : float or array_like, shape (n,), optional
        Period T, s. It may be left to the call.
    memory : dict of array_like, optional
        Initial values of what it keeps from call to call, by name: a number or a vector each. In
        the function they are `memory.NAME`.
    unit : dict of str, optional
        Unit of each output, by name, for the columns' metadata. Default: "1".
    **defaults : array_like
        Default of each parameter, as in `lierb.wrench`.

    Returns
    -------
    callable
        Function that makes a controller for `Problem(controllers=…)`. Its keyword `every` is the
        period, one with a memory's name its initial value, any other one a parameter.

    Raises
    ------
    ForceError
        The function has another form, or cannot be compiled.
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
